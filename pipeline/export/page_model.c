/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: the mesh is in Morton order, so neighbours in a column differ little; differences, sorted
 * by bytes, are what deflate packs well (RFC 1950, 1951). Where that is still too much, vertices
 * are clustered on a lattice (J. Rossignac, P. Borrel, "Multi-resolution 3D approximations for
 * rendering complex scenes", 1993): the first vertex of a lattice cell stands for all, tetrahedra
 * that fold or turn over go, and the lattice grows until the rest fits.
 *
 * Steps: (1) cells with tissue; (2) their vertices and edges, numbered as they come; (3) the spline
 * and its colours at both; (4) what is said of each cell, as whole numbers; (5) pack; (6) cluster
 * and again.
 *
 * Failure: memory; a model that is too large at any lattice. Cost: bounds of each cell and one
 * value a node, then a sort of the edges. */
#include "pipeline/export/page_model.h"

#include "pipeline/core/geom.h"
#include "pipeline/core/parallel.h"
#include "pipeline/core/srgb.h"
#include "pipeline/model/batch.h"
#include "pipeline/render/region_border.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <zlib.h>

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "numbers are written as they lie");

enum {
    PLACES = 65535,        /* along an axis */
    HEIGHTS = 4095,        /* between the least and the largest value at a node */
    FIGURES = 20000,       /* that the range of values has at least, in units of the last digit */
    VOLUME_FIGURES = 1000, /* that a middling volume has at least */
    UNKNOWN = INT32_MIN,
    ZLIB_LEVEL = 9
};

static const double GROWTH = 1.2; /* of the lattice, from try to try */

/* What the page is told of each tetrahedron, whatever the level. */
struct fact {
    double density, lower, upper, residual, share, volume;
    double coefficient[GSN_DMS_MAX_FUNCTIONS], low, high; /* p_I, and where s lies about it */
    uint32_t samples;
    int taken;
};

/* One level: its cells, by their numbers in the model, and its nodes. */
struct level {
    size_t vertices, edges, cells;
    uint32_t *cell;        /* number in the model */
    uint32_t (*corner)[4]; /* of 0..vertices-1, in the order of the model's tetrahedron */
    uint32_t *vertex;      /* number in the model of each vertex */
    uint32_t (*edge)[2];   /* its ends */
    uint32_t *home;        /* of each vertex, then each edge: a tetrahedron of the model */
    double *value;         /* of each vertex, then each edge */
    double *inward;        /* likewise, distance from the border of the region */
    double *colour[3];     /* likewise, light; NULL: no colours */
};

struct packing {
    const struct gsn_spline *spline;
    const struct gsn_tets *mesh;
    const struct gsn_model_cells *cells;
    const struct gsn_page_options *options;
    unsigned threads;
    struct gsn_border *border; /* NULL: no region */
    struct fact *fact;
    struct level level;
    uint8_t *plain; /* before it is packed */
    size_t size, room;
};

static void level_done(struct level *level)
{
    gsn_free(level->cell);
    gsn_free(level->corner);
    gsn_free(level->vertex);
    gsn_free(level->edge);
    gsn_free(level->home);
    gsn_free(level->value);
    gsn_free(level->inward);
    for (int c = 0; c < 3; c++)
        gsn_free(level->colour[c]);
    *level = (struct level){ 0 };
}

static void packing_done(struct packing *p)
{
    level_done(&p->level);
    gsn_border_free(p->border);
    gsn_free(p->fact);
    gsn_free(p->plain);
}

/* ---- what is known of each cell ------------------------------------------------------------ */

