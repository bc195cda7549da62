/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Registers one section onto another by their tissue alone, at all rotations and on both faces.
 *
 * Steps: (1) starts: the cross-correlation of the coarsest level of both sections by Fourier
 * transforms (phase correlation without whitening: the bands are even already), for every rotation
 * in steps of 5 degrees (the plain face is the real part, the mirrored one the imaginary: one
 * transform serves both); the highest peaks, at most one of rotations that are nearly the same. (2)
 * Each start is improved in the two coarsest bands, by Gauss-Newton on the differences of the bands
 * (Lucas and Kanade 1981), cells that differ much counting less (Cauchy weights). (3) The best of
 * them and the best that is another go down to the finest band; the more likely one is kept. (4)
 * The same from b onto a: the pose is the motion half way between both, and how far the two are
 * apart says how well it is known.
 *
 * A band of correlation rho carries information in proportion to rho^2 / (1 - rho^2); the evidence
 * is the logarithm of the likelihood ratio against sections that share nothing, over all bands.
 * Fails when nothing is shared or memory runs out. */
#include "pipeline/register/tissue/pairwise.h"

#include "pipeline/core/linalg.h"
#include "pipeline/imaging/fourier.h"
#include "pipeline/register/tissue/bands.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* Every rotation in steps of 5 degrees: half a step moves the outline by less than a cell. */
enum { N = 64, ANGLES = 72 };

/* Complex numbers. */
struct spectrum {
    float z[N][N][2];
};

struct peak {
    double height, angle;
    int mirrored, dx, dy;
};

struct buffers {
    struct spectrum a, b;
    struct peak peak[2 * ANGLES];
    double step; /* side of a cell here, in cells of the first level */
};

/* ---- starts ------------------------------------------------------------------------------- */

static float interpolate(const float *plane, size_t w, size_t h, double x, double y)
{
    const double u = x - 0.5, v = y - 0.5;
    const int i = (int)floor(u), j = (int)floor(v);
    const float fx = (float)(u - i), fy = (float)(v - j);
    const float *at;

    if (i < 0 || j < 0 || i + 1 >= (int)w || j + 1 >= (int)h)
        return 0;
    at = plane + (size_t)j * w + (size_t)i;
    return (at[0] * (1 - fx) + at[1] * fx) * (1 - fy) + (at[w] * (1 - fx) + at[w + 1] * fx) * fy;
}

/* The section about its centre, turned and perhaps mirrored, as the real (0) or imaginary (1) part;
 * a cell is step of the first level. */
static void rotate_onto_grid(const struct gsn_tissue *t, double step, double angle, int mirrored,
                             int part, struct spectrum *onto)
{
    const struct gsn_tissue_band *band = &t->band[t->levels - 1];
    const double scale = ldexp(1, (int)t->levels - 1);
    const double c = cos(angle) * step / scale, s = sin(angle) * step / scale;
    const double m = mirrored ? -1 : 1;

    for (int y = 0; y < N; y++)
        for (int x = 0; x < N; x++) {
            const double u = m * (x - N / 2), v = y - N / 2;

            onto->z[y][x][part] =
                interpolate(t->whole, band->w, band->h, t->centre.x / scale + c * u - s * v,
                            t->centre.y / scale + s * u + c * v);
        }
}

static void find_peak(const struct spectrum *s, int part, double angle, struct peak *peak)
{
    *peak = (struct peak){ .angle = angle, .mirrored = part };
    for (int y = 0; y < N; y++)
        for (int x = 0; x < N; x++)
            if ((double)s->z[y][x][part] > peak->height) {
                peak->height = (double)s->z[y][x][part];
                peak->dx = x < N / 2 ? x : x - N;
                peak->dy = y < N / 2 ? y : y - N;
            }
}

/* The plain face is the real part and the mirrored one the imaginary: one transform for both. */
static int correlate_rotation(struct buffers *room, const struct gsn_tissue *b, double angle,
                              struct peak ret_peak[2], struct gsn_error *err)
{
    struct spectrum *s = &room->b;
    int r;

