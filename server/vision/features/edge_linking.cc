#include "server/vision/features/edge_linking.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <opencv2/core.hpp>
#include <opencv2/core/hal/intrin.hpp>

namespace horopter {
namespace {

// Flags of a pixel.
constexpr uint8_t kMaximum = 1;  // largest across the edge and above `low`
constexpr uint8_t kSeed = 2;     // ... above `high`
constexpr uint8_t kTaken = 4;    // on the chain being walked or a finished one
constexpr uint8_t kLinked = 8;   // on a finished one

constexpr int kBlock = 16;     // px of two vectors
constexpr int kBuckets = 256;  // of seed strength, an eighth of a threshold wide

struct Pixel {
  int x = 0, y = 0;
};

class Linker {
 public:
  Linker(const GradientField& field, const LinkingOptions& options)
      : field_(field),
        options_(options),
        width_(field.magnitude.cols),
        height_(field.magnitude.rows),
        low_(Units(options.low)),
        high_(Units(options.high)),
        gap_low_(Units(options.gap_low)),
        flags_(height_, width_, CV_8UC1) {}

  std::vector<EdgeChain> Link() {
    FindMaxima();
    std::vector<EdgeChain> chains;
    for (const int32_t seed : SeedsStrongestFirst()) {
      const Pixel p = {seed % width_, seed / width_};
      if ((Flags(p) & kTaken) == 0) {
        Trace(p, &chains);
      }
    }
    return chains;
  }

 private:
  static int16_t Units(double thresholds) {
    return static_cast<int16_t>(std::lround(thresholds * kThresholdUnits));
  }
  int16_t Magnitude(Pixel p) const { return field_.magnitude.ptr<int16_t>(p.y)[p.x]; }
  uint8_t& Flags(Pixel p) { return flags_.ptr<uint8_t>(p.y)[p.x]; }
  bool Inside(Pixel p) const {
    return p.x >= 2 && p.y >= 2 && p.x + 2 < width_ && p.y + 2 < height_;
  }
  bool Upright(Pixel p) const {  // the edge runs more down than across
    return std::abs(field_.dx.ptr<int16_t>(p.y)[p.x]) >= std::abs(field_.dy.ptr<int16_t>(p.y)[p.x]);
  }

  // Counting sort: strong edges are walked before noise can run into them.
  std::vector<int32_t> SeedsStrongestFirst() {
    std::vector<int32_t> seeds;
    std::array<int32_t, kBuckets + 1> begin{};
    for (int y = 2; y + 2 < height_; ++y) {
      const uint8_t* row = flags_.ptr<uint8_t>(y);
      for (int x = 0; x < width_;) {
        uint64_t eight;
        if (x + 8 <= width_ && (std::memcpy(&eight, row + x, 8), eight) == 0) {
          x += 8;
          continue;
        }
        for (const int end = std::min(x + 8, width_); x < end; ++x) {
          if ((row[x] & kSeed) != 0 && x >= 2 && x + 2 < width_) {
            seeds.push_back(y * width_ + x);
            ++begin[Bucket({x, y}) + 1];
          }
        }
      }
    }
    for (int b = 0; b < kBuckets; ++b) begin[b + 1] += begin[b];
    std::vector<int32_t> sorted(seeds.size());
    for (const int32_t seed : seeds) {
      sorted[begin[Bucket({seed % width_, seed / width_})]++] = seed;
    }
    return sorted;
  }
  int Bucket(Pixel p) const {
    return kBuckets - 1 - std::min(Magnitude(p) / (kThresholdUnits / 8), kBuckets - 1);
  }

