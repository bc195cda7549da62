/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Slides: the levels of a pyramid in one TIFF, as OpenSlide's "aperio" and "generic-tiff" have
 * them. The finest level is the first page; the others are tiled pages of the same picture made
 * smaller. Aperio's thumbnail, label and overview are not tiled, and no levels. */
#include "pipeline/decode/tiff.h"
#include "pipeline/decode/volume_header.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { MOST_LEVELS = 32 };

/* A level's sides are whole pixels, so they keep the shape of the first to a pixel. */
static const double SHAPE_PX = 1.5;
/* Pixels that differ by more than this along the two axes are not square. */
static const double SQUARE = 0.01;

struct level {
    tdir_t page;
    uint32_t width, height;
};

struct slide {
    unsigned count;
    struct level level[MOST_LEVELS]; /* finest first */
};

static const char *description(TIFF *tiff)
{
    char *text = NULL;

    return TIFFGetField(tiff, TIFFTAG_IMAGEDESCRIPTION, &text) && text ? text : "";
}

static int is_aperio(TIFF *tiff)
{
    return strncmp(description(tiff), "Aperio", 6) == 0;
}

double gsn_tiff_aperio_um(TIFF *tiff)
{
    const char *at = is_aperio(tiff) ? strstr(description(tiff), "|MPP = ") : NULL;
    struct gsn_words number = { 0 };
    double um = 0;

    if (!at)
        return 0;
    number.at = at + strlen("|MPP = ");
    number.size = strcspn(number.at, "|\r\n");
    return gsn_words_numbers(number, &um, 1) && um > 0.01 && um < 1000 ? um : 0;
}

static int has_shape(const struct level *finest, uint32_t width, uint32_t height)
{
    const double scale = (double)finest->width / width;

    return width > 0 && height > 0 && width < finest->width &&
           fabs(finest->height / scale - height) <= SHAPE_PX;
}

static void add_level(struct slide *slide, const struct level *level)
{
    unsigned at = slide->count++;

    for (; at > 0 && slide->level[at - 1].width < level->width; at--)
        slide->level[at] = slide->level[at - 1];
    slide->level[at] = *level;
}

static void find_levels(TIFF *tiff, unsigned pages, struct slide *slide)
{
    for (unsigned page = 0; page < pages && slide->count < MOST_LEVELS; page++) {
        struct level level = { .page = (tdir_t)page };

        if (!TIFFSetDirectory(tiff, (tdir_t)page) ||
            !TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &level.width) ||
            !TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &level.height))
            return;
        if (page == 0 ||
            (TIFFIsTiled(tiff) && has_shape(&slide->level[0], level.width, level.height)))
            add_level(slide, &level);
    }
}

/* Of the first page, which must be the current one. */
static int finest_um(TIFF *tiff, double *ret_um, struct gsn_error *err)
{
    struct gsn_picture stated = { 0 };
    uint16_t unit = RESUNIT_NONE;
    float x = 0, y = 0;
    double um = gsn_tiff_aperio_um(tiff);

    (void)TIFFGetField(tiff, TIFFTAG_XRESOLUTION, &x);
    (void)TIFFGetField(tiff, TIFFTAG_YRESOLUTION, &y);
    (void)TIFFGetFieldDefaulted(tiff, TIFFTAG_RESOLUTIONUNIT, &unit);
    if (um == 0 && (unit == RESUNIT_INCH || unit == RESUNIT_CENTIMETER))
        gsn_picture_pitch(&stated, (double)x, (double)y, unit == RESUNIT_INCH ? 25400 : 10000);
    if (stated.px_um_x > 0 && fabs(stated.px_um_y / stated.px_um_x - 1) > SQUARE)
        return gsn_fail(err, GSN_E_INPUT,
                        "a slide whose pixels are not square (%.4g x %.4g um): export it anew",
                        stated.px_um_x, stated.px_um_y);
    um = um > 0 ? um : stated.px_um_x;
    if (!(um > 0))
        return gsn_fail(err, GSN_E_INPUT,
                        "a slide that does not state the size of its pixels, so no level can be "
                        "measured: export it with its resolution");
    *ret_um = um;
    return GSN_OK;
}

static double level_um(const struct slide *slide, unsigned level, double um)
{
    return um * slide->level[0].width / slide->level[level].width;
}

static unsigned level_for(const struct slide *slide, double um, double target_um)
{
    unsigned level = 0;

    while (level + 1 < slide->count && level_um(slide, level + 1, um) <= target_um * (1 + SQUARE))
        level++;
    return level;
}

int gsn_tiff_choose_level(struct gsn_tiff *t, const struct gsn_decode_limits *limits,
                          struct gsn_picture *picture, struct gsn_error *err)
{
    const char *vendor = is_aperio(t->tiff) ? "Aperio slide" : "tiled slide";
    struct slide slide = { 0 };
    unsigned level = limits->level;
    double um = 0;
    int r = finest_um(t->tiff, &um, err);

    if (r < 0)
        return r;
    find_levels(t->tiff, picture->pages, &slide);
    if (limits->target_um > 0)
        level = level_for(&slide, um, limits->target_um);
    if (level >= slide.count)
        return gsn_fail(err, GSN_E_INPUT,
                        "a slide with %u level%s, so there is no level %u: say a smaller \"level\" "
                        "in job.json (0 is the finest)",
                        slide.count, slide.count == 1 ? "" : "s", level);
    if (!TIFFSetDirectory(t->tiff, slide.level[level].page))
        return gsn_fail(err, GSN_E_INPUT, "the directory of level %u cannot be read", level);
    t->slide_um = level_um(&slide, level, um);
    gsn_picture_remark(picture, "%s, level %u of %u (0 to %u), %.4g um", vendor, level, slide.count,
                       slide.count - 1, t->slide_um);
    return GSN_OK;
}
