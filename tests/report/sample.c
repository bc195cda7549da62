/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/report/sample.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "pipeline/core/mem.h"

enum { PANELS = 5, SLOTS = 12, SECTIONS = PANELS * SLOTS, BINS = 40, PICTURES = 5 };

struct sample {
    struct gsn_report report;
    struct gsn_report_section section[SECTIONS];
    struct gsn_report_panel panel[PANELS];
    char panel_file[PANELS][40];
    struct gsn_report_input input[PANELS + 1];
    struct gsn_report_registration registration;
    struct gsn_report_fit fit;
    struct gsn_report_units units;
    struct gsn_report_tile tile;
    size_t bin[BINS];
    struct gsn_report_picture picture[PICTURES];
    struct gsn_report_loss_map loss_map;
    struct gsn_report_aligned aligned;
    struct gsn_report_glass glass;
};

static const char digest[] = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08";

static uint32_t crc32_of(const uint8_t *bytes, size_t size)
{
    uint32_t crc = 0xFFFFFFFF;

    for (size_t i = 0; i < size; i++) {
        crc ^= bytes[i];
        for (int k = 0; k < 8; k++)
            crc = crc >> 1 ^ (0xEDB88320 & (0 - (crc & 1)));
    }
    return ~crc;
}

static uint8_t *put32(uint8_t *at, uint32_t value)
{
    for (int i = 0; i < 4; i++)
        at[i] = (uint8_t)(value >> (24 - 8 * i));
    return at + 4;
}

static uint8_t *put_chunk(uint8_t *at, const char *type, const uint8_t *bytes, size_t size)
{
    uint8_t *const start = put32(at, (uint32_t)size);

    memcpy(start, type, 4);
    if (size)
        memcpy(start + 4, bytes, size);
    return put32(start + 4 + size, crc32_of(start, 4 + size));
}

/* zlib's container with stored blocks (RFC 1950, 1951): rows with filter 0. */
static size_t store(const uint8_t *rgb, size_t width, size_t height, uint8_t *into)
{
    uint8_t *to = into;
    uint32_t a = 1, b = 0;

    *to++ = 0x78;
    *to++ = 0x01;
    for (size_t y = 0; y < height; y++) {
        const size_t length = 1 + 3 * width;

        *to++ = y + 1 == height;
        *to++ = (uint8_t)length;
        *to++ = (uint8_t)(length >> 8);
        *to++ = (uint8_t)~length;
        *to++ = (uint8_t)(~length >> 8);
        to[0] = 0;
        memcpy(to + 1, rgb + y * 3 * width, 3 * width);
        for (size_t i = 0; i < length; i++) {
            a = (a + to[i]) % 65521;
            b = (b + a) % 65521;
        }
        to += length;
    }
    return (size_t)(put32(to, b << 16 | a) - into);
}

int sample_png(const uint8_t *rgb, unsigned width, unsigned height, struct gsn_report_png *ret_png,
               struct gsn_error *err)
{
    const size_t most = (size_t)height * (6 + 3 * (size_t)width) + 16;
    gsn_auto_mem(uint8_t) packed = gsn_alloc(most);
    gsn_auto_mem(uint8_t) file = gsn_alloc(most + 100);
    uint8_t head[13] = { 0 };
    uint8_t *at;

    if (!packed || !file)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a sample picture");
    (void)put32(put32(head, width), height);
    head[8] = 8;
    head[9] = 2;
    memcpy(file, "\x89PNG\r\n\x1a\n", 8);
    at = put_chunk(file + 8, "IHDR", head, sizeof head);
    at = put_chunk(at, "IDAT", packed, store(rgb, width, height, packed));
    at = put_chunk(at, "IEND", NULL, 0);
    *ret_png =
        (struct gsn_report_png){ .size = (size_t)(at - file), .width = width, .height = height };
    ret_png->bytes = gsn_steal(&file);
    return GSN_OK;
}

static double smooth(double low, double high, double x)
{
    const double t = fmin(fmax((x - low) / (high - low), 0), 1);

    return t * t * (3 - 2 * t);
}

