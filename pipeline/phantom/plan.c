/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which specimens there are, a line each, and what follows from the plan of one: where slots and
 * sections lie on their panels, and which random numbers are whose. Planning (planning.c) fills a
 * plan in; everything else reads it. Failure: none. Cost: none, but for a warp (warp.c). */
#include "pipeline/phantom/plan.h"

#include <math.h>
#include <string.h>

/* One line of the table. A loss is proportional to the depth of the lesion, and 44.873 % at A = 1;
 * a control of the study has none, but bone of its own density. */
#define LOSS(percent) ((percent) / 44.873)
#define WHOLE(name, group, animal, depth, red, yellow, draws, baseline)                            \
    {                                                                                              \
        name, group, animal, 8, depth, red, yellow, draws, baseline, 60, 1, 16                     \
    }
#define CONTROL(name, gain, draws)                                                                 \
    {                                                                                              \
        name, "N", name, 8, 0, 1, 1, draws, NULL, 36, gain, 24                                     \
    }
#define TREATED(name, group, week, percent, draws)                                                 \
    {                                                                                              \
        name, group, name, week, LOSS(percent), 1, 1, draws, "N", 36, 1, 24                        \
    }

/* S03 and S04 are the block, the cuts and the grain of S02 in another stain. */
static const struct gsn_phantom_specimen SPECIMEN[GSN_PHANTOM_SPECIMENS] = {
    WHOLE("S00", "N", "N1", 0, 1, 1, 0, NULL),
    WHOLE("S01", "S", "S1", .3698, 1, 1, 1, GSN_PHANTOM_STUDY "-S00"),
    WHOLE("S02", "U", "U1", .8153, 1, 1, 2, GSN_PHANTOM_STUDY "-S00"),
    WHOLE("S03", "U", "U2", .8153, 1.15, 1.15, 2, GSN_PHANTOM_STUDY "-S00"),
    WHOLE("S04", "U", "U3", .8153, .85, 1.20, 2, GSN_PHANTOM_STUDY "-S00"),
    CONTROL("N1", .980, 10),
    CONTROL("N2", .993, 11),
    CONTROL("N3", 1.008, 12),
    CONTROL("N4", 1.019, 13),
    TREATED("S1", "S", 8, 13.5, 14),
    TREATED("S2", "S", 8, 15.7, 15),
    TREATED("S3", "S", 8, 17.8, 16),
    TREATED("S4", "S", 8, 19.4, 17),
    TREATED("U1", "U", 8, 32.2, 18),
    TREATED("U2", "U", 8, 35.3, 19),
    TREATED("U3", "U", 8, 38.1, 20),
    TREATED("U4", "U", 8, 40.8, 21),
    TREATED("T2", "T", 2, 18, 22),
    TREATED("T4", "T", 4, 27, 23),
    TREATED("T8", "T", 8, 36.6, 24),
};

const struct gsn_phantom_specimen *gsn_phantom_specimen_at(int i)
{
    return i >= 0 && i < GSN_PHANTOM_SPECIMENS ? &SPECIMEN[i] : NULL;
}

const struct gsn_phantom_specimen *gsn_phantom_specimen_find(const char *name)
{
    static const char prefix[] = GSN_PHANTOM_STUDY "-";

    if (strncmp(name, prefix, sizeof prefix - 1) == 0)
        name += sizeof prefix - 1;
    for (int i = 0; i < GSN_PHANTOM_SPECIMENS; i++)
        if (strcmp(SPECIMEN[i].name, name) == 0)
            return &SPECIMEN[i];
    return NULL;
}

const double gsn_phantom_slot_half_um = 4000;

static const struct gsn_point FIRST_SLOT_UM = { 8200, 4300 };
static const double PITCH_UM = 8000;

double gsn_phantom_frame_um(const struct gsn_phantom_plan *plan)
{
    return plan->variant.black_frame_px * plan->px_um;
}

uint32_t gsn_phantom_to_px(double um, double px_um, uint32_t most)
{
    return (uint32_t)fmin(fmax(round(um / px_um), 0), most);
}

struct gsn_point gsn_phantom_slot_centre_um(const struct gsn_phantom_plan *plan, int slot)
{
    const double frame = gsn_phantom_frame_um(plan);
    const struct gsn_point centre = {
        frame + FIRST_SLOT_UM.x + PITCH_UM * (slot % plan->variant.columns),
        frame + FIRST_SLOT_UM.y + PITCH_UM * (slot / plan->variant.columns),
    };
    return centre;
}

int gsn_phantom_plan_varies(const struct gsn_phantom_plan *plan)
{
    return plan->level.handled || plan->variant.text;
}

struct gsn_phantom_random gsn_phantom_plan_random(const struct gsn_phantom_plan *plan,
                                                  enum gsn_phantom_stream stream, int n,
                                                  uint32_t minor)
{
    const uint64_t major = (uint64_t)plan->specimen.draws_as << 32 | (uint32_t)n;

    return gsn_phantom_random_make(plan->seed, stream, major, minor);
}

struct gsn_affine gsn_phantom_panel_map(const struct gsn_phantom_section *s, double px_um)
{
    const double c = cos(s->theta) / px_um, n = sin(s->theta) / px_um;
    const double mirror = s->flip ? -1 : 1;
    const struct gsn_affine map = {
        c * s->sx * mirror, -n * s->sy, s->centre_px.x,
        n * s->sx * mirror, c * s->sy,  s->centre_px.y,
    };
    return map;
}

struct gsn_point gsn_phantom_material(const struct gsn_phantom_section *section, double px_um,
                                      struct gsn_point p)
{
    const double c = cos(section->theta), n = sin(section->theta);
    const double dx = (p.x - section->centre_px.x) * px_um;
    const double dy = (p.y - section->centre_px.y) * px_um;
    const double x = (c * dx + n * dy) / section->sx, y = (c * dy - n * dx) / section->sy;
    const struct gsn_point at = { section->flip ? -x : x, y };

    return at;
}

void gsn_phantom_plan_warp(const struct gsn_phantom_plan *plan, int k,
                           struct gsn_phantom_warp *ret_warp)
{
    const struct gsn_point centre = gsn_phantom_slot_centre_um(plan, k % plan->slots);
    const double half = gsn_phantom_slot_half_um;
    const struct gsn_point corner = { centre.x - half, centre.y - half };
    struct gsn_phantom_random random = gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_WARP, k, 0);

    gsn_phantom_warp_draw(corner, 2 * half, plan->level.warp_rms_um, &random, ret_warp);
}
