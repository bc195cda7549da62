/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* EM mixture: log-normal classes, fitted by expectation-maximisation (Dempster, Laird and Rubin
 * 1977), and its scores by the stain vectors.
 *
 * An amount a seen with noise s enters as z = log((a + sqrt(a^2 + 4 s^2)) / 2), which is log a
 * where a is well above the noise and stays finite where noise made it negative (Rocke and Durbin
 * 2003, 10.1093/bioinformatics/btg107). The classes are normal in the three z; one pixel in a
 * hundred may be of none, so that pigment and ink do not pull.
 *
 *   1. start: thirds of the pixels by their share of red
 *   2. refit: each class claims a share of each pixel; weighted moments make the classes anew
 *   3. score: slopes of the log-likelihood by the six turns of the vectors, freed of what the
 *      classes could follow of them (outer products of the scores stand for the information)
 *   4. misfit: relative entropy between pixels and classes along nine directions
 *
 * A class that holds less than a hundredth of the pixels is dropped. All is linear in the pixels;
 * memory is two matrices of 35 unknowns. */
#include "pipeline/stain/mixture.h"

#include "pipeline/core/linalg.h"

#include <math.h>
#include <string.h>

#define STRAY 0.01            /* share of pixels that may be of no class */
#define STRAY_VOLUME 27.0     /* they lie anywhere up to density 3 in each channel */
#define LEAST_VARIANCE 0.0009 /* of a logarithm: 3 %, finer than any tissue is even */
#define LOG_2PI 1.8378770664093453

/* ---- one pixel --------------------------------------------------------------------------- */

/* A pixel through the vectors: amounts, their noise, and their logarithms. */
struct seen {
    double amount[3], z[3];
    double root[3];      /* sqrt(a^2 + 4 s^2) */
    double noise[3][3];  /* covariance of the amounts */
    double log_jacobian; /* of z by the densities */
};

static void see_pixel(const struct gsn_stain_pixel *pixel, const struct gsn_dyes_inverse *optics,
                      struct seen *ret)
{
    const double(*w)[3] = optics->inverse;
    double product = 1;

    for (int k = 0; k < 3; k++) {
        double a = 0;

        for (int c = 0; c < 3; c++)
            a += w[k][c] * (double)pixel->od[c];
        for (int m = 0; m <= k; m++) {
            double s = 0;

            for (int c = 0; c < 3; c++)
                s += w[k][c] * w[m][c] * (double)pixel->noise[c] * (double)pixel->noise[c];
            ret->noise[k][m] = ret->noise[m][k] = s;
        }
        const double root = sqrt(a * a + 4 * ret->noise[k][k]);

        ret->amount[k] = a;
        ret->root[k] = root;
        /* The second form keeps its digits where a is far below 0. */
        ret->z[k] = log(a > 0 ? (a + root) / 2 : 2 * ret->noise[k][k] / (root - a));
        product *= root;
    }
    ret->log_jacobian = -log(product) - optics->log_det;
}

/* What each class says: pull is precision (z - mean), weight the share of the pixel it claims. */
struct claim {
    double weight[GSN_MIXTURE_CLASSES], pull[GSN_MIXTURE_CLASSES][3];
    double log_density;
};

static void claim_pixel(const struct gsn_mixture *classes, const struct seen *seen,
                        struct claim *ret)
{
    double stray = STRAY / STRAY_VOLUME, sum = stray;

    for (size_t j = 0; j < classes->count; j++) {
        const struct gsn_mixture_class *class = &classes->class[j];
        double u[3], square = 0;

        for (int k = 0; k < 3; k++)
            u[k] = seen->z[k] - class->mean[k];
        for (int k = 0; k < 3; k++) {
            ret->pull[j][k] = class->precision[k][0] * u[0] + class->precision[k][1] * u[1] +
                              class->precision[k][2] * u[2];
            square += ret->pull[j][k] * u[k];
        }
        ret->weight[j] = (1 - STRAY) * exp(class->log_norm - square / 2 + seen->log_jacobian);
        sum += ret->weight[j];
    }
    for (size_t j = 0; j < classes->count; j++)
        ret->weight[j] /= sum;
    ret->log_density = log(sum);
}

/* ---- classes ----------------------------------------------------------------------------- */

