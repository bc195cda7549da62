/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Outlines drawn on some sections, made a region of the block by shape-based interpolation.
 *
 * References: RFC 7946 (GeoJSON); QuPath writes a geometry's place in a stack as "plane", and
 * leaves it out for the first plane. Raya and Udupa (1990, 10.1109/42.52980) and Herman, Zheng and
 * Bucholtz (1992, 10.1109/38.135915): between two outlines lies what is inside by the signed
 * distances to both, interpolated linearly.
 *
 * 1. The features of a FeatureCollection, of a list, a single one, or a bare geometry; of one
 *    classification, which the job names where the file has several. Selections of ImageJ come as
 *    such a collection (imagej_roi.c).
 * 2. Each polygon is checked: rings of four points or more that are closed, within the picture,
 *    and do not cross; its holes lie in it. Its pixels are those whose centres are inside. Polygons
 *    of a plane are joined.
 * 3. Each plane between two drawn ones is interpolated. Before the first and behind the last one
 *    there is nothing: nobody drew there.
 *
 * All that is wrong fails with GSN_E_INPUT: nothing that was drawn is left out without a word.
 * Rings are filled here and not by cv::fillPoly, which sets the pixels that an outline touches too:
 * half a pixel more all around.
 *
 * Costs two distance transforms a drawn plane, and a pass over a ring's points for each of its
 * rows. */
#include "pipeline/specimen/drawn_region.h"

#include "pipeline/core/geom.h"
#include "pipeline/core/mem.h"
#include "pipeline/imaging/morphology.h"
#include "pipeline/specimen/imagej_roi.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* A crossing is looked for among all pairs of edges that share rows. */
enum { MOST_POINTS = 100000, CLASS_ROOM = 120 };

/* QuPath rounds points to a hundredth of a pixel: edges that touched may cross by so much. */
static const double ROUNDING_PX = 0.02;

struct drawing {
    const struct gsn_region *region;
    const json_t *features; /* an array; NULL: one feature or geometry, which is root */
    const json_t *root;
    struct gsn_mask *mask;
    uint8_t *is_drawn; /* a plane */
    uint8_t *scratch;  /* of a plane's size, 0 between polygons */
    size_t points;     /* read so far */
};

/* ---- features ------------------------------------------------------------------------------ */

static size_t count_features(const struct drawing *d)
{
    return d->features ? json_array_size(d->features) : 1;
}

static const json_t *get_feature(const struct drawing *d, size_t i)
{
    return d->features ? json_array_get(d->features, i) : d->root;
}

static const char *get_type(const json_t *object)
{
    const char *type = json_string_value(json_object_get(object, "type"));

    return type ? type : "";
}

static const json_t *get_geometry(const json_t *feature)
{
    return strcmp(get_type(feature), "Feature") == 0 ? json_object_get(feature, "geometry")
                                                     : feature;
}

/* As QuPath shows it; "" for none. */
static void read_class(const json_t *feature, char ret_class[CLASS_ROOM])
{
    const json_t *properties = json_object_get(feature, "properties");
    const json_t *stated = json_object_get(properties, "classification");
    const json_t *names = json_object_get(stated, "names");
    const char *name =
        json_string_value(json_is_string(stated) ? stated : json_object_get(stated, "name"));
    size_t used = 0;

    (void)snprintf(ret_class, CLASS_ROOM, "%s", name ? name : "");
    for (size_t i = 0; !name && i < json_array_size(names) && used < CLASS_ROOM; i++) {
        const char *part = json_string_value(json_array_get(names, i));

        used += (size_t)snprintf(ret_class + used, CLASS_ROOM - used, "%s%s", i ? ": " : "",
                                 part ? part : "");
    }
}

static int is_chosen(const struct drawing *d, size_t i)
{
    char name[CLASS_ROOM];

    read_class(get_feature(d, i), name);
    return !d->region->class_name || strcmp(name, d->region->class_name) == 0;
}

/* That something is drawn, of one classification. */
static int check_classes(const struct drawing *d, struct gsn_error *err)
{
    char first[CLASS_ROOM], other[CLASS_ROOM];
    const char *file = d->region->file;
    size_t chosen = 0;

    if (count_features(d) == 0)
        return gsn_fail(err, GSN_E_INPUT, "%s: no region is drawn in it: it has no feature", file);
    read_class(get_feature(d, 0), first);
    for (size_t i = 0; i < count_features(d); i++) {
        chosen += (size_t)is_chosen(d, i);
        read_class(get_feature(d, i), other);
        if (!d->region->class_name && strcmp(first, other) != 0)
            return gsn_fail(err, GSN_E_INPUT,
                            "%s: its features are of the classifications \"%s\" and \"%s\"%s: say "
                            "which is the region, in job.json as \"class\": \"%s\"",
                            file, first, other, first[0] && other[0] ? "" : " (that is: of none)",
                            first[0] ? first : other);
    }
    if (chosen == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: no feature is of the classification \"%s\"; the first is of \"%s\"",
                        file, d->region->class_name, first);
    return GSN_OK;
}

