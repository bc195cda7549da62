/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Selections of ImageJ made features of GeoJSON, so that all that is asked of outlines is asked in
 * one place (drawn_region.c).
 *
 * Reference: ij/io/RoiDecoder.java and ij/gui/ShapeRoi.java of ImageJ 1.54, which are the format's
 * only description. Numbers are big-endian. The archive is read by libzip, which checks each
 * entry's CRC.
 *
 * 1. An archive's entries that end in .roi, in their order, each no larger than MOST_BYTES;
 * anything else in it is refused. Or the one selection that the file is.
 * 2. The slice is the Z of the second header (hyperstacks) or the position of the first, from 1.
 * 3. Polygons, freehand and traced outlines are taken as they are, with fractions of pixels where
 * they have them; rectangles, ovals, ellipses and rotated rectangles by their parameters; the
 * shapes of a combined selection by the rule even-odd: an outline that lies in an even number of
 * others is a border, in an odd number a hole of the smallest one around it. Curves become chords
 * of a pixel at most, which lie 1 / (8 radius) of a pixel inside of them.
 * 4. Lines, angles, points, texts and pictures become features of a type without an area, so that
 * they are refused by their name.
 *
 * How it fails: GSN_E_INPUT for what is no selection, ends too early, says no slice though there
 * are several, or is not what was drawn (fitted splines, rounded corners, which only ImageJ can
 * draw). Costs a pass over the points; combined selections the square of their outlines. */
#include "pipeline/specimen/imagej_roi.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <zip.h>

#include "pipeline/core/geom.h"
#include "pipeline/core/mem.h"

/* Of an entry; of an archive; of a selection; of a combined one; of a curve. */
enum {
    MOST_BYTES = 8 << 20,
    MOST_ENTRIES = 10000,
    MOST_POINTS = 100000,
    MOST_RINGS = 1000,
    MOST_CHORDS = 4096
};

/* Offsets. */
enum {
    VERSION = 4,
    TYPE = 6,
    TOP = 8,
    LEFT = 10,
    BOTTOM = 12,
    RIGHT = 14,
    COUNT = 16,
    EXACT = 18, /* two points, as floats; or the count as an int */
    SHAPE = 36,
    SUBTYPE = 48,
    OPTIONS = 50,
    RATIO = 52,
    ARC = 54,
    POSITION = 56,
    SECOND = 60,
    HEADER = 64,
    SECOND_Z = 8, /* of the second header */
    SECOND_T = 12,
    SECOND_GROUP = 30,
    SECOND_SIZE = 36,
};

enum {
    POLYGON,
    RECTANGLE,
    OVAL,
    LINE,
    FREE_LINE,
    POLYLINE,
    NOTHING,
    FREEHAND,
    TRACED,
    ANGLE,
    POINT
};
enum { IS_TEXT = 1, IS_ELLIPSE = 3, IS_PICTURE = 4, IS_ROTATED = 5 };
enum { BY_SPLINE = 1, WITH_FRACTIONS = 128 };

struct roi {
    const char *file;
    size_t number; /* from 1 */
    const uint8_t *bytes;
    size_t size;
    struct gsn_point *point; /* owned; of all rings */
    size_t points;
    size_t *first; /* owned; of each ring, and one behind the last */
    size_t rings;
};

static void roi_done(struct roi *roi)
{
    gsn_free(roi->point);
    gsn_free(roi->first);
}

