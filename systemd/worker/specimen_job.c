/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The job that takes a specimen from its inputs to its report.
 *
 * Steps.
 * 1. Load the inputs (job_inputs.h), hashed into the key of the run.
 * 2. Process (pipeline/specimen.h) into a folder of the run.
 * 3. In one transaction: measures, poses, stains, files with their hashes, the run's parameters for
 *    later comparisons, the seal, and the end of the job. audit-RUN.json is written before.
 * 4. Ask for the specimens whose baseline this is.
 * Where an older gieson looked at its panels, the job waits until they were looked at anew.
 *
 * How it fails: withheld results are a run with its sentence; a failure leaves no run behind that
 * counts. */
#include "systemd/worker/specimen_job.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "pipeline/core/mem.h"
#include "pipeline/decode/apart.h"
#include "pipeline/specimen/process.h"
#include "storage/audit_log.h"
#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/result.h"
#include "systemd/worker/audit.h"
#include "systemd/worker/baseline.h"
#include "systemd/worker/job_inputs.h"
#include "systemd/worker/panel_job.h"
#include "systemd/worker/store_index.h"

/* Where a report lies: reports/SPECIMEN/KEY, so that the same work makes the same files. */
struct place {
    char *html, *json; /* paths */
    struct gsn_digest html_is, json_is;
};

static void run_place_done(struct place *place)
{
    gsn_free(place->html);
    gsn_free(place->json);
}

/* What is kept beside the report. */
static int write_beside(const char *folder, const struct gsn_specimen_result *result,
                        struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < result->file_count; i++) {
        gsn_auto_mem(char) path = gsn_format("%s/%s", folder, result->file[i].name);

        r = path ? gsn_file_write(path, result->file[i].bytes, result->file[i].size, err)
                 : gsn_fail(err, GSN_E_NOMEM, "out of memory for the report's place");
    }
    return r;
}

static int write_files(struct gsn_store *store, const char *specimen, const char *key,
                       const struct gsn_specimen_result *result, struct place *place,
                       struct gsn_error *err)
{
    gsn_auto_mem(char) folder = NULL;
    gsn_auto_mem(char) of_run = NULL;
    int r = gsn_store_report_dir(store, specimen, &folder, err);

    if (r < 0)
        return r;
    of_run = gsn_format("%s/%.16s", folder, key);
    place->html = gsn_format("%s/%.16s/report.html", folder, key);
    place->json = gsn_format("%s/%.16s/report.json", folder, key);
    if (!of_run || !place->html || !place->json)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the report's place");
    r = gsn_file_mkdir(of_run, err);
    if (r >= 0)
        r = gsn_file_write(place->html, result->html, result->html_size, err);
    if (r >= 0)
        r = gsn_file_write(place->json, result->json, result->json_size, err);
    if (r >= 0)
        r = write_beside(of_run, result, err);
    if (r >= 0)
        r = gsn_sha256(result->html, result->html_size, &place->html_is, err);
    if (r >= 0)
        r = gsn_sha256(result->json, result->json_size, &place->json_is, err);
    return r;
}

/* Paths in rows are relative to the store, so that a store can be moved. */
static const char *relative_path(struct gsn_store *store, const char *path)
{
    const size_t length = strlen(gsn_store_dir(store));

    return strncmp(path, gsn_store_dir(store), length) == 0 ? path + length + 1 : path;
}

static int64_t panel_id_of(const struct gsn_panel_rows *panels, unsigned number)
{
    for (size_t i = 0; i < panels->count; i++)
        if (panels->at[i].number == number && strcmp(panels->at[i].state, "registered") == 0)
            return panels->at[i].id;
    return 0;
}

/* The result as rows. */
struct rows {
    struct gsn_measure_row *measure;
    size_t measure_count;
    char (*name)[96]; /* of the measures of named regions */
    struct gsn_pose_row *pose;
    struct gsn_stain_row *stain;
};

static void rows_done(struct rows *rows)
{
    gsn_free(rows->measure);
    gsn_free(rows->name);
    gsn_free(rows->pose);
    gsn_free(rows->stain);
}

static struct gsn_pose_row pose_row(const struct gsn_specimen_pose *p, int64_t panel)
{
    const struct gsn_affine *m = &p->pose.panel_to_block_um;

    return (struct gsn_pose_row){ .panel_id = panel,
                                  .slot = p->slot + 1,
                                  .serial = p->serial + 1,
                                  .m00 = m->m00,
                                  .m01 = m->m01,
                                  .m02 = m->m02,
                                  .m10 = m->m10,
                                  .m11 = m->m11,
                                  .m12 = m->m12,
                                  .flipped = p->pose.flipped,
                                  .rotated180 = p->pose.rotated180,
                                  .rms_um = p->pose.rms_um,
                                  .tre_um = p->pose.tre_um };
}

