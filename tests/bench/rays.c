/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures of 512^2 rays on the cube, orthographic and oblique: a linear field against VTK's
 * mappers on the same tetrahedra, and a quadratic spline against a trilinear caster on 256^3 voxels
 * of it, steps of half a voxel, scalar code like ours.
 *
 * Errors are rms over pixels. Of the linear field the truth is a closed form (a chord of the cube),
 * of the spline the integral along a few segments. */
#include "pipeline/model/resample.h"
#include "pipeline/render/projected_tets.h"
#include "pipeline/render/ray_cast.h"

#include "tests/bench/bench.h"
#include "tests/bench/peer.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define CLOUD 0.03

static const double KAPPA = 2;
enum { EDGE = 256, SAMPLED = 40 };

struct scene {
    struct bench_case bench;
    struct gsn_camera camera;
    struct gsn_ray_style style;
    unsigned threads;
    struct gsn_plane *plane;
    struct gsn_ray_picture *picture;
    const double *voxel; /* of the peer */
    size_t edge;
    float *theirs;
};

static double linear_at(const double u[3])
{
    return 0.1 + 0.3 * u[0] + 0.2 * u[1] + 0.25 * u[2];
}

static struct scene scene_new(enum bench_size size, unsigned degree)
{
    const uint32_t px = bench_quick ? 48 : 512;
    const struct gsn_view view = {
        .direction = { 0.45, 0.62, 0.64 }, .up = { 0, -0.35, -1 }, .width = px, .height = px
    };
    struct scene scene = { .bench = bench_case_new(size, degree, CLOUD),
                           .style = { .low = 0,
                                      .high = 1,
                                      .opaque_um = 1 / KAPPA,
                                      .map = GSN_MAP_GREY,
                                      .level = NAN,
                                      .across = 1 },
                           .threads = 1 };
    struct gsn_error err = { 0 };

    bench_need(gsn_camera_frame(&view, scene.bench.mesh, &scene.camera, &err), &err, "camera");
    return scene;
}

static void scene_done(struct scene *scene)
{
    gsn_plane_free(scene->plane);
    gsn_ray_picture_free(scene->picture);
    bench_case_done(&scene->bench);
}

static void run_xray(void *context)
{
    struct scene *scene = context;
    struct gsn_error err = { 0 };

    gsn_plane_free(scene->plane);
    scene->plane = NULL;
    bench_need(gsn_ray_xray(scene->bench.spline, &scene->camera, NULL, &scene->style,
                            scene->threads, NULL, &scene->plane, &err),
               &err, "X-ray");
}

static void run_light(void *context)
{
    struct scene *scene = context;
    struct gsn_error err = { 0 };

    gsn_ray_picture_free(scene->picture);
    scene->picture = NULL;
    bench_need(gsn_ray_volume(scene->bench.spline, &scene->camera, NULL, &scene->style,
                              scene->threads, NULL, &scene->picture, &err),
               &err, "light");
}

static void run_projected(void *context)
{
    struct scene *scene = context;
    struct gsn_error err = { 0 };

    gsn_ray_picture_free(scene->picture);
    scene->picture = NULL;
    bench_need(gsn_projected_volume(scene->bench.spline, &scene->camera, NULL, &scene->style,
                                    scene->threads, NULL, &scene->picture, &err),
               &err, "light of cells");
}

static void run_projected_xray(void *context)
{
    struct scene *scene = context;
    struct gsn_error err = { 0 };

    gsn_plane_free(scene->plane);
    scene->plane = NULL;
    bench_need(gsn_projected_xray(scene->bench.spline, &scene->camera, NULL, &scene->style,
                                  scene->threads, NULL, &scene->plane, &err),
               &err, "X-ray of cells");
}

static int cube_chord(const double start[3], const double into[3], double *ret_from, double *ret_to)
{
    *ret_from = -INFINITY;
    *ret_to = INFINITY;
    for (int c = 0; c < 3; c++) {
        const double a = -start[c] / into[c], b = (1 - start[c]) / into[c];

        *ret_from = fmax(*ret_from, fmin(a, b));
        *ret_to = fmin(*ret_to, fmax(a, b));
    }
    return *ret_from < *ret_to;
}

/* ---- the linear field ---- */

