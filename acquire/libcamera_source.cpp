/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Written for libcamera 0.0.3 and later alike: no alias for lists of roles, transform and
 * orientation left alone, planes mapped once per descriptor. Frames are completed on a thread of
 * libcamera's; they wait in a queue, and an eventfd wakes whoever waits. No exception leaves. */
#include "acquire/libcamera_source.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <new>
#include <string>
#include <vector>

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <unistd.h>

#include <libcamera/libcamera.h>

#include "acquire/camera.h"

namespace
{

using namespace libcamera;

constexpr unsigned buffer_count = 4;
constexpr size_t control_count = 3;
/* libcamera rounds an exposure to rows of the sensor, and a gain to its steps. */
constexpr double tolerance = 0.02;

/* There may be one manager in a process; a second one ends it. */
std::atomic_flag manager_taken = ATOMIC_FLAG_INIT;

class Manager
{
  public:
    ~Manager()
    {
        if (started)
            manager.stop();
        manager_taken.clear();
    }

    CameraManager manager;
    bool started = false;
};

struct Mapping {
    uint8_t *at = nullptr;
    size_t size = 0;
};

struct Locked {
    const char *name, *unit;
    bool has_value, has_automatic; /* controls the camera offers */
    int64_t asked;                 /* -1: what it has */
    int64_t before;                /* of the frame before; -1: none */
    int64_t now;
    bool is_known;
    std::string unlock;
};

class Grabber
{
  public:
    ~Grabber();
    int open(const char *id, const gsn_camera_settings &wanted, gsn_error *err);
    int start_stream(gsn_error *err);
    void stop_stream();
    int take_frame(gsn_frame *ret_frame, int *ret_there, gsn_error *err);
    void give_frame();
    int read_frame(gsn_frame *frame);
    unsigned take_damaged();
    int wait_for_frame(int timeout_ms, int stop_fd, gsn_error *err);
    const char *device() const
    {
        return name.c_str();
    }

  private:
    int find(const char *id, gsn_error *err);
    int configure(gsn_error *err);
    int refuse(const CameraConfiguration &config, gsn_error *err);
    int map_buffers(gsn_error *err);
    int make_requests(gsn_error *err);
    int gone(gsn_error *err) const;
    bool offers(unsigned id) const;
    void list_locked();
    void set_controls(Request *request);
    void note_controls(const ControlList &metadata);
    void on_completed(Request *request);
    void on_disconnected();
    void wake();
    Request *next();
    void describe(gsn_frame *frame) const;
    bool gather(const FrameBuffer *buffer, gsn_frame *frame);

    std::unique_ptr<Manager> manager;
    std::shared_ptr<Camera> camera;
    std::unique_ptr<CameraConfiguration> config;
    std::unique_ptr<FrameBufferAllocator> allocator;
    std::vector<std::unique_ptr<Request>> requests;
    std::map<int, Mapping> mappings;
    std::vector<uint8_t> joined; /* a frame whose planes do not lie behind each other */
    std::string name;
    gsn_camera_settings settings = {};
    bool acquired = false, running = false;
    Request *held = nullptr;
    Locked locked[control_count] = {};
    gsn_frame_control controls[control_count] = {};
    std::string withheld;

