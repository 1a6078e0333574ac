#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cmath>
#include <fstream>
#include <iterator>
#include <optional>
#include <random>
#include <string>
#include <string_view>
#include <vector>

#include "core/io/files.h"
#include "prt/prt.h"
#include "tests/fuzz/mutate.h"
#include "tests/support/temp_folder.h"

namespace penumbra::prt {
namespace {

namespace fs = std::filesystem;

class BakedFile : public testing::Test {
 protected:
  static BakedObject object(bool with_receiver, Rgb albedo, int bands = 3,
                            bool floor_apart = false) {
    BakeOptions options;
    options.bands = bands;
    options.rays = options.ground_rays = 64;
    options.bounces = 1;
    options.visibility = with_receiver;
    const Mesh mesh = make_knot(.37f, 12, 5, albedo);
    if (with_receiver)
      options.receiver = Receiver{fit_ground_grid(mesh, -.01f, 9), {.2f, .3f, .7f}};
    options.floor_apart = floor_apart;
    auto result = bake(mesh, options);
    EXPECT_TRUE(result);
    return result ? *result : BakedObject{};
  }
  fs::path file(const char* name) const { return folder_.path() / name; }
  void put(const fs::path& path, std::string_view bytes) const {
    std::ofstream(path, std::ios::binary)
        .write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  }
  std::string written(const BakedObject& object) const {
    EXPECT_TRUE(write_baked(file("whole.glb"), object));
    const auto bytes = read_bytes(file("whole.glb"));
    return bytes ? std::string(bytes->begin(), bytes->end()) : "";
  }
  /// The error of reading these bytes, or nothing when they are read.
  std::optional<ErrorCode> error_of(std::string_view bytes) const {
    put(file("damaged.glb"), bytes);
    const auto back = read_baked(file("damaged.glb"));
    if (back) return std::nullopt;
    EXPECT_EQ(back.error().where, file("damaged.glb").string());
    EXPECT_FALSE(back.error().detail.empty());
    EXPECT_EQ(back.error().detail.find('\n'), std::string::npos)
        << "errors are printed as one line";
    return back.error().code;
  }

