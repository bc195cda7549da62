/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: a head and the floats behind it as they lie in memory; gzip by zlib, without a time.
 * Reference: Kindlmann, "Definition of NRRD File Format" (NRRD0004); Cox and others, "nifti1.h"
 * (2004), the one-file variant "n+1" with an sform.
 * Failure: memory, and what NIfTI's 16-bit sizes cannot hold. Cost: the file's size in memory,
 * twice with gzip. */
#include "pipeline/export/volume_file.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

#include <zlib.h>

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "numbers are written as they lie");

enum {
    NIFTI_HEAD = 352, /* of 348 bytes and 4 that say that no more heads follow */
    NIFTI_FLOAT = 16,
    NIFTI_MICROMETRES = 3,
    NIFTI_ALIGNED = 2, /* coordinates of some other frame, not of a scanner */
    GZIP_WINDOW = 15 + 16,
    GZIP_LEVEL = 6
};

static int put_together(const void *head, size_t head_size, const struct gsn_grid *grid,
                        uint8_t **ret_bytes, size_t *ret_size, struct gsn_error *err)
{
    const size_t voxels = gsn_lattice_count(&grid->at) * sizeof *grid->value;
    uint8_t *bytes = gsn_alloc(head_size + voxels);

    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a volume of %zu bytes", voxels);
    memcpy(bytes, head, head_size);
    memcpy(bytes + head_size, grid->value, voxels);
    *ret_bytes = bytes;
    *ret_size = head_size + voxels;
    return GSN_OK;
}

int gsn_nrrd_write(const struct gsn_grid *grid, uint8_t **ret_bytes, size_t *ret_size,
                   struct gsn_error *err)
{
    const struct gsn_lattice *at = &grid->at;
    char head[640];
    const int length =
        snprintf(head, sizeof head,
                 "NRRD0004\n# density; NaN: no data\ntype: float\nendian: little\ndimension: 3\n"
                 "space dimension: 3\nsizes: %zu %zu %zu\n"
                 "space directions: (%.17g,0,0) (0,%.17g,0) (0,0,%.17g)\n"
                 "space origin: (%.17g,%.17g,%.17g)\nspace units: \"um\" \"um\" \"um\"\n"
                 "kinds: domain domain domain\nencoding: raw\n\n",
                 at->nx, at->ny, at->nz, at->step_um.x, at->step_um.y, at->step_um.z,
                 at->origin_um.x, at->origin_um.y, at->origin_um.z);

    assert(ret_bytes && ret_size);

    return put_together(head, (size_t)length, grid, ret_bytes, ret_size, err);
}

static void put_short(uint8_t *head, size_t at, int16_t value)
{
    memcpy(head + at, &value, sizeof value);
}

static void put_float(uint8_t *head, size_t at, double value)
{
    const float narrow = (float)value;

    memcpy(head + at, &narrow, sizeof narrow);
}

/* Places are those of nifti1.h; what is not set is 0. */
static void fill_nifti(const struct gsn_lattice *at, uint8_t head[NIFTI_HEAD])
{
    const double step[3] = { at->step_um.x, at->step_um.y, at->step_um.z };
    const double origin[3] = { at->origin_um.x, at->origin_um.y, at->origin_um.z };
    const int16_t dim[8] = { 3, (int16_t)at->nx, (int16_t)at->ny, (int16_t)at->nz, 1, 1, 1, 1 };
    const int32_t size = 348;

    memset(head, 0, NIFTI_HEAD);
    memcpy(head, &size, sizeof size);
    memcpy(head + 40, dim, sizeof dim);
    put_short(head, 70, NIFTI_FLOAT);
    put_short(head, 72, 32); /* bits a voxel */
    put_float(head, 76, 1);  /* handedness of the qform, which is not used */
    for (size_t c = 0; c < 3; c++) {
        put_float(head, 80 + 4 * c, step[c]);
        put_float(head, 280 + 16 * c + 4 * c, step[c]);
        put_float(head, 280 + 16 * c + 12, origin[c]);
    }
    put_float(head, 108, NIFTI_HEAD); /* where the voxels begin */
    put_float(head, 112, 1);          /* value = 1 x voxel + 0 */
    head[123] = NIFTI_MICROMETRES;
    memcpy(head + 148, "gieson: density, NaN: no data", 29);
    put_short(head, 254, NIFTI_ALIGNED);
    memcpy(head + 344, "n+1", 4);
}

static int compress_bytes(const uint8_t *bytes, size_t size, uint8_t **ret_bytes, size_t *ret_size,
                          struct gsn_error *err)
{
    z_stream stream = { .next_in = (Bytef *)(uintptr_t)bytes };
    gsn_auto_mem(uint8_t) out = NULL;
    size_t room, left_in = size, left_out;
    int r = deflateInit2(&stream, GZIP_LEVEL, Z_DEFLATED, GZIP_WINDOW, 8, Z_DEFAULT_STRATEGY);

    if (r != Z_OK)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for zlib");
    room = left_out = deflateBound(&stream, size);
    out = gsn_alloc(room);
    stream.next_out = out;
    /* Its counts are of 32 bits. */
    while (out && r == Z_OK) {
        stream.avail_in = left_in > UINT32_MAX ? UINT32_MAX : (uInt)left_in;
        stream.avail_out = left_out > UINT32_MAX ? UINT32_MAX : (uInt)left_out;
        left_in -= stream.avail_in;
        left_out -= stream.avail_out;
        r = deflate(&stream, left_in ? Z_NO_FLUSH : Z_FINISH);
        left_in += stream.avail_in;
        left_out += stream.avail_out;
    }
    (void)deflateEnd(&stream);
    if (!out || r != Z_STREAM_END)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a compressed volume");
    *ret_bytes = gsn_steal(&out);
    *ret_size = room - left_out;
    return GSN_OK;
}

int gsn_nifti_write(const struct gsn_grid *grid, int gzip, uint8_t **ret_bytes, size_t *ret_size,
                    struct gsn_error *err)
{
    const struct gsn_lattice *at = &grid->at;
    gsn_auto_mem(uint8_t) bytes = NULL;
    uint8_t head[NIFTI_HEAD];
    size_t size = 0;
    int r;

    assert(ret_bytes && ret_size);

    if (at->nx > INT16_MAX || at->ny > INT16_MAX || at->nz > INT16_MAX)
        return gsn_fail(err, GSN_E_LIMIT,
                        "NIfTI holds at most %d voxels along an axis, not %zu x %zu x %zu: write "
                        "a .nrrd",
                        INT16_MAX, at->nx, at->ny, at->nz);
    fill_nifti(at, head);
    r = put_together(head, sizeof head, grid, &bytes, &size, err);
    if (r >= 0 && gzip)
        return compress_bytes(bytes, size, ret_bytes, ret_size, err);
    if (r < 0)
        return r;
    *ret_bytes = gsn_steal(&bytes);
    *ret_size = size;
    return GSN_OK;
}
