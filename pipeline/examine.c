/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/examine.h"

#include "pipeline/core/parallel.h"
#include "pipeline/register/panel.h"
#include "pipeline/slot_marks.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

struct gsn_layout gsn_protocol_layout(const struct gsn_protocol *protocol)
{
    static const enum gsn_order orders[] = { [GSN_STATED_ROW] = GSN_ORDER_ROW,
                                             [GSN_STATED_COLUMN] = GSN_ORDER_COLUMN,
                                             [GSN_STATED_SNAKE] = GSN_ORDER_SNAKE };

    return (struct gsn_layout){ .rows = protocol->rows,
                                .columns = protocol->columns,
                                .order = orders[protocol->order] };
}

const char *gsn_sighting_name(enum gsn_sighting sighting)
{
    static const char *const names[] = { "found", "needs-eye", "missing", "empty", "held" };

    return names[sighting];
}

static void flag(struct gsn_panel_section *section, const char *word)
{
    const size_t used = strlen(section->flags);

    (void)snprintf(section->flags + used, sizeof section->flags - used, "%s%s", used ? " " : "",
                   word);
}

__attribute__((format(printf, 2, 3))) static void say(struct gsn_panel_findings *findings,
                                                      const char *format, ...)
{
    const size_t used = strlen(findings->note);
    const char *glue = used ? "; " : "";
    char text[200];
    va_list args;

    va_start(args, format);
    (void)vsnprintf(text, sizeof text, format, args);
    va_end(args);
    /* What does not fit is left out whole. */
    if (used + strlen(glue) + strlen(text) < sizeof findings->note)
        (void)snprintf(findings->note + used, sizeof findings->note - used, "%s%s", glue, text);
}

/* The triangle to look for: the protocol's, or what the sections of this panel agree on. */
static int know_triangle(const struct gsn_protocol *protocol,
                         const struct gsn_mark_candidates *candidates, size_t count,
                         struct gsn_triangle_prior *ret_prior, struct gsn_error *err)
{
    struct gsn_triangle_prior prior = { 0 };
    int r;

    if (protocol->has_markers)
        memcpy(prior.mark_um, protocol->markers_um, sizeof prior.mark_um);
    else if ((r = gsn_markers_consensus(candidates, count, &prior, err)) < 0)
        return r;
    r = gsn_markers_learn(candidates, count, &prior, err);
    if (r < 0)
        return r;
    *ret_prior = prior;
    return GSN_OK;
}

/* What the spots of one section say. */
struct sight {
    int mirrored, ambiguous, decided;
};

static int count_found(const struct gsn_mark mark[GSN_MARKS])
{
    return mark[0].found + mark[1].found + mark[2].found;
}

/* Sections whose marks could be others get their candidates. */
static struct sight choose_marks(struct gsn_panel_section *section,
                                 const struct gsn_mark_candidates *candidates,
                                 const struct gsn_triangle_prior *prior)
{
    struct gsn_mark_rival rivals[GSN_MARK_RIVALS];
    struct sight sight = { 0 };
    double score = 0, runner_up = 0;

    gsn_markers_choose(candidates, prior, section->mark, &sight.mirrored, &score, &runner_up);
    sight.ambiguous = score > 0 && runner_up > 0.5 * score;
    if (count_found(section->mark) < GSN_MARKS)
        gsn_candidates_of_rivals(rivals, gsn_markers_rivals(candidates, prior, rivals),
                                 &section->candidates);
    return sight;
}

static void state_marks(struct gsn_panel_section *section, const struct sight *sight)
{
    const int found = count_found(section->mark);

    /* What has grown together is held, whatever its marks. */
    if (section->sighting != GSN_SIGHT_HELD)
        section->sighting =
            found == GSN_MARKS || sight->decided ? GSN_SIGHT_FOUND : GSN_SIGHT_NEEDS_EYE;
    if (found == 2)
        flag(section, sight->mirrored ? "two-marks mirrored" : "two-marks");
    else if (found < 2)
        flag(section, sight->ambiguous ? "ambiguous-marks" : "no-marks");
    if (sight->decided)
        flag(section, "decided");
}

/* ---- which of the candidates a person chose ---------------------------------------------- */

