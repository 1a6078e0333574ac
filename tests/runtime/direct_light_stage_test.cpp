#include "runtime/direct/direct_light_stage.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <cmath>

namespace penumbra::runtime {
namespace {

using glm::dvec3;

PreparedScene two_of(const prt::Mesh& thing, bool visibility) {
  PreparedScene scene;
  scene.planes.push_back({{0, 0, 0}, {0, 1, 0}, {.4f, .4f, .4f}, {}});
  for (const char* name : {"first", "second"}) {
    prt::Mesh mesh = thing;
    prt::BakeOptions bake;
    bake.rays = bake.ground_rays = 64;
    bake.bounces = 0;
    bake.visibility = visibility;
    bake.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 32), {.4f, .4f, .4f}};
    auto baked = prt::bake(std::move(mesh), bake);
    EXPECT_TRUE(baked);
    if (baked) scene.objects.push_back({name, std::move(*baked), {}, 0, nullptr});
  }
  return scene;
}

PreparedScene two_balls() {
  return two_of(prt::make_sphere({0, .2f, 0}, .2f, 3, {.6f, .6f, .6f}), false);
}

lighting::DistantLight sun(double azimuth) {
  lighting::DistantLight d;
  d.id = 1;
  d.direction = glm::normalize(dvec3(std::cos(azimuth), .7, std::sin(azimuth)));
  d.radius = Radians(.02);
  d.radiance = {100, 100, 100};
  return d;
}

std::vector<float> light_on(DirectLightStage& stage, const PreparedScene& scene,
                            std::size_t object) {
  std::vector<float> out(3 * scene.objects[object].baked.transfer.stride);
  stage.add_light(object, out);
  return out;
}

std::vector<compositor::ShadowMapOnPlane> shadows_of(const DirectLightStage& stage,
                                                     const std::vector<Rgb>& open_irradiance) {
  std::vector<compositor::ShadowMapOnPlane> out;
  stage.shadows(open_irradiance, out);
  return out;
}

// What is kept of the last update must be what a stage of its own would find.
TEST(DirectLightStage, ObjectsThatMoveRenewAllThatTheyReach) {
  const PreparedScene scene = two_balls();
  const OcclusionProbes around(scene);
  auto kept = DirectLightStage::create(scene, {});
  ASSERT_TRUE(kept);
  std::vector<float> open;
  int shaded = 0;
  // Far away, between the other one and the sun, gone again, beside it, and touching.
  for (const dvec3 at : {dvec3(3, 0, 0), {.5, .35, 0}, {-3, 0, 0}, {0, 0, .8}, {.4, 0, 0}}) {
    const Pose pose{{1, 0, 0, 0}, at};
    auto fresh = DirectLightStage::create(scene, {});
    ASSERT_TRUE(fresh);
    for (DirectLightStage* stage : {&*kept, &*fresh}) {
      stage->set_pose(1, pose);
      stage->update(std::vector{sun(0)}, 1, around);
    }
    for (const std::size_t object : {std::size_t{0}, std::size_t{1}})
      EXPECT_EQ(light_on(*kept, scene, object), light_on(*fresh, scene, object)) << at.x;
    if (open.empty()) open = light_on(*kept, scene, 0);
    shaded += open != light_on(*kept, scene, 0);
  }
  EXPECT_GE(shaded, 1) << "one of the places is before the sun";
}

