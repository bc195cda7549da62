/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Ray casting of the spline, in order of visibility.
 *
 * Method: object order first (every tetrahedron and every face gives its polynomials to the rays
 * that meet it; pipeline/model/pieces.h), then ray by ray the pieces in order. No grid, no steps,
 * no walk from neighbour to neighbour, so that a domain with hollows is no special case. The
 * emission-absorption integral (N. Max 1995, 10.1109/2945.468400) of a piece with extinction k(t),
 * colour c and transparency T,
 *
 *     int c k T dt,      T = T_0 exp(-tau),      tau = int k dt,
 *
 * has tau as a polynomial, once the piece is cut where the density crosses the window's ends. With
 * one colour it is c (T_0 - T_1), exactly; what the colour differs from that of the middle is
 * integrated by Gauss's rule of 3 points in Kronrod's of 7, halved until the two agree.
 *
 * Steps: (1) the camera, and the pixels that the shadow of each tetrahedron and face may touch; (2)
 * tile by tile, and there by depth: their pieces of every ray; (3) per ray what the clip leaves,
 * and the pieces by where they begin; (4) an X-ray adds the integrals of the pieces; otherwise the
 * sum of the polynomials between two ends is composed, or searched for the level; (5) rays of a
 * pixel averaged.
 *
 * Exact but for rounding: X-ray integrals, optical depths, cuts, levels. Held to GSN_RAY_TOLERANCE:
 * colours. Rays are moved by 1e-9 px so that none runs in a face that pixels line up with.
 *
 * Failure: GSN_E_INPUT on a view, style or clip that cannot be; GSN_E_LIMIT; GSN_E_NOMEM.
 * Cost: per ray its pieces, sorted by insertion, as they come nearly sorted; each is a quadrature
 * unless its colour hardly varies. */
#include "pipeline/render/ray_cast.h"

#include "pipeline/core/geom.h"
#include "pipeline/core/parallel.h"
#include "pipeline/core/srgb.h"
#include "pipeline/model/pieces.h"
#include "pipeline/render/rays_internal.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { TILE = 16, PER_CHUNK = 512, BATCHES = 20 };

void gsn_ray_picture_free(struct gsn_ray_picture *picture)
{
    if (picture)
        gsn_free(picture->rgba);
    gsn_free(picture);
}

/* --- what is drawn --- */

enum mode { MODE_XRAY, MODE_VOLUME, MODE_SURFACE };

struct casting {
    enum mode mode;
    const struct gsn_spline *spline;
    const struct gsn_ray_clip *clip;
    const struct gsn_ray_style *style;
    struct gsn_camera camera;  /* of rays, style->across a pixel's side */
    int with_slope, with_tint; /* gradients, colours of the style are kept with pieces */
    struct gsn_ray_colours colours;
    double blur;
    size_t items; /* four faces and a tetrahedron each */
    struct gsn_ray_reach *reach;
    struct gsn_ray_bins bins;
    size_t first_tile;
    float *value;     /* X-ray, a ray each */
    float (*rgba)[4]; /* otherwise */
};

static void casting_done(struct casting *casting)
{
    gsn_free(casting->reach);
    gsn_ray_bins_done(&casting->bins);
    gsn_free(casting->value);
    gsn_free(casting->rgba);
}
#define auto_casting __attribute__((cleanup(casting_done))) struct casting

/* --- which pixels a tetrahedron or a face may touch --- */

static struct gsn_ray_reach reach_tet(const struct casting *casting, size_t tet)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(gsn_spline_space(casting->spline));
    double low[2] = { INFINITY, INFINITY }, high[2] = { -INFINITY, -INFINITY };

    for (int k = 0; k < 4; k++)
        gsn_ray_reach_point(&casting->camera, mesh->vertex[mesh->tet[tet][k]], low, high);
    return gsn_ray_reach_of(&casting->camera, low, high);
}

static struct gsn_ray_reach reach_face(const struct casting *casting, size_t tet, unsigned corner)
{
    const struct gsn_dms *space = gsn_spline_space(casting->spline);
    const size_t per_cloud = gsn_dms_degree(space) + 1;
    double low[2] = { INFINITY, INFINITY }, high[2] = { -INFINITY, -INFINITY };
    struct gsn_prism prism;

    if (!gsn_prism_init(space, tet, corner, &prism))
        return (struct gsn_ray_reach){ { 1, 1 }, { 0, 0 } };
    for (int k = 0; k < 3; k++) {
        for (unsigned l = 0; l <= prism.top; l++)
            gsn_ray_reach_point(&casting->camera,
                                gsn_dms_knots(space)[prism.vertex[k] * per_cloud + l], low, high);
    }
    return gsn_ray_reach_of(&casting->camera, low, high);
}

static int reach_chunk(size_t chunk, void *context, struct gsn_error *err)
{
    struct casting *casting = context;
    const size_t tets = casting->items / 5;

    (void)err;
    for (size_t t = chunk * PER_CHUNK; t < tets && t < (chunk + 1) * PER_CHUNK; t++) {
        for (unsigned k = 0; k < 4; k++)
            casting->reach[5 * t + k] = reach_face(casting, t, k);
        casting->reach[5 * t + 4] = reach_tet(casting, t);
    }
    return GSN_OK;
}

struct depth {
    float um;
    uint32_t tet;
};

static int by_depth(const void *a, const void *b)
{
    const struct depth *p = a, *q = b;

    if (p->um < q->um || p->um > q->um)
        return p->um < q->um ? -1 : 1;
    return (p->tet > q->tet) - (p->tet < q->tet);
}

