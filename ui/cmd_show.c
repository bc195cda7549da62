/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/show.h"
#include "ui/ui.h"

#include <sysexits.h>

int gsn_cmd_show(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto(gsn_store) store = NULL;
    struct gsn_show view = { 0 };
    struct gsn_error err = { 0 };
    int status = EX_OK, r;

    if (argc != 2)
        return gsn_ui_usage(ui, "show which specimen? `gieson status` lists them");
    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    r = gsn_show_load(store, argv[1], &view, &err);
    if (r < 0)
        status = gsn_ui_complain(ui, &err, r);
    else if (ui->json)
        gsn_ui_print_json(ui, gsn_show_json(&view));
    else
        gsn_show_print(ui, &view);
    gsn_show_done(&view);
    return status;
}
