/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/mem.h"

#include "tests/check.h"

#include <string.h>

/* Compilers see through constants and warn about what the tests mean to ask. */
static volatile size_t huge = SIZE_MAX;

struct thing {
    int *freed; /* counts */
};

static void thing_free(struct thing *thing)
{
    if (!thing)
        return;
    (*thing->freed)++;
    gsn_free(thing);
}
GSN_DEFINE_AUTO(thing);

static struct thing *thing_new(int *freed)
{
    struct thing *thing = gsn_alloc_array(1, sizeof *thing);

    CHECK(thing != NULL);
    thing->freed = freed;
    return thing;
}

TEST(nothing_is_asked_for_and_something_is_given)
{
    gsn_auto_mem(char) none = gsn_alloc(0);
    gsn_auto_mem(char) no_items = gsn_alloc_array(0, 8);
    gsn_auto_mem(char) empty_items = gsn_alloc_array(8, 0);
    gsn_auto_mem(char) copy = gsn_memdup(NULL, 0);

    CHECK(none != NULL && no_items != NULL && empty_items != NULL && copy != NULL);
}

TEST(arrays_begin_as_zeros)
{
    for (size_t count = 1; count < 4000; count = 3 * count + 1) {
        gsn_auto_mem(unsigned char) dirty = gsn_alloc(7 * count);
        gsn_auto_mem(unsigned char) bytes = NULL;

        CHECK(dirty != NULL);
        memset(dirty, 0xFF, 7 * count);
        gsn_free(gsn_steal(&dirty)); /* so that the next memory is used memory */
        bytes = gsn_alloc_array(count, 7);
        CHECK(bytes != NULL);
        for (size_t i = 0; i < 7 * count; i++)
            CHECK(bytes[i] == 0);
    }
}

TEST(large_arrays_begin_as_zeros_in_memory_that_was_used)
{
    const size_t size = (size_t)5 << 20;

    for (int round = 0; round < 3; round++) {
        gsn_auto_mem(unsigned char) bytes = gsn_alloc_array(size, 1);

        CHECK(bytes != NULL);
        for (size_t i = 0; i < size; i++)
            CHECK(bytes[i] == 0);
        memset(bytes, 0xFF, size);
    }
}

TEST(a_size_that_overflows_gives_null_and_asks_the_system_for_nothing)
{
    static const size_t sizes[] = { 2, 3, 4, 8, 24, 4096 };

    gsn_check_fail_allocation(0);
    CHECK(gsn_alloc_array(huge, huge) == NULL);
    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
        CHECK(gsn_alloc_array(huge / sizes[i] + 1, sizes[i]) == NULL);
        CHECK(gsn_alloc_array(sizes[i], huge / sizes[i] + 1) == NULL);
        CHECK(gsn_realloc_array(NULL, huge / sizes[i] + 1, sizes[i]) == NULL);
    }
    CHECK(gsn_check_allocations() == 0);
}

TEST(a_refused_resize_leaves_the_old_items)
{
    gsn_auto_mem(int) items = gsn_alloc_array(3, sizeof *items);

    CHECK(items != NULL);
    items[2] = 42;
    CHECK(gsn_realloc_array(items, huge / 2, sizeof *items) == NULL);
    CHECK(items[2] == 42);
    gsn_check_fail_allocation(1);
    CHECK(gsn_realloc_array(items, 100, sizeof *items) == NULL);
    gsn_check_fail_allocation(0);
    CHECK(items[2] == 42);
}

TEST(resizing_keeps_what_fits)
{
    gsn_auto_mem(int) items = gsn_realloc_array(NULL, 4, sizeof *items);
    int *more;

    CHECK(items != NULL);
    for (int i = 0; i < 4; i++)
        items[i] = i * i;
    more = gsn_realloc_array(items, 4000, sizeof *items);
    CHECK(more != NULL);
    items = more;
    CHECK(items[0] == 0 && items[1] == 1 && items[2] == 4 && items[3] == 9);
    more = gsn_realloc_array(items, 2, sizeof *items);
    CHECK(more != NULL);
    items = more;
    CHECK(items[0] == 0 && items[1] == 1);
    more = gsn_realloc_array(items, 0, sizeof *items); /* realloc(p, 0) would free */
    CHECK(more != NULL);
    items = more;
}

