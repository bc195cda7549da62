/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Profiles made here, some by hand and some by Little CMS, around pictures whose samples are known.
 */
#include "pipeline/decode/apart.h"
#include "pipeline/decode/icc.h"

#include "tests/check.h"
#include "tests/decode/make.h"

#include <lcms2.h>
#include <string.h>
#include <zlib.h>

static const struct gsn_decode_limits LIGHT = { .light = 1 };

/* gives */
static struct made saved(cmsHPROFILE profile)
{
    struct made made = { NULL, 0 };
    cmsUInt32Number size = 0;

    CHECK(cmsSaveProfileToMem(profile, NULL, &size) && size > 0);
    made.bytes = gsn_alloc_array(size, 1);
    CHECK(cmsSaveProfileToMem(profile, made.bytes, &size));
    made.size = size;
    (void)cmsCloseProfile(profile);
    return made;
}

static void profile_free(struct made *made)
{
    gsn_free(made->bytes);
}
#define auto_profile __attribute__((cleanup(profile_free))) struct made

static cmsHPROFILE of_curve(cmsToneCurve *curve)
{
    const cmsCIExyY white = { 0.3127, 0.3290, 1 };
    const cmsCIExyYTRIPLE primaries = { { 0.64, 0.33, 1 }, { 0.30, 0.60, 1 }, { 0.15, 0.06, 1 } };
    cmsToneCurve *const curves[3] = { curve, curve, curve };
    cmsHPROFILE profile = cmsCreateRGBProfile(&white, &primaries, curves);

    cmsFreeToneCurve(curve);
    return profile;
}

static cmsHPROFILE of_gamma(double gamma)
{
    return of_curve(cmsBuildGamma(NULL, gamma));
}

/* ---- by hand ------------------------------------------------------------------------------- */

static void put(uint8_t *at, uint32_t value)
{
    for (int i = 0; i < 4; i++)
        at[i] = (uint8_t)(value >> (24 - 8 * i));
}

/* ICC.1:2001-04: a header of 128 bytes, seven tags of 12, then what they point at: the primaries
 * and the white in s15Fixed16, one curve of one u8Fixed8 number, and a description. */
static struct made by_hand(void)
{
    static const char names[] = "rXYZgXYZbXYZwtptrTRCgTRCbTRCdesc";
    static const double xyz[4][3] = { { 0.4361, 0.2225, 0.0139 },
                                      { 0.3851, 0.7169, 0.0971 },
                                      { 0.1431, 0.0606, 0.7141 },
                                      { 0.9642, 1.0000, 0.8249 } };
    enum { FIRST = 128 + 4 + 8 * 12, CURVE = FIRST + 4 * 20, TEXT = CURVE + 16, SIZE = TEXT + 112 };
    struct made made = { gsn_alloc_array(SIZE, 1), SIZE };
    uint8_t *at = made.bytes;

    put(at, SIZE);
    put(at + 8, 0x02100000);
    memcpy(at + 12, "scnrRGB XYZ ", 12);
    memcpy(at + 36, "acsp", 4);
    put(at + 68, 0xf6d6);
    put(at + 72, 0x10000);
    put(at + 76, 0xd32d);
    put(at + 128, 8);
    for (uint32_t i = 0; i < 8; i++) {
        memcpy(at + 132 + 12 * i, names + 4 * i, 4);
        put(at + 136 + 12 * i, i < 4 ? FIRST + 20 * i : i < 7 ? CURVE : TEXT);
        put(at + 140 + 12 * i, i < 4 ? 20 : i < 7 ? 14 : 112);
    }
    for (int i = 0; i < 4; i++) {
        memcpy(at + FIRST + 20 * i, "XYZ ", 4);
        for (int c = 0; c < 3; c++)
            put(at + FIRST + 20 * i + 8 + 4 * c, (uint32_t)(xyz[i][c] * 65536 + 0.5));
    }
    memcpy(at + CURVE, "curv", 4);
    put(at + CURVE + 8, 1);
    at[CURVE + 12] = 1; /* 1.8 in 256ths */
    at[CURVE + 13] = 205;
    memcpy(at + TEXT, "desc", 4);
    put(at + TEXT + 8, 12);
    memcpy(at + TEXT + 12, "Bench scan\x07", 11);
    return made;
}

/* ---- pictures ------------------------------------------------------------------------------ */

