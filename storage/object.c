/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/object.h"

#include "storage/sql.h"

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
