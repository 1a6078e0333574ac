#include "capture/environment/common_surfaces.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <map>
#include <optional>

#include "calib/camera/camera_model.h"
#include "calib/camera/lens_vignetting.h"
#include "calib/camera/vignetting.h"
#include "capture/camera_regions.h"
#include "capture/frames.h"
#include "capture/hdr/merge.h"
#include "capture/hdr/pose_warp.h"
#include "core/threads/queues.h"

namespace penumbra::capture {

namespace {

using NewestByExposure = std::map<double, Frame>;  // by exposure time times gain

// A part of a picture as if its lens let all light through.
void undo_vignetting(const calib::CameraModel& lens, const std::array<double, 3>& terms, int x0,
                     int y0, Image<Rgb>& radiance) {
  const Vignetting left = calib::vignetting_of(lens, terms);
  for (int y = 0; y < lens.height && !left.none(); ++y)
    for (int x = 0; x < lens.width; ++x)
      radiance.at(x0 + x, y0 + y) =
          radiance.at(x0 + x, y0 + y) * static_cast<float>(1 / left.at({x + .5, y + .5}));
}

Result<StillPicture> merge_latest(const CameraInfo& camera, const NewestByExposure& frames) {
  if (frames.empty())
    return fail(ErrorCode::kUndetermined, camera.name, "has no frame in the capture");
  StillPicture out{camera, {}, {}};
  ExposureStack stack{{}, {}, camera.response, camera.noise, camera.black_level};
  for (const auto& [product, frame] : frames) {
    stack.frames.push_back(frame.pixels);
    stack.exposures.push_back(frame.exposure);
    out.camera.world_from_camera = frame.world_from_camera;
  }
  auto merged = merge(stack);
  if (!merged)
    return fail(merged.error().code, camera.name + ": " + merged.error().where,
                merged.error().detail);
  out.radiance = std::move(merged->radiance);
  out.clipped = std::move(merged->clipped);
  if (camera.lenses.empty())
    undo_vignetting(camera.projection, camera.vignetting, 0, 0, out.radiance);
  for (const Lens& lens : camera.lenses)
    undo_vignetting(lens.projection, camera.vignetting, lens.x_px, lens.y_px, out.radiance);
  return out;
}

std::optional<Rgb> sample(const StillPicture& picture, glm::dvec2 at) {
  const auto x = static_cast<int>(std::floor(at.x)), y = static_cast<int>(std::floor(at.y));
  if (x < 0 || y < 0 || x >= picture.radiance.width() || y >= picture.radiance.height() ||
      picture.clipped.at(x, y))
    return std::nullopt;
  return picture.radiance.at(x, y);
}

// Means of one patch in both pictures; nothing where either clips, ends, or is uneven.
std::optional<calib::ColourPair> patch(const StillPicture& environment,
                                       std::span<const CameraRegion> regions,
                                       const StillPicture& view,
                                       const glm::dquat& environment_from_view, int left, int top,
                                       int side) {
  constexpr int kSamples = 6;  // a side
  constexpr double kUneven = .15, kDark = 1e-6;
  glm::dvec3 sums[2] = {}, squares[2] = {};
  for (int i = 0; i < kSamples * kSamples; ++i) {
    const glm::dvec2 at(left + (i % kSamples + .5) * side / kSamples,
                        top + (double(i / kSamples) + .5) * side / kSamples);
    const auto direction = calib::direction_from_pixel(view.camera.projection, at);
    if (!direction) return std::nullopt;
    const auto there = find_in_picture(regions, environment_from_view * *direction);
    const auto seen = there ? sample(environment, *there) : std::nullopt, own = sample(view, at);
    if (!seen || !own) return std::nullopt;
    for (int c = 0; c < 3; ++c) {
      const double both[] = {double((*seen)[c]), double((*own)[c])};
      for (int k = 0; k < 2; ++k) sums[k][c] += both[k], squares[k][c] += both[k] * both[k];
    }
  }
  constexpr double n = kSamples * kSamples;
  for (int k = 0; k < 2; ++k)
    for (int c = 0; c < 3; ++c) {
      const double mean = sums[k][c] / n, variance = squares[k][c] / n - mean * mean;
      if (!(mean > kDark) || variance > kUneven * kUneven * mean * mean) return std::nullopt;
    }
  const auto colour = [&](int k) {
    const glm::dvec3 mean = sums[k] / n;
    return Rgb{static_cast<float>(mean.x), static_cast<float>(mean.y), static_cast<float>(mean.z)};
  };
  return calib::ColourPair{colour(0), colour(1)};
}

}  // namespace

Result<std::vector<StillPicture>> merge_still(FrameSource& source,
                                              const std::vector<std::string>& cameras) {
  constexpr std::size_t kMaxExposures = 16;
  const auto& known = source.cameras();
  std::map<int, NewestByExposure> frames;
  for (const std::string& name : cameras) {
    const auto found = std::ranges::find(known, name, &CameraInfo::name);
    if (found == known.end())
      return fail(ErrorCode::kNotFound, name, "is not a camera of the capture");
    frames[static_cast<int>(found - known.begin())];
  }
  while (true) {
    PENUMBRA_ASSIGN(frame, source.next());
    if (!frame) break;
    const auto wanted = frames.find(frame->camera);
    if (wanted == frames.end()) continue;
    wanted->second.insert_or_assign(frame->exposure.product(), *frame);
    if (wanted->second.size() > kMaxExposures) wanted->second.erase(wanted->second.begin());
  }
  std::vector<StillPicture> out;
  for (const std::string& name : cameras) {
    const auto found = std::ranges::find(known, name, &CameraInfo::name);
    PENUMBRA_ASSIGN(merged, merge_latest(*found, frames[static_cast<int>(found - known.begin())]));
    out.push_back(std::move(merged));
  }
  return out;
}

std::vector<CommonSurface> common_surfaces(const StillPicture& environment,
                                           const StillPicture& view, double turned_rad) {
  constexpr double kPixelsOfTheEnvironment = 3;  // a side of a patch
  constexpr int kMin = 8;
  const double ratio =
      pixel_angle(environment.camera.projection) / pixel_angle(view.camera.projection);
  const int side = std::max(kMin, static_cast<int>(std::lround(kPixelsOfTheEnvironment * ratio)));
  const glm::dquat environment_from_view =
      glm::angleAxis(turned_rad, glm::dvec3(0, 1, 0)) *
      glm::conjugate(environment.camera.world_from_camera.rotation) *
      view.camera.world_from_camera.rotation;
  std::vector<CommonSurface> out;
  const auto regions = camera_regions(environment.camera, environment.camera.world_from_camera);
  if (!regions) return out;
  for (int top = 0; top + side <= view.radiance.height(); top += side)
    for (int left = 0; left + side <= view.radiance.width(); left += side)
      if (const auto colours =
              patch(environment, *regions, view, environment_from_view, left, top, side))
        out.push_back({{left + side / 2., top + side / 2.}, *colours});
  return out;
}

}  // namespace penumbra::capture
