#include "shadows/shared_sight.h"

#include <algorithm>
#include <cmath>
#include <glm/gtx/quaternion.hpp>
#include <optional>

#include "core/scratch.h"
#include "shadows/disc_rays.h"

namespace penumbra::shadows {

namespace {

constexpr float kMostCells = 192;  // across an object seen from the light
// Radians: of a wider disc most vertices see a part, and looking for the others costs more than their rays.
constexpr double kWidest = .15;
constexpr float kCosineRounding = 1e-5f;

struct Box {
  glm::vec3 low, high;
};
Box turned(const prt::Bounds& bounds, const glm::mat3& turn) {
  const glm::vec3 centre = turn * bounds.centre(), half = .5f * (bounds.high - bounds.low);
  glm::vec3 reach(0);
  for (int k = 0; k < 3; ++k) reach += glm::abs(turn[k]) * half[k];
  return {centre - reach, centre + reach};
}

// Whether another caster reaches into the sphere around the object.
bool others_reach(std::span<const Caster> casters, const Caster& object) {
  const auto sphere = [](const Caster& c) {
    return std::pair(c.world_from_mesh * glm::dvec3(c.outline->bounds().centre()),
                     double(c.outline->radius_m()));
  };
  const auto [centre, radius] = sphere(object);
  return std::ranges::any_of(casters, [&](const Caster& c) {
    const auto [other, its_radius] = sphere(c);
    const bool itself = c.outline == object.outline && c.world_from_mesh == object.world_from_mesh;
    return !itself && glm::distance(other, centre) < radius + its_radius;
  });
}

// An edge that is an outline: x and z in cells of a grid seen from the light, y in metres towards it.
struct Line {
  glm::vec3 from, to;
};

// What is long covers many cells aside of it and has many heights.
void add_parts(const Line& line, std::pmr::vector<Line>& out) {
  constexpr float kLong = 16, kMostParts = 64;  // cells
  const glm::vec3 way = line.to - line.from;
  const float parts =
      std::clamp(std::ceil(std::max(std::abs(way.x), std::abs(way.z)) / kLong), 1.f, kMostParts);
  glm::vec3 from = line.from;
  for (float k = 1; k <= parts; ++k) {
    const glm::vec3 to = k == parts ? line.to : line.from + k / parts * way;
    out.push_back({from, to});
    from = to;
  }
}

// The way into such a grid.
class IntoGrid {
 public:
  IntoGrid(const Pose& grid_from_mesh, float cell_m)
      : turn_(grid_from_mesh.rotation_matrix()),
        shift_(grid_from_mesh.translation),
        scale_(1 / cell_m, 1, 1 / cell_m) {}
  glm::vec3 operator()(const glm::vec3& p) const { return scale_ * (turn_ * p + shift_); }

 private:
  glm::mat3 turn_;
  glm::vec3 shift_, scale_;
};

// Signed area of the parallelogram of two vectors.
float cross(const glm::vec2& a, const glm::vec2& b) {
  return a.x * b.y - a.y * b.x;
}
glm::vec2 across(const glm::vec3& p) {
  return {p.x, p.z};
}

// Whether the line passes over the way from a to b. Ways that begin or end on it are not passed over: an outline's own
// surface touches it. (Both come by the same sums from the same vertex, so that they are equal where they should be.)
bool passes_over(const Line& line, const glm::vec3& a, const glm::vec3& b) {
  const glm::vec2 from = across(line.from), along = across(line.to) - from, start = across(a),
                  way = across(b) - start;
  const float a_off = cross(along, start - from), b_off = cross(along, across(b) - from);
  if (!(a_off < 0 ? b_off > 0 : a_off > 0 && b_off < 0)) return false;
  const float from_off = cross(way, from - start), to_off = cross(way, across(line.to) - start);
  if ((from_off < 0 && to_off < 0) || (from_off > 0 && to_off > 0)) return false;
  const float on_way = a_off / (a_off - b_off),
              on_line = from_off == to_off ? 0 : from_off / (from_off - to_off);
  return glm::mix(line.from.y, line.to.y, on_line) > glm::mix(a.y, b.y, on_way);
}

// Where outlines pass over a grid seen from the light.
class Outlines {
 public:
  /// `drop`: metres below an outline at which the disc throws its shadow aside by a cell.
  Outlines(std::span<const Line> lines, int width, int depth, float drop,
           std::pmr::memory_resource* memory)
      : lines_(lines),
        width_(width),
        depth_(depth),
        drop_(drop),
        height_(static_cast<std::size_t>(width * depth), -1e30f, memory),
        around_(height_.size(), memory),
        last_(memory),
        listed_(memory) {
    last_.assign(2 * height_.size(), kNone);
    for (std::uint32_t i = 0; i < lines_.size(); ++i)
      each_cell(lines_[i], [&](std::size_t cell, float height, bool over) {
        height_[cell] = std::max(height_[cell], height);
        list(i, over ? kOver : kBeside, cell, height);
      });
    if (last_.empty()) spread();
    find_around();
  }

