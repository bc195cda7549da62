/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Sections that nobody here drew: ../shared/data/stacks, with landmarks and printed dots. */
#include "pipeline/core/file.h"

#include "pipeline/core/robust.h"
#include "pipeline/decode/apart.h"
#include "pipeline/folder/register_folder.h"
#include "pipeline/register/pose/rigid.h"
#include "tests/check.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { LANDMARKS = 80, MOST_DOTS = 1500, SIDE = 600 };

static char *stack_path(const char *name)
{
    const char *shared = getenv("GIESON_SHARED");
    char path[1024];
    char *copy;

    (void)snprintf(path, sizeof path, "%s/data/stacks/%s", shared ? shared : GSN_SHARED, name);
    if (access(path, R_OK) < 0)
        gsn_check_skip("%s is not there", path);
    copy = gsn_strdup(path);
    CHECK(copy);
    return copy;
}

/* ---- Landmarks ---------------------------------------------------------------------------- */

/* One person's, in pixels of the picture, centres at whole numbers: the files are of pictures of
 * half size, these are of a twentieth. */
static void read_landmarks(const char *folder, const char *picture, struct gsn_point *ret)
{
    gsn_auto_mem(char) name =
        gsn_format("%s/landmarks-50pc-user-PS/%.*s.csv", folder, (int)strlen(picture) - 4, picture);
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size, n = 0;
    const char *line;

    CHECK_OK(gsn_file_read(name, 1 << 20, &bytes, &size, &err), err);
    bytes = gsn_realloc_array(bytes, size + 1, 1);
    CHECK(bytes);
    bytes[size] = 0;
    for (line = strchr((char *)bytes, '\n'); line && n < LANDMARKS; line = strchr(line + 1, '\n')) {
        double x, y;

        if (sscanf(line + 1, "%*d,%lf,%lf", &x, &y) != 2)
            break;
        ret[n++] = (struct gsn_point){ 0.1 * x, 0.1 * y };
    }
    CHECK(n == LANDMARKS);
}

struct spread {
    double median, rms;
};

static struct spread spread_of(const struct gsn_point *a, const struct gsn_point *b)
{
    double off[LANDMARKS], square = 0;

    for (int i = 0; i < LANDMARKS; i++) {
        off[i] = hypot(a[i].x - b[i].x, a[i].y - b[i].y);
        square += off[i] * off[i] / LANDMARKS;
    }
    return (struct spread){ gsn_median(off, LANDMARKS), sqrt(square) };
}

/* What the best rigid motion of these very landmarks leaves. */
static struct spread floor_of(const struct gsn_point *a, const struct gsn_point *b)
{
    struct gsn_point moved[LANDMARKS];
    struct gsn_error err = { 0 };
    struct gsn_rigid motion;

    CHECK_OK(gsn_rigid_fit(a, b, NULL, LANDMARKS, &motion, NULL, &err), err);
    for (int i = 0; i < LANDMARKS; i++)
        moved[i] = gsn_rigid_apply(&motion, a[i]);
    return spread_of(moved, b);
}

static struct spread by_poses(const struct gsn_folder_section *s, const struct gsn_point *a,
                              const struct gsn_folder_section *t, const struct gsn_point *b)
{
    const struct gsn_affine back = gsn_affine_inverse(&s->frame_to_px);
    const struct gsn_affine map = gsn_affine_compose(&back, &t->frame_to_px);
    struct gsn_point moved[LANDMARKS];

    for (int i = 0; i < LANDMARKS; i++)
        moved[i] = gsn_affine_apply(&map, a[i]);
    return spread_of(moved, b);
}

/* Five sections of a lung in five stains, without marks, beside the floor of the landmarks that a
 * person set: no rigid pose can be better there than their own best one. */
