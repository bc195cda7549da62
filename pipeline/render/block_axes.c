/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The orientation cube and the axes of the block.
 *
 * Cube: of its six faces those that look at the eye are filled, by testing each quarter of a pixel
 * in the face's own coordinates; the three edges that leave the cube's lowest corner are the axes,
 * longer than the cube, in colours and with letters. What of an axis lies behind the cube is drawn
 * before it. The cube is seen without perspective, whatever the picture is.
 *
 * Axes: of the four edges along an axis those are on the outline of the box whose one face looks at
 * the eye and whose other does not; ticks and numbers beyond them meet nothing of what is shown.
 * The lower one is drawn, or the left one where they are upright. Numbers stand at multiples of 1,
 * 2 or 5 times a power of ten.
 *
 * Failure: memory, or no fonts. Cost: some thousand pixels. */
#include "pipeline/render/block_axes.h"

#include "pipeline/core/geom.h"
#include "pipeline/core/mem.h"
#include "pipeline/render/lettering.h"

#include <math.h>
#include <stdio.h>

static const struct gsn_colour axis_ink[3] = { { 176, 60, 40 }, { 30, 120, 80 }, { 40, 70, 170 } };
static const struct gsn_colour edge_ink = { 90, 94, 102 }, number_ink = { 60, 64, 72 };
static const struct gsn_colour paper = { 255, 255, 255 };

/* Pixels, of a picture of FULL_PX or more; the cube of a smaller one is smaller: from the middle of
 * the cube to the corner of the picture, half a side, how much longer an axis is than a side,
 * letters. */
static const double CORNER_PX = 44, HALF_PX = 15, LONGER_PX = 11, LETTER_PX = 12, NUMBER_PX = 10.5,
                    FULL_PX = 400;
enum { LEAST_PX = 240 }; /* narrower pictures have no room for numbers */

struct painter {
    struct gsn_image *sheet;
    const struct gsn_camera *camera;
    struct gsn_lettering *letters;
    double at[2]; /* the middle of the cube */
    double half;  /* of its side */
};

/* A place of the cube, whose sides go from -1 to 1. */
static void place_of(const struct painter *p, const double place[3], double ret_px[2])
{
    ret_px[0] = p->at[0] + p->half * gsn_dot3(place, p->camera->right);
    ret_px[1] = p->at[1] + p->half * gsn_dot3(place, p->camera->down);
}

/* Fills the face on this side of an axis: the square around its middle along two other axes. */
static void fill_face(const struct painter *p, int axis, double side)
{
    enum { PARTS = 4 };
    const int b = (axis + 1) % 3, c = (axis + 2) % 3;
    const double u[2] = { p->half * p->camera->right[b], p->half * p->camera->down[b] };
    const double v[2] = { p->half * p->camera->right[c], p->half * p->camera->down[c] };
    const double det = u[0] * v[1] - u[1] * v[0];
    /* The more it looks at the eye, the lighter. */
    const uint8_t grey = (uint8_t)(188 + 54 * fabs(p->camera->into[axis]));
    double middle[3] = { 0, 0, 0 }, at[2];
    const int reach = (int)(2 * p->half);

    middle[axis] = side;
    place_of(p, middle, at);
    if (fabs(det) < 1e-9)
        return;
    for (int y = (int)at[1] - reach; y <= (int)at[1] + reach; y++)
        for (int x = (int)at[0] - reach; x <= (int)at[0] + reach; x++) {
            int in = 0;

            for (int k = 0; k < PARTS * PARTS; k++) {
                const double dx = x + (k % PARTS + 0.5) / PARTS - at[0];
                const double dy = y + ((double)(k / PARTS) + 0.5) / PARTS - at[1];

                in += fabs(dx * v[1] - dy * v[0]) <= fabs(det) &&
                      fabs(dy * u[0] - dx * u[1]) <= fabs(det);
            }
            if (in > 0)
                gsn_canvas_mix(p->sheet, x, y, (struct gsn_colour){ grey, grey, grey },
                               in / (double)(PARTS * PARTS));
        }
}

static int draw_stroke(const struct painter *p, const double from[2], const double to[2],
                       double width, struct gsn_colour ink, struct gsn_error *err)
{
    gsn_auto(gsn_pen) pen = NULL;
    int r = gsn_pen_new(p->sheet, &pen, err);

    if (r < 0)
        return r;
    gsn_pen_line(pen, from[0], from[1], to[0], to[1]);
    return gsn_pen_ink(pen, p->sheet, width, ink, err);
}