    rotate_onto_grid(b, room->step, angle, 0, 0, s);
    rotate_onto_grid(b, room->step, angle, 1, 1, s);
    r = gsn_fourier(&s->z[0][0][0], N, N, 0, err);
    for (size_t i = 0; r >= 0 && i < (size_t)N * N; i++) {
        const float *p = (&room->a.z[0][0])[i];
        float *q = (&s->z[0][0])[i];
        const float re = q[0] * p[0] + q[1] * p[1], im = q[1] * p[0] - q[0] * p[1];

        q[0] = re;
        q[1] = im;
    }
    if (r >= 0)
        r = gsn_fourier(&s->z[0][0][0], N, N, 1, err);
    if (r < 0)
        return r;
    find_peak(s, 0, angle, &ret_peak[0]);
    find_peak(s, 1, angle, &ret_peak[1]);
    return GSN_OK;
}

/* A point u of a lies at c_b + R F (u - c_a + shift). */
static struct gsn_affine peak_motion(const struct gsn_tissue *a, const struct gsn_tissue *b,
                                     const struct peak *peak, double scale)
{
    const double c = cos(peak->angle), s = sin(peak->angle), m = peak->mirrored ? -1 : 1;
    const struct gsn_point at = { peak->dx * scale - a->centre.x, peak->dy * scale - a->centre.y };
    struct gsn_affine map = { m * c, -s, 0, m * s, c, 0 };
    const struct gsn_point moved = gsn_affine_apply(&map, at);

    map.m02 = b->centre.x + moved.x;
    map.m12 = b->centre.y + moved.y;
    return map;
}

static int are_alike(const struct peak *p, const struct peak *q)
{
    const double step = 2 * M_PI / ANGLES;

    return p->mirrored == q->mirrored &&
           fabs(remainder(p->angle - q->angle, 2 * M_PI)) < 2.5 * step;
}

/* The highest peaks, at most one of rotations that are nearly the same. */
static size_t list_highest(const struct buffers *room, size_t most, struct peak *ret_peak)
{
    size_t count = 0;

    while (count < most) {
        const struct peak *best = NULL;

        for (size_t i = 0; i < (size_t)2 * ANGLES; i++) {
            const struct peak *p = &room->peak[i];
            int taken = p->height <= 0;

            for (size_t k = 0; k < count && !taken; k++)
                taken = are_alike(p, &ret_peak[k]);
            if (!taken && (!best || p->height > best->height))
                best = p;
        }
        if (!best)
            break;
        ret_peak[count++] = *best;
    }
    return count;
}

/* The likeliest starts of a search, at most so many. Fails with GSN_E_NOMEM. */
static int find_starts(const struct gsn_tissue *a, const struct gsn_tissue *b, size_t most,
                       struct gsn_affine *ret_start, size_t *ret_count, struct gsn_error *err)
{
    gsn_auto_mem(struct buffers) room = gsn_alloc_array(1, sizeof *room);
    gsn_auto_mem(struct peak) peak = gsn_alloc_array(most, sizeof *peak);
    int r;

    if (!room || !peak)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying a section by its tissue");
    room->step = ldexp(1, (int)(a->levels > b->levels ? a->levels : b->levels) - 1);
    rotate_onto_grid(a, room->step, 0, 0, 0, &room->a);
    r = gsn_fourier(&room->a.z[0][0][0], N, N, 0, err);
    for (size_t i = 0; r >= 0 && i < ANGLES; i++)
        r = correlate_rotation(room, b, 2 * M_PI * (double)i / ANGLES, &room->peak[2 * i], err);
    if (r < 0)
        return r;
    *ret_count = list_highest(room, most, peak);
    for (size_t i = 0; i < *ret_count; i++)
        ret_start[i] = peak_motion(a, b, &peak[i], room->step);
    return GSN_OK;
}

/* ---- least squares in one band ------------------------------------------------------------ */

/* A motion between cells of the first level of two sections. */
struct fit {
    struct gsn_affine a_to_b;
    double information[3][3];
    double evidence, variance; /* of the evidence, by chance */
};

enum { STEPS = 12, STARTS = 8, COARSE_BANDS = 2 };

