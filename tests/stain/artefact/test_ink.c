/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Panels of six sections, stained by dyes that are not the stated ones, drawn upon by pens, and
 * looked at with and without what the tissue itself says of its dyes. */
#include "pipeline/stain/artefact/detection.h"

#include "tests/check.h"
#include "tests/stain/paint.h"

#include <string.h>

enum { COLUMNS = 3, ROWS = 2, SECTIONS = COLUMNS * ROWS, PITCH_X = 160, PITCH_Y = 130 };
enum { WIDTH = COLUMNS * PITCH_X, HEIGHT = ROWS * PITCH_Y, COUNT = WIDTH * HEIGHT };

#define PX_UM 16.0
#define NOISE 1.2 /* codes */

static const double WHITE[3] = { 248, 244, 238 };
static const double PENS[][3] = {
    { 200, 20, 40 }, { 30, 60, 170 }, { 20, 130, 70 }, { 25, 25, 30 }
};
enum { PEN_COUNT = sizeof PENS / sizeof PENS[0], NO_PEN = -1 };

struct panel {
    struct gsn_dyes dyes; /* its own */
    struct gsn_image *image;
    struct gsn_plane *od[3];
    struct gsn_flat_field glass;
    struct gsn_artefact_section section[SECTIONS];
    size_t section_count;
    uint8_t *pen; /* 2 where a pen drew, 1 within 130 um of it */
    struct gsn_artefact_labels *labels;
    struct gsn_artefact_figures figures[SECTIONS];
};

static void forget(struct panel *p)
{
    gsn_artefact_labels_free(p->labels);
    p->labels = NULL;
}

static void panel_done(struct panel *p)
{
    forget(p);
    gsn_image_free(p->image);
    gsn_free(p->pen);
    for (int c = 0; c < 3; c++)
        gsn_plane_free(p->od[c]);
}
#define panel_auto __attribute__((cleanup(panel_done))) struct panel

static void turn(double v[3], const double by[3])
{
    double length = 0;

    for (int c = 0; c < 3; c++) {
        v[c] += by[c];
        length += v[c] * v[c];
    }
    for (int c = 0; c < 3; c++)
        v[c] /= sqrt(length);
}

static double degrees(const double a[3], const double b[3])
{
    return acos(fmin(a[0] * b[0] + a[1] * b[1] + a[2] * b[2], 1)) * 180 / M_PI;
}

/* Yellow turned by eleven degrees. */
static struct gsn_dyes other_yellow(void)
{
    struct gsn_dyes dyes = gsn_dyes_builtin();

    turn(dyes.yellow, (const double[3]){ -0.19, 0.01, 0 });
    CHECK(fabs(degrees(dyes.yellow, gsn_dyes_builtin().yellow) - 11) < 1);
    return dyes;
}

/* Red half way to a red pen's. */
static struct gsn_dyes other_red(void)
{
    struct gsn_dyes dyes = gsn_dyes_builtin();

    turn(dyes.red, (const double[3]){ -0.10, 0.05, -0.02 });
    CHECK(fabs(degrees(dyes.red, gsn_dyes_builtin().red) - 6.5) < 1);
    return dyes;
}

static int in_tissue(double x, double y)
{
    return pow(fabs(x - PITCH_X / 2.0) / 66, 3) + pow(fabs(y - PITCH_Y / 2.0) / 52, 3) < 1;
}

/* A stroke of 0.5 mm across a section; its distance in pixels. */
static double from_stroke(double x, double y)
{
    return fabs(0.8 * (x - PITCH_X / 2.0) + 0.6 * (y - PITCH_Y / 2.0) - 14) - 16;
}

/* Ligament and bone, with grain; the yellow bath 1.75 times as strong. */
static void stain(const struct gsn_dyes *dyes, int x, double od[3], struct dice *dice)
{
    const double density = x < 62 ? 0.25 : 0.85;
    const double red = 0.62 * density * fmax(0.05, 1 + 0.25 * dice_normal(dice));
    const double yellow = 0.6 * (1 - 0.55 * density) * fmax(0.05, 1 + 0.25 * dice_normal(dice));

    for (int c = 0; c < 3; c++)
        od[c] = red * dyes->red[c] + yellow * dyes->yellow[c];
}