static const struct gsn_panel_answer *pose_said(const struct gsn_panel_answers *answers,
                                                unsigned slot)
{
    for (size_t i = 0; answers && i < answers->count; i++)
        if (answers->at[i].said == GSN_SAID_POSE && answers->at[i].slot == slot)
            return &answers->at[i];
    return NULL;
}

/* A section whose three marks contradict the rest of the stack looks fine on its panel: a person
 * chose some of them. */
static void take_choice(struct gsn_panel_section *section, const struct gsn_panel_answer *answer,
                        struct sight *sight)
{
    unsigned meant;

    if (!answer || answer->elsewhere)
        return;
    if (count_found(section->mark) == GSN_MARKS)
        gsn_candidates_of_marks(section->mark, answer->choice.mirrored, &section->candidates);
    meant = gsn_candidates_meant(&section->candidates, &answer->choice);
    if (meant == 0)
        return;
    section->candidates.chosen = meant;
    memcpy(section->mark, section->candidates.at[meant - 1].mark, sizeof section->mark);
    sight->mirrored = section->candidates.at[meant - 1].mirrored;
    sight->decided = 1;
}

/* Names every choice that could not be applied. */
static void void_choices(const struct gsn_panel_answers *answers,
                         struct gsn_panel_findings *findings)
{
    for (size_t i = 0; i < findings->count; i++) {
        struct gsn_panel_section *section = &findings->section[i];
        const struct gsn_panel_answer *answer = pose_said(answers, (unsigned)i);

        if (!answer || section->candidates.chosen)
            continue;
        flag(section, "decision-void");
        say(findings, "the pose that was chosen for slot %u %s and is not used: choose again",
            section->slot + 1,
            answer->elsewhere ? "was said of another scan" : "fits nothing that is found there");
    }
}

/* Adds where a section with three marks points, laid on the panel's triangle. */
static void add_direction(const struct gsn_panel_section *section, const struct sight *sight,
                          const struct gsn_triangle_prior *prior, double px_um,
                          struct gsn_point *upright)
{
    struct gsn_candidates own;
    const struct gsn_candidate *whole = &own.at[GSN_MARKS];
    struct gsn_point d;

    if (count_found(section->mark) < GSN_MARKS)
        return;
    gsn_candidates_of_marks(section->mark, sight->mirrored, &own);
    gsn_candidates_lay(&own, px_um, prior->mark_um);
    if (!whole->laid)
        return;
    d = gsn_candidate_direction(&whole->panel_to_block_um);
    upright->x += d.x;
    upright->y += d.y;
}

/* Lays all candidates of the panel on its triangle. Upright is the job's frame, or else the way
 * most sections lie. */
static void lay_candidates(const struct gsn_triangle_prior *prior, struct gsn_point upright,
                           double px_um, struct gsn_panel_findings *findings)
{
    for (size_t i = 0; i < findings->count; i++) {
        gsn_candidates_lay(&findings->section[i].candidates, px_um, prior->mark_um);
        gsn_candidates_say(&findings->section[i].candidates, upright);
    }
}

struct search {
    const struct gsn_scan *scan;
    struct gsn_layout layout;
    const struct gsn_absorber *absorber;
    double side;                            /* of the typical section's box, px */
    const struct gsn_slot *slots;           /* those with tissue */
    struct gsn_mark_candidates *candidates; /* one for each */
};

static int search_slot(size_t index, void *context, struct gsn_error *err)
{
    const struct search *search = context;
    const struct gsn_slot *slot = &search->slots[index];
    const int r = gsn_slot_marks(search->scan, search->absorber, &search->layout, search->side,
                                 slot, NULL, &search->candidates[index], err);

    return r < 0 ? gsn_fail_at(err, "slot %u", slot->slot + 1) : GSN_OK;
}

static int count_chosen(const struct gsn_mark_candidates *candidates,
                        const struct gsn_triangle_prior *prior)
{
    struct gsn_mark mark[GSN_MARKS];

    gsn_markers_choose(candidates, prior, mark, NULL, NULL, NULL);
    return count_found(mark);
}

/* Where marks are missing, the section is searched again for spots that look like those of the
 * panel's others. */