    std::mutex mutex; /* of what follows */
    std::deque<Request *> completed;
    bool disconnected = false;
    unsigned damaged = 0;
    int event_fd = -1;
};

Grabber::~Grabber()
{
    stop_stream();
    requests.clear();
    allocator.reset();
    for (const auto &mapping : mappings)
        (void)munmap(mapping.second.at, mapping.second.size);
    if (camera) {
        camera->requestCompleted.disconnect(this);
        camera->disconnected.disconnect(this);
        if (acquired)
            (void)camera->release();
    }
    camera.reset(); /* before its manager */
    manager.reset();
    if (event_fd >= 0)
        (void)close(event_fd);
}

int Grabber::gone(gsn_error *err) const
{
    return gsn_fail(err, GSN_E_NOTFOUND, "%.100s: the camera is gone: plug it in again",
                    name.c_str());
}

int Grabber::find(const char *id, gsn_error *err)
{
    if (manager_taken.test_and_set())
        return gsn_fail(err, GSN_E_BUSY,
                        "libcamera:%.200s: this process has a source of libcamera already", id);
    manager = std::make_unique<Manager>();
    if (manager->manager.start() < 0)
        return gsn_fail(err, GSN_E_IO, "libcamera:%.200s: libcamera does not start", id);
    manager->started = true;
    std::string there;
    for (const auto &one : manager->manager.cameras()) {
        if (one->id() == id)
            camera = one;
        there += (there.empty() ? "" : ", ") + one->id();
    }
    if (!camera)
        return gsn_fail(err, GSN_E_NOTFOUND,
                        "libcamera:%.150s: libcamera lists %zu cameras%s%.200s; a USB camera it "
                        "does not list can be addressed as v4l2:",
                        id, manager->manager.cameras().size(), there.empty() ? "" : ": ",
                        there.c_str());
    const auto model = camera->properties().get(properties::Model);
    name = (model ? std::string(*model) + ", " : std::string()) + id;
    return GSN_OK;
}

int Grabber::refuse(const CameraConfiguration &got, gsn_error *err)
{
    std::string list;
    const StreamFormats &formats = got.at(0).formats();

    for (const auto &format : formats.pixelformats()) {
        list += (list.empty() ? "" : "; ") + format.toString();
        for (const auto &size : formats.sizes(format)) {
            list += " " + size.toString();
            if (list.size() > 220)
                break;
        }
    }
    return gsn_fail(err, GSN_E_INPUT,
                    "%.60s: asked for %s %ux%u, the camera would give %.60s; it has: %.220s",
                    name.c_str(), settings.format->libcamera, settings.width, settings.height,
                    got.at(0).toString().c_str(), list.c_str());
}

int Grabber::configure(gsn_error *err)
{
    const bool raw = strncmp(settings.format->tupltype, "BAYER", 5) == 0;

    if (camera->acquire() < 0)
        return gsn_fail(err, GSN_E_BUSY,
                        "%.100s: another program holds the camera; close that first", name.c_str());
    acquired = true;
    config = camera->generateConfiguration({ raw ? StreamRole::Raw : StreamRole::StillCapture });
    if (!config || config->size() != 1)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "%.100s: the camera takes no %s pictures",
                        name.c_str(), raw ? "raw" : "still");
    StreamConfiguration &stream = config->at(0);
    stream.pixelFormat = PixelFormat::fromString(settings.format->libcamera);
    stream.size = Size(settings.width, settings.height);
    stream.bufferCount = buffer_count;
    const bool valid = config->validate() != CameraConfiguration::Invalid;
    if (!valid || stream.pixelFormat != PixelFormat::fromString(settings.format->libcamera) ||
        stream.size != Size(settings.width, settings.height))
        return refuse(*config, err);
    if (camera->configure(config.get()) < 0)
        return gsn_fail(err, GSN_E_IO, "%.100s: the camera refuses its own configuration",
                        name.c_str());
    return GSN_OK;
}

/* A descriptor may hold several planes at offsets that are no pages: one mapping for all. */
int Grabber::map_buffers(gsn_error *err)
{
    Stream *const stream = config->at(0).stream();

    allocator = std::make_unique<FrameBufferAllocator>(camera);
    if (allocator->allocate(stream) < 0)
        return gsn_fail(err, GSN_E_NOMEM, "%.100s: no buffers for its frames", name.c_str());
    for (const auto &buffer : allocator->buffers(stream)) {
        for (const auto &plane : buffer->planes())
            mappings[plane.fd.get()].size = std::max(
                mappings[plane.fd.get()].size, static_cast<size_t>(plane.offset) + plane.length);
    }
    for (auto &mapping : mappings) {
        void *const at =
            mmap(nullptr, mapping.second.size, PROT_READ, MAP_SHARED, mapping.first, 0);

        if (at == MAP_FAILED) {
            mappings.clear();
            return gsn_fail(err, GSN_E_IO, "%.100s: its frames cannot be mapped: %s", name.c_str(),
                            strerror(errno));
        }
        mapping.second.at = static_cast<uint8_t *>(at);
    }
    return GSN_OK;
}

int Grabber::make_requests(gsn_error *err)
{
    Stream *const stream = config->at(0).stream();

    for (const auto &buffer : allocator->buffers(stream)) {
        std::unique_ptr<Request> request = camera->createRequest();

        if (!request || request->addBuffer(stream, buffer.get()) < 0)
            return gsn_fail(err, GSN_E_IO, "%.100s: the camera takes no requests", name.c_str());
        requests.push_back(std::move(request));
    }
    return GSN_OK;
}

bool Grabber::offers(unsigned id) const
{
    return camera->controls().find(id) != camera->controls().end();
}

