/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: HDF5 in memory (the core file driver and its file image), in VTK's VTKHDF layout and,
 * beside it, in a group of our own that is read back.
 * Reference: VTK, "VTK File Formats", VTKHDF 1.0; the order of points in a Bezier tetrahedron is
 * that of vtkHigherOrderTetra (bezier_cells.h).
 *
 * Steps of writing: the picture (points and coefficients cell by cell, cell data), the model, its
 * checksum, the image. Of reading: the image, sizes that agree with each other, the arrays, the
 * checksum; only then is a space made of them.
 *
 * An array is compressed where it is long (shuffle and deflate); nothing is rounded. Identifiers of
 * HDF5 are closed when they leave their scope. Every call that fails becomes one sentence that
 * names the item; HDF5's own printing is off.
 *
 * Cost: some 40 bytes a Bezier point before compression, of which a quadratic cell has ten. */
#include "pipeline/model/model_file.h"

#include "pipeline/core/hash.h"
#include "pipeline/model/bezier_cells.h"

#include <assert.h>
#include <string.h>

#include <hdf5.h>

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__,
               "the checksum is over the bytes of the file, which are little-endian");

enum {
    FORMAT = 3,               /* 1 has no region, 2 no colours */
    LONG_ARRAY = 8192,        /* values; shorter ones are not worth a chunk */
    CHUNK_ROWS = 16384,       /* of a long array */
    IMAGE_STEP = 1 << 20,     /* by which the file in memory grows */
    MOST_TETS = 100 * 1000000 /* more is no file of ours */
};

static void release_id(const hid_t *id)
{
    if (*id >= 0)
        (void)H5Idec_ref(*id);
}

#define auto_id __attribute__((cleanup(release_id))) hid_t

static int fail_item(const char *doing, const char *item, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_IO, "HDF5 could not %s \"%s\" of the model's file", doing, item);
}

/* ---- writing ------------------------------------------------------------------------------- */

/* rows of columns values each; columns 0: a plain list. */
struct array {
    const char *name;
    hid_t stored, held; /* type in the file, type in memory */
    size_t rows, columns;
    const void *values;
};

/* No times, so that the same model is the same bytes; long arrays compressed. */
static hid_t plan_storage(const struct array *a, const hsize_t extent[2], int rank)
{
    const hsize_t chunk[2] = { extent[0] < CHUNK_ROWS ? extent[0] : CHUNK_ROWS, extent[1] };
    auto_id plan = H5Pcreate(H5P_DATASET_CREATE);
    hid_t given;

    if (plan < 0 || H5Pset_obj_track_times(plan, 0) < 0)
        return -1;
    if (a->rows * (a->columns ? a->columns : 1) >= LONG_ARRAY &&
        (H5Pset_chunk(plan, rank, chunk) < 0 || H5Pset_shuffle(plan) < 0 ||
         H5Pset_deflate(plan, 4) < 0))
        return -1;
    given = plan;
    plan = -1;
    return given;
}

static int write_array(hid_t group, const struct array *a, struct gsn_error *err)
{
    const hsize_t extent[2] = { a->rows, a->columns };
    const int rank = a->columns ? 2 : 1;
    auto_id shape = H5Screate_simple(rank, extent, NULL);
    auto_id plan = plan_storage(a, extent, rank);
    auto_id set = -1;

    if (shape >= 0 && plan >= 0)
        set = H5Dcreate2(group, a->name, a->stored, shape, H5P_DEFAULT, plan, H5P_DEFAULT);
    if (set < 0 || H5Dwrite(set, a->held, H5S_ALL, H5S_ALL, H5P_DEFAULT, a->values) < 0)
        return fail_item("write", a->name, err);
    return GSN_OK;
}

static int write_doubles(hid_t group, const char *name, size_t rows, size_t columns,
                         const double *values, struct gsn_error *err)
{
    return write_array(
        group, &(struct array){ name, H5T_IEEE_F64LE, H5T_NATIVE_DOUBLE, rows, columns, values },
        err);
}

static int write_integers(hid_t group, const char *name, size_t rows, const int64_t *values,
                          struct gsn_error *err)
{
    return write_array(
        group, &(struct array){ name, H5T_STD_I64LE, H5T_NATIVE_INT64, rows, 0, values }, err);
}

