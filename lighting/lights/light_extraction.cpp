#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/threads/background_task.h"
#include "core/threads/scratch.h"
#include "lighting/lights/distant_light.h"
#include "lighting/lights/internal/light_shape.h"
#include "lighting/lights/light_extraction.h"
#include "lighting/sh/latlong_kernel.h"
#include "lighting/sh/map_luminance.h"
#include "lighting/sh/row_overlay.h"

namespace penumbra::lighting {

namespace {

constexpr float kAboveMean = 6;     // a source is brighter than this times the mean of the rest
constexpr float kStep = 300;        // regions with a larger range than this are peeled core first
constexpr double kRoundness = 1.2;  // of a 1.8:1 rectangle
constexpr double kRoundnessOfLarge = 1.03;  // of a square 1.05
constexpr double kOneSource = .02;          // radians
constexpr double kLarge = .03;  // steradians, 11 degrees across: of larger ones corners are seen
constexpr double kSmall = .01;  // radians: the form of smaller sources cannot be seen in a shadow
constexpr float kCoreLevel = .01f;  // of the peak: where the core of such a region ends

// Temporaries come from the thread's scratch memory.
// Pixels [x0, x1) of row y.
struct Run {
  int y, x0, x1;
  float peak = 0;  // of luminance
  double sum = 0;  // of luminance
  int length() const { return x1 - x0; }
};

// luminance: of its pixels. In eight sums side by side, so that none waits for another.
Run run_of(int y, int x0, int x1, const float* luminance) {
  constexpr int kSums = 8;
  float peak[kSums] = {}, sum[kSums] = {};
  const auto add = [&](int i, float l) {
    peak[i] = std::max(peak[i], l);
    sum[i] += l;
  };
  int k = 0;
  for (; k + kSums <= x1 - x0; k += kSums)
    for (int i = 0; i < kSums; ++i) add(i, luminance[k + i]);
  for (; k < x1 - x0; ++k) add(0, luminance[k]);
  Run run{y, x0, x1};
  for (int i = 0; i < kSums; ++i) {
    run.peak = std::max(run.peak, peak[i]);
    run.sum += static_cast<double>(sum[i]);
  }
  return run;
}

class DisjointSets {
 public:
  DisjointSets(std::size_t count, std::pmr::memory_resource* memory) : parent_(count, memory) {
    std::iota(parent_.begin(), parent_.end(), std::size_t{0});
  }
  std::size_t find(std::size_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(std::size_t a, std::size_t b) { parent_[find(a)] = find(b); }

 private:
  std::pmr::vector<std::size_t> parent_;
};

struct BrightRegion {
  using allocator_type = std::pmr::polymorphic_allocator<>;
  BrightRegion(const allocator_type& memory) : runs(memory) {}
  BrightRegion(BrightRegion&&) = default;
  BrightRegion(BrightRegion&& other, const allocator_type& memory)
      : runs(std::move(other.runs), memory), peak(other.peak), pixels(other.pixels) {}
  BrightRegion& operator=(BrightRegion&&) = default;
  void add(const Run& run) {
    runs.push_back(run);
    peak = std::max(peak, run.peak);
    pixels += static_cast<std::size_t>(run.length());
  }

  std::pmr::vector<Run> runs;
  float peak = 0;
  std::size_t pixels = 0;
};

// What was cut off some pixels, and its sums. Flux: luminance times solid angle.
struct RegionCut {
  explicit RegionCut(std::pmr::memory_resource* memory)
      : runs(memory), radiance(memory), luminance(memory) {}
  void append(const RegionCut& other) {
    runs.insert(runs.end(), other.runs.begin(), other.runs.end());
    radiance.insert(radiance.end(), other.radiance.begin(), other.radiance.end());
    luminance.insert(luminance.end(), other.luminance.begin(), other.luminance.end());
    power += other.power, moment += other.moment, flux += other.flux;
    clipped |= other.clipped;
  }

