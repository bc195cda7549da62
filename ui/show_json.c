/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/show.h"

#include "ui/text.h"

#include <math.h>

static json_t *panels_json(const struct gsn_show *view)
{
    json_t *array = json_array();

    for (size_t i = 0; i < view->panels->count; i++) {
        const struct gsn_panel_row *p = &view->panels->at[i];
        gsn_auto_mem(char) action = gsn_show_panel_action(view, p);

        (void)json_array_append_new(
            array, json_pack("{s:I, s:o, s:s, s:s, s:s, s:o, s:o}", "number", (json_int_t)p->number,
                             "file", gsn_text_json(p->file_name), "sha256", p->sha256, "state",
                             p->state, "code", p->code, "message", gsn_text_json(p->message),
                             "action", gsn_text_json(action ? action : "")));
    }
    return array;
}

static json_t *delivered_json(const struct gsn_show *view)
{
    json_t *array = json_array();

    for (size_t i = 0; i < view->sources->count; i++)
        if (gsn_show_delivers(view, view->sources->at[i].name))
            (void)json_array_append_new(array, gsn_text_json(view->sources->at[i].name));
    return array;
}

static json_t *candidates_json(const struct gsn_show *view, const struct gsn_section_row *s)
{
    const struct gsn_candidate_row *c = NULL;
    const size_t count = gsn_show_candidates(view, s, &c);
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++)
        (void)json_array_append_new(
            array,
            json_pack("{s:I, s:b, s:o, s:o, s:b, s:b, s:o}", "number", (json_int_t)c[i].number,
                      "chosen", (int)c[i].chosen, "share", gsn_ui_number(c[i].share), "error_um",
                      gsn_ui_number(c[i].error_um), "flipped", (int)c[i].flipped, "rotated180",
                      (int)c[i].rotated180, "differs", gsn_text_json(c[i].differs)));
    return array;
}

static json_t *sections_json(const struct gsn_show *view)
{
    json_t *array = json_array();

    for (size_t i = 0; i < view->sections->count; i++) {
        const struct gsn_section_row *s = &view->sections->at[i];
        gsn_auto_mem(char) action = gsn_show_section_action(view, s);

        (void)json_array_append_new(
            array,
            json_pack("{s:o, s:I, s:s, s:s, s:o, s:o}", "serial",
                      s->serial ? json_integer((json_int_t)s->serial - 1) : json_null(), "slot",
                      (json_int_t)s->slot - 1, "state", s->state, "flags", s->flags, "candidates",
                      candidates_json(view, s), "action", gsn_text_json(action ? action : "")));
    }
    return array;
}

static json_t *runs_json(const struct gsn_show *view)
{
    json_t *array = json_array();

    for (size_t i = 0; i < view->runs->count; i++) {
        const struct gsn_run_row *run = &view->runs->at[i];

        (void)json_array_append_new(
            array, json_pack("{s:I, s:s, s:o, s:s, s:s, s:s}", "run", (json_int_t)run->id, "state",
                             run->state, "message", gsn_text_json(run->message), "key", run->key,
                             "version", run->version, "event_head", run->event_head));
    }
    return array;
}

static json_t *measures_json(const struct gsn_show *view)
{
    json_t *array = json_array();

    for (size_t i = 0; view->measures && i < view->measures->count; i++) {
        const struct gsn_measure_row *m = &view->measures->at[i];
        json_t *row = json_pack("{s:s, s:o, s:s}", "name", m->name, "value",
                                gsn_ui_number(m->value), "unit", m->unit);

        if (!isnan(m->lower)) {
            (void)json_object_set_new(row, "lower", json_real(m->lower));
            (void)json_object_set_new(row, "upper", json_real(m->upper));
        }
        (void)json_array_append_new(array, row);
    }
    return array;
}

json_t *gsn_show_json(const struct gsn_show *view)
{
    return json_pack("{s:o, s:s, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "specimen",
                     gsn_text_json(view->specimen->name), "kind", view->specimen->kind, "group",
                     gsn_text_json(view->specimen->group), "baseline",
                     gsn_text_json(view->specimen->baseline), "delivered_by", delivered_json(view),
                     "panels", panels_json(view), "sections", sections_json(view), "runs",
                     runs_json(view), "measures", measures_json(view));
}
