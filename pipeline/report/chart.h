/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The drawings of the page, as SVG written into it. Colours and fonts are the style sheet's
 * (classes), so that they follow the light and the dark scheme; each has a title for readers that
 * do not see. */
#ifndef GSN_REPORT_CHART_H
#define GSN_REPORT_CHART_H

#include "pipeline/report/report.h"
#include "pipeline/report/text.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How far each mark of each section lies from where the common triangle wants it. */
void gsn_chart_residuals(struct gsn_report_text *text, const struct gsn_report *report);
/* How many micro-units have which density; report->units is not NULL. */
void gsn_chart_densities(struct gsn_report_text *text, const struct gsn_report_units *units);
/* The mean density of the baseline and of this specimen as two bars, 0..1. */
void gsn_chart_loss(struct gsn_report_text *text, double baseline, double specimen);

/* One figure of many specimens by the day. */
struct gsn_chart_dot {
    int64_t when; /* s since 1970 */
    double value; /* NaN: not drawn */
    const char *name;
};
/* One dot each, and their median as a line. what: the figure's name. Draws nothing where there are
 * fewer than two values. */
void gsn_chart_days(struct gsn_report_text *text, const char *what, const char *unit,
                    const struct gsn_chart_dot *dot, size_t count);

/* The step of 1, 2 or 5 times a power of ten that cuts a range > 0 into at most so many parts. */
double gsn_chart_step(double range, unsigned parts);

#ifdef __cplusplus
}
#endif
#endif
