/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/folder_source.h"

#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "acquire/source.h"
#include "acquire/spool.h"
#include "pipeline/core/file.h"
#include "tests/check.h"
#include "tests/storage/scratch.h"

/* The smallest containers: SOI and EOI around nothing; a PNG with its end alone. */
static const char whole[] = "\xff\xd8\xff\xd9";
static const char half[] = "\xff\xd8\xff\xda\x00\x03s...";
static const char png[] = "\x89PNG\r\n\x1a\n\0\0\0\0IEND\xae\x42\x60\x82";

enum { SETTLE = 1000, PATIENCE = 60000, MOST_TOLD = 4096, NOBODY = 65534 };

static const struct gsn_source_options options = { .settle_ms = SETTLE, .patience_ms = PATIENCE };

static void write_file(const struct gsn_scratch *scratch, const char *name, const char *bytes,
                       size_t size)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_file_write(gsn_scratch_path(scratch, name), bytes, size, &err), err);
}

static struct gsn_source *open_source(const struct gsn_scratch *scratch, const char *kind)
{
    struct gsn_source *source = NULL;
    struct gsn_error err = { 0 };
    char address[200];

    (void)snprintf(address, sizeof address, "%s:%s", kind, scratch->dir);
    CHECK_OK(gsn_source_open(address, &options, &source, &err), err);
    CHECK(strcmp(gsn_source_address(source), address) == 0);
    return source;
}

static int last_ended;

static struct gsn_source_events *poll(struct gsn_source *source, int64_t now)
{
    struct gsn_source_events *events = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_source_poll(source, now, &events, &last_ended, &err), err);
    return events;
}

/* What a poll tells, as text: "READY a.jpg; WAITING b.jpg; ". */
static const char *told(struct gsn_source *source, int64_t now)
{
    static const char *const words[] = { "READY", "WAITING", "GONE", "NOTICE", "BARRED" };
    static char text[2][MOST_TOLD];
    static unsigned turn;
    char *const to = text[turn++ % 2];
    gsn_auto(gsn_source_events) events = poll(source, now);
    size_t used = 0;

    to[0] = '\0';
    for (size_t i = 0; i < events->count && used < MOST_TOLD; i++)
        used +=
            (size_t)snprintf(to + used, MOST_TOLD - used, "%s%s %s; ", words[events->at[i].what],
                             events->at[i].incomplete ? "?" : "", events->at[i].name);
    return to;
}

static void tells(struct gsn_source *source, int64_t now, const char *expected)
{
    const char *const got = told(source, now);

    if (strcmp(got, expected) != 0)
        fail_msg("at %lld was told \"%s\", not \"%s\"", (long long)now, got, expected);
}

/* Acknowledges everything that is READY now; returns how many that were. */
static size_t take_all(struct gsn_source *source, int64_t now)
{
    gsn_auto(gsn_source_events) events = poll(source, now);
    struct gsn_error err = { 0 };
    size_t count = 0;

    for (size_t i = 0; i < events->count; i++) {
        if (events->at[i].what != GSN_SOURCE_READY)
            continue;
        CHECK_OK(gsn_source_acknowledge(source, events->at[i].item, &err), err);
        count++;
    }
    return count;
}

TEST(a_file_is_ready_when_two_looks_agree)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");

    write_file(&scratch, "a.jpg", whole, 4);
    tells(source, 0, "WAITING a.jpg; ");
    tells(source, SETTLE - 1, "");
    tells(source, SETTLE, "READY a.jpg; ");
    tells(source, SETTLE + 1, "READY a.jpg; "); /* until somebody has it */
    CHECK(take_all(source, SETTLE + 2) == 1);
    tells(source, SETTLE + 3, "");
    CHECK(last_ended == 0);
    CHECK(access(gsn_scratch_path(&scratch, "a.jpg"), F_OK) == 0);
}

