#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <glm/geometric.hpp>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/camera/internal/radial_lens.h"
#include "calib/camera/projection_table.h"
#include "core/conventions.h"

namespace penumbra::calib {
namespace {

std::size_t pixel_index(const ProjectionTable& table, int x, int y) {
  return static_cast<std::size_t>(y) * static_cast<std::size_t>(table.width) +
         static_cast<std::size_t>(x);
}

void set_cell(ProjectionTable& table, int x, int y, double solid_angle, double confidence) {
  const std::size_t n = pixel_index(table, x, y);
  table.solid_angle_sr[n] = static_cast<float>(std::max(0., solid_angle));
  table.confidence[n] = static_cast<float>(std::clamp(confidence, 0., 1.));
}

// ------------------------------------------------------------------------------- radial lenses
//
// dw = sin th dth dphi = d(1 - cos th) dphi. In the normalised plane q of RadialLens let
// F(rho) = 1 - cos th(rho), held constant outside the rim. The field F(rho)/rho^2 q has the
// divergence F'(rho)/rho = sin th th'/rho = dw/dA, and 0 outside the rim. So a pixel's solid angle
// is the flux of that field out of its four edges (Gauss). Pixels cut by the rim come out exactly,
// and an edge is integrated once for the two pixels it parts. The sum over the picture telescopes
// to 2 * (angle of the outer border) = 4 pi.

// Gauss-Legendre, four points, on -1..1: error below 1e-9 even where a pixel spans a radian.
constexpr std::array<double, 4> kNodes{-.8611363115940526, -.3399810435848563, .3399810435848563,
                                       .8611363115940526};
constexpr std::array<double, 4> kWeights{.3478548451374538, .6521451548625461, .6521451548625461,
                                         .3478548451374538};

/// Flux through the edge at distance `a` from the centre, from `s0` to `s1` along it:
/// Int F/(a^2 + s^2) a ds.
double edge_flux(const RadialLens& lens, double a, double s0, double s1) {
  if (a == 0) return 0;  // the field runs along such an edge
  const double chord2 = lens.rim() * lens.rim() - a * a;
  const double chord = chord2 > 0 ? std::sqrt(chord2) : 0;
  const double in0 = std::clamp(s0, -chord, chord), in1 = std::clamp(s1, -chord, chord);
  const double half = (in1 - in0) / 2, middle = (in1 + in0) / 2;
  double flux = 0;
  if (half > 0) {
    for (std::size_t k = 0; k < kNodes.size(); ++k) {
      const double s = middle + half * kNodes[k];
      flux += kWeights[k] * lens.flux_density(a * a + s * s);
    }
    flux *= a * half;
  }
  if (in0 != s0 ||
      in1 != s1)  // outside the rim F is constant, and Int a/(a^2 + s^2) ds = atan(s/a)
    flux += lens.flux_outside() *
            ((std::atan(s1 / a) - std::atan(in1 / a)) + (std::atan(in0 / a) - std::atan(s0 / a)));
  return flux;
}

/// Normalised corners of a pixel. y points down, which changes no flux.
struct PixelCorners {
  double x0, x1, y0, y1;
};

PixelCorners corners(const RadialLens& lens, int x, int y) {
  return {(x - lens.centre_px.x) / lens.focal_px.x, (x + 1 - lens.centre_px.x) / lens.focal_px.x,
          (y - lens.centre_px.y) / lens.focal_px.y, (y + 1 - lens.centre_px.y) / lens.focal_px.y};
}

/// Part of the pixel's area within the rim. The mirror ball is equal-area with dw/dA = 4 in its
/// normalised plane, so the same flux measures area.
double covered_fraction(const RadialLens& lens, const PixelCorners& c) {
  const RadialLens area{{0, 0}, {1, 1}, {RadialCurve::CurveKind::kMirrorBall, {}}};
  const double k = 1 / lens.rim();
  const double flux = edge_flux(area, c.x1 * k, c.y0 * k, c.y1 * k) -
                      edge_flux(area, c.x0 * k, c.y0 * k, c.y1 * k) +
                      edge_flux(area, c.y1 * k, c.x0 * k, c.x1 * k) -
                      edge_flux(area, c.y0 * k, c.x0 * k, c.x1 * k);
  return flux / (4 * k * k * (c.x1 - c.x0) * (c.y1 - c.y0));
}

/// The middle of what a rim pixel sees when its centre lies outside: half way between its innermost
/// corner and the rim.
glm::dvec3 rim_direction(const RadialLens& lens, const PixelCorners& c) {
  const glm::dvec2 inner{std::clamp(0., c.x0, c.x1), std::clamp(0., c.y0, c.y1)};
  const glm::dvec2 centre{(c.x0 + c.x1) / 2, (c.y0 + c.y1) / 2};
  const double rho = (std::fmin(std::hypot(inner.x, inner.y), lens.rim()) + lens.rim()) / 2;
  return lens.direction(centre * (rho / std::hypot(centre.x, centre.y)));
}

void fill_radial_cell(ProjectionTable& table, const RadialLens& lens, int x, int y,
                      double solid_angle) {
  const PixelCorners c = corners(lens, x, y);
  const double far = std::hypot(std::max(std::abs(c.x0), std::abs(c.x1)),
                                std::max(std::abs(c.y0), std::abs(c.y1)));
  if (far <= lens.rim()) return set_cell(table, x, y, solid_angle, 1);
  const double near = std::hypot(std::clamp(0., c.x0, c.x1), std::clamp(0., c.y0, c.y1));
  if (near >= lens.rim()) return set_cell(table, x, y, 0, 0);
  set_cell(table, x, y, solid_angle, covered_fraction(lens, c));
  const glm::dvec2 centre{(c.x0 + c.x1) / 2, (c.y0 + c.y1) / 2};
  if (std::hypot(centre.x, centre.y) > lens.rim())
    table.direction[pixel_index(table, x, y)] = glm::vec3(rim_direction(lens, c));
}

void fill_radial(ProjectionTable& table, const RadialLens& lens) {
  const auto width = static_cast<std::size_t>(table.width);
  std::vector<double> above(width), below(width), side(width + 1);
  const auto horizontal = [&](int y, std::vector<double>& flux) {
    for (int x = 0; x < table.width; ++x) {
      const PixelCorners c = corners(lens, x, y);
      flux[static_cast<std::size_t>(x)] = edge_flux(lens, c.y0, c.x0, c.x1);
    }
  };
  horizontal(0, above);
  for (int y = 0; y < table.height; ++y) {
    horizontal(y + 1, below);
    for (int x = 0; x <= table.width; ++x) {
      const PixelCorners c = corners(lens, x, y);
      side[static_cast<std::size_t>(x)] = edge_flux(lens, c.x0, c.y0, c.y1);
    }
    for (int x = 0; x < table.width; ++x) {
      const auto n = static_cast<std::size_t>(x);
      fill_radial_cell(table, lens, x, y, side[n + 1] - side[n] + below[n] - above[n]);
    }
    std::swap(above, below);
  }
}

// ------------------------------------------------------------------------------- planes

/// Solid angle of the rectangle from (0,0) to (x, y) in the plane at distance 1.
double corner_solid_angle(double x, double y) {
  return std::atan2(x * y, std::sqrt(1 + x * x + y * y));
}

/// Solid angles of all cells of a grid in the plane at distance 1, given its lines; row by row.
std::vector<double> plane_cells(const std::vector<double>& xs, const std::vector<double>& ys) {
  std::vector<double> cells, above(xs.size()), below(xs.size());
  cells.reserve((xs.size() - 1) * (ys.size() - 1));
  for (std::size_t y = 0; y < ys.size(); ++y) {
    for (std::size_t x = 0; x < xs.size(); ++x) below[x] = corner_solid_angle(xs[x], ys[y]);
    for (std::size_t x = 1; y > 0 && x < xs.size(); ++x)
      cells.push_back((below[x] - below[x - 1]) - (above[x] - above[x - 1]));
    std::swap(above, below);
  }
  return cells;
}

/// Solid angle of a spherical triangle of unit vectors.
/// source: Van Oosterom & Strackee 1983
double triangle_solid_angle(const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c) {
  return 2 * std::atan2(std::abs(glm::dot(a, glm::cross(b, c))),
                        1 + glm::dot(a, b) + glm::dot(b, c) + glm::dot(c, a));
}

/// A pixel of a distorted picture is the quadrangle of its corners' directions.
void fill_distorted(ProjectionTable& table, const CameraModel& p) {
  using RayRow = std::vector<std::optional<glm::dvec3>>;
  const auto corners_of_row = [&](int y, RayRow& out) {
    out.clear();
    for (int x = 0; x <= p.width; ++x) out.push_back(direction_from_pixel(p, {x, y}));
  };
  RayRow above, below;
  corners_of_row(0, above);
  for (int y = 0; y < p.height; ++y) {
    corners_of_row(y + 1, below);
    for (std::size_t x = 0; x + 1 < above.size(); ++x) {
      const auto &a = above[x], &b = above[x + 1], &c = below[x + 1], &d = below[x];
      if (a && b && c && d)
        set_cell(table, static_cast<int>(x), y,
                 triangle_solid_angle(*a, *b, *c) + triangle_solid_angle(*a, *c, *d), 1);
    }
    std::swap(above, below);
  }
}

void fill_pinhole(ProjectionTable& table, const CameraModel& p) {
  if (p.is_distorted()) return fill_distorted(table, p);
  std::vector<double> xs, ys;
  for (int x = 0; x <= p.width; ++x) xs.push_back((x - p.principal_px.x) / p.focal_px.x);
  for (int y = 0; y <= p.height; ++y) ys.push_back((y - p.principal_px.y) / p.focal_px.y);
  const std::vector<double> cells = plane_cells(xs, ys);
  for (int y = 0; y < p.height; ++y)
    for (int x = 0; x < p.width; ++x) set_cell(table, x, y, cells[pixel_index(table, x, y)], 1);
}

/// Lines between the pixels of a cube's face in -1..1. OpenEXR's outer pixels have their centres on
/// the cube's edges, so each owns half a cell here and its twin on the next face the other half.
std::vector<double> face_lines(int size, bool centres_on_edges) {
  std::vector<double> lines;
  for (int i = 0; i <= size; ++i)
    lines.push_back(centres_on_edges ? std::clamp(2 * (i - .5) / (size - 1) - 1, -1., 1.)
                                     : 2. * i / size - 1);
  return lines;
}

void fill_faces(ProjectionTable& table, const CameraModel& p) {
  const bool cross = p.kind == ProjectionKind::kVerticalCross;
  const int size = std::max(1, cross ? p.width / 3 : p.width);
  const std::vector<double> lines = face_lines(size, !cross);
  const std::vector<double> cells = plane_cells(lines, lines);
  for (int y = 0; y < p.height; ++y) {
    for (int x = 0; x < p.width; ++x) {
      const bool empty = cross && y / size != 1 && x / size != 1;
      const auto row = static_cast<std::size_t>(y % size),
                 column = static_cast<std::size_t>(x % size);
      const std::size_t cell = row * static_cast<std::size_t>(size) + column;
      set_cell(table, x, y, empty ? 0 : cells[cell], empty ? 0 : 1);
    }
  }
}

// ------------------------------------------------------------------------------- lat-long

void fill_latlong(ProjectionTable& table, const CameraModel& p) {
  for (int y = 0; y < p.height; ++y) {
    const double cell = latlong_solid_angle(y, p.width, p.height);
    for (int x = 0; x < p.width; ++x) set_cell(table, x, y, cell, 1);
  }
}

/// Pixel centres on the poles and on the seam: the first and last rows are caps half a row high,
/// the first and last columns (the same meridian) half as wide.
void fill_exr_latlong(ProjectionTable& table, const CameraModel& p) {
  const auto theta = [&](double row) { return kPi * std::clamp(row / (p.height - 1), 0., 1.); };
  for (int y = 0; y < p.height; ++y) {
    const double band = std::cos(theta(y - .5)) - std::cos(theta(y + .5));
    for (int x = 0; x < p.width; ++x) {
      const double width = x == 0 || x == p.width - 1 ? .5 : 1;
      set_cell(table, x, y, width * 2 * kPi / (p.width - 1) * band, 1);
    }
  }
}

}  // namespace

ProjectionTable make_projection_table(const CameraModel& p) {
  assert(p.width > 0 && p.height > 0);
  const auto area = static_cast<std::size_t>(p.width) * static_cast<std::size_t>(p.height);
  ProjectionTable table{p.width, p.height, {}, std::vector<float>(area), std::vector<float>(area)};
  table.direction.reserve(area);
  const auto lens = radial_lens(p);
  for (int y = 0; y < p.height; ++y) {
    for (int x = 0; x < p.width; ++x) {
      const auto d = direction_from_pixel(p, {x + .5, y + .5});
      // A pixel that sees nothing still has a unit vector, so nobody has to normalise a zero.
      table.direction.push_back(d ? glm::vec3(*d) : glm::vec3(0, 0, -1));
    }
  }
  if (lens) {
    fill_radial(table, *lens);
    return table;
  }
  switch (p.kind) {
    case ProjectionKind::kPinhole:
      fill_pinhole(table, p);
      break;
    case ProjectionKind::kVerticalCross:
    case ProjectionKind::kExrCube:
      fill_faces(table, p);
      break;
    case ProjectionKind::kExrLatLong:
      fill_exr_latlong(table, p);
      break;
    default:
      fill_latlong(table, p);
  }
  return table;
}

}  // namespace penumbra::calib
