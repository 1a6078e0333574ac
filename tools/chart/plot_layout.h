// Where things stand in a plot: logarithmic axes, and labels that cover nothing.
#pragma once

#include <cmath>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace penumbra::tools {

/// A logarithmic axis whose values start at `least`. What is 0 or less stands at `zero`, below all
/// else, on a tick of its own; `zero` is 0 when there is no such value.
struct PlotAxis {
  double low = .1, high = 10, smallest = .1, zero = 0;

  double clamped(double v) const { return v > 0 ? v : zero; }
  double fraction(double v) const { return std::log(clamped(v) / low) / std::log(high / low); }
  /// Between `zero` and `least`: where the scale breaks.
  double end_of_zero() const { return std::sqrt(zero * smallest); }
};

/// An axis with room for all finite values.
PlotAxis make_axis(std::span<const double> values);

/// The tick list of gnuplot: labelled (unless not wanted) at 1, 2 and 5 of each decade, at 3 too
/// where there is room and at 1 alone where there is little, with marks between.
std::string axis_ticks(const PlotAxis& axis, bool labelled);

/// Pixels of a plot, y upwards.
struct PlotPosition {
  double x = 0, y = 0;
};
struct PlotBox {
  double x0 = 0, y0 = 0, x1 = 0, y1 = 0;
};

/// A drawn point, which covers a square.
struct PlotMarker {
  PlotPosition at;
  double size_px = 0;
};

/// A label wanted at a point, with the size its text takes.
struct WantedLabel {
  PlotPosition at;
  double width_px = 0, height_px = 0;
};

/// The box of every label in the order of `wanted`; none where there is no room near the point.
/// Boxes lie within `area`, overlap neither each other nor the `markers`, and keep off the
/// `avoided` positions where they can. Earlier labels choose first.
/// threads: reentrant
std::vector<std::optional<PlotBox>> place_labels(const PlotBox& area,
                                                 std::span<const WantedLabel> wanted,
                                                 std::span<const PlotMarker> markers,
                                                 std::span<const PlotPosition> avoided);

/// The position on a box nearest to a point: where a line to the label ends.
PlotPosition nearest_on(const PlotBox& box, const PlotPosition& point);

}  // namespace penumbra::tools
