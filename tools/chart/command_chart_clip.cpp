// Bytes against rendered error of ways to code transfer over a clip.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "capture/studio/environments.h"
#include "codec/codec.h"
#include "core/io/files.h"
#include "lighting/sh/projection.h"
#include "lighting/sh/rotation.h"
#include "prt/clip/light_map.h"
#include "prt/clip/sequence.h"
#include "prt/geometry/animation.h"
#include "prt/transfer/transfer.h"
#include "runtime/pipeline/light_file.h"
#include "runtime/pipeline/report.h"
#include "tools/chart/charts/chart_options.h"
#include "tools/chart/charts/chart_slurm.h"
#include "tools/chart/charts/clip_setup.h"
#include "tools/chart/charts/rate_chart.h"
#include "tools/chart/peers/peer_codecs.h"
#include "tools/chart/peers/rgbe_video.h"
#include "tools/common/print.h"
#include "tools/farm/core_limit.h"
#include "tools/farm/shard_choice.h"
#include "tools/farm/shard_file.h"
#include "tools/runs/output.h"

namespace penumbra::tools {

namespace {

// The clip's transfer as baked, as maps, and the lights that tell what an error looks like.
class ClipBench {
 public:
  static Result<ClipBench> make(const ChartOptions& o, const ChartedClip& charted,
                                std::span<const std::filesystem::path> journals);

  Result<void> run(const std::filesystem::path& scratch, std::vector<RatePoint>& out) const;
  std::size_t raw_bytes() const { return 4 * maps_.size() * maps_[0].area(); }
  std::size_t texels() const { return layout_.texels.size(); }
  int coefficients() const { return coefficient_count(frames_[0].bands); }

 private:
  double error_of(std::span<const Image<float>> maps) const;
  double error_of(const prt::TransferSequence& sequence) const;
  template <class Value>
  double rendered_error(const Value& value) const;
  void make_maps();

