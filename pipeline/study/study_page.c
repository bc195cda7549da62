/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The page of a study: one answer first, then what it rests on.
 *
 * From the top: the loss of each group with its interval over animals; a drawing with one dot an
 * animal; the comparisons; what the variance of each loss is made of; the animals with links to the
 * reports of their specimens; what was left out and why; further measures; a paragraph of methods
 * and an ARRIVE list with its blanks. Each part says how it is to be read. The style sheet is the
 * report's. Nothing is fetched and nothing runs. Fails only when memory runs out. */
#include "pipeline/study/loss_maps.h"
#include "pipeline/study/study.h"

#include "pipeline/report/chart.h"
#include "pipeline/report/html_elements.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static void put_week(struct gsn_report_text *text, double week)
{
    if (isfinite(week)) {
        gsn_report_text_raw(text, "week ");
        gsn_report_text_plain(text, week);
    }
}

static void put_cell_name(struct gsn_report_text *text, const struct gsn_study_cell *cell)
{
    gsn_report_text_escape(text, *cell->group ? cell->group : "(no group)");
    if (isfinite(cell->week)) {
        gsn_report_text_raw(text, ", ");
        put_week(text, cell->week);
    }
}

/* Three significant digits, as many decimals as those of densities and volumes. */
static void put_value(struct gsn_report_text *text, double value)
{
    gsn_report_text_digits(text, value, 4);
}

static void put_range(struct gsn_report_text *text, double lower, double upper, int decimals)
{
    if (!isfinite(lower) || !isfinite(upper)) {
        gsn_report_text_raw(text, "\xE2\x80\x93");
        return;
    }
    gsn_report_text_number(text, lower, decimals);
    gsn_report_text_raw(text, " to ");
    gsn_report_text_number(text, upper, decimals);
}

static void put_p(struct gsn_report_text *text, double p)
{
    if (isfinite(p) && p < 1e-4)
        gsn_report_text_raw(text, "&lt; 0.0001");
    else if (isfinite(p))
        gsn_report_text_number(text, p, p < 0.1 ? 4 : 2);
    else
        gsn_report_text_raw(text, "\xE2\x80\x93");
}

/* ---- head ---------------------------------------------------------------------------------- */

static int add_head(struct gsn_report_text *text, const struct gsn_study *study,
                    struct gsn_error *err)
{
    const int r = gsn_html_head(text, study->input.name, " \xC2\xB7 study", 0, err);

    if (r < 0)
        return r;
    gsn_report_text_raw(text, "<header class=\"top\">\n"
                              "<p class=\"brand\"><b>gieson</b> study</p>\n<h1>");
    gsn_report_text_escape(text, *study->input.name ? study->input.name : "(study without a name)");
    gsn_report_text_raw(text, "</h1>\n<ul class=\"ids\">\n");
    gsn_report_text_print(text,
                          "<li><b>%zu</b> animals</li>\n<li><b>%zu</b> specimens</li>\n"
                          "<li><b>%zu</b> groups and time points</li>\n<li>",
                          study->animal_count, study->input.specimen_count, study->cell_count);
    if (study->input.frozen) {
        gsn_report_text_raw(text, "analysis frozen ");
        gsn_report_text_escape(text, study->input.frozen);
    } else {
        gsn_report_text_raw(text, "analysis not frozen");
    }
    gsn_report_text_raw(text, "</li>\n</ul>\n</header>\n<main>\n");
    return GSN_OK;
}

/* ---- the answer ---------------------------------------------------------------------------- */

