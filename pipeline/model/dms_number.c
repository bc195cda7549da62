/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/dms_internal.h"

#include <stdlib.h>

/* A shared control point belongs to a multiset of vertices: vertex i_k taken beta_k times. That is
 * all its polar value depends on. Ascending; unused places are 0. */
struct key {
    uint32_t vertex[GSN_DMS_MAX_DEGREE];
    uint32_t function; /* functions * tetrahedron + function */
};

static int compare_vertices(const struct key *a, const struct key *b)
{
    for (int i = 0; i < GSN_DMS_MAX_DEGREE; i++) {
        if (a->vertex[i] != b->vertex[i])
            return a->vertex[i] < b->vertex[i] ? -1 : 1;
    }
    return 0;
}

static int by_vertices(const void *left, const void *right)
{
    const struct key *a = left, *b = right;
    const int order = compare_vertices(a, b);

    return order ? order : (a->function > b->function) - (a->function < b->function);
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

/* Gives equal keys one number, in the order of the keys. */
static int number_shared(struct gsn_dms *space, size_t count, struct gsn_error *err)
{
    gsn_auto_mem(struct key) key = gsn_alloc_array(count, sizeof *key);

    if (!key)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu functions", count);
    for (size_t i = 0; i < count; i++)
        key[i] = key_of(space, i);
    qsort(key, count, sizeof *key, by_vertices);
    space->controls = 0;
    for (size_t i = 0; i < count; i++) {
        if (i == 0 || compare_vertices(&key[i - 1], &key[i]) != 0)
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
