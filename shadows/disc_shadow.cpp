#include <algorithm>
#include <cmath>
#include <optional>

#include "core/parallel.h"
#include "core/scratch.h"
#include "shadows/disc_rays.h"

namespace penumbra::shadows {

namespace {

constexpr std::size_t kScouts = 4;  // taps that decide whether a node needs the others
constexpr int kCoarse = 8;          // cells between the first nodes
constexpr float kSame = .07f;       // a cell whose corners differ by less is flat
constexpr float kSteep = .6f;       // an edge may hide in a cell whose corners differ by more
constexpr float kStraight = .06f;   // midpoints this close to the bilinear value need no refinement
// In the penumbra of a broad disc a step of one tap, 1/24, is no edge: who refined it where the shadow runs gently would
// follow every tap's own hard shadow, for nothing.
constexpr double kBroad = .2;  // radians
constexpr float kGentle = .15f, kGentleStraight = .1f;
constexpr double kLongest = 10;  // radii of the caster: longest shadow
constexpr double kLeastSine =
    .02;  // of a tap's elevation: lower ones throw their shadow like this one

int taps_for(const lighting::Disc& disc, int taps) {
  // As many of a form's points for each tap.
  if (!disc.shape.empty()) return std::min(kMostTaps, 2 * taps);
  return is_narrow(disc) ? taps : std::min(kMostTaps, taps + taps / 2);
}

// Bounds of the casters' shadow in the plane frame.
struct Extent {
  glm::dvec2 low{1e30}, high{-1e30};
  bool cut = false;  // the shadow goes on beyond high.x
  bool empty() const { return low.x >= high.x || low.y >= high.y; }
};

// Where the shadow of a point at height one lies, over all taps above the plane.
Extent reach_of_taps(const TapPattern& taps, const glm::dmat3& plane_from_world) {
  Extent reach;
  for (int t = 0; t < taps.count(); ++t) {
    const glm::dvec3 d = plane_from_world * glm::dvec3(taps.at(0)[t]);
    if (d.y <= 0) continue;
    const glm::dvec2 shift = -glm::dvec2(d.x, d.z) / std::max(d.y, kLeastSine);
    reach.low = glm::min(reach.low, shift);
    reach.high = glm::max(reach.high, shift);
  }
  return reach;
}

Extent shadow_extent(std::span<const Caster> casters, const Pose& plane_from_world,
                     const Extent& reach) {
  Extent all;
  for (const Caster& caster : casters) {
    const glm::dmat4 place = (plane_from_world * caster.world_from_mesh).matrix();
    Extent body, e;
    for (const glm::vec3& position : caster.mesh->positions) {
      const glm::dvec3 p(place * glm::dvec4(position, 1));
      if (p.y < 0) continue;
      const glm::dvec2 foot(p.x, p.z);
      body.low = glm::min(body.low, foot);
      body.high = glm::max(body.high, foot);
      e.low = glm::min(e.low, foot + p.y * reach.low);
      e.high = glm::max(e.high, foot + p.y * reach.high);
    }
    if (e.empty()) continue;
    const double longest =
        kLongest * radius_around(*caster.mesh, prt::bounds_of(*caster.mesh).centre());
    all.cut |= e.high.x > body.high.x + longest;
    all.low = glm::min(all.low, glm::max(e.low, body.low - longest));
    all.high = glm::max(all.high, glm::min(e.high, body.high + longest));
  }
  return all;
}

// One shadow map under construction. All nodes use the same taps: visibility is then smooth across nodes, and
// refinement ends where it should.
class Refiner {
 public:
  Refiner(const Blockers& blockers, const TapPattern& taps, const lighting::Disc& disc,
          DiscShadow& out)
      : blockers_(blockers),
        out_(out),
        width_(out.taken.width()),
        narrow_(is_narrow(disc)),
        broad_(least_radius(disc) >= kBroad) {
    known_.assign(out.taken.area(), false);
    const glm::mat3 axes(out.world_from_map.rotation_matrix());
    frame_ = axes * out.cell_m;
    origin_ = glm::vec3(out.world_from_map.translation) + blockers.near_m * axes[1];
    float open = 0;
    for (int t = 0; t < taps.count(); ++t) {
      // Taps below the horizon bring no light and take none.
      const float cosine = glm::dot(axes[1], taps.at(0)[t]);
      if (cosine <= 0) continue;
      taps_.push_back({taps.at(0)[t], cosine});
      open += cosine;
    }
    for (Tap& tap : taps_) tap.weight /= open;
  }
  void run();

