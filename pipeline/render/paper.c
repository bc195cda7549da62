/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Sheets of paper by cairo's PDF surface and pango.
 *
 * Method: one pass from top to bottom. A paragraph is broken into lines by pango and goes on on the
 * next page line by line; a row of a table, a row of a grid and a figure are kept whole. A column
 * of a table gets what its longest text needs; where that is more than the page has, columns that
 * need less than their share keep theirs and the others share the rest. A JPEG is put into the file
 * as it is, a PNG is read by cairo. A row that is higher than a page is set as paragraphs.
 *
 * Failure: remembered until gsn_paper_finish(). Cost: a layout for each text, twice for cells. */
#include "pipeline/render/paper.h"

#include <cairo/cairo-pdf.h>
#include <string.h>

#include "pipeline/core/mem.h"
#include "pipeline/render/lettering_internal.h"

/* A4; the margin leaves what Letter, 17 mm lower and 6 mm wider, would cut off. */
static const double page_width = 595.276, page_height = 841.89;
static const double margin = 42, foot_at = 46, gutter = 8;

static const double table_pt = 7.5, grid_pt = 7;

static const struct {
    enum gsn_face face;
    double pt, before, after, grey;
} style_of[] = {
    [GSN_PAPER_TITLE] = { GSN_FACE_BOLD, 20, 0, 4, 0 },
    [GSN_PAPER_HEADING] = { GSN_FACE_BOLD, 13, 14, 4, 0 },
    [GSN_PAPER_SUBHEADING] = { GSN_FACE_BOLD, 9, 6, 2, 0 },
    [GSN_PAPER_BIG] = { GSN_FACE_BOLD, 24, 2, 2, 0 },
    [GSN_PAPER_BODY] = { GSN_FACE_PLAIN, 9, 0, 3, 0 },
    [GSN_PAPER_SOFT] = { GSN_FACE_PLAIN, 8, 0, 3, 0.35 },
};

struct file {
    uint8_t *bytes;
    size_t size, room;
    int failed; /* cairo does not always say so */
};

struct gsn_paper {
    struct gsn_lettering *letters;
    cairo_surface_t *surface;
    cairo_t *cairo;
    struct file file;
    char *foot;
    double y;
    unsigned page;
    int is_bad; /* a picture was none */
};

static cairo_status_t take_bytes(void *closure, const unsigned char *bytes, unsigned size)
{
    struct file *const file = closure;

    if (file->size + size > file->room) {
        const size_t room = 2 * (file->size + size);
        uint8_t *const more = gsn_realloc_array(file->bytes, room, 1);

        if (!more) {
            file->failed = 1;
            return CAIRO_STATUS_WRITE_ERROR;
        }
        file->bytes = more;
        file->room = room;
    }
    memcpy(file->bytes + file->size, bytes, size);
    file->size += size;
    return CAIRO_STATUS_SUCCESS;
}

int gsn_paper_new(const char *title, const char *foot, struct gsn_paper **ret_paper,
                  struct gsn_error *err)
{
    gsn_auto(gsn_paper) paper = gsn_alloc_array(1, sizeof *paper);
    char *valid;
    int r;

    if (!paper)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a PDF");
    r = gsn_lettering_new(GSN_FONT_FOLDER, &paper->letters, err);
    if (r < 0)
        return r;
    gsn_lettering_for_paper(paper->letters);
    paper->foot = gsn_strdup(foot);
    if (!paper->foot)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a PDF");
    paper->surface =
        cairo_pdf_surface_create_for_stream(take_bytes, &paper->file, page_width, page_height);
    valid = g_utf8_make_valid(title, -1);
    cairo_pdf_surface_set_metadata(paper->surface, CAIRO_PDF_METADATA_TITLE, valid);
    g_free(valid);
    /* Otherwise it is the hour at which it is written. */
    cairo_pdf_surface_set_metadata(paper->surface, CAIRO_PDF_METADATA_CREATE_DATE, NULL);
    paper->cairo = cairo_create(paper->surface);
    paper->y = margin;
    paper->page = 1;
    *ret_paper = gsn_steal(&paper);
    return GSN_OK;
}

void gsn_paper_free(struct gsn_paper *paper)
{
    if (!paper)
        return;
    if (paper->cairo)
        cairo_destroy(paper->cairo);
    if (paper->surface)
        cairo_surface_destroy(paper->surface);
    gsn_lettering_free(paper->letters);
    gsn_free(paper->file.bytes);
    gsn_free(paper->foot);
    gsn_free(paper);
}

