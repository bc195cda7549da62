/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which specimens there are, a line each, and the plan of one: how its sections lie on their
 * panels, with all that is drawn for the poses and the stains. The plan is a plain value. */
#include "pipeline/phantom/plan.h"

#include "pipeline/core/mem.h"
#include "pipeline/phantom/delivery.h"
#include "pipeline/phantom/mishap.h"

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

#define RAD_PER_DEG (M_PI / 180)

const double gsn_phantom_slot_half_um = 4000;

static const struct gsn_point FIRST_SLOT_UM = { 8200, 4300 };
static const double PITCH_UM = 8000;

/* Of a panel, beside its slots. */
static const double BORDER_X_UM = 4800, BORDER_Y_UM = 960;
static const double LEAST_PX_UM = 4, MOST_PX_UM = 48;

/* A bad bench, however its panels come in. */
#define BAD_BENCH                                                                                  \
    .turn_within_deg = 180, .flip_share = .10, .jitter_um = 1300, .size_sd = .02, .axis_sd = .01,  \
    .warp_rms_um = 30, .mark_missing_share = .08, .mark_wander_um = 6, .decoys_most = 6,           \
    .ln_red_sd = .20, .ln_yellow_sd = .25, .dye_turn_deg = 5, .white_sd = .03, .ramp = .10,        \
    .illumination = .15, .noise_sd = 3, .texture = 1.3, .defects_least = 6, .defects_most = 8,     \
    .missing_least = 2, .missing_most = 3, .handled = 1, .extension = "jpg", .quality = 60

static const struct gsn_phantom_level LEVEL[] = {
    { .name = "L0", .extension = "png" },
    { .name = "L1",
      .turn_within_deg = 10,
      .jitter_um = 300,
      .illumination = .02,
      .noise_sd = 1.2,
      .texture = 1,
      .extension = "tif" },
    { .name = "L2",
      .turn_sd_deg = 12,
      .half_turn_share = .05,
      .flip_share = .03,
      .jitter_um = 600,
      .size_sd = .008,
      .axis_sd = .004,
      .warp_rms_um = 10,
      .mark_missing_share = .03,
      .mark_wander_um = 2,
      .decoys_most = 2,
      .ln_red_sd = .10,
      .ln_yellow_sd = .15,
      .dye_turn_deg = 2,
      .white_sd = .01,
      .ramp = .05,
      .illumination = .06,
      .noise_sd = 1.5,
      .texture = 1,
      .defects_least = 2,
      .defects_most = 3,
      .missing_least = 1,
      .missing_most = 1,
      .handled = 1,
      .extension = "jpg",
      .quality = 85 },
    { .name = "L3", .awkward = 1, BAD_BENCH },
    { .name = "L3-whole", BAD_BENCH },
};

static const struct gsn_phantom_level *find_level(const char *name)
{
    for (size_t i = 0; i < sizeof LEVEL / sizeof *LEVEL; i++)
        if (strcmp(LEVEL[i].name, name) == 0)
            return &LEVEL[i];
    return NULL;
}

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

/* Within -most..most. */
static double draw_within(struct gsn_phantom_random *random, double most)
{
    return most * (2 * gsn_phantom_uniform(random) - 1);
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

/* What a hand adds to the pose: some sections lie upside down or turned over, and the water has
 * stretched them. */
static void handle_section(const struct gsn_phantom_level *level, struct gsn_phantom_random *random,
                           struct gsn_phantom_section *s)
{
    double size;

    s->theta += RAD_PER_DEG * gsn_phantom_normal(random, level->turn_sd_deg);
    s->theta += gsn_phantom_uniform(random) < level->half_turn_share ? M_PI : 0;
    s->flip = gsn_phantom_uniform(random) < level->flip_share;
    size = gsn_phantom_normal(random, level->size_sd);
    s->sx = 1 + size + gsn_phantom_normal(random, level->axis_sd);
    s->sy = 1 + size + gsn_phantom_normal(random, level->axis_sd);
}

static void place_section(struct gsn_phantom_plan *plan, int k)
{
    struct gsn_phantom_section *s = &plan->section[k];
    struct gsn_phantom_random random = gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_POSE, k, 0);
    struct gsn_point centre;

    *s = (struct gsn_phantom_section){ .k = k,
                                       .panel = k / plan->slots + 1,
                                       .slot = k % plan->slots,
                                       .shows = k,
                                       .z_um = gsn_phantom_section_z(&plan->variant.geometry, k),
                                       .sx = 1,
                                       .sy = 1 };
    centre = gsn_phantom_slot_centre_um(plan, s->slot);
    s->theta = RAD_PER_DEG * draw_within(&random, plan->level.turn_within_deg);
    s->centre_px.x = (centre.x + draw_within(&random, plan->level.jitter_um)) / plan->px_um;
    s->centre_px.y = (centre.y + draw_within(&random, plan->level.jitter_um)) / plan->px_um;
    if (plan->level.handled || plan->level.size_sd > 0)
        handle_section(&plan->level, &random, s);
    s->to_panel = gsn_phantom_panel_map(s, plan->px_um);
}

