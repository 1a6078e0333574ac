
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <malloc.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <random>

#include "calib/calib.h"
#include "capture/capture.h"
#include "capture/recording/undamaged_frames.h"
#include "codec/codec.h"
#include "tests/support/temp_folder.h"

namespace penumbra::capture {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

constexpr int kRecordedWidth = 48, kRecordedHeight = 32;

CameraInfo camera(const std::string& name, Role role) {
  CameraInfo out;
  out.name = name;
  out.role = role;
  out.projection = *calib::make_projection(
      role == Role::kView ? calib::ProjectionKind::kPinhole : calib::ProjectionKind::kEquidistant,
      kRecordedWidth, kRecordedHeight);
  out.response = calib::Response::srgb();
  out.noise = {12000, 3e-4};
  out.noise_known = true;
  out.black_level = .0625;
  out.world_from_camera.translation = {.1, 1.5, -.25};
  return out;
}

template <class Pixel>
FramePixels noise(std::uint32_t seed, int width = kRecordedWidth, int height = kRecordedHeight) {
  std::mt19937 random(seed);
  Image<Pixel> out(width, height);
  for (Pixel& p : out.pixels()) {
    using Sample = decltype(p.r);
    p = {static_cast<Sample>(random()), static_cast<Sample>(random()),
         static_cast<Sample>(random())};
  }
  return out;
}

std::shared_ptr<const std::vector<std::byte>> jpeg_of(std::uint32_t seed) {
  const auto bytes = *codec::encode_jpeg(std::get<Image<Rgb8>>(noise<Rgb8>(seed)), 90);
  const auto* data = reinterpret_cast<const std::byte*>(bytes.data());
  return std::make_shared<const std::vector<std::byte>>(data, data + bytes.size());
}

Frame frame(int camera, std::uint64_t sequence, double time_s, FramePixels pixels) {
  Frame out{camera,
            sequence,
            TimestampNs{1'700'000'000'123'456'789} + Seconds(time_s),
            {Seconds(.01 / static_cast<double>(1 + sequence % 3)), Gain(1.5)},
            {},
            std::make_shared<const FramePixels>(std::move(pixels))};
  out.world_from_camera.translation.x = .001 * static_cast<double>(sequence);
  // Some poses are old: a replay that showed all of what is virtual would let it float.
  if (sequence % 4 == 3) out.opacity = sequence % 8 == 3 ? .3f : 0;
  return out;
}

Result<std::vector<Frame>> frames_of(const fs::path& path) {
  PENUMBRA_ASSIGN(source, open_recording(path));
  std::vector<Frame> out;
  for (;;) {
    PENUMBRA_ASSIGN(next, source->next());
    if (!next) return out;
    out.push_back(std::move(*next));
  }
}

void expect_same_label(const Frame& a, const Frame& b) {
  EXPECT_EQ(a.camera, b.camera);
  EXPECT_EQ(a.sequence, b.sequence);
  EXPECT_EQ(a.time, b.time);
  EXPECT_EQ(a.exposure.time, b.exposure.time);
  EXPECT_EQ(a.exposure.gain.value(), b.exposure.gain.value());
  EXPECT_EQ(a.world_from_camera.translation, b.world_from_camera.translation);
  EXPECT_EQ(a.world_from_camera.rotation, b.world_from_camera.rotation);
  EXPECT_EQ(a.opacity, b.opacity);
}

class RecordingTest : public testing::Test {
 protected:
  test::TempFolder folder_;
  fs::path path_ = folder_.path() / "a.mkv";

