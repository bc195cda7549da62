/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where the pixels of a file go, so that they lie upright as they arrive.
 *
 * Method: each of the eight orientations of EXIF and TIFF is an origin and a step for each of the
 * stored axes. Steps: (1) the size that the header states is checked against the limits; (2)
 * memory: large pictures are mapped with all their pages at once (madvise, MADV_POPULATE_WRITE) or
 * lie at a place that the caller lent; (3) runs of pixels come from the codec: copied where they
 * lie as stored, past the caches where the picture is large (SSE2), scattered where they have to be
 * turned; (4) pixels more transparent than not are counted on the way.
 *
 * Failure: GSN_E_INPUT, GSN_E_LIMIT, GSN_E_NOMEM before any pixel; afterwards none. Cost: each
 * sample is written once. */
#include "pipeline/decode/raster.h"

#include <assert.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

/* From here on memory is worth a mapping of its own. */
#define LARGE_BYTES ((uint64_t)8 << 20)

/* Where stored pixel (0, 0) goes and which way its row and column run, EXIF orientations 1..8:
 * from_right, from_bottom say at which corner the first pixel ends up; turned swaps the axes. */
static const struct corner {
    unsigned from_right : 1, from_bottom : 1, turned : 1;
} corners[9] = {
    [1] = { 0, 0, 0 }, [2] = { 1, 0, 0 }, [3] = { 1, 1, 0 }, [4] = { 0, 1, 0 },
    [5] = { 0, 0, 1 }, [6] = { 1, 0, 1 }, [7] = { 1, 1, 1 }, [8] = { 0, 1, 1 },
};

static int check_limits(const struct gsn_raster_layout *layout,
                        const struct gsn_decode_limits *limits, struct gsn_error *err)
{
    const uint64_t pixels = (uint64_t)layout->width * layout->height;
    const uint64_t pixel_bytes = (uint64_t)layout->channels * layout->bits / 8;

    if (pixels == 0)
        return gsn_fail(err, GSN_E_INPUT, "the header states %u x %u pixels: nothing to decode",
                        layout->width, layout->height);
    if (pixels > limits->most_pixels)
        return gsn_fail(err, GSN_E_LIMIT,
                        "%u x %u pixels are more than the limit of %.0f million: scan at a lower "
                        "resolution or raise the limit",
                        layout->width, layout->height, (double)limits->most_pixels / 1e6);
    if (pixels > limits->most_bytes / pixel_bytes)
        return gsn_fail(err, GSN_E_LIMIT,
                        "%u x %u pixels of %u x %u bit need more than the limit of %.0f MiB: scan "
                        "at a lower resolution or raise the limit",
                        layout->width, layout->height, layout->channels, layout->bits,
                        (double)limits->most_bytes / 1048576.0);
    return GSN_OK;
}

static void swap_pitch(struct gsn_picture *picture)
{
    const double x = picture->px_um_x;

    picture->px_um_x = picture->px_um_y;
    picture->px_um_y = x;
}

/* Every sample is written by its codec, so a large picture need not be zeroed twice: its pages come
 * all at once, which costs two thirds of touching them one by one, or a third of it where the
 * system has pieces of 2 MiB. */
static void map_place(uint64_t bytes, struct gsn_picture *picture)
{
    void *place;

    /* A profile makes 16-bit samples of 8-bit ones, over the old ones: no room behind these. */
    if (bytes < LARGE_BYTES || picture->wants_profile)
        return;
    place = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (place == MAP_FAILED)
        return;
    (void)madvise(place, bytes, MADV_HUGEPAGE);
    (void)madvise(place, bytes, MADV_POPULATE_WRITE); /* older kernels do without */
    picture->place = place;
    picture->mapped_bytes = bytes;
}

/* The picture's image, allocated or at the place that was given for its samples. */
static int make_image(const struct gsn_raster_layout *layout, uint32_t width, uint32_t height,
                      struct gsn_picture *picture, struct gsn_error *err)
{
    const uint64_t bytes = (uint64_t)width * height * layout->channels * layout->bits / 8;

