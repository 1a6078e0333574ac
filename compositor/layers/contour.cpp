#include "compositor/layers/contour.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/vector_relational.hpp>
#include <iterator>
#include <map>
#include <optional>
#include <utility>

#include "core/half.h"
#include "core/threads/parallel.h"

namespace penumbra::compositor {

namespace {

constexpr std::int32_t kNone = -1;

using Step = std::pair<std::uint32_t, std::uint32_t>;

// Edges that are not gone along as often there as back between what `of` makes of the vertices.
template <class Of>
std::vector<Step> rims_of(const prt::Mesh& mesh, Of of) {
  std::vector<Step> there, back, out;
  for (const auto& t : mesh.triangles)
    for (std::size_t i = 0; i < 3; ++i) {
      there.emplace_back(of(t[i]), of(t[(i + 1) % 3]));
      back.emplace_back(of(t[(i + 1) % 3]), of(t[i]));
    }
  std::ranges::sort(there);
  std::ranges::sort(back);
  std::ranges::set_symmetric_difference(there, back, std::back_inserter(out));
  return out;
}

// By place, one place of the part that triangles join it to.
std::vector<std::uint32_t> parts_of(const prt::Mesh& mesh, std::vector<std::uint32_t> part) {
  const auto root = [&](std::uint32_t v) {
    while (part[v] != v) v = part[v] = part[part[v]];
    return v;
  };
  for (const auto& t : mesh.triangles)
    for (const std::uint32_t v : {t[1], t[2]}) part[root(v)] = root(t[0]);
  for (std::uint32_t v = 0; v < part.size(); ++v) part[v] = root(v);
  return part;
}

struct MeshPart {
  prt::Bounds bounds;
  Rgb albedo;  // of its first vertex
};

bool may_meet(const prt::Mesh& mesh, std::span<const std::uint32_t> place) {
  constexpr std::size_t kMax = 256;  // parts; more are not looked at pair by pair
  const std::vector<std::uint32_t> part_of = parts_of(mesh, {place.begin(), place.end()});
  std::map<std::uint32_t, MeshPart> parts;
  for (const auto& t : mesh.triangles)
    for (const std::uint32_t v : t) {
      const glm::vec3& p = mesh.positions[v];
      prt::Bounds& b =
          parts.try_emplace(part_of[v], MeshPart{{p, p}, mesh.albedo[v]}).first->second.bounds;
      b = {glm::min(b.low, p), glm::max(b.high, p)};
    }
  if (parts.size() > kMax) return true;
  for (auto a = parts.begin(); a != parts.end(); ++a)
    for (auto b = parts.begin(); b != a; ++b) {
      const MeshPart &p = a->second, &q = b->second;
      if (!(p.albedo == q.albedo) && glm::all(glm::lessThan(p.bounds.low, q.bounds.high)) &&
          glm::all(glm::lessThan(q.bounds.low, p.bounds.high)))
        return true;
    }
  return false;
}

double signed_volume(const prt::Mesh& mesh) {
  double sum = 0;
  for (const auto& t : mesh.triangles)
    sum += glm::dot(glm::dvec3(mesh.positions[t[0]]),
                    glm::cross(glm::dvec3(mesh.positions[t[1]]), glm::dvec3(mesh.positions[t[2]])));
  return sum;
}

}  // namespace

// Creases split a vertex in two; the place is what counts.
bool is_closed(const prt::Mesh& mesh) {
  const std::vector<std::uint32_t> place = prt::places_of(mesh.positions);
  return rims_of(mesh, [&](std::uint32_t v) { return place[v]; }).empty() &&
         signed_volume(mesh) > 0;
}

Contour::Contour(const prt::Mesh& mesh)
    : place_(prt::places_of(mesh.positions)),
      rim_(mesh.positions.size(), 0),
      first_(mesh.positions.size()) {
  constexpr std::size_t kMaxRims = 100'000;  // both ways
  const std::vector<Step> rims = rims_of(mesh, std::identity());
  for (const auto& [a, b] : rims) rim_[place_[a]] = rim_[place_[b]] = kBoth;
  serves_ = rims.size() <= kMaxRims && !may_meet(mesh, place_);
}

void Contour::project(std::span<const glm::vec3> positions, const ViewProjection& from_object) {
  projected_.resize(positions.size());
  // What a lens does not show counts as behind the camera.
  if (const ViewLens* lens = from_object.lens())
    return lens->project(positions, from_object.matrix(), projected_);
  const glm::mat4 m(from_object.matrix());
  const float half_width = .5f * static_cast<float>(from_object.width()),
              half_height = .5f * static_cast<float>(from_object.height());
  for (std::size_t i = 0; i < positions.size(); ++i) {
    const glm::vec3& p = positions[i];
    const float w = m[0][3] * p.x + m[1][3] * p.y + m[2][3] * p.z + m[3][3], per_w = 1 / w;
    const float x = m[0][0] * p.x + m[1][0] * p.y + m[2][0] * p.z + m[3][0],
                y = m[0][1] * p.x + m[1][1] * p.y + m[2][1] * p.z + m[3][1];
    projected_[i] = {half_width * (x * per_w + 1), half_height * (y * per_w + 1), per_w};
  }
}

// A triangle's edge, the triangle at its left hand; the next one there that goes on alike ends its
// being a line.
void Contour::meet(std::uint32_t from, std::uint32_t to, bool front) {
  std::int32_t& first = first_[std::min(place_[from], place_[to])];
  for (std::int32_t i = first; i != kNone; i = edges_[static_cast<std::size_t>(i)].next) {
    ContourEdge& e = edges_[static_cast<std::size_t>(i)];
    if (e.from != to || e.to != from || e.front != front || e.inner) continue;
    e.inner = true;
    return;
  }
  edges_.push_back({from, to, first, front, false});
  first = static_cast<std::int32_t>(edges_.size()) - 1;
}

// False where a triangle reaches behind the camera.
bool Contour::see_facings(std::span<const ContourTriangle> triangles) {
  // Seen so nearly from its side a triangle may have either facing for GL, which snaps corners to a
  // part of a pixel.
  constexpr float kSliver_px2 = 1.f / 256;  // twice its area
  constexpr float kNearest = 1 / static_cast<float>(kNearPlane);
  around_ = rim_;
  facing_.clear();
  for (const ContourTriangle& t : triangles) {
    const glm::vec3 &a = projected_[t[0]], &b = projected_[t[1]], &c = projected_[t[2]];
    const auto before_camera = [](const glm::vec3& p) { return p.z > 0 && p.z <= kNearest; };
    if (!before_camera(a) || !before_camera(b) || !before_camera(c)) return false;
    const float area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    facing_.push_back(area < kSliver_px2 ? kFront : kBack);
    for (const std::uint32_t v : t) around_[place_[v]] |= facing_.back();
  }
  return true;
}

bool Contour::find(std::span<const glm::vec3> positions, std::span<const ContourTriangle> triangles,
                   bool fronts_only, const ViewProjection& from_object,
                   std::vector<ContourLine>& out) {
  seen_.clear();
  project(positions, from_object);
  if (!see_facings(triangles)) return false;
  std::ranges::fill(first_, kNone);
  edges_.clear();
  for (std::size_t i = 0; i < triangles.size(); ++i) {
    const bool front = facing_[i] == kFront;
    if (fronts_only && !front) continue;
    const ContourTriangle& t = triangles[i];
    seen_.push_back(t);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t from = t[front ? k : (k + 1) % 3], to = t[front ? (k + 1) % 3 : k];
      if (around_[place_[from]] == kBoth && around_[place_[to]] == kBoth) meet(from, to, front);
    }
  }
  for (const ContourEdge& e : edges_)
    if (!e.inner) out.push_back({glm::vec2(projected_[e.from]), glm::vec2(projected_[e.to])});
  return true;
}