static struct gsn_stain_row stain_row(const struct gsn_specimen_stain *s, int64_t panel)
{
    struct gsn_stain_row row = { .panel_id = panel, .source = s->fit.dyes.name };

    for (size_t c = 0; c < 3; c++) {
        row.white[c] = s->white[c];
        row.vector[c] = s->fit.dyes.red[c];
        row.vector[3 + c] = s->fit.dyes.yellow[c];
        row.vector[6 + c] = s->fit.dyes.dark[c];
    }
    return row;
}

/* Those of the main region have the names that they have in the result. */
static void add_measures(const struct gsn_specimen_result *result, struct rows *rows)
{
    for (size_t i = 0; i < result->measure_count; i++) {
        const struct gsn_specimen_measure *m = &result->measure[i];
        char *name = rows->name[rows->measure_count];

        (void)snprintf(name, sizeof rows->name[0], "%s%c%s", result->name, GSN_SPECIMEN_IN_REGION,
                       m->name);
        rows->measure[rows->measure_count++] =
            (struct gsn_measure_row){ .name = result->name[0] ? name : m->name,
                                      .value = m->value,
                                      .lower = m->lower,
                                      .upper = m->upper,
                                      .unit = m->unit };
    }
}

static int make_rows(const struct gsn_specimen_result *result, const struct gsn_panel_rows *panels,
                     struct rows *rows, struct gsn_error *err)
{
    const size_t measures = (1 + result->part_count) * GSN_SPECIMEN_MEASURES;

    rows->measure = gsn_alloc_array(measures, sizeof *rows->measure);
    rows->name = gsn_alloc_array(measures, sizeof *rows->name);
    rows->pose = gsn_alloc_array(result->pose_count, sizeof *rows->pose);
    rows->stain = gsn_alloc_array(result->stain_count, sizeof *rows->stain);
    if (!rows->measure || !rows->name || !rows->pose || !rows->stain)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the rows of a result");
    add_measures(result, rows);
    for (size_t i = 0; i < result->part_count; i++)
        add_measures(result->part[i], rows);
    for (size_t i = 0; i < result->pose_count; i++)
        rows->pose[i] = pose_row(&result->pose[i], panel_id_of(panels, result->pose[i].panel));
    for (size_t i = 0; i < result->stain_count; i++)
        rows->stain[i] = stain_row(&result->stain[i], panel_id_of(panels, result->stain[i].panel));
    return GSN_OK;
}

int gsn_same_number(double a, double b)
{
    return memcmp(&a, &b, sizeof a) == 0 || (isnan(a) && isnan(b));
}

static int same_measures(const struct gsn_measure_rows *was, const struct gsn_measure_row *is,
                         size_t count)
{
    int ret = was->count == count;

    for (size_t i = 0; ret && i < count; i++)
        ret = strcmp(was->at[i].name, is[i].name) == 0 &&
              gsn_same_number(was->at[i].value, is[i].value) &&
              gsn_same_number(was->at[i].lower, is[i].lower) &&
              gsn_same_number(was->at[i].upper, is[i].upper) &&
              strcmp(was->at[i].unit, is[i].unit) == 0;
    return ret;
}

static int same_poses(const struct gsn_pose_rows *was, const struct gsn_pose_row *is, size_t count)
{
    int ret = was->count == count;

    for (size_t i = 0; ret && i < count; i++) {
        const struct gsn_pose_row *const a = &was->at[i], *const b = &is[i];

        ret = a->panel_id == b->panel_id && a->slot == b->slot && a->serial == b->serial &&
              a->flipped == b->flipped && a->rotated180 == b->rotated180 &&
              gsn_same_number(a->m00, b->m00) && gsn_same_number(a->m01, b->m01) &&
              gsn_same_number(a->m02, b->m02) && gsn_same_number(a->m10, b->m10) &&
              gsn_same_number(a->m11, b->m11) && gsn_same_number(a->m12, b->m12) &&
              gsn_same_number(a->rms_um, b->rms_um) && gsn_same_number(a->tre_um, b->tre_um);
    }
    return ret;
}

static int same_stains(const struct gsn_stain_rows *was, const struct gsn_stain_row *is,
                       size_t count)
{
    int ret = was->count == count;

    for (size_t i = 0; ret && i < count; i++) {
        ret = was->at[i].panel_id == is[i].panel_id && strcmp(was->at[i].source, is[i].source) == 0;
        for (size_t c = 0; ret && c < 3; c++)
            ret = gsn_same_number(was->at[i].white[c], is[i].white[c]);
        for (size_t c = 0; ret && c < 9; c++)
            ret = gsn_same_number(was->at[i].vector[c], is[i].vector[c]);
    }
    return ret;
}

