/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Analyses one panel: which slot holds which section, what its label says, where the marks are.
 *
 * 1. The panel is surveyed, set upright and split into the slots of its layout (register/panel.h).
 * 2. What a person decided is applied: cuts, holds, pieces that belong to a slot.
 * 3. Slots become sections with a sighting; pieces between the slots become scraps; the label's
 * text is read or its place is told.
 * 4. Marks: candidates of all sections (fiducial_search.h), the triangle of the job or the one that
 *    most sections agree on, the best assignment in each section, and rivals where it is in doubt.
 *    Sections that lack marks are searched again for spots that look like the panel's others.
 * 5. Two checks on the whole panel: do three of four sections lie mirrored or turned against the
 *    job's triangle (then the panel lies otherwise than its label says), and do the sections agree
 * on the triangle at another pixel size than is stated.
 *
 * A section in doubt is a state, a panel in doubt fails with GSN_E_WITHHELD and a sentence that
 * says what to do. Sections agreeing on no triangle are no failure: each needs a person's eye. */
#include "pipeline/specimen/panel_analysis.h"

#include "pipeline/core/parallel.h"
#include "pipeline/register/fiducial/correspondence.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/fiducial/learn.h"
#include "pipeline/register/fiducial/triangle.h"
#include "pipeline/register/panel/slots.h"
#include "pipeline/specimen/fiducial_search.h"
#include "pipeline/specimen/orientation.h"
#include "pipeline/stain/artefact/dust.h"
#include "pipeline/stain/optical_density.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* Adds a sentence to the panel's note; one that does not fit is left out whole. */
static void add_note(struct gsn_panel_findings *findings, const char *format, ...)
    __attribute__((format(printf, 2, 3)));
static void add_note(struct gsn_panel_findings *findings, const char *format, ...)
{
    const size_t used = strlen(findings->note);
    const char *glue = used ? "; " : "";
    char text[200];
    va_list args;

    va_start(args, format);
    (void)vsnprintf(text, sizeof text, format, args);
    va_end(args);
    if (used + strlen(glue) + strlen(text) < sizeof findings->note)
        (void)snprintf(findings->note + used, sizeof findings->note - used, "%s%s", glue, text);
}

/* ---- what a person decided ------------------------------------------------------------------ */

/* Whether a person said this of the panel as a whole. */
static int has_answer(const struct gsn_panel_answers *answers, enum gsn_panel_said said)
{
    for (size_t i = 0; answers && i < answers->count; i++)
        if (answers->at[i].said == said)
            return 1;
    return 0;
}

/* The slot that a person said is the panel's first of tissue; GSN_SLOT_UNSAID: nobody did. */
static unsigned find_first_answer(const struct gsn_panel_answers *answers, size_t slots)
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

/* borrows: the answer about this scrap, or NULL. */
static const struct gsn_panel_answer *find_scrap_answer(const struct gsn_panel_answers *answers,
                                                        size_t slots, const struct gsn_scrap *scrap)
{
    for (size_t i = 0; answers && i < answers->count; i++)
        if (answers->at[i].slot >= slots && lies_in(scrap, answers->at[i].at_px) &&
            (answers->at[i].said == GSN_SAID_DISMISS ||
             (answers->at[i].said == GSN_SAID_SEAT && answers->at[i].to < slots)))
            return &answers->at[i];
    return NULL;
}

/* Cuts, holds and seats the sections and scraps that a person spoke of. */
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
        const struct gsn_panel_answer *answer = find_scrap_answer(answers, count, &scraps[i]);

        if (answer && answer->said == GSN_SAID_SEAT && scraps[i].inside_grid)
            seat_scrap(slots, &scraps[i], answer->to);
    }
}

/* ---- the marks of the sections --------------------------------------------------------------- */

/* The triangle to look for: the protocol's, or what the sections of this panel agree on. */
static int know_triangle(const struct gsn_protocol *protocol,
                         const struct gsn_fiducial_candidates *candidates, size_t count,
                         struct gsn_triangle_prior *ret_prior, struct gsn_error *err)
{
    struct gsn_triangle_prior prior = { 0 };
    int r;

    if (protocol->has_markers)
        memcpy(prior.mark_um, protocol->markers_um, sizeof prior.mark_um);
    else if ((r = gsn_fiducials_vote_triangle(candidates, count, &prior, err)) < 0)
        return r;
    r = gsn_fiducials_learn(candidates, count, &prior, err);
    if (r < 0)
        return r;
    *ret_prior = prior;
    return GSN_OK;
}

