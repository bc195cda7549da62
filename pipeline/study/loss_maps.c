/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where groups lost collagen, over animals.
 *
 * Method: each cell of the base mesh (measure/base_cells.h) is one outcome. Specimens of one animal
 * are averaged in it; the loss of a group is the ratio of the means over animals with Fieller's
 * interval, as the study's own loss is, and Welch's test says whether the two groups differ there.
 * So many tests find some cells by chance: q is the share of false ones among the findings up to
 * that cell (Benjamini and Hochberg, J. R. Stat. Soc. B 57, 1995; neighbouring cells agree, which
 * their procedure allows: Benjamini and Yekutieli, Ann. Stat. 29, 2001).
 *
 * Steps: (1) all places of the animals of both sides in one list, sorted by cell and animal; (2) a
 * cell that two animals of either side have; (3) q; (4) quantiles, each cell by the control's
 * collagen in it; (5) the page: one layer of cubes, cut half way up.
 *
 * Failure: memory. Cost: the list's sorting. */
#include "pipeline/study/loss_maps.h"

#include "pipeline/measure/stats.h"
#include "pipeline/report/html_elements.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Findings of which one in twenty may be false. */
static const double FALSE_SHARE = 0.05;

/* One animal in one cell, as one of its specimens has it. */
struct place {
    struct gsn_base_address address;
    double density, volume;
    size_t animal;
    int is_control;
};

static int compare_places(const void *left, const void *right)
{
    const struct place *const a = left, *const b = right;
    const int order = gsn_base_compare(a->address, b->address);

    if (order != 0)
        return order;
    return (a->animal > b->animal) - (a->animal < b->animal);
}

static int is_side(const struct gsn_study *study, const struct gsn_study_comparison *c,
                   size_t animal, int *ret_control)
{
    const size_t cell = study->animal[animal].cell;

    *ret_control = cell != c->a;
    if (cell == c->a || cell == c->b)
        return 1;
    return c->pooled && study->cell[cell].is_control &&
           strcmp(study->cell[cell].group, study->cell[c->b].group) == 0;
}

static int is_of(const struct gsn_study *study, const struct gsn_study_specimen *s, size_t animal)
{
    const struct gsn_study_animal *const a = &study->animal[animal];
    const struct gsn_study_cell *const cell = &study->cell[a->cell];

    return !s->left_out && strcmp(s->animal, a->name) == 0 && strcmp(s->group, cell->group) == 0 &&
           (isnan(s->week) ? isnan(cell->week) : !(s->week < cell->week || s->week > cell->week));
}

/* gives: the places of both sides, sorted. */
static int list_places(const struct gsn_study *study, const struct gsn_study_comparison *c,
                       struct place **ret_place, size_t *ret_count, struct gsn_error *err)
{
    size_t room = 0, used = 0;
    struct place *place;

    for (size_t i = 0; i < study->input.specimen_count; i++)
        room += study->input.specimen[i].place_count;
    place = gsn_alloc_array(room + 1, sizeof *place);
    if (!place)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the cells of a study");
    for (size_t a = 0; a < study->animal_count; a++) {
        int is_control;

        if (!is_side(study, c, a, &is_control))
            continue;
        for (size_t i = 0; i < study->input.specimen_count; i++) {
            const struct gsn_study_specimen *const s = &study->input.specimen[i];

            for (size_t k = 0; k < s->place_count && is_of(study, s, a); k++)
                place[used++] = (struct place){ .address = s->place[k].address,
                                                .density = s->place[k].density,
                                                .volume = s->place[k].volume_um3,
                                                .animal = a,
                                                .is_control = is_control };
        }
    }
    qsort(place, used, sizeof *place, compare_places);
    *ret_place = place;
    *ret_count = used;
    return GSN_OK;
}

/* One number an animal, of each side. */
struct sides {
    double *treated, *control; /* owned */
    size_t treated_count, control_count;
    double volume; /* of the treated, summed */
};

