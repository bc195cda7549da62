/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A camera as a source, whatever its interface: which frames become panels, and how they are kept.
 *
 * Steps of a poll.
 * 1. At most 32 frames are grabbed. With AtRest= each is reduced to a thumbnail and shown to
 *    acquire/scene_stability.h; on request the first frame that was exposed since is taken.
 * 2. A frame that is taken is encoded with the controls as they are read back then
 *    (acquire/frame.h), and kept in memory until it is acknowledged, 8 at most.
 * 3. Silence: after silence_ms without a whole frame the stream is begun anew.
 * 4. Pending events are emitted in the order in which the pictures were taken.
 *
 * How it fails: only a lack of memory and an unplugged camera fail the poll; anything else is said
 * once and the next frame is tried. Pictures that were taken before the camera went can still be
 * read. */
#include "acquire/camera.h"

#include <errno.h>
#include <poll.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "acquire/scene_stability.h"

const char *const gsn_camera_keys[] = { "Format", "Width",        "Height", "Fps",   "Exposure",
                                        "Gain",   "WhiteBalance", "AtRest", "Noise", "SilenceS",
                                        NULL };

/* Settings. */

static const char *value_of(const struct gsn_source_options *options, const char *key)
{
    const char *value = NULL;

    for (size_t i = 0; i < options->setting_count; i++) {
        if (strcmp(options->setting[i].key, key) == 0)
            value = options->setting[i].value;
    }
    return value;
}

/* A whole number from least to most; a setting that is not there leaves *ret_value as it is. */
static int read_number(const struct gsn_source_options *options, const char *key, long long least,
                       long long most, long long *ret_value, struct gsn_error *err)
{
    const char *const text = value_of(options, key);
    char *end = NULL;
    long long value;

    if (!text)
        return GSN_OK;
    errno = 0;
    value = strtoll(text, &end, 10);
    if (errno || end == text || *end || value < least || value > most)
        return gsn_fail(err, GSN_E_INPUT, "%s=%.60s: give a whole number from %lld to %lld", key,
                        text, least, most);
    *ret_value = value;
    return GSN_OK;
}

static int read_format(const struct gsn_source_options *options,
                       struct gsn_camera_settings *settings, struct gsn_error *err)
{
    const char *const text = value_of(options, "Format");

    if (!text)
        return gsn_fail(err, GSN_E_INPUT,
                        "a camera needs Format=, Width= and Height=: one format for all panels");
    settings->format = gsn_pixel_format_named(text);
    if (!settings->format)
        return gsn_fail(err, GSN_E_INPUT, "Format=%.60s is not read here; these are: %s", text,
                        gsn_pixel_format_list());
    return GSN_OK;
}

static int read_rest(const struct gsn_source_options *options, struct gsn_camera_settings *settings,
                     struct gsn_error *err)
{
    const char *const text = value_of(options, "AtRest");
    const bool off = text && strcmp(text, "no") == 0;
    long long frames = 8, noise = 4;
    int r =
        off ? GSN_OK : read_number(options, "AtRest", 2, GSN_STABILITY_MAX_FRAMES, &frames, err);

    if (r >= 0)
        r = read_number(options, "Noise", 1, 255, &noise, err);
    if (r < 0)
        return r;
    if (!off && settings->format->packing == GSN_PACKING_JPEG)
        return gsn_fail(err, GSN_E_INPUT,
                        "Format=MJPG: its frames do not show whether the panel is at rest; give "
                        "another Format=, or AtRest=no and ask for each picture");
    settings->at_rest = off ? 0 : (unsigned)frames;
    settings->noise = (float)noise;
    return GSN_OK;
}

int gsn_camera_settings_read(const struct gsn_source_options *options,
                             struct gsn_camera_settings *ret_settings, struct gsn_error *err)
{
    struct gsn_camera_settings settings = { 0 };
    const long long most = 1 << 30;
    long long width = 0, height = 0, fps = 0, silence = 5, control[3] = { -1, -1, -1 };
    static const char *const controls[3] = { "Exposure", "Gain", "WhiteBalance" };
    int r = read_format(options, &settings, err);

