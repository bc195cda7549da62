/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A reader of codes in place of the product's, for drawn panels, on which nothing is printed: it
 * reads one code on every picture, or fails on every picture, and counts how often it is asked. A
 * program that links this has no other. */
#ifndef GSN_TESTS_SPECIMEN_DRAWN_LABEL_H
#define GSN_TESTS_SPECIMEN_DRAWN_LABEL_H

/* From now on every picture shows the code of a panel that was fed like this (drawn_panel.h), and
 * nobody has asked yet. */
void drawn_label_lies(int mirrored, int quarters);

/* From now on no code can be read. */
void drawn_label_fails(void);

/* How often the reader was asked since drawn_label_lies(). */
unsigned drawn_label_asked(void);

#endif
