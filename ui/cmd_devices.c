/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/text.h"
#include "ui/ui.h"

#include "pipeline/core/process.h"

#include <stdio.h>
#include <string.h>
#include <sysexits.h>

/* A device that answers nothing must not hold us for ever. */
enum { MOST_LIST_BYTES = 1 << 20, WITHIN_S = 30 };

/* What gieson-intake tells of a device: three texts, each ended by a zero byte. */
struct device {
    const char *address, *name, *note;
};

/* Where the text behind this one begins; NULL when it does not end before the end. */
static const char *behind(const char *text, const char *end)
{
    const char *zero = memchr(text, '\0', (size_t)(end - text));

    return zero ? zero + 1 : NULL;
}

/* The next device, or 0 at the end. */
static int next(const char **at, const char *end, struct device *ret_device)
{
    const char *const name = behind(*at, end);
    const char *const note = name ? behind(name, end) : NULL;
    const char *const rest = note ? behind(note, end) : NULL;

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

    for (const char *i = at; next(&i, end, &device);) {
        const int columns = gsn_text_columns(device.address);

        width = columns > width ? columns : width;
    }
    if (width == 0)
        (void)printf("no scanner and no camera is plugged in; folders need no device\n");
    while (next(&at, end, &device)) {
        gsn_auto_mem(char) address = gsn_text_cell(device.address, width);

        gsn_text_line(stdout, "%s  %s%s%s", address ? address : device.address, device.name,
                      device.note[0] ? ": " : "", device.note);
    }
}

static void print_json(const struct gsn_ui *ui, const char *at, const char *end)
{
    json_t *array = json_array();
    struct device device;

    while (next(&at, end, &device))
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
