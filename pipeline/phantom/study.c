/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The animals of a study, one after the other, each as phantom.c makes one, and then the table of
 * their true losses, whose integrals are taken once. Failure: that of the first animal that fails;
 * those before it stay. */
#include "pipeline/phantom/study.h"

#include "pipeline/core/file.h"
#include "pipeline/phantom/buffer.h"
#include "pipeline/phantom/phantom.h"
#include "pipeline/phantom/planning.h"
#include "pipeline/phantom/truth.h"

static int make_animal(const struct gsn_phantom_specimen *animal, const char *level, uint64_t seed,
                       double px_um, unsigned threads, const char *folder,
                       const struct gsn_progress *progress, struct gsn_error *err)
{
    gsn_auto_mem(char) place = gsn_format("%s/" GSN_PHANTOM_STUDY "-%s", folder, animal->name);
    gsn_auto_mem(struct gsn_phantom_plan) plan = gsn_alloc_array(1, sizeof *plan);
    int r;

    if (!place || !plan)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", animal->name);
    r = gsn_phantom_plan_make(animal->name, level, seed, px_um, plan, err);
    if (r < 0)
        return r;
    return gsn_phantom_make(plan, 0, threads, place, progress, err);
}

static int write_table(unsigned threads, const char *folder, struct gsn_error *err)
{
    gsn_auto_mem(char) truth = gsn_format("%s/truth", folder);
    gsn_auto_phantom_buffer text = { 0 };
    struct gsn_phantom_sums sums;
    int r;

    if (!truth)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for study.csv");
    r = gsn_phantom_truth_sums(gsn_phantom_geometry(), gsn_phantom_specimen_at(0), threads, &sums,
                               err);
    if (r < 0)
        return r;
    gsn_phantom_buffer_print(&text, "specimen,group,animal,week,true_loss_pct\n");
    for (int i = GSN_PHANTOM_STUDY_FIRST; i < GSN_PHANTOM_SPECIMENS; i++) {
        const struct gsn_phantom_specimen *s = gsn_phantom_specimen_at(i);

        gsn_phantom_buffer_print(&text, GSN_PHANTOM_STUDY "-%s,%s,%s,%d,%.6f\n", s->name, s->group,
                                 s->animal, s->week, gsn_phantom_truth_loss(s, &sums));
    }
    r = gsn_file_mkdir(truth, err);
    return r < 0 ? r : gsn_phantom_buffer_write(&text, truth, "study.csv", err);
}

int gsn_phantom_study_make(const char *level, uint64_t seed, double px_um, unsigned threads,
                           const char *folder, const struct gsn_progress *progress,
                           struct gsn_error *err)
{
    for (int i = GSN_PHANTOM_STUDY_FIRST; i < GSN_PHANTOM_SPECIMENS; i++) {
        const int r = make_animal(gsn_phantom_specimen_at(i), level, seed, px_um, threads, folder,
                                  progress, err);

        if (r < 0)
            return r;
    }
    return write_table(threads, folder, err);
}
