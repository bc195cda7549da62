/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/device/umock_v4l2.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <umockdev.h>
#include <unistd.h>

enum { MOST_CAMERAS = 8, MOST_BUFFERS = 8, MOST_FRAMES = 256, MOST_COUNTED = 32 };

struct frame {
    uint8_t *bytes;
    size_t size;
    uint32_t flags;
};

struct buffer {
    int is_queued;
    unsigned long address; /* USERPTR */
    uint32_t length;
};

struct counted {
    unsigned long request;
    unsigned asked, failing;
    int error;
};

struct v4l2_mock_camera {
    struct v4l2_mock *mock;
    unsigned number;
    struct v4l2_mock_recipe recipe; /* its controls hold the present values */
    UMockdevIoctlBase *handler;
    int is_plugged, is_gone, is_streaming;
    struct v4l2_pix_format format;
    uint32_t memory, count;
    struct buffer buffer[MOST_BUFFERS];
    uint8_t *map; /* the node's file */
    size_t map_size;
    struct frame frame[MOST_FRAMES];
    size_t frame_count;
    struct counted counted[MOST_COUNTED];
};

struct v4l2_mock {
    UMockdevTestbed *testbed;
    char *root;
    pthread_mutex_t mutex;
    struct v4l2_mock_camera camera[MOST_CAMERAS];
};

static gboolean answer(UMockdevIoctlClient *client, long result, int error)
{
    umockdev_ioctl_client_complete(client, error ? -1 : result, error);
    return TRUE;
}

static struct counted *count_of(struct v4l2_mock_camera *camera, unsigned long request)
{
    size_t i = 0;

    while (i < MOST_COUNTED - 1 && camera->counted[i].request &&
           camera->counted[i].request != request)
        i++;
    camera->counted[i].request = request;
    return &camera->counted[i];
}

static size_t room_of(const struct v4l2_mock_camera *camera)
{
    return ((size_t)camera->format.sizeimage + 4095) / 4096 * 4096;
}

static void unmap(struct v4l2_mock_camera *camera)
{
    if (camera->map)
        (void)munmap(camera->map, camera->map_size);
    camera->map = NULL;
}

