/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/decode/apart.h"

#include "pipeline/core/process.h"
#include "pipeline/decode/apart_page.h"
#include "pipeline/decode/raster.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

/* What a codec may use beside samples and file: its work, its libraries and its stacks. */
static const uint64_t OWN_BYTES = (uint64_t)256 << 20;
enum { DEFAULT_SECONDS = 120 };

/* The sanitizers reserve terabytes of address space and would not start under a limit. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
static const int LIMITS_MEMORY = 0;
#else
static const int LIMITS_MEMORY = 1;
#endif

struct shared {
    int fd; /* -1: none */
    struct gsn_decode_page page;
};

static void shared_done(struct shared *shared)
{
    if (shared->fd >= 0)
        (void)close(shared->fd);
}

static uint64_t whole_pages(uint64_t bytes)
{
    return (bytes + GSN_DECODE_PAGE_BYTES - 1) & ~(uint64_t)(GSN_DECODE_PAGE_BYTES - 1);
}

static int put(int fd, const void *bytes, size_t size, uint64_t at)
{
    const uint8_t *from = bytes;

    while (size > 0) {
        const ssize_t done = pwrite(fd, from, size, (off_t)at);

        if (done < 0 && errno != EINTR)
            return -1;
        from += done > 0 ? done : 0;
        size -= done > 0 ? (size_t)done : 0;
        at += done > 0 ? (uint64_t)done : 0;
    }
    return 0;
}

/* Room for samples that are never decoded costs nothing: the memory is sparse. */
static int share(struct shared *shared, const void *bytes, size_t size,
                 const struct gsn_decode_limits *limits, struct gsn_error *err)
{
    struct gsn_decode_page *page = &shared->page;

    *page = (struct gsn_decode_page){ .magic = GSN_DECODE_PAGE_MAGIC,
                                      .most_pixels = limits->most_pixels,
                                      .most_bytes = limits->most_bytes,
                                      .codes = limits->codes != 0,
                                      .light = limits->light != 0,
                                      .slide = limits->slide != 0,
                                      .level = limits->level,
                                      .target_um = limits->target_um,
                                      .file_at = GSN_DECODE_PAGE_BYTES,
                                      .file_size = size };
    page->samples_at = page->file_at + whole_pages(size);
    page->whole_size = page->samples_at + whole_pages(limits->most_bytes);
    shared->fd = memfd_create("gieson-decode", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    if (shared->fd < 0 || ftruncate(shared->fd, (off_t)page->whole_size) < 0 ||
        fcntl(shared->fd, F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW) < 0 ||
        put(shared->fd, page, sizeof *page, 0) < 0 ||
        put(shared->fd, bytes, size, page->file_at) < 0)
        return gsn_fail(err, GSN_E_PROCESS, "no memory to share with the decoder: %s",
                        strerror(errno));
    return GSN_OK;
}

/* ---- how it ended ------------------------------------------------------------------------ */

static int judge_end(const struct gsn_process_end *end, const char *decoder,
                     const struct gsn_decode_limits *limits, struct gsn_error *err)
{
    if (end->late || end->signal == SIGXCPU)
        return gsn_fail(err, GSN_E_LIMIT,
                        "decoding did not end within %u s and was stopped: scan again, or export "
                        "the picture anew",
                        limits->seconds);
    if (end->signal == SIGSYS)
        return gsn_fail(err, GSN_E_INPUT,
                        "the decoder was stopped when this file made it do what no picture needs: "
                        "do not trust the file, scan again");
    if (end->signal == SIGKILL)
        return gsn_fail(err, GSN_E_PROCESS, "%s was killed from outside (is memory short?)",
                        decoder);
    if (end->signal)
        return gsn_fail(err, GSN_E_INPUT,
                        "the decoder crashed on this file (%s): scan again, or export the picture "
                        "anew",
                        strsignal(end->signal));
    if (end->code != 0)
        return gsn_fail(err, GSN_E_PROCESS, "%s ended with code %d%s%s", decoder, end->code,
                        end->complaint[0] ? ": " : "", end->complaint);
    return GSN_OK;
}

static int run(const struct shared *shared, const char *decoder,
               const struct gsn_decode_limits *limits, struct gsn_error *err)
{
    const char *const argv[] = { decoder, NULL };
    const struct gsn_process_limits most = {
        .memory_bytes = LIMITS_MEMORY ? shared->page.whole_size + OWN_BYTES : 0,
        .cpu_s = limits->seconds,
        .wall_s = limits->seconds
    };
    struct gsn_process_end end;
    const int r = gsn_process_lend(argv, &most, shared->fd, &end, err);

    return r < 0 ? r : judge_end(&end, decoder, limits, err);
}

/* ---- what it said ------------------------------------------------------------------------ */

static int lied(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT,
                    "the decoder gave an answer that cannot be: do not trust the file, scan again");
}

/* One line of printable text, whatever stood there. */
static void clean(char *text, size_t room)
{
    size_t i;

    for (i = 0; i + 1 < room && text[i]; i++)
        if ((unsigned char)text[i] < ' ' || text[i] == 0x7f)
            text[i] = ' ';
    text[i] = '\0';
}

