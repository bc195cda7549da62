/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/imaging/components.h"
#include "pipeline/imaging/filter.h"
#include "pipeline/imaging/fourier.h"
#include "pipeline/imaging/imaging.h"
#include "pipeline/imaging/morphology.h"
#include "pipeline/imaging/warp.h"

#include "pipeline/core/sandbox.h"
#include "tests/check.h"

#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

enum { SIDE = 300, PIXELS = SIDE * SIDE };

/* Every operation once; whether all went well. */
static int work(void)
{
    static uint8_t set[PIXELS];
    static float number[2 * PIXELS];
    const struct gsn_plane plane = { SIDE, SIDE, number };
    static float slope[2 * SIDE * SIDE];
    struct gsn_image picture = { SIDE, SIDE, 1, 8, set };
    gsn_auto(gsn_components) all = NULL;
    gsn_auto(gsn_plane) mean = NULL;

    set[SIDE * 40 + 50] = 1;
    return gsn_dilate(set, SIDE, SIDE, 6.5, NULL) >= 0 &&
           gsn_dilate(set, SIDE, SIDE, 20, NULL) >= 0 && gsn_erode(set, SIDE, SIDE, 3, NULL) >= 0 &&
           gsn_erode(set, SIDE, SIDE, 15, NULL) >= 0 &&
           gsn_fill_holes(set, SIDE, SIDE, 8, NULL) >= 0 &&
           gsn_components_find(set, SIDE, SIDE, &all, NULL) >= 0 && all->count == 1 &&
           gsn_median_3(set, SIDE, SIDE, NULL) >= 0 &&
           gsn_differences(number, SIDE, SIDE, 0.5, slope, slope + SIDE * SIDE, NULL) >= 0 &&
           gsn_turn_image(&picture, 1, 1, NULL) >= 0 && gsn_box_mean(&plane, 3, &mean, NULL) >= 0 &&
           gsn_fourier(number, SIDE, SIDE, 0, NULL) >= 0;
}

/* Behind the wall nothing can be opened and no thread be started: who tries is killed. */
TEST(opened_before_it_works_in_a_sandbox)
{
    const pid_t child = fork();
    int status = -1;

    CHECK(child >= 0);
    if (child == 0) {
        struct gsn_error err = { 0 };

        gsn_imaging_open();
        _exit(gsn_sandbox_enter(2, 0, &err) < 0 ? 3 : work() ? 0 : 2);
    }
    CHECK(waitpid(child, &status, 0) == child);
    CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

TEST(the_version_is_that_of_opencv_4)
{
    CHECK(strncmp(gsn_imaging_version(), "4.", 2) == 0);
}