/* Case 65. */
TEST(a_file_that_grows_waits_until_it_is_whole)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");
    const char *const path = gsn_scratch_path(&scratch, "a.jpg");

    gsn_scratch_append(path, half, sizeof half - 1);
    tells(source, 0, "WAITING a.jpg; ");
    for (int64_t now = SETTLE; now < 5 * SETTLE; now += SETTLE) {
        gsn_scratch_append(path, "more", 4);
        tells(source, now, "");
    }
    tells(source, 6 * SETTLE, "WAITING a.jpg; "); /* stalled: another reason, told once */
    tells(source, 7 * SETTLE, "");
    gsn_scratch_append(path, "\xff\xd9", 2);
    tells(source, 8 * SETTLE, "WAITING a.jpg; ");
    tells(source, 9 * SETTLE, "READY a.jpg; ");
}

TEST(what_stays_half_is_delivered_as_such_when_patience_ends)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");

    gsn_scratch_append(gsn_scratch_path(&scratch, "a.jpg"), half, sizeof half - 1);
    tells(source, 0, "WAITING a.jpg; ");
    tells(source, SETTLE, "WAITING a.jpg; ");
    tells(source, PATIENCE - 1, "");
    {
        gsn_auto(gsn_source_events) events = poll(source, PATIENCE);

        CHECK(events->count == 1 && events->at[0].what == GSN_SOURCE_READY);
        CHECK(events->at[0].incomplete == 1 && events->at[0].size == sizeof half - 1);
        CHECK(strcmp(events->at[0].reason, "the file ends before the JPEG's EOI") == 0);
    }
    CHECK(take_all(source, PATIENCE) == 1);
    /* The copy went on after all: a new item. */
    gsn_scratch_append(gsn_scratch_path(&scratch, "a.jpg"), "\xff\xd9", 2);
    tells(source, PATIENCE + 1, "WAITING a.jpg; ");
    tells(source, PATIENCE + 1 + SETTLE, "READY a.jpg; ");
}

TEST(a_touched_file_starts_to_settle_again)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");
    const char *const path = gsn_scratch_path(&scratch, "a.jpg");
    const struct timespec times[2] = { { 1000, 0 }, { 1000, 0 } };

    write_file(&scratch, "a.jpg", whole, 4);
    tells(source, 0, "WAITING a.jpg; ");
    CHECK(utimensat(AT_FDCWD, path, times, 0) == 0); /* mtime */
    tells(source, SETTLE, "");
    CHECK(chmod(path, 0600) == 0); /* ctime alone */
    tells(source, 2 * SETTLE, "");
    tells(source, 3 * SETTLE, "READY a.jpg; ");
    CHECK(chmod(path, 0644) == 0);
    tells(source, 4 * SETTLE, "WAITING a.jpg; ");
}

TEST(a_file_changed_after_it_was_taken_is_a_new_item)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");
    uint64_t first, second;

    write_file(&scratch, "a.jpg", whole, 4);
    gsn_source_events_free(poll(source, 0));
    {
        gsn_auto(gsn_source_events) events = poll(source, SETTLE);
        first = events->at[0].item;
    }
    CHECK(take_all(source, SETTLE) == 1);
    write_file(&scratch, "a.jpg", png, sizeof png - 1);
    tells(source, 2 * SETTLE, "WAITING a.jpg; ");
    {
        gsn_auto(gsn_source_events) events = poll(source, 3 * SETTLE);
        CHECK(events->count == 1 && events->at[0].what == GSN_SOURCE_READY);
        second = events->at[0].item;
    }
    CHECK(first != second);
}

TEST(a_file_that_vanishes_is_told_once)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");

    write_file(&scratch, "a.jpg", whole, 4);
    write_file(&scratch, "b.jpg", whole, 4);
    gsn_source_events_free(poll(source, 0));
    CHECK(unlink(gsn_scratch_path(&scratch, "a.jpg")) == 0);
    tells(source, SETTLE, "GONE a.jpg; READY b.jpg; ");
    CHECK(unlink(gsn_scratch_path(&scratch, "b.jpg")) == 0);
    tells(source, SETTLE, "GONE b.jpg; ");
    tells(source, SETTLE, "");
}

TEST(names_come_in_natural_order)
{
    static const char *const names[] = { "P10.jpg", "P2.jpg", "P1.jpg", "Q.jpg", "P02.jpg" };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "replay");

    for (size_t i = 0; i < 5; i++)
        write_file(&scratch, names[i], whole, 4);
    gsn_source_events_free(poll(source, 0));
    tells(source, SETTLE,
          "READY P1.jpg; READY P02.jpg; READY P2.jpg; READY P10.jpg; READY Q.jpg; ");
}

