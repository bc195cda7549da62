/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/service/config.h"

#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "tests/check.h"
#include "tests/storage/scratch.h"

/* Everything that was told, a line each. */
struct heard {
    char text[8192];
    size_t length, count;
};

static void hear(void *context, const char *sentence)
{
    struct heard *const heard = context;

    heard->length += (size_t)snprintf(heard->text + heard->length,
                                      sizeof heard->text - heard->length, "%s\n", sentence);
    heard->count++;
}

static void write_text(const struct gsn_scratch *scratch, const char *name, const char *text)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_file_mkdir(gsn_scratch_path(scratch, "conf.d"), &err), err);
    CHECK_OK(gsn_file_write(gsn_scratch_path(scratch, name), text, strlen(text), &err), err);
}

static int read_heard(const struct gsn_scratch *scratch, struct heard *heard,
                      struct gsn_config **ret_config, struct gsn_error *err)
{
    const struct gsn_config_ear ear = { hear, heard };

    return gsn_config_read(gsn_scratch_path(scratch, "gieson.conf"), &ear, ret_config, err);
}

static struct gsn_config *read_fine(const struct gsn_scratch *scratch)
{
    struct gsn_config *config = NULL;
    struct heard heard = { .count = 0 };
    struct gsn_error err = { 0 };

    if (read_heard(scratch, &heard, &config, &err) < 0)
        fail_msg("a good configuration was refused: %s", heard.text);
    CHECK(heard.count == 0);
    return config;
}

TEST(no_file_is_a_configuration_without_sources)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_config) config = read_fine(&scratch);

    CHECK(config->source_count == 0 && config->workers == 1 && config->threads == 0);
    CHECK(strcmp(config->store_dir, "") == 0 && config->reserve_bytes > 0 && config->minutes > 0);
}

TEST(every_key_is_read)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_config) config = NULL;
    const struct gsn_config_source *source;

    write_text(
        &scratch, "gieson.conf",
        "\xef\xbb\xbf# a comment\n; another\n\n[store]\nDirectory = /srv/gieson\n"
        "ReserveMiB=7\n[work]\nWorkers=2\nThreads=3\nMemoryMiB=0\nTimeMinutes=5\n"
        "[source flatbed]\r\n  Address=hot:/srv/scans ; inline\r\nSettleMs=10\nPatienceS=11\n"
        "SweepS=12\nDeleteAfterCopy=yes\nSpecimen=GVP D\n");
    config = read_fine(&scratch);
    CHECK(strcmp(config->store_dir, "/srv/gieson") == 0);
    CHECK(config->reserve_bytes == (uint64_t)7 << 20);
    CHECK(config->workers == 2 && config->threads == 3 && config->memory_mib == 0);
    CHECK(config->minutes == 5 && config->source_count == 1);
    source = gsn_config_find(config, "flatbed");
    CHECK(source && strcmp(source->address, "hot:/srv/scans") == 0);
    CHECK(source->settle_ms == 10 && source->patience_s == 11 && source->sweep_s == 12);
    CHECK(source->delete_after_copy == 1 && strcmp(source->specimen, "GVP D") == 0);
    CHECK(gsn_config_find(config, "flat") == NULL);
}

TEST(of_a_key_the_last_file_counts_by_name)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_config) config = NULL;

    write_text(&scratch, "gieson.conf",
               "[work]\nWorkers=1\nThreads=1\n[source a]\nAddress=hot:/a\n");
    write_text(&scratch, "conf.d/20-b.conf", "[work]\nWorkers=20\n[source a]\nSweepS=9\n");
    write_text(&scratch, "conf.d/10-a.conf",
               "[work]\nWorkers=10\nThreads=10\n[source b]\n"
               "Address=replay:/b\n");
    write_text(&scratch, "conf.d/30-c.conf.bak", "[work]\nWorkers=30\n");
    write_text(&scratch, "conf.d/.40-d.conf", "[work]\nWorkers=40\n");
    config = read_fine(&scratch);
    CHECK(config->workers == 20 && config->threads == 10 && config->source_count == 2);
    CHECK(strcmp(config->source[0].name, "a") == 0 && config->source[0].sweep_s == 9);
    CHECK(strcmp(config->source[0].address, "hot:/a") == 0);
}

/* One wrong text, the line that is to blame and a part of the sentence. */
/* What a camera needs, all at once. */
#define CAMERA "Format=YUYV\nWidth=640\nHeight=480\n"

