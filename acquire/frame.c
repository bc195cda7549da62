/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/frame.h"

#include <string.h>

#include "acquire/frame_jpeg.h"
#include "acquire/text.h"

const char *gsn_frame_subject(enum gsn_source_subject subject)
{
    static const char *const names[] = { "panel", "blank", "dark" };

    return names[subject];
}

const char *gsn_frame_name(const struct gsn_frame *frame)
{
    static const char *const names[3][2] = { { "panel.pam", "panel.jpg" },
                                             { "blank.pam", "blank.jpg" },
                                             { "dark.pam", "dark.jpg" } };

    return names[frame->subject][frame->format->packing == GSN_PACKING_JPEG];
}

static void add_controls(struct gsn_text *text, const struct gsn_frame *frame)
{
    for (size_t i = 0; i < frame->control_count; i++) {
        const struct gsn_frame_control *const control = &frame->control[i];

        if (control->is_known)
            gsn_text_add(text, "# %s: %lld%s%s, %s\n", control->name, (long long)control->value,
                         control->unit[0] ? " " : "", control->unit,
                         control->unlock ? "not locked" : "locked");
        else
            gsn_text_add(text, "# %s: not known\n", control->name);
    }
}

static void add_optional(struct gsn_text *text, const char *key, const char *value)
{
    if (value)
        gsn_text_add_line(text, key, value);
}

static void add_lines(struct gsn_text *text, const struct gsn_frame *frame)
{
    gsn_text_add(text, "# gieson frame 1\n");
    gsn_text_add_line(text, "device", frame->device);
    gsn_text_add_line(text, "interface", frame->interface);
    gsn_text_add_line(text, "format", frame->format->fourcc);
    gsn_text_add(text, "# size: %u x %u\n", frame->width, frame->height);
    add_optional(text, "colorspace", frame->colorspace);
    add_optional(text, "matrix", frame->matrix);
    add_optional(text, "range", frame->range);
    add_optional(text, "transfer", frame->transfer);
    gsn_text_add_line(text, "subject", gsn_frame_subject(frame->subject));
    add_controls(text, frame);
    add_optional(text, "not to be measured", frame->withheld);
}

/* The header of a PAM that holds this frame. */
static void add_header(struct gsn_text *text, const struct gsn_frame *frame)
{
    const struct gsn_pixel_format *const format = frame->format;
    const uint32_t rows =
        format->packing == GSN_PACKING_NV12 ? frame->height / 2 * 3 : frame->height;

    gsn_text_add(text, "P7\n");
    add_lines(text, frame);
    gsn_text_add(text, "WIDTH %u\nHEIGHT %u\nDEPTH %u\nMAXVAL %u\nTUPLTYPE %s\nENDHDR\n",
                 frame->width, rows, format->depth, (1U << format->bits) - 1, format->tupltype);
}

static void take_words(const uint8_t *from, uint8_t *to, uint32_t width)
{
    for (size_t i = 0; i < (size_t)width * 2; i += 2) {
        to[i] = from[i + 1];
        to[i + 1] = from[i];
    }
}

static void put_word(uint8_t *to, unsigned sample)
{
    to[0] = (uint8_t)(sample >> 8);
    to[1] = (uint8_t)sample;
}

static void take_csi10(const uint8_t *from, uint8_t *to, uint32_t width)
{
    for (uint32_t x = 0; x < width; x++) {
        const uint8_t *const group = from + (size_t)x / 4 * 5;

        put_word(to + (size_t)x * 2, (unsigned)group[x % 4] << 2 | (group[4] >> 2 * (x % 4) & 3U));
    }
}

static void take_csi12(const uint8_t *from, uint8_t *to, uint32_t width)
{
    for (uint32_t x = 0; x < width; x++) {
        const uint8_t *const pair = from + (size_t)x / 2 * 3;

        put_word(to + (size_t)x * 2, (unsigned)pair[x % 2] << 4 | (pair[2] >> 4 * (x % 2) & 15U));
    }
}

/* A word that says more than its bits can: the camera shifts its samples, or sends rubbish. */
static int check_words(const struct gsn_frame *frame, const uint8_t *row, uint32_t y,
                       struct gsn_error *err)
{
    const unsigned most = (1U << frame->format->bits) - 1;

    for (uint32_t x = 0; x < frame->width; x++) {
        const unsigned sample = (unsigned)row[2 * (size_t)x] << 8 | row[2 * (size_t)x + 1];

        if (sample > most)
            return gsn_fail(err, GSN_E_INPUT,
                            "sample (%u, %u) is %u, but %.4s has %u bits: the camera delivers "
                            "another format than it states",
                            x, y, sample, frame->format->fourcc, frame->format->bits);
    }
    return GSN_OK;
}

static int take_row(const struct gsn_frame *frame, uint32_t y, uint8_t *to, struct gsn_error *err)
{
    const uint8_t *const from = frame->bytes + (size_t)y * frame->stride;

    switch (frame->format->packing) {
    case GSN_PACKING_WORDS:
        take_words(from, to, frame->width);
        return check_words(frame, to, y, err);
    case GSN_PACKING_CSI10:
        take_csi10(from, to, frame->width);
        return GSN_OK;
    case GSN_PACKING_CSI12:
        take_csi12(from, to, frame->width);
        return GSN_OK;
    default:
        memcpy(to, from, (size_t)gsn_pixel_format_row(frame->format, frame->width));
        return GSN_OK;
    }
}

