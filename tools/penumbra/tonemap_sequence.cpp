#include "tools/penumbra/tonemap_sequence.h"

#include <fmt/format.h>
#include <string.h>  // strverscmp

#include <algorithm>
#include <glm/ext/vector_int2.hpp>
#include <optional>
#include <set>
#include <string>
#include <string_view>

#include "codec/codec.h"
#include "codec/tone/temporal_tone.h"
#include "compositor/composite/compositor.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "core/units.h"
#include "tools/common/progress.h"

namespace penumbra::tools {

namespace fs = std::filesystem;

namespace {

bool names_a_file(const fs::path& path) {
  constexpr std::string_view kFiles[] = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr",
                                         ".hdr", ".mov", ".mkv",  ".avi", ".webm", ".gif"};
  return std::ranges::find(kFiles, lower_extension(path)) != std::end(kFiles);
}

// Where shown pictures go: a video, or a file each.
class ShownPictures {
 public:
  static Result<ShownPictures> create(const ToneSequence& sequence) {
    ShownPictures out(sequence);
    if (!out.is_video()) {
      if (names_a_file(sequence.output))
        return fail(ErrorCode::kInvalid, sequence.output.string(),
                    "is one picture: several go to a video, .mp4, or to a folder");
      PENUMBRA_TRY(out.check_names());
      PENUMBRA_TRY(make_folder(sequence.output));
    }
    return out;
  }

  Result<void> add(const fs::path& picture, const Image<Rgb8>& shown) {
    if (!is_video())
      return codec::write_frame(sequence_->output / fs::path(picture.stem()).concat(".png"), shown);
    if (!video_) {
      PENUMBRA_ASSIGN(
          video, compositor::VideoWriter::create(sequence_->output, shown.width(), shown.height(),
                                                 sequence_->frames_per_second));
      video_.emplace(std::move(video));
      size_ = {shown.width(), shown.height()};
    }
    if (size_ != glm::ivec2(shown.width(), shown.height()))
      return fail(ErrorCode::kInvalid, picture.string(),
                  fmt::format("has {}x{} pixels, the first picture {}x{}", shown.width(),
                              shown.height(), size_.x, size_.y));
    return video_->write(shown);
  }

  Result<void> finish() { return video_ ? video_->finish() : Result<void>{}; }

 private:
  explicit ShownPictures(const ToneSequence& sequence) : sequence_(&sequence) {}

  bool is_video() const { return lower_extension(sequence_->output) == ".mp4"; }
  Result<void> check_names() const {
    std::set<fs::path> names;
    for (const fs::path& p : sequence_->pictures)
      if (!names.insert(p.stem()).second)
        return fail(ErrorCode::kInvalid, p.string(), "has the name of a picture before it");
    return {};
  }

  const ToneSequence* sequence_;
  std::optional<compositor::VideoWriter> video_;
  glm::ivec2 size_{0};
};

}  // namespace

Result<std::vector<fs::path>> pictures_of(const fs::path& path) {
  constexpr std::string_view kExtensions[] = {".exr", ".hdr", ".jph", ".jp2", ".pnr"};
  std::error_code error;
  if (!fs::is_directory(path, error)) return std::vector{path};
  std::vector<fs::path> out;
  for (const auto& entry : fs::directory_iterator(path, error))
    if (!entry.path().filename().string().starts_with('.') &&
        std::ranges::find(kExtensions, lower_extension(entry.path())) != std::end(kExtensions))
      out.push_back(entry.path());
  if (error) return fail(ErrorCode::kUnreadable, path.string(), error.message());
  if (out.empty()) return fail(ErrorCode::kNotFound, path.string(), "holds no HDR pictures");
  std::ranges::sort(out, [](const fs::path& a, const fs::path& b) {
    return ::strverscmp(a.filename().c_str(), b.filename().c_str()) < 0;  // 9 before 10
  });
  return out;
}

Result<void> tonemap_sequence(const ToneSequence& sequence) {
  PENUMBRA_ASSIGN(shown, ShownPictures::create(sequence));
  tone::TemporalTone tone(sequence.tone, Seconds(sequence.adaptation_s));
  const auto progress = progress_bar("tonemap");
  std::size_t negative = 0;
  for (std::size_t i = 0; i < sequence.pictures.size(); ++i) {
    const fs::path& path = sequence.pictures[i];
    PENUMBRA_ASSIGN(read, codec::read_hdr(path));
    const Seconds since(static_cast<double>(i) / sequence.frames_per_second);
    auto mapped = tone.map(read.pixels, TimestampNs{} + since);
    if (!mapped)
      return fail(mapped.error().code,
                  mapped.error().where == "picture" ? path.string() : mapped.error().where,
                  mapped.error().detail);
    negative += mapped->statistics.negative;
    PENUMBRA_TRY(shown.add(path, mapped->pixels));
    progress(static_cast<double>(i + 1) / static_cast<double>(sequence.pictures.size()));
  }
  if (negative > 0) log_warning("{} pixels have components below 0, which count as 0", negative);
  return shown.finish();
}

}  // namespace penumbra::tools
