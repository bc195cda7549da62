/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* gieson-phantom: makes a specimen with a known truth, or checks that its own truth is the right
 * one. Exit status: 0 done, 1 failed, 2 a check value was missed, 64 the command line is wrong. */
#include "pipeline/phantom/check.h"
#include "pipeline/phantom/phantom.h"
#include "pipeline/phantom/planning.h"
#include "pipeline/phantom/study.h"

#include <argp.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { KEY_CHECK = 256, KEY_STUDY, KEY_SEED, KEY_PX, KEY_VARIANT, KEY_DENSITY, KEY_THREADS };
enum { STATUS_FAILED = 1, STATUS_MISSED = 2 };

static const double CHECK_STEP_UM = 6;

struct request {
    const char *specimen, *level, *out, *variant;
    uint64_t seed;
    double px_um;
    int check, study, density;
    unsigned threads;
};

static const struct argp_option OPTIONS[] = {
    { "check", KEY_CHECK, NULL, 0, "compare the phantom with its check values", 0 },
    { "specimen", 's', "NAME", 0,
      "S00 (no lesion), S01, S02, S03 or S04; N1 and so on of the study", 0 },
    { "study", KEY_STUDY, NULL, 0, "make all 15 animals of the study", 0 },
    { "level", 'l', "LEVEL", 0,
      "L0 (ideal), L1 (a careful bench, the default), L2 (an ordinary one, with defects), L3 (a "
      "bad "
      "one) or L3-whole (a bad one whose panels all come in)",
      0 },
    { "seed", KEY_SEED, "NUMBER", 0, "what is drawn at random follows from it; default 1", 0 },
    { "out", 'o', "DIR", 0, "the folder to write", 0 },
    { "px", KEY_PX, "UM", 0, "pixel size, 4 to 48 um; default 16, for the study 24", 0 },
    { "variant", KEY_VARIANT, "FILE", 0,
      "what the specimen is to have instead of what its level and block say: another bath, other "
      "marks, another anatomy (JSON)",
      0 },
    { "density", KEY_DENSITY, NULL, 0, "write truth/density.raw (20 MB) as well", 0 },
    { "threads", KEY_THREADS, "COUNT", 0, "default: as many as there are processors", 0 },
    { 0 },
};

/* Digits with at most one point, as a number; -1 for anything else. */
static double to_number(const char *text)
{
    double value = 0, unit = 1;
    int digits = 0, point = 0;

    for (; *text; text++) {
        if (*text == '.' && !point++)
            continue;
        if (*text < '0' || *text > '9' || ++digits > 15)
            return -1;
        value = 10 * value + (*text - '0');
        unit *= point ? 10 : 1;
    }
    return digits ? value / unit : -1;
}

static int to_whole(const char *text, uint64_t most, uint64_t *ret_value)
{
    char *end;
    unsigned long long value;

    if (*text < '0' || *text > '9')
        return -1;
    errno = 0;
    value = strtoull(text, &end, 10);
    if (errno || *end || value > most)
        return -1;
    *ret_value = value;
    return 0;
}

static error_t take_option(int key, char *value, struct argp_state *state)
{
    struct request *request = state->input;
    uint64_t threads = 0;

    switch (key) {
    case KEY_CHECK:
        request->check = 1;
        return 0;
    case KEY_STUDY:
        request->study = 1;
        return 0;
    case 's':
        request->specimen = value;
        return 0;
    case 'l':
        request->level = value;
        return 0;
    case 'o':
        request->out = value;
        return 0;
    case KEY_SEED:
        if (to_whole(value, UINT64_MAX, &request->seed) < 0)
            argp_error(state, "--seed %s: not a whole number", value);
        return 0;
    case KEY_PX:
        request->px_um = to_number(value);
        if (request->px_um <= 0)
            argp_error(state, "--px %s: not a number of micrometres", value);
        return 0;
    case KEY_VARIANT:
        request->variant = value;
        return 0;
    case KEY_DENSITY:
        request->density = 1;
        return 0;
    case KEY_THREADS:
        if (to_whole(value, 64, &threads) < 0)
            argp_error(state, "--threads %s: not a number of threads, 0 to 64", value);
        request->threads = (unsigned)threads;
        return 0;
    case ARGP_KEY_END:
        if (!request->check && (!(request->specimen || request->study) || !request->out))
            argp_error(state, "--check, or --specimen or --study and --out, must be given");
        if (request->study && request->variant)
            argp_error(state, "--variant goes with --specimen, not with --study");
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

static int run_check(unsigned threads, struct gsn_error *err)
{
    struct gsn_phantom_check check[GSN_PHANTOM_CHECKS];
    int missed = 0;
    const int r = gsn_phantom_check_all(CHECK_STEP_UM, threads, check, err);

    if (r < 0)
        return STATUS_FAILED;
    (void)printf("%-28s %10s %10s %10s  verdict\n", "quantity", "value", "demanded", "difference");
    for (int i = 0; i < GSN_PHANTOM_CHECKS; i++) {
        (void)printf("%-28s %10.4f %10.4f %+10.4f  %s\n", check[i].name, check[i].value,
                     check[i].demanded, check[i].value - check[i].demanded,
                     check[i].met ? "met" : "MISSED");
        missed += !check[i].met;
    }
    return missed ? STATUS_MISSED : 0;
}

static void show_progress(void *context, const char *stage, size_t done, size_t total)
{
    (void)context;
    (void)fprintf(stderr, "\r%zu/%zu %-24s%s", done, total, stage, done == total ? "\n" : "");
}

static int run_make(const struct request *request, struct gsn_error *err)
{
    const struct gsn_progress progress = { show_progress, NULL };
    const struct gsn_progress *shown = isatty(STDERR_FILENO) ? &progress : NULL;
    gsn_auto_phantom_variant variant = gsn_phantom_variant_usual();
    gsn_auto_mem(struct gsn_phantom_plan) plan = NULL;
    int r = GSN_OK;

    if (request->study) {
        r = gsn_phantom_study_make(request->level, request->seed, request->px_um, request->threads,
                                   request->out, shown, err);
        return r < 0 ? STATUS_FAILED : 0;
    }
    plan = gsn_alloc_array(1, sizeof *plan);
    if (!plan)
        r = gsn_fail(err, GSN_E_NOMEM, "out of memory for the plan");
    if (r >= 0 && request->variant)
        r = gsn_phantom_variant_read(request->variant, &variant, err);
    if (r >= 0)
        r = gsn_phantom_plan_make_variant(request->specimen, request->level, request->seed,
                                          request->px_um, &variant, plan, err);
    if (r >= 0)
        r = gsn_phantom_make(plan, request->density, request->threads, request->out, shown, err);
    return r < 0 ? STATUS_FAILED : 0;
}

int main(int argc, char **argv)
{
    static const struct argp parser = {
        .options = OPTIONS,
        .parser = take_option,
        .doc = "Makes a phantom specimen, stained serial sections whose collagen loss is known, as "
               "a folder that gieson import reads.",
    };
    struct request request = { .level = "L1", .seed = 1 };
    struct gsn_error err = { 0 };
    int status = 0;

    argp_program_version = "gieson-phantom " GSN_VERSION;
    if (argp_parse(&parser, argc, argv, 0, NULL, &request) != 0)
        return STATUS_FAILED;
    if (request.check)
        status = run_check(request.threads, &err);
    if (status == 0 && (request.specimen || request.study) && request.out)
        status = run_make(&request, &err);
    if (err.code)
        (void)fprintf(stderr, "gieson-phantom: %s\n", err.text);
    return status;
}
