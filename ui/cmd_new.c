/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A folder for a specimen's panels, with a job.json to be filled in. JSON has no comments, so each
 * key is led by one that begins with "comment", which an import does not read. */
#include "ui/text.h"
#include "ui/ui.h"

#include "pipeline/core/file.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

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
