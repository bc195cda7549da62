/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The folders of specimens inside a hot folder: which are due, and their import by a child.
 *
 * Steps of a look.
 * 1. Each folder with a job.json becomes a hot folder of its own (acquire/folder_source.h).
 * 2. It is due when something in it is ready and nothing in it still changes, or job.json changed.
 * What waits too long is told; the rest comes in without it.
 * 3. A folder with pictures and no job.json is told after the patience.
 * 4. The import is a process (gieson-work import), for that needs the pipeline. While it goes on
 * this process gives its heartbeats; an import that neither computes nor reads nor writes
 * (/proc/PID/stat and io) for the patience hangs and is ended.
 *
 * How it fails: a failed import is tried again after 2 s, doubled to 2 minutes, and at once when
 * somebody changed job.json. One that cannot even be ended costs this process its heartbeat. */
#include "systemd/ingest/specimen_folders.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <sysexits.h>
#include <time.h>
#include <unistd.h>

#include "acquire/source.h"
#include "pipeline/core/calendar.h"
#include "pipeline/core/file.h"
#include "pipeline/core/process.h"
#include "systemd/service/log.h"
#include "systemd/service/spawn.h"

enum { FIRST_DELAY_MS = 2000, LONGEST_DELAY_MS = 120000 };

struct specimen {
    char *path;
    const char *name; /* in path */
    struct gsn_source *source;
    struct gsn_source_events *events; /* of the last look */
    size_t waiting_count;
    char **waiting; /* names that were told as WAITING and not as anything else since */
    uint64_t ready_bytes;
    size_t ready;
    int64_t next_ms, delay_ms;
    struct stat job; /* job.json as it was at the last look */
};

/* A folder that is no specimen yet. */
struct stranger {
    char *name;
    int64_t since_ms;
    bool seen; /* in this look */
};

struct gsn_specimen_folders {
    char *root;
    struct gsn_source_options options;
    const struct gsn_specimen_ear *ear;
    size_t count;
    struct specimen *at;
    size_t stranger_count;
    struct stranger *stranger;
};

/* Folders. */

static int out_of_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the folders of specimens");
}

static void specimen_done(struct specimen *specimen)
{
    gsn_source_events_free(specimen->events);
    gsn_source_free(specimen->source);
    for (size_t i = 0; i < specimen->waiting_count; i++)
        gsn_free(specimen->waiting[i]);
    gsn_free(specimen->waiting);
    gsn_free(specimen->path);
}

void gsn_specimen_folders_free(struct gsn_specimen_folders *folders)
{
    for (size_t i = 0; folders && i < folders->count; i++)
        specimen_done(&folders->at[i]);
    for (size_t i = 0; folders && i < folders->stranger_count; i++)
        gsn_free(folders->stranger[i].name);
    if (folders) {
        gsn_free(folders->stranger);
        gsn_free(folders->at);
        gsn_free(folders->root);
    }
    gsn_free(folders);
}

int gsn_specimen_folders_new(const char *root, int64_t settle_ms, int64_t patience_ms,
                             const struct gsn_specimen_ear *ear,
                             struct gsn_specimen_folders **ret_folders, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_folders) folders = gsn_alloc_array(1, sizeof *folders);

    if (folders)
        folders->root = gsn_strdup(root);
    if (!folders || !folders->root)
        return out_of_memory(err);
    folders->options =
        (struct gsn_source_options){ .settle_ms = settle_ms, .patience_ms = patience_ms };
    folders->ear = ear;
    *ret_folders = gsn_steal(&folders);
    return GSN_OK;
}

static bool is_known(const struct gsn_specimen_folders *folders, const char *name)
{
    for (size_t i = 0; i < folders->count; i++)
        if (strcmp(folders->at[i].name, name) == 0)
            return true;
    return false;
}

static int add_folder(struct gsn_specimen_folders *folders, const char *name, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", folders->root, name);
    gsn_auto_mem(char) address = gsn_format("hot:%s/%s", folders->root, name);
    gsn_auto(gsn_source) source = NULL;
    struct specimen *more;
    int r;

    if (!path || !address)
        return out_of_memory(err);
    r = gsn_source_open(address, &folders->options, &source, err);
    if (r < 0)
        return r;
    more = gsn_realloc_array(folders->at, folders->count + 1, sizeof *more);
    if (!more)
        return out_of_memory(err);
    folders->at = more;
    more[folders->count] = (struct specimen){ .path = path,
                                              .name = path + strlen(folders->root) + 1,
                                              .source = gsn_steal(&source) };
    folders->count++;
    (void)gsn_steal(&path);
    return GSN_OK;
}

