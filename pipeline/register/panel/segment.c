/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: Otsu's threshold (1979), morphological closing and opening by reconstruction (Serra 1982;
 * Vincent 1993), connected components (pipeline/imaging), k-means of equal sections where several
 * grew together (Lloyd 1982).
 *
 * Steps. 1. gsn_segment_tissue(): what is black along a whole side of the picture, the scanner's
 * bed or the holder, is taken off; the histogram of the densities is parted into glass and tissue.
 * 2. gsn_segment_mask(): the mask in a frame of empty cells is closed with a cross, so that things
 * along the border do not grow; its components are found. Where threads are asked for, the mask is
 * worn down by crosses and squares in turn, as an octagon does, so that a thread counts the same
 * whichever way it runs, and grown back inside itself by two cells more, which gives back the
 * outline; what is then missing of a component that has a wide place was a thread of it. The
 * components of what is left. 3. gsn_segment_section_area(): the size class that covers most.
 * 4. gsn_segment_regions(): a component of several areas is dealt out to so many centres, and
 * between two of them cut along the straight line that runs through the least tissue; two torn
 * halves that lie near each other are one region.
 *
 * Fails when memory runs out. A wrong cut is not told here: slots.c says where one is doubtful.
 * Cost: a few passes over some 200 000 cells; the cut tries 200 x 31 lines. */
#include "pipeline/register/panel/segment.h"

#include "pipeline/core/geom.h"
#include "pipeline/imaging/morphology.h"
#include "pipeline/imaging/threshold.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* ---- a mask and its components --------------------------------------------------------------- */

enum { FRAME = 2 };

/* Structuring elements by their radius: 5 and 9 cells. */
static const double CROSS = 1, SQUARE = 1.5;

/* A mask in its frame. */
struct framed {
    uint32_t width, height; /* with the frame */
    uint8_t *cell;
};

static size_t count_cells(const struct framed *mask)
{
    return (size_t)mask->width * mask->height;
}

/* The row of the mask itself that is y. */
static uint8_t *find_row(const struct framed *mask, uint32_t y)
{
    return mask->cell + (size_t)(y + FRAME) * mask->width + FRAME;
}

static int find_components(const struct framed *mask, struct gsn_components **ret_components,
                           struct gsn_error *err)
{
    const uint32_t width = mask->width - 2 * FRAME, height = mask->height - 2 * FRAME;
    gsn_auto_mem(uint8_t) bare = gsn_alloc((size_t)width * height);

    if (!bare)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    for (uint32_t y = 0; y < height; y++)
        memcpy(bare + (size_t)y * width, find_row(mask, y), width);
    return gsn_components_find(bare, width, height, ret_components, err);
}

/* wide becomes the cells of mask that are wider than a thread, and two more around them. */
static int find_wide_cells(const struct framed *mask, unsigned thread, uint8_t *wide,
                           struct gsn_error *err)
{
    const unsigned turns = (thread + 1) / 2;
    int r = GSN_OK;

    for (unsigned i = 0; r >= 0 && i < turns; i++)
        r = gsn_erode(wide, mask->width, mask->height, i % 2 ? SQUARE : CROSS, err);
    for (unsigned i = 0; r >= 0 && i < turns + 2; i++) {
        r = gsn_dilate(wide, mask->width, mask->height, CROSS, err);
        for (size_t k = 0; k < count_cells(mask); k++)
            wide[k] &= mask->cell[k];
    }
    return r;
}

/* The place in the frame of a pixel of a component. */
static size_t find_place(const struct framed *mask, const struct gsn_components *components,
                         size_t pixel)
{
    return (size_t)(pixel / components->width + FRAME) * mask->width + pixel % components->width +
           FRAME;
}

