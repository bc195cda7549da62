/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* VTK on the same linear tetrahedra with the same point data: vtk_probe.py is started once, loads
 * the mesh, and then takes its turns when told to, timing vtkProbeFilter's Update() alone. */
#include "pipeline/model/resample.h"

#include "tests/bench/bench.h"
#include "tests/bench/peer.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define CLOUD 0.03

/* The mesh as a VTK file of linear tetrahedra, the spline's control values at the vertices. */
int bench_write_mesh(const struct bench_case *bench, const char *path)
{
    const struct gsn_tets *mesh = bench->mesh;
    double *at_vertex = bench_alloc(mesh->vertex_count, sizeof *at_vertex);
    FILE *file = fopen(path, "w");
    int ok;

    if (!file)
        return 0;
    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (size_t k = 0; k < 4; k++) /* at degree 1 function k is that of corner k */
            at_vertex[mesh->tet[t][k]] =
                gsn_spline_controls(bench->spline)[gsn_dms_control_ids(bench->space, t)[k]];
    }
    fprintf(file,
            "# vtk DataFile Version 3.0\ncube\nASCII\nDATASET UNSTRUCTURED_GRID\n"
            "POINTS %zu double\n",
            mesh->vertex_count);
    for (size_t i = 0; i < mesh->vertex_count; i++)
        fprintf(file, "%.17g %.17g %.17g\n", mesh->vertex[i][0], mesh->vertex[i][1],
                mesh->vertex[i][2]);
    fprintf(file, "CELLS %zu %zu\n", mesh->tet_count, 5 * mesh->tet_count);
    for (size_t t = 0; t < mesh->tet_count; t++)
        fprintf(file, "4 %u %u %u %u\n", mesh->tet[t][0], mesh->tet[t][1], mesh->tet[t][2],
                mesh->tet[t][3]);
    fprintf(file, "CELL_TYPES %zu\n", mesh->tet_count);
    for (size_t t = 0; t < mesh->tet_count; t++)
        fprintf(file, "10\n");
    fprintf(file, "POINT_DATA %zu\nSCALARS s double\nLOOKUP_TABLE default\n", mesh->vertex_count);
    for (size_t i = 0; i < mesh->vertex_count; i++)
        fprintf(file, "%.17g\n", at_vertex[i]);
    ok = ferror(file) == 0;
    gsn_free(at_vertex);
    return fclose(file) == 0 && ok;
}

static int start_probe(struct bench_peer *probe, char *mesh, char *edge, char *values)
{
    char *argv[] = {
        (char[]){ GSN_DEBIAN_PYTHON }, (char[]){ GSN_BENCH_PROBE }, mesh, edge, values, NULL
    };

    return bench_peer_start(probe, argv);
}

/* The largest difference between VTK's linear interpolation and our spline, whose skins around the
 * faces are smooth: a sign that both did the same work, not an error of either. */
static double compare(const char *path, const double *ours, size_t count)
{
    FILE *file = fopen(path, "rb");
    double worst = 0, theirs;

    for (size_t i = 0; i < count; i++) {
        if (!file || fread(&theirs, sizeof theirs, 1, file) != 1)
            theirs = DBL_MAX;
        worst = fmax(worst, fabs(theirs - ours[i]));
    }
    if (file)
        (void)fclose(file);
    return worst;
}

struct grid {
    const struct gsn_spline *spline;
    struct gsn_lattice at;
    double *value;
};

static void run_grid(void *context)
{
    const struct grid *grid = context;
    struct gsn_error err = { 0 };

    bench_need(gsn_spline_resample(grid->spline, &grid->at, 1, grid->value, &err), &err,
               "resample");
}

/* Turns of both; returns 0 when VTK is not there. */
static int take_turns(const struct bench_peer *probe, struct bench_job *ours, double *ret_vtk_s)
{
    const unsigned repeats = bench_quick ? 1 : 7;
    double least = INFINITY, least_vtk = INFINITY;

    if (bench_peer_ask(probe, "load", NULL) < 0)
        return 0;
    for (unsigned turn = 0; turn < repeats; turn++) {
        const double vtk = bench_peer_ask(probe, "probe", NULL);

        if (vtk < 0)
            return 0;
        least_vtk = fmin(least_vtk, vtk);
        bench_race(ours, 1, 1);
        least = fmin(least, ours->cpu_s);
    }
    ours->cpu_s = least;
    *ret_vtk_s = least_vtk;
    return bench_peer_ask(probe, "write", NULL) >= 0;
}

static void contest(struct bench_case *bench, char *mesh_path, char *values_path)
{
    const size_t edge = bench_quick ? 16 : 96, voxels = edge * edge * edge;
    struct grid grid = { .spline = bench->spline,
                         .at = bench_lattice(edge),
                         .value = bench_alloc(voxels, sizeof *grid.value) };
    struct bench_job job = { .run = run_grid, .context = &grid };
    struct bench_peer probe = { 0 };
    double vtk_s = 0;
    char text[32];

    snprintf(text, sizeof text, "%zu", edge);
    if (!bench_write_mesh(bench, mesh_path) || !start_probe(&probe, mesh_path, text, values_path)) {
        bench_skip("vtk", "ns/point", "vtkProbeFilter", "the peer could not be started");
    } else if (!take_turns(&probe, &job, &vtk_s)) {
        bench_skip("vtk", "ns/point", "vtkProbeFilter",
                   "python3-vtk9 is not installed for " GSN_DEBIAN_PYTHON ", or it failed");
    } else {
        bench_say("vtk", job.cpu_s * 1e9 / (double)voxels, "ns/point", "vtkProbeFilter",
                  vtk_s / job.cpu_s,
                  json_pack("{s:i, s:I, s:I, s:f, s:f, s:s}", "degree", 1, "tets",
                            (json_int_t)bench->mesh->tet_count, "grid", (json_int_t)edge,
                            "against_ns", vtk_s * 1e9 / (double)voxels, "largest_difference",
                            compare(values_path, grid.value, voxels), "of",
                            "least of 7 turns each"));
    }
    bench_peer_end(&probe);
    gsn_free(grid.value);
}

void bench_vtk(void)
{
    char folder[] = "/tmp/gieson-bench.XXXXXX", mesh_path[64], values_path[64];
    struct bench_case bench;

    if (!mkdtemp(folder)) {
        bench_skip("vtk", "ns/point", "vtkProbeFilter", "no folder could be made in /tmp");
        return;
    }
    snprintf(mesh_path, sizeof mesh_path, "%s/mesh.vtk", folder);
    snprintf(values_path, sizeof values_path, "%s/values", folder);
    bench = bench_case_new(BENCH_27K, 1, CLOUD);
    contest(&bench, mesh_path, values_path);
    bench_case_done(&bench);
    (void)unlink(mesh_path);
    (void)unlink(values_path);
    (void)rmdir(folder);
}
