/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The whole way of a panel under a camera, with the service in it: giesond starts the intake of its
 * source, which locks the camera and takes a frame at rest; the frame becomes an object, a row of
 * the ledger and a panel, which is decoded apart and examined. */
#include <linux/videodev2.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "storage/bench.h"
#include "storage/queue.h"
#include "storage/scan.h"
#include "systemd/worker/job.h"
#include "tests/check.h"
#include "tests/device/aside.h"
#include "tests/device/umock_v4l2.h"
#include "tests/specimen/drawn_panel.h"
#include "tests/storage/bench.h"

enum { PADDING = 32, REST = 3, GENEROUS_MS = 60000, SKIPPED = 77 };
enum { MOST_BYTES = 1 << 24 };

#define JOB                                                                                        \
    "{\"specimen\": \"S\", \"px_um\": 24, \"layout\": [2, 2], \"panels\": 4, \"transfer\": "       \
    "\"linear\", \"thresholds\": [0.5], \"markers_um\": " DRAWN_MARKS_JSON "}"

/* The automatics are on, as they are in a camera fresh from its box. */
static const struct v4l2_mock_recipe camera_of_ours = {
    .card = "Mock Camera",
    .serial = "SN0001",
    .padding = PADDING,
    .colorspace = V4L2_COLORSPACE_SRGB,
    .control = { { V4L2_CID_EXPOSURE_AUTO, 0, 3, 3, 0, 0, 0, 0 },
                 { V4L2_CID_EXPOSURE_ABSOLUTE, 3, 2047, 250, 0, 0, 0, V4L2_CID_EXPOSURE_AUTO },
                 { V4L2_CID_GAIN, 0, 255, 64, 0, 0, 0, 0 },
                 { V4L2_CID_AUTO_WHITE_BALANCE, 0, 1, 1, 0, 0, 0, 0 },
                 { V4L2_CID_WHITE_BALANCE_TEMPERATURE, 2800, 6500, 4000, 0, 0, 0,
                   V4L2_CID_AUTO_WHITE_BALANCE } },
};

struct bench {
    struct gsn_scratch scratch;
    struct v4l2_mock *mock;
    struct v4l2_mock_camera *camera;
    struct gsn_store *store;
    pid_t giesond;
    struct gsn_image *scene[3]; /* two panels, and the stage without one */
    uint8_t *frame;
};

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

static int64_t now_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* Panels 0 and 1 are told apart by a section that is missing; the stage 2 is glass. */
static struct gsn_image *draw(unsigned which)
{
    struct drawn_panel panel = drawn_panel_of(which + 1, 24, 0.4);

    for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++)
        panel.section[slot].missing = which == 2 || (which == 1 && slot == 3);
    return drawn_panel_image(&panel);
}

static size_t row_of(const struct bench *bench)
{
    return 3 * (size_t)bench->scene[0]->width;
}

/* Frames of a scene; noise: each is a step brighter or darker than the one before. */
static void push(struct bench *bench, unsigned which, unsigned count, int noise)
{
    const struct gsn_image *const image = bench->scene[which];
    const size_t stride = row_of(bench) + PADDING, size = stride * image->height;

    for (unsigned i = 0; i < count; i++) {
        memset(bench->frame, 0xee, size);
        for (size_t y = 0; y < image->height; y++)
            for (size_t x = 0; x < row_of(bench); x++) {
                const uint8_t code = ((const uint8_t *)image->samples)[y * row_of(bench) + x];

                bench->frame[y * stride + x] =
                    (uint8_t)(noise && code < 250 ? code + 1 + (i & 1) : code);
            }
        v4l2_mock_push(bench->camera, bench->frame, size, 0);
    }
}

/* ---- the service ------------------------------------------------------------------------- */

static void configure(struct bench *bench)
{
    gsn_auto_mem(char) text = gsn_format(
        "[store]\nReserveMiB=1\n[work]\nMemoryMiB=0\n[source camera]\nAddress=v4l2:SN0001\n"
        "SettleMs=100\nSweepS=1\nFormat=RGB3\nWidth=%u\nHeight=%u\nAtRest=%d\nExposure=156\n"
        "Gain=10\nWhiteBalance=4600\nSilenceS=3600\n",
        bench->scene[0]->width, bench->scene[0]->height, REST);
    struct gsn_error err = { 0 };

    CHECK_OK(
        gsn_file_write(gsn_scratch_path(&bench->scratch, "gieson.conf"), text, strlen(text), &err),
        err);
}

