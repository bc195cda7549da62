/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/decode/tiff.h"

enum { MOST_PAGES = 1024 };

/* Classic and BigTIFF differ in these widths only. */
struct chain {
    struct gsn_bytes file;
    int big_endian;
    unsigned offset_size, count_size, entry_size;
};

static uint64_t get(const struct chain *chain, uint64_t at, unsigned bytes)
{
    uint64_t value = 0;

    for (unsigned i = 0; i < bytes; i++) {
        const uint64_t from = chain->big_endian ? at + i : at + bytes - 1 - i;

        value = value << 8 | chain->file.at[from];
    }
    return value;
}

static int inside(const struct chain *chain, uint64_t at, uint64_t count)
{
    return at <= chain->file.size && count <= chain->file.size - at;
}

/* Where the directory behind the one at this offset begins; 0 behind the last. */
static int next_page(const struct chain *chain, unsigned page, uint64_t at, uint64_t *ret_next,
                     struct gsn_error *err)
{
    uint64_t count;

    if (!inside(chain, at, chain->count_size))
        return gsn_fail(err, GSN_E_INPUT,
                        "truncated TIFF: page %u is to begin at byte %llu, the file ends at %zu; "
                        "copy or scan it again",
                        page, (unsigned long long)at, chain->file.size);
    count = get(chain, at, chain->count_size);
    if (count > chain->file.size ||
        !inside(chain, at, chain->count_size + count * chain->entry_size + chain->offset_size))
        return gsn_fail(err, GSN_E_INPUT,
                        "truncated TIFF: the directory of page %u, at byte %llu, is to hold %llu "
                        "entries, the file ends at %zu",
                        page, (unsigned long long)at, (unsigned long long)count, chain->file.size);
    *ret_next = get(chain, at + chain->count_size + count * chain->entry_size, chain->offset_size);
    return GSN_OK;
}

static int refuse_loop(const uint64_t *seen, unsigned count, uint64_t next, struct gsn_error *err)
{
    for (unsigned i = 0; i < count; i++)
        if (seen[i] == next)
            return gsn_fail(err, GSN_E_INPUT,
                            "corrupt TIFF: page %u of its chain is followed by page %u again",
                            count, i + 1);
    return GSN_OK;
}

static int walk(const struct chain *chain, uint64_t at, unsigned *ret_pages, struct gsn_error *err)
{
    uint64_t seen[MOST_PAGES];
    unsigned pages = 0;
    int r;

    while (at != 0) {
        if (pages == MOST_PAGES)
            return gsn_fail(err, GSN_E_LIMIT, "a TIFF of more than %d pages", MOST_PAGES);
        seen[pages++] = at;
        r = next_page(chain, pages, at, &at, err);
        if (r < 0)
            return r;
        r = refuse_loop(seen, pages, at, err);
        if (r < 0)
            return r;
    }
    if (pages == 0)
        return gsn_fail(err, GSN_E_INPUT, "a TIFF without a page");
    *ret_pages = pages;
    return GSN_OK;
}

int gsn_tiff_count_pages(struct gsn_bytes file, unsigned *ret_pages, struct gsn_error *err)
{
    struct chain chain = { file, file.at[0] == 'M', 4, 2, 12 };
    uint64_t first = 4;

    if (get(&chain, 2, 2) == 43) {
        chain = (struct chain){ file, chain.big_endian, 8, 8, 20 };
        first = 8;
    }
    if (!inside(&chain, first, chain.offset_size))
        return gsn_fail(err, GSN_E_INPUT,
                        "truncated TIFF: the file ends in its header, at byte %zu", file.size);
    return walk(&chain, get(&chain, first, chain.offset_size), ret_pages, err);
}
