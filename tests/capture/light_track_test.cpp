#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <random>

#include "calib/calib.h"
#include "capture/capture.h"
#include "capture/recording/internal/map_coding.h"
#include "capture/recording/undamaged_frames.h"
#include "core/conventions.h"
#include "tests/support/irradiance.h"
#include "tests/support/temp_folder.h"

namespace penumbra::capture {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

constexpr int kTrackRows = 64, kTrackMaps = 70;  // more than two from key to key

CameraInfo light_track(int rows = kTrackRows) {
  CameraInfo out;
  out.name = "light";
  out.gives_maps = true;
  out.projection = *calib::make_projection(calib::ProjectionKind::kLatLong, 2 * rows, rows);
  out.response = calib::Response::linear();
  return out;
}

// As cameras measure it: with noise, and where nothing looks, nothing.
Environment measured_map(const Image<Rgb>& truth, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> noise(1, .02f);
  Environment out;
  out.radiance = truth;
  out.confidence = Image<float>(truth.width(), truth.height(), 1);
  for (int y = 0; y < truth.height(); ++y)
    for (int x = 0; x < truth.width(); ++x) {
      Rgb& p = out.radiance.at(x, y);
      for (int c = 0; c < 3; ++c) p[c] *= noise(random);
      if (y < truth.height() * 7 / 8) continue;
      out.confidence.at(x, y) = y < truth.height() * 15 / 16 ? .5f : 0;
      if (out.confidence.at(x, y) == 0) p = {};
    }
  return out;
}

Frame map_frame(Environment map, std::uint64_t number, int camera = 0) {
  Frame out{.camera = camera,
            .sequence = number,
            .time = TimestampNs{1'700'000'000'000'000'000} + Seconds(.1 * double(number)),
            .exposure = {Seconds(1), Gain(1)},
            .world_from_camera = {},
            .pixels = {}};
  map.time = out.time;
  out.map = std::make_shared<const Environment>(std::move(map));
  return out;
}

// CRC-32 as zlib has it, bit by bit.
std::string crc_of(const std::string& text) {
  std::uint32_t crc = 0xffffffffu;
  for (const unsigned char c : text) {
    crc ^= c;
    for (int k = 0; k < 8; ++k) crc = crc >> 1 ^ (crc & 1 ? 0xedb88320u : 0);
  }
  char out[9];
  std::snprintf(out, sizeof out, "%08x", ~crc);
  return out;
}

std::vector<Frame> track_of(const Image<Rgb>& truth, int count = kTrackMaps) {
  std::vector<Frame> out;
  for (int i = 0; i < count; ++i)
    out.push_back(map_frame(measured_map(truth, static_cast<std::uint32_t>(i)),
                            static_cast<std::uint64_t>(i)));
  return out;
}

class LightTrack : public testing::Test {
 protected:
  void write(const std::vector<Frame>& frames, std::vector<CameraInfo> cameras,
             const std::vector<Coding>& codings) {
    auto writer = RecordingWriter::create(path(), std::move(cameras), codings, 10);
    ASSERT_TRUE(writer) << writer.error().where << " " << writer.error().detail;
    const std::uint64_t head = writer->bytes();
    for (const Frame& f : frames) {
      const auto written = writer->write(f);
      ASSERT_TRUE(written) << written.error().where << " " << written.error().detail;
    }
    bytes_per_map_ = double(writer->bytes() - head) / double(frames.size());
    ASSERT_TRUE(writer->finish());
  }
  void write(const std::vector<Frame>& maps, int rows = kTrackRows) {
    write(maps, {light_track(rows)}, {Coding::kMap});
  }
  std::vector<Frame> read(int* damaged = nullptr) {
    std::vector<Frame> out;
    auto source = open_recording(path(), RecordedLight::kTrack);
    if (!source) ADD_FAILURE() << source.error().where << " " << source.error().detail;
    while (source) {
      auto next = (*source)->next();
      if (!next && damaged)
        ++*damaged;
      else if (!next)
        ADD_FAILURE() << next.error().where << " " << next.error().detail;
      else if (!*next)
        break;
      else
        out.push_back(std::move(**next));
      if (!next && !damaged) break;
    }
    return out;
  }
  fs::path path() const { return folder_.path() / "light.mkv"; }

