#include "capture/device/internal/v4l2_node.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <thread>

#include "capture/frames.h"
#include "capture/raw_formats.h"

namespace penumbra::capture {

namespace {

constexpr std::uint32_t kMaxEntries = 512;  // of any list that a driver gives

template <std::size_t n>
std::string text(const std::uint8_t (&field)[n]) {
  const auto* const at = reinterpret_cast<const char*>(field);
  return std::string(at, strnlen(at, n));
}

double rate(const v4l2_fract& interval) {
  return interval.numerator ? static_cast<double>(interval.denominator) / interval.numerator : 0;
}

// Sizes of a driver that takes any between two.
constexpr std::pair<std::uint32_t, std::uint32_t> kUsualSizes[] = {
    {320, 240}, {640, 480}, {1280, 720}, {1280, 960}, {1920, 1080}, {2560, 1440}, {3840, 2160}};

std::filesystem::path hardware_of(int fd) {
  struct stat node {};
  if (::fstat(fd, &node) != 0) return {};
  std::error_code error;
  return std::filesystem::canonical(
      fmt::format("/sys/dev/char/{}:{}/device", major(node.st_rdev), minor(node.st_rdev)), error);
}

}  // namespace

// Linux 6.1 dereferences null when the last file of an unplugged camera closes while
// uvc_disconnect() still takes its media device down: __media_device_unregister_entity() reads the
// entity's device again after waiting for its lock. The folder of the hardware goes once the driver
// has returned.
V4l2Node::~V4l2Node() {
  using namespace std::chrono_literals;
  v4l2_capability able{};
  if (!fd_ || call(VIDIOC_QUERYCAP, &able) != ENODEV) return;
  std::error_code error;
  for (auto waited = 0ms; waited < 500ms && std::filesystem::exists(hardware_, error);
       waited += 10ms)
    std::this_thread::sleep_for(10ms);
}

Error V4l2Node::error(ErrorCode code, const std::string& what, int number) const {
  return {code, device_, fmt::format("{}: {}", what, std::strerror(number))};
}

Result<V4l2Node> V4l2Node::open(const std::string& device) {
  V4l2Node node;
  node.device_ = device;
  node.fd_ = UniqueFd(::open(device.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
  if (!node.fd_) {
    const bool missing = errno == ENOENT || errno == ENODEV || errno == ENXIO;
    if (missing) return fail(ErrorCode::kNotFound, device, "is not a connected camera");
    return std::unexpected(node.error(ErrorCode::kUnavailable, "cannot be opened", errno));
  }
  v4l2_capability able{};
  if (const int e = node.call(VIDIOC_QUERYCAP, &able))
    return fail(ErrorCode::kUnavailable, device,
                fmt::format("is not a video device: {}", std::strerror(e)));
  node.hardware_ = hardware_of(node.fd());
  node.name_ = text(able.card);
  node.driver_ = text(able.driver);
  const std::uint32_t caps =
      able.capabilities & V4L2_CAP_DEVICE_CAPS ? able.device_caps : able.capabilities;
  if (caps & V4L2_CAP_VIDEO_CAPTURE_MPLANE)
    return fail(ErrorCode::kUnavailable, device,
                "delivers each picture in several planes, which is not supported");
  if (!(caps & V4L2_CAP_VIDEO_CAPTURE))
    return fail(ErrorCode::kInvalid, device, "does not capture video");
  if (!(caps & V4L2_CAP_STREAMING))
    return fail(ErrorCode::kUnavailable, device, "does not support streaming");
  return node;
}

double V4l2Node::max_fps(std::uint32_t fourcc, std::uint32_t width, std::uint32_t height) const {
  double largest = 0;
  v4l2_frmivalenum interval{};
  interval.pixel_format = fourcc, interval.width = width, interval.height = height;
  for (; interval.index < kMaxEntries && call(VIDIOC_ENUM_FRAMEINTERVALS, &interval) == 0;
       ++interval.index) {
    if (interval.type != V4L2_FRMIVAL_TYPE_DISCRETE)
      return rate(interval.stepwise.min);  // the shortest
    largest = std::max(largest, rate(interval.discrete));
  }
  return largest;
}

std::vector<CameraMode> V4l2Node::modes() const {
  std::vector<CameraMode> out;
  v4l2_fmtdesc format{};
  format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  for (; format.index < kMaxEntries && call(VIDIOC_ENUM_FMT, &format) == 0; ++format.index) {
    const auto add = [&](std::uint32_t width, std::uint32_t height) {
      out.push_back({fourcc_name(format.pixelformat), static_cast<int>(width),
                     static_cast<int>(height), max_fps(format.pixelformat, width, height),
                     format_rank(format.pixelformat) > 0});
    };
    v4l2_frmsizeenum size{};
    size.pixel_format = format.pixelformat;
    for (; size.index < kMaxEntries && call(VIDIOC_ENUM_FRAMESIZES, &size) == 0; ++size.index) {
      if (size.type == V4L2_FRMSIZE_TYPE_DISCRETE) {
        add(size.discrete.width, size.discrete.height);
        continue;
      }
      const auto& s = size.stepwise;
      for (const auto& [width, height] : kUsualSizes)
        if (width >= s.min_width && width <= s.max_width && height >= s.min_height &&
            height <= s.max_height)
          add(width, height);
      break;
    }
  }
  return out;
}

std::optional<V4l2Node::Control> V4l2Node::control(std::uint32_t id) const {
  v4l2_queryctrl query{};
  query.id = id;
  if (call(VIDIOC_QUERYCTRL, &query) != 0 || (query.flags & V4L2_CTRL_FLAG_DISABLED))
    return std::nullopt;
  return Control{id, static_cast<double>(query.minimum), static_cast<double>(query.maximum),
                 static_cast<double>(std::max(query.step, 1)),
                 static_cast<double>(query.default_value)};
}

std::optional<int> V4l2Node::value(std::uint32_t id) const {
  v4l2_control c{id, 0};
  if (call(VIDIOC_G_CTRL, &c) != 0) return std::nullopt;
  return c.value;
}

int V4l2Node::set(std::uint32_t id, int value) const {
  v4l2_control c{id, value};
  return call(VIDIOC_S_CTRL, &c);
}

V4l2Exposure exposure_of(const V4l2Node& node) {
  V4l2Exposure out;
  out.time = node.control(V4L2_CID_EXPOSURE_ABSOLUTE);
  out.gain = node.control(V4L2_CID_ANALOGUE_GAIN);
  if (!out.gain) out.gain = node.control(V4L2_CID_GAIN);
  return out;
}

namespace {

Result<CameraListing> describe(const std::string& device) {
  PENUMBRA_ASSIGN(node, V4l2Node::open(device));
  CameraListing out{device, node.name(), node.driver(), node.modes(), {}, {}};
  const V4l2Exposure e = exposure_of(node);
  if (e.time)
    out.exposure_s =
        ControlRange{e.time->low * V4l2Exposure::kUnit, e.time->high * V4l2Exposure::kUnit};
  if (e.gain) out.gain = ControlRange{e.gain->low, e.gain->high};
  return out;
}

}  // namespace

void list_v4l2(CameraList& list) {
  std::vector<std::pair<int, std::string>> nodes;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator("/dev", error)) {
    const std::string name = entry.path().filename().string();
    int number = 0;
    if (std::sscanf(name.c_str(), "video%d", &number) == 1)
      nodes.emplace_back(number, entry.path().string());
  }
  std::ranges::sort(nodes);
  for (const auto& [number, device] : nodes) {
    auto listing = describe(device);
    if (listing)
      list.cameras.push_back(std::move(*listing));
    else if (listing.error().code !=
             ErrorCode::kInvalid)  // metadata and output nodes are no cameras
      list.rejected.push_back(listing.error());
  }
}

Result<CameraMode> choose_mode(const std::vector<CameraMode>& modes, const CameraSettings& s) {
  const auto serves = [&](const CameraMode& m) {
    return m.readable && m.width == s.width && m.height == s.height &&
           (s.format.empty() ? m.format != kDepthFormat : m.format == s.format);
  };
  // Larger is better, from the first to the last.
  const auto merit = [&](const CameraMode& m) {
    const bool fast = m.max_fps == 0 || m.max_fps > .99 * s.fps;
    const auto code = fourcc_from(m.format);
    return std::tuple(fast, fast ? 0. : m.max_fps, code ? format_rank(*code) : 0);
  };
  const CameraMode* best = nullptr;
  for (const CameraMode& m : modes)
    if (serves(m) && (!best || merit(m) > merit(*best))) best = &m;
  if (best) return *best;
  constexpr std::size_t kLong = 200;
  std::string list;
  for (const CameraMode& m : modes)
    if (m.readable && list.size() < kLong)
      list += fmt::format("{}{} {}x{}", list.empty() ? "" : ", ", m.format, m.width, m.height);
  return fail(
      ErrorCode::kInvalid, s.device,
      fmt::format("does not offer {}{}{}x{}; it offers {}", s.format, s.format.empty() ? "" : " ",
                  s.width, s.height, list.empty() ? "nothing that can be read" : list));
}

}  // namespace penumbra::capture
