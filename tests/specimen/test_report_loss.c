/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What is said of a loss by dye vectors that calibration panels tell, or nobody, from inputs that
 * is stated here. */
#include "pipeline/specimen/process.h"

#include "pipeline/stain/error_propagation.h"
#include "pipeline/stain/hue_distribution.h"
#include "pipeline/stain/stain_vectors.h"
#include "pipeline/stain/unmixing.h"
#include "tests/check.h"
#include "tests/specimen/drawn_specimen.h"

#include <jansson.h>
#include <stdio.h>
#include <string.h>

#define JOB                                                                                        \
    "{\"specimen\": \"treated\", \"baseline\": \"control\", \"dyes\": \"estimate\", "              \
    "" DRAWN_JOB_HEAD ", \"region\": " DRAWN_REGION "}"
#define SET "inferred-2"
#define BY_VECTORS "Standard error of the loss by dye vectors"

enum { MOST_PANELS = 30 };

/* The figures that the interval of a loss is made of, all of them different. */
static const double TREATED = 0.45, CONTROL = 0.75;
static const double BY_STEPS = 0.021, BY_ALL = 0.09, IN_COMMON = 0.05; /* relative, treated */
#define BESIDE_STEPS sqrt(BY_ALL *BY_ALL - BY_STEPS * BY_STEPS)
static const double OF_CONTROL = 0.013, OF_CONTROL_BY_ALL = 0.06; /* of its mean density */
static const double GAIN_SCATTER = 0.02, OFFSET_SCATTER = 0.01;   /* from panel to panel */
static const double OWN = 0.034, SHARED = 0.057, TOGETHER = -0.4; /* by vectors */

struct told {
    struct gsn_protocol *protocol;
    struct gsn_protocol_calibration stated;
    struct gsn_calibration_panel calibration;
    struct gsn_panel_section section;
    struct gsn_specimen_panel given[MOST_PANELS];
    struct gsn_stack_panel panel[MOST_PANELS];
    struct gsn_panel_scale scale[MOST_PANELS];
    struct gsn_specimen_control control; /* that hands no panel on */
    struct gsn_specimen specimen;
    struct gsn_reconstruction stack;
    struct gsn_analysis analysis;
};

/* A tetrahedron, as a report names how many there are. */
static struct gsn_dms *one_tet(void)
{
    static const double corner[4][3] = { { 0, 0, 0 }, { 90, 0, 0 }, { 0, 90, 0 }, { 0, 0, 90 } };
    static const uint32_t tet[1][4] = { { 0, 1, 2, 3 } };
    gsn_auto(gsn_tets) mesh = NULL;
    gsn_auto_mem(double) knots = NULL;
    double(*knot)[3] = NULL;
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tets_new(corner, 4, tet, 1, &mesh, &err), err);
    CHECK_OK(gsn_dms_clouds(mesh, 1, 0.1, &knot, &err), err);
    knots = (double *)knot;
    CHECK_OK(gsn_dms_new(mesh, 1, knot, GSN_DMS_SHARED, &space, &err), err);
    return space;
}

static struct gsn_stack_panel calibrated_panel(const struct gsn_specimen_panel *given,
                                               const struct gsn_calibration_panel *by)
{
    return (
        struct gsn_stack_panel){ .given = given,
                                 .opened = 1,
                                 .calibrated = { .panel = by, .compared = 1 },
                                 .stain = { .panel = given->number,
                                            .fit = { .dyes = { .name = SET,
                                                               .red = { 0.28, 0.96, 0 },
                                                               .yellow = { 0, 0.28, 0.96 },
                                                               .dark = { 0.6, 0.64, 0.48 },
                                                               .full_red_od = 1 },
                                                     .deviation_deg = { 1.5, 2.25, 3.125 } } } };
}

/* Untreated tissue that reads alike in both, so badly known that it tells nothing of their stain:
 * what two specimens' baths scatter by is all that there is to compare them with. */
static void put_tissue(struct told *t)
{
    static const double value[GSN_CONTROL_KINDS] = { 0.88, 0.2, NAN };

    for (int k = 0; k < GSN_CONTROL_KINDS; k++) {
        t->stack.scale.levelling.tissues.value[k] = value[k];
        t->stack.scale.levelling.tissues.covariance[k][k] = 1e8;
    }
    t->specimen.baseline.tissues = t->stack.scale.levelling.tissues;
}

