// What a run leaves in its output folder.
#include <gtest/gtest.h>

#include <cstdio>
#include <fstream>
#include <memory>

#include "codec/codec.h"
#include "tests/support/temp_folder.h"
#include "tools/runs/output.h"

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

/// Two bytes, so far after the name of a box.
unsigned number_after(const std::string& file, const std::string& box, std::size_t offset) {
  const auto at = file.find(box);
  if (at == std::string::npos || at + 6 + offset > file.size()) return 0;
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(file[at + 4 + i]); };
  return static_cast<unsigned>(byte(offset) << 8 | byte(offset + 1));
}

std::shared_ptr<const FramePixels> grey(int code) {
  const auto c = static_cast<std::uint8_t>(code);
  return std::make_shared<const FramePixels>(Image<Rgb8>(64, 48, {c, c, c}));
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

// The right eye begins a frame early, and one left frame is lost: what is shown is of one moment.
TEST(FrameWriter, VideoHoldsBothEyesSideBySideOfOneMoment) {
  const test::TempFolder folder;
  StageTimes times;
  auto writer =
      FrameWriter::create({.folder = folder.path(), .stills = false, .fps = 30, .eyes = 2}, times);
  ASSERT_TRUE(writer);
  const auto write = [&](int frame, int eye) {
    const TimestampNs time = TimestampNs{0} + Seconds((frame + .1 * eye) / 30.);
    EXPECT_TRUE((*writer)->write("", grey(eye == 0 ? 40 : 200), FrameWriter::InVideo{time, eye}));
  };
  write(0, 1);
  for (int frame = 1; frame < 6; ++frame) {
    if (frame != 3) write(frame, 0);
    write(frame, 1);
  }
  const auto finished = (*writer)->finish();
  if (!finished && finished.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no video encoder: " << finished.error().detail;
  ASSERT_TRUE(finished) << finished.error().detail;
  std::ifstream in(folder.path() / "video.mp4", std::ios::binary);
  const std::string file{std::istreambuf_iterator<char>(in), {}};
  // Width of the only track, 16.16 in its "tkhd" box, and its samples in "stsz" (ISO 14496-12).
  EXPECT_EQ(number_after(file, "tkhd", 76), 128u);
  EXPECT_EQ(number_after(file, "stsz", 10), 4u);
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
  const auto run = [&](int frames, bool video) {
    auto out = OutputFolder::create(folder.path());
    ASSERT_TRUE(out);
    ASSERT_TRUE(out->begin());
    for (int i = 0; i < frames; ++i)
      std::ofstream(out->file("frame_00000" + std::to_string(i) + ".png")) << frames;
    if (video) std::ofstream(out->file("video.mp4")) << frames;
    ASSERT_TRUE(out->keep(OutputFolder::EarlierFrames::kGo));
  };
  for (const char* name : {"notes.txt", "frame_notes.txt", "frame_1.png"})
    std::ofstream(folder.path() / name) << "mine";
  fs::create_directory(folder.path() / "frame_000009.png");
  run(3, true);
  EXPECT_TRUE(fs::exists(folder.path() / "video.mp4"));
  run(2, false);
  EXPECT_TRUE(fs::exists(folder.path() / "frame_000001.png"));
  EXPECT_FALSE(fs::exists(folder.path() / "frame_000002.png"));
  EXPECT_FALSE(fs::exists(folder.path() / "video.mp4"));
  for (const char* name : {"notes.txt", "frame_notes.txt", "frame_1.png", "frame_000009.png"})
    EXPECT_TRUE(fs::exists(folder.path() / name)) << name;
}

}  // namespace
}  // namespace penumbra::tools
