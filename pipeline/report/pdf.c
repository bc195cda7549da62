/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The report on paper: the page's own words, tables and pictures, set as a PDF.
 *
 * Method: the page is written as for a browser (html.c) and its markup, which is ours and closed,
 * read from front to back: so that no number is formatted in a second place, and what the page says
 * the paper says too. Left out is what paper cannot do: the contents, the model to turn, and the
 * charts, whose numbers are on the contact sheet and in the tables.
 *
 * Steps, of each tag: (1) text is collected, its white space as a browser would show it; (2) at the
 * end of a block it becomes a paragraph, or part of the cell or caption that is open; (3) a table
 * of pictures becomes a grid, as do the cards of the summary, another a table.
 *
 * Failure: GSN_E_NOMEM; GSN_E_NOTFOUND without the fonts. Cost: once more the page, and the
 * pictures decoded. */
#include "pipeline/report/report.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "pipeline/render/paper.h"
#include "pipeline/report/text.h"

/* A start or end tag of our own markup. */
struct tag {
    const char *name, *attributes;
    size_t name_length, attributes_length;
    int is_end;
};

/* A cell with what it owns. */
struct cell {
    size_t text; /* where it begins in the walk's part */
    uint8_t *bytes;
    struct gsn_paper_cell shown;
};

enum { NOWHERE, IN_TABLE, IN_GRID, IN_FIGURE };

struct walk {
    struct gsn_paper *paper;
    struct gsn_report_text run;  /* of the block that is open */
    struct gsn_report_text part; /* blocks of the cell or caption that is open */
    enum gsn_paper_style style;  /* of the block that is open */
    int place;                   /* one of the four above */
    struct cell *cell;
    size_t cell_count, cell_room, columns;
    int cell_is_open, spans_two, has_pictures;
    int is_list_of_ids;
    int cards;                        /* depth of <div> within the cards; 0: not there */
    struct gsn_paper_picture picture; /* of the figure that is open */
    uint8_t *picture_bytes;           /* owned */
    char *title;                      /* of the figure */
    size_t skipped;                   /* depth of what is left out */
    char skipped_name[16];
    int failed;
};

static int is_named(const struct tag *tag, const char *name)
{
    return strlen(name) == tag->name_length && memcmp(tag->name, name, tag->name_length) == 0;
}

/* Whether the attributes hold these bytes. */
static int has(const struct tag *tag, const char *bytes)
{
    return memmem(tag->attributes, tag->attributes_length, bytes, strlen(bytes)) != NULL;
}

/* What follows these bytes in the attributes, up to a quotation mark; NULL: nothing. */
static const char *value_of(const struct tag *tag, const char *before, size_t *ret_length)
{
    const char *at = memmem(tag->attributes, tag->attributes_length, before, strlen(before));
    const char *end = at ? strchr(at + strlen(before), '"') : NULL;

    if (!end)
        return NULL;
    at += strlen(before);
    *ret_length = (size_t)(end - at);
    return at;
}

/* --- text --- */

static int ends_with_space(const struct gsn_report_text *text)
{
    return text->size == 0 || text->bytes[text->size - 1] == ' ' ||
           text->bytes[text->size - 1] == '\n';
}

/* The character that an escape of ours stands for; 0: it is none. */
static char escaped_at(const char *at, size_t *ret_length)
{
    static const struct {
        const char *as;
        char is;
    } escape[] = {
        { "&amp;", '&' }, { "&lt;", '<' }, { "&gt;", '>' }, { "&quot;", '"' }, { "&#39;", '\'' }
    };

    for (size_t i = 0; i < sizeof escape / sizeof *escape; i++) {
        *ret_length = strlen(escape[i].as);
        if (strncmp(at, escape[i].as, *ret_length) == 0)
            return escape[i].is;
    }
    return 0;
}

/* Adds a stretch between two tags, with white space as one space. */
static void add_stretch(struct gsn_report_text *run, const char *at, const char *end)
{
    while (at < end) {
        size_t length = 1;
        const char escaped = *at == '&' ? escaped_at(at, &length) : 0;

        if (escaped) {
            gsn_report_text_bytes(run, &escaped, 1);
        } else if (*at == ' ' || *at == '\n' || *at == '\t') {
            if (!ends_with_space(run))
                gsn_report_text_bytes(run, " ", 1);
        } else {
            length = 1;
            gsn_report_text_bytes(run, at, 1);
        }
        at += length;
    }
}

