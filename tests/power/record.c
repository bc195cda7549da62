/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* record STORE FOLDER SESSIONS PICTURES: takes the pictures of the folder in so many sessions, each
 * with the store opened anew, and says to the recorder which are safe. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/power/ingest.h"
#include "tests/power/trace.h"

static void mark(void *context, const char *name, const char *sha256)
{
    char text[512];

    (void)context;
    (void)snprintf(text, sizeof text, "%s %s", sha256, name);
    if (power_mark)
        power_mark(text);
}

int main(int argc, char **argv)
{
    struct gsn_error err = { 0 };
    char address[4096];
    unsigned taken = 0;
    const int sessions = argc == 5 ? atoi(argv[3]) : 0;
    const unsigned pictures = argc == 5 ? (unsigned)atoi(argv[4]) : 0;

    if (sessions < 1)
        return 64;
    (void)snprintf(address, sizeof address, "replay:%s", argv[2]);
    for (int i = 1; i <= sessions; i++) {
        const struct power_ingest ingest = { .store = argv[1],
                                             .address = address,
                                             .most =
                                                 i < sessions ? pictures / (unsigned)sessions : 0,
                                             .checkpoint_every = 5,
                                             .acknowledged = mark };

        if (power_ingest(&ingest, &taken, &err) < 0) {
            fprintf(stderr, "%s\n", err.text);
            return 1;
        }
    }
    return 0;
}