    if (r >= 0)
        r = read_number(options, "Width", 1, 65535, &width, err);
    if (r >= 0)
        r = read_number(options, "Height", 1, 65535, &height, err);
    if (r >= 0 && (!width || !height))
        r = gsn_fail(err, GSN_E_INPUT,
                     "a camera needs Format=, Width= and Height=: one format for all panels");
    if (r >= 0)
        r = read_number(options, "Fps", 1, 1000, &fps, err);
    for (size_t i = 0; i < 3 && r >= 0; i++)
        r = read_number(options, controls[i], 0, most, &control[i], err);
    if (r >= 0)
        r = read_number(options, "SilenceS", 1, 3600, &silence, err);
    if (r >= 0)
        r = read_rest(options, &settings, err);
    if (r < 0)
        return r;
    settings.width = (uint32_t)width;
    settings.height = (uint32_t)height;
    settings.fps = (uint32_t)fps;
    settings.exposure = control[0];
    settings.gain = control[1];
    settings.white_balance = control[2];
    settings.silence_ms = silence * 1000;
    *ret_settings = settings;
    return GSN_OK;
}

int gsn_camera_check(const char *rest, const struct gsn_source_options *options,
                     struct gsn_error *err)
{
    struct gsn_camera_settings settings;

    if (!rest[0])
        return gsn_fail(err, GSN_E_INPUT, "which camera? Its name is missing behind the colon");
    return gsn_camera_settings_read(options, &settings, err);
}

/* Pictures kept until they are acknowledged: whoever takes them over is stuck if there are more. */
enum { MOST_ITEMS = 8 };

/* Frames looked at in one poll, so that a fast camera cannot keep it for ever. */
enum { MOST_FRAMES = 32 };

/* What poll() promised and the camera did not keep is asked for again after this long. */
enum { PATIENCE_MS = 10 };

struct item {
    uint64_t number; /* 0: this place is free */
    enum gsn_source_subject subject;
    const char *name;
    uint8_t *bytes;
    size_t size;
    char *facts;
};

struct camera {
    struct gsn_grabber grabber;
    struct gsn_camera_settings settings;
    struct gsn_stability rest;
    struct item item[MOST_ITEMS];
    uint64_t last_item;
    bool wanted; /* a picture was asked for, of this subject */
    enum gsn_source_subject subject;
    unsigned stale;        /* frames that are older than the request */
    unsigned damaged;      /* frames since the last picture */
    int64_t last_frame_ms; /* of the caller's clock; negative before the first poll */
    unsigned idle;         /* polls in a row that found no frame */
    bool silent, full, gone;
    char notice[480];     /* to be told; empty: nothing */
    char refused[480];    /* why a frame was refused last: said once */
    struct gsn_error why; /* it is gone */
};

/* Frames that become pictures. */

static void set_notice(struct camera *camera, const char *sentence)
{
    (void)snprintf(camera->notice, sizeof camera->notice, "%s", sentence);
}

static struct item *free_place(struct camera *camera)
{
    for (size_t i = 0; i < MOST_ITEMS; i++) {
        if (!camera->item[i].number)
            return &camera->item[i];
    }
    return NULL;
}

static void clear_item(struct item *item)
{
    gsn_free(item->bytes);
    gsn_free(item->facts);
    *item = (struct item){ 0 };
}

/* Keeps the frame in a free place, with the controls as they are read back now; from then on the
 * scene is known. thumbnail NULL: the frame tells none. */
static int keep_frame(struct camera *camera, struct gsn_frame *frame,
                      const struct gsn_thumbnail *thumbnail, enum gsn_source_subject subject,
                      struct item *item, struct gsn_error *err)
{
    char text[GSN_THUMBNAIL_TEXT + 1];
    int r;