static int is_pitch(double value)
{
    return isfinite(value) && value >= 0;
}

static int can_be(const struct gsn_decode_page *page, const struct gsn_decode_limits *limits)
{
    const uint64_t pixels = (uint64_t)page->width * page->height;

    return (page->channels == 1 || page->channels == 3) && (page->bits == 8 || page->bits == 16) &&
           pixels > 0 && pixels <= limits->most_pixels &&
           pixels <= limits->most_bytes / (page->channels * page->bits / 8) && page->pages > 0 &&
           page->transfer <= GSN_TRANSFER_PROFILE && page->printed_count <= GSN_CODES &&
           is_pitch(page->px_um_x) && is_pitch(page->px_um_y);
}

/* The codes a decoder has a right to; memory that ran out is its limit, not ours. */
static int refusal(const struct gsn_decode_page *page, uint64_t memory_bytes, struct gsn_error *err)
{
    if (page->code == GSN_E_NOMEM)
        return gsn_fail(err, GSN_E_LIMIT,
                        "decoding needs more than %.0f MiB of memory: scan at a lower resolution",
                        (double)memory_bytes / 1048576.0);
    if (page->code != GSN_E_INPUT && page->code != GSN_E_UNSUPPORTED && page->code != GSN_E_LIMIT)
        return lied(err);
    return gsn_fail(err, page->code, "%s", page->text);
}

/* The samples stay where the decoder put them; nobody else has them any more. */
static int take(const struct shared *shared, const struct gsn_decode_page *said,
                struct gsn_picture **ret_picture, struct gsn_error *err)
{
    gsn_auto(gsn_picture) picture = gsn_alloc_array(1, sizeof *picture);
    struct gsn_image *image = picture ? gsn_alloc_array(1, sizeof *image) : NULL;
    void *samples;

    if (!image)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding");
    picture->image = image;
    *image = (struct gsn_image){
        .width = said->width, .height = said->height, .channels = said->channels, .bits = said->bits
    };
    samples = mmap(NULL, gsn_image_bytes(image), PROT_READ | PROT_WRITE, MAP_PRIVATE, shared->fd,
                   (off_t)shared->page.samples_at);
    if (samples == MAP_FAILED)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding");
    image->samples = picture->place = samples;
    picture->mapped_bytes = gsn_image_bytes(image);
    picture->px_um_x = said->px_um_x;
    picture->px_um_y = said->px_um_y;
    picture->transfer = (enum gsn_transfer)said->transfer;
    picture->pages = said->pages;
    (void)snprintf(picture->kind, sizeof picture->kind, "%s", said->kind);
    (void)snprintf(picture->note, sizeof picture->note, "%s", said->note);
    (void)snprintf(picture->withheld, sizeof picture->withheld, "%s", said->withheld);
    (void)snprintf(picture->profile, sizeof picture->profile, "%s", said->profile);
    picture->code_count = said->printed_count;
    memcpy(picture->code, said->printed, sizeof picture->code);
    *ret_picture = gsn_steal(&picture);
    return GSN_OK;
}

static int hear(const struct shared *shared, const struct gsn_decode_limits *limits,
                struct gsn_picture **ret_picture, struct gsn_error *err)
{
    struct gsn_decode_page said;

    if (pread(shared->fd, &said, sizeof said, 0) != (ssize_t)sizeof said)
        return gsn_fail(err, GSN_E_IO, "the decoder's answer cannot be read");
    clean(said.text, sizeof said.text);
    clean(said.profile, sizeof said.profile);
    clean(said.kind, sizeof said.kind);
    clean(said.note, sizeof said.note);
    clean(said.withheld, sizeof said.withheld);
    for (size_t i = 0; i < GSN_CODES; i++) {
        clean(said.printed[i].text, sizeof said.printed[i].text);
        clean(said.printed[i].kind, sizeof said.printed[i].kind);
        if (!isfinite(said.printed[i].turn_deg))
            said.printed[i].turn_deg = 0;
    }
    if (!said.answered)
        return lied(err);
    if (said.code != GSN_OK)
        return refusal(&said, shared->page.whole_size + OWN_BYTES, err);
    return can_be(&said, limits) ? take(shared, &said, ret_picture, err) : lied(err);
}

int gsn_decode_apart(const char *decoder, const void *bytes, size_t size,
                     const struct gsn_decode_limits *limits, struct gsn_picture **ret_picture,
                     struct gsn_error *err)
{
    __attribute__((cleanup(shared_done))) struct shared shared = { .fd = -1 };
    struct gsn_decode_limits most = gsn_decode_defaults(limits);
    int r;

    if (!decoder)
        return gsn_decode(bytes, size, limits, ret_picture, err);
    most.seconds = most.seconds ? most.seconds : DEFAULT_SECONDS;
    r = share(&shared, bytes, size, &most, err);
    if (r >= 0)
        r = run(&shared, decoder, &most, err);
    return r < 0 ? r : hear(&shared, &most, ret_picture, err);
}