static int write_counts(hid_t group, const char *name, size_t rows, size_t columns,
                        const uint32_t *values, struct gsn_error *err)
{
    return write_array(
        group, &(struct array){ name, H5T_STD_U32LE, H5T_NATIVE_UINT32, rows, columns, values },
        err);
}

/* A text as an attribute of its own length, as VTK's reader wants its "Type". */
static int write_text(hid_t group, const char *name, const char *text, struct gsn_error *err)
{
    const size_t length = strlen(text);
    auto_id type = H5Tcopy(H5T_C_S1);
    auto_id shape = H5Screate(H5S_SCALAR);
    auto_id attribute = -1;

    if (type >= 0 && shape >= 0 && H5Tset_size(type, length ? length : 1) >= 0 &&
        H5Tset_strpad(type, H5T_STR_NULLPAD) >= 0)
        attribute = H5Acreate2(group, name, type, shape, H5P_DEFAULT, H5P_DEFAULT);
    return attribute < 0 || H5Awrite(attribute, type, text) < 0 ? fail_item("write", name, err)
                                                                : GSN_OK;
}

static int write_numbers(hid_t group, const char *name, size_t count, const int64_t *values,
                         struct gsn_error *err)
{
    const hsize_t extent = count;
    auto_id shape = H5Screate_simple(1, &extent, NULL);
    auto_id attribute = -1;

    if (shape >= 0)
        attribute = H5Acreate2(group, name, H5T_STD_I64LE, shape, H5P_DEFAULT, H5P_DEFAULT);
    return attribute < 0 || H5Awrite(attribute, H5T_NATIVE_INT64, values) < 0
               ? fail_item("write", name, err)
               : GSN_OK;
}

static hid_t create_group(hid_t above, const char *name)
{
    auto_id plan = H5Pcreate(H5P_GROUP_CREATE);

    if (plan < 0 || H5Pset_obj_track_times(plan, 0) < 0)
        return -1;
    return H5Gcreate2(above, name, H5P_DEFAULT, plan, H5P_DEFAULT);
}

static int write_cells(hid_t group, size_t tets, const struct gsn_model_cells *cells,
                       struct gsn_error *err)
{
    int r = GSN_OK;

    if (r >= 0 && cells->density)
        r = write_doubles(group, "density", tets, 0, cells->density, err);
    if (r >= 0 && cells->inside_share)
        r = write_doubles(group, "inside_share", tets, 0, cells->inside_share, err);
    if (r >= 0 && cells->residual)
        r = write_doubles(group, "residual", tets, 0, cells->residual, err);
    if (r >= 0 && cells->samples)
        r = write_counts(group, "samples", tets, 0, cells->samples, err);
    return r;
}

static int write_picture(hid_t file, const struct gsn_spline *spline,
                         const struct gsn_model_cells *cells, struct gsn_error *err)
{
    static const int64_t version[2] = { 1, 0 };
    gsn_auto(gsn_bezier_cells) p = NULL;
    auto_id group = create_group(file, "VTKHDF");
    auto_id point_data = group < 0 ? -1 : create_group(group, "PointData");
    auto_id cell_data = group < 0 ? -1 : create_group(group, "CellData");
    int r = gsn_bezier_cells_new(spline, &p, err);
    const int64_t points = r < 0 ? 0 : (int64_t)p->points, tets = r < 0 ? 0 : (int64_t)p->tets;

    if (r >= 0 && (point_data < 0 || cell_data < 0))
        r = fail_item("make", "VTKHDF", err);
    if (r >= 0)
        r = write_numbers(group, "Version", 2, version, err);
    if (r >= 0)
        r = write_text(group, "Type", "UnstructuredGrid", err);
    if (r >= 0)
        r = write_integers(group, "NumberOfPoints", 1, &points, err);
    if (r >= 0)
        r = write_integers(group, "NumberOfCells", 1, &tets, err);
    if (r >= 0)
        r = write_integers(group, "NumberOfConnectivityIds", 1, &points, err);
    if (r >= 0)
        r = write_doubles(group, "Points", p->points, 3, &p->point[0][0], err);
    if (r >= 0)
        r = write_integers(group, "Connectivity", p->points, p->connectivity, err);
    if (r >= 0)
        r = write_integers(group, "Offsets", p->tets + 1, p->offset, err);
    if (r >= 0)
        r = write_array(
            group, &(struct array){ "Types", H5T_STD_U8LE, H5T_NATIVE_UINT8, p->tets, 0, p->type },
            err);
    if (r >= 0)
        r = write_doubles(point_data, "s", p->points, 0, p->s, err);
    return r < 0 ? r : write_cells(cell_data, p->tets, cells, err);
}