/* gives: for each component whether it has no wide place. NULL: no memory. */
static uint8_t *find_thin(const struct gsn_components *components, const struct framed *mask,
                          const uint8_t *wide)
{
    uint8_t *thin = gsn_alloc_array(components->count, 1);

    for (size_t i = 0; thin && i < components->count; i++) {
        const uint32_t *pixel = components->pixel + components->component[i].first;
        int any = 0;

        for (size_t k = 0; k < components->component[i].area; k++)
            any |= wide[find_place(mask, components, pixel[k])];
        thin[i] = !any;
    }
    return thin;
}

/* Takes the threads out of the mask that hang on something wide; the components that are left. */
static int cut_threads(struct framed *mask, unsigned thread, struct gsn_components **components,
                       uint8_t **ret_thin, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) wide = gsn_memdup(mask->cell, count_cells(mask));
    gsn_auto_mem(uint8_t) thin = NULL;
    int r = wide ? find_wide_cells(mask, thread, wide, err) : GSN_OK;

    if (r < 0)
        return r;
    thin = wide ? find_thin(*components, mask, wide) : NULL;
    if (!thin)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    for (size_t i = 0; i < (*components)->count; i++) {
        const uint32_t *pixel = (*components)->pixel + (*components)->component[i].first;

        for (size_t k = 0; !thin[i] && k < (*components)->component[i].area; k++) {
            const size_t at = find_place(mask, *components, pixel[k]);

            mask->cell[at] = wide[at];
        }
    }
    gsn_components_free(*components);
    *components = NULL;
    r = find_components(mask, components, err);
    if (r < 0)
        return r;
    *ret_thin = find_thin(*components, mask, wide);
    return *ret_thin ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
}

int gsn_segment_mask(const uint8_t *mask, uint32_t width, uint32_t height, unsigned thread,
                     struct gsn_components **ret_components, uint8_t **ret_thin,
                     struct gsn_error *err)
{
    struct framed framed = { .width = width + 2 * FRAME, .height = height + 2 * FRAME };
    gsn_auto_mem(uint8_t) cell = gsn_alloc_array(framed.width, framed.height);
    gsn_auto_mem(uint8_t) thin = NULL;
    gsn_auto(gsn_components) components = NULL;
    int r;

    assert(mask && width > 0 && height > 0 && ret_components);

    if (!cell)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    framed.cell = cell;
    for (uint32_t y = 0; y < height; y++)
        memcpy(find_row(&framed, y), mask + (size_t)y * width, width);
    r = gsn_dilate(cell, framed.width, framed.height, CROSS, err);
    if (r >= 0)
        r = gsn_erode(cell, framed.width, framed.height, CROSS, err);
    if (r >= 0)
        r = find_components(&framed, &components, err);
    if (r >= 0 && thread > 0)
        r = cut_threads(&framed, thread, &components, &thin, err);
    if (r >= 0 && !thin) {
        thin = gsn_alloc_array(components->count, 1);
        if (!thin)
            r = gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    }
    if (r < 0)
        return r;
    if (ret_thin)
        *ret_thin = gsn_steal(&thin);
    *ret_components = gsn_steal(&components);
    return GSN_OK;
}

/* ---- tissue and glass ------------------------------------------------------------------------ */

/* Anything smaller is dust. */
static const double DUST_UM = 200;

/* The tissue's mean must stand this far above the glass, in optical density. */
static const double TISSUE_LEAST = 0.05;

enum { BINS = 256 };

/* Density above which all is simply dark: ink must not pull the threshold up. */
static const double DARKEST = 1.0;

/* Components alike speak louder than one: two sections that grew together cover as much as two
 * alone.
 */
static const double ALONE = 0.8;

/* Masked cells and what is brighter than glass count as glass. */
static void clip_density(const struct gsn_plane *tissue, float *ret_value)
{
    const size_t count = (size_t)tissue->width * tissue->height;
    const float most = (float)DARKEST;

    for (size_t i = 0; i < count; i++) {
        const float value = tissue->value[i];

        ret_value[i] = value > 0 ? value < most ? value : most : 0;
    }
}