static void add_loss(struct gsn_report_text *text, const struct gsn_study *study,
                     const struct gsn_study_comparison *c)
{
    char allows[256];

    gsn_report_text_raw(text, "<div><p class=\"label\">Collagen loss of ");
    put_cell_name(text, &study->cell[c->a]);
    gsn_report_text_raw(text, ", against ");
    gsn_report_text_escape(text, study->cell[c->b].group);
    if (c->pooled)
        gsn_report_text_raw(text, " of all time points");
    gsn_report_text_raw(text, "</p>\n<p class=\"big\">");
    gsn_report_text_number(text, c->loss.percent, 1);
    gsn_report_text_raw(text, "<small>%</small></p>\n<p class=\"range\">");
    put_range(text, c->loss.lower, c->loss.upper, 1);
    gsn_report_text_print(text,
                          " %% <span class=\"soft\">(95 %%, over %zu and %zu animals)</span></p>\n"
                          "<p class=\"soft\">Welch p ",
                          c->mean_a.n, c->mean_b.n);
    put_p(text, c->difference.p);
    gsn_report_text_raw(text, ", corrected for all comparisons ");
    put_p(text, c->p_holm);
    if (isfinite(c->p_exact)) {
        gsn_report_text_raw(text, "; exact permutation p ");
        put_p(text, c->p_exact);
    } else
        gsn_report_text_print(text,
                              "; no exact permutation p, for so many animals can be dealt out "
                              "in more than %d million ways",
                              GSN_PERMUTATIONS / 1000000);
    gsn_report_text_raw(text, "</p>\n");
    gsn_study_allows(c, allows, sizeof allows);
    if (allows[0]) {
        gsn_report_text_raw(text, "<p class=\"flag\">What so few allow: ");
        gsn_report_text_escape(text, allows);
        gsn_report_text_raw(text, ".</p>\n");
    }
    gsn_report_text_raw(text, "</div>\n");
}

static void add_answer(struct gsn_report_text *text, const struct gsn_study *study)
{
    size_t losses = 0;

    for (size_t i = 0; i < study->comparison_count; i++)
        losses += study->comparison[i].kind == GSN_STUDY_LOSS && study->comparison[i].measure == 0;
    gsn_report_text_print(text,
                          "<div class=\"summary\">\n<div class=\"verdict %s\"><p class=\"state\">",
                          losses ? "is-ok" : "is-warn");
    if (study->input.blind)
        gsn_report_text_raw(text,
                            "Blind</p><p>Group names are codes until the analysis is frozen, so no "
                            "control and no loss is shown: <code>gieson study NAME freeze</code>, "
                            "then <code>unblind</code>.");
    else if (losses)
        gsn_report_text_raw(text,
                            "Answer</p><p>Intervals are over animals: how far the loss would move "
                            "if other animals had been taken.");
    else
        gsn_report_text_raw(
            text, "No loss</p><p>No group has both a control and a report of its own yet: "
                  "state <code>baseline</code> and <code>group</code> in job.json.");
    gsn_report_text_raw(text, "</p></div>\n");
    if (losses)
        gsn_report_text_raw(text, "<div class=\"hero\">\n");
    for (size_t i = 0; i < study->comparison_count; i++)
        if (study->comparison[i].kind == GSN_STUDY_LOSS && study->comparison[i].measure == 0)
            add_loss(text, study, &study->comparison[i]);
    gsn_report_text_raw(text, losses ? "</div>\n</div>\n" : "</div>\n");
    if (study->shared_animals > 0)
        gsn_report_text_print(
            text,
            "<section><ul class=\"warnings\"><li>%zu animals are in more than one group "
            "(two sides of one animal, say). The comparisons here take groups for "
            "independent; a paired analysis of the CSV is narrower.</li></ul></section>\n",
            study->shared_animals);
}

/* ---- one dot an animal --------------------------------------------------------------------- */

struct drawing {
    double left, right, top, bottom, most;
};

/* Half the bar of a group's mean: wider than its dots lie, however many they are. */
static const double BAR = 32;

static double height_of(const struct drawing *d, double value)
{
    return d->bottom - value / d->most * (d->bottom - d->top);
}

static void draw_scale(struct gsn_report_text *text, const struct drawing *d, double step)
{
    for (int i = 0; i * step <= d->most * 1.0001; i++) {
        const double y = height_of(d, i * step);

        gsn_report_text_print(text,
                              "<path class=\"grid\" d=\"M%.1f %.1fH%.1f\"/>\n"
                              "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"end\">",
                              d->left, y, d->right, d->left - 6, y + 4);
        gsn_report_text_plain(text, i * step);
        gsn_report_text_raw(text, "</text>\n");
    }
}

