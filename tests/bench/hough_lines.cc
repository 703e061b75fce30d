#include "tests/bench/hough_lines.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr int kMaxSide = 20000;
constexpr size_t kMaxVertices = 10000;

struct Voter {
  Eigen::Vector2d point;  // from the image's centre
  double angle = 0.0;     // of the gradient
  double strength = 0.0;
  bool used = false;
};

// Votes over the angle of the normal (a whole turn) and the offset from the image's centre.
class Accumulator {
 public:
  Accumulator(double radius, const HoughOptions& options)
      : options_(options),
        angles_(std::max(8, static_cast<int>(std::lround(2.0 * M_PI / options.angle_step_rad)))),
        offsets_(2 * static_cast<int>(std::ceil(radius / options.offset_step_px)) + 4),
        votes_(static_cast<size_t>(angles_) * offsets_, 0.0f),
        best_(angles_, -1) {
    for (int a = 0; a < angles_; ++a) {
      const double angle = 2.0 * M_PI * a / angles_;
      normals_.push_back({std::cos(angle), std::sin(angle)});
    }
  }

  void Vote(const Voter& voter, float sign) {
    const double step = 2.0 * M_PI / angles_;
    const int reach = static_cast<int>(options_.angle_spread_rad / step);
    const int middle = static_cast<int>(std::lround(voter.angle / step));
    for (int k = middle - reach; k <= middle + reach; ++k) {
      const int a = ((k % angles_) + angles_) % angles_;
      // Lines that leave the gradient's normal get less.
      const double off = std::remainder(voter.angle - k * step, 2.0 * M_PI);
      const double weight = 1.0 - std::abs(off) / (options_.angle_spread_rad + step);
      if (weight <= 0.0) continue;
      const double at =
          std::clamp(normals_[a].dot(voter.point) / options_.offset_step_px + 0.5 * offsets_,
                     0.0,
                     offsets_ - 1.0);
      const int low = std::min(static_cast<int>(at), offsets_ - 2);
      const double share = at - low;
      float* row = &votes_[static_cast<size_t>(a) * offsets_];
      row[low] += sign * static_cast<float>(weight * (1.0 - share));
      row[low + 1] += sign * static_cast<float>(weight * share);
      best_[a] = -1;
    }
  }

  struct Peak {
    Eigen::Vector2d normal;
    double offset = 0.0;
    double votes = 0.0;
    int angle = 0;
    int cell = 0;
  };

  Peak Strongest() {
    int best = 0;
    for (int a = 0; a < angles_; ++a) {
      const float* row = &votes_[static_cast<size_t>(a) * offsets_];
      if (best_[a] < 0) best_[a] = static_cast<int>(std::max_element(row, row + offsets_) - row);
      if (row[best_[a]] > At(best)) best = a;
    }
    return {normals_[best],
            (best_[best] - 0.5 * offsets_) * options_.offset_step_px,
            At(best),
            best,
            best_[best]};
  }

  // A peak whose points give no segment would come up again for ever.
  void Silence(const Peak& peak) {
    votes_[static_cast<size_t>(peak.angle) * offsets_ + peak.cell] = -1e9f;
    best_[peak.angle] = -1;
  }

 private:
  float At(int a) const { return votes_[static_cast<size_t>(a) * offsets_ + best_[a]]; }

  const HoughOptions options_;
  int angles_;
  int offsets_;
  std::vector<float> votes_;
  std::vector<int> best_;  // strongest cell of each angle, -1: unknown
  std::vector<Eigen::Vector2d> normals_;
};

struct Line {
  Eigen::Vector2d point = Eigen::Vector2d::Zero();
  Eigen::Vector2d direction = Eigen::Vector2d::UnitX();

  double Across(const Eigen::Vector2d& p) const {
    return direction.x() * (p - point).y() - direction.y() * (p - point).x();
  }
};

