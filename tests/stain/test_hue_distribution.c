/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/hue_distribution.h"

#include "tests/check.h"
#include "tests/stain/paint.h"

#include <math.h>
#include <string.h>

enum { CELLS = 30000 };

/* Three dyes, none of them any table's. */
static const double RED[3] = { 0.25, 0.75, 0.61 }, YELLOW[3] = { 0.30, 0.35, 0.89 },
                    DARK[3] = { 0.60, 0.60, 0.53 };

/* What a made tissue is. */
struct tissue {
    double pure;            /* share of the cells without collagen */
    double least;           /* collagen of the others: from here on */
    double noise_od;        /* of a cell's optical density, each channel */
    const double (*map)[3]; /* of all colours, or NULL */
};

static void mix(const struct tissue *tissue, double red, double yellow, double dark, double od[3])
{
    double plain[3];

    for (int c = 0; c < 3; c++)
        plain[c] = red * RED[c] + yellow * YELLOW[c] + dark * DARK[c];
    for (int c = 0; c < 3; c++)
        od[c] = tissue->map ? tissue->map[c][0] * plain[0] + tissue->map[c][1] * plain[1] +
                                  tissue->map[c][2] * plain[2]
                            : plain[c];
}

/* Cells with any share of dark; returns how many points. */
static size_t make(const struct tissue *tissue, size_t cells, struct gsn_hue_edge_point *point)
{
    struct dice dice = { 23 };

    for (size_t i = 0; i < cells; i++) {
        const double dark = 0.6 * dice_even(&dice);
        const double spread = dice_even(&dice);
        const double red = dice_even(&dice) < tissue->pure ? 0 : tissue->least + 1.2 * spread;
        double od[3], all = 0;

        mix(tissue, red, 0.4 * (1 - dark), 0.4 * dark, od);
        for (int c = 0; c < 3; c++) {
            od[c] += tissue->noise_od * dice_normal(&dice);
            all += od[c];
        }
        point[i].cells = 1;
        for (int c = 0; c < 3; c++) {
            point[i].hue[c] = od[c] / all;
            point[i].variance[c] = tissue->noise_od * tissue->noise_od / (all * all);
        }
    }
    return cells;
}

/* The ratio found where this is true. */
static double found(const struct tissue *tissue, double truth, struct gsn_hue_edge *edge)
{
    static struct gsn_hue_edge_point point[CELLS];
    struct gsn_error err = { 0 };
    const size_t points = make(tissue, CELLS, point);
    double control[3], treated[3];

    mix(tissue, 0.55, 0.18, 0.01, control);
    mix(tissue, 0.55 * truth, 0.18 * truth + 0.15, 0.01 * truth + 0.07, treated);
    CHECK_OK(gsn_hue_edge_find(point, points, control, treated, edge, &err), err);
    return gsn_hue_edge_ratio(edge, control, treated, 0);
}

TEST(tissue_without_collagen_tells_the_loss_whatever_the_dyes)
{
    static const struct tissue tissue = { .pure = 0.1, .least = 0.02 };
    struct gsn_hue_edge edge;

    for (double truth = 0.3; truth < 0.95; truth += 0.2)
        CHECK_NEAR(found(&tissue, truth, &edge), truth, 0.004);
    CHECK(edge.vertex < 0.05);
    CHECK_NEAR(edge.remains[0] + edge.remains[1] + edge.remains[2], 1, 1e-12);
}

TEST(noise_of_the_scan_does_not_move_the_edge)
{
    static const struct tissue clean = { .pure = 0.1, .least = 0.02 },
                               noisy = { .pure = 0.1, .least = 0.02, .noise_od = 0.004 };
    struct gsn_hue_edge edge;

    CHECK_NEAR(found(&noisy, 0.6, &edge), found(&clean, 0.6, &edge), 0.01);
}

/* Another scanner mixes the channels; another bath turns the dyes. */
TEST(a_linear_map_of_all_colours_changes_nothing)
{
    static const double map[3][3] = { { 0.9, 0.15, 0.05 }, { 0.1, 1.1, 0 }, { 0.05, 0, 0.8 } };
    static const struct tissue plain = { .pure = 0.1, .least = 0.02, .noise_od = 0.002 }, mapped = {
        .pure = 0.1, .least = 0.02, .noise_od = 0.002, .map = map
    };
    struct gsn_hue_edge edge;

    CHECK_NEAR(found(&mapped, 0.6, &edge), found(&plain, 0.6, &edge), 0.006);
}

/* Collagen in the purest cells makes the loss too large, and that much of it is taken off. */
TEST(the_loss_is_the_largest_that_can_be_and_a_known_purity_mends_it)
{
    static const struct tissue tissue = { .pure = 0, .least = 0.06 };
    static const double control_all = 0.55 * 1.61 + 0.18 * 1.54 + 0.01 * 1.73;
    struct gsn_hue_edge edge;
    double control[3], treated[3];
    const double ratio = found(&tissue, 0.6, &edge);
    /* Red over what is not red where the line leaves the cloud, in the control's tissue over what
     * remains. */
    const double purest = 0.06 / 0.55 * control_all / (0.4 * (0.68 * 1.54 + 0.32 * 1.73));

    CHECK(ratio < 0.58);
    mix(&tissue, 0.55, 0.18, 0.01, control);
    mix(&tissue, 0.55 * 0.6, 0.18 * 0.6 + 0.15, 0.01 * 0.6 + 0.07, treated);
    CHECK_NEAR(gsn_hue_edge_ratio(&edge, control, treated, purest), 0.6, 0.01);
}

