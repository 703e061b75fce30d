#include "server/vision/euclidean/euclidean.h"

#include <ceres/ceres.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "server/vision/euclidean/scene_costs.h"
#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/recognition/edge_maps.h"
#include "server/vision/recognition/plane_points.h"
#include "server/vision/recognition/pose_refine.h"
#include "server/vision/recognition/prepared_object.h"

namespace horopter {
namespace {

// Neighbouring samples of one edge share the edge's error; samples closer than this (pixels) count
// as one.
constexpr double kCorrelationPx = 12.0;
constexpr double kCauchySigmas =
    0.5;  // edges of a rounded or shaded part err in common: hard on outliers
constexpr double kK1Sigma = 0.03;
constexpr double kPlaneSigmaPx = 0.7;
constexpr double kHiddenTolerance = 0.012;  // share of the diameter
constexpr double kMaxTurnRad = 0.35;        // between a sample's and its edge point's direction

struct CameraState {
  bool known = false;
  PinholeCamera camera;
  Rigid3 camera_from_scene;
  std::array<double, kCameraBlock> block{};

  void Load() {
    block = {0, 0, 0, 0, 0, 0, std::log(camera.focal_px), camera.cx, camera.cy, camera.k1};
  }
  void Store() {
    const Eigen::Map<const Eigen::Vector3d> w(block.data()), t(block.data() + 3);
    camera_from_scene = {RotationFromVector(w) * camera_from_scene.R, camera_from_scene.t + t};
    camera.focal_px = std::exp(block[6]);
    camera.cx = block[7];
    camera.cy = block[8];
    camera.k1 = block[9];
    Load();
  }
};

struct ObjectState {
  Rigid3 scene_from_object;
  std::array<double, kObjectBlock> block{};