  // Maxima along the row or the column, whichever is nearer to the gradient: on a straight edge the
  // profile along an axis is the stretched profile across, so nothing need be interpolated.
  void FindMaxima() {
    flags_.row(0).setTo(0);
    flags_.row(height_ - 1).setTo(0);
    for (int y = 1; y + 1 < height_; ++y) {
      const int16_t* up = field_.magnitude.ptr<int16_t>(y - 1);
      const int16_t* here = field_.magnitude.ptr<int16_t>(y);
      const int16_t* down = field_.magnitude.ptr<int16_t>(y + 1);
      const int16_t* dx = field_.dx.ptr<int16_t>(y);
      const int16_t* dy = field_.dy.ptr<int16_t>(y);
      uint8_t* out = flags_.ptr<uint8_t>(y);
      out[0] = out[width_ - 1] = 0;
      // Sixteen pixels at a time; the last block overlaps the one before.
      const int last = width_ - 1 - kBlock;
      for (int x = 1; x <= last; x = x < last && x + kBlock > last ? last : x + kBlock) {
        const cv::v_int16x8 left_half = MaximaAt(up + x, here + x, down + x, dx + x, dy + x);
        const cv::v_int16x8 right_half =
            MaximaAt(up + x + 8, here + x + 8, down + x + 8, dx + x + 8, dy + x + 8);
        cv::v_store(out + x, cv::v_pack_u(left_half, right_half));
      }
      if (last < 1) {
        for (int x = 1; x < width_ - 1; ++x) {
          const bool upright = std::abs(dx[x]) >= std::abs(dy[x]);
          const bool maximum = here[x] > (upright ? here[x - 1] : up[x]) &&
                               here[x] >= (upright ? here[x + 1] : down[x]) && here[x] >= low_;
          out[x] = !maximum ? 0 : here[x] >= high_ ? kMaximum | kSeed : kMaximum;
        }
      }
    }
  }

  cv::v_int16x8 MaximaAt(const int16_t* up,
                         const int16_t* here,
                         const int16_t* down,
                         const int16_t* dx,
                         const int16_t* dy) const {
    using cv::v_int16x8;
    const v_int16x8 m = cv::v_load(here);
    const v_int16x8 x = cv::v_load(dx), y = cv::v_load(dy);
    const v_int16x8 zero = cv::v_setzero_s16();
    const v_int16x8 upright = cv::v_max(x, zero - x) >= cv::v_max(y, zero - y);
    const v_int16x8 before = cv::v_select(upright, cv::v_load(here - 1), cv::v_load(up));
    const v_int16x8 after = cv::v_select(upright, cv::v_load(here + 1), cv::v_load(down));
    const v_int16x8 maximum = (m > before) & (m >= after) & (m >= cv::v_setall_s16(low_));
    const v_int16x8 seed = m >= cv::v_setall_s16(high_);
    return maximum & (cv::v_setall_s16(kMaximum) | (seed & cv::v_setall_s16(kSeed)));
  }

  // Walks from the seed both ways.
  void Trace(Pixel seed, std::vector<EdgeChain>* chains) {
    forward_.clear();
    backward_.clear();
    Flags(seed) |= kTaken;
    const bool upright = Upright(seed);
    const Pixel heading = upright ? Pixel{0, 1} : Pixel{1, 0};
    Walk(seed, heading, &forward_);
    Walk(seed, {-heading.x, -heading.y}, &backward_);
    const size_t count = forward_.size() + backward_.size() + 1;
    if (static_cast<int>(count) < options_.min_chain_px) {
      Release(seed);
      for (const Pixel& p : forward_) Release(p);
      for (const Pixel& p : backward_) Release(p);
      return;
    }
    for (const std::vector<Pixel>* half : {&forward_, &backward_}) {
      for (const Pixel& p : *half) Flags(p) |= kLinked;
    }
    Flags(seed) |= kLinked;
    EdgeChain chain;
    chain.points.reserve(count);
    chain.gradients.reserve(count);
    int votes[5] = {0, 0, 0, 0, 0};
    const auto add = [&](Pixel p) {
      chain.points.push_back(SubPixel(p));
      const auto scale = static_cast<float>(1.0 / kSlopeUnits);
      chain.gradients.emplace_back(scale * field_.dx.ptr<int16_t>(p.y)[p.x],
                                   scale * field_.dy.ptr<int16_t>(p.y)[p.x]);
      const int channel = field_.single_channel >= 0 ? field_.single_channel
                                                     : field_.channel.ptr<uint8_t>(p.y)[p.x];
      chain.channels.push_back(static_cast<uint8_t>(channel));
      ++votes[channel];
    };
    chain.channels.reserve(count);
    for (size_t k = backward_.size(); k-- > 0;) add(backward_[k]);
    add(seed);
    for (const Pixel& p : forward_) add(p);
    chain.channel = static_cast<int>(std::max_element(votes, votes + 5) - votes);
    const Eigen::Vector2f gap = chain.points.front() - chain.points.back();
    chain.closed = count > 12 && gap.cwiseAbs().maxCoeff() <= 2.5f;
    chains->push_back(std::move(chain));
  }