    if (thumbnail)
        gsn_thumbnail_write(thumbnail, text);
    frame->subject = subject;
    r = camera->grabber.ops->read_back(camera->grabber.self, frame, err);
    if (r >= 0)
        r = gsn_frame_encode(frame, &item->bytes, &item->size, err);
    if (r >= 0)
        r = gsn_frame_facts(frame, camera->damaged, thumbnail ? text : NULL, &item->facts, err);
    if (r < 0) {
        clear_item(item);
        return r;
    }
    if (thumbnail)
        gsn_stability_know(&camera->rest, subject, thumbnail);
    item->subject = subject;
    item->name = gsn_frame_name(frame);
    item->number = ++camera->last_item;
    camera->damaged = 0;
    camera->refused[0] = '\0';
    return GSN_OK;
}

/* A picture that was asked for: the first frame that was exposed since. */
static int serve_request(struct camera *camera, struct gsn_frame *frame,
                         const struct gsn_thumbnail *thumbnail, struct item *place,
                         struct gsn_error *err)
{
    int r;

    if (camera->stale > 0) {
        camera->stale--;
        return GSN_OK;
    }
    r = keep_frame(camera, frame, thumbnail, camera->subject, place, err);
    if (r < 0)
        return r;
    camera->wanted = false;
    return GSN_OK;
}

static int look_at_frame(struct camera *camera, struct gsn_frame *frame, struct gsn_error *err)
{
    const struct gsn_stability before = camera->rest;
    struct item *const place = free_place(camera);
    struct gsn_thumbnail made;
    const struct gsn_thumbnail *thumbnail;
    int r = GSN_OK;

    if (!place && !camera->full)
        set_notice(camera, "pictures wait to be taken over; no more are taken until then");
    camera->full = !place;
    if (!place)
        return GSN_OK;
    if (!camera->wanted && !camera->settings.at_rest)
        return GSN_OK;
    thumbnail = gsn_thumbnail_make(frame, &made) ? &made : NULL;
    if (camera->wanted)
        return serve_request(camera, frame, thumbnail, place, err);
    if (thumbnail && gsn_stability_update(&camera->rest, thumbnail) == GSN_STABILITY_TAKE)
        r = keep_frame(camera, frame, thumbnail, GSN_SUBJECT_PANEL, place, err);
    if (r < 0)
        camera->rest = before; /* the next frame is tried in its place */
    return r;
}

/* Only a lack of memory and an unplugged camera are failures; what else happens to a frame is said
 * once, and the next one is tried. */
static int note_failure(struct camera *camera, int code, const struct gsn_error *why,
                        struct gsn_error *err)
{
    if (code == GSN_E_NOMEM)
        return gsn_fail(err, code, "%s", why->text);
    if (code == GSN_E_NOTFOUND) {
        camera->gone = true;
        camera->why = *why;
        set_notice(camera, why->text);
    } else if (strcmp(camera->refused, why->text) != 0) {
        (void)snprintf(camera->refused, sizeof camera->refused, "%s", why->text);
        set_notice(camera, why->text);
    }
    return GSN_OK;
}

static int take_frames(struct camera *camera, unsigned *ret_count, struct gsn_error *err)
{
    const struct gsn_grabber *const grabber = &camera->grabber;
    int there = 1, r = GSN_OK;

    *ret_count = 0;
    while (r >= 0 && there && *ret_count < MOST_FRAMES) {
        struct gsn_frame frame = { 0 };
        struct gsn_error why = { 0 };

        there = 0;
        r = grabber->ops->grab(grabber->self, &frame, &there, &why);
        if (r >= 0 && there) {
            ++*ret_count;
            r = look_at_frame(camera, &frame, &why);
            grabber->ops->release(grabber->self);
        }
        if (r < 0)
            r = note_failure(camera, r, &why, err);
    }
    camera->damaged += grabber->ops->damaged(grabber->self);
    return r;
}