static int seek_again(const struct search *search, size_t index,
                      const struct gsn_triangle_prior *prior, struct gsn_error *err)
{
    const struct gsn_slot *slot = &search->slots[index];
    const int before = count_chosen(&search->candidates[index], prior);
    struct gsn_mark_candidates again;
    int r;

    if (before == GSN_MARKS || !prior->learnt)
        return GSN_OK;
    r = gsn_slot_marks(search->scan, search->absorber, &search->layout, search->side, slot, prior,
                       &again, err);
    if (r < 0)
        return gsn_fail_at(err, "slot %u", slot->slot + 1);
    if (count_chosen(&again, prior) > before)
        search->candidates[index] = again;
    return GSN_OK;
}

/* ---- whether the pixels are as large as stated ------------------------------------------- */

/* Sides of a triangle from the shortest to the longest. */
static void sides_of(const struct gsn_point mark[GSN_MARKS], double side[3])
{
    for (int i = 0; i < 3; i++)
        side[i] = hypot(mark[(i + 1) % 3].x - mark[i].x, mark[(i + 1) % 3].y - mark[i].y);
    for (int i = 0; i < 2; i++)
        for (int k = 0; k < 2 - i; k++)
            if (side[k] > side[k + 1]) {
                const double kept = side[k];

                side[k] = side[k + 1];
                side[k + 1] = kept;
            }
}

/* How many times larger the known triangle is than the one seen; 0 when they differ in shape by
 * more than sections stretch. */
static double scale_of(const struct gsn_point known[GSN_MARKS],
                       const struct gsn_point seen[GSN_MARKS])
{
    static const double STRETCH = 0.05;
    double a[3], b[3], low = INFINITY, high = 0;

    sides_of(known, a);
    sides_of(seen, b);
    for (int i = 0; i < 3; i++) {
        low = fmin(low, a[i] / b[i]);
        high = fmax(high, a[i] / b[i]);
    }
    return low > 0 && high / low < 1 + STRETCH ? 0.5 * (low + high) : 0;
}

/* The pixel size at which the sections agree on the job's triangle, when that is far from the one
 * stated; 0: they agree at none. Burns of 40 to 150 um are looked for, so steps of 2 miss none. */
