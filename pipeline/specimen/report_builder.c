/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the parts of a report share while it is written: its records, its texts, its warnings in the
 * order of what they cost, and the headline.
 *
 * Texts live as long as the draft. Memory that runs out is noted once and fails at the end.
 *
 * The headline is the one sentence why a figure is withheld: the first broken link of the chain,
 * never its last consequence. A figure needs, in this order: panels that came; panels that could be
 * used; sections on them; marks; enough of the region. Whoever finds the last of these missing
 * gives the reason, and here what was missing before it is put in front:
 *
 * 1. Panels that give nothing are gathered by cause: not come, lost, and refused or held for one
 *    reason. Sentences about panels differ in numbers and names, so the words without a digit are
 *    what makes two of them one reason.
 * 2. Where no panel gives anything, the panels are the whole sentence.
 * 3. Where some do, the consequence follows behind them.
 * 4. Where all do and none of them shows a section, that is the sentence.
 *
 * The same text is the verdict of the report, the line of `run`, `status` and `top` and that of the
 * journal, so it has at most the bytes that a run's row keeps. */
#include "pipeline/specimen/report_builder.h"

#include "pipeline/stain/artefact/detection.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

void gsn_builder_done(struct gsn_builder *d)
{
    for (size_t i = 0; i < d->text_count; i++)
        gsn_free(d->text[i]);
    gsn_free(d->text);
    gsn_free(d->warning);
    gsn_free(d->cost);
    gsn_free(d->exclusion);
    gsn_free(d->section);
    gsn_free(d->flag);
    gsn_free(d->candidate);
    gsn_free(d->decision);
    gsn_free(d->panel);
    gsn_free(d->input);
    for (size_t i = 0; i < GSN_LOSS_PICTURES; i++)
        gsn_free(d->loss_png[i].png);
}

int gsn_builder_init(struct gsn_builder *d, size_t sections, size_t panels, size_t inputs,
                     size_t decisions, struct gsn_error *err)
{
    *d = (struct gsn_builder){ .report = { .loss_lower = NAN, .loss_upper = NAN } };
    d->warning = gsn_alloc_array(64 + 12 * panels + decisions, sizeof *d->warning);
    d->cost = gsn_alloc_array(64 + 12 * panels + decisions, sizeof *d->cost);
    d->exclusion = gsn_alloc_array(sections + GSN_DEFECTS + panels + 1, sizeof *d->exclusion);
    d->section = gsn_alloc_array(sections + 1, sizeof *d->section);
    d->flag = gsn_alloc_array(sections + 1, sizeof *d->flag);
    d->candidate = gsn_alloc_array(sections + 1, sizeof *d->candidate);
    d->decision = gsn_alloc_array(decisions + 1, sizeof *d->decision);
    d->panel = gsn_alloc_array(panels + 1, sizeof *d->panel);
    d->input = gsn_alloc_array(inputs + 1, sizeof *d->input);
    if (d->warning && d->cost && d->exclusion && d->section && d->flag && d->candidate &&
        d->decision && d->panel && d->input)
        return GSN_OK;
    gsn_builder_done(d);
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for a report");
}

const char *gsn_builder_say(struct gsn_builder *d, const char *format, ...)
{
    char line[1024];
    va_list args;
    char *kept;

    va_start(args, format);
    (void)vsnprintf(line, sizeof line, format, args);
    va_end(args);
    if (d->text_count == d->text_room) {
        char **more = gsn_realloc_array(d->text, 2 * d->text_room + 64, sizeof *more);

        if (more) {
            d->text = more;
            d->text_room = 2 * d->text_room + 64;
        }
    }
    kept = d->text_count < d->text_room ? gsn_strdup(line) : NULL;
    if (!kept) {
        d->out_of_memory = 1;
        return "";
    }
    d->text[d->text_count++] = kept;
    return kept;
}

void gsn_builder_warn(struct gsn_builder *d, const char *sentence)
{
    gsn_builder_warn_cost(d, (struct gsn_builder_cost){ 0 }, sentence);
}

static int costs_more(struct gsn_builder_cost a, struct gsn_builder_cost b)
{
    return a.points > b.points || (!(a.points < b.points) && a.sections > b.sections);
}

