// Plots of a calibration for --report.
#pragma once

#include <filesystem>
#include <span>

#include "calib/camera/colour.h"
#include "calib/estimate/boards.h"
#include "calib/estimate/camera_calibration.h"
#include "calib/estimate/colour_calibration.h"
#include "calib/estimate/estimate_response.h"
#include "calib/estimate/latency.h"
#include "calib/estimate/noise_calibration.h"
#include "calib/estimate/rig_calibration.h"
#include "calib/estimate/vignetting_calibration.h"
#include "core/result.h"

namespace penumbra::tools {

/// coverage.svg (where corners were seen, what is left of their errors, enlarged), residuals.svg
/// (errors in x and y), boards.svg (error of each picture), residuals.csv. Without gnuplot only the
/// last.
/// errors: kUnwritable
Result<void> write_camera_report(const std::filesystem::path& folder,
                                 const calib::CameraCalibration& calibration,
                                 std::span<const calib::BoardView> views);

/// response.svg (light over code, logarithmic, per channel), response.csv. Without gnuplot only the
/// last.
/// errors: kUnwritable
Result<void> write_response_report(const std::filesystem::path& folder,
                                   const calib::ResponseCalibration& calibration);

/// colours.svg (each surface's channels as carried over the view camera's), colours.csv. Without
/// gnuplot only the last.
/// errors: kUnwritable
Result<void> write_colour_report(const std::filesystem::path& folder,
                                 const calib::ColourCalibration& calibration,
                                 std::span<const calib::ColourPair> pairs);

/// noise.svg (standard deviation over signal, measured and as modelled), noise.csv. Without gnuplot
/// only the last.
/// errors: kUnwritable
Result<void> write_noise_report(const std::filesystem::path& folder,
                                const calib::NoiseCalibration& calibration);

/// vignetting.svg (light over the distance from the centre, seen and as fitted), vignetting.csv.
/// Without gnuplot only the last.
/// errors: kUnwritable
Result<void> write_vignetting_report(const std::filesystem::path& folder,
                                     const calib::VignettingCalibration& calibration);

/// rig.svg (the cameras from above and from the side, with where they look), rig.csv. Without
/// gnuplot only the last.
/// errors: kUnwritable
Result<void> write_rig_report(const std::filesystem::path& folder,
                              std::span<const calib::RigCameraInput> cameras,
                              std::span<const Pose> poses,
                              const calib::RigCalibration& calibration);

/// latency.svg (how fast camera and tracker turn), latency.csv. Without gnuplot only the last.
/// errors: kUnwritable
Result<void> write_latency_report(const std::filesystem::path& folder,
                                  const calib::Latency& latency);

}  // namespace penumbra::tools
