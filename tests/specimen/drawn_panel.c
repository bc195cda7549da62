/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/specimen/drawn_panel.h"

#include "pipeline/decode/png_write.h"
#include "tests/check.h"

#include <string.h>

static const double PITCH_UM = 2600;
static const double WHITE[3] = { 248, 244, 238 };
static const double FULL_RED = 0.62, YELLOW = 0.34, BURN = 1.15;

/* PHANTOM.md, section 2: RED, YEL and MARK before normalisation. */
static const double RED_DYE[3] = { .239, .716, .655 };
static const double YELLOW_DYE[3] = { .357, .326, .875 };
static const double CHAR[3] = { .50, .60, .63 };

const struct gsn_point drawn_marks_um[3] = { { -717.5, -350 }, { 595, -525 }, { -525, 455 } };

struct drawn_panel drawn_panel_of(unsigned number, double px_um, double density)
{
    struct drawn_panel panel = { .px_um = px_um };

    for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++) {
        const double k = number * DRAWN_SLOTS + slot;

        panel.section[slot] =
            (struct drawn_section){ .turn_deg = 6 * sin(1.7 * k),
                                    .shift_um = { 90 * sin(2.3 * k), 90 * cos(3.1 * k) },
                                    .density = density };
    }
    return panel;
}

static struct gsn_point centre_um(const struct drawn_panel *panel, unsigned slot)
{
    const struct gsn_point shift = panel->section[slot].shift_um;

    return (struct gsn_point){ (slot % DRAWN_COLUMNS + 0.5) * PITCH_UM + shift.x,
                               (slot / DRAWN_COLUMNS + 0.5) * PITCH_UM + shift.y };
}

struct gsn_point drawn_panel_place(const struct drawn_panel *panel, unsigned slot,
                                   struct gsn_point um)
{
    const struct drawn_section *s = &panel->section[slot];
    const struct gsn_point centre = centre_um(panel, slot);
    const double c = cos(s->turn_deg * M_PI / 180), n = sin(s->turn_deg * M_PI / 180);
    const double x = s->flipped ? -um.x : um.x;

    return (struct gsn_point){ (centre.x + c * x - n * um.y) / panel->px_um,
                               (centre.y + n * x + c * um.y) / panel->px_um };
}

/* The inverse of the above. */
static struct gsn_point material(const struct drawn_panel *panel, unsigned slot,
                                 struct gsn_point px)
{
    const struct drawn_section *s = &panel->section[slot];
    const struct gsn_point centre = centre_um(panel, slot);
    const double c = cos(s->turn_deg * M_PI / 180), n = sin(s->turn_deg * M_PI / 180);
    const double dx = px.x * panel->px_um - centre.x, dy = px.y * panel->px_um - centre.y;
    const double x = c * dx + n * dy;

    return (struct gsn_point){ s->flipped ? -x : x, c * dy - n * dx };
}

static double smooth(double t)
{
    const double u = fmin(fmax((t + 1) / 2, 0), 1);

    return u * u * (3 - 2 * u);
}

static void add(double od[3], const double dye[3], double amount)
{
    const double length = sqrt(dye[0] * dye[0] + dye[1] * dye[1] + dye[2] * dye[2]);

    for (int i = 0; i < 3; i++)
        od[i] += amount * dye[i] / length;
}

static void burn(double od[3], double r)
{
    const double a = smooth((75 - r) / 14), h = smooth((115 - r) / 14) * (1 - a);

    for (int i = 0; i < 3; i++)
        od[i] *= (1 - .65 * h) * (1 - a);
    add(od, CHAR, BURN * a);
}

/* Waves of 180 to 900 um in all directions: those that all sections have, and one section's. */
static double structure(struct gsn_point u, unsigned seed)
{
    double sum = 0;

    for (unsigned k = 0; k < 12; k++) {
        const double way = 2.4 * k + 1.7 * seed, length = 180 + 720 * k / 11.0;
        const double phase = 6.1 * sin(3.7 * k + 5.3 * seed);

        sum += sin(2 * M_PI * (cos(way) * u.x + sin(way) * u.y) / length + phase);
    }
    return sum;
}