// A cloth before the sun, seen from its dark side's back: the sun shines on that, but for a ball's
// shadow.
TEST(DirectLightStage, TheOtherSideOfASheetIsShaded) {
  PreparedScene scene = two_balls();
  prt::BakedObject& sheet = scene.objects[1].baked;
  prt::Mesh mesh;
  constexpr int kSide = 21;
  for (int y = 0; y < kSide; ++y)
    for (int z = 0; z < kSide; ++z) {
      mesh.positions.emplace_back(0, .05f * float(y), .05f * float(z - kSide / 2));
      mesh.normals.emplace_back(-1, 0, 0);
      mesh.albedo.push_back({.5f, .5f, .5f});
    }
  for (std::uint32_t y = 0; y + 1 < kSide; ++y)
    for (std::uint32_t z = 0; z + 1 < kSide; ++z) {
      const std::uint32_t a = y * kSide + z, b = a + kSide;
      mesh.triangles.push_back({a, b, a + 1});
      mesh.triangles.push_back({a + 1, b, b + 1});
    }
  prt::BakeOptions bake;
  bake.rays = bake.ground_rays = 64;
  bake.bounces = 0;
  bake.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 32), {.4f, .4f, .4f}};
  auto baked = prt::bake(std::move(mesh), bake);
  ASSERT_TRUE(baked) << baked.error().detail;
  sheet = std::move(*baked);
  prt::SurfaceMaterials surface;
  surface.materials = {{.double_sided = true}};
  surface.material.assign(sheet.mesh.positions.size(), 0);
  sheet.surface = std::make_shared<const prt::SurfaceMaterials>(std::move(surface));
  auto stage = DirectLightStage::create(scene, {});
  ASSERT_TRUE(stage);
  // The ball stands between the sheet and the sun.
  stage->set_pose(0, {{1, 0, 0, 0}, {.6, .35, 0}});
  stage->update(std::vector{sun(0)}, 1, OcclusionProbes(scene));
  std::vector<float> open(sheet.mesh.positions.size());
  stage->visible_fractions(0, 1, open);
  int shaded = 0, lit = 0;
  const dvec3 ball(.6, .55, 0), towards = sun(0).direction;
  for (std::size_t v = 0; v < open.size(); ++v) {
    const dvec3 from = ball - dvec3(sheet.mesh.positions[v]);
    const double past = glm::length(from - glm::dot(from, towards) * towards);
    if (past < .17) {
      EXPECT_LT(open[v], .05f);
      ++shaded;
    } else if (past > .23) {
      EXPECT_GT(open[v], .95f);
      ++lit;
    }
  }
  EXPECT_GT(shaded, 10);
  EXPECT_GT(lit, 100);
}

// The light that is drawn apart is a part of what the vertices get, however lights change: never
// more than that, and all of it where no edge is near.
TEST(DirectLightStage, EdgedLightIsAPartOfTheVerticesLight) {
  const PreparedScene scene = two_balls();
  const OcclusionProbes around(scene);
  auto stage = DirectLightStage::create(scene, {});
  ASSERT_TRUE(stage);
  lighting::DistantLight strong = sun(0), weak = sun(2);
  strong.radius = weak.radius = Radians(.005);
  weak.id = 2, weak.radiance = {40, 40, 40};
  const auto expect_a_part = [&](const char* when) {
    for (const std::size_t object : {std::size_t{0}, std::size_t{1}}) {
      const auto edged = stage->edged_light(object);
      ASSERT_TRUE(edged) << when;
      const std::vector<float> all = light_on(*stage, scene, object);
      std::size_t near = 0;
      for (std::size_t v = 0; v < edged->lit.size(); ++v) {
        const float at_vertex = edged->radiance.r * edged->cosine[v];
        ASSERT_LE(at_vertex, all[v] * 1.00001f) << when;
        const float drawn =
            edged->radiance.r * edged->open[v] * std::clamp(edged->lit[v], 0.f, 1.f);
        near += std::abs(drawn - at_vertex) > .01f * edged->radiance.r;
      }
      EXPECT_LT(near, edged->lit.size() / 20) << when;
    }
  };
  const auto update = [&](std::initializer_list<lighting::DistantLight> lights) {
    stage->update(std::vector<lighting::DistantLight>(lights), 1, around);
  };
  update({strong, weak});
  expect_a_part("at first");
  std::swap(strong.radiance, weak.radiance);
  update({strong, weak});
  expect_a_part("while what was weak is strong, and not traced anew");
  weak.direction = sun(1.9).direction;
  update({strong, weak});
  expect_a_part("once it is");
  EXPECT_EQ(stage->edged_light(0)->radiance, weak.radiance * float(weak.solid_angle_sr() / kPi));
  update({});
  EXPECT_FALSE(stage->edged_light(0));
  update({weak});
  expect_a_part("when a light has come back");
  weak.radius = Radians(.1);
  update({weak});
  EXPECT_FALSE(stage->edged_light(0)) << "wide lights have no sharp edges";
}

