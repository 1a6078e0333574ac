#include <gtest/gtest.h>
#include <png.h>
#include <tiffio.h>
#include <turbojpeg.h>

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "codec/codec.h"
#include "core/io/files.h"
#include "tests/fuzz/mutate.h"
#include "tests/support/shared_data.h"
#include "tests/support/temp_folder.h"

namespace penumbra::codec {
namespace {

using test::TempFolder;
using ByteList = std::vector<unsigned char>;

// A grey PNG of 2 x 1 pixels: 10, 200.
const ByteList kGrey8{0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d,
                      0x49, 0x48, 0x44, 0x52, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01,
                      0x08, 0x00, 0x00, 0x00, 0x00, 0xd1, 0x49, 0x20, 0x56, 0x00, 0x00, 0x00,
                      0x0b, 0x49, 0x44, 0x41, 0x54, 0x78, 0xda, 0x63, 0xe0, 0x3a, 0x01, 0x00,
                      0x00, 0xdf, 0x00, 0xd3, 0xd8, 0x85, 0xd2, 0xae, 0x00, 0x00, 0x00, 0x00,
                      0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82};
// A grey PNG of 2 x 1 pixels in 16 bits: 1000, 60000.
const ByteList kGrey16{0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d,
                       0x49, 0x48, 0x44, 0x52, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01,
                       0x10, 0x00, 0x00, 0x00, 0x00, 0x81, 0xd9, 0xfc, 0x15, 0x00, 0x00, 0x00,
                       0x0d, 0x49, 0x44, 0x41, 0x54, 0x78, 0xda, 0x63, 0x60, 0x7e, 0xf1, 0x2a,
                       0x01, 0x00, 0x04, 0xfd, 0x02, 0x36, 0x68, 0x99, 0xf1, 0xfc, 0x00, 0x00,
                       0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82};
// One pixel: 1, 2, 3, alpha 0.
const ByteList kRgba8{0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d,
                      0x49, 0x48, 0x44, 0x52, 0x00, 0x00, 0x00, 0x01, 0x00, 0x00, 0x00, 0x01,
                      0x08, 0x06, 0x00, 0x00, 0x00, 0x1f, 0x15, 0xc4, 0x89, 0x00, 0x00, 0x00,
                      0x0d, 0x49, 0x44, 0x41, 0x54, 0x78, 0xda, 0x63, 0x60, 0x64, 0x62, 0x66,
                      0x00, 0x00, 0x00, 0x15, 0x00, 0x07, 0xf3, 0xf4, 0x32, 0x5e, 0x00, 0x00,
                      0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82};

Image<Rgb8> ramp8(int width, int height) {
  Image<Rgb8> image(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      image.at(x, y) = {static_cast<std::uint8_t>(x * 7), static_cast<std::uint8_t>(y * 11),
                        static_cast<std::uint8_t>(200 - x)};
  return image;
}

Image<Rgb16> ramp16(int width, int height) {
  Image<Rgb16> image(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      image.at(x, y) = {static_cast<std::uint16_t>(x * 701), static_cast<std::uint16_t>(y * 1103),
                        static_cast<std::uint16_t>(65535 - x)};
  return image;
}

class Frames : public testing::Test {
 protected:
  Result<FramePixels> read(const ByteList& bytes) {
    const auto path = folder_.path() / "frame.bin";
    EXPECT_TRUE(write_bytes(path, {reinterpret_cast<const char*>(bytes.data()), bytes.size()}));
    return read_frame(path);
  }
  ByteList bytes_of(const std::string& name, const auto& image) {
    EXPECT_TRUE(write_frame(folder_.path() / name, image));
    const auto bytes = read_bytes(folder_.path() / name);
    return bytes ? *bytes : ByteList();
  }
  // The picture, or an empty one and a failure.
  template <class Pixel>
  Image<Pixel> expect(const Result<FramePixels>& frame) {
    if (!frame) {
      ADD_FAILURE() << frame.error().where << ": " << frame.error().detail;
      return {};
    }
    const auto* image = std::get_if<Image<Pixel>>(&*frame);
    EXPECT_TRUE(image) << "another depth";
    return image ? *image : Image<Pixel>();
  }

  TempFolder folder_;
};

template <class T>
std::optional<ErrorCode> code(const Result<T>& result) {
  return result ? std::optional<ErrorCode>() : result.error().code;
}

TEST_F(Frames, LosslessRoundTripKeepsEveryCode) {
  for (const char* name : {"a.png", "a.tif", "a.tiff", "A.PNG"}) {
    EXPECT_EQ(expect<Rgb8>(read(bytes_of(name, ramp8(31, 17)))), ramp8(31, 17)) << name;
    EXPECT_EQ(expect<Rgb16>(read(bytes_of(name, ramp16(31, 17)))), ramp16(31, 17)) << name;
  }
}

TEST_F(Frames, JpegStaysNearAndKeepsChannelOrder) {
  const Image<Rgb8> flat(40, 24, {200, 100, 20});
  for (const char* name : {"a.jpg", "a.jpeg"}) {
    const auto back = expect<Rgb8>(read(bytes_of(name, flat)));
    ASSERT_TRUE(back.same_size(flat));
    for (const Rgb8& p : back.pixels()) {
      EXPECT_NEAR(p.r, 200, 3);
      EXPECT_NEAR(p.g, 100, 3);
      EXPECT_NEAR(p.b, 20, 3);
    }
  }
}

TEST_F(Frames, GreyBecomesThreeEqualChannels) {
  const auto eight = expect<Rgb8>(read(kGrey8));
  ASSERT_EQ(eight.width(), 2);
  EXPECT_EQ(eight.at(0, 0), (Rgb8{10, 10, 10}));
  EXPECT_EQ(eight.at(1, 0), (Rgb8{200, 200, 200}));
  const auto sixteen = expect<Rgb16>(read(kGrey16));
  ASSERT_EQ(sixteen.width(), 2);
  EXPECT_EQ(sixteen.at(0, 0), (Rgb16{1000, 1000, 1000}));
  EXPECT_EQ(sixteen.at(1, 0), (Rgb16{60000, 60000, 60000}));
}

TEST_F(Frames, AlphaIsDroppedNotMultiplied) {
  const auto image = expect<Rgb8>(read(kRgba8));
  ASSERT_EQ(image.area(), 1u);
  EXPECT_EQ(image.at(0, 0), (Rgb8{1, 2, 3}));
}

// A TIFF as its makers vary it: fields are set, then rows or tiles are written.
ByteList tiff_of(const std::filesystem::path& path, const std::function<void(TIFF*)>& write) {
  const std::unique_ptr<TIFF, void (*)(TIFF*)> file(TIFFOpen(path.c_str(), "w"), TIFFClose);
  if (!file) return {};
  TIFFSetField(file.get(), TIFFTAG_IMAGEWIDTH, 3);
  TIFFSetField(file.get(), TIFFTAG_IMAGELENGTH, 2);
  write(file.get());
  TIFFFlush(file.get());
  return read_bytes(path).value_or(ByteList());
}

void set_samples(TIFF* file, int bits, int samples, int photometric) {
  TIFFSetField(file, TIFFTAG_BITSPERSAMPLE, bits);
  TIFFSetField(file, TIFFTAG_SAMPLESPERPIXEL, samples);
  TIFFSetField(file, TIFFTAG_PHOTOMETRIC, photometric);
  TIFFSetField(file, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
  TIFFSetField(file, TIFFTAG_ROWSPERSTRIP, 1);
}

template <class Sample, std::size_t N>
void write_two_rows(TIFF* file, std::array<Sample, N> samples) {
  TIFFWriteScanline(file, samples.data(), 0, 0);
  TIFFWriteScanline(file, samples.data() + N / 2, 1, 0);
}

TEST_F(Frames, TiffsPlanesTilesAndSamplesAreTakenAsTheyAre) {
  const auto path = folder_.path() / "made.tif";
  // Plane by plane, an alpha as the fourth.
  const auto planes = expect<Rgb8>(read(tiff_of(path, [](TIFF* file) {
    set_samples(file, 8, 4, PHOTOMETRIC_RGB);
    TIFFSetField(file, TIFFTAG_PLANARCONFIG, PLANARCONFIG_SEPARATE);
    for (int plane = 0; plane < 4; ++plane)
      for (int y = 0; y < 2; ++y) {
        const auto v = static_cast<std::uint8_t>(plane == 3 ? 0 : 40 * plane + 10 * y);
        std::array<std::uint8_t, 3> row{v, static_cast<std::uint8_t>(v + 1),
                                        static_cast<std::uint8_t>(v + 2)};
        TIFFWriteScanline(file, row.data(), static_cast<std::uint32_t>(y),
                          static_cast<std::uint16_t>(plane));
      }
  })));
  ASSERT_EQ(planes.width(), 3);
  EXPECT_EQ(planes.at(2, 1), (Rgb8{12, 52, 92}));
  // One tile, larger than the picture.
  const auto tile = expect<Rgb16>(read(tiff_of(path, [](TIFF* file) {
    set_samples(file, 16, 3, PHOTOMETRIC_RGB);
    TIFFSetField(file, TIFFTAG_TILEWIDTH, 16);
    TIFFSetField(file, TIFFTAG_TILELENGTH, 16);
    TIFFSetField(file, TIFFTAG_COMPRESSION, COMPRESSION_ADOBE_DEFLATE);
    std::array<std::uint16_t, 3 * 16 * 16> samples{};
    for (std::size_t i = 0; i < samples.size(); ++i)
      samples[i] = static_cast<std::uint16_t>(70 * i);
    TIFFWriteEncodedTile(file, 0, samples.data(), static_cast<tmsize_t>(sizeof samples));
  })));
  ASSERT_EQ(tile.height(), 2);
  EXPECT_EQ(tile.at(1, 1), (Rgb16{70 * 51, 70 * 52, 70 * 53}));
  // Linear floats, the light of a raw converter.
  const auto light = expect<Rgb>(read(tiff_of(path, [](TIFF* file) {
    set_samples(file, 32, 1, PHOTOMETRIC_MINISBLACK);
    TIFFSetField(file, TIFFTAG_SAMPLEFORMAT, SAMPLEFORMAT_IEEEFP);
    write_two_rows(file, std::array{.5f, 1.f, 2.f, 4.f, 8.f, 16.f});
  })));
  ASSERT_EQ(light.width(), 3);
  EXPECT_EQ(light.at(1, 1), (Rgb{8, 8, 8}));
  // White is 0, as in a scanner's file.
  const auto inverted = expect<Rgb8>(read(tiff_of(path, [](TIFF* file) {
    set_samples(file, 8, 1, PHOTOMETRIC_MINISWHITE);
    write_two_rows(file, std::array<std::uint8_t, 6>{0, 1, 2, 3, 4, 255});
  })));
  ASSERT_EQ(inverted.width(), 3);
  EXPECT_EQ(inverted.at(1, 0), (Rgb8{254, 254, 254}));
  EXPECT_EQ(inverted.at(2, 1), (Rgb8{0, 0, 0}));
}

TEST_F(Frames, TiffsOfTwelveBitsFillSixteen) {
  const auto image = expect<Rgb16>(read(tiff_of(folder_.path() / "made.tif", [](TIFF* file) {
    set_samples(file, 12, 1, PHOTOMETRIC_MINISBLACK);
    // Three samples a row: fff 800 001, and 123 456 789 with half a byte left.
    write_two_rows(file, std::array<std::uint8_t, 10>{0xff, 0xf8, 0x00, 0x00, 0x10, 0x12, 0x34,
                                                      0x56, 0x78, 0x90});
  })));
  ASSERT_EQ(image.width(), 3);
  EXPECT_EQ(image.at(0, 0).r, 0xffff) << "saturated stays saturated";
  EXPECT_EQ(image.at(1, 0).r, 0x8008);
  EXPECT_EQ(image.at(2, 0).r, 0x0010);
  EXPECT_EQ(image.at(0, 1).r, 0x1231);
  EXPECT_EQ(image.at(2, 1).r, 0x7897);
}

TEST_F(Frames, ATileFarLargerThanItsPictureIsRefused) {
  const auto frame = read(tiff_of(folder_.path() / "made.tif", [](TIFF* file) {
    set_samples(file, 8, 1, PHOTOMETRIC_MINISBLACK);
    TIFFSetField(file, TIFFTAG_TILEWIDTH, 16384);
    TIFFSetField(file, TIFFTAG_TILELENGTH, 16);
    const std::vector<std::uint8_t> samples(16384 * 16);
    TIFFSetField(file, TIFFTAG_COMPRESSION, COMPRESSION_ADOBE_DEFLATE);
    TIFFWriteEncodedTile(file, 0, const_cast<std::uint8_t*>(samples.data()), 16384 * 16);
  }));
  ASSERT_FALSE(frame);
  EXPECT_EQ(frame.error().detail, "is damaged: its tiles or samples are out of range");
}

TEST_F(Frames, TiffsOfPalettesAreUnfoldedInTheOrderOfTheirRows) {
  const auto image = expect<Rgb8>(read(tiff_of(folder_.path() / "made.tif", [](TIFF* file) {
    set_samples(file, 8, 1, PHOTOMETRIC_PALETTE);
    TIFFSetField(file, TIFFTAG_ORIENTATION, ORIENTATION_BOTLEFT);
    std::array<std::uint16_t, 256> red{}, green{}, blue{};
    red[1] = 65535, green[2] = 65535, blue[3] = 65535;
    TIFFSetField(file, TIFFTAG_COLORMAP, red.data(), green.data(), blue.data());
    write_two_rows(file, std::array<std::uint8_t, 6>{1, 2, 3, 0, 0, 1});
  })));
  ASSERT_EQ(image.width(), 3);
  EXPECT_EQ(image.at(0, 0), (Rgb8{255, 0, 0}));
  EXPECT_EQ(image.at(1, 0), (Rgb8{0, 255, 0}));
  EXPECT_EQ(image.at(2, 1), (Rgb8{255, 0, 0}));
}

TEST_F(Frames, TiffsOfOtherSamplesAreRefusedByThem) {
  const auto path = folder_.path() / "made.tif";
  const auto read_kind = [&](int bits, int format) {
    return read(tiff_of(path, [&](TIFF* file) {
      set_samples(file, bits, 1, PHOTOMETRIC_MINISBLACK);
      TIFFSetField(file, TIFFTAG_SAMPLEFORMAT, format);
      write_two_rows(file, std::array<double, 6>{});
    }));
  };
  for (const auto& [bits, format] : {std::pair{64, SAMPLEFORMAT_IEEEFP},
                                     {32, SAMPLEFORMAT_UINT},
                                     {16, SAMPLEFORMAT_INT},
                                     {16, SAMPLEFORMAT_IEEEFP}}) {
    const auto frame = read_kind(bits, format);
    ASSERT_FALSE(frame) << bits;
    EXPECT_EQ(frame.error().detail, "has neither 8-bit nor 16-bit nor float samples");
  }
}

TEST_F(Frames, ExifOrientationDoesNotTurnThePicture) {
  const auto plain = encode_jpeg(ramp8(24, 16));
  ASSERT_TRUE(plain);
  // An Exif segment whose only entry is orientation 6, a quarter turn.
  const ByteList exif{0xff, 0xe1, 0, 34,   'E', 'x', 'i', 'f', 0, 0, 'M', 'M', 0, 42, 0, 0, 0, 8,
                      0,    1,    1, 0x12, 0,   3,   0,   0,   0, 1, 0,   6,   0, 0,  0, 0, 0, 0};
  ByteList turned = *plain;
  turned.insert(turned.begin() + 2, exif.begin(), exif.end());
  const auto image = expect<Rgb8>(read(turned));
  EXPECT_EQ(image, expect<Rgb8>(read(*plain)));
  EXPECT_EQ(image.width(), 24);
}

TEST_F(Frames, FloatFilesComeBackAsLinearFloat) {
  Image<Rgb> image(9, 2, {.5f, 2, 1});
  for (const char* name : {"a.exr", "a.hdr"}) {
    ASSERT_TRUE(write_hdr(folder_.path() / name, image));
    EXPECT_EQ(expect<Rgb>(read_frame(folder_.path() / name)), image) << name;
  }
}

TEST_F(Frames, EveryTruncationIsAnError) {
  for (const char* name : {"a.png", "a.jpg", "a.tif"}) {
    const ByteList whole = bytes_of(name, ramp8(19, 13));
    ASSERT_TRUE(read(whole)) << name;
    for (std::size_t size = 0; size < whole.size(); ++size) {
      const ByteList part(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size));
      ASSERT_EQ(code(read(part)), ErrorCode::kUnreadable) << name << " cut to " << size;
    }
  }
}

// `size` bytes of TurboJPEG's own in a list.
ByteList jpeg_of(int pixel_format, int bytes_a_pixel, int subsampling) {
  const std::unique_ptr<void, int (*)(void*)> coder(tjInitCompress(), tjDestroy);
  std::vector<unsigned char> picture;
  for (int i = 0; i < 48 * 48 * bytes_a_pixel; ++i)
    picture.push_back(static_cast<unsigned char>(i % bytes_a_pixel == 3 ? 200 : 60 + i % 7));
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  EXPECT_EQ(tjCompress2(coder.get(), picture.data(), 48, 0, 48, pixel_format, &bytes, &size,
                        subsampling, 95, TJFLAG_PROGRESSIVE),
            0);
  const std::unique_ptr<unsigned char, void (*)(unsigned char*)> owner(bytes, tjFree);
  return ByteList(bytes, bytes + size);
}

TEST_F(Frames, JpegsOfAPrintersInksShowWhatTheyPrint) {
  const auto image = expect<Rgb8>(read(jpeg_of(TJPF_CMYK, 4, TJSAMP_444)));
  ASSERT_EQ(image.width(), 48);
  for (const Rgb8& p : image.pixels()) EXPECT_NEAR(p.r, 63 * 200 / 255, 6);
}

TEST_F(Frames, JpegsOfAnySubsamplingAndVersionAreRead) {
  ByteList jpeg = jpeg_of(TJPF_RGB, 3, TJSAMP_422);
  ASSERT_TRUE(read(jpeg));
  for (std::size_t i = 0; i + 9 < jpeg.size(); ++i) {
    if (jpeg[i] == 0xff && jpeg[i + 1] == 0xe0) jpeg[i + 9] = 2;  // JFIF 2: a warning
    // 4x1, which has no name in TurboJPEG
    if (jpeg[i] == 0xff && jpeg[i + 1] == 0xc2) jpeg[i + 11] = 0x41;
  }
  EXPECT_TRUE(read(jpeg));
}

// A warning before it must not make an error one.
TEST_F(Frames, AJpegThatEndsInAnErrorIsRefusedThoughItWarnedBefore) {
  ByteList jpeg = jpeg_of(TJPF_RGB, 3, TJSAMP_444);
  std::vector<std::size_t> scans;
  for (std::size_t i = 0; i + 1 < jpeg.size(); ++i)
    if (jpeg[i] == 0xff && jpeg[i + 1] == 0xda) scans.push_back(i);
  ASSERT_GT(scans.size(), 3u);
  for (std::size_t i = scans[0] + 15; i < scans[0] + 18; ++i) jpeg[i] ^= 0x15;
  const auto warned = read(jpeg);
  ASSERT_TRUE(warned) << warned.error().detail;
  jpeg[scans.back() + 5] = 77;  // a component that there is not
  EXPECT_EQ(code(read(jpeg)), ErrorCode::kUnreadable);
}

// A PNG of `bits` a sample in seven passes, 8 x 8, whose column i has the code i of 2^bits.
ByteList png_of(int colour, int bits) {
  ByteList out;
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(png);
  png_set_write_fn(
      png, &out,
      [](png_structp to, png_bytep data, std::size_t size) {
        auto* bytes = static_cast<ByteList*>(png_get_io_ptr(to));
        bytes->insert(bytes->end(), data, data + size);
      },
      [](png_structp) {});
  png_set_IHDR(png, info, 8, 8, bits, colour, PNG_INTERLACE_ADAM7, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  const std::array<png_color, 2> palette{{{250, 10, 20}, {30, 240, 50}}};
  const std::array<png_byte, 2> alpha{255, 7};
  if (colour == PNG_COLOR_TYPE_PALETTE) {
    png_set_PLTE(png, info, palette.data(), 2);
    png_set_tRNS(png, info, alpha.data(), 2, nullptr);
  }
  png_write_info(png, info);
  png_set_packing(png);
  std::array<std::array<png_byte, 64>, 8> rows{};
  std::array<png_bytep, 8> pointers{};
  for (std::size_t y = 0; y < 8; ++y) {
    pointers[y] = rows[y].data();
    for (std::size_t x = 0; x < 64; ++x)
      rows[y][x] = static_cast<png_byte>(bits < 8 ? x % 2 : 4 * x);
  }
  png_write_image(png, pointers.data());
  png_write_end(png, info);
  png_destroy_write_struct(&png, &info);
  return out;
}

TEST_F(Frames, PngsOfPalettesAndFewBitsAreUnfolded) {
  const auto palette = png_of(PNG_COLOR_TYPE_PALETTE, 1);
  const auto image = expect<Rgb8>(read(palette));
  ASSERT_EQ(image.width(), 8);
  EXPECT_EQ(image.at(0, 5), (Rgb8{250, 10, 20}));
  EXPECT_EQ(image.at(3, 2), (Rgb8{30, 240, 50}));
  const auto with_alpha = decode_frame_with_alpha(palette, "palette");
  ASSERT_TRUE(with_alpha);
  EXPECT_EQ(with_alpha->alpha.at(0, 0), 255);
  EXPECT_EQ(with_alpha->alpha.at(1, 7), 7);
  const auto bits = expect<Rgb8>(read(png_of(PNG_COLOR_TYPE_GRAY, 1)));
  ASSERT_EQ(bits.width(), 8);
  EXPECT_EQ(bits.at(1, 1), (Rgb8{255, 255, 255}));
  const auto wide = decode_frame_with_alpha(png_of(PNG_COLOR_TYPE_RGB_ALPHA, 16), "wide");
  ASSERT_TRUE(wide);
  const auto* codes = std::get_if<Image<Rgb16>>(&wide->pixels);
  ASSERT_TRUE(codes);
  EXPECT_EQ(codes->at(1, 3), (Rgb16{32 * 256 + 36, 40 * 256 + 44, 48 * 256 + 52}));
  EXPECT_EQ(wide->alpha.at(1, 3), 56);  // of 56 * 256 + 60
}

TEST_F(Frames, JpegThumbnailEndIsNotThePicturesEnd) {
  const auto plain = encode_jpeg(ramp8(24, 16));
  ASSERT_TRUE(plain);
  // An application segment that holds an end-of-image marker, as a thumbnail would.
  const ByteList segment{0xff, 0xe5, 0, 4, 0xff, 0xd9};
  ByteList whole = *plain;
  whole.insert(whole.begin() + 2, segment.begin(), segment.end());
  EXPECT_TRUE(read(whole));
  whole.resize(whole.size() - 40);
  EXPECT_EQ(code(read(whole)), ErrorCode::kUnreadable);
}

TEST_F(Frames, BytesAfterThePictureAreIgnored) {
  for (const char* name : {"a.png", "a.jpg", "a.tif"}) {
    ByteList bytes = bytes_of(name, ramp8(19, 13));
    bytes.resize(bytes.size() + 5000, 0xab);
    EXPECT_TRUE(read(bytes)) << name;
  }
}

TEST_F(Frames, HugeSizesAreRefusedBeforeDecoding) {
  ByteList png = kGrey8;
  png[16] = 0x3b;  // about 1e9 columns
  EXPECT_EQ(code(read(png)), ErrorCode::kInvalid);
  png[16] = 0xff;
  EXPECT_EQ(code(read(png)), ErrorCode::kInvalid);

  ByteList jpeg = bytes_of("a.jpg", ramp8(19, 13));
  for (std::size_t i = 0; i + 8 < jpeg.size(); ++i)
    if (jpeg[i] == 0xff && jpeg[i + 1] == 0xc0) jpeg[i + 5] = jpeg[i + 7] = 0xff;
  EXPECT_EQ(code(read(jpeg)), ErrorCode::kInvalid);

  ByteList none = kGrey8;
  none[19] = 0;
  EXPECT_EQ(code(read(none)), ErrorCode::kUnreadable);
}

TEST_F(Frames, WhatIsNoPictureIsRefused) {
  EXPECT_EQ(code(read_frame(folder_.path() / "absent.png")), ErrorCode::kNotFound);
  EXPECT_EQ(code(read_frame(folder_.path())), ErrorCode::kUnreadable);
  EXPECT_EQ(code(read({})), ErrorCode::kUnreadable);
  EXPECT_EQ(code(read({'B', 'M', 0, 0})), ErrorCode::kUnreadable);
  EXPECT_EQ(code(read(ByteList(1000, 0))), ErrorCode::kUnreadable);
}

TEST_F(Frames, DamageNeverCrashes) {
  const auto tiles = tiff_of(folder_.path() / "made.tif", [](TIFF* file) {
    set_samples(file, 16, 3, PHOTOMETRIC_RGB);
    TIFFSetField(file, TIFFTAG_PLANARCONFIG, PLANARCONFIG_SEPARATE);
    TIFFSetField(file, TIFFTAG_TILEWIDTH, 16);
    TIFFSetField(file, TIFFTAG_TILELENGTH, 16);
    std::array<std::uint16_t, 256> samples{};
    for (std::uint32_t plane = 0; plane < 3; ++plane)
      TIFFWriteEncodedTile(file, plane, samples.data(), static_cast<tmsize_t>(sizeof samples));
  });
  int which = 0;
  for (const ByteList& whole : {bytes_of("a.png", ramp8(6, 5)), bytes_of("a.jpg", ramp8(6, 5)),
                                bytes_of("a.tif", ramp8(6, 5)), png_of(PNG_COLOR_TYPE_PALETTE, 1),
                                jpeg_of(TJPF_CMYK, 4, TJSAMP_444), tiles}) {
    int errors = 0;
    test::mutate_and_run(whole, 150, 21, [&](std::span<const unsigned char> bytes) {
      errors += !decode_frame(bytes, "mutated");
    });
    EXPECT_GT(errors, 5) << which;
    ++which;
  }
}

TEST_F(Frames, UnwritableOutputLeavesNothing) {
  const TempFolder folder;
  for (const char* name : {"a.png", "a.jpg", "a.tif"}) {
    EXPECT_EQ(code(write_frame(folder.path() / "absent" / name, ramp8(4, 4))),
              ErrorCode::kUnwritable);
    EXPECT_EQ(code(write_frame(folder.path() / name, Image<Rgb8>())), ErrorCode::kInvalid);
  }
  EXPECT_EQ(code(write_frame(folder.path() / "a.bmp", ramp8(4, 4))), ErrorCode::kInvalid);
  EXPECT_EQ(code(write_frame(folder.path() / "a", ramp8(4, 4))), ErrorCode::kInvalid);
  EXPECT_TRUE(folder.empty());
}

TEST_F(Frames, SixteenBitCodesAreNotSqueezedIntoJpeg) {
  EXPECT_EQ(code(write_frame(folder_.path() / "a.jpg", ramp16(4, 4))), ErrorCode::kInvalid);
  EXPECT_TRUE(folder_.empty());
}

TEST_F(Frames, JpegBytesAreWholeAndGrowWithQuality) {
  const auto low = encode_jpeg(ramp8(64, 64), 20);
  const auto high = encode_jpeg(ramp8(64, 64), 95);
  ASSERT_TRUE(low && high);
  EXPECT_LT(low->size(), high->size());
  EXPECT_EQ((*low)[0], 0xff);
  EXPECT_EQ((*low)[1], 0xd8);
  EXPECT_EQ((*low)[low->size() - 2], 0xff);
  EXPECT_EQ(low->back(), 0xd9);
  EXPECT_EQ(code(encode_jpeg(Image<Rgb8>())), ErrorCode::kInvalid);
  EXPECT_EQ(code(encode_jpeg(ramp8(4, 4), 0)), ErrorCode::kInvalid);
  EXPECT_EQ(code(encode_jpeg(ramp8(4, 4), 101)), ErrorCode::kInvalid);
}

TEST_F(Frames, EveryPictureOfTheRealStacksIsRead) {
  PENUMBRA_NEED_SHARED(stacks, "eval-only/stacks");
  int read_count = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(stacks)) {
    const auto extension = entry.path().extension();
    if (extension != ".png" && extension != ".jpg" && extension != ".JPG") continue;
    const auto frame = read_frame(entry.path());
    ASSERT_TRUE(frame) << entry.path() << ": " << frame.error().detail;
    EXPECT_TRUE(std::holds_alternative<Image<Rgb8>>(*frame)) << entry.path();
    ++read_count;
  }
  EXPECT_GT(read_count, 0);
}

}  // namespace
}  // namespace penumbra::codec
