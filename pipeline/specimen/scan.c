/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Opens one scanned picture: decoded, its light understood, its glass measured, its colours read as
 * optical density.
 *
 * 1. A process apart decodes the picture (decode/apart.h) and reads the codes on its label.
 * 2. The pixel size is the job's, or else the file's; a difference of more than a percent is noted.
 * 3. A panel is set upright (orientation.h).
 * 4. What the samples mean as light: as the job says, else the file, else codes in proportion to
 *    light for panels and sRGB for tiles, which is noted as an assumption.
 * 5. The white is measured on blank glass (stain/flat_field.h), taken from the job, or, for a tile
 * whose tissue fills it, from its palest parts.
 * 6. Optical density of every n-th pixel, n such that two million remain; a survey has it in cells.
 *
 * The palest parts of a tile: of cells of 8 x 8 pixels the half per cent whose least channel is
 * highest. Single pixels would be noise, and a JPEG keeps the mean of a block of 8 x 8 where it
 * keeps nothing else. How far that white is off shows when four times as many cells are taken. */
#include "pipeline/specimen/scan.h"

#include "pipeline/register/panel/reduce.h"
#include "pipeline/specimen/orientation.h"
#include "pipeline/stain/artefact/dust.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/stain_sample.h"
#include "pipeline/stain/stain_vectors.h"
#include "pipeline/stain/vector_estimation.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* A file and a job that differ by more than this about the pixel size cannot both be right. */
static const double PX_UM_TOLERANCE = 0.01;

static void append_note(char *noted, size_t room, const char *text)
{
    const size_t used = strlen(noted);

    (void)snprintf(noted + used, room - used, "%s%s", used ? "; " : "", text);
}

static void add_note(struct gsn_scan *scan, const char *text)
{
    append_note(scan->note, sizeof scan->note, text);
}

static void note_profile(struct gsn_scan *scan)
{
    const struct gsn_picture *picture = scan->picture;
    char text[160];

    (void)snprintf(text, sizeof text,
                   picture->transfer == GSN_TRANSFER_ICC ? "its ICC profile is read as sRGB: %s"
                   : picture->transfer == GSN_TRANSFER_PROFILE
                       ? "samples turned into linear light by its profile \"%s\""
                       : "light as its profile \"%s\" states",
                   picture->profile);
    add_note(scan, text);
}

static enum gsn_light light_of(struct gsn_scan *scan, const struct gsn_protocol *protocol)
{
    const enum gsn_transfer stated = scan->picture->transfer;

    if (protocol->transfer == GSN_PROTOCOL_LINEAR)
        return GSN_LIGHT_CODES_LINEAR;
    if (protocol->transfer == GSN_PROTOCOL_SRGB)
        return GSN_LIGHT_SRGB;
    if (scan->picture->profile[0])
        note_profile(scan);
    else if (stated == GSN_TRANSFER_ICC)
        add_note(scan, "its ICC profile is read as sRGB: the job states the white in codes");
    if (stated == GSN_TRANSFER_PROFILE)
        return GSN_LIGHT_PROFILE;
    if (stated == GSN_TRANSFER_ICC || stated == GSN_TRANSFER_SRGB)
        return GSN_LIGHT_SRGB;
    scan->light_assumed = stated == GSN_TRANSFER_UNKNOWN;
    if (scan->light_assumed && protocol->kind == GSN_KIND_TILE)
        return GSN_LIGHT_SRGB;
    if (scan->light_assumed)
        add_note(scan, "transfer curve not stated: codes taken as linear light, as the dye vectors "
                       "were measured");
    return GSN_LIGHT_CODES_LINEAR;
}

static void note_dyes(struct gsn_scan *scan, const struct gsn_protocol *protocol)
{
    if (protocol->dyes == GSN_PROTOCOL_DYES_BUILTIN && scan->light != gsn_dyes_builtin().light)
        add_note(scan, "the built-in dye vectors are used as the job states, on samples of another "
                       "light than they were measured in");
}

static int size_of_pixels(struct gsn_scan *scan, const struct gsn_protocol *protocol,
                          struct gsn_error *err)
{
    const double x = scan->picture->px_um_x, y = scan->picture->px_um_y;
    char text[120];

