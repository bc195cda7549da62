/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/dms_internal.h"

#include <string.h>

/* A shared control point belongs to a multiset of vertices: vertex i_k taken beta_k times. That is
 * all its polar value depends on. Ascending; unused places are 0. */
struct key {
    uint32_t vertex[GSN_DMS_MAX_DEGREE];
    uint32_t function; /* functions * tetrahedron + function */
};

static int same_vertices(const struct key *a, const struct key *b)
{
    return memcmp(a->vertex, b->vertex, sizeof a->vertex) == 0;
}

static struct key key_of(const struct gsn_dms *space, size_t function)
{
    const uint32_t *v = space->mesh->tet[function / space->sets->functions];
    const uint8_t *beta = space->sets->beta[function % space->sets->functions];
    struct key key = { .function = (uint32_t)function };
    unsigned n = 0;

    for (unsigned k = 0; k < 4; k++) {
        for (unsigned l = 0; l < beta[k]; l++) {
            unsigned at = n++;

            for (; at > 0 && key.vertex[at - 1] > v[k]; at--)
                key.vertex[at] = key.vertex[at - 1];
            key.vertex[at] = v[k];
        }
    }
    return key;
}

/* Sorts by one place, leaving the order as it is among equals; start has a place for every vertex
 * and one more. */
static void sort_by(const struct key *from, struct key *to, size_t count, int place, size_t *start,
                    size_t vertices)
{
    size_t sum = 0;

    memset(start, 0, (vertices + 1) * sizeof *start);
    for (size_t i = 0; i < count; i++)
        start[from[i].vertex[place] + 1]++;
    for (size_t v = 0; v <= vertices; v++)
        start[v] = sum += start[v];
    for (size_t i = 0; i < count; i++)
        to[start[from[i].vertex[place]]++] = from[i];
}

/* Gives equal keys one number, in the order of the keys. */
static int number_shared(struct gsn_dms *space, size_t count, struct gsn_error *err)
{
    const size_t vertices = space->mesh->vertex_count;
    gsn_auto_mem(struct key) first = gsn_alloc_array(count, sizeof *first);
    gsn_auto_mem(struct key) second = gsn_alloc_array(count, sizeof *second);
    gsn_auto_mem(size_t) start = gsn_alloc_array(vertices + 1, sizeof *start);
    struct key *key = first, *other = second;

    if (!first || !second || !start)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu functions", count);
    for (size_t i = 0; i < count; i++)
        key[i] = key_of(space, i);
    for (int place = (int)space->degree - 1; place >= 0; place--) {
        struct key *const sorted = other;

        sort_by(key, sorted, count, place, start, vertices);
        other = key;
        key = sorted;
    }
    space->controls = 0;
    for (size_t i = 0; i < count; i++) {
        if (i == 0 || !same_vertices(&key[i - 1], &key[i]))
            space->controls++;
        space->id[key[i].function] = (uint32_t)(space->controls - 1);
    }
    return GSN_OK;
}

int gsn_dms_number(struct gsn_dms *space, struct gsn_error *err)
{
    const size_t count = space->mesh->tet_count * space->sets->functions;

    space->id = gsn_alloc_array(count, sizeof *space->id);
    if (!space->id)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu functions", count);
    if (space->sharing == GSN_DMS_SHARED)
        return number_shared(space, count, err);
    for (size_t i = 0; i < count; i++)
        space->id[i] = (uint32_t)i;
    space->controls = count;
    return GSN_OK;
}
