#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <tuple>

#include "calib/camera/response.h"
#include "capture/frames.h"
#include "capture/recording/folder.h"
#include "capture/recording/folder_format.h"
#include "codec/codec.h"
#include "core/io/files.h"

namespace penumbra::capture {
namespace fs = std::filesystem;
namespace {

// ------------------------------------------------------------------------------- reading

class FolderSource final : public FrameSource {
 public:
  FolderSource(fs::path folder, std::vector<FolderCamera> read, Seconds from)
      : folder_(std::move(folder)) {
    for (std::size_t c = 0; c < read.size(); ++c) {
      for (std::size_t n = 0; n < read[c].rows.size(); ++n) order_.push_back({c, n});
      cameras_.push_back(std::move(read[c].info));
      rows_.push_back(std::move(read[c].rows));
    }
    // At the same time the light comes before the picture that it lights.
    std::ranges::stable_sort(order_, {}, [&](const FrameEntry& e) {
      return std::tuple(rows_[e.camera][e.row].time, cameras_[e.camera].role == Role::kView,
                        e.camera);
    });
    if (from.count() == 0 || order_.empty()) return;
    const TimestampNs first = rows_[order_[0].camera][order_[0].row].time;
    std::erase_if(order_, [&](const FrameEntry& e) {
      const Seconds since = rows_[e.camera][e.row].time - first;
      return since < (cameras_[e.camera].role == Role::kView ? from : from - kLightBefore);
    });
  }

  const std::vector<CameraInfo>& cameras() const override { return cameras_; }

  double view_rate() const override {
    const auto view = std::ranges::find(cameras_, Role::kView, &CameraInfo::role);
    if (view == cameras_.end()) return 0;
    const auto& rows = rows_[static_cast<std::size_t>(view - cameras_.begin())];
    const double span = rows.size() > 1 ? (rows.back().time - rows.front().time).count() : 0;
    return span > 0 ? static_cast<double>(rows.size() - 1) / span : 0;
  }

  Result<std::optional<Frame>> next() override {
    if (position_ == order_.size()) return std::nullopt;
    const FrameEntry entry = order_[position_++];  // a bad picture does not stop the rest
    const FrameRow& row = rows_[entry.camera][entry.row];
    const CameraInfo& camera = cameras_[entry.camera];
    const fs::path path = folder_ / row.file;
    PENUMBRA_ASSIGN(pixels, codec::read_frame(path));
    if (width(pixels) != camera.projection.width || height(pixels) != camera.projection.height)
      return fail(ErrorCode::kInvalid, path.string(),
                  fmt::format("has {}x{} pixels instead of {}x{}", width(pixels), height(pixels),
                              camera.projection.width, camera.projection.height));
    Frame frame{static_cast<int>(entry.camera),
                entry.row,
                row.time,
                row.exposure,
                row.pose.value_or(camera.world_from_camera),
                std::make_shared<const FramePixels>(std::move(pixels))};
    frame.opacity = row.opacity;
    return frame;
  }

 private:
  struct FrameEntry {
    std::size_t camera, row;
  };
  fs::path folder_;
  std::vector<CameraInfo> cameras_;
  std::vector<std::vector<FrameRow>> rows_;
  std::vector<FrameEntry> order_;
  std::size_t position_ = 0;
};

// ------------------------------------------------------------------------------- writing

/// The name becomes a folder and two file names.
bool is_file_name(std::string_view name) {
  return !name.empty() && name.size() <= 64 && std::ranges::all_of(name, [](unsigned char c) {
    return std::isalnum(c) || c == '-' || c == '_';
  });
}

/// The last frame written, from the list's own text; nothing if there is none.
std::optional<FrameRow> last_row(const std::string& list) {
  const auto end = list.size() - 1;  // the final line break
  const auto begin = list.rfind('\n', end - 1);
  if (begin == std::string::npos) return std::nullopt;  // only the header
  auto row = parse_row(std::string_view(list).substr(begin + 1, end - begin - 1), true, list);
  return row ? std::optional(std::move(*row)) : std::nullopt;
}

std::size_t number_of(const FrameRow& row) {
  std::size_t number = 0;
  const std::string stem = fs::path(row.file).stem().string();
  std::from_chars(stem.data(), stem.data() + stem.size(), number);
  return number;
}

Result<void> write_picture(const fs::path& path, const FramePixels& pixels) {
  if (const auto* linear = std::get_if<Image<Rgb>>(&pixels))
    return codec::write_hdr(path, *linear, codec::Depth::kFloat);
  if (const auto* deep = std::get_if<Image<Rgb16>>(&pixels)) return codec::write_frame(path, *deep);
  return codec::write_frame(path, std::get<Image<Rgb8>>(pixels));
}

}  // namespace

Result<void> check_cameras(const std::vector<CameraInfo>& cameras) {
  if (cameras.empty()) return fail(ErrorCode::kInvalid, "capture folder", "has no cameras");
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const std::string& name = cameras[i].name;
    if (!is_file_name(name))
      return fail(ErrorCode::kInvalid, "camera \"" + name + "\"",
                  "has a name with other characters than letters, digits, '-' and '_'");
    for (std::size_t j = 0; j < i; ++j)
      if (cameras[j].name == name)
        return fail(ErrorCode::kInvalid, "camera \"" + name + "\"",
                    "has a name that is used twice");
  }
  return {};
}

