/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/phantom/plan.h"

#include <string.h>

/* One line of the table. A loss is proportional to the depth of the lesion, and 44.873 % at A = 1;
 * a control of the study has none, but bone of its own density. */
#define LOSS(percent) ((percent) / 44.873)
#define WHOLE(name, group, animal, depth, red, yellow, draws, baseline)                            \
    {                                                                                              \
        name, group, animal, 8, depth, red, yellow, draws, baseline, 60, 1, 16                     \
    }
#define CONTROL(name, gain, draws)                                                                 \
    {                                                                                              \
        name, "N", name, 8, 0, 1, 1, draws, NULL, 36, gain, 24                                     \
    }
#define TREATED(name, group, week, percent, draws)                                                 \
    {                                                                                              \
        name, group, name, week, LOSS(percent), 1, 1, draws, "N", 36, 1, 24                        \
    }

/* S03 and S04 are the block, the cuts and the grain of S02 in another stain. */
static const struct gsn_phantom_specimen SPECIMEN[GSN_PHANTOM_SPECIMENS] = {
    WHOLE("S00", "N", "N1", 0, 1, 1, 0, NULL),
    WHOLE("S01", "S", "S1", .3698, 1, 1, 1, GSN_PHANTOM_STUDY "-S00"),
    WHOLE("S02", "U", "U1", .8153, 1, 1, 2, GSN_PHANTOM_STUDY "-S00"),
    WHOLE("S03", "U", "U2", .8153, 1.15, 1.15, 2, GSN_PHANTOM_STUDY "-S00"),
    WHOLE("S04", "U", "U3", .8153, .85, 1.20, 2, GSN_PHANTOM_STUDY "-S00"),
    CONTROL("N1", .980, 10),
    CONTROL("N2", .993, 11),
    CONTROL("N3", 1.008, 12),
    CONTROL("N4", 1.019, 13),
    TREATED("S1", "S", 8, 13.5, 14),
    TREATED("S2", "S", 8, 15.7, 15),
    TREATED("S3", "S", 8, 17.8, 16),
    TREATED("S4", "S", 8, 19.4, 17),
    TREATED("U1", "U", 8, 32.2, 18),
    TREATED("U2", "U", 8, 35.3, 19),
    TREATED("U3", "U", 8, 38.1, 20),
    TREATED("U4", "U", 8, 40.8, 21),
    TREATED("T2", "T", 2, 18, 22),
    TREATED("T4", "T", 4, 27, 23),
    TREATED("T8", "T", 8, 36.6, 24),
};

const struct gsn_phantom_specimen *gsn_phantom_specimen_at(int i)
{
    return i >= 0 && i < GSN_PHANTOM_SPECIMENS ? &SPECIMEN[i] : NULL;
}

const struct gsn_phantom_specimen *gsn_phantom_specimen_find(const char *name)
{
    static const char prefix[] = GSN_PHANTOM_STUDY "-";

    if (strncmp(name, prefix, sizeof prefix - 1) == 0)
        name += sizeof prefix - 1;
    for (int i = 0; i < GSN_PHANTOM_SPECIMENS; i++)
        if (strcmp(SPECIMEN[i].name, name) == 0)
            return &SPECIMEN[i];
    return NULL;
}
