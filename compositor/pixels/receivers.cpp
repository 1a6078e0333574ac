#include "compositor/pixels/receivers.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace penumbra::compositor {

namespace {
// Where real things take more than 95 % of the light the ratio has no footing.
constexpr float kMinLeft = .05f;
}  // namespace

int Receivers::add(const prt::GroundGrid& grid) {
  ++changes_;
  receivers_.push_back({grid, {}, {}, {}, {}, false});
  return static_cast<int>(receivers_.size()) - 1;
}

void Receivers::set_pose(int receiver, const Pose& world_from_bake) {
  Pose& pose = receivers_[static_cast<std::size_t>(receiver)].world_from_bake;
  if (pose == world_from_bake) return;
  ++changes_;
  pose = world_from_bake;
}

void Receivers::show(int receiver, bool visible) {
  bool& shown = receivers_[static_cast<std::size_t>(receiver)].visible;
  if (std::exchange(shown, visible) != visible) ++changes_;
}

void Receivers::add_real(const prt::GroundGrid& grid, const Pose& world_from_bake) {
  real_ = FloorReceiver{grid, world_from_bake, {}, {}, {}, false};
}

namespace {

void take(const shadows::PlanarShadow& shadow, const Rgb& of_open, auto& r) {
  r.has_shadow = !shadow.empty();
  if (!r.has_shadow) return;
  if (!r.ratio.same_size(shadow.ratio))
    r.ratio = Image<std::uint32_t>(shadow.ratio.width(), shadow.ratio.height());
  const bool all = of_open == Rgb{1, 1, 1};
  std::ranges::transform(shadow.ratio.pixels(), r.ratio.pixels().begin(), [&](const Rgb& ratio) {
    if (all) return PackedRatio::pack(ratio);
    Rgb of_the_open;
    for (int c = 0; c < 3; ++c) of_the_open[c] = std::max(0.f, 1 - of_open[c] * (1 - ratio[c]));
    return PackedRatio::pack(of_the_open);
  });
  // One texel more on each side: bilinear reads reach half a texel out.
  const auto at = [&](int x, int y) {
    const auto size = static_cast<float>(r.grid.size);
    return glm::dvec2(r.grid.position({static_cast<float>(std::clamp(x, 0, r.grid.size)) / size,
                                       static_cast<float>(std::clamp(y, 0, r.grid.size)) / size}));
  };
  r.low = at(shadow.x0 - 1, shadow.y0 - 1);
  r.high = at(shadow.x1 + 1, shadow.y1 + 1);
}

}  // namespace

void Receivers::set_shadow(int receiver, const shadows::PlanarShadow& shadow, const Rgb& of_open) {
  ++changes_;
  take(shadow, of_open, receivers_[static_cast<std::size_t>(receiver)]);
}

void Receivers::set_real_shadow(const shadows::PlanarShadow& shadow) {
  if (real_) take(shadow, {1, 1, 1}, *real_);
}

void Receivers::set_shadow_maps(std::span<const ShadowMapOnPlane> lights) {
  ++changes_;
  lights_.resize(lights.size());
  real_shadow_maps_.clear();
  for (std::size_t i = 0; i < lights.size(); ++i) {
    lights_[i].shadow = *lights[i].shadow;
    lights_[i].fraction = lights[i].part;
    lights_[i].real = -1;
    if (!lights[i].real || lights[i].real->empty()) continue;
    auto known = std::ranges::find(real_shadow_maps_, lights[i].real, &RealShadowMap::source);
    if (known == real_shadow_maps_.end())
      known = real_shadow_maps_.insert(known, {lights[i].real, *lights[i].real, lights[i].part});
    lights_[i].real = static_cast<int>(known - real_shadow_maps_.begin());
  }
}

