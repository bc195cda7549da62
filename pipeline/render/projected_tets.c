/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Projected tetrahedra (P. Shirley and A. Tuchman 1990, 10.1145/99308.99322), in software.
 *
 * Method: the depth at which a ray enters or leaves through a face is an affine function of the
 * pixel: the depth itself without perspective, with it -1 / depth. So a tetrahedron lies between
 * the greatest of its entering faces' functions and the least of its leaving faces', wherever the
 * one is below the other; the classes of silhouettes and the fans of triangles of the paper follow
 * from these four functions and need not be told apart. Between two such depths a linear density
 * has the mean of the middle. A face has one function, computed from its vertices in one order,
 * whichever tetrahedron asks: what the one loses to rounding the other gains, and no pixel of a
 * shared edge is counted twice or not at all. A face that is seen edge on is tilted by 1e-12.
 *
 * Light is composed in order of visibility: cells are visited by the depth of their middles, and
 * each pixel keeps its stretches sorted by depth, which settles what middles cannot (cycles, cells
 * of different size, domains with hollows).
 *
 * Steps: (1) a cell's four functions, its linear density, and the pixels it may touch; (2) cells by
 * depth, into tiles of pixels; (3) tile by tile: what the clip leaves of each ray, in layers of one
 * stretch a pixel; rows of each cell; (4) sums, or the sorted stretches composed; (5) rays of a
 * pixel averaged.
 *
 * Failure: GSN_E_INPUT on a style or clip that cannot be; GSN_E_LIMIT; GSN_E_NOMEM.
 * Cost: a few flops a pixel and cell; about 190 bytes a cell. */
#include "pipeline/render/projected_tets.h"

#include "pipeline/core/geom.h"
#include "pipeline/core/parallel.h"
#include "pipeline/model/pieces.h"
#include "pipeline/render/rays_internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { TILE = 64, PIXELS = TILE * TILE, PER_CHUNK = 512, BATCHES = 20, LANES = 8 };

/* Of its depth, a face's rise over a micrometre beside it. */
#define EDGE_ON 1e-12
/* -1 / depth where there is next to none. */
#define AT_EYE (-1e30F)

/* Places (X, Y) in the plane of the picture in um, depths from it, or from the eye if there is
 * one. */
struct cell {
    double face[4][3];        /* at[0] + at[1] X + at[2] Y; entering ones first */
    double base[3], slope[3]; /* density at the middle's depth, and its rise with depth */
    float middle, steep2;     /* steep2: the gradient's square */
    unsigned entering;
};

struct order {
    float depth;
    uint32_t cell;
};

struct projection {
    int light;
    const struct gsn_spline *spline;
    const struct gsn_ray_clip *clip;
    const struct gsn_ray_style *style;
    struct gsn_camera camera; /* of rays */
    struct gsn_ray_colours colours;
    double blur, low[3], high[3]; /* of the mesh */
    size_t cells, first_tile;
    struct cell *cell;
    struct gsn_ray_reach *reach;
    struct order *order;
    uint32_t *rank;
    struct gsn_ray_bins bins;
    float *value;
    float (*rgba)[4];
};

static void projection_done(struct projection *p)
{
    gsn_free(p->cell);
    gsn_free(p->reach);
    gsn_free(p->order);
    gsn_free(p->rank);
    gsn_ray_bins_done(&p->bins);
    gsn_free(p->value);
    gsn_free(p->rgba);
}
#define auto_projection __attribute__((cleanup(projection_done))) struct projection

/* --- cells --- */

/* The middle of a pixel in the plane of the picture, um; as gsn_ray_of() has it. */
static double place_of(const struct gsn_camera *camera, int down, double pixel)
{
    return (pixel + 0.5 + (down ? 0.7e-9 : 1.1e-9) -
            0.5 * (down ? camera->height : camera->width)) /
           camera->px_per_um;
}

