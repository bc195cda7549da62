/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/decode/apart.h"

#include "pipeline/core/file.h"
#include "pipeline/core/parallel.h"
#include "tests/check.h"
#include "tests/decode/awkward_files.h"
#include "tests/decode/make.h"
#include "tests/memory_file.h"

#include <string.h>
#include <unistd.h>

#define FOLDER GSN_SHARED "/data/images/"

static struct gsn_picture *decode(struct gsn_decoder *decoder, const struct made *file,
                                  int *ret_code, struct gsn_error *err)
{
    struct gsn_picture *picture = NULL;

    *err = (struct gsn_error){ 0 };
    *ret_code =
        gsn_decode_apart(decoder, gsn_check_fd(file->bytes, file->size), NULL, &picture, err);
    return picture;
}

static struct gsn_decoder *new_decoder(const char *program)
{
    struct gsn_decoder *decoder = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_decoder_new(program, &decoder, &err), err);
    return decoder;
}

static int same_text_and_numbers(const struct gsn_picture *a, const struct gsn_picture *b)
{
    return a->pages == b->pages && a->lossy == b->lossy && a->transfer == b->transfer &&
           memcmp(&a->px_um_x, &b->px_um_x, sizeof a->px_um_x) == 0 &&
           memcmp(&a->px_um_y, &b->px_um_y, sizeof a->px_um_y) == 0 &&
           strcmp(a->kind, b->kind) == 0 && strcmp(a->note, b->note) == 0 &&
           strcmp(a->withheld, b->withheld) == 0;
}

/* The same answer in and out of the sandbox: code, sentence, samples and what is known of them. */
static int is_same_apart(struct gsn_decoder *decoder, const struct made *file)
{
    struct gsn_error here_said, apart_said;
    int here_code, apart_code;
    gsn_auto(gsn_picture) here = decode(NULL, file, &here_code, &here_said);
    gsn_auto(gsn_picture) apart = decode(decoder, file, &apart_code, &apart_said);

    if (here_code != apart_code || strcmp(here_said.text, apart_said.text) != 0) {
        print_error("here %d \"%s\", apart %d \"%s\"\n", here_code, here_said.text, apart_code,
                    apart_said.text);
        return 0;
    }
    return here_code < 0 ||
           (same_picture(here->image, apart->image) && same_text_and_numbers(here, apart));
}

TEST(every_awkward_file_gets_the_same_answer_in_the_sandbox)
{
    size_t wrong = 0;

    if (access(FOLDER, R_OK) != 0) {
        gsn_check_skip("%s is not there", FOLDER);
    }
    gsn_auto(gsn_decoder) decoder = new_decoder(GSN_DECODER);
    for (size_t i = 0; i < sizeof awkward_files / sizeof awkward_files[0]; i++) {
        gsn_auto_mem(char) path = gsn_format(FOLDER "%s", awkward_files[i].file);
        auto_made file = { 0 };
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_file_read(path, 16 << 20, &file.bytes, &file.size, &err), err);
        if (is_same_apart(decoder, &file))
            continue;
        print_error("%s differs\n", awkward_files[i].file);
        wrong++;
    }
    CHECK(wrong == 0);
}

TEST(made_pictures_of_every_kind_come_back_whole)
{
    static const uint32_t channels[] = { 1, 3, 1, 3 }, bits[] = { 8, 8, 16, 16 };
    gsn_auto(gsn_decoder) decoder = new_decoder(GSN_DECODER);

    for (size_t i = 0; i < 4; i++) {
        gsn_auto(gsn_image) image = make_picture(611, 403, channels[i], bits[i]);
        const struct tiff_recipe turned = { .orientation = 6, .unit = 2, .dots = 600 };
        auto_made tiff = make_tiff(image, &turned);
        auto_made png = make_png(image, &(struct png_recipe){ .per_metre = 1000 });
        auto_made nothing = { 0 };

        CHECK(is_same_apart(decoder, &tiff) && is_same_apart(decoder, &png) &&
              is_same_apart(decoder, &nothing));
    }
}

/* Else a camera that was not locked would be measured after all. */
TEST(why_a_picture_must_not_be_measured_comes_out_of_the_sandbox)
{
    static char frame[] =
        "P7\n# gieson frame 1\n# not to be measured: gain is not locked\nWIDTH 2\n"
        "HEIGHT 1\nDEPTH 3\nMAXVAL 255\nTUPLTYPE RGB\nENDHDR\nabcdef";
    const struct made file = { (uint8_t *)frame, sizeof frame - 1 };
    struct gsn_error err;
    int r;
    gsn_auto(gsn_decoder) decoder = new_decoder(GSN_DECODER);
    gsn_auto(gsn_picture) picture = decode(decoder, &file, &r, &err);

    CHECK_OK(r, err);
    CHECK(strcmp(picture->withheld, "gain is not locked") == 0);
    CHECK(is_same_apart(decoder, &file));
}

