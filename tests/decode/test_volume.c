/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include "pipeline/core/file.h"
#include "pipeline/decode/volume.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <zlib.h>

#define FOLDER GSN_SHARED "/data/volumes/"

static void need_folder(void)
{
    if (access(FOLDER, R_OK) == 0)
        return;
    gsn_check_skip("%s is not there", FOLDER);
}

/* --- files of others --- */

TEST(the_tooth_has_its_known_sum_and_count)
{
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };
    size_t above = 0;
    double sum = 0;

    need_folder();
    CHECK_OK(gsn_volume_read_grid(FOLDER "tooth.mhd", 0, 1, &grid, &err), err);
    CHECK(grid->at.nx == 140 && grid->at.ny == 120 && grid->at.nz == 161);
    CHECK_NEAR(gsn_lattice_voxel_um3(&grid->at), 1, 0);
    for (size_t i = 0; i < gsn_lattice_count(&grid->at); i++) {
        sum += (double)grid->value[i];
        above += grid->value[i] > 100;
    }
    CHECK_NEAR(sum, 68672069, 0);
    CHECK(above == 370903);
}

TEST(the_tooth_as_a_mask_is_where_it_is_not_zero)
{
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_mask) mask = NULL;
    struct gsn_error err = { 0 };
    size_t wrong = 0;

    need_folder();
    CHECK_OK(gsn_volume_read_grid(FOLDER "tooth.mhd", 0, 1, &grid, &err), err);
    CHECK_OK(gsn_volume_read_mask(FOLDER "tooth.mhd", 0, 1, &mask, &err), err);
    for (size_t i = 0; i < gsn_lattice_count(&grid->at); i++)
        wrong += grid->value[i] > 0 ? mask->inside[i] != 1 : mask->inside[i] != 0;
    CHECK(wrong == 0);
}

static double mix(double a, double b, double t)
{
    return a + t * (b - a);
}

/* The part of one cell where the trilinear field is above level, from 4 x 4 x 4 points. */
static double part_above(const struct gsn_grid *g, size_t x, size_t y, size_t z, double level)
{
    double corner[8];
    size_t above = 0;

    for (size_t c = 0; c < 8; c++)
        corner[c] =
            (double)g->value[gsn_lattice_index(&g->at, x + c % 2, y + c / 2 % 2, z + c / 4)];
    for (size_t i = 0; i < 64; i++) {
        const double u = (double)(i % 4) / 4 + 0.125, v = (double)(i / 4 % 4) / 4 + 0.125;
        const double low = mix(mix(corner[0], corner[1], u), mix(corner[2], corner[3], u), v);
        const double high = mix(mix(corner[4], corner[5], u), mix(corner[6], corner[7], u), v);

        above += mix(low, high, (double)(i / 16) / 4 + 0.125) > level;
    }
    return (double)above / 64;
}

TEST(inrimage_files_give_their_numbers)
{
    /* The eight floats of the file as od(1) prints them. */
    static const float small[8] = { 6, -2, -1, 3, -3, 1, -1, -1.4f };
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_grid) skull = NULL;
    struct gsn_error err = { 0 };
    double cells = 0;

    need_folder();
    CHECK_OK(gsn_volume_read_grid(FOLDER "small-scalar.inr", 0, 1, &grid, &err), err);
    CHECK(grid->at.nx == 2 && grid->at.ny == 2 && grid->at.nz == 2);
    CHECK_NEAR(grid->at.step_um.y, 100, 0);
    for (size_t i = 0; i < 8; i++)
        CHECK_NEAR(grid->value[i], small[i], 0);
    CHECK_OK(gsn_volume_read_grid(FOLDER "skull_2.9.inr", 0, 1, &skull, &err), err);
    CHECK(gsn_lattice_count(&skull->at) == 64 * 64 * 64);
    CHECK_NEAR(skull->at.step_um.x, 3.94305, 1e-15);
    CHECK_NEAR(skull->at.step_um.z, 3.65079, 1e-15);
    for (size_t i = 0; i < 63 * 63 * 63; i++)
        cells += part_above(skull, i % 63, i / 63 % 63, i / 63 / 63, 2.9);
    /* The published volume of the trilinear field above 2.9, in mm3. */
    CHECK_NEAR(cells * gsn_lattice_voxel_um3(&skull->at), 1241328, 0.001 * 1241328);
}