/* Whether the component holds a whole side of the picture, so that it lies beyond the panel: a
 * section leaves glass on either side of itself. */
static int is_bed(const struct gsn_components *components, size_t i, uint32_t height)
{
    const uint32_t width = components->width;
    const uint32_t *pixel = components->pixel + components->component[i].first;
    size_t left = 0, right = 0, top = 0, bottom = 0;

    for (size_t k = 0; k < components->component[i].area; k++) {
        const uint32_t x = pixel[k] % width, y = pixel[k] / width;

        left += x == 0;
        right += x == width - 1;
        top += y == 0;
        bottom += y == height - 1;
    }
    return left == height || right == height || top == width || bottom == width;
}

/* Makes glass of the dark bed around the panel, and of the cell beside it, which is half of it. */
static int clear_bed(float *value, uint8_t *dark, uint32_t width, uint32_t height,
                     struct gsn_error *err)
{
    const size_t count = (size_t)width * height;
    gsn_auto(gsn_components) components = NULL;
    int r;

    for (size_t i = 0; i < count; i++)
        dark[i] = value[i] >= (float)DARKEST;
    r = gsn_components_find(dark, width, height, &components, err);
    if (r < 0)
        return r;
    memset(dark, 0, count);
    for (size_t i = 0; i < components->count; i++) {
        const struct gsn_component *c = &components->component[i];
        const size_t area = is_bed(components, i, height) ? c->area : 0;

        for (size_t k = 0; k < area; k++)
            dark[components->pixel[c->first + k]] = 1;
    }
    r = gsn_dilate(dark, width, height, SQUARE, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        value[i] = dark[i] ? 0 : value[i];
    return r;
}

/* Otsu's threshold between glass and tissue; ret_apart is the distance of their means. */
static double find_threshold(const float *value, size_t count, double *ret_apart)
{
    size_t histogram[BINS] = { 0 }, cut;

    for (size_t i = 0; i < count; i++) {
        const unsigned bin = (unsigned)(value[i] * (float)(BINS / DARKEST));

        histogram[bin < BINS ? bin : BINS - 1]++;
    }
    cut = gsn_otsu_cut(histogram, BINS, ret_apart);
    *ret_apart *= DARKEST / BINS;
    return (double)cut / BINS * DARKEST;
}

int gsn_segment_tissue(const struct gsn_plane *tissue, double cell_um,
                       struct gsn_components **ret_components, uint8_t **ret_thin,
                       struct gsn_error *err)
{
    const size_t count = (size_t)tissue->width * tissue->height;
    gsn_auto_mem(float) value = gsn_alloc(count * sizeof *value);
    gsn_auto_mem(uint8_t) mask = gsn_alloc(count);
    double apart;
    float threshold;
    int r;