  void Store() {
    const Eigen::Map<const Eigen::Vector3d> w(block.data()), t(block.data() + 3);
    scene_from_object = {RotationFromVector(w) * scene_from_object.R, scene_from_object.t + t};
    block.fill(0.0);
  }
};

struct EdgeObservation {
  int view, object;
  Eigen::Vector3d point_in_object;
  Eigen::Vector2d edge_point, normal;  // image pixels
  double residual_px, spacing_px;
};

// Everything one adjustment works on.
struct Adjustment {
  const RecognitionInput* input;
  const EuclideanOptions* options;
  std::vector<EdgeMaps> maps;
  std::vector<CameraState> cameras;
  std::vector<ObjectState> objects;
  std::vector<const PreparedObject*> models;
  PlanePoints plane;
};

// Visible samples (other objects occlude) with a like-directed image edge along their normal.
std::vector<EdgeObservation> Observe(const Adjustment& a, double reach_px) {
  std::vector<EdgeObservation> out;
  for (int v = 0; v < static_cast<int>(a.cameras.size()); ++v) {
    if (!a.cameras[v].known) continue;
    const EdgeMaps& maps = a.maps[v];
    const double s = maps.working_from_image;
    const PinholeCamera& camera = a.cameras[v].camera;
    PinholeCamera working{
        maps.width, maps.height, camera.focal_px * s, camera.cx * s, camera.cy * s, camera.k1};
    DepthBuffer depth = MakeDepthBuffer(maps.width, maps.height);
    for (std::size_t k = 0; k < a.objects.size(); ++k) {
      RenderDepth(a.models[k]->model.mesh,
                  working,
                  a.cameras[v].camera_from_scene * a.objects[k].scene_from_object,
                  &depth);
    }
    const std::size_t cells = static_cast<std::size_t>(maps.width) * maps.height;
    for (int k = 0; k < static_cast<int>(a.objects.size()); ++k) {
      const Rigid3 pose = a.cameras[v].camera_from_scene * a.objects[k].scene_from_object;
      for (const EdgeSample& sample : a.models[k]->samples) {
        const Eigen::Vector3d p = pose * sample.point.cast<double>();
        if (p.z() < 1e-3) continue;
        const Eigen::Vector2d u = Project(working, p);
        if (!IsVisible(depth, u, p.z(), kHiddenTolerance * a.models[k]->model.diameter_m)) continue;
        const Eigen::Vector3d q = pose.R * sample.tangent.cast<double>();
        Eigen::Vector2d along(q.x() * p.z() - p.x() * q.z(), q.y() * p.z() - p.y() * q.z());
        const double norm = along.norm();
        if (norm < 0.05 * p.z()) continue;  // seen nearly end-on
        along /= norm;
        const int bin =
            OrientationBin(static_cast<float>(along.x()), static_cast<float>(along.y()));
        const int cx = std::clamp(static_cast<int>(std::lround(u.x())), 0, maps.width - 1);
        const int cy = std::clamp(static_cast<int>(std::lround(u.y())), 0, maps.height - 1);
        const std::int32_t nearest = maps.nearest[cells * bin + maps.Cell(cx, cy)];
        if (nearest < 0) continue;
        const EdgePoint& e = maps.points[nearest];
        const double turn = std::remainder(e.direction - std::atan2(along.y(), along.x()), M_PI);
        const Eigen::Vector2d off = u - e.point.cast<double>() * s;
        if (off.norm() > reach_px || std::abs(turn) > kMaxTurnRad) continue;
        const Eigen::Vector2d normal(-along.y(), along.x());
        out.push_back({v,
                       k,
                       sample.point.cast<double>(),
                       e.point.cast<double>(),
                       normal,
                       normal.dot(off),
                       norm / (p.z() * p.z()) * working.focal_px * a.models[k]->sample_spacing_m});
      }
    }
  }
  return out;
}

double EdgeWeight(const EdgeObservation& o, double sigma_px, double working_from_image) {
  const double shared = std::max(1.0, kCorrelationPx / std::max(o.spacing_px, 0.2));
  return working_from_image / (sigma_px * std::sqrt(shared));
}

CameraPrior PriorOf(const Adjustment& a, int v) {
  const ImageFeatures& f = a.input->features[v];
  const RecognitionOptions defaults;
  CameraPrior prior;
  prior.log_focal = std::log(defaults.focal_start_widths * f.width);
  prior.log_focal_sigma = a.options->focal_log_sigma;
  prior.cx = 0.5 * (f.width - 1);
  prior.cy = 0.5 * (f.height - 1);
  prior.center_sigma_px = a.options->principal_point_sigma * f.width;
  prior.k1 = 0.0;
  prior.k1_sigma = kK1Sigma;
  if (!a.input->hints.empty()) {
    const CameraHint& hint = a.input->hints[v];
    if (hint.focal_px) {
      prior.log_focal = std::log(*hint.focal_px);
      prior.log_focal_sigma = hint.focal_log_sigma.value_or(0.02);
    }
    if (hint.principal_point) {
      prior.cx = hint.principal_point->x();
      prior.cy = hint.principal_point->y();
      prior.center_sigma_px = 1.0;
    }
    if (hint.k1) {
      prior.k1 = *hint.k1;
      prior.k1_sigma = 0.002;
    }
  }
  return prior;
}

void AddResiduals(Adjustment* a,
                  const std::vector<EdgeObservation>& observations,
                  double sigma_px,
                  ceres::Problem* problem) {
  for (const EdgeObservation& o : observations) {
    auto* cost = new ceres::AutoDiffCostFunction<EdgeCost, 1, kCameraBlock, kObjectBlock>(
        new EdgeCost{o.point_in_object,
                     a->cameras[o.view].camera_from_scene,
                     a->objects[o.object].scene_from_object,
                     o.edge_point,
                     o.normal,
                     EdgeWeight(o, sigma_px, a->maps[o.view].working_from_image)});
    problem->AddResidualBlock(cost,
                              new ceres::CauchyLoss(kCauchySigmas),
                              a->cameras[o.view].block.data(),
                              a->objects[o.object].block.data());
  }
  for (int v = 0; v < static_cast<int>(a->cameras.size()); ++v) {
    if (!a->cameras[v].known) continue;
    problem->AddResidualBlock(new ceres::AutoDiffCostFunction<CameraPrior, 4, kCameraBlock>(
                                  new CameraPrior(PriorOf(*a, v))),
                              nullptr,
                              a->cameras[v].block.data());
  }
  for (const PlanePoints::Match& m : a->plane.matches) {
    const double weight = a->maps[m.view_b].working_from_image / kPlaneSigmaPx;
    auto* cost = new ceres::AutoDiffCostFunction<PlanePointCost, 2, kCameraBlock, kCameraBlock, 3>(
        new PlanePointCost{a->cameras[m.view_a].camera_from_scene,
                           a->cameras[m.view_b].camera_from_scene,
                           a->plane.anchor,
                           m.pixel_a,
                           m.pixel_b,
                           weight});
    problem->AddResidualBlock(cost,
                              new ceres::CauchyLoss(kCauchySigmas),
                              a->cameras[m.view_a].block.data(),
                              a->cameras[m.view_b].block.data(),
                              a->plane.plane.data());
  }
  // The first object is the scene frame.
  if (problem->HasParameterBlock(a->objects[0].block.data())) {
    problem->SetParameterBlockConstant(a->objects[0].block.data());
  }
}

bool Solve(Adjustment* a, const std::vector<EdgeObservation>& observations, double sigma_px) {
  ceres::Problem problem;
  AddResiduals(a, observations, sigma_px, &problem);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  options.max_num_iterations = 12;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return false;
  for (CameraState& c : a->cameras) {
    if (c.known) c.Store();
  }
  for (ObjectState& o : a->objects) o.Store();
  return true;
}

double RobustRms(const std::vector<EdgeObservation>& observations) {
  if (observations.empty()) return 0.0;
  std::vector<double> r;
  for (const EdgeObservation& o : observations) r.push_back(std::abs(o.residual_px));
  std::nth_element(r.begin(), r.begin() + r.size() / 2, r.end());
  return 1.4826 * r[r.size() / 2];
}

// Covariance of the increments of all blocks at the solution, by the pseudo-inverse of the normal
// matrix.
struct BlockCovariance {
  Eigen::MatrixXd full;
  std::vector<int> camera_at, object_at;  // first column, -1: fixed or absent
};

BlockCovariance ComputeCovariance(Adjustment* a,
                                  const std::vector<EdgeObservation>& observations,
                                  double sigma_px) {
  BlockCovariance out;
  ceres::Problem problem;
  AddResiduals(a, observations, sigma_px, &problem);
  ceres::Problem::EvaluateOptions evaluate;
  int size = 0;
  for (CameraState& c : a->cameras) {
    out.camera_at.push_back(c.known ? size : -1);
    if (!c.known) continue;
    evaluate.parameter_blocks.push_back(c.block.data());
    size += kCameraBlock;
  }
  for (std::size_t k = 0; k < a->objects.size(); ++k) {
    const bool free = k > 0 && problem.HasParameterBlock(a->objects[k].block.data());
    out.object_at.push_back(free ? size : -1);
    if (!free) continue;
    evaluate.parameter_blocks.push_back(a->objects[k].block.data());
    size += kObjectBlock;
  }
  if (!a->plane.matches.empty()) {
    evaluate.parameter_blocks.push_back(a->plane.plane.data());
    size += 3;
  }
  ceres::CRSMatrix J;
  if (!problem.Evaluate(evaluate, nullptr, nullptr, nullptr, &J)) return out;
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(size, size);
  for (int r = 0; r < J.num_rows; ++r) {
    for (int i = J.rows[r]; i < J.rows[r + 1]; ++i) {
      for (int j = J.rows[r]; j < J.rows[r + 1]; ++j)
        A(J.cols[i], J.cols[j]) += J.values[i] * J.values[j];
    }
  }
  // Equilibrated, so that radians, metres and pixels are treated alike.
  const Eigen::VectorXd scale = A.diagonal().cwiseMax(1e-12).cwiseSqrt().cwiseInverse();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(scale.asDiagonal() * A *
                                                             scale.asDiagonal());
  const Eigen::VectorXd inverse = eigen.eigenvalues().cwiseMax(1e-9).cwiseInverse();
  out.full = scale.asDiagonal() * eigen.eigenvectors() * inverse.asDiagonal() *
             eigen.eigenvectors().transpose() * scale.asDiagonal();
  return out;
}

Adjustment MakeAdjustment(const RecognitionInput& input,
                          const RecognitionResult& recognition,
                          const EuclideanOptions& options) {
  Adjustment a;
  a.input = &input;
  a.options = &options;
  const Rigid3 scene_from_old = recognition.objects[0].scene_from_object.Inverse();
  a.maps.resize(recognition.views.size());
  a.cameras.resize(recognition.views.size());
  for (std::size_t v = 0; v < recognition.views.size(); ++v) {
    if (!recognition.views[v]) continue;
    a.maps[v] = BuildEdgeMaps(input.features[v]);
    a.cameras[v].known = true;
    a.cameras[v].camera = recognition.views[v]->camera;
    a.cameras[v].camera_from_scene =
        recognition.views[v]->camera_from_scene * scene_from_old.Inverse();
    a.cameras[v].Load();
  }
  for (const SceneObject& o : recognition.objects) {
    a.objects.push_back({scene_from_old * o.scene_from_object, {}});
    a.models.push_back(input.objects[o.object].get());
  }
  return a;
}

}  // namespace

absl::StatusOr<MetricScene> RefineMetricScene(const RecognitionInput& input,
                                              const RecognitionResult& recognition,
                                              const EuclideanOptions& options,
                                              const StopRequested& stop) {
  if (recognition.objects.empty()) return absl::FailedPreconditionError("no recognised object");
  if (std::none_of(recognition.views.begin(), recognition.views.end(), [](const auto& v) {
        return v.has_value();
      })) {
    return absl::FailedPreconditionError("no recovered camera");
  }
  if (recognition.views.size() != input.features.size()) {
    return absl::InvalidArgumentError("views and features differ in number");
  }
  Adjustment a = MakeAdjustment(input, recognition, options);
  if (input.matching != nullptr) {
    std::vector<std::optional<RecognizedView>> views(a.cameras.size());
    for (std::size_t v = 0; v < views.size(); ++v) {
      if (a.cameras[v].known)
        views[v] = RecognizedView{a.cameras[v].camera, a.cameras[v].camera_from_scene};
    }
    a.plane = FindPlanePoints(*input.matching, views);
  }
  std::vector<EdgeObservation> observations;
  double sigma = options.edge_sigma_px;
  for (int round = 0; round < options.rounds; ++round) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped during the metric adjustment");
    observations = Observe(a, options.search_px);
    if (observations.size() < 8)
      return absl::FailedPreconditionError("fewer than 8 edge points support the objects");
    if (!Solve(&a, observations, sigma))
      return absl::FailedPreconditionError("the metric adjustment failed");
  }
  observations = Observe(a, options.search_px);
  sigma = std::max(0.3, RobustRms(observations));
  const BlockCovariance covariance = ComputeCovariance(&a, observations, sigma);

