/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Ways to call spots of one section its marks: what each is worth, and which of them it is. For the
 * mark_*.c that choose, alone. */
#ifndef GSN_REGISTER_MARK_CHOICE_H
#define GSN_REGISTER_MARK_CHOICE_H

#include "pipeline/register/mark_odds.h"
#include "pipeline/register/markers.h"
#include "pipeline/register/rigid.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A tear or a fold moves a mark by some tenths of the triangle's size, in some sections in a
 * hundred: this many times the stretch of the others. Believed only of spots that look like marks;
 * of two, hardly, since other sides of the triangle are as long. */
#define GSN_MARK_TORN 6.0
#define GSN_MARK_TORN_PAIR 1.5
/* A second choice with more than this share of the first's likelihood makes both worthless. */
#define GSN_MARK_RUNNER_UP_MOST 0.5
/* A spot must be a mark, and none that lies there by chance, with these odds. */
#define GSN_MARK_ODDS_LEAST 20.0

enum { GSN_MARK_CHOICES = 128 };

/* One way to call candidates marks. */
struct gsn_mark_choice {
    int candidate[GSN_MARKS]; /* index, or -1: this mark is not there */
    int mirrored;
    double over_none;  /* likelihood over that of a section without marks, tissue left aside */
    double likelihood; /* the same, with what the tissue says */
    int trusted;       /* nothing about it is beyond what happens to marks */
    int rivalled;      /* three others are marks with a chance that matters */
    int folded;        /* a pair of another length than two marks have */
    struct gsn_rigid motion;
    double unlike; /* the tissue, laid so */
};

/* The likeliest choices of one section. */
struct gsn_mark_choices {
    size_t count;
    struct gsn_mark_choice item[GSN_MARK_CHOICES];
};

/* mark_weigh.c: one choice by its marks alone. */

/* How far the sections of the stack move their marks. The caller guarantees that the prior is
 * learnt. */
struct gsn_mark_moves gsn_mark_choice_moves(const struct gsn_mark_candidates *section,
                                            const struct gsn_triangle_prior *prior);

/* Lays the choice and weighs it; torn_pair: how many tolerances a pair may be too short or too
 * long. 0: it is beyond what happens to marks, or one of three lies there by chance. */
int gsn_mark_choice_weigh(const struct gsn_mark_candidates *section,
                          const struct gsn_triangle_prior *prior, double torn_pair,
                          struct gsn_mark_choice *choice);
int gsn_mark_choice_is_triple(const struct gsn_mark_choice *choice);
/* Whether nothing tore or folded: the marks lie as far apart as sections stretch. */
int gsn_mark_choice_lies_well(const struct gsn_mark_candidates *section,
                              const struct gsn_triangle_prior *prior,
                              const struct gsn_mark_choice *choice);

/* mark_choose.c: how much likelier the section has three marks, anywhere, than none; without what
 * the tissue says. */
double gsn_mark_choices_over_none(const struct gsn_mark_candidates *section,
                                  const struct gsn_triangle_prior *prior);

/* mark_choices.c: all of a section. fine: 1 for each candidate that may be a mark. */

/* Of more than there is room for, the likeliest stay. */
void gsn_mark_choices_keep(struct gsn_mark_choices *choices, const struct gsn_mark_choice *choice);
void gsn_mark_choices_add_triples(const struct gsn_mark_candidates *section,
                                  const struct gsn_triangle_prior *prior, const int *fine,
                                  struct gsn_mark_choices *choices);
void gsn_mark_choices_add_pairs(const struct gsn_mark_candidates *section,
                                const struct gsn_triangle_prior *prior, const int *fine,
                                double torn_pair, struct gsn_mark_choices *choices);

/* mark_decide.c: one against another, by the tissue that each lays. */

/* Whether both call the same spots marks, whatever their numbers. */
int gsn_mark_choice_same_spots(const struct gsn_mark_choice *a, const struct gsn_mark_choice *b);
/* Notes how unlike the others' tissue this one's is. */
void gsn_mark_choice_look(const struct gsn_mark_candidates *section,
                          const struct gsn_triangle_prior *prior, struct gsn_mark_choice *choice);
/* Odds for a way that lays the tissue so unlike, against another one. */
double gsn_mark_picture_odds(double unlike, double other);
void gsn_mark_choices_ask_picture(const struct gsn_mark_candidates *section,
                                  const struct gsn_triangle_prior *prior,
                                  struct gsn_mark_choices *choices);
void gsn_mark_choices_ask_centre(const struct gsn_mark_candidates *section,
                                 const struct gsn_triangle_prior *prior,
                                 struct gsn_mark_choices *choices);
/* The winner, and the likelihood of the best that contradicts it. triple: all are of three. */
struct gsn_mark_choice gsn_mark_choices_decide(const struct gsn_mark_choices *choices, int triple,
                                               double *ret_runner_up);

#ifdef __cplusplus
}
#endif
#endif