static int know_cell(size_t tet, void *context, struct gsn_error *err)
{
    struct packing *p = context;
    struct fact *fact = &p->fact[tet];
    const size_t functions = gsn_dms_functions(gsn_spline_space(p->spline));

    (void)err;
    fact->density = p->cells->density ? p->cells->density[tet] : (double)NAN;
    fact->taken = !p->cells->density || isfinite(fact->density);
    if (!fact->taken)
        return GSN_OK;
    fact->residual = p->cells->residual ? p->cells->residual[tet] : (double)NAN;
    fact->share = p->cells->inside_share ? p->cells->inside_share[tet] : (double)NAN;
    fact->samples = p->cells->samples ? p->cells->samples[tet] : 0;
    fact->volume = gsn_tets_volume(p->mesh, tet);
    gsn_spline_bernstein(p->spline, tet, fact->coefficient);
    gsn_spline_residual(p->spline, tet, &fact->low, &fact->high);
    fact->lower = INFINITY;
    fact->upper = -INFINITY;
    for (size_t f = 0; f < functions; f++) {
        fact->lower = fmin(fact->lower, fact->coefficient[f]);
        fact->upper = fmax(fact->upper, fact->coefficient[f]);
    }
    fact->lower += fact->low;
    fact->upper += fact->high;
    return GSN_OK;
}

/* ---- clustering ---------------------------------------------------------------------------- */

struct placed {
    int64_t at[3]; /* cell of the lattice */
    uint32_t vertex;
};

static int by_place(const void *a, const void *b)
{
    const struct placed *p = a, *q = b;

    for (int c = 0; c < 3; c++)
        if (p->at[c] != q->at[c])
            return p->at[c] < q->at[c] ? -1 : 1;
    return p->vertex < q->vertex ? -1 : 1;
}

/* Who stands for each vertex: itself where apart is 0. */
static int find_leaders(const struct gsn_tets *mesh, double apart, uint32_t *ret_leader,
                        struct gsn_error *err)
{
    gsn_auto_mem(struct placed) placed = gsn_alloc_array(mesh->vertex_count, sizeof *placed);
    uint32_t leader = 0;

    if (!placed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", mesh->vertex_count);
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        ret_leader[v] = placed[v].vertex = (uint32_t)v;
        for (int c = 0; apart > 0 && c < 3; c++)
            placed[v].at[c] = (int64_t)floor(mesh->vertex[v][c] / apart);
    }
    if (!(apart > 0))
        return GSN_OK;
    qsort(placed, mesh->vertex_count, sizeof *placed, by_place);
    for (size_t i = 0; i < mesh->vertex_count; i++) {
        if (i == 0 || memcmp(placed[i].at, placed[i - 1].at, sizeof placed[i].at) != 0)
            leader = placed[i].vertex;
        ret_leader[placed[i].vertex] = leader;
    }
    return GSN_OK;
}

static double volume_of(const struct gsn_tets *mesh, const uint32_t corner[4])
{
    double edge[3][3], cross[3];

    for (int k = 0; k < 3; k++)
        for (int c = 0; c < 3; c++)
            edge[k][c] = mesh->vertex[corner[k + 1]][c] - mesh->vertex[corner[0]][c];
    gsn_cross3(edge[0], edge[1], cross);
    return gsn_dot3(cross, edge[2]) / 6;
}

/* Cells that keep a volume, with corners as the model numbers its vertices. */
static int choose_cells(struct packing *p, const uint32_t *leader, struct gsn_error *err)
{
    struct level *level = &p->level;
    const struct gsn_tets *mesh = p->mesh;

    level->cell = gsn_alloc_array(mesh->tet_count, sizeof *level->cell);
    level->corner = gsn_alloc_array(mesh->tet_count, sizeof *level->corner);
    if (!level->cell || !level->corner)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", mesh->tet_count);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        uint32_t *corner = level->corner[level->cells];

        for (int k = 0; k < 4; k++)
            corner[k] = leader[mesh->tet[t][k]];
        if (p->fact[t].taken && volume_of(mesh, corner) > 1e-3 * p->fact[t].volume)
            level->cell[level->cells++] = (uint32_t)t;
    }
    return GSN_OK;
}