static void draw_cell(struct gsn_report_text *text, const struct gsn_study *study,
                      const struct gsn_study_cell *cell, const struct drawing *d, double x)
{
    const struct gsn_group_mean *const mean = &cell->mean[0];

    for (size_t i = 0; i < cell->count; i++) {
        const struct gsn_study_animal *const animal = &study->animal[cell->first + i];
        const double aside =
            ((double)i - 0.5 * (double)(cell->count - 1)) * fmin(9, 44.0 / (double)cell->count);

        if (!isfinite(animal->value[0]))
            continue;
        gsn_report_text_print(
            text, "<circle class=\"%s\" cx=\"%.1f\" cy=\"%.1f\" r=\"3.4\"><title>",
            cell->is_control ? "m3" : "m1", x + aside, height_of(d, animal->value[0]));
        gsn_report_text_escape_short(text, animal->name, 40);
        gsn_report_text_raw(text, ": ");
        put_value(text, animal->value[0]);
        gsn_report_text_raw(text, "</title></circle>\n");
    }
    if (isfinite(mean->mean))
        gsn_report_text_print(text, "<path class=\"mean\" d=\"M%.1f %.1fh%.0f\"/>\n", x - BAR,
                              height_of(d, mean->mean), 2 * BAR);
    if (isfinite(mean->lower))
        gsn_report_text_print(text, "<path class=\"mean\" d=\"M%.1f %.1fV%.1f\"/>\n", x + BAR,
                              height_of(d, fmin(mean->upper, d->most)),
                              height_of(d, fmax(mean->lower, 0)));
    gsn_report_text_print(text,
                          "<text class=\"strong\" x=\"%.1f\" y=\"%.1f\" text-anchor=\"middle\">", x,
                          d->bottom + 16);
    gsn_report_text_escape_short(text, *cell->group ? cell->group : "(no group)", 12);
    gsn_report_text_print(text, "</text>\n<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"middle\">", x,
                          d->bottom + 31);
    put_week(text, cell->week);
    gsn_report_text_raw(text, "</text>\n");
}

static void add_drawing(struct gsn_report_text *text, const struct gsn_study *study)
{
    const double width = fmax(420, 60 + 92 * (double)study->cell_count);
    struct drawing d = { 44, width - 10, 26, 220, 0 };
    double step;

    for (size_t i = 0; i < study->animal_count; i++)
        if (isfinite(study->animal[i].value[0]))
            d.most = fmax(d.most, study->animal[i].value[0]);
    if (!(d.most > 0))
        return;
    step = gsn_chart_step(d.most, 6);
    d.most = step * ceil(d.most / step * 1.0001);
    gsn_report_text_raw(
        text, "<section>\n<h2>One dot an animal</h2>\n<p class=\"lead\">Mean collagen "
              "density of the region, on the scale of the control's stain. The bar is the "
              "group's mean; the line at its end the 95 % interval. Good: the dots of a group "
              "lie close together, and groups that differ do not overlap. One dot far from "
              "its group: open its report below before anything else.</p>\n"
              "<figure><div class=\"drawing\">");
    gsn_report_text_print(
        text,
        "<svg viewBox=\"0 0 %.0f 262\" role=\"img\" class=\"chart %s\"><title>Density of "
        "each animal by group and time point</title>\n"
        "<text class=\"name\" x=\"2\" y=\"14\">density</text>\n",
        width, study->cell_count <= 4 ? "few" : "many");
    draw_scale(text, &d, step);
    for (size_t c = 0; c < study->cell_count; c++)
        draw_cell(text, study, &study->cell[c], &d,
                  d.left + (d.right - d.left) * ((double)c + 0.5) / (double)study->cell_count);
    gsn_report_text_print(text,
                          "<path class=\"axis\" d=\"M%.1f %.1fH%.1f\"/>\n</svg></div></figure>\n",
                          d.left, d.bottom, d.right);
    gsn_report_text_raw(text, "</section>\n");
}

/* ---- tables -------------------------------------------------------------------------------- */

static void open_table(struct gsn_report_text *text, const char *const *heads, size_t count)
{
    gsn_report_text_raw(text, "<div class=\"table scroll\"><table><thead><tr>");
    for (size_t i = 0; i < count; i++)
        gsn_report_text_print(text, "<th%s>%s</th>", i ? " class=\"num\"" : "", heads[i]);
    gsn_report_text_raw(text, "</tr></thead><tbody>\n");
}

static void close_table(struct gsn_report_text *text)
{
    gsn_report_text_raw(text, "</tbody></table></div>\n</section>\n");
}

