/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A scanner or a camera for a virtual machine: a model of a device on qemu's usb-redir.
 *
 *     gieson-sim SOCKET ptp [--serial S] [--fault NAME=VALUE]... FILE...
 *     gieson-sim SOCKET uvc [--serial S] [--fault NAME=VALUE]... WIDTH HEIGHT FRAMES
 *
 * ptp: the first FILE is there from the start; each SIGUSR1 finishes the next scan. uvc: FRAMES are
 * raw YUY2, JPEGs, or frames that gieson took, one after the other, played five a second. SIGUSR2
 * unplugs the device, and plugs it in again when the guest has seen that; SIGTERM unplugs it and
 * ends. */
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#include "tests/device/ptp_model.h"
#include "tests/device/redir.h"
#include "tests/device/sim_faults.h"
#include "tests/device/uvc_model.h"

enum {
    TURN_MS = 5,
    UNPLUGGED_MS = 1500,
    FRAME_MS = 200,
    USAGE = 64,
    NO_INPUT = 66,
    NO_SOCKET = 69
};

static volatile sig_atomic_t scans, replugs, ended;

struct sim {
    struct ptp_model *scanner;
    struct uvc_model *camera;
    char **file; /* of scans to come */
    int file_count;
    int64_t plug_at_ms; /* 0: it is plugged in */
    uint8_t **kept;     /* the files' bytes, which the models do not own */
    size_t kept_count;
};

static int64_t now_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static void on_signal(int number)
{
    if (number == SIGUSR1)
        scans++;
    else if (number == SIGUSR2)
        replugs++;
    else
        ended = 1;
}

/* Says why and ends: this program has nothing to clean up. */
static void give_up(int code, const char *what, const char *why)
{
    (void)fprintf(stderr, "gieson-sim: %s: %s\n", what, why);
    exit(code);
}

/* The bytes live as long as sim does. */
static const uint8_t *read_file(struct sim *sim, const char *path, size_t *ret_size)
{
    const int fd = open(path, O_RDONLY | O_CLOEXEC);
    uint8_t *bytes = NULL;
    size_t done = 0;
    struct stat st;

    if (fd >= 0 && fstat(fd, &st) == 0)
        bytes = malloc((size_t)st.st_size + 1);
    while (bytes && done < (size_t)st.st_size) {
        const ssize_t got = read(fd, bytes + done, (size_t)st.st_size - done);

        if (got <= 0)
            give_up(NO_INPUT, path, "it cannot be read");
        done += (size_t)got;
    }
    if (!bytes)
        give_up(NO_INPUT, path, "it cannot be read");
    (void)close(fd);
    sim->kept = reallocarray(sim->kept, sim->kept_count + 1, sizeof *sim->kept);
    if (!sim->kept)
        give_up(71, path, "out of memory");
    sim->kept[sim->kept_count++] = bytes;
    *ret_size = done;
    return bytes;
}

static void finish_scan(struct sim *sim, int announce)
{
    struct ptp_object object = { .date = "20260101T120000" };
    const char *path, *slash;
    size_t size;

    if (sim->file_count == 0)
        return;
    path = *sim->file++;
    sim->file_count--;
    slash = strrchr(path, '/');
    object.name = slash ? slash + 1 : path;
    object.bytes = read_file(sim, path, &size);
    object.size = size;
    object.format = size > 1 && object.bytes[0] == 0xff ? PTP_JPEG : PTP_TIFF;
    (void)ptp_model_add(sim->scanner, &object, announce);
    (void)fprintf(stderr, "gieson-sim: %s is there, %zu bytes\n", object.name, size);
}

static int connect_to(const char *path)
{
    struct sockaddr_un address = { .sun_family = AF_UNIX };
    const int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);

    (void)snprintf(address.sun_path, sizeof address.sun_path, "%s", path);
    if (fd < 0 || connect(fd, (struct sockaddr *)&address, sizeof address) < 0)
        give_up(NO_SOCKET, path, "qemu does not listen there");
    return fd;
}

static void usage(void)
{
    give_up(USAGE, "usage",
            "gieson-sim SOCKET ptp [--serial S] [--fault NAME=VALUE]... FILE... | "
            "SOCKET uvc [--serial S] [--fault NAME=VALUE]... WIDTH HEIGHT FRAMES");
}

