/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From code values to linear light by an embedded ICC profile (ICC.1), read by Little CMS.
 *
 * Steps: (1) the profile is opened from memory and refused unless it is of RGB, of a scanner,
 * camera, screen or colour space, and its curves, where it has some, rise from dark to light; (2)
 * tone curves that are sRGB's (IEC 61966-2-1) or straight, to half a step of 8 bits, only name the
 * transfer, the samples stay; (3) a profile of curves and a matrix becomes a table for each
 * channel, without the matrix; one of tables becomes a transform to linear light in the primaries
 * of sRGB, relative colorimetric; (4) samples are converted from the last to the first, over the
 * old ones where there is room.
 *
 * Failure: GSN_E_NOMEM; a profile that cannot be used is no failure, the picture says why. Cost: a
 * look-up a sample, or a transform a pixel. */
#include "pipeline/decode/icc.h"

#include "pipeline/core/srgb.h"

#include <lcms2.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

enum { CHANNELS = 3 };

/* A curve nearer than this to sRGB's or to a straight one all along is that curve: half a step of
 * 8 bits is 0.002. */
static const double SAME_CURVE = 0.002;

struct profile {
    cmsContext context;
    cmsHPROFILE handle;
    cmsToneCurve *curve[CHANNELS]; /* borrowed from the handle; NULL: a profile of tables */
};

void gsn_icc_keep(struct gsn_picture *picture, const void *bytes, size_t size)
{
    uint8_t *kept;

    picture->transfer = GSN_TRANSFER_ICC;
    if (!picture->wants_profile)
        return;
    if (size == 0) {
        (void)snprintf(picture->profile, sizeof picture->profile, "it cannot be read");
        return;
    }
    if (size > GSN_ICC_MOST_BYTES) {
        (void)snprintf(picture->profile, sizeof picture->profile, "it has %zu bytes", size);
        return;
    }
    kept = bytes ? gsn_memdup(bytes, size) : NULL;
    gsn_free(picture->icc);
    picture->icc = kept;
    picture->icc_size = size;
}

static void profile_done(struct profile *profile)
{
    if (profile->handle)
        (void)cmsCloseProfile(profile->handle);
    if (profile->context)
        cmsDeleteContext(profile->context);
}

static double decode_straight(double code)
{
    return code;
}

static double curve_at(const cmsToneCurve *curve, double code)
{
    return (double)cmsEvalToneCurveFloat(curve, (cmsFloat32Number)code);
}

static int follows_curve(const struct profile *profile, double (*truth)(double))
{
    for (int c = 0; c < CHANNELS; c++)
        for (int i = 0; i <= 255; i++)
            if (fabs(curve_at(profile->curve[c], i / 255.0) - truth(i / 255.0)) > SAME_CURVE)
                return 0;
    return 1;
}

/* Light rises with the code, from none to all; anything else would make up or destroy contrast. */
static int rises_throughout(const struct profile *profile)
{
    for (int c = 0; c < CHANNELS; c++) {
        double last = curve_at(profile->curve[c], 0);

        if (!(fabs(last) < 0.05) || !(fabs(curve_at(profile->curve[c], 1) - 1) < 0.05))
            return 0;
        for (int i = 1; i <= 255; i++) {
            const double next = curve_at(profile->curve[c], i / 255.0);

            if (!(next >= last))
                return 0;
            last = next;
        }
    }
    return 1;
}

