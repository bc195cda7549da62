/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The loss against the baseline, or why there is none.
 *
 * It is withheld where too little of either region is known, where the baseline has no figure,
 * where batches cannot be compared, and where it is left open by more than MOST_WIDTH points. Where
 * the dye vectors of all panels were measured it is the ratio of two means (measure/loss.h).
 * Otherwise it is narrowed by what both specimens' tissue looks like:
 *
 * Red that a table of vectors sees is red and what yellow and dark dye leak into it, so a table
 * that is a few degrees off is wrong by several points, in every panel alike. Of the treated region
 * take away so much of the control's that no collagen is left: the colours of all cells of both
 * blocks, pooled, say how much (stain/hue_distribution.h), and no table enters. That is the largest
 * loss that can be. What the purest cells hold of collagen is then taken off: half-normal, PUREST
 * of the control's tissue over what remains, which is 0.10 of red over yellow and dark, what
 * anatomies of the study's four kinds showed at their 2 % quantile (0.01 to 0.10). Where the
 * foremost cells have no common hue no tissue is poor in collagen, and only the upper bound is
 * known.
 *
 *     1. the control's colours as this specimen's bath would show them: red by the link of
 *        untreated tissue (stain/normalisation.h), yellow by the yellow of the same tissue
 *     2. edge of the pooled cells, and where each panel has its own: that of this specimen's panels
 *        counts, and what panels scatter by is the error
 *     3. distribution of the loss: edge less purity, and around it what the stain leaves open
 *        (tissue that job.json states to hold no collagen replaces the guess: its hue, carried
 *        along the edge to the mixture that remains, less what a density up to FREE_MOST makes)
 *     4. where no edge is seen: what vectors leave open that are as far off as baths are, which is
 *        little where hardly anything is lost, or nothing but red is there
 */
#include "pipeline/specimen/report_builder.h"

#include "pipeline/core/distributions.h"
#include "pipeline/core/mem.h"
#include "pipeline/measure/stats.h"
#include "pipeline/stain/hue_distribution.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/stain_vectors.h"
#include "pipeline/stain/unmixing.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static const double PUREST = 0.13;

/* The density that tissue which is stated to hold none has at most, in 95 of 100 cases: what
 * muscle, red cells and marrow are taken to have. */
static const double FREE_MOST = 0.05;

/* Of the edge's slope, as the cells tell it: a third of what vectors 5 degrees off leave open. */
static const double SLOPE_ERROR = 0.3;

/* Of the edge itself, in the same unit, beside what panels scatter by: 0.8 points of a loss of 40,
 * which the study's middle values scattered by at a turn of 5 degrees without scatter. */
static const double EDGE_ERROR = 0.03;

/* The same where a panel of either side went through JPEG, whose colours run over from tissue to
 * tissue: 2.7 points there, at quality 85. */
static const double EDGE_ERROR_LOSSY = 0.10;

/* Foremost cells that are spread wider are no tissue without collagen: as wide is the vertex of a
 * section stained for collagen (picrosirius, psr_left of liverquant), 0.060 of red over yellow, and
 * the control's tissue is 1.3 of its red. Of haematoxylin and eosin it is 0.134. */
static const double WIDEST_VERTEX = 0.078;

/* Points that an interval is at most wide: more is no answer. */
static const double MOST_WIDTH = 25;

/* A loss nearer to 0 leaves too little to see the colour of; what a bath as far off as any makes of
 * it is small then. */
static const double LEAST_LOST = 0.08;

/* How far a bath's dyes lie from any table, either way: five degrees, and the dark one in a quarter
 * of all cases 20, for it may be another counterstain. No measured vectors of Van Gieson were
 * published, so every table is an estimate. */
static const double YELLOW_DEG = 5, DARK_DEG = 10.9;

/* An edge that one panel alone shows may be a fault of that panel. */
enum { LEAST_PANELS = 2 };

/* Colours on this specimen's scale. */
struct side {
    double od[3];                /* of the region */
    size_t panels;               /* that show colours */
    double gain, offset, yellow; /* that a control's were brought over by */
};

/* All cells, panel after panel. */
struct pool {
    struct gsn_hue_edge_point *point; /* owned */
    size_t points, panels;
    size_t *first; /* owned; of each panel, and the end */
    size_t own;    /* panels that are this specimen's, first */
    int lossy;     /* whether any of them went through JPEG */
};