static int pixels_by_marks(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                           const struct gsn_slot *found, size_t count, unsigned threads,
                           double *ret_px_um, struct gsn_error *err)
{
    static const double times[] = { 0.5, 2, 0.25, 4, 0.125, 8 };
    gsn_auto_mem(struct gsn_mark_candidates) candidates =
        gsn_alloc_array(count, sizeof *candidates);
    gsn_auto_mem(double) scratch = gsn_alloc_array(count, sizeof *scratch);
    gsn_auto(gsn_absorber) absorber = NULL;
    double side;
    int r = gsn_absorber_new(scan->picture->image, &scan->glass, &absorber, err);

    if (r < 0)
        return r;
    if (!candidates || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    side = gsn_slot_typical_side(found, count, scratch);
    *ret_px_um = 0;
    for (size_t i = 0; i < sizeof times / sizeof times[0]; i++) {
        struct gsn_scan other = *scan;
        struct search search = { &other,    gsn_protocol_layout(protocol), absorber, side, found,
                                 candidates };
        struct gsn_triangle_prior seen = { 0 };
        double scale;

        other.px_um = scan->px_um * times[i];
        r = gsn_parallel_for(count, threads, search_slot, &search, err);
        if (r >= 0)
            r = gsn_markers_consensus(candidates, count, &seen, err);
        if (r == GSN_E_NOMEM)
            return r;
        scale = r >= 0 ? scale_of(protocol->markers_um, seen.mark_um) : 0;
        if (!(scale > 0))
            continue;
        *ret_px_um = scale * other.px_um;
        return GSN_OK;
    }
    return GSN_OK;
}

/* Sections that show no marks where the job knows their triangle: perhaps they are there, and the
 * pixels are not as large as stated. A person puts that right, since all lengths hang on it. */
static int check_pixels(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                        const struct gsn_slot *found, size_t count, unsigned threads,
                        const struct gsn_panel_findings *findings, struct gsn_error *err)
{
    struct gsn_error quiet = { 0 };
    size_t marked = 0;
    double px_um = 0;
    int r;

    for (size_t i = 0; i < findings->count; i++)
        marked += findings->section[i].sighting == GSN_SIGHT_FOUND;
    if (!protocol->has_markers || count < 3 || 3 * marked >= count)
        return GSN_OK;
    r = pixels_by_marks(scan, protocol, found, count, threads, &px_um, &quiet);
    if (r < 0)
        return gsn_fail(err, r, "%s", quiet.text);
    if (!(px_um > 0))
        return GSN_OK;
    return gsn_fail(err, GSN_E_WITHHELD,
                    "%s states pixels of %.4g um, but by the triangle of its marks they are %.4g "
                    "um: put \"px_um\" (or \"markers_um\") in job.json right and import it again "
                    "with --replace",
                    protocol->px_um > 0 ? "job.json" : "the file", scan->px_um, px_um);
}

/* Marks of all sections of the panel: found slots and their numbers in findings. A panel whose
 * sections agree on no triangle is no failure: its sections need a person's eye. */
static int find_marks(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                      const struct gsn_slot *found, size_t count,
                      const struct gsn_panel_answers *answers, unsigned threads,
                      struct gsn_panel_findings *findings, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_mark_candidates) candidates =
        gsn_alloc_array(count, sizeof *candidates);
    gsn_auto_mem(double) scratch = gsn_alloc_array(count, sizeof *scratch);
    gsn_auto(gsn_absorber) absorber = NULL;
    struct search search = { scan, gsn_protocol_layout(protocol), NULL, 0, found, candidates };
    struct gsn_triangle_prior prior;
    struct gsn_point upright = { protocol->has_markers, 0 };
    size_t mirrored = 0;
    int agreed, r;

    if (!candidates || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    r = gsn_absorber_new(scan->picture->image, &scan->glass, &absorber, err);
    if (r < 0)
        return r;
    search.absorber = absorber;
    search.side = gsn_slot_typical_side(found, count, scratch);
    r = gsn_parallel_for(count, threads, search_slot, &search, err);
    if (r < 0)
        return r;
    r = know_triangle(protocol, candidates, count, &prior, err);
    if (r < 0 && r != GSN_E_MARKERS)
        return r;
    agreed = r >= 0;
    for (size_t i = 0; i < count; i++) {
        struct gsn_panel_section *section = &findings->section[found[i].slot];
        struct sight sight = { 0 };

        r = agreed ? seek_again(&search, i, &prior, err) : GSN_OK;
        if (r < 0)
            return r;
        if (agreed)
            sight = choose_marks(section, &candidates[i], &prior);
        mirrored += sight.mirrored && count_found(section->mark) == GSN_MARKS;
        if (agreed && !protocol->has_markers)
            add_direction(section, &sight, &prior, scan->px_um, &upright);
        if (section->sighting != GSN_SIGHT_HELD)
            take_choice(section, pose_said(answers, section->slot), &sight);
        state_marks(section, &sight);
    }
    void_choices(answers, findings);
    if (agreed)
        lay_candidates(&prior, upright, scan->px_um, findings);
    if (protocol->has_markers && 2 * mirrored > count)
        say(findings,
            "%zu of %zu sections are mirrored against the job's \"markers_um\": if no label says "
            "which way round the panel is, look at the scanner's settings",
            mirrored, count);
    return GSN_OK;
}

static void take_slots(struct gsn_panel_findings *findings, const struct gsn_slot *slots,
                       const struct gsn_protocol *protocol, unsigned number)
{
    const struct gsn_layout layout = gsn_protocol_layout(protocol);

    for (size_t i = 0; i < findings->count; i++) {
        const unsigned serial = gsn_panel_serial(number, slots[i].slot, &layout);
        const unsigned expected = gsn_protocol_sections(protocol);
        struct gsn_panel_section *section = &findings->section[i];

        *section = (struct gsn_panel_section){ .serial = serial,
                                               .slot = slots[i].slot,
                                               .sighting = GSN_SIGHT_NEEDS_EYE,
                                               .x = slots[i].x,
                                               .y = slots[i].y,
                                               .width = slots[i].width,
                                               .height = slots[i].height,
                                               .area_px = slots[i].area_px };
        if (!slots[i].found)
            section->sighting =
                expected && serial >= expected ? GSN_SIGHT_EMPTY : GSN_SIGHT_MISSING;
        else if (slots[i].touching)
            section->sighting = GSN_SIGHT_HELD;
        if (slots[i].touching)
            flag(section, "touching");
        if (slots[i].parted)
            flag(section, "parted");
        if (slots[i].found && slots[i].doubtful)
            section->sighting = GSN_SIGHT_HELD;
        if (slots[i].doubtful)
            flag(section, "between-slots");
        if (slots[i].lost > 0)
            flag(section, "over-edge");
    }
}

static void note_slots(struct gsn_panel_findings *findings, const struct gsn_slot *slots)
{
    size_t found = 0;

    for (size_t i = 0; i < findings->count; i++) {
        const struct gsn_slot *s = &slots[i];

        found += s->found != 0;
        /* Each pair once, by the first that names it. */
        if (s->touching && (s->touched > s->slot || slots[s->touched].touched != s->slot))
            say(findings,
                "the sections in slots %u and %u have grown together and are held: cut along the "
                "line from (%.0f, %.0f) to (%.0f, %.0f) px, or mount them again",
                s->slot + 1, s->touched + 1, s->cut_px[0].x, s->cut_px[0].y, s->cut_px[1].x,
                s->cut_px[1].y);
        if (s->parted && s->touched > s->slot)
            say(findings,
                "the sections in slots %u and %u touch and were cut apart along the line from "
                "(%.0f, %.0f) to (%.0f, %.0f) px",
                s->slot + 1, s->touched + 1, s->cut_px[0].x, s->cut_px[0].y, s->cut_px[1].x,
                s->cut_px[1].y);
        if (s->found && s->doubtful)
            say(findings,
                "the section in slot %u lies between slots %u and %u and is held: say which is its "
                "own",
                s->slot + 1, s->slot + 1, s->rival + 1);
        if (s->lost > 0)
            say(findings,
                "the section in slot %u runs over the edge: %.0f %% of its tissue is lost",
                s->slot + 1, 100 * s->lost);
    }
    if (found == 0)
        say(findings, "no tissue on this panel");
}

/* ---- what a person decided --------------------------------------------------------------- */

static unsigned first_said(const struct gsn_panel_answers *answers, size_t slots)
{
    for (size_t i = 0; answers && i < answers->count; i++)
        if (answers->at[i].said == GSN_SAID_FIRST && answers->at[i].to < slots)
            return answers->at[i].to;
    return GSN_SLOT_UNSAID;
}

/* Both sections of a neck, whichever of them was named. */
static void decide_cut(struct gsn_slot *slots, struct gsn_slot *slot, int cut)
{
    struct gsn_slot *other = &slots[slot->touched];

    if (!slot->touching && !slot->parted)
        return;
    slot->parted = cut;
    slot->touching = !cut;
    if (other->touched == slot->slot && (other->touching || other->parted)) {
        other->parted = cut;
        other->touching = !cut;
    }
}

/* A section moves to the slot that is its own, if that is free. */
static void decide_seat(struct gsn_slot *slots, struct gsn_slot *slot, unsigned to)
{
    struct gsn_slot moved = *slot;

    if (!slot->doubtful || (to != slot->slot && slots[to].found))
        return;
    moved.doubtful = 0;
    moved.rival = 0;
    moved.slot = to;
    moved.row = slots[to].row;
    moved.column = slots[to].column;
    *slot = (struct gsn_slot){ .slot = slot->slot, .row = slot->row, .column = slot->column };
    slots[to] = moved;
}

static int lies_in(const struct gsn_scrap *scrap, struct gsn_point at)
{
    return at.x >= scrap->x && at.x < scrap->x + scrap->width && at.y >= scrap->y &&
           at.y < scrap->y + scrap->height;
}

static void seat_scrap(struct gsn_slot *slots, const struct gsn_scrap *scrap, unsigned to)
{
    struct gsn_slot *slot = &slots[to];

    if (slot->found)
        return;
    slot->found = 1;
    slot->x = scrap->x;
    slot->y = scrap->y;
    slot->width = scrap->width;
    slot->height = scrap->height;
    slot->area_px = scrap->area_px;
    slot->centre_px =
        (struct gsn_point){ scrap->x + 0.5 * scrap->width, scrap->y + 0.5 * scrap->height };
}

/* The answer about this scrap, or NULL. */
static const struct gsn_panel_answer *answer_for(const struct gsn_panel_answers *answers,
                                                 size_t slots, const struct gsn_scrap *scrap)
{
    for (size_t i = 0; answers && i < answers->count; i++)
        if (answers->at[i].slot >= slots && lies_in(scrap, answers->at[i].at_px) &&
            (answers->at[i].said == GSN_SAID_DISMISS ||
             (answers->at[i].said == GSN_SAID_SEAT && answers->at[i].to < slots)))
            return &answers->at[i];
    return NULL;
}

static void apply_answers(const struct gsn_panel_answers *answers, struct gsn_slot *slots,
                          size_t count, const struct gsn_scrap *scraps, size_t scrap_count)
{
    for (size_t i = 0; answers && i < answers->count; i++) {
        const struct gsn_panel_answer *answer = &answers->at[i];

        if (answer->slot >= count)
            continue;
        if (answer->said == GSN_SAID_CUT || answer->said == GSN_SAID_HOLD)
            decide_cut(slots, &slots[answer->slot], answer->said == GSN_SAID_CUT);
        if (answer->said == GSN_SAID_SEAT && answer->to < count)
            decide_seat(slots, &slots[answer->slot], answer->to);
    }
    for (size_t i = 0; i < scrap_count; i++) {
        const struct gsn_panel_answer *answer = answer_for(answers, count, &scraps[i]);

        if (answer && answer->said == GSN_SAID_SEAT && scraps[i].inside_grid)
            seat_scrap(slots, &scraps[i], answer->to);
    }
}

/* ------------------------------------------------------------------------------------------ */

/* Pieces among the slots that no section claims: rows of their own, for a person to look at. What
 * lies outside the grid is a label. */
static int take_scraps(struct gsn_panel_findings *findings, const struct gsn_scrap *scraps,
                       size_t count, const struct gsn_panel_answers *answers, struct gsn_error *err)
{
    size_t held = 0;

    struct gsn_panel_section *longer =
        gsn_realloc_array(findings->section, findings->count + count, sizeof *longer);
    const size_t slots = findings->count;

    if (!longer)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the pieces of a panel");
    findings->section = longer;
    for (size_t i = 0; i < count; i++) {
        struct gsn_panel_section *section = &findings->section[findings->count];

        if (!scraps[i].inside_grid)
            continue;
        *section = (struct gsn_panel_section){ .serial = GSN_NO_SERIAL,
                                               .slot = (unsigned)findings->count,
                                               .sighting = GSN_SIGHT_HELD,
                                               .x = scraps[i].x,
                                               .y = scraps[i].y,
                                               .width = scraps[i].width,
                                               .height = scraps[i].height,
                                               .area_px = scraps[i].area_px };
        flag(section, "scrap");
        if (answer_for(answers, slots, &scraps[i])) {
            section->sighting = GSN_SIGHT_EMPTY;
            flag(section, "decided");
        }
        held += section->sighting == GSN_SIGHT_HELD;
        findings->count++;
    }
    if (held > 0)
        say(findings, "%zu piece%s between the slots belong%s to no section: held", held,
            held == 1 ? "" : "s", held == 1 ? "s" : "");
    return GSN_OK;
}

/* "GVP-D-S01-P03" is panel 3 of "GVP-D-S01". */
static int read_label(struct gsn_panel_findings *findings, const char *text)
{
    const char *dash = strrchr(text, '-');
    unsigned number = 0;

    if (!dash || dash == text || (dash[1] != 'P' && dash[1] != 'p') || !dash[2])
        return 0;
    for (const char *c = dash + 2; *c; c++) {
        if (*c < '0' || *c > '9' || number > 10000)
            return 0;
        number = 10 * number + (unsigned)(*c - '0');
    }
    findings->label_number = number;
    (void)snprintf(findings->label, sizeof findings->label, "%s", text);
    (void)snprintf(findings->label_subject, sizeof findings->label_subject, "%.*s",
                   (int)(dash - text), text);
    return number > 0;
}

/* A label that cannot be read is shown where it is; what it is printed on lies beside the slots. */
static void note_label(const struct gsn_picture *picture, const struct gsn_scrap *scraps,
                       size_t count, struct gsn_panel_findings *findings)
{
    int x0 = INT_MAX, y0 = INT_MAX, x1 = 0, y1 = 0;

    for (unsigned i = 0; i < picture->code_count; i++)
        if (read_label(findings, picture->code[i].text))
            return;
    for (size_t i = 0; i < count; i++) {
        const struct gsn_scrap *s = &scraps[i];

        if (s->inside_grid)
            continue;
        x0 = s->x < x0 ? s->x : x0;
        y0 = s->y < y0 ? s->y : y0;
        x1 = s->x + s->width > x1 ? s->x + s->width : x1;
        y1 = s->y + s->height > y1 ? s->y + s->height : y1;
    }
    if (picture->code_count > 0)
        say(findings, "its label says \"%s\", which names no panel", picture->code[0].text);
    else if (x1 > 0)
        say(findings,
            "no code could be read on its label: compare what is written from (%d, %d) to (%d, %d) "
            "px",
            x0, y0, x1, y1);
}

static int examine(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                   unsigned number, const struct gsn_panel_answers *answers, unsigned threads,
                   const struct gsn_progress *progress, struct gsn_panel_findings *findings,
                   struct gsn_error *err)
{
    const struct gsn_layout layout = gsn_protocol_layout(protocol);
    gsn_auto_mem(struct gsn_slot) slots = gsn_alloc_array(findings->count, sizeof *slots);
    gsn_auto_mem(struct gsn_scrap) scraps = NULL;
    size_t scrap_count = 0, found = 0;
    struct gsn_error wrong = { 0 };
    int r;

    if (!slots)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the slots of a panel");
    gsn_progress_say(progress, "splitting", 0, 1);
    r = gsn_panel_split(scan->total, scan->step, &layout, scan->px_um,
                        first_said(answers, findings->count), slots, &scraps, &scrap_count, err);
    if (r < 0)
        return r;
    apply_answers(answers, slots, findings->count, scraps, scrap_count);
    take_slots(findings, slots, protocol, number);
    note_slots(findings, slots);
    for (size_t i = 0; i < findings->count; i++)
        if (slots[i].found && !slots[i].doubtful)
            slots[found++] = slots[i];
    note_label(scan->picture, scraps, scrap_count, findings);
    r = take_scraps(findings, scraps, scrap_count, answers, err);
    if (r < 0)
        return r;
    gsn_progress_say(progress, "marks", 0, found);
    r = find_marks(scan, protocol, slots, found, answers, threads, findings, err);
    /* Pixels too large for marks may only be said to be. */
    if (r == GSN_E_INPUT &&
        check_pixels(scan, protocol, slots, found, threads, findings, &wrong) == GSN_E_WITHHELD)
        return gsn_fail(err, GSN_E_WITHHELD, "%s", wrong.text);
    return r < 0 ? r : check_pixels(scan, protocol, slots, found, threads, findings, err);
}

int gsn_panel_examine(const char *decoder, const void *bytes, size_t size,
                      const struct gsn_protocol *protocol, unsigned number,
                      const struct gsn_panel_answers *answers, unsigned threads,
                      const struct gsn_progress *progress, struct gsn_panel_findings **ret_findings,
                      struct gsn_error *err)
{
    gsn_auto(gsn_panel_findings) findings = gsn_alloc_array(1, sizeof *findings);
    gsn_auto(gsn_scan) scan = NULL;
    int r;

    if (findings)
        findings->count = (size_t)protocol->rows * protocol->columns;
    if (findings)
        findings->section = gsn_alloc_array(findings->count, sizeof *findings->section);
    if (!findings || !findings->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a panel");
    gsn_progress_say(progress, "decoding", 0, 1);
    r = gsn_scan_survey(decoder, bytes, size, protocol, &scan, err);
    if (r < 0)
        return r;
    findings->width = scan->picture->image->width;
    findings->height = scan->picture->image->height;
    findings->px_um = scan->px_um;
    (void)snprintf(findings->note, sizeof findings->note, "%s%s%s", scan->picture->note,
                   scan->picture->note[0] && scan->note[0] ? "; " : "", scan->note);
    r = examine(scan, protocol, number, answers, threads, progress, findings, err);
    if (r < 0)
        return r;
    *ret_findings = gsn_steal(&findings);
    return GSN_OK;
}

void gsn_panel_findings_free(struct gsn_panel_findings *findings)
{
    if (!findings)
        return;
    gsn_free(findings->section);
    gsn_free(findings);
}
