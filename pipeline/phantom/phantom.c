/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A specimen as a folder: panels, calibration, truth, and job.json last, so that a folder that has
 * one is complete. Failure: memory and disk; what was written stays. Cost: drawing the panels. */
#include "pipeline/phantom/phantom.h"

#include "pipeline/core/file.h"
#include "pipeline/phantom/calibration.h"
#include "pipeline/phantom/delivery.h"
#include "pipeline/phantom/panel.h"
#include "pipeline/phantom/truth.h"

/* File i of the delivery; ret_extent is of its panel. */
static int write_panel(const struct gsn_phantom_plan *plan, int i, unsigned threads,
                       const char *folder, struct gsn_phantom_extent *ret_extent,
                       struct gsn_error *err)
{
    gsn_auto_mem(char) name = gsn_phantom_delivery_name(plan, i);
    gsn_auto(gsn_image) image = NULL;
    gsn_auto_phantom_buffer file = { 0 };
    int r;

    if (!name)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for file %d", i + 1);
    r = gsn_phantom_panel_draw(plan, &plan->file[i], threads, &image, ret_extent, err);
    if (r < 0)
        return r;
    r = gsn_phantom_delivery_encode(plan, &plan->file[i], image, &file, err);
    if (r < 0)
        return gsn_fail_at(err, "%s", name);
    return gsn_phantom_buffer_write(&file, folder, name, err);
}

int gsn_phantom_make(const struct gsn_phantom_plan *plan, int with_density, unsigned threads,
                     const char *folder, const struct gsn_progress *progress, struct gsn_error *err)
{
    const size_t panels = (size_t)plan->files, steps = panels + 2;
    struct gsn_phantom_extent extent[GSN_PHANTOM_SECTIONS] = { 0 };
    gsn_auto_mem(char) truth = gsn_format("%s/truth", folder);
    int r;

    if (!truth)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", folder);
    r = gsn_file_mkdir(truth, err);
    if (r < 0)
        return r;
    for (int i = 0; i < plan->files; i++) {
        const int first = (plan->file[i].panel - 1) * plan->slots;

        gsn_progress_say(progress, "drawing panels", (size_t)i, steps);
        r = write_panel(plan, i, threads, folder, &extent[first], err);
        if (r < 0)
            return r;
    }
    r = gsn_phantom_calibration_write(plan, threads, folder, err);
    if (r < 0)
        return r;
    gsn_progress_say(progress, "writing the truth", panels, steps);
    r = gsn_phantom_write_truth(plan, extent, with_density, threads, truth, err);
    if (r < 0)
        return r;
    gsn_progress_say(progress, "writing the job", panels + 1, steps);
    r = gsn_phantom_write_job(plan, folder, err);
    if (r < 0)
        return r;
    gsn_progress_say(progress, "done", steps, steps);
    return GSN_OK;
}
