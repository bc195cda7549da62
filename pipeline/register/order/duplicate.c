/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Finds sections that are there twice, by texture that only two mounts of one section share.
 *
 * Steps: (1) a section's texture is its density less its own smooth part, in robust standard
 * deviations, clipped, 0 beside the tissue. (2) Two sections are compared in patches of half a
 * millimetre: the largest correlation of each over shifts of up to five cells, since every mount
 * stretches and warps a section anew; the median over the patches is what the two share. (3) What
 * neighbours of this stack share says what is usual. Two that share eight robust standard
 * deviations more are proposed as duplicate mounts; where neighbours share nearly all, nothing is.
 * (4) A section that is excluded pending review has no pose, so it is registered onto those up to
 * three numbers away by their tissue alone (tissue/pairwise.h); of a folded one it may be one side
 * that comes to lie right, so the best quarter of its patches counts.
 *
 * With too few patches nothing is said. Fails when memory runs out. The cost is that of the
 * multiply_patches in add_products(): pairs far below the limit are told by some ten patches each.
 */
#include "pipeline/core/robust.h"
#include "pipeline/imaging/smooth.h"
#include "pipeline/register/order/findings.h"
#include "pipeline/register/tissue/pairwise.h"

#include <math.h>
#include <string.h>

/* With fewer patches than this their median says little. */
enum { LEAST_PATCHES = 9 };

struct texture {
    size_t n, columns, rows;
    float *value;  /* owned; n planes, 0 beside the tissue, and two of scratch */
    double *share; /* owned; what each patch compared last shares, and scratch */
};

/* One number for the shares of at least so many patches; NaN of fewer. Two mounts share `same`
 * at least, and this many standard deviations of what neighbours share more than they do. */
struct summary {
    double (*of)(double *share, size_t count);
    size_t least;
    double same, deviations;
};

/* A patch is compared at all shifts up to REACH, as two mounts of a section are warped each in its
 * own way. A patch of 16 is half a millimetre: small enough to be shifted as a whole, large enough
 * that chance agrees by a fifth at most shifts. */
enum { PATCH = 16, REACH = 5, SHIFTS = 2 * REACH + 1, WINDOW = PATCH + 2 * REACH };

/* Whole vectors. */
enum { ROW = 12 };

/* What is finer than this is texture. */
enum { SMOOTHINGS = 2 };

enum { MOST_PATCHES = 4096 };

/* What two mounts of a section share under a good scanner. Where the limit is above, neighbours
 * share so much that nothing could tell a section that is there twice. */
static const double TWO_MOUNTS = 0.6;

/* Median absolute deviation to standard deviation of normal numbers. */
static const double MAD_TO_SD = 1.4826;

/* Of the plane's mean over what is not glass: below it is no tissue. */
static const double TISSUE = 0.1;

/* Edges of the anatomy are clipped to this many standard deviations: neighbours share them. */
static const double CLIP = 3;

/* Share of a patch that must be tissue; of the window around it in the other section. */
static const double FULL = 0.8, FULL_WINDOW = 0.5;

typedef float four __attribute__((vector_size(16)));

static void texture_free(struct texture *t)
{
    if (!t)
        return;
    gsn_free(t->value);
    gsn_free(t->share);
    gsn_free(t);
}

GSN_DEFINE_AUTO(texture);

/* gives: n planes without texture. Fails with GSN_E_NOMEM. */
static int new_texture(size_t n, size_t columns, size_t rows, struct texture **ret_texture,
                       struct gsn_error *err)
{
    gsn_auto(texture) t = gsn_alloc_array(1, sizeof *t);

    if (t) {
        *t = (struct texture){ .n = n, .columns = columns, .rows = rows };
        t->value = gsn_alloc_array((n + 2) * columns * rows, sizeof *t->value);
        t->share = gsn_alloc_array(columns * rows + MOST_PATCHES, sizeof *t->share);
    }
    if (!t || !t->value || !t->share)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the texture of %zu sections", n);
    *ret_texture = gsn_steal(&t);
    return GSN_OK;
}

/* ---- what a section has finer than its anatomy -------------------------------------------- */

/* Below this a cell is glass, or so poor in dye that its noise is all there is. */
static double least_tissue(const float *density, size_t cells)
{
    double sum = 0, count = 0;

    for (size_t c = 0; c < cells; c++)
        if (density[c] > 0) {
            sum += (double)density[c];
            count++;
        }
    return count > 0 ? TISSUE * sum / count : INFINITY;
}