TEST(natural_order_is_an_order)
{
    static const char *const sorted[] = { "",
                                          "0",
                                          "00",
                                          "01",
                                          "1",
                                          "1a",
                                          "01b",
                                          "2",
                                          "10",
                                          "99999999999999999999998",
                                          "99999999999999999999999",
                                          "A",
                                          "a",
                                          "a1",
                                          "a1b",
                                          "a2",
                                          "a10",
                                          "a10b2",
                                          "a10b10",
                                          "b",
                                          "\xff" };
    const size_t count = sizeof sorted / sizeof sorted[0];

    for (size_t i = 0; i < count; i++) {
        for (size_t j = 0; j < count; j++) {
            const int order = gsn_natural_compare(sorted[i], sorted[j]);

            if ((order < 0) != (i < j) || (order == 0) != (i == j))
                fail_msg("\"%s\" and \"%s\" compare as %d", sorted[i], sorted[j], order);
        }
    }
}

TEST(only_pictures_are_delivered_and_the_rest_is_named)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "replay");

    write_file(&scratch, "job.json", "{}", 2);
    write_file(&scratch, "roi.mhd", "ObjectType = Image", 18);
    write_file(&scratch, "panel", png, sizeof png - 1); /* by its bytes */
    write_file(&scratch, "text.TIF", "hello", 5);       /* by its name */
    write_file(&scratch, "empty.png", "", 0);
    write_file(&scratch, ".a.jpg.Xy12", whole, 4); /* how rsync names what it writes */
    CHECK(mkdir(gsn_scratch_path(&scratch, "folder.jpg"), 0755) == 0);
    CHECK(mkfifo(gsn_scratch_path(&scratch, "pipe.jpg"), 0644) == 0);
    CHECK(symlink("nowhere", gsn_scratch_path(&scratch, "link.jpg")) == 0);
    tells(source, 0,
          "WAITING empty.png; NOTICE folder.jpg; WAITING link.jpg; "
          "WAITING panel; NOTICE pipe.jpg; WAITING roi.mhd; WAITING text.TIF; ");
    write_file(&scratch, "folder.jpg/inside.jpg", whole, 4);
    tells(source, SETTLE,
          "WAITING empty.png; BARRED link.jpg; READY panel; NOTICE roi.mhd; WAITING text.TIF; ");
    tells(source, PATIENCE,
          "BARRED .a.jpg.Xy12; READY? empty.png; BARRED link.jpg; READY panel; READY? text.TIF; ");
    CHECK(last_ended == 0);
    CHECK(take_all(source, PATIENCE) == 3);
    tells(source, PATIENCE, "BARRED .a.jpg.Xy12; BARRED link.jpg; ");
    CHECK(last_ended == 1);
}

/* What is barred, why, and what to do: "name reason | action". */
static const char *barred(struct gsn_source *source, int64_t now)
{
    static char text[1200];
    gsn_auto(gsn_source_events) events = poll(source, now);

    text[0] = '\0';
    for (size_t i = 0; i < events->count; i++)
        if (events->at[i].what == GSN_SOURCE_BARRED)
            (void)snprintf(text, sizeof text, "%s %s | %s", events->at[i].name,
                           events->at[i].reason, events->at[i].action);
    return text;
}

/* It used to wait without end, in silence, and kept the specimen it belongs to out. */
TEST(a_file_that_may_not_be_read_is_told_with_what_to_do_until_it_may)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");
    const char *const path = gsn_scratch_path(&scratch, "P02.jpg");
    const int is_root = geteuid() == 0;
    const char *text;

    write_file(&scratch, "P02.jpg", whole, 4);
    CHECK(chmod(path, 0) == 0 && chmod(scratch.dir, 0755) == 0);
    CHECK(!is_root || seteuid(NOBODY) == 0);
    tells(source, 0, "WAITING P02.jpg; ");
    text = barred(source, SETTLE);
    CHECK(strstr(text, "P02.jpg may not be read: it is of user ") && strstr(text, "mode 0000"));
    CHECK(strstr(text, "| let it be read: chmod a+r '") && strstr(text, "/P02.jpg'"));
    tells(source, 2 * SETTLE, "BARRED P02.jpg; "); /* until it is changed */
    CHECK(!is_root || seteuid(0) == 0);
    CHECK(chmod(path, 0644) == 0);
    CHECK(!is_root || seteuid(NOBODY) == 0);
    tells(source, 3 * SETTLE, "WAITING P02.jpg; ");
    tells(source, 4 * SETTLE, "READY P02.jpg; ");
    CHECK(!is_root || seteuid(0) == 0);
}

