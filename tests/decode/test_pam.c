/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include "pipeline/decode/decode.h"
#include "tests/decode/make.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#define YCBCR(matrix, range) "# gieson frame 1\n# matrix: " matrix "\n# range: " range "\n"

/* A file put together from a header and samples. */
struct file {
    uint8_t at[8192];
    size_t size;
};

static struct file pam(const char *comments, unsigned width, unsigned height, unsigned depth,
                       unsigned maxval, const char *tupltype, const void *samples, size_t size)
{
    struct file file;

    file.size = (size_t)snprintf((char *)file.at, sizeof file.at,
                                 "P7\n%sWIDTH %u\nHEIGHT %u\nDEPTH %u\nMAXVAL %u\nTUPLTYPE %s\n"
                                 "ENDHDR\n",
                                 comments, width, height, depth, maxval, tupltype);
    CHECK(file.size + size <= sizeof file.at);
    memcpy(file.at + file.size, samples, size);
    file.size += size;
    return file;
}

static struct gsn_picture *decode(const struct file *file)
{
    struct gsn_picture *picture = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_decode(file->at, file->size, NULL, &picture, &err), err);
    CHECK(strcmp(picture->kind, "PAM") == 0);
    return picture;
}

static void refuses(const struct file *file, int code, const char *sentence)
{
    struct gsn_picture *picture = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_decode(file->at, file->size, NULL, &picture, &err) == code);
    CHECK(picture == NULL);
    if (!strstr(err.text, sentence))
        fail_msg("\"%s\" does not say \"%s\"", err.text, sentence);
}

TEST(grey_and_colour_come_back_as_they_are)
{
    for (unsigned i = 0; i < 4; i++) {
        gsn_auto(gsn_image) truth = make_picture(13, 7, i % 2 ? 3 : 1, i / 2 ? 16 : 8);
        const size_t size = gsn_image_bytes(truth);
        uint8_t samples[13 * 7 * 6];
        struct file file;

        for (size_t k = 0; k < size; k++)
            samples[k] = ((const uint8_t *)truth->samples)[i / 2 ? k ^ 1 : k]; /* high byte first */
        file = pam("", 13, 7, truth->channels, i / 2 ? 65535 : 255, i % 2 ? "RGB" : "GRAYSCALE",
                   samples, size);
        gsn_auto(gsn_picture) picture = decode(&file);

        CHECK(same_picture(picture->image, truth));
        CHECK(picture->note[0] == '\0' && picture->withheld[0] == '\0');
        CHECK(picture->transfer == GSN_TRANSFER_UNKNOWN);
    }
}

TEST(ten_bits_fill_the_range_and_no_two_values_meet)
{
    uint8_t samples[2048];
    struct file file;
    unsigned last = 0;

    for (unsigned i = 0; i < 1024; i++) {
        samples[2 * i] = (uint8_t)(i >> 8);
        samples[2 * i + 1] = (uint8_t)i;
    }
    file = pam("", 32, 32, 1, 1023, "GRAYSCALE", samples, sizeof samples);
    gsn_auto(gsn_picture) picture = decode(&file);

    CHECK(picture->image->bits == 16 && strstr(picture->note, "0..1023 stretched") != NULL);
    for (unsigned i = 0; i < 1024; i++) {
        const unsigned value = gsn_image_at(picture->image, i % 32, i / 32, 0);

        CHECK_NEAR(value, i * 65535.0 / 1023, 0.5);
        CHECK(i == 0 || value > last);
        last = value;
    }
}

TEST(blue_first_is_turned_and_alpha_is_passed_over)
{
    static const uint8_t bgr[] = { 1, 2, 3, 4, 5, 6 };
    static const uint8_t rgba[] = { 1, 2, 3, 99, 4, 5, 6, 98 };
    struct file file = pam("", 2, 1, 3, 255, "BGR", bgr, sizeof bgr);
    gsn_auto(gsn_picture) turned = decode(&file);

    CHECK(memcmp(turned->image->samples, "\3\2\1\6\5\4", 6) == 0);
    file = pam("", 2, 1, 4, 255, "RGB_ALPHA", rgba, sizeof rgba);
    gsn_auto(gsn_picture) passed = decode(&file);
    CHECK(memcmp(passed->image->samples, "\1\2\3\4\5\6", 6) == 0);
    CHECK(strcmp(passed->note, "alpha ignored") == 0);
}