// What rests is not lit anew for a change too small to be seen, and keeps the light that it has;
// many such changes are seen.
TEST(DirectLightStage, SmallChangesAddUpWhileSomethingElseMoves) {
  const PreparedScene scene = two_balls();
  const OcclusionProbes around(scene);
  auto stage = DirectLightStage::create(scene, {});
  ASSERT_TRUE(stage);
  stage->set_pose(0, {{1, 0, 0, 0}, {0, 0, 3}});
  lighting::DistantLight light = sun(0);
  light.radius = Radians(.005);
  const auto update = [&](double step) {
    stage->set_pose(1, {{1, 0, 0, 0}, {.01 * step, 0, 0}});
    stage->update(std::vector{light}, luminance(light.irradiance()), around);
  };
  update(0);
  std::vector<float> lit = light_on(*stage, scene, 0);
  int renewed = 0;
  for (int step = 1; step <= 20; ++step) {
    light.radiance = light.radiance * .997f;
    update(step);
    if (stage->changed(0))
      lit = light_on(*stage, scene, 0), ++renewed;
    else
      EXPECT_EQ(light_on(*stage, scene, 0), lit) << step;
  }
  EXPECT_GE(renewed, 8);
  EXPECT_LE(renewed, 12) << "two steps are seen, one is not";
}

// More rays of the probes are other hits: each is shaded, once.
TEST(DirectLightStage, OtherHitsAreShadedAnew) {
  const PreparedScene scene = two_balls();
  OcclusionProbes around(scene);
  auto stage = DirectLightStage::create(scene, {});
  ASSERT_TRUE(stage);
  const std::vector<Pose> poses{scene.objects[0].world_from_bake, scene.objects[1].world_from_bake};
  around.update(stage->occluders(), poses);
  const auto update = [&] { return stage->update(std::vector{sun(0)}, 1, around); };
  EXPECT_TRUE(update());
  EXPECT_FALSE(update()) << "nothing is new";
  EXPECT_EQ(stage->hit_shade(0, 0).size(), around.hits(0).size());
  around.want_fine(0, true);
  ASSERT_TRUE(around.refine(stage->occluders(), true));
  EXPECT_TRUE(update());
  EXPECT_EQ(stage->hit_shade(0, 0).size(), around.hits(0).size());
  EXPECT_FALSE(update());
}

// A window's form is long: its round stand-in does not reach what stands before the window's end.
// Silhouettes for planes are others than those for objects, and both move.
TEST(DirectLightStage, TheShadowOnAPlaneGoesWithItsObject) {
  const PreparedScene scene = two_balls();
  const OcclusionProbes around(scene);
  auto stage = DirectLightStage::create(scene, {});
  ASSERT_TRUE(stage);
  const std::vector<Rgb> open{{1, 1, 1}};
  lighting::DistantLight light = sun(0);
  const auto middle_x = [&](const dvec3& at) {
    for (const std::size_t object : {std::size_t{0}, std::size_t{1}})
      stage->set_pose(object, {{1, 0, 0, 0}, at});
    stage->update(std::vector{light}, 1, around);
    double sum = 0, weight = 0;
    for (const auto& on_plane : shadows_of(*stage, open)) {
      const shadows::ShadowMap& s = *on_plane.shadow;
      for (int y = 0; y < s.virtual_occlusion.height(); ++y)
        for (int x = 0; x < s.virtual_occlusion.width(); ++x) {
          const double here = s.virtual_occlusion.at(x, y);
          sum += here * (s.world_from_map * dvec3(x * s.cell_m, 0, y * s.cell_m)).x;
          weight += here;
        }
    }
    return sum / weight;
  };
  for (const double radius : {.02, .1}) {
    light.radius = Radians(radius);
    EXPECT_EQ(shadows::is_wide(light), radius == .1);
    const double before = middle_x({0, 0, 0});
    EXPECT_NEAR(middle_x({.7, 0, 0}) - before, .7, 1e-3) << radius;
  }
}

// A quarter of the directions and half of the cells: a little off, and never left like that when
// the light is to be drawn finely.
TEST(DirectLightStage, CoarseShadowsAreCloseAndBecomeFineAtOnce) {
  const PreparedScene scene = two_balls();
  const OcclusionProbes around(scene);
  const std::vector<Rgb> open{{1, 1, 1}};
  auto stage = DirectLightStage::create(scene, {});
  ASSERT_TRUE(stage);
  const auto drawn = [&](std::size_t fine) {
    stage->update(std::vector{sun(0)}, 1, around, open, fine);
    const auto all = shadows_of(*stage, open);
    EXPECT_FALSE(all.empty());
    double area = 0;
    int cells = 0;
    for (const auto& on_plane : all) {
      const shadows::ShadowMap& s = *on_plane.shadow;
      cells = std::max({cells, s.virtual_occlusion.width(), s.virtual_occlusion.height()});
      for (const float taken : s.virtual_occlusion.pixels())
        area += double(taken) * s.cell_m * s.cell_m;
    }
    return std::pair(area, cells);
  };
  const auto [coarse, few] = drawn(0);
  const auto [fine, many] = drawn(1);
  EXPECT_GT(many, 1.8 * few);
  EXPECT_NEAR(coarse, fine, .02 * fine);
  EXPECT_EQ(drawn(0).second, many) << "drawn finely already, and the light has not moved";
}

