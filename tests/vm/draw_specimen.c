/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A specimen small enough for a machine in software: writes its job and two panels into the folder
 * $GIESON_SPECIMEN, under the name $GIESON_SPECIMEN_NAME. It states no region, so its report is
 * withheld: it has its panels, poses and pictures, and no figure. */
#include "tests/check.h"

#include "pipeline/core/file.h"
#include "tests/specimen/drawn_panel.h"

#include <stdlib.h>
#include <string.h>

static void write_file(const char *folder, const char *name, const void *bytes, size_t size)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", folder, name);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_file_write(path, bytes, size, &err), err);
}

TEST(a_small_specimen_is_drawn)
{
    const char *folder = getenv("GIESON_SPECIMEN"), *name = getenv("GIESON_SPECIMEN_NAME");
    gsn_auto_mem(char) job = NULL;

    CHECK(folder && name);
    job = gsn_format("{\"specimen\": \"%s\", \"px_um\": 24, \"layout\": [2, 2], \"panels\": 2, "
                     "\"transfer\": \"linear\", \"thresholds\": [0.5], "
                     "\"markers_um\": " DRAWN_MARKS_JSON "}",
                     name);
    write_file(folder, "job.json", job, strlen(job));
    for (unsigned number = 1; number <= 2; number++) {
        const struct drawn_panel panel = drawn_panel_of(number, 24, 0.6);
        gsn_auto_mem(char) file = gsn_format("P%02u.png", number);
        size_t size;
        gsn_auto_mem(uint8_t) png = drawn_panel_png(&panel, &size);

        write_file(folder, file, png, size);
    }
}
