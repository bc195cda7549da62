/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/folder.h"

#include "pipeline/core/robust.h"
#include "pipeline/folder_parts.h"

#include <assert.h>

static double median_search_ms(const struct gsn_section_folder *folder)
{
    gsn_auto_mem(double) ms = gsn_alloc_array(folder->stack->count, sizeof *ms);
    size_t n = 0;

    for (size_t i = 0; ms && i < folder->stack->count; i++)
        if (folder->work[i].spots)
            ms[n++] = folder->work[i].search_ms;
    return n > 0 ? gsn_median(ms, n) : 0;
}

/* Why there may be no marks, when they are not found. */
static int fail_without_marks(const struct gsn_section_folder *folder, const char *why,
                              struct gsn_error *err)
{
    const double least_um = GSN_MARK_LEAST_PX * folder->px_um;

    if (!(folder->options->px_um > 0 && least_um > GSN_MARK_LEAST_UM))
        return gsn_fail(err, GSN_E_MARKERS, "%s", why);
    return gsn_fail(err, GSN_E_MARKERS,
                    "%s; at %.4g um a pixel marks of less than %.3g um radius (%g pixels; holes: "
                    "%.3g um) may not be told from grain: scan finer if they are so small",
                    why, folder->px_um, least_um, GSN_MARK_LEAST_PX, 2 * least_um);
}

static int run(struct gsn_section_folder *folder, const char *dir, struct gsn_error *err)
{
    struct gsn_error own = { 0 };
    double began;
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < folder->stack->count; i++)
        r = gsn_folder_search(folder, dir, i, err);
    began = gsn_folder_cpu_ms();
    if (r >= 0)
        r = gsn_folder_choose_marks(folder, &own);
    if (r >= 0 || r == GSN_E_MARKERS)
        r = gsn_folder_choose_burns(folder, dir, r, &own);
    if (r >= 0)
        r = gsn_folder_solve(folder, &own);
    if (r == GSN_E_MARKERS && folder->options->by_tissue && !folder->options->mark)
        r = GSN_OK;
    else if (r == GSN_E_MARKERS)
        r = fail_without_marks(folder, own.text, err);
    else if (r < 0 && own.text[0])
        r = gsn_fail(err, r, "%s", own.text);
    if (r >= 0 && folder->options->by_tissue)
        r = gsn_folder_lay_by_tissue(folder, err);
    folder->stack->cpu_ms =
        median_search_ms(folder) + (gsn_folder_cpu_ms() - began) / (double)folder->stack->count;
    return r;
}

int gsn_folder_register(const char *dir, const struct gsn_folder_options *options,
                        struct gsn_folder_stack **ret_stack, struct gsn_error *err)
{
    gsn_auto(gsn_folder_stack) stack = gsn_alloc_array(1, sizeof *stack);
    gsn_auto_mem(struct gsn_folder_work) work = NULL;
    struct gsn_section_folder folder = { .options = options, .stack = stack };
    int r;

    assert(dir && options && ret_stack);

    if (!stack)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", dir);
    r = gsn_folder_list(dir, stack, err);
    if (r < 0)
        return r;
    work = gsn_alloc_array(stack->count, sizeof *work);
    if (!work)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", dir);
    folder.work = work;
    folder.px_um = options->px_um > 0 ? options->px_um : GSN_FOLDER_PX_UM;
    folder.unit = options->px_um > 0 ? 1 : GSN_FOLDER_PX_UM;
    r = run(&folder, dir, err);
    for (size_t i = 0; i < stack->count; i++) {
        gsn_mark_spots_free(work[i].spots);
        gsn_tissue_free(work[i].tissue);
    }
    if (r < 0)
        return r;
    *ret_stack = gsn_steal(&stack);
    return GSN_OK;
}

void gsn_folder_stack_free(struct gsn_folder_stack *stack)
{
    if (!stack)
        return;
    for (size_t i = 0; stack->section && i < stack->count; i++)
        gsn_free(stack->section[i].file);
    gsn_free(stack->section);
    gsn_free(stack);
}