/* A lattice as it is in the file: voxels along x, y, z, centre of the first, steps. */
struct lattice {
    double number[9];
};

static struct lattice list_lattice(const struct gsn_lattice *at)
{
    return (struct lattice){ { (double)at->nx, (double)at->ny, (double)at->nz, at->origin_um.x,
                               at->origin_um.y, at->origin_um.z, at->step_um.x, at->step_um.y,
                               at->step_um.z } };
}

static int write_region(hid_t above, const struct gsn_mask *region, struct gsn_error *err)
{
    const struct lattice lattice = list_lattice(&region->at);
    auto_id group = create_group(above, "region");
    int r = group < 0 ? fail_item("make", "region", err) : GSN_OK;

    if (r >= 0)
        r = write_doubles(group, "lattice", 9, 0, lattice.number, err);
    if (r >= 0)
        r = write_array(group,
                        &(struct array){ "inside", H5T_STD_U8LE, H5T_NATIVE_UINT8,
                                         gsn_lattice_count(&region->at), 0, region->inside },
                        err);
    return r;
}

/* Everything that the model is, in one order, whoever holds it. */
static int sum_up(const struct gsn_spline *spline, const struct gsn_spline *const *colour,
                  const struct gsn_model_cells *cells, const struct gsn_mask *region,
                  const struct gsn_model_notes *notes, struct gsn_digest *ret_digest,
                  struct gsn_error *err)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const size_t tets = mesh->tet_count;
    const struct lattice lattice = region ? list_lattice(&region->at) : (struct lattice){ { 0 } };
    const struct {
        const void *bytes;
        size_t size;
    } parts[] = {
        { mesh->vertex, mesh->vertex_count * sizeof *mesh->vertex },
        { mesh->tet, tets * sizeof *mesh->tet },
        { gsn_dms_knots(space),
          mesh->vertex_count * (gsn_dms_degree(space) + 1) * sizeof *gsn_dms_knots(space) },
        { gsn_spline_controls(spline), gsn_dms_controls(space) * sizeof(double) },
        { cells->density, tets * sizeof *cells->density },
        { cells->inside_share, tets * sizeof *cells->inside_share },
        { cells->residual, tets * sizeof *cells->residual },
        { cells->samples, tets * sizeof *cells->samples },
        { notes->name, strlen(notes->name) + 1 },
        { notes->parameters, strlen(notes->parameters) + 1 },
        { notes->version, strlen(notes->version) + 1 },
        { region ? &lattice : NULL, sizeof lattice },
        { region ? region->inside : NULL, region ? gsn_lattice_count(&region->at) : 0 },
        { colour ? gsn_spline_controls(colour[0]) : NULL,
          gsn_dms_controls(space) * sizeof(double) },
        { colour ? gsn_spline_controls(colour[1]) : NULL,
          gsn_dms_controls(space) * sizeof(double) },
        { colour ? gsn_spline_controls(colour[2]) : NULL,
          gsn_dms_controls(space) * sizeof(double) },
    };
    gsn_auto(gsn_hash) hash = NULL;
    int r = gsn_hash_new(&hash, err);

    for (size_t i = 0; r >= 0 && i < sizeof parts / sizeof *parts; i++)
        if (parts[i].bytes)
            r = gsn_hash_add(hash, parts[i].bytes, parts[i].size, err);
    return r < 0 ? r : gsn_hash_end(hash, ret_digest, err);
}

static const char *const COLOURS[3] = { "red", "green", "blue" };