static void fill_store(struct bench *bench)
{
    struct gsn_specimen_row specimen = bench_specimen("S", "g", "");
    struct gsn_error err = { 0 };
    int64_t id;

    specimen.job_json = JOB;
    CHECK_OK(gsn_store_open(gsn_scratch_path(&bench->scratch, "store"), GSN_STORE_CREATE,
                            &bench->store, &err),
             err);
    CHECK_OK(
        gsn_specimen_put(bench->store, &specimen, GSN_SPECIMEN_REFUSE, "test", NOON, &id, &err),
        err);
    CHECK_OK(gsn_scan_expect(bench->store, "camera", "S", "test", NOON, &err), err);
}

static void start(struct bench *bench)
{
    gsn_auto_mem(char) config = gsn_strdup(gsn_scratch_path(&bench->scratch, "gieson.conf"));
    gsn_auto_mem(char) store = gsn_strdup(gsn_scratch_path(&bench->scratch, "store"));

    bench->giesond = fork();
    if (bench->giesond == 0) {
        umock_open_aside();
        (void)prctl(PR_SET_PDEATHSIG, SIGTERM); /* a failed test leaves nobody behind */
        (void)unsetenv("NOTIFY_SOCKET");
        (void)execl(GSN_GIESOND, GSN_GIESOND, "--store", store, "--config", config, "--only",
                    "intake", (char *)NULL);
        _exit(127);
    }
}

static void stop(struct bench *bench)
{
    int status = -1;

    CHECK(kill(bench->giesond, SIGTERM) == 0);
    CHECK(waitpid(bench->giesond, &status, 0) == bench->giesond);
    CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

static void bench_done(struct bench *bench)
{
    gsn_store_free(bench->store);
    v4l2_mock_free(bench->mock);
    for (size_t i = 0; i < 3; i++)
        gsn_image_free(bench->scene[i]);
    gsn_scratch_remove(&bench->scratch);
    free(bench->frame);
}
#define auto_bench __attribute__((cleanup(bench_done))) struct bench

static struct bench set_up(const struct v4l2_mock_recipe *recipe)
{
    struct bench bench = { .scratch = gsn_scratch_new(), .mock = v4l2_mock_new() };
    struct v4l2_mock_recipe own = *recipe;

    for (unsigned i = 0; i < 3; i++)
        bench.scene[i] = draw(i);
    own.size[0] = (struct v4l2_mock_size){ V4L2_PIX_FMT_RGB24, bench.scene[0]->width,
                                           bench.scene[0]->height };
    bench.frame = malloc((row_of(&bench) + PADDING) * bench.scene[0]->height);
    CHECK(bench.frame != NULL);
    bench.camera = v4l2_mock_plug(bench.mock, 0, &own);
    configure(&bench);
    fill_store(&bench);
    start(&bench);
    return bench;
}

/* ---- waiting ----------------------------------------------------------------------------- */

static size_t scans(struct bench *bench)
{
    gsn_auto(gsn_scan_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_scan_list(bench->store, NULL, 0, &rows, &err), err);
    return rows->count;
}

static void wait_for_scans(struct bench *bench, size_t count)
{
    const int64_t end = now_ms() + GENEROUS_MS;

    while (scans(bench) < count && now_ms() < end)
        (void)usleep(20000);
    if (scans(bench) != count)
        fail_msg("%zu scans came, not %zu", scans(bench), count);
}

/* Until the camera's stream was begun so many times. */
static void wait_for_stream(struct bench *bench, unsigned times)
{
    const int64_t end = now_ms() + GENEROUS_MS;

    while (v4l2_mock_asked(bench->camera, VIDIOC_STREAMON) < times && now_ms() < end)
        (void)usleep(20000);
    CHECK(v4l2_mock_asked(bench->camera, VIDIOC_STREAMON) == times);
}

/* The one process that giesond runs. */
static pid_t intake_of(const struct bench *bench)
{
    char path[80], line[80] = "";
    FILE *file;

    (void)snprintf(path, sizeof path, "/proc/%ld/task/%ld/children", (long)bench->giesond,
                   (long)bench->giesond);
    file = fopen(path, "r");
    CHECK(file != NULL);
    CHECK(fgets(line, sizeof line, file) != NULL);
    (void)fclose(file);
    return (pid_t)strtol(line, NULL, 10);
}

static void ask_for(struct bench *bench, const char *kind)
{
    const int64_t end = now_ms() + GENEROUS_MS;
    struct gsn_error err = { 0 };
    int64_t id;
    int r;

    /* The camera streams before giesond has heard of it. */
    while ((r = gsn_request_add(bench->store, "camera", kind, "test", NOON, &id, &err)) ==
               GSN_E_NOTFOUND &&
           now_ms() < end)
        (void)usleep(20000);
    CHECK_OK(r, err);
    for (;;) {
        gsn_auto(gsn_request_row) row = NULL;

        CHECK_OK(gsn_request_get(bench->store, id, &row, &err), err);
        if (strcmp(row->state, "done") == 0)
            return;
        if (strcmp(row->state, "waiting") != 0 || now_ms() > end)
            fail_msg("%s is %s: %s", kind, row->state, row->message);
        (void)usleep(20000);
    }
}

/* ---- what came of it --------------------------------------------------------------------- */

static struct gsn_scan_row *newest(struct bench *bench, const char *subject)
{
    struct gsn_scan_row *row = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_scan_newest(bench->store, "camera", subject, &row, &err), err);
    return row;
}