static void see_vector(const struct gsn_camera *camera, const double vector[3], double ret[3])
{
    ret[0] = gsn_dot3(vector, camera->right);
    ret[1] = gsn_dot3(vector, camera->down);
    ret[2] = gsn_dot3(vector, camera->into);
}

/* Right, down and depth. */
static void see_point(const struct gsn_camera *camera, const double point[3], double ret[3])
{
    const double away[3] = { point[0] - camera->centre[0], point[1] - camera->centre[1],
                             point[2] - camera->centre[2] };

    see_vector(camera, away, ret);
    ret[2] += camera->eye_um;
}

static void order_two(uint32_t id[3], int i, int j, int *turned)
{
    const uint32_t kept = id[i];

    if (id[i] < id[j])
        return;
    id[i] = id[j];
    id[j] = kept;
    *turned = !*turned;
}

/* The function of the face opposite a corner; returns whether rays enter through it. Inside,
 * normal . u > height, where u is (X, Y, depth), or with an eye depth (X / eye, Y / eye, 1). */
static int project_face(const struct projection *p, size_t tet, int corner, double ret_face[3])
{
    const struct gsn_tets *mesh = gsn_dms_mesh(gsn_spline_space(p->spline));
    const double eye = p->camera.eye_um, far = eye > 0 ? eye : 1;
    double at[3][3], edge[2][3], normal[3], height, rate, least;
    uint32_t id[3];
    int n = 0, turned = corner % 2 == 0;

    for (int k = 0; k < 4; k++) {
        if (k != corner)
            id[n++] = mesh->tet[tet][k];
    }
    order_two(id, 0, 1, &turned);
    order_two(id, 1, 2, &turned);
    order_two(id, 0, 1, &turned);
    for (int k = 0; k < 3; k++)
        see_point(&p->camera, mesh->vertex[id[k]], at[k]);
    for (int c = 0; c < 3; c++) {
        edge[0][c] = at[1][c] - at[0][c];
        edge[1][c] = at[2][c] - at[0][c];
    }
    gsn_cross3(edge[0], edge[1], normal);
    height = gsn_dot3(normal, at[0]);
    rate = eye > 0 ? height : normal[2];
    least = EDGE_ON * far * sqrt(gsn_dot3(normal, normal));
    if (!(fabs(rate) > least))
        rate = copysign(least, rate);
    ret_face[0] = (eye > 0 ? -normal[2] : height) / rate;
    ret_face[1] = -normal[0] / (far * rate);
    ret_face[2] = -normal[1] / (far * rate);
    return (rate > 0) != turned;
}

/* The corner values of the linear function that is nearest to a polynomial in least squares over
 * its tetrahedron: the moments of both with the barycentric coordinates are equal. */
static void fit_linear(const struct gsn_dms *space, const double *bernstein, double ret_corner[4])
{
    const unsigned n = gsn_dms_degree(space);
    const double share = 1.0 / (n + 1) / ((n + 4) * (n + 3) * (n + 2) / 6.0);
    double moment[4] = { 0 };

    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        for (int k = 0; k < 4; k++)
            moment[k] += share * (gsn_dms_beta(space, f)[k] + 1) * bernstein[f];
    }
    for (int k = 0; k < 4; k++)
        ret_corner[k] = 20 * moment[k] - 4 * (moment[0] + moment[1] + moment[2] + moment[3]);
}

static void fit_density(const struct projection *p, size_t tet, struct cell *cell)
{
    const double eye = p->camera.eye_um, middle = (double)cell->middle;
    double corner[4], gradient[3] = { 0 }, seen[3], origin[3];
    struct gsn_tet_line line;

    gsn_tet_line_init(p->spline, tet, &line);
    fit_linear(gsn_spline_space(p->spline), line.coefficient, corner);
    for (int k = 1; k < 4; k++) {
        for (int c = 0; c < 3; c++)
            gradient[c] += (corner[k] - corner[0]) * line.frame.row[k - 1][c];
    }
    see_vector(&p->camera, gradient, seen);
    see_point(&p->camera, line.frame.origin, origin);
    cell->steep2 = (float)gsn_dot3(gradient, gradient);
    memset(cell->slope, 0, sizeof cell->slope);
    cell->slope[0] = seen[2];
    cell->base[0] = corner[0] - gsn_dot3(seen, origin) + seen[2] * middle;
    for (int c = 0; c < 2; c++) {
        cell->slope[1 + c] = eye > 0 ? seen[c] / eye : 0;
        cell->base[1 + c] = eye > 0 ? seen[c] / eye * middle : seen[c];
    }
}

