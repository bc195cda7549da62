/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A model of a device on qemu's usb-redir: the guest's own kernel meets it behind xHCI. */
#ifndef GSN_TESTS_DEVICE_REDIR_H
#define GSN_TESTS_DEVICE_REDIR_H

#include "tests/device/usb_model.h"

struct redir;

/* Serves the model over a connected socket, which it closes in the end. keeps: the model.
 * NULL when memory is out. */
struct redir *redir_new(int socket, const struct usb_model *model);
void redir_free(struct redir *redir);

/* Waits up to timeout_ms for the guest, then answers what can be answered. Returns -1 when the
 * other end has gone. */
int redir_turn(struct redir *redir, int timeout_ms);

/* The guest sees the device go, and come. It is there from the start. */
void redir_unplug(struct redir *redir);
void redir_plug(struct redir *redir);

#endif