/* A residual of so many deviations counts half: debris, folds and marks differ by more. */
static const double HALF_WEIGHT = 3;

/* A step that moves no tissue by more of a cell of the band worked on is the last. */
static const double STILL = 0.02;

/* Correlations above this are of the same picture; they would count infinitely. */
static const double MOST_ALIKE = 0.999;

/* What a band says of the motion. With r = b - rho a, both scaled to variance 1, and D the motion
 * that is left, r = rho grad a . D: least squares, in sums that need rho only afterwards. */
struct sums {
    double aa, bb, ab, aaaa; /* of the two bands where they overlap */
    double h[3][3], ja[3], jb[3];
};

/* What the last pass found, for this one's weights. */
struct scale {
    double a, b, rho; /* deviations, correlation; a 0: nothing known yet */
};

struct frame {
    const struct gsn_tissue_band *a, *b;
    struct gsn_affine map;   /* in cells of this band */
    struct gsn_point centre; /* of a, in cells of this band */
    struct scale scale;
    const struct gsn_affine *to_grid; /* of a's cells of this band; NULL: no columns */
};

struct row {
    double aa, bb, ab, aaaa, xx, xy, yy, xt, yt, tt, xa, ya, ta, xb, yb, tb;
};

static float robust_weight(const struct scale *s, float a, float b)
{
    const double limit = HALF_WEIGHT * HALF_WEIGHT;
    const double r = (double)b / s->b - s->rho * (double)a / s->a;

    return (float)(limit / (limit + r * r / (1 - s->rho * s->rho)));
}

/* Which column of the tissue a cell belongs to; all to the first where there are no columns. */
static size_t find_column(const struct frame *f, double x, double y)
{
    const struct gsn_affine *m = f->to_grid;
    const double last = GSN_TISSUE_COLUMNS_SIDE - 1;
    double u, v;

    if (!m)
        return 0;
    u = fmin(fmax(floor(m->m00 * x + m->m01 * y + m->m02), 0), last);
    v = fmin(fmax(floor(m->m10 * x + m->m11 * y + m->m12), 0), last);
    return (size_t)v * GSN_TISSUE_COLUMNS_SIDE + (size_t)u;
}

static void add_row(const struct frame *f, size_t y, struct row *rows)
{
    const size_t w = f->a->w, bw = f->b->w;
    const float c = (float)f->map.m00, s = (float)f->map.m10;
    const double y0 = (double)y + 0.5;
    const float u0 = (float)(f->map.m01 * y0 + f->map.m02 + 0.5 * f->map.m00 - 0.5);
    const float v0 = (float)(f->map.m11 * y0 + f->map.m12 + 0.5 * f->map.m10 - 0.5);
    const float last_u = (float)f->b->w - 1.001f, last_v = (float)f->b->h - 1.001f;
    const float turn_y = (float)(y0 - f->centre.y);
    const float *a = f->a->value + y * w, *dx = f->a->dx + y * w, *dy = f->a->dy + y * w;

    for (size_t x = 0; x < w; x++) {
        const float u = u0 + c * (float)x, v = v0 + s * (float)x;
        struct row *row = rows;
        size_t i, j;
        float fu, fv, b, k, g, gx = dx[x], gy = dy[x], gt;
        const float *at;

        if (!(u >= 0 && v >= 0 && u <= last_u && v <= last_v))
            continue;
        i = (size_t)u;
        j = (size_t)v;
        fu = u - (float)i;
        fv = v - (float)j;
        at = f->b->value + j * bw + i;
        b = (at[0] + (at[1] - at[0]) * fu) * (1 - fv) + (at[bw] + (at[bw + 1] - at[bw]) * fu) * fv;
        k = f->scale.a > 0 ? robust_weight(&f->scale, a[x], b) : 1;
        gt = gy * ((float)x + 0.5f - (float)f->centre.x) - gx * turn_y;
        g = k * a[x];
        if (f->to_grid)
            row += find_column(f, (double)x + 0.5, y0);
        row->aa += (double)(g * a[x]);
        row->ab += (double)(g * b);
        row->bb += (double)(k * b * b);
        row->aaaa += (double)(g * a[x] * a[x] * a[x]);
        row->xa += (double)(g * gx);
        row->ya += (double)(g * gy);
        row->ta += (double)(g * gt);
        g = k * b;
        row->xb += (double)(g * gx);
        row->yb += (double)(g * gy);
        row->tb += (double)(g * gt);
        gx *= k;
        row->xx += (double)(gx * dx[x]);
        row->xy += (double)(gx * gy);
        row->xt += (double)(gx * gt);
        row->yy += (double)(k * gy * gy);
        row->yt += (double)(k * gy * gt);
        row->tt += (double)(k * gt * gt);
    }
}

