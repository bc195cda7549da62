/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/density.h"

#include "pipeline/measure/overlap.h"

#include <string.h>

#include "tests/check.h"
#include "tests/measure/kuhn.h"

static const double low[3] = { 0.0, 0.0, 0.0 }, high[3] = { 1200.0, 900.0, 600.0 };
static const unsigned cells[3] = { 4, 3, 2 };
static const double corner[3] = { 120.0, 96.0, 48.0 };
static const struct quadric field = { 0.2, { 1e-4, -2e-4, 3e-4 }, { 2e-7, -1e-7, 4e-7 } };

/* Mean of the quadric over the box of n voxels of this step at corner. */
static double mean_of_box(const double at[3], double step, size_t nx, size_t ny, size_t nz)
{
    const double n[3] = { (double)nx, (double)ny, (double)nz };
    double mean = field.constant;

    for (int a = 0; a < 3; a++) {
        const double from = at[a], to = at[a] + step * n[a];

        mean += field.linear[a] * 0.5 * (from + to) +
                field.square[a] * (from * from + from * to + to * to) / 3.0;
    }
    return mean;
}

TEST(the_mean_of_a_quadratic_field_over_boxes_is_exact)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 30, 20);
    const double truth = mean_of_box(corner, 24.0, 40, 30, 20);

    for (unsigned degree = 2; degree <= 3; degree++) {
        struct gsn_region_density density;
        struct gsn_error err = { 0 };
        struct kuhn kuhn;

        CHECK_OK(kuhn_new(low, high, cells, degree, 0.05, &field, &kuhn, &err), err);
        CHECK_OK(gsn_region_density(kuhn.spline, region, 0, NULL, &density, &err), err);
        CHECK_NEAR(density.mean, truth, 1e-12);
        /* The centre rule misses h^2 / 24 of the second derivatives. */
        CHECK_NEAR(density.centres_mean, truth - 24.0 * 24.0 / 24.0 * 2.0 * (2e-7 - 1e-7 + 4e-7),
                   1e-12);
        CHECK(density.voxels == 24000);
        CHECK_NEAR(density.volume_um3, 24000.0 * 13824.0, 1e-3);
        kuhn_done(&kuhn);
    }
}

TEST(the_mean_of_a_rough_spline_is_that_of_a_finer_lattice)
{
    gsn_auto(gsn_mask) coarse = full_mask(corner, 24.0, 20, 20, 16);
    gsn_auto(gsn_mask) fine = full_mask(corner, 6.0, 80, 80, 64);
    struct gsn_region_density one, other;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    /* Random control points 150 um apart swing by 2: rougher than any tissue fitted with samples
     * 24 um apart. */
    CHECK_OK(kuhn_random(low, high, cells, 2, 0.02, 9, &kuhn, &err), err);
    CHECK_OK(gsn_region_density(kuhn.spline, coarse, 0, NULL, &one, &err), err);
    CHECK_OK(gsn_region_density(kuhn.spline, fine, 0, NULL, &other, &err), err);
    CHECK_NEAR(one.mean, other.mean, 1e-4);
    kuhn_done(&kuhn);
}

/* The Gauss rule and the centre rule, one point after the other. */
static void density_by_points(const struct gsn_spline *spline, const struct gsn_mask *region,
                              double *ret_mean, double *ret_centres)
{
    const double node = 0.5 / sqrt(3.0);
    const struct gsn_lattice *at = &region->at;
    const double step[3] = { at->step_um.x, at->step_um.y, at->step_um.z };
    size_t hint = 0, voxels = 0;

    *ret_mean = *ret_centres = 0.0;
    for (size_t i = 0; i < gsn_lattice_count(at); i++) {
        const struct gsn_vec3 c =
            gsn_lattice_centre(at, i % at->nx, i / at->nx % at->ny, i / at->nx / at->ny);

        for (int k = 0; region->inside[i] && k <= 8; k++) {
            double u[3] = { c.x, c.y, c.z }, value;

            for (int a = 0; k < 8 && a < 3; a++)
                u[a] += (k >> a & 1 ? node : -node) * step[a];
            CHECK(gsn_spline_eval(spline, u, &hint, &value, NULL) == GSN_OK);
            *(k < 8 ? ret_mean : ret_centres) += k < 8 ? value / 8.0 : value;
        }
        voxels += region->inside[i];
    }
    *ret_mean /= (double)voxels;
    *ret_centres /= (double)voxels;
}

