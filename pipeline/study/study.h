/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A study: specimens become animals, animals groups, groups one answer.
 *
 * The unit is the animal. Specimens of one animal, in one group at one time point, are averaged
 * first: two sides of a jaw are not two animals. Every comparison, interval and p is over animals
 * (inference.h); what a single measurement is uncertain by is shown beside it and never in its
 * place.
 *
 * Nothing is looked up here and nothing printed; the caller gives records and writes the bytes. */
#ifndef GSN_STUDY_STUDY_H
#define GSN_STUDY_STUDY_H

#include "pipeline/core/mem.h"
#include "pipeline/measure/base_cells.h"
#include "pipeline/study/inference.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_STUDY_MEASURES = 12 };

/* What a report says of the bench and not of the animal: mean white of the glass, codes; stain
 * against the baseline's, factor; localisation error of a mark (FLE) and mean error of the
 * registration over the region (TRE), um. */
enum gsn_bench_figure {
    GSN_BENCH_WHITE,
    GSN_BENCH_STAIN,
    GSN_BENCH_FLE,
    GSN_BENCH_TRE,
    GSN_BENCH_FIGURES
};

struct gsn_study_measure {
    const char *name; /* "density", "volume_above_0.5", ... */
    const char *unit;
    const char *definition; /* one sentence */
};

/* Density of a specimen in a cell of the base mesh, as value[0] is: in the control's stain. */
struct gsn_study_place {
    struct gsn_base_address address;
    double density;
    double volume_um3; /* of the region in it */
};

/* One specimen as its latest report has it. Texts may hold anything and are borrowed. */
struct gsn_study_specimen {
    const char *name, *animal, *group;
    double week;         /* NaN: not stated */
    const char *control; /* the group that its loss is measured against; NULL: it is a control */
    double value[GSN_STUDY_MEASURES]; /* in the order of the study's measures; NaN: none */
    double error[GSN_STUDY_MEASURES]; /* standard error of the measurement; NaN: not known */
    double vector_error;              /* the part of error[0] that dye vectors make; NaN: none */
    double section_error; /* that which sections make, each by itself: cutting, registration; NaN */
    double loss, loss_lower, loss_upper; /* its own report's, per cent; NaN: none */
    const char *left_out;                /* why it takes no part; NULL: it does */
    int excluded;                        /* and that a person said so */
    const char *page; /* its report, from the store's folder, as a link; NULL: not shown */
    size_t warnings;  /* of its report */
    int64_t finished; /* when that was made, s since 1970; 0: there is none */
    int64_t first;    /* and its first report, near the day of its scans; 0: there is none */
    double bench[GSN_BENCH_FIGURES];     /* what the bench was like; NaN: not known */
    const char *key;                     /* of its run, 64 hexadecimal digits, or empty */
    const struct gsn_study_place *place; /* place_count, in order of address; none: not known */
    size_t place_count;
};

struct gsn_study_input {
    const char *name, *version;
    const char *region; /* what the figures are of, in words */
    const struct gsn_study_measure *measure;
    size_t measure_count; /* 1..GSN_STUDY_MEASURES; the first is the main one */
    const struct gsn_study_specimen *specimen;
    size_t specimen_count;
    int blind;          /* group names are codes, nobody is a control */
    const char *frozen; /* "2026-11-25, by mueller", or NULL */
    const struct gsn_study_input
        *part; /* the same study in further regions, each with the name of its
                                           region; without parts; their measures are the first of
                                           this one's */
    size_t part_count;
};

/* An animal in a group at a time point: the mean of its specimens that take part. */
struct gsn_study_animal {
    const char *name;
    size_t cell; /* that it belongs to */
    double value[GSN_STUDY_MEASURES];
    double error[GSN_STUDY_MEASURES]; /* of that mean, as if specimens erred independently */
    double vector_error, section_error;
    size_t specimens;
};

/* A group at a time point. */
struct gsn_study_cell {
    const char *group;
    double week;
    int is_control;
    size_t first, count; /* of the animals */
    struct gsn_group_mean mean[GSN_STUDY_MEASURES];
    double error[GSN_STUDY_MEASURES]; /* root mean square of its animals' errors; NaN: not known */
    double vector_error, section_error; /* the same of those; 0: not known */
};

enum gsn_study_kind {
    GSN_STUDY_LOSS,      /* a group against its control */
    GSN_STUDY_TREATMENT, /* two groups that are both no control, or none is known */
};