/* Levelled panels with calibrated vectors that leave an own and a shared part open. */
static void told_init(struct told *t, size_t panels)
{
    *t = (struct told){ .protocol = drawn_protocol(JOB), .stated = { .file = "C01.png" } };
    t->calibration.stated = &t->stated;
    t->calibration.has_dyes = 1;
    for (size_t i = 0; i < panels; i++) {
        t->given[i] = (struct gsn_specimen_panel){ .number = (unsigned)i + 1,
                                                   .file = "P.png",
                                                   .sha256 = "0",
                                                   .state = "registered",
                                                   .message = "",
                                                   .section_count = 1,
                                                   .section = &t->section };
        t->panel[i] = calibrated_panel(&t->given[i], &t->calibration);
        t->scale[i] = (struct gsn_panel_scale){ .levelled = 1, .level = { 1, 0 } };
    }
    t->specimen = (struct gsn_specimen){
        .protocol = t->protocol, .panel_count = panels, .panel = t->given, .key = "0123456789abcdef"
    };
    t->stack = (struct gsn_reconstruction){
        .poses = { .solved = 1 },
        .densities = { .panel_count = panels, .panel = t->panel },
        .scale = { .panel_count = panels,
                   .panel = t->scale,
                   .red_error = BY_ALL,
                   .step_error = BY_STEPS,
                   .common_error = IN_COMMON,
                   .levelling = { .done = 1,
                                  .panels = panels,
                                  .fit = { .gain_scatter = GAIN_SCATTER,
                                           .offset_scatter = OFFSET_SCATTER },
                                  .vectors = { 1, OWN * OWN, SHARED * SHARED,
                                               TOGETHER * OWN * SHARED } } }
    };
    t->analysis = (struct gsn_analysis){ .space = one_tet(),
                                         .coverage = 1,
                                         .density = { .mean = TREATED, .volume_um3 = 3e7 } };
    t->specimen.baseline =
        (struct gsn_specimen_baseline){ .name = "control",
                                        .specimens = 1,
                                        .mean_density = CONTROL,
                                        .volume_mm3 = 0.03,
                                        .mean_density_error = OF_CONTROL_BY_ALL,
                                        .own_scale_error = OF_CONTROL,
                                        .control = &t->control,
                                        .definition =
                                            "collagen-equivalent density (red dye by unmixing)",
                                        .dyes = SET };
    put_tissue(t);
}

static void told_done(struct told *t)
{
    gsn_dms_free(t->analysis.space);
    gsn_protocol_free(t->protocol);
}
#define told_auto __attribute__((cleanup(told_done))) struct told

static int summarise_once(const struct told *t, struct gsn_specimen_result **ret,
                          struct gsn_error *err)
{
    const struct gsn_report_inputs inputs = { .specimen = &t->specimen,
                                              .reconstruction = &t->stack,
                                              .analysis = &t->analysis };
    gsn_auto(gsn_specimen_result) result = gsn_alloc_array(1, sizeof *result);
    const int r = result ? gsn_report_build(&inputs, result, err)
                         : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    if (r >= 0 && ret)
        *ret = gsn_steal(&result);
    return r;
}

static struct gsn_specimen_result *summarised(const struct told *t)
{
    struct gsn_specimen_result *result = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(summarise_once(t, &result, &err), err);
    return result;
}

static struct gsn_specimen_measure measure(const struct gsn_specimen_result *result,
                                           const char *name)
{
    for (size_t i = 0; i < result->measure_count; i++)
        if (strcmp(result->measure[i].name, name) == 0)
            return result->measure[i];
    return (struct gsn_specimen_measure){ .value = NAN, .lower = NAN, .upper = NAN };
}

/* gives: the row of this name among the measures or the parameters, or NULL. */
static json_t *row_of(const struct gsn_specimen_result *result, int parameter, const char *name)
{
    json_t *root = json_loadb(result->json, result->json_size, JSON_REJECT_DUPLICATES, NULL);
    const json_t *rows = json_object_get(parameter ? json_object_get(root, "provenance") : root,
                                         parameter ? "parameters" : "measures");
    json_t *found = NULL;

    CHECK(rows != NULL);
    for (size_t i = 0; i < json_array_size(rows) && !found; i++) {
        json_t *row = json_array_get(rows, i);

        if (strcmp(json_string_value(json_object_get(row, "name")), name) == 0)
            found = json_incref(row);
    }
    json_decref(root);
    return found;
}

static int is_nan(double value)
{
    return value != value;
}

/* Per cent that the vectors leave open in the loss, as the report says; NaN: it says nothing. */
static double by_vectors(const struct gsn_specimen_result *result)
{
    json_t *row = row_of(result, 0, BY_VECTORS);
    const double value = row ? json_number_value(json_object_get(row, "value")) : (double)NAN;

    CHECK(!row || strcmp(json_string_value(json_object_get(row, "unit")), "%") == 0);
    CHECK(!row == !strstr(result->html, BY_VECTORS));
    json_decref(row);
    return value;
}

/* ---- what vectors leave open ----------------------------------------------------------------- */

/* A vector that is off adds to both sides alike, in units of the treated density, and something of
 * its own to the treated one. */
static double loss_with(double own, double shared)
{
    return 100 * (1 - TREATED * (1 + own + shared) / (CONTROL + TREATED * shared));
}

