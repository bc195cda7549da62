/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/supervise_parts.h"

#include <signal.h>
#include <string.h>
#include <sysexits.h>

#include "acquire/source.h"
#include "systemd/lifeline.h"

enum {
    KILLED_DELAY_MS = 200,
    FIRST_DELAY_MS = 1000,
    LONGEST_DELAY_MS = 60000,
    AWAY_DELAY_MS = 60000,
    FOLDER_AWAY_DELAY_MS = 5000, /* a mount is no event of a device */
    STEADY_MS = 60000,           /* who lived so long begins a new series of failures */
};

/* Later each time, until it was steady for a while. */
static int64_t next_delay(struct gsn_supervised *intake)
{
    if (intake->delay_ms == 0 || gsn_now_ms() - intake->began_ms >= STEADY_MS)
        intake->delay_ms = FIRST_DELAY_MS;
    else if (intake->delay_ms < LONGEST_DELAY_MS / 2)
        intake->delay_ms *= 2;
    else
        intake->delay_ms = LONGEST_DELAY_MS;
    return intake->delay_ms;
}

void gsn_supervised_back_off(struct gsn_supervised *intake)
{
    gsn_supervised_rest(intake, GSN_SUPERVISED_RESTING, next_delay(intake));
}

/* A device that answered before may only have been reset; one that was not there comes with an
 * event. */
static void wait_for_device(struct gsn_supervised *intake)
{
    if (intake->was_ready || intake->was_late)
        gsn_supervised_rest(intake, GSN_SUPERVISED_AWAY, next_delay(intake));
    else if (gsn_source_subsystem(intake->address))
        gsn_supervised_rest(intake, GSN_SUPERVISED_AWAY, AWAY_DELAY_MS);
    else
        gsn_supervised_rest(intake, GSN_SUPERVISED_AWAY, FOLDER_AWAY_DELAY_MS);
}

void gsn_supervised_judge_exit(struct gsn_supervised *intake, int status)
{
    const struct gsn_log_about what = gsn_supervised_about(intake, NULL);

    if (status == EX_OK) {
        intake->state = GSN_SUPERVISED_ENDED;
        gsn_log(LOG_INFO, &what, "has ended: everything in it is taken in");
    } else if (status == GSN_INTAKE_STOPPED) {
        gsn_supervised_rest(intake, GSN_SUPERVISED_RESTING, KILLED_DELAY_MS);
    } else if (status == EX_NOINPUT) {
        wait_for_device(intake);
    } else {
        gsn_supervised_back_off(intake);
        gsn_log(LOG_WARNING, &what, "gieson-intake ended with %d; it starts again in %lld s",
                status, (long long)(intake->delay_ms / 1000));
    }
}

void gsn_supervised_judge_death(struct gsn_supervised *intake, int signal_number)
{
    const struct gsn_log_about what = gsn_supervised_about(intake, NULL);

    if (signal_number == SIGKILL && !intake->is_hung)
        gsn_supervised_rest(intake, GSN_SUPERVISED_RESTING, KILLED_DELAY_MS);
    else
        gsn_supervised_back_off(intake);
    if (intake->is_hung)
        return;
    gsn_log(LOG_WARNING, &what, "gieson-intake died of signal %d (%s) and is started again",
            signal_number, strsignal(signal_number));
    gsn_supervised_say_failed(intake, "its process died and is started again");
}