static void pool_done(struct pool *pool)
{
    gsn_free(pool->point);
    gsn_free(pool->first);
}

/* Amounts of red, yellow and dark, negative ones as well. */
static void amounts_of(const struct gsn_unmixer *mix, const double od[3], double ret[3])
{
    double along[3] = { 0 };

    for (int k = 0; k < 3; k++)
        for (int c = 0; c < 3; c++)
            along[k] += mix->dye[k][c] * od[c];
    for (int k = 0; k < 3; k++) {
        ret[k] = 0;
        for (int m = 0; m < 3; m++)
            ret[k] += mix->inverse[7][k][m] * along[m];
    }
}

/* A control's colour as this specimen's bath would show it. */
static void bring_over(const struct gsn_unmixer *mix, const struct gsn_dyes *dyes,
                       const struct side *side, double od[3])
{
    double amount[3], red, yellow;

    amounts_of(mix, od, amount);
    red = (side->gain - 1) * amount[0] + side->offset * dyes->full_red_od;
    yellow = (side->yellow - 1) * amount[1];
    for (int c = 0; c < 3; c++)
        od[c] += red * dyes->red[c] + yellow * dyes->yellow[c];
}

/* The yellow of tissue that both have, here over there; 1: none is. */
static double yellow_against(const double here[GSN_CONTROL_TISSUES],
                             const double there[GSN_CONTROL_TISSUES])
{
    double sum[2] = { 0 };

    for (int t = 0; t < GSN_CONTROL_TISSUES; t++)
        if (!isnan(here[t]) && !isnan(there[t])) {
            sum[0] += here[t];
            sum[1] += there[t];
        }
    return sum[0] > 0 && sum[1] > 0 ? sum[0] / sum[1] : 1;
}

static size_t bins_of(const struct gsn_cloud *cloud)
{
    size_t bins = 0;

    for (size_t p = 0; cloud && p < cloud->panels; p++)
        bins += cloud->panel[p].bins;
    return bins;
}

/* side: NULL for this specimen's own. */
static void add_cloud(const struct gsn_cloud *cloud, const struct gsn_unmixer *mix,
                      const struct gsn_dyes *dyes, const struct side *side, struct pool *pool)
{
    for (size_t p = 0; cloud && p < cloud->panels; p++) {
        const struct gsn_cloud_panel *panel = &cloud->panel[p];

        if (panel->bins == 0)
            continue;
        for (size_t i = 0; i < panel->bins; i++) {
            struct gsn_hue_edge_point *point = &pool->point[pool->points];
            double od[3], all;

            gsn_cloud_bin_od(&panel->bin[i], od);
            if (side)
                bring_over(mix, dyes, side, od);
            all = od[0] + od[1] + od[2];
            if (!(all > 0))
                continue;
            point->cells = panel->bin[i].cells;
            for (int c = 0; c < 3; c++) {
                point->hue[c] = od[c] / all;
                point->variance[c] = panel->noise * pow(10, 2 * od[c]) / (all * all) +
                                     GSN_CLOUD_SHARE * GSN_CLOUD_SHARE / 12;
            }
            pool->points++;
        }
        pool->first[++pool->panels] = pool->points;
        pool->lossy |= panel->lossy;
    }
}

static int pool_init(const struct gsn_report_inputs *e, struct pool *pool)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    const struct gsn_cloud *own = e->reconstruction->scale.cloud;
    size_t bins = bins_of(own), panels = own ? own->panels : 0;

    for (size_t i = 0; i < b->specimens; i++) {
        bins += bins_of(b->control[i].cloud);
        panels += b->control[i].cloud ? b->control[i].cloud->panels : 0;
    }
    *pool = (struct pool){ .point = gsn_alloc_array(bins + 1, sizeof *pool->point),
                           .first = gsn_alloc_array(panels + 1, sizeof *pool->first) };
    return pool->point && pool->first;
}

/* Both sides' colours, and the loss by the table alone. */
struct sides {
    double here[3], there[3];
    double free[3];     /* of tissue that is stated to hold no collagen, in R + G + B of it */
    double free_all;    /* R + G + B of it, summed over the specimens */
    int stated;         /* of how many specimens; 0: of none */
    double free_panels; /* that it lies in, of all of them */
    double apparent;    /* treated over control */
    double density;     /* of the control */
    double deviation;   /* of the loss by all but the vectors, per cent */
};