/* Numbers vertices in the model's order. */
static int number_vertices(struct packing *p, struct gsn_error *err)
{
    struct level *level = &p->level;
    const struct gsn_tets *mesh = p->mesh;
    gsn_auto_mem(uint32_t) number = gsn_alloc_array(mesh->vertex_count + 1, sizeof *number);
    gsn_auto_mem(uint32_t) home = gsn_alloc_array(mesh->vertex_count + 1, sizeof *home);

    level->vertex = gsn_alloc_array(mesh->vertex_count, sizeof *level->vertex);
    level->home = gsn_alloc_array(mesh->vertex_count + 6 * level->cells + 1, sizeof *level->home);
    if (!number || !home || !level->vertex || !level->home)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", mesh->vertex_count);
    for (size_t t = mesh->tet_count; t-- > 0;)
        for (int k = 0; k < 4; k++)
            home[mesh->tet[t][k]] = (uint32_t)t;
    for (size_t i = 0; i < level->cells; i++)
        for (int k = 0; k < 4; k++)
            number[level->corner[i][k]] = 1;
    for (size_t v = 0; v < mesh->vertex_count; v++)
        if (number[v]) {
            level->vertex[level->vertices] = (uint32_t)v;
            level->home[level->vertices] = home[v];
            number[v] = (uint32_t)level->vertices++;
        }
    for (size_t i = 0; i < level->cells; i++)
        for (int k = 0; k < 4; k++)
            level->corner[i][k] = number[level->corner[i][k]];
    return GSN_OK;
}

static const uint8_t PAIR[6][2] = { { 0, 1 }, { 0, 2 }, { 0, 3 }, { 1, 2 }, { 1, 3 }, { 2, 3 } };

struct sight {
    uint32_t end[2]; /* the lower number first */
    uint32_t first;  /* 6 * cell + pair */
};

static int by_ends(const void *a, const void *b)
{
    const struct sight *p = a, *q = b;

    for (int k = 0; k < 2; k++)
        if (p->end[k] != q->end[k])
            return p->end[k] < q->end[k] ? -1 : 1;
    return p->first < q->first ? -1 : 1;
}

static int by_first(const void *a, const void *b)
{
    const struct sight *p = a, *q = b;

    return p->first < q->first ? -1 : 1;
}

/* Edges in the order in which cells have them first. */
static int number_edges(struct level *level, struct gsn_error *err)
{
    gsn_auto_mem(struct sight) sight = gsn_alloc_array(6 * level->cells + 1, sizeof *sight);
    size_t count = 0;

    level->edge = gsn_alloc_array(6 * level->cells + 1, sizeof *level->edge);
    if (!sight || !level->edge)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the edges of %zu cells", level->cells);
    for (size_t i = 0; i < 6 * level->cells; i++) {
        const uint32_t a = level->corner[i / 6][PAIR[i % 6][0]];
        const uint32_t b = level->corner[i / 6][PAIR[i % 6][1]];

        sight[i] = (struct sight){ { a < b ? a : b, a < b ? b : a }, (uint32_t)i };
    }
    qsort(sight, 6 * level->cells, sizeof *sight, by_ends);
    for (size_t i = 0; i < 6 * level->cells; i++)
        if (count == 0 || memcmp(sight[i].end, sight[count - 1].end, sizeof sight[i].end) != 0)
            sight[count++] = sight[i];
    qsort(sight, count, sizeof *sight, by_first);
    for (size_t i = 0; i < count; i++) {
        memcpy(level->edge[i], sight[i].end, sizeof sight[i].end);
        level->home[level->vertices + i] = level->cell[sight[i].first / 6];
    }
    level->edges = count;
    return GSN_OK;
}

/* ---- the spline at the nodes --------------------------------------------------------------- */

/* Of the way from a node to the middle of a tetrahedron that has it: where s is asked, so that no
 * node on the border of the domain counts as outside. */
static const double INWARD = 1e-7;

static void place_node(const struct packing *p, size_t node, double ret_at[3])
{
    const struct level *level = &p->level;
    const struct gsn_tets *mesh = p->mesh;
    const uint32_t *tet = mesh->tet[level->home[node]];

    for (int c = 0; c < 3; c++) {
        double middle = 0;

        if (node < level->vertices)
            ret_at[c] = mesh->vertex[level->vertex[node]][c];
        else
            ret_at[c] = (mesh->vertex[level->vertex[level->edge[node - level->vertices][0]]][c] +
                         mesh->vertex[level->vertex[level->edge[node - level->vertices][1]]][c]) /
                        2;
        for (int k = 0; k < 4; k++)
            middle += mesh->vertex[tet[k]][c] / 4;
        ret_at[c] += INWARD * (middle - ret_at[c]);
    }
}

