#include "tools/chart/charts/chart_plot.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "core/io/files.h"
#include "tests/support/temp_folder.h"
#include "tools/plots/gnuplot.h"

namespace penumbra::tools {

namespace {

namespace fs = std::filesystem;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

using Front = std::vector<std::size_t>;
using CostsAndErrors = std::vector<std::pair<double, double>>;

TEST(ParetoFront, LeavesOutWhatAnotherBeats) {
  EXPECT_EQ(pareto_front(CostsAndErrors{{3, 1}, {1, 3}, {2, 2}, {2.5, 2.5}, {4, 1}}),
            (Front{1, 2, 0}));
  EXPECT_EQ(pareto_front(CostsAndErrors{}), Front{});
  EXPECT_EQ(pareto_front(CostsAndErrors{{5, 5}}), Front{0});
}

TEST(ParetoFront, TiesInOneValueAreDecidedByTheOther) {
  EXPECT_EQ(pareto_front(CostsAndErrors{{1, 2}, {1, 1}, {2, 1}}), Front{1});
}

TEST(ParetoFront, EqualPointsStandTogether) {
  EXPECT_EQ(pareto_front(CostsAndErrors{{1, 1}, {2, 2}, {1, 1}}), (Front{0, 2}));
}

TEST(ParetoFront, IgnoresWhatIsNotFinite) {
  EXPECT_EQ(
      pareto_front(CostsAndErrors{{kNan, 0}, {0, kNan}, {-HUGE_VAL, 0}, {2, 1}, {1, HUGE_VAL}}),
      Front{3});
}

TEST(ParetoFront, FreePointsCount) {
  EXPECT_EQ(pareto_front(CostsAndErrors{{0, 3}, {0, 2}, {1, 1}}), (Front{1, 2}));
}

std::vector<std::string> lines_of(const std::string& text) {
  std::istringstream in(text);
  std::vector<std::string> out;
  for (std::string line; std::getline(in, line);) out.push_back(line);
  return out;
}

TEST(ChartCsv, HeaderNamesUnitsAndRowsMatchIt) {
  ChartPoint p;
  p.environment = "room";
  p.mesh = "knot";
  p.method = "SH";
  p.coefficients = 25;
  p.sampling = 16;
  p.object_samples = 4;
  p.object_rel_rmse = .0125;
  p.ms_p50 = .25;
  p.bytes = 12345678901;
  p.chosen = true;
  const auto lines = lines_of(chart_csv(std::vector{p}));
  ASSERT_EQ(lines.size(), 2u);
  for (const char* name : {"object_rel_rmse", "light_update_p50_ms", "light_update_p99_ms",
                           "memory_bytes", "map_size_px", "updates_per_frame"})
    EXPECT_NE(lines[0].find(name), std::string::npos) << name;
  EXPECT_EQ(std::ranges::count(lines[0], ','), std::ranges::count(lines[1], ','));
  // Neither penumbra error nor flicker has been measured.
  EXPECT_EQ(lines[1],
            "room,knot,SH,0,25,0,0,16,4,0,0,0,1,0.0125,0,0,0,,0,,0.25,0,12345678901,1,0,0,,");
}

TEST(ChartCsv, QuotesOnlyWhatNeedsIt) {
  ChartPoint p;
  p.environment = "hall, \"north\"";
  p.mesh = "two\nlines";
  p.method = "plain_name";
  const std::string csv = chart_csv(std::vector{p});
  EXPECT_NE(csv.find("\n\"hall, \"\"north\"\"\",\"two\nlines\",plain_name,0,"), std::string::npos)
      << csv;
}

TEST(ChartJson, HasTheTablesColumns) {
  ChartPoint p;
  p.method = "SH, \"25\"";
  p.chosen = true;
  p.map_size = 256;
  p.ms_p50 = .25;
  const auto rows = chart_json(std::vector{p});
  ASSERT_EQ(rows.size(), 1u);
  std::string header;
  for (const auto& [column, cell] : rows[0].items()) header += (header.empty() ? "" : ",") + column;
  EXPECT_EQ(header, lines_of(chart_csv(std::vector{p}))[0]);
  EXPECT_EQ(rows[0]["method"], p.method);
  EXPECT_EQ(rows[0]["chosen"], true);
  EXPECT_EQ(rows[0]["map_size_px"], 256);
  EXPECT_EQ(rows[0]["light_update_p50_ms"], .25);
  EXPECT_EQ(rows[0]["penumbra_rel_error"].dump(), "null");
  EXPECT_TRUE(chart_json({}).empty());
}

TEST(GnuplotQuoted, LeavesNothingToSubstitute) {
  EXPECT_EQ(gnuplot_quoted("a'b\n`c` \\ @d \"e\""), "'a''b `c` \\ @d \"e\"'");
  EXPECT_EQ(gnuplot_quoted("K\xc3\xb6ln\x7f"), "'K?ln '");
}

TEST(GnuplotBlock, NoRowEndsItOrIsRun) {
  EXPECT_EQ(gnuplot_block("data", "1,2\nEND_OF_BLOCK\n`id`,3"),
            "$data << END_OF_BLOCK\n1,2\n?END_OF_BLOCK\n?id?,3\nEND_OF_BLOCK\n");
  EXPECT_EQ(gnuplot_cell("a\"b\n`c` 'd'"), "\"a?b ?c? 'd'\"");
}

// PATH for the length of a test.
class ScopedPath {
 public:
  explicit ScopedPath(const std::string& path) : before_(std::getenv("PATH")) {
    ::setenv("PATH", path.c_str(), 1);
  }
  ~ScopedPath() { ::setenv("PATH", before_.c_str(), 1); }
  ScopedPath(const ScopedPath&) = delete;
  ScopedPath& operator=(const ScopedPath&) = delete;

