-- SPDX-License-Identifier: AGPL-3.0-or-later
-- The bench: where pictures come from, what came, and what people asked of it.

-- One row per source of the configuration, written by whoever serves it.
CREATE TABLE source (
    name TEXT PRIMARY KEY CHECK (name <> ''),
    address TEXT NOT NULL,
    device TEXT NOT NULL DEFAULT '',
    state TEXT NOT NULL CHECK (state IN ('away', 'ready', 'receiving', 'paused', 'failed', 'off')),
    message TEXT NOT NULL DEFAULT '',
    -- What is being received now: its name, and bytes of how many.
    item TEXT NOT NULL DEFAULT '',
    done INTEGER NOT NULL DEFAULT 0,
    total INTEGER NOT NULL DEFAULT 0,
    changed INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

-- The ledger: one row per picture that arrived and is durable. A scan that belongs to a specimen is
-- filed and has its panel; one nobody can place is unfiled and waits for a person.
CREATE TABLE scan (
    id INTEGER PRIMARY KEY,
    source TEXT NOT NULL,
    device TEXT NOT NULL,
    name TEXT NOT NULL,
    key TEXT NOT NULL,
    subject TEXT NOT NULL CHECK (subject IN ('panel', 'blank', 'dark')),
    sha256 TEXT NOT NULL CHECK (length(sha256) = 64 AND sha256 NOT GLOB '*[^0-9a-f]*'),
    size INTEGER NOT NULL CHECK (size > 0),
    facts TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('filed', 'unfiled', 'kept')),
    reason TEXT NOT NULL,
    panel_id INTEGER REFERENCES panel,
    arrived INTEGER NOT NULL,
    UNIQUE (source, name, sha256)
) STRICT;
CREATE INDEX scan_key ON scan (key) WHERE key <> '';
-- Only what is looked for often and is rare: each index is another page to sync for every scan.
CREATE INDEX scan_unfiled ON scan (id) WHERE state = 'unfiled';
CREATE INDEX scan_alone ON scan (sha256) WHERE panel_id IS NULL;

-- What could not be taken in, until it can, or is dismissed by a person.
CREATE TABLE trouble (
    source TEXT NOT NULL,
    name TEXT NOT NULL,
    reason TEXT NOT NULL,
    action TEXT NOT NULL,
    tries INTEGER NOT NULL,
    since INTEGER NOT NULL,
    last INTEGER NOT NULL,
    PRIMARY KEY (source, name)
) STRICT, WITHOUT ROWID;

-- Whose panels a source delivers until somebody says otherwise.
CREATE TABLE expectation (
    source TEXT PRIMARY KEY,
    specimen_id INTEGER NOT NULL REFERENCES specimen,
    actor TEXT NOT NULL,
    since INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

-- What a person asked for: who, when, what; answered by the service.
CREATE TABLE request (
    id INTEGER PRIMARY KEY,
    time INTEGER NOT NULL,
    actor TEXT NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('capture-panel', 'capture-blank', 'capture-dark')),
    source TEXT NOT NULL,
    state TEXT NOT NULL DEFAULT 'waiting' CHECK (state IN ('waiting', 'done', 'refused')),
    message TEXT NOT NULL DEFAULT ''
) STRICT;
CREATE INDEX request_waiting ON request (source, id) WHERE state = 'waiting';