static const struct {
    const char *text;
    unsigned line;
    const char *says;
} wrongs[] = {
    { "Workers=1\n", 1, "stands before the first [section]" },
    { "[work\nWorkers=1\n", 1, "a heading must be like [source NAME]" },
    { "[work]\nWorkers\n", 2, "is neither [section] nor Key=Value" },
    { "[work]\n=3\n", 2, "is neither [section] nor Key=Value" },
    { "[wrok]\n", 1, "there is no section [wrok]" },
    { "[work]\nworkers=1\n", 2, "has no such key" },
    { "[work]\nWorkers=0\n", 2, "must be a whole number from 1 to 64" },
    { "[work]\nWorkers=65\n", 2, "must be a whole number from 1 to 64" },
    { "[work]\nWorkers=-1\n", 2, "must be a whole number" },
    { "[work]\nWorkers=2x\n", 2, "must be a whole number" },
    { "[work]\nWorkers=\n", 2, "must be a whole number" },
    { "[work]\nWorkers=99999999999999999999\n", 2, "must be a whole number" },
    { "[work]\nTimeMinutes=0\n", 2, "must be a whole number from 1" },
    { "[work]\nWorkers=1\n[store]\n[work]\nWorkers=2\n", 5, "already, in line 2" },
    { "[store]\nDirectory=store\n", 2, "must be a path that begins with /" },
    { "[store]\nReserve=1\n", 2, "has no such key" },
    { "[source a b]\nAddress=hot:/a\n", 1, "a source's name is made of" },
    { "[source -a]\nAddress=hot:/a\n", 1, "a source's name is made of" },
    { "[source a]\nSettleMs=1\n", 1, "[source a] has no Address" },
    { "[source a]\nSettleMs=1\nAddress=cold:/a\n", 3, "names no source" },
    { "[source a]\nAddress=hot:/a\nPatienceS=0\n", 3, "must be a whole number from 1" },
    { "[source a]\nAddress=hot:/a\nDeleteAfterCopy=true\n", 3, "must be yes or no" },
    { "[source a]\nAddress=hot:/a\n\nExposure=3\n", 4, "has no setting \"Exposure\"" },
    { "[source a]\nAddress=v4l2:cam\nWidth=640\n", 2, "a camera needs Format=" },
    { "[source a]\nAddress=v4l2:cam\n" CAMERA "Exposure=x\n", 6, "Exposure=x: " },
    { "[source a]\nAddress=v4l2:cam\n" CAMERA "Light=1\n", 6, "has no setting \"Light\"" },
    { "[source a]\nAddress=v4l2:/dev/video0\n" CAMERA, 2, "v4l2" },
};

TEST(every_mistake_is_told_with_file_line_and_reason)
{
    for (size_t i = 0; i < sizeof wrongs / sizeof wrongs[0]; i++) {
        scratch_auto scratch = gsn_scratch_new();
        struct gsn_config *config = NULL;
        struct heard heard = { .count = 0 };
        struct gsn_error err = { 0 };
        char place[300];

        write_text(&scratch, "gieson.conf", wrongs[i].text);
        (void)snprintf(place, sizeof place, "%s:%u: ", gsn_scratch_path(&scratch, "gieson.conf"),
                       wrongs[i].line);
        if (read_heard(&scratch, &heard, &config, &err) != GSN_E_INPUT ||
            strncmp(heard.text, place, strlen(place)) != 0 || !strstr(heard.text, wrongs[i].says) ||
            config || heard.count != 1)
            fail_msg("%s -> %zu: %s", wrongs[i].text, heard.count, heard.text);
        CHECK(strstr(err.text, "1 mistake"));
    }
}

TEST(a_camera_is_judged_by_all_its_settings_at_once)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_config) config = NULL;

    write_text(&scratch, "gieson.conf", "[source a]\nAddress=v4l2:cam\n" CAMERA "Exposure=10\n");
    config = read_fine(&scratch);
    CHECK(config->source_count == 1 && config->source[0].setting_count == 4);
}

TEST(all_mistakes_are_told_and_not_the_first_alone)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_config *config = NULL;
    struct heard heard = { .count = 0 };
    struct gsn_error err = { 0 };

    write_text(&scratch, "gieson.conf",
               "[work]\nWorkers=no\nThreads=no\nnonsense\n[source a]\n"
               "Address=hot:/a\nGain=1\nExposure=2\n");
    write_text(&scratch, "conf.d/a.conf", "[storage]\n");
    CHECK(read_heard(&scratch, &heard, &config, &err) == GSN_E_INPUT);
    CHECK(heard.count == 6 && strstr(err.text, "6 mistakes"));
    CHECK(strstr(heard.text, "gieson.conf:2: ") && strstr(heard.text, "gieson.conf:3: "));
    CHECK(strstr(heard.text, "gieson.conf:4: ") && strstr(heard.text, "gieson.conf:7: "));
    CHECK(strstr(heard.text, "gieson.conf:8: ") && strstr(heard.text, "conf.d/a.conf:1: "));
}

