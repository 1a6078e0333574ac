// The chart's results as a table and as pictures of error against time.
#pragma once

#include <cstddef>
#include <filesystem>
#include <limits>
#include <nlohmann/json_fwd.hpp>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/result.h"

namespace penumbra::tools {

/// One method with one configuration in one environment with one object. NaN: not measured.
struct ChartPoint {
  std::string environment, mesh, method;
  bool baseline = false;  // a method of others, to compare with
  int max_lights = 0;     // allowed; `lights` is how many there were
  int coefficients = 0, lights = 0, map_size = 0, bake_rays = 0, environment_rows = 0;
  int fine_lights = 0;                   // with finely drawn shadows
  int sampling = 0, object_samples = 0;  // of a light: on the floor, and at an object's vertex
  double update_rate = 1;                // light updates a frame
  double object_rel_rmse = 0, object_bias = 0;  // relative to the object's mean luminance
  double shadow_rmse = 0, shadow_bias = 0;      // of s = L/L_0
  double penumbra_error = std::numeric_limits<double>::quiet_NaN();  // |w/w_ref - 1|
  double flip = 0;                                                   // mean HDR-FLIP, 0..1
  double flicker = std::numeric_limits<double>::quiet_NaN();         // relative to mean luminance
  double ms_p50 = 0, ms_p99 = 0;                                     // of one light update
  std::size_t bytes = 0;
  double reference_error = 0;  // noise of the reference on the object, taken out of object_rel_rmse
  bool chosen = false;         // what the program picks by itself here
  bool full = false;           // every knob as far as it goes by default
  // Of what is chosen: the time of every knob at full over its own, and its own over that of the
  // cheapest point that keeps the default limit.
  double saved = std::numeric_limits<double>::quiet_NaN(),
         regret = std::numeric_limits<double>::quiet_NaN();
};

/// Rows of objects as CSV: a header of the columns' names, cells quoted as RFC 4180 asks, lines
/// ended by LF. What is not finite or null is an empty cell.
std::string csv_table(const nlohmann::ordered_json& columns, const nlohmann::ordered_json& rows);

/// Every point as a row under a header that names units, as csv_table.
std::string chart_csv(std::span<const ChartPoint> points);
/// The same as an array of objects by the columns' names; what is not finite becomes null when it
/// is printed.
nlohmann::ordered_json chart_json(std::span<const ChartPoint> points);

/// Indices of the points (cost, error) that no other beats, in order of cost: no other is as good
/// in both and better in one. Equal points stand together; what is not finite is left out.
std::vector<std::size_t> pareto_front(std::span<const std::pair<double, double>> points);

/// Writes error-time.svg, where every configuration stands at its mean over the environments and
/// meshes it was measured in, and error-time-<environment>.svg for each environment: shadow error
/// above, object error below, over the median time, all logarithmic. What is 0 stands at a tick of
/// its own. Characters outside letters, digits, '.', '_' and '-' become '-' in file names.
/// errors:  kInvalid (no points), kUnavailable (no gnuplot), kUnwritable; no file is half-written
/// threads: reentrant; runs gnuplot as a child process, without a shell
Result<void> write_chart_plots(const std::filesystem::path& folder,
                               std::span<const ChartPoint> points);

}  // namespace penumbra::tools
