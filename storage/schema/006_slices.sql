-- SPDX-License-Identifier: AGPL-3.0-or-later
-- A slice is one row on one page: its three marks stand in it, and its id says panel and slot, so
-- that the rows of a panel lie side by side and no slot is there twice, without an index. Logging a
-- panel wrote five pages before, and now it writes one or two. A mark that was not found has no
-- place: its columns are NULL.

CREATE TABLE slice (
    id INTEGER PRIMARY KEY CHECK (id = panel_id * 4096 + slot),
    panel_id INTEGER NOT NULL REFERENCES panel,
    slot INTEGER NOT NULL CHECK (slot >= 1 AND slot < 4096),
    serial INTEGER NOT NULL CHECK (serial >= 0),
    state TEXT NOT NULL CHECK (state = 'found' OR state = 'empty' OR state = 'needs-eye'
                               OR state = 'missing' OR state = 'held'),
    flags TEXT NOT NULL,
    bbox_x REAL,
    bbox_y REAL,
    bbox_w REAL,
    bbox_h REAL,
    area_px REAL,
    mark1_x_px REAL,
    mark1_y_px REAL,
    mark1_radius_px REAL,
    mark1_cov_xx REAL,
    mark1_cov_xy REAL,
    mark1_cov_yy REAL,
    mark1_score REAL,
    mark2_x_px REAL,
    mark2_y_px REAL,
    mark2_radius_px REAL,
    mark2_cov_xx REAL,
    mark2_cov_xy REAL,
    mark2_cov_yy REAL,
    mark2_score REAL,
    mark3_x_px REAL,
    mark3_y_px REAL,
    mark3_radius_px REAL,
    mark3_cov_xx REAL,
    mark3_cov_xy REAL,
    mark3_cov_yy REAL,
    mark3_score REAL
) STRICT;

INSERT INTO slice
SELECT s.panel_id * 4096 + s.slot, s.panel_id, s.slot, s.serial, s.state, s.flags, s.bbox_x, s.bbox_y, s.bbox_w, s.bbox_h,
       s.area_px,
       a.x_px, a.y_px, a.radius_px, a.cov_xx, a.cov_xy, a.cov_yy, a.score,
       b.x_px, b.y_px, b.radius_px, b.cov_xx, b.cov_xy, b.cov_yy, b.score,
       c.x_px, c.y_px, c.radius_px, c.cov_xx, c.cov_xy, c.cov_yy, c.score
FROM section s
LEFT JOIN marker a ON a.section_id = s.id AND a.mark = 1
LEFT JOIN marker b ON b.section_id = s.id AND b.mark = 2
LEFT JOIN marker c ON c.section_id = s.id AND c.mark = 3;

DROP TABLE marker;
DROP TABLE section;
ALTER TABLE slice RENAME TO section;

-- One row a mark, for who reads the store with other programs.
CREATE VIEW marker (panel_id, slot, mark, x_px, y_px, radius_px, cov_xx, cov_xy, cov_yy, score) AS
SELECT panel_id, slot, 1, mark1_x_px, mark1_y_px, mark1_radius_px, mark1_cov_xx, mark1_cov_xy,
       mark1_cov_yy, mark1_score FROM section WHERE mark1_x_px IS NOT NULL
UNION ALL
SELECT panel_id, slot, 2, mark2_x_px, mark2_y_px, mark2_radius_px, mark2_cov_xx, mark2_cov_xy,
       mark2_cov_yy, mark2_score FROM section WHERE mark2_x_px IS NOT NULL
UNION ALL
SELECT panel_id, slot, 3, mark3_x_px, mark3_y_px, mark3_radius_px, mark3_cov_xx, mark3_cov_xy,
       mark3_cov_yy, mark3_score FROM section WHERE mark3_x_px IS NOT NULL;
