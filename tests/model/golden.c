/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/model/golden.h"

#include "tests/check.h"

#include "pipeline/core/file.h"

#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

const double *golden_row(const struct golden_table *table, size_t row)
{
    return &table->cell[row * table->columns];
}

static size_t count(const char *text, char what)
{
    size_t n = 0;

    for (; *text; text++)
        n += *text == what;
    return n;
}

static void read_line(struct golden_table *table, size_t row, char *line)
{
    char *rest = line;

    for (size_t column = 0; column < table->columns; column++) {
        const char *word = strsep(&rest, ",");
        char *end;

        assert_non_null(word);
        table->cell[row * table->columns + column] = strtod(word, &end);
        if (end != word && !*end)
            continue;
        table->cell[row * table->columns + column] = NAN;
        if (column < 2)
            (void)snprintf(table->kind[row], sizeof table->kind[row], "%s", word);
    }
}

struct golden_table golden_read(const struct golden_case *golden, const char *file)
{
    struct golden_table table = { 0 };
    struct gsn_error err = { 0 };
    char path[1024];
    uint8_t *bytes = NULL;
    size_t size;
    char *rest, *header;

    (void)snprintf(path, sizeof path, "%s/%s.csv", golden->folder, file);
    CHECK_OK(gsn_file_read(path, 1 << 20, &bytes, &size, &err), err);
    rest = (char *)bytes;
    table.rows = count(rest, '\n') - 1;
    header = strsep(&rest, "\n");
    table.columns = count(header, ',') + 1;
    table.cell = gsn_alloc_array(table.rows * table.columns, sizeof *table.cell);
    table.kind = gsn_alloc_array(table.rows, sizeof *table.kind);
    assert_non_null(table.cell);
    assert_non_null(table.kind);
    for (size_t row = 0; row < table.rows; row++)
        read_line(&table, row, strsep(&rest, "\n"));
    gsn_free(bytes);
    return table;
}

void golden_done(struct golden_table *table)
{
    gsn_free(table->cell);
    gsn_free(table->kind);
}

size_t golden_function(const struct gsn_dms *space, const double beta[4])
{
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const uint8_t *own = gsn_dms_beta(space, f);

        if (own[0] == beta[0] && own[1] == beta[1] && own[2] == beta[2] && own[3] == beta[3])
            return f;
    }
    fail_msg("no function has this beta");
    return 0;
}

struct gsn_spline *golden_spline(const struct golden_case *golden)
{
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spline_new(golden->space, golden->control, &spline, &err), err);
    return spline;
}

static void load(struct golden_case *golden)
{
    struct golden_table knots = golden_read(golden, "knots");
    struct golden_table tets = golden_read(golden, "tets");
    struct golden_table control = golden_read(golden, "control");
    const size_t last = knots.rows - 1;
    const unsigned degree = (unsigned)golden_row(&knots, last)[1];
    const size_t vertices = (size_t)golden_row(&knots, last)[0] + 1;
    double(*knot)[3] = gsn_alloc_array(knots.rows, sizeof *knot);
    double(*vertex)[3] = gsn_alloc_array(vertices, sizeof *vertex);
    uint32_t(*tet)[4] = gsn_alloc_array(tets.rows, sizeof *tet);
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < knots.rows; i++) {
        memcpy(knot[i], golden_row(&knots, i) + 2, sizeof *knot);
        if (i % (degree + 1) == 0)
            memcpy(vertex[i / (degree + 1)], knot[i], sizeof *vertex);
    }
    for (size_t t = 0; t < tets.rows; t++) {
        for (int k = 0; k < 4; k++)
            tet[t][k] = (uint32_t)golden_row(&tets, t)[k + 1];
    }
    golden->degree = degree;
    CHECK_OK(gsn_tets_new((const double(*)[3])vertex, vertices, (const uint32_t(*)[4])tet,
                          tets.rows, &golden->mesh, &err),
             err);
    CHECK(memcmp(golden->mesh->tet, tet, tets.rows * sizeof *tet) == 0);
    CHECK_OK(gsn_dms_new(golden->mesh, degree, (const double(*)[3])knot, GSN_DMS_OWN,
                         &golden->space, &err),
             err);
    golden->control = gsn_alloc_array(control.rows, sizeof *golden->control);
    CHECK(control.rows == gsn_dms_controls(golden->space));
    for (size_t i = 0; i < control.rows; i++) {
        const double *row = golden_row(&control, i);
        const size_t t = (size_t)row[0];

        golden->control[gsn_dms_control_ids(golden->space,
                                            t)[golden_function(golden->space, row + 1)]] = row[5];
    }
    gsn_free(knot);
    gsn_free(vertex);
    gsn_free(tet);
    golden_done(&knots);
    golden_done(&tets);
    golden_done(&control);
}

static int has(const char *folder, const char *file)
{
    char path[1024];
    struct stat there;

    (void)snprintf(path, sizeof path, "%s/%s.csv", folder, file);
    return stat(path, &there) == 0;
}

static void run_case(const char *folder, void (*test)(const struct golden_case *golden))
{
    struct golden_case golden = { 0 };

    (void)snprintf(golden.folder, sizeof golden.folder, "%s", folder);
    print_message("%s\n", folder);
    load(&golden);
    test(&golden);
    gsn_dms_free(golden.space);
    gsn_tets_free(golden.mesh);
    gsn_free(golden.control);
}

/* Runs the cases in a folder and the folders in it; returns how many there were. */
static size_t run_folder(const char *folder, const char *file,
                         void (*test)(const struct golden_case *golden))
{
    struct dirent **entry;
    const int entries = scandir(folder, &entry, NULL, alphasort);
    size_t found = 0;

    if (entries < 0) /* a file */
        return 0;
    if (has(folder, file) && has(folder, "knots")) {
        run_case(folder, test);
        found++;
    }
    for (int i = 0; i < entries; i++) {
        char path[512];

        (void)snprintf(path, sizeof path, "%s/%s", folder, entry[i]->d_name);
        if (entry[i]->d_name[0] != '.')
            found += run_folder(path, file, test);
        free(entry[i]);
    }
    free(entry);
    return found;
}

void golden_each(const char *file, void (*test)(const struct golden_case *golden))
{
    const char *named = getenv("GIESON_GOLDEN");
    struct stat there;

    if (named && stat(named, &there) < 0) {
        gsn_check_skip("GIESON_GOLDEN names %s, which does not exist", named);
    }
    if (run_folder(named ? named : GSN_FIXTURES "/model/golden", file, test) > 0)
        return;
    CHECK(named);
    gsn_check_skip("no case of %s has a %s.csv", named, file);
}

double golden_steepest(const struct golden_table *spline)
{
    double largest = 0;

    for (size_t i = 0; i < spline->rows; i++) {
        for (int c = 0; c < 3; c++)
            largest = fmax(largest, fabs(golden_row(spline, i)[3 + c]));
    }
    return largest;
}