/* Items by the depth of the middles of tetrahedra. */
static void order_items(const struct casting *casting, struct depth *depth, uint32_t *ret_order)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(gsn_spline_space(casting->spline));
    const double *into = casting->camera.into;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        double sum = 0;

        for (int k = 0; k < 4; k++)
            sum += gsn_dot3(into, mesh->vertex[mesh->tet[t][k]]);
        depth[t] = (struct depth){ (float)(sum / 4), (uint32_t)t };
    }
    qsort(depth, mesh->tet_count, sizeof *depth, by_depth);
    for (size_t i = 0; i < casting->items; i++)
        ret_order[i] = 5 * depth[i / 5].tet + (uint32_t)(i % 5);
}

static int bin_items(struct casting *casting, unsigned threads, struct gsn_error *err)
{
    const size_t tets = gsn_dms_mesh(gsn_spline_space(casting->spline))->tet_count;
    gsn_auto_mem(struct depth) depth = NULL;
    gsn_auto_mem(uint32_t) order = NULL;
    int r;

    if (tets > UINT32_MAX / 5)
        return gsn_fail(err, GSN_E_LIMIT, "%zu tetrahedra are too many for a picture", tets);
    casting->items = 5 * tets;
    casting->reach = gsn_alloc_array(casting->items, sizeof *casting->reach);
    depth = gsn_alloc_array(tets, sizeof *depth);
    order = gsn_alloc_array(casting->items, sizeof *order);
    if (!casting->reach || !depth || !order)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a picture of %zu tetrahedra", tets);
    r = gsn_parallel_for((tets + PER_CHUNK - 1) / PER_CHUNK, threads, reach_chunk, casting, err);
    if (r < 0)
        return r;
    order_items(casting, depth, order);
    return gsn_ray_bin(casting->reach, order, casting->items, &casting->camera, TILE,
                       &casting->bins, err);
}

/* --- the pieces of the rays of a tile --- */

struct kept {
    double from, to, value[4]; /* as of gsn_line_piece */
    uint16_t ray;              /* of the tile */
    uint8_t home;              /* of a tetrahedron, not of a face */
};

struct tile {
    const struct casting *casting;
    uint32_t low[2], size[2]; /* rays */
    struct gsn_ray ray[TILE * TILE];
    struct kept *kept;
    double (*slope)[3][4]; /* of kept, if gradients are asked for */
    double (*tint)[3][4];  /* and colours */
    size_t count, room;
    uint32_t *order;                  /* of kept, by ray, and there by where they begin */
    uint32_t *active;                 /* of kept, on a stretch; room for all */
    struct gsn_ray_spans spans, runs; /* of one ray */
};

static void tile_done(struct tile *tile)
{
    gsn_free(tile->kept);
    gsn_free(tile->slope);
    gsn_free(tile->tint);
    gsn_free(tile->order);
    gsn_free(tile->active);
    gsn_ray_spans_done(&tile->spans);
    gsn_ray_spans_done(&tile->runs);
}
#define auto_tile __attribute__((cleanup(tile_done))) struct tile

static int grow_triples(double (**triples)[3][4], size_t room, struct gsn_error *err)
{
    double(*grown)[3][4] = gsn_realloc_array(*triples, room, sizeof *grown);

    if (!grown)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the pieces of rays");
    *triples = grown;
    return GSN_OK;
}

static int grow_pieces(struct tile *tile, size_t room, struct gsn_error *err)
{
    struct kept *kept = gsn_realloc_array(tile->kept, room, sizeof *kept);
    int r = GSN_OK;

    if (!kept)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the pieces of rays");
    tile->kept = kept;
    if (tile->casting->with_slope)
        r = grow_triples(&tile->slope, room, err);
    if (r >= 0 && tile->casting->with_tint)
        r = grow_triples(&tile->tint, room, err);
    if (r >= 0)
        tile->room = room;
    return r;
}

static int keep_pieces(struct tile *tile, const struct gsn_line_piece *piece, size_t count,
                       size_t ray, int home, struct gsn_error *err)
{
    if (tile->count + count > tile->room) {
        const int r = grow_pieces(tile, 2 * tile->room + count + 1024, err);

        if (r < 0)
            return r;
    }
    for (size_t i = 0; i < count; i++) {
        struct kept *kept = &tile->kept[tile->count];

        kept->from = piece[i].from;
        kept->to = piece[i].to;
        memcpy(kept->value, piece[i].value, sizeof kept->value);
        kept->ray = (uint16_t)ray;
        kept->home = (uint8_t)home;
        if (tile->casting->with_slope)
            memcpy(tile->slope[tile->count], piece[i].slope, sizeof piece[i].slope);
        tile->count++;
    }
    return GSN_OK;
}

/* One tetrahedron or face of one spline, made ready for lines. */
struct item_line {
    int home;
    struct gsn_tet_line tet;
    struct gsn_face_line face;
};

/* Of the spline that is drawn, and of the three of its colours. */
enum { MOST_LINES = 4 };

static void item_line_init(const struct gsn_spline *spline, uint32_t item, struct item_line *line)
{
    line->home = item % 5 == 4;
    if (line->home)
        gsn_tet_line_init(spline, item / 5, &line->tet);
    else
        (void)gsn_face_line_init(spline, item / 5, item % 5, &line->face);
}