static void trim(struct gsn_report_text *text)
{
    while (text->size && ends_with_space(text))
        text->bytes[--text->size] = '\0';
}

/* Its memory is kept for the next block. */
static void empty(struct gsn_report_text *text)
{
    text->size = 0;
    if (text->bytes)
        text->bytes[0] = '\0';
}

/* The block is over: a paragraph, or a line of the cell or caption. */
static void end_block(struct walk *walk)
{
    struct gsn_report_text *run = &walk->run;

    walk->failed |= run->failed;
    trim(run);
    if (run->size == 0)
        return;
    if (walk->cell_is_open || walk->place == IN_FIGURE) {
        if (walk->part.size > (walk->cell_is_open ? walk->cell[walk->cell_count - 1].text : 0))
            gsn_report_text_bytes(&walk->part, "\n", 1);
        gsn_report_text_bytes(&walk->part, run->bytes, run->size);
    } else {
        gsn_paper_text(walk->paper, walk->style, run->bytes);
    }
    walk->failed |= walk->part.failed;
    empty(run);
    walk->style = GSN_PAPER_BODY;
}

/* gives: the text of the caption; NULL, remembered, when memory runs out. */
static char *take_part(struct walk *walk)
{
    char *text = gsn_strdup(walk->part.size ? walk->part.bytes : "");

    walk->failed |= !text || walk->part.failed;
    empty(&walk->part);
    return text;
}

/* --- pictures --- */

static int sextet_of(char c)
{
    static const char alphabet[] =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const char *at = c ? strchr(alphabet, c) : NULL;

    return at ? (int)(at - alphabet) : -1;
}

/* The inverse of gsn_report_text_base64(). gives: NULL when memory runs out. */
static uint8_t *read_base64(const char *text, size_t length, size_t *ret_size)
{
    uint8_t *bytes = gsn_alloc(length / 4 * 3 + 3);
    uint32_t bits = 0;
    size_t size = 0;

    for (size_t i = 0; bytes && i < length && sextet_of(text[i]) >= 0; i++) {
        bits = bits << 6 | (uint32_t)sextet_of(text[i]);
        if (i % 4)
            bytes[size++] = (uint8_t)(bits >> (6 - 2 * (i % 4)));
    }
    *ret_size = size;
    return bytes;
}

static unsigned number_of(const struct tag *tag, const char *before)
{
    size_t length;
    const char *value = value_of(tag, before, &length);

    return value ? (unsigned)strtoul(value, NULL, 10) : 0;
}

/* gives ret_bytes, which the picture borrows. */
static void take_picture(struct walk *walk, const struct tag *tag,
                         struct gsn_paper_picture *picture, uint8_t **ret_bytes)
{
    size_t length, size;
    const char *text = value_of(tag, ";base64,", &length);

    if (!text || *ret_bytes)
        return;
    *ret_bytes = read_base64(text, length, &size);
    walk->failed |= !*ret_bytes;
    if (*ret_bytes)
        *picture = (struct gsn_paper_picture){ .bytes = *ret_bytes,
                                               .size = size,
                                               .is_jpeg = has(tag, "data:image/jpeg"),
                                               .width = number_of(tag, "width=\""),
                                               .height = number_of(tag, "height=\"") };
}

/* --- tables and grids --- */

static void open_cell(struct walk *walk, int is_head, int is_right)
{
    if (walk->cell_count == walk->cell_room) {
        const size_t room = 2 * walk->cell_room + 64;
        struct cell *more = gsn_realloc_array(walk->cell, room, sizeof *more);

        if (!more) {
            walk->failed = 1;
            return;
        }
        walk->cell = more;
        walk->cell_room = room;
    }
    walk->cell[walk->cell_count++] =
        (struct cell){ .text = walk->part.size,
                       .shown = { .is_head = is_head, .is_right = is_right } };
    walk->cell_is_open = 1;
}

static void close_cell(struct walk *walk)
{
    end_block(walk);
    if (!walk->cell_is_open)
        return;
    gsn_report_text_bytes(&walk->part, "", 1);
    walk->failed |= walk->part.failed;
    if (walk->spans_two) {
        walk->spans_two = 0;
        open_cell(walk, 0, 0);
        close_cell(walk);
    }
    walk->cell_is_open = 0;
}

static void drop_cells(struct walk *walk)
{
    for (size_t i = 0; i < walk->cell_count; i++)
        gsn_free(walk->cell[i].bytes);
    empty(&walk->part);
    walk->cell_count = walk->columns = 0;
    walk->has_pictures = 0;
    walk->place = NOWHERE;
}

