#include "prt/clip/internal/sequence_codec.h"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

#include "codec/codec.h"
#include "codec/range_coder.h"
#include "core/half.h"
#include "core/threads/parallel.h"

namespace penumbra::prt {

namespace {

// A walk's transfer has some thirty components that are worth their bytes; a clip of many moves has
// as many for each.
constexpr int kLongestSpan = 128;  // frames
constexpr std::size_t kPad = TransferSequence::kLanes;
constexpr std::size_t kMaxValues = std::size_t{1} << 28;

std::size_t padded(std::size_t count) {
  return (count + kPad - 1) / kPad * kPad;
}

}  // namespace

StreamLayout layout_of_surface(const SurfaceLayout& layout) {
  return {layout.bone, layout.neighbours, layout.vertices};
}

StreamLayout layout_of_ground(int size) {
  const auto side = static_cast<std::uint32_t>(size);
  StreamLayout out;
  out.bone.assign(std::size_t{side} * side, 0);
  for (std::uint32_t y = 0; y < side; ++y)
    for (std::uint32_t x = 0; x < side; ++x) {
      const std::uint32_t p = y * side + x;
      constexpr auto kNoPoint = SurfaceLayout::kNone;
      out.neighbours.push_back({x > 0 ? p - 1 : kNoPoint, y > 0 ? p - side : kNoPoint,
                                x > 0 && y > 0 ? p - side - 1 : kNoPoint});
    }
  return out;
}

namespace {

struct PointGroup {
  std::uint16_t bone;
  std::size_t first, count;  // in the order
};

std::vector<std::uint32_t> order_by_bone(const StreamLayout& layout) {
  std::vector<std::uint32_t> order(layout.bone.size());
  std::iota(order.begin(), order.end(), 0u);
  std::ranges::stable_sort(order, {}, [&](std::uint32_t p) { return layout.bone[p]; });
  return order;
}

std::vector<PointGroup> groups_of(const StreamLayout& layout,
                                  const std::vector<std::uint32_t>& order) {
  std::vector<PointGroup> out;
  for (std::size_t i = 0; i < order.size(); ++i) {
    const std::uint16_t bone = layout.bone[order[i]];
    if (out.empty() || out.back().bone != bone) out.push_back({bone, i, 0});
    ++out.back().count;
  }
  return out;
}

/// What transfer in a coefficient's band is worth, as a factor of its amplitude.
float band_weight(int l) {
  return std::sqrt(mean_band_energy()[static_cast<std::size_t>(l)]);
}

int band_of(int n) {
  return static_cast<int>(std::sqrt(static_cast<double>(n) + .5));
}

/// Frames that share principal components.
struct FrameSpan {
  int first, count;
};

std::vector<FrameSpan> spans_of(int frames) {
  const int spans = (frames + kLongestSpan - 1) / kLongestSpan;
  std::vector<FrameSpan> out;
  for (int i = 0; i < spans; ++i) {
    const int first = frames * i / spans;
    out.push_back({first, frames * (i + 1) / spans - first});
  }
  return out;
}

}  // namespace

// Weighted values of one group, plane and span over time, and their principal components.
class SequenceCodec::Encoder {
 public:
  // error: that run() is going to ask for
  Encoder(std::span<const Transfer> frames, const StreamLayout& layout, double error)
      : frames_(frames),
        order_(order_by_bone(layout)),
        coefficients_(coefficient_count(frames[0].bands)),
        error_(error) {
    for (const PointGroup& g : groups_of(layout, order_))
      for (int plane = 0; plane < frames[0].channels; ++plane)
        for (const FrameSpan& span : spans_of(static_cast<int>(frames.size())))
          parts_.push_back({g, plane, span, {}, {}, {}});
    parallel_for(std::size_t{0}, parts_.size(), [&](std::size_t i) { analyse(parts_[i]); });
  }

