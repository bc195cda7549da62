/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Volume files: MetaImage (.mhd), NRRD and INRIMAGE-4, read by our own parser.
 *
 * Method: a text header in one of three formats (volume_formats.c) becomes one description; voxels
 * are read from where it says, inflated when they are one zlib or gzip stream, brought to the
 * machine's byte order and to doubles. References: ITK MetaIO; "Definition of NRRD" (teem, G.
 * Kindlmann); INRIMAGE-4.
 *
 * Steps: (1) tell the format by its first bytes; (2) parse the header, refuse what is not supported
 * by the name of its key; (3) check every size before memory is asked for; (4) read.
 *
 * Failure: GSN_E_INPUT names the key or the size that does not agree; GSN_E_LIMIT; GSN_E_NOMEM.
 * Cost: linear in the bytes. */
#include "pipeline/decode/volume.h"

#include "pipeline/core/file.h"
#include "pipeline/decode/volume_internal.h"

#include <assert.h>
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <strings.h>

/* --- voxels --- */

#define ZLIB_CONST
#include <zlib.h>

static const size_t voxel_bytes[] = {
    [GSN_VOXEL_U8] = 1,  [GSN_VOXEL_S8] = 1,  [GSN_VOXEL_U16] = 2, [GSN_VOXEL_S16] = 2,
    [GSN_VOXEL_U32] = 4, [GSN_VOXEL_S32] = 4, [GSN_VOXEL_F32] = 4, [GSN_VOXEL_F64] = 8,
};

/* Voxels as they are stored: count of them, begin inside one of the two owned buffers. */
struct stored {
    struct gsn_volume_header header;
    uint8_t *file, *inflated;
    const uint8_t *voxels;
    size_t count;
};

static void stored_done(struct stored *stored)
{
    gsn_free(stored->file);
    gsn_free(stored->inflated);
}

static int has_ending(const char *path, const char *ending)
{
    const size_t size = strlen(path), tail = strlen(ending);

    return size > tail && strcasecmp(path + size - tail, ending) == 0;
}

static int parse_header(const char *path, struct gsn_words file, struct gsn_volume_header *header,
                        struct gsn_error *err)
{
    if (file.size >= 7 && memcmp(file.at, "NRRD000", 7) == 0)
        return gsn_nrrd_parse(file, header, err);
    if (file.size >= 12 && memcmp(file.at, "#INRIMAGE-4#", 12) == 0)
        return gsn_inr_parse(file, header, err);
    if (has_ending(path, ".mhd") || has_ending(path, ".mha"))
        return gsn_mhd_parse(file, header, err);
    return gsn_fail(err, GSN_E_UNSUPPORTED,
                    "neither MetaImage (.mhd, .mha) nor NRRD nor INRIMAGE-4");
}

/* What every format must have stated, and what it may ask for. */
static int check_header(const struct gsn_volume_header *header, size_t limit, struct gsn_error *err)
{
    const struct gsn_lattice *at = &header->at;
    size_t bytes;

    if (at->nx == 0 || header->voxel == GSN_VOXEL_NONE)
        return gsn_fail(err, GSN_E_INPUT, "the header does not state the %s",
                        at->nx == 0 ? "sizes" : "type of a voxel");
    if (at->step_um.x <= 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "the header does not state the spacing: add it, in micrometres");
    if (header->compressed && header->from_end)
        return gsn_fail(err, GSN_E_INPUT,
                        "compressed data cannot be found from the end of their file: their length "
                        "is not that of the voxels");
    bytes = voxel_bytes[header->voxel] > 4 ? voxel_bytes[header->voxel] : 4;
    /* Each size is at most 10^6, so that two of them multiply without overflow. */
    if (at->nx * at->ny > limit / bytes / at->nz)
        return gsn_fail(err, GSN_E_LIMIT,
                        "%zu x %zu x %zu voxels need more than the limit of %zu bytes", at->nx,
                        at->ny, at->nz, limit);
    return GSN_OK;
}

/* Replaces the header's file by the data file that stands beside it. */
static int read_neighbour(const char *path, size_t limit, struct stored *stored, size_t *size,
                          struct gsn_error *err)
{
    const char *slash = strrchr(path, '/');
    const int folder = slash ? (int)(slash - path) + 1 : 0;
    gsn_auto_mem(char) beside = gsn_format("%.*s%s", folder, path, stored->header.data_file);

