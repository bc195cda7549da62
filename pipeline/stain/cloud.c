/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Counting hues: a dense table of bins while cells pass, the bins that hold something afterwards.
 * A panel of 400 000 cells leaves about a thousand bins. Fails only without memory. */
#include "pipeline/stain/cloud.h"

#include <math.h>
#include <string.h>

enum { BINS = GSN_CLOUD_GREENS * GSN_CLOUD_BLUES };

struct gsn_cloud_tally {
    double cells[BINS], od[BINS];
};

int gsn_cloud_new(size_t panels, struct gsn_cloud **ret_cloud, struct gsn_error *err)
{
    gsn_auto(gsn_cloud) cloud = gsn_alloc_array(1, sizeof *cloud);

    if (cloud)
        cloud->panel = gsn_alloc_array(panels + 1, sizeof *cloud->panel);
    if (!cloud || !cloud->panel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the colours of a specimen");
    cloud->panels = panels;
    *ret_cloud = gsn_steal(&cloud);
    return GSN_OK;
}

void gsn_cloud_free(struct gsn_cloud *cloud)
{
    if (!cloud)
        return;
    for (size_t p = 0; p < cloud->panels && cloud->panel; p++)
        gsn_free(cloud->panel[p].bin);
    gsn_free(cloud->panel);
    gsn_free(cloud);
}

int gsn_cloud_tally_new(struct gsn_cloud_tally **ret_tally, struct gsn_error *err)
{
    struct gsn_cloud_tally *tally = gsn_alloc_array(1, sizeof *tally);

    if (!tally)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the colours of a panel");
    *ret_tally = tally;
    return GSN_OK;
}

void gsn_cloud_tally_free(struct gsn_cloud_tally *tally)
{
    gsn_free(tally);
}

void gsn_cloud_tally_add(struct gsn_cloud_tally *tally, const double od[3], double cells)
{
    const double all = od[0] + od[1] + od[2];
    const double green = (od[1] / all - GSN_CLOUD_LEAST_GREEN) / GSN_CLOUD_SHARE;
    const double blue = (od[2] / all - GSN_CLOUD_LEAST_BLUE) / GSN_CLOUD_SHARE;

    if (!(all >= GSN_CLOUD_LEAST_OD) || !(green >= 0 && green < GSN_CLOUD_GREENS) ||
        !(blue >= 0 && blue < GSN_CLOUD_BLUES))
        return;

    const size_t at = (size_t)green * GSN_CLOUD_BLUES + (size_t)blue;

    tally->cells[at] += cells;
    tally->od[at] += cells * all;
}

int gsn_cloud_tally_take(struct gsn_cloud_tally *tally, struct gsn_cloud_panel *panel,
                         struct gsn_error *err)
{
    struct gsn_cloud_bin *bin;
    size_t count = 0;

    for (size_t i = 0; i < BINS; i++)
        count += tally->cells[i] > 0;
    bin = gsn_alloc_array(count + 1, sizeof *bin);
    if (!bin)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the colours of a panel");
    gsn_free(panel->bin);
    panel->bin = bin;
    panel->bins = count;
    for (size_t i = 0; i < BINS; i++)
        if (tally->cells[i] > 0)
            *bin++ = (struct gsn_cloud_bin){ (uint32_t)i, tally->cells[i],
                                             tally->od[i] / tally->cells[i] };
    memset(tally, 0, sizeof *tally);
    return GSN_OK;
}

void gsn_cloud_bin_od(const struct gsn_cloud_bin *bin, double ret_od[3])
{
    const double green =
        GSN_CLOUD_LEAST_GREEN + GSN_CLOUD_SHARE * (bin->at / GSN_CLOUD_BLUES + 0.5);
    const double blue = GSN_CLOUD_LEAST_BLUE + GSN_CLOUD_SHARE * (bin->at % GSN_CLOUD_BLUES + 0.5);

    ret_od[0] = bin->od * (1 - green - blue);
    ret_od[1] = bin->od * green;
    ret_od[2] = bin->od * blue;
}