// Look-ups find what rays find, which neighbours share on so coarse a mesh; also where the other
// object takes some of the lamp.
TEST(DirectLightStage, WhatObjectsWereBakedToSeeIsAsked) {
  const prt::Mesh knot = prt::make_knot(.4f, 120, 24, {.6f, .6f, .6f});
  const PreparedScene plain = two_of(knot, false), known = two_of(knot, true);
  lighting::DistantLight lamp = sun(0);
  lamp.radius = Radians(.3);
  for (const double apart : {3., .7}) {
    std::vector<std::vector<float>> light;
    for (const PreparedScene* scene : {&plain, &known}) {
      const OcclusionProbes around(*scene);
      auto stage = DirectLightStage::create(*scene, {});
      ASSERT_TRUE(stage);
      stage->set_pose(1, {{1, 0, 0, 0}, {apart, .3, 0}});
      stage->update(std::vector{lamp}, 1, around);
      light.push_back(light_on(*stage, *scene, 0));
    }
    double square = 0, mean = 0;
    for (std::size_t i = 0; i < light[0].size(); ++i) {
      square += std::pow(double(light[1][i]) - light[0][i], 2);
      mean += light[0][i];
    }
    const auto count = static_cast<double>(light[0].size());
    EXPECT_LT(std::sqrt(square / count) / (mean / count), .2) << apart;
    EXPECT_NE(light[0], light[1]) << "the visibility map was not asked";
  }
}

// Rays and cells go where the light is: a source among much other light has fewer, and no other
// shadow than it had.
TEST(DirectLightStage, WeakSourcesAreAskedLess) {
  const prt::Mesh knot = prt::make_knot(.4f, 160, 32, {.6f, .6f, .6f});
  const PreparedScene known = two_of(knot, true), plain = two_of(knot, false);
  const auto lamp_of = [](double radius) {
    lighting::DistantLight lamp = sun(0);
    lamp.radius = Radians(radius);
    return lamp;
  };
  const auto traced = [&](const PreparedScene& scene, const lighting::DistantLight& lamp,
                          double others, int sampling) {
    const OcclusionProbes around(scene);
    auto stage = DirectLightStage::create(scene, {sampling, {}});
    EXPECT_TRUE(stage);
    stage->set_pose(1, {{1, 0, 0, 0}, {3, 0, 0}});
    const float open = luminance(lighting::irradiance(lamp, {0, 1, 0}));
    const std::vector<Rgb> on_plane(1, Rgb{open, open, open} * static_cast<float>(1 + others));
    stage->update(std::vector{lamp}, luminance(lamp.irradiance()) * (.25 + others), around,
                  on_plane);
    const auto shadows = shadows_of(*stage, on_plane);
    return std::pair(light_on(*stage, scene, 0), shadows.empty()
                                                     ? std::size_t{0}
                                                     : shadows[0].shadow->virtual_occlusion.area());
  };
  const lighting::DistantLight spot = lamp_of(.03), broad = lamp_of(.2);
  EXPECT_EQ(traced(known, spot, 9, 4).first, traced(known, spot, 0, 2).first) << "half of the rays";
  EXPECT_NE(traced(known, spot, 9, 4).first, traced(known, spot, 0, 4).first);
  EXPECT_EQ(traced(known, spot, 9, 1).first, traced(known, spot, 0, 1).first) << "hard stays hard";
  EXPECT_EQ(traced(known, spot, 9, 2).first, traced(known, spot, 0, 2).first) << "and soft soft";
  EXPECT_EQ(traced(plain, broad, 9, 4).first, traced(plain, broad, 0, 4).first)
      << "without a visibility map rays are all that it has";
  EXPECT_EQ(traced(known, spot, 9, 4).second, traced(known, spot, 0, 4).second);
  EXPECT_LT(traced(known, broad, 9, 4).second, traced(known, broad, 0, 4).second / 2)
      << "cells of its map";
}

