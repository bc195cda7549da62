/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Who asks, for the audit log and the report: what the kernel knows, not what the environment says.
 *
 * The login uid is given once, when somebody logs in, and stays through sudo and su; where there is
 * none (a service, a container) the real uid stands alone. SUDO_USER, which anybody can set, is
 * only a remark behind. */
#ifndef GSN_STORAGE_ACTOR_H
#define GSN_STORAGE_ACTOR_H

#include <sys/types.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_actor {
    char name[200]; /* "mueller", "mueller as root", "root (SUDO_USER says mueller)" */
};

struct gsn_actor gsn_actor_now(void);
/* login: (uid_t)-1 for none. claimed: what SUDO_USER says, or NULL. */
struct gsn_actor gsn_actor_of(uid_t login, uid_t real, const char *claimed);

#ifdef __cplusplus
}
#endif
#endif
