/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verbs about picture files without a store: `check` decodes strictly and says what each file
 * is; `register` gives the poses of a folder of section pictures as a table or JSON.
 *
 * The work of `register` is pipeline/folder/register_folder.h; here its options become records and
 * its result words: for each section the pose, its error ellipse, what is known of the tissue, and
 * why one was left out. Exit status 0 when every picture could be used, else 65; usage errors 64.
 */

#include <jansson.h>
#include <malloc.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sysexits.h>

#include "pipeline/core/error.h"
#include "pipeline/core/file.h"
#include "pipeline/core/process.h"
#include "pipeline/decode/apart.h"
#include "pipeline/folder/register_folder.h"
#include "systemd/worker/work_verbs.h"

/* `gieson-work register`: a plain folder of section pictures, as poses on stdout. */

struct gsn_decoder; /* pipeline/decode/apart.h */

struct gsn_register_request {
    const char *dir;
    const char *marks; /* six numbers, or NULL */
    const char *px_um; /* numbers as given, or NULL */
    const char *radius;
    int by_tissue;
    int json;
};

/* register */

/* Numbers of the command line, with commas or blanks between. gives: an array, or NULL. */
static json_t *numbers_of(const char *text)
{
    gsn_auto_mem(char) list = gsn_format("[%s]", text);
    json_t *array;

    for (char *c = list; c && *c; c++)
        if (*c == ' ' || *c == ';')
            *c = ',';
    array = list ? json_loads(list, 0, NULL) : NULL;
    for (size_t i = 0; i < json_array_size(array); i++) {
        if (!json_is_number(json_array_get(array, i))) {
            json_decref(array);
            return NULL;
        }
    }
    return array;
}

/* A length above 0; 0 when none was given. */
static int take_length(const char *text, const char *option, double *ret_length,
                       struct gsn_error *err)
{
    json_t *numbers = text ? numbers_of(text) : NULL;
    const double length = json_number_value(json_array_get(numbers, 0));
    const int fine = json_array_size(numbers) == 1 && isfinite(length) && length > 0;

    json_decref(numbers);
    if (text && !fine)
        return gsn_fail(err, GSN_E_INPUT, "--%s must be a length above 0, not \"%s\"", option,
                        text);
    *ret_length = text ? length : 0;
    return GSN_OK;
}

static int take_marks(const char *text, struct gsn_point ret_mark[GSN_FIDUCIALS],
                      struct gsn_error *err)
{
    json_t *numbers = numbers_of(text);
    const int fine = json_array_size(numbers) == 2 * GSN_FIDUCIALS;

    for (size_t i = 0; fine && i < GSN_FIDUCIALS; i++)
        ret_mark[i] = (struct gsn_point){ json_number_value(json_array_get(numbers, 2 * i)),
                                          json_number_value(json_array_get(numbers, 2 * i + 1)) };
    json_decref(numbers);
    return fine ? GSN_OK
                : gsn_fail(err, GSN_E_INPUT,
                           "--marks must be the places of three marks, \"x,y x,y x,y\", not \"%s\"",
                           text);
}

static const char *state_name(const struct gsn_folder_section *s)
{
    static const char *const names[] = { "none", "two-marks", "ok" };

    return s->by_tissue ? "by-tissue" : names[s->state];
}

static int has_pose(const struct gsn_folder_section *s)
{
    return s->by_tissue || s->state != GSN_POSE_NONE;
}

static json_t *matrix_of(const struct gsn_affine *m)
{
    return json_pack("[[f, f, f], [f, f, f]]", m->m00, m->m01, m->m02, m->m10, m->m11, m->m12);
}

static json_t *ellipses_of(const struct gsn_folder_section *s)
{
    json_t *list = json_array();

    for (size_t i = 0; i < GSN_FOLDER_ELLIPSES; i++) {
        const struct gsn_folder_ellipse *e = &s->ellipse[i];

        (void)json_array_append_new(list,
                                    json_pack("[f, f, f, f, f]", e->at.x, e->at.y, e->px.major,
                                              e->px.minor, e->px.angle * 180 / M_PI));
    }
    return list;
}

static json_t *section_of(const struct gsn_folder_section *s)
{
    json_t *root = json_pack("{s:s, s:s, s:f, s:f}", "state", state_name(s), "flags", s->flags,
                             "score", s->score, "runner_up", s->runner_up);

    if (!has_pose(s)) {
        (void)json_object_set_new(root, "reason", json_string(s->reason));
    } else if (s->by_tissue) {
        (void)json_object_set_new(root, "error_px", json_real(s->error_px));
        (void)json_object_set_new(root, "sections_away", json_integer(s->from));
    } else {
        (void)json_object_set_new(root, "error_px", json_real(s->error_px));
        (void)json_object_set_new(root, "ellipse95_px", ellipses_of(s));
        (void)json_object_set_new(root, "marks_rms_px", json_real(s->rms_px));
    }
    return root;
}

