/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/config_parts.h"

#include "pipeline/core/nearest.h"

#include <stdbool.h>
#include <string.h>

enum { DEVICE_SWEEP_S = 10 };

static int judge_settings(const struct gsn_config_source *source, size_t from, size_t count,
                          struct gsn_error *err)
{
    const struct gsn_source_options options = { .settle_ms = source->settle_ms,
                                                .patience_ms = source->patience_s * 1000,
                                                .delete_there = source->delete_after_copy,
                                                .setting_count = count,
                                                .setting = source->setting + from };

    return gsn_source_check(source->address, &options, err);
}

static const struct gsn_config_line *line_of(const struct gsn_config_reading *reading,
                                             const struct gsn_config_source *source,
                                             const char *key)
{
    for (size_t i = reading->lines.count; i-- > 0;) {
        const struct gsn_config_line *const line = &reading->lines.at[i];

        if (line->key && strcmp(line->key, key) == 0 &&
            strncmp(line->section, "source ", strlen("source ")) == 0 &&
            strcmp(line->section + strlen("source "), source->name) == 0)
            return line;
    }
    return NULL;
}

/* Whether the sentence is about this setting: they begin with "Key=value". */
static bool is_about(const char *sentence, const char *key)
{
    const size_t length = strlen(key);

    return strncmp(sentence, key, length) == 0 && sentence[length] == '=';
}

/* Names the line of every setting that is wrong: of one that is wrong by itself, and of the one
 * that `whole` is about. What is said of no setting at all, `none`, is no setting's fault (a camera
 * needs several at once). True when there was one. */
static bool blame_settings(struct gsn_config_reading *reading,
                           const struct gsn_config_source *source, const char *none,
                           const char *whole)
{
    bool blamed = false;

    for (size_t i = 0; i < source->setting_count; i++) {
        const char *const key = source->setting[i].key;
        const struct gsn_config_line *const line = line_of(reading, source, key);
        const char *sentence = whole;
        struct gsn_error why = { 0 };

        if (judge_settings(source, i, 1, &why) < 0 && strcmp(why.text, none) != 0)
            sentence = why.text;
        else if (!is_about(whole, key))
            continue;
        if (!line)
            continue;
        gsn_config_mistake(&reading->lines, line->file, line->number, "%.380s", sentence);
        blamed = true;
    }
    return blamed;
}

/* Names the line of every key that is one slip away from one of ours. A kind's own keys are not
 * judged: without an address nobody knows the kind. True when there was one. */
static bool blame_spelling(struct gsn_config_reading *reading,
                           const struct gsn_config_source *source)
{
    static const char *const ours[] = { "Address",   "Specimen", "SettleMs",
                                        "PatienceS", "SweepS",   "DeleteAfterCopy" };
    bool blamed = false;

    for (size_t i = 0; i < source->setting_count; i++) {
        const char *const key = source->setting[i].key;
        const char *const near = gsn_nearest(key, ours, sizeof ours / sizeof ours[0]);
        const struct gsn_config_line *const line = line_of(reading, source, key);

        if (!near || !line)
            continue;
        gsn_config_mistake(&reading->lines, line->file, line->number,
                           "%s: there is no such key: did you mean %s?", key, near);
        blamed |= strcmp(near, "Address") == 0;
    }
    return blamed;
}

void gsn_config_judge_source(struct gsn_config_reading *reading, size_t i)
{
    struct gsn_config_source *const source = &reading->config->source[i];
    const struct gsn_config_seen *const seen = &reading->seen[i];
    struct gsn_error none = { 0 }, whole = { 0 };

    if (source->sweep_s == 0)
        source->sweep_s =
            gsn_source_subsystem(source->address) ? DEVICE_SWEEP_S : GSN_FOLDER_SWEEP_S;
    if (!seen->address) {
        if (blame_spelling(reading, source))
            return;
        gsn_config_mistake(&reading->lines, seen->heading->file, seen->heading->number,
                           "[source %s] has no Address", source->name);
        return;
    }
    if (judge_settings(source, 0, source->setting_count, &whole) >= 0)
        return;
    (void)judge_settings(source, 0, 0, &none);
    if (strcmp(none.text, whole.text) == 0)
        gsn_config_mistake(&reading->lines, seen->address->file, seen->address->number, "%.380s",
                           whole.text);
    else if (!blame_settings(reading, source, none.text, whole.text))
        gsn_config_mistake(&reading->lines, seen->heading->file, seen->heading->number,
                           "[source %s]: %.300s", source->name, whole.text);
}