 private:
  std::string before_;
};

class ChartPlots : public testing::Test {
 protected:
  static ChartPoint point(const std::string& environment, const std::string& method, bool baseline,
                          double ms, double error) {
    ChartPoint p;
    p.environment = environment;
    p.mesh = "knot";
    p.method = method;
    p.baseline = baseline;
    p.ms_p50 = ms;
    p.shadow_rmse = error;
    p.object_rel_rmse = .5 * error;
    return p;
  }
  static std::vector<ChartPoint> points(const std::vector<std::string>& environments) {
    std::vector<ChartPoint> out;
    for (const std::string& e : environments) {
      for (std::size_t i = 0; i < kBaselines.size(); ++i)
        out.push_back(point(e, kBaselines[i], true, i == 0 ? 0 : .01 * static_cast<double>(i * i),
                            .3 / static_cast<double>(i + 1)));
      for (int c : {4, 9, 25}) {
        out.push_back(point(e, "SH_and_discs", false, .01 * c, .2 / c));
        out.back().coefficients = c;
        out.back().chosen = c == 9;
      }
    }
    return out;
  }
  Result<void> write(const std::vector<ChartPoint>& points) {
    return write_chart_plots(folder(), points);
  }
  fs::path folder() const { return temp_.path() / "plots"; }
  std::vector<std::string> files() const {
    std::vector<std::string> out;
    for (const auto& entry : fs::directory_iterator(folder()))
      out.push_back(entry.path().filename().string());
    std::ranges::sort(out);
    return out;
  }
  std::string text_of(const std::string& name) const {
    const auto bytes = read_bytes(folder() / name);
    return bytes ? std::string(bytes->begin(), bytes->end()) : std::string();
  }
  void install_fake_gnuplot(const std::string& body) const {
    const fs::path program = temp_.path() / "gnuplot";
    std::ofstream(program) << "#!/bin/sh\n" << body;
    fs::permissions(program, fs::perms::owner_all);
  }
  static bool unavailable(const Result<void>& result) {
    return !result && result.error().code == ErrorCode::kUnavailable;
  }

