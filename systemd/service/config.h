/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the administrator of a bench decides: where the store is, how much the queue may use, which
 * sources there are.
 *
 *     [store]        Directory=/var/lib/gieson  ReserveMiB=256
 *     [work]         Workers=1  Threads=0  MemoryMiB=8192  TimeMinutes=120
 *     [source NAME]  Address=ptp:any  SettleMs=1500  PatienceS=60  SweepS=2  DeleteAfterCopy=no
 *                    Specimen=  and what the kind of source knows further
 *
 * One file and the *.conf files of conf.d beside it, in order of their names; of a key that several
 * files give the last one counts. Nothing is taken on trust: an unknown section or key, a value out
 * of its range and an address that no source understands are mistakes. */
#ifndef GSN_SYSTEMD_SERVICE_CONFIG_H
#define GSN_SYSTEMD_SERVICE_CONFIG_H

#include "acquire/source.h"
#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

/* Where `cmake --install` puts it: /etc/gieson/gieson.conf for a prefix of /usr. */
#define GSN_CONFIG_FILE GSN_SYSCONFDIR "/gieson/gieson.conf"

struct gsn_config_source {
    char *name; /* letters, digits, '-', '_' and '.' */
    char *address;
    char *specimen; /* whose panels it delivers while nobody says otherwise; or empty */
    int64_t settle_ms, patience_s, sweep_s;
    int delete_after_copy;
    size_t setting_count;
    struct gsn_source_setting *setting; /* its texts are owned here */
};

struct gsn_config {
    char *store_dir; /* empty: not told */
    uint64_t reserve_bytes;
    unsigned workers, threads;    /* threads 0: as many as there are processors */
    unsigned memory_mib, minutes; /* of one job; memory 0: no limit */
    size_t source_count;
    struct gsn_config_source *source;
};

/* Told every mistake as "FILE:LINE: sentence"; a file that cannot be read is "FILE: sentence". */
struct gsn_config_ear {
    void (*say)(void *context, const char *sentence);
    void *context;
};

/* Reads path and its conf.d; files that are not there are no mistake. gives: the configuration.
 * Fails with GSN_E_INPUT after all mistakes were told; err says how many, and the first. */
int gsn_config_read(const char *path, const struct gsn_config_ear *ear,
                    struct gsn_config **ret_config, struct gsn_error *err);
void gsn_config_free(struct gsn_config *config);
GSN_DEFINE_AUTO(gsn_config);

/* Adds a hot folder that has no section, under a name made of the folder's. */
int gsn_config_add_folder(struct gsn_config *config, const char *folder, struct gsn_error *err);

/* borrows: the source of this name, or NULL. */
const struct gsn_config_source *gsn_config_find(const struct gsn_config *config, const char *name);

/* gives: a text that gsn_config_read() reads back as this one source and the store's reserve; two
 * texts are equal when nothing changed for the source. */
int gsn_config_write_source(const struct gsn_config *config, const struct gsn_config_source *source,
                            char **ret_text, struct gsn_error *err);

#endif
