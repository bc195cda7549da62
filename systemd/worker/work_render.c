/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verb `render`: a picture of the model of a specimen's last run, as PNG.
 *
 * Method: rays through the fitted spline itself (pipeline/render/ray_cast.h); no grid is made. With
 * --preview its cells are projected instead (pipeline/render/projected_tets.h). The
 * picture ends where the region of interest ends, smoothly; `--whole` shows all of the domain. What
 * a picture shows is written on it: how, between which densities, which way up, how large.
 * Steps: (1) the model; (2) what is seen, and the window of densities: those of the cells' means
 * unless it is said; (3) the camera; (4) the rays; (5) the sheet.
 * Failure: a sentence. A file that exists is never written over. */
#include <math.h>
#include <string.h>
#include <strings.h>
#include <sysexits.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"
#include "pipeline/decode/png_write.h"
#include "pipeline/render/projected_tets.h"
#include "pipeline/render/ray_cast.h"
#include "systemd/worker/kept_run.h"
#include "systemd/worker/work_verbs.h"

enum { USUAL_PX = 640, LEAST_PX = 64, MOST_PX = 4096 };

/* A picture, and what it is made of. */
struct render {
    const struct gsn_work_request *request;
    struct gsn_store *store;
    struct gsn_kept_run *kept;
    struct gsn_model *model;
    struct gsn_border *border;
    struct gsn_view view;
    struct gsn_ray_clip clip;
    struct gsn_ray_style style;
    struct gsn_camera camera;
    double plane[1][6], low[3], high[3]; /* what is framed */
    struct gsn_image *image;
    char title[160], note[160];
};

static void render_done(struct render *e)
{
    gsn_store_free(e->store);
    gsn_kept_run_free(e->kept);
    gsn_model_free(e->model);
    gsn_border_free(e->border);
    gsn_image_free(e->image);
}

/* ---- what was asked ------------------------------------------------------------------------ */

/* Directions with names; up is where y, or for y and others z, grows smaller. */
static int read_view(const char *text, struct gsn_view *view)
{
    static const struct {
        const char *name;
        double direction[3], up[3];
    } known[] = { { "corner", { 0.45, 0.62, 0.64 }, { 0, -0.35, -1 } },
                  { "x", { 1, 0, 0 }, { 0, 0, -1 } },
                  { "y", { 0, 1, 0 }, { 0, 0, -1 } },
                  { "z", { 0, 0, 1 }, { 0, -1, 0 } } };

    for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
        if (strcmp(text, known[i].name) != 0)
            continue;
        memcpy(view->direction, known[i].direction, sizeof view->direction);
        memcpy(view->up, known[i].up, sizeof view->up);
        return 1;
    }
    if (!gsn_work_numbers(text, 3, view->direction))
        return 0;
    memcpy(view->up, known[0].up, sizeof view->up);
    return 1;
}

/* NULL: it is fine. */
static const char *read_request(struct render *e)
{
    const struct gsn_work_request *request = e->request;
    const size_t length = request->rest_count == 2 ? strlen(request->rest[1]) : 0;
    double size = USUAL_PX, window[2], box[6];

    if (length < 5 || strcasecmp(request->rest[1] + length - 4, ".png") != 0)
        return "render what, and where to? Say `gieson render SPECIMEN FILE.png`";
    if (request->surface && request->translucent)
        return "a picture is an X-ray, --translucent or --surface V";
    if (request->surface && request->preview)
        return "--preview is of an X-ray or --translucent; a surface is drawn by rays alone";
    if (!read_view(request->view ? request->view : "corner", &e->view))
        return "--view is x, y, z, corner, or a direction into the block: X,Y,Z";
    if (request->size && (!gsn_work_numbers(request->size, 1, &size) || size < LEAST_PX ||
                          size > MOST_PX || size != floor(size)))
        return "--size is the picture's width in pixels, from 64 to 4096";
    e->view.width = e->view.height = (uint32_t)size;
    e->view.eye_distance = request->perspective ? 3 : 0;
    e->style = (struct gsn_ray_style){ .low = NAN, .map = GSN_MAP_VIRIDIS, .level = NAN,
                                       .across = 2 };
    if (request->surface && !gsn_work_numbers(request->surface, 1, &e->style.level))
        return "--surface V is where the density has one value";
    if (request->window) {
        if (!gsn_work_numbers(request->window, 2, window) || !(window[0] < window[1]))
            return "--window is two densities, the smaller first: LOW,HIGH";
        e->style.low = window[0];
        e->style.high = window[1];
        if (!request->surface && !request->translucent)
            return "--window is for --translucent and --surface; an X-ray shows integrals";
    }
    if (request->box) {
        if (!gsn_work_numbers(request->box, 6, box))
            return "--box is two corners in micrometres: X1,Y1,Z1,X2,Y2,Z2";
        e->clip.has_box = 1;
        for (int c = 0; c < 3; c++) {
            e->clip.low[c] = fmin(box[c], box[c + 3]);
            e->clip.high[c] = fmax(box[c], box[c + 3]);
        }
    }
    if (request->plane) {
        if (!gsn_work_numbers(request->plane, 6, e->plane[0]))
            return "--plane is a point in micrometres and a normal: X,Y,Z,NX,NY,NZ";
        e->clip.plane = (const double(*)[6])e->plane;
        e->clip.plane_count = 1;
    }
    return NULL;
}