// Total least squares; the direction has the bright side (`normal`) on its right.
Line FitLine(const std::vector<Voter>& voters,
             const std::vector<int>& members,
             const Eigen::Vector2d& normal) {
  Line line;
  for (int i : members) line.point += voters[i].point / static_cast<double>(members.size());
  Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
  for (int i : members) {
    const Eigen::Vector2d q = voters[i].point - line.point;
    scatter += q * q.transpose();
  }
  line.direction = Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(scatter).eigenvectors().col(1);
  if (line.direction.x() * normal.y() - line.direction.y() * normal.x() < 0.0) {
    line.direction = -line.direction;
  }
  return line;
}

// Unused points within support_px of the line with a gradient along its normal.
std::vector<int> Support(const std::vector<Voter>& voters,
                         const Eigen::Vector2d& normal,
                         double offset,
                         const HoughOptions& options) {
  const double angle = std::atan2(normal.y(), normal.x());
  std::vector<int> members;
  for (size_t i = 0; i < voters.size(); ++i) {
    if (!voters[i].used && std::abs(normal.dot(voters[i].point) - offset) <= options.support_px &&
        std::abs(std::remainder(voters[i].angle - angle, 2.0 * M_PI)) <=
            2.0 * options.angle_spread_rad) {
      members.push_back(static_cast<int>(i));
    }
  }
  return members;
}

// Cuts members, which are sorted along the direction, at gaps; keeps the long runs.
std::vector<std::vector<int>> Runs(const std::vector<Voter>& voters,
                                   std::vector<int> members,
                                   const Line& line,
                                   const HoughOptions& options) {
  const auto along = [&](int i) { return line.direction.dot(voters[i].point - line.point); };
  std::stable_sort(
      members.begin(), members.end(), [&](int a, int b) { return along(a) < along(b); });
  std::vector<std::vector<int>> runs;
  size_t begin = 0;
  for (size_t k = 1; k <= members.size(); ++k) {
    if (k < members.size() && along(members[k]) - along(members[k - 1]) <= options.max_gap_px) {
      continue;
    }
    if (along(members[k - 1]) - along(members[begin]) >= options.min_length_px) {
      runs.emplace_back(members.begin() + static_cast<ptrdiff_t>(begin),
                        members.begin() + static_cast<ptrdiff_t>(k));
    }
    begin = k;
  }
  return runs;
}

Segment MakeSegment(const std::vector<Voter>& voters,
                    const std::vector<int>& run,
                    const Eigen::Vector2d& normal,
                    const Eigen::Vector2d& center) {
  const Line line = FitLine(voters, run, normal);
  Segment segment;
  double low = 1e18, high = -1e18, square = 0.0;
  for (int i : run) {
    const double s = line.direction.dot(voters[i].point - line.point);
    low = std::min(low, s);
    high = std::max(high, s);
    const double d = line.Across(voters[i].point);
    square += d * d;
    segment.contrast += voters[i].strength / static_cast<double>(run.size());
  }
  segment.start = center + line.point + low * line.direction;
  segment.end = center + line.point + high * line.direction;
  segment.rms_px = std::sqrt(square / static_cast<double>(run.size()));
  return segment;
}

std::vector<Segment> FindSegments(std::vector<Voter> voters,
                                  const Eigen::Vector2d& center,
                                  const HoughOptions& options) {
  Accumulator accumulator(center.norm() + 2.0, options);
  for (const Voter& voter : voters) accumulator.Vote(voter, 1.0f);
  std::vector<Segment> segments;
  // Peaks without a segment count too, so that noise cannot make the search long.
  for (int tried = 0; tried < options.max_lines; ++tried) {
    const Accumulator::Peak peak = accumulator.Strongest();
    if (peak.votes < options.min_votes) break;
    std::vector<int> members = Support(voters, peak.normal, peak.offset, options);
    bool found = false;
    if (members.size() >= 3) {
      const Line line = FitLine(voters, members, peak.normal);
      for (const std::vector<int>& run : Runs(voters, members, line, options)) {
        found = true;
        segments.push_back(MakeSegment(voters, run, peak.normal, center));
        for (int i : run) {
          accumulator.Vote(voters[i], -1.0f);
          voters[i].used = true;
        }
      }
    }
    if (!found) accumulator.Silence(peak);
  }
  return segments;
}

