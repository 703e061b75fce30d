#include "tests/support/synthetic_scene.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/vision/matching/feature_tracks.h"
#include "server/vision/matching/homography.h"
#include "server/vision/matching/plane_chain.h"
#include "tests/support/random.h"

namespace horopter {
namespace {

Rigid3 LookAt(const Eigen::Vector3d& center, const Eigen::Vector3d& target, double roll) {
  const Eigen::Vector3d z = (target - center).normalized();
  const Eigen::Vector3d x = z.cross(Eigen::Vector3d::UnitZ()).normalized();
  Rigid3 pose;
  pose.R.row(0) = x;
  pose.R.row(1) = z.cross(x);
  pose.R.row(2) = z;
  pose.R = Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ()).toRotationMatrix() * pose.R;
  pose.t = -(pose.R * center);
  return pose;
}

bool InImage(const PinholeCamera& camera, const Eigen::Vector2d& p) {
  return p.x() >= 0 && p.y() >= 0 && p.x() <= camera.width - 1 && p.y() <= camera.height - 1;
}

Eigen::Matrix3d Cross(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

}  // namespace

std::vector<ImageSize> SyntheticScene::Sizes() const {
  std::vector<ImageSize> sizes;
  for (const PinholeCamera& camera : cameras) sizes.push_back({camera.width, camera.height});
  return sizes;
}

Eigen::Matrix3d SyntheticScene::PlaneHomographyOf(int a, int b) const {
  const auto map = [&](int v) {
    Eigen::Matrix3d m;
    m << camera_from_world[v].R.col(0), camera_from_world[v].R.col(1), camera_from_world[v].t;
    return (cameras[v].K() * m).eval();
  };
  return *NormalizeDeterminant(map(b) * map(a).inverse());
}

Eigen::Matrix3d SyntheticScene::FundamentalOf(int a, int b) const {
  const Rigid3 b_from_a = camera_from_world[b] * camera_from_world[a].Inverse();
  const Eigen::Matrix3d F = cameras[b].K().inverse().transpose() * Cross(b_from_a.t) * b_from_a.R *
                            cameras[a].K().inverse();
  return F / F.norm();
}

SyntheticScene MakeSyntheticScene(const SyntheticSceneOptions& options) {
  Random random(options.seed);
  SyntheticScene scene;
  for (int i = 0; i < options.views; ++i) {
    const double share = options.views > 1 ? i / static_cast<double>(options.views - 1) - 0.5 : 0.0;
    const double azimuth = options.pure_rotation ? 0.0 : options.arc_rad * share;
    const double elevation = options.pure_rotation ? 0.8 : random.Uniform(0.6, 1.0);
    const double distance = options.pure_rotation ? 0.8 : random.Uniform(0.7, 0.9);
    const Eigen::Vector3d center(distance * std::cos(elevation) * std::cos(azimuth),
                                 distance * std::cos(elevation) * std::sin(azimuth),
                                 distance * std::sin(elevation));
    const Eigen::Vector3d target(random.Uniform(-0.02, 0.02), random.Uniform(-0.02, 0.02), 0.01);
    scene.camera_from_world.push_back(LookAt(center, target, random.Uniform(-0.2, 0.2)));
    scene.cameras.push_back(CenteredCamera(
        options.width,
        options.height,
        options.width * random.Uniform(options.min_focal_widths, options.max_focal_widths)));
  }
  for (int k = 0; k < options.plane_points; ++k) {
    const double x = random.Uniform(-0.2, 0.2);
    scene.plane_points.emplace_back(x, random.Uniform(-0.2, 0.2), 0.0);
  }
  for (int k = 0; k < options.off_plane_points; ++k) {
    const double x = random.Uniform(-0.1, 0.1), y = random.Uniform(-0.1, 0.1);
    scene.off_plane_points.emplace_back(x, y, random.Uniform(0.02, 0.1));
  }
  return scene;
}

SyntheticMatches MatchSyntheticScene(const SyntheticScene& scene, const SyntheticNoise& noise) {
  Random random(noise.seed);
  SyntheticMatches result;
  const int views = static_cast<int>(scene.cameras.size());
  std::vector<std::vector<Eigen::Vector2d>> plane(views);
  for (int v = 0; v < views; ++v) {
    ImageFeatures features;
    features.width = scene.cameras[v].width;
    features.height = scene.cameras[v].height;
    for (const Eigen::Vector3d& x : scene.off_plane_points) {
      Junction junction;
      junction.point =
          Project(scene.cameras[v], scene.camera_from_world[v] * x) + random.Noise(noise.sigma_px);
      features.junctions.push_back(junction);
    }
    for (const Eigen::Vector3d& x : scene.plane_points) {
      plane[v].push_back(Project(scene.cameras[v], scene.camera_from_world[v] * x) +
                         random.Noise(noise.sigma_px));
    }
    result.features.push_back(features);
  }
  MatchingResult& matching = result.matching;
  for (int a = 0; a < views; ++a) {
    for (int b = a + 1; b < views; ++b) {
      PlaneHomography h;
      h.view_a = a;
      h.view_b = b;
      std::vector<PointPair> pairs;
      for (size_t k = 0; k < scene.plane_points.size(); ++k) {
        if (!InImage(scene.cameras[a], plane[a][k]) || !InImage(scene.cameras[b], plane[b][k]))
          continue;
        h.inliers_a.push_back(plane[a][k]);
        h.inliers_b.push_back(plane[b][k]);
        pairs.push_back({plane[a][k], plane[b][k]});
      }
      const auto H = FitHomography(pairs);
      if (H) {
        h.b_from_a = RefineHomography(*H, pairs);
        matching.planes.push_back(h);
      }
      PairGeometry pair;
      pair.view_a = a;
      pair.view_b = b;
      const int n = static_cast<int>(scene.off_plane_points.size());
      if (n >= 2 && scene.FundamentalOf(a, b).allFinite()) {
        pair.F = scene.FundamentalOf(a, b);
        for (int k = 0; k < n; ++k) {
          const bool outlier = random.Uniform(0.0, 1.0) < noise.outlier_share;
          pair.matches.push_back({k, outlier ? random.Index(n) : k});
        }
      }
      matching.pairs.push_back(pair);
    }
  }
  matching.junction_tracks = JoinTracks(JunctionLinks(matching.pairs, /*accepted_only=*/true));
  PlaneChain chain = ChainPlanes(matching.planes, views, 4.0);
  matching.component = chain.component;
  matching.view_from_plane = chain.view_from_plane;
  for (const ImageFeatures& f : result.features)
    matching.segment_on_plane.emplace_back(f.segments.size(), false);
  return result;
}

}  // namespace horopter