static int write_model(hid_t file, const struct gsn_spline *spline,
                       const struct gsn_spline *const *colour, const struct gsn_model_cells *cells,
                       const struct gsn_mask *region, const struct gsn_model_notes *notes,
                       struct gsn_error *err)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const size_t knots = mesh->vertex_count * (gsn_dms_degree(space) + 1);
    const int64_t facts[3] = { FORMAT, gsn_dms_degree(space), gsn_dms_sharing(space) };
    auto_id group = create_group(file, "gieson");
    struct gsn_digest digest;
    int r = sum_up(spline, colour, cells, region, notes, &digest, err);

    if (r >= 0 && group < 0)
        r = fail_item("make", "gieson", err);
    if (r >= 0)
        r = write_numbers(group, "format, degree, sharing", 3, facts, err);
    if (r >= 0)
        r = write_text(group, "name", notes->name, err);
    if (r >= 0)
        r = write_text(group, "version", notes->version, err);
    if (r >= 0)
        r = write_text(group, "sha256", digest.hex, err);
    if (r >= 0)
        r = write_array(group,
                        &(struct array){ "parameters", H5T_STD_U8LE, H5T_NATIVE_UINT8,
                                         strlen(notes->parameters) + 1, 0, notes->parameters },
                        err);
    if (r >= 0)
        r = write_doubles(group, "vertices", mesh->vertex_count, 3, &mesh->vertex[0][0], err);
    if (r >= 0)
        r = write_counts(group, "tetrahedra", mesh->tet_count, 4, &mesh->tet[0][0], err);
    if (r >= 0)
        r = write_doubles(group, "knots", knots, 3, &gsn_dms_knots(space)[0][0], err);
    if (r >= 0)
        r = write_doubles(group, "controls", gsn_dms_controls(space), 0,
                          gsn_spline_controls(spline), err);
    for (int c = 0; colour && r >= 0 && c < 3; c++)
        r = write_doubles(group, COLOURS[c], gsn_dms_controls(space), 0,
                          gsn_spline_controls(colour[c]), err);
    return r < 0 || !region ? r : write_region(group, region, err);
}

/* A file that is in memory only; image: one to start from, or NULL. The oldest format will do, and
 * H5Fget_file_image() of HDF5 1.10 leaves a wrong checksum in the head of the newer ones. */
static hid_t open_in_memory(const uint8_t *image, size_t size)
{
    auto_id access = H5Pcreate(H5P_FILE_ACCESS);
    auto_id creation = H5Pcreate(H5P_FILE_CREATE);

    /* What fails is said in our words, by the caller. */
    (void)H5Eset_auto2(H5E_DEFAULT, NULL, NULL);
    if (access < 0 || creation < 0 || H5Pset_obj_track_times(creation, 0) < 0 ||
        H5Pset_fapl_core(access, IMAGE_STEP, 0) < 0)
        return -1;
    if (!image)
        return H5Fcreate("model.vtkhdf", H5F_ACC_TRUNC, creation, access);
    /* HDF5 copies the image and never writes to the caller's. */
    if (H5Pset_file_image(access, (void *)(uintptr_t)image, size) < 0)
        return -1;
    return H5Fopen("model.vtkhdf", H5F_ACC_RDONLY, access);
}

static int take_image(hid_t file, uint8_t **ret_bytes, size_t *ret_size, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    ssize_t size;

    if (H5Fflush(file, H5F_SCOPE_LOCAL) < 0 || (size = H5Fget_file_image(file, NULL, 0)) <= 0)
        return fail_item("finish", "model.vtkhdf", err);
    bytes = gsn_alloc((size_t)size);
    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a model of %zd bytes", size);
    if (H5Fget_file_image(file, bytes, (size_t)size) != size)
        return fail_item("finish", "model.vtkhdf", err);
    *ret_bytes = gsn_steal(&bytes);
    *ret_size = (size_t)size;
    return GSN_OK;
}

int gsn_model_file_write(const struct gsn_spline *spline, const struct gsn_spline *const *colour,
                         const struct gsn_model_cells *cells, const struct gsn_mask *region,
                         const struct gsn_model_notes *notes, uint8_t **ret_bytes, size_t *ret_size,
                         struct gsn_error *err)
{
    auto_id file = open_in_memory(NULL, 0);
    int r;

    assert(spline && cells && notes && ret_bytes && ret_size);

