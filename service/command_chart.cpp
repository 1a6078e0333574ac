#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cmath>
#include <filesystem>

#include "capture/capture.h"
#include "codec/codec.h"
#include "core/conventions.h"
#include "core/files.h"
#include "service/accuracy.h"
#include "service/commands.h"
#include "service/light_file.h"
#include "service/output.h"
#include "service/progress.h"
#include "service/report.h"
#include "service/still.h"

namespace penumbra::service {

namespace {

struct Row : Accuracy {
  std::string environment;
  int bands = 0;
};

// One scene for all environments: the object stands on a 40 % grey floor before a camera that sees
// both.
struct Bench {
  Scene scene;
  PreparedScene prepared;
  prt::PinholeView view;
};

prt::PinholeView make_view() {
  constexpr int kWidth = 192, kHeight = 144;
  return {kWidth,
          kHeight,
          {210, 210},
          {kWidth / 2., kHeight / 2.},
          capture::look_at({.25, .95, 1.35}, {0, .17, 0})};
}

Result<Bench> make_bench(const ChartOptions& o) {
  Bench bench;
  SceneObject object;
  object.asset = o.asset.value_or("builtin:knot");
  object.name = "object";
  object.albedo = {.6f, .6f, .6f};
  object.stand = true;
  RealGeometry floor;
  floor.plane = RealPlane{};
  floor.albedo = Rgb{.4f, .4f, .4f};
  bench.scene = {{object}, {floor}};
  bench.view = make_view();
  BakeSettings settings;
  settings.bands = kMaxBands;  // fewer bands are the same coefficients, left out
  // Truncated light isolates what our own steps cost: the bake must not be the noise of that figure.
  settings.rays = o.truncated ? 8192 : 1024;
  settings.ground_rays = o.truncated ? 8192 : 2048;
  auto prepared = prepare(bench.scene, settings, progress_bar);
  if (!prepared) return std::unexpected(prepared.error());
  bench.prepared = std::move(*prepared);
  return bench;
}

struct Environment {
  std::string name;
  Image<Rgb> map;
  lighting::Projection light;
};

Result<std::vector<Environment>> read_environments(const ChartOptions& o) {
  std::vector<Environment> out;
  const auto add = [&](std::string name, Image<Rgb> map) -> Result<void> {
    auto light = lighting::project_latlong(map, kMaxBands);
    if (!light) return fail(light.error().code, name, light.error().detail);
    out.push_back({std::move(name), std::move(map), *light});
    return {};
  };
  for (const std::string& path : o.environments) {
    auto light = read_light(path, std::nullopt);
    if (!light) return std::unexpected(light.error());
    auto map = capture::to_latlong(light->file);
    if (!map) return std::unexpected(map.error());
    PENUMBRA_TRY(add(std::filesystem::path(path).stem().string(), std::move(*map)));
  }
  if (!out.empty()) return out;
  PENUMBRA_TRY(add("room", capture::make_room_environment(1024, 512)));
  PENUMBRA_TRY(add("clear-sky", capture::make_sky_environment(1024, 512, .8)));
  return out;
}

Result<void> chart_environment(const ChartOptions& o, const Bench& bench, const Masks& masks,
                               const Environment& environment, std::vector<Row>& rows) {
  const StillScene in{&bench.prepared, &environment.map, bench.view};
  auto empty = render_real(in, o.error, {});
  if (!empty) return std::unexpected(empty.error());
  std::optional<Still> truth;
  for (const int bands : o.bands) {
    lighting::LightEstimate light = lighting::make_estimate(environment.light, bands);
    if (o.discs > 0) {
      auto split = lighting::estimate_map(environment.map, {bands, {o.discs, .02}});
      if (!split) return std::unexpected(split.error());
      light = *split;
      for (const auto& d : light.discs)
        fmt::print("  disc {} dir {:.2f} {:.2f} {:.2f} radius {:.2f} deg E {:.2f} share {:.3f}\n", d.id, d.direction.x, d.direction.y, d.direction.z, d.radius.value()*180/kPi, luminance(d.irradiance()), luminance(d.irradiance())/kPi/luminance(light.mean_radiance));
    }
    Still truncated_empty = *empty;
    if (o.truncated || !truth) {
      auto reference =
          render_reference(in, true, o.error, o.truncated ? std::optional(light) : std::nullopt,
                           progress_bar(fmt::format("{} {}", environment.name, bands)));
      if (!reference) return std::unexpected(reference.error());
      truth = std::move(*reference);
    }
    if (o.truncated) light_floor(in, light, masks, truncated_empty);
    auto ours = render_composite(in, light, truncated_empty, DiscTaps{o.object_taps, {o.taps, o.map}});
    if (!ours) return std::unexpected(ours.error());
    Row row{compare_pictures(*ours, *truth, truncated_empty, masks), environment.name, bands};
    if (!o.json)
      fmt::print("{:<44} {:>3} {:>12.2f} {:>12.2f} {:>12.4f} {:>12.2f}\n", row.environment,
                 bands * bands, 100 * row.object_rel_rmse, 100 * row.object_bias, row.shadow_rmse,
                 100 * row.reference_error);
    rows.push_back(row);
  }
  return {};
}

}  // namespace

Result<void> chart(const ChartOptions& options) {
  ChartOptions o = options;
  if (o.bands.empty()) o.bands = {1, 2, 3, 4, 5, 6, 9};
  for (int b : o.bands)
    if (b < 1 || b > kMaxBands)
      return fail(ErrorCode::kInvalid, "--bands", fmt::format("{} is not within 1..9", b));
  if (!(o.error > 0 && o.error < 1)) return fail(ErrorCode::kInvalid, "--error", "not within 0..1");
  auto output = OutputFolder::create(o.output);
  if (!output) return std::unexpected(output.error());
  auto environments = read_environments(o);
  if (!environments) return std::unexpected(environments.error());
  auto bench = make_bench(o);
  if (!bench) return std::unexpected(bench.error());
  auto masks = make_masks(bench->prepared, bench->view);
  if (!masks) return std::unexpected(masks.error());
  if (!o.json)
    fmt::print("{:<44} {:>3} {:>12} {:>12} {:>12} {:>12}\n", "environment", "n", "object %",
               "bias %", "shadow s", "ref error %");
  std::vector<Row> rows;
  for (const Environment& e : *environments)
    PENUMBRA_TRY(chart_environment(o, *bench, *masks, e, rows));
  std::string csv =
      "environment,coefficients,object_rel_rmse,object_bias,shadow_rmse,reference_error\n";
  nlohmann::json json = nlohmann::json::array();
  for (const Row& r : rows) {
    csv += fmt::format("{},{},{:.6f},{:.6f},{:.6f},{:.6f}\n", r.environment, r.bands * r.bands,
                       r.object_rel_rmse, r.object_bias, r.shadow_rmse, r.reference_error);
    json.push_back({{"environment", r.environment},
                    {"coefficients", r.bands * r.bands},
                    {"object_rel_rmse", r.object_rel_rmse},
                    {"object_bias", r.object_bias},
                    {"shadow_rmse", r.shadow_rmse},
                    {"reference_error", r.reference_error}});
  }
  PENUMBRA_TRY(write_bytes(output->file("accuracy.csv"), csv));
  output->keep();
  if (o.json) print_json({{"rows", json}});
  return {};
}

}  // namespace penumbra::service