    scan->px_um = protocol->px_um > 0 ? protocol->px_um : x;
    if (!(scan->px_um > 0) && protocol->kind == GSN_KIND_TILE) {
        scan->px_um = 0;
        return GSN_OK;
    }
    if (!(scan->px_um > 0))
        return gsn_fail(err, GSN_E_INPUT,
                        "the pixel size is not known: neither \"px_um\" in job.json nor a "
                        "resolution in the file");
    if (x > 0 && (fabs(x / scan->px_um - 1) > PX_UM_TOLERANCE ||
                  fabs(y / scan->px_um - 1) > PX_UM_TOLERANCE)) {
        (void)snprintf(text, sizeof text,
                       "the file states pixels of %.4g x %.4g um, the job %.4g um was used", x, y,
                       scan->px_um);
        add_note(scan, text);
    }
    return GSN_OK;
}

static int give_glass(struct gsn_scan *scan, const struct gsn_protocol *protocol,
                      enum gsn_light light, struct gsn_error *err)
{
    const struct gsn_image *image = scan->picture->image;
    const double white[3] = { 255 * protocol->white[0], 255 * protocol->white[1],
                              255 * protocol->white[2] };

    add_note(scan, "white point as stated in the job, not measured");
    return gsn_flat_field_given(image->width, image->height, light, white, &scan->glass, err);
}

/* ---- the white of a tile, by its palest parts ------------------------------------------------ */

enum { PALE_CELL = 8 };

/* Of the cells. On the picrosirius tile of liverquant, of which 2 % are fat vacuoles, the mean
 * moves by 1.5 % under JPEG 50 with this, by 3.6 with four times as many. */
static const double PALEST = 0.005;

int gsn_scan_cells(const struct gsn_image *image, uint32_t side, struct gsn_image **ret_cells,
                   struct gsn_error *err)
{
    const uint32_t width = image->width / side, height = image->height / side;
    const uint64_t n = (uint64_t)side * side, stretch = image->bits == 8 ? 257 : 1;
    gsn_auto(gsn_image) cells = NULL;
    int r;

    if (width < 1 || height < 1)
        return gsn_fail(err, GSN_E_INPUT, "a picture of %u x %u pixels is too small to be measured",
                        image->width, image->height);
    if (image->channels != 3)
        return gsn_fail(err, GSN_E_INPUT, "a grey picture tells no dyes apart");
    r = gsn_image_new(width, height, 3, 16, &cells, err);
    if (r < 0)
        return r;
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++)
            for (uint32_t c = 0; c < 3; c++) {
                uint64_t sum = 0;

                for (uint32_t k = 0; k < n; k++)
                    sum += gsn_image_at(image, x * side + k % side, y * side + k / side, c);
                ((uint16_t *)cells->samples)[((size_t)y * width + x) * 3 + c] =
                    (uint16_t)((sum * stretch + n / 2) / n);
            }
    *ret_cells = gsn_steal(&cells);
    return GSN_OK;
}

struct cell {
    uint16_t least; /* of its channels */
    uint32_t at;
};

static int compare_palest_first(const void *a, const void *b)
{
    const struct cell *one = a, *other = b;

    if (one->least != other->least)
        return one->least > other->least ? -1 : 1;
    return one->at < other->at ? -1 : one->at > other->at;
}

static int average_palest(const struct gsn_image *image, const struct gsn_image *cells,
                          enum gsn_light light, const struct cell *sorted, size_t count,
                          struct gsn_flat_field *ret_glass, struct gsn_error *err)
{
    double white[3] = { 0 };

    for (size_t i = 0; i < count; i++)
        for (size_t c = 0; c < 3; c++)
            white[c] += ((const uint16_t *)cells->samples)[3 * (size_t)sorted[i].at + c];
    for (size_t c = 0; c < 3; c++)
        white[c] *= 255.0 / 65535 / (double)count;
    if (!(white[0] >= 1 && white[1] >= 1 && white[2] >= 1))
        return gsn_fail(err, GSN_E_STAIN,
                        "this picture is dark everywhere: no part of it is pale enough to tell how "
                        "bright the empty slide is");
    return gsn_flat_field_given(image->width, image->height, light, white, ret_glass, err);
}

static double share_clipped(const struct gsn_image *image, const struct gsn_image *cells,
                            const struct cell *sorted, size_t count)
{
    const unsigned top = image->bits == 8 ? 255 : 65535;
    size_t clipped = 0;

    for (size_t i = 0; i < count; i++) {
        const uint32_t x = PALE_CELL * (sorted[i].at % cells->width);
        const uint32_t y = PALE_CELL * (sorted[i].at / cells->width);

        for (uint32_t k = 0; k < PALE_CELL * PALE_CELL; k++)
            for (uint32_t c = 0; c < 3; c++)
                clipped += gsn_image_at(image, x + k % PALE_CELL, y + k / PALE_CELL, c) == top;
    }
    return (double)clipped / (double)(count * PALE_CELL * PALE_CELL * 3);
}

