/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Letters on pictures, in DejaVu Sans, by cairo and pango, and the sheet a picture is mounted on.
 *
 * Sizes are the height of the face in pixels, places are pixels from the upper left corner. One
 * lettering is used by one thread at a time; any number may be in use. The same text has the same
 * pixels whatever else is installed or configured: fonts are read from one folder alone. */
#ifndef GSN_RENDER_LETTERING_H
#define GSN_RENDER_LETTERING_H

#include "pipeline/render/canvas.h"

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_face { GSN_FACE_PLAIN, GSN_FACE_BOLD };

struct gsn_lettering;

/* Where Debian's package fonts-dejavu-core lays the fonts. */
#define GSN_FONT_FOLDER "/usr/share/fonts/truetype/dejavu"

/* gives: the faces of DejaVu Sans in that folder. Fails, naming the package, with GSN_E_NOTFOUND
 * where one is missing, GSN_E_INPUT where it is damaged, GSN_E_IO; or with GSN_E_NOMEM. */
int gsn_lettering_new(const char *folder, struct gsn_lettering **ret_lettering,
                      struct gsn_error *err);
void gsn_lettering_free(struct gsn_lettering *lettering);
GSN_DEFINE_AUTO(gsn_lettering);

/* Pixels from one end of the line to the other, rounded up. */
int gsn_lettering_width(struct gsn_lettering *lettering, enum gsn_face face, double px,
                        const char *text);
/* Pixels from the top of the line to its bottom, whatever the text. */
int gsn_lettering_height(struct gsn_lettering *lettering, enum gsn_face face, double px);

/* Draws UTF-8 on one line; (x, y) is its upper left corner, what falls outside of the picture is
 * cut. A character that the face does not have is named by its number, as in [U+4E2D]; a wrong byte
 * is drawn as U+FFFD. Fails with GSN_E_NOMEM. image: 3 channels of 8 bits. */
int gsn_lettering_draw(struct gsn_lettering *lettering, struct gsn_image *image, int x, int y,
                       enum gsn_face face, double px, const char *text, struct gsn_colour colour,
                       struct gsn_error *err);

/* The sheet a picture is mounted on: title above, colour scale to the right, scale bar and a note
 * below. */

struct gsn_plate {
    const char *title, *note; /* NULL: none */
    double um_per_px;         /* for the scale bar; 0: none */
    int has_scale;            /* whether the four below are shown */
    const char *unit;
    double low, high;
    enum gsn_colour_map map;
};

/* gives: a white sheet for a picture of this size; the picture's upper left corner goes to
 * (*ret_x, *ret_y) and is framed already. low < high where has_scale. Fails with GSN_E_NOMEM, and
 * with GSN_E_NOTFOUND where the fonts are missing. */
int gsn_plate_new(const struct gsn_plate *plate, uint32_t width, uint32_t height,
                  struct gsn_image **ret_sheet, int *ret_x, int *ret_y, struct gsn_error *err);

/* Colours of a plane of values at (x, y); NaN is hatched. low < high. */
void gsn_plate_fill(struct gsn_image *sheet, int x, int y, const struct gsn_plane *plane,
                    enum gsn_colour_map map, double low, double high);

/* Ends for the colour scale: low and high as given when they differ; otherwise the extremes of the
 * values, made different when they are not. */
void gsn_plate_range(const struct gsn_plane *plane, double *low, double *high);

/* The versions that run, as "1.16.0": pixels depend on them. borrows. */
const char *gsn_lettering_cairo(void);
const char *gsn_lettering_pango(void);

#ifdef __cplusplus
}
#endif
#endif
