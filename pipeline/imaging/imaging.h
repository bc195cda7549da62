/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Operations on pictures, by OpenCV's core and imgproc: nothing else of it is used, and only what
 * gives the same bits on every processor and for any number of threads (labels, morphology,
 * resizing, box and median filters, Fourier transforms; not the float Gaussian, not its algebra).
 *
 * Sets are bytes, 0 or 1, rows from top to bottom. Every function that can fail returns a code and
 * leaves ret_* alone then; memory that OpenCV cannot get is GSN_E_NOMEM. */
#ifndef GSN_IMAGING_IMAGING_H
#define GSN_IMAGING_IMAGING_H

#ifdef __cplusplus
extern "C" {
#endif

/* Makes OpenCV quiet and single-threaded, in the whole process (we are parallel over sections), and
 * runs it once, so that what it reads from disk is read: who enters a sandbox calls this before.
 * All functions of this folder do so by themselves; again costs nothing. */
void gsn_imaging_open(void);

/* The version of OpenCV that runs, as "4.6.0": pixels depend on it. borrows. */
const char *gsn_imaging_version(void);

#ifdef __cplusplus
}
#endif
#endif
