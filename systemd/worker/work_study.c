/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verbs about many animals: `study` makes the page of one study or of all, and keeps what
 * people state of it in the audit log; `index` makes the front page of the store, and a copy of all
 * pages; `plan` says how many animals a difference needs. */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sysexits.h>
#include <time.h>

#include "pipeline/core/mem.h"
#include "storage/audit_log.h"
#include "storage/catalog.h"
#include "systemd/worker/store_index.h"
#include "systemd/worker/study.h"
#include "systemd/worker/work_verbs.h"

/* ---- the page ------------------------------------------------------------------------------ */

static void say_cell(const struct gsn_study_cell *cell)
{
    gsn_work_print(stdout, "%s", *cell->group ? cell->group : "(no group)");
    if (isfinite(cell->week))
        gsn_work_print(stdout, ", week %.9g", cell->week);
}

static void say_group(const struct gsn_study_cell *cell)
{
    (void)fputs("  ", stdout);
    say_cell(cell);
    gsn_work_print(stdout, "%s: n %zu, density %.3f", cell->is_control ? " (control)" : "",
                   cell->mean[0].n, cell->mean[0].mean);
    if (isfinite(cell->mean[0].sd))
        gsn_work_print(stdout, ", SD %.3f", cell->mean[0].sd);
    (void)fputs("\n", stdout);
}

static void say_comparison(const struct gsn_study *study, const struct gsn_study_comparison *c)
{
    char allows[256];

    (void)fputs(c->kind == GSN_STUDY_LOSS ? "  loss of " : "  ", stdout);
    say_cell(&study->cell[c->a]);
    gsn_work_print(stdout, " against %s%s: ", study->cell[c->b].group,
                   c->pooled ? " of all time points" : "");
    if (c->kind == GSN_STUDY_LOSS)
        gsn_work_print(stdout, "%.1f %%", c->loss.percent);
    else
        gsn_work_print(stdout, "difference %.3f", c->difference.difference);
    if (c->kind == GSN_STUDY_LOSS && isfinite(c->loss.lower))
        gsn_work_print(stdout, " (%.1f to %.1f)", c->loss.lower, c->loss.upper);
    else if (isfinite(c->difference.lower))
        gsn_work_print(stdout, " (%.3f to %.3f)", c->difference.lower, c->difference.upper);
    if (isfinite(c->difference.p))
        gsn_work_print(stdout, ", p %.2g, after Holm %.2g", c->difference.p, c->p_holm);
    gsn_study_allows(c, allows, sizeof allows);
    gsn_work_print(stdout, "%s%s\n", allows[0] ? "; " : "", allows);
}

static void say_study(const struct gsn_study *study, const char *folder)
{
    gsn_work_print(stdout, "%s: %zu animals%s%s%s\n", study->input.name, study->animal_count,
                   study->input.blind ? ", blind" : "", study->input.frozen ? ", frozen " : "",
                   study->input.frozen ? study->input.frozen : "");
    for (size_t c = 0; c < study->cell_count; c++)
        say_group(&study->cell[c]);
    for (size_t i = 0; i < study->comparison_count; i++)
        if (study->comparison[i].measure == 0)
            say_comparison(study, &study->comparison[i]);
    for (size_t i = 0; i < study->input.specimen_count; i++)
        if (study->input.specimen[i].left_out)
            gsn_work_print(stdout, "  left out: %s: %s\n", study->input.specimen[i].name,
                           study->input.specimen[i].left_out);
    gsn_work_print(stdout, "  %s/index.html\n", folder);
}

static int print_bytes(const struct gsn_study *study,
                       int (*make)(const struct gsn_study *, char **, size_t *, struct gsn_error *),
                       struct gsn_error *err)
{
    gsn_auto_mem(char) bytes = NULL;
    size_t size;
    const int r = make(study, &bytes, &size, err);

    if (r >= 0)
        (void)fwrite(bytes, 1, size, stdout);
    return r;
}

