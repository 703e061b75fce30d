#include "server/vision/geometry/mesh_symmetry.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <optional>
#include <random>

#include "server/base/stop_scope.h"
#include "server/vision/geometry/surface_distance.h"

namespace horopter {
namespace {

using Eigen::Vector3d;

constexpr double kPi = std::numbers::pi;
constexpr int kAreaSamples = 700, kVertexSamples = 1200;
constexpr int kFitSamples = 300;            // for moving an axis
constexpr int kGlanceSamples = 60;          // for a first look
constexpr double kSameAxis = 0.9998;        // cosine, one degree
constexpr int kFewFold = 12;                // orders that near symmetries are looked for in
constexpr double kAnyTurns[] = {2.3, 1.0};  // rad; no rational parts of a turn
constexpr double kFlipStep = kPi / 60.0;    // between half turns that are tried
constexpr double kRegionGap = 0.06;         // diameters; nearer samples are one region
constexpr int kPlaneAxes = 5;               // faces whose normals are tried as axes
constexpr double kSameTurn = 0.1;           // Frobenius, 4 degrees: an exact one, measured anew
// A near symmetry is one of small features, or of small steps (diameters) of large faces.
constexpr double kSmallShare = 0.2, kSmallStep = 0.015;
constexpr double kSphereInside = 0.97;  // of the radius; sixteen facets around
constexpr double kSharper = 1.5;        // a lower order must fit so much better

struct Sample {
  Vector3d point;
  bool vertex = false;  // of the mesh, where its features are; otherwise stands for area
};

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

class Prober {
 public:
  Prober(const TriangleMesh& mesh, double diameter_m, const MeshSymmetryOptions& options)
      : mesh_(mesh),
        options_(options),
        diameter_(diameter_m),
        surface_(mesh, options.reach * diameter_m) {
    Draw();
  }

  bool empty() const { return area_.empty(); }
  const Vector3d& center() const { return center_; }
  double diameter_m() const { return diameter_; }
  double near_mean_m() const { return options_.near_mean * diameter_; }
  double tolerance_m() const { return options_.tolerance * diameter_; }

  // Mean distance of the first `count` samples of the area; at least `enough` if it gets there.
  double Mean(const Rigid3& motion, int count, double enough) const {
    count = std::min<int>(count, static_cast<int>(area_.size()));
    LeaveIfStopped();
    const double most = enough * count;
    double sum = 0.0;
    for (int i = 0; i < count; ++i) {
      sum += surface_.At(motion * area_[i].point).distance;
      if (sum > most) return std::max(enough, sum / count);
    }
    return sum / count;
  }

  // Whether no sample is off.
  bool Exact(const Rigid3& motion) const {
    const auto on = [&](const Sample& s) {
      return surface_.At(motion * s.point).distance <= tolerance_m();
    };
    return std::all_of(area_.begin(), area_.end(), on) &&
           std::all_of(vertices_.begin(), vertices_.end(), on);
  }

  // Vertices at one distance from the centre, and the facets between them not far inside.
  bool IsSphere() const {
    double least = std::numeric_limits<double>::infinity(), most = 0.0, inside = least;
    for (const Sample& s : vertices_) {
      const double r = (s.point - center_).norm();
      least = std::min(least, r);
      most = std::max(most, r);
    }
    for (const Sample& s : area_) inside = std::min(inside, (s.point - center_).norm());
    return most - least <= 2.0 * tolerance_m() && inside >= kSphereInside * most;
  }

  SurfaceMismatch Measure(const Rigid3& motion) const {
    SurfaceMismatch out;
    std::vector<Vector3d> off_area, off_vertices;
    for (const auto* samples : {&area_, &vertices_}) {
      for (const Sample& s : *samples) {
        const double distance = surface_.At(motion * s.point).distance;
        out.largest_m = std::max(out.largest_m, distance);
        const bool off = distance > tolerance_m();
        if (off) (s.vertex ? off_vertices : off_area).push_back(s.point);
        if (!s.vertex) out.mean_m += distance / static_cast<double>(area_.size());
      }
    }
    out.area_share = static_cast<double>(off_area.size()) / static_cast<double>(area_.size());
    // What a feature is told by are its vertices; the plain face in the place of its counterpart
    // has none.
    const auto& off = off_vertices.size() >= 3 ? off_vertices : off_area;
    const Eigen::AlignedBox3d region = LargestRegion(off);
    if (!region.isEmpty()) {
      out.place = region.center();
      out.size_m = region.diagonal().norm();
    }
    return out;
  }