enum { FEWEST_TURNED = 3 };

/* What the spots of one section say. */
struct sight {
    int mirrored, ambiguous, decided;
};

static int count_found(const struct gsn_fiducial mark[GSN_FIDUCIALS])
{
    return mark[0].found + mark[1].found + mark[2].found;
}

/* Sections whose marks could be others get their candidates. */
static struct sight choose_marks(struct gsn_panel_section *section,
                                 const struct gsn_fiducial_candidates *candidates,
                                 const struct gsn_triangle_prior *prior)
{
    struct gsn_fiducial_hypothesis rivals[GSN_FIDUCIAL_HYPOTHESES];
    struct sight sight = { 0 };
    double score = 0, runner_up = 0;

    gsn_fiducials_match(candidates, prior, section->mark, &sight.mirrored, &score, &runner_up);
    sight.ambiguous = score > 0 && 20 * runner_up > score;
    if (count_found(section->mark) < GSN_FIDUCIALS)
        gsn_candidates_of_rivals(rivals, gsn_fiducials_hypotheses(candidates, prior, rivals),
                                 &section->candidates);
    return sight;
}

static void state_marks(struct gsn_panel_section *section, const struct sight *sight)
{
    const int found = count_found(section->mark);

    /* What has grown together is held, whatever its marks. */
    if (section->sighting != GSN_SIGHT_HELD)
        section->sighting =
            found == GSN_FIDUCIALS || sight->decided ? GSN_SIGHT_FOUND : GSN_SIGHT_NEEDS_EYE;
    if (found == 2)
        gsn_flags_add(&section->flags, GSN_FLAG_TWO_MARKS);
    else if (found < 2)
        gsn_flags_add(&section->flags,
                      sight->ambiguous ? GSN_FLAG_AMBIGUOUS_MARKS : GSN_FLAG_NO_MARKS);
    if (found == 2 && sight->mirrored)
        gsn_flags_add(&section->flags, GSN_FLAG_MIRRORED);
    if (sight->decided)
        gsn_flags_add(&section->flags, GSN_FLAG_DECIDED);
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
    if (count_found(section->mark) == GSN_FIDUCIALS)
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
        gsn_flags_add(&section->flags, GSN_FLAG_DECISION_VOID);
        add_note(findings, "the pose that was chosen for slot %u %s and is not used: choose again",
                 section->slot + 1,
                 answer->elsewhere ? "was said of another scan"
                                   : "fits nothing that is found there");
    }
}

/* Adds where a section with three marks points, laid on the panel's triangle. */
static void add_direction(const struct gsn_panel_section *section, const struct sight *sight,
                          const struct gsn_triangle_prior *prior, double px_um,
                          struct gsn_point *upright)
{
    struct gsn_candidates own;
    const struct gsn_candidate *whole = &own.at[GSN_FIDUCIALS];
    struct gsn_point d;

    if (count_found(section->mark) < GSN_FIDUCIALS)
        return;
    gsn_candidates_of_marks(section->mark, sight->mirrored, &own);
    gsn_candidates_lay(&own, px_um, prior->mark_um);
    if (!whole->laid)
        return;
    d = gsn_candidate_direction(&whole->panel_to_block_um);
    upright->x += d.x;
    upright->y += d.y;
}

/* Whether a section with three marks lies turned by more than a quarter against the triangle's
 * frame. */
static int is_turned(const struct gsn_panel_section *section, const struct sight *sight,
                     const struct gsn_triangle_prior *prior, double px_um)
{
    struct gsn_point way = { 0, 0 };

    add_direction(section, sight, prior, px_um, &way);
    return way.x < 0;
}

/* How the sections with three marks lie against the job's triangle. */
struct lie {
    size_t marked, mirrored, turned;
};

/* Sections are mounted one by one, so so many do not lie the wrong way round by chance. */
static int is_most(size_t count, const struct lie *lie)
{
    return count >= FEWEST_TURNED && 4 * count >= 3 * lie->marked;
}

/* What the label says, as the first half of a sentence. */
static const char *label_words(const struct gsn_scan *scan, const struct gsn_dust_turn *left)
{
    const struct gsn_dust_turn *turn = &scan->upright.turn;

    if (!gsn_orientation_is_coded(scan->picture))
        return "no code was read on its label";
    if (left->mirrored)
        return turn->mirrored ? "the code on its label is mirrored" : "its label is not mirrored";
    return turn->quarters == 2 ? "the code on its label stands on its head"
                               : "the code on its label stands upright";
}