/* The node's file becomes as long as all buffers: whoever maps it sees what is written there. */
static int map_node(struct v4l2_mock_camera *camera)
{
    char path[400];
    int fd;

    unmap(camera);
    (void)snprintf(path, sizeof path, "%s/dev/video%u", camera->mock->root, camera->number);
    fd = open(path, O_RDWR);
    camera->map_size = room_of(camera) * camera->count;
    if (fd < 0 || ftruncate(fd, (off_t)camera->map_size) < 0)
        abort();
    camera->map = mmap(NULL, camera->map_size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    (void)close(fd);
    return camera->map == MAP_FAILED ? ENOMEM : 0;
}

static uint32_t row_of(uint32_t fourcc, uint32_t width)
{
    switch (fourcc) {
    case V4L2_PIX_FMT_GREY:
    case V4L2_PIX_FMT_NV12:
    case V4L2_PIX_FMT_SRGGB8:
        return width;
    case V4L2_PIX_FMT_RGB24:
    case V4L2_PIX_FMT_BGR24:
        return 3 * width;
    case V4L2_PIX_FMT_MJPEG:
        return 0;
    default:
        return 2 * width;
    }
}

static void set_format(struct v4l2_mock_camera *camera, struct v4l2_pix_format *pixels)
{
    const struct v4l2_mock_recipe *const recipe = &camera->recipe;
    const struct v4l2_mock_size *size = &recipe->size[0];
    uint32_t row;

    for (size_t i = 0; i < V4L2_MOCK_SIZES; i++) {
        if (recipe->size[i].fourcc == pixels->pixelformat &&
            recipe->size[i].width == pixels->width && recipe->size[i].height == pixels->height)
            size = &recipe->size[i];
    }
    row = row_of(size->fourcc, size->width);
    row += row ? recipe->padding : 0;
    *pixels = (struct v4l2_pix_format){
        .width = size->width,
        .height = size->height,
        .pixelformat = size->fourcc,
        .field = V4L2_FIELD_NONE,
        .bytesperline = row,
        .sizeimage = row ? row * size->height : 2 * size->width * size->height,
        .colorspace = recipe->colorspace,
        .priv = V4L2_PIX_FMT_PRIV_MAGIC,
        .ycbcr_enc = recipe->encoding,
        .quantization = recipe->quantization,
    };
    if (size->fourcc == V4L2_PIX_FMT_NV12)
        pixels->sizeimage = row * size->height / 2 * 3;
    camera->format = *pixels;
}

static int query_caps(struct v4l2_mock_camera *camera, struct v4l2_capability *caps)
{
    const struct v4l2_mock_recipe *const recipe = &camera->recipe;

    (void)snprintf((char *)caps->driver, sizeof caps->driver, "mock");
    (void)snprintf((char *)caps->card, sizeof caps->card, "%s", recipe->card);
    (void)snprintf((char *)caps->bus_info, sizeof caps->bus_info, "usb-mock-%u", camera->number);
    caps->version = 6 << 16;
    caps->device_caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_EXT_PIX_FORMAT;
    if (!recipe->no_mmap || !recipe->no_userptr)
        caps->device_caps |= V4L2_CAP_STREAMING;
    if (recipe->has_read)
        caps->device_caps |= V4L2_CAP_READWRITE;
    caps->capabilities = caps->device_caps | V4L2_CAP_DEVICE_CAPS;
    return 0;
}

static int enum_formats(const struct v4l2_mock_camera *camera, struct v4l2_fmtdesc *format)
{
    uint32_t at = 0, last = 0;

    for (size_t i = 0; i < V4L2_MOCK_SIZES && camera->recipe.size[i].fourcc; i++) {
        if (camera->recipe.size[i].fourcc == last)
            continue;
        last = camera->recipe.size[i].fourcc;
        if (at++ == format->index) {
            format->pixelformat = last;
            format->flags = last == V4L2_PIX_FMT_MJPEG ? V4L2_FMT_FLAG_COMPRESSED : 0;
            return 0;
        }
    }
    return EINVAL;
}

static int enum_sizes(const struct v4l2_mock_camera *camera, struct v4l2_frmsizeenum *size)
{
    uint32_t at = 0;

    for (size_t i = 0; i < V4L2_MOCK_SIZES && camera->recipe.size[i].fourcc; i++) {
        if (camera->recipe.size[i].fourcc != size->pixel_format || at++ != size->index)
            continue;
        size->type = V4L2_FRMSIZE_TYPE_DISCRETE;
        size->discrete.width = camera->recipe.size[i].width;
        size->discrete.height = camera->recipe.size[i].height;
        return 0;
    }
    return EINVAL;
}

static struct v4l2_mock_control *find_control(struct v4l2_mock_camera *camera, uint32_t id)
{
    for (size_t i = 0; i < V4L2_MOCK_CONTROLS; i++) {
        if (camera->recipe.control[i].id == id && id)
            return &camera->recipe.control[i];
    }
    return NULL;
}

static uint32_t flags_of(struct v4l2_mock_camera *camera, const struct v4l2_mock_control *control)
{
    const struct v4l2_mock_control *const ruler = find_control(camera, control->rules);
    const int manual = control->rules == V4L2_CID_EXPOSURE_AUTO ? V4L2_EXPOSURE_MANUAL : 0;

    return control->flags | (ruler && ruler->value != manual ? V4L2_CTRL_FLAG_INACTIVE : 0U);
}

static struct v4l2_mock_control *next_control(struct v4l2_mock_camera *camera, uint32_t id)
{
    struct v4l2_mock_control *next = NULL;

    for (size_t i = 0; i < V4L2_MOCK_CONTROLS; i++) {
        struct v4l2_mock_control *const control = &camera->recipe.control[i];

        if (control->id > id && (!next || control->id < next->id))
            next = control;
    }
    return next;
}

static int query_control(struct v4l2_mock_camera *camera, struct v4l2_queryctrl *query)
{
    const uint32_t next = query->id & (V4L2_CTRL_FLAG_NEXT_CTRL | V4L2_CTRL_FLAG_NEXT_COMPOUND);
    const struct v4l2_mock_control *const control =
        next ? next_control(camera, query->id & ~next) : find_control(camera, query->id);

    if (!control)
        return EINVAL;
    *query = (struct v4l2_queryctrl){ .id = control->id,
                                      .type = V4L2_CTRL_TYPE_INTEGER,
                                      .minimum = control->minimum,
                                      .maximum = control->maximum,
                                      .step = 1,
                                      .default_value = control->value,
                                      .flags = flags_of(camera, control) };
    (void)snprintf((char *)query->name, sizeof query->name, "Control %x", control->id);
    return 0;
}

static int get_control(struct v4l2_mock_camera *camera, struct v4l2_control *value)
{
    const struct v4l2_mock_control *const control = find_control(camera, value->id);

    if (control)
        value->value = control->value;
    return control ? 0 : EINVAL;
}

static int set_control(struct v4l2_mock_camera *camera, struct v4l2_control *value)
{
    struct v4l2_mock_control *const control = find_control(camera, value->id);

    if (!control)
        return EINVAL;
    if (control->set_errno)
        return control->set_errno;
    if (flags_of(camera, control) & V4L2_CTRL_FLAG_GRABBED)
        return EBUSY;
    if (value->value < control->minimum || value->value > control->maximum)
        return ERANGE;
    if (!control->is_stuck)
        control->value = value->value;
    return 0;
}

static int request_buffers(struct v4l2_mock_camera *camera, struct v4l2_requestbuffers *request)
{
    const struct v4l2_mock_recipe *const recipe = &camera->recipe;

    if (request->memory != V4L2_MEMORY_MMAP && request->memory != V4L2_MEMORY_USERPTR)
        return EINVAL;
    if (request->memory == V4L2_MEMORY_MMAP ? recipe->no_mmap : recipe->no_userptr)
        return EINVAL;
    request->count = request->count < MOST_BUFFERS ? request->count : MOST_BUFFERS;
    camera->memory = request->memory;
    camera->count = request->count;
    camera->is_streaming = 0;
    memset(camera->buffer, 0, sizeof camera->buffer);
    if (request->memory == V4L2_MEMORY_USERPTR || camera->count == 0 || recipe->is_pty)
        return 0;
    return map_node(camera);
}

static int query_buffer(const struct v4l2_mock_camera *camera, struct v4l2_buffer *buffer)
{
    if (buffer->index >= camera->count)
        return EINVAL;
    buffer->length = camera->format.sizeimage;
    buffer->m.offset = (uint32_t)(buffer->index * room_of(camera));
    buffer->flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
    return 0;
}

static int queue_buffer(struct v4l2_mock_camera *camera, const struct v4l2_buffer *buffer)
{
    struct buffer *const own = &camera->buffer[buffer->index % MOST_BUFFERS];

    if (buffer->index >= camera->count || own->is_queued)
        return EINVAL;
    own->is_queued = 1;
    if (camera->memory == V4L2_MEMORY_USERPTR) {
        own->address = buffer->m.userptr;
        own->length = buffer->length;
        return own->length >= camera->format.sizeimage ? 0 : EINVAL;
    }
    return 0;
}

static void drop_first(struct v4l2_mock_camera *camera)
{
    free(camera->frame[0].bytes);
    camera->frame_count--;
    memmove(camera->frame, camera->frame + 1, camera->frame_count * sizeof camera->frame[0]);
}

static int dequeue_buffer(struct v4l2_mock_camera *camera, UMockdevIoctlData *data)
{
    struct v4l2_buffer *const buffer = (void *)data->data;
    const struct frame *const frame = &camera->frame[0];
    uint32_t i = 0;

    while (i < camera->count && !camera->buffer[i].is_queued)
        i++;
    if (!camera->is_streaming)
        return EINVAL;
    if (i == camera->count || camera->frame_count == 0)
        return EAGAIN;
    buffer->index = i;
    buffer->bytesused = (uint32_t)frame->size;
    buffer->length = camera->format.sizeimage;
    buffer->flags = frame->flags | V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
    buffer->field = V4L2_FIELD_NONE;
    if (camera->memory == V4L2_MEMORY_MMAP) {
        buffer->m.offset = (uint32_t)(i * room_of(camera));
        memcpy(camera->map + buffer->m.offset, frame->bytes, frame->size);
    } else {
        UMockdevIoctlData *memory;

        buffer->m.userptr = camera->buffer[i].address;
        memory = umockdev_ioctl_data_resolve(data, offsetof(struct v4l2_buffer, m.userptr),
                                             frame->size, NULL);
        if (!memory)
            return EFAULT;
        memcpy(memory->data, frame->bytes, frame->size);
        umockdev_ioctl_data_unref(memory);
    }
    camera->buffer[i].is_queued = 0;
    drop_first(camera);
    return 0;
}

static int handle(struct v4l2_mock_camera *camera, unsigned long request, UMockdevIoctlData *data)
{
    struct v4l2_format *const format = (void *)data->data;

    switch (request) {
    case VIDIOC_QUERYCAP:
        return query_caps(camera, (void *)data->data);
    case VIDIOC_ENUM_FMT:
        return enum_formats(camera, (void *)data->data);
    case VIDIOC_ENUM_FRAMESIZES:
        return enum_sizes(camera, (void *)data->data);
    case VIDIOC_S_FMT:
    case VIDIOC_TRY_FMT:
        set_format(camera, &format->fmt.pix);
        return 0;
    case VIDIOC_G_FMT:
        format->fmt.pix = camera->format;
        return 0;
    case VIDIOC_QUERYCTRL:
        return query_control(camera, (void *)data->data);
    case VIDIOC_G_CTRL:
        return get_control(camera, (void *)data->data);
    case VIDIOC_S_CTRL:
        return set_control(camera, (void *)data->data);
    case VIDIOC_REQBUFS:
        return request_buffers(camera, (void *)data->data);
    case VIDIOC_QUERYBUF:
        return query_buffer(camera, (void *)data->data);
    case VIDIOC_QBUF:
        return queue_buffer(camera, (void *)data->data);
    case VIDIOC_DQBUF:
        return dequeue_buffer(camera, data);
    case VIDIOC_STREAMON:
    case VIDIOC_STREAMOFF:
        camera->is_streaming = request == VIDIOC_STREAMON;
        for (size_t i = 0; i < MOST_BUFFERS && !camera->is_streaming; i++)
            camera->buffer[i].is_queued = 0;
        return 0;
    case VIDIOC_S_PARM: /* any rate, but none above 30 */
    {
        struct v4l2_fract *const time =
            &((struct v4l2_streamparm *)data->data)->parm.capture.timeperframe;

        time->denominator = time->denominator > 30 * time->numerator ? 30 : time->denominator;
        return 0;
    }
    default:
        return ENOTTY;
    }
}

static gboolean on_ioctl(UMockdevIoctlBase *handler, UMockdevIoctlClient *client, void *context)
{
    struct v4l2_mock_camera *const camera = context;
    const unsigned long request = (uint32_t)umockdev_ioctl_client_get_request(client);
    UMockdevIoctlData *const arg = umockdev_ioctl_client_get_arg(client);
    UMockdevIoctlData *data = NULL;
    struct counted *counted;
    int error;

    (void)handler;
    if (_IOC_TYPE(request) != 'V')
        return answer(client, -1, ENOTTY);
    data = umockdev_ioctl_data_resolve(arg, 0, _IOC_SIZE(request), NULL);
    (void)pthread_mutex_lock(&camera->mock->mutex);
    counted = count_of(camera, request);
    counted->asked++;
    error = counted->failing ? counted->error : 0;
    counted->failing -= counted->failing > 0;
    if (camera->is_gone)
        error = ENODEV;
    if (!error)
        error = data ? handle(camera, request, data) : ENOTTY;
    (void)pthread_mutex_unlock(&camera->mock->mutex);
    if (data)
        umockdev_ioctl_data_unref(data);
    return answer(client, 0, error);
}

/* read() gives the next frame, or nothing. */
static gboolean on_read(UMockdevIoctlBase *handler, UMockdevIoctlClient *client, void *context)
{
    struct v4l2_mock_camera *const camera = context;
    UMockdevIoctlData *const arg = umockdev_ioctl_client_get_arg(client);
    long got = 0;
    int error = 0;

    (void)handler;
    (void)pthread_mutex_lock(&camera->mock->mutex);
    if (camera->is_gone) {
        error = ENODEV;
    } else if (camera->frame_count == 0) {
        error = EAGAIN;
    } else {
        const struct frame *const frame = &camera->frame[0];

        got = frame->size < (size_t)arg->data_len ? (long)frame->size : arg->data_len;
        umockdev_ioctl_data_update(arg, 0, frame->bytes, (gint)got);
        drop_first(camera);
    }
    (void)pthread_mutex_unlock(&camera->mock->mutex);
    return answer(client, got, error);
}

struct v4l2_mock *v4l2_mock_new(void)
{
    struct v4l2_mock *const mock = calloc(1, sizeof *mock);

    if (!mock)
        abort();
    mock->testbed = umockdev_testbed_new();
    if (!umockdev_in_mock_environment()) {
        g_object_unref(mock->testbed);
        free(mock);
        return NULL;
    }
    mock->root = umockdev_testbed_get_root_dir(mock->testbed);
    (void)pthread_mutex_init(&mock->mutex, NULL);
    return mock;
}

const char *v4l2_mock_root(const struct v4l2_mock *mock)
{
    return mock->root;
}

static void link_path(const struct v4l2_mock_camera *camera, const char *tail, char *to,
                      size_t size)
{
    (void)snprintf(to, size, "%s/dev/v4l%s", camera->mock->root, tail);
}

static void make_link(const struct v4l2_mock_camera *camera)
{
    char path[500], tail[200], target[40];

    if (!camera->recipe.by_id)
        return;
    link_path(camera, "", path, sizeof path);
    (void)mkdir(path, 0755);
    link_path(camera, "/by-id", path, sizeof path);
    (void)mkdir(path, 0755);
    (void)snprintf(tail, sizeof tail, "/by-id/%s", camera->recipe.by_id);
    link_path(camera, tail, path, sizeof path);
    (void)snprintf(target, sizeof target, "../../video%u", camera->number);
    if (symlink(target, path) < 0)
        abort();
}

static void check(gboolean done, GError *error, const char *what)
{
    if (done)
        return;
    (void)fprintf(stderr, "umockdev: %s: %s\n", what, error ? error->message : "refused");
    abort();
}

/* The USB device, its interface, and the node that hangs on that. */
static char *describe_usb(const struct v4l2_mock_recipe *recipe)
{
    GString *const text = g_string_new(recipe->descriptors ? "H: descriptors=" : "");

    for (size_t i = 0; recipe->descriptors && i < recipe->descriptors_size; i++)
        g_string_append_printf(text, "%02x", recipe->descriptors[i]);
    if (recipe->descriptors)
        (void)g_string_append_c(text, '\n');
    return g_string_free(text, FALSE);
}

static void add(const struct v4l2_mock_camera *camera)
{
    const unsigned n = camera->number;
    UMockdevTestbed *const testbed = camera->mock->testbed;
    GError *error = NULL;
    char *const usb = describe_usb(&camera->recipe);
    char *const text = g_strdup_printf(
        "P: /devices/pci0000:00/usb1/1-%u\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\n"
        "A: serial=%s\\n\n%s\n"
        "P: /devices/pci0000:00/usb1/1-%u/1-%u:1.0\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_interface\n\n"
        "P: /devices/pci0000:00/usb1/1-%u/1-%u:1.0/video4linux/video%u\n"
        "N: video%u%s\n"
        "E: SUBSYSTEM=video4linux\nE: DEVNAME=/dev/video%u\nE: MAJOR=81\nE: MINOR=%u\n"
        "E: ID_V4L_CAPABILITIES=:capture:\n"
        "A: dev=81:%u\\n\nA: index=0\\n\nA: name=%s\\n\nL: device=../../../1-%u:1.0\n",
        n, camera->recipe.serial, usb, n, n, n, n, n, n, camera->recipe.is_pty ? "" : "=00", n, n,
        n, camera->recipe.card, n);

    check(umockdev_testbed_add_from_string(testbed, text, &error), error, text);
    g_free(text);
    g_free(usb);
}

struct v4l2_mock_camera *v4l2_mock_plug(struct v4l2_mock *mock, unsigned number,
                                        const struct v4l2_mock_recipe *recipe)
{
    struct v4l2_mock_camera *const camera = &mock->camera[number];
    struct v4l2_pix_format first = { 0 };
    GError *error = NULL;
    char node[40];

    *camera = (struct v4l2_mock_camera){
        .mock = mock, .number = number, .recipe = *recipe, .is_plugged = 1
    };
    set_format(camera, &first);
    (void)snprintf(node, sizeof node, "/dev/video%u", number);
    camera->handler = umockdev_ioctl_base_new();
    (void)g_signal_connect(camera->handler, "handle-ioctl", G_CALLBACK(on_ioctl), camera);
    if (recipe->has_read)
        (void)g_signal_connect(camera->handler, "handle-read", G_CALLBACK(on_read), camera);
    check(umockdev_testbed_attach_ioctl(mock->testbed, node, camera->handler, &error), error, node);
    add(camera);
    make_link(camera);
    return camera;
}

void v4l2_mock_unplug(struct v4l2_mock_camera *camera)
{
    struct v4l2_mock *const mock = camera->mock;
    const unsigned n = camera->number;
    char path[500], tail[200];

    (void)pthread_mutex_lock(&mock->mutex);
    camera->is_gone = 1;
    (void)pthread_mutex_unlock(&mock->mutex);
    if (camera->recipe.by_id) {
        (void)snprintf(tail, sizeof tail, "/by-id/%s", camera->recipe.by_id);
        link_path(camera, tail, path, sizeof path);
        (void)unlink(path);
    }
    (void)snprintf(path, sizeof path,
                   "/sys/devices/pci0000:00/usb1/1-%u/1-%u:1.0/video4linux/video%u", n, n, n);
    umockdev_testbed_uevent(mock->testbed, path, "remove");
    umockdev_testbed_remove_device(mock->testbed, path);
    (void)snprintf(path, sizeof path, "/sys/devices/pci0000:00/usb1/1-%u", n);
    umockdev_testbed_remove_device(mock->testbed, path);
}

/* Only when nobody has it open any more. */
static void pull_out(struct v4l2_mock_camera *camera)
{
    char node[40];

    if (!camera->is_plugged)
        return;
    (void)snprintf(node, sizeof node, "/dev/video%u", camera->number);
    (void)umockdev_testbed_detach_ioctl(camera->mock->testbed, node, NULL);
    g_clear_object(&camera->handler);
    while (camera->frame_count)
        drop_first(camera);
    unmap(camera);
    camera->is_plugged = 0;
}

void v4l2_mock_free(struct v4l2_mock *mock)
{
    if (!mock)
        return;
    for (size_t i = 0; i < MOST_CAMERAS; i++)
        pull_out(&mock->camera[i]);
    g_object_unref(mock->testbed);
    (void)pthread_mutex_destroy(&mock->mutex);
    g_free(mock->root);
    free(mock);
}

void v4l2_mock_push(struct v4l2_mock_camera *camera, const void *bytes, size_t size, uint32_t flags)
{
    uint8_t *const copy = malloc(size ? size : 1);

    if (!copy || camera->frame_count == MOST_FRAMES)
        abort();
    memcpy(copy, bytes, size);
    (void)pthread_mutex_lock(&camera->mock->mutex);
    camera->frame[camera->frame_count++] = (struct frame){ copy, size, flags };
    (void)pthread_mutex_unlock(&camera->mock->mutex);
}

size_t v4l2_mock_waiting(struct v4l2_mock_camera *camera)
{
    size_t count;

    (void)pthread_mutex_lock(&camera->mock->mutex);
    count = camera->frame_count;
    (void)pthread_mutex_unlock(&camera->mock->mutex);
    return count;
}

void v4l2_mock_fail(struct v4l2_mock_camera *camera, unsigned long request, int error,
                    unsigned count)
{
    struct counted *counted;

    (void)pthread_mutex_lock(&camera->mock->mutex);
    counted = count_of(camera, request);
    counted->error = error;
    counted->failing = count;
    (void)pthread_mutex_unlock(&camera->mock->mutex);
}

unsigned v4l2_mock_asked(struct v4l2_mock_camera *camera, unsigned long request)
{
    unsigned asked;

    (void)pthread_mutex_lock(&camera->mock->mutex);
    asked = count_of(camera, request)->asked;
    (void)pthread_mutex_unlock(&camera->mock->mutex);
    return asked;
}

void v4l2_mock_turn(struct v4l2_mock_camera *camera, uint32_t id, int32_t value)
{
    (void)pthread_mutex_lock(&camera->mock->mutex);
    find_control(camera, id)->value = value;
    (void)pthread_mutex_unlock(&camera->mock->mutex);
}

int32_t v4l2_mock_value(struct v4l2_mock_camera *camera, uint32_t id)
{
    int32_t value;

    (void)pthread_mutex_lock(&camera->mock->mutex);
    value = find_control(camera, id)->value;
    (void)pthread_mutex_unlock(&camera->mock->mutex);
    return value;
}
