/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What each verb is for: one page a verb, with an example that can be typed. */
#ifndef GSN_UI_HELP_H
#define GSN_UI_HELP_H

#include <stddef.h>

struct gsn_help {
    const char *verb;
    const char *arguments; /* behind the verb */
    const char *what;      /* sentences */
    const char *options;   /* a line each, or "" */
    const char *example;   /* a line each */
};

/* The page of a verb; NULL: there is no such verb. */
const struct gsn_help *gsn_help_of(const char *verb);
/* The verb that this was meant to be; NULL: none is near. */
const char *gsn_help_nearest(const char *verb);
/* Prints the page. */
void gsn_help_print(const struct gsn_help *help);

#endif
