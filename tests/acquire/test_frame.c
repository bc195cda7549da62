/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/frame.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "acquire/container.h"
#include "tests/check.h"
#include "tests/decode/make.h"

static const struct gsn_frame_control controls[] = {
    { "exposure", "x 100 us", 156, 1, NULL },
    { "gain", "", 10, 1, "its automatic reads on" },
    { "white balance", "K", 0, 0, "the camera has no control for it" },
};

static struct gsn_frame frame_of(const char *fourcc, uint32_t width, uint32_t height,
                                 uint32_t stride, const void *bytes, size_t size)
{
    return (struct gsn_frame){ .format = gsn_pixel_format_named(fourcc),
                               .width = width,
                               .height = height,
                               .stride = stride,
                               .device = "Mock \"one\"\n# quoted",
                               .interface = "V4L2",
                               .colorspace = "sRGB",
                               .bytes = bytes,
                               .size = size };
}

struct kept {
    uint8_t *bytes;
    size_t size;
    const uint8_t *payload;
    size_t payload_size;
};

static void kept_free(struct kept *kept)
{
    gsn_free(kept->bytes);
}

#define auto_kept __attribute__((cleanup(kept_free))) struct kept

static struct kept keep(const struct gsn_frame *frame)
{
    struct kept kept = { 0 };
    struct gsn_error err = { 0 };
    const uint8_t *end;

    CHECK_OK(gsn_frame_encode(frame, &kept.bytes, &kept.size, &err), err);
    CHECK(gsn_container_check(kept.bytes, kept.size).complete);
    end = memmem(kept.bytes, kept.size, "ENDHDR\n", 7);
    if (end) {
        kept.payload = end + 7;
        kept.payload_size = kept.size - (size_t)(kept.payload - kept.bytes);
    }
    return kept;
}

static void refuses(const struct gsn_frame *frame, const char *sentence)
{
    struct gsn_error err = { 0 };
    uint8_t *bytes = NULL;
    size_t size = 7;

    CHECK(gsn_frame_encode(frame, &bytes, &size, &err) == GSN_E_INPUT);
    CHECK(bytes == NULL && size == 7);
    if (!strstr(err.text, sentence))
        fail_msg("\"%s\" does not say \"%s\"", err.text, sentence);
}

TEST(a_frame_is_its_payload_behind_a_header_that_says_all)
{
    static const char expected[] = "P7\n"
                                   "# gieson frame 1\n"
                                   "# device: Mock \"one\"?# quoted\n"
                                   "# interface: V4L2\n"
                                   "# format: YUYV\n"
                                   "# size: 2 x 2\n"
                                   "# colorspace: sRGB\n"
                                   "# matrix: BT.601\n"
                                   "# range: limited\n"
                                   "# subject: dark\n"
                                   "# exposure: 156 x 100 us, locked\n"
                                   "# gain: 10, not locked\n"
                                   "# white balance: not known\n"
                                   "# not to be measured: gain is not locked\n"
                                   "WIDTH 2\nHEIGHT 2\nDEPTH 2\nMAXVAL 255\nTUPLTYPE YUYV\nENDHDR\n"
                                   "abcdefgh";
    struct gsn_frame frame = frame_of("YUYV", 2, 2, 6, "abcd..efgh", 10);

    frame.matrix = "BT.601";
    frame.range = "limited";
    frame.subject = GSN_SUBJECT_DARK;
    frame.control = controls;
    frame.control_count = 3;
    frame.withheld = "gain is not locked";
    {
        auto_kept kept = keep(&frame);
        auto_kept again = keep(&frame);

        CHECK(kept.size == sizeof expected - 1 && memcmp(kept.bytes, expected, kept.size) == 0);
        CHECK(again.size == kept.size && memcmp(again.bytes, kept.bytes, kept.size) == 0);
        CHECK(strcmp(gsn_frame_name(&frame), "dark.pam") == 0);
    }
}

