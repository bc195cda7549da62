/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A variant of the specimen, from JSON.
 *
 * Every number, list of numbers and word of the file has one row in a table here: its key, where it
 * belongs and what it may be. First each key of the file is looked up (one that is in no table is
 * refused together with the known key that the fewest edits lead to: V. I. Levenshtein, Soviet
 * Physics Doklady 10, 1966), then the rows are read, then what follows from several keys is
 * checked: the region lies in the block, the block in its slot. A value that is absent stays what
 * GVP-D and the level have. Failures are GSN_E_INPUT with the key and what it may be. */
#include "pipeline/phantom/variant.h"

#include "pipeline/core/file.h"
#include "pipeline/phantom/random.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#define RAD_PER_DEG (M_PI / 180)

/* Haematoxylin, R, G, B: A. C. Ruifrok and D. A. Johnston, Quantification of histochemical staining
 * by color deconvolution, Anal. Quant. Cytol. Histol. 23 (2001). */
static const double HAEMATOXYLIN[3] = { 0.650, 0.704, 0.286 };

/* A section has to find room in its slot of 8 mm, turned by any angle. */
static const double REACH_UM = 2900;
static const size_t FILE_LIMIT = 65536;

/* count numbers, one after another in the struct from offset on; a single one is no list. */
struct number_key {
    const char *key;
    size_t count, offset;
    double low, high;
};

#define IN_VARIANT(field) offsetof(struct gsn_phantom_variant, field)
static const struct number_key NUMBER[] = {
    { "bath_turn_deg", 1, IN_VARIANT(bath_turn_deg), 0, 45 },
    { "panel_turn_deg", 1, IN_VARIANT(panel_turn_deg), 0, 45 },
    { "stain_strength", 1, IN_VARIANT(stain_strength), 0.1, 3 },
    { "texture", 1, IN_VARIANT(texture), 0, 3 },
    { "loss", 1, IN_VARIANT(loss), 0, 3 },
    { "exposure", 1, IN_VARIANT(exposure), 0.1, 2 },
    { "size_percent", 1, IN_VARIANT(size_share), 0, 10 },
    { "collagen_floor", 1, IN_VARIANT(geometry.floor), 0, 0.6 },
};

#define IN_BLOCK(field) offsetof(struct gsn_phantom_geometry, field)
static const struct number_key BLOCK_NUMBER[] = {
    { "half_axes_um", 2, IN_BLOCK(ax), 500, 3000 },
    { "power", 1, IN_BLOCK(p), 1.5, 6 },
    { "interval_um", 1, IN_BLOCK(interval), 4, 500 },
    { "root_um", 2, IN_BLOCK(a), 100, 1500 },
    { "root_length_um", 1, IN_BLOCK(root_length), 200, 5000 },
    { "apex_um", 1, IN_BLOCK(apex_z), -2000, 2000 },
    { "root_at_um", 2, IN_BLOCK(cx), -1500, 1500 },
    { "root_slant", 2, IN_BLOCK(tx), -0.5, 0.5 },
    { "ligament_um", 1, IN_BLOCK(pdl_width), 50, 600 },
    { "bone_um", 1, IN_BLOCK(bone_width), 200, 2000 },
    { "bone_density", 1, IN_BLOCK(density[GSN_PHANTOM_BONE]), 0.3, 0.95 },
    { "marrow_density", 1, IN_BLOCK(density[GSN_PHANTOM_MARR]), 0, 0.3 },
    { "lesion_um", 3, IN_BLOCK(lesion), -3000, 3000 },
    { "lesion_size_um", 3, IN_BLOCK(lesion_radius), 50, 2000 },
    { "region_um", 3, IN_BLOCK(region_depth), 50, 2000 },
};

/* The keys that the tables above do not hold. */
static const char *const OTHER[] = { "bath_seed",  "counterstain", "jpeg_quality",   "marks",
                                     "layout",     "triangle_um",  "label",          "markers_key",
                                     "order",      "markers_y_up", "black_frame_px", "block",
                                     "calibration" };
