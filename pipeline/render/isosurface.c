/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The isosurface of a spline as a closed triangle mesh.
 *
 * What is marched is the height: s - level, or, where that is less, the distance from the region's
 * border at a fixed rate. It is 0 on the surface of the solid {s >= level} in the region.
 *
 * Method: marching tetrahedra on a subdivision of the domain, with crossings on edges found on the
 * spline itself and not by interpolation. Every tetrahedron is cut into 8^level path simplices of
 * the cubes of a lattice (H. Freudenthal 1942; H. W. Kuhn 1960), alike on both sides of a face, so
 * that the surface is closed wherever the level does not leave the domain. Reference: A. Doi, A.
 * Koide, "An efficient method of triangulating equi-valued surfaces by using tetrahedral cells",
 * IEICE Trans. E74, 1991.
 *
 * Steps: (1) one point per place of the finer mesh, shared by a hash table; (2) heights of all
 * points together; (3) edges that pass the level, once each; (4) roots by false position (the
 * Illinois rule), all edges of a round together, and normals from gradients; (5) triangles, outside
 * to outside.
 *
 * Failure: GSN_E_LIMIT above 2^31 parts, GSN_E_NOMEM.
 * Cost: one value a point, some eight an edge that passes the level. */
#include "pipeline/render/isosurface.h"

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/mem.h"
#include "pipeline/model/batch.h"
#include "pipeline/model/spline.h"
#include "pipeline/render/subdivide.h"

#include <assert.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

struct hash_table {
    uint64_t *hash;
    uint32_t *number;  /* UINT32_MAX: free */
    size_t size, used; /* size is a power of two */
};

/* Whether item number has the key. */
typedef int hash_same(uint32_t number, const void *key, const void *context);

/* A spline, the level that counts as zero, the border that closes it, and the finer mesh. borrows. */
struct level_function {
    const struct gsn_spline *spline;
    double level;
    const struct gsn_border *border; /* NULL: none */
    const struct gsn_fine *fine;
};

/* --- a hash table of what was met before --- */

static void hash_done(struct hash_table *slots)
{
    gsn_free(slots->hash);
    gsn_free(slots->number);
    slots->hash = NULL;
    slots->number = NULL;
    slots->size = 0;
}

/* A well mixed hash of two numbers. */
static uint64_t hash_mix(uint64_t a, uint64_t b)
{
    /* The finaliser of splitmix64. */
    uint64_t h = a * 0x9e3779b97f4a7c15U + b;

    h = (h ^ (h >> 30)) * 0xbf58476d1ce4e5b9U;
    h = (h ^ (h >> 27)) * 0x94d049bb133111ebU;
    return h ^ (h >> 31);
}

static int grow_table(struct hash_table *slots, struct gsn_error *err)
{
    const size_t size = slots->size ? 2 * slots->size : 1024;
    uint64_t *hash = gsn_alloc_array(size, sizeof *hash);
    uint32_t *number = gsn_alloc_array(size, sizeof *number);

    if (!hash || !number) {
        gsn_free(hash);
        gsn_free(number);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a table of %zu", size);
    }
    for (size_t i = 0; i < size; i++)
        number[i] = UINT32_MAX;
    for (size_t i = 0; i < slots->size; i++) {
        size_t at = slots->hash[i] & (size - 1);

        if (slots->number[i] == UINT32_MAX)
            continue;
        while (number[at] != UINT32_MAX)
            at = (at + 1) & (size - 1);
        number[at] = slots->number[i];
        hash[at] = slots->hash[i];
    }
    hash_done(slots);
    slots->hash = hash;
    slots->number = number;
    slots->size = size;
    return GSN_OK;
}

/* Finds the item with this key, or gives it the number next. *ret_number == next says it is new.
 * Fails with GSN_E_NOMEM. Start with all zero; done releases. */
static int hash_find(struct hash_table *slots, uint64_t hash, const void *key, hash_same *same,
                     const void *context, uint32_t next, uint32_t *ret_number,
                     struct gsn_error *err)
{
    size_t at;

