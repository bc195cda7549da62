/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Any bytes as a volume file: by each of the three header readers, and as a whole file through the
 * door that the worker uses. What is read has as many finite or missing voxels as its lattice says;
 * what is refused leaves the outputs alone and says why. */
#include "pipeline/decode/volume.h"

#include <math.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/decode/volume_internal.h"
#include "tests/fuzz/hold.h"

enum { MOST_BYTES = 1 << 20 };

typedef int parse(struct gsn_words file, struct gsn_volume_header *header, struct gsn_error *err);

static void read_header(parse *format, const uint8_t *bytes, size_t size)
{
    struct gsn_volume_header header = { .data_at = 0 };
    struct gsn_error err = { 0 };
    const int r = format((struct gsn_words){ (const char *)bytes, size }, &header, &err);

    if (r < 0)
        HOLD(err.code == r && err.text[0]);
    else
        HOLD(memchr(header.data_file, '\0', sizeof header.data_file));
}

/* A name of its own for each process; the ending counts for one format. */
static const char *write_file(const uint8_t *bytes, size_t size)
{
    static char path[64];
    FILE *file;

    (void)snprintf(path, sizeof path, "/dev/shm/gieson-fuzz-%ld.mha", (long)getpid());
    file = fopen(path, "wb"); /* door */
    if (!file)
        return NULL;
    HOLD(fwrite(bytes, 1, size, file) == size && fclose(file) == 0);
    return path;
}

static void read_file(const char *path)
{
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_mask) mask = NULL;
    struct gsn_error err = { 0 };
    int r = gsn_volume_read_grid(path, MOST_BYTES, 1, &grid, &err);

    HOLD((r >= 0) == (grid != NULL) && (r >= 0 || (err.code == r && err.text[0])));
    for (size_t i = 0; grid && i < gsn_lattice_count(&grid->at); i++)
        HOLD(!isinf(grid->value[i]));
    r = gsn_volume_read_mask(path, MOST_BYTES, 1, &mask, &err);
    HOLD((r >= 0) == (mask != NULL) && (r >= 0 || (err.code == r && err.text[0])));
    for (size_t i = 0; mask && i < gsn_lattice_count(&mask->at); i++)
        HOLD(mask->inside[i] <= 1);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    const char *path;

    read_header(gsn_mhd_parse, bytes, size);
    read_header(gsn_nrrd_parse, bytes, size);
    read_header(gsn_inr_parse, bytes, size);
    path = write_file(bytes, size);
    if (path) {
        read_file(path);
        (void)unlink(path);
    }
    return 0;
}