    if (file < 0)
        return fail_item("make", "model.vtkhdf", err);
    r = write_picture(file, spline, cells, err);
    if (r >= 0)
        r = write_model(file, spline, colour, cells, region, notes, err);
    return r < 0 ? r : take_image(file, ret_bytes, ret_size, err);
}

/* ---- reading ------------------------------------------------------------------------------- */

static int refuse_item(const char *item, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT,
                    "this is no model that gieson kept, or it is damaged: \"%s\" is missing or of "
                    "the wrong size",
                    item);
}

/* gives: the values of an array with this many columns (0: a plain list); ret_rows says how many
 * rows there are, or, when it is not 0 before, must be. */
static int read_array(hid_t group, const char *name, hid_t held, size_t item_size, size_t columns,
                      size_t *ret_rows, void *ret_values, struct gsn_error *err)
{
    const int rank = columns ? 2 : 1;
    hsize_t extent[2] = { 0, 0 };
    auto_id set = H5Dopen2(group, name, H5P_DEFAULT);
    auto_id shape = set < 0 ? -1 : H5Dget_space(set);
    gsn_auto_mem(void) values = NULL;

    if (shape < 0 || H5Sget_simple_extent_ndims(shape) != rank ||
        H5Sget_simple_extent_dims(shape, extent, NULL) != rank || extent[0] == 0 ||
        extent[0] > MOST_TETS || (columns && extent[1] != columns) ||
        (*ret_rows && extent[0] != *ret_rows))
        return refuse_item(name, err);
    values = gsn_alloc_array(extent[0] * (columns ? columns : 1), item_size);
    if (!values)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for \"%s\" of a model", name);
    if (H5Dread(set, held, H5S_ALL, H5S_ALL, H5P_DEFAULT, values) < 0)
        return refuse_item(name, err);
    *ret_rows = extent[0];
    *(void **)ret_values = gsn_steal(&values);
    return GSN_OK;
}

/* Cell data that are not there stay NULL. */
static int read_cells(hid_t group, size_t tets, struct gsn_model_cells *cells,
                      struct gsn_error *err)
{
    int r = GSN_OK;

    if (r >= 0 && H5Lexists(group, "density", H5P_DEFAULT) > 0)
        r = read_array(group, "density", H5T_NATIVE_DOUBLE, sizeof(double), 0, &tets,
                       &cells->density, err);
    if (r >= 0 && H5Lexists(group, "inside_share", H5P_DEFAULT) > 0)
        r = read_array(group, "inside_share", H5T_NATIVE_DOUBLE, sizeof(double), 0, &tets,
                       &cells->inside_share, err);
    if (r >= 0 && H5Lexists(group, "residual", H5P_DEFAULT) > 0)
        r = read_array(group, "residual", H5T_NATIVE_DOUBLE, sizeof(double), 0, &tets,
                       &cells->residual, err);
    if (r >= 0 && H5Lexists(group, "samples", H5P_DEFAULT) > 0)
        r = read_array(group, "samples", H5T_NATIVE_UINT32, sizeof(uint32_t), 0, &tets,
                       &cells->samples, err);
    return r;
}

static int read_text(hid_t group, const char *name, char **ret_text, struct gsn_error *err)
{
    auto_id attribute = H5Aopen(group, name, H5P_DEFAULT);
    auto_id type = attribute < 0 ? -1 : H5Aget_type(attribute);
    const size_t size = type < 0 ? 0 : H5Tget_size(type);
    gsn_auto_mem(char) text = NULL;

    if (size == 0 || H5Tget_class(type) != H5T_STRING || H5Tis_variable_str(type) != 0)
        return refuse_item(name, err);
    text = gsn_alloc(size + 1);
    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the name of a model");
    if (H5Aread(attribute, type, text) < 0)
        return refuse_item(name, err);
    text[size] = '\0';
    *ret_text = gsn_steal(&text);
    return GSN_OK;
}