  test::TempFolder folder_;
  double bytes_per_map_ = 0;
};

// A coder's own error in a sun of a few pixels would be one of all light: they are kept apart. With
// them in the picture the sky's irradiance is off by several percent.
TEST_F(LightTrack, LightComesBackInAHundredthOfTheBytes) {
  for (const bool sky : {false, true}) {
    const Image<Rgb> truth = sky ? make_sky_environment(2 * kTrackRows, kTrackRows, .6)
                                 : make_room_environment(2 * kTrackRows, kTrackRows);
    const auto maps = track_of(truth);
    fs::remove(path());
    write(maps);
    constexpr double kFloats = 12. * 2 * kTrackRows * kTrackRows;
    EXPECT_LT(bytes_per_map_, kFloats / 100) << sky;
    const auto back = read();
    ASSERT_EQ(back.size(), maps.size()) << sky;
    double worst = 0;
    for (std::size_t i = 0; i < maps.size(); i += 7)
      worst = std::max(worst, test::irradiance_error(back[i].map->radiance, maps[i].map->radiance));
    EXPECT_LT(worst, .01) << sky;
    RecordProperty(sky ? "sky_error" : "room_error", std::to_string(worst));
    RecordProperty(sky ? "sky_bytes" : "room_bytes", std::to_string(bytes_per_map_));
  }
}

TEST_F(LightTrack, WhatWasSeenAndWhatIsALowerBoundComesBackExactly) {
  auto maps = track_of(make_room_environment(2 * kTrackRows, kTrackRows), 3);
  Environment clipped = *maps[1].map;
  clipped.clipped = {5, 700, 701};
  maps[1] = map_frame(clipped, 1);
  Environment whole = *maps[2].map;
  whole.confidence = {};
  maps[2] = map_frame(whole, 2);
  write(maps);
  const auto back = read();
  ASSERT_EQ(back.size(), maps.size());
  for (std::size_t i = 0; i < back.size(); ++i) {
    EXPECT_FALSE(back[i].pixels) << i;
    EXPECT_EQ(back[i].time, maps[i].time) << i;
    EXPECT_EQ(back[i].map->time, maps[i].time) << i;
    EXPECT_EQ(back[i].map->clipped, maps[i].map->clipped) << i;
  }
  EXPECT_TRUE(back[2].map->confidence.empty());
  const Image<float>& seen = back[0].map->confidence;
  for (std::size_t i = 0; i < seen.area(); ++i)
    EXPECT_NEAR(seen.pixels()[i], maps[0].map->confidence.pixels()[i], 1. / 254) << i;
  for (int x = 0; x < 2 * kTrackRows; ++x)
    EXPECT_EQ(back[0].map->radiance.at(x, kTrackRows - 1), Rgb{});
  const double solid = latlong_solid_angle(0, 2 * kTrackRows, kTrackRows) +
                       2 * latlong_solid_angle(700 / (2 * kTrackRows), 2 * kTrackRows, kTrackRows);
  EXPECT_NEAR(back[1].map->clipped_fraction, solid / (4 * kPi), 1e-9);
}

// The scale follows the light, from the day into the night and back.
TEST_F(LightTrack, ADarkNightIsKeptAsWellAsADay) {
  const Image<Rgb> room = make_room_environment(2 * kTrackRows, kTrackRows);
  std::vector<Frame> maps;
  constexpr int kMaps = 120;
  for (int i = 0; i < kMaps; ++i) {
    Environment map = measured_map(room, static_cast<std::uint32_t>(i));
    const float stops = -12 * std::sin(float(kPi) * static_cast<float>(i) / kMaps);
    for (Rgb& p : map.radiance.pixels()) p = p * std::exp2(stops);
    maps.push_back(map_frame(std::move(map), static_cast<std::uint64_t>(i)));
  }
  write(maps);
  const auto back = read();
  ASSERT_EQ(back.size(), maps.size());
  for (std::size_t i = 0; i < maps.size(); i += 9)
    EXPECT_LT(test::irradiance_error(back[i].map->radiance, maps[i].map->radiance), .015) << i;
}

TEST_F(LightTrack, BlackMapsAndNoNumbersAreKept) {
  Environment black;
  black.radiance = Image<Rgb>(2 * kTrackRows, kTrackRows);
  Environment bad = black;
  bad.radiance.at(3, 3) = {NAN, INFINITY, -1};
  write({map_frame(black, 0), map_frame(bad, 1), map_frame(black, 2)});
  const auto back = read();
  ASSERT_EQ(back.size(), 3u);
  for (const Frame& f : back)
    for (const Rgb& p : f.map->radiance.pixels())
      for (int c = 0; c < 3; ++c) {
        EXPECT_TRUE(std::isfinite(p[c]));
        EXPECT_GE(p[c], 0);
      }
  EXPECT_NEAR(back[0].map->black_fraction, 1, 1e-6);
}

// A camera's colour matrix makes negative channels of saturated lamps.
TEST_F(LightTrack, NegativeChannelsOfALampAreNone) {
  Environment map = measured_map(make_room_environment(2 * kTrackRows, kTrackRows), 1);
  map.radiance.at(40, 20) = {-300, -26, 5000};
  map.radiance.at(41, 20) = {-.1f, .5f, .5f};
  write({map_frame(map, 0)});
  const auto back = read();
  ASSERT_EQ(back.size(), 1u);
  EXPECT_EQ(back[0].map->radiance.at(40, 20).r, 0);
  EXPECT_NEAR(back[0].map->radiance.at(40, 20).b, 5000, 1);
}

// A random reader begins at any key map: light and mask stand alone there.
TEST_F(LightTrack, KeyMapsStandAlone) {
  const auto maps = track_of(make_room_environment(2 * kTrackRows, kTrackRows));
  write(maps);
  std::string bytes(fs::file_size(path()), '\0');
  std::ifstream(path(), std::ios::binary)
      .read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  // Map 5's label names another map, so nothing comes until the key map 30.
  const auto at = bytes.find("light/5,");
  ASSERT_NE(at, std::string::npos);
  bytes[at + 6] = '7';
  std::ofstream(path(), std::ios::binary | std::ios::trunc) << bytes;
  int damaged = 0;
  const auto back = read(&damaged);
  EXPECT_EQ(damaged, 2) << "its label, and once that maps build on what is missing";
  ASSERT_EQ(back.size(), maps.size() - 25);
  EXPECT_EQ(back[4].time, maps[4].time);
  EXPECT_EQ(back[5].time, maps[30].time);
  EXPECT_LT(test::irradiance_error(back[5].map->radiance, maps[30].map->radiance), .015);
}

// Of hours one wants the minute that one asks for.
TEST_F(LightTrack, AReplayBeginsAnywhere) {
  const auto maps = track_of(make_room_environment(2 * kTrackRows, kTrackRows), 95);
  write(maps);
  auto source = open_recording(path(), RecordedLight::kTrack, Seconds(8.55));
  ASSERT_TRUE(source) << source.error().detail;
  const auto first = (*source)->next();
  ASSERT_TRUE(first && *first);
  // The key map two seconds before at least.
  EXPECT_EQ((*first)->time, maps[60].time);
  EXPECT_LT(test::irradiance_error((*first)->map->radiance, maps[60].map->radiance), .015);
  EXPECT_FALSE(open_recording(path(), RecordedLight::kTrack, Seconds(-1)));
  auto behind = open_recording(path(), RecordedLight::kTrack, Seconds(1e6));
  ASSERT_TRUE(behind);
  const auto last = (*behind)->next();
  EXPECT_TRUE(last);
}

// Without an index, as a killed writer leaves it; with a track that begins late; in the middle.
TEST_F(LightTrack, PicturesBeginWhereTheyAreAskedFor) {
  CameraInfo view;
  view.name = "view";
  view.role = Role::kView;
  view.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 32, 16);
  view.response = calib::Response::srgb();
  const auto map = measured_map(make_room_environment(2 * kTrackRows, kTrackRows), 1);
  const std::vector codings{Coding::kRgb8, Coding::kMap};
  for (const int first_map : {0, 5, 60}) {
    for (const bool killed : {false, true}) {
      fs::remove(path());
      {
        auto writer = *RecordingWriter::create(path(), {view, light_track()}, codings, 10);
        for (int i = 0; i < 90; ++i) {
          const TimestampNs time = TimestampNs{5'000'000'000} + Seconds(i / 10.);
          if (i >= first_map) {
            Frame light = map_frame(map, 0, 1);
            light.time = time;
            ASSERT_TRUE(writer.write(light));
          }
          ASSERT_TRUE(writer.write(
              {0,
               static_cast<std::uint64_t>(i),
               time,
               {Seconds(.01), Gain(1)},
               {},
               std::make_shared<const FramePixels>(Image<Rgb8>(32, 16, Rgb8{9, 9, 9}))}));
        }
        if (!killed) {
          ASSERT_TRUE(writer.finish());
        }
      }
      for (const double from : {.3, 2.2, 7.9}) {
        auto source = open_recording(path(), RecordedLight::kTrack, Seconds(from));
        ASSERT_TRUE(source) << source.error().detail;
        std::vector<std::uint64_t> views;
        std::size_t maps_before = 0;
        for (;;) {
          const auto frame = (*source)->next();
          ASSERT_TRUE(frame) << frame.error().detail;
          if (!*frame) break;
          if ((*frame)->camera == 0) views.push_back((*frame)->sequence);
          maps_before += views.empty();
        }
        ASSERT_FALSE(views.empty()) << first_map << killed << from;
        EXPECT_EQ(views.front(), std::lround(10 * from)) << first_map << killed;
        EXPECT_EQ(views.back(), 89u);
        EXPECT_EQ(views.size(), 90 - views.front());
        EXPECT_EQ(maps_before > 0, first_map <= 10 * from) << first_map << killed << from;
      }
    }
  }
}

TEST_F(LightTrack, LabelsThatNoWriterWritesAreRefused) {
  const auto maps = track_of(make_room_environment(2 * kTrackRows, kTrackRows), 2);
  write(maps);
  std::string whole(fs::file_size(path()), '\0');
  std::ifstream(path(), std::ios::binary)
      .read(whole.data(), static_cast<std::streamsize>(whole.size()));
  const auto label = whole.find("light/0,"), gain = whole.find(';', label),
             codes = whole.find(';', gain + 1);
  ASSERT_NE(gain, std::string::npos);
  const auto refused_with = [&](std::size_t from, std::string_view bad) {
    std::string bytes = whole;
    bytes.replace(from, bad.size(), bad);
    // With its right checksum: what it says is looked at.
    const auto end = whole.find(';', codes + 1);
    bytes.replace(end + 1, 8, crc_of(bytes.substr(label, end - label)));
    std::ofstream(path(), std::ios::binary | std::ios::trunc) << bytes;
    const auto source = open_recording(path(), RecordedLight::kTrack);
    return source && !(*source)->next();
  };
  EXPECT_FALSE(refused_with(label, "light/0,"));
  EXPECT_TRUE(refused_with(gain, ";9"));     // a gain of 9
  EXPECT_TRUE(refused_with(gain, ";-"));     // a negative one
  EXPECT_TRUE(refused_with(gain, "; nan"));  // none
  EXPECT_TRUE(refused_with(gain, ",,"));     // a row that is none
  EXPECT_TRUE(refused_with(codes, ";g"));    // a sum that is no number
  EXPECT_TRUE(refused_with(codes, ";+"));
}

// What a killed writer left ends with the last whole map.
TEST_F(LightTrack, CutAnywhereItEndsEarlier) {
  const auto maps = track_of(make_room_environment(2 * kTrackRows, kTrackRows));
  write(maps);
  const auto size = fs::file_size(path());
  std::size_t before = maps.size();
  for (int k = 19; k > 10; --k) {
    fs::resize_file(path(), size * static_cast<std::uintmax_t>(k) / 20);
    const auto back = read();
    EXPECT_LE(back.size(), before);
    before = back.size();
    for (std::size_t i = 0; i < back.size(); ++i) EXPECT_EQ(back[i].time, maps[i].time);
  }
  EXPECT_LT(before, maps.size());
  EXPECT_GT(before, 0u);
}

// A map that builds on a damaged one would be wrong without a word: nothing comes until the next
// key, and every map that comes is right.
TEST_F(LightTrack, DamageCostsMapsUpToTheNextKey) {
  const Image<Rgb> truth = make_room_environment(2 * kTrackRows, kTrackRows);
  auto maps = track_of(truth);
  // What is seen changes, too: a mask of another map would be as wrong.
  for (std::size_t i = 0; i < maps.size(); ++i) {
    Environment map = *maps[i].map;
    map.clipped = {static_cast<std::uint32_t>(100 + i)};
    maps[i] = map_frame(std::move(map), i);
  }
  write(maps);
  std::string whole(fs::file_size(path()), '\0');
  std::ifstream(path(), std::ios::binary)
      .read(whole.data(), static_cast<std::streamsize>(whole.size()));
  std::mt19937 random(4);
  std::size_t lost = 0;
  for (int turn = 0; turn < 6; ++turn) {
    std::string bad = whole;
    for (int k = 0; k < 40; ++k)  // somewhere behind the head: a few packets
      bad[bad.size() / 8 + (random() % (bad.size() / 16)) +
          static_cast<std::size_t>(turn) * bad.size() / 10] ^= 0x5a;
    std::ofstream(path(), std::ios::binary | std::ios::trunc) << bad;
    int damaged = 0;
    const auto back = read(&damaged);
    EXPECT_LE(back.size(), maps.size());
    // Programs go on over it, and count.
    auto whole_ones = UndamagedFrames::open(path(), RecordedLight::kBoth);
    ASSERT_TRUE(whole_ones) << whole_ones.error().detail;
    std::size_t taken = 0;
    for (auto f = (*whole_ones)->next(); f && *f; f = (*whole_ones)->next()) ++taken;
    EXPECT_EQ(taken, back.size());
    EXPECT_EQ((*whole_ones)->left_out(), static_cast<std::uint64_t>(damaged));
    lost += maps.size() - back.size();
    for (const Frame& f : back) {
      const auto n = static_cast<std::size_t>(std::lround((f.time - maps[0].time).count() / .1));
      ASSERT_LT(n, maps.size());
      EXPECT_EQ(f.map->clipped, maps[n].map->clipped) << turn << " " << n;
      EXPECT_LT(test::irradiance_error(f.map->radiance, maps[n].map->radiance), .02)
          << turn << " " << n;
    }
  }
  EXPECT_GT(lost, 6u);
}

struct ParametersFreed {
  void operator()(AVCodecParameters* p) const { avcodec_parameters_free(&p); }
};
struct PacketFreed {
  void operator()(AVPacket* p) const { av_packet_free(&p); }
};

Result<MapDecoder> decoder_of(const MapEncoder& encoder) {
  const auto parameters_of = [](const AVCodecContext& coder) {
    std::unique_ptr<AVCodecParameters, ParametersFreed> out(avcodec_parameters_alloc());
    avcodec_parameters_from_context(out.get(), &coder);
    return out;
  };
  const auto light = parameters_of(encoder.light()), seen = parameters_of(encoder.seen());
  return MapDecoder::open(*light, *seen);
}

TEST(MapLabel, HoldsTheSumOrNone) {
  MapLabel label{.exposure = 2, .gain = {1, 1.01f, 1}, .peaks = {{7, {3, 2, 1}}}};
  for (const auto& codes : {std::optional<std::uint64_t>(), std::optional<std::uint64_t>(0xabcd)}) {
    label.codes = codes;
    const std::string text = print_map_label("light/1,0", label);
    const auto parts = split_map_label(text);
    ASSERT_TRUE(parts) << text;
    const auto back = parse_map_label(parts->rest, 2);
    ASSERT_TRUE(back) << text;
    EXPECT_EQ(back->codes, codes) << text;
    ASSERT_EQ(back->peaks.size(), 1u) << text;
    EXPECT_EQ(back->peaks[0].pixel, 7u);
  }
}

// FFmpeg's decoder makes a picture of most damaged packets, and says nothing.
TEST(MapDecoder, ADamagedByteOfTheLightIsFoundOrChangesNothing) {
  auto encoder = MapEncoder::create(2 * kTrackRows, kTrackRows, true);
  ASSERT_TRUE(encoder) << encoder.error().detail;
  auto decoder = decoder_of(*encoder);
  ASSERT_TRUE(decoder) << decoder.error().detail;
  const std::unique_ptr<AVPacket, PacketFreed> light(av_packet_alloc()), seen(av_packet_alloc());
  const Environment map = measured_map(make_room_environment(2 * kTrackRows, kTrackRows), 1);
  const auto label = encoder->code(map, *light, *seen);
  ASSERT_TRUE(label) << label.error().detail;
  ASSERT_TRUE(label->codes);
  MapLabel without_sum = *label;
  without_sum.codes.reset();
  const auto whole = decoder->decode(*light, *seen, *label);
  ASSERT_TRUE(whole) << whole.error().detail;
  int wrong = 0, passed_without_sum = 0;
  const auto differs = [&](const Result<Environment>& back) {
    return back && !std::ranges::equal(back->radiance.pixels(), whole->radiance.pixels());
  };
  for (int i = 0; i < light->size; i += 3) {
    light->data[i] ^= 0x10;
    wrong += differs(decoder->decode(*light, *seen, *label));
    passed_without_sum += differs(decoder->decode(*light, *seen, without_sum));
    light->data[i] ^= 0x10;
  }
  EXPECT_EQ(wrong, 0);
  EXPECT_GT(passed_without_sum, light->size / 12) << "the sum is not needed?";
}

// FFV1 takes 78 MB for each packet of 1024 x 512 pixels. What was seen changes seldom.
TEST(MapEncoder, WhatWasSeenIsCodedAnewWhereItHasChanged) {
  auto encoder = MapEncoder::create(2 * kTrackRows, kTrackRows, true);
  ASSERT_TRUE(encoder) << encoder.error().detail;
  auto decoder = decoder_of(*encoder);
  ASSERT_TRUE(decoder) << decoder.error().detail;
  Environment map = measured_map(make_room_environment(2 * kTrackRows, kTrackRows), 1);
  std::unique_ptr<AVPacket, PacketFreed> last;  // kept, so that its place is not taken anew
  for (const auto& clipped : std::vector<std::vector<std::uint32_t>>{{}, {}, {700}, {700}, {}}) {
    const std::unique_ptr<AVPacket, PacketFreed> light(av_packet_alloc());
    std::unique_ptr<AVPacket, PacketFreed> seen(av_packet_alloc());
    const bool as_before = last && clipped == map.clipped;
    map.clipped = clipped;
    const auto label = encoder->code(map, *light, *seen);
    ASSERT_TRUE(label) << label.error().detail;
    EXPECT_EQ(last && seen->data == last->data, as_before);
    EXPECT_TRUE(seen->flags & AV_PKT_FLAG_KEY);
    const auto back = decoder->decode(*light, *seen, *label);
    ASSERT_TRUE(back) << back.error().detail;
    EXPECT_EQ(back->clipped, clipped);
    last = std::move(seen);
  }
}

// FFmpeg's decoder shows the last map's pixels where a checksum is wrong: what is clipped would be
// that of another map.
TEST(MapDecoder, AnyDamagedByteOfWhatWasSeenIsFound) {
  auto encoder = MapEncoder::create(2 * kTrackRows, kTrackRows, true);
  ASSERT_TRUE(encoder) << encoder.error().detail;
  auto decoder = decoder_of(*encoder);
  ASSERT_TRUE(decoder) << decoder.error().detail;
  const std::unique_ptr<AVPacket, PacketFreed> light(av_packet_alloc()), seen(av_packet_alloc());
  Environment map = measured_map(make_room_environment(2 * kTrackRows, kTrackRows), 1);
  map.clipped = {700, 701, 2000};
  const auto label = encoder->code(map, *light, *seen);
  ASSERT_TRUE(label) << label.error().detail;
  const auto whole = decoder->decode(*light, *seen, *label);
  ASSERT_TRUE(whole) << whole.error().detail;
  EXPECT_EQ(whole->clipped, map.clipped);
  int found = 0;
  for (int i = 0; i < seen->size; ++i) {
    seen->data[i] ^= 0x10;
    found += !decoder->decode(*light, *seen, *label);
    seen->data[i] ^= 0x10;
  }
  EXPECT_GT(seen->size, 40);
  EXPECT_EQ(found, seen->size);
  EXPECT_TRUE(decoder->decode(*light, *seen, *label)) << "what is whole is read again";
}

TEST_F(LightTrack, AReplayTakesWhatIsAskedFor) {
  CameraInfo view;
  view.name = "view";
  view.role = Role::kView;
  view.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 32, 16);
  view.response = calib::Response::srgb();
  view.ball = Ball{Ball::OutlinePixels{{16, 8}, 4}, {0, 0, 0}, 0};
  CameraInfo fisheye = view;
  fisheye.name = "fisheye";
  fisheye.role = Role::kEnvironment;
  fisheye.ball.reset();
  fisheye.projection = *calib::make_projection(calib::ProjectionKind::kEquidistant, 32, 32);
  const auto picture = [](int camera, int w, int h, double s) {
    return Frame{camera,
                 0,
                 TimestampNs{0} + Seconds(s),
                 {Seconds(.01), Gain(1)},
                 {},
                 std::make_shared<const FramePixels>(Image<Rgb8>(w, h, Rgb8{9, 9, 9}))};
  };
  Frame map = map_frame(measured_map(make_room_environment(2 * kTrackRows, kTrackRows), 1), 0, 2);
  map.time = TimestampNs{0} + Seconds(.02);
  write({picture(0, 32, 32, 0), picture(1, 32, 16, .01), map}, {fisheye, view, light_track()},
        {Coding::kRgb8, Coding::kRgb8, Coding::kMap});
  const auto names = [&](RecordedLight light) {
    std::string out;
    auto source = *open_capture(path(), light);
    for (const CameraInfo& c : source->cameras()) out += c.name + (c.ball ? "* " : " ");
    out += ":";
    while (auto f = *source->next())
      out += " " + source->cameras()[static_cast<std::size_t>(f->camera)].name;
    return out;
  };
  EXPECT_EQ(names(RecordedLight::kCameras), "fisheye view* : fisheye view");
  EXPECT_EQ(names(RecordedLight::kTrack), "view light : view light");
  EXPECT_EQ(names(RecordedLight::kEither), "fisheye view* : fisheye view");
  EXPECT_EQ(names(RecordedLight::kBoth), "fisheye view* light : fisheye view light");
}

