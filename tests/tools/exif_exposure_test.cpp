// Exposure times that cameras wrote into JPEGs.
#include "tools/pictures/exif_exposure.h"

#include <gtest/gtest.h>

#include <fstream>

#include "codec/codec.h"
#include "tests/support/shared_data.h"
#include "tests/support/temp_folder.h"
#include "tools/pictures/bracket_files.h"

namespace penumbra::tools {
namespace {

namespace fs = std::filesystem;
using Block = std::vector<unsigned char>;

void put(Block& to, std::uint32_t value, int bytes) {  // little-endian
  for (int i = 0; i < bytes; ++i) to.push_back(static_cast<unsigned char>(value >> 8 * i));
}

struct Tags {
  std::uint32_t time_numerator = 1, time_denominator = 60, iso = 100, f_tenths = 56;
  bool has_time = true;
};

// A JPEG of 16 x 8 pixels with one EXIF directory (EXIF 2.3, section 4.5).
Block jpeg_with(const Tags& tags, std::uint8_t grey = 100) {
  Block tiff{'I', 'I', 42, 0};
  put(tiff, 8, 4);
  put(tiff, 1, 2);  // directory 0 points to the EXIF directory
  put(tiff, 0x8769, 2), put(tiff, 4, 2), put(tiff, 1, 4), put(tiff, 26, 4);
  put(tiff, 0, 4);
  const std::uint32_t entries = tags.has_time ? 3 : 2, values = 26 + 2 + 12 * entries + 4;
  put(tiff, entries, 2);
  if (tags.has_time) put(tiff, 0x829a, 2), put(tiff, 5, 2), put(tiff, 1, 4), put(tiff, values, 4);
  put(tiff, 0x829d, 2), put(tiff, 5, 2), put(tiff, 1, 4), put(tiff, values + 8, 4);
  put(tiff, 0x8827, 2), put(tiff, 3, 2), put(tiff, 1, 4), put(tiff, tags.iso, 4);
  put(tiff, 0, 4);
  put(tiff, tags.time_numerator, 4), put(tiff, tags.time_denominator, 4);
  put(tiff, tags.f_tenths, 4), put(tiff, 10, 4);

  const Block picture = *codec::encode_jpeg(Image<Rgb8>(16, 8, {grey, grey, grey}));
  Block out(picture.begin(), picture.begin() + 2);
  out.insert(out.end(), {0xff, 0xe1});
  const std::size_t length = 8 + tiff.size();
  out.push_back(static_cast<unsigned char>(length >> 8));
  out.push_back(static_cast<unsigned char>(length));
  out.insert(out.end(), {'E', 'x', 'i', 'f', 0, 0});
  out.insert(out.end(), tiff.begin(), tiff.end());
  out.insert(out.end(), picture.begin() + 2, picture.end());
  return out;
}

class ExifExposureTest : public testing::Test {
 protected:
  std::string write(const std::string& name, const Block& bytes) {
    const fs::path path = folder_.path() / name;
    std::ofstream(path, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()),
               static_cast<std::streamsize>(bytes.size()));
    return path.string();
  }
  test::TempFolder folder_;
};

TEST_F(ExifExposureTest, IsReadAsWritten) {
  const auto got = read_exif_exposure(write("a.jpg", jpeg_with({1, 250, 400, 28})));
  ASSERT_TRUE(got) << got.error().detail;
  EXPECT_DOUBLE_EQ(got->time.count(), 1 / 250.);
  EXPECT_EQ(got->iso, 400);
  EXPECT_DOUBLE_EQ(got->f_number.value_or(0), 2.8);
}

TEST_F(ExifExposureTest, WithoutATimeIsRefused) {
  const auto code = [&](const Block& bytes) {
    const auto got = read_exif_exposure(write("b.jpg", bytes));
    return got ? ErrorCode::kInvalid : got.error().code;
  };
  EXPECT_EQ(code(jpeg_with({.has_time = false})), ErrorCode::kUndetermined);
  EXPECT_EQ(code(jpeg_with({.time_denominator = 0})), ErrorCode::kUndetermined);
  EXPECT_EQ(code(jpeg_with({.time_numerator = 0})), ErrorCode::kUndetermined);
  EXPECT_EQ(code(*codec::encode_jpeg(Image<Rgb8>(16, 8))), ErrorCode::kUndetermined);
  EXPECT_EQ(read_exif_exposure(folder_.path() / "none.jpg").error().code, ErrorCode::kNotFound);
}

// Cut anywhere, and with any byte of the directory changed: an answer or an error, never more.
TEST_F(ExifExposureTest, DamagedFilesAreSurvived) {
  const Block whole = jpeg_with({});
  for (std::size_t n = 1; n < 140; ++n)
    (void)read_exif_exposure(
        write("c.jpg", Block(whole.begin(), whole.begin() + std::ptrdiff_t(n))));
  for (std::size_t n = 2; n < 120; ++n)
    for (const unsigned char value : {0x00, 0x7f, 0xff}) {
      Block other = whole;
      other[n] = value;
      const auto got = read_exif_exposure(write("d.jpg", other));
      if (got) {
        EXPECT_TRUE(got->time.count() > 0 && std::isfinite(got->time.count())) << n;
      }
    }
}

TEST_F(ExifExposureTest, BracketTakesTimesAtTheIsoOfItsFirstPicture) {
  const std::string a = write("a.jpg", jpeg_with({1, 100, 100, 56}, 40)),
                    b = write("b.jpg", jpeg_with({1, 50, 200, 56}, 90)),
                    other_stop = write("c.jpg", jpeg_with({1, 50, 100, 80})),
                    untold = write("d.jpg", jpeg_with({.has_time = false}));
  const auto stack = read_bracket({a, b}, "");
  ASSERT_TRUE(stack) << stack.error().detail;
  EXPECT_DOUBLE_EQ(stack->exposures[0].time.count(), .01);
  EXPECT_DOUBLE_EQ(stack->exposures[1].time.count(), .04);
  EXPECT_EQ(read_bracket({a, other_stop}, "").error().code, ErrorCode::kInvalid);
  const auto none = read_bracket({a, untold}, "");
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().where, untold);
  const auto told = read_bracket({a, untold}, "1,2");
  ASSERT_TRUE(told);
  EXPECT_DOUBLE_EQ(told->exposures[0].time.count(), 1) << "what the user says wins";
}

TEST(ExifExposure, OfARealCameraIsTwoStopsApart) {
  PENUMBRA_NEED_SHARED(first, "eval-only/stacks/pingpong/Img1.JPG");
  std::vector<double> times;
  for (const char* name : {"Img1.JPG", "Img2.JPG", "Img3.JPG"}) {
    const auto got = read_exif_exposure(first.parent_path() / name);
    ASSERT_TRUE(got) << got.error().detail;
    times.push_back(got->time.count());
  }
  EXPECT_NEAR(std::log2(times[1] / times[0]), 2, .1);
  EXPECT_NEAR(std::log2(times[2] / times[1]), 2, .1);
}

}  // namespace
}  // namespace penumbra::tools