static struct gsn_picture *decoded(const struct made *file, const struct gsn_decode_limits *limits)
{
    struct gsn_picture *picture = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_decode(file->bytes, file->size, limits, &picture, &err), err);
    return picture;
}

static double power_error(const struct gsn_image *raw, const struct gsn_image *light, double gamma)
{
    const double top = raw->bits == 8 ? 255 : 65535;
    double worst = 0;

    CHECK(light->bits == 16 && light->width == raw->width && light->height == raw->height);
    for (uint32_t y = 0; y < raw->height; y++)
        for (uint32_t x = 0; x < raw->width; x++)
            for (unsigned c = 0; c < 3; c++)
                worst = fmax(worst, fabs(gsn_image_at(light, x, y, c) -
                                         65535 * pow(gsn_image_at(raw, x, y, c) / top, gamma)));
    return worst;
}

static void check_gamma(const struct made *file)
{
    gsn_auto(gsn_picture) raw = decoded(file, NULL);
    gsn_auto(gsn_picture) light = decoded(file, &LIGHT);

    CHECK(raw->transfer == GSN_TRANSFER_ICC);
    CHECK(light->transfer == GSN_TRANSFER_PROFILE);
    assert_string_equal(light->profile, "Bench scan?");
    /* 205 / 256 is 1.8008; a code that is not 0 stays above it. */
    CHECK(power_error(raw->image, light->image, 1 + 205 / 256.0) < 1.5);
}

TEST(a_hand_made_gamma_of_1_8_is_undone_in_every_container)
{
    static uint8_t chunk[6000] = "hand\0";
    auto_profile profile = by_hand();
    struct made packed = { chunk, sizeof chunk - 6 };
    uLongf size = sizeof chunk - 6;

    CHECK(compress(chunk + 6, &size, profile.bytes, profile.size) == Z_OK);
    packed.size = 6 + size;
    for (uint32_t bits = 8; bits <= 16; bits += 8) {
        gsn_auto(gsn_image) image = make_picture(64, 40, 3, bits);
        auto_made tiff = make_tiff(image, &(struct tiff_recipe){ .icc = &profile });
        auto_made png = make_png(image, &(struct png_recipe){ .icc = &packed });

        check_gamma(&tiff);
        check_gamma(&png);
        if (bits == 8) {
            auto_made jpeg = make_jpeg(image, &(struct jpeg_recipe){ .icc = &profile });

            check_gamma(&jpeg);
        }
    }
}

/* Little CMS itself, from the profile to linear light in the same primaries. */
TEST(the_light_is_that_of_little_cms)
{
    auto_profile profile = saved(of_gamma(1.8));
    gsn_auto(gsn_image) image = make_picture(64, 40, 3, 8);
    auto_made file = make_tiff(image, &(struct tiff_recipe){ .icc = &profile });
    gsn_auto(gsn_picture) light = decoded(&file, &LIGHT);
    cmsHPROFILE from = cmsOpenProfileFromMem(profile.bytes, (cmsUInt32Number)profile.size);
    cmsHPROFILE to = of_gamma(1);
    cmsHTRANSFORM transform =
        cmsCreateTransform(from, TYPE_RGB_8, to, TYPE_RGB_DBL, INTENT_RELATIVE_COLORIMETRIC, 0);
    double worst = 0;

    for (uint32_t i = 0; i < 64 * 40; i++) {
        double theirs[3];

        cmsDoTransform(transform, (const uint8_t *)image->samples + 3 * (size_t)i, theirs, 1);
        for (int c = 0; c < 3; c++)
            worst = fmax(worst,
                         fabs(((const uint16_t *)light->image->samples)[3 * (size_t)i + (size_t)c] /
                                  65535.0 -
                              theirs[c]));
    }
    print_message("  worst difference to Little CMS %.6f of full light\n", worst);
    CHECK(worst < 0.001);
    cmsDeleteTransform(transform);
    (void)cmsCloseProfile(from);
    (void)cmsCloseProfile(to);
}

