/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Values of job.json under their keys, checked: text, numbers, words. Where nothing else is said,
 * what is absent leaves the answer as it is, and what is wrong fails with GSN_E_INPUT, naming the
 * key and what is allowed. */
#ifndef GSN_PIPELINE_STATED_VALUE_H
#define GSN_PIPELINE_STATED_VALUE_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct json_t;

/* Says what the key must be. */
int gsn_stated_bad(struct gsn_error *err, const char *key, const char *wanted);
/* gives: text, "" when the key is absent. Fails with GSN_E_NOMEM too. */
int gsn_stated_text(const struct json_t *job, const char *key, char **text, struct gsn_error *err);
int gsn_stated_number(const struct json_t *job, const char *key, double low, double high,
                      double *number, struct gsn_error *err);
int gsn_stated_count(const struct json_t *job, const char *key, unsigned most, unsigned *count,
                     struct gsn_error *err);
/* One of several words, of which there are two at least, with NULL behind the last. */
int gsn_stated_word(const struct json_t *job, const char *key, const char *const *words,
                    int *chosen, struct gsn_error *err);
/* Exactly count finite numbers; else -1, and nothing is said. */
int gsn_stated_numbers(const struct json_t *array, size_t count, double *numbers);

#ifdef __cplusplus
}
#endif
#endif