/* Bars of 75 % as the recommendations print them, Y Cb Cr of 8 bits: white, yellow, cyan, green,
 * magenta, red, blue, black. Rounding to 8 bits is worth less than a hundredth. */
static const uint8_t bars_601[8][3] = { { 180, 128, 128 }, { 162, 44, 142 }, { 131, 156, 44 },
                                        { 112, 72, 58 },   { 84, 184, 198 }, { 65, 100, 212 },
                                        { 35, 212, 114 },  { 16, 128, 128 } };
static const uint8_t bars_709[8][3] = { { 180, 128, 128 }, { 168, 44, 136 }, { 145, 147, 44 },
                                        { 133, 63, 52 },   { 63, 193, 204 }, { 51, 109, 212 },
                                        { 28, 212, 120 },  { 16, 128, 128 } };
/* JFIF, full range: the same at 100 %. */
static const uint8_t bars_full[8][3] = { { 255, 128, 128 }, { 226, 0, 149 },   { 179, 171, 0 },
                                         { 150, 44, 21 },   { 105, 212, 235 }, { 76, 85, 255 },
                                         { 29, 255, 107 },  { 0, 128, 128 } };

static void check_bars(const struct gsn_image *image, double level)
{
    for (uint32_t y = 0; y < image->height; y++) {
        for (uint32_t x = 0; x < 16; x++) {
            const unsigned bar = x / 2;
            const double truth[3] = { level * !(bar >> 1 & 1), level * !(bar >> 2 & 1),
                                      level * !(bar & 1) };

            for (uint32_t c = 0; c < 3; c++)
                CHECK_NEAR(gsn_image_at(image, x, y, c) / 65535.0, truth[c], 0.01);
        }
    }
}

static void bars_come_out(const uint8_t bars[8][3], const char *comments, double level)
{
    uint8_t yuyv[64], uyvy[64], nv12[16 * 3];
    struct file file;

    for (unsigned i = 0; i < 8; i++) {
        const uint8_t y = bars[i][0], u = bars[i][1], v = bars[i][2];

        for (unsigned row = 0; row < 2; row++) {
            memcpy(yuyv + 32 * row + 4 * i, (uint8_t[]){ y, u, y, v }, 4);
            memcpy(uyvy + 32 * row + 4 * i, (uint8_t[]){ u, y, v, y }, 4);
            memcpy(nv12 + 16 * row + 2 * i, (uint8_t[]){ y, y }, 2);
        }
        memcpy(nv12 + 32 + 2 * i, (uint8_t[]){ u, v }, 2);
    }
    file = pam(comments, 16, 2, 2, 255, "YUYV", yuyv, sizeof yuyv);
    gsn_auto(gsn_picture) first = decode(&file);
    check_bars(first->image, level);
    file = pam(comments, 16, 2, 2, 255, "UYVY", uyvy, sizeof uyvy);
    gsn_auto(gsn_picture) second = decode(&file);
    CHECK(same_picture(first->image, second->image));
    file = pam(comments, 16, 3, 1, 255, "NV12", nv12, sizeof nv12);
    gsn_auto(gsn_picture) third = decode(&file);
    CHECK(same_picture(first->image, third->image));
}

TEST(colour_bars_come_out_in_their_colours)
{
    bars_come_out(bars_601, YCBCR("BT.601", "limited"), 0.75);
    bars_come_out(bars_709, YCBCR("BT.709", "limited"), 0.75);
    bars_come_out(bars_full, YCBCR("BT.601", "full"), 1);
}