TEST(profiles_that_say_srgb_or_straight_leave_the_samples)
{
    auto_profile srgb = saved(cmsCreate_sRGBProfile());
    auto_profile straight = saved(of_gamma(1));
    gsn_auto(gsn_image) image = make_picture(64, 40, 3, 8);
    auto_made a = make_tiff(image, &(struct tiff_recipe){ .icc = &srgb });
    auto_made b = make_tiff(image, &(struct tiff_recipe){ .icc = &straight });
    gsn_auto(gsn_picture) one = decoded(&a, &LIGHT);
    gsn_auto(gsn_picture) two = decoded(&b, &LIGHT);

    CHECK(one->transfer == GSN_TRANSFER_SRGB && same_picture(one->image, image));
    CHECK(two->transfer == GSN_TRANSFER_LINEAR && same_picture(two->image, image));
    CHECK(strstr(one->profile, "sRGB") != NULL);
}

static void check_refused(const struct made *profile, const char *why)
{
    gsn_auto(gsn_image) image = make_picture(64, 40, 3, 8);
    auto_made file = make_tiff(image, &(struct tiff_recipe){ .icc = profile });
    gsn_auto(gsn_picture) picture = decoded(&file, &LIGHT);

    CHECK(picture->transfer == GSN_TRANSFER_ICC && same_picture(picture->image, image));
    if (!strstr(picture->profile, why))
        fail_msg("\"%s\" is not in \"%s\"", why, picture->profile);
}

TEST(a_bad_profile_is_refused_and_the_picture_is_not)
{
    static const cmsUInt16Number falling[3] = { 65535, 30000, 0 };
    auto_profile lab = saved(cmsCreateLab4Profile(NULL));
    auto_profile down = saved(of_curve(cmsBuildTabulatedToneCurve16(NULL, 3, falling)));
    auto_profile cut = saved(of_gamma(1.8));
    struct gsn_picture large = { .wants_profile = 1, .transfer = GSN_TRANSFER_UNKNOWN };
    const struct made junk = { (uint8_t *)(uintptr_t) "no profile", 10 };

    check_refused(&junk, "it cannot be read");
    check_refused(&lab, "it is");
    check_refused(&down, "its curves do not rise from dark to light");
    gsn_icc_keep(&large, "", GSN_ICC_MOST_BYTES + 1);
    CHECK(large.transfer == GSN_TRANSFER_ICC && large.icc == NULL);
    assert_string_equal(large.profile, "it has 4194305 bytes");
    cut.size /= 2;
    check_refused(&cut, "");
}

TEST(every_cut_and_every_changed_byte_of_a_profile_is_survived)
{
    auto_profile profile = by_hand();
    gsn_auto(gsn_image) image = make_picture(20, 11, 3, 8);

    for (size_t i = 0; i < profile.size; i += 3) {
        const uint8_t kept = profile.bytes[i];
        const struct made shorter = { profile.bytes, i + 1 };
        auto_made cut = make_tiff(image, &(struct tiff_recipe){ .icc = &shorter });

        gsn_picture_free(decoded(&cut, &LIGHT));
        profile.bytes[i] ^= 0xff;
        auto_made changed = make_tiff(image, &(struct tiff_recipe){ .icc = &profile });

        gsn_picture_free(decoded(&changed, &LIGHT));
        profile.bytes[i] = kept;
    }
}

TEST(in_the_sandbox_the_light_is_the_same)
{
    auto_profile profile = by_hand();
    gsn_auto(gsn_image) image = make_picture(300, 200, 3, 8);
    auto_made file = make_tiff(image, &(struct tiff_recipe){ .icc = &profile });
    gsn_auto(gsn_picture) here = decoded(&file, &LIGHT);
    gsn_auto(gsn_decoder) decoder = NULL;
    gsn_auto(gsn_picture) apart = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_decoder_new(GSN_DECODER, &decoder, &err), err);
    CHECK_OK(gsn_decode_apart(decoder, gsn_check_fd(file.bytes, file.size), &LIGHT, &apart, &err),
             err);
    CHECK(apart->transfer == GSN_TRANSFER_PROFILE && same_picture(apart->image, here->image));
    assert_string_equal(apart->profile, here->profile);
}

static int decode_once(const struct made *file, struct gsn_error *err)
{
    gsn_auto(gsn_picture) picture = NULL;

    return gsn_decode(file->bytes, file->size, &LIGHT, &picture, err);
}

TEST(running_out_of_memory_is_said_and_leaks_nothing)
{
    auto_profile profile = by_hand();
    gsn_auto(gsn_image) image = make_picture(20, 11, 3, 8);
    auto_made file = make_tiff(image, &(struct tiff_recipe){ .icc = &profile });
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(decode_once(&file, &err), err);
}
