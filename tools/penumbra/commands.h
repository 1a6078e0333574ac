// The subcommands of `penumbra` as functions. main.cpp parses arguments and prints errors; a
// command prints its result on standard output (with json: one object and nothing else) and logs
// elsewhere.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/result.h"

namespace penumbra::service {

/// Of the shadow ratio's RMS error, kept with 95 % confidence; the mean error comes out at a quarter of it.
inline constexpr double kDefaultBudget = .05;

struct HdrMergeOptions {
  std::vector<std::string> images;
  std::string times;                    // seconds, separated by commas
  std::optional<std::string> response;  // estimated from the bracket when absent
  bool align = false;
  int reference =
      0;  // picture that is trusted most, from 1; 0: none, or with `align` the middle one
  std::string output;
  bool json = false;
};
Result<void> hdr_merge(const HdrMergeOptions& options);

struct CalibrateVignettingOptions {
  std::vector<std::string> pictures;
  std::string response = "srgb", output;
  std::optional<std::string> camera, report;
  double black_level = 0;
  bool json = false;
};
Result<void> calibrate_vignetting(const CalibrateVignettingOptions& options);

struct CalibrateBallOptions {
  std::string cameras;                // capture folder, recording or rig.toml
  std::vector<std::string> outlines;  // NAME:x,y,radius in pixels
  double radius_m = 0, sigma_px = 1;
  bool json = false;
};
Result<void> calibrate_ball(const CalibrateBallOptions& options);

struct HdrEnvironmentOptions {
  std::string capture, output;
  double at_s = 0;  // after the first frame: the surroundings as they were then; 0: at the end
  bool json = false;
};
Result<void> hdr_environment(const HdrEnvironmentOptions& options);

struct LightEstimateOptions {
  std::string environment;
  std::optional<std::string> projection;
  std::string bands = "auto", discs = "auto";
  bool json = false;
};
Result<void> light_estimate(const LightEstimateOptions& options);

struct BakeCommandOptions {
  std::string asset, output;
  int bands = 5, bounces = 4, samples = 1024;
  std::vector<double> albedo{.7, .7, .7};
  double receiver_albedo = 0;
  bool json = false;
  // Of a clip:
  std::string animation;
  double fps = 30, error = .005, between = .02;
  std::string light_map;  // "256x128", or empty: at vertices
  std::string shard;      // "i/n"
  int merge = 0;          // so many shards
  int ground_texels = 64;
};
Result<void> bake(const BakeCommandOptions& options);
Result<void> bake_clip(const BakeCommandOptions& options);
Rgb albedo_of(const BakeCommandOptions& options);

struct RenderOptions {
  std::string scene, environment, camera, output;
  std::optional<std::string> projection;
  std::string bands = "auto", discs = "auto";
  bool reference = false, without_objects = false;
  double error = .01, time_s = 0;
  std::optional<int> truncated_to;  // reference under light cut to so many bands
  bool json = false;
};
Result<void> render(const RenderOptions& options);

struct CompositeOptions {
  std::string capture, scene, output;
  int bands = 5;
  std::string discs = "auto";
  double budget = kDefaultBudget;
  bool json = false, video = true;
};
Result<void> composite(const CompositeOptions& options);

struct DemoOptions {
  bool headless = false, live = false, json = false, animated = true, video = true;
  int frames = 90;
  std::string output = "out/demo";
  std::optional<std::string> environment, asset, animation, prop, record;
  int width = 1280, height = 720;
  double fps = 30;
  int bands = 5;
  std::string discs = "auto";
  double budget = kDefaultBudget;
};
Result<void> demo(const DemoOptions& options);

struct ServeOptions {
  std::string config;
};
Result<void> serve(const ServeOptions& options);

struct RecordOptions {
  std::string config, output;
  double seconds = 0;  // 0 = until stopped
  int frames = 0;      // of all cameras; 0 = any
  bool json = false;
};
Result<void> record(const RecordOptions& options);

struct CalibrateCameraOptions {
  std::vector<std::string> pictures;
  std::optional<std::string>
      capture;          // instead: a recording, capture folder or rig.toml, of it `camera`
  double seconds = 60;  // of a rig: how long it is looked at
  std::string camera = "camera";  // its name, there and in the output
  double every_s = .5;            // of a capture: at least so long between two pictures
  std::string board, projection = "pinhole", output;
  bool undistorted = false;
  std::optional<std::string> report;
  bool json = false;
};
Result<void> calibrate_camera(const CalibrateCameraOptions& options);

struct CalibrateResponseOptions {
  std::vector<std::string> images;
  std::string times;  // seconds, separated by commas
  std::vector<std::string>
      captures;        // instead of both: of a still scene, two exposures at least in all
  std::string camera;  // in the captures
  std::string output;
  std::optional<std::string> report;
  bool json = false;
};
Result<void> calibrate_response(const CalibrateResponseOptions& options);

struct CalibrateColourOptions {
  std::string capture;  // of a still scene
  std::string environment = "environment", view = "view", model = "matrix", output;
  bool chart = false;  // a ColorChecker stands in both pictures
  std::optional<std::string> report;
  bool json = false;
};
Result<void> calibrate_colour(const CalibrateColourOptions& options);

struct CalibrateNoiseOptions {
  std::string capture;                // of a still scene
  std::optional<std::string> capped;  // the same camera with its lens capped
  std::string camera = "camera", output;
  std::optional<std::string> report;
  bool json = false;
};
Result<void> calibrate_noise(const CalibrateNoiseOptions& options);

struct CalibrateRigOptions {
  std::string capture;  // cameras that are fixed to each other, and a board
  std::string board, output;
  std::vector<std::string> cameras;    // the first is the rig's frame; empty: all
  std::optional<std::string> tracker;  // poses of the body that the cameras are fixed to, .csv
  double tracker_sigma_mm = 1, tracker_sigma_deg = .05;
  std::string board_lies;  // "floor" or "wall": the board is the world
  double every_s = .5, simultaneous_s = .005;
  std::optional<std::string> report;
  bool json = false;
};
Result<void> calibrate_rig(const CalibrateRigOptions& options);

struct CompareOptions {
  std::string a, b;
  std::optional<std::string>
      mask;            // "blue": pixels that are pure blue in this picture are left out
  bool scale = false;  // allow one scale factor
  bool json = false;
};
Result<void> compare(const CompareOptions& options);

struct InspectOptions {
  std::string file;
  bool json = false;
};
Result<void> inspect(const InspectOptions& options);

struct ChartOptions {
  std::string output = "out/chart";
  std::vector<std::string> environments;  // files
  bool with_procedural = false;           // the built-in ones beside the files
  std::vector<std::string> assets;
  std::vector<int> bands;  // only these, with `discs`; else the whole sweep
  int discs = 0;
  double error = .004;
  int governor = 0;        // prove the governor on so many scenes instead
  double budget = .05;     // of the shadow's RMS error in s, for that
  bool truncated = false;  // compare under the same truncated light instead of the whole light
  std::string animation;   // of the first asset: chart the compression of its transfer instead
  std::string light_map = "128x128";
  int frames = 100, samples = 512;
  bool json = false;
};
Result<void> chart(const ChartOptions& options);
/// Bytes against rendered error of ways to code transfer over a clip.
Result<void> chart_clip(const ChartOptions& options);
/// "WIDTHxHEIGHT" within 8..4096.
/// errors: kInvalid
Result<std::array<int, 2>> read_map_size(const std::string& option, const std::string& text);

}  // namespace penumbra::service