static unsigned number(const char *text)
{
    char *end;
    const unsigned long value = strtoul(text, &end, 10);

    if (*end || value < 1 || value > 8192)
        give_up(USAGE, text, "a size is a number of pixels");
    return (unsigned)value;
}

static void make_camera(struct sim *sim, const char *serial, const struct uvc_faults *faults,
                        char **argument, int count)
{
    const uint8_t *bytes;
    size_t size;

    if (count != 3)
        usage();
    sim->camera = uvc_model_new(serial, number(argument[0]), number(argument[1]), FRAME_MS, faults);
    bytes = read_file(sim, argument[2], &size);
    if (uvc_model_add_file(sim->camera, bytes, size) == 0)
        give_up(NO_INPUT, argument[2], "neither JPEGs nor whole YUYV frames of that size");
}

static void make_scanner(struct sim *sim, const char *serial, const struct ptp_faults *faults,
                         char **argument, int count)
{
    if (count < 1)
        usage();
    sim->scanner = ptp_model_new(serial, faults);
    sim->file = argument;
    sim->file_count = count;
    finish_scan(sim, 0);
}

static const struct usb_model *make(struct sim *sim, int argc, char **argv)
{
    const int camera = argc > 2 && strcmp(argv[2], "uvc") == 0;
    const char *serial = camera ? "CAM0001" : "SN0001";
    struct ptp_faults ptp = { 0 };
    struct uvc_faults uvc = { 0 };
    int at = 3;

    if (argc < 4 || (!camera && strcmp(argv[2], "ptp") != 0))
        usage();
    for (; at + 1 < argc && strncmp(argv[at], "--", 2) == 0; at += 2) {
        if (strcmp(argv[at], "--serial") == 0)
            serial = argv[at + 1];
        else if (strcmp(argv[at], "--fault") != 0)
            usage();
        else if (camera ? sim_uvc_fault(argv[at + 1], &uvc) < 0
                        : sim_ptp_fault(argv[at + 1], &ptp) < 0)
            give_up(USAGE, argv[at + 1], "no such fault");
    }
    if (camera)
        make_camera(sim, serial, &uvc, argv + at, argc - at);
    else
        make_scanner(sim, serial, &ptp, argv + at, argc - at);
    return camera ? uvc_model_usb(sim->camera) : ptp_model_usb(sim->scanner);
}

static void unplug(struct sim *sim, struct redir *redir)
{
    if (sim->camera)
        uvc_model_unplug(sim->camera);
    else
        ptp_model_unplug(sim->scanner);
    redir_unplug(redir);
}

static void plug(struct sim *sim, struct redir *redir)
{
    if (sim->camera)
        uvc_model_replug(sim->camera);
    else
        ptp_model_replug(sim->scanner);
    redir_plug(redir);
}

static void follow_signals(struct sim *sim, struct redir *redir)
{
    for (; scans > 0; scans--)
        if (sim->scanner)
            finish_scan(sim, 1);
    if (replugs > 0 && sim->plug_at_ms == 0) {
        replugs--;
        unplug(sim, redir);
        sim->plug_at_ms = now_ms() + UNPLUGGED_MS; /* the guest's hub must notice */
    }
    if (sim->plug_at_ms && now_ms() >= sim->plug_at_ms) {
        sim->plug_at_ms = 0;
        plug(sim, redir);
    }
}

static void listen_to_signals(void)
{
    struct sigaction action = { .sa_handler = on_signal };

    (void)sigaction(SIGUSR1, &action, NULL);
    (void)sigaction(SIGUSR2, &action, NULL);
    (void)sigaction(SIGTERM, &action, NULL);
    (void)sigaction(SIGINT, &action, NULL);
    action.sa_handler = SIG_IGN;
    (void)sigaction(SIGPIPE, &action, NULL);
}

int main(int argc, char **argv)
{
    struct sim sim = { 0 };
    const struct usb_model *const model = make(&sim, argc, argv);
    struct redir *redir;

    listen_to_signals();
    redir = redir_new(connect_to(argv[1]), model);
    if (!redir)
        give_up(71, "usb-redir", "out of memory");
    while (!ended && redir_turn(redir, TURN_MS) >= 0)
        follow_signals(&sim, redir);
    unplug(&sim, redir);
    (void)redir_turn(redir, 0);
    redir_free(redir);
    uvc_model_free(sim.camera);
    ptp_model_free(sim.scanner);
    while (sim.kept_count > 0)
        free(sim.kept[--sim.kept_count]);
    free(sim.kept);
    return 0;
}
