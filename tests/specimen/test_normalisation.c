/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/reconstruction.h"

#include "pipeline/register/stack/resample.h"
#include "pipeline/stain/error_propagation.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/stain_vectors.h"
#include "tests/check.h"

#include <string.h>

enum { PANELS = 4, PER_PANEL = 7, SECTIONS = PANELS * PER_PANEL };

static const struct gsn_lattice BLOCK = {
    110, 100, SECTIONS, { -1744, -1584, 12 }, { 32, 32, 24 }
};

/* Bone with a root in it, loose tissue around, glass beyond. A region in the bone. */
static double beyond_root(struct gsn_vec3 u)
{
    return hypot(u.x + 300, u.y + 40) - (350 + 0.2 * u.z);
}

static int in_region(struct gsn_vec3 u)
{
    return fabs(u.x - 700) < 200 && fabs(u.y) < 200 && u.z > 100 && u.z < 400;
}

/* What is left of a lesion around the region: half of it at 300 um, next to nothing at 900. */
static double left_of(double spill, struct gsn_vec3 u)
{
    const double away = hypot(fmax(0, fabs(u.x - 700) - 200), fmax(0, fabs(u.y) - 200));

    return 1 - spill * exp(-0.69 * (away / 300) * (away / 300));
}

static double density_at(struct gsn_vec3 u, double loss)
{
    const double d = beyond_root(u), r = hypot(u.x, u.y);

    if (r > 1450)
        return NAN;
    if (d < 0)
        return 0.55;
    if (d < 200)
        return 0.4;
    return r > 1150 ? 0.2 : in_region(u) ? 0.88 * (1 - loss) : 0.88;
}

/* Grain that is the same everywhere the test runs. */
static double grain(size_t i)
{
    uint64_t s = 0x9e3779b97f4a7c15u * (i + 1);

    s ^= s >> 29;
    s *= 0xbf58476d1ce4e5b9u;
    s ^= s >> 32;
    return (double)(s >> 11) / 4503599627370496.0 - 1; /* -1..1 */
}

struct drawing {
    struct gsn_gain_offset stain[PANELS];
    double loss;
    double spill; /* what bone beside the region has lost with it, falling off with the distance */
    double thinning; /* of all bone along the block, per um */
    int uniform;     /* the block is of bone alone */
};

static void put(const struct drawing *d, struct gsn_grid *grid, struct gsn_grid *tissue)
{
    const struct gsn_lattice *at = &grid->at;

    for (size_t i = 0; i < gsn_lattice_count(at); i++) {
        const struct gsn_vec3 u =
            gsn_lattice_centre(at, i % at->nx, i / at->nx % at->ny, i / at->nx / at->ny);
        const struct gsn_gain_offset *stain = &d->stain[(int)(u.z / 24) / PER_PANEL];
        double density = density_at(u, d->loss);

        if (d->uniform && !isnan(density))
            density = 0.88;
        if (density > 0.8)
            density *= left_of(d->spill, u) * (1 - d->thinning * u.z);
        grid->value[i] = (float)(stain->gain * density * (1 + 0.1 * grain(i)) + stain->offset);
        if (tissue)
            tissue->value[i] = isnan(density) ? 0.0F : 1.0F;
    }
}

static int make_parts(const struct gsn_lattice *block, struct gsn_reconstruction *a,
                      struct gsn_error *err)
{
    const struct gsn_lattice near = { 30, 30, 16, { 480, -232, 84 }, { 16, 16, 24 } };
    int r = gsn_coarse_grid_new(block, &a->densities.coarse, err);

    a->densities.panel = gsn_alloc_array(PANELS, sizeof *a->densities.panel);
    a->poses.section = gsn_alloc_array(SECTIONS, sizeof *a->poses.section);
    a->densities.section = gsn_alloc_array(SECTIONS, sizeof *a->densities.section);
    CHECK(a->densities.panel && a->poses.section && a->densities.section);
    a->densities.section_count = SECTIONS;
    a->densities.panel_count = PANELS;
    a->poses.section_count = SECTIONS;
    if (r >= 0)
        r = gsn_grid_new(&near, &a->densities.grid, err);
    return r < 0 ? r : gsn_mask_new(&near, &a->region, err);
}