TEST(every_grey_of_a_camera_stays_apart_and_in_order)
{
    uint8_t yuyv[512];
    struct file file;

    for (unsigned i = 0; i < 256; i++) {
        yuyv[2 * i] = (uint8_t)i;
        yuyv[2 * i + 1] = 128;
    }
    file = pam(YCBCR("BT.709", "full"), 256, 1, 2, 255, "YUYV", yuyv, sizeof yuyv);
    gsn_auto(gsn_picture) picture = decode(&file);

    for (uint32_t i = 0; i < 256; i++) {
        for (uint32_t c = 0; c < 3; c++)
            CHECK(gsn_image_at(picture->image, i, 0, c) == i * 257);
    }
}

TEST(a_yuv_frame_that_does_not_say_what_it_means_is_refused)
{
    static const uint8_t grey[8] = { 1, 128, 2, 128, 3, 128, 4, 128 };
    struct file file = pam("", 4, 1, 2, 255, "YUYV", grey, 8);

    refuses(&file, GSN_E_UNSUPPORTED, "its colours are not known");
    file = pam("# matrix: BT.601\n# range: full\n", 4, 1, 2, 255, "YUYV", grey, 8);
    refuses(&file, GSN_E_UNSUPPORTED, "its colours are not known"); /* anybody's comment */
    file = pam(YCBCR("another", "full"), 4, 1, 2, 255, "YUYV", grey, 8);
    refuses(&file, GSN_E_UNSUPPORTED, "matrix \"another\"");
    file = pam(YCBCR("BT.601", "wide"), 4, 1, 2, 255, "YUYV", grey, 8);
    refuses(&file, GSN_E_UNSUPPORTED, "range \"wide\"");
}

/* Red, green and blue are planes that rise evenly; the sensor sees one of them at each pixel. */
static double plane(unsigned colour, uint32_t x, uint32_t y)
{
    static const double at[3] = { 100, 300, 200 }, dx[3] = { 6, 4, 10 }, dy[3] = { 4, 14, 2 };

    return at[colour] + dx[colour] * x + dy[colour] * y;
}

TEST(colours_that_rise_evenly_are_given_back_by_every_bayer_pattern)
{
    static const char *const names[] = { "BAYER_RGGB", "BAYER_GRBG", "BAYER_GBRG", "BAYER_BGGR" };
    static const unsigned patterns[4][4] = {
        { 0, 1, 1, 2 }, { 1, 0, 2, 1 }, { 1, 2, 0, 1 }, { 2, 1, 1, 0 }
    };
    enum { W = 12, H = 9 };

    for (unsigned p = 0; p < 4; p++) {
        uint8_t samples[2 * W * H];
        struct file file;

        for (uint32_t i = 0; i < W * H; i++) {
            const uint32_t x = i % W, y = i / W;
            const unsigned value = (unsigned)plane(patterns[p][y % 2 * 2 + x % 2], x, y);

            samples[2 * i] = (uint8_t)(value >> 8);
            samples[2 * i + 1] = (uint8_t)value;
        }
        file = pam("", W, H, 1, 4095, names[p], samples, sizeof samples);
        gsn_auto(gsn_picture) picture = decode(&file);

        CHECK(picture->image->channels == 3 && picture->image->bits == 16);
        CHECK(strstr(picture->note, "Bayer pattern interpolated") != NULL);
        for (uint32_t y = 1; y + 1 < H; y++) {
            for (uint32_t x = 1; x + 1 < W; x++) {
                for (unsigned c = 0; c < 3; c++)
                    CHECK_NEAR(gsn_image_at(picture->image, x, y, c), plane(c, x, y) * 65535 / 4095,
                               0.51);
            }
        }
    }
}