Result<void> check_frame(const Frame& frame, const CameraInfo& camera,
                         const std::optional<TimestampNs>& last) {
  const auto invalid = [&](std::string detail) {
    return fail(ErrorCode::kInvalid, fmt::format("{}, frame {}", camera.name, frame.sequence),
                std::move(detail));
  };
  if (camera.gives_maps ? !frame.map : !frame.pixels)
    return invalid(camera.gives_maps ? "has no map" : "has no pixels");
  const int w = frame.map ? frame.map->radiance.width() : width(*frame.pixels),
            h = frame.map ? frame.map->radiance.height() : height(*frame.pixels);
  if (w != camera.projection.width || h != camera.projection.height)
    return invalid(fmt::format("has {}x{} pixels instead of {}x{}", w, h, camera.projection.width,
                               camera.projection.height));
  if (last && frame.time < *last) return invalid("has a time before the previous frame's");
  return {};
}

Result<void> check_from(Seconds from) {
  constexpr Seconds kLongest(86400e3);
  if (from >= Seconds(0) && from <= kLongest) return {};
  return fail(ErrorCode::kInvalid, "begin of the replay",
              fmt::format("{} s is not within 0..{:.0f}", from.count(), kLongest.count()));
}

Result<std::unique_ptr<FrameSource>> open_capture_folder(const fs::path& folder, Seconds from) {
  PENUMBRA_TRY(check_from(from));
  PENUMBRA_ASSIGN(cameras, read_manifest(folder));
  return std::make_unique<FolderSource>(folder, std::move(cameras), from);
}

bool holds_capture(const fs::path& folder) {
  std::error_code ignored;
  const fs::path manifest = folder / kManifestName;
  return fs::exists(manifest, ignored) && !fs::is_empty(manifest, ignored);
}

Result<CaptureFolderWriter> CaptureFolderWriter::create(const fs::path& folder,
                                                        std::vector<CameraInfo> cameras) {
  PENUMBRA_TRY(check_cameras(cameras));
  if (holds_capture(folder))
    return fail(ErrorCode::kUnwritable, folder.string(),
                "already holds a capture: remove it, or choose another folder");
  for (const CameraInfo& camera : cameras) PENUMBRA_TRY(make_folder(folder / camera.name));
  CaptureFolderWriter writer;
  writer.folder_ = folder;
  writer.rows_.assign(cameras.size(), std::string(kListHeader) + std::string(kPoseHeader) + "\n");
  writer.cameras_ = std::move(cameras);
  return writer;
}

Result<void> CaptureFolderWriter::write(const Frame& frame) {
  const auto n = static_cast<std::size_t>(frame.camera);
  if (frame.camera < 0 || n >= cameras_.size())
    return fail(ErrorCode::kInvalid, "capture folder",
                fmt::format("has no camera {}", frame.camera));
  const auto last = last_row(rows_[n]);
  if (frame.map)
    return fail(ErrorCode::kInvalid, cameras_[n].name,
                "is a light track, which a recording holds and a capture folder does not");
  PENUMBRA_TRY(check_frame(frame, cameras_[n], last ? std::optional(last->time) : std::nullopt));
  const bool linear = std::holds_alternative<Image<Rgb>>(*frame.pixels);
  const std::string file = fmt::format("{}/{:06}.{}", cameras_[n].name,
                                       last ? number_of(*last) + 1 : 0, linear ? "exr" : "png");
  const std::string row =
      print_row({file, frame.time, frame.exposure, frame.world_from_camera, frame.opacity});
  PENUMBRA_TRY(parse_row(row, true, file));  // what cannot be read back is not written
  PENUMBRA_TRY(write_picture(folder_ / file, *frame.pixels));
  // The head tells of a column once a row has it.
  const std::size_t head = rows_[n].find('\n');
  if (frame.opacity < 1 && !std::string_view(rows_[n]).substr(0, head).ends_with(kOpacityHeader))
    rows_[n].insert(head, kOpacityHeader);
  rows_[n] += row + "\n";
  return {};
}

Result<void> CaptureFolderWriter::finish() {
  std::vector<std::string> responses;
  for (std::size_t i = 0; i < cameras_.size(); ++i) {
    const CameraInfo& camera = cameras_[i];
    std::string response = camera.response.describe();
    if (response.starts_with("table")) {  // has no name: goes into a file of its own
      response = camera.name + ".response.toml";
      PENUMBRA_TRY(calib::write_response(folder_ / response, camera.response));
    }
    responses.push_back(std::move(response));
    PENUMBRA_TRY(write_bytes(folder_ / (camera.name + ".csv"), rows_[i]));
  }
  return write_bytes(folder_ / kManifestName, print_manifest(cameras_, responses));
}

}  // namespace penumbra::capture
