/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/summary_draft.h"

#include "pipeline/core/mem.h"

#include <math.h>

size_t gsn_draft_panel_zeros(const struct gsn_assembly *a, double ret_zero[GSN_LEVEL_PANELS])
{
    size_t count = 0;

    for (size_t i = 0; i < a->panel_count && count < GSN_LEVEL_PANELS; i++)
        if (a->panel[i].levelled)
            ret_zero[count++] = -a->panel[i].level.offset / a->panel[i].level.gain;
    return count;
}

/* A control's panels, as this specimen's stain shows them; returns their number, 0 where too little
 * tissue tells how that is. */
static size_t zeros_of(const struct gsn_specimen_control *control, const struct gsn_levelling *l,
                       const struct gsn_level *spread, double *ret_zero)
{
    struct gsn_level_link link;

    if (gsn_level_between(&l->tissues, &control->tissues, spread, &link, NULL) < 0)
        return 0;
    for (size_t p = 0; p < control->panels; p++)
        ret_zero[p] = link.gain * control->zero[p] + link.offset;
    return control->panels;
}

void gsn_draft_find_zero(const struct gsn_evidence *e, const struct gsn_level *spread,
                         struct gsn_draft *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    gsn_auto_mem(double) zero =
        gsn_alloc_array((b->specimens + 1) * GSN_LEVEL_PANELS, sizeof *zero);
    size_t own, all;

    if (!zero) {
        d->out_of_memory = 1;
        return;
    }
    own = all = gsn_draft_panel_zeros(e->assembly, zero);
    for (size_t i = 0; i < b->specimens; i++)
        all += zeros_of(&b->control[i], &e->assembly->levelling, spread, zero + all);
    d->zero = gsn_level_zero_of(zero, all);
    /* What the link is off by, all of the controls' panels are. */
    if (d->zero.error > 0)
        d->zero.error = hypot(d->zero.error, (double)(all - own) / (double)all *
                                                 gsn_level_link_error(&d->link, d->zero.at));
}
