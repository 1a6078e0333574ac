// Cameras and what becomes of their frames: capture folders, the synthetic studio, HDR merge, and
// the assembly of a lat-long environment. Nothing here knows spherical harmonics.
// threads: classes
// are thread-bound (one thread at a time), free functions reentrant
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calib/calib.h"
#include "capture/cameras.h"            // IWYU pragma: export
#include "capture/environment_blend.h"  // IWYU pragma: export
#include "capture/frames.h"             // IWYU pragma: export
#include "capture/recording.h"          // IWYU pragma: export
#include "capture/rig.h"                // IWYU pragma: export
#include "capture/seen_grid.h"          // IWYU pragma: export
#include "capture/shared_surfaces.h"    // IWYU pragma: export
#include "capture/sights.h"             // IWYU pragma: export
#include "capture/stacks.h"             // IWYU pragma: export
#include "core/code_curve.h"
#include "core/environment.h"
#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "core/units.h"

namespace penumbra::capture {

// ------------------------------------------------------------------------------ capture folder

/// Opens a folder with capture.toml (design in docs/capture-folder.md). Everything that can be
/// checked without decoding a picture is checked here: keys, sizes, exposures (positive, finite),
/// times (non-decreasing), files present.
/// errors: kNotFound, kInvalid (unknown key, bad value: file
/// and line), kUnreadable
Result<std::unique_ptr<FrameSource>> open_capture_folder(const std::filesystem::path& folder);

/// A camera on its own (for `render`): `version = 1` and one [[camera]] without frames.
/// errors: kNotFound, kUnreadable, kInvalid
Result<CameraInfo> read_camera_file(const std::filesystem::path& path);

/// Whether a finished capture stands there.
bool holds_capture(const std::filesystem::path& folder);

/// Writes a capture folder frame by frame: 8 and 16 bit frames as PNG, float ones as EXR.
/// capture.toml is written by finish(), so an unfinished folder is not a capture.
class CaptureFolderWriter {
 public:
  /// errors: kUnwritable
  static Result<CaptureFolderWriter> create(const std::filesystem::path& folder,
                                            std::vector<CameraInfo> cameras);
  Result<void> write(const Frame& frame);
  Result<void> finish();