/* The label sets the panel upright, the marks of its sections say whether it is: neither decides
 * alone, since a label may be stuck on its head, and a laboratory may mount all sections turned.
 * A triangle drawn with y up is mirrored top to bottom, which is mirrored and turned by half. */
static int check_way_round(const struct gsn_scan *scan, const struct lie *lie,
                           const struct gsn_panel_answers *answers,
                           struct gsn_panel_findings *findings, struct gsn_error *err)
{
    const struct gsn_dust_turn left = { is_most(lie->mirrored, lie),
                                        is_most(lie->turned, lie) ? 2 : 0 };
    const char *label = label_words(scan, &left);

    if (!left.mirrored && !left.quarters) {
        if (2 * lie->mirrored > lie->marked)
            add_note(findings, "%zu of %zu sections are mirrored against the job's \"markers_um\"",
                     lie->mirrored, lie->marked);
        return GSN_OK;
    }
    if (has_answer(answers, GSN_SAID_AS_SET)) {
        add_note(findings, "used as it was set upright, against its marks, as was decided");
        return GSN_OK;
    }
    findings->against = left;
    if (left.mirrored && left.quarters)
        return gsn_fail(
            err, GSN_E_WITHHELD,
            "%zu of %zu sections are mirrored top to bottom against \"markers_um\" (%s):"
            " are the markers' y pointing up? In job.json y points down, as in the "
            "scan: turn the sign of every y and import again with --replace; or decide "
            "as-marked (turn the picture so) or as-set (all sections lie face down)",
            lie->mirrored, lie->marked, label);
    if (left.mirrored)
        return gsn_fail(err, GSN_E_WITHHELD,
                        "%zu of %zu sections are mirrored against \"markers_um\", but %s: are the "
                        "markers' x pointing left, or does the scanner mirror? Put it right and "
                        "import again; or decide as-marked (mirror the picture) or as-set (all "
                        "sections lie face down)",
                        lie->mirrored, lie->marked, label);
    return gsn_fail(
        err, GSN_E_WITHHELD,
        "%s, but by \"markers_um\" the marks of %zu of %zu sections then lie on theirs: "
        "the label is stuck on its head, or all sections are. Turned by half, sections "
        "count backwards: look at the glass, then decide as-marked (by its marks) or "
        "as-set (by its label, or as it was scanned)",
        label, lie->turned, lie->marked);
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
    struct gsn_fiducial_search in;
    struct gsn_fiducial_candidates *candidates; /* one for each section */
};

static int search_slot(size_t index, void *context, struct gsn_error *err)
{
    const struct search *search = context;
    const struct gsn_fiducial_search *in = &search->in;
    const struct gsn_slot *slot = &in->slots[index];
    const int r = gsn_fiducial_search_section(in->scan, in->absorber, &in->layout, in->side, slot,
                                              0, NULL, &search->candidates[index], err);

    return r < 0 ? gsn_fail_at(err, "slot %u", slot->slot + 1) : GSN_OK;
}

static int count_chosen(const struct gsn_fiducial_candidates *candidates,
                        const struct gsn_triangle_prior *prior)
{
    struct gsn_fiducial mark[GSN_FIDUCIALS];

    gsn_fiducials_match(candidates, prior, mark, NULL, NULL, NULL);
    return count_found(mark);
}

/* Where marks are missing, the section is searched again for spots that look like those of the
 * panel's others. */
static int seek_again(const struct search *search, size_t index,
                      const struct gsn_triangle_prior *prior, struct gsn_error *err)
{
    const struct gsn_fiducial_search *in = &search->in;
    const struct gsn_slot *slot = &in->slots[index];
    const int before = count_chosen(&search->candidates[index], prior);
    struct gsn_fiducial_candidates again;
    int r;

    if (before == GSN_FIDUCIALS || !prior->learnt)
        return GSN_OK;
    r = gsn_fiducial_search_section(in->scan, in->absorber, &in->layout, in->side, slot, 0, prior,
                                    &again, err);
    if (r < 0)
        return gsn_fail_at(err, "slot %u", slot->slot + 1);
    if (count_chosen(&again, prior) > before)
        search->candidates[index] = again;
    return GSN_OK;
}