/* A collection, a list, a feature or a geometry. */
static int find_features(struct drawing *d, struct gsn_error *err)
{
    d->features = json_is_array(d->root) ? d->root : json_object_get(d->root, "features");
    if (!d->features && get_type(d->root)[0] && strcmp(get_type(d->root), "FeatureCollection") != 0)
        return check_classes(d, err);
    if (!json_is_array(d->features))
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: it is not GeoJSON: neither a feature nor a list of features. The "
                        "menu File of QuPath exports objects as GeoJSON",
                        d->region->file);
    return check_classes(d, err);
}

/* ---- planes -------------------------------------------------------------------------------- */

static int has_plane(const struct drawing *d)
{
    int has = 0;

    for (size_t i = 0; i < count_features(d); i++)
        has |= json_object_get(get_geometry(get_feature(d, i)), "plane") != NULL;
    return has;
}

/* Where no feature has a plane, nobody knows on which section of many it lies. */
static int check_planes(const struct drawing *d, struct gsn_error *err)
{
    if (d->region->stack.nz == 1 || has_plane(d))
        return GSN_OK;
    return gsn_fail(err, GSN_E_INPUT,
                    "%s: no feature has a plane, and the stack has %zu: nobody knows on which it "
                    "was drawn. Draw on the exported stack itself; for one in the first section "
                    "only write \"plane\": {\"c\": -1, \"z\": 0, \"t\": 0} into its geometry",
                    d->region->file, d->region->stack.nz);
}

/* Without one it is the first, where another feature has one. */
static int read_plane(const struct drawing *d, size_t number, size_t *ret_plane,
                      struct gsn_error *err)
{
    const json_t *plane = json_object_get(get_geometry(get_feature(d, number)), "plane");
    const json_t *z = json_object_get(plane, "z"), *t = json_object_get(plane, "t");

    *ret_plane = 0;
    if (!plane)
        return GSN_OK;
    if (!json_is_integer(z) || json_integer_value(z) < 0 ||
        json_integer_value(z) >= (json_int_t)d->region->stack.nz || json_number_value(t) > 0) {
        char said[40] = "nothing";

        if (json_is_number(z))
            (void)snprintf(said, sizeof said, "%g", json_number_value(z));
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: feature %zu lies on a plane that the stack does not have: z is %s, "
                        "and \"size\" states %zu planes, from 0, at one time. Was it drawn on "
                        "another export?",
                        d->region->file, number + 1, said, d->region->stack.nz);
    }
    *ret_plane = (size_t)json_integer_value(z);
    return GSN_OK;
}

/* ---- rings --------------------------------------------------------------------------------- */

struct ring {
    size_t count;
    struct gsn_point *point; /* the last is the first */
};

static int read_point(const struct drawing *d, size_t number, const json_t *pair,
                      struct gsn_point *ret_point, struct gsn_error *err)
{
    const json_t *x = json_array_get(pair, 0), *y = json_array_get(pair, 1);
    const struct gsn_lattice *at = &d->region->stack;

    if (json_array_size(pair) != 2 || !json_is_number(x) || !json_is_number(y))
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: feature %zu: a point of an outline is not a pair of numbers",
                        d->region->file, number + 1);
    *ret_point = (struct gsn_point){ json_number_value(x), json_number_value(y) };
    if (!(ret_point->x >= 0 && ret_point->x <= (double)at->nx && ret_point->y >= 0 &&
          ret_point->y <= (double)at->ny))
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: feature %zu lies outside of the picture: the point (%g, %g) in one of "
                        "%zu x %zu pixels. Was it drawn on another export, or in micrometres?",
                        d->region->file, number + 1, ret_point->x, ret_point->y, at->nx, at->ny);
    return GSN_OK;
}

/* gives: ring->point, also when it fails. */
static int read_ring(struct drawing *d, size_t number, const json_t *points, struct ring *ring,
                     struct gsn_error *err)
{
    const size_t count = json_array_size(points);
    int r = GSN_OK;