/* As these vectors see the columns: what is not red is yellow. */
static void stain_columns(struct gsn_reconstruction *a, const struct gsn_dyes_fit *fit)
{
    const struct gsn_dyes *dyes = &fit->dyes;

    for (size_t i = 0; i < gsn_lattice_count(&a->densities.coarse->density->at); i++) {
        const double density = (double)a->densities.coarse->density->value[i];

        for (int c = 0; c < 3; c++)
            a->densities.coarse->od[c]->value[i] =
                (float)(dyes->full_red_od * density * dyes->red[c] +
                        0.34 * (1 - 0.55 * density) * dyes->yellow[c]);
    }
    for (int p = 0; p < PANELS; p++)
        a->densities.panel[p].stain.fit = *fit;
}

/* gives: three panels of seven sections, as they are when all panels have passed. */
static struct gsn_reconstruction *draw_on(const struct gsn_lattice *block, const struct drawing *d)
{
    struct gsn_reconstruction *a = gsn_alloc_array(1, sizeof *a);
    struct gsn_error err = { 0 };

    CHECK(a != NULL);
    CHECK_OK(make_parts(block, a, &err), err);
    for (unsigned p = 0; p < PANELS; p++) {
        a->densities.panel[p].opened = 1;
        a->densities.panel[p].stain.panel = p + 1;
    }
    for (unsigned k = 0; k < SECTIONS; k++) {
        a->poses.section[k].panel = k / PER_PANEL + 1;
        a->poses.section[k].seen.serial = k;
        a->densities.section[k].state = GSN_SECTION_USED;
    }
    put(d, a->densities.coarse->density, a->densities.coarse->tissue);
    put(d, a->densities.grid, NULL);
    stain_columns(a, &(struct gsn_dyes_fit){ .dyes = gsn_dyes_builtin() });
    for (size_t i = 0; i < gsn_lattice_count(&a->region->at); i++)
        a->region->inside[i] =
            (uint8_t)in_region(gsn_lattice_centre(&a->region->at, i % 30, i / 30 % 30, i / 900));
    return a;
}

static struct gsn_reconstruction *draw(const struct drawing *d)
{
    return draw_on(&BLOCK, d);
}

static int is_nan(double value)
{
    return value != value;
}

static const struct gsn_protocol JOB = { .interval_um = 24 };
static const struct gsn_specimen SPECIMEN = { .protocol = &JOB };

static int find_tissues(struct gsn_reconstruction *a, struct gsn_error *err)
{
    return gsn_scale_find_tissues(&SPECIMEN, a->region, &a->poses, &a->densities, &a->scale, err);
}

static int normalise(struct gsn_reconstruction *a, struct gsn_error *err)
{
    gsn_scale_done(&a->scale);
    a->scale = (struct gsn_scale){ .panel = NULL };
    return gsn_scale_normalise(&SPECIMEN, a->region, &a->poses, &a->densities, &a->scale, err);
}

static int level(struct gsn_reconstruction *a, struct gsn_error *err)
{
    const int r = normalise(a, err);

    if (r < 0)
        return r;
    gsn_scale_sum_errors(&SPECIMEN, a->region, &a->poses, &a->densities, &a->scale);
    return find_tissues(a, err);
}

static double region_mean(const struct gsn_reconstruction *a)
{
    double sum = 0;
    size_t n = 0;

    for (size_t i = 0; i < gsn_lattice_count(&a->densities.grid->at); i++)
        if (a->region->inside[i]) {
            sum += (double)a->densities.grid->value[i];
            n++;
        }
    return sum / (double)n;
}

