/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/calibration_panel.h"

#include "pipeline/core/file.h"
#include "pipeline/decode/png_write.h"
#include "pipeline/phantom/calibration.h"
#include "pipeline/phantom/planning.h"
#include "pipeline/specimen/process.h"
#include "pipeline/stain/calibration.h"
#include "pipeline/stain/normalisation.h"
#include "tests/check.h"
#include "tests/memory_file.h"
#include "tests/specimen/drawn_specimen.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static const char JOB[] =
    "{\"specimen\": \"x\", \"px_um\": 24, \"transfer\": \"linear\", \"calibration\": {\"file\": "
    "\"c.png\", \"patches\": [[0, 0.25, 0.5, 0.75, 1], [\"red\", \"yellow\", \"dark\"]]}}";

static struct gsn_phantom_plan plan_of(const char *specimen, const char *level)
{
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make(specimen, level, 7, 24, &plan, &err), err);
    return plan;
}

static struct gsn_image *drawn(const struct gsn_phantom_plan *plan, int batch)
{
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_calibration_draw(plan, batch, 0, &image, &err), err);
    return image;
}

static struct gsn_protocol *parsed(const char *job)
{
    struct gsn_protocol *protocol = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_protocol_parse(job, strlen(job), &protocol, &err), err);
    return protocol;
}

static int read_as(const struct gsn_image *image, const struct gsn_protocol *protocol,
                   struct gsn_calibration_panel **ret_panel, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) png = NULL;
    size_t size;
    const int r = gsn_png_encode(image, &png, &size, err);

    return r < 0 ? r
                 : gsn_calibration_panel_read(NULL, gsn_check_fd(png, size), protocol,
                                              &protocol->calibration[0], ret_panel, err);
}

static double apart_deg(const double a[3], const double b[3])
{
    const double dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

    return acos(fmin(dot, 1)) * 180 / M_PI;
}

/* Vectors and gain against what the phantom was stained with. Returns the sum of the squares of the
 * vectors' errors in their deviations. */
static double check_batch(const struct gsn_phantom_plan *plan, int batch, double most_deg,
                          double most_gain)
{
    const struct gsn_phantom_batch *b = &plan->batch[batch - 1];
    gsn_auto(gsn_image) image = drawn(plan, batch);
    gsn_auto(gsn_protocol) protocol = parsed(JOB);
    gsn_auto(gsn_calibration_panel) panel = NULL;
    struct gsn_error err = { 0 };
    struct gsn_stain_gain gain;
    double zero, squares = 0;

    CHECK_OK(read_as(image, protocol, &panel, &err), err);
    CHECK(panel->has_dyes && panel->patch_count == 8);

    const double *seen[3] = { panel->fit.dyes.red, panel->fit.dyes.yellow, panel->fit.dyes.dark };

    CHECK_OK(gsn_calibration_gain(panel->patch, 8, &panel->fit.dyes, &gain, &zero, &err), err);
    for (int k = 0; k < 3; k++) {
        const double off = apart_deg(seen[k], b->dye[k]);

        CHECK(off <= most_deg);
        CHECK(panel->fit.deviation_deg[k] > 0 && panel->fit.deviation_deg[k] < most_deg);
        squares += off * off / panel->fit.deviation_deg[k] / panel->fit.deviation_deg[k];
    }
    CHECK_NEAR(gain.gain / b->red_gain, 1, most_gain);
    CHECK(gain.sections == 5 && gain.error > 0 && gain.error < 0.02);
    CHECK_NEAR(zero, 0, 0.01);
    return squares;
}

TEST(vectors_and_strength_are_those_the_batch_was_stained_with)
{
    static const struct {
        const char *level;
        double most_deg, most_gain;
    } levels[] = { { "L1", 0.15, 0.005 }, { "L2", 0.2, 0.005 }, { "L3", 0.3, 0.01 } };

    for (size_t i = 0; i < sizeof levels / sizeof levels[0]; i++) {
        const struct gsn_phantom_plan plan = plan_of("S04", levels[i].level);
        double squares = 0;

        for (int batch = 1; batch <= GSN_PHANTOM_PANELS; batch++)
            squares += check_batch(&plan, batch, levels[i].most_deg, levels[i].most_gain);
        print_message("  %s: errors are %.2f of their deviations\n", levels[i].level,
                      sqrt(squares / (3 * GSN_PHANTOM_PANELS)));
        CHECK(sqrt(squares / (3 * GSN_PHANTOM_PANELS)) < 1.2);
    }
}

/* A box of the picture in one colour. */
static void paint(struct gsn_image *image, struct gsn_phantom_patch box, const uint8_t colour[3])
{
    for (uint32_t y = box.y; y < box.y + box.height; y++)
        for (uint32_t x = box.x; x < box.x + box.width; x++)
            memcpy((uint8_t *)image->samples + 3 * ((size_t)y * image->width + x), colour, 3);
}

