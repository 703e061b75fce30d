#include "tests/support/synthetic_tracks.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "server/vision/geometry/collineation.h"
#include "server/vision/reconstruction/intersection_resection.h"

namespace horopter {
namespace {

// The standard's distributions differ between libraries; these do not.
class Random {
 public:
  explicit Random(unsigned seed) : rng_(seed) {}
  double Uniform(double low, double high) {
    return low + (high - low) * ((static_cast<double>(rng_()) + 0.5) / 4294967296.0);
  }
  double Normal() {
    return std::sqrt(-2.0 * std::log(Uniform(0.0, 1.0))) *
           std::cos(2.0 * std::numbers::pi * Uniform(0.0, 1.0));
  }
  Eigen::Vector2d Noise(double sigma) {
    const double x = Normal();
    return sigma * Eigen::Vector2d(x, Normal());
  }
  Eigen::Vector3d InBox(const Eigen::Vector3d& half) {
    const double x = Uniform(-1, 1), y = Uniform(-1, 1);
    return Eigen::Vector3d(x, y, Uniform(-1, 1)).cwiseProduct(half);
  }
  int Index(int n) { return std::min(n - 1, static_cast<int>(Uniform(0.0, n))); }

 private:
  std::mt19937 rng_;
};

// Profiles of unit size: L, T, U, step, wedge.
std::vector<Eigen::Vector2d> Profile(int kind, Random* random) {
  const double a = random->Uniform(0.2, 0.45), b = random->Uniform(0.2, 0.45);
  switch (kind) {
    case 0:
      return {{0, 0}, {1, 0}, {1, a}, {b, a}, {b, 1}, {0, 1}};
    case 1:
      return {{0, 1 - a},
              {0, 1},
              {1, 1},
              {1, 1 - a},
              {0.5 + b / 2, 1 - a},
              {0.5 + b / 2, 0},
              {0.5 - b / 2, 0},
              {0.5 - b / 2, 1 - a}};
    case 2:
      return {{0, 0}, {1, 0}, {1, 1}, {1 - a, 1}, {1 - a, b}, {a, b}, {a, 1}, {0, 1}};
    case 3:
      return {{0, 0}, {1, 0}, {1, a}, {0.7, a}, {0.7, a + b}, {0, a + b}};
    default:
      return {{0, 0}, {1, 0}, {1, a}, {0, 1}};
  }
}

void AddPart(int index, int parts, Random* random, SyntheticTracks* out) {
  const double size = random->Uniform(0.05, 0.11), height = random->Uniform(0.03, 0.08);
  const double turn = random->Uniform(0.0, 2.0 * std::numbers::pi);
  const double place = 2.0 * std::numbers::pi * index / parts;
  const double radius = parts > 1 ? 0.12 : 0.0;
  const Eigen::Matrix3d R = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  const Eigen::Vector3d t(radius * std::cos(place), radius * std::sin(place), 0.0);
  const auto profile = Profile(random->Index(5), random);
  const int n = static_cast<int>(profile.size());
  const size_t first = out->points.size();
  for (int level = 0; level < 2; ++level) {
    for (const Eigen::Vector2d& p : profile) {
      const Eigen::Vector3d local(size * (p.x() - 0.5), size * (p.y() - 0.5), level * height);
      out->points.push_back(R * local + t);
      out->part_of_point.push_back(index);
    }
  }
  for (int i = 0; i < n; ++i) {
    const size_t a = first + i, b = first + (i + 1) % n;
    out->lines.push_back({out->points[a], out->points[b]});
    out->lines.push_back({out->points[a + n], out->points[b + n]});
    out->lines.push_back({out->points[a], out->points[a + n]});
  }
}

void AddStructure(const SyntheticTracksOptions& options, Random* random, SyntheticTracks* out) {
  const Eigen::Vector3d half(0.15, 0.15, 0.08);
  out->points = options.given_points;
  out->lines = options.given_lines;
  const bool given = !out->points.empty() || !out->lines.empty();
  if (!given && options.points == 0 && options.lines == 0) {
    for (int k = 0; k < options.parts; ++k) AddPart(k, options.parts, random, out);
  }
  for (int k = 0; k < options.points; ++k) out->points.push_back(random->InBox(half));
  const Eigen::Vector3d common = random->InBox(Eigen::Vector3d::Constant(0.1));
  for (int k = 0; k < options.lines; ++k) {
    const Eigen::Vector3d a = random->InBox(half);
    const Eigen::Vector3d d = random->InBox(Eigen::Vector3d::Constant(0.1));
    out->lines.push_back({a, options.parallel_lines ? Eigen::Vector3d(a + common) : a + d});
  }
  if (!options.planar) return;
  for (Eigen::Vector3d& x : out->points) x.z() = 0.0;
  for (auto& [a, b] : out->lines) a.z() = b.z() = 0.0;
}

void AddCameras(const SyntheticTracksOptions& options, Random* random, SyntheticTracks* out) {
  const double shared = random->Uniform(options.min_focal_px, options.max_focal_px);
  for (int i = 0; i < options.views; ++i) {
    const double share = options.views > 1 ? i / (options.views - 1.0) - 0.5 : 0.0;
    const double azimuth = options.pure_rotation ? 0.0 : options.arc_rad * share;
    const double elevation = options.pure_rotation ? 0.8 : random->Uniform(0.5, 1.0);
    const double distance =
        options.distance_m * (options.pure_rotation ? 1.0 : random->Uniform(0.9, 1.1));
    const Eigen::Vector3d center =
        distance * Eigen::Vector3d(std::cos(elevation) * std::cos(azimuth),
                                   std::cos(elevation) * std::sin(azimuth),
                                   std::sin(elevation));
    const Eigen::Vector3d target = random->InBox(Eigen::Vector3d(0.03, 0.03, 0.03));
    Rigid3 pose;
    const Eigen::Vector3d z = (target - center).normalized();
    const Eigen::Vector3d x = z.cross(Eigen::Vector3d::UnitZ()).normalized();
    pose.R << x.transpose(), z.cross(x).transpose(), z.transpose();
    pose.R = Eigen::AngleAxisd(random->Uniform(-0.2, 0.2), Eigen::Vector3d::UnitZ()) * pose.R;
    pose.t = -(pose.R * center);
    out->camera_from_world.push_back(pose);
    PinholeCamera camera = CenteredCamera(640, 480, 0.0);
    camera.focal_px = random->Uniform(options.min_focal_px, options.max_focal_px);
    if (options.equal_focal) camera.focal_px = shared;
    const Eigen::Vector2d offset = random->Noise(options.principal_point_sd_px);
    camera.cx += offset.x();
    camera.cy += offset.y();
    camera.k1 = options.k1;
    out->cameras.push_back(camera);
    out->tracks.sizes.push_back({camera.width, camera.height});
  }
}

Eigen::Vector2d Displacement(const SyntheticTrackNoise& noise, Random* random) {
  const double angle = random->Uniform(0.0, 2.0 * std::numbers::pi);
  const double length = random->Uniform(noise.min_outlier_px, noise.max_outlier_px);
  return length * Eigen::Vector2d(std::cos(angle), std::sin(angle));
}

void Observe(const SyntheticTrackNoise& noise, SyntheticTracks* out) {
  Random random(noise.seed * 7919u + 17u);
  const double stated = std::max(noise.sigma_px, 0.01);
  out->tracks.points = static_cast<int>(out->points.size());
  out->tracks.lines = static_cast<int>(out->lines.size());
  for (int v = 0; v < static_cast<int>(out->cameras.size()); ++v) {
    const auto image = [&](const Eigen::Vector3d& x) {
      return Project(out->cameras[v], out->camera_from_world[v] * x);
    };
    for (int j = 0; j < out->tracks.points; ++j) {
      const bool missing = random.Uniform(0.0, 1.0) < noise.missing_share;
      const bool wrong = random.Uniform(0.0, 1.0) < noise.outlier_share;
      Eigen::Vector2d x = image(out->points[j]) + random.Noise(noise.sigma_px);
      const Eigen::Vector2d shift = Displacement(noise, &random);
      if (missing) continue;
      if (wrong) x += shift;
      out->tracks.point_observations.push_back({v, j, x, stated});
      out->point_outlier.push_back(wrong);
    }
    for (int j = 0; j < out->tracks.lines; ++j) {
      const auto& [a, b] = out->lines[j];
      const bool missing = random.Uniform(0.0, 1.0) < noise.missing_share;
      const bool wrong = random.Uniform(0.0, 1.0) < noise.outlier_share;
      // Every view sees another piece.
      const double from = random.Uniform(0.0, 0.2), to = random.Uniform(0.8, 1.0);
      Eigen::Vector2d s = image(a + from * (b - a)) + random.Noise(noise.sigma_px);
      Eigen::Vector2d e = image(a + to * (b - a)) + random.Noise(noise.sigma_px);
      const Eigen::Vector2d shift_s = Displacement(noise, &random);
      const Eigen::Vector2d shift_e = Displacement(noise, &random);
      if (missing) continue;
      if (wrong) {
        s += shift_s;
        e += shift_e;
      }
      out->tracks.line_observations.push_back({v, j, s, e, stated});
      out->line_outlier.push_back(wrong);
    }
  }
}

// Homogeneous coordinates differ by orders of magnitude between gauges: whitened by their moments.
Eigen::Matrix4d Whitening(const std::vector<Eigen::Vector4d>& points) {
  Eigen::Matrix4d moment = Eigen::Matrix4d::Zero();
  for (const Eigen::Vector4d& x : points) moment += x * x.transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> solver(moment);
  const Eigen::Vector4d values = solver.eigenvalues().cwiseMax(1e-18 * solver.eigenvalues()(3));
  return values.cwiseSqrt().cwiseInverse().asDiagonal() * solver.eigenvectors().transpose();
}

CollineationFit FitTo(const std::vector<Eigen::Vector4d>& from,
                      const std::vector<Eigen::Vector4d>& to) {
  CollineationFit fit;
  fit.points = static_cast<int>(from.size());
  fit.rms_m = std::numeric_limits<double>::infinity();
  if (from.size() < 6) return fit;
  const Eigen::Matrix4d A = Whitening(from), B = Whitening(to);
  std::vector<PointPair3> white, pairs;
  for (size_t k = 0; k < from.size(); ++k) {
    white.push_back({(A * from[k]).normalized(), (B * to[k]).normalized()});
    pairs.push_back({from[k], to[k]});
  }
  const auto H = FitCollineation(white, {});
  if (!H) return fit;
  fit.metric_from_scene = RefineCollineation(B.inverse() * *H * A, pairs);
  fit.rms_m = CollineationRms(fit.metric_from_scene, pairs);
  if (!std::isfinite(fit.rms_m)) fit.rms_m = std::numeric_limits<double>::infinity();
  return fit;
}

}  // namespace

CameraMatrix SyntheticTracks::TrueCamera(int view) const {
  CameraMatrix P;
  P << camera_from_world[view].R, camera_from_world[view].t;
  return cameras[view].K() * P;
}

SyntheticTracks MakeSyntheticTracks(const SyntheticTracksOptions& options,
                                    const SyntheticTrackNoise& noise) {
  Random random(options.seed * 104729u + 1u);
  SyntheticTracks out;
  AddStructure(options, &random, &out);
  AddCameras(options, &random, &out);
  Observe(noise, &out);
  return out;
}

CollineationFit CompareWithTruth(const SyntheticTracks& truth, const ProjectiveScene& scene) {
  std::vector<int> seen(truth.points.size(), 0);
  for (size_t k = 0; k < truth.tracks.point_observations.size(); ++k) {
    const PointObservation& o = truth.tracks.point_observations[k];
    seen[o.point] += scene.point_inlier[k] && scene.cameras[o.view];
  }
  std::vector<Eigen::Vector4d> from, to;
  for (size_t j = 0; j < truth.points.size(); ++j) {
    if (!scene.points[j] || seen[j] < 2) continue;
    from.push_back(*scene.points[j]);
    to.push_back(truth.points[j].homogeneous());
  }
  return FitTo(from, to);
}

double CameraCollineationRms(const SyntheticTracks& truth, const ProjectiveScene& scene) {
  std::vector<Eigen::Vector3d> exact = truth.points;
  for (const auto& [a, b] : truth.lines) {
    exact.push_back(a);
    exact.push_back(b);
  }
  std::vector<Eigen::Vector4d> from, to;
  for (const Eigen::Vector3d& x : exact) {
    std::vector<PointObservation> observations;
    for (size_t v = 0; v < truth.cameras.size(); ++v) {
      if (!scene.cameras[v]) continue;
      observations.push_back(
          {static_cast<int>(v), 0, Project(truth.cameras[v], truth.camera_from_world[v] * x), 1.0});
    }
    std::vector<WeightedPoint> weighted;
    for (const PointObservation& o : observations) {
      weighted.push_back({&o, *scene.cameras[o.view], Eigen::Vector4d::Zero(), 1.0});
    }
    if (weighted.size() < 2) return std::numeric_limits<double>::infinity();
    auto X = IntersectPoint(weighted);
    for (int i = 0; i < 3 && X; ++i) X = IntersectPoint(weighted, X);
    if (!X) return std::numeric_limits<double>::infinity();
    from.push_back(*X);
    to.push_back(x.homogeneous());
  }
  return FitTo(from, to).rms_m;
}

}  // namespace horopter