/* flat: places of the nodes. */
static int value_field(const struct packing *p, const struct gsn_spline *field, const double *flat,
                       double *ret_value, struct gsn_error *err)
{
    const struct level *level = &p->level;
    const size_t nodes = level->vertices + level->edges;
    const int r = gsn_spline_eval_many(field, (const double(*)[3])flat, nodes, p->threads,
                                       ret_value, NULL, err);

    /* Amid two corners that were drawn together there may be no domain. */
    for (size_t i = level->vertices; r >= 0 && i < nodes; i++)
        if (isnan(ret_value[i]))
            ret_value[i] = (ret_value[level->edge[i - level->vertices][0]] +
                            ret_value[level->edge[i - level->vertices][1]]) /
                           2;
    return r;
}

static int value_nodes(struct packing *p, struct gsn_error *err)
{
    struct level *level = &p->level;
    const size_t nodes = level->vertices + level->edges;
    gsn_auto_mem(double) flat = gsn_alloc_array(nodes + 1, 3 * sizeof *flat);
    int r;

    level->value = gsn_alloc_array(nodes + 1, sizeof *level->value);
    level->inward = gsn_alloc_array(nodes + 1, sizeof *level->inward);
    if (!flat || !level->value || !level->inward)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu nodes", nodes);
    for (size_t i = 0; i < nodes; i++) {
        place_node(p, i, flat + 3 * i);
        level->inward[i] = p->border ? gsn_border_at(p->border, flat + 3 * i, NULL) : 1;
    }
    r = value_field(p, p->spline, flat, level->value, err);
    for (int c = 0; r >= 0 && p->options->colour && c < 3; c++) {
        level->colour[c] = gsn_alloc_array(nodes + 1, sizeof *level->colour[c]);
        r = level->colour[c] ? value_field(p, p->options->colour[c], flat, level->colour[c], err)
                             : gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu nodes", nodes);
    }
    return r;
}

static int make_level(struct packing *p, double apart, struct gsn_error *err)
{
    gsn_auto_mem(uint32_t) leader = gsn_alloc_array(p->mesh->vertex_count, sizeof *leader);
    int r;

    level_done(&p->level);
    if (!leader)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", p->mesh->vertex_count);
    r = find_leaders(p->mesh, apart, leader, err);
    if (r >= 0)
        r = choose_cells(p, leader, err);
    if (r >= 0)
        r = number_vertices(p, err);
    if (r >= 0)
        r = number_edges(&p->level, err);
    return r < 0 ? r : value_nodes(p, err);
}

/* ---- columns ------------------------------------------------------------------------------- */

/* Powers of ten that give the range at least so many units; never below 0. */
static double choose_digits(double range, double units)
{
    return range > 0 && isfinite(range) ? fmin(12, fmax(0, ceil(log10(units / range)))) : 4;
}

static int make_room(struct packing *p, size_t more, struct gsn_error *err)
{
    const size_t room = 2 * (p->size + more);
    uint8_t *grown;

    if (p->size + more <= p->room)
        return GSN_OK;
    grown = gsn_realloc_array(p->plain, room, 1);
    if (!grown)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a page's model");
    p->plain = grown;
    p->room = room;
    return GSN_OK;
}

static uint32_t fold_sign(int64_t difference)
{
    return (uint32_t)(difference >= 0 ? 2 * difference : -2 * difference - 1);
}

/* Differences wrap at 2^32, as the reader's do. */
static int put_column(struct packing *p, const int32_t *item, size_t count, struct gsn_error *err)
{
    uint32_t largest = 0;
    unsigned width = 1;
    int32_t before = 0;
    int r;

    for (size_t i = 0; i < count; i++) {
        const uint32_t folded = fold_sign((int32_t)((uint32_t)item[i] - (uint32_t)before));

        largest = folded > largest ? folded : largest;
        before = item[i];
    }
    while (width < 4 && largest >> 8 * width)
        width++;
    r = make_room(p, 1 + width * count, err);
    if (r < 0)
        return r;
    p->plain[p->size++] = (uint8_t)width;
    before = 0;
    for (size_t i = 0; i < count; i++) {
        const uint32_t folded = fold_sign((int32_t)((uint32_t)item[i] - (uint32_t)before));

        for (unsigned b = 0; b < width; b++)
            p->plain[p->size + b * count + i] = (uint8_t)(folded >> 8 * b);
        before = item[i];
    }
    p->size += width * count;
    return GSN_OK;
}

