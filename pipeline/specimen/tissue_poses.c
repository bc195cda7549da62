/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Poses by the tissue of neighbouring sections.
 *
 * 1. Panels are surveyed once more; each section is reduced to cells of CELL_UM
 * (register/tissue/pairwise.h).
 * 2. A section that its marks place elsewhere than its neighbours' tissue does is held, and a
 * person is offered its candidates (register/tissue/pose_check.h).
 * 3. Sections without a sure pose are placed by a graph of comparisons with up to AROUND sections
 * on either side, anchored at those that marks hold (register/tissue/pose_graph.h). A predicted
 * error above MOST_ERROR_UM leaves the section held.
 * 4. Where the tissue's pose agrees with one candidate and comes near no other, that candidate's
 * spots are its marks. Two spots that leave more than one pose open are dropped where the tissue
 * surely lies elsewhere.
 * 5. Where the job asks for tissue alone, all sections are placed so, in the frame of one of them.
 * 6. On the opened panel, marks of the sections placed so are searched where their pose expects
 * them; the pose stays the tissue's.
 *
 * Tissue that cannot tell leaves sections as they were. Fails with GSN_E_NOMEM, GSN_E_IO and as
 * gsn_scan_survey(). */
#include "pipeline/specimen/poses.h"

#include "pipeline/core/file.h"
#include "pipeline/register/fiducial/correspondence.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/fiducial/learn.h"
#include "pipeline/register/panel/slots.h"
#include "pipeline/register/pose/pose.h"
#include "pipeline/register/pose/tre.h"
#include "pipeline/register/tissue/bands.h"
#include "pipeline/register/tissue/pairwise.h"
#include "pipeline/register/tissue/pose_check.h"
#include "pipeline/register/tissue/pose_graph.h"
#include "pipeline/specimen/fiducial_search.h"
#include "pipeline/stain/optical_density.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* Sections on either side that are looked at: two to compare with, and one that may be missing. */
enum { AROUND = 3 };

/* Side of a cell, um: about as fine as the panels are surveyed, whatever their pixels. */
static const double CELL_UM = 48;

/* Cells of glass around a section's box: its outline counts, and what is compared with it may lie
 * beyond the box. */
enum { MARGIN = 12 };
static const double MARGIN_UM = 12 * 48;

/* Beyond this predicted error, two intervals and a half, a section would blur what it is to add to.
 */
static const double MOST_ERROR_UM = 60;

/* Two marks of which another pose has more than this share of the likelihood are asked about. */
static const double OPEN = 0.01;

/* Where tissue lays a section this far, root mean square, from where its two marks do, they are not
 * its marks: a fold or a tear moves half a section, and so the tissue's pose, by half a millimetre.
 */
static const double APART_UM = 600;

/* Spots that lay a section within this of where its tissue does are its marks, as long as no others
 * lay it within the second distance: what a fold or a tear leaves open is not told by so little. */
static const double TOGETHER_UM = 300, ALONE_UM = 1200;

/* A section while it is laid. */
struct part {
    size_t section; /* its place in the reconstruction */
    int wanted;     /* to be laid, or near one that is */
    struct gsn_tissue *tissue;
};

static int is_lost(const struct gsn_section *s)
{
    return s->state == GSN_SECTION_HELD && s->seen.sighting != GSN_SIGHT_HELD &&
           s->seen.width > 0 && s->seen.height > 0 && (!s->posed || s->pose.gross);
}

/* Two spots that could be other marks than they are taken for, or none: the panel alone cannot say,
 * nor has a person. */
static int is_open(const struct gsn_section *s)
{
    return s->posed && s->state == GSN_SECTION_DOUBTFUL && s->pose.state == GSN_POSE_TWO_MARKS &&
           s->candidates.chosen == 0 && s->candidates.count > 1 && s->candidates.at[1].share > OPEN;
}

static int is_held_by_marks(const struct gsn_section *s)
{
    return s->posed && !s->pose.gross && !is_open(s) &&
           (s->state == GSN_SECTION_USED || s->state == GSN_SECTION_DOUBTFUL);
}

