#include "tools/chart/charts/chart_shards.h"

#include <fmt/format.h>

#include <cstdint>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>

#include "core/io/files.h"
#include "core/io/hash.h"
#include "runtime/scene/scene.h"
#include "tools/chart/charts/light_chart.h"
#include "tools/farm/shard_file.h"

namespace penumbra::tools {

namespace {

using Json = nlohmann::ordered_json;

// Changes with what a chart measures.
constexpr std::uint64_t kChartVersion = 1;

void add_text(Fnv1a& hash, const std::string& text) {
  hash.add(text.size()).add(text.data(), text.size());
}

// Of everything that rows depend on but the machine.
Result<std::string> key_of(const ChartOptions& o, std::span<const std::string> assets,
                           std::span<const ChartEnvironment> environments) {
  Fnv1a hash;
  hash.add(kChartVersion).add(o.bands).add(o.lights).add(o.error.value_or(0)).add(o.truncated);
  for (const std::string& asset : assets) {
    add_text(hash, std::filesystem::path(asset).filename().string());
    if (asset.starts_with("builtin:")) continue;
    // As it is read: a mesh may have files beside it.
    PENUMBRA_ASSIGN(loaded, runtime::load_asset(asset, {.7f, .7f, .7f}, 0));
    const prt::Mesh& m = loaded.mesh;
    hash.add(m.positions).add(m.normals).add(m.albedo).add(m.triangles);
  }
  for (const ChartEnvironment& e : environments) {
    add_text(hash, e.name);
    hash.add(e.map.width()).add(e.map.height());
    for (int y = 0; y < e.map.height(); ++y) {
      const auto row = e.map.row(y);
      hash.add(row.data(), row.size_bytes());
    }
  }
  return fmt::format("{:016x}", hash.value());
}

// What is not finite is null in JSON.
double number_in(const Json& row, const char* name) {
  const Json& value = row.at(name);
  return value.is_null() ? std::numeric_limits<double>::quiet_NaN() : value.get<double>();
}

// The reverse of chart_json; throws where a name is missing.
ChartPoint point_of(const Json& row) {
  ChartPoint p;
  p.environment = row.at("environment").get<std::string>();
  p.mesh = row.at("mesh").get<std::string>();
  p.method = row.at("method").get<std::string>();
  p.baseline = row.at("baseline").get<bool>();
  p.coefficients = row.at("coefficients").get<int>();
  p.lights = row.at("lights").get<int>();
  p.fine_lights = row.at("fine_lights").get<int>();
  p.sampling = row.at("samples").get<int>();
  p.object_samples = row.at("object_samples").get<int>();
  p.map_size = row.at("map_size_px").get<int>();
  p.bake_rays = row.at("bake_rays").get<int>();
  p.environment_rows = row.at("environment_rows").get<int>();
  p.update_rate = number_in(row, "updates_per_frame");
  p.object_rel_rmse = number_in(row, "object_rel_rmse");
  p.object_bias = number_in(row, "object_rel_bias");
  p.shadow_rmse = number_in(row, "shadow_rmse");
  p.shadow_bias = number_in(row, "shadow_bias");
  p.penumbra_error = number_in(row, "penumbra_rel_error");
  p.flip = number_in(row, "hdr_flip_mean");
  p.flicker = number_in(row, "flicker_rel");
  p.ms_p50 = number_in(row, "light_update_p50_ms");
  p.ms_p99 = number_in(row, "light_update_p99_ms");
  p.bytes = row.at("memory_bytes").get<std::size_t>();
  p.chosen = row.at("chosen").get<bool>();
  p.max_lights = row.at("lights_allowed").get<int>();
  p.reference_error = number_in(row, "reference_rel_error");
  p.saved = number_in(row, "full_over_chosen_ms");
  p.regret = number_in(row, "chosen_over_cheapest_ms");
  return p;
}

using Cases = std::vector<std::vector<ChartPoint>>;

std::unexpected<Error> not_whole(const std::filesystem::path& path) {
  return fail(ErrorCode::kUnreadable, path.string(), "is not a whole shard of a chart");
}

// The cases that are in it, which may be fewer than all.
Result<Cases> read_cases(const std::filesystem::path& path, const std::string& key,
                         ShardChoice shard) {
  PENUMBRA_ASSIGN(text, read_text(path));
  try {
    const Json file = Json::parse(text);
    if (file.at("chart").get<std::string>() != key || file.at("shard").get<int>() != shard.index ||
        file.at("shards").get<int>() != shard.count)
      return fail(ErrorCode::kInvalid, path.string(),
                  "is the shard of another chart, with another asset, environment or setting: "
                  "remove it, or choose another folder");
    Cases out;
    for (const Json& rows : file.at("cases")) {
      out.emplace_back();
      for (const Json& row : rows) out.back().push_back(point_of(row));
    }
    return out;
  } catch (const Json::exception&) {
    return not_whole(path);
  }
}

Result<Cases> read_shard_file(const std::filesystem::path& path, const std::string& key,
                              ShardChoice shard, std::size_t cases) {
  std::error_code ignored;
  if (!std::filesystem::exists(path, ignored))
    return fail(ErrorCode::kNotFound, path.string(), "is missing: chart this shard first");
  PENUMBRA_ASSIGN(out, read_cases(path, key, shard));
  if (out.size() != cases) return not_whole(path);
  return out;
}

// Of so many cases in all.
std::size_t cases_of(ShardChoice shard, std::size_t all) {
  const auto first = static_cast<std::size_t>(shard.index);
  const auto step = static_cast<std::size_t>(shard.count);
  return first < all ? (all - first - 1) / step + 1 : 0;
}

}  // namespace

std::string chart_shards_stem(const ChartOptions& o) {
  return (std::filesystem::path(o.output) / "chart").string();
}

Result<std::string> chart_shard(const ChartOptions& o, std::span<const std::string> assets,
                                std::span<const ChartEnvironment> environments, ShardChoice shard) {
  PENUMBRA_ASSIGN(key, key_of(o, assets, environments));
  const std::size_t all = assets.size() * environments.size();
  ChartOptions silent = o;
  silent.json = true;
  const auto measure_into = [&](const std::filesystem::path& path) -> Result<void> {
    Json file = {
        {"chart", key}, {"shard", shard.index}, {"shards", shard.count}, {"cases", Json::array()}};
    // An attempt that was ended left whole cases.
    std::error_code ignored;
    if (std::filesystem::exists(path, ignored))
      if (const auto done = read_cases(path, key, shard))
        for (const std::vector<ChartPoint>& points : *done)
          file["cases"].push_back(chart_json(points));
    while (file["cases"].size() < cases_of(shard, all)) {
      const std::size_t i = static_cast<std::size_t>(shard.index) +
                            file["cases"].size() * static_cast<std::size_t>(shard.count);
      PENUMBRA_ASSIGN(points, chart_lights(silent, assets.subspan(i / environments.size(), 1),
                                           environments.subspan(i % environments.size(), 1)));
      file["cases"].push_back(chart_json(points));
      PENUMBRA_TRY(write_bytes(path, file.dump()));
    }
    return write_bytes(path, file.dump());
  };
  const auto is_whole = [&](const std::filesystem::path& path) -> Result<bool> {
    PENUMBRA_ASSIGN(done, read_cases(path, key, shard));
    return done.size() == cases_of(shard, all);
  };
  const auto file = shard_file(chart_shards_stem(o), shard.index, shard.count);
  PENUMBRA_TRY(make_shard(file, is_whole, measure_into));
  return file.string();
}

Result<std::vector<ChartPoint>> read_chart_shards(const ChartOptions& o,
                                                  std::span<const std::string> assets,
                                                  std::span<const ChartEnvironment> environments,
                                                  int count) {
  PENUMBRA_ASSIGN(key, key_of(o, assets, environments));
  const std::size_t all = assets.size() * environments.size();
  std::vector<Cases> shards;
  for (int i = 0; i < count; ++i) {
    const ShardChoice shard{i, count};
    PENUMBRA_ASSIGN(cases, read_shard_file(shard_file(chart_shards_stem(o), i, count), key, shard,
                                           cases_of(shard, all)));
    shards.push_back(std::move(cases));
  }
  std::vector<ChartPoint> out;
  const auto step = static_cast<std::size_t>(count);
  for (std::size_t i = 0; i < all; ++i) {
    const std::vector<ChartPoint>& points = shards[i % step][i / step];
    out.insert(out.end(), points.begin(), points.end());
  }
  return out;
}

}  // namespace penumbra::tools
