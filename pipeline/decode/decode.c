/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A picture file from its bytes to samples that may be used.
 *
 * Steps: (1) the kind, by the bytes that such files begin with; kinds without a decoder are known
 * so that the refusal can name them; (2) the codec of that kind fills the picture through raster.h;
 * (3) what no scan has is refused: transparent pixels, one value everywhere; 16-bit samples of
 * which the upper bits are never used are remarked on; (4) printed codes (codes.c) and (5) the
 * embedded ICC profile (icc.c), where asked for.
 *
 * Failure: one sentence from whoever refused; nothing of the picture is given then. Cost: the
 * codec's, and for 16 bits one more pass over the samples. */
#include "pipeline/decode/decode.h"

#include "pipeline/decode/codes.h"
#include "pipeline/decode/icc.h"
#include "pipeline/decode/raster.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>

typedef int decode_body(struct gsn_bytes file, const struct gsn_decode_limits *limits,
                        struct gsn_picture *picture, struct gsn_error *err);

/* How files begin. Those without a decoder are known only so that the refusal can name them. */
static const struct kind {
    const char *name;
    size_t at, size;
    const char *bytes;
    decode_body *decode;
} kinds[] = {
    { "JPEG", 0, 3, "\xff\xd8\xff", gsn_jpeg_decode },
    { "PNG", 0, 8, "\x89PNG\r\n\x1a\n", gsn_png_decode },
    { "TIFF", 0, 4, "II*\0", gsn_tiff_decode },
    { "TIFF", 0, 4, "MM\0*", gsn_tiff_decode },
    { "BigTIFF", 0, 4, "II+\0", gsn_tiff_decode },
    { "BigTIFF", 0, 4, "MM\0+", gsn_tiff_decode },
    { "PAM", 0, 3, "P7\n", gsn_pam_decode },
    { "PDF", 0, 5, "%PDF-", NULL },
    { "JPEG 2000", 0, 8, "\0\0\0\x0cjP  ", NULL },
    { "JPEG 2000", 0, 4, "\xff\x4f\xff\x51", NULL },
    { "HEIF or AVIF", 4, 4, "ftyp", NULL },
    { "WebP", 8, 4, "WEBP", NULL },
    { "GIF", 0, 4, "GIF8", NULL },
    { "BMP", 0, 2, "BM", NULL },
    { "DICOM", 128, 4, "DICM", NULL },
    { "Zeiss CZI", 0, 10, "ZISRAWFILE", NULL },
};

static const struct kind *sniff(struct gsn_bytes file)
{
    for (size_t i = 0; i < sizeof kinds / sizeof kinds[0]; i++) {
        const struct kind *kind = &kinds[i];

        if (file.size >= kind->at + kind->size &&
            memcmp(file.at + kind->at, kind->bytes, kind->size) == 0)
            return kind;
    }
    return NULL;
}

static int refuse_kind(struct gsn_bytes file, const struct kind *kind, struct gsn_error *err)
{
    uint8_t head[4] = { 0 };

    if (file.size == 0)
        return gsn_fail(err, GSN_E_INPUT, "the file is empty");
    if (kind)
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "a %s file is not read: scan again as TIFF, PNG or JPEG", kind->name);
    memcpy(head, file.at, file.size < sizeof head ? file.size : sizeof head);
    return gsn_fail(err, GSN_E_UNSUPPORTED,
                    "neither TIFF, PNG, JPEG nor PAM: the %zu bytes begin with %02x %02x %02x %02x",
                    file.size, head[0], head[1], head[2], head[3]);
}

/* A lamp that is off, a shutter that is closed, a frame nobody filled. */
static int refuse_constant(const struct gsn_image *image, struct gsn_error *err)
{
    const uint8_t *samples = image->samples;
    const size_t pixel = (size_t)image->channels * (image->bits / 8);
    const unsigned first = gsn_image_at(image, 0, 0, 0);

    if (memcmp(samples, samples + pixel, gsn_image_bytes(image) - pixel) != 0)
        return GSN_OK;
    if (image->channels == 3 &&
        (gsn_image_at(image, 0, 0, 1) != first || gsn_image_at(image, 0, 0, 2) != first))
        return gsn_fail(err, GSN_E_INPUT,
                        "every pixel has the same colour (%u, %u, %u): not a scan", first,
                        gsn_image_at(image, 0, 0, 1), gsn_image_at(image, 0, 0, 2));
    return gsn_fail(err, GSN_E_INPUT, "every pixel has the same value %u: not a scan", first);
}