static void project_cell(struct projection *p, size_t tet)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(gsn_spline_space(p->spline));
    struct cell *cell = &p->cell[tet];
    double low[2] = { INFINITY, INFINITY }, high[2] = { -INFINITY, -INFINITY }, depth = 0;
    double face[3];
    int leaving = 3, before = 0; /* the eye */

    cell->entering = 0;
    for (int k = 0; k < 4; k++) {
        const double *vertex = mesh->vertex[mesh->tet[tet][k]];
        double seen[3];

        see_point(&p->camera, vertex, seen);
        before += p->camera.eye_um > 0 ? seen[2] > 0 : 1;
        depth += seen[2] / 4;
        gsn_ray_reach_point(&p->camera, vertex, low, high);
        if (project_face(p, tet, k, face))
            memcpy(cell->face[cell->entering++], face, sizeof face);
        else
            memcpy(cell->face[leaving--], face, sizeof face);
    }
    cell->middle = (float)depth;
    p->order[tet] = (struct order){ cell->middle, (uint32_t)tet };
    p->reach[tet] = gsn_ray_reach_of(&p->camera, low, high);
    /* Behind the eye; or flat but for rounding, when no ray has any of it. */
    if (before == 0 || cell->entering == 4 || (cell->entering == 0 && before == 4))
        p->reach[tet].high[0] = (int16_t)(p->reach[tet].low[0] - 1);
    fit_density(p, tet, cell);
}

static int project_chunk(size_t chunk, void *context, struct gsn_error *err)
{
    struct projection *p = context;

    (void)err;
    for (size_t t = chunk * PER_CHUNK; t < p->cells && t < (chunk + 1) * PER_CHUNK; t++)
        project_cell(p, t);
    return GSN_OK;
}

static int by_depth(const void *a, const void *b)
{
    const struct order *p = a, *q = b;

    if (p->depth < q->depth || p->depth > q->depth)
        return p->depth < q->depth ? -1 : 1;
    return (p->cell > q->cell) - (p->cell < q->cell);
}

static int project_cells(struct projection *p, unsigned threads, struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(gsn_spline_space(p->spline));
    int r;

    p->cells = mesh->tet_count;
    if (p->cells > UINT32_MAX)
        return gsn_fail(err, GSN_E_LIMIT, "%zu tetrahedra are too many for a picture", p->cells);
    p->cell = gsn_alloc_array(p->cells, sizeof *p->cell);
    p->reach = gsn_alloc_array(p->cells, sizeof *p->reach);
    p->order = gsn_alloc_array(p->cells, sizeof *p->order);
    p->rank = gsn_alloc_array(p->cells, sizeof *p->rank);
    if (!p->cell || !p->reach || !p->order || !p->rank)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a picture of %zu tetrahedra",
                        p->cells);
    for (int c = 0; c < 3; c++) {
        p->low[c] = INFINITY;
        p->high[c] = -INFINITY;
        for (size_t v = 0; v < mesh->vertex_count; v++) {
            p->low[c] = fmin(p->low[c], mesh->vertex[v][c]);
            p->high[c] = fmax(p->high[c], mesh->vertex[v][c]);
        }
    }
    r = gsn_parallel_for((p->cells + PER_CHUNK - 1) / PER_CHUNK, threads, project_chunk, p, err);
    if (r < 0)
        return r;
    /* An X-ray is a sum, and sums in any order that is always the same. */
    if (p->light)
        qsort(p->order, p->cells, sizeof *p->order, by_depth);
    for (size_t i = 0; i < p->cells; i++)
        p->rank[i] = p->order[i].cell;
    return gsn_ray_bin(p->reach, p->rank, p->cells, &p->camera, TILE, &p->bins, err);
}