    if (picture->place)
        (void)madvise(picture->place, bytes, MADV_POPULATE_WRITE);
    else
        map_place(bytes, picture);
    if (!picture->place)
        return gsn_image_new(width, height, layout->channels, layout->bits, &picture->image, err);
    picture->image = gsn_alloc_array(1, sizeof *picture->image);
    if (!picture->image)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding");
    *picture->image = (struct gsn_image){ .width = width,
                                          .height = height,
                                          .channels = layout->channels,
                                          .bits = layout->bits,
                                          .samples = picture->place };
    return GSN_OK;
}

int gsn_raster_open(struct gsn_raster *canvas, const struct gsn_raster_layout *layout,
                    const struct gsn_decode_limits *limits, struct gsn_picture *picture,
                    struct gsn_error *err)
{
    const struct corner corner = corners[layout->orientation];
    const uint32_t width = corner.turned ? layout->height : layout->width;
    const uint32_t height = corner.turned ? layout->width : layout->height;
    ptrdiff_t right, down;
    int r;

    assert(layout->orientation >= 1 && layout->orientation <= 8 && !picture->image);

    r = check_limits(layout, limits, err);
    if (r < 0)
        return r;
    r = make_image(layout, width, height, picture, err);
    if (r < 0)
        return r;

    right = corner.from_right ? -1 : 1;
    down = corner.from_bottom ? -(ptrdiff_t)width : (ptrdiff_t)width;
    *canvas = (struct gsn_raster){
        .image = picture->image,
        .origin = (corner.from_right ? (ptrdiff_t)width - 1 : 0) +
                  (corner.from_bottom ? ((ptrdiff_t)height - 1) * (ptrdiff_t)width : 0),
        .step_x = corner.turned ? down : right,
        .step_y = corner.turned ? right : down,
        .transparent = &picture->transparent,
    };
    if (corner.turned)
        swap_pitch(picture);
    if (layout->orientation != 1)
        gsn_picture_remark(picture, "orientation %u applied", layout->orientation);
    return GSN_OK;
}

/* channels is known where this is put to use, so that the loop over it is none. */
static inline void scatter8(uint8_t *to, ptrdiff_t step, const uint8_t *from, size_t stride,
                            size_t count, uint32_t channels)
{
    for (size_t i = 0; i < count; i++, to += step, from += stride)
        for (uint32_t c = 0; c < channels; c++)
            to[c] = from[c];
}

static inline void scatter16(uint16_t *to, ptrdiff_t step, const uint16_t *from, size_t stride,
                             size_t count, uint32_t channels)
{
    for (size_t i = 0; i < count; i++, to += step, from += stride)
        for (uint32_t c = 0; c < channels; c++)
            to[c] = from[c];
}

/* Past the caches: whoever reads a picture larger than they are finds nothing of it there anyway,
 * and memory need not be read before it is written. */
static void stream_bytes(uint8_t *to, const uint8_t *from, size_t bytes)
{
#ifdef __SSE2__
    const size_t uneven = -(uintptr_t)to % sizeof(__m128i), head = uneven < bytes ? uneven : bytes;
    size_t i = head;

    memcpy(to, from, head);
    for (; i + sizeof(__m128i) <= bytes; i += sizeof(__m128i))
        _mm_stream_si128((void *)(to + i), _mm_loadu_si128((const void *)(from + i)));
    memcpy(to + i, from + i, bytes - i);
#else
    memcpy(to, from, bytes);
#endif
}

/* Before another thread may look. */
static void stream_end(void)
{
#ifdef __SSE2__
    _mm_sfence();
#endif
}

/* Whether samples go to the picture as they come, side by side. */
static int is_straight(const struct gsn_raster *canvas, const struct gsn_run *run)
{
    const uint32_t channels = canvas->image->channels;

    return canvas->step_x * (ptrdiff_t)run->step == 1 && run->channels == channels &&
           run->stride == channels;
}

/* Pixels that let more through than they show. */
static void count_transparent(const struct gsn_raster *canvas, const struct gsn_run *run,
                              const void *samples)
{
    const uint8_t *const at8 = samples;
    const uint16_t *const at16 = samples;
    uint64_t count = 0;

    for (size_t i = 0, k = run->channels; i < run->count; i++, k += run->stride)
        count += canvas->image->bits == 8 ? at8[k] < 1 << 7 : at16[k] < 1 << 15;
    *canvas->transparent += count;
}

