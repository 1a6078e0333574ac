#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <optional>

#include "capture/frames.h"
#include "capture/recording/undamaged_frames.h"
#include "codec/codec.h"
#include "core/counted.h"
#include "core/environment.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "runtime/pipeline/light_estimation_stage.h"
#include "runtime/pipeline/report.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/penumbra/commands.h"

namespace penumbra::tools {

namespace {

struct HdrEnvironmentOptions {
  std::string capture, output;
  double at_s = 0;  // after the first frame: the surroundings as they were then; 0: at the end
  bool json = false;
};

struct AssembledView {
  Environment map;
  double coverage = 0;
};

// The newest map at that time; frames that show no light are passed over.
Result<AssembledView> replay(capture::FrameSource& source, runtime::LightEstimationStage& stage,
                             const std::string& name, double at_s) {
  std::optional<AssembledView> seen;
  std::string why = "has no frame of the surroundings";
  std::optional<TimestampNs> first;
  while (true) {
    PENUMBRA_ASSIGN(frame, source.next());
    if (!frame) break;
    if (!first) first = frame->time;
    if (at_s > 0 && (frame->time - *first).count() > at_s) break;
    if (!stage.takes(frame->camera)) continue;
    auto estimate = stage.process(*frame);
    if (estimate)
      seen = {stage.environment(), estimate->coverage};
    else if (estimate.error().code != ErrorCode::kUndetermined)
      return std::unexpected(estimate.error());
    else
      why = estimate.error().where + ": " + estimate.error().detail;
  }
  if (!seen) return fail(ErrorCode::kUndetermined, name, why);
  lighting::LightEstimate settled;
  PENUMBRA_TRY(stage.settle(runtime::LightEstimationStage::kNoMore, settled));
  if (settled.valid) seen->map = stage.environment();
  return std::move(*seen);
}

// 1 where a camera saw, 0 elsewhere; empty where all is seen.
Image<float> seen_pixels(const Environment& map) {
  const bool all = std::ranges::all_of(map.confidence.pixels(), [](float c) { return c > 0; });
  if (all) return {};
  Image<float> out = map.confidence;
  for (float& c : out.pixels()) c = c > 0 ? 1 : 0;
  return out;
}

}  // namespace

Result<void> hdr_environment(const HdrEnvironmentOptions& o) {
  PENUMBRA_TRY(check_writable(o.output));
  PENUMBRA_ASSIGN(source,
                  capture::UndamagedFrames::open(o.capture, capture::RecordedLight::kEither));
  StageTimes times;
  PENUMBRA_ASSIGN(stage,
                  runtime::LightEstimationStage::create(source->cameras(), {.bands = 3}, times));
  PENUMBRA_ASSIGN(seen, replay(*source, stage, o.capture, o.at_s));
  const Environment& map = seen.map;
  const bool tells_clipped = lower_extension(o.output) != ".hdr";
  if (!tells_clipped && !map.clipped.empty())
    log_warning("{}: its brightest light is a lower bound, which only .exr can say", o.output);
  PENUMBRA_TRY(codec::write_hdr(o.output, map.radiance, codec::Depth::kFloat, {}, seen_pixels(map),
                                tells_clipped ? clipped_pixels(map) : Image<float>()));
  if (!o.json) {
    fmt::print("{}: {}x{} from {} of {}, {:.1f} % of the sphere seen, {:.3f} % clipped\n", o.output,
               map.radiance.width(), map.radiance.height(), counted(stage.gains().size(), "view"),
               stage.exposures() > 0 ? counted(stage.exposures(), "exposure") : "a light track",
               100 * seen.coverage, 100 * map.clipped_fraction);
    return {};
  }
  nlohmann::json views = nlohmann::json::array();
  for (const auto& [camera, g, known] : stage.gains())
    views.push_back({{"camera", camera}, {"gain", {g.r, g.g, g.b}}, {"gain_known", known}});
  print_json({{"width", map.radiance.width()},
              {"height", map.radiance.height()},
              {"exposures_used", stage.exposures()},
              {"coverage", seen.coverage},
              {"clipped_fraction", map.clipped_fraction},
              {"views", views}});
  return {};
}

void add_hdr_environment(CLI::App& parent, Action& action) {
  static HdrEnvironmentOptions surroundings;
  auto* c = parent.add_subcommand(
      "environment",
      "Assemble what the cameras of a capture show of their surroundings into one lat-long HDR "
      "picture");
  c->add_option("capture", surroundings.capture, "Capture folder or recording")->required();
  c->add_option("--at", surroundings.at_s,
                "Time in seconds after the first frame, above 0; by default the end of the capture")
      ->check(above_zero);
  c->add_option("-o,--output", surroundings.output,
                "Picture to write, .exr or, where every direction was seen, .hdr; the "
                "alpha of .exr is 0 where no camera saw")
      ->required();
  add_json(c, surroundings.json);
  c->callback([&] { action = [] { return hdr_environment(surroundings); }; });
}

}  // namespace penumbra::tools
