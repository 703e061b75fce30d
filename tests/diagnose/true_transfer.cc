#include "tests/diagnose/true_transfer.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "server/vision/geometry/plucker_line.h"

namespace horopter {
namespace {

constexpr double kEpipolarPx = 2.0, kTransferPx = 3.0;
constexpr double kBufferMargin = 0.15;  // of the image's size: undistorted points may be outside

Eigen::Vector2d Undistort(const BopImage& image, const Eigen::Vector2d& pixel) {
  PinholeCamera straight = image.camera;
  straight.k1 = 0.0;
  return Project(straight, NormalizedPoint(image.camera, pixel).homogeneous());
}

double LineDistance(const Eigen::Vector3d& line, const Eigen::Vector2d& p) {
  return std::abs(line.dot(p.homogeneous())) / line.head<2>().norm();
}

}  // namespace

double TrueEpipolarDistance(const BopImage& image_a,
                            const Eigen::Vector2d& a,
                            const BopImage& image_b,
                            const Eigen::Vector2d& b) {
  const Rigid3 b_from_a = image_b.camera_from_world * image_a.camera_from_world.Inverse();
  const Eigen::Matrix3d F = image_b.camera.K().inverse().transpose() * CrossMatrix(b_from_a.t) *
                            b_from_a.R * image_a.camera.K().inverse();
  return std::max(LineDistance(F * a.homogeneous(), b),
                  LineDistance(F.transpose() * b.homogeneous(), a));
}

TrueTransfer::TrueTransfer(const TrueWorld& world, const TrueModels& models)
    : world_(world), models_(models) {
  for (const BopImage& image : world.scene.images) {
    View view;
    view.wide = image.camera;
    view.wide.k1 = 0.0;
    const int margin_x = static_cast<int>(kBufferMargin * image.camera.width);
    const int margin_y = static_cast<int>(kBufferMargin * image.camera.height);
    view.wide.width += 2 * margin_x;
    view.wide.height += 2 * margin_y;
    view.wide.cx += margin_x;
    view.wide.cy += margin_y;
    view.depth = MakeDepthBuffer(view.wide.width, view.wide.height);
    view.instance.assign(view.depth.depth.size(), -1);
    DepthBuffer one = view.depth;
    for (size_t i = 0; i < image.instances.size(); ++i) {
      const auto model = models.find(image.instances[i].obj_id);
      if (model == models.end()) continue;
      ClearDepth(&one);
      RenderDepth(model->second.mesh, view.wide, image.instances[i].camera_from_object, &one);
      for (size_t k = 0; k < one.depth.size(); ++k) {
        if (one.depth[k] >= view.depth.depth[k]) continue;
        view.depth.depth[k] = one.depth[k];
        view.instance[k] = static_cast<int>(i);
      }
    }
    views_.push_back(std::move(view));
  }
}

std::optional<TrueTransfer::Surface> TrueTransfer::SurfaceAt(int view,
                                                             const Eigen::Vector2d& pixel) const {
  const BopImage& image = world_.scene.images[view];
  const View& v = views_[view];
  const Eigen::Vector2d offset(v.wide.cx - image.camera.cx, v.wide.cy - image.camera.cy);
  const Eigen::Vector2d at = Undistort(image, pixel) + offset;
  const int x = static_cast<int>(std::lround(at.x())), y = static_cast<int>(std::lround(at.y()));
  // Beside an outline the surface behind may be meant.
  constexpr int kBeside = 2;
  if (x < kBeside || y < kBeside || x >= v.wide.width - kBeside || y >= v.wide.height - kBeside)
    return std::nullopt;
  const size_t middle = static_cast<size_t>(y) * v.wide.width + x;
  const int instance = v.instance[middle];
  if (instance < 0 || image.instances[instance].visib_fract <= 0.0) return std::nullopt;
  for (int dy = -kBeside; dy <= kBeside; ++dy) {
    for (int dx = -kBeside; dx <= kBeside; ++dx) {
      if (v.instance[middle + static_cast<size_t>(dy * v.wide.width + dx)] != instance)
        return std::nullopt;
    }
  }
  const double z = v.depth.At(x, y);
  return Surface{instance, z * NormalizedPoint(v.wide, at).homogeneous()};
}

// Of the scene between two images; without a world that of the part.
std::optional<Rigid3> TrueTransfer::Motion(int from, int to, int instance) const {
  const BopImage& a = world_.scene.images[from];
  const BopImage& b = world_.scene.images[to];
  if (a.has_pose && b.has_pose) return b.camera_from_world * a.camera_from_world.Inverse();
  const BopInstance& in_a = a.instances[instance];
  const BopInstance& in_b = b.instances[instance];
  if (in_b.visib_fract <= 0.0 || !models_.at(in_a.obj_id).symmetries.empty()) return std::nullopt;
  return in_b.camera_from_object * in_a.camera_from_object.Inverse();
}

std::optional<double> TrueTransfer::TransferError(int from,
                                                  const Surface& surface,
                                                  int to,
                                                  const Eigen::Vector2d& pixel) const {
  const auto motion = Motion(from, to, surface.instance);
  if (!motion) return std::nullopt;
  const Eigen::Vector3d there = *motion * surface.point_in_camera;
  if (there.z() <= 1e-6) return 1e6;
  return (ProjectTrue(world_.scene.images[to], there) - pixel).norm();
}

MatchTruth TrueTransfer::Judge(int view_a,
                               const Eigen::Vector2d& a,
                               int view_b,
                               const Eigen::Vector2d& b) const {
  const BopImage& image_a = world_.scene.images[view_a];
  const BopImage& image_b = world_.scene.images[view_b];
  const double off = world_.rms_px.value_or(0.0);
  bool known = false;
  if (image_a.has_pose && image_b.has_pose) {
    known = true;
    if (TrueEpipolarDistance(image_a, Undistort(image_a, a), image_b, Undistort(image_b, b)) >
        kEpipolarPx + off) {
      return MatchTruth::kWrong;
    }
  }
  const auto differs = [&](int from, const Eigen::Vector2d& x, int to, const Eigen::Vector2d& y) {
    const auto surface = SurfaceAt(from, x);
    const auto error = surface ? TransferError(from, *surface, to, y) : std::nullopt;
    known |= error.has_value();
    return error.value_or(0.0) > kTransferPx + 2.0 * off;
  };
  if (differs(view_a, a, view_b, b) || differs(view_b, b, view_a, a)) return MatchTruth::kWrong;
  return known ? MatchTruth::kRight : MatchTruth::kUnknown;
}

}  // namespace horopter
