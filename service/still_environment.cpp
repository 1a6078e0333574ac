#include "service/still_environment.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>

#include "calib/camera/camera_model.h"
#include "calib/camera/lens_vignetting.h"
#include "core/conventions.h"
#include "core/io/log.h"

namespace penumbra::service {

namespace {

constexpr Seconds kBetweenMaps{.5}, kBetweenLooks{.25};

// Of an open surface, from every pixel of the map.
Rgb irradiance_of(const Image<Rgb>& map, const glm::dvec3& normal) {
  double sum[3] = {};
  for (int y = 0; y < map.height(); ++y) {
    const double weight = latlong_solid_angle(y, map.width(), map.height());
    for (int x = 0; x < map.width(); ++x) {
      const double cosine =
          glm::dot(latlong_direction(x + .5, y + .5, map.width(), map.height()), normal);
      for (int c = 0; c < 3 && cosine > 0; ++c) sum[c] += weight * cosine * map.at(x, y)[c];
    }
  }
  return {static_cast<float>(sum[0]), static_cast<float>(sum[1]), static_cast<float>(sum[2])};
}

// Signal of a pixel, in fractions of full scale; nothing where it is near white or black.
std::optional<Rgb> signal_at(const FramePixels& pixels, const capture::CameraInfo& camera,
                             glm::ivec2 at) {
  constexpr double kWhite = .97, kBlack = .01;
  const auto decoded = [&](const auto& code, double largest) -> std::optional<Rgb> {
    Rgb out;
    for (int c = 0; c < 3; ++c) {
      const double coded = static_cast<double>(c == 0   ? code.r
                                               : c == 1 ? code.g
                                                        : code.b) /
                           largest;
      if (!(coded > kBlack && coded < kWhite)) return std::nullopt;
      out[c] = static_cast<float>(camera.response.decode(coded, c) - camera.black_level);
    }
    return out;
  };
  if (const auto* eight = std::get_if<Image<Rgb8>>(&pixels))
    return decoded(eight->at(at.x, at.y), 255);
  if (const auto* sixteen = std::get_if<Image<Rgb16>>(&pixels))
    return decoded(sixteen->at(at.x, at.y), 65535);
  return std::get<Image<Rgb>>(pixels).at(at.x, at.y);
}

}  // namespace

Result<std::unique_ptr<StillEnvironment>> StillEnvironment::create(
    std::unique_ptr<capture::FrameSource> frames, StillEnvironmentOptions options) {
  const auto& before = frames->cameras();
  if (std::ranges::any_of(before, capture::shows_surroundings))
    return fail(ErrorCode::kInvalid, "environment",
                "comes from a file, and a camera of the rig shows it, too");
  if (options.scale && !(*options.scale > 0 && std::isfinite(*options.scale)))
    return fail(ErrorCode::kInvalid, "environment_scale", "is not positive");
  if (!options.scale && options.boards.empty())
    return fail(ErrorCode::kInvalid, "environment",
                "has no environment_scale, and no board whose paper would tell it");
  if (!(options.paper_albedo > 0 && options.paper_albedo <= 1))
    return fail(ErrorCode::kInvalid, "paper_albedo", "is not above 0 and at most 1");
  auto out = std::unique_ptr<StillEnvironment>(
      new StillEnvironment(std::move(frames), std::move(options)));
  const Image<Rgb>& map = out->options_.map;
  out->cameras_ = before;
  capture::CameraInfo camera;
  camera.name = "environment file";
  PENUMBRA_ASSIGN(
      latlong, calib::make_projection(calib::ProjectionKind::kLatLong, map.width(), map.height()));
  camera.projection = latlong;
  camera.response = calib::Response::linear();
  out->cameras_.push_back(std::move(camera));
  for (const calib::PlacedBoard& b : out->options_.boards)
    out->irradiance_.push_back(
        irradiance_of(map, b.world_from_board.rotation * glm::dvec3(0, 0, 1)));
  if (const auto scale = out->options_.scale) {
    const auto all = static_cast<float>(*scale);
    out->scale_ = Rgb{all, all, all};
  }
  return out;
}

Result<std::optional<capture::Frame>> StillEnvironment::next() {
  if (held_) return std::exchange(held_, std::nullopt);
  auto frame = frames_->next();
  if (!frame || !*frame) return frame;
  const capture::Frame& now = **frame;
  const bool views = cameras_[static_cast<std::size_t>(now.camera)].role == capture::Role::kView;
  if (views && !options_.scale && !now.for_light && now.opacity >= 1 &&
      (!measured_ || now.time - *measured_ >= kBetweenLooks)) {
    measured_ = now.time;
    measure(now);
  }
  if (!scale_ || (sent_ && now.time - *sent_ < kBetweenMaps && scale_ == shown_)) return frame;
  held_ = std::move(**frame);
  return std::optional(frame_of_map(held_->time));
}

// What the light of the map would have to be multiplied by, at most white places. Seen slantwise
// the strips of white are narrow one way, and blur darkens them: the upper quartile is of the
// others.
std::optional<Rgb> StillEnvironment::paper_over_map(const capture::Frame& view) const {
  constexpr std::size_t kMinPlaces = 6;
  const capture::CameraInfo& camera = cameras_[static_cast<std::size_t>(view.camera)];
  const Vignetting vignetting = calib::vignetting_of(camera.projection, camera.vignetting);
  const Pose camera_from_world = view.world_from_camera.inverse();
  std::array<std::vector<float>, 3> ratios;
  for (std::size_t b = 0; b < options_.boards.size(); ++b) {
    const Pose camera_from_board = camera_from_world * options_.boards[b].world_from_board;
    for (const glm::dvec2& place : calib::white_places(options_.boards[b].board)) {
      const auto px = calib::pixel_from_direction(
          camera.projection, camera_from_board * glm::dvec3(place.x, -place.y, 0));
      if (!px || px->x >= camera.projection.width || px->y >= camera.projection.height) continue;
      const auto signal = signal_at(*view.pixels, camera, glm::ivec2(*px));
      if (!signal) continue;
      for (int c = 0; c < 3; ++c) {
        const double radiance = (*signal)[c] / (view.exposure.product() * vignetting.at(*px));
        const double of_map = options_.paper_albedo / kPi * irradiance_[b][c];
        if (of_map > 0) ratios[static_cast<std::size_t>(c)].push_back(float(radiance / of_map));
      }
    }
  }
  Rgb out;
  for (int c = 0; c < 3; ++c) {
    auto& of = ratios[static_cast<std::size_t>(c)];
    if (of.size() < kMinPlaces) return std::nullopt;
    const auto upper = of.begin() + static_cast<std::ptrdiff_t>(3 * of.size() / 4);
    std::ranges::nth_element(of, upper);
    out[c] = *upper;
  }
  return out;
}

// Follows the camera's own exposure within a second, and jumps by nothing that noise makes.
void StillEnvironment::measure(const capture::Frame& view) {
  constexpr float kSame = .02f, kTakeOver = .5f;
  const auto found = paper_over_map(view);
  if (!found) {
    if (!scale_)
      log_warning(
          "environment: the board's paper is too bright, too dark or too far away to tell "
          "how bright the map is");
    return;
  }
  if (!scale_) {
    scale_ = found;
    return;
  }
  float change = 0;
  for (int c = 0; c < 3; ++c) change = std::max(change, std::abs((*found)[c] / (*scale_)[c] - 1));
  if (change > kSame) scale_ = *scale_ * (1 - kTakeOver) + *found * kTakeOver;
}

capture::Frame StillEnvironment::frame_of_map(TimestampNs time) {
  if (!scaled_ || scale_ != shown_) {
    Image<Rgb> map = options_.map;
    for (Rgb& p : map.pixels()) p = p * *scale_;
    scaled_ = std::make_shared<const FramePixels>(std::move(map));
    shown_ = scale_;
  }
  sent_ = time;
  capture::Frame out;
  out.camera = static_cast<int>(cameras_.size()) - 1;
  out.sequence = sent_frames_++;
  out.time = time;
  out.exposure = {Seconds(1), Gain(1)};
  out.pixels = scaled_;
  return out;
}

}  // namespace penumbra::service
