/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A section of three kinds of tissue with grain is drawn as densities, damaged, turned into codes
 * with noise, and looked at. What was damaged is known to the pixel. */
#include "pipeline/stain/artefact/detection.h"

#include "tests/check.h"
#include "tests/stain/paint.h"

#include <stdlib.h>
#include <string.h>

enum { WIDTH = 440, HEIGHT = 340, COUNT = WIDTH * HEIGHT };

#define PX_UM 16.0
#define NOISE 1.2 /* codes */

static const double WHITE[3] = { 248, 244, 238 };

struct scene {
    float od[3][COUNT];
    uint8_t truth[COUNT]; /* what was damaged */
    struct gsn_artefact_labels *labels;
    struct gsn_artefact_figures figures;
};

static size_t index_of(int x, int y)
{
    return (size_t)y * WIDTH + (size_t)x;
}

static int in_tissue(double x, double y)
{
    return pow(fabs(x - 220) / 160, 3) + pow(fabs(y - 170) / 125, 3) < 1;
}

/* Grain of mean 0 and deviation 1: half of it fine, over three pixels, and half over nine, as what
 * tissue is made of comes in all sizes. */
static void draw_grain(float *grain, uint64_t seed)
{
    struct dice dice = { seed };
    static float white[COUNT];

    for (size_t i = 0; i < COUNT; i++)
        white[i] = (float)dice_normal(&dice);
    for (int y = 4; y + 4 < HEIGHT; y++)
        for (int x = 4; x + 4 < WIDTH; x++) {
            double fine = 0, broad = 0;

            for (int v = -4; v <= 4; v++)
                for (int u = -4; u <= 4; u++) {
                    const double one = white[index_of(x + u, y + v)];

                    broad += one / 9;
                    if (abs(u) <= 1 && abs(v) <= 1)
                        fine += one / ((1.0 + abs(u)) * (1.0 + abs(v))) / 1.5;
                }
            grain[index_of(x, y)] = (float)(sqrt(0.5) * (fine + broad));
        }
}

/* Ligament, bone and marrow beside each other. */
static double density_at(int x, int y)
{
    if (hypot(x - 290, y - 200) < 25)
        return 0.06;
    return x < 160 ? 0.42 : 0.88;
}

static struct scene *draw(double grain_size)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct scene *scene = gsn_alloc_array(1, sizeof *scene);
    static float red[COUNT], yellow[COUNT];

    draw_grain(red, 1);
    draw_grain(yellow, 2);
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            const size_t i = index_of(x, y);
            const double d = density_at(x, y);
            const double r = 0.62 * d * fmax(0.05, 1 + grain_size * red[i]);
            const double v = 0.34 * (1 - 0.55 * d) * fmax(0.05, 1 + grain_size * yellow[i]);

            for (int c = 0; c < 3; c++)
                scene->od[c][i] =
                    in_tissue(x, y) ? (float)(r * dyes.red[c] + v * dyes.yellow[c]) : 0;
        }
    return scene;
}

static void scene_free(struct scene **scene)
{
    if (*scene)
        gsn_artefact_labels_free((*scene)->labels);
    gsn_free(*scene);
}
#define scene_auto __attribute__((cleanup(scene_free))) struct scene *

static void scan(const struct scene *scene, struct gsn_image *image, struct gsn_flat_field *glass)
{
    struct gsn_error err = { 0 };
    struct dice dice = { 7 };

    for (size_t i = 0; i < COUNT; i++)
        for (size_t c = 0; c < 3; c++) {
            const double code =
                WHITE[c] * pow(10, -scene->od[c][i]) + NOISE * dice_normal(&dice) + 0.5;

            ((uint8_t *)image->samples)[3 * i + c] = (uint8_t)fmin(fmax(code, 0), 255);
        }
    CHECK_OK(gsn_flat_field_given(WIDTH, HEIGHT, GSN_LIGHT_CODES_LINEAR, WHITE, glass, &err), err);
    glass->noise_od = NOISE / 244 / log(10);
}

static int find_with(struct scene *scene, const struct gsn_artefact_section *section, double px_um,
                     unsigned threads, struct gsn_error *err)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    gsn_auto(gsn_image) image = NULL;
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) green = NULL;
    gsn_auto(gsn_plane) blue = NULL;
    struct gsn_plane *od[3] = { NULL, NULL, NULL };
    struct gsn_flat_field glass;
    int r = gsn_image_new(WIDTH, HEIGHT, 3, 8, &image, err);

    if (r < 0)
        return r;
    scan(scene, image, &glass);
    r = gsn_od_thin(image, &glass, 1, od, err);
    red = od[0];
    green = od[1];
    blue = od[2];
    if (r < 0)
        return r;
    const struct gsn_artefact_panel panel = { image, od, &glass, &dyes, px_um, 1, section, NULL };

    return gsn_artefact_find(&panel, threads, &scene->labels, &scene->figures, err);
}