/* Samples are the caller's own: writing to one picture changes no other, and the next picture comes
 * whole where that one was. */
TEST(pictures_are_the_callers_own_as_long_as_it_has_them)
{
    gsn_auto(gsn_image) image = make_picture(100, 80, 3, 8);
    auto_made png = make_png(image, &(struct png_recipe){ 0 });
    struct gsn_error err;
    int r;
    gsn_auto(gsn_decoder) decoder = new_decoder(GSN_DECODER);
    struct gsn_picture *first = decode(decoder, &png, &r, &err);
    gsn_auto(gsn_picture) second = decode(decoder, &png, &r, &err);
    const void *place = first->image->samples;

    CHECK(first && second && same_picture(first->image, image));
    memset(first->image->samples, 7, gsn_image_bytes(first->image));
    CHECK(same_picture(second->image, image));
    gsn_picture_free(first);
    first = decode(decoder, &png, &r, &err);
    CHECK(first->image->samples == place && same_picture(first->image, image));
    gsn_picture_free(first);
}

static int ask_misbehaving(const char *word, const struct gsn_decode_limits *limits,
                           struct gsn_error *err)
{
    gsn_auto(gsn_decoder) decoder = new_decoder(GSN_MISBEHAVING);
    struct gsn_picture mark, *picture = &mark;
    const int r =
        gsn_decode_apart(decoder, gsn_check_fd(word, strlen(word) + 1), limits, &picture, err);

    if (r >= 0)
        gsn_picture_free(picture);
    else
        CHECK(picture == &mark);
    return r;
}

static size_t count_wrong(const char *const words[], size_t count, int code, const char *sentence)
{
    size_t wrong = 0;

    for (size_t i = 0; i < count; i++) {
        struct gsn_error err = { 0 };
        const int r = ask_misbehaving(words[i], NULL, &err);

        if (r == code && strncmp(err.text, sentence, strlen(sentence)) == 0)
            continue;
        print_error("%s: %d \"%s\"\n", words[i], r, err.text);
        wrong++;
    }
    return wrong;
}

#define COUNT(array) (sizeof(array) / sizeof(array)[0])

TEST(a_decoder_that_reaches_for_the_machine_is_stopped_and_the_file_refused)
{
    static const char *const reaching[] = { "connect", "fork", "start" };
    static const char *const opening[] = { "open" };

    CHECK(count_wrong(reaching, COUNT(reaching), GSN_E_INPUT,
                      "the decoder was stopped when this file made it do what no picture needs: do "
                      "not trust the file, scan again") == 0);
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
    CHECK(count_wrong(opening, COUNT(opening), GSN_E_PROCESS,
                      GSN_MISBEHAVING " ended with code 7") == 0);
#else
    CHECK(count_wrong(opening, COUNT(opening), GSN_E_INPUT, "the decoder was stopped when") == 0);
#endif
}

TEST(a_decoder_that_crashes_costs_the_file)
{
    static const char *const crashing[] = { "crash" };

    CHECK(count_wrong(crashing, COUNT(crashing), GSN_E_INPUT,
                      "the decoder crashed on this file (Aborted): scan again, or export the "
                      "picture anew") == 0);
}

TEST(a_decoder_that_hangs_is_stopped_in_time)
{
    const struct gsn_decode_limits limits = { .seconds = 1 };
    struct gsn_error err = { 0 };

    CHECK(ask_misbehaving("hang", &limits, &err) == GSN_E_LIMIT);
    assert_string_equal(err.text, "decoding did not end within 1 s and was stopped: scan again, or "
                                  "export the picture anew");
}

/* A sanitizer's build cannot limit address space: there memory is the machine's. */
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
TEST(a_decoder_that_eats_memory_reaches_its_limit)
{
    const struct gsn_decode_limits limits = { .most_bytes = 1 << 20 };
    struct gsn_error err = { 0 };

    CHECK(ask_misbehaving("eat", &limits, &err) == GSN_E_LIMIT);
    assert_string_equal(err.text, "decoding needs more than 257 MiB of memory: scan at a lower "
                                  "resolution");
}
#endif

TEST(a_decoder_that_lies_is_not_believed)
{
    static const char *const lies[] = { "nothing",  "size",  "bits", "channels",
                                        "transfer", "pitch", "code" };

    CHECK(count_wrong(lies, COUNT(lies), GSN_E_INPUT,
                      "the decoder gave an answer that cannot be: do not trust the file, scan "
                      "again") == 0);
}