// A lamp that is switched on fades in: what was found while it was faint does not do when it is all
// of the light. A little up and down at a limit changes nothing.
TEST(DirectLightStage, ALampThatFadesInIsTracedAnew) {
  const PreparedScene scene = two_of(prt::make_knot(.4f, 120, 24, {.6f, .6f, .6f}), false);
  const OcclusionProbes around(scene);
  lighting::DistantLight lamp = sun(0);
  lamp.radius = Radians(.2);
  const auto update = [&](DirectLightStage& stage, double fraction) {
    lighting::DistantLight now = lamp;
    now.radiance = lamp.radiance * static_cast<float>(fraction);
    const Rgb all = lighting::irradiance(lamp, {0, 1, 0});
    stage.update(std::vector{now}, luminance(lamp.irradiance()) * .9, around, std::vector{all});
    return std::pair(light_on(stage, scene, 0),
                     shadows_of(stage, {all})[0].shadow->virtual_occlusion);
  };
  auto fading = DirectLightStage::create(scene, {}), fresh = DirectLightStage::create(scene, {});
  ASSERT_TRUE(fading && fresh);
  for (DirectLightStage* stage : {&*fading, &*fresh}) stage->set_pose(1, {{1, 0, 0, 0}, {3, 0, 0}});
  const auto faint = update(*fading, .05), whole = update(*fading, 1), at_once = update(*fresh, 1);
  EXPECT_EQ(whole.first, at_once.first);
  EXPECT_EQ(whole.second, at_once.second);
  EXPECT_LT(faint.second.area(), whole.second.area() / 2);
  // Turned with each update: nothing is kept.
  for (const double fraction : {.51, .49, .45, .51}) {
    lamp.direction = glm::normalize(lamp.direction + dvec3(.1, 0, 0));
    EXPECT_GT(update(*fading, fraction).second.area(), 1.5 * double(faint.second.area()))
        << fraction;
  }
  lamp.direction = glm::normalize(lamp.direction + dvec3(.1, 0, 0));
  EXPECT_LT(update(*fading, .1).second.area(), 1.5 * double(faint.second.area()));
}

TEST(DirectLightStage, LongSourcesAreSeenPastWhatMovesAtTheirEnd) {
  const PreparedScene scene = two_balls();
  const OcclusionProbes around(scene);
  lighting::DistantLight window = sun(0);
  const dvec3 aside = glm::normalize(glm::cross(window.direction, dvec3(0, 1, 0)));
  for (const double along : {-.8, -.4, 0., .4, .8})
    window.shape.push_back(glm::normalize(window.direction + along * aside));
  auto kept = DirectLightStage::create(scene, {});
  ASSERT_TRUE(kept);
  kept->update(std::vector{window}, 1, around);
  const auto open = light_on(*kept, scene, 0);
  const Pose pose{{1, 0, 0, 0}, window.shape.back() * .9};
  auto fresh = DirectLightStage::create(scene, {});
  ASSERT_TRUE(fresh);
  for (DirectLightStage* stage : {&*kept, &*fresh}) {
    stage->set_pose(1, pose);
    stage->update(std::vector{window}, 1, around);
  }
  EXPECT_EQ(light_on(*kept, scene, 0), light_on(*fresh, scene, 0));
  EXPECT_NE(light_on(*kept, scene, 0), open) << "the place is before the window's end";
}

// An object that moves in every frame must not hide that the sun creeps on.
TEST(DirectLightStage, CreepingSunIsFollowedWhileObjectsMove) {
  const PreparedScene scene = two_balls();
  const OcclusionProbes around(scene);
  auto stage = DirectLightStage::create(scene, {});
  ASSERT_TRUE(stage);
  constexpr double kStep = 5e-4;  // radians, less than what alone would be traced anew
  stage->update(std::vector{sun(0)}, 1, around);
  const auto first = light_on(*stage, scene, 0);
  for (int frame = 1; frame <= 40; ++frame) {
    stage->set_pose(1, {{1, 0, 0, 0}, {-3, 0, .01 * frame}});
    stage->update(std::vector{sun(kStep * frame)}, 1, around);
  }
  EXPECT_NE(light_on(*stage, scene, 0), first);
}

