/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* gieson-work: the heavy program. It does one thing and ends, so that a crash in mathematics or in
 * a decoder costs one job and never a scan. `gieson` and giesond start it; people rarely do.
 *
 *     gieson-work --store DIR import FOLDER
 *     gieson-work --store DIR work          claims one job; 0: done, 66: nothing to do, 75: busy
 *     gieson-work --store DIR verify RUN
 *     gieson-work --store DIR changed       asks for the job of every specimen that changed
 *     gieson-work --store DIR scrub         reads stored objects again; 65: some are damaged
 *     gieson-work check FILE...             decodes strictly, says what each file is
 *     gieson-work register FOLDER           the poses of a folder of section pictures
 */
#include "pipeline/core/error.h"
#include "pipeline/core/file.h"
#include "pipeline/core/process.h"
#include "pipeline/core/sandbox.h"
#include "pipeline/decode/apart.h"
#include "storage/catalog.h"
#include "storage/event.h"
#include "storage/result.h"
#include "systemd/give_back.h"
#include "systemd/import.h"
#include "systemd/job.h"
#include "systemd/night.h"
#include "systemd/register_folder.h"
#include "systemd/scrub.h"

#include <argp.h>
#include <jansson.h>
#include <malloc.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sysexits.h>
#include <unistd.h>

enum { MOST_CHECK_BYTES = 1 << 30, MOST_THREADS = 64, MOST_MINUTES = 10000 };

const char *argp_program_version = "gieson-work " GSN_VERSION;

enum {
    OPT_VOLUME = 256,
    OPT_TILE,
    OPT_REFERENCE,
    OPT_SPECIMEN,
    OPT_THRESHOLD,
    OPT_REPLACE,
    OPT_MINUTES,
    OPT_MARKS,
    OPT_PX_UM,
    OPT_RADIUS,
    OPT_BY_TISSUE
};

struct request {
    const char *store_dir, *verb;
    char **rest;
    int rest_count, json, replace, by_tissue;
    unsigned threads, minutes;
    const char *volume, *tile, *reference, *specimen, *marks, *px_um, *radius;
    json_t *thresholds;
};

static const struct argp_option options[] = {
    { "store", 's', "DIR", 0, "The store (default: $GIESON_STORE)", 0 },
    { "threads", 't', "N", 0, "Threads to use (default: as many as there are processors)", 0 },
    { "json", 'j', NULL, 0, "Print JSON", 0 },
    { "replace", OPT_REPLACE, NULL, 0, "import: a specimen of the same name takes the new job", 1 },
    { "volume", OPT_VOLUME, "FILE", 0, "import: a volume (.mhd, .nrrd, .inr) instead of a folder",
      1 },
    { "tile", OPT_TILE, "FILE", 0, "import: one picture of stained tissue", 1 },
    { "reference", OPT_REFERENCE, "FILE", 0, "import --tile: a mask to compare with, beside it",
      1 },
    { "specimen", OPT_SPECIMEN, "NAME", 0, "import --volume, --tile: its name", 1 },
    { "threshold", OPT_THRESHOLD, "X", 0, "import --volume, --tile: may be given up to 8 times",
      1 },
    { "minutes", OPT_MINUTES, "N", 0, "scrub: stop after so long; the next one goes on there", 1 },
    { "marks", OPT_MARKS, "X,Y X,Y X,Y", 0, "register: where the marks are in the frame wanted",
      1 },
    { "px-um", OPT_PX_UM, "UM", 0, "register: size of a pixel; without it lengths are pixels", 1 },
    { "radius", OPT_RADIUS, "R", 0, "register: the error is given over this disc", 1 },
    { "by-tissue", OPT_BY_TISSUE, NULL, 0,
      "register: lay sections without marks by the tissue of their neighbours", 1 },
    { 0 },
};

/* A decimal number of the command line, through the parser that reads every other number. */
static json_t *number_of(const char *text)
{
    return json_loads(text, JSON_DECODE_ANY, NULL);
}

