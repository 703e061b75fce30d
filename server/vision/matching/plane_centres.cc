#include "server/vision/matching/plane_centres.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <random>

#include "server/vision/geometry/plucker_line.h"
#include "server/vision/matching/homography.h"

namespace horopter {
namespace {

constexpr double kUnitPx = 300.0;      // pixels per unit of the working coordinates
constexpr double kPointSigmaPx = 0.4;  // a junction is not known better than this
constexpr double kCauchyPx = 1.0;
constexpr double kGaugeWeight = 1e6;
constexpr int kMinToAdd = 4;  // points that must agree before a view joins; two always do
constexpr int kRounds = 3;    // of refinement and new inliers

using Vector4 = Eigen::Vector4d;

struct Camera {
  Eigen::Matrix3d H;  // det 1, working coordinates
  Eigen::Vector3d e = Eigen::Vector3d::Zero();
  bool known = false;

  Eigen::Vector3d Apply(const Vector4& X) const { return H * X.head<3>() + X(3) * e; }
};

struct Seen {
  int view = -1;
  Eigen::Vector3d p;  // working coordinates, third entry 1
};

struct Point {
  std::vector<Seen> seen;
  Vector4 X = Vector4::Zero();
  bool valid = false;  // consistent in >= 2 known views
};

double ErrorPx(const Camera& camera, const Vector4& X, const Eigen::Vector3d& p) {
  const Eigen::Vector3d y = camera.Apply(X);
  if (!(std::abs(y.z()) > 1e-9)) return 1e9;
  return kUnitPx * (y.head<2>() / y.z() - p.head<2>()).norm();
}

class Solver {
 public:
  Solver(std::vector<Camera> cameras, std::vector<Point> points, const PlaneCentresOptions& options)
      : cameras_(std::move(cameras)),
        points_(std::move(points)),
        options_(options),
        rng_(options.seed) {}

  // Starts from a pair of views and adds the others; false when the pair gives nothing.
  bool Grow(int a, int b) {
    if (!Seed(a, b)) return false;
    TriangulateAll();
    while (AddBestView()) TriangulateAll();
    return true;
  }

  // Observations of points seen in >= 3 known views count, and of the others a little.
  double Score() const {
    double score = 0.0;
    for (const Point& point : points_) {
      if (!point.valid) continue;
      const int n = KnownViews(point);
      score += n >= 3 ? n : 0.5;
    }
    return score;
  }

  void Refine() {
    for (int round = 0; round < kRounds; ++round) {
      Adjust();
      TriangulateAll();
    }
  }

  // Views that the others do not confirm are forgotten again: of the points that the other views
  // fix, enough must be seen where this one sees them.
  void DropWeakViews() {
    for (bool dropped = true; dropped;) {
      dropped = false;
      double worst = 2.0;
      int worst_view = -1;
      for (size_t v = 0; v < cameras_.size(); ++v) {
        if (!cameras_[v].known) continue;
        const double margin = Margin(static_cast<int>(v));
        if (margin >= worst) continue;
        worst = margin;
        worst_view = static_cast<int>(v);
      }
      if (worst >= 1.0 || worst_view < 0) break;
      cameras_[worst_view].known = false;
      dropped = true;
    }
    TriangulateAll();
  }

  std::vector<PlaneCentres::Pair> Pairs() {
    std::vector<PlaneCentres::Pair> pairs;
    Adjust();  // leaves the covariance of the cameras
    for (size_t a = 0; a < cameras_.size(); ++a) {
      for (size_t b = a + 1; b < cameras_.size(); ++b) {
        if (!cameras_[a].known || !cameras_[b].known) continue;
        PlaneCentres::Pair pair;
        pair.view_a = static_cast<int>(a);
        pair.view_b = static_cast<int>(b);
        pair.F = PairF(cameras_[a], cameras_[b]);
        pair.sigma_px = PairSigma(pair.view_a, pair.view_b);
        pairs.push_back(pair);
      }
    }
    return pairs;
  }

