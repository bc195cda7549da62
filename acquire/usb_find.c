/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/usb_find.h"

#include <libusb.h>
#include <stdio.h>

static int is_bulk(const struct libusb_endpoint_descriptor *endpoint, int in)
{
    return (endpoint->bmAttributes & 3) == LIBUSB_TRANSFER_TYPE_BULK &&
           !in == !(endpoint->bEndpointAddress & LIBUSB_ENDPOINT_IN);
}

static int find_pipes_of(const struct libusb_interface_descriptor *setting,
                         struct gsn_usb_pipes *ret_pipes)
{
    struct gsn_usb_pipes pipes = { .interface = setting->bInterfaceNumber,
                                   .alternate = setting->bAlternateSetting };

    if (setting->bInterfaceClass != LIBUSB_CLASS_IMAGE || setting->bInterfaceSubClass != 1 ||
        setting->bInterfaceProtocol != 1)
        return 0;
    for (int i = 0; i < setting->bNumEndpoints; i++) {
        const struct libusb_endpoint_descriptor *const endpoint = &setting->endpoint[i];
        const uint16_t packet = endpoint->wMaxPacketSize & 0x7ff;

        if (is_bulk(endpoint, 1)) {
            pipes.in = endpoint->bEndpointAddress;
            pipes.in_packet = packet;
        } else if (is_bulk(endpoint, 0)) {
            pipes.out = endpoint->bEndpointAddress;
        } else if ((endpoint->bmAttributes & 3) == LIBUSB_TRANSFER_TYPE_INTERRUPT) {
            pipes.event = endpoint->bEndpointAddress;
            pipes.event_packet = packet;
        }
    }
    *ret_pipes = pipes;
    return pipes.in && pipes.out && pipes.in_packet >= 8;
}

int gsn_usb_find_pipes(libusb_device *device, struct gsn_usb_pipes *ret_pipes)
{
    struct libusb_config_descriptor *config;
    int found = 0;

    if (libusb_get_active_config_descriptor(device, &config) < 0)
        return 0;
    for (int i = 0; i < config->bNumInterfaces && !found; i++)
        for (int k = 0; k < config->interface[i].num_altsetting && !found; k++)
            found = find_pipes_of(&config->interface[i].altsetting[k], ret_pipes);
    libusb_free_config_descriptor(config);
    return found;
}

/* Descriptors' texts end in sentences and rows: no control characters. */
static void read_text(libusb_device_handle *handle, uint8_t index, char *ret_text, size_t size)
{
    int length = 0;

    if (index)
        length = libusb_get_string_descriptor_ascii(handle, index, (unsigned char *)ret_text,
                                                    (int)size - 1);
    ret_text[length > 0 ? length : 0] = '\0';
    for (char *at = ret_text; *at; at++)
        if (*at < ' ' || *at > '~')
            *at = '?';
}

void gsn_usb_describe(libusb_device *device, struct gsn_ptp_usb_device *ret_described)
{
    struct gsn_ptp_usb_device described = { .bus = libusb_get_bus_number(device),
                                            .number = libusb_get_device_address(device) };
    struct libusb_device_descriptor descriptor = { 0 };
    libusb_device_handle *handle = NULL;
    char maker[60], product[60];

    (void)libusb_get_device_descriptor(device, &descriptor);
    described.vendor = descriptor.idVendor;
    described.product = descriptor.idProduct;
    described.refused = libusb_open(device, &handle) < 0;
    if (!described.refused) {
        read_text(handle, descriptor.iSerialNumber, described.serial, sizeof described.serial);
        read_text(handle, descriptor.iManufacturer, maker, sizeof maker);
        read_text(handle, descriptor.iProduct, product, sizeof product);
        (void)snprintf(described.name, sizeof described.name, "%s%s%s", maker,
                       maker[0] && product[0] ? " " : "", product);
        libusb_close(handle);
    }
    *ret_described = described;
}

