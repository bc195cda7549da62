/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/reconstruction.h"

#include "tests/check.h"
#include "tests/specimen/drawn_assembly.h"

#include <string.h>

TEST(a_region_is_the_same_as_a_mask_and_as_a_shape)
{
    drawn_auto d;
    struct gsn_error err = { 0 };
    gsn_auto(gsn_mask) mask = NULL;
    const struct gsn_lattice lattice = { .nx = 40,
                                         .ny = 40,
                                         .nz = 12,
                                         .origin_um = { 12 - 20 * 24, 12 - 20 * 24, 12 },
                                         .step_um = { 24, 24, 24 } };

    drawn_specimen_even(&d, DRAWN_JOB, DRAWN_DENSITY);
    CHECK_OK(gsn_region_raster(&d.protocol->region, &lattice, &mask, &err), err);
    gsn_auto(gsn_reconstruction) shape = drawn_assembly(&d);

    d.specimen.region = mask;
    gsn_auto(gsn_reconstruction) same = drawn_assembly(&d);

    CHECK(gsn_mask_count(shape->region) == gsn_mask_count(same->region));
    for (size_t z = 0; z < shape->densities.grid->at.nz; z++)
        for (size_t y = 0; y < shape->densities.grid->at.ny; y++)
            for (size_t x = 0; x < shape->densities.grid->at.nx; x++) {
                const struct gsn_vec3 u = gsn_lattice_centre(&shape->densities.grid->at, x, y, z);

                CHECK(gsn_mask_has(shape->region, u) == gsn_mask_has(same->region, u));
            }
    /* Half a voxel lies between the two rasters; the densities are those that were drawn. */
    for (unsigned serial = 2; serial < 10; serial++) {

        drawn_check_plane(same->densities.grid, serial, DRAWN_DENSITY);
    }
}

TEST(a_region_that_is_not_in_the_block_is_refused)
{
    static const struct {
        const char *region, *says;
    } cases[] = {
        { "{\"shape\": \"box\", \"min\": [-288, -168, 480], \"max\": [288, 168, 960]}",
          "does not lie in this block of 12 sections every 24 um" },
        { "{\"shape\": \"box\", \"min\": [-288, -168, -960], \"max\": [288, 168, -480]}",
          "does not lie in this block" },
        { "{\"shape\": \"sphere\", \"centre\": [0, 0, 100], \"radius\": 1e300}",
          "does not lie in this block" },
        { "{\"shape\": \"box\", \"min\": [0, 0, 50], \"max\": [1, 1, 51]}", "holds no voxel" },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        gsn_auto_mem(char) job = gsn_format(
            "{\"specimen\": \"x\", " DRAWN_JOB_HEAD ", \"region\": %s}", cases[i].region);
        struct gsn_reconstruction *assembly = NULL;
        struct gsn_error err = { 0 };
        drawn_auto d;

        drawn_specimen_even(&d, job, DRAWN_DENSITY);
        CHECK(gsn_reconstruct(&d.specimen, &DRAWN_OPTIONS, &assembly, &err) == GSN_E_INPUT);
        CHECK(assembly == NULL);
        if (!strstr(err.text, cases[i].says))
            fail_msg("%s\nsays: %s", cases[i].region, err.text);
    }
}

/* Else a region of which half was never cut would look fully covered. */
TEST(the_part_of_a_region_beyond_the_block_counts_as_not_seen)
{
    static const char job[] =
        "{\"specimen\": \"x\", " DRAWN_JOB_HEAD ", \"region\": {\"shape\": \"box\", \"min\": "
        "[-288, -168, -96], \"max\": [288, 168, 384]}}";
    drawn_auto d;
    size_t region = 0, filled = 0;

    drawn_specimen_even(&d, job, DRAWN_DENSITY);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);
    const struct gsn_lattice *at = &a->densities.grid->at;

    for (size_t z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++)
                if (gsn_mask_has(a->region, gsn_lattice_centre(at, x, y, z))) {
                    region++;
                    filled +=
                        isfinite(
                            (double)a->densities.grid->value[gsn_lattice_index(at, x, y, z)]) != 0;
                }
    CHECK(region == 24 * 14 * 20); /* planes -4 to 15 */
    CHECK(filled == 24 * 14 * 12);
}

TEST(an_empty_mask_is_refused)
{
    struct gsn_reconstruction *assembly = NULL;
    struct gsn_error err = { 0 };
    gsn_auto(gsn_mask) mask = NULL;
    const struct gsn_lattice lattice = { .nx = 4, .ny = 4, .nz = 4, .step_um = { 24, 24, 24 } };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DRAWN_DENSITY);
    CHECK_OK(gsn_mask_new(&lattice, &mask, &err), err);
    d.specimen.region = mask;
    CHECK(gsn_reconstruct(&d.specimen, &DRAWN_OPTIONS, &assembly, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "the region mask is empty") != NULL && assembly == NULL);
}

TEST(without_a_region_the_sections_are_still_laid_and_pictured)
{
    drawn_auto d;

    drawn_specimen_even(&d, "{\"specimen\": \"x\", " DRAWN_JOB_HEAD "}", DRAWN_DENSITY);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->poses.solved && !a->densities.grid && !a->region &&
          a->densities.section[0].state == GSN_SECTION_USED);
    CHECK(a->densities.panel[0].opened && a->densities.section[0].thumbnail.size > 0);
}