TEST(a_loss_is_as_open_as_a_shared_and_an_own_error_of_the_densities_make_it)
{
    const double small = 1e-5;
    const double own = OWN * (loss_with(small, 0) - loss_with(-small, 0)) / (2 * small);
    const double shared = SHARED * (loss_with(0, small) - loss_with(0, -small)) / (2 * small);
    told_auto t;

    told_init(&t, 2);
    gsn_auto(gsn_specimen_result) result = summarised(&t);

    CHECK_NEAR(measure(result, "loss").value, 40, 1e-9);
    CHECK_NEAR(by_vectors(result), sqrt(own * own + 2 * TOGETHER * own * shared + shared * shared),
               1e-5);
}

TEST(what_both_sides_share_wholly_counts_as_they_differ)
{
    static const double ratio[] = { 1, 0.8, 0.4, 1.2 };

    for (int k = 0; k < 4; k++) {
        told_auto t;

        told_init(&t, 2);
        t.analysis.density.mean = ratio[k] * CONTROL;
        t.stack.scale.levelling.vectors =
            (struct gsn_vector_error_left){ 1, 0, SHARED * SHARED, 0 };
        gsn_auto(gsn_specimen_result) result = summarised(&t);

        CHECK_NEAR(by_vectors(result), 100 * ratio[k] * fabs(1 - ratio[k]) * SHARED, 1e-9);
    }
}

/* ---- the interval ---------------------------------------------------------------------------- */

/* Fieller's: the shares at which treated - share * control is just 1.96 of its own errors off. */
static void check_sides(const struct gsn_specimen_result *result, const double mean[2],
                        const double error[2])
{
    const struct gsn_specimen_measure loss = measure(result, "loss");
    const double edge[2] = { 1 - loss.upper / 100, 1 - loss.lower / 100 };

    CHECK(loss.lower < loss.value && loss.value < loss.upper);
    for (int k = 0; k < 2; k++)
        CHECK_NEAR(fabs(mean[0] - edge[k] * mean[1]) / hypot(error[0], edge[k] * error[1]),
                   1.959963985, 1e-7);
}

static void check_interval(const struct gsn_specimen_result *result, double treated,
                           double of_treated, double of_control)
{
    check_sides(result, (double[]){ treated, CONTROL }, (double[]){ of_treated, of_control });
}

/* What two baths may differ by is twice what those of one specimen's panels do. */
static double of_linked_control(void)
{
    return hypot(OF_CONTROL, hypot(2 * GAIN_SCATTER * CONTROL, 2 * OFFSET_SCATTER));
}

TEST(the_interval_holds_the_vectors_beside_what_the_baths_differ_by)
{
    const double own = OWN, shared = (1 - TREATED / CONTROL) * SHARED;
    const double vectors = sqrt(own * own + 2 * TOGETHER * own * shared + shared * shared);
    told_auto t;

    told_init(&t, 4);
    gsn_auto(gsn_specimen_result) result = summarised(&t);

    check_interval(result, TREATED, TREATED * vectors, of_linked_control());
}

TEST(without_a_loss_what_both_sides_share_is_not_in_the_interval)
{
    told_auto t;

    told_init(&t, 2);
    t.analysis.density.mean = CONTROL;
    t.stack.scale.levelling.vectors =
        (struct gsn_vector_error_left){ 1, OWN * OWN, SHARED * SHARED, 0 };
    gsn_auto(gsn_specimen_result) result = summarised(&t);

    CHECK_NEAR(by_vectors(result), 100 * OWN, 1e-9);
    check_interval(result, CONTROL, CONTROL * OWN, of_linked_control());
}

/* The steps are among the errors of vectors that were taken as exact; they are in the link's. */
TEST(nothing_inferred_leaves_no_row_and_the_interval_by_the_rest_of_the_stain)
{
    told_auto t;

    told_init(&t, 2);
    t.stack.scale.levelling.vectors = (struct gsn_vector_error_left){ 0 };
    gsn_auto(gsn_specimen_result) result = summarised(&t);

    CHECK(is_nan(by_vectors(result)));
    check_interval(result, TREATED, TREATED * BESIDE_STEPS, of_linked_control());
}

/* Of both sides; the link of these two stains is 1. */
TEST(what_each_section_errs_by_itself_is_in_the_interval)
{
    told_auto t;

    told_init(&t, 2);
    t.stack.scale.levelling.vectors = (struct gsn_vector_error_left){ 0 };
    t.analysis.section_error = 0.011;
    t.specimen.baseline.section_error = 0.007;
    gsn_auto(gsn_specimen_result) result = summarised(&t);

    check_interval(result, TREATED, hypot(TREATED * BESIDE_STEPS, 0.011),
                   hypot(of_linked_control(), 0.007));
    CHECK_NEAR(measure(result, "section_error").value, 0.011, 1e-12);
    CHECK_NEAR(measure(result, "mean_density_error").value, TREATED * hypot(BY_ALL, IN_COMMON),
               1e-12);
}