  // 8 bits of one camera, 16 of the other, in turn.
  std::vector<Frame> write(int count) {
    const std::array codings{Coding::kRgb8, Coding::kRgb16};
    auto writer = RecordingWriter::create(
        path_, {camera("environment", Role::kEnvironment), camera("view", Role::kView)}, codings,
        60);
    EXPECT_TRUE(writer) << writer.error().detail;
    std::vector<Frame> frames;
    for (int i = 0; i < count; ++i) {
      const auto seed = static_cast<std::uint32_t>(i);
      // As from two threads: the other camera's next frame is older.
      frames.push_back(frame(i % 2, static_cast<std::uint64_t>(i / 2),
                             i / 2 / 60. + (i % 2 ? 0 : .025),
                             i % 2 ? noise<Rgb16>(seed) : noise<Rgb8>(seed)));
      const auto written = writer->write(frames.back());
      EXPECT_TRUE(written) << written.error().detail;
    }
    EXPECT_TRUE(writer->finish());
    EXPECT_EQ(writer->bytes() >= fs::file_size(path_), true);
    return frames;
  }
};

TEST_F(RecordingTest, EveryBitOfPicturesAndLabelsComesBack) {
  std::vector<Frame> written = write(40);
  const auto read = frames_of(path_);
  ASSERT_TRUE(read) << read.error().where << ": " << read.error().detail;
  ASSERT_EQ(read->size(), written.size());
  std::ranges::sort(written, {}, &Frame::time);
  for (std::size_t i = 0; i < written.size(); ++i) {
    expect_same_label(written[i], (*read)[i]);
    EXPECT_TRUE(*written[i].pixels == *(*read)[i].pixels) << "pixels of frame " << i;
  }
}

// FFmpeg resumes behind a hole and says nothing: the lost frames would be nobody's.
TEST_F(RecordingTest, AHoleIsToldOnce) {
  const std::size_t written = write(40).size();
  const auto frames = [&](std::uint64_t& holes) {
    auto source = UndamagedFrames::open(path_);
    EXPECT_TRUE(source);
    std::size_t count = 0;
    for (auto f = (*source)->next(); f && *f; f = (*source)->next()) ++count;
    holes = (*source)->left_out();
    return count;
  };
  std::uint64_t holes = 0;
  EXPECT_EQ(frames(holes), written);
  EXPECT_EQ(holes, 0u);
  const auto size = static_cast<std::streamoff>(fs::file_size(path_));
  {
    std::fstream file(path_, std::ios::binary | std::ios::in | std::ios::out);
    file.seekp(size / 2);
    file << std::string(static_cast<std::size_t>(size / 6), '\0');
  }
  EXPECT_LT(frames(holes), written);
  EXPECT_GE(holes, 1u);
  EXPECT_LE(holes, 3u);
}

TEST_F(RecordingTest, CamerasComeBackWithTheirResponseTables) {
  std::vector<CameraInfo> cameras{camera("environment", Role::kEnvironment),
                                  camera("view", Role::kView)};
  std::array<std::vector<float>, 3> table{{{0, .1f, 1}, {0, .2f, 1}, {0, .3f, 1}}};
  cameras[0].response = *calib::Response::from_table(table);
  {
    const std::array codings{Coding::kRgb8, Coding::kRgb8};
    auto writer = RecordingWriter::create(path_, cameras, codings, 59.94);
    ASSERT_TRUE(writer);
    ASSERT_TRUE(writer->write(frame(0, 0, 0, noise<Rgb8>(1))));
  }
  const auto source = open_recording(path_);
  ASSERT_TRUE(source) << source.error().detail;
  EXPECT_EQ((*source)->view_rate(), 59.94);
  ASSERT_EQ((*source)->cameras().size(), 2u);
  for (std::size_t i = 0; i < 2; ++i) {
    const CameraInfo& a = cameras[i];
    const CameraInfo& b = (*source)->cameras()[i];
    EXPECT_EQ(a.name, b.name);
    EXPECT_EQ(a.role, b.role);
    EXPECT_EQ(a.projection.kind, b.projection.kind);
    EXPECT_EQ(a.projection.focal_px, b.projection.focal_px);
    EXPECT_EQ(a.projection.principal_px, b.projection.principal_px);
    EXPECT_EQ(a.black_level, b.black_level);
    EXPECT_EQ(a.noise.full_well_electrons, b.noise.full_well_electrons);
    EXPECT_EQ(a.world_from_camera.translation, b.world_from_camera.translation);
    for (int c = 0; c < 3; ++c)
      EXPECT_NEAR(a.response.decode(.5, c), b.response.decode(.5, c), 1e-7);
  }
}

TEST_F(RecordingTest, JpegIsKeptAsTheCameraCodedIt) {
  const auto jpeg = jpeg_of(3);
  {
    const std::array codings{Coding::kJpeg};
    auto writer = RecordingWriter::create(path_, {camera("view", Role::kView)}, codings, 30);
    ASSERT_TRUE(writer);
    Frame f = frame(0, 7, 0, noise<Rgb8>(1));
    f.jpeg = jpeg;
    ASSERT_TRUE(writer->write(f));
    ASSERT_TRUE(writer->finish());
  }
  const auto read = frames_of(path_);
  ASSERT_TRUE(read) << read.error().detail;
  ASSERT_EQ(read->size(), 1u);
  ASSERT_TRUE((*read)[0].jpeg);
  EXPECT_EQ(*(*read)[0].jpeg, *jpeg);
  const auto& pixels = std::get<Image<Rgb8>>(*(*read)[0].pixels);
  EXPECT_EQ(pixels.width(), kRecordedWidth);
}

// A cut at any byte gives a shorter recording or a plain refusal, never another frame's label.
TEST_F(RecordingTest, CutAnywhereItEndsEarlier) {
  const std::vector<Frame> written = write(12);
  const auto size = fs::file_size(path_);
  std::ifstream file(path_, std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(file)), {});
  const fs::path cut = folder_.path() / "cut.mkv";
  std::size_t largest = 0, refused = 0;
  for (std::uintmax_t end = 0; end < size; end += 701) {
    std::ofstream(cut, std::ios::binary | std::ios::trunc) << bytes.substr(0, end);
    const auto read = frames_of(cut);
    if (!read) {
      ++refused;
      EXPECT_THAT(read.error().where, HasSubstr("cut.mkv"));
      continue;
    }
    EXPECT_GE(read->size(), largest) << "at byte " << end;
    largest = std::max(largest, read->size());
    std::vector<Frame> kept(written.begin(),
                            written.begin() + static_cast<std::ptrdiff_t>(read->size()));
    std::ranges::sort(kept, {}, &Frame::time);
    for (std::size_t i = 0; i < read->size(); ++i) {
      expect_same_label(kept[i], (*read)[i]);
      EXPECT_TRUE(*kept[i].pixels == *(*read)[i].pixels);
    }
  }
  EXPECT_EQ(largest, written.size());
  EXPECT_LT(refused, 20u);  // only a cut within the head, which holds cameras.toml
}

