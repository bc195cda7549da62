/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The front page of a store.
 *
 * From the top: how many specimens there are and how they stand; what needs a person, each with its
 * first cause; then a table a study, a row a specimen: group, week, loss with its interval in
 * figures and drawn on one scale for the whole page, density, warnings, day of the report. A blind
 * study shows what its own records show, which is neither groups nor losses. Last what the bench
 * was like from day to day. Nothing is fetched and nothing runs. Fails only when memory runs out.
 * Costs a line of text a specimen. */
#include "pipeline/study/index_page.h"

#include "pipeline/report/chart.h"
#include "pipeline/report/html_elements.h"

#include <math.h>
#include <string.h>
#include <time.h>

/* Of the drawing of an interval, in px; its scale is the page's. */
enum { DRAWN_WIDE = 150, DRAWN_HIGH = 22 };
struct scale {
    double low, high; /* per cent of loss; low < high */
    int used;         /* by any specimen */
};

static const char DASH[] = "\xE2\x80\x93";

static int needs_person(const struct gsn_study_specimen *s)
{
    return s->left_out && !s->excluded;
}

static struct scale find_scale(const struct gsn_index_study *study, size_t count)
{
    struct scale scale = { 0, 10, 0 };

    for (size_t k = 0; k < count; k++)
        for (size_t i = 0; i < study[k].input->specimen_count; i++) {
            const struct gsn_study_specimen *const s = &study[k].input->specimen[i];

            if (isfinite(s->loss)) {
                scale.used = 1;
                scale.low = fmin(scale.low, s->loss);
                scale.high = fmax(scale.high, s->loss);
            }
            if (isfinite(s->loss_lower))
                scale.low = fmin(scale.low, s->loss_lower);
            if (isfinite(s->loss_upper))
                scale.high = fmax(scale.high, s->loss_upper);
        }
    return scale;
}

static double place_of(const struct scale *scale, double loss)
{
    return 3 + (DRAWN_WIDE - 6) * (loss - scale->low) / (scale->high - scale->low);
}

static void draw_interval(struct gsn_report_text *text, const struct scale *scale,
                          const struct gsn_study_specimen *s)
{
    const double middle = DRAWN_HIGH / 2.0;

    gsn_report_text_print(text,
                          "<svg class=\"chart\" viewBox=\"0 0 %d %d\" width=\"%d\" height=\"%d\" "
                          "role=\"img\"><title>loss, from %.0f to %.0f %%</title>"
                          "<path class=\"grid\" d=\"M%.1f 0V%d\"/>",
                          DRAWN_WIDE, DRAWN_HIGH, DRAWN_WIDE, DRAWN_HIGH, scale->low, scale->high,
                          place_of(scale, 0), DRAWN_HIGH);
    if (isfinite(s->loss_lower) && isfinite(s->loss_upper))
        gsn_report_text_print(text, "<path class=\"axis\" d=\"M%.1f %.1fH%.1f\"/>",
                              place_of(scale, s->loss_lower), middle,
                              place_of(scale, s->loss_upper));
    gsn_report_text_print(text, "<circle class=\"m1\" cx=\"%.1f\" cy=\"%.1f\" r=\"3.6\"/></svg>",
                          place_of(scale, s->loss), middle);
}

static void put_name(struct gsn_report_text *text, const struct gsn_study_specimen *s)
{
    if (s->page) {
        gsn_report_text_raw(text, "<a href=\"");
        gsn_report_text_escape(text, s->page);
        gsn_report_text_raw(text, "\">");
    }
    gsn_report_text_escape(text, s->name);
    if (s->page)
        gsn_report_text_raw(text, "</a>");
}

static void put_day(struct gsn_report_text *text, int64_t when)
{
    const time_t seconds = (time_t)when;
    struct tm day;
    char said[16];

    if (when > 0 && gmtime_r(&seconds, &day) && strftime(said, sizeof said, "%Y-%m-%d", &day))
        gsn_report_text_raw(text, said);
    else
        gsn_report_text_raw(text, DASH);
}

/* ---- parts ------------------------------------------------------------------------------- */

/* How many specimens stand how. */
struct tally {
    size_t specimens, reported, person, excluded;
};

static struct tally count_specimens(const struct gsn_index_study *study, size_t count)
{
    struct tally tally = { 0 };

    for (size_t k = 0; k < count; k++)
        for (size_t i = 0; i < study[k].input->specimen_count; i++) {
            const struct gsn_study_specimen *const s = &study[k].input->specimen[i];

            tally.specimens++;
            tally.reported += !s->left_out;
            tally.person += (size_t)needs_person(s);
            tally.excluded += (size_t)(s->excluded != 0);
        }
    return tally;
}

