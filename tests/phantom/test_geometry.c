/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"
#include "pipeline/phantom/geometry.h"
#include "pipeline/phantom/random.h"

enum { PLACES = 20000 };

/* Anywhere in the block and a little beyond. */
static struct gsn_vec3 somewhere(struct gsn_phantom_random *random)
{
    return gsn_vec3_make(5600 * (gsn_phantom_uniform(random) - 0.5),
                         4500 * (gsn_phantom_uniform(random) - 0.5),
                         1440 * gsn_phantom_uniform(random));
}

static struct gsn_phantom_random draws(void)
{
    return gsn_phantom_random_make(1, GSN_PHANTOM_STREAM_POSE, 0, 0);
}

/* The specification once more, word by word and without any short cut. */
static double S(double t)
{
    const double u = t <= -1 ? 0 : t >= 1 ? 1 : (t + 1) / 2;

    return u * u * (3 - 2 * u);
}

static double plain_tissue(double x, double y, double z)
{
    const double phi = atan2(y / 2050, x / 2600);
    const double base = cbrt(pow(fabs(x) / 2600, 3) + pow(fabs(y) / 2050, 3));
    const double waves =
        .001 * cos(2 * phi + .33 - .000722 * z) + .003 * cos(3 * phi + 6.18 - .001243 * z) +
        .007 * cos(4 * phi + .37 + .00035 * z) + .001 * cos(5 * phi + .43 - .00105 * z) +
        .005 * cos(6 * phi + 3.62 + .000764 * z);

    return S((1 - base / (1 + waves)) * 2050 / 12);
}

static double plain_root(double x, double y, double z, double scale, double start)
{
    const double a = 520 * scale, b = 430 * scale;
    const double X = x - (-100 + .10 * z), Y = y - (80 - .06 * z), s = (z - 250) / 900 - start;
    const double gx = 2 * X / (a * a), gy = 2 * Y / (b * b);
    const double gz = -1.0 / 900 - 2 * X * .10 / (a * a) + 2 * Y * .06 / (b * b);

    return ((X / a) * (X / a) + (Y / b) * (Y / b) - s) / sqrt(gx * gx + gy * gy + gz * gz);
}

static double plain_marrow(double x, double y, double z)
{
    const struct gsn_phantom_geometry *g = gsn_phantom_geometry();
    double most = 0;

    for (int i = 0; i < GSN_PHANTOM_MARROWS; i++) {
        const struct gsn_vec3 c = g->marrow[i].centre, r = g->marrow[i].radius;
        const double q =
            sqrt(pow((x - c.x) / r.x, 2) + pow((y - c.y) / r.y, 2) + pow((z - c.z) / r.z, 2));

        most = fmax(most, S((1 - q) * fmin(r.x, fmin(r.y, r.z)) / 12));
    }
    return most;
}

static double plain_density(double x, double y, double z, double A)
{
    const double d = plain_root(x, y, z, 1, 0);
    const double theta = atan2(y - (80 - .06 * z), x - (-100 + .10 * z));
    const double inr = S(-d / 12), pulp = S(-plain_root(x, y, z, .38, .25) / 12) * inr;
    const double o1 = S((d - 180) / 12);
    const double o2 = S((d - 180 - 700 * (1 + .25 * cos(theta - .6))) / 12);
    const double m = plain_marrow(x, y, z), bone = o1 * (1 - o2) * (1 - m);
    const double dx = x - 411, dy = y - 646, u = cos(.5) * dx + sin(.5) * dy;
    const double w = -sin(.5) * dx + cos(.5) * dy;
    const double E = exp(-.5 * (pow(u / 520, 2) + pow(w / 420, 2) + pow((z - 420) / 330, 2)));

    return plain_tissue(x, y, z) *
           (.20 * o1 * o2 + .55 * (inr - pulp) + .12 * pulp + .06 * o1 * (1 - o2) * m +
            .42 * (1 - inr) * (1 - o1) * (1 - A * E / 2) +
            .88 * bone * (1 + .05 * cos(2 * M_PI * d / 80)) * (1 - .08 * z / 1440) * (1 - A * E));
}

TEST(the_density_is_that_of_the_specification_everywhere)
{
    static const double depth[] = { 0, .3698, .8153, 1 };
    struct gsn_phantom_random random = draws();
    struct gsn_phantom_field field;

    for (int i = 0; i < PLACES; i++) {
        const struct gsn_vec3 at = somewhere(&random);
        const double A = depth[i % 4];

        gsn_phantom_field_at(gsn_phantom_geometry(), at, &field);
        CHECK_NEAR(gsn_phantom_density(&field, A), plain_density(at.x, at.y, at.z, A), 1e-12);
    }
}