#define fail_roi(roi, err, format, ...)                                                            \
    gsn_fail(err, GSN_E_INPUT, "%s: feature %zu " format, (roi)->file, (roi)->number, ##__VA_ARGS__)

/* ---- numbers ------------------------------------------------------------------------------- */

static uint32_t read_word(const struct roi *roi, size_t at)
{
    const uint8_t *const b = roi->bytes + at;

    return (uint32_t)b[0] << 24 | (uint32_t)b[1] << 16 | (uint32_t)b[2] << 8 | b[3];
}

static unsigned read_half(const struct roi *roi, size_t at)
{
    return (unsigned)roi->bytes[at] << 8 | roi->bytes[at + 1];
}

/* As ImageJ does: what is below -5000 is a large number without a sign. */
static double read_pixel(const struct roi *roi, size_t at)
{
    const unsigned half = read_half(roi, at);

    return half > UINT16_MAX - 5000 ? (double)half - (UINT16_MAX + 1) : (double)half;
}

static double read_float(const struct roi *roi, size_t at)
{
    const uint32_t word = read_word(roi, at);
    float value;

    memcpy(&value, &word, sizeof value);
    return (double)value;
}

/* ---- outlines ------------------------------------------------------------------------------ */

static int begin_ring(struct roi *roi, struct gsn_error *err)
{
    size_t *more;

    if (roi->rings == MOST_RINGS)
        return fail_roi(roi, err,
                        "has more than %d outlines: split it, or smooth what it was made from",
                        MOST_RINGS);
    more = gsn_realloc_array(roi->first, roi->rings + 2, sizeof *more);
    if (!more)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for outlines");
    roi->first = more;
    roi->first[roi->rings++] = roi->points;
    roi->first[roi->rings] = roi->points;
    return GSN_OK;
}

/* To the ring begun last. */
static int add_point(struct roi *roi, double x, double y, struct gsn_error *err)
{
    if (!isfinite(x) || !isfinite(y))
        return fail_roi(roi, err, "is damaged: a point of its outline is no number");
    if (roi->points == MOST_POINTS)
        return fail_roi(roi, err, "has more than %d points: simplify it", MOST_POINTS);
    if (roi->points % 256 == 0) {
        struct gsn_point *more = gsn_realloc_array(roi->point, roi->points + 256, sizeof *more);

        if (!more)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for an outline");
        roi->point = more;
    }
    roi->point[roi->points++] = (struct gsn_point){ x, y };
    roi->first[roi->rings] = roi->points;
    return GSN_OK;
}

static int count_chords(double length)
{
    return length < 8 ? 8 : length < MOST_CHORDS ? (int)ceil(length) : MOST_CHORDS;
}

/* centre, half axes, and the direction of the first in radians. */
static int add_oval(struct roi *roi, struct gsn_point centre, double a, double b, double turn,
                    struct gsn_error *err)
{
    const int chords = count_chords(2 * M_PI * fmax(fabs(a), fabs(b)));
    int r = begin_ring(roi, err);

    for (int i = 0; r >= 0 && i < chords; i++) {
        const double at = 2 * M_PI * i / chords, x = a * cos(at), y = b * sin(at);

        r = add_point(roi, centre.x + x * cos(turn) - y * sin(turn),
                      centre.y + x * sin(turn) + y * cos(turn), err);
    }
    return r;
}

static int add_box(struct roi *roi, double x, double y, double width, double height,
                   struct gsn_error *err)
{
    const double corner[4][2] = {
        { x, y }, { x + width, y }, { x + width, y + height }, { x, y + height }
    };
    int r = begin_ring(roi, err);

    for (int i = 0; r >= 0 && i < 4; i++)
        r = add_point(roi, corner[i][0], corner[i][1], err);
    return r;
}

/* A rectangle or an oval in one. Where it has fractions of pixels ImageJ shows them, but fills and
 * measures whole ones. */
static int add_bounds(struct roi *roi, int type, struct gsn_error *err)
{
    const double x = read_pixel(roi, LEFT), y = read_pixel(roi, TOP);
    const double width = read_pixel(roi, RIGHT) - x, height = read_pixel(roi, BOTTOM) - y;

    if (type == OVAL)
        return add_oval(roi, (struct gsn_point){ x + width / 2, y + height / 2 }, width / 2,
                        height / 2, 0, err);
    if (read_pixel(roi, ARC) > 0)
        return fail_roi(roi, err, "is a rectangle with rounded corners: draw it as an outline");
    return add_box(roi, x, y, width, height, err);
}

/* An ellipse by the ends of its long axis and its ratio; a rotated rectangle by the ends of its
 * middle line and its width. */
static int add_turned(struct roi *roi, unsigned subtype, struct gsn_error *err)
{
    const double x1 = read_float(roi, EXACT), y1 = read_float(roi, EXACT + 4);
    const double x2 = read_float(roi, EXACT + 8), y2 = read_float(roi, EXACT + 12);
    const double length = hypot(x2 - x1, y2 - y1), parameter = read_float(roi, RATIO);
    const double across_x = length > 0 ? (y1 - y2) / length * parameter / 2 : 0;
    const double across_y = length > 0 ? (x2 - x1) / length * parameter / 2 : 0;
    const double corner[4][2] = { { x1 - across_x, y1 - across_y },
                                  { x2 - across_x, y2 - across_y },
                                  { x2 + across_x, y2 + across_y },
                                  { x1 + across_x, y1 + across_y } };
    int r;

    if (subtype == IS_ELLIPSE)
        return add_oval(roi, (struct gsn_point){ (x1 + x2) / 2, (y1 + y2) / 2 }, length / 2,
                        parameter * length / 2, atan2(y2 - y1, x2 - x1), err);
    r = begin_ring(roi, err);
    for (int i = 0; r >= 0 && i < 4; i++)
        r = add_point(roi, corner[i][0], corner[i][1], err);
    return r;
}

static int add_vertices(struct roi *roi, int with_fractions, struct gsn_error *err)
{
    const double left = read_pixel(roi, LEFT), top = read_pixel(roi, TOP);
    const size_t said = read_half(roi, COUNT), n = said ? said : read_word(roi, EXACT);
    const size_t each = with_fractions ? 12 : 4;
    const size_t exact = HEADER + 4 * n;
    int r;

    if (n > MOST_POINTS || n * each > roi->size - HEADER)
        return fail_roi(roi, err, "is damaged: it ends before its %zu points do", n);
    r = begin_ring(roi, err);
    for (size_t i = 0; r >= 0 && i < n; i++) {
        if (with_fractions)
            r = add_point(roi, read_float(roi, exact + 4 * i), read_float(roi, exact + 4 * (n + i)),
                          err);
        else
            r = add_point(roi, left + fmax(read_pixel(roi, HEADER + 2 * i), 0),
                          top + fmax(read_pixel(roi, HEADER + 2 * (n + i)), 0), err);
    }
    return r;
}

/* ---- combined selections ------------------------------------------------------------------- */

/* From the ring's last point along a curve of Bezier of that degree. */
static int add_curve(struct roi *roi, const double *control, int degree, struct gsn_error *err)
{
    const struct gsn_point from = roi->point[roi->points - 1];
    double px[4] = { from.x }, py[4] = { from.y }, length = 0;
    int chords, r = GSN_OK;

    for (int k = 1; k <= degree; k++) {
        px[k] = control[2 * (k - 1)];
        py[k] = control[2 * (k - 1) + 1];
        length += hypot(px[k] - px[k - 1], py[k] - py[k - 1]);
    }
    if (!isfinite(length))
        return fail_roi(roi, err, "is damaged: a point of its outline is no number");
    chords = count_chords(length);
    for (int i = 1; r >= 0 && i <= chords; i++) {
        const double t = (double)i / chords;
        double x[4], y[4];

        memcpy(x, px, sizeof x);
        memcpy(y, py, sizeof y);
        for (int level = degree; level > 0; level--)
            for (int k = 0; k < level; k++) {
                x[k] += t * (x[k + 1] - x[k]);
                y[k] += t * (y[k + 1] - y[k]);
            }
        r = add_point(roi, x[0], y[0], err);
    }
    return r;
}

/* Segments: to begin (0), a line (1), curves of degree two (2) and three (3), back to the begin
 * (4), each followed by its points. */
static int add_shapes(struct roi *roi, struct gsn_error *err)
{
    static const size_t numbers[] = { 2, 2, 4, 6, 0 };
    const size_t n = read_word(roi, SHAPE);
    int open = 0, r = GSN_OK;

    if (n > (roi->size - HEADER) / 4)
        return fail_roi(roi, err, "is damaged: it ends before its shape does");
    for (size_t i = 0; r >= 0 && i < n;) {
        const double what = read_float(roi, HEADER + 4 * i);
        const size_t kind = what >= 0 && what <= 4 ? (size_t)what : 5;
        double given[6] = { 0 };

        if (kind == 5 || (double)kind != what || i + 1 + numbers[kind] > n || (kind > 0 && !open))
            return fail_roi(roi, err, "is damaged: number %zu of its shape is %g", i, what);
        for (size_t k = 0; k < numbers[kind]; k++)
            given[k] = read_float(roi, HEADER + 4 * (i + 1 + k));
        i += 1 + numbers[kind];
        open = kind < 4;
        if (kind == 0)
            r = begin_ring(roi, err);
        if (r >= 0 && kind < 2)
            r = add_point(roi, given[0], given[1], err);
        else if (r >= 0 && kind < 4)
            r = add_curve(roi, given, (int)kind, err);
    }
    return r;
}

static size_t count_points(const struct roi *roi, size_t ring)
{
    return roi->first[ring + 1] - roi->first[ring];
}

/* By crossings of a ray to the right. */
static int holds_point(const struct roi *roi, size_t ring, struct gsn_point p)
{
    const struct gsn_point *const at = roi->point + roi->first[ring];
    const size_t n = count_points(roi, ring);
    int inside = 0;

    for (size_t i = 0; i < n; i++) {
        const struct gsn_point a = at[i], b = at[(i + 1) % n];

        if ((a.y <= p.y) != (b.y <= p.y) && a.x + (b.x - a.x) * (p.y - a.y) / (b.y - a.y) > p.x)
            inside = !inside;
    }
    return inside;
}

/* Rings may touch at a corner, but share no edge: the middle of one lies clearly in or out. */
static struct gsn_point middle_of_edge(const struct roi *roi, size_t ring)
{
    const struct gsn_point a = roi->point[roi->first[ring]], b = roi->point[roi->first[ring] + 1];

    return (struct gsn_point){ (a.x + b.x) / 2, (a.y + b.y) / 2 };
}

/* For each ring how many hold it. */
static void count_depths(const struct roi *roi, size_t *depth)
{
    for (size_t i = 0; i < roi->rings; i++)
        for (size_t k = 0; k < roi->rings; k++)
            depth[i] +=
                k != i && count_points(roi, i) > 1 && holds_point(roi, k, middle_of_edge(roi, i));
}

/* ---- features ------------------------------------------------------------------------------ */

/* Takes value. Returns -1, and array is gone, when memory runs out. */
static int append_json(json_t **array, json_t *value)
{
    if (json_array_append_new(*array, value) == 0)
        return 0;
    json_decref(*array);
    *array = NULL;
    return -1;
}

/* gives: closed, as GeoJSON has it; NULL when memory runs out. */
static json_t *ring_json(const struct roi *roi, size_t ring)
{
    const size_t n = count_points(roi, ring);
    json_t *points = json_array();

    for (size_t i = 0; i <= n && n > 0; i++) {
        const struct gsn_point at = roi->point[roi->first[ring] + i % n];

        if (append_json(&points, json_pack("[f, f]", at.x, at.y)) < 0)
            return NULL;
    }
    return points;
}

/* gives: a ring of an even depth, with the holes in it, one deeper; NULL when memory runs out. */
static json_t *polygon_json(const struct roi *roi, const size_t *depth, size_t border)
{
    json_t *polygon = json_array();

    if (append_json(&polygon, ring_json(roi, border)) < 0)
        return NULL;
    for (size_t k = 0; k < roi->rings; k++)
        if (depth[k] == depth[border] + 1 && holds_point(roi, border, middle_of_edge(roi, k)) &&
            append_json(&polygon, ring_json(roi, k)) < 0)
            return NULL;
    return polygon;
}

/* gives, or NULL when memory runs out. */
static json_t *polygons_json(const struct roi *roi, const size_t *depth)
{
    json_t *polygons = json_array();

    for (size_t i = 0; i < roi->rings; i++)
        if (depth[i] % 2 == 0 && append_json(&polygons, polygon_json(roi, depth, i)) < 0)
            return NULL;
    return polygons;
}

/* What has no area, in a word; NULL: it has one. */
static const char *name_of_type(int type, unsigned subtype)
{
    static const char *const names[] = {
        NULL, NULL, NULL,    "line", "freehand line", "segmented line", "selection of nothing",
        NULL, NULL, "angle", "point"
    };

    if (subtype == IS_TEXT)
        return "text";
    return subtype == IS_PICTURE ? "picture" : names[type];
}

static int add_outlines(struct roi *roi, int type, struct gsn_error *err)
{
    const unsigned subtype = read_half(roi, SUBTYPE), options = read_half(roi, OPTIONS);
    const int with_fractions = (options & WITH_FRACTIONS) != 0 && read_half(roi, VERSION) >= 222;

    if (read_word(roi, SHAPE) > 0)
        return add_shapes(roi, err);
    if (type == RECTANGLE || type == OVAL)
        return add_bounds(roi, type, err);
    if (type == FREEHAND && (subtype == IS_ELLIPSE || subtype == IS_ROTATED))
        return add_turned(roi, subtype, err);
    if (options & BY_SPLINE)
        return fail_roi(roi, err,
                        "is an outline that ImageJ fits a spline to: make it what is seen by "
                        "Edit, Selection, Interpolate, and save it again");
    return add_vertices(roi, with_fractions, err);
}

/* Where it lies, and its group; both from 1, 0: not said. */
static void read_place(const struct roi *roi, uint32_t *ret_slice, uint32_t *ret_frame,
                       unsigned *ret_group)
{
    const size_t second = read_word(roi, SECOND);

    *ret_slice = read_word(roi, POSITION);
    if (second < HEADER || second > roi->size || roi->size - second < SECOND_SIZE)
        return;
    if (read_word(roi, second + SECOND_Z) > 0)
        *ret_slice = read_word(roi, second + SECOND_Z);
    *ret_frame = read_word(roi, second + SECOND_T);
    *ret_group = read_half(roi, VERSION) >= 228 ? roi->bytes[second + SECOND_GROUP] : 0;
}

static json_t *feature_json(const struct roi *roi, const char *without_area, const size_t *depth)
{
    uint32_t slice = 0, frame = 0;
    unsigned group = 0;
    char name[16] = "";
    json_t *feature;

    read_place(roi, &slice, &frame, &group);
    feature =
        json_pack("{s:s, s:{s:s, s:o, s:{s:I, s:I}}}", "type", "Feature", "geometry", "type",
                  without_area ? without_area : "MultiPolygon", "coordinates",
                  without_area ? json_array() : polygons_json(roi, depth), "plane", "z",
                  (json_int_t)(slice ? slice - 1 : 0), "t", (json_int_t)(frame ? frame - 1 : 0));
    if (group > 0) {
        (void)snprintf(name, sizeof name, "%u", group);
        (void)json_object_set_new(feature, "properties",
                                  json_pack("{s:{s:s}}", "classification", "name", name));
    }
    return feature;
}

/* Adds one selection to the features. */
static int read_roi(const char *file, const uint8_t *bytes, size_t size, size_t planes,
                    json_t *features, struct gsn_error *err)
{
    struct roi roi __attribute__((cleanup(roi_done))) = {
        .file = file, .number = json_array_size(features) + 1, .bytes = bytes, .size = size
    };
    gsn_auto_mem(size_t) depth = NULL;
    const char *without_area;
    uint32_t slice = 0, frame = 0;
    unsigned group = 0;
    int type, r = GSN_OK;

    if (size < HEADER || memcmp(bytes, "Iout", 4) != 0)
        return fail_roi(&roi, err,
                        "is no selection of ImageJ: it does not begin as one, or is cut off");
    type = bytes[TYPE];
    if (type > POINT)
        return fail_roi(&roi, err, "is of the type %d, which ImageJ 1.54 does not have", type);
    read_place(&roi, &slice, &frame, &group);
    if (planes > 1 && slice == 0)
        return fail_roi(
            &roi, err,
            "says no slice, and the stack has %zu: in ImageJ add it to the ROI Manager while "
            "its slice is shown, with \"Associate Show All ROIs with slices\" (More, "
            "Options), and save it from there",
            planes);
    without_area = name_of_type(type, read_half(&roi, SUBTYPE));
    if (!without_area)
        r = add_outlines(&roi, type, err);
    if (r < 0)
        return r;
    depth = gsn_alloc_array(roi.rings + 1, sizeof *depth);
    if (!depth)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for outlines");
    count_depths(&roi, depth);
    return json_array_append_new(features, feature_json(&roi, without_area, depth)) < 0
               ? gsn_fail(err, GSN_E_NOMEM, "out of memory for outlines")
               : GSN_OK;
}

/* ---- the archive --------------------------------------------------------------------------- */

static void archive_done(zip_t **archive)
{
    if (*archive)
        zip_discard(*archive);
}

static void entry_done(zip_file_t **entry)
{
    if (*entry)
        (void)zip_fclose(*entry);
}

/* ret_bytes: of MOST_BYTES. */
static int read_entry(zip_t *archive, const char *file, zip_uint64_t i, uint8_t *bytes,
                      size_t *ret_size, struct gsn_error *err)
{
    zip_file_t *entry __attribute__((cleanup(entry_done))) = NULL;
    zip_stat_t stat;
    zip_int64_t got = -1;

    if (zip_stat_index(archive, i, 0, &stat) < 0 || !(stat.valid & ZIP_STAT_NAME) ||
        !(stat.valid & ZIP_STAT_SIZE))
        return gsn_fail(err, GSN_E_INPUT, "%s: its entry %llu is damaged", file,
                        (unsigned long long)i + 1);
    if (strlen(stat.name) < 4 || strcmp(stat.name + strlen(stat.name) - 4, ".roi") != 0)
        return gsn_fail(
            err, GSN_E_INPUT,
            "%s: \"%.100s\" in it is no selection of ImageJ (.roi): save the selections by "
            "the ROI Manager alone (More, Save)",
            file, stat.name);
    if (stat.size > MOST_BYTES)
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: \"%.100s\" in it has %llu bytes, more than the %d of any "
                        "selection",
                        file, stat.name, (unsigned long long)stat.size, MOST_BYTES);
    entry = zip_fopen_index(archive, i, 0);
    if (entry)
        got = zip_fread(entry, bytes, MOST_BYTES);
    /* The CRC is compared at the end, which is seen by reading on. */
    if (got < 0 || (zip_uint64_t)got != stat.size || zip_fread(entry, bytes + got, 1) != 0)
        return gsn_fail(err, GSN_E_INPUT, "%s: \"%.100s\" in it is damaged: %s", file, stat.name,
                        entry ? zip_file_strerror(entry) : zip_strerror(archive));
    *ret_size = (size_t)got;
    return GSN_OK;
}