/* panels: that it lies in; 0: an older run did not count them, and one is the least. */
static void add_free(const double od[3], double panels, struct sides *sides)
{
    const double all = od[0] + od[1] + od[2];

    if (!(all > GSN_CLOUD_LEAST_OD)) /* NaN too: none is stated */
        return;
    for (int c = 0; c < 3; c++)
        sides->free[c] += od[c] / all;
    sides->free_all += all;
    sides->free_panels += fmax(1, panels);
    sides->stated++;
}

/* The mean of all controls' regions, in this specimen's bath; each control's cells are pooled. */
static void add_controls(const struct gsn_report_inputs *e, const struct gsn_builder *d,
                         const struct gsn_unmixer *mix, const struct gsn_dyes *dyes,
                         struct pool *pool, struct side *ret_control, struct sides *sides)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    const size_t before = pool->panels;

    *ret_control = (struct side){ .panels = 0 };
    for (size_t i = 0; i < b->specimens; i++) {
        const struct gsn_specimen_control *control = &b->control[i];
        struct side side = { .gain = d->linked ? d->link.gain : 1,
                             .offset = d->linked ? d->link.offset : 0,
                             .yellow = yellow_against(e->reconstruction->scale.levelling.yellow,
                                                      control->yellow) };
        double od[3];

        for (int c = 0; c < 3; c++)
            od[c] = control->region_od[c];
        bring_over(mix, dyes, &side, od);
        for (int c = 0; c < 3; c++)
            ret_control->od[c] += od[c] / (double)b->specimens;
        add_cloud(control->cloud, mix, dyes, &side, pool);
        for (int c = 0; c < 3; c++)
            od[c] = control->free_od[c];
        bring_over(mix, dyes, &side, od);
        add_free(od, control->free_panels, sides);
    }
    ret_control->panels = pool->panels - before;
}

/* The colour with this density of red, and the rest as it is. */
static void set_density(const struct gsn_unmixer *mix, const struct gsn_dyes *dyes, double density,
                        double od[3])
{
    double amount[3];

    amounts_of(mix, od, amount);
    for (int c = 0; c < 3; c++)
        od[c] += (density * dyes->full_red_od - amount[0]) * dyes->red[c];
}

/* ---- distribution ------------------------------------------------------------------------ */

/* Of a loss, per cent: the most it can be, less what the purest cells hold. */
struct spread {
    double most, per_purest; /* per unit of purity */
    double purest;           /* deviation of the half-normal purity */
    double deviation;        /* by all else */
};

static double normal_below(double t)
{
    return 0.5 * erfc(-t * M_SQRT1_2);
}

/* How probable it is that the loss is less; by the middle rule over the half-normal purity. */
static double probability_below(const struct spread *s, double loss)
{
    enum { STEPS = 400 };
    double sum = 0, all = 0;

    for (int i = 0; i < STEPS; i++) {
        const double purest = 4 * (i + 0.5) / STEPS, weight = exp(-0.5 * purest * purest);

        all += weight;
        sum += weight *
               normal_below((loss - (s->most - s->per_purest * s->purest * purest)) / s->deviation);
    }
    return sum / all;
}

static double spread_quantile(const struct spread *s, double share)
{
    const double reach = 10 * (s->deviation + fabs(s->per_purest));
    double low = s->most - reach, high = s->most + reach;

    for (int i = 0; i < 60; i++) {
        const double middle = (low + high) / 2;

        if (probability_below(s, middle) < share)
            low = middle;
        else
            high = middle;
    }
    return (low + high) / 2;
}

/* ---- loss -------------------------------------------------------------------------------- */

/* The edge panel by panel. A panel whose bath or light lies apart has its edge apart, and all of
 * its tissue with it: so the edge that counts is that of the panels which the treated region was
 * seen in. (The control's tissue lies on the axis from collagen, where the edge has no say.) */
struct panel_edges {
    double mean;      /* of this specimen's panels */
    double scatter;   /* from panel to panel within a specimen, so wide that 1.96 of it hold 95 %
                         though it is known from few */
    size_t panels[2]; /* this specimen's that show an edge, and the controls' */
};

static int judge_panels(const struct gsn_hue_edge *edge, const struct pool *pool,
                        struct panel_edges *ret_edges, struct gsn_error *err)
{
    double sum[2] = { 0 }, square[2] = { 0 }, apart = 0, freedom;
    struct panel_edges edges = { 0 };