 private:
  CaptureFolderWriter() = default;
  std::filesystem::path folder_;
  std::vector<CameraInfo> cameras_;
  std::vector<std::string> rows_;  // one CSV text per camera
};

// ------------------------------------------------------------------------------ HDR merge

/// Registered pictures of one camera at different exposures.
struct ExposureStack {
  std::vector<std::shared_ptr<const FramePixels>> frames;
  std::vector<Exposure> exposures;
  calib::Response response;  // unused for float frames, which are linear
  calib::NoiseModel noise;
  double black_level = 0;
  /// Most trusted first: samples that contradict a more trusted one by more than the noise explains are left out.
  /// Empty: nothing moved between the exposures, and all count.
  std::vector<std::size_t> trust{};
  bool noise_known = true;  // of a guess, more has to be explained
  /// For each frame 1 where it shows anything; empty: everywhere. A frame's own may be empty, too.
  std::vector<Image<std::uint8_t>> valid{};
};

/// Code curve of a response at 8 or 16 bits.
CodeCurve make_code_curve(const calib::Response& response, int bits, double black_level);

struct MergedImage {
  Image<HalfRgba> pixels;  // radiance / `scale`; fourth channel 0 where every exposure is clipped
  float scale = 1;         // relative radiance of a stored 1
  double clipped_fraction = 0;  // of the pixels
  double black_fraction = 0;    // of the samples: under twice the noise in the longest exposure
};

/// Maximum-likelihood radiance x = sum w_k x_k / sum w_k with w_k = 1/var_k(x), two iterations from
/// the Poisson estimator sum y_k / sum e_k; codes above 95 % of full scale do not count. Negative
/// results are kept; a pixel that is clipped everywhere gets the lower bound of its shortest
/// exposure.
/// errors:  kInvalid (no frames, sizes or kinds differ, exposure not positive and
/// finite),
///          kUndetermined (all black, all clipped)
/// source:  Granados et al. 2010; start Hanji et al. 2020; weights Hasinoff et al. 2010
struct MergedFloat {
  Image<Rgb> radiance;
  Image<std::uint8_t> clipped;  // 1 where clipped in every exposure, in any channel
  double clipped_fraction = 0, black_fraction = 0;
};
Result<MergedFloat> merge(const ExposureStack& stack);

class TableMerger;  // private: table_merger.h

/// The merge at camera rate: every new frame replaces the one of its exposure and publishes a new image. What moved or
/// changed since an older exposure was taken leaves no ghost: older samples that contradict newer ones by the noise
/// model are left out, and light that thereby vanished from one place while another became brighter than the newest
/// exposure can tell stays whole (a lamp that moves; frames of 8 bits) until a shorter exposure has seen it. When the camera
/// turns (Frame::world_from_camera) older exposures are turned with it; what they did not see is taken from the newest.
/// source: sample rejection at 3.5 sigma, Granados et al. 2010
class HdrRing {
 public:
  HdrRing(CameraInfo camera, int slots);
  ~HdrRing();
  HdrRing(HdrRing&&) noexcept;
  HdrRing& operator=(HdrRing&&) noexcept;
  /// errors: kInvalid (size changed, bad exposure), kUndetermined as merge()
  Result<const MergedImage*> add(const Frame& frame);
  /// Different exposures that stand in the ring.
  std::size_t exposures() const { return slots_.size(); }
  /// False while a shorter exposure may still come: until one came back, or so many different ones stand in the ring.
  bool knows_bracket() const { return came_back_ || slots_.size() >= kUsualBracket; }

 private:
  static constexpr std::size_t kUsualBracket = 4;
  struct Slot {
    Frame frame;
    Exposure nominal;          // as its exposure came first; flicker moves the frames' own
    double gain_log = 0;       // of late, in the mean
    std::uint64_t placed = 0;  // frames that the ring had taken before
    // As the camera would have seen it from where it looks now; null: as it is.
    std::shared_ptr<const FramePixels> turned{};
    Image<std::uint8_t> valid{};  // of `turned`
    const std::shared_ptr<const FramePixels>& pixels() const {
      return turned ? turned : frame.pixels;
    }
  };
  bool turn_to(const Frame& newest);
  void fill_unseen(Slot& slot, const Frame& newest) const;
  Slot* slot_of(const Exposure& exposure);
  Result<void> merge_now(const std::optional<Frame>& replaced);
  Result<void> merge_all();
  CameraInfo camera_;
  std::size_t most_slots_;
  bool came_back_ = false;   // an exposure
  bool was_turned_ = false;  // some slot, at the last merge
  std::uint64_t taken_ = 0;
  std::vector<Slot> slots_;  // longest exposure first
  std::vector<Exposure> table_exposures_;
  std::unique_ptr<TableMerger> table_;
  MergedImage merged_;
};

// ------------------------------------------------------------------------------ environment

struct GatherTap;  // private: gather_kernel.h

/// Gathers a camera's merged image into a lat-long environment in world directions.
class EnvironmentAssembler {
 public:
  EnvironmentAssembler(const calib::Projection& projection, const Pose& world_from_camera,
                       int width, int height, const glm::dmat3& colour = glm::dmat3(1));
  EnvironmentAssembler(const Sight& sight, const Pose& world_from_camera, int width, int height,
                       const glm::dmat3& colour = glm::dmat3(1));
  ~EnvironmentAssembler();
  EnvironmentAssembler(EnvironmentAssembler&&) noexcept;
  EnvironmentAssembler& operator=(EnvironmentAssembler&&) noexcept;
  /// Bilinear gather; where the camera does not look, radiance and confidence are 0.
  /// threads: internally parallel; no allocation once `out` has its size and has held as many
  /// clipped pixels
  void assemble(const MergedImage& merged, Environment& out);

