/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/device/sim_faults.h"

#include <stdlib.h>
#include <string.h>

/* A member of one of the structs; its width says what it is. */
struct member {
    const char *name;
    size_t at, size;
};

#define PTP(name)                                                                                  \
    {                                                                                              \
#name, offsetof(struct ptp_faults, name), sizeof((struct ptp_faults *)0)->name             \
    }
#define UVC(name)                                                                                  \
    {                                                                                              \
#name, offsetof(struct uvc_faults, name), sizeof((struct uvc_faults *)0)->name             \
    }

static const struct member ptp_members[] = {
    PTP(merge_response),
    PTP(split_header),
    PTP(leftover_zlp),
    PTP(no_zlp),
    PTP(short_reads),
    PTP(stall_at),
    PTP(stall_every),
    PTP(short_data_at),
    PTP(wrong_id_at),
    PTP(late_at),
    PTP(late_ms),
    PTP(silent_at),
    PTP(lying_length_at),
    PTP(unplug_at_byte),
    PTP(info_needs_session),
    PTP(no_list_of_all),
    PTP(no_storage_ids),
    PTP(closed_storage),
    PTP(measures_once),
    PTP(session_stays_open),
    PTP(new_handles),
    PTP(no_partial),
    PTP(no_partial64),
    PTP(no_properties),
    PTP(no_delete),
    PTP(busy_count),
    PTP(crash_above),
    PTP(bad_object),
    PTP(no_events),
    PTP(hidden_events),
    PTP(size_zero_first),
    PTP(changed_flood),
    PTP(wrong_event_handle),
};

static const struct member uvc_members[] = {
    UVC(stall_at),       UVC(silent_after),     UVC(short_frame_at), UVC(error_at),
    UVC(unplug_at_byte), UVC(always_automatic), UVC(forgets_gain),
};

static int set(const char *text, const struct member *members, size_t count, void *faults)
{
    const char *const equals = strchr(text, '=');
    unsigned long long value;
    char *end;

    if (!equals)
        return -1;
    value = strtoull(equals + 1, &end, 0);
    if (end == equals + 1 || *end)
        return -1;
    for (size_t i = 0; i < count; i++) {
        const size_t length = strlen(members[i].name);
        uint8_t *const to = (uint8_t *)faults + members[i].at;

        if (length != (size_t)(equals - text) || memcmp(text, members[i].name, length) != 0)
            continue;
        if (members[i].size == sizeof(bool))
            memcpy(to, &(bool){ value != 0 }, sizeof(bool));
        else if (members[i].size == sizeof(unsigned))
            memcpy(to, &(unsigned){ (unsigned)value }, sizeof(unsigned));
        else
            memcpy(to, &(uint64_t){ value }, sizeof(uint64_t));
        return 0;
    }
    return -1;
}

int sim_ptp_fault(const char *text, struct ptp_faults *faults)
{
    return set(text, ptp_members, sizeof ptp_members / sizeof *ptp_members, faults);
}

int sim_uvc_fault(const char *text, struct uvc_faults *faults)
{
    return set(text, uvc_members, sizeof uvc_members / sizeof *uvc_members, faults);
}
