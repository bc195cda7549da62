/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a scan's name says about the panel it shows. */
#ifndef GSN_STORAGE_PANEL_NAME_H
#define GSN_STORAGE_PANEL_NAME_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The panel number in a file name: the last number that is called a panel ("P03", "panel 3"), else
 * the last number at all; 0 when there is none or it is beyond 10000. The first skip bytes and the
 * extension are not read. */
unsigned gsn_panel_number(const char *name, size_t skip);

/* The same, but only a number that is called a panel: cameras count their pictures in names, and
 * that count is no panel's number. */
unsigned gsn_panel_number_called(const char *name, size_t skip);

#ifdef __cplusplus
}
#endif
#endif