static void make_linear(struct bench_case *bench)
{
    double *control = bench_alloc(gsn_dms_controls(bench->space), sizeof *control);
    struct gsn_error err = { 0 };

    for (size_t t = 0; t < bench->mesh->tet_count; t++) {
        for (size_t k = 0; k < 4; k++)
            control[gsn_dms_control_ids(bench->space, t)[k]] =
                linear_at(bench->mesh->vertex[bench->mesh->tet[t][k]]);
    }
    gsn_spline_free(bench->spline);
    bench->spline = NULL;
    bench_need(gsn_spline_new(bench->space, control, &bench->spline, &err), &err, "spline");
    gsn_free(control);
}

/* The integral along the ray. */
static double linear_truth(const struct gsn_camera *camera, uint32_t x, uint32_t y)
{
    double start[3], from, to, middle[3];

    gsn_ray_start(camera, x + 0.5, y + 0.5, start);
    if (!cube_chord(start, camera->into, &from, &to))
        return 0;
    for (int c = 0; c < 3; c++)
        middle[c] = start[c] + (from + to) / 2 * camera->into[c];
    return (to - from) * linear_at(middle);
}

/* In steps of 8 bits. */
static double linear_error(const struct scene *scene, const uint8_t *theirs)
{
    const uint32_t px = scene->camera.width;
    double sum = 0;

    for (uint32_t y = 0; y < px; y++) {
        for (uint32_t x = 0; x < px; x++) {
            const double got =
                theirs ? theirs[y * px + x] / 255.0 : (double)scene->picture->rgba[y * px + x][3];
            const double off = got + expm1(-KAPPA * linear_truth(&scene->camera, x, y));

            sum += off * off;
        }
    }
    return 255 * sqrt(sum / px / px);
}

/* Of the X-ray, as a share of the deepest, in steps of 8 bits. */
static double linear_xray_error(const struct scene *scene)
{
    const uint32_t px = scene->camera.width;
    double sum = 0, most = 0;

    for (uint32_t y = 0; y < px; y++) {
        for (uint32_t x = 0; x < px; x++) {
            const double got = (double)scene->plane->value[y * px + x];
            const double truth = linear_truth(&scene->camera, x, y);
            const double off = (isnan(got) ? 0 : got) - truth;

            sum += off * off;
            most = fmax(most, truth);
        }
    }
    return 255 * sqrt(sum / px / px) / most;
}

static int write_camera(const struct scene *scene, const char *path)
{
    const struct gsn_camera *camera = &scene->camera;
    json_t *root = json_pack(
        "{s:i, s:f, s:f, s:[f,f,f], s:[f,f,f], s:[f,f,f]}", "size", (int)camera->width, "kappa",
        KAPPA, "half_height", camera->height / 2.0 / camera->px_per_um, "centre", camera->centre[0],
        camera->centre[1], camera->centre[2], "into", camera->into[0], camera->into[1],
        camera->into[2], "up", -camera->down[0], -camera->down[1], -camera->down[2]);
    const int ok = json_dump_file(root, path, 0) == 0;

    json_decref(root);
    return ok;
}

static void contest(struct scene *scene, const char *measure, void (*run)(void *),
                    const struct bench_peer *peer, const char *mapper, const char *path)
{
    const size_t pixels = (size_t)scene->camera.width * scene->camera.width;
    uint8_t *theirs = bench_alloc(pixels, 1);
    struct bench_job job = { .run = run, .context = scene };
    double ours = INFINITY, vtk = INFINITY;
    FILE *file;

    for (unsigned turn = 0; turn < (bench_quick ? 1 : 3) && vtk >= 0; turn++) {
        const double took = bench_peer_ask(peer, mapper, NULL);

        vtk = took < 0 ? -1 : fmin(vtk, took);
        bench_race(&job, 1, 1);
        ours = fmin(ours, job.cpu_s);
    }
    file = vtk >= 0 && bench_peer_ask(peer, "write", NULL) >= 0 ? fopen(path, "rb") : NULL;
    if (!file || fread(theirs, 1, pixels, file) != pixels)
        bench_skip(measure, "s", mapper,
                   "python3-vtk9 is not installed for " GSN_DEBIAN_PYTHON ", or it failed");
    else
        bench_say(measure, ours, "s", mapper, vtk / ours,
                  json_pack("{s:I, s:f, s:f, s:f}", "tets",
                            (json_int_t)scene->bench.mesh->tet_count, "against_s", vtk,
                            "rms_in_255ths", linear_error(scene, NULL), "against_rms_in_255ths",
                            linear_error(scene, theirs)));
    if (file)
        (void)fclose(file);
    gsn_free(theirs);
}

