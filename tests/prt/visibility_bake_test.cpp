// Rays where an edge is: transfer and visibility of a vertex from fewer rays than all of its cells
// have.

#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>

#include "core/conventions.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "prt/bake/internal/hemi_oct_sums.h"
#include "prt/prt.h"

namespace penumbra::prt {
namespace {

constexpr int kBands = 6;
constexpr float kLeaned = .7f;  // radians

HemiOctFrame leaned(float radians) {
  return HemiOctFrame::of(5, {std::sin(radians), std::cos(radians), 0});
}

TEST(HemiOctSums, AllThatIsBlockedIsAllThatIsOpenByTheClosedForm) {
  const HemiOctFrame frame = leaned(kLeaned);
  std::vector<float> sum(coefficient_count(kBands), 0);
  const HemiOctSums sums(kBands);
  const HemiOctSums::Blocked blocked = sums.add_blocked(OpenCells{}, frame, false, sum);
  EXPECT_NEAR(blocked.fraction, 1, 1e-4);
  EXPECT_NEAR(blocked.standard_error, 0, 1e-5);
  double basis[kMaxCoefficients];
  lighting::evaluate_basis(kBands, glm::dvec3(frame.normal), basis);
  for (int l = 0; l < kBands; ++l)
    for (int m = -l; m <= l; ++m) {
      const auto n = static_cast<std::size_t>(sh_index(l, m));
      EXPECT_NEAR(sum[n], lighting::cosine_coefficient(l) / kPi * basis[n], 1e-4) << l << ' ' << m;
    }
}

// source: form factor of a plane to a surface that leans by an angle
TEST(HemiOctSums, APlaneHidesItsPartOfTheCosine) {
  const HemiOctSums sums(1);
  OpenCells open;
  open.fill(~std::uint64_t{0});
  for (const float radians : {0.f, .1f, .5f, 1.f, 2.f, 3.f}) {
    std::vector<float> sum(1, 0);
    const HemiOctSums::Blocked blocked = sums.add_blocked(open, leaned(radians), true, sum);
    EXPECT_NEAR(blocked.fraction, (1 - std::cos(radians)) / 2, .002) << radians;
  }
}

// Relative RMS difference of t_0, and of all coefficients.
struct TransferError {
  double constant = 0, all = 0;
};
TransferError difference(const BakedObject& o, const BakedObject& truth) {
  double constant = 0, constant_square = 0, all = 0, square = 0;
  for (std::size_t p = 0; p < truth.transfer.points; ++p)
    for (int n = 0; n < coefficient_count(truth.transfer.bands); ++n) {
      const double t = truth.transfer.value(0, n, p), e = o.transfer.value(0, n, p) - t;
      all += e * e, square += t * t;
      if (n == 0) constant += e * e, constant_square += t * t;
    }
  return {std::sqrt(constant / constant_square), std::sqrt(all / square)};
}

BakedObject baked(const Mesh& mesh, bool visibility, int rays) {
  BakeOptions options;
  options.bands = kBands;
  options.bounces = 0;
  options.rays = rays, options.ground_rays = 64;
  options.visibility = visibility;
  options.receiver = Receiver{fit_ground_grid(mesh, bounds_of(mesh).low.y, 4), {}};
  auto out = bake(mesh, options);
  EXPECT_TRUE(out);
  return out ? std::move(*out) : BakedObject{};
}

constexpr int kTruthRays = 16384, kPeerRays = 1024;

TEST(VisibilityBake, TransferIsCloserThanByTheBakesOtherRays) {
  const Mesh knot = make_knot(.4f, 120, 24, {.5f, .5f, .5f});
  const BakedObject truth = baked(knot, false, kTruthRays), peer = baked(knot, false, kPeerRays),
                    ours = baked(knot, true, kPeerRays);
  const TransferError of_peer = difference(peer, truth), of_ours = difference(ours, truth);
  EXPECT_LT(of_ours.constant, .65 * of_peer.constant) << of_ours.constant;
  EXPECT_LT(of_ours.all, .65 * of_peer.all) << of_ours.all;
  const std::size_t all = knot.positions.size() * 64 * 64;
  EXPECT_LT(ours.report.rays, 2 * all / 3) << "most vertices' edges are few";
  // What it says of itself holds.
  EXPECT_GT(ours.report.standard_error, .7 * of_ours.constant);
  EXPECT_LT(ours.report.standard_error, 3 * of_ours.constant);
}

// Rods that hide between the wide rays of most vertices.
Mesh make_fence() {
  constexpr Rgb kGrey{.5f, .5f, .5f};
  Mesh out = make_box({-1, -.1f, -1}, {1, 0, 1}, 20, kGrey);
  for (int i = 0; i < 9; ++i) {
    const float x = -.83f + .2f * static_cast<float>(i), z = i % 2 ? -.31f : .37f;
    append(out, make_box({x, 0, z}, {x + .024f, .6f, z + .024f}, 1, kGrey));
  }
  return out;
}

TEST(VisibilityBake, ThinThingsAreFoundByTheVerticesAround) {
  const Mesh fence = make_fence();
  const BakedObject truth = baked(fence, false, kTruthRays), peer = baked(fence, false, kPeerRays),
                    ours = baked(fence, true, kPeerRays);
  const TransferError of_peer = difference(peer, truth), of_ours = difference(ours, truth);
  EXPECT_LT(of_ours.constant, 1.3 * of_peer.constant) << "by each vertex's own edges alone 1.8";
  EXPECT_LT(of_ours.all, of_peer.all) << of_ours.all;
}

TEST(VisibilityBake, MoreRaysThanCellsAreTracedApart) {
  const Mesh knot = make_knot(.4f, 40, 12, {.5f, .5f, .5f});
  const BakedObject truth = baked(knot, false, 8192), ours = baked(knot, true, 8192);
  EXPECT_EQ(difference(ours, truth).all, 0);
  EXPECT_FALSE(ours.visibility.empty());
}

}  // namespace
}  // namespace penumbra::prt
