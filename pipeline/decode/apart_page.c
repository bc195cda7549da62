/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/decode/apart_page.h"

#include "pipeline/decode/raster.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>

static int fits(const struct gsn_decode_page *page, uint64_t size)
{
    return memcmp(page->magic, GSN_DECODE_PAGE_MAGIC, sizeof page->magic) == 0 &&
           page->whole_size == size && page->file_at >= GSN_DECODE_PAGE_BYTES &&
           page->file_size <= size && page->file_at <= size - page->file_size &&
           page->samples_at >= page->file_at + page->file_size && page->samples_at <= size &&
           page->most_bytes <= size - page->samples_at;
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
    if (!fits(page, (uint64_t)status.st_size)) {
        (void)munmap(page, (size_t)status.st_size);
        return gsn_fail(err, GSN_E_INPUT, "the question is damaged, or of another version");
    }
    *ret_page = page;
    return GSN_OK;
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

void gsn_decode_page_answer(struct gsn_decode_page *page)
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

    page->code = gsn_decode_into(memory + page->file_at, page->file_size, &limits,
                                 memory + page->samples_at, &picture, &said);
    memcpy(page->text, said.text, sizeof page->text);
    if (picture)
        describe(picture, page);
    page->answered = 1;
}