/* The outlines of the faces that are seen. */
static int draw_outlines(const struct painter *p, struct gsn_error *err)
{
    gsn_auto(gsn_pen) pen = NULL;
    int r = gsn_pen_new(p->sheet, &pen, err);

    for (int a = 0; r >= 0 && a < 3; a++) {
        const double side = p->camera->into[a] > 0 ? -1 : 1;
        const int b = (a + 1) % 3, c = (a + 2) % 3;

        if (fabs(p->camera->into[a]) < 1e-9)
            continue;
        for (int k = 0; k < 4; k++) {
            double from[3] = { 0 }, to[3] = { 0 }, px[2], end[2];

            from[a] = to[a] = side;
            from[b] = k == 0 || k == 3 ? -1 : 1;
            from[c] = k < 2 ? -1 : 1;
            to[b] = k < 2 ? 1 : -1;
            to[c] = k == 0 || k == 3 ? -1 : 1;
            place_of(p, from, px);
            place_of(p, to, end);
            gsn_pen_line(pen, px[0], px[1], end[0], end[1]);
        }
    }
    return r < 0 ? r : gsn_pen_ink(pen, p->sheet, 1, edge_ink, err);
}

/* White around it, so that it is read on anything. */
static int write_text(const struct painter *p, double x, double y, enum gsn_face face, double px,
                      const char *text, struct gsn_colour ink, struct gsn_error *err)
{
    const int left = (int)lrint(x - 0.5 * gsn_lettering_width(p->letters, face, px, text));
    const int top = (int)lrint(y - 0.5 * gsn_lettering_height(p->letters, face, px));
    int r = GSN_OK;

    for (int k = 0; r >= 0 && k < 9; k++)
        if (k != 4)
            r = gsn_lettering_draw(p->letters, p->sheet, left + k % 3 - 1, top + k / 3 - 1, face,
                                   px, text, paper, err);
    return r < 0 ? r
                 : gsn_lettering_draw(p->letters, p->sheet, left, top, face, px, text, ink, err);
}

/* From the lowest corner along an axis: within the cube (part 0), or what is longer with its
 * letter. */
static int draw_cube_axis(const struct painter *p, int axis, int part, struct gsn_error *err)
{
    const double longer = 1 + LONGER_PX / HALF_PX;
    const double right = p->camera->right[axis], down = p->camera->down[axis];
    const double far = 8 / fmax(0.3, hypot(right, down)); /* of the letter from the tip */
    double place[3] = { -1, -1, -1 }, from[2], to[2];
    const char name[2] = { "xyz"[axis], 0 };
    int r;

    place[axis] = part ? 1 : -1;
    place_of(p, place, from);
    place[axis] = part ? longer : 1;
    place_of(p, place, to);
    r = draw_stroke(p, from, to, 2, axis_ink[axis], err);
    if (r < 0 || !part || hypot(right, down) < 0.15)
        return r; /* of one that points at the eye or away there is a dot */
    return write_text(p, to[0] + far * right, to[1] + far * down, GSN_FACE_BOLD, LETTER_PX, name,
                      axis_ink[axis], err);
}

static int draw_cube(const struct painter *p, struct gsn_error *err)
{
    const double *into = p->camera->into;
    int r = GSN_OK;

    for (int a = 0; r >= 0 && a < 3; a++)
        if (into[a] > 0)
            r = draw_cube_axis(p, a, 1, err); /* it leaves by a face that is not seen */
    for (int a = 0; r >= 0 && a < 3; a++)
        if (fabs(into[a]) > 1e-9)
            fill_face(p, a, into[a] > 0 ? -1 : 1);
    if (r >= 0)
        r = draw_outlines(p, err);
    for (int a = 0; r >= 0 && a < 3; a++)
        if (into[(a + 1) % 3] > -1e-9 || into[(a + 2) % 3] > -1e-9)
            r = draw_cube_axis(p, a, 0, err); /* on a face that is seen */
    for (int a = 0; r >= 0 && a < 3; a++)
        if (!(into[a] > 0))
            r = draw_cube_axis(p, a, 1, err);
    return r;
}

/* Whether the upper or lower face of the box across an axis looks at the eye. */
static int faces_eye(const struct gsn_camera *camera, const struct gsn_block_box_um *box, int axis,
                     int upper)
{
    const double eye = camera->centre[axis] - camera->eye_um * camera->into[axis];

    if (camera->eye_um > 0)
        return upper ? eye > box->high[axis] : eye < box->low[axis];
    return upper ? camera->into[axis] < 0 : camera->into[axis] > 0;
}

int gsn_block_axes_edge(const struct gsn_camera *camera, const struct gsn_block_box_um *box,
                        int axis, double ret_from[3], double ret_to[3])
{
    const int b = (axis + 1) % 3, c = (axis + 2) % 3;
    double best = -INFINITY;

    for (int k = 0; k < 4; k++) {
        double end[2][3], px[2][2], depth, across[2], long_px, off;

        if (faces_eye(camera, box, b, k & 1) == faces_eye(camera, box, c, k >> 1))
            continue;
        for (int e = 0; e < 2; e++) {
            for (int i = 0; i < 3; i++)
                end[e][i] = i == axis                   ? (e ? box->high : box->low)[i]
                            : (i == b ? k & 1 : k >> 1) ? box->high[i]
                                                        : box->low[i];
            gsn_camera_project(camera, end[e], px[e], &depth);
        }
        across[0] = px[0][1] - px[1][1];
        across[1] = px[1][0] - px[0][0];
        long_px = hypot(across[0], across[1]);
        if (long_px < 1)
            continue;
        /* Downwards, or to the left where that is hardly told. */
        if (fabs(across[1]) > 0.3 * long_px ? across[1] < 0 : across[0] > 0)
            long_px = -long_px;
        off = ((0.5 * (px[0][0] + px[1][0]) - 0.5 * camera->width) * across[0] +
               (0.5 * (px[0][1] + px[1][1]) - 0.5 * camera->height) * across[1]) /
              long_px;
        if (off > best) {
            best = off;
            for (int i = 0; i < 3; i++) {
                ret_from[i] = end[0][i];
                ret_to[i] = end[1][i];
            }
        }
    }
    return best > -INFINITY;
}