/* Since when a folder is there that is no specimen; notes that it is there still. */
static int note_stranger(struct gsn_specimen_folders *folders, const char *name, int64_t now_ms,
                         int64_t *ret_since_ms, struct gsn_error *err)
{
    gsn_auto_mem(char) copy = NULL;
    struct stranger *more;

    for (size_t i = 0; i < folders->stranger_count; i++) {
        struct stranger *const stranger = &folders->stranger[i];

        if (strcmp(stranger->name, name) != 0)
            continue;
        stranger->seen = true;
        *ret_since_ms = stranger->since_ms;
        return GSN_OK;
    }
    copy = gsn_strdup(name);
    more = gsn_realloc_array(folders->stranger, folders->stranger_count + 1, sizeof *more);
    if (more)
        folders->stranger = more;
    if (!copy || !more)
        return out_of_memory(err);
    more[folders->stranger_count++] =
        (struct stranger){ .name = gsn_steal(&copy), .since_ms = now_ms, .seen = true };
    *ret_since_ms = now_ms;
    return GSN_OK;
}

static void forget_strangers(struct gsn_specimen_folders *folders)
{
    size_t kept = 0;

    for (size_t i = 0; i < folders->stranger_count; i++) {
        struct stranger *const stranger = &folders->stranger[i];

        if (stranger->seen)
            folders->stranger[kept++] = (struct stranger){ stranger->name, stranger->since_ms, 0 };
        else
            gsn_free(stranger->name);
    }
    folders->stranger_count = kept;
}

static int bar_name(const struct gsn_specimen_folders *folders, const char *name,
                    const char *reason, char *action, struct gsn_error *err)
{
    gsn_auto_mem(char) what = action;

    return what ? folders->ear->barred(folders->ear->context, name, reason, what, err)
                : out_of_memory(err);
}

/* Whether anything in it is called like a picture; errno as opendir() leaves it when not even that
 * can be seen. */
static bool has_picture(const char *path)
{
    DIR *const dir = opendir(path);
    const struct dirent *entry;
    bool any = false;

    if (!dir)
        return false;
    while (!any && (entry = readdir(dir)))
        any = entry->d_name[0] != '.' && gsn_name_is_picture(entry->d_name);
    (void)closedir(dir);
    errno = 0;
    return any;
}

/* No job.json can be had in this folder: a person is told, once that has lasted for long. */
static int meet_stranger(struct gsn_specimen_folders *folders, const char *name, int64_t now_ms,
                         const struct gsn_error *why, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", folders->root, name);
    int64_t since_ms = 0;
    int r = note_stranger(folders, name, now_ms, &since_ms, err);

    bool any;

    if (r < 0 || now_ms - since_ms < folders->options.patience_ms)
        return r;
    if (!path)
        return out_of_memory(err);
    any = has_picture(path);
    if (errno == EACCES)
        return bar_name(folders, name, "is a folder that may not be looked into",
                        gsn_format("let it be read: chmod -R a+rX '%s'", path), err);
    if (why->code == GSN_E_DENIED)
        return bar_name(folders, name, why->text,
                        gsn_format("let it be read: chmod -R a+rX '%s'", path), err);
    if (why->code == GSN_E_INPUT)
        return bar_name(folders, name, why->text, gsn_format("put the file itself into '%s'", path),
                        err);
    if (any)
        return bar_name(folders, name,
                        "holds pictures but no job.json, which says whose sections they are: "
                        "nothing of it is taken in",
                        gsn_format("write '%s/job.json', or remove the folder", path), err);
    return folders->ear->over(folders->ear->context, name, err);
}

static int meet_folder(struct gsn_specimen_folders *folders, const char *name, int64_t now_ms,
                       struct gsn_error *err)
{
    gsn_auto_mem(char) job = gsn_format("%s/job.json", name);
    gsn_auto_fd fd = -1;
    struct gsn_error why = { 0 };
    int r;

    if (!job)
        return out_of_memory(err);
    r = gsn_file_open_in(folders->root, job, &fd, &why);
    if (r == GSN_E_NOMEM)
        return out_of_memory(err);
    if (r < 0)
        return meet_stranger(folders, name, now_ms, &why, err);
    r = add_folder(folders, name, &why);
    if (r < 0)
        return r == GSN_E_NOMEM ? out_of_memory(err) : GSN_OK;
    return folders->ear->over(folders->ear->context, name, err);
}