  Outcome run() {
    const double samples =
        3. * static_cast<double>(frames_.size()) * static_cast<double>(frames_[0].points);
    const double allowed = error_ * error_ * samples;
    // No value may leave its sixteen bits; and where the components end, so does what finer steps
    // can win.
    float low = finest_step(), high = std::max(1.f, 2 * low);
    const double reachable = std::max(allowed, 1.1 * error_at(low));
    while (error_at(high) < reachable && high < 1e3f) high *= 2;
    for (int i = 0; i < 24; ++i) {
      const float middle = std::sqrt(low * high);
      (error_at(middle) <= reachable ? low : high) = middle;
    }
    while (values_at(low) > kMaxValues) low *= 1.1f;
    return {quantise(low), std::sqrt(error_at(low) / samples)};
  }

 private:
  struct PointPart {
    PointGroup group;
    int plane;
    FrameSpan span;
    Eigen::MatrixXf maps;     // column 0: the mean; k: U_k, by row = coefficient * count + point
    Eigen::MatrixXf weights;  // frames x components, of mean square 1
    // Of each component and, last, of all further ones; over the span's frames
    std::vector<double> energy;
  };

  // An error of green, or of grey, is one of all three colours.
  static double worth(const PointPart& part) { return part.plane == 0 ? 3 : 1; }

  float value(const Transfer& t, int plane, int n, std::size_t point) const {
    if (t.channels == 1) return t.value(0, n, point);
    const float green = t.value(1, n, point);
    return plane == 0 ? green : t.value(plane == 1 ? 0 : 2, n, point) - green;
  }

  void analyse(PointPart& part) {
    const auto count = static_cast<Eigen::Index>(part.group.count);
    const Eigen::Index rows = count * coefficients_, columns = part.span.count;
    Eigen::MatrixXf x(rows, columns);
    for (Eigen::Index f = 0; f < columns; ++f)
      for (int n = 0; n < coefficients_; ++n)
        for (Eigen::Index p = 0; p < count; ++p)
          x(n * count + p, f) =
              band_weight(band_of(n)) *
              value(frames_[static_cast<std::size_t>(part.span.first + f)], part.plane, n,
                    order_[part.group.first + static_cast<std::size_t>(p)]);
    // Equal frames keep their mean to the last bit.
    const Eigen::VectorXf mean =
        (x.array() == x.col(0).replicate(1, columns).array()).all()
            ? Eigen::VectorXf(x.col(0))
            : Eigen::VectorXf(x.cast<double>().rowwise().mean().cast<float>());
    x.colwise() -= mean;
    const Eigen::MatrixXd gram = (x.transpose() * x).cast<double>();
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(gram);
    double rest = std::max(0., gram.trace());
    const Eigen::Index kept = worth_keeping(part, rest, solver.eigenvalues());
    part.weights.resize(columns, kept);
    part.maps.resize(rows, kept + 1);
    part.maps.col(0) = mean;
    const double root = std::sqrt(static_cast<double>(columns));
    for (Eigen::Index k = 0; k < kept; ++k) {
      const Eigen::Index from = columns - 1 - k;  // Eigen sorts upwards
      Eigen::VectorXf v = (root * solver.eigenvectors().col(from)).cast<float>();
      for (float& w : v) w = float_from_half(half_from_float(w));  // as it is stored
      part.weights.col(k) = v;
      part.maps.col(k + 1) = x * v / static_cast<float>(columns);
      part.energy.push_back(std::max(0., solver.eigenvalues()(from)));
      rest -= part.energy.back();
    }
    part.energy.push_back(std::max(0., rest));
  }

  // Components until what is left of them does not count in the error.
  Eigen::Index worth_keeping(const PointPart& part, double rest,
                             const Eigen::VectorXd& energies) const {
    constexpr double kFraction = .02;
    const double fraction = static_cast<double>(part.group.count) * part.span.count * kFraction;
    const Eigen::Index largest = energies.size() - 1;
    Eigen::Index k = 0;
    for (; k < largest && rest > error_ * error_ * fraction; ++k) rest -= energies(largest - k);
    return k;
  }

