// Bytes against error of several coders: rows, a plot, and what one takes at another's error.
// threads: reentrant
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "core/result.h"
#include "tools/runs/output.h"

namespace penumbra::tools {

struct RatePoint {
  std::string coder, setting;
  std::size_t bytes = 0;
  double error = 0;  // relative
};

/// What a chart's axes and columns are called.
struct RateNames {
  std::string title, error_label;  // of the plot
  std::string error_column;        // of the table
  std::string bytes_label;         // of the plot
  double bytes_unit = 1;           // in bytes
};

/// rate-distortion.csv and .svg in the folder; without gnuplot only the first, with a warning.
/// errors: kUnwritable
Result<void> write_rates(const OutputFolder& output, const std::vector<RatePoint>& points,
                         const RateNames& names);

/// On the straight line between logarithms; nothing outside the coder's range.
std::optional<double> bytes_at(const std::vector<RatePoint>& points, const std::string& coder,
                               double error);

}  // namespace penumbra::tools