static const char *const BLOCK_OTHER[] = { "like", "sections", "marrow" };
static const char *const MARKS[] = { "radius_um", "kind", "aspect", "decoys", "none" };

enum { KEYS_MOST = 32 };
#define COUNT(array) (sizeof(array) / sizeof *(array))

/* --- failures --- */

/* place: the file, and within it the object that a key belongs to. */
static int refuse_key(struct gsn_error *err, const char *place, const char *key, const char *wanted)
{
    return gsn_fail(err, GSN_E_INPUT, "%s: \"%s\" must be %s", place, key, wanted);
}

/* How many letters must be put in, taken out or replaced; names are short. */
static size_t edits_between(const char *a, const char *b)
{
    size_t row[64], length = strlen(b);

    if (length >= COUNT(row))
        return SIZE_MAX;
    for (size_t j = 0; j <= length; j++)
        row[j] = j;
    for (size_t i = 0; a[i]; i++) {
        size_t diagonal = row[0];

        row[0] = i + 1;
        for (size_t j = 0; j < length; j++) {
            const size_t replaced = diagonal + (a[i] != b[j]);
            const size_t moved = 1 + (row[j] < row[j + 1] ? row[j] : row[j + 1]);

            diagonal = row[j + 1];
            row[j + 1] = replaced < moved ? replaced : moved;
        }
    }
    return row[length];
}

static int check_keys(json_t *object, const char *place, const char *const *known, size_t count,
                      struct gsn_error *err)
{
    for (void *at = json_object_iter(object); at; at = json_object_iter_next(object, at)) {
        const char *key = json_object_iter_key(at);
        size_t nearest = 0, fewest = SIZE_MAX;

        for (size_t i = 0; i < count && fewest > 0; i++) {
            const size_t edits = edits_between(key, known[i]);

            if (edits < fewest) {
                fewest = edits;
                nearest = i;
            }
        }
        if (fewest > 0)
            return gsn_fail(err, GSN_E_INPUT,
                            "%s: there is no key \"%.60s\"; the nearest is \"%s\"", place, key,
                            known[nearest]);
    }
    return GSN_OK;
}

static size_t list_keys(const struct number_key *number, size_t numbers, const char *const *other,
                        size_t others, const char *ret_known[KEYS_MOST])
{
    size_t count = 0;

    for (size_t i = 0; i < numbers; i++)
        ret_known[count++] = number[i].key;
    for (size_t i = 0; i < others; i++)
        ret_known[count++] = other[i];
    return count;
}

/* --- values --- */

static int read_numbers(const json_t *value, size_t count, double low, double high, double *ret)
{
    double number[3];

    if (count > 1 && (!json_is_array(value) || json_array_size(value) != count))
        return -1;
    for (size_t i = 0; i < count; i++) {
        const json_t *one = count > 1 ? json_array_get(value, i) : value;

        number[i] = json_number_value(one);
        if (!json_is_number(one) || !(number[i] >= low && number[i] <= high))
            return -1;
    }
    memcpy(ret, number, count * sizeof *number);
    return 0;
}

static int read_table(const json_t *object, const char *place, const struct number_key *number,
                      size_t numbers, void *onto, struct gsn_error *err)
{
    for (size_t i = 0; i < numbers; i++) {
        const struct number_key *n = &number[i];
        const json_t *value = json_object_get(object, n->key);
        double *at = (double *)((char *)onto + n->offset);

        if (value && read_numbers(value, n->count, n->low, n->high, at) < 0)
            return gsn_fail(err, GSN_E_INPUT, "%s: \"%s\" must be %s, %g to %g", place, n->key,
                            n->count == 1   ? "a number"
                            : n->count == 2 ? "two numbers"
                                            : "three numbers",
                            n->low, n->high);
    }
    return GSN_OK;
}

