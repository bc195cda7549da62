/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/examine_parts.h"

#include "pipeline/core/parallel.h"
#include "pipeline/slot_marks.h"
#include "pipeline/upright.h"
#include "pipeline/register/fiducial/triangle.h"
#include "pipeline/register/fiducial/learn.h"
#include "pipeline/register/fiducial/correspondence.h"
#include "pipeline/register/panel/slots.h"

#include <math.h>
#include <string.h>

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

enum { FEWEST_TURNED = 3 };

/* What the spots of one section gsn_findings_say. */
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
    sight.ambiguous = score > 0 && 20 * runner_up > score;
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
        gsn_section_flag(section, sight->mirrored ? "two-marks mirrored" : "two-marks");
    else if (found < 2)
        gsn_section_flag(section, sight->ambiguous ? "ambiguous-marks" : "no-marks");
    if (sight->decided)
        gsn_section_flag(section, "decided");
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
        gsn_section_flag(section, "decision-void");
        gsn_findings_say(
            findings, "the pose that was chosen for slot %u %s and is not used: choose again",
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

    if (!gsn_upright_is_coded(scan->picture))
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
            gsn_findings_say(findings,
                             "%zu of %zu sections are mirrored against the job's \"markers_um\"",
                             lie->mirrored, lie->marked);
        return GSN_OK;
    }
    if (gsn_answers_say(answers, GSN_SAID_AS_SET)) {
        gsn_findings_say(findings, "used as it was set upright, against its marks, as was decided");
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
    struct gsn_slot_search in;
    struct gsn_mark_candidates *candidates; /* one for each section */
};

static int search_slot(size_t index, void *context, struct gsn_error *err)
{
    const struct search *search = context;
    const struct gsn_slot_search *in = &search->in;
    const struct gsn_slot *slot = &in->slots[index];
    const int r = gsn_slot_marks(in->scan, in->absorber, &in->layout, in->side, slot, 0, NULL,
                                 &search->candidates[index], err);

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
    const struct gsn_slot_search *in = &search->in;
    const struct gsn_slot *slot = &in->slots[index];
    const int before = count_chosen(&search->candidates[index], prior);
    struct gsn_mark_candidates again;
    int r;

    if (before == GSN_MARKS || !prior->learnt)
        return GSN_OK;
    r = gsn_slot_marks(in->scan, in->absorber, &in->layout, in->side, slot, 0, prior, &again, err);
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
 * stated; 0: they agree at none. Burns of the ordinary kind span a factor of 3.75, so steps of 2
 * miss none. */
static int pixels_by_marks(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                           const struct gsn_slot *found, size_t count, unsigned threads,
                           double *ret_px_um, struct gsn_error *err)
{
    static const double times[] = { 0.5, 2, 0.25, 4, 0.125, 8 };
    /* Sections swell and shrink by some per cent. */
    static const double SAME = 0.1;
    gsn_auto_mem(struct gsn_mark_candidates) candidates =
        gsn_alloc_array(count, sizeof *candidates);
    gsn_auto_mem(double) scratch = gsn_alloc_array(count, sizeof *scratch);
    gsn_auto(gsn_od_reader) absorber = NULL;
    double side;
    int r = gsn_od_reader_new(scan->picture->image, &scan->glass, &absorber, err);

    if (r < 0)
        return r;
    if (!candidates || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    side = gsn_slot_typical_side(found, count, scratch);
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
            r = gsn_markers_consensus(candidates, count, &seen, err);
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

int gsn_examine_pixels(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                       const struct gsn_slot *found, size_t count, unsigned threads,
                       const struct gsn_panel_findings *findings, struct gsn_error *err)
{
    struct gsn_error quiet = { 0 };
    size_t marked = 0;
    double px_um = 0;
    int r;

    for (size_t i = 0; i < findings->count; i++)
        marked += findings->section[i].sighting == GSN_SIGHT_FOUND;
    if (!protocol->has_markers || protocol->registration == GSN_STATED_TISSUE || count < 3 ||
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
    const double least_um = GSN_MARK_LEAST_PX * scan->px_um;

    if (least_um > GSN_MARK_LEAST_UM)
        gsn_findings_say(findings,
                         "no section shows three marks: at %.4g um a pixel those of less than %.3g "
                         "um radius (%g pixels; holes: %.3g um) may not be told from grain: scan "
                         "finer if they are so small",
                         scan->px_um, least_um, GSN_MARK_LEAST_PX, 2 * least_um);
}

int gsn_examine_marks(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                      const struct gsn_slot *found, size_t count,
                      const struct gsn_panel_answers *answers, unsigned threads,
                      struct gsn_panel_findings *findings, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_mark_candidates) candidates =
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

    if (protocol->registration == GSN_STATED_TISSUE) {
        pass_over_marks(found, count, answers, findings);
        return GSN_OK;
    }
    if (!candidates || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    r = gsn_od_reader_new(scan->picture->image, &scan->glass, &absorber, err);
    if (r < 0)
        return r;
    search.in.absorber = absorber;
    search.in.side = gsn_slot_typical_side(found, count, scratch);
    r = gsn_slots_marks(&search.in, protocol->has_markers ? protocol->markers_um : NULL, candidates,
                        err);
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
        if (count_found(section->mark) == GSN_MARKS) {
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
