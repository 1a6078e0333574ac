// The client library against pages that the test writes, and the conversions against the light
// itself, looked up along mapped axes.
#include <gtest/gtest.h>

#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <memory>
#include <numbers>
#include <random>
#include <set>
#include <string>
#include <thread>

#include "service/client/penumbra_client.h"
#include "service/client/penumbra_convert.h"
#include "tests/support/light_page_writer.h"
#include "tests/support/temp_folder.h"

namespace penumbra::service {
namespace {

using test::LightPageWriter;
using test::TempFolder;
using namespace std::chrono_literals;

// A number everywhere, so that a mixture of two lights is seen.
penumbra_light light_full_of(std::uint64_t number) {
  penumbra_light light{};
  light.number = number;
  light.published_ns = LightPageWriter::monotonic_ns();
  light.valid = 1;
  light.bands = 9;
  light.light_count = 64;
  const auto value = static_cast<float>(number % 1'000'000);
  for (auto& row : light.coefficients)
    for (float& c : row) c = value;
  for (auto& row : light.residual)
    for (float& c : row) c = value;
  for (auto& one : light.lights) one.radius_rad = value;
  return light;
}

bool is_whole(const penumbra_light& light) {
  const auto value = static_cast<float>(light.number % 1'000'000);
  bool same = true;
  for (const auto& row : light.coefficients)
    for (float c : row) same &= c == value;
  for (const auto& row : light.residual)
    for (float c : row) same &= c == value;
  for (const auto& one : light.lights) same &= one.radius_rad == value;
  return same;
}

class OpenClient {
 public:
  explicit OpenClient(const std::filesystem::path& path) {
    code_ = penumbra_client_open(path.c_str(), &client_);
  }
  ~OpenClient() { penumbra_client_close(client_); }
  OpenClient(const OpenClient&) = delete;
  OpenClient& operator=(const OpenClient&) = delete;
  operator penumbra_client*() const { return client_; }
  [[nodiscard]] int code() const { return code_; }