    if (2 * (slots->used + 1) > slots->size) {
        const int r = grow_table(slots, err);

        if (r < 0)
            return r;
    }
    for (at = hash & (slots->size - 1); slots->number[at] != UINT32_MAX;
         at = (at + 1) & (slots->size - 1)) {
        if (slots->hash[at] == hash && same(slots->number[at], key, context)) {
            *ret_number = slots->number[at];
            return GSN_OK;
        }
    }
    slots->hash[at] = hash;
    slots->number[at] = next;
    slots->used++;
    *ret_number = next;
    return GSN_OK;
}

/* --- tetrahedra cut finer --- */

/* A tetrahedron's lattice of m parts a side is that of the simplex m >= x >= y >= z >= 0: place
 * (x, y, z) has the weights (m - x, x - y, y - z, z) / m at the corners, and the parts are the six
 * path simplices of every unit cube, as far as they lie in it. On a face this always gives the same
 * m^2 triangles, so that neighbours fit whatever the order of their corners. */
struct lattice {
    int m;
    uint8_t weight[GSN_FINE_MOST_PLACES][4];
    uint8_t place[9][9][9];
};

static void make_places(struct lattice *lattice, struct gsn_fine *fine)
{
    const int m = lattice->m;

    fine->places = 0;
    for (int x = 0; x <= m; x++) {
        for (int y = 0; y <= x; y++) {
            for (int z = 0; z <= y; z++) {
                const int weight[4] = { m - x, x - y, y - z, z };

                for (int k = 0; k < 4; k++)
                    lattice->weight[fine->places][k] = (uint8_t)weight[k];
                lattice->place[x][y][z] = (uint8_t)fine->places++;
            }
        }
    }
}

/* Adds the path simplex of the cube at base along these axes, if it lies in the tetrahedron. */
static void add_part(const struct lattice *lattice, const int base[3], const int axis[3], int odd,
                     struct gsn_fine *fine)
{
    int at[3] = { base[0], base[1], base[2] };
    uint8_t part[4];

    for (int step = 0; step < 4; step++) {
        if (at[0] > lattice->m || at[1] > at[0] || at[2] > at[1])
            return;
        part[step] = lattice->place[at[0]][at[1]][at[2]];
        if (step < 3)
            at[axis[step]]++;
    }
    if (odd) {
        const uint8_t swap = part[2];

        part[2] = part[3];
        part[3] = swap;
    }
    memcpy(fine->part[fine->parts++], part, sizeof part);
}

static void make_parts(const struct lattice *lattice, struct gsn_fine *fine)
{
    static const int path[6][3] = { { 0, 1, 2 }, { 1, 2, 0 }, { 2, 0, 1 },
                                    { 0, 2, 1 }, { 2, 1, 0 }, { 1, 0, 2 } };

    fine->parts = 0;
    for (int x = 0; x < lattice->m; x++) {
        for (int y = 0; y <= x; y++) {
            for (int z = 0; z <= y; z++) {
                const int base[3] = { x, y, z };

                for (int k = 0; k < 6; k++)
                    add_part(lattice, base, path[k], k >= 3, fine);
            }
        }
    }
}

/* What names a place of the finer mesh: corners of the coarse one with weights, by rising corner,
 * those with weight 0 left out (UINT32_MAX). */
struct name {
    uint32_t corner[4];
    uint8_t weight[4];
};

static struct name make_name(const uint32_t corner[4], const uint8_t weight[4])
{
    struct name name = { { UINT32_MAX, UINT32_MAX, UINT32_MAX, UINT32_MAX }, { 0, 0, 0, 0 } };
    int count = 0;

    for (int k = 0; k < 4; k++) {
        int at = count;

        if (weight[k] == 0)
            continue;
        for (; at > 0 && name.corner[at - 1] > corner[k]; at--) {
            name.corner[at] = name.corner[at - 1];
            name.weight[at] = name.weight[at - 1];
        }
        name.corner[at] = corner[k];
        name.weight[at] = weight[k];
        count++;
    }
    return name;
}

static uint64_t hash_name(const struct name *name)
{
    uint64_t hash = 0;

    for (int k = 0; k < 4; k++)
        hash = hash_mix(hash, (uint64_t)name->corner[k] << 8 | name->weight[k]);
    return hash;
}

