/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel_parts.h"

#include "pipeline/imaging/threshold.h"

/* Anything smaller is dust. */
static const double DUST_UM = 200;
/* The tissue's mean must stand this far above the glass, in optical density. */
static const double TISSUE_LEAST = 0.05;
enum { BINS = 256 };
/* Density above which all is simply dark: ink must not pull the threshold up. */
static const double DARKEST = 1.0;
/* Pieces alike speak louder than one: two sections that grew together cover as much as two alone.
 */
static const double ALONE = 0.8;

/* Masked cells and what is brighter than glass count as glass. */
static void clip(const struct gsn_plane *tissue, float *ret_value)
{
    const size_t count = (size_t)tissue->width * tissue->height;
    const float most = (float)DARKEST;

    for (size_t i = 0; i < count; i++) {
        const float value = tissue->value[i];

        ret_value[i] = value > 0 ? value < most ? value : most : 0;
    }
}

/* Otsu's threshold between glass and tissue; ret_apart is the distance of their means. */
static double threshold_of(const float *value, size_t count, double *ret_apart)
{
    size_t histogram[BINS] = { 0 }, cut;

    for (size_t i = 0; i < count; i++) {
        const unsigned bin = (unsigned)(value[i] * (float)(BINS / DARKEST));

        histogram[bin < BINS ? bin : BINS - 1]++;
    }
    cut = gsn_otsu_cut(histogram, BINS, ret_apart);
    *ret_apart *= DARKEST / BINS;
    return (double)cut / BINS * DARKEST;
}

int gsn_panel_pieces_find(const struct gsn_plane *tissue, double cell_um,
                          struct gsn_components **ret_pieces, uint8_t **ret_thin,
                          struct gsn_error *err)
{
    const size_t count = (size_t)tissue->width * tissue->height;
    gsn_auto_mem(float) value = gsn_alloc(count * sizeof *value);
    gsn_auto_mem(uint8_t) mask = gsn_alloc(count);
    double apart;
    float threshold;

    if (!value || !mask)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    clip(tissue, value);
    threshold = (float)threshold_of(value, count, &apart);
    for (size_t i = 0; i < count; i++)
        mask[i] = apart >= TISSUE_LEAST && value[i] >= threshold;
    return gsn_split_pieces(mask, tissue->width, tissue->height,
                            (unsigned)(GSN_PANEL_THREAD_UM / cell_um), ret_pieces, ret_thin, err);
}

int gsn_panel_is_dust(const struct gsn_component *piece, const struct gsn_panel_cells *cells)
{
    return (double)piece->area * cells->um * cells->um < DUST_UM * DUST_UM;
}

double gsn_panel_section_area(const struct gsn_components *pieces,
                              const struct gsn_panel_cells *cells)
{
    double most = 0, area = 0;

    for (size_t i = 0; i < pieces->count; i++) {
        const double own = (double)pieces->component[i].area;
        double sum = 0;
        size_t alike = 0;

        if (gsn_panel_is_dust(&pieces->component[i], cells))
            continue;
        for (size_t k = 0; k < pieces->count; k++) {
            const double other = (double)pieces->component[k].area;

            if (other <= GSN_PANEL_SAME_AREA * own && own <= GSN_PANEL_SAME_AREA * other) {
                sum += other;
                alike++;
            }
        }
        if (alike == 1)
            sum *= ALONE;
        if (sum > most) {
            most = sum;
            area = alike == 1 ? own : sum / (double)alike;
        }
    }
    return area;
}
