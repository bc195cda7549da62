/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One line of the service's log: to the journal as fields (systemd.journal-fields(7)) when stderr
 * is the journal, else as a line on stderr.
 *
 * Whether it is the journal is told by $JOURNAL_STREAM, which names the device and inode of the
 * stream. Names come from devices and strangers' disks: what a terminal would obey, or what would
 * begin a line of its own, is shown as '?'. Logging never fails; what cannot be written is lost. */
#include "systemd/service/log.h"

#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <systemd/sd-journal.h>

enum { MOST_FIELDS = 6, MOST_FIELD = 1024 };

/* JOURNAL_STREAM names the device and inode of what systemd connected us with. */
static bool is_journal(void)
{
    const char *const stream = getenv("JOURNAL_STREAM");
    char here[64];
    struct stat st;

    if (!stream || fstat(2, &st) < 0)
        return false;
    (void)snprintf(here, sizeof here, "%llu:%llu", (unsigned long long)st.st_dev,
                   (unsigned long long)st.st_ino);
    return strcmp(stream, here) == 0;
}

struct fields {
    int count;
    char text[MOST_FIELDS][MOST_FIELD];
};

static void add_field(struct fields *fields, const char *name, const char *value)
{
    if (value && value[0])
        (void)snprintf(fields->text[fields->count++], MOST_FIELD, "%s=%s", name, value);
}

static int send_fields(const struct fields *fields)
{
    struct iovec parts[MOST_FIELDS];

    for (int i = 0; i < fields->count; i++)
        parts[i] = (struct iovec){ (void *)(uintptr_t)fields->text[i], strlen(fields->text[i]) };
    return sd_journal_sendv(parts, fields->count);
}

/* Names come from devices and strangers' disks: what a terminal would obey, or what would begin a
 * line of its own, is shown as '?'. */
static void tame_text(char *text)
{
    unsigned char *at = (unsigned char *)text;

    for (; *at; at++) {
        const int is_c1 = at[0] == 0xc2 && at[1] >= 0x80 && at[1] < 0xa0; /* in UTF-8 */

        if (is_c1)
            at[1] = '?';
        if (is_c1 || *at < ' ' || *at == 0x7f)
            *at = '?';
    }
}

void gsn_log(int priority, const struct gsn_log_about *about, const char *format, ...)
{
    const bool to_journal = is_journal();
    struct fields fields = { 0 };
    char message[900], number[24];
    va_list arguments;

    va_start(arguments, format);
    (void)vsnprintf(message, sizeof message, format, arguments);
    va_end(arguments);
    tame_text(message);
    if (to_journal) {
        (void)snprintf(number, sizeof number, "%d", priority);
        add_field(&fields, "MESSAGE", message);
        add_field(&fields, "PRIORITY", number);
        if (about) {
            add_field(&fields, "MESSAGE_ID", about->id);
            add_field(&fields, "GIESON_SOURCE", about->source);
            add_field(&fields, "GIESON_SPECIMEN", about->specimen);
            (void)snprintf(number, sizeof number, "%lld", (long long)about->scan);
            add_field(&fields, "GIESON_SCAN", about->scan ? number : "");
        }
        if (send_fields(&fields) >= 0)
            return;
    }
    /* journald reads the priority in front; people do not. */
    if (to_journal)
        (void)fprintf(stderr, "<%d>", priority);
    (void)fprintf(stderr, "%s%s%s\n",
                  about && about->source && about->source[0] ? about->source : "",
                  about && about->source && about->source[0] ? ": " : "", message);
}