/* One part for each serial number that has tissue, in order. */
static size_t list_parts(const struct gsn_poses *poses, struct part *parts)
{
    size_t count = 0;

    for (size_t i = 0; i < poses->section_count; i++) {
        const struct gsn_section *s = &poses->section[i];

        if ((!is_lost(s) && !is_open(s) && !is_held_by_marks(s)) ||
            (count > 0 && poses->section[parts[count - 1].section].seen.serial == s->seen.serial))
            continue;
        parts[count++] = (struct part){ .section = i };
    }
    return count;
}

/* Marks the lost and open ones and those around them; 0 when there are none. */
static int mark_wanted(const struct gsn_poses *poses, struct part *parts, size_t count)
{
    int any = 0;

    for (size_t i = 0; i < count; i++) {
        const struct gsn_section *s = &poses->section[parts[i].section];

        if (!is_lost(s) && !is_open(s))
            continue;
        any = 1;
        for (size_t k = i > AROUND ? i - AROUND : 0; k < count && k <= i + AROUND; k++)
            parts[k].wanted = 1;
    }
    return any;
}

static float total_at(const struct gsn_plane *total, double x, double y)
{
    const double u = fmin(fmax(x - 0.5, 0), total->width - 1.001);
    const double v = fmin(fmax(y - 0.5, 0), total->height - 1.001);
    const size_t i = (size_t)u, j = (size_t)v, w = total->width;
    const float fu = (float)(u - (double)i), fv = (float)(v - (double)j);
    const float *at = total->value + j * w + i;

    return (at[0] * (1 - fu) + at[1] * fu) * (1 - fv) + (at[w] * (1 - fu) + at[w + 1] * fu) * fv;
}

/* The section's box in cells of CELL_UM, with its margin; the origin is the margin's corner, in um.
 */
static int reduce_section(const struct gsn_scan *scan, const struct gsn_panel_section *seen,
                          struct gsn_tissue **ret_tissue, struct gsn_error *err)
{
    const uint32_t w = (uint32_t)(seen->width * scan->px_um / CELL_UM);
    const uint32_t h = (uint32_t)(seen->height * scan->px_um / CELL_UM), wide = w + 2 * MARGIN;
    const double cell_px = CELL_UM / scan->px_um;
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_error own = { 0 };
    int r;

    if (w == 0 || h == 0 || scan->total->width < 2 || scan->total->height < 2)
        return GSN_OK;
    r = gsn_plane_new(wide, h + 2 * MARGIN, &plane, err);
    if (r < 0)
        return r;
    for (uint32_t y = 0; y < h; y++)
        for (uint32_t x = 0; x < w; x++)
            plane->value[(size_t)(y + MARGIN) * wide + x + MARGIN] =
                total_at(scan->total, (seen->x + (x + 0.5) * cell_px) / scan->step,
                         (seen->y + (y + 0.5) * cell_px) / scan->step);
    r = gsn_tissue_new(plane, CELL_UM, ret_tissue, &own);
    return r == GSN_E_NOMEM ? gsn_fail(err, r, "%s", own.text) : GSN_OK;
}

static int reduce_panel(const struct gsn_specimen *specimen,
                        const struct gsn_specimen_options *options,
                        const struct gsn_specimen_panel *panel, const struct gsn_poses *poses,
                        struct part *parts, size_t count, struct gsn_error *err)
{
    gsn_auto_fd picture_fd = -1;
    gsn_auto(gsn_scan) scan = NULL;
    int r = specimen->open(specimen->context, panel->sha256, &picture_fd, err);

    if (r >= 0)
        r = gsn_scan_survey(options->decoder, picture_fd, specimen->protocol, &panel->upright,
                            &scan, err);
    for (size_t i = 0; r >= 0 && i < count; i++) {
        const struct gsn_section *s = &poses->section[parts[i].section];

        if (s->panel == panel->number)
            r = reduce_section(scan, &s->seen, &parts[i].tissue, err);
    }
    return r;
}

/* From um from the margin's corner to panel pixels. */
static struct gsn_affine to_panel(const struct gsn_section *s, double px_um)
{
    return (struct gsn_affine){ 1 / px_um, 0,         s->seen.x - MARGIN_UM / px_um,
                                0,         1 / px_um, s->seen.y - MARGIN_UM / px_um };
}