static int read_whole(const json_t *object, const char *key, int low, int high, int *ret)
{
    const json_t *value = json_object_get(object, key);

    if (!value)
        return 0;
    if (!json_is_integer(value) || json_integer_value(value) < low ||
        json_integer_value(value) > high)
        return -1;
    *ret = (int)json_integer_value(value);
    return 0;
}

static int read_flag(const json_t *object, const char *key, int *ret)
{
    const json_t *value = json_object_get(object, key);

    if (value && !json_is_boolean(value))
        return -1;
    if (value)
        *ret = json_is_true(value);
    return 0;
}

/* Which of the words, of which the last is followed by NULL; -1 for another one. */
static int read_word(const json_t *object, const char *key, const char *const *words, int *ret)
{
    const json_t *value = json_object_get(object, key);

    if (!value)
        return 0;
    for (int i = 0; json_is_string(value) && words[i]; i++)
        if (strcmp(json_string_value(value), words[i]) == 0) {
            *ret = i;
            return 0;
        }
    return -1;
}

static int copy_word(const json_t *object, const char *key, char ret[GSN_PHANTOM_WORD])
{
    const json_t *value = json_object_get(object, key);

    if (!value)
        return 0;
    if (!json_is_string(value) || json_string_length(value) == 0 ||
        json_string_length(value) >= GSN_PHANTOM_WORD || strpbrk(json_string_value(value), "\"\\"))
        return -1;
    (void)snprintf(ret, GSN_PHANTOM_WORD, "%s", json_string_value(value));
    return 0;
}

/* --- objects --- */

static int read_marks(json_t *root, const char *place, struct gsn_phantom_variant *v,
                      struct gsn_error *err)
{
    static const char *const kinds[] = { "disc", "hole", NULL };
    const struct gsn_phantom_burning usual = *gsn_phantom_burning();
    json_t *marks = json_object_get(root, "marks");
    double radius = usual.radius_um, scale;
    int r;

    if (!marks)
        return GSN_OK;
    if (!json_is_object(marks))
        return refuse_key(err, place, "marks", "an object");
    r = check_keys(marks, place, MARKS, COUNT(MARKS), err);
    if (r < 0)
        return r;
    if (json_object_get(marks, "radius_um") &&
        read_numbers(json_object_get(marks, "radius_um"), 1, 10, 400, &radius) < 0)
        return refuse_key(err, place, "radius_um", "a number, 10 to 400");
    if (json_object_get(marks, "aspect") &&
        read_numbers(json_object_get(marks, "aspect"), 1, 1, 1.6, &v->aspect) < 0)
        return refuse_key(err, place, "aspect", "a number, 1 to 1.6");
    if (read_word(marks, "kind", kinds, &v->burning.hole) < 0)
        return refuse_key(err, place, "kind", "\"disc\" or \"hole\"");
    if (read_whole(marks, "decoys", 0, GSN_PHANTOM_DECOYS_MOST, &v->decoys) < 0)
        return refuse_key(err, place, "decoys", "a whole number, 0 to 60");
    if (read_flag(marks, "none", &v->no_marks) < 0)
        return refuse_key(err, place, "none", "true or false");
    /* Another mark is the usual one made larger or smaller, but no edge is softer. */
    scale = radius / usual.radius_um;
    v->burning.radius_um = radius;
    v->burning.ring_um = scale * usual.ring_um;
    v->burning.edge_um = fmin(scale, 1) * usual.edge_um;
    return GSN_OK;
}

/* "D" or "P", or an object that says in what it is unlike one of them. */
static int read_block(json_t *root, const char *place, struct gsn_phantom_variant *v,
                      struct gsn_error *err)
{
    static const char *const names[] = { "D", "P", NULL };
    const char *known[KEYS_MOST];
    json_t *block = json_object_get(root, "block");
    struct gsn_phantom_geometry *g = &v->geometry;
    int like = 0, r;