struct moments {
    double sum, first[3], second[3][3];
};

static void add_moments(struct moments *m, double weight, const double z[3])
{
    m->sum += weight;
    for (int k = 0; k < 3; k++) {
        m->first[k] += weight * z[k];
        for (int l = 0; l <= k; l++)
            m->second[k][l] += weight * z[k] * z[l];
    }
}

static void set_class(const struct moments *m, double all, struct gsn_mixture_class *class)
{
    double covariance[3][3], l[3][3], log_det = 0;

    class->share = m->sum / all;
    for (int k = 0; k < 3; k++)
        class->mean[k] = m->first[k] / m->sum;
    for (int k = 0; k < 3; k++)
        for (int n = 0; n <= k; n++)
            covariance[k][n] = covariance[n][k] = m->second[k][n] / m->sum -
                                                  class->mean[k] * class->mean[n] +
                                                  (k == n ? LEAST_VARIANCE : 0);
    memcpy(l, covariance, sizeof l);
    (void)gsn_cholesky(&l[0][0], 3, 3); /* LEAST_VARIANCE keeps it definite */
    for (int k = 0; k < 3; k++)
        log_det += 2 * log(l[k][k]);
    memcpy(class->precision, covariance, sizeof covariance);
    (void)gsn_invert_spd(&class->precision[0][0], 3, 3);
    class->log_norm = log(class->share) - 1.5 * LOG_2PI - log_det / 2;
}

/* A class of less than this share of the pixels has no shape of its own any more. */
static const double LEAST_SHARE = 0.01;

static void set_classes(const struct moments m[GSN_MIXTURE_CLASSES], size_t pixels,
                        struct gsn_mixture *classes)
{
    double all = 0;
    size_t kept = 0;

    for (size_t j = 0; j < classes->count; j++)
        all += m[j].sum;
    for (size_t j = 0; j < classes->count; j++)
        if (m[j].sum > LEAST_SHARE * all)
            set_class(&m[j], all, &classes->class[kept++]);
    classes->count = kept;
    classes->strays = 1 - all / (double)pixels;
}

/* Classes to begin with: thirds of the pixels by their share of red. */
void gsn_mixture_start(struct gsn_mixture *classes, size_t count,
                       const struct gsn_stain_sample *sample, const struct gsn_dyes_inverse *optics)
{
    enum { SHARES = 256 };
    size_t bin[SHARES] = { 0 }, below = 0;
    struct moments m[GSN_MIXTURE_CLASSES] = { { 0 } };
    size_t class_of[SHARES];
    struct seen seen;

    classes->count = count;
    for (int pass = 0; pass < 2; pass++) {
        for (size_t i = 0; i < sample->count; i++) {
            see_pixel(&sample->pixel[i], optics, &seen);
            const double share = 1 / (1 + exp(seen.z[1] - seen.z[0]));
            const size_t at = (size_t)fmin(share * SHARES, SHARES - 1);

            if (pass == 0)
                bin[at]++;
            else
                add_moments(&m[class_of[at]], 1, seen.z);
        }
        for (size_t i = 0; i < SHARES && pass == 0; i++) {
            class_of[i] = below * classes->count / sample->count;
            below += bin[i];
        }
    }
    set_classes(m, sample->count, classes);
}

void gsn_mixture_refit(struct gsn_mixture *classes, const struct gsn_stain_sample *sample,
                       const struct gsn_dyes_inverse *optics)
{
    struct moments m[GSN_MIXTURE_CLASSES] = { { 0 } };

    for (size_t i = 0; i < sample->count; i++) {
        struct seen seen;
        struct claim of;

        see_pixel(&sample->pixel[i], optics, &seen);
        claim_pixel(classes, &seen, &of);
        for (size_t j = 0; j < classes->count; j++)
            add_moments(&m[j], of.weight[j], seen.z);
    }
    set_classes(m, sample->count, classes);
}

double gsn_mixture_likelihood(const struct gsn_mixture *classes,
                              const struct gsn_stain_sample *sample,
                              const struct gsn_dyes_inverse *optics)
{
    double sum = 0;

    for (size_t i = 0; i < sample->count; i++) {
        struct seen seen;
        struct claim of;

        see_pixel(&sample->pixel[i], optics, &seen);
        claim_pixel(classes, &seen, &of);
        sum += of.log_density;
    }
    return sum;
}

