/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Files for other programs: what libtiff and zlib read in them, laws and limits. VTK and numpy read
 * the others in tests/ui/test_model.py. */
#include "pipeline/export/cells_file.h"
#include "pipeline/export/ome_tiff.h"
#include "pipeline/export/surface_file.h"
#include "pipeline/export/volume_file.h"

#include "pipeline/core/file.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <tiffio.h>

#include "tests/check.h"
#include "tests/measure/kuhn.h"

static const struct gsn_lattice AT = {
    .nx = 70, .ny = 131, .nz = 3, .origin_um = { -528, 12.5, 84 }, .step_um = { 16, 16, 24 }
};

static struct gsn_colour_grid *draw_stack(void)
{
    struct gsn_colour_grid *stack = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_colour_grid_new(&AT, &stack, &err), err);
    for (size_t i = 0; i < 3 * gsn_lattice_count(&AT); i++)
        stack->rgb[i] = (uint8_t)(i * i / 7 + i);
    return stack;
}

TEST(a_stack_is_pages_of_the_same_pixels_and_says_where_they_lie)
{
    gsn_auto(gsn_colour_grid) stack = draw_stack();
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto_mem(uint8_t) row = gsn_alloc(3 * AT.nx);
    struct gsn_error err = { 0 };
    size_t size = 0;
    char path[] = "/tmp/gieson-stack-XXXXXX";
    const char *xml = "";
    TIFF *tiff;
    int fd = mkstemp(path);

    CHECK_OK(gsn_ome_tiff_write(stack, "R07 <left> & \xc3\xa9", &bytes, &size, &err), err);
    CHECK(fd >= 0 && write(fd, bytes, size) == (ssize_t)size && close(fd) == 0);
    tiff = TIFFOpen(path, "r");
    CHECK(tiff && TIFFNumberOfDirectories(tiff) == AT.nz);
    CHECK(TIFFGetField(tiff, TIFFTAG_IMAGEDESCRIPTION, &xml) == 1);
    CHECK(strstr(xml, "Name=\"R07 &lt;left> &amp; ??\""));
    CHECK(strstr(xml, "SizeX=\"70\" SizeY=\"131\" SizeC=\"3\" SizeZ=\"3\" SizeT=\"1\""));
    CHECK(strstr(xml, "PhysicalSizeX=\"16\" PhysicalSizeY=\"16\" PhysicalSizeZ=\"24\""));
    CHECK(strstr(xml, "TheZ=\"2\" TheT=\"0\" TheC=\"0\" PositionX=\"-528\""));
    CHECK(strstr(xml, "PositionZ=\"132\"") && strstr(xml, "</Pixels></Image></OME>"));
    for (size_t z = 0; z < AT.nz; z++) {
        CHECK(TIFFSetDirectory(tiff, (tdir_t)z) == 1);
        for (size_t y = 0; y < AT.ny; y++) {
            CHECK(TIFFReadScanline(tiff, row, (uint32_t)y, 0) == 1);
            CHECK(memcmp(row, stack->rgb + (z * AT.ny + y) * 3 * AT.nx, 3 * AT.nx) == 0);
        }
    }
    TIFFClose(tiff);
    CHECK(unlink(path) == 0);
}

TEST(a_colour_volume_is_read_as_it_was_written)
{
    gsn_auto(gsn_colour_grid) stack = draw_stack();
    gsn_auto(gsn_colour_grid) back = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0;

    CHECK_OK(gsn_colour_grid_nrrd(stack, &bytes, &size, &err), err);
    CHECK_OK(gsn_colour_grid_read(bytes, size, &back, &err), err);
    CHECK(memcmp(&back->at, &AT, sizeof AT) == 0);
    CHECK(memcmp(back->rgb, stack->rgb, 3 * gsn_lattice_count(&AT)) == 0);
}

TEST(another_or_a_damaged_colour_volume_is_refused)
{
    gsn_auto(gsn_colour_grid) stack = draw_stack();
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0, head;

    CHECK_OK(gsn_colour_grid_nrrd(stack, &bytes, &size, &err), err);
    head = size - 3 * gsn_lattice_count(&AT);
    for (size_t cut = 1; cut <= head + 1; cut++) {
        struct gsn_colour_grid *back = NULL;

        CHECK(gsn_colour_grid_read(bytes, cut - 1, &back, &err) == GSN_E_INPUT && !back);
    }
    for (size_t i = 0; i < head; i++) {
        struct gsn_colour_grid *back = NULL;

        bytes[i] ^= 0x40;
        CHECK(gsn_colour_grid_read(bytes, size, &back, &err) == GSN_E_INPUT && !back);
        bytes[i] ^= 0x40;
    }
}

TEST(what_nifti_cannot_hold_is_refused)
{
    const struct gsn_grid wide = { .at = { .nx = 32768, .ny = 1, .nz = 1 } };
    uint8_t *bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size;

    CHECK(gsn_nifti_write(&wide, 0, &bytes, &size, &err) == GSN_E_LIMIT);
    CHECK(!bytes && strstr(err.text, "write a .nrrd"));
}

static int write_all(const struct gsn_colour_grid *stack, const struct gsn_grid *grid,
                     const struct gsn_model *model, const struct gsn_trimesh *surface,
                     struct gsn_error *err)
{
    uint8_t *made[7] = { NULL };
    size_t size;
    int r = gsn_ome_tiff_write(stack, "R07", &made[0], &size, err);

    if (r >= 0)
        r = gsn_nrrd_write(grid, &made[1], &size, err);
    if (r >= 0)
        r = gsn_nifti_write(grid, 1, &made[2], &size, err);
    if (r >= 0)
        r = gsn_vtu_write(model, &made[3], &size, err);
    if (r >= 0)
        r = gsn_units_csv_write(model, &made[4], &size, err);
    if (r >= 0)
        r = gsn_stl_write(surface, &made[5], &size, err);
    if (r >= 0)
        r = gsn_glb_write(surface, &made[6], &size, err);
    for (size_t i = 0; i < 7; i++)
        gsn_free(made[i]);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    static const double low[3] = { 0 }, high[3] = { 1, 1, 1 };
    static const unsigned cells[3] = { 1, 1, 1 };
    static const struct quadric field = { 0.2, { 1, 2, 3 }, { 0 } };
    const struct gsn_isosurface_options options = { .level = 2, .edge_um = 2, .threads = 1 };
    gsn_auto(gsn_colour_grid) stack = draw_stack();
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_trimesh) surface = NULL;
    struct gsn_error err = { 0 };
    struct gsn_model model = { .space = NULL };
    struct kuhn kuhn;

    CHECK_OK(gsn_grid_new(&AT, &grid, &err), err);
    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    CHECK_OK(gsn_isosurface(kuhn.spline, &options, &surface, &err), err);
    model.space = kuhn.space;
    model.spline = kuhn.spline;
    CHECK_EVERY_OOM(write_all(stack, grid, &model, surface, &err), err);
    kuhn_done(&kuhn);
}
