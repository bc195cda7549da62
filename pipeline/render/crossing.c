/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/crossing.h"

#include <math.h>

#include "pipeline/model/batch.h"

enum {
    CHUNK = 1 << 16, /* points evaluated together */
    MOST_STEPS = 24
};

/* s - level at a point that counts as outside though it is not: taken a little towards the middle
 * of a tetrahedron that the point belongs to. */
static double height_beside(const struct gsn_level *level, const double u[3], uint32_t home,
                            double *ret_gradient)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(gsn_spline_space(level->spline));
    double at[3], value = 0.0;
    size_t hint = home;

    for (double step = 1e-9; step <= 1.0; step *= 1000.0) {
        for (int a = 0; a < 3; a++) {
            double middle = 0.0;

            for (int k = 0; k < 4; k++)
                middle += 0.25 * mesh->vertex[mesh->tet[home][k]][a];
            at[a] = u[a] + step * (middle - u[a]);
        }
        if (gsn_spline_eval(level->spline, at, &hint, &value, ret_gradient) == GSN_OK)
            break;
    }
    return value - level->level;
}

/* s - level, and its gradient unless that is NULL, at count points in these tetrahedra. */
static int heights_at(const struct gsn_level *level, const double (*at)[3], const uint32_t *home,
                      size_t count, unsigned threads, double *ret_height, double (*ret_gradient)[3],
                      struct gsn_error *err)
{
    const int r =
        gsn_spline_eval_many(level->spline, at, count, threads, ret_height, ret_gradient, err);

    for (size_t i = 0; r >= 0 && i < count; i++) {
        if (isnan(ret_height[i]))
            ret_height[i] =
                height_beside(level, at[i], home[i], ret_gradient ? ret_gradient[i] : NULL);
        else
            ret_height[i] -= level->level;
    }
    return r;
}

int gsn_level_heights(const struct gsn_level *level, unsigned threads, double *ret_height,
                      struct gsn_error *err)
{
    const struct gsn_fine *fine = level->fine;
    int r = GSN_OK;

    for (size_t i = 0; i < fine->point_count && r >= 0; i += CHUNK) {
        const size_t left = fine->point_count - i;

        r = heights_at(level, (const double(*)[3])fine->point + i, fine->home + i,
                       left < CHUNK ? left : CHUNK, threads, ret_height + i, NULL, err);
    }
    return r;
}

/* What is known of one crossing: it lies at t0..t1 of the edge, where the heights are f0 >= 0 and
 * f1 < 0 or, where an end has stayed, a part of these. */
struct crossing {
    double t0, t1, f0, f1, t, enough;
    int stayed; /* which end: -1 the far one, 1 the near one */
};

/* Room for a chunk of edges: the crossings, and the points at which s is asked next. */
struct search {
    const struct gsn_level *level;
    const uint32_t (*edge)[2]; /* of the chunk */
    size_t open;               /* crossings that are still searched */
    struct crossing *crossing;
    uint32_t *which, *home; /* of the open ones: the crossing; a tetrahedron that holds it */
    double (*at)[3], (*gradient)[3], *height;
};

static void search_done(struct search *search)
{
    gsn_free(search->crossing);
    gsn_free(search->which);
    gsn_free(search->home);
    gsn_free(search->at);
    gsn_free(search->gradient);
    gsn_free(search->height);
}

static int search_init(struct search *search, const struct gsn_level *level, size_t room,
                       struct gsn_error *err)
{
    *search = (struct search){ .level = level,
                               .crossing = gsn_alloc_array(room, sizeof *search->crossing),
                               .which = gsn_alloc_array(room, sizeof *search->which),
                               .home = gsn_alloc_array(room, sizeof *search->home),
                               .at = gsn_alloc_array(room, sizeof *search->at),
                               .gradient = gsn_alloc_array(room, sizeof *search->gradient),
                               .height = gsn_alloc_array(room, sizeof *search->height) };
    if (!search->crossing || !search->which || !search->home || !search->at || !search->gradient ||
        !search->height)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", room);
    return GSN_OK;
}

static void point_of(const struct search *search, size_t i, double ret_at[3])
{
    const struct gsn_fine *fine = search->level->fine;
    const double *p = fine->point[search->edge[i][0]], *q = fine->point[search->edge[i][1]];

    for (int a = 0; a < 3; a++)
        ret_at[a] = p[a] + search->crossing[i].t * (q[a] - p[a]);
}