static void set_cells(struct walk *walk)
{
    gsn_auto_mem(struct gsn_paper_cell) shown = gsn_alloc_array(walk->cell_count, sizeof *shown);

    walk->failed |= !shown;
    if (!walk->failed && walk->cell_count) {
        for (size_t i = 0; i < walk->cell_count; i++) {
            shown[i] = walk->cell[i].shown;
            shown[i].text = walk->part.bytes + walk->cell[i].text;
        }
        if (walk->has_pictures || walk->place == IN_GRID)
            gsn_paper_grid(walk->paper, shown, walk->cell_count,
                           walk->columns ? walk->columns : walk->cell_count);
        else
            gsn_paper_table(walk->paper, shown, walk->cell_count, walk->columns);
    }
    drop_cells(walk);
}

static void meet_table(struct walk *walk, const struct tag *tag)
{
    if (is_named(tag, "table")) {
        end_block(walk);
        if (tag->is_end)
            set_cells(walk);
        else
            walk->place = IN_TABLE;
    } else if (is_named(tag, "tr")) {
        if (tag->is_end && walk->columns == 0)
            walk->columns = walk->cell_count;
    } else if (tag->is_end) {
        close_cell(walk);
    } else {
        end_block(walk);
        open_cell(walk, is_named(tag, "th"), has(tag, "\"num\""));
        walk->spans_two = has(tag, "colspan=\"2\"");
    }
}

static void meet_figure(struct walk *walk, const struct tag *tag)
{
    gsn_auto_mem(char) caption = NULL;

    end_block(walk);
    if (!tag->is_end) {
        walk->place = IN_FIGURE;
        return;
    }
    caption = take_part(walk);
    if (caption)
        gsn_paper_figure(walk->paper, &walk->picture, walk->title ? walk->title : "", caption);
    gsn_free(walk->title);
    gsn_free(walk->picture_bytes);
    walk->title = NULL;
    walk->picture_bytes = NULL;
    walk->picture = (struct gsn_paper_picture){ 0 };
    walk->place = NOWHERE;
}

static void meet_picture(struct walk *walk, const struct tag *tag)
{
    if (walk->cell_is_open) {
        struct cell *cell = &walk->cell[walk->cell_count - 1];

        take_picture(walk, tag, &cell->shown.picture, &cell->bytes);
        walk->has_pictures = 1;
    } else if (walk->place == IN_FIGURE) {
        take_picture(walk, tag, &walk->picture, &walk->picture_bytes);
    }
}

/* The cards of the summary are cells of a grid. */
static void meet_division(struct walk *walk, const struct tag *tag)
{
    end_block(walk);
    if (!walk->cards) {
        if (!tag->is_end && has(tag, "\"cards\"")) {
            walk->cards = 1;
            walk->place = IN_GRID;
        }
        return;
    }
    walk->cards += tag->is_end ? -1 : 1;
    if (walk->cards == 2 && !tag->is_end)
        open_cell(walk, 0, 0);
    else if (walk->cards == 1)
        close_cell(walk);
    else if (walk->cards == 0)
        set_cells(walk);
}

/* --- blocks --- */

static enum gsn_paper_style style_of(const struct tag *tag)
{
    if (is_named(tag, "h1"))
        return GSN_PAPER_TITLE;
    if (is_named(tag, "h2"))
        return GSN_PAPER_HEADING;
    if (is_named(tag, "h3") || is_named(tag, "summary") || has(tag, "\"label\"") ||
        has(tag, "\"state\""))
        return GSN_PAPER_SUBHEADING;
    if (has(tag, "\"big\""))
        return GSN_PAPER_BIG;
    return has(tag, "\"soft\"") || has(tag, "\"lead\"") ? GSN_PAPER_SOFT : GSN_PAPER_BODY;
}

static void meet_block(struct walk *walk, const struct tag *tag)
{
    if (tag->is_end && walk->place == IN_FIGURE && is_named(tag, "h3") && !walk->title) {
        end_block(walk);
        walk->title = take_part(walk);
        return;
    }
    end_block(walk);
    if (!tag->is_end)
        walk->style = style_of(tag);
}

static void meet_list(struct walk *walk, const struct tag *tag)
{
    if (is_named(tag, "ul")) {
        end_block(walk);
        walk->is_list_of_ids = !tag->is_end && has(tag, "\"ids\"");
    } else if (!tag->is_end && walk->is_list_of_ids) {
        if (walk->run.size)
            gsn_report_text_raw(&walk->run, " \xC2\xB7 ");
    } else if (!walk->is_list_of_ids) {
        end_block(walk);
        if (!tag->is_end)
            gsn_report_text_raw(&walk->run, "\xE2\x80\xA2 ");
    }
}