static const struct drawing STAINED = {
    .stain = { { 0.9, 0.03 }, { 1.17, 0 }, { 1.02, -0.06 }, { 0.95, 0.02 } }
};
static const struct drawing EVEN = { .stain = { { 1, 0 }, { 1, 0 }, { 1, 0 }, { 1, 0 } } };

/* A density on the scale of the panels' mean. */
static double common(const struct drawing *d, double density)
{
    double gain = 0, offset = 0;

    for (int p = 0; p < PANELS; p++) {
        gain += d->stain[p].gain / PANELS;
        offset += d->stain[p].offset / PANELS;
    }
    return gain * density + offset;
}

/* Case 46, case 50: panels that were stained apart. */
TEST(panels_of_a_block_come_to_one_scale)
{
    gsn_auto(gsn_reconstruction) a = draw(&STAINED);
    struct gsn_error err = { 0 };

    CHECK_OK(level(a, &err), err);
    CHECK(a->scale.levelling.done && a->scale.levelling.panels == PANELS &&
          a->scale.levelling.why[0] == '\0');
    CHECK(a->scale.levelling.fit.kept > 0.99);
    CHECK_NEAR(region_mean(a), common(&STAINED, 0.88), 0.006);
    CHECK_NEAR(a->scale.levelling.tissues.value[GSN_CONTROL_DENSE], common(&STAINED, 0.88), 0.006);
    CHECK_NEAR(a->scale.levelling.tissues.value[GSN_CONTROL_LOOSE], common(&STAINED, 0.2), 0.006);
    CHECK_NEAR(a->scale.levelling.tissues.value[GSN_CONTROL_DENTINE], common(&STAINED, 0.55),
               0.006);
    CHECK(a->scale.red_error > 0 && a->scale.red_error < 0.01);
}

TEST(a_loss_in_the_region_stays_a_loss)
{
    struct drawing treated = STAINED;
    struct gsn_error err = { 0 };

    treated.loss = 0.4;
    gsn_auto(gsn_reconstruction) a = draw(&treated);

    CHECK_OK(level(a, &err), err);
    CHECK(a->scale.levelling.done);
    CHECK_NEAR(region_mean(a), common(&STAINED, 0.6 * 0.88), 0.006);
    CHECK_NEAR(a->scale.levelling.tissues.value[GSN_CONTROL_DENSE], common(&STAINED, 0.88), 0.006);
}

/* Bone that has lost a tenth 300 um from the region is not what another specimen is compared by. */
TEST(what_a_lesion_leaves_beside_the_region_is_not_taken_for_stain)
{
    struct drawing spilt = EVEN;
    struct gsn_error err = { 0 };

    spilt.spill = 0.2;
    gsn_auto(gsn_reconstruction) a = draw(&spilt);

    CHECK_OK(level(a, &err), err);
    CHECK_NEAR(a->scale.levelling.tissues.value[GSN_CONTROL_DENSE], 0.88, 0.004);
}

/* The region's middle is at 252 um, the block's at 336: what is missing does not move the tissue.
 */
TEST(tissue_is_told_at_the_height_of_the_region)
{
    struct drawing thinning = EVEN;
    struct gsn_error err = { 0 };

    thinning.thinning = 2e-4;
    for (unsigned lost = 0; lost <= 4; lost += 4) {
        gsn_auto(gsn_reconstruction) a = draw(&thinning);

        for (unsigned k = 0; k < lost; k++)
            a->densities.section[k].state = GSN_SECTION_HELD;
        CHECK_OK(level(a, &err), err);
        CHECK(a->scale.levelling.panels == PANELS);
        CHECK_NEAR(a->scale.levelling.tissues.value[GSN_CONTROL_DENSE], 0.88 * (1 - 2e-4 * 252),
                   0.004);
    }
}