/* 1.3 % of a mean density, as two real tiles have it. */
TEST(a_panel_that_went_through_jpeg_widens_the_interval_and_is_told)
{
    const double jpeg = 0.013;
    told_auto t;

    told_init(&t, 2);
    t.stack.scale.levelling.vectors = (struct gsn_vector_error_left){ 0 };
    t.panel[1].lossy = 1;
    gsn_auto(gsn_specimen_result) result = summarised(&t);

    check_interval(result, TREATED, TREATED * hypot(BESIDE_STEPS, jpeg), of_linked_control());
    CHECK_NEAR(measure(result, "mean_density_error").value,
               TREATED * hypot(jpeg, hypot(BY_ALL, IN_COMMON)), 1e-12);
    assert_non_null(strstr(result->html, "let the scanner write PNG or TIFF without JPEG"));
}

/* Vectors that were taken as exact turn as much as the panels of both specimens scatter by, of
 * which there are few: Student's distribution with n degrees of freedom has the variance n / (n -
 * 2). */
TEST(exact_vectors_are_off_by_what_the_panels_of_both_specimens_scatter)
{
    const double turn = sqrt((4 * 0.002 + 6 * 0.004) / 10 * 10 / 8);
    told_auto t;

    told_init(&t, 5);
    t.stack.scale.levelling.vectors = (struct gsn_vector_error_left){ 1, OWN * OWN, 0, 0 };
    t.stack.scale.levelling.turns = (struct gsn_vector_scatter){ 0.002, 4 };
    t.specimen.baseline.turns = (struct gsn_vector_scatter){ 0.004, 6 };
    gsn_auto(gsn_specimen_result) result = summarised(&t);

    CHECK_NEAR(by_vectors(result), 100 * TREATED / CONTROL * OWN * turn, 1e-9);
    check_interval(result, TREATED, TREATED * hypot(BESIDE_STEPS, OWN * turn), of_linked_control());
    CHECK_NEAR(measure(result, "vector_turns").value, 0.002, 0);
    CHECK_NEAR(measure(result, "vector_turns_freedom").value, 4, 0);
}

/* ---- vectors that nobody measured ------------------------------------------------------------ */

/* The bath that coloured everything, each vector some degrees off the table's. */
static const double BATH_TURN[GSN_DYE_ROTATIONS] = { 0.03, -0.02, 0.06, 0.05, -0.05, 0.04 };

static void colour_of(const struct gsn_dyes *bath, const double amount[3], double od[3])
{
    for (int c = 0; c < 3; c++)
        od[c] = amount[0] * bath->red[c] + amount[1] * bath->yellow[c] + amount[2] * bath->dark[c];
}

/* gives: panels of cells with any mixture of yellow and dark; pure: a fifth of them nearly without
 * collagen, else all with at least this much. */
static struct gsn_cloud *cells_of(const struct gsn_dyes *bath, size_t panels, int pure)
{
    struct gsn_cloud *cloud = NULL;
    gsn_auto(gsn_cloud_tally) tally = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_cloud_new(panels, &cloud, &err), err);
    CHECK_OK(gsn_cloud_tally_new(&tally, &err), err);
    for (size_t p = 0; p < panels; p++) {
        cloud->panel[p].panel = (unsigned)p + 1;
        for (int dark = 0; dark < 240; dark++)
            for (int red = 0; red < 200; red++) {
                const double share = dark / 400.0;
                const double more =
                    pure ? (red < 40 ? 0.02 : (red - 36) / 160.0) : 0.2 + red / 200.0;
                double od[3];

                colour_of(bath, (double[]){ more, 0.4 * (1 - share), 0.4 * share }, od);
                gsn_cloud_tally_add(tally, od, 10);
            }
        CHECK_OK(gsn_cloud_tally_take(tally, &cloud->panel[p], &err), err);
    }
    return cloud;
}

/* Red as a table sees it, in shares of what counts as full. */
static double seen_density(const struct gsn_dyes *table, const double od[3])
{
    struct gsn_unmixer mix;
    struct gsn_error err = { 0 };
    double red = 0;

    CHECK_OK(gsn_unmixer_init(&mix, table, &err), err);
    for (int k = 0; k < 3; k++)
        for (int c = 0; c < 3; c++)
            red += mix.inverse[7][0][k] * mix.dye[k][c] * od[c];
    return red / table->full_red_od;
}

struct narrowed {
    struct told told;
    struct gsn_specimen_control control;
};

static void narrowed_done(struct narrowed *n)
{
    gsn_cloud_free(n->told.stack.scale.cloud);
    gsn_cloud_free(n->control.cloud);
    told_done(&n->told);
}
#define narrowed_auto __attribute__((cleanup(narrowed_done))) struct narrowed

/* Of the control's collagen this much is left, nuclei and yellow come in its place; the table is
 * the built-in one, and the bath is it or another. */
