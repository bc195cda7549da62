/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* All artefacts of a panel's sections, and densities without them.
 *
 *   1. Tissue and glass are told apart on the whole panel.
 *   2. Each section is cut into cells (artefact/cells.h); halos of the laser marks are labelled.
 *   3. Colours that all sections share are the tissue's own, whatever the stated dyes say (ink.c).
 *   4. Per section: ink, so that no other detector is misled by it; folds; bubbles; hairs and
 *      grains; tears and holes; how sharp it is.
 *   5. Sections are compared with each other: what is less sharp is out of focus (blur.c).
 *
 * Sections are worked on in parallel; what is found does not depend on the threads. Fails only for
 * wrong boxes, dyes that are too alike, and without memory. 0.8 s for the twelve sections of a
 * panel of 48 million pixels. */
#include "pipeline/stain/artefact/detection.h"

#include "pipeline/core/parallel.h"
#include "pipeline/core/robust.h"
#include "pipeline/stain/artefact/cells.h"

#include <math.h>

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

/* What the cells of one section say. */
struct box {
    struct gsn_artefact_section at;
    uint32_t side, nx, rim;
    uint16_t *label; /* owned */
};

struct gsn_artefact_labels {
    size_t count;
    struct box *box; /* owned */
};

/* One section at work. */
struct part {
    struct gsn_artefact_cells *cells;
    struct gsn_plane *sharpness;
    double median;
};

struct work {
    const struct gsn_artefact_panel *panel;
    const struct gsn_od_reader *absorber;
    struct part *part; /* per section */
    double clear;      /* density below which is glass */
    double usual;      /* sharpness of the panel's sections */
};

static void work_done(struct work *work)
{
    for (size_t i = 0; work->part && i < work->panel->section_count; i++) {
        gsn_artefact_cells_free(work->part[i].cells);
        gsn_plane_free(work->part[i].sharpness);
    }
    gsn_free(work->part);
}

/* Whether a pixel's centre, or a cell's, lies in a disc. */
static int in_disc(const struct gsn_artefact_disc *disc, double x, double y)
{
    const double dx = x - disc->px.x, dy = y - disc->px.y;

    return dx * dx + dy * dy <= disc->radius_px * disc->radius_px;
}

static void mark_halos(const struct gsn_artefact_section *section, struct gsn_artefact_cells *cells)
{
    for (size_t i = 0; i < (size_t)cells->nx * cells->ny; i++) {
        const double x = cells->x0 + cells->side * ((double)(i % cells->nx) + 0.5 - cells->rim);
        const double y = cells->y0 + cells->side * ((double)(i / cells->nx) + 0.5 - cells->rim);

        for (size_t h = 0; h < section->halo_count; h++)
            if (in_disc(&section->halo[h], x, y))
                cells->label[i] = GSN_DEFECT_HALO;
    }
}

static int cut_section(size_t i, void *context, struct gsn_error *err)
{
    const struct work *work = context;
    const struct gsn_artefact_section *section = &work->panel->section[i];
    const int r = gsn_artefact_cells_cut(work->panel, work->absorber, section, work->clear,
                                         &work->part[i].cells, err);

    if (r >= 0)
        mark_halos(section, work->part[i].cells);
    return r;
}

/* What only the sections together tell. */
static int compare_hues(const struct work *work, struct gsn_error *err)
{
    const size_t count = work->panel->section_count;
    gsn_auto_mem(struct gsn_artefact_cells *) cells = gsn_alloc_array(count, sizeof(void *));

    if (!cells)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t i = 0; i < count; i++)
        cells[i] = work->part[i].cells;
    return gsn_artefact_own_hues(cells, count, work->panel->own, err);
}

/* Everything that a section shows by itself. Ink comes first, so that no other detector is misled
 * by it. */
