/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/v4l2.h"

#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* What must not change by itself. The first value control a camera has is the one used; an optional
 * row counts only where the camera has the automatic. */
static const struct row {
    const char *name;
    uint32_t automatic;
    int32_t off;
    struct {
        uint32_t control;
        const char *unit;
    } value[2];
    bool optional;
    bool of_raw; /* bears on raw samples, too */
} rows[] = {
    { "exposure",
      V4L2_CID_EXPOSURE_AUTO,
      V4L2_EXPOSURE_MANUAL,
      { { V4L2_CID_EXPOSURE_ABSOLUTE, "x 100 us" }, { V4L2_CID_EXPOSURE, "" } },
      false,
      true },
    { "gain",
      V4L2_CID_AUTOGAIN,
      0,
      { { V4L2_CID_GAIN, "" }, { V4L2_CID_ANALOGUE_GAIN, "" } },
      false,
      true },
    { "white balance",
      V4L2_CID_AUTO_WHITE_BALANCE,
      0,
      { { V4L2_CID_WHITE_BALANCE_TEMPERATURE, "K" } },
      false,
      false },
    { "brightness", V4L2_CID_AUTOBRIGHTNESS, 0, { { V4L2_CID_BRIGHTNESS, "" } }, true, true },
    { "hue", V4L2_CID_HUE_AUTO, 0, { { V4L2_CID_HUE, "" } }, true, false },
};

static int64_t asked_for(const struct gsn_v4l2 *v4l2, const struct row *row)
{
    const int64_t asked[] = { v4l2->settings.exposure, v4l2->settings.gain,
                              v4l2->settings.white_balance };
    const size_t i = (size_t)(row - rows);

    return i < 3 ? asked[i] : -1;
}

__attribute__((format(printf, 2, 3))) static void unlock(struct gsn_v4l2_lock *lock,
                                                         const char *format, ...)
{
    va_list args;

    va_start(args, format);
    (void)vsnprintf(lock->unlock, sizeof lock->unlock, format, args);
    va_end(args);
}

static bool query(const struct gsn_v4l2 *v4l2, uint32_t id, struct v4l2_queryctrl *ret_control)
{
    *ret_control = (struct v4l2_queryctrl){ .id = id };
    return id && gsn_v4l2_ioctl(v4l2, VIDIOC_QUERYCTRL, ret_control) == 0 &&
           !(ret_control->flags & V4L2_CTRL_FLAG_DISABLED);
}

static bool get(const struct gsn_v4l2 *v4l2, uint32_t id, int32_t *ret_value)
{
    struct v4l2_control control = { .id = id };

    if (gsn_v4l2_ioctl(v4l2, VIDIOC_G_CTRL, &control) < 0)
        return false;
    *ret_value = control.value;
    return true;
}

static bool set(const struct gsn_v4l2 *v4l2, uint32_t id, int32_t value)
{
    struct v4l2_control control = { .id = id, .value = value };

    return gsn_v4l2_ioctl(v4l2, VIDIOC_S_CTRL, &control) == 0;
}

/* Why a control cannot be set, before anybody tries; NULL: it can. */
static const char *obstacle(const struct v4l2_queryctrl *control)
{
    if (control->flags & V4L2_CTRL_FLAG_GRABBED)
        return "held by another program or by the stream";
    if (control->flags & V4L2_CTRL_FLAG_READ_ONLY)
        return "read-only";
    if (control->flags & V4L2_CTRL_FLAG_INACTIVE)
        return "inactive: another control governs it";
    return NULL;
}

static void switch_off(const struct gsn_v4l2 *v4l2, struct gsn_v4l2_lock *lock)
{
    struct v4l2_queryctrl control;
    int32_t value = 0;

    (void)query(v4l2, lock->automatic, &control);
    if (get(v4l2, lock->automatic, &value) && value == lock->off)
        return;
    if (obstacle(&control))
        unlock(lock, "its automatic cannot be switched off (%s)", obstacle(&control));
    else if (!set(v4l2, lock->automatic, lock->off))
        unlock(lock, "its automatic cannot be switched off (%s)",
               errno == EBUSY ? "held by another program or by the stream" : strerror(errno));
    else if (!get(v4l2, lock->automatic, &value) || value != lock->off)
        unlock(lock, "its automatic was switched off, but reads on");
}