/* Folders that are new: with a job.json they are specimens. One that cannot be opened is looked at
 * again next time. Links are told by the source of the whole folder. */
static int find_new(struct gsn_specimen_folders *folders, int64_t now_ms, struct gsn_error *err)
{
    DIR *const dir = opendir(folders->root);
    const struct dirent *entry;
    int r = GSN_OK;

    while (dir && r >= 0 && (entry = readdir(dir)))
        if (entry->d_name[0] != '.' && (entry->d_type == DT_DIR || entry->d_type == DT_UNKNOWN) &&
            !is_known(folders, entry->d_name))
            r = meet_folder(folders, entry->d_name, now_ms, err);
    if (dir)
        (void)closedir(dir);
    if (r >= 0)
        forget_strangers(folders);
    return r;
}

static void forget_waiting(struct specimen *specimen, const char *name)
{
    size_t kept = 0;

    for (size_t i = 0; i < specimen->waiting_count; i++) {
        if (strcmp(specimen->waiting[i], name) == 0)
            gsn_free(specimen->waiting[i]);
        else
            specimen->waiting[kept++] = specimen->waiting[i];
    }
    specimen->waiting_count = kept;
}

static int note_waiting(struct specimen *specimen, const char *name, struct gsn_error *err)
{
    gsn_auto_mem(char) copy = gsn_strdup(name);
    char **more;

    forget_waiting(specimen, name);
    more = copy ? gsn_realloc_array(specimen->waiting, specimen->waiting_count + 1, sizeof *more)
                : NULL;
    if (!more)
        return out_of_memory(err);
    specimen->waiting = more;
    more[specimen->waiting_count++] = gsn_steal(&copy);
    return GSN_OK;
}

/* What a person has changed is tried at once. */
static void watch_job(struct specimen *specimen)
{
    gsn_auto_mem(char) path = gsn_format("%s/job.json", specimen->path);
    struct stat now = { .st_size = 0 };

    if (!path || lstat(path, &now) < 0)
        return;
    if (now.st_mtim.tv_sec != specimen->job.st_mtim.tv_sec ||
        now.st_mtim.tv_nsec != specimen->job.st_mtim.tv_nsec ||
        now.st_size != specimen->job.st_size || now.st_ino != specimen->job.st_ino ||
        now.st_mode != specimen->job.st_mode) {
        specimen->delay_ms = 0;
        specimen->next_ms = 0;
    }
    specimen->job = now;
}

/* One file of a specimen: barred, or not any more. */
static int tell_file(const struct gsn_specimen_folders *folders, const struct specimen *specimen,
                     const struct gsn_source_event *event, struct gsn_error *err)
{
    gsn_auto_mem(char) name = gsn_format("%s/%s", specimen->name, event->name);

    if (!name)
        return out_of_memory(err);
    if (event->what == GSN_SOURCE_BARRED)
        return folders->ear->barred(folders->ear->context, name, event->reason, event->action, err);
    return event->what == GSN_SOURCE_WAITING ? GSN_OK
                                             : folders->ear->over(folders->ear->context, name, err);
}

static int poll_folder(const struct gsn_specimen_folders *folders, struct specimen *specimen,
                       int64_t now_ms, bool *ret_gone, struct gsn_error *err)
{
    struct gsn_error why = { 0 };
    struct gsn_source_events *events = NULL;
    int ended = 0;
    int r = gsn_source_poll(specimen->source, now_ms, &events, &ended, &why);

    *ret_gone = r < 0 && r != GSN_E_NOMEM;
    if (r < 0)
        return *ret_gone ? GSN_OK : out_of_memory(err);
    gsn_source_events_free(specimen->events);
    specimen->events = events;
    specimen->ready = 0;
    specimen->ready_bytes = 0;
    watch_job(specimen);
    for (size_t i = 0; r >= 0 && i < events->count; i++) {
        const struct gsn_source_event *const event = &events->at[i];

        /* That job.json is no picture is never told. */
        if (event->what == GSN_SOURCE_WAITING && strcmp(event->name, "job.json") != 0)
            r = note_waiting(specimen, event->name, err);
        else
            forget_waiting(specimen, event->name);
        if (r >= 0)
            r = tell_file(folders, specimen, event, err);
        if (event->what == GSN_SOURCE_READY) {
            specimen->ready++;
            specimen->ready_bytes += event->size;
        }
    }
    return r;
}

static void drop_folder(struct gsn_specimen_folders *folders, size_t index)
{
    specimen_done(&folders->at[index]);
    folders->count--;
    memmove(&folders->at[index], &folders->at[index + 1],
            (folders->count - index) * sizeof *folders->at);
}

