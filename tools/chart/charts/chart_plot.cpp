#include "tools/chart/charts/chart_plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <numeric>
#include <set>
#include <tuple>

#include "core/counted.h"
#include "core/io/files.h"
#include "tools/chart/charts/plots.h"
#include "tools/plots/gnuplot.h"

namespace penumbra::tools {

namespace {

// ---- The table. ----

std::string quoted(const std::string& cell) {
  if (cell.find_first_of(",\"\r\n") == std::string::npos) return cell;
  std::string out = "\"";
  for (const char c : cell) out += c == '"' ? "\"\"" : std::string(1, c);
  return out + "\"";
}

std::string number(double value) {
  return std::isfinite(value) ? fmt::format("{:.6g}", value) : std::string();
}

std::string csv_cell(const nlohmann::ordered_json& cell) {
  if (cell.is_string()) return quoted(cell.get_ref<const std::string&>());
  if (cell.is_null()) return {};
  if (cell.is_boolean()) return cell.get<bool>() ? "1" : "0";
  return cell.is_number_float() ? number(cell.get<double>()) : cell.dump();
}

nlohmann::ordered_json chart_row(const ChartPoint& p) {
  return {{"environment", p.environment},
          {"mesh", p.mesh},
          {"method", p.method},
          {"baseline", p.baseline},
          {"coefficients", p.coefficients},
          {"lights", p.lights},
          {"fine_lights", p.fine_lights},
          {"samples", p.sampling},
          {"object_samples", p.object_samples},
          {"map_size_px", p.map_size},
          {"bake_rays", p.bake_rays},
          {"environment_rows", p.environment_rows},
          {"updates_per_frame", p.update_rate},
          {"object_rel_rmse", p.object_rel_rmse},
          {"object_rel_bias", p.object_bias},
          {"shadow_rmse", p.shadow_rmse},
          {"shadow_bias", p.shadow_bias},
          {"penumbra_rel_error", p.penumbra_error},
          {"hdr_flip_mean", p.flip},
          {"flicker_rel", p.flicker},
          {"light_update_p50_ms", p.ms_p50},
          {"light_update_p99_ms", p.ms_p99},
          {"memory_bytes", p.bytes},
          {"chosen", p.chosen},
          {"lights_allowed", p.max_lights},
          {"reference_rel_error", p.reference_error},
          {"full_over_chosen_ms", p.saved},
          {"chosen_over_cheapest_ms", p.regret}};
}

// ---- What one picture shows. ----

struct Mean {
  double sum = 0;
  int count = 0;
  void add(double v) {
    if (std::isfinite(v)) sum += v, ++count;
  }
  double value() const { return count ? sum / count : std::numeric_limits<double>::quiet_NaN(); }
};

// One configuration at its mean over scenes.
struct Mark {
  std::string method, configuration;
  bool baseline = false, chosen = false;
  Mean ms, shadow, object_percent;
};

std::vector<Mark> gather(std::span<const ChartPoint> points) {
  std::vector<Mark> out;
  std::map<std::tuple<std::string, bool, int, int, int, int, int, int, double>, std::size_t> known;
  for (const ChartPoint& p : points) {
    // What others do, and what is chosen, differs from light to light and is one method all the
    // same.
    const bool by_name = p.baseline || p.chosen;
    const auto configured = [&](int value) { return by_name ? 0 : value; };
    const auto [entry, fresh] =
        known.try_emplace({p.method, p.baseline, configured(p.coefficients),
                           configured(p.max_lights), configured(p.sampling), configured(p.map_size),
                           p.bake_rays, configured(p.environment_rows), p.update_rate},
                          out.size());
    std::string configuration = fmt::format("{} SH", p.coefficients);
    if (p.max_lights > 0)
      configuration +=
          fmt::format(", {} of {}", counted(p.max_lights, "light"), counted(p.sampling, "sample"));
    if (fresh) {
      Mark& mark = out.emplace_back();
      mark.method = p.method;
      mark.baseline = p.baseline;
      mark.configuration = configuration;
    }
    Mark& mark = out[entry->second];
    if (mark.configuration != configuration) mark.configuration = "as each light needs";
    mark.chosen |= p.chosen;
    mark.ms.add(p.ms_p50);
    mark.shadow.add(p.shadow_rmse);
    mark.object_percent.add(100 * p.object_rel_rmse);
  }
  return out;
}

using Marks = std::vector<const Mark*>;

// On a logarithmic axis 0 is drawn below all else; 0 where there is no such value.
double zero_of(const std::vector<Mark>& marks, Mean Mark::*value) {
  double smallest = HUGE_VAL;
  bool any_zero = false;
  for (const Mark& m : marks) {
    const double v = (m.*value).value();
    if (v > 0) smallest = std::min(smallest, v);
    any_zero |= v == 0;
  }
  constexpr double kBelow = .5, kOfNothingElse = .1;
  if (!any_zero) return 0;
  return std::isfinite(smallest) ? kBelow * smallest : kOfNothingElse;
}

Marks front_of(const std::vector<Mark>& marks, Mean Mark::*error) {
  std::vector<std::pair<double, double>> values;
  for (const Mark& m : marks) values.emplace_back(m.ms.value(), (m.*error).value());
  Marks out;
  for (const std::size_t i : pareto_front(values)) out.push_back(&marks[i]);
  return out;
}

Marks select(const std::vector<Mark>& marks, const auto& wanted) {
  Marks out;
  for (const Mark& m : marks)
    if (wanted(m)) out.push_back(&m);
  return out;
}

// ---- The data that error_time.gp draws. ----

class PlotData {
 public:
  explicit PlotData(const std::vector<Mark>& marks)
      : ms_(zero_of(marks, &Mark::ms)),
        shadow_(zero_of(marks, &Mark::shadow)),
        object_(zero_of(marks, &Mark::object_percent)) {
    const auto measured = [&](Mean Mark::*error) {
      return std::ranges::any_of(marks, [&](const Mark& m) { return (m.*error).count > 0; });
    };
    settings_ = fmt::format(
        "zero_ms = {:.9g}\nzero_shadow = {:.9g}\nzero_object = {:.9g}\n"
        "measured_shadow = {:d}\nmeasured_object = {:d}\nxlabel_text = {}\n",
        ms_, shadow_, object_, measured(&Mark::shadow), measured(&Mark::object_percent),
        gnuplot_quoted(std::string("Light update, median time (ms)") +
                       (ms_ > 0 ? "; methods without any cost stand at 0" : "")));
  }
  // A block without a row is written as one that gnuplot draws nothing for.
  void add(const std::string& name, const Marks& marks) {
    blocks_ += gnuplot_cell(name) + "\n";
    for (const Mark* m : marks)
      blocks_ += fmt::format("{:.9g}\t{:.9g}\t{:.9g}\t{}\n", at(m->ms, ms_), at(m->shadow, shadow_),
                             at(m->object_percent, object_), gnuplot_cell(m->configuration));
    blocks_ += marks.empty() ? "NaN\tNaN\tNaN\tnone\n\n\n" : "\n\n";
  }
  std::string script() const { return settings_ + gnuplot_block("data", blocks_) + kErrorTimePlot; }

