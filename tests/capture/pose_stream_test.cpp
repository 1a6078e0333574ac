#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <chrono>
#include <cstring>
#include <fstream>
#include <thread>

#include "capture/poses/pose_line.h"
#include "capture/poses/pose_stream.h"
#include "capture/poses/pose_track.h"
#include "core/io/log.h"
#include "tests/fuzz/mutate.h"
#include "tests/support/temp_folder.h"

namespace penumbra::capture {
namespace {

using testing::HasSubstr;

TEST(PoseLine, SaysTimePositionAndQuaternion) {
  const auto p = parse_pose_line("123456789 0.5 1 -2e-1 0 0.6 0 0.8\n");
  ASSERT_TRUE(p) << p.error().detail;
  EXPECT_EQ(p->time.value, 123456789);
  EXPECT_EQ(p->world_from_body.translation, glm::dvec3(.5, 1, -.2));
  EXPECT_NEAR(p->world_from_body.rotation.w, .8, 1e-12);
  EXPECT_NEAR(p->world_from_body.rotation.y, .6, 1e-12);
  EXPECT_EQ(p->sigma_m, kUsualPoseSigma_m);
  const auto sure = parse_pose_line("1 0 0 0 0 0 0 1 0.004 0.01");
  ASSERT_TRUE(sure);
  EXPECT_EQ(sure->sigma_m, .004);
  EXPECT_EQ(sure->sigma_rad, .01);
}

TEST(PoseLine, RefusesEverythingElse) {
  const auto why = [](std::string_view line) { return parse_pose_line(line).error().detail; };
  EXPECT_THAT(why(""), HasSubstr("time"));
  EXPECT_THAT(why("1.5 0 0 0 0 0 0 1"), HasSubstr("time"));
  EXPECT_THAT(why("9223372036854775807 0 0 0 0 0 0 1"), HasSubstr("clock"));
  EXPECT_THAT(why("99223372036854775807 0 0 0 0 0 0 1"), HasSubstr("time"));
  EXPECT_THAT(why("1 0 0 0 0 0 0"), HasSubstr("eight or ten"));
  EXPECT_THAT(why("1 0 0 0 0 0 0 1 0.1"), HasSubstr("eight or ten"));
  EXPECT_THAT(why("1 0 0 0 0 0 0 1 .1 .1 .1"), HasSubstr("eight or ten"));
  EXPECT_THAT(why("1 0 0 x 0 0 0 1"), HasSubstr("eight or ten"));
  EXPECT_THAT(why("1 0 0 nan 0 0 0 1"), HasSubstr("finite"));
  EXPECT_THAT(why("1 0 0 inf 0 0 0 1"), HasSubstr("finite"));
  EXPECT_THAT(why("1 0 0 1e9 0 0 0 1"), HasSubstr("kilometres"));
  EXPECT_THAT(why("1 0 0 0 0 0 0 2"), HasSubstr("unit length"));
  EXPECT_THAT(why("1 0 0 0 0 0 0 0"), HasSubstr("unit length"));
  EXPECT_THAT(why("1 0 0 0 0 0 0 1 0 0.1"), HasSubstr("standard deviation"));
  EXPECT_THAT(why("1 0 0 0 0 0 0 1 0.1 11"), HasSubstr("standard deviation"));
  EXPECT_THAT(why(std::string(600, ' ')), HasSubstr("512"));
}

TEST(PoseLine, SurvivesDamage) {
  const std::string good = "1234567890123 0.5 1.25 -2e-1 0 0.6 0 0.8 0.001 0.002\n";
  int read = 0;
  test::mutate_and_run(
      {reinterpret_cast<const unsigned char*>(good.data()), good.size()}, 5000, 1,
      [&](std::span<const unsigned char> bytes) {
        const auto p = parse_pose_line({reinterpret_cast<const char*>(bytes.data()), bytes.size()});
        if (!p) return;
        ++read;
        EXPECT_NEAR(glm::length(p->world_from_body.rotation), 1, 1e-9);
      });
  EXPECT_GT(read, 100);
}

// ---- The socket. ----

class Sender {
 public:
  explicit Sender(int port) : socket_(::socket(AF_INET, SOCK_DGRAM, 0)) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(port));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(::connect(socket_, reinterpret_cast<const sockaddr*>(&to), sizeof to), 0);
  }
  explicit Sender(const std::filesystem::path& path) : socket_(::socket(AF_UNIX, SOCK_DGRAM, 0)) {
    sockaddr_un to{};
    to.sun_family = AF_UNIX;
    std::strncpy(to.sun_path, path.c_str(), sizeof to.sun_path - 1);
    EXPECT_EQ(::connect(socket_, reinterpret_cast<const sockaddr*>(&to), sizeof to), 0);
  }
  ~Sender() { ::close(socket_); }
  void send(std::string_view line) const {
    ASSERT_EQ(::send(socket_, line.data(), line.size(), 0), std::ssize(line));
  }

 private:
  int socket_;
};

template <class Condition>
bool soon(const Condition& condition) {
  for (int i = 0; i < 500; ++i) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(4));
  }
  return false;
}

