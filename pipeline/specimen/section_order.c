/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Are the sections in the order that the job states, and is one of them there twice?
 *
 * 1. While panels pass, the density of each placed section is averaged in cells of the block; that
 * of held sections in cells of their own box.
 * 2. Pairs that look exchanged and sections that look alike are found by comparison
 *    (register/order/sequence.h), also among held sections.
 * 3. The way through all sections (register/order/seriation.h: sum of the changes from one to the
 * next) is compared with that of other readings of the layout: row, column, snake, panels turned by
 * half, two panels exchanged. A reading that is shorter by gsn_seriation_shorter standard errors
 * means that z is wrong: no figure is given, and no single swap is named.
 *
 * What is found are flags and sentences for a person; nothing is moved. What the tissue of this
 * block could not have shown is reported as well. */
#include "pipeline/specimen/section_order.h"

#include "pipeline/core/robust.h"
#include "pipeline/register/order/sequence.h"
#include "pipeline/register/order/seriation.h"
#include "pipeline/register/panel/slots.h"
#include "pipeline/register/pose/pose.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

/* A cell of which less than this share was seen is not known. */
static const double SEEN = 0.5;

/* What is masked counts as this little seen: the cell is in the section's box, so it is no glass.
 */
static const float HIDDEN = 1e-6f;

/* Of one plane: larger specimens are seen in larger cells. */
static const double MOST_CELLS = 80000;

static int is_laid(const struct gsn_section *s)
{
    return s->posed && (s->state == GSN_SECTION_USED || s->state == GSN_SECTION_DOUBTFUL) &&
           s->seen.width > 0 && s->seen.height > 0;
}

size_t gsn_section_planes_list(const struct gsn_poses *poses, size_t *ret_section)
{
    size_t count = 0;

    for (size_t i = 0; i < poses->section_count; i++)
        if (is_laid(&poses->section[i]) &&
            (count == 0 ||
             poses->section[ret_section[count - 1]].seen.serial != poses->section[i].seen.serial))
            ret_section[count++] = i;
    return count;
}

/* One end of a section's box in the block. */
static double end_of(const struct gsn_section *s, int along_y, double sign)
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
static double usual_end(const struct gsn_section_planes *planes, const struct gsn_poses *poses,
                        int along_y, double sign, double *room)
{
    for (size_t k = 0; k < planes->count; k++)
        room[k] = end_of(&poses->section[planes->section[k]], along_y, sign);
    return gsn_median(room, planes->count);
}

/* Cells no narrower than the coarsest pixel, and no more than are allowed. */
static double wide_enough(const struct gsn_section_planes *planes, const struct gsn_poses *poses,
                          struct gsn_point end)
{
    const double area = (end.x - planes->origin.x) * (end.y - planes->origin.y);
    double wide = fmax(planes->cell_um, sqrt(fmax(area, 0) / MOST_CELLS));

    for (size_t k = 0; k < planes->count; k++) {
        const struct gsn_pose *pose = &poses->section[planes->section[k]].pose;

        wide = fmax(wide, sqrt(fabs(gsn_affine_det(&pose->panel_to_block_um))));
    }
    return wide;
}

static void place_cells(struct gsn_section_planes *planes, const struct gsn_poses *poses,
                        double *room)
{
    struct gsn_point end;

    planes->origin = (struct gsn_point){ usual_end(planes, poses, 0, -1, room),
                                         usual_end(planes, poses, 1, -1, room) };
    end = (struct gsn_point){ usual_end(planes, poses, 0, 1, room),
                              usual_end(planes, poses, 1, 1, room) };
    planes->cell_um = wide_enough(planes, poses, end);
    planes->columns = (size_t)fmax((end.x - planes->origin.x) / planes->cell_um, 1) + 1;
    planes->rows = (size_t)fmax((end.y - planes->origin.y) / planes->cell_um, 1) + 1;
}