  prt::SurfaceLayout layout_;
  std::vector<prt::Transfer> frames_;
  std::vector<Image<float>> maps_;  // coefficient by coefficient, frame by frame
  std::vector<std::vector<std::vector<RadianceSh>>> lights_;  // by light, frame, bone
};

Result<std::vector<RadianceSh>> read_lights(const ChartOptions& o) {
  std::vector<RadianceSh> out;
  for (const std::string& path : o.environments) {
    PENUMBRA_ASSIGN(light, runtime::read_light(path));
    out.push_back(light.light.light);
  }
  if (!out.empty() && !o.with_procedural) return out;
  for (const Image<Rgb>& map :
       {capture::make_room_environment(1024, 512), capture::make_sky_environment(1024, 512, .8)}) {
    PENUMBRA_ASSIGN(light, lighting::project_latlong(map, kMaxBands));
    out.push_back(light.light);
  }
  return out;
}

Result<ClipBench> ClipBench::make(const ChartOptions& o, const ChartedClip& charted,
                                  std::span<const std::filesystem::path> journals) {
  PENUMBRA_ASSIGN(lights, read_lights(o));
  const prt::Character& character = charted.standing.character;
  const prt::SequenceOptions& options = charted.options;
  const prt::Clip& clip = character.clips[static_cast<std::size_t>(charted.standing.clip)];
  PENUMBRA_ASSIGN(frames, prt::baked_surface(character, charted.standing.clip, options, journals));
  ClipBench out;
  out.layout_ = prt::lay_out(character, options.map_width, options.map_height);
  out.frames_ = std::move(frames);
  for (const RadianceSh& light : lights) {
    auto& by_frame = out.lights_.emplace_back();
    for (std::size_t f = 0; f < out.frames_.size(); ++f) {
      const double t =
          clip.seconds * static_cast<double>(f) / static_cast<double>(out.frames_.size());
      auto& by_bone = by_frame.emplace_back();
      for (const glm::mat3& turn : prt::bone_turns(character, prt::sample(character, clip, t)))
        by_bone.push_back(lighting::ShRotation(glm::dmat3(glm::transpose(turn)), options.bands) *
                          light.with_bands(options.bands));
    }
  }
  out.make_maps();
  return out;
}

// What no texel covers continues what is beside it: a hole would cost transform coders bits.
void fill_holes(Image<float>& map, Image<std::uint8_t> known) {
  for (bool any = true; any;) {
    any = false;
    const Image<std::uint8_t> before = known;
    for (int y = 0; y < map.height(); ++y)
      for (int x = 0; x < map.width(); ++x) {
        if (before.at(x, y)) continue;
        float sum = 0, count = 0;
        for (const auto& [dx, dy] : {std::pair{-1, 0}, {1, 0}, {0, -1}, {0, 1}}) {
          const int i = x + dx, j = y + dy;
          if (i < 0 || j < 0 || i >= map.width() || j >= map.height() || !before.at(i, j)) continue;
          sum += map.at(i, j);
          ++count;
        }
        if (count == 0) continue;
        map.at(x, y) = sum / count;
        known.at(x, y) = 1;
        any = true;
      }
  }
}

void ClipBench::make_maps() {
  Image<std::uint8_t> covered(layout_.width, layout_.height);
  for (const prt::SurfaceLayout::Texel& t : layout_.texels) covered.at(t.x, t.y) = 1;
  for (const prt::Transfer& frame : frames_)
    for (int n = 0; n < coefficients(); ++n) {
      Image<float>& map = maps_.emplace_back(layout_.width, layout_.height);
      for (std::size_t i = 0; i < layout_.texels.size(); ++i)
        map.at(layout_.texels[i].x, layout_.texels[i].y) = frame.value(0, n, layout_.vertices + i);
      fill_holes(map, covered);
    }
}

// value(frame, coefficient, texel); over all lights, frames and texels, by luminance.
template <class Value>
double ClipBench::rendered_error(const Value& value) const {
  double wrong = 0, all = 0;
  for (const auto& by_frame : lights_) {
    double own_wrong = 0, own = 0;
    for (std::size_t f = 0; f < frames_.size(); ++f)
      for (std::size_t i = 0; i < layout_.texels.size(); ++i) {
        const RadianceSh& light = by_frame[f][layout_.bone[layout_.vertices + i]];
        double exact = 0, difference = 0;
        for (int n = 0; n < coefficients(); ++n) {
          const double l = luminance(light[n]), t = frames_[f].value(0, n, layout_.vertices + i);
          exact += l * t;
          difference += l * (value(f, n, i) - t);
        }
        own += exact * exact;
        own_wrong += difference * difference;
      }
    wrong += own_wrong / own;  // each light by its own brightness
    ++all;
  }
  return std::sqrt(wrong / all);
}

double ClipBench::error_of(std::span<const Image<float>> maps) const {
  return rendered_error([&](std::size_t f, int n, std::size_t i) {
    const Image<float>& map =
        maps[f * static_cast<std::size_t>(coefficients()) + static_cast<std::size_t>(n)];
    return double(map.at(layout_.texels[i].x, layout_.texels[i].y));
  });
}

double ClipBench::error_of(const prt::TransferSequence& sequence) const {
  std::vector<prt::Transfer> decoded(frames_.size());
  for (std::size_t f = 0; f < decoded.size(); ++f)
    sequence.decode(static_cast<double>(f), {}, decoded[f]);
  return rendered_error([&](std::size_t f, int n, std::size_t i) {
    return double(decoded[f].value(0, n, layout_.vertices + i));
  });
}

Result<void> ClipBench::run(const std::filesystem::path& scratch,
                            std::vector<RatePoint>& out) const {
  for (const double error : {.04, .02, .01, .007, .005, .0035, .0025}) {
    const auto ours = prt::compress_surface(layout_, frames_, error);
    out.push_back({"temporal PCA (ours)", fmt::format("error {}", error), ours.bytes,
                   error_of(ours.sequence)});
  }
  // By coefficient, as the dissertation keeps its maps: each is a video of its own.
  for (const int quality : {10, 30, 50, 70, 85, 93, 97, 99}) {
    std::vector<Image<float>> maps(maps_.size());
    std::size_t bytes = 0;
    for (int n = 0; n < coefficients(); ++n) {
      std::vector<Image<float>> video;
      const auto layers = static_cast<std::size_t>(coefficients());
      for (std::size_t i = static_cast<std::size_t>(n); i < maps_.size(); i += layers)
        video.push_back(maps_[i]);
      PENUMBRA_ASSIGN(coded, encode_rgbe_video(video, quality));
      bytes += coded.size();
      PENUMBRA_ASSIGN(decoded, decode_rgbe_video(coded, "maps"));
      for (std::size_t f = 0; f < decoded.size(); ++f)
        maps[f * layers + static_cast<std::size_t>(n)] = std::move(decoded[f]);
    }
    out.push_back(
        {"RGBE video (dissertation)", fmt::format("quality {}", quality), bytes, error_of(maps)});
  }
  for (const float level : {5.f, 15.f, 45.f, 150.f, 500.f}) {
    PENUMBRA_ASSIGN(coded, code_as_exr(maps_, coefficients(), level, scratch));
    out.push_back(
        {"OpenEXR DWAA", fmt::format("level {}", level), coded.bytes, error_of(coded.maps)});
  }
  for (const int crf : {4, 10, 16, 22, 28, 36}) {
    PENUMBRA_ASSIGN(coded, code_as_video(maps_, coefficients(), crf));
    out.push_back(
        {"H.264 10 bit intra", fmt::format("crf {}", crf), coded.bytes, error_of(coded.maps)});
  }
  return {};
}

}  // namespace

Result<void> chart_clip(const ChartOptions& o) {
  if (o.frames < 1 || o.frames > 1000)
    return fail(ErrorCode::kInvalid, "--frames", "is not within 1..1000");
  PENUMBRA_ASSIGN(clip, charted_clip(o));
  if (o.slurm.slurm) return chart_clip_on_slurm(o, clip);
  const CoreLimit cores;
  if (!o.shard.empty()) {
    PENUMBRA_ASSIGN(shard, shard_of_environment(o.shard));
    PENUMBRA_TRY(make_folder(o.output));
    PENUMBRA_ASSIGN(file, bake_charted_shard(o, clip, shard));
    print_shard(file, o.json);
    return {};
  }
  PENUMBRA_ASSIGN(output, OutputFolder::create(o.output));
  PENUMBRA_TRY(output.begin());
  PENUMBRA_ASSIGN(journals, charted_journals(o, clip, output.file("bake.journal")));
  PENUMBRA_ASSIGN(bench, ClipBench::make(o, clip, journals));
  std::vector<RatePoint> points;
  PENUMBRA_TRY(bench.run(output.work(), points));
  const RateNames names{fmt::format("{} frames of {} texels, {} coefficients: {:.0f} MB as floats",
                                    o.frames, bench.texels(), bench.coefficients(),
                                    static_cast<double>(bench.raw_bytes()) * 1e-6),
                        "Rendered error: relative RMSE (per cent)", "rendered_rel_rmse",
                        "Megabytes", 1e6};
  PENUMBRA_TRY(write_rates(output, points, names));
  if (o.merge == 0) remove_shards(journals);  // of this run's own folder
  PENUMBRA_TRY(output.keep());
  if (o.merge > 0) remove_shards(journals);  // once what they were for is there
  if (o.json) {
    nlohmann::json rows = nlohmann::json::array();
    for (const RatePoint& p : points)
      rows.push_back({{"coder", p.coder},
                      {"setting", p.setting},
                      {"bytes", p.bytes},
                      {"rendered_rel_rmse", p.error}});
    print_json({{"raw_bytes", bench.raw_bytes()}, {"rows", rows}});
    return {};
  }
  for (const RatePoint& p : points)
    fmt::print("{:<28} {:<14} {:>9.3f} MB  {:>7.3f} %\n", p.coder, p.setting,
               static_cast<double>(p.bytes) * 1e-6, 100 * p.error);
  for (const RatePoint& p : points) {
    if (p.coder != "RGBE video (dissertation)") continue;
    if (const auto ours = bytes_at(points, "temporal PCA (ours)", p.error))
      fmt::print("at {:.2f} % ours is {:.1f} times smaller than the dissertation's\n",
                 100 * p.error, static_cast<double>(p.bytes) / *ours);
  }
  fmt::print("{0}/rate-distortion.csv, {0}/rate-distortion.svg\n", o.output);
  return {};
}

}  // namespace penumbra::tools
