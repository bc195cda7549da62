/* SPDX-License-Identifier: AGPL-3.0-or-later */
/* Selections that ImageJ saved (fixtures/roi, by MakeRois.java there), against the pixels that
 * ImageJ itself fills of them. */
#include "pipeline/specimen/drawn_region.h"

#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"
#include "tests/check.h"

#include <stdio.h>
#include <string.h>

enum { SIDE = 40, PLANES = 6, PLANE = 2, MOST = 1 << 20 };

static struct gsn_region region_of(const char *file, size_t planes, const char *class_name)
{
    return (struct gsn_region){ .kind = GSN_REGION_DRAWN,
                                .file = (char *)(uintptr_t)file,
                                .class_name = (char *)(uintptr_t)class_name,
                                .stack = { .nx = SIDE,
                                           .ny = SIDE,
                                           .nz = planes,
                                           .origin_um = { -500, 300, 36 },
                                           .step_um = { 8, 8, 24 } } };
}

/* gives: the fixture of that name. */
static uint8_t *read_fixture(const char *name, size_t *ret_size)
{
    gsn_auto_mem(char) path = gsn_format(GSN_FIXTURES "/roi/%s", name);
    struct gsn_error err = { 0 };
    uint8_t *bytes = NULL;

    CHECK_OK(gsn_file_read(path, MOST, &bytes, ret_size, &err), err);
    return bytes;
}

static int read_region(const char *name, size_t planes, const char *class_name,
                       struct gsn_mask **ret_mask, struct gsn_error *err)
{
    const struct gsn_region region = region_of(name, planes, class_name);
    char said[GSN_DRAWN_SENTENCE];
    size_t size = 0;
    gsn_auto_mem(uint8_t) bytes = read_fixture(name, &size);

    return gsn_drawn_region_read(&region, (const char *)bytes, size, ret_mask, said, err);
}

/* Pixels of the plane in which mask and ImageJ differ. */
static size_t count_differences(const struct gsn_mask *mask, size_t plane, const char *name)
{
    gsn_auto_mem(char) file = gsn_format("%.*s.txt", (int)strcspn(name, "."), name);
    size_t size = 0, differences = 0;
    gsn_auto_mem(uint8_t) rows = read_fixture(file, &size);

    CHECK(size == (size_t)SIDE * (SIDE + 1));
    for (size_t y = 0; y < SIDE; y++)
        for (size_t x = 0; x < SIDE; x++)
            differences +=
                mask->inside[(plane * SIDE + y) * SIDE + x] != (rows[y * (SIDE + 1) + x] == '#');
    return differences;
}

TEST(a_selection_has_the_pixels_that_imagej_fills)
{
    static const char *const names[] = { "polygon.roi",
                                         "freehand.roi",
                                         "traced.roi",
                                         "rectangle.roi",
                                         "rectangle_fraction.roi",
                                         "oval.roi",
                                         "oval_fraction.roi",
                                         "ellipse.roi",
                                         "rectangle_turned.roi",
                                         "ring.roi",
                                         "curves.roi",
                                         "hyperstack.roi",
                                         "group.roi",
                                         "RoiSet.zip" };

    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        gsn_auto(gsn_mask) mask = NULL;
        struct gsn_error err = { 0 };
        size_t on_plane = 0;

        CHECK_OK(read_region(names[i], PLANES, NULL, &mask, &err), err);
        for (size_t k = 0; k < (size_t)SIDE * SIDE; k++)
            on_plane += mask->inside[PLANE * SIDE * SIDE + k];
        printf("%s: %zu pixels, %zu differ\n", names[i], on_plane,
               count_differences(mask, PLANE, names[i]));
        CHECK(on_plane == gsn_mask_count(mask));
        CHECK(count_differences(mask, PLANE, names[i]) == 0);
    }
}

TEST(a_picture_of_one_slice_needs_none_said)
{
    gsn_auto(gsn_mask) mask = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(read_region("no_slice.roi", 1, NULL, &mask, &err), err);
    CHECK(gsn_mask_count(mask) == 21 * 13);
}