/* What the marks, or else the tissue, said of all sections. */
static json_t *summary_of(const struct gsn_folder_stack *stack, size_t lost, json_t *sections)
{
    json_t *root = json_pack(
        "{s:I, s:I, s:f, s:f, s:b, s:f, s:o}", "sections", (json_int_t)stack->count, "without_pose",
        (json_int_t)lost, "fle_px", stack->fle_px, "isosceles_sigma",
        fmin(stack->summary.isosceles_sigma, 1e9), "flips_told", stack->summary.flips_told,
        "cpu_ms_per_section", stack->cpu_ms, "section", sections);

    if (stack->by_tissue == 0)
        return root;
    (void)json_object_set_new(root, "by_tissue", json_integer((json_int_t)stack->by_tissue));
    (void)json_object_set_new(root, "drift_px_per_section", json_real(stack->tissue.drift));
    (void)json_object_set_new(root, "comparison_px", json_real(stack->tissue.usual));
    (void)json_object_set_new(root, "frame",
                              json_string(stack->tissue.held > 0
                                              ? "marks"
                                              : stack->section[stack->tissue.reference].file));
    return root;
}

/* A file's name that is not UTF-8 cannot be a key of JSON: it is left to the list. */
static void print_json(const struct gsn_folder_stack *stack, size_t lost)
{
    json_t *root = json_object(), *sections = json_object();

    for (size_t i = 0; i < stack->count; i++) {
        const struct gsn_folder_section *s = &stack->section[i];

        if (has_pose(s))
            (void)json_object_set_new(root, s->file, matrix_of(&s->frame_to_px));
        (void)json_object_set_new(sections, s->file, section_of(s));
    }
    (void)json_object_set_new(root, "gieson", summary_of(stack, lost, sections));
    (void)json_dumpf(root, stdout, JSON_INDENT(1) | JSON_REAL_PRECISION(9));
    (void)putchar('\n');
    json_decref(root);
}

static void print_tissue(const struct gsn_folder_stack *stack)
{
    const struct gsn_tissue_summary *t = &stack->tissue;

    (void)printf(
        "%zu of them laid by their tissue: two neighbours to about %.2f px, and at most %.2f "
        "px a section away from %s\n",
        stack->by_tissue, t->usual, t->drift,
        t->held > 0 ? "those with marks" : stack->section[t->reference].file);
    if (t->held == 0)
        (void)printf(
            "Without marks a block that slants or bends comes out upright and straight.\n");
}

static void print_text(const struct gsn_folder_stack *stack, size_t lost)
{
    for (size_t i = 0; i < stack->count; i++) {
        const struct gsn_folder_section *s = &stack->section[i];

        if (!has_pose(s))
            (void)printf("%-24s no pose: %s\n", s->file, s->reason);
        else
            (void)printf("%-24s %-9s turned %7.2f, error %.3f px%s%s\n", s->file, state_name(s),
                         atan2(-s->frame_to_px.m01, s->frame_to_px.m11) * 180 / M_PI, s->error_px,
                         s->flags[0] ? "; " : "", s->flags);
    }
    if (stack->by_tissue > 0)
        print_tissue(stack);
    if (stack->tissue.held == 0 && stack->by_tissue > 0) {
        (void)printf("%zu sections, %zu without a pose; %.2f ms each\n", stack->count, lost,
                     stack->cpu_ms);
        return;
    }
    (void)printf("%zu sections, %zu without a pose; a mark is localised to %.3f px; %.2f ms each\n",
                 stack->count, lost, stack->fle_px, stack->cpu_ms);
    if (!stack->summary.flips_told)
        (void)printf("The triangle is too nearly isosceles: a section mounted face down cannot be "
                     "told on this block\n");
}

/* How many sections have no pose. */
static size_t lost_of(const struct gsn_folder_stack *stack)
{
    size_t lost = 0;

    for (size_t i = 0; i < stack->count; i++)
        lost += !has_pose(&stack->section[i]);
    return lost;
}

/* Prints the poses. Returns the exit status: that of the mistake whose sentence is in err, or 65
 * when a picture has no pose. */
static int register_folder(const struct gsn_register_request *request, struct gsn_decoder *decoder,
                           struct gsn_error *err)
{
    struct gsn_point mark[GSN_FIDUCIALS];
    struct gsn_folder_options options = { .decoder = decoder, .by_tissue = request->by_tissue };
    gsn_auto(gsn_folder_stack) stack = NULL;
    int r = take_length(request->px_um, "px-um", &options.px_um, err);

    if (r >= 0)
        r = take_length(request->radius, "radius", &options.radius, err);
    if (r >= 0 && request->marks) {
        r = take_marks(request->marks, mark, err);
        options.mark = mark;
    }
    if (r < 0)
        return EX_USAGE;
    r = gsn_folder_register(request->dir, &options, &stack, err);
    if (r < 0)
        return gsn_code_exit(r);
    if (request->json)
        print_json(stack, lost_of(stack));
    else
        print_text(stack, lost_of(stack));
    return lost_of(stack) > 0 ? EX_DATAERR : EX_OK;
}

/* check */

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
        gsn_work_print(stdout, "%s: refused (%s): %s\n", path, gsn_code_name(r), err.text);
        return gsn_code_exit(r);
    }
    gsn_work_print(stdout, "%s: fine: %s, %u x %u, %s, %u bit%s%s\n", path, picture->kind,
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
    status = register_folder(&folder, decoder, &err);
    if (err.text[0])
        gsn_work_print(stderr, "gieson: %s\n", err.text);
    return status;
}