/* ---- whether the pixels are as large as stated ------------------------------------------- */

/* Sides of a triangle from the shortest to the longest. */
static void sides_of(const struct gsn_point mark[GSN_FIDUCIALS], double side[3])
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
static double scale_of(const struct gsn_point known[GSN_FIDUCIALS],
                       const struct gsn_point seen[GSN_FIDUCIALS])
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
 * stated; 0: they agree at none. Burns of the ordinary kind span a factor of 3.75, so steps of 2
 * miss none. */
static int pixels_by_marks(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                           const struct gsn_slot *found, size_t count, unsigned threads,
                           double *ret_px_um, struct gsn_error *err)
{
    static const double times[] = { 0.5, 2, 0.25, 4, 0.125, 8 };
    /* Sections swell and shrink by some per cent. */
    static const double SAME = 0.1;
    gsn_auto_mem(struct gsn_fiducial_candidates) candidates =
        gsn_alloc_array(count, sizeof *candidates);
    gsn_auto_mem(double) scratch = gsn_alloc_array(count, sizeof *scratch);
    gsn_auto(gsn_od_reader) absorber = NULL;
    double side;
    int r = gsn_od_reader_new(scan->picture->image, &scan->glass, &absorber, err);

    if (r < 0)
        return r;
    if (!candidates || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    side = gsn_fiducial_search_side(found, count, scratch);
    *ret_px_um = 0;
    for (size_t i = 0; i < sizeof times / sizeof times[0]; i++) {
        struct gsn_scan other = *scan;
        struct search search = { { &other, absorber, gsn_protocol_layout(protocol), side, found,
                                   count, threads },
                                 candidates };
        struct gsn_triangle_prior seen = { 0 };
        double scale;

        other.px_um = scan->px_um * times[i];
        r = gsn_parallel_for(count, threads, search_slot, &search, err);
        if (r >= 0)
            r = gsn_fiducials_vote_triangle(candidates, count, &seen, err);
        if (r == GSN_E_NOMEM)
            return r;
        scale = r >= 0 ? scale_of(protocol->markers_um, seen.mark_um) : 0;
        /* Of the size that is stated: other burns than those looked for, and no other pixels. */
        if (!(scale > 0) || fabs(scale * times[i] - 1) < SAME)
            continue;
        *ret_px_um = scale * other.px_um;
        return GSN_OK;
    }
    return GSN_OK;
}

/* Sections that show no marks where the job knows their triangle: perhaps they are there, and the
 * pixels are not as large as stated. A person puts that right, since all lengths hang on it. */
static int check_pixel_size(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                            const struct gsn_slot *found, size_t count, unsigned threads,
                            const struct gsn_panel_findings *findings, struct gsn_error *err)
{
    struct gsn_error quiet = { 0 };
    size_t marked = 0;
    double px_um = 0;
    int r;

    for (size_t i = 0; i < findings->count; i++)
        marked += findings->section[i].sighting == GSN_SIGHT_FOUND;
    if (!protocol->has_markers || protocol->registration == GSN_PROTOCOL_TISSUE || count < 3 ||
        3 * marked >= count)
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

/* Sections that are laid by their tissue are asked for no marks, and nobody is asked about them. */
static void pass_over_marks(const struct gsn_slot *found, size_t count,
                            const struct gsn_panel_answers *answers,
                            struct gsn_panel_findings *findings)
{
    for (size_t i = 0; i < count; i++) {
        struct gsn_panel_section *section = &findings->section[found[i].slot];

        if (section->sighting != GSN_SIGHT_HELD)
            section->sighting = GSN_SIGHT_FOUND;
    }
    void_choices(answers, findings);
}

/* Why there may be no marks at all. */
static void say_too_coarse(const struct gsn_scan *scan, struct gsn_panel_findings *findings)
{
    const double least_um = GSN_FIDUCIAL_MIN_PX * scan->px_um;

    if (least_um > GSN_FIDUCIAL_MIN_UM)
        add_note(findings,
                 "no section shows three marks: at %.4g um a pixel those of less than %.3g "
                 "um radius (%g pixels; holes: %.3g um) may not be told from grain: scan "
                 "finer if they are so small",
                 scan->px_um, least_um, GSN_FIDUCIAL_MIN_PX, 2 * least_um);
}

/* Marks of all sections of the panel: found slots and their numbers in findings. A panel whose
 * sections agree on no triangle is no failure: its sections need a person's eye. */
static int find_panel_marks(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                            const struct gsn_slot *found, size_t count,
                            const struct gsn_panel_answers *answers, unsigned threads,
                            struct gsn_panel_findings *findings, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_fiducial_candidates) candidates =
        gsn_alloc_array(count, sizeof *candidates);
    gsn_auto_mem(double) scratch = gsn_alloc_array(count, sizeof *scratch);
    gsn_auto(gsn_od_reader) absorber = NULL;
    struct search search = {
        { scan, NULL, gsn_protocol_layout(protocol), 0, found, count, threads }, candidates
    };
    struct gsn_triangle_prior prior;
    struct gsn_point upright = { protocol->has_markers, 0 };
    struct lie lie = { 0 };
    int agreed, r;

    if (protocol->registration == GSN_PROTOCOL_TISSUE) {
        pass_over_marks(found, count, answers, findings);
        return GSN_OK;
    }
    if (!candidates || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    r = gsn_od_reader_new(scan->picture->image, &scan->glass, &absorber, err);
    if (r < 0)
        return r;
    search.in.absorber = absorber;
    search.in.side = gsn_fiducial_search_side(found, count, scratch);
    r = gsn_fiducial_search_panel(&search.in, protocol->has_markers ? protocol->markers_um : NULL,
                                  candidates, err);
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
        if (count_found(section->mark) == GSN_FIDUCIALS) {
            lie.marked++;
            lie.mirrored += sight.mirrored != 0;
            lie.turned += is_turned(section, &sight, &prior, scan->px_um) != 0;
        }
        if (agreed && !protocol->has_markers)
            add_direction(section, &sight, &prior, scan->px_um, &upright);
        if (section->sighting != GSN_SIGHT_HELD)
            take_choice(section, pose_said(answers, section->slot), &sight);
        state_marks(section, &sight);
    }
    void_choices(answers, findings);
    if (lie.marked == 0)
        say_too_coarse(scan, findings);
    if (agreed)
        lay_candidates(&prior, upright, scan->px_um, findings);
    return protocol->has_markers ? check_way_round(scan, &lie, answers, findings, err) : GSN_OK;
}

const char *gsn_sighting_name(enum gsn_sighting sighting)
{
    static const char *const names[] = { "found", "needs-eye", "missing", "empty", "held" };

    return names[sighting];
}

/* ---- slots, scraps and label ---------------------------------------------------------------- */

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
            gsn_flags_add(&section->flags, GSN_FLAG_TOUCHING);
        if (slots[i].parted)
            gsn_flags_add(&section->flags, GSN_FLAG_PARTED);
        if (slots[i].found && slots[i].doubtful)
            section->sighting = GSN_SIGHT_HELD;
        if (slots[i].doubtful)
            gsn_flags_add(&section->flags, GSN_FLAG_BETWEEN_SLOTS);
        if (slots[i].lost > 0)
            gsn_flags_add(&section->flags, GSN_FLAG_OVER_EDGE);
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
            add_note(
                findings,
                "the sections in slots %u and %u have grown together and are held: cut along the "
                "line from (%.0f, %.0f) to (%.0f, %.0f) px, or mount them again",
                s->slot + 1, s->touched + 1, s->cut_px[0].x, s->cut_px[0].y, s->cut_px[1].x,
                s->cut_px[1].y);
        if (s->parted && s->touched > s->slot)
            add_note(findings,
                     "the sections in slots %u and %u touch and were cut apart along the line from "
                     "(%.0f, %.0f) to (%.0f, %.0f) px",
                     s->slot + 1, s->touched + 1, s->cut_px[0].x, s->cut_px[0].y, s->cut_px[1].x,
                     s->cut_px[1].y);
        if (s->found && s->doubtful)
            add_note(findings,
                     "the section in slot %u lies between slots %u and %u and is held: say which "
                     "is its own",
                     s->slot + 1, s->slot + 1, s->rival + 1);
        if (s->lost > 0)
            add_note(findings,
                     "the section in slot %u runs over the edge: %.0f %% of its tissue is lost",
                     s->slot + 1, 100 * s->lost);
    }
    if (found == 0)
        add_note(findings, "no tissue on this panel");
}

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
        gsn_flags_add(&section->flags, GSN_FLAG_SCRAP);
        if (find_scrap_answer(answers, slots, &scraps[i])) {
            section->sighting = GSN_SIGHT_EMPTY;
            gsn_flags_add(&section->flags, GSN_FLAG_DECIDED);
        }
        held += section->sighting == GSN_SIGHT_HELD;
        findings->count++;
    }
    if (held > 0)
        add_note(findings, "%zu piece%s between the slots belong%s to no section: held", held,
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

    if (findings->label_number > 0)
        return;
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
        add_note(findings, "its label says \"%s\", which names no panel", picture->code[0].text);
    else if (x1 > 0)
        add_note(
            findings,
            "no code could be read on its label: compare what is written from (%d, %d) to (%d, %d) "
            "px",
            x0, y0, x1, y1);
}

