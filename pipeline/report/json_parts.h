/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What report.json is written of; for its files alone. jansson takes NULL for a value kindly, so
 * that a failure anywhere is looked at once, at the end. */
#ifndef GSN_REPORT_JSON_PARTS_H
#define GSN_REPORT_JSON_PARTS_H

#include "pipeline/report/report.h"

#include <jansson.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_json_writer {
    int failed;
    int code; /* of a failure that has its own sentence; 0: memory ran out */
};

/* json_value.c */

/* takes: value. */
void gsn_json_put(struct gsn_json_writer *writer, json_t *object, const char *key, json_t *value);
void gsn_json_append(struct gsn_json_writer *writer, json_t *array, json_t *value);
json_t *gsn_json_text(const char *said);
json_t *gsn_json_text_or_null(const char *said);
/* NaN is a figure that does not exist. Minus zero is zero. */
json_t *gsn_json_number(double value);
json_t *gsn_json_count(size_t count);
json_t *gsn_json_numbers(const double *values, size_t count, struct gsn_json_writer *writer);
json_t *gsn_json_texts(const char *const *said, size_t count, struct gsn_json_writer *writer);

/* json_sections.c */

json_t *gsn_json_sections(const struct gsn_report *report, struct gsn_json_writer *writer);

/* json_figures.c; null where there are none */

json_t *gsn_json_region(const struct gsn_report_region *region, struct gsn_json_writer *writer);
json_t *gsn_json_volumes(const struct gsn_report *report, struct gsn_json_writer *writer);
json_t *gsn_json_registration(const struct gsn_report_registration *done,
                              struct gsn_json_writer *writer);
json_t *gsn_json_fit(const struct gsn_report_fit *fit, struct gsn_json_writer *writer);
json_t *gsn_json_units(const struct gsn_report_units *units, struct gsn_json_writer *writer);
json_t *gsn_json_tile(const struct gsn_report_tile *tile, struct gsn_json_writer *writer);

#ifdef __cplusplus
}
#endif
#endif