static int make_page(const struct gsn_work_request *request, struct gsn_store *store,
                     const char *name, struct gsn_error *err)
{
    gsn_auto(gsn_study_files) files = NULL;
    gsn_auto(gsn_study) study = NULL;
    gsn_auto_mem(char) folder = NULL;
    int r = gsn_study_gather(store, name, &files, err);

    if (r >= 0)
        r = gsn_study_read_cells(files, store, err);
    if (r >= 0)
        r = gsn_study_analyse(gsn_study_files_input(files), &study, err);
    if (r >= 0)
        r = gsn_study_write(store, study, &folder, err);
    if (r < 0)
        return r;
    if (request->quiet)
        return GSN_OK;
    if (request->csv)
        return print_bytes(study, gsn_study_csv, err);
    if (request->json)
        return print_bytes(study, gsn_study_json, err);
    say_study(study, folder);
    return GSN_OK;
}

/* One study that cannot be made costs only itself. */
static int make_all(const struct gsn_work_request *request, struct gsn_store *store)
{
    gsn_auto(gsn_study_names) names = NULL;
    struct gsn_error err = { 0 };
    int r = gsn_study_list(store, &names, &err), status = EX_OK;

    if (r < 0)
        return gsn_work_complain(request, &err, r);
    if (names->count == 0 && !request->quiet)
        gsn_work_print(stderr, "no specimen states a `study` in its job.json\n");
    if (request->json)
        (void)fputs("[\n", stdout);
    for (size_t i = 0; i < names->count; i++) {
        if (request->json && i > 0)
            (void)fputs(",\n", stdout);
        r = make_page(request, store, names->at[i], &err);
        if (r < 0) {
            status = gsn_work_complain(request, &err, r);
            if (request->json)
                (void)fputs("null\n", stdout);
        }
    }
    if (request->json)
        (void)fputs("]\n", stdout);
    return status;
}

/* ---- what people state --------------------------------------------------------------------- */

static int note_event(struct gsn_store *store, const char *kind, const char *subject,
                      const char *text, struct gsn_error *err)
{
    const struct gsn_actor who = gsn_actor_now();

    return gsn_event_add(store, (int64_t)time(NULL), who.name, kind, subject, text, err);
}

static int is_of_study(const struct gsn_study_input *input, const char *specimen)
{
    for (size_t i = 0; i < input->specimen_count; i++)
        if (strcmp(input->specimen[i].name, specimen) == 0)
            return 1;
    return 0;
}

/* Excludes a specimen or takes it back. */
static int change_exclusion(struct gsn_store *store, const struct gsn_study_files *files,
                            const char *kind, const char *specimen, const char *because,
                            struct gsn_error *err)
{
    const struct gsn_study_input *const input = gsn_study_files_input(files);
    gsn_auto(gsn_specimen_row) row = NULL;
    int r = gsn_specimen_get(store, specimen, &row, err);

    if (r < 0)
        return r;
    if (!input->blind && !is_of_study(input, specimen))
        return gsn_fail(err, GSN_E_INPUT, "%s is of study \"%s\", not \"%s\"", specimen, row->study,
                        input->name);
    if (gsn_study_is_frozen(files))
        return gsn_fail(err, GSN_E_INPUT,
                        "the analysis of %s is frozen (%s): who takes part can no longer change",
                        input->name, input->frozen);
    if (strcmp(kind, GSN_STUDY_EXCLUDE) == 0 && !because)
        return gsn_fail(err, GSN_E_INPUT,
                        "say why: `gieson study %s exclude %s --because \"the block broke\"`",
                        input->name, specimen);
    return note_event(store, kind, specimen, because ? because : "", err);
}