  // Evidence for a view over what is asked: at least 1 is enough.
  double Margin(int view) {
    int possible = 0, consistent = 0;
    cameras_[view].known = false;
    for (const Point& point : points_) {
      const Seen* seen = In(point, view);
      if (!seen) continue;
      Point others = point;
      Triangulate(&others);
      if (!others.valid) continue;
      ++possible;
      consistent += ErrorPx(cameras_[view], others.X, seen->p) < 1.5 * options_.inlier_px;
    }
    cameras_[view].known = true;
    return std::min(static_cast<double>(consistent) / options_.min_off_plane,
                    possible > 0 ? consistent / (options_.min_share * possible) : 0.0);
  }

  const std::vector<Camera>& cameras() const { return cameras_; }
  const std::vector<Point>& points() const { return points_; }
  double RmsPx() const {
    double sum = 0.0;
    int count = 0;
    for (const Point& point : points_) {
      if (!point.valid) continue;
      for (const Seen& s : point.seen) {
        if (!cameras_[s.view].known) continue;
        const double e = ErrorPx(cameras_[s.view], point.X, s.p);
        sum += 0.5 * e * e;
        ++count;
      }
    }
    return count > 0 ? std::sqrt(sum / count) : 0.0;
  }

 private:
  int KnownViews(const Point& point) const {
    int n = 0;
    for (const Seen& s : point.seen) n += cameras_[s.view].known;
    return n;
  }

  static const Seen* In(const Point& point, int view) {
    for (const Seen& s : point.seen) {
      if (s.view == view) return &s;
    }
    return nullptr;
  }

  size_t Draw(size_t n) { return static_cast<size_t>(rng_()) % n; }

  bool Seed(int a, int b) {
    struct Vote {
      Eigen::Vector3d y, p;  // H_b x and what is seen
    };
    std::vector<Vote> votes;
    const Eigen::Matrix3d H = cameras_[b].H * cameras_[a].H.inverse();
    for (const Point& point : points_) {
      const Seen* in_a = In(point, a);
      const Seen* in_b = In(point, b);
      if (!in_a || !in_b) continue;
      const Eigen::Vector3d y = H * in_a->p;
      if (y.z() > 0.0) votes.push_back({y / y.z(), in_b->p});
    }
    if (votes.size() < 3) return false;
    const auto distance = [](const Vote& v, const Eigen::Vector3d& e) {
      const Eigen::Vector3d l = e.cross(v.y);
      const double n = l.head<2>().norm();
      return n > 1e-12 ? kUnitPx * std::abs(l.dot(v.p)) / n : 1e9;
    };
    // Points off the plane all lie on the cameras' side of it.
    const auto side = [](const Vote& v, const Eigen::Vector3d& e) {
      return -v.p.cross(v.y).dot(v.p.cross(e)) > 0.0;
    };
    Eigen::Vector3d best = Eigen::Vector3d::Zero();
    double best_score = 0.0;
    bool best_side = true;
    for (int h = 0; h < options_.hypotheses; ++h) {
      const Vote& v = votes[Draw(votes.size())];
      const Vote& w = votes[Draw(votes.size())];
      Eigen::Vector3d e = v.y.cross(v.p).cross(w.y.cross(w.p));
      const double norm = e.norm();
      if (norm < 1e-12) continue;
      e /= norm;
      double score[2] = {0.0, 0.0};
      for (const Vote& x : votes) {
        const double r = distance(x, e) / options_.inlier_px;
        if (r < 1.0) score[side(x, e)] += 1.0 - r * r;
      }
      if (std::max(score[0], score[1]) <= best_score) continue;
      best_score = std::max(score[0], score[1]);
      best_side = score[1] >= score[0];
      best = e;
    }
    if (best_score <= 0.0) return false;
    for (Camera& c : cameras_) c.known = false;
    cameras_[a].known = cameras_[b].known = true;
    cameras_[a].e.setZero();
    cameras_[b].e = best_side ? best : Eigen::Vector3d(-best);  // rho > 0 towards the cameras
    reference_ = a;
    scaled_ = b;
    return true;
  }