int gsn_section_planes_new(const struct gsn_poses *poses, double cell_um,
                           struct gsn_section_planes **ret_planes, struct gsn_error *err)
{
    gsn_auto(gsn_section_planes) planes = gsn_alloc_array(1, sizeof *planes);
    gsn_auto_mem(double) room = gsn_alloc_array(poses->section_count, sizeof *room);

    assert(ret_planes);

    if (planes) {
        planes->cell_um = cell_um;
        planes->section = gsn_alloc_array(poses->section_count, sizeof *planes->section);
        planes->held = gsn_alloc_array(poses->section_count, sizeof *planes->held);
    }
    if (!planes || !room || !planes->section || !planes->held)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the planes of the sections");
    planes->count = gsn_section_planes_list(poses, planes->section);
    if (planes->count == 0) {
        *ret_planes = NULL;
        return GSN_OK;
    }
    place_cells(planes, poses, room);
    planes->density =
        gsn_alloc_array(planes->count * planes->rows, planes->columns * sizeof(float));
    planes->seen = gsn_alloc_array(planes->count * planes->rows, planes->columns * sizeof(float));
    if (!planes->density || !planes->seen)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the planes of the sections");
    *ret_planes = gsn_steal(&planes);
    return GSN_OK;
}

void gsn_section_planes_free(struct gsn_section_planes *planes)
{
    if (!planes)
        return;
    for (size_t k = 0; k < planes->held_count; k++)
        gsn_free(planes->held[k].density);
    gsn_free(planes->held);
    gsn_free(planes->section);
    gsn_free(planes->density);
    gsn_free(planes->seen);
    gsn_free(planes);
}

static void gather_density(struct gsn_section_planes *planes, size_t plane,
                           const struct gsn_section *s, const struct gsn_plane *density,
                           unsigned apart)
{
    const struct gsn_affine *map = &s->pose.panel_to_block_um;
    const float area = (float)(apart * fabs(gsn_affine_det(map)));
    float *sum = planes->density + plane * planes->columns * planes->rows;
    float *seen = planes->seen + plane * planes->columns * planes->rows;

    for (size_t y = 0; y < density->height; y++)
        for (size_t x = 0; x < density->width; x++) {
            const float value = density->value[y * density->width + x];
            const struct gsn_point at = { s->seen.x + (double)x + 0.5,
                                          s->seen.y + (double)(y * apart) + 0.5 };
            const struct gsn_point p = gsn_affine_apply(map, at);
            const double u = (p.x - planes->origin.x) / planes->cell_um;
            const double v = (p.y - planes->origin.y) / planes->cell_um;

            if (!(u >= 0 && v >= 0 && u < (double)planes->columns && v < (double)planes->rows))
                continue;
            sum[(size_t)v * planes->columns + (size_t)u] += isnan(value) ? 0 : area * value;
            seen[(size_t)v * planes->columns + (size_t)u] += isnan(value) ? HIDDEN * area : area;
        }
}

void gsn_section_planes_add(struct gsn_section_planes *planes, const struct gsn_poses *poses,
                            size_t i, const struct gsn_plane *density, unsigned apart)
{
    for (size_t k = 0; planes && k < planes->count; k++)
        if (planes->section[k] == i)
            gather_density(planes, k, &poses->section[i], density, apart);
}

/* known, seen: samples of each cell, scratch. */
static void gather_held(struct gsn_held_section *s, const struct gsn_plane *density, unsigned apart,
                        double px_um, float *known, float *seen)
{
    for (size_t y = 0; y < density->height; y++)
        for (size_t x = 0; x < density->width; x++) {
            const float value = density->value[y * density->width + x];
            const size_t u = (size_t)(((double)x + 0.5) * px_um / s->cell_um);
            const size_t v = (size_t)(((double)(y * apart) + 0.5) * px_um / s->cell_um);
            const size_t cell = v * s->columns + u;

            s->density[cell] += isnan(value) ? 0 : value;
            known[cell] += isnan(value) ? 0.0f : 1.0f;
            seen[cell]++;
        }
    for (size_t c = 0; c < s->columns * s->rows; c++)
        s->density[c] = known[c] > 0 && (double)known[c] >= SEEN * (double)seen[c]
                            ? s->density[c] / known[c]
                        : seen[c] > 0 ? NAN
                                      : 0;
}