/* pen: which of PENS; on every apart-th section. */
static void draw(struct panel *p, const struct gsn_dyes *dyes, int pen, size_t apart)
{
    struct gsn_error err = { 0 };
    struct dice dice = { 5 };

    p->dyes = *dyes;
    p->section_count = SECTIONS;
    for (int i = 0; i < SECTIONS; i++)
        p->section[i] = (struct gsn_artefact_section){ .x = i % COLUMNS * PITCH_X,
                                                       .y = i / COLUMNS * PITCH_Y,
                                                       .width = PITCH_X,
                                                       .height = PITCH_Y };
    p->pen = gsn_alloc_array(COUNT, 1);
    CHECK_OK(gsn_image_new(WIDTH, HEIGHT, 3, 8, &p->image, &err), err);
    for (int at = 0; at < COUNT; at++) {
        const int x = at % WIDTH, y = at / WIDTH, u = x % PITCH_X, v = y % PITCH_Y;
        const size_t i = (size_t)(y / PITCH_Y * COLUMNS + x / PITCH_X);
        const double far = pen != NO_PEN && i % apart == 0 ? from_stroke(u, v) : 1e9;
        double od[3] = { 0, 0, 0 };

        if (in_tissue(u, v))
            stain(dyes, u, od, &dice);
        p->pen[at] = far < 0 ? 2 : far < 8;
        for (int c = 0; c < 3; c++) {
            const double ink = far < 0 ? log10(WHITE[c] / PENS[pen][c]) : 0;
            const double code = WHITE[c] * pow(10, -od[c] - ink) + NOISE * dice_normal(&dice) + 0.5;

            ((uint8_t *)p->image->samples)[3 * at + c] = (uint8_t)fmin(fmax(code, 0), 255);
        }
    }
    CHECK_OK(gsn_flat_field_given(WIDTH, HEIGHT, GSN_LIGHT_CODES_LINEAR, WHITE, &p->glass, &err),
             err);
    p->glass.noise_od = NOISE / 244 / log(10);
    CHECK_OK(gsn_od_thin(p->image, &p->glass, 1, p->od, &err), err);
}

static int find_with(struct panel *p, const struct gsn_dyes *own, struct gsn_error *err)
{
    const struct gsn_dyes stated = gsn_dyes_builtin();
    const struct gsn_artefact_panel panel = { .image = p->image,
                                              .od = p->od,
                                              .glass = &p->glass,
                                              .dyes = &stated,
                                              .px_um = PX_UM,
                                              .section_count = p->section_count,
                                              .section = p->section,
                                              .own = own };

    forget(p);
    return gsn_artefact_find(&panel, 2, &p->labels, p->figures, err);
}

static void find(struct panel *p, const struct gsn_dyes *own)
{
    struct gsn_error err = { 0 };

    CHECK_OK(find_with(p, own, &err), err);
}

/* Of the tissue that no pen is near, or of that which a pen drew on, the share that is ink. */
static double ink_of(const struct panel *p, int drawn)
{
    size_t all = 0, ink = 0;

    for (int at = 0; at < COUNT; at++) {
        const int x = at % WIDTH, y = at / WIDTH;
        const size_t i = (size_t)(y / PITCH_Y * COLUMNS + x / PITCH_X);

        if (i >= p->section_count || !in_tissue(x % PITCH_X, y % PITCH_Y) ||
            p->pen[at] != (drawn ? 2 : 0))
            continue;
        all++;
        ink += (gsn_artefact_label(p->labels, i, x, y) & GSN_DEFECT_INK) != 0;
    }
    return (double)ink / (double)all;
}

TEST(tissue_of_another_hue_is_no_ink_where_all_sections_have_it)
{
    const struct gsn_dyes dyes = other_yellow();
    panel_auto p = { 0 };

    draw(&p, &dyes, NO_PEN, 1);
    find(&p, NULL);
    CHECK(ink_of(&p, 0) > 0.3); /* by the stated dyes */
    find(&p, &dyes);
    CHECK(ink_of(&p, 0) < 0.005);
}

/* The slide's red dye explains the red pen, so its hue alone does not tell it. */
TEST(pens_are_ink_whatever_the_slides_own_dyes_are)
{
    const struct gsn_dyes dyes[] = { other_yellow(), other_red() };

    for (size_t d = 0; d < 2; d++)
        for (int pen = 0; pen < PEN_COUNT; pen++)
            for (size_t apart = 1; apart <= 3; apart += 2) {
                panel_auto p = { 0 };

                draw(&p, &dyes[d], pen, apart);
                find(&p, &dyes[d]);
                CHECK_NEAR(ink_of(&p, 1), 1, 0.001);
                CHECK(ink_of(&p, 0) < 0.01);
            }
}

/* ---- bands ---- */

enum { BANDED = 4, BAND_AT = 40, BAND = 4 }; /* the section; pixels */