double DistanceToSegment(const Segment& segment, const Eigen::Vector2d& p, double reach) {
  const Eigen::Vector2d d = segment.end - segment.start;
  const double length = d.norm(), s = d.dot(p - segment.start) / length;
  const double beyond = std::max({-s, s - length, 0.0});
  if (beyond > reach) return 1e9;
  return std::abs(d.x() * (p - segment.start).y() - d.y() * (p - segment.start).x()) / length;
}

// Votes of each segment for the pixels it passes: 1 on its line, 0 from vertex_width_px.
std::vector<float> VertexVotes(const std::vector<Segment>& segments,
                               int width,
                               int height,
                               const HoughOptions& options) {
  std::vector<float> votes(static_cast<size_t>(width) * height, 0.0f);
  for (const Segment& segment : segments) {
    const Eigen::Vector2d direction = (segment.end - segment.start).normalized();
    const Eigen::Vector2d a = segment.start - options.vertex_reach_px * direction;
    const Eigen::Vector2d b = segment.end + options.vertex_reach_px * direction;
    const bool steep = std::abs(direction.y()) > std::abs(direction.x());
    const int major = steep ? 1 : 0, minor = 1 - major;
    const int limit = steep ? height : width, other = steep ? width : height;
    const int from = std::max(static_cast<int>(std::ceil(std::min(a[major], b[major]))), 0);
    const int to = std::min(static_cast<int>(std::floor(std::max(a[major], b[major]))), limit - 1);
    const double slope = direction[minor] / direction[major];
    const double half = options.vertex_width_px / std::abs(direction[major]);
    for (int k = from; k <= to; ++k) {
      const double middle = a[minor] + slope * (k - a[major]);
      const int low = std::max(static_cast<int>(std::ceil(middle - half)), 0);
      const int high = std::min(static_cast<int>(std::floor(middle + half)), other - 1);
      for (int j = low; j <= high; ++j) {
        const size_t cell =
            steep ? static_cast<size_t>(k) * width + j : static_cast<size_t>(j) * width + k;
        votes[cell] += static_cast<float>(1.0 - std::abs(j - middle) / half);
      }
    }
  }
  return votes;
}

// The segments that pass `at` meet there: least squares over their lines, when they are of
// different directions and it stays near.
std::optional<HoughVertex> MeetingAt(const Eigen::Vector2d& at,
                                     const std::vector<Segment>& segments,
                                     const HoughOptions& options) {
  HoughVertex vertex;
  Eigen::Matrix2d normal = Eigen::Matrix2d::Zero();
  Eigen::Vector2d right = Eigen::Vector2d::Zero();
  double widest = 0.0;
  for (size_t i = 0; i < segments.size(); ++i) {
    const Segment& s = segments[i];
    if (DistanceToSegment(s, at, options.vertex_reach_px) > options.vertex_width_px) continue;
    const Eigen::Vector2d d = (s.end - s.start).normalized(), n(-d.y(), d.x());
    normal += n * n.transpose();
    right += n * n.dot(s.start);
    for (int j : vertex.segments) {
      const Eigen::Vector2d e = (segments[j].end - segments[j].start).normalized();
      widest = std::max(widest, std::abs(std::asin(std::clamp(e.dot(n), -1.0, 1.0))));
    }
    vertex.segments.push_back(static_cast<int>(i));
  }
  if (widest < options.vertex_min_angle_rad) return std::nullopt;
  vertex.point = normal.inverse() * right;
  if (!((vertex.point - at).norm() <= options.vertex_distance_px)) return std::nullopt;
  return vertex;
}

