/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Dust of the scanner: the least contrast over all panels, as the scanner gave the pictures.
 *
 *   1. Each panel: density that all three channels have, in cells of 20 um; by how much a cell is
 *      darker than the darkest of eight around it, at two distances.
 *   2. The least of that over the panels, turned back to the scanner's frame.
 *   3. What is left of two cells and more together is a spot of dust.
 *
 * The grain of tissue reaches the threshold at one place in a hundred, so on three panels at one in
 * a million: with fewer panels nothing is found. */
#include "pipeline/stain/artefact/dust.h"

#include "pipeline/core/mem.h"
#include "pipeline/imaging/components.h"

#include <math.h>
#include <string.h>

/* Cells of whole pixels of about this size. A grain is told whole from what lies twice its radius
 * away: NEAR for specks of up to 40 um in a busy tissue, FAR for those of up to a tenth of a
 * millimetre. */
static const double CELL_UM = 20;

enum { NEAR = 4, FAR = 12 };

/* A spot is darker than its surroundings by this much on every panel: it costs a density of 0.7 a
 * tenth. The grain of tissue reaches it at one place in a hundred, so on three panels at one in a
 * million. */
static const double LEAST_OD = 0.07;
static const double STEP_OD = 0.01; /* of what is kept for each cell */

/* One cell alone may be three grains by chance. */
enum { LEAST_CELLS = 2, LEAST_PANELS = 3 };

/* Around a spot, in cells: what the lens spreads. */
static const double MARGIN = 1.5;

struct gsn_dust {
    uint32_t width, height; /* of the panels as the scanner gave them */
    double px_um;
    uint32_t side, nx, ny; /* cells */
    uint8_t *least;        /* contrast of each cell, the least of the panels, in STEP_OD */
    unsigned panels;
};

int gsn_dust_new(struct gsn_dust **ret_dust, struct gsn_error *err)
{
    struct gsn_dust *dust = gsn_alloc_array(1, sizeof *dust);

    if (!dust)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a map of dust");
    *ret_dust = dust;
    return GSN_OK;
}

void gsn_dust_free(struct gsn_dust *dust)
{
    if (!dust)
        return;
    gsn_free(dust->least);
    gsn_free(dust);
}

/* The first panel says how large they are. */
static int begin_map(struct gsn_dust *dust, const struct gsn_plane *od, struct gsn_dust_turn turn,
                     double px_um, struct gsn_error *err)
{
    const int lying = turn.quarters % 2 == 1;
    const uint32_t width = lying ? od->height : od->width;
    const uint32_t height = lying ? od->width : od->height;

    dust->side = (uint32_t)fmax(1, round(CELL_UM / px_um));
    dust->nx = width / dust->side;
    dust->ny = height / dust->side;
    dust->least = gsn_alloc_array((size_t)dust->nx * dust->ny + 1, 1);
    if (!dust->least)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a map of dust");
    memset(dust->least, UINT8_MAX, (size_t)dust->nx * dust->ny);
    dust->width = width;
    dust->height = height;
    dust->px_um = px_um;
    return GSN_OK;
}

/* The density that all three channels have, mean over the cell's pixels. */
static float darkness_of(const struct gsn_dust *dust, struct gsn_plane *const od[3], uint32_t x,
                         uint32_t y)
{
    float sum[3] = { 0 };

    for (int c = 0; c < 3; c++)
        for (uint32_t v = y * dust->side; v < (y + 1) * dust->side; v++)
            for (uint32_t u = x * dust->side; u < (x + 1) * dust->side; u++)
                sum[c] += od[c]->value[(size_t)v * od[c]->width + u];
    return fminf(sum[0], fminf(sum[1], sum[2])) / (float)(dust->side * dust->side);
}

/* By how much a cell is darker than the darkest of eight around it. */
static float contrast_at(const float *dark, size_t nx, size_t i, size_t reach)
{
    const size_t aside = reach * nx, slant = reach * 5 / 7; /* cos 45 degrees */
    const size_t across = slant * nx;
    const float around = fmaxf(
        fmaxf(fmaxf(dark[i - reach], dark[i + reach]), fmaxf(dark[i - aside], dark[i + aside])),
        fmaxf(fmaxf(dark[i - across - slant], dark[i - across + slant]),
              fmaxf(dark[i + across - slant], dark[i + across + slant])));

    return dark[i] - around;
}

static int in_discs(const struct gsn_dust *dust, const struct gsn_artefact_disc *disc, size_t discs,
                    uint32_t x, uint32_t y)
{
    for (size_t i = 0; i < discs; i++)
        if (hypot((x + 0.5) * dust->side - disc[i].px.x, (y + 0.5) * dust->side - disc[i].px.y) <=
            disc[i].radius_px + FAR * dust->side)
            return 1;
    return 0;
}

struct place {
    double x, y, width, height; /* on a picture of that size */
};

static struct place turn_place(struct place at, unsigned quarters)
{
    for (unsigned i = 0; i < quarters; i++)
        at = (struct place){ at.height - at.y, at.x, at.height, at.width };
    return at;
}