    if (!block)
        return GSN_OK;
    if (read_word(json_is_object(block) ? block : root, json_is_object(block) ? "like" : "block",
                  names, &like) < 0)
        return refuse_key(err, place, "block", "\"D\" or \"P\", or an object \"like\" one of them");
    *g = *gsn_phantom_geometry_find(names[like]);
    if (!json_is_object(block))
        return GSN_OK;
    r = check_keys(
        block, place, known,
        list_keys(BLOCK_NUMBER, COUNT(BLOCK_NUMBER), BLOCK_OTHER, COUNT(BLOCK_OTHER), known), err);
    if (r >= 0)
        r = read_table(block, place, BLOCK_NUMBER, COUNT(BLOCK_NUMBER), g, err);
    if (r < 0)
        return r;
    if (read_whole(block, "sections", 4, 60, &g->sections) < 0)
        return refuse_key(err, place, "sections", "a whole number, 4 to 60");
    if (read_whole(block, "marrow", 0, GSN_PHANTOM_MARROWS, &g->marrows) < 0)
        return refuse_key(err, place, "marrow", "a whole number, 0 to 40");
    g->first_z = g->interval / 2;
    g->height = g->interval * g->sections;
    return GSN_OK;
}

static int read_layout(const json_t *root, const char *place, struct gsn_phantom_variant *v,
                       struct gsn_error *err)
{
    const json_t *layout = json_object_get(root, "layout"), *triangle;
    double side[2] = { v->rows, v->columns };

    if (layout && (read_numbers(layout, 2, 1, 24, side) < 0 || side[0] != floor(side[0]) ||
                   side[1] != floor(side[1]) || side[0] * side[1] < 4 || side[0] * side[1] > 24))
        return refuse_key(err, place, "layout", "[rows, columns] of 4 to 24 sections");
    v->rows = (int)side[0];
    v->columns = (int)side[1];
    triangle = json_object_get(root, "triangle_um");
    if (triangle && json_array_size(triangle) != GSN_PHANTOM_MARKS)
        return refuse_key(err, place, "triangle_um", "three points [x, y]");
    for (size_t i = 0; triangle && i < GSN_PHANTOM_MARKS; i++) {
        double at[2];

        if (read_numbers(json_array_get(triangle, i), 2, -3000, 3000, at) < 0)
            return refuse_key(err, place, "triangle_um", "three points [x, y] within 3000 um");
        v->geometry.mark[i] = (struct gsn_point){ at[0], at[1] };
    }
    return GSN_OK;
}

static int read_bath(const json_t *root, const char *place, struct gsn_phantom_variant *v,
                     struct gsn_error *err)
{
    static const char *const stains[] = { "haematoxylin", NULL };
    const json_t *seed = json_object_get(root, "bath_seed");
    const json_t *quality = json_object_get(root, "jpeg_quality");
    int stain = -1;

    if (seed && (!json_is_integer(seed) || json_integer_value(seed) < 0))
        return refuse_key(err, place, "bath_seed", "a whole number, 0 or more");
    if (seed)
        v->bath_seed = (uint64_t)json_integer_value(seed);
    if (read_word(root, "counterstain", stains, &stain) < 0)
        return refuse_key(err, place, "counterstain", "\"haematoxylin\"");
    v->haematoxylin = stain == 0;
    if (json_is_null(quality))
        v->jpeg_quality = 0;
    else if (read_whole(root, "jpeg_quality", 1, 100, &v->jpeg_quality) < 0)
        return refuse_key(err, place, "jpeg_quality", "a whole number, 1 to 100, or null for PNG");
    return GSN_OK;
}

static int read_calibrated(const json_t *root, const char *place, struct gsn_phantom_variant *v,
                           struct gsn_error *err)
{
    const json_t *value = json_object_get(root, "calibration");

