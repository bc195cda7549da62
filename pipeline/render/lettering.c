/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Letters by cairo and pango, from font files that we name, and the lettered sheet of a picture.
 *
 * Method: fontconfig is told of two files and of nothing else, so that neither what is installed
 * nor somebody's fonts.conf nor a cache decides what a report looks like, and a sandbox needs to
 * show no more than those files. Pango lays a line out and cairo draws it as weights of 8 bits,
 * which are mixed into the picture. Edges are grey, hinted along the vertical alone, whatever the
 * screen of this machine would like.
 *
 * A sheet has the title above, the colour scale to the right, a scale bar and a note below; the
 * scale bar has the largest length of 1, 2 or 5 times a power of ten that fits. What a line of
 * letters needs is measured, and the sheet is made as wide as that.
 *
 * Failure: GSN_E_NOTFOUND where a font is missing, GSN_E_INPUT where it is damaged, what a read
 * says where it cannot be read; GSN_E_NOMEM as far as cairo says so (glib ends the process itself).
 * Cost: a lettering reads two files of 0.7 MB, and so does a sheet; a line of text its box. */
#include "pipeline/render/lettering.h"

#include <fontconfig/fontconfig.h>
#include <math.h>
#include <pango/pangofc-fontmap.h>
#include <stdio.h>

#include "pipeline/core/file.h"
#include "pipeline/render/lettering_internal.h"

enum { MOST_BYTES = 16 << 20 }; /* of a font */

struct gsn_lettering {
    PangoFontMap *map;
    PangoContext *context;
};

/* fontconfig does not say why it takes no file: reading it does. */
static int add_font(FcConfig *fonts, const char *folder, const char *name, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", folder, name);
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0;

    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the name of a font");
    if (FcConfigAppFontAddFile(fonts, (const FcChar8 *)path))
        return GSN_OK;
    if (gsn_file_read(path, MOST_BYTES, &bytes, &size, err))
        return gsn_fail_at(err,
                           "pictures are lettered with a font of the package fonts-dejavu-core");
    if (!FcConfigAppFontAddFile(fonts, (const FcChar8 *)path))
        return gsn_fail(err, GSN_E_INPUT,
                        "the font %s is damaged, and pictures are lettered with it: install the "
                        "package fonts-dejavu-core again",
                        path);
    return GSN_OK;
}

static void set_edges(PangoContext *context, cairo_hint_style_t hints, cairo_hint_metrics_t metrics)
{
    cairo_font_options_t *edges = cairo_font_options_create();

    cairo_font_options_set_antialias(edges, CAIRO_ANTIALIAS_GRAY);
    cairo_font_options_set_hint_style(edges, hints);
    cairo_font_options_set_hint_metrics(edges, metrics);
    pango_cairo_context_set_font_options(context, edges);
    cairo_font_options_destroy(edges);
}

/* Pango starts fontconfig too, which would read all fonts of the machine and its caches if it had
 * no configuration yet. */
static void know_no_fonts(void)
{
    FcConfig *none = FcConfigCreate();

    if (none) {
        (void)FcConfigSetCurrent(none);
        FcConfigDestroy(none);
    }
}

int gsn_lettering_new(const char *folder, struct gsn_lettering **ret_lettering,
                      struct gsn_error *err)
{
    gsn_auto(gsn_lettering) lettering = gsn_alloc_array(1, sizeof *lettering);
    FcConfig *fonts = lettering ? FcConfigCreate() : NULL;
    int r;

    if (!fonts)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for letters");
    know_no_fonts();
    r = add_font(fonts, folder, "DejaVuSans.ttf", err);
    if (r >= 0)
        r = add_font(fonts, folder, "DejaVuSans-Bold.ttf", err);
    if (r >= 0) {
        lettering->map = pango_cairo_font_map_new_for_font_type(CAIRO_FONT_TYPE_FT);
        pango_fc_font_map_set_config(PANGO_FC_FONT_MAP(lettering->map), fonts);
        lettering->context = pango_font_map_create_context(lettering->map);
        set_edges(lettering->context, CAIRO_HINT_STYLE_SLIGHT, CAIRO_HINT_METRICS_ON);
        *ret_lettering = gsn_steal(&lettering);
    }
    FcConfigDestroy(fonts);
    return r;
}

