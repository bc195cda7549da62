/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/show.h"

#include "storage/advice.h"

#include "ui/text.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* The sources that deliver this specimen, and what they could not take in. */
static void print_sources(const struct gsn_ui *ui, const struct gsn_show *view)
{
    for (size_t i = 0; i < view->sources->count; i++) {
        const struct gsn_bench_source *source = &view->sources->at[i];

        if (gsn_show_delivers(view, source->name))
            gsn_text_line(stdout, "  delivered by %s, which is %s", source->name, source->state);
    }
    for (size_t i = 0; i < view->troubles->count; i++) {
        const struct gsn_trouble_row *trouble = &view->troubles->at[i];

        if (!gsn_show_delivers(view, trouble->source))
            continue;
        gsn_text_line(stdout, "  trouble  %s", trouble->name);
        gsn_ui_wrap(ui, 4, trouble->reason);
        gsn_ui_next(ui, trouble->action, "");
    }
}

static void print_panels(const struct gsn_ui *ui, const struct gsn_show *view)
{
    for (size_t i = 0; i < view->panels->count; i++) {
        const struct gsn_panel_row *p = &view->panels->at[i];
        gsn_auto_mem(char) action = gsn_show_panel_action(view, p);

        gsn_text_line(stdout, "  panel %lld  %-10s %s", (long long)p->number, p->state,
                      p->file_name);
        if (p->message[0])
            gsn_ui_wrap(ui, 4, p->message);
        if (action)
            gsn_ui_next(ui, action, "");
    }
}

static void print_missing(const struct gsn_ui *ui, int64_t number, const char *action)
{
    gsn_auto_mem(char) advice = gsn_advice(ui->store_dir, action);

    gsn_text_line(stdout, "  panel %lld  has not come", (long long)number);
    gsn_text_line(stdout, "    next: import it; where it is lost: %s", advice ? advice : action);
}

/* Panels that the job states and that never came. */
static void print_absent(const struct gsn_ui *ui, const struct gsn_show *view)
{
    for (int64_t number = 1; number <= view->expected; number++) {
        const struct gsn_decision_row *decided = gsn_show_decision_on(view, number, 0);
        gsn_auto_mem(char) action = gsn_show_decide_command(view, number, 0, "lost");
        int is_there = 0;

        for (size_t i = 0; i < view->panels->count; i++)
            is_there |= view->panels->at[i].number == number;
        if (is_there)
            continue;
        if (decided && strcmp(decided->answer, "lost") == 0)
            gsn_text_line(stdout, "  panel %lld  lost, as %s said%s%s", (long long)number,
                          decided->actor, decided->reason[0] ? ": " : "", decided->reason);
        else
            print_missing(ui, number, action ? action : "");
    }
}

/* What may be said instead. */
static const char *otherwise(const struct gsn_section_row *s)
{
    if (gsn_show_has_flag(s, "touching"))
        return ", or hold";
    return gsn_show_has_flag(s, "scrap") ? ", or dismiss" : "";
}

/* gives: a dash for what is not known. */
static char *share_text(double share)
{
    if (isnan(share))
        return gsn_strdup("-");
    return share < 0.001 ? gsn_strdup("< 0.1 %") : gsn_format("%.1f %%", 100 * share);
}

static char *error_text(double error_um)
{
    return isnan(error_um) ? gsn_strdup("-") : gsn_format("%.1f um", error_um);
}

static void print_candidate(const struct gsn_candidate_row *c)
{
    gsn_auto_mem(char) likely = share_text(c->share);
    gsn_auto_mem(char) error = error_text(c->error_um);

    gsn_text_line(stdout, "    %c %2lld  %8s  %9s  %-4s  %-6s  %s", c->chosen ? '*' : ' ',
                  (long long)c->number, likely ? likely : "", error ? error : "",
                  c->flipped ? "down" : "up", c->rotated180 ? "yes" : "no", c->differs);
}

static void print_choice(const struct gsn_show *view, const struct gsn_section_row *s, int is_used)
{
    const struct gsn_decision_row *d =
        gsn_show_decision_on(view, gsn_show_panel_number(view, s->panel_id), s->slot);

    if (!d || strncmp(d->answer, "pose ", 5) != 0)
        return;
    if (gsn_show_has_flag(s, "decision-void"))
        gsn_text_line(stdout, "    what %s chose is not found there any more and is not used",
                      d->actor);
    else if (is_used)
        gsn_text_line(stdout, "    chosen by %s%s%s", d->actor, d->reason[0] ? ": " : "",
                      d->reason);
    else if (gsn_show_has_flag(s, "decided"))
        gsn_text_line(stdout, "    what %s chose does not fit the stack and is not used", d->actor);
    else
        gsn_text_line(stdout, "    %.*s, as %s said; `gieson run` works it",
                      (int)strcspn(d->answer + 5, " ") + 5, d->answer, d->actor);
}