/* --- a tile --- */

/* What a cell gives to a pixel. */
struct stretch {
    float at, depth; /* where it begins; optical */
    float share, shade;
};

/* A stretch of every ray of the tile, in the faces' terms; nothing where from >= to. */
struct layer {
    float from[PIXELS + LANES], to[PIXELS + LANES];
};

struct tile {
    const struct projection *p;
    uint32_t low[2], size[2];
    struct layer *layer;
    size_t layers;
    float norm[PIXELS + LANES]; /* arc length a unit of depth */
    float sum[PIXELS + LANES], length[PIXELS + LANES];
    struct stretch *stretch; /* room a pixel, sorted */
    uint32_t count[PIXELS], room;
};

static void tile_free(struct tile *tile)
{
    if (!tile)
        return;
    gsn_free(tile->layer);
    gsn_free(tile->stretch);
    gsn_free(tile);
}
GSN_DEFINE_AUTO(tile);

/* A place on a ray, from the plane of the picture, in the faces' terms. */
static float face_term(const struct projection *p, const struct gsn_ray *ray, double at)
{
    const double eye = p->camera.eye_um, into = gsn_dot3(ray->into, p->camera.into);
    const double depth = eye + at * into;

    return (float)(eye > 0 ? -1 / fmax(depth, 1e-9 * eye) : at);
}

static int lay_stretch(struct tile *tile, size_t number, size_t pixel, const struct gsn_ray *ray,
                       double from, double to, struct gsn_error *err)
{
    if (number == tile->layers) {
        struct layer *layer = gsn_realloc_array(tile->layer, number + 1, sizeof *layer);

        if (!layer)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for the stretches of rays");
        tile->layer = layer;
        tile->layers++;
        for (size_t i = 0; i < PIXELS + LANES; i++) {
            layer[number].from[i] = 1;
            layer[number].to[i] = -1;
        }
    }
    tile->layer[number].from[pixel] = face_term(tile->p, ray, from);
    tile->layer[number].to[pixel] = face_term(tile->p, ray, to);
    return GSN_OK;
}

/* What the clip leaves of the rays. Without a clip it is all of the mesh. */
static int lay_rays(struct tile *tile, struct gsn_ray_spans *spans, struct gsn_error *err)
{
    const struct projection *p = tile->p;
    int r = GSN_OK;

    for (uint32_t y = 0; y < tile->size[1]; y++) {
        for (uint32_t x = 0; r >= 0 && x < tile->size[0]; x++) {
            const size_t pixel = y * TILE + x;
            struct gsn_ray ray = gsn_ray_of(&p->camera, tile->low[0] + x, tile->low[1] + y);

            tile->norm[pixel] = (float)(1 / gsn_dot3(ray.into, p->camera.into));
            gsn_ray_cut_box(p->low, p->high, &ray);
            if (p->clip)
                gsn_ray_cut(p->clip, &ray);
            if (!(ray.from < ray.to))
                continue;
            spans->count = 0;
            r = p->clip && p->clip->border
                    ? gsn_ray_find_spans(p->clip, &ray, ray.from, ray.to, spans, err)
                    : gsn_ray_add_span(spans, ray.from, ray.to, err);
            for (size_t i = 0; r >= 0 && i < spans->count; i++)
                r = lay_stretch(tile, i, pixel, &ray, spans->span[i][0], spans->span[i][1], err);
        }
    }
    return r;
}

/* A row of a cell: pixels first..last of a row of the tile, and at its pixel 0 the faces'
 * functions, the density at the middle's depth, and its rise with depth; all with what a pixel
 * adds. */
