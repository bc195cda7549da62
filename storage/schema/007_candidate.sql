-- SPDX-License-Identifier: AGPL-3.0-or-later
-- The poses that a doubtful section may have, for a person to choose from: a JSON array in the order
-- of their numbers, or empty. It goes with the section's row when the panel is looked at again.
ALTER TABLE section ADD COLUMN candidates TEXT NOT NULL DEFAULT '';
