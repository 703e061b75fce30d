#include "server/vision/recognition/aspects/dot_lattice.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <queue>
#include <utility>

#include "server/vision/geometry/symmetric_eigen.h"

namespace horopter {
namespace {

// Where a lattice of dots goes on: beyond a dot, as far as its neighbour on the other side.
struct Expected {
  Eigen::Vector2f place;
  float spacing = 0.0f;
  float size = 0.0f;
};

struct Expectations {
  std::vector<Expected> places;  // ordered by x
  float widest = 0.0f;           // spacing
};

// The nearest other dots of each, best first: distance and number.
std::vector<std::vector<std::pair<float, int>>> Neighbours(const std::vector<Dot>& dots) {
  constexpr std::size_t kNeighbours = 6;  // of which rows and columns are made
  std::vector<int> by_x(dots.size());
  std::iota(by_x.begin(), by_x.end(), 0);
  std::sort(by_x.begin(), by_x.end(), [&](int a, int b) {
    return dots[a].middle.x() < dots[b].middle.x();
  });
  const int count = static_cast<int>(by_x.size());
  std::vector<std::vector<std::pair<float, int>>> out(dots.size());
  for (int at = 0; at < count; ++at) {
    const Dot& dot = dots[by_x[at]];
    std::vector<std::pair<float, int>>& near = out[by_x[at]];
    for (const int step : {-1, 1}) {
      for (int j = at + step; j >= 0 && j < count; j += step) {
        const Eigen::Vector2f off = dots[by_x[j]].middle - dot.middle;
        if (near.size() == kNeighbours && std::abs(off.x()) > near.back().first) break;
        const std::pair<float, int> other{off.norm(), by_x[j]};
        if (other.first <= dot.size) continue;
        near.insert(std::lower_bound(near.begin(), near.end(), other), other);
        if (near.size() > kNeighbours) near.pop_back();
      }
    }
  }
  return out;
}

Expectations GoOn(const std::vector<Dot>& dots) {
  constexpr float kReach = 1.7f;  // of the nearest one's distance: rows, columns and diagonals
  Expectations out;
  const auto neighbours = Neighbours(dots);
  for (std::size_t d = 0; d < dots.size(); ++d) {
    for (const auto& [distance, k] : neighbours[d]) {
      if (distance > kReach * neighbours[d].front().first) break;
      out.places.push_back({2.0f * dots[d].middle - dots[k].middle, distance, dots[d].size});
      out.widest = std::max(out.widest, distance);
    }
  }
  std::sort(out.places.begin(), out.places.end(), [](const Expected& a, const Expected& b) {
    return a.place.x() < b.place.x();
  });
  return out;
}

// What is expected where a dot stands: how many neighbours expect one, and the largest of theirs.
struct Votes {
  int count = 0;
  float size = 0.0f;
};

// off: of the spacing; `smallest`, `largest`: of the size that is expected.
Votes VotesFor(
    const Dot& dot, const Expectations& expected, float off, float smallest, float largest) {
  Votes out;
  const float reach = off * expected.widest;
  const auto& places = expected.places;
  auto e = std::lower_bound(
      places.begin(), places.end(), dot.middle.x() - reach, [](const Expected& x, float v) {
        return x.place.x() < v;
      });
  for (; e != places.end() && e->place.x() <= dot.middle.x() + reach; ++e) {
    if (dot.size < smallest * e->size || dot.size > largest * e->size ||
        (dot.middle - e->place).norm() > off * e->spacing) {
      continue;
    }
    ++out.count;
    out.size = std::max(out.size, e->size);
  }
  return out;
}

constexpr int kVotes = 2;         // of neighbours that expect a dot there
constexpr float kLarger = 1.35f;  // than the dot beside it

// Dots by the places of their middles.
class DotFinder {
 public:
  explicit DotFinder(const std::vector<Dot>& dots) : dots_(dots), by_x_(dots.size()) {
    std::iota(by_x_.begin(), by_x_.end(), 0);
    std::sort(by_x_.begin(), by_x_.end(), [&](int a, int b) {
      return dots[a].middle.x() < dots[b].middle.x();
    });
  }

  // Nearest to a place, within a distance; -1: none.
  int Nearest(const Eigen::Vector2f& at, float within) const {
    auto d = std::lower_bound(by_x_.begin(), by_x_.end(), at.x() - within, [&](int i, float x) {
      return dots_[i].middle.x() < x;
    });
    int found = -1;
    for (; d != by_x_.end() && dots_[*d].middle.x() <= at.x() + within; ++d) {
      const float off = (dots_[*d].middle - at).norm();
      if (off > within) continue;
      within = off;
      found = *d;
    }
    return found;
  }