static void scatter_run(const struct gsn_raster *canvas, const struct gsn_run *run, ptrdiff_t first,
                        const void *samples)
{
    const struct gsn_image *image = canvas->image;
    const ptrdiff_t step = canvas->step_x * (ptrdiff_t)run->step * (ptrdiff_t)image->channels;
    uint8_t *const to8 = image->samples;
    uint16_t *const to16 = image->samples;

    assert(run->channels == 1 || run->channels == 3);

    if (image->bits == 8 && run->channels == 3)
        scatter8(to8 + first, step, samples, run->stride, run->count, 3);
    else if (image->bits == 8)
        scatter8(to8 + first, step, samples, run->stride, run->count, 1);
    else if (run->channels == 3)
        scatter16(to16 + first, step, samples, run->stride, run->count, 3);
    else
        scatter16(to16 + first, step, samples, run->stride, run->count, 1);
}

void gsn_raster_put_rows(const struct gsn_raster *canvas, const struct gsn_run *run, uint32_t rows,
                         size_t row_bytes, const void *samples)
{
    const struct gsn_image *image = canvas->image;
    const size_t sample = image->bits / 8, bytes = run->count * (size_t)run->channels * sample;
    const int straight = is_straight(canvas, run);
    const int large = rows > 1 && gsn_image_bytes(image) >= LARGE_BYTES;
    /* Without a gap on either side rows are one. */
    const int whole = straight && row_bytes == bytes && canvas->step_y == (ptrdiff_t)run->count;
    const size_t length = whole ? rows * bytes : bytes;

    for (uint32_t i = 0; i < (whole ? 1 : rows); i++) {
        const uint8_t *const row = (const uint8_t *)samples + i * row_bytes;
        const ptrdiff_t pixel =
            canvas->origin + run->x * canvas->step_x + ((ptrdiff_t)run->y + i) * canvas->step_y;
        const ptrdiff_t first = pixel * (ptrdiff_t)image->channels + (ptrdiff_t)run->channel;
        uint8_t *const to = (uint8_t *)image->samples + first * (ptrdiff_t)sample;

        if (run->alpha)
            count_transparent(canvas, run, row);
        if (!straight)
            scatter_run(canvas, run, first, row);
        else if (large)
            stream_bytes(to, row, length);
        else
            memcpy(to, row, length);
    }
    if (straight && large)
        stream_end();
}

void gsn_raster_put(const struct gsn_raster *canvas, const struct gsn_run *run, const void *samples)
{
    gsn_raster_put_rows(canvas, run, 1, 0, samples);
}

void *gsn_raster_row(const struct gsn_raster *canvas, uint32_t y)
{
    const struct gsn_image *image = canvas->image;
    const size_t row_bytes = (size_t)image->width * image->channels * (image->bits / 8);

    if (canvas->origin != 0 || canvas->step_x != 1 || canvas->step_y != (ptrdiff_t)image->width)
        return NULL;
    return (uint8_t *)image->samples + y * row_bytes;
}

void gsn_picture_remark(struct gsn_picture *picture, const char *format, ...)
{
    char remark[sizeof picture->note];
    const size_t used = strlen(picture->note);
    const char *glue = used ? "; " : "";
    va_list args;

    va_start(args, format);
    (void)vsnprintf(remark, sizeof remark, format, args);
    va_end(args);
    if (used + strlen(glue) + strlen(remark) < sizeof picture->note)
        (void)snprintf(picture->note + used, sizeof picture->note - used, "%s%s", glue, remark);
}

static double find_pitch(double per_unit, double unit_um)
{
    /* NaN is not above 0 either; what remains of nonsense would be pixels of kilometres. */
    return per_unit > 1e-9 && per_unit < 1e12 ? unit_um / per_unit : 0;
}

void gsn_picture_pitch(struct gsn_picture *picture, double per_unit_x, double per_unit_y,
                       double unit_um)
{
    const double x = find_pitch(per_unit_x, unit_um), y = find_pitch(per_unit_y, unit_um);

    if (x > 0 && y > 0) {
        picture->px_um_x = x;
        picture->px_um_y = y;
    }
}
