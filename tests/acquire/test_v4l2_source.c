/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The V4L2 source, unmodified, against cameras behind /dev/videoN as umockdev makes them believed.
 */
#include "acquire/v4l2_device.h"
#include "acquire/source.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <stdbool.h>
#include <stdio.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "acquire/container.h"
#include "pipeline/core/file.h"
#include "pipeline/decode/decode.h"
#include "tests/check.h"
#include "tests/decode/make.h"
#include "tests/device/umock_v4l2.h"

enum { WIDTH = 64, HEIGHT = 48, ROW = 2 * WIDTH, PADDING = 32, STRIDE = ROW + PADDING };
enum { REST = 3, SILENCE_MS = 5000, SKIPPED = 77 };

#define BY_ID "usb-Mock_Camera_SN0001-video-index0"

/* A camera as they are: automatics on, values inactive until those are off. */
static const struct v4l2_mock_recipe webcam = {
    .card = "Mock Camera",
    .serial = "SN0001",
    .by_id = BY_ID,
    .size = { { V4L2_PIX_FMT_YUYV, WIDTH, HEIGHT },
              { V4L2_PIX_FMT_YUYV, 32, 24 },
              { V4L2_PIX_FMT_MJPEG, WIDTH, HEIGHT } },
    .padding = PADDING,
    .colorspace = V4L2_COLORSPACE_SRGB,
    .control = { { V4L2_CID_EXPOSURE_AUTO, 0, 3, 3, 0, 0, 0, 0 },
                 { V4L2_CID_EXPOSURE_ABSOLUTE, 3, 2047, 250, 0, 0, 0, V4L2_CID_EXPOSURE_AUTO },
                 { V4L2_CID_GAIN, 0, 255, 64, 0, 0, 0, 0 },
                 { V4L2_CID_AUTO_WHITE_BALANCE, 0, 1, 1, 0, 0, 0, 0 },
                 { V4L2_CID_WHITE_BALANCE_TEMPERATURE, 2800, 6500, 4000, 0, 0, 0,
                   V4L2_CID_AUTO_WHITE_BALANCE } },
};

static const struct gsn_source_setting settings[] = {
    { "Format", "YUYV" },  { "Width", "64" }, { "Height", "48" },         { "AtRest", "3" },
    { "Exposure", "156" }, { "Gain", "10" },  { "WhiteBalance", "4600" },
};

static const struct gsn_source_options options = { .setting_count = 7, .setting = settings };

/* Everything here needs the mock; without it nothing is said to be true. */
__attribute__((constructor)) static void skip_without_umockdev(void)
{
    struct v4l2_mock *const mock = v4l2_mock_new();

    if (mock) {
        v4l2_mock_free(mock);
        return;
    }
    (void)fprintf(stderr, "skipped: umockdev's preload library is not in LD_PRELOAD\n");
    _exit(SKIPPED);
}

static void free_mock(struct v4l2_mock **mock)
{
    v4l2_mock_free(*mock);
}

#define mock_auto __attribute__((cleanup(free_mock))) struct v4l2_mock *

/* Frame number i of the picture which: rows with padding that must not be kept. */
static void draw(uint8_t frame[HEIGHT * STRIDE], unsigned which)
{
    for (unsigned y = 0; y < HEIGHT; y++) {
        for (unsigned x = 0; x < STRIDE; x++)
            frame[y * STRIDE + x] =
                (uint8_t)(x < ROW ? 40 + ((x * 3 + y * 5 + which * 61) % 180) : 0xee);
    }
}

static void push(struct v4l2_mock_camera *camera, unsigned which, unsigned count)
{
    static uint8_t frame[HEIGHT * STRIDE];

    draw(frame, which);
    for (unsigned i = 0; i < count; i++)
        v4l2_mock_push(camera, frame, sizeof frame, 0);
}

static struct gsn_source *open_camera(const char *address)
{
    struct gsn_source *source = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_source_open(address, &options, &source, &err), err);
    return source;
}

/* Demands that opening fails, with these words in the sentence. */
static void refuses(const char *address, const struct gsn_source_options *with, int code,
                    const char *words)
{
    struct gsn_source *source = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_source_open(address, with, &source, &err) == code);
    CHECK(source == NULL);
    if (!strstr(err.text, words))
        fail_msg("\"%s\" does not say \"%s\"", err.text, words);
}

/* What one poll tells: items and notices. */
static struct gsn_source_events *poll_at(struct gsn_source *source, int64_t now)
{
    struct gsn_source_events *events = NULL;
    struct gsn_error err = { 0 };
    int ended = 0;

    CHECK_OK(gsn_source_poll(source, now, &events, &ended, &err), err);
    CHECK(ended == 0);
    return events;
}

/* Polls until every frame was taken from the camera; the number of items that are READY then. */
static size_t drain(struct gsn_source *source, struct v4l2_mock_camera *camera)
{
    size_t ready = 0, before = 0;

    do {
        gsn_auto(gsn_source_events) events = NULL;

        before = v4l2_mock_waiting(camera);
        events = poll_at(source, 0);
        ready = 0;
        for (size_t i = 0; i < events->count; i++)
            ready += events->at[i].what == GSN_SOURCE_READY;
    } while (v4l2_mock_waiting(camera) < before);
    return ready;
}

struct item {
    uint64_t number;
    enum gsn_source_subject subject;
    char name[32], facts[4000];
    size_t size;
    uint8_t bytes[3 * HEIGHT * STRIDE];
};

