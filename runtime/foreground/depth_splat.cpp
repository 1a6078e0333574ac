#include "runtime/foreground/internal/depth_splat.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <ranges>

#include "core/conventions.h"
#include "runtime/foreground/internal/depth_rows.h"

namespace penumbra::runtime {

namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();

// Those of which the camera sees the upper side.
std::vector<SeenPlane> seen_planes(std::span<const prt::Plane> planes,
                                   const Pose& world_from_depth) {
  std::vector<SeenPlane> out;
  for (const prt::Plane& p : planes) {
    const double eye = glm::dot(p.normal, world_from_depth.translation - p.point);
    if (eye <= 0) continue;
    out.push_back(
        {glm::vec3(glm::conjugate(world_from_depth.rotation) * p.normal), static_cast<float>(eye)});
  }
  return out;
}

// Holes wider than this part of a row are left: what is behind them nobody knows.
constexpr int kMaxHole = 8;

// Each hole gets the farther of its row's neighbours.
void fill_holes(std::span<float> row) {
  const int width = static_cast<int>(row.size());
  const auto at = [&](int x) -> float& { return row[static_cast<std::size_t>(x)]; };
  for (int x = 0; x < width;) {
    if (at(x) > 0) {
      ++x;
      continue;
    }
    int end = x;
    while (end < width && !(at(end) > 0)) ++end;
    const float left = x > 0 ? at(x - 1) : 0, right = end < width ? at(end) : 0;
    // At the rim of the picture nothing tells of the other side.
    const float fill =
        left > 0 && right > 0 && end - x <= width / kMaxHole ? std::max(left, right) : 0;
    std::fill(row.begin() + x, row.begin() + end, fill);
    x = end;
  }
}

// As 0: what cameras give where they know nothing.
constexpr std::uint16_t kNoDepth = 65535;

void load_depth(const Image<Rgb16>& codes, float unit_m, Image<float>& out) {
  if (!out.same_size(codes)) out.reset(codes.width(), codes.height());
  for (int y = 0; y < out.height(); ++y) {
    const auto from = codes.row(y);
    const auto to = out.row(y);
    for (std::size_t x = 0; x < from.size(); ++x)
      to[x] = from[x].r < kNoDepth ? unit_m * static_cast<float>(from[x].r) : 0;
    fill_holes(to);
  }
}

void keep_rows_in_front(const Image<float>& depth, std::span<const SeenPlane> planes,
                        const DepthRays& rays, DepthFront& out) {
  if (!out.depth_m.same_size(depth)) out.depth_m.reset(depth.width(), depth.height());
  out.area = {};
  for (int y = 0; y < depth.height(); ++y) {
    const auto front = out.depth_m.row(y);
    keep_in_front({depth.row(std::max(y - 1, 0)), depth.row(y),
                   depth.row(std::min(y + 1, depth.height() - 1)), rays.x.row(y), rays.y.row(y)},
                  planes, front);
    const auto is_there = [](float d) { return d > 0; };
    const auto begin = std::ranges::find_if(front, is_there);
    if (begin == front.end()) continue;
    const auto end = std::ranges::find_if(front | std::views::reverse, is_there).base();
    out.area = compositor::united(out.area, {static_cast<int>(begin - front.begin()), y,
                                             static_cast<int>(end - front.begin()), y + 1});
  }
}

// A pixel that is unlike all of its neighbours but one errs. The rim of what is in front is left.
void drop_specks(DepthFront& out_front) {
  constexpr int kMaxAlike = 1;
  Image<float>&front = out_front.depth_m, &before = out_front.scratch;
  const compositor::Rect r =
      compositor::common(out_front.area, {1, 1, front.width() - 1, front.height() - 1});
  if (r.empty()) return;
  for (int y = r.y0 - 1; y <= r.y1; ++y) std::ranges::copy(front.row(y), before.row(y).begin());
  for (int y = r.y0; y < r.y1; ++y) {
    const auto above = before.row(y - 1), here = before.row(y), below = before.row(y + 1);
    const auto out = front.row(y);
    for (auto x = static_cast<std::size_t>(r.x0); x < static_cast<std::size_t>(r.x1); ++x) {
      const bool there = here[x] > 0;
      // Most are like those above and below them.
      if ((above[x] > 0) == there && (below[x] > 0) == there) continue;
      const float around[] = {above[x - 1], above[x],     above[x + 1], here[x - 1],
                              here[x + 1],  below[x - 1], below[x],     below[x + 1]};
      int in_front = 0;
      float farthest = 0;
      for (const float d : around) in_front += d > 0, farthest = std::max(farthest, d);
      if (there && in_front <= kMaxAlike) out[x] = 0;
      if (!there && in_front >= 8 - kMaxAlike) out[x] = farthest;
    }
  }
}

// Where the pixels of a row of what is in front lie in the view.
void project(const SplatView& view, const Pose& view_from_depth, const DepthFront& front,
             const DepthRays& rays, int y, SplatRow& out) {
  const auto first = static_cast<std::size_t>(front.area.x0),
             count = static_cast<std::size_t>(front.area.width());
  const auto depth = front.depth_m.row(y).subspan(first, count),
             ray_x = rays.x.row(y).subspan(first, count),
             ray_y = rays.y.row(y).subspan(first, count);
  for (auto* v : {&out.x_px, &out.y_px, &out.distance_m}) v->resize(count);
  if (!view.lens)
    return project_row(
        {glm::mat3(view_from_depth.rotation_matrix()), glm::vec3(view_from_depth.translation),
         glm::vec2(view.camera.focal_px), glm::vec2(view.camera.principal_px)},
        {{}, depth, {}, ray_x, ray_y}, {out.x_px, out.y_px, out.distance_m});
  for (std::size_t i = 0; i < count; ++i) {
    out.distance_m[i] = 0;
    if (!(depth[i] > 0)) continue;
    const glm::dvec3 p = view_from_depth * (double(depth[i]) * glm::dvec3(ray_x[i], ray_y[i], -1));
    if (view.lens->is_beside(p)) continue;
    const glm::dvec2 px = view.lens->pixel(p);
    out.x_px[i] = static_cast<float>(px.x), out.y_px[i] = static_cast<float>(px.y);
    out.distance_m[i] = static_cast<float>(glm::length(p));
  }
}

// Whether a point that project() gave is farther from the eye than anything that it could hide.
class Beyond {
 public:
  explicit Beyond(const SplatView& view)
      : through_lens_(view.lens != nullptr),
        principal_(view.camera.principal_px),
        per_focal_(1. / view.camera.focal_px),
        max_squared_(view.max_distance_m * view.max_distance_m) {}