int gsn_section_planes_hold(struct gsn_section_planes *planes, size_t i,
                            const struct gsn_plane *density, unsigned apart, double px_um,
                            struct gsn_error *err)
{
    struct gsn_held_section s = { .section = i };

    if (!planes)
        return GSN_OK;
    s.cell_um = fmax(planes->cell_um / 2, apart * px_um);
    s.columns = (size_t)(density->width * px_um / s.cell_um) + 1;
    s.rows = (size_t)(density->height * apart * px_um / s.cell_um) + 1;

    gsn_auto_mem(float) cells = gsn_alloc_array(s.columns * s.rows, sizeof *cells);
    gsn_auto_mem(float) room = gsn_alloc_array(2 * s.columns * s.rows, sizeof *room);

    if (!cells || !room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the planes of the sections");
    s.density = cells;
    gather_held(&s, density, apart, px_um, room, room + s.columns * s.rows);
    s.density = gsn_steal(&cells);
    planes->held[planes->held_count++] = s;
    return GSN_OK;
}

static float mean_of(double sum, double seen, double cell_um)
{
    if (seen >= SEEN * cell_um * cell_um)
        return (float)(sum / seen);
    return seen > 0 ? NAN : 0;
}

void gsn_section_planes_settle(struct gsn_section_planes *planes)
{
    const size_t total = planes->count * planes->columns * planes->rows;

    for (size_t i = 0; i < total; i++)
        planes->density[i] =
            mean_of((double)planes->density[i], (double)planes->seen[i], planes->cell_um);
}

struct section_name {
    char text[24];
};

/* As people say it, and `gieson decide` takes it. */
static struct section_name name_of(unsigned serial, unsigned slots)
{
    struct section_name name;

    (void)snprintf(name.text, sizeof name.text, "%u.%u", serial / slots + 1, serial % slots + 1);
    return name;
}

/* Flags the sections of that number that were compared, laid or held. */
static void flag_sections(const struct gsn_section_planes *planes, const struct gsn_poses *poses,
                          struct gsn_densities *densities,
                          const struct gsn_sequence_finding *finding, int second, unsigned slots)
{
    const unsigned serial = second ? finding->b : finding->a;
    const unsigned other = second ? finding->a : finding->b;
    const size_t count = finding->held[second] ? planes->held_count : planes->count;

    for (size_t k = 0; k < count; k++) {
        const size_t i = finding->held[second] ? planes->held[k].section : planes->section[k];

        if (poses->section[i].seen.serial == serial)
            gsn_flags_add_number(&densities->section[i].flags,
                                 finding->kind == GSN_SEQUENCE_SWAP ? GSN_FLAG_SWAPPED_WITH
                                                                    : GSN_FLAG_SAME_AS,
                                 other / slots + 1, other % slots + 1);
    }
}

static int examine_laid(const struct gsn_section_planes *planes, const struct gsn_poses *poses,
                        struct gsn_sequence_plane *plane, struct gsn_sequence **ret_sequence,
                        struct gsn_error *err)
{
    for (size_t k = 0; k < planes->count; k++)
        plane[k] =
            (struct gsn_sequence_plane){ poses->section[planes->section[k]].seen.serial,
                                         planes->density + k * planes->columns * planes->rows };
    return gsn_sequence_examine(plane, planes->count, planes->columns, planes->rows, ret_sequence,
                                err);
}

static int examine_held(const struct gsn_section_planes *planes, const struct gsn_poses *poses,
                        const struct gsn_sequence_plane *plane, struct gsn_sequence *sequence,
                        struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_sequence_excluded) held =
        gsn_alloc_array(planes->held_count, sizeof *held);