/* ---- what is seen -------------------------------------------------------------------------- */

static int find_scene(struct render *e, struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(e->model->space);
    const struct gsn_mask *region = e->request->whole ? NULL : e->model->region;

    if (!e->request->whole && !region)
        return gsn_fail(
            err, GSN_E_NOTFOUND,
            "the model of run %lld, by gieson %s, does not say where the region is: add "
            "--whole for all of its domain, or `gieson night` computes it again",
            (long long)e->kept->run->id, e->kept->run->version);
    for (int c = 0; c < 3; c++) {
        e->low[c] = INFINITY;
        e->high[c] = -INFINITY;
    }
    for (size_t v = 0; !region && v < mesh->vertex_count; v++) {
        for (int c = 0; c < 3; c++) {
            e->low[c] = fmin(e->low[c], mesh->vertex[v][c]);
            e->high[c] = fmax(e->high[c], mesh->vertex[v][c]);
        }
    }
    if (region) {
        const struct gsn_vec3 step = region->at.step_um;

        gsn_mask_box(region, e->low, e->high);
        e->clip.border_step_um = fmin(step.x, fmin(step.y, step.z));
    }
    for (int c = 0; e->clip.has_box && c < 3; c++) {
        e->low[c] = fmax(e->low[c], e->clip.low[c]);
        e->high[c] = fmin(e->high[c], e->clip.high[c]);
    }
    for (int c = 0; c < 3; c++) {
        if (!(e->low[c] < e->high[c]))
            return gsn_fail(err, GSN_E_INPUT, "nothing of %s lies in the box",
                            region ? "the region" : "the domain");
    }
    if (!region)
        return GSN_OK;
    return gsn_border_new(region, e->request->threads, &e->border, err);
}

/* From 0, or less, to the greatest mean of a cell. */
static void find_window(struct render *e)
{
    const size_t cells = gsn_dms_mesh(e->model->space)->tet_count;
    double low = 0, high = -INFINITY;

    if (!isnan(e->style.low))
        return;
    for (size_t t = 0; t < cells; t++) {
        double mean = e->model->cells.density ? e->model->cells.density[t] : NAN;

        if (!e->model->cells.density)
            (void)gsn_spline_tet_mean(e->model->spline, t, &mean, NULL);
        low = fmin(low, mean);
        high = fmax(high, mean);
    }
    e->style.low = low;
    e->style.high = high > low ? high : low + 1;
}

static int frame_scene(struct render *e, struct gsn_error *err)
{
    double corner[8][3], across = 0;
    const struct gsn_tets box = { .vertex_count = 8, .vertex = corner };

    for (int i = 0; i < 8; i++) {
        for (int c = 0; c < 3; c++)
            corner[i][c] = i >> c & 1 ? e->high[c] : e->low[c];
    }
    for (int c = 0; c < 3; c++)
        across = fmax(across, e->high[c] - e->low[c]);
    /* Light through a tenth of the scene of the window's upper end: the inner shows through. */
    e->style.opaque_um = across / 10;
    return gsn_camera_frame(&e->view, &box, &e->camera, err);
}

/* ---- the picture --------------------------------------------------------------------------- */

static const char *through_eye(const struct render *e)
{
    return e->camera.eye_um > 0 ? "perspective" : "orthographic";
}

