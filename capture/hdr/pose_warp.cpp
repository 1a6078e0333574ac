#include "capture/hdr/pose_warp.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "calib/camera/camera_model.h"
#include "capture/camera_regions.h"
#include "capture/warp_grid.h"

namespace penumbra::capture {

double pixel_angle(const calib::CameraModel& p) {
  const glm::dvec2 middle(p.width / 2., p.height / 2.);
  const auto a = calib::direction_from_pixel(p, middle),
             b = calib::direction_from_pixel(p, middle + glm::dvec2(1, 0));
  return a && b ? std::acos(std::clamp(glm::dot(*a, *b), -1., 1.)) : 1e-3;
}

std::shared_ptr<const FramePixels> turned(const FramePixels& picture,
                                          const calib::CameraModel& projection,
                                          const Vignetting& vignetting,
                                          const glm::dquat& before_from_now,
                                          Image<std::uint8_t>& valid) {
  if (valid.width() != projection.width || valid.height() != projection.height)
    valid = Image<std::uint8_t>(projection.width, projection.height);
  const auto where = [&](const glm::dvec2& px) -> std::optional<PixelHit> {
    const auto direction = calib::direction_from_pixel(projection, px);
    if (!direction) return std::nullopt;
    const auto before = calib::pixel_from_direction(projection, before_from_now * *direction);
    return before ? std::optional(PixelHit{*before}) : std::nullopt;
  };
  const auto turn = [&](const auto& image) -> FramePixels {
    std::decay_t<decltype(image)> out(image.width(), image.height());
    warp_grid(image.width(), image.height(), where, [&](int x, int y, const PixelHit* seen) {
      constexpr double kAlike = .03;
      const bool alike =
          seen &&
          (vignetting.none() ||
           std::abs(vignetting.at({x + .5, y + .5}) / vignetting.at(seen->px) - 1) < kAlike);
      valid.at(x, y) = alike ? 1 : 0;
      if (!alike) return;
      out.at(x, y) = image.at(std::clamp(static_cast<int>(seen->px.x), 0, image.width() - 1),
                              std::clamp(static_cast<int>(seen->px.y), 0, image.height() - 1));
    });
    return out;
  };
  return std::make_shared<const FramePixels>(std::visit(turn, picture));
}

}  // namespace penumbra::capture