/* Which part of the variance of a loss is whose; per cent squared, NaN where there is no loss. The
 * parts add up to total: measuring takes no more than all of the spread that is seen. Where no
 * error of measurement is known, its parts are NaN and the animals' hold them. */
struct gsn_study_share {
    double animals;     /* true spread, over the number of animals */
    double vectors;     /* dye vectors */
    double sections;    /* what each section errs by itself: cutting, registration, fit */
    double measurement; /* all other error of measurement: stain and white */
};

struct gsn_study_budget {
    double total;
    struct gsn_study_share treated, control;
};

struct gsn_study_comparison {
    enum gsn_study_kind kind;
    size_t measure;
    size_t a, b; /* cells; b is the control */
    int pooled;  /* b stands for the control of all time points, as there is none at this one */
    struct gsn_group_mean mean_a, mean_b;
    struct gsn_group_difference difference;
    struct gsn_group_loss loss; /* NaN for kind TREATMENT */
    double p_exact;             /* permutation; NaN: too few or too many animals */
    double p_least;             /* that permutation could reach */
    double
        p_holm; /* Welch's p, corrected over all comparisons of kind and measure, of all regions */
    struct gsn_study_budget budget;
};

/* A cell of the base mesh that two animals or more of either side have. */
struct gsn_study_loss_cell {
    struct gsn_base_address address;
    size_t treated, controls; /* animals that have it */
    double density, control;  /* means over them */
    double volume_um3;        /* of the treated, on average */
    struct gsn_group_loss loss;
    double p; /* Welch, two-sided */
    double q; /* the smallest share of false findings at which it is one: Benjamini and Hochberg
                 (1995), over the cells of this map */
};

/* Where a group lost collagen against its control. */
struct gsn_study_loss_map {
    size_t comparison;                /* of kind LOSS and measure 0 */
    struct gsn_study_loss_cell *cell; /* owned; count, in order of address */
    size_t count;
    double low, median, high; /* 5, 50, 95 % of the control's collagen lie where no more was lost */
    double lost, gained;      /* shares of it, 0..1, in cells that are told apart (q <= 0.05) */
};

struct gsn_study {
    struct gsn_study_input input; /* borrowed */
    struct gsn_study_animal *animal;
    size_t animal_count;
    struct gsn_study_cell *cell;
    size_t cell_count;
    struct gsn_study_comparison *comparison;
    size_t comparison_count;
    size_t shared_animals; /* names that occur in several groups: then groups are not independent */
    struct gsn_study **part; /* owned: the parts of the input, in its order */
    size_t part_count;
    struct gsn_study_loss_map
        *map; /* map_count; one a loss of which two animals a side have cells */
    size_t map_count;
};

void gsn_study_free(struct gsn_study *study);
GSN_DEFINE_AUTO(gsn_study);

/* gives: the analysis; input is borrowed as long as it lives. The order of the specimens does not
 * matter. Fails with GSN_E_NOMEM, GSN_E_INPUT without measures, and GSN_E_WITHHELD when specimens
 * of one group name several control groups. */
int gsn_study_analyse(const struct gsn_study_input *input, struct gsn_study **ret_study,
                      struct gsn_error *err);

/* What so few animals allow, and what they do not, in a sentence; writes "" when nothing is to be
 * said. */
void gsn_study_allows(const struct gsn_study_comparison *comparison, char *text, size_t room);

/* give: bytes, with a zero behind that is not counted. The same study gives the same bytes. Fail
 * with GSN_E_NOMEM. */
/* One row an animal, region and measure, RFC 4180, names in the first line; docs/user/study.md. */
int gsn_study_csv(const struct gsn_study *study, char **ret_bytes, size_t *ret_size,
                  struct gsn_error *err);
/* "gieson-study-1", docs/user/study.md. */
int gsn_study_json(const struct gsn_study *study, char **ret_bytes, size_t *ret_size,
                   struct gsn_error *err);
/* A row a cell of the base mesh and comparison; docs/user/study.md. */
int gsn_study_cells_csv(const struct gsn_study *study, char **ret_bytes, size_t *ret_size,
                        struct gsn_error *err);
/* One page that fetches nothing. */
int gsn_study_page(const struct gsn_study *study, char **ret_bytes, size_t *ret_size,
                   struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
