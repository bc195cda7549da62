/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verbs for somebody who begins: new and demo.
 *
 * `new` makes a folder for a specimen's panels, with a job.json to be filled in; JSON has no
 * comments, so each key is led by one that begins with "comment", which an import does not read.
 * `demo` goes the whole way once: two phantom specimens with a known truth and a calibration panel
 * of their bath, taken in as a scanner's folder, processed, reported, and compared with the truth.
 */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sysexits.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "storage/catalog.h"
#include "storage/result.h"
#include "ui/text.h"
#include "ui/ui.h"

static const char template_text[] =
    "{\n"
    "  \"comment\": \"What is known of this specimen; lengths are micrometres. Take out the lines "
    "that\",\n"
    "  \"comment 2\": \"you do not need: comments, and keys whose default will do "
    "(man gieson-job).\",\n"
    "\n"
    "  \"comment calibration\": \"A glass of the same batch with a patch of each dye, scanned "
    "alike: with\",\n"
    "  \"comment calibration 2\": \"it a loss is known to a point or two, without to ten, or not "
    "at all.\",\n"
    "  \"comment calibration 3\": \"No such glass? Take the next line out. \\\"batch\\\" names the "
    "stain.\",\n"
    "  \"calibration\": \"C01.tif\",\n"
    "  \"batch\": \"\",\n"
    "\n"
    "  \"comment specimen\": \"A name that is unique in the store; the panels' files begin with "
    "it.\",\n"
    "  \"specimen\": %s,\n"
    "  \"study\": \"\",\n"
    "  \"group\": \"\",\n"
    "  \"animal\": \"\",\n"
    "\n"
    "  \"comment baseline\": \"The specimen or group that the loss is measured against; take it "
    "out for a\",\n"
    "  \"comment baseline 2\": \"control.\",\n"
    "  \"baseline\": \"saline\",\n"
    "\n"
    "  \"comment px_um\": \"Side of a pixel. Panels: how many slides with sections there are, and "
    "rows and\",\n"
    "  \"comment px_um 2\": \"columns of sections on each, in the order of mounting: row, column "
    "or snake.\",\n"
    "  \"px_um\": 10.58,\n"
    "  \"panels\": 5,\n"
    "  \"layout\": [3, 4],\n"
    "  \"order\": \"row\",\n"
    "  \"interval_um\": 24,\n"
    "\n"
    "  \"comment markers_um\": \"The three laser marks in the block frame: x to the right, y DOWN, "
    "as in\",\n"
    "  \"comment markers_um 2\": \"the scan of a section that was mounted the right way up.\",\n"
    "  \"markers_um\": [[-2050, -1000], [1700, -1500], [-1500, 1300]],\n"
    "\n"
    "  \"comment region\": \"What is measured, in the same frame; z along the cutting direction. "
    "Or the\",\n"
    "  \"comment region 2\": \"name of a mask file (.mhd, .nrrd) beside this one.\",\n"
    "  \"region\": {\"shape\": \"cylinder\", \"centre\": [410, 645], \"radius\": 900, \"z\": [120, "
    "720]}\n"
    "}\n";

/* new */

static char *last_part(const char *folder)
{
    size_t end = strlen(folder), begin;

    while (end > 1 && folder[end - 1] == '/')
        end--;
    begin = end;
    while (begin > 0 && folder[begin - 1] != '/')
        begin--;
    return gsn_format("%.*s", (int)(end - begin), folder + begin);
}

int gsn_cmd_new(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto_mem(char) name = argc == 2 ? last_part(argv[1]) : NULL;
    gsn_auto_mem(char) path = argc == 2 ? gsn_format("%s/job.json", argv[1]) : NULL;
    gsn_auto_mem(char) text = NULL;
    struct gsn_error err = { 0 };
    json_t *quoted;
    char *dumped;
    int r;

    if (argc != 2)
        return gsn_ui_usage(ui, "new takes one folder: say `gieson new FOLDER`");
    if (!name || !path)
        return gsn_ui_fail(ui, EX_OSERR, "out of memory");
    if (access(path, F_OK) == 0)
        return gsn_ui_fail(ui, EX_CANTCREAT, "%s is there already and stays as it is", path);
    quoted = gsn_text_json(strcmp(name, ".") == 0 ? "NAME" : name);
    dumped = quoted ? json_dumps(quoted, JSON_ENCODE_ANY) : NULL;
    text = dumped ? gsn_format(template_text, dumped) : NULL;
    free(dumped); /* door */
    json_decref(quoted);
    if (!text)
        return gsn_ui_fail(ui, EX_OSERR, "out of memory");
    r = gsn_file_mkdir(argv[1], &err);
    if (r >= 0)
        r = gsn_file_write(path, text, strlen(text), &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    if (ui->json)
        gsn_ui_print_json(ui, json_pack("{s:o}", "job", gsn_text_json(path)));
    else
        gsn_text_line(stdout, "%s: fill it in, copy the panels beside it, then `gieson import %s`",
                      path, argv[1]);
    return EX_OK;
}

static const char CONTROL[] = "S00", TREATED[] = "S02", SPECIMEN[] = "GVP-D-S02";

enum { MOST_TRUTH_BYTES = 1 << 16 };

/* demo */

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