/* Only what lies in the middle of the domain is inside. */
static void keep_middle(struct gsn_mask *region)
{
    const struct gsn_lattice *at = &region->at;

    for (size_t i = 0; i < gsn_lattice_count(at); i++) {
        const struct gsn_vec3 c =
            gsn_lattice_centre(at, i % at->nx, i / at->nx % at->ny, i / at->nx / at->ny);

        region->inside[i] = c.x > 200.0 && c.x < 900.0 && c.y > 150.0 && c.y < 700.0 &&
                            c.z > 100.0 && c.z < 500.0 && i % 7 != 3;
    }
}

/* Corner of 200 x 190 x 120 voxels of 23 um: layer 110, the first of the second slab, is in the
 * middle of the domain. */
static const double two_slabs[3] = { 0.0, 0.0, 300.0 - 110.0 * 23.0 };

TEST(slabs_of_any_shape_sum_what_single_points_give)
{
    /* Whole layers in one slab, in several, and layers that are cut where the region is; all reach
     * beyond the mesh. */
    static const struct {
        double corner[3], step;
        size_t nx, ny, nz;
    } shape[] = { { { -61.0, -53.0, -47.0 }, 47.0, 31, 23, 17 },
                  { { -61.0, -53.0, 300.0 - 110.0 * 23.0 }, 23.0, 200, 190, 120 },
                  { { -61.0, 437.0 - 1997.0 * 19.0, 100.0 }, 19.0, 2100, 2010, 3 } };
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_random(low, high, cells, 3, 0.04, 21, &kuhn, &err), err);
    for (size_t s = 0; s < sizeof shape / sizeof shape[0]; s++) {
        gsn_auto(gsn_mask) region =
            full_mask(shape[s].corner, shape[s].step, shape[s].nx, shape[s].ny, shape[s].nz);
        struct gsn_region_density density[2];
        double mean, centres;

        keep_middle(region);
        memset(density, 0, sizeof density);
        for (unsigned k = 0; k < 2; k++)
            CHECK_OK(gsn_region_density(kuhn.spline, region, k + 1, NULL, &density[k], &err), err);
        CHECK(memcmp(&density[0], &density[1], sizeof density[0]) == 0);
        CHECK(density[0].voxels > 1000);
        density_by_points(kuhn.spline, region, &mean, &centres);
        CHECK_NEAR(density[0].mean, mean, 1e-12);
        CHECK_NEAR(density[0].centres_mean, centres, 1e-12);
    }
    kuhn_done(&kuhn);
}

struct said {
    size_t calls, done, total;
    int in_order;
};

static void hear(void *context, const char *stage, size_t done, size_t total)
{
    struct said *said = context;

    said->in_order &= strcmp(stage, "density") == 0 && done >= said->done && done <= total &&
                      (said->calls == 0 ? done == 0 : total == said->total);
    said->done = done;
    said->total = total;
    said->calls++;
}

TEST(progress_grows_from_nothing_to_all_rows)
{
    gsn_auto(gsn_mask) region = full_mask(two_slabs, 23.0, 200, 190, 120);
    struct said said = { .in_order = 1 };
    const struct gsn_progress progress = { hear, &said };
    struct gsn_region_density density;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    keep_middle(region);
    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    CHECK_OK(gsn_region_density(kuhn.spline, region, 1, &progress, &density, &err), err);
    CHECK(said.in_order && said.calls > 16);
    CHECK(said.total == 190 * 120 && said.done == said.total);
    kuhn_done(&kuhn);
}

