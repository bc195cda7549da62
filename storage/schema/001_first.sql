-- SPDX-License-Identifier: AGPL-3.0-or-later
-- The first schema. Times are seconds since 1970 (UTC), pixels are those of the upright image,
-- texts are UTF-8 as far as the giver kept to it; NULL stands for a number nobody knows.

CREATE TABLE study (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE
) STRICT;

-- "group" is a word of SQL.
CREATE TABLE study_group (
    id INTEGER PRIMARY KEY,
    study_id INTEGER NOT NULL REFERENCES study,
    name TEXT NOT NULL,
    UNIQUE (study_id, name)
) STRICT;

CREATE TABLE animal (
    id INTEGER PRIMARY KEY,
    study_id INTEGER NOT NULL REFERENCES study,
    name TEXT NOT NULL,
    UNIQUE (study_id, name)
) STRICT;

CREATE TABLE specimen (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE CHECK (name <> ''),
    study_id INTEGER NOT NULL REFERENCES study,
    group_id INTEGER NOT NULL REFERENCES study_group,
    animal_id INTEGER NOT NULL REFERENCES animal,
    week REAL,
    kind TEXT NOT NULL CHECK (kind IN ('sections', 'volume', 'tile')),
    baseline TEXT NOT NULL,
    job_json TEXT NOT NULL,
    job_sha256 TEXT NOT NULL CHECK (length(job_sha256) = 64)
) STRICT;
CREATE INDEX specimen_group ON specimen (group_id);
CREATE INDEX specimen_baseline ON specimen (baseline);

CREATE TABLE panel (
    id INTEGER PRIMARY KEY,
    specimen_id INTEGER NOT NULL REFERENCES specimen,
    number INTEGER NOT NULL CHECK (number >= 0),
    file_name TEXT NOT NULL,
    sha256 TEXT NOT NULL CHECK (length(sha256) = 64 AND sha256 NOT GLOB '*[^0-9a-f]*'),
    size INTEGER NOT NULL CHECK (size >= 0),
    state TEXT NOT NULL CHECK (state IN ('waiting', 'registered', 'refused', 'held')),
    code TEXT NOT NULL,
    message TEXT NOT NULL,
    width INTEGER NOT NULL CHECK (width >= 0),
    height INTEGER NOT NULL CHECK (height >= 0),
    px_um REAL,
    UNIQUE (specimen_id, sha256)
) STRICT;

-- Files that the job names beside its panels: masks, volumes, reference maps.
CREATE TABLE attachment (
    specimen_id INTEGER NOT NULL REFERENCES specimen,
    name TEXT NOT NULL CHECK (name <> ''),
    sha256 TEXT NOT NULL CHECK (length(sha256) = 64 AND sha256 NOT GLOB '*[^0-9a-f]*'),
    size INTEGER NOT NULL CHECK (size >= 0),
    PRIMARY KEY (specimen_id, name)
) STRICT, WITHOUT ROWID;

CREATE TABLE section (
    id INTEGER PRIMARY KEY,
    panel_id INTEGER NOT NULL REFERENCES panel,
    slot INTEGER NOT NULL CHECK (slot >= 1),
    serial INTEGER NOT NULL CHECK (serial >= 0),
    state TEXT NOT NULL CHECK (state IN ('found', 'empty', 'needs-eye', 'missing', 'held')),
    flags TEXT NOT NULL,
    bbox_x REAL,
    bbox_y REAL,
    bbox_w REAL,
    bbox_h REAL,
    area_px REAL,
    UNIQUE (panel_id, slot)
) STRICT;

CREATE TABLE marker (
    section_id INTEGER NOT NULL REFERENCES section ON DELETE CASCADE,
    mark INTEGER NOT NULL CHECK (mark BETWEEN 1 AND 3),
    found INTEGER NOT NULL CHECK (found IN (0, 1)),
    x_px REAL,
    y_px REAL,
    radius_px REAL,
    cov_xx REAL,
    cov_xy REAL,
    cov_yy REAL,
    score REAL,
    PRIMARY KEY (section_id, mark)
) STRICT, WITHOUT ROWID;

