// Bands of light on the mains under a rolling shutter.
#pragma once

#include <array>
#include <complex>
#include <memory>
#include <optional>
#include <vector>

#include "calib/camera/response_table.h"
#include "capture/watch/picture_history.h"

namespace penumbra::capture {

/// Light on the mains swells 100 or 120 times a second. A shutter that opens row after row turns
/// that into bands, elsewhere in each frame and the stronger the shorter the exposure. Against the
/// mean of the same exposure's frames, in which they cancel out, a wave over the rows is fitted
/// with its first overtone; its length is the same in all frames. A wave that explains most of the
/// rows' change, and goes on from frame to frame as the mains do, is taken out.
/// Limits: bands that stand still, and light of which only a part is on the mains, whose rows
/// change by their median.
/// threads: thread-bound
class MainsBands {
 public:
  static constexpr std::size_t kCandidates = 110;
  static double cycles(std::size_t candidate) { return .6 + .05 * static_cast<double>(candidate); }
  /// A wave's terms at the rows of cells.
  using Basis = std::array<std::array<double, 5>, std::size_t{PictureHistory::kGrid.rows}>;

  /// Constant, cosine, sine, and those of the overtone; and the weighted sum of squares that they
  /// leave.
  struct WaveFit {
    std::array<double, 5> terms{};
    double left = 0;
  };
  /// What a row of cells changes by, natural logarithm, and how far that can be relied on: the
  /// reciprocal of its variance, 0 where nothing tells.
  struct RowChange {
    double log, weight;
  };
  /// Natural logarithm of what the rows of a frame are too bright by, by a row's place from 0 to 1.
  struct Wave {
    double cycles = 0;                   // in a picture's height
    double offset = 0;                   // of the whole frame
    std::array<double, 4> amplitudes{};  // cosine, sine; of the overtone
    double reach = 0;                    // of any row, in any frame of its exposure of late
    double at(double place) const;
    double amplitude() const;
  };
  /// Nothing where no bands are seen.
  std::optional<Wave> find(const PictureHistory::Comparison& seen);
  /// What of its waves stands still in the exposure that was looked at last, and so is one of the
  /// mean.
  const Wave& standing() const { return standing_; }
  /// True once the scene itself has changed, and the mean says nothing more.
  bool scene_changed() const { return scene_changed_; }
  /// True when all of the light has changed at once, by more than mains do.
  bool light_changed() const { return light_changed_; }

 private:
  static constexpr std::size_t kLevels = 5;
  struct OfExposure {
    int exposure;
    int waves = 0;                         // frames of late that a wave explains
    int strange = 0;                       // frames in a row that none does
    std::array<double, kLevels> levels{};  // of whole frames, of late
    std::size_t level_count = 0;
    double reach = 0;  // of the waves of late
    int averaged = 0;  // waves in the mean one
    std::array<double, 4> mean{};
    std::complex<double> place{};  // of the last wave, on the unit circle
    TimestampNs time{};
    // Cosine, in the mean of late, between how far the wave went and how far 100 Hz and 120 Hz
    // would take it, one way and the other
    std::array<double, 4> agrees{};
  };
  double centre_rows();
  double squares_of_rows() const;
  void drop_outliers(const WaveFit& fit, std::size_t candidate);
  int rows_that_tell() const;
  bool advances_with_mains(OfExposure& seen, const Wave& wave, TimestampNs time);
  OfExposure& of(int exposure);
  void find_rows(const PictureHistory::Comparison& seen);
  std::size_t best_candidate(double varied);
  void follow_level(OfExposure& seen, Wave& wave);

  std::array<double, kCandidates> left_{};  // of a row's change, by wavelength, of late
  std::vector<OfExposure> exposures_;
  std::complex<double> phase_;  // mean of late
  bool scene_changed_ = false;
  bool light_changed_ = false;
  Wave standing_;
  std::vector<RowChange> rows_;
  std::vector<double> offs_;
  struct CellChange {
    double ratio, weight;
  };
  std::vector<CellChange> row_;
};

struct BandRemoval {
  const MainsBands::Wave& wave;
  const ResponseTable& curve;
  double black_level;
  /// Of the same scene, `ratio` times darker and of the same kind; null: there is none.
  const FramePixels* shorter = nullptr;
  double ratio = 1;
};

/// The picture with a wave taken out of its rows. What the wave brings above the clip level in some
/// frames is seen in the others only, and there in part: a shorter exposure stands in for it.
std::shared_ptr<const FramePixels> without_bands(const FramePixels& pixels,
                                                 const BandRemoval& removal);

}  // namespace penumbra::capture