static unsigned take_whole(const char *text, const char *option, unsigned most,
                           struct argp_state *state)
{
    json_t *number = number_of(text);
    const json_int_t value = json_is_integer(number) ? json_integer_value(number) : -1;

    json_decref(number);
    if (value < 0 || value > most)
        argp_error(state, "--%s must be a whole number from 0 to %u", option, most);
    return (unsigned)value;
}

static void take_threshold(const char *text, struct request *request, struct argp_state *state)
{
    json_t *number = number_of(text);

    if (!json_is_number(number))
        argp_error(state, "--threshold must be a number, not \"%s\"", text);
    if (!request->thresholds)
        request->thresholds = json_array();
    (void)json_array_append_new(request->thresholds, number);
}

static error_t take_option(int key, char *arg, struct argp_state *state)
{
    struct request *request = state->input;

    switch (key) {
    case 's':
        request->store_dir = arg;
        return 0;
    case 't':
        request->threads = take_whole(arg, "threads", MOST_THREADS, state);
        return 0;
    case 'j':
        request->json = 1;
        return 0;
    case OPT_MINUTES:
        request->minutes = take_whole(arg, "minutes", MOST_MINUTES, state);
        return 0;
    case OPT_REPLACE:
        request->replace = 1;
        return 0;
    case OPT_VOLUME:
        request->volume = arg;
        return 0;
    case OPT_TILE:
        request->tile = arg;
        return 0;
    case OPT_REFERENCE:
        request->reference = arg;
        return 0;
    case OPT_SPECIMEN:
        request->specimen = arg;
        return 0;
    case OPT_MARKS:
        request->marks = arg;
        return 0;
    case OPT_PX_UM:
        request->px_um = arg;
        return 0;
    case OPT_BY_TISSUE:
        request->by_tissue = 1;
        return 0;
    case OPT_RADIUS:
        request->radius = arg;
        return 0;
    case OPT_THRESHOLD:
        take_threshold(arg, request, state);
        return 0;
    case ARGP_KEY_ARG:
        if (request->verb)
            request->rest[request->rest_count++] = arg;
        else
            request->verb = arg;
        return 0;
    case ARGP_KEY_END:
        if (!request->verb)
            argp_error(state,
                       "say what to do: import, work, changed, verify, scrub, check or register");
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

static int complain(const struct gsn_error *err, int code)
{
    (void)fprintf(stderr, "gieson: %s\n", err->text);
    return gsn_code_exit(code);
}

static int usage(const char *sentence)
{
    (void)fprintf(stderr, "gieson: %s\n", sentence);
    return EX_USAGE;
}

static const char *actor(void)
{
    const char *user = getenv("SUDO_USER"); /* who asked, not whom they became */

    if (!user || !user[0])
        user = getenv("USER");
    return user && user[0] ? user : "gieson";
}

/* ---- import ------------------------------------------------------------------------------ */

static void say_notice(void *context, const char *name, const char *sentence)
{
    (void)context;
    (void)fprintf(stderr, "gieson: %s: %s\n", name, sentence);
}

static const char *base_name(const char *path)
{
    const char *slash = strrchr(path, '/');

    return slash ? slash + 1 : path;
}

/* The job that an operator would have written for a single file. gives. */
static char *job_for_file(const struct request *request, const char *file)
{
    const char *name = base_name(file);
    const char *dot = strrchr(name, '.');
    gsn_auto_mem(char) stem = gsn_format("%.*s", dot ? (int)(dot - name) : (int)strlen(name), name);
    json_t *job = json_pack("{s:s, s:s, s:s}", "specimen",
                            request->specimen ? request->specimen : (stem ? stem : name), "kind",
                            request->volume ? "volume" : "tile", "file", name);
    char *dumped, *text;

    if (request->thresholds)
        (void)json_object_set(job, "thresholds", request->thresholds);
    if (request->tile) {
        (void)json_object_set_new(job, "dyes", json_string("estimate"));
        (void)json_object_set_new(job, "transfer", json_string("srgb"));
        (void)json_object_set_new(job, "px_um", json_real(1));
        (void)json_object_set_new(job, "white", json_pack("[f, f, f]", 1.0, 1.0, 1.0));
    }
    if (request->tile && request->reference)
        (void)json_object_set_new(job, "reference", json_string(base_name(request->reference)));
    dumped = json_dumps(job, JSON_INDENT(2) | JSON_REAL_PRECISION(9));
    text = dumped ? gsn_strdup(dumped) : NULL;
    free(dumped); /* door */
    json_decref(job);
    return text;
}

static void print_import(const struct request *request, const char *specimen,
                         const struct gsn_import_counts *counts)
{
    if (request->json) {
        json_t *root = json_pack("{s:s, s:i, s:i, s:i, s:i}", "specimen", specimen, "panels_taken",
                                 counts->taken, "panels_again", counts->again, "panels_unnumbered",
                                 counts->held, "files", counts->attached);

        (void)json_dumpf(root, stdout, JSON_INDENT(2));
        (void)putchar('\n');
        json_decref(root);
        return;
    }
    (void)printf("%s:", specimen);
    if (counts->taken || counts->again || !counts->attached)
        (void)printf(" %u panel%s taken,", counts->taken, counts->taken == 1 ? "" : "s");
    if (counts->again)
        (void)printf(" %u here already,", counts->again);
    if (counts->attached)
        (void)printf(" %u file%s that the job names,", counts->attached,
                     counts->attached == 1 ? "" : "s");
    (void)printf(" `gieson run` works the queue\n");
}

static int do_import(const struct request *request)
{
    const char *file = request->volume ? request->volume : request->tile;
    gsn_auto_mem(char) folder = NULL;
    gsn_auto_mem(char) job = NULL;
    gsn_auto_mem(char) specimen = NULL;
    gsn_auto(gsn_store) store = NULL;
    struct gsn_import import = { .notice = say_notice, .replace = request->replace };
    struct gsn_import_counts counts;
    struct gsn_error err = { 0 };
    int r;

    if (!file && request->rest_count != 1)
        return usage("import needs one folder");
    if (file) {
        const int length = (int)(base_name(file) - file);

        folder = length ? gsn_format("%.*s", length > 1 ? length - 1 : 1, file) : gsn_strdup(".");
        job = job_for_file(request, file);
    } else {
        folder = gsn_strdup(request->rest[0]);
    }
    if (!folder || (file && !job))
        return usage("out of memory");
    r = gsn_store_open(request->store_dir, GSN_STORE_CREATE, &store, &err);
    if (r < 0)
        return complain(&err, r);
    import.store = store;
    import.dir = folder;
    import.job_text = job;
    import.actor = actor();
    r = gsn_import_folder(&import, &specimen, &counts, &err);
    if (r < 0)
        return complain(&err, r);
    print_import(request, specimen, &counts);
    return EX_OK;
}

/* ---- work and verify --------------------------------------------------------------------- */

/* The programs a job asks: their paths, or why there is none. */
struct helpers {
    char *mesher, *decoder, *lacks_mesher, *lacks_decoder, owner[64];
};

static void helpers_done(struct helpers *helpers)
{
    gsn_free(helpers->mesher);
    gsn_free(helpers->decoder);
    gsn_free(helpers->lacks_mesher);
    gsn_free(helpers->lacks_decoder);
}

/* One that is not there costs the jobs that need it, not the queue. */
static int find_helper(const char *name, char **ret_path, char **ret_lacks, struct gsn_error *err)
{
    struct gsn_error why = { 0 };
    const int r = gsn_process_sibling(name, ret_path, &why);

    if (r != GSN_E_NOTFOUND)
        return r < 0 ? gsn_fail(err, r, "%s", why.text) : r;
    *ret_lacks = gsn_format("%s; install gieson again with all its programs (apt-get install "
                            "--reinstall gieson), then `gieson retry`",
                            why.text);
    return *ret_lacks ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory");
}

static int job_options(const struct request *request, struct helpers *helpers,
                       struct gsn_job_options *ret_options, struct gsn_error *err)
{
    int r = find_helper("gieson-mesh", &helpers->mesher, &helpers->lacks_mesher, err);

    if (r >= 0)
        r = find_helper("gieson-decode", &helpers->decoder, &helpers->lacks_decoder, err);
    if (r < 0)
        return r;
    (void)snprintf(helpers->owner, sizeof helpers->owner, "gieson-work %ld", (long)getpid());
    *ret_options = (struct gsn_job_options){ .mesher = helpers->mesher,
                                             .decoder = helpers->decoder,
                                             .lacks_mesher = helpers->lacks_mesher,
                                             .lacks_decoder = helpers->lacks_decoder,
                                             .owner = helpers->owner,
                                             .threads = request->threads };
    return GSN_OK;
}

/* A wall that is not there must not go unnoticed. */
static void say_walls(void)
{
    if (gsn_sandbox_landlock() == 0)
        (void)fprintf(stderr, "gieson: this kernel has no Landlock: decoder and mesher are held by "
                              "their list of system calls alone\n");
}

static int do_work(const struct request *request)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_give_back) watch = NULL;
    __attribute__((cleanup(helpers_done))) struct helpers helpers = { .mesher = NULL };
    struct gsn_job_options how;
    struct gsn_error err = { 0 };
    int r = gsn_store_open(request->store_dir, GSN_STORE_WRITE, &store, &err);

    if (r >= 0)
        r = job_options(request, &helpers, &how, &err);
    if (r >= 0)
        r = gsn_give_back_new(request->store_dir, &watch, &err);
    if (r >= 0) {
        say_walls();
        r = gsn_job_next(store, &how, &err);
    }
    if (r == GSN_E_NOTFOUND || r == GSN_E_BUSY)
        return gsn_code_exit(r);
    return r < 0 ? complain(&err, r) : EX_OK;
}