static void narrowed_init(struct narrowed *n, double left, int turned, size_t panels, int pure)
{
    const struct gsn_dyes table = gsn_dyes_builtin();
    const struct gsn_dyes bath = turned ? gsn_dyes_rotated(&table, BATH_TURN) : table;
    struct told *t = &n->told;

    told_init(t, panels);
    for (size_t i = 0; i < panels; i++) {
        t->panel[i].calibrated = (struct gsn_calibrated){ .panel = NULL };
        t->panel[i].stain.fit = (struct gsn_dyes_fit){ .dyes = table };
    }
    t->specimen.baseline.dyes = t->panel[0].stain.fit.dyes.name;
    t->specimen.baseline.own_scale_error = 1e-4;
    t->stack.scale.red_error = t->stack.scale.step_error = t->stack.scale.common_error = 0;
    t->stack.scale.levelling.vectors.known = 0;
    t->stack.scale.levelling.fit.gain_scatter = t->stack.scale.levelling.fit.offset_scatter = 1e-4;
    t->stack.scale.cloud = cells_of(&bath, panels, pure);
    n->control = (struct gsn_specimen_control){ .yellow = { NAN, NAN, NAN },
                                                .free_od = { NAN, NAN, NAN },
                                                .cloud = cells_of(&bath, panels, pure) };
    colour_of(&bath, (double[]){ 0.52, 0.18, 0.01 }, n->control.region_od);
    colour_of(&bath, (double[]){ 0.52 * left, 0.18 + 0.14 * (1 - left), 0.01 + 0.14 * (1 - left) },
              t->stack.scale.region_od);
    t->specimen.baseline.control = &n->control;
    t->specimen.baseline.mean_density = seen_density(&table, n->control.region_od);
    t->analysis.density.mean = seen_density(&table, t->stack.scale.region_od);
}

TEST(a_loss_is_the_same_whatever_bath_the_table_of_vectors_is_off_by)
{
    narrowed_auto same, other;

    narrowed_init(&same, 0.6, 0, 3, 1);
    narrowed_init(&other, 0.6, 1, 3, 1);
    gsn_auto(gsn_specimen_result) by_table = summarised(&same.told);
    gsn_auto(gsn_specimen_result) by_bath = summarised(&other.told);
    const struct gsn_specimen_measure a = measure(by_table, "loss"), b = measure(by_bath, "loss");
    const double apparent =
        100 * (1 - other.told.analysis.density.mean / other.told.specimen.baseline.mean_density);

    CHECK(fabs(apparent - 40) > 4); /* what the table says */
    CHECK_NEAR(b.value, a.value, 0.6);
    CHECK(a.lower < 40 && 40 < a.upper && b.lower < 40 && 40 < b.upper);
    CHECK(b.upper - b.lower > 5 && b.upper - b.lower < 12);
    CHECK(by_vectors(by_bath) > 1);
    assert_non_null(strstr(by_bath->html, "95 %, stain, white, dye vectors and sections"));
}

/* Colours of a JPEG run over, so that tissue without collagen shows some. */
TEST(a_jpeg_on_either_side_leaves_the_loss_more_open)
{
    for (int side = 0; side < 2; side++) {
        narrowed_auto sharp, lossy;

        narrowed_init(&sharp, 0.6, 1, 3, 1);
        narrowed_init(&lossy, 0.6, 1, 3, 1);
        (side ? lossy.control.cloud : lossy.told.stack.scale.cloud)->panel[1].lossy = 1;
        gsn_auto(gsn_specimen_result) a = summarised(&sharp.told);
        gsn_auto(gsn_specimen_result) b = summarised(&lossy.told);
        const struct gsn_specimen_measure narrow = measure(a, "loss"), wide = measure(b, "loss");

        CHECK_NEAR(wide.value, narrow.value, 0.5);
        CHECK(wide.upper - wide.lower > 1.2 * (narrow.upper - narrow.lower));
    }
}

/* One panel of a side was in another bath, and with it a third of that side's region. */
static void set_panel_apart(struct narrowed *n, int of_control, double left, double turn)
{
    const double more[GSN_DYE_ROTATIONS] = { turn, -turn, turn, turn, -turn, turn };
    const struct gsn_dyes table = gsn_dyes_builtin();
    const struct gsn_dyes bath = gsn_dyes_rotated(&table, BATH_TURN);
    const struct gsn_dyes apart = gsn_dyes_rotated(&bath, more);
    struct gsn_cloud *cloud = of_control ? n->control.cloud : n->told.stack.scale.cloud;
    double *region = of_control ? n->control.region_od : n->told.stack.scale.region_od;
    const double amount[3] = { 0.52 * left, 0.18 + 0.14 * (1 - left), 0.01 + 0.14 * (1 - left) };
    struct gsn_cloud *other = cells_of(&apart, cloud->panels, 1);
    const struct gsn_cloud_panel kept = cloud->panel[1];
    double here[3], there[3];

    cloud->panel[1] = other->panel[1];
    other->panel[1] = kept;
    gsn_cloud_free(other);
    colour_of(&bath, amount, here);
    colour_of(&apart, amount, there);
    for (int c = 0; c < 3; c++)
        region[c] += (there[c] - here[c]) / (double)cloud->panels;
    *(of_control ? &n->told.specimen.baseline.mean_density : &n->told.analysis.density.mean) =
        seen_density(&table, region);
}

