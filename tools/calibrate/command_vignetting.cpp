#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "calib/camera/camera_model.h"
#include "calib/camera/response.h"
#include "calib/estimate/vignetting_calibration.h"
#include "capture/frames.h"
#include "capture/recording/folder.h"
#include "codec/codec.h"
#include "core/io/files.h"
#include "runtime/pipeline/report.h"
#include "tools/calibrate/calibration_report.h"
#include "tools/calibrate/commands.h"
#include "tools/common/command.h"
#include "tools/common/print.h"

namespace penumbra::tools {

namespace {

struct CalibrateVignettingOptions {
  std::vector<std::string> pictures;
  std::string response = "srgb", output;
  std::optional<std::string> camera, report;
  double black_level = 0;
  bool json = false;
};

Result<calib::CameraModel> projection_of(const CalibrateVignettingOptions& o,
                                         const FramePixels& picture) {
  if (o.camera) {
    PENUMBRA_ASSIGN(camera, capture::read_camera_file(*o.camera));
    return camera.projection;
  }
  return calib::make_projection(calib::ProjectionKind::kPinhole, capture::width(picture),
                                capture::height(picture));
}

}  // namespace

Result<void> calibrate_vignetting(const CalibrateVignettingOptions& o) {
  PENUMBRA_TRY(check_writable(o.output));
  if (o.report) PENUMBRA_TRY(make_folder(*o.report));
  PENUMBRA_ASSIGN(response, calib::parse_response(o.response));
  std::vector<calib::EvenPicture> pictures;
  for (const std::string& name : o.pictures) {
    PENUMBRA_ASSIGN(pixels, codec::read_frame(name));
    pictures.push_back({name, std::move(pixels)});
  }
  PENUMBRA_ASSIGN(projection, projection_of(o, pictures[0].pixels));
  PENUMBRA_ASSIGN(found,
                  calib::calibrate_vignetting(pictures, projection, response, o.black_level));
  PENUMBRA_TRY(write_bytes(o.output, calib::print_vignetting_file(found)));
  if (o.report) PENUMBRA_TRY(write_vignetting_report(*o.report, found));
  if (o.json) {
    print_json({{"terms", found.vignetting.terms},
                {"corner", found.corner},
                {"corner_sigma", found.corner_sigma},
                {"residual", found.residual},
                {"pictures", pictures.size()}});
    return {};
  }
  fmt::print("{}: {:.1f} +- {:.1f} % of the light in the corners; {:.2f} % RMS left{}\n", o.output,
             100 * found.corner, 100 * found.corner_sigma, 100 * found.residual,
             pictures.size() == 1
                 ? "; one picture cannot tell the lens from a light that is brighter in its middle"
                 : "");
  return {};
}

void add_calibrate_vignetting(CLI::App& parent, Action& action) {
  static CalibrateVignettingOptions vignetting;
  auto* c = parent.add_subcommand(
      "vignetting",
      "Find how a lens darkens the picture towards its borders, from pictures of an even surface");
  c->add_option(
       "pictures", vignetting.pictures,
       "Pictures of an evenly lit surface, such as white paper out of focus; turn the camera "
       "between them")
      ->required();
  c->add_option(
      "--camera", vignetting.camera,
      "Camera file, whose principal point is the centre of the vignetting; by default the "
      "centre of the picture");
  c->add_option("--response", vignetting.response,
                "Response curve of the camera: linear, srgb, gamma:2.2 or a response file")
      ->capture_default_str();
  c->add_option("--black-level", vignetting.black_level,
                "Code of darkness as a fraction of full scale, 0 to 0.9")
      ->check(within(0, .9))
      ->capture_default_str();
  c->add_option("-o,--output", vignetting.output, "Vignetting file to write, .toml")->required();
  c->add_option("--report", vignetting.report, "Folder for a plot and a table of the fall-off");
  add_json(c, vignetting.json);
  c->callback([&] { action = [] { return calibrate_vignetting(vignetting); }; });
}

}  // namespace penumbra::tools
