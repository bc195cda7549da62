/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/camera.h"

#include <errno.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "acquire/rest.h"

const char *const gsn_camera_keys[] = { "Format", "Width",        "Height", "Fps",   "Exposure",
                                        "Gain",   "WhiteBalance", "AtRest", "Noise", "SilenceS",
                                        NULL };

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
    int r = off ? GSN_OK : read_number(options, "AtRest", 2, GSN_REST_MOST_FRAMES, &frames, err);

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
