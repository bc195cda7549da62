/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How GSL reports errors while our libraries call it. Private to pipeline/core: GSL has no other
 * door than linalg.h, robust.h and distributions.h. */
#ifndef GSN_CORE_GSL_DOOR_H
#define GSN_CORE_GSL_DOOR_H

/* GSL's own handler ends the process with abort(); after the first call of this it returns codes,
 * in all threads. A handler that the host program set before stays: it is the host's, and it may
 * hear of a matrix that is not positive definite. */
void gsn_gsl_open(void);

#endif