    for (size_t p = 0; p < pool->panels; p++) {
        const int side = p >= pool->own;
        double at;
        const int r = gsn_hue_edge_of(edge, pool->point + pool->first[p],
                                      pool->first[p + 1] - pool->first[p], &at, NULL);

        if (r == GSN_E_NOMEM)
            return gsn_fail(err, r, "out of memory for the colours of two specimens");
        if (r < 0)
            continue;
        edges.panels[side]++;
        sum[side] += at;
        square[side] += at * at;
    }
    freedom = (double)(edges.panels[0] + edges.panels[1]) - 2;
    for (int side = 0; side < 2; side++)
        if (edges.panels[side] > 0)
            apart += square[side] - sum[side] * sum[side] / (double)edges.panels[side];
    if (edges.panels[0] > 0)
        edges.mean = sum[0] / (double)edges.panels[0];
    if (freedom > 0)
        edges.scatter =
            sqrt(fmax(0, apart) / freedom) * gsn_student_quantile(0.975, freedom) / 1.96;
    *ret_edges = edges;
    return GSN_OK;
}

/* What vectors that are as far off as baths are leave open, per cent: red that they see is red and
 * what yellow and dark dye leak into it, a radian by 1 over the sine that red makes with their
 * plane. */
static double prior_error(const struct gsn_unmixer *mix, const struct sides *sides)
{
    double here[3], there[3];

    amounts_of(mix, sides->here, here);
    amounts_of(mix, sides->there, there);
    return 100 * sqrt(mix->inverse[7][0][0]) / there[0] * M_PI / 180 *
           hypot(YELLOW_DEG * (here[1] - sides->apparent * there[1]),
                 DARK_DEG * (here[2] - sides->apparent * there[2]));
}

/* What tissue that is stated to hold no collagen shows, in the control's tissue over what remains.
 */
struct free_tissue {
    double at;          /* over the edge */
    double slope_error; /* by the slope that it is carried along the edge with */
    double purest;      /* deviation of the half-normal collagen that it holds all the same */
};

static struct free_tissue look_at_free(const struct gsn_hue_edge *edge, const struct sides *sides)
{
    const double all = sides->free_all / sides->stated;
    const double control = sides->there[0] + sides->there[1] + sides->there[2];
    double part[3] = { 0 };

    for (int k = 0; k < 3; k++)
        for (int c = 0; c < 3; c++)
            part[k] += edge->frame[k][c] * sides->free[c];
    return (struct free_tissue){ part[0] / part[1], SLOPE_ERROR * fabs(part[2] / part[1]),
                                 FREE_MOST / 1.96 / sides->density * control / all };
}

static const char *note_contradiction(struct gsn_builder *d, const struct free_tissue *tissue,
                                      double edge)
{
    const char *why = gsn_builder_say(
        d,
        "the tissue that \"collagen_free\" states holds collagen: cells of the same "
        "specimens have less by %.2f of the baseline's tissue, so the shape lies "
        "elsewhere, or is of another tissue",
        tissue->at - edge);

    gsn_builder_warn(d, why);
    return why;
}

