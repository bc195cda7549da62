/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Specimens, the files their jobs name, and which objects rows rest on.
 *
 * A specimen is its job.json and the hash of it; the same again changes nothing, another text under
 * the same name is a clash that the caller allows or not. Attachments are names for objects. The
 * lists of objects go over panels, scans and attachments, each object once, in the order of
 * digests, so that a round through all of them can stop and go on (worker/scrub.c). */
#include "storage/catalog.h"

#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "storage/audit_log.h"
#include "storage/sql.h"

#define FIELD(type, name)                                                                          \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_specimen_row, name)                                    \
    }
static const struct gsn_sql_field specimen_fields[] = {
    FIELD(INT, id),        FIELD(TEXT, name),       FIELD(TEXT, study), FIELD(TEXT, group),
    FIELD(TEXT, animal),   FIELD(REAL, week),       FIELD(TEXT, kind),  FIELD(TEXT, baseline),
    FIELD(TEXT, job_json), FIELD(TEXT, job_sha256),
};

#undef FIELD

#define SELECT_SPECIMEN                                                                            \
    "SELECT s.id, s.name, y.name, g.name, a.name, s.week, s.kind, s.baseline, s.job_json, "        \
    "s.job_sha256 FROM specimen s JOIN study y ON y.id = s.study_id "                              \
    "JOIN study_group g ON g.id = s.group_id JOIN animal a ON a.id = s.animal_id "

static const struct gsn_sql_shape specimen_shape =
    SQL_SHAPE(struct gsn_specimen_row, specimen_fields);

SQL_DEFINE_ROW(specimen);
SQL_DEFINE_ROWS(specimen);

/* Specimens. */

static int not_found_means(int r, struct gsn_error *err, const char *name)
{
    if (r == GSN_E_NOTFOUND)
        return gsn_fail(err, r, "there is no specimen %s: `gieson status` lists them", name);
    return r;
}

int gsn_specimen_get(struct gsn_store *store, const char *name,
                     struct gsn_specimen_row **ret_specimen, struct gsn_error *err)
{
    const int r = specimen_row(store, SELECT_SPECIMEN "WHERE s.name = ?1", SQL_ARGS(SQL_TEXT(name)),
                               ret_specimen, err);

    return not_found_means(r, err, name);
}

int gsn_specimen_get_by_id(struct gsn_store *store, int64_t id,
                           struct gsn_specimen_row **ret_specimen, struct gsn_error *err)
{
    const int r = specimen_row(store, SELECT_SPECIMEN "WHERE s.id = ?1", SQL_ARGS(SQL_INT(id)),
                               ret_specimen, err);

    return not_found_means(r, err, "of that number");
}

int gsn_specimen_list(struct gsn_store *store, struct gsn_specimen_rows **ret_rows,
                      struct gsn_error *err)
{
    return specimen_rows(store, SELECT_SPECIMEN "ORDER BY s.id", SQL_NO_ARGS, ret_rows, err);
}

int gsn_specimen_baseline(struct gsn_store *store, const char *study, const char *baseline,
                          struct gsn_specimen_rows **ret_rows, struct gsn_error *err)
{
    return specimen_rows(store,
                         SELECT_SPECIMEN
                         "WHERE ?2 <> '' AND (s.name = ?2 OR (y.name = ?1 AND g.name = ?2 AND NOT "
                         "EXISTS (SELECT 1 FROM specimen o WHERE o.name = ?2))) ORDER BY s.id",
                         SQL_ARGS(SQL_TEXT(study), SQL_TEXT(baseline)), ret_rows, err);
}

int gsn_specimen_dependents(struct gsn_store *store, int64_t specimen_id,
                            struct gsn_specimen_rows **ret_rows, struct gsn_error *err)
{
    return specimen_rows(
        store,
        SELECT_SPECIMEN
        "JOIN specimen me ON me.id = ?1 JOIN study_group mine ON mine.id = me.group_id "
        "WHERE s.id <> me.id AND s.baseline <> '' AND (s.baseline = me.name OR "
        "(s.study_id = me.study_id AND s.baseline = mine.name AND NOT EXISTS "
        "(SELECT 1 FROM specimen o WHERE o.name = s.baseline))) ORDER BY s.id",
        SQL_ARGS(SQL_INT(specimen_id)), ret_rows, err);
}

/* The ids of its study, group and animal, made when missing. */
struct places {
    int64_t study, group, animal;
};

static int find_places(struct gsn_store *store, const struct gsn_specimen_row *specimen,
                       struct places *places, struct gsn_error *err)
{
    const struct gsn_sql_args study = SQL_ARGS(SQL_TEXT(specimen->study));
    int r = gsn_sql_run(store, "INSERT INTO study (name) VALUES (?1) ON CONFLICT DO NOTHING", study,
                        NULL, err);

    if (r >= 0)
        r = gsn_sql_int(store, "SELECT id FROM study WHERE name = ?1", study, &places->study, err);
    if (r < 0)
        return r;

