#include "tools/chart/charts/panel_plot.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <map>

#include "tools/chart/charts/plots.h"
#include "tools/plots/gnuplot.h"

namespace penumbra::tools {

namespace {

constexpr double kMinPlotted = .01;  // per cent: a logarithmic axis has no zero

std::string array_of(const std::string& name, const std::vector<std::string>& texts) {
  std::vector<std::string> quoted;
  for (const std::string& text : texts) quoted.push_back(gnuplot_quoted(text));
  return fmt::format("array {}[{}] = [{}]\n", name, texts.size(), fmt::join(quoted, ", "));
}

}  // namespace

std::string panel_plot(const std::vector<PanelPoint>& points, std::size_t columns,
                       const std::string& time_axis, const std::string& error_axis) {
  std::vector<std::string> methods, panels;
  std::map<std::string, std::map<std::string, std::string>> rows;
  const auto note = [](std::vector<std::string>& names, const std::string& name) {
    if (std::ranges::find(names, name) == names.end()) names.push_back(name);
  };
  for (const PanelPoint& p : points) {
    note(panels, p.panel), note(methods, p.method);
    rows[p.panel][p.method] +=
        fmt::format("{:.5g}\t{:.5g}\n", p.ms, std::max(kMinPlotted, 100 * p.error));
  }
  std::string script =
      fmt::format("columns = {}\nrows = {}\ntime_axis = {}\nerror_axis = {}\n", columns,
                  panels.size() / columns, gnuplot_quoted(time_axis), gnuplot_quoted(error_axis)) +
      array_of("methods", methods) + array_of("titles", panels);
  for (std::size_t i = 0; i < panels.size(); ++i) {
    std::string data;
    for (const std::string& method : methods) {
      const std::string& own = rows[panels[i]][method];
      data += (own.empty() ? "NaN\tNaN\n" : own) + "\n\n";
    }
    script += gnuplot_block(fmt::format("panel{}", i + 1), data);
  }
  return script + kPanelsPlot;
}

}  // namespace penumbra::tools