TEST(even_panels_stay_as_they_were)
{
    gsn_auto(gsn_reconstruction) a = draw(&EVEN);
    const double before = region_mean(a);
    struct gsn_error err = { 0 };

    CHECK_OK(level(a, &err), err);
    CHECK(a->scale.levelling.done);
    CHECK_NEAR(region_mean(a), before, 0.0005);
}

TEST(a_block_without_contrast_is_not_levelled_and_says_so)
{
    struct drawing bone = STAINED;
    struct gsn_error err = { 0 };

    bone.uniform = 1;
    for (int p = 0; p < PANELS; p++)
        bone.stain[p] = (struct gsn_gain_offset){ 1, 0 };
    gsn_auto(gsn_reconstruction) a = draw(&bone);
    const double before = region_mean(a);

    CHECK_OK(level(a, &err), err);
    CHECK(!a->scale.levelling.done);
    assert_non_null(strstr(a->scale.levelling.why, "is all of one density"));
    CHECK_NEAR(region_mean(a), before, 0);
    CHECK(is_nan(a->scale.levelling.tissues.value[GSN_CONTROL_DENSE]));
}

TEST(too_few_sections_are_not_levelled_and_say_so)
{
    gsn_auto(gsn_reconstruction) a = draw(&STAINED);
    struct gsn_error err = { 0 };

    for (unsigned k = 0; k < SECTIONS; k++)
        if (k % PER_PANEL >= 4)
            a->densities.section[k].state = GSN_SECTION_HELD;
    CHECK_OK(level(a, &err), err);
    CHECK(!a->scale.levelling.done);
    assert_non_null(strstr(a->scale.levelling.why, "only 0 times could sections of one panel"));
}

TEST(one_panel_has_tissue_but_no_steps)
{
    gsn_auto(gsn_reconstruction) a = draw(&EVEN);
    struct gsn_error err = { 0 };

    for (unsigned k = 0; k < SECTIONS; k++)
        a->poses.section[k].panel = 1;
    CHECK_OK(level(a, &err), err);
    CHECK(a->scale.levelling.done && a->scale.levelling.panels == 1 && !a->scale.panel[1].levelled);
    CHECK_NEAR(a->scale.levelling.tissues.value[GSN_CONTROL_DENSE], 0.88, 0.01);
    CHECK(gsn_control_tissue_error(&a->scale.levelling.tissues, GSN_CONTROL_DENSE) < 0.01);
    CHECK(!a->scale.levelling.vectors.known); /* nothing scatters */
}

TEST(running_out_of_memory_while_levelling_is_said)
{
    gsn_auto(gsn_reconstruction) a = draw(&STAINED);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(normalise(a, &err), err);
    CHECK(a->scale.levelling.done);
}

/* Yellow goes down in a line as red goes up, so all that vectors do is on the line of the untreated
 * tissues; vectors that are taken as exact have no error. */
TEST(what_vectors_do_alike_to_untreated_tissue_and_region_is_not_counted)
{
    const struct gsn_dyes_prior prior = gsn_dyes_prior_builtin(GSN_LIGHT_CODES_LINEAR);
    const struct gsn_dyes_fit stated = gsn_dyes_as_stated(&prior), exact = { .dyes = prior.dyes };
    struct drawing treated = EVEN;
    struct gsn_error err = { 0 };

    treated.loss = 0.4;
    gsn_auto(gsn_reconstruction) a = draw(&treated);
    gsn_auto(gsn_reconstruction) b = draw(&treated);

    stain_columns(a, &stated);
    CHECK_OK(level(a, &err), err);
    CHECK(a->scale.levelling.vectors.known);
    CHECK_NEAR(gsn_vector_error_of_loss(&a->scale.levelling.vectors, 1), 0, 1e-3);
    CHECK(gsn_vector_error_of_loss(&a->scale.levelling.vectors, 0.6) > 0.01);
    stain_columns(b, &exact);
    CHECK_OK(level(b, &err), err);
    CHECK(b->scale.levelling.vectors.known && b->scale.levelling.turns.freedom == PANELS - 1);
    CHECK(b->scale.levelling.turns.variance < 1e-5); /* as even panels say: a fifth of a degree */
}

