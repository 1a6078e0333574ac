// Writes composited frames on threads of its own: PNG stills and an H.264 video.
#pragma once

#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "compositor/composite/compositor.h"
#include "core/result.h"
#include "core/threads/queues.h"
#include "core/threads/stage_times.h"
#include "core/units.h"

namespace penumbra::tools {

/// A run's results, made in a hidden folder inside the output folder and moved there by keep(). A
/// run that fails leaves no file, and what an earlier one left stays as it was; files of names that
/// this run does not make stay too, but for an earlier run's frames where keep() is told so.
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
  enum class EarlierFrames { kStay, kGo };  // frame_000012.png and so on, and video.mp4
  /// errors: kUnwritable; then some files may have been moved, each whole
  Result<void> keep(EarlierFrames earlier = EarlierFrames::kStay);

 private:
  OutputFolder() = default;
  std::filesystem::path path_, work_;
  bool made_ = false;
};

/// threads: thread-bound; owns a thread for the video and one a core, at most eight, for stills
class FrameWriter {
 public:
  struct Options {
    std::filesystem::path folder;
    bool stills = true, video = true;
    double fps = 30;
    bool live = false;  // the video may be larger, not slower
    int eyes = 1;       // side by side in the video
  };
  /// errors: kUnwritable
  static Result<std::unique_ptr<FrameWriter>> create(const Options& options, StageTimes& times);
  ~FrameWriter();

  struct InVideo {
    TimestampNs time;  // eyes go together within half a frame
    int eye = 0;       // from the left
  };
  /// Queues a frame (waits while four more wait for a thread). False after an error of a worker.
  /// in: in_video, none: a still alone
  bool write(const std::string& name, std::shared_ptr<const FramePixels> pixels,
             std::optional<InVideo> in_video);
  /// Writes what is queued, closes the video; the first error of a worker, if any.
  Result<void> finish();

 private:
  struct StillJob {
    std::string name;
    std::shared_ptr<const FramePixels> pixels;
  };
  struct VideoJob {
    std::shared_ptr<const FramePixels> pixels;
    InVideo in_video;
  };
  FrameWriter(const Options& options, StageTimes& times) : options_(options), times_(times) {}
  template <class Job>
  void work(Bounded<Job>& queue, Result<void> (FrameWriter::*handle)(const Job&)) noexcept;
  Result<void> write_still(const StillJob& still);
  Result<void> encode(const VideoJob& frame);
  Result<void> encode(const Image<Rgb8>& picture);
  void give_up(Result<void> why);

  Options options_;
  StageTimes& times_;
  Bounded<StillJob> stills_{4};
  Bounded<VideoJob> frames_{4};
  std::optional<compositor::VideoWriter> video_;
  std::vector<Image<Rgb8>> eyes_;  // of the picture to come; empty: not there yet
  TimestampNs moment_;             // of those
  std::mutex mutex_;
  Result<void> result_;  // guarded by mutex_
  std::vector<std::jthread> workers_;
};

}  // namespace penumbra::tools