    if (!value || !mask)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    clip_density(tissue, value);
    r = clear_bed(value, mask, tissue->width, tissue->height, err);
    if (r < 0)
        return r;
    threshold = (float)find_threshold(value, count, &apart);
    for (size_t i = 0; i < count; i++)
        mask[i] = apart >= TISSUE_LEAST && value[i] >= threshold;
    return gsn_segment_mask(mask, tissue->width, tissue->height,
                            (unsigned)(GSN_PANEL_THREAD_UM / cell_um), ret_components, ret_thin,
                            err);
}

int gsn_segment_is_dust(const struct gsn_component *component, double cell_um)
{
    return (double)component->area * cell_um * cell_um < DUST_UM * DUST_UM;
}

double gsn_segment_section_area(const struct gsn_components *components, double cell_um)
{
    double most = 0, area = 0;

    for (size_t i = 0; i < components->count; i++) {
        const double own = (double)components->component[i].area;
        double sum = 0;
        size_t alike = 0;

        if (gsn_segment_is_dust(&components->component[i], cell_um))
            continue;
        for (size_t k = 0; k < components->count; k++) {
            const double other = (double)components->component[k].area;

            if (other <= GSN_PANEL_SAME_AREA * own && own <= GSN_PANEL_SAME_AREA * other) {
                sum += other;
                alike++;
            }
        }
        if (alike == 1)
            sum *= ALONE;
        if (sum > most) {
            most = sum;
            area = alike == 1 ? own : sum / (double)alike;
        }
    }
    return area;
}

/* ---- where to cut ---------------------------------------------------------------------------- */

/* Lines that are tried: every half cell along the middle half of the way between the centres,
 * turned by up to 45 degrees either way in steps of 3. */
enum { TURNS = 15, MOST_PLACES = 200 };
static const double TURN_RAD = M_PI / 60, PLACES_PER_CELL = 2;

struct shape {
    const struct gsn_component *box;
    uint8_t *cell; /* of the box: 1 inside the component */
};

static int draw_shape(const struct gsn_components *components, size_t component,
                      struct shape *ret_shape, struct gsn_error *err)
{
    const struct gsn_component *box = &components->component[component];
    uint8_t *cell = gsn_alloc_array((size_t)box->width, (size_t)box->height);

    if (!cell)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    for (size_t i = 0; i < box->area; i++) {
        const uint32_t pixel = components->pixel[box->first + i];
        const int x = (int)(pixel % components->width), y = (int)(pixel / components->width);

        cell[(y - box->y) * box->width + x - box->x] = 1;
    }
    *ret_shape = (struct shape){ box, cell };
    return GSN_OK;
}

static int is_inside(const struct shape *shape, struct gsn_point at)
{
    const int x = (int)floor(at.x) - shape->box->x, y = (int)floor(at.y) - shape->box->y;

    return x >= 0 && y >= 0 && x < shape->box->width && y < shape->box->height &&
           shape->cell[y * shape->box->width + x];
}

/* Cells of tissue along a line through at, and its ends in tissue; steps of half a cell. */
static int count_tissue_along(const struct shape *shape, struct gsn_point at, double dx, double dy,
                              struct gsn_point end[2])
{
    const int reach = 2 * (shape->box->width + shape->box->height);
    int count = 0;