/* ---- scores ------------------------------------------------------------------------------ */

/* Slopes of one pixel's log-likelihood. A vector that moves by dv changes amount k by
 * -(inverse[k] . dv) times its own amount, and the noises likewise. */
static void score_turns(const struct gsn_mixture *classes, const struct seen *seen,
                        const struct claim *of, const struct gsn_dyes_inverse *optics, double *ret)
{
    double pull[3] = { 0 }, claimed = 0;

    for (size_t j = 0; j < classes->count; j++) {
        claimed += of->weight[j];
        for (int k = 0; k < 3; k++)
            pull[k] += of->weight[j] * of->pull[j][k];
    }
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++) {
        const int moving = m / 2;
        double sum = 0;

        for (int k = 0; k < 3; k++) {
            const double *w = optics->inverse[k], *dv = optics->slope[m];
            const double along = w[0] * dv[0] + w[1] * dv[1] + w[2] * dv[2];
            const double da = -along * seen->amount[moving];
            const double ds2 = -2 * along * seen->noise[k][moving];
            const double a = seen->amount[k], h = seen->root[k];
            const double s2 = seen->noise[k][k];
            /* 1 / (a + h) without cancellation */
            const double over = a > 0 ? 1 / (a + h) : (h - a) / (4 * s2);
            const double dz = da / h + 2 * over * ds2 / h;
            const double dlog_h = (a * da + 2 * ds2) / (h * h);

            sum -= pull[k] * dz + claimed * dlog_h;
            if (k == moving)
                sum -= claimed * along;
        }
        ret[m] = sum;
    }
}

static void score_classes(const struct gsn_mixture *classes, const struct claim *of, double *ret)
{
    const size_t last = classes->count - 1;

    for (size_t j = 0; j < classes->count; j++) {
        const struct gsn_mixture_class *class = &classes->class[j];
        const double *pull = of->pull[j];

        for (int k = 0; k < 3; k++)
            *ret++ = of->weight[j] * pull[k];
        for (int k = 0; k < 3; k++)
            for (int n = 0; n <= k; n++)
                *ret++ = of->weight[j] * (pull[k] * pull[n] - class->precision[k][n]);
        if (j < last)
            *ret++ = of->weight[j] / class->share - of->weight[last] / classes->class[last].share;
    }
}

size_t gsn_mixture_unknowns(const struct gsn_mixture *classes)
{
    return classes->count * 9 + classes->count - 1;
}

/* Frees the turns' slopes of what the classes could follow of them:
 * outer[turn][class] outer[class][class]^-1. */
static void free_of_classes(size_t unknowns, const double *slope, struct gsn_mixture_scores *s)
{
    double a[GSN_MIXTURE_UNKNOWNS * GSN_MIXTURE_UNKNOWNS], follow[GSN_MIXTURE_UNKNOWNS];
    const size_t base = GSN_DYE_ROTATIONS;
    int definite;

    for (size_t i = 0; i < unknowns; i++)
        for (size_t j = 0; j < unknowns; j++)
            a[i * unknowns + j] = s->outer[base + i][base + j] * (i == j ? 1 + 1e-9 : 1);
    definite = gsn_cholesky(a, unknowns, unknowns) == 0;
    for (size_t m = 0; m < GSN_DYE_ROTATIONS; m++) {
        for (size_t i = 0; i < unknowns; i++)
            follow[i] = definite ? s->outer[m][base + i] : 0;
        if (definite)
            gsn_cholesky_solve(a, unknowns, unknowns, follow);
        s->total[m] = slope[m];
        for (size_t i = 0; i < unknowns; i++)
            s->total[m] -= follow[i] * slope[base + i];
        for (size_t n = 0; n < GSN_DYE_ROTATIONS; n++) {
            s->information[m][n] = s->outer[m][n];
            for (size_t i = 0; i < unknowns; i++)
                s->information[m][n] -= follow[i] * s->outer[n][base + i];
        }
    }
}

