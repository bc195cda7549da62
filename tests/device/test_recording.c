/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A session that was written down comes back as a device. All the way through libusb. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "acquire/ptp_transport.h"
#include "acquire/source.h"
#include "pipeline/core/file.h"
#include "tests/check.h"
#include "tests/device/ptp_model.h"
#include "tests/device/pull.h"
#include "tests/device/transcript.h"
#include "tests/device/umock.h"
#include "tests/storage/scratch.h"

enum { NUMBER = 11, LARGEST = 16 << 20 };

static struct gsn_source *open_source(const char *address, const char *record)
{
    const struct gsn_source_setting setting = { "Record", record };
    const struct gsn_source_options options = { .settle_ms = 500,
                                                .setting_count = record ? 1 : 0,
                                                .setting = &setting };
    struct gsn_source *source = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_source_open(address, &options, &source, &err), err);
    return source;
}

/* Plugs the record in and takes so many objects from it. */
static void play(const char *text, size_t size, const char *address, size_t count,
                 struct pull *pull)
{
    struct transcript *const transcript = transcript_new(text, size);
    struct umock *const umock = umock_new();
    struct gsn_source *source;
    struct gsn_error err = { 0 };

    CHECK(transcript);
    umock_plug(umock, transcript_usb(transcript), NUMBER);
    source = open_source(address, NULL);
    CHECK_OK(pull_until(pull, source, count, &err), err);
    gsn_source_free(source);
    umock_free(umock);
    transcript_free(transcript);
}

static void record_session(const char *path, const uint8_t *bytes, size_t size,
                           const struct ptp_faults *faults, struct pull *pull)
{
    struct ptp_model *const model = ptp_model_new("SN0001", faults);
    struct umock *const umock = umock_new();
    const struct ptp_object first = { .name = "one.tif",
                                      .date = "20260101T120000",
                                      .format = PTP_TIFF,
                                      .size = 500,
                                      .bytes = bytes };
    struct ptp_object second = first;
    struct gsn_source *source;
    struct gsn_error err = { 0 };

    second.name = "two.tif";
    second.size = size;
    (void)ptp_model_add(model, &first, 0);
    umock_plug(umock, ptp_model_usb(model), NUMBER);
    source = open_source("ptp:SN0001", path);
    CHECK_OK(pull_until(pull, source, 1, &err), err);
    umock_lock(umock);
    (void)ptp_model_add(model, &second, 1);
    umock_unlock(umock);
    CHECK_OK(pull_until(pull, source, 2, &err), err);
    gsn_source_free(source);
    umock_free(umock);
    ptp_model_free(model);
}

static void is_there(const struct pull *pull, const char *name, const uint8_t *bytes, size_t size)
{
    const struct pulled *const got = pull_find(pull, name);

    CHECK(got && got->size == size && memcmp(got->bytes, bytes, size) == 0);
}

TEST(a_live_capture_can_be_saved_and_is_a_device_again)
{
    static const struct ptp_faults habits[] = {
        { 0 },
        { .merge_response = true },
        { .split_header = true, .leftover_zlp = true },
        { .no_partial = true, .no_partial64 = true, .short_reads = 10000 },
    };
    const size_t size = 300000;
    uint8_t *const bytes = malloc(size);

    for (size_t i = 0; i < size; i++)
        bytes[i] = (uint8_t)(i * 11 + i / 241);
    for (size_t i = 0; i < sizeof habits / sizeof *habits; i++) {
        scratch_auto scratch = gsn_scratch_new();
        const char *const path = gsn_scratch_path(&scratch, "session");
        gsn_auto_mem(uint8_t) text = NULL;
        struct pull live = { 0 }, played = { 0 };
        struct gsn_error err = { 0 };
        size_t text_size;

        record_session(path, bytes, size, &habits[i], &live);
        is_there(&live, "two.tif", bytes, size);
        CHECK_OK(gsn_file_read(path, LARGEST, &text, &text_size, &err), err);
        CHECK(strstr((const char *)text, "\ne ")); /* the event that announced the second */
        CHECK(strstr((const char *)text, " +\n"));
        play((const char *)text, text_size, "ptp:1209:0001:SN0001", 2, &played);
        is_there(&played, "one.tif", bytes, 500);
        is_there(&played, "two.tif", bytes, size);
        pull_free(&live);
        pull_free(&played);
    }
    free(bytes);
}

TEST(a_record_is_asked_for_by_a_whole_path_and_refused_where_none_can_be)
{
    const struct gsn_source_setting relative = { "Record", "session" },
                                    nowhere = { "Record", "/proc/nothing/session" };
    struct gsn_source_options options = { .setting_count = 1, .setting = &relative };
    struct ptp_model *const model = ptp_model_new("SN0001", NULL);
    struct umock *const umock = umock_new();
    struct gsn_source *source = NULL;
    struct gsn_error err = { 0 };

    umock_plug(umock, ptp_model_usb(model), NUMBER);
    CHECK(gsn_source_check("ptp:any", &options, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "Record=session"));
    options.setting = &nowhere;
    CHECK(gsn_source_open("ptp:any", &options, &source, &err) == GSN_E_IO && !source);
    CHECK(strstr(err.text, "/proc/nothing/session"));
    umock_free(umock);
    ptp_model_free(model);
}
