#include "server/vision/recognition/aspects/outline_shape.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace horopter {
namespace {

constexpr int kDirections = 64;       // of the support function; eight of the highest order's waves
constexpr int kTurns = 72;            // of 5 degrees, before the best are refined
constexpr float kRoundApart = 0.02f;  // outlines whose turns differ by less fit at any; chosen
constexpr float kWorse = 2.0f;  // turns that differ by so often the best's are left out; chosen

// Unit vectors, and powers of the root of unity that they stand for.
struct Circle {
  std::array<Eigen::Vector2f, kDirections> at;
  Circle() {
    for (int k = 0; k < kDirections; ++k) {
      const float a = 2.0f * std::numbers::pi_v<float> * static_cast<float>(k) / kDirections;
      at[k] = {std::cos(a), std::sin(a)};
    }
  }
};
const Circle kCircle;

float Apart(const OutlineShape& model, const OutlineShape& image, float turn) {
  float sum = 0.0f;
  for (int i = 0; i < kOutlineOrders; ++i) {
    const float n = static_cast<float>(i + 2);
    sum += std::norm(image.orders[i] - model.orders[i] * std::polar(1.0f, -n * turn));
  }
  return std::sqrt(sum);
}

}  // namespace

std::array<double, kOutlineOrders> OutlineShape::Key() const {
  std::array<double, kOutlineOrders> key;
  for (int i = 0; i < kOutlineOrders; ++i) key[i] = std::abs(orders[i]);
  return key;
}

std::optional<OutlineShape> ShapeOf(std::span<const Eigen::Vector2f> points) {
  if (points.size() < 3) return std::nullopt;
  std::array<float, kDirections> support;
  for (int k = 0; k < kDirections; ++k) {
    float most = -std::numeric_limits<float>::infinity();
    for (const Eigen::Vector2f& p : points) most = std::max(most, p.dot(kCircle.at[k]));
    support[k] = most;
  }
  OutlineShape out;
  float mean = 0.0f;
  for (int k = 0; k < kDirections; ++k) {
    mean += support[k] / kDirections;
    out.center += 2.0f / kDirections * support[k] * kCircle.at[k];
  }
  if (!(mean > 0.0f) || !std::isfinite(mean)) {
    // The mean of the support function is half the mean width wherever the origin is.
    return std::nullopt;
  }
  out.width = 2.0f * mean;
  for (int i = 0; i < kOutlineOrders; ++i) {
    for (int k = 0; k < kDirections; ++k) {
      const Eigen::Vector2f& u = kCircle.at[(i + 2) * k % kDirections];
      out.orders[i] += support[k] * std::complex<float>(u.x(), -u.y());
    }
    out.orders[i] *= 2.0f / (kDirections * mean);
  }
  return out;
}

std::vector<OutlineTurn> TurnsBetween(const OutlineShape& model,
                                      const OutlineShape& image,
                                      int most) {
  constexpr float kStep = 2.0f * std::numbers::pi_v<float> / kTurns;
  std::array<float, kTurns> apart;
  static const auto kTurned = [] {
    std::array<std::array<std::complex<float>, kOutlineOrders>, kTurns> out;
    for (int k = 0; k < kTurns; ++k) {
      for (int i = 0; i < kOutlineOrders; ++i)
        out[k][i] = std::polar(1.0f, -static_cast<float>(i + 2) * (kStep * static_cast<float>(k)));
    }
    return out;
  }();
  for (int k = 0; k < kTurns; ++k) {
    float sum = 0.0f;
    for (int i = 0; i < kOutlineOrders; ++i)
      sum += std::norm(image.orders[i] - model.orders[i] * kTurned[k][i]);
    apart[k] = std::sqrt(sum);
  }
  const auto [least, largest] = std::minmax_element(apart.begin(), apart.end());
  std::vector<OutlineTurn> out;
  if (*largest - *least < kRoundApart) {
    for (int k = 0; k < most; ++k)
      out.push_back({2.0f * std::numbers::pi_v<float> * static_cast<float>(k) / most, *least});
    return out;
  }
  for (int k = 0; k < kTurns; ++k) {
    const float before = apart[(k + kTurns - 1) % kTurns], here = apart[k],
                after = apart[(k + 1) % kTurns];
    if (here > before || here >= after || here > kWorse * *least + kRoundApart) continue;
    const float bend = before - 2.0f * here + after;
    const float off = bend > 0.0f ? 0.5f * (before - after) / bend : 0.0f;
    const float turn = kStep * (static_cast<float>(k) + off);
    out.push_back({turn, Apart(model, image, turn)});
  }
  std::stable_sort(out.begin(), out.end(), [](const OutlineTurn& a, const OutlineTurn& b) {
    return a.apart < b.apart;
  });
  if (static_cast<int>(out.size()) > most) out.resize(most);
  return out;
}

}  // namespace horopter
