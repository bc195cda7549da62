/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A bench in memory: a PTP scanner, the source that asks it, the spool that makes bytes durable,
 * and a ledger that counts what was acknowledged. Time moves when somebody waits. */
#ifndef GSN_TESTS_ACQUIRE_PTP_BENCH_H
#define GSN_TESTS_ACQUIRE_PTP_BENCH_H

#include <stdbool.h>

#include "acquire/source.h"
#include "acquire/spool.h"
#include "tests/device/memory_transport.h"
#include "tests/device/ptp_model.h"
#include "tests/storage/scratch.h"

enum { BENCH_OBJECTS = 16, BENCH_LINES = 256, BENCH_TURNS = 60 };

struct bench_object {
    char name[64];
    uint8_t *bytes;
    size_t size;
    uint32_t handle;
    unsigned taken; /* rows of the ledger with its bytes */
};

struct bench_line {
    enum gsn_source_what what;
    char name[64], reason[256];
};

struct bench {
    struct ptp_model *model;
    struct memory_bus bus;
    struct gsn_source *source;
    struct gsn_source_options options;
    struct gsn_scratch scratch;
    struct gsn_spool *spool;
    size_t objects;
    struct bench_object object[BENCH_OBJECTS];
    size_t keys;
    char key[BENCH_OBJECTS][256]; /* of what was taken */
    unsigned foreign;             /* taken, but nobody's bytes */
    unsigned again;               /* taken a second time, and recognised by the hash */
    unsigned away;                /* polls that found no device */
    unsigned failed_copies;
    bool dies;    /* the process dies between the ledger and the acknowledgement, once */
    size_t lines; /* what was told but READY */
    struct bench_line line[BENCH_LINES];
};

/* The scanner is plugged in; no source is open. */
void bench_init(struct bench *bench, const struct ptp_faults *faults);
void bench_done(struct bench *bench);
#define bench_auto __attribute__((cleanup(bench_done))) struct bench

/* Opens the source; settle_ms is 1000 unless set in options before. */
void bench_open(struct bench *bench);
/* The process died: source and spool are opened anew, the ledger stays. */
void bench_restart(struct bench *bench);

/* A scan of this many bytes, made from seed, appears; date NULL: "20260101T120000". */
struct bench_object *bench_scan(struct bench *bench, const char *name, size_t size, unsigned seed,
                                const char *date, int announce);

/* One turn as the intake takes it: look, copy what is ready, write it down, acknowledge, wait. */
void bench_turn(struct bench *bench);
/* Turns until everything is in the ledger, at most this many; whether it is. */
bool bench_work(struct bench *bench, unsigned turns);
/* Every object is in the ledger exactly once, and nothing else is. */
bool bench_is_complete(const struct bench *bench);

/* Makes a bench whose scanner has these faults, and demands that three scans come in whole: a small
 * one, one of exact packets, and one of several pieces. */
void bench_take_three(const struct ptp_faults *faults, struct bench *bench);

/* borrows: the last line told about this name (NULL: about anybody) with this in its reason. */
const struct bench_line *bench_told(const struct bench *bench, const char *name, const char *part);

#endif