/* --- files made here --- */

struct room {
    char folder[64], path[128];
};

static struct room room_new(void)
{
    struct room room = { .folder = "/tmp/gsn_volume_XXXXXX" };

    CHECK(mkdtemp(room.folder) != NULL);
    return room;
}

static void room_done(struct room *room)
{
    static const char *const names[] = { "v.mhd", "v.mha", "v.nrrd", "v.nhdr",
                                         "v.inr", "v.raw", "v.txt" };
    char path[128];

    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        (void)snprintf(path, sizeof path, "%s/%s", room->folder, names[i]);
        (void)unlink(path);
    }
    (void)rmdir(room->folder);
}
#define auto_room __attribute__((cleanup(room_done))) struct room

/* Writes a header and, behind it, data; remembers the path in the room. */
static void put(struct room *room, const char *name, const char *header, const void *data,
                size_t size)
{
    const size_t head = strlen(header);
    gsn_auto_mem(uint8_t) all = gsn_alloc(head + size);
    struct gsn_error err = { 0 };

    CHECK(all);
    memcpy(all, header, head);
    memcpy(all + head, data, size);
    (void)snprintf(room->path, sizeof room->path, "%s/%s", room->folder, name);
    CHECK_OK(gsn_file_write(room->path, all, head + size, &err), err);
}

static void check_counting(const struct room *room, double first, double step)
{
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_volume_read_grid(room->path, 0, 1, &grid, &err), err);
    CHECK(grid->at.nx == 3 && grid->at.ny == 2 && grid->at.nz == 1);
    CHECK_NEAR(grid->at.step_um.x, 1.5, 0);
    CHECK_NEAR(grid->at.step_um.y, 2, 0);
    CHECK_NEAR(grid->at.step_um.z, 24, 0);
    CHECK_NEAR(grid->at.origin_um.x, 10, 0);
    CHECK_NEAR(grid->at.origin_um.y, -20.25, 0);
    CHECK_NEAR(grid->at.origin_um.z, 0, 0);
    for (size_t i = 0; i < 6; i++)
        CHECK_NEAR(grid->value[i], first + (double)i * step, 0);
}

#define MHD                                                                                        \
    "ObjectType = Image\nNDims = 3\nDimSize = 3 2 1\nElementSpacing = 1.5 2 2.4e1\n"               \
    "Offset = 10 -20.25 0\n"

static const uint8_t bytes6[] = { 0, 1, 2, 3, 4, 5 };
static const uint8_t big6[] = { 0xff, 0xfe, 0xff, 0xff, 0, 0, 0, 1, 0, 2, 0, 3 };
static const uint8_t little6[] = { 0xfe, 0xff, 0xff, 0xff, 0, 0, 1, 0, 2, 0, 3, 0 };
static const float float6[] = { 0.5f, 1, 1.5f, 2, 2.5f, 3 };
static const double double6[] = { -3, -2, -1, 0, 1, 2 };

TEST(metaimages_are_read_in_every_type_local_or_beside)
{
    auto_room room = room_new();

    put(&room, "v.mha", MHD "ElementType = MET_UCHAR\nElementDataFile = LOCAL\n", bytes6, 6);
    check_counting(&room, 0, 1);
    put(&room, "v.mha",
        MHD "ElementType = MET_SHORT\nElementByteOrderMSB = True\nElementDataFile = LOCAL\n", big6,
        12);
    check_counting(&room, -2, 1);
    put(&room, "v.raw", "head", float6, sizeof float6);
    put(&room, "v.mhd", MHD "ElementType = MET_FLOAT\nHeaderSize = 4\nElementDataFile = v.raw\n",
        "", 0);
    check_counting(&room, 0.5, 0.5);
    put(&room, "v.mhd", MHD "ElementType = MET_FLOAT\nHeaderSize = -1\nElementDataFile = v.raw\r\n",
        "", 0);
    check_counting(&room, 0.5, 0.5);
    put(&room, "v.mha",
        MHD "BinaryDataByteOrderMSB = False\nElementType = MET_DOUBLE\nElementDataFile = LOCAL\n",
        double6, sizeof double6);
    check_counting(&room, -3, 1);
    put(&room, "v.mha",
        MHD
        "TransformMatrix = 1 0 0 0 1 0 0 0 1\nElementType = MET_SHORT\nElementDataFile = LOCAL\n",
        little6, 12);
    check_counting(&room, -2, 1);
}

