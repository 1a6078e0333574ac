#include "tools/chart/plot_layout.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/conventions.h"

namespace penumbra::tools {

namespace {

bool overlap(const PlotBox& a, const PlotBox& b) {
  return a.x0 < b.x1 && b.x0 < a.x1 && a.y0 < b.y1 && b.y0 < a.y1;
}

bool contains(const PlotBox& outer, const PlotBox& inner) {
  return inner.x0 >= outer.x0 && inner.x1 <= outer.x1 && inner.y0 >= outer.y0 &&
         inner.y1 <= outer.y1;
}

bool contains(const PlotBox& box, const PlotPosition& p) {
  return p.x >= box.x0 && p.x <= box.x1 && p.y >= box.y0 && p.y <= box.y1;
}

PlotBox around(const PlotPosition& p, double width, double height) {
  return {p.x - width / 2, p.y - height / 2, p.x + width / 2, p.y + height / 2};
}

// The box in direction `angle` whose side is `distance` away from the point.
PlotBox candidate(const WantedLabel& label, double distance, double angle) {
  const PlotPosition centre{label.at.x + std::cos(angle) * (distance + label.width_px / 2),
                            label.at.y + std::sin(angle) * (distance + label.height_px / 2)};
  return around(centre, label.width_px, label.height_px);
}

std::optional<PlotBox> best_place(const PlotBox& area, const WantedLabel& label,
                                  const std::vector<PlotBox>& taken,
                                  std::span<const PlotPosition> avoided) {
  constexpr int kDirections = 16;
  constexpr double kAvoidedCost = 9;  // a crossed line weighs as much as a few pixels of distance
  double best_cost = std::numeric_limits<double>::infinity();
  std::optional<PlotBox> best;
  for (const double distance : {12., 17., 24., 34., 50., 70., 90.})
    for (int k = 0; k < kDirections; ++k) {
      const PlotBox box = candidate(label, distance, 2 * kPi * k / kDirections);
      if (!contains(area, box)) continue;
      if (std::ranges::any_of(taken, [&](const PlotBox& t) { return overlap(t, box); })) continue;
      const auto crossed =
          std::ranges::count_if(avoided, [&](const PlotPosition& p) { return contains(box, p); });
      const double cost = distance + kAvoidedCost * static_cast<double>(crossed);
      if (cost < best_cost) best_cost = cost, best = box;
    }
  return best;
}

}  // namespace

PlotAxis make_axis(std::span<const double> values) {
  double smallest = HUGE_VAL, largest = 0;
  bool zero = false;
  for (const double v : values) {
    if (!std::isfinite(v)) continue;
    if (v > 0) smallest = std::min(smallest, v), largest = std::max(largest, v);
    zero |= !(v > 0);
  }
  if (largest == 0) smallest = largest = 1;
  const double pad = std::pow(std::max(largest / smallest, 2.), .07);
  PlotAxis axis{smallest / pad, largest * pad, smallest, 0};
  if (zero) {
    axis.zero = smallest / std::pow(largest / smallest + 10, .2);
    axis.low = axis.zero / pad;
  }
  return axis;
}

std::string axis_ticks(const PlotAxis& axis, bool labelled) {
  const double decades = std::log10(axis.high / axis.low);
  const double first = axis.zero > 0 ? axis.end_of_zero() : axis.low;
  std::string out;
  const auto add = [&](const std::string& text, double at, int level) {
    out +=
        fmt::format("{}'{}' {:.9g} {}", out.empty() ? "" : ", ", labelled ? text : "", at, level);
  };
  if (axis.zero > 0) add("0", axis.zero, 0);
  for (int k = static_cast<int>(std::floor(std::log10(axis.low))); std::pow(10., k) <= axis.high;
       ++k)
    for (int m = 1; m < 10; ++m) {
      const double at = m * std::pow(10., k);
      if (at < first || at > axis.high) continue;
      const bool major =
          m == 1 || (decades < 2.5 && (m == 2 || m == 5)) || (decades < 1.5 && m == 3);
      add(major ? fmt::format("{:g}", at) : "", at, major ? 0 : 1);
    }
  return "(" + out + ")";
}

std::vector<std::optional<PlotBox>> place_labels(const PlotBox& area,
                                                 std::span<const WantedLabel> wanted,
                                                 std::span<const PlotMarker> markers,
                                                 std::span<const PlotPosition> avoided) {
  std::vector<PlotBox> taken;
  for (const PlotMarker& m : markers) taken.push_back(around(m.at, m.size_px, m.size_px));
  std::vector<std::optional<PlotBox>> out;
  for (const WantedLabel& label : wanted) {
    out.push_back(best_place(area, label, taken, avoided));
    if (out.back()) taken.push_back(*out.back());
  }
  return out;
}

PlotPosition nearest_on(const PlotBox& box, const PlotPosition& point) {
  return {std::clamp(point.x, box.x0, box.x1), std::clamp(point.y, box.y0, box.y1)};
}

}  // namespace penumbra::tools