static int change_state(struct gsn_store *store, const struct gsn_study_files *files,
                        const char *kind, struct gsn_error *err)
{
    const struct gsn_study_input *const input = gsn_study_files_input(files);

    if (strcmp(kind, GSN_STUDY_UNBLIND) == 0 && !gsn_study_is_frozen(files))
        return gsn_fail(err, GSN_E_INPUT,
                        "the groups of %s are shown once its analysis is frozen: `gieson study %s "
                        "freeze` first",
                        input->name, input->name);
    if (strcmp(kind, GSN_STUDY_FREEZE) == 0 && gsn_study_is_frozen(files))
        return gsn_fail(err, GSN_E_INPUT, "the analysis of %s was frozen %s", input->name,
                        input->frozen);
    return note_event(store, kind, input->name,
                      strcmp(kind, GSN_STUDY_FREEZE) == 0 ? gsn_study_files_digest(files) : "",
                      err);
}

static int state_change(const struct gsn_work_request *request, struct gsn_store *store,
                        struct gsn_error *err)
{
    const char *const kind = request->rest[1];
    const int of_specimen =
        strcmp(kind, GSN_STUDY_EXCLUDE) == 0 || strcmp(kind, GSN_STUDY_INCLUDE) == 0;
    const int of_study = strcmp(kind, GSN_STUDY_BLIND) == 0 ||
                         strcmp(kind, GSN_STUDY_FREEZE) == 0 ||
                         strcmp(kind, GSN_STUDY_UNBLIND) == 0;
    gsn_auto(gsn_study_files) files = NULL;
    int r;

    if ((!of_specimen && !of_study) || request->rest_count != 2 + of_specimen)
        return gsn_fail(err, GSN_E_INPUT,
                        "behind the study's name may stand: blind, freeze, unblind, exclude "
                        "SPECIMEN --because WHY, include SPECIMEN");
    r = gsn_study_gather(store, request->rest[0], &files, err);
    if (r < 0)
        return r;
    return of_specimen
               ? change_exclusion(store, files, kind, request->rest[2], request->because, err)
               : change_state(store, files, kind, err);
}

int gsn_work_study(const struct gsn_work_request *request)
{
    gsn_auto(gsn_store) store = NULL;
    struct gsn_error err = { 0 };
    int r = gsn_store_open(request->store_dir, GSN_STORE_WRITE, &store, &err);

    if (r >= 0 && request->rest_count == 0)
        return make_all(request, store);
    if (r >= 0 && request->rest_count > 1)
        r = state_change(request, store, &err);
    if (r >= 0)
        r = make_page(request, store, request->rest[0], &err);
    return r < 0 ? gsn_work_complain(request, &err, r) : EX_OK;
}

/* ---- the front page ------------------------------------------------------------------------- */

int gsn_work_index(const struct gsn_work_request *request)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto_mem(char) page = NULL;
    struct gsn_error err = { 0 };
    int r;

    if (request->rest_count > 0)
        return gsn_work_usage(request,
                              "say `gieson index`, with --publish FOLDER to copy all pages there");
    r = gsn_store_open(request->store_dir, GSN_STORE_READ, &store, &err);
    if (r >= 0)
        r = gsn_store_index_write(store, &err);
    if (r >= 0 && request->publish)
        r = gsn_store_publish(store, request->publish, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    if (request->quiet)
        return EX_OK;
    page = gsn_format("%s/index.html", request->publish ? request->publish : gsn_store_dir(store));
    if (!page)
        return EX_OSERR;
    if (request->json) {
        json_t *row = json_pack("{s:o}", "page", gsn_work_text(page));

        (void)json_dumpf(row, stdout, JSON_INDENT(2));
        (void)fputs("\n", stdout);
        json_decref(row);
    } else {
        gsn_work_print(stdout, "%s\n", page);
    }
    return EX_OK;
}

/* ---- how many animals ---------------------------------------------------------------------- */

/* A number above zero of the command line, or the default where it is not said; 0: it is none. */
static double read_positive(const char *said, double otherwise)
{
    json_t *number = said ? gsn_work_number(said) : NULL;
    const double value = json_is_number(number) ? json_number_value(number) : 0;

    json_decref(number);
    return !said ? otherwise : value > 0 && value < 1e6 ? value : 0;
}

