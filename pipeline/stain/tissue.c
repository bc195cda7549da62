/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/tissue.h"

#include "pipeline/core/robust.h"
#include "pipeline/stain/segment.h"
#include "pipeline/stain/tissue_body.h"

#include <string.h>

/* A body of less is a splinter: a ball of 300 um. */
static const double LEAST_UM3 = 1.4e7;

/* What is not there, and what that may mean. */
static const char *const MISSING[] = {
    [GSN_TISSUE_ROOT] = "no root was found in this block: nothing solid, paler than bone, stands "
                        "alone within a ligament",
    [GSN_TISSUE_BONE] = "no bone was found in this block: nothing solid stands out by its density",
    [GSN_TISSUE_ALL] = "no tissue was found in this block",
};

const char *gsn_tissue_name(enum gsn_tissue_kind tissue)
{
    static const char *const name[] = { "root", "bone", "tissue" };

    return name[tissue];
}

/* Bone is the median of what lies above Otsu's level. */
static int find_levels(const struct gsn_body *b, struct gsn_tissue_levels *levels,
                       struct gsn_error *err)
{
    gsn_auto_mem(float) list = gsn_alloc_array(b->count, sizeof *list);
    gsn_auto_mem(double) scratch = gsn_alloc_array(b->count, sizeof *scratch);
    size_t n = 0, count = 0;

    if (!list || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissues of a block");
    for (size_t i = 0; i < b->count; i++)
        if (b->value[i] > (float)GSN_BODY_GLASS)
            list[n++] = b->value[i];
    levels->border = gsn_otsu(list, n);
    for (size_t i = 0; i < n; i++)
        if ((double)list[i] > levels->border)
            scratch[count++] = (double)list[i];
    levels->bone = count > 0 ? gsn_order_pick(scratch, count, count / 2) : 0;
    return GSN_OK;
}

/* The set, the root or nothing, becomes the bone: what is denser than midway between the ligament
 * and the bone, where there is a ligament. */
static void take_bone(struct gsn_body *b, struct gsn_tissue_levels *levels)
{
    if (levels->dentine > 0)
        levels->border = (2 * levels->border - levels->dentine + levels->bone) / 2;
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = !b->set[i] && (double)b->value[i] > levels->border;
    gsn_body_tidy(b);
}

/* The outline: voids within a section belong to it. */
static void take_all(struct gsn_body *b, struct gsn_tissue_levels *levels)
{
    levels->border = GSN_BODY_GLASS;
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = (double)b->value[i] > levels->border;
    gsn_body_tidy(b);
    gsn_body_fill_sections(b);
}

static int take(struct gsn_body *b, enum gsn_tissue_kind tissue, struct gsn_tissue_levels *levels,
                struct gsn_error *err)
{
    int r = find_levels(b, levels, err);

    if (r >= 0 && tissue != GSN_TISSUE_ALL && levels->bone > 0)
        r = gsn_body_find_root(b, levels, err);
    if (r >= 0 && tissue == GSN_TISSUE_BONE)
        take_bone(b, levels);
    if (r >= 0 && tissue == GSN_TISSUE_ALL)
        take_all(b, levels);
    return r;
}

static int make_body(struct gsn_body *b, enum gsn_tissue_kind tissue, struct gsn_mask **ret_body,
                     struct gsn_tissue_levels *levels, struct gsn_error *err)
{
    gsn_auto(gsn_mask) body = NULL;
    int r = take(b, tissue, levels, err);

    if (r >= 0)
        r = gsn_mask_new(&b->at, &body, err);
    if (r < 0)
        return r;
    memcpy(body->inside, b->set, b->count);
    levels->volume_um3 = (double)gsn_mask_count(body) * gsn_lattice_voxel_um3(&b->at);
    if (!(levels->volume_um3 >= LEAST_UM3))
        return gsn_fail(err, GSN_E_STAIN, "%s; state the region as a mask or a shape",
                        MISSING[tissue]);
    *ret_body = gsn_steal(&body);
    return GSN_OK;
}

int gsn_tissue_find(const struct gsn_grid *density, enum gsn_tissue_kind tissue,
                    struct gsn_mask **ret_body, struct gsn_tissue_levels *ret_levels,
                    struct gsn_error *err)
{
    struct gsn_tissue_levels levels = { 0 };
    struct gsn_body b;
    int r = gsn_body_init(density, &b, err);

    if (r >= 0)
        r = make_body(&b, tissue, ret_body, &levels, err);
    gsn_body_done(&b);
    if (r >= 0)
        *ret_levels = levels;
    return r;
}