/* The first item, in pieces of an odd size; it stays. */
static struct item *first_item(struct gsn_source *source)
{
    static struct item item;
    gsn_auto(gsn_source_events) events = poll_at(source, 0);
    struct gsn_error err = { 0 };
    size_t got = 1, i = 0;

    memset(&item, 0, sizeof item);
    while (i < events->count && events->at[i].what != GSN_SOURCE_READY)
        i++;
    CHECK(i < events->count);
    item.number = events->at[i].item;
    item.subject = events->at[i].subject;
    (void)snprintf(item.name, sizeof item.name, "%s", events->at[i].name);
    (void)snprintf(item.facts, sizeof item.facts, "%s", events->at[i].facts);
    for (; got > 0; item.size += got)
        CHECK_OK(gsn_source_read(source, item.number, item.size, item.bytes + item.size, 997, &got,
                                 &err),
                 err);
    CHECK(item.size == events->at[i].size && events->at[i].incomplete == 0);
    return &item;
}

static void acknowledge(struct gsn_source *source, uint64_t item)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_source_acknowledge(source, item, &err), err);
}

static bool says(const struct item *item, const char *line)
{
    return memmem(item->bytes, item->size < 2000 ? item->size : 2000, line, strlen(line)) != NULL;
}

/* The payload is the frame without its padding. */
static void is_frame(const struct item *item, unsigned which)
{
    static uint8_t frame[HEIGHT * STRIDE];
    const uint8_t *const payload = item->bytes + item->size - HEIGHT * ROW;

    draw(frame, which);
    CHECK(item->size > HEIGHT * ROW && memcmp(payload - 7, "ENDHDR\n", 7) == 0);
    for (size_t y = 0; y < HEIGHT; y++)
        CHECK(memcmp(payload + y * ROW, frame + y * STRIDE, ROW) == 0);
}

static void a_panel_comes_in(const struct v4l2_mock_recipe *recipe, const char *address)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 3, recipe);
    gsn_auto(gsn_source) source = open_camera(address);
    struct item *item;

    push(camera, 1, REST - 1);
    CHECK(drain(source, camera) == 0);
    push(camera, 1, 3);
    CHECK(drain(source, camera) == 1);
    item = first_item(source);
    CHECK(item->subject == GSN_SUBJECT_PANEL && strcmp(item->name, "panel.pam") == 0);
    is_frame(item, 1);
    CHECK(says(item, "WIDTH 64\nHEIGHT 48\nDEPTH 2\nMAXVAL 255\nTUPLTYPE YUYV\n"));
    CHECK(says(item, "# matrix: BT.601\n# range: limited\n# transfer: sRGB\n"));
    CHECK(says(item, "# exposure: 156 x 100 us, locked\n# gain: 10, locked\n"
                     "# white balance: 4600 K, locked\n"));
    CHECK(!says(item, "not to be measured"));
    CHECK(strstr(item->facts, "\"quantify\":true") != NULL);
    acknowledge(source, item->number);
    push(camera, 1, 2 * REST);
    CHECK(drain(source, camera) == 0);
}

TEST(a_panel_at_rest_is_taken_once_through_mapped_buffers)
{
    a_panel_comes_in(&webcam, "v4l2:" BY_ID);
}

TEST(a_panel_at_rest_is_taken_once_through_buffers_of_ours)
{
    struct v4l2_mock_recipe recipe = webcam;

    recipe.no_mmap = 1;
    a_panel_comes_in(&recipe, "v4l2:" BY_ID);
    recipe.is_pty = 1;
    a_panel_comes_in(&recipe, "v4l2:" BY_ID);
}

TEST(a_node_that_cannot_be_mapped_is_read_into_buffers_of_ours)
{
    struct v4l2_mock_recipe recipe = webcam;

    recipe.is_pty = 1; /* REQBUFS succeeds, mmap() does not */
    a_panel_comes_in(&recipe, "v4l2:" BY_ID);
}

TEST(a_panel_at_rest_is_taken_once_by_read)
{
    struct v4l2_mock_recipe recipe = webcam;

    recipe.no_mmap = recipe.no_userptr = recipe.has_read = 1;
    a_panel_comes_in(&recipe, "v4l2:" BY_ID);
}

TEST(a_camera_answers_to_its_serial_number)
{
    a_panel_comes_in(&webcam, "v4l2:SN0001");
}

/* Case 6. */
TEST(of_two_cameras_the_one_that_is_named_is_opened)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_recipe other = webcam;
    struct v4l2_mock_camera *one, *two;

    other.serial = "SN0002";
    other.by_id = "usb-Mock_Camera_SN0002-video-index0";
    two = v4l2_mock_plug(mock, 0, &other); /* it has the number that the first had yesterday */
    one = v4l2_mock_plug(mock, 1, &webcam);
    {
        gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);

        CHECK(v4l2_mock_asked(one, VIDIOC_S_FMT) == 1 && v4l2_mock_asked(two, VIDIOC_S_FMT) == 0);
        CHECK(strcmp(gsn_source_device(source), "Mock Camera, " BY_ID) == 0);
    }
    {
        gsn_auto(gsn_source) source = open_camera("v4l2:SN0002");

        CHECK(v4l2_mock_asked(one, VIDIOC_S_FMT) == 1 && v4l2_mock_asked(two, VIDIOC_S_FMT) == 1);
    }
    refuses("v4l2:SN0003", &options, GSN_E_NOTFOUND, "is it plugged in?");
}

