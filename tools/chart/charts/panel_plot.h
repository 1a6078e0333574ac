// Plots of error against time in panels side by side, one line a method.
// threads: reentrant
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace penumbra::tools {

struct PanelPoint {
  std::string panel, method;
  double ms = 0, error = 0;  // error relative, drawn in per cent
};

/// A script for gnuplot. in: as many panels a row as `columns` says, and none left over
std::string panel_plot(const std::vector<PanelPoint>& points, std::size_t columns,
                       const std::string& time_axis, const std::string& error_axis);

}  // namespace penumbra::tools
