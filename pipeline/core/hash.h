/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* SHA-256, by OpenSSL's EVP (hash.c is the one door to libcrypto). */
#ifndef GSN_CORE_HASH_H
#define GSN_CORE_HASH_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* 64 lower-case hexadecimal digits and the terminating zero. */
struct gsn_digest {
    char hex[65];
};

int gsn_sha256(const void *bytes, size_t size, struct gsn_digest *ret_digest,
               struct gsn_error *err);

/* Of an open file from its first byte to its last, wherever its position is; ret_size may be NULL.
 * name: for the sentence. */
int gsn_sha256_file(int fd, const char *name, struct gsn_digest *ret_digest, int64_t *ret_size,
                    struct gsn_error *err);

/* The same in pieces. */
struct gsn_hash;
int gsn_hash_new(struct gsn_hash **ret_hash, struct gsn_error *err);
int gsn_hash_add(struct gsn_hash *hash, const void *bytes, size_t size, struct gsn_error *err);
/* The digest of what was added so far; more may follow. */
int gsn_hash_peek(const struct gsn_hash *hash, struct gsn_digest *ret_digest,
                  struct gsn_error *err);
int gsn_hash_end(struct gsn_hash *hash, struct gsn_digest *ret_digest, struct gsn_error *err);
/* Forgets what was added: the same hash for other bytes, which is cheaper than a new one. */
int gsn_hash_again(struct gsn_hash *hash, struct gsn_error *err);
void gsn_hash_free(struct gsn_hash *hash);
GSN_DEFINE_AUTO(gsn_hash);

#ifdef __cplusplus
}
#endif
#endif