/* A run by its number, or the latest of a specimen by its name. */
static int find_run(struct gsn_store *store, const char *text, int64_t *ret_run,
                    struct gsn_error *err)
{
    gsn_auto(gsn_specimen_row) specimen = NULL;
    gsn_auto(gsn_run_row) run = NULL;
    struct gsn_error quiet = { 0 };
    json_t *number = number_of(text);
    int r = gsn_specimen_get(store, text, &specimen, &quiet);

    if (r < 0 && json_is_integer(number)) {
        *ret_run = json_integer_value(number);
        json_decref(number);
        return GSN_OK;
    }
    json_decref(number);
    if (r < 0)
        return gsn_fail(err, r, "%s", quiet.text);
    r = gsn_run_latest(store, specimen->id, NULL, &run, err);
    if (r >= 0)
        *ret_run = run->id;
    return r;
}

/* The run's known head must still be in the diary, and no row before or after it changed. */
static int print_verdict(const struct request *request, const struct gsn_job_verdict *v,
                         const struct gsn_event_verdict *diary)
{
    const int whole = diary->broken == 0 && diary->head_is_there;
    const int same = v->same_inputs && v->same_json && v->same_html && whole;

    if (request->json) {
        json_t *root =
            json_pack("{s:I, s:b, s:b, s:b, s:b, s:b, s:I, s:s, s:s}", "run", (json_int_t)v->run,
                      "verified", same, "same_inputs", v->same_inputs, "same_json", v->same_json,
                      "same_html", v->same_html, "diary_whole", whole, "diary_events",
                      (json_int_t)diary->count, "json_sha256_was", v->was, "json_sha256_is", v->is);

        (void)json_dumpf(root, stdout, JSON_INDENT(2));
        (void)putchar('\n');
        json_decref(root);
    } else if (same) {
        (void)printf("run %lld: verified, report.json %.16s... and report.html are the same bytes, "
                     "the diary of %lld events is whole\n",
                     (long long)v->run, v->is, (long long)diary->count);
    } else {
        (void)printf("run %lld: NOT the same:%s%s%s%s\n", (long long)v->run,
                     v->same_inputs ? "" : " its inputs or this version of gieson changed;",
                     v->same_json ? "" : " report.json differs;",
                     v->same_html ? "" : " report.html differs;",
                     whole ? "" : " the diary was changed after it was written;");
    }
    return same ? EX_OK : 1;
}

