/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include "pipeline/core/file.h"
#include "pipeline/decode/decode.h"
#include "tests/decode/awkward_files.h"
#include "tests/decode/make.h"

#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define FOLDER GSN_SHARED "/data/images/"

enum { FILES = sizeof awkward_files / sizeof awkward_files[0] };

static void need_folder(void)
{
    if (access(FOLDER, R_OK) == 0)
        return;
    gsn_check_skip("%s is not there", FOLDER);
}

static struct made load(const char *name)
{
    gsn_auto_mem(char) path = gsn_format("%s%s", FOLDER, name);
    struct gsn_error err = { 0 };
    struct made made = { 0 };

    CHECK_OK(gsn_file_read(path, 16 << 20, &made.bytes, &made.size, &err), err);
    return made;
}

static struct gsn_picture *decode(const char *name)
{
    auto_made file = load(name);
    struct gsn_picture *picture = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_decode(file.bytes, file.size, NULL, &picture, &err), err);
    return picture;
}

TEST(every_awkward_file_ends_as_the_table_says)
{
    size_t wrong = 0;

    need_folder();
    for (size_t i = 0; i < FILES; i++) {
        const struct awkward_file *file = &awkward_files[i];
        auto_made bytes = load(file->file);
        struct gsn_error said = { 0 };
        uint64_t peak = 0;
        const int code = decode_in_child(bytes.bytes, bytes.size, (uint64_t)1 << 30, &said, &peak);

        if (code == file->code && strncmp(said.text, file->sentence, strlen(file->sentence)) == 0 &&
            (code < 0 || strcmp(said.text, file->sentence) == 0) && peak < (uint64_t)1 << 30)
            continue;
        print_error("%s: %d \"%s\" (peak %llu), should be %d \"%s\"\n", file->file, code, said.text,
                    (unsigned long long)peak, file->code, file->sentence);
        wrong++;
    }
    CHECK(wrong == 0);
}

TEST(each_sentence_fits_on_one_line)
{
    need_folder();
    for (size_t i = 0; i < FILES; i++) {
        auto_made bytes = load(awkward_files[i].file);
        gsn_auto(gsn_picture) picture = NULL;
        struct gsn_error err = { 0 };

        if (gsn_decode(bytes.bytes, bytes.size, NULL, &picture, &err) == GSN_OK)
            continue;
        CHECK(strlen(err.text) > 10 && strlen(err.text) < 200 && !strchr(err.text, '\n'));
        CHECK(picture == NULL);
    }
}

/* The photo upside down is 40 to 60 levels away, so 6 tells every orientation from the others. */
TEST(every_hopper_is_the_same_photo)
{
    static const struct {
        const char *name;
        double most;
    } hoppers[] = {
        { "hopper.tif", 0.1 },
        { "hopper_bigtiff.tif", 0.1 },
        { "hopper.iccprofile.tif", 0.1 },
        { "hopper_orientation_3.jpg", 6 },
        { "hopper_orientation_6.jpg", 6 },
        { "hopper_orientation_8.jpg", 6 },
    };
    gsn_auto(gsn_picture) truth = NULL;

    need_folder();
    truth = decode("hopper.jpg");
    for (size_t i = 0; i < sizeof hoppers / sizeof hoppers[0]; i++) {
        gsn_auto(gsn_picture) hopper = decode(hoppers[i].name);
        const double difference = mean_difference(truth->image, hopper->image);

        CHECK_NEAR(difference, hoppers[i].most / 2, hoppers[i].most / 2);
    }
}

TEST(tiles_planes_and_strips_hold_the_same_picture)
{
    gsn_auto(gsn_picture) tiled = NULL;
    gsn_auto(gsn_picture) planes = NULL;
    gsn_auto(gsn_picture) strips = NULL;

    need_folder();
    tiled = decode("tiff_tiled_raw.tif");
    planes = decode("tiff_tiled_planar_raw.tif");
    strips = decode("tiff_strip_planar_lzw.tiff");
    CHECK(tiled->image->width == 278 && tiled->image->height == 374);
    CHECK(same_picture(tiled->image, planes->image));
    CHECK(same_picture(tiled->image, strips->image));
}

/* The high bytes of one are the samples of the other, within most. */
static void check_high_bytes(const char *wide_name, const char *narrow_name, int most)
{
    gsn_auto(gsn_picture) wide = decode(wide_name);
    gsn_auto(gsn_picture) narrow = decode(narrow_name);
    const struct gsn_image *a = wide->image, *b = narrow->image;
    int worst = 0;

    CHECK(a->bits == 16 && b->bits == 8);
    CHECK(a->width == b->width && a->height == b->height && a->channels == b->channels);
    for (uint32_t y = 0; y < a->height; y++)
        for (uint32_t x = 0; x < a->width; x++)
            for (uint32_t c = 0; c < a->channels; c++) {
                const int d = (int)(gsn_image_at(a, x, y, c) >> 8) - (int)gsn_image_at(b, x, y, c);

                worst = abs(d) > worst ? abs(d) : worst;
            }
    CHECK(worst <= most);
}

TEST(sixteen_bits_agree_with_their_eight_bit_twin)
{
    need_folder();
    check_high_bytes("tiff_16bit_RGB.tiff", "tiff_16bit_RGB_target.png", 0);
    check_high_bytes("rgb-3c-16b.tiff", "rgb-3c-8b.tiff", 1);
}

TEST(an_embedded_profile_and_the_resolution_are_stated)
{
    gsn_auto(gsn_picture) picture = NULL;

    need_folder();
    picture = decode("hopper.iccprofile.tif");
    CHECK(picture->transfer == GSN_TRANSFER_ICC);
    CHECK_NEAR(picture->px_um_x, 25400.0 / 96, 1e-3);
    CHECK_NEAR(picture->px_um_y, 25400.0 / 96, 1e-3);
}
