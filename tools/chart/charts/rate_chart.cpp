#include "tools/chart/charts/rate_chart.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/io/files.h"
#include "core/io/log.h"
#include "tools/plots/gnuplot.h"

namespace penumbra::tools {

namespace {

std::string plot_of(const std::vector<RatePoint>& points, const RateNames& names) {
  std::string script =
      "set terminal svg size 900,640 font 'sans-serif,13' background 'white'\n"
      "set logscale xy\nset grid\nset key top right\n";
  script += fmt::format("set xlabel {}\nset ylabel {}\nset title {}\nplot ",
                        gnuplot_quoted(names.bytes_label), gnuplot_quoted(names.error_label),
                        gnuplot_quoted(names.title));
  std::vector<std::string> coders;
  for (const RatePoint& p : points)
    if (std::ranges::find(coders, p.coder) == coders.end()) coders.push_back(p.coder);
  for (std::size_t i = 0; i < coders.size(); ++i)
    script += fmt::format("{}'-' using 1:2 with linespoints linewidth 2 pointtype {} title {}",
                          i > 0 ? ", " : "", 5 + 2 * i, gnuplot_quoted(coders[i]));
  script += "\n";
  for (const std::string& coder : coders) {
    for (const RatePoint& p : points)
      if (p.coder == coder)
        script +=
            fmt::format("{} {}\n", static_cast<double>(p.bytes) / names.bytes_unit, 100 * p.error);
    script += "e\n";
  }
  return script;
}

}  // namespace

Result<void> write_rates(const OutputFolder& output, const std::vector<RatePoint>& points,
                         const RateNames& names) {
  std::string csv = fmt::format("coder,setting,bytes,{}\n", names.error_column);
  for (const RatePoint& p : points)
    csv += fmt::format("\"{}\",{},{},{:.6g}\n", p.coder, p.setting, p.bytes, p.error);
  PENUMBRA_TRY(write_bytes(output.file("rate-distortion.csv"), csv));
  if (const auto plot = run_gnuplot(plot_of(points, names), output.file("rate-distortion.svg"));
      !plot)
    log_warning("the plot is not written: {}: {}", plot.error().where, plot.error().detail);
  return {};
}

std::optional<double> bytes_at(const std::vector<RatePoint>& points, const std::string& coder,
                               double error) {
  std::vector<const RatePoint*> own;
  for (const RatePoint& p : points)
    if (p.coder == coder) own.push_back(&p);
  std::ranges::sort(own, {}, [](const RatePoint* p) { return p->error; });
  for (std::size_t i = 0; i + 1 < own.size(); ++i) {
    if (!(own[i]->error <= error && error <= own[i + 1]->error)) continue;
    const double fraction =
        std::log(error / own[i]->error) / std::log(own[i + 1]->error / own[i]->error);
    return std::exp(std::lerp(std::log(static_cast<double>(own[i]->bytes)),
                              std::log(static_cast<double>(own[i + 1]->bytes)), fraction));
  }
  return {};
}

}  // namespace penumbra::tools