int gsn_specimen_compare_rows(struct gsn_store *store, int64_t run,
                              const struct gsn_panel_rows *panels,
                              const struct gsn_specimen_result *result, gsn_audit_found *found,
                              void *context, struct gsn_error *err)
{
    gsn_auto(gsn_measure_rows) measures = NULL;
    gsn_auto(gsn_pose_rows) poses = NULL;
    gsn_auto(gsn_stain_rows) stains = NULL;
    gsn_auto_mem(char) what = gsn_format("run %lld", (long long)run);
    struct rows rows = { 0 };
    int r =
        what ? make_rows(result, panels, &rows, err) : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    if (r >= 0)
        r = gsn_measure_list(store, run, &measures, err);
    if (r >= 0)
        r = gsn_pose_list(store, run, &poses, err);
    if (r >= 0)
        r = gsn_stain_list(store, run, &stains, err);
    if (r >= 0 && !same_measures(measures, rows.measure, rows.measure_count))
        found(context, what, "its stored figures are not those that come out of the originals");
    if (r >= 0 && !same_poses(poses, rows.pose, result->pose_count))
        found(context, what, "its stored poses are not those that come out of the originals");
    if (r >= 0 && !same_stains(stains, rows.stain, result->stain_count))
        found(context, what, "its stored colours are not those that come out of the originals");
    rows_done(&rows);
    return r;
}

/* What there is to choose from, now that the stack is solved, in place of what each panel alone
 * showed. */
static int keep_candidates(struct gsn_store *store, const struct gsn_panel_rows *panels,
                           const struct gsn_specimen_result *result, struct gsn_error *err)
{
    const size_t most = result->candidates_count * GSN_CANDIDATES;
    gsn_auto_mem(struct gsn_candidate_row) rows = gsn_alloc_array(most, sizeof *rows);
    int r = rows ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for the candidates");

    for (size_t p = 0; r >= 0 && p < panels->count; p++) {
        size_t used = 0;

        if (strcmp(panels->at[p].state, "registered") != 0)
            continue;
        for (size_t i = 0; i < result->candidates_count; i++)
            if (panels->at[p].id == panel_id_of(panels, result->candidates[i].panel))
                used += gsn_candidates_to_rows(&result->candidates[i].list,
                                               result->candidates[i].slot + 1, &rows[used]);
        r = gsn_candidate_replace(store, panels->at[p].id, rows, used, err);
    }
    return r;
}

/* Run, rows, job and the requests that follow from them: all or nothing. */
static int commit_run(struct gsn_store *store, const struct gsn_job_row *job, int64_t run,
                      const struct gsn_run_end *end, const struct gsn_job_inputs *inputs,
                      const struct gsn_panel_rows *panels, const struct gsn_specimen_result *result,
                      struct gsn_error *err)
{
    gsn_auto(gsn_specimen_rows) dependents = NULL;
    int r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    r = gsn_run_finish(store, run, end, time(NULL), err);
    if (r >= 0 && result->pose_count > 0)
        r = keep_candidates(store, panels, result, err);
    if (r >= 0)
        r = gsn_event_add(store, time(NULL), "gieson-work", "run", job->specimen,
                          gsn_job_inputs_key(inputs), err);
    if (r >= 0)
        r = gsn_audit_write_beside(store, run, err);
    if (r >= 0)
        r = gsn_specimen_dependents(store, job->specimen_id, &dependents, err);
    for (size_t i = 0; r >= 0 && i < dependents->count; i++) {
        gsn_auto(gsn_run_row) latest = NULL;
        struct gsn_error quiet = { 0 };
        int64_t id;

        /* One that never ran waits for its own turn; one that rests on this result is up to date.
         */
        if (gsn_run_latest(store, dependents->at[i].id, NULL, &latest, &quiet) < 0 ||
            strstr(latest->inputs_json, gsn_job_inputs_own_key(inputs)))
            continue;
        r = gsn_queue_add(store, dependents->at[i].id, 0, &id, err);
    }
    if (r >= 0)
        r = gsn_queue_done(store, job, err);
    if (r < 0) {
        gsn_store_rollback(store);
        return r;
    }
    return gsn_store_commit(store, err);
}

