// A USB camera of our own design behind QEMU's usb-redir: the kernel's uvcvideo driver in the guest
// sees a device with exposure and gain whose settings really change its pictures, through the
// project's sensor model.
// usage: uvc_camera SOCKET; ends when QEMU closes the socket
// source: usbredir protocol 0.7; USB Device Class Definition for Video Devices 1.1
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <deque>
#include <optional>
#include <span>
#include <vector>

#include "calib/calib.h"
#include "capture/capture.h"
#include "tests/vm/uvc_scene.h"

namespace penumbra::test {
namespace {

using Bytes = std::vector<std::uint8_t>;
using Clock = std::chrono::steady_clock;

// Little-endian, as USB and usbredir have it.
void put(Bytes& out, std::uint64_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) out.push_back(static_cast<std::uint8_t>(value >> 8 * i));
}
std::uint32_t get(std::span<const std::uint8_t> in, std::size_t at, int bytes) {
  std::uint32_t value = 0;
  for (int i = 0; i < bytes && at + static_cast<std::size_t>(i) < in.size(); ++i)
    value |= static_cast<std::uint32_t>(in[at + static_cast<std::size_t>(i)]) << 8 * i;
  return value;
}

constexpr std::uint8_t kEndpoint = 0x81;
constexpr int kErrors = 5;  // in a row: the host controller tries three times more by itself
constexpr std::uint32_t kFrameBytes = kUvcWidth * kUvcHeight * 2, kPayloadHeader = 2;
constexpr std::uint32_t kFps = 20, kInterval = 10'000'000 / kFps;  // 100 ns

const Bytes& device_descriptor() {
  static const Bytes one = {18,   1,    0x00, 0x02, 0xEF, 0x02, 0x01, 64, 0x09,
                            0x12, 0x01, 0x00, 0x00, 0x01, 1,    2,    0,  1};
  return one;
}

Bytes configuration_descriptor() {
  const auto append = [](Bytes& out, const Bytes& more) {
    out.insert(out.end(), more.begin(), more.end());
  };
  Bytes control = {13, 0x24, 0x01, 0x10, 0x01, 0, 0, 0x40, 0x42, 0x0F, 0x00, 1, 1};
  append(control, {18, 0x24, 0x02, 1, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x0A, 0x00, 0x00});
  append(control, {12, 0x24, 0x05, 2, 1, 0, 0, 2, 0x10, 0x02, 0, 0});  // sharpness, gain
  append(control, {9, 0x24, 0x03, 3, 0x01, 0x01, 0, 2, 0});
  control[5] = static_cast<std::uint8_t>(control.size());
  Bytes frame = {30, 0x24, 0x05, 1, 0};
  put(frame, kUvcWidth, 2);
  put(frame, kUvcHeight, 2);
  const std::uint64_t bits = std::uint64_t{kFrameBytes} * 8 * kFps;
  for (const std::uint64_t v : {bits, bits, std::uint64_t{kFrameBytes}, std::uint64_t{kInterval}})
    put(frame, v, 4);
  frame.push_back(1);
  put(frame, kInterval, 4);
  Bytes format = {27,   0x24, 0x04, 1,    1,    'Y',  'U',  'Y', '2', 0, 0, 0x10, 0, 0x80,
                  0x00, 0x00, 0xAA, 0x00, 0x38, 0x9B, 0x71, 16,  1,   0, 0, 0,    0};
  Bytes stream = {14, 0x24, 0x01, 1, 0, 0, kEndpoint, 0, 3, 0, 0, 0, 1, 0};
  append(stream, format);
  append(stream, frame);
  stream[4] = static_cast<std::uint8_t>(stream.size());
  Bytes out = {9, 2, 0, 0, 2, 1, 0, 0x80, 0xFA};
  append(out, {8, 11, 0, 2, 0x0E, 0x03, 0, 0});
  append(out, {9, 4, 0, 0, 0, 0x0E, 0x01, 0, 0});
  append(out, control);
  append(out, {9, 4, 1, 0, 1, 0x0E, 0x02, 0, 0});
  append(out, stream);
  append(out, {7, 5, kEndpoint, 2, 0x00, 0x02, 0});
  out[2] = static_cast<std::uint8_t>(out.size());
  out[3] = static_cast<std::uint8_t>(out.size() >> 8);
  return out;
}

Bytes string_descriptor(int index) {
  if (index == 0) return {4, 3, 0x09, 0x04};
  const char* const text = index == 1 ? "Penumbra" : "Penumbra studio camera";
  Bytes out = {static_cast<std::uint8_t>(2 + 2 * std::strlen(text)), 3};
  for (const char* c = text; *c; ++c) put(out, static_cast<std::uint64_t>(*c), 2);
  return out;
}

// The sensor: its settings take effect some frames after they were made.
class Sensor {
 public:
  int exposure = 156, gain = static_cast<int>(kUvcUnitGain), automatic = 8, fault = kNoFault;

