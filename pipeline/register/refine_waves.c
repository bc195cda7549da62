/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/refine_parts.h"

#include <math.h>
#include <string.h>

int gsn_waves_init(struct gsn_waves *w, size_t side, size_t most)
{
    *w = (struct gsn_waves){ .side = side, .most = most };
    w->cosine = gsn_alloc_array(side, sizeof *w->cosine);
    w->sine = gsn_alloc_array(side, sizeof *w->sine);
    if (!w->cosine || !w->sine)
        return GSN_E_NOMEM;
    for (size_t i = 0; i < side; i++) {
        w->cosine[i] = (float)cos(2 * M_PI * (double)i / (double)side);
        w->sine[i] = (float)sin(2 * M_PI * (double)i / (double)side);
    }
    return GSN_OK;
}

void gsn_waves_done(struct gsn_waves *w)
{
    gsn_free(w->cosine);
    gsn_free(w->sine);
}

static size_t rows_of(const struct gsn_waves *w)
{
    return 2 * w->most + 1;
}

size_t gsn_waves_count(const struct gsn_waves *w)
{
    return (w->most + 1) * rows_of(w);
}

double gsn_waves_times(const struct gsn_waves *w, size_t i)
{
    return i / rows_of(w) > 0 ? 2 : 1;
}

size_t gsn_waves_ring(const struct gsn_waves *w, size_t i)
{
    const double u = (double)(i / rows_of(w)), v = (double)(i % rows_of(w)) - (double)w->most;

    return (size_t)(hypot(u, v) + 0.5);
}

/* Row frequency of the row-th pair, as a step through the tables. */
static size_t step_of(const struct gsn_waves *w, size_t row)
{
    return (row + w->side - w->most) % w->side;
}

void gsn_waves_of(const struct gsn_waves *w, const float *plane, float *scratch, float *ret_pairs)
{
    const size_t n = w->side, columns = w->most + 1, rows = rows_of(w);

    memset(scratch, 0, 2 * n * columns * sizeof *scratch);
    for (size_t u = 0; u < columns; u++)
        for (size_t y = 0; y < n; y++) {
            float re = 0, im = 0;

            for (size_t x = 0, at = 0; x < n; x++) {
                re += plane[y * n + x] * w->cosine[at];
                im -= plane[y * n + x] * w->sine[at];
                at += u;
                at -= at >= n ? n : 0;
            }
            scratch[2 * (u * n + y)] = re;
            scratch[2 * (u * n + y) + 1] = im;
        }
    for (size_t u = 0; u < columns; u++)
        for (size_t v = 0; v < rows; v++) {
            const size_t step = step_of(w, v);
            float re = 0, im = 0;

            for (size_t y = 0, at = 0; y < n; y++) {
                const float a = scratch[2 * (u * n + y)], b = scratch[2 * (u * n + y) + 1];

                re += a * w->cosine[at] + b * w->sine[at];
                im += b * w->cosine[at] - a * w->sine[at];
                at += step;
                at -= at >= n ? n : 0;
            }
            ret_pairs[2 * (u * rows + v)] = re;
            ret_pairs[2 * (u * rows + v) + 1] = im;
        }
}

void gsn_waves_back(const struct gsn_waves *w, const float *pairs, float *scratch, float *ret_plane)
{
    const size_t n = w->side, columns = w->most + 1, rows = rows_of(w);
    const float scale = 1 / (float)(n * n);

    for (size_t u = 0; u < columns; u++)
        for (size_t y = 0; y < n; y++) {
            float re = 0, im = 0;

            for (size_t v = 0; v < rows; v++) {
                const size_t at = step_of(w, v) * y % n;
                const float a = pairs[2 * (u * rows + v)], b = pairs[2 * (u * rows + v) + 1];

                re += a * w->cosine[at] - b * w->sine[at];
                im += b * w->cosine[at] + a * w->sine[at];
            }
            scratch[2 * (u * n + y)] = re;
            scratch[2 * (u * n + y) + 1] = im;
        }
    memset(ret_plane, 0, n * n * sizeof *ret_plane);
    for (size_t u = 0; u < columns; u++)
        for (size_t y = 0; y < n; y++) {
            const float times = u > 0 ? 2 * scale : scale;
            const float re = times * scratch[2 * (u * n + y)];
            const float im = times * scratch[2 * (u * n + y) + 1];

            for (size_t x = 0, at = 0; x < n; x++) {
                ret_plane[y * n + x] += re * w->cosine[at] - im * w->sine[at];
                at += u;
                at -= at >= n ? n : 0;
            }
        }
}
