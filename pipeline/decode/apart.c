/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Decoding in a child that stays warm.
 *
 * Method: a pool of channels. A channel is a child, a socket to it, and memory that both have
 * mapped. A question is one page of limits in that memory and the file's descriptor over the
 * socket; the child maps the file, so none of its bytes are copied, and decodes to where the
 * samples stay. Then it sends a byte. The samples are the caller's until it frees the picture, and
 * with that the channel is free for the next file: no program is started and no page is zeroed
 * anew.
 *
 * Failure: a child that dies, hangs or lies costs the file it was asked about. Whoever refused a
 * file is not asked again either, for that file may be why: the next one gets a new child. Cost:
 * 0.1 ms a question beside the decoding; a new child 3 ms, and every page of memory that was not
 * used before about 0.5 us. */
#include "pipeline/decode/apart.h"

#include "pipeline/core/file.h"
#include "pipeline/core/process.h"
#include "pipeline/decode/apart_page.h"
#include "pipeline/decode/raster.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

/* --- the page that both sides have mapped --- */

/* Room for one descriptor beside a message, aligned as the kernel wants it. */
union beside {
    char room[CMSG_SPACE(sizeof(int))];
    struct cmsghdr aligned;
};

/* The worker's half: sends a descriptor. Returns 0, or -1 with errno. */
static int send_descriptor(int socket, int fd)
{
    char byte = 0;
    union beside beside = { .room = { 0 } };
    struct iovec text = { .iov_base = &byte, .iov_len = 1 };
    struct msghdr message = { .msg_iov = &text,
                              .msg_iovlen = 1,
                              .msg_control = beside.room,
                              .msg_controllen = sizeof beside.room };
    struct cmsghdr *head = CMSG_FIRSTHDR(&message);

    head->cmsg_level = SOL_SOCKET;
    head->cmsg_type = SCM_RIGHTS;
    head->cmsg_len = CMSG_LEN(sizeof fd);
    memcpy(CMSG_DATA(head), &fd, sizeof fd);
    for (;;) {
        if (sendmsg(socket, &message, MSG_NOSIGNAL) >= 0)
            return 0;
        if (errno != EINTR)
            return -1;
    }
}

int gsn_decode_receive(int socket)
{
    char byte;
    union beside beside;
    struct iovec text = { .iov_base = &byte, .iov_len = 1 };
    struct msghdr message = { .msg_iov = &text,
                              .msg_iovlen = 1,
                              .msg_control = beside.room,
                              .msg_controllen = sizeof beside.room };
    const struct cmsghdr *head;
    ssize_t got;
    int fd = -1;

    do
        got = recvmsg(socket, &message, 0);
    while (got < 0 && errno == EINTR);
    head = got > 0 ? CMSG_FIRSTHDR(&message) : NULL;
    if (head && head->cmsg_level == SOL_SOCKET && head->cmsg_type == SCM_RIGHTS &&
        head->cmsg_len == CMSG_LEN(sizeof fd))
        memcpy(&fd, CMSG_DATA(head), sizeof fd);
    return fd;
}

