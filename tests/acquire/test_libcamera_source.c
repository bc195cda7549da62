/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The kind "libcamera" on a machine that has no such camera, and in a build without the library.
 * (Frames come from a camera in the virtual bench.) */
#include "acquire/libcamera_source.h"

#include <stdio.h>
#include <string.h>

#include "tests/check.h"

static const struct gsn_source_setting settings[] = { { "Format", "YUYV" },
                                                      { "Width", "640" },
                                                      { "Height", "480" } };
static const struct gsn_source_options options = { .setting_count = 3, .setting = settings };

TEST(the_kind_is_known_and_its_settings_are_judged)
{
    const struct gsn_source_setting wrong = { "Focus", "1" };
    const struct gsn_source_options with = { .setting_count = 1, .setting = &wrong };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_source_check("libcamera:x", &options, &err), err);
    CHECK(gsn_source_check("libcamera:x", &with, &err) == GSN_E_INPUT);
    CHECK(strcmp(gsn_source_subsystem("libcamera:x"), "video4linux") == 0);
}

/* Twice: the first one gave back what there is one of in a process. */
TEST(a_camera_that_is_not_there_is_refused_cleanly_and_again)
{
    for (unsigned i = 0; i < 2; i++) {
        struct gsn_source *source = NULL;
        struct gsn_error err = { 0 };
        const int r = gsn_source_open("libcamera:\\_SB_.no-such-camera", &options, &source, &err);

        CHECK(source == NULL);
#ifdef GSN_WITHOUT_LIBCAMERA
        CHECK(r == GSN_E_UNSUPPORTED);
        CHECK(strstr(err.text, "was built without libcamera") != NULL);
#else
        CHECK(r == GSN_E_NOTFOUND);
        CHECK(strstr(err.text, "libcamera lists ") != NULL);
#endif
    }
}
