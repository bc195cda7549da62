/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/device/umock.h"

#include <errno.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>
#include <linux/ioctl.h>
#include <linux/usbdevice_fs.h>
#include <umockdev.h>

#include "tests/device/usb_standard.h"

enum { MOST_DEVICES = 100, MOST_FLYING = 32, CONTROL_ROOM = 4096 };

/* A request of usbfs that was submitted and not yet reaped. */
struct urb {
    UMockdevIoctlData *data; /* of struct usbdevfs_urb */
    int discarded;
};

struct slot {
    struct umock *umock;
    const struct usb_model *model; /* NULL: nothing is plugged in */
    UMockdevIoctlBase *handler;
    int claimed_by_another, gone;
    struct urb flying[MOST_FLYING];
    size_t flying_count;
};

struct umock {
    UMockdevTestbed *testbed;
    char *root;
    pthread_mutex_t mutex;
    struct slot slot[MOST_DEVICES];
};

static int64_t now_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static gboolean answer(UMockdevIoctlClient *client, long result, int error)
{
    umockdev_ioctl_client_complete(client, result, error);
    return TRUE;
}

/* What the model made of a request, as usbfs says it; 1: nothing yet. */
static int finish(struct slot *slot, struct usbdevfs_urb *urb, long got)
{
    switch (got) {
    case USB_MODEL_NAK:
        return 1;
    case USB_MODEL_STALL:
        urb->status = -EPIPE;
        break;
    case USB_MODEL_BABBLE:
        urb->status = -EOVERFLOW;
        break;
    case USB_MODEL_GONE:
        slot->gone = 1;
        urb->status = -ENODEV;
        break;
    default:
        urb->status = 0;
        urb->actual_length = (int)got;
    }
    return 0;
}

static long try_control(const struct usb_model *model, uint8_t *buffer, size_t size)
{
    uint8_t in[CONTROL_ROOM];
    const size_t room = size - 8 < sizeof in ? size - 8 : sizeof in;
    const int reads = buffer[0] & 0x80;
    const long got =
        usb_standard_control(model, buffer, buffer + 8, reads ? 0 : size - 8, in, reads ? room : 0);

    if (reads && got > 0)
        memcpy(buffer + 8, in, (size_t)got);
    return reads || got < 0 ? got : (long)(size - 8);
}

static int try_urb(struct slot *slot, UMockdevIoctlData *data)
{
    const struct usb_model *const model = slot->model;
    struct usbdevfs_urb *const urb = (void *)data->data;
    const size_t size = (size_t)urb->buffer_length;
    uint8_t *const buffer = urb->buffer;

    urb->actual_length = 0;
    if (urb->type == USBDEVFS_URB_TYPE_CONTROL)
        return finish(slot, urb, try_control(model, buffer, size));
    if (urb->endpoint & 0x80)
        return finish(slot, urb, model->in(model->self, urb->endpoint, buffer, size));
    return finish(slot, urb, model->out(model->self, urb->endpoint, buffer, size));
}

static gboolean submit(struct slot *slot, UMockdevIoctlClient *client, UMockdevIoctlData *arg)
{
    UMockdevIoctlData *const data =
        umockdev_ioctl_data_resolve(arg, 0, sizeof(struct usbdevfs_urb), NULL);
    const struct usbdevfs_urb *const urb = (const void *)data->data;
    UMockdevIoctlData *const buffer = umockdev_ioctl_data_resolve(
        data, offsetof(struct usbdevfs_urb, buffer), (gsize)urb->buffer_length, NULL);

    if (buffer)
        umockdev_ioctl_data_unref(buffer); /* data keeps it */
    if (slot->gone || slot->flying_count == MOST_FLYING) {
        umockdev_ioctl_data_unref(data);
        return answer(client, -1, slot->gone ? ENODEV : ENOMEM);
    }
    slot->flying[slot->flying_count++] = (struct urb){ data, 0 };
    return answer(client, 0, 0);
}

static int is_first_of_its_endpoint(const struct slot *slot, size_t at)
{
    const struct usbdevfs_urb *const urb = (const void *)slot->flying[at].data->data;

    for (size_t i = 0; i < at; i++) {
        const struct usbdevfs_urb *const earlier = (const void *)slot->flying[i].data->data;

        if (!slot->flying[i].discarded && earlier->endpoint == urb->endpoint)
            return 0;
    }
    return 1;
}

static gboolean give_back(struct slot *slot, UMockdevIoctlClient *client, UMockdevIoctlData *arg,
                          size_t at)
{
    UMockdevIoctlData *const data = slot->flying[at].data;
    UMockdevIoctlData *const pointer = umockdev_ioctl_data_resolve(arg, 0, sizeof(void *), NULL);

    slot->flying_count--;
    memmove(&slot->flying[at], &slot->flying[at + 1],
            (slot->flying_count - at) * sizeof slot->flying[0]);
    (void)umockdev_ioctl_data_set_ptr(pointer, 0, data);
    umockdev_ioctl_data_unref(pointer);
    umockdev_ioctl_data_unref(data);
    return answer(client, 0, 0);
}

