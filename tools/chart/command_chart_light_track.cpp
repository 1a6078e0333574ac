// Bytes against the light's error of ways to keep maps of the surroundings.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <glm/geometric.hpp>

#include "capture/recording/recording.h"
#include "capture/studio/studio.h"
#include "core/conventions.h"
#include "runtime/pipeline/light_track.h"
#include "tools/chart/charts/chart_environments.h"
#include "tools/chart/charts/chart_options.h"
#include "tools/chart/charts/rate_chart.h"
#include "tools/chart/peers/light_coders.h"
#include "tools/chart/peers/peer_codecs.h"
#include "tools/chart/peers/rgbe_video.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/runs/output.h"

namespace penumbra::tools {

namespace {

constexpr int kMapsCharted = 60;
constexpr const char* kOurs = "light track (ours)";

// Light at surfaces that face all around: what maps are for.
class Irradiances {
 public:
  Irradiances(int width, int height) {
    constexpr int kNormals = 32;
    constexpr double kGoldenAngle = 2.399963;
    for (int k = 0; k < kNormals; ++k) {
      const double y = 1 - (2 * k + 1) / double(kNormals), r = std::sqrt(1 - y * y);
      const glm::dvec3 normal(r * std::cos(k * kGoldenAngle), y, r * std::sin(k * kGoldenAngle));
      Image<float>& weights = weights_.emplace_back(width, height);
      for (int j = 0; j < height; ++j)
        for (int i = 0; i < width; ++i)
          weights.at(i, j) = static_cast<float>(
              latlong_solid_angle(j, width, height) *
              std::max(0., glm::dot(normal, latlong_direction(i + .5, j + .5, width, height))));
    }
  }
  std::vector<glm::dvec3> of(const Image<Rgb>& map) const {
    std::vector<glm::dvec3> out;
    for (const Image<float>& weights : weights_) {
      glm::dvec3& sum = out.emplace_back(0);
      for (std::size_t i = 0; i < map.area(); ++i) {
        const Rgb& p = map.pixels()[i];
        sum += glm::dvec3(p.r, p.g, p.b) * double(weights.pixels()[i]);
      }
    }
    return out;
  }