/* The edge that counts is that of the panels the treated region was seen in; what panels scatter by
 * is in the interval, whichever side shows it. */
TEST(panels_of_another_bath_leave_the_loss_more_open_and_still_right)
{
    for (int of_control = 0; of_control < 2; of_control++) {
        narrowed_auto alike, apart;

        narrowed_init(&alike, 0.6, 1, 3, 1);
        narrowed_init(&apart, 0.6, 1, 3, 1);
        set_panel_apart(&apart, of_control, of_control ? 1 : 0.6, 0.03);
        gsn_auto(gsn_specimen_result) a = summarised(&alike.told);
        gsn_auto(gsn_specimen_result) b = summarised(&apart.told);
        const struct gsn_specimen_measure narrow = measure(a, "loss"), wide = measure(b, "loss");

        CHECK(wide.lower < 40 && 40 < wide.upper);
        CHECK(wide.upper - wide.lower > 1.05 * (narrow.upper - narrow.lower));
        if (!of_control)
            CHECK_NEAR(wide.value, 40, 2);
    }
}

TEST(no_loss_stays_none_in_any_bath_and_is_known_well)
{
    narrowed_auto n;

    narrowed_init(&n, 1, 1, 3, 1);
    gsn_auto(gsn_specimen_result) result = summarised(&n.told);
    const struct gsn_specimen_measure loss = measure(result, "loss");

    CHECK_NEAR(loss.value, 0, 0.1);
    CHECK(loss.lower < 0 && 0 < loss.upper && loss.upper - loss.lower < 1);
}

/* Stated on either side: the interval is narrower, and no edge need be sharp. */
TEST(tissue_that_is_stated_to_hold_no_collagen_replaces_the_guess)
{
    for (int pure = 0; pure < 2; pure++) {
        const struct gsn_dyes table = gsn_dyes_builtin();
        const struct gsn_dyes bath = gsn_dyes_rotated(&table, BATH_TURN);
        narrowed_auto n;

        narrowed_init(&n, 0.6, 1, 3, pure);
        colour_of(&bath, (double[]){ 0.005, 0.27, 0.12 },
                  pure ? n.told.stack.scale.free_od : n.control.free_od);
        gsn_auto(gsn_specimen_result) result = summarised(&n.told);
        const struct gsn_specimen_measure loss = measure(result, "loss");

        CHECK(!result->withheld && loss.lower < 40 && 40 < loss.upper);
        CHECK(loss.upper - loss.lower <
              (pure ? 7 : 12)); /* a blunt edge has a slope hard to tell */
    }
}

/* A shape on the wrong tissue: cells beside it hold less. */
TEST(tissue_that_is_stated_to_hold_none_and_is_red_is_not_taken_for_it)
{
    const struct gsn_dyes table = gsn_dyes_builtin();
    const struct gsn_dyes bath = gsn_dyes_rotated(&table, BATH_TURN);
    narrowed_auto n;

    narrowed_init(&n, 0.6, 1, 3, 1);
    colour_of(&bath, (double[]){ 0.12, 0.27, 0.12 }, n.told.stack.scale.free_od);
    gsn_auto(gsn_specimen_result) result = summarised(&n.told);

    CHECK(result->withheld && is_nan(measure(result, "loss").value));
    assert_non_null(strstr(result->message, "\"collagen_free\" states holds collagen"));
}

TEST(without_tissue_poor_in_collagen_the_loss_is_at_most_something_and_withheld)
{
    narrowed_auto n;

    narrowed_init(&n, 0.6, 1, 3, 0);
    gsn_auto(gsn_specimen_result) result = summarised(&n.told);

    CHECK(result->withheld && is_nan(measure(result, "loss").value));
    assert_non_null(strstr(result->message, "so that the loss is at most 6"));
    assert_non_null(strstr(result->message, "a calibration panel would narrow this"));
    CHECK(!is_nan(measure(result, "mean_density").value)); /* that stays */
}

TEST(colours_of_one_panel_or_of_none_narrow_nothing)
{
    narrowed_auto one, none;

    narrowed_init(&one, 0.6, 1, 1, 1);
    narrowed_init(&none, 0.6, 1, 3, 1);
    gsn_cloud_free(none.told.stack.scale.cloud);
    gsn_cloud_free(none.control.cloud);
    none.told.stack.scale.cloud = none.control.cloud = NULL;
    gsn_auto(gsn_specimen_result) alone = summarised(&one.told);
    gsn_auto(gsn_specimen_result) blind = summarised(&none.told);

    CHECK(alone->withheld && blind->withheld);
    assert_non_null(strstr(alone->message, "fewer than 2 panels of each specimen show tissue"));
    assert_non_null(strstr(blind->message, "a calibration panel would narrow this"));
}