void gsn_builder_warn_cost(struct gsn_builder *d, struct gsn_builder_cost cost,
                           const char *sentence)
{
    size_t at = d->warning_count++;

    for (; at > 0 && costs_more(cost, d->cost[at - 1]); at--) {
        d->warning[at] = d->warning[at - 1];
        d->cost[at] = d->cost[at - 1];
    }
    d->warning[at] = sentence;
    d->cost[at] = cost;
}

void gsn_builder_value(struct gsn_report_value *rows, size_t *count, const char *name, double value,
                       const char *unit)
{
    rows[(*count)++] = (struct gsn_report_value){ .name = name, .value = value, .unit = unit };
}

void gsn_builder_text(struct gsn_report_value *rows, size_t *count, const char *name,
                      const char *text)
{
    rows[(*count)++] = (struct gsn_report_value){ .name = name, .value = NAN, .text = text };
}

/* ---- the headline ---------------------------------------------------------------------------- */

enum { MOST_BYTES = sizeof((struct gsn_specimen_result *)NULL)->message - 1, MOST_CAUSES = 6 };

/* A panel that gives nothing, and how many others do for the same reason. */
struct cause {
    const char *state, *message; /* message: NULL where there is no file */
    const char *file;
    unsigned number;
    size_t count;
};

/* ---- one reason -------------------------------------------------------------------------- */

/* The next word without a digit, from *at on; its length, 0: none is left. */
static size_t next_word(const char **at)
{
    for (;;) {
        size_t length, digits;

        *at += strspn(*at, " ");
        length = strcspn(*at, " ");
        digits = strcspn(*at, "0123456789");
        if (length == 0 || digits >= length)
            return length;
        *at += length;
    }
}

int gsn_builder_same_reason(const char *a, const char *b)
{
    for (;;) {
        const size_t length = next_word(&a);

        if (next_word(&b) != length || strncmp(a, b, length) != 0)
            return 0;
        if (length == 0)
            return 1;
        a += length;
        b += length;
    }
}

/* ---- the panels that give nothing ---------------------------------------------------------- */

static int is_lost(const struct gsn_specimen *specimen, unsigned number)
{
    for (size_t i = 0; i < specimen->decision_count; i++)
        if (specimen->decision[i].panel == number && specimen->decision[i].slot == 0 &&
            strcmp(specimen->decision[i].answer, "lost") == 0)
            return 1;
    return 0;
}

static int is_used(const struct gsn_report_inputs *e, unsigned number)
{
    for (size_t i = 0; e->reconstruction && i < e->reconstruction->poses.section_count; i++)
        if (e->reconstruction->poses.section[i].panel == number &&
            (e->reconstruction->densities.section[i].state == GSN_SECTION_USED ||
             e->reconstruction->densities.section[i].state == GSN_SECTION_DOUBTFUL))
            return 1;
    return 0;
}

/* Why a panel's number gives nothing; state is NULL where it gives something. */
static struct cause cause_of(const struct gsn_report_inputs *e, unsigned number)
{
    const struct gsn_specimen *specimen = e->specimen;
    const struct gsn_specimen_panel *panel = NULL;
    struct cause cause = { .number = number, .count = 1 };

    for (size_t i = 0; i < specimen->panel_count; i++)
        if (specimen->panel[i].number == number && (!panel || specimen->panel[i].section_count > 0))
            panel = &specimen->panel[i];
    if (!panel) {
        cause.state = is_lost(specimen, number) ? "lost" : "not come";
    } else if (panel->section_count == 0) {
        cause.state = strcmp(panel->state, "refused") == 0 ? "refused" : "held";
        cause.message = panel->message;
        cause.file = panel->file;
    } else if (e->reconstruction && e->reconstruction->poses.solved && !is_used(e, number)) {
        cause.state = "without a section that is used";
        cause.file = panel->file;
    }
    return cause;
}

static int is_same(const struct cause *a, const struct cause *b)
{
    return strcmp(a->state, b->state) == 0 &&
           (a->message && b->message ? gsn_builder_same_reason(a->message, b->message)
                                     : !a->message == !b->message);
}

