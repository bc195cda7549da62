/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/pose/pose.h"

#include "tests/check.h"
#include "pipeline/phantom/geometry.h"
#include "pipeline/register/fiducial/learn.h"
#include "pipeline/register/fiducial/correspondence.h"
#include "tests/register/draw.h"
#include "tests/register/mounted.h"

#include <string.h>

/* Stacks as hard as the phantom's levels L2 and L3 (PHANTOM.md section 5), by their spots and by
 * the tissue seen from afar: any rotation, one section in five face down, marks lost, spots that
 * are no marks, strain. Nothing says which spot is which. */
enum { SECTIONS = 125, WIDE = 100, HIGH = 80 };
static const double CELL_UM = 66;

struct bench {
    struct mounted_world world;
    unsigned most_decoys;
};

static const struct bench L2 = {
    .world = { .marks = mounted_marks,
               .angle = M_PI,
               .flips = 0.2,
               .burn_um = 5,
               .fit_um = 4,
               .strain_sd = { 0.008, 0.003, 0.001 },
               .missing = 0.09 },
    .most_decoys = 2,
};
static const struct bench L3 = {
    .world = { .marks = mounted_marks,
               .angle = M_PI,
               .flips = 0.2,
               .burn_um = 15,
               .fit_um = 8,
               .strain_sd = { 0.02, 0.007, 0.003 },
               .missing = 0.22 },
    .most_decoys = 6,
};

static struct gsn_fiducial_candidates sections[SECTIONS];
static float block[WIDE * HIGH];

/* The phantom's block in its middle. */
static void fill_block(void)
{
    for (int i = 0; i < WIDE * HIGH; i++) {
        const struct gsn_vec3 at = { (i % WIDE + 0.5 - WIDE / 2.0) * CELL_UM,
                                     (i / WIDE + 0.5 - HIGH / 2.0) * CELL_UM,
                                     gsn_phantom_section_z(gsn_phantom_geometry(), 30) };
        struct gsn_phantom_field field;

        gsn_phantom_field_at(gsn_phantom_geometry(), at, &field);
        block[i] = (float)(0.2 * field.tissue + 0.5 * gsn_phantom_density(&field, 0.37));
    }
}

static double tissue_at(struct gsn_point um)
{
    const double x = floor(um.x / CELL_UM + WIDE / 2.0), y = floor(um.y / CELL_UM + HIGH / 2.0);

    if (!(x >= 0 && x < WIDE && y >= 0 && y < HIGH))
        return 0;
    return (double)block[(int)y * WIDE + (int)x];
}

/* The section's tissue in cells, each of which differs by a tenth from the block's. */
static void see_tissue(struct gsn_fiducial_candidates *s, const struct mounted *m,
                       struct draw_chance *chance)
{
    const double c = cos(m->angle), n = sin(m->angle), stain = exp(0.15 * draw_normal(chance));

    s->map.cell = 170 / MOUNTED_PX;
    s->map.origin.x = m->centre_px.x - GSN_THUMBNAIL_SIDE / 2.0 * s->map.cell;
    s->map.origin.y = m->centre_px.y - GSN_THUMBNAIL_SIDE / 2.0 * s->map.cell;
    for (int i = 0; i < GSN_THUMBNAIL_SIDE * GSN_THUMBNAIL_SIDE; i++) {
        const double x = 170 * (i % GSN_THUMBNAIL_SIDE + 0.5 - GSN_THUMBNAIL_SIDE / 2.0);
        const double y = 170 * (i / GSN_THUMBNAIL_SIDE + 0.5 - GSN_THUMBNAIL_SIDE / 2.0);
        const double u = c * x + n * y;
        const struct gsn_point um = { m->flipped ? -u : u, c * y - n * x };

        s->map.value[i] = (float)(stain * tissue_at(um) * (1 + 0.1 * draw_normal(chance)));
    }
}

static void add_spot(struct gsn_fiducial_candidates *s, const struct gsn_fiducial *looks,
                     struct draw_chance *chance)
{
    struct gsn_fiducial spot = *looks;

    spot.found = 1;
    /* In any order: each new one changes places with one that is there. */
    const size_t at = (size_t)draw_uniform(chance, 0, (double)s->count + 1);

    s->mark[s->count++] = s->mark[at];
    s->mark[at] = spot;
}

/* What is seen of a section: its marks that are there, and debris that may look like them. */
static void see(const struct bench *bench, const struct mounted_stack *stack, size_t i,
                struct draw_chance *chance)
{
    const unsigned decoys = (unsigned)draw_uniform(chance, 0, bench->most_decoys + 1);
    struct gsn_fiducial_candidates *s = &sections[i];

