/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The front page of a store: every specimen of every study on one page, what needs a person first.
 *
 * It is a list to look things up in, not a result: what groups and losses of many animals mean is
 * on the pages of the studies (study.h). */
#ifndef GSN_STUDY_INDEX_PAGE_H
#define GSN_STUDY_INDEX_PAGE_H

#include "pipeline/study/study.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A study and where its page lies, from the front page. */
struct gsn_index_study {
    const struct gsn_study_input *input; /* the name may be empty: specimens of no study */
    const char *page;                    /* NULL: it has none */
};

/* gives: one page that fetches nothing and runs nothing; the same studies give the same bytes.
 * Links to reports are those of the records, from the folder the page lies in. Fails with
 * GSN_E_NOMEM. */
int gsn_index_page(const struct gsn_index_study *study, size_t count, const char *version,
                   char **ret_bytes, size_t *ret_size, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