enum { PATIENCE = 20000, NAP_US = 100 }; /* two seconds */

/* Pango looks for fonts in a thread of its own, which says what it found before it is done: it
 * still looks into the map's tables then, and holds the map until it no longer does.
 * Returns whether nobody else holds it. */
static int wait_for_pango(PangoFontMap *map)
{
    gint *const holders = (gint *)&G_OBJECT(map)->ref_count;

    for (int i = 0; g_atomic_int_get(holders) > 1 && i < PATIENCE; i++)
        g_usleep(NAP_US);
    return g_atomic_int_get(holders) == 1;
}

void gsn_lettering_free(struct gsn_lettering *lettering)
{
    if (!lettering)
        return;
    g_clear_object(&lettering->context);
    /* A map of pango 1.50 never lets go of its configuration; to take it away throws its tables
     * away too. Where its thread is not done with them some memory is lost instead. */
    if (lettering->map && wait_for_pango(lettering->map))
        pango_fc_font_map_set_config(PANGO_FC_FONT_MAP(lettering->map), NULL);
    g_clear_object(&lettering->map);
    gsn_free(lettering);
}

void gsn_lettering_for_paper(struct gsn_lettering *lettering)
{
    set_edges(lettering->context, CAIRO_HINT_STYLE_NONE, CAIRO_HINT_METRICS_OFF);
    pango_context_set_round_glyph_positions(lettering->context, FALSE);
}

static PangoFontDescription *describe_face(enum gsn_face face, double px)
{
    PangoFontDescription *said = pango_font_description_from_string(
        face == GSN_FACE_BOLD ? "DejaVu Sans Bold" : "DejaVu Sans");

    pango_font_description_set_absolute_size(said, px * PANGO_SCALE);
    return said;
}

/* The text as the face can show it; what steers the direction of writing is named too. */
static GString *name_missing(PangoFont *font, const char *text, int lines)
{
    char *valid = g_utf8_make_valid(text, -1);
    GString *shown = g_string_new(NULL);

    for (const char *c = valid; *c; c = g_utf8_next_char(c)) {
        const gunichar code = g_utf8_get_char(c);

        if (lines && code == '\n')
            g_string_append_c(shown, '\n');
        else if (g_unichar_iscntrl(code) || g_unichar_type(code) == G_UNICODE_FORMAT ||
                 !pango_font_has_char(font, code))
            g_string_append_printf(shown, "[U+%04X]", code);
        else
            g_string_append_unichar(shown, code);
    }
    g_free(valid);
    return shown;
}

PangoLayout *gsn_lettering_layout(struct gsn_lettering *lettering, enum gsn_face face, double px,
                                  const char *text, double width)
{
    PangoFontDescription *said = describe_face(face, px);
    PangoFont *font = pango_context_load_font(lettering->context, said);
    PangoLayout *layout = pango_layout_new(lettering->context);
    GString *shown = name_missing(font, text, width > 0);

    pango_layout_set_font_description(layout, said);
    if (width > 0)
        pango_layout_set_width(layout, (int)(width * PANGO_SCALE));
    pango_layout_set_wrap(layout, PANGO_WRAP_WORD_CHAR);
    pango_layout_set_text(layout, shown->str, (int)shown->len);
    g_string_free(shown, TRUE);
    g_object_unref(font);
    pango_font_description_free(said);
    return layout;
}

int gsn_lettering_width(struct gsn_lettering *lettering, enum gsn_face face, double px,
                        const char *text)
{
    PangoLayout *layout = gsn_lettering_layout(lettering, face, px, text, 0);
    int width;

    pango_layout_get_size(layout, &width, NULL);
    g_object_unref(layout);
    return PANGO_PIXELS_CEIL(width);
}

int gsn_lettering_height(struct gsn_lettering *lettering, enum gsn_face face, double px)
{
    PangoLayout *layout = gsn_lettering_layout(lettering, face, px, "", 0);
    int height;

    pango_layout_get_size(layout, NULL, &height);
    g_object_unref(layout);
    return PANGO_PIXELS_CEIL(height);
}