#define NRRD                                                                                       \
    "NRRD0004\n# a comment: with a colon\nkey:=value: of ours\ndimension: 3\nsizes: 3 2 1\n"       \
    "space directions: (1.5,0,0) (0,2,0) (0,0,24)\nspace origin: (10,-20.25,0)\n"

static size_t gzipped(const void *from, size_t size, int bits, uint8_t room[256])
{
    z_stream z = { .next_in = (Bytef *)(uintptr_t)from, .avail_in = (uInt)size };

    z.next_out = room;
    z.avail_out = 256;
    CHECK(deflateInit2(&z, 9, Z_DEFLATED, bits, 8, Z_DEFAULT_STRATEGY) == Z_OK);
    CHECK(deflate(&z, Z_FINISH) == Z_STREAM_END);
    CHECK(deflateEnd(&z) == Z_OK);
    return 256 - z.avail_out;
}

TEST(nrrds_are_read_attached_detached_raw_and_gzipped)
{
    auto_room room = room_new();
    uint8_t packed[256];
    size_t size;

    put(&room, "v.nrrd", NRRD "type: unsigned char\nencoding: raw\n\n", bytes6, 6);
    check_counting(&room, 0, 1);
    put(&room, "v.nrrd", NRRD "type: short\nencoding: raw\nendian: big\n\n", big6, 12);
    check_counting(&room, -2, 1);
    size = gzipped(little6, 12, 15 + 16, packed);
    put(&room, "v.nrrd", NRRD "type: int16\nencoding: gzip\nendian: little\n\n", packed, size);
    check_counting(&room, -2, 1);
    put(&room, "v.raw", "", packed, size);
    put(&room, "v.nhdr", NRRD "type: int16\nencoding: gz\nendian: little\ndata file: v.raw\n", "",
        0);
    check_counting(&room, -2, 1);
    size = gzipped(float6, sizeof float6, 15, packed);
    put(&room, "v.mha",
        MHD "ElementType = MET_FLOAT\nCompressedData = True\nElementDataFile = LOCAL\n", packed,
        size);
    check_counting(&room, 0.5, 0.5);
    put(&room, "v.nrrd", NRRD "type: double\nencoding: raw\nendian: little\nbyte skip: -1\n\nxyz",
        double6, sizeof double6);
    check_counting(&room, -3, 1);
    put(&room, "v.nrrd",
        NRRD "type: uchar\nencoding: raw\nspace units: \"um\" \"microns\" \"\xc2\xb5m\"\n\n",
        bytes6, 6);
    check_counting(&room, 0, 1);
}

