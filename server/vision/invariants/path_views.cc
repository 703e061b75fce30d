#include "server/vision/invariants/path_views.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

namespace horopter {
namespace {

double Diameter(std::span<const Eigen::Vector3d, 4> path) {
  double diameter = 0.0;
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < i; ++j) diameter = std::max(diameter, (path[i] - path[j]).norm());
  }
  return diameter;
}

Eigen::Vector4d KeyOf(const Eigen::Matrix<double, 8, 1>& at) {
  // Complex division by c - b is the similarity.
  const Eigen::Vector2d b = at.segment<2>(2), bc = at.segment<2>(4) - b;
  const auto divide = [&](const Eigen::Vector2d& v) -> Eigen::Vector2d {
    return Eigen::Vector2d(v.dot(bc), bc.x() * v.y() - bc.y() * v.x()) / bc.squaredNorm();
  };
  Eigen::Vector4d values;
  values << divide(at.segment<2>(0) - b), divide(at.segment<2>(6) - b);
  return values;
}

Eigen::Matrix<double, 8, 1> Stacked(std::span<const Eigen::Vector2d, 4> points) {
  Eigen::Matrix<double, 8, 1> x;
  for (int i = 0; i < 4; ++i) x.segment<2>(2 * i) = points[i];
  return x;
}

// Views of a cell that its box is spanned by: a triangular grid of directions, and camera distances
// that divide the range of nearness evenly, as the image is smooth in 1 / distance. The view from
// behind, mirrored, is the one from the front with the depths reversed: a negative nearness.
constexpr int kGrid = 4;
constexpr double kNearness[] = {-1.0, -0.5, 0.0, 0.5, 1.0};
// What the key does between the samples and with a path off the image's middle, as a share of the
// box and of the unit b-c.
constexpr double kMarginShare = 0.06;
constexpr double kMargin = 0.02;

// Rows: image axes right-handed as in an image, x right, y down, z away from the camera.
Eigen::Matrix3d CameraFrame(const Eigen::Vector3d& direction) {
  const Eigen::Vector3d z = -direction.normalized();
  const Eigen::Vector3d helper =
      std::abs(z.x()) < 0.9 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitY();
  Eigen::Matrix3d frame;
  frame.row(0) = helper.cross(z).normalized();
  frame.row(1) = z.cross(Eigen::Vector3d(frame.row(0)));
  frame.row(2) = z;
  return frame;
}

// A spherical triangle.
struct Cell {
  std::array<Eigen::Vector3d, 3> corners;
  std::vector<Eigen::Matrix3d> views;  // frames of kGrid's directions
};

// Every cell halved along its longest side, so that cells stay compact.
std::vector<Cell> Divided(const std::vector<Cell>& cells) {
  std::vector<Cell> out;
  for (const Cell& cell : cells) {
    const auto& c = cell.corners;
    int longest = 0;
    double length = -1.0;
    for (int k = 0; k < 3; ++k) {
      const double l = (c[k] - c[(k + 1) % 3]).norm();
      if (l > length + 1e-9) length = l, longest = k;
    }
    const Eigen::Vector3d &a = c[longest], &b = c[(longest + 1) % 3], &top = c[(longest + 2) % 3];
    const Eigen::Vector3d middle = (a + b).normalized();
    out.push_back({{a, middle, top}, {}});
    out.push_back({{middle, b, top}, {}});
  }
  return out;
}

// The four upper faces of an octahedron, divided three times.
const std::vector<Cell>& Cells() {
  static const std::vector<Cell> kCells = [] {
    std::vector<Cell> cells;
    for (int k = 0; k < 4; ++k) {
      const double a = 0.5 * M_PI * k, b = a + 0.5 * M_PI;
      cells.push_back({{Eigen::Vector3d(std::cos(a), std::sin(a), 0.0),
                        Eigen::Vector3d(std::cos(b), std::sin(b), 0.0),
                        Eigen::Vector3d::UnitZ()},
                       {}});
    }
    while (static_cast<int>(cells.size()) < kPathCells) cells = Divided(cells);
    for (Cell& cell : cells) {
      const auto& c = cell.corners;
      for (int i = 0; i <= kGrid; ++i) {
        for (int j = 0; i + j <= kGrid; ++j) {
          cell.views.push_back(CameraFrame(i * c[0] + j * c[1] + (kGrid - i - j) * c[2]));
        }
      }
    }
    return cells;
  }();
  return kCells;
}

}  // namespace

