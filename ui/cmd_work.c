/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verbs that other programs do: import, verify, scrub, backup, restore, check, register, study,
 * plan, index, export, render, probe, line and integral are gieson-work's, phantom has a program of
 * its own, and the configuration is the service's. */
#include <string.h>

#include "ui/ui.h"

enum { MOST_MINUTES = 10000 };

static int pass_on(const struct gsn_ui *ui, const char *program, int with_store, int argc,
                   char **argv, int from)
{
    gsn_auto_mem(const char *) args = gsn_alloc_array((size_t)argc + 1, sizeof *args);

    if (!args)
        return gsn_ui_fail(ui, EX_OSERR, "out of memory");
    for (int i = from; i < argc; i++)
        args[i - from] = argv[i];
    return gsn_ui_call(ui, program, with_store, args);
}

int gsn_cmd_import(const struct gsn_ui *ui, int argc, char **argv)
{
    if (argc < 2)
        return gsn_ui_usage(ui, "import what? Say `gieson import FOLDER`");
    return pass_on(ui, "gieson-work", 1, argc, argv, 0);
}

int gsn_cmd_verify(const struct gsn_ui *ui, int argc, char **argv)
{
    const int journal = argc > 2 && strcmp(argv[1], "--journal") == 0;

    if (argc != (journal ? 4 : 2))
        return gsn_ui_usage(ui, "verify which run? Say `gieson verify RUN` or a specimen's name");
    return pass_on(ui, "gieson-work", 1, argc, argv, 0);
}

int gsn_cmd_backup(const struct gsn_ui *ui, int argc, char **argv)
{
    if (argc != 2)
        return gsn_ui_usage(ui, "backup where? Say `gieson backup FOLDER`, a new or an empty one");
    return pass_on(ui, "gieson-work", 1, argc, argv, 0);
}

int gsn_cmd_restore(const struct gsn_ui *ui, int argc, char **argv)
{
    if (argc != 2)
        return gsn_ui_usage(ui, "restore from where? Say `gieson --store NEW restore FOLDER`");
    return pass_on(ui, "gieson-work", 1, argc, argv, 0);
}

/* Those that need no store. */
static int pass_on_plain(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto_mem(const char *) args = gsn_alloc_array((size_t)argc + 2, sizeof *args);
    size_t n = 0;

    if (!args)
        return gsn_ui_fail(ui, EX_OSERR, "out of memory");
    if (ui->json)
        args[n++] = "--json";
    for (int i = 0; i < argc; i++)
        args[n++] = argv[i];
    return gsn_ui_call(ui, "gieson-work", 0, args);
}

int gsn_cmd_check(const struct gsn_ui *ui, int argc, char **argv)
{
    if (argc < 2)
        return gsn_ui_usage(ui, "check which files? Say `gieson check FILE...`");
    return pass_on_plain(ui, argc, argv);
}

int gsn_cmd_register(const struct gsn_ui *ui, int argc, char **argv)
{
    if (argc < 2)
        return gsn_ui_usage(ui, "register which pictures? Say `gieson register FOLDER`");
    return pass_on_plain(ui, argc, argv);
}

int gsn_cmd_study(const struct gsn_ui *ui, int argc, char **argv)
{
    return pass_on(ui, "gieson-work", 1, argc, argv, 0);
}

int gsn_cmd_index(const struct gsn_ui *ui, int argc, char **argv)
{
    return pass_on(ui, "gieson-work", 1, argc, argv, 0);
}

/* `export`, `render`, `probe`, `line` and `integral`: options go first, then everything else behind
 * "--", since a coordinate may be negative. */
int gsn_cmd_model(const struct gsn_ui *ui, int argc, char **argv)
{
    static const char *const valued[] = {
        "--level",   "--step", "--box",  "--plane",  "--points", "--threads",
        "--surface", "--view", "--size", "--window", "--cells",
    };
    gsn_auto_mem(const char *) args = gsn_alloc_array((size_t)argc + 2, sizeof *args);
    size_t n = 0;

    if (!args)
        return gsn_ui_fail(ui, EX_OSERR, "out of memory");
    for (int pass = 0; pass < 2; pass++) {
        for (int i = pass == 0 ? 1 : 0; i < argc; i++) {
            const int is_option = strncmp(argv[i], "--", 2) == 0;
            int takes = 0;

            for (size_t k = 0; k < sizeof valued / sizeof *valued; k++)
                takes |= strcmp(argv[i], valued[k]) == 0;
            if (takes && i + 1 == argc)
                return gsn_ui_usage(ui, "%s needs a value; `gieson %s --help` says which", argv[i],
                                    argv[0]);
            if (is_option == (pass == 0)) {
                args[n++] = argv[i];
                if (takes)
                    args[n++] = argv[i + 1];
            }
            i += takes;
        }
        if (pass == 0)
            args[n++] = "--";
    }
    return gsn_ui_call(ui, "gieson-work", 1, args);
}

/* A store is needed only where a study is named. */
int gsn_cmd_plan(const struct gsn_ui *ui, int argc, char **argv)
{
    for (int i = 1; i < argc; i++) {
        if (argv[i][0] != '-')
            return pass_on(ui, "gieson-work", 1, argc, argv, 0);
        if (!strchr(argv[i], '='))
            i++;
    }
    return pass_on_plain(ui, argc, argv);
}

int gsn_cmd_phantom(const struct gsn_ui *ui, int argc, char **argv)
{
    return pass_on(ui, "gieson-phantom", 0, argc, argv, 1);
}

int gsn_cmd_scrub(const struct gsn_ui *ui, int argc, char **argv)
{
    int64_t minutes = 0;

    for (int i = 1; i < argc; i++) {
        const int takes = strcmp(argv[i], "--minutes") == 0 || strcmp(argv[i], "--journal") == 0;

        if ((!takes && strcmp(argv[i], "--quick") != 0) || (takes && i + 1 == argc))
            return gsn_ui_usage(
                ui, "scrub takes only --quick, --minutes N and --journal FILE, not \"%s\"",
                argv[i]);
        if (strcmp(argv[i], "--minutes") == 0 &&
            !gsn_ui_whole(argv[i + 1], 1, MOST_MINUTES, &minutes))
            return gsn_ui_usage(ui, "--minutes must be a whole number from 1 to %d, not \"%s\"",
                                (int)MOST_MINUTES, argv[i + 1]);
        i += takes;
    }
    return pass_on(ui, "gieson-work", 1, argc, argv, 0);
}

int gsn_cmd_check_config(const struct gsn_ui *ui, int argc, char **argv)
{
    const char *args[5] = { "--check-config" };
    size_t n = 1;

    if (argc > 2)
        return gsn_ui_usage(ui, "check-config takes one file or none, not \"%s\"", argv[2]);
    if (ui->json)
        args[n++] = "--json";
    if (argc == 2) {
        args[n++] = "--config";
        args[n] = argv[1];
    }
    return gsn_ui_call(ui, "giesond", 0, args);
}