void Grabber::list_locked()
{
    const bool ae = offers(controls::AeEnable.id());

    locked[0] = {
        "exposure", "us", offers(controls::ExposureTime.id()), ae, settings.exposure, -1, -1,
        false,      ""
    };
    locked[1] = { "gain", "/ 1000", offers(controls::AnalogueGain.id()), ae, settings.gain, -1, -1,
                  false,  "" };
    locked[2] = { "white balance",
                  "K",
                  offers(controls::ColourTemperature.id()),
                  offers(controls::AwbEnable.id()),
                  settings.white_balance,
                  -1,
                  -1,
                  false,
                  "" };
}

int Grabber::open(const char *id, const gsn_camera_settings &wanted, gsn_error *err)
{
    settings = wanted;
    name = id;
    event_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    if (event_fd < 0)
        return gsn_fail(err, GSN_E_IO, "eventfd: %s", strerror(errno));
    int r = find(id, err);
    if (r >= 0)
        r = configure(err);
    if (r >= 0)
        r = map_buffers(err);
    if (r < 0)
        return r;
    list_locked();
    if (settings.fps && !offers(controls::FrameDurationLimits.id()))
        return gsn_fail(err, GSN_E_INPUT, "%.100s: Fps=%u: the camera's rate cannot be set",
                        name.c_str(), settings.fps);
    camera->requestCompleted.connect(this, &Grabber::on_completed);
    camera->disconnected.connect(this, &Grabber::on_disconnected);
    return GSN_OK;
}

void Grabber::set_controls(Request *request)
{
    ControlList &list = request->controls();

    if (locked[0].has_automatic)
        list.set(controls::AeEnable, false);
    if (locked[2].has_automatic)
        list.set(controls::AwbEnable, false);
    if (locked[0].has_value && settings.exposure >= 0)
        list.set(controls::ExposureTime, static_cast<int32_t>(settings.exposure));
    if (locked[1].has_value && settings.gain >= 0)
        list.set(controls::AnalogueGain, static_cast<float>(settings.gain) / 1000.0F);
    if (locked[2].has_value && settings.white_balance >= 0)
        list.set(controls::ColourTemperature, static_cast<int32_t>(settings.white_balance));
    if (settings.fps) {
        const int64_t limits[2] = { 1000000 / settings.fps, 1000000 / settings.fps };

        list.set(controls::FrameDurationLimits, Span<const int64_t, 2>(limits));
    }
}

int Grabber::start_stream(gsn_error *err)
{
    {
        const std::lock_guard<std::mutex> lock(mutex);
        if (disconnected)
            return gone(err);
    }
    requests.clear();
    int r = make_requests(err);
    if (r < 0)
        return r;
    if (camera->start() < 0)
        return gsn_fail(err, GSN_E_IO, "%.100s: the camera does not start", name.c_str());
    running = true;
    for (const auto &request : requests) {
        set_controls(request.get());
        if (camera->queueRequest(request.get()) < 0)
            return gsn_fail(err, GSN_E_IO, "%.100s: the camera takes no requests", name.c_str());
    }
    return GSN_OK;
}

void Grabber::stop_stream()
{
    if (!running)
        return;
    running = false;
    held = nullptr;
    (void)camera->stop(); /* cancels what is queued; those come through on_completed */
    const std::lock_guard<std::mutex> lock(mutex);
    completed.clear();
}

void Grabber::wake()
{
    const uint64_t one = 1;

    if (write(event_fd, &one, sizeof one) < 0)
        return; /* it is awake already */
}

void Grabber::on_completed(Request *request)
{
    const std::lock_guard<std::mutex> lock(mutex);

    if (request->status() == Request::RequestCancelled)
        return;
    completed.push_back(request);
    wake();
}

void Grabber::on_disconnected()
{
    const std::lock_guard<std::mutex> lock(mutex);

    disconnected = true;
    wake();
}

Request *Grabber::next()
{
    const std::lock_guard<std::mutex> lock(mutex);
    Request *request = nullptr;

    if (!completed.empty()) {
        request = completed.front();
        completed.pop_front();
    }
    return request;
}

void Grabber::note_controls(const ControlList &metadata)
{
    const auto exposure = metadata.get(controls::ExposureTime);
    const auto gain = metadata.get(controls::AnalogueGain);
    const auto kelvin = metadata.get(controls::ColourTemperature);

    for (Locked &one : locked)
        one.before = one.is_known ? one.now : -1;
    locked[0].is_known = exposure.has_value();
    locked[0].now = exposure.value_or(0);
    locked[1].is_known = gain.has_value();
    locked[1].now = std::llround(static_cast<double>(gain.value_or(0)) * 1000);
    locked[2].is_known = kelvin.has_value();
    locked[2].now = kelvin.value_or(0);
}