/* What a picture's title says of how it was made. */
static const char *how_made(const struct render *e)
{
    return e->request->preview ? ", preview: cells as if linear" : "";
}

static int draw_xray(struct render *e, struct gsn_error *err)
{
    gsn_auto(gsn_plane) plane = NULL;
    int r = (e->request->preview ? gsn_projected_xray : gsn_ray_xray)(
        e->model->spline, &e->camera, &e->clip, &e->style, e->request->threads, NULL, &plane, err);

    (void)snprintf(e->title, sizeof e->title, "%s: X-ray, %s%s", e->request->rest[0],
                   through_eye(e), how_made(e));
    if (r >= 0)
        r = gsn_xray_paint(plane, &e->camera, e->title, NULL, GSN_MAP_VIRIDIS, &e->image, err);
    return r;
}

static int draw_light(struct render *e, int surface, struct gsn_error *err)
{
    gsn_auto(gsn_ray_picture) picture = NULL;
    int r;

    e->style.shading = surface ? 0 : 0.6;
    if (surface) {
        (void)snprintf(e->title, sizeof e->title, "%s: surface at density %g, %s",
                       e->request->rest[0], e->style.level, through_eye(e));
        (void)snprintf(e->note, sizeof e->note, "cuts show the density");
        r = gsn_ray_surface(e->model->spline, &e->camera, &e->clip, &e->style,
                            e->request->threads, NULL, &picture, err);
    } else {
        (void)snprintf(e->title, sizeof e->title, "%s: emission and absorption, %s%s",
                       e->request->rest[0], through_eye(e), how_made(e));
        (void)snprintf(e->note, sizeof e->note, "%.3g: 1/e through %.3g \xc2\xb5m", e->style.high,
                       e->style.opaque_um);
        r = (e->request->preview ? gsn_projected_volume : gsn_ray_volume)(
            e->model->spline, &e->camera, &e->clip, &e->style, e->request->threads, NULL, &picture,
            err);
    }
    if (r >= 0)
        r = gsn_ray_paint(picture, &e->camera, &e->style, e->title, e->note, &e->image, err);
    return r;
}

static void say_render(const struct render *e, size_t size)
{
    if (e->request->json) {
        json_t *root = json_pack("{s:o, s:I, s:o, s:o, s:I, s:f}", "specimen",
                                 gsn_work_text(e->request->rest[0]), "run",
                                 (json_int_t)e->kept->run->id, "file",
                                 gsn_work_text(e->request->rest[1]), "holds",
                                 gsn_work_text(e->title), "bytes", (json_int_t)size, "um_per_px",
                                 1 / e->camera.px_per_um);

        (void)json_dumpf(root, stdout, JSON_INDENT(2));
        (void)putchar('\n');
        json_decref(root);
        return;
    }
    gsn_work_print(stdout, "%s: %s, %.4g um a pixel; run %lld\n", e->request->rest[1], e->title,
                   1 / e->camera.px_per_um, (long long)e->kept->run->id);
}

int gsn_work_render(const struct gsn_work_request *request)
{
    struct render e __attribute__((cleanup(render_done))) = { .request = request };
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    const char *mistake = read_request(&e);
    size_t size = 0;
    int r;

    if (mistake)
        return gsn_work_usage(request, mistake);
    if (access(request->rest[1], F_OK) == 0)
        return gsn_work_usage(request,
                              "that file exists already, and render writes over none: remove it, "
                              "or say another name");
    r = gsn_store_open(request->store_dir, GSN_STORE_READ, &e.store, &err);
    if (r >= 0)
        r = gsn_kept_run_open(e.store, request->rest[0], &e.kept, &err);
    if (r >= 0)
        r = gsn_kept_run_model(e.store, e.kept, &e.model, &err);
    if (r >= 0)
        r = find_scene(&e, &err);
    if (r >= 0)
        r = frame_scene(&e, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    e.clip.border = e.border;
    find_window(&e);
    r = !request->surface && !request->translucent
            ? draw_xray(&e, &err)
            : draw_light(&e, request->surface != NULL, &err);
    if (r >= 0)
        r = gsn_png_encode(e.image, &bytes, &size, &err);
    if (r >= 0)
        r = gsn_file_write(request->rest[1], bytes, size, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    say_render(&e, size);
    return EX_OK;
}
