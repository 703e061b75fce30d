#include "server/vision/recognition/aspect_scenes/shape_strain.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/vision/geometry/hidden_tolerance.h"
#include "server/vision/geometry/plucker_line.h"
#include "server/vision/recognition/aspect_search/pose_edges.h"
#include "server/vision/recognition/aspects/visible_edges.h"

namespace horopter {
namespace {

constexpr int kStrainViewParameters = 7;  // rotation, translation, ln f
constexpr int kStrains = 2;               // of three with mean 0
constexpr int kLeastRows = 60;
constexpr double kStrainMinDepth = 1e-4;  // metres
constexpr double kRenderPx = 140.0;
// Reach of each round, working pixels: a part stretched by a tenth is off by so much at its ends.
constexpr double kSearchPx[] = {6.0, 4.0, 3.0};
constexpr int kSteps = 3;
constexpr double kStrainRowSigmaPx = 1.0;
constexpr double kStrainSigma = 0.1;  // nothing is stretched by much more
// Cameras stay near where they are: radians, of the distance, ln f.
constexpr double kTurnSigma = 0.5, kShiftSigma = 0.5, kFocalSigma = 0.05;

Eigen::Matrix3d RotationOf(const Eigen::Vector3d& w) {
  const double angle = w.norm();
  if (angle < 1e-12) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, w / angle).toRotationMatrix();
}

class StrainFit {
 public:
  StrainFit(std::span<const AspectImage> images,
            const RenderMesh& mesh,
            const std::vector<std::optional<CalibratedCamera>>& views,
            const Rigid3& scene_from_object,
            std::span<const DepthBuffer> hidden)
      : images_(images),
        mesh_(mesh),
        pose_(scene_from_object),
        hidden_(hidden),
        views_(views),
        given_(views) {
    for (const auto& view : views_) {
      at_.push_back(view ? size_ : -1);
      if (view) size_ += kStrainViewParameters;
    }
    size_ += kStrains;
  }

  ShapeStrain Run() {
    ShapeStrain out;
    Render();
    for (const double search : kSearchPx) {
      for (int step = 0; step < kSteps; ++step) {
        Match(search);
        if (static_cast<int>(rows_.size()) < kLeastRows) return {};
        if (!Step()) break;
      }
    }
    out.strain = StrainDirections() * strain_;
    Eigen::MatrixXd H;
    Eigen::VectorXd g;
    Linearise(&H, &g);
    const Eigen::MatrixXd inverse = H.ldlt().solve(Eigen::MatrixXd::Identity(size_, size_));
    out.covariance = StrainDirections() * inverse.bottomRightCorner<kStrains, kStrains>() *
                     StrainDirections().transpose();
    return out;
  }

 private:
  struct Row {
    int view = -1;
    Eigen::Vector3d point;  // unstrained, object frame
    Eigen::Vector2d normal;
    double residual_px = 0.0, weight = 0.0, working = 1.0;
  };

  Eigen::Vector3d Center() const { return mesh_.center.cast<double>(); }
  Eigen::Vector3d Scale() const {
    return Eigen::Vector3d((StrainDirections() * strain_).array().exp().matrix());
  }

  void Render() {
    strained_ = Strained(mesh_, StrainDirections() * strain_);
    VisibleEdgeOptions options;
    options.render_px = kRenderPx;
    points_.assign(views_.size(), {});
    for (std::size_t v = 0; v < views_.size(); ++v) {
      if (!views_[v] || images_[v].width == 0) continue;
      points_[v] = ThinnedEdgePoints(
          FindVisibleEdges(
              strained_, views_[v]->camera, views_[v]->camera_from_scene * pose_, options),
          PoseEdgeOptions{}.max_points);
      DropHidden(v);
      for (ModelEdgePoint& p : points_[v]) {  // to the part as it is
        p.point =
            (Center() + (p.point.cast<double>() - Center()).cwiseQuotient(Scale())).cast<float>();
      }
    }
  }

  void DropHidden(std::size_t v) {
    if (v >= hidden_.size() || hidden_[v].width == 0) return;
    PinholeCamera straight = WorkingCamera(images_[v], views_[v]->camera);
    straight.k1 = 0.0;
    const Rigid3 camera_from_object = views_[v]->camera_from_scene * pose_;
    std::erase_if(points_[v], [&](const ModelEdgePoint& p) {
      const Eigen::Vector3d x = camera_from_object * p.point.cast<double>();
      return x.z() > kStrainMinDepth &&
             !IsVisible(
                 hidden_[v], Project(straight, x), x.z(), kHiddenShareOfFaces * mesh_.diameter_m);
    });
  }

  void Match(double search_px) {
    rows_.clear();
    PoseEdgeOptions options;
    options.search_px = search_px;
    const Eigen::Vector3d center = Center(), scale = Scale();
    for (std::size_t v = 0; v < views_.size(); ++v) {
      if (points_[v].empty()) continue;
      std::vector<ModelEdgePoint> here = points_[v];
      for (ModelEdgePoint& p : here)
        p.point = (center + (p.point.cast<double>() - center).cwiseProduct(scale)).cast<float>();
      for (const PoseEdgeMatch& m : MatchPoseEdges(images_[v],
                                                   here,
                                                   views_[v]->camera,
                                                   views_[v]->camera_from_scene * pose_,
                                                   options)) {
        rows_.push_back({static_cast<int>(v),
                         center + (m.point - center).cwiseQuotient(scale),
                         m.normal,
                         m.residual_px,
                         m.weight,
                         images_[v].working_from_image});
      }
    }
  }