    if (!held)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    for (size_t k = 0; k < planes->held_count; k++) {
        const struct gsn_held_section *s = &planes->held[k];

        held[k] =
            (struct gsn_sequence_excluded){ poses->section[s->section].seen.serial, s->columns,
                                            s->rows, s->cell_um / planes->cell_um, s->density };
    }
    return gsn_sequence_examine_excluded(plane, planes->count, planes->columns, planes->rows, held,
                                         planes->held_count, sequence, err);
}

/* ---- another order of all sections ---------------------------------------------------------- */

enum { MOST_PANELS = 64 };

/* How the panels may have been read otherwise. */
struct reading {
    enum gsn_order order;
    unsigned turned;      /* the panel that lies turned by half, from 1; 0: none */
    int all_turned;       /* every panel does */
    unsigned exchange[2]; /* panels that have each other's numbers; 0: none */
};

static unsigned serial_as(const struct reading *reading, const struct gsn_layout *stated,
                          const struct gsn_section *s)
{
    const struct gsn_layout layout = { stated->rows, stated->columns, reading->order };
    unsigned panel = s->panel, row, column;

    if (reading->exchange[0] && (panel == reading->exchange[0] || panel == reading->exchange[1]))
        panel = reading->exchange[0] + reading->exchange[1] - panel;
    gsn_panel_place(stated, s->seen.slot, &row, &column);
    if (reading->all_turned != (reading->turned == s->panel)) {
        row = stated->rows - 1 - row;
        column = stated->columns - 1 - column;
    }
    for (unsigned slot = 0; slot < layout.rows * layout.columns; slot++) {
        unsigned there_row, there_column;

        gsn_panel_place(&layout, slot, &there_row, &there_column);
        if (there_row == row && there_column == column)
            return gsn_panel_serial(panel, slot, &layout);
    }
    return s->seen.serial;
}

struct place {
    unsigned serial;
    size_t plane;
};

static int by_serial(const void *a, const void *b)
{
    const struct place *p = a, *q = b;

    return p->serial < q->serial ? -1 : p->serial > q->serial;
}

struct search {
    const struct gsn_section_planes *planes;
    const struct gsn_poses *poses;
    struct gsn_seriation *path;
    struct gsn_layout layout;
    struct place *place; /* room for all planes */
    size_t *order;       /* likewise */
    struct reading best;
    double gain;
};

static void try_reading(struct search *s, const struct reading *reading)
{
    double gain;

    for (size_t k = 0; k < s->planes->count; k++)
        s->place[k] = (struct place){
            serial_as(reading, &s->layout, &s->poses->section[s->planes->section[k]]), k
        };
    qsort(s->place, s->planes->count, sizeof *s->place, by_serial);
    for (size_t k = 0; k < s->planes->count; k++)
        s->order[k] = s->place[k].plane;
    gain = gsn_seriation_gain(s->path, s->order);
    if (gain > s->gain) {
        s->gain = gain;
        s->best = *reading;
    }
}

/* The order that is stated with one panel read otherwise, and the other orders with all panels as
 * they lie or turned. */
static void try_all(struct search *s, unsigned panels)
{
    for (int order = GSN_ORDER_ROW; order <= GSN_ORDER_SNAKE; order++)
        for (int turned = 0; turned < 2; turned++)
            try_reading(s,
                        &(struct reading){ .order = (enum gsn_order)order, .all_turned = turned });
    for (unsigned p = 1; p <= panels; p++) {
        try_reading(s, &(struct reading){ .order = s->layout.order, .turned = p });
        for (unsigned q = p + 1; q <= panels; q++)
            try_reading(s, &(struct reading){ .order = s->layout.order, .exchange = { p, q } });
    }
}