/* place[0..count) are of one cell. */
static void average_animals(const struct place *place, size_t count, struct sides *sides)
{
    sides->treated_count = sides->control_count = 0;
    sides->volume = 0;
    for (size_t i = 0; i < count;) {
        const size_t first = i;
        double density = 0, volume = 0, n;

        for (; i < count && place[i].animal == place[first].animal; i++) {
            density += place[i].density;
            volume += place[i].volume;
        }
        n = (double)(i - first);
        if (place[first].is_control) {
            sides->control[sides->control_count++] = density / n;
        } else {
            sides->treated[sides->treated_count++] = density / n;
            sides->volume += volume / n;
        }
    }
}

/* Returns 0 where too few animals have the cell, or the control holds nothing there. */
static int compare_cell(struct gsn_base_address address, const struct sides *sides,
                        struct gsn_study_loss_cell *ret)
{
    struct gsn_group_mean a, b;

    if (sides->treated_count < 2 || sides->control_count < 2)
        return 0;
    a = gsn_group_mean_of(sides->treated, sides->treated_count);
    b = gsn_group_mean_of(sides->control, sides->control_count);
    if (!(b.mean > 0))
        return 0;
    *ret = (struct gsn_study_loss_cell){ .address = address,
                                         .treated = a.n,
                                         .controls = b.n,
                                         .density = a.mean,
                                         .control = b.mean,
                                         .volume_um3 = sides->volume / (double)a.n,
                                         .loss = gsn_group_loss_of(&a, &b),
                                         .p = gsn_group_welch(&a, &b).p };
    return isfinite(ret->loss.lower) && isfinite(ret->p);
}

static int compare_p(const void *left, const void *right)
{
    const struct gsn_study_loss_cell *const a = *(struct gsn_study_loss_cell *const *)left;
    const struct gsn_study_loss_cell *const b = *(struct gsn_study_loss_cell *const *)right;

    if (a->p < b->p || a->p > b->p)
        return a->p < b->p ? -1 : 1;
    return gsn_base_compare(a->address, b->address);
}

static int correct_cells(struct gsn_study_loss_map *map, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_study_loss_cell *) sorted = gsn_alloc_array(map->count, sizeof *sorted);
    double q = 1;

    if (!sorted)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the cells of a study");
    for (size_t i = 0; i < map->count; i++)
        sorted[i] = &map->cell[i];
    qsort(sorted, map->count, sizeof *sorted, compare_p);
    for (size_t i = map->count; i-- > 0;) {
        q = fmin(q, sorted[i]->p * (double)map->count / (double)(i + 1));
        sorted[i]->q = q;
    }
    return GSN_OK;
}

static int sum_up(struct gsn_study_loss_map *map, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_weighed) sorted = gsn_alloc_array(map->count, sizeof *sorted);
    double all = 0;

    if (!sorted)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the cells of a study");
    for (size_t i = 0; i < map->count; i++) {
        const struct gsn_study_loss_cell *const c = &map->cell[i];
        const double weight = c->volume_um3 * c->control;

        sorted[i] = (struct gsn_weighed){ c->loss.percent, weight };
        all += weight;
        if (c->q <= FALSE_SHARE)
            *(c->loss.percent > 0 ? &map->lost : &map->gained) += weight;
    }
    gsn_weighed_sort(sorted, map->count);
    map->low = gsn_weighed_quantile(sorted, map->count, 0.05);
    map->median = gsn_weighed_quantile(sorted, map->count, 0.5);
    map->high = gsn_weighed_quantile(sorted, map->count, 0.95);
    map->lost /= all;
    map->gained /= all;
    return GSN_OK;
}

/* Leaves the map empty where no cell has two animals a side. */
static int map_loss(const struct gsn_study *study, size_t comparison,
                    struct gsn_study_loss_map *ret_map, struct gsn_error *err)
{
    gsn_auto_mem(double) treated = gsn_alloc_array(study->animal_count + 1, sizeof *treated);
    gsn_auto_mem(double) control = gsn_alloc_array(study->animal_count + 1, sizeof *control);
    gsn_auto_mem(struct place) place = NULL;
    struct sides sides = { .treated = treated, .control = control };
    size_t count = 0;
    int r = treated && control ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for a study");

