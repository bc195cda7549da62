/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Swaps of two sections, one at a time, put into the laid planes of a whole specimen:
 *
 *     swap_planes FOLDER FAR
 *
 * FOLDER is one that gieson import reads. Its panels are taken through the product's own stages to
 * the planes by which the order of sections is looked at; there every two neighbours (but of the
 * last two at either end), every two sections that are two and three apart, and FAR pairs drawn
 * from those farther apart change places, each alone. A minute for a dozen swaps. */
#include "pipeline/specimen/reconstruction.h"
#include "pipeline/core/file.h"
#include "pipeline/decode/volume.h"
#include "pipeline/specimen/panel_analysis.h"
#include "tests/memory_file.h"
#include "tests/register/draw.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_PANELS = 16, MOST_BYTES = 1 << 30 };

struct panels {
    struct gsn_protocol *protocol;
    struct gsn_mask *region;
    size_t count;
    struct gsn_specimen_panel panel[MOST_PANELS];
    struct gsn_panel_findings *findings[MOST_PANELS];
    uint8_t *bytes[MOST_PANELS];
    char name[MOST_PANELS][32];
};

struct tally {
    size_t made, found, others;
};

/* Not with the planes: what is wrapped below is called without a context of ours. */
static unsigned far_swaps;

/* ---- swaps -------------------------------------------------------------------------------- */

struct planes {
    struct gsn_sequence_plane *plane;
    size_t count, columns, rows;
};

int __real_gsn_sequence_examine(const struct gsn_sequence_plane *planes, size_t count,
                                size_t columns, size_t rows, struct gsn_sequence **ret_sequence,
                                struct gsn_error *err);
int __wrap_gsn_sequence_examine(const struct gsn_sequence_plane *planes, size_t count,
                                size_t columns, size_t rows, struct gsn_sequence **ret_sequence,
                                struct gsn_error *err);

static void exchange(const struct planes *p, size_t i, size_t j)
{
    const float *density = p->plane[i].density;

    p->plane[i].density = p->plane[j].density;
    p->plane[j].density = density;
}

static int swap_one(const struct planes *p, size_t i, size_t j, struct tally *t,
                    struct gsn_error *err)
{
    const unsigned a = p->plane[i].serial, b = p->plane[j].serial;
    gsn_auto(gsn_sequence) s = NULL;
    int r, found = 0;

    exchange(p, i, j);
    r = __real_gsn_sequence_examine(p->plane, p->count, p->columns, p->rows, &s, err);
    exchange(p, i, j);
    if (r < 0)
        return r;
    for (size_t k = 0; k < s->count; k++) {
        const struct gsn_sequence_finding *f = &s->finding[k];
        const int is = f->a == a && f->b == b;

        found |= is;
        if (f->kind == GSN_SEQUENCE_SWAP && !is) {
            t->others++;
            printf("  %u and %u named beside %u and %u\n", f->a, f->b, a, b);
        }
    }
    t->made++;
    t->found += found != 0;
    if (!found)
        printf("  %u and %u not found\n", a, b);
    return fflush(stdout) == 0 ? GSN_OK : gsn_fail(err, GSN_E_IO, "standard output");
}

static int swap_near(const struct planes *p, size_t apart, struct tally *t, struct gsn_error *err)
{
    const size_t end = apart == 1; /* which of the last two is the last cannot be told */
    int r = GSN_OK;

    for (size_t i = end; r >= 0 && i + apart + end < p->count; i++)
        r = swap_one(p, i, i + apart, t, err);
    return r;
}

static int swap_far(const struct planes *p, struct tally *t, struct gsn_error *err)
{
    struct draw_chance chance = { 1 };
    int r = GSN_OK;

    while (r >= 0 && t->made < far_swaps) {
        const size_t i = (size_t)draw_uniform(&chance, 0, (double)p->count);
        const size_t j = (size_t)draw_uniform(&chance, 0, (double)p->count);

        if (j > i + GSN_SEQUENCE_NEAR)
            r = swap_one(p, i, j, t, err);
    }
    return r;
}

/* What share is found of swaps of any two sections, each pair as likely as any other. */
static double share_of_all(size_t count, const struct tally near[GSN_SEQUENCE_NEAR],
                           const struct tally *far)
{
    const double all = (double)count * ((double)count - 1) / 2 - 2;
    double sum = 0, pairs = 0;

    for (size_t f = 0; f < GSN_SEQUENCE_NEAR; f++) {
        sum += (double)near[f].found;
        pairs += (double)near[f].made;
    }
    return far->made ? (sum + (all - pairs) * (double)far->found / (double)far->made) / all : NAN;
}

static int swap_all(const struct planes *p, struct gsn_error *err)
{
    struct tally near[GSN_SEQUENCE_NEAR] = { { 0 } }, far = { 0 };
    int r = GSN_OK;

    for (size_t f = 0; r >= 0 && f < GSN_SEQUENCE_NEAR; f++) {
        r = swap_near(p, f + 1, &near[f], err);
        printf("%zu apart: %zu of %zu found, %zu other swaps named\n", f + 1, near[f].found,
               near[f].made, near[f].others);
    }
    if (r >= 0)
        r = swap_far(p, &far, err);
    printf("farther apart: %zu of %zu found, %zu other swaps named\n", far.found, far.made,
           far.others);
    printf("of any two of %zu sections: %.2f %%\n", p->count,
           100 * share_of_all(p->count, near, &far));
    return r;
}