static int finish_run(struct gsn_store *store, const struct gsn_job_row *job, int64_t run,
                      const struct gsn_job_inputs *inputs, const struct gsn_specimen_result *result,
                      struct gsn_error *err)
{
    gsn_auto(gsn_panel_rows) panels = NULL;
    struct place place = { 0 };
    struct rows rows = { 0 };
    struct gsn_run_end end = { .state = result->withheld ? "withheld" : "reported",
                               .message = result->message,
                               .pose_count = result->pose_count,
                               .stain_count = result->stain_count };
    struct gsn_digest head;
    int r = gsn_panel_list(store, job->specimen_id, &panels, err);

    if (r >= 0)
        r = make_rows(result, panels, &rows, err);
    if (r >= 0)
        r = write_files(store, job->specimen, gsn_job_inputs_key(inputs), result, &place, err);
    if (r >= 0)
        r = gsn_event_head(store, &head, err);
    if (r >= 0) {
        end.report_path = relative_path(store, place.html);
        end.report_sha256 = place.html_is.hex;
        end.json_path = relative_path(store, place.json);
        end.json_sha256 = place.json_is.hex;
        end.event_head = head.hex;
        end.measures = rows.measure;
        end.measure_count = rows.measure_count;
        end.poses = rows.pose;
        end.stains = rows.stain;
        r = commit_run(store, job, run, &end, inputs, panels, result, err);
        /* The next index makes it where this cannot. */
        if (r >= 0)
            (void)gsn_store_link_latest(store, relative_path(store, place.html), NULL);
    }
    rows_done(&rows);
    run_place_done(&place);
    return r;
}

/* ---- panels that an older gieson looked at ------------------------------------------------ */

/* In a transaction. The panel waits, so that one whose job fails is not asked for again and again.
 */
static int ask_again(struct gsn_store *store, const struct gsn_job_row *job,
                     const struct gsn_panel_rows *panels, struct gsn_error *err)
{
    int64_t id;
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < panels->count; i++) {
        if (!gsn_panel_lacks_turn(&panels->at[i]))
            continue;
        r = gsn_panel_set_state(store, panels->at[i].id, "waiting", NULL, NULL, err);
        if (r >= 0)
            r = gsn_queue_add(store, job->specimen_id, panels->at[i].id, &id, err);
    }
    if (r >= 0)
        r = gsn_queue_add(store, job->specimen_id, 0, &id, err);
    return r >= 0 ? gsn_queue_done(store, job, err) : r;
}

/* ret_asked: whether the job waits for panels now. */
static int ask_for_turns(struct gsn_store *store, const struct gsn_job_row *job, int *ret_asked,
                         struct gsn_error *err)
{
    gsn_auto(gsn_panel_rows) panels = NULL;
    int r = gsn_panel_list(store, job->specimen_id, &panels, err);

    *ret_asked = 0;
    for (size_t i = 0; r >= 0 && i < panels->count; i++)
        *ret_asked |= gsn_panel_lacks_turn(&panels->at[i]);
    if (r < 0 || !*ret_asked)
        return r;
    r = gsn_store_begin(store, err);
    if (r < 0)
        return r;
    r = ask_again(store, job, panels, err);
    if (r < 0) {
        gsn_store_rollback(store);
        return r;
    }
    return gsn_store_commit(store, err);
}

int gsn_specimen_job(struct gsn_store *store, const struct gsn_job_row *job,
                     const struct gsn_job_options *options, const struct gsn_progress *progress,
                     struct gsn_error *err)
{
    gsn_auto(gsn_decoder) decoder = NULL;
    struct gsn_specimen_options how = { .mesher = options->mesher,
                                        .threads = options->threads,
                                        .progress = progress };
    gsn_auto(gsn_job_inputs) inputs = NULL;
    gsn_auto(gsn_specimen_result) result = NULL;
    gsn_auto_mem(char) parameters = NULL;
    struct gsn_run_row run = { .specimen_id = job->specimen_id, .version = GSN_VERSION };
    int64_t id;
    int asked, r = ask_for_turns(store, job, &asked, err);

    if (r < 0 || asked)
        return r;
    if (options->decoder) {
        r = gsn_decoder_new(options->decoder, &decoder, err);
        how.decoder = decoder;
    }
    if (r >= 0)
        r = gsn_job_inputs_load(store, job->specimen_id, decoder, &inputs, err);
    if (r >= 0)
        r = gsn_specimen_process(gsn_job_inputs_specimen(inputs), &how, &result, err);
    if (r < 0)
        return r;
    parameters = gsn_run_parameters(gsn_job_inputs_own_key(inputs), result);
    if (!parameters)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the parameters of a run");
    run.key = gsn_job_inputs_key(inputs);
    run.inputs_json = gsn_job_inputs_json(inputs);
    run.parameters_json = parameters;
    r = gsn_run_begin(store, &run, time(NULL), &id, err);
    return r < 0 ? r : finish_run(store, job, id, inputs, result, err);
}