  // A piece too short for a chain stands in no other chain's way.
  void Release(Pixel p) {
    uint8_t& flags = Flags(p);
    if ((flags & kLinked) == 0) flags &= static_cast<uint8_t>(~kTaken);
  }

  // Follows the ridge from `at`; the pixels met go to `out`.
  void Walk(Pixel at, Pixel heading, std::vector<Pixel>* out) {
    int gap = 0;
    // Displacement over the last steps, decaying: the side the walk looks to.
    float hx = static_cast<float>(heading.x), hy = static_cast<float>(heading.y);
    for (;;) {
      const float gx = field_.dx.ptr<int16_t>(at.y)[at.x];
      const float gy = field_.dy.ptr<int16_t>(at.y)[at.x];
      // Along the edge, turned towards the heading; across a gap the gradient says little.
      float tx = -gy, ty = gx;
      if (gap > 0 || (tx == 0.0f && ty == 0.0f)) {
        tx = hx;
        ty = hy;
      } else if (tx * hx + ty * hy < 0.0f) {
        tx = -tx;
        ty = -ty;
      }
      Pixel next[3];
      if (std::abs(ty) >= std::abs(tx)) {
        const int step = ty > 0.0f ? 1 : -1;
        const int lean = tx > 0.0f ? 1 : -1;
        next[0] = {at.x, at.y + step};
        next[1] = {at.x + lean, at.y + step};
        next[2] = {at.x - lean, at.y + step};
      } else {
        const int step = tx > 0.0f ? 1 : -1;
        const int lean = ty > 0.0f ? 1 : -1;
        next[0] = {at.x + step, at.y};
        next[1] = {at.x + step, at.y + lean};
        next[2] = {at.x + step, at.y - lean};
      }
      if (!Inside(next[0])) {
        break;
      }
      int best = -1, best_score = -1;
      for (int k = 0; k < 3; ++k) {
        const int score = Magnitude(next[k]) + ((Flags(next[k]) & kMaximum) != 0 ? 65536 : 0);
        if (score > best_score) {
          best_score = score;
          best = k;
        }
      }
      const Pixel to = next[best];
      const uint8_t flags = Flags(to);
      if ((flags & kTaken) != 0) {
        // Runs into a chain: share the point, so that the two are known to meet.
        out->push_back(to);
        gap = 0;
        break;
      }
      if ((flags & kMaximum) != 0) {
        gap = 0;
      } else if (++gap > options_.max_gap_px || Magnitude(to) < gap_low_) {
        break;
      }
      Flags(to) = static_cast<uint8_t>(flags | kTaken);
      hx = 0.7f * hx + static_cast<float>(to.x - at.x);
      hy = 0.7f * hy + static_cast<float>(to.y - at.y);
      out->push_back(to);
      at = to;
    }
    // A gap that led nowhere is no edge.
    for (gap = std::min<int>(gap, static_cast<int>(out->size())); gap > 0; --gap) {
      if ((Flags(out->back()) & kMaximum) != 0) break;
      Flags(out->back()) &= static_cast<uint8_t>(~kTaken);
      out->pop_back();
    }
  }

  // Vertex of the parabola through the three magnitudes along the axis nearer to the gradient.
  Eigen::Vector2f SubPixel(Pixel p) const {
    const bool upright = Upright(p);
    const Pixel step = upright ? Pixel{1, 0} : Pixel{0, 1};
    const float before = Magnitude({p.x - step.x, p.y - step.y});
    const float peak = Magnitude(p);
    const float after = Magnitude({p.x + step.x, p.y + step.y});
    const float curvature = before - 2.0f * peak + after;
    const float shift =
        curvature < -0.5f ? std::clamp(0.5f * (before - after) / curvature, -0.6f, 0.6f) : 0.0f;
    return {static_cast<float>(p.x) + shift * static_cast<float>(step.x),
            static_cast<float>(p.y) + shift * static_cast<float>(step.y)};
  }

  const GradientField& field_;
  const LinkingOptions& options_;
  int width_;
  int height_;
  int16_t low_, high_, gap_low_;
  cv::Mat flags_;
  std::vector<Pixel> forward_, backward_;
};

}  // namespace

std::vector<EdgeChain> LinkEdges(const GradientField& field, const LinkingOptions& options) {
  if (field.magnitude.rows < 5 || field.magnitude.cols < 5) {
    return {};
  }
  return Linker(field, options).Link();
}

}  // namespace horopter