 private:
  struct Tap {
    glm::vec3 direction;
    float weight;  // of all light of the disc on the open plane
  };
  struct Cell {
    int x, y;  // lower node
  };
  bool varies(const Cell& c, int step) const;
  bool is_straight(const Cell& c, int step) const;
  void want(int x, int y);
  void trace_wanted();
  void trace(std::span<const std::size_t> nodes, std::span<const Tap> taps);
  bool settle(std::size_t node, float scouted);
  void fill(const Cell& c, int step);
  std::size_t index(int x, int y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
           static_cast<std::size_t>(x);
  }

  const Blockers& blockers_;
  DiscShadow& out_;
  int width_;
  bool narrow_, broad_;
  glm::mat3 frame_;
  glm::vec3 origin_;
  Scratch::Scope scope_;
  std::pmr::vector<Tap> taps_{scope_.memory()};
  std::pmr::vector<char> known_{scope_.memory()};
  std::pmr::vector<std::size_t> wanted_{scope_.memory()};
};

void Refiner::want(int x, int y) {
  const std::size_t i = index(x, y);
  if (known_[i]) return;
  known_[i] = true;
  out_.taken.pixels()[i] = 0;  // a neighbouring cell may have filled it in
  if (!out_.missing.empty()) out_.missing.pixels()[i] = 0;
  wanted_.push_back(i);
}

// Scouts around the disc's rim first: where they agree there is no penumbra.
void Refiner::trace_wanted() {
  const std::size_t scouts = narrow_ ? std::min(kScouts, taps_.size()) : taps_.size();
  trace(wanted_, std::span(taps_).first(scouts));
  if (scouts < taps_.size()) {
    float scouted = 0;
    for (std::size_t t = 0; t < scouts; ++t) scouted += taps_[t].weight;
    std::erase_if(wanted_, [&](std::size_t i) { return settle(i, scouted); });
    trace(wanted_, std::span(taps_).subspan(scouts));
  }
  wanted_.clear();
}

// True when the scouts, which weigh `scouted` together, all saw the same.
bool Refiner::settle(std::size_t node, float scouted) {
  constexpr float kRounding = 1e-4f;
  float& taken = out_.taken.pixels()[node];
  float* const missing = out_.missing.empty() ? nullptr : &out_.missing.pixels()[node];
  const float dark = taken + (missing ? *missing : 0);
  if (dark < kRounding) return true;
  if (taken > scouted - kRounding) return taken = 1, true;
  if (missing && *missing > scouted - kRounding) return *missing = 1, true;
  return false;
}

void Refiner::trace(std::span<const std::size_t> nodes, std::span<const Tap> taps) {
  parallel_for(std::size_t{0}, nodes.size(), 128, [&](const auto& part) {
    Packets packets(blockers_, [&](std::size_t i, float weight, bool by_virtual, bool by_real) {
      if (by_real)
        out_.missing.pixels()[i] += weight;
      else if (by_virtual)
        out_.taken.pixels()[i] += weight;
    });
    for (std::size_t k = part.begin(); k < part.end(); ++k) {
      const std::size_t i = nodes[k];
      const auto x = static_cast<float>(i % static_cast<std::size_t>(width_)),
                 y = static_cast<float>(i / static_cast<std::size_t>(width_));
      const glm::vec3 o = origin_ + x * frame_[0] + y * frame_[2];
      for (const Tap& tap : taps) packets.add(i, tap.weight, o, tap.direction);
    }
  });
  out_.rays += nodes.size() * taps.size();
}

bool Refiner::varies(const Cell& c, int step) const {
  const auto spread = [&](const Image<float>& map) {
    if (map.empty()) return 0.f;
    const auto [low, high] = std::minmax({map.at(c.x, c.y), map.at(c.x + step, c.y),
                                          map.at(c.x, c.y + step), map.at(c.x + step, c.y + step)});
    return high - low;
  };
  return std::max(spread(out_.taken), spread(out_.missing)) > kSame;
}

// The five nodes in the middle against the corners' bilinear values.
bool Refiner::is_straight(const Cell& c, int step) const {
  const int h = step / 2;
  const auto straight = [&](const Image<float>& m) {
    if (m.empty()) return true;
    const float a = m.at(c.x, c.y), b = m.at(c.x + step, c.y), d = m.at(c.x, c.y + step),
                e = m.at(c.x + step, c.y + step);
    const auto [low, high] = std::minmax({a, b, d, e});
    if (high - low > kSteep) return false;
    const float allowed = broad_ && high - low < kGentle ? kGentleStraight : kStraight;
    const auto near = [&](float u, float v) { return std::abs(u - v) < allowed; };
    return near(m.at(c.x + h, c.y), (a + b) / 2) && near(m.at(c.x + h, c.y + step), (d + e) / 2) &&
           near(m.at(c.x, c.y + h), (a + d) / 2) && near(m.at(c.x + step, c.y + h), (b + e) / 2) &&
           near(m.at(c.x + h, c.y + h), (a + b + d + e) / 4);
  };
  return straight(out_.taken) && straight(out_.missing);
}

void Refiner::fill(const Cell& c, int step) {
  for (Image<float>* map : {&out_.taken, &out_.missing}) {
    if (map->empty()) continue;
    const float a = map->at(c.x, c.y), b = map->at(c.x + step, c.y), d = map->at(c.x, c.y + step),
                e = map->at(c.x + step, c.y + step);
    if (a == 0 && b == 0 && d == 0 && e == 0) continue;  // as it was made
    for (int y = 0; y <= step; ++y)
      for (int x = 0; x <= step; ++x) {
        if (known_[index(c.x + x, c.y + y)]) continue;
        const float u = static_cast<float>(x) / static_cast<float>(step),
                    v = static_cast<float>(y) / static_cast<float>(step);
        map->at(c.x + x, c.y + y) = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * e);
      }
  }
}

void Refiner::run() {
  const int columns = (out_.taken.width() - 1) / kCoarse,
            rows = (out_.taken.height() - 1) / kCoarse;
  for (int y = 0; y <= rows; ++y)
    for (int x = 0; x <= columns; ++x) want(x * kCoarse, y * kCoarse);
  trace_wanted();
  // A cell next to one that varies may hold an edge that missed its corners.
  std::pmr::vector<char> vary(static_cast<std::size_t>(columns * rows), false, scope_.memory());
  const auto at = [&](int x, int y) { return static_cast<std::size_t>(y * columns + x); };
  for (int y = 0; y < rows; ++y)
    for (int x = 0; x < columns; ++x) vary[at(x, y)] = varies({x * kCoarse, y * kCoarse}, kCoarse);
  std::pmr::vector<Cell> cells(scope_.memory()), next(scope_.memory());
  for (int y = 0; y < rows; ++y)
    for (int x = 0; x < columns; ++x) {
      bool near = false;
      for (int j = std::max(0, y - 1); j <= std::min(rows - 1, y + 1); ++j)
        for (int i = std::max(0, x - 1); i <= std::min(columns - 1, x + 1); ++i)
          near |= vary[at(i, j)] != 0;
      const Cell c{x * kCoarse, y * kCoarse};
      near ? cells.push_back(c) : fill(c, kCoarse);
    }
  for (int step = kCoarse; step > 1; step /= 2, std::swap(cells, next)) {
    const int h = step / 2;
    for (const Cell& c : cells)
      for (int k = 0; k < 9; ++k) want(c.x + k % 3 * h, c.y + k / 3 * h);
    trace_wanted();
    next.clear();
    for (const Cell& c : cells) {
      if (is_straight(c, step)) {
        fill(c, step);
        continue;
      }
      for (int k = 0; k < 4; ++k) {
        const Cell part{c.x + k % 2 * h, c.y + k / 2 * h};
        varies(part, h) ? next.push_back(part) : fill(part, h);
      }
    }
  }
}

// Nothing may end abruptly: a shadow that is cut off runs out over the last fifth.
void fade_end(Image<float>& map) {
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      const float t = std::min(
          1.f, 5 * static_cast<float>(map.width() - 1 - x) / static_cast<float>(map.width()));
      map.at(x, y) *= t * t * (3 - 2 * t);
    }
}