  test::TempFolder folder_;
};

void expect_same(const Transfer& a, const Transfer& b) {
  EXPECT_EQ(a.bands, b.bands);
  EXPECT_EQ(a.channels, b.channels);
  EXPECT_EQ(a.points, b.points);
  EXPECT_EQ(a.stride, b.stride);
  EXPECT_EQ(a.values, b.values);
}

void expect_same(const BakedObject& a, const BakedObject& b) {
  EXPECT_EQ(a.mesh.positions, b.mesh.positions);
  EXPECT_EQ(a.mesh.normals, b.mesh.normals);
  EXPECT_EQ(a.mesh.albedo, b.mesh.albedo);
  EXPECT_EQ(a.mesh.triangles, b.mesh.triangles);
  expect_same(a.transfer, b.transfer);
  expect_same(a.ground_deficit, b.ground_deficit);
  expect_same(a.floor, b.floor);
  expect_same(a.ground_floor, b.ground_floor);
  expect_same(a.floor_again, b.floor_again);
  expect_same(a.ground_floor_again, b.ground_floor_again);
  EXPECT_EQ(a.floor_echo, b.floor_echo);
  EXPECT_EQ(a.visibility.refined, b.visibility.refined);
  EXPECT_EQ(a.visibility.fine, b.visibility.fine);
  EXPECT_EQ(a.visibility.open, b.visibility.open);
  EXPECT_EQ(a.report.rays, b.report.rays);
  EXPECT_EQ(a.report.seconds, b.report.seconds);
  EXPECT_EQ(a.report.standard_error, b.report.standard_error);
  ASSERT_EQ(a.receiver.has_value(), b.receiver.has_value());
  if (!a.receiver) return;
  EXPECT_EQ(a.receiver->albedo, b.receiver->albedo);
  const GroundGrid &g = a.receiver->grid, &h = b.receiver->grid;
  EXPECT_EQ(g.size, h.size);
  EXPECT_EQ(g.centre, h.centre);
  EXPECT_EQ(g.half_extent, h.half_extent);
  EXPECT_EQ(g.height, h.height);
}

TEST_F(BakedFile, RoundTripIsExact) {
  for (const bool receiver : {false, true})
    for (const Rgb albedo : {Rgb{.5f, .5f, .5f}, Rgb{.9f, .1f, .35f}})
      for (const int bands : {1, 2, 3, 9}) {
        SCOPED_TRACE(testing::Message() << receiver << ' ' << albedo.g << ' ' << bands);
        const BakedObject before = object(receiver, albedo, bands);
        ASSERT_TRUE(write_baked(file("a.glb"), before));
        const auto after = read_baked(file("a.glb"));
        ASSERT_TRUE(after) << after.error().detail;
        expect_same(before, *after);
      }
}

TEST_F(BakedFile, FloorApartComesBack) {
  for (const Rgb albedo : {Rgb{.5f, .5f, .5f}, Rgb{.9f, .1f, .35f}}) {
    const BakedObject before = object(true, albedo, 3, true);
    ASSERT_GT(before.floor.points, 0u);
    const auto bytes = written(before);
    put(file("apart.glb"), bytes);
    const auto after = read_baked(file("apart.glb"));
    ASSERT_TRUE(after) << after.error().detail;
    expect_same(before, *after);
  }
}

TEST_F(BakedFile, VisibilityWithoutFinerCellsComesBack) {
  BakeOptions options;
  options.rays = options.ground_rays = 64;
  options.visibility = true;
  const auto ball = bake(make_sphere({0, 0, 0}, .3f, 2, {.5f, .5f, .5f}), options);
  ASSERT_TRUE(ball);
  ASSERT_TRUE(ball->visibility.fine.empty());
  ASSERT_TRUE(write_baked(file("ball.glb"), *ball));
  const auto back = read_baked(file("ball.glb"));
  ASSERT_TRUE(back) << back.error().detail;
  expect_same(*ball, *back);
}

TEST_F(BakedFile, VisibilityWhosePartsDoNotAgreeIsAnError) {
  const BakedObject whole = object(true, {.5f, .5f, .5f});
  ASSERT_EQ(error_of(written(whole)), std::nullopt);
  BakedObject fewer = whole;
  fewer.visibility.fine.pop_back();
  EXPECT_EQ(error_of(written(fewer)), ErrorCode::kUnreadable);
  BakedObject more = whole;
  more.visibility.refined[0] ^= 1;
  EXPECT_EQ(error_of(written(more)), ErrorCode::kUnreadable);
  BakedObject short_ = whole;
  short_.visibility.refined.pop_back();
  EXPECT_EQ(error_of(written(short_)), ErrorCode::kUnreadable);
}

TEST_F(BakedFile, SameObjectGivesTheSameBytes) {
  const BakedObject o = object(true, {.9f, .1f, .35f});
  const std::string first = written(o);
  EXPECT_EQ(first, written(o));
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_.path()), fs::directory_iterator()), 1)
      << "no temporary is left";
}

TEST_F(BakedFile, IsAGltfThatOtherReadersOpen) {
  const BakedObject before = object(true, {.9f, .1f, .35f});
  ASSERT_TRUE(write_baked(file("a.glb"), before));
  const auto imported = import_mesh(file("a.glb"), {0, 0, 0});
  ASSERT_TRUE(imported) << imported.error().detail;
  EXPECT_EQ(imported->mesh.triangles.size() + imported->degenerate_triangles,
            before.mesh.triangles.size());
  const Bounds a = bounds_of(before.mesh), b = bounds_of(imported->mesh);
  EXPECT_LT(glm::distance(a.low, b.low) + glm::distance(a.high, b.high), 1e-6f);
}

TEST_F(BakedFile, IsRecognised) {
  const BakedObject o = object(false, {.5f, .5f, .5f});
  ASSERT_TRUE(write_baked(file("a.glb"), o));
  EXPECT_TRUE(is_baked_file(file("a.glb")));
  put(file("text.glb"), "This is not a model, though it says \"penumbra\" and _TRANSFER_0.");
  EXPECT_FALSE(is_baked_file(file("text.glb")));
  put(file("empty.glb"), "");
  EXPECT_FALSE(is_baked_file(file("empty.glb")));
  EXPECT_FALSE(is_baked_file(file("absent.glb")));
  EXPECT_FALSE(is_baked_file(folder_.path()));
}

