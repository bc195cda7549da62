/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Steps. 1. The specimen's last run that left a report. 2. report.json, its hash held against the
 * run's row. 3. A file beside it, its hash held against the report's provenance.
 *
 * Failure: each step says what is missing or changed, and the command to give next.
 * Cost: each file is read twice, once for its hash. */
#include "systemd/worker/kept_run.h"

#include <string.h>

#include "pipeline/core/file.h"
#include "storage/audit.h"
#include "storage/catalog.h"

enum { MOST_REPORT_BYTES = 1 << 28 };

static const size_t MOST_FILE_BYTES = (size_t)1 << 34;

void gsn_kept_run_free(struct gsn_kept_run *kept)
{
    if (!kept)
        return;
    gsn_run_row_free(kept->run);
    json_decref(kept->report);
    gsn_free(kept);
}

/* gives: a file of the store that has this hash. */
static int read_checked(struct gsn_store *store, const struct gsn_run_row *run,
                        const char *relative, const char *sha256, size_t limit, uint8_t **ret_bytes,
                        size_t *ret_size, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", gsn_store_dir(store), relative);
    struct gsn_error why = { 0 };
    const int r = gsn_audit_file(store, relative, sha256, &why);

    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a path");
    if (r < 0)
        return gsn_fail(err, r, "%s; it is not used. `gieson verify %lld` says what else changed",
                        why.text, (long long)run->id);
    return gsn_file_read(path, limit, ret_bytes, ret_size, err);
}

int gsn_kept_run_open(struct gsn_store *store, const char *specimen, struct gsn_kept_run **ret_kept,
                      struct gsn_error *err)
{
    gsn_auto(gsn_kept_run) kept = gsn_alloc_array(1, sizeof *kept);
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0;
    int r;

    if (!kept)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a run");
    r = gsn_run_latest_report(store, specimen, &kept->run, err);
    if (r >= 0)
        r = read_checked(store, kept->run, kept->run->json_path, kept->run->json_sha256,
                         MOST_REPORT_BYTES, &bytes, &size, err);
    if (r < 0)
        return r;
    kept->report = json_loadb((const char *)bytes, size, 0, NULL);
    if (!kept->report)
        return gsn_fail(err, GSN_E_INPUT, "%s is no JSON", kept->run->json_path);
    *ret_kept = gsn_steal(&kept);
    return GSN_OK;
}

/* Why there is no such file, and what to do. */
static int say_missing(const struct gsn_kept_run *kept, const char *name, struct gsn_error *err)
{
    const char *kind = json_string_value(json_object_get(kept->report, "kind"));
    const char *specimen = json_string_value(json_object_get(kept->report, "specimen"));
    const int is_model = strcmp(name, "model.vtkhdf") == 0;
    const long long run = (long long)kept->run->id;

    if (!kind || !specimen)
        return gsn_fail(err, GSN_E_INPUT, "%s is no report", kept->run->json_path);
    if (strcmp(kind, "tile") == 0)
        return gsn_fail(err, GSN_E_NOTFOUND,
                        "%s is one picture: only sections and volumes have a %s", specimen,
                        is_model ? "model" : "stack");
    if (!is_model && strcmp(kind, "volume") == 0)
        return gsn_fail(err, GSN_E_NOTFOUND,
                        "%s is a volume and has no stack of sections in colour: export a .nrrd",
                        specimen);
    if (strcmp(kept->run->state, "withheld") == 0)
        return gsn_fail(err, GSN_E_NOTFOUND,
                        "run %lld of %s kept no %s, it was withheld: %.200s. `gieson show %s` says "
                        "what to do",
                        run, specimen, name, kept->run->message, specimen);
    return gsn_fail(err, GSN_E_NOTFOUND,
                    "run %lld of %s, by gieson %s, kept no %s: `gieson night` computes it again",
                    run, specimen, kept->run->version, name);
}

int gsn_kept_run_file(struct gsn_store *store, const struct gsn_kept_run *kept, const char *name,
                      uint8_t **ret_bytes, size_t *ret_size, struct gsn_error *err)
{
    const json_t *const provenance = json_object_get(kept->report, "provenance");
    const json_t *const outputs = json_object_get(provenance, "outputs");
    const char *const slash = strrchr(kept->run->json_path, '/');
    gsn_auto_mem(char) relative = NULL;
    const json_t *output;
    size_t i;

    json_array_foreach(outputs, i, output)
    {
        const char *const said = json_string_value(json_object_get(output, "name"));
        const char *const sha256 = json_string_value(json_object_get(output, "sha256"));

        if (!said || !sha256 || !slash || strcmp(said, name) != 0)
            continue;
        relative =
            gsn_format("%.*s/%s", (int)(slash - kept->run->json_path), kept->run->json_path, name);
        if (!relative)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for a path");
        return read_checked(store, kept->run, relative, sha256, MOST_FILE_BYTES, ret_bytes,
                            ret_size, err);
    }
    return say_missing(kept, name, err);
}

int gsn_kept_run_model(struct gsn_store *store, const struct gsn_kept_run *kept,
                       struct gsn_model **ret_model, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0;
    const int r = gsn_kept_run_file(store, kept, "model.vtkhdf", &bytes, &size, err);

    return r < 0 ? r : gsn_model_file_read(bytes, size, ret_model, err);
}