static int begin_anew(struct camera *camera, struct gsn_error *err)
{
    const struct gsn_grabber *const grabber = &camera->grabber;
    struct gsn_error why = { 0 };
    char sentence[200];
    int r;

    (void)snprintf(sentence, sizeof sentence,
                   "no whole frame came for %lld s (%u were damaged); the stream is begun anew "
                   "until one comes",
                   (long long)(camera->settings.silence_ms / 1000), camera->damaged);
    if (!camera->silent)
        set_notice(camera, sentence);
    camera->silent = true;
    grabber->ops->stop(grabber->self);
    r = grabber->ops->start(grabber->self, &why);
    if (r >= 0 || r == GSN_E_NOMEM)
        return r < 0 ? gsn_fail(err, r, "%s", why.text) : r;
    /* Some drivers stay in a stream that failed until their node is closed: whoever serves this
     * source opens it anew. */
    return note_failure(camera, GSN_E_NOTFOUND, &why, err);
}

static int watch_silence(struct camera *camera, unsigned frames, int64_t now_ms,
                         struct gsn_error *err)
{
    camera->idle = frames ? 0 : camera->idle + 1;
    if (frames || camera->last_frame_ms < 0) {
        camera->silent = camera->silent && !frames;
        camera->last_frame_ms = now_ms;
        return GSN_OK;
    }
    if (camera->gone || now_ms - camera->last_frame_ms < camera->settings.silence_ms)
        return GSN_OK;
    camera->last_frame_ms = now_ms;
    return begin_anew(camera, err);
}

static int emit_item(const struct item *item, struct gsn_source_events *events,
                     struct gsn_error *err)
{
    const struct gsn_source_event event = { .what = GSN_SOURCE_READY,
                                            .item = item->number,
                                            .name = item->name,
                                            .reason = "",
                                            .size = item->size,
                                            .subject = item->subject,
                                            .facts = item->facts };

    return gsn_source_emit(events, &event, err);
}

/* Items in the order in which they were taken: numbers go up, places do not. */
static int emit_items(const struct camera *camera, struct gsn_source_events *events,
                      struct gsn_error *err)
{
    uint64_t told = 0;

    for (;;) {
        const struct item *next = NULL;
        int r;

        for (size_t i = 0; i < MOST_ITEMS; i++) {
            const struct item *const item = &camera->item[i];

            if (item->number > told && (!next || item->number < next->number))
                next = item;
        }
        if (!next)
            return GSN_OK;
        r = emit_item(next, events, err);
        if (r < 0)
            return r;
        told = next->number;
    }
}

static int emit_events(struct camera *camera, struct gsn_source_events *events,
                       struct gsn_error *err)
{
    const struct gsn_source_event notice = { .what = GSN_SOURCE_NOTICE,
                                             .name = "camera",
                                             .reason = camera->notice };
    int r = camera->notice[0] ? gsn_source_emit(events, &notice, err) : GSN_OK;

    if (r >= 0)
        r = emit_items(camera, events, err);
    if (r >= 0)
        camera->notice[0] = '\0';
    return r;
}

int gsn_camera_poll(void *self, int64_t now_ms, struct gsn_source_events *events, int *ret_ended,
                    struct gsn_error *err)
{
    struct camera *const camera = self;
    unsigned frames = 0;
    int r = camera->gone ? GSN_OK : take_frames(camera, &frames, err);

    if (r >= 0)
        r = watch_silence(camera, frames, now_ms, err);
    if (r >= 0)
        r = emit_events(camera, events, err);
    if (r < 0)
        return r;
    *ret_ended = 0;
    for (size_t i = 0; i < MOST_ITEMS; i++) {
        if (camera->item[i].number)
            return GSN_OK;
    }
    return camera->gone ? gsn_fail(err, GSN_E_NOTFOUND, "%s", camera->why.text) : GSN_OK;
}

static struct item *find_item(struct camera *camera, uint64_t number)
{
    for (size_t i = 0; number && i < MOST_ITEMS; i++) {
        if (camera->item[i].number == number)
            return &camera->item[i];
    }
    return NULL;
}