static void mix_batch(struct gsn_phantom_plan *plan, int panel)
{
    /* Above this a brighter glass would clip, which is a fault of the scanner, not of the glass. */
    const double brightest = 254;
    const struct gsn_phantom_level *level = &plan->level;
    struct gsn_phantom_batch *batch = &plan->batch[panel];
    struct gsn_phantom_random random =
        gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_BATCH, panel, 0);

    *batch = (struct gsn_phantom_batch){ .red_gain = plan->specimen.red_gain,
                                         .yellow_gain = plan->specimen.yellow_gain };
    for (int i = 0; i < GSN_PHANTOM_DYES; i++)
        gsn_phantom_variant_dye(&plan->variant, (enum gsn_phantom_dye)i, batch->dye[i]);
    for (int c = 0; c < 3; c++)
        batch->white[c] = gsn_phantom_white[c];
    if (!level->handled && level->dye_turn_deg == 0)
        return;
    batch->red_gain *= exp(gsn_phantom_normal(&random, level->ln_red_sd));
    batch->yellow_gain *= exp(gsn_phantom_normal(&random, level->ln_yellow_sd));
    for (int i = 0; i < GSN_PHANTOM_MARK; i++)
        gsn_phantom_turn_vector(
            &random, RAD_PER_DEG * gsn_phantom_normal(&random, level->dye_turn_deg), batch->dye[i]);
    for (int c = 0; c < 3; c++)
        batch->white[c] =
            fmin(brightest, batch->white[c] * (1 + gsn_phantom_normal(&random, level->white_sd)));
}

/* What the variant has instead of what the level and the specimen have. */
static void apply_variant(struct gsn_phantom_plan *plan)
{
    const struct gsn_phantom_variant *v = &plan->variant;

    plan->specimen.depth *= v->loss;
    plan->specimen.red_gain *= v->stain_strength;
    plan->specimen.yellow_gain *= v->stain_strength;
    plan->level.texture *= v->texture;
    if (v->panel_turn_deg >= 0)
        plan->level.dye_turn_deg = v->panel_turn_deg;
    if (v->size_share >= 0)
        plan->level.size_sd = v->size_share;
    if (v->jpeg_quality >= 0) {
        plan->level.extension = v->jpeg_quality > 0 ? "jpg" : "png";
        plan->level.quality = v->jpeg_quality;
    }
}

/* As many panels as the sections of the specimen and of its block fill. */
static void count_panels(struct gsn_phantom_plan *plan)
{
    const struct gsn_phantom_variant *v = &plan->variant;
    const int sections = plan->specimen.sections < v->geometry.sections ? plan->specimen.sections
                                                                        : v->geometry.sections;
    const double frame = 2 * gsn_phantom_frame_um(plan);

    plan->slots = v->rows * v->columns;
    plan->panels = sections / plan->slots;
    plan->sections = plan->panels * plan->slots;
    plan->width = (uint32_t)lround((BORDER_X_UM + PITCH_UM * v->columns + frame) / plan->px_um);
    plan->height = (uint32_t)lround((BORDER_Y_UM + PITCH_UM * v->rows + frame) / plan->px_um);
}

int gsn_phantom_plan_make(const char *specimen, const char *level, uint64_t seed, double px_um,
                          struct gsn_phantom_plan *ret_plan, struct gsn_error *err)
{
    const struct gsn_phantom_variant usual = gsn_phantom_variant_usual();

    return gsn_phantom_plan_make_variant(specimen, level, seed, px_um, &usual, ret_plan, err);
}

int gsn_phantom_plan_make_variant(const char *specimen, const char *level, uint64_t seed,
                                  double px_um, const struct gsn_phantom_variant *variant,
                                  struct gsn_phantom_plan *ret_plan, struct gsn_error *err)
{
    const struct gsn_phantom_specimen *of = gsn_phantom_specimen_find(specimen);
    const struct gsn_phantom_level *at = find_level(level);
    gsn_auto_mem(struct gsn_phantom_plan) plan = gsn_alloc_array(1, sizeof *plan);

    if (!plan)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the plan of %s", specimen);
    if (!of)
        return gsn_fail(err, GSN_E_NOTFOUND,
                        "no specimen %s: there are S00 to S04, and of the study N1 to N4, S1 to "
                        "S4, U1 to U4, T2, T4 and T8",
                        specimen);
    if (!at)
        return gsn_fail(err, GSN_E_NOTFOUND, "no level %s: there are L0 to L3, and L3-whole",
                        level);
    if (px_um == 0)
        px_um = of->usual_px_um;
    if (!(px_um >= LEAST_PX_UM && px_um <= MOST_PX_UM))
        return gsn_fail(err, GSN_E_LIMIT, "a pixel of %g um: it must be %g to %g um", px_um,
                        LEAST_PX_UM, MOST_PX_UM);
    if (of->depth * variant->loss > 1)
        return gsn_fail(err, GSN_E_LIMIT,
                        "the lesion of %s is %g deep: its \"loss\" can be %.3f at most", specimen,
                        of->depth, 1 / of->depth);
    plan->specimen = *of;
    plan->level = *at;
    plan->seed = seed;
    plan->px_um = px_um;
    plan->variant = *variant;
    apply_variant(plan);
    count_panels(plan);
    if (plan->panels == 0)
        return gsn_fail(err, GSN_E_LIMIT, "%d sections do not fill a panel of %d",
                        variant->geometry.sections, plan->slots);
    for (int k = 0; k < plan->sections; k++)
        place_section(plan, k);
    for (int panel = 0; panel < plan->panels; panel++)
        mix_batch(plan, panel);
    gsn_phantom_delivery_draw(plan);
    gsn_phantom_mishaps_draw(plan);
    *ret_plan = *plan;
    return GSN_OK;
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
