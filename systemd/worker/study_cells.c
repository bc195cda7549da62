/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Cells of a study's specimens.
 *
 * Steps: (1) base-cells.csv of the specimen's last run, its hash held against the report's; (2) of
 * one with a baseline, the same of each specimen that this stands for, from the tables that were
 * read before where there are; (3) cell by cell, the density of a control, or what the loss leaves
 * of the baseline's mean.
 *
 * Failure: a table that is missing or damaged leaves its specimen without cells. Cost: a table is
 * read once. */
#include "systemd/worker/study_cells.h"

#include "storage/catalog.h"
#include "systemd/worker/kept_run.h"

#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* As pipeline/export/cells_file.h writes them. */
enum { CUBE = 0, TET = 3, VOLUME = 7, DENSITY = 8, LOSS = 12, COLUMNS = 14 };

struct row {
    struct gsn_base_address address;
    double volume_um3, density, loss; /* NaN: none */
};

struct table {
    char *specimen;
    struct row *row; /* in order of address */
    size_t count;    /* 0: there is none */
};

struct gsn_cell_tables {
    struct table *table;
    size_t count, room;
};

struct gsn_cell_tables *gsn_cell_tables_new(void)
{
    return gsn_alloc_array(1, sizeof(struct gsn_cell_tables));
}

void gsn_cell_tables_free(struct gsn_cell_tables *tables)
{
    if (!tables)
        return;
    for (size_t i = 0; i < tables->count; i++) {
        gsn_free(tables->table[i].specimen);
        gsn_free(tables->table[i].row);
    }
    gsn_free(tables->table);
    gsn_free(tables);
}

/* ---- reading a table ----------------------------------------------------------------------- */

/* The numbers of a line, by jansson, which knows no locale; an empty field is none. Returns 0 where
 * they are not COLUMNS. */
static int read_line(const char *line, size_t length, double ret_number[COLUMNS])
{
    char list[40 * COLUMNS];
    size_t used = 0;
    json_t *root;
    int ok;

    list[used++] = '[';
    for (size_t i = 0; i <= length && used < sizeof list - 8; i++) {
        const char end = i < length ? line[i] : ',';

        if (end == ',' && (list[used - 1] == ',' || list[used - 1] == '[')) {
            memcpy(list + used, "null", 4);
            used += 4;
        }
        list[used++] = i < length ? end : ']';
    }
    root = json_loadb(list, used, 0, NULL);
    ok = json_array_size(root) == COLUMNS;
    for (size_t i = 0; ok && i < COLUMNS; i++) {
        const json_t *const item = json_array_get(root, i);

        ret_number[i] = json_is_number(item) ? json_number_value(item) : (double)NAN;
    }
    json_decref(root);
    return ok;
}

static int make_row(const double number[COLUMNS], struct row *ret_row)
{
    for (int k = CUBE; k <= TET; k++)
        if (!(fabs(number[k]) < 1e9))
            return 0;
    *ret_row =
        (struct row){ .address = { { (int32_t)number[0], (int32_t)number[1], (int32_t)number[2] },
                                   (uint8_t)number[TET] },
                      .volume_um3 = number[VOLUME],
                      .density = number[DENSITY],
                      .loss = number[LOSS] };
    return isfinite(ret_row->density) && isfinite(ret_row->volume_um3);
}

/* No row where a line is not as it should be. */
static int read_rows(const char *text, size_t size, struct table *table, struct gsn_error *err)
{
    const char *const end = text + size, *line = memchr(text, '\n', size);
    size_t lines = 0;

    for (const char *at = text; at < end; at++)
        lines += *at == '\n';
    table->row = gsn_alloc_array(lines + 1, sizeof *table->row);
    if (!table->row)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", lines);
    while (line && line + 1 < end) {
        const char *const next = memchr(line + 1, '\n', (size_t)(end - line - 1));
        const char *const stop = next ? next : end;
        const size_t length = (size_t)(stop - line - 1) - (stop[-1] == '\r');
        double number[COLUMNS];

        if (!read_line(line + 1, length, number) || !make_row(number, &table->row[table->count])) {
            table->count = 0;
            return GSN_OK;
        }
        table->count++;
        line = next;
    }
    return GSN_OK;
}

