/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_order.h"

#include "pipeline/assembly_parts.h"
#include "pipeline/register/order/seriation.h"
#include "pipeline/register/panel/slots.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

/* The way through the sections is shorter by this many standard errors, or the order stands as it
 * is stated. Errors have long tails, so no probability is claimed: on eleven phantoms of levels L1
 * and L2 and on the Visible Human's axial cuts no other order came nearer to the true one than
 * 2.4 below it, and of these eleven a snake that was called rows showed on ten by 7.7 to 26 (on one
 * with half of its sections missing by 3.9). */
static const double SHORTER = 6;

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

static void flag(struct gsn_assembly_section *s, const struct gsn_sequence_finding *finding,
                 struct section_name other)
{
    char word[40];

    (void)snprintf(word, sizeof word,
                   finding->kind == GSN_SEQUENCE_SWAP ? "swapped-with-%s?" : "same-as-%s?",
                   other.text);
    gsn_assembly_flag(s, word);
}

/* Flags the sections of that number that were compared, laid or held. */
static void flag_all(const struct gsn_section_planes *planes, struct gsn_assembly *a,
                     const struct gsn_sequence_finding *finding, int second, unsigned slots)
{
    const unsigned serial = second ? finding->b : finding->a;
    const unsigned other = second ? finding->a : finding->b;
    const size_t count = finding->held[second] ? planes->held_count : planes->count;

    for (size_t k = 0; k < count; k++) {
        const size_t i = finding->held[second] ? planes->held[k].section : planes->section[k];

        if (a->section[i].seen.serial == serial)
            flag(&a->section[i], finding, name_of(other, slots));
    }
}

static int examine_laid(const struct gsn_section_planes *planes, const struct gsn_assembly *a,
                        struct gsn_sequence_plane *plane, struct gsn_sequence **ret_sequence,
                        struct gsn_error *err)
{
    for (size_t k = 0; k < planes->count; k++)
        plane[k] =
            (struct gsn_sequence_plane){ a->section[planes->section[k]].seen.serial,
                                         planes->density + k * planes->columns * planes->rows };
    return gsn_sequence_examine(plane, planes->count, planes->columns, planes->rows, ret_sequence,
                                err);
}

static int examine_held(const struct gsn_section_planes *planes, const struct gsn_assembly *a,
                        const struct gsn_sequence_plane *plane, struct gsn_sequence *sequence,
                        struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_sequence_excluded) held =
        gsn_alloc_array(planes->held_count, sizeof *held);

    if (!held)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    for (size_t k = 0; k < planes->held_count; k++) {
        const struct gsn_section_apart *s = &planes->held[k];

        held[k] =
            (struct gsn_sequence_excluded){ a->section[s->section].seen.serial, s->columns, s->rows,
                                            s->cell_um / planes->cell_um, s->density };
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
                          const struct gsn_assembly_section *s)
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
    const struct gsn_assembly *a;
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
        s->place[k] =
            (struct place){ serial_as(reading, &s->layout, &s->a->section[s->planes->section[k]]),
                            k };
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

/* ---- single swaps -------------------------------------------------------------------------- */

static size_t plane_of(const struct gsn_sequence_plane *plane, size_t count, unsigned serial)
{
    size_t k = 0;

    while (k < count && plane[k].serial != serial)
        k++;
    return k;
}

/* Share of the pairs so far apart that would show, were they swapped; as much as they now speak
 * against it. */
static double share_shown(const struct gsn_seriation *path, size_t count, size_t apart)
{
    size_t shown = 0, pairs = 0;

    for (size_t i = 0; i + apart < count; i++)
        if (apart > 1 || (i > 0 && i + 2 < count)) {
            shown += gsn_seriation_exchange_gain(path, i, i + apart) < -SHORTER;
            pairs++;
        }
    return pairs ? (double)shown / (double)pairs : 0;
}