static int analyse_scan(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
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
                        find_first_answer(answers, findings->count), slots, &scraps, &scrap_count,
                        err);
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
    r = find_panel_marks(scan, protocol, slots, found, answers, threads, findings, err);
    /* Pixels too large for marks may only be said to be. */
    if (r == GSN_E_INPUT &&
        check_pixel_size(scan, protocol, slots, found, threads, findings, &wrong) == GSN_E_WITHHELD)
        return gsn_fail(err, GSN_E_WITHHELD, "%s", wrong.text);
    return r < 0 ? r : check_pixel_size(scan, protocol, slots, found, threads, findings, err);
}

static int analyse_as(struct gsn_decoder *decoder, int picture_fd,
                      const struct gsn_protocol *protocol, const struct gsn_orientation *upright,
                      unsigned number, const struct gsn_panel_answers *answers, unsigned threads,
                      const struct gsn_progress *progress, struct gsn_panel_findings *findings,
                      struct gsn_error *err)
{
    gsn_auto(gsn_scan) scan = NULL;
    int r;

    gsn_progress_say(progress, "decoding", 0, 1);
    r = gsn_scan_survey(decoder, picture_fd, protocol, upright, &scan, err);
    if (r < 0)
        return r;
    findings->width = scan->picture->image->width;
    findings->height = scan->picture->image->height;
    findings->px_um = scan->px_um;
    findings->upright = scan->upright;
    (void)snprintf(findings->note, sizeof findings->note, "%s%s%s", scan->picture->note,
                   scan->picture->note[0] && scan->note[0] ? "; " : "", scan->note);
    return analyse_scan(scan, protocol, number, answers, threads, progress, findings, err);
}

