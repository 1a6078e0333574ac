#include <Eigen/Eigenvalues>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/scratch.h"
#include "lighting/latlong_kernel.h"
#include "lighting/lighting.h"

namespace penumbra::lighting {

namespace {

constexpr float kAboveMean = 6;     // a source is brighter than this times the mean of the rest
constexpr float kStep = 300;        // regions with a larger range than this are peeled core first
constexpr double kRoundness = 1.2;  // of a 1.8:1 rectangle
constexpr double kOneSource = .02;  // radians
constexpr double kSmall = .01;  // radians: the form of smaller sources cannot be seen in a shadow
constexpr int kShapeDepth = 6;  // 2^6 = Disc::kShapePoints
constexpr float kCoreLevel = .01f;  // of the peak: where the core of such a region ends

// Temporaries come from the thread's scratch memory.
template <class T>
using Vector = std::pmr::vector<T>;

// Pixels [x0, x1) of row y that are brighter than the level.
struct Run {
  int y, x0, x1;
};

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
      : runs(std::move(other.runs), memory), peak(other.peak) {}
  Region& operator=(Region&&) = default;

  Vector<Run> runs;
  float peak = 0;
};

// What was cut off a pixel.
struct Excess {
  int x, y;
  Rgb radiance;
  glm::dvec3 direction;
};

struct Share {
  double weight = 0;
  glm::dvec3 direction{0};
};

struct Candidate {
  Vector<Excess> pixels;
  glm::dvec3 centre;
  double flux;         // luminance times solid angle
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
            row_luminance_above(&map_.at(r.x0, r.y).r, r.x1 - r.x0, static_cast<float>(level)) /
            (4 * kPi);
  return std::max(0., mean);  // of a map that is black but for its sources, but for rounding
}

Vector<Run> Peeler::runs_above(float level, std::span<const Run> within) const {
  Vector<Run> runs(memory_);
  for (const Run& r : within) {
    const auto row = map_.row(r.y);
    for (int x = r.x0; x < r.x1;) {
      if (!(luminance(row[static_cast<std::size_t>(x)]) > level)) {
        ++x;
        continue;
      }
      const int start = x;
      while (x < r.x1 && luminance(row[static_cast<std::size_t>(x)]) > level) ++x;
      runs.push_back({r.y, start, x});
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
  for (std::size_t i = 0; i < runs.size(); ++i) {
    Region& region = regions[sets.find(i)];
    region.runs.push_back(runs[i]);
    for (int x = runs[i].x0; x < runs[i].x1; ++x)
      region.peak = std::max(region.peak, luminance(map_.at(x, runs[i].y)));
  }
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
  for (const Run& r : region.runs)
    for (int x = r.x0; x < r.x1; ++x)
      sum += grid_.weight[static_cast<std::size_t>(r.y)] * luminance(map_.at(x, r.y));
  return sum;
}

// Clipped pixels come first, so that the disc is where they are and what they lack is not spread
// over the glow around them. Down to half of their own mean where that is not six times the rest.
void Peeler::cut_clipped(float level) {
  Vector<Run> runs(memory_);
  for (const std::uint32_t i : clipped_) {
    const int y = static_cast<int>(i) / map_.width(), x = static_cast<int>(i) % map_.width();
    if (!runs.empty() && runs.back().y == y && runs.back().x1 == x)
      ++runs.back().x1;
    else
      runs.push_back({y, x, x + 1});
  }
  for (const Region& region : regions_of(runs)) {
    double solid_angle = 0;
    for (const Run& r : region.runs)
      solid_angle += grid_.weight[static_cast<std::size_t>(r.y)] * (r.x1 - r.x0);
    cut(region, std::min(level, static_cast<float>(.5 * flux_of(region) / solid_angle)), true);
  }
}

// Cuts the region down to the level and turns what was above into a candidate. The level, not a share of the
// region's own mean: a window that dims slowly then leaves the list with nothing left in it.
void Peeler::cut(const Region& region, float level, bool clipped) {
  Vector<Excess> above(memory_);
  for (const Run& r : region.runs) {
    const std::span<Rgb> row = map_.row_to_change(r.y);
    for (int x = r.x0; x < r.x1; ++x) {
      Rgb& c = row[static_cast<std::size_t>(x)];
      const float l = luminance(c);
      if (!(l > level)) continue;
      above.push_back({x, r.y, c * (1 - level / l), direction(x, r.y)});
      c = c * (level / l);
    }
  }
  add_candidate(std::move(above), clipped);
}

void Peeler::add_candidate(Vector<Excess> pixels, bool clipped) {
  double flux = 0, square = 0;
  glm::dvec3 centre(0);
  for (const Excess& p : pixels) {
    const double w = grid_.weight[static_cast<std::size_t>(p.y)], l = luminance(p.radiance);
    flux += w * l;
    square += w * l * l;
    centre += w * l * p.direction;
  }
  if (!(flux > (clipped ? 0 : least_flux_))) {
    put_back(pixels);
    return;
  }
  const double cap = std::min(2 * kPi, flux * flux / square), length = glm::length(centre);
  const glm::dvec3 direction = length > 1e-9 * flux ? centre / length : glm::dvec3(0, 1, 0);
  candidates_.push_back({std::move(pixels), direction, flux, cap, clipped});
}

void Peeler::put_back(std::span<const Excess> pixels) {
  for (const Excess& p : pixels)
    map_.row_to_change(p.y)[static_cast<std::size_t>(p.x)] += p.radiance;
}

// Equal shares of the energy, by halving across the longest axis six times.
void halve(std::span<Share> shares, int depth, std::vector<glm::dvec3>& out) {
  double weight = 0;
  glm::dvec3 mean(0);
  for (const Share& s : shares) weight += s.weight, mean += s.weight * s.direction;
  mean = mean / weight;
  if (depth == 0 || shares.size() < 2) {
    out.insert(out.end(), std::size_t{1} << depth, glm::normalize(mean));
    return;
  }
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
  for (const Share& s : shares) {
    const glm::dvec3 d = s.direction - mean;
    const Eigen::Vector3d v(d.x, d.y, d.z);
    spread += s.weight * v * v.transpose();
  }
  const Eigen::Vector3d axis =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(spread).eigenvectors().col(2);
  std::ranges::sort(shares, {}, [&](const Share& s) {
    return axis.dot(Eigen::Vector3d(s.direction.x, s.direction.y, s.direction.z));
  });
  std::size_t middle = 0;
  for (double sum = 0; sum + .5 * shares[middle].weight < .5 * weight; ++middle)
    sum += shares[middle].weight;
  middle = std::clamp<std::size_t>(middle, 1, shares.size() - 1);
  halve(shares.first(middle), depth - 1, out);
  halve(shares.subspan(middle), depth - 1, out);
}

// Where the energy lies when a round disc would misplace it.
std::vector<glm::dvec3> Peeler::shape_of(const Candidate& c) const {
  double spread = 0;
  for (const Excess& p : c.pixels)
    spread += grid_.weight[static_cast<std::size_t>(p.y)] * luminance(p.radiance) / c.flux *
              (2 - 2 * glm::dot(p.direction, c.centre));
  // Mean square distance of an even disc of that solid angle: a^2/2 with pi a^2 = the solid angle.
  if (spread < kRoundness * c.solid_angle / (2 * kPi) || spread < kSmall * kSmall) return {};
  // A thousand shares are plenty for 64 points.
  const int block = 1 + static_cast<int>(std::sqrt(static_cast<double>(c.pixels.size()) / 1000));
  Vector<std::pair<std::int64_t, Share>> parts(memory_);  // by block
  parts.reserve(c.pixels.size());
  for (const Excess& p : c.pixels) {
    const double w = grid_.weight[static_cast<std::size_t>(p.y)] * luminance(p.radiance);
    parts.push_back({std::int64_t{p.y / block} * map_.width() + p.x / block, {w, w * p.direction}});
  }
  std::ranges::sort(parts, {}, &std::pair<std::int64_t, Share>::first);
  Vector<Share> shares(memory_);
  for (std::size_t i = 0; i < parts.size();) {
    const std::int64_t at = parts[i].first;
    Share sum;
    for (; i < parts.size() && parts[i].first == at; ++i)
      sum.weight += parts[i].second.weight, sum.direction += parts[i].second.direction;
    shares.push_back({sum.weight, sum.direction / sum.weight});
  }
  std::vector<glm::dvec3> out;
  out.reserve(Disc::kShapePoints);
  halve(shares, kShapeDepth, out);
  return out;
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

double Disc::solid_angle_sr() const {
  return 4 * kPi * std::pow(std::sin(.5 * radius.value()), 2);
}

Rgb Disc::irradiance() const {
  return radiance * static_cast<float>(kPi * std::pow(std::sin(radius.value()), 2));
}

Result<void> split_discs(const Image<Rgb>& map, const DiscOptions& options, DiscSplit& split,
                         std::span<const std::uint32_t> clipped) {
  if (map.empty()) return fail(ErrorCode::kInvalid, "environment", "has no pixels");
  if (!std::ranges::is_sorted(clipped) || (!clipped.empty() && clipped.back() >= map.area()))
    return fail(ErrorCode::kInvalid, "environment",
                "its clipped pixels are out of order or outside");
  split.rest.reset(map);
  return Peeler(options, clipped, split).run();
}

namespace {

// Points of equal solid angle over the disc: f(direction, solid angle of the point).
template <class F>
void over_disc(const Disc& disc, F f) {
  for (const glm::dvec3& d : disc.shape)
    f(d, disc.solid_angle_sr() / static_cast<double>(disc.shape.size()));
  if (!disc.shape.empty()) return;
  constexpr int kPoints = 256;
  const glm::dvec3 axis = disc.direction,
                   side = glm::normalize(glm::cross(
                       axis, std::abs(axis.y) < .9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0))),
                   up = glm::cross(side, axis);
  const double height = 2 * std::pow(std::sin(.5 * disc.radius.value()), 2);
  for (int k = 0; k < kPoints; ++k) {
    const double c = 1 - height * (k + .5) / kPoints, s = std::sqrt(1 - c * c),
                 a = k * 2.399963229728653;
    f(c * axis + s * (std::cos(a) * side + std::sin(a) * up), 2 * kPi * height / kPoints);
  }
}

// A round disc is a zonal function.
RadianceSh project_round(const Disc& disc, int bands) {
  RadianceSh out(bands);
  double basis[kMaxCoefficients];
  evaluate_basis(bands, disc.direction, basis);
  const double c = std::cos(disc.radius.value());
  double before = 1, here = c;  // P_{l-1}, P_l at l = 1
  for (int l = 0; l < bands; ++l) {
    double zonal = std::sqrt(kPi) * 2 * std::pow(std::sin(.5 * disc.radius.value()), 2);
    if (l > 0) {
      const double after = ((2 * l + 1) * c * here - l * before) / (l + 1);
      zonal = std::sqrt(kPi / (2 * l + 1)) * (before - after);
      before = here, here = after;
    }
    const double k = zonal * std::sqrt(4 * kPi / (2 * l + 1));
    for (int m = -l; m <= l; ++m) {
      const int n = sh_index(l, m);
      out[n] = disc.radiance * static_cast<float>(k * basis[n]);
    }
  }
  return out;
}

RadianceSh project_points(const Disc& disc, int bands, bool above) {
  double sum[kMaxCoefficients] = {}, basis[kMaxCoefficients];
  over_disc(disc, [&](const glm::dvec3& d, double solid_angle) {
    if (above && d.y <= 0) return;
    evaluate_basis(bands, d, basis);
    for (int n = 0; n < coefficient_count(bands); ++n) sum[n] += solid_angle * basis[n];
  });
  RadianceSh out(bands);
  for (int n = 0; n < out.size(); ++n) out[n] = disc.radiance * static_cast<float>(sum[n]);
  return out;
}

// In front of a surface with that normal, all of it.
bool is_in_front(const Disc& disc, const glm::dvec3& normal) {
  return disc.shape.empty() && disc.radius.value() < kPi / 2 &&
         glm::dot(disc.direction, normal) >= std::sin(disc.radius.value());
}

}  // namespace

RadianceSh project_disc(const Disc& disc, int bands) {
  return disc.shape.empty() ? project_round(disc, bands) : project_points(disc, bands, false);
}

RadianceSh project_disc_above(const Disc& disc, int bands) {
  return is_in_front(disc, {0, 1, 0}) ? project_round(disc, bands)
                                      : project_points(disc, bands, true);
}

Rgb irradiance(const Disc& disc, const glm::dvec3& normal) {
  if (is_in_front(disc, normal))
    return disc.irradiance() * static_cast<float>(glm::dot(disc.direction, normal));
  double sum = 0;
  over_disc(disc, [&](const glm::dvec3& d, double solid_angle) {
    sum += solid_angle * std::max(0., glm::dot(d, normal));
  });
  return disc.radiance * static_cast<float>(sum);
}

}  // namespace penumbra::lighting
