#include "capture/device/rig.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <mutex>
#include <stop_token>

#include "capture/device/internal/bracketed_camera.h"
#include "capture/device/internal/libcamera_device.h"
#include "capture/device/internal/v4l2_node.h"
#include "core/exceptions.h"
#include "core/threads/processor_time.h"

namespace penumbra::capture {

namespace {

constexpr std::size_t kQueued = 8;  // frames of all cameras
constexpr Seconds kTurn{.1}, kRetry{.25};
// And four exposures: a stream that gives nothing for so long is opened anew
constexpr Seconds kSilence{2};

// The camera as it was configured, or the same one under another device: after a replug the number
// may have changed.
Result<std::unique_ptr<CameraDevice>> find_again(const CameraSettings& settings,
                                                 const std::string& name, OpenCamera open) {
  auto device = open(settings);
  if (device || name.empty()) return device;
  CameraList list;
  is_libcamera(settings.device) ? list_libcamera(list) : list_v4l2(list);
  for (const CameraListing& other : list.cameras) {
    if (other.name != name || other.device == settings.device) continue;
    CameraSettings there = settings;
    there.device = other.device;
    if (auto found = open(there)) return found;
  }
  return device;
}

bool are_halves(const RigCamera& a, const RigCamera& b) {
  const calib::CameraModel &of_a = a.info.projection, &of_b = b.info.projection;
  return a.half && b.half && a.half != b.half && a.info.role == b.info.role &&
         of_a.width == of_b.width && of_a.height == of_b.height;
}

Frame half_of(const Frame& whole, StereoHalf half, const CameraInfo& info) {
  Frame out = whole;
  out.world_from_camera = info.world_from_camera;
  out.jpeg.reset();  // of both halves
  const int wide = info.projection.width;
  out.pixels = std::make_shared<const FramePixels>(std::visit(
      [&](const auto& picture) -> FramePixels {
        std::decay_t<decltype(picture)> part(wide, picture.height());
        for (int y = 0; y < part.height(); ++y)
          std::ranges::copy(
              picture.row(y).subspan(half == StereoHalf::kLeft ? 0 : static_cast<std::size_t>(wide),
                                     static_cast<std::size_t>(wide)),
              part.row(y).begin());
        return part;
      },
      *whole.pixels));
  return out;
}

}  // namespace

// One device and its thread.
struct Rig::Station {
  Station(RigCamera c, int number, OpenCamera opener, Bounded<Frame>& out, Latest<Error>& error)
      : camera(std::move(c)),
        bracketed(camera.info, camera.schedule, camera.delay_frames, camera.light_error,
                  camera.settings.fps),
        open(opener),
        frames(out),
        failed(error) {
    shown.push_back({number, camera.half, camera.info});
    expect(camera.schedule);
  }

  Result<void> start(std::unique_ptr<CameraDevice> device) {
    name = device->name();
    PENUMBRA_TRY(bracketed.connect(std::move(device)));
    can_take_darker = bracketed.can_take_darker();
    thread = std::jthread([this](const std::stop_token& stop) { run(stop); });
    return {};
  }
  void run(const std::stop_token& stop) noexcept {
    try {
      while (!stop.stop_requested()) {
        if (!bracketed.connected() && !reconnect()) {
          std::this_thread::sleep_for(kRetry);
          continue;
        }
        const SpendingOn spending(ProcessorUse::kCameras);
        const auto before = std::chrono::steady_clock::now();
        const std::uint64_t arrived = arrivals();
        if (auto exposures = wanted.take()) {
          expect(*exposures);
          bracketed.set_exposures(*exposures);
        }
        if (const double factor = darker.exchange(0); factor > 0) bracketed.take_darker(factor);
        auto frame = bracketed.next(kTurn);
        can_take_darker = bracketed.can_take_darker();
        publish();
        silent = arrivals() != arrived
                     ? Seconds(0)
                     : silent + Seconds(std::chrono::steady_clock::now() - before);
        if (silent > kSilence + 4 * longest) bracketed.disconnect(), silent = Seconds(0);
        if (!frame || !*frame) continue;  // gone, or nothing yet
        hand_on(**frame);
      }
    } catch (const std::exception& e) {
      failed.put({ErrorCode::kUnavailable, camera.info.name, reason_of(e)});
      frames.close();
    }
  }
  // Both eyes of a moment, or none of them.
  void hand_on(const Frame& frame) {
    std::array<Frame, 2> parts;
    for (std::size_t i = 0; i < shown.size(); ++i) {
      const ShownCamera& s = shown[i];
      parts[i] = s.half ? half_of(frame, *s.half, s.info) : frame;
      parts[i].camera = s.index;
    }
    if (!frames.try_push_all(std::span(parts).first(shown.size())) && !frames.closed()) ++overrun;
  }
  // How long no frame is no reason to worry.
  void expect(const std::vector<Exposure>& exposures) {
    for (const Exposure& e : exposures) longest = std::max(longest, e.time);
  }
  std::uint64_t arrivals() const { return bracketed.counts().arrived; }
  bool reconnect() {
    auto device = find_again(camera.settings, name, open);
    if (!device || !bracketed.connect(std::move(*device))) return false;
    ++reconnected;
    return true;
  }
  void publish() {
    const std::scoped_lock lock(mutex);
    for (ShownCamera& s : shown) {
      s.counts = bracketed.counts();
      s.counts.reconnected = reconnected;
      s.counts.overrun = overrun;
      s.counts.frames -= overrun;  // the bracketed camera handed them on
    }
  }

