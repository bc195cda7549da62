/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A scanner that speaks PTP (ISO 15740 over the USB Still Image class): the responder's side, with
 * switches for the faults that devices in the field have. */
#ifndef GSN_TESTS_DEVICE_PTP_MODEL_H
#define GSN_TESTS_DEVICE_PTP_MODEL_H

#include "tests/device/usb_model.h"

#include <stdbool.h>

struct ptp_model;

enum { PTP_TIFF = 0x380d, PTP_JPEG = 0x3801, PTP_FOLDER = 0x3001 };

/* Each is off when zero. "At" counts transfers, transactions or bytes since the model was made or
 * plugged in, from 1. */
struct ptp_faults {
    /* How data cross the bus. */
    bool merge_response;      /* data block and response in one transfer */
    bool split_header;        /* the data header in a transfer of its own */
    bool leftover_zlp;        /* a zero-length packet before each response */
    bool no_zlp;              /* none after a data block that is a multiple of the packet */
    size_t short_reads;       /* most bytes a bulk transfer gives */
    unsigned stall_at;        /* this bulk-in transfer stalls, once */
    unsigned stall_every;     /* every n-th does */
    unsigned short_data_at;   /* this transaction's data block ends early */
    unsigned wrong_id_at;     /* this transaction's answers carry another id */
    unsigned late_at;         /* this transaction's answer comes after the next one was asked */
    unsigned late_ms;         /* every answer waits this long */
    unsigned silent_at;       /* this transaction is never answered */
    unsigned lying_length_at; /* this data header's length is nonsense: odd huge, even tiny */
    uint64_t unplug_at_byte;  /* gone before this bulk-in byte, until ptp_model_replug(), which
                                 counts anew */
    /* How it answers. */
    bool info_needs_session; /* GetDeviceInfo before OpenSession: 0x2003 */
    bool no_list_of_all;     /* GetObjectHandles(0xffffffff): 0x2008, and then it hangs at the
                                next one, as umtp-responder does */
    bool no_storage_ids;     /* GetStorageIDs is not offered */
    unsigned closed_storage; /* the n-th is named, and listing it refused: 0x2013 */
    bool measures_once;      /* an object's size is looked at once in a session */
    bool session_stays_open; /* a replug does not close the session: 0x201E */
    bool new_handles;        /* a replug gives every object another handle */
    bool no_partial;         /* GetPartialObject is not offered */
    bool no_partial64;       /* 0x95C1 is not offered */
    bool no_properties;      /* GetObjectPropValue is not offered */
    bool no_delete;          /* DeleteObject: 0x200D */
    unsigned busy_count;     /* this many answers are 0x2019 first */
    size_t crash_above;      /* a partial read larger than this: silent until reset */
    unsigned bad_object;     /* the n-th object can be listed, but reading it fails: 0x2002 */
    /* Events. */
    bool no_events;          /* none are sent, though DeviceInfo lists them */
    bool hidden_events;      /* sent, though DeviceInfo lists none */
    bool size_zero_first;    /* ObjectAdded at size 0; every look sees more, never all of it,
                                until ptp_model_complete() */
    unsigned changed_flood;  /* this many ObjectInfoChanged after each ObjectAdded */
    bool wrong_event_handle; /* an ObjectAdded for a handle that is not there comes before each */
};

/* An object's bytes; where read is not NULL they are made when asked for (objects over 4 GiB). */
struct ptp_object {
    const char *name;
    const char *date; /* "20260101T120000", or "" */
    uint16_t format;  /* PTP_TIFF, ... */
    uint64_t size;
    const uint8_t *bytes; /* keeps */
    void (*read)(void *context, uint64_t offset, uint8_t *buffer, size_t size);
    void *context;
    uint32_t parent;  /* the handle of its folder; 0: none */
    unsigned storage; /* 0: the first card, 1: the second, ... */
};

/* gives: the model, plugged in. It copies serial, faults, names and dates, not the bytes. */
struct ptp_model *ptp_model_new(const char *serial, const struct ptp_faults *faults);
void ptp_model_free(struct ptp_model *model);
const struct usb_model *ptp_model_usb(const struct ptp_model *model);

/* A scan is finished: the object appears. Returns its handle. announce 0: without an event. */
uint32_t ptp_model_add(struct ptp_model *model, const struct ptp_object *object, int announce);
/* So much of it is written now, and an event says so. */
void ptp_model_write(struct ptp_model *model, uint32_t handle, uint64_t size);
/* Its size is final now (size_zero_first). */
void ptp_model_complete(struct ptp_model *model, uint32_t handle);
void ptp_model_remove(struct ptp_model *model, uint32_t handle);
/* Whether the object is still there: nobody deletes what was not asked for. */
int ptp_model_has(const struct ptp_model *model, uint32_t handle);
size_t ptp_model_count(const struct ptp_model *model);

void ptp_model_set_faults(struct ptp_model *model, const struct ptp_faults *faults);
void ptp_model_unplug(struct ptp_model *model);
void ptp_model_replug(struct ptp_model *model);

/* What was asked of it, since it was made: how often an operation came, and the bulk-in bytes it
 * gave. */
unsigned ptp_model_asked(const struct ptp_model *model, uint16_t operation);
uint64_t ptp_model_given(const struct ptp_model *model);

#endif
