/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/show.h"

#include <jansson.h>
#include <string.h>

void gsn_show_done(struct gsn_show *view)
{
    gsn_specimen_row_free(view->specimen);
    gsn_panel_rows_free(view->panels);
    gsn_section_rows_free(view->sections);
    gsn_run_rows_free(view->runs);
    gsn_measure_rows_free(view->measures);
    gsn_open_panel_rows_free(view->open);
    gsn_bench_sources_free(view->sources);
    gsn_trouble_rows_free(view->troubles);
    gsn_decision_rows_free(view->decided);
    gsn_candidate_rows_free(view->candidates);
}

static int64_t expected_panels(const struct gsn_specimen_row *specimen)
{
    json_t *job = json_loads(specimen->job_json, 0, NULL);
    const json_int_t panels = json_integer_value(json_object_get(job, "panels"));

    json_decref(job);
    return strcmp(specimen->kind, "sections") == 0 ? panels : 0;
}

int gsn_show_load_sections(struct gsn_store *store, const char *name, struct gsn_show *view,
                           struct gsn_error *err)
{
    int r = gsn_specimen_get(store, name, &view->specimen, err);

    if (r >= 0)
        r = gsn_panel_list(store, view->specimen->id, &view->panels, err);
    if (r >= 0)
        r = gsn_section_list(store, view->specimen->id, &view->sections, err);
    if (r >= 0)
        r = gsn_decision_list(store, view->specimen->id, &view->decided, err);
    return r >= 0 ? gsn_candidate_list(store, view->specimen->id, &view->candidates, err) : r;
}

int gsn_show_load(struct gsn_store *store, const char *name, struct gsn_show *view,
                  struct gsn_error *err)
{
    int r = gsn_show_load_sections(store, name, view, err);

    if (r >= 0)
        r = gsn_run_list(store, view->specimen->id, &view->runs, err);
    if (r >= 0 && view->runs->count > 0)
        r = gsn_measure_list(store, view->runs->at[view->runs->count - 1].id, &view->measures, err);
    if (r >= 0)
        r = gsn_overview_panels(store, &view->open, err);
    if (r >= 0)
        r = gsn_bench_list(store, &view->sources, err);
    if (r >= 0)
        view->expected = expected_panels(view->specimen);
    return r >= 0 ? gsn_trouble_list(store, &view->troubles, err) : r;
}

int gsn_show_has_flag(const struct gsn_section_row *section, const char *flag)
{
    const size_t length = strlen(flag);

    for (const char *at = strstr(section->flags, flag); at; at = strstr(at + 1, flag))
        if ((at == section->flags || at[-1] == ' ') && (!at[length] || at[length] == ' '))
            return 1;
    return 0;
}

const struct gsn_decision_row *gsn_show_decision_on(const struct gsn_show *view, int64_t number,
                                                    int64_t slot)
{
    for (size_t i = 0; i < view->decided->count; i++)
        if (view->decided->at[i].number == number && view->decided->at[i].slot == slot)
            return &view->decided->at[i];
    return NULL;
}

int gsn_show_delivers(const struct gsn_show *view, const char *source)
{
    for (size_t i = 0; i < view->sources->count; i++)
        if (strcmp(view->sources->at[i].name, source) == 0)
            return strcmp(view->sources->at[i].expects, view->specimen->name) == 0;
    return 0;
}

int64_t gsn_show_panel_number(const struct gsn_show *view, int64_t id)
{
    for (size_t i = 0; i < view->panels->count; i++)
        if (view->panels->at[i].id == id)
            return view->panels->at[i].number;
    return 0;
}

size_t gsn_show_candidates(const struct gsn_show *view, const struct gsn_section_row *s,
                           const struct gsn_candidate_row **ret_first)
{
    size_t count = 0;

    for (size_t i = 0; i < view->candidates->count; i++) {
        const struct gsn_candidate_row *c = &view->candidates->at[i];

        if (c->panel_id == s->panel_id && c->slot == s->slot && count++ == 0)
            *ret_first = c;
    }
    return count;
}
