-- SPDX-License-Identifier: AGPL-3.0-or-later
-- What a person decided about a panel or one of its slots. One row a question: the last answer holds,
-- and the audit log has them all. number is that of the panel and slot counts from 1 in its order, 0 for
-- the panel as a whole; x_px, y_px: the middle of what the answer is about, on the upright picture.
CREATE TABLE decision (
    specimen_id INTEGER NOT NULL REFERENCES specimen,
    number INTEGER NOT NULL CHECK (number > 0),
    slot INTEGER NOT NULL CHECK (slot >= 0),
    answer TEXT NOT NULL CHECK (answer <> ''),
    x_px REAL,
    y_px REAL,
    actor TEXT NOT NULL,
    reason TEXT NOT NULL,
    time INTEGER NOT NULL,
    PRIMARY KEY (specimen_id, number, slot)
) STRICT, WITHOUT ROWID;