TEST(every_pixel_of_a_bayer_frame_keeps_its_own_sample_and_a_uniform_colour_its_colour)
{
    uint8_t samples[6 * 4];
    struct file file;

    for (uint32_t i = 0; i < 24; i++)
        samples[i] = (uint8_t)(i / 6 % 2 ? (i % 2 ? 30 : 20) : (i % 2 ? 20 : 10)); /* RGGB */
    samples[23] = 77; /* a blue one and a green one, at the corners */
    samples[18] = 55;
    file = pam("", 6, 4, 1, 255, "BAYER_RGGB", samples, sizeof samples);
    gsn_auto(gsn_picture) picture = decode(&file);

    CHECK(gsn_image_at(picture->image, 5, 3, 2) == 77 * 257);
    CHECK(gsn_image_at(picture->image, 0, 3, 1) == 55 * 257);
    for (uint32_t i = 0; i < 24; i++) {
        for (uint32_t c = 0; c < 3 && i / 6 < 2; c++)
            CHECK(gsn_image_at(picture->image, i % 6, i / 6, c) == (c + 1) * 10 * 257);
    }
}

TEST(what_its_camera_says_of_a_frame_is_told)
{
    static const uint8_t two[6] = { 1, 2, 3, 4, 5, 6 };
    struct file file = pam("# gieson frame 1\n# transfer: sRGB\n"
                           "# not to be measured: gain is not locked: it is automatic\n",
                           2, 1, 3, 255, "RGB", two, 6);
    gsn_auto(gsn_picture) withheld = decode(&file);

    CHECK(withheld->transfer == GSN_TRANSFER_SRGB);
    CHECK(strcmp(withheld->withheld, "gain is not locked: it is automatic") == 0);
    file = pam("# not to be measured: a stranger's words\n# gieson frame 1\n# transfer: linear\n",
               2, 1, 3, 255, "RGB", two, 6);
    gsn_auto(gsn_picture) free_one = decode(&file);
    CHECK(free_one->transfer == GSN_TRANSFER_LINEAR && free_one->withheld[0] == '\0');
}

TEST(wrong_headers_are_refused)
{
    static const struct {
        const char *bytes;
        int code;
        const char *says;
    } cases[] = {
        { "P7\nWIDTH 2\n", GSN_E_INPUT, "the header has no ENDHDR" },
        { "P7\nWIDTH 2\nHEIGHT 1\nDEPTH 3\nENDHDR\nabcdef", GSN_E_INPUT, "is missing" },
        { "P7\nWIDTH 2\nWIDTH 2\nENDHDR\n", GSN_E_INPUT, "or twice" },
        { "P7\nWIDTH -2\nENDHDR\n", GSN_E_INPUT, "WIDTH is no number" },
        { "P7\nWIDTH 0\nENDHDR\n", GSN_E_INPUT, "out of range" },
        { "P7\nWIDTH 99999999999999999999\nENDHDR\n", GSN_E_INPUT, "out of range" },
        { "P7\nCOLOUR 2\nENDHDR\n", GSN_E_INPUT, "a line of another kind" },
        { "P7\nWIDTH 2\nHEIGHT 1\nDEPTH 3\nMAXVAL 255\nENDHDR\nabcdef", GSN_E_UNSUPPORTED,
          "TUPLTYPE \"\"" },
        { "P7\nWIDTH 2\nHEIGHT 1\nDEPTH 3\nMAXVAL 255\nTUPLTYPE CMYK\nENDHDR\nabcdef",
          GSN_E_UNSUPPORTED, "TUPLTYPE \"CMYK\"" },
        { "P7\nWIDTH 2\nHEIGHT 1\nDEPTH 1\nMAXVAL 255\nTUPLTYPE RGB\nENDHDR\nab", GSN_E_INPUT,
          "RGB has DEPTH 3, not 1" },
        { "P7\nWIDTH 2\nHEIGHT 1\nDEPTH 3\nMAXVAL 65536\nTUPLTYPE RGB\nENDHDR\nabcdef", GSN_E_INPUT,
          "MAXVAL 65536 is above 65535" },
        { "P7\nWIDTH 2\nHEIGHT 1\nDEPTH 3\nMAXVAL 255\nTUPLTYPE RGB\nENDHDR\nabcde", GSN_E_INPUT,
          "truncated PAM" },
        { "P7\nWIDTH 2\nHEIGHT 1\nDEPTH 3\nMAXVAL 255\nTUPLTYPE RGB\nENDHDR\nabcdefg", GSN_E_INPUT,
          "1 bytes follow the picture" },
        { "P7\nWIDTH 2\nHEIGHT 1\nDEPTH 3\nMAXVAL 101\nTUPLTYPE RGB\nENDHDR\nabcdef", GSN_E_INPUT,
          "a sample of 102 is above MAXVAL 101" },
        { "P7\nWIDTH 4294967295\nHEIGHT 4294967295\nDEPTH 3\nMAXVAL 255\nTUPLTYPE RGB\nENDHDR\nabc",
          GSN_E_INPUT, "truncated PAM" },
        { "P7\nWIDTH 1\nHEIGHT 2\nDEPTH 1\nMAXVAL 255\nTUPLTYPE BAYER_RGGB\nENDHDR\nab",
          GSN_E_INPUT, "no BAYER_RGGB picture" },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct file file = { .size = strlen(cases[i].bytes) };

        memcpy(file.at, cases[i].bytes, file.size);
        refuses(&file, cases[i].code, cases[i].says);
    }
}