/* What paper cannot do. */
static int is_left_out(const struct tag *tag)
{
    static const char *const name[] = { "head", "nav", "svg", "script", "canvas" };

    for (size_t i = 0; i < sizeof name / sizeof *name; i++)
        if (is_named(tag, name[i]))
            return 1;
    return has(tag, "id=\"charts\"") || has(tag, "class=\"key");
}

static void meet_tag(struct walk *walk, const struct tag *tag)
{
    static const char *const block[] = {
        "h1", "h2", "h3", "p", "summary", "br", "section", "footer"
    };

    if (walk->skipped) {
        if (is_named(tag, walk->skipped_name))
            walk->skipped = tag->is_end ? walk->skipped - 1 : walk->skipped + 1;
    } else if (!tag->is_end && is_left_out(tag)) {
        (void)snprintf(walk->skipped_name, sizeof walk->skipped_name, "%.*s", (int)tag->name_length,
                       tag->name);
        walk->skipped = 1;
    } else if (is_named(tag, "table") || is_named(tag, "tr") || is_named(tag, "td") ||
               is_named(tag, "th")) {
        meet_table(walk, tag);
    } else if (is_named(tag, "figure")) {
        meet_figure(walk, tag);
    } else if (is_named(tag, "img")) {
        meet_picture(walk, tag);
    } else if (is_named(tag, "div")) {
        meet_division(walk, tag);
    } else if (is_named(tag, "ul") || is_named(tag, "li")) {
        meet_list(walk, tag);
    } else {
        for (size_t i = 0; i < sizeof block / sizeof *block; i++)
            if (is_named(tag, block[i]))
                meet_block(walk, tag);
    }
}

static struct tag read_tag(const char *at, const char *end)
{
    struct tag tag = { .is_end = at[1] == '/' };

    tag.name = at + 1 + tag.is_end;
    tag.name_length = strcspn(tag.name, " />");
    tag.attributes = tag.name + tag.name_length;
    tag.attributes_length = (size_t)(end - tag.attributes);
    return tag;
}

static void walk_page(struct walk *walk, const char *page)
{
    const char *at = page;

    while (!walk->failed && *at) {
        const char *open = strchr(at, '<'), *close = open ? strchr(open, '>') : NULL;
        struct tag tag;

        if (!close)
            break;
        if (!walk->skipped)
            add_stretch(&walk->run, at, open);
        tag = read_tag(open, close);
        meet_tag(walk, &tag);
        at = close + 1;
        /* Scripts are no markup. */
        if (!tag.is_end && is_named(&tag, "script") && strstr(at, "</script>"))
            at = strstr(at, "</script>");
    }
}

int gsn_report_pdf(const struct gsn_report *report, uint8_t **ret_bytes, size_t *ret_size,
                   struct gsn_error *err)
{
    struct gsn_report still = *report; /* without the model to turn */
    gsn_auto(gsn_paper) paper = NULL;
    gsn_auto_mem(char) page = NULL;
    gsn_auto_mem(char) foot = NULL;
    struct walk walk = { .style = GSN_PAPER_BODY };
    size_t size;
    int r;

    still.model = NULL;
    foot = gsn_format("%s \xC2\xB7 gieson %s \xC2\xB7 run %.16s", report->specimen, report->version,
                      report->key ? report->key : "");
    if (!foot)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the report's PDF");
    r = gsn_report_html(&still, &page, &size, err);
    if (r >= 0)
        r = gsn_paper_new(report->specimen, foot, &paper, err);
    if (r < 0)
        return r;
    walk.paper = paper;
    walk_page(&walk, page);
    end_block(&walk);
    if (report->model || report->units || report->registration)
        gsn_paper_text(paper, GSN_PAPER_SOFT,
                       "On the page and not on paper: charts, and the model to turn and ask. See "
                       "report.html beside this file.");
    drop_cells(&walk);
    gsn_free(walk.cell);
    gsn_free(walk.title);
    gsn_free(walk.picture_bytes);
    gsn_report_text_done(&walk.run);
    gsn_report_text_done(&walk.part);
    if (walk.failed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the report's PDF");
    return gsn_paper_finish(paper, ret_bytes, ret_size, err);
}
