#include "service/openxr/layer_settings.h"

#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <numbers>
#include <utility>

namespace penumbra::openxr {

namespace {

constexpr std::pair<std::string_view, penumbra_convention> kConventions[] = {
    {"webxr", PENUMBRA_CONVENTION_WEBXR}, {"arcore", PENUMBRA_CONVENTION_ARCORE},
    {"godot", PENUMBRA_CONVENTION_GODOT}, {"filament", PENUMBRA_CONVENTION_FILAMENT},
    {"unity", PENUMBRA_CONVENTION_UNITY}, {"unreal", PENUMBRA_CONVENTION_UNREAL}};

std::string_view variable(const char* name) {
  const char* value = std::getenv(name);
  return value ? value : "";
}

void complain(const char* name, std::string_view value, const char* known) {
  std::fprintf(stderr, "penumbra: %s: \"%.*s\" is not %s\n", name, static_cast<int>(value.size()),
               value.data(), known);
}

}  // namespace

LayerSettings read_layer_settings(std::string_view engine_name) {
  LayerSettings out;
  // Its vendors plugin looks the harmonics up at a mirrored z. Other engines take them as they are.
  if (engine_name.starts_with("Godot")) out.convention = PENUMBRA_CONVENTION_GODOT;

  if (const auto name = variable("PENUMBRA_XR_CONVENTION"); !name.empty()) {
    bool known = false;
    for (const auto& [text, convention] : kConventions)
      if (text == name) out.convention = convention, known = true;
    if (!known)
      complain("PENUMBRA_XR_CONVENTION", name, "webxr, arcore, godot, filament, unity or unreal");
  }
  if (const auto sign = variable("PENUMBRA_XR_LIGHT_DIRECTION"); !sign.empty()) {
    if (sign == "towards" || sign == "along")
      out.towards_light = sign == "towards";
    else
      complain("PENUMBRA_XR_LIGHT_DIRECTION", sign, "towards or along");
  }
  if (const auto yaw = variable("PENUMBRA_XR_YAW_DEGREES"); !yaw.empty()) {
    double degrees = 0;
    const auto [end, error] = std::from_chars(yaw.data(), yaw.data() + yaw.size(), degrees);
    if (error == std::errc{} && end == yaw.data() + yaw.size() && std::isfinite(degrees))
      out.yaw_rad = degrees * std::numbers::pi / 180;
    else
      complain("PENUMBRA_XR_YAW_DEGREES", yaw, "a number");
  }
  return out;
}

}  // namespace penumbra::openxr