    if (!beside)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while reading a volume");
    gsn_free(stored->file);
    stored->file = NULL;
    return gsn_file_read(beside, limit, &stored->file, size, err);
}

static voidpf on_alloc(voidpf user, uInt count, uInt size)
{
    (void)user;
    return gsn_alloc_array(count, size);
}

static void on_free(voidpf user, voidpf memory)
{
    (void)user;
    gsn_free(memory);
}

/* zlib counts in 32 bits, so larger data go through it in pieces. */
static uInt next_piece(size_t left)
{
    return left < UINT32_MAX / 2 ? (uInt)left : UINT32_MAX / 2;
}

/* Inflates the whole stream into exactly wanted bytes; one spare byte shows that there is more. */
static int inflate_all(const uint8_t *from, size_t size, uint8_t *to, size_t wanted,
                       struct gsn_error *err)
{
    z_stream z = { .zalloc = on_alloc, .zfree = on_free, .next_in = from };
    uint8_t spare;
    size_t done = 0;
    int r = inflateInit2(&z, 15 + 32); /* zlib or gzip, whichever it is */

    if (r != Z_OK)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while inflating a volume");
    while (r == Z_OK) {
        const size_t taken = (size_t)(z.next_in - from);

        z.avail_in = next_piece(size - taken);
        z.next_out = done < wanted ? to + done : &spare;
        z.avail_out = done < wanted ? next_piece(wanted - done) : 1;
        r = inflate(&z, Z_NO_FLUSH);
        if (z.next_out == &spare + 1)
            r = Z_BUF_ERROR;
        else if (done < wanted)
            done = (size_t)(z.next_out - to);
    }
    (void)inflateEnd(&z);
    if (r == Z_MEM_ERROR)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while inflating a volume");
    if (r == Z_STREAM_END && done == wanted && (size_t)(z.next_in - from) == size)
        return GSN_OK;
    return gsn_fail(err, GSN_E_INPUT,
                    "the compressed voxels are damaged or not the %zu bytes the header asks for "
                    "(%zu came%s%s)",
                    wanted, done, z.msg ? ": " : "", z.msg ? z.msg : "");
}

/* Places stored->voxels; the data must be exactly as long as the header says. */
static int locate_voxels(struct stored *stored, size_t size, struct gsn_error *err)
{
    const struct gsn_volume_header *header = &stored->header;
    const size_t wanted = stored->count * voxel_bytes[header->voxel];
    const int counted_back = header->from_end && size >= wanted && size - wanted >= header->data_at;
    const size_t skip = counted_back ? size - wanted : header->data_at;
    const size_t left = size > skip ? size - skip : 0;

    if (!header->compressed) {
        if (left != wanted)
            return gsn_fail(err, GSN_E_INPUT,
                            "the header asks for %zu bytes of voxels, the data have %zu: one of "
                            "them is wrong",
                            wanted, left);
        stored->voxels = stored->file + skip;
        return GSN_OK;
    }
    stored->inflated = gsn_alloc(wanted);
    if (!stored->inflated)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while reading a volume");
    stored->voxels = stored->inflated;
    return inflate_all(stored->file + (left ? skip : 0), left, stored->inflated, wanted, err);
}

static void scale_lattice(struct gsn_lattice *at, double unit_um)
{
    at->step_um =
        gsn_vec3_make(unit_um * at->step_um.x, unit_um * at->step_um.y, unit_um * at->step_um.z);
    at->origin_um = gsn_vec3_make(unit_um * at->origin_um.x, unit_um * at->origin_um.y,
                                  unit_um * at->origin_um.z);
}

static int load_volume(const char *path, size_t limit, double unit_um, struct stored *stored,
                       struct gsn_error *err)
{
    struct gsn_volume_header *header = &stored->header;
    size_t size;
    int r;

    r = gsn_file_read(path, limit, &stored->file, &size, err);
    if (r < 0)
        return r;
    r = parse_header(path, (struct gsn_words){ (const char *)stored->file, size }, header, err);
    if (r >= 0)
        r = check_header(header, limit, err);
    if (r < 0) {
        (void)gsn_fail_at(err, "%s", path);
        return r;
    }
    scale_lattice(&header->at, header->unit_um > 0 ? header->unit_um : unit_um);
    if (header->data_file[0])
        r = read_neighbour(path, limit, stored, &size, err);
    if (r < 0)
        return r;
    stored->count = gsn_lattice_count(&header->at);
    r = locate_voxels(stored, size, err);
    if (r < 0)
        (void)gsn_fail_at(err, "%s", path);
    return r;
}