/* Whether the object of a scan is a PAM with the frame in it, without the padding of its rows. */
static bool is_frame(struct bench *bench, const struct gsn_scan_row *scan, unsigned which)
{
    const size_t payload = row_of(bench) * bench->scene[which]->height;
    gsn_auto_mem(char) path = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_digest digest;
    struct gsn_error err = { 0 };
    size_t size;

    CHECK_OK(gsn_store_object_path(bench->store, scan->sha256, &path, &err), err);
    CHECK_OK(gsn_file_read(path, MOST_BYTES, &bytes, &size, &err), err);
    CHECK_OK(gsn_sha256(bytes, size, &digest, &err), err);
    CHECK(strcmp(digest.hex, scan->sha256) == 0);
    CHECK(size > payload && memcmp(bytes, "P7\n# gieson frame 1\n", 20) == 0);
    return memcmp(bytes + size - payload, bench->scene[which]->samples, payload) == 0;
}

/* Until this scene is the panel that came last: pictures come in order, so whatever was to be taken
 * before it is there by then. */
static void wait_for_panel(struct bench *bench, unsigned which)
{
    const int64_t end = now_ms() + GENEROUS_MS;
    bool there = false;

    while (!there && now_ms() < end) {
        gsn_auto(gsn_scan_row) row = NULL;
        struct gsn_error err = { 0 };

        there = gsn_scan_newest(bench->store, "camera", "panel", &row, &err) >= 0 &&
                is_frame(bench, row, which);
        if (!there)
            (void)usleep(20000);
    }
    CHECK(there);
}

/* Does the job of the panel that came last, and gives its row. */
static struct gsn_panel_row *examine(struct bench *bench)
{
    static const struct gsn_job_options options = {
        .mesher = GSN_MESHER, .decoder = GSN_DECODER, .owner = "test", .threads = 1
    };
    gsn_auto(gsn_scan_row) scan = newest(bench, "panel");
    struct gsn_panel_row *panel = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_job_next(bench->store, &options, &err), err);
    CHECK_OK(gsn_panel_get(bench->store, scan->panel_id, &panel, &err), err);
    return panel;
}

static void is_panel(struct bench *bench, int64_t number)
{
    gsn_auto(gsn_scan_row) scan = newest(bench, "panel");
    gsn_auto(gsn_panel_row) panel = NULL;
    struct gsn_error err = { 0 };

    CHECK(strcmp(scan->state, "filed") == 0 && strcmp(scan->specimen, "S") == 0);
    CHECK_OK(gsn_panel_get(bench->store, scan->panel_id, &panel, &err), err);
    CHECK(panel->number == number);
}

