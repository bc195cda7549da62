/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/attachment.h"

#include "storage/sql.h"

static const struct gsn_sql_field attachment_fields[] = {
    { GSN_SQL_TEXT, offsetof(struct gsn_attachment_row, name) },
    { GSN_SQL_TEXT, offsetof(struct gsn_attachment_row, sha256) },
    { GSN_SQL_INT, offsetof(struct gsn_attachment_row, size) },
};
static const struct gsn_sql_shape attachment_shape =
    SQL_SHAPE(struct gsn_attachment_row, attachment_fields);

SQL_DEFINE_ROWS(attachment);

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