static struct sums sums_of_row(const struct row *r)
{
    return (struct sums){
        .aa = r->aa,
        .bb = r->bb,
        .ab = r->ab,
        .aaaa = r->aaaa,
        .h = { { r->xx, r->xy, r->xt }, { r->xy, r->yy, r->yt }, { r->xt, r->yt, r->tt } },
        .ja = { r->xa, r->ya, r->ta },
        .jb = { r->xb, r->yb, r->tb },
    };
}

static struct sums sum_band(const struct frame *f)
{
    struct row r = { 0 };

    for (size_t y = 1; y + 1 < f->a->h; y++)
        add_row(f, y, &r);
    return sums_of_row(&r);
}

/* How many independent cells a band has where there is tissue: for n normal numbers the fourth
 * moment is 3 n, and glass adds nothing to either. Neighbouring cells of a band share some of their
 * noise, which its blur spreads over about four of them. */
static double count_independent(const struct sums *s)
{
    return s->aaaa > 0 ? 3 * s->aa * s->aa / s->aaaa / 4 : 0;
}

/* ---- All bands ---------------------------------------------------------------------------- */

struct normal {
    double h[3][3], g[3], evidence, variance;
};

/* What of a band's sums pulls at the motion, in cells of the first level; of: the whole band's. */
static void add_pull(const struct sums *s, const struct sums *of, size_t level, double rho,
                     double g[3])
{
    const double size = ldexp(1, (int)level), unit[3] = { size, size, 1 };
    const double weight = count_independent(of) / (1 - rho * rho);

    for (size_t i = 0; i < 3; i++)
        g[i] +=
            weight * rho * (s->jb[i] / sqrt(of->aa * of->bb) - rho * s->ja[i] / of->aa) / unit[i];
}

/* Adds a band at level to the normal equations, in cells of the first level. */
static void add_band(const struct sums *s, size_t level, struct scale *scale, struct normal *normal)
{
    const double size = ldexp(1, (int)level), unit[3] = { size, size, 1 };
    const double n = count_independent(s);
    double rho, weight;

    scale->a = 0;
    if (!(s->aa > 0) || !(s->bb > 0) || !(n > 0))
        return;
    rho = s->ab / sqrt(s->aa * s->bb);
    if (!(rho > 0)) {
        return;
    }
    rho = fmin(rho, MOST_ALIKE);
    weight = n / (1 - rho * rho);
    *scale = (struct scale){ 1, 1, rho };
    /* Deviations over the cells with tissue. */
    scale->a = sqrt(s->aa / (4 * n));
    scale->b = sqrt(s->bb / (4 * n));
    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++)
            normal->h[i][j] += weight * rho * rho * s->h[i][j] / s->aa / (unit[i] * unit[j]);
    add_pull(s, s, level, rho, normal->g);
    normal->evidence -= 0.5 * n * log(1 - rho * rho);
    /* A correlation of n errs by (1 - rho^2) / sqrt(n). */
    normal->variance += n * rho * rho;
}

static void frame_at(const struct gsn_tissue *a, const struct gsn_tissue *b, size_t level,
                     const struct gsn_affine *map, struct frame *f)
{
    const double size = ldexp(1, (int)level);

    f->a = &a->band[level];
    f->b = &b->band[level];
    f->map = *map;
    f->map.m02 /= size;
    f->map.m12 /= size;
    f->centre = (struct gsn_point){ a->centre.x / size, a->centre.y / size };
    f->to_grid = NULL;
}