int gsn_decode_page_map(int fd, struct gsn_decode_page **ret_page, struct gsn_error *err)
{
    struct stat status;
    struct gsn_decode_page *page;

    if (fstat(fd, &status) < 0)
        return gsn_fail(err, GSN_E_IO, "the question: %s", strerror(errno));
    if (!S_ISREG(status.st_mode) || status.st_size < GSN_DECODE_PAGE_BYTES)
        return gsn_fail(err, GSN_E_INPUT,
                        "the question is no shared memory: this program is asked "
                        "by gieson-work, not by people");
    page = mmap(NULL, (size_t)status.st_size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (page == MAP_FAILED)
        return gsn_fail(err, GSN_E_IO, "the question: %s", strerror(errno));
    if (memcmp(page->magic, GSN_DECODE_PAGE_MAGIC, sizeof page->magic) != 0 ||
        page->most_bytes > (uint64_t)status.st_size - GSN_DECODE_PAGE_BYTES) {
        (void)munmap(page, (size_t)status.st_size);
        return gsn_fail(err, GSN_E_INPUT, "the question is damaged, or of another version");
    }
    *ret_page = page;
    return GSN_OK;
}

const uint8_t *gsn_decode_page_file(const struct gsn_decode_page *page, int fd)
{
    static const uint8_t none[1];
    const void *file;

    if (page->file_size == 0)
        return none;
    file = mmap(NULL, page->file_size, PROT_READ, MAP_PRIVATE, fd, 0);
    return file == MAP_FAILED ? NULL : file;
}

static void describe_page(const struct gsn_picture *picture, struct gsn_decode_page *page)
{
    page->width = picture->image->width;
    page->height = picture->image->height;
    page->channels = picture->image->channels;
    page->bits = picture->image->bits;
    page->pages = picture->pages;
    page->lossy = (uint32_t)picture->lossy;
    page->transfer = (uint32_t)picture->transfer;
    page->px_um_x = picture->px_um_x;
    page->px_um_y = picture->px_um_y;
    memcpy(page->kind, picture->kind, sizeof page->kind);
    memcpy(page->note, picture->note, sizeof page->note);
    memcpy(page->withheld, picture->withheld, sizeof page->withheld);
    memcpy(page->profile, picture->profile, sizeof page->profile);
    page->printed_count = picture->code_count;
    memcpy(page->printed, picture->code, sizeof page->printed);
}

void gsn_decode_page_answer(struct gsn_decode_page *page, const uint8_t *file)
{
    const struct gsn_decode_limits limits = { .most_pixels = page->most_pixels,
                                              .most_bytes = page->most_bytes,
                                              .codes = page->codes != 0,
                                              .light = page->light != 0,
                                              .slide = page->slide != 0,
                                              .level = page->level,
                                              .target_um = page->target_um };
    uint8_t *memory = (uint8_t *)page;
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error said = { 0 };

    page->code = gsn_decode_into(file, page->file_size, &limits, memory + GSN_DECODE_PAGE_BYTES,
                                 &picture, &said);
    memcpy(page->text, said.text, sizeof page->text);
    if (picture)
        describe_page(picture, page);
    page->answered = 1;
}

/* --- the pool of children --- */

/* Decoding in a child that stays warm.
 *
 * Method: a pool of channels. A channel is a child, a socket to it, and memory that both have
 * mapped. A question is one page of limits in that memory and the file's descriptor over the
 * socket; the child maps the file, so none of its bytes are copied, and decodes to where the
 * samples stay. Then it sends a byte. The samples are the caller's until it frees the picture, and
 * with that the channel is free for the next file: no program is started and no page is zeroed
 * anew.
 *
 * Failure: a child that dies, hangs or lies costs the file it was asked about. Whoever refused a
 * file is not asked again either, for that file may be why: the next one gets a new child.
 * Cost: 0.1 ms a question beside the decoding; a new child 3 ms, and every page of memory that was
 * not used before about 0.5 us. */

/* What a codec may use beside samples and file: its work, its libraries and its stacks. */
static const uint64_t OWN_BYTES = (uint64_t)256 << 20;
enum { DEFAULT_SECONDS = 120, MOST_FILE_BYTES = 1 << 30 };

/* The sanitizers reserve terabytes of address space and would not start under a limit. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
static const int LIMITS_MEMORY = 0;
#else
static const int LIMITS_MEMORY = 1;
#endif

struct channel {
    struct gsn_decoder *decoder;
    struct channel *next;      /* the next idle one */
    struct gsn_process *child; /* NULL: to be started */
    int socket, memory;        /* -1: none */
    uint8_t *at;               /* the memory: a page, then samples */
    uint64_t size;
};

struct gsn_decoder {
    char *program;
    pthread_mutex_t lock; /* of idle */
    struct channel *idle;
};

int gsn_decoder_new(const char *program, struct gsn_decoder **ret_decoder, struct gsn_error *err)
{
    struct gsn_decoder *decoder = gsn_alloc_array(1, sizeof *decoder);

    if (decoder)
        *decoder = (struct gsn_decoder){ .program = gsn_strdup(program) };
    if (!decoder || !decoder->program || pthread_mutex_init(&decoder->lock, NULL) != 0) {
        if (decoder)
            gsn_free(decoder->program);
        gsn_free(decoder);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a decoder");
    }
    *ret_decoder = decoder;
    return GSN_OK;
}