TEST_F(LightTrack, RefusesWhatItCannotKeep) {
  const std::vector coding{Coding::kMap};
  for (const int rows : {8, 33, 1026}) {
    const auto refused = RecordingWriter::create(path(), {light_track(rows)}, coding, 0);
    ASSERT_FALSE(refused) << rows;
    EXPECT_THAT(refused.error().detail, HasSubstr("16..1024")) << rows;
    EXPECT_FALSE(fs::exists(path())) << rows;
  }
  const std::vector pictures_alone{Coding::kRgb8};
  EXPECT_FALSE(RecordingWriter::create(path(), {light_track()}, pictures_alone, 0));
  CameraInfo camera = light_track();
  camera.gives_maps = false;
  EXPECT_FALSE(RecordingWriter::create(path(), {camera}, coding, 0));
  EXPECT_FALSE(fs::exists(path()));
  auto writer = *RecordingWriter::create(path(), {light_track()}, coding, 0);
  Environment small;
  small.radiance = Image<Rgb>(kTrackRows, kTrackRows / 2);
  ASSERT_TRUE(writer.write(
      map_frame(measured_map(make_room_environment(2 * kTrackRows, kTrackRows), 1), 0)));
  const auto refused = writer.write(map_frame(small, 1));
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().detail, HasSubstr("64x32"));
  ASSERT_TRUE(writer.finish());
  const auto pictures = open_recording(path());
  ASSERT_FALSE(pictures);
  EXPECT_THAT(pictures.error().detail, HasSubstr("light track alone"));
  auto folder = *CaptureFolderWriter::create(folder_.path() / "folder", {light_track()});
  const auto in_folder = folder.write(
      map_frame(measured_map(make_room_environment(2 * kTrackRows, kTrackRows), 1), 0));
  ASSERT_FALSE(in_folder);
  EXPECT_THAT(in_folder.error().detail, HasSubstr("light track"));
}

}  // namespace
}  // namespace penumbra::capture