    if (json_is_true(value))
        v->calibrated = GSN_PHANTOM_BY_DYES;
    else if (json_is_string(value) && strcmp(json_string_value(value), "patches") == 0)
        v->calibrated = GSN_PHANTOM_BY_PATCHES;
    else if (value && !json_is_false(value))
        return refuse_key(err, place, "calibration", "true, false or \"patches\"");
    return GSN_OK;
}

/* What the operator states, and what is on the glass beside the sections. */
static int read_statements(const json_t *root, const char *place, struct gsn_phantom_variant *v,
                           struct gsn_error *err)
{
    static const char *const labels[] = { "upright", "turned", "none", NULL };
    int label = GSN_PHANTOM_UPRIGHT;

    if (read_word(root, "label", labels, &label) < 0)
        return refuse_key(err, place, "label", "\"upright\", \"turned\" or \"none\"");
    v->label = (enum gsn_phantom_label)label;
    if (copy_word(root, "markers_key", v->markers_key) < 0)
        return refuse_key(err, place, "markers_key", "a key of job.json");
    if (copy_word(root, "order", v->order) < 0)
        return refuse_key(err, place, "order", "a word");
    if (read_flag(root, "markers_y_up", &v->markers_y_up) < 0)
        return refuse_key(err, place, "markers_y_up", "true or false");
    if (read_whole(root, "black_frame_px", 0, 2000, &v->black_frame_px) < 0)
        return refuse_key(err, place, "black_frame_px", "a whole number, 0 to 2000");
    return GSN_OK;
}

/* --- what follows from several keys --- */

/* How far the outline |x/Ax|^p + |y/Ay|^p = 1 reaches. */
static double outline_reach(const struct gsn_phantom_geometry *g)
{
    enum { STEPS = 90 };
    double most = 0;

    for (int i = 0; i <= STEPS; i++) {
        const double phi = M_PI / 2 * i / STEPS, x = cos(phi), y = sin(phi);

        most = fmax(most, pow(pow(x / g->ax, g->p) + pow(y / g->ay, g->p), -1 / g->p));
    }
    return most;
}

static int check_block(const char *place, const struct gsn_phantom_variant *v,
                       struct gsn_error *err)
{
    const struct gsn_phantom_geometry *g = &v->geometry;
    const double low = g->lesion.z - g->region_half_height;
    const double high = g->lesion.z + g->region_half_height;

    if (outline_reach(g) > REACH_UM)
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: the block reaches %.0f um from its middle, and a slot has room for "
                        "%g: make \"half_axes_um\" smaller",
                        place, outline_reach(g), REACH_UM);
    if (low < 0 || high > g->height)
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: the region lies at z = %g to %g um, and the block at 0 to %g: change "
                        "\"lesion_um\", \"region_um\" or \"sections\"",
                        place, low, high, g->height);
    /* Else region.mhd, a voxel a section, is not the region of loss.csv. */
    if (fabs(remainder(low, g->interval)) > 1e-6 || fabs(remainder(high, g->interval)) > 1e-6)
        return gsn_fail(err, GSN_E_INPUT,
                        "%s: the region ends within a section (z = %g to %g um): \"lesion_um\" and "
                        "\"region_um\" must put both ends on a multiple of %g um",
                        place, low, high, g->interval);
    for (int i = 0; i < GSN_PHANTOM_MARKS; i++)
        if (hypot(g->mark[i].x, g->mark[i].y) > REACH_UM)
            return gsn_fail(err, GSN_E_INPUT,
                            "%s: mark %d of \"triangle_um\" lies more than %g um from the middle",
                            place, i + 1, REACH_UM);
    return GSN_OK;
}

/* A specimen without collagen-poor tissue. */
static void raise_to_floor(struct gsn_phantom_geometry *g)
{
    for (int i = 0; i < GSN_PHANTOM_LAYERS; i++)
        g->density[i] = fmax(g->density[i], g->floor);
}

static int read_variant(json_t *root, const char *place, struct gsn_phantom_variant *v,
                        struct gsn_error *err)
{
    const char *known[KEYS_MOST];
    int r;

