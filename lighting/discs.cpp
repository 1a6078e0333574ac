#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/scratch.h"
#include "lighting/disc_shape.h"
#include "lighting/latlong_kernel.h"
#include "lighting/lighting.h"

namespace penumbra::lighting {

namespace {

constexpr float kAboveMean = 6;     // a source is brighter than this times the mean of the rest
constexpr float kStep = 300;        // regions with a larger range than this are peeled core first
constexpr double kRoundness = 1.2;  // of a 1.8:1 rectangle
constexpr double kOneSource = .02;  // radians
constexpr double kSmall = .01;  // radians: the form of smaller sources cannot be seen in a shadow
constexpr float kCoreLevel = .01f;  // of the peak: where the core of such a region ends

// Temporaries come from the thread's scratch memory.
template <class T>
using Vector = std::pmr::vector<T>;

// Pixels [x0, x1) of row y.
struct Run {
  int y, x0, x1;
  float peak = 0;  // of luminance
  double sum = 0;  // of luminance
  int length() const { return x1 - x0; }
};

// The one after its last.
void add_pixel(float luminance, Run& run) {
  ++run.x1;
  run.peak = std::max(run.peak, luminance);
  run.sum += luminance;
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
  Vector<std::size_t> parent_;
};

struct Region {
  using allocator_type = std::pmr::polymorphic_allocator<>;
  Region(const allocator_type& memory) : runs(memory) {}
  Region(Region&&) = default;
  Region(Region&& other, const allocator_type& memory)
      : runs(std::move(other.runs), memory), peak(other.peak), pixels(other.pixels) {}
  Region& operator=(Region&&) = default;
  void add(const Run& run) {
    runs.push_back(run);
    peak = std::max(peak, run.peak);
    pixels += static_cast<std::size_t>(run.length());
  }

  Vector<Run> runs;
  float peak = 0;
  std::size_t pixels = 0;
};

// What was cut off a pixel.
struct Excess {
  int x, y;
  Rgb radiance;
  double flux;  // luminance times solid angle
};

struct Candidate {
  Vector<Excess> pixels;
  glm::dvec3 centre, moment;  // moment: sum of flux times direction
  double flux;
  double solid_angle;  // of an even disc with the same second moment of radiance
  bool clipped;
};

// Of a lat-long map's pixels.
struct Directions {
  int width = 0, height = 0;
  std::vector<double> weight;                  // solid angle of a pixel, by row
  std::vector<std::pair<double, double>> row;  // of a direction: across and up, by row
  std::vector<glm::dvec2> column;              // its x and z where across is 1, by column
};

const Directions& directions_of(int width, int height) {
  thread_local Directions known;
  if (known.width == width && known.height == height) return known;
  known = {width, height, {}, {}, {}};
  for (int y = 0; y < height; ++y) {
    known.weight.push_back(latlong_solid_angle(y, width, height));
    const glm::dvec3 d = latlong_direction(.5, y + .5, width, height);
    known.row.emplace_back(std::hypot(d.x, d.z), d.y);
  }
  for (int x = 0; x < width; ++x) {
    const glm::dvec3 d = latlong_direction(x + .5, .5 * height, width, height);
    known.column.emplace_back(d.x, d.z);
  }
  return known;
}

class Peeler {
 public:
  Peeler(const DiscOptions& options, std::span<const std::uint32_t> clipped, DiscSplit& split)
      : options_(options),
        clipped_(clipped),
        map_(split.rest),
        discs_(split.discs),
        split_(split),
        grid_(directions_of(map_.width(), map_.height())) {}

  Result<void> run();

 private:
  glm::dvec3 direction(int x, int y) const {
    const auto [across, up] = grid_.row[static_cast<std::size_t>(y)];
    const glm::dvec2& around = grid_.column[static_cast<std::size_t>(x)];
    return {across * around.x, up, across * around.y};
  }
  Result<double> measure();
  Vector<Run> bright_parts(float level) const;
  double mean_below(double level) const;
  Vector<Region> regions_above(float level) const;
  Vector<Region> regions_of(std::span<const Run> runs) const;
  Vector<Run> runs_above(float level, std::span<const Run> within) const;
  void peel(const Region& region, float level);
  double flux_of(const Region& region) const;
  void cut_clipped(float level);
  void cut(const Region& region, float level, bool clipped = false);
  void add_candidate(Vector<Excess> pixels, bool clipped);
  void put_back(std::span<const Excess> pixels);
  Vector<Share> shares_of(const Candidate& candidate) const;
  std::vector<glm::dvec3> shape_of(const Candidate& candidate) const;
  void join_concentric();
  void choose();