TEST(a_panel_under_a_locked_camera_is_taken_decoded_and_registered)
{
    auto_bench bench = set_up(&camera_of_ours);
    gsn_auto(gsn_scan_row) scan = NULL;
    gsn_auto(gsn_panel_row) panel = NULL;
    gsn_auto(gsn_section_rows) sections = NULL;
    struct gsn_error err = { 0 };

    wait_for_stream(&bench, 1);
    push(&bench, 0, REST + 2, 0);
    wait_for_scans(&bench, 1);
    scan = newest(&bench, "panel");
    CHECK(strcmp(scan->device, "Mock Camera, SN0001") == 0 && strcmp(scan->name, "panel.pam") == 0);
    CHECK(is_frame(&bench, scan, 0));
    CHECK(strstr(scan->facts, "{\"name\":\"exposure\",\"value\":156,\"unit\":\"x 100 us\","
                              "\"locked\":true},{\"name\":\"gain\",\"value\":10,\"locked\":true},"
                              "{\"name\":\"white balance\",\"value\":4600,\"unit\":\"K\","
                              "\"locked\":true}],\"quantify\":true"));
    is_panel(&bench, 1);
    panel = examine(&bench);
    if (strcmp(panel->state, "registered") != 0)
        fail_msg("%s: %s", panel->state, panel->message);
    CHECK(panel->width == bench.scene[0]->width && panel->height == bench.scene[0]->height);
    CHECK_OK(gsn_section_list(bench.store, panel->specimen_id, &sections, &err), err);
    CHECK(sections->count == DRAWN_SLOTS);
    for (size_t i = 0; i < sections->count; i++)
        CHECK(strcmp(sections->at[i].state, "found") == 0);
    stop(&bench);
}

TEST(a_panel_under_a_camera_that_cannot_be_locked_is_kept_but_not_measured)
{
    struct v4l2_mock_recipe recipe = camera_of_ours;
    gsn_auto(gsn_scan_row) scan = NULL;
    gsn_auto(gsn_panel_row) panel = NULL;

    recipe.control[0].is_stuck = 1; /* its automatic exposure stays on */
    auto_bench bench = set_up(&recipe);
    wait_for_stream(&bench, 1);
    push(&bench, 0, REST + 2, 0);
    wait_for_scans(&bench, 1);
    scan = newest(&bench, "panel");
    CHECK(strstr(scan->facts, "\"quantify\":false"));
    panel = examine(&bench);
    CHECK(strcmp(panel->state, "refused") == 0 && strcmp(panel->code, "stain") == 0);
    if (!strstr(panel->message,
                "its camera says that colours must not be measured (exposure is not locked: its "
                "automatic was switched off, but reads on"))
        fail_msg("%s", panel->message);
    CHECK(is_frame(&bench, scan, 0));
    stop(&bench);
}

TEST(a_panel_that_lies_there_while_the_intake_is_killed_is_taken_once)
{
    auto_bench bench = set_up(&camera_of_ours);

    wait_for_stream(&bench, 1);
    push(&bench, 0, REST + 2, 0);
    wait_for_scans(&bench, 1);
    CHECK(kill(intake_of(&bench), SIGKILL) == 0);
    wait_for_stream(&bench, 2);
    push(&bench, 0, 3 * REST, 1); /* other bytes of the same */
    push(&bench, 1, REST + 2, 0);
    wait_for_panel(&bench, 1);
    wait_for_scans(&bench, 2);
    is_panel(&bench, 2);
    stop(&bench);
}

TEST(blank_glass_is_taken_by_request_and_known_after_a_restart)
{
    auto_bench bench = set_up(&camera_of_ours);
    gsn_auto(gsn_scan_row) blank = NULL;

    wait_for_stream(&bench, 1);
    ask_for(&bench, "capture-blank");
    push(&bench, 2, 5 + 2 * REST, 0); /* as many as may be old, the one, and the stage at rest */
    wait_for_scans(&bench, 1);
    blank = newest(&bench, "blank");
    CHECK(strcmp(blank->state, "kept") == 0 && strcmp(blank->name, "blank.pam") == 0);
    CHECK(blank->panel_id == 0);
    CHECK(is_frame(&bench, blank, 2));
    stop(&bench);
    start(&bench);
    wait_for_stream(&bench, 2);
    push(&bench, 2, 3 * REST, 1);
    push(&bench, 0, REST + 2, 0);
    wait_for_panel(&bench, 0);
    wait_for_scans(&bench, 2);
    is_panel(&bench, 1);
    stop(&bench);
}
