// What a look-up says is what the ray of that cell found.

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "prt/prt.h"

namespace penumbra::prt {
namespace {

BakedObject baked_knot(bool visibility) {
  BakeOptions options;
  options.rays = options.ground_rays = 64;
  options.bounces = 0;
  options.bands = 2;
  options.visibility = visibility;
  const Mesh mesh = make_knot(.4f, 60, 16, {.5f, .5f, .5f});
  options.receiver = Receiver{fit_ground_grid(mesh, -.01f, 8), {.4f, .4f, .4f}};
  auto out = bake(mesh, options);
  EXPECT_TRUE(out);
  return out ? *out : BakedObject{};
}

struct ReferenceWorld {
  explicit ReferenceWorld(const BakedObject& o) : object(o) { EXPECT_TRUE(rays.add(o.mesh)); }
  bool open(std::size_t vertex, const glm::vec3& d) const {
    const glm::vec3 centre = bounds_of(object.mesh).centre();
    const float near = 1e-4f * radius_around(object.mesh, centre);
    const glm::vec3 o = object.mesh.positions[vertex] + near * object.mesh.normals[vertex];
    RayWorld::Rays r;
    r.ox[0] = o.x, r.oy[0] = o.y, r.oz[0] = o.z;
    r.dx[0] = d.x, r.dy[0] = d.y, r.dz[0] = d.z;
    return (rays.occluded(r, 1) & 1) == 0;
  }
  const BakedObject& object;
  RayWorld rays = *RayWorld::create();
};

std::vector<CosineSums> look(const BakedObject& o, const VisibilitySamples& directions_used) {
  std::vector<CosineSums> out(o.mesh.positions.size());
  VisibilityLookup(o.visibility, o.mesh).look_up(directions_used, 0, out.size(), out);
  return out;
}

struct Way {
  int cells;
  std::size_t each;
};
constexpr Way kWays[] = {{VisibilityMap::kCells, VisibilitySamples::kMax},
                         {VisibilityMap::kFineCells, VisibilitySamples::kMax},
                         {VisibilityMap::kFineCells, VisibilitySamples::kFew}};

// Each vertex looks along rays of its own, of random cells; the receiver, which its rays cross,
// does not count.
TEST(VisibilityMap, AlongItsRaysALookUpIsTheRay) {
  const BakedObject o = baked_knot(true);
  const ReferenceWorld world(o);
  for (const auto& [cells, each] : kWays) {
    std::mt19937 rng(7);
    std::uniform_int_distribution<int> cell(0, cells - 1);
    VisibilitySamples directions_used;
    directions_used.clear(cells, each);
    std::vector<float> seen(o.mesh.positions.size(), 0), open = seen;
    for (std::size_t v = 0; v < seen.size(); ++v) {
      const HemiOctFrame frame = HemiOctFrame::of(v, o.mesh.normals[v]);
      for (std::size_t k = 0; k < each; ++k) {
        const glm::vec3 d = frame.direction(cell(rng), cell(rng), cells);
        const float cosine = glm::dot(d, o.mesh.normals[v]);
        EXPECT_GE(cosine, 0);
        const bool counts = k % 5 != 0;
        directions_used.add(d, counts);
        open[v] += cosine;
        if (counts && world.open(v, d)) seen[v] += cosine;
      }
    }
    const std::vector<CosineSums> looked = look(o, directions_used);
    std::size_t different = 0, dark = 0;
    for (std::size_t v = 0; v < seen.size(); ++v) {
      EXPECT_NEAR(looked[v].open, open[v], 1e-4f);
      different += std::abs(looked[v].seen - seen[v]) > 1e-4f;
      dark += seen[v] < .5f * open[v];
    }
    // Rays along an edge may go either way in a mesh of another scale.
    EXPECT_LE(different, seen.size() / 200);
    EXPECT_GT(dark, seen.size() / 10);
  }
}

// Rays lie so that the nearest is off by `blur` in the mean, and nowhere by much more.
TEST(VisibilityMap, RaysAreNearToEveryDirection) {
  std::mt19937 rng(3);
  std::normal_distribution<float> normal;
  for (const int cells : {VisibilityMap::kCells, VisibilityMap::kFineCells}) {
    double square = 0, largest = 0;
    constexpr int kTries = 4000;
    for (int i = 0; i < kTries; ++i) {
      const glm::vec3 up = glm::normalize(glm::vec3(normal(rng), normal(rng), normal(rng)));
      glm::vec3 d = glm::normalize(glm::vec3(normal(rng), normal(rng), normal(rng)));
      if (glm::dot(d, up) < 0) d = -d;
      const HemiOctFrame frame = HemiOctFrame::of(static_cast<std::size_t>(i), up);
      float nearest = -1;
      for (int y = 0; y < cells; ++y)
        for (int x = 0; x < cells; ++x)
          nearest = std::max(nearest, glm::dot(d, frame.direction(x, y, cells)));
      const double angle = std::acos(std::min(1.f, nearest));
      square += angle * angle;
      largest = std::max(largest, angle);
    }
    const double blur = VisibilityMap::blur(cells);
    EXPECT_NEAR(std::sqrt(square / kTries) / blur, 1, .25) << cells;
    EXPECT_LT(largest, 3.5 * blur) << cells;
  }
}

// Of one vertex or another one ray alone is open: the nearest one. The map is skewed, so that a
// look-up between two rays may take the farther one.
TEST(VisibilityMap, LooksAlongTheNearestRay) {
  std::mt19937 rng(5);
  std::normal_distribution<float> normal;
  constexpr int kTries = 1000;
  for (const int cells : {VisibilityMap::kCells, VisibilityMap::kFineCells}) {
    int found = 0;
    for (int i = 0; i < kTries; ++i) {
      const std::size_t vertex = static_cast<std::size_t>(i) % 7, count = 7;
      const std::vector<glm::vec3> up(
          count, glm::normalize(glm::vec3(normal(rng), normal(rng), normal(rng))));
      glm::vec3 d = glm::normalize(glm::vec3(normal(rng), normal(rng), normal(rng)));
      if (glm::dot(d, up[0]) < 0) d = -d;
      const HemiOctFrame frame = HemiOctFrame::of(vertex, up[0]);
      float nearest = -1;
      std::size_t block = 0, cell = 0;
      const int side = cells / 8;
      for (int y = 0; y < cells; ++y)
        for (int x = 0; x < cells; ++x)
          if (const float here = glm::dot(d, frame.direction(x, y, cells)); here > nearest) {
            nearest = here;
            block = static_cast<std::size_t>(8 * (y / side) + x / side);
            cell = static_cast<std::size_t>(side * (y % side) + x % side);
          }
      VisibilityMap visibility(count);
      if (cells == VisibilityMap::kCells) {
        visibility.open[VisibilityMap::kWords * vertex + block / 2] = 1u
                                                                      << (16 * (block % 2) + cell);
      } else {
        visibility.refined[vertex] = std::uint64_t{1} << block;
        visibility.fine.push_back(std::uint64_t{1} << cell);
      }
      VisibilitySamples directions_used;
      directions_used.clear(cells);
      for (std::size_t k = 0; k < VisibilitySamples::kMax; ++k) directions_used.add(d, true);
      std::vector<CosineSums> sums(count);
      VisibilityLookup(visibility, Mesh{up, up, {}, {}}).look_up(directions_used, 0, count, sums);
      found += sums[vertex].seen > 0;
    }
    EXPECT_GT(found, kTries * 85 / 100) << cells;
  }
}

TEST(VisibilityMap, AnOpenSurfaceSeesEverything) {
  BakeOptions options;
  options.rays = options.ground_rays = 64;
  options.bounces = 0;
  options.visibility = true;
  const auto ball = bake(make_sphere({0, 0, 0}, .3f, 3, {.5f, .5f, .5f}), options);
  ASSERT_TRUE(ball);
  EXPECT_TRUE(ball->visibility.fine.empty());
  for (const int cells : {VisibilityMap::kCells, VisibilityMap::kFineCells}) {
    VisibilitySamples directions_used;
    directions_used.clear(cells);
    for (int k = 0; k < 32; ++k)
      directions_used.add(glm::normalize(glm::vec3(std::cos(k), 1, std::sin(k))), true);
    const std::vector<CosineSums> looked = look(*ball, directions_used);
    for (std::size_t v = 0; v < looked.size(); ++v) {
      ASSERT_EQ(looked[v].seen, looked[v].open) << v;
      if (ball->mesh.normals[v].y < -.8f) {
        EXPECT_EQ(looked[v].open, 0) << "turned away";
      }
    }
  }
}

// Normals that only differ in the sign of a zero are one, whatever files and placements make of
// them.
TEST(VisibilityMap, ANegativeZeroTurnsNothing) {
  for (const glm::vec3& n : {glm::vec3(1, 0, 0), {0, 1, 0}, {0, 0, 1}}) {
    const HemiOctFrame plus = HemiOctFrame::of(3, n),
                       minus =
                           HemiOctFrame::of(3, glm::vec3(n.x > 0 ? n.x : -0.f, n.y > 0 ? n.y : -0.f,
                                                         n.z > 0 ? n.z : -0.f));
    EXPECT_EQ(plus.first, minus.first);
    EXPECT_EQ(plus.second, minus.second);
  }
}

// Each width of vectors that this machine has, in its own code.
TEST(VisibilityMap, LooksAlikeOnEveryKindOfProcessor) {
  const BakedObject o = baked_knot(true);
  std::mt19937 rng(11);
  std::normal_distribution<float> normal;
  const std::int64_t targets = hwy::SupportedTargets();
  struct Restore {
    ~Restore() {
      hwy::SetSupportedTargetsForTest(0);
      hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    }
  } restore;
  for (const auto& [cells, each] : kWays) {
    VisibilitySamples directions_used;
    directions_used.clear(cells, each);
    for (std::size_t k = 0; k < 5 * each; ++k)
      directions_used.add(glm::normalize(glm::vec3(normal(rng), normal(rng), normal(rng))),
                          k % 7 != 0);
    hwy::GetChosenTarget().Update(targets);
    const std::vector<CosineSums> best = look(o, directions_used);
    for (std::int64_t left = targets; left != 0; left &= left - 1) {
      SCOPED_TRACE(hwy::TargetName(left & -left));
      hwy::SetSupportedTargetsForTest(left & -left);
      hwy::GetChosenTarget().Update(left & -left);
      const std::vector<CosineSums> here = look(o, directions_used);
      std::size_t different = 0;
      for (std::size_t v = 0; v < best.size(); ++v) {
        ASSERT_NEAR(here[v].open, best[v].open, 1e-4f);
        different += std::abs(here[v].seen - best[v].seen) > 1e-4f;
      }
      EXPECT_LE(different, best.size() / 200) << "rounding at the rims of cells";
    }
  }
}

// What look-ups rely on.
TEST(VisibilityMap, FinerCellsStandWhereAnEdgeIsSeen) {
  const BakedObject o = baked_knot(true);
  const std::size_t count = o.mesh.positions.size();
  ASSERT_EQ(o.visibility.refined.size(), count);
  ASSERT_EQ(o.visibility.open.size(), count * VisibilityMap::kWords);
  std::size_t blocks = 0, by_others = 0;
  for (std::size_t v = 0; v < count; ++v)
    for (int b = 0; b < VisibilityMap::kBlocks * VisibilityMap::kBlocks; ++b) {
      const std::uint32_t bits = o.visibility.block(v, b);
      const bool mixed = bits != 0 && bits != 0xffffu,
                 refined = (o.visibility.refined[v] >> b & 1) != 0;
      ASSERT_TRUE(refined || !mixed) << v << ' ' << b;
      blocks += refined;
      by_others += refined && !mixed;
    }
  EXPECT_EQ(o.visibility.fine.size(), blocks);
  EXPECT_GT(by_others, blocks / 20) << "where neighbours alone see one";
  EXPECT_LT(blocks, count * 40);
  constexpr std::size_t kWide = 16 * 16, kPacket = 16, kReceiver = 8 * 8 * 64;
  ASSERT_GT(o.report.rays, count * kWide + kReceiver);
  const std::size_t closer = o.report.rays - count * kWide - kReceiver;
  EXPECT_EQ(closer % kPacket, 0);
  EXPECT_LT(closer, count * kPacket * kWide * 3 / 4) << "not all cells";
}

// A mesh whose triangles have vertices of their own asks as many.
TEST(VisibilityMap, SeamsAreNoRims) {
  const Mesh whole = make_knot(.4f, 60, 16, {.5f, .5f, .5f});
  Mesh split;
  for (const auto& t : whole.triangles) {
    const auto first = static_cast<std::uint32_t>(split.positions.size());
    for (const std::uint32_t v : t) {
      split.positions.push_back(whole.positions[v]);
      split.normals.push_back(whole.normals[v]);
      split.albedo.push_back(whole.albedo[v]);
    }
    split.triangles.push_back({first, first + 1, first + 2});
  }
  const auto refined = [](const Mesh& mesh) {
    BakeOptions options;
    options.rays = options.ground_rays = 64;
    options.bounces = 0;
    options.visibility = true;
    const auto o = bake(mesh, options);
    EXPECT_TRUE(o);
    return double(o->visibility.fine.size()) / double(mesh.positions.size());
  };
  const double fraction = refined(split) / refined(whole);
  EXPECT_GT(fraction, .99) << "the naive form asks one neighbour";
  EXPECT_LT(fraction, 1.1) << "copies look another way";
}

TEST(VisibilityMap, IsMadeOnDemand) {
  EXPECT_TRUE(baked_knot(false).visibility.empty());
}

}  // namespace
}  // namespace penumbra::prt
