/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* SHA-256 (FIPS 180-4) by OpenSSL's EVP. A file is read by pread() in pieces, so that its position
 * stays; the digest of what was added so far is that of a copy of the state.
 *
 * Failure: memory, a file that cannot be read, an OpenSSL without SHA-256. Cost: one pass, 256 KiB.
 */
#include "pipeline/core/hash.h"

#include <errno.h>
#include <openssl/evp.h>
#include <string.h>
#include <unistd.h>

enum { PIECE_BYTES = 1 << 18 };

struct gsn_hash {
    EVP_MD_CTX *evp;
};

int gsn_hash_new(struct gsn_hash **ret_hash, struct gsn_error *err)
{
    gsn_auto(gsn_hash) hash = gsn_alloc_array(1, sizeof *hash);

    if (hash)
        hash->evp = EVP_MD_CTX_new();
    if (!hash || !hash->evp)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a hash");
    if (EVP_DigestInit_ex(hash->evp, EVP_sha256(), NULL) != 1)
        return gsn_fail(err, GSN_E_IO, "OpenSSL offers no SHA-256");
    *ret_hash = gsn_steal(&hash);
    return GSN_OK;
}

int gsn_hash_add(struct gsn_hash *hash, const void *bytes, size_t size, struct gsn_error *err)
{
    if (EVP_DigestUpdate(hash->evp, bytes, size) != 1)
        return gsn_fail(err, GSN_E_IO, "OpenSSL failed to hash");
    return GSN_OK;
}

int gsn_hash_end(struct gsn_hash *hash, struct gsn_digest *ret_digest, struct gsn_error *err)
{
    static const char digits[] = "0123456789abcdef";
    unsigned char raw[32];
    unsigned length = 0;

    if (EVP_DigestFinal_ex(hash->evp, raw, &length) != 1 || length != sizeof raw)
        return gsn_fail(err, GSN_E_IO, "OpenSSL failed to finish a hash");
    for (size_t i = 0; i < sizeof raw; i++) {
        ret_digest->hex[2 * i] = digits[raw[i] >> 4];
        ret_digest->hex[2 * i + 1] = digits[raw[i] & 15];
    }
    ret_digest->hex[64] = '\0';
    return GSN_OK;
}

int gsn_hash_peek(const struct gsn_hash *hash, struct gsn_digest *ret_digest, struct gsn_error *err)
{
    gsn_auto(gsn_hash) copy = NULL;
    int r = gsn_hash_new(&copy, err);

    if (r >= 0 && EVP_MD_CTX_copy_ex(copy->evp, hash->evp) != 1)
        r = gsn_fail(err, GSN_E_NOMEM, "out of memory for a hash");
    return r >= 0 ? gsn_hash_end(copy, ret_digest, err) : r;
}

int gsn_hash_again(struct gsn_hash *hash, struct gsn_error *err)
{
    if (EVP_DigestInit_ex(hash->evp, NULL, NULL) != 1)
        return gsn_fail(err, GSN_E_IO, "OpenSSL failed to start a hash anew");
    return GSN_OK;
}

void gsn_hash_free(struct gsn_hash *hash)
{
    if (!hash)
        return;
    EVP_MD_CTX_free(hash->evp);
    gsn_free(hash);
}

int gsn_sha256(const void *bytes, size_t size, struct gsn_digest *ret_digest, struct gsn_error *err)
{
    gsn_auto(gsn_hash) hash = NULL;
    int r = gsn_hash_new(&hash, err);

    if (r >= 0)
        r = gsn_hash_add(hash, bytes, size, err);
    if (r >= 0)
        r = gsn_hash_end(hash, ret_digest, err);
    return r;
}

int gsn_sha256_file(int fd, const char *name, struct gsn_digest *ret_digest, int64_t *ret_size,
                    struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) piece = gsn_alloc(PIECE_BYTES);
    gsn_auto(gsn_hash) hash = NULL;
    int64_t at = 0;
    int r = piece ? gsn_hash_new(&hash, err) : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    while (r >= 0) {
        const ssize_t got = pread(fd, piece, PIECE_BYTES, at);

        if (got < 0 && errno == EINTR)
            continue;
        if (got < 0)
            return gsn_fail(err, GSN_E_IO, "%s: %s", name, strerror(errno));
        if (got == 0)
            break;
        at += got;
        r = gsn_hash_add(hash, piece, (size_t)got, err);
    }
    if (r >= 0)
        r = gsn_hash_end(hash, ret_digest, err);
    if (r >= 0 && ret_size)
        *ret_size = at;
    return r;
}