namespace {

// Ray through pixel (px, py): d = R (a px + b, c py + e, -1) in the map's frame, all linear in the
// pixel; through a lens d = R ray. It meets the plane y = height at o + d (height - o.y)/d.y, hence
// x = (o.x d.y + (height - o.y) d.x)/d.y. In units of `unit_m` from (x0, z0).
Homography homography(const View& view, const Pose& map_from_camera, double height,
                      glm::dvec2 origin, double unit_m) {
  const prt::PinholeView& v = view.camera;
  const glm::dmat3 r = map_from_camera.rotation_matrix();
  const glm::dvec3 o = map_from_camera.translation;
  glm::dvec3 ray[3] = {
      r[0] / v.focal_px.x, r[1] * (-1 / v.focal_px.y),
      -r[0] * (v.principal_px.x / v.focal_px.x) + r[1] * (v.principal_px.y / v.focal_px.y) - r[2]};
  if (view.lens) std::copy_n(&r[0], 3, ray);
  const double drop = height - o.y, sign = drop < 0 ? -1 : 1;
  Homography out;
  for (int k = 0; k < 3; ++k) {
    const double w = sign * ray[k].y;  // positive in front of the camera
    out.h[0][k] = static_cast<float>(((o.x - origin.x) * w + sign * drop * ray[k].x) / unit_m);
    out.h[1][k] = static_cast<float>(((o.z - origin.y) * w + sign * drop * ray[k].z) / unit_m);
    out.h[2][k] = static_cast<float>(w);
  }
  return out;
}

ShadowMapLookup shadow_lookup(const View& view, const shadows::ShadowMap& shadow,
                              const Image<float>& nodes, int samples, const Rgb& fraction,
                              const Rect& area) {
  return {.at = homography(view, shadow.world_from_map.inverse() * view.camera.world_from_camera, 0,
                           {0, 0}, shadow.cell_m),
          .nodes = nodes.pixels().data(),
          .width = nodes.width(),
          .height = nodes.height(),
          .samples = samples,
          .fraction = fraction,
          .area = area,
          .lens = view.lens.get()};
}

}  // namespace

void Receivers::find_visible_part(const View& view, const Homography& at, const glm::dvec3& point,
                                  const glm::dvec3& normal, const glm::dvec2& low,
                                  const glm::dvec2& high, const Rect& area, Sides& out) {
  out.first = half_images_.size();
  find_visible(view, point, normal);
  out.exact = half_images_.size() - out.first;
  add_sides(at, low, high);
  out.count = half_images_.size() - out.first;
  if (lens_) find_bands(area, out);
}

bool Receivers::prepare_lookup(const View& view, const ViewProjection& from_world,
                               const FloorReceiver& r, PlaneLookup& lookup) {
  if (!r.has_shadow || !r.visible) return false;
  const double h = r.grid.height;
  const glm::dvec3 corners[4] = {{r.low.x, h, r.low.y},
                                 {r.high.x, h, r.low.y},
                                 {r.low.x, h, r.high.y},
                                 {r.high.x, h, r.high.y}};
  lookup.area = from_world.of(r.world_from_bake).reach(corners);
  if (lookup.area.empty()) return false;
  lookup.ratio = r.ratio.pixels().data();
  lookup.size = r.grid.size;
  lookup.lens = view.lens.get();
  lookup.at = homography(view, r.world_from_bake.inverse() * view.camera.world_from_camera, h,
                         {r.grid.centre.x, r.grid.centre.y}, r.grid.half_extent);
  const glm::dvec2 centre(r.grid.centre.x, r.grid.centre.y);
  const double half = r.grid.half_extent;
  find_visible_part(view, lookup.at, r.world_from_bake * glm::dvec3(0, h, 0),
                    r.world_from_bake.rotation * glm::dvec3(0, 1, 0), (r.low - centre) / half,
                    (r.high - centre) / half, lookup.area, lookup.visible);
  return true;
}

