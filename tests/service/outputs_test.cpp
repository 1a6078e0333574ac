// The picture in other programs' hands: its colours, its times, and consumers that stop or leave.
#include "service/outputs/frame_output.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <iterator>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "capture/unique_fd.h"
#include "core/io/log.h"
#include "service/outputs/colour_conversion.h"
#include "tests/support/moving_bars.h"
#include "tests/support/temp_folder.h"

namespace penumbra::service {

namespace {

using Clock = std::chrono::steady_clock;
using Codes = std::vector<std::uint8_t>;

// BT.709 in the range of video, before it is rounded.
std::array<double, 3> exact_codes(Rgb8 p) {
  const double r = p.r / 255., g = p.g / 255., b = p.b / 255.;
  const double y = .2126 * r + .7152 * g + .0722 * b;
  return {16 + 219 * y, 128 + 224 * (b - y) / 1.8556, 128 + 224 * (r - y) / 1.5748};
}

Codes yuv420(const Image<Rgb8>& in) {
  Codes out(yuv420_bytes(in.width(), in.height()));
  to_yuv420(in, out);
  return out;
}

TEST(ColourConversion, GivesTheCodesOfTheStandard) {
  const std::pair<Rgb8, Codes> known[] = {
      {{255, 255, 255}, {235, 128, 128}}, {{0, 0, 0}, {16, 128, 128}},
      {{255, 0, 0}, {63, 102, 240}},      {{0, 255, 0}, {173, 42, 26}},
      {{0, 0, 255}, {32, 240, 118}},      {{255, 255, 0}, {219, 16, 138}},
      {{0, 255, 255}, {188, 154, 16}},    {{255, 0, 255}, {78, 214, 230}},
      {{128, 128, 128}, {126, 128, 128}}};
  for (const auto& [colour, codes] : known) {
    const Codes planar = yuv420(Image<Rgb8>(2, 2, colour));
    EXPECT_EQ(planar, (Codes{codes[0], codes[0], codes[0], codes[0], codes[1], codes[2]}));
    Codes packed(4);
    to_yuyv(Image<Rgb8>(2, 1, colour), packed.data(), 4);
    EXPECT_EQ(packed, (Codes{codes[0], codes[1], codes[0], codes[2]}));
    Codes bgrx(4);
    to_bgrx(Image<Rgb8>(1, 1, colour), bgrx.data(), 4);
    EXPECT_EQ(bgrx, (Codes{colour.b, colour.g, colour.r, 255}));
  }
}

TEST(ColourConversion, RoundsEveryColourToTheNearestCode) {
  for (int r = 0; r < 256; r += 5)
    for (int g = 0; g < 256; g += 5)
      for (int b = 0; b < 256; b += 5) {
        const Rgb8 colour{static_cast<std::uint8_t>(r), static_cast<std::uint8_t>(g),
                          static_cast<std::uint8_t>(b)};
        const auto exact = exact_codes(colour);
        const Codes codes = yuv420(Image<Rgb8>(2, 2, colour));
        for (int i = 0; i < 3; ++i)
          ASSERT_NEAR(codes[static_cast<std::size_t>(i == 0 ? 0 : 3 + i)],
                      exact[static_cast<std::size_t>(i)], .51)
              << r << ' ' << g << ' ' << b;
      }
}

// Of a red column, chroma on the column itself gets a half; one beside it gives a quarter to each.
TEST(ColourConversion, ChromaLiesOnTheLeftOfTwoColumnsAndBetweenTwoRows) {
  const auto red_difference = [](int red_column, int red_row) {
    Image<Rgb8> in(8, 2);
    for (int y = 0; y < 2; ++y)
      for (int x = 0; x < 8; ++x)
        if (x == red_column && (red_row < 0 || y == red_row)) in.at(x, y) = {255, 0, 0};
    const Codes all = yuv420(in);
    return Codes(all.end() - 4, all.end());
  };
  EXPECT_EQ(red_difference(4, -1), (Codes{128, 128, 184, 128}));
  EXPECT_EQ(red_difference(3, -1), (Codes{128, 156, 156, 128}));
  EXPECT_EQ(red_difference(0, -1), (Codes{212, 128, 128, 128})) << "the border repeats";
  EXPECT_EQ(red_difference(4, 0), red_difference(4, 1));
  EXPECT_EQ(red_difference(4, 0), (Codes{128, 128, 156, 128}));
}

TEST(ColourConversion, OddSizesHaveChromaForTheirLastColumnAndRow) {
  EXPECT_EQ(yuv420_bytes(5, 3), 15u + 2 * 6);
  const Codes all = yuv420(Image<Rgb8>(5, 3, {255, 0, 0}));
  for (std::size_t i = 0; i < all.size(); ++i)
    ASSERT_EQ(all[i], i < 15 ? 63 : i < 21 ? 102 : 240) << i;
  EXPECT_EQ(yuv420(Image<Rgb8>(1, 1, {255, 0, 0})), (Codes{63, 102, 240}));
}

// Lines of the log while it lives.
class Told {
 public:
  Told() {
    set_log_sink([this](LogLevel, std::string_view line) {
      const std::scoped_lock lock(mutex_);
      lines_.emplace_back(line);
    });
  }
  ~Told() {
    set_log_sink([](LogLevel, std::string_view line) { fmt::print(stderr, "{}\n", line); });
  }
  std::vector<std::string> lines() const {
    const std::scoped_lock lock(mutex_);
    return lines_;
  }