  /// Whether nothing hides a part of the disc only at the places, and nothing passes between them: a first look.
  bool are_clear_of(const glm::vec3& a, const glm::vec3& b) const {
    const int x = static_cast<int>(a.x), z = static_cast<int>(a.z);
    return std::abs(static_cast<int>(b.x) - x) <= 1 && std::abs(static_cast<int>(b.z) - z) <= 1 &&
           around_[index(x, z)] < std::min(a.y, b.y);
  }
  /// Whether an outline hides a part of the disc only. False where pass_between() tells it of every way from there.
  bool in_penumbra(const glm::vec3& p) const {
    if (last_.empty()) return false;
    const std::size_t cell = index(static_cast<int>(p.x), static_cast<int>(p.z));
    if (height_[cell] < p.y) return false;
    const auto hides_a_part = [&](const Line& line) {
      const glm::vec2 to_place = across(p) - across(line.from),
                      along = across(line.to) - across(line.from);
      const float square = glm::dot(along, along),
                  nearest =
                      square > 0 ? std::clamp(glm::dot(to_place, along) / square, 0.f, 1.f) : 0;
      // What is higher reaches farther.
      for (const float t : {nearest, 0.f, 1.f}) {
        const float above = glm::mix(line.from.y, line.to.y, t) - p.y,
                    reach = above / drop_ + kRounding;
        const glm::vec2 off = to_place - t * along;
        if (above > 0 && glm::dot(off, off) < reach * reach) return true;
      }
      return false;
    };
    return any_line(cell, kOver, p.y, hides_a_part) || any_line(cell, kBeside, p.y, hides_a_part);
  }
  /// in: places within the grid
  bool pass_between(const glm::vec3& a, const glm::vec3& b) const {
    if (last_.empty()) return any_cell(a, b, [](std::size_t) { return true; });
    return any_cell(a, b, [&](std::size_t cell) {
      return any_line(cell, kOver, std::min(a.y, b.y),
                      [&](const Line& line) { return passes_over(line, a, b); });
    });
  }

 private:
  static constexpr float kRounding = .02f;  // cells
  struct Listed {
    std::uint32_t line, before;
    float height;
  };
  static constexpr std::uint32_t kNone = 0xffffffffu;

  // f(cell, height, over): how near to the light something has to be there that the line does not pass between it and any
  // part of the disc: where it is not over the cell itself only what is lower down is passed over.
  template <class F>
  void each_cell(const Line& line, F f) const {
    const float height = std::max(line.from.y, line.to.y), reach = std::min(1.f, height / drop_);
    const glm::vec2 a(across(line.from)), b(across(line.to)),
        low = glm::min(a, b), high = glm::max(a, b),
        end(static_cast<float>(width_) - 1, static_cast<float>(depth_) - 1);
    // What lies aside of the grid comes in at its rim.
    const glm::vec2 off = glm::max(glm::max(low - reach - end, -high - reach), 0.f);
    const float aside = std::max(off.x, off.y);
    if (!(height > drop_ * aside && aside < 1e9f)) return;
    const glm::ivec2 first(glm::clamp(low - reach - aside, glm::vec2(0), end)),
        last(glm::clamp(high + reach + aside, glm::vec2(0), end));
    for (int z = first.y; z <= last.y; ++z)
      for (int x = first.x; x <= last.x; ++x) {
        const glm::vec2 cell(x, z),
            apart = glm::max(glm::max(low - cell - 1.f, cell - high), kRounding) - kRounding;
        const float here = height - drop_ * std::max(apart.x, apart.y);
        if (here > 0) f(index(x, z), here, here == height);
      }
  }
  enum Where : std::size_t { kOver, kBeside };
  void list(std::uint32_t line, Where where, std::size_t cell, float height) {
    constexpr std::size_t kMost =
        32;  // over a cell in the mean: blinds of long slats would fill lists
    // What is so high reaches farther than the cells in which it is listed.
    if (height >= drop_ || listed_.size() > kMost * height_.size()) last_.clear();
    if (last_.empty()) return;
    listed_.push_back({line, last_[2 * cell + where], height});
    last_[2 * cell + where] = static_cast<std::uint32_t>(listed_.size() - 1);
  }
  // The most of a cell and those that touch it.
  void find_around() {
    std::pmr::vector<float> of_rows(height_, height_.get_allocator());
    for (int z = 0; z < depth_; ++z)
      for (int x = 0; x < width_; ++x)
        of_rows[index(x, z)] =
            std::max({height_[index(std::max(x - 1, 0), z)], height_[index(x, z)],
                      height_[index(std::min(x + 1, width_ - 1), z)]});
    for (int z = 0; z < depth_; ++z)
      for (int x = 0; x < width_; ++x)
        around_[index(x, z)] =
            std::max({of_rows[index(x, std::max(z - 1, 0))], of_rows[index(x, z)],
                      of_rows[index(x, std::min(z + 1, depth_ - 1))]});
  }
  // Below an outline the light comes from aside as well: cells further off are passed over lower down. Steps go aslant too,
  // so that no cell is left out.
  void spread() {
    for (int z = 0; z < depth_; ++z)
      for (int x = 0; x < width_; ++x) lift(x, z, -1);
    for (int z = depth_ - 1; z >= 0; --z)
      for (int x = width_ - 1; x >= 0; --x) lift(x, z, 1);
  }
  // From the neighbours that come earlier on the way.
  void lift(int x, int z, int way) {
    float& here = height_[index(x, z)];
    const auto from = [&](int i, int j) {
      if (i >= 0 && i < width_ && j >= 0 && j < depth_)
        here = std::max(here, height_[index(i, j)] - drop_);
    };
    from(x + way, z);
    for (int i = -1; i <= 1; ++i) from(x + i, z + way);
  }