/* Sections look swapped where the way through the tissue says so, too: what changes between
 * neighbours is as large as what a fold or a bath does to them, and 4 of 9 specimens in true order
 * had such notes. All of them are dropped where all sections are out of place. */
static void confirm_swaps(const struct gsn_seriation *path,
                          const struct gsn_sequence_plane *plane, size_t count, int misordered,
                          struct gsn_sequence *sequence)
{
    static const double NEARLY_ALL = 0.95;
    size_t kept = 0;

    for (size_t i = 0; i < sequence->count; i++) {
        const struct gsn_sequence_finding *f = &sequence->finding[i];

        if (f->kind != GSN_SEQUENCE_SWAP ||
            (!misordered && gsn_seriation_exchange_gain(path, plane_of(plane, count, f->a),
                                                      plane_of(plane, count, f->b)) > SHORTER))
            sequence->finding[kept++] = *f;
    }
    sequence->count = kept;
    for (size_t f = 1; f <= GSN_SEQUENCE_NEAR; f++)
        sequence->shown[f - 1] = fmin(sequence->shown[f - 1], share_shown(path, count, f));
    for (size_t f = sequence->reach; f > 0 && f < count && share_shown(path, count, f) < NEARLY_ALL;
         f++)
        sequence->reach = f + 1 < count ? (unsigned)f + 1 : 0;
}

static int examine_layout(const struct gsn_section_planes *planes,
                          const struct gsn_sequence_plane *plane,
                          const struct gsn_protocol *protocol, struct gsn_assembly *a,
                          struct gsn_sequence *sequence, struct gsn_error *err)
{
    gsn_auto_mem(struct place) place = gsn_alloc_array(planes->count + 1, sizeof *place);
    gsn_auto_mem(size_t) order = gsn_alloc_array(planes->count + 1, sizeof *order);
    gsn_auto(gsn_seriation) path = NULL;
    struct search search = { .planes = planes,
                             .a = a,
                             .layout = gsn_protocol_layout(protocol),
                             .place = place,
                             .order = order };
    unsigned panels = 0;
    int r;

    if (!place || !order)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    for (size_t k = 0; k < planes->count; k++) {
        const unsigned panel = a->section[planes->section[k]].panel;

        panels = panel > panels ? panel : panels;
    }
    r = gsn_seriation_new(plane, planes->count, planes->columns, planes->rows, &path, err);
    search.path = path;
    if (r >= 0)
        try_all(&search, panels < MOST_PANELS ? panels : MOST_PANELS);
    if (r >= 0 && search.gain > SHORTER)
        say_reading(&search, a->misordered, sizeof a->misordered);
    if (r >= 0)
        confirm_swaps(path, plane, planes->count, a->misordered[0] != '\0', sequence);
    return r;
}

int gsn_section_order_examine(struct gsn_section_planes *planes,
                              const struct gsn_protocol *protocol, struct gsn_assembly *a,
                              struct gsn_sequence **ret_sequence, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_sequence_plane) plane = gsn_alloc_array(planes->count, sizeof *plane);
    gsn_auto(gsn_sequence) sequence = NULL;
    const struct gsn_layout layout = gsn_protocol_layout(protocol);
    int r;

    if (!plane)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    gsn_section_planes_settle(planes);
    r = examine_laid(planes, a, plane, &sequence, err);
    if (r >= 0)
        r = examine_layout(planes, plane, protocol, a, sequence, err);
    if (r >= 0 && planes->held_count > 0)
        r = examine_held(planes, a, plane, sequence, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < sequence->count; i++)
        for (int second = 0; second < 2; second++)
            flag_all(planes, a, &sequence->finding[i], second, layout.rows * layout.columns);
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
                       "sections %s and %s look swapped: from one to the other the tissue changes "
                       "against the way it changes around them, by %.1f standard errors where %.1f "
                       "along it are expected; nothing was moved: look at both",
                       a.text, b.text, finding->against, finding->predicted);
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