/* Something like a stained section: tissue, bone, a root, three burnt marks. */
static void section_colour(double x, double y, double turn, double ret[3])
{
    static const double mark[3][2] = { { -.63, -.33 }, { .52, -.48 }, { -.46, .42 } };
    const double u = x * cos(turn) - y * sin(turn), v = x * sin(turn) + y * cos(turn);
    const double tissue =
        smooth(1, .97, pow(pow(fabs(u / .82), 3) + pow(fabs(v / .64), 3), 1 / 3.));
    const double root = smooth(.3, .26, hypot((u + .03) / 1.1, v - .03));
    const double bone =
        smooth(.52, .46, hypot(u + .03, v - .03)) * (1 - smooth(.36, .3, hypot(u, v)));
    double red = tissue * (.18 + .25 * root + .55 * bone * (.8 + .2 * sin(40 * u) * sin(34 * v)));
    double yellow = tissue * (.34 - .2 * bone), dark = 0;

    for (int i = 0; i < 3; i++)
        dark += 1.1 * smooth(.045, .03, hypot(u - mark[i][0], v - mark[i][1]));
    for (int c = 0; c < 3; c++) {
        static const double dye[3][3] = { { .239, .357, .50 },
                                          { .716, .326, .60 },
                                          { .655, .875, .63 } };
        static const double white[3] = { 248, 244, 238 };

        ret[c] = white[c] * pow(10, -(red * dye[c][0] + yellow * dye[c][1] + dark * dye[c][2]));
    }
}

/* The same laid on its marks, this much beside its place. */
static void aligned_colour(double x, double y, double beside, double ret[3])
{
    section_colour(x + beside, y, 0, ret);
}

static void density_colour(double x, double y, double turn, double ret[3])
{
    const double d =
        .9 * exp(-4 * (pow(hypot(x, y * 1.2) - .45 - .1 * sin(3 * atan2(y, x) + turn), 2) * 9));

    ret[0] = 20 + 220 * d;
    ret[1] = 18 + 190 * d * d;
    ret[2] = 40 + 60 * d + 90 * d * d * d;
}

static int draw(void (*colour)(double x, double y, double turn, double ret[3]), double turn,
                unsigned width, unsigned height, struct gsn_report_png *ret_png)
{
    gsn_auto_mem(uint8_t) rgb = gsn_alloc_array((size_t)width * height, 3);

    if (!rgb)
        return GSN_E_NOMEM;
    for (size_t i = 0; i < (size_t)width * height; i++) {
        double code[3];

        colour(((double)(i % width) + .5) * 2 / width - 1,
               (((double)(i / width) + .5) * 2 - height) / width, turn, code);
        for (size_t c = 0; c < 3; c++)
            rgb[3 * i + c] = (uint8_t)fmin(fmax(code[c], 0), 255);
    }
    return sample_png(rgb, width, height, ret_png, NULL);
}

/* Code 2 in a small disc beside the middle: a fold. */
static void masked_code(double x, double y, double turn, double ret[3])
{
    (void)turn;
    ret[0] = ret[1] = ret[2] = hypot(x - .4, y + .1) < .15 ? 2 : 0;
}

/* 1 + 254 x over the right half, not known on the left; the region is a disc. */
static void density_code(double x, double y, double turn, double ret[3])
{
    (void)turn;
    ret[0] = x > 0 ? 1 + 254 * x : 0;
    ret[1] = hypot(x, y) < .5 ? 255 : 0;
    ret[2] = 0;
}

/* Large enough to be told from the small one. */
static int fill_glass(struct gsn_report_section *s, double beside, unsigned side)
{
    int r = draw(aligned_colour, beside, 2 * side, 2 * side, &s->glass);

    if (r >= 0)
        r = draw(masked_code, 0, side / 2, side / 2, &s->masked_map);
    if (r >= 0 && s->serial != 20)
        r = draw(density_code, 0, side / 2, side / 2, &s->density_map);
    return r;
}