/* Why the profile cannot be used; NULL: it can. */
static const char *open_profile(const struct gsn_picture *picture, struct profile *profile)
{
    static const cmsTagSignature tags[CHANNELS] = { cmsSigRedTRCTag, cmsSigGreenTRCTag,
                                                    cmsSigBlueTRCTag };

    profile->context = cmsCreateContext(NULL, NULL);
    if (profile->context)
        profile->handle = cmsOpenProfileFromMemTHR(profile->context, picture->icc,
                                                   (cmsUInt32Number)picture->icc_size);
    if (!profile->handle)
        return "it cannot be read";
    if (cmsGetDeviceClass(profile->handle) != cmsSigInputClass &&
        cmsGetDeviceClass(profile->handle) != cmsSigDisplayClass &&
        cmsGetDeviceClass(profile->handle) != cmsSigColorSpaceClass)
        return "it is of no scanner, camera, screen or colour space";
    if (cmsGetColorSpace(profile->handle) != cmsSigRgbData || picture->image->channels != CHANNELS)
        return "it is not one of RGB";
    if (!cmsIsMatrixShaper(profile->handle))
        return NULL;
    for (int c = 0; c < CHANNELS; c++) {
        profile->curve[c] = cmsReadTag(profile->handle, tags[c]);
        if (!profile->curve[c])
            return "a curve of it is missing";
    }
    return rises_throughout(profile) ? NULL : "its curves do not rise from dark to light";
}

static void name_profile(const struct profile *profile, struct gsn_picture *picture)
{
    char name[sizeof picture->profile] = "";

    (void)cmsGetProfileInfoASCII(profile->handle, cmsInfoDescription, "en", "US", name,
                                 sizeof name);
    name[sizeof name - 1] = '\0';
    for (size_t i = 0; name[i]; i++)
        if ((unsigned char)name[i] < ' ' || (unsigned char)name[i] > '~')
            name[i] = '?';
    (void)snprintf(picture->profile, sizeof picture->profile, "%s", name[0] ? name : "unnamed");
}

/* Where the 16-bit samples go: over the old ones where there is room behind them. */
static int make_room(struct gsn_picture *picture, const struct gsn_decode_limits *limits,
                     uint16_t **ret_to, struct gsn_error *err)
{
    const size_t samples = gsn_image_bytes(picture->image) / (picture->image->bits / 8);

    *ret_to = picture->image->samples;
    if (picture->image->bits == 16)
        return GSN_OK;
    if (2 * (uint64_t)samples > limits->most_bytes)
        *ret_to = NULL;
    else if (!picture->place) {
        *ret_to = gsn_alloc_array(samples, sizeof **ret_to);
        if (!*ret_to)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for the light of a picture");
    }
    return GSN_OK;
}

/* A code at either end of its range stays at that end, and no other gets there: what is clipped
 * must still be seen. */
static uint16_t *table_of(const cmsToneCurve *curve, unsigned top)
{
    uint16_t *table = gsn_alloc_array((size_t)top + 1, sizeof *table);

    for (unsigned i = 1; table && i < top; i++)
        table[i] =
            (uint16_t)fmin(fmax(floor(65535 * curve_at(curve, (double)i / top) + 0.5), 1), 65534);
    if (table)
        table[top] = 65535;
    return table;
}

/* From the last sample to the first, because the wider ones may lie over the narrower. */
static int apply_curves(const struct profile *profile, const struct gsn_image *image, uint16_t *to,
                        struct gsn_error *err)
{
    const unsigned top = image->bits == 8 ? 255 : 65535;
    const size_t samples = gsn_image_bytes(image) / (image->bits / 8);
    gsn_auto_mem(uint16_t) red = table_of(profile->curve[0], top);
    gsn_auto_mem(uint16_t) green = table_of(profile->curve[1], top);
    gsn_auto_mem(uint16_t) blue = table_of(profile->curve[2], top);
    const uint16_t *const table[CHANNELS] = { red, green, blue };

    if (!red || !green || !blue)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the curves of a profile");
    for (size_t i = samples; i-- > 0;) {
        const unsigned code = image->bits == 8 ? ((const uint8_t *)image->samples)[i]
                                               : ((const uint16_t *)image->samples)[i];

        to[i] = table[i % CHANNELS][code];
    }
    return GSN_OK;
}