/* gives: a coarse block of even panels as if they had been levelled. */
static struct gsn_reconstruction *draw_levelled(void)
{
    const struct gsn_lattice coarse = { 55, 50, SECTIONS, { -1728, -1568, 12 }, { 64, 64, 24 } };
    struct gsn_reconstruction *a = draw_on(&coarse, &EVEN);

    a->scale.panel = gsn_alloc_array(PANELS, sizeof *a->scale.panel);
    CHECK(a->scale.panel != NULL);
    a->scale.panel_count = PANELS;
    a->scale.levelling.done = 1;
    a->scale.levelling.panels = PANELS;
    a->scale.levelling.fit.steps = PANELS - 1;
    a->scale.levelling.fit.at[1] = 1;
    for (int p = 0; p < PANELS; p++) {
        a->scale.panel[p].levelled = 1;
        a->scale.panel[p].place = (size_t)p;
    }
    return a;
}

/* A walk of n points has a sample variance of (n + 1) / 6 of its steps' variance: five sixths for
 * four panels. */
TEST(offsets_that_levelling_itself_scatters_are_no_turn_of_the_vectors)
{
    gsn_auto(gsn_reconstruction) a = draw_levelled();
    struct gsn_normalisation *l = &a->scale.levelling;
    struct gsn_error err = { 0 };
    double alone;

    l->fit.offset_scatter = 0.05;
    CHECK_OK(find_tissues(a, &err), err);
    alone = l->turns.variance;
    CHECK(alone > 1e-5);
    l->fit.covariance[0] = 0.6 * 0.05 * 0.05; /* half of the scatter's variance */
    CHECK_OK(find_tissues(a, &err), err);
    CHECK_NEAR(l->turns.variance, 0.5 * alone, 1e-6 * alone);
    l->fit.covariance[0] = 2 * 0.05 * 0.05;
    CHECK_OK(find_tissues(a, &err), err);
    CHECK_NEAR(l->turns.variance, 0, 0);
}

TEST(running_out_of_memory_among_tissues_is_said)
{
    gsn_auto(gsn_reconstruction) a = draw_levelled();
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(find_tissues(a, &err), err);
    CHECK_NEAR(a->scale.levelling.tissues.value[GSN_CONTROL_DENSE], 0.88, 0.02);
}

/* ---- columns ------------------------------------------------------------------------------- */

/* Tissue of optical density 0.5 on the left, glass on the right. */
static struct gsn_image *half_a_tissue(void)
{
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(16, 16, 3, 8, &image, &err), err);
    for (size_t i = 0; i < 256; i++) {
        uint8_t *code = (uint8_t *)image->samples + 3 * i;

        code[0] = i % 16 < 8 ? 81 : 255;
        code[1] = code[2] = 255;
    }
    return image;
}

