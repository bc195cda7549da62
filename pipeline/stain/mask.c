/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/mask.h"

#include <math.h>
#include <string.h>

#include "pipeline/core/parallel.h"
#include "pipeline/stain/mask_cells.h"
#include "pipeline/stain/order.h"

static const char *const WORDS[GSN_DEFECTS][2] = {
    { "halo", "beside a laser mark, where heat changes the stain" },
    { "fold", "the tissue lies double: both dyes are there twice along a line" },
    { "void", "a tear or a hole: no tissue within the section's outline" },
    { "bubble", "air under the coverslip: mount the slide anew and scan it again" },
    { "blur", "out of focus against the other sections: scan again" },
    { "ink", "a colour that the dyes do not make, such as a pen's: wipe the slide and scan again" },
    { "edge", "the edge of the coverslip or of the frame lies over it" },
    { "hair", "a hair or a fibre lies over it" },
    { "debris", "a dark neutral grain: dust, enamel, metal or pigment" },
    { "dust", "dark at this place of every panel: dirt on the scanner's glass or sensor" },
};

const char *gsn_defect_word(unsigned i)
{
    return WORDS[i][0];
}

const char *gsn_defect_reason(unsigned i)
{
    return WORDS[i][1];
}

/* One section at work. */
struct part {
    struct gsn_mask_cells *cells;
    struct gsn_plane *sharpness;
    double median;
};

struct work {
    const struct gsn_mask_panel *panel;
    struct part *part; /* per section */
    double clear;      /* density below which is glass */
    double usual;      /* sharpness of the panel's sections */
};

static void work_done(struct work *work)
{
    for (size_t i = 0; work->part && i < work->panel->section_count; i++) {
        gsn_mask_cells_free(work->part[i].cells);
        gsn_plane_free(work->part[i].sharpness);
    }
    gsn_free(work->part);
}

/* Whether a pixel's centre, or a cell's, lies in a disc. */
static int in_disc(const struct gsn_mask_disc *disc, double x, double y)
{
    return hypot(x - disc->px.x, y - disc->px.y) <= disc->radius_px;
}

static void mark_halos(const struct gsn_mask_section *section, struct gsn_mask_cells *cells)
{
    for (size_t i = 0; i < (size_t)cells->nx * cells->ny; i++) {
        const double x = cells->x0 + cells->side * ((double)(i % cells->nx) + 0.5 - cells->rim);
        const double y = cells->y0 + cells->side * ((double)(i / cells->nx) + 0.5 - cells->rim);

        for (size_t h = 0; h < section->halo_count; h++)
            if (in_disc(&section->halo[h], x, y))
                cells->label[i] = GSN_DEFECT_HALO;
    }
}

/* Everything that a section shows by itself. Ink comes first, so that no other detector is misled
 * by it. */
static int look_at_section(size_t i, void *context, struct gsn_error *err)
{
    const struct work *work = context;
    const struct gsn_mask_section *section = &work->panel->section[i];
    struct part *part = &work->part[i];
    int r = gsn_mask_cells_cut(work->panel, section, work->clear, &part->cells, err);

    if (r < 0)
        return r;
    mark_halos(section, part->cells);
    r = gsn_mask_ink(part->cells, err);
    if (r >= 0)
        r = gsn_mask_folds(part->cells, err);
    if (r >= 0)
        r = gsn_mask_bubbles(part->cells, err);
    if (r >= 0)
        r = gsn_mask_specks(part->cells, err);
    if (r >= 0)
        r = gsn_mask_voids(part->cells, err);
    if (r >= 0)
        r = gsn_mask_sharpness(part->cells, &part->sharpness, &part->median, err);
    return r;
}

static int compare_section(size_t i, void *context, struct gsn_error *err)
{
    const struct work *work = context;

    return gsn_mask_blur(work->part[i].cells, work->part[i].sharpness, work->usual, err);
}

/* The median of the sections' own. */
static int find_usual(struct work *work, struct gsn_error *err)
{
    const size_t count = work->panel->section_count;
    gsn_auto_mem(double) list = gsn_alloc_array(count, sizeof *list);
    size_t n = 0;

    if (!list)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t i = 0; i < count; i++)
        if (!isnan(work->part[i].median))
            list[n++] = work->part[i].median;
    work->usual = n > 0 ? gsn_order_pick(list, n, n / 2) : (double)NAN;
    return GSN_OK;
}