TEST(sections_of_five_stains_are_laid_by_tissue_nearly_as_well_as_by_their_landmarks)
{
    const struct gsn_folder_options options = { .by_tissue = 1 };
    gsn_auto_mem(char) folder = stack_path("lung-lesion3");
    gsn_auto(gsn_folder_stack) stack = NULL;
    static struct gsn_point mark[8][LANDMARKS];
    struct gsn_error err = { 0 };
    double ours = 0, least = 0, none = 0;
    int pairs = 0;

    CHECK_OK(gsn_folder_register(folder, &options, &stack, &err), err);
    CHECK(stack->count == 5 && stack->by_tissue == 5);
    for (size_t i = 0; i < stack->count; i++)
        read_landmarks(folder, stack->section[i].file, mark[i]);
    for (size_t i = 0; i < stack->count; i++)
        for (size_t j = 0; j < i; j++, pairs++) {
            const struct spread floor = floor_of(mark[j], mark[i]);
            const struct spread before = spread_of(mark[j], mark[i]);
            const struct spread found =
                by_poses(&stack->section[j], mark[j], &stack->section[i], mark[i]);

            print_message("  %-12.12s on %-12.12s: median %5.2f, rms %5.2f px; floor %5.2f, %5.2f; "
                          "as they come %5.2f, %5.2f\n",
                          stack->section[j].file + 15, stack->section[i].file + 15, found.median,
                          found.rms, floor.median, floor.rms, before.median, before.rms);
            ours += found.rms;
            least += floor.rms;
            none += before.rms;
            CHECK(found.rms < 1.5 * floor.rms);
        }
    print_message("  mean of %d pairs: %.2f px, %.2f times the rigid floor of %.2f; as they come "
                  "%.2f; %.1f ms a section\n",
                  pairs, ours / pairs, ours / least, least / pairs, none / pairs, stack->cpu_ms);
}

/* ---- Dots --------------------------------------------------------------------------------- */

static float mean_of(const struct gsn_image *image, int x, int y, int reach)
{
    float sum = 0;

    for (int v = y - reach; v <= y + reach; v++)
        for (int u = x - reach; u <= x + reach; u++)
            sum += (float)gsn_image_at(image, (uint32_t)u, (uint32_t)v, 0);
    return sum / (float)((2 * reach + 1) * (2 * reach + 1));
}

/* How much darker a disc of a dot's size is than what is around it. */
static void darkness(const struct gsn_image *image, float *ret)
{
    memset(ret, 0, (size_t)SIDE * SIDE * sizeof *ret);
    for (int y = 8; y < SIDE - 8; y++)
        for (int x = 8; x < SIDE - 8; x++) {
            const float wide = mean_of(image, x, y, 4);

            /* Only on glass: what is dark around shows tissue. */
            if (mean_of(image, x, y, 7) > 150)
                ret[y * SIDE + x] = wide - mean_of(image, x, y, 2);
        }
}

static int is_peak(const float *dark, int x, int y)
{
    for (int v = -3; v <= 3; v++)
        for (int u = -3; u <= 3; u++)
            if ((u || v) && dark[(y + v) * SIDE + x + u] >= dark[y * SIDE + x])
                return 0;
    return dark[y * SIDE + x] > 3;
}

static size_t find_dots(const char *folder, const char *name, struct gsn_point *ret)
{
    static float dark[SIDE * SIDE];
    gsn_auto_mem(char) path = gsn_format("%s/%s", folder, name);
    gsn_auto_fd fd = -1;
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };
    size_t n = 0;

    CHECK_OK(gsn_file_open(path, &fd, &err), err);
    CHECK_OK(gsn_decode_apart(NULL, fd, NULL, &picture, &err), err);
    CHECK(picture->image->width == SIDE && picture->image->height == SIDE);
    darkness(picture->image, dark);
    for (int y = 12; y < SIDE - 12; y++)
        for (int x = 12; x < SIDE - 12; x++) {
            double sum = 0, sx = 0, sy = 0;

            if (!is_peak(dark, x, y) || n == MOST_DOTS)
                continue;
            for (int v = -2; v <= 2; v++)
                for (int u = -2; u <= 2; u++) {
                    const double w = fmax((double)dark[(y + v) * SIDE + x + u], 0);

                    sum += w;
                    sx += w * u;
                    sy += w * v;
                }
            ret[n++] = (struct gsn_point){ x + sx / sum, y + sy / sum };
        }
    return n;
}