static int fill_section(struct sample *sample, unsigned serial, unsigned picture_width)
{
    static const char *const doubtful[] = { "predicted error above 5 \xC2\xB5m",
                                            "fold, 2 % of region" };
    struct gsn_report_section *s = &sample->section[serial];
    const double turn = .25 * sin(serial * 1.7);
    int r;

    *s = (struct gsn_report_section){
        .serial = serial,
        .z_um = 24 * (serial + .5),
        .panel = serial / SLOTS + 1,
        .slot = serial % SLOTS,
        .row = serial % SLOTS / 4,
        .column = serial % 4,
        .state = "used",
        .posed = 1,
        .flipped = serial == 20,
        .rotated180 = serial == 33,
        .marker_px = { { 100.25 + serial, 200.5 }, { 300, 180.125 }, { 150.75, 400 } },
        .marker_found = { 1, 1, 1 },
        .residual_um = { .4 + fabs(sin(serial * 2.1)), .5 + fabs(sin(serial * 3.7)),
                         .3 + 1.2 * fabs(cos(serial * 1.3)) },
        .panel_to_block_um = { 16 * cos(turn), -16 * sin(turn), -2600, 16 * sin(turn),
                               16 * cos(turn), -2050.5 },
        .predicted_tre_um = 1.4 + .3 * fabs(sin(serial)),
    };
    for (int k = 0; k < 3; k++) {
        static const double mark[3][2] = { { -.63, -.33 }, { .52, -.48 }, { -.46, .42 } };
        const double way = serial + 2. * k;

        s->onto_um[k] = (struct gsn_point){ 1500 * mark[k][0], 1500 * mark[k][1] };
        s->off_um[k] =
            (struct gsn_point){ s->residual_um[k] * cos(way), s->residual_um[k] * sin(way) };
    }
    s->tissue_apart_um = 6 + 3 * sin(serial);
    s->tissue_limit_um = 31;
    if (serial == 17 || serial == 41) {
        s->state = "doubtful";
        s->flags = doubtful;
        s->flag_count = 2;
        s->marker_found[1] = serial != 17;
        s->residual_um[2] = 4.1;
        s->predicted_tre_um = 5.7;
    }
    if (serial == 29 || serial == 52) {
        s->state = serial == 29 ? "missing" : "held";
        s->posed = 0;
        memset(s->marker_found, 0, sizeof s->marker_found);
    }
    if (!picture_width || serial == 29)
        return GSN_OK;
    if (s->posed && (r = draw(aligned_colour, serial == 41 ? .06 : .004 * turn,
                              picture_width / 3 + 1, picture_width / 3 + 1, &s->aligned)) < 0)
        return r;
    if (s->posed && (r = fill_glass(s, serial == 41 ? .06 : .004 * turn, picture_width / 3)) < 0)
        return r;
    return draw(section_colour, turn, picture_width / 3 + 1, (picture_width / 3 + 1) * 7 / 8,
                &s->thumbnail);
}

static void fill_panel(struct sample *sample, unsigned i)
{
    struct gsn_report_panel *panel = &sample->panel[i];

    (void)snprintf(sample->panel_file[i], sizeof sample->panel_file[i], "GVP-D-S02-P%02u.jpg",
                   i + 1);
    *panel = (struct gsn_report_panel){
        .number = i + 1,
        .file = sample->panel_file[i],
        .sha256 = digest,
        .state = "used",
        .message = i == 4 ? "one slot was held: two sections touch" : "",
        .rows = 3,
        .columns = 4,
        .white = { 247.6, 243.9, 237.8 },
        .glass = .71,
    };
    sample->input[i] = (struct gsn_report_input){ panel->file, digest, 412345 + 991 * i };
}

static int fill_pictures(struct sample *sample, enum gsn_report_kind kind, unsigned width)
{
    static const char *const text[PICTURES][3] = {
        { "cut_xy", "Cut at z = 420 \xC2\xB5m",
          "Across the block, through the middle of the region. Bar: 500 \xC2\xB5m." },
        { "cut_xz", "Cut at y = 646 \xC2\xB5m",
          "Along the cutting direction. Bar: 500 \xC2\xB5m." },
        { "cut_yz", "Cut at x = 411 \xC2\xB5m",
          "Along the cutting direction, from the side. Bar: 500 \xC2\xB5m." },
        { "xray", "X-ray",
          "Density summed along y; exact integrals of the spline. Bar: 500 \xC2\xB5m." },
        { "surface", "Surface of density 0.5", "Seen from above left. Bar: 500 \xC2\xB5m." },
    };
    int r = GSN_OK;

    for (int i = 0; i < PICTURES && r >= 0; i++) {
        struct gsn_report_picture *picture = &sample->picture[i];

        picture->id = text[i][0];
        picture->title = text[i][1];
        picture->caption = text[i][2];
        r = draw(kind == GSN_REPORT_TILE && i == 0 ? section_colour : density_colour, i, width,
                 width * 7 / 8, &picture->png);
    }
    return r;
}