TEST(a_line_that_the_parser_would_cut_is_refused_whole)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_config *config = NULL;
    struct heard heard = { .count = 0 };
    struct gsn_error err = { 0 };
    char text[400] = "[source a]\nAddress=hot:/";
    const size_t begun = strlen(text);

    memset(text + begun, 'x', 170);
    write_text(&scratch, "gieson.conf", text);
    gsn_config_free(read_fine(&scratch));
    memset(text + begun, 'x', 200);
    write_text(&scratch, "gieson.conf", text);
    CHECK(read_heard(&scratch, &heard, &config, &err) == GSN_E_INPUT);
    CHECK(strstr(heard.text, "gieson.conf:2: the line is longer than"));
}

TEST(a_file_that_cannot_be_read_is_a_mistake)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_config *config = NULL;
    struct heard heard = { .count = 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_file_mkdir(gsn_scratch_path(&scratch, "gieson.conf"), &err), err);
    CHECK(read_heard(&scratch, &heard, &config, &err) == GSN_E_INPUT);
    CHECK(strstr(heard.text, "cannot be read"));
}

TEST(a_source_is_passed_on_as_a_text_that_reads_back_the_same)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_config) config = NULL;
    gsn_auto(gsn_config) again = NULL;
    gsn_auto_mem(char) text = NULL;
    gsn_auto_mem(char) second = NULL;
    struct gsn_error err = { 0 };

    write_text(&scratch, "gieson.conf",
               "[store]\nReserveMiB=9\n[source a]\nAddress=hot:/a b\n"
               "SweepS=3\nDeleteAfterCopy=yes\nSpecimen=S 1\n[source b]\n"
               "Address=replay:/b\n");
    config = read_fine(&scratch);
    CHECK_OK(gsn_config_write_source(config, &config->source[0], &text, &err), err);
    write_text(&scratch, "gieson.conf", text);
    again = read_fine(&scratch);
    CHECK(again->source_count == 1 && again->reserve_bytes == config->reserve_bytes);
    CHECK(strcmp(again->source[0].address, "hot:/a b") == 0);
    CHECK_OK(gsn_config_write_source(again, &again->source[0], &second, &err), err);
    CHECK(strcmp(text, second) == 0);
}

TEST(folders_without_a_section_get_names_of_their_own)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_config) config = read_fine(&scratch);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_config_add_folder(config, "/srv/my scans/", &err), err);
    CHECK_OK(gsn_config_add_folder(config, "/other/my scans", &err), err);
    CHECK_OK(gsn_config_add_folder(config, ".", &err), err);
    CHECK_OK(gsn_config_add_folder(config, "/", &err), err);
    CHECK(strcmp(config->source[0].name, "my_scans") == 0);
    CHECK(strcmp(config->source[0].address, "hot:/srv/my scans/") == 0);
    CHECK(strcmp(config->source[1].name, "my_scans-2") == 0);
    CHECK(strcmp(config->source[2].name, "_") == 0);
    CHECK(config->source[3].name[0]);
    CHECK(gsn_config_add_folder(config, "/a ;b", &err) == GSN_E_INPUT);
    CHECK(config->source_count == 4);
}

static int read_once(const struct gsn_scratch *scratch, struct gsn_error *err)
{
    gsn_auto(gsn_config) config = NULL;
    gsn_auto_mem(char) text = NULL;
    int r = gsn_config_read(gsn_scratch_path(scratch, "gieson.conf"), NULL, &config, err);

    if (r >= 0)
        r = gsn_config_add_folder(config, "/a", err);
    return r < 0 ? r : gsn_config_write_source(config, &config->source[0], &text, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_error err = { 0 };

    write_text(&scratch, "gieson.conf",
               "[store]\nDirectory=/s\n[source a]\nAddress=hot:/a\n"
               "Specimen=S\n[work]\nWorkers=2\n");
    write_text(&scratch, "conf.d/a.conf", "[source b]\nAddress=hot:/b\n");
    CHECK_EVERY_OOM(read_once(&scratch, &err), err);
}
