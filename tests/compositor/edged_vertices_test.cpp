// A light whose shadow is drawn finer than the object's mesh.
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <vector>

#include "compositor/composite/compositor.h"
#include "prt/prt.h"
#include "prt/rays/fine_form.h"
#include "tests/support/offscreen_compositor.h"
#include "tests/support/scenes.h"

namespace penumbra::compositor {
namespace {

using test::kSceneHeight, test::kSceneWidth;

class EdgedVerticesTest : public test::OffscreenCompositor {
 protected:
  View view() const { return {test::scene_camera(), nullptr, .5f}; }
  Image<Rgb> composited_floats(const Image<Rgb>& frame, const View& v) {
    FramePixels out = frame;
    const auto done = compositor_->composite(v, out);
    EXPECT_TRUE(done) << done.error().detail;
    return std::get<Image<Rgb>>(out);
  }
};

// Pixels of a row through the ball's middle that are neither lit nor dark: from -.05 to .05 m the
// fraction runs over 20 of the edge's widths.
std::size_t half_lit_pixels(const Image<Rgb>& picture) {
  const float most = std::ranges::max(picture.pixels(), {}, &Rgb::g).g;
  std::size_t count = 0;
  for (int x = 40; x < 120; ++x) {
    const float g = picture.at(x, 60).g;
    count += g > .1f * most && g < .9f * most;
  }
  return count;
}

// Vertices tell how far off an edge they lie, and it is drawn there, not from one to the next: on
// objects with and without pictures and materials, and lit at fewer vertices than are drawn.
TEST_F(EdgedVerticesTest, EdgeOfALightIsAsSharpAsAPixelOnACoarseMesh) {
  prt::BakeOptions options;
  options.bands = 1, options.bounces = 0, options.rays = 64;
  const auto coarse = prt::bake(prt::make_sphere({0, .4f, 0}, .4f, 2, {1, 1, 1}), options);
  ASSERT_TRUE(coarse);
  prt::BakedObject with_material = *coarse;
  prt::SurfaceMaterials surface;
  surface.materials.emplace_back().roughness = 1;
  surface.material.assign(coarse->mesh.positions.size(), 0);
  with_material.surface = std::make_shared<const prt::SurfaceMaterials>(surface);
  prt::BakedObject of_two_forms = *coarse;
  auto form = prt::lit_by(prt::make_sphere({0, .4f, 0}, .4f, 4, {1, 1, 1}), coarse->mesh);
  ASSERT_TRUE(form);
  of_two_forms.fine = std::make_shared<const prt::FineForm>(std::move(*form));
  const std::size_t vertices = coarse->mesh.positions.size();
  Appearance pictured;
  const Image<Rgb8> white(4, 4, Rgb8{255, 255, 255});
  const std::vector<glm::vec2> places(vertices, {.5f, .5f});
  pictured.texture = &white;
  pictured.texture_coordinates = places;
  const std::vector<float> zeros(vertices), open(vertices, 1.f);
  std::vector<float> far(vertices), near(vertices);
  for (std::size_t i = 0; i < vertices; ++i) {
    far[i] = .5f + 200 * coarse->mesh.positions[i].x;
    near[i] = std::clamp(far[i], 0.f, 1.f);
  }
  const std::vector<float> none(3 * coarse->transfer.stride, 0.f);
  const Image<Rgb> black(kSceneWidth, kSceneHeight);
  struct Kind {
    const char* name;
    const prt::BakedObject& object;
    Appearance appearance;
  };
  for (const Kind& kind :
       {Kind{"plain", *coarse, {}}, Kind{"with a picture", *coarse, pictured},
        Kind{"with a material", with_material, {}}, Kind{"of two forms", of_two_forms, {}}}) {
    SetUp();
    const int handle = compositor_->add_object(kind.object, kind.appearance);
    const EdgedLight naive{{1, 1, 1}, zeros, open, near}, edged{{1, 1, 1}, zeros, open, far};
    compositor_->set_light(handle, none, {}, {1, 1, 1}, &naive);
    EXPECT_GT(half_lit_pixels(composited_floats(black, view())), 4U) << kind.name;
    compositor_->set_light(handle, none, {}, {1, 1, 1}, &edged);
    EXPECT_LE(half_lit_pixels(composited_floats(black, view())), 2U) << kind.name;
    compositor_->set_light(handle, none, {}, {1, 1, 1});
    const Image<Rgb> dark = composited_floats(black, view());
    EXPECT_EQ(std::ranges::max(dark.pixels(), {}, &Rgb::g).g, 0) << kind.name;
  }
}

}  // namespace
}  // namespace penumbra::compositor