  // Whether f(cell) is true for a cell between the places over which an outline passes.
  template <class F>
  bool any_cell(const glm::vec3& a, const glm::vec3& b, F f) const {
    const glm::vec3 low = glm::min(a, b), high = glm::max(a, b);
    for (int z = static_cast<int>(low.z); z <= static_cast<int>(high.z); ++z)
      for (int x = static_cast<int>(low.x); x <= static_cast<int>(high.x); ++x)
        if (height_[index(x, z)] >= low.y && f(index(x, z))) return true;
    return false;
  }
  // Of those listed in a cell that are higher than `low`.
  template <class F>
  bool any_line(std::size_t cell, Where where, float low, F f) const {
    for (std::uint32_t i = last_[2 * cell + where]; i != kNone; i = listed_[i].before)
      if (listed_[i].height >= low && f(lines_[listed_[i].line])) return true;
    return false;
  }
  std::size_t index(int x, int z) const { return static_cast<std::size_t>(z * width_ + x); }

  std::span<const Line> lines_;
  int width_, depth_;
  float drop_;
  std::pmr::vector<float> height_, around_;
  // Where no shadow is thrown aside by a cell: the lines over each cell, from its last one back. Else empty.
  std::pmr::vector<std::uint32_t> last_;
  std::pmr::vector<Listed> listed_;
};

// The outlines of casters where they are higher than the grid's foot.
void add_lines(std::span<const Caster> casters, const Pose& grid_from_world, float cell_m,
               const Beam& beam, OutlineMemo& memo, std::pmr::vector<Line>& out) {
  for (const Caster& c : casters) {
    const IntoGrid place(grid_from_world * c.world_from_mesh, cell_m);
    for (const std::uint32_t i : memo.find(*c.outline, c.world_from_mesh, beam).edges) {
      const Outline::Edge& e = c.outline->edges()[i];
      const Line line{place(c.mesh->positions[e.from]), place(c.mesh->positions[e.to])};
      if (line.from.y > 0 || line.to.y > 0) add_parts(line, out);
    }
  }
}

// The vertices of an object in front of the light, and what is above them.
class View {
 public:
  /// `behind`: cosines from which on a vertex is turned away from all of the disc.
  View(const Caster& object, const glm::vec3& towards, float behind, const IntoGrid& place,
       const Outlines& outlines, std::pmr::memory_resource* memory)
      : outlines_(outlines),
        places_(object.mesh->positions.size(), memory),
        sees_(places_.size(), kShut, memory) {
    for (std::size_t i = 0; i < places_.size(); ++i) {
      const float cosine = glm::dot(object.mesh->normals[i], towards);
      if (cosine < behind) sees_[i] = kNothing;
      if (!(cosine > 0)) continue;
      places_[i] = place(object.mesh->positions[i]);
      sees_[i] = kUnknown;
    }
  }
  bool is_turned_away(std::size_t i) const { return sees_[i] == kNothing; }
  /// False of vertices whose middle of the disc is behind them, or known to lie in a penumbra.
  bool may_share(std::uint32_t i) const { return sees_[i] >= kUnknown; }
  /// in: vertices that may share
  bool see_alike(std::uint32_t a, std::uint32_t b) {
    return outlines_.are_clear_of(places_[a], places_[b]) ||
           (is_open(a) && is_open(b) && !outlines_.pass_between(places_[a], places_[b]));
  }