static void add_top(struct gsn_report_text *text, const struct tally *tally)
{
    gsn_report_text_print(text,
                          "<header class=\"top\">\n<p class=\"brand\"><b>gieson</b> store</p>\n"
                          "<h1>Specimens and studies</h1>\n<ul class=\"ids\">\n"
                          "<li><b>%zu</b> specimens</li>\n<li><b>%zu</b> with a figure</li>\n"
                          "<li><b>%zu</b> need a person</li>\n",
                          tally->specimens, tally->reported, tally->person);
    if (tally->excluded > 0)
        gsn_report_text_print(text, "<li><b>%zu</b> excluded</li>\n", tally->excluded);
    gsn_report_text_raw(text, "</ul>\n</header>\n<main>\n");
}

static void add_person(struct gsn_report_text *text, const struct gsn_index_study *study,
                       size_t count)
{
    gsn_report_text_raw(text, "<section>\n<h2>Needs a person</h2>\n<p class=\"lead\">No figure was "
                              "given, each with the first cause.</p>\n<ul class=\"warnings\">\n");
    for (size_t k = 0; k < count; k++)
        for (size_t i = 0; i < study[k].input->specimen_count; i++) {
            const struct gsn_study_specimen *const s = &study[k].input->specimen[i];

            if (!needs_person(s))
                continue;
            gsn_report_text_raw(text, "<li><b>");
            put_name(text, s);
            gsn_report_text_raw(text, "</b>: ");
            gsn_report_text_escape(text, s->left_out);
            gsn_report_text_raw(text, "</li>\n");
        }
    gsn_report_text_raw(text, "</ul>\n</section>\n");
}

static void add_row(struct gsn_report_text *text, const struct scale *scale,
                    const struct gsn_study_specimen *s)
{
    gsn_report_text_raw(text, "<tr><th scope=\"row\" class=\"name\">");
    put_name(text, s);
    gsn_report_text_raw(text, "</th><td>");
    gsn_report_text_escape(text, *s->group ? s->group : DASH);
    gsn_report_text_raw(text, "</td><td class=\"num\">");
    if (isfinite(s->week))
        gsn_report_text_plain(text, s->week);
    else
        gsn_report_text_raw(text, DASH);
    gsn_report_text_raw(text, "</td><td class=\"num\">");
    if (isfinite(s->loss)) {
        gsn_report_text_number(text, s->loss, 1);
        gsn_report_text_raw(text, " %");
        if (isfinite(s->loss_lower) && isfinite(s->loss_upper)) {
            gsn_report_text_raw(text, "<br><span class=\"soft\">");
            gsn_report_text_number(text, s->loss_lower, 1);
            gsn_report_text_raw(text, " to ");
            gsn_report_text_number(text, s->loss_upper, 1);
            gsn_report_text_raw(text, "</span>");
        }
    } else {
        gsn_report_text_raw(text, s->control && s->page ? "withheld" : DASH);
    }
    gsn_report_text_raw(text, "</td><td>");
    if (isfinite(s->loss))
        draw_interval(text, scale, s);
    gsn_report_text_raw(text, "</td><td class=\"num\">");
    gsn_report_text_number(text, s->value[0], 3);
    gsn_report_text_raw(text, "</td><td class=\"num\">");
    if (s->left_out)
        gsn_report_text_raw(text, DASH);
    else
        gsn_report_text_count(text, s->warnings);
    gsn_report_text_raw(text, "</td><td class=\"nowrap\">");
    put_day(text, s->finished);
    gsn_report_text_raw(text, "</td></tr>\n");
}

static void add_study(struct gsn_report_text *text, const struct scale *scale,
                      const struct gsn_index_study *study)
{
    const struct gsn_study_input *const input = study->input;

    gsn_report_text_raw(text, "<section>\n<h2>");
    if (study->page) {
        gsn_report_text_raw(text, "<a href=\"");
        gsn_report_text_escape(text, study->page);
        gsn_report_text_raw(text, "\">");
    }
    gsn_report_text_escape(text, *input->name ? input->name : "Of no study");
    gsn_report_text_raw(text, study->page ? "</a></h2>\n" : "</h2>\n");
    if (input->blind)
        gsn_report_text_raw(text, "<p class=\"lead\">Blind: groups and losses are shown once the "
                                  "analysis is frozen and the study is no longer blind.</p>\n");
    gsn_report_text_raw(
        text, "<div class=\"table scroll\"><table><thead><tr><th>Specimen</th><th>Group</th>"
              "<th class=\"num\">Week</th><th class=\"num\">Collagen loss</th>"
              "<th class=\"nowrap\">");
    if (scale->used) {
        gsn_report_text_number(text, scale->low, 0);
        gsn_report_text_raw(text, " to ");
        gsn_report_text_number(text, scale->high, 0);
        gsn_report_text_raw(text, " %");
    }
    gsn_report_text_raw(text, "</th><th class=\"num\">Density</th><th class=\"num\">Warnings</th>"
                              "<th>Report of</th></tr></thead><tbody>\n");
    for (size_t i = 0; i < input->specimen_count; i++)
        add_row(text, scale, &input->specimen[i]);
    gsn_report_text_raw(text, "</tbody></table></div>\n</section>\n");
}

