/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What listing a device, describing an object and knowing it again have in common; for the files of
 * acquire/ptp_table.h alone. */
#ifndef GSN_ACQUIRE_PTP_TABLE_PARTS_H
#define GSN_ACQUIRE_PTP_TABLE_PARTS_H

#include "acquire/ptp_table.h"

#include <stdbool.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ptp_table.c */

/* Where the handle of this session is, or belongs. */
size_t gsn_ptp_table_place(const struct gsn_ptp_table *table, unsigned session, uint32_t handle,
                           bool *ret_found);
/* borrows: the object with this handle, or NULL. */
struct gsn_ptp_object *gsn_ptp_table_handle(struct gsn_ptp_table *table, unsigned session,
                                            uint32_t handle);

/* ptp_object.c */

void gsn_ptp_object_free_texts(struct gsn_ptp_object *object);
/* A reason is told once, and again when it becomes another. */
void gsn_ptp_object_set_state(struct gsn_ptp_object *object, enum gsn_ptp_state state,
                              const char *reason);
/* Whether it is time to describe it. */
bool gsn_ptp_object_is_due(const struct gsn_ptp_object *object, int64_t now_ms);
/* Asks for it and judges it. An object that cannot be described is set aside alone. */
int gsn_ptp_object_describe(struct gsn_ptp_table *table, struct gsn_ptp_device *device,
                            struct gsn_ptp_object *object, int64_t now_ms, struct gsn_error *err);

/* ptp_key.c: all folders are known, so everybody's path is, and who was met in an earlier session.
 * Fails with GSN_E_NOMEM. */
int gsn_ptp_table_make_keys(struct gsn_ptp_table *table, const struct gsn_ptp_device *device,
                            struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
