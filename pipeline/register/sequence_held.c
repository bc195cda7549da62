/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include "pipeline/core/robust.h"
#include "pipeline/register/sequence_texture.h"
#include "pipeline/register/tissue.h"

#include <math.h>
#include <string.h>

/* The second mount of a section lies in one of the next slots, whose own section is missing. */
enum { NEAR_BY = 3 };
/* Of a folded section one side alone may come to lie right: as many patches must agree as of the
 * fewest that a median is taken of, and by more, for chance lifts the best more than the middle.
 * Fewer deviations than of the median, since six pairs of a section are compared and not all. */
static double upper_quartile(double *share, size_t count);
static const struct gsn_sequence_summary BEST_QUARTER = { upper_quartile,
                                                          2 * GSN_SEQUENCE_LEAST_PATCHES, 0.42, 5 };
/* A cell of which less than this share is seen is not known. */
static const double SEEN = 0.5;
/* What is not known counts as this little seen: it is no glass. */
static const float HIDDEN = 1e-6f;

/* Sections side by side, in cells of the planes. */
struct picture {
    size_t columns, rows;
    const float *density; /* borrowed */
};

/* One section that is not laid, as it lies on its slide. */
struct part {
    const struct gsn_sequence_held *held;
    size_t columns, rows;
    float *density;            /* owned; in cells of the planes */
    struct gsn_tissue *tissue; /* owned; NULL where there is too little */
};

/* What neighbours share, and what is looked for. */
struct search {
    const struct gsn_sequence_plane *planes;
    size_t count, columns, rows;
    struct part *part;
    size_t parts;
    double usual, least;
    struct gsn_sequence_finding *finding;
    size_t found;
};

/* The median of the upper half. */
static double upper_quartile(double *share, size_t count)
{
    (void)gsn_order_pick(share, count, count / 2);
    return gsn_median(share + count / 2, count - count / 2);
}

/* ---- a section where it is not ------------------------------------------------------------ */

/* The section under a map from its own cells to those of a frame. ret_density, seen: a frame. */
static void lay(const struct gsn_sequence_held *held, const struct gsn_affine *map, size_t columns,
                size_t rows, float *ret_density, float *seen)
{
    const float area = (float)fabs(gsn_affine_det(map));

    memset(ret_density, 0, columns * rows * sizeof *ret_density);
    memset(seen, 0, columns * rows * sizeof *seen);
    for (size_t i = 0; i < held->columns * held->rows; i++) {
        const struct gsn_point at = { (double)(i % held->columns) + 0.5,
                                      (double)(i / held->columns) + 0.5 };
        const struct gsn_point p = gsn_affine_apply(map, at);
        const float value = held->density[i];
        size_t cell;

        if (!(p.x >= 0 && p.y >= 0 && p.x < (double)columns && p.y < (double)rows))
            continue;
        cell = (size_t)p.y * columns + (size_t)p.x;
        ret_density[cell] += isnan(value) ? 0 : area * value;
        seen[cell] += isnan(value) ? HIDDEN * area : area;
    }
    for (size_t c = 0; c < columns * rows; c++)
        ret_density[c] = (double)seen[c] >= SEEN ? ret_density[c] / seen[c] : seen[c] > 0 ? NAN : 0;
}

static struct gsn_affine to_cells(const struct gsn_sequence_held *held)
{
    return (struct gsn_affine){ held->side, 0, 0, 0, held->side, 0 };
}

/* gives: NULL where a picture has too little tissue. */
static int see_tissue(const struct picture *picture, struct gsn_tissue **ret_tissue,
                      struct gsn_error *err)
{
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_error own = { 0 };
    int r = gsn_plane_new((uint32_t)picture->columns, (uint32_t)picture->rows, &plane, err);

    if (r < 0)
        return r;
    memcpy(plane->value, picture->density,
           picture->columns * picture->rows * sizeof *picture->density);
    r = gsn_tissue_new(plane, 1, ret_tissue, &own);
    return r == GSN_E_NOMEM ? gsn_fail(err, r, "%s", own.text) : GSN_OK;
}

static int see_part(struct part *part, struct gsn_error *err)
{
    const struct gsn_sequence_held *held = part->held;
    const struct gsn_affine map = to_cells(held);

    part->columns = (size_t)((double)held->columns * held->side) + 1;
    part->rows = (size_t)((double)held->rows * held->side) + 1;
    part->density = gsn_alloc_array(part->columns * part->rows, sizeof *part->density);

    gsn_auto_mem(float) seen = gsn_alloc_array(part->columns * part->rows, sizeof *seen);

    if (!part->density || !seen)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the sections that are held");
    lay(held, &map, part->columns, part->rows, part->density, seen);
    return see_tissue(&(struct picture){ part->columns, part->rows, part->density }, &part->tissue,
                      err);
}

/* ---- two mounts ---------------------------------------------------------------------------- */

