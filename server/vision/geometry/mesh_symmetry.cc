#include "server/vision/geometry/mesh_symmetry.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>

#include "server/base/constants.h"
#include "server/vision/geometry/surface_prober.h"

namespace horopter {
namespace {

using Eigen::Vector3d;

constexpr int kGlanceSamples = 60;          // for a first look
constexpr int kFewFold = 12;                // orders that near symmetries are looked for in
constexpr double kAnyTurns[] = {2.3, 1.0};  // rad; no rational parts of a turn
constexpr double kFlipStep = kPi / 60.0;    // between half turns that are tried
constexpr double kSameTurn = 0.1;           // Frobenius, 4 degrees: an exact one, measured again
// A near symmetry is one of small features, or of small steps (diameters) of large faces.
constexpr double kSmallShare = 0.2, kSmallStep = 0.015;
constexpr double kSharper = 1.5;  // a lower order must fit so much better

int Gcd(int a, int b) {
  return b == 0 ? a : Gcd(b, a % b);
}

// A turn that generates the same group as 2 pi / order but is wide, so that its axis can be told.
double GeneratorAngle(int order) {
  int best = 1;
  const auto off = [&](int k) { return std::abs(2.0 * kPi * k / order - 2.0); };
  for (int k = 1; k < order; ++k) {
    if (Gcd(k, order) == 1 && off(k) < off(best)) best = k;
  }
  return 2.0 * kPi * best / order;
}

// What is known of an axis: exact, near or neither.
struct Judged {
  bool exact = false;
  double mean_m = 0.0;
  SymmetryAxis axis;
};

class Finder {
 public:
  Finder(const SurfaceProber& prober, const MeshSymmetryOptions& options)
      : prober_(prober), options_(options) {}

  MeshSymmetries Find() {
    out_.center = prober_.center();
    if (prober_.IsSphere()) {
      out_.sphere = true;
      return out_;
    }
    const Vector3d frame[] = {Vector3d::UnitX(), Vector3d::UnitY(), Vector3d::UnitZ()};
    std::vector<Vector3d> directions(std::begin(frame), std::end(frame));
    for (const Vector3d& d : prober_.PrincipalDirections()) AddDirection(d, &directions);
    for (const Vector3d& d : prober_.FaceDirections()) AddDirection(d, &directions);
    for (const Vector3d& d : directions) LookAlong(d);
    FindFlips();
    Finish();
    return out_;
  }

 private:
  static void AddDirection(const Vector3d& d, std::vector<Vector3d>* list) {
    if (std::none_of(list->begin(), list->end(), [&](const Vector3d& k) {
          return std::abs(k.dot(d)) > kSameAxis;
        })) {
      list->push_back(d);
    }
  }

  // Nothing if the turn is no near symmetry either.
  std::optional<Judged> Judge(const SymmetryAxis& start) const {
    const double limit = prober_.near_mean_m();
    const double angle = start.order == 0 ? kAnyTurns[0] : GeneratorAngle(start.order);
    if (prober_.Mean(TurnAbout(start, angle), kGlanceSamples, 3.0 * limit) >= 3.0 * limit) {
      return std::nullopt;
    }
    Judged out{IsExact(start), 0.0, start};
    if (!out.exact) out.axis = prober_.Fit(start, angle);
    if (!out.exact && IsExact(out.axis)) out.exact = true;
    if (out.axis.axis.dot(start.axis) < std::cos(0.1)) return std::nullopt;
    out.mean_m = prober_.Mean(TurnAbout(out.axis, angle), kAreaSamples, limit);
    if (start.order == 0) {
      out.mean_m = std::max(out.mean_m,
                            prober_.Mean(TurnAbout(out.axis, kAnyTurns[1]), kAreaSamples, limit));
    }
    if (!out.exact && out.mean_m >= limit) return std::nullopt;
    return out;
  }

  bool IsExact(const SymmetryAxis& axis) const {
    if (axis.order != 0) return prober_.Exact(TurnAbout(axis, GeneratorAngle(axis.order)));
    return prober_.Exact(TurnAbout(axis, kAnyTurns[0])) &&
           prober_.Exact(TurnAbout(axis, kAnyTurns[1]));
  }