static void add_groups(struct gsn_report_text *text, const struct gsn_study *study)
{
    static const char *const heads[] = { "Group",
                                         "Animals",
                                         "Mean density",
                                         "95 % of the mean",
                                         "SD between animals",
                                         "Error of one animal" };

    gsn_report_text_raw(
        text, "<section>\n<h2>Groups</h2>\n<p class=\"lead\">The error of one animal is what "
              "measuring it leaves open. Where it is as large as the SD between animals, better "
              "measuring helps; where it is much smaller, only more animals do.</p>\n");
    open_table(text, heads, sizeof heads / sizeof heads[0]);
    for (size_t i = 0; i < study->cell_count; i++) {
        const struct gsn_study_cell *const cell = &study->cell[i];

        gsn_report_text_raw(text, "<tr><th scope=\"row\">");
        put_cell_name(text, cell);
        gsn_report_text_print(text, "</th><td class=\"num\">%zu</td><td class=\"num\">",
                              cell->mean[0].n);
        put_value(text, cell->mean[0].mean);
        gsn_report_text_raw(text, "</td><td class=\"num\">");
        put_range(text, cell->mean[0].lower, cell->mean[0].upper, 3);
        gsn_report_text_raw(text, "</td><td class=\"num\">");
        put_value(text, cell->mean[0].sd);
        gsn_report_text_raw(text, "</td><td class=\"num\">");
        put_value(text, cell->error[0]);
        gsn_report_text_raw(text, "</td></tr>\n");
    }
    close_table(text);
}

static void add_comparison_row(struct gsn_report_text *text, const struct gsn_study *study,
                               const struct gsn_study_comparison *c)
{
    gsn_report_text_raw(text, "<tr><th scope=\"row\">");
    put_cell_name(text, &study->cell[c->a]);
    gsn_report_text_raw(text, " against ");
    gsn_report_text_escape(text, *study->cell[c->b].group ? study->cell[c->b].group : "(no group)");
    if (c->pooled)
        gsn_report_text_raw(text, ", all time points");
    if (c->measure > 0) {
        gsn_report_text_raw(text, "<br><span class=\"soft\">");
        gsn_report_text_escape(text, study->input.measure[c->measure].name);
        gsn_report_text_raw(text, "</span>");
    }
    gsn_report_text_print(text, "</th><td class=\"num\">%zu / %zu</td><td class=\"num\">",
                          c->mean_a.n, c->mean_b.n);
    if (c->kind == GSN_STUDY_LOSS) {
        gsn_report_text_number(text, c->loss.percent, 1);
        gsn_report_text_raw(text, " %<br><span class=\"soft\">");
        put_range(text, c->loss.lower, c->loss.upper, 1);
        gsn_report_text_raw(text, "</span>");
    } else {
        gsn_report_text_raw(text, "\xE2\x80\x93");
    }
    gsn_report_text_raw(text, "</td><td class=\"num\">");
    put_value(text, c->difference.difference);
    gsn_report_text_raw(text, "<br><span class=\"soft\">");
    put_range(text, c->difference.lower, c->difference.upper, 3);
    gsn_report_text_raw(text, "</span></td><td class=\"num\">");
    put_p(text, c->difference.p);
    gsn_report_text_raw(text, "</td><td class=\"num\">");
    put_p(text, c->p_holm);
    gsn_report_text_raw(text, "</td><td class=\"num\">");
    put_p(text, c->p_exact);
    gsn_report_text_raw(text, "</td><td class=\"num\">");
    gsn_report_text_number(text, c->difference.g, 2);
    gsn_report_text_raw(text, "<br><span class=\"soft\">");
    put_range(text, c->difference.g_lower, c->difference.g_upper, 2);
    gsn_report_text_raw(text, "</span></td></tr>\n");
}

/* main: those of the first measure; else those of all others. */
static void add_comparisons(struct gsn_report_text *text, const struct gsn_study *study, int main)
{
    static const char *const heads[] = { "Comparison", "Animals", "Loss",        "Difference",
                                         "Welch p",    "Holm p",  "Permutation", "Hedges' g" };
    size_t count = 0;

    for (size_t i = 0; i < study->comparison_count; i++)
        count += (study->comparison[i].measure == 0) == main;
    if (count == 0)
        return;
    gsn_report_text_raw(text, main ? "<section>\n<h2>Comparisons</h2>\n"
                                   : "<section>\n<h2>Further measures</h2>\n");
    gsn_report_text_raw(text,
                        "<p class=\"lead\">A loss with Fieller's 95 % interval, the difference of "
                        "the means with Welch's. Holm p counts that several comparisons were made: "
                        "quote it. The permutation p assumes nothing of how densities are "
                        "distributed; with few animals it cannot be small, and with so many that "
                        "there are millions of ways to deal them out it is not computed.</p>\n");
    open_table(text, heads, sizeof heads / sizeof heads[0]);
    for (size_t i = 0; i < study->comparison_count; i++)
        if ((study->comparison[i].measure == 0) == main)
            add_comparison_row(text, study, &study->comparison[i]);
    close_table(text);
}

