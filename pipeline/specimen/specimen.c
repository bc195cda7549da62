/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What is looked up in the records of a specimen and of its result, which all stages read.
 *
 * Nothing here computes or fails: a panel by its number, a measure by its name, the names by which
 * the densities of control tissue are handed on; and a result is freed. */
#include "pipeline/specimen/specimen.h"

#include <math.h>
#include <string.h>

const struct gsn_specimen_panel *gsn_specimen_find_panel(const struct gsn_specimen *specimen,
                                                         unsigned number)
{
    for (size_t i = 0; i < specimen->panel_count; i++)
        if (specimen->panel[i].number == number && specimen->panel[i].section_count > 0)
            return &specimen->panel[i];
    return NULL;
}

double gsn_specimen_result_measure(const struct gsn_specimen_result *result, const char *name,
                                   const struct gsn_specimen_measure **ret_row)
{
    for (size_t i = 0; i < result->measure_count; i++)
        if (strcmp(result->measure[i].name, name) == 0) {
            if (ret_row)
                *ret_row = &result->measure[i];
            return result->measure[i].value;
        }
    return NAN;
}

const char *gsn_specimen_tissue_measure(unsigned tissue)
{
    static const char *const names[GSN_CONTROL_TISSUES] = { "tissue_dense", "tissue_loose",
                                                            "tissue_dentine" };

    return names[tissue];
}

const char *gsn_specimen_tissues_measure(unsigned tissue, unsigned other)
{
    static const char *const names[] = { "tissue_dense_loose", "tissue_dense_dentine",
                                         "tissue_loose_dentine" };

    _Static_assert((int)GSN_CONTROL_TISSUES == 3, "all pairs of three have a name");
    return names[tissue + other - 1];
}

void gsn_specimen_result_free(struct gsn_specimen_result *result)
{
    if (!result)
        return;
    gsn_free(result->json);
    gsn_free(result->html);
    for (size_t i = 0; i < result->file_count; i++)
        gsn_free(result->file[i].bytes);
    for (size_t i = 0; i < result->part_count; i++)
        gsn_specimen_result_free(result->part[i]);
    gsn_free(result->pose);
    gsn_free(result->candidates);
    gsn_free(result->stain);
    gsn_cloud_free(result->colours.cloud);
    gsn_free(result);
}