 private:
  static double at(const Mean& mean, double zero) {
    return mean.value() == 0 ? zero : mean.value();
  }

  double ms_, shadow_, object_;
  std::string settings_, blocks_;
};

std::string plot_script(const std::string& title, const std::vector<Mark>& marks,
                        const std::vector<std::string>& baselines) {
  PlotData data(marks);
  data.add("shadow front", front_of(marks, &Mark::shadow));
  data.add("object front", front_of(marks, &Mark::object_percent));
  data.add("Penumbra", select(marks, [](const Mark& m) { return !m.baseline; }));
  data.add("chosen", select(marks, [](const Mark& m) { return m.chosen; }));
  // Of all plots, so that each looks the same in all.
  for (const std::string& name : baselines)
    data.add(name, select(marks, [&](const Mark& m) { return m.baseline && m.method == name; }));
  return "heading = " + gnuplot_quoted(title) + "\n" + data.script();
}

// ---- Files. ----

std::string file_name_of(const std::string& environment) {
  std::string out;
  for (const char c : environment.substr(0, 80)) {
    const bool safe = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                      c == '.' || c == '_' || c == '-';
    out += safe ? c : '-';
  }
  return out.empty() ? "unnamed" : out;
}

// Different names may come out alike; the later one gets a number.
std::string unused(const std::string& name, std::set<std::string>& used) {
  std::string out = name;
  for (int n = 2; !used.insert(out).second; ++n) out = fmt::format("{}-{}", name, n);
  return out;
}

}  // namespace

std::string csv_table(const nlohmann::ordered_json& columns, const nlohmann::ordered_json& rows) {
  std::string header, out;
  for (const auto& [column, cell] : columns.items()) header += ',' + column;
  out = header.substr(1) + '\n';
  for (const nlohmann::ordered_json& row : rows) {
    std::string line;
    for (const auto& [column, cell] : row.items()) line += ',' + csv_cell(cell);
    out += line.substr(1) + '\n';
  }
  return out;
}

std::string chart_csv(std::span<const ChartPoint> points) {
  return csv_table(chart_row({}), chart_json(points));
}

nlohmann::ordered_json chart_json(std::span<const ChartPoint> points) {
  auto rows = nlohmann::ordered_json::array();
  for (const ChartPoint& p : points) rows.push_back(chart_row(p));
  return rows;
}

std::vector<std::size_t> pareto_front(std::span<const std::pair<double, double>> points) {
  std::vector<std::size_t> order(points.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::erase_if(order, [&](std::size_t i) {
    return !std::isfinite(points[i].first) || !std::isfinite(points[i].second);
  });
  std::ranges::stable_sort(order, {}, [&](std::size_t i) { return points[i]; });
  std::vector<std::size_t> out;
  for (const std::size_t i : order)
    if (out.empty() || points[i].second < points[out.back()].second ||
        points[i] == points[out.back()])
      out.push_back(i);
  return out;
}

Result<void> write_chart_plots(const std::filesystem::path& folder,
                               std::span<const ChartPoint> points) {
  if (points.empty()) return fail(ErrorCode::kInvalid, folder.string(), "no points to plot");
  std::map<std::string, std::vector<ChartPoint>> environments;
  std::set<std::string> meshes, used;
  std::vector<std::string> baselines;
  for (const ChartPoint& p : points) {
    environments[p.environment].push_back(p);
    meshes.insert(p.mesh);
    if (p.baseline && std::ranges::find(baselines, p.method) == baselines.end())
      baselines.push_back(p.method);
  }
  PENUMBRA_TRY(make_folder(folder));
  const std::string objects = counted(meshes.size(), "object");
  const std::string title = fmt::format("Error against time: mean over {} and {}",
                                        counted(environments.size(), "environment"), objects);
  PENUMBRA_TRY(
      run_gnuplot(plot_script(title, gather(points), baselines), folder / "error-time.svg"));
  for (const auto& [name, own] : environments) {
    const std::string own_title = fmt::format("Error against time: {}, {}", name, objects);
    PENUMBRA_TRY(
        run_gnuplot(plot_script(own_title, gather(own), baselines),
                    folder / fmt::format("error-time-{}.svg", unused(file_name_of(name), used))));
  }
  return {};
}

}  // namespace penumbra::tools