static void fill_figures(struct sample *sample)
{
    static const struct gsn_report_volume volumes[] = { { .3, .8729, .8737, .8701, .8532, .8870 },
                                                        { .5, .5826, .5834, .5812, .5650, .5974 },
                                                        { .7, .2036, .2042, NAN, NAN, NAN } };
    static const char *const warnings[] = {
        "Section 17: one of the three marks was not found; its pose rests on two marks, so a flip "
        "could not be checked.",
        "1 section of 60 is missing (serial 29). Its place stays empty at its depth and is bridged "
        "by the model.",
    };
    static const struct gsn_report_exclusion exclusions[] = {
        { "Section 29 (panel 3, slot 5)", "not delivered: the slot is empty" },
        { "Section 52 (panel 5, slot 4)",
          "held: it touches its neighbour; confirm the proposed cut" },
    };
    static const struct gsn_report_value parameters[] = {
        { "smoothing", 1e-6, "", NULL },
        { "stain", 0, "", "van-gieson-gvp-1" },
        { "tet_size", 120, "um", NULL },
        { "light", 0, "", "codes are linear" },
    };
    static const struct gsn_report_value measures[] = {
        { "Peak memory of the fit", 412.7, "MiB", NULL },
    };
    struct gsn_report *r = &sample->report;

    sample->registration =
        (struct gsn_report_registration){ 1.21, .86, 4.1, 1.62, 5.7, 58, 60, "marks+tissue", NAN };
    sample->fit =
        (struct gsn_report_fit){ 8412, 13822, 1204331, 0, 8377, .0214, .188, 1e-6, .05, 2 };
    sample->units = (struct gsn_report_units){ 0, 1, sample->bin, BINS, .031, .552, .934 };
    for (int i = 0; i < BINS; i++)
        sample->bin[i] =
            (size_t)(620 * exp(-pow((i - 21) / 6.5, 2)) + 240 * exp(-pow((i - 8) / 3., 2)));
    sample->tile = (struct gsn_report_tile){ .area_fraction = .311,
                                             .mean_density = .607,
                                             .mean_lower = .264,
                                             .mean_upper = .939,
                                             .red_share = .509,
                                             .threshold = .467,
                                             .compared = 1,
                                             .mask_name = "psr_left_mask.jpg",
                                             .dice = .875,
                                             .map_fraction = .305,
                                             .mask_fraction = .258,
                                             .false_positive = .192,
                                             .false_negative = .045 };
    r->volumes = volumes;
    r->volume_count = 3;
    r->warnings = warnings;
    r->warning_count = 2;
    r->exclusions = exclusions;
    r->exclusion_count = 2;
    r->parameters = parameters;
    r->parameter_count = 4;
    r->measures = measures;
    r->measure_count = 1;
    sample->input[PANELS] = (struct gsn_report_input){ "job.json", digest, 512 };
}

static void fill_head(struct gsn_report *r, enum gsn_report_kind kind)
{
    r->kind = kind;
    r->specimen = kind == GSN_REPORT_TILE ? "psr_left" : "GVP-D-S02";
    r->study = "Wear debris 2026";
    r->group = "UHMWPE particles";
    r->animal = "R-17";
    r->week = "8";
    r->verdict = GSN_REPORT_WARNED;
    r->verdict_reason = "2 of 60 sections are not in the model; see the warnings.";
    r->baseline = kind == GSN_REPORT_SPECIMEN ? "GVP-D-S00" : "";
    r->loss_percent = kind == GSN_REPORT_SPECIMEN ? 36.585 : (double)NAN;
    r->loss_lower = 34.08;
    r->loss_upper = 38.94;
    r->loss_interval = kind == GSN_REPORT_SPECIMEN ? "95 %, stain, white and sections" : NULL;
    r->loss_points = kind == GSN_REPORT_SPECIMEN ? 30.845 : (double)NAN;
    r->baseline_mean = .8431;
    r->zero_density = 0;
    r->density_name = "collagen-equivalent density";
    r->density_version = "van-gieson-gvp-1";
    r->area_figure = (struct gsn_report_value){ "Region above density 0.5", 59.5, "%", NULL };
    r->region =
        (struct gsn_report_region){ kind == GSN_REPORT_TILE ? (double)NAN : .9802, .53466,
                                    kind == GSN_REPORT_TILE ? (double)NAN : .992,
                                    "bone within 450 \xC2\xB5m of the ligament, near the lesion" };
    r->version = "0.1.0";
    r->key = digest;
}

