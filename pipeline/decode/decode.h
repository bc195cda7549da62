/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Scanned pictures out of bytes: JPEG, TIFF, BigTIFF, PNG and PAM (frames of cameras), strictly.
 *
 * A file is either decoded completely or refused with one sentence; no sample is ever made up, and
 * what a header asks for is checked against limits before anything is allocated for it. Works from
 * memory alone: no file is opened. Lengths are micrometres, samples are as the file stores them
 * (transfer curve not undone). */
#ifndef GSN_DECODE_DECODE_H
#define GSN_DECODE_DECODE_H

#include "pipeline/core/error.h"
#include "pipeline/core/image.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A member of 0 stands for its default: 250 million pixels, 768 MiB of decoded samples, and two
 * minutes, which count where decoding has a process of its own (pipeline/decode/apart.h). */
struct gsn_decode_limits {
    uint64_t most_pixels;
    uint64_t most_bytes;
    unsigned seconds;
    int codes; /* 1: the codes printed on the picture are read too */
    int light; /* 1: an embedded ICC profile is undone, so that samples are linear light */
    /* 1: the file is a slide of several levels, each the picture at another pixel size (a pyramid
     * of tiles in one TIFF, Aperio's SVS among them, or Hamamatsu's NDPI), and one of them is
     * decoded: the coarsest whose pixels are at most target_um, or this level where target_um is 0;
     * level 0 is the finest. The file must then state the size of its pixels, and they must be
     * square. */
    int slide;
    unsigned level;
    double target_um;
};

/* How samples relate to light, as far as the file says so. */
enum gsn_transfer {
    GSN_TRANSFER_UNKNOWN, /* not stated, or a curve that is none of the others */
    GSN_TRANSFER_LINEAR,  /* PNG gAMA 1.0, or a straight TIFF TransferFunction */
    GSN_TRANSFER_SRGB,    /* PNG sRGB or gAMA 1/2.2, sRGB TransferFunction, EXIF ColorSpace 1 */
    GSN_TRANSFER_ICC,     /* an ICC profile is embedded; it wins over the others */
    GSN_TRANSFER_PROFILE, /* it was undone: samples are 16-bit linear light */
};

enum { GSN_CODES = 4, GSN_CODE_BYTES = 64 };

/* A printed code. Its text is data from outside: printable ASCII, cut when longer. */
struct gsn_printed {
    char text[GSN_CODE_BYTES];
    char kind[16];   /* "Data Matrix", or ZBar's name: "QR-Code", "CODE-128", ... */
    double turn_deg; /* how far it is turned clockwise on the upright picture */
    int mirrored;    /* it could be read only in a mirror; told of Data Matrix alone */
};

struct gsn_picture {
    struct gsn_image *image; /* owned; upright: EXIF or TIFF orientation is applied */
    double px_um_x, px_um_y; /* pixel pitch along the upright axes; 0: the file does not say */
    enum gsn_transfer transfer;
    unsigned pages; /* pages in the file; the first one is decoded */
    int lossy;      /* its samples went through JPEG, in a file of its own or inside a TIFF */
    char kind[24];  /* "JPEG", "TIFF", "BigTIFF", "PNG" or "PAM" */
    char note[160]; /* what was passed over or applied, "; " between; empty when nothing was */
    /* Why colours of this picture must not be measured, as whoever took it says in the file (its
     * camera could not be locked); empty: they may. */
    char withheld[160];
    /* The embedded ICC profile: its name, or, with GSN_TRANSFER_ICC, why it was refused; empty
     * unless light was asked for. Printable ASCII. */
    char profile[96];
    int wants_profile;    /* light was asked for */
    uint64_t transparent; /* pixels that are; while decoding */
    uint8_t *icc;         /* owned; its bytes while decoding */
    size_t icc_size;
    unsigned code_count; /* 0 unless codes were asked for */
    struct gsn_printed code[GSN_CODES];

    void *place;         /* where the samples are when they are not allocated, or NULL */
    size_t mapped_bytes; /* of it, to be unmapped; 0: it is somebody else's */
    /* Whoever lent the place, to be told that it is free again; NULL: nobody. */
    void (*give_back)(void *keeper);
    void *keeper;
};

/* Decodes the first page of a picture file, or the level of a slide that limits ask for.
 *
 * limits may be NULL for the defaults. Besides the samples the decoder needs at most about 200 MiB.
 * Fails with GSN_E_INPUT (truncated, corrupt, or every pixel the same), GSN_E_UNSUPPORTED (12 bit,
 * float, CMYK, Lab, old-style JPEG in TIFF, ...), GSN_E_LIMIT or GSN_E_NOMEM.
 * borrows: bytes. gives: ret_picture. */
int gsn_decode(const void *bytes, size_t size, const struct gsn_decode_limits *limits,
               struct gsn_picture **ret_picture, struct gsn_error *err);

void gsn_picture_free(struct gsn_picture *picture);
GSN_DEFINE_AUTO(gsn_picture);

#ifdef __cplusplus
}
#endif
#endif
