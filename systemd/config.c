/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/config.h"

#include "systemd/config_parts.h"

static void source_done(struct gsn_config_source *source)
{
    for (size_t i = 0; i < source->setting_count; i++) {
        gsn_free((char *)source->setting[i].key);
        gsn_free((char *)source->setting[i].value);
    }
    gsn_free(source->setting);
    gsn_free(source->name);
    gsn_free(source->address);
    gsn_free(source->specimen);
}

void gsn_config_free(struct gsn_config *config)
{
    if (!config)
        return;
    for (size_t i = 0; i < config->source_count; i++)
        source_done(&config->source[i]);
    gsn_free(config->source);
    gsn_free(config->store_dir);
    gsn_free(config);
}

int gsn_config_no_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the configuration");
}

int gsn_config_set_text(char **to, const char *value, struct gsn_error *err)
{
    char *const copy = gsn_strdup(value);

    if (!copy)
        return gsn_config_no_memory(err);
    gsn_free(*to);
    *to = copy;
    return GSN_OK;
}

static int judge(struct gsn_config_reading *reading, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < reading->lines.count; i++)
        r = gsn_config_take_line(reading, i, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < reading->config->source_count; i++)
        gsn_config_judge_source(reading, i);
    if (reading->lines.mistakes == 0)
        return GSN_OK;
    return gsn_fail(err, GSN_E_INPUT, "the configuration has %zu mistake%s: %.390s",
                    reading->lines.mistakes, reading->lines.mistakes == 1 ? "" : "s",
                    reading->lines.first);
}

static void reading_done(struct gsn_config_reading *reading)
{
    gsn_config_lines_done(&reading->lines);
    gsn_config_free(reading->config);
    gsn_free(reading->seen);
}

int gsn_config_read(const char *path, const struct gsn_config_ear *ear,
                    struct gsn_config **ret_config, struct gsn_error *err)
{
    __attribute__((cleanup(reading_done))) struct gsn_config_reading reading = { .lines = {
                                                                                     .ear = ear } };
    int r;

    reading.config = gsn_alloc_array(1, sizeof *reading.config);
    if (!reading.config)
        return gsn_config_no_memory(err);
    *reading.config = (struct gsn_config){ .store_dir = gsn_strdup(""),
                                           .reserve_bytes = 256 * GSN_MIB,
                                           .workers = 1,
                                           .memory_mib = 8192,
                                           .minutes = 120 };
    if (!reading.config->store_dir)
        return gsn_config_no_memory(err);
    r = gsn_config_lines_read(path, &reading.lines, err);
    if (r >= 0)
        r = judge(&reading, err);
    if (r < 0)
        return r;
    *ret_config = gsn_steal(&reading.config);
    return GSN_OK;
}
