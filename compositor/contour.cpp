#include "compositor/contour.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>
#include <utility>

#include "core/half.h"

namespace penumbra::compositor {

namespace {

constexpr std::int32_t kNone = -1;

// Places at edges without exactly one triangle that goes on from vertex to vertex.
std::vector<std::uint8_t> rims(const prt::Mesh& mesh, std::span<const std::uint32_t> place,
                               std::uint8_t mark) {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> there, back;
  for (const auto& t : mesh.triangles)
    for (std::size_t i = 0; i < 3; ++i) {
      there.emplace_back(t[i], t[(i + 1) % 3]);
      back.emplace_back(t[(i + 1) % 3], t[i]);
    }
  std::ranges::sort(there);
  std::ranges::sort(back);
  std::vector<std::pair<std::uint32_t, std::uint32_t>> unmatched;
  std::ranges::set_symmetric_difference(there, back, std::back_inserter(unmatched));
  std::vector<std::uint8_t> out(mesh.positions.size(), 0);
  for (const auto& [a, b] : unmatched) out[place[a]] = out[place[b]] = mark;
  return out;
}

}  // namespace

Contour::Contour(const prt::Mesh& mesh)
    : place_(prt::places_of(mesh.positions)),
      rim_(rims(mesh, place_, kBoth)),
      first_(mesh.positions.size()) {}

void Contour::project(std::span<const glm::vec3> positions, const glm::dmat4& clip_from_object,
                      int frame_width, int frame_height) {
  const glm::mat4 m(clip_from_object);
  const float half_width = .5f * static_cast<float>(frame_width),
              half_height = .5f * static_cast<float>(frame_height);
  projected_.resize(positions.size());
  for (std::size_t i = 0; i < positions.size(); ++i) {
    const glm::vec3& p = positions[i];
    const float w = m[0][3] * p.x + m[1][3] * p.y + m[2][3] * p.z + m[3][3], per_w = 1 / w;
    const float x = m[0][0] * p.x + m[1][0] * p.y + m[2][0] * p.z + m[3][0],
                y = m[0][1] * p.x + m[1][1] * p.y + m[2][1] * p.z + m[3][1];
    projected_[i] = {half_width * (x * per_w + 1), half_height * (y * per_w + 1), w};
  }
}

// A triangle's edge, the triangle at its left hand; the next one there that goes on alike ends its being a line.
void Contour::meet(std::uint32_t from, std::uint32_t to, bool front) {
  std::int32_t& first = first_[std::min(place_[from], place_[to])];
  for (std::int32_t i = first; i != kNone; i = edges_[static_cast<std::size_t>(i)].next) {
    Edge& e = edges_[static_cast<std::size_t>(i)];
    if (e.from != to || e.to != from || e.front != front || e.inner) continue;
    e.inner = true;
    return;
  }
  edges_.push_back({from, to, first, front, false});
  first = static_cast<std::int32_t>(edges_.size()) - 1;
}

void Contour::see_facings(std::span<const Triangle> triangles) {
  around_ = rim_;
  facing_.clear();
  for (const Triangle& t : triangles) {
    const glm::vec3 &a = projected_[t[0]], &b = projected_[t[1]], &c = projected_[t[2]];
    const bool before_camera = std::min({a.z, b.z, c.z}) >= static_cast<float>(kNearPlane);
    const bool front = (b.x - a.x) * (c.y - a.y) < (b.y - a.y) * (c.x - a.x);
    facing_.push_back(before_camera ? front ? kFront : kBack : 0);
    for (const std::uint32_t v : t) around_[place_[v]] |= facing_.back();
  }
}

std::span<const Contour::Triangle> Contour::find(
    std::span<const glm::vec3> positions, std::span<const Triangle> triangles, bool fronts_only,
    const glm::dmat4& clip_from_object, int frame_width, int frame_height, std::vector<Line>& out) {
  project(positions, clip_from_object, frame_width, frame_height);
  see_facings(triangles);
  std::ranges::fill(first_, kNone);
  edges_.clear();
  seen_.clear();
  for (std::size_t i = 0; i < triangles.size(); ++i) {
    if (fronts_only && facing_[i] == kBack) continue;
    const Triangle& t = triangles[i];
    seen_.push_back(t);
    if (facing_[i] == 0) continue;
    const bool front = facing_[i] == kFront;
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t from = t[front ? k : (k + 1) % 3], to = t[front ? (k + 1) % 3 : k];
      if (around_[place_[from]] == kBoth && around_[place_[to]] == kBoth) meet(from, to, front);
    }
  }
  for (const Edge& e : edges_)
    if (!e.inner) out.push_back({projected_[e.from], projected_[e.to]});
  return seen_;
}