/* Plane i from densities: 0 on glass, NaN where nothing is known. */
/* The difference to the plane's own smooth part, in robust standard deviations. */
static void fill_texture(struct texture *t, size_t i, const float *density)
{
    const size_t cells = t->columns * t->rows;
    float *value = t->value + i * cells, *smooth = t->value + t->n * cells,
          *weight = smooth + cells;
    double *spread = t->share + MOST_PATCHES;
    const float least = (float)least_tissue(density, cells);
    size_t count = 0;
    double sd;

    for (size_t c = 0; c < cells; c++) {
        weight[c] = isnan(density[c]) ? 0.0f : 1.0f;
        smooth[c] = isnan(density[c]) ? 0 : density[c];
    }
    gsn_smooth_binomial(smooth, t->columns, t->rows, SMOOTHINGS);
    gsn_smooth_binomial(weight, t->columns, t->rows, SMOOTHINGS);
    for (size_t c = 0; c < cells; c++) {
        value[c] = density[c] > least ? density[c] - smooth[c] / weight[c] : 0;
        if (density[c] > least)
            spread[count++] = fabs((double)value[c]);
    }
    sd = count ? MAD_TO_SD * gsn_median(spread, count) : 0;
    for (size_t c = 0; c < cells; c++)
        value[c] = sd > 0 ? (float)fmax(-CLIP, fmin((double)value[c] / sd, CLIP)) : 0;
}

/* ---- how much of it two sections share ---------------------------------------------------- */

static double tissue_share(const struct texture *t, const float *corner, size_t side)
{
    size_t count = 0;

    for (size_t y = 0; y < side; y++)
        for (size_t x = 0; x < side; x++)
            count += corner[y * t->columns + x] != 0;
    return (double)count / (double)(side * side);
}

/* Sums of squares over every patch of a window. */
static void sum_energies(const struct texture *t, const float *window,
                         double ret_energy[SHIFTS][SHIFTS])
{
    double sum[WINDOW + 1][WINDOW + 1] = { { 0 } };

    for (int y = 0; y < WINDOW; y++)
        for (int x = 0; x < WINDOW; x++) {
            const double v = (double)window[(size_t)y * t->columns + (size_t)x];

            sum[y + 1][x + 1] = sum[y][x + 1] + sum[y + 1][x] - sum[y][x] + v * v;
        }
    for (int v = 0; v < SHIFTS; v++)
        for (int u = 0; u < SHIFTS; u++)
            ret_energy[v][u] =
                sum[v + PATCH][u + PATCH] - sum[v][u + PATCH] - sum[v + PATCH][u] + sum[v][u];
}

/* A line of a patch times a row of the window, at ROW shifts. Written with vectors, as this is
 * where the time goes and the compiler would turn the loops inside out. */
static void add_products(const float line[PATCH], const float row[PATCH + ROW],
                         float ret_product[ROW])
{
    four sum[ROW / 4];

    memcpy(sum, ret_product, sizeof sum);
    for (int x = 0; x < PATCH; x++)
        for (int k = 0; k < ROW / 4; k++) {
            four at;

            memcpy(&at, row + x + 4 * k, sizeof at);
            sum[k] += line[x] * at;
        }
    memcpy(ret_product, sum, sizeof sum);
}

/* Products of a patch with every patch of a window. */
static void multiply_patches(const struct texture *t, const float *patch, const float *window,
                             float ret_product[SHIFTS][ROW])
{
    float row[WINDOW + ROW] = { 0 };

    memset(ret_product, 0, SHIFTS * sizeof *ret_product);
    for (int w = 0; w < WINDOW; w++) {
        memcpy(row, window + (size_t)w * t->columns, WINDOW * sizeof *row);
        for (int v = w < PATCH ? 0 : w - PATCH + 1; v < SHIFTS && v <= w; v++) {
            const float *line = patch + (size_t)(w - v) * t->columns;

            add_products(line, row, ret_product[v]);
        }
    }
}

