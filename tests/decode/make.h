/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Small picture files made on the spot by the libraries' own writers, so that the decoder is
 * checked against samples that are known and not against another decoder. */
#ifndef GSN_TESTS_DECODE_MAKE_H
#define GSN_TESTS_DECODE_MAKE_H

#include "pipeline/decode/decode.h"

#include <stdint.h>

struct made {
    uint8_t *bytes;
    size_t size;
};
void made_free(struct made *made);
#define auto_made __attribute__((cleanup(made_free))) struct made

/* No two neighbours alike, no symmetry: a gradient with texture. */
struct gsn_image *make_picture(uint32_t width, uint32_t height, uint32_t channels, uint32_t bits);

struct jpeg_recipe {
    int quality, progressive, cmyk, whole_resolution; /* no chroma subsampling */
    int unit, dots;                                   /* JFIF density */
    const uint8_t *exif;                              /* with its "Exif\0\0" */
    size_t exif_size;
    int with_icc;
    const struct made *icc; /* a profile to embed, or NULL */
};
struct made make_jpeg(const struct gsn_image *image, const struct jpeg_recipe *recipe);

struct png_recipe {
    int interlaced, alpha, bits; /* bits 0: those of the image; 1: a black and white picture */
    uint32_t gamma;              /* times 100000; 0: no gAMA */
    int srgb, with_icc;
    uint32_t per_metre;
    const struct made *icc; /* an iCCP chunk, or NULL */
    const uint8_t *exif;
    size_t exif_size;
};
struct made make_png(const struct gsn_image *image, const struct png_recipe *recipe);
/* The indices are the image's grey values; entry i is (i, 255 - i, i / 2). */
struct made make_palette_png(const struct gsn_image *image);

struct tiff_recipe {
    const char *mode; /* NULL: "w"; "w8" BigTIFF, "wb" big-endian */
    uint32_t tile;    /* 0: strips of 5 rows */
    int compression, predictor, planar, orientation, photometric, white_is_zero, alpha;
    int unit;
    double dots;
    int pages;
    int sample_format;
    int lowest_bit_first; /* the bits of every byte turned round */
    const uint16_t *curve; /* TransferFunction */
    int with_icc, jpeg_ycbcr;
    const struct made *icc; /* a profile to embed, or NULL */
};
struct made make_tiff(const struct gsn_image *image, const struct tiff_recipe *recipe);
/* As make_palette_png(); bits 4 or 8. */
struct made make_palette_tiff(const struct gsn_image *image, unsigned bits);

/* An EXIF block of one directory; with the "Exif\0\0" of JPEG when for_jpeg. */
struct exif_recipe {
    int big_endian, for_jpeg;
    unsigned orientation, dots_per_cm, colour_space;
};
size_t make_exif(const struct exif_recipe *recipe, uint8_t room[128]);

/* Decodes in a child with this much address space and ten seconds; a death is an error of its own.
 */
enum { CHILD_DIED = -1000 };
int decode_in_child(const void *bytes, size_t size, uint64_t address_space,
                    struct gsn_error *ret_said, uint64_t *ret_peak_bytes);

/* Largest and mean difference of two pictures of the same shape; -1 when the shapes differ. */
double mean_difference(const struct gsn_image *a, const struct gsn_image *b);
int same_picture(const struct gsn_image *a, const struct gsn_image *b);

#endif