  void Keep(const Judged& judged) {
    if (judged.exact) {
      out_.exact.push_back(judged.axis);
    } else {
      near_.push_back(judged);
    }
  }

  void LookAlong(const Vector3d& direction) {
    SymmetryAxis axis{direction, out_.center, 0};
    const std::optional<Judged> any = Judge(axis);
    if (any) Keep(*any);
    if (any && any->exact) return;
    std::vector<Judged> kept;
    if (any) kept.push_back(*any);
    int exact_order = 1;
    for (int order = kFewFold; order >= 2; --order) {
      if (exact_order % order == 0) continue;
      axis.order = order;
      const std::optional<Judged> judged = Judge(axis);
      if (!judged) continue;
      if (judged->exact) {
        Keep(*judged);
        exact_order = std::max(exact_order, order);
        continue;
      }
      const bool covered = std::any_of(kept.begin(), kept.end(), [&](const Judged& k) {
        return (k.axis.order == 0 || k.axis.order % order == 0) &&
               k.mean_m < kSharper * judged->mean_m + prober_.tolerance_m() / 4;
      });
      if (covered) continue;
      kept.push_back(*judged);
      Keep(*judged);
    }
    LookForTeeth(direction, kept, exact_order);
  }

  // Many-fold turns, of gears: an order that fits far better than most.
  void LookForTeeth(const Vector3d& direction, const std::vector<Judged>& kept, int exact_order) {
    SymmetryAxis axis{direction, out_.center, 0};
    if (!kept.empty()) axis = kept.back().axis;
    const double limit = prober_.near_mean_m();
    std::vector<std::pair<double, int>> means;
    for (int order = kFewFold + 1; order <= options_.max_order; ++order) {
      axis.order = order;
      const Rigid3 turn = TurnAbout(axis, GeneratorAngle(order));
      if (prober_.Mean(turn, kGlanceSamples / 2, limit) >= limit) continue;
      means.push_back({prober_.Mean(turn, kFitSamples / 2, limit), order});
    }
    if (means.empty()) return;
    std::sort(means.begin(), means.end());
    const double best = means.front().first, usual = means[means.size() / 2].first;
    if (static_cast<int>(means.size()) > options_.max_order / 2 && best > 0.4 * usual) return;
    axis.order = 0;
    for (const auto& [mean, order] : means) {
      if (mean <= 1.3 * best + 1e-4 * limit) axis.order = std::max(axis.order, order);
    }
    const std::optional<Judged> judged = Judge(axis);
    if (!judged || axis.order <= exact_order) return;
    Keep(*judged);
  }

  // Half turns perpendicular to the axes found: the first that fits stands for all that the axis
  // turns it into.
  void FindFlips() {
    std::vector<SymmetryAxis> mains;
    for (const SymmetryAxis& a : out_.exact) mains.push_back(a);
    for (const Judged& n : near_) mains.push_back(n.axis);
    std::erase_if(mains, [](const SymmetryAxis& a) { return a.order == 1 || a.order == 2; });
    const double limit = prober_.near_mean_m();
    for (const SymmetryAxis& main : mains) {
      const Vector3d u = main.axis.unitOrthogonal(), w = main.axis.cross(u);
      const double range = main.order == 0 ? 0.5 * kFlipStep : kPi / main.order;
      double best = 3.0 * limit;
      SymmetryAxis flip{u, out_.center, 2};
      for (double a = 0.0; a < range; a += std::min(kFlipStep, range / 4)) {
        const SymmetryAxis trial{std::cos(a) * u + std::sin(a) * w, main.point, 2};
        const double mean = prober_.Mean(TurnAbout(trial, kPi), 2 * kGlanceSamples, best);
        if (mean >= best) continue;
        best = mean;
        flip = trial;
      }
      if (best >= 3.0 * limit) continue;
      if (const std::optional<Judged> judged = Judge(flip)) Keep(*judged);
    }
  }

