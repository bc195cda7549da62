/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/camera.h"

#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>

#include "acquire/rest.h"

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
    struct gsn_rest rest;
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

static void say(struct camera *camera, const char *sentence)
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

static void empty(struct item *item)
{
    gsn_free(item->bytes);
    gsn_free(item->facts);
    *item = (struct item){ 0 };
}

/* Keeps the frame in a free place, with the controls as they are read back now; from then on the
 * scene is known. thumbnail NULL: the frame tells none. */
static int keep(struct camera *camera, struct gsn_frame *frame,
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
        empty(item);
        return r;
    }
    if (thumbnail)
        gsn_rest_know(&camera->rest, subject, thumbnail);
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
    r = keep(camera, frame, thumbnail, camera->subject, place, err);
    if (r < 0)
        return r;
    camera->wanted = false;
    return GSN_OK;
}

static int look(struct camera *camera, struct gsn_frame *frame, struct gsn_error *err)
{
    const struct gsn_rest before = camera->rest;
    struct item *const place = free_place(camera);
    struct gsn_thumbnail made;
    const struct gsn_thumbnail *thumbnail;
    int r = GSN_OK;

    if (!place && !camera->full)
        say(camera, "pictures wait to be taken over; no more are taken until then");
    camera->full = !place;
    if (!place)
        return GSN_OK;
    if (!camera->wanted && !camera->settings.at_rest)
        return GSN_OK;
    thumbnail = gsn_thumbnail_make(frame, &made) ? &made : NULL;
    if (camera->wanted)
        return serve_request(camera, frame, thumbnail, place, err);
    if (thumbnail && gsn_rest_look(&camera->rest, thumbnail) == GSN_REST_TAKE)
        r = keep(camera, frame, thumbnail, GSN_SUBJECT_PANEL, place, err);
    if (r < 0)
        camera->rest = before; /* the next frame is tried in its place */
    return r;
}

/* Only a lack of memory and an unplugged camera are failures; what else happens to a frame is said
 * once, and the next one is tried. */
static int bear(struct camera *camera, int code, const struct gsn_error *why, struct gsn_error *err)
{
    if (code == GSN_E_NOMEM)
        return gsn_fail(err, code, "%s", why->text);
    if (code == GSN_E_NOTFOUND) {
        camera->gone = true;
        camera->why = *why;
        say(camera, why->text);
    } else if (strcmp(camera->refused, why->text) != 0) {
        (void)snprintf(camera->refused, sizeof camera->refused, "%s", why->text);
        say(camera, why->text);
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
            r = look(camera, &frame, &why);
            grabber->ops->release(grabber->self);
        }
        if (r < 0)
            r = bear(camera, r, &why, err);
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
        say(camera, sentence);
    camera->silent = true;
    grabber->ops->stop(grabber->self);
    r = grabber->ops->start(grabber->self, &why);
    if (r >= 0 || r == GSN_E_NOMEM)
        return r < 0 ? gsn_fail(err, r, "%s", why.text) : r;
    /* Some drivers stay in a stream that failed until their node is closed: whoever serves this
     * source opens it anew. */
    return bear(camera, GSN_E_NOTFOUND, &why, err);
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

static int tell_item(const struct item *item, struct gsn_source_events *events,
                     struct gsn_error *err)
{
    const struct gsn_source_event event = { .what = GSN_SOURCE_READY,
                                            .item = item->number,
                                            .name = item->name,
                                            .reason = "",
                                            .size = item->size,
                                            .subject = item->subject,
                                            .facts = item->facts };

    return gsn_source_tell(events, &event, err);
}

/* Items in the order in which they were taken: numbers go up, places do not. */
static int tell_items(const struct camera *camera, struct gsn_source_events *events,
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
        r = tell_item(next, events, err);
        if (r < 0)
            return r;
        told = next->number;
    }
}

static int tell(struct camera *camera, struct gsn_source_events *events, struct gsn_error *err)
{
    const struct gsn_source_event notice = { .what = GSN_SOURCE_NOTICE,
                                             .name = "camera",
                                             .reason = camera->notice };
    int r = camera->notice[0] ? gsn_source_tell(events, &notice, err) : GSN_OK;

    if (r >= 0)
        r = tell_items(camera, events, err);
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
        r = tell(camera, events, err);
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

static int no_item(uint64_t item, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOTFOUND, "item %llu is not ready", (unsigned long long)item);
}

int gsn_camera_read(void *self, uint64_t item, uint64_t offset, void *buffer, size_t size,
                    size_t *ret_got, struct gsn_error *err)
{
    const struct item *const kept = find_item(self, item);
    size_t left;

    if (!kept)
        return no_item(item, err);
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
        return no_item(item, err);
    empty(kept);
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
        empty(&camera->item[i]);
    gsn_free(camera);
}

/* What was taken before this process began: it may lie on the stage still. */
static void remember(struct camera *camera, const struct gsn_source_options *options)
{
    struct gsn_thumbnail thumbnail;

    for (int subject = 0; subject < GSN_SUBJECTS; subject++) {
        if (gsn_thumbnail_read(options->last_facts[subject], &thumbnail))
            gsn_rest_know(&camera->rest, (enum gsn_source_subject)subject, &thumbnail);
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
    camera->rest = gsn_rest_begin(settings->at_rest, settings->noise);
    remember(camera, options);
    camera->last_frame_ms = -1;
    r = grabber.ops->start(grabber.self, err);
    if (r < 0) {
        gsn_camera_close(camera);
        return r;
    }
    *ret_self = camera;
    return GSN_OK;
}
