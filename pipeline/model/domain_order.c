/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/domain_order.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { BITS = 21 };

struct box {
    double low[3], extent;
};

struct place {
    uint64_t code;
    uint32_t index;
};

static struct box bounding_box(const struct gsn_soup *soup)
{
    struct box box = { { INFINITY, INFINITY, INFINITY }, 0 };
    double high[3] = { -INFINITY, -INFINITY, -INFINITY };

    for (size_t v = 0; v < soup->vertex_count; v++)
        for (size_t k = 0; k < 3; k++) {
            box.low[k] = fmin(box.low[k], soup->vertex[v][k]);
            high[k] = fmax(high[k], soup->vertex[v][k]);
        }
    for (size_t k = 0; k < 3; k++)
        box.extent = fmax(box.extent, high[k] - box.low[k]);
    return box;
}

static uint64_t morton(const struct box *box, const double p[3])
{
    uint64_t code = 0;

    for (size_t k = 0; k < 3; k++) {
        const double scaled = (p[k] - box->low[k]) / box->extent * (1 << BITS);
        const uint64_t cell = scaled <= 0                 ? 0
                              : scaled >= (1 << BITS) - 1 ? (1 << BITS) - 1
                                                          : (uint64_t)scaled;

        for (unsigned bit = 0; bit < BITS; bit++)
            code |= (cell >> bit & 1) << (3 * bit + k);
    }
    return code;
}

static int compare_places(const void *a, const void *b)
{
    const struct place *left = a, *right = b;

    if (left->code != right->code)
        return left->code < right->code ? -1 : 1;
    return (left->index > right->index) - (left->index < right->index);
}

static int order_vertices(struct gsn_soup *soup, const struct box *box, struct gsn_error *err)
{
    const size_t count = soup->vertex_count;
    gsn_auto_mem(struct place) place = gsn_alloc_array(count, sizeof *place);
    gsn_auto_mem(uint32_t) now = gsn_alloc_array(count, sizeof *now);
    gsn_auto_mem(double) old = gsn_memdup(soup->vertex, count * sizeof *soup->vertex);

    if (!place || !now || !old)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while ordering a mesh");
    for (size_t v = 0; v < count; v++)
        place[v] = (struct place){ morton(box, soup->vertex[v]), (uint32_t)v };
    qsort(place, count, sizeof *place, compare_places);
    for (size_t v = 0; v < count; v++) {
        now[place[v].index] = (uint32_t)v;
        memcpy(soup->vertex[v], old + 3 * (size_t)place[v].index, sizeof soup->vertex[v]);
    }
    for (size_t t = 0; t < soup->tet_count; t++)
        for (size_t k = 0; k < 4; k++)
            soup->tet[t][k] = now[soup->tet[t][k]];
    return GSN_OK;
}

static void sort_corners(uint32_t corner[4])
{
    for (size_t i = 1; i < 4; i++)
        for (size_t j = i; j > 0 && corner[j] < corner[j - 1]; j--) {
            const uint32_t swap = corner[j];

            corner[j] = corner[j - 1];
            corner[j - 1] = swap;
        }
}

static int order_tets(struct gsn_soup *soup, const struct box *box, struct gsn_error *err)
{
    const size_t count = soup->tet_count;
    gsn_auto_mem(struct place) place = gsn_alloc_array(count, sizeof *place);
    gsn_auto_mem(uint32_t) old = gsn_memdup(soup->tet, count * sizeof *soup->tet);

    if (!place || !old)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while ordering a mesh");
    for (size_t t = 0; t < count; t++) {
        double middle[3] = { 0 };

        sort_corners(old + 4 * t);
        for (size_t c = 0; c < 4; c++)
            for (size_t k = 0; k < 3; k++)
                middle[k] += soup->vertex[old[4 * t + c]][k] / 4;
        place[t] = (struct place){ morton(box, middle), (uint32_t)t };
    }
    qsort(place, count, sizeof *place, compare_places);
    for (size_t t = 0; t < count; t++)
        memcpy(soup->tet[t], old + 4 * (size_t)place[t].index, sizeof soup->tet[t]);
    return GSN_OK;
}

int gsn_domain_order(struct gsn_soup *soup, struct gsn_error *err)
{
    const struct box box = bounding_box(soup);
    const int r = order_vertices(soup, &box, err);

    return r < 0 ? r : order_tets(soup, &box, err);
}