static size_t find_pieces(const struct item_line *line, const struct gsn_ray *ray, int with_slope,
                          struct gsn_line_piece piece[GSN_FACE_CORRECTION_MAX_LEAVES])
{
    return line->home ? (size_t)gsn_tet_line_piece(&line->tet, ray->start, ray->into, ray->from,
                                                   ray->to, with_slope, piece)
                      : gsn_face_line_pieces(&line->face, ray->start, ray->into, ray->from, ray->to,
                                             with_slope, piece);
}

/* Colours of the pieces kept last: splines on one space have their pieces in the same places. */
static void tint_pieces(struct tile *tile, const struct item_line *line, const struct gsn_ray *ray,
                        size_t count)
{
    struct gsn_line_piece piece[GSN_FACE_CORRECTION_MAX_LEAVES];

    for (int c = 0; c < 3; c++) {
        const size_t same = find_pieces(&line[c], ray, 0, piece);

        assert(same == count);
        for (size_t i = 0; i < same; i++)
            memcpy(tile->tint[tile->count - count + i][c], piece[i].value, sizeof piece->value);
    }
}

/* What one tetrahedron or face gives to the rays of the tile. line: room for MOST_LINES. */
static int cast_item(struct tile *tile, uint32_t item, struct item_line *line,
                     struct gsn_error *err)
{
    const struct casting *casting = tile->casting;
    const struct gsn_ray_reach reach = casting->reach[item];
    struct gsn_line_piece piece[GSN_FACE_CORRECTION_MAX_LEAVES];
    int r = GSN_OK;

    item_line_init(casting->spline, item, line);
    for (int c = 0; casting->with_tint && c < 3; c++)
        item_line_init(casting->style->colour[c], item, &line[1 + c]);
    for (uint32_t y = 0; r >= 0 && y < tile->size[1]; y++) {
        if ((int)(tile->low[1] + y) < reach.low[1] || (int)(tile->low[1] + y) > reach.high[1])
            continue;
        for (uint32_t x = 0; r >= 0 && x < tile->size[0]; x++) {
            const size_t at = y * TILE + x;
            const struct gsn_ray *ray = &tile->ray[at];
            size_t count;

            if ((int)(tile->low[0] + x) < reach.low[0] || (int)(tile->low[0] + x) > reach.high[0] ||
                !(ray->from < ray->to))
                continue;
            count = find_pieces(line, ray, casting->with_slope, piece);
            r = keep_pieces(tile, piece, count, at, line->home, err);
            if (r >= 0 && casting->with_tint && count > 0)
                tint_pieces(tile, line + 1, ray, count);
        }
    }
    return r;
}

/* --- a piece: one polynomial on a stretch of a ray --- */

struct stretch {
    double from, length;                      /* um */
    double value[4], slope[3][4], tint[3][4]; /* in 0..1 */
    double share;                             /* of the tolerance */
    int fresh;                                /* nothing of the ray is seen just before it */
};

static double poly_at(const double c[4], double v)
{
    return c[0] + v * (c[1] + v * (c[2] + v * c[3]));
}

/* The polynomial p(at + scale v), added. */
static void add_shifted(const double c[4], double at, double scale, double ret[4])
{
    const double twice = scale * scale;

    ret[0] += poly_at(c, at);
    ret[1] += scale * (c[1] + at * (2 * c[2] + 3 * at * c[3]));
    ret[2] += twice * (c[2] + 3 * at * c[3]);
    ret[3] += twice * scale * c[3];
}

/* Bounds on 0..1 by the Bernstein coefficients. */
static void poly_range(const double c[4], double *ret_low, double *ret_high)
{
    const double b[4] = { c[0], c[0] + c[1] / 3, c[0] + (2 * c[1] + c[2]) / 3,
                          c[0] + c[1] + c[2] + c[3] };

    *ret_low = fmin(fmin(b[0], b[1]), fmin(b[2], b[3]));
    *ret_high = fmax(fmax(b[0], b[1]), fmax(b[2], b[3]));
}

/* The root of p - level between two places where it has different signs, p monotone there. */
static double find_root(const double c[4], double level, double low, double high)
{
    const int rises = poly_at(c, high) > level;

    for (int i = 0; i < 60 && high - low > 1e-15; i++) {
        const double middle = (low + high) / 2;

        if ((poly_at(c, middle) > level) == rises)
            high = middle;
        else
            low = middle;
    }
    return (low + high) / 2;
}

/* Where p is at the level in 0..1, ascending; at most three places. */
static unsigned find_roots(const double c[4], double level, double ret_root[3])
{
    double turn[4] = { 0 }, low, high;
    unsigned turns = 1, count = 0;

    poly_range(c, &low, &high);
    if (low > level || high < level)
        return 0;
    /* Between the roots of the derivative p is monotone. */
    if (c[3] != 0) {
        const double under = c[2] * c[2] - 3 * c[3] * c[1];

        if (under > 0) {
            const double q = -(c[2] + copysign(sqrt(under), c[2]));
            const double a = q / (3 * c[3]), b = q != 0 ? c[1] / q : a;

            for (int i = 0; i < 2; i++) {
                const double at = i ? fmax(a, b) : fmin(a, b);

                if (at > 0 && at < 1)
                    turn[turns++] = at;
            }
        }
    } else if (c[2] != 0 && -c[1] / (2 * c[2]) > 0 && -c[1] / (2 * c[2]) < 1) {
        turn[turns++] = -c[1] / (2 * c[2]);
    }
    turn[turns] = 1;
    for (unsigned i = 0; i < turns; i++) {
        if ((poly_at(c, turn[i]) > level) != (poly_at(c, turn[i + 1]) > level))
            ret_root[count++] = find_root(c, level, turn[i], turn[i + 1]);
    }
    return count;
}

/* --- emission and absorption --- */