Rect Receivers::prepare(const View& view) {
  lens_ = view.lens.get();
  bands_.clear();
  lookups_.clear();
  virtual_occlusion_.clear();
  real_occlusion_.clear();
  fine_missing_.clear();
  half_images_.clear();
  Rect all;
  const ViewProjection from_world(view.camera, view.lens.get());
  PlaneLookup lookup;
  for (const FloorReceiver& r : receivers_) {
    if (!prepare_lookup(view, from_world, r, lookup)) continue;
    lookups_.push_back(lookup);
    all = united(all, lookup.area);
  }
  real_lookup_.reset();
  if (real_ && prepare_lookup(view, from_world, *real_, lookup)) real_lookup_ = lookup;
  const auto source_area = [&](const shadows::ShadowMap& s) {
    const double x = (s.virtual_occlusion.width() - 1) * double(s.cell_m),
                 z = (s.virtual_occlusion.height() - 1) * double(s.cell_m);
    const glm::dvec3 corners[4] = {{0, 0, 0}, {x, 0, 0}, {0, 0, z}, {x, 0, z}};
    return from_world.of(s.world_from_map).reach(corners);
  };
  const auto look_up = [&](const shadows::ShadowMap& s, const Image<float>& nodes,
                           const Rgb& fraction, const Rect& area) {
    ShadowMapLookup out = shadow_lookup(view, s, nodes, samples_, fraction, area);
    find_visible_part(view, out.at, s.world_from_map.translation,
                      s.world_from_map.rotation * glm::dvec3(0, 1, 0), {0, 0},
                      {nodes.width() - 1, nodes.height() - 1}, area, out.visible);
    return out;
  };
  for (const RealShadowMap& d : real_shadow_maps_)
    real_occlusion_.push_back(
        look_up(d.shadow, d.shadow.virtual_occlusion, d.fraction, source_area(d.shadow)));
  for (const OnPlane& d : lights_) {
    const shadows::ShadowMap& s = d.shadow;
    if (s.empty()) continue;
    const Rect area = source_area(s);
    if (area.empty()) continue;
    virtual_occlusion_.push_back(look_up(s, s.virtual_occlusion, d.fraction, area));
    if (d.real >= 0 && !s.real_occlusion.empty())
      fine_missing_.push_back(
          {static_cast<std::size_t>(d.real), look_up(s, s.real_occlusion, d.fraction, area)});
    all = united(all, area);
  }
  return all;
}

// 1/t along the ray of a pixel to a plane is (n.d)/(n.(p - eye)): linear in the pixel, and largest
// for the nearest plane.
void Receivers::find_visible(const View& from, const glm::dvec3& point, const glm::dvec3& normal) {
  constexpr double kSame = 1e-6;
  const prt::PinholeView& view = from.camera;
  const glm::dmat3 turn = view.world_from_camera.rotation_matrix();
  const auto nearness = [&](const glm::dvec3& p, const glm::dvec3& n) {
    const double height = glm::dot(n, p - view.world_from_camera.translation);
    const glm::dvec3 m = glm::transpose(turn) * n / (std::abs(height) > 1e-12 ? height : 1e-12);
    if (from.lens) return HalfImage{m.x, m.y, m.z};
    return HalfImage{m.x / view.focal_px.x, -m.y / view.focal_px.y,
                     -m.x * view.principal_px.x / view.focal_px.x +
                         m.y * view.principal_px.y / view.focal_px.y - m.z};
  };
  const HalfImage own = nearness(point, normal);
  for (const ReceiverPlane& other : planes_) {
    // Seen from behind a plane hides nothing; the plane itself is no other.
    if (glm::dot(other.normal, view.world_from_camera.translation - other.point) <= 0) continue;
    if (glm::dot(other.normal, normal) > 1 - kSame &&
        std::abs(glm::dot(normal, other.point - point)) < 1e-3)
      continue;
    const HalfImage there = nearness(other.point, other.normal);
    half_images_.push_back({own.a - there.a, own.b - there.b, own.c - there.c});
  }
}