    *ret_map = (struct gsn_study_loss_map){ .comparison = comparison };
    if (r >= 0)
        r = list_places(study, &study->comparison[comparison], &place, &count, err);
    if (r < 0)
        return r;
    ret_map->cell = gsn_alloc_array(count / 4 + 1, sizeof *ret_map->cell);
    if (!ret_map->cell)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the cells of a study");
    for (size_t i = 0, end; i < count; i = end) {
        for (end = i + 1;
             end < count && gsn_base_compare(place[i].address, place[end].address) == 0; end++) {
        }
        average_animals(place + i, end - i, &sides);
        /* Four places at least make a cell. */
        if (end - i >= 4)
            ret_map->count +=
                (size_t)compare_cell(place[i].address, &sides, &ret_map->cell[ret_map->count]);
    }
    if (ret_map->count == 0)
        return GSN_OK;
    r = correct_cells(ret_map, err);
    return r < 0 ? r : sum_up(ret_map, err);
}

int gsn_study_map_losses(struct gsn_study *study, struct gsn_error *err)
{
    int r = GSN_OK;

    study->map = gsn_alloc_array(study->comparison_count + 1, sizeof *study->map);
    if (!study->map)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a study");
    for (size_t i = 0; r >= 0 && i < study->comparison_count; i++) {
        struct gsn_study_loss_map *const map = &study->map[study->map_count];

        if (study->comparison[i].kind != GSN_STUDY_LOSS || study->comparison[i].measure != 0)
            continue;
        r = map_loss(study, i, map, err);
        if (r < 0 || map->count == 0) {
            gsn_free(map->cell);
            *map = (struct gsn_study_loss_map){ 0 };
        } else {
            study->map_count++;
        }
    }
    return r;
}

/* ---- the table ------------------------------------------------------------------------------ */

static void put_numbers(struct gsn_report_text *text, const double *value, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (isfinite(value[i]))
            gsn_report_text_print(text, ",%.9g", value[i]);
        else
            gsn_report_text_raw(text, ",");
}

int gsn_study_cells_csv(const struct gsn_study *study, char **ret_bytes, size_t *ret_size,
                        struct gsn_error *err)
{
    gsn_auto_report_text text = { .bytes = NULL };