static void refused(const struct gsn_image *image, const char *sentence)
{
    gsn_auto(gsn_protocol) protocol = parsed(JOB);
    struct gsn_calibration_panel *panel = NULL;
    struct gsn_error err = { 0 };

    CHECK(read_as(image, protocol, &panel, &err) == GSN_E_STAIN);
    CHECK(panel == NULL);
    if (!strstr(err.text, sentence) || !strstr(err.text, "calibration panel c.png"))
        fail_msg("\"%s\" is not in \"%s\"", sentence, err.text);
}

TEST(a_panel_that_cannot_be_used_is_refused_with_its_patch)
{
    static const uint8_t GLASS[3] = { 248, 244, 238 }, DARK[3] = { 90, 0, 40 },
                         PALE[3] = { 244, 228, 224 };
    const struct gsn_phantom_plan plan = plan_of("S02", "L0");
    const struct gsn_phantom_patch red = gsn_phantom_dye_patch_of(&plan, GSN_PHANTOM_RED);
    const struct gsn_phantom_patch yellow = gsn_phantom_dye_patch_of(&plan, GSN_PHANTOM_YELLOW);
    const struct gsn_phantom_patch between = {
        .x = red.x, .y = red.y + red.height / 3, .width = yellow.x - red.x, .height = red.height / 3
    };
    gsn_auto(gsn_image) missing = drawn(&plan, 1);
    gsn_auto(gsn_image) clipped = drawn(&plan, 1);
    gsn_auto(gsn_image) pale = drawn(&plan, 1);
    gsn_auto(gsn_image) swapped = drawn(&plan, 1);
    gsn_auto(gsn_image) joined = drawn(&plan, 1);
    gsn_auto(gsn_image) tinted = drawn(&plan, 1);

    paint(missing, yellow, GLASS);
    refused(missing, "row 2 is stated with 3 patches, 2 were found from (");
    paint(joined, between, DARK);
    refused(joined, "row 2 is stated with 3 patches, ");
    paint(clipped, red, DARK);
    refused(clipped, "patch 1 of row 2 is clipped (100 % of it is at an end of the codes)");
    paint(pale, red, PALE);
    refused(pale, "patch 1 of row 2 (red) is too pale to have a hue");
    for (uint32_t y = 0; y < yellow.height; y++)
        memcpy((uint8_t *)swapped->samples + 3 * ((size_t)(red.y + y) * swapped->width + red.x),
               (const uint8_t *)swapped->samples +
                   3 * ((size_t)(yellow.y + y) * swapped->width + yellow.x),
               (size_t)3 * yellow.width);
    refused(swapped, "the patches of red and yellow show one dye");
    for (size_t i = 0; i < (size_t)tinted->width * tinted->height; i++)
        ((uint8_t *)tinted->samples)[3 * i + 2] /= 2;
    refused(tinted, "its glass is not white (codes 24");
}

/* Fed on its side, as its label tells. */
TEST(a_calibration_panel_on_its_side_is_set_upright)
{
    const struct gsn_phantom_plan plan = plan_of("S04", "L2");
    gsn_auto(gsn_image) image = drawn(&plan, 1);
    gsn_auto(gsn_image) lying = NULL;
    gsn_auto(gsn_protocol) protocol = parsed(JOB);
    gsn_auto(gsn_calibration_panel) a = NULL;
    gsn_auto(gsn_calibration_panel) b = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(image->height, image->width, 3, 8, &lying, &err), err);
    for (uint32_t y = 0; y < image->height; y++)
        for (uint32_t x = 0; x < image->width; x++)
            memcpy((uint8_t *)lying->samples +
                       3 * ((size_t)x * lying->width + image->height - 1 - y),
                   (const uint8_t *)image->samples + 3 * ((size_t)y * image->width + x), 3);
    CHECK_OK(read_as(image, protocol, &a, &err), err);
    CHECK_OK(read_as(lying, protocol, &b, &err), err);
    CHECK(memcmp(&a->fit.dyes, &b->fit.dyes, sizeof a->fit.dyes) == 0);
}

static int read_once(const struct gsn_image *image, const struct gsn_protocol *protocol,
                     struct gsn_error *err)
{
    gsn_auto(gsn_calibration_panel) panel = NULL;

