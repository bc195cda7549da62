/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The first screen of `gieson top`: the queue. It holds a board and what the reader chose on it;
 * what was chosen stays chosen when a new board comes. */
#ifndef GSN_UI_QUEUE_VIEW_H
#define GSN_UI_QUEUE_VIEW_H

#include "ui/board.h"
#include "ui/screen.h"

struct gsn_queue_view;

/* keeps: store_dir. gives. */
int gsn_queue_view_new(const char *store_dir, struct gsn_queue_view **ret_view,
                       struct gsn_error *err);
void gsn_queue_view_free(struct gsn_queue_view *view);
GSN_DEFINE_AUTO(gsn_queue_view);

/* A new state of the store, and the time to which ages are told. */
int gsn_queue_view_set(struct gsn_queue_view *view, const struct gsn_snapshot *snapshot,
                       int64_t now, struct gsn_error *err);
/* The store does not answer: the sentence is shown until the next state; what is shown stays. */
void gsn_queue_view_set_trouble(struct gsn_queue_view *view, const char *sentence);
/* A sentence for the reader, until the next key. */
void gsn_queue_view_say(struct gsn_queue_view *view, const char *sentence);

void gsn_queue_view_draw(struct gsn_queue_view *view, struct gsn_screen *screen);

enum gsn_queue_wish {
    GSN_QUEUE_WISH_NONE,
    GSN_QUEUE_WISH_QUIT,
    GSN_QUEUE_WISH_RETRY,     /* of gsn_queue_view_specimen() */
    GSN_QUEUE_WISH_RETRY_ALL, /* of whatever failed */
};

enum gsn_queue_wish gsn_queue_view_key(struct gsn_queue_view *view, int key);

/* The specimen of the chosen line; 0: none. */
int64_t gsn_queue_view_specimen(const struct gsn_queue_view *view);

#endif
