/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Dyes to optical density: amounts times unit vectors, added (Beer and Lambert), as unmixing has it
 * the other way round. The amount of red is proportional to the density, that of yellow falls with
 * it, nuclei take a share of a pixel; textures scale the first two about a mean of 1. A mark is two
 * smooth steps, of the disc and of the ring around it. Failure: none. Cost: constant. */
#include "pipeline/phantom/stain.h"

#include <math.h>

const double gsn_phantom_white[3] = { 248, 244, 238 };

static const double DYE[GSN_PHANTOM_DYES][3] = {
    [GSN_PHANTOM_RED] = { .239, .716, .655 },
    [GSN_PHANTOM_YELLOW] = { .357, .326, .875 },
    [GSN_PHANTOM_NUCLEAR] = { .52, .60, .61 },
    [GSN_PHANTOM_MARK] = { .50, .60, .63 },
};

static const struct gsn_phantom_recipe RECIPE = {
    .red_amount = 0.62,
    .yellow_amount = 0.34,
    .yellow_loss = 0.55,
    .nuclear_amount = 0.45,
    .least_texture = 0.05,
    .lesion_nuclei = 0.35,
    .nuclei = { [GSN_PHANTOM_CONN] = .10,
                [GSN_PHANTOM_DENT] = 0,
                [GSN_PHANTOM_PULP] = .15,
                [GSN_PHANTOM_PDL] = .08,
                [GSN_PHANTOM_BONE] = .02,
                [GSN_PHANTOM_MARR] = .35 },
    .amplitude = { [GSN_PHANTOM_CONN] = .35,
                   [GSN_PHANTOM_DENT] = .15,
                   [GSN_PHANTOM_PULP] = .45,
                   [GSN_PHANTOM_PDL] = .55,
                   [GSN_PHANTOM_BONE] = .25,
                   [GSN_PHANTOM_MARR] = .45 },
    .mark_bleach = 0.65,
    .mark_amount = 1.15,
};

const struct gsn_phantom_recipe *gsn_phantom_recipe(void)
{
    return &RECIPE;
}

void gsn_phantom_dye_vector(enum gsn_phantom_dye dye, double ret_vector[3])
{
    const double *v = DYE[dye];
    const double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);

    for (int c = 0; c < 3; c++)
        ret_vector[c] = v[c] / length;
}

double gsn_phantom_nuclei_mean(const struct gsn_phantom_field *field, double depth)
{
    double n = RECIPE.lesion_nuclei * depth * field->lesion * field->layer[GSN_PHANTOM_BONE];

    for (int i = 0; i < GSN_PHANTOM_LAYERS; i++)
        n += field->layer[i] * RECIPE.nuclei[i];
    return GSN_PHANTOM_NUCLEI_FULL * field->tissue * n;
}

/* Amplitude of the textures at this point. */
static double texture_amplitude(const struct gsn_phantom_field *field)
{
    double amplitude = 0;

    for (int i = 0; i < GSN_PHANTOM_LAYERS; i++)
        amplitude += field->layer[i] * RECIPE.amplitude[i];
    return amplitude;
}

void gsn_phantom_optical_density(const struct gsn_phantom_field *field,
                                 const struct gsn_phantom_stain *stain,
                                 const struct gsn_phantom_local *local, double ret_od[3])
{
    const double density = gsn_phantom_density(field, stain->depth);
    const double amplitude = texture_amplitude(field);
    const double red = stain->red_gain * RECIPE.red_amount * density *
                       fmax(RECIPE.least_texture, 1 + amplitude * local->red_texture) *
                       (1 + 2 * stain->ramp * local->ramp_place);
    const double yellow = stain->yellow_gain * RECIPE.yellow_amount * field->tissue *
                          (1 - RECIPE.yellow_loss * density) *
                          fmax(RECIPE.least_texture, 1 + amplitude * local->yellow_texture);
    const double nuclear =
        RECIPE.nuclear_amount * fmin(1, (double)local->nuclei / GSN_PHANTOM_NUCLEI_FULL);
    const double(*dye)[3] = stain->dye;
    double plain[GSN_PHANTOM_DYES][3];

    if (!dye) {
        for (int i = 0; i < GSN_PHANTOM_DYES; i++)
            gsn_phantom_dye_vector((enum gsn_phantom_dye)i, plain[i]);
        dye = (const double(*)[3])plain;
    }
    for (int c = 0; c < 3; c++)
        ret_od[c] = red * dye[GSN_PHANTOM_RED][c] + yellow * dye[GSN_PHANTOM_YELLOW][c] +
                    nuclear * dye[GSN_PHANTOM_NUCLEAR][c];
}

const struct gsn_phantom_burning *gsn_phantom_burning(void)
{
    static const struct gsn_phantom_burning disc = { .radius_um = 75,
                                                     .ring_um = 115,
                                                     .edge_um = 14 };

    return &disc;
}

void gsn_phantom_burn(const struct gsn_phantom_burning *burning, double distance_um, double od[3])
{
    const double a = gsn_phantom_step((burning->radius_um - distance_um) / burning->edge_um);
    const double ring =
        gsn_phantom_step((burning->ring_um - distance_um) / burning->edge_um) * (1 - a);
    const double burnt = burning->hole ? ring : a;
    const double bleached = burning->hole ? ring : RECIPE.mark_bleach * ring;
    double mark[3];

    gsn_phantom_dye_vector(GSN_PHANTOM_MARK, mark);
    for (int c = 0; c < 3; c++)
        od[c] = od[c] * (1 - bleached) * (1 - a) + RECIPE.mark_amount * burnt * mark[c];
}