/* The end of a child, however it comes about. */
static void end_child(struct channel *channel, int at_once, struct gsn_process_end *ret_end)
{
    gsn_fd_close(&channel->socket);
    gsn_process_close(channel->child, at_once, ret_end);
    channel->child = NULL;
}

static void free_channel(struct channel *channel)
{
    if (!channel)
        return;
    end_child(channel, 1, NULL);
    if (channel->at)
        (void)munmap(channel->at, channel->size);
    gsn_fd_close(&channel->memory);
    gsn_free(channel);
}

static void free_idle(struct channel *idle)
{
    while (idle) {
        struct channel *next = idle->next;

        free_channel(idle);
        idle = next;
    }
}

static struct channel *take_idle(struct gsn_decoder *decoder, int all)
{
    struct channel *idle;

    (void)pthread_mutex_lock(&decoder->lock);
    idle = decoder->idle;
    decoder->idle = idle && !all ? idle->next : NULL;
    (void)pthread_mutex_unlock(&decoder->lock);
    return idle;
}

void gsn_decoder_rest(struct gsn_decoder *decoder)
{
    if (decoder)
        free_idle(take_idle(decoder, 1));
}

void gsn_decoder_free(struct gsn_decoder *decoder)
{
    if (!decoder)
        return;
    free_idle(decoder->idle);
    (void)pthread_mutex_destroy(&decoder->lock);
    gsn_free(decoder->program);
    gsn_free(decoder);
}

static void give_back(void *kept)
{
    struct channel *channel = kept;
    struct gsn_decoder *decoder = channel->decoder;

    (void)pthread_mutex_lock(&decoder->lock);
    channel->next = decoder->idle;
    decoder->idle = channel;
    (void)pthread_mutex_unlock(&decoder->lock);
}

/* ---- asking ------------------------------------------------------------------------------ */

static uint64_t whole_pages(uint64_t bytes)
{
    return (bytes + GSN_DECODE_PAGE_BYTES - 1) & ~(uint64_t)(GSN_DECODE_PAGE_BYTES - 1);
}

static uint64_t room_for(const struct gsn_decode_limits *limits)
{
    return GSN_DECODE_PAGE_BYTES + whole_pages(limits->most_bytes);
}

/* Room for samples that are never decoded costs nothing: the memory is sparse. */
static int new_channel(struct gsn_decoder *decoder, uint64_t size, struct channel **ret_channel,
                       struct gsn_error *err)
{
    struct channel *channel = gsn_alloc_array(1, sizeof *channel);
    void *at = MAP_FAILED;

    if (!channel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding");
    *channel = (struct channel){ .decoder = decoder, .socket = -1, .size = size };
    channel->memory = memfd_create("gieson-decode", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    if (channel->memory >= 0 && ftruncate(channel->memory, (off_t)size) == 0 &&
        fcntl(channel->memory, F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW) == 0)
        at = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, channel->memory, 0);
    if (at == MAP_FAILED) {
        free_channel(channel);
        return gsn_fail(err, GSN_E_PROCESS, "no memory to share with the decoder: %s",
                        strerror(errno));
    }
    channel->at = at;
    *ret_channel = channel;
    return GSN_OK;
}

/* An idle channel with this much room, or a new one. */
static int open_channel(struct gsn_decoder *decoder, uint64_t size, struct channel **ret_channel,
                        struct gsn_error *err)
{
    struct channel *channel;