  // A component is worth its bits when its values' variance is above that of the step's rounding.
  bool keeps(const PointPart& part, std::size_t k, float step) const {
    const double values =
        static_cast<double>(part.span.count) * static_cast<double>(part.maps.rows());
    return part.energy[k] > values * step * step / 4;
  }

  double error_at(float step) {
    std::vector<double> errors(parts_.size());
    parallel_for(std::size_t{0}, parts_.size(), [&](std::size_t i) {
      const PointPart& part = parts_[i];
      const auto frames = static_cast<double>(part.span.count);
      const auto rounding = [&](Eigen::Index column) {
        double sum = 0;
        for (Eigen::Index r = 0; r < part.maps.rows(); ++r) {
          const float v = part.maps(r, column);
          const float away = v - step * std::nearbyint(v / step);
          sum += double(away) * double(away);
        }
        return sum;
      };
      double error = frames * rounding(0) + part.energy.back();
      for (std::size_t k = 0; k + 1 < part.energy.size(); ++k)
        error += keeps(part, k, step) ? frames * rounding(static_cast<Eigen::Index>(k) + 1)
                                      : part.energy[k];
      errors[i] = worth(part) * error;
    });
    return std::accumulate(errors.begin(), errors.end(), 0.);
  }

  // That a reader has to hold.
  std::size_t values_at(float step) const {
    std::size_t sum = 0;
    for (const PointPart& part : parts_) {
      std::size_t columns = 1;
      for (std::size_t k = 0; k + 1 < part.energy.size(); ++k) columns += keeps(part, k, step);
      sum += columns * static_cast<std::size_t>(coefficients_) * padded(part.group.count);
    }
    return sum;
  }

  float finest_step() const {
    float largest = 0;
    for (const PointPart& part : parts_)
      if (part.maps.size() > 0) largest = std::max(largest, part.maps.cwiseAbs().maxCoeff());
    return std::max(1e-7f, largest / 32000);
  }

  TransferSequence quantise(float step) const {
    TransferSequence out;
    out.bands_ = frames_[0].bands;
    out.channels_ = frames_[0].channels;
    out.frames_ = static_cast<int>(frames_.size());
    out.points_ = frames_[0].points;
    out.order_ = order_;
    for (int l = 0; l < out.bands_; ++l)
      out.step_.push_back(band_weight(l) > 0 ? step / band_weight(l) : 0);
    for (const PointPart& part : parts_) {
      if (part.span.first == 0)
        out.groups_.push_back(
            {part.group.bone, part.plane, part.group.first, part.group.count, {}});
      for (std::size_t k = 0; k < part.energy.size(); ++k)
        if (k == 0 || keeps(part, k - 1, step))
          out.groups_.back().components.push_back(component(part, k, step, out));
    }
    out.finish_maps();
    return out;
  }

  TransferSequence::Component component(const PointPart& part, std::size_t k, float step,
                                        TransferSequence& out) const {
    TransferSequence::Component c{part.span.first, part.span.count, {}, {}};
    const auto column = static_cast<Eigen::Index>(k);
    if (k > 0)
      for (Eigen::Index f = 0; f < part.weights.rows(); ++f)
        c.weight.push_back(part.weights(f, column - 1));
    const auto count = static_cast<Eigen::Index>(part.group.count);
    for (int n = 0; n < coefficients_; ++n) {
      std::vector<std::int16_t> map(padded(part.group.count), 0);
      bool any = false;
      for (Eigen::Index p = 0; p < count; ++p) {
        const float v = std::nearbyint(part.maps(n * count + p, column) / step);
        map[static_cast<std::size_t>(p)] = static_cast<std::int16_t>(v);
        any |= v != 0;
      }
      c.maps.push_back(
          {any ? static_cast<std::uint32_t>(out.values_.size()) : TransferSequence::kNone});
      if (any) out.values_.insert(out.values_.end(), map.begin(), map.end());
    }
    return c;
  }