/* Fails with GSN_E_STAIN when the picture is black, GSN_E_INPUT when it is grey or has less than
 * one cell of 8 x 8 pixels, GSN_E_NOMEM. */
static int find_palest(const struct gsn_image *image, enum gsn_light light,
                       struct gsn_palest *ret_palest, struct gsn_error *err)
{
    struct gsn_palest palest = { .share = 0 };
    gsn_auto(gsn_image) cells = NULL;
    gsn_auto_mem(struct cell) sorted = NULL;
    size_t all, count, more;
    int r = gsn_scan_cells(image, PALE_CELL, &cells, err);

    if (r < 0)
        return r;
    all = (size_t)cells->width * cells->height;
    count = (size_t)fmax(1, PALEST * (double)all);
    more = 4 * count < all ? 4 * count : all;
    sorted = gsn_alloc_array(all, sizeof *sorted);
    if (!sorted)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the white of a picture");
    for (size_t i = 0; i < all; i++) {
        const uint16_t *code = &((const uint16_t *)cells->samples)[3 * i];
        const uint16_t least = code[0] < code[1] ? code[0] : code[1];

        sorted[i] = (struct cell){ .least = least < code[2] ? least : code[2], .at = (uint32_t)i };
    }
    qsort(sorted, all, sizeof *sorted, compare_palest_first);
    r = average_palest(image, cells, light, sorted, count, &palest.glass, err);
    if (r >= 0)
        r = average_palest(image, cells, light, sorted, more, &palest.darker, err);
    if (r < 0)
        return r;
    palest.share = (double)count / (double)all;
    palest.clipped = share_clipped(image, cells, sorted, count);
    *ret_palest = palest;
    return GSN_OK;
}

/* ---- which side is up -------------------------------------------------------------------- */

static int survey_picture(struct gsn_scan *scan, const struct gsn_protocol *protocol,
                          struct gsn_error *err);

/* Surveyed as it lies, for the grid and the marks; what is noted on the way comes again. */
static int survey_round(struct gsn_scan *scan, const struct gsn_protocol *protocol,
                        struct gsn_dust_turn *ret_turn, const char **ret_why, struct gsn_error *err)
{
    char noted[sizeof scan->note];
    int r;

    memcpy(noted, scan->note, sizeof noted);
    r = survey_picture(scan, protocol, err);
    if (r >= 0)
        r = gsn_orientation_find(scan, protocol, ret_turn, ret_why, err);
    gsn_plane_free(scan->total);
    scan->total = NULL;
    memcpy(scan->note, noted, sizeof noted);
    return r;
}

static void say_of_turn(struct gsn_orientation *upright, const char *text)
{
    append_note(upright->note, sizeof upright->note, text);
}

/* why: by what it was told; NULL: by the code alone. */
static void note_turn(struct gsn_orientation *upright, const char *why)
{
    char text[160];

    if (upright->turn.mirrored)
        say_of_turn(upright, why ? "mirrored back as a whole"
                                 : "mirrored back as a whole: the code on its label was mirrored");
    if (upright->turn.quarters == 2 && !why)
        say_of_turn(upright, "turned by 180 degrees: the code on its label stood on its head");
    if (!why || (upright->turn.quarters == 0 && !upright->turn.mirrored))
        return;
    (void)snprintf(text, sizeof text, "turned by %u degrees clockwise: %s",
                   90 * upright->turn.quarters, why);
    say_of_turn(upright, text);
}

static int find_turn(struct gsn_scan *scan, const struct gsn_protocol *protocol,
                     struct gsn_error *err)
{
    const char *why = NULL;
    int r = GSN_OK;

    scan->upright.turn = gsn_orientation_by_code(scan->picture);
    if (gsn_orientation_asks(scan->picture, protocol))
        r = survey_round(scan, protocol, &scan->upright.turn, &why, err);
    if (r >= 0)
        note_turn(&scan->upright, why);
    return r;
}

static int set_upright(struct gsn_scan *scan, const struct gsn_protocol *protocol,
                       const struct gsn_orientation *known, struct gsn_error *err)
{
    int r = GSN_OK;

    if (protocol->kind != GSN_KIND_SECTIONS)
        return GSN_OK;
    if (known)
        scan->upright = *known;
    else
        r = find_turn(scan, protocol, err);
    if (r >= 0)
        r = gsn_orientation_turn(scan->picture, scan->upright.turn, err);
    if (r >= 0 && scan->upright.note[0])
        add_note(scan, scan->upright.note);
    return r;
}