TEST(two_cameras_with_one_serial_number_must_be_told_apart_by_name)
{
    mock_auto mock = v4l2_mock_new();

    (void)v4l2_mock_plug(mock, 0, &webcam);
    {
        struct v4l2_mock_recipe twin = webcam;

        twin.by_id = NULL;
        (void)v4l2_mock_plug(mock, 1, &twin);
    }
    refuses("v4l2:SN0001", &options, GSN_E_INPUT, "2 cameras have this serial number");
}

TEST(a_number_of_a_node_names_no_camera)
{
    struct gsn_error err = { 0 };

    CHECK(gsn_source_check("v4l2:/dev/video0", &options, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "dealt anew at each boot") != NULL);
    CHECK(gsn_source_check("v4l2:video12", &options, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "dealt anew at each boot") != NULL);
    CHECK(gsn_source_check("v4l2:../../etc", &options, &err) == GSN_E_INPUT);
    CHECK(gsn_source_check("v4l2:", &options, &err) == GSN_E_INPUT);
    CHECK_OK(gsn_source_check("v4l2:videograbber", &options, &err), err);
    CHECK(strcmp(gsn_source_subsystem("v4l2:x"), "video4linux") == 0);
}

static void refuses_setting(const char *key, const char *value, const char *words)
{
    struct gsn_source_setting changed[8];
    struct gsn_source_options with = { .setting_count = 8, .setting = changed };
    struct gsn_error err = { 0 };

    memcpy(changed, settings, sizeof settings);
    changed[7] = (struct gsn_source_setting){ key, value };
    CHECK(gsn_source_check("v4l2:x", &with, &err) == GSN_E_INPUT);
    if (!strstr(err.text, words))
        fail_msg("\"%s\" does not say \"%s\"", err.text, words);
}

TEST(settings_are_judged_without_a_camera)
{
    const struct gsn_source_options none = { .setting_count = 0 };
    struct gsn_error err = { 0 };

    refuses_setting("Format", "H264", "Format=H264 is not read here; these are: YUYV");
    refuses_setting("Format", "MJPG", "AtRest=no");
    refuses_setting("Width", "0", "Width=0: give a whole number from 1 to 65535");
    refuses_setting("Height", "12.5", "Height=12.5");
    refuses_setting("Exposure", "auto", "Exposure=auto");
    refuses_setting("AtRest", "1", "from 2 to 64");
    refuses_setting("Zoom", "1", "no setting \"Zoom\"");
    CHECK(gsn_source_check("v4l2:x", &none, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "Format=, Width= and Height=") != NULL);
}

/* Case 2. */
TEST(a_format_the_driver_would_change_is_refused_with_what_it_has)
{
    mock_auto mock = v4l2_mock_new();
    struct gsn_source_setting changed[7];
    const struct gsn_source_options with = { .setting_count = 7, .setting = changed };

    (void)v4l2_mock_plug(mock, 0, &webcam);
    memcpy(changed, settings, sizeof settings);
    changed[1].value = "640";
    changed[2].value = "480";
    refuses("v4l2:" BY_ID, &with, GSN_E_INPUT,
            "asked for YUYV 640x480, the camera would give YUYV 64x48; it has: YUYV 64x48 32x24; "
            "MJPG 64x48");
    /* Each of the three alone, too. */
    changed[0].value = "UYVY";
    changed[1].value = "64";
    changed[2].value = "48";
    refuses("v4l2:" BY_ID, &with, GSN_E_INPUT, "asked for UYVY 64x48");
    changed[0].value = "YUYV";
    changed[1].value = "32";
    refuses("v4l2:" BY_ID, &with, GSN_E_INPUT, "asked for YUYV 32x48");
    changed[1].value = "64";
    changed[2].value = "24";
    refuses("v4l2:" BY_ID, &with, GSN_E_INPUT, "asked for YUYV 64x24");
}

TEST(a_rate_the_driver_would_change_is_refused)
{
    mock_auto mock = v4l2_mock_new();
    struct gsn_source_setting changed[8];
    const struct gsn_source_options with = { .setting_count = 8, .setting = changed };
    struct gsn_source *source = NULL;
    struct gsn_error err = { 0 };

    (void)v4l2_mock_plug(mock, 0, &webcam);
    memcpy(changed, settings, sizeof settings);
    changed[7] = (struct gsn_source_setting){ "Fps", "60" };
    refuses("v4l2:" BY_ID, &with, GSN_E_INPUT, "Fps=60: the camera would give 30 frames in 1 s");
    changed[7].value = "25";
    CHECK_OK(gsn_source_open("v4l2:" BY_ID, &with, &source, &err), err);
    gsn_source_free(source);
}

/* One panel of a camera whose control number i was changed; what its frame says. */
static struct item *panel_of(const struct v4l2_mock_recipe *recipe)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, recipe);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);

    push(camera, 1, REST);
    CHECK(drain(source, camera) == 1);
    return first_item(source);
}

static void is_withheld(const struct v4l2_mock_recipe *recipe, const char *reason)
{
    const struct item *const item = panel_of(recipe);
    char line[300];

    (void)snprintf(line, sizeof line, "# not to be measured: %s", reason);
    if (!says(item, line))
        fail_msg("the frame does not say \"%s\" but %.900s", line, (const char *)item->bytes);
    CHECK(strstr(item->facts, "\"quantify\":false,\"reason\":\"") != NULL);
    CHECK(strstr(item->facts, reason) != NULL);
    CHECK(strstr(item->facts, "\"locked\":false") != NULL);
    is_frame(item, 1);
}