/* Why the tissue's colours do not narrow the loss; NULL: ret_spread is what they leave of it. */
static const char *by_edge(struct gsn_builder *d, const struct sides *sides,
                           const struct pool *pool, struct spread *ret_spread)
{
    struct gsn_error why = { 0 };
    struct gsn_hue_edge edge;
    const double edge_error = pool->lossy ? EDGE_ERROR_LOSSY : EDGE_ERROR;
    struct panel_edges panels = { 0 };
    double own, error, step;
    int r;

    if (fabs(1 - sides->apparent) < LEAST_LOST)
        return "too little is lost to see the colour of what remains";
    r = gsn_hue_edge_find(pool->point, pool->points, sides->there, sides->here, &edge, &why);
    if (r >= 0)
        r = judge_panels(&edge, pool, &panels, &why);
    if (r == GSN_E_NOMEM)
        d->out_of_memory = 1;
    if (r < 0)
        return gsn_builder_say(d, "%s", why.text);
    if (panels.panels[0] < LEAST_PANELS || panels.panels[1] < LEAST_PANELS)
        return gsn_builder_say(
            d,
            "fewer than %d panels of each specimen show tissue of the colour that "
            "is left where collagen is gone",
            LEAST_PANELS);
    own = (double)panels.panels[0];
    error = panels.scatter / sqrt(own);
    step = (gsn_hue_edge_ratio(&edge, sides->there, sides->here, 0.01) -
            gsn_hue_edge_ratio(&edge, sides->there, sides->here, -0.01)) /
           0.02;
    ret_spread->most =
        100 * (1 - gsn_hue_edge_ratio(&edge, sides->there, sides->here, -panels.mean));
    ret_spread->per_purest = 100 * step;
    ret_spread->deviation = hypot(100 * step * hypot(error, edge_error), sides->deviation);
    ret_spread->purest = PUREST;
    d->edge = edge;
    d->edge_panels = panels.panels[0] + panels.panels[1];
    if (sides->stated) {
        const struct free_tissue tissue = look_at_free(&edge, sides);
        /* It lies in some panels, the region in all of its own. */
        const double carried = panels.scatter * sqrt(1 / own + 1 / sides->free_panels);
        const double deviation = hypot(hypot(carried, edge_error), tissue.slope_error);

        /* No cell holds less than no collagen, so such tissue is not far inside the cloud. */
        if (tissue.at - panels.mean > 1.96 * hypot(deviation, tissue.purest))
            return note_contradiction(d, &tissue, panels.mean);
        ret_spread->most =
            100 * (1 - gsn_hue_edge_ratio(&edge, sides->there, sides->here, -tissue.at));
        ret_spread->purest = tissue.purest;
        ret_spread->deviation = hypot(100 * step * deviation, sides->deviation);
        return NULL;
    }
    if (edge.vertex > WIDEST_VERTEX)
        return gsn_builder_say(d,
                               "no tissue poor in collagen is seen, so that the loss is at most "
                               "%.1f %% and may be any less",
                               ret_spread->most + 1.96 * ret_spread->deviation);
    return NULL;
}

static void give_loss(const struct spread *s, double control, struct gsn_loss *loss)
{
    loss->percent = spread_quantile(s, 0.5);
    loss->percent_low = spread_quantile(s, 0.025);
    loss->percent_high = spread_quantile(s, 0.975);
    loss->points = loss->percent * control;
    loss->has_interval = 1;
}

static const char *narrow_loss(const struct gsn_report_inputs *e, struct gsn_builder *d,
                               const struct gsn_loss_side *control,
                               const struct gsn_loss_side *treated, const struct gsn_unmixer *mix,
                               struct pool *pool, struct gsn_loss *loss)
{
    const struct gsn_dyes *dyes = gsn_builder_table(e);
    struct sides sides = { .apparent = treated->mean / control->mean, .density = control->mean };
    struct side there;
    struct spread s = { 0 };
    const char *why;

    add_cloud(e->reconstruction->scale.cloud, mix, dyes, NULL, pool);
    pool->own = pool->panels;
    add_controls(e, d, mix, dyes, pool, &there, &sides);
    add_free(e->reconstruction->scale.free_od, e->reconstruction->scale.free_panels, &sides);
    for (int c = 0; c < 3; c++) {
        sides.here[c] = e->reconstruction->scale.region_od[c];
        sides.there[c] = there.od[c];
    }
    set_density(mix, dyes, treated->mean, sides.here);
    set_density(mix, dyes, control->mean, sides.there);
    sides.deviation =
        fmax(0.01, 100 * hypot(treated->standard_error, sides.apparent * control->standard_error) /
                       control->mean);
    why = by_edge(d, &sides, pool, &s);
    if (why) {
        s = (struct spread){ 100 * (1 - sides.apparent), 0, 0,
                             hypot(sides.deviation, prior_error(mix, &sides)) };
        d->edge_panels = 0;
    }
    if (isnan(s.deviation))
        return gsn_builder_say(d,
                               "the dye vectors were not measured, and what the baseline's tissue "
                               "looks like was not kept: run %s again",
                               e->specimen->baseline.name);
    give_loss(&s, control->mean, loss);
    d->by_colours = 1;
    d->loss_by_colour = (spread_quantile(&s, 0.841) - spread_quantile(&s, 0.159)) / 2;
    if (loss->percent_high - loss->percent_low <= MOST_WIDTH)
        return NULL;
    return gsn_builder_say(
        d,
        "the dye vectors were not measured, and %s: a calibration panel would "
        "narrow this: stain and scan one with each batch and state "
        "\"calibration\" in the jobs of both specimens",
        why ? why
            : gsn_builder_say(d,
                              "what the tissue tells leaves the loss between %.1f "
                              "and %.1f %%",
                              loss->percent_low, loss->percent_high));
}