TEST(what_was_stated_and_read_back_is_one_json_object)
{
    static const char expected[] =
        "{\"device\":\"Mock \\\"one\\\"?# quoted\",\"interface\":\"V4L2\",\"format\":\"GREY\","
        "\"width\":2,\"height\":1,\"stride\":2,\"colorspace\":\"sRGB\",\"subject\":\"panel\","
        "\"damaged_before\":3,\"controls\":[{\"name\":\"exposure\",\"value\":156,"
        "\"unit\":\"x 100 us\",\"locked\":true},{\"name\":\"gain\",\"value\":10,\"locked\":false,"
        "\"reason\":\"its automatic reads on\"},{\"name\":\"white balance\",\"unit\":\"K\","
        "\"locked\":false,\"reason\":\"the camera has no control for it\"}],\"quantify\":true,"
        "\"thumbnail\":\"AAB/\"}";
    struct gsn_frame frame = frame_of("GREY", 2, 1, 2, "ab", 2);
    struct gsn_error err = { 0 };
    char *facts = NULL;

    frame.control = controls;
    frame.control_count = 3;
    CHECK_OK(gsn_frame_facts(&frame, 3, "AAB/", &facts, &err), err);
    if (strcmp(facts, expected) != 0)
        fail_msg("%s", facts);
    gsn_free(facts);
}

TEST(words_change_their_byte_order_and_nothing_else)
{
    static const uint8_t words[] = { 0x34, 0x02, 0xff, 0x03, 0xee, 0xee,
                                     0x00, 0x00, 0x01, 0x00, 0xee, 0xee };
    static const uint8_t turned[] = { 0x02, 0x34, 0x03, 0xff, 0x00, 0x00, 0x00, 0x01 };
    const struct gsn_frame frame = frame_of("RG10", 2, 2, 6, words, sizeof words);
    auto_kept kept = keep(&frame);

    CHECK(kept.payload_size == 8 && memcmp(kept.payload, turned, 8) == 0);
    CHECK(memmem(kept.bytes, kept.size, "MAXVAL 1023\nTUPLTYPE BAYER_RGGB\n", 32) != NULL);
}

TEST(packed_samples_are_taken_apart_into_what_was_packed)
{
    /* 10 bit: 0x3ff, 0x001, 0x2aa, 0x155; MIPI CSI-2: high bytes, then two low bits of each. */
    static const uint8_t ten[] = { 0xff, 0x00, 0xaa, 0x55, 0x3 | 1 << 2 | 2 << 4 | 1 << 6 };
    static const uint8_t ten_apart[] = { 0x03, 0xff, 0x00, 0x01, 0x02, 0xaa, 0x01, 0x55 };
    /* 12 bit: 0xabc, 0x123: high bytes, then the low halves. */
    static const uint8_t twelve[] = { 0xab, 0x12, 0x3c };
    static const uint8_t twelve_apart[] = { 0x0a, 0xbc, 0x01, 0x23 };
    struct gsn_frame frame = frame_of("pRAA", 4, 1, 5, ten, sizeof ten);
    auto_kept first = keep(&frame);

    CHECK(first.payload_size == 8 && memcmp(first.payload, ten_apart, 8) == 0);
    frame = frame_of("pBCC", 2, 1, 3, twelve, sizeof twelve);
    auto_kept second = keep(&frame);
    CHECK(second.payload_size == 4 && memcmp(second.payload, twelve_apart, 4) == 0);
    CHECK(memmem(second.bytes, second.size, "MAXVAL 4095\nTUPLTYPE BAYER_BGGR\n", 32) != NULL);
}

TEST(both_planes_of_nv12_lose_their_padding)
{
    static const char bytes[] = "abcd..efgh..uvUV..";
    const struct gsn_frame frame = frame_of("NV12", 4, 2, 6, bytes, 18);
    auto_kept kept = keep(&frame);

    CHECK(kept.payload_size == 12 && memcmp(kept.payload, "abcdefghuvUV", 12) == 0);
    CHECK(memmem(kept.bytes, kept.size, "WIDTH 4\nHEIGHT 3\nDEPTH 1\n", 25) != NULL);
}