/* The largest correlation of a patch with the patches around its place in the other section. */
static double find_agreement(const struct texture *t, const float *patch, const float *window)
{
    float product[SHIFTS][ROW];
    double energy[SHIFTS][SHIFTS], own = 0, most = 0;

    for (size_t y = 0; y < PATCH; y++)
        for (size_t x = 0; x < PATCH; x++)
            own += pow((double)patch[y * t->columns + x], 2);
    sum_energies(t, window, energy);
    multiply_patches(t, patch, window, product);
    for (int v = 0; v < SHIFTS; v++)
        for (int u = 0; u < SHIFTS; u++)
            if (energy[v][u] * own > 0)
                most = fmax(most, (double)product[v][u] / sqrt(energy[v][u] * own));
    return most;
}

/* Fills share with the largest correlation of each patch of plane i with those around its place in
 * plane j; every step-th patch is looked at. Returns how many have tissue over tissue. */
static size_t compare_patches(struct texture *t, size_t i, size_t j, size_t step)
{
    const size_t cells = t->columns * t->rows;
    size_t count = 0, at = 0;

    for (size_t y = REACH; y + PATCH + REACH <= t->rows; y += PATCH)
        for (size_t x = REACH; x + PATCH + REACH <= t->columns; x += PATCH) {
            const float *a = t->value + i * cells + y * t->columns + x;
            const float *b = t->value + j * cells + (y - REACH) * t->columns + x - REACH;

            if (at++ % step != 0 || count >= MOST_PATCHES || tissue_share(t, a, PATCH) < FULL ||
                tissue_share(t, b, WINDOW) < FULL_WINDOW)
                continue;
            t->share[count++] = find_agreement(t, a, b);
        }
    return count;
}

/* Patches of a whole plane, with tissue or without. */
static size_t count_patches(const struct texture *t)
{
    return (t->columns / PATCH) * (t->rows / PATCH);
}

static double measure_shared(struct texture *t, size_t i, size_t j, size_t step,
                             const struct summary *summary)
{
    const size_t count = compare_patches(t, i, j, step);

    return count >= summary->least ? summary->of(t->share, count) : NAN;
}

/* Whether neighbours show enough to know two mounts of one section by. ret_usual: what they share,
 * in the median of the pairs; ret_least: what two mounts share more than. Fails with GSN_E_NOMEM.
 */
/* ---- what only two mounts share ----------------------------------------------------------- */

static int learn_limit(struct texture *t, const struct summary *summary, int *ret_told,
                       double *ret_usual, double *ret_least, struct gsn_error *err)
{
    gsn_auto_mem(double) share = gsn_alloc_array(t->n, sizeof *share);
    size_t pairs = 0;
    double usual;

    if (!share)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the texture of %zu sections", t->n);
    for (size_t i = 0; i + 1 < t->n; i++) {
        const double of_pair = measure_shared(t, i, i + 1, 1, summary);

        if (!isnan(of_pair))
            share[pairs++] = of_pair;
    }
    *ret_told = 0;
    if (2 * pairs < t->n)
        return GSN_OK;
    usual = gsn_median(share, pairs);
    for (size_t i = 0; i < pairs; i++)
        share[i] = fabs(share[i] - usual);
    *ret_usual = usual;
    *ret_least =
        fmax(summary->same, usual + summary->deviations * MAD_TO_SD * gsn_median(share, pairs));
    *ret_told = *ret_least <= TWO_MOUNTS;
    return GSN_OK;
}

/* ---- sections that were registered -------------------------------------------------------- */

/* A first look takes about FIRST_LOOK patches of the whole plane; those on tissue tell nearly all
 * pairs. */
enum { FIRST_LOOK = 10, LEAST_OF_FIRST = 5 };

/* A pair whose first look is below this part of the limit is not looked at again. */
static const double FAR_BELOW = 0.7;

/* Two mounts share this much of their texture at least, and this much more than neighbours of this
 * stack do, in standard deviations of what neighbours share. */
static const struct summary WHOLE = { gsn_median, LEAST_PATCHES, 0.38, 8 };
static const struct summary FIRST = { gsn_median, LEAST_OF_FIRST, 0.38, 8 };

/* Pairs far below the limit, which are nearly all, are told by a few of their patches. */
static double measure_if_shared(struct texture *t, size_t i, size_t j, double least)
{
    const size_t patches = count_patches(t);
    const size_t step = patches / FIRST_LOOK;

    if (step > 1) {
        const double first = measure_shared(t, i, j, step, &FIRST);

        if (first < FAR_BELOW * least)
            return first;
    }
    return measure_shared(t, i, j, 1, &WHOLE);
}

