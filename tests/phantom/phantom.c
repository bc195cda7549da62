/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/phantom/phantom.h"

#include "pipeline/core/file.h"
#include "tests/phantom/panel.h"
#include "tests/phantom/truth.h"
#include "tests/phantom/writer.h"

#include <string.h>

static int encode(const struct gsn_phantom_plan *plan, const struct gsn_image *image,
                  struct gsn_phantom_buffer *ret_file, struct gsn_error *err)
{
    const char *extension = plan->level->extension;

    if (strcmp(extension, "jpg") == 0)
        return gsn_phantom_jpeg(image, plan->px_um, plan->level->quality, ret_file, err);
    return strcmp(extension, "png") == 0 ? gsn_phantom_png(image, plan->px_um, ret_file, err)
                                         : gsn_phantom_tiff(image, plan->px_um, ret_file, err);
}

static int write_panel(const struct gsn_phantom_plan *plan, int panel, unsigned threads,
                       const char *folder, struct gsn_phantom_extent *ret_extent,
                       struct gsn_error *err)
{
    gsn_auto_mem(char) name = gsn_format(GSN_PHANTOM_STUDY "-%s-P%02d.%s", plan->specimen->name,
                                         panel, plan->level->extension);
    gsn_auto(gsn_image) image = NULL;
    gsn_auto_phantom_buffer file = { 0 };
    int r;

    if (!name)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for panel %d", panel);
    r = gsn_phantom_panel_draw(plan, panel, threads, &image, ret_extent, err);
    if (r < 0)
        return r;
    r = encode(plan, image, &file, err);
    if (r < 0)
        return gsn_fail_at(err, "%s", name);
    return gsn_phantom_buffer_write(&file, folder, name, err);
}

int gsn_phantom_make(const struct gsn_phantom_plan *plan, int with_density, unsigned threads,
                     const char *folder, const struct gsn_progress *progress, struct gsn_error *err)
{
    enum { STEPS = GSN_PHANTOM_PANELS + 2 };
    struct gsn_phantom_extent extent[GSN_PHANTOM_SECTIONS];
    gsn_auto_mem(char) truth = gsn_format("%s/truth", folder);
    int r;

    if (!truth)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", folder);
    r = gsn_file_mkdir(truth, err);
    if (r < 0)
        return r;
    for (int panel = 1; panel <= GSN_PHANTOM_PANELS; panel++) {
        gsn_progress_say(progress, "drawing panels", (size_t)panel - 1, STEPS);
        r = write_panel(plan, panel, threads, folder, &extent[(panel - 1) * GSN_PHANTOM_SLOTS],
                        err);
        if (r < 0)
            return r;
    }
    gsn_progress_say(progress, "writing the truth", GSN_PHANTOM_PANELS, STEPS);
    r = gsn_phantom_write_truth(plan, extent, with_density, threads, truth, err);
    if (r < 0)
        return r;
    gsn_progress_say(progress, "writing the job", GSN_PHANTOM_PANELS + 1, STEPS);
    r = gsn_phantom_write_job(plan, folder, err);
    if (r < 0)
        return r;
    gsn_progress_say(progress, "done", STEPS, STEPS);
    return GSN_OK;
}