TEST(a_block_without_pure_tissue_has_a_wide_vertex)
{
    static const struct tissue pure = { .pure = 0.25, .least = 0.02 },
                               none = { .pure = 0, .least = 0.15 };
    struct gsn_hue_edge sharp, wide;

    (void)found(&pure, 0.6, &sharp);
    (void)found(&none, 0.6, &wide);
    CHECK(wide.vertex > 3 * sharp.vertex);
}

TEST(the_edge_of_the_same_cells_is_0_and_that_of_redder_ones_above)
{
    static const struct tissue tissue = { .pure = 0.1, .least = 0.02 },
                               redder = { .pure = 0, .least = 0.06 };
    static struct gsn_hue_edge_point point[CELLS];
    struct gsn_error err = { 0 };
    struct gsn_hue_edge edge;
    double at;

    (void)found(&tissue, 0.6, &edge);
    CHECK_OK(gsn_hue_edge_of(&edge, point, make(&tissue, CELLS, point), &at, &err), err);
    CHECK_NEAR(at, 0, 0.005);
    CHECK_OK(gsn_hue_edge_of(&edge, point, make(&redder, CELLS, point), &at, &err), err);
    CHECK(at > 0.08 && at < 0.3);
    CHECK(gsn_hue_edge_of(&edge, point, make(&redder, 200, point), &at, &err) == GSN_E_STAIN);
}

TEST(no_loss_no_line_and_no_cells_are_refused)
{
    static const struct tissue tissue = { .pure = 0.1, .least = 0.02 };
    static const struct gsn_hue_edge before = { .vertex = 7 };
    static struct gsn_hue_edge_point point[CELLS];
    const size_t points = make(&tissue, CELLS, point);
    struct gsn_error err = { 0 };
    struct gsn_hue_edge edge = before;
    double control[3], treated[3];

    mix(&tissue, 0.55, 0.18, 0.01, control);
    mix(&tissue, 0.33, 0.26, 0.08, treated);
    CHECK(gsn_hue_edge_find(point, points, control, control, &edge, &err) == GSN_E_STAIN);
    CHECK(gsn_hue_edge_find(point, 100, control, treated, &edge, &err) == GSN_E_STAIN);
    CHECK(memcmp(&edge, &before, sizeof edge) == 0);
    CHECK(strstr(err.text, "too little tissue") != NULL);
}

static int find_once(struct gsn_error *err)
{
    static const struct tissue tissue = { .pure = 0.1, .least = 0.02 };
    static struct gsn_hue_edge_point point[8000];
    struct gsn_hue_edge edge;
    double control[3], treated[3], at;
    int r;

    mix(&tissue, 0.55, 0.18, 0.01, control);
    mix(&tissue, 0.33, 0.26, 0.08, treated);
    r = gsn_hue_edge_find(point, make(&tissue, 8000, point), control, treated, &edge, err);
    return r < 0 ? r : gsn_hue_edge_of(&edge, point, 8000, &at, err);
}

TEST(running_out_of_memory_leaves_nothing_behind)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(find_once(&err), err);
}

/* ---- cloud ------------------------------------------------------------------------------- */

TEST(a_cloud_counts_hues_and_keeps_the_mean_density_of_each)
{
    static const double od[3] = { 0.2, 0.5, 0.4 }, twice[3] = { 0.4, 1.0, 0.8 },
                        pale[3] = { 0.02, 0.05, 0.04 };
    struct gsn_cloud_panel panel = { .panel = 3 };
    gsn_auto(gsn_cloud_tally) tally = NULL;
    struct gsn_error err = { 0 };
    double middle[3];

    CHECK_OK(gsn_cloud_tally_new(&tally, &err), err);
    gsn_cloud_tally_add(tally, od, 1);
    gsn_cloud_tally_add(tally, twice, 3);
    gsn_cloud_tally_add(tally, pale, 1);
    CHECK_OK(gsn_cloud_tally_take(tally, &panel, &err), err);
    CHECK(panel.bins == 1);
    CHECK_NEAR(panel.bin[0].cells, 4, 0);
    CHECK_NEAR(panel.bin[0].od, (1.1 + 3 * 2.2) / 4, 1e-12);
    gsn_cloud_bin_od(&panel.bin[0], middle);
    for (int c = 0; c < 3; c++)
        CHECK_NEAR(middle[c] / panel.bin[0].od, od[c] / 1.1, GSN_CLOUD_SHARE);
    CHECK_OK(gsn_cloud_tally_take(tally, &panel, &err), err);
    CHECK(panel.bins == 0);
    gsn_free(panel.bin);
}

static int count_once(struct gsn_error *err)
{
    static const double od[3] = { 0.2, 0.5, 0.4 };
    gsn_auto(gsn_cloud_tally) tally = NULL;
    gsn_auto(gsn_cloud) cloud = NULL;
    int r = gsn_cloud_new(2, &cloud, err);

    if (r >= 0)
        r = gsn_cloud_tally_new(&tally, err);
    if (r < 0)
        return r;
    gsn_cloud_tally_add(tally, od, 1);
    return gsn_cloud_tally_take(tally, &cloud->panel[0], err);
}

TEST(counting_out_of_memory_leaves_nothing_behind)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(count_once(&err), err);
}