    end[0] = end[1] = at;
    for (int i = -reach; i <= reach; i++) {
        const struct gsn_point here = { at.x + 0.5 * i * dx, at.y + 0.5 * i * dy };

        if (!is_inside(shape, here))
            continue;
        end[count > 0] = here;
        count++;
    }
    return count;
}

/* centre: of the two slots, in cells. ret_end: where the line enters and leaves the component; both
 * at one place when it has no tissue there. ret_width: how many cells of tissue the line runs
 * through. Fails with GSN_E_NOMEM. */
static int find_cut(const struct gsn_components *components, size_t component,
                    const struct gsn_point centre[2], struct gsn_point ret_end[2],
                    double *ret_width, struct gsn_error *err)
{
    const double wx = centre[1].x - centre[0].x, wy = centre[1].y - centre[0].y;
    const double way = hypot(wx, wy);
    const int places = (int)fmin(fmax(ceil(0.5 * way * PLACES_PER_CELL), 1), MOST_PLACES);
    struct shape shape = { 0 };
    double least = INFINITY;
    int r;

    assert(component < components->count && way > 0);

    r = draw_shape(components, component, &shape, err);
    if (r < 0)
        return r;
    for (int p = 0; p <= places; p++)
        for (int t = -TURNS; t <= TURNS; t++) {
            const double share = 0.25 + 0.5 * p / places, turn = t * TURN_RAD;
            const struct gsn_point at = { centre[0].x + share * wx, centre[0].y + share * wy };
            const double nx = (-wy * cos(turn) - wx * sin(turn)) / way;
            const double ny = (wx * cos(turn) - wy * sin(turn)) / way;
            struct gsn_point end[2];
            /* Of equally short ones the straightest, nearest to the middle. */
            const int tissue = count_tissue_along(&shape, at, nx, ny, end);
            const double cost = tissue + 0.01 * (fabs(share - 0.5) + 0.1 * fabs(turn));

            if (cost < least) {
                least = cost;
                *ret_width = 0.5 * tissue;
                ret_end[0] = end[0];
                ret_end[1] = end[1];
            }
        }
    gsn_free(shape.cell);
    return GSN_OK;
}

/* ---- sections that grew together ------------------------------------------------------------- */

/* Sections that are taken apart in one component; more are a label or a flood of ink. */
enum { MOST_IN_COMPONENT = 8, ROUNDS = 30 };

/* In areas of a section: components of a torn one, and what they make up together. */
static const double TORN_LEAST = 0.2, TORN_MOST = 0.8, TORN_TOGETHER = 1.25;

/* Sections whose centres are further apart than this, in their size, do not touch. */
static const double REACH = 1.8;

void gsn_panel_regions_free(struct gsn_panel_regions *regions)
{
    if (!regions)
        return;
    gsn_free(regions->region);
    gsn_free(regions);
}

void gsn_part_add(struct gsn_part *sum, const struct gsn_part *part)
{
    if (part->area == 0)
        return;
    if (sum->area == 0) {
        *sum = *part;
        return;
    }
    sum->area += part->area;
    sum->sum_x += part->sum_x;
    sum->sum_y += part->sum_y;
    sum->x0 = part->x0 < sum->x0 ? part->x0 : sum->x0;
    sum->y0 = part->y0 < sum->y0 ? part->y0 : sum->y0;
    sum->x1 = part->x1 > sum->x1 ? part->x1 : sum->x1;
    sum->y1 = part->y1 > sum->y1 ? part->y1 : sum->y1;
}

struct gsn_point gsn_part_centre(const struct gsn_part *part)
{
    const double area = (double)part->area;