TEST(a_link_is_barred_and_nobody_waits_for_it)
{
    scratch_auto outer = gsn_scratch_new();
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "replay");

    write_file(&outer, "secret.jpg", whole, 4);
    CHECK(symlink(gsn_scratch_path(&outer, "secret.jpg"), gsn_scratch_path(&scratch, "P01.jpg")) ==
          0);
    tells(source, 0, "WAITING P01.jpg; ");
    CHECK(strcmp(barred(source, SETTLE),
                 "P01.jpg is a link, and links in a scan folder are not followed: they could lead "
                 "to any file | put the file itself in its place") == 0);
    CHECK(last_ended == 1);
}

TEST(a_picture_that_keeps_a_hidden_name_is_told_and_other_hidden_files_are_not)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");

    write_file(&scratch, ".P03.jpg", whole, 4);
    write_file(&scratch, "._P01.tif", "\0\5\26\7", 4); /* what a Mac leaves beside a file */
    write_file(&scratch, ".DS_Store", "\0\0\0\1Bud1", 8);
    CHECK(mkdir(gsn_scratch_path(&scratch, ".Trash"), 0755) == 0);
    tells(source, 0, "");
    tells(source, PATIENCE - 1, "");
    CHECK(strcmp(barred(source, PATIENCE),
                 ".P03.jpg is a picture whose name begins with a dot, as those of unfinished "
                 "copies do | rename it without the dot when it is a panel, else remove it") == 0);
    CHECK(rename(gsn_scratch_path(&scratch, ".P03.jpg"), gsn_scratch_path(&scratch, "P03.jpg")) ==
          0);
    tells(source, PATIENCE + 2, "GONE .P03.jpg; WAITING P03.jpg; ");
}

TEST(a_download_is_not_taken_under_its_passing_name)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");

    write_file(&scratch, "P03.jpg.part", whole, 4);
    tells(source, 0, "");
    tells(source, SETTLE, "");
    CHECK(strcmp(barred(source, PATIENCE),
                 "P03.jpg.part is a picture whose name ends as those of unfinished copies do | "
                 "rename it without that when it is a panel, else remove it") == 0);
    CHECK(rename(gsn_scratch_path(&scratch, "P03.jpg.part"),
                 gsn_scratch_path(&scratch, "P03.jpg")) == 0);
    tells(source, PATIENCE + 1, "WAITING P03.jpg; GONE P03.jpg.part; ");
    tells(source, PATIENCE + 1 + SETTLE, "READY P03.jpg; ");
}

/* statfs(2) names the file systems; nfs(5) and mount.cifs(8) for how old a size may be there. */
TEST(files_of_another_machine_keep_still_for_longer)
{
    static const long nfs = 0x6969, smb2 = (long)0xfe534d42, cifs = (long)0xff534d42, ext4 = 0xef53,
                      tmpfs = 0x01021994;

    CHECK(gsn_folder_settle_on(nfs, 1000) == 6000 && gsn_folder_settle_on(smb2, 150) == 6000);
    CHECK(gsn_folder_settle_on(cifs, 1000) == 6000);
    CHECK(gsn_folder_settle_on((int32_t)0xff534d42, 1000) == 6000); /* of a 32-bit machine */
    CHECK(gsn_folder_settle_on(nfs, 9000) == 9000);
    CHECK(gsn_folder_settle_on(ext4, 1000) == 1000 && gsn_folder_settle_on(tmpfs, 150) == 150);
    CHECK(gsn_folder_settle_ms("/proc", 1000) == 1000);
    CHECK(gsn_folder_settle_ms("/nowhere", 1000) == 1000);
}

