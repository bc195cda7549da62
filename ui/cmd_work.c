/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verbs that gieson-work does: import, verify, check; and phantom, which has its own program.
 */
#include "ui/ui.h"

static int pass_on(const struct gsn_ui *ui, const char *program, int with_store, int argc,
                   char **argv, int from)
{
    gsn_auto_mem(const char *) args = gsn_alloc_array((size_t)argc + 1, sizeof *args);

    if (!args)
        return gsn_ui_fail(EX_OSERR, "out of memory");
    for (int i = from; i < argc; i++)
        args[i - from] = argv[i];
    return gsn_ui_call(ui, program, with_store, args);
}

int gsn_cmd_import(const struct gsn_ui *ui, int argc, char **argv)
{
    if (argc < 2)
        return gsn_ui_usage("import what? Say `gieson import FOLDER`");
    return pass_on(ui, "gieson-work", 1, argc, argv, 0);
}

int gsn_cmd_verify(const struct gsn_ui *ui, int argc, char **argv)
{
    if (argc != 2)
        return gsn_ui_usage("verify which run? Say `gieson verify RUN` or a specimen's name");
    return pass_on(ui, "gieson-work", 1, argc, argv, 0);
}

int gsn_cmd_check(const struct gsn_ui *ui, int argc, char **argv)
{
    if (argc < 2)
        return gsn_ui_usage("check which files? Say `gieson check FILE...`");
    return pass_on(ui, "gieson-work", 0, argc, argv, 0);
}

int gsn_cmd_phantom(const struct gsn_ui *ui, int argc, char **argv)
{
    return pass_on(ui, "gieson-phantom", 0, argc, argv, 1);
}