/* Case 7. */
TEST(what_cannot_be_locked_is_said_in_the_frame)
{
    struct v4l2_mock_recipe recipe = webcam;

    recipe.control[0].flags = V4L2_CTRL_FLAG_GRABBED;
    is_withheld(&recipe, "exposure is not locked: its automatic cannot be switched off (held by "
                         "another program or by the stream)");
    recipe = webcam;
    recipe.control[0].is_stuck = 1;
    is_withheld(&recipe, "exposure is not locked: its automatic was switched off, but reads on");
    recipe = webcam;
    recipe.control[0].set_errno = EIO;
    is_withheld(&recipe, "exposure is not locked: its automatic cannot be switched off");
    recipe = webcam;
    recipe.control[2].is_stuck = 1;
    is_withheld(&recipe, "gain is not locked: it was set to 10 and reads 64");
    recipe = webcam;
    recipe.control[2].flags = V4L2_CTRL_FLAG_VOLATILE;
    is_withheld(&recipe, "gain is not locked: its value changes by itself");
    recipe = webcam;
    recipe.control[2].id = 0;
    is_withheld(&recipe, "gain is not locked: the camera has no control for it");
    recipe = webcam;
    recipe.control[4].rules = V4L2_CID_EXPOSURE_AUTO;
    recipe.control[0].is_stuck = 1;
    is_withheld(&recipe, "exposure is not locked: its automatic was switched off, but reads on; "
                         "white balance is not locked: inactive");
}

TEST(a_value_out_of_range_is_refused_with_the_range)
{
    mock_auto mock = v4l2_mock_new();
    struct gsn_source_setting changed[7];
    const struct gsn_source_options with = { .setting_count = 7, .setting = changed };

    (void)v4l2_mock_plug(mock, 0, &webcam);
    memcpy(changed, settings, sizeof settings);
    changed[4].value = "5000";
    refuses("v4l2:" BY_ID, &with, GSN_E_INPUT,
            "exposure 5000 was asked for, it goes from 3 to 2047");
}

TEST(a_control_turned_by_another_program_is_seen_at_the_next_frame)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    struct item *item;

    CHECK(v4l2_mock_value(camera, V4L2_CID_EXPOSURE_AUTO) == V4L2_EXPOSURE_MANUAL);
    CHECK(v4l2_mock_value(camera, V4L2_CID_EXPOSURE_ABSOLUTE) == 156);
    CHECK(v4l2_mock_value(camera, V4L2_CID_AUTO_WHITE_BALANCE) == 0);
    v4l2_mock_turn(camera, V4L2_CID_GAIN, 99);
    push(camera, 1, REST);
    CHECK(drain(source, camera) == 1);
    item = first_item(source);
    CHECK(says(item, "# gain: 99, not locked\n"));
    CHECK(says(item, "# not to be measured: gain is not locked: it reads 99 where 10 was locked"));
    acknowledge(source, item->number);
    v4l2_mock_turn(camera, V4L2_CID_GAIN, 10);
    v4l2_mock_turn(camera, V4L2_CID_AUTO_WHITE_BALANCE, 1);
    push(camera, 2, REST);
    CHECK(drain(source, camera) == 1);
    CHECK(says(first_item(source), "white balance is not locked: its automatic was switched on"));
}

TEST(an_item_stays_until_it_is_acknowledged)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    struct gsn_error err = { 0 };
    uint64_t first;
    size_t got = 7;
    char byte;

    push(camera, 1, REST);
    CHECK(drain(source, camera) == 1);
    push(camera, 2, REST);
    CHECK(drain(source, camera) == 2);
    CHECK(drain(source, camera) == 2);
    first = first_item(source)->number;
    is_frame(first_item(source), 1);
    acknowledge(source, first);
    is_frame(first_item(source), 2);
    CHECK(gsn_source_acknowledge(source, first, &err) == GSN_E_NOTFOUND);
    CHECK(gsn_source_read(source, first, 0, &byte, 1, &got, &err) == GSN_E_NOTFOUND && got == 7);
}

TEST(no_more_pictures_are_taken_than_are_fetched_and_the_next_one_is_not_lost)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    gsn_auto(gsn_source_events) events = NULL;

    for (unsigned i = 1; i <= 8; i++) {
        push(camera, i, REST);
        CHECK(drain(source, camera) == i);
    }
    push(camera, 9, REST);
    events = poll_at(source, 0);
    CHECK(events->count == 9 && events->at[0].what == GSN_SOURCE_NOTICE);
    CHECK(strstr(events->at[0].reason, "wait to be taken over") != NULL);
    acknowledge(source, first_item(source)->number);
    push(camera, 9, REST); /* it lies there still */
    CHECK(drain(source, camera) == 8);
    for (unsigned i = 2; i <= 9; i++) {
        struct item *const item = first_item(source);

        is_frame(item, i);
        acknowledge(source, item->number);
    }
}

TEST(a_picture_asked_for_is_none_that_was_exposed_before)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    struct gsn_error err = { 0 };
    struct item *item;

    CHECK_OK(gsn_source_capture(source, GSN_SUBJECT_BLANK, &err), err);
    CHECK(gsn_source_capture(source, GSN_SUBJECT_DARK, &err) == GSN_E_BUSY);
    CHECK(strstr(err.text, "blank") != NULL);
    push(camera, 1, 4); /* as many as the driver has buffers: they may be old */
    push(camera, 2, 1);
    CHECK(drain(source, camera) == 1);
    item = first_item(source);
    CHECK(item->subject == GSN_SUBJECT_BLANK && strcmp(item->name, "blank.pam") == 0);
    CHECK(says(item, "# subject: blank\n"));
    is_frame(item, 2);
    acknowledge(source, item->number);
    /* The empty stage is known now, and not taken for a panel. */
    push(camera, 2, 2 * REST);
    CHECK(drain(source, camera) == 0);
    push(camera, 3, 2 * REST);
    CHECK(drain(source, camera) == 1);
}