static const struct gsn_artefact_section ALL = { .width = WIDTH, .height = HEIGHT };

static void find(struct scene *scene)
{
    struct gsn_error err = { 0 };

    CHECK_OK(find_with(scene, &ALL, PX_UM, 1, &err), err);
}

static unsigned label_at(const struct scene *scene, int x, int y)
{
    return gsn_artefact_label(scene->labels, 0, x, y);
}

/* The share of what was damaged that is masked, and masked for this reason. */
static double found(const struct scene *scene, unsigned bits)
{
    size_t all = 0, seen = 0;

    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            if (scene->truth[index_of(x, y)]) {
                all++;
                seen += (label_at(scene, x, y) & bits) != 0;
            }
    return (double)seen / (double)all;
}

static int is_near_truth(const struct scene *scene, int x, int y)
{
    for (int v = y > 8 ? y - 8 : 0; v <= y + 8 && v < HEIGHT; v++)
        for (int u = x > 8 ? x - 8 : 0; u <= x + 8 && u < WIDTH; u++)
            if (scene->truth[index_of(u, v)])
                return 1;
    return 0;
}

/* The share of the section that is masked although nothing is wrong within 130 um. */
static double false_alarm(const struct scene *scene)
{
    size_t all = 0, masked = 0;

    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            if (!in_tissue(x, y))
                continue;
            all++;
            masked += label_at(scene, x, y) && !is_near_truth(scene, x, y);
        }
    return (double)masked / (double)all;
}

static void add(struct scene *scene, int x, int y, const double od[3])
{
    for (int c = 0; c < 3; c++)
        scene->od[c][index_of(x, y)] += (float)od[c];
    scene->truth[index_of(x, y)] = 1;
}

TEST(clean_tissue_is_left_alone_whatever_its_grain)
{
    static const double grains[] = { 0, 0.15, 0.3, 0.55 };

    for (size_t i = 0; i < 4; i++) {
        scene_auto scene = draw(grains[i]);

        find(scene);
        CHECK_NEAR(false_alarm(scene), 0, 0);
        CHECK_NEAR(scene->figures.masked_um2, 0, 0);
        /* The superellipse |x/a|^3 + |y/b|^3 < 1 has 3.533 a b. */
        CHECK_NEAR(scene->figures.outline_um2 * 1e-6, 3.533 * 160 * 125 * 256e-6, 0.4);
    }
}

static void fold(struct scene *scene, int x0, int width)
{
    for (int y = 0; y < HEIGHT; y++)
        for (int x = x0; x < x0 + width; x++) {
            const size_t mirrored = index_of(2 * x0 - x - 1, y);
            const double od[3] = { scene->od[0][mirrored], scene->od[1][mirrored],
                                   scene->od[2][mirrored] };

            if (in_tissue(x, y))
                add(scene, x, y, od);
        }
}

/* Case 36. */
TEST(a_fold_is_found_whatever_tissue_lies_double)
{
    static const int at[][2] = { { 120, 5 }, { 240, 9 }, { 290, 15 } };

    for (size_t i = 0; i < 3; i++) {
        scene_auto scene = draw(0.3);

        fold(scene, at[i][0], at[i][1]);
        find(scene);
        CHECK(found(scene, GSN_DEFECT_FOLD) > 0.9);
        CHECK_NEAR(false_alarm(scene), 0, 0.002);
        CHECK(scene->figures.area_um2[1] > 0 && strcmp(gsn_defect_word(1), "fold") == 0);
        CHECK(strstr(gsn_defect_reason(1), "lies double") != NULL);
    }
    CHECK(strstr(gsn_defect_reason(1), "the tissue lies double: both dyes are there twice") !=
          NULL);
}

/* Case 37: a cleft that opens at the border, and a hole; neither counts as tissue of no collagen.
 */