TEST(the_first_voxel_outside_is_named_whatever_slab_it_is_in)
{
    gsn_auto(gsn_mask) region = full_mask(two_slabs, 23.0, 200, 190, 120);
    struct gsn_region_density density = { .mean = 7.0 };
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    keep_middle(region);
    region->inside[gsn_lattice_index(&region->at, 60, 20, 112)] = 1;
    region->inside[gsn_lattice_index(&region->at, 53, 19, 113)] = 1;
    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    for (unsigned k = 1; k <= 2; k++) {
        CHECK(gsn_region_density(kuhn.spline, region, k, NULL, &density, &err) == GSN_E_INPUT);
        CHECK(strstr(err.text, "voxel (60, 20, 112) of the region lies outside") != NULL);
    }
    /* The centre of this one is inside (1184.5), the Gauss points beyond it are too (1191.1), so
     * that it counts; those of its neighbour (1207.5) are not. */
    region->inside[gsn_lattice_index(&region->at, 60, 20, 112)] = 0;
    region->inside[gsn_lattice_index(&region->at, 53, 19, 113)] = 0;
    region->inside[gsn_lattice_index(&region->at, 51, 20, 112)] = 1;
    CHECK_OK(gsn_region_density(kuhn.spline, region, 1, NULL, &density, &err), err);
    region->inside[gsn_lattice_index(&region->at, 52, 20, 112)] = 1;
    CHECK(gsn_region_density(kuhn.spline, region, 1, NULL, &density, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "voxel (52, 20, 112)") != NULL);
    kuhn_done(&kuhn);
}

TEST(a_voxel_whose_centre_alone_is_inside_is_outside)
{
    const double edge[3] = { 1188.0, 96.0, 48.0 }; /* centre 1198, far Gauss points 1203.8 */
    gsn_auto(gsn_mask) region = full_mask(edge, 20.0, 1, 2, 2);
    struct gsn_region_density density = { .mean = 7.0 };
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    CHECK(gsn_region_density(kuhn.spline, region, 1, NULL, &density, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "voxel (0, 0, 0)") != NULL);
    CHECK_NEAR(density.mean, 7.0, 0.0);
    kuhn_done(&kuhn);
}

TEST(one_and_two_threads_give_the_same_mean_and_the_same_units)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 20, 20, 16);
    struct gsn_region_density density[2];
    gsn_auto_mem(struct gsn_unit) unit0 = NULL;
    gsn_auto_mem(struct gsn_unit) unit1 = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_random(low, high, cells, 2, 0.03, 9, &kuhn, &err), err);
    memset(density, 0, sizeof density);
    for (unsigned k = 0; k < 2; k++)
        CHECK_OK(gsn_region_density(kuhn.spline, region, k + 1, NULL, &density[k], &err), err);
    CHECK(memcmp(&density[0], &density[1], sizeof density[0]) == 0);
    CHECK_OK(gsn_units(kuhn.spline, region, NULL, 1, &unit0, &err), err);
    CHECK_OK(gsn_units(kuhn.spline, region, NULL, 2, &unit1, &err), err);
    for (size_t t = 0; t < kuhn.mesh->tet_count; t++) {
        CHECK(unit0[t].state == unit1[t].state);
        CHECK(memcmp(&unit0[t].mean, &unit1[t].mean, sizeof unit0[t].mean) == 0);
        CHECK_NEAR(unit0[t].inside_share, unit1[t].inside_share, 0.0);
    }
    kuhn_done(&kuhn);
}

TEST(units_of_a_linear_field_hold_it_at_their_centroid_and_fill_the_region)
{
    const struct quadric linear = { 0.2, { 1e-4, -2e-4, 3e-4 }, { 0.0, 0.0, 0.0 } };
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 20, 20, 16);
    gsn_auto_mem(struct gsn_unit) unit = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    double inside = 0.0, volume = 0.0;
    size_t outside = 0;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &linear, &kuhn, &err), err);
    CHECK_OK(gsn_units(kuhn.spline, region, NULL, 0, &unit, &err), err);
    for (size_t t = 0; t < kuhn.mesh->tet_count; t++) {
        double centroid[3] = { 0.0, 0.0, 0.0 };

        for (int k = 0; k < 12; k++)
            centroid[k % 3] += 0.25 * kuhn.mesh->vertex[kuhn.mesh->tet[t][k / 3]][k % 3];
        if (unit[t].state == GSN_UNIT_OK)
            CHECK_NEAR(unit[t].mean, quadric_at(&linear, centroid), 1e-8);
        else
            CHECK(unit[t].mean != unit[t].mean); /* NaN */
        CHECK(unit[t].inside_share >= 0.0 && unit[t].inside_share <= 1.0);
        CHECK(unit[t].state == (unit[t].inside_share > 0.0 ? GSN_UNIT_OK : GSN_UNIT_OUTSIDE));
        inside += unit[t].inside_share * unit[t].volume_um3;
        volume += unit[t].volume_um3;
        outside += unit[t].state == GSN_UNIT_OUTSIDE;
    }
    CHECK_NEAR(volume, 1200.0 * 900.0 * 600.0, 1e-3);
    CHECK_NEAR(inside, 6400.0 * 13824.0, 1e-3);
    CHECK(outside > 0 && outside < kuhn.mesh->tet_count);
    kuhn_done(&kuhn);
}