/* The densities of a further region. */
static void add_part(struct gsn_report_text *text, const struct gsn_study *part)
{
    static const char *const heads[] = { "Comparison", "Animals", "Loss",        "Difference",
                                         "Welch p",    "Holm p",  "Permutation", "Hedges' g" };
    size_t left_out = 0;

    for (size_t i = 0; i < part->input.specimen_count; i++)
        left_out += part->input.specimen[i].left_out != NULL;
    gsn_report_text_raw(text, "<section>\n<h2>Region ");
    gsn_report_text_escape(text, part->input.region);
    gsn_report_text_print(
        text, "</h2>\n<p class=\"lead\">Density, as above; Holm p counts the comparisons "
              "of all regions.");
    if (left_out > 0)
        gsn_report_text_print(text, " %zu %s no figure here; animals.csv has the reasons.",
                              left_out, left_out == 1 ? "specimen has" : "specimens have");
    gsn_report_text_raw(text, " animals.csv has the volumes.</p>\n");
    open_table(text, heads, sizeof heads / sizeof heads[0]);
    for (size_t i = 0; i < part->comparison_count; i++)
        if (part->comparison[i].measure == 0)
            add_comparison_row(text, part, &part->comparison[i]);
    close_table(text);
}

static void put_share(struct gsn_report_text *text, double part, double total)
{
    gsn_report_text_raw(text, "<td class=\"num\">");
    gsn_report_text_number(text, total > 0 ? 100 * part / total : NAN, 0);
    gsn_report_text_raw(text, isfinite(part) ? " %</td>" : "</td>");
}

/* The parts of one budget as the page has them, both sides together but for the animals. */
enum { BUDGET_PARTS = 5 };
static const struct {
    const char *name, *helps;
} BUDGET[BUDGET_PARTS] = {
    { "Animals, treated", "more treated animals" },
    { "Animals, control", "more control animals" },
    { "Dye vectors", "a calibration panel with each batch" },
    { "Stain and white", "a steadier bath and lamp" },
    { "Sections", "more or better sections" },
};

static void sum_budget(const struct gsn_study_budget *b, double part[BUDGET_PARTS])
{
    part[0] = b->treated.animals;
    part[1] = b->control.animals;
    part[2] = b->treated.vectors + b->control.vectors;
    part[3] = b->treated.measurement + b->control.measurement;
    part[4] = b->treated.sections + b->control.sections;
}

static const char *find_remedy(const double part[BUDGET_PARTS])
{
    size_t largest = 0;

    for (size_t i = 1; i < BUDGET_PARTS; i++)
        if (part[i] > part[largest])
            largest = i;
    return BUDGET[largest].helps;
}

static void add_budget_row(struct gsn_report_text *text, const struct gsn_study *study,
                           const struct gsn_study_comparison *c)
{
    double part[BUDGET_PARTS];

    sum_budget(&c->budget, part);
    gsn_report_text_raw(text, "<tr><th scope=\"row\">");
    put_cell_name(text, &study->cell[c->a]);
    gsn_report_text_raw(text, "</th><td class=\"num\">");
    gsn_report_text_number(text, sqrt(c->budget.total), 2);
    gsn_report_text_raw(text, " points</td>");
    for (size_t i = 0; i < BUDGET_PARTS; i++)
        put_share(text, part[i], c->budget.total);
    gsn_report_text_print(text, "<td>%s</td></tr>\n", find_remedy(part));
}

static void add_budget(struct gsn_report_text *text, const struct gsn_study *study)
{
    size_t count = 0;

    for (size_t i = 0; i < study->comparison_count; i++)
        count += study->comparison[i].measure == 0 && study->comparison[i].budget.total > 0;
    if (count == 0)
        return;
    gsn_report_text_raw(
        text, "<section>\n<h2>What limits the answer</h2>\n<p class=\"lead\">Of the variance of "
              "each loss, the share that animals make and the shares that measuring them adds; "
              "they add up to all of it. The largest is where effort pays. An error that all "
              "animals share, such as one wrong table of dyes, is in none of them.</p>\n"
              "<div class=\"table scroll\"><table><thead><tr><th>Loss of</th>"
              "<th class=\"num\">Standard error</th>");
    for (size_t i = 0; i < BUDGET_PARTS; i++)
        gsn_report_text_print(text, "<th class=\"num\">%s</th>", BUDGET[i].name);
    gsn_report_text_raw(text, "<th>Helps most</th></tr></thead><tbody>\n");
    for (size_t i = 0; i < study->comparison_count; i++)
        if (study->comparison[i].measure == 0 && study->comparison[i].budget.total > 0)
            add_budget_row(text, study, &study->comparison[i]);
    close_table(text);
}