TEST(a_replay_takes_what_is_there_once_and_ends)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "replay");

    write_file(&scratch, "a.jpg", whole, 4);
    tells(source, 0, "WAITING a.jpg; ");
    CHECK(last_ended == 0);
    write_file(&scratch, "late.jpg", whole, 4);
    tells(source, SETTLE, "READY a.jpg; ");
    CHECK(last_ended == 0);
    CHECK(take_all(source, SETTLE) == 1);
    tells(source, SETTLE, "");
    CHECK(last_ended == 1);
}

TEST(an_empty_folder_ends_at_once_when_replayed_and_never_when_hot)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) replay = open_source(&scratch, "replay");
    gsn_auto(gsn_source) hot = open_source(&scratch, "hot");

    tells(replay, 0, "");
    CHECK(last_ended == 1);
    tells(hot, 0, "");
    CHECK(last_ended == 0);
}

struct ledger {
    char key[200];
};

static int is_known(void *context, const char *key)
{
    const struct ledger *const ledger = context;

    return strcmp(ledger->key, key) == 0;
}

TEST(a_file_that_was_taken_before_is_not_offered_again_unless_it_changes)
{
    scratch_auto scratch = gsn_scratch_new();
    struct ledger ledger = { "" };
    struct gsn_source_options knowing = options;
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");
    gsn_auto(gsn_source) later = NULL;
    struct gsn_error err = { 0 };
    char address[200];

    write_file(&scratch, "a.jpg", whole, sizeof whole - 1);
    tells(source, 0, "WAITING a.jpg; ");
    {
        gsn_auto(gsn_source_events) events = poll(source, SETTLE);

        CHECK(events->count == 1 && events->at[0].key[0]);
        (void)snprintf(ledger.key, sizeof ledger.key, "%s", events->at[0].key);
    }
    (void)snprintf(address, sizeof address, "hot:%s", scratch.dir);
    knowing.is_known = is_known;
    knowing.context = &ledger;
    CHECK_OK(gsn_source_open(address, &knowing, &later, &err), err);
    tells(later, 0, "");
    tells(later, SETTLE, "");
    gsn_scratch_append(gsn_scratch_path(&scratch, "a.jpg"), whole, sizeof whole - 1);
    tells(later, 2 * SETTLE, "WAITING a.jpg; ");
    tells(later, 3 * SETTLE, "READY a.jpg; ");
}

static int is_any_known(void *context, const char *key)
{
    (void)context;
    (void)key;
    return 1;
}

/* 1980 is where the clocks of cards begin. */
TEST(a_file_without_a_true_date_is_never_taken_for_one_that_was_taken)
{
    static const struct timespec begin[2] = { { .tv_sec = 315532800 }, { .tv_sec = 315532800 } };
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_source_options knowing = options;
    gsn_auto(gsn_source) source = NULL;
    gsn_auto(gsn_source_events) events = NULL;
    struct gsn_error err = { 0 };
    char address[200];

    write_file(&scratch, "a.jpg", whole, sizeof whole - 1);
    CHECK(utimensat(AT_FDCWD, gsn_scratch_path(&scratch, "a.jpg"), begin, 0) == 0);
    (void)snprintf(address, sizeof address, "hot:%s", scratch.dir);
    knowing.is_known = is_any_known;
    CHECK_OK(gsn_source_open(address, &knowing, &source, &err), err);
    tells(source, 0, "WAITING a.jpg; ");
    events = poll(source, SETTLE);
    CHECK(events->count == 1 && events->at[0].what == GSN_SOURCE_READY && !events->at[0].key[0]);
}

TEST(reading_gives_the_bytes_in_pieces)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");
    struct gsn_error err = { 0 };
    char got[64] = "";
    size_t count = 0, size = 1;
    uint64_t item;

    write_file(&scratch, "a.png", png, sizeof png - 1);
    gsn_source_events_free(poll(source, 0));
    {
        gsn_auto(gsn_source_events) events = poll(source, SETTLE);
        item = events->at[0].item;
        CHECK(events->at[0].size == sizeof png - 1 && events->at[0].incomplete == 0);
    }
    for (; size > 0; count += size)
        CHECK_OK(gsn_source_read(source, item, count, got + count, 7, &size, &err), err);
    CHECK(count == sizeof png - 1 && memcmp(got, png, count) == 0);
    size = 77;
    CHECK(gsn_source_read(source, item + 1, 0, got, 7, &size, &err) == GSN_E_NOTFOUND);
    CHECK(gsn_source_acknowledge(source, item + 1, &err) == GSN_E_NOTFOUND);
    CHECK(size == 77);
}

