/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Real slides with pen on them, empty ones, and one with next to nothing (shared data, which is not
 * part of the product). None of them is stained by Van Gieson. */
#include "pipeline/core/robust.h"

#include "pipeline/decode/decode.h"
#include "pipeline/stain/artefact/detection.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/stain_vectors.h"
#include "pipeline/stain/unmixing.h"
#include "tests/check.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* As dense as the palest collagen that counts, thresholds[0] of a job by default. */
#define COLLAGEN 0.3

struct seen {
    uint32_t width, height;
    struct gsn_artefact_labels *labels;
    struct gsn_plane *red, *total;
    struct gsn_artefact_figures figures;
    double clear;
    uint8_t *ink; /* 1 where a pixel can be nothing but ink */
};

static void seen_done(struct seen *s)
{
    gsn_artefact_labels_free(s->labels);
    gsn_plane_free(s->red);
    gsn_plane_free(s->total);
    gsn_free(s->ink);
}
#define seen_auto __attribute__((cleanup(seen_done))) struct seen

static uint8_t *read_shared(const char *name, size_t *ret_size)
{
    const char *shared = getenv("GIESON_SHARED");
    char path[600];
    FILE *file;
    uint8_t *bytes;
    const size_t room = 8 << 20;

    (void)snprintf(path, sizeof path, "%s/data/slides/%s", shared ? shared : GSN_SHARED, name);
    file = fopen(path, "rb");
    if (!file) {
        print_message("SKIPPED: %s is not there\n", path);
        skip();
    }
    bytes = gsn_alloc(room);
    *ret_size = fread(bytes, 1, room, file);
    (void)fclose(file);
    return bytes;
}

static double brightness(const uint8_t rgb[3])
{
    return rgb[0] + rgb[1] + rgb[2];
}

/* A white as a person would state it, of a picture without enough glass: that of the brightest
 * pixels but for the very brightest. */
static void state_white(const struct gsn_image *image, double ret_white[3])
{
    const uint8_t *rgb = image->samples;
    const size_t count = (size_t)image->width * image->height;
    gsn_auto_mem(double) sum = gsn_alloc_array(count, sizeof *sum);
    double low, high, n = 0;

    CHECK(image->channels == 3 && image->bits == 8 && sum != NULL);
    for (size_t i = 0; i < count; i++)
        sum[i] = brightness(rgb + 3 * i);
    low = gsn_order_pick(sum, count, (size_t)(0.99 * (double)(count - 1)));
    high = gsn_order_pick(sum, count, (size_t)(0.999 * (double)(count - 1)));
    memset(ret_white, 0, 3 * sizeof *ret_white);
    for (size_t i = 0; i < count; i++)
        n += brightness(rgb + 3 * i) >= low && brightness(rgb + 3 * i) <= high;
    for (size_t i = 0; i < count; i++)
        for (size_t c = 0; c < 3; c++)
            if (brightness(rgb + 3 * i) >= low && brightness(rgb + 3 * i) <= high)
                ret_white[c] += rgb[3 * i + c] / n;
}

static void look(const struct gsn_image *image, double px_um, struct seen *s)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    const struct gsn_artefact_section all = { .width = (int)image->width,
                                              .height = (int)image->height };
    struct gsn_flat_field glass;
    struct gsn_plane *od[3];
    struct gsn_error err = { 0 };
    double white[3];

    s->width = image->width;
    s->height = image->height;
    if (gsn_flat_field_estimate(image, GSN_LIGHT_CODES_LINEAR, &glass, &err) < 0) {
        state_white(image, white);
        CHECK_OK(gsn_flat_field_given(image->width, image->height, GSN_LIGHT_CODES_LINEAR, white,
                                      &glass, &err),
                 err);
    }
    CHECK_OK(gsn_od_thin(image, &glass, 1, od, &err), err);
    const struct gsn_artefact_panel panel = { image, od, &glass, &dyes, px_um, 1, &all, NULL };

    CHECK_OK(gsn_artefact_find(&panel, 1, &s->labels, &s->figures, &err), err);
    CHECK_OK(gsn_unmix(od, &dyes, 1, &s->red, NULL, NULL, &err), err);
    CHECK_OK(gsn_od_tissue(od, &glass, &s->total, &s->clear, &err), err);
    for (int c = 0; c < 3; c++)
        gsn_plane_free(od[c]);
}

/* More saturated, darker or greener than any tissue is: ink, whatever else may be ink. */
static int is_ink(const uint8_t rgb[3])
{
    const int most =
        rgb[0] > rgb[1] ? (rgb[0] > rgb[2] ? rgb[0] : rgb[2]) : (rgb[1] > rgb[2] ? rgb[1] : rgb[2]);
    const int least =
        rgb[0] < rgb[1] ? (rgb[0] < rgb[2] ? rgb[0] : rgb[2]) : (rgb[1] < rgb[2] ? rgb[1] : rgb[2]);

    return most - least > 110 || most < 90 || rgb[1] - rgb[0] > 20;
}

static void list_ink(const struct gsn_image *image, struct seen *s)
{
    const uint8_t *rgb = image->samples;
    const size_t count = (size_t)s->width * s->height;

    CHECK(image->channels == 3 && image->bits == 8);
    s->ink = gsn_alloc_array(count, 1);
    for (size_t i = 0; s->ink && i < count; i++)
        s->ink[i] = (uint8_t)is_ink(rgb + 3 * i);
}