/* What the texture of a section laid by a_to_b shares with a picture's. */
static int share_texture(const struct part *part, const struct gsn_affine *a_to_b,
                         const struct picture *picture, double *ret_share, struct gsn_error *err)
{
    const struct gsn_affine own = to_cells(part->held);
    const struct gsn_affine map = gsn_affine_compose(&own, a_to_b);
    gsn_auto_mem(float) room = gsn_alloc_array(2 * picture->columns, picture->rows * sizeof *room);
    gsn_auto(gsn_sequence_texture) texture = NULL;
    int r = gsn_sequence_texture_new(2, picture->columns, picture->rows, &texture, err);

    if (r < 0)
        return r;
    if (!room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the sections that are held");
    lay(part->held, &map, picture->columns, picture->rows, room,
        room + picture->columns * picture->rows);
    gsn_sequence_texture_fill(texture, 0, room);
    gsn_sequence_texture_fill(texture, 1, picture->density);
    *ret_share = gsn_sequence_texture_shared(texture, 0, 1, 1, &BEST_QUARTER);
    return GSN_OK;
}

/* Lays a part on a picture by their tissue; NaN where they do not hang together. */
static int compare(const struct part *part, const struct picture *picture, double *ret_share,
                   struct gsn_error *err)
{
    gsn_auto(gsn_tissue) other = NULL;
    struct gsn_tissue_match match;
    struct gsn_error own = { 0 };
    int r = see_tissue(picture, &other, err);

    *ret_share = NAN;
    if (r < 0 || !other)
        return r;
    r = gsn_tissue_search(part->tissue, other, &match, &own);
    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", own.text);
    return r < 0 ? GSN_OK : share_texture(part, &match.a_to_b, picture, ret_share, err);
}

static int is_near(unsigned a, unsigned b)
{
    return a != b && (a > b ? a - b : b - a) <= NEAR_BY;
}

/* Keeps what a part shares with another section where it is more than neighbours do. */
static void weigh(struct search *w, unsigned own, unsigned other, int other_held, double share)
{
    struct gsn_sequence_finding finding = { .kind = GSN_SEQUENCE_HELD_DUPLICATE,
                                            .evidence = share,
                                            .usual = w->usual };

    if (!(share > w->least))
        return;
    finding.a = own < other ? own : other;
    finding.b = own < other ? other : own;
    finding.held[0] = own < other || other_held;
    finding.held[1] = own > other || other_held;
    w->finding[w->found++] = finding;
}

static int look_around(struct search *w, size_t i, struct gsn_error *err)
{
    const struct part *part = &w->part[i];
    const unsigned serial = part->held->serial;
    double share;
    int r = GSN_OK;

    for (size_t k = 0; r >= 0 && part->tissue && k < w->count; k++) {
        if (!is_near(serial, w->planes[k].serial))
            continue;
        r = compare(part, &(struct picture){ w->columns, w->rows, w->planes[k].density }, &share,
                    err);
        if (r >= 0)
            weigh(w, serial, w->planes[k].serial, 0, share);
    }
    for (size_t k = i + 1; r >= 0 && part->tissue && k < w->parts; k++) {
        const struct part *other = &w->part[k];

        if (!is_near(serial, other->held->serial))
            continue;
        r = compare(part, &(struct picture){ other->columns, other->rows, other->density }, &share,
                    err);
        if (r >= 0)
            weigh(w, serial, other->held->serial, 1, share);
    }
    return r;
}

static int look_at_all(struct search *w, const struct gsn_sequence_held *held,
                       struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < w->parts; i++) {
        w->part[i].held = &held[i];
        r = see_part(&w->part[i], err);
    }
    for (size_t i = 0; r >= 0 && i < w->parts; i++)
        r = look_around(w, i, err);
    for (size_t i = 0; i < w->parts; i++) {
        gsn_free(w->part[i].density);
        gsn_tissue_free(w->part[i].tissue);
    }
    return r;
}

/* What neighbours share in their best quarter. */
static int learn(struct search *w, int *ret_told, struct gsn_error *err)
{
    gsn_auto(gsn_sequence_texture) texture = NULL;
    int r = gsn_sequence_texture_new(w->count, w->columns, w->rows, &texture, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < w->count; i++)
        gsn_sequence_texture_fill(texture, i, w->planes[i].density);
    return gsn_sequence_texture_judge(texture, &BEST_QUARTER, ret_told, &w->usual, &w->least, err);
}

static int join(struct gsn_sequence *sequence, const struct search *w, struct gsn_error *err)
{
    struct gsn_sequence_finding *all = gsn_alloc_array(sequence->count + w->found + 1, sizeof *all);

    if (!all)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    for (size_t i = 0; i < sequence->count; i++)
        all[i] = sequence->finding[i];
    for (size_t i = 0; i < w->found; i++)
        all[sequence->count + i] = w->finding[i];
    gsn_free(sequence->finding);
    sequence->finding = all;
    sequence->count += w->found;
    gsn_sequence_sort(sequence);
    return GSN_OK;
}

static int examine(struct search *w, const struct gsn_sequence_held *held,
                   struct gsn_sequence *sequence, struct gsn_error *err)
{
    gsn_auto_mem(struct part) part = gsn_alloc_array(w->parts, sizeof *part);
    gsn_auto_mem(struct gsn_sequence_finding) finding =
        gsn_alloc_array(w->parts * (2 * NEAR_BY + w->parts), sizeof *finding);
    int told = 0, r;

    if (!part || !finding)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the sections that are held");
    w->part = part;
    w->finding = finding;
    r = learn(w, &told, err);
    if (r >= 0 && told)
        r = look_at_all(w, held, err);
    return r < 0 || w->found == 0 ? r : join(sequence, w, err);
}

int gsn_sequence_examine_held(const struct gsn_sequence_plane *planes, size_t count, size_t columns,
                              size_t rows, const struct gsn_sequence_held *held, size_t held_count,
                              struct gsn_sequence *sequence, struct gsn_error *err)
{
    struct search w = { planes, count, columns, rows, .parts = held_count };

    return held_count > 0 && sequence->twice_told ? examine(&w, held, sequence, err) : GSN_OK;
}