/* One plane, planes behind each other, or (copied) planes that are not. */
bool Grabber::gather(const FrameBuffer *buffer, gsn_frame *frame)
{
    const auto &planes = buffer->planes();
    const auto &filled = buffer->metadata().planes();
    size_t end = 0;
    bool behind = true;

    frame->size = 0;
    for (size_t i = 0; i < planes.size(); i++) {
        const size_t used = std::min<size_t>(filled[i].bytesused, planes[i].length);

        behind = behind && planes[i].fd.get() == planes[0].fd.get() &&
                 (i == 0 || planes[i].offset == end);
        end = planes[i].offset + used;
        frame->size += used;
    }
    frame->bytes = mappings[planes[0].fd.get()].at + planes[0].offset;
    if (behind)
        return frame->size > 0;
    joined.clear();
    for (size_t i = 0; i < planes.size(); i++) {
        const uint8_t *const at = mappings[planes[i].fd.get()].at + planes[i].offset;

        joined.insert(joined.end(), at,
                      at + std::min<size_t>(filled[i].bytesused, planes[i].length));
    }
    frame->bytes = joined.data();
    return frame->size > 0;
}

const char *matrix_name(const ColorSpace &space)
{
    switch (space.ycbcrEncoding) {
    case ColorSpace::YcbcrEncoding::Rec601:
        return "BT.601";
    case ColorSpace::YcbcrEncoding::Rec709:
        return "BT.709";
    case ColorSpace::YcbcrEncoding::Rec2020:
        return "BT.2020";
    default:
        return "another";
    }
}

const char *transfer_name(const ColorSpace &space)
{
    switch (space.transferFunction) {
    case ColorSpace::TransferFunction::Linear:
        return "linear";
    case ColorSpace::TransferFunction::Srgb:
        return "sRGB";
    default:
        return nullptr;
    }
}

void Grabber::describe(gsn_frame *frame) const
{
    const StreamConfiguration &stream = config->at(0);
    const bool yuv = gsn_pixel_format_is_yuv(settings.format);

    *frame = {};
    frame->format = settings.format;
    frame->width = stream.size.width;
    frame->height = stream.size.height;
    frame->stride = stream.stride;
    frame->device = name.c_str();
    frame->interface = "libcamera";
    if (stream.colorSpace) {
        const ColorSpace &space = *stream.colorSpace;

        frame->colorspace = "as stated";
        frame->matrix = yuv ? matrix_name(space) : nullptr;
        frame->range =
            !yuv ? nullptr : (space.range == ColorSpace::Range::Full ? "full" : "limited");
        frame->transfer = transfer_name(space);
        return;
    }
    frame->colorspace = "not stated, taken as sRGB";
    frame->matrix = yuv ? "BT.601" : nullptr;
    frame->range = yuv ? "limited" : nullptr;
    frame->transfer = gsn_pixel_format_is_raw(settings.format) ? nullptr : "sRGB";
}

int Grabber::take_frame(gsn_frame *ret_frame, int *ret_there, gsn_error *err)
{
    for (Request *request = next(); request; request = next()) {
        const FrameBuffer *const buffer = request->buffers().begin()->second;

        held = request;
        describe(ret_frame);
        note_controls(request->metadata());
        if (buffer->metadata().status == FrameMetadata::FrameSuccess && gather(buffer, ret_frame)) {
            *ret_there = 1;
            return GSN_OK;
        }
        damaged++;
        give_frame();
    }
    const std::lock_guard<std::mutex> lock(mutex);
    *ret_there = 0;
    return disconnected ? gone(err) : GSN_OK;
}

void Grabber::give_frame()
{
    if (!held || !running)
        return;
    held->reuse(Request::ReuseBuffers);
    set_controls(held);
    (void)camera->queueRequest(held); /* a lost one is missed by the silence that follows */
    held = nullptr;
}

/* Why a control is not locked as far as frames tell; empty: it is. */
std::string why_unlocked(const Locked &one)
{
    if (!one.has_automatic && !one.has_value)
        return "the camera has no control for it";
    if (!one.has_automatic)
        return "its automatic cannot be switched off";
    if (!one.is_known)
        return "its value cannot be read back";
    if (one.asked >= 0 && !one.has_value)
        return "its value cannot be set";
    if (one.asked >= 0 && std::abs(static_cast<double>(one.now - one.asked)) >
                              tolerance * static_cast<double>(one.asked))
        return "it was set to " + std::to_string(one.asked) + " and reads " +
               std::to_string(one.now);
    if (one.before != one.now)
        return "it reads otherwise than in the frame before";
    return "";
}