static void add_specimens(struct gsn_report_text *text, const struct gsn_study *study)
{
    static const char *const heads[] = { "Specimen", "Animal", "Group", "Density", "Its own loss" };

    gsn_report_text_raw(
        text, "<section>\n<h2>Animals and specimens</h2>\n<p class=\"lead\">Each specimen "
              "leads to its own report, with the sections as they lay on the glass. Its "
              "own loss has the interval of one measurement, not of a group.</p>\n");
    open_table(text, heads, sizeof heads / sizeof heads[0]);
    for (size_t i = 0; i < study->input.specimen_count; i++) {
        const struct gsn_study_specimen *const s = &study->input.specimen[i];

        if (s->left_out)
            continue;
        gsn_report_text_raw(text, "<tr><th scope=\"row\">");
        if (s->page) {
            gsn_report_text_raw(text, "<a href=\"../../");
            gsn_report_text_escape(text, s->page);
            gsn_report_text_raw(text, "\">");
        }
        gsn_report_text_escape(text, s->name);
        gsn_report_text_raw(text,
                            s->page ? "</a></th><td class=\"num\">" : "</th><td class=\"num\">");
        gsn_report_text_escape(text, s->animal);
        gsn_report_text_raw(text, "</td><td class=\"num\">");
        gsn_report_text_escape(text, s->group);
        if (isfinite(s->week)) {
            gsn_report_text_raw(text, ", ");
            put_week(text, s->week);
        }
        gsn_report_text_raw(text, "</td><td class=\"num\">");
        put_value(text, s->value[0]);
        gsn_report_text_raw(text, "</td><td class=\"num\">");
        if (isfinite(s->loss)) {
            gsn_report_text_number(text, s->loss, 1);
            gsn_report_text_raw(text, " %<br><span class=\"soft\">");
            put_range(text, s->loss_lower, s->loss_upper, 1);
            gsn_report_text_raw(text, "</span>");
        } else {
            gsn_report_text_raw(text, "\xE2\x80\x93");
        }
        gsn_report_text_raw(text, "</td></tr>\n");
    }
    close_table(text);
}

static void add_left_out(struct gsn_report_text *text, const struct gsn_study *study)
{
    size_t count = 0;

    for (size_t i = 0; i < study->input.specimen_count; i++)
        count += study->input.specimen[i].left_out != NULL;
    gsn_report_text_raw(text, "<section>\n<h2>Left out</h2>\n");
    if (count == 0) {
        gsn_report_text_raw(text, "<p class=\"lead\">No specimen.</p>\n</section>\n");
        return;
    }
    gsn_report_text_raw(text, "<div class=\"table scroll\"><table><thead><tr><th>Specimen</th>"
                              "<th>Group</th><th>Why</th></tr></thead><tbody>\n");
    for (size_t i = 0; i < study->input.specimen_count; i++) {
        const struct gsn_study_specimen *const s = &study->input.specimen[i];

        if (!s->left_out)
            continue;
        gsn_report_text_raw(text, "<tr><th scope=\"row\">");
        gsn_report_text_escape(text, s->name);
        gsn_report_text_raw(text, "</th><td>");
        gsn_report_text_escape(text, s->group);
        gsn_report_text_raw(text, "</td><td class=\"reason\">");
        gsn_report_text_escape(text, s->left_out);
        gsn_report_text_raw(text, "</td></tr>\n");
    }
    close_table(text);
}

/* ---- words to paste ------------------------------------------------------------------------ */

