/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the themes of gieson-bench share: clocks, fair races, lines of JSON, and the cube they all
 * work on.
 *
 * A line has at least the keys measure, value, unit, against and ratio. A ratio is formed within
 * one run only, between jobs that took turns; it says how many times faster ours is than what
 * stands in "against", unless the line says otherwise. Absolute times mean little elsewhere.
 *
 * A benchmark has nobody to report a failure to: what fails here ends the program with a
 * sentence. */
#ifndef GSN_TESTS_BENCH_BENCH_H
#define GSN_TESTS_BENCH_BENCH_H

#include "pipeline/core/grid.h"
#include "pipeline/model/kernels.h"
#include "pipeline/model/spline.h"

#include <jansson.h>

/* --quick: everything small, to see that it runs. Its figures mean nothing. */
extern int bench_quick;

/* ---- bench.c ---- */

/* Ends the program unless code says success; what names the step. */
void bench_need(int code, const struct gsn_error *err, const char *what);
/* The same for memory. */
void *bench_alloc(size_t count, size_t size);

struct bench_job {
    void (*run)(void *context);
    void *context;
    double cpu_s, wall_s; /* the least of all turns: of the whole process, and of the clock */
};

/* Runs all jobs in turn, repeats times over, so that whatever else the machine does meanwhile
 * meets all of them. */
void bench_race(struct bench_job *job, size_t count, unsigned repeats);

/* Prints one line and flushes. ratio NAN: there is none. against may be NULL. takes: details, an
 * object of further keys, or NULL. */
void bench_say(const char *measure, double value, const char *unit, const char *against,
               double ratio, json_t *details);
/* The line of a measure that could not be taken, on stderr too. */
void bench_skip(const char *measure, const char *unit, const char *against, const char *why);

/* The next of a fixed sequence, in [0, 1). */
double bench_draw(uint64_t *seed);

/* ---- cube.c ---- */

enum bench_size { BENCH_4K, BENCH_27K, BENCH_240K, BENCH_SIZES };

/* gives: a TetGen mesh of the unit cube of about so many tetrahedra, in Morton order. */
struct gsn_tets *bench_mesh(enum bench_size size);

/* A smooth field on it; splines take their control values from there. */
double bench_field(const double x[3]);

/* A mesh with a space and a spline on it; shared control points. */
struct bench_case {
    struct gsn_tets *mesh;
    struct gsn_dms *space;
    struct gsn_spline *spline;
    size_t shrunk; /* vertices whose clouds had to be made smaller than asked */
};

/* The clouds of every figure: knots 1..n of a vertex at cloud times its mean incident edge, along
 * the axes of a random orthonormal frame; on the boundary turned outwards. */
struct bench_case bench_case_new(enum bench_size size, unsigned degree, double cloud);
void bench_case_done(struct bench_case *bench);

/* edge^3 voxels whose cells fill the cube. */
struct gsn_lattice bench_lattice(size_t edge);

/* ---- vtk.c ---- */

/* A linear case as a VTK file of tetrahedra, the control values at the vertices. */
int bench_write_mesh(const struct bench_case *bench, const char *path);

/* ---- machine.c ---- */

/* Multiply-adds in registers and nothing else. Runs as a job with a struct bench_peak. */
struct bench_peak {
    enum gsn_isa isa;
    size_t rounds;
    double sink;
};
int bench_peak_exists(enum gsn_isa isa);
void bench_peak_run(void *peak);
/* Floating point operations of one run, a fused multiply-add counting 2. */
double bench_peak_flops(const struct bench_peak *peak);
const char *bench_isa_name(enum gsn_isa isa);

/* ---- the themes; each prints its lines ---- */

void bench_machine(void);
void bench_plain(void);
void bench_resample(void);
void bench_threads(void);
void bench_slope(void);
void bench_vtk(void);
void bench_rays(void);
void bench_kernel(void);
void bench_points(void);
void bench_locate(void);
void bench_mean(void);
void bench_fit(void);
void bench_space(void);
void bench_log(void);
void bench_log_slices(void);
void bench_spool(void);
void bench_decode(void);
void bench_split(void);
void bench_chain(void);

#endif