static int do_verify(const struct request *request)
{
    gsn_auto(gsn_store) store = NULL;
    __attribute__((cleanup(helpers_done))) struct helpers helpers = { .mesher = NULL };
    struct gsn_job_options how;
    gsn_auto(gsn_run_row) row = NULL;
    struct gsn_job_verdict verdict;
    struct gsn_event_verdict diary;
    struct gsn_error err = { 0 };
    int64_t run = 0;
    int r;

    if (request->rest_count != 1)
        return usage("verify needs one run number or specimen");
    r = gsn_store_open(request->store_dir, GSN_STORE_WRITE, &store, &err);
    if (r >= 0)
        r = find_run(store, request->rest[0], &run, &err);
    if (r >= 0)
        r = job_options(request, &helpers, &how, &err);
    if (r >= 0)
        r = gsn_job_verify(store, run, &how, &verdict, &err);
    if (r >= 0)
        r = gsn_run_get(store, run, &row, &err);
    if (r >= 0)
        r = gsn_event_verify(store, row->event_head, &diary, &err);
    return r < 0 ? complain(&err, r) : print_verdict(request, &verdict, &diary);
}

/* ---- changed and scrub ------------------------------------------------------------------- */

static int do_changed(const struct request *request)
{
    gsn_auto(gsn_store) store = NULL;
    struct gsn_error err = { 0 };
    size_t count;
    int r = gsn_store_open(request->store_dir, GSN_STORE_WRITE, &store, &err);

    if (r >= 0)
        r = gsn_night_ask(store, &count, &err);
    return r < 0 ? complain(&err, r) : EX_OK;
}