static int read_facts(hid_t group, int64_t ret_facts[3], struct gsn_error *err)
{
    auto_id attribute = H5Aopen(group, "format, degree, sharing", H5P_DEFAULT);
    auto_id shape = attribute < 0 ? -1 : H5Aget_space(attribute);

    if (shape < 0 || H5Sget_simple_extent_npoints(shape) != 3 ||
        H5Aread(attribute, H5T_NATIVE_INT64, ret_facts) < 0)
        return refuse_item("format, degree, sharing", err);
    if (ret_facts[0] < 1 || ret_facts[0] > FORMAT)
        return gsn_fail(err, GSN_E_INPUT,
                        "this model was kept by a newer gieson (format %d, this one knows %d)",
                        (int)ret_facts[0], FORMAT);
    if (ret_facts[1] < 1 || ret_facts[1] > GSN_DMS_MAX_DEGREE ||
        (ret_facts[2] != GSN_DMS_SHARED && ret_facts[2] != GSN_DMS_OWN))
        return refuse_item("format, degree, sharing", err);
    return GSN_OK;
}

static int read_notes(hid_t group, struct gsn_model *model, struct gsn_error *err)
{
    size_t length = 0;
    int r = read_text(group, "name", &model->name, err);

    if (r >= 0)
        r = read_text(group, "version", &model->version, err);
    if (r >= 0)
        r = read_array(group, "parameters", H5T_NATIVE_UINT8, 1, 0, &length, &model->parameters,
                       err);
    if (r >= 0 && model->parameters[length - 1] != '\0')
        r = refuse_item("parameters", err);
    return r;
}

static int read_spline(hid_t group, const int64_t facts[3], struct gsn_model *model,
                       struct gsn_error *err)
{
    gsn_auto(gsn_tets) mesh = NULL;
    gsn_auto_mem(double) vertex = NULL;
    gsn_auto_mem(double) knots = NULL;
    gsn_auto_mem(double) control = NULL;
    gsn_auto_mem(uint32_t) tet = NULL;
    size_t vertices = 0, tets = 0, knot_count = 0, controls = 0;
    int r = read_array(group, "vertices", H5T_NATIVE_DOUBLE, sizeof(double), 3, &vertices, &vertex,
                       err);

    if (r >= 0)
        r = read_array(group, "tetrahedra", H5T_NATIVE_UINT32, sizeof(uint32_t), 4, &tets, &tet,
                       err);
    knot_count = vertices * (size_t)(facts[1] + 1);
    if (r >= 0)
        r = read_array(group, "knots", H5T_NATIVE_DOUBLE, sizeof(double), 3, &knot_count, &knots,
                       err);
    if (r >= 0)
        r = read_array(group, "controls", H5T_NATIVE_DOUBLE, sizeof(double), 0, &controls, &control,
                       err);
    if (r >= 0)
        r = gsn_tets_new((const double(*)[3])vertex, vertices, (const uint32_t(*)[4])tet, tets,
                         &mesh, err);
    if (r >= 0)
        r = gsn_dms_new(mesh, (unsigned)facts[1], (const double(*)[3])knots,
                        (enum gsn_dms_sharing)facts[2], &model->space, err);
    if (r >= 0 && gsn_dms_controls(model->space) != controls)
        r = refuse_item("controls", err);
    return r < 0 ? r : gsn_spline_new(model->space, control, &model->spline, err);
}

/* All three, or none. */
static int read_colours(hid_t group, struct gsn_model *model, struct gsn_error *err)
{
    int r = GSN_OK;

    for (int c = 0; r >= 0 && c < 3; c++) {
        gsn_auto_mem(double) control = NULL;
        size_t controls = 0;

        r = read_array(group, COLOURS[c], H5T_NATIVE_DOUBLE, sizeof(double), 0, &controls, &control,
                       err);
        if (r >= 0 && gsn_dms_controls(model->space) != controls)
            r = refuse_item(COLOURS[c], err);
        if (r >= 0)
            r = gsn_spline_new(model->space, control, &model->colour[c], err);
    }
    return r;
}