  // Least squares point of the known views; valid when it is consistent with at least two of them,
  // with all of those that see it but at most one, and lies on the cameras' side of the plane.
  void Triangulate(Point* point) const {
    point->valid = false;
    Eigen::Matrix4d A = Eigen::Matrix4d::Zero();
    int known = 0;
    for (const Seen& s : point->seen) {
      if (!cameras_[s.view].known) continue;
      Eigen::Matrix<double, 3, 4> P;
      P << cameras_[s.view].H, cameras_[s.view].e;
      const Eigen::Matrix<double, 3, 4> rows = CrossMatrix(s.p) * P;
      A += rows.transpose() * rows;
      ++known;
    }
    if (known < 2) return;
    Vector4 X = Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d>(A).eigenvectors().col(0);
    if (std::abs(X(2)) < 1e-9) return;
    X /= X(2);
    int consistent = 0;
    for (const Seen& s : point->seen) {
      if (cameras_[s.view].known)
        consistent += ErrorPx(cameras_[s.view], X, s.p) < options_.inlier_px;
    }
    if (consistent < 2 || consistent < known || !(X(3) > 0.0)) return;
    point->X = X;
    point->valid = true;
  }

  void TriangulateAll() {
    for (Point& point : points_) Triangulate(&point);
  }

  struct Sight {
    Vector4 X;
    Eigen::Vector3d p;
  };

  // rho [p]x e = -[p]x H x for every sight.
  static Eigen::Vector3d SolveCentre(const Eigen::Matrix3d& H, const std::vector<Sight>& sights) {
    Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
    Eigen::Vector3d g = Eigen::Vector3d::Zero();
    for (const Sight& s : sights) {
      const Eigen::Matrix3d C = CrossMatrix(s.p);
      A += s.X(3) * s.X(3) * C.transpose() * C;
      g -= s.X(3) * C.transpose() * (C * (H * s.X.head<3>()));
    }
    A.diagonal().array() += 1e-12 * A.trace() + 1e-300;
    return A.ldlt().solve(g);
  }

  bool AddBestView() {
    int best_view = -1;
    size_t best_count = 0;
    Eigen::Vector3d best_e = Eigen::Vector3d::Zero();
    for (size_t v = 0; v < cameras_.size(); ++v) {
      if (cameras_[v].known) continue;
      std::vector<Sight> sights;
      for (const Point& point : points_) {
        const Seen* s = In(point, static_cast<int>(v));
        if (s && point.valid) sights.push_back({point.X, s->p});
      }
      if (sights.size() < kMinToAdd) continue;
      Camera trial = cameras_[v];
      std::vector<Sight> inliers;
      const auto collect = [&](const Eigen::Vector3d& e) {
        trial.e = e;
        std::vector<Sight> near;
        for (const Sight& s : sights) {
          if (ErrorPx(trial, s.X, s.p) < 1.5 * options_.inlier_px) near.push_back(s);
        }
        return near;
      };
      Eigen::Vector3d e_best = Eigen::Vector3d::Zero();
      for (int h = 0; h < options_.hypotheses; ++h) {
        const Sight& s = sights[Draw(sights.size())];
        const Sight& t = sights[Draw(sights.size())];
        const Eigen::Vector3d e = SolveCentre(trial.H, {s, t});
        if (!e.allFinite()) continue;
        std::vector<Sight> near = collect(e);
        if (near.size() <= inliers.size()) continue;
        inliers = std::move(near);
        e_best = e;
      }
      for (int round = 0; round < 3 && inliers.size() >= 3; ++round) {
        const Eigen::Vector3d e = SolveCentre(trial.H, inliers);
        std::vector<Sight> near = collect(e);
        if (near.size() < inliers.size()) break;
        inliers = std::move(near);
        e_best = e;
      }
      if (inliers.size() < kMinToAdd || inliers.size() < options_.min_share * sights.size())
        continue;
      if (inliers.size() <= best_count) continue;
      best_count = inliers.size();
      best_view = static_cast<int>(v);
      best_e = e_best;
    }
    if (best_view < 0) return false;
    cameras_[best_view].known = true;
    cameras_[best_view].e = best_e;
    return true;
  }

