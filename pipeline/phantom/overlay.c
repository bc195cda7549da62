/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What lies on the glass, drawn over its sections kind by kind.
 *
 * Strokes, discs and edges add to the optical density, each pixel by the share of it that they
 * cover. Bubbles and defocus blur what comes through: light, not its logarithm, by a separable
 * Gaussian cut at nine pixels, taken in full inside the disc and less towards its border.
 *
 * Failure: GSN_E_NOMEM for the blur. Cost: the pixels of the box around each thing. */
#include "pipeline/phantom/overlay.h"

#include "pipeline/core/mem.h"
#include "pipeline/phantom/decoy.h"

#include <math.h>

static const double HAIR_OD = 0.6, DUST_OD = 0.9, EDGE_OD = 0.6;
static const double RIM_OD = 0.35, RIM_PX = 3, INSIDE_SHARE = 0.75, INSIDE_BLUR_PX = 2;
/* A border is as soft as this: a pixel takes the share of it that is covered. */
static const double SOFT_PX = 1;

static const double PEN[GSN_PHANTOM_PENS][3] = {
    { 200, 20, 40 }, { 30, 50, 160 }, { 20, 120, 60 }, { 35, 35, 40 }
};

/* Pixels x0 <= x < x1, y0 <= y < y1 within reach_um of a box. */
struct box {
    uint32_t x0, y0, x1, y1;
};

static uint32_t clip_pixel(double px, uint32_t most)
{
    return (uint32_t)fmin(fmax(px, 0), most);
}

static struct box box_of(const struct gsn_phantom_glass *glass, const struct gsn_point *point,
                         size_t count, double reach_um)
{
    double left = INFINITY, top = INFINITY, right = -INFINITY, low = -INFINITY;

    for (size_t i = 0; i < count; i++) {
        left = fmin(left, point[i].x - reach_um);
        right = fmax(right, point[i].x + reach_um);
        top = fmin(top, point[i].y - reach_um);
        low = fmax(low, point[i].y + reach_um);
    }
    return (struct box){ clip_pixel(floor(left / glass->px_um), glass->width),
                         clip_pixel(floor(top / glass->px_um), glass->height),
                         clip_pixel(ceil(right / glass->px_um), glass->width),
                         clip_pixel(ceil(low / glass->px_um), glass->height) };
}

static struct gsn_point centre_um(const struct gsn_phantom_glass *glass, uint32_t x, uint32_t y)
{
    return (struct gsn_point){ (x + 0.5) * glass->px_um, (y + 0.5) * glass->px_um };
}

static float *pixel_at(const struct gsn_phantom_glass *glass, uint32_t x, uint32_t y)
{
    return glass->od + 3 * ((size_t)y * glass->width + x);
}

static void darken_pixel(float *od, double share, const double by[3])
{
    for (int c = 0; c < 3; c++)
        od[c] += (float)(share * by[c]);
}

/* How much of a pixel lies within half a width of the middle of a line, 0..1. */
static double cover_share(double distance_um, double half_um, double px_um)
{
    const double inner = fmin(fmax((half_um - distance_um) / (SOFT_PX * px_um) + 0.5, 0), 1);

    return inner * fmin(1, 2 * half_um / px_um);
}

/* --- lines and discs --- */

static void draw_stroke(const struct gsn_phantom_glass *glass, const struct gsn_phantom_defect *d,
                        const double od[3])
{
    struct gsn_point line[GSN_PHANTOM_STROKE + 1];
    struct box box;

    gsn_phantom_stroke(d, line);
    box = box_of(glass, line, GSN_PHANTOM_STROKE + 1, d->width / 2 + 2 * glass->px_um);
    for (uint32_t y = box.y0; y < box.y1; y++)
        for (uint32_t x = box.x0; x < box.x1; x++) {
            const double away = gsn_phantom_stroke_distance(line, centre_um(glass, x, y));

            darken_pixel(pixel_at(glass, x, y), cover_share(away, d->width / 2, glass->px_um), od);
        }
}

static void draw_disc(const struct gsn_phantom_glass *glass, struct gsn_phantom_disc disc,
                      const double od[3])
{
    const struct box box = box_of(glass, &disc.at, 1, disc.radius + 2 * glass->px_um);

    for (uint32_t y = box.y0; y < box.y1; y++)
        for (uint32_t x = box.x0; x < box.x1; x++) {
            const struct gsn_point p = centre_um(glass, x, y);
            const double away = hypot(p.x - disc.at.x, p.y - disc.at.y);

            darken_pixel(pixel_at(glass, x, y), cover_share(away, disc.radius, glass->px_um), od);
        }
}

