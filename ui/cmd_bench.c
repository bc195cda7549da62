/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a person says to the bench and asks of it: file, expect, capture, devices.
 *
 * `file` says where a scan belongs, or that it belongs nowhere; `expect` whose panels a source
 * delivers; `capture` asks a source for a picture now and waits for its answer; `devices` has
 * gieson-intake list what is plugged in, with the address under which the configuration names each.
 */

#include <stdio.h>
#include <string.h>
#include <sysexits.h>
#include <time.h>

#include "pipeline/core/process.h"
#include "storage/audit_log.h"
#include "storage/bench.h"
#include "storage/scan.h"
#include "ui/text.h"
#include "ui/ui.h"

enum {
    MOST_PANELS = 100000,
    ANSWER_WITHIN_S = 60,
    ASK_EVERY_MS = 200,
};

/* ---- file -------------------------------------------------------------------------------- */

struct filing {
    const char *scan, *specimen, *panel; /* as typed */
    int64_t id, number;
    int undo;
};

static int read_filing(int argc, char **argv, struct filing *filing)
{
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--panel") == 0 && i + 1 < argc)
            filing->panel = argv[++i];
        else if (strncmp(argv[i], "--panel=", 8) == 0)
            filing->panel = argv[i] + 8;
        else if (!filing->scan)
            filing->scan = argv[i];
        else if (!filing->specimen)
            filing->specimen = argv[i];
        else
            return -1;
    }
    /* A specimen called undo is named with its panel. */
    filing->undo = filing->specimen && strcmp(filing->specimen, "undo") == 0 && !filing->panel;
    return filing->scan && filing->specimen && (filing->panel || filing->undo) ? 0 : -1;
}

static int undo_filing(const struct gsn_ui *ui, struct gsn_store *store, int64_t scan,
                       const char *actor)
{
    struct gsn_error err = { 0 };
    const int r = gsn_scan_unfile(store, scan, actor, time(NULL), &err);

    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    if (ui->json)
        gsn_ui_print_json(
            ui, json_pack("{s:I, s:n, s:n}", "scan", (json_int_t)scan, "specimen", "panel"));
    else
        gsn_text_line(stdout, "scan %lld is nobody's panel again: `gieson status` lists it",
                      (long long)scan);
    return EX_OK;
}

