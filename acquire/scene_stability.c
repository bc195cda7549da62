/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether the scene under the camera is stable, from thumbnails of brightness alone.
 *
 * Steps, a frame.
 * 1. The frame becomes 32 x 24 cells of mean brightness, 16 x 16 points each.
 * 2. A run is made of frames that each differ from the one before by no more than the noise. When
 * it is long enough, its ends may differ by at most twice the median of what neighbours differ by,
 * which is the noise of those very frames; a slow slide fails here.
 * 3. A stable scene is taken unless it is known: the panel taken last, what a person showed as
 * glass or as dark, or darkness itself, all within the noise.
 * 4. Then nothing is taken until the scene changes by twice the noise.
 *
 * How it fails: it does not; a lamp that drifts makes a second picture, which is better than none.
 * Cost: 200 000 points a frame, whatever its size. */
#include "acquire/scene_stability.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Points looked at along each side of a cell: enough to average noise away, cheap at any size. */
enum { POINTS = 16 };

/* Cells of a still picture without any noise still differ by rounding. */
static const float ROUNDING = 0.25F;

/* The brightness at (x, y), 0..255. */
static float brightness_at(const struct gsn_frame *frame, uint32_t x, uint32_t y)
{
    const struct gsn_pixel_format *const format = frame->format;
    const uint8_t *const row = frame->bytes + (size_t)y * frame->stride;

    switch (format->packing) {
    case GSN_PACKING_WORDS:
        return (float)(row[2 * (size_t)x] | row[2 * (size_t)x + 1] << 8) * 255.0F /
               (float)((1 << format->bits) - 1);
    case GSN_PACKING_CSI10:
        return row[(size_t)x / 4 * 5 + x % 4];
    case GSN_PACKING_CSI12:
        return row[(size_t)x / 2 * 3 + x % 2];
    default:
        return row[format->luma + (size_t)x * format->luma_step];
    }
}

static bool is_complete(const struct gsn_frame *frame)
{
    const uint64_t row = gsn_pixel_format_row(frame->format, frame->width);

    return row > 0 && frame->height > 0 && frame->stride >= row &&
           (frame->height - 1) * (uint64_t)frame->stride + row <= frame->size;
}

/* Where cell i of count begins; every cell has a pixel, also of a tiny frame. */
static uint32_t cell_edge(uint32_t size, unsigned i, unsigned count)
{
    return (uint32_t)((uint64_t)size * i / count);
}

static float mean_brightness(const struct gsn_frame *frame, unsigned column, unsigned row)
{
    const uint32_t x0 = cell_edge(frame->width, column, GSN_THUMBNAIL_COLUMNS);
    const uint32_t x1 = cell_edge(frame->width, column + 1, GSN_THUMBNAIL_COLUMNS);
    const uint32_t y0 = cell_edge(frame->height, row, GSN_THUMBNAIL_ROWS);
    const uint32_t y1 = cell_edge(frame->height, row + 1, GSN_THUMBNAIL_ROWS);
    /* An odd step meets all four colours of a Bayer pattern. */
    const uint32_t step_x = (x1 - x0) / POINTS | 1, step_y = (y1 - y0) / POINTS | 1;
    float sum = brightness_at(frame, x0, y0);
    unsigned count = 1;

    for (uint32_t y = y0; y < y1; y += step_y) {
        for (uint32_t x = x0; x < x1; x += step_x, count++)
            sum += brightness_at(frame, x, y);
    }
    return sum / (float)count;
}

int gsn_thumbnail_make(const struct gsn_frame *frame, struct gsn_thumbnail *ret_thumbnail)
{
    if (!is_complete(frame))
        return 0;
    for (unsigned row = 0; row < GSN_THUMBNAIL_ROWS; row++) {
        for (unsigned column = 0; column < GSN_THUMBNAIL_COLUMNS; column++)
            ret_thumbnail->cell[row * GSN_THUMBNAIL_COLUMNS + column] =
                mean_brightness(frame, column, row);
    }
    return 1;
}

float gsn_thumbnail_difference(const struct gsn_thumbnail *a, const struct gsn_thumbnail *b)
{
    float most = 0;

    for (size_t i = 0; i < sizeof a->cell / sizeof a->cell[0]; i++)
        most = fmaxf(most, fabsf(a->cell[i] - b->cell[i]));
    return most;
}

/* Sixteenths of a step of brightness, which two letters can count. */
static const float FINENESS = 16;
static const char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

void gsn_thumbnail_write(const struct gsn_thumbnail *thumbnail,
                         char ret_text[GSN_THUMBNAIL_TEXT + 1])
{
    for (size_t i = 0; i < GSN_THUMBNAIL_TEXT / 2; i++) {
        const float bounded = fminf(fmaxf(thumbnail->cell[i], 0), 255);
        const unsigned count = (unsigned)(bounded * FINENESS + 0.5F);

        ret_text[2 * i] = letters[count / 64];
        ret_text[2 * i + 1] = letters[count % 64];
    }
    ret_text[GSN_THUMBNAIL_TEXT] = '\0';
}