static void say_reading(const struct search *s, char *ret_sentence, size_t size)
{
    static const char *const words[] = {
        [GSN_ORDER_ROW] = "row", [GSN_ORDER_COLUMN] = "column", [GSN_ORDER_SNAKE] = "snake"
    };
    const struct reading *b = &s->best;
    char what[200];

    if (b->exchange[0])
        (void)snprintf(
            what, sizeof what,
            "as if panels %u and %u had each other's numbers: look at the glasses and at "
            "the files' names",
            b->exchange[0], b->exchange[1]);
    else if (b->turned)
        (void)snprintf(
            what, sizeof what,
            "as if panel %u lay turned by half, so that its sections count backwards: look "
            "at the glass and its label",
            b->turned);
    else if (b->order == s->layout.order)
        (void)snprintf(what, sizeof what,
                       "as if all panels lay turned by half, so that sections count backwards on "
                       "each: look at the glasses and their labels");
    else
        (void)snprintf(what, sizeof what,
                       "by \"order\": \"%s\"%s, where \"%s\" is stated: put it right in job.json",
                       words[b->order], b->all_turned ? " with all panels turned by half" : "",
                       words[s->layout.order]);
    (void)snprintf(
        ret_sentence, size,
        "the tissue goes on from section to section %s (the way through them is shorter by "
        "%.0f standard errors); z is wrong as it is stated, so no figure is given",
        what, s->gain);
}

/* Where all sections are out of place, no two of them are named. */
static void drop_swaps(struct gsn_sequence *sequence)
{
    size_t kept = 0;

    for (size_t i = 0; i < sequence->count; i++)
        if (sequence->finding[i].kind != GSN_SEQUENCE_SWAP)
            sequence->finding[kept++] = sequence->finding[i];
    sequence->count = kept;
}

static int examine_layout(const struct gsn_section_planes *planes,
                          const struct gsn_sequence_plane *plane,
                          const struct gsn_protocol *protocol, const struct gsn_poses *poses,
                          struct gsn_densities *densities, struct gsn_sequence *sequence,
                          struct gsn_error *err)
{
    gsn_auto_mem(struct place) place = gsn_alloc_array(planes->count + 1, sizeof *place);
    gsn_auto_mem(size_t) order = gsn_alloc_array(planes->count + 1, sizeof *order);
    gsn_auto(gsn_seriation) path = NULL;
    struct search search = { .planes = planes,
                             .poses = poses,
                             .layout = gsn_protocol_layout(protocol),
                             .place = place,
                             .order = order };
    unsigned panels = 0;
    int r;

    if (!place || !order)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    for (size_t k = 0; k < planes->count; k++) {
        const unsigned panel = poses->section[planes->section[k]].panel;

        panels = panel > panels ? panel : panels;
    }
    r = gsn_seriation_new(plane, planes->count, planes->columns, planes->rows, &path, err);
    search.path = path;
    if (r >= 0)
        try_all(&search, panels < MOST_PANELS ? panels : MOST_PANELS);
    if (r >= 0 && search.gain > gsn_seriation_shorter) {
        say_reading(&search, densities->misordered, sizeof densities->misordered);
        drop_swaps(sequence);
    }
    return r;
}

int gsn_section_order_examine(struct gsn_section_planes *planes,
                              const struct gsn_protocol *protocol, const struct gsn_poses *poses,
                              struct gsn_densities *densities, struct gsn_sequence **ret_sequence,
                              struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_sequence_plane) plane = gsn_alloc_array(planes->count, sizeof *plane);
    gsn_auto(gsn_sequence) sequence = NULL;
    const struct gsn_layout layout = gsn_protocol_layout(protocol);
    int r;

    if (!plane)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    gsn_section_planes_settle(planes);
    r = examine_laid(planes, poses, plane, &sequence, err);
    if (r >= 0)
        r = examine_layout(planes, plane, protocol, poses, densities, sequence, err);
    if (r >= 0 && planes->held_count > 0)
        r = examine_held(planes, poses, plane, sequence, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < sequence->count; i++)
        for (int second = 0; second < 2; second++)
            flag_sections(planes, poses, densities, &sequence->finding[i], second,
                          layout.rows * layout.columns);
    *ret_sequence = gsn_steal(&sequence);
    return GSN_OK;
}

