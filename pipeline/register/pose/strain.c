/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: the strain between two triangles is exact (six coordinates are a motion and a strain, one
 * to one); what all sections share is a linear regression on the sections' angles with an F test.
 *
 * Steps of gsn_strain_of_panel(). 1. Each section's strain against the mean triangle. 2. The
 * block's own stretch turns with no section, the panel's twice as fast as the section: both are
 * fitted where the sections are turned enough, the panel's alone, against the protocol's triangle,
 * where not.
 * 3. It is reported beyond 0.1 % of chance and beyond half a per cent.
 *
 * Finds nothing where neither turning nor a declared triangle can show it. Cost: nothing. */
#include "pipeline/register/pose/strain.h"

#include "pipeline/core/distributions.h"
#include "pipeline/core/linalg.h"
#include "pipeline/register/pose/weighted_fit.h"

#include <math.h>
#include <string.h>

enum { COORDS = 2 * GSN_FIDUCIALS, UNKNOWNS = 4 };

/* Pixels less square than this matter to nothing: half the tolerance of a pixel size. */
static const double PRACTICAL = 0.005;
/* Turned sections tell the panel's stretch from the block's when they know it this well. */
static const double KNOWN = 0.002;
/* A chance of 0.1 %. */
static const double ALPHA = 1e-3;

struct gsn_strain_axes gsn_strain_principal(const double strain[3])
{
    const double r = hypot(strain[1], strain[2]);

    return (struct gsn_strain_axes){ strain[0] + r, strain[0] - r,
                                     r > 0 ? 0.5 * atan2(strain[2], strain[1]) : 0 };
}

struct gsn_affine gsn_strain_corrected(const struct gsn_pose *pose)
{
    const double xx = 1 + pose->strain[0] + pose->strain[1], xy = pose->strain[2];
    const double yy = 1 + pose->strain[0] - pose->strain[1];
    const struct gsn_point c = pose->error.about;
    const struct gsn_affine stretch = { xx, xy, c.x - xx * c.x - xy * c.y,
                                        xy, yy, c.y - xy * c.x - yy * c.y };
    const struct gsn_affine back = gsn_affine_inverse(&stretch);

    return gsn_affine_compose(&pose->panel_to_block_um, &back);
}

/* (0, 0), (1, 0) and (0, 1) -> the triangle. */
static struct gsn_affine onto_triangle(const struct gsn_point t[GSN_FIDUCIALS])
{
    return (struct gsn_affine){ t[1].x - t[0].x, t[2].x - t[0].x, t[0].x,
                                t[1].y - t[0].y, t[2].y - t[0].y, t[0].y };
}

struct gsn_affine gsn_strain_of_mean(const struct gsn_point mean[GSN_FIDUCIALS],
                                     const struct gsn_point declared[GSN_FIDUCIALS])
{
    const struct gsn_affine from = onto_triangle(mean), onto = onto_triangle(declared);
    const struct gsn_affine back = gsn_affine_inverse(&from);

    return gsn_affine_compose(&back, &onto);
}

void gsn_strain_between(const struct gsn_point from[GSN_FIDUCIALS],
                        const struct gsn_point to[GSN_FIDUCIALS], double ret_strain[3])
{
    const struct gsn_point about = { (from[0].x + from[1].x + from[2].x) / 3,
                                     (from[0].y + from[1].y + from[2].y) / 3 };
    double a[COORDS][COORDS] = { 0 }, y[COORDS];
    struct gsn_rigid motion;

    memset(ret_strain, 0, 3 * sizeof *ret_strain);
    if (gsn_rigid_fit(to, from, NULL, GSN_FIDUCIALS, &motion, NULL, NULL) < 0)
        return;
    for (size_t i = 0; i < GSN_FIDUCIALS; i++) {
        const struct gsn_point p = gsn_rigid_apply(&motion, to[i]);
        const struct gsn_point u = { from[i].x - about.x, from[i].y - about.y };
        double j[2][3], k[2][3];

        gsn_pose_jacobian(u, j, k);
        for (size_t r = 0; r < 2; r++)
            for (size_t c = 0; c < 3; c++) {
                a[2 * i + r][c] = j[r][c];
                a[2 * i + r][3 + c] = k[r][c];
            }
        y[2 * i] = p.x - from[i].x;
        y[2 * i + 1] = p.y - from[i].y;
    }
    if (gsn_solve_general(&a[0][0], COORDS, COORDS, y, 1, 1) < 0)
        return;
    for (size_t c = 0; c < 3; c++)
        ret_strain[c] = y[3 + c];
}