int gsn_lettering_draw(struct gsn_lettering *lettering, struct gsn_image *image, int x, int y,
                       enum gsn_face face, double px, const char *text, struct gsn_colour colour,
                       struct gsn_error *err)
{
    PangoLayout *layout = gsn_lettering_layout(lettering, face, px, text, 0);
    PangoRectangle ink, line;
    cairo_surface_t *weights;
    cairo_t *cairo;
    int r;

    pango_layout_get_pixel_extents(layout, &ink, &line);
    /* No wider than what is left of the picture: a surface has its limits. */
    weights = cairo_image_surface_create(
        CAIRO_FORMAT_A8, CLAMP((int)image->width - x - ink.x, 0, ink.width), ink.height);
    cairo = cairo_create(weights);
    cairo_translate(cairo, -ink.x, -ink.y);
    pango_cairo_show_layout(cairo, layout);
    r = cairo_status(cairo) == CAIRO_STATUS_SUCCESS
            ? gsn_canvas_ink(image, x + ink.x, y + ink.y, weights, colour, err)
            : gsn_fail(err, GSN_E_NOMEM, "out of memory while drawing letters");
    cairo_destroy(cairo);
    cairo_surface_destroy(weights);
    g_object_unref(layout);
    return r;
}

const char *gsn_lettering_cairo(void)
{
    return cairo_version_string();
}

const char *gsn_lettering_pango(void)
{
    return pango_version_string();
}

/* --- the sheet a picture is mounted on --- */

static const struct gsn_colour paper = { 255, 255, 255 };
static const struct gsn_colour ink = { 40, 40, 46 };
static const struct gsn_colour faint = { 200, 200, 204 };

static const double title_px = 13, label_px = 12; /* as the words of the page around */

enum {
    MARGIN = 12,
    GAP = 4, /* between a line of letters and what it belongs to */
    TICK = 3,
    BAR = 14,         /* width of the colour scale */
    LEAST_WIDTH = 96, /* of a sheet, so that a picture of few pixels still carries its letters */
};

/* A frame one pixel wide, outside of the box. */
static void draw_frame(struct gsn_image *image, int x, int y, int width, int height,
                       struct gsn_colour colour)
{
    gsn_canvas_box(image, x - 1, y - 1, width + 2, 1, colour);
    gsn_canvas_box(image, x - 1, y + height, width + 2, 1, colour);
    gsn_canvas_box(image, x - 1, y, 1, height, colour);
    gsn_canvas_box(image, x + width, y, 1, height, colour);
}

static int larger_of(int a, int b)
{
    return a > b ? a : b;
}

/* 1, 2 or 5 times a power of ten: the smallest that is not below. */
static double round_step(double least)
{
    const double power = pow(10.0, floor(log10(least)));
    const double digit = least / power;

    return power * (digit <= 1.0 ? 1.0 : digit <= 2.0 ? 2.0 : digit <= 5.0 ? 5.0 : 10.0);
}

/* Just the digits that multiples of the step have. */
static void write_number(char *text, size_t size, double value, double step)
{
    const int digits = (int)fmax(0.0, ceil(-log10(step) - 1e-9));

    if (fabs(value) >= 1e6 || digits > 5)
        (void)snprintf(text, size, "%.3g", value);
    else
        (void)snprintf(text, size, "%.*f", digits, value);
}

/* The largest round length of at most most_px. */
static void measure_scale_bar(double um_per_px, int most_px, int *ret_px, char label[32])
{
    const double most_um = um_per_px * most_px, power = pow(10.0, floor(log10(most_um)));
    const double digit = most_um / power;
    const double um = power * (digit >= 5.0 ? 5.0 : digit >= 2.0 ? 2.0 : 1.0);

    *ret_px = (int)(um / um_per_px + 0.5);
    if (um >= 1000.0)
        (void)snprintf(label, 32, "%g mm", um / 1000.0);
    else
        (void)snprintf(label, 32, "%g \xc2\xb5m", um);
}

/* The numbers beside a colour scale: multiples of a round step, no nearer than their letters. */
struct ticks {
    double step, first;
    int count;
};

