#include "tools/runs/output.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <regex>

#include "codec/codec.h"
#include "codec/display.h"
#include "core/exceptions.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "core/threads/processor_time.h"
#include "tools/runs/side_by_side.h"

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

namespace {

std::vector<std::string> files_in(const fs::path& folder, std::error_code& error) {
  std::vector<std::string> out;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error))
    out.push_back(entry->path().filename().string());
  return out;
}

// frame_000012.png, frame_right_000012.exr, video.mp4.
bool is_frame_or_video(const std::string& name) {
  static const std::regex kPattern(R"(frame_(.+_)?\d{6}\.(png|exr)|video\.mp4)");
  return std::regex_match(name, kPattern);
}

}  // namespace

Result<void> OutputFolder::keep(EarlierFrames earlier) {
  std::error_code error;
  const std::vector<std::string> made = files_in(work_, error);
  if (error) return fail(ErrorCode::kUnwritable, path_.string(), error.message());
  for (const std::string& name : made) {
    const fs::path target = path_ / name;
    fs::rename(work_ / name, target, error);
    if (error) return fail(ErrorCode::kUnwritable, target.string(), error.message());
  }
  if (earlier == EarlierFrames::kStay) return {};
  for (const std::string& name : files_in(path_, error)) {
    const fs::path old = path_ / name;
    std::error_code failed;
    if (!is_frame_or_video(name) || std::ranges::find(made, name) != made.end() ||
        !fs::is_regular_file(old, failed))
      continue;
    fs::remove(old, failed);
    if (failed) return fail(ErrorCode::kUnwritable, old.string(), failed.message());
  }
  if (error) return fail(ErrorCode::kUnwritable, path_.string(), error.message());
  return {};
}

Result<std::unique_ptr<FrameWriter>> FrameWriter::create(const Options& options,
                                                         StageTimes& times) {
  PENUMBRA_TRY(make_folder(options.folder));
  auto writer = std::unique_ptr<FrameWriter>(new FrameWriter(options, times));
  writer->eyes_.resize(static_cast<std::size_t>(options.eyes));
  FrameWriter* const w = writer.get();
  constexpr unsigned kMaxThreads = 8;
  const unsigned cores = std::clamp(std::thread::hardware_concurrency(), 1u, kMaxThreads);
  for (unsigned i = 0; options.stills && i < cores; ++i)
    writer->workers_.emplace_back([w] { w->work(w->stills_, &FrameWriter::write_still); });
  if (options.video)
    writer->workers_.emplace_back([w] { w->work<VideoJob>(w->frames_, &FrameWriter::encode); });
  return writer;
}

FrameWriter::~FrameWriter() {
  stills_.close();
  frames_.close();
}

bool FrameWriter::write(const std::string& name, std::shared_ptr<const FramePixels> pixels,
                        std::optional<InVideo> in_video) {
  if (options_.video && in_video && !frames_.push({pixels, *in_video})) return false;
  return !options_.stills || stills_.push({name, std::move(pixels)});
}

Result<void> FrameWriter::finish() {
  stills_.close();
  frames_.close();
  workers_.clear();  // joins
  PENUMBRA_TRY(result_);
  if (video_) return video_->finish();
  if (options_.video && options_.eyes > 1)
    log_warning("{}: no video, since no two frames show both eyes at one moment",
                options_.folder.string());
  return {};
}

template <class Job>
void FrameWriter::work(Bounded<Job>& queue,
                       Result<void> (FrameWriter::*handle)(const Job&)) noexcept {
  const SpendingOn spending(ProcessorUse::kEncoding);
  try {
    while (auto job = queue.pop())
      if (auto handled = (this->*handle)(*job); !handled) return give_up(std::move(handled));
  } catch (const std::exception& e) {
    give_up(fail(ErrorCode::kUnwritable, options_.folder.string(), reason_of(e)));
  }
}

// Writers are refused from now on instead of waiting.
void FrameWriter::give_up(Result<void> why) {
  {
    const std::scoped_lock lock(mutex_);
    if (result_) result_ = std::move(why);
  }
  stills_.close();
  frames_.close();
}

Result<void> FrameWriter::write_still(const StillJob& still) {
  const StageTimer timer(times_, "write still");
  const auto path = options_.folder / still.name;
  if (const auto* f8 = std::get_if<Image<Rgb8>>(still.pixels.get()))
    return codec::write_frame(path, *f8);
  if (const auto* f16 = std::get_if<Image<Rgb16>>(still.pixels.get()))
    return codec::write_frame(path, *f16);
  auto exr = path;
  return codec::write_hdr(exr.replace_extension(".exr"), std::get<Image<Rgb>>(*still.pixels),
                          codec::Depth::kFloat);
}

// A picture is whole when every eye has come; what is of another moment is left out.
Result<void> FrameWriter::encode(const VideoJob& frame) {
  const StageTimer timer(times_, "encode video");
  const auto* bytes = std::get_if<Image<Rgb8>>(frame.pixels.get());
  if (eyes_.size() == 1 && bytes) return encode(*bytes);
  const Seconds same(.5 / options_.fps);
  if (frame.in_video.time - moment_ > same || moment_ - frame.in_video.time > same)
    for (Image<Rgb8>& e : eyes_) e = {};
  moment_ = frame.in_video.time;
  Image<Rgb8>& eye = eyes_[static_cast<std::size_t>(frame.in_video.eye)];
  eye = bytes ? *bytes : codec::to_display(*frame.pixels);
  if (std::ranges::any_of(eyes_, &Image<Rgb8>::empty)) return {};
  const Image<Rgb8> picture = side_by_side(std::span<const Image<Rgb8>>(eyes_));
  for (Image<Rgb8>& e : eyes_) e = {};
  return encode(picture);
}

Result<void> FrameWriter::encode(const Image<Rgb8>& picture) {
  if (!video_) {
    PENUMBRA_ASSIGN(video,
                    compositor::VideoWriter::create(options_.folder / "video.mp4", picture.width(),
                                                    picture.height(), options_.fps, options_.live));
    video_ = std::move(video);
  }
  return video_->write(picture);
}

}  // namespace penumbra::tools
