/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Values of the JSON that we write, over jansson, which takes NULL for a value kindly: a failure
 * anywhere is noted in the writer and looked at once, at the end. */
#ifndef GSN_REPORT_JSON_H
#define GSN_REPORT_JSON_H

#include <jansson.h>
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_json_writer {
    int failed;
    int code; /* of a failure that has its own sentence; 0: memory ran out */
};

/* takes: value. */
void gsn_json_put(struct gsn_json_writer *writer, json_t *object, const char *key, json_t *value);
void gsn_json_append(struct gsn_json_writer *writer, json_t *array, json_t *value);

/* give. A text may hold anything: wrong bytes become U+FFFD. */
json_t *gsn_json_text(const char *said);
json_t *gsn_json_text_or_null(const char *said);
/* NaN is a figure that does not exist: null. Minus zero is zero. */
json_t *gsn_json_figure(double value);
json_t *gsn_json_count(size_t count);
json_t *gsn_json_figures(const double *values, size_t count, struct gsn_json_writer *writer);
json_t *gsn_json_texts(const char *const *said, size_t count, struct gsn_json_writer *writer);

#ifdef __cplusplus
}
#endif
#endif