TEST(shares_of_a_region_with_holes_are_those_of_its_voxels_one_by_one)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 20, 20, 16);
    gsn_auto_mem(struct gsn_unit) unit = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    for (size_t i = 0; i < gsn_lattice_count(&region->at); i++)
        region->inside[i] = i % 5 != 0 && i % 20 != 19 && (i / 400 < 4 || i % 11 > 2);
    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    CHECK_OK(gsn_units(kuhn.spline, region, NULL, 2, &unit, &err), err);
    for (size_t t = 0; t < kuhn.mesh->tet_count; t++) {
        double tet[4][3], volume = 0.0;

        for (int k = 0; k < 4; k++)
            memcpy(tet[k], kuhn.mesh->vertex[kuhn.mesh->tet[t][k]], sizeof tet[k]);
        for (size_t i = 0; i < gsn_lattice_count(&region->at); i++) {
            const struct gsn_aabb box = gsn_voxel_aabb(&region->at, i);

            if (region->inside[i])
                volume += gsn_aabb_tet_volume(&box, (const double(*)[3])tet);
        }
        CHECK_NEAR(unit[t].inside_share, volume / unit[t].volume_um3, 1e-12);
    }
    kuhn_done(&kuhn);
}

/* Case 55. */
TEST(a_unit_without_samples_is_no_data_and_not_in_the_summary)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 20, 20, 16);
    gsn_auto_mem(struct gsn_unit) unit = NULL;
    gsn_auto_mem(uint32_t) samples = NULL;
    struct gsn_units_summary with, without;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    size_t t = 0;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    samples = gsn_alloc_array(kuhn.mesh->tet_count, sizeof *samples);
    for (size_t i = 0; i < kuhn.mesh->tet_count; i++)
        samples[i] = (uint32_t)i + 1;
    CHECK_OK(gsn_units(kuhn.spline, region, samples, 0, &unit, &err), err);
    CHECK_OK(gsn_units_summarise(unit, kuhn.mesh->tet_count, 0.0, 1.0, &with, &err), err);
    while (unit[t].state != GSN_UNIT_OK)
        t++;
    CHECK(unit[t].samples == t + 1);
    samples[t] = 0;
    gsn_free(gsn_steal(&unit));
    CHECK_OK(gsn_units(kuhn.spline, region, samples, 0, &unit, &err), err);
    CHECK(unit[t].state == GSN_UNIT_NO_DATA);
    CHECK_OK(gsn_units_summarise(unit, kuhn.mesh->tet_count, 0.0, 1.0, &without, &err), err);
    CHECK(with.no_data == 0 && without.no_data == 1 && without.ok == with.ok - 1);
    kuhn_done(&kuhn);
}