    const struct gsn_sql_args group = SQL_ARGS(SQL_INT(places->study), SQL_TEXT(specimen->group));
    const struct gsn_sql_args animal = SQL_ARGS(SQL_INT(places->study), SQL_TEXT(specimen->animal));

    r = gsn_sql_run(store,
                    "INSERT INTO study_group (study_id, name) VALUES (?1, ?2) "
                    "ON CONFLICT DO NOTHING",
                    group, NULL, err);
    if (r >= 0)
        r = gsn_sql_int(store, "SELECT id FROM study_group WHERE study_id = ?1 AND name = ?2",
                        group, &places->group, err);
    if (r >= 0)
        r = gsn_sql_run(store,
                        "INSERT INTO animal (study_id, name) VALUES (?1, ?2) "
                        "ON CONFLICT DO NOTHING",
                        animal, NULL, err);
    if (r >= 0)
        r = gsn_sql_int(store, "SELECT id FROM animal WHERE study_id = ?1 AND name = ?2", animal,
                        &places->animal, err);
    return r;
}

/* Inserts, or updates the row of the same name. */
static int write_specimen(struct gsn_store *store, const struct gsn_specimen_row *specimen,
                          const struct gsn_digest *digest, int64_t *ret_id, struct gsn_error *err)
{
    struct places places = { 0 };
    int r = find_places(store, specimen, &places, err);

    if (r < 0)
        return r;
    r = gsn_sql_run(
        store,
        "INSERT INTO specimen (name, study_id, group_id, animal_id, week, kind, baseline, "
        "job_json, job_sha256) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9) "
        "ON CONFLICT (name) DO UPDATE SET study_id = excluded.study_id, "
        "group_id = excluded.group_id, animal_id = excluded.animal_id, week = excluded.week, "
        "kind = excluded.kind, baseline = excluded.baseline, job_json = excluded.job_json, "
        "job_sha256 = excluded.job_sha256",
        SQL_ARGS(SQL_TEXT(specimen->name), SQL_INT(places.study), SQL_INT(places.group),
                 SQL_INT(places.animal), SQL_REAL(specimen->week), SQL_TEXT(specimen->kind),
                 SQL_TEXT(specimen->baseline), SQL_TEXT(specimen->job_json), SQL_TEXT(digest->hex)),
        NULL, err);
    if (r < 0)
        return r;
    return gsn_sql_int(store, "SELECT id FROM specimen WHERE name = ?1",
                       SQL_ARGS(SQL_TEXT(specimen->name)), ret_id, err);
}

/* In a transaction. */
static int put_specimen(struct gsn_store *store, const struct gsn_specimen_row *specimen,
                        enum gsn_specimen_clash clash, const char *actor, int64_t now,
                        const struct gsn_digest *digest, int64_t *ret_id, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_row) old = NULL;
    int r = gsn_specimen_get(store, specimen->name, &old, err);

    if (r == GSN_E_NOTFOUND)
        return write_specimen(store, specimen, digest, ret_id, err);
    if (r < 0)
        return r;
    if (strcmp(old->job_json, specimen->job_json) == 0) {
        *ret_id = old->id;
        return GSN_OK;
    }
    if (clash == GSN_SPECIMEN_REFUSE)
        return gsn_fail(err, GSN_E_INPUT,
                        "specimen %.200s exists with other settings (%.8s, now %.8s): use another "
                        "name or `gieson import --replace`",
                        specimen->name, old->job_sha256, digest->hex);
    r = gsn_event_add(store, now, actor, "replace", specimen->name, old->job_json, err);
    return r >= 0 ? write_specimen(store, specimen, digest, ret_id, err) : r;
}

int gsn_specimen_put(struct gsn_store *store, const struct gsn_specimen_row *specimen,
                     enum gsn_specimen_clash clash, const char *actor, int64_t now, int64_t *ret_id,
                     struct gsn_error *err)
{
    struct gsn_digest digest;
    int64_t id = 0;
    int r = gsn_sha256(specimen->job_json, strlen(specimen->job_json), &digest, err);

    if (r >= 0 && !*specimen->name)
        r = gsn_fail(err, GSN_E_INPUT, "a specimen needs a name");
    if (r >= 0)
        r = gsn_store_begin(store, err);
    if (r < 0)
        return r;
    r = gsn_sql_end(store, put_specimen(store, specimen, clash, actor, now, &digest, &id, err),
                    err);
    if (r >= 0)
        *ret_id = id;
    return r;
}

static const struct gsn_sql_field attachment_fields[] = {
    { GSN_SQL_TEXT, offsetof(struct gsn_attachment_row, name) },
    { GSN_SQL_TEXT, offsetof(struct gsn_attachment_row, sha256) },
    { GSN_SQL_INT, offsetof(struct gsn_attachment_row, size) },
};
static const struct gsn_sql_shape attachment_shape =
    SQL_SHAPE(struct gsn_attachment_row, attachment_fields);

SQL_DEFINE_ROWS(attachment);

/* Attachments. */