static void od_at(const struct drawn_panel *panel, unsigned slot, struct gsn_point px,
                  double ret_od[3])
{
    const struct drawn_section *s = &panel->section[slot];
    const struct gsn_point u = material(panel, slot, px);
    const double grain = s->grain ? 0.07 * structure(u, 0) + 0.03 * structure(u, s->grain) : 0;
    const double d = s->density * (1 + DRAWN_SLOPE * u.x + grain);

    ret_od[0] = ret_od[1] = ret_od[2] = 0;
    if (s->missing || hypot(u.x / DRAWN_WIDTH_UM, u.y / DRAWN_HEIGHT_UM) > 1 ||
        (s->lopsided && u.x > 200 && u.y > 100))
        return;
    add(ret_od, RED_DYE, FULL_RED * d);
    add(ret_od, YELLOW_DYE, YELLOW * (1 - .55 * d));
    for (unsigned m = 0; m < 3; m++)
        if (!(s->no_marks >> m & 1))
            burn(ret_od, hypot(u.x - drawn_marks_um[m].x, u.y - drawn_marks_um[m].y));
}

static double encode(double light)
{
    return light > 0.0031308 ? 1.055 * pow(light, 1 / 2.4) - 0.055 : 12.92 * light;
}

/* A pixel sees the mean light of nine points. */
static void draw_pixel(const struct drawn_panel *panel, struct gsn_image *image, uint32_t x,
                       uint32_t y)
{
    const unsigned column = (unsigned)fmin(x * panel->px_um / PITCH_UM, DRAWN_COLUMNS - 1);
    const unsigned row = (unsigned)fmin(y * panel->px_um / PITCH_UM, DRAWN_ROWS - 1);
    double light[3] = { 0 };

    for (int i = 0; i < 9; i++) {
        const struct gsn_point at = { x + (i % 3 + 0.5) / 3, y + (i / 3 + 0.5) / 3 };
        double od[3];

        od_at(panel, row * DRAWN_COLUMNS + column, at, od);
        for (int c = 0; c < 3; c++)
            light[c] += WHITE[c] / 255 * (od[c] > 0 ? pow(10, -od[c]) : 1) / 9;
    }
    for (size_t c = 0; c < 3; c++) {
        const double code = panel->srgb ? encode(light[c]) : light[c];

        ((uint8_t *)image->samples)[((size_t)y * image->width + x) * 3 + c] =
            (uint8_t)(255 * code + 0.5);
    }
}

struct gsn_image *drawn_turned(const struct gsn_image *image, int mirrored, int quarters)
{
    const uint32_t width = image->width, height = image->height;
    struct gsn_image *now = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(quarters % 2 ? height : width, quarters % 2 ? width : height, 3, 8, &now,
                           &err),
             err);
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++) {
            const uint32_t u = mirrored ? width - 1 - x : x;
            const uint32_t to_x[4] = { u, height - 1 - y, width - 1 - u, y };
            const uint32_t to_y[4] = { y, u, height - 1 - y, width - 1 - u };

            memcpy((uint8_t *)now->samples +
                       3 * ((size_t)to_y[quarters] * now->width + to_x[quarters]),
                   (const uint8_t *)image->samples + 3 * ((size_t)y * width + x), 3);
        }
    return now;
}

struct gsn_image *drawn_panel_image(const struct drawn_panel *panel)
{
    const uint32_t width = (uint32_t)(DRAWN_COLUMNS * PITCH_UM / panel->px_um);
    const uint32_t height = (uint32_t)(DRAWN_ROWS * PITCH_UM / panel->px_um);
    gsn_auto(gsn_image) image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(width, height, 3, 8, &image, &err), err);
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++)
            draw_pixel(panel, image, x, y);
    return drawn_turned(image, panel->mirrored, panel->quarters);
}

uint8_t *drawn_panel_png(const struct drawn_panel *panel, size_t *ret_size)
{
    gsn_auto(gsn_image) image = drawn_panel_image(panel);
    struct gsn_error err = { 0 };
    uint8_t *bytes = NULL;

    CHECK_OK(gsn_png_encode(image, &bytes, ret_size, &err), err);
    return bytes;
}