static int set_value(const struct gsn_v4l2 *v4l2, struct gsn_v4l2_lock *lock, int64_t asked,
                     const struct v4l2_queryctrl *control, struct gsn_error *err)
{
    int32_t value = 0;

    if (asked >= 0 && (asked < control->minimum || asked > control->maximum))
        return gsn_fail(err, GSN_E_INPUT, "%.60s: %s %lld was asked for, it goes from %d to %d",
                        v4l2->device, lock->name, (long long)asked, control->minimum,
                        control->maximum);
    if (lock->unlock[0])
        return GSN_OK; /* the automatic would change it again */
    if (control->flags & V4L2_CTRL_FLAG_INACTIVE)
        unlock(lock, "%s", obstacle(control));
    else if (asked >= 0 && obstacle(control))
        unlock(lock, "its value cannot be set (%s)", obstacle(control));
    else if (asked >= 0 && !set(v4l2, lock->control, (int32_t)asked))
        unlock(lock, "its value cannot be set (%s)", strerror(errno));
    else if (control->flags & V4L2_CTRL_FLAG_VOLATILE)
        unlock(lock, "its value changes by itself");
    else if (asked >= 0 && (!get(v4l2, lock->control, &value) || value != asked))
        unlock(lock, "it was set to %lld and reads %d", (long long)asked, value);
    return GSN_OK;
}

static int lock_row(struct gsn_v4l2 *v4l2, const struct row *row, struct gsn_error *err)
{
    struct gsn_v4l2_lock *const lock = &v4l2->lock[v4l2->lock_count];
    struct v4l2_queryctrl automatic, control = { 0 };
    const bool has_automatic = query(v4l2, row->automatic, &automatic);
    int32_t value = 0;
    int r = GSN_OK;

    if (row->optional && !has_automatic)
        return GSN_OK;
    *lock = (struct gsn_v4l2_lock){ .name = row->name, .unit = "", .off = row->off };
    lock->automatic = has_automatic ? row->automatic : 0;
    v4l2->lock_count++;
    if (has_automatic)
        switch_off(v4l2, lock);
    for (size_t i = 0; i < 2 && !lock->control; i++) {
        if (!query(v4l2, row->value[i].control, &control))
            continue;
        lock->control = row->value[i].control;
        lock->unit = row->value[i].unit;
    }
    if (lock->control)
        r = set_value(v4l2, lock, asked_for(v4l2, row), &control, err);
    else if (!lock->unlock[0])
        unlock(lock, "the camera has no control for it");
    lock->is_known = lock->control && get(v4l2, lock->control, &value);
    lock->value = value;
    if (lock->control && !lock->is_known && !lock->unlock[0])
        unlock(lock, "its value cannot be read back");
    return r;
}

int gsn_v4l2_lock_controls(struct gsn_v4l2 *v4l2, struct gsn_error *err)
{
    const bool raw = gsn_pixel_format_is_raw(v4l2->settings.format);
    int r = GSN_OK;

    v4l2->lock_count = 0;
    for (size_t i = 0; i < sizeof rows / sizeof rows[0] && r >= 0; i++) {
        if (!raw || rows[i].of_raw)
            r = lock_row(v4l2, &rows[i], err);
    }
    return r;
}

/* What a control says now, and whether that is what was locked. */
static bool look_again(const struct gsn_v4l2 *v4l2, const struct gsn_v4l2_lock *lock,
                       struct gsn_frame_control *ret_control, char *unlocked, size_t size)
{
    int32_t value = 0, automatic = lock->off;

    (void)snprintf(unlocked, size, "%s", lock->unlock);
    *ret_control = (struct gsn_frame_control){ .name = lock->name, .unit = lock->unit };
    if (lock->control) {
        ret_control->is_known = get(v4l2, lock->control, &value);
        ret_control->value = value;
        if (!ret_control->is_known && errno == ENODEV)
            return false;
    }
    if (!unlocked[0] && lock->automatic &&
        (!get(v4l2, lock->automatic, &automatic) || automatic != lock->off))
        (void)snprintf(unlocked, size, "its automatic was switched on again");
    else if (!unlocked[0] && !ret_control->is_known)
        (void)snprintf(unlocked, size, "its value cannot be read back");
    else if (!unlocked[0] && value != lock->value)
        (void)snprintf(unlocked, size, "it reads %d where %lld was locked", value,
                       (long long)lock->value);
    ret_control->unlock = unlocked[0] ? unlocked : NULL;
    return true;
}

int gsn_v4l2_read_back(struct gsn_v4l2 *v4l2, struct gsn_frame *frame, struct gsn_error *err)
{
    size_t used = 0;

    v4l2->withheld[0] = '\0';
    for (size_t i = 0; i < v4l2->lock_count; i++) {
        if (!look_again(v4l2, &v4l2->lock[i], &v4l2->control[i], v4l2->unlock[i],
                        sizeof v4l2->unlock[i]))
            return gsn_v4l2_refused(v4l2, "reading the controls back", err);
        if (v4l2->control[i].unlock && used < sizeof v4l2->withheld)
            used += (size_t)snprintf(v4l2->withheld + used, sizeof v4l2->withheld - used,
                                     "%s%s is not locked: %s", used ? "; " : "", v4l2->lock[i].name,
                                     v4l2->control[i].unlock);
    }
    frame->control = v4l2->control;
    frame->control_count = v4l2->lock_count;
    frame->withheld = v4l2->withheld[0] ? v4l2->withheld : NULL;
    return GSN_OK;
}
