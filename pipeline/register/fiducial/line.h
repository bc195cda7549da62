/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A straight dark line from one side of a section's window to the other: the edge of a coverslip.
 *
 * Where it lies over a burn or beside it, the two are one spot from afar and no disc from near. The
 * line is found by its being dark against both of its sides nearly all the way; what it covers is
 * then bridged on the reduced picture and left out where marks are fitted. Lengths are panel
 * pixels, centres at +0.5. */
#ifndef GSN_REGISTER_FIDUCIAL_LINE_H
#define GSN_REGISTER_FIDUCIAL_LINE_H

#include "pipeline/register/fiducial/blob.h"
#include "pipeline/register/fiducial/detect.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Two edges of one glass meet in a corner. */
enum { GSN_COVERSLIP_LINES = 2 };

struct gsn_coverslip_line {
    int steep;           /* runs along y rather than along x */
    double start, slope; /* the other coordinate where the first is 0, and per pixel of the first */
    double half_px;      /* half of what it covers, in that other coordinate */
};

/* A density with the lines that lie over it. borrows; keeps: density. */
struct gsn_lined_density {
    const struct gsn_density_source *density;
    size_t count;
    struct gsn_coverslip_line line[GSN_COVERSLIP_LINES];
};

/* Finds lines on the field and bridges them there, from one side to the other. Returns how many.
 * The field's cells are finite. */
size_t gsn_coverslip_lines_bridge(struct gsn_blob_field *field, double px_um,
                                  struct gsn_coverslip_line ret_line[GSN_COVERSLIP_LINES]);

/* The density with NaN where lines lie. borrows; keeps: lined. */
struct gsn_density_source gsn_density_without_lines(const struct gsn_lined_density *lined);

#ifdef __cplusplus
}
#endif
#endif
