/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include "tests/check.h"
#include "tests/register/draw.h"
#include "tests/register/mounted.h"

#include <math.h>

/* Blocks drawn anew for every stack: an outline, structures of half a millimetre that drift from
 * section to section, and a texture of some 60 um that each section has for itself. Each mount of a
 * section is laid, stretched, warped, stained, torn and scanned in its own way. */
enum {
    SECTIONS = 14,
    COLUMNS = 112,
    ROWS = 88,
    CELLS = COLUMNS * ROWS,
    MARGIN = 8,
    WIDE = COLUMNS + 2 * MARGIN,
    HIGH = ROWS + 2 * MARGIN,
    AREA = WIDE * HIGH,
    WAVES = 24
};

/* What the water, the hand and the scanner do to a mount, by the phantom's levels (PHANTOM.md
 * section 5). Noise is such that two mounts and neighbours have as much texture in common as on the
 * phantom's laid panels: 61 to 66 and 22 to 24 % at L2, 51 to 58 and 18 to 19 % at L3. Lengths in
 * cells of 33 um. */
struct bench {
    const char *name;
    double laid, common, axis, warp, stain, noise;
};
static const struct bench L2 = { "L2", 0.3, 0.008, 0.004, 0.3, 0.1, 0.05 };
static const struct bench L3 = { "L3", 0.5, 0.02, 0.01, 0.9, 0.2, 0.06 };
static const double WARP_LENGTH = 25;

static float outline[3][AREA], block[SECTIONS][AREA], seen[SECTIONS][CELLS];
static struct gsn_sequence_plane planes[SECTIONS];

struct wave {
    double x, y, z, phase;
};

static void draw_waves(struct wave waves[WAVES], struct draw_chance *chance)
{
    for (int i = 0; i < WAVES; i++) {
        const double way = draw_uniform(chance, 0, 2 * M_PI);
        const double length = draw_uniform(chance, 12, 60);

        waves[i] = (struct wave){ 2 * M_PI / length * cos(way), 2 * M_PI / length * sin(way),
                                  0.25 * draw_normal(chance), draw_uniform(chance, 0, 2 * M_PI) };
    }
}

/* Independent numbers, smoothed by (1 2 1) / 4 along both axes and of deviation 1 again. */
static void draw_texture(float texture[AREA], struct draw_chance *chance)
{
    static float raw[AREA];
    double squares = 0;

    for (int c = 0; c < AREA; c++)
        raw[c] = (float)draw_uniform(chance, -1, 1);
    for (int c = 0; c < AREA; c++) {
        const int left = c % WIDE ? c - 1 : c, right = c % WIDE < WIDE - 1 ? c + 1 : c;

        texture[c] = raw[left] + 2 * raw[c] + raw[right];
    }
    for (int c = 0; c < AREA; c++)
        raw[c] = texture[c < WIDE ? c : c - WIDE] + 2 * texture[c] +
                 texture[c >= AREA - WIDE ? c : c + WIDE];
    for (int c = 0; c < AREA; c++)
        squares += (double)raw[c] * (double)raw[c] / AREA;
    for (int c = 0; c < AREA; c++)
        texture[c] = raw[c] / (float)sqrt(squares);
}

/* Adds the structures of section k, of deviation 1. */
static void add_waves(float sum[AREA], const struct wave waves[WAVES], int k)
{
    const double scale = 1 / sqrt(WAVES / 2.0);

    for (int c = 0; c < AREA; c++)
        sum[c] = 0;
    for (int i = 0; i < WAVES; i++) {
        float along[2][WIDE];

        for (int x = 0; x < WIDE; x++) {
            along[0][x] = (float)(scale * cos(waves[i].x * x));
            along[1][x] = (float)(scale * sin(waves[i].x * x));
        }
        for (int y = 0; y < HIGH; y++) {
            const double rest = waves[i].y * y + waves[i].z * k + waves[i].phase;
            const float c = (float)cos(rest), n = (float)sin(rest);

            for (int x = 0; x < WIDE; x++)
                sum[y * WIDE + x] += along[0][x] * c - along[1][x] * n;
        }
    }
}