static int findings_new(const struct gsn_protocol *protocol,
                        struct gsn_panel_findings **ret_findings, struct gsn_error *err)
{
    gsn_auto(gsn_panel_findings) findings = gsn_alloc_array(1, sizeof *findings);

    if (findings)
        findings->count = (size_t)protocol->rows * protocol->columns;
    if (findings)
        findings->section = gsn_alloc_array(findings->count, sizeof *findings->section);
    if (!findings || !findings->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a panel");
    *ret_findings = gsn_steal(&findings);
    return GSN_OK;
}

int gsn_panel_analyse(struct gsn_decoder *decoder, int picture_fd,
                      const struct gsn_protocol *protocol, unsigned number,
                      const struct gsn_panel_answers *answers, unsigned threads,
                      const struct gsn_progress *progress, struct gsn_panel_findings **ret_findings,
                      struct gsn_error *err)
{
    gsn_auto(gsn_panel_findings) findings = NULL;
    gsn_auto(gsn_panel_findings) first = NULL;
    struct gsn_error why = { 0 };
    struct gsn_orientation as_marked = { .note = "set as its marks say, as was decided" };
    int r = findings_new(protocol, &findings, err);

    if (r < 0)
        return r;
    r = analyse_as(decoder, picture_fd, protocol, NULL, number, answers, threads, progress,
                   findings, &why);
    if (r == GSN_E_WITHHELD && (findings->against.mirrored || findings->against.quarters) &&
        has_answer(answers, GSN_SAID_AS_MARKED)) {
        first = gsn_steal(&findings);
        as_marked.turn = gsn_orientation_compose(first->upright.turn, first->against);
        r = findings_new(protocol, &findings, err);
        if (r < 0)
            return r;
        findings->label_number = first->label_number;
        memcpy(findings->label, first->label, sizeof findings->label);
        memcpy(findings->label_subject, first->label_subject, sizeof findings->label_subject);
        r = analyse_as(decoder, picture_fd, protocol, &as_marked, number, answers, threads,
                       progress, findings, &why);
    }
    if (r < 0)
        return gsn_fail(err, r, "%s", why.text);
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