static double round_up(double least)
{
    const double ten = pow(10, floor(log10(least)));

    for (int i = 0; i < 3; i++) {
        static const double steps[] = { 1, 2, 5 };

        if (steps[i] * ten >= least * (1 - 1e-9))
            return steps[i] * ten;
    }
    return 10 * ten;
}

static int draw_axis(const struct painter *p, int x, int y, const struct gsn_block_box_um *box,
                     int axis, struct gsn_error *err)
{
    const struct gsn_camera *camera = p->camera;
    double from[3], to[3], start[2], end[2], depth, out[2], long_px, every;
    int widest = 0;
    const char name[2] = { "xyz"[axis], 0 };
    gsn_auto(gsn_pen) pen = NULL;
    int r;

    if (!gsn_block_axes_edge(camera, box, axis, from, to))
        return GSN_OK;
    gsn_camera_project(camera, from, start, &depth);
    gsn_camera_project(camera, to, end, &depth);
    long_px = hypot(end[0] - start[0], end[1] - start[1]);
    if (long_px < 40)
        return GSN_OK;
    out[0] = (start[1] - end[1]) / long_px;
    out[1] = (end[0] - start[0]) / long_px;
    if (fabs(out[1]) > 0.3 ? out[1] < 0 : out[0] > 0) {
        out[0] = -out[0];
        out[1] = -out[1];
    }
    /* Numbers side by side need more room than one above the other. */
    every = round_up((to[axis] - from[axis]) * (fabs(end[1] - start[1]) > 0.7 * long_px ? 30 : 48) /
                     long_px);
    r = gsn_pen_new(p->sheet, &pen, err);
    if (r < 0)
        return r;
    gsn_pen_line(pen, x + start[0], y + start[1], x + end[0], y + end[1]);
    for (double v = every * ceil(from[axis] / every - 1e-9); r >= 0 && v <= to[axis] + 1e-9 * every;
         v += every) {
        double place[3] = { from[0], from[1], from[2] }, px[2];
        char text[24];
        int wide;

        place[axis] = v;
        gsn_camera_project(camera, place, px, &depth);
        px[0] += x;
        px[1] += y;
        gsn_pen_line(pen, px[0], px[1], px[0] + 5 * out[0], px[1] + 5 * out[1]);
        (void)snprintf(text, sizeof text, "%s%.9g", v < -0.5 * every ? "\xE2\x88\x92" : "",
                       fabs(v) < 0.5 * every ? 0 : fabs(v));
        wide = gsn_lettering_width(p->letters, GSN_FACE_PLAIN, NUMBER_PX, text);
        widest = wide > widest ? wide : widest;
        r = write_text(p, px[0] + (8 + 0.55 * wide) * out[0], px[1] + 13 * out[1], GSN_FACE_PLAIN,
                       NUMBER_PX, text, number_ink, err);
    }
    if (r >= 0)
        r = gsn_pen_ink(pen, p->sheet, 1.2, axis_ink[axis], err);
    if (r < 0)
        return r;
    return write_text(p, x + 0.5 * (start[0] + end[0]) + (17 + 1.1 * widest) * out[0],
                      y + 0.5 * (start[1] + end[1]) + 28 * out[1], GSN_FACE_BOLD, LETTER_PX, name,
                      axis_ink[axis], err);
}

int gsn_block_axes_paint(struct gsn_image *sheet, int x, int y, const struct gsn_camera *camera,
                         const struct gsn_block_box_um *box, struct gsn_error *err)
{
    gsn_auto(gsn_lettering) letters = NULL;
    const double scale = fmin(1, camera->width / FULL_PX);
    struct painter p = { .sheet = sheet,
                         .camera = camera,
                         .at = { (double)x + camera->width - scale * CORNER_PX,
                                 y + scale * CORNER_PX },
                         .half = scale * HALF_PX };
    int r = gsn_lettering_new(GSN_FONT_FOLDER, &letters, err);

    p.letters = letters;
    for (int a = 0; r >= 0 && box && camera->width >= LEAST_PX && a < 3; a++)
        r = draw_axis(&p, x, y, box, a, err);
    return r < 0 ? r : draw_cube(&p, err);
}
