/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/work_verbs.h"

#include "pipeline/core/file.h"
#include "pipeline/core/process.h"
#include "pipeline/decode/apart.h"
#include "systemd/register_folder.h"

#include <malloc.h>
#include <stdio.h>
#include <sysexits.h>

static json_t *checked_json(const char *path, int r, const struct gsn_picture *picture,
                            const char *why)
{
    if (r < 0)
        return json_pack("{s:o, s:b, s:s, s:o}", "file", gsn_work_text(path), "fine", 0, "code",
                         gsn_code_name(r), "message", gsn_work_text(why));
    return json_pack("{s:o, s:b, s:s, s:i, s:i, s:i, s:i, s:o}", "file", gsn_work_text(path),
                     "fine", 1, "kind", picture->kind, "width", (int)picture->image->width,
                     "height", (int)picture->image->height, "channels",
                     (int)picture->image->channels, "bits", (int)picture->image->bits, "message",
                     gsn_work_text(picture->note));
}

/* ret_json: NULL: in words. */
static int check_one(struct gsn_decoder *decoder, const char *path, json_t *ret_json)
{
    gsn_auto_fd fd = -1;
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };
    int r = gsn_file_open(path, &fd, &err);

    if (r >= 0)
        r = gsn_decode_apart(decoder, fd, NULL, &picture, &err);
    if (ret_json) {
        (void)json_array_append_new(ret_json, checked_json(path, r, picture, err.text));
        return r < 0 ? gsn_code_exit(r) : EX_OK;
    }
    if (r < 0) {
        gsn_work_say(stdout, "%s: refused (%s): %s\n", path, gsn_code_name(r), err.text);
        return gsn_code_exit(r);
    }
    gsn_work_say(stdout, "%s: fine: %s, %u x %u, %s, %u bit%s%s\n", path, picture->kind,
                 picture->image->width, picture->image->height,
                 picture->image->channels == 3 ? "RGB" : "grey", picture->image->bits,
                 picture->note[0] ? "; " : "", picture->note);
    return EX_OK;
}

int gsn_work_check(const struct gsn_work_request *request)
{
    gsn_auto_mem(char) program = NULL;
    gsn_auto(gsn_decoder) decoder = NULL;
    __attribute__((cleanup(json_decrefp))) json_t *checked = request->json ? json_array() : NULL;
    struct gsn_error err = { 0 };
    int status = EX_OK, r;

    if (request->rest_count < 1)
        return gsn_work_usage(request, "check needs at least one file");
    r = gsn_process_sibling("gieson-decode", &program, &err);
    if (r >= 0)
        r = gsn_decoder_new(program, &decoder, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    for (int i = 0; i < request->rest_count; i++) {
        r = check_one(decoder, request->rest[i], checked);

        if (r != EX_OK)
            status = r;
    }
    if (checked) {
        (void)json_dumpf(checked, stdout, JSON_INDENT(2));
        (void)putchar('\n');
    }
    return status;
}

int gsn_work_register(const struct gsn_work_request *request)
{
    const struct gsn_register_request folder = { .dir = request->rest[0],
                                                 .marks = request->marks,
                                                 .px_um = request->px_um,
                                                 .radius = request->radius,
                                                 .by_tissue = request->by_tissue,
                                                 .json = request->json };
    gsn_auto_mem(char) program = NULL;
    gsn_auto(gsn_decoder) decoder = NULL;
    struct gsn_error err = { 0 };
    int status, r;

    if (request->rest_count != 1)
        return gsn_work_usage(request, "register needs one folder of pictures");
    /* One section after the other works in the same pages. */
    (void)mallopt(M_MMAP_THRESHOLD, 32 << 20);
    (void)mallopt(M_TRIM_THRESHOLD, 256 << 20);
    r = gsn_process_sibling("gieson-decode", &program, &err);
    if (r >= 0)
        r = gsn_decoder_new(program, &decoder, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    status = gsn_register_folder(&folder, decoder, &err);
    if (err.text[0])
        gsn_work_say(stderr, "gieson: %s\n", err.text);
    return status;
}