static int same_name(uint32_t number, const void *key, const void *context)
{
    const struct name *names = context, *name = key;

    return memcmp(names[number].corner, name->corner, sizeof name->corner) == 0 &&
           memcmp(names[number].weight, name->weight, sizeof name->weight) == 0;
}

struct naming {
    struct hash_table slots;
    struct name *name;
    size_t room;
};

static int make_room(struct naming *naming, struct gsn_fine *fine, struct gsn_error *err)
{
    const size_t room = naming->room ? 2 * naming->room : 1024;
    struct name *name;
    uint32_t *home;

    if (fine->point_count < naming->room)
        return GSN_OK;
    name = gsn_realloc_array(naming->name, room, sizeof *name);
    if (name)
        naming->name = name;
    home = gsn_realloc_array(fine->home, room, sizeof *home);
    if (home)
        fine->home = home;
    if (!name || !home)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu points", room);
    naming->room = room;
    return GSN_OK;
}

/* Numbers all places, in the order of the tetrahedra. */
static int name_places(const struct gsn_tets *mesh, const struct lattice *lattice,
                       struct gsn_fine *fine, struct naming *naming, struct gsn_error *err)
{
    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (unsigned p = 0; p < fine->places; p++) {
            const struct name name = make_name(mesh->tet[t], lattice->weight[p]);
            const uint32_t next = (uint32_t)fine->point_count;
            uint32_t number = 0;
            int r = make_room(naming, fine, err);

            if (r == GSN_OK)
                r = hash_find(&naming->slots, hash_name(&name), &name, same_name, naming->name,
                              next, &number, err);
            if (r < 0)
                return r;
            fine->place[t * fine->places + p] = number;
            if (number == next) {
                naming->name[number] = name;
                fine->home[number] = (uint32_t)t;
                fine->point_count++;
            }
        }
    }
    return GSN_OK;
}

/* Points from their names alone: the same sum in the same order for every tetrahedron that has it.
 */
static int make_points(const struct gsn_tets *mesh, const struct name *name, int m,
                       struct gsn_fine *fine, struct gsn_error *err)
{
    fine->point = gsn_alloc_array(fine->point_count, sizeof *fine->point);
    fine->outer = gsn_alloc_array(fine->point_count, sizeof *fine->outer);
    if (!fine->point || !fine->outer)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu points", fine->point_count);
    for (size_t i = 0; i < fine->point_count; i++) {
        for (int k = 0; k < 4 && name[i].weight[k] > 0; k++) {
            for (int a = 0; a < 3; a++)
                fine->point[i][a] +=
                    (double)name[i].weight[k] / m * mesh->vertex[name[i].corner[k]][a];
        }
    }
    return GSN_OK;
}

/* Places on faces that no other tetrahedron has. */
static void mark_outer(const struct gsn_tets *mesh, const struct lattice *lattice,
                       struct gsn_fine *fine)
{
    for (size_t t = 0; t < mesh->tet_count; t++)
        for (int k = 0; k < 4; k++)
            for (unsigned p = 0; mesh->neighbour[t][k] < 0 && p < fine->places; p++)
                if (lattice->weight[p][k] == 0)
                    fine->outer[fine->place[t * fine->places + p]] = 1;
}

static int fill_lattice(const struct gsn_tets *mesh, const struct lattice *lattice,
                        struct gsn_fine *fine, struct gsn_error *err)
{
    struct naming naming = { 0 };
    int r;

    fine->place = gsn_alloc_array(mesh->tet_count, fine->places * sizeof *fine->place);
    if (!fine->place)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", mesh->tet_count);
    r = name_places(mesh, lattice, fine, &naming, err);
    if (r == GSN_OK)
        r = make_points(mesh, naming.name, lattice->m, fine, err);
    if (r == GSN_OK)
        mark_outer(mesh, lattice, fine);
    hash_done(&naming.slots);
    gsn_free(naming.name);
    return r;
}

int gsn_fine_new(const struct gsn_tets *mesh, unsigned level, struct gsn_fine **ret_fine,
                 struct gsn_error *err)
{
    gsn_auto(gsn_fine) fine = NULL;
    struct lattice lattice = { .m = 1 << level };
    int r;