static int fill(struct sample *sample, enum gsn_report_kind kind, unsigned width)
{
    struct gsn_report *r = &sample->report;
    int code = GSN_OK;

    fill_head(r, kind);
    fill_figures(sample);
    if (kind == GSN_REPORT_TILE)
        r->tile = &sample->tile;
    if (kind == GSN_REPORT_SPECIMEN) {
        for (unsigned i = 0; i < SECTIONS && code >= 0; i++)
            code = fill_section(sample, i, width);
        for (unsigned i = 0; i < PANELS; i++)
            fill_panel(sample, i);
        r->sections = sample->section;
        r->section_count = SECTIONS;
        sample->aligned = (struct gsn_report_aligned){ { -1500, -1500 }, 3000. / (width / 3 + 1) };
        r->aligned = width ? &sample->aligned : NULL;
        if (width >= 24) {
            static const char *const reasons[] = { "halo", "fold" };
            const double um = 3000. / (width / 3 * 2), coarse = 3000. / (width / 3 / 2);

            sample->glass = (struct gsn_report_glass){
                { -1500, -1500 }, { -1500, -1500 }, um, coarse, { coarse, coarse }, 0, 1, reasons, 2
            };
            r->glass = &sample->glass;
        }
        r->panels = sample->panel;
        r->panel_count = PANELS;
        r->registration = &sample->registration;
        r->inputs = sample->input;
        r->input_count = PANELS + 1;
    }
    if (kind != GSN_REPORT_TILE) {
        r->fit = &sample->fit;
        r->units = &sample->units;
    } else {
        r->volume_count = r->exclusion_count = r->warning_count = 0;
    }
    if (width && code >= 0)
        code = fill_pictures(sample, kind, width);
    if (kind == GSN_REPORT_SPECIMEN) {
        sample->loss_map =
            (struct gsn_report_loss_map){ 200, 1265, .98, 8.5, 35.5, 69.1, 3.7, NULL, 0 };
        if (width) {
            sample->loss_map.pictures = sample->picture;
            sample->loss_map.picture_count = 1;
        }
        r->loss_map = &sample->loss_map;
    }
    if (width) {
        r->pictures = sample->picture;
        r->picture_count = kind == GSN_REPORT_TILE ? 2 : PICTURES;
    }
    return code;
}

struct sample *sample_new(enum gsn_report_kind kind, unsigned picture_width)
{
    struct sample *sample = gsn_alloc_array(1, sizeof *sample);

    if (sample && fill(sample, kind, picture_width) < 0) {
        sample_free(sample);
        return NULL;
    }
    return sample;
}

void sample_free(struct sample *sample)
{
    if (!sample)
        return;
    for (int i = 0; i < SECTIONS; i++) {
        gsn_free((void *)(uintptr_t)sample->section[i].thumbnail.bytes);
        gsn_free((void *)(uintptr_t)sample->section[i].aligned.bytes);
        gsn_free((void *)(uintptr_t)sample->section[i].glass.bytes);
        gsn_free((void *)(uintptr_t)sample->section[i].masked_map.bytes);
        gsn_free((void *)(uintptr_t)sample->section[i].density_map.bytes);
    }
    for (int i = 0; i < PICTURES; i++)
        gsn_free((void *)(uintptr_t)sample->picture[i].png.bytes);
    gsn_free(sample);
}

struct gsn_report *sample_report(struct sample *sample)
{
    return &sample->report;
}