  void changed() {
    if (fault != kIgnoresExposure) settings_.push_back({frame_, exposure, gain});
  }
  void fault_changed() { since_ = frame_; }
  std::uint64_t since_fault() const { return frame_ - since_; }

  /// The next frame as YUYV codes of limited range.
  Bytes expose_next() {
    ++frame_;
    const std::uint64_t delay = fault == kThreeFramesLate ? 4 : 1;
    while (settings_.size() > 1 && settings_[1].frame + delay <= frame_) settings_.pop_front();
    const Setting now = settings_.empty() ? Setting{0, exposure, gain} : settings_.front();
    FramePixels codes = Image<Rgb8>(kUvcWidth, kUvcHeight);
    capture::Sensor model;
    model.response = calib::Response::srgb();
    capture::expose(model, scene_, {Seconds(now.exposure * 1e-4), Gain(now.gain / kUvcUnitGain)},
                    frame_, codes);
    return yuyv(std::get<Image<Rgb8>>(codes));
  }
  std::uint64_t frame() const { return frame_; }

 private:
  struct Setting {
    std::uint64_t frame;
    int exposure, gain;
  };
  // BT.601, codes 16..235; each pair shares its chroma.
  static Bytes yuyv(const Image<Rgb8>& rgb) {
    Bytes out(kFrameBytes);
    const auto code = [](double v) {
      return static_cast<std::uint8_t>(std::clamp(v + .5, 0., 255.));
    };
    for (std::size_t i = 0; i + 1 < rgb.area(); i += 2) {
      const Rgb8 &a = rgb.pixels()[i], &b = rgb.pixels()[i + 1];
      const double red = .5 * (a.r + b.r), green = .5 * (a.g + b.g), blue = .5 * (a.b + b.b);
      const auto luma = [](const Rgb8& p) {
        return 16 + (65.481 * p.r + 128.553 * p.g + 24.966 * p.b) / 255;
      };
      out[2 * i] = code(luma(a));
      out[2 * i + 1] = code(128 + (-37.797 * red - 74.203 * green + 112. * blue) / 255);
      out[2 * i + 2] = code(luma(b));
      out[2 * i + 3] = code(128 + (112. * red - 93.786 * green - 18.214 * blue) / 255);
    }
    return out;
  }
  Image<Rgb> scene_ = uvc_scene();
  std::deque<Setting> settings_;
  std::uint64_t frame_ = 0, since_ = 0;
};

enum RayPacket : std::uint32_t {
  kHello = 0,
  kConnect = 1,
  kDisconnect = 2,
  kReset = 3,
  kInterfaceInfo = 4,
  kEndpointInfo = 5,
  kSetConfiguration = 6,
  kGetConfiguration = 7,
  kConfigurationStatus = 8,
  kSetAlternate = 9,
  kGetAlternate = 10,
  kAlternateStatus = 11,
  kCancel = 21,
  kControl = 100,
  kBulk = 101,
};
enum Status : std::uint8_t { kSuccess = 0, kCancelled = 1, kIoError = 3, kStall = 4 };

class Device {
 public:
  explicit Device(int socket) : socket_(socket) {}
  void run();

