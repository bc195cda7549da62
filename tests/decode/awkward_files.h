/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Every file of ../shared/data/images: what becomes of it, and how its sentence begins.
 *
 * A code of GSN_OK means that the file is decoded; the sentence is then the decoder's note. */
#ifndef GSN_TESTS_DECODE_AWKWARD_FILES_H
#define GSN_TESTS_DECODE_AWKWARD_FILES_H

#include "pipeline/core/error.h"

static const struct awkward_file {
    const char *file;
    int code;
    const char *sentence;
} awkward_files[] = {
    { "12in16bit.tif", GSN_OK, "only 5 of 16 bits are used" },
    { "16bit.cropped.tif", GSN_OK, "only 10 of 16 bits are used" },
    { "broken.png", GSN_E_INPUT,
      "corrupt PNG in the header, before byte 16 of 80: [F4][A8][81][E1]: invalid chunk type" },
    { "crash-0c7e0e8e11ce787078f00b5b0ca409a167f070e0.tif", GSN_E_INPUT,
      "corrupt TIFF: Incompatible type for \"YCbCrSubsampling\"" },
    { "crash-0e16d3bfb83be87356d026d66919deaefca44dac.tif", GSN_E_INPUT,
      "corrupt TIFF: IO error during reading of \"Tag 42112\"" },
    { "crash-2020-10-test.tif", GSN_E_INPUT,
      "truncated TIFF: page 4 is to begin at byte 2650800128, the file ends at 4883" },
    { "crash-338516dbd2f0e83caddb8ce256c22db3bd6dc40f.tif", GSN_E_INPUT,
      "corrupt TIFF: IO error during reading of \"Tag 42112\"" },
    { "crash-74d2a78403a5a59db1fb0a2b8735ac068a75f6e3.tif", GSN_E_UNSUPPORTED,
      "a TIFF with compression 4" },
    { "crash-f46f5b2f43c370fe65706c11449f567ecc345e74.tif", GSN_E_INPUT,
      "corrupt TIFF: IO error during reading of \"Tag 42112\"" },
    { "hopper.iccprofile.tif", GSN_OK, "" },
    { "hopper.jpg", GSN_OK, "" },
    { "hopper.Lab.tif", GSN_E_UNSUPPORTED, "a TIFF of Lab colours" },
    { "hopper.tif", GSN_OK, "" },
    { "hopper_bigtiff.tif", GSN_OK, "" },
    { "hopper_orientation_3.jpg", GSN_OK, "orientation 3 applied" },
    { "hopper_orientation_6.jpg", GSN_OK, "orientation 6 applied" },
    { "hopper_orientation_8.jpg", GSN_OK, "orientation 8 applied" },
    { "hopper_unknown_pixel_mode.tif", GSN_E_UNSUPPORTED, "a TIFF of 32 bit per sample" },
    { "invalid-exif.jpg", GSN_OK, "EXIF unreadable, upright as stored" },
    { "libtiff_segfault.tif", GSN_E_INPUT, "corrupt TIFF: Incorrect count for \"StripOffsets\"" },
    { "minisblack-1c-16b.tiff", GSN_OK, "" },
    { "multipage.tiff", GSN_E_INPUT, "every pixel has the same colour (0, 128, 0): not a scan" },
    { "multipage_single_frame_loop.tiff", GSN_E_INPUT,
      "corrupt TIFF: page 1 of its chain is followed by page 1 again" },
    { "old-style-jpeg-compression.tif", GSN_E_UNSUPPORTED,
      "a TIFF with old-style JPEG compression" },
    { "orientation_rectangle.jpg", GSN_E_INPUT,
      "every pixel has the same colour (254, 0, 0): not a scan" },
    { "palette-1c-4b.tiff", GSN_OK, "palette expanded" },
    { "pil_sample_cmyk.jpg", GSN_E_UNSUPPORTED, "a JPEG of 4 components (CMYK)" },
    { "quad-tile.jpg.tiff", GSN_OK, "" },
    { "rgb-3c-16b.tiff", GSN_OK, "" },
    { "rgb-3c-8b.tiff", GSN_OK, "" },
    { "seek_too_large.tif", GSN_E_INPUT,
      "truncated TIFF: page 1 is to begin at byte 9295429630892703743, the file ends at 16" },
    { "test_ifd_loop_to_self.tif", GSN_E_INPUT,
      "corrupt TIFF: page 1 of its chain is followed by page 1 again" },
    { "tiff_16bit_RGB.tiff", GSN_OK, "" },
    { "tiff_16bit_RGB_target.png", GSN_OK, "" },
    { "tiff_strip_cmyk_jpeg.tif", GSN_E_UNSUPPORTED, "a TIFF of CMYK colours" },
    { "tiff_strip_planar_lzw.tiff", GSN_OK, "" },
    { "tiff_tiled_planar_raw.tif", GSN_OK, "" },
    { "tiff_tiled_raw.tif", GSN_OK, "" },
    { "tiff_tiled_ycbcr_jpeg_2x2_sampling.tif", GSN_OK, "" },
    { "tiff_with_subifd_chain.tif", GSN_E_INPUT, "every pixel has the same value 220: not a scan" },
    { "truncated_image.png", GSN_E_INPUT,
      "truncated PNG: the data end in row 386 of 480, at byte 81920" },
    { "truncated_jpeg.jpg", GSN_E_INPUT, "truncated JPEG: the data end in scan 10, at byte 6698" },
};

#endif
