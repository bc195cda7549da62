/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/decode/apart_page.h"

#include "pipeline/decode/raster.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>

/* Room for one descriptor beside a message, aligned as the kernel wants it. */
union beside {
    char room[CMSG_SPACE(sizeof(int))];
    struct cmsghdr aligned;
};

int gsn_decode_send(int socket, int fd)
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

static void describe(const struct gsn_picture *picture, struct gsn_decode_page *page)
{
    page->width = picture->image->width;
    page->height = picture->image->height;
    page->channels = picture->image->channels;
    page->bits = picture->image->bits;
    page->pages = picture->pages;
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
        describe(picture, page);
    page->answered = 1;
}