/* What has been seen along a ray. */
struct seen {
    double integral;       /* X-ray */
    double light[3], left; /* colour, transparency */
    int done, any;
};

/* What is integrated over a part of a stretch: extinction as a polynomial in 0..1 times length. */
struct glow {
    const struct casting *casting;
    const struct stretch *stretch;
    const struct gsn_ray *ray;
    double at, scale; /* the part in the stretch */
    double share[4];  /* of the window */
    double depth[5];  /* optical, from the part's beginning */
    double rate[4];   /* its derivative */
    double middle[3]; /* the colour that is taken off */
};

/* The colour at v of the part, where the density has this share of the window. */
static void colour_at(const struct glow *glow, double v, double share, double ret[3])
{
    const double at = glow->at + glow->scale * v;

    if (!glow->casting->with_tint) {
        gsn_ray_colour_at(&glow->casting->colours, share, ret);
        return;
    }
    for (int c = 0; c < 3; c++)
        ret[c] = fmin(1, fmax(0, poly_at(glow->stretch->tint[c], at)));
}

/* How bright: darker where the surface of equal density is seen edge on, the more the steeper. */
static double shade_at(const struct glow *glow, double v)
{
    const struct casting *casting = glow->casting;
    const double shading = casting->style->shading, at = glow->at + glow->scale * v;
    double gradient[3], steep2, facing;

    if (!casting->with_slope)
        return 1;
    for (int c = 0; c < 3; c++)
        gradient[c] = poly_at(glow->stretch->slope[c], at);
    steep2 = gsn_dot3(gradient, gradient);
    facing = gsn_dot3(gradient, glow->ray->into);
    return 1 - shading * (steep2 - fabs(facing) * sqrt(steep2)) /
                   (steep2 + casting->blur * casting->blur);
}

/* Adds the integrand at v, times weight, without the transparency that was left before. */
static void add_glow(const struct glow *glow, double v, double weight, double sum[3])
{
    const double *d = glow->depth;
    const double depth = v * (d[1] + v * (d[2] + v * (d[3] + v * d[4])));
    const double bright = weight * exp(-depth) * poly_at(glow->rate, v);
    const double shade = shade_at(glow, v);
    double colour[3];

    colour_at(glow, v, poly_at(glow->share, v), colour);
    for (int c = 0; c < 3; c++)
        sum[c] += bright * (shade * colour[c] - glow->middle[c]);
}

/* Gauss's rule of three points within Kronrod's of seven, on -1..1. */
static const double node[4] = { 0, 0.774596669241483377, 0.434243749346802558,
                                0.960491268708020283 };
static const double gauss[2] = { 8.0 / 9, 5.0 / 9 };
static const double kronrod[4] = { 0.450916538658474142, 0.268488089868333441, 0.401397414775962222,
                                   0.104656226026467265 };

static void integrate_glow(const struct glow *glow, double low, double high, double allowed,
                           unsigned depth, double sum[3])
{
    const double middle = (low + high) / 2, half = (high - low) / 2;
    double rough[3] = { 0 }, fine[3] = { 0 }, differ = 0;

    for (int i = 0; i < 4; i++) {
        double here[3] = { 0 };

        add_glow(glow, middle + half * node[i], half, here);
        if (i > 0)
            add_glow(glow, middle - half * node[i], half, here);
        for (int c = 0; c < 3; c++) {
            fine[c] += kronrod[i] * here[c];
            rough[c] += i < 2 ? gauss[i] * here[c] : 0;
        }
    }
    for (int c = 0; c < 3; c++)
        differ = fmax(differ, fabs(fine[c] - rough[c]));
    if (differ > allowed && depth > 0) {
        integrate_glow(glow, low, middle, allowed / 2, depth - 1, sum);
        integrate_glow(glow, middle, high, allowed / 2, depth - 1, sum);
        return;
    }
    for (int c = 0; c < 3; c++)
        sum[c] += fine[c];
}

/* How much colours may vary over the part, shading left out. */
static double spread_of(const struct glow *glow)
{
    double low, high, spread = 0;

    if (!glow->casting->with_tint) {
        poly_range(glow->share, &low, &high);
        return glow->casting->colours.steepest * (high - low);
    }
    for (int c = 0; c < 3; c++) {
        double part[4] = { 0 };

        add_shifted(glow->stretch->tint[c], glow->at, glow->scale, part);
        poly_range(part, &low, &high);
        spread = fmax(spread, high - low);
    }
    return spread;
}

/* The part of a stretch between two crossings of the window's ends. */
static void add_part(const struct casting *casting, const struct gsn_ray *ray,
                     const struct stretch *stretch, const double share[4], double low, double high,
                     struct seen *seen)
{
    const double rate = (high - low) * stretch->length / casting->style->opaque_um;
    const double middle = poly_at(share, (low + high) / 2);
    struct glow glow = { casting, stretch, ray, low, high - low, { 0 }, { 0 }, { 0 }, { 0 } };
    double gone, sum[3] = { 0 }, spread, allowed;

