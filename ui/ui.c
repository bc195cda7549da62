/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What every verb of `gieson` shares: opening the store, words for people, starting a helper
 * program.
 *
 * Words go to stderr, wrapped to the terminal's width, with the store in the commands they advise
 * (storage/advice.h); data goes to stdout. A helper is a program beside this one; its exit status
 * is handed on. A mistake costs one line. */
#include "ui/ui.h"

#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sysexits.h>
#include <time.h>

#include "pipeline/core/process.h"
#include "storage/advice.h"
#include "ui/text.h"

void gsn_ui_wrap(const struct gsn_ui *ui, int indent, const char *text)
{
    gsn_auto_mem(char) advice = gsn_advice(ui->store_dir, text);

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
    advice = gsn_advice(ui->store_dir, text);
    gsn_text_line(stdout, "%s", advice ? advice : "out of memory");
}

void gsn_ui_next(const struct gsn_ui *ui, const char *action, const char *behind)
{
    gsn_auto_mem(char) advice = gsn_advice(ui->store_dir, action);

    gsn_text_line(stdout, "    next: %s%s", advice ? advice : action, behind);
}

static void say_failure(const struct gsn_ui *ui, const char *sentence)
{
    gsn_auto_mem(char) advice = gsn_advice(ui->store_dir, sentence);

    gsn_text_line(stderr, "gieson: %s", advice ? advice : sentence);
}

int gsn_ui_complain(const struct gsn_ui *ui, const struct gsn_error *err, int code)
{
    say_failure(ui, err->text);
    return gsn_code_exit(code);
}

int gsn_ui_fail(const struct gsn_ui *ui, int status, const char *format, ...)
{
    char sentence[512];
    va_list args;

    va_start(args, format);
    (void)vsnprintf(sentence, sizeof sentence, format, args);
    va_end(args);
    say_failure(ui, sentence);
    return status;
}

struct gsn_store *gsn_ui_store(const struct gsn_ui *ui, enum gsn_store_mode mode, int *ret_status)
{
    struct gsn_store *store = NULL;
    struct gsn_error err = { 0 };
    int r;

    if (!ui->store_dir || !ui->store_dir[0]) {
        *ret_status = gsn_ui_usage(ui, "no store: say --store DIR or set GIESON_STORE");
        return NULL;
    }
    r = gsn_store_open(ui->store_dir, mode, &store, &err);
    if (r < 0)
        *ret_status = gsn_ui_complain(ui, &err, r);
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

/* What people read in it advises as the screens do. */
static void advise_in(const struct gsn_ui *ui, json_t *node)
{
    static const char *const keys[] = { "action", "detail", "message", "reason" };
    const char *name;
    json_t *part;
    size_t i;

    json_array_foreach(node, i, part) advise_in(ui, part);
    json_object_foreach(node, name, part)
    {
        advise_in(ui, part);
        for (size_t k = 0; json_is_string(part) && k < sizeof keys / sizeof keys[0]; k++) {
            gsn_auto_mem(char) advice = strcmp(name, keys[k]) == 0
                                            ? gsn_advice(ui->store_dir, json_string_value(part))
                                            : NULL;

            if (advice)
                (void)json_string_set(part, advice);
        }
    }
}

void gsn_ui_print_json(const struct gsn_ui *ui, json_t *root)
{
    advise_in(ui, root);
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
        (void)gsn_ui_complain(ui, &err, r);
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
    (void)gsn_ui_complain(ui, &err, r);
    return -1;
}

int gsn_ui_call(const struct gsn_ui *ui, const char *program, int with_store,
                const char *const args[])
{
    pid_t child;

    if (with_store && (!ui->store_dir || !ui->store_dir[0]))
        return gsn_ui_usage(ui, "no store: say --store DIR or set GIESON_STORE");
    child = gsn_ui_start(ui, program, with_store, args);
    return child < 0 ? EX_OSERR : gsn_process_wait(child, 1);
}
