/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Small pictures of sections: thumbnails for the contact sheet, and candidate sheets.
 *
 * A candidate sheet shows a section in doubt as each of its candidates would place it in the block,
 * with the outline of the nearest section whose place is known:
 *
 * 1. The frame is as wide as the typical placed section and ROOM more.
 * 2. Panels are opened one after the other: as each passes, its sections in doubt are resampled,
 * and those that others are compared with get an outline (what is denser than half of the section's
 *    box on average).
 * 3. At the end outlines are drawn into the pictures and all are coded as JPEG. */
#include "pipeline/specimen/section_pictures.h"

#include "pipeline/core/robust.h"
#include "pipeline/decode/jpeg_write.h"
#include "pipeline/decode/png_write.h"
#include "pipeline/imaging/filter.h"
#include "pipeline/imaging/morphology.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/render/canvas.h"
#include "pipeline/stain/flat_field.h"

#include <math.h>
#include <string.h>

/* What a profile made linear is coded again, or it would come out dark; other codes are shown as
 * they are, as any viewer shows the scan, and as the cuts do (gsn_stack_light_table()). */
static uint8_t code_of(enum gsn_light light, double share)
{
    return (uint8_t)(255 * (light == GSN_LIGHT_PROFILE ? gsn_light_encode(GSN_LIGHT_SRGB, share)
                                                       : share));
}

/* The mean colour of the pixels that one pixel of the small picture stands for, of at most four by
 * four of them: more would show nothing more. */
static struct gsn_colour box_mean(const struct gsn_image *image, enum gsn_light light, int x0,
                                  int y0, int x1, int y1)
{
    const double full = image->bits == 16 ? 65535 : 255;
    const int right = (x1 - x0 + 3) / 4, down = (y1 - y0 + 3) / 4;
    unsigned long sum[3] = { 0 }, count = 0;
    double full_count;

    for (int y = y0 + down / 2; y < y1; y += down)
        for (int x = x0 + right / 2; x < x1; x += right, count++)
            for (unsigned c = 0; c < 3; c++)
                sum[c] += gsn_image_at(image, (uint32_t)x, (uint32_t)y, c);
    full_count = full * (double)(count ? count : 1);
    return (struct gsn_colour){ .r = code_of(light, (double)sum[0] / full_count),
                                .g = code_of(light, (double)sum[1] / full_count),
                                .b = code_of(light, (double)sum[2] / full_count) };
}

static void add_ring(struct gsn_pen *pen, double x, double y, double radius)
{
    enum { SIDES = 20 };

    for (int i = 0; i < SIDES; i++) {
        const double a = 2 * M_PI * i / SIDES, b = 2 * M_PI * (i + 1) / SIDES;

        gsn_pen_line(pen, x + radius * cos(a), y + radius * sin(a), x + radius * cos(b),
                     y + radius * sin(b));
    }
}

int gsn_thumbnail(const struct gsn_image *image, enum gsn_light light, int x, int y, int width,
                  int height, const struct gsn_fiducial mark[GSN_FIDUCIALS], unsigned longest_px,
                  int quality, struct gsn_png_picture *ret_picture, struct gsn_error *err)
{
    static const struct gsn_colour white = { .r = 255, .g = 255, .b = 255 };
    static const struct gsn_colour ring = { .r = 0, .g = 110, .b = 230 };
    const struct gsn_jpeg_style style = { .quality = quality, .smallest = 1 };
    const int longest = width > height ? width : height;
    const double scale = longest > (int)longest_px ? (double)longest_px / longest : 1;
    const uint32_t w = (uint32_t)fmax(1, floor(width * scale));
    const uint32_t h = (uint32_t)fmax(1, floor(height * scale));
    gsn_auto(gsn_image) small = NULL;
    gsn_auto(gsn_pen) pen = NULL;
    int r = gsn_canvas_new(w, h, white, &small, err);

    if (r >= 0)
        r = gsn_pen_new(small, &pen, err);
    if (r < 0)
        return r;
    for (uint32_t v = 0; v < h; v++)
        for (uint32_t u = 0; u < w; u++)
            gsn_canvas_put(small, (int)u, (int)v,
                           box_mean(image, light, x + (int)(u * (uint32_t)width / w),
                                    y + (int)(v * (uint32_t)height / h),
                                    x + (int)((u + 1) * (uint32_t)width / w),
                                    y + (int)((v + 1) * (uint32_t)height / h)));
    for (size_t i = 0; i < GSN_FIDUCIALS; i++)
        if (mark[i].found)
            add_ring(pen, (mark[i].px.x - x) * scale, (mark[i].px.y - y) * scale,
                     fmax(4, 2.2 * mark[i].radius_px * scale));
    r = gsn_pen_ink(pen, small, 1.4, ring, err);
    if (r < 0)
        return r;
    ret_picture->width = small->width;
    ret_picture->height = small->height;
    return quality ? gsn_jpeg_encode(small, &style, &ret_picture->png, &ret_picture->size, err)
                   : gsn_png_encode(small, &ret_picture->png, &ret_picture->size, err);
}