/* A pose corrected for strain is no rigid one: the nearest that is, about the tissue's centre. */
static struct gsn_affine rigid_of(const struct gsn_affine *m, struct gsn_point centre)
{
    const double sign = gsn_affine_det(m) < 0 ? -1 : 1;
    const double c = sign * m->m00 + m->m11, s = sign * m->m10 - m->m01, size = hypot(c, s);
    struct gsn_affine map = { sign * c / size, -s / size, 0, sign * s / size, c / size, 0 };
    const struct gsn_point wanted = gsn_affine_apply(m, centre);
    const struct gsn_point at = gsn_affine_apply(&map, centre);

    map.m02 = wanted.x - at.x;
    map.m12 = wanted.y - at.y;
    return map;
}

static void state_section(const struct gsn_specimen *specimen, const struct gsn_poses *poses,
                          const struct part *part, struct gsn_tissue_section *ret_section)
{
    const struct gsn_section *s = &poses->section[part->section];
    const struct gsn_affine panel = to_panel(s, gsn_specimen_find_panel(specimen, s->panel)->px_um);
    const struct gsn_affine map = gsn_affine_compose(&panel, &s->pose.panel_to_block_um);

    *ret_section = (struct gsn_tissue_section){ .serial = s->seen.serial,
                                                .tissue = part->tissue,
                                                .marked = is_held_by_marks(s) };
    if (!ret_section->marked || !part->tissue)
        return;
    ret_section->to_block = rigid_of(&map, gsn_tissue_centre(part->tissue));
    gsn_pose_error_about(&s->pose.error, gsn_affine_apply(&map, gsn_tissue_centre(part->tissue)),
                         ret_section->covariance);
}

static struct gsn_tissue_place place_of(const struct gsn_specimen *specimen,
                                        const struct gsn_section *s,
                                        const struct gsn_tissue_pose *pose)
{
    const struct gsn_affine panel = to_panel(s, gsn_specimen_find_panel(specimen, s->panel)->px_um);
    const struct gsn_affine back = gsn_affine_inverse(&panel);

    return (struct gsn_tissue_place){ .known = 1,
                                      .panel_to_block_um =
                                          gsn_affine_compose(&back, &pose->to_block),
                                      .error_um = pose->error };
}

/* The pose of one section by its tissue. Its marks have no residuals: they did not lay it. */
static void take_tissue_pose(struct gsn_section *s, const struct gsn_tissue_place *place)
{
    const struct gsn_affine map = place->panel_to_block_um;

    s->place = *place;
    s->pose = (struct gsn_pose){ .state = GSN_POSE_TWO_MARKS };
    s->pose.panel_to_block_um = map;
    s->pose.tre_um = place->error_um;
    s->pose.flipped = gsn_affine_det(&map) < 0;
    s->pose.rotated180 = map.m11 < 0;
    s->posed = 1;
    s->state = GSN_SECTION_DOUBTFUL;
    gsn_flags_add(&s->flags, GSN_FLAG_BY_TISSUE);
    if (s->pose.flipped && !gsn_flags_has(&s->flags, GSN_FLAG_FLIPPED))
        gsn_flags_add(&s->flags, GSN_FLAG_FLIPPED);
    if (s->pose.rotated180 && !gsn_flags_has(&s->flags, GSN_FLAG_TURNED))
        gsn_flags_add(&s->flags, GSN_FLAG_TURNED);
}

/* How far apart two poses have the corners of a section's box, root mean square. */
static double distance_between(const struct gsn_section *s, const struct gsn_affine *a,
                               const struct gsn_affine *b)
{
    double square = 0;

    for (int corner = 0; corner < 4; corner++) {
        const struct gsn_point at = { s->seen.x + (corner & 1 ? s->seen.width : 0),
                                      s->seen.y + (corner & 2 ? s->seen.height : 0) };
        const struct gsn_point p = gsn_affine_apply(a, at), q = gsn_affine_apply(b, at);

        square += (pow(p.x - q.x, 2) + pow(p.y - q.y, 2)) / 4;
    }
    return sqrt(square);
}

static int count_marks(const struct gsn_section *s)
{
    return s->seen.mark[0].found + s->seen.mark[1].found + s->seen.mark[2].found;
}

/* The tissue decides which spots are the marks, where it lays the section as one candidate does and
 * as no other. The pose stays the tissue's. */