    if (middle <= 0)
        return;
    if (middle >= 1)
        glow.share[0] = 1;
    else
        add_shifted(share, low, high - low, glow.share);
    for (int i = 0; i < 4; i++) {
        glow.rate[i] = rate * glow.share[i];
        glow.depth[i + 1] = glow.rate[i] / (i + 1);
    }
    gone = -expm1(-(glow.depth[1] + glow.depth[2] + glow.depth[3] + glow.depth[4]));
    colour_at(&glow, 0.5, fmin(1, middle), glow.middle);
    for (int c = 0; c < 3; c++)
        glow.middle[c] *= shade_at(&glow, 0.5);
    spread = casting->with_slope ? 1 : spread_of(&glow);
    /* The tolerance is shared by the light of the part, but no less than evenly over parts. */
    allowed = GSN_RAY_PART_TOLERANCE * fmax(gone, stretch->share / seen->left);
    if (gone * spread > allowed)
        integrate_glow(&glow, 0, 1, allowed, 12, sum);
    for (int c = 0; c < 3; c++)
        seen->light[c] += seen->left * (gone * glow.middle[c] + sum[c]);
    seen->left *= 1 - gone;
    seen->done = seen->left < GSN_RAY_PART_TOLERANCE;
}

static void add_volume(const struct casting *casting, const struct gsn_ray *ray,
                       const struct stretch *stretch, struct seen *seen)
{
    const double width = casting->style->high - casting->style->low;
    double share[4], low, high, cut[8] = { 0 };
    unsigned cuts = 1;

    for (int i = 0; i < 4; i++)
        share[i] = (stretch->value[i] - (i ? 0 : casting->style->low)) / width;
    poly_range(share, &low, &high);
    if (high <= 0)
        return;
    for (int end = 0; end < 2; end++) {
        double root[3];
        const unsigned roots = find_roots(share, end, root);

        for (unsigned i = 0; i < roots; i++) {
            unsigned at = cuts++;

            for (; cut[at - 1] > root[i]; at--)
                cut[at] = cut[at - 1];
            cut[at] = root[i];
        }
    }
    cut[cuts] = 1;
    for (unsigned i = 0; i < cuts && !seen->done; i++) {
        if (cut[i] < cut[i + 1])
            add_part(casting, ray, stretch, share, cut[i], cut[i + 1], seen);
    }
}

/* --- the surface at a level --- */

/* Seen flatter than this a film hides no more. */
static const double GRAZING = 0.1;

static const double bone[3] = { 226 / 255.0, 205 / 255.0, 176 / 255.0 };
static const double to_light[3] = { -0.45, -0.60, -0.66 }; /* right, down, into */

/* A two-sided surface of this normal in the camera's light. */
static void light_surface(const struct gsn_camera *camera, const double normal[3],
                          const double base[3], double ret[3])
{
    const double *axis[3] = { camera->right, camera->down, camera->into };
    const double length = sqrt(gsn_dot3(normal, normal));
    double n[3] = { 0, 0, -1 }, diffuse, fill, half[3], shine;

    for (int c = 0; length > 0 && c < 3; c++)
        n[c] = gsn_dot3(normal, axis[c]) / length;
    for (int c = 0; n[2] > 0 && c < 3; c++)
        n[c] = c < 2 ? -n[c] : n[c];
    n[2] = -fabs(n[2]);
    memcpy(half, to_light, sizeof half);
    half[2] -= 1;
    diffuse = fmax(0, gsn_dot3(n, to_light));
    fill = fmax(0, -0.7 * (n[0] * to_light[0] + n[1] * to_light[1]) - 0.5 * n[2]);
    shine = pow(fmax(0, gsn_dot3(n, half) / sqrt(gsn_dot3(half, half))), 32);
    for (int c = 0; c < 3; c++)
        ret[c] = fmin(1, base[c] * (0.30 + 0.62 * diffuse + 0.16 * fill) + 0.15 * shine);
}

/* The style's colour at v of the stretch, as codes. */
static void see_colour(const struct stretch *stretch, double v, double ret[3])
{
    for (int c = 0; c < 3; c++)
        ret[c] = gsn_srgb_of_light(fmin(1, fmax(0, poly_at(stretch->tint[c], v))));
}

/* The colour of the surface, or of a cut, at v of the stretch. */
static void light_place(const struct casting *casting, const struct gsn_ray *ray,
                        const struct stretch *stretch, double v, int cut, double ret[3])
{
    const struct gsn_ray_style *style = casting->style;
    const struct gsn_ray_clip *clip = casting->clip;
    double u[3], value, gradient[3] = { 0, 0, 0 }, base[3];
    size_t hint = 0;

    for (int c = 0; c < 3; c++)
        u[c] = ray->start[c] + (stretch->from + v * stretch->length) * ray->into[c];
    if (!cut) {
        (void)gsn_spline_eval(casting->spline, u, &hint, &value, gradient);
        memcpy(base, bone, sizeof base);
        if (casting->with_tint)
            see_colour(stretch, v, base);
        light_surface(&casting->camera, gradient, base, ret);
        return;
    }
    if (casting->with_tint)
        see_colour(stretch, v, base);
    else
        gsn_ray_colour_at(&casting->colours,
                          (poly_at(stretch->value, v) - style->low) / (style->high - style->low),
                          base);
    memcpy(ret, base, sizeof base);
    /* A cut is flat and shows its colour as the scale has it; the border of the region is round. */
    if (clip && clip->border &&
        fabs(gsn_border_at(clip->border, u, gradient)) < 1e-3 * clip->border_step_um)
        light_surface(&casting->camera, gradient, base, ret);
}

/* Behind it nothing is seen. */
static void meet_surface(const struct casting *casting, const struct gsn_ray *ray,
                         const struct stretch *stretch, double v, int cut, struct seen *seen)
{
    double lit[3];

    light_place(casting, ray, stretch, v, cut, lit);
    for (int c = 0; c < 3; c++)
        seen->light[c] += seen->left * lit[c];
    seen->done = 1;
    seen->left = 0;
}

/* A film in the way, at v. What is looked through hides 1 - (1 - opacity)^(its length in the
 * film). */