/* 10- and 12-bit cameras store their numbers in 16 bits; taken as 16 bit the picture is black. */
static void remark_unused_bits(struct gsn_picture *picture)
{
    const struct gsn_image *image = picture->image;
    const uint16_t *samples = image->samples;
    const size_t count = gsn_image_bytes(image) / 2;
    unsigned seen = 0, bits = 0;

    if (image->bits != 16)
        return;
    for (size_t i = 0; i < count; i++)
        seen |= samples[i];
    while (seen >> bits)
        bits++;
    if (bits <= 12)
        gsn_picture_remark(picture, "only %u of 16 bits are used", bits);
}

/* What shows through a transparent pixel nobody knows, and the colour stored under it is whatever a
 * program left there. */
static int refuse_transparent(const struct gsn_picture *picture, struct gsn_error *err)
{
    const double pixels = (double)picture->image->width * picture->image->height;

    if (picture->transparent == 0)
        return GSN_OK;
    return gsn_fail(err, GSN_E_UNSUPPORTED,
                    "%.3g %% of its pixels are transparent, and what shows through is not in the "
                    "file: save it without transparency, or scan it again",
                    100 * (double)picture->transparent / pixels);
}

struct gsn_decode_limits gsn_decode_defaults(const struct gsn_decode_limits *limits)
{
    const struct gsn_decode_limits asked = limits ? *limits : (struct gsn_decode_limits){ 0 };

    return (struct gsn_decode_limits){
        .most_pixels = asked.most_pixels ? asked.most_pixels : 250000000,
        .most_bytes = asked.most_bytes ? asked.most_bytes : (uint64_t)768 << 20,
        .seconds = asked.seconds,
        .codes = asked.codes,
        .light = asked.light,
        .slide = asked.slide,
        .level = asked.level,
        .target_um = asked.target_um,
    };
}

int gsn_decode_into(const void *bytes, size_t size, const struct gsn_decode_limits *limits,
                    void *place, struct gsn_picture **ret_picture, struct gsn_error *err)
{
    const struct gsn_bytes file = { .at = bytes, .size = size };
    const struct gsn_decode_limits most = gsn_decode_defaults(limits);
    const struct kind *kind = sniff(file);
    gsn_auto(gsn_picture) picture = NULL;
    int r;

    assert((bytes || size == 0) && ret_picture);

    if (!kind || !kind->decode)
        return refuse_kind(file, kind, err);
    picture = gsn_alloc_array(1, sizeof *picture);
    if (!picture)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding");
    (void)snprintf(picture->kind, sizeof picture->kind, "%s", kind->name);
    picture->pages = 1;
    picture->place = place;
    picture->wants_profile = most.light;
    if (most.slide && kind->decode != gsn_tiff_decode)
        return gsn_fail(
            err, GSN_E_INPUT,
            "a %s file has no levels: leave \"level\" and \"target_um\" out of job.json",
            kind->name);
    r = kind->decode(file, &most, picture, err);
    if (r < 0)
        return r;
    r = refuse_transparent(picture, err);
    if (r >= 0)
        r = refuse_constant(picture->image, err);
    if (r < 0)
        return r;
    remark_unused_bits(picture);
    if (most.codes) {
        r = gsn_codes_read(picture, err);
        if (r < 0)
            return r;
    }
    if (most.light) {
        r = gsn_icc_apply(picture, &most, err);
        if (r < 0)
            return r;
    }
    *ret_picture = gsn_steal(&picture);
    return GSN_OK;
}

int gsn_decode(const void *bytes, size_t size, const struct gsn_decode_limits *limits,
               struct gsn_picture **ret_picture, struct gsn_error *err)
{
    return gsn_decode_into(bytes, size, limits, NULL, ret_picture, err);
}

void gsn_picture_free(struct gsn_picture *picture)
{
    if (!picture)
        return;
    if (picture->place && picture->image)
        picture->image->samples = NULL;
    if (picture->mapped_bytes > 0)
        (void)munmap(picture->place, picture->mapped_bytes);
    if (picture->give_back)
        picture->give_back(picture->keeper);
    gsn_image_free(picture->image);
    gsn_free(picture->icc);
    gsn_free(picture);
}