TEST(a_file_that_changes_under_the_reader_is_not_taken)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");
    gsn_auto(gsn_spool) spool = NULL;
    struct gsn_error err = { 0 };
    struct gsn_spooled spooled = { .size = 77 };
    struct gsn_digest expected;

    CHECK(mkdir(gsn_scratch_path(&scratch, "store"), 0755) == 0);
    CHECK_OK(gsn_spool_open(gsn_scratch_path(&scratch, "store"), 0, &spool, &err), err);
    write_file(&scratch, "a.jpg", whole, 4);
    gsn_source_events_free(poll(source, 0));
    {
        gsn_auto(gsn_source_events) events = poll(source, SETTLE);

        CHECK(events->at[0].what == GSN_SOURCE_READY);
        gsn_scratch_append(gsn_scratch_path(&scratch, "a.jpg"), "x", 1);
        CHECK(gsn_spool_take_item(spool, source, &events->at[0], &spooled, &err) == GSN_E_BUSY);
        CHECK(strcmp(err.text, "a.jpg changed while it was read") == 0 && spooled.size == 77);
        CHECK(gsn_source_acknowledge(source, events->at[0].item, &err) == GSN_E_NOTFOUND);
    }
    tells(source, 2 * SETTLE, "WAITING a.jpg; ");
    gsn_auto(gsn_source_events) events = poll(source, 3 * SETTLE);

    CHECK(events->count == 1 && events->at[0].what == GSN_SOURCE_READY);
    CHECK_OK(gsn_spool_take_item(spool, source, &events->at[0], &spooled, &err), err);
    CHECK_OK(gsn_sha256("\xff\xd8\xff\xd9x", 5, &expected, &err), err);
    CHECK(spooled.size == 5 && strcmp(spooled.digest.hex, expected.hex) == 0);
    CHECK_OK(gsn_source_acknowledge(source, events->at[0].item, &err), err);
}

TEST(a_folder_that_is_away_can_be_polled_again)
{
    scratch_auto scratch = gsn_scratch_new();
    char inner[200], away[200], address[220];
    gsn_auto(gsn_source) source = NULL;
    struct gsn_source_events *none = NULL;
    struct gsn_error err = { 0 };
    int ended = 7;

    (void)snprintf(inner, sizeof inner, "%s/in", scratch.dir);
    (void)snprintf(away, sizeof away, "%s/away", scratch.dir);
    (void)snprintf(address, sizeof address, "hot:%s", inner);
    CHECK(mkdir(inner, 0755) == 0);
    write_file(&scratch, "in/a.jpg", whole, 4);
    CHECK_OK(gsn_source_open(address, &options, &source, &err), err);
    tells(source, 0, "WAITING a.jpg; ");
    CHECK(rename(inner, away) == 0);
    CHECK(gsn_source_poll(source, SETTLE, &none, &ended, &err) == GSN_E_IO);
    CHECK(none == NULL && ended == 7);
    CHECK(rename(away, inner) == 0);
    tells(source, 2 * SETTLE, "READY a.jpg; ");
}

TEST(an_address_that_is_none_is_refused)
{
    static const char *const wrong[] = { "", "hot", "usb:1", "hotter:/tmp", "/tmp", ":/tmp" };
    struct gsn_source *source = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++)
        CHECK(gsn_source_open(wrong[i], &options, &source, &err) == GSN_E_UNSUPPORTED);
    CHECK(gsn_source_open("hot:/nowhere/at/all", &options, &source, &err) == GSN_E_NOTFOUND);
    CHECK(gsn_source_open("hot:/dev/null", &options, &source, &err) == GSN_E_NOTFOUND);
    CHECK(source == NULL);
}