/* What a letter counts; -1: it is none. */
static int count_of(char letter)
{
    const char *const at = letter ? strchr(letters, letter) : NULL;

    return at ? (int)(at - letters) : -1;
}

/* In JSON the key with its bare quotes cannot stand inside of a string. */
static const char *find_thumbnail(const char *facts)
{
    static const char key[] = "\"thumbnail\":\"";
    const char *const at = facts ? strstr(facts, key) : NULL;

    return at ? at + sizeof key - 1 : NULL;
}

int gsn_thumbnail_read(const char *facts, struct gsn_thumbnail *ret_thumbnail)
{
    const char *const text = find_thumbnail(facts);
    struct gsn_thumbnail thumbnail;

    if (!text || strcspn(text, "\"") != GSN_THUMBNAIL_TEXT || !text[GSN_THUMBNAIL_TEXT])
        return 0;
    for (size_t i = 0; i < GSN_THUMBNAIL_TEXT / 2; i++) {
        const int high = count_of(text[2 * i]), low = count_of(text[2 * i + 1]);

        if (high < 0 || low < 0 || high * 64 + low > 255 * FINENESS)
            return 0;
        thumbnail.cell[i] = (float)(high * 64 + low) / FINENESS;
    }
    *ret_thumbnail = thumbnail;
    return 1;
}

struct gsn_stability gsn_stability_begin(unsigned frames, float noise)
{
    return (struct gsn_stability){ .frames = frames, .noise = noise };
}

static int compare_floats(const void *a, const void *b)
{
    const float x = *(const float *)a, y = *(const float *)b;

    return (x > y) - (x < y);
}

/* What neighbours differ by, in the frames of this run. */
static float median_between(const struct gsn_stability *rest)
{
    const unsigned count = rest->run - 1;
    float sorted[GSN_STABILITY_MAX_FRAMES];

    memcpy(sorted, rest->between, count * sizeof sorted[0]);
    qsort(sorted, count, sizeof sorted[0], compare_floats);
    return sorted[count / 2];
}

/* A run begins anew with this frame. */
static void restart_run(struct gsn_stability *rest, const struct gsn_thumbnail *now)
{
    rest->first = *now;
    rest->run = 1;
}

static bool is_known(const struct gsn_stability *rest, const struct gsn_thumbnail *now)
{
    static const struct gsn_thumbnail darkness;
    bool known = gsn_thumbnail_difference(&darkness, now) <= 2 * rest->noise;

    for (size_t i = 0; i < GSN_SUBJECTS && !known; i++)
        known = rest->is_known[i] && gsn_thumbnail_difference(&rest->known[i], now) <= rest->noise;
    return known;
}

/* The run is long enough: did only noise differ in it? */
static enum gsn_stability_answer judge_run(struct gsn_stability *rest,
                                           const struct gsn_thumbnail *now)
{
    const float across = gsn_thumbnail_difference(&rest->first, now);
    const float drift = 2 * median_between(rest) + ROUNDING;
    bool known;

    restart_run(rest, now);
    if (across > drift)
        return GSN_STABILITY_MOVING;
    known = is_known(rest, now);
    rest->is_waiting = true;
    if (known)
        return GSN_STABILITY_WAITING;
    gsn_stability_know(rest, GSN_SUBJECT_PANEL, now);
    return GSN_STABILITY_TAKE;
}

enum gsn_stability_answer gsn_stability_update(struct gsn_stability *rest,
                                               const struct gsn_thumbnail *now)
{
    const float step = rest->run ? gsn_thumbnail_difference(&rest->previous, now) : 0;

    rest->previous = *now;
    /* While waiting, first is the frame at which rest was found; a lamp that drifts away from it
     * by that much makes a second picture: better twice than never. */
    if (rest->is_waiting &&
        (step > 2 * rest->noise || gsn_thumbnail_difference(&rest->first, now) > 2 * rest->noise))
        rest->is_waiting = false;
    else if (rest->is_waiting)
        return GSN_STABILITY_WAITING;
    if (rest->run == 0 || step > rest->noise) {
        restart_run(rest, now);
        return GSN_STABILITY_MOVING;
    }
    rest->between[rest->run - 1] = step;
    rest->run++;
    return rest->run < rest->frames ? GSN_STABILITY_MOVING : judge_run(rest, now);
}

void gsn_stability_know(struct gsn_stability *rest, enum gsn_source_subject subject,
                        const struct gsn_thumbnail *thumbnail)
{
    rest->known[subject] = *thumbnail;
    rest->is_known[subject] = true;
}