static int read_region(hid_t above, struct gsn_mask **ret_region, struct gsn_error *err)
{
    auto_id group = H5Gopen2(above, "region", H5P_DEFAULT);
    gsn_auto(gsn_mask) region = NULL;
    gsn_auto_mem(double) number = NULL;
    gsn_auto_mem(uint8_t) inside = NULL;
    size_t numbers = 9, voxels = 0;
    struct gsn_lattice at;
    int r = group < 0 ? refuse_item("region", err)
                      : read_array(group, "lattice", H5T_NATIVE_DOUBLE, sizeof(double), 0, &numbers,
                                   &number, err);

    if (r >= 0)
        r = read_array(group, "inside", H5T_NATIVE_UINT8, 1, 0, &voxels, &inside, err);
    if (r < 0)
        return r;
    for (int k = 0; k < 3; k++)
        if (!(number[k] >= 1 && number[k] <= (double)voxels && number[6 + k] > 0))
            return refuse_item("lattice", err);
    at = (struct gsn_lattice){ .nx = (size_t)number[0],
                               .ny = (size_t)number[1],
                               .nz = (size_t)number[2],
                               .origin_um = { number[3], number[4], number[5] },
                               .step_um = { number[6], number[7], number[8] } };
    /* Each is at most as large as their number, which is bounded: the product cannot overflow. */
    if (at.nx * at.ny > voxels || gsn_lattice_count(&at) != voxels)
        return refuse_item("lattice", err);
    r = gsn_mask_new(&at, &region, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < voxels; i++)
        region->inside[i] = inside[i] != 0;
    *ret_region = gsn_steal(&region);
    return GSN_OK;
}

const struct gsn_spline *const *gsn_model_colours(const struct gsn_model *model)
{
    return model->colour[0] ? (const struct gsn_spline *const *)model->colour : NULL;
}

static int check_sum(hid_t group, const struct gsn_model *model, struct gsn_error *err)
{
    const struct gsn_model_notes notes = { model->name, model->parameters, model->version };
    gsn_auto_mem(char) kept = NULL;
    struct gsn_digest digest;
    int r = read_text(group, "sha256", &kept, err);

    if (r >= 0)
        r = sum_up(model->spline, gsn_model_colours(model), &model->cells, model->region, &notes,
                   &digest, err);
    if (r >= 0 && strcmp(kept, digest.hex) != 0)
        r = gsn_fail(err, GSN_E_INPUT,
                     "the model was changed since it was kept: its checksum is %.12s..., its "
                     "contents have %.12s...",
                     kept, digest.hex);
    return r;
}

int gsn_model_file_read(const uint8_t *bytes, size_t size, struct gsn_model **ret_model,
                        struct gsn_error *err)
{
    auto_id file = size > 0 ? open_in_memory(bytes, size) : -1;
    auto_id group = file < 0 ? -1 : H5Gopen2(file, "gieson", H5P_DEFAULT);
    auto_id cells = file < 0 ? -1 : H5Gopen2(file, "VTKHDF/CellData", H5P_DEFAULT);
    gsn_auto(gsn_model) model = NULL;
    int64_t facts[3];
    int r;

    assert(bytes && ret_model);

    if (group < 0 || cells < 0)
        return refuse_item("gieson", err);
    model = gsn_alloc_array(1, sizeof *model);
    if (!model)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a model");
    r = read_facts(group, facts, err);
    if (r >= 0)
        r = read_notes(group, model, err);
    if (r >= 0)
        r = read_spline(group, facts, model, err);
    if (r >= 0)
        r = read_cells(cells, gsn_dms_mesh(model->space)->tet_count, &model->cells, err);
    if (r >= 0 && H5Lexists(group, COLOURS[0], H5P_DEFAULT) > 0)
        r = read_colours(group, model, err);
    if (r >= 0 && H5Lexists(group, "region", H5P_DEFAULT) > 0)
        r = read_region(group, &model->region, err);
    if (r >= 0)
        r = check_sum(group, model, err);
    if (r < 0)
        return r;
    *ret_model = gsn_steal(&model);
    return GSN_OK;
}

void gsn_model_free(struct gsn_model *model)
{
    if (!model)
        return;
    gsn_spline_free(model->spline);
    for (int c = 0; c < 3; c++)
        gsn_spline_free(model->colour[c]);
    gsn_dms_free(model->space);
    gsn_mask_free(model->region);
    gsn_free(model->cells.density);
    gsn_free(model->cells.inside_share);
    gsn_free(model->cells.residual);
    gsn_free(model->cells.samples);
    gsn_free(model->name);
    gsn_free(model->parameters);
    gsn_free(model->version);
    gsn_free(model);
}