  std::pmr::vector<Run> runs;
  std::pmr::vector<Rgb> radiance;     // of their pixels, one after the other
  std::pmr::vector<float> luminance;  // likewise
  glm::dvec3 power{0};                // radiance times solid angle
  glm::dvec3 moment{0};               // sum of flux times direction
  glm::dvec3 centre{0, 1, 0};
  double flux = 0;
  double solid_angle = 0;  // of an even light with the same second moment of radiance
  bool clipped = false;
};

// Of a lat-long map's pixels.
struct PixelDirections {
  int width = 0, height = 0;
  std::vector<double> weight;                  // solid angle of a pixel, by row
  std::vector<std::pair<double, double>> row;  // of a direction: across and up, by row
  std::vector<float> column_x, column_z;       // of it where across is 1, by column
};

const PixelDirections& directions_of(int width, int height) {
  thread_local PixelDirections known;
  if (known.width == width && known.height == height) return known;
  known = {width, height, {}, {}, {}, {}};
  for (int y = 0; y < height; ++y) {
    known.weight.push_back(latlong_solid_angle(y, width, height));
    const glm::dvec3 d = latlong_direction(.5, y + .5, width, height);
    known.row.emplace_back(std::hypot(d.x, d.z), d.y);
  }
  for (int x = 0; x < width; ++x) {
    const glm::dvec3 d = latlong_direction(x + .5, .5 * height, width, height);
    known.column_x.push_back(static_cast<float>(d.x));
    known.column_z.push_back(static_cast<float>(d.z));
  }
  return known;
}

class LightExtractor {
 public:
  LightExtractor(const MapLuminance& luminance, const ExtractionOptions& options,
                 std::span<const std::uint32_t> clipped, LightExtraction& split)
      : luminance_(luminance),
        options_(options),
        clipped_(clipped),
        map_(split.residual),
        lights_(split.lights),
        split_(split),
        grid_(directions_of(map_.width(), map_.height())) {}

  Result<void> run();

 private:
  Result<double> mean() const;
  std::pmr::vector<Run> bright_parts(float level) const;
  double mean_below(double level) const;
  std::pmr::vector<BrightRegion> regions_above(float level);
  std::pmr::vector<BrightRegion> regions_of(std::span<const Run> runs) const;
  std::pmr::vector<Run> runs_above(float level, std::span<const Run> within);
  void extract(const BrightRegion& region, float level);
  double flux_of(const BrightRegion& region) const;
  void cut_clipped(float level);
  void cut(const BrightRegion& region, float level, bool clipped = false);
  void put_back(const RegionCut& candidate);
  std::pmr::vector<EnergyPiece> fractions_of(const RegionCut& candidate) const;
  DistantLight::Shape shape_of(const RegionCut& candidate) const;
  void join_concentric();
  void choose();