  // Each once; near ones that exact ones give are none.
  void Finish() {
    std::vector<SymmetryAxis> exact;
    for (const SymmetryAxis& a : out_.exact) {
      const bool known = std::any_of(exact.begin(), exact.end(), [&](const SymmetryAxis& k) {
        return std::abs(k.axis.dot(a.axis)) > kSameAxis && k.order == a.order;
      });
      if (!known) exact.push_back(a);
    }
    out_.exact = WithoutImplied(std::move(exact));
    // Any turn first: it says what the others say.
    std::stable_sort(near_.begin(), near_.end(), [](const Judged& a, const Judged& b) {
      return std::pair(a.axis.order != 0, a.mean_m) < std::pair(b.axis.order != 0, b.mean_m);
    });
    const std::vector<Rigid3> group = SymmetryGroup(out_);
    for (const Judged& n : near_) {
      if (static_cast<int>(out_.near.size()) >= options_.max_near) break;
      const Rigid3 turn =
          TurnAbout(n.axis, n.axis.order == 0 ? kAnyTurns[0] : GeneratorAngle(n.axis.order));
      const bool of_group = std::any_of(group.begin(), group.end(), [&](const Rigid3& s) {
        return (s.R - turn.R).norm() < kSameTurn;
      });
      if (of_group || Said(n.axis)) continue;
      const SurfaceMismatch mismatch = prober_.Measure(turn);
      if (mismatch.area_share <= kSmallShare ||
          mismatch.largest_m <= kSmallStep * prober_.diameter_m()) {
        out_.near.push_back({n.axis, mismatch});
      }
    }
  }

  // Around a single axis of many turns one half turn gives all the others.
  static std::vector<SymmetryAxis> WithoutImplied(std::vector<SymmetryAxis> axes) {
    const auto turns = [](const SymmetryAxis& a) { return a.order == 0 ? 1000 : a.order; };
    std::stable_sort(axes.begin(), axes.end(), [&](const SymmetryAxis& a, const SymmetryAxis& b) {
      return turns(a) > turns(b);
    });
    if (axes.empty() || turns(axes[0]) < 3) return axes;
    const auto other = [&](const SymmetryAxis& a) {
      return turns(a) >= 3 && std::abs(a.axis.dot(axes[0].axis)) < kSameAxis;
    };
    if (axes[0].order != 0 && std::any_of(axes.begin(), axes.end(), other)) return axes;
    std::vector<SymmetryAxis> kept{axes[0]};
    for (const SymmetryAxis& a : axes) {
      if (kept.size() == 1 && a.order == 2 && std::abs(a.axis.dot(axes[0].axis)) < 0.03) {
        kept.push_back(a);
      }
    }
    return kept;
  }

  // Whether near symmetries that are kept say it already.
  bool Said(const SymmetryAxis& axis) const {
    int flips = 0, most = 1000;
    const auto count = [&](const SymmetryAxis& main) {
      if (main.order == 1 || main.order == 2) return;
      if (std::abs(main.axis.dot(axis.axis)) < 0.05) most = std::min(most, main.order == 0 ? 1 : 2);
    };
    for (const SymmetryAxis& a : out_.exact) count(a);
    for (const NearSymmetry& n : out_.near) {
      count(n.axis);
      const double cosine = std::abs(n.axis.axis.dot(axis.axis));
      if (n.axis.order == axis.order && cosine > 0.998) return true;
      flips += n.axis.order == 2;
    }
    return axis.order == 2 && flips >= most;
  }

  const SurfaceProber& prober_;
  const MeshSymmetryOptions& options_;
  MeshSymmetries out_;
  std::vector<Judged> near_;
};

}  // namespace

MeshSymmetries FindMeshSymmetries(const TriangleMesh& mesh,
                                  double diameter_m,
                                  const MeshSymmetryOptions& options) {
  const SurfaceProber prober(mesh, diameter_m, options);
  if (prober.empty()) return {};
  return Finder(prober, options).Find();
}

std::vector<SurfaceMismatch> MeasureMismatches(const TriangleMesh& mesh,
                                               double diameter_m,
                                               std::span<const Rigid3> motions,
                                               const MeshSymmetryOptions& options) {
  const SurfaceProber prober(mesh, diameter_m, options);
  std::vector<SurfaceMismatch> out(motions.size());
  if (prober.empty()) return out;
  for (std::size_t i = 0; i < motions.size(); ++i) out[i] = prober.Measure(motions[i]);
  return out;
}

}  // namespace horopter