 private:
  static constexpr char kNothing = 0, kShut = 1, kUnknown = 2, kOpen = 3;
  bool is_open(std::uint32_t i) {
    if (sees_[i] == kUnknown) sees_[i] = outlines_.in_penumbra(places_[i]) ? kShut : kOpen;
    return sees_[i] == kOpen;
  }

  const Outlines& outlines_;
  std::pmr::vector<glm::vec3> places_;
  std::pmr::vector<char> sees_;
};

// A grid over an object as the light sees it; y towards the light.
struct LightGrid {
  Pose grid_from_world;
  float cell_m;
  int width, depth;
};
// Outlines lower than its foot shade none of the object. Nothing for an object that is a point.
std::optional<LightGrid> grid_over(const Caster& object, const glm::dvec3& towards) {
  const Pose light_from_world =
                 Pose{glm::rotation(glm::dvec3(0, 1, 0), towards), {0, 0, 0}}.inverse(),
             light_from_mesh = light_from_world * object.world_from_mesh;
  const Box box = turned(object.outline->bounds(), glm::mat3(light_from_mesh.rotation_matrix()));
  const glm::vec3 size = box.high - box.low;
  const float cell =
      std::max(object.outline->mean_length_m(), std::max(size.x, size.z) / kMostCells);
  if (!(cell > 0)) return std::nullopt;
  const Pose grid_from_light{{1, 0, 0, 0},
                             glm::dvec3(cell) - glm::dvec3(box.low) - light_from_mesh.translation};
  return LightGrid{grid_from_light * light_from_world, cell, static_cast<int>(size.x / cell) + 3,
                   static_cast<int>(size.z / cell) + 3};
}

}  // namespace

void SharedSight::find(const Casters& casters, const Caster& object, const lighting::Disc& disc) {
  const Outline& outline = *object.outline;
  group_.assign(object.mesh->positions.size(), kAlone);
  members_.clear();
  may_be_cut_ = !outline.knows_cuts() || others_reach(casters.virtual_things, object) ||
                others_reach(casters.real_things, object);
  const double angle = largest_angle(disc);
  if (angle > kWidest || outline.edges().empty()) return;
  const auto grid = grid_over(object, disc.direction);
  if (!grid) return;
  const Scratch::Scope scope;
  const Beam beam = beam_of(disc);
  OutlineMemo& memo = memo_of(casters);
  std::pmr::vector<Line> lines(scope.memory());
  for (const auto& things : {casters.virtual_things, casters.real_things})
    add_lines(things, grid->grid_from_world, grid->cell_m, beam, memo, lines);
  const Outlines outlines(lines, grid->width, grid->depth,
                          static_cast<float>(grid->cell_m / std::tan(std::max(angle, 1e-6))),
                          scope.memory());
  const glm::vec3 towards =
      glm::transpose(object.world_from_mesh.rotation_matrix()) * disc.direction;
  const auto behind = -static_cast<float>(std::sin(angle)) - kCosineRounding;
  View view(object, towards, behind,
            IntoGrid(grid->grid_from_world * object.world_from_mesh, grid->cell_m), outlines,
            scope.memory());
  for (std::size_t i = 0; i < group_.size(); ++i)
    if (view.is_turned_away(i)) group_[i] = kTurnedAway;
  join_all(outline, memo.find(outline, object.world_from_mesh, beam).faces, towards, view);
}

template <class View>
void SharedSight::join_all(const Outline& outline, std::span<const std::uint8_t> faces,
                           const glm::vec3& towards, View& view) {
  // Of triangles that are turned away one end may lie in their own shadow.
  const auto is_in_front = [&](const Outline::Edge& e) {
    return faces[e.left] != kFacesNone ||
           (e.right != Outline::kOpen && faces[e.right] != kFacesNone);
  };
  // Edges come in the order of their lower vertex: it has its group when it is joined to others.
  for (std::size_t p = 0; p < outline.patches().size(); ++p) {
    const Outline::Patch& patch = outline.patches()[p];
    if (glm::dot(patch.axis, towards) < -patch.sine) continue;
    const std::span<const Outline::Edge> edges = outline.edges_of(p);
    for (std::size_t i = 0; i < edges.size(); ++i) {
      const std::uint32_t first = std::min(edges[i].from, edges[i].to),
                          second = std::max(edges[i].from, edges[i].to);
      if (view.may_share(first) && view.may_share(second) && group_[second] == kAlone &&
          is_in_front(edges[i]) && !outline.is_cut(p * Outline::kTogether + i) &&
          view.see_alike(first, second))
        join(first, second);
    }
  }
}

void SharedSight::join(std::uint32_t first, std::uint32_t second) {
  if (group_[first] == kAlone) {
    group_[first] = static_cast<std::uint32_t>(groups());
    members_.insert(members_.end(), {first, second});
  }
  group_[second] = group_[first];
  members_[2 * group_[first] + 1] = second;
}

}  // namespace penumbra::shadows