int gsn_specimen_folders_next(struct gsn_specimen_folders *folders, int64_t now_ms, long after,
                              struct gsn_specimen_due *ret_due, struct gsn_error *err)
{
    int r = after < 0 ? find_new(folders, now_ms, err) : GSN_OK;

    ret_due->path = NULL;
    for (size_t i = (size_t)(after + 1); r >= 0 && i < folders->count;) {
        struct specimen *const specimen = &folders->at[i];
        bool gone = false;

        r = poll_folder(folders, specimen, now_ms, &gone, err);
        if (r < 0)
            return r;
        if (gone) {
            drop_folder(folders, i);
            continue;
        }
        if (specimen->ready > 0 && specimen->waiting_count == 0 && now_ms >= specimen->next_ms) {
            *ret_due = (struct gsn_specimen_due){ .path = specimen->path,
                                                  .name = specimen->name,
                                                  .bytes = specimen->ready_bytes,
                                                  .again = specimen->delay_ms > 0,
                                                  .index = i };
            return GSN_OK;
        }
        i++;
    }
    return r;
}

void gsn_specimen_folders_done(struct gsn_specimen_folders *folders, size_t index)
{
    struct specimen *const specimen = &folders->at[index];
    struct gsn_error quiet = { 0 };

    for (size_t i = 0; i < specimen->events->count; i++)
        if (specimen->events->at[i].what == GSN_SOURCE_READY)
            (void)gsn_source_acknowledge(specimen->source, specimen->events->at[i].item, &quiet);
    specimen->ready = 0;
    specimen->delay_ms = 0;
    specimen->next_ms = 0;
}

void gsn_specimen_folders_failed(struct gsn_specimen_folders *folders, size_t index, int64_t now_ms)
{
    struct specimen *const specimen = &folders->at[index];

    specimen->delay_ms = specimen->delay_ms ? 2 * specimen->delay_ms : FIRST_DELAY_MS;
    if (specimen->delay_ms > LONGEST_DELAY_MS)
        specimen->delay_ms = LONGEST_DELAY_MS;
    specimen->next_ms = now_ms + specimen->delay_ms;
}

int gsn_specimen_folders_is_busy(const struct gsn_specimen_folders *folders)
{
    for (size_t i = 0; i < folders->count; i++)
        if (folders->at[i].waiting_count > 0 || folders->at[i].ready > 0)
            return 1;
    return 0;
}

enum { BREATH_MS = 500, KILL_AFTER_MS = 1000 };

/* The import. */

/* What a process has done since it began, by the kernel's account: time, reads and writes. */
struct deeds {
    char stat[1024], io[512];
};

/* What the child says, line by line, and when it last did anything. */
struct talk {
    const struct gsn_import_child *child;
    pid_t pid;
    struct deeds deeds;
    int64_t did_ms;
    int from;
    size_t length;
    char line[400], last[400];
};

static void end_line(struct talk *talk)
{
    static const char mark[] = "gieson: ";
    const struct gsn_log_about about = { .source = talk->child->source };
    const char *text = talk->line;

    talk->line[talk->length] = '\0';
    talk->length = 0;
    if (strncmp(text, mark, strlen(mark)) == 0)
        text += strlen(mark);
    if (!*text)
        return;
    if (!talk->child->again)
        gsn_log(LOG_INFO, &about, "%s", text);
    (void)snprintf(talk->last, sizeof talk->last, "%s", text);
}

/* False at the end of what it says. */
static bool listen_once(struct talk *talk)
{
    char piece[512];
    const ssize_t got = read(talk->from, piece, sizeof piece);

    for (ssize_t i = 0; i < got; i++) {
        if (piece[i] == '\n' || talk->length + 1 == sizeof talk->line)
            end_line(talk);
        if (piece[i] != '\n')
            talk->line[talk->length++] = piece[i];
    }
    return got > 0 || (got < 0 && (errno == EINTR || errno == EAGAIN));
}

static void read_deeds(pid_t pid, const char *what, char *ret_text, size_t size)
{
    char path[64];
    ssize_t got = -1;
    int fd;

    (void)snprintf(path, sizeof path, "/proc/%lld/%s", (long long)pid, what);
    if (gsn_file_open(path, &fd, NULL) >= 0) {
        got = read(fd, ret_text, size - 1);
        (void)close(fd);
    }
    ret_text[got > 0 ? got : 0] = '\0';
}

/* Whether the child has done nothing at all for its patience. Where /proc does not tell, none is
 * ever called hung. */