TEST(lengths_are_micrometres_by_the_header_else_by_the_caller)
{
    static const char axes[] =
        "NRRD0004\ndimension: 3\nsizes: 3 2 1\ntype: uchar\nencoding: raw\nspacings: 0.05 0.04 "
        "0.024\n";
    static const char metaimage[] =
        "NDims = 3\nDimSize = 3 2 1\nElementSpacing = 0.05 0.04 0.024\nOffset = 1 2 3\n"
        "ElementType = MET_UCHAR\nElementDataFile = LOCAL\n";
    static const struct {
        const char *name, *header, *more;
        double unit_um, wanted; /* of the first spacing */
        int states;
    } cases[] = {
        { "v.mha", metaimage, "", 1, 0.05, 0 },
        { "v.mha", metaimage, "", 1000, 50, 0 },
        { "v.nrrd", axes, "\n", 1000, 50, 0 },
        { "v.nrrd", axes, "units: \"mm\" \"mm\" \"mm\"\n\n", 1, 50, 1 },
        { "v.nrrd", axes, "units: \"um\" \"um\" \"um\"\n\n", 1000, 0.05, 1 },
    };
    auto_room room = room_new();
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        gsn_auto_mem(char) header = gsn_format("%s%s", cases[i].header, cases[i].more);
        gsn_auto(gsn_grid) grid = NULL;

        put(&room, cases[i].name, header, "123456", 6);
        CHECK_OK(gsn_volume_read_grid(room.path, 0, cases[i].unit_um, &grid, &err), err);
        CHECK_NEAR(grid->at.step_um.x, cases[i].wanted, 1e-12);
        CHECK_NEAR(grid->at.step_um.z, cases[i].wanted * 0.48, 1e-12);
        if (strcmp(cases[i].name, "v.mha") == 0)
            CHECK_NEAR(grid->at.origin_um.y, 2 * cases[i].unit_um, 1e-12);
        CHECK(gsn_volume_states_unit(header, strlen(header)) == cases[i].states);
    }
}

TEST(an_inrimage_of_bytes_is_read)
{
    static const char fields[] =
        "#INRIMAGE-4#{\nXDIM=3\nYDIM=2\nZDIM=1\nVDIM=1\nTYPE=unsigned fixed\n"
        "PIXSIZE=8 bits\nCPU=sun\nVX=1.5\nVY=2\nVZ=24\nTX=10\nTY=-20.25\n"
        "TZ=0\n";
    auto_room room = room_new();
    char header[257] = { 0 };

    memset(header, '\n', 256);
    memcpy(header, fields, sizeof fields - 1);
    memcpy(header + 252, "##}\n", 4);
    put(&room, "v.inr", header, bytes6, 6);
    check_counting(&room, 0, 1);
}

TEST(a_mask_is_one_wherever_the_voxel_is_not_zero)
{
    auto_room room = room_new();
    gsn_auto(gsn_mask) mask = NULL;
    struct gsn_error err = { 0 };

    put(&room, "v.mha", MHD "ElementType = MET_DOUBLE\nElementDataFile = LOCAL\n", double6,
        sizeof double6);
    CHECK_OK(gsn_volume_read_mask(room.path, 0, 1, &mask, &err), err);
    CHECK(memcmp(mask->inside, (uint8_t[]){ 1, 1, 1, 0, 1, 1 }, 6) == 0);
}

/* --- refusals --- */

static void check_refused_at(const struct room *room, int code, const char *words, int line)
{
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };
    const int r = gsn_volume_read_grid(room->path, 0, 1, &grid, &err);

    if (r != code || !strstr(err.text, words) || grid) {
        print_error("%d \"%s\", should be %d \"%s\"\n", r, err.text, code, words);
        _fail(__FILE__, line);
    }
}
#define check_refused(room, code, words) check_refused_at(room, code, words, __LINE__)