// Along the axis where the line is longer: one gap for each middle that it passes.
void ContourSmoother::collect(const Line& line, const Rect& rect) {
  const glm::vec3 d = line.to - line.from;
  const bool steep = std::abs(d.y) > std::abs(d.x);
  const int along = steep ? 1 : 0, across = 1 - along;
  const bool forth = d[along] > 0;
  const glm::vec3 &a = forth ? line.from : line.to, &b = forth ? line.to : line.from;
  const glm::ivec2 low(rect.x0, rect.y0), high(rect.x1, rect.y1);
  const int first = std::max(static_cast<int>(std::ceil(a[along] - .5f)), low[along]),
            end = std::min(static_cast<int>(std::ceil(b[along] - .5f)), high[along]);
  const glm::vec3 step = first < end ? d / d[along] : glm::vec3(0);
  for (int i = first; i < end; ++i) {
    const glm::vec3 at = a + (static_cast<float>(i) + .5f - a[along]) * step;
    const float middle = std::floor(at[across] - .5f);
    glm::ivec2 p;
    p[along] = i;
    p[across] = static_cast<int>(middle);
    if (p[across] < low[across] || p[across] + 1 >= high[across]) continue;
    const int index = (p.y - rect.y0) * rect.width() + p.x - rect.x0;
    crossings_.push_back({2 * static_cast<std::uint32_t>(index) + (steep ? 0u : 1u),
                          at[across] - .5f - middle, at.z, forth != steep});
  }
}

void ContourSmoother::decide(std::span<const Crossing> gap, const Layer& layer) {
  constexpr float kOneSurface = 1.005f;  // folds of it lie within so much of the distance
  const std::size_t before = 4 * static_cast<std::size_t>(gap[0].gap / 2);
  const bool down = gap[0].gap % 2 == 1;
  const std::size_t after = before + 4 * (down ? static_cast<std::size_t>(layer.rect.width()) : 1);
  if (std::equal(&layer.halves[before], &layer.halves[before] + 4, &layer.halves[after])) return;
  float nearest = HUGE_VALF;
  for (const Crossing& c : gap) nearest = std::min(nearest, c.distance_m);
  std::optional<float> ends, begins;
  for (const Crossing& c : gap) {
    if (c.distance_m > kOneSurface * nearest) continue;
    if (c.surface_before)
      ends = std::max(ends.value_or(0), c.at);
    else
      begins = std::min(begins.value_or(1), c.at);
  }
  const bool covered_before = layer.halves[before + 3] != 0;
  const float at = ends && (covered_before || !begins) ? *ends : *begins;
  const bool first_is_cut = at < .5f;
  Share s{first_is_cut ? before : after, std::abs(at - .5f), {}};
  std::copy_n(&layer.halves[first_is_cut ? after : before], 4, s.neighbour.begin());
  shares_.push_back(s);
}

void ContourSmoother::smooth(std::span<const Line> lines, Layer& layer) {
  crossings_.clear();
  shares_.clear();
  for (const Line& line : lines) collect(line, layer.rect);
  std::ranges::sort(crossings_, {}, &Crossing::gap);
  for (auto i = crossings_.begin(); i != crossings_.end();) {
    const auto end =
        std::find_if(i, crossings_.end(), [&](const auto& c) { return c.gap != i->gap; });
    decide({i, end}, layer);
    i = end;
  }
  for (const Share& s : shares_)
    for (std::size_t c = 0; c < 4; ++c) {
      std::uint16_t& half = layer.halves[s.pixel + c];
      const float own = float_from_half(half);
      half = half_from_float(own + s.of_neighbour * (float_from_half(s.neighbour[c]) - own));
    }
}

}  // namespace penumbra::compositor