std::vector<HoughVertex> FindVertices(const std::vector<Segment>& segments,
                                      int width,
                                      int height,
                                      const HoughOptions& options) {
  const std::vector<float> votes = VertexVotes(segments, width, height, options);
  std::vector<int> order;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const float here = votes[static_cast<size_t>(y) * width + x];
      if (here < options.vertex_min_votes) continue;
      bool largest = true;
      for (int v = std::max(y - 1, 0); v <= std::min(y + 1, height - 1) && largest; ++v) {
        for (int u = std::max(x - 1, 0); u <= std::min(x + 1, width - 1); ++u) {
          largest = largest && votes[static_cast<size_t>(v) * width + u] <= here;
        }
      }
      if (largest) order.push_back(y * width + x);
    }
  }
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return votes[a] > votes[b]; });
  if (order.size() > kMaxVertices) order.resize(kMaxVertices);
  std::vector<HoughVertex> vertices;
  for (int cell : order) {
    std::optional<HoughVertex> vertex = MeetingAt({cell % width, cell / width}, segments, options);
    if (!vertex) continue;
    const bool known = std::any_of(vertices.begin(), vertices.end(), [&](const HoughVertex& v) {
      return (v.point - vertex->point).norm() < options.vertex_distance_px;
    });
    if (known) continue;
    vertex->votes = votes[cell];
    vertices.push_back(*std::move(vertex));
  }
  return vertices;
}

}  // namespace

absl::Status Validate(const HoughOptions& options) {
  const std::pair<const char*, double> positive[] = {
      {"angle_step_rad", options.angle_step_rad},
      {"offset_step_px", options.offset_step_px},
      {"angle_spread_rad", options.angle_spread_rad},
      {"support_px", options.support_px},
      {"max_gap_px", options.max_gap_px},
      {"min_length_px", options.min_length_px},
      {"min_votes", options.min_votes},
      {"vertex_width_px", options.vertex_width_px},
      {"vertex_min_votes", options.vertex_min_votes},
      {"vertex_min_angle_rad", options.vertex_min_angle_rad},
      {"vertex_distance_px", options.vertex_distance_px}};
  for (const auto& [name, value] : positive) {
    if (!(value > 0.0) || !std::isfinite(value)) {
      return absl::InvalidArgumentError(std::string(name) + ": need a finite value > 0");
    }
  }
  if (options.angle_step_rad < 1e-3 || options.angle_spread_rad > M_PI / 2) {
    return absl::InvalidArgumentError(
        "angle_step_rad and angle_spread_rad: need at least 0.001 and at most pi / 2");
  }
  if (options.offset_step_px < 0.1) {
    return absl::InvalidArgumentError("offset_step_px: need at least 0.1");
  }
  if (!(options.vertex_reach_px >= 0.0) || !std::isfinite(options.vertex_reach_px)) {
    return absl::InvalidArgumentError("vertex_reach_px: need a finite value >= 0");
  }
  if (options.max_lines < 0) {
    return absl::InvalidArgumentError("max_lines: need >= 0");
  }
  return absl::OkStatus();
}

absl::StatusOr<HoughFeatures> DetectHoughLines(std::span<const EdgeChain> chains,
                                               int width,
                                               int height,
                                               const HoughOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide) {
    return absl::InvalidArgumentError("image: need 1 to 20000 px each way, got " +
                                      std::to_string(width) + "x" + std::to_string(height));
  }
  const Eigen::Vector2d center(0.5 * (width - 1), 0.5 * (height - 1));
  std::vector<Voter> voters;
  for (size_t c = 0; c < chains.size(); ++c) {
    const EdgeChain& chain = chains[c];
    if (chain.gradients.size() != chain.points.size()) {
      return absl::InvalidArgumentError("chains: " + std::to_string(c) +
                                        " has not one gradient per point");
    }
    for (size_t i = 0; i < chain.points.size(); ++i) {
      if (!chain.points[i].allFinite() || !chain.gradients[i].allFinite()) {
        return absl::InvalidArgumentError("chains: " + std::to_string(c) +
                                          " has a point that is not finite");
      }
      const Eigen::Vector2d g = chain.gradients[i].cast<double>();
      if (g.norm() > 0.0) {
        voters.push_back(
            {chain.points[i].cast<double>() - center, std::atan2(g.y(), g.x()), g.norm(), false});
      }
    }
  }
  HoughFeatures out;
  out.segments = FindSegments(std::move(voters), center, options);
  out.vertices = FindVertices(out.segments, width, height, options);
  return out;
}

}  // namespace horopter