  Scratch::Scope scope_;
  std::pmr::memory_resource* const memory_ = scope_.memory();
  const DiscOptions& options_;
  std::span<const std::uint32_t> clipped_;
  PatchedMap& map_;
  std::vector<Disc>& discs_;
  DiscSplit& split_;
  const Directions& grid_;
  Vector<float> block_peak_{memory_};  // by row, kPeakBlock pixels each
  Vector<Candidate> candidates_{memory_};
  double least_flux_ = 0;
};

// The brightest luminance of each block. Returns the mean.
Result<double> Peeler::measure() {
  const std::size_t blocks = static_cast<std::size_t>(map_.width() + kPeakBlock - 1) / kPeakBlock;
  block_peak_.assign(blocks * static_cast<std::size_t>(map_.height()), 0);
  double mean = 0;
  for (int y = 0; y < map_.height(); ++y) {
    const double sum = row_luminance(&map_.row(y)[0].r, map_.width(),
                                     &block_peak_[static_cast<std::size_t>(y) * blocks]);
    if (!std::isfinite(sum))
      return fail(ErrorCode::kNonFinite, "environment", "holds NaN or infinite radiance");
    mean += grid_.weight[static_cast<std::size_t>(y)] * sum / (4 * kPi);
  }
  return mean;
}

// The parts of rows whose blocks reach above the level.
Vector<Run> Peeler::bright_parts(float level) const {
  Vector<Run> parts(memory_);
  auto peak = block_peak_.begin();
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
double Peeler::mean_below(double level) const {
  double mean = split_.mean_luminance;
  for (const Run& r : bright_parts(static_cast<float>(level)))
    mean -= grid_.weight[static_cast<std::size_t>(r.y)] *
            row_luminance_above(&map_.at(r.x0, r.y).r, r.length(), static_cast<float>(level)) /
            (4 * kPi);
  return std::max(0., mean);  // of a map that is black but for its sources, but for rounding
}

Vector<Run> Peeler::runs_above(float level, std::span<const Run> within) const {
  Vector<Run> runs(memory_);
  for (const Run& r : within) {
    const auto row = map_.row(r.y);
    bool open = false;
    for (int x = r.x0; x < r.x1; ++x) {
      const float l = luminance(row[static_cast<std::size_t>(x)]);
      if (!(l > level)) {
        open = false;
        continue;
      }
      if (!open) runs.push_back({r.y, x, x});
      open = true;
      add_pixel(l, runs.back());
    }
  }
  return runs;
}

Vector<Region> Peeler::regions_above(float level) const {
  return regions_of(runs_above(level, bright_parts(level)));
}

// Runs touch when they overlap, diagonals counted, in one row or two neighbouring ones; around the seam; and
// all pixels of the first row, or the last, meet at the pole.
Vector<Region> Peeler::regions_of(std::span<const Run> runs) const {
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
  Vector<Region> regions(memory_);
  regions.reserve(runs.size());
  for (std::size_t i = 0; i < runs.size(); ++i) regions.emplace_back();
  for (std::size_t i = 0; i < runs.size(); ++i) regions[sets.find(i)].add(runs[i]);
  std::erase_if(regions, [](const Region& r) { return r.runs.empty(); });
  return regions;
}

void Peeler::peel(const Region& region, float level) {
  if (region.peak > kStep * level) {
    const float core = kCoreLevel * region.peak;
    for (const Region& part : regions_of(runs_above(core, region.runs))) cut(part, level);
    // What is left reaches up to the core's level at most.
    for (Region& part : regions_of(runs_above(level, region.runs)))
      part.peak < region.peak ? peel(part, level) : cut(part, level);
    return;
  }
  cut(region, level);
}

double Peeler::flux_of(const Region& region) const {
  double sum = 0;
  for (const Run& r : region.runs) sum += grid_.weight[static_cast<std::size_t>(r.y)] * r.sum;
  return sum;
}

// Clipped pixels come first, so that the disc is where they are and what they lack is not spread
// over the glow around them. Down to half of their own mean where that is not six times the rest.
void Peeler::cut_clipped(float level) {
  Vector<Run> runs(memory_);
  for (const std::uint32_t i : clipped_) {
    const int y = static_cast<int>(i) / map_.width(), x = static_cast<int>(i) % map_.width();
    if (runs.empty() || runs.back().y != y || runs.back().x1 != x) runs.push_back({y, x, x});
    add_pixel(luminance(map_.at(x, y)), runs.back());
  }
  for (const Region& region : regions_of(runs)) {
    double solid_angle = 0;
    for (const Run& r : region.runs)
      solid_angle += grid_.weight[static_cast<std::size_t>(r.y)] * r.length();
    cut(region, std::min(level, static_cast<float>(.5 * flux_of(region) / solid_angle)), true);
  }
}

// Cuts the region down to the level and turns what was above into a candidate. The level, not a share of the
// region's own mean: a window that dims slowly then leaves the list with nothing left in it.
void Peeler::cut(const Region& region, float level, bool clipped) {
  Vector<Excess> above(memory_);
  above.reserve(region.pixels);
  for (const Run& r : region.runs) {
    const std::span<Rgb> row = map_.row_to_change(r.y);
    const double weight = grid_.weight[static_cast<std::size_t>(r.y)];
    for (int x = r.x0; x < r.x1; ++x) {
      Rgb& c = row[static_cast<std::size_t>(x)];
      const float l = luminance(c);
      if (!(l > level)) continue;
      const float kept = level / l;
      const Rgb excess = c * (1 - kept);
      above.push_back({x, r.y, excess, weight * luminance(excess)});
      c = c * kept;
    }
  }
  add_candidate(std::move(above), clipped);
}

void Peeler::add_candidate(Vector<Excess> pixels, bool clipped) {
  double flux = 0, square = 0;  // square: of luminance, times solid angle
  glm::dvec3 moment(0);
  for (const Excess& p : pixels) {
    flux += p.flux;
    square += p.flux * p.flux / grid_.weight[static_cast<std::size_t>(p.y)];
    moment += p.flux * direction(p.x, p.y);
  }
  if (!(flux > (clipped ? 0 : least_flux_))) {
    put_back(pixels);
    return;
  }
  const double cap = std::min(2 * kPi, flux * flux / square), length = glm::length(moment);
  const glm::dvec3 centre = length > 1e-9 * flux ? moment / length : glm::dvec3(0, 1, 0);
  candidates_.push_back({std::move(pixels), centre, moment, flux, cap, clipped});
}

void Peeler::put_back(std::span<const Excess> pixels) {
  for (const Excess& p : pixels)
    map_.row_to_change(p.y)[static_cast<std::size_t>(p.x)] += p.radiance;
}

// Of blocks of pixels: a thousand shares are plenty for 64 points.
Vector<Share> Peeler::shares_of(const Candidate& c) const {
  const int block = 1 + static_cast<int>(std::sqrt(static_cast<double>(c.pixels.size()) / 1000));
  Vector<Share> shares(memory_), across(static_cast<std::size_t>(map_.width()), memory_);
  Vector<std::size_t> touched(memory_);  // of `across`, in this row of blocks
  shares.reserve(4096);
  touched.reserve(across.size());
  const auto end_row = [&] {
    for (const std::size_t column : touched) {
      Share& sum = across[column];
      shares.push_back({sum.weight, sum.direction / sum.weight});
      sum = {};
    }
    touched.clear();
  };
  Vector<std::size_t> column_of(memory_);  // a division for each pixel would take half of the time
  for (int x = 0; x < map_.width(); ++x) column_of.push_back(static_cast<std::size_t>(x / block));
  int y = -1;
  for (const Excess& p : c.pixels) {
    if (!(p.flux > 0)) continue;
    if (p.y != y && p.y / block != y / block) end_row();
    y = p.y;
    const std::size_t column = column_of[static_cast<std::size_t>(p.x)];
    Share& sum = across[column];
    if (sum.weight == 0) touched.push_back(column);
    sum.weight += p.flux, sum.direction += p.flux * direction(p.x, p.y);
  }
  end_row();
  return shares;
}

// Where the energy lies when a round disc would misplace it.
std::vector<glm::dvec3> Peeler::shape_of(const Candidate& c) const {
  // Mean square distance from the centre; of an even disc of that solid angle: a^2/2 with pi a^2 = the solid angle.
  const double spread = 2 - 2 * glm::dot(c.moment, c.centre) / c.flux;
  if (spread < kRoundness * c.solid_angle / (2 * kPi) || spread < kSmall * kSmall) return {};
  Vector<Share> shares = shares_of(c);
  return shape_points(shares);
}

// The steps of one small source (a sun and its glow within a degree) are one disc: its second moment is the
// mean of theirs.
void Peeler::join_concentric() {
  for (std::size_t i = 0; i < candidates_.size(); ++i)
    for (std::size_t k = candidates_.size(); k-- > i + 1;) {
      Candidate &a = candidates_[i], &b = candidates_[k];
      const double apart = std::acos(std::clamp(glm::dot(a.centre, b.centre), -1., 1.));
      if (apart > kOneSource ||
          std::max(a.solid_angle, b.solid_angle) > kPi * kOneSource * kOneSource)
        continue;
      const double flux = a.flux + b.flux;
      a.solid_angle = (a.flux * a.solid_angle + b.flux * b.solid_angle) / flux;
      a.centre = glm::normalize(a.flux * a.centre + b.flux * b.centre);
      a.moment += b.moment;
      a.flux = flux;
      a.clipped |= b.clipped;
      a.pixels.insert(a.pixels.end(), b.pixels.begin(), b.pixels.end());
      candidates_.erase(candidates_.begin() + static_cast<std::ptrdiff_t>(k));
    }
}

// The strongest become discs, clipped ones first of all; the others go back into the map.
void Peeler::choose() {
  std::ranges::sort(candidates_, std::greater<>(), &Candidate::flux);
  join_concentric();
  std::ranges::sort(candidates_, std::greater<>(), &Candidate::flux);
  const auto clipped = static_cast<int>(std::ranges::count_if(candidates_, &Candidate::clipped));
  int for_clipped = std::min(clipped, options_.most), for_others = options_.most - for_clipped;
  for (const Candidate& c : candidates_) {
    int& places = c.clipped ? for_clipped : for_others;
    if ((c.flux < least_flux_ && !c.clipped) || places <= 0) {
      put_back(c.pixels);
      continue;
    }
    --places;
    double rgb[3] = {};
    for (const Excess& p : c.pixels)
      for (int k = 0; k < 3; ++k)
        rgb[k] += grid_.weight[static_cast<std::size_t>(p.y)] * p.radiance[k];
    Disc disc;
    disc.direction = c.centre;
    disc.radius = Radians(std::acos(1 - c.solid_angle / (2 * kPi)));
    for (int k = 0; k < 3; ++k) disc.radiance[k] = static_cast<float>(rgb[k] / c.solid_angle);
    disc.shape = shape_of(c);
    disc.clipped = c.clipped;
    discs_.push_back(std::move(disc));
  }
}

Result<void> Peeler::run() {
  discs_.clear();
  auto mean = measure();
  if (!mean) return std::unexpected(mean.error());
  split_.mean_luminance = *mean;
  if (!(*mean > 0)) return {};
  least_flux_ = options_.least_share * kPi * *mean;
  // The mean of what is not a source: three steps bring it within a percent.
  double rest = *mean;
  for (int i = 0; i < 3; ++i) rest = mean_below(kAboveMean * rest);
  const auto level = static_cast<float>(kAboveMean * rest);
  if (!clipped_.empty()) cut_clipped(level);
  auto regions = regions_above(level);
  Vector<std::pair<double, const Region*>> order(memory_);
  for (const Region& region : regions) order.emplace_back(-flux_of(region), &region);
  std::ranges::sort(order, {}, &std::pair<double, const Region*>::first);
  for (const auto& [negative_flux, region] : order) {
    if (-negative_flux < least_flux_) break;
    peel(*region, level);
  }
  choose();
  return {};
}

}  // namespace

Result<void> split_discs(const Image<Rgb>& map, const DiscOptions& options, DiscSplit& split,
                         std::span<const std::uint32_t> clipped) {
  if (map.empty()) return fail(ErrorCode::kInvalid, "environment", "has no pixels");
  if (!std::ranges::is_sorted(clipped) || (!clipped.empty() && clipped.back() >= map.area()))
    return fail(ErrorCode::kInvalid, "environment",
                "its clipped pixels are out of order or outside");
  split.rest.reset(map);
  return Peeler(options, clipped, split).run();
}

}  // namespace penumbra::lighting