static cmsHTRANSFORM to_linear_light(const struct profile *profile, unsigned bits)
{
    const cmsCIExyY white = { 0.3127, 0.3290, 1 };
    const cmsCIExyYTRIPLE primaries = { { 0.64, 0.33, 1 }, { 0.30, 0.60, 1 }, { 0.15, 0.06, 1 } };
    cmsToneCurve *const line = cmsBuildGamma(profile->context, 1);
    cmsToneCurve *const lines[CHANNELS] = { line, line, line };
    cmsHPROFILE linear = cmsCreateRGBProfileTHR(profile->context, &white, &primaries, lines);
    cmsHTRANSFORM transform =
        linear ? cmsCreateTransformTHR(profile->context, profile->handle,
                                       bits == 8 ? TYPE_RGB_8 : TYPE_RGB_16, linear, TYPE_RGB_16,
                                       INTENT_RELATIVE_COLORIMETRIC, cmsFLAGS_NOCACHE)
               : NULL;

    if (linear)
        (void)cmsCloseProfile(linear);
    cmsFreeToneCurve(line);
    return transform;
}

/* Row by row from the last, for the same reason. */
static int apply_tables(cmsHTRANSFORM transform, const struct gsn_image *image, uint16_t *to,
                        struct gsn_error *err)
{
    const size_t row = (size_t)image->width * CHANNELS, bytes = row * (image->bits / 8);
    gsn_auto_mem(uint8_t) kept = gsn_alloc_array(row, sizeof(uint16_t));

    if (!kept)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a row of a picture");
    for (size_t y = image->height; y-- > 0;) {
        memcpy(kept, (const uint8_t *)image->samples + y * bytes, bytes);
        cmsDoTransform(transform, kept, to + y * row, image->width);
    }
    return GSN_OK;
}

static int make_linear(const struct profile *profile, struct gsn_picture *picture, uint16_t *to,
                       struct gsn_error *err)
{
    cmsHTRANSFORM transform;
    int r;

    if (profile->curve[0])
        return apply_curves(profile, picture->image, to, err);
    transform = to_linear_light(profile, picture->image->bits);
    if (!transform)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "its tables lead nowhere");
    r = apply_tables(transform, picture->image, to, err);
    cmsDeleteTransform(transform);
    return r;
}

static int use_profile(const struct profile *profile, struct gsn_picture *picture,
                       const struct gsn_decode_limits *limits, struct gsn_error *err)
{
    struct gsn_image *image = picture->image;
    struct gsn_error why = { 0 };
    uint16_t *to;
    int r = make_room(picture, limits, &to, err);

    if (r < 0)
        return r;
    if (!to) {
        (void)snprintf(picture->profile, sizeof picture->profile,
                       "the picture is too large to be turned into linear light");
        return GSN_OK;
    }
    r = make_linear(profile, picture, to, &why);
    if (r < 0 && (void *)to != image->samples)
        gsn_free(to);
    if (r == GSN_E_UNSUPPORTED) {
        (void)snprintf(picture->profile, sizeof picture->profile, "%.90s", why.text);
        return GSN_OK;
    }
    if (r < 0)
        return gsn_fail(err, r, "%s", why.text);
    if ((void *)to != image->samples)
        gsn_free(image->samples);
    image->samples = to;
    image->bits = 16;
    name_profile(profile, picture);
    picture->transfer = GSN_TRANSFER_PROFILE;
    return GSN_OK;
}

int gsn_icc_apply(struct gsn_picture *picture, const struct gsn_decode_limits *limits,
                  struct gsn_error *err)
{
    __attribute__((cleanup(profile_done))) struct profile profile = { .handle = NULL };
    const char *why;

    if (picture->icc_size == 0)
        return GSN_OK;
    if (!picture->icc)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for an ICC profile");
    why = open_profile(picture, &profile);
    if (why) {
        (void)snprintf(picture->profile, sizeof picture->profile, "%s", why);
        return GSN_OK;
    }
    if (profile.curve[0] &&
        (follows_curve(&profile, gsn_light_of_srgb) || follows_curve(&profile, decode_straight))) {
        name_profile(&profile, picture);
        picture->transfer =
            follows_curve(&profile, gsn_light_of_srgb) ? GSN_TRANSFER_SRGB : GSN_TRANSFER_LINEAR;
        return GSN_OK;
    }
    return use_profile(&profile, picture, limits, err);
}