static void name_marks(struct gsn_section *s)
{
    const struct gsn_candidate *named = NULL;
    size_t near = 0;

    for (size_t i = 0; i < s->candidates.count; i++) {
        const struct gsn_candidate *c = &s->candidates.at[i];
        const double away =
            c->laid ? distance_between(s, &s->pose.panel_to_block_um, &c->panel_to_block_um)
                    : INFINITY;

        near += away < ALONE_UM;
        if (away < TOGETHER_UM)
            named = c;
    }
    if (named && near == 1 && count_marks(s) == 0)
        memcpy(s->seen.mark, named->mark, sizeof s->seen.mark);
}

static void forget_marks(struct gsn_section *s)
{
    for (size_t m = 0; m < GSN_FIDUCIALS; m++)
        s->seen.mark[m].found = 0;
}

/* An open section whose tissue lies elsewhere than its two spots say: they are not its marks. */
static void correct_open(struct gsn_section *s, const struct gsn_tissue_place *place)
{
    struct gsn_section corrected = *s;

    corrected.flags = s->seen.flags;
    take_tissue_pose(&corrected, place);
    if (distance_between(s, &s->pose.panel_to_block_um, &corrected.pose.panel_to_block_um) <
        APART_UM)
        return;
    forget_marks(&corrected);
    *s = corrected;
}

/* Its marks lay it where its neighbours' tissue does not: held until tissue lays it, and a person
 * may say that they are its marks all the same. */
static void hold_section(const struct gsn_specimen *specimen,
                         const struct gsn_pose_options *options, const struct gsn_poses *poses,
                         struct gsn_section *s)
{
    if (s->pose.state == GSN_POSE_OK)
        gsn_candidates_offer_marks(specimen, options, poses, s);
    s->pose = (struct gsn_pose){ .state = GSN_POSE_NONE };
    s->posed = 0;
    s->state = GSN_SECTION_HELD;
    forget_marks(s);
    s->flags = s->seen.flags;
    gsn_flags_add(&s->flags, GSN_FLAG_TISSUE_DISAGREES);
}

/* Holds every section that its marks lay against the tissue of its neighbours; what a person chose
 * stays. */
static int check_marks(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                       struct gsn_poses *poses, const struct part *parts, size_t count,
                       struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_tissue_section) sections = gsn_alloc_array(count, sizeof *sections);
    gsn_auto_mem(struct gsn_tissue_finding) findings = gsn_alloc_array(count, sizeof *findings);
    gsn_auto_mem(struct gsn_point) targets = NULL;
    struct gsn_pose_options options = { .markers_um = specimen->protocol->has_markers
                                                          ? specimen->protocol->markers_um
                                                          : NULL };
    int r;

    if (!sections || !findings)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying sections by their tissue");
    for (size_t i = 0; i < count; i++)
        state_section(specimen, poses, &parts[i], &sections[i]);
    r = gsn_tissue_check(sections, count, findings, err);
    if (r >= 0)
        r = gsn_region_targets(region, &targets, &options.target_count, err);
    options.targets_um = targets;
    for (size_t i = 0; r >= 0 && i < count; i++) {
        struct gsn_section *s = &poses->section[parts[i].section];

        if (s->candidates.chosen > 0)
            continue;
        s->finding = findings[i];
        if (findings[i].contradicted)
            hold_section(specimen, &options, poses, s);
    }
    return r;
}

/* What marks do not lay is laid by its tissue; where that is too rough, it shows at least where
 * the marks are. */
static void accept_pose(const struct gsn_specimen *specimen, const struct gsn_tissue_pose *pose,
                        struct gsn_section *s)
{
    const struct gsn_tissue_place place = place_of(specimen, s, pose);
    const int fine = pose->error <= MOST_ERROR_UM;

    if (is_lost(s) && fine) {
        take_tissue_pose(s, &place);
        name_marks(s);
    } else if (is_lost(s)) {
        s->place = place;
    } else if (is_open(s) && fine) {
        correct_open(s, &place);
    }
}