  bool operator()(float x_px, float y_px, float distance_m) const {
    const glm::vec2 slope = (glm::vec2(x_px, y_px) - principal_) * per_focal_;
    const float stretch = through_lens_ ? 1 : 1 + glm::dot(slope, slope);
    return distance_m * distance_m * stretch > max_squared_;
  }

 private:
  bool through_lens_;
  glm::vec2 principal_, per_focal_;
  float max_squared_;
};

// Fills squares of a view's picture, each with its distance.
class SquareFiller {
 public:
  explicit SquareFiller(Image<float>& distance_m) : distance_m_(distance_m) {}

  void cover(float x_px, float y_px, float side_px, float distance_m) {
    const float half = .5f * side_px;
    const int width = distance_m_.width(), height = distance_m_.height();
    const int x0 = from(x_px - half, width), x1 = from(x_px + half, width),
              y0 = from(y_px - half, height), y1 = from(y_px + half, height);
    for (int y = y0; y < y1; ++y) {
      float* const row = &distance_m_.at(0, y);
      for (int x = x0; x < x1; ++x) row[x] = std::min(row[x], distance_m);
    }
    if (x0 >= x1 || y0 >= y1) return;
    x0_ = std::min(x0_, x0), x1_ = std::max(x1_, x1);
    y0_ = std::min(y0_, y0), y1_ = std::max(y1_, y1);
  }
  compositor::Rect area() const {
    return x0_ < x1_ ? compositor::Rect{x0_, y0_, x1_, y1_} : compositor::Rect{};
  }