    if (count < 4)
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: feature %zu is empty: an outline has %zu points, and a closed one has "
                        "four at least",
                        d->region->file, number + 1, count);
    d->points += count;
    if (d->points > MOST_POINTS)
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: its outlines have more than %d points: simplify them (in QuPath "
                        "Objects, Annotations, Simplify shape)",
                        d->region->file, MOST_POINTS);
    ring->point = gsn_alloc_array(count, sizeof *ring->point);
    if (!ring->point)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for an outline");
    ring->count = count;
    for (size_t i = 0; r >= 0 && i < count; i++)
        r = read_point(d, number, json_array_get(points, i), &ring->point[i], err);
    if (r >= 0 && (ring->point[0].x != ring->point[count - 1].x ||
                   ring->point[0].y != ring->point[count - 1].y))
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: feature %zu is not closed: an outline begins at (%g, %g) and ends at "
                        "(%g, %g); its last point is to be its first one again",
                        d->region->file, number + 1, ring->point[0].x, ring->point[0].y,
                        ring->point[count - 1].x, ring->point[count - 1].y);
    return r;
}

struct edge {
    struct gsn_point a, b;
    double low, high; /* y */
    size_t index;
};

static int compare_edges(const void *a, const void *b)
{
    const struct edge *p = a, *q = b;

    if (p->low != q->low)
        return p->low < q->low ? -1 : 1;
    return p->index < q->index ? -1 : p->index > q->index;
}

/* How far p lies to one side of the line through an edge, in pixels; 0 for an edge without length.
 */
static double measure_side(const struct edge *e, struct gsn_point p)
{
    const double x = e->b.x - e->a.x, y = e->b.y - e->a.y, length = hypot(x, y);

    return length > 0 ? (x * (p.y - e->a.y) - y * (p.x - e->a.x)) / length : 0;
}

/* Whether both ends of each lie on different sides of the other, by more than rounding. */
static int edges_cross(const struct edge *e, const struct edge *f)
{
    const double a = measure_side(e, f->a), b = measure_side(e, f->b);
    const double c = measure_side(f, e->a), d = measure_side(f, e->b);

    return fmin(fabs(a), fabs(b)) > ROUNDING_PX && fmin(fabs(c), fabs(d)) > ROUNDING_PX &&
           (a > 0) != (b > 0) && (c > 0) != (d > 0);
}

/* No edge of a polygon crosses another: sorted by their upper ends, each is compared with those
 * that begin before it ends. */
static int check_crossings(const struct drawing *d, size_t number, const struct ring *rings,
                           size_t count, struct gsn_error *err)
{
    gsn_auto_mem(struct edge) edge = NULL;
    size_t edges = 0;

    for (size_t k = 0; k < count; k++)
        edges += rings[k].count;
    edge = gsn_alloc_array(edges, sizeof *edge);
    if (!edge)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the edges of an outline");
    edges = 0;
    for (size_t k = 0; k < count; k++)
        for (size_t i = 0; i + 1 < rings[k].count; i++, edges++) {
            const struct gsn_point a = rings[k].point[i], b = rings[k].point[i + 1];

            edge[edges] = (struct edge){ a, b, fmin(a.y, b.y), fmax(a.y, b.y), edges };
        }
    qsort(edge, edges, sizeof *edge, compare_edges);
    for (size_t i = 0; i < edges; i++)
        for (size_t k = i + 1; k < edges && edge[k].low <= edge[i].high; k++)
            if (edges_cross(&edge[i], &edge[k]))
                return gsn_fail(err, GSN_E_INPUT,
                                "%s: feature %zu crosses itself, between (%g, %g) and (%g, %g): "
                                "what is inside is not clear. Draw it again there",
                                d->region->file, number + 1, edge[i].a.x, edge[i].a.y, edge[i].b.x,
                                edge[i].b.y);
    return GSN_OK;
}