/* Takes the motion that is left off: map o (turn by t about the centre, shift)^-1. */
static void apply_step(struct gsn_affine *map, struct gsn_point centre, const double move[3])
{
    const double c = cos(move[2]), s = sin(move[2]);
    const struct gsn_affine left = { c, -s, centre.x + move[0] - c * centre.x + s * centre.y,
                                     s, c,  centre.y + move[1] - s * centre.x - c * centre.y };
    const struct gsn_affine back = gsn_affine_inverse(&left);

    *map = gsn_affine_compose(&back, map);
}

static int solve_normal(const struct normal *normal, double ret_move[3])
{
    double a[3][3];

    memcpy(a, normal->h, sizeof a);
    memcpy(ret_move, normal->g, 3 * sizeof *ret_move);
    return gsn_solve_spd(&a[0][0], 3, 3, ret_move);
}

/* Improves the motion in the bands from the coarsest to finest. */
static void improve_band(const struct gsn_tissue *a, const struct gsn_tissue *b, size_t finest,
                         struct fit *fit)
{
    const size_t levels = a->levels < b->levels ? a->levels : b->levels;
    struct frame frame[GSN_TISSUE_LEVELS] = { 0 };
    const double least = STILL * ldexp(1, (int)finest);

    for (int pass = 0; pass < STEPS; pass++) {
        struct normal normal = { 0 };
        double move[3];
        double far;

        for (size_t l = finest; l < levels; l++) {
            struct sums sums;

            frame_at(a, b, l, &fit->a_to_b, &frame[l]);
            sums = sum_band(&frame[l]);
            add_band(&sums, l, &frame[l].scale, &normal);
        }
        memcpy(fit->information, normal.h, sizeof fit->information);
        fit->evidence = normal.evidence;
        fit->variance = normal.variance;
        if (solve_normal(&normal, move) < 0)
            return;
        far = hypot(hypot(move[0], move[1]), move[2] * a->radius);
        /* The slopes of a band reach about a cell of its coarsest. */
        if (far > ldexp(1, (int)levels))
            for (size_t i = 0; i < 3; i++)
                move[i] *= ldexp(1, (int)levels) / far;
        apply_step(&fit->a_to_b, a->centre, move);
        if (far < least)
            return;
    }
}

/* ---- Matches ------------------------------------------------------------------------------ */

/* From the coarsest bands to the finest. */
static void improve_all_bands(const struct gsn_tissue *a, const struct gsn_tissue *b,
                              struct fit *fit)
{
    const size_t levels = a->levels < b->levels ? a->levels : b->levels;

    for (size_t l = levels > COARSE_BANDS ? levels - COARSE_BANDS : 0;; l--) {
        improve_band(a, b, l, fit);
        if (l == 0)
            return;
    }
}

/* The motion half way between two that are nearly the same, about a's centre; and how far the two
 * are apart over a's tissue. */
static struct gsn_affine average_motions(const struct gsn_affine *p, const struct gsn_affine *q,
                                         const struct gsn_tissue *a, double *ret_apart)
{
    const struct gsn_point u = gsn_affine_apply(p, a->centre), v = gsn_affine_apply(q, a->centre);
    const double sign = gsn_affine_det(p) < 0 ? -1 : 1;
    const double c = p->m11 + q->m11, s = p->m01 + q->m01, size = hypot(c, s);
    const double turn = hypot(p->m11 - q->m11, p->m01 - q->m01);
    struct gsn_affine middle = { sign * c / size, s / size, 0, -sign * s / size, c / size, 0 };
    const struct gsn_point at = gsn_affine_apply(&middle, a->centre);

    middle.m02 = 0.5 * (u.x + v.x) - at.x;
    middle.m12 = 0.5 * (u.y + v.y) - at.y;
    *ret_apart = hypot(hypot(u.x - v.x, u.y - v.y), turn * a->radius);
    return middle;
}

/* Cells to lengths. */
static struct gsn_affine scale_to_lengths(const struct gsn_affine *map, double a_cell,
                                          double b_cell)
{
    const double k = b_cell / a_cell;

    return (struct gsn_affine){ k * map->m00, k * map->m01, b_cell * map->m02,
                                k * map->m10, k * map->m11, b_cell * map->m12 };
}