struct row {
    float face[4], face_step[4], base, base_step, slope, slope_step, middle;
    int first, last;
};

static void row_init(const struct tile *tile, const struct cell *cell,
                     const struct gsn_ray_reach *reach, uint32_t y, struct row *ret_row)
{
    const struct gsn_camera *camera = &tile->p->camera;
    const double right = place_of(camera, 0, tile->low[0]);
    const double down = place_of(camera, 1, tile->low[1] + y), px = camera->px_per_um;
    int first = reach->low[0] - (int)tile->low[0], last = reach->high[0] - (int)tile->low[0];

    for (int k = 0; k < 4; k++) {
        const double *face = cell->face[k];

        ret_row->face[k] = (float)(face[0] + face[1] * right + face[2] * down);
        ret_row->face_step[k] = (float)(face[1] / px);
    }
    ret_row->base = (float)(cell->base[0] + cell->base[1] * right + cell->base[2] * down);
    ret_row->base_step = (float)(cell->base[1] / px);
    ret_row->slope = (float)(cell->slope[0] + cell->slope[1] * right + cell->slope[2] * down);
    ret_row->slope_step = (float)(cell->slope[1] / px);
    ret_row->middle = cell->middle;
    first = first > 0 ? first : 0;
    last = last < (int)tile->size[0] ? last : (int)tile->size[0] - 1;
    /* Where every entering face lies before every leaving one, and a pixel more. */
    for (unsigned in = 0; in < cell->entering; in++) {
        for (unsigned out = cell->entering; out < 4; out++) {
            const float ahead = ret_row->face[out] - ret_row->face[in];
            const float step = ret_row->face_step[out] - ret_row->face_step[in];
            const float zero = step != 0 ? -ahead / step : ahead;

            if (step > 0 && zero > (float)first)
                first = zero < TILE ? (int)zero : TILE;
            else if (step < 0 && zero < (float)last)
                last = zero > -1 ? (int)(zero + 1) : -1;
            else if (step == 0 && !(ahead > 0))
                last = -1;
        }
    }
    ret_row->first = first;
    ret_row->last = last;
}

/* Where the rays enter the cell and leave it, from pixel first on, and nowhere from pixel last on
 * to the end of a lane; entering and leaving faces padded to three each. */
static void cross_row(const struct row *row, unsigned entering, float *restrict in,
                      float *restrict out)
{
    const float *face = row->face, *step = row->face_step;
    const float f0 = entering > 0 ? face[0] : AT_EYE, s0 = entering > 0 ? step[0] : 0;
    const float f1 = entering > 1 ? face[1] : f0, s1 = entering > 1 ? step[1] : s0;
    const float f2 = entering > 2 ? face[2] : f0, s2 = entering > 2 ? step[2] : s0;
    const float g1 = entering < 3 ? face[2] : face[3], t1 = entering < 3 ? step[2] : step[3];
    const float g2 = entering < 2 ? face[1] : face[3], t2 = entering < 2 ? step[1] : step[3];
    const float g0 = face[3], t0 = step[3];
    int i = row->first;

    for (; i <= row->last; i += LANES, in += LANES, out += LANES) {
        for (int lane = 0; lane < LANES; lane++) {
            const float x = (float)(i + lane);
            const float a = f0 + s0 * x, b = f1 + s1 * x, c = f2 + s2 * x;
            const float d = g0 + t0 * x, e = g1 + t1 * x, f = g2 + t2 * x;
            const float ab = a > b ? a : b, de = d < e ? d : e;

            in[lane] = ab > c ? ab : c;
            out[lane] = de < f ? de : f;
        }
    }
    /* The eye is in the cell, and all four faces are left through. */
    for (int at = row->first - i; entering == 0 && at < 0; at++)
        out[at] = fminf(out[at], face[0] + step[0] * (float)(i + at));
    for (int beyond = i - row->last - 1; beyond > 0; beyond--) {
        in[-beyond] = 1;
        out[-beyond] = -1;
    }
}