static gboolean reap(struct slot *slot, UMockdevIoctlClient *client, UMockdevIoctlData *arg)
{
    for (size_t i = 0; i < slot->flying_count; i++) {
        struct usbdevfs_urb *const urb = (void *)slot->flying[i].data->data;

        if (slot->flying[i].discarded) {
            urb->status = -ENOENT;
            return give_back(slot, client, arg, i);
        }
        if (slot->gone)
            urb->status = -ENODEV;
        else if (!is_first_of_its_endpoint(slot, i) || try_urb(slot, slot->flying[i].data))
            continue;
        return give_back(slot, client, arg, i);
    }
    if (!slot->gone)
        (void)usleep(200); /* the node always says that it can be read: do not answer as fast */
    return answer(client, -1, slot->gone ? ENODEV : EAGAIN);
}

static gboolean discard(struct slot *slot, UMockdevIoctlClient *client, UMockdevIoctlData *arg)
{
    gulong address;

    memcpy(&address, arg->data, sizeof address);
    for (size_t i = 0; i < slot->flying_count; i++) {
        if (slot->flying[i].data->client_addr != address)
            continue;
        slot->flying[i].discarded = 1;
        return answer(client, 0, 0);
    }
    return answer(client, -1, EINVAL);
}

static gboolean clear_halt(struct slot *slot, UMockdevIoctlClient *client, UMockdevIoctlData *arg)
{
    UMockdevIoctlData *const data = umockdev_ioctl_data_resolve(arg, 0, sizeof(unsigned), NULL);
    const uint8_t setup[8] = { 0x02, 1, 0, 0, data->data[0] };

    umockdev_ioctl_data_unref(data);
    (void)slot->model->control(slot->model->self, setup, NULL, 0, NULL, 0);
    return answer(client, 0, 0);
}

/* A reset of the bus does at least what the class's request does. */
static gboolean reset(struct slot *slot, UMockdevIoctlClient *client)
{
    static const uint8_t setup[8] = { 0x21, 0x66 };

    (void)slot->model->control(slot->model->self, setup, NULL, 0, NULL, 0);
    return answer(client, 0, 0);
}

static gboolean capabilities(UMockdevIoctlClient *client, UMockdevIoctlData *arg)
{
    UMockdevIoctlData *const data = umockdev_ioctl_data_resolve(arg, 0, sizeof(uint32_t), NULL);
    const uint32_t can = USBDEVFS_CAP_BULK_SCATTER_GATHER | USBDEVFS_CAP_BULK_CONTINUATION |
                         USBDEVFS_CAP_NO_PACKET_SIZE_LIM | USBDEVFS_CAP_REAP_AFTER_DISCONNECT |
                         USBDEVFS_CAP_ZERO_PACKET;

    memcpy(data->data, &can, sizeof can);
    umockdev_ioctl_data_unref(data);
    return answer(client, 0, 0);
}

/* Several requests differ in the size of their argument alone; these are those of this kernel's. */
static gboolean handle(struct slot *slot, UMockdevIoctlClient *client)
{
    const gulong request = umockdev_ioctl_client_get_request(client);
    UMockdevIoctlData *const arg = umockdev_ioctl_client_get_arg(client);

    if (slot->gone && request != USBDEVFS_REAPURB && request != USBDEVFS_REAPURBNDELAY &&
        request != USBDEVFS_DISCARDURB)
        return answer(client, -1, ENODEV);
    switch (request) {
    case USBDEVFS_GET_CAPABILITIES:
        return capabilities(client, arg);
    case USBDEVFS_CLAIMINTERFACE:
    case USBDEVFS_DISCONNECT_CLAIM:
        return answer(client, slot->claimed_by_another ? -1 : 0, EBUSY * slot->claimed_by_another);
    case USBDEVFS_RELEASEINTERFACE:
    case USBDEVFS_SETINTERFACE:
        return answer(client, 0, 0);
    case USBDEVFS_IOCTL: /* no kernel driver is bound */
    case USBDEVFS_GETDRIVER:
        return answer(client, -1, ENODATA);
    case USBDEVFS_CLEAR_HALT:
        return clear_halt(slot, client, arg);
    case USBDEVFS_RESET:
        return reset(slot, client);
    case USBDEVFS_SUBMITURB:
        return submit(slot, client, arg);
    case USBDEVFS_REAPURB:
    case USBDEVFS_REAPURBNDELAY:
        return reap(slot, client, arg);
    case USBDEVFS_DISCARDURB:
        return discard(slot, client, arg);
    default:
        return FALSE;
    }
}

static gboolean on_ioctl(UMockdevIoctlBase *handler, UMockdevIoctlClient *client, void *data)
{
    struct slot *const slot = data;
    gboolean handled;

    (void)handler;
    umock_lock(slot->umock);
    if (slot->model && slot->model->tick)
        slot->model->tick(slot->model->self, now_ms());
    handled = handle(slot, client);
    umock_unlock(slot->umock);
    return handled;
}