Frame frame_at(std::int64_t ns) {
  Frame out;
  out.time.value = ns;
  return out;
}

void expect_stream_works(PoseStream& stream, const Sender& sender) {
  EXPECT_FALSE(stream.pose_of(frame_at(5'000'000'000)));
  EXPECT_THAT(stream.state().trouble, HasSubstr("no pose has arrived"));
  for (int i = 0; i < 50; ++i)
    sender.send(std::to_string(5'000'000'000 + i * 10'000'000LL) + " " + std::to_string(.01 * i) +
                " 0 0 0 0 0 1");
  ASSERT_TRUE(soon([&] { return stream.state().taken == 50; }));
  const auto pose = stream.pose_of(frame_at(5'245'000'000));
  ASSERT_TRUE(pose);
  EXPECT_NEAR(pose->pose.translation.x, .245, 1e-6);
  EXPECT_NEAR(stream.state().age->count(), 0, 1e-9);
  EXPECT_EQ(stream.state().trouble, "");
  const auto ahead = stream.pose_of(frame_at(5'510'000'000));
  ASSERT_TRUE(ahead);
  EXPECT_NEAR(ahead->pose.translation.x, .51, 1e-6);
  EXPECT_NEAR(stream.state().age->count(), .02, 1e-9);
  EXPECT_FALSE(stream.pose_of(frame_at(5'700'000'000)));
  EXPECT_THAT(stream.state().trouble, HasSubstr("on this clock"));
}

TEST(PoseStream, TakesDatagramsOfUdp) {
  auto stream = PoseStream::open({.socket = {}, .port = 0});
  ASSERT_TRUE(stream) << stream.error().detail;
  expect_stream_works(**stream, Sender((*stream)->port()));
}

TEST(PoseStream, TakesDatagramsOfASocketAndLeavesNoFile) {
  const test::TempFolder folder;
  const auto path = folder.path() / "poses.sock";
  {
    auto stream = PoseStream::open({.socket = path, .port = {}});
    ASSERT_TRUE(stream) << stream.error().detail;
    expect_stream_works(**stream, Sender(path));
    // A second one would take its datagrams.
    const auto second = PoseStream::open({.socket = path, .port = {}});
    ASSERT_FALSE(second);
    EXPECT_THAT(second.error().detail, HasSubstr("another program's"));
  }
  EXPECT_TRUE(folder.empty());
}

TEST(PoseStream, TakesOverASocketThatSomebodyLeft) {
  const test::TempFolder folder;
  const auto path = folder.path() / "poses.sock";
  const int left = ::socket(AF_UNIX, SOCK_DGRAM, 0);
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  std::strncpy(name.sun_path, path.c_str(), sizeof name.sun_path - 1);
  ASSERT_EQ(::bind(left, reinterpret_cast<const sockaddr*>(&name), sizeof name), 0);
  ::close(left);
  ASSERT_TRUE(std::filesystem::exists(path));
  EXPECT_TRUE(PoseStream::open({.socket = path, .port = {}}));
}

TEST(PoseStream, AddsItsOffsetToTheSendersClock) {
  auto stream = PoseStream::open({.socket = {}, .port = 0, .clock_offset = Seconds(-100)});
  ASSERT_TRUE(stream);
  const Sender sender((*stream)->port());
  sender.send("105000000000 1 0 0 0 0 0 1");
  ASSERT_TRUE(soon([&] { return (*stream)->state().taken == 1; }));
  EXPECT_TRUE((*stream)->pose_of(frame_at(5'000'000'000)));
}

TEST(PoseStream, CanTakeTheTimeOfArrival) {
  auto stream = PoseStream::open({.socket = {}, .port = 0, .by_arrival = true});
  ASSERT_TRUE(stream);
  const Sender sender((*stream)->port());
  const auto now = [] {
    return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count();
  };
  const auto before = now();
  sender.send("7 1 0 0 0 0 0 1");
  ASSERT_TRUE(soon([&] { return (*stream)->state().taken == 1; }));
  EXPECT_FALSE((*stream)->pose_of(frame_at(before - 1)));
  EXPECT_FALSE((*stream)->pose_of(frame_at(7)));
  (void)(*stream)->pose_of(frame_at(now()));
  EXPECT_LT((*stream)->state().age->count(), 3);
}

TEST(PoseStream, CountsWhatIsNoPoseAndSaysItOnce) {
  std::vector<std::string> lines;
  set_log_sink([&](LogLevel, std::string_view line) { lines.emplace_back(line); });
  {
    auto stream = PoseStream::open({.socket = {}, .port = 0});
    ASSERT_TRUE(stream);
    const Sender sender((*stream)->port());
    sender.send("hello");
    sender.send(std::string(2000, '7'));
    sender.send("1 0 0 0 0 0 0 5");
    sender.send(std::string_view("\0\xff\xfe", 3));
    for (int i = 0; i < 20; ++i) sender.send("1 0 0 nan 0 0 0 1");
    sender.send("5000000000 0 0 0 0 0 0 1");
    ASSERT_TRUE(soon([&] { return (*stream)->state().taken == 1; }));
    EXPECT_EQ((*stream)->state().refused, 24u);
  }
  set_log_sink({});
  ASSERT_EQ(lines.size(), 1u);
  EXPECT_THAT(lines[0], HasSubstr("such datagrams are left out and counted"));
}

TEST(PoseStream, EndsWhileNobodySends) {
  for (int i = 0; i < 20; ++i) {
    auto stream = PoseStream::open({.socket = {}, .port = 0});
    ASSERT_TRUE(stream);
  }
}

TEST(PoseStream, RefusesAddressesThatAreNone) {
  const auto why = [](const PoseStreamOptions& o) {
    const auto stream = PoseStream::open(o);
    return stream ? std::string() : stream.error().detail;
  };
  EXPECT_THAT(why({}), HasSubstr("either a socket or a port"));
  EXPECT_THAT(why({.socket = "x", .port = 4}), HasSubstr("either a socket or a port"));
  EXPECT_THAT(why({.socket = {}, .port = 70000}), HasSubstr("0..65535"));
  EXPECT_THAT(why({.socket = std::string(200, 'x'), .port = {}}), HasSubstr("longer than"));
  EXPECT_THAT(why({.socket = {}, .port = 0, .clock_offset = Seconds(NAN)}), HasSubstr("billion"));
  EXPECT_NE(why({.socket = "/nowhere/at/all", .port = {}}), "");
  auto first = PoseStream::open({.socket = {}, .port = 0});
  ASSERT_TRUE(first);
  EXPECT_NE(why({.socket = {}, .port = (*first)->port()}), "");  // taken
}

// ---- The track. ----

class PoseTrackFile : public testing::Test {
 protected:
  std::filesystem::path write(const std::string& text) const {
    const auto path = folder_.path() / "track.csv";
    std::ofstream(path) << text;
    return path;
  }
  std::string why(const std::string& text) const {
    const auto track = read_pose_track(write(text));
    return track ? "" : track.error().where + ": " + track.error().detail;
  }
  test::TempFolder folder_;
};

TEST_F(PoseTrackFile, IsReadInNanosecondsAndInSeconds) {
  const auto ns =
      read_pose_track(write("time_ns,tx,ty,tz,qx,qy,qz,qw\r\n"
                            "1700000000123456789,1,2,3,0,0,0,1\r\n"
                            "1700000000133456789,1,2,3,0,0.6,0,0.8\r\n"));
  ASSERT_TRUE(ns) << ns.error().detail;
  EXPECT_EQ((*ns)[0].time.value, 1700000000123456789);
  EXPECT_EQ((*ns)[1].world_from_body.rotation.y, .6);
  const auto s = read_pose_track(write("time_s,tx,ty,tz,qx,qy,qz,qw\n1.5,1,2,3,0,0,0,1\n"));
  ASSERT_TRUE(s);
  EXPECT_EQ((*s)[0].time.value, 1'500'000'000);
}

TEST_F(PoseTrackFile, IsRefusedWithItsLine) {
  const std::string header = "time_ns,tx,ty,tz,qx,qy,qz,qw\n";
  EXPECT_THAT(why("time,x\n"), HasSubstr("track.csv:1: is neither the header"));
  EXPECT_THAT(why(header), HasSubstr("no pose"));
  EXPECT_THAT(why(header + "1,0,0,0,0,0,0\n"), HasSubstr("track.csv:2: does not have eight"));
  EXPECT_THAT(why(header + "1.5,0,0,0,0,0,0,1\n"), HasSubstr("eight numbers"));
  EXPECT_THAT(why(header + "1,0,0,nan,0,0,0,1\n"), HasSubstr("eight numbers"));
  EXPECT_THAT(why(header + "1,0,0,0,0,0,0,2\n"), HasSubstr("unit length"));
  EXPECT_THAT(why(header + "1,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1\n"), HasSubstr("track.csv:3: is not"));
}

TEST_F(PoseTrackFile, GivesTheBodysPoseWithItsOffset) {
  std::string text = "time_ns,tx,ty,tz,qx,qy,qz,qw\n";
  for (int i = 0; i < 100; ++i)
    text += std::to_string(i * 10'000'000LL) + "," + std::to_string(.01 * i) + ",0,0,0,0,0,1\n";
  auto track = PoseTrack::open(write(text), Seconds(2));
  ASSERT_TRUE(track) << track.error().detail;
  EXPECT_EQ((*track)->state().taken, 100u);
  EXPECT_FALSE((*track)->pose_of(frame_at(1'900'000'000)));
  EXPECT_NE((*track)->state().trouble, "");
  const auto pose = (*track)->pose_of(frame_at(2'505'000'000));
  ASSERT_TRUE(pose);
  EXPECT_NEAR(pose->pose.translation.x, .505, 1e-6);
  EXPECT_EQ((*track)->state().trouble, "");
  EXPECT_TRUE((*track)->pose_of(frame_at(3'020'000'000)));
  EXPECT_FALSE((*track)->pose_of(frame_at(3'030'000'000)));
}

}  // namespace
}  // namespace penumbra::capture