static int finish_match(const struct gsn_tissue *a, const struct gsn_tissue *b, struct fit *there,
                        struct gsn_tissue_match *ret_match, struct gsn_error *err)
{
    struct fit back;
    struct gsn_affine inverse;
    double h[3][3], apart;
    const double unit[3] = { a->cell, a->cell, 1 };

    improve_all_bands(a, b, there);
    back = (struct fit){ .a_to_b = gsn_affine_inverse(&there->a_to_b) };
    improve_band(b, a, 0, &back);
    inverse = gsn_affine_inverse(&back.a_to_b);
    memcpy(h, there->information, sizeof h);
    if (gsn_invert_spd(&h[0][0], 3, 3) < 0)
        return gsn_fail(err, GSN_E_MARKERS, "the two sections share no detail to lay them by");
    there->a_to_b = average_motions(&there->a_to_b, &inverse, a, &apart);
    ret_match->a_to_b = scale_to_lengths(&there->a_to_b, a->cell, b->cell);
    ret_match->back = apart * a->cell;
    ret_match->evidence = 0.5 * (there->evidence + back.evidence);
    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++)
            ret_match->covariance[i][j] = h[i][j] * unit[i] * unit[j];
    return GSN_OK;
}

/* Whether two motions are one but for what is left to improve: two cells of the coarsest band. */
static int are_same(const struct gsn_affine *p, const struct gsn_affine *q,
                    const struct gsn_tissue *a, size_t levels)
{
    double apart;

    if (gsn_affine_det(p) * gsn_affine_det(q) < 0)
        return 0;
    (void)average_motions(p, q, a, &apart);
    return apart < ldexp(2, (int)levels - 1);
}

static void improve_coarse(const struct gsn_tissue *a, const struct gsn_tissue *b, struct fit *fit)
{
    const size_t levels = a->levels < b->levels ? a->levels : b->levels;

    improve_band(a, b, levels - 1, fit);
    improve_band(a, b, levels > COARSE_BANDS ? levels - COARSE_BANDS : 0, fit);
}

/* The best of all motions in the coarse bands, and the best that is another. */
static int best_two(const struct gsn_tissue *a, const struct gsn_tissue *b, struct fit ret_fit[2],
                    struct gsn_error *err)
{
    const size_t levels = a->levels < b->levels ? a->levels : b->levels;
    struct gsn_affine start[STARTS];
    struct fit best = { .evidence = -1 }, rival = { .evidence = -1 };
    size_t count = 0;
    const int r = find_starts(a, b, STARTS, start, &count, err);

    for (size_t i = 0; r >= 0 && i < count; i++) {
        struct fit fit = { .a_to_b = start[i] };
        int is_best;

        improve_coarse(a, b, &fit);
        is_best = fit.evidence > best.evidence;
        if (best.evidence < 0 || are_same(&fit.a_to_b, &best.a_to_b, a, levels)) {
            best = is_best ? fit : best;
            continue;
        }
        if (is_best || fit.evidence > rival.evidence)
            rival = is_best ? best : fit;
        best = is_best ? fit : best;
    }
    if (r < 0)
        return r;
    if (best.evidence < 0)
        return gsn_fail(err, GSN_E_MARKERS, "the two sections share no detail to lay them by");
    ret_fit[0] = best;
    ret_fit[1] = rival;
    return GSN_OK;
}

/* Coarse bands show little else than the outline, which may fit in two ways: all bands choose. */
double gsn_tissue_apart(struct gsn_point centre, double radius, const struct gsn_affine *p,
                        const struct gsn_affine *q)
{
    const struct gsn_point u = gsn_affine_apply(p, centre), v = gsn_affine_apply(q, centre);
    const double turn =
        hypot(hypot(p->m00 - q->m00, p->m01 - q->m01), hypot(p->m10 - q->m10, p->m11 - q->m11));

    return hypot(hypot(u.x - v.x, u.y - v.y), M_SQRT1_2 * turn * radius);
}