/* How far each cell lies out, the rim of the outline at 1; three lobes. */
static void fill_outline(void)
{
    if (outline[0][0] > 0)
        return;
    for (int c = 0; c < AREA; c++) {
        const double x = c % WIDE - WIDE / 2.0, y = c / WIDE - HIGH / 2.0;

        outline[0][c] = (float)hypot(x / 52, y / 42);
        outline[1][c] = 0.05f * (float)cos(3 * atan2(y, x));
        outline[2][c] = 0.05f * (float)sin(3 * atan2(y, x));
    }
}

static void draw_block(struct draw_chance *chance)
{
    static float texture[AREA], sum[AREA];
    struct wave waves[WAVES];
    const double phase = draw_uniform(chance, 0, 2 * M_PI);

    fill_outline();
    draw_waves(waves, chance);
    for (int k = 0; k < SECTIONS; k++) {
        const float a = (float)cos(phase + 0.05 * k), b = (float)sin(phase + 0.05 * k);

        draw_texture(texture, chance);
        add_waves(sum, waves, k);
        for (int c = 0; c < AREA; c++) {
            const float edge = 1 + a * outline[1][c] + b * outline[2][c];

            block[k][c] =
                outline[0][c] < edge ? 0.5f * expf(0.25f * sum[c] + 0.15f * texture[c]) : 0;
        }
    }
}

static double between(const float *plane, double x, double y)
{
    const double u = fmin(fmax(x + MARGIN, 0), WIDE - 1.001),
                 v = fmin(fmax(y + MARGIN, 0), HIGH - 1.001);
    const int i = (int)u, j = (int)v;
    const float *at = plane + j * WIDE + i;
    const double fx = u - i, fy = v - j;

    return (1 - fy) * ((1 - fx) * (double)at[0] + fx * (double)at[1]) +
           fy * ((1 - fx) * (double)at[WIDE] + fx * (double)at[WIDE + 1]);
}

static void mount(const struct bench *b, int k, float *cells, struct draw_chance *chance)
{
    const double size = b->common * draw_normal(chance);
    const double sx = 1 + size + b->axis * draw_normal(chance);
    const double sy = 1 + size + b->axis * draw_normal(chance);
    const double turn = 0.005 * draw_normal(chance), stain = exp(b->stain * draw_normal(chance));
    const double dx = b->laid * draw_normal(chance), dy = b->laid * draw_normal(chance);
    const int torn = (int)draw_uniform(chance, 0, CELLS - 80);
    /* The product of two sines has a mean square of a quarter, and there are two. */
    double column[2][COLUMNS], row[2][ROWS];

    for (int i = 0; i < 2; i++) {
        const double p = draw_uniform(chance, 0, 2 * M_PI), q = draw_uniform(chance, 0, 2 * M_PI);

        for (int x = 0; x < COLUMNS; x++)
            column[i][x] = M_SQRT2 * b->warp * sin(x / WARP_LENGTH + p);
        for (int y = 0; y < ROWS; y++)
            row[i][y] = sin(y / WARP_LENGTH + q);
    }
    for (int c = 0; c < CELLS; c++) {
        const int i = c % COLUMNS, j = c / COLUMNS;
        const double u = i - COLUMNS / 2.0, v = j - ROWS / 2.0;
        const double x = COLUMNS / 2.0 + sx * u - turn * v + dx + column[0][i] * row[0][j];
        const double y = ROWS / 2.0 + turn * u + sy * v + dy + column[1][i] * row[1][j];
        /* Of deviation 1. */
        const double noise = draw_uniform(chance, -1.7320508, 1.7320508);

        cells[c] = (float)(stain * between(block[k], x, y) * (1 + b->noise * noise));
    }
    for (int c = torn; c < torn + 60; c++)
        cells[c] = NAN;
}

struct tally {
    size_t stacks, made, named, others, swaps, untold;
    double texture, usual, least; /* shared by two mounts, by neighbours; the least of mounts */
};

static void count_findings(const struct gsn_sequence *s, const unsigned *at, size_t count,
                           struct tally *t)
{
    t->stacks++;
    t->made += count;
    t->untold += !s->twice_told;
    for (size_t i = 0; i < s->count; i++) {
        const struct gsn_sequence_finding *f = &s->finding[i];
        int is = 0;

        for (size_t k = 0; k < count; k++)
            is |= f->kind == GSN_SEQUENCE_DUPLICATE && f->a == at[k] && f->b == at[k] + 1;
        t->named += is != 0;
        t->others += !is && f->kind == GSN_SEQUENCE_DUPLICATE;
        t->swaps += f->kind == GSN_SEQUENCE_SWAP;
        if (is) {
            t->texture += f->evidence;
            t->usual += f->usual;
            t->least = fmin(t->least, f->evidence);
        }
    }
}