/* The poses that the section may have, and what was chosen of them. */
static void print_candidates(const struct gsn_show *view, const struct gsn_section_row *s)
{
    const struct gsn_candidate_row *c = NULL;
    const size_t count = gsn_show_candidates(view, s, &c);
    int is_used = 0;

    if (count > 0)
        gsn_text_line(stdout, "    pose    likely      error  side  turned");
    for (size_t i = 0; i < count; i++) {
        print_candidate(&c[i]);
        is_used |= c[i].chosen != 0;
    }
    print_choice(view, s, is_used);
}

/* A panel's look may find marks that the stack or the neighbours' tissue contradicts. */
static const char *state_of(const struct gsn_show *view, const struct gsn_section_row *s)
{
    const struct gsn_candidate_row *first;

    return strcmp(s->state, "found") == 0 && gsn_show_candidates(view, s, &first) > 0
               ? "found, but its marks are in doubt"
               : s->state;
}

/* Named as `decide` takes it, PANEL.SLOT. Serial number 0: a piece that lies in no slot. */
static void print_section(const struct gsn_ui *ui, const struct gsn_show *view,
                          const struct gsn_section_row *s)
{
    gsn_auto_mem(char) action = gsn_show_section_action(view, s);

    if (s->serial == 0)
        gsn_text_line(stdout, "  a piece beside the slots of panel %lld  %s  %s",
                      (long long)gsn_show_panel_number(view, s->panel_id), s->state, s->flags);
    else
        gsn_text_line(stdout, "  section %lld.%lld  %s  %s",
                      (long long)gsn_show_panel_number(view, s->panel_id), (long long)s->slot,
                      state_of(view, s), s->flags);
    print_candidates(view, s);
    if (action)
        gsn_ui_next(ui, action, otherwise(s));
}

/* Only what a person should look at, or did; found and empty slots are counted. */
static void print_sections(const struct gsn_ui *ui, const struct gsn_show *view)
{
    size_t found = 0, empty = 0;

    for (size_t i = 0; i < view->sections->count; i++) {
        const struct gsn_section_row *s = &view->sections->at[i];
        const struct gsn_candidate_row *first;

        found += strcmp(s->state, "found") == 0;
        empty += strcmp(s->state, "empty") == 0;
        if ((strcmp(s->state, "found") != 0 && strcmp(s->state, "empty") != 0) ||
            gsn_show_candidates(view, s, &first) > 0 || gsn_show_has_flag(s, "decision-void"))
            print_section(ui, view, s);
    }
    if (view->sections->count > 0)
        (void)printf("  %zu sections found, %zu slots empty\n", found, empty);
}

static void print_runs(const struct gsn_ui *ui, const struct gsn_show *view)
{
    for (size_t i = 0; i < view->runs->count; i++) {
        const struct gsn_run_row *run = &view->runs->at[i];
        gsn_auto_mem(char) line = gsn_format("run %lld  %s%s%s", (long long)run->id, run->state,
                                             run->message[0] ? ": " : "", run->message);

        gsn_text_wrap(stdout, 2, ui->width, line ? line : "");
    }
    for (size_t i = 0; view->measures && i < view->measures->count; i++) {
        const struct gsn_measure_row *m = &view->measures->at[i];

        gsn_auto_mem(char) bounds =
            isnan(m->lower) ? gsn_strdup("") : gsn_format("  (%.6g to %.6g)", m->lower, m->upper);
        gsn_auto_mem(char) line =
            gsn_format("%-18s %.6g %s%s", m->name, m->value, m->unit, bounds ? bounds : "");

        gsn_text_wrap(stdout, 4, ui->width, line ? line : m->name);
    }
}

void gsn_show_print(const struct gsn_ui *ui, const struct gsn_show *view)
{
    const struct gsn_specimen_row *s = view->specimen;

    gsn_text_line(stdout, "%s  (%s)", s->name, s->kind);
    if (s->group[0] || s->study[0])
        gsn_text_line(stdout, "  study %s, group %s, animal %s", s->study[0] ? s->study : "-",
                      s->group[0] ? s->group : "-", s->animal[0] ? s->animal : "-");
    if (s->baseline[0])
        gsn_text_line(stdout, "  baseline %s", s->baseline);
    print_sources(ui, view);
    print_panels(ui, view);
    print_absent(ui, view);
    print_sections(ui, view);
    print_runs(ui, view);
}