TEST_F(RecordingTest, DamagedBytesNeverMoveALabel) {
  const std::vector<Frame> written = write(12);
  std::ifstream file(path_, std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(file)), {});
  const fs::path bad = folder_.path() / "bad.mkv";
  std::mt19937 random(5);
  for (int trial = 0; trial < 150; ++trial) {
    std::string damaged = bytes;
    for (int i = 0; i < 3; ++i) damaged[random() % damaged.size()] = static_cast<char>(random());
    std::ofstream(bad, std::ios::binary | std::ios::trunc) << damaged;
    const auto source = open_recording(bad);
    if (!source) continue;
    for (int errors = 0; errors < 50;) {
      const auto next = (*source)->next();
      if (!next) ++errors;
      if (!next) continue;
      if (!*next) break;
      // A flipped digit of a label can't be told; a label with another frame's picture can.
      const auto same = std::ranges::find_if(written, [&](const Frame& f) {
        return f.camera == (**next).camera && f.sequence == (**next).sequence &&
               f.time == (**next).time;
      });
      if (same == written.end()) continue;
      const auto other = std::ranges::find_if(written, [&](const Frame& f) {
        return f.time != same->time && *f.pixels == *(**next).pixels;
      });
      EXPECT_EQ(other, written.end()) << "trial " << trial;
    }
  }
}