/* Cells against rays, on the same linear cube. */
static void race_cells(struct scene *scene)
{
    struct bench_job job[2] = { { .run = run_projected_xray, .context = scene },
                                { .run = run_xray, .context = scene } };
    double cells;

    bench_race(job, 1, 1);
    cells = linear_xray_error(scene);
    bench_race(job, 2, bench_quick ? 1 : 3);
    bench_say("rays_projected_xray", job[0].cpu_s, "s", "our rays", job[1].cpu_s / job[0].cpu_s,
              json_pack("{s:f, s:f}", "rms_in_255ths", cells, "against_rms_in_255ths",
                        linear_xray_error(scene)));
}

static void race_vtk(void)
{
    static const char *const MAPPERS[] = { "projected", "raycast", "fixed" };
    char folder[] = "/tmp/gieson-bench.XXXXXX", path[3][64];
    struct scene scene = scene_new(BENCH_27K, 1);
    struct bench_peer peer = { 0 };

    make_linear(&scene.bench);
    race_cells(&scene);
    if (mkdtemp(folder)) {
        snprintf(path[0], sizeof path[0], "%s/mesh.vtk", folder);
        snprintf(path[1], sizeof path[1], "%s/camera.json", folder);
        snprintf(path[2], sizeof path[2], "%s/picture", folder);
    }
    if (path[0][0] && bench_write_mesh(&scene.bench, path[0]) && write_camera(&scene, path[1])) {
        char *argv[] = { (char[]){ GSN_DEBIAN_PYTHON },
                         (char[]){ GSN_BENCH_RAYS },
                         path[0],
                         path[1],
                         path[2],
                         NULL };

        (void)bench_peer_start(&peer, argv);
        (void)bench_peer_ask(&peer, "load", NULL);
        contest(&scene, "rays_projected", run_projected, &peer, MAPPERS[0], path[2]);
        for (size_t m = 0; m < sizeof MAPPERS / sizeof *MAPPERS; m++)
            contest(&scene, "rays_linear", run_light, &peer, MAPPERS[m], path[2]);
        bench_peer_end(&peer);
    }
    for (int i = 0; i < 3; i++)
        (void)unlink(path[i]);
    (void)rmdir(folder);
    scene_done(&scene);
}

/* ---- a quadratic spline ---- */

static double voxel_at(const struct scene *scene, const double u[3])
{
    const size_t edge = scene->edge, stride[3] = { 1, edge, edge * edge };
    double share[3], plane[4];
    size_t at = 0;

    for (int c = 0; c < 3; c++) {
        const double place = fmin((double)edge - 1, fmax(0, u[c] * (double)edge - 0.5));
        const double below = fmin((double)edge - 2, floor(place));

        share[c] = place - below;
        at += (size_t)below * stride[c];
    }
    for (unsigned i = 0; i < 4; i++) {
        const double *v = scene->voxel + at + (i & 1) * stride[1] + (i >> 1) * stride[2];

        plane[i] = v[0] + share[0] * (v[1] - v[0]);
    }
    return (plane[0] + share[1] * (plane[1] - plane[0])) * (1 - share[2]) +
           (plane[2] + share[1] * (plane[3] - plane[2])) * share[2];
}

/* X-ray, or transparency where light is asked for. */
static double step_ray(const struct scene *scene, uint32_t x, uint32_t y, int light)
{
    const double step = 0.5 / (double)scene->edge;
    double start[3], from, to, sum = 0, left = 1;

    gsn_ray_start(&scene->camera, x + 0.5, y + 0.5, start);
    if (!cube_chord(start, scene->camera.into, &from, &to))
        return 0;
    for (double t = from + step / 2; t < to && left > 1e-5; t += step) {
        double u[3], s;

        for (int c = 0; c < 3; c++)
            u[c] = start[c] + t * scene->camera.into[c];
        s = voxel_at(scene, u);
        sum += s * fmin(step, to - t + step / 2);
        if (light)
            left *= exp(-KAPPA * step * fmin(1, fmax(0, s)));
    }
    return light ? 1 - left : sum;
}

static void run_steps(struct scene *scene, int light)
{
    for (uint32_t y = 0; y < scene->camera.height; y++) {
        for (uint32_t x = 0; x < scene->camera.width; x++)
            scene->theirs[y * scene->camera.width + x] = (float)step_ray(scene, x, y, light);
    }
}

