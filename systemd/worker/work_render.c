/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verb `render`: a picture of the models of specimens' last runs, side by side, as PNG.
 *
 * Method: rays through the fitted spline itself (pipeline/render/ray_cast.h); no grid is made. With
 * --preview its cells are projected instead (pipeline/render/projected_tets.h); --cells draws them
 * apart (pipeline/render/cells_picture.h). The picture ends where the region of interest ends,
 * smoothly; `--whole` shows all of the domain. What a picture shows is written on it: how, between
 * which densities, which way up, how large. Pictures side by side have one scale of lengths and one
 * of densities, or they could not be compared.
 * Steps: (1) the models; (2) what is seen of each, and the window of densities: those of all cells'
 * means unless it is said; (3) the cameras, of the scale at which the largest scene fits; (4) the
 * rays; (5) the sheets, and them beside each other.
 * Failure: a sentence. A file that exists is never written over. */
#include <math.h>
#include <string.h>
#include <strings.h>
#include <sysexits.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"
#include "pipeline/decode/png_write.h"
#include "pipeline/render/cells_picture.h"
#include "pipeline/render/lettering.h"
#include "pipeline/render/projected_tets.h"
#include "pipeline/render/ray_cast.h"
#include "systemd/worker/kept_run.h"
#include "systemd/worker/work_verbs.h"

enum { FILMS_ROOM = 64, USUAL_PX = 640, LEAST_PX = 64, MOST_PX = 4096, MOST_SCENES = 8 };

/* Of what lies behind a film that is faced, so much is hidden. */
static const double FILM_OPACITY = 0.3;

/* One model, and what is seen of it. */
struct scene {
    const char *name; /* of the specimen */
    struct gsn_kept_run *kept;
    struct gsn_model *model;
    double *mean; /* of each cell; NaN: it is not shown as a cell */
    struct gsn_border *border;
    struct gsn_ray_clip clip;
    struct gsn_block_box_um box; /* what is framed */
    struct gsn_camera camera;
    struct gsn_plane *xray;
    struct gsn_image *sheet;
    char title[160];
};

/* A picture, and what it is made of. */
struct render {
    const struct gsn_work_request *request;
    struct gsn_store *store;
    struct scene scene[MOST_SCENES];
    int scenes;
    struct gsn_view view;
    struct gsn_ray_clip clip; /* as it was asked for */
    struct gsn_ray_style style;
    double plane[1][6], cells; /* share of their size; 0: not asked for */
    struct gsn_image *image;
    char note[160];
};