static void find_pairs(struct texture *t, const struct gsn_sequence_plane *planes, double usual,
                       double least, struct gsn_sequence *found)
{
    for (size_t i = 0; i < t->n; i++)
        for (size_t j = i + 1; j < t->n && found->count < t->n; j++) {
            const double share = measure_if_shared(t, i, j, least);

            if (share > least)
                found->finding[found->count++] =
                    (struct gsn_sequence_finding){ .kind = GSN_SEQUENCE_DUPLICATE,
                                                   .a = planes[i].serial,
                                                   .b = planes[j].serial,
                                                   .evidence = share,
                                                   .usual = usual };
        }
}

int gsn_sequence_find_duplicates(const struct gsn_sequence_plane *planes, size_t n, size_t columns,
                                 size_t rows, struct gsn_sequence *found, struct gsn_error *err)
{
    gsn_auto(texture) t = NULL;
    double usual = 0, least = 0;
    int r = new_texture(n, columns, rows, &t, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < n; i++)
        fill_texture(t, i, planes[i].density);
    r = learn_limit(t, &WHOLE, &found->duplicates_known, &usual, &least, err);
    if (r >= 0 && found->duplicates_known)
        find_pairs(t, planes, usual, least, found);
    return r;
}

/* ---- sections excluded pending review ----------------------------------------------------- */

/* The second mount of a section lies in one of the next slots, whose own section is missing. */
enum { NEAR_BY = 3 };

/* The median of the upper half. */
static double upper_quartile(double *share, size_t count)
{
    (void)gsn_order_pick(share, count, count / 2);
    return gsn_median(share + count / 2, count - count / 2);
}

/* Of a folded section one side alone may come to lie right: as many patches must agree as of the
 * fewest that a median is taken of, and by more, for chance lifts the best more than the middle.
 * Fewer deviations than of the median, since six pairs of a section are compared and not all. */
static const struct summary BEST_QUARTER = { upper_quartile, 2 * LEAST_PATCHES, 0.42, 5 };

/* A cell of which less than this share is seen is not known. */
static const double SEEN = 0.5;

/* What is not known counts as this little seen: it is no glass. */
static const float HIDDEN = 1e-6f;

/* Sections side by side, in cells of the planes. */
struct picture {
    size_t columns, rows;
    const float *density; /* borrowed */
};