int gsn_usb_look(libusb_context *context, const struct gsn_usb_address *address,
                 struct gsn_ptp_usb_devices *ret_devices, size_t *ret_matches,
                 libusb_device **ret_device, struct gsn_error *err)
{
    libusb_device **list, *match = NULL;
    const ssize_t count = libusb_get_device_list(context, &list);
    size_t matches = 0;
    struct gsn_usb_pipes pipes;

    if (count < 0)
        return gsn_fail(err, count == LIBUSB_ERROR_NO_MEM ? GSN_E_NOMEM : GSN_E_IO,
                        "the USB devices cannot be listed: %s", libusb_strerror((int)count));
    ret_devices->count = 0;
    for (ssize_t i = 0; i < count && ret_devices->count < GSN_PTP_USB_MOST; i++) {
        struct gsn_ptp_usb_device *const at = &ret_devices->at[ret_devices->count];

        if (!gsn_usb_find_pipes(list[i], &pipes))
            continue;
        gsn_usb_describe(list[i], at);
        ret_devices->count++;
        if (address && gsn_usb_address_matches(address, at->vendor, at->product, at->serial) &&
            matches++ == 0)
            match = list[i];
    }
    if (ret_device)
        *ret_device = matches == 1 ? libusb_ref_device(match) : NULL;
    if (ret_matches)
        *ret_matches = matches;
    libusb_free_device_list(list, 1);
    return GSN_OK;
}

/* "04a9:31c0 SN0001, 1209:0001 (may not be opened)" of those that answer to address; NULL: all. */
static void say_devices(const struct gsn_ptp_usb_devices *devices,
                        const struct gsn_usb_address *address, char *ret_text, size_t size)
{
    size_t used = 0;

    ret_text[0] = '\0';
    for (size_t i = 0; i < devices->count && used < size; i++) {
        const struct gsn_ptp_usb_device *const at = &devices->at[i];

        if (address && !gsn_usb_address_matches(address, at->vendor, at->product, at->serial))
            continue;
        used +=
            (size_t)snprintf(ret_text + used, size - used, "%s%04x:%04x%s%s%s", used ? ", " : "",
                             at->vendor, at->product, at->serial[0] ? ":" : "", at->serial,
                             at->refused ? " (may not be opened)" : "");
    }
}

static int any_refused(const struct gsn_ptp_usb_devices *devices)
{
    for (size_t i = 0; i < devices->count; i++)
        if (devices->at[i].refused)
            return 1;
    return 0;
}

int gsn_usb_explain(const char *rest, const struct gsn_usb_address *address, size_t matches,
                    const struct gsn_ptp_usb_devices *devices, struct gsn_error *err)
{
    char text[240];

    say_devices(devices, matches > 1 ? address : NULL, text, sizeof text);
    if (matches > 1)
        return gsn_fail(err, GSN_E_INPUT,
                        "%zu scanners or cameras answer to \"%.60s\": %s; name one of them",
                        matches, rest, text);
    if (any_refused(devices))
        return gsn_fail(err, GSN_E_IO,
                        "no scanner or camera answers to \"%.60s\", but there is %s: see that the "
                        "udev rules are installed and this account is in the device's group",
                        rest, text);
    return gsn_fail(err, GSN_E_NOTFOUND,
                    "no scanner or camera (USB Still Image class) answers to \"%.60s\"%s%s; is it "
                    "switched on and set to PTP?",
                    rest, text[0] ? "; there is " : "", text);
}

int gsn_usb_start(libusb_context **ret_context, struct gsn_error *err)
{
    const int r = libusb_init(ret_context);

    if (r < 0)
        return gsn_fail(err, r == LIBUSB_ERROR_NO_MEM ? GSN_E_NOMEM : GSN_E_IO,
                        "USB is not available here: %s", libusb_strerror(r));
    return GSN_OK;
}

int gsn_ptp_usb_list(struct gsn_ptp_usb_devices *ret_devices, struct gsn_error *err)
{
    struct gsn_ptp_usb_devices devices;
    libusb_context *context;
    int r = gsn_usb_start(&context, err);

    if (r < 0)
        return r;
    r = gsn_usb_look(context, NULL, &devices, NULL, NULL, err);
    libusb_exit(context);
    if (r >= 0)
        *ret_devices = devices;
    return r;
}
