/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/supervise.h"

#include <string.h>

#include "acquire/source.h"
#include "pipeline/core/process.h"
#include "systemd/supervise_parts.h"

/* A device that is silent breaks its transfers off after 10 s, and class requests follow. */
enum { DEVICE_PATIENCE_MS = 30000 };

void gsn_supervisor_forget_unwanted(struct gsn_supervisor *supervisor)
{
    size_t kept = 0;

    for (size_t i = 0; i < supervisor->count; i++) {
        struct gsn_supervised *const intake = supervisor->at[i];

        if (intake->wanted || intake->pid > 0)
            supervisor->at[kept++] = intake;
        else
            gsn_supervised_free(intake);
    }
    supervisor->count = kept;
}

static struct gsn_supervised *find(const struct gsn_supervisor *supervisor, const char *name)
{
    for (size_t i = 0; i < supervisor->count; i++)
        if (strcmp(supervisor->at[i]->name, name) == 0)
            return supervisor->at[i];
    return NULL;
}

static int add(struct gsn_supervisor *supervisor, const char *name,
               struct gsn_supervised **ret_intake, struct gsn_error *err)
{
    struct gsn_supervised **more =
        gsn_realloc_array(supervisor->at, supervisor->count + 1, sizeof(struct gsn_supervised *));
    struct gsn_supervised *intake = gsn_alloc_array(1, sizeof *intake);

    if (more)
        supervisor->at = more;
    if (intake) {
        *intake = (struct gsn_supervised){ .supervisor = supervisor,
                                           .heartbeat = -1,
                                           .state = GSN_SUPERVISED_ENDED };
        intake->name = gsn_strdup(name);
    }
    if (!more || !intake || !intake->name) {
        gsn_supervised_free(intake);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a source");
    }
    more[supervisor->count++] = intake;
    *ret_intake = intake;
    return GSN_OK;
}

static int configure(struct gsn_supervisor *supervisor, const struct gsn_config *config,
                     const struct gsn_config_source *source, struct gsn_error *err)
{
    struct gsn_supervised *intake = find(supervisor, source->name);
    gsn_auto_mem(char) text = NULL;
    gsn_auto_mem(char) address = gsn_strdup(source->address);
    int r = gsn_config_write_source(config, source, &text, err);

    if (r >= 0 && !address)
        r = gsn_fail(err, GSN_E_NOMEM, "out of memory for a source");
    if (r >= 0 && !intake)
        r = add(supervisor, source->name, &intake, err);
    if (r < 0)
        return r;
    intake->wanted = true;
    if (intake->text && strcmp(intake->text, text) == 0 && intake->state != GSN_SUPERVISED_STOPPING)
        return GSN_OK;
    gsn_free(intake->text);
    gsn_free(intake->address);
    intake->text = gsn_steal(&text);
    intake->address = gsn_steal(&address);
    intake->patience_ms = source->patience_s * 1000;
    if (gsn_source_subsystem(source->address) && intake->patience_ms < DEVICE_PATIENCE_MS)
        intake->patience_ms = DEVICE_PATIENCE_MS;
    gsn_supervised_stop(intake);
    if (intake->state != GSN_SUPERVISED_STOPPING)
        gsn_supervised_start(intake);
    return GSN_OK;
}

int gsn_supervisor_set(struct gsn_supervisor *supervisor, const struct gsn_config *config,
                       struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; i < supervisor->count; i++)
        supervisor->at[i]->wanted = gsn_config_find(config, supervisor->at[i]->name) != NULL;
    for (size_t i = 0; i < supervisor->count; i++)
        if (!supervisor->at[i]->wanted)
            gsn_supervised_stop(supervisor->at[i]);
    gsn_supervisor_forget_unwanted(supervisor);
    for (size_t i = 0; r >= 0 && i < config->source_count; i++)
        r = configure(supervisor, config, &config->source[i], err);
    return r;
}

void gsn_supervisor_arrival(struct gsn_supervisor *supervisor, const char *subsystem)
{
    for (size_t i = 0; i < supervisor->count; i++) {
        struct gsn_supervised *const intake = supervisor->at[i];
        const char *const its = gsn_source_subsystem(intake->address);

        if (!its || strcmp(its, subsystem) != 0)
            continue;
        intake->was_late = intake->state == GSN_SUPERVISED_RUNNING;
        if (intake->state != GSN_SUPERVISED_AWAY && intake->state != GSN_SUPERVISED_RESTING)
            continue;
        intake->timer = sd_event_source_disable_unref(intake->timer);
        gsn_supervised_start(intake);
    }
}

void gsn_supervisor_stop(struct gsn_supervisor *supervisor)
{
    supervisor->stopping = true;
    for (size_t i = 0; i < supervisor->count; i++)
        gsn_supervised_stop(supervisor->at[i]);
}

size_t gsn_supervisor_running(const struct gsn_supervisor *supervisor)
{
    size_t running = 0;

    for (size_t i = 0; i < supervisor->count; i++)
        running += supervisor->at[i]->pid > 0;
    return running;
}

int gsn_supervisor_new(sd_event *loop, struct gsn_store *store,
                       struct gsn_supervisor **ret_supervisor, struct gsn_error *err)
{
    gsn_auto(gsn_supervisor) supervisor = gsn_alloc_array(1, sizeof *supervisor);
    int r;

    if (!supervisor)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a supervisor");
    supervisor->loop = loop;
    supervisor->store = store;
    r = gsn_process_sibling("gieson-intake", &supervisor->program, err);
    if (r < 0)
        return r;
    *ret_supervisor = gsn_steal(&supervisor);
    return GSN_OK;
}

void gsn_supervisor_free(struct gsn_supervisor *supervisor)
{
    if (!supervisor)
        return;
    for (size_t i = 0; i < supervisor->count; i++)
        gsn_supervised_free(supervisor->at[i]);
    gsn_free(supervisor->at);
    gsn_free(supervisor->program);
    gsn_free(supervisor);
}