 private:
  // The first pixel whose centre is not before v; casts round down what is above 0.
  static int from(float v, int size) {
    return static_cast<int>(std::clamp(v + .5f, 0.f, static_cast<float>(size)));
  }

  Image<float>& distance_m_;
  int x0_ = std::numeric_limits<int>::max(), y0_ = x0_, x1_ = 0, y1_ = 0;
};

// Cracks of a pixel between splats.
void close_cracks(Silhouettes& out) {
  Image<float>& d = out.distance_m;
  const compositor::Rect inner =
      compositor::common(out.area, {1, 1, d.width() - 1, d.height() - 1});
  for (int y = inner.y0; y < inner.y1; ++y)
    for (int x = inner.x0; x < inner.x1; ++x) {
      if (d.at(x, y) < Silhouettes::kNothing) continue;
      const float across = std::max(d.at(x - 1, y), d.at(x + 1, y)),
                  along = std::max(d.at(x, y - 1), d.at(x, y + 1));
      d.at(x, y) = std::min(across, along);
    }
}

}  // namespace

Result<DepthRays> DepthRays::create(const calib::CameraModel& camera) {
  const double min_cosine = std::cos(85 * kPi / 180);
  if (!(camera.focal_px.x >= 1 && camera.focal_px.y >= 1))
    return fail(ErrorCode::kInvalid, "projection",
                "has no focal length of a pixel or more, which a depth camera needs");
  DepthRays out{Image<float>(camera.width, camera.height, kNone),
                Image<float>(camera.width, camera.height, kNone),
                static_cast<float>(camera.focal_px.x)};
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const auto ray = calib::direction_from_pixel(camera, {x + .5, y + .5});
      if (!ray) continue;
      if (-ray->z < min_cosine * glm::length(*ray))
        return fail(ErrorCode::kInvalid, "projection",
                    "sees more than 170 degrees, where depth along an axis tells nothing");
      out.x.at(x, y) = static_cast<float>(ray->x / -ray->z);
      out.y.at(x, y) = static_cast<float>(ray->y / -ray->z);
    }
  return out;
}

void Silhouettes::reset(int width, int height) {
  distance_m.reset(width, height, kNothing);
  has_mask = has_depth = false;
  area = {};
  blur_px = 0;
}

void find_front(const Image<Rgb16>& codes, float unit_m, const DepthRays& rays,
                const Pose& world_from_camera, std::span<const prt::Plane> planes,
                DepthFront& out) {
  out.world_from_camera = world_from_camera;
  load_depth(codes, unit_m, out.scratch);
  keep_rows_in_front(out.scratch, seen_planes(planes, world_from_camera), rays, out);
  drop_specks(out);
}

