/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/register/mounted.h"

#include "tests/check.h"

#include "pipeline/core/mem.h"

#include <math.h>
#include <stdlib.h>

const struct gsn_point mounted_marks[GSN_FIDUCIALS] = { { -2050, -1000 },
                                                        { 1700, -1500 },
                                                        { -1500, 1300 } };
const struct gsn_pose_options mounted_declared = { .markers_um = mounted_marks };

struct gsn_point mounted_px(const struct mounted *m, struct gsn_point um)
{
    const double *e = m->strain;
    const double x = um.x - m->about.x, y = um.y - m->about.y;
    const struct gsn_point p = { um.x + (e[0] + e[1]) * x + e[2] * y,
                                 um.y + e[2] * x + (e[0] - e[1]) * y };
    const double u = m->flipped ? -p.x : p.x, c = cos(m->angle), s = sin(m->angle);

    return (struct gsn_point){ m->centre_px.x + (c * u - s * p.y) / MOUNTED_PX,
                               m->centre_px.y + (s * u + c * p.y) / MOUNTED_PX };
}

/* Normal, or Student's t with 3 degrees of freedom. */
static double drawn(struct draw_chance *chance, int heavy)
{
    const double a = draw_normal(chance), b = draw_normal(chance), c = draw_normal(chance);

    return draw_normal(chance) / (heavy ? sqrt((a * a + b * b + c * c) / 3) : 1);
}

static void draw_marks(struct gsn_pose_input *input, const struct mounted *m,
                       const struct mounted_world *w, struct draw_chance *chance)
{
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const double poor = draw_uniform(chance, 0, 1) < w->unequal ? 4 : 1;
        const double way = draw_uniform(chance, 0, M_PI), c = cos(way), s = sin(way);
        const double along = poor * w->fit_um / MOUNTED_PX * draw_normal(chance);
        const double across = w->fit_um / MOUNTED_PX * draw_normal(chance);
        const double luck = w->erratic > 0 ? exp(w->erratic * draw_normal(chance)) : 1;
        const double said = luck * w->fit_um / MOUNTED_PX / fmax(w->modest, 1);
        const double va = pow(poor * said, 2), vb = pow(said, 2);
        const struct gsn_point um = { w->marks[i].x + input->serial * w->slope[i].x,
                                      w->marks[i].y + input->serial * w->slope[i].y };
        struct gsn_fiducial *mark = &input->marks[i];

        mark->found = 1;
        mark->px = mounted_px(m, um);
        mark->px.x += c * along - s * across + w->burn_um / MOUNTED_PX * draw_normal(chance);
        mark->px.y += s * along + c * across + w->burn_um / MOUNTED_PX * draw_normal(chance);
        mark->cov_xx = c * c * va + s * s * vb;
        mark->cov_yy = s * s * va + c * c * vb;
        mark->cov_xy = c * s * (va - vb);
    }
}

void mounted_draw(struct mounted_stack *s, const struct mounted_world *w,
                  struct draw_chance *chance)
{
    const struct gsn_point *t = w->marks;

    for (size_t i = 0; i < s->count; i++) {
        struct mounted *m = &s->mounting[i];

        *m = (struct mounted){
            .angle = draw_uniform(chance, -w->angle, w->angle),
            .flipped = draw_uniform(chance, 0, 1) < w->flips,
            .centre_px = { draw_uniform(chance, 300, 2000), draw_uniform(chance, 300, 1200) },
            .about = { (t[0].x + t[1].x + t[2].x) / 3, (t[0].y + t[1].y + t[2].y) / 3 },
        };
        for (int k = 0; k < 3; k++)
            m->strain[k] = w->strain_sd[k] * drawn(chance, w->heavy);
        s->input[i] = (struct gsn_pose_input){ .serial = (unsigned)i,
                                               .px_um = MOUNTED_PX,
                                               .mirrored = m->flipped };
        draw_marks(&s->input[i], m, w, chance);
        if (draw_uniform(chance, 0, 1) < w->missing)
            s->input[i].marks[(int)draw_uniform(chance, 0, 3)].found = 0;
    }
}

struct mounted_stack mounted_new(size_t count)
{
    struct mounted_stack s = { .count = count,
                               .mounting = gsn_alloc_array(count, sizeof *s.mounting),
                               .input = gsn_alloc_array(count, sizeof *s.input),
                               .pose = gsn_alloc_array(count, sizeof *s.pose) };

    CHECK(s.mounting && s.input && s.pose);
    return s;
}

void mounted_done(struct mounted_stack *s)
{
    gsn_free(s->mounting);
    gsn_free(s->input);
    gsn_free(s->pose);
}

void mounted_solve(struct mounted_stack *s, const struct gsn_pose_options *options)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_pose_solve(s->input, s->count, options, s->pose, &s->summary, &err), err);
}

struct gsn_point mounted_error(const struct mounted_stack *s, size_t i, struct gsn_point target)
{
    const struct gsn_point p =
        gsn_affine_apply(&s->pose[i].panel_to_block_um, mounted_px(&s->mounting[i], target));

    return (struct gsn_point){ p.x - target.x, p.y - target.y };
}

size_t mounted_trials(size_t few)
{
    const char *stated = getenv("GIESON_TRIALS");
    const unsigned long trials = stated ? strtoul(stated, NULL, 10) : 0;

    return trials > 0 ? trials : few;
}

double mounted_tre(double fle, double rho, double r)
{
    return fle * sqrt((1 + r * r / (2 * rho * rho)) / 3);
}