static int32_t whole_of(double value)
{
    return isfinite(value) ? (int32_t)fmin(INT32_MAX, fmax(INT32_MIN + 1, value)) : UNKNOWN;
}

struct scales {
    double origin[3], step[3], low, height, unit, volume_unit; /* units: of one last digit */
    double digits, volume_digits;
};

static int by_size(const void *a, const void *b)
{
    const double *p = a, *q = b;

    return (*p > *q) - (*p < *q);
}

static int find_scales(const struct packing *p, struct scales *ret, struct gsn_error *err)
{
    const struct level *level = &p->level;
    gsn_auto_mem(double) volume = gsn_alloc_array(level->cells + 1, sizeof *volume);
    double high = -INFINITY;

    if (!volume)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", level->cells);
    *ret = (struct scales){ .low = INFINITY };
    for (int c = 0; c < 3; c++) {
        double least = INFINITY, most = -INFINITY;

        for (size_t v = 0; v < level->vertices; v++) {
            least = fmin(least, p->mesh->vertex[level->vertex[v]][c]);
            most = fmax(most, p->mesh->vertex[level->vertex[v]][c]);
        }
        ret->origin[c] = level->vertices ? least : 0;
        ret->step[c] = level->vertices ? (most - least) / PLACES : 1;
    }
    for (size_t i = 0; i < level->vertices + level->edges; i++) {
        ret->low = fmin(ret->low, level->value[i]);
        high = fmax(high, level->value[i]);
    }
    if (!(ret->low < high)) {
        ret->low = isfinite(ret->low) ? ret->low : 0;
        high = ret->low + 1;
    }
    ret->height = (high - ret->low) / HEIGHTS;
    for (size_t i = 0; i < level->cells; i++)
        volume[i] = p->fact[level->cell[i]].volume;
    qsort(volume, level->cells, sizeof *volume, by_size);
    ret->digits = choose_digits(p->options->high - p->options->low, FIGURES / 2);
    ret->volume_digits = choose_digits(level->cells ? volume[level->cells / 2] : 1, VOLUME_FIGURES);
    ret->unit = pow(10, ret->digits);
    ret->volume_unit = pow(10, ret->volume_digits);
    return GSN_OK;
}

/* How far s may lie below and above what is linear between the corners as they are given. */
static void bound_about(const struct packing *p, const struct scales *scales, size_t cell,
                        const int32_t *given, double *ret_below, double *ret_above)
{
    const struct gsn_dms *space = gsn_spline_space(p->spline);
    const struct fact *fact = &p->fact[p->level.cell[cell]];
    double low = INFINITY, high = -INFINITY;

    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const uint8_t *beta = gsn_dms_beta(space, f);
        double linear = 0;

        for (int k = 0; k < 4; k++)
            linear += beta[k] * (scales->low + scales->height * given[p->level.corner[cell][k]]) /
                      gsn_dms_degree(space);
        low = fmin(low, fact->coefficient[f] - linear);
        high = fmax(high, fact->coefficient[f] - linear);
    }
    *ret_below = -(low + fact->low);
    *ret_above = high + fact->high;
}

enum column {
    NUMBER,
    DENSITY,
    LOWER,
    UPPER,
    RESIDUAL,
    BELOW,
    ABOVE,
    SAMPLES,
    SHARE,
    VOLUME,
    CELL_COLUMNS
};