static void render_done(struct render *e)
{
    for (int i = 0; i < MOST_SCENES; i++) {
        struct scene *s = &e->scene[i];

        gsn_kept_run_free(s->kept);
        gsn_model_free(s->model);
        gsn_free(s->mean);
        gsn_border_free(s->border);
        gsn_plane_free(s->xray);
        gsn_image_free(s->sheet);
    }
    gsn_store_free(e->store);
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

/* The greatest is the surface, others are films before it. */
static int read_levels(const char *text, struct gsn_ray_style *style)
{
    double level[1 + GSN_RAY_FILMS];
    size_t count = 1, top = 0;

    while (count <= 1 + GSN_RAY_FILMS && !gsn_work_numbers(text, count, level))
        count++;
    if (count > 1 + GSN_RAY_FILMS)
        return 0;
    for (size_t i = 1; i < count; i++)
        top = level[i] > level[top] ? i : top;
    style->level = level[top];
    style->film_opacity = FILM_OPACITY;
    for (size_t i = 0; i < count; i++)
        if (i != top)
            style->film[style->films++] = level[i];
    for (unsigned f = 0; f < style->films; f++)
        if (!(style->film[f] < style->level))
            return 0;
    return 1;
}

/* NULL: it is fine. */
static const char *read_request(struct render *e)
{
    const struct gsn_work_request *request = e->request;
    const int last = request->rest_count - 1;
    const size_t length = last >= 1 ? strlen(request->rest[last]) : 0;
    double size = USUAL_PX, window[2], box[6];

    if (length < 5 || strcasecmp(request->rest[last] + length - 4, ".png") != 0)
        return "render what, and where to? Say `gieson render SPECIMEN FILE.png`";
    if (last > MOST_SCENES)
        return "at most 8 specimens fit side by side";
    if ((request->surface != NULL) + request->translucent + (request->cells != NULL) > 1)
        return "a picture is an X-ray, --translucent, --surface V or --cells PERCENT";
    if (request->cells &&
        (!gsn_work_numbers(request->cells, 1, &e->cells) || !(e->cells >= 1 && e->cells <= 100)))
        return "--cells is how large cells are drawn, from 1 to 100 per cent";
    e->cells /= 100;
    if (request->true_colour && !request->translucent && !request->surface)
        return "--true-colour is for --translucent and --surface V";
    if (request->true_colour && request->preview)
        return "--preview is in the colours of the density; --true-colour is drawn by rays alone";
    if (request->cells && request->preview)
        return "--preview is of an X-ray or --translucent; cells are drawn as they are";
    if (request->surface && request->preview)
        return "--preview is of an X-ray or --translucent; a surface is drawn by rays alone";
    if (!read_view(request->view ? request->view : "corner", &e->view))
        return "--view is x, y, z, corner, or a direction into the block: X,Y,Z";
    if (request->size && (!gsn_work_numbers(request->size, 1, &size) || size < LEAST_PX ||
                          size > MOST_PX || size != floor(size)))
        return "--size is the picture's width in pixels, from 64 to 4096";
    e->view.width = e->view.height = (uint32_t)size;
    e->view.eye_distance = request->perspective ? 3 : 0;
    e->style =
        (struct gsn_ray_style){ .low = NAN, .map = GSN_MAP_VIRIDIS, .level = NAN, .across = 2 };
    if (request->surface && !read_levels(request->surface, &e->style))
        return "--surface V is where the density has one value; up to three smaller ones before or "
               "behind it, as 0.2,0.5, are seen through";
    if (request->window) {
        if (!gsn_work_numbers(request->window, 2, window) || !(window[0] < window[1]))
            return "--window is two densities, the smaller first: LOW,HIGH";
        e->style.low = window[0];
        e->style.high = window[1];
        if (!request->surface && !request->translucent && !request->cells)
            return "--window is for --translucent, --surface and --cells; an X-ray shows integrals";
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

/* Means of the cells: as the model keeps them, which is of those with tissue of the region; or,
 * where it keeps none or all of the domain is shown, of the spline. */
static int find_means(const struct render *e, struct scene *s, struct gsn_error *err)
{
    const size_t cells = gsn_dms_mesh(s->model->space)->tet_count;
    const double *kept = e->request->whole ? NULL : s->model->cells.density;

    s->mean = gsn_alloc_array(cells, sizeof *s->mean);
    if (!s->mean)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the means of %zu cells", cells);
    for (size_t t = 0; t < cells; t++) {
        s->mean[t] = kept ? kept[t] : NAN;
        if (!kept)
            (void)gsn_spline_tet_mean(s->model->spline, t, &s->mean[t], NULL);
    }
    return GSN_OK;
}

/* Around the cells that are shown, which reach beyond the region; low: NaN, or less is not
 * shown. */
static void frame_cells(struct scene *s, double low)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(s->model->space);

    for (size_t t = 0; t < mesh->tet_count; t++) {
        if (isnan(s->mean[t]) || s->mean[t] < low)
            continue;
        for (int k = 0; k < 4; k++)
            for (int c = 0; c < 3; c++) {
                const double at = mesh->vertex[mesh->tet[t][k]][c];

                s->box.low[c] = fmin(s->box.low[c], at);
                s->box.high[c] = fmax(s->box.high[c], at);
            }
    }
}

static int find_scene(struct render *e, struct scene *s, struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(s->model->space);
    const struct gsn_mask *region = e->request->whole ? NULL : s->model->region;
    double *const low = s->box.low, *const high = s->box.high;

    if (!e->request->whole && !region)
        return gsn_fail(
            err, GSN_E_NOTFOUND,
            "the model of run %lld, by gieson %s, does not say where the region is: add "
            "--whole for all of its domain, or `gieson night` computes it again",
            (long long)s->kept->run->id, s->kept->run->version);
    s->clip = e->clip;
    for (int c = 0; c < 3; c++) {
        low[c] = INFINITY;
        high[c] = -INFINITY;
    }
    for (size_t v = 0; !region && v < mesh->vertex_count; v++) {
        for (int c = 0; c < 3; c++) {
            low[c] = fmin(low[c], mesh->vertex[v][c]);
            high[c] = fmax(high[c], mesh->vertex[v][c]);
        }
    }
    if (region && e->cells > 0) {
        frame_cells(s, e->style.low);
    } else if (region) {
        const struct gsn_vec3 step = region->at.step_um;

        gsn_mask_box(region, low, high);
        s->clip.border_step_um = fmin(step.x, fmin(step.y, step.z));
    }
    for (int c = 0; s->clip.has_box && c < 3; c++) {
        low[c] = fmax(low[c], s->clip.low[c]);
        high[c] = fmin(high[c], s->clip.high[c]);
    }
    if (e->cells > 0 && !(low[0] < high[0]))
        return gsn_fail(err, GSN_E_INPUT,
                        "no cell of the window's densities lies in what is shown");
    for (int c = 0; c < 3; c++) {
        if (!(low[c] < high[c]))
            return gsn_fail(err, GSN_E_INPUT, "nothing of %s lies in the box",
                            region ? "the region" : "the domain");
    }
    if (!region || e->cells > 0)
        return GSN_OK;
    return gsn_border_new(region, e->request->threads, &s->border, err);
}

static int open_scene(struct render *e, struct scene *s, struct gsn_error *err)
{
    int r = gsn_kept_run_open(e->store, s->name, &s->kept, err);

    if (r >= 0)
        r = gsn_kept_run_model(e->store, s->kept, &s->model, err);
    if (r >= 0)
        r = find_means(e, s, err);
    if (r >= 0)
        r = find_scene(e, s, err);
    return r < 0 && e->scenes > 1 ? gsn_fail_at(err, "%s", s->name) : r;
}

/* From 0, or less, to the greatest mean of a cell of any of them. */
static void find_window(struct render *e)
{
    double low = 0, high = -INFINITY;

    if (!isnan(e->style.low))
        return;
    for (int i = 0; i < e->scenes; i++) {
        const struct scene *s = &e->scene[i];

        for (size_t t = 0; t < gsn_dms_mesh(s->model->space)->tet_count; t++) {
            low = fmin(low, s->mean[t]);
            high = fmax(high, s->mean[t]);
        }
    }
    e->style.low = low;
    e->style.high = high > low ? high : low + 1;
}

static int frame_scenes(struct render *e, struct gsn_error *err)
{
    double across = 0, scale = INFINITY;

    for (int i = 0; i < e->scenes; i++) {
        struct scene *s = &e->scene[i];
        double corner[8][3];
        const struct gsn_tets box = { .vertex_count = 8, .vertex = corner };
        int r;

        for (int k = 0; k < 8; k++) {
            for (int c = 0; c < 3; c++)
                corner[k][c] = k >> c & 1 ? s->box.high[c] : s->box.low[c];
        }
        for (int c = 0; c < 3; c++)
            across = fmax(across, s->box.high[c] - s->box.low[c]);
        r = gsn_camera_frame(&e->view, &box, &s->camera, err);
        if (r < 0)
            return r;
        scale = fmin(scale, s->camera.px_per_um);
    }
    for (int i = 0; i < e->scenes; i++)
        e->scene[i].camera.px_per_um = GSN_BLOCK_AXES_SHARE * scale;
    /* Light through a tenth of the scene of the window's upper end: the inner shows through. */
    e->style.opaque_um = across / 10;
    return GSN_OK;
}

/* ---- the picture --------------------------------------------------------------------------- */

static const char *through_eye(const struct scene *s)
{
    return s->camera.eye_um > 0 ? "perspective" : "orthographic";
}

/* What a picture's title says of how it was made. */
static const char *how_made(const struct render *e)
{
    return e->request->preview ? ", preview: cells as if linear" : "";
}

static int draw_xrays(struct render *e, struct gsn_error *err)
{
    double range[2] = { 0, 0 };
    int r = GSN_OK;

    for (int i = 0; r >= 0 && i < e->scenes; i++) {
        struct scene *s = &e->scene[i];
        double low = 0, high = 0;

        r = (e->request->preview ? gsn_projected_xray
                                 : gsn_ray_xray)(s->model->spline, &s->camera, &s->clip, &e->style,
                                                 e->request->threads, NULL, &s->xray, err);
        if (r < 0)
            return r;
        gsn_plate_range(s->xray, &low, &high);
        range[0] = fmin(range[0], low);
        range[1] = i == 0 ? high : fmax(range[1], high);
    }
    for (int i = 0; r >= 0 && i < e->scenes; i++) {
        struct scene *s = &e->scene[i];

        (void)snprintf(s->title, sizeof s->title, "%s: X-ray, %s%s", s->name, through_eye(s),
                       how_made(e));
        r = gsn_xray_paint(s->xray, &s->camera, &s->box, range, s->title, NULL, GSN_MAP_VIRIDIS,
                           &s->sheet, err);
    }
    return r;
}

/* Colours of the sections, where they are asked for. */
static int take_colours(struct render *e, const struct scene *s, struct gsn_error *err)
{
    if (!e->request->true_colour)
        return GSN_OK;
    e->style.colour = gsn_model_colours(s->model);
    return e->style.colour
               ? GSN_OK
               : gsn_fail(err, GSN_E_NOTFOUND,
                          "the model of run %lld of %s, by gieson %s, has no colours: a "
                          "volume has none, and `gieson night` computes sections of an "
                          "older version again",
                          (long long)s->kept->run->id, s->name, s->kept->run->version);
}

/* ", seen through 0.2 and 0.35". */
static const char *name_films(const struct gsn_ray_style *style, char room[FILMS_ROOM])
{
    size_t used = 0;

    room[0] = '\0';
    for (unsigned f = 0; f < style->films && used < FILMS_ROOM; f++)
        used += (size_t)snprintf(room + used, FILMS_ROOM - used, "%s%g",
                                 f == 0                  ? ", seen through "
                                 : f + 1 == style->films ? " and "
                                                         : ", ",
                                 style->film[f]);
    return room;
}

static int draw_light(struct render *e, struct scene *s, struct gsn_error *err)
{
    const struct gsn_spline *spline = s->model->spline;
    const unsigned threads = e->request->threads;
    const char *coloured = e->request->true_colour ? " in true colour" : "";
    gsn_auto(gsn_ray_picture) picture = NULL;
    char films[FILMS_ROOM];
    int r = take_colours(e, s, err);

    if (r < 0)
        return r;
    e->style.shading = e->request->translucent ? 0.6 : 0;
    if (e->request->surface) {
        (void)snprintf(s->title, sizeof s->title, "%s: surface at density %g%s%s, %s", s->name,
                       e->style.level, name_films(&e->style, films), coloured, through_eye(s));
        (void)snprintf(e->note, sizeof e->note, "cuts show the %s; axes in \xc2\xb5m",
                       coloured[0] ? "colour" : "density");
        r = gsn_ray_surface(spline, &s->camera, &s->clip, &e->style, threads, NULL, &picture, err);
    } else if (e->cells > 0) {
        (void)snprintf(s->title, sizeof s->title, "%s: cells at %g %%, %s", s->name, 100 * e->cells,
                       through_eye(s));
        (void)snprintf(e->note, sizeof e->note, "mean of each cell; axes in \xc2\xb5m");
        r = gsn_cells_picture(gsn_dms_mesh(s->model->space), s->mean, e->cells, &s->camera,
                              &s->clip, &e->style, threads, &picture, err);
    } else {
        (void)snprintf(s->title, sizeof s->title, "%s: emission and absorption%s, %s%s", s->name,
                       coloured, through_eye(s), how_made(e));
        (void)snprintf(e->note, sizeof e->note,
                       "%.3g: 1/e through %.3g \xc2\xb5m; axes in \xc2\xb5m", e->style.high,
                       e->style.opaque_um);
        r = (e->request->preview ? gsn_projected_volume : gsn_ray_volume)(
            spline, &s->camera, &s->clip, &e->style, threads, NULL, &picture, err);
    }
    if (r >= 0)
        r = gsn_ray_paint(picture, &s->camera, &e->style, &s->box, s->title, e->note, &s->sheet,
                          err);
    return r;
}

/* The sheets side by side, their upper edges level. */
static int join_sheets(struct render *e, struct gsn_error *err)
{
    static const struct gsn_colour white = { 255, 255, 255 };
    uint32_t wide = 0, high = 0;
    int x = 0, r;

    for (int i = 0; i < e->scenes; i++) {
        const struct gsn_image *sheet = e->scene[i].sheet;

        wide += sheet->width;
        high = sheet->height > high ? sheet->height : high;
    }
    r = gsn_canvas_new(wide, high, white, &e->image, err);
    for (int i = 0; r >= 0 && i < e->scenes; i++) {
        gsn_canvas_paste(e->image, e->scene[i].sheet, x, 0);
        x += (int)e->scene[i].sheet->width;
    }
    return r;
}

static int draw_scenes(struct render *e, struct gsn_error *err)
{
    const int xray = !e->request->surface && !e->request->translucent && !(e->cells > 0);
    int r;

    for (int i = 0; i < e->scenes; i++)
        e->scene[i].clip.border = e->scene[i].border;
    r = xray ? draw_xrays(e, err) : GSN_OK;
    for (int i = 0; r >= 0 && !xray && i < e->scenes; i++)
        r = draw_light(e, &e->scene[i], err);
    return r < 0 ? r : join_sheets(e, err);
}

static void say_render(const struct render *e, const char *file, size_t size)
{
    const double um_per_px = 1 / e->scene[0].camera.px_per_um;

    if (e->request->json) {
        json_t *root = json_pack(
            "{s:o, s:I, s:o, s:o, s:I, s:f}", "specimen", gsn_work_text(e->scene[0].name), "run",
            (json_int_t)e->scene[0].kept->run->id, "file", gsn_work_text(file), "holds",
            gsn_work_text(e->scene[0].title), "bytes", (json_int_t)size, "um_per_px", um_per_px);
        json_t *beside = json_array();

        for (int i = 1; i < e->scenes; i++)
            (void)json_array_append_new(beside, json_pack("{s:o, s:I}", "specimen",
                                                          gsn_work_text(e->scene[i].name), "run",
                                                          (json_int_t)e->scene[i].kept->run->id));
        (void)json_object_set_new(root, "beside", beside);
        (void)json_dumpf(root, stdout, JSON_INDENT(2));
        (void)putchar('\n');
        json_decref(root);
        return;
    }
    for (int i = 0; i < e->scenes; i++)
        gsn_work_print(stdout, "%s: %s, %.4g um a pixel; run %lld\n", file, e->scene[i].title,
                       um_per_px, (long long)e->scene[i].kept->run->id);
}

int gsn_work_render(const struct gsn_work_request *request)
{
    struct render e __attribute__((cleanup(render_done))) = { .request = request };
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    const char *mistake = read_request(&e);
    const char *file;
    size_t size = 0;
    int r;

    if (mistake)
        return gsn_work_usage(request, mistake);
    e.scenes = request->rest_count - 1;
    file = request->rest[e.scenes];
    if (access(file, F_OK) == 0)
        return gsn_work_usage(request,
                              "that file exists already, and render writes over none: remove it, "
                              "or say another name");
    r = gsn_store_open(request->store_dir, GSN_STORE_READ, &e.store, &err);
    for (int i = 0; r >= 0 && i < e.scenes; i++) {
        e.scene[i].name = request->rest[i];
        r = open_scene(&e, &e.scene[i], &err);
    }
    if (r >= 0)
        r = frame_scenes(&e, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    find_window(&e);
    r = draw_scenes(&e, &err);
    if (r >= 0)
        r = gsn_png_encode(e.image, &bytes, &size, &err);
    if (r >= 0)
        r = gsn_file_write(file, bytes, size, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    say_render(&e, file, size);
    return EX_OK;
}