/* A band of one hue over every section, so many times as wide on one of them. */
static void draw_bands(struct panel *p, const double od[3], int times)
{
    struct gsn_error err = { 0 };
    struct dice dice = { 9 };

    for (int at = 0; at < COUNT; at++) {
        const int x = at % WIDTH, y = at / WIDTH, u = x % PITCH_X, v = y % PITCH_Y;
        const int i = y / PITCH_Y * COLUMNS + x / PITCH_X;

        if (!in_tissue(u, v) || u < BAND_AT || u >= BAND_AT + BAND * (i == BANDED ? times : 1))
            continue;
        for (int c = 0; c < 3; c++)
            ((uint8_t *)p->image->samples)[3 * at + c] =
                (uint8_t)(WHITE[c] * pow(10, -od[c]) + NOISE * dice_normal(&dice) + 0.5);
    }
    for (int c = 0; c < 3; c++) {
        gsn_plane_free(p->od[c]);
        p->od[c] = NULL;
    }
    CHECK_OK(gsn_od_thin(p->image, &p->glass, 1, p->od, &err), err);
}

/* Share of the widest band that is ink. */
static double banded_ink(const struct panel *p, int times)
{
    size_t all = 0, ink = 0;

    for (int v = 0; v < PITCH_Y; v++)
        for (int u = BAND_AT; u < BAND_AT + BAND * times; u++) {
            const int x = BANDED % COLUMNS * PITCH_X + u, y = BANDED / COLUMNS * PITCH_Y + v;

            if (!in_tissue(u, v))
                continue;
            all++;
            ink += (gsn_artefact_label(p->labels, BANDED, x, y) & GSN_DEFECT_INK) != 0;
        }
    return (double)ink / (double)all;
}

/* The panel's own dyes explain both colours. One is unlike all that the sections have besides; the
 * other is 8 degrees from ordinary tissue, of which there is plenty. */
TEST(a_section_with_eight_times_its_panels_share_of_a_hue_has_ink_there)
{
    const struct gsn_dyes own = other_yellow(), stated = gsn_dyes_builtin();
    static const double amounts[][2] = { { 0, 0.5 }, { 0.15, 0.5 } };

    for (int k = 0; k < 2; k++) {
        double od[3];

        for (int c = 0; c < 3; c++)
            od[c] = amounts[k][0] * own.red[c] + amounts[k][1] * own.yellow[c];
        for (int times = 2; times <= 8; times += 6) {
            panel_auto p = { 0 };

            draw(&p, &stated, NO_PEN, 1);
            draw_bands(&p, od, times);
            find(&p, NULL);
            CHECK(banded_ink(&p, times) > 0.99); /* by the stated dyes */
            find(&p, &own);
            CHECK(times == 2 ? banded_ink(&p, times) < 0.01 : banded_ink(&p, times) > 0.99);
        }
    }
}

TEST(three_sections_outvote_no_pen)
{
    const struct gsn_dyes dyes = other_yellow();
    panel_auto p = { 0 };
    double stated;

    draw(&p, &dyes, NO_PEN, 1);
    p.section_count = 3;
    find(&p, NULL);
    stated = ink_of(&p, 0);
    find(&p, &dyes);
    CHECK_NEAR(ink_of(&p, 0), stated, 0);
    CHECK(stated > 0.3);
}

TEST(what_the_stated_dyes_explain_stays_as_it_is)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin(), other = other_yellow();
    panel_auto p = { 0 };

    draw(&p, &dyes, NO_PEN, 1);
    find(&p, &other);
    CHECK_NEAR(ink_of(&p, 0), 0, 0);
}

TEST(dyes_that_are_no_directions_are_refused)
{
    struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_error err = { 0 };
    panel_auto p = { 0 };

    draw(&p, &dyes, NO_PEN, 1);
    dyes.red[0] = 2;
    p.figures[0].outline_um2 = -7;
    CHECK(find_with(&p, &dyes, &err) == GSN_E_STAIN);
    CHECK(strstr(err.text, "not a vector of length 1") != NULL);
    CHECK(p.labels == NULL);
    CHECK_NEAR(p.figures[0].outline_um2, -7, 0);
}

static int find_and_forget(struct panel *p, struct gsn_error *err)
{
    const int r = find_with(p, &p->dyes, err);

    forget(p);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct gsn_dyes dyes = other_yellow();
    struct gsn_error err = { 0 };
    panel_auto p = { 0 };

    draw(&p, &dyes, NO_PEN, 1);
    p.section_count = 4;
    for (int i = 0; i < SECTIONS; i++) /* little of each is enough */
        p.section[i] = (struct gsn_artefact_section){
            .x = p.section[i].x + 50, .y = p.section[i].y + 40, .width = 40, .height = 40
        };
    CHECK_EVERY_OOM(find_and_forget(&p, &err), err);
}