 private:
  const std::vector<Dot>& dots_;
  std::vector<int> by_x_;
};

struct Numbered {
  int dot = -1;
  Eigen::Vector2i index = Eigen::Vector2i::Zero();
  Eigen::Vector2f steps[2];  // to the next ones, pixels
};

// Numbers of the dots that rows and columns from one reach.
std::vector<Numbered> NumberFrom(const std::vector<Dot>& dots,
                                 const DotFinder& finder,
                                 int seed,
                                 const std::vector<std::pair<float, int>>& near) {
  constexpr float kOff = 0.25f;       // of a step, by which the next one may be off
  constexpr float kLonger = 1.9f;     // the second direction's step, against the first one's
  constexpr float kLeastSine = 0.5f;  // between the two directions
  std::vector<Numbered> out;
  if (near.size() < 2) return out;
  Numbered first;
  first.dot = seed;
  first.steps[0] = dots[near[0].second].middle - dots[seed].middle;
  bool found = false;
  for (const auto& [distance, k] : near) {
    const Eigen::Vector2f step = dots[k].middle - dots[seed].middle;
    const float sine = std::abs(step.x() * first.steps[0].y() - step.y() * first.steps[0].x()) /
                       (distance * near[0].first);
    if (sine < kLeastSine || distance > kLonger * near[0].first) continue;
    first.steps[1] = step;
    found = true;
    break;
  }
  if (!found) return out;
  std::vector<char> taken(dots.size(), 0);
  taken[seed] = 1;
  std::queue<Numbered> open;
  open.push(first);
  while (!open.empty()) {
    const Numbered here = open.front();
    open.pop();
    out.push_back(here);
    for (const int axis : {0, 1}) {
      for (const int sign : {-1, 1}) {
        const Eigen::Vector2f step = static_cast<float>(sign) * here.steps[axis];
        const int k = finder.Nearest(dots[here.dot].middle + step, kOff * step.norm());
        if (k < 0 || taken[k]) continue;
        taken[k] = 1;
        Numbered next = here;
        next.dot = k;
        next.index[axis] += sign;
        next.steps[axis] = static_cast<float>(sign) * (dots[k].middle - dots[here.dot].middle);
        open.push(next);
      }
    }
  }
  return out;
}

Eigen::Vector2d Mapped(const Eigen::Matrix3d& H, const Eigen::Vector2d& at) {
  const Eigen::Vector3d x = H * at.homogeneous();
  return x.head<2>() / x.z();
}

// Shift and scale to mean zero and deviation one.
Eigen::Matrix3d Normalization(const std::vector<Eigen::Vector2d>& points) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& p : points) mean += p / static_cast<double>(points.size());
  double square = 0.0;
  for (const Eigen::Vector2d& p : points) square += (p - mean).squaredNorm();
  const double scale = std::sqrt(static_cast<double>(points.size()) / std::max(square, 1e-12));
  Eigen::Matrix3d T = Eigen::Matrix3d::Identity();
  T(0, 0) = T(1, 1) = scale;
  T.col(2).head<2>() = -scale * mean;
  return T;
}

Eigen::Matrix3d LinearHomography(const std::vector<Eigen::Vector2d>& from,
                                 const std::vector<Eigen::Vector2d>& to) {
  const Eigen::Matrix3d T = Normalization(from), S = Normalization(to);
  Eigen::Matrix<double, 9, 9> A = Eigen::Matrix<double, 9, 9>::Zero();
  for (std::size_t i = 0; i < from.size(); ++i) {
    const Eigen::Vector3d x = T * from[i].homogeneous();
    const Eigen::Vector2d u = Mapped(S, to[i]);
    for (const int axis : {0, 1}) {
      Eigen::Matrix<double, 9, 1> row = Eigen::Matrix<double, 9, 1>::Zero();
      row.segment<3>(3 * axis) = x;
      row.tail<3>() = -u[axis] * x;
      A += row * row.transpose();
    }
  }
  const SymmetricEigen<9> solver(A);
  const Eigen::Matrix<double, 9, 1> h = solver.eigenvectors().col(0);
  Eigen::Matrix3d H;
  H << h.head<3>().transpose(), h.segment<3>(3).transpose(), h.tail<3>().transpose();
  return S.inverse() * H * T;
}

// The shorter step to a neighbour where the lattice has this number.
double SpacingAt(const Eigen::Matrix3d& H, const Eigen::Vector2d& index) {
  const Eigen::Vector2d here = Mapped(H, index);
  return std::min((Mapped(H, index + Eigen::Vector2d::UnitX()) - here).norm(),
                  (Mapped(H, index + Eigen::Vector2d::UnitY()) - here).norm());
}

