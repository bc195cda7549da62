/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"

#include "pipeline/register/stack/resample_colour.h"

#include <math.h>
#include <string.h>

int gsn_assembly_place_colour(struct gsn_assembly *a, struct gsn_error *err)
{
    return a->grid ? gsn_colour_grid_new(&a->grid->at, &a->colour, err) : GSN_OK;
}

/* By how many voxels the second lattice begins later. */
static size_t later(double from, double to, double step)
{
    return (size_t)lround((to - from) / step);
}

int gsn_assembly_crop_colour(struct gsn_assembly *a, struct gsn_error *err)
{
    const struct gsn_lattice *from = &a->colour->at, *to = &a->grid->at;
    const size_t x = later(from->origin_um.x, to->origin_um.x, to->step_um.x);
    const size_t y = later(from->origin_um.y, to->origin_um.y, to->step_um.y);
    const size_t z = later(from->origin_um.z, to->origin_um.z, to->step_um.z);
    gsn_auto(gsn_colour_grid) part = NULL;
    const int r = gsn_colour_grid_new(to, &part, err);

    if (r < 0)
        return r;
    for (size_t v = 0; v < to->ny * to->nz; v++)
        memcpy(part->rgb + 3 * v * to->nx,
               a->colour->rgb + 3 * gsn_lattice_index(from, x, y + v % to->ny, z + v / to->ny),
               3 * to->nx);
    gsn_colour_grid_free(a->colour);
    a->colour = gsn_steal(&part);
    return GSN_OK;
}

int gsn_assembly_light(enum gsn_light light, unsigned bits, struct gsn_assembly_light *ret_light,
                       struct gsn_error *err)
{
    const size_t samples = (size_t)1 << bits, steps = GSN_STACK_FULL_LIGHT / 4 + 1;
    struct gsn_assembly_light made = { gsn_alloc(samples * sizeof(uint16_t)), gsn_alloc(steps) };

    if (!made.of_sample || !made.code) {
        gsn_assembly_light_done(&made);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the colours of a panel");
    }
    for (unsigned i = 0; i < samples; i++)
        made.of_sample[i] =
            (uint16_t)lround(GSN_STACK_FULL_LIGHT * gsn_light_of_sample(light, i, bits));
    for (size_t i = 0; i < steps; i++) {
        /* The middle of the four lights that share a code. */
        const double middle = fmin((4.0 * (double)i + 1.5) / GSN_STACK_FULL_LIGHT, 1);
        const long code = lround(255 * gsn_light_encode(GSN_LIGHT_SRGB, middle));

        made.code[i] = (uint8_t)(code > 0 ? code : 1);
    }
    *ret_light = made;
    return GSN_OK;
}

void gsn_assembly_light_done(struct gsn_assembly_light *light)
{
    gsn_free(light->of_sample);
    gsn_free(light->code);
}
