// One row of the environment gather, with run-time choice of the vector instructions.
#pragma once

#include <cstdint>

namespace penumbra::capture {

/// out[3 i + c] = scale * bilinear sample of RGBA half pixels at sample i; a sample of offset -1
/// gives 0. Returns the sum of the sampled fourth channel. A sample: offset in pixels, weights 0..1
/// of the right and the lower neighbour.
struct GatherSample {
  std::int32_t offset;
  float right, down;
};
float gather_row(const std::uint16_t* rgba, int source_width, const GatherSample* samples,
                 int count, float scale, float* out);

/// The same for a source that is already lat-long: conversion only.
float convert_row(const std::uint16_t* rgba, int count, float scale, float* out);

}  // namespace penumbra::capture