    return (struct gsn_point){ part->sum_x / area, part->sum_y / area };
}

double gsn_part_distance(const struct gsn_part *a, const struct gsn_part *b)
{
    const int x = a->x0 > b->x1 ? a->x0 - b->x1 : b->x0 > a->x1 ? b->x0 - a->x1 : 0;
    const int y = a->y0 > b->y1 ? a->y0 - b->y1 : b->y0 > a->y1 ? b->y0 - a->y1 : 0;

    return hypot(x, y);
}

static struct gsn_part part_of_component(const struct gsn_component *component)
{
    return (struct gsn_part){ .area = component->area,
                              .x0 = component->x,
                              .y0 = component->y,
                              .x1 = component->x + component->width,
                              .y1 = component->y + component->height,
                              .sum_x = component->cx * (double)component->area,
                              .sum_y = component->cy * (double)component->area };
}

static void add_cells(struct gsn_part *part, int y, int x0, int x1)
{
    const double length = x1 - x0;
    const struct gsn_part cells = { .area = (size_t)(x1 - x0),
                                    .x0 = x0,
                                    .y0 = y,
                                    .x1 = x1,
                                    .y1 = y + 1,
                                    .sum_x = length * 0.5 * (x0 + x1),
                                    .sum_y = length * (y + 0.5) };

    gsn_part_add(part, &cells);
}

struct line {
    int is;
    struct gsn_point end[2];
    double width;
};

struct cluster {
    const struct gsn_components *components;
    size_t component, count;
    struct gsn_point centre[MOST_IN_COMPONENT];
    struct line line[MOST_IN_COMPONENT][MOST_IN_COMPONENT]; /* of i < k */
};

/* Side of the point against a line: its sign alone counts. */
static double side_of_line(const struct line *line, struct gsn_point at)
{
    return (line->end[1].x - line->end[0].x) * (at.y - line->end[0].y) -
           (line->end[1].y - line->end[0].y) * (at.x - line->end[0].x);
}

/* The nearest centre; between the two nearest the line decides where there is one. */
static size_t find_owner(const struct cluster *c, struct gsn_point at)
{
    size_t first = 0, second = c->count;
    const struct line *line;

    for (size_t i = 1; i < c->count; i++)
        if (gsn_point_distance(at, c->centre[i]) < gsn_point_distance(at, c->centre[first]))
            first = i;
    for (size_t i = 0; i < c->count; i++)
        if (i != first && (second == c->count || gsn_point_distance(at, c->centre[i]) <
                                                     gsn_point_distance(at, c->centre[second])))
            second = i;
    line = first < second ? &c->line[first][second] : &c->line[second][first];
    if (!line->is || side_of_line(line, at) * side_of_line(line, c->centre[first]) >= 0)
        return first;
    return second;
}

static void assign_cells(const struct cluster *c, struct gsn_part part[MOST_IN_COMPONENT])
{
    const struct gsn_component *component = &c->components->component[c->component];

    for (size_t i = 0; i < MOST_IN_COMPONENT; i++)
        part[i] = (struct gsn_part){ 0 };
    for (size_t i = 0; i < component->area; i++) {
        const uint32_t pixel = c->components->pixel[component->first + i];
        const int x = (int)(pixel % c->components->width), y = (int)(pixel / c->components->width);

        add_cells(&part[find_owner(c, (struct gsn_point){ x + 0.5, y + 0.5 })], y, x, x + 1);
    }
}

/* Evenly along the longer axis of the component. */
static void seed_centres(struct cluster *c)
{
    const struct gsn_component *component = &c->components->component[c->component];
    double xx = 0, xy = 0, yy = 0, angle, sd;

    for (size_t i = 0; i < component->area; i++) {
        const uint32_t pixel = c->components->pixel[component->first + i];
        const double dx = pixel % c->components->width + 0.5 - component->cx;
        const double dy = pixel / c->components->width + 0.5 - component->cy;

        xx += dx * dx;
        xy += dx * dy;
        yy += dy * dy;
    }
    angle = 0.5 * atan2(2 * xy, xx - yy);
    sd = sqrt((0.5 * (xx + yy) + hypot(0.5 * (xx - yy), xy)) / (double)component->area);
    for (size_t i = 0; i < c->count; i++) {
        /* A rod of length 2 sqrt(3) sd. */
        const double at = 2 * sqrt(3) * sd * (((double)i + 0.5) / (double)c->count - 0.5);

        c->centre[i] =
            (struct gsn_point){ component->cx + at * cos(angle), component->cy + at * sin(angle) };
    }
}

/* Centres of equal sections: the cells nearest to each, and the mean of those, in turn. */
static void find_centres(struct cluster *c)
{
    struct gsn_part part[MOST_IN_COMPONENT];

    seed_centres(c);
    for (int round = 0; round < ROUNDS; round++) {
        double moved = 0;

        assign_cells(c, part);
        for (size_t i = 0; i < c->count; i++) {
            const struct gsn_point now = part[i].area ? gsn_part_centre(&part[i]) : c->centre[i];

            moved = fmax(moved, gsn_point_distance(now, c->centre[i]));
            c->centre[i] = now;
        }
        if (moved < 0.1)
            break;
    }
}

static int find_lines(struct cluster *c, double size, struct gsn_error *err)
{
    for (size_t i = 0; i < c->count; i++)
        for (size_t k = i + 1; k < c->count; k++) {
            const struct gsn_point pair[2] = { c->centre[i], c->centre[k] };
            struct line *line = &c->line[i][k];
            int r;

            if (!(gsn_point_distance(pair[0], pair[1]) < REACH * size) ||
                !(gsn_point_distance(pair[0], pair[1]) > 0))
                continue;
            r = find_cut(c->components, c->component, pair, line->end, &line->width, err);
            if (r < 0)
                return r;
            line->is = gsn_point_distance(line->end[0], line->end[1]) > 0;
        }
    return GSN_OK;
}

static void note_neck(struct gsn_panel_region *region, size_t beside, const struct line *line)
{
    if (!line->is || line->width < region->neck)
        return;
    region->beside = beside;
    region->neck = line->width;
    region->end[0] = line->end[0];
    region->end[1] = line->end[1];
}

/* Adds the parts of a component that holds count sections. */
static int separate_sections(const struct gsn_components *components, size_t component,
                             size_t count, double size, struct gsn_panel_regions *regions,
                             struct gsn_error *err)
{
    struct cluster c = { .components = components, .component = component, .count = count };
    struct gsn_part part[MOST_IN_COMPONENT];
    const size_t first = regions->count;
    int r;

