/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/bench/panel.h"

#include "tests/bench/bench.h"

#include <math.h>

/* Of a section of 1500 pixels: its marks from the centre, radius of tissue and of a mark. */
static const struct gsn_point MARKS[3] = { { -450, -100 }, { 380, -200 }, { 150, 330 } };
static const double TISSUE = 585, MARK = 16;

struct section {
    double x, y, cos, sin, scale; /* centre; turn; pixels per unit of the above */
    int mirrored;
    double phase;
};

static uint32_t scramble(uint32_t x)
{
    x ^= x >> 16;
    x *= 0x7feb352dU;
    x ^= x >> 15;
    x *= 0x846ca68bU;
    return x ^ x >> 16;
}

/* About normal, sigma 3: a sum of four bytes. */
static double noise(uint32_t x, uint32_t y, uint32_t c)
{
    const uint32_t h = scramble(x * 0x9e3779b9U + scramble(y * 3 + c));
    const int sum = (int)((h & 255) + (h >> 8 & 255) + (h >> 16 & 255) + (h >> 24));

    return (sum - 510) * (3 / 147.8);
}

static struct gsn_point place(const struct section *s, struct gsn_point u)
{
    const double f = s->mirrored ? -u.x : u.x;

    return (struct gsn_point){ s->x + s->scale * (s->cos * f - s->sin * u.y),
                               s->y + s->scale * (s->sin * f + s->cos * u.y) };
}

/* How much light passes at a point of a section, 1 outside it. */
static void tissue(const struct section *s, double dx, double dy, double light[3])
{
    static const double YELLOW[3] = { 0.93, 0.80, 0.45 }, ROSE[3] = { 0.75, 0.25, 0.39 };
    const double ux = (s->cos * dx + s->sin * dy) / s->scale;
    const double u = s->mirrored ? -ux : ux, v = (s->cos * dy - s->sin * dx) / s->scale;
    const double r = hypot(u, v), edge = TISSUE * (1 + 0.03 * cos(3 * atan2(v, u) + s->phase));
    const double inside = fmin(fmax((edge - r) / 3 + 0.5, 0), 1);
    const double red =
        0.5 + 0.3 * sin(u / 31 + s->phase) * cos(v / 23) + 0.2 * sin((u + 2 * v) / 7);
    double char_share = 0;

    for (int m = 0; m < 3; m++)
        char_share += 1 / (1 + exp((hypot(u - MARKS[m].x, v - MARKS[m].y) - MARK) * 1.4));
    for (int c = 0; c < 3; c++) {
        const double stained = YELLOW[c] + red * (ROSE[c] - YELLOW[c]);

        light[c] = (1 + inside * (stained - 1)) * (1 - 0.72 * fmin(char_share, 1));
    }
}

static void draw_row(const struct bench_panel *panel, const struct section *sections, uint32_t y)
{
    const struct gsn_image *image = panel->image;
    uint8_t *to = (uint8_t *)image->samples + 3 * (size_t)y * image->width;
    const uint32_t row = y * BENCH_ROWS / image->height;

    for (uint32_t x = 0; x < image->width; x++) {
        const struct section *s = &sections[row * BENCH_COLUMNS + x * BENCH_COLUMNS / image->width];
        const double u = 2.0 * x / image->width - 1, v = 2.0 * y / image->height - 1;
        const double shade = 1 - 0.05 * (u * u + v * v) + 0.02 * u;
        const double dx = x + 0.5 - s->x, dy = y + 0.5 - s->y;
        double light[3] = { 1, 1, 1 };

        if (hypot(dx, dy) < 1.1 * TISSUE * s->scale)
            tissue(s, dx, dy, light);
        for (unsigned c = 0; c < 3; c++)
            *to++ =
                (uint8_t)fmin(fmax((238 - 2.0 * c) * shade * light[c] + noise(x, y, c), 0), 255);
    }
}

/* Specks between and on the sections. */
static void draw_dust(const struct gsn_image *image, uint64_t *seed)
{
    for (int i = 0; i < 250; i++) {
        const uint32_t x0 = (uint32_t)(bench_draw(seed) * (image->width - 9));
        const uint32_t y0 = (uint32_t)(bench_draw(seed) * (image->height - 9));

        for (uint32_t k = 0; k < 64; k++) {
            uint8_t *pixel =
                (uint8_t *)image->samples + 3 * ((size_t)(y0 + k / 8) * image->width + x0 + k % 8);

            if (hypot(k % 8 - 3.5, (double)k / 8 - 3.5) < 3.5)
                pixel[0] = pixel[1] = pixel[2] = 70;
        }
    }
}

struct bench_panel bench_panel_draw(void)
{
    const uint32_t width = bench_quick ? 1600 : 8000, height = bench_quick ? 1200 : 6000;
    struct bench_panel panel = { .px_um = 40000.0 / width, .side = width * 3 / 16 };
    struct section sections[BENCH_SECTIONS];
    struct gsn_error err = { 0 };
    uint64_t seed = 5;

    bench_need(gsn_image_new(width, height, 3, 8, &panel.image, &err), &err, "panel");
    for (unsigned i = 0; i < BENCH_SECTIONS; i++) {
        const double turn = 2 * M_PI * bench_draw(&seed);
        const double jitter_x = bench_draw(&seed) - 0.5, jitter_y = bench_draw(&seed) - 0.5;

        sections[i] = (struct section){
            .x = (i % BENCH_COLUMNS + 0.5) * width / BENCH_COLUMNS + 0.01 * width * jitter_x,
            .y = (i / BENCH_COLUMNS + 0.5) * height / BENCH_ROWS + 0.01 * width * jitter_y,
            .cos = cos(turn),
            .sin = sin(turn),
            .scale = width / 8000.0,
            .mirrored = i % 7 == 3,
            .phase = i,
        };
        for (int m = 0; m < 3; m++)
            panel.mark[i][m] = place(&sections[i], MARKS[m]);
    }
    for (int m = 0; m < 3; m++)
        panel.triangle_um[m] = (struct gsn_point){ 5 * MARKS[m].x, 5 * MARKS[m].y };
    for (uint32_t y = 0; y < height; y++)
        draw_row(&panel, sections, y);
    draw_dust(panel.image, &seed);
    return panel;
}

void bench_panel_done(struct bench_panel *panel)
{
    gsn_image_free(panel->image);
}