/* report_loss.c: a loss whose dye vectors nobody measured, by the colours of both specimens'
 * tissue; why it cannot be given, or NULL. */
static const char *narrow_by_colours(const struct gsn_report_inputs *e, struct gsn_builder *d,
                                     const struct gsn_loss_side *control,
                                     const struct gsn_loss_side *treated, struct gsn_loss *loss)
{
    struct gsn_error why = { 0 };
    struct gsn_unmixer mix;
    struct pool pool;
    const char *reason;

    if (gsn_unmixer_init(&mix, gsn_builder_table(e), &why) < 0)
        return gsn_builder_say(d, "%s", why.text);
    if (!pool_init(e, &pool)) {
        d->out_of_memory = 1;
        reason = NULL;
    } else {
        reason = narrow_loss(e, d, control, treated, &mix, &pool, loss);
    }
    pool_done(&pool);
    return reason;
}

/* ---- the loss, or why there is none --------------------------------------------------------- */

/* Below this share of region voxels that were measured, or bridged from the sections beside them, a
 * loss is not printed: the density of a tenth that nobody knows can move the mean by as much as the
 * effects people look for. */
static const double LEAST_KNOWN = 0.9;

/* Of these, at least this share was measured: with every third section gone, what bridging costs
 * can hardly be measured on the rest. */
static const double LEAST_MEASURED = 0.7;

/* Per cent: of a smaller loss nobody can say from which density it is counted. */
static const double LEAST_FOR_ZERO = 5;

/* Why too little of a region is known to give a loss; NULL: enough is. */
static const char *too_little(struct gsn_builder *d, const char *whose, double known,
                              double measured)
{
    if (known < LEAST_KNOWN)
        return gsn_builder_say(d, "%sonly %.0f %% of the region of interest has data", whose,
                               100 * measured);
    if (measured < LEAST_MEASURED)
        return gsn_builder_say(
            d,
            "%sonly %.0f %% of the region of interest was measured; the rest could "
            "only be bridged from the sections beside it",
            whose, 100 * measured);
    return NULL;
}

static const char *too_little_known(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const char *why = too_little(d, "", e->analysis->coverage, d->report.region.coverage);

    return why ? gsn_builder_headline(e, d, why) : NULL;
}

static const char *too_little_of_baseline(const struct gsn_specimen_baseline *b,
                                          struct gsn_builder *d)
{
    const char *whose = gsn_builder_say(d, "of the baseline %s ", b->name);
    const char *why = too_little(d, whose, 1 - b->unknown, 1 - b->unmeasured);

    return why ? gsn_builder_say(d, "%s: settle what its report says, then run again", why) : NULL;
}

static const struct gsn_builder_cost no_loss = { .points = INFINITY };

/* Why the baseline gives nothing to compare with. */
static const char *no_baseline(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;

    if (b->lacking > 0)
        return gsn_builder_say(
            d,
            "the baseline %s has no region \"%s\": state it under \"regions\" in "
            "its job.json too, import it with --replace, then run again",
            b->name, e->specimen->part);
    if (b->withheld == 0)
        return gsn_builder_say(d, "the baseline %s has no result yet: import and run it", b->name);
    return gsn_builder_say(
        d,
        "the baseline %s was run and its own figure is withheld: settle what its "
        "report says, then run again",
        b->name);
}

/* Why two densities that are known say nothing of each other; NULL: they do. */
static const char *not_comparable(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    const char *version = d->report.density_version;
    const char *own = too_little_known(e, d), *theirs = too_little_of_baseline(b, d);

    if (own && theirs)
        gsn_builder_warn_cost(d, no_loss, theirs);
    if (own || theirs)
        return own ? own : theirs;
    if (e->reconstruction && e->reconstruction->scale.not_comparable[0])
        return e->reconstruction->scale.not_comparable;
    if (strcmp(b->dyes, version) != 0 &&
        (strstr(b->dyes, GSN_BUILDER_IN_BATCH) || strstr(version, GSN_BUILDER_IN_BATCH)))
        return gsn_builder_say(d,
                               "batches not comparable: the control was measured by %s, this "
                               "specimen by %s; state \"reference\" in both jobs",
                               b->dyes, version);
    return NULL;
}

/* Others may have this specimen for their baseline. */
static void warn_as_baseline(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const char *known = e->analysis ? too_little_known(e, d) : NULL;

    if (known)
        gsn_builder_warn_cost(
            d, no_loss,
            gsn_builder_say(d, "no loss can be given against this specimen: %s", known));
}