TEST(a_tear_and_a_hole_are_voids)
{
    scene_auto scene = draw(0.3);

    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            if (in_tissue(x, y) &&
                (fabs(x - 180.0) < 0.10 * (y - 160) || hypot(x - 300, y - 110) < 12)) {
                scene->od[0][index_of(x, y)] = scene->od[1][index_of(x, y)] =
                    scene->od[2][index_of(x, y)] = 0;
                scene->truth[index_of(x, y)] = 1;
            }
    find(scene);
    CHECK(found(scene, GSN_DEFECT_VOID) > 0.9);
    CHECK_NEAR(false_alarm(scene), 0, 0.002);
    assert_string_equal(gsn_defect_reason(2),
                        "a tear or a hole: no tissue within the section's outline");
}

static void blur_disc(struct scene *scene, int cx, int cy, int radius, double sigma)
{
    static float before[COUNT];
    const int reach = (int)ceil(3 * sigma);

    for (int c = 0; c < 3; c++) {
        memcpy(before, scene->od[c], sizeof before);
        for (int y = cy - radius; y <= cy + radius; y++)
            for (int x = cx - radius; x <= cx + radius; x++) {
                double sum = 0, weight = 0;

                if (hypot(x - cx, y - cy) > radius)
                    continue;
                for (int v = -reach; v <= reach; v++)
                    for (int u = -reach; u <= reach; u++) {
                        const double w = exp(-(u * u + v * v) / (2 * sigma * sigma));

                        sum += w * before[index_of(x + u, y + v)];
                        weight += w;
                    }
                scene->od[c][index_of(x, y)] = (float)(sum / weight);
                scene->truth[index_of(x, y)] = 1;
            }
    }
}

/* Case 38. */
TEST(a_bubble_is_found_by_its_ring)
{
    static const int radius[] = { 20, 45, 70 };

    for (size_t i = 0; i < 3; i++) {
        scene_auto scene = draw(0.3);

        blur_disc(scene, 230, 160, radius[i], 2);
        for (int y = 0; y < HEIGHT; y++)
            for (int x = 0; x < WIDTH; x++) {
                const double r = hypot(x - 230, y - 160) - radius[i];
                const double grey = 0.35 * exp(-r * r / 18);

                for (int c = 0; c < 3; c++)
                    scene->od[c][index_of(x, y)] =
                        (float)(scene->od[c][index_of(x, y)] * (r < 0 ? 0.75 : 1) + grey);
            }
        find(scene);
        CHECK(found(scene, GSN_DEFECT_BUBBLE) > 0.95);
        CHECK_NEAR(false_alarm(scene), 0, 0.01);
    }
    CHECK(strstr(gsn_defect_reason(3), "mount the slide anew and scan it again") != NULL);
}

/* Case 39: inks of four colours, as strokes of 0.8 mm across the section and beyond it. */
TEST(ink_is_not_tissue_and_not_collagen)
{
    static const double light[][3] = {
        { 200, 20, 40 }, { 30, 60, 170 }, { 20, 130, 70 }, { 25, 25, 30 }
    };

    for (size_t i = 0; i < 4; i++) {
        scene_auto scene = draw(0.3);
        double od[3];

        for (int c = 0; c < 3; c++)
            od[c] = log10(WHITE[c] / light[i][c]);
        for (int y = 20; y < 320; y++)
            for (int x = 0; x < WIDTH; x++)
                if (fabs(x - 100 - 0.7 * y) < 25)
                    add(scene, x, y, od);
        find(scene);
        CHECK(found(scene, GSN_DEFECT_INK) > 0.99);
        CHECK_NEAR(false_alarm(scene), 0, 0.005);
    }
    CHECK(strstr(gsn_defect_reason(5), "such as a pen's: wipe the slide and scan again") != NULL);
}

/* Case 40: only against other tissue, and not where tissue is smooth by nature. */
TEST(a_place_out_of_focus_is_found_and_smooth_tissue_is_not_blamed)
{
    static const double sigma[] = { 1.2, 2, 3 };

    for (size_t i = 0; i < 3; i++) {
        scene_auto scene = draw(0.3);

        blur_disc(scene, 240, 160, 40, sigma[i]);
        find(scene);
        CHECK(found(scene, GSN_DEFECT_BLUR) > 0.75);
        CHECK_NEAR(false_alarm(scene), 0, 0.002);
    }
    CHECK(strstr(gsn_defect_reason(4), "out of focus against the other sections: scan again") !=
          NULL);
}

static void line(struct scene *scene, double x0, double y0, double x1, double y1, double px,
                 double od)
{
    const double length = hypot(x1 - x0, y1 - y0);

    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            const double along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length;
            const double across = ((x - x0) * (y1 - y0) - (y - y0) * (x1 - x0)) / length;
            const double share = fmin(1, px / 2 + 0.5 - fabs(across)); /* of the pixel */
            const double grey[3] = { od * share, od * share, od * share };

            if (along >= 0 && along <= length && share > 0.3)
                add(scene, x, y, grey);
        }
}

