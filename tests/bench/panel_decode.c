/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A panel of 48 million pixels out of each format, against the bare libraries and OpenCV's imread.
 */
#include "tests/bench/panel_theme.h"

#include "pipeline/decode/raster.h"

#include "tests/bench/bench.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

struct decoding {
    enum bench_format format;
    const char *path;
    uint8_t *bytes; /* room for the samples */
    size_t count;   /* of them */
};

static void decode_bare(void *context)
{
    const struct decoding *job = context;

    if (!bench_format_read(job->format, job->path, job->bytes))
        abort();
}

/* To where the samples shall be, as the bare library does. */
static void decode_ours(void *context)
{
    const struct decoding *job = context;
    const struct bench_file file = bench_file_map(job->path);
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };

    bench_need(gsn_decode_into(file.at, file.size, NULL, job->bytes, &picture, &err), &err,
               "decode");
    (void)munmap(file.at, file.size);
}

/* To memory of its own, as imread does. */
static void decode_fresh(void *context)
{
    const struct decoding *job = context;
    const struct bench_file file = bench_file_map(job->path);
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };

    bench_need(gsn_decode(file.at, file.size, NULL, &picture, &err), &err, "decode");
    (void)munmap(file.at, file.size);
}

/* Both ways have to give the same samples, but for JPEG, where the least digit is the library's.
 */
static void compare(struct decoding *work)
{
    const int lossy = work->format == BENCH_JPEG || work->format == BENCH_TIFF_JPEG;
    uint8_t *const theirs = bench_alloc(work->count, 1);

    decode_bare(work);
    memcpy(theirs, work->bytes, work->count);
    memset(work->bytes, 0, work->count);
    decode_ours(work);
    for (size_t i = 0; i < work->count; i++)
        if (abs(theirs[i] - work->bytes[i]) > lossy) {
            fprintf(stderr, "gieson-bench: %s is not decoded as by the bare library\n",
                    bench_format_name(work->format));
            exit(gsn_code_exit(GSN_E_INPUT));
        }
    gsn_free(theirs);
}

static void decode_format(struct bench_theme *theme, enum bench_format format, uint8_t *bytes)
{
    struct decoding work = { .format = format,
                             .path = theme->path,
                             .bytes = bytes,
                             .count = gsn_image_bytes(theme->panel.image) *
                                      bench_format_bits(format) / 8 };
    struct bench_job job[3] = { { .run = decode_ours, .context = &work },
                                { .run = decode_bare, .context = &work },
                                { .run = decode_fresh, .context = &work } };
    const struct gsn_image *image = theme->panel.image;
    const double mpx = 1e-6 * image->width * image->height;
    const unsigned turns = bench_quick ? 1 : 5;
    double least[3] = { INFINITY, INFINITY, INFINITY }, theirs = INFINITY;

    bench_theme_write(theme, format);
    compare(&work);
    for (unsigned turn = 0; turn < turns; turn++) {
        bench_race(job, 3, 1);
        for (int j = 0; j < 3; j++)
            least[j] = fmin(least[j], job[j].cpu_s);
        theirs = fmin(theirs, bench_theme_ask(theme, "read", NULL));
    }
    bench_say("decode", mpx / least[0], "Mpx/s", "the bare library", least[1] / least[0],
              json_pack("{s:s, s:f}", "format", bench_format_name(format), "megapixel", mpx));
    /* The library's own figure against imread was taken with its memory given; both are said. */
    bench_theme_say(theme, "decode_imread", mpx / least[0], "Mpx/s", "cv2.imread",
                    theirs / least[0],
                    json_pack("{s:s, s:f, s:o}", "format", bench_format_name(format), "megapixel",
                              mpx, "ratio_in_fresh_memory",
                              theme->has_peer ? json_real(theirs / least[2]) : json_null()));
    (void)unlink(theme->path);
}

void bench_decode(void)
{
    enum { PAGE = 4096 };
    struct bench_theme theme;
    uint8_t *bytes;

    if (!bench_theme_begin(&theme, "decode", "Mpx/s"))
        return;
    /* Whole strips are copied at half the speed to an uneven place: of the library's making, not
     * of ours. Samples of 16 bits have room too. */
    bytes = bench_alloc(2 * gsn_image_bytes(theme.panel.image) + PAGE, 1);
    for (int format = 0; format < BENCH_FORMATS; format++)
        decode_format(&theme, (enum bench_format)format, bytes + (PAGE - (uintptr_t)bytes % PAGE));
    gsn_free(bytes);
    bench_theme_end(&theme);
}
