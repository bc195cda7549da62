/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which way round a panel lies, and turning it upright.
 *
 * 1. The Data Matrix on the label tells mirrored and turned, within ASKEW_DEG of a quarter turn.
 * 2. Where that is lying on its side, or the picture is not as wide as the stated layout, the panel
 * is split twice, as stated and lying (register/panel.h): the grid that takes up more sections
 * wins.
 * 3. Where the grid leaves it open, the marks are asked: each section with three marks votes for
 * the quarter turn that lays it on the job's triangle (least squares rotation); three sections and
 *    three quarters of the votes decide.
 * 4. Code, grid and marks together decide, or the panel is refused with a sentence
 * (GSN_E_WITHHELD).
 *
 * Turning moves the samples where they lie; only a quarter turn needs a second buffer. */
#include "pipeline/specimen/orientation.h"

#include "pipeline/imaging/warp.h"
#include "pipeline/register/fiducial/correspondence.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/fiducial/learn.h"
#include "pipeline/register/panel/slots.h"
#include "pipeline/specimen/fiducial_search.h"
#include "pipeline/specimen/panel_analysis.h"
#include "pipeline/stain/artefact/dust.h"
#include "pipeline/stain/optical_density.h"

#include <math.h>
#include <string.h>

/* A code turned by this much less than half a turn, or off a quarter turn, is askew. */
static const double ASKEW_DEG = 30;
/* Of the sections with three marks: so many lie the same way round, or nothing is told. */
static const double MAJORITY = 0.75;
enum { LEAST_SECTIONS = 3 };
/* Sections are mounted upright to within this; further off they tell nothing of the panel. */
static const double MOUNTED_DEG = 40;

/* ---- turning ----------------------------------------------------------------------------- */

int gsn_orientation_turn(struct gsn_picture *picture, struct gsn_dust_turn turn,
                         struct gsn_error *err)
{
    const int r = gsn_turn_image(picture->image, turn.mirrored, turn.quarters, err);

    if (r >= 0 && turn.quarters % 2 == 1) {
        const double x = picture->px_um_x;

        picture->px_um_x = picture->px_um_y;
        picture->px_um_y = x;
    }
    return r;
}

/* ---- the code on the label --------------------------------------------------------------- */

static const struct gsn_printed *code_of(const struct gsn_picture *picture)
{
    for (unsigned i = 0; i < picture->code_count; i++)
        if (strcmp(picture->code[i].kind, "Data Matrix") == 0)
            return &picture->code[i];
    return NULL;
}

int gsn_orientation_is_coded(const struct gsn_picture *picture)
{
    return code_of(picture) != NULL;
}

/* To turn and then mirror is to mirror and then turn the other way. */
struct gsn_dust_turn gsn_orientation_compose(struct gsn_dust_turn first, struct gsn_dust_turn then)
{
    const unsigned quarters = then.mirrored ? 4 - first.quarters % 4 : first.quarters;

    return (struct gsn_dust_turn){ !first.mirrored != !then.mirrored,
                                   (quarters + then.quarters) % 4 };
}

struct gsn_dust_turn gsn_orientation_by_code(const struct gsn_picture *picture)
{
    const struct gsn_printed *code = code_of(picture);
    struct gsn_dust_turn turn = { 0 };
    double quarters;

    if (!code)
        return turn;
    turn.mirrored = code->mirrored;
    quarters = round(code->turn_deg / 90);
    if (fabs(code->turn_deg - 90 * quarters) <= ASKEW_DEG)
        turn.quarters = (unsigned)(8 - (int)quarters) % 4;
    return turn;
}

/* Wider than high, as the job's layout is; a square is either. */
static int is_as_wide(const struct gsn_image *image, const struct gsn_protocol *protocol)
{
    return image->width == image->height || protocol->rows == protocol->columns ||
           (image->width > image->height) == (protocol->columns > protocol->rows);
}

int gsn_orientation_asks(const struct gsn_picture *picture, const struct gsn_protocol *protocol)
{
    return gsn_orientation_by_code(picture).quarters % 2 == 1 ||
           !is_as_wide(picture->image, protocol);
}

/* ---- the grid of the sections ------------------------------------------------------------ */

/* One way to read the panel: its slots, and how well they take up what lies on it. */
struct reading {
    struct gsn_layout layout;
    struct gsn_slot *slot; /* owned */
    size_t count;          /* of those with a section, first in slot */
    int score;
};