static struct ticks place_ticks(double low, double high, int height, int line)
{
    const double step = round_step((high - low) / fmax(1.0, fmin(6.0, height / (1.2 * line))));
    const double first = ceil(low / step - 1e-9);

    return (struct ticks){ step, first, (int)(floor(high / step + 1e-9) - first) + 1 };
}

/* + 0.0 makes a zero of a minus zero. */
static double tick_value(const struct ticks *ticks, int k, char label[32])
{
    const double value = (ticks->first + k) * ticks->step + 0.0;

    write_number(label, 32, value, ticks->step);
    return value;
}

/* Where everything on a sheet lies; see gsn_plate_new(). */
struct layout {
    int line, x, y, width, height; /* of a line of letters; of the picture */
    int bar_x, bar_y, bar_height;
    struct ticks ticks;
    int scale_px; /* 0: no scale bar */
    char scale_label[32];
    int note_x, foot_y, sheet_width, sheet_height;
};

/* To the right of the colour scale, and of what stands above it. */
static int measure_scale(struct gsn_lettering *letters, const struct gsn_plate *plate,
                         const struct ticks *ticks)
{
    int most = 0;

    for (int k = 0; k < ticks->count; k++) {
        char label[32];

        (void)tick_value(ticks, k, label);
        most = larger_of(most, gsn_lettering_width(letters, GSN_FACE_PLAIN, label_px, label));
    }
    most += BAR + TICK + GAP;
    return plate->unit ? larger_of(most, gsn_lettering_width(letters, GSN_FACE_PLAIN, label_px,
                                                             plate->unit))
                       : most;
}

static void lay_out(struct gsn_lettering *letters, const struct gsn_plate *plate, struct layout *at)
{
    const int has_bar = plate->um_per_px > 0.0;
    const int title = gsn_lettering_height(letters, GSN_FACE_BOLD, title_px);
    int body = at->width, head = 0, foot = 0;

    at->line = gsn_lettering_height(letters, GSN_FACE_PLAIN, label_px);
    at->x = MARGIN;
    at->y = MARGIN;
    if (plate->title) {
        head = gsn_lettering_width(letters, GSN_FACE_BOLD, title_px, plate->title);
        at->y += title + GAP;
    }
    if (plate->has_scale) {
        at->bar_x = at->x + at->width + MARGIN;
        at->bar_y = at->y + (plate->unit ? at->line + 2 * GAP : at->line / 2);
        at->bar_height = larger_of(3 * at->line, at->y + at->height - at->line / 2 - at->bar_y);
        at->ticks = place_ticks(plate->low, plate->high, at->bar_height, at->line);
        body += MARGIN + measure_scale(letters, plate, &at->ticks);
        at->sheet_height = at->bar_y + at->bar_height + at->line / 2;
    }
    if (has_bar) {
        measure_scale_bar(plate->um_per_px, larger_of(at->width / 4, 40), &at->scale_px,
                          at->scale_label);
        foot = larger_of(at->scale_px,
                         gsn_lettering_width(letters, GSN_FACE_PLAIN, label_px, at->scale_label));
    }
    if (plate->note) {
        const int note = gsn_lettering_width(letters, GSN_FACE_PLAIN, label_px, plate->note);

        /* The scale bar, a gap and the note side by side, the note to the right if there is room.
         */
        foot += note + (has_bar ? 2 * MARGIN : 0);
        at->note_x = at->x + larger_of(at->width, foot) - note;
    }
    at->sheet_height = larger_of(at->sheet_height, at->y + at->height);
    at->foot_y = at->sheet_height + 2 * GAP;
    if (has_bar || plate->note)
        at->sheet_height = at->foot_y + at->line + (has_bar ? GAP : 0);
    at->sheet_height += MARGIN;
    at->sheet_width = larger_of(larger_of(body, larger_of(head, foot)), LEAST_WIDTH) + 2 * MARGIN;
}

static int letter(struct gsn_lettering *letters, struct gsn_image *sheet, int x, int y,
                  const char *text, struct gsn_error *err)
{
    return gsn_lettering_draw(letters, sheet, x, y, GSN_FACE_PLAIN, label_px, text, ink, err);
}

