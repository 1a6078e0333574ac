// The view camera's blur, and what a capture folder says about blur and noise.
#include <gtest/gtest.h>

#include <cmath>

#include "calib/calib.h"
#include "capture/capture.h"
#include "tests/support/temp_folder.h"

namespace penumbra::capture {
namespace {

TEST(Blur, SpreadsAPointByItsVarianceAndKeepsItsLight) {
  for (const double sigma : {.3, .7, 1.5, 4.}) {
    Image<Rgb> picture(81, 81);
    picture.at(40, 40) = {1, 2, 3};
    blur(picture, sigma);
    double sum = 0, square_x = 0, square_y = 0;
    for (int y = 0; y < 81; ++y)
      for (int x = 0; x < 81; ++x) {
        const double v = double(picture.at(x, y).g);
        sum += v;
        square_x += v * (x - 40) * (x - 40);
        square_y += v * (y - 40) * (y - 40);
      }
    EXPECT_NEAR(sum, 2, 1e-5) << sigma;
    EXPECT_NEAR(square_x / sum / (sigma * sigma), 1, .01) << sigma;
    EXPECT_NEAR(square_y / sum / (sigma * sigma), 1, .01) << sigma;
  }
}

TEST(Blur, LeavesAnEvenPictureEvenUpToItsEdges) {
  Image<Rgb> picture(9, 5, {.25f, .5f, 1});
  blur(picture, 2);
  for (const Rgb& p : picture.pixels()) {
    EXPECT_NEAR(p.r, .25f, 1e-6f);
    EXPECT_NEAR(p.b, 1, 1e-6f);
  }
}

TEST(Sensor, BlursLightAndNotItsOwnNoise) {
  Sensor sensor;
  sensor.bits = 16;
  Image<Rgb> radiance(64, 64, {.2f, .2f, .2f});
  FramePixels sharp, soft;
  expose(sensor, radiance, {Seconds(1), Gain(1)}, 5, sharp);
  sensor.psf_sigma_px = 3;
  expose(sensor, radiance, {Seconds(1), Gain(1)}, 5, soft);
  int largest = 0;  // the blurred light of an even picture rounds differently, no more
  for (std::size_t i = 0; i < radiance.area(); ++i)
    largest = std::max(largest, std::abs(std::get<Image<Rgb16>>(sharp).pixels()[i].g -
                                         std::get<Image<Rgb16>>(soft).pixels()[i].g));
  EXPECT_LE(largest, 1);
}

/// Dark to the left, bright to the right.
class EdgeWorld : public RadianceWorld {
 public:
  Rgb radiance(const glm::dvec3&, const glm::dvec3& d) const override { return far_radiance(d); }
  Rgb far_radiance(const glm::dvec3& d) const override {
    return d.x > 0 ? Rgb{.8f, .8f, .8f} : Rgb{.1f, .1f, .1f};
  }
};

TEST(Studio, OnlyTheViewCameraIsBlurred) {
  const auto frames_with = [](double sigma) {
    StudioOptions o;
    o.environment_width = 32, o.environment_height = 16;
    o.view_width = 40, o.view_height = 30;
    o.view_focal_px = 40;
    o.schedule = {{Seconds(.9), Gain(1)}};
    o.view_exposure = Exposure{Seconds(1), Gain(1)};
    o.view_frames = 1;
    o.sensor.noisy = false;
    o.sensor.bits = 16;
    o.sensor.psf_sigma_px = sigma;
    Studio studio(std::make_shared<EdgeWorld>(), o);
    EXPECT_EQ(studio.cameras()[0].psf_sigma_px, 0);
    EXPECT_EQ(studio.cameras()[1].psf_sigma_px, sigma);
    EXPECT_FALSE(studio.cameras()[1].noise_known) << "a sensor without noise";
    std::vector<Image<Rgb16>> out;
    for (int k = 0; k < 2; ++k) out.push_back(std::get<Image<Rgb16>>(*(**studio.next()).pixels));
    const Image<Rgb> truth = studio.view_radiance();
    EXPECT_NEAR(out[1].at(19, 15).g / 65535., truth.at(19, 15).g, 2e-5) << "the truth is blurred";
    return out;
  };
  const auto sharp = frames_with(0), soft = frames_with(2);
  EXPECT_EQ(sharp[0], soft[0]) << "environment";
  EXPECT_NEAR(sharp[1].at(19, 15).g / 65535., .1, 1e-4);
  // Half a pixel beside the edge, sigma 2: .1 + .7 Phi(-.25)
  EXPECT_NEAR(soft[1].at(19, 15).g / 65535., .1 + .7 * .4013, .01);
}

// ------------------------------------------------------------------------------------- folder

Result<CameraInfo> through_a_folder(const CameraInfo& info) {
  const test::TempFolder folder;
  PENUMBRA_ASSIGN(writer, CaptureFolderWriter::create(folder.path(), {info}));
  Frame frame;
  frame.exposure = {Seconds(.01), Gain(1)};
  frame.pixels = std::make_shared<const FramePixels>(Image<Rgb8>(8, 6));
  PENUMBRA_TRY(writer.write(frame));
  PENUMBRA_TRY(writer.finish());
  PENUMBRA_ASSIGN(source, open_capture_folder(folder.path()));
  return source->cameras()[0];
}

TEST(CaptureFolder, KeepsBlurAndWhetherTheNoiseIsKnown) {
  CameraInfo info;
  info.name = "view";
  info.role = Role::kView;
  info.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 8, 6);
  const auto plain = through_a_folder(info);
  ASSERT_TRUE(plain) << plain.error().detail;
  EXPECT_FALSE(plain->noise_known);
  EXPECT_EQ(plain->psf_sigma_px, 0);
  info.noise_known = true;  // by chance what merging assumes
  info.psf_sigma_px = .65;
  const auto known = through_a_folder(info);
  ASSERT_TRUE(known) << known.error().detail;
  EXPECT_TRUE(known->noise_known);
  EXPECT_EQ(known->psf_sigma_px, .65);
  EXPECT_EQ(known->noise.full_well_electrons, info.noise.full_well_electrons);
  EXPECT_EQ(known->noise.read_noise, info.noise.read_noise);
}

TEST(CaptureFolder, RefusesAnImpossibleBlur) {
  CameraInfo info;
  info.name = "view";
  info.role = Role::kView;
  info.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 8, 6);
  for (const double sigma : {21., 1e9}) {
    info.psf_sigma_px = sigma;
    const auto refused = through_a_folder(info);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalid);
    EXPECT_NE(refused.error().detail.find("psf_sigma_px"), std::string::npos);
  }
}

}  // namespace
}  // namespace penumbra::capture