static void set_ink(struct gsn_paper *paper, double grey)
{
    cairo_set_source_rgb(paper->cairo, grey, grey, grey);
}

/* Draws the layout unless y is below 0, and frees it; returns its height in points. */
static double put_layout(struct gsn_paper *paper, PangoLayout *layout, double x, double y)
{
    int height;

    pango_layout_get_size(layout, NULL, &height);
    if (y >= 0) {
        cairo_move_to(paper->cairo, x, y);
        pango_cairo_show_layout(paper->cairo, layout);
    }
    g_object_unref(layout);
    return (double)height / PANGO_SCALE;
}

/* Draws a text within a width and returns its height; with a negative y it is measured alone. */
static double place_text(struct gsn_paper *paper, enum gsn_face face, double pt, double x, double y,
                         double width, PangoAlignment side, const char *text)
{
    PangoLayout *layout = gsn_lettering_layout(paper->letters, face, pt, text, width);

    pango_layout_set_alignment(layout, side);
    return put_layout(paper, layout, x, y);
}

static void end_page(struct gsn_paper *paper)
{
    char number[32];

    (void)g_snprintf(number, sizeof number, "Page %u", paper->page);
    set_ink(paper, 0.35);
    (void)place_text(paper, GSN_FACE_PLAIN, 7, margin, page_height - foot_at + 8,
                     page_width - 2 * margin - 60, PANGO_ALIGN_LEFT, paper->foot);
    (void)place_text(paper, GSN_FACE_PLAIN, 7, page_width - margin - 60, page_height - foot_at + 8,
                     60, PANGO_ALIGN_RIGHT, number);
    cairo_show_page(paper->cairo);
    paper->page++;
    paper->y = margin;
}

static const double bottom = 841.89 - 60;

/* Goes on to the next page where this one does not have so much left. */
static void make_room(struct gsn_paper *paper, double height)
{
    if (paper->y > margin && paper->y + height > bottom)
        end_page(paper);
}

void gsn_paper_text(struct gsn_paper *paper, enum gsn_paper_style style, const char *text)
{
    const int is_heading = style <= GSN_PAPER_SUBHEADING;
    PangoLayout *layout = gsn_lettering_layout(paper->letters, style_of[style].face,
                                               style_of[style].pt, text, page_width - 2 * margin);
    PangoLayoutIter *at = pango_layout_get_iter(layout);

    if (paper->y > margin)
        paper->y += style_of[style].before;
    /* A heading is followed by something: a row of small pictures needs the most. */
    make_room(paper, is_heading ? 170 : style_of[style].pt);
    do {
        PangoRectangle box;
        int start, end;

        pango_layout_iter_get_line_extents(at, NULL, &box);
        pango_layout_iter_get_line_yrange(at, &start, &end);
        make_room(paper, (double)(end - start) / PANGO_SCALE);
        set_ink(paper, style_of[style].grey);
        cairo_move_to(paper->cairo, margin + (double)box.x / PANGO_SCALE,
                      paper->y +
                          (double)(pango_layout_iter_get_baseline(at) - start) / PANGO_SCALE);
        pango_cairo_show_layout_line(paper->cairo, pango_layout_iter_get_line_readonly(at));
        paper->y += (double)(end - start) / PANGO_SCALE;
    } while (pango_layout_iter_next_line(at));
    paper->y += style_of[style].after;
    pango_layout_iter_free(at);
    g_object_unref(layout);
}

/* --- tables --- */

enum { MOST_COLUMNS = 16 };

static double width_of(struct gsn_paper *paper, const struct gsn_paper_cell *cell)
{
    return gsn_lettering_width(paper->letters, cell->is_head ? GSN_FACE_BOLD : GSN_FACE_PLAIN,
                               table_pt * 16, cell->text) /
               16.0 +
           1;
}

/* What each column gets of the page. */
static void share_width(struct gsn_paper *paper, const struct gsn_paper_cell *cell, size_t count,
                        size_t columns, double *ret_width)
{
    double left = page_width - 2 * margin - gutter * (double)(columns - 1);
    double need[MOST_COLUMNS] = { 0 };
    size_t open = columns;

    for (size_t i = 0; i < count; i++)
        need[i % columns] = MAX(need[i % columns], width_of(paper, &cell[i]));
    for (size_t c = 0; c < columns; c++)
        ret_width[c] = -1;
    for (int changed = 1; changed && open;) {
        const double share = left / (double)open;

        changed = 0;
        for (size_t c = 0; c < columns; c++) {
            if (ret_width[c] >= 0 || need[c] > share)
                continue;
            ret_width[c] = need[c];
            left -= need[c];
            open--;
            changed = 1;
        }
    }
    for (size_t c = 0; c < columns; c++)
        if (ret_width[c] < 0)
            ret_width[c] = left / (double)open;
}

