/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One question to the mesher's process, and its answer as a mesh. */
#ifndef GSN_MODEL_DOMAIN_MESHER_H
#define GSN_MODEL_DOMAIN_MESHER_H

#include "pipeline/model/domain.h"
#include "pipeline/model/tetgen_wire.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: the answer, conforming, oriented and in the order of space; whether it fills the right
 * place is the caller's to verify. The quality is set here, whatever the question's options say;
 * their largest volume is kept. Fails with GSN_E_MESH, GSN_E_PROCESS, GSN_E_NOMEM. */
int gsn_domain_ask(const struct gsn_domain_options *options,
                   const struct gsn_mesh_question *question, struct gsn_tets **ret_mesh,
                   struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
