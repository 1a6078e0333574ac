#include "tools/runs/summary.h"

#include <fmt/format.h>

#include "core/counted.h"
#include "runtime/pipeline/report.h"

namespace penumbra::tools {

nlohmann::json summarise(const runtime::RunCounts& counts, const StageTimes& times,
                         const Configuration& c) {
  const auto frames = static_cast<double>(counts.frames);
  return {{"frames", counts.frames},
          {"dropped", runtime::to_json(counts.overtaken)},
          {"without_light", counts.without_light},
          {"unusable_environment_frames", counts.unusable},
          {"seconds", counts.seconds},
          {"fps", counts.seconds > 0 ? frames / counts.seconds : 0},
          {"stages", runtime::to_json(times)},
          {"processor", counts.processor && frames > 0 ? runtime::to_json(*counts.processor, frames)
                                                       : nlohmann::json()},
          {"configuration",
           {{"bands", c.bands},
            {"lights", counts.lights},
            {"plan", counts.plan ? runtime::to_json(*counts.plan) : nlohmann::json()},
            {"coverage", counts.coverage.value_or(0)},
            {"exposures", counts.exposures},
            {"width", c.width},
            {"height", c.height},
            {"objects", c.objects},
            {"renderer", c.renderer}}},
          {"touched_fraction", frames > 0 ? counts.touched / frames : 0}};
}

namespace {

std::string from_what(int exposures) {
  return exposures > 0 ? counted(exposures, "exposure") : "light of a track";
}

void print_plan(const nlohmann::json& p) {
  const auto error = [&](const char* key) {
    return p[key].is_null() ? std::string("unknown") : fmt::format("{:.3f}", p[key].get<double>());
  };
  fmt::print(
      "governor: {} bands, {} lights ({} with fine shadows), map {}, predicted error of shadows "
      "{}, of objects {}, {:.1f} ms (map {:.1f}, relighting {:.1f}, lights {:.1f}): {}\n",
      p["bands"].get<int>(), p["lights"].get<int>(), p["fine_lights"].get<int>(),
      p["map_step"].get<int>() > 1 ? "in blocks" : "whole", error("predicted_error"),
      error("predicted_object_error"), p["predicted_ms"].get<double>(),
      p["reading_ms"].get<double>(), p["relighting_ms"].get<double>(), p["lights_ms"].get<double>(),
      p["why"].get<std::string>());
}

}  // namespace

void print_summary(const nlohmann::json& s) {
  const auto& c = s["configuration"];
  fmt::print(
      "{} frames of {}x{} in {:.2f} s: {:.1f} fps, {} view and {} environment frames dropped, "
      "{:.1f} % of the pixels touched\n",
      s["frames"].get<int>(), c["width"].get<int>(), c["height"].get<int>(),
      s["seconds"].get<double>(), s["fps"].get<double>(), s["dropped"]["view"].get<int>(),
      s["dropped"]["environment"].get<int>(), 100 * s["touched_fraction"].get<double>());
  fmt::print("{}, {}, at most {}, {}, {:.0f} % of the sphere seen, {}\n",
             counted(c["objects"].get<int>(), "object"), counted(c["bands"].get<int>(), "band"),
             counted(c["lights"].get<int>(), "light"), from_what(c["exposures"].get<int>()),
             100 * c["coverage"].get<double>(), c["renderer"].get<std::string>());
  if (const auto& p = c["plan"]; !p.is_null()) print_plan(p);
  if (const auto& p = s["processor"]; !p.is_null())
    fmt::print(
        "processor time a frame: {:.1f} ms for the pipeline, {:.1f} for drawing without a GPU, "
        "{:.1f} for cameras, {:.1f} for encoding and writing, {:.1f} for the rest\n",
        p["pipeline_ms"].get<double>(), p["drawing_ms"].get<double>(),
        p["cameras_ms"].get<double>(), p["encoding_ms"].get<double>(), p["other_ms"].get<double>());
  fmt::print("{:<16} {:>8} {:>10} {:>10}\n", "stage", "count", "p50 ms", "p99 ms");
  for (const auto& [name, stage] : s["stages"].items())
    fmt::print("{:<16} {:>8} {:>10.3f} {:>10.3f}\n", name, stage["count"].get<int>(),
               stage["p50_ms"].get<double>(), stage["p99_ms"].get<double>());
}

}  // namespace penumbra::tools