TEST(no_colour_goes_missing_for_want_of_memory)
{
    struct gsn_error err = { 0 };
    narrowed_auto n;

    narrowed_init(&n, 0.6, 1, 2, 1);
    /* So few cells that no time is lost on them; what the edge needs is tested beside it. */
    for (size_t p = 0; p < 2; p++)
        n.told.stack.scale.cloud->panel[p].bins = n.control.cloud->panel[p].bins = 1;
    CHECK_EVERY_OOM(summarise_once(&n.told, NULL, &err), err);
}

TEST(without_untreated_tissue_of_the_control_both_sides_count_in_full)
{
    told_auto t;

    told_init(&t, 2);
    for (int k = 0; k < GSN_CONTROL_KINDS; k++)
        t.specimen.baseline.tissues.value[k] = (double)NAN;
    gsn_auto(gsn_specimen_result) result = summarised(&t);

    CHECK(is_nan(by_vectors(result)));
    check_interval(result, TREATED, TREATED * hypot(BY_ALL, IN_COMMON), OF_CONTROL_BY_ALL);
    assert_null(strstr(result->html, "volumes above a density are withheld"));
}

/* Nobody measured the dyes: untreated tissue brings volumes to the baseline's scale, or nothing
 * does. */
TEST(volumes_that_nothing_brings_to_the_baselines_scale_are_withheld)
{
    narrowed_auto linked, alone;

    narrowed_init(&linked, 0.6, 1, 3, 1);
    narrowed_init(&alone, 0.6, 1, 3, 1);
    for (int k = 0; k < GSN_CONTROL_KINDS; k++)
        alone.told.specimen.baseline.tissues.value[k] = (double)NAN;
    gsn_auto(gsn_specimen_result) on_its_scale = summarised(&linked.told);
    gsn_auto(gsn_specimen_result) on_none = summarised(&alone.told);

    assert_null(strstr(on_its_scale->html, "volumes above a density are withheld"));
    assert_non_null(strstr(on_none->html, "volumes above a density are withheld"));
}

TEST(what_is_handed_on_of_a_control_is_its_own_part)
{
    told_auto t;

    told_init(&t, 2);
    gsn_auto(gsn_specimen_result) inferred = summarised(&t);

    CHECK_NEAR(measure(inferred, "own_scale_error").value, TREATED * OWN, 1e-12);
    CHECK_NEAR(measure(inferred, "mean_density_error").value, TREATED * hypot(BY_ALL, IN_COMMON),
               1e-12);
    t.stack.scale.levelling.vectors.known = 0;
    gsn_auto(gsn_specimen_result) stated = summarised(&t);

    CHECK_NEAR(measure(stated, "own_scale_error").value, TREATED * BESIDE_STEPS, 1e-12);
}

/* ---- what is read ---------------------------------------------------------------------------- */

/* gives: the vectors of a panel as the report tells them, NULL where it does not. */
static char *vectors_of(const struct gsn_specimen_result *result, unsigned panel)
{
    char name[40];
    char *text = NULL;
    json_t *row;

    (void)snprintf(name, sizeof name, "dye vectors of panel %u", panel);
    row = row_of(result, 1, name);
    if (row) {
        text = gsn_format("%s", json_string_value(json_object_get(row, "value")));
        CHECK(text && strstr(text, "red (") && strstr(result->html, name) &&
              strstr(result->html, strstr(text, "red (")));
    }
    json_decref(row);
    return text;
}

TEST(inferred_vectors_are_named_with_where_they_come_from_and_how_well_they_are_known)
{
    told_auto t;

    told_init(&t, 2);
    t.panel[0].calibrated.panel = t.panel[1].calibrated.panel = NULL;
    gsn_auto(gsn_specimen_result) result = summarised(&t);

    for (unsigned panel = 1; panel <= 2; panel++) {
        gsn_auto_mem(char) text = vectors_of(result, panel);

        CHECK(text != NULL);
        assert_string_equal(text, "from the slide's own tissue: red (0.2800 0.9600 0.0000) +- 1.50 "
                                  "deg, yellow (0.0000 0.2800 0.9600) +- 2.25 deg, dark (0.6000 "
                                  "0.6400 0.4800) +- 3.12 deg");
    }
    CHECK(vectors_of(result, 3) == NULL);
}

TEST(vectors_that_are_taken_as_exact_and_panels_that_were_not_opened_are_not_told)
{
    told_auto t;

    told_init(&t, 3);
    memset(t.panel[0].stain.fit.deviation_deg, 0, sizeof t.panel[0].stain.fit.deviation_deg);
    t.panel[1].opened = 0;
    gsn_auto(gsn_specimen_result) result = summarised(&t);
    gsn_auto_mem(char) third = vectors_of(result, 3);

    CHECK(vectors_of(result, 1) == NULL && vectors_of(result, 2) == NULL && third != NULL);
}