/* Everything but glass and density. */
static int read_scan(struct gsn_decoder *decoder, int picture_fd,
                     const struct gsn_protocol *protocol, const struct gsn_orientation *upright,
                     struct gsn_scan **ret_scan, struct gsn_error *err)
{
    gsn_auto(gsn_scan) scan = gsn_alloc_array(1, sizeof *scan);
    /* A white that the job states is one of the file's codes, which a profile would move. */
    const struct gsn_decode_limits plain = {
        .light = protocol->transfer == GSN_PROTOCOL_TRANSFER_UNKNOWN && !protocol->has_white,
        .slide = protocol->target_um > 0 || !isnan(protocol->level),
        .level = isnan(protocol->level) ? 0 : (unsigned)protocol->level,
        .target_um = protocol->target_um
    };
    struct gsn_decode_limits limits = plain;
    int r;

    if (!scan)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a scan");
    limits.codes = protocol->kind == GSN_KIND_SECTIONS && !upright;
    r = gsn_decode_apart(decoder, picture_fd, &limits, &scan->picture, err);
    /* Readers of codes are as old as decoders: one that falls over must not cost the panel. */
    if ((r == GSN_E_INPUT || r == GSN_E_LIMIT) && limits.codes &&
        gsn_decode_apart(decoder, picture_fd, &plain, &scan->picture, NULL) >= 0) {
        say_of_turn(&scan->upright,
                    "the code on its label could not be read: the reader failed on this picture");
        r = GSN_OK;
    }
    if (r < 0)
        return r;
    if (scan->picture->withheld[0])
        return gsn_fail(err, GSN_E_STAIN,
                        "its camera says that colours must not be measured (%s): lock the camera "
                        "and take the panel again",
                        scan->picture->withheld);
    if (scan->picture->image->channels != 3)
        return gsn_fail(err, GSN_E_INPUT,
                        "a grey picture: collagen needs colour; scan again as RGB");
    r = size_of_pixels(scan, protocol, err);
    if (r < 0)
        return r;
    r = set_upright(scan, protocol, upright, err);
    if (r < 0)
        return r;
    *ret_scan = gsn_steal(&scan);
    return GSN_OK;
}

/* A tile is small, and all of it is mapped; of a panel two million pixels tell dyes, tissue and
 * noise as well as fifty do. */
static unsigned apart_of(const struct gsn_image *image, const struct gsn_protocol *protocol)
{
    const double most = 1 << 21, pixels = (double)image->width * image->height;

    return protocol->kind == GSN_KIND_TILE ? 1 : (unsigned)ceil(sqrt(fmax(pixels / most, 1)));
}

/* Of a tile whose tissue fills it. */
static int take_palest(struct gsn_scan *scan, struct gsn_error *err)
{
    const int r = find_palest(scan->picture->image, scan->light, &scan->palest, err);

    if (r < 0)
        return r;
    scan->by_palest = 1;
    scan->glass = scan->palest.glass;
    return GSN_OK;
}

static int find_glass(struct gsn_scan *scan, const struct gsn_protocol *protocol,
                      struct gsn_error *err)
{
    int r;

    if (protocol->has_white)
        return give_glass(scan, protocol, scan->light, err);
    r = gsn_flat_field_estimate(scan->picture->image, scan->light, &scan->glass, err);
    return r == GSN_E_STAIN && protocol->kind == GSN_KIND_TILE ? take_palest(scan, err) : r;
}

int gsn_scan_open(struct gsn_decoder *decoder, int picture_fd, const struct gsn_protocol *protocol,
                  const struct gsn_orientation *upright, struct gsn_scan **ret_scan,
                  struct gsn_error *err)
{
    gsn_auto(gsn_scan) scan = NULL;
    int r = read_scan(decoder, picture_fd, protocol, upright, &scan, err);

    if (r < 0)
        return r;
    scan->light = light_of(scan, protocol);
    note_dyes(scan, protocol);
    r = find_glass(scan, protocol, err);
    scan->apart = apart_of(scan->picture->image, protocol);
    if (r >= 0)
        r = gsn_od_thin(scan->picture->image, &scan->glass, scan->apart, scan->od, err);
    if (r < 0)
        return r;
    *ret_scan = gsn_steal(&scan);
    return GSN_OK;
}

/* First on a picture of at most COARSE pixels across, where the fit costs nothing; a panel so
 * crowded that little glass is left in cells that large is looked at more closely. */