  // A camera of the rig: all that the device shows, or a half of it.
  struct ShownCamera {
    int index;
    std::optional<StereoHalf> half;
    CameraInfo info;
    CameraCounts counts{};  // guarded by mutex
  };

  RigCamera camera;
  BracketedCamera bracketed;
  std::string name;
  std::vector<ShownCamera> shown;
  OpenCamera open;
  Bounded<Frame>& frames;
  Latest<Error>& failed;
  std::atomic<double> darker = 0;  // factor of a darker frame that is wanted; 0: none
  std::atomic<bool> can_take_darker = false;
  Latest<std::vector<Exposure>> wanted;
  Seconds longest{0}, silent{0};
  std::uint64_t reconnected = 0, overrun = 0;
  mutable std::mutex mutex;
  std::jthread thread;  // last: joined before the rest goes
};

Rig::Rig() : frames_(kQueued) {}
Rig::~Rig() {
  Rig::close();
}

Result<std::unique_ptr<Rig>> Rig::open(std::vector<RigCamera> cameras, OpenCamera open) {
  if (cameras.empty()) return fail(ErrorCode::kInvalid, "rig", "has no camera");
  auto rig = std::unique_ptr<Rig>(new Rig);
  std::vector<std::unique_ptr<CameraDevice>> devices;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    RigCamera& camera = cameras[i];
    rig->infos_.push_back(camera.info);
    if (camera.info.role == Role::kView && rig->view_rate_ == 0)
      rig->view_rate_ = camera.settings.fps;
    const auto other = std::ranges::find_if(rig->stations_, [&](const auto& s) {
      return (camera.half || s->camera.half) && s->camera.settings.device == camera.settings.device;
    });
    if (camera.half && camera.light_error)
      return fail(ErrorCode::kInvalid, camera.info.name,
                  "is a half of a picture and cannot find its exposures itself");
    if (other != rig->stations_.end() &&
        ((*other)->shown.size() == 2 || !are_halves((*other)->camera, camera)))
      return fail(ErrorCode::kInvalid, camera.info.name,
                  "and " + (*other)->camera.info.name + " are not the two halves of one picture");
    rig->station_of_.push_back(static_cast<std::size_t>(other - rig->stations_.begin()));
    const int index = static_cast<int>(i);
    if (other != rig->stations_.end()) {
      (*other)->shown.push_back({index, camera.half, camera.info});
      continue;
    }
    camera.settings.width = (camera.half ? 2 : 1) * camera.info.projection.width;
    camera.settings.height = camera.info.projection.height;
    PENUMBRA_ASSIGN(device, open(camera.settings));
    devices.push_back(std::move(device));
    rig->stations_.push_back(
        std::make_unique<Station>(std::move(camera), index, open, rig->frames_, rig->failed_));
  }
  for (std::size_t i = 0; i < devices.size(); ++i)
    PENUMBRA_TRY(rig->stations_[i]->start(std::move(devices[i])));
  return rig;
}

Rig::Station& Rig::station_of(int camera) {
  return *stations_[station_of_.at(static_cast<std::size_t>(camera))];
}

Result<std::optional<Frame>> Rig::next() {
  auto frame = frames_.pop();
  if (frame) return frame;
  if (auto error = failed_.take()) return std::unexpected(std::move(*error));
  return std::nullopt;
}

void Rig::close() {
  frames_.close();
  for (const auto& station : stations_) station->thread.request_stop();
}

bool Rig::take_darker(int camera, double factor) {
  Station& station = station_of(camera);
  if (!station.can_take_darker) return false;
  station.darker = factor;
  return true;
}

Result<void> Rig::set_exposures(int camera, const std::vector<Exposure>& exposures) {
  Station& station = station_of(camera);
  if (!station.bracketed.sets_exposures())
    return fail(ErrorCode::kInvalid, station.camera.info.name,
                "stays at the exposure that it has: the rig file gives it no exposures_s");
  station.wanted.put(exposures);
  return {};
}

std::vector<CameraCounts> Rig::counts() const {
  std::vector<CameraCounts> out(infos_.size());
  for (const auto& station : stations_) {
    const std::scoped_lock lock(station->mutex);
    for (const Station::ShownCamera& s : station->shown)
      out[static_cast<std::size_t>(s.index)] = s.counts;
  }
  return out;
}

}  // namespace penumbra::capture