/* What a scan shows at a place of it, between its pixels; outside of the box as at its border. */
static void add_sample(const struct gsn_image *image, const struct gsn_placed_box *box,
                       struct gsn_point px, double sum[3])
{
    const double u = fmin(fmax(px.x - 0.5, box->x), box->x + box->width - 1);
    const double v = fmin(fmax(px.y - 0.5, box->y), box->y + box->height - 1);
    const size_t x = (size_t)u, y = (size_t)v;
    const size_t right = x + 1 < (size_t)(box->x + box->width) ? image->channels : 0;
    const size_t down =
        y + 1 < (size_t)(box->y + box->height) ? (size_t)image->channels * image->width : 0;
    const size_t at = (y * image->width + x) * image->channels;
    const double s = u - (double)x, t = v - (double)y;
    const size_t corner[4] = { at, at + right, at + down, at + right + down };
    const double weight[4] = { (1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t };

    for (size_t k = 0; k < 4; k++)
        for (size_t c = 0; c < 3; c++)
            sum[c] +=
                weight[k] * (image->bits == 16 ? ((const uint16_t *)image->samples)[corner[k] + c]
                                               : ((const uint8_t *)image->samples)[corner[k] + c]);
}

static const double SETTLED_UM = 1e-6, SETTLED_SCALE = 1e-9;

static double settle(double value, double step)
{
    return step * rint(value / step);
}

struct gsn_affine gsn_settled_pose(const struct gsn_affine *pose)
{
    return (struct gsn_affine){ .m00 = settle(pose->m00, SETTLED_SCALE),
                                .m01 = settle(pose->m01, SETTLED_SCALE),
                                .m02 = settle(pose->m02, SETTLED_UM),
                                .m10 = settle(pose->m10, SETTLED_SCALE),
                                .m11 = settle(pose->m11, SETTLED_SCALE),
                                .m12 = settle(pose->m12, SETTLED_UM) };
}

int gsn_placed_picture(const struct gsn_image *image, enum gsn_light light,
                       const struct gsn_placed_box *box, struct gsn_point corner, double um_per_px,
                       unsigned side_px, struct gsn_image **ret_picture, struct gsn_error *err)
{
    static const struct gsn_colour white = { .r = 255, .g = 255, .b = 255 };
    const struct gsn_affine to_block = gsn_settled_pose(&box->panel_to_block_um);
    const struct gsn_affine to_px = gsn_affine_inverse(&to_block);
    const double reach = um_per_px / sqrt(fabs(gsn_affine_det(&to_block)));
    const int samples = (int)fmin(fmax(ceil(reach), 1), 4); /* in each direction */
    const double full = (image->bits == 16 ? 65535. : 255.) * samples * samples;
    const int right = box->x + box->width, down = box->y + box->height;
    gsn_auto(gsn_image) picture = NULL;
    int r = gsn_canvas_new(side_px, side_px, white, &picture, err);

    for (unsigned v = 0; r >= 0 && v < side_px; v++)
        for (unsigned u = 0; u < side_px; u++) {
            const struct gsn_point um = { corner.x + (u + 0.5) * um_per_px,
                                          corner.y + (v + 0.5) * um_per_px };
            const struct gsn_point px = gsn_affine_apply(&to_px, um);
            double sum[3] = { 0 };

            if (!(px.x >= box->x && px.y >= box->y && px.x < right && px.y < down))
                continue;
            for (int k = 0; k < samples * samples; k++) {
                const struct gsn_point part = {
                    corner.x + (u + (k % samples + 0.5) / samples) * um_per_px,
                    corner.y + (v + (k / samples + 0.5) / samples) * um_per_px
                };

                add_sample(image, box, gsn_affine_apply(&to_px, part), sum);
            }
            gsn_canvas_put(picture, (int)u, (int)v,
                           (struct gsn_colour){ .r = code_of(light, sum[0] / full),
                                                .g = code_of(light, sum[1] / full),
                                                .b = code_of(light, sum[2] / full) });
        }
    if (r >= 0)
        *ret_picture = gsn_steal(&picture);
    return r;
}

enum { SIDE_PX = 168, CELLS = SIDE_PX * SIDE_PX, QUALITY = 90 };

/* A neighbour farther away than this is another place of the block. */
enum { MOST_APART = 3 };

/* Room around the typical section for one that would be laid askew. */
static const double ROOM = 1.3;

/* One section, as far as it is drawn. */
struct figure {
    size_t neighbour; /* its place in the reconstruction; the section itself: none */
    int outlined;     /* whether another is compared with this one */
    uint8_t *inside;  /* owned; CELLS of 0 or 1, NULL before its panel came */
    struct gsn_image *laid[GSN_CANDIDATES]; /* owned */
};

struct gsn_candidate_sheet {
    struct gsn_point corner; /* of the pictures, um in the block */
    double um_per_px;
    size_t count;
    struct figure *figure; /* one for each section of the reconstruction */
};

int gsn_section_is_placed(const struct gsn_section *s)
{
    return s->posed && !s->pose.gross && (s->candidates.count == 0 || s->candidates.chosen) &&
           (s->state == GSN_SECTION_USED || s->state == GSN_SECTION_DOUBTFUL);
}

static int is_doubtful(const struct gsn_section *s)
{
    return s->candidates.count > 0 && s->seen.width > 0 && s->seen.height > 0;
}

static size_t neighbour_of(const struct gsn_poses *poses, size_t i)
{
    size_t best = i;
    double least = MOST_APART + 0.5;

    for (size_t k = 0; k < poses->section_count; k++) {
        const double apart =
            fabs((double)poses->section[k].seen.serial - poses->section[i].seen.serial);

        if (k != i && gsn_section_is_placed(&poses->section[k]) && apart < least) {
            best = k;
            least = apart;
        }
    }
    return best;
}

int gsn_placed_frame(const struct gsn_poses *poses, double room, struct gsn_point *ret_corner,
                     double *ret_side_um, struct gsn_error *err)
{
    const size_t most = poses->section_count;
    gsn_auto_mem(double) x = gsn_alloc_array(3 * most + 1, sizeof *x);
    double *const y = x + most, *const longest = y + most;
    size_t count = 0;
    double side = 0;

    if (!x)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for pictures of sections");
    for (size_t i = 0; i < most; i++) {
        const struct gsn_panel_section *seen = &poses->section[i].seen;
        const struct gsn_affine *map = &poses->section[i].pose.panel_to_block_um;
        const struct gsn_point middle = { seen->x + 0.5 * seen->width,
                                          seen->y + 0.5 * seen->height };
        struct gsn_point um;

        if (!gsn_section_is_placed(&poses->section[i]))
            continue;
        um = gsn_affine_apply(map, middle);
        x[count] = um.x;
        y[count] = um.y;
        longest[count++] = fmax(seen->width, seen->height) * sqrt(fabs(gsn_affine_det(map)));
    }
    if (count > 0)
        side = settle(room * gsn_median(longest, count), SETTLED_UM);
    if (side > 0)
        *ret_corner = (struct gsn_point){ settle(gsn_median(x, count), SETTLED_UM) - 0.5 * side,
                                          settle(gsn_median(y, count), SETTLED_UM) - 0.5 * side };
    *ret_side_um = side;
    return GSN_OK;
}

int gsn_candidate_sheet_new(const struct gsn_poses *poses, struct gsn_candidate_sheet **ret_sheet,
                            struct gsn_error *err)
{
    gsn_auto(gsn_candidate_sheet) sheet = gsn_alloc_array(1, sizeof *sheet);
    size_t doubtful = 0;
    double side = 0;
    int r = GSN_OK;

