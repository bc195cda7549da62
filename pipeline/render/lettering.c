/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Letters by cairo and pango, from font files that we name.
 *
 * Method: fontconfig is told of two files and of nothing else, so that neither what is installed
 * nor somebody's fonts.conf nor a cache decides what a report looks like, and a sandbox needs to
 * show no more than those files. Pango lays a line out and cairo draws it as weights of 8 bits,
 * which are mixed into the picture. Edges are grey, hinted along the vertical alone, whatever the
 * screen of this machine would like.
 *
 * Failure: GSN_E_NOTFOUND where a font is missing, GSN_E_INPUT where it is damaged, what a read says
 * where it cannot be read; GSN_E_NOMEM as far as cairo says so (glib ends the process itself).
 * Cost: a lettering reads two files of 0.7 MB; a line of text its box. */
#include "pipeline/render/lettering.h"

#include <fontconfig/fontconfig.h>
#include <pango/pangofc-fontmap.h>

#include "pipeline/core/file.h"
#include "pipeline/render/canvas.h"
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
        return gsn_fail_at(err, "pictures are lettered with a font of the package fonts-dejavu-core");
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

void gsn_lettering_free(struct gsn_lettering *lettering)
{
    if (!lettering)
        return;
    g_clear_object(&lettering->context);
    /* A map of pango 1.50 never lets go of its configuration. */
    if (lettering->map)
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

int gsn_lettering_ink(struct gsn_image *image, int x, int y, cairo_surface_t *weights,
                      struct gsn_colour colour, struct gsn_error *err)
{
    const unsigned char *bytes;
    int stride;

    cairo_surface_flush(weights);
    if (cairo_surface_status(weights) != CAIRO_STATUS_SUCCESS)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while drawing");
    bytes = cairo_image_surface_get_data(weights);
    stride = cairo_image_surface_get_stride(weights);
    for (int j = 0; j < cairo_image_surface_get_height(weights); j++) {
        for (int i = 0; i < cairo_image_surface_get_width(weights); i++) {
            if (bytes[j * stride + i])
                gsn_canvas_mix(image, x + i, y + j, colour, bytes[j * stride + i] / 255.0);
        }
    }
    return GSN_OK;
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
            ? gsn_lettering_ink(image, x + ink.x, y + ink.y, weights, colour, err)
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