static void pass_film(const struct casting *casting, const struct gsn_ray *ray,
                      const struct stretch *stretch, double v, double level, struct seen *seen)
{
    const struct gsn_ray_style *style = casting->style;
    double u[3], value, gradient[3] = { 0, 0, 0 }, base[3], lit[3], facing, hides;
    size_t hint = 0;

    for (int c = 0; c < 3; c++)
        u[c] = ray->start[c] + (stretch->from + v * stretch->length) * ray->into[c];
    (void)gsn_spline_eval(casting->spline, u, &hint, &value, gradient);
    facing = fabs(gsn_dot3(gradient, ray->into)) /
             sqrt(gsn_dot3(gradient, gradient) * gsn_dot3(ray->into, ray->into));
    hides = 1 - pow(1 - style->film_opacity, 1 / fmax(GRAZING, facing >= 0 ? facing : 1));
    gsn_ray_colour_at(&casting->colours, (level - style->low) / (style->high - style->low), base);
    light_surface(&casting->camera, gradient, base, lit);
    for (int c = 0; c < 3; c++)
        seen->light[c] += seen->left * hides * lit[c];
    seen->left *= 1 - hides;
}

/* Those that the ray passes before the place end of the stretch, in its order. */
static void pass_films(const struct casting *casting, const struct gsn_ray *ray,
                       const struct stretch *stretch, double end, struct seen *seen)
{
    struct {
        double at, level;
    } met[3 * GSN_RAY_FILMS];
    size_t count = 0;

    for (unsigned f = 0; f < casting->style->films; f++) {
        double root[3];
        const unsigned roots = find_roots(stretch->value, casting->style->film[f], root);

        for (unsigned i = 0; i < roots && root[i] < end; i++) {
            size_t at = count++;

            for (; at > 0 && met[at - 1].at > root[i]; at--)
                met[at] = met[at - 1];
            met[at].at = root[i];
            met[at].level = casting->style->film[f];
        }
    }
    for (size_t i = 0; i < count; i++)
        pass_film(casting, ray, stretch, met[i].at, met[i].level, seen);
}

static void find_surface(const struct casting *casting, const struct gsn_ray *ray,
                         const struct stretch *stretch, struct seen *seen)
{
    double root[3];

    if (stretch->value[0] >= casting->style->level) {
        meet_surface(casting, ray, stretch, 0, stretch->fresh, seen);
    } else if (find_roots(stretch->value, casting->style->level, root) > 0) {
        pass_films(casting, ray, stretch, root[0], seen);
        meet_surface(casting, ray, stretch, root[0], 0, seen);
    } else {
        pass_films(casting, ray, stretch, INFINITY, seen);
    }
}

/* --- a ray --- */

/* The sum of what is active between two places. */
static void sum_active(const struct tile *tile, size_t count, double from, double to,
                       struct stretch *ret)
{
    *ret = (struct stretch){ .from = from, .length = to - from };
    for (size_t i = 0; i < count; i++) {
        const struct kept *kept = &tile->kept[tile->active[i]];
        const double span = kept->to - kept->from;
        const double at = (from - kept->from) / span, scale = (to - from) / span;

        add_shifted(kept->value, at, scale, ret->value);
        for (int c = 0; tile->casting->with_slope && c < 3; c++)
            add_shifted(tile->slope[tile->active[i]][c], at, scale, ret->slope[c]);
        for (int c = 0; tile->casting->with_tint && c < 3; c++)
            add_shifted(tile->tint[tile->active[i]][c], at, scale, ret->tint[c]);
    }
}

/* The whole of it between two places: a piece is 0..1 of itself. */
static double integrate_piece(const struct kept *kept, double from, double to)
{
    const double span = kept->to - kept->from, low = (from - kept->from) / span;
    const double high = (to - kept->from) / span, *c = kept->value;
    const double upper = high * (c[0] + high * (c[1] / 2 + high * (c[2] / 3 + high * c[3] / 4)));
    const double lower = low * (c[0] + low * (c[1] / 2 + low * (c[2] / 3 + low * c[3] / 4)));

    return span * (upper - lower);
}

/* An X-ray is a sum: the pieces, where the ray is in the mesh and in what the clip leaves of it. */
static int add_integrals(struct tile *tile, const uint32_t *order, size_t count, struct seen *seen,
                         struct gsn_error *err)
{
    const double least = 1e-9 / tile->casting->camera.px_per_um; /* um: rounding of places */
    struct gsn_ray_spans *runs = &tile->runs;
    int r = GSN_OK;

    runs->count = 0;
    for (size_t i = 0; r >= 0 && i < count; i++) {
        const struct kept *kept = &tile->kept[order[i]];

        if (!kept->home)
            continue;
        if (runs->count > 0 && kept->from <= runs->span[runs->count - 1][1] + least)
            runs->span[runs->count - 1][1] = fmax(kept->to, runs->span[runs->count - 1][1]);
        else
            r = gsn_ray_add_span(runs, kept->from, kept->to, err);
    }
    for (size_t s = 0; r >= 0 && s < tile->spans.count; s++) {
        for (size_t k = 0; k < runs->count; k++) {
            const double from = fmax(tile->spans.span[s][0], runs->span[k][0]);
            const double to = fmin(tile->spans.span[s][1], runs->span[k][1]);

            if (!(to - from > least))
                continue;
            seen->any = 1;
            for (size_t i = 0; i < count; i++) {
                const struct kept *kept = &tile->kept[order[i]];

                if (kept->from < to && kept->to > from)
                    seen->integral +=
                        integrate_piece(kept, fmax(from, kept->from), fmin(to, kept->to));
            }
        }
    }
    return r;
}