static int place_by_neighbours(const struct gsn_specimen *specimen, struct gsn_poses *poses,
                               const struct part *parts, size_t count, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_tissue_section) sections = gsn_alloc_array(count, sizeof *sections);
    gsn_auto_mem(struct gsn_tissue_pose) placed = gsn_alloc_array(count, sizeof *placed);
    struct gsn_tissue_summary summary;
    int r;

    if (!sections || !placed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying sections by their tissue");
    for (size_t i = 0; i < count; i++) {
        state_section(specimen, poses, &parts[i], &sections[i]);
        if (!parts[i].wanted)
            sections[i].tissue = NULL;
    }
    r = gsn_tissue_register(sections, count, GSN_TISSUE_MIDDLE, placed, &summary, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        if (placed[i].laid && !placed[i].unsure && summary.held > 0 && placed[i].from <= AROUND)
            accept_pose(specimen, &placed[i], &poses->section[parts[i].section]);
    return r;
}

/* ---- By tissue alone ---------------------------------------------------------------------- */

static int note_unsolved(struct gsn_poses *poses, const char *format, ...)
{
    va_list args;

    va_start(args, format);
    (void)vsnprintf(poses->unsolved, sizeof poses->unsolved, format, args);
    va_end(args);
    return GSN_OK;
}

/* From um from the corner of a section's margin to its panel's picture in um, which is the block
 * when the section is the frame. */
static struct gsn_affine to_picture(const struct gsn_specimen *specimen,
                                    const struct gsn_section *s)
{
    const double px_um = gsn_specimen_find_panel(specimen, s->panel)->px_um;

    return (struct gsn_affine){ 1, 0, s->seen.x * px_um - MARGIN_UM,
                                0, 1, s->seen.y * px_um - MARGIN_UM };
}

/* The part that the job states as the frame; count where it states none. Fails with
 * GSN_E_NOTFOUND. */
static int stated_frame(const struct gsn_specimen *specimen, const struct gsn_poses *poses,
                        const struct part *parts, size_t count, size_t *ret_part)
{
    const struct gsn_protocol *p = specimen->protocol;

    *ret_part = count;
    for (size_t i = 0; p->frame_panel > 0 && i < count; i++) {
        const struct gsn_section *s = &poses->section[parts[i].section];

        if (s->panel == p->frame_panel && s->seen.slot + 1 == p->frame_slot && parts[i].tissue)
            *ret_part = i;
    }
    return p->frame_panel > 0 && *ret_part == count ? GSN_E_NOTFOUND : GSN_OK;
}

/* A section that its tissue alone lays is as good as its neighbours say. */
static void take_pose_alone(const struct gsn_specimen *specimen, const struct gsn_tissue_pose *pose,
                            struct gsn_section *s)
{
    const struct gsn_tissue_place place = place_of(specimen, s, pose);

    s->pose = (struct gsn_pose){ .state = GSN_POSE_OK,
                                 .panel_to_block_um = place.panel_to_block_um,
                                 .tre_um = place.error_um,
                                 .flipped = gsn_affine_det(&place.panel_to_block_um) < 0,
                                 .rotated180 = place.panel_to_block_um.m11 < 0 };
    s->posed = 1;
    s->state = GSN_SECTION_USED;
    if (s->pose.flipped)
        gsn_flags_add(&s->flags, GSN_FLAG_FLIPPED);
    if (s->pose.rotated180)
        gsn_flags_add(&s->flags, GSN_FLAG_TURNED);
}

static void take_poses_alone(const struct gsn_specimen *specimen, struct gsn_poses *poses,
                             const struct part *parts, size_t count,
                             const struct gsn_tissue_pose *placed)
{
    for (size_t i = 0; i < count; i++) {
        struct gsn_section *s = &poses->section[parts[i].section];

        if (placed[i].laid && !placed[i].unsure)
            take_pose_alone(specimen, &placed[i], s);
        else
            gsn_flags_add(&s->flags,
                          placed[i].laid ? GSN_FLAG_TISSUE_UNSURE : GSN_FLAG_NO_TISSUE_FITS);
    }
}

/* All sections by their tissue, in the frame of one of them. */
static int place_by_tissue_alone(const struct gsn_specimen *specimen, struct gsn_poses *poses,
                                 const struct part *parts, size_t count, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_tissue_section) sections = gsn_alloc_array(count, sizeof *sections);
    gsn_auto_mem(struct gsn_tissue_pose) placed = gsn_alloc_array(count, sizeof *placed);
    struct gsn_tissue_summary *summary = &poses->by_tissue.summary;
    struct gsn_affine frame;
    size_t at;
    int r;

    if (!sections || !placed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying sections by their tissue");
    if (stated_frame(specimen, poses, parts, count, &at) < 0)
        return note_unsolved(
            poses,
            "no tissue to lay others on is seen in panel %u, slot %u, which job.json "
            "states as \"frame\": look at the panel, or take the coordinates from "
            "another section",
            specimen->protocol->frame_panel, specimen->protocol->frame_slot);
    for (size_t i = 0; i < count; i++)
        sections[i] =
            (struct gsn_tissue_section){ .serial = poses->section[parts[i].section].seen.serial,
                                         .tissue = parts[i].tissue };
    r = gsn_tissue_register(sections, count, at < count ? at : GSN_TISSUE_MIDDLE, placed, summary,
                            err);
    if (r < 0)
        return r;
    if (summary->laid < 2)
        return note_unsolved(poses, "the tissue of none of %zu sections fits another's", count);
    poses->by_tissue.frame = parts[summary->reference].section;
    frame = to_picture(specimen, &poses->section[poses->by_tissue.frame]);
    for (size_t i = 0; i < count; i++)
        placed[i].to_block = gsn_affine_compose(&placed[i].to_block, &frame);
    poses->by_tissue.done = poses->solved = 1;
    take_poses_alone(specimen, poses, parts, count, placed);
    return GSN_OK;
}

static int reduce_panels(const struct gsn_specimen *specimen,
                         const struct gsn_specimen_options *options, const struct gsn_poses *poses,
                         struct part *parts, size_t count, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < specimen->panel_count; i++) {
        if (specimen->panel[i].section_count == 0)
            continue;
        r = reduce_panel(specimen, options, &specimen->panel[i], poses, parts, count, err);
        if (r < 0)
            (void)gsn_fail_at(err, "panel %u (%s)", specimen->panel[i].number,
                              specimen->panel[i].file);
    }
    return r;
}