/* Why this specimen is compared with nothing; NULL: there is something. */
static const char *nothing_beside(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    const char *known, *none;

    if (!b->name[0]) {
        warn_as_baseline(e, d);
        return "no baseline is stated, so this specimen is its own";
    }
    if (e->tile)
        return "a tile is one picture: it has no baseline. Take `baseline` out of its job.json";
    if (!e->analysis)
        return gsn_builder_withheld(e, d);
    if (b->specimens > 0)
        return NULL;
    known = too_little_known(e, d);
    none = no_baseline(e, d);
    gsn_builder_warn_cost(d, no_loss, none);
    /* With a baseline it would be withheld just the same. */
    return known ? gsn_builder_say(d, "%s; %s", known, none) : none;
}

/* Why two sides give no loss; NULL: they gave ret_loss. */
static const char *compare_sides(const struct gsn_report_inputs *e, struct gsn_builder *d,
                                 const struct gsn_loss_side *control,
                                 const struct gsn_loss_side *treated, struct gsn_loss *ret_loss)
{
    struct gsn_error why = { 0 };
    const char *reason = not_comparable(e, d);

    if (!reason && gsn_loss(control, treated, 0.95, ret_loss, &why) < 0)
        reason = gsn_builder_say(d, "%s", why.text);
    if (!reason && !gsn_builder_calibrated(e))
        reason = narrow_by_colours(e, d, control, treated, ret_loss);
    return reason;
}

static void print_loss(const struct gsn_loss *loss, int narrowed, struct gsn_report *r)
{
    if (loss->has_interval) {
        r->loss_lower = loss->percent_low;
        r->loss_upper = loss->percent_high;
        r->loss_interval = narrowed ? "95 %, stain, white, dye vectors and sections"
                                    : "95 %, stain, white and sections";
    }
    r->loss_percent = loss->percent;
    r->loss_points = loss->points;
}

/* What each section errs by itself (cutting, registration, its own stain) is in the mean of either
 * side, beside the stain; where nothing is known of that, no interval comes of it. */
static void add_sections(double error, struct gsn_loss_side *side)
{
    if (side->standard_error > 0 && isfinite(error))
        side->standard_error = hypot(side->standard_error, error);
}

void gsn_builder_loss(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    struct gsn_report *r = &d->report;
    struct gsn_loss_side control = { .name = b->name,
                                     .definition = b->definition,
                                     .dyes = b->dyes,
                                     .mean = b->mean_density,
                                     .standard_error = b->mean_density_error,
                                     .region = b->region,
                                     .volume_um3 = 1e9 * b->volume_mm3 };
    struct gsn_loss_side treated = { .name = r->specimen,
                                     .definition = r->density_name,
                                     .dyes = r->density_version,
                                     .mean = r->region.mean_density,
                                     .standard_error = gsn_builder_density_error(e),
                                     .region = r->region.description,
                                     .volume_um3 = 1e9 * r->region.volume_mm3 };
    struct gsn_loss loss;

    r->loss_reason = nothing_beside(e, d);
    if (r->loss_reason || !e->analysis || b->specimens == 0)
        return;
    if (d->linked)
        gsn_builder_link_sides(e, d, &control, &treated);
    add_sections((d->linked ? d->link.gain : 1) * b->section_error, &control);
    add_sections(e->analysis->section_error, &treated);
    r->baseline_mean = control.mean;
    if (!gsn_loss_is_one_volume(treated.volume_um3, control.volume_um3))
        r->baseline_volume_mm3 = b->volume_mm3;
    r->loss_reason = compare_sides(e, d, &control, &treated, &loss);
    if (r->loss_reason) {
        gsn_builder_warn_cost(d, no_loss, r->loss_reason);
        return;
    }
    print_loss(&loss, d->by_colours, r);
    if (d->edge_panels > 0 && fabs(loss.percent) > LEAST_FOR_ZERO)
        r->zero_density =
            (treated.mean - (1 - loss.percent / 100) * control.mean) / (loss.percent / 100);
    if (d->by_colours || (d->linked && e->reconstruction->scale.levelling.vectors.known))
        gsn_builder_value(
            d->measure, &r->measure_count, "Standard error of the loss by dye vectors",
            d->by_colours ? d->loss_by_colour : gsn_builder_loss_by_vectors(e, &control, &treated),
            "%");
}