  static inline const std::vector<std::string> kBaselines{
      "no shadow", "ambient + one_hard_light", "unshadowed SH9", "16 lights", "<64> & lights"};
  test::TempFolder temp_;
};

TEST_F(ChartPlots, ShowEveryEnvironmentAndNameEveryBaseline) {
  const auto written = write(points({"room", "clear-sky_2k"}));
  if (unavailable(written)) GTEST_SKIP() << written.error().detail;
  ASSERT_TRUE(written) << written.error().detail;
  EXPECT_EQ(files(), (std::vector<std::string>{"error-time-clear-sky_2k.svg", "error-time-room.svg",
                                               "error-time.svg"}));
  for (const std::string& file : files()) {
    const std::string svg = text_of(file);
    EXPECT_NE(svg.find("</svg>"), std::string::npos);
    for (const char* label : {"no shadow", "ambient + one_hard_light", "unshadowed SH9",
                              "16 lights", "&lt;64&gt; &amp; lights", "Pareto front", "(ms)",
                              "9 SH", "relative RMSE (%)", "stand at 0"})
      // gnuplot may leave '>' as it is, which XML allows.
      EXPECT_TRUE(svg.find(label) != std::string::npos ||
                  (label[0] == '&' && svg.find("&lt;64> &amp; lights") != std::string::npos))
          << file << ": " << label;
  }
  EXPECT_NE(text_of("error-time.svg").find("2 environments"), std::string::npos);
  EXPECT_NE(text_of("error-time-room.svg").find("room"), std::string::npos);
}

TEST_F(ChartPlots, HostileNamesDoNoHarm) {
  const std::string harm = (temp_.path() / "harm").string();
  const std::string name = "a'; system \"touch " + harm + "\"; '\n`touch " + harm + "`";
  auto all = points({name, "../../a b", "../../a:b", ""});
  all[0].method = name;
  const auto written = write(all);
  if (unavailable(written)) GTEST_SKIP() << written.error().detail;
  ASSERT_TRUE(written) << written.error().detail;
  EXPECT_FALSE(fs::exists(harm));
  const auto names = files();
  EXPECT_EQ(names.size(), 5u);
  EXPECT_TRUE(std::ranges::count(names, "error-time-..-..-a-b.svg"));
  EXPECT_TRUE(std::ranges::count(names, "error-time-..-..-a-b-2.svg"));
  EXPECT_TRUE(std::ranges::count(names, "error-time-unnamed.svg"));
  for (const std::string& n : names)
    EXPECT_EQ(n.find_first_of(" '\"`;\n/"), std::string::npos) << n;
  EXPECT_EQ(std::distance(fs::directory_iterator(temp_.path()), fs::directory_iterator()), 1);
}

TEST_F(ChartPlots, AreMadeOfWhatWasMeasured) {
  auto all = points({"room"});
  for (ChartPoint& p : all) p.shadow_rmse = kNan;
  all[1].ms_p50 = kNan;
  all[2].object_rel_rmse = 0;
  const auto written = write(all);
  if (unavailable(written)) GTEST_SKIP() << written.error().detail;
  ASSERT_TRUE(written) << written.error().detail;
  EXPECT_NE(text_of("error-time.svg").find("not measured"), std::string::npos);
}

// Without a measured error there is no label beside a point: the legend alone names them.
TEST_F(ChartPlots, LegendNamesManyBaselines) {
  std::vector<ChartPoint> all;
  for (int i = 0; i < 20; ++i)
    all.push_back(point("room", "baseline number " + std::to_string(i) + ".", true, i, kNan));
  const auto written = write(all);
  if (unavailable(written)) GTEST_SKIP() << written.error().detail;
  ASSERT_TRUE(written) << written.error().detail;
  const std::string svg = text_of("error-time.svg");
  for (const ChartPoint& p : all) EXPECT_NE(svg.find(p.method), std::string::npos) << p.method;
}

TEST_F(ChartPlots, NoPointsIsAnError) {
  EXPECT_EQ(write({}).error().code, ErrorCode::kInvalid);
  EXPECT_FALSE(fs::exists(folder()));
}

TEST_F(ChartPlots, WithoutGnuplotNameThePackage) {
  const ScopedPath path(temp_.path().string());
  const auto written = write(points({"room"}));
  ASSERT_TRUE(unavailable(written));
  EXPECT_NE(written.error().detail.find("gnuplot-nox"), std::string::npos);
  EXPECT_TRUE(files().empty());
}

TEST_F(ChartPlots, FailureOfGnuplotLeavesNoFile) {
  install_fake_gnuplot("echo '<svg>'\necho 'line 3: no such terminal' >&2\nexit 1\n");
  const ScopedPath path(temp_.path().string() + ":" + std::getenv("PATH"));
  const auto written = write(points({"room"}));
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kUnwritable);
  EXPECT_NE(written.error().detail.find("no such terminal"), std::string::npos);
  EXPECT_TRUE(files().empty());
}

TEST_F(ChartPlots, SilenceOfGnuplotIsAnError) {
  install_fake_gnuplot("exit 0\n");
  const ScopedPath path(temp_.path().string() + ":" + std::getenv("PATH"));
  EXPECT_EQ(write(points({"room"})).error().code, ErrorCode::kUnwritable);
  EXPECT_TRUE(files().empty());
}

TEST_F(ChartPlots, FolderThatCannotBeMadeIsAnError) {
  std::ofstream(folder()) << "a file is in the way";
  EXPECT_EQ(write(points({"room"})).error().code, ErrorCode::kUnwritable);
}

}  // namespace
}  // namespace penumbra::tools