// Along the axis where the line is longer: one gap for each middle that it passes.
void ContourSmoother::collect(const ContourLine& line, const Rect& rect) {
  const glm::vec2 d = line.to - line.from;
  const bool steep = std::abs(d.y) > std::abs(d.x);
  const int along = steep ? 1 : 0, across = 1 - along;
  const bool forth = d[along] > 0;
  const glm::vec2 &a = forth ? line.from : line.to, &b = forth ? line.to : line.from;
  const glm::ivec2 low(rect.x0, rect.y0), high(rect.x1, rect.y1);
  const auto middle_from = [&](float at) {
    return static_cast<int>(std::ceil(
        std::clamp(at - .5f, static_cast<float>(low[along]), static_cast<float>(high[along]))));
  };
  const int first = middle_from(a[along]), end = middle_from(b[along]);
  const glm::vec2 step = first < end ? d / d[along] : glm::vec2(0);
  for (int i = first; i < end; ++i) {
    const glm::vec2 at = a + (static_cast<float>(i) + .5f - a[along]) * step;
    const float middle = std::floor(at[across] - .5f);
    if (!(middle >= static_cast<float>(low[across]) &&
          middle + 1 < static_cast<float>(high[across])))
      continue;
    glm::ivec2 p;
    p[along] = i;
    p[across] = static_cast<int>(middle);
    const int index = (p.y - rect.y0) * rect.width() + p.x - rect.x0;
    crossings_.push_back({2 * static_cast<std::uint32_t>(index) + (steep ? 0u : 1u),
                          at[across] - .5f - middle, forth != steep});
  }
}

