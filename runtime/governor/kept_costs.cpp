#include "runtime/governor/internal/kept_costs.h"

#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>

#include "core/io/files.h"
#include "core/io/hash.h"
#include "core/io/log.h"
#include "runtime/scene/bake_cache.h"

namespace penumbra::runtime {

namespace {

constexpr std::pair<const char*, double lighting::CostModel::*> kTimes[] = {
    {"relight_ms", &lighting::CostModel::relight_ms},
    {"per_coefficient_ms", &lighting::CostModel::per_coefficient_ms},
    {"fine_light_ms", &lighting::CostModel::fine_light_ms},
    {"coarse_light_ms", &lighting::CostModel::coarse_light_ms},
    {"wide_light_ms", &lighting::CostModel::wide_light_ms},
    {"read_ms", &lighting::CostModel::read_ms},
    {"read_blocks_ms", &lighting::CostModel::read_blocks_ms}};

#ifdef NDEBUG
constexpr bool kOptimised = true;
#else
constexpr bool kOptimised = false;
#endif

std::string name_of(const PreparedScene& scene) {
  constexpr int kVersion = 2;  // of what is measured
  const std::string here = processor_name();
  Fnv1a h;
  h.add(kVersion).add(kOptimised).add(here.data(), here.size()).add(scene.planes.size());
  for (const PreparedObject& o : scene.objects)
    h.add(o.baked.mesh.positions.size())
        .add(o.baked.mesh.triangles.size())
        .add(o.baked.transfer.bands)
        .add(o.baked.transfer.channels)
        .add(o.baked.visibility.empty())
        .add(o.animation != nullptr)
        .add(o.baked.ground_deficit.points);
  h.add(scene.real_mesh.triangles.size());
  return fmt::format("costs-{:016x}.json", h.value());
}

std::optional<lighting::CostModel> read_costs(const std::filesystem::path& file) {
  constexpr std::size_t kLimit = 1 << 16;
  const auto text = read_text(file, kLimit);
  if (!text) return std::nullopt;
  const auto kept = nlohmann::json::parse(*text, nullptr, false);
  lighting::CostModel out;
  for (const auto& [name, member] : kTimes) {
    if (!kept.is_object() || !kept.contains(name) || !kept[name].is_number()) return std::nullopt;
    out.*member = kept[name].get<double>();
    if (!(out.*member >= 0 && std::isfinite(out.*member))) return std::nullopt;
  }
  return out;
}

Result<void> write_costs(const std::filesystem::path& file, const lighting::CostModel& costs) {
  nlohmann::ordered_json out;
  for (const auto& [name, member] : kTimes) out[name] = costs.*member;
  return write_bytes(file, out.dump(2) + "\n");
}

}  // namespace

// Read line by line: the kernel's files have no size.
std::string processor_name() {
  std::ifstream file("/proc/cpuinfo");
  std::string processor, line;
  while (std::getline(file, line) && !line.empty())  // the first one's lines
    if (line.starts_with("model name") || line.starts_with("CPU part") ||
        line.starts_with("CPU implementer"))
      processor += line;
  return processor;
}

Result<lighting::CostModel> recall_or_fit(const PreparedScene& scene,
                                          const std::function<Result<lighting::CostModel>()>& fit) {
  const auto folder = cache_folder();
  const std::filesystem::path file = folder ? *folder / name_of(scene) : std::filesystem::path();
  if (folder)
    if (const auto kept = read_costs(file)) return *kept;
  auto fitted = fit();
  if (!fitted || !folder || !make_folder(*folder)) return fitted;
  if (const auto written = write_costs(file, *fitted); !written)
    log_warning("the times that the governor goes by are not kept: {}: {}", written.error().where,
                written.error().detail);
  return fitted;
}

}  // namespace penumbra::runtime