    gsn_report_text_raw(&text, "group,week,against,cube_x,cube_y,cube_z,tet,x_um,y_um,z_um,"
                               "volume_um3,animals,animals_against,density,density_against,"
                               "loss_percent,loss_lower,loss_upper,p,q\r\n");
    for (size_t m = 0; m < study->map_count; m++) {
        const struct gsn_study_comparison *const c = &study->comparison[study->map[m].comparison];

        for (size_t i = 0; i < study->map[m].count; i++) {
            const struct gsn_study_loss_cell *const at = &study->map[m].cell[i];
            double corner[4][3], figures[12];

            gsn_base_corners(at->address, corner);
            for (int k = 0; k < 3; k++)
                figures[k] = 0.25 * (corner[0][k] + corner[1][k] + corner[2][k] + corner[3][k]);
            memcpy(figures + 3,
                   (const double[9]){ at->volume_um3, (double)at->treated, (double)at->controls,
                                      at->density, at->control, at->loss.percent, at->loss.lower,
                                      at->loss.upper, at->p },
                   9 * sizeof *figures);
            gsn_report_text_field(&text, study->cell[c->a].group);
            put_numbers(&text, &study->cell[c->a].week, 1);
            gsn_report_text_raw(&text, ",");
            gsn_report_text_field(&text, study->cell[c->b].group);
            gsn_report_text_print(&text, ",%d,%d,%d,%d", at->address.cube[0], at->address.cube[1],
                                  at->address.cube[2], at->address.tet);
            put_numbers(&text, figures, 12);
            put_numbers(&text, &at->q, 1);
            gsn_report_text_raw(&text, "\r\n");
        }
    }
    if (text.failed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the cells of a study");
    gsn_report_text_give(&text, ret_bytes, ret_size);
    return GSN_OK;
}

/* ---- the page ------------------------------------------------------------------------------- */

enum { SIDE_PX = 46, LEGEND_STEPS = 24 };

/* The layer of cubes in which most collagen was lost. */
static int32_t find_layer(const struct gsn_study_loss_map *map)
{
    double best = -INFINITY, sum = 0;
    int32_t layer = 0;

    for (size_t i = 0; i < map->count; i++) {
        const struct gsn_study_loss_cell *const c = &map->cell[i];

        /* Cells are in order of z. */
        sum += c->volume_um3 * (c->control - c->density);
        if (i + 1 < map->count && map->cell[i + 1].address.cube[2] == c->address.cube[2])
            continue;
        if (sum > best) {
            best = sum;
            layer = c->address.cube[2];
        }
        sum = 0;
    }
    return layer;
}

/* Where a tetrahedron of a cube is cut half way up: corners in halves of its edge. */
static size_t cut_cell(uint8_t tet, int ret_corner[4][2])
{
    /* By the order of its axes; x and y change places for the others. */
    static const int upper[3][4][2] = { { { 1, 1 }, { 2, 1 }, { 2, 2 }, { 0, 0 } },   /* x y z */
                                        { { 1, 0 }, { 2, 0 }, { 2, 1 }, { 1, 1 } },   /* x z y */
                                        { { 0, 0 }, { 1, 0 }, { 1, 1 }, { 0, 0 } } }; /* z x y */
    static const struct {
        int shape, swapped;
    } known[GSN_BASE_TETS] = { { 0, 0 }, { 1, 0 }, { 0, 1 }, { 1, 1 }, { 2, 0 }, { 2, 1 } };
    const int shape = known[tet].shape, swapped = known[tet].swapped;

    for (int k = 0; k < 4; k++) {
        ret_corner[k][0] = upper[shape][k][swapped];
        ret_corner[k][1] = upper[shape][k][!swapped];
    }
    return shape == 1 ? 4 : 3;
}

static double shade_of(const struct gsn_study_loss_map *map, double percent)
{
    const double span = map->high - map->low;

    return span > 0 ? fmin(1, fmax(0, (percent - map->low) / span)) : 0.5;
}

static void draw_place(struct gsn_report_text *text, const struct gsn_study_loss_map *map,
                       const struct gsn_study_loss_cell *c, const int32_t first[2])
{
    int corner[4][2];
    const size_t corners = cut_cell(c->address.tet, corner);

    gsn_report_text_raw(text, "<polygon points=\"");
    for (size_t k = 0; k < corners; k++)
        gsn_report_text_print(text, "%s%.1f,%.1f", k ? " " : "",
                              SIDE_PX * (c->address.cube[0] - first[0] + 0.5 * corner[k][0]),
                              SIDE_PX * (c->address.cube[1] - first[1] + 0.5 * corner[k][1]) + 4);
    if (c->q <= FALSE_SHARE)
        gsn_report_text_print(text, "\" fill=\"#a0144f\" fill-opacity=\"%.2f\"><title>",
                              0.15 + 0.85 * shade_of(map, c->loss.percent));
    else
        gsn_report_text_raw(text, "\" fill=\"#808890\" fill-opacity=\"0.25\"><title>");
    gsn_report_text_number(text, c->loss.percent, 1);
    gsn_report_text_raw(text, " % (");
    gsn_report_text_number(text, c->loss.lower, 1);
    gsn_report_text_raw(text, " to ");
    gsn_report_text_number(text, c->loss.upper, 1);
    gsn_report_text_print(text, "), %zu and %zu animals, q ", c->treated, c->controls);
    gsn_report_text_digits(text, c->q, 2);
    gsn_report_text_raw(text, "</title></polygon>\n");
}

static void draw_legend(struct gsn_report_text *text, const struct gsn_study_loss_map *map,
                        double width, double top)
{
    const double step = fmin(10, width / (LEGEND_STEPS + 2));

    for (int i = 0; i < LEGEND_STEPS; i++)
        gsn_report_text_print(text,
                              "<rect x=\"%.1f\" y=\"%.1f\" width=\"%.2f\" height=\"10\" "
                              "fill=\"#a0144f\" fill-opacity=\"%.2f\"/>\n",
                              i * step, top, step, 0.15 + 0.85 * i / (LEGEND_STEPS - 1));
    gsn_report_text_print(text, "<text x=\"0\" y=\"%.1f\">", top + 25);
    gsn_report_text_number(text, map->low, 0);
    gsn_report_text_print(text, " %%</text>\n<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"end\">",
                          LEGEND_STEPS * step, top + 25);
    gsn_report_text_number(text, map->high, 0);
    gsn_report_text_raw(text, " % lost</text>\n");
}

static void draw_layer(struct gsn_report_text *text, const struct gsn_study_loss_map *map)
{
    const int32_t layer = find_layer(map);
    int32_t first[2] = { INT32_MAX, INT32_MAX }, last[2] = { INT32_MIN, INT32_MIN };
    double width, height;

    for (size_t i = 0; i < map->count; i++)
        for (int k = 0; k < 2 && map->cell[i].address.cube[2] == layer; k++) {
            const int32_t cube = map->cell[i].address.cube[k];

            first[k] = cube < first[k] ? cube : first[k];
            last[k] = cube > last[k] ? cube : last[k];
        }
    width = SIDE_PX * (last[0] - first[0] + 1.0);
    height = SIDE_PX * (last[1] - first[1] + 1.0) + 8;
    gsn_report_text_print(text,
                          "<figure><div class=\"drawing\"><svg viewBox=\"-4 0 %.0f %.0f\" "
                          "role=\"img\" class=\"chart few\"><title>Loss of each cell across z"
                          "</title>\n",
                          fmax(width, 300) + 8, height + 34);
    for (size_t i = 0; i < map->count; i++)
        if (map->cell[i].address.cube[2] == layer)
            draw_place(text, map, &map->cell[i], first);
    draw_legend(text, map, fmax(width, 300), height + 4);
    gsn_report_text_print(
        text,
        "</svg></div><figcaption>Across z at %d \xC2\xB5m, where most was lost; x right from %d, y "
        "down from %d \xC2\xB5m. Grey: not told apart from its control.</figcaption>"
        "</figure>\n",
        layer * GSN_BASE_EDGE_UM + GSN_BASE_EDGE_UM / 2, first[0] * GSN_BASE_EDGE_UM,
        first[1] * GSN_BASE_EDGE_UM);
}

static void add_map(struct gsn_report_text *text, const struct gsn_study *study,
                    const struct gsn_study_loss_map *map)
{
    const struct gsn_study_comparison *const c = &study->comparison[map->comparison];
    const struct gsn_study_cell *const a = &study->cell[c->a];

    gsn_report_text_raw(text, "<h3>");
    gsn_report_text_escape(text, *a->group ? a->group : "(no group)");
    if (isfinite(a->week)) {
        gsn_report_text_raw(text, ", week ");
        gsn_report_text_plain(text, a->week);
    }
    gsn_report_text_raw(text, ", against ");
    gsn_report_text_escape(text, study->cell[c->b].group);
    gsn_report_text_print(
        text, "</h3>\n<p>%zu cells that two animals or more of either side have. ", map->count);
    gsn_html_figure(text, "In cells with ", 100 * map->lost, 0,
                    " % of the control's collagen a loss");
    gsn_html_figure(text, " is told from none, in cells with ", 100 * map->gained, 0,
                    " % a gain. ");
    gsn_html_figure(text, "Half of the control's collagen lies where more than ", map->median, 0,
                    " % was lost; ");
    gsn_html_figure(text, "a twentieth where less than ", map->low, 0, " %, ");
    gsn_html_figure(text, "a twentieth where more than ", map->high, 0, " %.</p>\n");
    draw_layer(text, map);
}

void gsn_study_add_maps(struct gsn_report_text *text, const struct gsn_study *study)
{
    if (study->map_count == 0)
        return;
    gsn_report_text_print(
        text,
        "<section id=\"lost\"><h2>Where it was lost</h2>\n<p class=\"lead\">The loss in each cell "
        "of a mesh that all specimens share (cubes of %d \xC2\xB5m in the block frame, six "
        "tetrahedra each), over animals. A cell is one piece of the block, laid by the laser "
        "marks: where animals differ in shape, edges of tissue show. Of the cells in colour one "
        "in twenty may be there by chance (Benjamini and Hochberg). All of them: "
        "<a href=\"loss-cells.csv\">loss-cells.csv</a>.</p>\n",
        GSN_BASE_EDGE_UM);
    for (size_t i = 0; i < study->map_count; i++)
        add_map(text, study, &study->map[i]);
    gsn_report_text_raw(text, "</section>\n");
}