 private:
  mutable std::mutex mutex_;
  std::vector<std::string> lines_;
};

bool comes_true(const std::function<bool()>& what) {
  constexpr std::chrono::seconds kLimit(20);
  const auto until = Clock::now() + kLimit;
  while (!what() && Clock::now() < until) std::this_thread::sleep_for(std::chrono::milliseconds(2));
  return what();
}

std::shared_ptr<const FramePixels> grey_frame(int level, int width = 16, int height = 8) {
  const auto code = static_cast<std::uint8_t>(level);
  return std::make_shared<const FramePixels>(Image<Rgb8>(width, height, {code, code, code}));
}

TimestampNs at_s(double seconds) {
  return TimestampNs{1'000'000'000'000} + Seconds(seconds);
}

// One after the other, so that none is overtaken.
void show_all(FrameOutput& output, const std::vector<double>& times_s) {
  for (std::size_t i = 0; i < times_s.size(); ++i) {
    const auto before = output.counts().shown;
    output.show(grey_frame(static_cast<int>(10 * (i + 1))), at_s(times_s[i]));
    ASSERT_TRUE(comes_true([&] { return output.counts().shown > before; })) << times_s[i];
  }
}

std::string contents(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

// Which of show_all()'s frames stand in a file, in their order.
std::vector<int> numbers_in(const std::filesystem::path& path) {
  const std::string all = contents(path);
  const std::size_t frame = 6 + yuv420_bytes(16, 8);
  std::vector<int> out;
  for (std::size_t at = all.find('\n') + 1; at + frame <= all.size(); at += frame) {
    EXPECT_EQ(all.substr(at, 6), "FRAME\n");
    const auto luma = static_cast<std::uint8_t>(all[at + 6]);
    out.push_back(static_cast<int>(std::lround((luma - 16) * 255 / 219. / 10)));
  }
  return out;
}

TEST(Y4mOutput, IsReadByOtherProgramsWithTheRightSizeCountAndColours) {
  const test::TempFolder folder;
  const std::string file = (folder.path() / "out.y4m").string();
  constexpr int kWidth = 320, kHeight = 180;
  {
    auto output = FrameOutput::to_y4m(file, 30);
    ASSERT_TRUE(output) << output.error().detail;
    for (int i = 0; i < 5; ++i) {
      (*output)->show(std::make_shared<const FramePixels>(test::moving_bars(kWidth, kHeight, i)),
                      at_s(i / 30.));
      ASSERT_TRUE(comes_true([&] { return (*output)->counts().shown == std::uint64_t(i) + 1; }));
    }
  }
  const std::string text = (folder.path() / "probe").string();
  const std::string probe =
      "ffprobe -v error -count_frames -select_streams v -of default=nw=1:nk=1 -show_entries "
      "stream=width,height,pix_fmt,color_range,chroma_location,r_frame_rate,nb_read_frames " +
      file + " > " + text;
  ASSERT_EQ(std::system(probe.c_str()), 0);
  EXPECT_EQ(contents(text), "320\n180\nyuv420p\ntv\nleft\n30/1\n5\n");
  const std::string raw = (folder.path() / "raw").string();
  const std::string decode =
      "ffmpeg -v error -i " + file +
      " -vf scale=in_color_matrix=bt709:flags=accurate_rnd+full_chroma_int -f rawvideo "
      "-pix_fmt rgb24 " +
      raw;
  ASSERT_EQ(std::system(decode.c_str()), 0);
  const std::string pixels = contents(raw);
  ASSERT_EQ(pixels.size(), std::size_t{5} * kWidth * kHeight * 3);
  for (std::size_t bar = 0; bar < 8; ++bar) {
    const std::size_t at = ((2 * bar + 1) * kWidth / 16 + std::size_t{60} * kWidth) * 3;
    const Rgb8 seen{static_cast<std::uint8_t>(pixels[at]),
                    static_cast<std::uint8_t>(pixels[at + 1]),
                    static_cast<std::uint8_t>(pixels[at + 2])};
    EXPECT_NEAR(seen.r, test::kBarColours[bar].r, 2) << bar;
    EXPECT_NEAR(seen.g, test::kBarColours[bar].g, 2) << bar;
    EXPECT_NEAR(seen.b, test::kBarColours[bar].b, 2) << bar;
  }
}

TEST(Y4mOutput, FramesStandWhereTheirTimesPutThem) {
  const test::TempFolder folder;
  const auto file = folder.path() / "out.y4m";
  {
    auto output = FrameOutput::to_y4m(file.string(), 10);
    ASSERT_TRUE(output);
    show_all(**output, {0, .1, .21, .5, .58});  // two are missing before .5, and times tremble
  }
  EXPECT_EQ(numbers_in(file), (std::vector<int>{1, 2, 3, 3, 3, 4, 5}));
}

TEST(Y4mOutput, ASourceFasterThanTheRateIsThinnedOut) {
  const test::TempFolder folder;
  const auto file = folder.path() / "out.y4m";
  {
    auto output = FrameOutput::to_y4m(file.string(), 10);
    ASSERT_TRUE(output);
    for (int i = 0; i <= 20; ++i) {
      (*output)->show(grey_frame(10 * (i + 1)), at_s(i * .05));
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    ASSERT_TRUE(comes_true([&] { return numbers_in(file).size() == 11; }))
        << numbers_in(file).size();
  }
  const std::vector<int> numbers = numbers_in(file);
  ASSERT_EQ(numbers.size(), 11u) << "a second at ten a second, and the first";
  EXPECT_TRUE(std::ranges::is_sorted(numbers));
}

TEST(Y4mOutput, LongGapsAndTimesThatGoBackAreNotFilled) {
  const test::TempFolder folder;
  const auto file = folder.path() / "out.y4m";
  {
    auto output = FrameOutput::to_y4m(file.string(), 10);
    ASSERT_TRUE(output);
    show_all(**output, {0, .1, 100, 100.2, 3, 3.1});
  }
  EXPECT_EQ(numbers_in(file), (std::vector<int>{1, 2, 3, 3, 4, 5, 6}));
}

TEST(Y4mOutput, TheRateIsAFractionAndARateThatIsNoneIsRefused) {
  const test::TempFolder folder;
  const auto file = folder.path() / "out.y4m";
  for (const auto& [rate_hz, text] :
       {std::pair(29.97, "F2997:100 "), {0., "F30:1 "}, {12.5, "F25:2 "}}) {
    {
      auto output = FrameOutput::to_y4m(file.string(), rate_hz);
      ASSERT_TRUE(output);
      show_all(**output, {0});
    }
    EXPECT_NE(contents(file).find(text), std::string::npos) << contents(file).substr(0, 60);
  }
  for (const double rate_hz : {-1., .01, 5000., std::nan("")}) {
    const auto refused = FrameOutput::to_y4m(file.string(), rate_hz);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalid);
  }
  const auto nowhere = FrameOutput::to_y4m((folder.path() / "none" / "x").string(), 30);
  ASSERT_FALSE(nowhere);
  EXPECT_EQ(nowhere.error().detail, "cannot be opened: No such file or directory");
}

std::string fifo_in(const test::TempFolder& folder) {
  const std::string path = (folder.path() / "fifo").string();
  EXPECT_EQ(::mkfifo(path.c_str(), 0600), 0);
  return path;
}

capture::UniqueFd reader_of(const std::string& path) {
  return capture::UniqueFd(::open(path.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC));
}

TEST(Y4mOutput, AFifoWaitsForItsNextReader) {
  const Told told;
  const test::TempFolder folder;
  const std::string fifo = fifo_in(folder);
  auto reader = reader_of(fifo);
  auto output = FrameOutput::to_y4m(fifo, 30);
  ASSERT_TRUE(output);
  show_all(**output, {0, .1});
  EXPECT_FALSE((*output)->ended());
  reader = capture::UniqueFd();
  const auto show_until = [&](const auto& done) {
    for (int i = 0; i < 200; ++i) {
      if (done()) return true;
      (*output)->show(grey_frame(100), at_s(1 + i / 30.));
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
    return false;
  };
  const std::string waits = "waits for a reader of the pipe";
  EXPECT_TRUE(show_until([&] { return (*output)->trouble() == waits; }));
  EXPECT_FALSE((*output)->ended());
  const auto lines = told.lines();
  ASSERT_GE(lines.size(), 1u);
  EXPECT_EQ(lines[0], fifo + ": its reader has gone: it waits for another one");
  // The next one gets a film of its own.
  reader = reader_of(fifo);
  std::string begin(10, '\0');
  EXPECT_TRUE(show_until([&] { return ::read(reader.get(), begin.data(), begin.size()) == 10; }));
  EXPECT_EQ(begin, "YUV4MPEG2 ");
}

// The time that showing so many frames takes.
Seconds show_many(FrameOutput& output, int count) {
  const auto frame = grey_frame(50, 640, 360);
  const auto begun = Clock::now();
  for (int i = 0; i < count; ++i) output.show(frame, at_s(i / 30.));
  return Clock::now() - begun;
}

TEST(Y4mOutput, ShowingNeverWaitsForAPipeThatNobodyReads) {
  const test::TempFolder folder;
  const std::string fifo = fifo_in(folder);
  constexpr int kFrames = 300;
  {
    auto unopened = FrameOutput::to_y4m(fifo, 30);
    ASSERT_TRUE(unopened);
    EXPECT_LT(show_many(**unopened, kFrames).count(), .5);
    EXPECT_TRUE(comes_true([&] { return !(*unopened)->trouble().empty(); }));
    EXPECT_EQ((*unopened)->trouble(), "waits for a reader of the pipe");
    EXPECT_FALSE((*unopened)->ended());
  }
  const auto reader = reader_of(fifo);  // opens and never reads
  auto stuck = FrameOutput::to_y4m(fifo, 30);
  ASSERT_TRUE(stuck);
  (*stuck)->show(grey_frame(50, 640, 360), at_s(0));
  std::this_thread::sleep_for(std::chrono::milliseconds(200));  // the pipe is full
  EXPECT_LT(show_many(**stuck, kFrames).count(), .5);
  EXPECT_EQ((*stuck)->counts().shown, 0u);
  EXPECT_EQ((*stuck)->counts().overtaken, std::uint64_t{kFrames} - 1);
  const auto begun = Clock::now();
  stuck->reset();
  EXPECT_LT(Seconds(Clock::now() - begun).count(), 5)
      << "a stuck consumer keeps nobody from ending";
}

TEST(Y4mOutput, AReaderMayComeLater) {
  const Told told;
  const test::TempFolder folder;
  const std::string fifo = fifo_in(folder);
  auto output = FrameOutput::to_y4m(fifo, 30);
  ASSERT_TRUE(output);
  ASSERT_TRUE(comes_true([&] { return told.lines().size() == 1; }));
  const auto reader = reader_of(fifo);
  ASSERT_TRUE(comes_true([&] { return (*output)->trouble().empty(); }));
  show_all(**output, {0});
  char head[10] = {};
  ASSERT_EQ(::read(reader.get(), head, 9), 9);
  EXPECT_STREQ(head, "YUV4MPEG2");
  EXPECT_EQ(told.lines(), (std::vector<std::string>{fifo + ": waits for a reader of the pipe",
                                                    fifo + ": goes on"}));
}

TEST(Y4mOutput, StandardOutputStaysAsItIsForOthers) {
  int ends[2];
  ASSERT_EQ(::pipe2(ends, O_CLOEXEC), 0);
  const capture::UniqueFd from(ends[0]);
  capture::UniqueFd to(ends[1]);
  std::fflush(stdout);
  const capture::UniqueFd kept(::fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, 0));
  ASSERT_EQ(::dup2(to.get(), STDOUT_FILENO), STDOUT_FILENO);
  auto output = FrameOutput::to_y4m("-", 30);
  ::dup2(kept.get(), STDOUT_FILENO);
  ASSERT_TRUE(output);
  EXPECT_EQ((*output)->name(), "standard output");
  std::string got;
  std::jthread reader([&] {
    char some[70'000];
    for (ssize_t n; (n = ::read(from.get(), some, sizeof some)) > 0;)
      got.append(some, static_cast<std::size_t>(n));
  });
  (*output)->show(grey_frame(255, 640, 360), at_s(0));
  EXPECT_TRUE(comes_true([&] { return (*output)->counts().shown == 1; }));
  EXPECT_EQ(::fcntl(to.get(), F_GETFL) & O_NONBLOCK, 0);
  output->reset();
  to = capture::UniqueFd();
  reader.join();
  const std::size_t head = got.find('\n') + 1;
  EXPECT_EQ(got.substr(0, head),
            "YUV4MPEG2 W640 H360 F30:1 Ip A1:1 C420mpeg2 XCOLORRANGE=LIMITED\n");
  ASSERT_EQ(got.size(), head + 6 + yuv420_bytes(640, 360));
  EXPECT_EQ(static_cast<std::uint8_t>(got[head + 6]), 235);
}

TEST(V4l2Output, WhatIsNoVideoOutputIsRefusedWithItsReason) {
  const test::TempFolder folder;
  const std::string file = (folder.path() / "file").string();
  std::ofstream(file) << "no device";
  for (const std::string& device : {file, std::string("/dev/null")}) {
    const auto refused = FrameOutput::to_v4l2(device);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kUnavailable);
    EXPECT_EQ(refused.error().where, device);
    EXPECT_EQ(refused.error().detail, "is not a video device: Inappropriate ioctl for device");
  }
  const auto missing = FrameOutput::to_v4l2("/dev/video4711");
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().code, ErrorCode::kNotFound);
  EXPECT_EQ(missing.error().detail, "cannot be opened: No such file or directory");
}

TEST(PipeWireOutput, WithoutAServerItSaysSoOnceAndGoesOn) {
  const Told told;
  const test::TempFolder folder;
  ::setenv("PIPEWIRE_RUNTIME_DIR", folder.path().c_str(), 1);
  auto output = FrameOutput::to_pipewire({"camera", "A camera", 30});
  ASSERT_TRUE(output) << output.error().detail;
  const std::string reason = "cannot be reached: is PipeWire running?";
  EXPECT_TRUE(comes_true([&] { return (*output)->trouble() == reason; }));
  show_many(**output, 10);
  std::this_thread::sleep_for(std::chrono::milliseconds(2500));  // a second try
  EXPECT_FALSE((*output)->ended());
  EXPECT_EQ((*output)->counts().shown, 0u);
  EXPECT_EQ(told.lines(), std::vector{"PipeWire node camera: " + reason});
  ::unsetenv("PIPEWIRE_RUNTIME_DIR");
}

TEST(PipeWireOutput, ANameThatIsNoneIsRefused) {
  for (const char* name : {"", "two words", "quote\"", "new\nline"}) {
    const auto refused = FrameOutput::to_pipewire({name, "A camera", 30});
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalid);
  }
}

}  // namespace
}  // namespace penumbra::service