int gsn_attachment_put(struct gsn_store *store, int64_t specimen_id,
                       const struct gsn_attachment_row *row, int *ret_again, struct gsn_error *err)
{
    int64_t changed = 0;
    const int r = gsn_sql_run(
        store,
        "INSERT INTO attachment (specimen_id, name, sha256, size) VALUES (?1, ?2, ?3, ?4) "
        "ON CONFLICT (specimen_id, name) DO UPDATE SET sha256 = excluded.sha256, "
        "size = excluded.size WHERE sha256 <> excluded.sha256",
        SQL_ARGS(SQL_INT(specimen_id), SQL_TEXT(row->name), SQL_TEXT(row->sha256),
                 SQL_INT(row->size)),
        &changed, err);

    if (r >= 0)
        *ret_again = changed == 0;
    return r;
}

int gsn_attachment_list(struct gsn_store *store, int64_t specimen_id,
                        struct gsn_attachment_rows **ret_rows, struct gsn_error *err)
{
    return attachment_rows(store,
                           "SELECT name, sha256, size FROM attachment WHERE specimen_id = ?1 "
                           "ORDER BY name",
                           SQL_ARGS(SQL_INT(specimen_id)), ret_rows, err);
}

static const struct gsn_sql_field object_fields[] = {
    { GSN_SQL_TEXT, offsetof(struct gsn_object_row, sha256) },
    { GSN_SQL_INT, offsetof(struct gsn_object_row, size) },
};
static const struct gsn_sql_shape object_shape = SQL_SHAPE(struct gsn_object_row, object_fields);

static const struct gsn_sql_field object_use_fields[] = {
    { GSN_SQL_TEXT, offsetof(struct gsn_object_use_row, specimen) },
    { GSN_SQL_TEXT, offsetof(struct gsn_object_use_row, name) },
};
static const struct gsn_sql_shape object_use_shape =
    SQL_SHAPE(struct gsn_object_use_row, object_use_fields);

SQL_DEFINE_ROWS(object);
SQL_DEFINE_ROWS(object_use);

/* Objects. */

int gsn_object_list(struct gsn_store *store, const char *after, size_t most,
                    struct gsn_object_rows **ret_rows, struct gsn_error *err)
{
    return object_rows(store,
                       "SELECT sha256, max(size) FROM ("
                       "SELECT sha256, size FROM panel WHERE sha256 > ?1 "
                       "UNION ALL SELECT sha256, size FROM attachment WHERE sha256 > ?1 "
                       "UNION ALL SELECT sha256, size FROM scan WHERE sha256 > ?1) "
                       "GROUP BY sha256 ORDER BY sha256 LIMIT ?2",
                       SQL_ARGS(SQL_TEXT(after), SQL_INT((int64_t)most)), ret_rows, err);
}

int gsn_object_uses(struct gsn_store *store, const char *sha256,
                    struct gsn_object_use_rows **ret_rows, struct gsn_error *err)
{
    return object_use_rows(
        store,
        "SELECT s.name, p.file_name FROM panel p JOIN specimen s ON s.id = p.specimen_id "
        "WHERE p.sha256 = ?1 "
        "UNION ALL SELECT s.name, a.name FROM attachment a JOIN specimen s "
        "ON s.id = a.specimen_id WHERE a.sha256 = ?1 "
        "UNION ALL SELECT '', name FROM scan WHERE sha256 = ?1 AND panel_id IS NULL",
        SQL_ARGS(SQL_TEXT(sha256)), ret_rows, err);
}

enum { MOST_OBJECT_BYTES = 1 << 30 };

static int check_digest(const char *sha256, const struct gsn_digest *digest, struct gsn_error *err)
{
    if (strcmp(digest->hex, sha256) == 0)
        return GSN_OK;
    return gsn_fail(err, GSN_E_IO,
                    "the stored object %s is damaged: its bytes no longer have this hash; "
                    "import the original again",
                    sha256);
}

int gsn_object_read(struct gsn_store *store, const char *sha256, uint8_t **ret_bytes,
                    size_t *ret_size, struct gsn_error *err)
{
    gsn_auto_mem(char) path = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_digest digest;
    size_t size;
    int r = gsn_store_object_path(store, sha256, &path, err);

    if (r >= 0)
        r = gsn_file_read(path, MOST_OBJECT_BYTES, &bytes, &size, err);
    if (r >= 0)
        r = gsn_sha256(bytes, size, &digest, err);
    if (r >= 0)
        r = check_digest(sha256, &digest, err);
    if (r < 0)
        return r;
    *ret_bytes = gsn_steal(&bytes);
    *ret_size = size;
    return GSN_OK;
}

int gsn_object_open(struct gsn_store *store, const char *sha256, int *ret_fd, struct gsn_error *err)
{
    gsn_auto_mem(char) path = NULL;
    gsn_auto_fd fd = -1;
    struct gsn_digest digest;
    int r = gsn_store_object_path(store, sha256, &path, err);

    if (r >= 0)
        r = gsn_file_open(path, &fd, err);
    if (r >= 0)
        r = gsn_sha256_file(fd, path, &digest, NULL, err);
    if (r >= 0)
        r = check_digest(sha256, &digest, err);
    if (r < 0)
        return r;
    *ret_fd = fd;
    fd = -1;
    return GSN_OK;
}
