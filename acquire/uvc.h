/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a USB camera (Video Class 1.0 to 1.5) says of itself before anybody opens it: its formats
 * and sizes, and which controls it has, so that it can be said beforehand whether its exposure,
 * gain and white balance can be locked.
 *
 * Input is a device's descriptor set as sysfs keeps it in "descriptors": the device descriptor,
 * then its configuration. It comes from a device and is not trusted: every length is checked. */
#ifndef GSN_ACQUIRE_UVC_H
#define GSN_ACQUIRE_UVC_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_UVC_MOST_FORMATS = 32, GSN_UVC_MOST_SIZES = 512 };

struct gsn_uvc_format {
    char name[5]; /* "YUY2", "MJPG", "NV12", ..., "????" for a GUID that is no FourCC */
    uint8_t index;
    uint8_t interface; /* of the stream it belongs to */
    unsigned sizes;    /* it says it has */
};

struct gsn_uvc_size {
    size_t format; /* in the list */
    uint32_t width, height;
    uint32_t shortest; /* interval between frames, 100 ns; 0: not stated */
};

struct gsn_uvc {
    uint16_t vendor, product;
    uint16_t version; /* bcdUVC: 0x0110 is 1.1 */
    int is_bulk, is_isochronous;
    uint32_t terminal;   /* bmControls of the camera terminal (UVC 1.5, table 3-6) */
    uint32_t processing; /* bmControls of the processing unit (table 3-8) */
    size_t format_count, size_count;
    struct gsn_uvc_format format[GSN_UVC_MOST_FORMATS];
    struct gsn_uvc_size size[GSN_UVC_MOST_SIZES];
};

/* gives. Fails with GSN_E_UNSUPPORTED for a device that is no camera or gives no pictures,
 * GSN_E_INPUT for descriptors that contradict themselves, GSN_E_LIMIT, GSN_E_NOMEM. */
int gsn_uvc_parse(const void *bytes, size_t size, struct gsn_uvc **ret_uvc, struct gsn_error *err);
void gsn_uvc_free(struct gsn_uvc *uvc);
GSN_DEFINE_AUTO(gsn_uvc);

/* Writes why exposure, gain and white balance cannot all be locked, "no gain; ..." ; an empty text
 * when the camera has all that is needed. Returns whether it has. */
int gsn_uvc_can_be_locked(const struct gsn_uvc *uvc, char *ret_reason, size_t size);

#ifdef __cplusplus
}
#endif
#endif