/* From cells to pixels; halos are round to the pixel. */
static void paint(const struct gsn_mask_section *section, const struct gsn_mask_cells *cells,
                  struct gsn_image *labels)
{
    for (int y = 0; y < section->height; y++) {
        const size_t row = (size_t)(cells->rim + (uint32_t)y / cells->side) * cells->nx;
        uint16_t *out =
            (uint16_t *)labels->samples + (size_t)(section->y + y) * labels->width + section->x;

        for (int x = 0; x < section->width; x++)
            out[x] =
                (uint16_t)(out[x] | (cells->label[row + cells->rim + (uint32_t)x / cells->side] &
                                     ~GSN_DEFECT_HALO));
    }
}

static void paint_halo(const struct gsn_mask_disc *disc, struct gsn_image *labels)
{
    const double x0 = fmax(0, floor(disc->px.x - disc->radius_px));
    const double y0 = fmax(0, floor(disc->px.y - disc->radius_px));
    const double x1 = fmin(labels->width, disc->px.x + disc->radius_px + 1);
    const double y1 = fmin(labels->height, disc->px.y + disc->radius_px + 1);

    for (double y = y0; y < y1; y++)
        for (double x = x0; x < x1; x++)
            if (in_disc(disc, x + 0.5, y + 0.5)) {
                uint16_t *at = (uint16_t *)labels->samples + (size_t)y * labels->width + (size_t)x;

                *at = (uint16_t)(*at | GSN_DEFECT_HALO);
            }
}

static struct gsn_mask_figures count(const struct part *part)
{
    const struct gsn_mask_cells *cells = part->cells;
    const double area = cells->um * cells->um;
    struct gsn_mask_figures figures = { .sharpness = part->median };

    for (size_t i = 0; i < (size_t)cells->nx * cells->ny; i++) {
        if (!cells->outline[i])
            continue;
        figures.outline_um2 += area;
        figures.masked_um2 += cells->label[i] ? area : 0;
        for (unsigned bit = 0; bit < GSN_DEFECTS; bit++)
            figures.area_um2[bit] += cells->label[i] >> bit & 1 ? area : 0;
    }
    return figures;
}

static int check(const struct gsn_mask_panel *panel, struct gsn_error *err)
{
    const uint32_t width = panel->od[0]->width, height = panel->od[0]->height;

    if (!(panel->px_um > 0))
        return gsn_fail(err, GSN_E_INPUT, "the pixel size must be positive to look for defects");
    for (size_t i = 0; i < panel->section_count; i++) {
        const struct gsn_mask_section *s = &panel->section[i];

        if (s->x < 0 || s->y < 0 || s->width <= 0 || s->height <= 0 ||
            (uint32_t)s->x + (uint32_t)s->width > width ||
            (uint32_t)s->y + (uint32_t)s->height > height)
            return gsn_fail(err, GSN_E_INPUT,
                            "section %zu (%d x %d at %d, %d) reaches outside its panel of %u x %u",
                            i + 1, s->width, s->height, s->x, s->y, width, height);
    }
    return GSN_OK;
}

static int find(struct work *work, unsigned threads, struct gsn_error *err)
{
    const size_t sections = work->panel->section_count;
    gsn_auto(gsn_plane) total = NULL;
    int r = gsn_tissue_plane(work->panel->od, work->panel->glass, &total, &work->clear, err);

    if (r >= 0)
        r = gsn_parallel_for(sections, threads, look_at_section, work, err);
    if (r >= 0)
        r = find_usual(work, err);
    return r < 0 ? r : gsn_parallel_for(sections, threads, compare_section, work, err);
}

int gsn_mask_find(const struct gsn_mask_panel *panel, unsigned threads,
                  struct gsn_image **ret_labels, struct gsn_mask_figures *ret_figures,
                  struct gsn_error *err)
{
    struct work work = { .panel = panel };
    gsn_auto(gsn_image) labels = NULL;
    int r = check(panel, err);

    if (r >= 0)
        r = gsn_image_new(panel->od[0]->width, panel->od[0]->height, 1, 16, &labels, err);
    if (r < 0)
        return r;
    work.part = gsn_alloc_array(panel->section_count, sizeof *work.part);
    r = work.part ? find(&work, threads, err)
                  : gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t i = 0; r >= 0 && i < panel->section_count; i++) {
        paint(&panel->section[i], work.part[i].cells, labels);
        for (size_t h = 0; h < panel->section[i].halo_count; h++)
            paint_halo(&panel->section[i].halo[h], labels);
        ret_figures[i] = count(&work.part[i]);
    }
    work_done(&work);
    if (r >= 0)
        *ret_labels = gsn_steal(&labels);
    return r;
}

void gsn_mask_apply(const struct gsn_image *labels, struct gsn_plane *density)
{
    const uint16_t *label = labels->samples;

    for (size_t i = 0; i < (size_t)density->width * density->height; i++)
        if (label[i])
            density->value[i] = NAN;
}