static void say_damaged(void *context, const char *sha256, const char *sentence)
{
    json_t *list = context;

    (void)fprintf(stderr, "gieson: damaged: %s\n", sentence);
    (void)json_array_append_new(
        list, json_pack("{s:s, s:o}", "sha256", sha256, "message", json_string(sentence)));
}

static void print_scrub(const struct request *request, const struct gsn_scrub_counts *c,
                        json_t *damaged)
{
    if (request->json) {
        json_t *root = json_pack("{s:I, s:I, s:b, s:I, s:O}", "checked", (json_int_t)c->checked,
                                 "bytes", (json_int_t)c->bytes, "complete", c->complete,
                                 "round_checked", (json_int_t)c->round_checked, "damaged", damaged);

        (void)json_dumpf(root, stdout, JSON_INDENT(2));
        (void)putchar('\n');
        json_decref(root);
        return;
    }
    (void)printf("%lld objects (%.1f MB) read again, %lld damaged%s\n", (long long)c->checked,
                 1e-6 * (double)c->bytes, (long long)c->damaged,
                 c->complete ? "" : "; the next `gieson scrub` goes on from here");
}

/* Whoever works or looks at a screen goes first. */
static void step_back(void)
{
    enum { IOPRIO_WHO_PROCESS = 1, IOPRIO_CLASS_IDLE = 3, IOPRIO_CLASS_SHIFT = 13 };

    (void)setpriority(PRIO_PROCESS, 0, PRIO_MAX - 1);
    (void)syscall(SYS_ioprio_set, IOPRIO_WHO_PROCESS, 0, IOPRIO_CLASS_IDLE << IOPRIO_CLASS_SHIFT);
}

static int do_scrub(const struct request *request)
{
    gsn_auto(gsn_store) store = NULL;
    json_t *damaged = json_array();
    struct gsn_scrub scrub = {
        .actor = actor(), .minutes = request->minutes, .damaged = say_damaged, .context = damaged
    };
    struct gsn_scrub_counts counts = { 0 };
    struct gsn_error err = { 0 };
    int r = gsn_store_open(request->store_dir, GSN_STORE_WRITE, &store, &err);

    step_back();
    scrub.store = store;
    if (r >= 0)
        r = gsn_scrub_run(&scrub, &counts, &err);
    if (r >= 0)
        print_scrub(request, &counts, damaged);
    json_decref(damaged);
    if (r < 0)
        return complain(&err, r);
    return counts.damaged > 0 ? EX_DATAERR : EX_OK;
}

