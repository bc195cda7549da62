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

/* The decimal as it stands: 25 digits are more than a double holds. */
static _Float128 read_decimal(const char *word)
{
    _Float128 value = 0;
    int negative = *word == '-', places = 0, exponent = 0;

    for (word += negative; (*word >= '0' && *word <= '9') || *word == '.'; word++) {
        if (*word == '.') {
            places = 1;
            continue;
        }
        value = 10 * value + (*word - '0');
        exponent -= places;
    }
    if (*word == 'e' || *word == 'E')
        exponent += (int)strtol(word + 1, NULL, 10);
    for (; exponent < 0; exponent++)
        value /= 10;
    for (; exponent > 0; exponent--)
        value *= 10;
    return negative ? -value : value;
}

static void read_line(struct golden_table *table, size_t row, char *line)
{
    char *rest = line;

    for (size_t column = 0; column < table->columns; column++) {
        const char *word = strsep(&rest, ",");
        char *end;

        assert_non_null(word);
        table->cell[row * table->columns + column] = strtod(word, &end);
        table->fine[row * table->columns + column] = read_decimal(word);
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
    table.fine = gsn_alloc_array(table.rows * table.columns, sizeof *table.fine);
    assert_non_null(table.cell);
    assert_non_null(table.fine);
    assert_non_null(table.kind);
    for (size_t row = 0; row < table.rows; row++)
        read_line(&table, row, strsep(&rest, "\n"));
    gsn_free(bytes);
    return table;
}

void golden_done(struct golden_table *table)
{
    gsn_free(table->cell);
    gsn_free(table->fine);
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

/* ---- beyond the mesh ---------------------------------------------------------------------- */

/* How far beyond the mesh its enlargement reaches, of its size. */
static const double enlarged = 16.0;

/* Three tetrahedra over one boundary face; the diagonals run from lower to higher vertices, on both
 * sides of an edge alike. */
static size_t add_prism(const uint32_t *copy, const uint32_t face[3], uint32_t (*ret_tet)[4])
{
    const uint32_t low = face[0] < face[1] ? face[0] : face[1];
    const uint32_t p = low < face[2] ? low : face[2];
    const uint32_t high = face[0] > face[1] ? face[0] : face[1];
    const uint32_t r = high > face[2] ? high : face[2];
    const uint32_t q = face[0] + face[1] + face[2] - p - r;
    const uint32_t tet[3][4] = { { p, q, r, copy[r] },
                                 { p, q, copy[q], copy[r] },
                                 { p, copy[p], copy[q], copy[r] } };

    memcpy(ret_tet, tet, sizeof tet);
    return 3;
}

/* ret_copy: of each vertex on the boundary, its copy far out; that of an inner one stays 0. */
static struct gsn_tets *enlarge_mesh(const struct gsn_tets *mesh, uint32_t *ret_copy)
{
    const size_t n = mesh->vertex_count;
    double(*vertex)[3] = gsn_alloc_array(2 * n, sizeof *vertex), middle[3] = { 0 };
    uint32_t(*tet)[4] = gsn_alloc_array(13 * mesh->tet_count, sizeof *tet);
    struct gsn_tets *larger = NULL;
    struct gsn_error err = { 0 };
    size_t count = mesh->tet_count, vertices = n;

    assert_non_null(vertex);
    assert_non_null(tet);
    memcpy(tet, mesh->tet, count * sizeof *tet);
    memcpy(vertex, mesh->vertex, n * sizeof *vertex);
    for (size_t i = 0; i < n; i++)
        for (int a = 0; a < 3; a++)
            middle[a] += mesh->vertex[i][a] / (double)n;
    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (int k = 0; k < 4; k++) {
            const uint32_t face[3] = { mesh->tet[t][(k + 1) % 4], mesh->tet[t][(k + 2) % 4],
                                       mesh->tet[t][(k + 3) % 4] };

            for (int i = 0; mesh->neighbour[t][k] < 0 && i < 3; i++) {
                if (ret_copy[face[i]])
                    continue;
                for (int a = 0; a < 3; a++)
                    vertex[vertices][a] =
                        middle[a] + enlarged * (mesh->vertex[face[i]][a] - middle[a]);
                ret_copy[face[i]] = (uint32_t)vertices++;
            }
            if (mesh->neighbour[t][k] < 0)
                count += add_prism(ret_copy, face, tet + count);
        }
    }
    CHECK_OK(gsn_tets_new((const double(*)[3])vertex, vertices, (const uint32_t(*)[4])tet, count,
                          &larger, &err),
             err);
    gsn_free(vertex);
    gsn_free(tet);
    return larger;
}

struct golden_larger golden_enlarge(const struct golden_case *golden)
{
    const size_t cloud = golden->degree + 1U, n = golden->mesh->vertex_count;
    uint32_t *copy = gsn_alloc_array(n, sizeof *copy);
    struct golden_larger larger = { .mesh = enlarge_mesh(golden->mesh, copy) };
    const size_t knots = larger.mesh->vertex_count * cloud;
    double(*knot)[3] = gsn_alloc_array(knots, sizeof *knot);
    struct gsn_error err = { 0 };
    double *control;

    memcpy(knot, gsn_dms_knots(golden->space), n * cloud * sizeof *knot);
    for (size_t i = n * cloud; i < knots; i++)
        memcpy(knot[i], larger.mesh->vertex[i / cloud], sizeof *knot);
    CHECK_OK(gsn_dms_new(larger.mesh, golden->degree, (const double(*)[3])knot, GSN_DMS_OWN,
                         &larger.space, &err),
             err);
    control = gsn_alloc_array(gsn_dms_controls(larger.space), sizeof *control);
    for (size_t t = 0; t < golden->mesh->tet_count; t++) {
        for (size_t f = 0; f < gsn_dms_functions(larger.space); f++)
            control[gsn_dms_control_ids(larger.space, t)[f]] =
                golden->control[gsn_dms_control_ids(golden->space, t)[f]];
    }
    CHECK_OK(gsn_spline_new(larger.space, control, &larger.spline, &err), err);
    gsn_free(control);
    gsn_free(knot);
    gsn_free(copy);
    return larger;
}

void golden_larger_done(struct golden_larger *larger)
{
    gsn_spline_free(larger->spline);
    gsn_dms_free(larger->space);
    gsn_tets_free(larger->mesh);
}

/* ---- from folder to folder ------------------------------------------------------------------ */

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
