/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/subdivide.h"

#include <assert.h>
#include <string.h>

#include "pipeline/render/slots.h"

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
        hash = gsn_slots_mix(hash, (uint64_t)name->corner[k] << 8 | name->weight[k]);
    return hash;
}

static int same_name(uint32_t number, const void *key, const void *context)
{
    const struct name *names = context, *name = key;

    return memcmp(names[number].corner, name->corner, sizeof name->corner) == 0 &&
           memcmp(names[number].weight, name->weight, sizeof name->weight) == 0;
}

struct naming {
    struct gsn_slots slots;
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
            uint32_t number;
            int r = make_room(naming, fine, err);

            if (r == GSN_OK)
                r = gsn_slots_find(&naming->slots, hash_name(&name), &name, same_name, naming->name,
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
    if (!fine->point)
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

static int fill(const struct gsn_tets *mesh, const struct lattice *lattice, struct gsn_fine *fine,
                struct gsn_error *err)
{
    struct naming naming = { 0 };
    int r;

    fine->place = gsn_alloc_array(mesh->tet_count, fine->places * sizeof *fine->place);
    if (!fine->place)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", mesh->tet_count);
    r = name_places(mesh, lattice, fine, &naming, err);
    if (r == GSN_OK)
        r = make_points(mesh, naming.name, lattice->m, fine, err);
    gsn_slots_done(&naming.slots);
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
    r = fill(mesh, &lattice, fine, err);
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
    gsn_free(fine->home);
    gsn_free(fine->place);
    gsn_free(fine);
}
