/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/register/draw.h"
#include "pipeline/register/fiducial/detect.h"

#include <math.h>

static uint64_t next(struct draw_chance *chance)
{
    uint64_t z = (chance->state += 0x9e3779b97f4a7c15u);

    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

double draw_uniform(struct draw_chance *chance, double from, double to)
{
    return from + (to - from) * ((double)(next(chance) >> 11) + 0.5) / 9007199254740992.0;
}

double draw_normal(struct draw_chance *chance)
{
    const double r = sqrt(-2 * log(draw_uniform(chance, 0, 1)));

    return r * cos(draw_uniform(chance, 0, 2 * M_PI));
}

void draw_fill(struct gsn_plane *plane, double value)
{
    for (size_t i = 0; i < (size_t)plane->width * plane->height; i++)
        plane->value[i] = (float)value;
}

void draw_noise(struct gsn_plane *plane, struct draw_chance *chance, double sd)
{
    for (size_t i = 0; i < (size_t)plane->width * plane->height; i++)
        plane->value[i] += (float)(sd * draw_normal(chance));
}

static size_t clamp(double value, uint32_t most)
{
    return (size_t)fmin(fmax(floor(value), 0), most);
}

void draw_ellipse(struct gsn_plane *plane, struct gsn_point centre, double a, double b,
                  double angle, double value)
{
    const double reach = fmax(a, b) + 1;

    for (size_t y = clamp(centre.y - reach, plane->height);
         y < clamp(centre.y + reach + 1, plane->height); y++) {
        for (size_t x = clamp(centre.x - reach, plane->width);
             x < clamp(centre.x + reach + 1, plane->width); x++) {
            const double dx = (double)x + 0.5 - centre.x, dy = (double)y + 0.5 - centre.y;
            const double u = cos(angle) * dx + sin(angle) * dy;
            const double v = cos(angle) * dy - sin(angle) * dx;

            if (u * u / (a * a) + v * v / (b * b) < 1)
                plane->value[y * plane->width + x] += (float)value;
        }
    }
}

void draw_box(struct gsn_plane *plane, int x, int y, int width, int height, double value)
{
    for (int j = y; j < y + height; j++) {
        for (int i = x; i < x + width; i++)
            plane->value[(size_t)j * plane->width + (size_t)i] = (float)value;
    }
}

static double smooth(double t)
{
    const double u = fmin(fmax((t + 1) / 2, 0), 1);

    return u * u * (3 - 2 * u);
}

struct draw_mark draw_phantom_mark(struct gsn_point centre, double px_um)
{
    return (struct draw_mark){ .centre = centre,
                               .radius = 75 / px_um,
                               .edge = 14 / px_um,
                               .ring = 115 / px_um,
                               .bleach = 0.65,
                               .depth = 0.573 };
}

void draw_burn(struct gsn_plane *plane, const struct draw_mark *mark)
{
    for (size_t i = 0; i < (size_t)plane->width * plane->height; i++) {
        const double r = hypot((double)(i % plane->width) + 0.5 - mark->centre.x,
                               (double)(i / plane->width) + 0.5 - mark->centre.y);
        const double a = smooth((mark->radius - r) / mark->edge);
        const double h = smooth((mark->ring - r) / mark->edge) * (1 - a);

        plane->value[i] =
            (float)(plane->value[i] * (1 - mark->bleach * h) * (1 - a) + mark->depth * a);
    }
}

static void plane_row(const void *context, uint32_t x, uint32_t y, uint32_t apart, size_t count,
                      float *to)
{
    const struct gsn_plane *plane = context;
    const float *from = plane->value + (size_t)y * plane->width + x;

    for (size_t i = 0; i < count; i++)
        to[i] = from[i * apart];
}

struct gsn_density_source draw_density(const struct gsn_plane *plane)
{
    return (struct gsn_density_source){ plane->width, plane->height, plane, plane_row };
}