/* Any single byte changed: decoded or refused, never anything else (the sanitizers watch). */
TEST(damaged_frames_are_decoded_or_refused)
{
    uint8_t samples[64];
    unsigned seed = 1;

    for (unsigned i = 0; i < 64; i++)
        samples[i] = (uint8_t)(i * 3);
    for (unsigned i = 0; i < 20000; i++) {
        struct file file = pam(YCBCR("BT.601", "limited"), 8, 4, 2, 255, "YUYV", samples, 64);
        gsn_auto(gsn_picture) picture = NULL;

        for (unsigned k = 0; k < 1 + i % 3; k++) {
            seed = seed * 1664525U + 1013904223U;
            file.at[(seed >> 8) % file.size] = (uint8_t)(seed >> 24);
        }
        (void)gsn_decode(file.at, i % 7 ? file.size : (seed >> 4) % file.size, NULL, &picture,
                         NULL);
    }
}

static int decode_once(const struct file *file, struct gsn_error *err)
{
    gsn_auto(gsn_picture) picture = NULL;

    return gsn_decode(file->at, file->size, NULL, &picture, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    static const uint8_t two[6] = { 1, 2, 3, 4, 5, 6 };
    const struct file file = pam("", 2, 1, 3, 255, "RGB", two, 6);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(decode_once(&file, &err), err);
}

/* netpbm writes the picture; both decoders of ours must see the same samples. */
TEST(netpbm_and_this_decoder_agree)
{
    char path[] = "/tmp/gieson_pam_XXXXXX", command[200];
    const int fd = mkstemp(path);
    struct made pam_file = { 0 };
    FILE *pipe;
    int status;

    if (system("command -v pngtopam >/dev/null") != 0) {
        (void)unlink(path);
        gsn_check_skip("netpbm is not installed");
    }
    CHECK(fd >= 0);
    for (unsigned i = 0; i < 4; i++) {
        gsn_auto(gsn_image) truth = make_picture(31, 17, i % 2 ? 3 : 1, i / 2 ? 16 : 8);
        auto_made png = make_png(truth, &(struct png_recipe){ 0 });
        gsn_auto(gsn_picture) picture = NULL;
        struct gsn_error err = { 0 };
        uint8_t bytes[8192];

        CHECK(pwrite(fd, png.bytes, png.size, 0) == (ssize_t)png.size &&
              ftruncate(fd, (off_t)png.size) == 0);
        (void)snprintf(command, sizeof command, "pngtopam %s | pamtopam", path);
        pipe = popen(command, "r");
        CHECK(pipe != NULL);
        pam_file.bytes = bytes;
        pam_file.size = fread(bytes, 1, sizeof bytes, pipe);
        status = pclose(pipe);
        CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
        if (memcmp(bytes, "P7\n", 3) != 0) {
            print_message("skipped: this netpbm writes no PAM\n");
            break;
        }
        CHECK_OK(gsn_decode(pam_file.bytes, pam_file.size, NULL, &picture, &err), err);
        CHECK(same_picture(picture->image, truth));
    }
    (void)close(fd);
    (void)unlink(path);
}
