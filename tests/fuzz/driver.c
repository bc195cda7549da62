/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Runs a fuzz target where libFuzzer is not at hand: every file of the corpus as it is, then so
 * many inputs made of them.
 *
 *     fuzz_TARGET [-runs=N] [-seed=N] FILE|FOLDER...
 *
 * An input is a file of the corpus with one to sixteen changes (bits, bytes, numbers of two and
 * four bytes that hurt, a stretch cut out, doubled or taken from another file, the end cut off), as
 * libFuzzer's own mutators do without its coverage. Each run has memory of exactly the input's
 * size, so that a sanitizer guards its end. The same seed gives the same inputs on every machine;
 * the file in which a crash left its input is told. Exit 0: nothing was found; 64: no input. */
#include <dirent.h>
#include <fcntl.h>
#include <signal.h>
#include <stdbool.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"
#include "tests/device/dice.h"
#include "tests/fuzz/hold.h"

enum { MOST_FILES = 8192, MOST_BYTES = 1 << 16, MOST_INPUT = 8192, MOST_CHANGES = 16 };

struct corpus {
    size_t count;
    struct {
        uint8_t *bytes;
        size_t size;
    } at[MOST_FILES];
};

/* What runs now, for the handler of SIGABRT, which the sanitizers raise as well. */
static const uint8_t *volatile now_bytes;
static volatile size_t now_size;

static void keep_input(int number)
{
    static const char told[] = "its input is in ./crash\n";
    const int fd = open("crash", O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644); /* door */

    (void)!write(fd, now_bytes, now_size);
    (void)!write(2, told, sizeof told - 1);
    (void)signal(number, SIG_DFL);
    (void)raise(number);
}

static void run_once(const uint8_t *bytes, size_t size)
{
    uint8_t *const exact = gsn_alloc(size ? size : 1);

    HOLD(exact != NULL);
    if (size > 0)
        memcpy(exact, bytes, size);
    now_bytes = exact;
    now_size = size;
    (void)LLVMFuzzerTestOneInput(exact, size);
    gsn_free(exact);
}

static void add_file(struct corpus *corpus, const char *path)
{
    struct gsn_error err = { 0 };

    HOLD(corpus->count < MOST_FILES);
    if (gsn_file_read(path, MOST_BYTES, &corpus->at[corpus->count].bytes,
                      &corpus->at[corpus->count].size, &err) < 0) {
        (void)fprintf(stderr, "%s\n", err.text);
        exit(66); /* door */
    }
    corpus->count++;
}

static void add_path(struct corpus *corpus, const char *path)
{
    DIR *const dir = opendir(path);
    const struct dirent *entry;

    if (!dir) {
        add_file(corpus, path);
        return;
    }
    while ((entry = readdir(dir))) {
        gsn_auto_mem(char) inner = gsn_format("%s/%s", path, entry->d_name);

        HOLD(inner != NULL);
        if (entry->d_name[0] != '.')
            add_file(corpus, inner);
    }
    (void)closedir(dir);
}

struct input {
    size_t size;
    uint8_t bytes[MOST_INPUT];
};

static void write_number(struct input *input, struct dice *dice)
{
    static const uint32_t hurt[] = { 0,       1,      2,          0x7f,       0x80,      0xff,
                                     0x100,   0x7fff, 0x8000,     0xffff,     0x10000,   0x7fffffff,
                                     1 << 30, 12,     0x80000000, 0xffffffff, 0xfffffff0 };
    const uint32_t number = below(dice, 2) ? hurt[below(dice, sizeof hurt / sizeof hurt[0])]
                                           : (uint32_t)input->size + below(dice, 5) - 2;
    const size_t width = below(dice, 2) ? 4 : 2;
    const bool little = below(dice, 2) != 0;
    size_t at;

    if (input->size < width)
        return;
    at = roll(dice) % (input->size - width + 1);
    for (size_t i = 0; i < width; i++)
        input->bytes[at + i] = (uint8_t)(number >> 8 * (little ? i : width - 1 - i));
}

/* Puts a stretch of another file in at some place, over what is there or before it. */
static void splice_in(struct input *input, const struct corpus *corpus, struct dice *dice)
{
    const size_t which = roll(dice) % corpus->count;
    const size_t from = corpus->at[which].size ? roll(dice) % corpus->at[which].size : 0;
    size_t length = corpus->at[which].size - from;
    const size_t at = input->size ? roll(dice) % input->size : 0;

    length = length > 0 ? 1 + roll(dice) % length : 0;
    if (below(dice, 2) && input->size + length <= MOST_INPUT) {
        memmove(input->bytes + at + length, input->bytes + at, input->size - at);
        input->size += length;
    }
    length = length > input->size - at ? input->size - at : length;
    memcpy(input->bytes + at, corpus->at[which].bytes + from, length);
}

static void cut_out(struct input *input, struct dice *dice)
{
    const size_t at = roll(dice) % input->size;
    const size_t length = 1 + roll(dice) % (input->size - at);

    memmove(input->bytes + at, input->bytes + at + length, input->size - at - length);
    input->size -= length;
}

static void change(struct input *input, const struct corpus *corpus, struct dice *dice)
{
    const unsigned how = input->size ? below(dice, 8) : 7;

    switch (how) {
    case 0:
    case 1:
        input->bytes[roll(dice) % input->size] ^= (uint8_t)(1u << below(dice, 8));
        break;
    case 2:
    case 3:
        input->bytes[roll(dice) % input->size] = (uint8_t)roll(dice);
        break;
    case 4:
        write_number(input, dice);
        break;
    case 5:
        cut_out(input, dice);
        break;
    case 6:
        input->size = roll(dice) % (input->size + 1);
        break;
    default:
        splice_in(input, corpus, dice);
        break;
    }
}

static void make_input(struct input *input, const struct corpus *corpus, struct dice *dice)
{
    const size_t which = roll(dice) % corpus->count;
    const size_t size = corpus->at[which].size;

    input->size = size < MOST_INPUT ? size : MOST_INPUT;
    memcpy(input->bytes, corpus->at[which].bytes, input->size);
    for (unsigned n = 1 + below(dice, MOST_CHANGES); n > 0; n--)
        change(input, corpus, dice);
}

int main(int argc, char **argv)
{
    static struct corpus corpus;
    static struct input input;
    unsigned long long runs = 0, seed = 1;

    (void)signal(SIGABRT, keep_input);
    for (int i = 1; i < argc; i++)
        if (sscanf(argv[i], "-runs=%llu", &runs) != 1 && sscanf(argv[i], "-seed=%llu", &seed) != 1)
            add_path(&corpus, argv[i]);
    if (corpus.count == 0) {
        (void)fprintf(stderr, "usage: %s [-runs=N] [-seed=N] FILE|FOLDER...\n", argv[0]);
        return 64;
    }
    for (size_t i = 0; i < corpus.count; i++)
        run_once(corpus.at[i].bytes, corpus.at[i].size);
    for (unsigned long long i = 0; i < runs; i++) {
        /* From the run's number, so that any of them can be made again alone. */
        struct dice dice = { seed * 1000003 + i };

        make_input(&input, &corpus, &dice);
        run_once(input.bytes, input.size);
    }
    (void)printf("%zu files of the corpus and %llu inputs made of them: nothing found\n",
                 corpus.count, runs);
    for (size_t i = 0; i < corpus.count; i++)
        gsn_free(corpus.at[i].bytes);
    return 0;
}