/* The section's marks, laid rigidly; whether it can be asked. */
static int laid_marks(const struct gsn_pose_input *input, const struct gsn_pose *pose,
                      struct gsn_point ret_mark[GSN_FIDUCIALS])
{
    if (pose->state != GSN_POSE_OK || pose->gross)
        return 0;
    for (size_t i = 0; i < GSN_FIDUCIALS; i++)
        ret_mark[i] = gsn_affine_apply(&pose->panel_to_block_um, input->marks[pose->order[i]].px);
    return 1;
}

/* Rows for x against y and for shear: the block's own stretch (left out when `block` is 0) and the
 * panel's, turned twice as fast as the section. */
static void find_rows(const struct gsn_pose *pose, int block, double ret_row[2][UNKNOWNS])
{
    const struct gsn_affine *m = &pose->panel_to_block_um;
    const double mirror = pose->flipped ? -1 : 1, angle = 2 * atan2(-m->m01, m->m11);
    const double rows[2][UNKNOWNS] = { { cos(angle), -mirror * sin(angle), block, 0 },
                                       { sin(angle), mirror * cos(angle), 0, block } };

    memcpy(ret_row, rows, sizeof rows);
}

struct regression {
    double inverse[UNKNOWNS][UNKNOWNS], right[UNKNOWNS], square;
    size_t rows, unknowns;
};

static void add_section(struct regression *g, const struct gsn_pose *pose, const double strain[3])
{
    double row[2][UNKNOWNS];

    find_rows(pose, g->unknowns > 2, row);
    for (size_t r = 0; r < 2; r++) {
        for (size_t i = 0; i < g->unknowns; i++) {
            for (size_t j = 0; j < g->unknowns; j++)
                g->inverse[i][j] += row[r][i] * row[r][j];
            g->right[i] += row[r][i] * strain[1 + r];
        }
        g->square += strain[1 + r] * strain[1 + r];
    }
    g->rows += 2;
}

/* The first two unknowns and their standard deviation; 0 where they cannot be told. */
static int solve_regression(struct regression *g, double ret_found[2], double *ret_sd)
{
    double left = g->square;

    if (g->rows <= g->unknowns + 2 || gsn_invert_spd(&g->inverse[0][0], g->unknowns, UNKNOWNS) < 0)
        return 0;
    for (size_t i = 0; i < g->unknowns; i++) {
        double x = 0;

        for (size_t j = 0; j < g->unknowns; j++)
            x += g->inverse[i][j] * g->right[j];
        left -= x * g->right[i];
        if (i < 2)
            ret_found[i] = x;
    }
    *ret_sd = sqrt(fmax(left, 0) / (double)(g->rows - g->unknowns) * 0.5 *
                   (g->inverse[0][0] + g->inverse[1][1]));
    return 1;
}

static int fit_common(const struct gsn_pose_input *inputs, const struct gsn_pose *poses,
                      size_t count, const struct gsn_point *triangle, int block,
                      struct gsn_strain_common *ret_common)
{
    struct regression g = { .unknowns = block ? 4 : 2 };
    double found[2], sd, square;

    for (size_t i = 0; i < count; i++) {
        struct gsn_point marks[GSN_FIDUCIALS];
        double strain[3];

        if (!laid_marks(&inputs[i], &poses[i], marks))
            continue;
        gsn_strain_between(triangle, marks, strain);
        add_section(&g, &poses[i], strain);
    }
    if (!solve_regression(&g, found, &sd))
        return 0;
    square = found[0] * found[0] + found[1] * found[1];
    *ret_common = (struct gsn_strain_common){
        .along_x = 2 * found[0],
        .diagonal = 2 * found[1],
        .sd = 2 * sd,
        .from_declared = !block,
        .anisotropic = 2 * sqrt(square) > PRACTICAL &&
                       square > sd * sd * gsn_ratio_limit(2, (double)(g.rows - g.unknowns), ALPHA),
    };
    return 1;
}

struct gsn_strain_common gsn_strain_of_panel(const struct gsn_pose_input *inputs,
                                             const struct gsn_pose *poses, size_t count,
                                             const struct gsn_point *declared,
                                             const struct gsn_point mean[GSN_FIDUCIALS])
{
    struct gsn_strain_common common = { 0 };

    if (fit_common(inputs, poses, count, mean, 1, &common) && common.sd < KNOWN)
        return common;
    common = (struct gsn_strain_common){ 0 };
    if (declared)
        (void)fit_common(inputs, poses, count, declared, 0, &common);
    return common;
}