  // Levenberg-Marquardt over centres and points, points eliminated. Gauge: the reference stays, and
  // the largest entry of one other centre. Leaves the covariance of the centres.
  void Adjust() {
    const int n = static_cast<int>(cameras_.size());
    int gauge = scaled_;
    if (!cameras_[reference_].known || !cameras_[gauge].known) RepairGauge(&gauge);
    if (gauge < 0) return;
    int gauge_entry = 0;
    cameras_[gauge].e.cwiseAbs().maxCoeff(&gauge_entry);
    double lambda = 1e-4, current = Cost();
    Eigen::MatrixXd S;
    for (int iteration = 0; iteration < 10; ++iteration) {
      S = Eigen::MatrixXd::Zero(3 * n, 3 * n);
      Eigen::VectorXd g = Eigen::VectorXd::Zero(3 * n);
      struct Eliminated {
        Eigen::Matrix3d V_inverse;
        Eigen::Vector3d g;
        std::vector<std::pair<int, Eigen::Matrix3d>> W;
      };
      std::vector<Eliminated> eliminated(points_.size());
      for (size_t k = 0; k < points_.size(); ++k) {
        const Point& point = points_[k];
        if (!point.valid) continue;
        Eigen::Matrix3d V = Eigen::Matrix3d::Zero();
        Eliminated& out = eliminated[k];
        out.g.setZero();
        for (const Seen& s : point.seen) {
          const Camera& camera = cameras_[s.view];
          if (!camera.known) continue;
          const Eigen::Vector3d y = camera.Apply(point.X);
          const Eigen::Vector2d r = kUnitPx * (y.head<2>() / y.z() - s.p.head<2>());
          Eigen::Matrix<double, 2, 3> D;
          D << 1 / y.z(), 0, -y.x() / (y.z() * y.z()), 0, 1 / y.z(), -y.y() / (y.z() * y.z());
          D *= kUnitPx;
          const Eigen::Matrix<double, 2, 3> J_e = point.X(3) * D;
          Eigen::Matrix3d of_point;  // of (x, y, rho)
          of_point << camera.H.col(0), camera.H.col(1), camera.e;
          const Eigen::Matrix<double, 2, 3> J_p = D * of_point;
          const double w = 1.0 / (1.0 + r.squaredNorm() / (kCauchyPx * kCauchyPx));
          V += w * J_p.transpose() * J_p;
          out.g -= w * J_p.transpose() * r;
          S.block<3, 3>(3 * s.view, 3 * s.view) += w * J_e.transpose() * J_e;
          g.segment<3>(3 * s.view) -= w * J_e.transpose() * r;
          out.W.emplace_back(s.view, w * J_e.transpose() * J_p);
        }
        V.diagonal() *= 1.0 + lambda;
        V.diagonal().array() += 1e-12 * V.trace() + 1e-12;
        out.V_inverse = V.inverse();
        for (const auto& [i, W_i] : out.W) {
          g.segment<3>(3 * i) -= W_i * out.V_inverse * out.g;
          for (const auto& [j, W_j] : out.W)
            S.block<3, 3>(3 * i, 3 * j) -= W_i * out.V_inverse * W_j.transpose();
        }
      }
      for (int v = 0; v < n; ++v) {
        if (!cameras_[v].known || v == reference_)
          S.block<3, 3>(3 * v, 3 * v) += kGaugeWeight * Eigen::Matrix3d::Identity();
      }
      S(3 * gauge + gauge_entry, 3 * gauge + gauge_entry) += kGaugeWeight;
      Eigen::MatrixXd damped = S;
      damped.diagonal() *= 1.0 + lambda;
      const Eigen::VectorXd step = damped.ldlt().solve(g);
      if (!step.allFinite()) break;
      const std::vector<Camera> cameras_before = cameras_;
      const std::vector<Point> points_before = points_;
      for (int v = 0; v < n; ++v) {
        if (cameras_[v].known && v != reference_) cameras_[v].e += step.segment<3>(3 * v);
      }
      for (size_t k = 0; k < points_.size(); ++k) {
        if (!points_[k].valid) continue;
        Eigen::Vector3d rhs = eliminated[k].g;
        for (const auto& [i, W_i] : eliminated[k].W)
          rhs -= W_i.transpose() * step.segment<3>(3 * i);
        const Eigen::Vector3d d = eliminated[k].V_inverse * rhs;
        points_[k].X += Vector4(d.x(), d.y(), 0.0, d.z());
      }
      const double there = Cost();
      if (there < current) {
        const bool done = current - there < 1e-9 * current;
        current = there;
        lambda = std::max(1e-9, 0.1 * lambda);
        if (done) break;
      } else {
        cameras_ = cameras_before;
        points_ = points_before;
        lambda *= 10.0;
        if (lambda > 1e4) break;
      }
    }
    const double rms = RmsPx();
    covariance_ = std::max(kPointSigmaPx * kPointSigmaPx, rms * rms) * S.inverse();
  }

