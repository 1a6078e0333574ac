// The `penumbra` program: arguments in, one line of error out.
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <functional>

#include "tools/penumbra/commands.h"

namespace {

using namespace penumbra;
using namespace penumbra::tools;

// The subcommand that was chosen; run after parsing.
using Action = std::function<Result<void>()>;

std::string not_empty(const std::string& text) {
  return text.empty() ? "is empty" : "";
}

void add_json(CLI::App* app, bool& json) {
  app->add_flag("--json", json, "Print one JSON object on standard output and nothing else");
}

constexpr const char* kDiscsHelp =
    "Most compact sources lit one by one beside the bands, or auto (8)";

constexpr const char* kBudgetHelp =
    "RMS error of the shadow ratio that the governor keeps to; bands and discs are its limits";

void add_calibrate_commands(CLI::App& app, Action& action) {
  auto* calibrate = app.add_subcommand("calibrate", "What a camera is like, from its own pictures");
  calibrate->require_subcommand(1);
  static CalibrateResponseOptions response;
  auto* c = calibrate->add_subcommand(
      "response",
      "Response curve from a bracket of a still scene that has everything from dark to bright");
  auto* images =
      c->add_option("images", response.images, "8-bit PNG, JPEG or TIFF, the camera still");
  c->add_option("--times", response.times, "Exposure times in seconds: t1,t2,... (1/60 works)")
      ->needs(images);
  auto* name = c->add_option("--camera", response.camera, "Its name in the captures");
  c->add_option(
       "--capture", response.captures,
       "Instead of images: recordings or capture folders of one still scene, two exposures at "
       "least in all; the frames of an exposure are averaged")
      ->excludes(images)
      ->needs(name);
  c->add_option("-o,--output", response.output, "Response file to write, .toml")->required();
  c->add_option("--report", response.report, "Folder for a plot and a table of the curves");
  add_json(c, response.json);
  c->callback([&] { action = [] { return calibrate_response(response); }; });

  static CalibrateCameraOptions camera;
  c = calibrate->add_subcommand(
      "camera",
      "Intrinsics from pictures of a board: ten to thirty, tilted to all sides, up to the borders");
  c->add_option("pictures", camera.pictures, "PNG, JPEG or TIFF pictures of the board");
  c->add_option(
      "--capture", camera.capture,
      "Instead of pictures: a recording, a capture folder, or a rig.toml whose camera is looked "
      "at live");
  c->add_option("--seconds", camera.seconds,
                "Of a live rig: how long; an interrupt ends it earlier")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  c->add_option("--camera", camera.camera, "Name of the camera, in the capture and in the output");
  c->add_option("--every", camera.every_s, "Of a capture: seconds between two pictures, at least");
  c->add_option("--board", camera.board,
                "chessboard:15x9:0.026 (inner corners, square in metres), "
                "charuco:8x6:0.04:0.03 (squares, square, marker) or apriltag:6x5:0.05:0.015 (tags, "
                "tag, gap)")
      ->required();
  c->add_option("--projection", camera.projection, "pinhole, equidistant, kb4 or double-sphere")
      ->capture_default_str();
  c->add_flag("--undistorted", camera.undistorted, "Keep the distortion at 0");
  c->add_option("-o,--output", camera.output, "Camera file to write, .toml")->required();
  c->add_option("--report", camera.report, "Folder for plots and a table of the residuals");
  add_json(c, camera.json);
  c->callback([&] { action = [] { return calibrate_camera(camera); }; });

  static CalibrateVignettingOptions vignetting;
  c = calibrate->add_subcommand(
      "vignetting",
      "What a lens takes of the light towards the borders, from pictures of an even surface");
  c->add_option("pictures", vignetting.pictures,
                "Of white paper out of focus, or a sky through it; turn the camera between them")
      ->required();
  c->add_option("--camera", vignetting.camera,
                "Camera file of calibrate camera: its principal point is the centre, else the "
                "picture's middle");
  c->add_option("--response", vignetting.response, "linear, srgb, gamma:2.2 or a response file")
      ->capture_default_str();
  c->add_option("--black-level", vignetting.black_level, "Fraction of full scale")
      ->check(CLI::Range(0., .9));
  c->add_option("-o,--output", vignetting.output, "Vignetting file to write, .toml")->required();
  c->add_option("--report", vignetting.report, "Folder for a plot");
  add_json(c, vignetting.json);
  c->callback([&] { action = [] { return calibrate_vignetting(vignetting); }; });

  static CalibrateBallOptions ball;
  c = calibrate->add_subcommand("ball",
                                "Where a mirror ball of known radius stands, from its outline in "
                                "pictures of cameras with known poses");
  c->add_option("cameras", ball.cameras, "Capture folder, recording or rig.toml with the cameras")
      ->required();
  c->add_option(
       "--outline", ball.outlines,
       "NAME:x,y,radius: a circle over the ball in that camera's picture, pixels; once a camera")
      ->required();
  c->add_option("--radius", ball.radius_m, "Of the ball, metres")
      ->required()
      ->check(CLI::PositiveNumber);
  c->add_option("--sigma-px", ball.sigma_px, "How exact the circles are")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  add_json(c, ball.json);
  c->callback([&] { action = [] { return calibrate_ball(ball); }; });

  static CalibrateNoiseOptions noise;
  c = calibrate->add_subcommand(
      "noise",
      "Full well, read noise and black level from frames of a still scene (photon transfer)");
  c->add_option(
       "capture", noise.capture,
       "Recording or capture folder: a still scene from dark to bright, eight frames or more of "
       "each exposure and gain")
      ->required();
  c->add_option("--capped", noise.capped,
                "The same camera with its lens capped, for the black level");
  c->add_option("--camera", noise.camera, "Its name in the captures")->capture_default_str();
  c->add_option("-o,--output", noise.output, "Noise file to write, .toml")->required();
  c->add_option("--report", noise.report, "Folder for a plot and a table of the points");
  add_json(c, noise.json);
  c->callback([&] { action = [] { return calibrate_noise(noise); }; });

  static CalibrateRigOptions rig;
  c = calibrate->add_subcommand(
      "rig", "Poses of cameras that are fixed to each other, from a board that they see at once");
  c->add_option("capture", rig.capture, "Recording or capture folder with the cameras' intrinsics")
      ->required();
  c->add_option("--board", rig.board, "As for calibrate camera")->required();
  c->add_option("--cameras", rig.cameras, "Names; the first is the rig's frame (all, as they come)")
      ->delimiter(',');
  c->add_option(
      "--tracker", rig.tracker,
      "Poses of the body that carries the cameras, before a board that stands still: CSV of "
      "time_s,tx,ty,tz,qx,qy,qz,qw");
  c->add_option("--tracker-sigma-mm", rig.tracker_sigma_mm, "Noise of a tracked position")
      ->capture_default_str();
  c->add_option("--tracker-sigma-deg", rig.tracker_sigma_deg, "Noise of a tracked rotation")
      ->capture_default_str();
  c->add_option("--board-lies", rig.board_lies,
                "floor or wall: cameras and board stand still, and the board's first corner is the "
                "world's origin");
  c->add_option("--every", rig.every_s, "Seconds between two moments, at least")
      ->capture_default_str();
  c->add_option("--simultaneous", rig.simultaneous_s,
                "Seconds that frames of one moment may lie apart")
      ->capture_default_str();
  c->add_option("-o,--output", rig.output, "Pose file to write, .toml")->required();
  c->add_option("--report", rig.report, "Folder for a plot and a table of the boards");
  add_json(c, rig.json);
  c->callback([&] { action = [] { return calibrate_rig(rig); }; });

  static CalibrateColourOptions colour;
  c = calibrate->add_subcommand(
      "colour", "Matrix that carries an environment camera's radiance into a view camera's");
  c->add_option(
       "capture", colour.capture,
       "Recording or capture folder of a still scene that both cameras see, with their poses")
      ->required();
  c->add_option("--environment", colour.environment, "Name of the environment camera")
      ->capture_default_str();
  c->add_option("--view", colour.view, "Name of the view camera")->capture_default_str();
  c->add_flag("--chart", colour.chart,
              "A ColorChecker of 24 patches stands in both pictures; poses do not matter");
  c->add_option("--model", colour.model, "matrix, gains (one a channel) or scale (one in all)")
      ->capture_default_str();
  c->add_option("-o,--output", colour.output, "Colour file to write, .toml")->required();
  c->add_option("--report", colour.report, "Folder for a plot and a table of the surfaces");
  add_json(c, colour.json);
  c->callback([&] { action = [] { return calibrate_colour(colour); }; });
}

void add_image_commands(CLI::App& app, Action& action) {
  auto* hdr = app.add_subcommand("hdr", "High dynamic range images");
  hdr->require_subcommand(1);
  static HdrMergeOptions merge;
  auto* c = hdr->add_subcommand("merge", "One HDR image from a bracket");
  c->add_option("images", merge.images, "8 or 16 bit PNG, JPEG, TIFF, or linear EXR/HDR")
      ->required();
  c->add_option(
       "--times", merge.times,
       "Exposure times in seconds: t1,t2,... (1/60 works; ? is found from the overlap, with "
       "--response)")
      ->required();
  c->add_flag("--align", merge.align, "The camera was held by hand: align the pictures first");
  c->add_option(
       "--reference", merge.reference,
       "Something moved: trust this picture (1, 2, ...) and leave out what contradicts it; "
       "with --align the middle exposure unless given")
      ->check(CLI::Range(1, 10000));
  c->add_option("--response", merge.response,
                "linear, srgb, gamma:2.2 or a response file; without it the curve is estimated "
                "from the bracket");
  c->add_option("-o,--output", merge.output, "Output .exr or .hdr")->required();
  add_json(c, merge.json);
  c->callback([&] { action = [] { return hdr_merge(merge); }; });

  static HdrEnvironmentOptions surroundings;
  c = hdr->add_subcommand(
      "environment",
      "What the cameras of a capture show of their surroundings, as one lat-long picture");
  c->add_option("capture", surroundings.capture, "Capture folder or recording")->required();
  c->add_option("--at", surroundings.at_s,
                "As it was so many seconds after the first frame; at the end without it")
      ->check(CLI::PositiveNumber);
  c->add_option("-o,--output", surroundings.output, "Output .exr or .hdr")->required();
  add_json(c, surroundings.json);
  c->callback([&] { action = [] { return hdr_environment(surroundings); }; });

  static CompareOptions compare_options;
  c = app.add_subcommand("compare", "Error figures between two pictures of the same size");
  c->add_option("a", compare_options.a, "Picture")->required();
  c->add_option("b", compare_options.b, "Reference")->required();
  c->add_option("--mask", compare_options.mask,
                "Leave out the pixels that are pure blue in this picture");
  c->add_flag("--scale", compare_options.scale, "Allow one scale factor, fitted in the logarithm");
  add_json(c, compare_options.json);
  c->callback([&] { action = [] { return compare(compare_options); }; });

  static InspectOptions inspect_options;
  c = app.add_subcommand("inspect",
                         "What is in a file: picture, mesh, baked object, scene, camera, capture "
                         "folder, recording; or which cameras there are");
  c->add_option("file", inspect_options.file,
                "File, recording or capture folder; cameras: what stands here and what each can do")
      ->required();
  add_json(c, inspect_options.json);
  c->callback([&] { action = [] { return inspect(inspect_options); }; });
}

void add_light_commands(CLI::App& app, Action& action) {
  auto* light = app.add_subcommand("light", "Light of an environment");
  light->require_subcommand(1);
  static LightEstimateOptions estimate;
  auto* c = light->add_subcommand("estimate", "Spherical-harmonic light of an environment map");
  c->add_option("environment", estimate.environment, "HDR environment (.exr or .hdr)")->required();
  c->add_option("--projection", estimate.projection,
                "latlong, angular, mirror-ball, equidistant, pinhole, vertical-cross, exr-latlong "
                "or exr-cube; "
                "an OpenEXR file that says what it is wins; without both, from its shape");
  c->add_option("--bands", estimate.bands, "1 to 9, or auto")->capture_default_str();
  c->add_option("--discs", estimate.discs, kDiscsHelp)->capture_default_str();
  add_json(c, estimate.json);
  c->callback([&] { action = [] { return light_estimate(estimate); }; });

  static BakeCommandOptions bake_options;
  c = app.add_subcommand(
      "bake", "Precompute transfer and shadow basis of an object on the plane it stands on");
  c->add_option("asset", bake_options.asset,
                "glTF, OBJ or PLY (or builtin:knot, builtin:twist, builtin:box, builtin:walker)")
      ->required();
  c->add_option("-o,--output", bake_options.output, "Baked .glb, of a clip .shlm")->required();
  c->add_option("--bands", bake_options.bands, "1 to 9")->capture_default_str();
  c->add_option("--bounces", bake_options.bounces,
                "Traced bounces of light between the parts; from 2 on the rest is extrapolated")
      ->capture_default_str();
  c->add_option("--samples", bake_options.samples, "Rays per vertex, a multiple of 64")
      ->capture_default_str();
  c->add_option("--albedo", bake_options.albedo, "R G B where the asset has no material")
      ->expected(3)
      ->check(CLI::Range(0., 1.))
      ->capture_default_str();
  c->add_option("--receiver-albedo", bake_options.receiver_albedo,
                "Of the plane under it; 0 reflects nothing")
      ->check(CLI::Range(0., 1.))
      ->capture_default_str();
  add_json(c, bake_options.json);
  const char* const kClip = "A clip of a character";
  c->add_option("--animation", bake_options.animation,
                "Clip, by name or number: transfer over its frames instead of one pose")
      ->check(not_empty)
      ->group(kClip);
  c->add_option("--fps", bake_options.fps, "Baked frames a second of the clip")
      ->capture_default_str()
      ->group(kClip);
  c->add_option("--light-map", bake_options.light_map,
                "WIDTHxHEIGHT texels instead of vertices, laid out by the asset's texture "
                "coordinates or, where "
                "those are not usable, by an atlas of its own")
      ->group(kClip);
  c->add_option("--error", bake_options.error, "Relative rendered error that compression may add")
      ->capture_default_str()
      ->group(kClip);
  c->add_option(
       "--between", bake_options.between,
       "Relative rendered error that a straight line between two frames may add: where it is "
       "more, further frames are baked between those of --fps; 0: none")
      ->capture_default_str()
      ->group(kClip);
  c->add_option("--ground-texels", bake_options.ground_texels,
                "Side of the shadow basis on the floor; 0: none")
      ->capture_default_str()
      ->group(kClip);
  c->add_option("--shard", bake_options.shard,
                "i/n: only every n-th frame from the i-th on, kept beside the output for --merge")
      ->group(kClip);
  c->add_option("--merge", bake_options.merge,
                "n: join n shards to the output; bakes what --between asks for")
      ->group(kClip);
  c->callback([&] {
    action = [] {
      return bake_options.animation.empty() ? bake(bake_options) : bake_clip(bake_options);
    };
  });
}

void add_picture_commands(CLI::App& app, Action& action) {
  static RenderOptions render_options;
  auto* c = app.add_subcommand("render", "A still in linear radiance of a scene in an environment");
  c->add_option("--scene", render_options.scene, "scene.toml")->required();
  c->add_option("--environment", render_options.environment, "HDR environment")->required();
  c->add_option("--projection", render_options.projection, "As in light estimate");
  c->add_option("--camera", render_options.camera, "camera.toml")->required();
  c->add_option("-o,--output", render_options.output, "Output .exr or .hdr")->required();
  c->add_option("--bands", render_options.bands, "1 to 9, or auto")->capture_default_str();
  c->add_option("--discs", render_options.discs, kDiscsHelp)->capture_default_str();
  c->add_flag("--reference", render_options.reference,
              "Path-trace the picture with the objects really there");
  c->add_option("--time", render_options.time_s, "Seconds: where clips and turntables are then")
      ->capture_default_str();
  c->add_option("--error", render_options.error, "Relative error at which the reference stops")
      ->capture_default_str();
  c->add_option("--truncated-to", render_options.truncated_to,
                "Path-trace under the light cut to so many bands instead of the whole environment");
  c->add_flag("--without-objects", render_options.without_objects, "The real world alone");
  add_json(c, render_options.json);
  c->callback([&] { action = [] { return render(render_options); }; });

  static CompositeOptions composite_options;
  c = app.add_subcommand("composite",
                         "Replay a recording through the whole pipeline; the same bytes each time");
  c->add_option("--capture", composite_options.capture, "Capture folder")->required();
  c->add_option("--scene", composite_options.scene, "scene.toml")->required();
  c->add_option("--out", composite_options.output, "Output folder")->required();
  c->add_option("--bands", composite_options.bands, "1 to 9")->capture_default_str();
  c->add_option("--discs", composite_options.discs, kDiscsHelp)->capture_default_str();
  c->add_option("--budget", composite_options.budget, kBudgetHelp)->capture_default_str();
  c->add_flag("!--no-video", composite_options.video, "Stills alone");
  add_json(c, composite_options.json);
  c->callback([&] { action = [] { return composite(composite_options); }; });

  static ChartOptions chart_options;
  c = app.add_subcommand("chart", "Error against time: sweeps, baselines, CSV and SVG");
  c->add_option("--out", chart_options.output, "Output folder")->capture_default_str();
  c->add_option("--environment", chart_options.environments,
                "HDR environments; built-in ones by default");
  c->add_flag("--with-procedural", chart_options.with_procedural,
              "The built-in environments beside the given ones");
  c->add_option("--asset", chart_options.assets, "Objects; the built-in knot and twist by default");
  c->add_option("--bands", chart_options.bands,
                "Only these numbers of bands, with --discs; by default the whole sweep")
      ->delimiter(',');
  c->add_option("--discs", chart_options.discs, "Most discs beside --bands")->capture_default_str();
  c->add_option("--governor", chart_options.governor,
                "Calibrate the governor on 59 random scenes and prove it on so many others");
  c->add_option("--budget", chart_options.budget, "Of the shadow's RMS error in s, for --governor")
      ->capture_default_str();
  c->add_option("--error", chart_options.error, "Relative error of the reference")
      ->capture_default_str();
  c->add_flag(
      "--truncated", chart_options.truncated,
      "Against the reference under the same truncated light: what bake, shadow and composite cost");
  const char* const kClip = "Compression of a clip's transfer instead";
  c->add_option("--animation", chart_options.animation,
                "Clip of the first --asset (builtin:walker without one): bytes against rendered "
                "error of ways to "
                "code its transfer")
      ->check(not_empty)
      ->group(kClip);
  c->add_option("--light-map", chart_options.light_map, "WIDTHxHEIGHT texels")
      ->capture_default_str()
      ->group(kClip);
  c->add_option("--frames", chart_options.frames, "Of the clip")
      ->capture_default_str()
      ->group(kClip);
  c->add_option("--samples", chart_options.samples, "Rays a texel and frame, a multiple of 64")
      ->capture_default_str()
      ->group(kClip);
  add_json(c, chart_options.json);
  c->callback([&] {
    action = [] {
      return chart_options.animation.empty() ? chart(chart_options) : chart_clip(chart_options);
    };
  });
}

void add_running_commands(CLI::App& app, Action& action) {
  static DemoOptions demo_options;
  auto* c = app.add_subcommand("demo", "The main job on a synthetic studio: video, still, summary");
  c->add_flag("--headless", demo_options.headless, "No window even with a display");
  c->add_option("--frames", demo_options.frames, "View frames")->capture_default_str();
  c->add_option("--out", demo_options.output, "Output folder")->capture_default_str();
  c->add_option("--environment", demo_options.environment,
                "HDR environment; the built-in room by default");
  c->add_option("--asset", demo_options.asset,
                "Object; the built-in knot by default, or with --animation builtin:walker");
  c->add_option("--animation", demo_options.animation,
                "Clip that the asset plays, by name or number; its frames are baked first")
      ->check(not_empty);
  c->add_option("--prop", demo_options.prop,
                "Mesh of something that really stands in the studio, or builtin:box");
  c->add_flag("!--still-only", demo_options.animated, "Leave out the turning object");
  c->add_option("--record", demo_options.record,
                "Also record a capture folder with its scene.toml");
  c->add_flag("!--no-video", demo_options.video, "Still and summary alone");
  c->add_flag("--live", demo_options.live,
              "Cameras (filmed beforehand), light and composite on threads, paced by the clock; "
              "discs that --fps leaves no time for are given up");
  c->add_option("--width", demo_options.width, "View camera, pixels")->capture_default_str();
  c->add_option("--height", demo_options.height, "View camera, pixels")->capture_default_str();
  c->add_option("--fps", demo_options.fps, "View camera, frames a second")->capture_default_str();
  c->add_option("--bands", demo_options.bands, "1 to 9")->capture_default_str();
  c->add_option("--discs", demo_options.discs, kDiscsHelp)->capture_default_str();
  c->add_option("--budget", demo_options.budget, kBudgetHelp)->capture_default_str();
  add_json(c, demo_options.json);
  c->callback([&] { action = [] { return demo(demo_options); }; });

  static RecordOptions record_options;
  c = app.add_subcommand("record", "Record a rig's cameras into Matroska until Ctrl-C");
  c->add_option("--config", record_options.config, "rig.toml")->required();
  c->add_option("--out,-o", record_options.output, "Recording to make, .mkv")->required();
  c->add_option("--seconds", record_options.seconds, "Stop after so many seconds of frames");
  c->add_option("--frames", record_options.frames, "Stop after so many frames of all cameras");
  add_json(c, record_options.json);
  c->callback([&] { action = [] { return record(record_options); }; });

  static ServeOptions serve_options;
  c = app.add_subcommand("serve", "The live service with its HTTP interface on loopback");
  c->add_option("--config", serve_options.config, "rig.toml")->required();
  c->callback([&] { action = [] { return serve(serve_options); }; });
}

int report(const Error& e) {
  std::string line = "penumbra: " + e.where + ": " + e.detail;
  for (char& ch : line)
    if (ch == '\n' || ch == '\r') ch = ' ';
  std::fprintf(stderr, "%s\n", line.c_str());
  return 2;
}

}  // namespace

int main(int argc, char** argv) {
  spdlog::set_default_logger(spdlog::stderr_color_mt("penumbra"));
  spdlog::set_pattern("%^%l%$: %v");
  CLI::App app(
      "Mixed reality with measured light: HDR capture, precomputed transfer, differential shadows");
  app.require_subcommand(1);
  app.set_version_flag("--version", std::string("penumbra ") + PENUMBRA_VERSION);
  Action action;
  add_running_commands(app, action);
  add_picture_commands(app, action);
  add_image_commands(app, action);
  add_calibrate_commands(app, action);
  add_light_commands(app, action);
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& e) {
    return app.exit(e);  // help and version
  } catch (const CLI::ParseError& e) {
    return report({ErrorCode::kInvalid, "arguments", e.what()});
  }
  try {
    if (const auto result = action(); !result) return report(result.error());
  } catch (const std::exception& e) {
    return report({ErrorCode::kUnavailable, "internal", e.what()});
  }
  return 0;
}
