// Error against time of ways to trace a distant light at an object's vertices.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <glm/geometric.hpp>
#include <nlohmann/json.hpp>
#include <optional>

#include "core/conventions.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "core/threads/parallel.h"
#include "prt/transfer/visibility_map.h"
#include "runtime/governor/single_thread_time.h"
#include "runtime/scene/scene.h"
#include "shadows/silhouette/light_rays.h"
#include "shadows/visibility/direct_light.h"
#include "tools/chart/benches/chart_bench.h"
#include "tools/chart/charts/chart_options.h"
#include "tools/chart/charts/chart_plot.h"
#include "tools/chart/charts/light_chart.h"
#include "tools/chart/charts/panel_plot.h"
#include "tools/chart/peers/visibility_cache.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/farm/core_limit.h"
#include "tools/plots/gnuplot.h"
#include "tools/runs/output.h"

namespace penumbra::tools {

namespace {

constexpr std::array kRadii_deg = {.27, 1.7, 4., 15.};
constexpr int kTimings = 7;

struct DirectLightPoint {
  std::string mesh;
  double radius_deg = 0;
  std::string method, setting;
  double error = 0;                // relative RMSE of the irradiance over the surface
  double ms = 0;                   // of one light on one thread
  std::optional<double> traced{};  // of a cache: fraction of the vertices
};

lighting::DistantLight lamp(double radius_deg) {
  constexpr double kElevation = .7, kAzimuth = .3;  // radians
  lighting::DistantLight out;
  out.direction = {std::cos(kElevation) * std::cos(kAzimuth), std::sin(kElevation),
                   std::cos(kElevation) * std::sin(kAzimuth)};
  out.radius = Radians{radius_deg * kPi / 180};
  out.radiance = {1, 1, 1};
  return out;
}

// An object alone, with all that ways to trace it need.
class TracedObject {
 public:
  static Result<std::unique_ptr<TracedObject>> make(const std::string& asset) {
    PENUMBRA_ASSIGN(scene, ChartScene::make(asset, kBakeRays));
    const prt::BakedObject& baked = scene.prepared().objects.front().baked;
    shadows::SilhouetteMesh silhouette(baked.mesh);
    const auto near_m = static_cast<float>(shadows::SilhouetteMesh::kNear * silhouette.radius_m());
    PENUMBRA_ASSIGN(cache, VisibilityCache::create(baked.mesh, near_m));
    return std::unique_ptr<TracedObject>(
        new TracedObject(std::move(scene), std::move(cache), std::move(silhouette), near_m));
  }

  std::size_t vertices() const { return mesh().positions.size(); }

  /// Mean cosines over the light, by a thousand rays a vertex.
  std::vector<float> truth(const lighting::DistantLight& source) const {
    constexpr std::size_t kTurnsUsed = 16;
    constexpr auto kRays = static_cast<float>(kTurnsUsed * shadows::kMaxSamples);
    shadows::SamplePattern pattern;
    pattern.make(source, shadows::kMaxSamples, shadows::kTurns);
    const shadows::RayOccluders rays = occluders();
    std::vector<float> out(vertices());
    parallel_for(std::size_t{0}, out.size(), 256, [&](const auto& part) {
      shadows::Packets packets(rays, [&](std::size_t i, float cosine, bool hidden, bool) {
        if (!hidden) out[i] += cosine / kRays;
      });
      for (std::size_t i = part.begin(); i < part.end(); ++i)
        for (std::size_t turn = 0; turn < kTurnsUsed; ++turn)
          for (const glm::vec3& d : pattern.at(turn * shadows::kTurns / kTurnsUsed))
            if (const float cosine = glm::dot(mesh().normals[i], d); cosine > 0)
              packets.add(i, cosine, mesh().positions[i] + near_m_ * mesh().normals[i], d);
    });
    return out;
  }