    while ((channel = take_idle(decoder, 0))) {
        if (channel->size == size) {
            *ret_channel = channel;
            return GSN_OK;
        }
        free_channel(channel);
    }
    return new_channel(decoder, size, ret_channel, err);
}

static int start_child(struct channel *channel, struct gsn_error *err)
{
    const char *const argv[] = { channel->decoder->program, NULL };
    int ends[2], r;

    if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends) < 0)
        return gsn_fail(err, GSN_E_PROCESS, "%s could not be started: %s", argv[0],
                        strerror(errno));
    channel->socket = ends[0];
    r = gsn_process_open(argv, ends[1], &channel->child, err);
    (void)close(ends[1]);
    if (r < 0) {
        gsn_fd_close(&channel->socket);
        return r;
    }
    /* One that is gone already will be missed when it is asked. */
    (void)send_descriptor(channel->socket, channel->memory);
    return GSN_OK;
}

static void write_question(struct channel *channel, uint64_t size,
                           const struct gsn_decode_limits *limits)
{
    const struct gsn_decode_page page = { .magic = GSN_DECODE_PAGE_MAGIC,
                                          .most_pixels = limits->most_pixels,
                                          .most_bytes = limits->most_bytes,
                                          .file_size = size,
                                          .codes = limits->codes != 0,
                                          .light = limits->light != 0,
                                          .slide = limits->slide != 0,
                                          .level = limits->level,
                                          .target_um = limits->target_um };

    memcpy(channel->at, &page, sizeof page);
}

/* Lets the channel's child, a new one where there is none, have memory for this file, and sends it.
 * Whether it is still there shows when it is waited for. */
static int ask_child(struct channel *channel, int fd, uint64_t size,
                     const struct gsn_decode_limits *limits, struct gsn_error *err)
{
    int r = GSN_OK;

    write_question(channel, size, limits);
    if (!channel->child)
        r = start_child(channel, err);
    if (r >= 0 && LIMITS_MEMORY)
        r = gsn_process_allow(channel->child, channel->size + OWN_BYTES + size, err);
    if (r >= 0)
        (void)send_descriptor(channel->socket, fd);
    return r;
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

/* Asks and waits for the answer; a child that ends instead has its end judged. One that was there
 * before this file may have ended for another reason (with the thread that had started it, or by
 * what an earlier file did to it), so the file is tried once more with a new one. */
static int exchange_file(struct channel *channel, int fd, uint64_t size,
                         const struct gsn_decode_limits *limits, struct gsn_error *err)
{
    for (;;) {
        const int was_there = channel->child != NULL;
        const int r = ask_child(channel, fd, size, limits, err);
        struct gsn_process_end end;
        char byte;

        if (r < 0)
            return r;
        if (gsn_process_await(channel->child, channel->socket, limits->seconds) &&
            recv(channel->socket, &byte, 1, 0) == 1)
            return GSN_OK;
        end_child(channel, 0, &end);
        if (!was_there || end.late)
            return judge_end(&end, channel->decoder->program, limits, err);
    }
}

/* ---- what it said ------------------------------------------------------------------------ */

static int fail_lied(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT,
                    "the decoder gave an answer that cannot be: do not trust the file, scan again");
}

/* One line of printable text, whatever stood there. */
static void clean_text(char *text, size_t room)
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
static int judge_refusal(const struct gsn_decode_page *page, uint64_t memory_bytes,
                         struct gsn_error *err)
{
    if (page->code == GSN_E_NOMEM)
        return gsn_fail(err, GSN_E_LIMIT,
                        "decoding needs more than %.0f MiB of memory: scan at a lower resolution",
                        (double)memory_bytes / 1048576.0);
    if (page->code != GSN_E_INPUT && page->code != GSN_E_UNSUPPORTED && page->code != GSN_E_LIMIT)
        return fail_lied(err);
    return gsn_fail(err, page->code, "%s", page->text);
}

/* The samples stay where the decoder put them; the channel is the picture's until it is freed. */
static int keep_samples(struct channel *channel, const struct gsn_decode_page *said,
                        struct gsn_picture **ret_picture, struct gsn_error *err)
{
    gsn_auto(gsn_picture) picture = gsn_alloc_array(1, sizeof *picture);
    struct gsn_image *image = picture ? gsn_alloc_array(1, sizeof *image) : NULL;

