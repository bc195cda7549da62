/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/config_parts.h"

#include <ctype.h>
#include <stdio.h>
#include <string.h>

enum { SETTLE_MS = 1500, PATIENCE_S = 60, MOST_FOLDER = 180 };

const struct gsn_config_source *gsn_config_find(const struct gsn_config *config, const char *name)
{
    for (size_t i = 0; i < config->source_count; i++)
        if (strcmp(config->source[i].name, name) == 0)
            return &config->source[i];
    return NULL;
}

int gsn_config_new_source(struct gsn_config *config, const char *name,
                          struct gsn_config_source **ret_source, struct gsn_error *err)
{
    struct gsn_config_source *more =
        gsn_realloc_array(config->source, config->source_count + 1, sizeof *more);
    struct gsn_config_source *source;

    if (!more)
        return gsn_config_no_memory(err);
    config->source = more;
    source = &more[config->source_count];
    *source = (struct gsn_config_source){ .name = gsn_strdup(name),
                                          .address = gsn_strdup(""),
                                          .specimen = gsn_strdup(""),
                                          .settle_ms = SETTLE_MS,
                                          .patience_s = PATIENCE_S };
    config->source_count++;
    if (!source->name || !source->address || !source->specimen)
        return gsn_config_no_memory(err);
    *ret_source = source;
    return GSN_OK;
}

/* The folder's own name, with what no source's name may hold made '-'. */
static void name_of_folder(const char *folder, unsigned number, char name[GSN_CONFIG_NAME + 1])
{
    size_t end = strlen(folder), begin, length = 0;

    while (end > 1 && folder[end - 1] == '/')
        end--;
    for (begin = end; begin > 0 && folder[begin - 1] != '/';)
        begin--;
    for (size_t i = begin; i < end && length < GSN_CONFIG_NAME - 8; i++)
        name[length++] = folder[i];
    name[length] = '\0';
    for (size_t i = 0; i < length; i++)
        if (!isalnum((unsigned char)name[i]) && (!strchr("-_.", name[i]) || i == 0))
            name[i] = '_';
    if (length == 0)
        length = (size_t)snprintf(name, GSN_CONFIG_NAME, "folder");
    if (number > 1)
        (void)snprintf(name + length, GSN_CONFIG_NAME - length, "-%u", number);
}

int gsn_config_add_folder(struct gsn_config *config, const char *folder, struct gsn_error *err)
{
    char name[GSN_CONFIG_NAME + 1];
    gsn_auto_mem(char) address = gsn_format("hot:%s", folder);
    struct gsn_config_source *source;
    unsigned number = 1;
    int r;

    if (!address)
        return gsn_config_no_memory(err);
    /* What is written for the source's own process must be read back as it is. */
    if (strlen(folder) > MOST_FOLDER || strchr(folder, '\n') || strstr(folder, " ;"))
        return gsn_fail(err, GSN_E_INPUT,
                        "%.200s cannot be watched: a path of at most %d bytes without line breaks "
                        "and \" ;\" can",
                        folder, MOST_FOLDER);
    name_of_folder(folder, number, name);
    while (gsn_config_find(config, name))
        name_of_folder(folder, ++number, name);
    r = gsn_config_new_source(config, name, &source, err);
    if (r < 0)
        return r;
    source->sweep_s = GSN_FOLDER_SWEEP_S;
    return gsn_config_set_text(&source->address, address, err);
}

int gsn_config_write_source(const struct gsn_config *config, const struct gsn_config_source *source,
                            char **ret_text, struct gsn_error *err)
{
    gsn_auto_mem(char) text = gsn_format(
        "[store]\nReserveMiB=%llu\n[source %s]\nAddress=%s\nSettleMs=%lld\nPatienceS=%lld\n"
        "SweepS=%lld\nDeleteAfterCopy=%s\nSpecimen=%s\n",
        (unsigned long long)(config->reserve_bytes / GSN_MIB), source->name, source->address,
        (long long)source->settle_ms, (long long)source->patience_s, (long long)source->sweep_s,
        source->delete_after_copy ? "yes" : "no", source->specimen);

    for (size_t i = 0; text && i < source->setting_count; i++) {
        char *const more =
            gsn_format("%s%s=%s\n", text, source->setting[i].key, source->setting[i].value);

        gsn_free(text);
        text = more;
    }
    if (!text)
        return gsn_config_no_memory(err);
    *ret_text = gsn_steal(&text);
    return GSN_OK;
}