static void draw_hair(const struct gsn_phantom_glass *glass, const struct gsn_phantom_defect *d)
{
    const double hair[3] = { HAIR_OD, HAIR_OD, HAIR_OD }, dust[3] = { DUST_OD, DUST_OD, DUST_OD };

    draw_stroke(glass, d, hair);
    for (int i = 0; i < GSN_PHANTOM_DUST; i++)
        draw_disc(glass, d->dust[i], dust);
}

static void draw_pen(const struct gsn_phantom_glass *glass, const struct gsn_phantom_defect *d)
{
    double od[3];

    for (int c = 0; c < 3; c++)
        od[c] = log10(gsn_phantom_white[c] / PEN[d->colour][c]);
    draw_stroke(glass, d, od);
}

/* From the label to the right border. */
static void draw_edge(const struct gsn_phantom_plan *plan, const struct gsn_phantom_glass *glass,
                      const struct gsn_phantom_defect *d)
{
    const double left_um = gsn_phantom_slot_centre_um(plan, 0).x - gsn_phantom_slot_half_um;
    const double od[3] = { EDGE_OD, EDGE_OD, EDGE_OD };

    for (uint32_t x = clip_pixel(left_um / glass->px_um, glass->width); x < glass->width; x++) {
        const double middle = d->at.y + ((x + 0.5) * glass->px_um - d->at.x) * tan(d->turn);
        const struct gsn_point at = { d->at.x, middle };
        const struct box box = box_of(glass, &at, 1, d->width);

        for (uint32_t y = box.y0; y < box.y1; y++) {
            const double away = fabs((y + 0.5) * glass->px_um - middle) * cos(d->turn);

            darken_pixel(pixel_at(glass, x, y), cover_share(away, d->width / 2, glass->px_um), od);
        }
    }
}

/* --- blur: of the light, not of its logarithm --- */

enum { KERNEL_REACH = 9 }; /* three sigma of the widest */

static size_t at_patch(const struct box *box, uint32_t x, uint32_t y)
{
    return 3 * ((size_t)(y - box->y0) * (box->x1 - box->x0) + (x - box->x0));
}

/* One direction: stride 1 in x or 1 in y; held at the border of the patch. */
static void blur_line(const struct box *box, const float *in, const double *kernel, int down,
                      float *out)
{
    for (uint32_t y = box->y0; y < box->y1; y++)
        for (uint32_t x = box->x0; x < box->x1; x++) {
            double sum[3] = { 0 };

            for (int i = -KERNEL_REACH; i <= KERNEL_REACH; i++) {
                const int64_t u = (int64_t)x + (down ? 0 : i), v = (int64_t)y + (down ? i : 0);
                const uint32_t px = clip_pixel(fmax((double)u, box->x0), box->x1 - 1);
                const uint32_t py = clip_pixel(fmax((double)v, box->y0), box->y1 - 1);
                const float *at = in + at_patch(box, px, py);

                for (int c = 0; c < 3; c++)
                    sum[c] += kernel[i + KERNEL_REACH] * (double)at[c];
            }
            for (int c = 0; c < 3; c++)
                out[at_patch(box, x, y) + (size_t)c] = (float)sum[c];
        }
}

static void make_kernel(double sigma_px, double kernel[2 * KERNEL_REACH + 1])
{
    double sum = 0;

    for (int i = -KERNEL_REACH; i <= KERNEL_REACH; i++)
        sum += kernel[i + KERNEL_REACH] = exp(-i * i / (2 * sigma_px * sigma_px));
    for (int i = 0; i <= 2 * KERNEL_REACH; i++)
        kernel[i] /= sum;
}

/* Blurs the light that comes through a disc; how much of the blurred is taken falls off over a
 * sixth of the radius when the border is soft. */