static int compare_numbers(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

/* Sets to value what pixels have their centres in the ring, by the crossings of each row's middle;
 * tells how many were not so before. at: of as many crossings as the ring has points. */
static size_t fill_ring(const struct ring *ring, double *at, const struct gsn_lattice *lattice,
                        uint8_t value, uint8_t *plane)
{
    size_t changed = 0;

    for (size_t y = 0; y < lattice->ny; y++) {
        const double middle = (double)y + 0.5;
        size_t crossings = 0;

        for (size_t i = 0; i + 1 < ring->count; i++) {
            const struct gsn_point a = ring->point[i], b = ring->point[i + 1];

            if ((a.y <= middle) != (b.y <= middle))
                at[crossings++] = a.x + (b.x - a.x) * (middle - a.y) / (b.y - a.y);
        }
        qsort(at, crossings, sizeof *at, compare_numbers);
        for (size_t k = 0; k + 1 < crossings; k += 2)
            for (double x = fmax(ceil(at[k] - 0.5), 0); x + 0.5 < at[k + 1]; x++) {
                uint8_t *pixel = &plane[y * lattice->nx + (size_t)x];

                changed += *pixel != value;
                *pixel = value;
            }
    }
    return changed;
}

/* ---- polygons ------------------------------------------------------------------------------ */

struct rings {
    size_t count;
    struct ring *ring;
};

static void rings_done(struct rings *rings)
{
    for (size_t i = 0; i < rings->count; i++)
        gsn_free(rings->ring[i].point);
    gsn_free(rings->ring);
}

/* Joins a polygon whose rings are sound to what is drawn on the plane. */
static int add_polygon(struct drawing *d, size_t number, size_t plane, const struct rings *rings,
                       struct gsn_error *err)
{
    const struct gsn_lattice *at = &d->region->stack;
    const size_t size = at->nx * at->ny;
    gsn_auto_mem(double) crossing = NULL;
    size_t longest = 0, held = 0;

    for (size_t k = 0; k < rings->count; k++)
        longest = rings->ring[k].count > longest ? rings->ring[k].count : longest;
    crossing = gsn_alloc_array(longest, sizeof *crossing);
    if (!crossing)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the rows of an outline");
    memset(d->scratch, 0, size);
    held = fill_ring(&rings->ring[0], crossing, at, 1, d->scratch);
    for (size_t k = 1; held > 0 && k < rings->count; k++) {
        const size_t taken = fill_ring(&rings->ring[k], crossing, at, 0, d->scratch);

        if (taken == 0)
            return gsn_fail(err, GSN_E_INPUT,
                            "%s: feature %zu: its hole at (%g, %g) takes no pixel from it: it is "
                            "outside, or smaller than a pixel. Take it away",
                            d->region->file, number + 1, rings->ring[k].point[0].x,
                            rings->ring[k].point[0].y);
        held -= taken;
    }
    if (held == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: feature %zu is empty: its outline at (%g, %g) holds the centre of no "
                        "pixel. Take it away",
                        d->region->file, number + 1, rings->ring[0].point[0].x,
                        rings->ring[0].point[0].y);
    for (size_t i = 0; i < size; i++)
        d->mask->inside[plane * size + i] |= d->scratch[i];
    d->is_drawn[plane] = 1;
    return GSN_OK;
}

static int draw_polygon(struct drawing *d, size_t number, size_t plane, const json_t *outlines,
                        struct gsn_error *err)
{
    struct rings rings __attribute__((cleanup(rings_done))) = { 0 };
    const size_t count = json_array_size(outlines);
    int r = GSN_OK;

    if (count == 0)
        return gsn_fail(err, GSN_E_INPUT, "%s: feature %zu is empty: a polygon without an outline",
                        d->region->file, number + 1);
    rings.ring = gsn_alloc_array(count, sizeof *rings.ring);
    if (!rings.ring)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for outlines");
    for (; r >= 0 && rings.count < count; rings.count++)
        r = read_ring(d, number, json_array_get(outlines, rings.count), &rings.ring[rings.count],
                      err);
    if (r >= 0)
        r = check_crossings(d, number, rings.ring, rings.count, err);
    return r < 0 ? r : add_polygon(d, number, plane, &rings, err);
}

static int draw_feature(struct drawing *d, size_t number, struct gsn_error *err)
{
    const json_t *geometry = get_geometry(get_feature(d, number));
    const json_t *coordinates = json_object_get(geometry, "coordinates");
    const char *type = get_type(geometry);
    size_t plane;
    int r = read_plane(d, number, &plane, err);

    if (r < 0)
        return r;
    if (strcmp(type, "Polygon") == 0)
        return draw_polygon(d, number, plane, coordinates, err);
    if (strcmp(type, "MultiPolygon") != 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: feature %zu is a \"%.40s\", which has no area: a region is made of "
                        "Polygon and MultiPolygon. Take it away, or give the region a "
                        "classification of its own",
                        d->region->file, number + 1, type);
    if (json_array_size(coordinates) == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: feature %zu is empty: a MultiPolygon without a polygon",
                        d->region->file, number + 1);
    for (size_t i = 0; r >= 0 && i < json_array_size(coordinates); i++)
        r = draw_polygon(d, number, plane, json_array_get(coordinates, i), err);
    return r;
}

/* ---- between drawn planes ------------------------------------------------------------------ */

/* Fills the planes between two drawn ones. near, far: signed distances to their outlines. */
static int interpolate_shapes(const struct drawing *d, size_t first, size_t last, const float *near,
                              const float *far, struct gsn_error *err)
{
    const size_t size = d->region->stack.nx * d->region->stack.ny;

    for (size_t z = first + 1; z < last; z++) {
        const float share = (float)(z - first) / (float)(last - first);
        uint8_t *plane = d->mask->inside + z * size;
        size_t held = 0;

        for (size_t i = 0; i < size; i++) {
            plane[i] = (1 - share) * near[i] + share * far[i] > 0;
            held += plane[i];
        }
        if (held == 0)
            return gsn_fail(err, GSN_E_INPUT,
                            "%s: the outlines of plane %zu and %zu do not overlap enough: nothing "
                            "is left of them on plane %zu between (planes from 0). Draw one there",
                            d->region->file, first, last, z);
    }
    return GSN_OK;
}

static int fill_between(const struct drawing *d, struct gsn_error *err)
{
    const struct gsn_lattice *at = &d->region->stack;
    const size_t size = at->nx * at->ny;
    gsn_auto_mem(float) distances = gsn_alloc_array(2 * size, sizeof *distances);
    float *near = distances, *far = distances + size;
    size_t last = SIZE_MAX;
    int r = GSN_OK;

    if (!distances)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the distances to outlines");
    for (size_t z = 0; r >= 0 && z < at->nz; z++) {
        float *kept = near;

        if (!d->is_drawn[z])
            continue;
        near = far;
        far = kept;
        r = gsn_signed_distance(d->mask->inside + z * size, (uint32_t)at->nx, (uint32_t)at->ny, far,
                                err);
        if (r >= 0 && last != SIZE_MAX)
            r = interpolate_shapes(d, last, z, near, far, err);
        last = z;
    }
    return r;
}

static void describe_drawing(const struct drawing *d, char ret_sentence[GSN_DRAWN_SENTENCE])
{
    const struct gsn_lattice *at = &d->region->stack;
    size_t count = 0, first = 0, last = 0;

    for (size_t z = 0; z < at->nz; z++)
        if (d->is_drawn[z]) {
            first = count == 0 ? z : first;
            last = z;
            count++;
        }
    (void)snprintf(
        ret_sentence, GSN_DRAWN_SENTENCE,
        "drawn on %zu of %zu planes, from z %g to %g um; interpolated on the %zu between; "
        "the %zu before the first and the %zu behind the last drawn one are not in the "
        "region",
        count, at->nz, at->origin_um.z + (double)first * at->step_um.z,
        at->origin_um.z + (double)last * at->step_um.z, last - first + 1 - count, first,
        at->nz - 1 - last);
}

/* ---- from text to mask --------------------------------------------------------------------- */

static int draw_all(struct drawing *d, struct gsn_error *err)
{
    int r = find_features(d, err);

    if (r >= 0)
        r = check_planes(d, err);
    for (size_t i = 0; r >= 0 && i < count_features(d); i++)
        if (is_chosen(d, i))
            r = draw_feature(d, i, err);
    return r < 0 ? r : fill_between(d, err);
}

int gsn_drawn_region_read(const struct gsn_region *region, const char *text, size_t size,
                          struct gsn_mask **ret_mask, char ret_sentence[GSN_DRAWN_SENTENCE],
                          struct gsn_error *err)
{
    const struct gsn_lattice *at = &region->stack;
    gsn_auto(gsn_mask) mask = NULL;
    gsn_auto_mem(uint8_t) planes = gsn_alloc_array(at->nx * at->ny + at->nz, 1);
    struct drawing d = { .region = region, .scratch = planes };
    json_error_t where;
    json_t *root = NULL;
    int r = planes ? gsn_mask_new(at, &mask, err)
                   : gsn_fail(err, GSN_E_NOMEM, "out of memory for a drawn region");

    if (r < 0)
        return r;
    d.is_drawn = planes + at->nx * at->ny;
    d.mask = mask;
    if (gsn_imagej_roi_is(text, size)) {
        r = gsn_imagej_roi_read(region->file, text, size, at->nz, &root, err);
    } else {
        root = json_loadb(text, size, 0, &where);
        if (!root)
            r = gsn_fail(
                err, GSN_E_INPUT,
                "%s: line %d: %s: it is not GeoJSON, which the menu File of QuPath exports, "
                "nor a .roi or RoiSet.zip of ImageJ",
                region->file, where.line, where.text);
    }
    d.root = root;
    if (r >= 0)
        r = draw_all(&d, err);
    json_decref(root);
    if (r < 0)
        return r;
    describe_drawing(&d, ret_sentence);
    *ret_mask = gsn_steal(&mask);
    return GSN_OK;
}