static int look_at_section(size_t i, void *context, struct gsn_error *err)
{
    const struct work *work = context;
    struct part *part = &work->part[i];
    int r = gsn_artefact_ink(part->cells, err);

    if (r >= 0)
        r = gsn_artefact_folds(part->cells, err);
    if (r >= 0)
        r = gsn_artefact_bubbles(part->cells, err);
    if (r >= 0)
        r = gsn_artefact_debris(part->cells, err);
    if (r >= 0)
        r = gsn_artefact_voids(part->cells, err);
    if (r >= 0)
        r = gsn_artefact_sharpness(part->cells, &part->sharpness, &part->median, err);
    return r;
}

static int compare_section(size_t i, void *context, struct gsn_error *err)
{
    const struct work *work = context;

    return gsn_artefact_blur(work->part[i].cells, work->part[i].sharpness, work->usual, err);
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

static struct gsn_artefact_figures count_areas(const struct part *part)
{
    const struct gsn_artefact_cells *cells = part->cells;
    const double area = cells->um * cells->um;
    struct gsn_artefact_figures figures = { .sharpness = part->median, .clipped = cells->clipped };

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

static int check_panel(const struct gsn_artefact_panel *panel, struct gsn_error *err)
{
    const uint32_t width = panel->image->width, height = panel->image->height;

    if (!(panel->px_um > 0))
        return gsn_fail(err, GSN_E_INPUT, "the pixel size must be positive to look for defects");
    for (size_t i = 0; i < panel->section_count; i++) {
        const struct gsn_artefact_section *s = &panel->section[i];

        if (s->x < 0 || s->y < 0 || s->width <= 0 || s->height <= 0 ||
            (uint32_t)s->x + (uint32_t)s->width > width ||
            (uint32_t)s->y + (uint32_t)s->height > height)
            return gsn_fail(err, GSN_E_INPUT,
                            "section %zu (%d x %d at %d, %d) reaches outside its panel of %u x %u",
                            i + 1, s->width, s->height, s->x, s->y, width, height);
    }
    return GSN_OK;
}

static int find_defects(struct work *work, unsigned threads, struct gsn_error *err)
{
    const size_t sections = work->panel->section_count;
    gsn_auto(gsn_plane) total = NULL;
    int r = gsn_od_tissue(work->panel->od, work->panel->glass, &total, &work->clear, err);

    if (r >= 0)
        r = gsn_parallel_for(sections, threads, cut_section, work, err);
    if (r >= 0 && work->panel->own)
        r = compare_hues(work, err);
    if (r >= 0)
        r = gsn_parallel_for(sections, threads, look_at_section, work, err);
    if (r >= 0)
        r = find_usual(work, err);
    return r < 0 ? r : gsn_parallel_for(sections, threads, compare_section, work, err);
}

/* Takes the labels out of the cells. */
static int keep_labels(struct work *work, struct gsn_artefact_labels **ret_labels,
                       struct gsn_error *err)
{
    struct gsn_artefact_labels *labels = gsn_alloc_array(1, sizeof *labels);

    if (labels)
        labels->box = gsn_alloc_array(work->panel->section_count, sizeof *labels->box);
    if (!labels || !labels->box) {
        gsn_artefact_labels_free(labels);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    }
    labels->count = work->panel->section_count;
    for (size_t i = 0; i < labels->count; i++) {
        const struct gsn_artefact_cells *cells = work->part[i].cells;

        labels->box[i] = (struct box){ .at = work->panel->section[i],
                                       .side = cells->side,
                                       .nx = cells->nx,
                                       .rim = cells->rim,
                                       .label = gsn_steal(&work->part[i].cells->label) };
    }
    *ret_labels = labels;
    return GSN_OK;
}

int gsn_artefact_find(const struct gsn_artefact_panel *panel, unsigned threads,
                      struct gsn_artefact_labels **ret_labels,
                      struct gsn_artefact_figures *ret_figures, struct gsn_error *err)
{
    struct work work = { .panel = panel };
    gsn_auto(gsn_od_reader) absorber = NULL;
    int r = check_panel(panel, err);

    if (r >= 0)
        r = gsn_od_reader_new(panel->image, panel->glass, &absorber, err);
    if (r < 0)
        return r;
    work.absorber = absorber;
    work.part = gsn_alloc_array(panel->section_count, sizeof *work.part);
    r = work.part ? find_defects(&work, threads, err)
                  : gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t i = 0; r >= 0 && i < panel->section_count; i++)
        ret_figures[i] = count_areas(&work.part[i]);
    if (r >= 0)
        r = keep_labels(&work, ret_labels, err);
    work_done(&work);
    return r;
}

void gsn_artefact_labels_free(struct gsn_artefact_labels *labels)
{
    if (!labels)
        return;
    for (size_t i = 0; i < labels->count; i++)
        gsn_free(labels->box[i].label);
    gsn_free(labels->box);
    gsn_free(labels);
}

unsigned gsn_artefact_label(const struct gsn_artefact_labels *labels, size_t section, int x, int y)
{
    const struct box *box = &labels->box[section];
    const int u = x - box->at.x, v = y - box->at.y;
    unsigned label;

    if (u < 0 || v < 0 || u >= box->at.width || v >= box->at.height)
        return 0;
    label = box->label[(size_t)(box->rim + (uint32_t)v / box->side) * box->nx + box->rim +
                       (uint32_t)u / box->side] &
            ~(unsigned)GSN_DEFECT_HALO;
    for (size_t h = 0; h < box->at.halo_count; h++)
        if (in_disc(&box->at.halo[h], x + 0.5, y + 0.5))
            label |= GSN_DEFECT_HALO;
    return label;
}

static int clamp_to(double value, int low, int high)
{
    return value < low ? low : value > high ? high : (int)value;
}

static void apply_disc(const struct gsn_artefact_disc *disc, int x0, int y0,
                       struct gsn_plane *density)
{
    const int left = clamp_to(disc->px.x - disc->radius_px - x0, 0, (int)density->width);
    const int right = clamp_to(disc->px.x + disc->radius_px - x0 + 1, 0, (int)density->width);
    const int top = clamp_to(disc->px.y - disc->radius_px - y0, 0, (int)density->height);
    const int bottom = clamp_to(disc->px.y + disc->radius_px - y0 + 1, 0, (int)density->height);

    for (int y = top; y < bottom; y++)
        for (int x = left; x < right; x++)
            if (in_disc(disc, x0 + x + 0.5, y0 + y + 0.5))
                density->value[(size_t)y * density->width + (size_t)x] = NAN;
}

/* The cells' labels over one row, run by run; halos are not theirs to say. */
static void apply_row(const struct box *box, const uint16_t *cell, int u, float *row, int width)
{
    const int end = u + width < box->at.width ? u + width : box->at.width;

    for (int x = u < 0 ? 0 : u; x < end;) {
        const int i = x / (int)box->side;
        const int next = (i + 1) * (int)box->side < end ? (i + 1) * (int)box->side : end;

        for (; x < next; x++)
            if (cell[i] & ~GSN_DEFECT_HALO)
                row[x - u] = NAN;
    }
}

void gsn_artefact_apply(const struct gsn_artefact_labels *labels, size_t section, int x0, int y0,
                        struct gsn_plane *density)
{
    const struct box *box = &labels->box[section];

    for (uint32_t y = 0; y < density->height; y++) {
        const int v = y0 + (int)y - box->at.y;

        if (v >= 0 && v < box->at.height)
            apply_row(
                box, box->label + (size_t)(box->rim + (uint32_t)v / box->side) * box->nx + box->rim,
                x0 - box->at.x, density->value + (size_t)y * density->width, (int)density->width);
    }
    for (size_t h = 0; h < box->at.halo_count; h++)
        apply_disc(&box->at.halo[h], x0, y0, density);
}