static int check_payload(const struct gsn_frame *frame, uint64_t rows, struct gsn_error *err)
{
    const uint64_t row = gsn_pixel_format_row(frame->format, frame->width);
    const uint64_t needed = rows ? (rows - 1) * frame->stride + row : 0;
    const uint32_t odd = frame->format->packing == GSN_PACKING_NV12
                             ? frame->width % 2 | frame->height % 2
                             : (frame->format->depth == 2 ? frame->width % 2 : 0);

    if (!row || !rows || frame->stride < row)
        return gsn_fail(err, GSN_E_INPUT, "%u x %u pixels of %.4s do not fit into rows of %u bytes",
                        frame->width, frame->height, frame->format->fourcc, frame->stride);
    if (odd)
        return gsn_fail(err, GSN_E_INPUT,
                        "%.4s has no pictures of %u x %u pixels: U and V are "
                        "shared by two",
                        frame->format->fourcc, frame->width, frame->height);
    if (frame->size < needed)
        return gsn_fail(err, GSN_E_INPUT,
                        "the frame has %zu bytes where %u x %u pixels of %.4s need %llu",
                        frame->size, frame->width, frame->height, frame->format->fourcc,
                        (unsigned long long)needed);
    return GSN_OK;
}

static int encode_pam(const struct gsn_frame *frame, struct gsn_text *header, uint8_t **ret_bytes,
                      size_t *ret_size, struct gsn_error *err)
{
    const struct gsn_pixel_format *const format = frame->format;
    const uint32_t rows =
        format->packing == GSN_PACKING_NV12 ? frame->height / 2 * 3 : frame->height;
    const size_t row = (size_t)frame->width * format->depth * (format->bits > 8 ? 2 : 1);
    gsn_auto_mem(uint8_t) file = NULL;
    int r = check_payload(frame, rows, err);

    if (r < 0)
        return r;
    add_header(header, frame);
    if (!header->starved)
        file = gsn_alloc(header->used + rows * row);
    if (!file)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a frame");
    memcpy(file, header->at, header->used);
    for (uint32_t y = 0; y < rows && r >= 0; y++)
        r = take_row(frame, y, file + header->used + y * row, err);
    if (r < 0)
        return r;
    *ret_size = header->used + rows * row;
    *ret_bytes = gsn_steal(&file);
    return GSN_OK;
}

static int encode_jpeg(const struct gsn_frame *frame, struct gsn_text *lines, uint8_t **ret_bytes,
                       size_t *ret_size, struct gsn_error *err)
{
    struct gsn_jpeg_stream stream;
    const int r = gsn_jpeg_stream_check(frame, &stream, err);

    if (r < 0)
        return r;
    add_lines(lines, frame);
    if (!stream.has_tables)
        gsn_text_add_line(lines, "Huffman tables", "the standard ones, put in");
    if (lines->starved)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a frame");
    return gsn_jpeg_stream_keep(frame, &stream, lines->at, ret_bytes, ret_size, err);
}

int gsn_frame_encode(const struct gsn_frame *frame, uint8_t **ret_bytes, size_t *ret_size,
                     struct gsn_error *err)
{
    struct gsn_text text = { 0 };
    const int r = frame->format->packing == GSN_PACKING_JPEG
                      ? encode_jpeg(frame, &text, ret_bytes, ret_size, err)
                      : encode_pam(frame, &text, ret_bytes, ret_size, err);

    gsn_free(text.at);
    return r;
}

static void add_member(struct gsn_text *text, const char *key, const char *value)
{
    if (!value)
        return;
    gsn_text_add(text, ",\"%s\":", key);
    gsn_text_add_json(text, value);
}

static void add_control_members(struct gsn_text *text, const struct gsn_frame_control *control)
{
    gsn_text_add(text, "{\"name\":");
    gsn_text_add_json(text, control->name);
    if (control->is_known)
        gsn_text_add(text, ",\"value\":%lld", (long long)control->value);
    if (control->unit[0])
        add_member(text, "unit", control->unit);
    gsn_text_add(text, ",\"locked\":%s", control->unlock ? "false" : "true");
    add_member(text, "reason", control->unlock);
    gsn_text_add(text, "}");
}

int gsn_frame_facts(const struct gsn_frame *frame, unsigned damaged, const char *thumbnail,
                    char **ret_json, struct gsn_error *err)
{
    struct gsn_text text = { 0 };

    gsn_text_add(&text, "{\"device\":");
    gsn_text_add_json(&text, frame->device);
    add_member(&text, "interface", frame->interface);
    add_member(&text, "format", frame->format->fourcc);
    gsn_text_add(&text, ",\"width\":%u,\"height\":%u,\"stride\":%u", frame->width, frame->height,
                 frame->stride);
    add_member(&text, "colorspace", frame->colorspace);
    add_member(&text, "matrix", frame->matrix);
    add_member(&text, "range", frame->range);
    add_member(&text, "transfer", frame->transfer);
    add_member(&text, "subject", gsn_frame_subject(frame->subject));
    gsn_text_add(&text, ",\"damaged_before\":%u,\"controls\":[", damaged);
    for (size_t i = 0; i < frame->control_count; i++) {
        gsn_text_add(&text, i ? "," : "");
        add_control_members(&text, &frame->control[i]);
    }
    gsn_text_add(&text, "],\"quantify\":%s", frame->withheld ? "false" : "true");
    add_member(&text, "reason", frame->withheld);
    add_member(&text, "thumbnail", thumbnail);
    gsn_text_add(&text, "}");
    if (text.starved) {
        gsn_free(text.at);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the facts of a frame");
    }
    *ret_json = text.at;
    return GSN_OK;
}
