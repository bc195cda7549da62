-- SPDX-License-Identifier: AGPL-3.0-or-later
-- What a run found is history once the run has ended: its figures, poses and colours come in while it
-- is running, and nothing of them changes afterwards. INSERT OR REPLACE would remove a row without
-- asking the trigger on DELETE, so an id that is there is refused as well. What came in keeps its
-- bytes in the ledger. Panels and sections are no history: a person may take a filing back, a whole
-- picture takes the place of its torn beginning, and sections are found anew whenever their panel is
-- looked at again; what became of the bytes is in the audit log.

CREATE TRIGGER run_is_kept BEFORE DELETE ON run
BEGIN
    SELECT raise(ABORT, 'runs are never removed');
END;
CREATE TRIGGER run_is_new BEFORE INSERT ON run WHEN EXISTS (SELECT 1 FROM run WHERE id = NEW.id)
BEGIN
    SELECT raise(ABORT, 'a run is never replaced');
END;

CREATE TRIGGER measure_stays BEFORE UPDATE ON measure
BEGIN
    SELECT raise(ABORT, 'the figures of a run are never changed');
END;
CREATE TRIGGER measure_is_kept BEFORE DELETE ON measure
BEGIN
    SELECT raise(ABORT, 'the figures of a run are never removed');
END;
CREATE TRIGGER measure_is_new BEFORE INSERT ON measure
WHEN (SELECT state FROM run WHERE id = NEW.run_id) IS NOT 'running'
     OR EXISTS (SELECT 1 FROM measure WHERE id = NEW.id)
BEGIN
    SELECT raise(ABORT, 'figures belong to a run that is running');
END;

CREATE TRIGGER pose_stays BEFORE UPDATE ON pose
BEGIN
    SELECT raise(ABORT, 'the poses of a run are never changed');
END;
CREATE TRIGGER pose_is_kept BEFORE DELETE ON pose
BEGIN
    SELECT raise(ABORT, 'the poses of a run are never removed');
END;
CREATE TRIGGER pose_is_new BEFORE INSERT ON pose
WHEN (SELECT state FROM run WHERE id = NEW.run_id) IS NOT 'running'
     OR EXISTS (SELECT 1 FROM pose WHERE id = NEW.id)
BEGIN
    SELECT raise(ABORT, 'poses belong to a run that is running');
END;

CREATE TRIGGER stain_batch_stays BEFORE UPDATE ON stain_batch
BEGIN
    SELECT raise(ABORT, 'the colours of a run are never changed');
END;
CREATE TRIGGER stain_batch_is_kept BEFORE DELETE ON stain_batch
BEGIN
    SELECT raise(ABORT, 'the colours of a run are never removed');
END;
CREATE TRIGGER stain_batch_is_new BEFORE INSERT ON stain_batch
WHEN (SELECT state FROM run WHERE id = NEW.run_id) IS NOT 'running'
     OR EXISTS (SELECT 1 FROM stain_batch WHERE id = NEW.id)
BEGIN
    SELECT raise(ABORT, 'colours belong to a run that is running');
END;

CREATE TRIGGER scan_is_kept BEFORE DELETE ON scan
BEGIN
    SELECT raise(ABORT, 'the ledger is never shortened');
END;
CREATE TRIGGER scan_bytes_stay BEFORE UPDATE OF id, source, name, sha256, size, arrived ON scan
BEGIN
    SELECT raise(ABORT, 'what came in is never changed');
END;
CREATE TRIGGER specimen_is_kept BEFORE DELETE ON specimen
BEGIN
    SELECT raise(ABORT, 'specimens are never removed');
END;