/* ---- the bench --------------------------------------------------------------------------- */

/* gives: every specimen's value of one figure of the bench, and one more; NULL: memory ran out. */
static struct gsn_chart_dot *gather_dots(const struct gsn_index_study *study, size_t count,
                                         enum gsn_bench_figure figure, size_t specimens)
{
    struct gsn_chart_dot *dot = gsn_alloc_array(specimens + 1, sizeof *dot);
    size_t n = 0;

    for (size_t k = 0; dot && k < count; k++)
        for (size_t i = 0; i < study[k].input->specimen_count; i++) {
            const struct gsn_study_specimen *const s = &study[k].input->specimen[i];

            dot[n++] = (struct gsn_chart_dot){ s->first, s->bench[figure], s->name };
        }
    return dot;
}

/* How white, stain and registration move from day to day, which no single report can show. */
static void add_bench(struct gsn_report_text *text, const struct gsn_index_study *study,
                      size_t count, size_t specimens)
{
    static const struct {
        const char *what, *unit;
    } figure[GSN_BENCH_FIGURES] = {
        [GSN_BENCH_WHITE] = { "White of the glass", "codes" },
        [GSN_BENCH_STAIN] = { "Strength of the stain against the baseline's", "" },
        [GSN_BENCH_FLE] = { "Localisation error of a mark (FLE)", "\xC2\xB5m" },
        [GSN_BENCH_TRE] = { "Mean error of the registration (TRE)", "\xC2\xB5m" },
    };
    size_t drawn = 0;

    for (int k = 0; k < GSN_BENCH_FIGURES && !text->failed; k++) {
        gsn_auto_mem(struct gsn_chart_dot) dot =
            gather_dots(study, count, (enum gsn_bench_figure)k, specimens);
        size_t values = 0;

        for (size_t i = 0; dot && i < specimens; i++)
            values += isfinite(dot[i].value) && dot[i].when > 0;
        text->failed |= !dot;
        if (values < 2)
            continue;
        if (drawn++ == 0)
            gsn_report_text_raw(
                text,
                "<section>\n<h2>The bench, day by day</h2>\n<p class=\"lead\">One dot a "
                "specimen, on the day of its first report; the line is their median. A step or "
                "a slope in all of them is the scanner, the bath or the laser, not the "
                "animals.</p>\n<div class=\"charts\">\n");
        gsn_report_text_raw(text, "<figure class=\"drawing\">\n");
        gsn_chart_days(text, figure[k].what, figure[k].unit, dot, specimens);
        gsn_report_text_raw(text, "</figure>\n");
    }
    if (drawn > 0)
        gsn_report_text_raw(text, "</div>\n</section>\n");
}

int gsn_index_page(const struct gsn_index_study *study, size_t count, const char *version,
                   char **ret_bytes, size_t *ret_size, struct gsn_error *err)
{
    const struct scale scale = find_scale(study, count);
    const struct tally tally = count_specimens(study, count);
    gsn_auto_report_text text = { .bytes = NULL };
    const int r = gsn_html_head(&text, "Specimens and studies", "", 0, err);

    if (r < 0)
        return r;
    add_top(&text, &tally);
    if (tally.person > 0)
        add_person(&text, study, count);
    for (size_t k = 0; k < count; k++)
        add_study(&text, &scale, &study[k]);
    add_bench(&text, study, count, tally.specimens);
    if (tally.specimens == 0)
        gsn_report_text_raw(&text, "<p class=\"lead\">No specimen was taken in yet: "
                                   "<code>gieson import FOLDER</code>.</p>\n");
    gsn_report_text_raw(&text, "</main>\n<footer><p>gieson ");
    gsn_report_text_escape(&text, version);
    gsn_report_text_raw(&text, ". The page of a study says what its losses mean together; the "
                               "figure of one specimen is no answer about a treatment.</p>"
                               "</footer>\n</body>\n</html>\n");
    if (text.failed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the front page");
    gsn_report_text_give(&text, ret_bytes, ret_size);
    return GSN_OK;
}