int gsn_poses_by_tissue(const struct gsn_specimen *specimen,
                        const struct gsn_specimen_options *options, const struct gsn_mask *region,
                        struct gsn_poses *poses, struct gsn_error *err)
{
    gsn_auto_mem(struct part) parts = gsn_alloc_array(poses->section_count, sizeof *parts);
    const int alone = specimen->protocol->registration == GSN_PROTOCOL_TISSUE;
    size_t count;
    int r;

    if (!parts)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying sections by their tissue");
    if (specimen->protocol->registration == GSN_PROTOCOL_MARKS || (!poses->solved && !alone))
        return GSN_OK;
    count = list_parts(poses, parts);
    r = reduce_panels(specimen, options, poses, parts, count, err);
    if (r >= 0 && alone)
        r = place_by_tissue_alone(specimen, poses, parts, count, err);
    else if (r >= 0)
        r = check_marks(specimen, region, poses, parts, count, err);
    if (r >= 0 && !alone && mark_wanted(poses, parts, count))
        r = place_by_neighbours(specimen, poses, parts, count, err);
    for (size_t i = 0; i < count; i++)
        gsn_tissue_free(parts[i].tissue);
    return r;
}

size_t gsn_poses_count_by_tissue(const struct gsn_poses *poses)
{
    size_t count = 0;

    for (size_t i = 0; i < poses->section_count; i++)
        count += (size_t)gsn_flags_has(&poses->section[i].flags, GSN_FLAG_BY_TISSUE);
    return count;
}

/* ---- marks by tissue ------------------------------------------------------------------------ */

/* The sections of one panel, where marks are looked for. */
struct panel_search {
    struct gsn_fiducial_search in;
    struct gsn_slot *slots;                     /* those with tissue */
    struct gsn_fiducial_candidates *candidates; /* one for each */
    size_t *section;                            /* its place in the reconstruction */
};

static int is_wanted(const struct gsn_section *s, unsigned panel)
{
    return s->panel == panel && s->place.known &&
           !(s->seen.mark[0].found && s->seen.mark[1].found && s->seen.mark[2].found);
}

static int any_wanted(const struct gsn_poses *poses, unsigned panel)
{
    for (size_t i = 0; i < poses->section_count; i++)
        if (is_wanted(&poses->section[i], panel))
            return 1;
    return 0;
}