TEST(frames_that_are_not_what_they_state_are_refused)
{
    static const uint8_t words[] = { 0x00, 0x04, 0, 0 };
    struct gsn_frame frame = frame_of("GREY", 4, 2, 4, "abcdefg", 7);

    refuses(&frame, "the frame has 7 bytes where 4 x 2 pixels of GREY need 8");
    frame = frame_of("GREY", 4, 2, 3, "abcdefgh", 8);
    refuses(&frame, "do not fit into rows of 3 bytes");
    frame = frame_of("YUYV", 3, 1, 6, "abcdef", 6);
    refuses(&frame, "U and V are shared by two");
    frame = frame_of("Y10", 2, 1, 4, words, 4);
    refuses(&frame, "sample (0, 0) is 1024, but Y10  has 10 bits");
    frame = frame_of("MJPG", 2, 1, 0, "\xff\xd8\xff\xd9", 4);
    refuses(&frame, "before it has begun a picture");
    frame = frame_of("MJPG", 2, 1, 0, "abcdef", 6);
    refuses(&frame, "begins with no JPEG's SOI");
}

TEST(formats_have_one_row_for_each_code_and_name)
{
    static const char *const codes[] = { "YUYV", "Y16", "BA81", "RG12", "pgAA", "MJPG" };

    for (size_t i = 0; i < sizeof codes / sizeof codes[0]; i++) {
        const struct gsn_pixel_format *const format = gsn_pixel_format_named(codes[i]);

        CHECK(format && format->libcamera[0]);
        for (size_t j = 0; j < i; j++) {
            const struct gsn_pixel_format *const other = gsn_pixel_format_named(codes[j]);

            CHECK(other != format && strcmp(other->libcamera, format->libcamera) != 0 &&
                  gsn_pixel_format_code(other) != gsn_pixel_format_code(format));
        }
    }
    CHECK(gsn_pixel_format_named("Y1") == NULL && gsn_pixel_format_named("") == NULL);
    CHECK(gsn_pixel_format_named("YUYV2") == NULL);
}

/* libjpeg's own tables are the standard ones: without them, as UVC cameras send it, and with ours
 * put in, the picture must be the same. */
static struct made without_tables(const struct made *jpeg)
{
    struct made out = { malloc(jpeg->size), 0 };
    size_t at = 2;

    CHECK(out.bytes != NULL);
    memcpy(out.bytes, jpeg->bytes, 2);
    out.size = 2;
    while (jpeg->bytes[at + 1] != 0xda) {
        const size_t length = 2 + ((size_t)jpeg->bytes[at + 2] << 8 | jpeg->bytes[at + 3]);

        if (jpeg->bytes[at + 1] != 0xc4) {
            memcpy(out.bytes + out.size, jpeg->bytes + at, length);
            out.size += length;
        }
        at += length;
    }
    memcpy(out.bytes + out.size, jpeg->bytes + at, jpeg->size - at);
    out.size += jpeg->size - at;
    return out;
}

static void same_as(const struct made *jpeg, const struct gsn_frame *frame, const char *line)
{
    auto_kept kept = keep(frame);
    gsn_auto(gsn_picture) before = NULL;
    gsn_auto(gsn_picture) after = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_decode(jpeg->bytes, jpeg->size, NULL, &before, &err), err);
    CHECK_OK(gsn_decode(kept.bytes, kept.size, NULL, &after, &err), err);
    CHECK(same_picture(before->image, after->image));
    CHECK(strcmp(after->withheld, "gain is not locked") == 0);
    CHECK(after->transfer == GSN_TRANSFER_SRGB);
    CHECK(memmem(kept.bytes, kept.size, line, strlen(line)) != NULL);
}

TEST(a_jpeg_stays_one_and_gets_the_tables_it_lacks)
{
    gsn_auto(gsn_image) image = make_picture(40, 24, 3, 8);
    auto_made whole = make_jpeg(image, &(struct jpeg_recipe){ .quality = 80 });
    auto_made bare = without_tables(&whole);
    struct gsn_frame frame = frame_of("MJPG", 40, 24, 0, whole.bytes, whole.size);
    uint8_t *padded = malloc(bare.size + 99);

    CHECK(padded && bare.size < whole.size);
    frame.withheld = "gain is not locked";
    frame.transfer = "sRGB";
    {
        auto_kept kept = keep(&frame);

        CHECK(memmem(kept.bytes, kept.size, "# Huffman tables", 16) == NULL);
        /* What the camera sent is there to the last byte. */
        CHECK(memcmp(kept.bytes + kept.size - (whole.size - 2), whole.bytes + 2, whole.size - 2) ==
              0);
    }
    memcpy(padded, bare.bytes, bare.size); /* some cameras pad behind the EOI */
    memset(padded + bare.size, 0, 99);
    frame.bytes = padded;
    frame.size = bare.size + 99;
    same_as(&whole, &frame, "# Huffman tables: the standard ones, put in\n");
    for (size_t cut = 4; cut < bare.size; cut++) {
        frame.size = cut;
        refuses(&frame, "");
    }
    frame.size = bare.size / 2;
    refuses(&frame, "before the JPEG's EOI");
    frame.size = bare.size;
    frame.width = 41;
    refuses(&frame, "the JPEG states 40 x 24 pixels, the camera 41 x 24");
    free(padded);
}