    find_centres(&c);
    r = find_lines(&c, size, err);
    if (r < 0)
        return r;
    assign_cells(&c, part);
    for (size_t i = 0; i < count; i++) {
        struct gsn_panel_region *region = &regions->region[first + i];

        *region = (struct gsn_panel_region){
            .part = part[i], .component = component, .cut = 1, .beside = first + i
        };
        for (size_t k = 0; k < count; k++)
            if (k != i)
                note_neck(region, first + k, &c.line[i < k ? i : k][i < k ? k : i]);
    }
    regions->count += count;
    return GSN_OK;
}

/* ---- torn sections, and all of it
 * ------------------------------------------------------------- */

static int is_torn(const struct gsn_panel_region *region, double area)
{
    const double share = (double)region->part.area / area;

    return !region->cut && share >= TORN_LEAST && share <= TORN_MOST;
}

/* Takes halves of one section together, the nearest first. */
static void join_torn(struct gsn_panel_regions *regions, double area, double near)
{
    for (size_t i = 0; i < regions->count; i++) {
        struct gsn_panel_region *own = &regions->region[i];
        double least = near;
        size_t best = i;

        for (size_t k = i + 1; is_torn(own, area) && k < regions->count; k++) {
            const struct gsn_panel_region *other = &regions->region[k];
            const double apart = gsn_part_distance(&own->part, &other->part);

            if (is_torn(other, area) && apart < least &&
                (double)(own->part.area + other->part.area) <= TORN_TOGETHER * area) {
                least = apart;
                best = k;
            }
        }
        if (best == i)
            continue;
        gsn_part_add(&own->part, &regions->region[best].part);
        regions->region[best].part = (struct gsn_part){ 0 };
    }
}

static size_t count_sections(const struct gsn_component *component, double area, double most)
{
    const double share = (double)component->area / area;

    if (share <= most)
        return 1;
    return (size_t)fmin(fmax(round(share), 2), MOST_IN_COMPONENT);
}

int gsn_segment_regions(const struct gsn_components *components, double area, double most,
                        double near, struct gsn_panel_regions **ret_units, struct gsn_error *err)
{
    gsn_auto(gsn_panel_regions) regions = gsn_alloc_array(1, sizeof *regions);
    size_t room = 0;

    assert(components && area > 0 && ret_units);

    for (size_t i = 0; i < components->count; i++)
        room += count_sections(&components->component[i], area, most);
    if (regions)
        regions->region = gsn_alloc_array(room, sizeof *regions->region);
    if (!regions || !regions->region)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the components of a panel");
    for (size_t i = 0; i < components->count; i++) {
        const size_t count = count_sections(&components->component[i], area, most);
        int r = GSN_OK;

        if (count > 1)
            r = separate_sections(components, i, count, sqrt(area), regions, err);
        else
            regions->region[regions->count++] =
                (struct gsn_panel_region){ .part = part_of_component(&components->component[i]),
                                           .component = i };
        if (r < 0)
            return r;
    }
    join_torn(regions, area, near);
    *ret_units = gsn_steal(&regions);
    return GSN_OK;
}