int Grabber::read_frame(gsn_frame *frame)
{
    const size_t count = gsn_pixel_format_is_raw(settings.format) ? 2 : control_count;

    withheld.clear();
    for (size_t i = 0; i < count; i++) {
        Locked &one = locked[i];

        one.unlock = why_unlocked(one);
        controls[i] = { one.name, one.unit, one.now, one.is_known,
                        one.unlock.empty() ? nullptr : one.unlock.c_str() };
        if (!one.unlock.empty())
            withheld += (withheld.empty() ? "" : "; ") + std::string(one.name) +
                        " is not locked: " + one.unlock;
    }
    frame->control = controls;
    frame->control_count = count;
    frame->withheld = withheld.empty() ? nullptr : withheld.c_str();
    return GSN_OK;
}

unsigned Grabber::take_damaged()
{
    const unsigned count = damaged;

    damaged = 0;
    return count;
}

int Grabber::wait_for_frame(int timeout_ms, int stop_fd, gsn_error *err)
{
    pollfd on[2] = { { event_fd, POLLIN, 0 }, { stop_fd, POLLIN, 0 } };
    uint64_t count = 0;

    if (poll(on, 2, timeout_ms) < 0 && errno != EINTR)
        return gsn_fail(err, GSN_E_IO, "waiting: %s", strerror(errno));
    if (on[0].revents && read(event_fd, &count, sizeof count) < 0 && errno != EAGAIN)
        return gsn_fail(err, GSN_E_IO, "waiting: %s", strerror(errno));
    return GSN_OK;
}

int failed(gsn_error *err)
{
    try {
        throw;
    } catch (const std::bad_alloc &) {
        return gsn_fail(err, GSN_E_NOMEM, "out of memory in libcamera");
    } catch (const std::exception &reason) {
        return gsn_fail(err, GSN_E_IO, "libcamera: %.300s", reason.what());
    } catch (...) {
        return gsn_fail(err, GSN_E_IO, "libcamera gave up");
    }
}

int start_grabber(void *self, gsn_error *err)
try {
    return static_cast<Grabber *>(self)->start_stream(err);
} catch (...) {
    return failed(err);
}

void stop_grabber(void *self)
try {
    static_cast<Grabber *>(self)->stop_stream();
} catch (...) {
    (void)failed(nullptr);
}

int grab_frame(void *self, gsn_frame *ret_frame, int *ret_there, gsn_error *err)
try {
    return static_cast<Grabber *>(self)->take_frame(ret_frame, ret_there, err);
} catch (...) {
    return failed(err);
}

void release_frame(void *self)
try {
    static_cast<Grabber *>(self)->give_frame();
} catch (...) {
    (void)failed(nullptr);
}

int read_controls(void *self, gsn_frame *frame, gsn_error *err)
try {
    return static_cast<Grabber *>(self)->read_frame(frame);
} catch (...) {
    return failed(err);
}

unsigned count_damaged(void *self)
{
    return static_cast<Grabber *>(self)->take_damaged();
}

int wait_for_frame(void *self, int timeout_ms, int stop_fd, gsn_error *err)
try {
    return static_cast<Grabber *>(self)->wait_for_frame(timeout_ms, stop_fd, err);
} catch (...) {
    return failed(err);
}

const char *name_device(const void *self)
{
    return static_cast<const Grabber *>(self)->device();
}

void close_grabber(void *self)
try {
    delete static_cast<Grabber *>(self);
} catch (...) {
    (void)failed(nullptr);
}

const gsn_grabber_ops grabber_ops = {
    start_grabber, stop_grabber,   grab_frame,  release_frame, read_controls,
    count_damaged, wait_for_frame, name_device, close_grabber,
};

int open_source(const char *rest, const gsn_source_options *options, void **ret_self,
                gsn_error *err)
try {
    auto grabber = std::make_unique<Grabber>();
    gsn_camera_settings settings;
    int r = gsn_camera_settings_read(options, &settings, err);

    if (r >= 0)
        r = grabber->open(rest, settings, err);
    if (r < 0)
        return r;
    return gsn_camera_new({ &grabber_ops, grabber.release(), buffer_count }, &settings, options,
                          ret_self, err);
} catch (...) {
    return failed(err);
}

} // namespace

extern "C" const gsn_source_ops gsn_libcamera_source_ops = {
    "libcamera",      "video4linux",   gsn_camera_keys,    gsn_camera_check,
    open_source,      gsn_camera_poll, gsn_camera_read,    gsn_camera_acknowledge,
    nullptr,          gsn_camera_wait, gsn_camera_capture, gsn_camera_device,
    gsn_camera_close,
};
