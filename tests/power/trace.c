/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/power/trace.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"

static void give_up(const char *path, const char *why)
{
    fprintf(stderr, "%s: %s\n", path, why);
    exit(70);
}

static char *text_of(const uint8_t *bytes, size_t size)
{
    char *const text = gsn_alloc(size + 1);

    if (!text)
        abort();
    memcpy(text, bytes, size);
    text[size] = '\0';
    return text;
}

/* Returns where the next one begins. */
static const uint8_t *read_step(const uint8_t *at, const uint8_t *end, struct power_step *step)
{
    struct power_record record;

    if ((size_t)(end - at) < sizeof record)
        return NULL;
    memcpy(&record, at, sizeof record);
    at += sizeof record;
    if ((uint64_t)(end - at) < record.data + record.name + record.other)
        return NULL;
    *step = (struct power_step){ .op = record.op,
                                 .mode = record.mode,
                                 .inode = record.inode,
                                 .offset = record.offset,
                                 .size = record.data,
                                 .name = text_of(at, record.name),
                                 .other = text_of(at + record.name, record.other),
                                 .data = at + record.name + record.other };
    return step->data + record.data;
}

struct power_trace power_trace_read(const char *path)
{
    struct power_trace trace = { 0 };
    struct gsn_error err = { 0 };
    size_t size = 0, room = 0;

    if (gsn_file_read(path, SIZE_MAX / 2, &trace.bytes, &size, &err) < 0)
        give_up(path, err.text);
    for (const uint8_t *at = trace.bytes, *const end = at + size; at < end;) {
        if (trace.count == room) {
            room = room ? 2 * room : 1024;
            trace.at = gsn_realloc_array(trace.at, room, sizeof *trace.at);
            if (!trace.at)
                abort();
        }
        at = read_step(at, end, &trace.at[trace.count]);
        if (!at)
            give_up(path, "the trace ends within a record");
        trace.count++;
    }
    return trace;
}

void power_trace_done(struct power_trace *trace)
{
    for (size_t i = 0; i < trace->count; i++) {
        gsn_free(trace->at[i].name);
        gsn_free(trace->at[i].other);
    }
    gsn_free(trace->at);
    gsn_free(trace->bytes);
}