    if (sheet)
        sheet->figure = gsn_alloc_array(poses->section_count, sizeof *sheet->figure);
    if (!sheet || !sheet->figure)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the candidates' pictures");
    sheet->count = poses->section_count;
    for (size_t i = 0; i < poses->section_count; i++) {
        sheet->figure[i].neighbour = i;
        if (!is_doubtful(&poses->section[i]))
            continue;
        doubtful++;
        sheet->figure[i].neighbour = neighbour_of(poses, i);
        sheet->figure[sheet->figure[i].neighbour].outlined |= sheet->figure[i].neighbour != i;
    }
    if (poses->solved && doubtful > 0)
        r = gsn_placed_frame(poses, ROOM, &sheet->corner, &side, err);
    if (r < 0)
        return r;
    sheet->um_per_px = side / SIDE_PX;
    *ret_sheet = side > 0 ? gsn_steal(&sheet) : NULL;
    return GSN_OK;
}

void gsn_candidate_sheet_free(struct gsn_candidate_sheet *sheet)
{
    if (!sheet)
        return;
    for (size_t i = 0; sheet->figure && i < sheet->count; i++) {
        gsn_free(sheet->figure[i].inside);
        for (size_t c = 0; c < GSN_CANDIDATES; c++)
            gsn_image_free(sheet->figure[i].laid[c]);
    }
    gsn_free(sheet->figure);
    gsn_free(sheet);
}

/* ---- what a panel shows ------------------------------------------------------------------ */

static struct gsn_point place_of(const struct gsn_candidate_sheet *sheet, size_t cell)
{
    return (
        struct gsn_point){ sheet->corner.x + ((double)(cell % SIDE_PX) + 0.5) * sheet->um_per_px,
                           sheet->corner.y + ((double)(cell / SIDE_PX) + 0.5) * sheet->um_per_px };
}

static int is_in_box(const struct gsn_panel_section *seen, struct gsn_point px)
{
    return px.x >= seen->x && px.y >= seen->y && px.x < seen->x + seen->width &&
           px.y < seen->y + seen->height;
}

/* Density of all three channels at a place of the panel; 0 where it is not known. */
static double density_at(const struct gsn_scan *scan, struct gsn_point px)
{
    const struct gsn_plane *plane = scan->od[0];
    const double x = fmin(fmax(floor(px.x / scan->apart), 0), plane->width - 1.0);
    const double y = fmin(fmax(floor(px.y / scan->apart), 0), plane->height - 1.0);
    const size_t at = (size_t)y * plane->width + (size_t)x;
    const double sum =
        (double)scan->od[0]->value[at] + scan->od[1]->value[at] + scan->od[2]->value[at];

    return isfinite(sum) ? sum : 0;
}

/* Tissue is what is denser than half of the section's box on average: the glass beside it makes
 * that less than the tissue's own density, and more than nothing. */
static int find_outline(const struct gsn_candidate_sheet *sheet, const struct gsn_scan *scan,
                        const struct gsn_section *s, uint8_t **ret_inside, struct gsn_error *err)
{
    const struct gsn_affine to_px = gsn_affine_inverse(&s->pose.panel_to_block_um);
    gsn_auto_mem(uint8_t) inside = gsn_alloc_array(CELLS, sizeof *inside);
    double sum = 0, least;
    size_t count = 0;

    if (!inside)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a section's outline");
    for (size_t i = 0; i < CELLS; i++) {
        const struct gsn_point px = gsn_affine_apply(&to_px, place_of(sheet, i));

        if (is_in_box(&s->seen, px)) {
            sum += density_at(scan, px);
            count++;
        }
    }
    least = count > 0 ? 0.5 * sum / (double)count : 0;
    for (size_t i = 0; i < CELLS; i++) {
        const struct gsn_point px = gsn_affine_apply(&to_px, place_of(sheet, i));

        inside[i] = is_in_box(&s->seen, px) && density_at(scan, px) > least;
    }
    *ret_inside = gsn_steal(&inside);
    return GSN_OK;
}

static int gather_figure(struct gsn_candidate_sheet *sheet, const struct gsn_section *s,
                         const struct gsn_scan *scan, struct figure *figure, struct gsn_error *err)
{
    int r = GSN_OK;

    if (figure->outlined && !figure->inside)
        r = find_outline(sheet, scan, s, &figure->inside, err);
    for (size_t c = 0; r >= 0 && is_doubtful(s) && c < s->candidates.count; c++) {
        const struct gsn_placed_box box = { .panel_to_block_um =
                                                s->candidates.at[c].panel_to_block_um,
                                            .x = s->seen.x,
                                            .y = s->seen.y,
                                            .width = s->seen.width,
                                            .height = s->seen.height };

        if (s->candidates.at[c].laid && !figure->laid[c])
            r = gsn_placed_picture(scan->picture->image, scan->glass.light, &box, sheet->corner,
                                   sheet->um_per_px, SIDE_PX, &figure->laid[c], err);
    }
    return r;
}

int gsn_candidate_sheet_look(struct gsn_candidate_sheet *sheet, const struct gsn_poses *poses,
                             const struct gsn_scan *scan, unsigned panel, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; sheet && r >= 0 && i < sheet->count; i++)
        if (poses->section[i].panel == panel)
            r = gather_figure(sheet, &poses->section[i], scan, &sheet->figure[i], err);
    return r;
}