static uint64_t bits_at(const uint8_t *bytes, size_t size, int big_endian)
{
    uint64_t bits = 0;

    for (size_t i = 0; i < size; i++)
        bits = bits << 8 | bytes[big_endian ? i : size - 1 - i];
    return bits;
}

static double voxel_at(const struct stored *stored, size_t index)
{
    const enum gsn_voxel voxel = stored->header.voxel;
    const size_t size = voxel_bytes[voxel];
    const uint64_t bits = bits_at(stored->voxels + index * size, size, stored->header.big_endian);
    const uint32_t half = (uint32_t)bits;
    double wide;
    float narrow;

    switch (voxel) {
    case GSN_VOXEL_S8:
        return (int8_t)half;
    case GSN_VOXEL_S16:
        return (int16_t)half;
    case GSN_VOXEL_S32:
        return (int32_t)half;
    case GSN_VOXEL_F32:
        memcpy(&narrow, &half, sizeof narrow);
        return (double)narrow;
    case GSN_VOXEL_F64:
        memcpy(&wide, &bits, sizeof wide);
        return wide;
    default:
        return (double)bits;
    }
}

static int refuse_voxel(const char *path, const struct gsn_lattice *at, size_t index, double value,
                        struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT, "%s: voxel (%zu, %zu, %zu) is %g", path, index % at->nx,
                    index / at->nx % at->ny, index / at->nx / at->ny, value);
}

static int fill_grid(const char *path, const struct stored *stored, struct gsn_grid *grid,
                     struct gsn_error *err)
{
    for (size_t i = 0; i < stored->count; i++) {
        const double value = voxel_at(stored, i);

        grid->value[i] = (float)value;
        if (isinf(grid->value[i]))
            return refuse_voxel(path, &grid->at, i, value, err);
    }
    return GSN_OK;
}

static int fill_mask(const char *path, const struct stored *stored, struct gsn_mask *mask,
                     struct gsn_error *err)
{
    for (size_t i = 0; i < stored->count; i++) {
        const double value = voxel_at(stored, i);

        if (isnan(value))
            return refuse_voxel(path, &mask->at, i, value, err);
        mask->inside[i] = (uint8_t)(value > 0 || value < 0);
    }
    return GSN_OK;
}

static size_t or_default(size_t limit)
{
    return limit ? limit : (size_t)512 << 20;
}

int gsn_volume_read_grid(const char *path, size_t limit_bytes, double unit_um,
                         struct gsn_grid **ret_grid, struct gsn_error *err)
{
    __attribute__((cleanup(stored_done))) struct stored stored = { 0 };
    gsn_auto(gsn_grid) grid = NULL;
    int r;

    assert(path && ret_grid);

    r = load_volume(path, or_default(limit_bytes), unit_um, &stored, err);
    if (r < 0)
        return r;
    r = gsn_grid_new(&stored.header.at, &grid, err);
    if (r < 0)
        return r;
    r = fill_grid(path, &stored, grid, err);
    if (r < 0)
        return r;
    *ret_grid = gsn_steal(&grid);
    return GSN_OK;
}

int gsn_volume_read_mask(const char *path, size_t limit_bytes, double unit_um,
                         struct gsn_mask **ret_mask, struct gsn_error *err)
{
    __attribute__((cleanup(stored_done))) struct stored stored = { 0 };
    gsn_auto(gsn_mask) mask = NULL;
    int r;

    assert(path && ret_mask);

    r = load_volume(path, or_default(limit_bytes), unit_um, &stored, err);
    if (r < 0)
        return r;
    r = gsn_mask_new(&stored.header.at, &mask, err);
    if (r < 0)
        return r;
    r = fill_mask(path, &stored, mask, err);
    if (r < 0)
        return r;
    *ret_mask = gsn_steal(&mask);
    return GSN_OK;
}

int gsn_volume_states_unit(const char *header, size_t size)
{
    static const char *const fields[] = { "space units", "units" };
    struct gsn_words rest = { header, size }, line, key, value;

    while (gsn_words_line(&rest, &line) && line.size > 0)
        for (size_t i = 0; i < sizeof fields / sizeof fields[0]; i++)
            if (gsn_words_split(line, ":", &key, &value) && gsn_words_are(key, fields[i]))
                return 1;
    return 0;
}
