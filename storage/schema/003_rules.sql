-- SPDX-License-Identifier: AGPL-3.0-or-later
-- The same rules in other words. SQLite fills a table of its own with the values of x IN (...) when
-- there are more than two, for every row it checks: five times for each scan, and dearer than all
-- that the scan writes. A chain of OR compares. The rows stay as they are, so only the text of the
-- rules changes, the way SQLite's documentation of ALTER TABLE describes.

PRAGMA writable_schema = ON;
UPDATE sqlite_schema SET sql = replace(sql,
    'kind IN (''sections'', ''volume'', ''tile'')',
    'kind = ''sections'' OR kind = ''volume'' OR kind = ''tile''')
WHERE type = 'table' AND name = 'specimen';
UPDATE sqlite_schema SET sql = replace(sql,
    'state IN (''waiting'', ''registered'', ''refused'', ''held'')',
    'state = ''waiting'' OR state = ''registered'' OR state = ''refused'' OR state = ''held''')
WHERE type = 'table' AND name = 'panel';
UPDATE sqlite_schema SET sql = replace(sql,
    'state IN (''found'', ''empty'', ''needs-eye'', ''missing'', ''held'')',
    'state = ''found'' OR state = ''empty'' OR state = ''needs-eye'' OR state = ''missing'' OR state = ''held''')
WHERE type = 'table' AND name = 'section';
UPDATE sqlite_schema SET sql = replace(sql,
    'state IN (''waiting'', ''running'', ''done'', ''failed'')',
    'state = ''waiting'' OR state = ''running'' OR state = ''done'' OR state = ''failed''')
WHERE type = 'table' AND name = 'job';
UPDATE sqlite_schema SET sql = replace(sql,
    'state IN (''running'', ''reported'', ''withheld'', ''failed'')',
    'state = ''running'' OR state = ''reported'' OR state = ''withheld'' OR state = ''failed''')
WHERE type = 'table' AND name = 'run';
UPDATE sqlite_schema SET sql = replace(sql,
    'state IN (''away'', ''ready'', ''receiving'', ''paused'', ''failed'', ''off'')',
    'state = ''away'' OR state = ''ready'' OR state = ''receiving'' OR state = ''paused'' OR state = ''failed'' OR state = ''off''')
WHERE type = 'table' AND name = 'source';
UPDATE sqlite_schema SET sql = replace(sql,
    'subject IN (''panel'', ''blank'', ''dark'')',
    'subject = ''panel'' OR subject = ''blank'' OR subject = ''dark''')
WHERE type = 'table' AND name = 'scan';
UPDATE sqlite_schema SET sql = replace(sql,
    'state IN (''filed'', ''unfiled'', ''kept'')',
    'state = ''filed'' OR state = ''unfiled'' OR state = ''kept''')
WHERE type = 'table' AND name = 'scan';
UPDATE sqlite_schema SET sql = replace(sql,
    'kind IN (''capture-panel'', ''capture-blank'', ''capture-dark'')',
    'kind = ''capture-panel'' OR kind = ''capture-blank'' OR kind = ''capture-dark''')
WHERE type = 'table' AND name = 'request';
UPDATE sqlite_schema SET sql = replace(sql,
    'state IN (''waiting'', ''done'', ''refused'')',
    'state = ''waiting'' OR state = ''done'' OR state = ''refused''')
WHERE type = 'table' AND name = 'request';
PRAGMA writable_schema = RESET;
