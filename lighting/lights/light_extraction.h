// Compact light sources found in a map.
// threads: reentrant
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "lighting/lights/distant_light.h"
#include "lighting/sh/map_luminance.h"
#include "lighting/sh/row_overlay.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

struct ExtractionOptions {
  int max_count = 8;
  /// A source matters when it sends a surface that faces it this fraction of the mean irradiance.
  double min_irradiance_fraction = .02;
  /// Part of the sphere that the map shows; the rest is black. Means are those of what is shown:
  /// else a small bright view would be one light.
  double coverage = 1;
};

/// A map in which every source has been cut down to its surroundings, and the sources.
struct LightExtraction {
  RowOverlay residual;
  std::vector<DistantLight> lights;  // by falling irradiance; ids are not set
  double mean_luminance = 0;         // of the whole map
};

/// Blob peeling: connected regions brighter than six times the mean of what is not one
/// (8-neighbours, across the seam, and around the poles), each cut down to that level. A region of
/// a thousandfold range (a sun in its glow) is peeled in steps, the core first. The energy of
/// residual and lights together is the map's, channel by channel. Works on the full map: reduced to
/// 64 rows a sun would move by up to 1.4 degrees.
/// in:      luminance: of this map, see LatLongProjector::read
///          clipped: Environment::clipped; every connected region of it is a light of its own,
///          however little it sends, and before all others where there are more than max_count
/// out:     split.residual refers to the map, which must outlive it, and keeps its memory between
///          calls
/// errors:  kInvalid (empty), kNonFinite
/// source:  after Nowrouzezahrai, Geiger, Mitchell, Sumner, Jarosz & Gross 2011, section 4
Result<void> extract_lights(const Image<Rgb>& map, const MapLuminance& luminance,
                            const ExtractionOptions& options, LightExtraction& split,
                            std::span<const std::uint32_t> clipped = {});
Result<void> extract_lights(const Image<Rgb>&& map, const MapLuminance& luminance,
                            const ExtractionOptions& options, LightExtraction& split,
                            std::span<const std::uint32_t> clipped = {}) = delete;
/// Reads the map itself.
Result<void> extract_lights(const Image<Rgb>& map, const ExtractionOptions& options,
                            LightExtraction& split, std::span<const std::uint32_t> clipped = {});
Result<void> extract_lights(const Image<Rgb>&& map, const ExtractionOptions& options,
                            LightExtraction& split,
                            std::span<const std::uint32_t> clipped = {}) = delete;

}  // namespace penumbra::lighting
#pragma GCC visibility pop