/* The cell of the picture as the scanner gave it, of one of the upright picture. */
static size_t raw_cell(const struct gsn_dust *dust, const struct gsn_plane *od,
                       struct gsn_dust_turn turn, uint32_t x, uint32_t y)
{
    const struct place upright = { (x + 0.5) * dust->side, (y + 0.5) * dust->side, od->width,
                                   od->height };
    const struct place raw = turn_place(upright, (4 - turn.quarters) % 4);
    const uint32_t cx = (uint32_t)((turn.mirrored ? raw.width - raw.x : raw.x) / dust->side);
    const uint32_t cy = (uint32_t)(raw.y / dust->side);

    return (size_t)(cy < dust->ny ? cy : dust->ny - 1) * dust->nx +
           (cx < dust->nx ? cx : dust->nx - 1);
}

int gsn_dust_add(struct gsn_dust *dust, struct gsn_plane *const od[3], double px_um,
                 struct gsn_dust_turn turn, const struct gsn_pixel_box *box,
                 const struct gsn_artefact_disc *disc, size_t discs, struct gsn_error *err)
{
    gsn_auto_mem(float) dark = NULL;
    gsn_auto_mem(uint8_t) contrast = NULL;
    const int lying = turn.quarters % 2 == 1;
    int r = dust->panels == 0 && !dust->least ? begin_map(dust, od[0], turn, px_um, err) : GSN_OK;

    if (r < 0)
        return r;
    if ((lying ? od[0]->height : od[0]->width) != dust->width ||
        (lying ? od[0]->width : od[0]->height) != dust->height || px_um != dust->px_um)
        return GSN_OK;

    const size_t count = (size_t)dust->nx * dust->ny, nx = od[0]->width / dust->side;
    const uint32_t x0 = (uint32_t)box->x / dust->side, y0 = (uint32_t)box->y / dust->side;
    const uint32_t x1 = (uint32_t)(box->x + box->width) / dust->side;
    const uint32_t y1 = (uint32_t)(box->y + box->height) / dust->side;

    dark = gsn_alloc_array(count + 1, sizeof *dark);
    contrast = gsn_alloc_array(count + 1, 1);
    if (!dark || !contrast)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a map of dust");
    for (uint32_t y = y0; y < y1; y++)
        for (uint32_t x = x0; x < x1; x++)
            dark[(size_t)y * nx + x] = darkness_of(dust, od, x, y);
    for (uint32_t y = y0 + FAR; y + FAR < y1; y++)
        for (uint32_t x = x0 + FAR; x + FAR < x1; x++) {
            const size_t i = (size_t)y * nx + x;
            const double od_more =
                fmax(contrast_at(dark, nx, i, NEAR), contrast_at(dark, nx, i, FAR));

            if (od_more >= LEAST_OD && !in_discs(dust, disc, discs, x, y))
                contrast[raw_cell(dust, od[0], turn, x, y)] =
                    (uint8_t)fmin(od_more / STEP_OD, UINT8_MAX);
        }
    for (size_t i = 0; i < count; i++)
        dust->least[i] = contrast[i] < dust->least[i] ? contrast[i] : dust->least[i];
    dust->panels++;
    return GSN_OK;
}

/* ---- spots ------------------------------------------------------------------------------- */

static struct gsn_artefact_disc spot_of(const struct gsn_dust *dust,
                                        const struct gsn_component *piece)
{
    const double across = fmax(piece->width, piece->height);

    return (struct gsn_artefact_disc){ .px = { (piece->x + 0.5 * piece->width) * dust->side,
                                               (piece->y + 0.5 * piece->height) * dust->side },
                                       .radius_px = (across / 2 + MARGIN) * dust->side };
}

int gsn_dust_find(const struct gsn_dust *dust, struct gsn_artefact_disc **ret_spot,
                  size_t *ret_count, unsigned *ret_panels, struct gsn_error *err)
{
    const size_t cells = (size_t)dust->nx * dust->ny;
    gsn_auto_mem(uint8_t) map = gsn_alloc_array(cells + 1, 1);
    gsn_auto(gsn_components) pieces = NULL;
    gsn_auto_mem(struct gsn_artefact_disc) spot = NULL;
    size_t count = 0, seeds = 0;

    for (size_t i = 0; map && dust->panels >= LEAST_PANELS && i < cells; i++)
        seeds += map[i] = dust->least[i] > 0;
    spot = gsn_alloc_array(seeds / LEAST_CELLS + 1, sizeof *spot);
    if (!map || !spot)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a map of dust");
    if (seeds > 0) {
        const int r = gsn_components_find(map, dust->nx, dust->ny, &pieces, err);

        if (r < 0)
            return r;
        for (size_t i = 0; i < pieces->count; i++)
            if (pieces->component[i].area >= LEAST_CELLS)
                spot[count++] = spot_of(dust, &pieces->component[i]);
    }
    *ret_spot = gsn_steal(&spot);
    *ret_count = count;
    *ret_panels = dust->panels;
    return GSN_OK;
}

struct gsn_artefact_disc gsn_dust_upright(const struct gsn_dust *dust,
                                          const struct gsn_artefact_disc *spot,
                                          struct gsn_dust_turn turn)
{
    const struct place raw = { turn.mirrored ? dust->width - spot->px.x : spot->px.x, spot->px.y,
                               dust->width, dust->height };
    const struct place upright = turn_place(raw, turn.quarters);

    return (struct gsn_artefact_disc){ .px = { upright.x, upright.y },
                                       .radius_px = spot->radius_px };
}
