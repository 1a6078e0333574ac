#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <iterator>
#include <string>

#include "compositor/composite/compositor.h"
#include "tests/support/temp_folder.h"

namespace penumbra::compositor {
namespace {

namespace fs = std::filesystem;

std::string content(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

Image<Rgb8> picture(int width, int height, int number) {
  Image<Rgb8> out(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      out.at(x, y) = {std::uint8_t(x + 10 * number), std::uint8_t(y), std::uint8_t(40 * number)};
  return out;
}

/// Number of samples in the only track: the sample count of its "stsz" box (ISO 14496-12).
unsigned samples_in(const std::string& file) {
  const auto at = file.find("stsz");
  if (at == std::string::npos || at + 16 > file.size()) return 0;
  unsigned count = 0;
  for (std::size_t i = at + 12; i < at + 16; ++i)
    count = count << 8 | static_cast<unsigned char>(file[i]);
  return count;
}

class VideoWriterTest : public testing::Test {
 protected:
  Result<VideoWriter> open(const fs::path& path, int width = 64, int height = 48) {
    return VideoWriter::create(path, width, height, 30);
  }
  fs::path path() const { return folder_.path() / "video.mp4"; }
  void write_all(const fs::path& to, int width = 64, int height = 48) {
    auto writer = open(to, width, height);
    if (!writer && writer.error().code == ErrorCode::kUnavailable)
      GTEST_SKIP() << "no video encoder: " << writer.error().detail;
    ASSERT_TRUE(writer) << writer.error().detail;
    for (int i = 0; i < 10; ++i) {
      ASSERT_TRUE(writer->write(picture(width, height, i)));
      ASSERT_FALSE(fs::exists(to)) << "the file must not be seen before it is whole";
    }
    ASSERT_TRUE(writer->finish());
  }
  test::TempFolder folder_;
};

TEST_F(VideoWriterTest, TenFramesAppearAsAWholeFileOnFinish) {
  write_all(path());
  const std::string file = content(path());
  EXPECT_EQ(file.substr(4, 4), "ftyp");
  EXPECT_NE(file.find("moov"), std::string::npos);
  EXPECT_EQ(samples_in(file), 10U);
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_.path()), fs::directory_iterator()), 1);
}

TEST_F(VideoWriterTest, LiveVideoIsWholeToo) {
  auto writer = VideoWriter::create(path(), 64, 48, 30, true);
  if (!writer && writer.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no video encoder: " << writer.error().detail;
  ASSERT_TRUE(writer) << writer.error().detail;
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(writer->write(picture(64, 48, i)));
  ASSERT_TRUE(writer->finish());
  EXPECT_EQ(samples_in(content(path())), 10U);
}

TEST_F(VideoWriterTest, SameFramesGiveTheSameBytes) {
  write_all(path());
  write_all(folder_.path() / "again.mp4");
  EXPECT_EQ(content(path()), content(folder_.path() / "again.mp4"));
}

TEST_F(VideoWriterTest, OddSizesLoseTheirLastRowAndColumn) {
  write_all(path(), 65, 49);
  EXPECT_EQ(samples_in(content(path())), 10U);
}

TEST_F(VideoWriterTest, UnfinishedLeavesNothing) {
  {
    auto writer = open(path());
    if (!writer && writer.error().code == ErrorCode::kUnavailable)
      GTEST_SKIP() << "no video encoder: " << writer.error().detail;
    ASSERT_TRUE(writer);
    for (int i = 0; i < 5; ++i) ASSERT_TRUE(writer->write(picture(64, 48, i)));
  }
  EXPECT_TRUE(folder_.empty());
}

TEST_F(VideoWriterTest, UnfinishedLeavesAnOlderFileAlone) {
  std::ofstream(path()) << "older";
  {
    auto writer = open(path());
    if (!writer) GTEST_SKIP() << "no video encoder: " << writer.error().detail;
    ASSERT_TRUE(writer->write(picture(64, 48, 1)));
  }
  EXPECT_EQ(content(path()), "older");
}

TEST_F(VideoWriterTest, FolderThatCannotBeWrittenIsAnErrorNamingTheFile) {
  std::ofstream(folder_.path() / "plain") << "a file, not a folder";
  for (const fs::path& bad :
       {folder_.path() / "plain" / "video.mp4", folder_.path() / "nowhere" / "video.mp4"}) {
    const auto writer = open(bad);
    ASSERT_FALSE(writer);
    EXPECT_EQ(writer.error().code, ErrorCode::kUnwritable) << writer.error().detail;
    EXPECT_EQ(writer.error().where, bad.string());
  }
}

TEST_F(VideoWriterTest, RefusesEmptySizesRatesAndChangedFrames) {
  for (const auto& [width, height, fps] :
       {std::tuple{0, 48, 30.}, {64, 1, 30.}, {64, 48, 0.}, {64, 48, -1.}, {64, 48, NAN}}) {
    const auto writer = VideoWriter::create(path(), width, height, fps);
    ASSERT_FALSE(writer) << width << 'x' << height << ' ' << fps;
    EXPECT_EQ(writer.error().code, ErrorCode::kInvalid);
  }
  auto writer = open(path());
  if (!writer) GTEST_SKIP() << "no video encoder: " << writer.error().detail;
  const auto written = writer->write(picture(48, 64, 0));
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kInvalid);
}

}  // namespace
}  // namespace penumbra::compositor
