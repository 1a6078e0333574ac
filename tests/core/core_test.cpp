#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <glm/gtc/quaternion.hpp>
#include <iterator>
#include <limits>
#include <random>
#include <stdexcept>
#include <string>

#include "core/conventions.h"
#include "core/io/files.h"
#include "core/pose.h"
#include "core/units.h"
#include "tests/support/temp_folder.h"

namespace penumbra {
namespace {

namespace fs = std::filesystem;
using glm::dvec3;

// ------------------------------------------------------------------------------------- units

TEST(Quantity, ArithmeticFollowsItsNumbers) {
  constexpr Radians a(3), b(.5);
  static_assert((a + b).value() == 3.5 && (a - b).value() == 2.5);
  static_assert((a * 2.).value() == 6 && (2. * a).value() == 6);
  static_assert(a / b == 6);
  static_assert(a > b && a == Radians(3) && a != b);
  EXPECT_EQ(Radians().value(), 0);
}

TEST(Quantity, NanIsNotEqualToItself) {
  const Radians nan(std::numeric_limits<double>::quiet_NaN());
  EXPECT_FALSE(nan == nan);
  EXPECT_FALSE(nan < Radians(0) || nan > Radians(0));
}

TEST(Exposure, ProductIsTimeTimesGain) {
  EXPECT_DOUBLE_EQ((Exposure{Seconds(.02), Gain(4)}).product(), .08);
  EXPECT_DOUBLE_EQ(Exposure{Seconds(.02)}.product(), .02) << "the base gain is 1";
  EXPECT_DOUBLE_EQ(Exposure{std::chrono::milliseconds(5)}.product(), .005);
}

TEST(TimestampNs, StepThereAndBackIsExactToTheNanosecond) {
  std::mt19937_64 rng(1);
  std::uniform_int_distribution<std::int64_t> instants(0, std::int64_t{1} << 50);
  std::uniform_int_distribution<std::int64_t> steps(-1'000'000'000'000, 1'000'000'000'000);
  for (int i = 0; i < 1000; ++i) {
    const TimestampNs start{instants(rng)};
    const std::int64_t step = steps(rng);
    const TimestampNs end{start.value + step};
    EXPECT_EQ(start + (end - start), end);
    EXPECT_EQ(start + Seconds(static_cast<double>(step) * 1e-9), end);
  }
}

TEST(TimestampNs, StepsRoundToTheNearestNanosecondOnBothSides) {
  const TimestampNs start{1000};
  EXPECT_EQ((start + Seconds(1.4e-9)).value, 1001);
  EXPECT_EQ((start + Seconds(1.6e-9)).value, 1002);
  EXPECT_EQ((start + Seconds(-1.4e-9)).value, 999);
  EXPECT_EQ((start + Seconds(-1.6e-9)).value, 998);
}

TEST(TimestampNs, DifferenceKeepsNanosecondsOfYoungPairsOfOldInstants) {
  // A clock that has run for ten years: subtracting as doubles would lose 50 ns.
  const TimestampNs old{std::int64_t{315'360'000} * 1'000'000'000};
  const TimestampNs young{old.value + 1};
  EXPECT_DOUBLE_EQ((young - old).count(), 1e-9);
  EXPECT_LT(old, young);
}

// ------------------------------------------------------------------------------------- pose

Pose random_pose(std::mt19937& rng) {
  std::normal_distribution<double> g;
  return {glm::normalize(glm::dquat(g(rng), g(rng), g(rng), g(rng))),
          {5 * g(rng), 5 * g(rng), 5 * g(rng)}};
}

dvec3 random_point(std::mt19937& rng) {
  std::normal_distribution<double> g;
  return {g(rng), g(rng), g(rng)};
}

TEST(Pose, ComposedAppliesTheRightOneFirst) {
  std::mt19937 rng(2);
  for (int i = 0; i < 50; ++i) {
    const Pose a = random_pose(rng), b = random_pose(rng);
    const dvec3 p = random_point(rng);
    EXPECT_LT(glm::distance((a * b) * p, a * (b * p)), 1e-12);
  }
  const Pose turn{glm::angleAxis(kPi / 2, dvec3(0, 1, 0)), {0, 0, 0}},
      shift{{1, 0, 0, 0}, {0, 0, -1}};
  EXPECT_LT(glm::distance(turn * shift * dvec3(0), dvec3(-1, 0, 0)), 1e-15);
  EXPECT_LT(glm::distance(shift * turn * dvec3(0), dvec3(0, 0, -1)), 1e-15);
}

TEST(Pose, InverseUndoesFromBothSides) {
  std::mt19937 rng(3);
  for (int i = 0; i < 50; ++i) {
    const Pose a = random_pose(rng);
    const dvec3 p = random_point(rng);
    EXPECT_LT(glm::distance(a.inverse() * (a * p), p), 1e-12);
    EXPECT_LT(glm::distance(a * a.inverse() * p, p), 1e-12);
  }
}

TEST(Pose, MatricesActLikeThePose) {
  std::mt19937 rng(4);
  for (int i = 0; i < 50; ++i) {
    const Pose a = random_pose(rng);
    const dvec3 p = random_point(rng);
    EXPECT_LT(glm::distance(dvec3(a.matrix() * glm::dvec4(p, 1)), a * p), 1e-12);
    EXPECT_LT(glm::distance(a.rotation_matrix() * p + a.translation, a * p), 1e-12);
    EXPECT_NEAR(glm::determinant(a.rotation_matrix()), 1, 1e-12);
  }
}

// ------------------------------------------------------------------------------------- lat-long

TEST(LatLong, AxesStandWhereTheConventionsSay) {
  EXPECT_LT(glm::distance(latlong_direction(32, 16, 64, 32), dvec3(0, 0, -1)), 1e-15) << "centre";
  EXPECT_LT(glm::distance(latlong_direction(48, 16, 64, 32), dvec3(1, 0, 0)), 1e-15)
      << "to its right";
  EXPECT_LT(glm::distance(latlong_direction(16, 16, 64, 32), dvec3(-1, 0, 0)), 1e-15);
  EXPECT_LT(glm::distance(latlong_direction(7, 0, 64, 32), dvec3(0, 1, 0)), 1e-15)
      << "top row is up";
}

TEST(LatLong, PixelAndDirectionInvertEachOther) {
  std::mt19937 rng(5);
  std::uniform_real_distribution<double> x(0, 64), y(.01, 31.99);
  for (int i = 0; i < 1000; ++i) {
    const glm::dvec2 p(x(rng), y(rng));
    const dvec3 d = latlong_direction(p.x, p.y, 64, 32);
    EXPECT_NEAR(glm::length(d), 1, 1e-14);
    EXPECT_LT(glm::distance(latlong_pixel(d, 64, 32), p), 1e-9);
    EXPECT_LT(glm::distance(latlong_pixel(7. * d, 64, 32), p), 1e-9) << "length must not matter";
  }
}

TEST(LatLong, EveryDirectionHasAPixelInRange) {
  std::mt19937 rng(6);
  for (int i = 0; i < 1000; ++i) {
    const dvec3 d = i < 2 ? dvec3(0, 2 * i - 1, 0) : random_point(rng);  // the poles first
    const glm::dvec2 p = latlong_pixel(d, 64, 32);
    EXPECT_TRUE(p.x >= 0 && p.x <= 64 && p.y >= 0 && p.y <= 32) << p.x << ' ' << p.y;
  }
}

TEST(LatLong, SolidAnglesSumToTheSphere) {
  for (const auto& [width, height] : {std::pair{4, 1}, {64, 32}, {30, 15}, {1024, 512}, {7, 301}}) {
    double sum = 0;
    for (int j = 0; j < height; ++j) {
      const double w = latlong_solid_angle(j, width, height);
      EXPECT_GT(w, 0);
      sum += width * w;
    }
    EXPECT_NEAR(sum, 4 * kPi, 1e-11) << width << 'x' << height;
  }
}

TEST(LatLong, SolidAngleIsTheAreaBetweenItsRims) {
  // A row's zone on the unit sphere has the area 2 pi times its height along y (Archimedes).
  const double top = latlong_direction(0, 5, 64, 32).y, bottom = latlong_direction(0, 6, 64, 32).y;
  EXPECT_NEAR(64 * latlong_solid_angle(5, 64, 32), 2 * kPi * (top - bottom), 1e-12);
}

// ------------------------------------------------------------------------------------- files

std::string content(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

Result<void> put(const fs::path& path, std::string_view text) {
  std::ofstream(path, std::ios::binary) << text;
  return {};
}

class Files : public testing::Test {
 protected:
  // BlockedSh files count: a temporary one is.
  std::size_t entries() const {
    return static_cast<std::size_t>(
        std::distance(fs::directory_iterator(folder_.path()), fs::directory_iterator()));
  }
  fs::path file(const char* name) const { return folder_.path() / name; }

  test::TempFolder folder_;
};

TEST_F(Files, ReplaceWritesAndOverwrites) {
  for (const char* text : {"first", "second"}) {
    ASSERT_TRUE(replace_file(file("a.txt"), [&](const fs::path& p) { return put(p, text); }));
    EXPECT_EQ(content(file("a.txt")), text);
    EXPECT_EQ(entries(), 1u);
  }
}

TEST_F(Files, TemporaryStandsBesideTheTargetWithItsExtension) {
  fs::path seen;
  const auto done = replace_file(file("a.tar.exr"), [&](const fs::path& p) {
    seen = p;
    return put(p, "x");
  });
  ASSERT_TRUE(done);
  EXPECT_EQ(seen.parent_path(), folder_.path()) << "a rename is atomic only within a file system";
  EXPECT_EQ(seen.extension(), ".exr");
  EXPECT_NE(seen, file("a.tar.exr"));
}

TEST_F(Files, FailedWriteLeavesTargetUntouchedAndNothingBehind) {
  ASSERT_TRUE(write_bytes(file("a.txt"), "kept"));
  const auto done = replace_file(file("a.txt"), [&](const fs::path& p) -> Result<void> {
    EXPECT_TRUE(put(p, "half of it"));
    return fail(ErrorCode::kUndetermined, "encoder", "ran out of light");
  });
  ASSERT_FALSE(done);
  EXPECT_EQ(done.error().code, ErrorCode::kUndetermined) << "the writer's own error comes through";
  EXPECT_EQ(done.error().detail, "ran out of light");
  EXPECT_EQ(content(file("a.txt")), "kept");
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, ThrowingWriteLeavesTargetUntouchedAndNothingBehind) {
  ASSERT_TRUE(write_bytes(file("a.txt"), "kept"));
  const auto done = replace_file(file("a.txt"), [&](const fs::path& p) -> Result<void> {
    EXPECT_TRUE(put(p, "half of it"));
    throw std::runtime_error("encoder threw");
  });
  ASSERT_FALSE(done);
  EXPECT_EQ(done.error().code, ErrorCode::kUnwritable);
  EXPECT_NE(done.error().detail.find("encoder threw"), std::string::npos);
  EXPECT_EQ(content(file("a.txt")), "kept");
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, ThrowingSomethingElseLeavesNothingBehindEither) {
  ASSERT_TRUE(write_bytes(file("a.txt"), "kept"));
  try {
    const auto done = replace_file(file("a.txt"), [&](const fs::path& p) -> Result<void> {
      EXPECT_TRUE(put(p, "half of it"));
      throw 42;
    });
    EXPECT_FALSE(done);
  } catch (int) {
    // Whether it is translated or passed on, the promise about the files holds.
  }
  EXPECT_EQ(content(file("a.txt")), "kept");
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, WriterThatWritesNothingIsAnError) {
  const auto done = replace_file(file("a.txt"), [](const fs::path&) { return Result<void>{}; });
  ASSERT_FALSE(done);
  EXPECT_EQ(done.error().code, ErrorCode::kUnwritable);
  EXPECT_TRUE(folder_.empty());
}

TEST_F(Files, FolderAsTargetIsRefusedAndKept) {
  fs::create_directory(file("folder"));
  bool called = false;
  const auto done = replace_file(file("folder"), [&](const fs::path& p) {
    called = true;
    return put(p, "x");
  });
  ASSERT_FALSE(done);
  EXPECT_EQ(done.error().code, ErrorCode::kUnwritable);
  EXPECT_FALSE(called) << "work whose result cannot be kept";
  EXPECT_TRUE(fs::is_directory(file("folder")));
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, NoFolderToWriteInIsUnwritableAndNamesTheTarget) {
  ASSERT_TRUE(write_bytes(file("plain"), "x"));
  for (const fs::path& target : {file("absent") / "a.txt", file("plain") / "a.txt"}) {
    const auto done = write_bytes(target, "x");
    ASSERT_FALSE(done) << target;
    EXPECT_EQ(done.error().code, ErrorCode::kUnwritable);
    EXPECT_EQ(done.error().where, target.string());
    EXPECT_FALSE(done.error().detail.empty());
  }
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, FolderWithoutPermissionIsUnwritable) {
  if (::geteuid() == 0) GTEST_SKIP() << "root may write everywhere";
  fs::permissions(folder_.path(), fs::perms::owner_read | fs::perms::owner_exec);
  const auto done = write_bytes(file("a.txt"), "x");
  fs::permissions(folder_.path(), fs::perms::owner_all);
  ASSERT_FALSE(done);
  EXPECT_EQ(done.error().code, ErrorCode::kUnwritable);
  EXPECT_TRUE(folder_.empty());
}

TEST_F(Files, CheckingWhetherAFileCouldBeMadeLeavesNothing) {
  ASSERT_TRUE(check_writable(file("a.txt")));
  ASSERT_TRUE(write_bytes(file("b.txt"), "b"));
  ASSERT_TRUE(check_writable(file("b.txt")));
  EXPECT_EQ(entries(), 1u);
  for (const fs::path& bad : {file("none") / "a.txt", file("b.txt") / "a.txt", folder_.path()}) {
    const auto answer = check_writable(bad);
    ASSERT_FALSE(answer) << bad;
    EXPECT_EQ(answer.error().code, ErrorCode::kUnwritable);
    EXPECT_EQ(answer.error().where, bad.string());
  }
}

TEST_F(Files, BytesComeBackAsWritten) {
  std::string bytes(100'000, '\0');
  std::mt19937 rng(8);
  for (char& c : bytes) c = static_cast<char>(rng());
  for (const std::string& text : {bytes, std::string(), std::string("\r\n\0\n", 4)}) {
    ASSERT_TRUE(write_bytes(file("a.bin"), text));
    const auto back = read_bytes(file("a.bin"));
    ASSERT_TRUE(back);
    EXPECT_TRUE(std::ranges::equal(*back, text, {}, {},
                                   [](char c) { return static_cast<unsigned char>(c); }));
  }
}

TEST_F(Files, TextLosesItsByteOrderMarkAndNothingElse) {
  const fs::path path = folder_.path() / "mark.csv";
  for (const std::string text : {"", "a,b\n", "\xef\xbb", "x\xef\xbb\xbf"}) {
    for (const std::string mark : {"", "\xef\xbb\xbf"}) {
      ASSERT_TRUE(write_bytes(path, mark + text));
      EXPECT_EQ(read_text(path), text);
    }
  }
}

TEST_F(Files, ReadingSaysWhyItFails) {
  ASSERT_TRUE(write_bytes(file("a.bin"), "12345"));
  EXPECT_EQ(read_bytes(file("absent")).error().code, ErrorCode::kNotFound);
  EXPECT_EQ(read_bytes(folder_.path()).error().code, ErrorCode::kUnreadable);
  EXPECT_EQ(read_bytes(file("a.bin"), 4).error().code, ErrorCode::kInvalid);
  EXPECT_TRUE(read_bytes(file("a.bin"), 5));
}

TEST_F(Files, MakeFolderIsIdempotentAndRefusesAFile) {
  for (int i = 0; i < 2; ++i) EXPECT_TRUE(make_folder(file("a") / "b" / "c"));
  EXPECT_TRUE(fs::is_directory(file("a") / "b" / "c"));
  ASSERT_TRUE(write_bytes(file("plain"), "x"));
  for (const fs::path& path : {file("plain"), file("plain") / "below"}) {
    const auto done = make_folder(path);
    ASSERT_FALSE(done) << path;
    EXPECT_EQ(done.error().code, ErrorCode::kUnwritable);
  }
}

}  // namespace
}  // namespace penumbra
