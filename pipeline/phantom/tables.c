/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/phantom/tables.h"

#include "pipeline/phantom/buffer.h"
#include "pipeline/phantom/decoy.h"
#include "pipeline/phantom/delivery.h"
#include "pipeline/phantom/sight.h"

#include <math.h>

#define DEG_PER_RAD (180 / M_PI)

static void add_defects(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan, int k)
{
    const char *comma = "";

    for (size_t i = 0; i < plan->defects; i++)
        if (plan->defect[i].k == k) {
            gsn_phantom_buffer_print(text, "%s%s", comma,
                                     gsn_phantom_defect_name(plan->defect[i].kind));
            comma = ";";
        }
}

/* A section that is not there keeps its row, and with it the pose of what lies in its slot. */
static int write_sections(const struct gsn_phantom_plan *plan,
                          const struct gsn_phantom_extent *extent, const char *folder,
                          struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };

    gsn_phantom_buffer_print(&text, "k,z_um,panel,slot,present,flip,theta_deg,sx,sy,cx_px,cy_px,"
                                    "px_um,m00,m01,m02,m10,m11,m12,bbox_x,bbox_y,bbox_w,bbox_h,"
                                    "area_px,kr,ky,defects\n");
    for (int k = 0; k < plan->sections; k++) {
        const struct gsn_phantom_section *s = &plan->section[k];
        const struct gsn_phantom_batch *batch = &plan->batch[s->panel - 1];
        const struct gsn_affine *m = &s->to_panel;
        const struct gsn_phantom_extent *e = &extent[k];

        gsn_phantom_buffer_print(&text, "%d,%.15g,%d,%d,%d,%d,%.12g,%.12g,%.12g,%.9f,%.9f,%.15g,",
                                 k, s->z_um, s->panel, s->slot, s->shows == k, s->flip,
                                 s->theta * DEG_PER_RAD, s->sx, s->sy, s->centre_px.x,
                                 s->centre_px.y, plan->px_um);
        gsn_phantom_buffer_print(&text, "%.15g,%.15g,%.15g,%.15g,%.15g,%.15g,", m->m00, m->m01,
                                 m->m02, m->m10, m->m11, m->m12);
        gsn_phantom_buffer_print(&text, "%u,%u,%u,%u,%zu,%.12g,%.12g,", e->x, e->y, e->width,
                                 e->height, e->area_px, batch->red_gain, batch->yellow_gain);
        add_defects(&text, plan, k);
        gsn_phantom_buffer_print(&text, "\n");
    }
    return gsn_phantom_buffer_write(&text, folder, "sections.csv", err);
}

static int write_markers(const struct gsn_phantom_plan *plan, const char *folder,
                         struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };

    gsn_phantom_buffer_print(&text, "k,marker,x_px,y_px,visible,occluded_by\n");
    for (int k = 0; k < plan->sections; k++) {
        struct gsn_phantom_sight sight;

        gsn_phantom_sight_make(plan, k, &sight);
        for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
            struct gsn_point p;
            const char *by = gsn_phantom_sight_mark(&sight, i, &p);

            gsn_phantom_buffer_print(&text, "%d,%d,%.6f,%.6f,%d,%s\n", k, i + 1, p.x, p.y, !*by,
                                     by);
        }
    }
    return gsn_phantom_buffer_write(&text, folder, "markers.csv", err);
}

static int write_defects(const struct gsn_phantom_plan *plan, const char *folder,
                         struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };

    gsn_phantom_buffer_print(&text, "k,type,polygon,roi_fraction\n");
    for (size_t i = 0; i < plan->defects; i++) {
        const struct gsn_phantom_defect *d = &plan->defect[i];
        struct gsn_point p[GSN_PHANTOM_POLYGON];
        struct gsn_phantom_sight sight;
        size_t count;

        gsn_phantom_sight_make(plan, d->k, &sight);
        count = gsn_phantom_sight_polygon(&sight, d, p);
        gsn_phantom_buffer_print(&text, "%d,%s,", d->k, gsn_phantom_defect_name(d->kind));
        for (size_t j = 0; j < count; j++)
            gsn_phantom_buffer_print(&text, "%s%.2f %.2f", j ? ";" : "", p[j].x, p[j].y);
        gsn_phantom_buffer_print(&text, ",%.6f\n", gsn_phantom_sight_hidden(&sight, d));
    }
    return gsn_phantom_buffer_write(&text, folder, "defects.csv", err);
}