static int survey_glass(const struct gsn_image *small, enum gsn_light light,
                        struct gsn_flat_field *ret_glass, struct gsn_error *err)
{
    enum { COARSE = 128 };
    const uint32_t longest = small->width > small->height ? small->width : small->height;
    const unsigned step = (longest + COARSE - 1) / COARSE;
    gsn_auto(gsn_image) coarse = NULL;
    int r = GSN_E_STAIN;

    if (step > 1 && small->width / step >= 16 && small->height / step >= 16) {
        r = gsn_panel_reduce(small, step, &coarse, err);
        if (r >= 0)
            r = gsn_flat_field_estimate(coarse, light, ret_glass, NULL);
    }
    return r == GSN_E_STAIN ? gsn_flat_field_estimate(small, light, ret_glass, err) : r;
}

/* The glass stands in parts of the picture, so it fits the same picture at any size. */
static int survey_picture(struct gsn_scan *scan, const struct gsn_protocol *protocol,
                          struct gsn_error *err)
{
    const struct gsn_image *image = scan->picture->image;
    const enum gsn_light light = scan->light = light_of(scan, protocol);
    gsn_auto(gsn_image) small = NULL;
    struct gsn_flat_field glass;
    int r;

    note_dyes(scan, protocol);
    scan->step = gsn_panel_step(scan->px_um);
    r = gsn_panel_reduce(image, scan->step, &small, err);
    if (r < 0)
        return r;
    if (protocol->has_white)
        r = give_glass(scan, protocol, light, err);
    else
        r = survey_glass(small, light, &scan->glass, err);
    if (r < 0)
        return r;
    glass = scan->glass;
    glass.width = small->width;
    glass.height = small->height;
    scan->glass.width = image->width;
    scan->glass.height = image->height;
    return gsn_od_total(small, &glass, &scan->total, err);
}

int gsn_scan_survey(struct gsn_decoder *decoder, int picture_fd,
                    const struct gsn_protocol *protocol, const struct gsn_orientation *upright,
                    struct gsn_scan **ret_scan, struct gsn_error *err)
{
    gsn_auto(gsn_scan) scan = NULL;
    int r = read_scan(decoder, picture_fd, protocol, upright, &scan, err);

    if (r >= 0)
        r = survey_picture(scan, protocol, err);
    if (r < 0)
        return r;
    *ret_scan = gsn_steal(&scan);
    return GSN_OK;
}

void gsn_scan_free(struct gsn_scan *scan)
{
    if (!scan)
        return;
    gsn_picture_free(scan->picture);
    for (size_t c = 0; c < 3; c++)
        gsn_plane_free(scan->od[c]);
    gsn_plane_free(scan->total);
    gsn_free(scan);
}

/* What the slide itself says of its dyes. */
static int infer_dyes(const struct gsn_stain_sample *sample, const struct gsn_dyes_prior *prior,
                      struct gsn_dyes_fit *ret_fit, struct gsn_error *err)
{
    struct gsn_stain_look look;
    const int r = gsn_stain_look(sample, &look, err);

    return r < 0 ? r : gsn_dyes_estimate(sample, prior, ret_fit, err);
}

int gsn_scan_dyes(const struct gsn_scan *scan, const struct gsn_image *tissue,
                  const struct gsn_protocol *protocol, struct gsn_dyes_fit *ret_fit,
                  struct gsn_error *err)
{
    const struct gsn_dyes_prior prior = gsn_dyes_prior_builtin(scan->glass.light);
    const int is_tile = protocol->kind == GSN_KIND_TILE;
    gsn_auto(gsn_stain_sample) sample = NULL;
    struct gsn_stain_look look;
    double apart_deg = 0;
    int r = gsn_stain_sample_new(&sample, err);

    if (r >= 0)
        r = gsn_stain_sample_add(sample, scan->od, tissue, &scan->glass, err);
    if (r >= 0)
        r = is_tile ? gsn_stain_look(sample, &look, err)
                    : gsn_stain_fits(sample, &prior.dyes, &apart_deg, err);
    if (r >= 0 && is_tile)
        r = gsn_stain_apart(sample, &prior.dyes, &apart_deg, err);
    if (r < 0)
        return r;
    if (protocol->dyes == GSN_PROTOCOL_DYES_ESTIMATE ||
        (protocol->dyes == GSN_PROTOCOL_DYES_NONE && !is_tile &&
         gsn_dyes_builtin().light != scan->glass.light))
        return infer_dyes(sample, &prior, ret_fit, err);
    *ret_fit = is_tile ? gsn_dyes_as_stated(&prior) : (struct gsn_dyes_fit){ .dyes = prior.dyes };
    ret_fit->apart_deg = apart_deg;
    return GSN_OK;
}