static int read_table(struct gsn_store *store, struct table *table, struct gsn_error *err)
{
    gsn_auto(gsn_kept_run) kept = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error why = { 0 };
    size_t size = 0;
    int r = gsn_kept_run_open(store, table->specimen, &kept, &why);

    if (r >= 0)
        r = gsn_kept_run_file(store, kept, "base-cells.csv", &bytes, &size, &why);
    if (r == GSN_E_NOTFOUND || r == GSN_E_INPUT)
        return GSN_OK;
    if (r < 0)
        return gsn_fail(err, r, "%s", why.text);
    return read_rows((const char *)bytes, size, table, err);
}

/* borrows: until the next one is asked for. */
static int get_table(struct gsn_cell_tables *tables, struct gsn_store *store, const char *specimen,
                     const struct table **ret_table, struct gsn_error *err)
{
    struct table *table;
    int r;

    for (size_t i = 0; i < tables->count; i++)
        if (strcmp(tables->table[i].specimen, specimen) == 0) {
            *ret_table = &tables->table[i];
            return GSN_OK;
        }
    if (tables->count == tables->room) {
        struct table *const more =
            gsn_realloc_array(tables->table, 2 * tables->room + 16, sizeof *more);

        if (!more)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for tables of cells");
        tables->table = more;
        tables->room = 2 * tables->room + 16;
    }
    table = &tables->table[tables->count];
    *table = (struct table){ .specimen = gsn_strdup(specimen) };
    if (!table->specimen)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for tables of cells");
    tables->count++;
    r = read_table(store, table, err);
    if (r >= 0)
        *ret_table = table;
    return r;
}

/* ---- densities in the control's stain ------------------------------------------------------- */

static int compare_rows(const void *a, const void *b)
{
    return gsn_base_compare(((const struct row *)a)->address, ((const struct row *)b)->address);
}

/* Adds the controls' density in each of these cells. */
static int add_controls(struct gsn_cell_tables *tables, struct gsn_store *store,
                        const struct gsn_specimen_row *row, const struct gsn_study_place *place,
                        size_t count, double *sum, double *n, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_rows) controls = NULL;
    int r = gsn_specimen_baseline(store, row->study, row->baseline, &controls, err);

    for (size_t i = 0; r >= 0 && i < controls->count; i++) {
        const struct table *table;

        if (controls->at[i].id == row->id)
            continue;
        r = get_table(tables, store, controls->at[i].name, &table, err);
        for (size_t k = 0; r >= 0 && table->count > 0 && k < count; k++) {
            const struct row like = { .address = place[k].address };
            const struct row *const found =
                bsearch(&like, table->row, table->count, sizeof like, compare_rows);

            if (found) {
                sum[k] += found->density;
                n[k]++;
            }
        }
    }
    return r;
}

/* place[k].density is the loss, per cent, and becomes the density that it leaves. Returns how many
 * cells are left. */
static size_t apply_losses(struct gsn_study_place *place, size_t count, const double *sum,
                           const double *n)
{
    size_t used = 0;

    for (size_t k = 0; k < count; k++)
        if (n[k] > 0) {
            place[used] = place[k];
            place[used++].density = (1 - place[k].density / 100) * sum[k] / n[k];
        }
    return used;
}

int gsn_study_places(struct gsn_cell_tables *tables, struct gsn_store *store,
                     const struct gsn_specimen_row *row, struct gsn_study_place **ret_place,
                     size_t *ret_count, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_study_place) place = NULL;
    gsn_auto_mem(double) sum = NULL;
    const struct table *own;
    const int compared = row->baseline[0] != '\0';
    size_t count = 0;
    int r = get_table(tables, store, row->name, &own, err);

    if (r < 0)
        return r;
    place = gsn_alloc_array(own->count + 1, sizeof *place);
    sum = gsn_alloc_array(2 * own->count + 1, sizeof *sum);
    if (!place || !sum)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", own->count);
    for (size_t i = 0; i < own->count; i++) {
        const struct row *const at = &own->row[i];
        const double value = compared ? at->loss : at->density;

        if (isfinite(value))
            place[count++] = (struct gsn_study_place){ at->address, value, at->volume_um3 };
    }
    if (compared && count > 0) {
        r = add_controls(tables, store, row, place, count, sum, sum + count, err);
        if (r < 0)
            return r;
        count = apply_losses(place, count, sum, sum + count);
    }
    *ret_place = gsn_steal(&place);
    *ret_count = count;
    return GSN_OK;
}
