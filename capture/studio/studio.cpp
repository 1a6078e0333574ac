#include <algorithm>
#include <array>
#include <cmath>

#include "calib/camera/camera_model.h"
#include "calib/camera/response_table.h"
#include "capture/frames.h"
#include "capture/hdr/merge.h"
#include "capture/studio/sensor.h"
#include "capture/studio/studio.h"
#include "capture/studio/world.h"
#include "core/conventions.h"
#include "core/threads/parallel.h"

namespace penumbra::capture {

namespace {

constexpr int kEnvironmentCamera = 0, kViewCamera = 1;

// Average over the pixel of what the world shows; a map of the same size is copied by its pixel
// centres, and of a coarser one, which changes little within a pixel, fewer samples are taken.
Image<Rgb> film_environment(const RadianceWorld& world, int width, int height) {
  const auto* floor_world = dynamic_cast<const FloorWorld*>(&world);
  if (floor_world && floor_world->environment().width() == width &&
      floor_world->environment().height() == height)
    return floor_world->environment();
  constexpr int kMaxSamples = 6;
  const int samples =
      floor_world
          ? std::clamp(kMaxSamples * floor_world->environment().width() / width, 1, kMaxSamples)
          : kMaxSamples;
  Image<Rgb> out(width, height);
  parallel_for(0, height, [&](int y) {
    for (int x = 0; x < width; ++x) {
      Rgb sum;
      for (int k = 0; k < samples * samples; ++k)
        sum += world.far_radiance(latlong_direction(x + (k % samples + .5) / samples,
                                                    y + (double(k / samples) + .5) / samples, width,
                                                    height));
      out.at(x, y) = sum * (1.f / static_cast<float>(samples * samples));
    }
  });
  return out;
}

Image<Rgb> film_view(const RadianceWorld& world, const CameraInfo& camera) {
  constexpr int kSamples = 3;
  const calib::CameraModel& lens = camera.projection;
  Image<Rgb> out(lens.width, lens.height);
  parallel_for(0, lens.height, [&](int y) {
    for (int x = 0; x < lens.width; ++x) {
      Rgb sum;
      for (int k = 0; k < kSamples * kSamples; ++k) {
        const glm::dvec2 at(x + (k % kSamples + .5) / kSamples,
                            y + (double(k / kSamples) + .5) / kSamples);
        if (const auto d = calib::direction_from_pixel(lens, at))
          sum += world.radiance(camera.world_from_camera.translation,
                                glm::normalize(camera.world_from_camera.rotation * *d));
      }
      out.at(x, y) = sum * (1.f / (kSamples * kSamples));
    }
  });
  return out;
}

using Gains = std::array<double, 3>;

Rgb gained(const Rgb& c, const Gains& g) {
  return {c.r * static_cast<float>(g[0]), c.g * static_cast<float>(g[1]),
          c.b * static_cast<float>(g[2])};
}

double mean_luminance(const Image<Rgb>& image, int first_row, const Gains& gains) {
  double sum = 0;
  for (int y = first_row; y < image.height(); ++y)
    for (const Rgb& c : image.row(y)) sum += luminance(gained(c, gains));
  return sum / (static_cast<double>(image.height() - first_row) * image.width());
}

// A channel with no light at all would have no gain.
Gains white_gains(const Rgb& white) {
  const float smallest = .01f * std::max({white.r, white.g, white.b, 1e-30f});
  Gains gains;
  for (int c = 0; c < 3; ++c)
    gains[static_cast<std::size_t>(c)] = 1 / double(std::max(white[c], smallest));
  return gains;
}

// Full scale that clips this fraction of the rows from `first_row` on, in any channel as its gain
// leaves it.
double full_scale(const Image<Rgb>& picture, int first_row, const Gains& gains, double clipped) {
  std::vector<float> largest;
  for (int y = first_row; y < picture.height(); ++y)
    for (const Rgb& c : picture.row(y)) {
      const Rgb g = gained(c, gains);
      largest.push_back(std::max({g.r, g.g, g.b}));
    }
  const auto at = largest.begin() + static_cast<std::ptrdiff_t>(
                                        (1 - clipped) * static_cast<double>(largest.size() - 1));
  std::ranges::nth_element(largest, at);
  return *at;
}

std::vector<CameraInfo> make_cameras(const StudioOptions& o) {
  CameraInfo environment;
  environment.name = "environment";
  environment.role = Role::kEnvironment;
  environment.projection = {
      calib::ProjectionKind::kLatLong, o.environment_width, o.environment_height, {}, {}};
  environment.world_from_camera.translation = {0, 1, 0};
  environment.response = o.sensor.response;
  environment.noise = o.sensor.noise;
  environment.noise_known = o.sensor.noisy;
  environment.black_level = o.sensor.black_level;
  CameraInfo view = environment;
  view.name = "view";
  view.role = Role::kView;
  view.projection =
      o.view_lens.value_or(calib::CameraModel{calib::ProjectionKind::kPinhole,
                                              o.view_width,
                                              o.view_height,
                                              {o.view_focal_px, o.view_focal_px},
                                              {o.view_width / 2., o.view_height / 2.}});
  view.psf_sigma_px = o.sensor.psf_sigma_px;
  view.vignetting = {-o.sensor.vignetting, 0, 0};
  view.world_from_camera = o.world_from_view;
  return {environment, view};
}

}  // namespace

Pose look_at(const glm::dvec3& eye, const glm::dvec3& target) {
  const glm::dvec3 back = glm::normalize(eye - target);
  const glm::dvec3 right = glm::normalize(glm::cross(glm::dvec3(0, 1, 0), back));
  return {glm::normalize(glm::quat_cast(glm::dmat3(right, glm::cross(back, right), back))), eye};
}

std::vector<Exposure> choose_schedule(const Image<Rgb>& environment, const Sensor& sensor,
                                      Seconds shortest_there_is) {
  constexpr double kLongest = 1. / 30, kFull = .9;
  double brightest = 0, mean = 0, area = 0;
  for (int y = 0; y < environment.height(); ++y) {
    const double w = latlong_solid_angle(y, environment.width(), environment.height());
    for (const Rgb& c : environment.row(y)) {
      brightest = std::max(brightest, double(std::max({c.r, c.g, c.b})));
      mean += w * luminance(c);
      area += w;
    }
  }
  mean /= area;
  // Darkest radiance that matters for lighting: a hundredth of the mean, at SNR 3 with
  // quantisation.
  const double darkest = .01 * mean;
  const ResponseTable curve = make_response_table(sensor.response, sensor.bits, sensor.black_level);
  double low = 1;
  for (unsigned code = 1; code < curve.largest_code(); ++code) {
    const double y = curve.decode(1, code),
                 step = curve.decode(1, code + 1) - curve.decode(1, code);
    if (y > 3 * std::sqrt(sensor.noise.variance(y, 1) + step * step / 12)) {
      low = y;
      break;
    }
  }
  const double shortest = std::clamp(kFull / brightest, shortest_there_is.count(), kLongest);
  const double longest = std::clamp(low / darkest, shortest, kLongest);
  // Each exposure covers the range from `low` to full scale; they share the range evenly.
  const int count =
      1 + static_cast<int>(std::ceil(std::log(longest / shortest) / std::log(kFull / low) - 1e-9));
  std::vector<Exposure> out;
  for (int k = 0; k < count; ++k)
    out.push_back(
        {Seconds(longest * std::pow(shortest / longest, count > 1 ? double(k) / (count - 1) : 0.)),
         Gain(1)});
  return out;
}

Studio::Studio(const std::shared_ptr<const RadianceWorld>& world, StudioOptions options)
    : options_(std::move(options)),
      view_sensor_(options_.sensor),
      cameras_(make_cameras(options_)) {
  environment_radiance_ =
      film_environment(*world, options_.environment_width, options_.environment_height);
  view_radiance_ = film_view(*world, cameras_[kViewCamera]);
  blur(view_radiance_, options_.sensor.psf_sigma_px);  // once: it stands still
  options_.sensor.psf_sigma_px = view_sensor_.psf_sigma_px = 0;
  options_.sensor.vignetting = 0;
  if (options_.schedule.empty())
    options_.schedule = choose_schedule(environment_radiance_, options_.sensor);
  first_schedule_ = options_.schedule;
  expose_view();
  for (int i = 0; i < options_.clip; ++i)
    view_clip_.push_back(film(kViewCamera, *options_.view_exposure, clip_seed(i)));
  film_environment_clip();
}

std::uint64_t Studio::clip_seed(int i) const {
  return options_.seed + 1000003 * static_cast<std::uint64_t>(i);
}

void Studio::film_environment_clip() {
  environment_clip_.clear();
  for (int i = 0; i < options_.clip; ++i)
    for (const Exposure& e : options_.schedule)
      environment_clip_.push_back(
          film(kEnvironmentCamera, e, 7919 * clip_seed(i) + environment_clip_.size()));
}

void Studio::expose_view() {
  const int h = view_radiance_.height();
  Gains gains{1, 1, 1};
  if (options_.white) {
    view_sensor_.response = *view_sensor_.response.with_white_balance(white_gains(*options_.white));
    gains = view_sensor_.response.white_balance();
    cameras_[kViewCamera].response = view_sensor_.response;
  }
  if (options_.view_exposure) return;
  // The lower third shows the floor.
  double full = mean_luminance(view_radiance_, 2 * h / 3, gains) / .3;
  constexpr double kClipped = .02;
  if (options_.white) full = std::max(full, full_scale(view_radiance_, h / 2, gains, kClipped));
  options_.view_exposure = Exposure{Seconds(1 / full), Gain(1)};
}

std::shared_ptr<const FramePixels> Studio::film(int camera, const Exposure& exposure,
                                                std::uint64_t seed) const {
  FramePixels pixels;
  const bool view = camera == kViewCamera;
  expose(view ? view_sensor_ : options_.sensor, view ? view_radiance_ : environment_radiance_,
         exposure, seed, pixels);
  return std::make_shared<const FramePixels>(std::move(pixels));
}

Frame Studio::environment_frame(std::uint64_t index) {
  // The sensor answers a request only `control_delay_frames` later; the label is what was applied.
  const auto delay = static_cast<std::uint64_t>(options_.control_delay_frames);
  const std::uint64_t request = index >= delay ? index - delay : 0;
  Frame frame;
  frame.camera = kEnvironmentCamera;
  frame.sequence = index;
  frame.time = TimestampNs{0} + Seconds(static_cast<double>(index) / options_.environment_fps);
  frame.exposure = options_.schedule[request % options_.schedule.size()];
  frame.world_from_camera = cameras_[kEnvironmentCamera].world_from_camera;
  frame.pixels = environment_clip_.empty()
                     ? film(kEnvironmentCamera, frame.exposure, options_.seed * 7919 + 2 * index)
                     : environment_clip_[request % environment_clip_.size()];
  return frame;
}

Frame Studio::view_frame(std::uint64_t index) {
  Frame frame;
  frame.camera = kViewCamera;
  frame.sequence = index;
  // Half a frame after the environment, as free-running cameras are.
  frame.time = TimestampNs{0} + Seconds((static_cast<double>(index) + .5) / options_.view_fps);
  frame.exposure = *options_.view_exposure;
  frame.world_from_camera = cameras_[kViewCamera].world_from_camera;
  frame.pixels = view_clip_.empty()
                     ? film(kViewCamera, frame.exposure, options_.seed * 104729 + 2 * index + 1)
                     : view_clip_[index % view_clip_.size()];
  return frame;
}

bool Studio::take_darker(int camera, double factor) {
  if (camera != kViewCamera) return false;
  darker_ = factor;
  return true;
}

Result<void> Studio::set_exposures(int camera, const std::vector<Exposure>& exposures) {
  if (camera != kEnvironmentCamera) return FrameSource::set_exposures(camera, exposures);
  wanted_.put(exposures);
  return {};
}

// Between two view frames.
Frame Studio::darker_frame(double factor) const {
  Frame frame;
  frame.camera = kViewCamera;
  frame.sequence = next_view_;
  frame.time =
      TimestampNs{0} + Seconds((static_cast<double>(next_view_) + .25) / options_.view_fps);
  frame.exposure = {options_.view_exposure->time * factor, options_.view_exposure->gain};
  frame.world_from_camera = cameras_[kViewCamera].world_from_camera;
  frame.pixels = film(kViewCamera, frame.exposure, options_.seed * 15485863 + next_view_);
  frame.for_light = true;
  return frame;
}

Result<std::optional<Frame>> Studio::next() {
  const auto dropped = [&](std::uint64_t index) {
    return options_.drop_every > 0 &&
           (index + 1) % static_cast<std::uint64_t>(options_.drop_every) == 0;
  };
  if (auto exposures = wanted_.take()) {
    options_.schedule = exposures->empty() ? first_schedule_ : std::move(*exposures);
    film_environment_clip();
  }
  while (dropped(next_environment_)) ++next_environment_;
  while (dropped(next_view_)) ++next_view_;
  if (next_view_ >= static_cast<std::uint64_t>(options_.view_frames)) return std::optional<Frame>();
  const double environment_time = static_cast<double>(next_environment_) / options_.environment_fps;
  const double view_time = (static_cast<double>(next_view_) + .5) / options_.view_fps;
  if (environment_time <= view_time) return std::optional(environment_frame(next_environment_++));
  if (const double factor = darker_.exchange(0); factor > 0)
    return std::optional(darker_frame(factor));
  return std::optional(view_frame(next_view_++));
}

}  // namespace penumbra::capture