 private:
  std::vector<Image<float>> weights_;
};

// The maps of one scene, as its cameras measure them, and their light.
struct FilmedLight {
  std::vector<Image<Rgb>> maps;
  std::vector<capture::Frame> frames;
  capture::CameraInfo track;
  std::vector<std::vector<glm::dvec3>> light;
};

Result<FilmedLight> film_light(const ChartEnvironment& environment,
                               const Irradiances& irradiances) {
  PENUMBRA_ASSIGN(world, capture::FloorWorld::make(environment.map));
  capture::StudioOptions options;
  options.view_width = 64, options.view_height = 36, options.view_focal_px = 60;
  options.world_from_view = capture::look_at({.2, .6, 1.4}, {0, .2, 0});
  options.sensor.response = calib::Response::srgb();
  options.view_frames = 2 * kMapsCharted;
  capture::Studio studio(world, options);
  PENUMBRA_ASSIGN(tracked, runtime::with_light_track(studio, runtime::KeptLight::kTrack));
  FilmedLight out;
  out.track = tracked->cameras().back();
  while (out.maps.size() < kMapsCharted) {
    PENUMBRA_ASSIGN(frame, tracked->next());
    if (!frame) break;
    if (!frame->map) continue;
    frame->camera = 0;
    out.maps.push_back(frame->map->radiance);
    out.light.push_back(irradiances.of(frame->map->radiance));
    out.frames.push_back(std::move(*frame));
  }
  return out;
}

// Of irradiance: relative RMSE over maps, normals and channels.
double light_error(const Irradiances& irradiances, const FilmedLight& truth,
                   std::span<const Image<Rgb>> maps) {
  double sum = 0, count = 0;
  for (std::size_t m = 0; m < maps.size(); ++m) {
    const auto got = irradiances.of(maps[m]);
    for (std::size_t k = 0; k < got.size(); ++k)
      for (int c = 0; c < 3; ++c, ++count) sum += std::pow(got[k][c] / truth.light[m][k][c] - 1, 2);
  }
  return std::sqrt(sum / count);
}

Result<CodedLight> code_as_track(const FilmedLight& film, const std::filesystem::path& folder) {
  const std::filesystem::path file = folder / "light.mkv";
  const std::vector codings{capture::Coding::kMap};
  CodedLight out;
  {
    PENUMBRA_ASSIGN(writer, capture::RecordingWriter::create(file, {film.track}, codings, 0));
    const std::uint64_t head = writer.bytes();
    for (const capture::Frame& frame : film.frames) PENUMBRA_TRY(writer.write(frame));
    out.bytes = writer.bytes() - head;
    PENUMBRA_TRY(writer.finish());
  }
  PENUMBRA_ASSIGN(source, capture::open_recording(file, capture::RecordedLight::kTrack));
  for (;;) {
    PENUMBRA_ASSIGN(frame, source->next());
    if (!frame) break;
    out.maps.push_back(frame->map->radiance);
  }
  source.reset();
  std::error_code ignored;
  std::filesystem::remove(file, ignored);
  return out;
}

// Channel by channel, as coders of one value a pixel take them.
std::vector<Image<float>> channel_planes(std::span<const Image<Rgb>> maps, int channel) {
  std::vector<Image<float>> out;
  for (const Image<Rgb>& map : maps) {
    Image<float>& plane = out.emplace_back(map.width(), map.height());
    std::ranges::transform(map.pixels(), plane.pixels().begin(),
                           [channel](const Rgb& p) { return p[channel]; });
  }
  return out;
}

void put_channel(std::span<const Image<float>> planes, int channel, std::vector<Image<Rgb>>& maps) {
  maps.resize(planes.size());
  for (std::size_t m = 0; m < planes.size(); ++m) {
    if (maps[m].empty()) maps[m].reset(planes[m].width(), planes[m].height());
    for (std::size_t i = 0; i < planes[m].area(); ++i)
      maps[m].pixels()[i][channel] = planes[m].pixels()[i];
  }
}

Result<CodedLight> code_as_rgbe(std::span<const Image<Rgb>> maps, int quality) {
  CodedLight out;
  for (int c = 0; c < 3; ++c) {
    PENUMBRA_ASSIGN(coded, encode_rgbe_video(channel_planes(maps, c), quality, kLightCoderKeys));
    out.bytes += coded.size();
    PENUMBRA_ASSIGN(planes, decode_rgbe_video(coded, "maps"));
    put_channel(planes, c, out.maps);
  }
  return out;
}

Result<CodedLight> code_as_pictures(std::span<const Image<Rgb>> maps, float level,
                                    const std::filesystem::path& folder) {
  CodedLight out;
  for (int c = 0; c < 3; ++c) {
    PENUMBRA_ASSIGN(coded, code_as_exr(channel_planes(maps, c), 1, level, folder));
    out.bytes += coded.bytes;
    put_channel(coded.maps, c, out.maps);
  }
  return out;
}

struct CoderSetting {
  std::string coder, setting;
  std::function<Result<CodedLight>(const FilmedLight&)> code;
};

std::vector<CoderSetting> coder_settings(const std::filesystem::path& folder) {
  std::vector<CoderSetting> out;
  out.push_back(
      {kOurs, "as recorded", [=](const FilmedLight& f) { return code_as_track(f, folder); }});
  for (const int quantiser : {4, 10, 16, 22, 28}) {
    for (const LightCoder coder : {LightCoder::kHevcLog, LightCoder::kHevcPq, LightCoder::kAv1Pq}) {
      const int own = coder == LightCoder::kAv1Pq ? 2 * quantiser : quantiser;
      out.push_back({name_of(coder), fmt::format("quantiser {}", own),
                     [=](const FilmedLight& f) { return code_light(coder, f.maps, own); }});
    }
  }
  for (const int quality : {30, 60, 85, 95})
    out.push_back({"RGBE video (dissertation)", fmt::format("quality {}", quality),
                   [=](const FilmedLight& f) { return code_as_rgbe(f.maps, quality); }});
  for (const float level : {45.f, 200.f, 1000.f})
    out.push_back({"OpenEXR DWAA", fmt::format("level {}", level),
                   [=](const FilmedLight& f) { return code_as_pictures(f.maps, level, folder); }});
  return out;
}

// Over all scenes: bytes a map in the mean, and the root of the mean square error.
Result<std::vector<RatePoint>> chart_coders(std::span<const ChartEnvironment> environments,
                                            const std::filesystem::path& folder) {
  std::vector<CoderSetting> settings = coder_settings(folder);
  std::vector<RatePoint> out(settings.size());
  const Irradiances irradiances(2 * runtime::kLightTrackRows, runtime::kLightTrackRows);
  const auto progress = progress_bar("coding");
  double done = 0;
  for (const ChartEnvironment& environment : environments) {
    PENUMBRA_ASSIGN(film, film_light(environment, irradiances));
    for (std::size_t i = 0; i < settings.size(); ++i) {
      PENUMBRA_ASSIGN(coded, settings[i].code(film));
      out[i].bytes += coded.bytes / film.maps.size() / environments.size();
      out[i].error +=
          std::pow(light_error(irradiances, film, coded.maps), 2) / double(environments.size());
      progress(++done / double(settings.size() * environments.size()));
    }
  }
  for (std::size_t i = 0; i < settings.size(); ++i) {
    out[i].coder = settings[i].coder, out[i].setting = settings[i].setting;
    out[i].error = std::sqrt(out[i].error);
  }
  return out;
}

}  // namespace

Result<void> chart_light_track(const ChartOptions& o) {
  PENUMBRA_ASSIGN(environments, read_environments(o.environments, o.with_procedural));
  PENUMBRA_ASSIGN(output, OutputFolder::create(o.output));
  PENUMBRA_TRY(output.begin());
  PENUMBRA_ASSIGN(points, chart_coders(environments, output.work()));
  const RateNames names{
      fmt::format("{} scenes, {} maps each of {} x {} pixels", environments.size(), kMapsCharted,
                  2 * runtime::kLightTrackRows, runtime::kLightTrackRows),
      "Error of irradiance: relative RMSE (per cent)", "irradiance_rel_rmse", "Bytes a map", 1};
  PENUMBRA_TRY(write_rates(output, points, names));
  PENUMBRA_TRY(output.keep());
  if (o.json) {
    nlohmann::json rows = nlohmann::json::array();
    for (const RatePoint& p : points)
      rows.push_back({{"coder", p.coder},
                      {"setting", p.setting},
                      {"bytes", p.bytes},
                      {"irradiance_rel_rmse", p.error}});
    print_json({{"environments", environments.size()}, {"rows", rows}});
    return {};
  }
  for (const RatePoint& p : points)
    fmt::print("{:<28} {:<14} {:>9} bytes a map  {:>7.3f} %\n", p.coder, p.setting, p.bytes,
               100 * p.error);
  const RatePoint& ours = points.front();
  for (const LightCoder coder : {LightCoder::kHevcLog, LightCoder::kHevcPq, LightCoder::kAv1Pq})
    if (const auto bytes = bytes_at(points, name_of(coder), ours.error))
      fmt::print("at {:.2f} % {} takes {:.1f} times as many bytes\n", 100 * ours.error,
                 name_of(coder), *bytes / double(ours.bytes));
    else
      fmt::print("{} does not reach {:.2f} % here\n", name_of(coder), 100 * ours.error);
  fmt::print("{0}/rate-distortion.csv, {0}/rate-distortion.svg\n", o.output);
  return {};
}

}  // namespace penumbra::tools