/* Depths of where rays enter and leave, instead of the faces' terms, and whether they do at all. */
static void find_depths(int with_eye, float *restrict in, float *restrict out, int count)
{
    for (int i = 0; with_eye && i < count; i += LANES, in += LANES, out += LANES) {
        for (int lane = 0; lane < LANES; lane++) {
            const int met = in[lane] < out[lane] && out[lane] < 0;

            in[lane] = -1 / (met ? in[lane] : -1);
            out[lane] = -1 / (met ? out[lane] : -1);
        }
    }
}

static void clip_row(const struct layer *layer, size_t pixel, int count, const float *restrict in,
                     const float *restrict out, float *restrict ret_in, float *restrict ret_out)
{
    const float *from = layer->from + pixel, *to = layer->to + pixel;

    for (int i = 0; i < count; i += LANES) {
        for (int lane = 0; lane < LANES; lane++) {
            const int at = i + lane;

            ret_in[at] = in[at] > from[at] ? in[at] : from[at];
            ret_out[at] = out[at] < to[at] ? out[at] : to[at];
        }
    }
}

static void add_sums(struct tile *tile, const struct row *row, size_t pixel, int count,
                     const float *restrict in, const float *restrict out)
{
    float *restrict sum = tile->sum + pixel, *restrict length = tile->length + pixel;
    const float *norm = tile->norm + pixel;

    for (int i = 0; i < count; i += LANES) {
        for (int lane = 0; lane < LANES; lane++) {
            const int at = i + lane;
            const float x = (float)(row->first + at), long_um = (out[at] - in[at]) * norm[at];
            const float depth = (in[at] + out[at]) * 0.5F - row->middle;
            const float density =
                row->base + row->base_step * x + depth * (row->slope + row->slope_step * x);
            const int met = in[at] < out[at];

            sum[at] += met ? long_um * density : 0;
            length[at] += met ? long_um : 0;
        }
    }
}

/* --- light --- */