TEST(the_outline_is_that_of_the_specification_where_it_changes)
{
    struct gsn_phantom_random random = draws();
    struct gsn_phantom_field field;
    int between = 0;

    for (int i = 0; i < PLACES; i++) {
        const double phi = 2 * M_PI * gsn_phantom_uniform(&random);
        const double c = cos(phi), s = sin(phi);
        const double rho =
            (0.96 + 0.08 * gsn_phantom_uniform(&random)) / cbrt(pow(fabs(c), 3) + pow(fabs(s), 3));
        const struct gsn_vec3 at = { 2600 * rho * c, 2050 * rho * s,
                                     1440 * gsn_phantom_uniform(&random) };

        gsn_phantom_field_at(gsn_phantom_geometry(), at, &field);
        CHECK_NEAR(field.tissue, plain_tissue(at.x, at.y, at.z), 1e-12);
        between += field.tissue > 0 && field.tissue < 1;
    }
    CHECK(between > PLACES / 20);
}

TEST(layers_sum_to_one_where_there_is_tissue_and_to_nothing_elsewhere)
{
    struct gsn_phantom_random random = draws();
    int outside = 0;

    for (int i = 0; i < PLACES; i++) {
        struct gsn_phantom_field field;
        double sum = 0;

        gsn_phantom_field_at(gsn_phantom_geometry(), somewhere(&random), &field);
        for (int l = 0; l < GSN_PHANTOM_LAYERS; l++) {
            CHECK(field.layer[l] >= 0);
            sum += field.layer[l];
        }
        CHECK_NEAR(sum, field.tissue > 0 ? 1 : 0, 1e-12);
        if (field.tissue > 0)
            continue;
        outside++;
        CHECK(field.intact == 0 && field.lost == 0);
    }
    CHECK(outside > 100 && outside < PLACES / 2);
}

TEST(the_lesion_takes_collagen_and_never_more_than_there_is)
{
    struct gsn_phantom_random random = draws();

    for (int i = 0; i < PLACES; i++) {
        struct gsn_phantom_field field;

        gsn_phantom_field_at(gsn_phantom_geometry(), somewhere(&random), &field);
        CHECK(field.lost >= 0 && field.lost <= field.intact);
        CHECK(field.intact >= 0 && field.intact <= 1);
    }
}

TEST(distance_grows_by_one_per_micrometre_across_the_root_surface)
{
    /* A point on the surface at z = 700 straight right of the axis: (X/a)^2 = s. */
    const double s = 0.5, step = 0.01;
    const struct gsn_vec3 on = { -100 + 0.10 * 700 + 520 * sqrt(s), 80 - 0.06 * 700, 700 };
    const double dx =
        (gsn_phantom_root_distance(gsn_phantom_geometry(), gsn_vec3_make(on.x + step, on.y, on.z)) -
         gsn_phantom_root_distance(gsn_phantom_geometry(),
                                   gsn_vec3_make(on.x - step, on.y, on.z))) /
        (2 * step);
    const double dy =
        (gsn_phantom_root_distance(gsn_phantom_geometry(), gsn_vec3_make(on.x, on.y + step, on.z)) -
         gsn_phantom_root_distance(gsn_phantom_geometry(),
                                   gsn_vec3_make(on.x, on.y - step, on.z))) /
        (2 * step);
    const double dz =
        (gsn_phantom_root_distance(gsn_phantom_geometry(), gsn_vec3_make(on.x, on.y, on.z + step)) -
         gsn_phantom_root_distance(gsn_phantom_geometry(),
                                   gsn_vec3_make(on.x, on.y, on.z - step))) /
        (2 * step);

    CHECK_NEAR(gsn_phantom_root_distance(gsn_phantom_geometry(), on), 0, 1e-9);
    CHECK_NEAR(sqrt(dx * dx + dy * dy + dz * dz), 1, 1e-6);
}

TEST(the_region_of_interest_reaches_from_section_5_to_section_29)
{
    for (int k = 0; k < 60; k++) {
        int inside = 0;

        for (double y = -260; y <= 1560; y += 20)
            for (double x = -500; x <= 1320; x += 20)
                inside |= gsn_phantom_in_region(
                    gsn_phantom_geometry(),
                    gsn_vec3_make(x, y, gsn_phantom_section_z(gsn_phantom_geometry(), k)));
        CHECK(inside == (k >= 5 && k <= 29));
    }
}

TEST(the_marks_are_a_scalene_triangle)
{
    const struct gsn_point *m = gsn_phantom_geometry()->mark;

    CHECK_NEAR(hypot(m[0].x - m[2].x, m[0].y - m[2].y), 2365, 0.5);
    CHECK_NEAR(hypot(m[0].x - m[1].x, m[0].y - m[1].y), 3783, 0.5);
    CHECK_NEAR(hypot(m[1].x - m[2].x, m[1].y - m[2].y), 4252, 0.5);
}