/* What a camera may send as JPEG: never read beyond, never taken for whole when it is not. */
TEST(damaged_jpeg_frames_are_kept_or_refused)
{
    gsn_auto(gsn_image) image = make_picture(16, 16, 3, 8);
    auto_made whole = make_jpeg(image, &(struct jpeg_recipe){ .quality = 50 });
    unsigned seed = 1;

    for (unsigned i = 0; i < 20000; i++) {
        uint8_t *const copy = malloc(whole.size);
        struct gsn_frame frame;
        uint8_t *bytes = NULL;
        size_t size;

        CHECK(copy != NULL);
        memcpy(copy, whole.bytes, whole.size);
        for (unsigned k = 0; k < 1 + i % 4; k++) {
            seed = seed * 1664525U + 1013904223U;
            copy[(seed >> 8) % whole.size] = (uint8_t)(seed >> 24);
        }
        frame = frame_of("MJPG", 16, 16, 0, copy, i % 3 ? whole.size : (seed >> 4) % whole.size);
        (void)gsn_frame_encode(&frame, &bytes, &size, NULL);
        gsn_free(bytes);
        free(copy);
    }
}

static int encode_once(struct gsn_error *err)
{
    const struct gsn_frame frame = frame_of("GREY", 2, 1, 2, "ab", 2);
    uint8_t *bytes = NULL;
    char *facts = NULL;
    size_t size;
    int r = gsn_frame_encode(&frame, &bytes, &size, err);

    if (r >= 0)
        r = gsn_frame_facts(&frame, 0, NULL, &facts, err);
    gsn_free(bytes);
    gsn_free(facts);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(encode_once(&err), err);
}

/* netpbm reads what we write: the same samples come out of its own PNG. */
static void netpbm_reads(const struct gsn_frame *frame, const char *words)
{
    char path[] = "/tmp/gieson_frame_XXXXXX", command[300];
    const int fd = mkstemp(path);
    auto_kept kept = keep(frame);
    int status;

    CHECK(fd >= 0 && write(fd, kept.bytes, kept.size) == (ssize_t)kept.size);
    (void)snprintf(
        command, sizeof command,
        "pamfile %s | tr '\\n' ' ' | grep -q '%s' && pamtopam <%s | tail -c %zu | cmp - %s.payload",
        path, words, path, kept.payload_size, path);
    {
        char payload[64];
        FILE *file;

        (void)snprintf(payload, sizeof payload, "%s.payload", path);
        file = fopen(payload, "wb");
        CHECK(file && fwrite(kept.payload, 1, kept.payload_size, file) == kept.payload_size);
        (void)fclose(file);
        status = system(command);
        (void)unlink(payload);
    }
    (void)close(fd);
    (void)unlink(path);
    if (!WIFEXITED(status) || WEXITSTATUS(status) != 0)
        fail_msg("netpbm does not read it: %s", command);
}

TEST(netpbm_reads_frames)
{
    static const uint8_t words[] = { 0x34, 0x02, 0xff, 0x03 };
    struct gsn_frame frame;

    if (system("command -v pamfile >/dev/null") != 0) {
        gsn_check_skip("netpbm is not installed");
    }
    frame = frame_of("RGB3", 2, 1, 6, "abcdef", 6);
    netpbm_reads(&frame, "2 by 1 by 3 maxval 255.*RGB");
    frame = frame_of("Y10", 2, 1, 4, words, 4);
    netpbm_reads(&frame, "2 by 1 by 1 maxval 1023.*GRAYSCALE");
    frame = frame_of("YUYV", 2, 1, 4, "abcd", 4);
    netpbm_reads(&frame, "2 by 1 by 2 maxval 255.*YUYV");
}