/* The planes as the product gathers them: first as they are, then with every swap. */
int __wrap_gsn_sequence_examine(const struct gsn_sequence_plane *planes, size_t count,
                                size_t columns, size_t rows, struct gsn_sequence **ret_sequence,
                                struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_sequence_plane) plane = gsn_memdup(planes, count * sizeof *plane);
    const struct planes p = { plane, count, columns, rows };
    int r = __real_gsn_sequence_examine(planes, count, columns, rows, ret_sequence, err);

    if (r < 0 || !plane)
        return r < 0 ? r : gsn_fail(err, GSN_E_NOMEM, "out of memory for the planes");
    for (size_t k = 0; k < (*ret_sequence)->count; k++)
        printf("in order: %u and %u named as %s\n", (*ret_sequence)->finding[k].a,
               (*ret_sequence)->finding[k].b,
               (*ret_sequence)->finding[k].kind == GSN_SEQUENCE_SWAP ? "swapped" : "one section");
    printf("told of neighbours %.0f %%, two apart %.0f %%, three apart %.0f %%\n",
           100 * (*ret_sequence)->shown[0], 100 * (*ret_sequence)->shown[1],
           100 * (*ret_sequence)->shown[2]);
    return swap_all(&p, err);
}

/* ---- the specimen ------------------------------------------------------------------------- */

static int open_panel(void *context, const char *sha256, int *ret_fd, struct gsn_error *err)
{
    const struct panels *p = context;

    for (size_t i = 0; i < p->count; i++)
        if (strcmp(p->panel[i].sha256, sha256) == 0)
            return gsn_memory_file(p->bytes[i], p->panel[i].size, ret_fd, err);
    return gsn_fail(err, GSN_E_NOTFOUND, "there is no object %s", sha256);
}

static int add_panel(struct panels *p, const char *folder, unsigned number, struct gsn_error *err)
{
    const size_t i = p->count;
    gsn_auto_mem(char) path = gsn_format("%s/%s-P%02u.jpg", folder, p->protocol->specimen, number);
    gsn_auto_fd fd = -1;
    size_t size;
    int r = path ? gsn_file_read(path, MOST_BYTES, &p->bytes[i], &size, err)
                 : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    if (r >= 0)
        r = gsn_file_open(path, &fd, err);
    if (r >= 0)
        r = gsn_panel_analyse(NULL, fd, p->protocol, number, NULL, 0, NULL, &p->findings[i], err);
    if (r < 0)
        return r;
    (void)snprintf(p->name[i], sizeof p->name[i], "P%02u", number);
    p->panel[i] = (struct gsn_specimen_panel){ .number = number,
                                               .file = p->name[i],
                                               .sha256 = p->name[i],
                                               .state = "registered",
                                               .message = "",
                                               .size = size,
                                               .px_um = p->findings[i]->px_um,
                                               .upright = p->findings[i]->upright,
                                               .section_count = p->findings[i]->count,
                                               .section = p->findings[i]->section };
    p->count++;
    return GSN_OK;
}

static int open_folder(struct panels *p, const char *folder, struct gsn_error *err)
{
    gsn_auto_mem(char) job = gsn_format("%s/job.json", folder);
    gsn_auto_mem(char) region = gsn_format("%s/region.mhd", folder);
    gsn_auto_mem(uint8_t) text = NULL;
    size_t size;
    int r = job && region ? gsn_file_read(job, MOST_BYTES, &text, &size, err)
                          : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    if (r >= 0)
        r = gsn_protocol_parse((const char *)text, size, &p->protocol, err);
    if (r >= 0)
        r = gsn_volume_read_mask(region, 0, 1, &p->region, err);
    for (unsigned i = 1; r >= 0 && i <= p->protocol->panels && i <= MOST_PANELS; i++)
        r = add_panel(p, folder, i, err);
    return r;
}

static int assemble(struct panels *p, struct gsn_error *err)
{
    const struct gsn_specimen_options options = { 0 };
    const struct gsn_specimen specimen = {
        .protocol = p->protocol,
        .panel_count = p->count,
        .panel = p->panel,
        .region = p->region,
        .baseline = { .name = "", .definition = "", .dyes = "" },
        .key = "",
        .open = open_panel,
        .context = p,
    };
    gsn_auto(gsn_reconstruction) assembly = NULL;

    return gsn_reconstruct(&specimen, &options, &assembly, err);
}

int main(int argc, char **argv)
{
    static struct panels panels;
    struct gsn_error err = { 0 };
    int r;

    if (argc != 3) {
        fputs("usage: swap_planes FOLDER FAR\n", stderr);
        return 64;
    }
    far_swaps = (unsigned)strtoul(argv[2], NULL, 10);
    r = open_folder(&panels, argv[1], &err);
    if (r >= 0)
        r = assemble(&panels, &err);
    if (r < 0)
        fprintf(stderr, "swap_planes: %s\n", err.text);
    for (size_t i = 0; i < MOST_PANELS; i++) {
        gsn_panel_findings_free(panels.findings[i]);
        gsn_free(panels.bytes[i]);
    }
    gsn_mask_free(panels.region);
    gsn_protocol_free(panels.protocol);
    return r < 0;
}