/* Frames of the same picture as another process sees it: brighter or darker by a step or two. */
static void push_noisy(struct v4l2_mock_camera *camera, unsigned which, unsigned count)
{
    static uint8_t frame[HEIGHT * STRIDE];

    for (unsigned i = 0; i < count; i++) {
        draw(frame, which);
        for (size_t at = 0; at < sizeof frame; at += 2)
            frame[at] = (uint8_t)(frame[at] + 1 + i % 2);
        v4l2_mock_push(camera, frame, sizeof frame, 0);
    }
}

/* The facts of a picture that a process took before it ended. gives. */
static char *facts_of(struct v4l2_mock_camera *camera, enum gsn_source_subject subject,
                      unsigned which)
{
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_source_capture(source, subject, &err), err);
    push(camera, which, 5);
    CHECK(drain(source, camera) == 1);
    return gsn_strdup(first_item(source)->facts);
}

/* Opens with what the ledger says was taken of this subject last. */
static struct gsn_source *open_after(enum gsn_source_subject subject, const char *facts)
{
    struct gsn_source_options with = options;
    struct gsn_source *source = NULL;
    struct gsn_error err = { 0 };

    with.last_facts[subject] = facts;
    CHECK_OK(gsn_source_open("v4l2:" BY_ID, &with, &source, &err), err);
    return source;
}

TEST(a_panel_that_was_taken_before_the_restart_is_not_taken_again)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto_mem(char) facts = facts_of(camera, GSN_SUBJECT_PANEL, 1);
    gsn_auto(gsn_source) source = open_after(GSN_SUBJECT_PANEL, facts);

    push_noisy(camera, 1, 4 * REST);
    CHECK(drain(source, camera) == 0);
    push(camera, 2, REST + 1);
    CHECK(drain(source, camera) == 1);
    is_frame(first_item(source), 2);
    acknowledge(source, first_item(source)->number);
    push(camera, 1, REST + 1); /* another lay there meanwhile */
    CHECK(drain(source, camera) == 1);
}

TEST(blank_glass_and_dark_frames_shown_before_the_restart_are_no_panels)
{
    for (unsigned subject = GSN_SUBJECT_BLANK; subject <= GSN_SUBJECT_DARK; subject++) {
        mock_auto mock = v4l2_mock_new();
        struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
        gsn_auto_mem(char) facts = facts_of(camera, (enum gsn_source_subject)subject, 1);
        gsn_auto(gsn_source) source = open_after((enum gsn_source_subject)subject, facts);

        push_noisy(camera, 1, 4 * REST);
        CHECK(drain(source, camera) == 0);
        push(camera, 2, REST + 1);
        CHECK(drain(source, camera) == 1);
        acknowledge(source, first_item(source)->number);
        push_noisy(camera, 1, 4 * REST); /* and not only the first time */
        CHECK(drain(source, camera) == 0);
    }
}

TEST(a_panel_is_taken_where_the_ledger_tells_nothing_of_it)
{
    static const char *const texts[] = { NULL, "", "{\"ISO\":100}", "{\"thumbnail\":\"",
                                         "{\"thumbnail\":\"AAAA\"}" };

    for (size_t i = 0; i < sizeof texts / sizeof texts[0]; i++) {
        mock_auto mock = v4l2_mock_new();
        struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
        gsn_auto(gsn_source) source = open_after(GSN_SUBJECT_PANEL, texts[i]);

        push(camera, 1, 2 * REST);
        CHECK(drain(source, camera) == 1);
    }
}

TEST(a_panel_that_was_asked_for_is_not_taken_again_at_rest)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_source_capture(source, GSN_SUBJECT_PANEL, &err), err);
    push(camera, 1, 5 + 4 * REST);
    CHECK(drain(source, camera) == 1);
    push(camera, 2, REST + 1);
    CHECK(drain(source, camera) == 2);
}

TEST(damaged_and_short_frames_are_dropped_and_counted)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    static uint8_t rubbish[HEIGHT * STRIDE];

    v4l2_mock_push(camera, rubbish, sizeof rubbish, V4L2_BUF_FLAG_ERROR);
    push(camera, 1, 1);
    v4l2_mock_push(camera, rubbish, sizeof rubbish / 2, 0);
    v4l2_mock_push(camera, rubbish, 0, 0);
    push(camera, 1, REST - 1);
    CHECK(drain(source, camera) == 1);
    is_frame(first_item(source), 1);
    CHECK(strstr(first_item(source)->facts, "\"damaged_before\":") != NULL);
    acknowledge(source, first_item(source)->number);
}

TEST(a_picture_asked_for_is_none_the_driver_calls_damaged)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    static uint8_t frame[HEIGHT * STRIDE];
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_source_capture(source, GSN_SUBJECT_PANEL, &err), err);
    push(camera, 1, 4);
    draw(frame, 2); /* looks whole */
    v4l2_mock_push(camera, frame, sizeof frame, V4L2_BUF_FLAG_ERROR);
    CHECK(drain(source, camera) == 0);
    push(camera, 3, 1);
    CHECK(drain(source, camera) == 1);
    is_frame(first_item(source), 3);
    CHECK(strstr(first_item(source)->facts, "\"damaged_before\":1,") != NULL);
}