CREATE TABLE job (
    id INTEGER PRIMARY KEY,
    kind TEXT NOT NULL CHECK (kind IN ('panel', 'specimen')),
    specimen_id INTEGER NOT NULL REFERENCES specimen,
    panel_id INTEGER REFERENCES panel CHECK ((panel_id IS NULL) = (kind = 'specimen')),
    state TEXT NOT NULL DEFAULT 'waiting'
        CHECK (state IN ('waiting', 'running', 'done', 'failed')),
    again INTEGER NOT NULL DEFAULT 0 CHECK (again IN (0, 1)),
    attempts INTEGER NOT NULL DEFAULT 0,
    claim INTEGER NOT NULL DEFAULT 0,
    owner TEXT NOT NULL DEFAULT '',
    -- The owner's process: the boot and the process-id namespace it lives in, its id, its start.
    boot TEXT NOT NULL DEFAULT '',
    processes TEXT NOT NULL DEFAULT '',
    pid INTEGER NOT NULL DEFAULT 0,
    pid_start INTEGER NOT NULL DEFAULT 0,
    lease_s INTEGER NOT NULL DEFAULT 0,
    lease_until INTEGER NOT NULL DEFAULT 0,
    stage TEXT NOT NULL DEFAULT '',
    done INTEGER NOT NULL DEFAULT 0,
    total INTEGER NOT NULL DEFAULT 0,
    eta_s REAL,
    message TEXT NOT NULL DEFAULT '',
    code TEXT NOT NULL DEFAULT ''
) STRICT;
-- NULLs are all different to an index, so a specimen job counts as that of panel 0.
CREATE UNIQUE INDEX job_once ON job (kind, specimen_id, coalesce(panel_id, 0));
CREATE INDEX job_state ON job (state, kind, id);

CREATE TABLE run (
    id INTEGER PRIMARY KEY,
    specimen_id INTEGER NOT NULL REFERENCES specimen,
    key TEXT NOT NULL,
    version TEXT NOT NULL,
    inputs_json TEXT NOT NULL,
    parameters_json TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('running', 'reported', 'withheld', 'failed')),
    message TEXT NOT NULL DEFAULT '',
    report_path TEXT NOT NULL DEFAULT '',
    report_sha256 TEXT NOT NULL DEFAULT '',
    json_path TEXT NOT NULL DEFAULT '',
    json_sha256 TEXT NOT NULL DEFAULT '',
    event_head TEXT NOT NULL DEFAULT '',
    started INTEGER NOT NULL,
    finished INTEGER NOT NULL DEFAULT 0
) STRICT;
CREATE INDEX run_specimen ON run (specimen_id, id);

CREATE TABLE measure (
    id INTEGER PRIMARY KEY,
    run_id INTEGER NOT NULL REFERENCES run,
    name TEXT NOT NULL CHECK (name <> ''),
    value REAL,
    lower REAL,
    upper REAL,
    unit TEXT NOT NULL,
    UNIQUE (run_id, name)
) STRICT;

CREATE TABLE pose (
    id INTEGER PRIMARY KEY,
    run_id INTEGER NOT NULL REFERENCES run,
    panel_id INTEGER NOT NULL REFERENCES panel,
    slot INTEGER NOT NULL CHECK (slot >= 1),
    serial INTEGER NOT NULL CHECK (serial >= 0),
    m00 REAL NOT NULL,
    m01 REAL NOT NULL,
    m02 REAL NOT NULL,
    m10 REAL NOT NULL,
    m11 REAL NOT NULL,
    m12 REAL NOT NULL,
    flipped INTEGER NOT NULL CHECK (flipped IN (0, 1)),
    rotated180 INTEGER NOT NULL CHECK (rotated180 IN (0, 1)),
    rms_um REAL,
    tre_um REAL,
    UNIQUE (run_id, panel_id, slot)
) STRICT;

CREATE TABLE stain_batch (
    id INTEGER PRIMARY KEY,
    run_id INTEGER NOT NULL REFERENCES run,
    panel_id INTEGER NOT NULL REFERENCES panel,
    white_r REAL,
    white_g REAL,
    white_b REAL,
    -- Three dyes, each as optical density in red, green, blue.
    dye1_r REAL,
    dye1_g REAL,
    dye1_b REAL,
    dye2_r REAL,
    dye2_g REAL,
    dye2_b REAL,
    dye3_r REAL,
    dye3_g REAL,
    dye3_b REAL,
    source TEXT NOT NULL,
    UNIQUE (run_id, panel_id)
) STRICT;

CREATE TABLE event (
    id INTEGER PRIMARY KEY,
    time INTEGER NOT NULL,
    actor TEXT NOT NULL,
    kind TEXT NOT NULL CHECK (kind <> ''),
    subject TEXT NOT NULL,
    text TEXT NOT NULL,
    hash TEXT NOT NULL CHECK (length(hash) = 64)
) STRICT;

-- INSERT OR REPLACE would remove a row without asking the trigger on DELETE; an id that must be
-- the next one leaves nothing to replace.
CREATE TRIGGER event_is_appended BEFORE INSERT ON event
WHEN NEW.id IS NOT (SELECT coalesce(max(id), 0) + 1 FROM event)
BEGIN
    SELECT raise(ABORT, 'events are numbered without a gap');
END;
CREATE TRIGGER event_stays BEFORE UPDATE ON event
BEGIN
    SELECT raise(ABORT, 'events are never changed');
END;
CREATE TRIGGER event_is_kept BEFORE DELETE ON event
BEGIN
    SELECT raise(ABORT, 'events are never removed');
END;

-- A finished run is history too.
CREATE TRIGGER run_stays BEFORE UPDATE ON run
WHEN OLD.state <> 'running'
BEGIN
    SELECT raise(ABORT, 'a finished run is never changed');
END;