void clear_rim(Image<float>& map) {
  for (int y = 0; y < map.height(); ++y) map.at(0, y) = map.at(map.width() - 1, y) = 0;
  for (int x = 0; x < map.width(); ++x) map.at(x, 0) = map.at(x, map.height() - 1) = 0;
}

// How a plane lies to a disc, and the disc's rays.
struct Setting {
  Pose world_from_plane;  // x away from the light
  Extent reach;
};

std::optional<Setting> set_up(const prt::Plane& plane, const lighting::Disc& disc,
                              const TapPattern& taps) {
  // Any direction will do under a light at the zenith.
  const double sine = glm::dot(plane.normal, disc.direction);
  glm::dvec3 away = sine * plane.normal - disc.direction;
  if (glm::length(away) < 1e-6)
    away = glm::cross(plane.normal,
                      std::abs(plane.normal.x) < .9 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 0, 1));
  away = glm::normalize(away);
  const glm::dmat3 axes(away, plane.normal, glm::cross(away, plane.normal));
  const Extent reach = reach_of_taps(taps, glm::transpose(axes));
  if (reach.low.x > reach.high.x) return std::nullopt;  // no tap above the plane
  return Setting{{glm::quat_cast(axes), plane.point}, reach};
}

void trace_extent(const Blockers& blockers, const TapPattern& taps, const lighting::Disc& disc,
                  const DiscShadowOptions& options, const Setting& setting, const Extent& e,
                  DiscShadow& out) {
  const glm::dvec2 size = e.high - e.low;
  const double cell = std::max(size.x, size.y) / (options.size - 4);
  const auto nodes = [&](double length) {
    return (static_cast<int>(std::ceil(length / cell + 4)) + kCoarse - 1) / kCoarse * kCoarse + 1;
  };
  out.cell_m = static_cast<float>(cell);
  out.world_from_map =
      setting.world_from_plane * Pose{{1, 0, 0, 0}, {e.low.x - 2 * cell, 0, e.low.y - 2 * cell}};
  out.taken.reset(nodes(size.x), nodes(size.y));
  if (blockers.real_things && !blockers.real_things->empty())
    out.missing.reset(out.taken.width(), out.taken.height());
  Refiner(blockers, taps, disc, out).run();
  if (e.cut) fade_end(out.taken);
  clear_rim(out.taken);
}