static bool is_hung(struct talk *talk)
{
    struct deeds now;

    read_deeds(talk->pid, "stat", now.stat, sizeof now.stat);
    read_deeds(talk->pid, "io", now.io, sizeof now.io);
    if (!now.stat[0] || strcmp(now.stat, talk->deeds.stat) != 0 ||
        strcmp(now.io, talk->deeds.io) != 0) {
        talk->deeds = now;
        talk->did_ms = gsn_now_ms();
    }
    return gsn_now_ms() - talk->did_ms > talk->child->patience_ms;
}

enum outcome { SAID_ALL, STOPPED, HUNG };

/* Until the child closes its end, or we were asked to stop, or it hangs. */
static enum outcome listen_to(struct talk *talk)
{
    for (;;) {
        struct pollfd ends[] = { { .fd = talk->from, .events = POLLIN },
                                 { .fd = gsn_heartbeat_fd(talk->child->heartbeat),
                                   .events = POLLIN } };

        gsn_heartbeat_beat(talk->child->heartbeat, GSN_HEARTBEAT_READY);
        if (is_hung(talk))
            return HUNG;
        if (poll(ends, 2, BREATH_MS) <= 0)
            continue;
        if (ends[1].revents)
            return STOPPED;
        if (ends[0].revents && !listen_once(talk)) {
            end_line(talk);
            return SAID_ALL;
        }
    }
}

/* Asks it to stop, and no longer asks after a second. */
static void end_child(pid_t pid)
{
    const struct timespec nap = { .tv_nsec = 10000000 };
    const int64_t end = gsn_now_ms() + KILL_AFTER_MS;

    (void)kill(pid, SIGTERM);
    while (gsn_process_wait(pid, 0) < 0) {
        if (gsn_now_ms() > end)
            (void)kill(pid, SIGKILL);
        (void)nanosleep(&nap, NULL);
    }
}

static int judge_import(const struct talk *talk, int status, struct gsn_error *err)
{
    if (status == EX_OK)
        return GSN_OK;
    if (status == EX_TEMPFAIL)
        return gsn_fail(err, GSN_E_BUSY, "%.300s", talk->last);
    if (status == EX_NOPERM)
        return gsn_fail(err, GSN_E_DENIED, "%.390s", talk->last);
    if (status == EX_IOERR)
        return gsn_fail(err, GSN_E_IO, "%.390s", talk->last);
    if (status >= 128 || !talk->last[0])
        return gsn_fail(err, GSN_E_PROCESS, "gieson-work ended with %d%s%.300s", status,
                        talk->last[0] ? ": " : "", talk->last);
    return gsn_fail(err, GSN_E_INPUT, "%.390s", talk->last);
}

/* Started, with its words in talk->from; that is ours to close. */
static int start_import(struct talk *talk, struct gsn_error *err)
{
    const struct gsn_import_child *const child = talk->child;
    const char *const argv[] = { child->worker, "--store",     child->store_dir,
                                 "import",      child->folder, "--served",
                                 NULL };
    int ends[2], r;

    if (pipe2(ends, O_CLOEXEC) < 0)
        return gsn_fail(err, GSN_E_PROCESS, "a pipe: %s", strerror(errno));
    const struct gsn_spawn_fd places[] = { { ends[1], 1 }, { ends[1], 2 } };
    const struct gsn_spawn what = { .argv = argv, .fd_count = 2, .fd = places };

    r = gsn_spawn(&what, &talk->pid, err);
    (void)close(ends[1]);
    if (r < 0)
        (void)close(ends[0]);
    else
        talk->from = ends[0];
    talk->did_ms = gsn_now_ms();
    return r;
}

int gsn_import_child_run(const struct gsn_import_child *child, struct gsn_error *err)
{
    struct talk talk = { .child = child };
    enum outcome outcome;
    int r = start_import(&talk, err);

    if (r < 0)
        return r;
    outcome = listen_to(&talk);
    if (outcome == SAID_ALL) {
        r = judge_import(&talk, gsn_process_wait(talk.pid, 1), err);
    } else {
        end_child(talk.pid);
        r = outcome == STOPPED
                ? gsn_fail(err, GSN_E_BUSY, "the import was broken off")
                : gsn_fail(
                      err, GSN_E_PROCESS,
                      "gieson-work did nothing for %lld s while it took in this folder, and was "
                      "ended: see whether the disk or the network folder answers",
                      (long long)child->patience_ms / 1000);
    }
    (void)close(talk.from);
    return r;
}