/* In cause, those of most panels first; returns how many panels they are. */
static size_t gather_causes(const struct gsn_report_inputs *e, unsigned panels, struct cause *cause,
                            size_t *ret_causes)
{
    size_t causes = 0, silent = 0;

    for (unsigned number = 1; number <= panels; number++) {
        const struct cause next = cause_of(e, number);
        size_t i = 0;

        if (!next.state)
            continue;
        silent++;
        while (i < causes && !is_same(&cause[i], &next))
            i++;
        if (i == causes)
            cause[causes++] = next;
        else
            cause[i].count++;
        for (; i > 0 && cause[i].count > cause[i - 1].count; i--) {
            const struct cause kept = cause[i];

            cause[i] = cause[i - 1];
            cause[i - 1] = kept;
        }
    }
    *ret_causes = causes;
    return silent;
}

static unsigned panels_of(const struct gsn_specimen *specimen)
{
    unsigned panels = specimen->protocol->panels;

    for (size_t i = 0; i < specimen->panel_count; i++)
        if (specimen->panel[i].number > panels)
            panels = specimen->panel[i].number;
    return panels;
}

/* ---- the sentence ------------------------------------------------------------------------ */

struct line {
    char text[MOST_BYTES + 1];
    size_t used;
};

static void add_text(struct line *line, const char *text)
{
    const int put = snprintf(line->text + line->used, sizeof line->text - line->used, "%s", text);

    line->used += (size_t)put;
    if (line->used >= sizeof line->text) {
        line->used = sizeof line->text - 1;
        memcpy(line->text + line->used - 3, "...", 3);
    }
}

static void add_cause(struct line *line, const struct cause *cause, unsigned panels,
                      struct gsn_builder *d)
{
    const char *glue = line->used ? "; " : "";

    if (cause->count == 1 && panels > 1)
        add_text(line, gsn_builder_say(d, "%spanel %u of %u %s%s%s%s", glue, cause->number, panels,
                                       cause->state, cause->file ? " (" : "",
                                       cause->file ? cause->file : "", cause->file ? ")" : ""));
    else
        add_text(line, gsn_builder_say(d, "%s%zu of %u panels %s", glue, cause->count, panels,
                                       cause->state));
    if (cause->message && cause->message[0]) {
        add_text(line, ": ");
        add_text(line, cause->message);
    } else if (strcmp(cause->state, "not come") == 0) {
        add_text(line, ": import what is missing, or say `gieson decide SPECIMEN PANEL lost`");
    }
}

static size_t count_sections(const struct gsn_reconstruction *a)
{
    size_t count = 0;

    for (size_t i = 0; i < a->poses.section_count; i++)
        count += a->densities.section[i].state != GSN_SECTION_EMPTY &&
                 a->densities.section[i].state != GSN_SECTION_MISSING;
    return count;
}

const char *gsn_builder_headline(const struct gsn_report_inputs *e, struct gsn_builder *d,
                                 const char *why)
{
    const unsigned panels = panels_of(e->specimen);
    gsn_auto_mem(struct cause) cause = NULL;
    struct line line = { .used = 0 };
    size_t silent, causes;

    if (e->specimen->protocol->kind != GSN_KIND_SECTIONS ||
        (e->analysis && (!e->reconstruction || !e->reconstruction->densities.grid)))
        return why;
    if (e->specimen->panel_count == 0)
        return "no panel has come: put the pictures of the panels beside job.json and import the "
               "folder again";
    cause = gsn_alloc_array(panels + 1, sizeof *cause);
    if (!cause) {
        d->out_of_memory = 1;
        return why;
    }
    silent = gather_causes(e, panels, cause, &causes);
    for (size_t i = 0; i < causes && i < MOST_CAUSES; i++)
        add_cause(&line, &cause[i], panels, d);
    if (silent == panels && causes > 0 && !e->analysis)
        return gsn_builder_say(d, "%s", line.text);
    if (e->reconstruction && count_sections(e->reconstruction) == 0)
        why = "no section was found on any panel: look at them, and at \"layout\" and \"px_um\" in "
              "job.json";
    add_text(&line, causes > 0 ? "; so " : "");
    add_text(&line, why);
    return gsn_builder_say(d, "%s", line.text);
}

const char *gsn_builder_withheld(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    return e->withheld ? gsn_builder_headline(e, d, e->withheld) : NULL;
}