/* Goes along the pieces, which are in the order in which they begin, keeping what is active. */
static void follow_ray(struct tile *tile, const struct gsn_ray *ray, const uint32_t *order,
                       size_t count, struct seen *seen)
{
    const double least = 1e-9 / tile->casting->camera.px_per_um; /* um: rounding of places */
    size_t opened = 0, active = 0;

    for (size_t s = 0; s < tile->spans.count && !seen->done; s++) {
        const double end = tile->spans.span[s][1];
        double t = tile->spans.span[s][0], next;
        int fresh = 1;

        for (; t < end && !seen->done; t = next) {
            size_t homes = 0, left = 0;
            struct stretch stretch;

            next = end;
            for (; opened < count && tile->kept[order[opened]].from <= t; opened++)
                tile->active[active++] = order[opened];
            for (size_t i = 0; i < active; i++) {
                const struct kept *kept = &tile->kept[tile->active[i]];

                if (kept->to <= t)
                    continue;
                tile->active[left++] = tile->active[i];
                homes += kept->home;
                next = fmin(next, kept->to);
            }
            active = left;
            if (opened < count)
                next = fmin(next, tile->kept[order[opened]].from);
            if (!(next - t > least))
                continue;
            if (homes == 0) {
                fresh = 1;
                continue;
            }
            sum_active(tile, active, t, next, &stretch);
            stretch.fresh = fresh;
            /* Of so many ends; a stretch has seven parts at most. */
            stretch.share = 1 / (16.0 * (double)(count + tile->spans.count));
            if (tile->casting->mode == MODE_VOLUME)
                add_volume(tile->casting, ray, &stretch, seen);
            else
                find_surface(tile->casting, ray, &stretch, seen);
            fresh = 0;
        }
    }
}

/* The pieces order[0..count) belong to the ray; nearly in the order in which they begin, because
 * tetrahedra are visited by depth. */
static int cast_ray(struct tile *tile, const struct gsn_ray *ray, uint32_t *order, size_t count,
                    struct seen *seen, struct gsn_error *err)
{
    const struct gsn_ray_clip *clip = tile->casting->clip;
    double from = INFINITY, to = -INFINITY;
    int r;

    for (size_t i = 0; i < count; i++) {
        const uint32_t piece = order[i];
        const struct kept *kept = &tile->kept[piece];
        size_t at = i;

        for (; at > 0 && tile->kept[order[at - 1]].from > kept->from; at--)
            order[at] = order[at - 1];
        order[at] = piece;
        if (kept->home) {
            from = fmin(from, kept->from);
            to = fmax(to, kept->to);
        }
    }
    if (!(from < to))
        return GSN_OK;
    tile->spans.count = 0;
    r = clip && clip->border ? gsn_ray_find_spans(clip, ray, from, to, &tile->spans, err)
                             : gsn_ray_add_span(&tile->spans, from, to, err);
    if (r >= 0 && tile->casting->mode == MODE_XRAY)
        return add_integrals(tile, order, count, seen, err);
    if (r >= 0)
        follow_ray(tile, ray, order, count, seen);
    return r;
}

/* Counting sort of the pieces by ray; ret_start[i] is where those of ray i begin. */
static int order_pieces(struct tile *tile, size_t ret_start[TILE * TILE + 2], struct gsn_error *err)
{
    memset(ret_start, 0, (TILE * TILE + 2) * sizeof *ret_start);
    tile->order = gsn_alloc_array(tile->count, sizeof *tile->order);
    tile->active = gsn_alloc_array(tile->count, sizeof *tile->active);
    if (!tile->order || !tile->active)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the pieces of rays");
    for (size_t i = 0; i < tile->count; i++)
        ret_start[tile->kept[i].ray + 2]++;
    for (size_t i = 2; i < TILE * TILE + 2; i++)
        ret_start[i] += ret_start[i - 1];
    for (size_t i = 0; i < tile->count; i++)
        tile->order[ret_start[tile->kept[i].ray + 1]++] = (uint32_t)i;
    return GSN_OK;
}

static void put_ray(struct casting *casting, size_t at, const struct seen *seen)
{
    if (casting->mode == MODE_XRAY) {
        casting->value[at] = seen->any ? (float)seen->integral : NAN;
        return;
    }
    for (int c = 0; c < 3; c++)
        casting->rgba[at][c] = (float)seen->light[c];
    casting->rgba[at][3] = (float)(1 - seen->left);
}