  Scratch::Scope scope_;
  std::pmr::memory_resource* const memory_ = scope_.memory();
  const MapLuminance& luminance_;
  const ExtractionOptions& options_;
  std::span<const std::uint32_t> clipped_;
  RowOverlay& map_;
  std::vector<DistantLight>& lights_;
  LightExtraction& split_;
  const PixelDirections& grid_;
  std::pmr::vector<RegionCut> candidates_{memory_};
  // Of part of a row.
  std::pmr::vector<float> brightness_{static_cast<std::size_t>(map_.width()), memory_};
  double min_flux_ = 0;
};

Result<double> LightExtractor::mean() const {
  double mean = 0;
  for (int y = 0; y < map_.height(); ++y) {
    const double sum = luminance_.row_sum[static_cast<std::size_t>(y)];
    if (!std::isfinite(sum))
      return fail(ErrorCode::kNonFinite, "environment", "holds NaN or infinite radiance");
    mean += grid_.weight[static_cast<std::size_t>(y)] * sum / (4 * kPi);
  }
  return mean;
}

// The parts of rows whose blocks reach above the level.
std::pmr::vector<Run> LightExtractor::bright_parts(float level) const {
  std::pmr::vector<Run> parts(memory_);
  auto peak = luminance_.block_peak.begin();
  for (int y = 0; y < map_.height(); ++y)
    for (int x = 0; x < map_.width(); x += kPeakBlock) {
      if (!(*peak++ > level)) continue;
      const int end = std::min(x + kPeakBlock, map_.width());
      if (!parts.empty() && parts.back().y == y && parts.back().x1 == x)
        parts.back().x1 = end;
      else
        parts.push_back({y, x, end});
    }
  return parts;
}

// Mean of the map with everything above the level cut down to it.
double LightExtractor::mean_below(double level) const {
  double mean = split_.mean_luminance;
  for (const Run& r : bright_parts(static_cast<float>(level)))
    mean -= grid_.weight[static_cast<std::size_t>(r.y)] *
            row_luminance_above(&map_.at(r.x0, r.y).r, r.length(), static_cast<float>(level)) /
            (4 * kPi);
  return std::max(0., mean);  // of a map that is black but for its sources, but for rounding
}

std::pmr::vector<Run> LightExtractor::runs_above(float level, std::span<const Run> within) {
  std::pmr::vector<Run> runs(memory_);
  for (const Run& r : within) {
    pixel_luminance(&map_.at(r.x0, r.y).r, r.length(), brightness_.data());
    const float* const l = brightness_.data();
    const int n = r.length();
    for (int k = 0; k < n; ++k) {
      if (!(l[k] > level)) continue;
      const int first = k;
      while (k < n && l[k] > level) ++k;
      runs.push_back(run_of(r.y, r.x0 + first, r.x0 + k, l + first));
    }
  }
  return runs;
}

std::pmr::vector<BrightRegion> LightExtractor::regions_above(float level) {
  return regions_of(runs_above(level, bright_parts(level)));
}

// Runs touch when they overlap, diagonals counted, in one row or two neighbouring ones; around the
// seam; and all pixels of the first row, or the last, meet at the pole.
std::pmr::vector<BrightRegion> LightExtractor::regions_of(std::span<const Run> runs) const {
  DisjointSets sets(runs.size(), memory_);
  const int width = map_.width();
  const auto touch = [&](const Run& a, const Run& b) {
    for (const int shift : {-width, 0, width})
      if (a.x0 + shift <= b.x1 && b.x0 <= a.x1 + shift) return true;
    return false;
  };
  std::size_t row_start = 0, previous_start = 0;
  for (std::size_t i = 0; i < runs.size(); ++i) {
    if (i > 0 && runs[i].y != runs[i - 1].y) previous_start = row_start, row_start = i;
    const bool at_pole = runs[i].y == 0 || runs[i].y == map_.height() - 1;
    for (std::size_t k = row_start; k < i; ++k)
      if (at_pole || touch(runs[i], runs[k])) sets.join(i, k);
    if (row_start == 0 || runs[previous_start].y != runs[i].y - 1) continue;
    for (std::size_t k = previous_start; k < row_start; ++k)
      if (touch(runs[i], runs[k])) sets.join(i, k);
  }
  std::pmr::vector<BrightRegion> regions(memory_);
  regions.reserve(runs.size());
  for (std::size_t i = 0; i < runs.size(); ++i) regions.emplace_back();
  for (std::size_t i = 0; i < runs.size(); ++i) regions[sets.find(i)].add(runs[i]);
  std::erase_if(regions, [](const BrightRegion& r) { return r.runs.empty(); });
  return regions;
}

void LightExtractor::extract(const BrightRegion& region, float level) {
  if (region.peak > kStep * level) {
    const float core = kCoreLevel * region.peak;
    for (const BrightRegion& part : regions_of(runs_above(core, region.runs))) cut(part, level);
    // What is left reaches up to the core's level at most.
    for (BrightRegion& part : regions_of(runs_above(level, region.runs)))
      part.peak < region.peak ? extract(part, level) : cut(part, level);
    return;
  }
  cut(region, level);
}

double LightExtractor::flux_of(const BrightRegion& region) const {
  double sum = 0;
  for (const Run& r : region.runs) sum += grid_.weight[static_cast<std::size_t>(r.y)] * r.sum;
  return sum;
}

// Clipped pixels come first, so that the light is where they are and what they lack is not spread
// over the glow around them. Down to half of their own mean where that is not six times the rest.
void LightExtractor::cut_clipped(float level) {
  std::pmr::vector<Run> parts(memory_);
  const int width = std::max(1, map_.width());
  for (const std::uint32_t i : clipped_) {
    const int y = static_cast<int>(i) / width, x = static_cast<int>(i) % width;
    if (parts.empty() || parts.back().y != y || parts.back().x1 != x) parts.push_back({y, x, x});
    ++parts.back().x1;
  }
  constexpr float kAll = -std::numeric_limits<float>::infinity();
  const std::pmr::vector<Run> runs = runs_above(kAll, parts);
  for (const BrightRegion& region : regions_of(runs)) {
    double solid_angle = 0;
    for (const Run& r : region.runs)
      solid_angle += grid_.weight[static_cast<std::size_t>(r.y)] * r.length();
    if (solid_angle > 0)
      cut(region, std::min(level, static_cast<float>(.5 * flux_of(region) / solid_angle)), true);
  }
}

// Cuts the region down to the level and turns what was above into a candidate. The level, not a
// fraction of the region's own mean: a window that dims slowly then leaves the list with nothing
// left in it.
void LightExtractor::cut(const BrightRegion& region, float level, bool clipped) {
  RegionCut c(memory_);
  c.runs.assign(region.runs.begin(), region.runs.end());
  c.radiance.resize(region.pixels);
  c.luminance.resize(region.pixels);
  c.clipped = clipped;
  double square = 0;  // of luminance in its unit, times solid angle
  const float unit = std::max(region.peak, std::numeric_limits<float>::min());
  std::size_t first = 0;
  for (const Run& r : region.runs) {
    CutSums sums;
    const auto x0 = static_cast<std::size_t>(r.x0);
    cut_row(&map_.row_to_change(r.y)[x0].r, r.length(), level, unit, &grid_.column_x[x0],
            &grid_.column_z[x0], &c.radiance[first].r, &c.luminance[first], sums);
    first += static_cast<std::size_t>(r.length());
    const auto [across, up] = grid_.row[static_cast<std::size_t>(r.y)];
    const double weight = grid_.weight[static_cast<std::size_t>(r.y)];
    const glm::dvec3 rgb(sums.rgb[0], sums.rgb[1], sums.rgb[2]);
    const double sum = glm::dot(rgb, {kLuminance[0], kLuminance[1], kLuminance[2]});
    c.power += weight * rgb;
    c.flux += weight * sum;
    c.moment += weight * glm::dvec3(across * sums.x, up * sum, across * sums.z);
    square += weight * sums.square;
  }
  if (!(c.flux > (clipped ? 0 : min_flux_))) {
    put_back(c);
    return;
  }
  const double flux_in_units = c.flux / static_cast<double>(unit);
  c.solid_angle = std::min(2 * kPi, flux_in_units * flux_in_units / square);
  const double length = glm::length(c.moment);
  if (length > 1e-9 * c.flux) c.centre = c.moment / length;
  candidates_.push_back(std::move(c));
}

void LightExtractor::put_back(const RegionCut& c) {
  auto radiance = c.radiance.begin();
  for (const Run& r : c.runs)
    for (Rgb& pixel : map_.row_to_change(r.y).subspan(static_cast<std::size_t>(r.x0),
                                                      static_cast<std::size_t>(r.length())))
      pixel += *radiance++;
}

// Of blocks of pixels: a thousand pieces are plenty for 64 points.
std::pmr::vector<EnergyPiece> LightExtractor::fractions_of(const RegionCut& c) const {
  const int block = 1 + static_cast<int>(std::sqrt(static_cast<double>(c.luminance.size()) / 1000));
  std::pmr::vector<EnergyPiece> pieces(memory_),
      across_blocks(static_cast<std::size_t>(map_.width() / block + 1), memory_);
  std::pmr::vector<std::size_t> touched(memory_);  // of `across_blocks`, in this row of blocks
  pieces.reserve(4096);
  touched.reserve(across_blocks.size());
  const auto end_row = [&] {
    for (const std::size_t column : touched) {
      EnergyPiece& sum = across_blocks[column];
      if (sum.weight > 0) pieces.push_back({sum.weight, sum.direction / sum.weight});
      sum = {};
    }
    touched.clear();
  };
  auto luminance = c.luminance.begin();
  int y = -1;
  for (const Run& r : c.runs) {
    if (r.y / block != y / block) end_row();
    y = r.y;
    const auto [across, up] = grid_.row[static_cast<std::size_t>(y)];
    const double weight = grid_.weight[static_cast<std::size_t>(y)];
    for (int x = r.x0; x < r.x1;) {
      const int column = x / block, end = std::min(r.x1, (column + 1) * block);
      glm::vec3 sum(0);  // of luminance, and times what the column's direction has
      for (; x < end; ++x, ++luminance)
        sum += *luminance * glm::vec3(1, grid_.column_x[static_cast<std::size_t>(x)],
                                      grid_.column_z[static_cast<std::size_t>(x)]);
      EnergyPiece& piece = across_blocks[static_cast<std::size_t>(column)];
      if (piece.weight == 0) touched.push_back(static_cast<std::size_t>(column));
      piece.weight += weight * double(sum.x);
      piece.direction +=
          weight * glm::dvec3(across * double(sum.y), up * double(sum.x), across * double(sum.z));
    }
  }
  end_row();
  return pieces;
}

// Where the energy lies when a round light would misplace it.
DistantLight::Shape LightExtractor::shape_of(const RegionCut& c) const {
  // Mean square distance from the centre; of an even light of that solid angle: a^2/2 with pi a^2 =
  // the solid angle.
  const double spread = 2 - 2 * glm::dot(c.moment, c.centre) / c.flux;
  const double roundness = c.solid_angle < kLarge ? kRoundness : kRoundnessOfLarge;
  const bool is_round = spread < roundness * c.solid_angle / (2 * kPi);
  if (is_round || spread < kSmall * kSmall) return {};
  std::pmr::vector<EnergyPiece> pieces = fractions_of(c);
  return shape_points(pieces);
}

// The steps of one small source (a sun and its glow within a degree) are one light: its second
// moment is the mean of theirs.
void LightExtractor::join_concentric() {
  for (std::size_t i = 0; i < candidates_.size(); ++i)
    for (std::size_t k = candidates_.size(); k-- > i + 1;) {
      RegionCut &a = candidates_[i], &b = candidates_[k];
      const double apart = std::acos(std::clamp(glm::dot(a.centre, b.centre), -1., 1.));
      if (apart > kOneSource ||
          std::max(a.solid_angle, b.solid_angle) > kPi * kOneSource * kOneSource)
        continue;
      a.solid_angle = (a.flux * a.solid_angle + b.flux * b.solid_angle) / (a.flux + b.flux);
      a.centre = glm::normalize(a.flux * a.centre + b.flux * b.centre);
      a.append(b);
      candidates_.erase(candidates_.begin() + static_cast<std::ptrdiff_t>(k));
    }
}

// The strongest become lights, clipped ones first of all; the others go back into the map.
void LightExtractor::choose() {
  std::ranges::sort(candidates_, std::greater<>(), &RegionCut::flux);
  join_concentric();
  std::ranges::sort(candidates_, std::greater<>(), &RegionCut::flux);
  const auto clipped = static_cast<int>(std::ranges::count_if(candidates_, &RegionCut::clipped));
  int for_clipped = std::min(clipped, options_.max_count),
      for_others = options_.max_count - for_clipped;
  for (const RegionCut& c : candidates_) {
    int& places = c.clipped ? for_clipped : for_others;
    if ((c.flux < min_flux_ && !c.clipped) || places <= 0) {
      put_back(c);
      continue;
    }
    --places;
    DistantLight source;
    source.direction = c.centre;
    source.radius = Radians(std::acos(1 - c.solid_angle / (2 * kPi)));
    for (int k = 0; k < 3; ++k) source.radiance[k] = static_cast<float>(c.power[k] / c.solid_angle);
    source.shape = shape_of(c);
    source.clipped = c.clipped;
    lights_.push_back(source);
  }
}

Result<void> LightExtractor::run() {
  lights_.clear();
  PENUMBRA_ASSIGN(whole, mean());
  split_.mean_luminance = whole;
  if (!(whole > 0)) return {};
  const double shown = 1 / std::clamp(options_.coverage, 1e-3, 1.);
  min_flux_ = options_.min_irradiance_fraction * kPi * whole * shown;
  // The mean of what is not a source: three steps bring it within a percent.
  double residual = whole;
  for (int i = 0; i < 3; ++i) residual = mean_below(kAboveMean * shown * residual);
  const auto level = static_cast<float>(kAboveMean * shown * residual);
  if (!clipped_.empty()) cut_clipped(level);
  auto regions = regions_above(level);
  std::pmr::vector<std::pair<double, const BrightRegion*>> order(memory_);
  for (const BrightRegion& region : regions) order.emplace_back(-flux_of(region), &region);
  std::ranges::sort(order, {}, &std::pair<double, const BrightRegion*>::first);
  for (const auto& [negative_flux, region] : order) {
    if (-negative_flux < min_flux_) break;
    extract(*region, level);
  }
  choose();
  return {};
}

}  // namespace

Result<void> extract_lights(const Image<Rgb>& map, const MapLuminance& luminance,
                            const ExtractionOptions& options, LightExtraction& split,
                            std::span<const std::uint32_t> clipped) {
  if (map.empty()) return fail(ErrorCode::kInvalid, "environment", "has no pixels");
  if (!std::ranges::is_sorted(clipped) || (!clipped.empty() && clipped.back() >= map.area()))
    return fail(ErrorCode::kInvalid, "environment",
                "has a list of clipped pixels that is out of order or points outside the map");
  assert(luminance.is_of(map));
  split.residual.reset(map);
  return LightExtractor(luminance, options, clipped, split).run();
}

Result<void> extract_lights(const Image<Rgb>& map, const ExtractionOptions& options,
                            LightExtraction& split, std::span<const std::uint32_t> clipped) {
  MapLuminance luminance;
  luminance.resize(map.width(), map.height());
  for (int y = 0; y < map.height(); ++y) luminance.read_row(map, y);
  return extract_lights(map, luminance, options, split, clipped);
}

}  // namespace penumbra::lighting