  // The axis moved to where its turn fits best: point-to-plane steps on what lies near already.
  SymmetryAxis Fit(SymmetryAxis axis, double angle) const {
    Rigid3 motion = TurnAbout(axis, angle);
    double gate = 0.03 * diameter_;
    for (int round = 0; round < 4; ++round, gate *= 0.6) {
      Eigen::Matrix<double, 6, 6> A = Eigen::Matrix<double, 6, 6>::Zero();
      Eigen::Matrix<double, 6, 1> b = Eigen::Matrix<double, 6, 1>::Zero();
      const int count = std::min<int>(kFitSamples, static_cast<int>(area_.size()));
      for (int i = 0; i < count; ++i) {
        const Vector3d p = motion * area_[i].point;
        const SurfaceDistance::Nearest nearest = surface_.At(p);
        if (nearest.triangle < 0 || nearest.distance > gate) continue;
        const Vector3d n = NormalOf(nearest.triangle);
        Eigen::Matrix<double, 6, 1> row;
        row << (p - center_).cross(n) / diameter_, n;  // rotations in diameters
        A += row * row.transpose();
        b -= n.dot(p - nearest.point) * row;
      }
      // Free directions (a cylinder turns as it likes) stay as they are.
      A.diagonal().array() += 1e-3 * A.trace() / 6.0 + 1e-12;
      const Eigen::Matrix<double, 6, 1> step = A.ldlt().solve(b);
      const Vector3d turn = step.head<3>() / diameter_;
      const double size = turn.norm();
      const Eigen::Matrix3d R = size > 1e-12
                                    ? Eigen::AngleAxisd(size, turn / size).toRotationMatrix()
                                    : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
      motion = Rigid3{R, center_ - R * center_ + step.tail<3>()} * motion;
    }
    return AxisOf(motion, axis);
  }

  // Normals of the largest plane faces, largest first; opposite ones are one.
  std::vector<Vector3d> FaceDirections() const {
    struct Direction {
      Vector3d normal;
      int count;
    };
    std::vector<Direction> found;
    for (std::size_t i = 0; i < area_.size(); ++i) {
      const Vector3d& n = area_normals_[i];
      const auto known = std::find_if(found.begin(), found.end(), [&](const Direction& d) {
        return std::abs(d.normal.dot(n)) > kSameAxis;
      });
      if (known != found.end()) {
        ++known->count;
      } else {
        found.push_back({n, 1});
      }
    }
    std::stable_sort(found.begin(), found.end(), [](const Direction& a, const Direction& b) {
      return a.count > b.count;
    });
    std::vector<Vector3d> out;
    for (const Direction& d : found) {
      if (static_cast<int>(out.size()) == kPlaneAxes || d.count < 4) break;
      out.push_back(d.normal);
    }
    return out;
  }