void splat_depth(const DepthFront& front, const DepthRays& rays, const SplatView& view,
                 SplatRow& scratch, Silhouettes& out) {
  constexpr float kOverlap = 1.15f, kBlur = 1.5f;  // of a depth pixel
  constexpr float kMaxSide_px = 40, kMaxBlur_px = Silhouettes::kMaxBlur_px;
  const Pose view_from_depth = view.world_from_camera.inverse() * front.world_from_camera;
  const float scale = static_cast<float>(view.camera.focal_px.x) / rays.focal_px;
  const Beyond beyond(view);
  SquareFiller squares(out.distance_m);
  double areas = 0, volumes = 0;  // of all sides
  for (int y = front.area.y0; y < front.area.y1; ++y) {
    project(view, view_from_depth, front, rays, y, scratch);
    const auto row = front.depth_m.row(y).subspan(static_cast<std::size_t>(front.area.x0));
    float row_areas = 0, row_volumes = 0;
    for (std::size_t i = 0; i < scratch.distance_m.size(); ++i) {
      const float x = scratch.x_px[i], y_px = scratch.y_px[i], w = scratch.distance_m[i];
      if (!(w > 0) || beyond(x, y_px, w)) continue;
      const float side = std::min(scale * row[i] / w, kMaxSide_px), area = side * side;
      row_areas += area, row_volumes += area * side;
      squares.cover(x, y_px, kOverlap * side, w);
    }
    areas += double(row_areas), volumes += double(row_volumes);
  }
  out.area = compositor::united(out.area, squares.area());
  close_cracks(out);
  out.has_depth = true;
  // By area: a few near pixels make no edge uncertain but their own.
  const float mean = areas > 0 ? static_cast<float>(volumes / areas) : 0;
  out.blur_px = std::max(out.blur_px, std::min(kBlur * std::max(mean, 1.f), kMaxBlur_px));
}

namespace {

float fraction(const Rgb8& p) {
  return static_cast<float>(p.r) / 255.f;
}
float fraction(const Rgb16& p) {
  return static_cast<float>(p.r) / 65535.f;
}

}  // namespace

namespace {

// Between two pixels of a row or a column, the first of which `at` is; beyond the rim it goes on.
struct Between {
  std::size_t at, next;
  float part;  // of the next
};
Between between(double place, int size) {
  const double inside = std::clamp(place - .5, 0., size - 1.);
  const auto at = static_cast<std::size_t>(inside);
  return {at, std::min(at + 1, static_cast<std::size_t>(size) - 1),
          static_cast<float>(inside - std::floor(inside))};
}

}  // namespace

template <class Pixel>
void lay_mask(const Image<Pixel>& mask, Silhouettes& out) {
  const int width = out.distance_m.width(), height = out.distance_m.height();
  if (!out.has_mask) out.cover.reset(width, height, 0);
  out.has_mask = true;
  const double sx = double(mask.width()) / width, sy = double(mask.height()) / height;
  bool solid = false;  // else there is no edge to look for
  std::vector<Between> columns;
  for (int x = 0; x < width; ++x) columns.push_back(between((x + .5) * sx, mask.width()));
  for (int y = 0; y < height; ++y) {
    const Between rows = between((y + .5) * sy, mask.height());
    const auto above = mask.row(static_cast<int>(rows.at)),
               below = mask.row(static_cast<int>(rows.next));
    const auto cover = out.cover.row(y), distance = out.distance_m.row(y);
    int first = width, last = -1;
    for (int x = 0; x < width; ++x) {
      const auto i = static_cast<std::size_t>(x);
      const Between& c = columns[i];
      const auto mix = [](float a, float b, float part) { return a + part * (b - a); };
      const float here =
          mix(mix(fraction(above[c.at]), fraction(above[c.next]), c.part),
              mix(fraction(below[c.at]), fraction(below[c.next]), c.part), rows.part);
      if (!(here > 0)) continue;
      cover[i] = std::max(cover[i], here);
      if (here >= .5f) distance[i] = 0, solid = true;
      first = std::min(first, x), last = x;
    }
    if (last >= first) out.area = compositor::united(out.area, {first, y, last + 1, y + 1});
  }
  if (!solid) return;
  const auto blur = static_cast<float>(1.5 / std::min({sx, sy, 1.}));
  out.blur_px = std::max(out.blur_px, std::min(blur, Silhouettes::kMaxBlur_px));
}

template void lay_mask(const Image<Rgb8>& mask, Silhouettes& out);
template void lay_mask(const Image<Rgb16>& mask, Silhouettes& out);

}  // namespace penumbra::runtime
