/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The one sentence why a figure is withheld: the first broken link of the chain, never its last
 * consequence.
 *
 * A figure needs, in this order: panels that came; panels that could be used; sections on them;
 * marks; enough of the region. Whoever finds the last of these missing says so (why), and here what
 * was missing before it is put in front:
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
#include "pipeline/summary_draft.h"

#include <stdio.h>
#include <string.h>

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

int gsn_draft_same_reason(const char *a, const char *b)
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

static int is_used(const struct gsn_evidence *e, unsigned number)
{
    for (size_t i = 0; e->assembly && i < e->assembly->section_count; i++)
        if (e->assembly->section[i].panel == number &&
            (e->assembly->section[i].state == GSN_SECTION_USED ||
             e->assembly->section[i].state == GSN_SECTION_DOUBTFUL))
            return 1;
    return 0;
}

/* Why a panel's number gives nothing; state is NULL where it gives something. */
static struct cause cause_of(const struct gsn_evidence *e, unsigned number)
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
    } else if (e->assembly && e->assembly->solved && !is_used(e, number)) {
        cause.state = "without a section that is used";
        cause.file = panel->file;
    }
    return cause;
}

static int is_same(const struct cause *a, const struct cause *b)
{
    return strcmp(a->state, b->state) == 0 &&
           (a->message && b->message ? gsn_draft_same_reason(a->message, b->message)
                                     : !a->message == !b->message);
}

/* In cause, those of most panels first; returns how many panels they are. */
static size_t gather(const struct gsn_evidence *e, unsigned panels, struct cause *cause,
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

static void add(struct line *line, const char *text)
{
    const int put = snprintf(line->text + line->used, sizeof line->text - line->used, "%s", text);

    line->used += (size_t)put;
    if (line->used >= sizeof line->text) {
        line->used = sizeof line->text - 1;
        memcpy(line->text + line->used - 3, "...", 3);
    }
}

static void add_cause(struct line *line, const struct cause *cause, unsigned panels,
                      struct gsn_draft *d)
{
    const char *glue = line->used ? "; " : "";

    if (cause->count == 1 && panels > 1)
        add(line, gsn_draft_say(d, "%spanel %u of %u %s%s%s%s", glue, cause->number, panels,
                                cause->state, cause->file ? " (" : "",
                                cause->file ? cause->file : "", cause->file ? ")" : ""));
    else
        add(line,
            gsn_draft_say(d, "%s%zu of %u panels %s", glue, cause->count, panels, cause->state));
    if (cause->message && cause->message[0]) {
        add(line, ": ");
        add(line, cause->message);
    } else if (strcmp(cause->state, "not come") == 0) {
        add(line, ": import what is missing, or say `gieson decide SPECIMEN PANEL lost`");
    }
}

static size_t count_sections(const struct gsn_assembly *a)
{
    size_t count = 0;

    for (size_t i = 0; i < a->section_count; i++)
        count +=
            a->section[i].state != GSN_SECTION_EMPTY && a->section[i].state != GSN_SECTION_MISSING;
    return count;
}

const char *gsn_draft_headline(const struct gsn_evidence *e, struct gsn_draft *d, const char *why)
{
    const unsigned panels = panels_of(e->specimen);
    gsn_auto_mem(struct cause) cause = NULL;
    struct line line = { .used = 0 };
    size_t silent, causes;

    if (e->specimen->protocol->kind != GSN_KIND_SECTIONS ||
        (e->account && (!e->assembly || !e->assembly->grid)))
        return why;
    if (e->specimen->panel_count == 0)
        return "no panel has come: put the pictures of the panels beside job.json and import the "
               "folder again";
    cause = gsn_alloc_array(panels + 1, sizeof *cause);
    if (!cause) {
        d->out_of_memory = 1;
        return why;
    }
    silent = gather(e, panels, cause, &causes);
    for (size_t i = 0; i < causes && i < MOST_CAUSES; i++)
        add_cause(&line, &cause[i], panels, d);
    if (silent == panels && causes > 0 && !e->account)
        return gsn_draft_say(d, "%s", line.text);
    if (e->assembly && count_sections(e->assembly) == 0)
        why = "no section was found on any panel: look at them, and at \"layout\" and \"px_um\" in "
              "job.json";
    add(&line, causes > 0 ? "; so " : "");
    add(&line, why);
    return gsn_draft_say(d, "%s", line.text);
}

const char *gsn_draft_withheld(const struct gsn_evidence *e, struct gsn_draft *d)
{
    return e->withheld ? gsn_draft_headline(e, d, e->withheld) : NULL;
}