static int read_as(const struct gsn_scan *scan, unsigned rows, unsigned columns,
                   struct reading *reading, struct gsn_error *err)
{
    const size_t places = (size_t)rows * columns;
    gsn_auto_mem(struct gsn_scrap) scraps = NULL;
    struct gsn_error why = { 0 };
    size_t scrap_count = 0;
    int r;

    *reading = (struct reading){ .layout = { rows, columns, GSN_ORDER_ROW },
                                 .slot = gsn_alloc_array(places, sizeof *reading->slot) };
    if (!reading->slot)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the slots of a panel");
    r = gsn_panel_split(scan->total, scan->step, &reading->layout, scan->px_um, GSN_SLOT_UNSAID,
                        reading->slot, &scraps, &scrap_count, &why);
    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    for (size_t i = 0; r >= 0 && i < places; i++)
        if (reading->slot[i].found && !reading->slot[i].doubtful)
            reading->slot[reading->count++] = reading->slot[i];
    for (size_t i = 0; r >= 0 && i < scrap_count; i++)
        reading->score -= scraps[i].inside_grid;
    reading->score += (int)reading->count;
    return GSN_OK;
}

/* ---- the marks --------------------------------------------------------------------------- */

/* How far a section is turned clockwise, once it is mirrored back. */
static double turned_deg(const struct gsn_point block[GSN_FIDUCIALS],
                         const struct gsn_fiducial mark[GSN_FIDUCIALS], int mirrored)
{
    struct gsn_point a = { 0 }, b = { 0 };
    double along = 0, across = 0;

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        a.x += block[i].x / GSN_FIDUCIALS;
        a.y += block[i].y / GSN_FIDUCIALS;
        b.x += mark[i].px.x / GSN_FIDUCIALS;
        b.y += mark[i].px.y / GSN_FIDUCIALS;
    }
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const double ux = block[i].x - a.x, uy = block[i].y - a.y;
        const double vx = (mirrored ? -1 : 1) * (mark[i].px.x - b.x), vy = mark[i].px.y - b.y;

        along += ux * vx + uy * vy;
        across += ux * vy - uy * vx;
    }
    return atan2(across, along) * 180 / M_PI;
}

/* The way that most sections lie; 0 when they do not agree, or are too few. */
static int most_lie(unsigned votes[2][4], unsigned total, struct gsn_dust_turn *ret_turn)
{
    for (int mirrored = 0; mirrored < 2; mirrored++)
        for (unsigned k = 0; k < 4; k++)
            if (votes[mirrored][k] >= LEAST_SECTIONS && votes[mirrored][k] >= MAJORITY * total) {
                *ret_turn = (struct gsn_dust_turn){ mirrored, (4 - k) % 4 };
                return 1;
            }
    return 0;
}

/* ret_told: whether the triangle of the job tells which way round the sections lie. */
static int ask_marks(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                     const struct reading *reading, struct gsn_dust_turn *ret_turn, int *ret_told,
                     struct gsn_error *err)
{
    const size_t count = reading->count;
    gsn_auto_mem(struct gsn_fiducial_candidates) candidates =
        gsn_alloc_array(count + 1, sizeof *candidates);
    gsn_auto_mem(double) scratch = gsn_alloc_array(count + 1, sizeof *scratch);
    gsn_auto(gsn_od_reader) absorber = NULL;
    struct gsn_triangle_prior prior = { 0 };
    struct gsn_fiducial_search search = { .scan = scan,
                                          .layout = reading->layout,
                                          .slots = reading->slot,
                                          .count = count,
                                          .threads = 1 };
    unsigned votes[2][4] = { { 0 } }, total = 0;
    int r = GSN_OK;