int gsn_camera_read(void *self, uint64_t item, uint64_t offset, void *buffer, size_t size,
                    size_t *ret_got, struct gsn_error *err)
{
    const struct item *const kept = find_item(self, item);
    size_t left;

    if (!kept)
        return gsn_source_no_item(item, err);
    left = offset < kept->size ? kept->size - (size_t)offset : 0;
    *ret_got = left < size ? left : size;
    if (*ret_got)
        memcpy(buffer, kept->bytes + offset, *ret_got);
    return GSN_OK;
}

int gsn_camera_acknowledge(void *self, uint64_t item, struct gsn_error *err)
{
    struct item *const kept = find_item(self, item);

    if (!kept)
        return gsn_source_no_item(item, err);
    clear_item(kept);
    return GSN_OK;
}

int gsn_camera_wait(void *self, int timeout_ms, int stop_fd, struct gsn_error *err)
{
    struct camera *const camera = self;
    struct pollfd stop = { .fd = stop_fd, .events = POLLIN };
    /* Some drivers' poll() is always ready: then this is what keeps the processor free. */
    const bool hasty = camera->idle > 1 && timeout_ms != 0;
    const int first = timeout_ms < 0 || timeout_ms > PATIENCE_MS ? PATIENCE_MS : timeout_ms;
    int ready = 0;

    if (camera->gone || hasty)
        ready = poll(&stop, 1, camera->gone ? timeout_ms : first);
    if (ready < 0 && errno != EINTR)
        return gsn_fail(err, GSN_E_IO, "waiting: %s", strerror(errno));
    if (camera->gone || ready != 0)
        return GSN_OK;
    if (hasty && timeout_ms > 0)
        timeout_ms -= first;
    return camera->grabber.ops->wait(camera->grabber.self, timeout_ms, stop_fd, err);
}

int gsn_camera_capture(void *self, enum gsn_source_subject subject, struct gsn_error *err)
{
    struct camera *const camera = self;

    if (camera->gone)
        return gsn_fail(err, GSN_E_NOTFOUND, "%s", camera->why.text);
    if (camera->wanted)
        return gsn_fail(err, GSN_E_BUSY, "the picture asked for before (%s) has not come yet",
                        gsn_frame_subject(camera->subject));
    camera->wanted = true;
    camera->subject = subject;
    camera->stale = camera->grabber.depth;
    return GSN_OK;
}

const char *gsn_camera_device(const void *self)
{
    const struct camera *const camera = self;

    return camera->grabber.ops->device(camera->grabber.self);
}

void gsn_camera_close(void *self)
{
    struct camera *const camera = self;

    if (!camera)
        return;
    camera->grabber.ops->stop(camera->grabber.self);
    camera->grabber.ops->close(camera->grabber.self);
    for (size_t i = 0; i < MOST_ITEMS; i++)
        clear_item(&camera->item[i]);
    gsn_free(camera);
}

/* What was taken before this process began: it may lie on the stage still. */
static void recall_scenes(struct camera *camera, const struct gsn_source_options *options)
{
    struct gsn_thumbnail thumbnail;

    for (int subject = 0; subject < GSN_SUBJECTS; subject++) {
        if (gsn_thumbnail_read(options->last_facts[subject], &thumbnail))
            gsn_stability_know(&camera->rest, (enum gsn_source_subject)subject, &thumbnail);
    }
}

int gsn_camera_new(struct gsn_grabber grabber, const struct gsn_camera_settings *settings,
                   const struct gsn_source_options *options, void **ret_self, struct gsn_error *err)
{
    struct camera *const camera = gsn_alloc_array(1, sizeof *camera);
    int r;

    if (!camera) {
        grabber.ops->close(grabber.self);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a camera");
    }
    camera->grabber = grabber;
    camera->settings = *settings;
    camera->rest = gsn_stability_begin(settings->at_rest, settings->noise);
    recall_scenes(camera, options);
    camera->last_frame_ms = -1;
    r = grabber.ops->start(grabber.self, err);
    if (r < 0) {
        gsn_camera_close(camera);
        return r;
    }
    *ret_self = camera;
    return GSN_OK;
}