    assert(level <= GSN_FINE_MOST_LEVEL);
    if (mesh->tet_count > ((size_t)1 << 31) >> (3 * level))
        return gsn_fail(err, GSN_E_LIMIT, "%zu tetrahedra cannot each be cut into %u",
                        mesh->tet_count, 1U << (3 * level));
    fine = gsn_alloc_array(1, sizeof *fine);
    if (!fine)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a finer mesh");
    fine->tet_count = mesh->tet_count;
    make_places(&lattice, fine);
    make_parts(&lattice, fine);
    r = fill_lattice(mesh, &lattice, fine, err);
    if (r < 0)
        return r;
    *ret_fine = gsn_steal(&fine);
    return GSN_OK;
}

void gsn_fine_free(struct gsn_fine *fine)
{
    if (!fine)
        return;
    gsn_free(fine->point);
    gsn_free(fine->outer);
    gsn_free(fine->home);
    gsn_free(fine->place);
    gsn_free(fine);
}

/* --- where edges pass the level --- */

enum {
    CHUNK = 1 << 16, /* points evaluated together */
    MOST_STEPS = 24
};

/* s - level at a point that counts as outside though it is not: taken a little towards the middle
 * of a tetrahedron that the point belongs to. */
static double height_beside(const struct level_function *level, const double u[3], uint32_t home,
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

/* Height per um beyond the border. Where s is 0..1, as a density is, any such rate finds the roots
 * as well. */
static const double RATE = 0.01;

/* Takes the border for the height at u where it is less; whether it is. */
static int close_height(const struct level_function *level, const double u[3], double *height,
                        double *gradient)
{
    double slope[3], inward;

    if (!level->border)
        return 0;
    inward = RATE * gsn_border_at(level->border, u, gradient ? slope : NULL);
    if (!(inward < *height))
        return 0;
    *height = inward;
    for (int a = 0; gradient && a < 3; a++)
        gradient[a] = RATE * slope[a];
    return 1;
}

/* Heights, their gradients unless that is NULL, and whether they are the border's unless that is
 * NULL, at count points in these tetrahedra. */
static int heights_at(const struct level_function *level, const double (*at)[3],
                      const uint32_t *home, size_t count, unsigned threads, double *ret_height,
                      double (*ret_gradient)[3], uint8_t *ret_closing, struct gsn_error *err)
{
    const int r =
        gsn_spline_eval_many(level->spline, at, count, threads, ret_height, ret_gradient, err);

    for (size_t i = 0; r >= 0 && i < count; i++) {
        if (isnan(ret_height[i]))
            ret_height[i] =
                height_beside(level, at[i], home[i], ret_gradient ? ret_gradient[i] : NULL);
        else
            ret_height[i] -= level->level;
        const int closing =
            close_height(level, at[i], &ret_height[i], ret_gradient ? ret_gradient[i] : NULL);

        if (ret_closing)
            ret_closing[i] = (uint8_t)closing;
    }
    return r;
}

/* Heights of the fine mesh's points. The half-open rule puts the points of some boundary faces
 * outside; there it is the limit from inside. threads 0: all; the same bytes on any number. Fails
 * with GSN_E_NOMEM. */
static int level_heights(const struct level_function *level, unsigned threads, double *ret_height,
                         struct gsn_error *err)
{
    const struct gsn_fine *fine = level->fine;
    int r = GSN_OK;

    for (size_t i = 0; i < fine->point_count && r >= 0; i += CHUNK) {
        const size_t left = fine->point_count - i;

        r = heights_at(level, (const double(*)[3])fine->point + i, fine->home + i,
                       left < CHUNK ? left : CHUNK, threads, ret_height + i, NULL, NULL, err);
    }
    /* Where the domain ends inside the border, by less than a voxel, it closes the region too. */
    for (size_t i = 0; level->border && i < fine->point_count; i++)
        if (fine->outer[i])
            ret_height[i] = fmin(ret_height[i], -1e-9);
    return r;
}

/* Of an edge, that a vertex on the region's border stays away from its ends: more than single
 * precision tells apart. */
static const double NEAREST = 1e-3;

/* What is known of one crossing: it lies at t0..t1 of the edge, where the heights are f0 >= 0 and
 * f1 < 0 or, where an end has stayed, a part of these. */
struct crossing {
    double t0, t1, f0, f1, t, enough;
    int stayed; /* which end: -1 the far one, 1 the near one */
};

/* Room for a chunk of edges: the crossings, and the points at which s is asked next. */
struct search {
    const struct level_function *level;
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

static int search_init(struct search *search, const struct level_function *level, size_t room,
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
static int narrow_crossing(struct crossing *crossing, double f)
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
                   threads, search->height, NULL, NULL, err);
    for (size_t i = 0; i < search->open && r >= 0; i++) {
        if (!narrow_crossing(&search->crossing[search->which[i]], search->height[i]))
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

/* Whether the vertex closes the region. Then it is kept off the ends of its edge: where a point of
 * the mesh lies on the border, as they do in planes of voxels, several vertices would be in one
 * place and triangles without area between them. */
static int level_closes(struct search *search, size_t i, uint8_t *closing)
{
    const struct level_function *level = search->level;
    struct crossing *crossing = &search->crossing[i];

    closing[i] |= level->border && level->fine->outer[search->edge[i][1]];
    if (!closing[i])
        return 0;
    crossing->t = fmin(1 - NEAREST, fmax(NEAREST, crossing->t));
    return 1;
}

static int cross_chunk(struct search *search, const double *height, size_t count, unsigned threads,
                       double (*ret_at)[3], float (*ret_normal)[3], uint8_t *ret_closing,
                       struct gsn_error *err)
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
                       search->height, search->gradient, ret_closing, err);
    for (size_t i = 0; i < count && r >= 0; i++) {
        set_normal(search, i, ret_normal[i]);
        if (level_closes(search, i, ret_closing))
            point_of(search, i, ret_at[i]);
    }
    return r;
}

/* Where s is at the level on edges that go from a point whose height is >= 0 to one where it is <
 * 0, to 1e-12 of the edge or of the heights' difference; and the normals of length 1 there, against
 * the gradient, along the edge where there is none. threads and failures as above. */
static int find_crossings(const struct level_function *level, const double *height,
                          const uint32_t (*edge)[2], size_t count, unsigned threads,
                          double (*ret_at)[3], float (*ret_normal)[3], uint8_t *ret_closing,
                          struct gsn_error *err)
{
    struct search search;
    int r = search_init(&search, level, count < CHUNK ? count : CHUNK, err);

    for (size_t i = 0; i < count && r >= 0; i += CHUNK) {
        search.edge = edge + i;
        r = cross_chunk(&search, height, count - i < CHUNK ? count - i : CHUNK, threads, ret_at + i,
                        ret_normal + i, ret_closing + i, err);
    }
    search_done(&search);
    return r;
}

/* --- the surface --- */

void gsn_trimesh_free(struct gsn_trimesh *surface)
{
    if (!surface)
        return;
    gsn_free(surface->vertex);
    gsn_free(surface->normal);
    gsn_free(surface->triangle);
    gsn_free(surface->closing);
    gsn_free(surface);
}

unsigned gsn_isosurface_subdivision(const struct gsn_tets *mesh, double edge_um)
{
    double volume = 0.0, edge;
    unsigned level = 0;

    for (size_t t = 0; t < mesh->tet_count; t++)
        volume += gsn_tets_volume(mesh, t);
    /* A regular tetrahedron of edge a has the volume a^3 / (6 sqrt 2). */
    edge = cbrt(6.0 * sqrt(2.0) * volume / (double)mesh->tet_count);
    while (level < 2 && edge > edge_um) {
        edge *= 0.5;
        level++;
    }
    return level;
}

struct marching {
    const struct gsn_fine *fine;
    double *height;      /* s - level at the fine mesh's points */
    uint32_t (*edge)[2]; /* of each vertex of the surface: points with height >= 0 and < 0 */
    size_t edge_room;
    size_t triangle_room;
    struct hash_table slots;
    struct gsn_trimesh *surface;
};

static int same_edge(uint32_t number, const void *key, const void *context)
{
    const uint32_t(*edges)[2] = context, *edge = key;

    return edges[number][0] == edge[0] && edges[number][1] == edge[1];
}

/* The surface's vertex on the edge from a point inside to one outside. */
static int find_vertex(struct marching *marching, uint32_t inside, uint32_t outside,
                       uint32_t *ret_vertex, struct gsn_error *err)
{
    const uint32_t edge[2] = { inside, outside };
    const uint32_t next = (uint32_t)marching->surface->vertex_count;
    int r;

    if (next == marching->edge_room) {
        const size_t room = next ? 2 * (size_t)next : 1024;
        uint32_t(*grown)[2] = gsn_realloc_array(marching->edge, room, sizeof *grown);

        if (!grown)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", room);
        marching->edge = grown;
        marching->edge_room = room;
    }
    r = hash_find(&marching->slots, hash_mix(inside, outside), edge, same_edge, marching->edge,
                  next, ret_vertex, err);
    if (r == GSN_OK && *ret_vertex == next) {
        memcpy(marching->edge[next], edge, sizeof edge);
        marching->surface->vertex_count++;
    }
    return r;
}

static int add_triangle(struct marching *marching, uint32_t a, uint32_t b, uint32_t c,
                        struct gsn_error *err)
{
    struct gsn_trimesh *surface = marching->surface;

    if (surface->triangle_count == marching->triangle_room) {
        const size_t room = marching->triangle_room ? 2 * marching->triangle_room : 1024;
        uint32_t(*grown)[3] = gsn_realloc_array(surface->triangle, room, sizeof *grown);

        if (!grown)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu triangles", room);
        surface->triangle = grown;
        marching->triangle_room = room;
    }
    surface->triangle[surface->triangle_count][0] = a;
    surface->triangle[surface->triangle_count][1] = b;
    surface->triangle[surface->triangle_count][2] = c;
    surface->triangle_count++;
    return GSN_OK;
}

/* Even permutations of the corners that put the corners of a set first, by the set's bits. For
 * three inside, the one outside comes first. */
static const uint8_t order_of[16][4] = {
    [1] = { 0, 1, 2, 3 },  [2] = { 1, 0, 3, 2 },  [4] = { 2, 0, 1, 3 },  [8] = { 3, 0, 2, 1 },
    [3] = { 0, 1, 2, 3 },  [5] = { 0, 2, 3, 1 },  [9] = { 0, 3, 1, 2 },  [6] = { 1, 2, 0, 3 },
    [10] = { 1, 3, 2, 0 }, [12] = { 2, 3, 0, 1 }, [14] = { 0, 1, 2, 3 }, [13] = { 1, 0, 3, 2 },
    [11] = { 2, 0, 1, 3 }, [7] = { 3, 0, 2, 1 },
};

/* Triangles of one small, positively oriented tetrahedron; seen from the inner corners they turn so
 * that the normal by the right hand points away. */
static int march_part(struct marching *marching, const uint32_t point[4], struct gsn_error *err)
{
    unsigned set = 0, count = 0;
    uint32_t c[4], v[4];
    int r = GSN_OK;

    for (unsigned k = 0; k < 4; k++) {
        if (marching->height[point[k]] >= 0.0) {
            set |= 1U << k;
            count++;
        }
    }
    if (count == 0 || count == 4)
        return GSN_OK;
    for (int k = 0; k < 4; k++)
        c[k] = point[order_of[set][k]];
    if (count == 2) {
        static const uint8_t quad[4][2] = { { 0, 2 }, { 0, 3 }, { 1, 3 }, { 1, 2 } };

        for (int k = 0; k < 4 && r == GSN_OK; k++)
            r = find_vertex(marching, c[quad[k][0]], c[quad[k][1]], &v[k], err);
        if (r == GSN_OK)
            r = add_triangle(marching, v[0], v[1], v[2], err);
        if (r == GSN_OK)
            r = add_triangle(marching, v[0], v[2], v[3], err);
        return r;
    }
    for (int k = 0; k < 3 && r == GSN_OK; k++)
        r = count == 1 ? find_vertex(marching, c[0], c[k + 1], &v[k], err)
                       : find_vertex(marching, c[k + 1], c[0], &v[k], err);
    if (r < 0)
        return r;
    return count == 1 ? add_triangle(marching, v[0], v[1], v[2], err)
                      : add_triangle(marching, v[0], v[2], v[1], err);
}

static int march_cells(struct marching *marching, struct gsn_error *err)
{
    const struct gsn_fine *fine = marching->fine;

    for (size_t t = 0; t < fine->tet_count; t++) {
        const uint32_t *place = fine->place + t * fine->places;

        for (unsigned p = 0; p < fine->parts; p++) {
            const uint32_t point[4] = { place[fine->part[p][0]], place[fine->part[p][1]],
                                        place[fine->part[p][2]], place[fine->part[p][3]] };
            const int r = march_part(marching, point, err);

            if (r < 0)
                return r;
        }
    }
    return GSN_OK;
}

static int build_surface(struct marching *marching, const struct level_function *level,
                         unsigned threads, struct gsn_error *err)
{
    const size_t points = marching->fine->point_count;
    gsn_auto_mem(double) height = gsn_alloc_array(points, sizeof *height);
    struct gsn_trimesh *surface = marching->surface;
    int r;

    if (!height)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu points", points);
    marching->height = height;
    r = level_heights(level, threads, height, err);
    if (r == GSN_OK)
        r = march_cells(marching, err);
    if (r < 0)
        return r;
    surface->vertex = gsn_alloc_array(surface->vertex_count, sizeof *surface->vertex);
    surface->normal = gsn_alloc_array(surface->vertex_count, sizeof *surface->normal);
    surface->closing = gsn_alloc_array(surface->vertex_count, sizeof *surface->closing);
    if (!surface->vertex || !surface->normal || !surface->closing)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", surface->vertex_count);
    return find_crossings(level, height, (const uint32_t(*)[2])marching->edge,
                          surface->vertex_count, threads, surface->vertex, surface->normal,
                          surface->closing, err);
}

int gsn_isosurface(const struct gsn_spline *spline, double level, const struct gsn_border *border,
                   unsigned subdivision, unsigned threads, struct gsn_trimesh **ret_surface,
                   struct gsn_error *err)
{
    gsn_auto(gsn_fine) fine = NULL;
    gsn_auto(gsn_trimesh) surface = NULL;
    struct marching marching = { .edge = NULL };
    int r;

    if (!isfinite(level))
        return gsn_fail(err, GSN_E_INPUT, "the level of the surface is not a number");
    if (subdivision > GSN_ISOSURFACE_MOST_SUBDIVISION)
        return gsn_fail(err, GSN_E_INPUT, "subdivision %u is above %d", subdivision,
                        GSN_ISOSURFACE_MOST_SUBDIVISION);
    r = gsn_fine_new(gsn_dms_mesh(gsn_spline_space(spline)), subdivision, &fine, err);
    if (r < 0)
        return r;
    surface = gsn_alloc_array(1, sizeof *surface);
    if (!surface)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a surface");
    marching.fine = fine;
    marching.surface = surface;
    r = build_surface(&marching, &(struct level_function){ spline, level, border, fine }, threads, err);
    hash_done(&marching.slots);
    gsn_free(marching.edge);
    if (r < 0)
        return r;
    *ret_surface = gsn_steal(&surface);
    return GSN_OK;
}

/* Twice the area vector of a triangle, and its first corner. */
static const double *area_vector(const struct gsn_trimesh *surface, size_t triangle, double ret[3])
{
    const double *a = surface->vertex[surface->triangle[triangle][0]];
    const double *b = surface->vertex[surface->triangle[triangle][1]];
    const double *c = surface->vertex[surface->triangle[triangle][2]];

    for (int k = 0; k < 3; k++) {
        const int m = (k + 1) % 3, n = (k + 2) % 3;

        ret[k] = (b[m] - a[m]) * (c[n] - a[n]) - (b[n] - a[n]) * (c[m] - a[m]);
    }
    return a;
}

double gsn_trimesh_area(const struct gsn_trimesh *surface, double *ret_closing)
{
    double area = 0.0, closing = 0.0;

    for (size_t t = 0; t < surface->triangle_count; t++) {
        const uint32_t *corner = surface->triangle[t];
        double n[3], own;

        (void)area_vector(surface, t, n);
        own = 0.5 * sqrt(gsn_dot3(n, n));
        area += own;
        if (surface->closing[corner[0]] && surface->closing[corner[1]] &&
            surface->closing[corner[2]])
            closing += own;
    }
    if (ret_closing)
        *ret_closing = closing;
    return area;
}
