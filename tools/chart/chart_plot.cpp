#include "tools/chart/chart_plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <numeric>
#include <set>
#include <tuple>

#include "core/files.h"
#include "tools/chart/plot_layout.h"
#include "tools/common/gnuplot.h"

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
  if (cell.is_boolean()) return cell.get<bool>() ? "1" : "0";
  return cell.is_number_float() ? number(cell.get<double>()) : cell.dump();
}

nlohmann::ordered_json row_of(const ChartPoint& p) {
  return {{"environment", p.environment},
          {"mesh", p.mesh},
          {"method", p.method},
          {"baseline", p.baseline},
          {"coefficients", p.coefficients},
          {"lights", p.lights},
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
          {"reference_rel_error", p.reference_error}};
}

// ---- What one picture shows. ----

std::string counted(auto n, const char* thing) {
  return fmt::format("{} {}{}", n, thing, n == 1 ? "" : "s");
}

// Shadow above, object below.
struct PanelStyle {
  const char* label;
  double scale;
};
constexpr std::array<PanelStyle, 2> kPanels{
    {{"Shadow error: RMSE of s = L/L_0", 1}, {"Object error: relative RMSE (%)", 100}}};

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
  Mean ms;
  std::array<Mean, kPanels.size()> error;
};

std::vector<Mark> gather(std::span<const ChartPoint> points) {
  std::vector<Mark> out;
  std::map<std::tuple<std::string, bool, int, int, int, int, int, int, double>, std::size_t> known;
  for (const ChartPoint& p : points) {
    // What others do, and what is chosen, differs from light to light and is one method all the same.
    const bool by_name = p.baseline || p.chosen;
    const auto configured = [&](int value) { return by_name ? 0 : value; };
    const auto [entry, fresh] =
        known.try_emplace({p.method, p.baseline, configured(p.coefficients),
                           configured(p.max_lights), configured(p.sampling), configured(p.map_size),
                           p.bake_rays, p.environment_rows, p.update_rate},
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
    mark.error[0].add(p.shadow_rmse);
    mark.error[1].add(p.object_rel_rmse);
  }
  return out;
}

// ---- Geometry in pixels. ----

constexpr double kLeft = 86, kAreaWidth = 660, kAreaHeight = 350, kTop = 52, kGap = 26,
                 kBottom = 62;
constexpr double kHeight = kTop + 2 * kAreaHeight + kGap + kBottom;
constexpr double kCharacter = 7.7, kLine = 15;  // of the labels, in the widest of the usual fonts

// Okabe and Ito's colours, which differ for every kind of colour vision, less yellow (too pale on
// white) and the blue that is ours; gnuplot's filled point types first, then the open ones.
constexpr std::array<const char*, 6> kColours{"#D55E00", "#009E73", "#000000",
                                              "#CC79A7", "#E69F00", "#56B4E9"};
constexpr std::array<int, 10> kPointTypes{5, 9, 11, 13, 15, 4, 8, 10, 12, 14};

std::string baseline_style(std::size_t index) {
  return fmt::format("points pt {} ps 1.35 lw 1.6 lc rgb '{}'",
                     kPointTypes[index % kPointTypes.size()], kColours[index % kColours.size()]);
}
constexpr const char* kOursStyle = "points pt 7 ps .62 lc rgb '#0072B2'";
constexpr const char* kChosenStyle = "points pt 6 ps 1.7 lw 2 lc rgb '#0072B2'";
constexpr const char* kFrontStyle = "steps lw 1.6 lc rgb '#999999'";

// ---- The script. ----

struct Plot {
  std::string title;
  std::vector<Mark> marks;
  std::vector<std::string> baselines;  // of all plots, so that each looks the same in all
};

double legend_width(const Plot& plot) {
  std::size_t longest = 26;
  for (const std::string& name : plot.baselines) longest = std::max(longest, name.size());
  return 50 + kCharacter * static_cast<double>(std::min<std::size_t>(longest, 60));
}

double plot_width(const Plot& plot) {
  return kLeft + kAreaWidth + legend_width(plot);
}

// One panel: marks in it, and where they stand.
struct Panel {
  std::size_t index = 0;
  PlotAxis x, y;
  std::vector<const Mark*> marks;

  double error(const Mark& mark) const { return kPanels[index].scale * mark.error[index].value(); }
  PlotPosition position(double ms, double error) const {
    return {kAreaWidth * x.fraction(ms), kAreaHeight * y.fraction(error)};
  }
  PlotPosition position(const Mark& mark) const { return position(mark.ms.value(), error(mark)); }
  std::string line(const Mark& mark) const {
    return fmt::format("{:.9g} {:.9g}\n", x.clamped(mark.ms.value()), y.clamped(error(mark)));
  }
};

Panel make_panel(const Plot& plot, std::size_t index, const PlotAxis& x) {
  Panel panel{index, x, {}, {}};
  std::vector<double> errors;
  for (const Mark& mark : plot.marks) {
    if (!std::isfinite(mark.ms.value()) || !std::isfinite(panel.error(mark))) continue;
    panel.marks.push_back(&mark);
    errors.push_back(panel.error(mark));
  }
  panel.y = make_axis(errors);
  return panel;
}

std::vector<const Mark*> front_of(const Panel& panel) {
  std::vector<std::pair<double, double>> values;
  for (const Mark* mark : panel.marks)
    values.emplace_back(mark->ms.value(), mark->error[panel.index].value());
  std::vector<const Mark*> out;
  for (const std::size_t i : pareto_front(values)) out.push_back(panel.marks[i]);
  return out;
}

// Positions close together along the front's steps, for labels to keep off.
std::vector<PlotPosition> along_front(const Panel& panel, const std::vector<const Mark*>& front) {
  constexpr double kStep = 5;
  std::vector<PlotPosition> out;
  for (std::size_t i = 0; i + 1 < front.size(); ++i) {
    const PlotPosition a = panel.position(*front[i]), b = panel.position(*front[i + 1]);
    for (double x = a.x; x < b.x; x += kStep) out.push_back({x, a.y});
    for (double y = b.y; y < a.y; y += kStep) out.push_back({b.x, y});
  }
  return out;
}

// The text stands in its box on the side of the point, since its width is an upper bound.
std::string label_command(const PlotBox& box, const PlotPosition& at, const std::string& text) {
  const PlotPosition end = nearest_on(box, at);
  std::string out;
  if (std::hypot(end.x - at.x, end.y - at.y) > 18)
    out = fmt::format(
        "set arrow from graph {:.5f},{:.5f} to graph {:.5f},{:.5f} nohead lw .7 "
        "lc rgb '#777777' dt 3 back\n",
        at.x / kAreaWidth, at.y / kAreaHeight, end.x / kAreaWidth, end.y / kAreaHeight);
  const bool right = box.x0 > at.x, left = box.x1 < at.x;
  const double x = right ? box.x0 : left ? box.x1 : (box.x0 + box.x1) / 2;
  return out + fmt::format("set label {} at graph {:.5f},{:.5f} {} font ',12' noenhanced front\n",
                           gnuplot_quoted(text), x / kAreaWidth,
                           (box.y0 + box.y1) / 2 / kAreaHeight,
                           right  ? "left"
                           : left ? "right"
                                  : "center");
}

// Baselines by name, and what the program chooses by its configuration.
std::string label_commands(const Panel& panel, const std::vector<const Mark*>& front) {
  std::vector<PlotMarker> markers;
  for (const Mark* mark : panel.marks)
    markers.push_back({panel.position(*mark), mark->chosen ? 20. : mark->baseline ? 17. : 9.});
  std::vector<WantedLabel> wanted;
  std::vector<std::string> texts;
  for (const bool baseline : {true, false})
    for (const Mark* mark : panel.marks) {
      if (mark->baseline != baseline || !(baseline || mark->chosen)) continue;
      texts.push_back(baseline ? mark->method : mark->configuration);
      wanted.push_back(
          {panel.position(*mark), kCharacter * static_cast<double>(texts.back().size()), kLine});
    }
  const auto boxes = place_labels({4, 4, kAreaWidth - 4, kAreaHeight - 4}, wanted, markers,
                                  along_front(panel, front));
  std::string out;
  for (std::size_t i = 0; i < wanted.size(); ++i)
    if (boxes[i]) out += label_command(*boxes[i], wanted[i].at, texts[i]);
  return out;
}

// Data blocks and the plot elements that show them.
class Elements {
 public:
  void add(const std::string& name, const std::string& data, const std::string& style) {
    if (data.empty()) return;
    blocks_ += fmt::format("${} << END\n{}END\n", name, data);
    elements_ += fmt::format(", ${} with {} notitle", name, style);
  }
  void add_key(const std::string& style, const std::string& title) {
    elements_ += fmt::format(", keyentry with {} title {}", style, gnuplot_quoted(title));
  }
  // NaN is a plot of nothing, without which an empty panel would not be drawn.
  std::string commands() const { return blocks_ + "plot NaN notitle" + elements_ + "\n"; }

 private:
  std::string blocks_, elements_;
};

void add_data(Elements& elements, const Plot& plot, const Panel& panel,
              const std::vector<const Mark*>& front) {
  std::string line, ours, chosen;
  std::map<std::string, std::string> baselines;
  for (const Mark* mark : front) line += panel.line(*mark);
  for (const Mark* mark : panel.marks) {
    (mark->baseline ? baselines[mark->method] : ours) += panel.line(*mark);
    if (mark->chosen) chosen += panel.line(*mark);
  }
  elements.add("front", line, kFrontStyle);
  elements.add("ours", ours, kOursStyle);
  for (std::size_t i = 0; i < plot.baselines.size(); ++i)
    elements.add(fmt::format("baseline{}", i), baselines[plot.baselines[i]], baseline_style(i));
  elements.add("chosen", chosen, kChosenStyle);
}

// A plot of its own over the full height, since gnuplot breaks a legend taller than its plot.
std::string legend_script(const Plot& plot) {
  Elements elements;
  elements.add_key(kOursStyle, "Penumbra");
  elements.add_key(kChosenStyle, "Penumbra, chosen by itself");
  elements.add_key("lines lw 1.6 lc rgb '#999999'", "Pareto front");
  for (std::size_t i = 0; i < plot.baselines.size(); ++i)
    elements.add_key(baseline_style(i), plot.baselines[i]);
  const double width = plot_width(plot), top = 1 - kTop / kHeight;
  return fmt::format(
      "unset label\nunset arrow\nunset border\nunset tics\nunset xlabel\nunset ylabel\n"
      "set tmargin at screen {0:.5f}\nset bmargin at screen 0\n"
      "set key at screen {1:.5f},{0:.5f} left top Left reverse samplen 1.5 spacing 1.35 maxcols 1 "
      "noenhanced\n"
      "set label {2} at screen {3:.5f},{4:.5f} left font ',16' noenhanced\n{5}",
      top, (kLeft + kAreaWidth + 8) / width, gnuplot_quoted(plot.title), kLeft / width,
      1 - kTop / 2 / kHeight, elements.commands());
}

std::string panel_script(const Plot& plot, const Panel& panel) {
  const bool bottom = panel.index + 1 == kPanels.size();
  const double top = 1 - (kTop + static_cast<double>(panel.index) * (kAreaHeight + kGap)) / kHeight;
  const auto front = front_of(panel);
  std::string out = fmt::format(
      "unset label\nunset arrow\nset tmargin at screen {:.5f}\nset bmargin at screen {:.5f}\n"
      "set xrange [{:.9g}:{:.9g}]\nset yrange [{:.9g}:{:.9g}]\nset xtics {}\nset ytics {}\n"
      "set ylabel '{}' noenhanced\n",
      top, top - kAreaHeight / kHeight, panel.x.low, panel.x.high, panel.y.low, panel.y.high,
      axis_ticks(panel.x, bottom), axis_ticks(panel.y, true), kPanels[panel.index].label);
  if (bottom)
    out += fmt::format("set xlabel 'Light update, median time (ms){}' noenhanced\n",
                       panel.x.zero > 0 ? "; methods without any cost stand at 0" : "");
  if (panel.x.zero > 0)
    out += fmt::format(
        "set arrow from first {0:.9g},graph 0 to first {0:.9g},graph 1 nohead dt 3 "
        "lc rgb '#aaaaaa' back\n",
        panel.x.end_of_zero());
  out += label_commands(panel, front);
  if (panel.marks.empty()) out += "set label 'not measured' at graph .5,.5 center\n";
  Elements elements;
  add_data(elements, plot, panel, front);
  return out + elements.commands();
}

std::string plot_script(const Plot& plot) {
  const double width = plot_width(plot);
  std::vector<double> times;
  for (const Mark& mark : plot.marks) times.push_back(mark.ms.value());
  std::string out = fmt::format(
      "set encoding utf8\n"
      "set terminal svg size {:.0f},{:.0f} font 'sans-serif,13' background '#ffffff' noenhanced\n"
      "set multiplot\nset logscale xy\nset border lw .8\n"
      "set grid xtics ytics lw .6 lc rgb '#dddddd'\n"
      "set tics scale .8,.4\nunset key\n"
      "set lmargin at screen {:.5f}\nset rmargin at screen {:.5f}\n",
      width, kHeight, kLeft / width, (kLeft + kAreaWidth) / width);
  for (std::size_t i = 0; i < kPanels.size(); ++i)
    out += panel_script(plot, make_panel(plot, i, make_axis(times)));
  return out + legend_script(plot) + "unset multiplot\n";
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

std::string chart_csv(std::span<const ChartPoint> points) {
  const nlohmann::ordered_json columns = row_of({});
  std::string header, out;
  for (const auto& [column, cell] : columns.items()) header += ',' + column;
  out = header.substr(1) + '\n';
  for (const nlohmann::ordered_json& row : chart_json(points)) {
    std::string line;
    for (const auto& [column, cell] : row.items()) line += ',' + csv_cell(cell);
    out += line.substr(1) + '\n';
  }
  return out;
}

nlohmann::ordered_json chart_json(std::span<const ChartPoint> points) {
  auto rows = nlohmann::ordered_json::array();
  for (const ChartPoint& p : points) rows.push_back(row_of(p));
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
      run_gnuplot(plot_script({title, gather(points), baselines}), folder / "error-time.svg"));
  for (const auto& [name, own] : environments) {
    const Plot plot{fmt::format("Error against time: {}, {}", name, objects), gather(own),
                    baselines};
    PENUMBRA_TRY(
        run_gnuplot(plot_script(plot),
                    folder / fmt::format("error-time-{}.svg", unused(file_name_of(name), used))));
  }
  return {};
}

}  // namespace penumbra::tools
