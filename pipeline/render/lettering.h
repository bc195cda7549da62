/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Letters on pictures, in DejaVu Sans, by cairo and pango.
 *
 * Sizes are the height of the face in pixels, places are pixels from the upper left corner. One
 * lettering is used by one thread at a time; any number may be in use. The same text has the same
 * pixels whatever else is installed or configured: fonts are read from one folder alone. */
#ifndef GSN_RENDER_LETTERING_H
#define GSN_RENDER_LETTERING_H

#include "pipeline/core/image.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_colour {
    uint8_t r, g, b;
};

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

/* The versions that run, as "1.16.0": pixels depend on them. borrows. */
const char *gsn_lettering_cairo(void);
const char *gsn_lettering_pango(void);

#ifdef __cplusplus
}
#endif
#endif