TEST(a_header_that_contradicts_its_data_is_refused)
{
    auto_room room = room_new();
    uint8_t packed[256];
    size_t size = gzipped(little6, 12, 15 + 16, packed);

    put(&room, "v.mha", MHD "ElementType = MET_UCHAR\nElementDataFile = LOCAL\n", bytes6, 5);
    check_refused(&room, GSN_E_INPUT, "asks for 6 bytes of voxels, the data have 5");
    put(&room, "v.mha", MHD "ElementType = MET_UCHAR\nElementDataFile = LOCAL\n", big6, 7);
    check_refused(&room, GSN_E_INPUT, "asks for 6 bytes of voxels, the data have 7");
    put(&room, "v.nrrd", NRRD "type: uchar\nencoding: raw\nbyte skip: -1\n\n", bytes6, 5);
    check_refused(&room, GSN_E_INPUT, "asks for 6 bytes of voxels, the data have 5");
    put(&room, "v.nrrd", NRRD "type: uchar\nencoding: gzip\n\n", packed, size);
    check_refused(&room, GSN_E_INPUT, "not the 6 bytes the header asks for");
    put(&room, "v.nrrd", NRRD "type: int\nencoding: gzip\nendian: little\n\n", packed, size);
    check_refused(&room, GSN_E_INPUT, "not the 24 bytes the header asks for");
    put(&room, "v.nrrd", NRRD "type: short\nencoding: gzip\nendian: little\n\n", packed, size - 1);
    check_refused(&room, GSN_E_INPUT, "not the 12 bytes the header asks for");
    packed[size] = 0;
    put(&room, "v.nrrd", NRRD "type: short\nencoding: gzip\nendian: little\n\n", packed, size + 1);
    check_refused(&room, GSN_E_INPUT, "not the 12 bytes the header asks for");
    packed[size - 8] ^= 1; /* the checksum of gzip */
    put(&room, "v.nrrd", NRRD "type: short\nencoding: gzip\nendian: little\n\n", packed, size);
    check_refused(&room, GSN_E_INPUT, "incorrect data check");
}

TEST(what_a_header_leaves_open_is_refused_by_name)
{
    auto_room room = room_new();

    put(&room, "v.mha",
        "NDims = 3\nDimSize = 3 2 1\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n", bytes6,
        6);
    check_refused(&room, GSN_E_INPUT, "does not state the spacing");
    put(&room, "v.mha", MHD "ElementDataFile = LOCAL\n", bytes6, 6);
    check_refused(&room, GSN_E_INPUT, "does not state the type of a voxel");
    put(&room, "v.mha", MHD "ElementType = MET_UCHAR\n", bytes6, 6);
    check_refused(&room, GSN_E_INPUT, "without ElementDataFile");
    put(&room, "v.nrrd", NRRD "type: short\nencoding: raw\n\n", big6, 12);
    check_refused(&room, GSN_E_INPUT, "without endian");
    put(&room, "v.nrrd", NRRD "type: uchar\n\n", bytes6, 6);
    check_refused(&room, GSN_E_INPUT, "without encoding");
}

TEST(what_is_not_read_is_refused_by_name)
{
    auto_room room = room_new();

    put(&room, "v.mha", MHD "TransformMatrix = 0 1 0 1 0 0 0 0 1\nElementDataFile = LOCAL\n", "",
        0);
    check_refused(&room, GSN_E_UNSUPPORTED, "axes are turned");
    put(&room, "v.mha", MHD "ElementType = MET_LONG\nElementDataFile = LOCAL\n", "", 0);
    check_refused(&room, GSN_E_UNSUPPORTED, "ElementType MET_LONG");
    put(&room, "v.mha", "NDims = 2\nElementDataFile = LOCAL\n", "", 0);
    check_refused(&room, GSN_E_UNSUPPORTED, "NDims = 2");
    put(&room, "v.mha", "DimSize = 3 2.5 1\nElementDataFile = LOCAL\n", "", 0);
    check_refused(&room, GSN_E_INPUT, "size 2 is 2.5");
    put(&room, "v.mha", "ElementSpacing = 1 -1 1\nElementDataFile = LOCAL\n", "", 0);
    check_refused(&room, GSN_E_INPUT, "spacing \"1 -1 1\"");
    put(&room, "v.mha", "ElementSpacing = 1 1e999 1\nElementDataFile = LOCAL\n", "", 0);
    check_refused(&room, GSN_E_INPUT, "spacing");
    put(&room, "v.nrrd", NRRD "space units: \"mm\" \"um\" \"mm\"\n\n", "", 0);
    check_refused(&room, GSN_E_UNSUPPORTED, "units \"um\" are not read");
    put(&room, "v.nrrd", NRRD "space units: \"m\" \"m\" \"m\"\n\n", "", 0);
    check_refused(&room, GSN_E_UNSUPPORTED, "units \"m\" are not read");
    put(&room, "v.nrrd", NRRD "encoding: bzip2\n\n", "", 0);
    check_refused(&room, GSN_E_UNSUPPORTED, "encoding bzip2");
    put(&room, "v.nrrd", "NRRD0004\nspace directions: (1,1,0) (0,1,0) (0,0,1)\n\n", "", 0);
    check_refused(&room, GSN_E_UNSUPPORTED, "axes are turned");
    put(&room, "v.inr", "#INRIMAGE-4#{\nXDIM=3\n", "", 0);
    check_refused(&room, GSN_E_INPUT, "its header does not end");
    put(&room, "v.txt", "hello", "", 0);
    check_refused(&room, GSN_E_UNSUPPORTED, "neither MetaImage");
}