/* ---- drawing ----------------------------------------------------------------------------- */

/* Of a cell and those around it, what most are: specks of dust have no outline. The outline is what
 * has a cell of the outside beside it. */
static int draw_outline(struct gsn_image *image, const uint8_t *inside, struct gsn_error *err)
{
    static const struct gsn_colour ink = { .r = 0, .g = 110, .b = 230 };
    gsn_auto_mem(uint8_t) set = gsn_memdup(inside, CELLS);
    gsn_auto_mem(uint8_t) inner = NULL;
    int r;

    if (!set)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a section's outline");
    r = gsn_median_3(set, SIDE_PX, SIDE_PX, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < SIDE_PX; i++)
        set[i] = set[CELLS - 1 - i] = set[i * SIDE_PX] = set[i * SIDE_PX + SIDE_PX - 1] = 0;
    inner = gsn_memdup(set, CELLS);
    if (!inner)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a section's outline");
    r = gsn_erode(inner, SIDE_PX, SIDE_PX, 1, err);
    if (r < 0)
        return r;
    for (int i = 0; i < CELLS; i++)
        if (set[i] && !inner[i])
            gsn_canvas_put(image, i % SIDE_PX, i / SIDE_PX, ink);
    return GSN_OK;
}

int gsn_candidate_sheet_draw(struct gsn_candidate_sheet *sheet, const struct gsn_poses *poses,
                             struct gsn_densities *densities, struct gsn_error *err)
{
    const struct gsn_jpeg_style style = { .quality = QUALITY, .smallest = 1 };
    int r = GSN_OK;

    for (size_t i = 0; sheet && i < sheet->count; i++) {
        const struct figure *figure = &sheet->figure[i];
        const uint8_t *inside =
            figure->neighbour != i ? sheet->figure[figure->neighbour].inside : NULL;

        for (size_t c = 0; r >= 0 && c < GSN_CANDIDATES; c++) {
            struct gsn_png_picture *picture = &densities->section[i].candidate_picture[c];

            if (!figure->laid[c])
                continue;
            if (inside)
                r = draw_outline(figure->laid[c], inside, err);
            if (r < 0)
                return r;
            picture->width = picture->height = SIDE_PX;
            r = gsn_jpeg_encode(figure->laid[c], &style, &picture->png, &picture->size, err);
        }
        if (r >= 0 && figure->laid[0] && inside)
            densities->section[i].compared_with = poses->section[figure->neighbour].seen.serial + 1;
    }
    return r;
}