/* False position that halves the weight of an end that stays (Illinois), so that both ends close
 * in. Returns whether this was near enough. */
static int narrow(struct crossing *crossing, double f)
{
    if (fabs(f) <= crossing->enough || crossing->t1 - crossing->t0 < 1e-12)
        return 1;
    if (f >= 0.0) {
        crossing->t0 = crossing->t;
        crossing->f0 = f;
        crossing->f1 *= crossing->stayed < 0 ? 0.5 : 1.0;
        crossing->stayed = -1;
    } else {
        crossing->t1 = crossing->t;
        crossing->f1 = f;
        crossing->f0 *= crossing->stayed > 0 ? 0.5 : 1.0;
        crossing->stayed = 1;
    }
    return 0;
}

/* Asks for s at all open crossings and keeps those open that are not found. */
static int search_step(struct search *search, unsigned threads, struct gsn_error *err)
{
    size_t open = 0;
    int r;

    for (size_t i = 0; i < search->open; i++) {
        const uint32_t v = search->which[i];
        struct crossing *c = &search->crossing[v];

        c->t = c->t0 + (c->t1 - c->t0) * (c->f0 / (c->f0 - c->f1));
        point_of(search, v, search->at[i]);
        search->home[i] = search->level->fine->home[search->edge[v][0]];
    }
    r = heights_at(search->level, (const double(*)[3])search->at, search->home, search->open,
                   threads, search->height, NULL, err);
    for (size_t i = 0; i < search->open && r >= 0; i++) {
        if (!narrow(&search->crossing[search->which[i]], search->height[i]))
            search->which[open++] = search->which[i];
    }
    search->open = open;
    return r;
}

/* Out of the denser side: against the gradient, or along the edge where there is none. */
static void set_normal(const struct search *search, size_t i, float ret_normal[3])
{
    const struct gsn_fine *fine = search->level->fine;
    const uint32_t *edge = search->edge[i];
    double n[3], length = 0.0;

    for (int a = 0; a < 3; a++) {
        n[a] = -search->gradient[i][a];
        length += n[a] * n[a];
    }
    if (!(length > 0.0)) {
        length = 0.0;
        for (int a = 0; a < 3; a++) {
            n[a] = fine->point[edge[1]][a] - fine->point[edge[0]][a];
            length += n[a] * n[a];
        }
    }
    for (int a = 0; a < 3; a++)
        ret_normal[a] = (float)(n[a] / sqrt(length));
}

static int cross_chunk(struct search *search, const double *height, size_t count, unsigned threads,
                       double (*ret_at)[3], float (*ret_normal)[3], struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; i < count; i++) {
        const double f0 = height[search->edge[i][0]], f1 = height[search->edge[i][1]];

        search->crossing[i] =
            (struct crossing){ .t1 = 1.0, .f0 = f0, .f1 = f1, .enough = 1e-12 * (f0 - f1) };
        search->which[i] = (uint32_t)i;
    }
    search->open = count;
    for (int step = 0; step < MOST_STEPS && search->open > 0 && r >= 0; step++)
        r = search_step(search, threads, err);
    for (size_t i = 0; i < count && r >= 0; i++) {
        point_of(search, i, ret_at[i]);
        search->home[i] = search->level->fine->home[search->edge[i][0]];
    }
    if (r >= 0)
        r = heights_at(search->level, (const double(*)[3])ret_at, search->home, count, threads,
                       search->height, search->gradient, err);
    for (size_t i = 0; i < count && r >= 0; i++)
        set_normal(search, i, ret_normal[i]);
    return r;
}

int gsn_level_crossings(const struct gsn_level *level, const double *height,
                        const uint32_t (*edge)[2], size_t count, unsigned threads,
                        double (*ret_at)[3], float (*ret_normal)[3], struct gsn_error *err)
{
    struct search search;
    int r = search_init(&search, level, count < CHUNK ? count : CHUNK, err);

    for (size_t i = 0; i < count && r >= 0; i += CHUNK) {
        search.edge = edge + i;
        r = cross_chunk(&search, height, count - i < CHUNK ? count - i : CHUNK, threads, ret_at + i,
                        ret_normal + i, err);
    }
    search_done(&search);
    return r;
}