static struct seen see(const char *name, double px_um)
{
    size_t size;
    gsn_auto_mem(uint8_t) bytes = read_shared(name, &size);
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };
    struct seen s = { 0 };

    CHECK_OK(gsn_decode(bytes, size, NULL, &picture, &err), err);
    look(picture->image, px_um, &s);
    list_ink(picture->image, &s);
    return s;
}

/* The share of the picture that counts as collagen, with and without the masks. */
static double collagen(const struct seen *s, int masked)
{
    const size_t count = (size_t)s->width * s->height;
    size_t n = 0;

    for (size_t i = 0; i < count; i++)
        n +=
            s->red->value[i] > COLLAGEN &&
            !(masked && gsn_artefact_label(s->labels, 0, (int)(i % s->width), (int)(i / s->width)));
    return (double)n / (double)count;
}

static size_t ink(const struct seen *s, int counted)
{
    const size_t count = (size_t)s->width * s->height;
    size_t n = 0;

    for (size_t i = 0; i < count; i++)
        n += s->ink[i] && (!counted || (s->red->value[i] > COLLAGEN &&
                                        !gsn_artefact_label(s->labels, 0, (int)(i % s->width),
                                                            (int)(i / s->width))));
    return n;
}

/* Case 39. A tile of 1 um pixels, blurred: red pen, black pen, and nothing else. */
TEST(pen_alone_is_no_collagen)
{
    seen_auto s = see("no-tissue-red-pen.png", 1);

    print_message("no-tissue-red-pen: %.2f %% would be collagen, %.3f %% is\n",
                  100 * collagen(&s, 0), 100 * collagen(&s, 1));
    CHECK(collagen(&s, 0) > 0.2);
    CHECK_NEAR(collagen(&s, 1), 0, 0.001);
}

TEST(pen_on_tissue_is_no_collagen)
{
    seen_auto thumb = see("diagnostic-slide-thumb-rgb.png", 16);
    seen_auto tile = see("high-nuclei-score-red-pen-level1.png", 1);

    print_message("diagnostic-slide: %.2f %% would be collagen, %.3f %% is; tile: %.2f, %.3f\n",
                  100 * collagen(&thumb, 0), 100 * collagen(&thumb, 1), 100 * collagen(&tile, 0),
                  100 * collagen(&tile, 1));
    print_message("diagnostic-slide: %zu pixels are ink, %zu of them collagen\n", ink(&thumb, 0),
                  ink(&thumb, 1));
    /* What is left there is tissue red enough by its eosin. */
    CHECK(ink(&thumb, 0) > 40000 && ink(&thumb, 1) == 0);
    CHECK_NEAR(collagen(&tile, 1), 0, 0.001);
}

/* Cases 28 and 45. */
TEST(empty_glass_and_the_edge_of_a_coverslip_are_no_tissue)
{
    seen_auto glass = see("no-tissue.png", 1);
    seen_auto line = see("no-tissue-line.png", 1);

    CHECK_NEAR(glass.figures.outline_um2, 0, 0);
    CHECK_NEAR(line.figures.outline_um2, 0, 0);
    CHECK_NEAR(collagen(&glass, 1), 0, 0.001);
    CHECK_NEAR(collagen(&line, 1), 0, 0.001);
}

/* The library's mask at its own size (a numpy array of bytes) against what is not glass. */
static double dice_with(const char *name, const struct seen *s, uint32_t width, uint32_t height)
{
    size_t size, ours = 0, theirs = 0, both = 0;
    gsn_auto_mem(uint8_t) bytes = read_shared(name, &size);
    const uint8_t *mask = bytes + size - (size_t)width * height;

    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++) {
            const size_t u = (size_t)x * s->width / width, v = (size_t)y * s->height / height;
            const int a = s->total->value[v * s->width + u] > s->clear;
            const int b = mask[(size_t)y * width + x] != 0;

            ours += (size_t)a;
            theirs += (size_t)b;
            both += a && b;
        }
    return 2.0 * (double)both / (double)(ours + theirs);
}

TEST(tissue_is_where_another_library_sees_it)
{
    seen_auto thumb = see("diagnostic-slide-thumb-rgb.png", 16);
    seen_auto edge = see("tissue-level2-3000-7666-7096-11763.png", 16);
    seen_auto kidney = see("kidney-48-5.tif", 16);
    const double a = dice_with("tissue-mask-diagnostic-slide-thumb-rgb.npy", &thumb, 468, 525);
    const double b =
        dice_with("tissue-mask-tissue-level2-3000-7666-7096-11763.npy", &edge, 512, 512);
    const double c = dice_with("tissue-mask-kidney-48-5.npy", &kidney, 149, 90);

    print_message("Dice of tissue: thumbnail %.3f, ragged edge %.3f, kidney %.3f\n", a, b, c);
    CHECK(a > 0.9 && b > 0.9);
    /* One section of 1.2 mm2 on an almost empty slide, and neither hair nor smudge. */
    CHECK(kidney.figures.outline_um2 > 1e6 && kidney.figures.outline_um2 < 1.6e6);
}