    *ret_told = 0;
    if (!candidates || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    if (!protocol->has_markers)
        return GSN_OK;
    r = gsn_od_reader_new(scan->picture->image, &scan->glass, &absorber, err);
    search.absorber = absorber;
    search.side = gsn_fiducial_search_side(reading->slot, count, scratch);
    if (r >= 0)
        r = gsn_fiducial_search_panel(&search, protocol->markers_um, candidates, err);
    memcpy(prior.mark_um, protocol->markers_um, sizeof prior.mark_um);
    if (r >= 0)
        r = gsn_fiducials_learn(candidates, count, &prior, err);
    for (size_t i = 0; r >= 0 && i < count; i++) {
        struct gsn_fiducial mark[GSN_FIDUCIALS];
        int mirrored = 0;
        double deg, quarters;

        gsn_fiducials_match(&candidates[i], &prior, mark, &mirrored, NULL, NULL);
        if (!mark[0].found || !mark[1].found || !mark[2].found)
            continue;
        deg = turned_deg(prior.mark_um, mark, mirrored);
        quarters = round(deg / 90);
        total++;
        if (fabs(deg - 90 * quarters) <= MOUNTED_DEG)
            votes[mirrored != 0][(unsigned)((int)quarters + 4) % 4]++;
    }
    *ret_told = r >= 0 && most_lie(votes, total, ret_turn);
    return r;
}

/* ---- together ---------------------------------------------------------------------------- */

static int is_same_turn(struct gsn_dust_turn a, struct gsn_dust_turn b)
{
    return !a.mirrored == !b.mirrored && a.quarters == b.quarters;
}

struct evidence {
    int coded, told; /* whether there is a code, and whether the marks tell */
    struct gsn_dust_turn code, marks;
    int grid; /* > 0: the grid lies on its side, < 0: it lies as stated, 0: either */
    size_t sections;
};

/* A label's code lies on its side because the whole panel does, or by make. */
static int decide_lying_code(const struct evidence *e, struct gsn_dust_turn *ret_turn)
{
    const struct gsn_dust_turn as_made = { e->code.mirrored, 0 };

    if (e->grid > 0 || (e->grid == 0 && e->told && is_same_turn(e->marks, e->code)))
        *ret_turn = e->code;
    else if (e->grid < 0 || (e->told && is_same_turn(e->marks, as_made)))
        *ret_turn = as_made;
    else
        return 0;
    return 1;
}

static int decide_without_code(const struct evidence *e, struct gsn_dust_turn *ret_turn)
{
    if (e->grid < 0 || (e->grid == 0 && e->sections == 0))
        *ret_turn = (struct gsn_dust_turn){ 0 };
    else if (e->told && (e->grid == 0 || e->marks.quarters % 2 == 1))
        *ret_turn = e->marks;
    else
        return 0;
    return 1;
}

/* Whether the evidence settles it; ret_turn only then. */
static int decide_turn(const struct evidence *e, struct gsn_dust_turn *ret_turn)
{
    if (!e->coded)
        return decide_without_code(e, ret_turn);
    if (e->code.quarters % 2 == 1)
        return decide_lying_code(e, ret_turn);
    if (e->grid > 0)
        return 0;
    *ret_turn = e->code;
    return 1;
}

static int refuse_panel(const struct evidence *e, const struct gsn_protocol *protocol,
                        struct gsn_error *err)
{
    if (e->coded && e->code.quarters % 2 == 0)
        return gsn_fail(err, GSN_E_WITHHELD,
                        "its label stands upright, but its sections lie as %u rows of %u and not "
                        "as %u rows of %u: put \"layout\" in job.json right",
                        protocol->columns, protocol->rows, protocol->rows, protocol->columns);
    if (e->coded)
        return gsn_fail(err, GSN_E_WITHHELD,
                        "its label lies on its side, and neither the grid of its sections nor "
                        "their marks tell whether the panel does: turn the picture upright, or "
                        "state \"markers_um\" in job.json");
    return gsn_fail(err, GSN_E_WITHHELD,
                    "the panel seems to lie on its side (%u rows of %u are stated), and neither a "
                    "code on its label nor the marks of its sections tell which way it was turned: "
                    "turn the picture upright, or state \"markers_um\" in job.json",
                    protocol->rows, protocol->columns);
}

int gsn_orientation_find(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                         struct gsn_dust_turn *ret_turn, const char **ret_why,
                         struct gsn_error *err)
{
    struct evidence e = { .coded = code_of(scan->picture) != NULL,
                          .code = gsn_orientation_by_code(scan->picture) };
    struct reading stated, lying;
    int r = read_as(scan, protocol->rows, protocol->columns, &stated, err);

    lying.slot = NULL;
    if (r >= 0)
        r = read_as(scan, protocol->columns, protocol->rows, &lying, err);
    if (r >= 0) {
        const struct reading *best = lying.score > stated.score ? &lying : &stated;

        e.grid = (lying.score > stated.score) - (lying.score < stated.score);
        e.sections = best->count;
        if (e.grid == 0 || (e.grid > 0 && !e.coded))
            r = ask_marks(scan, protocol, best, &e.marks, &e.told, err);
    }
    gsn_free(stated.slot);
    gsn_free(lying.slot);
    if (r < 0)
        return r;
    if (!decide_turn(&e, ret_turn))
        return refuse_panel(&e, protocol, err);
    if (!e.coded)
        *ret_why = "so lie the marks of most of its sections";
    else if (ret_turn->quarters % 2 == 1)
        *ret_why = "the code on its label and its sections lay on their side";
    return GSN_OK;
}