  using Tracing = std::function<void(const lighting::DistantLight&, std::span<float>)>;
  struct NamedTracing {
    std::string method, setting;
    Tracing way;
  };
  std::vector<NamedTracing> ways() {
    std::vector<NamedTracing> out;
    for (const int n : {1, 2, 4, 8, 16})
      out.push_back({"rays at every vertex", fmt::format("{} rays", n),
                     [this, n](const auto& source, auto light) { trace_all(source, n, light); }});
    for (const int n : {2, 4, 8, 16})
      out.push_back(
          {"rays where needed", fmt::format("{} rays", n),
           [this, n](const auto& source, auto light) { trace(source, nullptr, n, light); }});
    for (const int n : {2, 4, 8})
      if (visibility_)
        out.push_back({"visibility map", fmt::format("{} rays", n),
                       [this, n](const auto& source, auto light) {
                         trace(source, &*visibility_, n, light);
                       }});
    for (const int n : {4, 16})
      for (const float error : {.05f, .1f, .2f, .4f})
        out.push_back({fmt::format("cached visibility, {} rays", n), fmt::format("error {}", error),
                       [this, n, error](const auto& source, auto light) {
                         cached_ = cache_.light(source, n, error, light);
                       }});
    return out;
  }

  /// RMS over the surface, relative to the truth's own. errors: kInvalid (the truth is dark)
  Result<double> error(std::span<const float> light, std::span<const float> truth) const {
    double off = 0, all = 0;
    for (std::size_t i = 0; i < area_.size(); ++i) {
      off += area_[i] * std::pow(double{light[i]} - truth[i], 2);
      all += area_[i] * std::pow(double{truth[i]}, 2);
    }
    if (!(all > 0))
      return fail(ErrorCode::kInvalid, scene_.name(), "gets no light of the chart's lamp");
    return std::sqrt(off / all);
  }
  /// Vertices that the last cache traced.
  std::size_t cached() const { return cached_; }

 private:
  TracedObject(ChartScene scene, VisibilityCache cache, shadows::SilhouetteMesh silhouette,
               float near_m)
      : scene_(std::move(scene)),
        cache_(std::move(cache)),
        silhouette_(std::move(silhouette)),
        near_m_(near_m),
        points_(mesh()),
        area_(vertices()) {
    points_.triangles.clear();
    const prt::VisibilityMap& map = scene_.prepared().objects.front().baked.visibility;
    if (!map.empty()) visibility_.emplace(map, mesh());
    const auto& p = mesh().positions;
    for (const auto& [a, b, c] : mesh().triangles) {
      const double area = glm::length(glm::cross(p[b] - p[a], p[c] - p[a]));
      for (const auto v : {a, b, c}) area_[v] += area;
    }
  }

  const prt::Mesh& mesh() const { return scene_.prepared().objects.front().baked.mesh; }
  shadows::RayOccluders occluders() const { return {&cache_.world(), nullptr, near_m_}; }
  void trace(const lighting::DistantLight& source, const prt::VisibilityLookup* visibility,
             int rays, std::span<float> out) const {
    const shadows::Caster caster{&mesh(), &silhouette_, {}, visibility};
    shadows::trace_direct_light(occluders(), {{&caster, 1}, {}, near_m_}, caster, nullptr, source,
                                rays, out);
  }

  void trace_all(const lighting::DistantLight& source, int rays, std::span<float> out) const {
    shadows::DirectLightAtVertices light;
    shadows::trace_direct_light_at_vertices(occluders(), points_, source, rays, light);
    std::ranges::transform(light.open, light.virtual_occlusion, out.begin(), std::minus());
  }