  std::vector<Vector3d> PrincipalDirections() const {
    Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
    for (const Sample& s : area_) {
      moment += (s.point - center_) * (s.point - center_).transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(moment);
    return {
        solver.eigenvectors().col(2), solver.eigenvectors().col(1), solver.eigenvectors().col(0)};
  }

 private:
  Vector3d NormalOf(int triangle) const {
    const Eigen::Vector3i& t = mesh_.triangles[triangle];
    return (mesh_.vertices[t[1]] - mesh_.vertices[t[0]])
        .cross(mesh_.vertices[t[2]] - mesh_.vertices[t[0]])
        .normalized();
  }

  // Points evenly over the area in an order without pattern, and the vertices.
  void Draw() {
    const int vertex_count = static_cast<int>(mesh_.vertices.size());
    std::vector<double> until;
    std::vector<int> triangles;
    std::vector<char> used(mesh_.vertices.size(), 0);
    double area = 0.0;
    Vector3d sum = Vector3d::Zero();
    for (int t = 0; t < static_cast<int>(mesh_.triangles.size()); ++t) {
      const Eigen::Vector3i& v = mesh_.triangles[t];
      if (v.minCoeff() < 0 || v.maxCoeff() >= vertex_count) continue;
      const Vector3d &a = mesh_.vertices[v[0]], &b = mesh_.vertices[v[1]],
                     &c = mesh_.vertices[v[2]];
      const double size = (b - a).cross(c - a).norm();
      if (!(size > 0.0)) continue;
      for (const int k : v) used[k] = 1;
      area += size;
      sum += size * (a + b + c) / 3.0;
      until.push_back(area);
      triangles.push_back(t);
    }
    if (!(area > 0.0) || !(diameter_ > 0.0)) return;
    center_ = sum / area;
    std::mt19937 random(20);
    const auto uniform = [&] { return (random() + 0.5) / 4294967296.0; };
    std::size_t at = 0;
    for (int i = 0; i < kAreaSamples; ++i) {
      const double want = (i + uniform()) / kAreaSamples * area;
      while (at + 1 < until.size() && until[at] < want) ++at;
      const Eigen::Vector3i& v = mesh_.triangles[triangles[at]];
      double r = uniform(), s = uniform();
      if (r + s > 1.0) r = 1.0 - r, s = 1.0 - s;
      area_.push_back({mesh_.vertices[v[0]] + r * (mesh_.vertices[v[1]] - mesh_.vertices[v[0]]) +
                           s * (mesh_.vertices[v[2]] - mesh_.vertices[v[0]]),
                       false});
    }
    for (std::size_t i = area_.size(); i > 1; --i) std::swap(area_[i - 1], area_[random() % i]);
    for (const Sample& s : area_) area_normals_.push_back(NormalOf(surface_.At(s.point).triangle));
    std::vector<int> vertices;
    for (int v = 0; v < vertex_count; ++v) {
      if (used[v]) vertices.push_back(v);
    }
    const std::size_t wanted = std::min<std::size_t>(kVertexSamples, vertices.size());
    for (std::size_t i = 0; i < wanted; ++i) {
      vertices_.push_back({mesh_.vertices[vertices[i * vertices.size() / wanted]], true});
    }
  }

  Eigen::AlignedBox3d LargestRegion(const std::vector<Vector3d>& points) const {
    const double gap = kRegionGap * diameter_;
    std::vector<char> done(points.size(), 0);
    Eigen::AlignedBox3d best;
    std::size_t most = 0;
    for (std::size_t seed = 0; seed < points.size(); ++seed) {
      if (done[seed]) continue;
      std::vector<std::size_t> region{seed};
      done[seed] = 1;
      Eigen::AlignedBox3d box;
      for (std::size_t i = 0; i < region.size(); ++i) {
        box.extend(points[region[i]]);
        for (std::size_t k = 0; k < points.size(); ++k) {
          if (done[k] || (points[k] - points[region[i]]).norm() > gap) continue;
          done[k] = 1;
          region.push_back(k);
        }
      }
      if (region.size() <= most) continue;
      most = region.size();
      best = box;
    }
    return best;
  }

  // The axis of a motion that is nearly a turn; `like` gives its order and which way it points.
  SymmetryAxis AxisOf(const Rigid3& motion, const SymmetryAxis& like) const {
    const Eigen::AngleAxisd turn(motion.R);
    if (!(turn.angle() > 0.3)) return like;
    SymmetryAxis out = like;
    out.axis = turn.axis().dot(like.axis) < 0.0 ? Vector3d(-turn.axis()) : turn.axis();
    const Vector3d across = motion.t - out.axis * out.axis.dot(motion.t);
    const Eigen::Matrix3d A = Eigen::Matrix3d::Identity() - motion.R;
    const Vector3d point = A.completeOrthogonalDecomposition().solve(across);
    // Of the axis the point nearest to the centre.
    out.point = point + out.axis * out.axis.dot(center_ - point);
    return out;
  }

  const TriangleMesh& mesh_;
  const MeshSymmetryOptions& options_;
  double diameter_;
  SurfaceDistance surface_;
  Vector3d center_ = Vector3d::Zero();
  std::vector<Sample> area_, vertices_;
  std::vector<Vector3d> area_normals_;
};

// What is known of an axis: exact, near or neither.
struct Judged {
  bool exact = false;
  double mean_m = 0.0;
  SymmetryAxis axis;
};

class Finder {
 public:
  Finder(const Prober& prober, const MeshSymmetryOptions& options)
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