static int make_room(struct tile *tile, struct gsn_error *err)
{
    const uint32_t room = tile->room ? 2 * tile->room : 32;
    struct stretch *stretch =
        gsn_realloc_array(tile->stretch, (size_t)PIXELS * room, sizeof *stretch);

    if (!stretch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the stretches of rays");
    for (size_t i = PIXELS; i-- > 0 && tile->room > 0;)
        memmove(stretch + i * room, stretch + i * tile->room, tile->count[i] * sizeof *stretch);
    tile->stretch = stretch;
    tile->room = room;
    return GSN_OK;
}

static float unit_clamp(float v)
{
    return v < 0 ? 0 : v > 1 ? 1 : v;
}

/* The integral from 0 to v of what unit_clamp() gives. */
static float clamp_integral(float v)
{
    return v < 0 ? 0 : v < 1 ? v * v / 2 : v - 0.5F;
}

/* The mean of what is clamped of a linear function from a to b. */
static float clamped_mean(float a, float b)
{
    if (fabsf(b - a) < 1e-4F || (a >= 0 && a <= 1 && b >= 0 && b <= 1))
        return unit_clamp((a + b) / 2);
    return (clamp_integral(b) - clamp_integral(a)) / (b - a);
}

static float find_shade(const struct projection *p, float steep2, float rise)
{
    const float steep = sqrtf(steep2), blur = (float)p->blur;

    return 1 - (float)p->style->shading * (steep2 - fminf(fabsf(rise), steep) * steep) /
                   (steep2 + blur * blur);
}

static int add_light(struct tile *tile, const struct cell *cell, const struct row *row,
                     size_t pixel, int count, const float *in, const float *out,
                     struct gsn_error *err)
{
    const struct projection *p = tile->p;
    const float low = (float)p->style->low, scale = 1 / (float)(p->style->high - p->style->low);
    const float per_um = 1 / (float)p->style->opaque_um;
    const int shaded = p->style->shading > 0;

    for (int i = 0; i < count; i++) {
        const float x = (float)(row->first + i), rise = row->slope + row->slope_step * x;
        const float base = row->base + row->base_step * x, norm = tile->norm[pixel + (size_t)i];
        struct stretch *list, made = { .at = in[i] };
        float a, b, mean;
        uint32_t at;

        if (!(in[i] < out[i]))
            continue;
        a = (base + (in[i] - row->middle) * rise - low) * scale;
        b = (base + (out[i] - row->middle) * rise - low) * scale;
        mean = clamped_mean(a, b);
        if (!(mean > 0))
            continue;
        a = unit_clamp(a);
        b = unit_clamp(b);
        made.depth = mean * (out[i] - in[i]) * norm * per_um;
        made.share = a + b > 0 ? (a * a + a * b + b * b) / (1.5F * (a + b)) : 0;
        made.shade = shaded ? find_shade(p, cell->steep2, rise / norm) : 1;
        if (tile->count[pixel + (size_t)i] == tile->room) {
            const int r = make_room(tile, err);

            if (r < 0)
                return r;
        }
        list = tile->stretch + (pixel + (size_t)i) * tile->room;
        for (at = tile->count[pixel + (size_t)i]++; at > 0 && list[at - 1].at > made.at; at--)
            list[at] = list[at - 1];
        list[at] = made;
    }
    return GSN_OK;
}

static void compose(const struct tile *tile, size_t pixel, float ret_rgba[4])
{
    const struct gsn_ray_colours *colours = &tile->p->colours;
    const struct stretch *list = tile->stretch + pixel * tile->room;
    float left = 1, light[3] = { 0 };

    for (uint32_t i = 0; i < tile->count[pixel] && left > (float)GSN_RAY_PART_TOLERANCE; i++) {
        const float kept = left * expf(-list[i].depth), bright = (left - kept) * list[i].shade;
        const float place = list[i].share * (GSN_RAY_COLOURS - 1);
        const int below = place < GSN_RAY_COLOURS - 2 ? (int)place : GSN_RAY_COLOURS - 2;
        const float rest = place - (float)below;
        const double *c0 = colours->at[below], *c1 = colours->at[below + 1];

        for (int c = 0; c < 3; c++)
            light[c] += bright * ((1 - rest) * (float)c0[c] + rest * (float)c1[c]);
        left = kept;
    }
    memcpy(ret_rgba, light, sizeof light);
    ret_rgba[3] = 1 - left;
}

/* --- tiles --- */

static int draw_cell(struct tile *tile, uint32_t number, struct gsn_error *err)
{
    const struct cell *cell = &tile->p->cell[number];
    const struct gsn_ray_reach *reach = &tile->p->reach[number];
    const int with_eye = tile->p->camera.eye_um > 0;
    int r = GSN_OK;

    for (uint32_t y = 0; r >= 0 && y < tile->size[1]; y++) {
        float in[TILE + LANES], out[TILE + LANES], left_in[TILE + LANES], left_out[TILE + LANES];
        struct row row;
        size_t pixel;
        int count;

        if ((int)(tile->low[1] + y) < reach->low[1] || (int)(tile->low[1] + y) > reach->high[1])
            continue;
        row_init(tile, cell, reach, y, &row);
        if (row.first > row.last)
            continue;
        cross_row(&row, cell->entering, in, out);
        count = row.last - row.first + 1;
        pixel = y * TILE + (size_t)row.first;
        for (size_t i = 0; r >= 0 && i < tile->layers; i++) {
            clip_row(&tile->layer[i], pixel, count, in, out, left_in, left_out);
            find_depths(with_eye, left_in, left_out, count);
            if (tile->p->light)
                r = add_light(tile, cell, &row, pixel, count, left_in, left_out, err);
            else
                add_sums(tile, &row, pixel, count, left_in, left_out);
        }
    }
    return r;
}

static int draw_tile(size_t index, void *context, struct gsn_error *err)
{
    struct projection *p = context;
    const size_t number = p->first_tile + index;
    gsn_auto(tile) tile = gsn_alloc_array(1, sizeof *tile);
    struct gsn_ray_spans spans = { 0 };
    int r;

    if (!tile)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a tile of the picture");
    tile->p = p;
    tile->low[0] = (uint32_t)(number % p->bins.across) * TILE;
    tile->low[1] = (uint32_t)(number / p->bins.across) * TILE;
    tile->size[0] = (uint32_t)fmin(TILE, p->camera.width - tile->low[0]);
    tile->size[1] = (uint32_t)fmin(TILE, p->camera.height - tile->low[1]);
    r = lay_rays(tile, &spans, err);
    gsn_ray_spans_done(&spans);
    for (size_t i = p->bins.start[number]; r >= 0 && i < p->bins.start[number + 1]; i++)
        r = draw_cell(tile, p->bins.item[i], err);
    for (uint32_t y = 0; r >= 0 && y < tile->size[1]; y++) {
        for (uint32_t x = 0; x < tile->size[0]; x++) {
            const size_t pixel = y * TILE + x;
            const size_t at = (size_t)(tile->low[1] + y) * p->camera.width + tile->low[0] + x;

            if (p->light)
                compose(tile, pixel, p->rgba[at]);
            else
                p->value[at] = tile->length[pixel] > 0 ? tile->sum[pixel] : NAN;
        }
    }
    return r;
}

/* --- pictures --- */

/* All but the average over the rays of a pixel. */
static int project_tets(struct projection *p, const struct gsn_camera *camera, unsigned threads,
                        const struct gsn_progress *progress, struct gsn_error *err)
{
    size_t rays, tiles;
    int r = gsn_ray_check(p->clip, p->style, p->light, p->light, err);

    if (r >= 0)
        r = gsn_ray_camera(camera, p->style, &p->camera, err);
    if (r < 0)
        return r;
    rays = (size_t)p->camera.width * p->camera.height;
    if (p->light) {
        gsn_ray_colours_init(p->style->map, &p->colours);
        p->blur = gsn_ray_blur(camera, p->style);
        p->rgba = gsn_alloc_array(rays, sizeof *p->rgba);
    } else {
        p->value = gsn_alloc_array(rays, sizeof *p->value);
    }
    if (!p->rgba && !p->value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu rays", rays);
    r = project_cells(p, threads, err);
    tiles = p->bins.across * p->bins.down;
    for (size_t batch = 0; r >= 0 && batch < BATCHES; batch++) {
        p->first_tile = tiles * batch / BATCHES;
        gsn_progress_say(progress, "cells", p->first_tile, tiles);
        r = gsn_parallel_for(tiles * (batch + 1) / BATCHES - p->first_tile, threads, draw_tile, p,
                             err);
    }
    if (r >= 0)
        gsn_progress_say(progress, "cells", tiles, tiles);
    return r;
}

int gsn_projected_xray(const struct gsn_spline *spline, const struct gsn_camera *camera,
                       const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                       unsigned threads, const struct gsn_progress *progress,
                       struct gsn_plane **ret_plane, struct gsn_error *err)
{
    auto_projection p = { 0, spline, clip, style, .value = NULL };
    const int r = project_tets(&p, camera, threads, progress, err);

    return r < 0 ? r
                 : gsn_ray_mean_values(p.value, style->across, camera->width, camera->height,
                                       ret_plane, err);
}

int gsn_projected_volume(const struct gsn_spline *spline, const struct gsn_camera *camera,
                         const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                         unsigned threads, const struct gsn_progress *progress,
                         struct gsn_ray_picture **ret_picture, struct gsn_error *err)
{
    auto_projection p = { 1, spline, clip, style, .value = NULL };
    const int r = project_tets(&p, camera, threads, progress, err);

    return r < 0 ? r
                 : gsn_ray_mean_light((const float(*)[4])p.rgba, style->across, camera->width,
                                      camera->height, ret_picture, err);
}