TEST(a_group_is_a_classification)
{
    gsn_auto(gsn_mask) mask = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(read_region("group.roi", PLANES, "7", &mask, &err), err);
    CHECK(read_region("oval.roi", PLANES, "7", &mask, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "no feature is of the classification \"7\"") != NULL);
}

TEST(what_is_no_region_is_refused_by_its_name)
{
    static const struct {
        const char *name, *says;
    } cases[] = {
        { "no_line.roi", "feature 1 is a \"line\", which has no area" },
        { "no_point.roi", "feature 1 is a \"point\"" },
        { "no_angle.roi", "feature 1 is a \"angle\"" },
        { "no_segments.roi", "feature 1 is a \"segmented line\"" },
        { "no_slice.roi", "feature 1 says no slice, and the stack has 6" },
        { "no_such_slice.roi", "z is 8, and \"size\" states 6 planes" },
        { "no_outside.roi", "feature 1 lies outside of the picture: the point (-3, 9)" },
        { "no_crossing.roi", "feature 1 crosses itself" },
        { "no_rounded.roi", "feature 1 is a rectangle with rounded corners" },
        { "no_spline.roi", "feature 1 is an outline that ImageJ fits a spline to" },
        { "no_other_file.zip", "\"notes.txt\" in it is no selection of ImageJ" },
        { "no_bomb.zip", "\"0001.roi\" in it has 9437184 bytes" },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct gsn_mask *mask = NULL;
        struct gsn_error err = { 0 };

        CHECK(read_region(cases[i].name, PLANES, NULL, &mask, &err) == GSN_E_INPUT && !mask);
        printf("%s\n", err.text);
        CHECK(strstr(err.text, cases[i].says) != NULL);
        CHECK(strncmp(err.text, cases[i].name, strlen(cases[i].name)) == 0);
    }
}

/* Cut or with a changed byte, a sound file is read or refused, and nothing else. */
TEST(damaged_selections_are_read_or_refused_and_never_more)
{
    static const char *const names[] = {
        "freehand.roi",           "ring.roi",  "curves.roi", "ellipse.roi",
        "rectangle_fraction.roi", "RoiSet.zip"
    };
    static const uint8_t others[] = { 0, 1, 0x7f, 0x80, 0xff };

    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        const struct gsn_region region = region_of(names[i], PLANES, NULL);
        size_t size = 0, refused = 0, tried = 0;
        gsn_auto_mem(uint8_t) bytes = read_fixture(names[i], &size);

        for (size_t at = 0; at < size; at += 1 + at / 64)
            for (size_t k = 0; k <= sizeof others; k++, tried++) {
                gsn_auto(gsn_mask) mask = NULL;
                char said[GSN_DRAWN_SENTENCE];
                struct gsn_error err = { 0 };
                /* Nothing behind what is left. */
                gsn_auto_mem(uint8_t) left = gsn_memdup(bytes, k < sizeof others ? size : at);
                int r;

                if (k < sizeof others)
                    left[at] = others[k];
                r = gsn_drawn_region_read(&region, (const char *)left,
                                          k < sizeof others ? size : at, &mask, said, &err);
                CHECK((r == GSN_OK && mask) || (r == GSN_E_INPUT && !mask && err.text[0]));
                refused += r < 0;
            }
        printf("%s: %zu of %zu refused\n", names[i], refused, tried);
        CHECK(refused > tried / 20 && refused < tried);
    }
}

struct given {
    const char *name;
    uint8_t *bytes;
    size_t size;
};

static int read_given(const struct given *given, struct gsn_error *err)
{
    const struct gsn_region region = region_of(given->name, PLANES, NULL);
    gsn_auto(gsn_mask) mask = NULL;
    char said[GSN_DRAWN_SENTENCE];

    return gsn_drawn_region_read(&region, (const char *)given->bytes, given->size, &mask, said,
                                 err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    static const char *const names[] = { "ring.roi", "RoiSet.zip" };

    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        struct given given = { .name = names[i] };
        gsn_auto_mem(uint8_t) bytes = read_fixture(names[i], &given.size);
        struct gsn_error err = { 0 };

        given.bytes = bytes;
        CHECK_EVERY_OOM(read_given(&given, &err), err);
    }
}