void gsn_mixture_score(const struct gsn_mixture *classes, const struct gsn_stain_sample *sample,
                       const struct gsn_dyes_inverse *optics, struct gsn_mixture_scores *ret_scores)
{
    const size_t all = GSN_DYE_ROTATIONS + gsn_mixture_unknowns(classes);
    double slope[GSN_SCORE_UNKNOWNS] = { 0 };

    memset(ret_scores->outer, 0, sizeof ret_scores->outer);
    for (size_t i = 0; i < sample->count; i++) {
        double score[GSN_SCORE_UNKNOWNS];
        struct seen seen;
        struct claim of;

        see_pixel(&sample->pixel[i], optics, &seen);
        claim_pixel(classes, &seen, &of);
        score_turns(classes, &seen, &of, optics, score);
        score_classes(classes, &of, score + GSN_DYE_ROTATIONS);
        for (size_t m = 0; m < all; m++) {
            slope[m] += score[m];
            for (size_t n = 0; n <= m; n++)
                ret_scores->outer[m][n] += score[m] * score[n];
        }
    }
    for (size_t m = 0; m < all; m++)
        for (size_t n = 0; n < m; n++)
            ret_scores->outer[n][m] = ret_scores->outer[m][n];
    free_of_classes(gsn_mixture_unknowns(classes), slope, ret_scores);
}

/* ---- misfit ------------------------------------------------------------------------------ */

enum { BINS = 16 };

/* The classes along one direction: normals in one dimension. */
struct along {
    double mean[GSN_MIXTURE_CLASSES], deviation[GSN_MIXTURE_CLASSES];
};

static void look_along(const struct gsn_mixture *classes, const double way[3], struct along *ret)
{
    for (size_t j = 0; j < classes->count; j++) {
        const struct gsn_mixture_class *class = &classes->class[j];
        double covariance[3][3], variance = 0;

        memcpy(covariance, class->precision, sizeof covariance);
        (void)gsn_invert_spd(&covariance[0][0], 3, 3);
        ret->mean[j] = 0;
        for (int k = 0; k < 3; k++) {
            ret->mean[j] += way[k] * class->mean[k];
            for (int n = 0; n < 3; n++)
                variance += way[k] * way[n] * covariance[k][n];
        }
        ret->deviation[j] = sqrt(variance);
    }
}

/* Share of the classes that lies below. */
static double share_below(const struct gsn_mixture *classes, const struct along *along, double z)
{
    double below = 0;

    for (size_t j = 0; j < classes->count; j++)
        below += classes->class[j].share *
                 erfc((along->mean[j] - z) / along->deviation[j] * M_SQRT1_2) / 2;
    return below;
}

/* Of pixels in bins that should all hold the same; less what chance makes of that. */
static double relative_entropy(const size_t bin[BINS], size_t all)
{
    double sum = -(BINS - 1) / (2.0 * (double)all);

    for (int b = 0; b < BINS; b++)
        if (bin[b] > 0)
            sum += (double)bin[b] / (double)all * log((double)bin[b] * BINS / (double)all);
    return sum;
}

double gsn_mixture_misfit(const struct gsn_mixture *classes, const struct gsn_stain_sample *sample,
                          const struct gsn_dyes_inverse *optics)
{
    /* Each amount, how two go together, and how they go against each other. */
    static const double way[][3] = { { 1, 0, 0 },  { 0, 1, 0 },  { 0, 0, 1 },
                                     { 1, 1, 0 },  { 1, -1, 0 }, { 1, 0, 1 },
                                     { 1, 0, -1 }, { 0, 1, 1 },  { 0, 1, -1 } };
    enum { WAYS = sizeof way / sizeof way[0] };
    struct along along[WAYS];
    size_t bin[WAYS][BINS] = { { 0 } };
    double worst = 0;

    for (int w = 0; w < WAYS; w++)
        look_along(classes, way[w], &along[w]);
    for (size_t i = 0; i < sample->count; i++) {
        struct seen seen;

        see_pixel(&sample->pixel[i], optics, &seen);
        for (int w = 0; w < WAYS; w++) {
            const double z = way[w][0] * seen.z[0] + way[w][1] * seen.z[1] + way[w][2] * seen.z[2];

            bin[w][(size_t)fmin(share_below(classes, &along[w], z) * BINS, BINS - 1)]++;
        }
    }
    for (int w = 0; w < WAYS; w++)
        worst = fmax(worst, relative_entropy(bin[w], sample->count));
    return worst;
}