TEST(errors_of_the_driver_in_between_lose_no_panel)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);

    v4l2_mock_fail(camera, VIDIOC_DQBUF, EIO, 2);
    v4l2_mock_fail(camera, VIDIOC_QBUF, EIO, 3);
    push(camera, 1, 3 * REST);
    for (unsigned i = 0; i < 4; i++)
        gsn_source_events_free(poll_at(source, 0));
    CHECK(drain(source, camera) == 1);
    is_frame(first_item(source), 1);
}

TEST(a_camera_that_gives_nothing_is_said_once_and_begun_anew)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    size_t told = 0;

    for (int64_t now = 1000; now < 1000 + 3 * SILENCE_MS; now += 500) {
        gsn_auto(gsn_source_events) events = poll_at(source, now);

        CHECK(events->count == 0 || now == 1000 + SILENCE_MS);
        for (size_t i = 0; i < events->count; i++)
            CHECK(strstr(events->at[i].reason, "no whole frame came for 5 s") != NULL);
        told += events->count;
    }
    CHECK(told == 1);
    CHECK(v4l2_mock_asked(camera, VIDIOC_STREAMON) == 3);
    push(camera, 1, REST);
    CHECK(drain(source, camera) == 1);
}

TEST(a_stream_that_cannot_be_begun_anew_ends_the_source)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    gsn_auto(gsn_source_events) events = NULL;
    struct gsn_error err = { 0 };
    int64_t now = 1000;
    int ended = 0, r = GSN_OK;

    v4l2_mock_fail(camera, VIDIOC_STREAMON, EBUSY, 100);
    for (; r >= 0 && now < 1000 + 3 * SILENCE_MS; now += 500) {
        gsn_source_events_free(gsn_steal(&events));
        r = gsn_source_poll(source, now, &events, &ended, &err);
    }
    CHECK(r == GSN_E_NOTFOUND && now < 1000 + 2 * SILENCE_MS);
    CHECK(strstr(err.text, "starting the stream") != NULL);
}

TEST(waiting_on_a_poll_that_is_always_ready_ends_in_time)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    struct gsn_error err = { 0 };
    unsigned asked;

    for (unsigned i = 0; i < 3; i++)
        gsn_source_events_free(poll_at(source, 0));
    asked = v4l2_mock_asked(camera, VIDIOC_DQBUF);
    CHECK_OK(gsn_source_wait(source, 5, -1, &err), err);
    CHECK(v4l2_mock_asked(camera, VIDIOC_DQBUF) == asked);
}

TEST(an_unplugged_camera_is_not_found_but_what_it_gave_is_kept)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    struct gsn_source_events *events = NULL;
    struct gsn_error err = { 0 };
    int ended = 7;

    push(camera, 1, REST);
    CHECK(drain(source, camera) == 1);
    v4l2_mock_unplug(camera);
    events = poll_at(source, 0);
    CHECK(events->count == 2 && events->at[0].what == GSN_SOURCE_NOTICE);
    CHECK(strstr(events->at[0].reason, "plug it in again") != NULL);
    gsn_source_events_free(events);
    events = NULL;
    is_frame(first_item(source), 1);
    acknowledge(source, first_item(source)->number);
    CHECK(gsn_source_poll(source, 0, &events, &ended, &err) == GSN_E_NOTFOUND);
    CHECK(events == NULL && ended == 7 && strstr(err.text, "plug it in again") != NULL);
    CHECK(gsn_source_capture(source, GSN_SUBJECT_DARK, &err) == GSN_E_NOTFOUND);
    refuses("v4l2:" BY_ID, &options, GSN_E_NOTFOUND, "is it plugged in?");
}

TEST(a_camera_held_by_another_is_busy)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);

    v4l2_mock_fail(camera, VIDIOC_S_FMT, EBUSY, 1);
    refuses("v4l2:" BY_ID, &options, GSN_E_BUSY, "another program holds the camera");
    v4l2_mock_fail(camera, VIDIOC_REQBUFS, EBUSY, 1);
    refuses("v4l2:" BY_ID, &options, GSN_E_BUSY, "another program holds the camera");
    v4l2_mock_fail(camera, VIDIOC_STREAMON, ENOSPC, 1);
    refuses("v4l2:" BY_ID, &options, GSN_E_IO, "the USB bus has no room for this stream");
}

/* A program of another name that has the node open; it is ready when this returns. */
static pid_t hold(const char *node)
{
    int pipe_of[2];
    char byte;
    pid_t pid;

    CHECK(pipe2(pipe_of, O_CLOEXEC) == 0);
    pid = fork();
    if (pid == 0) {
        (void)prctl(PR_SET_PDEATHSIG, SIGKILL); /* a failed test leaves nobody behind */
        if (open(node, O_RDWR) >= 0)            /* inherited by what follows */
            (void)execlp("sleep", "sleep", "1000", (char *)NULL);
        _exit(127);
    }
    (void)close(pipe_of[1]);
    CHECK(read(pipe_of[0], &byte, 1) == 0); /* closed by exec */
    (void)close(pipe_of[0]);
    return pid;
}

