/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* `gieson-work register`: a plain folder of section pictures, as poses on stdout. */
#ifndef GSN_SYSTEMD_REGISTER_FOLDER_H
#define GSN_SYSTEMD_REGISTER_FOLDER_H

#include "pipeline/core/error.h"

struct gsn_decoder; /* pipeline/decode/apart.h */

struct gsn_register_request {
    const char *dir;
    const char *marks; /* six numbers, or NULL */
    const char *px_um; /* numbers as given, or NULL */
    const char *radius;
    int by_tissue;
    int json;
};

/* Prints the poses. Returns the exit status: that of the mistake whose sentence is in err, or 65
 * when a picture has no pose. */
int gsn_register_folder(const struct gsn_register_request *request, struct gsn_decoder *decoder,
                        struct gsn_error *err);

#endif