  const Prober& prober_;
  const MeshSymmetryOptions& options_;
  MeshSymmetries out_;
  std::vector<Judged> near_;
};

bool Known(const std::vector<Eigen::Matrix3d>& list, const Eigen::Matrix3d& R) {
  // Frobenius, 2.4 degrees: measured axes are not exact; turns of order 120 differ by 3 degrees.
  constexpr double kSameRotation = 0.06;
  return std::any_of(
      list.begin(), list.end(), [&](const auto& k) { return (k - R).norm() < kSameRotation; });
}

// Products of the generators until nothing new comes.
std::vector<Eigen::Matrix3d> Closure(const std::vector<Eigen::Matrix3d>& generators, int most) {
  std::vector<Eigen::Matrix3d> group{Eigen::Matrix3d::Identity()};
  for (std::size_t i = 0; i < group.size(); ++i) {
    for (const Eigen::Matrix3d& g : generators) {
      if (static_cast<int>(group.size()) > most) return group;
      const Eigen::Matrix3d product = group[i] * g;
      if (!Known(group, product)) group.push_back(product);
    }
  }
  return group;
}

Eigen::Matrix3d Turn(double angle, const Vector3d& axis) {
  return Eigen::AngleAxisd(angle, axis.normalized()).toRotationMatrix();
}

}  // namespace

Rigid3 TurnAbout(const SymmetryAxis& axis, double angle_rad) {
  const Eigen::Matrix3d R = Turn(angle_rad, axis.axis);
  return {R, axis.point - R * axis.point};
}

std::vector<Rigid3> TurnsOf(const SymmetryAxis& axis, int steps) {
  const int count = axis.order == 0 ? steps : axis.order;
  std::vector<Rigid3> out;
  for (int k = 1; k < count; ++k) out.push_back(TurnAbout(axis, 2.0 * kPi * k / count));
  return out;
}

MeshSymmetries FindMeshSymmetries(const TriangleMesh& mesh,
                                  double diameter_m,
                                  const MeshSymmetryOptions& options) {
  const Prober prober(mesh, diameter_m, options);
  if (prober.empty()) return {};
  return Finder(prober, options).Find();
}

std::vector<SurfaceMismatch> MeasureMismatches(const TriangleMesh& mesh,
                                               double diameter_m,
                                               std::span<const Rigid3> motions,
                                               const MeshSymmetryOptions& options) {
  const Prober prober(mesh, diameter_m, options);
  std::vector<SurfaceMismatch> out(motions.size());
  if (prober.empty()) return out;
  for (std::size_t i = 0; i < motions.size(); ++i) out[i] = prober.Measure(motions[i]);
  return out;
}

std::vector<Rigid3> SymmetryGroup(const MeshSymmetries& symmetries, int steps, int most) {
  std::vector<Eigen::Matrix3d> generators;
  if (symmetries.sphere) {
    const double golden = 0.5 * (1.0 + std::sqrt(5.0));
    generators = {Turn(2.0 * kPi / 5.0, {0.0, 1.0, golden}), Turn(kPi, Vector3d::UnitZ())};
  }
  for (const SymmetryAxis& a : symmetries.exact) {
    Vector3d axis = a.axis;
    // Measured axes are off by hundredths of a degree, which products would add up.
    const Vector3d& main = symmetries.exact.front().axis;
    if (std::abs(axis.dot(main)) < 0.03) axis -= main * axis.dot(main);
    generators.push_back(Turn(2.0 * kPi / (a.order == 0 ? steps : a.order), axis));
  }
  std::vector<Rigid3> out;
  for (const Eigen::Matrix3d& R : Closure(generators, most)) {
    if ((R - Eigen::Matrix3d::Identity()).norm() < 1e-6) continue;
    out.push_back({R, symmetries.center - R * symmetries.center});
  }
  return out;
}

}  // namespace horopter