static int look_twice(const char *address, struct gsn_error *err)
{
    gsn_auto(gsn_source) source = NULL;
    int r = gsn_source_open(address, &options, &source, err);

    for (int64_t look = 0; r >= 0 && look < 2; look++) {
        gsn_auto(gsn_source_events) events = NULL;
        int ended;

        r = gsn_source_poll(source, look * SETTLE, &events, &ended, err);
    }
    return r;
}

/* A poll that fails for memory has told nothing, so the next one tells it all. */
static void poll_short_of_memory(struct gsn_source *source, int64_t now, const char *expected)
{
    struct gsn_error err = { 0 };

    for (size_t n = 1;; n++) {
        gsn_auto(gsn_source_events) events = NULL;
        int ended, r;

        gsn_check_fail_allocation(n);
        r = gsn_source_poll(source, now, &events, &ended, &err);
        gsn_check_fail_allocation(0);
        if (r == GSN_OK) {
            CHECK(n > 1);
            CHECK(events->count == 1 && strcmp(events->at[0].name, expected) == 0);
            return;
        }
        CHECK(r == GSN_E_NOMEM && events == NULL);
    }
}

TEST(running_out_of_memory_leaks_and_forgets_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");
    struct gsn_error err = { 0 };
    char address[200];

    write_file(&scratch, "a.txt", "text", 4);
    poll_short_of_memory(source, 0, "a.txt");
    poll_short_of_memory(source, SETTLE, "a.txt");
    (void)snprintf(address, sizeof address, "replay:%s", scratch.dir);
    write_file(&scratch, "b.jpg", whole, 4);
    CHECK_EVERY_OOM(look_twice(address, &err), err);
}

enum { LONG_MS = 300000, GENEROUS_MS = 60000 };

static int64_t now_ms(void)
{
    struct timespec now;

    CHECK(clock_gettime(CLOCK_MONOTONIC, &now) == 0);
    return now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static bool wakes_early(struct gsn_source *source, int stop_fd)
{
    const int64_t start = now_ms();
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_source_wait(source, LONG_MS, stop_fd, &err), err);
    return now_ms() - start < GENEROUS_MS;
}

TEST(a_file_that_comes_wakes_who_waits)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = open_source(&scratch, "hot");
    struct gsn_error err = { 0 };

    tells(source, 0, "");
    gsn_scratch_append(gsn_scratch_path(&scratch, "P1.jpg"), whole, 4);
    CHECK(wakes_early(source, -1));
    /* What was told of is over: nothing else happens until the time is. */
    const int64_t start = now_ms();

    CHECK_OK(gsn_source_wait(source, 30, -1, &err), err);
    CHECK(now_ms() - start >= 29);
    write_file(&scratch, "P2.jpg", whole, 4); /* by rename */
    CHECK(wakes_early(source, -1));
}

TEST(a_folder_that_was_replaced_is_watched_again)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_source) source = NULL;
    gsn_auto(gsn_source_events) events = NULL;
    const char *const dir = gsn_scratch_path(&scratch, "medium");
    struct gsn_error err = { 0 };
    char address[200];
    int ended;

    CHECK(mkdir(dir, 0755) == 0);
    (void)snprintf(address, sizeof address, "hot:%s", dir);
    CHECK_OK(gsn_source_open(address, &options, &source, &err), err);
    tells(source, 0, "");
    CHECK(rename(dir, gsn_scratch_path(&scratch, "old")) == 0);
    CHECK(gsn_source_poll(source, 0, &events, &ended, &err) == GSN_E_IO);
    CHECK(mkdir(dir, 0755) == 0);
    tells(source, 0, "");
    write_file(&scratch, "medium/P1.jpg", whole, 4);
    CHECK(wakes_early(source, -1));
    tells(source, 0, "WAITING P1.jpg; ");
}

TEST(who_waits_can_be_stopped)
{
    static const char *const kinds[] = { "hot", "replay" };
    scratch_auto scratch = gsn_scratch_new();
    int pipes[2];

    CHECK(pipe(pipes) == 0 && write(pipes[1], "", 1) == 1);
    for (size_t i = 0; i < 2; i++) {
        gsn_auto(gsn_source) source = open_source(&scratch, kinds[i]);

        CHECK(wakes_early(source, pipes[0]));
    }
    CHECK(close(pipes[0]) == 0 && close(pipes[1]) == 0);
}
