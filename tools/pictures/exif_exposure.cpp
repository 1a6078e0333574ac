#include "tools/pictures/exif_exposure.h"

#include <libexif/exif-data.h>

#include <cmath>
#include <fstream>
#include <memory>
#include <vector>

namespace penumbra::tools {

namespace {

// APP1 holds at most 64 KiB and stands at the front, behind other segments of that size.
constexpr std::streamsize kHead = 512 << 10;

std::optional<double> number_of(ExifData* data, ExifTag tag) {
  ExifEntry* const entry = exif_content_get_entry(data->ifd[EXIF_IFD_EXIF], tag);
  if (!entry || entry->components < 1) return {};
  const ExifByteOrder order = exif_data_get_byte_order(data);
  double value = 0;
  if (entry->format == EXIF_FORMAT_RATIONAL && entry->size >= 8) {
    const ExifRational r = exif_get_rational(entry->data, order);
    value = r.denominator == 0 ? 0 : double(r.numerator) / double(r.denominator);
  } else if (entry->format == EXIF_FORMAT_SHORT && entry->size >= 2) {
    value = exif_get_short(entry->data, order);
  } else if (entry->format == EXIF_FORMAT_LONG && entry->size >= 4) {
    value = exif_get_long(entry->data, order);
  }
  if (!(value > 0 && std::isfinite(value))) return {};
  return value;
}

}  // namespace

Result<ExifExposure> read_exif_exposure(const std::filesystem::path& jpeg) {
  std::error_code error;
  if (!std::filesystem::exists(jpeg, error))
    return fail(ErrorCode::kNotFound, jpeg.string(), "no such file");
  std::ifstream in(jpeg, std::ios::binary);
  std::vector<unsigned char> head(static_cast<std::size_t>(kHead));
  in.read(reinterpret_cast<char*>(head.data()), kHead);
  if (in.gcount() == 0) return fail(ErrorCode::kUnreadable, jpeg.string(), "cannot be read");
  const std::unique_ptr<ExifData, decltype(&exif_data_unref)> data(
      exif_data_new_from_data(head.data(), static_cast<unsigned>(in.gcount())), &exif_data_unref);
  const auto time = data ? number_of(data.get(), EXIF_TAG_EXPOSURE_TIME) : std::nullopt;
  if (!time) return fail(ErrorCode::kUndetermined, jpeg.string(), "holds no exposure time (EXIF)");
  return ExifExposure{Seconds(*time), number_of(data.get(), EXIF_TAG_ISO_SPEED_RATINGS),
                      number_of(data.get(), EXIF_TAG_FNUMBER)};
}

}  // namespace penumbra::tools
