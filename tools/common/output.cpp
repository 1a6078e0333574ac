#include "tools/common/output.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>

#include "codec/codec.h"
#include "codec/display.h"
#include "core/files.h"

namespace penumbra::tools {

namespace fs = std::filesystem;

Result<OutputFolder> OutputFolder::create(const fs::path& folder) {
  OutputFolder out;
  std::error_code error;
  out.made_ = !fs::exists(folder, error);
  out.path_ = folder;
  PENUMBRA_TRY(make_folder(folder));
  PENUMBRA_TRY(out.begin());
  fs::remove(out.work_, error);
  return out;
}

Result<void> OutputFolder::begin() {
  work_ = path_ / (".partial-" + std::to_string(::getpid()));
  std::error_code error;
  fs::remove_all(work_, error);  // of a process of the same number that was killed
  if (!fs::create_directory(work_, error))
    return fail(ErrorCode::kUnwritable, path_.string(),
                error ? error.message() : work_.string() + " cannot be replaced");
  return {};
}

OutputFolder::OutputFolder(OutputFolder&& other) noexcept
    : path_(std::move(other.path_)),
      work_(std::exchange(other.work_, {})),
      made_(std::exchange(other.made_, false)) {}

OutputFolder::~OutputFolder() {
  std::error_code ignored;
  if (!work_.empty()) fs::remove_all(work_, ignored);
  if (made_) fs::remove(path_, ignored);  // only when it is empty
}

Result<void> OutputFolder::keep() {
  std::error_code error;
  for (fs::directory_iterator entry(work_, error), end; !error && entry != end;
       entry.increment(error)) {
    const fs::path target = path_ / entry->path().filename();
    std::error_code moved;
    fs::rename(entry->path(), target, moved);
    if (moved) return fail(ErrorCode::kUnwritable, target.string(), moved.message());
  }
  if (error) return fail(ErrorCode::kUnwritable, path_.string(), error.message());
  return {};
}

Result<std::unique_ptr<FrameWriter>> FrameWriter::create(const Options& options,
                                                         StageTimes& times) {
  PENUMBRA_TRY(make_folder(options.folder));
  auto writer = std::unique_ptr<FrameWriter>(new FrameWriter(options, times));
  writer->worker_ = std::jthread([w = writer.get()] { w->work(); });
  return writer;
}

FrameWriter::~FrameWriter() {
  queue_.close();
}

bool FrameWriter::write(const std::string& name, std::shared_ptr<const FramePixels> pixels,
                        bool in_video) {
  return queue_.push({name, std::move(pixels), in_video});
}

Result<void> FrameWriter::finish() {
  queue_.close();
  if (worker_.joinable()) worker_.join();
  PENUMBRA_TRY(result_);
  if (video_) return video_->finish();
  return {};
}

void FrameWriter::work() noexcept {
  try {
    while (auto job = queue_.pop())
      if (auto handled = handle(*job); !handled) {
        result_ = std::move(handled);
        break;
      }
  } catch (const std::exception& e) {
    result_ = fail(ErrorCode::kUnwritable, options_.folder.string(), e.what());
  }
  queue_.close();  // after an error, writers are refused instead of waiting
}

Result<void> FrameWriter::handle(const WriteJob& job) {
  if (options_.stills) {
    const StageTimer timer(times_, "write still");
    const auto path = options_.folder / job.name;
    if (const auto* f8 = std::get_if<Image<Rgb8>>(job.pixels.get())) {
      PENUMBRA_TRY(codec::write_frame(path, *f8));
    } else if (const auto* f16 = std::get_if<Image<Rgb16>>(job.pixels.get())) {
      PENUMBRA_TRY(codec::write_frame(path, *f16));
    } else {
      auto exr = path;
      PENUMBRA_TRY(codec::write_hdr(exr.replace_extension(".exr"),
                                    std::get<Image<Rgb>>(*job.pixels), codec::Depth::kFloat));
    }
  }
  if (!options_.video || !job.in_video) return {};
  const StageTimer timer(times_, "encode video");
  const auto* bytes = std::get_if<Image<Rgb8>>(job.pixels.get());
  const Image<Rgb8> converted = bytes ? Image<Rgb8>() : codec::to_display(*job.pixels);
  const Image<Rgb8>& picture = bytes ? *bytes : converted;
  if (!video_) {
    PENUMBRA_ASSIGN(video,
                    compositor::VideoWriter::create(options_.folder / "video.mp4", picture.width(),
                                                    picture.height(), options_.fps, options_.live));
    video_ = std::move(video);
  }
  return video_->write(picture);
}

}  // namespace penumbra::tools