/* Returns the height of the row; with a negative y it is measured alone. */
static double place_row(struct gsn_paper *paper, const struct gsn_paper_cell *cell, size_t columns,
                        const double *width, double y)
{
    double x = margin, most = 0;

    for (size_t c = 0; c < columns; c++) {
        const double height = place_text(
            paper, cell[c].is_head ? GSN_FACE_BOLD : GSN_FACE_PLAIN, table_pt, x, y, width[c],
            cell[c].is_right ? PANGO_ALIGN_RIGHT : PANGO_ALIGN_LEFT, cell[c].text);

        most = MAX(most, height);
        x += width[c] + gutter;
    }
    return most;
}

static void draw_rule(struct gsn_paper *paper)
{
    cairo_set_source_rgb(paper->cairo, 0.8, 0.8, 0.82);
    cairo_rectangle(paper->cairo, margin, paper->y, page_width - 2 * margin, 0.5);
    cairo_fill(paper->cairo);
}

static void add_row(struct gsn_paper *paper, const struct gsn_paper_cell *cell, size_t columns,
                    const double *width, double height)
{
    set_ink(paper, 0);
    (void)place_row(paper, cell, columns, width, paper->y);
    paper->y += height + 1.5;
    draw_rule(paper);
    paper->y += 2;
}

void gsn_paper_table(struct gsn_paper *paper, const struct gsn_paper_cell *cell, size_t count,
                     size_t columns)
{
    double width[MOST_COLUMNS], head;
    int has_head = 1;

    if (columns == 0 || columns > MOST_COLUMNS || count < columns) {
        for (size_t i = 0; i < count; i++)
            gsn_paper_text(paper, GSN_PAPER_BODY, cell[i].text);
        return;
    }
    share_width(paper, cell, count, columns, width);
    for (size_t c = 0; c < columns; c++)
        has_head &= cell[c].is_head;
    head = place_row(paper, cell, columns, width, -1);
    make_room(paper, 3 * head + 12);
    for (size_t i = 0; i + columns <= count; i += columns) {
        const double height = place_row(paper, cell + i, columns, width, -1);

        if (height > bottom - margin - head - 8) {
            for (size_t c = 0; c < columns; c++)
                gsn_paper_text(paper, GSN_PAPER_BODY, cell[i + c].text);
            continue;
        }
        if (paper->y + height > bottom) {
            end_page(paper);
            if (has_head && i > 0)
                add_row(paper, cell, columns, width, head);
        }
        add_row(paper, cell + i, columns, width, height);
    }
    paper->y += 6;
}

/* --- pictures --- */

struct reading {
    const uint8_t *bytes;
    size_t left;
};

static cairo_status_t give_bytes(void *closure, unsigned char *bytes, unsigned size)
{
    struct reading *const reading = closure;

    if (size > reading->left)
        return CAIRO_STATUS_READ_ERROR;
    memcpy(bytes, reading->bytes, size);
    reading->bytes += size;
    reading->left -= size;
    return CAIRO_STATUS_SUCCESS;
}

/* A JPEG's pixels are not asked for where its own bytes can be shown. */
static cairo_surface_t *open_picture(const struct gsn_paper_picture *picture)
{
    struct reading reading = { picture->bytes, picture->size };
    cairo_surface_t *surface;
    unsigned char *copy;

    if (!picture->is_jpeg)
        return cairo_image_surface_create_from_png_stream(give_bytes, &reading);
    surface =
        cairo_image_surface_create(CAIRO_FORMAT_RGB24, (int)picture->width, (int)picture->height);
    copy = g_malloc(picture->size);
    memcpy(copy, picture->bytes, picture->size);
    if (cairo_surface_set_mime_data(surface, CAIRO_MIME_TYPE_JPEG, copy, picture->size, g_free,
                                    copy) != CAIRO_STATUS_SUCCESS)
        g_free(copy);
    return surface;
}