struct umock *umock_new(void)
{
    struct umock *const umock = calloc(1, sizeof *umock);

    if (!umock)
        abort();
    umock->testbed = umockdev_testbed_new();
    if (!umockdev_in_mock_environment()) {
        (void)fprintf(stderr, "libumockdev-preload.so.0 is not in LD_PRELOAD\n");
        abort();
    }
    umock->root = umockdev_testbed_get_root_dir(umock->testbed);
    (void)pthread_mutex_init(&umock->mutex, NULL);
    return umock;
}

static void node_of(unsigned number, char to[40])
{
    (void)snprintf(to, 40, "/dev/bus/usb/001/%03u", number);
}

/* Who still has the node open hears no more of it. */
static void forget(struct umock *umock, unsigned number)
{
    struct slot *const slot = &umock->slot[number];
    char node[40];

    if (!slot->handler)
        return;
    node_of(number, node);
    (void)umockdev_testbed_detach_ioctl(umock->testbed, node, NULL);
    umock_lock(umock);
    for (size_t i = 0; i < slot->flying_count; i++)
        umockdev_ioctl_data_unref(slot->flying[i].data);
    slot->flying_count = 0;
    umock_unlock(umock);
    g_clear_object(&slot->handler);
}

void umock_free(struct umock *umock)
{
    if (!umock)
        return;
    for (unsigned i = 0; i < MOST_DEVICES; i++) {
        if (umock->slot[i].model)
            umock_unplug(umock, i);
        forget(umock, i);
    }
    g_object_unref(umock->testbed);
    (void)pthread_mutex_destroy(&umock->mutex);
    g_free(umock->root);
    free(umock);
}

void umock_lock(struct umock *umock)
{
    (void)pthread_mutex_lock(&umock->mutex);
}

void umock_unlock(struct umock *umock)
{
    (void)pthread_mutex_unlock(&umock->mutex);
}

const char *umock_root(const struct umock *umock)
{
    return umock->root;
}

static void check(gboolean done, GError *error, const char *what)
{
    if (done)
        return;
    (void)fprintf(stderr, "umockdev: %s: %s\n", what, error ? error->message : "refused");
    abort();
}

static GString *describe(const struct usb_model *model, unsigned number)
{
    GString *const text = g_string_new(NULL);

    g_string_append_printf(text,
                           "P: /devices/pci0000:00/usb1/1-%u\n"
                           "N: bus/usb/001/%03u\n"
                           "E: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\n"
                           "E: BUSNUM=001\nE: DEVNUM=%03u\n"
                           "E: DEVNAME=/dev/bus/usb/001/%03u\n"
                           "E: ID_USB_INTERFACES=:060101:\nE: ID_SERIAL_SHORT=%s\n"
                           "A: busnum=1\\n\nA: devnum=%u\\n\nA: speed=480\\n\n"
                           "A: bConfigurationValue=1\\n\nH: descriptors=",
                           number, number, number, number,
                           model->strings[3] ? model->strings[3] : "", number);
    for (size_t i = 0; i < 18; i++)
        g_string_append_printf(text, "%02x", model->device[i]);
    for (size_t i = 0; i < model->config_size; i++)
        g_string_append_printf(text, "%02x", model->config[i]);
    g_string_append_c(text, '\n');
    return text;
}

void umock_plug(struct umock *umock, const struct usb_model *model, unsigned number)
{
    struct slot *const slot = &umock->slot[number];
    GString *const text = describe(model, number);
    GError *error = NULL;
    char node[40];

    forget(umock, number);
    node_of(number, node);
    umock_lock(umock);
    *slot = (struct slot){ .umock = umock, .model = model };
    umock_unlock(umock);
    slot->handler = umockdev_ioctl_base_new();
    (void)g_signal_connect(slot->handler, "handle-ioctl", G_CALLBACK(on_ioctl), slot);
    /* Before it is added: who sees it come opens it at once. */
    check(umockdev_testbed_attach_ioctl(umock->testbed, node, slot->handler, &error), error, node);
    check(umockdev_testbed_add_from_string(umock->testbed, text->str, &error), error, node);
    (void)g_string_free(text, TRUE);
}

/* As with usbfs, who has the node open hears ENODEV from now on, however late it asks. */
void umock_unplug(struct umock *umock, unsigned number)
{
    struct slot *const slot = &umock->slot[number];
    char path[80];

    (void)snprintf(path, sizeof path, "/sys/devices/pci0000:00/usb1/1-%u", number);
    umock_lock(umock);
    slot->gone = 1;
    slot->model = NULL;
    umock_unlock(umock);
    umockdev_testbed_uevent(umock->testbed, path, "remove");
    umockdev_testbed_remove_device(umock->testbed, path);
}

void umock_claim(struct umock *umock, unsigned number, int by_another)
{
    umock_lock(umock);
    umock->slot[number].claimed_by_another = by_another != 0;
    umock_unlock(umock);
}