int gsn_tissue_search(const struct gsn_tissue *a, const struct gsn_tissue *b,
                      struct gsn_tissue_match *ret_match, struct gsn_error *err)
{
    struct gsn_tissue_match match = { 0 };
    struct fit fit[2];
    size_t better;
    int r = best_two(a, b, fit, err);

    assert(ret_match);

    if (r < 0)
        return r;
    improve_all_bands(a, b, &fit[0]);
    if (fit[1].evidence > 0)
        improve_all_bands(a, b, &fit[1]);
    better = fit[1].evidence > fit[0].evidence;
    match.rival = fmax(fit[!better].evidence, 0);
    match.spread = sqrt(fit[0].variance + fit[1].variance);
    r = finish_match(a, b, &fit[better], &match, err);
    if (r >= 0)
        *ret_match = match;
    return r;
}

int gsn_tissue_refine(const struct gsn_tissue *a, const struct gsn_tissue *b,
                      const struct gsn_affine *start, struct gsn_tissue_match *ret_match,
                      struct gsn_error *err)
{
    struct gsn_tissue_match match = { 0 };
    struct fit fit = { .a_to_b = scale_to_lengths(start, 1 / a->cell, 1 / b->cell) };
    int r;

    assert(ret_match);

    r = finish_match(a, b, &fit, &match, err);
    if (r >= 0)
        *ret_match = match;
    return r;
}

void gsn_tissue_refine_coarse(const struct gsn_tissue *a, const struct gsn_tissue *b,
                              const struct gsn_affine *start, struct gsn_affine *ret_a_to_b,
                              double *ret_evidence)
{
    struct fit fit = { .a_to_b = scale_to_lengths(start, 1 / a->cell, 1 / b->cell) };

    improve_coarse(a, b, &fit);
    *ret_evidence = fit.evidence;
    *ret_a_to_b = fit.evidence > 0 ? scale_to_lengths(&fit.a_to_b, a->cell, b->cell) : *start;
}

/* ---- Columns ------------------------------------------------------------------------------ */

void gsn_tissue_pulls(const struct gsn_tissue *a, const struct gsn_tissue *b,
                      const struct gsn_affine *a_to_b, const struct gsn_affine *to_grid,
                      double ret_pull[GSN_TISSUE_COLUMNS][3])
{
    const size_t levels = a->levels < b->levels ? a->levels : b->levels;
    const struct gsn_affine map = scale_to_lengths(a_to_b, 1 / a->cell, 1 / b->cell);
    const double unit[3] = { a->cell, a->cell, 1 };
    double g[GSN_TISSUE_COLUMNS][3] = { 0 };
    struct normal normal = { 0 };

    memset(ret_pull, 0, sizeof g);
    for (size_t l = 0; l < levels; l++) {
        const double cell = ldexp(a->cell, (int)l);
        const struct gsn_affine of_cells = { cell, 0, 0, 0, cell, 0 };
        const struct gsn_affine grid = gsn_affine_compose(&of_cells, to_grid);
        struct row rows[GSN_TISSUE_COLUMNS] = { 0 };
        struct frame frame = { 0 };
        struct sums sums;

        frame_at(a, b, l, &map, &frame);
        for (int round = 0; round < 2; round++) {
            struct normal of_band = { 0 };

            sums = sum_band(&frame);
            add_band(&sums, l, &frame.scale, round ? &normal : &of_band);
        }
        if (!(frame.scale.a > 0))
            continue;
        frame.to_grid = &grid;
        for (size_t y = 1; y + 1 < frame.a->h; y++)
            add_row(&frame, y, rows);
        for (size_t k = 0; k < GSN_TISSUE_COLUMNS; k++) {
            const struct sums of_column = sums_of_row(&rows[k]);

            add_pull(&of_column, &sums, l, frame.scale.rho, g[k]);
        }
    }
    for (size_t k = 0; k < GSN_TISSUE_COLUMNS; k++) {
        memcpy(normal.g, g[k], sizeof normal.g);
        if (solve_normal(&normal, ret_pull[k]) < 0)
            continue;
        for (size_t i = 0; i < 3; i++)
            ret_pull[k][i] *= unit[i];
    }
}