  std::span<const Transfer> frames_;
  std::vector<std::uint32_t> order_;
  int coefficients_;
  double error_;
  std::vector<PointPart> parts_;
};

double SequenceCodec::rendered_rms(std::span<const Transfer> frames) {
  double sum = 0, samples = 0;
  for (const Transfer& t : frames)
    for (int c = 0; c < t.channels; ++c) {
      for (int n = 0; n < coefficient_count(t.bands); ++n)
        for (std::size_t p = 0; p < t.points; ++p)
          sum += std::pow(double(band_weight(band_of(n))) * t.value(c, n, p), 2);
      samples += static_cast<double>(t.points);
    }
  return samples > 0 ? std::sqrt(sum / samples) : 0;
}

SequenceCodec::Outcome SequenceCodec::encode(std::span<const Transfer> frames,
                                             const StreamLayout& layout, double error) {
  if (frames.empty() || frames[0].points == 0) return {};
  return Encoder(frames, layout, error).run();
}

// ---------------------------------------------------------------------------------- bytes

namespace {

// What earlier values of a map say of the next, and how restless it is around there.
struct ValuePrediction {
  int value, activity;
};

class MapCoder {
 public:
  // place: of each point in its group
  MapCoder(const StreamLayout& layout, const std::vector<std::uint32_t>& order,
           const std::vector<std::uint32_t>& place)
      : layout_(layout), order_(order), place_(place) {}

  template <class Code>
  void for_values(const PointGroup& group, bool predict, std::int16_t* map, const Code& code) {
    residual_.assign(group.count, 0);
    for (std::size_t i = 0; i < group.count; ++i) {
      const ValuePrediction g = guess(group, i, map);
      const int base = predict ? g.value : 0;
      const int value = code(map[i], base, g.activity);
      map[i] = static_cast<std::int16_t>(value);
      residual_[i] = std::min(std::abs(value - base), 64);
    }
  }

 private:
  ValuePrediction guess(const PointGroup& group, std::size_t i, const std::int16_t* map) const {
    int value[3] = {}, known = 0, restless = 0;
    bool all = true;
    for (const std::uint32_t n : layout_.neighbours[order_[group.first + i]]) {
      if (n == SurfaceLayout::kNone) {
        all = false;
        continue;
      }
      const std::uint32_t at = place_[n];
      value[known++] = map[at];
      restless += residual_[at];
    }
    if (known == 0) {
      const int before = i > 0 ? map[i - 1] : 0;
      return {before, i > 0 ? activity(residual_[i - 1]) : kActivities - 1};
    }
    const int mean_restless = restless / known;
    // Texels with three neighbours: what a plane through them says, within their range.
    if (all && order_[group.first + i] >= layout_.first_texel) {
      const int low = std::min(value[0], value[1]), high = std::max(value[0], value[1]);
      return {std::clamp(value[0] + value[1] - value[2], low, high), activity(mean_restless)};
    }
    int sum = 0;
    for (int k = 0; k < known; ++k) sum += value[k];
    return {sum >= 0 ? (sum + known / 2) / known : -((-sum + known / 2) / known),
            activity(mean_restless)};
  }
  static int activity(int r) { return r == 0 ? 0 : r == 1 ? 1 : r <= 3 ? 2 : r <= 8 ? 3 : 4; }

 public:
  static constexpr int kActivities = 5;

 private:
  const StreamLayout& layout_;
  const std::vector<std::uint32_t>& order_;
  const std::vector<std::uint32_t>& place_;
  std::vector<int> residual_;
};

// A number's models by how restless it is around, by band and by component.
struct ValueModels {
  codec::NumberModel number[4][3][MapCoder::kActivities];
  codec::NumberModel& at(std::size_t component, int band, int activity) {
    return number[std::min<std::size_t>(component, 3)][std::min(band, 2)][activity];
  }
};

std::vector<std::uint32_t> places_in_groups(const std::vector<std::uint32_t>& order,
                                            const std::vector<PointGroup>& groups) {
  std::vector<std::uint32_t> place(order.size());
  for (const PointGroup& g : groups)
    for (std::size_t i = 0; i < g.count; ++i)
      place[order[g.first + i]] = static_cast<std::uint32_t>(i);
  return place;
}

class ByteStream {
 public:
  template <class T>
  void put(T value) {
    const auto* p = reinterpret_cast<const unsigned char*>(&value);
    out_.insert(out_.end(), p, p + sizeof value);
  }
  void put(std::span<const unsigned char> bytes) {
    out_.insert(out_.end(), bytes.begin(), bytes.end());
  }
  std::vector<unsigned char> take() { return std::move(out_); }

