/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What pipeline/render itself asks of cairo and pango. */
#ifndef GSN_RENDER_LETTERING_INTERNAL_H
#define GSN_RENDER_LETTERING_INTERNAL_H

#include "pipeline/render/lettering.h"

#include <pango/pangocairo.h>

/* gives (g_object_unref): the text laid out in this face, with characters that it lacks named;
 * broken into lines of this width, and at newlines, or with a width of 0 on one line. */
PangoLayout *gsn_lettering_layout(struct gsn_lettering *lettering, enum gsn_face face, double px,
                                  const char *text, double width);

/* From here on letters are laid out for a printer: at fractions of a unit, as the font has them. */
void gsn_lettering_for_paper(struct gsn_lettering *lettering);

#endif