 private:
  void make_taps(const Look& look, const glm::dquat& camera_from_world);
  void list_seen();
  void gather_rows(int first_row, int last_row, const std::uint16_t* source, float scale,
                   Image<Rgb>& out);
  void list_clipped(const Image<HalfRgba>& source, std::vector<std::uint32_t>& out) const;
  struct Span {
    int first, last;  // columns [first, last) of a row hold everything that is seen
  };
  glm::mat3 colour_;
  int source_width_, source_height_, width_, height_;
  bool complete_ = true;
  std::vector<Span> spans_;      // one a row
  std::vector<int> seen_;        // pixels a row
  std::vector<double> alpha_;    // sum of the confidence a row, of the newest image
  std::vector<GatherTap> taps_;  // empty: the source is the environment already
  std::vector<float> gains_;     // by pixel of the map, against vignetting; empty: all 1
};

/// An environment file in any supported projection as directions, solid angles and radiance. The
/// mapping comes from the OpenEXR attribute where there is one, else from `projection`, else from
/// the shape: 2:1 lat-long, 3:4 vertical cross, 1:1 angular. Non-finite pixels get no solid angle.
struct EnvironmentFile {
  calib::Projection projection;
  calib::ProjectionTable table;
  Image<Rgb> radiance;
  std::size_t non_finite = 0;
};
Result<EnvironmentFile> read_environment(const std::filesystem::path& path,
                                         std::optional<calib::ProjectionKind> projection);
/// Any of them resampled to lat-long (a plain lat-long file keeps its pixels).
Result<Image<Rgb>> to_latlong(const EnvironmentFile& file);

// ------------------------------------------------------------------------------ synthetic studio

/// What the studio's cameras look at.
/// threads: reentrant
class World {
 public:
  virtual ~World() = default;
  /// Linear radiance arriving at `origin` from `direction`.
  virtual Rgb radiance(const glm::dvec3& origin, const glm::dvec3& direction) const = 0;
  /// The far light alone, without the floor: what an environment camera brackets.
  virtual Rgb far_radiance(const glm::dvec3& direction) const = 0;
};

/// A far environment over a textured diffuse floor y = 0. The floor takes its colour from the
/// environment's own ground, seen from kCaptureHeight above the origin, and fine detail from a
/// procedural texture; it is lit by the environment. Radiance is scaled so that the mean luminance
/// over the sphere is kMeanLuminance: full scales a second at gain 1, the light of a room for usual
/// exposure times.
class FloorWorld : public World {
 public:
  static constexpr double kCaptureHeight = .8, kMeanLuminance = 60;
  /// errors: kInvalid (no pixels), kNonFinite, kUndetermined (black)
  static Result<std::shared_ptr<FloorWorld>> make(Image<Rgb> latlong);
  Rgb radiance(const glm::dvec3& origin, const glm::dvec3& direction) const override;
  Rgb far_radiance(const glm::dvec3& direction) const override;

  Rgb floor_albedo(const glm::dvec3& position) const;
  Rgb mean_floor_albedo() const { return mean_albedo_; }  // around the origin
  Rgb floor_irradiance() const { return irradiance_; }    // exact, from every pixel of the map
  const Image<Rgb>& environment() const { return map_; }

