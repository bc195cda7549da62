-- SPDX-License-Identifier: AGPL-3.0-or-later
-- How a panel's picture was set upright when its sections were found on it: mirrored left to right or
-- not, then turned clockwise by so many quarters, and what is to be said of that. Whoever opens the
-- picture again turns it alike. NULL: not known, and so for panels that were looked at before this
-- was kept; they are looked at again before their sections are used.
ALTER TABLE panel ADD COLUMN mirrored INTEGER CHECK (mirrored = 0 OR mirrored = 1);
ALTER TABLE panel ADD COLUMN quarters INTEGER CHECK (quarters >= 0 AND quarters <= 3);
ALTER TABLE panel ADD COLUMN turn_note TEXT NOT NULL DEFAULT '';