    return read_as(image, protocol, &panel, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct gsn_phantom_plan plan = plan_of("S02", "L0");
    gsn_auto(gsn_image) image = drawn(&plan, 1);
    gsn_auto(gsn_protocol) protocol = parsed(JOB);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(read_once(image, protocol, &err), err);
}

/* ---- a specimen -------------------------------------------------------------------------- */

/* The panels of a specimen and, behind them, the calibration panels. */
struct stained {
    struct drawn_specimen drawn;
    struct gsn_specimen inner; /* reads the panels */
    uint8_t *png[3];
    size_t size[3];
    char sha256[3][65];
    const char *listed[3];
};

static int open_any(void *context, const char *sha256, int *ret_fd, struct gsn_error *err)
{
    const struct stained *s = context;

    for (size_t i = 0; i < 3; i++)
        if (strcmp(s->sha256[i], sha256) == 0)
            return gsn_memory_file(s->png[i], s->size[i], ret_fd, err);
    return s->inner.open(s->inner.context, sha256, ret_fd, err);
}

static void stained_done(struct stained *s)
{
    for (size_t i = 0; i < 3; i++)
        gsn_free(s->png[i]);
    drawn_specimen_done(&s->drawn);
}

/* Panels of density 0.5 in baths of strength 1, 1.15 and 0.85, which are what the phantom calls
 * S02, S03 and S04; the calibration panel of each comes from the same bath. */
static void stained_init(struct stained *s, const char *job, const char *const baths[3])
{
    struct drawn_panel panels[3];

    memset(s, 0, sizeof *s);
    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, 0.5 * (double[]){ 1, 1.15, 0.85 }[i]);
    drawn_specimen_init(&s->drawn, job, panels, 3);
    s->inner = s->drawn.specimen;
    for (unsigned i = 0; i < 3; i++) {
        const struct gsn_phantom_plan plan = plan_of(baths[i], "L0");
        gsn_auto(gsn_image) image = drawn(&plan, 1);
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_png_encode(image, &s->png[i], &s->size[i], &err), err);
        (void)snprintf(s->sha256[i], sizeof s->sha256[i], "%063ua", i);
        s->listed[i] = s->sha256[i];
    }
    s->drawn.specimen.open = open_any;
    s->drawn.specimen.context = s;
    s->drawn.specimen.calibration_sha256 = s->listed;
}

static struct gsn_specimen_result *worked(const struct stained *s)
{
    const struct gsn_specimen_options how = { .mesher = GSN_MESHER, .threads = 1 };
    struct gsn_specimen_result *result = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_specimen_process(&s->drawn.specimen, &how, &result, &err), err);
    return result;
}

static double mean_density(const struct gsn_specimen_result *result)
{
    for (size_t i = 0; i < result->measure_count; i++)
        if (strcmp(result->measure[i].name, "mean_density") == 0)
            return result->measure[i].value;
    return NAN;
}

#define PATCHES "\"patches\": [[0, 0.25, 0.5, 0.75, 1], [\"red\", \"yellow\", \"dark\"]]"
#define CALIBRATED(more)                                                                           \
    "{\"specimen\": \"drawn\", " DRAWN_JOB_HEAD ", \"region\": " DRAWN_REGION                      \
    ", \"calibration\": [{\"file\": \"a.png\", \"panels\": [1], " PATCHES                          \
    "}, {\"file\": \"b.png\", \"panels\": [2], " PATCHES "}" more "]}"

/* A panel's strength, with the error that is said of it. */
static void check_gain(const char *json, unsigned panel, double truth)
{
    const char *row = strstr(json, "\"stain gains\"");
    double gain = NAN, error = NAN;
    char name[20];

    assert_non_null(row);
    (void)snprintf(name, sizeof name, "panel %u: ", panel);
    row = strstr(row, name);
    assert_non_null(row);
    CHECK(sscanf(row + strlen(name), "%lf +- %lf", &gain, &error) == 2);
    CHECK(error > 0 && error < 0.005);
    CHECK_NEAR(gain, truth, 3 * error);
}

/* Case 41. */
TEST(panels_stained_unequally_read_alike_by_their_calibration_panels)
{
    static const char *const baths[3] = { "S02", "S03", "S04" };
    struct stained s __attribute__((cleanup(stained_done)));

    stained_init(&s, CALIBRATED(", {\"file\": \"c.png\", \"panels\": [3], " PATCHES "}"), baths);
    gsn_auto(gsn_specimen_result) result = worked(&s);

    CHECK(!result->withheld);
    CHECK_NEAR(mean_density(result), 0.5, 0.004);
    CHECK(strstr(result->definition, "calibration standards") != NULL);
    assert_string_equal(result->dyes, "calibrated-1");
    CHECK(strstr(result->json, "dye vectors of panel 2") != NULL);
    CHECK(strstr(result->json, "calibration panel b.png: red (") != NULL);
    CHECK(strstr(result->html, "calibration panel b.png: red (") != NULL);
    check_gain(result->json, 1, 1);
    check_gain(result->json, 2, 1.15);
    check_gain(result->json, 3, 0.85);
}

TEST(what_calibration_panels_leave_out_is_said)
{
    static const char *const baths[3] = { "S02", "S03", "S04" };
    struct stained s __attribute__((cleanup(stained_done)));

    stained_init(&s, CALIBRATED(""), baths);
    gsn_auto(gsn_specimen_result) result = worked(&s);

    CHECK(strstr(result->json, "panel 3 has no calibration panel, others have") != NULL);
    CHECK(strstr(result->json, "panel 2 has standards, other panels have none") != NULL);
    CHECK(strstr(result->definition, "calibration standards") == NULL);

    /* One that did not come withholds the figures. */
    s.listed[1] = NULL;
    gsn_auto(gsn_specimen_result) without = worked(&s);

    CHECK(without->withheld);
    CHECK(strstr(without->message, "calibration panel b.png did not come with the specimen"));
}
