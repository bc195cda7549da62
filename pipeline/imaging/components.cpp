/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Labels by cv::connectedComponents (block-based scan, Grana et al. 2010; which label a component
 * gets depends on the blocks). They are numbered anew by their first pixels, the pixels are listed
 * by a counting sort, and each list is measured: box, centre, and the axes of the ellipse with the
 * same second moments, a pixel being a square and not a point. Linear in the number of pixels. */
#include "pipeline/imaging/components.h"

#include <algorithm>
#include <cmath>

#include "pipeline/imaging/opencv.hpp"

void gsn_components_free(struct gsn_components *components)
{
    if (!components)
        return;
    gsn_free(components->component);
    gsn_free(components->pixel);
    gsn_free(components);
}

static void measure_component(const uint32_t *pixel, uint32_t width, struct gsn_component *c)
{
    const double n = static_cast<double>(c->area);
    double sum_x = 0, sum_y = 0, xx = 0, yy = 0, xy = 0;
    int x0 = static_cast<int>(width), x1 = 0;

    for (size_t i = 0; i < c->area; i++) {
        const int x = static_cast<int>(pixel[i] % width);

        sum_x += x;
        sum_y += pixel[i] / width;
        x0 = std::min(x0, x);
        x1 = std::max(x1, x);
    }
    c->x = x0;
    c->width = x1 + 1 - x0;
    c->y = static_cast<int>(pixel[0] / width);
    c->height = static_cast<int>(pixel[c->area - 1] / width) + 1 - c->y;
    for (size_t i = 0; i < c->area; i++) {
        const double x = pixel[i] % width - sum_x / n, y = pixel[i] / width - sum_y / n;

        xx += x * x;
        yy += y * y;
        xy += x * y;
    }
    xx = xx / n + 1.0 / 12;
    yy = yy / n + 1.0 / 12;
    xy /= n;

    const double half = std::hypot((xx - yy) / 2, xy), turn = std::atan2(2 * xy, xx - yy) / 2;

    c->cx = sum_x / n + 0.5;
    c->cy = sum_y / n + 0.5;
    c->length = 4 * std::sqrt((xx + yy) / 2 + half);
    c->breadth = 4 * std::sqrt(std::max((xx + yy) / 2 - half, 0.0));
    c->along_x = std::cos(turn);
    c->along_y = std::sin(turn);
}

/* Lists the pixels of labels 1 to count by component, in the order of first pixels. place: for each
 * label 1 + the component's number, zeroed. */
static void list_pixels(const int *label, size_t pixels, uint32_t *place,
                        struct gsn_components *all)
{
    size_t next = 0, first = 0;

    for (size_t i = 0; i < pixels; i++)
        if (label[i] > 0) {
            uint32_t *const at = &place[label[i]];

            if (*at == 0)
                *at = static_cast<uint32_t>(++next);
            all->component[*at - 1].area++;
        }
    for (size_t c = 0; c < all->count; c++) {
        all->component[c].first = first;
        first += all->component[c].area;
        all->component[c].area = 0;
    }
    for (size_t i = 0; i < pixels; i++)
        if (label[i] > 0) {
            struct gsn_component *const c = &all->component[place[label[i]] - 1];

            all->pixel[c->first + c->area++] = static_cast<uint32_t>(i);
        }
}

int gsn_components_find(const uint8_t *set, uint32_t width, uint32_t height,
                        struct gsn_components **ret_components, struct gsn_error *err)
{
    const size_t pixels = static_cast<size_t>(width) * height;
    auto *const all =
        static_cast<struct gsn_components *>(gsn_alloc_array(1, sizeof(struct gsn_components)));
    auto *const label = static_cast<int *>(gsn_alloc_array(pixels, sizeof(int)));
    uint32_t *place = nullptr;
    int labels = 1;
    size_t inside = 0;
    int r = all && label ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for labels");

    if (r >= 0)
        r = gsn::guarded(err, [&] {
            cv::Mat to = gsn::over(label, width, height, CV_32S);

            labels = cv::connectedComponents(gsn::over(set, width, height, CV_8U), to, 8, CV_32S);
        });
    if (r >= 0) {
        for (size_t i = 0; i < pixels; i++)
            inside += label[i] > 0;
        all->width = width;
        all->count = static_cast<size_t>(labels) - 1;
        place = static_cast<uint32_t *>(
            gsn_alloc_array(static_cast<size_t>(labels), sizeof(uint32_t)));
        all->component = static_cast<struct gsn_component *>(
            gsn_alloc_array(all->count + 1, sizeof(struct gsn_component)));
        all->pixel = static_cast<uint32_t *>(gsn_alloc_array(inside + 1, sizeof(uint32_t)));
        if (!place || !all->component || !all->pixel)
            r = gsn_fail(err, GSN_E_NOMEM, "out of memory for labels");
    }
    if (r >= 0) {
        list_pixels(label, pixels, place, all);
        for (size_t c = 0; c < all->count; c++)
            measure_component(all->pixel + all->component[c].first, width, &all->component[c]);
        *ret_components = all;
    } else {
        gsn_components_free(all);
    }
    gsn_free(label);
    gsn_free(place);
    return r;
}