static void fill_cell(const struct packing *p, const struct scales *s, size_t cell,
                      const int32_t *given, int32_t ret[CELL_COLUMNS])
{
    const struct fact *fact = &p->fact[p->level.cell[cell]];
    double below, above;

    bound_about(p, s, cell, given, &below, &above);
    ret[NUMBER] = (int32_t)p->level.cell[cell];
    ret[DENSITY] = whole_of(rint(s->unit * fact->density));
    ret[LOWER] = whole_of(floor(s->unit * fact->lower));
    ret[UPPER] = whole_of(ceil(s->unit * fact->upper));
    ret[RESIDUAL] = whole_of(rint(s->unit * fact->residual));
    /* A unit more than needed covers the rounding of all that was added. */
    ret[BELOW] = whole_of(ceil(s->unit * below) + 1);
    ret[ABOVE] = whole_of(ceil(s->unit * above) + 1);
    ret[SAMPLES] = p->cells->samples ? whole_of(fact->samples) : UNKNOWN;
    ret[SHARE] = whole_of(rint(1000 * fact->share));
    ret[VOLUME] = whole_of(rint(s->volume_unit * fact->volume));
}

static int put_cells(struct packing *p, const struct scales *s, const int32_t *given,
                     struct gsn_error *err)
{
    const size_t cells = p->level.cells;
    gsn_auto_mem(int32_t) all = gsn_alloc_array(cells + 1, CELL_COLUMNS * sizeof *all);
    int r = GSN_OK;

    if (!all)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", cells);
    for (size_t i = 0; i < cells; i++) {
        int32_t row[CELL_COLUMNS];

        fill_cell(p, s, i, given, row);
        for (size_t c = 0; c < CELL_COLUMNS; c++)
            all[c * cells + i] = row[c];
    }
    for (size_t c = 0; c < CELL_COLUMNS && r >= 0; c++)
        r = put_column(p, all + c * cells, cells, err);
    return r;
}

static int put_head(struct packing *p, const struct scales *s, struct gsn_error *err)
{
    const double head[GSN_PAGE_HEAD] = { (double)p->level.vertices,
                                         (double)p->level.edges,
                                         (double)p->level.cells,
                                         s->origin[0],
                                         s->origin[1],
                                         s->origin[2],
                                         s->step[0],
                                         s->step[1],
                                         s->step[2],
                                         s->low,
                                         s->height,
                                         s->digits,
                                         s->volume_digits,
                                         p->options->low,
                                         p->options->high,
                                         p->options->colour ? 3 : 0 };
    const int r = make_room(p, sizeof head, err);

    if (r < 0)
        return r;
    memcpy(p->plain, head, sizeof head);
    p->size = sizeof head;
    return GSN_OK;
}

/* To a micrometre. */
static int put_inward(struct packing *p, int32_t *item, struct gsn_error *err)
{
    const struct level *level = &p->level;
    int r;

    for (size_t i = 0; i < level->vertices + level->edges; i++)
        item[i] = whole_of(rint(level->inward[i]));
    r = put_column(p, item, level->vertices, err);
    return r < 0 ? r : put_column(p, item + level->vertices, level->edges, err);
}

static int put_colours(struct packing *p, int32_t *item, struct gsn_error *err)
{
    const struct level *level = &p->level;
    int r = GSN_OK;

    for (int c = 0; r >= 0 && level->colour[0] && c < 3; c++) {
        for (size_t i = 0; i < level->vertices + level->edges; i++)
            item[i] =
                whole_of(rint(255 * gsn_srgb_of_light(fmin(1, fmax(0, level->colour[c][i])))));
        r = put_column(p, item, level->vertices, err);
        if (r >= 0)
            r = put_column(p, item + level->vertices, level->edges, err);
    }
    return r;
}