/* Every row, and every second one of which each says what two do. */
TEST(a_cell_holds_the_mean_of_its_tissue)
{
    const struct gsn_lattice at = { 4, 4, 2, { 16, 16, 12 }, { 32, 32, 24 } };
    gsn_auto(gsn_image) image = half_a_tissue();
    gsn_auto(gsn_od_reader) absorber = NULL;
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass;

    CHECK_OK(gsn_flat_field_given(16, 16, GSN_LIGHT_CODES_LINEAR,
                                  (const double[3]){ 255, 255, 255 }, &glass, &err),
             err);
    CHECK_OK(gsn_od_reader_new(image, &glass, &absorber, &err), err);
    for (unsigned apart = 1; apart <= 2; apart++) {
        gsn_auto(gsn_coarse_grid) columns = NULL;
        gsn_auto(gsn_plane) density = NULL;

        CHECK_OK(gsn_coarse_grid_new(&at, &columns, &err), err);
        CHECK_OK(gsn_plane_new(16, 16 / apart, &density, &err), err);
        for (size_t i = 0; i < 256 / apart; i++) /* a hole in the first cell's corner */
            density->value[i] =
                i == 0 ? NAN : (float)(i % 16 < 8 ? 0.25 + 0.5 * (double)(i % 2) : 0);

        const struct gsn_stack_section section = { .serial = 1,
                                                   .density = density,
                                                   .panel_to_block_um = { 8, 0, 0, 0, 8, 0 },
                                                   .width = 16,
                                                   .height = 16 };

        CHECK_OK(gsn_coarse_grid_add(columns, &section, apart, absorber, 24, &err), err);
        CHECK(is_nan((double)columns->density->value[0]));
        CHECK(is_nan((double)columns->tissue->value[0]));
        CHECK_NEAR((double)columns->density->value[16], 0.5, 0.04);
        CHECK_NEAR((double)columns->density->value[21], 0.5, 1e-6);
        CHECK_NEAR((double)columns->tissue->value[21], 1, 0);
        CHECK_NEAR((double)columns->od[0]->value[21], log10(255 / 81.0), 1e-4);
        CHECK_NEAR((double)columns->od[1]->value[21], 0, 1e-6);
        CHECK(is_nan((double)columns->od[0]->value[19]));
        CHECK(is_nan((double)columns->density->value[19]));
        CHECK_NEAR((double)columns->tissue->value[19], 0, 0);
    }
}

TEST(a_cell_knows_how_far_it_is_from_a_region)
{
    const struct gsn_lattice at = { 20, 20, 9, { 16, 16, 12 }, { 32, 32, 24 } };
    const struct gsn_lattice of = { 1, 1, 1, { 320, 320, 108 }, { 16, 16, 24 } };
    gsn_auto(gsn_mask) region = NULL;
    gsn_auto(gsn_grid) away = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_mask_new(&of, &region, &err), err);
    CHECK_OK(gsn_coarse_grid_away(region, &at, &away, &err), err);
    CHECK(away->at.nz == 1 && isinf(away->value[0]));
    gsn_grid_free(gsn_steal(&away));
    region->inside[0] = 1;
    CHECK_OK(gsn_coarse_grid_away(region, &at, &away, &err), err);
    CHECK_NEAR((double)away->value[10 * 20 + 10], 0, 0);
    CHECK_NEAR((double)away->value[13 * 20 + 6], 32 * 5, 1e-4);
    gsn_grid_free(gsn_steal(&away));
    CHECK_EVERY_OOM(gsn_coarse_grid_away(region, &at, &away, &err), err);
}

TEST(a_footprint_holds_what_lies_above_and_below_a_region)
{
    const struct gsn_lattice at = { 20, 20, 9, { 16, 16, 12 }, { 32, 32, 24 } };
    const struct gsn_lattice of = { 1, 1, 1, { 320, 320, 108 }, { 16, 16, 24 } };
    gsn_auto(gsn_mask) region = NULL;
    gsn_auto(gsn_mask) footprint = NULL;
    struct gsn_error err = { 0 };
    size_t cells = 0;

    CHECK_OK(gsn_mask_new(&of, &region, &err), err);
    CHECK_OK(gsn_coarse_grid_footprint(region, &at, 100, &footprint, &err), err);
    CHECK(footprint->at.nz == 1 && gsn_mask_count(footprint) == 0);
    gsn_mask_free(gsn_steal(&footprint));
    region->inside[0] = 1;
    CHECK_OK(gsn_coarse_grid_footprint(region, &at, 100, &footprint, &err), err);
    for (int y = -3; y <= 3; y++)
        for (int x = -3; x <= 3; x++)
            cells += 32 * hypot(x, y) <= 100 ? 1 : 0;
    CHECK(gsn_mask_count(footprint) == cells);
    CHECK(footprint->inside[10 * 20 + 10] && !footprint->inside[10 * 20 + 14]);
}