  void Linearise(Eigen::MatrixXd* H, Eigen::VectorXd* g) const {
    H->setZero(size_, size_);
    g->setZero(size_);
    const int s = size_ - kStrains;
    const Eigen::Vector3d center = Center(), scale = Scale();
    for (const Row& row : rows_) {
      const CalibratedCamera& view = *views_[row.view];
      const Eigen::Vector3d stretched = (row.point - center).cwiseProduct(scale);
      const Eigen::Vector3d x =
          view.camera_from_scene * (pose_ * Eigen::Vector3d(center + stretched));
      if (x.z() < kStrainMinDepth) continue;
      const double w =
          row.weight * row.working * row.working / (kStrainRowSigmaPx * kStrainRowSigmaPx);
      const double f = view.camera.focal_px, q = f / x.z();
      const double along = row.normal.x() * x.x() + row.normal.y() * x.y();
      const Eigen::Matrix<double, 1, 3> dx(
          q * row.normal.x(), q * row.normal.y(), -q / x.z() * along);
      Eigen::Matrix<double, 1, kStrainViewParameters + kStrains> j;
      j.head<3>() = -dx * CrossMatrix(x - view.camera_from_scene.t);
      j.segment<3>(3) = dx;
      j(6) = q * along;
      j.tail<kStrains>() =
          dx * view.camera_from_scene.R * pose_.R * stretched.asDiagonal() * StrainDirections();
      const int a = at_[row.view];
      const auto jv = j.head<kStrainViewParameters>();
      const auto js = j.tail<kStrains>();
      H->block<kStrainViewParameters, kStrainViewParameters>(a, a) += w * jv.transpose() * jv;
      H->block<kStrainViewParameters, kStrains>(a, s) += w * jv.transpose() * js;
      H->block<kStrains, kStrainViewParameters>(s, a) += w * js.transpose() * jv;
      H->block<kStrains, kStrains>(s, s) += w * js.transpose() * js;
      g->segment<kStrainViewParameters>(a) += w * row.residual_px * jv.transpose();
      g->segment<kStrains>(s) += w * row.residual_px * js.transpose();
    }
    for (std::size_t v = 0; v < views_.size(); ++v) {
      if (!views_[v]) continue;
      const int a = at_[v];
      const double distance =
          std::max((views_[v]->camera_from_scene * pose_.t).norm(), kStrainMinDepth);
      for (int k = 0; k < 3; ++k) {
        (*H)(a + k, a + k) += 1.0 / (kTurnSigma * kTurnSigma);
        (*H)(a + 3 + k, a + 3 + k) += 1.0 / (kShiftSigma * kShiftSigma * distance * distance);
      }
      const double wf = 1.0 / (kFocalSigma * kFocalSigma);
      (*H)(a + 6, a + 6) += wf;
      (*g)(a + 6) += wf * std::log(given_[v]->camera.focal_px / views_[v]->camera.focal_px);
    }
    const double ws = 1.0 / (kStrainSigma * kStrainSigma);
    H->bottomRightCorner<kStrains, kStrains>().diagonal().array() += ws;
    g->tail<kStrains>() -= ws * strain_;
  }

  bool Step() {
    Eigen::MatrixXd H;
    Eigen::VectorXd g;
    Linearise(&H, &g);
    const Eigen::VectorXd step = H.ldlt().solve(g);
    if (!step.allFinite()) return false;
    for (std::size_t v = 0; v < views_.size(); ++v) {
      if (!views_[v]) continue;
      const auto d = step.segment<kStrainViewParameters>(at_[v]);
      Rigid3& pose = views_[v]->camera_from_scene;
      pose.R = RotationOf(d.head<3>()) * pose.R;
      pose.t += d.segment<3>(3);
      views_[v]->camera.focal_px *= std::exp(std::clamp(d(6), -0.3, 0.3));
    }
    strain_ += step.tail<kStrains>();
    strain_ = strain_.cwiseMax(-0.3).cwiseMin(0.3);
    return true;
  }

  std::span<const AspectImage> images_;
  const RenderMesh& mesh_;
  const Rigid3 pose_;
  std::span<const DepthBuffer> hidden_;
  std::vector<std::optional<CalibratedCamera>> views_;
  const std::vector<std::optional<CalibratedCamera>> given_;
  std::vector<int> at_;  // where a view's parameters begin; -1: none
  int size_ = 0;
  Eigen::Matrix<double, kStrains, 1> strain_ = Eigen::Matrix<double, kStrains, 1>::Zero();
  RenderMesh strained_;
  std::vector<std::vector<ModelEdgePoint>> points_;  // of views, on the part as it is
  std::vector<Row> rows_;
};

}  // namespace

Eigen::Matrix<double, 3, 2> StrainDirections() {
  Eigen::Matrix<double, 3, 2> out;
  out.col(0) = Eigen::Vector3d(1, -1, 0).normalized();
  out.col(1) = Eigen::Vector3d(1, 1, -2).normalized();
  return out;
}

ShapeStrain EstimateStrain(std::span<const AspectImage> images,
                           const RenderMesh& mesh,
                           const std::vector<std::optional<CalibratedCamera>>& views,
                           const Rigid3& scene_from_object,
                           std::span<const DepthBuffer> hidden) {
  return StrainFit(images, mesh, views, scene_from_object, hidden).Run();
}

RenderMesh Strained(const RenderMesh& mesh, const Eigen::Vector3d& strain) {
  RenderMesh out;
  out.origin = mesh.origin;
  out.step_m = mesh.step_m;
  out.diameter_m = mesh.diameter_m;
  const Eigen::Vector3f scale = strain.array().exp().matrix().cast<float>();
  for (const Eigen::Vector3f& v : mesh.vertices)
    out.vertices.push_back(mesh.center + (v - mesh.center).cwiseProduct(scale));
  out.triangles = mesh.triangles;
  ConnectRenderMesh(RenderMeshOptions{}.smooth_angle_rad, &out);
  return out;
}

}  // namespace horopter