/* The spread between animals of a study, per cent of the control: of the main measure, over all
 * groups with two animals or more; NaN without any. */
static double find_spread(const struct gsn_study *study)
{
    double sum = 0, freedom = 0, control = NAN;

    for (size_t c = 0; c < study->cell_count; c++) {
        const struct gsn_group_mean *const mean = &study->cell[c].mean[0];

        if (study->cell[c].is_control && !isfinite(control))
            control = mean->mean;
        if (mean->n >= 2) {
            sum += (double)(mean->n - 1) * mean->sd * mean->sd;
            freedom += (double)(mean->n - 1);
        }
    }
    return freedom > 0 ? 100 * sqrt(sum / freedom) / control : NAN;
}

static int read_spread(const struct gsn_work_request *request, double *ret_sd,
                       struct gsn_error *err)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_study_files) files = NULL;
    gsn_auto(gsn_study) study = NULL;
    int r;

    if (!request->store_dir || !request->store_dir[0])
        return gsn_fail(err, GSN_E_INPUT, "no store: say --store DIR or set GIESON_STORE");
    r = gsn_store_open(request->store_dir, GSN_STORE_READ, &store, err);
    if (r >= 0)
        r = gsn_study_gather(store, request->rest[0], &files, err);
    if (r >= 0)
        r = gsn_study_analyse(gsn_study_files_input(files), &study, err);
    if (r < 0)
        return r;
    *ret_sd = find_spread(study);
    if (!isfinite(*ret_sd))
        return gsn_fail(
            err, GSN_E_WITHHELD,
            "study %s has no group of two animals yet, so nobody knows what they differ "
            "by: state --sd",
            request->rest[0]);
    return GSN_OK;
}

static void print_plan(const struct gsn_work_request *request, double difference, double sd,
                       double power)
{
    const size_t n = gsn_animals_needed(difference / sd, 0.05, power);

    if (request->json) {
        (void)printf("{\"difference_percent\": %.9g, \"sd_percent\": %.9g, \"alpha\": 0.05, "
                     "\"power\": %.9g, \"animals_per_group\": ",
                     difference, sd, power);
        (void)(n ? printf("%zu}\n", n) : printf("null}\n"));
        return;
    }
    if (n == 0) {
        (void)printf("more than 10000 animals a group: a difference of %.9g points cannot be found "
                     "among animals that differ by %.3g\n",
                     difference, sd);
        return;
    }
    (void)printf("%zu animals a group find a loss that is %.9g points larger than another's, or "
                 "than none,\nwith a probability of %.0f %% (two-sided 5 %%; animals differ by an "
                 "SD of %.3g points)\n",
                 n, difference, 100 * gsn_power(difference / sd, n, 0.05), sd);
    for (size_t few = n > 4 ? n - 3 : 2; few < n; few++)
        (void)printf("%zu would find it with %.0f %%\n", few,
                     100 * gsn_power(difference / sd, few, 0.05));
}

int gsn_work_plan(const struct gsn_work_request *request)
{
    const double difference = read_positive(request->difference, 0);
    const double power = read_positive(request->power, 0.8);
    double sd = read_positive(request->sd, 0);
    struct gsn_error err = { 0 };
    int r = GSN_OK;

    if (!(difference > 0) || !(power > 0 && power < 1) || (request->sd && !(sd > 0)) ||
        request->rest_count > 1 || (request->rest_count == 1) == (request->sd != NULL))
        return gsn_work_usage(request,
                              "say `gieson plan --difference POINTS --sd POINTS`, or the name of a "
                              "study in place of --sd; --power is between 0 and 1");
    if (!request->sd)
        r = read_spread(request, &sd, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    print_plan(request, difference, sd, power);
    return EX_OK;
}
