/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_order.h"

#include "pipeline/assembly_parts.h"
#include "pipeline/register/median.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>

/* Cells of the block, um: several sections' errors of laying wide, and most structures' size. */
static const double CELL_UM = 100;
/* Texture is looked at in finer ones. */
static const double FINE_UM = 100.0 / GSN_SEQUENCE_FINER;
/* A cell of which less than this share was seen is not known. */
static const double SEEN = 0.5;

struct gsn_section_order {
    size_t count;            /* planes: laid sections, one for each serial number */
    size_t *section;         /* their places in the assembly */
    struct gsn_point origin; /* of the first cell's corner, um in the block */
    size_t columns, rows;
    float *sum, *seen; /* of the fine cells of each plane; um2 of tissue or glass seen */
    float *mean;       /* count * columns * rows */
};

static size_t coarse_cells(const struct gsn_section_order *order)
{
    return order->columns * order->rows;
}

static size_t fine_cells(const struct gsn_section_order *order)
{
    return GSN_SEQUENCE_FINER * GSN_SEQUENCE_FINER * coarse_cells(order);
}

static int is_laid(const struct gsn_assembly_section *s)
{
    return s->posed && (s->state == GSN_SECTION_USED || s->state == GSN_SECTION_DOUBTFUL) &&
           s->seen.width > 0 && s->seen.height > 0;
}

/* The laid sections, the first of each serial number. */
static size_t list(const struct gsn_assembly *a, size_t *ret_section)
{
    size_t count = 0;

    for (size_t i = 0; i < a->section_count; i++)
        if (is_laid(&a->section[i]) &&
            (count == 0 ||
             a->section[ret_section[count - 1]].seen.serial != a->section[i].seen.serial))
            ret_section[count++] = i;
    return count;
}

/* One end of a section's box in the block. */
static double end_of(const struct gsn_assembly_section *s, int along_y, double sign)
{
    double most = -INFINITY;

    for (int corner = 0; corner < 4; corner++) {
        const struct gsn_point at = { s->seen.x + (corner & 1 ? s->seen.width : 0),
                                      s->seen.y + (corner & 2 ? s->seen.height : 0) };
        const struct gsn_point p = gsn_affine_apply(&s->pose.panel_to_block_um, at);

        most = fmax(most, sign * (along_y ? p.y : p.x));
    }
    return sign * most;
}

/* The median section's end: a box that holds two sections, or a scrap, does not widen it. */
static double usual_end(const struct gsn_section_order *order, const struct gsn_assembly *a,
                        int along_y, double sign, double *room)
{
    for (size_t k = 0; k < order->count; k++)
        room[k] = end_of(&a->section[order->section[k]], along_y, sign);
    return gsn_median(room, order->count);
}

int gsn_section_order_new(const struct gsn_assembly *a, struct gsn_section_order **ret_order,
                          struct gsn_error *err)
{
    gsn_auto(gsn_section_order) order = gsn_alloc_array(1, sizeof *order);
    gsn_auto_mem(double) room = gsn_alloc_array(a->section_count, sizeof *room);

    assert(ret_order);