void clear(DiscShadow& out) {
  out.rays = 0;
  out.taken.reset(0, 0);
  out.missing.reset(0, 0);
}

Extent united(const Extent& a, const Extent& b) {
  return {glm::min(a.low, b.low), glm::max(a.high, b.high), a.cut || b.cut};
}

bool overlap(const Extent& a, const Extent& b) {
  return a.low.x < b.high.x && b.low.x < a.high.x && a.low.y < b.high.y && b.low.y < a.high.y;
}

}  // namespace

void trace_disc_shadow(const Blockers& blockers, std::span<const Caster> casters,
                       const prt::Plane& plane, const lighting::Disc& disc,
                       const DiscShadowOptions& options, DiscShadow& out) {
  clear(out);
  if (casters.empty()) return;
  thread_local TapPattern taps;  // grows once per thread
  taps.make(disc, taps_for(disc, options.taps), 1);
  const auto setting = set_up(plane, disc, taps);
  if (!setting) return;
  const Extent e = shadow_extent(casters, setting->world_from_plane.inverse(), setting->reach);
  if (!e.empty()) trace_extent(blockers, taps, disc, options, *setting, e, out);
}

void trace_real_shadow(const Blockers& blockers, std::span<const Neighbourhood> around,
                       const prt::Plane& plane, const lighting::Disc& disc,
                       const DiscShadowOptions& options, DiscShadow& out) {
  clear(out);
  thread_local TapPattern taps;  // grows once per thread
  taps.make(disc, taps_for(disc, options.taps), 1);
  const auto setting = set_up(plane, disc, taps);
  if (!setting || around.empty() || blockers.real_things->empty()) return;
  const Pose plane_from_world = setting->world_from_plane.inverse();
  Extent e;
  for (const Neighbourhood& n : around) {
    const glm::dvec3 p = plane_from_world * n.centre;
    e.low = glm::min(e.low, glm::dvec2(p.x, p.z) - n.radius);
    e.high = glm::max(e.high, glm::dvec2(p.x, p.z) + n.radius);
  }
  const Blockers real{blockers.real_things, nullptr, blockers.near_m};
  trace_extent(real, taps, disc, options, *setting, e, out);
}

void trace_disc_shadows(const Blockers& blockers, std::span<const Caster> casters,
                        const prt::Plane& plane, const lighting::Disc& disc,
                        const DiscShadowOptions& options, std::vector<DiscShadow>& out) {
  thread_local TapPattern taps;  // grows once per thread
  taps.make(disc, taps_for(disc, options.taps), 1);
  const auto setting = set_up(plane, disc, taps);
  const Scratch::Scope scope;
  std::pmr::vector<Extent> groups(scope.memory());
  for (const Caster& caster : casters) {
    if (!setting) break;
    Extent e = shadow_extent({&caster, 1}, setting->world_from_plane.inverse(), setting->reach);
    if (e.empty()) continue;
    // A rectangle that grew may meet others that it had passed.
    for (std::size_t i = 0; i < groups.size();) {
      if (!overlap(groups[i], e)) {
        ++i;
        continue;
      }
      e = united(groups[i], e);
      groups.erase(groups.begin() + static_cast<std::ptrdiff_t>(i));
      i = 0;
    }
    groups.push_back(e);
  }
  if (out.size() < groups.size()) out.resize(groups.size());
  for (DiscShadow& shadow : out) clear(shadow);
  for (std::size_t i = 0; i < groups.size(); ++i)
    trace_extent(blockers, taps, disc, options, *setting, groups[i], out[i]);
}

}  // namespace penumbra::shadows
