// How much a picture of a static scene moves because its light is measured anew with every frame.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "lighting/light_estimate.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/scene/scene.h"
#include "tools/chart/benches/chart_bench.h"
#include "tools/pictures/still.h"

namespace penumbra::tools {

/// The environment as a camera of 8 bits measures it again and again: bracketed, with shot and read
/// noise, merged.
/// errors: as capture::merge
Result<std::vector<Image<Rgb>>> measured_maps(const Image<Rgb>& environment, int count);

/// What a method makes of the map of that time; it may remember the maps before.
using LightOf = std::function<Result<lighting::LightEstimate>(const Image<Rgb>&, TimestampNs)>;

/// F = RMS(a_t - a_{t-1}) over the mean of a, on the pixels of objects and floor; maps come 30
/// times a second.
/// in: at least two maps
Result<double> measure_flicker(const ChartScene& bench, const runtime::PreparedScene& scene,
                               const LightOf& light, const runtime::ShadowSampling& sampling,
                               const Still& empty, std::span<const Image<Rgb>> maps);

}  // namespace penumbra::tools