TEST(copies_are_equal_and_apart)
{
    char text[] = "char absorbs red light";
    gsn_auto_mem(char) copy = gsn_strdup(text);
    gsn_auto_mem(char) empty = gsn_strdup("");
    gsn_auto_mem(char) bytes = gsn_memdup("a\0b", 3);

    CHECK(copy != NULL && empty != NULL && bytes != NULL);
    text[0] = 'C';
    assert_string_equal(copy, "char absorbs red light");
    assert_string_equal(empty, "");
    assert_memory_equal(bytes, "a\0b", 3);
}

TEST(formatted_text_is_as_long_as_it_must_be)
{
    gsn_auto_mem(char) empty = gsn_format("%s", "");
    gsn_auto_mem(char) text = gsn_format("%s-P%02d.%s", "GVP-D-S02", 3, "tif");
    gsn_auto_mem(char) wide = gsn_format("%5000d", 7);

    CHECK(empty != NULL && text != NULL && wide != NULL);
    assert_string_equal(empty, "");
    assert_string_equal(text, "GVP-D-S02-P03.tif");
    CHECK(strlen(wide) == 5000 && wide[4999] == '7' && wide[0] == ' ');
}

TEST(an_owner_frees_at_the_end_of_its_scope_and_not_before)
{
    int freed = 0;

    {
        gsn_auto(thing) owned = thing_new(&freed);

        CHECK(owned != NULL && freed == 0);
    }
    CHECK(freed == 1);
    {
        gsn_auto(thing) nobody = NULL;

        CHECK(nobody == NULL);
    }
    CHECK(freed == 1);
}

TEST(what_is_stolen_belongs_to_the_thief)
{
    int freed = 0;
    struct thing *taken;

    {
        gsn_auto(thing) owned = thing_new(&freed);

        taken = gsn_steal(&owned);
        CHECK(owned == NULL);
    }
    CHECK(freed == 0);
    thing_free(taken);
    CHECK(freed == 1);
}

TEST(when_memory_runs_out_each_gives_null)
{
    static const char word[] = "word";

    for (int which = 0; which < 6; which++) {
        void *given = NULL;

        gsn_check_fail_allocation(1);
        switch (which) {
        case 0:
            given = gsn_alloc(10);
            break;
        case 1:
            given = gsn_alloc_array(2, 5);
            break;
        case 2:
            given = gsn_realloc_array(NULL, 2, 5);
            break;
        case 3:
            given = gsn_strdup(word);
            break;
        case 4:
            given = gsn_memdup(word, sizeof word);
            break;
        default:
            given = gsn_format("%s", word);
        }
        CHECK(gsn_check_allocations() == 1);
        gsn_check_fail_allocation(0);
        CHECK(given == NULL);
    }
}

TEST(freeing_nothing_is_fine)
{
    gsn_free(NULL);
}

/* Asks five times in one place, then once in another. */
static int ask_six_times(unsigned *runs, struct gsn_error *err)
{
    int r = GSN_OK;

    ++*runs;
    for (int i = 0; r >= 0 && i < 6; i++) {
        void *const memory = i < 5 ? gsn_alloc(8) : gsn_strdup("another");

        r = memory ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory");
        gsn_free(memory);
    }
    return r;
}

TEST(a_sweep_fails_each_chain_of_calls_three_times_and_then_passes)
{
    struct gsn_error err = { 0 };

    for (int again = 0; again < 2; again++) {
        unsigned runs = 0;

        CHECK_EVERY_OOM(ask_six_times(&runs, &err), err);
        CHECK(runs == 3 + 1 + 1);
    }
}