TEST(of_many_panels_the_first_two_dozen_are_told_and_how_many_more_there_are)
{
    static const char *const further = "dye vectors of further panels";
    told_auto t;

    told_init(&t, MOST_PANELS);
    gsn_auto(gsn_specimen_result) result = summarised(&t);
    gsn_auto_mem(char) last = vectors_of(result, 24);

    CHECK(last != NULL && vectors_of(result, 25) == NULL);
    json_t *more = row_of(result, 1, further);

    CHECK(more != NULL && strstr(result->html, further));
    assert_string_equal(json_string_value(json_object_get(more, "value")),
                        "6 more panels have their own");
    json_decref(more);
    t.stack.densities.panel_count = 24;
    gsn_auto(gsn_specimen_result) all = summarised(&t);

    CHECK(row_of(all, 1, further) == NULL);
}

TEST(a_control_of_other_vectors_gives_no_loss_and_no_error_of_one)
{
    told_auto t;

    told_init(&t, 2);
    t.specimen.baseline.dyes = "van-gieson-1";
    gsn_auto(gsn_specimen_result) result = summarised(&t);

    CHECK(result->withheld);
    assert_string_equal(result->message, "the dye vectors differ: control has van-gieson-1, "
                                         "treated has inferred-2");
    CHECK(is_nan(measure(result, "loss").value));
    CHECK(is_nan(by_vectors(result)));
}

/* ---- what is not known of either side -------------------------------------------------------- */

TEST(a_baseline_of_which_too_little_is_known_gives_no_loss)
{
    static const struct {
        double unknown, unmeasured;
        const char *says;
    } cases[] = {
        { 0.09, 0.29, "" },
        { 0.11, 0.29,
          "of the baseline control only 71 % of the region of interest has data: settle what its "
          "report says, then run again" },
        { 0.09, 0.31,
          "of the baseline control only 69 % of the region of interest was measured; the rest "
          "could only be bridged from the sections beside it: settle what its report says, then "
          "run again" },
    };

    for (int k = 0; k < 3; k++) {
        told_auto t;

        told_init(&t, 2);
        t.specimen.baseline.unknown = cases[k].unknown;
        t.specimen.baseline.unmeasured = cases[k].unmeasured;
        gsn_auto(gsn_specimen_result) result = summarised(&t);

        CHECK(result->withheld == (k > 0) && is_nan(measure(result, "loss").value) == (k > 0));
        if (k > 0)
            assert_string_equal(result->message, cases[k].says);
    }
}

TEST(where_too_little_is_known_of_either_side_both_are_named)
{
    told_auto t;

    told_init(&t, 2);
    t.analysis.coverage = 0.8;
    t.specimen.baseline.unknown = t.specimen.baseline.unmeasured = 0.2;
    gsn_auto(gsn_specimen_result) result = summarised(&t);

    CHECK(result->withheld);
    assert_string_equal(result->message, "only 80 % of the region of interest has data");
    CHECK(strstr(result->html, "of the baseline control only 80 % of the region of interest has "
                               "data") != NULL);
}

TEST(a_specimen_that_is_its_own_says_when_it_is_no_baseline_for_others)
{
    static const char *const says =
        "no loss can be given against this specimen: only 80 % of the region of interest has data";

    for (int k = 0; k < 2; k++) {
        told_auto t;

        told_init(&t, 2);
        t.specimen.baseline = (struct gsn_specimen_baseline){ .name = "" };
        t.analysis.coverage = k ? 0.8 : 0.95;
        gsn_auto(gsn_specimen_result) result = summarised(&t);

        CHECK(!result->withheld && !strstr(result->html, says) == !k);
        CHECK_NEAR(measure(result, "known").value, t.analysis.coverage, 0);
    }
}

TEST(no_text_of_the_vectors_goes_missing_for_want_of_memory)
{
    struct gsn_error err = { 0 };
    told_auto t;

    told_init(&t, 2);
    CHECK_EVERY_OOM(summarise_once(&t, NULL, &err), err);
}

TEST(warnings_stand_by_what_they_cost_and_alike_ones_as_they_came)
{
    static const struct {
        double points;
        size_t sections;
        const char *said;
    } came[] = { { 0, 0, "7" },        { 0, 3, "5" }, { 0.5, 0, "3" }, { 0, 12, "4" },
                 { INFINITY, 0, "0" }, { 0, 0, "8" }, { 2.5, 1, "2" }, { INFINITY, 0, "1" },
                 { 0, 3, "6" },        { 0, 0, "9" } };
    const char *warning[10];
    struct gsn_builder_cost cost[10];
    struct gsn_builder draft = { .warning = warning, .cost = cost };

    for (size_t i = 0; i < 10; i++)
        if (came[i].points > 0 || came[i].sections > 0)
            gsn_builder_warn_cost(&draft,
                                  (struct gsn_builder_cost){ came[i].points, came[i].sections },
                                  came[i].said);
        else
            gsn_builder_warn(&draft, came[i].said);
    CHECK(draft.warning_count == 10);
    for (size_t i = 0; i < 10; i++)
        CHECK(warning[i][0] == (char)('0' + i));
}