TEST_F(RecordingTest, AFullDiskEndsItWithTheSystemsReason) {
  constexpr rlim_t kRoom = 200'000;
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto old = std::signal(SIGXFSZ, SIG_IGN);
  const std::array codings{Coding::kRgb8};
  auto writer = RecordingWriter::create(path_, {camera("view", Role::kView)}, codings, 60);
  ASSERT_TRUE(writer);
  const rlimit small{kRoom, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  std::size_t written = 0;
  std::optional<Error> error;
  for (; written < 1000 && !error; ++written) {
    auto r = writer->write(frame(0, written, static_cast<double>(written) / 60,
                                 noise<Rgb8>(static_cast<std::uint32_t>(written))));
    if (!r) error = r.error();
  }
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &before), 0);
  std::signal(SIGXFSZ, old);
  ASSERT_TRUE(error);
  EXPECT_EQ(error->code, ErrorCode::kUnwritable);
  EXPECT_EQ(error->detail, "File too large");
  EXPECT_EQ(error->where, path_.string());
  EXPECT_FALSE(writer->finish());
  const auto read = frames_of(path_);
  ASSERT_TRUE(read) << read.error().detail;
  EXPECT_GE(read->size() + 1, written);
}

TEST_F(RecordingTest, RefusesWhatItCannotKeep) {
  const std::array codings{Coding::kRgb8};
  {
    auto writer = RecordingWriter::create(path_, {camera("view", Role::kView)}, codings, 60);
    ASSERT_TRUE(writer);
    ASSERT_TRUE(writer->write(frame(0, 5, 1, noise<Rgb8>(1))));
    const auto reason = [&](const Frame& f) { return writer->write(f).error().detail; };
    EXPECT_THAT(reason(frame(0, 6, .5, noise<Rgb8>(1))), HasSubstr("time before"));
    EXPECT_THAT(reason(frame(0, 6, 2, noise<Rgb8>(1, 47))),
                HasSubstr("47x32 pixels instead of 48x32"));
    EXPECT_THAT(reason(frame(0, 6, 2, noise<Rgb16>(1))), HasSubstr("16 bits"));
    EXPECT_THAT(reason(frame(0, 6, 2, Image<Rgb>(kRecordedWidth, kRecordedHeight))),
                HasSubstr("capture folder"));
    EXPECT_THAT(reason(frame(1, 6, 2, noise<Rgb8>(1))), HasSubstr("no camera 1"));
  }
  const auto again = RecordingWriter::create(path_, {camera("view", Role::kView)}, codings, 60);
  EXPECT_EQ(again.error().detail, "exists already: remove it, or choose another name");
  EXPECT_EQ(frames_of(path_)->size(), 1u);
  const auto nowhere = RecordingWriter::create(folder_.path() / "no" / "a.mkv",
                                               {camera("view", Role::kView)}, codings, 60);
  EXPECT_EQ(nowhere.error().detail, "No such file or directory");
}

TEST_F(RecordingTest, OtherFilesAreRefusedByName) {
  EXPECT_EQ(open_recording(path_).error().detail, "no such file");
  std::ofstream(path_) << "no Matroska at all";
  EXPECT_THAT(open_recording(path_).error().detail, HasSubstr("not a Matroska file"));
  const fs::path movie = folder_.path() / "movie.mkv";
  const std::string make =
      "ffmpeg -v error -f lavfi -i testsrc=s=64x32 -frames:v 2 " + movie.string();
  if (std::system(make.c_str()) != 0)
    GTEST_SKIP() << "no ffmpeg program to make a film with (package ffmpeg)";
  EXPECT_THAT(open_recording(movie).error().detail, HasSubstr("not a recording by penumbra"));
}

// ------------------------------------------------------------------------------- kill -9

// A process that records 60 frames a second, faster than they come, and tells each frame's number
// once it is written.
[[noreturn]] void record_until_killed(const fs::path& path, int tell) {
  const std::array codings{Coding::kRgb8, Coding::kRgb8};
  auto writer = RecordingWriter::create(
      path, {camera("environment", Role::kEnvironment), camera("view", Role::kView)}, codings, 60);
  if (!writer) _exit(1);
  for (std::uint32_t i = 0;; ++i) {
    const int c = static_cast<int>(i % 2);
    if (!writer->write(frame(c, i / 2, i / 2 / 60., noise<Rgb8>(i)))) _exit(2);
    if (::write(tell, &i, sizeof i) != sizeof i) _exit(3);
  }
}