void ContourSmoother::decide(std::span<const GapCrossing> gap, const Layer& layer) {
  const std::size_t before = 4 * static_cast<std::size_t>(gap[0].gap / 2);
  const bool down = gap[0].gap % 2 == 1;
  const std::size_t after = before + 4 * (down ? static_cast<std::size_t>(layer.rect.width()) : 1);
  std::optional<float> ends, begins;
  for (const GapCrossing& c : gap) {
    if (c.surface_before)
      ends = std::max(ends.value_or(0), c.at);
    else
      begins = std::min(begins.value_or(1), c.at);
  }
  const bool covered_before = layer.halves[before + 3] != 0;
  at_background_ += !covered_before || layer.halves[after + 3] == 0;
  if (std::equal(&layer.halves[before], &layer.halves[before] + 4, &layer.halves[after])) {
    missed_ += !covered_before && ends && begins && *begins < *ends;
    return;
  }
  const float at = ends && (covered_before || !begins) ? *ends : *begins;
  const bool first_is_cut = at < .5f;
  PixelCoverage s{first_is_cut ? before : after, std::abs(at - .5f), {}};
  std::copy_n(&layer.halves[first_is_cut ? after : before], 4, s.neighbour.begin());
  fractions_.push_back(s);
}

bool ContourSmoother::smooth(std::span<const ContourLine> lines, Layer& layer) {
  constexpr std::size_t kMissedOf = 50;
  crossings_.clear();
  fractions_.clear();
  at_background_ = missed_ = 0;
  for (const ContourLine& line : lines) collect(line, layer.rect);
  std::ranges::sort(crossings_, {}, &GapCrossing::gap);
  for (auto i = crossings_.begin(); i != crossings_.end();) {
    const auto end =
        std::find_if(i, crossings_.end(), [&](const auto& c) { return c.gap != i->gap; });
    decide({i, end}, layer);
    i = end;
  }
  if (kMissedOf * missed_ > at_background_) return false;
  for (const PixelCoverage& s : fractions_)
    for (std::size_t c = 0; c < 4; ++c) {
      std::uint16_t& half = layer.halves[s.pixel + c];
      const float own = float_from_half(half);
      half = half_from_float(own + s.of_neighbour * (float_from_half(s.neighbour[c]) - own));
    }
  return true;
}

}  // namespace penumbra::compositor
