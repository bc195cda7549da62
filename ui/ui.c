/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/ui.h"

#include "pipeline/core/process.h"
#include "ui/text.h"

#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sysexits.h>
#include <time.h>

char *gsn_ui_advice(const struct gsn_ui *ui, const char *text)
{
    static const char ours[] = "gieson ";
    gsn_auto_mem(char) store = gsn_text_word(ui->store_dir ? ui->store_dir : "");
    gsn_auto_mem(char) said = NULL;

    if (!ui->store_said || !store)
        return gsn_strdup(text);
    for (const char *at = text; *at;) {
        const char *next = strstr(at, ours);
        /* A command begins the text, or stands in backquotes. */
        const int is_command = next && (next == text || next[-1] == '`');
        const size_t length = next ? (size_t)(next - at) + strlen(ours) : strlen(at);
        char *more = gsn_format("%s%.*s%s%s%s", said ? said : "", (int)length, at,
                                is_command ? "--store " : "", is_command ? store : "",
                                is_command ? " " : "");

        gsn_free(said);
        said = more;
        if (!said)
            return NULL;
        at += length;
    }
    return said ? gsn_steal(&said) : gsn_strdup("");
}

void gsn_ui_wrap(const struct gsn_ui *ui, int indent, const char *text)
{
    gsn_auto_mem(char) advice = gsn_ui_advice(ui, text);

    gsn_text_wrap(stdout, indent, ui->width, advice ? advice : text);
}

void gsn_ui_say(const struct gsn_ui *ui, const char *format, ...)
{
    gsn_auto_mem(char) advice = NULL;
    char text[512];
    va_list args;

    va_start(args, format);
    (void)vsnprintf(text, sizeof text, format, args);
    va_end(args);
    advice = gsn_ui_advice(ui, text);
    gsn_text_line(stdout, "%s", advice ? advice : "out of memory");
}

void gsn_ui_next(const struct gsn_ui *ui, const char *action, const char *behind)
{
    gsn_auto_mem(char) advice = gsn_ui_advice(ui, action);

    gsn_text_line(stdout, "    next: %s%s", advice ? advice : action, behind);
}

int gsn_ui_complain(const struct gsn_error *err, int code)
{
    gsn_text_line(stderr, "gieson: %s", err->text);
    return gsn_code_exit(code);
}

int gsn_ui_fail(int status, const char *format, ...)
{
    char sentence[512];
    va_list args;

    va_start(args, format);
    (void)vsnprintf(sentence, sizeof sentence, format, args);
    va_end(args);
    gsn_text_line(stderr, "gieson: %s", sentence);
    return status;
}

struct gsn_store *gsn_ui_store(const struct gsn_ui *ui, enum gsn_store_mode mode, int *ret_status)
{
    struct gsn_store *store = NULL;
    struct gsn_error err = { 0 };
    int r;

    if (!ui->store_dir || !ui->store_dir[0]) {
        *ret_status = gsn_ui_usage("no store: say --store DIR or set GIESON_STORE");
        return NULL;
    }
    r = gsn_store_open(ui->store_dir, mode, &store, &err);
    if (r < 0)
        *ret_status = gsn_ui_complain(&err, r);
    return store;
}

int gsn_ui_columns(int fd)
{
    struct winsize size;

    return ioctl(fd, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : 80;
}

json_t *gsn_ui_number(double value)
{
    return isnan(value) ? json_null() : json_real(value);
}

int gsn_ui_whole(const char *text, int64_t least, int64_t most, int64_t *ret_number)
{
    long long number;
    char *end;

    /* What strtoll() takes besides digits (blanks, signs) is no number of ours. */
    if (text[0] < '0' || text[0] > '9')
        return 0;
    errno = 0;
    number = strtoll(text, &end, 10);
    if (*end || errno || number < least || number > most)
        return 0;
    *ret_number = number;
    return 1;
}

void gsn_ui_pause_ms(long ms)
{
    const struct timespec time = { .tv_sec = ms / 1000, .tv_nsec = ms % 1000 * 1000000L };

    (void)nanosleep(&time, NULL);
}

void gsn_ui_print_json(json_t *root)
{
    (void)json_dumpf(root, stdout, JSON_INDENT(2) | JSON_REAL_PRECISION(9));
    (void)putchar('\n');
    json_decref(root);
}

pid_t gsn_ui_start(const struct gsn_ui *ui, const char *program, int with_store,
                   const char *const args[])
{
    gsn_auto_mem(char) path = NULL;
    gsn_auto_mem(const char *) argv = NULL;
    struct gsn_error err = { 0 };
    size_t given = 0, n = 0;
    pid_t child;
    int r = gsn_process_sibling(program, &path, &err);

    if (r < 0) {
        (void)gsn_ui_complain(&err, r);
        return -1;
    }
    while (args[given])
        given++;
    argv = gsn_alloc_array(given + 5, sizeof *argv);
    if (!argv)
        return -1;
    argv[n++] = path;
    if (with_store) {
        argv[n++] = "--store";
        argv[n++] = ui->store_dir;
    }
    if (with_store && ui->json)
        argv[n++] = "--json";
    memcpy(argv + n, args, given * sizeof *argv);
    r = gsn_process_start(argv, &child, &err);
    if (r >= 0)
        return child;
    (void)gsn_ui_complain(&err, r);
    return -1;
}

int gsn_ui_call(const struct gsn_ui *ui, const char *program, int with_store,
                const char *const args[])
{
    pid_t child;

    if (with_store && (!ui->store_dir || !ui->store_dir[0]))
        return gsn_ui_usage("no store: say --store DIR or set GIESON_STORE");
    child = gsn_ui_start(ui, program, with_store, args);
    return child < 0 ? EX_OSERR : gsn_process_wait(child, 1);
}