 private:
  void send(std::uint32_t type, std::uint64_t id, const Bytes& body);
  void plug_in();
  void take(std::uint32_t type, std::uint64_t id, std::span<const std::uint8_t> body);
  void control(std::uint64_t id, std::span<const std::uint8_t> body);
  std::optional<Bytes> answer(std::uint8_t request, std::uint8_t kind, std::uint16_t value,
                              std::uint16_t index, std::span<const std::uint8_t> data);
  std::optional<Bytes> class_request(std::uint8_t request, std::uint16_t value, std::uint16_t index,
                                     std::span<const std::uint8_t> data);
  void bulk_answer(std::uint64_t id, Status status, std::span<const std::uint8_t> data);
  void make_frame();
  void stream();
  Bytes probe() const;

  struct Urb {
    std::uint64_t id;
    std::size_t bytes;
  };
  int socket_;
  bool greeted_ = false, broken_ = false, streaming_ = false;
  Bytes in_;
  Sensor sensor_;
  std::deque<Urb> urbs_;
  Bytes payload_;
  std::size_t sent_ = 0;
  bool frame_id_ = false;
  int errors_left_ = 0;
  Clock::time_point due_ = Clock::now();
  std::optional<Clock::time_point> plug_in_at_;
};

void Device::send(std::uint32_t type, std::uint64_t id, const Bytes& body) {
  Bytes out;
  put(out, type, 4);
  put(out, body.size(), 4);
  put(out, id, type == kHello ? 4 : 8);  // what is agreed in the hello counts after it
  out.insert(out.end(), body.begin(), body.end());
  for (std::size_t at = 0; at < out.size() && !broken_;) {
    const ssize_t n = ::send(socket_, &out[at], out.size() - at, MSG_NOSIGNAL);
    if (n <= 0)
      broken_ = true;
    else
      at += static_cast<std::size_t>(n);
  }
}

void Device::plug_in() {
  Bytes interfaces;
  put(interfaces, 2, 4);
  for (const auto& [first, second] : {std::pair{0, 1}, {0x0E, 0x0E}, {1, 2}, {0, 0}}) {
    Bytes list(32);
    list[0] = static_cast<std::uint8_t>(first), list[1] = static_cast<std::uint8_t>(second);
    interfaces.insert(interfaces.end(), list.begin(), list.end());
  }
  send(kInterfaceInfo, 0, interfaces);
  Bytes types(32, 255), intervals(32), places(32), sizes;
  types[0] = types[16] = 0;  // control
  types[17] = 2;             // bulk, 0x81
  places[17] = 1;
  for (int i = 0; i < 32; ++i) put(sizes, i == 17 ? 512 : i % 16 == 0 ? 64 : 0, 2);
  Bytes endpoints = types;
  for (const Bytes* more : {&intervals, &places, &sizes})
    endpoints.insert(endpoints.end(), more->begin(), more->end());
  send(kEndpointInfo, 0, endpoints);
  Bytes device = {2, 0xEF, 0x02, 0x01};  // high speed
  put(device, 0x1209, 2);
  put(device, 0x0001, 2);
  put(device, 0x0100, 2);
  send(kConnect, 0, device);
}

void Device::take(std::uint32_t type, std::uint64_t id, std::span<const std::uint8_t> body) {
  switch (type) {
    case kHello:
      greeted_ = true;
      plug_in();
      break;
    case kReset:
      urbs_.clear();
      streaming_ = false;
      break;
    case kSetConfiguration:
    case kGetConfiguration:
      send(kConfigurationStatus, id, {kSuccess, 1});
      break;
    case kSetAlternate:
    case kGetAlternate:
      send(kAlternateStatus, id, {kSuccess, body.empty() ? std::uint8_t{0} : body[0], 0});
      break;
    case kCancel:
      if (std::erase_if(urbs_, [&](const Urb& u) { return u.id == id; }))
        bulk_answer(id, kCancelled, {});
      break;
    case kControl:
      control(id, body);
      break;
    case kBulk:
      urbs_.push_back({id, get(body, 2, 2) | get(body, 8, 2) << 16});
      break;
    default:
      break;
  }
}

void Device::control(std::uint64_t id, std::span<const std::uint8_t> body) {
  if (body.size() < 10) return;
  const std::uint8_t request = body[1], kind = body[2];
  const auto value = static_cast<std::uint16_t>(get(body, 4, 2)),
             index = static_cast<std::uint16_t>(get(body, 6, 2)),
             length = static_cast<std::uint16_t>(get(body, 8, 2));
  auto data = answer(request, kind, value, index, body.subspan(10));
  Bytes out(body.begin(), body.begin() + 10);
  out[3] = data ? kSuccess : kStall;
  if (!data || !(kind & 0x80)) data = Bytes{};
  data->resize(std::min<std::size_t>(data->size(), length));
  const std::size_t told = kind & 0x80 ? data->size() : length;
  out[8] = static_cast<std::uint8_t>(told), out[9] = static_cast<std::uint8_t>(told >> 8);
  out.insert(out.end(), data->begin(), data->end());
  send(kControl, id, out);
}

// Nothing: a stall.
std::optional<Bytes> Device::answer(std::uint8_t request, std::uint8_t kind, std::uint16_t value,
                                    std::uint16_t index, std::span<const std::uint8_t> data) {
  constexpr std::uint8_t kClass = 0x20, kGetDescriptor = 6, kGetStatus = 0, kClearFeature = 1;
  if ((kind & 0x60) == kClass) return class_request(request, value, index, data);
  if (request == kGetDescriptor) {
    if (value >> 8 == 1) return device_descriptor();
    if (value >> 8 == 2) return configuration_descriptor();
    if (value >> 8 == 3 && (value & 0xff) < 3) return string_descriptor(value & 0xff);
    return std::nullopt;
  }
  if (request == kGetStatus) return Bytes{0, 0};
  if (request == kClearFeature && index == kEndpoint) streaming_ = false;
  return Bytes{};
}

Bytes Device::probe() const {
  Bytes out = {0, 0, 1, 1};
  put(out, kInterval, 4);
  put(out, 0, 10);
  put(out, kFrameBytes, 4);
  put(out, kFrameBytes + kPayloadHeader, 4);
  put(out, 1'000'000, 4);
  out.resize(34);
  return out;
}

std::optional<Bytes> Device::class_request(std::uint8_t request, std::uint16_t value,
                                           std::uint16_t index,
                                           std::span<const std::uint8_t> data) {
  enum : std::uint8_t { kSet = 1, kCur = 0x81, kMin, kMax, kRes, kLen, kInfo, kDef };
  const int selector = value >> 8, entity = index >> 8;
  if ((index & 0xff) == 1) {  // streaming: probe and commit
    if (request == kInfo) return Bytes{3};
    if (request == kLen) return Bytes{34, 0};
    if (request != kSet) return probe();
    if (selector == 2) streaming_ = true, sent_ = 0, payload_.clear(), due_ = Clock::now();
    return Bytes{};
  }
  struct Control {
    int entity, selector, bytes, low, high, step, fallback;
    int* current;
  };
  const Control controls[] = {{1, 2, 1, 1, 8, 9, 8, &sensor_.automatic},
                              {1, 4, 4, 1, 5000, 1, 156, &sensor_.exposure},
                              {2, 4, 2, 0, 255, 1, 16, &sensor_.gain},
                              {2, 8, 2, 0, kUvcFaults - 1, 1, 0, &sensor_.fault}};
  const auto c = std::ranges::find_if(
      controls, [&](const Control& k) { return k.entity == entity && k.selector == selector; });
  if (c == std::end(controls)) return std::nullopt;
  if (request == kInfo) return Bytes{3};
  if (request == kSet) {
    const int wanted = static_cast<int>(get(data, 0, c->bytes));
    *c->current = c->bytes == 1 ? wanted : std::clamp(wanted, c->low, c->high);
    const bool fault = c->current == &sensor_.fault;
    fault ? sensor_.fault_changed() : sensor_.changed();
    if (fault) errors_left_ = kErrors;
    return Bytes{};
  }
  Bytes out;
  const int v = request == kMin   ? c->low
                : request == kMax ? c->high
                : request == kRes ? c->step
                : request == kDef ? c->fallback
                                  : *c->current;
  put(out, static_cast<std::uint64_t>(v), c->bytes);
  return out;
}

void Device::bulk_answer(std::uint64_t id, Status status, std::span<const std::uint8_t> data) {
  Bytes out = {kEndpoint, status};
  put(out, data.size() & 0xffff, 2);
  put(out, 0, 4);
  put(out, data.size() >> 16, 2);
  out.insert(out.end(), data.begin(), data.end());
  send(kBulk, id, out);
}

// A frame when it is due, and what goes wrong with it.
void Device::make_frame() {
  if (!streaming_ || Clock::now() < due_ || sent_ < payload_.size()) return;
  due_ = std::max(due_ + std::chrono::nanoseconds(kInterval * 100LL),
                  Clock::now() - std::chrono::milliseconds(100));
  Bytes picture = sensor_.expose_next();
  const std::uint64_t since = sensor_.since_fault();
  if (sensor_.fault == kDropsEveryFifth && sensor_.frame() % 5 == 0) return;
  if (sensor_.fault == kTruncatesEverySeventh && sensor_.frame() % 7 == 0)
    picture.resize(picture.size() / 3);
  if (sensor_.fault == kUnplugsForASecond && since == 10) {
    streaming_ = false;
    urbs_.clear();
    sensor_.fault = kNoFault;
    send(kDisconnect, 0, {});
    plug_in_at_ = Clock::now() + std::chrono::seconds(1);
    return;
  }
  payload_ = {2, static_cast<std::uint8_t>(0x82 | (frame_id_ ? 1 : 0))};  // end of frame
  payload_.insert(payload_.end(), picture.begin(), picture.end());
  frame_id_ = !frame_id_;
  sent_ = 0;
}

void Device::stream() {
  while (!urbs_.empty() && sent_ < payload_.size() && !broken_) {
    const Urb urb = urbs_.front();
    urbs_.pop_front();
    if (sensor_.fault == kOneProtocolError && sensor_.since_fault() > 10 && errors_left_ > 0) {
      --errors_left_;
      bulk_answer(urb.id, kIoError, {});
      sent_ = payload_.size();
      continue;
    }
    const std::size_t bytes = std::min(urb.bytes, payload_.size() - sent_);
    bulk_answer(urb.id, kSuccess, std::span(payload_).subspan(sent_, bytes));
    sent_ += bytes;
  }
}

void Device::run() {
  Bytes hello(64);
  std::memcpy(hello.data(), "penumbra", 8);
  put(hello, 1u << 1 | 1u << 4 | 1u << 5 | 1u << 6, 4);
  send(kHello, 0, hello);
  while (!broken_) {
    pollfd ready{socket_, POLLIN, 0};
    ::poll(&ready, 1, 2);
    if (ready.revents) {
      std::uint8_t chunk[65536];
      const ssize_t n = ::recv(socket_, chunk, sizeof chunk, 0);
      if (n <= 0) return;
      in_.insert(in_.end(), chunk, chunk + n);
    }
    std::size_t at = 0;
    while (true) {
      const std::size_t header = greeted_ ? 16 : 12;
      if (in_.size() - at < header) break;
      const std::span rest = std::span(in_).subspan(at);
      const std::size_t length = get(rest, 4, 4);
      if (rest.size() < header + length) break;
      const std::uint64_t id =
          get(rest, 8, 4) | (greeted_ ? std::uint64_t{get(rest, 12, 4)} << 32 : 0);
      const Bytes body(rest.begin() + static_cast<std::ptrdiff_t>(header),
                       rest.begin() + static_cast<std::ptrdiff_t>(header + length));
      take(get(rest, 0, 4), id, body);
      at += header + length;
    }
    in_.erase(in_.begin(), in_.begin() + static_cast<std::ptrdiff_t>(at));
    if (plug_in_at_ && Clock::now() > *plug_in_at_) plug_in_at_.reset(), plug_in();
    make_frame();
    stream();
  }
}

}  // namespace
}  // namespace penumbra::test

int main(int argc, char** argv) {
  if (argc != 2) return std::fprintf(stderr, "usage: uvc_camera SOCKET\n"), 2;
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (std::strlen(argv[1]) >= sizeof address.sun_path) return 2;
  std::strcpy(address.sun_path, argv[1]);
  const int listener = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (::bind(listener, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
      ::listen(listener, 1) != 0)
    return std::perror("uvc_camera"), 1;
  const int socket = ::accept(listener, nullptr, nullptr);
  if (socket < 0) return std::perror("uvc_camera"), 1;
  penumbra::test::Device(socket).run();
  return 0;
}
