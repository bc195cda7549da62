/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* gieson-bench [--quick] [measure ...]: how fast the splines are, how fast pictures are
 * kept and how fast panels are taken apart, one line of JSON a figure. */
#include "tests/bench/bench.h"

#include <signal.h>
#include <stdio.h>
#include <string.h>

int bench_quick;

static const struct {
    const char *name;
    void (*run)(void);
    const char *what;
} MEASURES[] = {
    { "machine", bench_machine, "peak of multiply-adds and memory bandwidth of this machine" },
    { "plain", bench_plain, "the textbook recurrence, per point" },
    { "resample", bench_resample, "splines onto 256^3 voxels, against the recurrences" },
    { "threads", bench_threads, "the same on two threads" },
    { "slope", bench_slope, "how its time grows with the number of tetrahedra" },
    { "vtk", bench_vtk, "linear splines on 96^3 voxels, against vtkProbeFilter" },
    { "rays", bench_rays, "pictures of 512^2 rays, against VTK's mappers and a trilinear caster" },
    { "kernel", bench_kernel, "seam kernels, as a fraction of the machine's peak" },
    { "points", bench_points, "value and gradient at random points" },
    { "locate", bench_locate, "which tetrahedron holds a point" },
    { "mean", bench_mean, "exact means over tetrahedra" },
    { "space", bench_space, "making a space and a spline, and their memory" },
    { "fit", bench_fit, "a fit to 128^3 voxels, its equations against one resampling of them" },
    { "log", bench_log, "a scan's rows, in this folder, against one bare INSERT" },
    { "slices", bench_log_slices, "a panel's slices, in this folder, against bare INSERTs" },
    { "spool", bench_spool, "a picture's bytes, in this folder: hash, copy and sync" },
    { "decode", bench_decode, "48 million pixels, against the bare libraries and cv2.imread" },
    { "split", bench_split, "sections on a panel of 48 million pixels, against OpenCV" },
    { "chain", bench_chain, "a panel's file to its sections in the block frame, against OpenCV" },
};

enum { COUNT = sizeof MEASURES / sizeof *MEASURES };

static int usage(const char *word)
{
    fprintf(stderr, "gieson-bench: no measure \"%s\"; there are\n", word);
    for (size_t m = 0; m < COUNT; m++)
        fprintf(stderr, "    %-10s %s\n", MEASURES[m].name, MEASURES[m].what);
    return 64;
}

int main(int argc, char **argv)
{
    int wanted[COUNT] = { 0 }, all = 1;

    /* A peer that dies shows as the end of its answers. */
    (void)signal(SIGPIPE, SIG_IGN);
    for (int a = 1; a < argc; a++) {
        size_t m = 0;

        if (strcmp(argv[a], "--quick") == 0) {
            bench_quick = 1;
            continue;
        }
        while (m < COUNT && strcmp(argv[a], MEASURES[m].name) != 0)
            m++;
        if (m == COUNT)
            return usage(argv[a]);
        wanted[m] = 1;
        all = 0;
    }
    for (size_t m = 0; m < COUNT; m++) {
        if (all || wanted[m])
            MEASURES[m].run();
    }
    return 0;
}