std::optional<InvariantKey> PathViewKey(std::span<const Eigen::Vector2d, 4> image_points,
                                        const Eigen::MatrixXd& covariance) {
  const Eigen::Matrix<double, 8, 1> x = Stacked(image_points);
  const double spread =
      (x.segment<2>(0) - x.segment<2>(2)).norm() + (x.segment<2>(6) - x.segment<2>(4)).norm();
  const double base = (x.segment<2>(4) - x.segment<2>(2)).norm();
  if (!x.allFinite() || !(base > 1e-3 * spread) || base == 0.0) return std::nullopt;
  InvariantKey result{KeyOf(x), {}};
  if (covariance.size() > 0) {
    const auto key = [](const Eigen::VectorXd& at) -> Eigen::VectorXd { return KeyOf(at); };
    result.covariance = PropagateCovariance(key, x, covariance);
  }
  return result;
}

std::optional<InvariantKey> PathViewKey(std::span<const Eigen::Vector2d, 4> image_points,
                                        const Eigen::MatrixXd& covariance,
                                        PathReading reading) {
  const bool reverse = reading == PathReading::kReverse || reading == PathReading::kMirroredReverse;
  const bool mirrored =
      reading == PathReading::kMirrored || reading == PathReading::kMirroredReverse;
  std::array<Eigen::Vector2d, 4> points;
  Eigen::Matrix<double, 8, 8> order = Eigen::Matrix<double, 8, 8>::Zero();
  const double flip = mirrored ? -1.0 : 1.0;
  for (int i = 0; i < 4; ++i) {
    const int from = reverse ? 3 - i : i;
    points[i] = {image_points[from].x(), flip * image_points[from].y()};
    order(2 * i, 2 * from) = 1.0;
    order(2 * i + 1, 2 * from + 1) = flip;
  }
  if (covariance.size() == 0) return PathViewKey(points);
  return PathViewKey(points, order * covariance * order.transpose());
}

std::array<Eigen::Vector2d, 4> ProjectPath(std::span<const Eigen::Vector3d, 4> path,
                                           const Eigen::Vector3d& direction,
                                           double distance_diameters) {
  const Eigen::Matrix3d frame = CameraFrame(direction);
  const Eigen::Vector3d center = 0.25 * (path[0] + path[1] + path[2] + path[3]);
  const double distance = distance_diameters * Diameter(path);
  std::array<Eigen::Vector2d, 4> image;
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector3d p = frame * (path[i] - center);
    image[i] = p.head<2>() / (distance > 0.0 ? 1.0 + p.z() / distance : 1.0);
  }
  return image;
}

Eigen::Vector3d PathCellDirection(int cell) {
  const auto& c = Cells()[cell].corners;
  return (c[0] + c[1] + c[2]).normalized();
}

std::vector<PathViewBox> PathViewBoxes(std::span<const Eigen::Vector3d, 4> path,
                                       const PathViewOptions& options) {
  std::vector<PathViewBox> boxes;
  const double base = (path[2] - path[1]).norm(), diameter = Diameter(path);
  if (!std::isfinite(diameter) || !(base > options.min_base_ratio * diameter)) return boxes;
  const double least_length = std::pow(options.min_length_ratio * base, 2);
  const Eigen::Vector3d center = 0.25 * (path[0] + path[1] + path[2] + path[3]);
  Eigen::Matrix<double, 3, 4> centered;
  for (int k = 0; k < 4; ++k) centered.col(k) = path[k] - center;
  for (int c = 0; c < kPathCells; ++c) {
    Eigen::Array4d low = Eigen::Array4d::Constant(std::numeric_limits<double>::infinity());
    Eigen::Array4d high = -low;
    bool seen_well = true;
    for (const Eigen::Matrix3d& camera_from_object : Cells()[c].views) {
      const Eigen::Matrix<double, 3, 4> p = camera_from_object * centered;
      seen_well = (p.col(2) - p.col(1)).head<2>().squaredNorm() >= least_length;
      if (!seen_well) break;
      for (const double nearness : kNearness) {
        Eigen::Matrix<double, 8, 1> image;
        for (int k = 0; k < 4; ++k) {
          const double depth =
              1.0 + p(2, k) * nearness / (options.min_distance_diameters * diameter);
          image.segment<2>(2 * k) = p.col(k).head<2>() / depth;
        }
        const Eigen::Array4d key = KeyOf(image).array();
        low = low.min(key);
        high = high.max(key);
      }
    }
    if (!seen_well || !low.allFinite() || !high.allFinite()) continue;
    const Eigen::Array4d margin = kMarginShare * (high - low) + kMargin;
    PathViewBox& box = boxes.emplace_back();
    box.cell = c;
    for (int k = 0; k < 4; ++k) {
      box.low[k] = static_cast<float>(low(k) - margin(k));
      box.high[k] = static_cast<float>(high(k) + margin(k));
    }
  }
  return boxes;
}

}  // namespace horopter
