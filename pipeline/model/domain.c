/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/domain.h"

#include "pipeline/model/domain_cells.h"
#include "pipeline/model/domain_mesher.h"
#include "pipeline/model/domain_verify.h"

#include <assert.h>
#include <math.h>

static int check_options(const struct gsn_domain_options *options, struct gsn_error *err)
{
    if (!(options->cell_um > 0) || !isfinite(options->cell_um) || !(options->max_tet_um3 > 0) ||
        !isfinite(options->max_tet_um3))
        return gsn_fail(err, GSN_E_INPUT,
                        "cells of %g um and tetrahedra of %g um^3: both must be above 0",
                        options->cell_um, options->max_tet_um3);
    return GSN_OK;
}

int gsn_domain_build(const struct gsn_mask *region, const struct gsn_domain_options *options,
                     struct gsn_tets **ret_mesh, struct gsn_error *err)
{
    struct gsn_mesh_question question = { .options.max_tet_um3 = options->max_tet_um3 };
    gsn_auto(gsn_cells) cells = NULL;
    gsn_auto(gsn_surface) surface = NULL;
    gsn_auto(gsn_tets) mesh = NULL;
    int r;

    assert(region && options && options->mesher && ret_mesh);
    r = check_options(options, err);
    if (r >= 0)
        r = gsn_cells_cover(region, options->cell_um, &cells, err);
    if (r >= 0)
        r = gsn_cells_close(cells, err);
    if (r >= 0)
        r = gsn_cells_surface(cells, &surface, err);
    if (r < 0)
        return r;
    question.surface = surface;
    r = gsn_domain_ask(options, &question, &mesh, err);
    if (r >= 0)
        r = gsn_domain_verify_cells(mesh, cells, region, err);
    if (r >= 0)
        *ret_mesh = gsn_steal(&mesh);
    return r;
}
