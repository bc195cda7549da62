/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/summary_draft.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

void gsn_draft_done(struct gsn_draft *d)
{
    for (size_t i = 0; i < d->text_count; i++)
        gsn_free(d->text[i]);
    gsn_free(d->text);
    gsn_free(d->warning);
    gsn_free(d->exclusion);
    gsn_free(d->section);
    gsn_free(d->flag);
    gsn_free(d->candidate);
    gsn_free(d->decision);
    gsn_free(d->panel);
    gsn_free(d->input);
}

int gsn_draft_init(struct gsn_draft *d, size_t sections, size_t panels, size_t inputs,
                   size_t decisions, struct gsn_error *err)
{
    *d = (struct gsn_draft){ .report = { .loss_lower = NAN, .loss_upper = NAN } };
    d->warning = gsn_alloc_array(64 + 12 * panels + decisions, sizeof *d->warning);
    d->exclusion = gsn_alloc_array(sections + GSN_DEFECTS + panels + 1, sizeof *d->exclusion);
    d->section = gsn_alloc_array(sections + 1, sizeof *d->section);
    d->flag = gsn_alloc_array(sections + 1, sizeof *d->flag);
    d->candidate = gsn_alloc_array(sections + 1, sizeof *d->candidate);
    d->decision = gsn_alloc_array(decisions + 1, sizeof *d->decision);
    d->panel = gsn_alloc_array(panels + 1, sizeof *d->panel);
    d->input = gsn_alloc_array(inputs + 1, sizeof *d->input);
    if (d->warning && d->exclusion && d->section && d->flag && d->candidate && d->decision &&
        d->panel && d->input)
        return GSN_OK;
    gsn_draft_done(d);
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for a report");
}

const char *gsn_draft_say(struct gsn_draft *d, const char *format, ...)
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

void gsn_draft_warn(struct gsn_draft *d, const char *sentence)
{
    d->warning[d->warning_count++] = sentence;
}

void gsn_draft_value(struct gsn_report_value *rows, size_t *count, const char *name, double value,
                     const char *unit)
{
    rows[(*count)++] = (struct gsn_report_value){ .name = name, .value = value, .unit = unit };
}

void gsn_draft_text(struct gsn_report_value *rows, size_t *count, const char *name,
                    const char *text)
{
    rows[(*count)++] = (struct gsn_report_value){ .name = name, .value = NAN, .text = text };
}