/* Whole: with the order of the sections, for which most of the time goes. */
static void look(int whole, const unsigned *at, size_t count, struct tally *t)
{
    struct gsn_sequence_finding finding[2 * SECTIONS + 1];
    struct gsn_sequence twice = { .finding = finding };
    gsn_auto(gsn_sequence) all = NULL;
    struct gsn_error err = { 0 };

    if (whole)
        CHECK_OK(gsn_sequence_examine(planes, SECTIONS, COLUMNS, ROWS, &all, &err), err);
    else
        CHECK_OK(gsn_sequence_find_duplicates(planes, SECTIONS, COLUMNS, ROWS, &twice, &err), err);
    count_findings(whole ? all : &twice, at, count, t);
}

/* Two sections of a stack are mounted twice, one in each half: the next slot holds the second
 * mount, and what belongs there is missing. Numbers stay as they are. */
static struct tally mount_twice(const struct bench *b, int whole, size_t trials, unsigned pairs,
                                uint64_t seed)
{
    struct draw_chance chance = { seed };
    struct tally t = { .least = 1 };

    while (pairs ? t.made < trials : t.stacks < trials) {
        unsigned at[2] = { 0 };

        draw_block(&chance);
        for (unsigned i = 0; i < pairs; i++)
            at[i] = i * SECTIONS / 2 + (unsigned)draw_uniform(&chance, 0, SECTIONS / 2.0 - 1);
        for (unsigned k = 0; k < SECTIONS; k++) {
            const int again = (pairs > 0 && k == at[0] + 1) || (pairs > 1 && k == at[1] + 1);

            mount(b, (int)(again ? k - 1 : k), seen[k], &chance);
            planes[k] = (struct gsn_sequence_plane){ k, seen[k] };
        }
        look(whole, at, pairs, &t);
    }
    print_message("  %s: %zu stacks, %zu sections mounted twice: %zu named (%.2f %%), %zu others "
                  "named, %zu stacks told blind, %zu swaps proposed",
                  b->name, t.stacks, t.made, t.named,
                  t.made ? 100 * (double)t.named / (double)t.made : 0, t.others, t.untold, t.swaps);
    if (t.named)
        print_message("; texture in common %.2f (%.2f at least), neighbours %.2f",
                      t.texture / (double)t.named, t.least, t.usual / (double)t.named);
    print_message("\n");
    return t;
}

/* Case 31. The long run: GIESON_TRIALS=10000 build/bench/tests/test_register_twice. */
TEST(a_section_mounted_twice_is_named_whatever_the_mounts_did_to_it)
{
    const size_t trials = mounted_trials(60);
    const struct tally easy = mount_twice(&L2, 0, trials, 2, 1),
                       hard = mount_twice(&L3, 0, trials, 2, 2);

    CHECK((double)easy.named >= 0.99 * (double)easy.made);
    CHECK((double)hard.named >= 0.99 * (double)hard.made);
    CHECK((double)(easy.others + hard.others) <= 0.01 * (double)(easy.stacks + hard.stacks));
}

TEST(stacks_without_a_section_mounted_twice_name_none)
{
    const size_t trials = mounted_trials(60) / 4;
    const struct tally easy = mount_twice(&L2, 0, trials, 0, 3),
                       hard = mount_twice(&L3, 0, trials, 0, 4);

    CHECK((double)(easy.others + hard.others) <= 0.01 * (double)(easy.stacks + hard.stacks));
}

/* The order of the sections is looked at, too: what lies at a missing section's place may look
 * swapped besides, which is printed. */
TEST(both_mounts_are_named_where_the_order_is_examined_too)
{
    const size_t trials = mounted_trials(800) / 100;
    const struct tally t = mount_twice(&L2, 1, trials, 2, 5);

    CHECK((double)t.named >= 0.99 * (double)t.made);
}
