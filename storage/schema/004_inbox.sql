-- SPDX-License-Identifier: AGPL-3.0-or-later
-- What has come and has no row in the ledger yet. A picture is safe with one row on one page here:
-- its row in the ledger, its panel, its job and its event in the audit log lie on ten pages, and are
-- written for many pictures at once. Whoever writes next writes these first, in the order in which
-- they came. Every rule that the ledger and the panels have stands here too, so that what has been
-- taken in is never refused afterwards.

CREATE TABLE inbox (
    id INTEGER PRIMARY KEY,
    -- In front: it tells most pictures apart, and comparing numbers is quick.
    size INTEGER NOT NULL CHECK (size > 0),
    sha256 TEXT NOT NULL CHECK (length(sha256) = 64),
    name TEXT NOT NULL,
    source TEXT NOT NULL,
    device TEXT NOT NULL,
    key TEXT NOT NULL,
    subject TEXT NOT NULL CHECK (subject = 'panel' OR subject = 'blank' OR subject = 'dark'),
    facts TEXT NOT NULL,
    number INTEGER NOT NULL CHECK (number >= 0),
    arrived INTEGER NOT NULL
) STRICT;

-- That a digest is one is asked once, by the program: GLOB takes longer to say so than the row takes
-- to be written. The rows stay as they are (see 003).
PRAGMA writable_schema = ON;
UPDATE sqlite_schema SET sql = replace(sql, ' AND sha256 NOT GLOB ''*[^0-9a-f]*''', '')
WHERE type = 'table' AND name IN ('panel', 'scan');
PRAGMA writable_schema = RESET;