static void run_xray_steps(void *context)
{
    run_steps(context, 0);
}

static void run_light_steps(void *context)
{
    run_steps(context, 1);
}

/* Largest errors of both X-rays on a few rays. */
static void xray_errors(const struct scene *scene, double *ret_ours, double *ret_theirs)
{
    const struct gsn_camera *camera = &scene->camera;
    uint64_t seed = 3;

    *ret_ours = *ret_theirs = 0;
    for (int i = 0; i < SAMPLED; i++) {
        const uint32_t x = (uint32_t)(bench_draw(&seed) * camera->width);
        const uint32_t y = (uint32_t)(bench_draw(&seed) * camera->height);
        const size_t at = (size_t)y * camera->width + x;
        double start[3], end[2][3], from, to, truth;
        struct gsn_error err = { 0 };

        gsn_ray_start(camera, x + 0.5, y + 0.5, start);
        if (!cube_chord(start, camera->into, &from, &to))
            continue;
        for (int c = 0; c < 3; c++) {
            end[0][c] = start[c] + from * camera->into[c];
            end[1][c] = start[c] + to * camera->into[c];
        }
        bench_need(gsn_spline_segment(scene->bench.spline, end[0], end[1], &truth, &err), &err,
                   "segment");
        *ret_ours = fmax(*ret_ours, fabs((double)scene->plane->value[at] - truth));
        *ret_theirs = fmax(*ret_theirs, fabs((double)scene->theirs[at] - truth));
    }
}

static void race_steps(void)
{
    struct scene scene = scene_new(BENCH_27K, 2);
    const size_t edge = bench_quick ? 24 : EDGE;
    const struct gsn_lattice at = bench_lattice(edge);
    double *voxel = bench_alloc(gsn_lattice_count(&at), sizeof *voxel), ours, theirs;
    struct bench_job xray[2] = { { .run = run_xray, .context = &scene },
                                 { .run = run_xray_steps, .context = &scene } };
    struct bench_job light[2] = { { .run = run_light, .context = &scene },
                                  { .run = run_light_steps, .context = &scene } };
    struct gsn_error err = { 0 };

    bench_need(gsn_spline_resample(scene.bench.spline, &at, 1, voxel, &err), &err, "resample");
    scene.voxel = voxel;
    scene.edge = edge;
    scene.theirs =
        bench_alloc((size_t)scene.camera.width * scene.camera.width, sizeof *scene.theirs);
    bench_race(xray, 2, bench_quick ? 1 : 3);
    xray_errors(&scene, &ours, &theirs);
    bench_say("rays_xray", xray[0].cpu_s, "s", "a trilinear caster", xray[1].cpu_s / xray[0].cpu_s,
              json_pack("{s:i, s:I, s:f, s:f}", "degree", 2, "tets",
                        (json_int_t)scene.bench.mesh->tet_count, "largest_error", ours,
                        "against_largest_error", theirs));
    bench_race(light, 2, bench_quick ? 1 : 3);
    bench_say("rays_light", light[0].cpu_s, "s", "a trilinear caster",
              light[1].cpu_s / light[0].cpu_s, json_pack("{s:i}", "degree", 2));
    scene.threads = 2;
    bench_race(&xray[0], 1, bench_quick ? 1 : 3);
    bench_say("rays_threads", xray[0].wall_s, "s", "the same on one thread, CPU time",
              xray[1].cpu_s > 0 ? xray[0].cpu_s / xray[0].wall_s : NAN, NULL);
    gsn_free(scene.theirs);
    gsn_free(voxel);
    scene_done(&scene);
}

static void grow(void)
{
    double took[2], tets[2];

    for (int i = 0; i < 2; i++) {
        struct scene scene = scene_new(i ? BENCH_27K : BENCH_4K, 2);
        struct bench_job job = { .run = run_xray, .context = &scene };

        bench_race(&job, 1, bench_quick ? 1 : 3);
        took[i] = job.cpu_s;
        tets[i] = (double)scene.bench.mesh->tet_count;
        scene_done(&scene);
    }
    bench_say("rays_slope", log(took[1] / took[0]) / log(tets[1] / tets[0]), "power of tetrahedra",
              NULL, NAN, json_pack("{s:f, s:f}", "small_s", took[0], "large_s", took[1]));
}

void bench_rays(void)
{
    race_vtk();
    race_steps();
    grow();
}
