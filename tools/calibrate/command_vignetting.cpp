#include <fmt/format.h>

#include "calib/camera/projection.h"
#include "calib/camera/response.h"
#include "calib/estimate/vignetting_calibration.h"
#include "capture/frames.h"
#include "capture/recording/folder.h"
#include "codec/codec.h"
#include "core/files.h"
#include "tools/calibrate/calibration_report.h"
#include "tools/penumbra/commands.h"
#include "runtime/pipeline/report.h"

namespace penumbra::service {

namespace {

Result<calib::Projection> projection_of(const CalibrateVignettingOptions& o,
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

}  // namespace penumbra::service