  ChartScene scene_;
  VisibilityCache cache_;
  shadows::SilhouetteMesh silhouette_;
  float near_m_;
  std::size_t cached_ = 0;
  std::optional<prt::VisibilityLookup> visibility_;
  prt::Mesh points_;  // no triangles: each vertex for itself
  std::vector<double> area_;
};

Result<void> measure_light(TracedObject& object, const std::string& asset, double radius_deg,
                           std::vector<DirectLightPoint>& out) {
  const lighting::DistantLight source = lamp(radius_deg);
  const std::vector<float> truth = object.truth(source);
  std::vector<float> light(object.vertices());
  for (const auto& [method, setting, way] : object.ways()) {
    const auto time = runtime::time_single_threaded(kTimings, [&](int) { way(source, light); });
    PENUMBRA_ASSIGN(error, object.error(light, truth));
    DirectLightPoint p{asset, radius_deg, method, setting, error, time.p50_ms};
    if (method.starts_with("cached"))
      p.traced = static_cast<double>(object.cached()) / static_cast<double>(object.vertices());
    out.push_back(std::move(p));
  }
  return {};
}

Result<std::vector<DirectLightPoint>> measure_ways(const std::vector<std::string>& assets) {
  std::vector<DirectLightPoint> out;
  for (const std::string& asset : assets) {
    PENUMBRA_ASSIGN(object, TracedObject::make(asset));
    const auto progress = progress_bar(asset);
    for (std::size_t k = 0; k < kRadii_deg.size(); ++k) {
      PENUMBRA_TRY(measure_light(*object, asset, kRadii_deg[k], out));
      if (progress) progress(double(k + 1) / kRadii_deg.size());
    }
  }
  return out;
}

nlohmann::ordered_json to_json(const DirectLightPoint& p) {
  return {{"mesh", p.mesh},
          {"light_radius_deg", p.radius_deg},
          {"method", p.method},
          {"setting", p.setting},
          {"irradiance_rel_rmse", p.error},
          {"ms", p.ms},
          {"traced_fraction", p.traced ? nlohmann::ordered_json(*p.traced) : nullptr}};
}

std::string plot_of(const std::vector<DirectLightPoint>& points) {
  std::vector<PanelPoint> out;
  for (const DirectLightPoint& p : points)
    out.push_back(
        {fmt::format("{}, light of {} degrees", p.mesh, p.radius_deg), p.method, p.ms, p.error});
  return panel_plot(out, kRadii_deg.size(), "Time of one light on one thread (ms)",
                    "Error of the irradiance (%)");
}

}  // namespace

Result<void> chart_direct_light(const ChartOptions& o) {
  std::vector<std::string> assets = o.assets;
  if (assets.empty()) assets = {"builtin:knot", "builtin:walker"};
  for (auto asset = assets.begin(); asset != assets.end(); ++asset) {
    if (std::find(assets.begin(), asset, *asset) != asset)
      return fail(ErrorCode::kInvalid, "--asset", fmt::format("names {} twice", *asset));
    PENUMBRA_TRY(runtime::load_asset(*asset, {.7f, .7f, .7f}, 0));  // all before the long work
  }
  const CoreLimit cores;
  PENUMBRA_ASSIGN(output, OutputFolder::create(o.output));
  PENUMBRA_ASSIGN(points, measure_ways(assets));
  PENUMBRA_TRY(output.begin());
  auto rows = nlohmann::ordered_json::array();
  for (const DirectLightPoint& p : points) rows.push_back(to_json(p));
  PENUMBRA_TRY(write_bytes(output.file("direct-light.csv"), csv_table(rows[0], rows)));
  if (const auto plot = run_gnuplot(plot_of(points), output.file("direct-light.svg")); !plot)
    log_warning("the plot is not written: {}: {}", plot.error().where, plot.error().detail);
  PENUMBRA_TRY(output.keep());
  if (o.json) {
    print_json({{"rows", rows}});
    return {};
  }
  for (const DirectLightPoint& p : points)
    fmt::print("{:<24} {:>5.2f} deg  {:<27} {:<10} {:>6.2f} % {:>8.2f} ms\n", p.mesh, p.radius_deg,
               p.method, p.setting, 100 * p.error, p.ms);
  fmt::print("{0}/direct-light.csv, {0}/direct-light.svg\n", o.output);
  return {};
}

}  // namespace penumbra::tools