/* ---- check ------------------------------------------------------------------------------- */

static int check_one(const char *decoder, const char *path)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };
    size_t size;
    int r = gsn_file_read(path, MOST_CHECK_BYTES, &bytes, &size, &err);

    if (r >= 0)
        r = gsn_decode_apart(decoder, bytes, size, NULL, &picture, &err);
    if (r < 0) {
        (void)printf("%s: refused (%s): %s\n", path, gsn_code_name(r), err.text);
        return gsn_code_exit(r);
    }
    (void)printf("%s: fine: %s, %u x %u, %s, %u bit%s%s\n", path, picture->kind,
                 picture->image->width, picture->image->height,
                 picture->image->channels == 3 ? "RGB" : "grey", picture->image->bits,
                 picture->note[0] ? "; " : "", picture->note);
    return EX_OK;
}

static int do_check(const struct request *request)
{
    gsn_auto_mem(char) decoder = NULL;
    struct gsn_error err = { 0 };
    int status = EX_OK, r;

    if (request->rest_count < 1)
        return usage("check needs at least one file");
    r = gsn_process_sibling("gieson-decode", &decoder, &err);
    if (r < 0)
        return complain(&err, r);
    for (int i = 0; i < request->rest_count; i++) {
        r = check_one(decoder, request->rest[i]);

        if (r != EX_OK)
            status = r;
    }
    return status;
}

static int do_register(const struct request *request)
{
    const struct gsn_register_request folder = { .dir = request->rest[0],
                                                 .marks = request->marks,
                                                 .px_um = request->px_um,
                                                 .radius = request->radius,
                                                 .by_tissue = request->by_tissue,
                                                 .json = request->json };
    gsn_auto_mem(char) decoder = NULL;
    struct gsn_error err = { 0 };
    int status, r;

    if (request->rest_count != 1)
        return usage("register needs one folder of pictures");
    /* One section after the other works in the same pages. */
    (void)mallopt(M_MMAP_THRESHOLD, 32 << 20);
    (void)mallopt(M_TRIM_THRESHOLD, 256 << 20);
    r = gsn_process_sibling("gieson-decode", &decoder, &err);
    if (r < 0)
        return complain(&err, r);
    status = gsn_register_folder(&folder, decoder, &err);
    if (err.text[0])
        (void)fprintf(stderr, "gieson: %s\n", err.text);
    return status;
}

int main(int argc, char **argv)
{
    static const struct {
        const char *verb;
        int needs_store;
        int (*run)(const struct request *request);
    } verbs[] = { { "import", 1, do_import },    { "work", 1, do_work },
                  { "changed", 1, do_changed },  { "verify", 1, do_verify },
                  { "scrub", 1, do_scrub },      { "check", 0, do_check },
                  { "register", 0, do_register } };
    static const struct argp parser = { .options = options,
                                        .parser = take_option,
                                        .args_doc = "VERB [ARGUMENT...]",
                                        .doc = "Does one piece of gieson's work and ends." };
    gsn_auto_mem(char *) rest = gsn_alloc_array((size_t)argc, sizeof *rest);
    struct request request = { .store_dir = getenv("GIESON_STORE"), .rest = rest };
    int status = EX_USAGE;
    size_t i = 0;

    if (!rest)
        return EX_OSERR;
    if (argp_parse(&parser, argc, argv, ARGP_IN_ORDER, NULL, &request) != 0)
        return EX_USAGE;
    while (i < sizeof verbs / sizeof verbs[0] && strcmp(verbs[i].verb, request.verb) != 0)
        i++;
    if (i == sizeof verbs / sizeof verbs[0])
        status = usage(
            "this verb is not known: import, work, changed, verify, scrub, check or register");
    else if (verbs[i].needs_store && (!request.store_dir || !request.store_dir[0]))
        status = usage("no store: say --store DIR or set GIESON_STORE");
    else
        status = verbs[i].run(&request);
    json_decref(request.thresholds);
    return status;
}