/* The dots of b that lie within reach of those of a after the motion. */
static size_t pair_up(const struct gsn_point *a, size_t na, const struct gsn_point *b, size_t nb,
                      const struct gsn_rigid *motion, double reach, struct gsn_point *ret_a,
                      struct gsn_point *ret_b)
{
    size_t n = 0;

    for (size_t i = 0; i < na; i++) {
        const struct gsn_point p = gsn_rigid_apply(motion, a[i]);
        double least = reach;
        size_t at = nb;

        for (size_t j = 0; j < nb; j++)
            if (hypot(p.x - b[j].x, p.y - b[j].y) < least) {
                least = hypot(p.x - b[j].x, p.y - b[j].y);
                at = j;
            }
        if (at < nb) {
            ret_a[n] = a[i];
            ret_b[n++] = b[at];
        }
    }
    return n;
}

/* The shift that lets most dots coincide: the frame's ends tell one period of the dots from the
 * next. */
static struct gsn_rigid best_shift(const struct gsn_point *a, size_t na, const struct gsn_point *b,
                                   size_t nb)
{
    static struct gsn_point p[MOST_DOTS], q[MOST_DOTS];
    struct gsn_rigid best = { 1, 0, 0, 0 };
    size_t most = 0;

    for (int dy = -24; dy <= 24; dy += 2)
        for (int dx = -24; dx <= 24; dx += 2) {
            const struct gsn_rigid shift = { 1, 0, dx, dy };
            const size_t n = pair_up(a, na, b, nb, &shift, 2, p, q);

            if (n > most) {
                most = n;
                best = shift;
            }
        }
    return best;
}

/* Four sections of one cortex on slides with a printed frame of dots: hundreds of fiducials in one
 * solution. The dots do not know the tissue, so this says how the slides lie, to the error of a dot
 * over the root of their number. */
TEST(sections_in_a_frame_of_dots_are_laid_by_all_dots_at_once)
{
    static const char *const names[] = { "151507.png", "151508.png", "151509.png", "151510.png" };
    static struct gsn_point dot[4][MOST_DOTS], p[MOST_DOTS], q[MOST_DOTS];
    gsn_auto_mem(char) folder = stack_path("dlpfc-donor1");
    struct gsn_error err = { 0 };
    size_t count[4];

    for (int i = 0; i < 4; i++)
        count[i] = find_dots(folder, names[i], dot[i]);
    for (int i = 1; i < 4; i++) {
        struct gsn_rigid motion = best_shift(dot[i - 1], count[i - 1], dot[i], count[i]);
        double rms = 0;
        size_t n = 0;

        for (int round = 0; round < 8; round++) {
            n = pair_up(dot[i - 1], count[i - 1], dot[i], count[i], &motion, 1.5, p, q);
            CHECK(n >= 50);
            CHECK_OK(gsn_rigid_fit(p, q, NULL, n, &motion, &rms, &err), err);
        }
        print_message("  %s on %s: %zu and %zu dots, %zu in common; left %.3f px, so the slide "
                      "lies to %.3f px in its middle; turned %.3f degrees, shift %.2f %.2f\n",
                      names[i - 1], names[i], count[i - 1], count[i], n, rms,
                      rms / sqrt((double)n - 1.5), atan2(motion.sin, motion.cos) * 180 / M_PI,
                      motion.dx, motion.dy);
        CHECK(rms < 0.6);
        CHECK(fabs(atan2(motion.sin, motion.cos)) < 0.01);
    }
}