TEST(the_program_that_holds_a_camera_is_named)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 1, &webcam);
    struct v4l2_mock_recipe other = webcam;
    const pid_t pid = hold("/dev/video1");
    char words[80];

    (void)snprintf(words, sizeof words, "process %ld (sleep) holds the camera; close that first",
                   (long)pid);
    v4l2_mock_fail(camera, VIDIOC_S_FMT, EBUSY, 1);
    refuses("v4l2:" BY_ID, &options, GSN_E_BUSY, words);
    /* What it holds is that camera and no other. */
    other.serial = "SN0002";
    other.by_id = NULL;
    v4l2_mock_fail(v4l2_mock_plug(mock, 0, &other), VIDIOC_S_FMT, EBUSY, 1);
    refuses("v4l2:SN0002", &options, GSN_E_BUSY, "another program holds the camera");
    CHECK(kill(pid, SIGKILL) == 0 && waitpid(pid, NULL, 0) == pid);
    v4l2_mock_fail(camera, VIDIOC_S_FMT, EBUSY, 1);
    refuses("v4l2:" BY_ID, &options, GSN_E_BUSY, "another program holds the camera");
}

static void notes(const char *set, size_t size, const char *note)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_recipe recipe = webcam;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    char path[300], got[400] = "untouched";
    size_t whole = 0;

    if (set) {
        (void)snprintf(path, sizeof path, "%s/device/%s.descriptors", GSN_FIXTURES, set);
        CHECK_OK(gsn_file_read(path, 65536, &bytes, &whole, &err), err);
    }
    recipe.descriptors = bytes;
    recipe.descriptors_size = size ? size : whole;
    (void)v4l2_mock_plug(mock, 0, &recipe);
    gsn_v4l2_note(BY_ID, got, sizeof got);
    if (strcmp(got, note) != 0)
        fail_msg("\"%s\", not \"%s\"", got, note);
    gsn_v4l2_note("nobody", got, sizeof got);
    CHECK(got[0] == '\0');
}

TEST(it_is_said_of_a_camera_beforehand_that_it_cannot_be_locked)
{
    notes("logitech_c270", 0, "");
    notes("anker_powerconf_c200", 0, "cannot be locked (no gain): its pictures are not measured");
    notes("logitech_c270", 100,
          "its description cannot be trusted: the configuration states 2466 bytes, 82 are there");
    notes(NULL, 0, "");
}

/* Opens with another format than YUYV, and no automatic rest. */
static struct gsn_source *open_by_request(const char *format)
{
    struct gsn_source_setting changed[7];
    const struct gsn_source_options with = { .setting_count = 7, .setting = changed };
    struct gsn_source *source = NULL;
    struct gsn_error err = { 0 };

    memcpy(changed, settings, sizeof settings);
    changed[0].value = format;
    changed[3].value = "no";
    CHECK_OK(gsn_source_open("v4l2:" BY_ID, &with, &source, &err), err);
    return source;
}

static void ask_for(struct gsn_source *source, enum gsn_source_subject subject)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_source_capture(source, subject, &err), err);
}

TEST(a_jpeg_that_ends_early_is_said_and_the_next_one_is_taken)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_by_request("MJPG");
    gsn_auto(gsn_image) image = make_picture(WIDTH, HEIGHT, 3, 8);
    auto_made jpeg = make_jpeg(image, &(struct jpeg_recipe){ .quality = 60 });
    gsn_auto(gsn_source_events) events = NULL;
    gsn_auto(gsn_picture) picture = NULL;
    gsn_auto(gsn_picture) truth = NULL;
    struct gsn_error err = { 0 };
    struct item *item;

    for (unsigned i = 0; i < 9; i++)
        v4l2_mock_push(camera, jpeg.bytes, jpeg.size, 0);
    CHECK(drain(source, camera) == 0); /* nobody asked */
    ask_for(source, GSN_SUBJECT_PANEL);
    for (unsigned i = 0; i < 4; i++)
        v4l2_mock_push(camera, jpeg.bytes, jpeg.size, 0);
    v4l2_mock_push(camera, jpeg.bytes, jpeg.size / 2, 0);
    events = poll_at(source, 0);
    CHECK(events->count == 1 && events->at[0].what == GSN_SOURCE_NOTICE);
    CHECK(strstr(events->at[0].reason, "before the JPEG's EOI") != NULL);
    v4l2_mock_push(camera, jpeg.bytes, jpeg.size, 0);
    CHECK(drain(source, camera) == 1);
    item = first_item(source);
    CHECK(strcmp(item->name, "panel.jpg") == 0);
    CHECK_OK(gsn_decode(item->bytes, item->size, NULL, &picture, &err), err);
    CHECK_OK(gsn_decode(jpeg.bytes, jpeg.size, NULL, &truth, &err), err);
    CHECK(same_picture(picture->image, truth->image) && picture->withheld[0] == '\0');
}