    if (!json_is_object(root))
        return gsn_fail(err, GSN_E_INPUT, "%s: must be a JSON object", place);
    r = check_keys(root, place, known, list_keys(NUMBER, COUNT(NUMBER), OTHER, COUNT(OTHER), known),
                   err);
    if (r < 0 || (r = read_block(root, place, v, err)) < 0 ||
        (r = read_table(root, place, NUMBER, COUNT(NUMBER), v, err)) < 0 ||
        (r = read_marks(root, place, v, err)) < 0 || (r = read_layout(root, place, v, err)) < 0 ||
        (r = read_bath(root, place, v, err)) < 0 ||
        (r = read_calibrated(root, place, v, err)) < 0 ||
        (r = read_statements(root, place, v, err)) < 0 || (r = check_block(place, v, err)) < 0)
        return r;
    if (json_object_get(root, "size_percent"))
        v->size_share /= 100;
    raise_to_floor(&v->geometry);
    return GSN_OK;
}

struct gsn_phantom_variant gsn_phantom_variant_usual(void)
{
    const struct gsn_phantom_variant usual = {
        .panel_turn_deg = -1,
        .stain_strength = 1,
        .texture = 1,
        .loss = 1,
        .exposure = 1,
        .size_share = -1,
        .jpeg_quality = -1,
        .geometry = *gsn_phantom_geometry(),
        .burning = *gsn_phantom_burning(),
        .aspect = -1,
        .decoys = -1,
        .rows = 3,
        .columns = 4,
        .markers_key = "markers_um",
        .order = "row",
    };
    return usual;
}

int gsn_phantom_variant_parse(const char *text, size_t size, const char *name,
                              struct gsn_phantom_variant *ret_variant, struct gsn_error *err)
{
    gsn_auto_phantom_variant variant = gsn_phantom_variant_usual();
    json_error_t why;
    json_t *root = json_loadb(text, size, JSON_REJECT_DUPLICATES, &why);
    int r;

    if (!root)
        return gsn_fail(err, GSN_E_INPUT, "%s, line %d: %s", name, why.line, why.text);
    r = read_variant(root, name, &variant, err);
    json_decref(root);
    if (r < 0)
        return r;
    variant.text = gsn_alloc(size + 1);
    if (!variant.text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", name);
    memcpy(variant.text, text, size);
    variant.text[size] = 0;
    *ret_variant = variant;
    variant.text = NULL;
    return GSN_OK;
}

int gsn_phantom_variant_read(const char *path, struct gsn_phantom_variant *ret_variant,
                             struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size;
    const int r = gsn_file_read(path, FILE_LIMIT, &bytes, &size, err);

    return r < 0 ? r : gsn_phantom_variant_parse((const char *)bytes, size, path, ret_variant, err);
}

void gsn_phantom_variant_done(struct gsn_phantom_variant *variant)
{
    gsn_free(variant->text);
    variant->text = NULL;
}

void gsn_phantom_variant_dye(const struct gsn_phantom_variant *variant, enum gsn_phantom_dye dye,
                             double ret_vector[3])
{
    struct gsn_phantom_random random =
        gsn_phantom_random_make(variant->bath_seed, GSN_PHANTOM_STREAM_BATH, (uint64_t)dye, 0);

    gsn_phantom_dye_vector(dye, ret_vector);
    if (dye == GSN_PHANTOM_NUCLEAR && variant->haematoxylin) {
        double squares = 0;

        for (int c = 0; c < 3; c++)
            squares += HAEMATOXYLIN[c] * HAEMATOXYLIN[c];
        for (int c = 0; c < 3; c++)
            ret_vector[c] = HAEMATOXYLIN[c] / sqrt(squares);
    }
    if (dye != GSN_PHANTOM_MARK && variant->bath_turn_deg > 0)
        gsn_phantom_turn_vector(&random, RAD_PER_DEG * variant->bath_turn_deg, ret_vector);
}
