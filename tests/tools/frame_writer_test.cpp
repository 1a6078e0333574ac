// What a run leaves in its output folder.
#include <gtest/gtest.h>

#include <cstdio>
#include <fstream>
#include <memory>

#include "codec/codec.h"
#include "tests/support/temp_folder.h"
#include "tools/common/output.h"

namespace penumbra::tools {
namespace {

namespace fs = std::filesystem;

std::shared_ptr<const FramePixels> picture(int number) {
  Image<Rgb8> out(64, 48);
  for (int y = 0; y < 48; ++y)
    for (int x = 0; x < 64; ++x)
      out.at(x, y) = {std::uint8_t(x + number), std::uint8_t(y), std::uint8_t(number)};
  return std::make_shared<const FramePixels>(std::move(out));
}

/// Width and height of the only track: 16.16 at the end of its "tkhd" box (ISO 14496-12).
std::pair<int, int> size_of_video(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  const std::string file{std::istreambuf_iterator<char>(in), {}};
  const auto box = file.find("tkhd");
  if (box == std::string::npos) return {};
  const auto at = [&](std::size_t i) {
    return static_cast<unsigned char>(file[box + 4 + i]) << 8 |
           static_cast<unsigned char>(file[box + 5 + i]);
  };
  return {at(76), at(80)};
}

TEST(FrameWriter, StillsOfAllThreadsAreWholeAndTheirOwn) {
  const test::TempFolder folder;
  StageTimes times;
  auto writer = FrameWriter::create({.folder = folder.path(), .video = false}, times);
  ASSERT_TRUE(writer);
  constexpr int kFrames = 40;
  for (int i = 0; i < kFrames; ++i)
    ASSERT_TRUE((*writer)->write("frame_" + std::to_string(i) + ".png", picture(i), {}));
  ASSERT_TRUE((*writer)->finish());
  for (int i = 0; i < kFrames; ++i) {
    const auto back = codec::read_frame(folder.path() / ("frame_" + std::to_string(i) + ".png"));
    ASSERT_TRUE(back) << i;
    EXPECT_EQ(std::get<Image<Rgb8>>(*back).pixels()[0],
              (Rgb8{std::uint8_t(i), 0, std::uint8_t(i)}));
  }
}

TEST(FrameWriter, VideoHoldsBothEyesSideBySide) {
  const test::TempFolder folder;
  StageTimes times;
  auto writer = FrameWriter::create({.folder = folder.path(), .stills = false, .eyes = 2}, times);
  ASSERT_TRUE(writer);
  for (int i = 0; i < 5; ++i)
    for (int eye = 0; eye < 2; ++eye)
      if (!(*writer)->write("", picture(i), eye)) break;
  const auto finished = (*writer)->finish();
  if (!finished && finished.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no video encoder: " << finished.error().detail;
  ASSERT_TRUE(finished) << finished.error().detail;
  EXPECT_EQ(size_of_video(folder.path() / "video.mp4"), (std::pair{128, 48}));
}

TEST(FrameWriter, ErrorOfOneThreadRefusesTheRest) {
  const test::TempFolder folder;
  StageTimes times;
  auto writer = FrameWriter::create({.folder = folder.path(), .video = false}, times);
  ASSERT_TRUE(writer);
  bool taken = true;
  for (int i = 0; i < 100 && taken; ++i)
    taken = (*writer)->write("no/such/folder/frame.png", picture(i), {});
  EXPECT_FALSE(taken);
  const auto finished = (*writer)->finish();
  ASSERT_FALSE(finished);
  EXPECT_EQ(finished.error().code, ErrorCode::kUnwritable);
}

// Two frames after three: the third would be taken for one of this run.
TEST(OutputFolder, FramesOfAnEarlierRunDoNotStay) {
  const test::TempFolder folder;
  const auto run = [&](int frames) {
    auto out = OutputFolder::create(folder.path());
    ASSERT_TRUE(out);
    ASSERT_TRUE(out->begin());
    for (int i = 0; i < frames; ++i)
      std::ofstream(out->file("frame_" + std::to_string(i) + ".png")) << frames;
    ASSERT_TRUE(out->keep("frame_"));
  };
  std::ofstream(folder.path() / "notes.txt") << "mine";
  run(3);
  run(2);
  EXPECT_TRUE(fs::exists(folder.path() / "frame_1.png"));
  EXPECT_FALSE(fs::exists(folder.path() / "frame_2.png"));
  EXPECT_TRUE(fs::exists(folder.path() / "notes.txt"));
}

}  // namespace
}  // namespace penumbra::tools
