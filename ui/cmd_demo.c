/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The whole way once, for somebody who has never seen it: two phantom specimens with a known truth
 * and a calibration panel of their bath, taken in as a scanner's folder, worked, reported, and
 * compared with the truth. */
#include "ui/look.h"
#include "ui/ui.h"

#include "pipeline/core/file.h"
#include "storage/catalog.h"
#include "storage/result.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sysexits.h>

static const char CONTROL[] = "S00", TREATED[] = "S02", SPECIMEN[] = "GVP-D-S02";

enum { MOST_TRUTH_BYTES = 1 << 16 };

static int make_specimen(const struct gsn_ui *ui, const char *folder, const char *which)
{
    static const char WITH_PANEL[] = "{\"calibration\": true}\n";
    gsn_auto_mem(char) out = gsn_format("%s/scans/GVP-D-%s", folder, which);
    gsn_auto_mem(char) variant = gsn_format("%s/variant.json", folder);
    const char *const args[] = { "--specimen", which,   "--level", "L1", "--seed", "7",
                                 "--variant",  variant, "--out",   out,  NULL };
    struct gsn_error err = { 0 };
    int r;

    if (!out || !variant)
        return EX_OSERR;
    r = gsn_file_mkdir(folder, &err);
    if (r >= 0)
        r = gsn_file_write(variant, WITH_PANEL, sizeof WITH_PANEL - 1, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    (void)fprintf(stderr, "demo: scanning phantom %s\n", which);
    return gsn_ui_call(ui, "gieson-phantom", 0, args);
}

static int import_specimen(const struct gsn_ui *ui, const char *folder, const char *which)
{
    gsn_auto_mem(char) scans = gsn_format("%s/scans/GVP-D-%s", folder, which);
    char verb[] = "import";
    char *argv[] = { verb, scans, NULL };

    return scans ? gsn_cmd_import(ui, 2, argv) : EX_OSERR;
}

/* The value under this heading in the first row of a CSV file, or NaN. */
static double csv_value(const char *text, const char *heading)
{
    const char *row = strchr(text, '\n');
    const char *name = text;
    double value = NAN;

    while (row && name && name < row) {
        const size_t name_length = strcspn(name, ",\n");
        const size_t length = strcspn(row + 1, ",\n");

        if (name_length == strlen(heading) && strncmp(name, heading, name_length) == 0) {
            json_t *number = json_loadb(row + 1, length, JSON_DECODE_ANY, NULL);

            value = json_is_number(number) ? json_number_value(number) : NAN;
            json_decref(number);
            return value;
        }
        name = name[name_length] == ',' ? name + name_length + 1 : NULL;
        row = row[1 + length] == ',' ? row + 1 + length : NULL;
    }
    return value;
}

static double read_truth(const char *folder)
{
    gsn_auto_mem(char) path = gsn_format("%s/scans/%s/truth/loss.csv", folder, SPECIMEN);
    gsn_auto_mem(uint8_t) text = NULL;
    struct gsn_error quiet = { 0 };
    size_t size;

    if (!path || gsn_file_read(path, MOST_TRUTH_BYTES, &text, &size, &quiet) < 0)
        return NAN;
    return csv_value((const char *)text, "loss_pct");
}

static int print_end(const struct gsn_ui *ui, const char *folder)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_specimen_row) specimen = NULL;
    gsn_auto(gsn_run_row) run = NULL;
    gsn_auto(gsn_measure_rows) measures = NULL;
    gsn_auto_mem(char) said = NULL;
    const double truth = read_truth(folder);
    struct gsn_error err = { 0 };
    double loss = NAN, lower = NAN, upper = NAN;
    int status = EX_OK, r;

    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    r = gsn_specimen_get(store, SPECIMEN, &specimen, &err);
    if (r >= 0)
        r = gsn_run_latest(store, specimen->id, NULL, &run, &err);
    if (r >= 0)
        r = gsn_measure_list(store, run->id, &measures, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    for (size_t i = 0; i < measures->count; i++)
        if (strcmp(measures->at[i].name, "loss") == 0) {
            loss = measures->at[i].value;
            lower = measures->at[i].lower;
            upper = measures->at[i].upper;
        }
    if (isnan(loss) || isnan(truth))
        return gsn_ui_fail(ui, EX_DATAERR, "the demo ended without a loss: %s", run->message);
    said = gsn_look_loss(loss, lower, upper);
    (void)printf("\ncollagen loss  %s  of %s against GVP-D-%s\n"
                 "the truth      %.2f %%  (difference %+.2f points)\n"
                 "report         %s/%s\n",
                 said ? said : "", SPECIMEN, CONTROL, truth, loss - truth, gsn_store_dir(store),
                 run->report_path);
    return EX_OK;
}

int gsn_cmd_demo(const struct gsn_ui *given, int argc, char **argv)
{
    const char *folder = argc > 1 ? argv[1] : "demo";
    gsn_auto_mem(char) dir = gsn_format("%s/store", folder);
    struct gsn_ui ui = *given;
    char run[] = "run";
    char *run_argv[] = { run, NULL };
    int status;

    if (argc > 2 || folder[0] == '-')
        return gsn_ui_usage(given, "demo takes one folder or none, not \"%s\"",
                            argv[argc > 2 ? 2 : 1]);
    if (!dir)
        return EX_OSERR;
    if (!ui.store_dir)
        ui.store_dir = dir;
    ui.json = 0;
    status = make_specimen(&ui, folder, CONTROL);
    if (status == EX_OK)
        status = make_specimen(&ui, folder, TREATED);
    if (status == EX_OK)
        status = import_specimen(&ui, folder, CONTROL);
    if (status == EX_OK)
        status = import_specimen(&ui, folder, TREATED);
    if (status == EX_OK)
        status = gsn_cmd_run(&ui, 1, run_argv);
    return status == EX_OK ? print_end(&ui, folder) : status;
}