TEST(a_header_cannot_reach_for_files_elsewhere)
{
    static const char *const names[] = { "/etc/passwd", "../v.raw", ".", "" };
    auto_room room = room_new();
    char header[512];

    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        (void)snprintf(header, sizeof header, MHD "ElementType = MET_UCHAR\nElementDataFile = %s\n",
                       names[i]);
        put(&room, "v.mhd", header, "", 0);
        check_refused(&room, GSN_E_INPUT, "is not a plain name");
    }
    put(&room, "v.mhd", MHD "ElementType = MET_UCHAR\nElementDataFile = none.raw\n", "", 0);
    check_refused(&room, GSN_E_NOTFOUND, "none.raw");
}

TEST(infinity_is_refused_and_a_mask_has_no_nan)
{
    static const float odd[6] = { 1, 2, NAN, 4, 5, 6 };
    static const float infinite[6] = { 1, 2, 3, INFINITY, 5, 6 };
    auto_room room = room_new();
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_mask) mask = NULL;
    struct gsn_error err = { 0 };

    put(&room, "v.mha", MHD "ElementType = MET_FLOAT\nElementDataFile = LOCAL\n", infinite,
        sizeof infinite);
    check_refused(&room, GSN_E_INPUT, "voxel (0, 1, 0) is inf");
    put(&room, "v.mha", MHD "ElementType = MET_FLOAT\nElementDataFile = LOCAL\n", odd, sizeof odd);
    CHECK_OK(gsn_volume_read_grid(room.path, 0, 1, &grid, &err), err);
    CHECK_NEAR((double)isnan(grid->value[2]), 1, 0);
    CHECK(gsn_volume_read_mask(room.path, 0, 1, &mask, &err) == GSN_E_INPUT);
    CHECK(mask == NULL);
}

TEST(the_limit_holds_before_anything_is_allocated)
{
    auto_room room = room_new();
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };

    put(&room, "v.mha",
        "NDims = 3\nDimSize = 1000000 1000000 1000000\nElementSpacing = 1 1 1\n"
        "ElementType = MET_UCHAR\nElementDataFile = LOCAL\n",
        bytes6, 6);
    check_refused(&room, GSN_E_LIMIT, "1000000 x 1000000 x 1000000 voxels");
    put(&room, "v.mha", MHD "ElementType = MET_UCHAR\nElementDataFile = LOCAL\n", bytes6, 6);
    CHECK(gsn_volume_read_grid(room.path, 23, 1, &grid, &err) == GSN_E_LIMIT);
    CHECK(grid == NULL);
}

static int read_once(const struct room *room, struct gsn_error *err)
{
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_mask) mask = NULL;
    const int r = gsn_volume_read_grid(room->path, 0, 1, &grid, err);

    return r < 0 ? r : gsn_volume_read_mask(room->path, 0, 1, &mask, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    auto_room room = room_new();
    struct gsn_error err = { 0 };
    uint8_t packed[256];
    const size_t size = gzipped(little6, 12, 15 + 16, packed);

    put(&room, "v.raw", "", packed, size);
    put(&room, "v.nhdr", NRRD "type: int16\nencoding: gz\nendian: little\ndata file: v.raw\n", "",
        0);
    CHECK_EVERY_OOM(read_once(&room, &err), err);
}