// (x, z) = (X, Z)/W is at or past a side where X - side W >= 0 in front of the camera: linear in
// the pixel. Half a pixel more, for those that a side passes through; through a lens as much as
// lies between two nodes of its grid, of rays that turn up to twice as fast as on the axis.
void Receivers::add_sides(const Homography& at, const glm::dvec2& low, const glm::dvec2& high) {
  const auto past = [&](int axis, double side, double sign) {
    const auto term = [&](int k) { return sign * (at.h[axis][k] - side * at.h[2][k]); };
    HalfImage half{term(0), term(1), term(2)};
    if (lens_) {
      const glm::dvec2& focal = lens_->model().focal_px;
      half.margin = 2 * ViewLens::kCell / std::min(focal.x, focal.y) *
                    (std::abs(half.a) + std::abs(half.b) + std::abs(half.c));
    } else {
      half.c += .5 * (std::abs(half.a) + std::abs(half.b));
    }
    half_images_.push_back(half);
  };
  for (const int axis : {0, 1}) {
    past(axis, low[axis], 1);
    past(axis, high[axis], -1);
  }
}

Rect Receivers::reach_in_row(int y) const {
  Rect all;
  const auto add = [&](const auto& lookup) {
    if (y < lookup.area.y0 || y >= lookup.area.y1) return;
    const Columns c = visible_columns(lookup.visible, y, lookup.area);
    all = united(all, {c.x0, y, c.x1, y + 1});
  };
  std::ranges::for_each(lookups_, add);
  std::ranges::for_each(virtual_occlusion_, add);
  return all;
}

namespace {

// Of the row within `area`; nothing outside.
template <class Columns>
Columns within(Columns c, const Rect& area) {
  return {std::max(c.x0, area.x0), std::min(c.x1, area.x1)};
}

}  // namespace

// Between the nodes above and below; a cell more on each side.
void Receivers::find_bands(const Rect& area, Sides& sides) {
  constexpr int kCell = ViewLens::kCell;
  const std::size_t columns = lens_->columns();
  const std::span own = std::span(half_images_).subspan(sides.first, sides.count);
  const auto seen = [&](std::size_t node) {
    const double x = lens_->ray_x()[node], y = lens_->ray_y()[node], z = lens_->ray_z()[node];
    return std::ranges::all_of(
        own, [&](const HalfImage& h) { return h.a * x + h.b * y + h.c * z + h.margin >= 0; });
  };
  sides.bands = bands_.size();
  for (int band = area.y0 / kCell; band * kCell < area.y1; ++band) {
    const std::size_t above = static_cast<std::size_t>(band) * columns;
    const auto any = [&](int node) {
      const std::size_t n = above + static_cast<std::size_t>(node);
      return seen(n) || seen(n + columns);
    };
    int first = area.x0 / kCell, last = area.x1 / kCell + 1;
    while (first <= last && !any(first)) ++first;
    while (last > first && !any(last)) --last;
    bands_.push_back(first > last ? Columns{0, 0}
                                  : Columns{(first - 1) * kCell, (last + 1) * kCell});
  }
}

Receivers::Columns Receivers::visible_columns(const Sides& sides, int y, const Rect& area) const {
  if (lens_)
    return within(bands_[sides.bands +
                         static_cast<std::size_t>(y / ViewLens::kCell - area.y0 / ViewLens::kCell)],
                  area);
  double first = area.x0, last = area.x1;
  for (const HalfImage& h : std::span(half_images_).subspan(sides.first, sides.count)) {
    const double residual = h.b * (y + .5) + h.c;
    if (std::abs(h.a) < 1e-15) {
      if (residual < 0) return {0, 0};
      continue;
    }
    const double edge = -residual / h.a - .5;  // of the first, or the last, pixel centre inside
    if (h.a > 0)
      first = std::max(first, std::ceil(edge));
    else
      last = std::min(last, std::floor(edge) + 1);
  }
  if (first >= last) return {0, 0};
  return {static_cast<int>(first), static_cast<int>(last)};
}

// Before a lens other planes may hide any part of the row.
template <class Lookup, class Body>
void Receivers::for_visible(const Lookup& lookup, int y, const Rect& area, const Body& body) const {
  if (y < lookup.area.y0 || y >= lookup.area.y1) return;
  const Columns c = within(visible_columns(lookup.visible, y, lookup.area), area);
  if (c.x0 >= c.x1) return;
  if (!lens_ || lookup.visible.exact == 0) return body(c);
  thread_local std::vector<float> least;  // grows once per thread
  const auto width = static_cast<std::size_t>(c.x1 - c.x0);
  least.resize(std::max(least.size(), width));
  load_least_side(*lens_,
                  std::span(half_images_).subspan(lookup.visible.first, lookup.visible.exact), y,
                  c.x0, c.x1, least.data());
  for (std::size_t from = 0, to = 0; from < width; from = to + 1) {
    to = from;
    while (to < width && least[to] >= 0) ++to;
    if (to > from) body(Columns{c.x0 + static_cast<int>(from), c.x0 + static_cast<int>(to)});
  }
}