static int draw_scale(struct gsn_lettering *letters, struct gsn_image *sheet,
                      const struct gsn_plate *plate, const struct layout *at, struct gsn_error *err)
{
    int r = GSN_OK;

    for (int j = 0; j < at->bar_height; j++)
        gsn_canvas_box(sheet, at->bar_x, at->bar_y + j, BAR, 1,
                       gsn_colour_of(plate->map, 1.0 - (j + 0.5) / (double)at->bar_height));
    draw_frame(sheet, at->bar_x, at->bar_y, BAR, at->bar_height, ink);
    for (int k = 0; r >= 0 && k < at->ticks.count; k++) {
        char label[32];
        const double value = tick_value(&at->ticks, k, label);
        const int y =
            at->bar_y +
            (int)((at->bar_height - 1) * (plate->high - value) / (plate->high - plate->low) + 0.5);

        gsn_canvas_box(sheet, at->bar_x + BAR + 1, y, TICK, 1, ink);
        r = letter(letters, sheet, at->bar_x + BAR + TICK + GAP, y - at->line / 2, label, err);
    }
    if (r >= 0 && plate->unit)
        r = letter(letters, sheet, at->bar_x, at->y, plate->unit, err);
    return r;
}

int gsn_plate_new(const struct gsn_plate *plate, uint32_t width, uint32_t height,
                  struct gsn_image **ret_sheet, int *ret_x, int *ret_y, struct gsn_error *err)
{
    struct layout at = { .width = (int)width, .height = (int)height };
    gsn_auto(gsn_lettering) letters = NULL;
    gsn_auto(gsn_image) sheet = NULL;
    int r = gsn_lettering_new(GSN_FONT_FOLDER, &letters, err);

    if (r < 0)
        return r;
    lay_out(letters, plate, &at);
    r = gsn_canvas_new((uint32_t)at.sheet_width, (uint32_t)at.sheet_height, paper, &sheet, err);
    if (r < 0)
        return r;
    draw_frame(sheet, at.x, at.y, at.width, at.height, faint);
    if (plate->title)
        r = gsn_lettering_draw(letters, sheet, at.x, MARGIN, GSN_FACE_BOLD, title_px, plate->title,
                               ink, err);
    if (r >= 0 && plate->has_scale)
        r = draw_scale(letters, sheet, plate, &at, err);
    if (r >= 0 && at.scale_px) {
        r = letter(letters, sheet, at.x, at.foot_y, at.scale_label, err);
        gsn_canvas_box(sheet, at.x, at.foot_y + at.line + 1, at.scale_px, 3, ink);
    }
    if (r >= 0 && plate->note)
        r = letter(letters, sheet, at.note_x, at.foot_y, plate->note, err);
    if (r < 0)
        return r;
    *ret_sheet = gsn_steal(&sheet);
    *ret_x = at.x;
    *ret_y = at.y;
    return GSN_OK;
}

void gsn_plate_fill(struct gsn_image *sheet, int x, int y, const struct gsn_plane *plane,
                    enum gsn_colour_map map, double low, double high)
{
    for (uint32_t j = 0; j < plane->height; j++) {
        for (uint32_t i = 0; i < plane->width; i++) {
            const double value = (double)plane->value[(size_t)j * plane->width + i];

            if (isnan(value))
                gsn_canvas_no_data(sheet, x + (int)i, y + (int)j);
            else
                gsn_canvas_put(sheet, x + (int)i, y + (int)j,
                               gsn_colour_of(map, (value - low) / (high - low)));
        }
    }
}

void gsn_plate_range(const struct gsn_plane *plane, double *low, double *high)
{
    double least = INFINITY, most = -INFINITY;

    if (*low < *high)
        return;
    for (size_t i = 0; i < (size_t)plane->width * plane->height; i++) {
        least = fmin(least, (double)plane->value[i]);
        most = fmax(most, (double)plane->value[i]);
    }
    if (least > most)
        least = most = 0.0;
    /* One colour for one value, in the middle of a scale that says so. */
    *low = least < most ? least : least - 0.5 * fmax(1e-3, fabs(least));
    *high = least < most ? most : most + 0.5 * fmax(1e-3, fabs(most));
}