 private:
  FloorWorld() = default;
  Image<Rgb> map_;
  Rgb irradiance_, mean_albedo_;
  float albedo_scale_ = 1;
};

/// The built-in interior: a white room with a window, two ceiling panels, a warm wall and a lamp.
Image<Rgb> make_room_environment(int width, int height);
/// Clear sky with a sun disc (radius .2666 degrees) of the given elevation, over grey ground.
Image<Rgb> make_sky_environment(int width, int height, double sun_elevation_rad);
/// Sky, ground and up to four lamps, windows or suns drawn at random: scenes for calibration and its proof.
Image<Rgb> make_random_environment(int width, int height, std::uint32_t seed);

/// From radiance to codes: blur of the optics, exposure, vignetting, shot and read noise, black
/// level, clipping, response, quantisation.
struct Sensor {
  calib::Response response;
  calib::NoiseModel noise;
  double black_level = 0;
  double vignetting = 0;    // relative loss of light in the corners
  double psf_sigma_px = 0;  // Gaussian blur in linear light, before noise
  int bits = 8;             // 8 or 16
  bool noisy = true;
};

/// The largest blur that a camera may have.
inline constexpr double kLargestPsfSigma = 20;

/// Blurs by a Gaussian of this sigma, 0 to kLargestPsfSigma; beyond its edges the picture goes on
/// as it is there.
void blur(Image<Rgb>& picture, double sigma_px);

/// out must have the size of `radiance`. The noise depends on (seed, pixel) alone.
/// source: Poisson shot noise and Gaussian read noise, Hasinoff et al. 2010
void expose(const Sensor& sensor, const Image<Rgb>& radiance, Exposure exposure, std::uint64_t seed,
            FramePixels& out);

struct StudioOptions {
  int environment_width = 1024, environment_height = 512;
  int view_width = 1280, view_height = 720;
  Pose world_from_view;  // where the view camera stands
  double view_focal_px = 1100;
  double environment_fps = 30, view_fps = 30;
  std::vector<Exposure> schedule;  // of the environment camera; empty: chosen from the light
  std::optional<Exposure>
      view_exposure;  // nothing: chosen so that the floor is at 30 % of full scale
  Sensor sensor;      // of both cameras; the blur is the view camera's alone
  /// Frames between a requested exposure and its effect; labels always say what was applied.
  int control_delay_frames = 0;
  int drop_every = 0;  // every n-th frame of each camera never arrives; 0 = none
  int view_frames = 120;
  std::uint64_t seed = 1;
  /// Distinct noise patterns of either camera (of every exposure), filmed before the first frame; 0: each frame new.
  int clip = 0;
};

/// The world seen by an environment camera (lat-long, at (0, 1, 0)) and a view camera (pinhole).
class Studio : public FrameSource {
 public:
  Studio(std::shared_ptr<const World> world, StudioOptions options);
  const std::vector<CameraInfo>& cameras() const override { return cameras_; }
  Result<std::optional<Frame>> next() override;
  double view_rate() const override { return options_.view_fps; }

  std::span<const Exposure> schedule() const { return options_.schedule; }
  Exposure view_exposure() const { return *options_.view_exposure; }
  /// The view camera's linear picture, blurred, without noise: the truth behind every view frame.
  const Image<Rgb>& view_radiance() const { return view_radiance_; }

 private:
  std::shared_ptr<const FramePixels> film(int camera, const Exposure& exposure,
                                          std::uint64_t seed) const;
  Frame environment_frame(std::uint64_t index);
  Frame view_frame(std::uint64_t index);
  StudioOptions options_;
  std::shared_ptr<const World> world_;
  std::vector<CameraInfo> cameras_;
  Image<Rgb> environment_radiance_, view_radiance_;  // with the blur of their cameras
  std::vector<std::shared_ptr<const FramePixels>> environment_clip_, view_clip_;
  std::uint64_t next_environment_ = 0, next_view_ = 0;
};

/// The fewest exposures that cover the light's range (methods: schedule), longest first, times in
/// seconds within [1/64000, 1/30] at gain 1.
std::vector<Exposure> choose_schedule(const Image<Rgb>& environment, const Sensor& sensor);

/// A camera at `eye` that looks at `target`, +y up.
Pose look_at(const glm::dvec3& eye, const glm::dvec3& target);

}  // namespace penumbra::capture