static int cast_tile(size_t index, void *context, struct gsn_error *err)
{
    struct casting *casting = context;
    const struct gsn_camera *camera = &casting->camera;
    const size_t number = casting->first_tile + index;
    auto_tile tile = { .casting = casting };
    gsn_auto_mem(struct item_line) line = gsn_alloc_array(MOST_LINES, sizeof *line);
    size_t start[TILE * TILE + 2];
    int r = GSN_OK;

    if (!line)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a tile of the picture");
    tile.low[0] = (uint32_t)(number % casting->bins.across) * TILE;
    tile.low[1] = (uint32_t)(number / casting->bins.across) * TILE;
    tile.size[0] = (uint32_t)fmin(TILE, camera->width - tile.low[0]);
    tile.size[1] = (uint32_t)fmin(TILE, camera->height - tile.low[1]);
    for (uint32_t y = 0; y < tile.size[1]; y++) {
        for (uint32_t x = 0; x < tile.size[0]; x++) {
            tile.ray[y * TILE + x] = gsn_ray_of(camera, tile.low[0] + x, tile.low[1] + y);
            if (casting->clip)
                gsn_ray_cut(casting->clip, &tile.ray[y * TILE + x]);
        }
    }
    for (size_t i = casting->bins.start[number]; r >= 0 && i < casting->bins.start[number + 1]; i++)
        r = cast_item(&tile, casting->bins.item[i], line, err);
    if (r >= 0)
        r = order_pieces(&tile, start, err);
    for (uint32_t y = 0; r >= 0 && y < tile.size[1]; y++) {
        for (uint32_t x = 0; r >= 0 && x < tile.size[0]; x++) {
            const size_t ray = y * TILE + x;
            struct seen seen = { .left = 1 };

            r = cast_ray(&tile, &tile.ray[ray], &tile.order[start[ray]],
                         start[ray + 1] - start[ray], &seen, err);
            put_ray(casting, (size_t)(tile.low[1] + y) * camera->width + tile.low[0] + x, &seen);
        }
    }
    return r;
}

/* --- pictures --- */

static int cast_tiles(struct casting *casting, unsigned threads,
                      const struct gsn_progress *progress, struct gsn_error *err)
{
    const size_t tiles = casting->bins.across * casting->bins.down;

    for (size_t batch = 0; batch < BATCHES; batch++) {
        const size_t first = tiles * batch / BATCHES, end = tiles * (batch + 1) / BATCHES;
        int r;

        gsn_progress_say(progress, "rays", first, tiles);
        casting->first_tile = first;
        r = gsn_parallel_for(end - first, threads, cast_tile, casting, err);
        if (r < 0)
            return r;
    }
    gsn_progress_say(progress, "rays", tiles, tiles);
    return GSN_OK;
}

/* All but the average over the rays of a pixel. */
static int cast_rays(struct casting *casting, const struct gsn_camera *camera, unsigned threads,
                     const struct gsn_progress *progress, struct gsn_error *err)
{
    const int light = casting->mode == MODE_VOLUME;
    size_t rays;
    int r = gsn_ray_check(casting->clip, casting->style, casting->mode != MODE_XRAY, light, err);

    if (r >= 0 && casting->mode == MODE_SURFACE && !isfinite(casting->style->level))
        return gsn_fail(err, GSN_E_INPUT, "a surface needs a level");
    for (unsigned f = 0; r >= 0 && casting->mode == MODE_SURFACE && f < casting->style->films; f++)
        if (!(casting->style->film[f] < casting->style->level))
            return gsn_fail(err, GSN_E_INPUT, "a film at %g hides a surface at %g",
                            casting->style->film[f], casting->style->level);
    if (r >= 0)
        r = gsn_ray_camera(camera, casting->style, &casting->camera, err);
    if (r < 0)
        return r;
    casting->with_slope = light && casting->style->shading > 0;
    casting->with_tint = casting->mode != MODE_XRAY && casting->style->colour != NULL;
    if (casting->with_slope)
        casting->blur = gsn_ray_blur(camera, casting->style);
    gsn_ray_colours_init(casting->style->map, &casting->colours);
    rays = (size_t)casting->camera.width * casting->camera.height;
    if (casting->mode == MODE_XRAY)
        casting->value = gsn_alloc_array(rays, sizeof *casting->value);
    else
        casting->rgba = gsn_alloc_array(rays, sizeof *casting->rgba);
    if (!casting->value && !casting->rgba)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu rays", rays);
    r = bin_items(casting, threads, err);
    if (r >= 0)
        r = cast_tiles(casting, threads, progress, err);
    return r;
}

int gsn_ray_xray(const struct gsn_spline *spline, const struct gsn_camera *camera,
                 const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                 unsigned threads, const struct gsn_progress *progress,
                 struct gsn_plane **ret_plane, struct gsn_error *err)
{
    auto_casting casting = { MODE_XRAY, spline, clip, style, .with_slope = 0 };
    int r = cast_rays(&casting, camera, threads, progress, err);

    return r < 0 ? r
                 : gsn_ray_mean_values(casting.value, style->across, camera->width, camera->height,
                                       ret_plane, err);
}

static int make_picture(struct casting *casting, const struct gsn_camera *camera, unsigned threads,
                        const struct gsn_progress *progress, struct gsn_ray_picture **ret_picture,
                        struct gsn_error *err)
{
    int r = cast_rays(casting, camera, threads, progress, err);

    if (r >= 0)
        r = gsn_ray_mean_light((const float(*)[4])casting->rgba, casting->style->across,
                               camera->width, camera->height, ret_picture, err);
    if (r >= 0)
        (*ret_picture)->is_light = casting->mode == MODE_VOLUME && casting->with_tint;
    return r;
}

int gsn_ray_volume(const struct gsn_spline *spline, const struct gsn_camera *camera,
                   const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                   unsigned threads, const struct gsn_progress *progress,
                   struct gsn_ray_picture **ret_picture, struct gsn_error *err)
{
    auto_casting casting = { MODE_VOLUME, spline, clip, style, .with_slope = 0 };

    return make_picture(&casting, camera, threads, progress, ret_picture, err);
}

int gsn_ray_surface(const struct gsn_spline *spline, const struct gsn_camera *camera,
                    const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                    unsigned threads, const struct gsn_progress *progress,
                    struct gsn_ray_picture **ret_picture, struct gsn_error *err)
{
    auto_casting casting = { MODE_SURFACE, spline, clip, style, .with_slope = 0 };

    return make_picture(&casting, camera, threads, progress, ret_picture, err);
}