static void say_held(const struct gsn_sequence_finding *f, unsigned slots,
                     char ret_sentence[GSN_POSE_SENTENCE])
{
    const struct section_name a = name_of(f->a, slots), b = name_of(f->b, slots);
    const char *held = f->held[0] ? a.text : b.text, *used = f->held[0] ? b.text : a.text;
    char what[200];

    if (f->held[0] && f->held[1])
        (void)snprintf(what, sizeof what, "both are held: use one of them at most");
    else
        (void)snprintf(what, sizeof what,
                       "section %s is held and %s is used: if %s is the one that belongs where it "
                       "is, %s lies in the place of another",
                       held, used, held, used);
    (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                   "sections %s and %s look like one section, mounted or scanned twice: the best "
                   "quarter of their texture agrees to %.0f %%, that of neighbours to %.0f %%; %s: "
                   "look at both",
                   a.text, b.text, 100 * f->evidence, 100 * f->usual, what);
}

void gsn_section_order_sentence(const struct gsn_sequence_finding *finding, unsigned slots,
                                char ret_sentence[GSN_POSE_SENTENCE])
{
    const struct section_name a = name_of(finding->a, slots), b = name_of(finding->b, slots);

    if (finding->kind == GSN_SEQUENCE_SWAP)
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "sections %s and %s look swapped: each is more like those around the "
                       "other's place than those around its own, by %.1f standard errors together; "
                       "nothing was moved: look at both",
                       a.text, b.text, finding->evidence);
    else if (finding->kind == GSN_SEQUENCE_EXCLUDED_DUPLICATE)
        say_held(finding, slots, ret_sentence);
    else
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "sections %s and %s look like one section, mounted or scanned twice: their "
                       "texture agrees to %.0f %%, that of neighbours to %.0f %%; both are used: "
                       "look at them, and hold the one that is not there",
                       a.text, b.text, 100 * finding->evidence, 100 * finding->usual);
}

int gsn_section_order_blind_to_swaps(const struct gsn_sequence *sequence,
                                     char ret_sentence[GSN_POSE_SENTENCE])
{
    const double *shown = sequence->shown;
    char near[160] = "", most[80] = "";

    ret_sentence[0] = '\0';
    if (sequence->reach == 1)
        return 0;
    if (shown[GSN_SEQUENCE_NEAR - 1] > 0)
        (void)snprintf(
            near, sizeof near,
            " (expected to show: %.0f %% of swaps of neighbours, %.0f %% two apart, %.0f "
            "%% three apart)",
            100 * shown[0], 100 * shown[1], 100 * shown[2]);
    if (sequence->unseen > 0)
        (void)snprintf(most, sizeof most,
                       "; it would carry at most %.2g %% of all density to the other place",
                       100 * sequence->unseen);
    if (sequence->reach > 1)
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "a swap of two sections nearer than %u to each other may not show in their "
                       "tissue%s: their order rests on numbers and slots alone%s",
                       sequence->reach, near, most);
    else
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "a swap of two sections may not show in their tissue%s: their order rests "
                       "on numbers and slots alone%s",
                       near, most);
    return 1;
}

int gsn_section_order_blind_to_duplicates(const struct gsn_sequence *sequence,
                                          char ret_sentence[GSN_POSE_SENTENCE])
{
    ret_sentence[0] = '\0';
    if (sequence->duplicates_known)
        return 0;
    (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                   "a section mounted or scanned twice would not show: neighbours share all that "
                   "could set one apart");
    return 1;
}
