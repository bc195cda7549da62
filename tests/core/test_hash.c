/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/hash.h"

#include "tests/check.h"

#include <string.h>

/* The examples of FIPS 180-4 (NIST, "SHA-256 examples") and of FIPS 180-2, appendix B. */
static const struct {
    const char *message, *digest;
} examples[] = {
    { "", "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855" },
    { "abc", "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad" },
    { "abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq",
      "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1" },
};
static const char MILLION[] = "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0";

enum { MILLION_BYTES = 1000000 };

static char *million_a(void)
{
    char *bytes = gsn_alloc(MILLION_BYTES);

    CHECK(bytes != NULL);
    memset(bytes, 'a', MILLION_BYTES);
    return bytes;
}

TEST(the_published_messages_have_their_published_digests)
{
    gsn_auto_mem(char) million = million_a();
    struct gsn_digest digest;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < sizeof examples / sizeof examples[0]; i++) {
        const char *message = examples[i].message;

        CHECK_OK(gsn_sha256(message, strlen(message), &digest, &err), err);
        assert_string_equal(digest.hex, examples[i].digest);
    }
    CHECK_OK(gsn_sha256(million, MILLION_BYTES, &digest, &err), err);
    assert_string_equal(digest.hex, MILLION);
    CHECK_OK(gsn_sha256(NULL, 0, &digest, &err), err);
    assert_string_equal(digest.hex, examples[0].digest);
}

static void check_in_pieces(const char *bytes, size_t size, size_t piece, const char *expected)
{
    gsn_auto(gsn_hash) hash = NULL;
    struct gsn_digest digest;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_hash_new(&hash, &err), err);
    for (size_t at = 0; at < size; at += piece)
        CHECK_OK(gsn_hash_add(hash, bytes + at, size - at < piece ? size - at : piece, &err), err);
    CHECK_OK(gsn_hash_end(hash, &digest, &err), err);
    assert_string_equal(digest.hex, expected);
}

TEST(pieces_hash_to_the_same_as_the_whole)
{
    /* A block is 64 bytes: pieces shorter, equal, longer and not dividing it. */
    static const size_t pieces[] = { 63, 64, 65, 1000, 65536, MILLION_BYTES };
    gsn_auto_mem(char) million = million_a();

    for (size_t i = 0; i < sizeof pieces / sizeof pieces[0]; i++)
        check_in_pieces(million, MILLION_BYTES, pieces[i], MILLION);
    for (size_t i = 0; i < sizeof examples / sizeof examples[0]; i++)
        for (size_t piece = 1; piece <= 60; piece++)
            check_in_pieces(examples[i].message, strlen(examples[i].message), piece,
                            examples[i].digest);
}

TEST(adding_nothing_changes_nothing)
{
    gsn_auto(gsn_hash) hash = NULL;
    struct gsn_digest digest;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_hash_new(&hash, &err), err);
    CHECK_OK(gsn_hash_add(hash, NULL, 0, &err), err);
    CHECK_OK(gsn_hash_add(hash, "ab", 2, &err), err);
    CHECK_OK(gsn_hash_add(hash, "", 0, &err), err);
    CHECK_OK(gsn_hash_add(hash, "c", 1, &err), err);
    CHECK_OK(gsn_hash_end(hash, &digest, &err), err);
    assert_string_equal(digest.hex, examples[1].digest);
}

TEST(a_hash_used_again_has_forgotten_what_it_was_given)
{
    gsn_auto(gsn_hash) hash = NULL;
    struct gsn_digest digest;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_hash_new(&hash, &err), err);
    CHECK_OK(gsn_hash_add(hash, "left behind", 11, &err), err);
    CHECK_OK(gsn_hash_again(hash, &err), err);
    for (int i = 0; i < 2; i++) {
        CHECK_OK(gsn_hash_add(hash, "abc", 3, &err), err);
        CHECK_OK(gsn_hash_end(hash, &digest, &err), err);
        assert_string_equal(digest.hex, examples[1].digest);
        CHECK_OK(gsn_hash_again(hash, &err), err); /* after the end, too */
    }
}

TEST(two_hashes_at_once_do_not_mix)
{
    gsn_auto(gsn_hash) one = NULL;
    gsn_auto(gsn_hash) two = NULL;
    struct gsn_digest digest;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_hash_new(&one, &err), err);
    CHECK_OK(gsn_hash_new(&two, &err), err);
    CHECK_OK(gsn_hash_add(one, "a", 1, &err), err);
    CHECK_OK(gsn_hash_add(two, "zzz", 3, &err), err);
    CHECK_OK(gsn_hash_add(one, "bc", 2, &err), err);
    CHECK_OK(gsn_hash_end(one, &digest, &err), err);
    assert_string_equal(digest.hex, examples[1].digest);
}

TEST(one_bit_changes_the_digest)
{
    struct gsn_digest was, is;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_sha256("abc", 3, &was, &err), err);
    CHECK_OK(gsn_sha256("abb", 3, &is, &err), err);
    CHECK(strcmp(was.hex, is.hex) != 0);
}

TEST(a_look_at_the_digest_so_far_changes_nothing)
{
    gsn_auto(gsn_hash) hash = NULL;
    struct gsn_digest so_far, whole, expected;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_hash_new(&hash, &err), err);
    for (size_t i = 0; i <= 3; i++) {
        CHECK_OK(gsn_hash_peek(hash, &so_far, &err), err);
        CHECK_OK(gsn_sha256("abc", i, &expected, &err), err);
        assert_string_equal(so_far.hex, expected.hex);
        if (i < 3)
            CHECK_OK(gsn_hash_add(hash, &"abc"[i], 1, &err), err);
    }
    CHECK_OK(gsn_hash_end(hash, &whole, &err), err);
    assert_string_equal(whole.hex, examples[1].digest);
}

static int hash_once(struct gsn_digest *digest, struct gsn_error *err)
{
    return gsn_sha256("abc", 3, digest, err);
}

TEST(running_out_of_memory_leaks_nothing_and_leaves_the_output)
{
    struct gsn_digest digest = { .hex = "untouched" };
    struct gsn_error err = { 0 };

    gsn_check_fail_allocation(1);
    CHECK(hash_once(&digest, &err) == GSN_E_NOMEM);
    gsn_check_fail_allocation(0);
    assert_string_equal(digest.hex, "untouched");
    assert_string_equal(err.text, "out of memory for a hash");
    CHECK_EVERY_OOM(hash_once(&digest, &err), err);
    assert_string_equal(digest.hex, examples[1].digest);
}

TEST(freeing_nothing_is_fine)
{
    gsn_hash_free(NULL);
}