 private:
  std::vector<unsigned char> out_;
};

class ByteReader {
 public:
  explicit ByteReader(std::span<const unsigned char> bytes) : bytes_(bytes) {}
  template <class T>
  bool get(T& value) {
    if (bytes_.size() - at_ < sizeof value) return false;
    std::memcpy(&value, bytes_.data() + at_, sizeof value);
    at_ += sizeof value;
    return true;
  }
  std::size_t left() const { return bytes_.size() - at_; }
  std::size_t at() const { return at_; }
  std::span<const unsigned char> rest() const { return bytes_.subspan(at_); }

 private:
  std::span<const unsigned char> bytes_;
  std::size_t at_ = 0;
};

struct StreamHead {
  std::uint32_t points;
  std::uint16_t frames;
  std::uint8_t bands, channels;
};

}  // namespace

std::vector<unsigned char> SequenceCodec::write(const TransferSequence& s,
                                                const StreamLayout& layout) {
  ByteStream out;
  out.put(StreamHead{static_cast<std::uint32_t>(s.points_), static_cast<std::uint16_t>(s.frames_),
                     static_cast<std::uint8_t>(s.bands_), static_cast<std::uint8_t>(s.channels_)});
  if (s.points_ == 0) return out.take();
  for (const float step : s.step_) out.put(step);
  for (const TransferSequence::BoneGroup& g : s.groups_) {
    for (const FrameSpan& span : spans_of(s.frames_))
      out.put(static_cast<std::uint8_t>(
          std::ranges::count(g.components, span.first, &TransferSequence::Component::first_frame)));
    for (const TransferSequence::Component& c : g.components)
      for (const float w : c.weight) out.put(half_from_float(w));
  }
  const std::vector<PointGroup> groups = groups_of(layout, s.order_);
  const std::vector<std::uint32_t> place = places_in_groups(s.order_, groups);
  MapCoder coder(layout, s.order_, place);
  auto models = std::make_unique<ValueModels>();
  codec::BitModel zero_map, predicted;
  codec::RangeEncoder range;
  for (std::size_t i = 0; i < s.groups_.size(); ++i) {
    const TransferSequence::BoneGroup& g = s.groups_[i];
    const PointGroup& points = groups[i / static_cast<std::size_t>(s.channels_)];
    std::size_t k = 0;  // in the span
    for (const TransferSequence::Component& c : g.components) {
      if (c.weight.empty()) k = 0;
      for (std::size_t n = 0; n < c.maps.size(); ++n) {
        const TransferSequence::Map& kept = c.maps[n];
        range.bit(zero_map, kept.none());
        if (kept.none()) continue;
        std::vector<std::int16_t> map(
            s.values_.begin() + kept.offset,
            s.values_.begin() + kept.offset + static_cast<std::ptrdiff_t>(g.count));
        long with = 0, without = 0;
        coder.for_values(points, true, map.data(), [&](int v, int base, int) {
          with += std::abs(v - base);
          without += std::abs(v);
          return v;
        });
        const bool predict = with < without;
        range.bit(predicted, predict);
        coder.for_values(points, predict, map.data(), [&](int v, int base, int activity) {
          models->at(k, band_of(static_cast<int>(n)), activity).encode(range, v - base);
          return v;
        });
      }
      ++k;
    }
  }
  const std::vector<unsigned char> body = std::move(range).finish();
  out.put(std::span(body));
  return out.take();
}

Result<TransferSequence> SequenceCodec::read(std::span<const unsigned char> bytes,
                                             const StreamLayout& layout, const std::string& name) {
  ByteReader in(bytes);
  const auto damaged = [&](const std::string& what) {
    return fail(ErrorCode::kUnreadable, name,
                fmt::format("is damaged at byte {}: {}", in.at(), what));
  };
  StreamHead head{};
  if (!in.get(head)) return damaged("a stream of transfer is cut off");
  TransferSequence s;
  if (head.points == 0) return s;
  if (head.points != layout.bone.size())
    return damaged(fmt::format("it has {} points instead of {}", head.points, layout.bone.size()));
  if (head.bands < 1 || head.bands > kMaxBands || (head.channels != 1 && head.channels != 3) ||
      head.frames < 1)
    return damaged("bands, channels or frames are out of range");
  s.points_ = head.points;
  s.frames_ = head.frames;
  s.bands_ = head.bands;
  s.channels_ = head.channels;
  for (int l = 0; l < s.bands_; ++l) {
    float step = 0;
    if (!in.get(step) || !(step >= 0 && step < 1e6f))
      return damaged("a quantisation step is not a number");
    s.step_.push_back(step);
  }
  s.order_ = order_by_bone(layout);
  const std::vector<PointGroup> groups = groups_of(layout, s.order_);
  const std::vector<FrameSpan> spans = spans_of(s.frames_);
  for (const PointGroup& points : groups)
    for (int plane = 0; plane < s.channels_; ++plane) {
      TransferSequence::BoneGroup g{points.bone, plane, points.first, points.count, {}};
      for (const FrameSpan& span : spans) {
        std::uint8_t components = 0;
        if (!in.get(components) || components < 1 || components > span.count)
          return damaged("the number of components is out of range");
        g.components.insert(g.components.end(), components, {span.first, span.count, {}, {}});
      }
      int before = -1;
      for (TransferSequence::Component& c : g.components) {
        if (std::exchange(before, c.first_frame) != c.first_frame) continue;  // the mean
        for (int f = 0; f < c.frames; ++f) {
          std::uint16_t half = 0;
          if (!in.get(half)) return damaged("weights over time are cut off");
          const float w = float_from_half(half);
          if (!std::isfinite(w)) return damaged("a weight over time is not a number");
          c.weight.push_back(w);
        }
      }
      s.groups_.push_back(std::move(g));
    }
  std::size_t largest = 0;
  for (const TransferSequence::BoneGroup& g : s.groups_)
    largest += g.components.size() * static_cast<std::size_t>(coefficient_count(s.bands_)) *
               padded(g.count);
  if (largest > kMaxValues) return damaged("it has more values than any bake");
  const std::vector<std::uint32_t> place = places_in_groups(s.order_, groups);
  MapCoder coder(layout, s.order_, place);
  auto models = std::make_unique<ValueModels>();
  codec::BitModel zero_map, predicted;
  codec::RangeDecoder range(in.rest());
  for (std::size_t i = 0; i < s.groups_.size(); ++i) {
    TransferSequence::BoneGroup& g = s.groups_[i];
    const PointGroup& points = groups[i / static_cast<std::size_t>(s.channels_)];
    std::size_t k = 0;  // in the span
    for (TransferSequence::Component& c : g.components) {
      if (c.weight.empty()) k = 0;
      for (int n = 0; n < coefficient_count(s.bands_); ++n) {
        if (range.bit(zero_map)) {
          c.maps.push_back({TransferSequence::kNone});
          continue;
        }
        const bool predict = range.bit(predicted);
        const std::size_t offset = s.values_.size();
        c.maps.push_back({static_cast<std::uint32_t>(offset)});
        s.values_.resize(offset + padded(g.count));
        coder.for_values(points, predict, s.values_.data() + offset,
                         [&](int, int base, int activity) {
                           const int v = base + models->at(k, band_of(n), activity).decode(range);
                           return std::clamp(v, -32767, 32767);
                         });
      }
      ++k;
    }
  }
  s.finish_maps();
  return s;
}

}  // namespace penumbra::prt
