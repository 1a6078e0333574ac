// Silhouettes found patch by patch are those of a look at every edge.
#include "shadows/silhouette/internal/silhouette_segments.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <map>
#include <random>

#include "core/conventions.h"

namespace penumbra::shadows {
namespace {

prt::Mesh outlined_knot() {
  return prt::make_knot(.5f, 120, 20, {.5f, .5f, .5f});
}

// Triangles without area among others: they face nothing.
prt::Mesh with_slivers() {
  prt::Mesh m = outlined_knot();
  for (std::size_t t = 0; t < m.triangles.size(); t += 37) {
    const auto [a, b, c] = m.triangles[t];
    m.positions[c] = .5f * (m.positions[a] + m.positions[b]);
  }
  return m;
}

prt::Mesh bumpy() {
  prt::Mesh m = outlined_knot();
  std::mt19937 random(3);
  std::normal_distribution<float> noise(0, .004f);
  for (glm::vec3& p : m.positions) p += glm::vec3(noise(random), noise(random), noise(random));
  return m;
}

prt::Mesh open_bowl() {
  prt::Mesh m = outlined_knot();
  m.triangles.resize(m.triangles.size() / 3);
  return m;
}

std::vector<PlaneSample> samples(double turn, double spread, int count) {
  std::vector<PlaneSample> out;
  for (int k = 0; k < count; ++k) {
    const double a = 2.4 * k, r = spread * std::sqrt((k + .5) / count);
    out.push_back(
        {{.8 * std::cos(turn) + r * std::cos(a), .8 * std::sin(turn) + r * std::sin(a)}, 1});
  }
  return out;
}

NodeGrid grid_at(double height_m) {
  return {{{1, 0, 0, 0}, {-500, height_m, -500}}, .01f, 1e5f, 1e5f};
}

// As narrow as it can be.
DirectionCone around(std::span<const PlaneSample> samples) {
  const auto direction = [](const PlaneSample& t) {
    return glm::normalize(glm::dvec3(-t.shift.x, 1, -t.shift.y));
  };
  glm::dvec3 sum(0);
  for (const PlaneSample& t : samples) sum += direction(t);
  DirectionCone out{glm::normalize(sum), 0};
  for (const PlaneSample& t : samples)
    out.sine = std::max(out.sine, glm::length(glm::cross(direction(t), out.towards)));
  return out;
}

std::pmr::vector<SilhouetteSegment> sides(const prt::Mesh& mesh, const SilhouetteMesh& silhouette,
                                          double height_m, std::span<const PlaneSample> samples) {
  const Caster caster{&mesh, &silhouette, {}};
  SilhouetteCache cache;
  return find_sides({&caster, 1}, grid_at(height_m), 0, {samples, around(samples)}, cache,
                    std::pmr::get_default_resource());
}
std::pmr::vector<SilhouetteSegment> sides(const prt::Mesh& mesh, double height_m,
                                          std::span<const PlaneSample> samples) {
  return sides(mesh, SilhouetteMesh(mesh), height_m, samples);
}

// Edges between triangles that do not face all of the directions alike, and rims.
std::size_t silhouette_edges(const prt::Mesh& mesh, std::span<const PlaneSample> samples) {
  const SilhouetteMesh o(mesh);
  const auto faces = [&](std::uint32_t t, const PlaneSample& sample) {
    const auto& n = o.normals();
    return glm::dot(glm::dvec3(n.x[t], n.y[t], n.z[t]), {-sample.shift.x, 1, -sample.shift.y}) > 0;
  };
  return static_cast<std::size_t>(
      std::ranges::count_if(o.edges(), [&](const SilhouetteMesh::Edge& e) {
        return e.right == SilhouetteMesh::kOpen ||
               std::ranges::any_of(samples, [&](const PlaneSample& sample) {
                 return faces(e.left, sample) != faces(e.right, sample);
               });
      }));
}

TEST(SilhouetteSegments, PatchesLeaveNothingOut) {
  for (const prt::Mesh& mesh : {outlined_knot(), with_slivers(), bumpy(), open_bowl()})
    for (const double turn : {0., 1.1, 2.5, 4.})
      for (const double spread : {0., .01, .3, 3.}) {
        const auto directions = samples(turn, spread, spread > 0 ? 16 : 1);
        const std::size_t all = silhouette_edges(mesh, directions),
                          found = sides(mesh, -1, directions).size();
        EXPECT_GT(all, 100u);
        EXPECT_LT(all, SilhouetteMesh(mesh).edges().size());
        // Which side of zero a triangle seen edge-on falls is rounding.
        EXPECT_NEAR(double(found), double(all), 2) << turn << ", " << spread;
      }
}

TEST(SilhouetteSegments, EveryTriangleThatGoesThroughThePlaneEndsThereOnce) {
  for (const prt::Mesh& mesh : {outlined_knot(), bumpy(), open_bowl()}) {
    std::size_t through_all = 0;
    for (const double height : {.013, .1, .251, .4}) {
      const auto directions = samples(.4, 0, 1);
      std::size_t through = 0;
      for (const auto& t : mesh.triangles) {
        const auto above =
            std::ranges::count_if(t, [&](auto v) { return mesh.positions[v].y >= float(height); });
        through += above == 1 || above == 2;
      }
      const auto found = sides(mesh, height, directions);
      through_all += through;
      EXPECT_EQ(std::ranges::count_if(
                    found, [](const SilhouetteSegment& s) { return s.from.y == 0 && s.to.y == 0; }),
                std::ptrdiff_t(through))
          << height;
    }
    EXPECT_GT(through_all, 50u);
  }
}

// Ends of stretches that do not cancel: past them a row's sum of layers would be wrong to its end.
std::size_t loose_ends(const prt::Mesh& mesh, double height_m,
                       std::span<const PlaneSample> samples) {
  std::map<std::array<float, 3>, std::array<int, 64>> ends;
  for (const SilhouetteSegment& s : sides(mesh, height_m, samples))
    for (std::size_t k = 0; k < samples.size(); ++k) {
      const int layers = s.layers * (int(s.more >> k & 1) - int(s.fewer >> k & 1));
      ends[{s.from.x, s.from.y, s.from.z}][k] -= layers;
      ends[{s.to.x, s.to.y, s.to.z}][k] += layers;
    }
  return static_cast<std::size_t>(std::ranges::count_if(ends, [](const auto& end) {
    return std::ranges::any_of(end.second, [](int n) { return n != 0; });
  }));
}

TEST(SilhouetteSegments, OfClosedMeshesCloseForEveryDirection) {
  for (const prt::Mesh& mesh : {outlined_knot(), bumpy()})
    for (const double turn : {0., 1.1, 2.5})
      for (const double spread : {.005, .3})
        for (const double height : {-1., .2})
          EXPECT_EQ(loose_ends(mesh, height, samples(turn, spread, 16)), 0u)
              << turn << ", " << spread << ", " << height;
}

// Triangles of one face whose normals differ by rounding alone, under light that passes along it.
TEST(SilhouetteSegments, OfAFaceSeenEdgeOnClose) {
  constexpr double kTilt = .6;
  prt::Mesh box = prt::make_box({-.5f, .3f, -.5f}, {.5f, 1.3f, .5f}, 40, {});
  // Far from the origin rounding turns normals by some 1e-4.
  prt::transform(box, glm::translate(glm::dmat4(1), glm::dvec3(30, 0, 20)) *
                          glm::rotate(glm::dmat4(1), kTilt, glm::dvec3(0, 0, 1)));
  ASSERT_EQ(loose_ends(box, -3, samples(1, 0, 1)), 0u);
  for (int step = -60; step <= 60; step += 8) {
    const double across = -std::tan(kTilt) * (1 + 2e-7 * step * std::abs(step));
    for (const double shift : {across, -1 / across}) {
      const PlaneSample sample{{shift, .1}, 1};
      EXPECT_EQ(loose_ends(box, -3, {&sample, 1}), 0u) << step << ", " << shift;
    }
  }
}

TEST(SilhouetteSegments, PatchesFollowAnotherForm) {
  prt::Mesh mesh = outlined_knot();
  SilhouetteMesh silhouette(mesh);
  for (glm::vec3& p : mesh.positions) p = {p.z, p.x + .4f, p.y};
  silhouette.update_vertices(mesh);
  const auto directions = samples(2, .01, 16);
  for (const double height : {-1., .3})
    EXPECT_EQ(sides(mesh, silhouette, height, directions).size(),
              sides(mesh, height, directions).size());
}

}  // namespace
}  // namespace penumbra::shadows
