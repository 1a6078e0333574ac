// Writes composited frames on a thread of its own: PNG stills and an H.264 video.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "compositor/compositor.h"
#include "core/queues.h"
#include "core/result.h"
#include "core/stage_times.h"

namespace penumbra::tools {

/// A run's results, made in a hidden folder inside the output folder and moved there by keep(). A
/// run that fails leaves no file, and what an earlier one left stays as it was; files of names that
/// this run does not make stay in any case.
/// threads: thread-bound
class OutputFolder {
 public:
  /// Tries whether the folder can be written and leaves it empty of this run: killed before begin()
  /// nothing remains.
  /// errors: kUnwritable
  static Result<OutputFolder> create(const std::filesystem::path& folder);
  /// Makes the hidden folder.
  Result<void> begin();
  ~OutputFolder();
  OutputFolder(OutputFolder&& other) noexcept;
  OutputFolder& operator=(OutputFolder&&) = delete;

  const std::filesystem::path& path() const { return path_; }
  /// Where this run writes.
  const std::filesystem::path& work() const { return work_; }
  std::filesystem::path file(const std::string& name) const { return work_ / name; }
  /// errors: kUnwritable; then some files may have been moved, each whole
  Result<void> keep();

 private:
  OutputFolder() = default;
  std::filesystem::path path_, work_;
  bool made_ = false;
};

/// threads: thread-bound; owns one worker thread
class FrameWriter {
 public:
  struct Options {
    std::filesystem::path folder;
    bool stills = true, video = true;
    double fps = 30;
    bool live = false;  // the video may be larger, not slower
  };
  /// errors: kUnwritable
  static Result<std::unique_ptr<FrameWriter>> create(const Options& options, StageTimes& times);
  ~FrameWriter();

  /// Queues a frame (waits while four are in work). False after an error of the worker.
  bool write(const std::string& name, std::shared_ptr<const FramePixels> pixels, bool in_video);
  /// Writes what is queued, closes the video; the first error of the worker, if any.
  Result<void> finish();

 private:
  struct WriteJob {
    std::string name;
    std::shared_ptr<const FramePixels> pixels;
    bool in_video;
  };
  FrameWriter(const Options& options, StageTimes& times) : options_(options), times_(times) {}
  void work() noexcept;
  Result<void> handle(const WriteJob& job);

  Options options_;
  StageTimes& times_;
  Bounded<WriteJob> queue_{4};
  std::optional<compositor::VideoWriter> video_;
  Result<void> result_;  // written by the worker, read after join
  std::jthread worker_;
};

}  // namespace penumbra::tools