TEST(what_a_decoder_says_is_one_clean_line)
{
    gsn_auto(gsn_decoder) decoder = new_decoder(GSN_MISBEHAVING);
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_decode_apart(decoder, gsn_check_fd("fair", 5), NULL, &picture, &err), err);
    CHECK(strlen(picture->kind) == sizeof picture->kind - 1);
    CHECK(strlen(picture->note) == sizeof picture->note - 1 && !strchr(picture->note, '\n'));
    CHECK(ask_misbehaving("loud", NULL, &err) == GSN_E_INPUT);
    CHECK(strlen(err.text) == sizeof err.text - 1 && !strchr(err.text, '\33'));
}

TEST(a_decoder_that_talks_is_not_listened_to)
{
    struct gsn_error err = { 0 };

    CHECK(ask_misbehaving("babble", NULL, &err) == GSN_E_INPUT);
}

TEST(a_decoder_that_is_not_there_is_no_fault_of_the_file)
{
    gsn_auto(gsn_decoder) decoder = new_decoder("/nowhere/gieson-decode");
    struct gsn_picture *picture = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_decode_apart(decoder, gsn_check_fd("x", 1), NULL, &picture, &err) == GSN_E_PROCESS);
    CHECK(strstr(err.text, "/nowhere/gieson-decode") == err.text && !picture);
}

/* Whoever died for one file does not stand in the way of the next; nor does one that a signal took
 * while nobody asked. */
TEST(a_file_that_kills_its_decoder_costs_only_itself)
{
    static const char *const words[] = { "fair", "crash",   "fair", "connect",
                                         "fair", "nothing", "fair", "fair" };
    static const int codes[] = { GSN_OK, GSN_E_INPUT, GSN_OK, GSN_E_INPUT,
                                 GSN_OK, GSN_E_INPUT, GSN_OK, GSN_OK };
    gsn_auto(gsn_decoder) decoder = new_decoder(GSN_MISBEHAVING);

    for (size_t i = 0; i < COUNT(words); i++) {
        gsn_auto(gsn_picture) picture = NULL;
        struct gsn_error err = { 0 };

        assert_int_equal(gsn_decode_apart(decoder, gsn_check_fd(words[i], strlen(words[i]) + 1),
                                          NULL, &picture, &err),
                         codes[i]);
    }
}

TEST(a_decoder_that_died_while_nobody_asked_is_started_again)
{
    gsn_auto(gsn_decoder) decoder = new_decoder(GSN_MISBEHAVING);

    for (int i = 0; i < 3; i++) {
        gsn_auto(gsn_picture) picture = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_decode_apart(decoder, gsn_check_fd("leave", 6), NULL, &picture, &err), err);
    }
}

struct crowd {
    struct gsn_decoder *decoder;
    const struct gsn_image *image;
    struct made png;
};

/* As `gieson register` asks: from several threads, which end between one folder and the next. */
static int decode_next(size_t i, void *context, struct gsn_error *err)
{
    struct crowd *crowd = context;
    gsn_auto_fd fd = -1;
    gsn_auto(gsn_picture) picture = NULL;
    int r = gsn_memory_file(crowd->png.bytes, crowd->png.size, &fd, err);

    (void)i;
    if (r >= 0)
        r = gsn_decode_apart(crowd->decoder, fd, NULL, &picture, err);
    if (r >= 0 && !same_picture(picture->image, crowd->image))
        return gsn_fail(err, GSN_E_INPUT, "another picture");
    return r;
}

TEST(several_threads_may_ask_and_end)
{
    gsn_auto(gsn_image) image = make_picture(211, 97, 3, 8);
    auto_made png = make_png(image, &(struct png_recipe){ 0 });
    gsn_auto(gsn_decoder) decoder = new_decoder(GSN_DECODER);
    struct crowd crowd = { decoder, image, png };
    struct gsn_error err = { 0 };

    for (int round = 0; round < 3; round++)
        CHECK_OK(gsn_parallel_for(24, 4, decode_next, &crowd, &err), err);
    gsn_decoder_rest(decoder);
    CHECK_OK(gsn_parallel_for(4, 2, decode_next, &crowd, &err), err);
}

static int decode_png(const struct made *png, struct gsn_error *err)
{
    gsn_auto(gsn_decoder) decoder = NULL;
    gsn_auto(gsn_picture) picture = NULL;
    int r = gsn_decoder_new(GSN_DECODER, &decoder, err);

    if (r >= 0)
        r = gsn_decode_apart(decoder, gsn_check_fd(png->bytes, png->size), NULL, &picture, err);
    return r;
}

TEST(running_out_of_memory_is_an_error)
{
    gsn_auto(gsn_image) image = make_picture(40, 30, 3, 8);
    auto_made png = make_png(image, &(struct png_recipe){ 0 });
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(decode_png(&png, &err), err);
}
