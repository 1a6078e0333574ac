// The service's V4L2 output against the driver that users have, v4l2loopback, with FFmpeg as its
// reader. In the guest of guest.sh; elsewhere skipped.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <iterator>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "capture/unique_fd.h"
#include "service/outputs/colour_conversion.h"
#include "service/outputs/frame_output.h"
#include "tests/support/moving_bars.h"
#include "tests/support/temp_folder.h"

namespace penumbra::service {
namespace {

constexpr const char* kLoopbackDevice = "/dev/video9";  // with exclusive_caps, as browsers need it
constexpr int kWidth = 320, kHeight = 180;

class OutputDevice : public testing::Test {
 protected:
  void SetUp() override {
    if (!std::getenv("PENUMBRA_GUEST")) GTEST_SKIP() << "runs in the guest of tests/vm alone";
  }
};

// Shows pictures until that is true; false after two minutes.
bool show_until(FrameOutput& output, int width, int height, const std::function<bool()>& is_done) {
  constexpr std::chrono::minutes kLimit(2);
  const auto until = std::chrono::steady_clock::now() + kLimit;
  for (int i = 0; !is_done() && std::chrono::steady_clock::now() < until; ++i) {
    output.show(std::make_shared<const FramePixels>(test::moving_bars(width, height, i % 16)),
                TimestampNs{std::int64_t{i} * 33'000'000});
    std::this_thread::sleep_for(std::chrono::milliseconds(30));
  }
  return is_done();
}

// What the device holds from now on, whoever writes; 0: what its writer asks for.
void keep_format(std::uint32_t fourcc) {
  capture::UniqueFd file;
  const auto set = [&](int value) {
    v4l2_queryctrl query{};
    for (query.id = V4L2_CTRL_FLAG_NEXT_CTRL; ::ioctl(file.get(), VIDIOC_QUERYCTRL, &query) == 0;
         query.id |= V4L2_CTRL_FLAG_NEXT_CTRL)
      if (std::string(reinterpret_cast<const char*>(query.name)) == "keep_format") break;
    v4l2_control control{query.id, value};
    return ::ioctl(file.get(), VIDIOC_S_CTRL, &control);
  };
  const auto open = [&] {
    file = capture::UniqueFd(::open(kLoopbackDevice, O_RDWR | O_CLOEXEC));
    return static_cast<bool>(file);
  };
  ASSERT_TRUE(open());
  ASSERT_EQ(set(0), 0);
  file = capture::UniqueFd();  // the last who closes lets the old format go
  if (fourcc == 0) return;
  ASSERT_TRUE(open());
  v4l2_format format{};
  format.type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
  format.fmt.pix.width = kWidth, format.fmt.pix.height = kHeight;
  format.fmt.pix.pixelformat = fourcc;
  format.fmt.pix.field = V4L2_FIELD_NONE;
  ASSERT_EQ(::ioctl(file.get(), VIDIOC_S_FMT, &format), 0);
  ASSERT_EQ(format.fmt.pix.pixelformat, fourcc);
  int kind = V4L2_BUF_TYPE_VIDEO_OUTPUT;
  ASSERT_EQ(::ioctl(file.get(), VIDIOC_STREAMON, &kind), 0);
  ASSERT_EQ(set(1), 0);
}

using Bytes = std::vector<std::uint8_t>;

// Shows pictures while FFmpeg reads six frames as they are.
Bytes read_by_ffmpeg(FrameOutput& output, const std::string& device) {
  const test::TempFolder folder;
  const std::string raw = (folder.path() / "raw").string();
  const std::string command =
      "ffmpeg -v error -f v4l2 -i " + device + " -frames:v 6 -f rawvideo -c copy " + raw;
  std::atomic<int> status = -1;
  std::jthread consumer([&] { status = std::system(command.c_str()); });
  EXPECT_TRUE(show_until(output, kWidth, kHeight, [&] { return status >= 0; }));
  consumer.join();
  EXPECT_EQ(status, 0);
  std::ifstream file(raw, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

Bytes in_format(std::uint32_t fourcc, const Image<Rgb8>& picture) {
  Bytes out;
  if (fourcc == V4L2_PIX_FMT_YUYV) {
    out.resize(picture.area() * 2);
    to_yuyv(picture, out.data(), std::size_t{kWidth} * 2);
  } else if (fourcc == V4L2_PIX_FMT_BGR32) {
    out.resize(picture.area() * 4);
    to_bgrx(picture, out.data(), std::size_t{kWidth} * 4);
  } else if (fourcc == V4L2_PIX_FMT_YUV420) {
    out.resize(yuv420_bytes(kWidth, kHeight));
    to_yuv420(picture, out);
  } else {
    for (const Rgb8& p : picture.pixels()) out.insert(out.end(), {p.r, p.g, p.b});
  }
  return out;
}

// Six frames, each of which is one of the pictures byte for byte.
void check_handing_on(const char* device, std::uint32_t fourcc) {
  auto output = FrameOutput::to_v4l2(device);
  ASSERT_TRUE(output) << output.error().detail;
  const auto is_shown = [&] { return (*output)->counts().shown > 2 || (*output)->ended(); };
  ASSERT_TRUE(show_until(**output, kWidth, kHeight, is_shown));
  ASSERT_FALSE((*output)->ended()) << (*output)->trouble();
  const Bytes bytes = read_by_ffmpeg(**output, device);
  std::vector<Bytes> pictures;
  for (int i = 0; i < 16; ++i)
    pictures.push_back(in_format(fourcc, test::moving_bars(kWidth, kHeight, i)));
  const std::size_t frame = pictures[0].size();
  ASSERT_EQ(bytes.size(), 6 * frame);
  for (std::size_t i = 0; i < 6; ++i) {
    const auto begin = bytes.begin() + static_cast<std::ptrdiff_t>(i * frame);
    const Bytes one(begin, begin + static_cast<std::ptrdiff_t>(frame));
    EXPECT_TRUE(std::ranges::find(pictures, one) != pictures.end()) << "frame " << i;
  }
}

TEST_F(OutputDevice, ALoopbackDeviceHandsEveryByteToAnotherProgram) {
  check_handing_on(kLoopbackDevice, V4L2_PIX_FMT_YUYV);
}

TEST_F(OutputDevice, AFormatThatTheDeviceIsHeldToIsTaken) {
  for (const std::uint32_t fourcc : {V4L2_PIX_FMT_RGB24, V4L2_PIX_FMT_BGR32, V4L2_PIX_FMT_YUV420}) {
    SCOPED_TRACE(fourcc);
    keep_format(fourcc);
    check_handing_on(kLoopbackDevice, fourcc);
  }
  keep_format(0);
}

TEST_F(OutputDevice, ASecondWriterIsRefused) {
  auto first = FrameOutput::to_v4l2(kLoopbackDevice);
  ASSERT_TRUE(first) << first.error().detail;
  const auto is_shown = [&] { return (*first)->counts().shown > 2; };
  ASSERT_TRUE(show_until(**first, kWidth, kHeight, is_shown));
  const auto second = FrameOutput::to_v4l2(kLoopbackDevice);
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().detail,
            "takes no pictures: it is not a video output, or another program writes to it");
  first->reset();
  EXPECT_TRUE(FrameOutput::to_v4l2(kLoopbackDevice)) << "free again";
}

TEST_F(OutputDevice, ASizeThatTheDeviceDoesNotTakeEndsTheOutputWithItsReason) {
  keep_format(V4L2_PIX_FMT_YUYV);
  auto output = FrameOutput::to_v4l2(kLoopbackDevice);
  ASSERT_TRUE(output) << output.error().detail;
  ASSERT_TRUE(show_until(**output, 2 * kWidth, 2 * kHeight, [&] { return (*output)->ended(); }));
  EXPECT_EQ((*output)->trouble(), "takes no pictures of 640x360 as YUYV, RGB24, BGR32 or YU12");
  output->reset();
  keep_format(0);
}

TEST_F(OutputDevice, ACameraTakesNoPictures) {
  const std::string camera = "/dev/video0";  // vivid's
  const auto refused = FrameOutput::to_v4l2(camera);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kInvalid);
  EXPECT_EQ(refused.error().where, camera);
  EXPECT_TRUE(refused.error().detail.starts_with("takes no pictures: it is not a video output"));
}

}  // namespace
}  // namespace penumbra::service
