#include "tools/runs/light_options.h"

#include <charconv>

#include "lighting/estimate.h"
#include "tools/common/command.h"

namespace penumbra::tools {

Result<lighting::ExtractionOptions> choose_max_lights(const std::string& text) {
  lighting::ExtractionOptions options;
  if (text == "auto") return options;
  const auto [end, error] =
      std::from_chars(text.data(), text.data() + text.size(), options.max_count);
  if (error != std::errc() || end != text.data() + text.size() || options.max_count < 0 ||
      options.max_count > 64)
    return fail(ErrorCode::kInvalid, "--max-lights",
                "\"" + text + "\" is neither auto nor within 0..64");
  return options;
}

Result<void> check_max_shadow_error(double value) {
  if (value > 0 && value <= 1) return {};
  return fail(ErrorCode::kInvalid, "--max-shadow-error", "is not above 0 and at most 1");
}

void add_orientation(CLI::App& app, runtime::EnvironmentOrientation& orientation) {
  app.add_option("--projection", orientation.projection, kProjectionHelp);
  app.add_option("--rotate-environment", orientation.rotation_deg, kRotationHelp)
      ->capture_default_str();
}

Result<int> choose_bands(const std::string& text, const lighting::ShProjection& nine_bands) {
  if (text == "auto") {
    for (int bands = 1; bands < kMaxBands; ++bands)
      if (lighting::make_estimate(nine_bands, bands).truncation_error.value_or(0) <= .005)
        return bands;
    return kMaxBands;
  }
  int bands = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), bands);
  if (error != std::errc() || end != text.data() + text.size() || bands < 1 || bands > kMaxBands)
    return fail(ErrorCode::kInvalid, "--bands", "\"" + text + "\" is neither auto nor within 1..9");
  return bands;
}

}  // namespace penumbra::tools