static void add_methods(struct gsn_report_text *text, const struct gsn_study *study)
{
    gsn_report_text_raw(text, "<section>\n<h2>Methods, to paste</h2>\n<p class=\"lead\">");
    gsn_report_text_raw(text,
                        "Collagen density was measured on serial sections stained after Van Gieson "
                        "with gieson ");
    gsn_report_text_escape(text, study->input.version);
    gsn_report_text_raw(
        text, ": sections were registered rigidly, red was unmixed from the other dyes in "
              "optical density, and densities were brought to the scale of the control's "
              "stain. Region: ");
    gsn_report_text_escape(text, study->input.region);
    gsn_report_text_raw(
        text, ". The animal was the unit of analysis; specimens of one animal were "
              "averaged. The loss is 100 (1 \xE2\x88\x92 mean of the group / mean of its "
              "control) with Fieller's 95 % interval over animals (Welch's freedom). Groups "
              "were compared by Welch's test, corrected after Holm, and by the exact "
              "permutation test; effect sizes are Hedges' g with the interval of the "
              "noncentral t distribution.</p>\n</section>\n");
}

static void add_arrive(struct gsn_report_text *text, const struct gsn_study *study)
{
    static const char blank[] = "<b>to be filled in by the authors: ____________________</b>";
    size_t left_out = 0;

    for (size_t i = 0; i < study->input.specimen_count; i++)
        left_out += study->input.specimen[i].left_out != NULL;
    gsn_report_text_raw(text, "<section>\n<h2>ARRIVE 2.0, the essential ten</h2>\n"
                              "<div class=\"table scroll\"><table><tbody>\n"
                              "<tr><th scope=\"row\">1 Study design</th><td>");
    for (size_t c = 0; c < study->cell_count; c++) {
        gsn_report_text_raw(text, c ? "; " : "");
        put_cell_name(text, &study->cell[c]);
        gsn_report_text_print(text, " (%zu)", study->cell[c].count);
    }
    gsn_report_text_print(
        text,
        ". Unit: the animal.</td></tr>\n<tr><th scope=\"row\">2 Sample size</th><td>%zu "
        "animals. How it was decided: %s</td></tr>\n"
        "<tr><th scope=\"row\">3 Inclusion and exclusion</th><td>%zu specimens left out, "
        "listed above with the reason. Criteria set beforehand: %s</td></tr>\n"
        "<tr><th scope=\"row\">4 Randomisation</th><td>%s</td></tr>\n"
        "<tr><th scope=\"row\">5 Blinding</th><td>Measurement is automatic. %s%s</td></tr>\n"
        "<tr><th scope=\"row\">6 Outcome measures</th><td>Main: ",
        study->animal_count, blank, left_out, blank, blank,
        study->input.blind ? "Group names are hidden in this page. " : "", blank);
    gsn_report_text_escape(text, study->input.measure[0].definition);
    gsn_report_text_print(
        text,
        "</td></tr>\n<tr><th scope=\"row\">7 Statistical methods</th><td>as in the "
        "paragraph above</td></tr>\n"
        "<tr><th scope=\"row\">8 Experimental animals</th><td>%s</td></tr>\n"
        "<tr><th scope=\"row\">9 Experimental procedures</th><td>%s</td></tr>\n"
        "<tr><th scope=\"row\">10 Results</th><td>means, spreads and effect sizes with "
        "intervals: above</td></tr>\n",
        blank, blank);
    close_table(text);
}

int gsn_study_page(const struct gsn_study *study, char **ret_bytes, size_t *ret_size,
                   struct gsn_error *err)
{
    gsn_auto_report_text text = { .bytes = NULL };
    const int r = add_head(&text, study, err);

    if (r < 0)
        return r;
    add_answer(&text, study);
    add_drawing(&text, study);
    add_groups(&text, study);
    add_comparisons(&text, study, 1);
    for (size_t k = 0; k < study->part_count; k++)
        add_part(&text, study->part[k]);
    gsn_study_add_maps(&text, study);
    add_budget(&text, study);
    add_specimens(&text, study);
    add_left_out(&text, study);
    add_comparisons(&text, study, 0);
    add_methods(&text, study);
    add_arrive(&text, study);
    gsn_report_text_raw(&text, "</main>\n<footer><p>gieson ");
    gsn_report_text_escape(&text, study->input.version);
    gsn_report_text_raw(&text,
                        " \xC2\xB7 the same figures for programs: <a href=\"animals.csv\">"
                        "animals.csv</a>, <a href=\"study.json\">study.json</a></p></footer>\n"
                        "</body>\n</html>\n");
    if (text.failed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the study's page");
    gsn_report_text_give(&text, ret_bytes, ret_size);
    return GSN_OK;
}