static void list_sections(const struct gsn_poses *poses, unsigned panel,
                          struct panel_search *search)
{
    for (size_t i = 0; i < poses->section_count; i++) {
        const struct gsn_panel_section *seen = &poses->section[i].seen;

        if (poses->section[i].panel != panel || seen->width <= 0 || seen->height <= 0)
            continue;
        search->slots[search->in.count] =
            (struct gsn_slot){ .slot = seen->slot,
                               .found = 1,
                               .x = seen->x,
                               .y = seen->y,
                               .width = seen->width,
                               .height = seen->height,
                               .centre_px = { seen->x + 0.5 * seen->width,
                                              seen->y + 0.5 * seen->height } };
        search->section[search->in.count++] = i;
    }
}

/* Looks once more, now for spots like the panel's other marks. */
static int name_placed_marks(const struct panel_search *search, size_t index,
                             const struct gsn_pose_summary *summary,
                             const struct gsn_triangle_prior *learnt, const struct gsn_section *s,
                             struct gsn_fiducial ret_mark[GSN_FIDUCIALS], struct gsn_error *err)
{
    struct gsn_triangle_prior prior = *learnt;
    struct gsn_fiducial_candidates candidates;
    const struct gsn_fiducial_search *in = &search->in;
    const int r = gsn_fiducial_search_section(in->scan, in->absorber, &in->layout, in->side,
                                              &search->slots[index], 0, learnt, &candidates, err);

    if (r < 0)
        return r;
    gsn_axes_at(&summary->axes, s->seen.serial, summary->mean_triangle, prior.mark_um);
    gsn_fiducials_match_placed(&candidates, &prior, &s->place.panel_to_block_um, s->place.error_um,
                               ret_mark);
    return GSN_OK;
}

static int search_panel(struct panel_search *search, unsigned panel, const struct gsn_poses *poses,
                        struct gsn_section_marks *ret_marks, struct gsn_error *err)
{
    const size_t count = search->in.count;
    gsn_auto_mem(double) scratch = gsn_alloc_array(count, sizeof *scratch);
    struct gsn_triangle_prior prior = { 0 };
    int r;

    if (!scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    search->in.slots = search->slots;
    search->in.side = gsn_fiducial_search_side(search->slots, count, scratch);
    memcpy(prior.mark_um, poses->summary.mean_triangle, sizeof prior.mark_um);
    r = gsn_fiducial_search_panel(&search->in, prior.mark_um, search->candidates, err);
    if (r >= 0)
        r = gsn_fiducials_learn(search->candidates, count, &prior, err);
    for (size_t i = 0; r >= 0 && prior.learnt && i < count; i++) {
        const size_t k = search->section[i];

        if (is_wanted(&poses->section[k], panel))
            r = name_placed_marks(search, i, &poses->summary, &prior, &poses->section[k],
                                  ret_marks[k].mark, err);
    }
    return r;
}

int gsn_fiducials_by_tissue(const struct gsn_specimen *specimen,
                            const struct gsn_specimen_options *options, const struct gsn_scan *scan,
                            unsigned panel, const struct gsn_poses *poses,
                            struct gsn_section_marks *ret_marks, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_slot) slots = NULL;
    gsn_auto_mem(struct gsn_fiducial_candidates) candidates = NULL;
    gsn_auto_mem(size_t) section = NULL;
    gsn_auto(gsn_od_reader) absorber = NULL;
    struct panel_search search = { .in = { .scan = scan,
                                           .layout = gsn_protocol_layout(specimen->protocol),
                                           .threads = options->threads } };
    int r;

    if (poses->by_tissue.done || !any_wanted(poses, panel))
        return GSN_OK;
    slots = gsn_alloc_array(poses->section_count, sizeof *slots);
    candidates = gsn_alloc_array(poses->section_count, sizeof *candidates);
    section = gsn_alloc_array(poses->section_count, sizeof *section);
    if (!slots || !candidates || !section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    r = gsn_od_reader_new(scan->picture->image, &scan->glass, &absorber, err);
    if (r < 0)
        return r;
    search.in.absorber = absorber;
    search.slots = slots;
    search.candidates = candidates;
    search.section = section;
    list_sections(poses, panel, &search);
    return search_panel(&search, panel, poses, ret_marks, err);
}