static int blur_disc(const struct gsn_phantom_glass *glass, struct gsn_phantom_disc disc,
                     double sigma_px, int soft, struct gsn_error *err)
{
    const double reach = disc.radius + (KERNEL_REACH + 1) * glass->px_um;
    const struct box box = box_of(glass, &disc.at, 1, reach);
    const double fall_um = soft ? disc.radius / 6 : glass->px_um;
    gsn_auto_mem(float) light = NULL;
    gsn_auto_mem(float) rows = NULL;
    double kernel[2 * KERNEL_REACH + 1];
    size_t samples;

    if (box.x0 >= box.x1 || box.y0 >= box.y1)
        return GSN_OK;
    samples = 3 * (size_t)(box.x1 - box.x0) * (box.y1 - box.y0);
    light = gsn_alloc_array(samples, sizeof *light);
    rows = gsn_alloc_array(samples, sizeof *rows);
    if (!light || !rows)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to blur a panel");
    make_kernel(sigma_px, kernel);
    for (uint32_t y = box.y0; y < box.y1; y++)
        for (uint32_t x = box.x0; x < box.x1; x++)
            for (uint32_t c = 0; c < 3; c++)
                light[at_patch(&box, x, y) + c] = powf(10, -pixel_at(glass, x, y)[c]);
    blur_line(&box, light, kernel, 0, rows);
    blur_line(&box, rows, kernel, 1, light);
    for (uint32_t y = box.y0; y < box.y1; y++)
        for (uint32_t x = box.x0; x < box.x1; x++) {
            const struct gsn_point p = centre_um(glass, x, y);
            const double away = hypot(p.x - disc.at.x, p.y - disc.at.y);
            const double share = fmin(fmax((disc.radius - away) / fall_um + 0.5, 0), 1);
            float *od = pixel_at(glass, x, y);

            for (uint32_t c = 0; share > 0 && c < 3; c++) {
                const double blurred = -log10((double)light[at_patch(&box, x, y) + c]);

                od[c] = (float)((1 - share) * (double)od[c] + share * blurred);
            }
        }
    return GSN_OK;
}

/* --- bubbles --- */

static int draw_bubble(const struct gsn_phantom_glass *glass, const struct gsn_phantom_defect *d,
                       struct gsn_error *err)
{
    const struct gsn_phantom_disc disc = { d->at, d->radius };
    const struct box box = box_of(glass, &d->at, 1, d->radius + 4 * RIM_PX * glass->px_um);
    const double grey[3] = { RIM_OD, RIM_OD, RIM_OD };
    const int r = blur_disc(glass, disc, INSIDE_BLUR_PX, 0, err);

    if (r < 0)
        return r;
    for (uint32_t y = box.y0; y < box.y1; y++)
        for (uint32_t x = box.x0; x < box.x1; x++) {
            const struct gsn_point p = centre_um(glass, x, y);
            const double away = (hypot(p.x - d->at.x, p.y - d->at.y) - d->radius) / glass->px_um;
            float *od = pixel_at(glass, x, y);

            for (int c = 0; away < 0 && c < 3; c++)
                od[c] *= (float)INSIDE_SHARE;
            darken_pixel(od, exp(-away * away / (2 * RIM_PX * RIM_PX)), grey);
        }
    return GSN_OK;
}

static int draw_defect(const struct gsn_phantom_plan *plan, const struct gsn_phantom_glass *glass,
                       const struct gsn_phantom_defect *d, struct gsn_error *err)
{
    const struct gsn_phantom_disc disc = { d->at, d->radius };

    switch (d->kind) {
    case GSN_PHANTOM_HAIR:
        draw_hair(glass, d);
        return GSN_OK;
    case GSN_PHANTOM_BUBBLE:
        return draw_bubble(glass, d, err);
    case GSN_PHANTOM_COVERSLIP_EDGE:
        draw_edge(plan, glass, d);
        return GSN_OK;
    case GSN_PHANTOM_PEN:
        draw_pen(glass, d);
        return GSN_OK;
    case GSN_PHANTOM_DEFOCUS:
        return blur_disc(glass, disc, d->sigma_px, 1, err);
    default:
        return GSN_OK;
    }
}

/* The entries of one edge follow each other, and it is drawn once. */
static int drawn_before(const struct gsn_phantom_plan *plan, size_t i)
{
    return i > 0 && plan->defect[i].kind == GSN_PHANTOM_COVERSLIP_EDGE &&
           plan->defect[i - 1].kind == GSN_PHANTOM_COVERSLIP_EDGE &&
           plan->defect[i - 1].at.y == plan->defect[i].at.y &&
           plan->defect[i - 1].at.x == plan->defect[i].at.x &&
           plan->defect[i - 1].turn == plan->defect[i].turn;
}

int gsn_phantom_overlay_draw(const struct gsn_phantom_plan *plan, int panel,
                             const struct gsn_phantom_glass *glass, struct gsn_error *err)
{
    for (int k = (panel - 1) * plan->slots; k < panel * plan->slots; k++)
        for (int i = 0; i < plan->section[k].decoys; i++)
            gsn_phantom_decoy_draw(plan, k, i, glass);
    for (int kind = 0; kind < GSN_PHANTOM_ACCIDENTS; kind++)
        for (size_t i = 0; i < plan->defects; i++) {
            const struct gsn_phantom_defect *d = &plan->defect[i];
            int r;

            if ((int)d->kind != kind || plan->section[d->k].panel != panel || drawn_before(plan, i))
                continue;
            r = draw_defect(plan, glass, d, err);
            if (r < 0)
                return r;
        }
    return GSN_OK;
}
