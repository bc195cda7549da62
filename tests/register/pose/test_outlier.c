/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/pose/outlier.h"

#include "tests/check.h"
#include "tests/register/mounted.h"

#include "pipeline/core/distributions.h"
#include "pipeline/register/pose/weighted_fit.h"

#include <string.h>

static double length(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

/* Where a mark can only be wrong along one line, L is a function of one number: the test is that of
 * a single normal number, or of Student's t. */
TEST(along_one_line_it_is_the_test_of_one_number)
{
    static const double line[3] = { 0.48, -0.6, 0.64 };
    double off[GSN_FIDUCIALS][2][3] = { 0 }, left[3];

    for (int i = 0; i < 3; i++) {
        off[0][0][i] = 0.9 * line[i];
        off[2][1][i] = -0.4 * line[i];
        left[i] = 3.290527 * line[i];
    }
    CHECK_NEAR(gsn_outlier_false_alarm(left, off, INFINITY, 1), 1e-3, 1e-5);
    for (int i = 0; i < 3; i++)
        left[i] = 3.849516 * line[i]; /* two sides of t with 20 degrees of freedom */
    CHECK_NEAR(gsn_outlier_false_alarm(left, off, 20, 1), 1e-3, 1e-5);
}

/* A small mistake, alike in all directions, adds to L in proportion to |z|^2: chi-squared, or
 * Fisher's F. */
TEST(for_small_mistakes_in_all_directions_it_is_chi_squared)
{
    static const double off[GSN_FIDUCIALS][2][3] = { { { 1e-3, 0, 0 }, { 0, 1e-3, 0 } },
                                                     { { 0, 1e-3, 0 }, { 0, 0, 1e-3 } },
                                                     { { 0, 0, 1e-3 }, { 1e-3, 0, 0 } } };
    const double at = sqrt(16.26624 / 3), f = sqrt(12.5527);

    CHECK_NEAR(gsn_outlier_false_alarm((double[]){ at, -at, at }, off, INFINITY, 1), 1e-3, 1e-6);
    CHECK_NEAR(gsn_outlier_false_alarm((double[]){ f, f, f }, off, 10, 1), 1e-3, 1e-6);
    CHECK_NEAR(gsn_outlier_false_alarm((double[]){ 2 * f, 2 * f, 2 * f }, off, 10, 4), 1e-3, 1e-6);
    CHECK(gsn_outlier_false_alarm((double[]){ 0, 0, 0 }, off, INFINITY, 1) == 1);
}

/* One section of exact marks but for what `noise` times their standard deviations put them off. */
struct section {
    struct gsn_pose_fit_input input;
    struct gsn_pose_fit fit;
};

static struct gsn_cov2 cov_of(int mark, int alike)
{
    static const struct gsn_cov2 own[GSN_FIDUCIALS] = { { 100, 0, 100 },
                                                        { 900, -250, 150 },
                                                        { 60, 20, 80 } };

    return own[alike ? 0 : mark];
}

/* um along the first axis of a covariance's Cholesky factor, then along the second. */
static struct gsn_point along(struct gsn_cov2 v, double first, double second)
{
    const double xx = sqrt(v.xx), xy = v.xy / xx;

    return (struct gsn_point){ xx * first, xy * first + sqrt(v.yy - xy * xy) * second };
}

static void measure(struct section *s, int alike, const double off[GSN_FIDUCIALS][2])
{
    struct gsn_error err = { 0 };

    s->input = (struct gsn_pose_fit_input){ .count = GSN_FIDUCIALS };
    for (int m = 0; m < GSN_FIDUCIALS; m++) {
        const struct gsn_cov2 v = cov_of(m, alike);
        const struct gsn_point d = along(v, off[m][0], off[m][1]);

        s->input.about.x += mounted_marks[m].x / 3;
        s->input.about.y += mounted_marks[m].y / 3;
        s->input.onto[m] = mounted_marks[m];
        s->input.from[m] = (struct gsn_point){ mounted_marks[m].x + d.x, mounted_marks[m].y + d.y };
        s->input.cov[m] = v;
    }
    CHECK_OK(gsn_pose_fit(&s->input, &s->fit, &err), err);
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* The premises: |left|^2 is chi2, and a mark that is off by its own deviation adds `off` to left;
 * told by inner products, as the three numbers may be turned. The axes are those of the marks as
 * seen, and here the section is hardly turned. */
TEST(residuals_are_white_and_move_as_stated)
{
    static const double noise[GSN_FIDUCIALS][2] = { { 0.3, -1.2 }, { 0.8, 0.4 }, { -1.1, 0.2 } };
    struct section s;

    measure(&s, 0, noise);
    CHECK_NEAR(dot(s.fit.left, s.fit.left), s.fit.chi2, 1e-9);
    for (int wrong = 0; wrong < 2 * GSN_FIDUCIALS; wrong++) {
        const double *added = s.fit.off[wrong / 2][wrong % 2];
        double more[GSN_FIDUCIALS][2];
        struct section other;

        memcpy(more, noise, sizeof more);
        more[wrong / 2][wrong % 2] += 1;
        measure(&other, 0, more);
        CHECK(length(added) > 0.1);
        for (int k = 0; k < 2 * GSN_FIDUCIALS; k++)
            CHECK_NEAR(dot(other.fit.left, other.fit.off[k / 2][k % 2]),
                       dot(s.fit.left, s.fit.off[k / 2][k % 2]) +
                           dot(added, s.fit.off[k / 2][k % 2]),
                       0.01);
    }
}

struct tally {
    size_t clean, blamed, faults[GSN_FIDUCIALS], missed[GSN_FIDUCIALS], missed_by_chi2;
};

/* How the residuals come about does not matter once they are white: off says what a mark does. */
static void tally(struct tally *t, const double off[GSN_FIDUCIALS][2][3], double sigmas,
                  size_t clean, size_t faults, struct draw_chance *chance)
{
    for (size_t i = 0; i < clean + faults; i++) {
        const double way = draw_uniform(chance, 0, 2 * M_PI);
        const size_t mark = i % GSN_FIDUCIALS;
        double left[3];
        int gross;

        for (int k = 0; k < 3; k++)
            left[k] =
                draw_normal(chance) +
                (i < clean ? 0
                           : sigmas * (cos(way) * off[mark][0][k] + sin(way) * off[mark][1][k]));
        /* Nearer than this, not even a single side would be beyond its limit. */
        gross = pow(length(left), 2) > 10.82757 &&
                gsn_outlier_false_alarm(left, off, INFINITY, 1) < 1e-3;
        t->clean += i < clean;
        t->blamed += i < clean && gross;
        t->faults[mark] += i >= clean;
        t->missed[mark] += i >= clean && !gross;
        t->missed_by_chi2 += i >= clean && pow(length(left), 2) <= 16.26624;
    }
}

static size_t sum(const size_t n[GSN_FIDUCIALS])
{
    return n[0] + n[1] + n[2];
}

static void say(const struct tally *t)
{
    print_message("  %zu of %zu missed (%zu, %zu and %zu of each mark; by chi-squared %zu), %zu of "
                  "%zu clean blamed\n",
                  sum(t->missed), sum(t->faults), t->missed[0], t->missed[1], t->missed[2],
                  t->missed_by_chi2, t->blamed, t->clean);
}

static void check_false_alarms(const struct tally *t)
{
    const double expected = 1e-3 * (double)t->clean;

    CHECK(fabs((double)t->blamed - expected) <= 3 * sqrt(expected));
}

/* The phantom's triangle, marks alike: 99 % of those that are 12 standard deviations off. */
TEST(a_mark_twelve_sigma_off_is_found_in_99_of_100)
{
    const size_t trials = mounted_trials(10000);
    struct draw_chance chance = { 31 };
    struct tally t = { 0 }, eight = { 0 };
    struct section s;

    measure(&s, 1, (const double[GSN_FIDUCIALS][2]){ { 0 } });
    tally(&t, s.fit.off, 12, 100000, trials, &chance);
    say(&t);
    CHECK((double)sum(t.missed) <= 0.01 * (double)trials);
    CHECK(sum(t.missed) < t.missed_by_chi2);
    check_false_alarms(&t);
    tally(&eight, s.fit.off, 8, 0, trials / 5, &chance);
    say(&eight);
    CHECK((double)sum(eight.missed) < 1.1 * (double)eight.missed_by_chi2);
}

/* Whatever the marks' own covariances, strain and the triangle: one good section in a thousand. */
TEST(false_alarms_are_one_in_a_thousand_for_marks_of_any_covariance)
{
    struct draw_chance chance = { 32 };
    struct tally t = { 0 };
    struct section s;

    measure(&s, 0, (const double[GSN_FIDUCIALS][2]){ { 0 } });
    tally(&t, s.fit.off, 12, 100000, 0, &chance);
    say(&t);
    check_false_alarms(&t);
}