  // The views the scale hung on were dropped: two others carry it.
  void RepairGauge(int* gauge) {
    std::vector<int> known;
    for (size_t v = 0; v < cameras_.size(); ++v) {
      if (cameras_[v].known) known.push_back(static_cast<int>(v));
    }
    *gauge = -1;
    if (known.size() < 2) return;
    reference_ = known[0];
    // e_i -> e_i - H_i v and x -> x + rho v leave all images alone.
    const Eigen::Vector3d v = cameras_[reference_].H.inverse() * cameras_[reference_].e;
    for (Camera& c : cameras_) c.e -= c.H * v;
    for (Point& point : points_) {
      if (!point.valid) continue;
      point.X.head<3>() += point.X(3) * v;
      if (std::abs(point.X(2)) > 1e-9) point.X /= point.X(2);
    }
    *gauge = scaled_ = known[1];
  }

  double Cost() const {
    double sum = 0.0;
    for (const Point& point : points_) {
      if (!point.valid) continue;
      for (const Seen& s : point.seen) {
        if (!cameras_[s.view].known) continue;
        const double e = ErrorPx(cameras_[s.view], point.X, s.p) / kCauchyPx;
        sum += std::log1p(e * e);
      }
    }
    return sum;
  }

  static Eigen::Matrix3d PairF(const Camera& a, const Camera& b) {
    const Eigen::Matrix3d H = b.H * a.H.inverse();
    const Eigen::Matrix3d F = CrossMatrix(b.e - H * a.e) * H;
    return F / F.norm();
  }

  // Deviation of the epipolar lines in b of the used points, from both centres' covariance.
  double PairSigma(int a, int b) const {
    if (covariance_.size() == 0) return 1e9;
    constexpr double kStep = 1e-6;
    Eigen::Matrix<double, 6, 6> C;
    const int at[2] = {3 * a, 3 * b};
    for (int i = 0; i < 2; ++i) {
      for (int j = 0; j < 2; ++j)
        C.block<3, 3>(3 * i, 3 * j) = covariance_.block<3, 3>(at[i], at[j]);
    }
    Eigen::Matrix3d moved[6];
    for (int k = 0; k < 6; ++k) {
      Camera x = cameras_[a], y = cameras_[b];
      (k < 3 ? x.e : y.e)(k % 3) += kStep;
      moved[k] = PairF(x, y);
    }
    const Eigen::Matrix3d F = PairF(cameras_[a], cameras_[b]);
    const auto offset =
        [](const Eigen::Matrix3d& f, const Eigen::Vector3d& p, const Eigen::Vector3d& q) {
          const Eigen::Vector3d l = f * p;
          return kUnitPx * l.dot(q) / std::max(1e-12, l.head<2>().norm());
        };
    double worst = 0.0;
    for (const Point& point : points_) {
      if (!point.valid) continue;
      const Seen* in_a = In(point, a);
      const Seen* in_b = In(point, b);
      if (!in_a || !in_b) continue;
      const double here = offset(F, in_a->p, in_b->p);
      Eigen::Matrix<double, 1, 6> J;
      for (int k = 0; k < 6; ++k) J(k) = (offset(moved[k], in_a->p, in_b->p) - here) / kStep;
      worst = std::max(worst, (J * C * J.transpose())(0));
    }
    return worst > 0.0 && std::isfinite(worst) ? std::sqrt(worst) : 1e9;
  }