TEST(a_summary_orders_and_counts)
{
    struct gsn_unit unit[7];
    struct gsn_units_summary summary;
    struct gsn_error err = { 0 };
    const double mean[7] = { 0.9, 0.1, 0.5, 0.3, 0.7, -2.0, 5.0 };
    size_t total = 0;

    for (int i = 0; i < 7; i++)
        unit[i] = (struct gsn_unit){ .mean = mean[i], .state = GSN_UNIT_OK };
    unit[5].state = GSN_UNIT_OUTSIDE;
    unit[6].state = GSN_UNIT_NO_DATA;
    CHECK_OK(gsn_units_summarise(unit, 7, 0.2, 0.8, &summary, &err), err);
    CHECK(summary.ok == 5 && summary.outside == 1 && summary.no_data == 1);
    CHECK_NEAR(summary.min, 0.1, 0.0);
    CHECK_NEAR(summary.quartile1, 0.3, 0.0);
    CHECK_NEAR(summary.median, 0.5, 0.0);
    CHECK_NEAR(summary.quartile3, 0.7, 0.0);
    CHECK_NEAR(summary.max, 0.9, 0.0);
    for (int b = 0; b < GSN_UNIT_BINS; b++)
        total += summary.bin[b];
    CHECK(total == 5);
    /* 0.1 below the scale and 0.9 above it; 0.5 in the middle. */
    CHECK(summary.bin[0] == 1 && summary.bin[GSN_UNIT_BINS - 1] == 1);
    CHECK(summary.bin[GSN_UNIT_BINS / 2] + summary.bin[GSN_UNIT_BINS / 2 - 1] == 1);

    CHECK_OK(gsn_units_summarise(unit + 5, 2, 0.0, 1.0, &summary, &err), err);
    CHECK(summary.ok == 0);
    CHECK_NEAR(summary.median, 0.0, 0.0);
}

TEST(quartiles_interpolate_between_order_statistics)
{
    struct gsn_unit unit[2] = { { .mean = 1.0 }, { .mean = 3.0 } };
    struct gsn_units_summary summary;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_units_summarise(unit, 2, 0.0, 4.0, &summary, &err), err);
    CHECK_NEAR(summary.quartile1, 1.5, 1e-15);
    CHECK_NEAR(summary.median, 2.0, 1e-15);
    CHECK_NEAR(summary.quartile3, 2.5, 1e-15);
}

TEST(a_region_beyond_the_domain_or_an_empty_one_is_refused_by_name)
{
    const double beyond[3] = { 1152.0, 0.0, 0.0 };
    gsn_auto(gsn_mask) region = full_mask(beyond, 24.0, 3, 2, 2);
    struct gsn_region_density density = { .mean = 7.0 };
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    CHECK(gsn_region_density(kuhn.spline, region, 0, NULL, &density, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "voxel (2, 0, 0)") != NULL);
    memset(region->inside, 0, 12);
    CHECK(gsn_region_density(kuhn.spline, region, 0, NULL, &density, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "empty") != NULL);
    CHECK_NEAR(density.mean, 7.0, 0.0);
    kuhn_done(&kuhn);
}

static int everything(const struct kuhn *kuhn, const struct gsn_mask *region, struct gsn_error *err)
{
    struct gsn_region_density density;
    gsn_auto_mem(struct gsn_unit) unit = NULL;
    struct gsn_units_summary summary;
    int r = gsn_region_density(kuhn->spline, region, 1, NULL, &density, err);

    if (r == GSN_OK)
        r = gsn_units(kuhn->spline, region, NULL, 1, &unit, err);
    if (r == GSN_OK)
        r = gsn_units_summarise(unit, kuhn->mesh->tet_count, 0.0, 1.0, &summary, err);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    const unsigned one[3] = { 1, 1, 1 };
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 4, 4, 4);
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, one, 2, 0.05, &field, &kuhn, &err), err);
    CHECK_EVERY_OOM(everything(&kuhn, region, &err), err);
    kuhn_done(&kuhn);
}

/* A trend along z is none of it; what each section is off by is: 0.02 up and down in turn, of 10
 * sections alike in size, gives 2 x 0.02 off its neighbours' middle. */
TEST(what_sections_err_by_is_told_from_a_trend)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 6, 5, 10);
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new(&region->at, &grid, &err), err);
    for (size_t i = 0; i < gsn_lattice_count(&region->at); i++)
        grid->value[i] = (float)(0.5 + 0.01 * (double)(i / 30));
    CHECK_NEAR(gsn_section_error(grid, region), 0, 1e-7);
    for (size_t i = 0; i < gsn_lattice_count(&region->at); i++)
        grid->value[i] += i / 30 % 2 ? 0.02f : -0.02f;
    CHECK_NEAR(gsn_section_error(grid, region), 0.04 / sqrt(1.5) / sqrt(10), 1e-6);
    for (size_t i = 0; i < gsn_lattice_count(&region->at); i++)
        if (i / 30 % 3 == 0)
            grid->value[i] = NAN; /* no three sections in a row */
    CHECK(!(gsn_section_error(grid, region) >= 0));
}