static int write_decoys(const struct gsn_phantom_plan *plan, const char *folder,
                        struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };

    gsn_phantom_buffer_print(&text, "k,type,x_px,y_px,radius_um\n");
    for (int k = 0; k < plan->sections; k++)
        for (int i = 0; i < plan->section[k].decoys; i++) {
            const struct gsn_phantom_decoy *d = &plan->section[k].decoy[i];

            gsn_phantom_buffer_print(&text, "%d,%s,%.3f,%.3f,%.3f\n", k,
                                     gsn_phantom_decoy_name(d->kind), d->at_um.x / plan->px_um,
                                     d->at_um.y / plan->px_um, d->radius_um);
        }
    return gsn_phantom_buffer_write(&text, folder, "decoys.csv", err);
}

/* Numbers files in the order of their delivery. */
static int write_files(const struct gsn_phantom_plan *plan, const char *folder,
                       struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };

    gsn_phantom_buffer_print(&text, "file,panel,again,orientation,bits,jpeg_passes,kept,tag_um\n");
    for (int i = 0; i < plan->files; i++) {
        const struct gsn_phantom_file *f = &plan->file[i];
        gsn_auto_mem(char) name = gsn_phantom_delivery_name(plan, i);

        if (!name)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for files.csv");
        gsn_phantom_buffer_print(&text, "%s,%d,%d,%d,%d,%d,%.6f,%.6f\n", name, f->panel, f->again,
                                 f->orientation, f->bits, f->bits == 8 ? f->passes : 0, f->kept,
                                 f->tag_um);
    }
    return gsn_phantom_buffer_write(&text, folder, "files.csv", err);
}

static int write_warp(const struct gsn_phantom_plan *plan, int k, const char *folder,
                      struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };
    gsn_auto_mem(char) name = gsn_format("warp_k%03d.csv", k);
    struct gsn_phantom_warp warp;

    if (!name)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the warp of section %d", k);
    gsn_phantom_plan_warp(plan, k, &warp);
    gsn_phantom_buffer_print(&text, "row,column,x_px,y_px,nx_um,ny_um\n");
    for (int j = 0; j < GSN_PHANTOM_WARP_SIDE; j++)
        for (int i = 0; i < GSN_PHANTOM_WARP_SIDE; i++)
            gsn_phantom_buffer_print(&text, "%d,%d,%.9g,%.9g,%.9f,%.9f\n", j, i,
                                     (warp.corner_um.x + i * warp.pitch_um) / plan->px_um,
                                     (warp.corner_um.y + j * warp.pitch_um) / plan->px_um,
                                     warp.node[j][i].x, warp.node[j][i].y);
    return gsn_phantom_buffer_write(&text, folder, name, err);
}

int gsn_phantom_tables_write(const struct gsn_phantom_plan *plan,
                             const struct gsn_phantom_extent extent[GSN_PHANTOM_SECTIONS],
                             const char *folder, struct gsn_error *err)
{
    int r = write_sections(plan, extent, folder, err);

    if (r >= 0)
        r = write_markers(plan, folder, err);
    if (r >= 0)
        r = write_defects(plan, folder, err);
    if (r >= 0 && gsn_phantom_plan_varies(plan))
        r = write_decoys(plan, folder, err);
    if (r >= 0 && plan->level.awkward)
        r = write_files(plan, folder, err);
    for (int k = 0; r >= 0 && plan->level.warp_rms_um > 0 && k < plan->sections; k++)
        if (plan->section[k].shows >= 0)
            r = write_warp(plan, k, folder, err);
    return r;
}
