#include "tests/support/staged_scene.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "server/base/status_macros.h"

namespace horopter {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr int kTexture = 2048;  // pixels of a table's metre
// A part stands surely when its centre of mass is as far inside its footprint, of the diameter.
constexpr double kLeastMargin = 0.05;
constexpr double kGap = 0.08;         // between parts, of the median diameter
constexpr int kTries = 60;            // of a place for a part
constexpr double kSceneShare = 1.25;  // reach of the places, of the median diameter

Vector3f FromHsv(double hue, double saturation, double value) {
  const auto channel = [&](double n) {
    const double k = std::fmod(n + hue * 6.0, 6.0);
    return static_cast<float>(value *
                              (1.0 - saturation * std::clamp(std::min(k, 4.0 - k), 0.0, 1.0)));
  };
  return {channel(5), channel(3), channel(1)};
}

// Smooth noise of so many cells across, deviation 1.
cv::Mat_<float> Noise(int cells, Random* random) {
  cv::Mat_<float> coarse(cells, cells), out;
  for (float& v : coarse) v = static_cast<float>(random->Normal());
  cv::resize(coarse, out, {kTexture, kTexture}, 0, 0, cv::INTER_CUBIC);
  cv::Scalar mean, sigma;
  cv::meanStdDev(out, mean, sigma);
  return (out - mean[0]) / sigma[0];
}

// Deviations about 0.
cv::Mat_<float> Pattern(TableKind kind, Random* random) {
  cv::Mat_<float> out(kTexture, kTexture, 0.0f);
  switch (kind) {
    case TableKind::kBlank:
      return Noise(6, random);  // stains too large to be features
    case TableKind::kMottled:
      for (const int cells : {24, 60, 150, 370})
        out += Noise(cells, random) * static_cast<float>(random->Uniform(0.2, 0.7));
      return out;
    case TableKind::kStriped: {
      const double angle = random->Uniform(0, std::numbers::pi), period = random->Uniform(40, 110);
      const cv::Mat_<float> waver = Noise(8, random);
      for (int y = 0; y < kTexture; ++y) {
        for (int x = 0; x < kTexture; ++x) {
          const double s = (x * std::cos(angle) + y * std::sin(angle)) / period;
          out(y, x) = static_cast<float>(
              std::clamp(3.0 * std::sin(2 * std::numbers::pi * s + 0.2 * waver(y, x)), -1.0, 1.0));
        }
      }
      return out + 0.3 * Noise(250, random);
    }
    case TableKind::kSpeckled: {
      for (int i = 0; i < 9000; ++i) {
        const cv::Point at(random->Index(kTexture), random->Index(kTexture));
        const double size = random->Uniform(1.5, 9.0);
        cv::ellipse(out,
                    at,
                    cv::Size2d(size, size * random->Uniform(0.5, 1.0)),
                    random->Uniform(0, 180),
                    0,
                    360,
                    random->Uniform(-2.0, 2.0),
                    cv::FILLED,
                    cv::LINE_AA);
      }
      return out + 0.3 * Noise(300, random);
    }
  }
  return out;
}

// Points of the mesh as it stands, on the table; the farthest from their middle.
struct Footprint {
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  double radius_m = 0.0;
};

Footprint FootprintOf(const RenderMesh& mesh, const Eigen::Matrix3d& R) {
  Eigen::Vector2d low = Eigen::Vector2d::Constant(1e30), high = -low;
  for (const Vector3f& v : mesh.vertices) {
    const Eigen::Vector2d p = (R * v.cast<double>()).head<2>();
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  Footprint out{0.5 * (low + high), 0.0};
  for (const Vector3f& v : mesh.vertices) {
    out.radius_m = std::max(out.radius_m, ((R * v.cast<double>()).head<2>() - out.middle).norm());
  }
  return out;
}

Vector3d OnDome(double azimuth, double elevation, double distance) {
  return distance * Vector3d(std::cos(azimuth) * std::cos(elevation),
                             std::sin(azimuth) * std::cos(elevation),
                             std::sin(elevation));
}

}  // namespace

std::string NameOf(TableKind kind) {
  switch (kind) {
    case TableKind::kBlank:
      return "blank";
    case TableKind::kMottled:
      return "mottled";
    case TableKind::kStriped:
      return "striped";
    case TableKind::kSpeckled:
      return "speckled";
  }
  return "";
}

PaintedTable MakeTable(TableKind kind, double contrast, Random* random) {
  const cv::Mat_<float> pattern = Pattern(kind, random), hues = Noise(10, random);
  const double hue = random->Uniform(0, 1), saturation = random->Uniform(0.0, 0.4);
  const Vector3f base = FromHsv(hue, saturation, random->Uniform(0.25, 0.7));
  PaintedTable out;
  out.reflectance.create(kTexture, kTexture);
  for (int y = 0; y < kTexture; ++y) {
    for (int x = 0; x < kTexture; ++x) {
      for (int c = 0; c < 3; ++c) {
        // Colours vary a little with the place.
        const double tint = 1.0 + 0.02 * hues(y, x) * (c - 1);
        out.reflectance(y, x)[c] = static_cast<float>(
            std::clamp(base(c) * tint * (1.0 + contrast * pattern(y, x)), 0.01, 0.95));
      }
    }
  }
  return out;
}

absl::StatusOr<StageablePart> MakeStageable(int id, const TriangleMesh& mesh, double diameter_m) {
  StageablePart out;
  out.id = id;
  HOROPTER_ASSIGN_OR_RETURN(out.mesh, ExactRenderMesh(mesh, diameter_m));
  out.diameter_m = out.mesh.diameter_m;
  for (const StablePose& pose : FindStablePoses(mesh)) {
    if (!pose.rolls && pose.margin_m >= kLeastMargin * out.diameter_m) out.poses.push_back(pose);
  }
  if (out.poses.empty()) return absl::InvalidArgumentError("it stands in no pose");
  return out;
}

double MedianDiameter(std::span<const StageablePart> parts) {
  std::vector<double> all;
  for (const StageablePart& part : parts) all.push_back(part.diameter_m);
  std::nth_element(all.begin(), all.begin() + all.size() / 2, all.end());
  return all[all.size() / 2];
}

std::vector<StagedPart> StandParts(std::span<const StageablePart> parts,
                                   int count,
                                   Random* random) {
  const double size = MedianDiameter(parts);
  std::vector<int> left(parts.size());
  for (std::size_t i = 0; i < left.size(); ++i) left[i] = static_cast<int>(i);
  struct Taken {
    Eigen::Vector2d at;
    double radius_m;
  };
  std::vector<Taken> taken;
  std::vector<StagedPart> out;
  for (int i = 0; i < count && !left.empty(); ++i) {
    const int k = random->Index(static_cast<int>(left.size()));
    const int chosen = left[k];
    left.erase(left.begin() + k);
    const StageablePart& part = parts[chosen];
    const StablePose& pose = part.poses[random->Index(static_cast<int>(part.poses.size()))];
    const Eigen::Matrix3d R =
        Eigen::AngleAxisd(random->Uniform(0, 2 * std::numbers::pi), Vector3d::UnitZ())
            .toRotationMatrix() *
        Eigen::Quaterniond::FromTwoVectors(pose.up, Vector3d::UnitZ()).toRotationMatrix();
    const Footprint foot = FootprintOf(part.mesh, R);
    const double reach = count == 1 ? 0.4 * size : kSceneShare * size;
    for (int t = 0; t < kTries; ++t) {
      // Evenly over a disc.
      const double r = reach * std::sqrt(random->Uniform(0, 1));
      const double a = random->Uniform(0, 2 * std::numbers::pi);
      const Eigen::Vector2d at(r * std::cos(a), r * std::sin(a));
      if (std::any_of(taken.begin(), taken.end(), [&](const Taken& o) {
            return (at - o.at).norm() < o.radius_m + foot.radius_m + kGap * size;
          })) {
        continue;
      }
      taken.push_back({at, foot.radius_m});
      const Eigen::Vector2d t_xy = at - foot.middle;
      out.push_back({chosen, {R, Vector3d(t_xy.x(), t_xy.y(), pose.height_m)}});
      break;
    }
  }
  return out;
}

std::vector<LightSource> MakeLights(Random* random) {
  std::vector<LightSource> out;
  constexpr int kLamp = 10, kRings = 3, kPerRing = 6;
  const double azimuth = random->Uniform(0, 2 * std::numbers::pi);
  const double elevation = random->Uniform(40, 75) * kDegree;
  const double width = random->Uniform(0.05, 0.35);  // metres; shadows as soft
  const Vector3f warm(1.0f, static_cast<float>(random->Uniform(0.9, 1.0)), 0.92f);
  const auto strength = static_cast<float>(random->Uniform(0.4, 0.7));
  for (int i = 0; i < kLamp; ++i) {
    // A spiral that covers the lamp's disc.
    const double r = width * std::sqrt((i + 0.5) / kLamp), a = 2.4 * i;
    const Vector3d offset(r * std::cos(a), r * std::sin(a), 0.0);
    out.push_back({OnDome(azimuth, elevation, 1.6) + offset, strength / kLamp * warm, true});
  }
  // The sky's radiance times the solid angle of each of its parts.
  const auto sky = static_cast<float>(random->Uniform(0.3, 0.5));
  for (int k = 0; k < kRings; ++k) {
    for (int i = 0; i < kPerRing; ++i) {
      const double e = (18.0 + 27.0 * k) * kDegree;
      const double a = 2 * std::numbers::pi * (i + 0.5 * (k % 2)) / kPerRing + azimuth;
      // Rooms are not equally light on all sides.
      const auto side = static_cast<float>(random->Uniform(0.5, 1.5) * std::cos(e));
      out.push_back({OnDome(a, e, 2.5), Vector3f::Constant(sky * side / (0.8f * kPerRing)), false});
    }
  }
  return out;
}

PaintedScene PaintScene(std::span<const StageablePart> parts,
                        std::span<const StagedPart> standing,
                        PaintedTable table,
                        std::vector<LightSource> lights,
                        Random* random) {
  PaintedScene out;
  out.table = std::move(table);
  out.lights = std::move(lights);
  for (const StagedPart& s : standing) {
    const StageablePart& part = parts[s.part];
    PaintedPart painted;
    painted.mesh = &part.mesh;
    painted.world_from_object = s.world_from_object;
    painted.color = FromHsv(random->Uniform(0, 1),
                            random->Uniform(0.0, 0.75),
                            std::pow(random->Uniform(0.35, 0.9), 1.6));
    painted.gloss = static_cast<float>(std::max(0.0, random->Uniform(-0.15, 0.3)));
    painted.shininess = static_cast<float>(random->Uniform(15, 60));
    out.parts.push_back(painted);
    out.radius_m =
        std::max(out.radius_m, s.world_from_object.t.head<2>().norm() + 1.5 * part.diameter_m);
  }
  return out;
}

StagedRig MakeRig(const RigOptions& options, Random* random) {
  StagedRig out;
  double azimuth = random->Uniform(0, 2 * std::numbers::pi);
  for (int c = 0; c < options.cameras; ++c) {
    PinholeCamera camera =
        CenteredCamera(options.width, options.height, options.width * random->Uniform(1.1, 1.9));
    camera.cx += 0.01 * options.width * std::clamp(random->Normal(), -2.0, 2.0);
    camera.cy += 0.01 * options.width * std::clamp(random->Normal(), -2.0, 2.0);
    camera.k1 = -random->Uniform(0.0, options.most_k1);
    // Across the image's smaller side there is room for the scene.
    const double distance =
        camera.focal_px * options.scene_m / options.height * random->Uniform(0.95, 1.2);
    const Vector3d from = OnDome(azimuth, random->Uniform(32, 60) * kDegree, distance);
    const Vector3d to(random->Uniform(-0.1, 0.1) * options.scene_m,
                      random->Uniform(-0.1, 0.1) * options.scene_m,
                      0.1 * options.scene_m);
    const Vector3d z = (to - from).normalized(), x = z.cross(Vector3d::UnitZ()).normalized();
    Eigen::Matrix3d upright;
    upright << x.transpose(), z.cross(x).transpose(), z.transpose();
    const Eigen::Matrix3d R =
        Eigen::AngleAxisd(random->Uniform(-10, 10) * kDegree, Vector3d::UnitZ()) * upright;
    out.cameras.push_back(camera);
    out.camera_from_world.push_back({R, -(R * from)});
    azimuth += random->Uniform(15, 35) * kDegree;
  }
  return out;
}

CameraLook MakeLook(Random* random) {
  CameraLook look;
  look.exposure = static_cast<float>(std::exp(random->Uniform(-0.25, 0.25)));
  look.gains = {static_cast<float>(std::exp(random->Uniform(-0.08, 0.08))),
                1.0f,
                static_cast<float>(std::exp(random->Uniform(-0.08, 0.08)))};
  look.blur_px = random->Uniform(0.3, 0.7);
  look.noise = random->Uniform(1.0, 3.0);
  look.seed = static_cast<unsigned>(random->Uniform(1, 1e9));
  return look;
}

}  // namespace horopter