TEST_F(RecordingTest, KilledAtAnyMomentItLosesLessThanASecond) {
  std::mt19937 random(9);
  for (int trial = 0; trial < 20; ++trial) {
    const fs::path path = folder_.path() / ("killed" + std::to_string(trial) + ".mkv");
    int pipe[2];
    ASSERT_EQ(::pipe(pipe), 0);
    const pid_t child = fork();
    if (child == 0) record_until_killed(path, pipe[1]);
    ::close(pipe[1]);
    const std::uint32_t until = 20 + random() % 600;
    std::uint32_t last = 0;
    while (last < until && ::read(pipe[0], &last, sizeof last) == sizeof last) continue;
    ::kill(child, SIGKILL);
    while (::read(pipe[0], &last, sizeof last) == sizeof last) continue;  // told, but not yet read
    ::close(pipe[0]);
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status));
    const auto read = frames_of(path);
    ASSERT_TRUE(read) << read.error().where << ": " << read.error().detail;
    // Every frame whose write() had returned.
    EXPECT_GE(read->size(), last + 1) << "trial " << trial;
    for (std::size_t i = 0; i < read->size(); ++i)
      EXPECT_EQ((*read)[i].sequence, static_cast<std::uint64_t>(i / 2));
    const std::string probe =
        "ffprobe -v error -show_entries stream=codec_name " + path.string() + " > /dev/null 2>&1";
    EXPECT_EQ(std::system(probe.c_str()), 0) << probe;
  }
}

// ------------------------------------------------------------------------------- an hour

// What is held, not what malloc keeps of what is free.
double resident_mb() {
  malloc_trim(0);
  long pages = 0, resident = 0;
  std::ifstream("/proc/self/statm") >> pages >> resident;
  return static_cast<double>(resident) * static_cast<double>(sysconf(_SC_PAGESIZE)) / 1e6;
}

TEST_F(RecordingTest, AnHourReplaysWithConstantMemory) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  // Sanitizers keep what was freed and take minutes for an hour: there the reader and the writer
  // alone are judged.
  constexpr int kFrames = 3'000;
  constexpr bool kMemoryCounts = false;
#else
  constexpr int kFrames = 216'000;  // 60 a second
  constexpr bool kMemoryCounts = true;
#endif
  constexpr int kW = 16, kH = 8;
  CameraInfo small = camera("view", Role::kView);
  small.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, kW, kH);
  const std::array codings{Coding::kRgb8};
  auto writer = RecordingWriter::create(path_, {small}, codings, 60);
  ASSERT_TRUE(writer);
  double after_a_tenth = 0;
  for (int i = 0; i < kFrames; ++i) {
    ASSERT_TRUE(writer->write(frame(0, static_cast<std::uint64_t>(i), i / 60.,
                                    noise<Rgb8>(static_cast<std::uint32_t>(i % 7), kW, kH))));
    if (i == kFrames / 10) after_a_tenth = resident_mb();
  }
  const double written = resident_mb() - after_a_tenth;
  ASSERT_TRUE(writer->finish());
  const auto source = open_recording(path_);
  ASSERT_TRUE(source);
  int count = 0;
  while (true) {
    const auto next = (*source)->next();
    ASSERT_TRUE(next) << next.error().detail;
    if (!*next) break;
    ASSERT_EQ((**next).sequence, static_cast<std::uint64_t>(count));
    if (++count == kFrames / 10) after_a_tenth = resident_mb();
  }
  EXPECT_EQ(count, kFrames);
  const double read = resident_mb() - after_a_tenth;
  std::printf("an hour: recording grew by %.1f MB (its index), replay by %.1f MB\n", written, read);
  if (!kMemoryCounts) return;
  EXPECT_LT(written, 20);
  EXPECT_LT(read, 2);
}

}  // namespace
}  // namespace penumbra::capture