void Receivers::multiply(const PlaneLookup& plane, int y, const Rect& area, float* r, float* g,
                         float* b) const {
  for_visible(plane, y, area, [&](const Columns& c) {
    const int skip = c.x0 - area.x0;
    multiply_plane_ratios(plane, y, c.x0, c.x1, r + skip, g + skip, b + skip);
  });
}

bool Receivers::load_row(int y, const Rect& area, float* r, float* g, float* b) const {
  const auto in_row = [&](const auto& lookup) { return y >= lookup.area.y0 && y < lookup.area.y1; };
  const bool on_planes = std::ranges::any_of(lookups_, in_row),
             of_lights = std::ranges::any_of(virtual_occlusion_, in_row);
  if (area.empty() || (!on_planes && !of_lights)) return false;
  for (const PlaneLookup& plane : lookups_) multiply(plane, y, area, r, g, b);
  if (of_lights || real_lookup_ || !real_occlusion_.empty()) subtract_shadows(y, area, r, g, b);
  return true;
}

// Of each light its fine map where there is one, else the wide one.
void Receivers::take_missing(int y, const Rect& area, std::span<float> left) const {
  thread_local std::vector<float> row;  // grows once per thread
  const std::size_t width = left.size() / 3;
  for (std::size_t shadow_map = 0; shadow_map < real_occlusion_.size(); ++shadow_map) {
    row.assign(width, 0.f);
    const auto load = [&](const ShadowMapLookup& d) {
      for_visible(d, y, area, [&](const Columns& c) {
        load_shadow_values(d, y, c.x0, c.x1, &row[static_cast<std::size_t>(c.x0 - area.x0)]);
      });
    };
    load(real_occlusion_[shadow_map]);
    for (const FineLookup& fine : fine_missing_)
      if (fine.real == shadow_map) load(fine.map);
    const Rgb& fraction = real_occlusion_[shadow_map].fraction;
    for (std::size_t c = 0; c < 3; ++c)
      for (std::size_t x = 0; x < width; ++x)
        left[c * width + x] -= fraction[static_cast<int>(c)] * row[x];
  }
}

void Receivers::multiply_by_left(int y, const Rect& area, std::span<float> left) const {
  const std::size_t width = left.size() / 3;
  if (real_lookup_) multiply(*real_lookup_, y, area, &left[0], &left[width], &left[2 * width]);
  take_missing(y, area, left);
}

void Receivers::subtract_shadows(int y, const Rect& area, float* r, float* g, float* b) const {
  const auto subtract_taken = [&] {
    for (const ShadowMapLookup& d : virtual_occlusion_)
      for_visible(d, y, area, [&](const Columns& c) {
        const int skip = c.x0 - area.x0;
        subtract_shadow_fractions(d, y, c.x0, c.x1, r + skip, g + skip, b + skip);
      });
  };
  const auto width = static_cast<std::size_t>(area.width());
  float* const rows[] = {r, g, b};
  if (real_occlusion_.empty() && !real_lookup_) {
    subtract_taken();
  } else {
    thread_local std::vector<float> left;  // by real things; grows once per thread
    left.assign(3 * width, 1.f);
    subtract_taken();
    multiply_by_left(y, area, left);
    for (std::size_t c = 0; c < 3; ++c)
      for (std::size_t x = 0; x < width; ++x)
        rows[c][x] = 1 - (1 - rows[c][x]) / std::max(left[c * width + x], kMinLeft);
  }
  for (float* row : rows)
    for (std::size_t x = 0; x < width; ++x) row[x] = std::max(row[x], 0.f);
}

}  // namespace penumbra::compositor