/* Cases 28 and 48, and the hair that every slide has. */
TEST(edges_hairs_and_grains_are_told_apart)
{
    scene_auto edge = draw(0.3);
    scene_auto hair = draw(0.3);
    scene_auto grain = draw(0.3);
    const double black[3] = { 0.7, 0.72, 0.72 };

    line(edge, 5, 60, 435, 80, 2.5, 0.5);
    find(edge);
    CHECK(found(edge, GSN_DEFECT_EDGE) > 0.9);
    CHECK_NEAR(false_alarm(edge), 0, 0.002);

    line(hair, 180, 100, 230, 150, 0.75, 0.6);
    find(hair);
    CHECK(found(hair, GSN_DEFECT_HAIR) > 0.8);
    CHECK_NEAR(false_alarm(hair), 0, 0.002);

    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            if (hypot(x - 200, y - 140) < 4.5)
                add(grain, x, y, black);
    find(grain);
    CHECK(found(grain, GSN_DEFECT_DEBRIS) > 0.95);
    CHECK_NEAR(false_alarm(grain), 0, 0.002);
    CHECK(strstr(gsn_defect_reason(8), "a dark neutral grain: dust, enamel, metal") != NULL);
}

/* Case 45. */
TEST(empty_glass_has_no_outline_and_neither_has_a_smear)
{
    scene_auto scene = draw(0.3);

    memset(scene->od, 0, sizeof scene->od);
    for (int y = 100; y < 200; y++)
        for (int x = 0; x < 200; x++)
            add(scene, x, y, (const double[3]){ 0.07, 0.07, 0.07 });
    find(scene);
    CHECK_NEAR(scene->figures.outline_um2, 0, 0);
    CHECK(!(scene->figures.sharpness >= 0));
}

TEST(a_halo_is_masked_to_the_pixel_and_what_it_covers_is_no_debris)
{
    struct gsn_artefact_section section = ALL;
    struct gsn_error err = { 0 };
    scene_auto scene = draw(0.3);

    section.halo_count = 1;
    section.halo[0] = (struct gsn_artefact_disc){ .px = { 200.5, 140.25 }, .radius_px = 9.5 };
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            if (hypot(x + 0.5 - 200.5, y + 0.5 - 140.25) < 5)
                add(scene, x, y, (const double[3]){ 0.6, 0.7, 0.7 });
    CHECK_OK(find_with(scene, &section, PX_UM, 1, &err), err);
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            CHECK((label_at(scene, x, y) == GSN_DEFECT_HALO) ==
                  (hypot(x + 0.5 - 200.5, y + 0.5 - 140.25) <= 9.5));
}

TEST(a_density_that_is_masked_is_no_number)
{
    scene_auto scene = draw(0.3);
    gsn_auto(gsn_plane) density = NULL;
    struct gsn_error err = { 0 };

    fold(scene, 240, 9);
    find(scene);
    CHECK_OK(gsn_plane_new(WIDTH, HEIGHT, &density, &err), err);
    gsn_artefact_apply(scene->labels, 0, 0, 0, density);
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            CHECK((label_at(scene, x, y) != 0) == !(density->value[index_of(x, y)] == 0));
}

TEST(a_box_outside_of_the_panel_is_refused)
{
    const struct gsn_artefact_section beyond = { .x = 10, .width = WIDTH, .height = 20 };
    scene_auto scene = draw(0);
    struct gsn_error err = { 0 };

    CHECK(find_with(scene, &beyond, PX_UM, 1, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "section 1") && strstr(err.text, "reaches outside its panel"));
    CHECK(find_with(scene, &ALL, 0, 1, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "pixel size") && scene->labels == NULL);
}

static int find_and_forget(struct scene *scene, struct gsn_error *err)
{
    const struct gsn_artefact_section part = { .x = 180, .y = 100, .width = 90, .height = 80 };
    const int r = find_with(scene, &part, PX_UM, 1, err);

    gsn_artefact_labels_free(scene->labels);
    scene->labels = NULL;
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    scene_auto scene = draw(0.3);
    struct gsn_error err = { 0 };

    line(scene, 190, 110, 250, 160, 2, 0.5);
    CHECK_EVERY_OOM(find_and_forget(scene, &err), err);
}