static int read_archive(const char *file, const void *bytes, size_t size, size_t planes,
                        json_t *features, struct gsn_error *err)
{
    zip_t *archive __attribute__((cleanup(archive_done))) = NULL;
    gsn_auto_mem(uint8_t) entry = gsn_alloc(MOST_BYTES + 1);
    zip_source_t *source;
    zip_error_t why;
    zip_int64_t count;
    int r = GSN_OK;

    if (!entry)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", file);
    zip_error_init(&why);
    source = zip_source_buffer_create(bytes, size, 0, &why);
    archive = source ? zip_open_from_source(source, ZIP_RDONLY | ZIP_CHECKCONS, &why) : NULL;
    if (!archive) {
        r = gsn_fail(err, GSN_E_INPUT, "%s: it is no sound archive: %s", file,
                     zip_error_strerror(&why));
        zip_source_free(source);
    }
    zip_error_fini(&why);
    if (r < 0)
        return r;
    count = zip_get_num_entries(archive, 0);
    if (count > MOST_ENTRIES)
        return gsn_fail(err, GSN_E_INPUT, "%s: it has %lld entries, more than %d", file,
                        (long long)count, MOST_ENTRIES);
    for (zip_int64_t i = 0; r >= 0 && i < count; i++) {
        size_t got = 0;

        r = read_entry(archive, file, (zip_uint64_t)i, entry, &got, err);
        if (r >= 0)
            r = read_roi(file, entry, got, planes, features, err);
    }
    return r;
}

int gsn_imagej_roi_is(const void *bytes, size_t size)
{
    return size >= 4 && (memcmp(bytes, "Iout", 4) == 0 || memcmp(bytes, "PK", 2) == 0);
}

int gsn_imagej_roi_read(const char *file, const void *bytes, size_t size, size_t planes,
                        json_t **ret_features, struct gsn_error *err)
{
    json_t *collection = json_pack("{s:s, s:[]}", "type", "FeatureCollection", "features");
    json_t *features = json_object_get(collection, "features");
    int r;

    if (!features)
        r = gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", file);
    else if (memcmp(bytes, "PK", 2) == 0)
        r = read_archive(file, bytes, size, planes, features, err);
    else
        r = read_roi(file, bytes, size, planes, features, err);
    if (r < 0)
        json_decref(collection);
    else
        *ret_features = collection;
    return r;
}