    if (!image)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding");
    picture->image = image;
    *image = (struct gsn_image){
        .width = said->width, .height = said->height, .channels = said->channels, .bits = said->bits
    };
    image->samples = picture->place = channel->at + GSN_DECODE_PAGE_BYTES;
    (void)madvise(picture->place, gsn_image_bytes(image), MADV_POPULATE_WRITE);
    picture->keeper = channel;
    picture->give_back = give_back;
    picture->px_um_x = said->px_um_x;
    picture->px_um_y = said->px_um_y;
    picture->transfer = (enum gsn_transfer)said->transfer;
    picture->pages = said->pages;
    picture->lossy = said->lossy != 0;
    (void)snprintf(picture->kind, sizeof picture->kind, "%s", said->kind);
    (void)snprintf(picture->note, sizeof picture->note, "%s", said->note);
    (void)snprintf(picture->withheld, sizeof picture->withheld, "%s", said->withheld);
    (void)snprintf(picture->profile, sizeof picture->profile, "%s", said->profile);
    picture->code_count = said->printed_count;
    memcpy(picture->code, said->printed, sizeof picture->code);
    *ret_picture = gsn_steal(&picture);
    return GSN_OK;
}

static int read_answer(struct channel *channel, const struct gsn_decode_limits *limits,
                       uint64_t file_size, struct gsn_picture **ret_picture, struct gsn_error *err)
{
    struct gsn_decode_page said;

    memcpy(&said, channel->at, sizeof said);
    clean_text(said.text, sizeof said.text);
    clean_text(said.profile, sizeof said.profile);
    clean_text(said.kind, sizeof said.kind);
    clean_text(said.note, sizeof said.note);
    clean_text(said.withheld, sizeof said.withheld);
    for (size_t i = 0; i < GSN_CODES; i++) {
        clean_text(said.printed[i].text, sizeof said.printed[i].text);
        clean_text(said.printed[i].kind, sizeof said.printed[i].kind);
        if (!isfinite(said.printed[i].turn_deg))
            said.printed[i].turn_deg = 0;
    }
    if (!said.answered)
        return fail_lied(err);
    if (said.code != GSN_OK)
        return judge_refusal(&said, limits->most_bytes + OWN_BYTES + file_size, err);
    return can_be(&said, limits) ? keep_samples(channel, &said, ret_picture, err) : fail_lied(err);
}

static int decode_apart(struct gsn_decoder *decoder, int fd, uint64_t size,
                        const struct gsn_decode_limits *limits, struct gsn_picture **ret_picture,
                        struct gsn_error *err)
{
    struct channel *channel = NULL;
    int r = open_channel(decoder, room_for(limits), &channel, err);

    if (r < 0)
        return r;
    r = exchange_file(channel, fd, size, limits, err);
    if (r >= 0)
        r = read_answer(channel, limits, size, ret_picture, err);
    if (r < 0)
        free_channel(channel);
    return r;
}

static int decode_here(int fd, const struct gsn_decode_limits *limits,
                       struct gsn_picture **ret_picture, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size;
    int r = gsn_file_read_open(fd, "the picture", MOST_FILE_BYTES, &bytes, &size, err);

    return r < 0 ? r : gsn_decode(bytes, size, limits, ret_picture, err);
}

int gsn_decode_apart(struct gsn_decoder *decoder, int fd, const struct gsn_decode_limits *limits,
                     struct gsn_picture **ret_picture, struct gsn_error *err)
{
    struct gsn_decode_limits most = gsn_decode_defaults(limits);
    struct stat status;

    if (!decoder)
        return decode_here(fd, limits, ret_picture, err);
    if (fstat(fd, &status) < 0)
        return gsn_fail(err, GSN_E_IO, "the picture cannot be read: %s", strerror(errno));
    if (!S_ISREG(status.st_mode))
        return gsn_fail(err, GSN_E_INPUT, "the picture is not a regular file");
    if (status.st_size > MOST_FILE_BYTES)
        return gsn_fail(err, GSN_E_LIMIT, "%lld bytes are more than the limit of %d",
                        (long long)status.st_size, MOST_FILE_BYTES);
    most.seconds = most.seconds ? most.seconds : DEFAULT_SECONDS;
    return decode_apart(decoder, fd, (uint64_t)status.st_size, &most, ret_picture, err);
}