int gsn_cmd_file(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto(gsn_store) store = NULL;
    const struct gsn_actor who = gsn_actor_now();
    struct filing filing = { 0 };
    struct gsn_error err = { 0 };
    int status = EX_OK, r;

    if (read_filing(argc, argv, &filing) < 0)
        return gsn_ui_usage(
            ui, "say `gieson file SCAN SPECIMEN --panel N`, or `gieson file SCAN undo`; "
                "`gieson status` lists the scans that nobody could place");
    if (!gsn_ui_whole(filing.scan, 1, INT64_MAX, &filing.id))
        return gsn_ui_usage(ui, "a scan is named by its number, not \"%s\"", filing.scan);
    if (!filing.undo && !gsn_ui_whole(filing.panel, 1, MOST_PANELS, &filing.number))
        return gsn_ui_usage(ui, "--panel must be a whole number from 1 to %d, not \"%s\"",
                            (int)MOST_PANELS, filing.panel);
    store = gsn_ui_store(ui, GSN_STORE_WRITE, &status);
    if (!store)
        return status;
    if (filing.undo)
        return undo_filing(ui, store, filing.id, who.name);
    r = gsn_scan_file(store, filing.id, filing.specimen, (unsigned)filing.number, who.name,
                      time(NULL), &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    if (ui->json)
        gsn_ui_print_json(ui, json_pack("{s:I, s:o, s:I}", "scan", (json_int_t)filing.id,
                                        "specimen", gsn_text_json(filing.specimen), "panel",
                                        (json_int_t)filing.number));
    else
        gsn_text_line(stdout, "scan %lld is panel %lld of %s", (long long)filing.id,
                      (long long)filing.number, filing.specimen);
    return EX_OK;
}

/* ---- expect ------------------------------------------------------------------------------ */

/* Whether the configuration named it when the service last began. */
static int knows_source(struct gsn_store *store, const char *name, struct gsn_error *err)
{
    gsn_auto(gsn_bench_sources) sources = NULL;
    const int r = gsn_bench_list(store, &sources, err);

    for (size_t i = 0; r >= 0 && i < sources->count; i++)
        if (strcmp(sources->at[i].name, name) == 0 && strcmp(sources->at[i].state, "off") != 0)
            return GSN_OK;
    return r < 0 ? r
                 : gsn_fail(err, GSN_E_NOTFOUND,
                            "there is no source %.200s: `gieson status` lists them", name);
}

int gsn_cmd_expect(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto(gsn_store) store = NULL;
    struct gsn_error err = { 0 };
    const char *specimen = argc == 3 && strcmp(argv[2], "--nobody") != 0 ? argv[2] : NULL;
    int status = EX_OK, r;

    if (argc != 3)
        return gsn_ui_usage(ui, "say `gieson expect SOURCE SPECIMEN` or `gieson expect SOURCE "
                                "--nobody`");
    store = gsn_ui_store(ui, GSN_STORE_WRITE, &status);
    if (!store)
        return status;
    r = knows_source(store, argv[1], &err);
    if (r >= 0)
        r = gsn_scan_expect(store, argv[1], specimen, gsn_actor_now().name, time(NULL), &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    if (ui->json)
        gsn_ui_print_json(ui, json_pack("{s:o, s:o}", "source", gsn_text_json(argv[1]), "delivers",
                                        gsn_text_json(specimen ? specimen : "")));
    else if (specimen)
        gsn_text_line(stdout, "%s delivers panels of %s from now on", argv[1], specimen);
    else
        gsn_text_line(stdout, "%s delivers panels of whom their names say", argv[1]);
    return EX_OK;
}

/* ---- capture ----------------------------------------------------------------------------- */

/* Waits until the request is answered. gives: the row, still waiting when nobody answered. */
static int wait_for_answer(struct gsn_store *store, int64_t id, struct gsn_request_row **ret_row,
                           struct gsn_error *err)
{
    const int64_t end = time(NULL) + ANSWER_WITHIN_S;

    for (;;) {
        gsn_auto(gsn_request_row) row = NULL;
        const int r = gsn_request_get(store, id, &row, err);

        if (r < 0)
            return r;
        if (strcmp(row->state, "waiting") != 0 || time(NULL) >= end) {
            *ret_row = gsn_steal(&row);
            return GSN_OK;
        }
        gsn_ui_pause_ms(ASK_EVERY_MS);
    }
}

static int tell_answer(const struct gsn_ui *ui, const struct gsn_request_row *row)
{
    const int refused = strcmp(row->state, "refused") == 0;

    if (ui->json)
        gsn_ui_print_json(ui,
                          json_pack("{s:I, s:o, s:s, s:s, s:o}", "request", (json_int_t)row->id,
                                    "source", gsn_text_json(row->source), "kind", row->kind,
                                    "state", row->state, "message", gsn_text_json(row->message)));
    if (strcmp(row->state, "waiting") == 0)
        return gsn_ui_fail(ui, EX_TEMPFAIL,
                           "%s has not answered within %d s; it still will: see `gieson status`",
                           row->source, (int)ANSWER_WITHIN_S);
    if (refused)
        return gsn_ui_fail(ui, EX_DATAERR, "%s refused: %s", row->source, row->message);
    if (!ui->json)
        gsn_text_line(stdout, "%s took its picture", row->source);
    return EX_OK;
}

int gsn_cmd_capture(const struct gsn_ui *ui, int argc, char **argv)
{
    static const char *const kinds[][2] = { { "--blank", "capture-blank" },
                                            { "--dark", "capture-dark" } };
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_request_row) row = NULL;
    const char *kind = argc == 2 ? "capture-panel" : NULL;
    struct gsn_error err = { 0 };
    int status = EX_OK, there = 0, r;
    int64_t id = 0;

    for (size_t i = 0; argc == 3 && i < 2; i++)
        if (strcmp(argv[2], kinds[i][0]) == 0)
            kind = kinds[i][1];
    if (!kind)
        return gsn_ui_usage(ui,
                            "say `gieson capture SOURCE`, with --blank for clean glass or --dark "
                            "for a covered lens");
    store = gsn_ui_store(ui, GSN_STORE_WRITE, &status);
    if (!store)
        return status;
    r = knows_source(store, argv[1], &err);
    if (r >= 0)
        r = gsn_service_is_there(gsn_store_dir(store), GSN_SERVICE_INTAKE, &there, &err);
    if (r >= 0 && !there)
        return gsn_ui_fail(ui, EX_TEMPFAIL,
                           "giesond is not running, and only it speaks to devices: "
                           "`systemctl start gieson`");
    if (r >= 0)
        r = gsn_request_add(store, argv[1], kind, gsn_actor_now().name, time(NULL), &id, &err);
    if (r >= 0)
        r = wait_for_answer(store, id, &row, &err);
    return r < 0 ? gsn_ui_complain(ui, &err, r) : tell_answer(ui, row);
}

/* A device that answers nothing must not hold us for ever. */
enum { MOST_LIST_BYTES = 1 << 20, WITHIN_S = 30 };

/* What gieson-intake tells of a device: three texts, each ended by a zero byte. */
struct device {
    const char *address, *name, *note;
};

/* devices */

/* Where the text behind this one begins; NULL when it does not end before the end. */
static const char *text_behind(const char *text, const char *end)
{
    const char *zero = memchr(text, '\0', (size_t)(end - text));

    return zero ? zero + 1 : NULL;
}

/* The next device, or 0 at the end. */
static int next_device(const char **at, const char *end, struct device *ret_device)
{
    const char *const name = text_behind(*at, end);
    const char *const note = name ? text_behind(name, end) : NULL;
    const char *const rest = note ? text_behind(note, end) : NULL;

    if (!rest)
        return 0;
    *ret_device = (struct device){ *at, name, note };
    *at = rest;
    return 1;
}

static void print_text(const char *at, const char *end)
{
    struct device device;
    int width = 0;

    for (const char *i = at; next_device(&i, end, &device);) {
        const int columns = gsn_text_columns(device.address);

        width = columns > width ? columns : width;
    }
    if (width == 0)
        (void)printf("no scanner and no camera is plugged in; folders need no device\n");
    while (next_device(&at, end, &device)) {
        gsn_auto_mem(char) address = gsn_text_cell(device.address, width);

        gsn_text_line(stdout, "%s  %s%s%s", address ? address : device.address, device.name,
                      device.note[0] ? ": " : "", device.note);
    }
}

static void print_json(const struct gsn_ui *ui, const char *at, const char *end)
{
    json_t *array = json_array();
    struct device device;

    while (next_device(&at, end, &device))
        (void)json_array_append_new(
            array, json_pack("{s:o, s:o, s:o}", "address", gsn_text_json(device.address), "name",
                             gsn_text_json(device.name), "note", gsn_text_json(device.note)));
    gsn_ui_print_json(ui, json_pack("{s:o}", "devices", array));
}

int gsn_cmd_devices(const struct gsn_ui *ui, int argc, char **argv)
{
    static const struct gsn_process_limits limits = { .wall_s = WITHIN_S,
                                                      .answer_bytes = MOST_LIST_BYTES };
    gsn_auto_mem(char) program = NULL;
    gsn_auto_mem(uint8_t) answer = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0;
    int r;

    if (argc > 1)
        return gsn_ui_usage(ui, "devices takes no argument, not \"%s\"", argv[1]);
    r = gsn_process_sibling("gieson-intake", &program, &err);
    if (r >= 0) {
        const char *const call[] = { program, "--list", NULL };

        r = gsn_process_ask(call, &limits, "", 0, &answer, &size, &err);
    }
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    if (ui->json)
        print_json(ui, (const char *)answer, (const char *)answer + size);
    else
        print_text((const char *)answer, (const char *)answer + size);
    return EX_OK;
}