// Whether each box stands in a hole of the fitted lattice.
std::vector<char> HolesOfPlane(const PlaneLatticeFit& fit, const std::vector<Dot>& boxes) {
  constexpr double kOff = 0.28;        // of the spacing, of the middle of what is left of a rim
  constexpr double kLeastSpacing = 4;  // px: finer ones run into each other
  const Eigen::Matrix3d& H = fit.lattice.image_from_index;
  const Eigen::Matrix3d inverse = H.inverse();
  const DotFinder finder(fit.dots);
  const double side = (H * fit.indices.front().cast<double>().homogeneous()).z();
  std::vector<char> out;
  for (const Dot& box : boxes) {
    out.push_back(0);
    // A lens bends the lattice, alike for what is near.
    Eigen::Vector2d bent = Eigen::Vector2d::Zero();
    constexpr float kNearSizes = 12.0f;  // of a dot
    const int near = finder.Nearest(box.middle, kNearSizes * fit.dots.front().size);
    if (near >= 0) {
      bent = fit.dots[near].middle.cast<double>() - Mapped(H, fit.indices[near].cast<double>());
    }
    const Eigen::Vector2d middle = box.middle.cast<double>() - bent;
    const Eigen::Vector2d index = Mapped(inverse, middle).array().round();
    if (!index.allFinite() || (H * index.homogeneous()).z() * side <= 0) continue;
    const double spacing = SpacingAt(H, index);
    out.back() = spacing >= kLeastSpacing && (Mapped(H, index) - middle).norm() < kOff * spacing &&
                 box.size < kLarger * fit.lattice.size_share * spacing;
  }
  return out;
}

}  // namespace

std::vector<char> RegularDots(const std::vector<Dot>& dots) {
  constexpr float kOff = 0.15f, kSmaller = 0.7f;  // of the expected step; of the size; chosen
  const Expectations expected = GoOn(dots);
  std::vector<char> out;
  for (const Dot& dot : dots)
    out.push_back(VotesFor(dot, expected, kOff, kSmaller, kLarger).count >= kVotes);
  return out;
}

PlaneLatticeFit FitPlaneLattice(const std::vector<Dot>& dots) {
  constexpr int kSeeds = 12;           // that are numbered from; the one that reaches most is taken
  constexpr std::size_t kLeast = 24;   // dots of a lattice
  constexpr double kLeastShare = 0.8;  // of those numbered that must agree
  constexpr double kOff = 0.2;         // of the spacing
  PlaneLatticeFit out;
  if (dots.size() < kLeast) return out;
  const DotFinder finder(dots);
  const auto neighbours = Neighbours(dots);
  std::vector<Numbered> best;
  for (int s = 0; s < kSeeds && 2 * best.size() < dots.size(); ++s) {
    const int seed = static_cast<int>((2 * s + 1) * dots.size() / (2 * kSeeds));
    std::vector<Numbered> reached = NumberFrom(dots, finder, seed, neighbours[seed]);
    if (reached.size() > best.size()) best = std::move(reached);
  }
  const std::size_t numbered = best.size();
  for (int round = 0; round < 2; ++round) {
    if (best.size() < kLeast) return out;
    std::vector<Eigen::Vector2d> from, to;
    for (const Numbered& n : best) {
      from.push_back(n.index.cast<double>());
      to.push_back(dots[n.dot].middle.cast<double>());
    }
    out.lattice.image_from_index = LinearHomography(from, to);
    const Eigen::Matrix3d& H = out.lattice.image_from_index;
    std::erase_if(best, [&](const Numbered& n) {
      const Eigen::Vector2d index = n.index.cast<double>();
      return !((Mapped(H, index) - dots[n.dot].middle.cast<double>()).norm() <
               kOff * SpacingAt(H, index));
    });
  }
  if (best.size() < kLeast || static_cast<double>(best.size()) < kLeastShare * numbered) return out;
  std::vector<double> shares;
  for (const Numbered& n : best) {
    out.dots.push_back(dots[n.dot]);
    out.indices.push_back(n.index);
    shares.push_back(dots[n.dot].size /
                     SpacingAt(out.lattice.image_from_index, n.index.cast<double>()));
  }
  const auto middle = shares.begin() + static_cast<std::ptrdiff_t>(shares.size() / 2);
  std::nth_element(shares.begin(), middle, shares.end());
  out.lattice.size_share = *middle;
  out.fits = true;
  return out;
}

std::vector<char> HolesOfLattice(const std::vector<Dot>& dots, const std::vector<Dot>& boxes) {
  constexpr int kRounds = 20;    // in which a lattice may go on; chosen, for time
  constexpr float kOff = 0.25f;  // of the middle of what is left of a rim
  std::vector<char> out(boxes.size(), 0);
  const PlaneLatticeFit fit = FitPlaneLattice(dots);
  if (fit.fits) out = HolesOfPlane(fit, boxes);
  std::vector<Dot> known = dots;
  for (std::size_t i = 0; i < boxes.size(); ++i) {
    if (out[i]) known.push_back(boxes[i]);
  }
  for (int round = 0; round < kRounds; ++round) {
    const Expectations expected = GoOn(known);
    const std::size_t before = known.size();
    for (std::size_t i = 0; i < boxes.size(); ++i) {
      if (out[i]) continue;
      const Votes votes = VotesFor(boxes[i], expected, kOff, 0.0f, kLarger);
      if (votes.count < kVotes) continue;
      out[i] = 1;
      known.push_back({boxes[i].middle, votes.size});
    }
    if (known.size() == before) break;
  }
  return out;
}

}  // namespace horopter