static int write_level(struct packing *p, struct gsn_error *err)
{
    const struct level *level = &p->level;
    const size_t nodes = level->vertices + level->edges;
    const size_t most = nodes > level->cells ? nodes : level->cells;
    gsn_auto_mem(int32_t) item = gsn_alloc_array(most + 1, sizeof *item);
    struct scales scales = { .low = 0 };
    int r;

    p->size = 0;
    if (!item)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu nodes", nodes);
    r = find_scales(p, &scales, err);
    if (r >= 0)
        r = put_head(p, &scales, err);
    for (int c = 0; c < 3 && r >= 0; c++) {
        for (size_t v = 0; v < level->vertices; v++)
            item[v] = whole_of(
                rint((p->mesh->vertex[level->vertex[v]][c] - scales.origin[c]) / scales.step[c]));
        r = put_column(p, item, level->vertices, err);
    }
    for (int k = 0; k < 4 && r >= 0; k++) {
        for (size_t i = 0; i < level->cells; i++)
            item[i] = (int32_t)level->corner[i][k];
        r = put_column(p, item, level->cells, err);
    }
    for (size_t i = 0; i < nodes && r >= 0; i++)
        item[i] = whole_of(rint((level->value[i] - scales.low) / scales.height));
    if (r >= 0)
        r = put_column(p, item, level->vertices, err);
    if (r >= 0)
        r = put_column(p, item + level->vertices, level->edges, err);
    if (r >= 0)
        r = put_cells(p, &scales, item, err);
    if (r >= 0)
        r = put_inward(p, item, err);
    return r < 0 ? r : put_colours(p, item, err);
}

/* ---- together ------------------------------------------------------------------------------ */

static int pack_level(const struct packing *p, struct gsn_page_model *model, struct gsn_error *err)
{
    uLongf size = compressBound((uLong)p->size);

    gsn_free(model->bytes);
    model->bytes = gsn_alloc(size);
    if (!model->bytes ||
        compress2(model->bytes, &size, p->plain, (uLong)p->size, ZLIB_LEVEL) != Z_OK)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a page's model");
    model->size = size;
    model->cells = p->level.cells;
    return GSN_OK;
}

/* Of a regular tetrahedron as large as the cells are on average. */
static double middling_edge(const struct packing *p, size_t cells)
{
    double volume = 0;

    for (size_t t = 0; t < p->mesh->tet_count; t++)
        volume += p->fact[t].taken ? p->fact[t].volume : 0;
    return cbrt(6 * M_SQRT2 * volume / (double)cells);
}

static int fit_levels(struct packing *p, struct gsn_page_model *model, struct gsn_error *err)
{
    for (;;) {
        int r = make_level(p, model->apart_um, err);

        if (r >= 0)
            r = write_level(p, err);
        if (r >= 0)
            r = pack_level(p, model, err);
        if (r < 0 || model->size <= p->options->most_bytes)
            return r;
        if (model->cells == 0)
            return gsn_fail(err, GSN_E_LIMIT, "a model of %zu cells does not fit in %zu bytes",
                            model->of, p->options->most_bytes);
        model->apart_um =
            model->apart_um > 0 ? GROWTH * model->apart_um : 0.5 * middling_edge(p, model->of);
    }
}

int gsn_page_model_new(const struct gsn_spline *spline, const struct gsn_model_cells *cells,
                       const struct gsn_page_options *options, unsigned threads,
                       struct gsn_page_model **ret_model, struct gsn_error *err)
{
    gsn_auto(gsn_page_model) model = gsn_alloc_array(1, sizeof *model);
    struct packing p __attribute__((cleanup(packing_done))) = {
        .spline = spline,
        .mesh = gsn_dms_mesh(gsn_spline_space(spline)),
        .cells = cells,
        .options = options,
        .threads = threads,
    };
    int r;

    assert(options->low < options->high);

    p.fact = gsn_alloc_array(p.mesh->tet_count, sizeof *p.fact);
    if (!model || !p.fact)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", p.mesh->tet_count);
    r = gsn_parallel_for(p.mesh->tet_count, threads, know_cell, &p, err);
    if (r >= 0 && options->region)
        r = gsn_border_new(options->region, threads, &p.border, err);
    for (size_t t = 0; t < p.mesh->tet_count; t++)
        model->of += p.fact[t].taken ? 1 : 0;
    if (r >= 0)
        r = fit_levels(&p, model, err);
    if (r < 0)
        return r;
    *ret_model = gsn_steal(&model);
    return GSN_OK;
}

void gsn_page_model_free(struct gsn_page_model *model)
{
    if (!model)
        return;
    gsn_free(model->bytes);
    gsn_free(model);
}