/* One section that is not registered, as it lies on its slide. */
struct part {
    const struct gsn_sequence_excluded *held;
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

/* The section under a map from its own cells to those of a frame. ret_density, seen: a frame. */
static void place_section(const struct gsn_sequence_excluded *held, const struct gsn_affine *map,
                          size_t columns, size_t rows, float *ret_density, float *seen)
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

static struct gsn_affine to_cells(const struct gsn_sequence_excluded *held)
{
    return (struct gsn_affine){ held->side, 0, 0, 0, held->side, 0 };
}

/* gives: NULL where a picture has too little tissue. */
static int make_tissue(const struct picture *picture, struct gsn_tissue **ret_tissue,
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

static int make_part(struct part *part, struct gsn_error *err)
{
    const struct gsn_sequence_excluded *held = part->held;
    const struct gsn_affine map = to_cells(held);

    part->columns = (size_t)((double)held->columns * held->side) + 1;
    part->rows = (size_t)((double)held->rows * held->side) + 1;
    part->density = gsn_alloc_array(part->columns * part->rows, sizeof *part->density);

    gsn_auto_mem(float) seen = gsn_alloc_array(part->columns * part->rows, sizeof *seen);

    if (!part->density || !seen)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the sections that are held");
    place_section(held, &map, part->columns, part->rows, part->density, seen);
    return make_tissue(&(struct picture){ part->columns, part->rows, part->density }, &part->tissue,
                       err);
}

/* What the texture of a section registered by a_to_b shares with a picture's. */
static int measure_registered(const struct part *part, const struct gsn_affine *a_to_b,
                              const struct picture *picture, double *ret_share,
                              struct gsn_error *err)
{
    const struct gsn_affine own = to_cells(part->held);
    const struct gsn_affine map = gsn_affine_compose(&own, a_to_b);
    gsn_auto_mem(float) room = gsn_alloc_array(2 * picture->columns, picture->rows * sizeof *room);
    gsn_auto(texture) texture = NULL;
    int r = new_texture(2, picture->columns, picture->rows, &texture, err);

    if (r < 0)
        return r;
    if (!room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the sections that are held");
    place_section(part->held, &map, picture->columns, picture->rows, room,
                  room + picture->columns * picture->rows);
    fill_texture(texture, 0, room);
    fill_texture(texture, 1, picture->density);
    *ret_share = measure_shared(texture, 0, 1, 1, &BEST_QUARTER);
    return GSN_OK;
}

/* Registers a part on a picture by their tissue; NaN where they do not hang together. */
static int compare_by_tissue(const struct part *part, const struct picture *picture,
                             double *ret_share, struct gsn_error *err)
{
    gsn_auto(gsn_tissue) other = NULL;
    struct gsn_tissue_match match;
    struct gsn_error own = { 0 };
    int r = make_tissue(picture, &other, err);

    *ret_share = NAN;
    if (r < 0 || !other)
        return r;
    r = gsn_tissue_search(part->tissue, other, &match, &own);
    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", own.text);
    return r < 0 ? GSN_OK : measure_registered(part, &match.a_to_b, picture, ret_share, err);
}

static int is_near(unsigned a, unsigned b)
{
    return a != b && (a > b ? a - b : b - a) <= NEAR_BY;
}

/* Keeps what a part shares with another section where it is more than neighbours do. */
static void keep_if_shared(struct search *w, unsigned own, unsigned other, int other_held,
                           double share)
{
    struct gsn_sequence_finding finding = { .kind = GSN_SEQUENCE_EXCLUDED_DUPLICATE,
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

static int compare_neighbours(struct search *w, size_t i, struct gsn_error *err)
{
    const struct part *part = &w->part[i];
    const unsigned serial = part->held->serial;
    double share;
    int r = GSN_OK;

    for (size_t k = 0; r >= 0 && part->tissue && k < w->count; k++) {
        if (!is_near(serial, w->planes[k].serial))
            continue;
        r = compare_by_tissue(part, &(struct picture){ w->columns, w->rows, w->planes[k].density },
                              &share, err);
        if (r >= 0)
            keep_if_shared(w, serial, w->planes[k].serial, 0, share);
    }
    for (size_t k = i + 1; r >= 0 && part->tissue && k < w->parts; k++) {
        const struct part *other = &w->part[k];

        if (!is_near(serial, other->held->serial))
            continue;
        r = compare_by_tissue(
            part, &(struct picture){ other->columns, other->rows, other->density }, &share, err);
        if (r >= 0)
            keep_if_shared(w, serial, other->held->serial, 1, share);
    }
    return r;
}

static int compare_all(struct search *w, const struct gsn_sequence_excluded *held,
                       struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < w->parts; i++) {
        w->part[i].held = &held[i];
        r = make_part(&w->part[i], err);
    }
    for (size_t i = 0; r >= 0 && i < w->parts; i++)
        r = compare_neighbours(w, i, err);
    for (size_t i = 0; i < w->parts; i++) {
        gsn_free(w->part[i].density);
        gsn_tissue_free(w->part[i].tissue);
    }
    return r;
}

/* What neighbours share in their best quarter. */
static int learn_usual(struct search *w, int *ret_told, struct gsn_error *err)
{
    gsn_auto(texture) texture = NULL;
    int r = new_texture(w->count, w->columns, w->rows, &texture, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < w->count; i++)
        fill_texture(texture, i, w->planes[i].density);
    return learn_limit(texture, &BEST_QUARTER, ret_told, &w->usual, &w->least, err);
}

static int join_findings(struct gsn_sequence *sequence, const struct search *w,
                         struct gsn_error *err)
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
    return GSN_OK;
}

int gsn_sequence_find_excluded(const struct gsn_sequence_plane *planes, size_t count,
                               size_t columns, size_t rows,
                               const struct gsn_sequence_excluded *held, size_t held_count,
                               struct gsn_sequence *sequence, struct gsn_error *err)
{
    gsn_auto_mem(struct part) part = gsn_alloc_array(held_count, sizeof *part);
    gsn_auto_mem(struct gsn_sequence_finding) finding =
        gsn_alloc_array(held_count * (2 * NEAR_BY + held_count), sizeof *finding);
    struct search w = { planes, count, columns, rows, part, held_count, .finding = finding };
    int told = 0, r;

    if (!part || !finding)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the sections that are held");
    r = learn_usual(&w, &told, err);
    if (r >= 0 && told)
        r = compare_all(&w, held, err);
    return r < 0 || w.found == 0 ? r : join_findings(sequence, &w, err);
}
