/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/specimen/drawn_assembly.h"

#include "tests/check.h"

const struct gsn_specimen_options DRAWN_OPTIONS = { .threads = 1 };

struct gsn_reconstruction *drawn_assembly(const struct drawn_specimen *d)
{
    struct gsn_reconstruction *assembly = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_reconstruct(&d->specimen, &DRAWN_OPTIONS, &assembly, &err), err);
    return assembly;
}

struct gsn_reconstruction *drawn_assembly_from(const struct drawn_panel panels[3])
{
    drawn_auto d;

    drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
    return drawn_assembly(&d);
}

void drawn_three_panels(struct drawn_panel panels[3])
{
    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, DRAWN_DENSITY);
}

/* Half a code of rounding in 8 bits is up to 0.003 in optical density; unmixing and cubic
 * convolution make at most five times that of it in one voxel, and next to nothing in the mean. */
static const double ROUNDING = 0.015, MEAN_ROUNDING = 0.002;

/* The planes of one section against what was drawn. */
struct plane {
    double filled;      /* share of the voxels with data */
    double worst, mean; /* distance from the drawn density */
};

static struct plane plane_of(const struct gsn_grid *grid, unsigned serial, double density)
{
    const struct gsn_lattice *at = &grid->at;
    struct plane plane = { 0 };
    size_t filled = 0;

    for (size_t i = 0; i < gsn_lattice_count(at); i++) {
        const struct gsn_vec3 u =
            gsn_lattice_centre(at, i % at->nx, i / at->nx % at->ny, i / at->nx / at->ny);
        const double off = (double)grid->value[i] - density * (1 + DRAWN_SLOPE * u.x);

        if (fabs(u.z - 24 * (serial + 0.5)) > 1 || isnan(off))
            continue;
        filled++;
        plane.worst = fmax(plane.worst, fabs(off));
        plane.mean += off;
    }
    plane.mean = filled ? plane.mean / (double)filled : 0;
    plane.filled = (double)filled / (double)(at->nx * at->ny);
    return plane;
}

void drawn_check_plane(const struct gsn_grid *grid, unsigned serial, double density)
{
    const struct plane plane = plane_of(grid, serial, density);

    CHECK_NEAR(plane.filled, 1, 0);
    CHECK_NEAR(plane.worst, 0, ROUNDING);
    CHECK_NEAR(plane.mean, 0, MEAN_ROUNDING);
}

void drawn_check_gap(const struct gsn_grid *grid, unsigned serial)
{
    CHECK_NEAR(plane_of(grid, serial, 0).filled, 0, 0);
}

int drawn_assemble_once(const struct drawn_specimen *d, struct gsn_error *err)
{
    gsn_auto(gsn_reconstruction) assembly = NULL;

    return gsn_reconstruct(&d->specimen, &DRAWN_OPTIONS, &assembly, err);
}