  MetricScene out;
  out.rms_px = RobustRms(observations);
  out.cameras.resize(a.cameras.size());
  for (std::size_t v = 0; v < a.cameras.size(); ++v) {
    if (!a.cameras[v].known) continue;
    PosedCamera c{a.cameras[v].camera, a.cameras[v].camera_from_scene, 0.0};
    if (covariance.full.size() > 0) {
      const int at = covariance.camera_at[v] + 6;
      c.focal_log_sigma = std::sqrt(covariance.full(at, at));
    }
    out.cameras[v] = c;
  }
  for (std::size_t k = 0; k < a.objects.size(); ++k) {
    const SceneObject& source = recognition.objects[k];
    PosedObject o;
    o.object = source.object;
    o.scene_from_object = a.objects[k].scene_from_object;
    o.score = source.score;
    o.view_scores = source.view_scores;
    o.alternatives = source.alternatives;
    if (covariance.full.size() > 0 && covariance.object_at[k] >= 0) {
      o.covariance = covariance.full.block<6, 6>(covariance.object_at[k], covariance.object_at[k]);
    }
    double squares = 0.0;
    for (const EdgeObservation& e : observations) {
      if (e.object != static_cast<int>(k)) continue;
      ++o.edge_observations;
      squares += e.residual_px * e.residual_px;
    }
    o.rms_px = o.edge_observations > 0 ? std::sqrt(squares / o.edge_observations) : 0.0;
    out.objects.push_back(std::move(o));
  }
  out.counts["edge_observations"] = static_cast<double>(observations.size());
  out.counts["plane_matches"] = static_cast<double>(a.plane.matches.size());
  return out;
}

std::vector<SceneGrasp> GraspsInScene(const ObjectModel& model, const Rigid3& scene_from_object) {
  std::vector<SceneGrasp> out;
  for (int s = 0; s <= static_cast<int>(model.symmetries.size()); ++s) {
    const Rigid3 symmetry = s == 0 ? Rigid3{} : model.symmetries[s - 1];
    const Rigid3 scene_from_turned = scene_from_object * symmetry;
    for (const Grasp& g : model.grasps) {
      out.push_back({g.name,
                     s,
                     scene_from_turned * g.object_from_gripper,
                     g.jaw_opening_m,
                     g.grip_width_m,
                     g.quality,
                     {}});
      if (g.object_from_pregrasp) {
        out.back().scene_from_pregrasp = scene_from_turned * *g.object_from_pregrasp;
      }
    }
  }
  return out;
}

}  // namespace horopter