    if (order)
        order->section = gsn_alloc_array(a->section_count, sizeof *order->section);
    if (!order || !room || !order->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    order->count = list(a, order->section);
    if (order->count == 0) {
        *ret_order = NULL;
        return GSN_OK;
    }
    order->origin =
        (struct gsn_point){ usual_end(order, a, 0, -1, room), usual_end(order, a, 1, -1, room) };
    order->columns =
        (size_t)fmax((usual_end(order, a, 0, 1, room) - order->origin.x) / CELL_UM, 1) + 1;
    order->rows =
        (size_t)fmax((usual_end(order, a, 1, 1, room) - order->origin.y) / CELL_UM, 1) + 1;
    order->sum = gsn_alloc_array(order->count * fine_cells(order), sizeof(float));
    order->seen = gsn_alloc_array(order->count * fine_cells(order), sizeof(float));
    order->mean = gsn_alloc_array(order->count * coarse_cells(order), sizeof(float));
    if (!order->sum || !order->seen || !order->mean)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    *ret_order = gsn_steal(&order);
    return GSN_OK;
}

void gsn_section_order_free(struct gsn_section_order *order)
{
    if (!order)
        return;
    gsn_free(order->section);
    gsn_free(order->sum);
    gsn_free(order->seen);
    gsn_free(order->mean);
    gsn_free(order);
}

static void gather(struct gsn_section_order *order, size_t plane,
                   const struct gsn_assembly_section *s, const struct gsn_plane *density,
                   unsigned apart)
{
    const struct gsn_affine *map = &s->pose.panel_to_block_um;
    const float area = (float)(apart * fabs(gsn_affine_det(map)));
    const size_t columns = GSN_SEQUENCE_FINER * order->columns;
    const size_t rows = GSN_SEQUENCE_FINER * order->rows;
    float *sum = order->sum + plane * fine_cells(order);
    float *seen = order->seen + plane * fine_cells(order);

    for (size_t y = 0; y < density->height; y++)
        for (size_t x = 0; x < density->width; x++) {
            const float value = density->value[y * density->width + x];
            const struct gsn_point at = { s->seen.x + (double)x + 0.5,
                                          s->seen.y + (double)(y * apart) + 0.5 };
            const struct gsn_point p = gsn_affine_apply(map, at);
            const double u = (p.x - order->origin.x) / FINE_UM;
            const double v = (p.y - order->origin.y) / FINE_UM;

            if (isnan(value) || !(u >= 0 && v >= 0 && u < (double)columns && v < (double)rows))
                continue;
            sum[(size_t)v * columns + (size_t)u] += area * value;
            seen[(size_t)v * columns + (size_t)u] += area;
        }
}

void gsn_section_order_add(struct gsn_section_order *order, const struct gsn_assembly *a, size_t i,
                           const struct gsn_plane *density, unsigned apart)
{
    for (size_t k = 0; order && k < order->count; k++)
        if (order->section[k] == i)
            gather(order, k, &a->section[i], density, apart);
}

/* What no section's box reached is glass; what was masked is not known. */
static float mean_of(double sum, double seen, double cell_um)
{
    if (seen >= SEEN * cell_um * cell_um)
        return (float)(sum / seen);
    return seen > 0 ? NAN : 0;
}

/* The mean over the fine cells of one coarse cell. */
static float coarse_mean(const struct gsn_section_order *order, size_t plane, size_t x, size_t y)
{
    const size_t columns = GSN_SEQUENCE_FINER * order->columns;
    const size_t corner = plane * fine_cells(order) + GSN_SEQUENCE_FINER * (y * columns + x);
    double sum = 0, seen = 0;

    for (size_t v = 0; v < GSN_SEQUENCE_FINER; v++)
        for (size_t u = 0; u < GSN_SEQUENCE_FINER; u++) {
            sum += (double)order->sum[corner + v * columns + u];
            seen += (double)order->seen[corner + v * columns + u];
        }
    return mean_of(sum, seen, CELL_UM);
}

/* Sums become means. */
static void mean(struct gsn_section_order *order)
{
    for (size_t plane = 0; plane < order->count; plane++)
        for (size_t y = 0; y < order->rows; y++)
            for (size_t x = 0; x < order->columns; x++)
                order->mean[(plane * order->rows + y) * order->columns + x] =
                    coarse_mean(order, plane, x, y);
    for (size_t i = 0; i < order->count * fine_cells(order); i++)
        order->sum[i] = mean_of((double)order->sum[i], (double)order->seen[i], FINE_UM);
}

static struct gsn_assembly_section *section_of(const struct gsn_section_order *order,
                                               struct gsn_assembly *a, unsigned serial)
{
    for (size_t k = 0; k < order->count; k++)
        if (a->section[order->section[k]].seen.serial == serial)
            return &a->section[order->section[k]];
    return NULL;
}

static void flag(const struct gsn_section_order *order, struct gsn_assembly *a,
                 const struct gsn_sequence_finding *finding)
{
    const unsigned serial[2] = { finding->a, finding->b };

    for (int i = 0; i < 2; i++) {
        struct gsn_assembly_section *s = section_of(order, a, serial[i]);
        char word[40];

        (void)snprintf(word, sizeof word,
                       finding->kind == GSN_SEQUENCE_SWAP ? "swapped-with-%u?" : "same-as-%u?",
                       serial[1 - i]);
        if (s)
            gsn_assembly_flag(s, word);
    }
}

int gsn_section_order_examine(struct gsn_section_order *order, struct gsn_assembly *a,
                              struct gsn_sequence **ret_sequence, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_sequence_plane) planes = gsn_alloc_array(order->count, sizeof *planes);
    int r;

    if (!planes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    mean(order);
    for (size_t k = 0; k < order->count; k++)
        planes[k] = (struct gsn_sequence_plane){ a->section[order->section[k]].seen.serial,
                                                 order->mean + k * coarse_cells(order),
                                                 order->sum + k * fine_cells(order) };
    r = gsn_sequence_examine(planes, order->count, order->columns, order->rows, ret_sequence, err);
    for (size_t i = 0; r >= 0 && i < (*ret_sequence)->count; i++)
        flag(order, a, &(*ret_sequence)->finding[i]);
    return r;
}

void gsn_section_order_sentence(const struct gsn_sequence_finding *finding,
                                char ret_sentence[GSN_POSE_SENTENCE])
{
    if (finding->kind == GSN_SEQUENCE_SWAP)
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "sections %u and %u look swapped: in each other's places the stack there "
                       "would be %.0f %% less rough along z; nothing was moved: look at both",
                       finding->a, finding->b, 100 * finding->smoother);
    else
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "sections %u and %u look like one section, mounted or scanned twice: their "
                       "texture agrees to %.0f %%, that of neighbours to %.0f %%; both are used: "
                       "look at them, and hold the one that is not there",
                       finding->a, finding->b, 100 * finding->evidence, 100 * finding->usual);
}

int gsn_section_order_blind_to_swaps(const struct gsn_sequence *sequence,
                                     char ret_sentence[GSN_POSE_SENTENCE])
{
    char near[48] = "", most[80] = "";

    ret_sentence[0] = '\0';
    if (sequence->reach == 1)
        return 0;
    if (sequence->reach > 1)
        (void)snprintf(near, sizeof near, " nearer than %u to each other", sequence->reach);
    if (sequence->unseen > 0)
        (void)snprintf(most, sizeof most,
                       "; it would carry at most %.2g %% of all density to the other place",
                       100 * sequence->unseen);
    (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                   "a swap of two sections%s may not show in their tissue: their order rests on "
                   "numbers and slots alone%s",
                   near, most);
    return 1;
}

int gsn_section_order_blind_to_duplicates(const struct gsn_sequence *sequence,
                                          char ret_sentence[GSN_POSE_SENTENCE])
{
    ret_sentence[0] = '\0';
    if (sequence->twice_told)
        return 0;
    (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                   "a section mounted or scanned twice would not show: neighbours share all that "
                   "could set one apart");
    return 1;
}