  std::vector<Camera> cameras_;
  std::vector<Point> points_;
  PlaneCentresOptions options_;
  std::mt19937 rng_;
  int reference_ = 0, scaled_ = 0;
  Eigen::MatrixXd covariance_;
};

// Largest displacement of the point against the plane, over the pairs of its views.
double Displacement(std::span<const PlaneView> views, const PlanePoint& point) {
  double largest = 0.0;
  const auto& first = point.observations.front();
  for (const auto& o : point.observations) {
    const Eigen::Matrix3d H =
        views[o.view].view_from_plane * views[first.view].view_from_plane.inverse();
    const double d = (Transfer(H, first.pixel) - o.pixel).norm();
    if (std::isfinite(d)) largest = std::max(largest, d);
  }
  return largest;
}

}  // namespace

PlaneCentres EstimatePlaneCentres(std::span<const PlaneView> views,
                                  std::span<const PlanePoint> points,
                                  const PlaneCentresOptions& options) {
  PlaneCentres result;
  const int n = static_cast<int>(views.size());
  result.epipoles.resize(n);
  result.point_used.assign(points.size(), false);
  // Working coordinates: pixels about the mean of what is seen, in kUnitPx.
  std::vector<Eigen::Vector2d> middle(n, Eigen::Vector2d::Zero());
  std::vector<int> count(n, 0);
  Eigen::Vector2d plane_middle = Eigen::Vector2d::Zero();
  int plane_count = 0;
  for (const PlanePoint& point : points) {
    for (const auto& o : point.observations) {
      middle[o.view] += o.pixel;
      ++count[o.view];
      const Eigen::Vector2d x = Transfer(views[o.view].view_from_plane.inverse(), o.pixel);
      if (!x.allFinite() || x.norm() > 1e5) continue;
      plane_middle += x;
      ++plane_count;
    }
  }
  if (plane_count == 0) return result;
  plane_middle /= plane_count;
  const auto centred = [](const Eigen::Vector2d& c) {
    Eigen::Matrix3d T;
    T << 1 / kUnitPx, 0, -c.x() / kUnitPx, 0, 1 / kUnitPx, -c.y() / kUnitPx, 0, 0, 1;
    return T;
  };
  std::vector<Camera> cameras(n);
  std::vector<Eigen::Matrix3d> T(n);
  for (int v = 0; v < n; ++v) {
    T[v] = centred(count[v] > 0 ? Eigen::Vector2d(middle[v] / count[v]) : Eigen::Vector2d(0, 0));
    const auto H =
        NormalizeDeterminant(T[v] * views[v].view_from_plane * centred(plane_middle).inverse());
    if (!H) return result;
    cameras[v].H = *H;
  }
  std::vector<Point> off_plane;
  std::vector<int> index;
  for (size_t k = 0; k < points.size(); ++k) {
    if (points[k].observations.size() < 2 || Displacement(views, points[k]) <= options.on_plane_px)
      continue;
    Point point;
    for (const auto& o : points[k].observations)
      point.seen.push_back({o.view, T[o.view] * o.pixel.homogeneous()});
    off_plane.push_back(std::move(point));
    index.push_back(static_cast<int>(k));
  }
  // The pairs that share most points start.
  std::vector<std::tuple<int, int, int>> seeds;
  for (int a = 0; a < n; ++a) {
    for (int b = a + 1; b < n; ++b) {
      int shared = 0;
      for (const Point& point : off_plane) {
        int in = 0;
        for (const Seen& s : point.seen) in += s.view == a || s.view == b;
        shared += in == 2;
      }
      if (shared >= kMinToAdd) seeds.emplace_back(-shared, a, b);
    }
  }
  std::sort(seeds.begin(), seeds.end());
  if (static_cast<int>(seeds.size()) > options.seeds) seeds.resize(options.seeds);
  std::optional<Solver> best;
  double best_score = 0.0;
  for (const auto& [unused, a, b] : seeds) {
    Solver solver(cameras, off_plane, options);
    if (!solver.Grow(a, b) || solver.Score() <= best_score) continue;
    best_score = solver.Score();
    best.emplace(std::move(solver));
  }
  if (!best) return result;
  best->Refine();
  best->DropWeakViews();
  for (const PlaneCentres::Pair& pair : best->Pairs()) {
    if (!(pair.sigma_px <= options.max_sigma_px)) continue;
    result.pairs.push_back(pair);
    Eigen::Matrix3d& F = result.pairs.back().F;
    F = T[pair.view_b].transpose() * pair.F * T[pair.view_a];
    F /= F.norm();
  }
  for (int v = 0; v < n; ++v) {
    if (best->cameras()[v].known) result.epipoles[v] = T[v].inverse() * best->cameras()[v].e;
  }
  for (size_t k = 0; k < off_plane.size(); ++k)
    result.point_used[index[k]] = best->points()[k].valid;
  result.rms_px = best->RmsPx();
  return result;
}

}  // namespace horopter