static void place_picture(struct gsn_paper *paper, const struct gsn_paper_picture *picture,
                          double x, double y, double width)
{
    cairo_surface_t *surface = open_picture(picture);

    if (cairo_surface_status(surface) != CAIRO_STATUS_SUCCESS) {
        paper->is_bad = 1;
    } else {
        cairo_save(paper->cairo);
        cairo_translate(paper->cairo, x, y);
        cairo_scale(paper->cairo, width / picture->width, width / picture->width);
        cairo_set_source_surface(paper->cairo, surface, 0, 0);
        cairo_paint(paper->cairo);
        cairo_restore(paper->cairo);
    }
    cairo_surface_destroy(surface);
}

static double height_at(const struct gsn_paper_picture *picture, double width)
{
    return picture->size ? width * picture->height / picture->width : 0;
}

/* The text of a cell, its first line bold; as place_text(). */
static double place_lines(struct gsn_paper *paper, double x, double y, double width,
                          const char *text)
{
    PangoLayout *layout =
        gsn_lettering_layout(paper->letters, GSN_FACE_PLAIN, grid_pt, text, width);
    PangoAttrList *list = pango_attr_list_new();
    PangoAttribute *bold = pango_attr_weight_new(PANGO_WEIGHT_BOLD);

    bold->end_index = (guint)strcspn(pango_layout_get_text(layout), "\n");
    pango_attr_list_insert(list, bold);
    pango_layout_set_attributes(layout, list);
    pango_attr_list_unref(list);
    return put_layout(paper, layout, x, y);
}

void gsn_paper_grid(struct gsn_paper *paper, const struct gsn_paper_cell *cell, size_t count,
                    size_t columns)
{
    const double width =
        (page_width - 2 * margin - gutter * (double)(columns - 1)) / (double)columns;

    for (size_t i = 0; i < count; i += columns) {
        const size_t here = MIN(columns, count - i);
        double picture = 0, text = 0;

        for (size_t c = 0; c < here; c++) {
            picture = MAX(picture, height_at(&cell[i + c].picture, width));
            text = MAX(text, place_lines(paper, 0, -1, width, cell[i + c].text));
        }
        make_room(paper, picture + text + 4);
        for (size_t c = 0; c < here; c++) {
            const double x = margin + (width + gutter) * (double)c;

            if (cell[i + c].picture.size)
                place_picture(paper, &cell[i + c].picture, x, paper->y, width);
            set_ink(paper, 0);
            (void)place_lines(paper, x, paper->y + picture + 2, width, cell[i + c].text);
        }
        paper->y += picture + text + 10;
    }
}

void gsn_paper_figure(struct gsn_paper *paper, const struct gsn_paper_picture *picture,
                      const char *title, const char *caption)
{
    const double whole = page_width - 2 * margin;
    const int beside = 10 * picture->width <= 16 * picture->height;
    const double width = beside ? 0.45 * whole : whole, height = height_at(picture, width);
    const double x = beside ? margin + width + 2 * gutter : margin;
    const double room = beside ? whole - width - 2 * gutter : whole;
    const double head = place_text(paper, GSN_FACE_BOLD, 9, 0, -1, room, PANGO_ALIGN_LEFT, title);
    const double text =
        head + place_text(paper, GSN_FACE_PLAIN, 8, 0, -1, room, PANGO_ALIGN_LEFT, caption);
    double y;

    make_room(paper, beside ? MAX(height, text) : height + text + 4);
    if (picture->size)
        place_picture(paper, picture, margin, paper->y, width);
    y = beside ? paper->y + 8 : paper->y + height + 4;
    set_ink(paper, 0);
    (void)place_text(paper, GSN_FACE_BOLD, 9, x, y, room, PANGO_ALIGN_LEFT, title);
    set_ink(paper, 0.35);
    (void)place_text(paper, GSN_FACE_PLAIN, 8, x, y + head, room, PANGO_ALIGN_LEFT, caption);
    paper->y += (beside ? MAX(height, text + 8) : height + text + 4) + 12;
}

int gsn_paper_finish(struct gsn_paper *paper, uint8_t **ret_bytes, size_t *ret_size,
                     struct gsn_error *err)
{
    end_page(paper);
    cairo_surface_finish(paper->surface);
    if (paper->is_bad && !paper->file.failed)
        return gsn_fail(err, GSN_E_INPUT, "a picture of the PDF cannot be read");
    if (paper->file.failed || cairo_status(paper->cairo) != CAIRO_STATUS_SUCCESS ||
        cairo_surface_status(paper->surface) != CAIRO_STATUS_SUCCESS)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while writing a PDF");
    *ret_bytes = gsn_steal(&paper->file.bytes);
    *ret_size = paper->file.size;
    return GSN_OK;
}