/* A mono camera of 10 bits: white balance is nothing to it, and what cannot be is refused. */
TEST(raw_samples_need_no_white_balance)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_recipe recipe = webcam;
    struct v4l2_mock_camera *camera;
    uint8_t words[HEIGHT * STRIDE] = { 0 };
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };
    struct item *item;

    recipe.size[0] = (struct v4l2_mock_size){ V4L2_PIX_FMT_Y10, WIDTH, HEIGHT };
    recipe.colorspace = V4L2_COLORSPACE_RAW;
    recipe.control[3].id = recipe.control[4].id = 0;
    for (size_t i = 0; i < HEIGHT * STRIDE; i += 2) {
        words[i] = (uint8_t)i;
        words[i + 1] = (uint8_t)(i / 2 % 4);
    }
    camera = v4l2_mock_plug(mock, 0, &recipe);
    gsn_auto(gsn_source) source = open_by_request("Y10");
    ask_for(source, GSN_SUBJECT_DARK);
    for (unsigned i = 0; i < 5; i++)
        v4l2_mock_push(camera, words, sizeof words, 0);
    CHECK(drain(source, camera) == 1);
    item = first_item(source);
    CHECK(item->subject == GSN_SUBJECT_DARK && strcmp(item->name, "dark.pam") == 0);
    CHECK(says(item, "MAXVAL 1023\nTUPLTYPE GRAYSCALE\n") && says(item, "# transfer: linear\n"));
    CHECK(!says(item, "not to be measured"));
    CHECK_OK(gsn_decode(item->bytes, item->size, NULL, &picture, &err), err);
    for (uint32_t x = 0; x < WIDTH; x++)
        CHECK_NEAR(
            gsn_image_at(picture->image, x, 3, 0),
            (words[3 * STRIDE + 2 * x] | words[3 * STRIDE + 2 * x + 1] << 8) * 65535.0 / 1023, 0.5);
}

/* What the camera said of its colours is what the decoder uses: a level of 16 is black here. */
TEST(a_frame_is_decoded_by_what_the_camera_states)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_recipe recipe = webcam;
    struct v4l2_mock_camera *camera;
    static uint8_t frame[HEIGHT * STRIDE];
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };
    struct item *item;

    recipe.colorspace = V4L2_COLORSPACE_REC709;
    camera = v4l2_mock_plug(mock, 0, &recipe);
    for (size_t i = 0; i < sizeof frame; i += 2)
        memcpy(frame + i, (uint8_t[]){ i % STRIDE < 64 ? 16 : 235, 128 }, 2);
    gsn_auto(gsn_source) source = open_by_request("YUYV");
    ask_for(source, GSN_SUBJECT_PANEL);
    for (unsigned i = 0; i < 5; i++)
        v4l2_mock_push(camera, frame, sizeof frame, 0);
    CHECK(drain(source, camera) == 1);
    item = first_item(source);
    CHECK(says(item, "# matrix: BT.709\n# range: limited\n"));
    CHECK_OK(gsn_decode(item->bytes, item->size, NULL, &picture, &err), err);
    CHECK(gsn_image_at(picture->image, 0, 0, 1) == 0);
    CHECK(gsn_image_at(picture->image, WIDTH - 1, HEIGHT - 1, 1) == 65535);
}

static int open_once(struct gsn_error *err)
{
    gsn_auto(gsn_source) source = NULL;

    return gsn_source_open("v4l2:" BY_ID, &options, &source, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    mock_auto mock = v4l2_mock_new();
    struct gsn_error err = { 0 };

    (void)v4l2_mock_plug(mock, 0, &webcam);
    CHECK_EVERY_OOM(open_once(&err), err);
}

/* Memory that runs out while a panel is taken costs a try, never the panel. */
TEST(running_out_of_memory_loses_no_panel)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);
    struct gsn_error err = { 0 };
    unsigned which = 0;

    for (size_t n = 1, asked = n; asked + 1 >= n; n++) {
        struct gsn_source_events *events = NULL;
        int ended, r;

        push(camera, ++which, REST);
        gsn_check_fail_allocation(n);
        r = gsn_source_poll(source, 0, &events, &ended, &err);
        asked = gsn_check_allocations();
        gsn_check_fail_allocation(0);
        gsn_source_events_free(events);
        CHECK(r == (asked >= n ? GSN_E_NOMEM : GSN_OK));
        push(camera, which, REST);
        CHECK(drain(source, camera) == 1);
        is_frame(first_item(source), which);
        acknowledge(source, first_item(source)->number);
    }
}

/* v4l2-ctl, unmodified, sees the camera that the source sees. */
TEST(v4l2_ctl_reads_the_same_bytes_from_this_camera)
{
    mock_auto mock = v4l2_mock_new();
    struct v4l2_mock_camera *const camera = v4l2_mock_plug(mock, 0, &webcam);
    static uint8_t frame[HEIGHT * STRIDE], got[HEIGHT * STRIDE + 1];
    char path[300], command[900];
    FILE *file;
    int status;

    if (access("/usr/bin/v4l2-ctl", X_OK) < 0) {
        gsn_check_skip("v4l2-ctl is not installed");
    }
    push(camera, 5, 4);
    (void)snprintf(path, sizeof path, "%.250s/frame", v4l2_mock_root(mock));
    (void)snprintf(command, sizeof command,
                   "timeout 60 v4l2-ctl -d /dev/video0 "
                   "--set-fmt-video=width=64,height=48,pixelformat=YUYV --stream-mmap "
                   "--stream-count=1 --stream-to=%s >%s.log 2>&1",
                   path, path);
    status = system(command);
    if (!WIFEXITED(status) || WEXITSTATUS(status) != 0)
        fail_msg("%s: %d", command, status);
    file = fopen(path, "rb");
    CHECK(file != NULL);
    draw(frame, 5);
    CHECK(fread(got, 1, sizeof got, file) == sizeof frame);
    (void)fclose(file);
    CHECK(memcmp(got, frame, sizeof frame) == 0);
    {
        gsn_auto(gsn_source) source = open_camera("v4l2:" BY_ID);

        push(camera, 5, REST);
        CHECK(drain(source, camera) == 1);
        is_frame(first_item(source), 5);
    }
}