// While something moves, nobody looks closely. Once it rests, all is as a stage of its own finds
// it.
TEST(DirectLightStage, WhatWasHurriedIsTracedWellOnceAllRests) {
  const PreparedScene scene = two_of(prt::make_knot(.5f, 96, 16, {.6f, .6f, .6f}), true);
  const OcclusionProbes around(scene);
  auto kept = DirectLightStage::create(scene, {}), fresh = DirectLightStage::create(scene, {});
  ASSERT_TRUE(kept && fresh);
  lighting::DistantLight window = sun(0);
  window.radius = Radians(.5);
  const Pose first{{1, 0, 0, 0}, {-3, 0, 0}}, last{{1, 0, 0, 0}, {-3, 0, .5}};
  const auto update = [&](DirectLightStage& stage, const Pose& pose) {
    stage.set_pose(1, pose);
    return stage.update(std::vector{window}, 1, around);
  };
  update(*kept, first);
  update(*fresh, last);
  EXPECT_TRUE(update(*kept, last));
  EXPECT_NE(light_on(*kept, scene, 1), light_on(*fresh, scene, 1));
  EXPECT_FALSE(update(*kept, last)) << "the other eye, or a view before the next pose";
  for (int frame = 0; frame < 8; ++frame) update(*kept, last);
  EXPECT_EQ(light_on(*kept, scene, 1), light_on(*fresh, scene, 1));
  EXPECT_FALSE(update(*kept, last)) << "nothing is left to do";
}

// A window as wide as a wall that turns by a degree: a tenth of its radius is three, and changes
// what a surface gets by several percent.
TEST(DirectLightStage, AWideLightThatTurnsIsFollowed) {
  const PreparedScene scene = two_balls();
  const OcclusionProbes around(scene);
  auto kept = DirectLightStage::create(scene, {});
  ASSERT_TRUE(kept);
  const auto window = [](double azimuth) {
    lighting::DistantLight d = sun(azimuth);
    d.direction = glm::normalize(dvec3(std::cos(azimuth), .7, std::sin(azimuth)));
    d.radius = Radians(.5);
    d.radiance = {1, 1, 1};
    return d;
  };
  kept->update(std::vector{window(0)}, 1, around);
  for (const double azimuth : {.003, .006, .02, .035, .05}) {
    auto fresh = DirectLightStage::create(scene, {});
    ASSERT_TRUE(fresh);
    fresh->update(std::vector{window(azimuth)}, 1, around);
    kept->update(std::vector{window(azimuth)}, 1, around);
    const auto mine = light_on(*kept, scene, 0), exact = light_on(*fresh, scene, 0);
    double square = 0, power = 0;
    for (std::size_t i = 0; i < mine.size(); ++i)
      square += std::pow(double(mine[i]) - double(exact[i]), 2),
          power += std::pow(double(exact[i]), 2);
    EXPECT_LT(std::sqrt(square / power), .01) << azimuth;
  }
}

// As casters planes are quads of single precision; beside something tiny one would cast a shadow
// on itself.
TEST(DirectLightStage, APlaneDoesNotShadeItself) {
  PreparedScene scene = two_balls();
  scene.objects.pop_back();
  for (glm::vec3& p : scene.objects[0].baked.mesh.positions) p *= .05f;  // a ball of a centimetre
  scene.planes[0].point.y = -10;  // a floor that shades no part of the wall in question
  const OcclusionProbes around(scene);
  int looked_at = 0;
  for (int k = 0; k < 60; ++k) {
    const double turn = .1 * k;
    const dvec3 normal(std::cos(turn), 0, std::sin(turn));
    scene.planes.resize(1);
    scene.planes.push_back({-.02 * normal, normal, {.4f, .4f, .4f}, {}});
    auto made = DirectLightStage::create(scene, {});
    ASSERT_TRUE(made);
    DirectLightStage stage = std::move(*made);
    if (glm::dot(normal, sun(0).direction) < .05) continue;
    stage.update(std::vector{sun(0)}, 1, around);
    for (const compositor::ShadowMapOnPlane& on :
         shadows_of(stage, std::vector<Rgb>(2, Rgb{100, 100, 100}))) {
      if (!on.real || glm::dot(on.real->world_from_map.rotation * dvec3(0, 1, 0), normal) < .99)
        continue;
      ++looked_at;
      EXPECT_EQ(std::ranges::max(on.real->virtual_occlusion.pixels()), 0) << k;
    }
  }
  EXPECT_GT(looked_at, 20);
}

}  // namespace
}  // namespace penumbra::runtime
