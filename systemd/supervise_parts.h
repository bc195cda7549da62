/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The processes that a supervisor keeps; for the files of systemd/supervise.h alone. */
#ifndef GSN_SYSTEMD_SUPERVISE_PARTS_H
#define GSN_SYSTEMD_SUPERVISE_PARTS_H

#include "systemd/log.h"
#include "systemd/supervise.h"

#include <stdbool.h>
#include <stdint.h>
#include <sys/types.h>

enum gsn_supervised_state {
    GSN_SUPERVISED_RUNNING,
    GSN_SUPERVISED_RESTING,  /* will be started again when its timer ends */
    GSN_SUPERVISED_AWAY,     /* the same, or when its device comes */
    GSN_SUPERVISED_ENDED,    /* nothing will follow */
    GSN_SUPERVISED_STOPPING, /* asked to */
};

struct gsn_supervised {
    struct gsn_supervisor *supervisor;
    char *name, *text; /* the configuration as it is passed on */
    char *address;
    int64_t patience_ms;
    enum gsn_supervised_state state;
    bool wanted;    /* by the present configuration */
    bool is_hung;   /* it was killed because of that */
    bool was_ready; /* its source answered */
    bool was_late;  /* a device came while this process was looking already */
    pid_t pid;
    int heartbeat; /* our end; -1 */
    int64_t began_ms, delay_ms;
    sd_event_source *child, *breath, *timer;
};

struct gsn_supervisor {
    sd_event *loop;
    struct gsn_store *store;
    char *program;
    bool stopping;
    size_t count;
    struct gsn_supervised **at;
};

/* supervise.c: frees those that no configuration wants and that have no process any more. */
void gsn_supervisor_forget_unwanted(struct gsn_supervisor *supervisor);

/* supervise_process.c */

/* Starts the process; what hinders it is logged, and it is tried again later. */
void gsn_supervised_start(struct gsn_supervised *intake);
/* Asks it to end, and kills it when it does not. */
void gsn_supervised_stop(struct gsn_supervised *intake);
/* Starts it after so long. */
void gsn_supervised_rest(struct gsn_supervised *intake, enum gsn_supervised_state state,
                         int64_t ms);
/* Kills what is left. */
void gsn_supervised_free(struct gsn_supervised *intake);
struct gsn_log_about gsn_supervised_about(const struct gsn_supervised *intake, const char *id);
/* In the row that people look at, because the process cannot say it any more. */
void gsn_supervised_say_failed(const struct gsn_supervised *intake, const char *sentence);

/* supervise_end.c: what follows when a process ended by itself, or could not be started. */
void gsn_supervised_back_off(struct gsn_supervised *intake);
void gsn_supervised_judge_exit(struct gsn_supervised *intake, int status);
void gsn_supervised_judge_death(struct gsn_supervised *intake, int signal_number);

#endif