// ------------------------------------------------------------------------------------- damage

// A binary glTF of one JSON chunk and one of bytes.
std::string glb(std::string json, std::string bytes = "") {
  const auto word = [](std::size_t v) {
    std::string s;
    for (int i = 0; i < 4; ++i) s += static_cast<char>(v >> (8 * i) & 255);
    return s;
  };
  json.resize((json.size() + 3) / 4 * 4, ' ');
  bytes.resize((bytes.size() + 3) / 4 * 4, '\0');
  std::string body = word(json.size()) + "JSON" + json;
  if (!bytes.empty()) body += word(bytes.size()) + std::string("BIN\0", 4) + bytes;
  return "glTF" + word(2) + word(12 + body.size()) + body;
}

// The JSON of a file and its bytes, to damage one and put both together again.
struct Parts {
  std::string json, bytes;
};
Parts split(const std::string& file) {
  const auto word = [&](std::size_t at) {
    std::size_t v = 0;
    for (std::size_t i = 0; i < 4; ++i)
      v |= std::size_t{static_cast<unsigned char>(file[at + i])} << (8 * i);
    return v;
  };
  const std::size_t json = word(12);
  return {file.substr(20, json), file.substr(28 + json, word(20 + json))};
}

std::string replaced(std::string text, std::string_view from, std::string_view to) {
  const auto at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

TEST_F(BakedFile, TruncatedAnywhereIsAnErrorAndNeverACrash) {
  const std::string whole = written(object(true, {.9f, .1f, .35f}));
  ASSERT_GT(whole.size(), 10'000u);
  for (std::size_t length = 0; length < whole.size(); length += length < 64 ? 1 : 1 + length / 29)
    EXPECT_TRUE(error_of(std::string_view(whole).substr(0, length))) << length;
  EXPECT_TRUE(error_of(std::string_view(whole).substr(0, whole.size() - 1)));
  EXPECT_FALSE(error_of(whole));
}

TEST_F(BakedFile, ShortenedWithItsLengthsMadeToAgreeIsAnErrorToo) {
  const Parts parts = split(written(object(true, {.5f, .5f, .5f})));
  for (std::size_t cut = 4; cut < parts.bytes.size(); cut += parts.bytes.size() / 40)
    EXPECT_TRUE(error_of(glb(parts.json, parts.bytes.substr(0, parts.bytes.size() - cut)))) << cut;
}

TEST_F(BakedFile, DamagedDescriptionsAreErrors) {
  const Parts parts = split(written(object(true, {.5f, .5f, .5f})));
  const auto code = [&](std::string_view from, std::string_view to) {
    return error_of(glb(replaced(parts.json, from, to), parts.bytes));
  };
  ASSERT_EQ(error_of(glb(parts.json, parts.bytes)), std::nullopt) << "the damage must be the cause";
  EXPECT_EQ(code("\"bands\":3", "\"bands\":4"), ErrorCode::kUnreadable);
  EXPECT_EQ(code("\"bands\":3", "\"bands\":10"), ErrorCode::kUnreadable);
  EXPECT_EQ(code("\"bands\":3", "\"bands\":-3"), ErrorCode::kUnreadable);
  EXPECT_EQ(code("\"channels\":3", "\"channels\":1"), ErrorCode::kUnreadable);
  EXPECT_EQ(code("\"channels\":3", "\"channels\":2"), ErrorCode::kUnreadable);
  EXPECT_EQ(code("\"size\":9", "\"size\":8"), ErrorCode::kUnreadable);
  EXPECT_EQ(code("\"size\":9", "\"size\":1"), ErrorCode::kUnreadable);
  EXPECT_EQ(code("\"count\":60", "\"count\":0"), ErrorCode::kUnreadable) << "no vertices";
  EXPECT_EQ(code("\"deficit\":", "\"surplus\":"), ErrorCode::kUnreadable);
  EXPECT_EQ(code("\"version\":6", "\"version\":5"), ErrorCode::kInvalid) << "another version";
  EXPECT_EQ(code("\"visibility\":", "\"visibility\":7,\"x\":"), ErrorCode::kUnreadable);
  EXPECT_EQ(code("\"receiver\":", "\"receiver\":7,\"x\":"), ErrorCode::kUnreadable);
  EXPECT_EQ(code("\"fine\":", "\"open\":"), ErrorCode::kUnreadable) << "no finer cells";
  EXPECT_EQ(code("\"fine\":", "\"fine\":9"), ErrorCode::kUnreadable) << "no such accessor";
  EXPECT_EQ(code("\"refined\":", "\"refined\":9"), ErrorCode::kUnreadable) << "no such accessor";
  EXPECT_EQ(code("\"open\":", "\"open\":9"), ErrorCode::kUnreadable) << "no such accessor";
  EXPECT_EQ(code("\"_TRANSFER_1\"", "\"_TRANSFER_7\""), ErrorCode::kUnreadable);
  EXPECT_EQ(code("\"penumbra\":", "\"elsewhere\":"), ErrorCode::kInvalid) << "not ours";
}

// Whatever comes back fits together: what is not so would be read past its end.
TEST_F(BakedFile, DamageAnywhereIsAnErrorOrAnObject) {
  const std::string whole = written(object(true, {.9f, .1f, .35f}));
  const Parts parts = split(whole);
  int read = 0, refused = 0;
  const auto take = [&](std::string_view bytes) {
    put(file("damaged.glb"), bytes);
    const auto o = read_baked(file("damaged.glb"));
    if (!o) return void(++refused);
    ++read;
    const std::size_t count = o->mesh.positions.size();
    ASSERT_EQ(o->mesh.normals.size(), count);
    ASSERT_EQ(o->transfer.points, count);
    for (const auto& t : o->mesh.triangles)
      for (const std::uint32_t v : t) ASSERT_LT(v, count);
    if (o->visibility.empty()) return;
    ASSERT_EQ(o->visibility.refined.size(), count);
    const VisibilityLookup lookup(o->visibility, o->mesh);
    std::vector<CosineSums> sums(count);
    for (const int cells : {VisibilityMap::kCells, VisibilityMap::kFineCells}) {
      VisibilitySamples directions_used;
      directions_used.clear(cells);
      for (std::size_t k = 0; k < VisibilitySamples::kMax; ++k)
        directions_used.add({.6f, k % 2 ? .8f : -.8f, 0}, true);
      lookup.look_up(directions_used, 0, count, sums);
    }
  };
  const auto as_bytes = [](const std::string& s) {
    return std::span(reinterpret_cast<const unsigned char*>(s.data()), s.size());
  };
  const auto as_text = [](std::span<const unsigned char> b) {
    return std::string(reinterpret_cast<const char*>(b.data()), b.size());
  };
  test::mutate_and_run(as_bytes(whole), 400, 1, [&](auto b) { take(as_text(b)); });
  test::mutate_and_run(as_bytes(parts.json), 400, 2,
                       [&](auto b) { take(glb(as_text(b), parts.bytes)); });
  test::mutate_and_run(as_bytes(parts.bytes), 400, 3,
                       [&](auto b) { take(glb(parts.json, as_text(b))); });
  EXPECT_GT(read, 50) << "else only the first check is tested";
  EXPECT_GT(refused, 50);
}

TEST_F(BakedFile, DeclaredSizeIsCheckedBeforeItIsAllocated) {
  const Parts parts = split(written(object(true, {.5f, .5f, .5f})));
  rusage before{}, after{};
  ::getrusage(RUSAGE_SELF, &before);
  const auto code = error_of(glb(replaced(parts.json, "\"size\":9", "\"size\":4096"), parts.bytes));
  ::getrusage(RUSAGE_SELF, &after);
  EXPECT_EQ(code, ErrorCode::kUnreadable);
  EXPECT_LT(after.ru_maxrss - before.ru_maxrss, 64 * 1024) << "kilobytes, for a file of a few";
}

TEST_F(BakedFile, MissingReportFigureIsNotReadAsNan) {
  const Parts parts = split(written(object(false, {.5f, .5f, .5f})));
  for (const char* key : {"\"standard_error\":", "\"seconds\":", "\"rays\":"}) {
    put(file("a.glb"), glb(replaced(parts.json, key, "\"other\":"), parts.bytes));
    const auto back = read_baked(file("a.glb"));
    if (!back) continue;
    EXPECT_TRUE(std::isfinite(back->report.standard_error) && std::isfinite(back->report.seconds))
        << key;
  }
}

TEST_F(BakedFile, NonFiniteValuesAreRefused) {
  const BakedObject good = object(true, {.5f, .5f, .5f});
  for (const float bad : {NAN, INFINITY}) {
    BakedObject o = good;
    o.mesh.positions[3].y = bad;
    EXPECT_EQ(error_of(written(o)), ErrorCode::kUnreadable);
    o = good;
    o.mesh.albedo[3].g = bad;
    EXPECT_EQ(error_of(written(o)), ErrorCode::kUnreadable);
    o = good;
    o.transfer.set(0, 4, 5, bad);
    EXPECT_EQ(error_of(written(o)), ErrorCode::kUnreadable);
    o = good;
    o.ground_deficit.set(0, 4, 5, bad);
    EXPECT_EQ(error_of(written(o)), ErrorCode::kUnreadable);
  }
}

TEST_F(BakedFile, IndexPastTheLastVertexIsRefused) {
  BakedObject o = object(false, {.5f, .5f, .5f});
  o.mesh.triangles[0][1] = static_cast<std::uint32_t>(o.mesh.positions.size());
  EXPECT_EQ(error_of(written(o)), ErrorCode::kUnreadable);
}

TEST_F(BakedFile, FilesThatWereNotBakedAreRefused) {
  EXPECT_EQ(read_baked(file("absent.glb")).error().code, ErrorCode::kNotFound);
  EXPECT_TRUE(error_of("A plain text file.\nWith two lines.\n"));
  EXPECT_TRUE(error_of(""));
  EXPECT_EQ(error_of(glb(R"({"asset":{"version":"2.0"}})")), ErrorCode::kInvalid)
      << "glTF, but not ours";
  EXPECT_FALSE(is_baked_file(file("damaged.glb")));
  EXPECT_TRUE(error_of(glb(
      R"({"asset":{"version":"2.0","extras":{"penumbra":{"version":1,"bands":3,"channels":1}}}})")))
      << "ours, but empty";
  EXPECT_TRUE(error_of(glb(R"({"asset":{"version":"2.0","extras":{"penumbra":[]}}})")));
}

TEST_F(BakedFile, RandomDamageNeverCrashes) {
  const std::string whole = written(object(true, {.5f, .5f, .5f}, 2));
  const std::size_t json = split(whole).json.size();
  std::mt19937 rng(3);
  for (int i = 0; i < 400; ++i) {
    std::string bytes = whole;
    // Most damage to the description, where it has the most ways to mislead.
    const std::size_t reach = i % 4 == 0 ? whole.size() : 20 + json;
    for (int k = 0; k <= i % 3; ++k)
      bytes[rng() % reach] = static_cast<char>(i % 2 ? rng() : '0' + rng() % 10);
    const auto ignored = error_of(bytes);
    (void)ignored;
  }
}

TEST_F(BakedFile, WriteFailureLeavesNothing) {
  const BakedObject o = object(false, {.5f, .5f, .5f});
  const auto absent = write_baked(file("no") / "a.glb", o);
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().code, ErrorCode::kUnwritable);
  fs::create_directory(file("folder.glb"));
  const auto folder = write_baked(file("folder.glb"), o);
  ASSERT_FALSE(folder);
  EXPECT_EQ(folder.error().code, ErrorCode::kUnwritable);
  EXPECT_TRUE(fs::is_empty(file("folder.glb")));
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_.path()), fs::directory_iterator()), 1);
}

}  // namespace
}  // namespace penumbra::prt