    *s = (struct gsn_fiducial_candidates){ .px_um = MOUNTED_PX };
    s->tissue_px = mounted_px(&stack->mounting[i], (struct gsn_point){ 120 * draw_normal(chance),
                                                                       120 * draw_normal(chance) });
    see_tissue(s, &stack->mounting[i], chance);
    for (int m = 0; m < GSN_FIDUCIALS; m++) {
        struct gsn_fiducial spot = stack->input[i].marks[m];

        spot.radius_px = 75 / MOUNTED_PX * (1 + draw_uniform(chance, -0.1, 0.1));
        spot.contrast = 0.4 * exp(0.1 * draw_normal(chance));
        spot.score = draw_uniform(chance, 0.85, 0.97);
        if (spot.found)
            add_spot(s, &spot, chance);
    }
    for (unsigned k = 0; k < decoys; k++) {
        struct gsn_fiducial spot = stack->input[i].marks[0];

        /* Debris, heaps of pigment, ink, rims: 40 to 130 um, few as round as a mark. */
        spot.px = mounted_px(&stack->mounting[i],
                             (struct gsn_point){ draw_uniform(chance, -2400, 2400),
                                                 draw_uniform(chance, -1900, 1900) });
        spot.radius_px = draw_uniform(chance, 40, 130) / MOUNTED_PX;
        spot.contrast = 0.4 * exp(0.4 * draw_normal(chance));
        spot.score = draw_uniform(chance, 0.5, 0.97);
        add_spot(s, &spot, chance);
    }
}

/* From spots to numbered marks, as the product does. */
static void number(struct mounted_stack *stack)
{
    struct gsn_triangle_prior prior = { 0 };
    struct gsn_error err = { 0 };

    memcpy(prior.mark_um, mounted_marks, sizeof prior.mark_um);
    CHECK_OK(gsn_fiducials_learn(sections, stack->count, &prior, &err), err);
    CHECK(prior.learnt);
    for (size_t i = 0; i < stack->count; i++)
        gsn_fiducials_match(&sections[i], &prior, stack->input[i].marks, &stack->input[i].mirrored,
                            NULL, NULL);
}

struct tally {
    size_t mirrored, called, asked, silent; /* silent: used, and not called flipped */
    size_t upright, upright_asked, blamed;
    size_t misnumbered; /* used, with a mark on another's number */
};

static int is_misnumbered(const struct mounted_stack *s, size_t i)
{
    for (int m = 0; m < GSN_FIDUCIALS; m++) {
        const struct gsn_fiducial *mark = &s->input[i].marks[m];
        const struct gsn_point true_px = mounted_px(&s->mounting[i], mounted_marks[m]);

        if (mark->found && hypot(mark->px.x - true_px.x, mark->px.y - true_px.y) > 150 / MOUNTED_PX)
            return 1;
    }
    return 0;
}

/* Doubtful: no pose, two marks, or marks that contradict the stack; a person is asked. */
static void count_section(const struct mounted_stack *s, size_t i, struct tally *t)
{
    const int used = s->pose[i].state == GSN_POSE_OK && !s->pose[i].gross;
    const int flipped = s->pose[i].flipped != 0;

    t->misnumbered += used && is_misnumbered(s, i);
    if (s->mounting[i].flipped) {
        t->mirrored++;
        t->called += used && flipped;
        t->asked += !used;
        t->silent += used && !flipped;
    } else {
        t->upright++;
        t->upright_asked += !used;
        t->blamed += used && flipped;
    }
}

static struct tally mirror(const char *level, const struct bench *bench, size_t trials,
                           uint64_t seed)
{
    struct draw_chance chance = { seed };
    struct mounted_stack s = mounted_new(SECTIONS);
    struct tally t = { 0 };

    fill_block();
    while (t.mirrored < trials) {
        mounted_draw(&s, &bench->world, &chance);
        for (size_t i = 0; i < s.count; i++)
            see(bench, &s, i, &chance);
        number(&s);
        mounted_solve(&s, &mounted_declared);
        CHECK(s.summary.flips_told);
        for (size_t i = 0; i < s.count; i++)
            count_section(&s, i, &t);
    }
    mounted_done(&s);
    print_message("  %s: %zu mirrored: %zu called flipped (%.2f %%), %zu asked about, %zu silently "
                  "upright; %zu upright: %zu asked about, %zu called flipped; %zu used with a "
                  "wrong mark\n",
                  level, t.mirrored, t.called, 100 * (double)t.called / (double)t.mirrored, t.asked,
                  t.silent, t.upright, t.upright_asked, t.blamed, t.misnumbered);
    return t;
}

/* At most one in ten thousand, and one for chance. */
static int are_rare(size_t events, size_t of)
{
    return (double)events <= fmax(1, 1e-4 * (double)of);
}

/* Case 17. The long run: GIESON_TRIALS=10000 build/bench/tests/test_register_mirrored. */
TEST(a_mirrored_section_is_called_flipped_or_asked_about)
{
    const struct tally t = mirror("L2", &L2, mounted_trials(200), 1),
                       hard = mirror("L3", &L3, mounted_trials(200), 2);

    CHECK(are_rare(t.silent, t.mirrored) && are_rare(t.blamed, t.upright));
    CHECK(are_rare(hard.silent, hard.mirrored) && are_rare(hard.blamed, hard.upright));
    CHECK(are_rare(t.misnumbered, t.mirrored + t.upright));
    /* Hardly more mirrored sections than upright ones are asked about. */
    CHECK((double)t.asked / (double)t.mirrored <=
          (double)t.upright_asked / (double)t.upright + 0.08);
}
