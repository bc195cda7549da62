/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Commands that we advise are there to be copied: behind `gieson` they name the store that they are
 * about, unless gieson opens that one by itself. A command stands in backquotes or is all of its
 * text; one that goes on with an option is whole as it is. */
#ifndef GSN_STORAGE_ADVICE_H
#define GSN_STORAGE_ADVICE_H

/* The store of who names none: GIESON_STORE, else that of the package's services. Borrowed; good
 * until the environment changes. */
const char *gsn_advice_usual_store(void);

/* gives: the text with --store STORE in its commands. store NULL or empty: as it is. NULL when
 * memory runs out. */
char *gsn_advice(const char *store, const char *text);

/* gives: a word of a shell's command line, quoted where it must be. NULL when memory runs out. */
char *gsn_advice_word(const char *text);

#endif
