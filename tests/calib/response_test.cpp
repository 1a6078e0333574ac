#include "calib/calib.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>
#include <vector>

#include "tests/support/temp_folder.h"

namespace penumbra::calib {
namespace {

Response curved_table() {
  std::array<std::vector<float>, 3> decode;
  for (int c = 0; c < 3; ++c)
    for (int i = 0; i < 256; ++i)
      decode[static_cast<std::size_t>(c)].push_back(
          static_cast<float>(std::pow(i / 255., 1.8 + .2 * c)));
  auto response = Response::from_table(decode);
  EXPECT_TRUE(response.has_value());
  return response.value_or(Response::linear());
}

std::vector<Response> all_forms() {
  return {Response::linear(), Response::srgb(), Response::gamma(2.2), Response::gamma(.7),
          curved_table()};
}

void write_text(const std::filesystem::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

TEST(Response, WhiteBalanceScalesChannelsBehindTheSensor) {
  for (const Response& plain : all_forms()) {
    const auto r = plain.with_white_balance({4, 2, 3});
    ASSERT_TRUE(r);
    EXPECT_EQ(r->white_balance(), (std::array<double, 3>{2, 1, 1.5})) << "ratios alone";
    EXPECT_FALSE(r->same_for_all_channels());
    EXPECT_FALSE(r->is_linear());
    for (int c = 0; c < 3; ++c) {
      const double gain = r->white_balance()[static_cast<std::size_t>(c)];
      for (const double linear : {.01, .1, .3}) {
        EXPECT_NEAR(r->encode(linear, c), plain.encode(linear * gain, c), 1e-12);
        EXPECT_NEAR(r->decode(r->encode(linear, c), c), linear, 1e-4);
      }
      EXPECT_NEAR(r->encode(1, c), 1, 1e-12) << "what the gain lifts beyond full scale is cut off";
    }
  }
  for (const double bad : {0., -1., std::nan(""), HUGE_VAL})
    EXPECT_FALSE(Response::srgb().with_white_balance({1, bad, 1})) << bad;
}

TEST(Response, EncodeInvertsDecode) {
  for (const Response& r : all_forms())
    for (int channel = 0; channel < 3; ++channel)
      for (int code = 0; code <= 1000; ++code)
        ASSERT_NEAR(r.encode(r.decode(code / 1000., channel), channel), code / 1000., 1e-5)
            << r.describe();
}

TEST(Response, IsMonotoneFromZeroToOne) {
  for (const Response& r : all_forms()) {
    for (const int bits : {8, 16}) {
      const std::vector<float> table = r.decode_table(bits, 1);
      ASSERT_EQ(table.size(), std::size_t{1} << bits);
      EXPECT_EQ(table.front(), 0) << r.describe();
      EXPECT_EQ(table.back(), 1) << r.describe();
      for (std::size_t i = 1; i < table.size(); ++i) ASSERT_GE(table[i], table[i - 1]);
    }
    double last = -1;
    for (int i = 0; i <= 4096; ++i) {
      const double code = r.encode(i / 4096., 0);
      ASSERT_GE(code, last) << r.describe() << " at " << i;
      last = code;
    }
  }
}

TEST(Response, GammaIsAPowerAndSrgbHasItsPublishedValues) {
  EXPECT_NEAR(Response::gamma(2.2).decode(.5, 0), std::pow(.5, 2.2), 1e-15);
  EXPECT_NEAR(Response::gamma(2.2).encode(.18, 2), std::pow(.18, 1 / 2.2), 1e-15);
  EXPECT_NEAR(Response::srgb().decode(.04, 0), .04 / 12.92, 1e-15);
  EXPECT_NEAR(Response::srgb().decode(.5, 0), .21404114, 1e-8);
  EXPECT_NEAR(Response::srgb().encode(.18, 0), .46135613, 1e-8);
}

TEST(Response, ClampsOutsideItsRangeAndKeepsNan) {
  for (const Response& r : all_forms()) {
    EXPECT_DOUBLE_EQ(r.encode(7, 0), 1) << r.describe();
    EXPECT_EQ(r.encode(-7, 0), 0) << r.describe();
    EXPECT_EQ(r.decode(1.5, 0), 1) << r.describe();
    EXPECT_TRUE(std::isnan(r.decode(std::nan(""), 0))) << r.describe();
    EXPECT_TRUE(std::isnan(r.encode(std::nan(""), 0))) << r.describe();
  }
}

TEST(Response, DescribesItself) {
  EXPECT_EQ(Response::linear().describe(), "linear");
  EXPECT_EQ(Response::srgb().describe(), "srgb");
  EXPECT_EQ(Response::gamma(2.2).describe(), "gamma:2.2");
  EXPECT_EQ(curved_table().describe(), "table of 256");
  EXPECT_TRUE(Response::linear().is_linear());
  EXPECT_TRUE(Response::gamma(1).is_linear());
  EXPECT_FALSE(Response::srgb().is_linear());
  EXPECT_TRUE(Response::srgb().same_for_all_channels());
  EXPECT_FALSE(curved_table().same_for_all_channels());
}

TEST(Response, FlatPiecesOfATableSaturateOnlyAtTheTop) {
  const std::vector<float> flat{0, 0, .5f, .5f, 1, 1};
  const auto r = Response::from_table({flat, flat, flat});
  ASSERT_TRUE(r.has_value());
  EXPECT_EQ(r->encode(0, 0), 0);
  EXPECT_NEAR(r->encode(.5, 0), .4, 1e-12);
  EXPECT_EQ(r->encode(1, 0), 1);
  for (const double x : {0., .1, .5, .7, 1.}) EXPECT_NEAR(r->decode(r->encode(x, 0), 0), x, 1e-12);
}

TEST(Response, RefusesBadTables) {
  const std::vector<float> good{0, .5f, 1};
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const std::vector<std::vector<float>> bad{{},          {1},        {0, .5f, .4f},   {0, nan, 1},
                                            {0, .5f, 2}, {-1, 0, 1}, {.5f, .5f, .5f}, {0, 1}};
  for (const auto& table : bad) {
    const auto r = Response::from_table({good, table, good});
    ASSERT_FALSE(r.has_value());
    EXPECT_EQ(r.error().code, ErrorCode::kInvalid);
    EXPECT_FALSE(r.error().detail.empty());
  }
}

TEST(ParseResponse, ReadsTheNamedForms) {
  for (const char* text : {"linear", "srgb", "gamma:2.2", "gamma:1.75"}) {
    const auto r = parse_response(text);
    ASSERT_TRUE(r.has_value()) << text;
    EXPECT_EQ(r->describe(), text);
  }
}

TEST(ParseResponse, RefusesBadNames) {
  for (const char* text :
       {"gamma:", "gamma:x", "gamma:0", "gamma:-2", "gamma:2.2x", "gamma:nan", "gamma:inf", ""}) {
    const auto r = parse_response(text);
    ASSERT_FALSE(r.has_value()) << text;
    EXPECT_EQ(r.error().code, ErrorCode::kInvalid) << text;
  }
  const auto missing = parse_response("no-such-file.toml");
  ASSERT_FALSE(missing.has_value());
  EXPECT_EQ(missing.error().code, ErrorCode::kNotFound);
}

TEST(ParseResponse, FilesRoundTripExactlyForTables) {
  const test::TempFolder folder;
  const Response table = curved_table();
  ASSERT_TRUE(write_response(folder.path() / "r.toml", table).has_value());
  const auto back = parse_response("r.toml", folder.path());
  ASSERT_TRUE(back.has_value()) << back.error().where << ": " << back.error().detail;
  for (int c = 0; c < 3; ++c) EXPECT_EQ(back->decode_table(16, c), table.decode_table(16, c));
}

TEST(ParseResponse, FormulasRoundTripAtEightBitCodes) {
  const test::TempFolder folder;
  for (const Response& r : {Response::linear(), Response::srgb(), Response::gamma(2.2)}) {
    ASSERT_TRUE(write_response(folder.path() / "r.toml", r).has_value());
    const auto back = parse_response("r.toml", folder.path());
    ASSERT_TRUE(back.has_value());
    EXPECT_TRUE(back->same_for_all_channels());
    const auto expected = r.decode_table(8, 0), found = back->decode_table(8, 0);
    for (std::size_t i = 0; i < expected.size(); ++i) ASSERT_NEAR(found[i], expected[i], 1e-7);
  }
}

TEST(ParseResponse, OneListServesAllChannels) {
  const test::TempFolder folder;
  for (const char* decode : {"[0, 0.25, 1]", "[[0, 0.25, 1]]"}) {
    write_text(folder.path() / "r.toml", std::string("version = 1\ndecode = ") + decode + "\n");
    const auto r = parse_response("r.toml", folder.path());
    ASSERT_TRUE(r.has_value());
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(r->decode(.5, c), .25, 1e-7);
  }
}

TEST(ParseResponse, BadFilesNameFileAndLine) {
  struct Case {
    const char* text;
    const char* where;
    const char* reason;
  };
  const test::TempFolder folder;
  for (const Case& c : {
           Case{"version = 1\ndecode = [0, 1]\ncolour = 3\n", "r.toml:3", "unknown key \"colour\""},
           Case{"version = 2\ndecode = [0, 1]\n", "r.toml:1", "version"},
           Case{"version = 1.0\ndecode = [0, 1]\n", "r.toml:1", "version"},
           Case{"decode = [0, 1]\n", "r.toml", "version = 1 is missing"},
           Case{"version = 1\n", "r.toml", "decode is missing"},
           Case{"version = 1\ndecode = 3\n", "r.toml:2", "not a list"},
           Case{"version = 1\ndecode = []\n", "r.toml:2", "0 samples"},
           Case{"version = 1\ndecode = [0, \"1\"]\n", "r.toml:2", "not a number"},
           Case{"version = 1\ndecode = [0, true]\n", "r.toml:2", "not a number"},
           Case{"version = 1\ndecode = [[0, 1], 2, 3]\n", "r.toml:2", "not a list of numbers"},
           Case{"version = 1\ndecode = [[0, 1], [0, 1]]\n", "r.toml:2", "2 lists"},
           Case{"version = 1\ndecode = [1, 0]\n", "r.toml:2", "not monotone"},
           Case{"version = 1\ndecode = [0, nan]\n", "r.toml:2", "within 0..1"},
           Case{"version = 1\ndecode = [0, 1\n", "r.toml:", ""},
       }) {
    write_text(folder.path() / "r.toml", c.text);
    const auto r = parse_response("r.toml", folder.path());
    ASSERT_FALSE(r.has_value()) << c.text;
    EXPECT_NE(r.error().where.find(c.where), std::string::npos) << r.error().where;
    EXPECT_NE(r.error().detail.find(c.reason), std::string::npos) << r.error().detail;
  }
}

TEST(WriteResponse, RefusesAnUnwritablePlace) {
  const test::TempFolder folder;
  const auto written = write_response(folder.path() / "missing" / "r.toml", Response::srgb());
  ASSERT_FALSE(written.has_value());
  EXPECT_EQ(written.error().code, ErrorCode::kUnwritable);
}

}  // namespace
}  // namespace penumbra::calib