 private:
  penumbra_client* client_ = nullptr;
  int code_ = 0;
};

struct LightPage : testing::Test {
  TempFolder folder;
  std::filesystem::path path = folder.path() / "light";
};

TEST_F(LightPage, GivesWhatWasWritten) {
  LightPageWriter writer(path);
  const OpenClient client(path);
  ASSERT_EQ(client.code(), PENUMBRA_OK);
  penumbra_light light{};
  EXPECT_EQ(penumbra_client_light(client, &light), PENUMBRA_NONE_YET);
  writer.write(light_full_of(7));
  ASSERT_EQ(penumbra_client_light(client, &light), PENUMBRA_OK);
  EXPECT_EQ(light.number, 7u);
  EXPECT_TRUE(is_whole(light));
  EXPECT_GE(penumbra_light_age_ns(&light), 0);
  EXPECT_LT(penumbra_light_age_ns(&light), 10'000'000'000);
  EXPECT_STREQ(penumbra_client_path(client), path.c_str());
}

TEST_F(LightPage, GivesObjectsAndTheCube) {
  LightPageWriter writer(path);
  const OpenClient client(path);
  penumbra_objects objects{};
  EXPECT_EQ(penumbra_client_objects(client, &objects), PENUMBRA_NONE_YET);
  objects.number = 3;
  objects.count = 1;
  std::memset(objects.objects[0].name, 'k', sizeof objects.objects[0].name);  // without an end
  objects.objects[0].position_m[1] = .5f;
  writer.write(objects);
  auto cube = std::make_unique<penumbra_cube>();
  EXPECT_EQ(penumbra_client_cube(client, cube.get()), PENUMBRA_NONE_YET);
  cube->number = 2, cube->size = 64, cube->faces = 6;
  cube->texels[5][63][62][1] = 0x3c00;
  writer.write(*cube);
  penumbra_objects got{};
  ASSERT_EQ(penumbra_client_objects(client, &got), PENUMBRA_OK);
  EXPECT_EQ(std::string(got.objects[0].name), std::string(63, 'k'));
  EXPECT_EQ(got.objects[0].position_m[1], .5f);
  auto copy = std::make_unique<penumbra_cube>();
  ASSERT_EQ(penumbra_client_cube(client, copy.get()), PENUMBRA_OK);
  EXPECT_EQ(std::memcmp(copy.get(), cube.get(), sizeof *cube), 0);
}

TEST_F(LightPage, IsNeverSeenTorn) {
  LightPageWriter writer(path);
  writer.write(light_full_of(1));
  std::atomic<bool> over = false;
  std::uint64_t written = 1;
  std::thread hammer([&] {
    while (!over) writer.write(light_full_of(++written));
  });
  const OpenClient client(path);
  const auto end = std::chrono::steady_clock::now() + 700ms;
  std::uint64_t newest = 0, read = 0, busy = 0, torn = 0, backwards = 0;
  while (std::chrono::steady_clock::now() < end) {
    penumbra_light light;
    const int code = penumbra_client_light(client, &light);
    busy += code == PENUMBRA_BUSY;
    if (code != PENUMBRA_OK) continue;
    ++read;
    torn += !is_whole(light);
    backwards += light.number < newest;
    newest = light.number;
  }
  over = true;
  hammer.join();
  EXPECT_EQ(torn, 0u);
  EXPECT_EQ(backwards, 0u);
  EXPECT_GT(read, 100u) << busy << " times busy, " << written << " written";
  EXPECT_GT(newest, 100u);
}

TEST_F(LightPage, OfAWriterThatDiedHalfWayIsBusyAtOnce) {
  LightPageWriter writer(path);
  writer.write(light_full_of(4));
  const OpenClient client(path);
  writer.leave_half_written();
  penumbra_light light{};
  const auto start = std::chrono::steady_clock::now();
  for (int i = 0; i < 1000; ++i) ASSERT_EQ(penumbra_client_light(client, &light), PENUMBRA_BUSY);
  EXPECT_LT(std::chrono::steady_clock::now() - start, 1s);
  EXPECT_EQ(light.number, 0u) << "nothing is written into the result";
  writer.write(light_full_of(5));
  EXPECT_EQ(penumbra_client_light(client, &light), PENUMBRA_OK) << "a new writer makes it good";
}

TEST_F(LightPage, AWaitEndsAtItsTime) {
  LightPageWriter writer(path);
  writer.write(light_full_of(1));
  const OpenClient client(path);
  penumbra_light light{};
  EXPECT_EQ(penumbra_client_wait(client, 0, 0, &light), PENUMBRA_OK);
  EXPECT_EQ(light.number, 1u);
  const auto start = std::chrono::steady_clock::now();
  EXPECT_EQ(penumbra_client_wait(client, 1, 60, &light), PENUMBRA_TIMEOUT);
  EXPECT_GE(std::chrono::steady_clock::now() - start, 60ms);
  EXPECT_EQ(penumbra_client_wait(client, 1, 0, &light), PENUMBRA_TIMEOUT);
}

TEST_F(LightPage, ANewLightEndsAWait) {
  LightPageWriter writer(path);
  writer.write(light_full_of(1));
  const OpenClient client(path);
  std::atomic<std::chrono::steady_clock::time_point> written{};
  std::chrono::nanoseconds latest = 0ns;
  for (std::uint64_t n = 2; n < 8; ++n) {
    std::jthread later([&] {
      std::this_thread::sleep_for(20ms);
      written = std::chrono::steady_clock::now();
      writer.write(light_full_of(n));
    });
    penumbra_light light{};
    ASSERT_EQ(penumbra_client_wait(client, n - 1, -1, &light), PENUMBRA_OK);
    const auto woken = std::chrono::steady_clock::now();
    EXPECT_EQ(light.number, n);
    later.join();
    latest = std::max<std::chrono::nanoseconds>(latest, woken - written.load());
  }
  // Without a wake-up it would look again after a quarter of a second.
  EXPECT_LT(latest, 200ms);
}

TEST_F(LightPage, AWaitPassesWhereNoDaemonRunsYet) {
  const OpenClient client(path);
  EXPECT_EQ(client.code(), PENUMBRA_NO_PAGE);
  ASSERT_NE(static_cast<penumbra_client*>(client), nullptr);
  penumbra_light light{};
  EXPECT_EQ(penumbra_client_light(client, &light), PENUMBRA_NO_PAGE);
  EXPECT_EQ(penumbra_client_wait(client, 0, 5, &light), PENUMBRA_NO_PAGE);
  LightPageWriter writer(path);
  writer.write(light_full_of(1));
  EXPECT_EQ(penumbra_client_wait(client, 0, 5000, &light), PENUMBRA_OK);
}

TEST_F(LightPage, OfADaemonThatBeganAnewIsFound) {
  auto first = std::make_unique<LightPageWriter>(path);
  first->write(light_full_of(9));
  const OpenClient client(path);
  penumbra_light light{};
  ASSERT_EQ(penumbra_client_light(client, &light), PENUMBRA_OK);
  first.reset();
  std::filesystem::remove(path);
  EXPECT_EQ(penumbra_client_light(client, &light), PENUMBRA_OK) << "still mapped";
  LightPageWriter second(path);
  second.write(light_full_of(1));
  ASSERT_EQ(penumbra_client_wait(client, 9, 5000, &light), PENUMBRA_OK);
  EXPECT_EQ(light.number, 1u);
}

TEST_F(LightPage, OfADaemonThatEndedIsStale) {
  LightPageWriter writer(path);
  writer.write(light_full_of(9));
  writer.page().writer_pid = 0x7fffffff;  // above the largest number of a process
  const OpenClient client(path);
  penumbra_light light{};
  EXPECT_EQ(penumbra_client_light(client, &light), PENUMBRA_STALE);
  EXPECT_EQ(light.number, 9u) << "the light is given none the less";
  writer.write(light_full_of(10));
  EXPECT_EQ(penumbra_client_light(client, &light), PENUMBRA_OK)
      << "who writes lives, whatever its number is here";
}

// Killed, and its parent has not asked yet.
TEST_F(LightPage, OfADaemonWhoseParentHasNotAskedForItIsStale) {
  const pid_t ended = ::fork();
  if (ended == 0) ::_exit(0);
  siginfo_t about{};
  ASSERT_EQ(::waitid(P_PID, static_cast<id_t>(ended), &about, WEXITED | WNOWAIT), 0);
  LightPageWriter writer(path);
  writer.write(light_full_of(9));
  writer.page().writer_pid = static_cast<std::uint32_t>(ended);
  const OpenClient client(path);
  penumbra_light light{};
  EXPECT_EQ(penumbra_client_light(client, &light), PENUMBRA_STALE);
  ::waitpid(ended, nullptr, 0);
}

TEST_F(LightPage, OfAFileThatIsNoneIsRefused) {
  const auto refused = [&] {
    const OpenClient client(path);
    penumbra_light light{};
    EXPECT_EQ(penumbra_client_light(client, &light), client.code());
    return client.code();
  };
  std::ofstream(path) << "PNBRLGHT";
  EXPECT_EQ(refused(), PENUMBRA_TOO_SHORT);
  std::filesystem::remove(path);
  std::filesystem::create_directory(path);
  EXPECT_EQ(refused(), PENUMBRA_NOT_A_PAGE);
  std::filesystem::remove(path);
  ASSERT_EQ(::mkfifo(path.c_str(), 0600), 0);
  EXPECT_EQ(refused(), PENUMBRA_NOT_A_PAGE);
  std::filesystem::remove(path);
  LightPageWriter writer(path);
  writer.page().version = 2;
  EXPECT_EQ(refused(), PENUMBRA_OTHER_VERSION);
  writer.page().version = 1;
  writer.page().bytes -= 64;
  EXPECT_EQ(refused(), PENUMBRA_OTHER_VERSION);
  writer.page().bytes += 64;
  writer.page().magic[0] = 'Q';
  EXPECT_EQ(refused(), PENUMBRA_NOT_A_PAGE);
}

TEST_F(LightPage, WithCountsOutOfRangeIsDamaged) {
  LightPageWriter writer(path);
  const OpenClient client(path);
  penumbra_light light = light_full_of(1), got{};
  light.bands = 10;
  writer.write(light);
  EXPECT_EQ(penumbra_client_light(client, &got), PENUMBRA_DAMAGED);
  EXPECT_EQ(penumbra_client_wait(client, 0, -1, &got), PENUMBRA_DAMAGED);
  light.bands = 9, light.light_count = 65;
  writer.write(light);
  EXPECT_EQ(penumbra_client_light(client, &got), PENUMBRA_DAMAGED);
  penumbra_objects objects{};
  objects.number = 1, objects.count = 65;
  writer.write(objects);
  EXPECT_EQ(penumbra_client_objects(client, &objects), PENUMBRA_DAMAGED);
  auto cube = std::make_unique<penumbra_cube>();
  cube->number = 1, cube->size = 32, cube->faces = 6;
  writer.write(*cube);
  EXPECT_EQ(penumbra_client_cube(client, cube.get()), PENUMBRA_DAMAGED);
}

TEST(PenumbraClient, TellsEachCodeApart) {
  std::set<std::string> texts;
  for (int code = PENUMBRA_NO_MEMORY; code <= PENUMBRA_STALE; ++code)
    texts.insert(penumbra_error_text(code));
  EXPECT_EQ(texts.size(), 13u);
  EXPECT_STREQ(penumbra_error_text(99), "unknown code");
  EXPECT_EQ(penumbra_client_version(), PENUMBRA_CLIENT_VERSION);
  EXPECT_EQ(penumbra_struct_bytes(PENUMBRA_STRUCT_LIGHT), sizeof(penumbra_light));
  EXPECT_EQ(penumbra_client_open("/x", nullptr), PENUMBRA_ARGUMENT);
  EXPECT_EQ(penumbra_client_light(nullptr, nullptr), PENUMBRA_ARGUMENT);
}

// ---- Conversions. ----

using Axis = std::array<double, 3>;

// The polynomials of three bands as the page's convention has them, without their factors.
std::array<double, 9> polynomials(const Axis& d) {
  const auto [x, y, z] = d;
  return {1, y, z, x, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y};
}

const std::array<double, 9> kOrthonormal = {
    std::sqrt(1 / (4 * std::numbers::pi)),  std::sqrt(3 / (4 * std::numbers::pi)),
    std::sqrt(3 / (4 * std::numbers::pi)),  std::sqrt(3 / (4 * std::numbers::pi)),
    std::sqrt(15 / (4 * std::numbers::pi)), std::sqrt(15 / (4 * std::numbers::pi)),
    std::sqrt(5 / (16 * std::numbers::pi)), std::sqrt(15 / (4 * std::numbers::pi)),
    std::sqrt(15 / (16 * std::numbers::pi))};
constexpr std::array<int, 9> kBand = {0, 1, 1, 1, 2, 2, 2, 2, 2};
constexpr std::array<int, 9> kOrder = {0, -1, 0, 1, -2, -1, 0, 1, 2};

double radiance(const float sh[9][3], const Axis& d) {
  const auto p = polynomials(d);
  double sum = 0;
  for (std::size_t n = 0; n < 9; ++n) sum += sh[n][0] * kOrthonormal[n] * p[n];
  return sum;
}

// What a white surface sends: E/pi.
double sent_by_white(const float sh[9][3], const Axis& d) {
  constexpr std::array<double, 3> share = {1, 2. / 3, 1. / 4};
  const auto p = polynomials(d);
  double sum = 0;
  for (std::size_t n = 0; n < 9; ++n)
    sum += share[static_cast<std::size_t>(kBand[n])] * sh[n][0] * kOrthonormal[n] * p[n];
  return sum;
}

// As an engine reads its coefficients: its polynomials have no factor where it folds them in.
double plain_sum(const float sh[9][3], const Axis& d) {
  const auto p = polynomials(d);
  double sum = 0;
  for (std::size_t n = 0; n < 9; ++n) sum += sh[n][0] * p[n];
  return sum;
}

// A basis with the Condon-Shortley phase.
double radiance_with_phase(const float sh[9][3], const Axis& d) {
  const auto p = polynomials(d);
  double sum = 0;
  for (std::size_t n = 0; n < 9; ++n)
    sum += sh[n][0] * kOrthonormal[n] * p[n] * (kOrder[n] % 2 ? -1 : 1);
  return sum;
}

struct AnyLight {
  float sh[9][3] = {};
  std::mt19937 random{20261127};

  AnyLight() {
    std::normal_distribution<float> normal;
    for (auto& row : sh)
      for (float& c : row) c = normal(random);
  }
  Axis direction() {
    std::normal_distribution<double> normal;
    Axis d = {normal(random), normal(random), normal(random)};
    const double length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    for (double& c : d) c /= length;
    return d;
  }
};

// expected(d) of the world against read(d') of the engine, d' being d on the engine's axes.
template <class Expected, class Read>
void expect_same_light(penumbra_convention convention, Expected expected, Read read) {
  AnyLight light;
  float out[9][3];
  ASSERT_EQ(penumbra_sh_convert(convention, light.sh, 3, out), PENUMBRA_OK);
  for (int i = 0; i < 200; ++i) {
    const Axis d = light.direction();
    const std::array<float, 3> in = {static_cast<float>(d[0]), static_cast<float>(d[1]),
                                     static_cast<float>(d[2])};
    std::array<float, 3> mapped{};
    ASSERT_EQ(penumbra_direction_convert(convention, in.data(), mapped.data()), PENUMBRA_OK);
    EXPECT_NEAR(read(out, {mapped[0], mapped[1], mapped[2]}), expected(light.sh, d), 2e-6);
  }
  ASSERT_EQ(penumbra_sh_convert(convention, light.sh, 3, light.sh), PENUMBRA_OK);
  EXPECT_EQ(std::memcmp(out, light.sh, sizeof out), 0) << "in place";
}

TEST(Convert, WebXrAndThreeReadTheSameRadiance) {
  expect_same_light(PENUMBRA_CONVENTION_WEBXR, radiance, radiance);
}
TEST(Convert, ArCoreReadsTheSameRadianceInABasisWithThePhase) {
  expect_same_light(PENUMBRA_CONVENTION_ARCORE, radiance, radiance_with_phase);
}
TEST(Convert, GodotReadsTheSameRadianceAtItsMirroredZ) {
  expect_same_light(PENUMBRA_CONVENTION_GODOT, radiance, [](const float sh[9][3], const Axis& d) {
    return radiance(sh, {d[0], d[1], -d[2]});
  });
}
TEST(Convert, FilamentReadsWhatAWhiteSurfaceSends) {
  expect_same_light(PENUMBRA_CONVENTION_FILAMENT, sent_by_white, plain_sum);
}
TEST(Convert, UnityReadsWhatAWhiteSurfaceSends) {
  expect_same_light(PENUMBRA_CONVENTION_UNITY, sent_by_white, plain_sum);
}
TEST(Convert, UnrealReadsTheSameRadianceInABasisWithThePhase) {
  expect_same_light(PENUMBRA_CONVENTION_UNREAL, radiance, radiance_with_phase);
}

// The engines' axes by their names: forward, right and up must come out where they say.
TEST(Convert, AxesStandWhereTheEnginesHaveThem) {
  const auto mapped = [](penumbra_convention convention, std::array<float, 3> d) {
    EXPECT_EQ(penumbra_direction_convert(convention, d.data(), d.data()), PENUMBRA_OK);
    return d;
  };
  using Three = std::array<float, 3>;
  const Three forward = {0, 0, -1}, right = {1, 0, 0}, up = {0, 1, 0};
  EXPECT_EQ(mapped(PENUMBRA_CONVENTION_UNITY, forward), (Three{0, 0, 1}));
  EXPECT_EQ(mapped(PENUMBRA_CONVENTION_UNITY, right), (Three{1, 0, 0}));
  EXPECT_EQ(mapped(PENUMBRA_CONVENTION_UNITY, up), (Three{0, 1, 0}));
  EXPECT_EQ(mapped(PENUMBRA_CONVENTION_UNREAL, forward), (Three{1, 0, 0}));
  EXPECT_EQ(mapped(PENUMBRA_CONVENTION_UNREAL, right), (Three{0, 1, 0}));
  EXPECT_EQ(mapped(PENUMBRA_CONVENTION_UNREAL, up), (Three{0, 0, 1}));
  for (const auto same : {PENUMBRA_CONVENTION_WEBXR, PENUMBRA_CONVENTION_ARCORE,
                          PENUMBRA_CONVENTION_GODOT, PENUMBRA_CONVENTION_FILAMENT})
    EXPECT_EQ(mapped(same, forward), forward);
}

TEST(Convert, RefusesBandsThatTheEngineDoesNotHave) {
  float sh[81][3] = {};
  EXPECT_EQ(penumbra_sh_convert(PENUMBRA_CONVENTION_WEBXR, sh, 9, sh), PENUMBRA_OK);
  EXPECT_EQ(penumbra_sh_convert(PENUMBRA_CONVENTION_GODOT, sh, 9, sh), PENUMBRA_OK);
  for (const auto few :
       {PENUMBRA_CONVENTION_FILAMENT, PENUMBRA_CONVENTION_UNITY, PENUMBRA_CONVENTION_UNREAL}) {
    EXPECT_EQ(penumbra_sh_convert(few, sh, 1, sh), PENUMBRA_OK);
    EXPECT_EQ(penumbra_sh_convert(few, sh, 4, sh), PENUMBRA_ARGUMENT);
  }
  EXPECT_EQ(penumbra_sh_convert(PENUMBRA_CONVENTION_WEBXR, sh, 10, sh), PENUMBRA_ARGUMENT);
  EXPECT_EQ(penumbra_sh_convert(PENUMBRA_CONVENTION_WEBXR, sh, 0, sh), PENUMBRA_ARGUMENT);
  EXPECT_EQ(penumbra_sh_convert(static_cast<penumbra_convention>(6), sh, 1, sh), PENUMBRA_ARGUMENT);
}

}  // namespace
}  // namespace penumbra::service
