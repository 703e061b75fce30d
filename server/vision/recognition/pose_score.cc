#include "server/vision/recognition/pose_score.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

namespace horopter {
namespace {

// Support needs a like-directed image edge within this (working pixels, radians).
constexpr float kSupportPx = 2.5f;
constexpr float kSupportRad = 0.30f;
// An image segment is explained by a visible model edge within this.
constexpr int kExplainPx = 3;
// A segment sample this close to the silhouette counts as inside.
constexpr double kHiddenTolerance = 0.015;  // share of the diameter
constexpr float kMinDepth = 1e-4f;
// Supported samples of 4 px at which the small-count factor is one half.
constexpr double kSmallCount = 20.0;
constexpr double kSampleLength = 4.0;

double F1(double p, double r, double supported) {
  if (p + r <= 0) return 0.0;
  const double n = supported / kSampleLength;
  return 2 * p * r / (p + r) * n / (n + kSmallCount);
}

struct FloatPose {
  Eigen::Matrix3f R;
  Eigen::Vector3f t;
  float f, cx, cy;
};

FloatPose ToFloat(const PinholeCamera& camera, const Rigid3& pose) {
  return {pose.R.cast<float>(),
          pose.t.cast<float>(),
          static_cast<float>(camera.focal_px),
          static_cast<float>(camera.cx),
          static_cast<float>(camera.cy)};
}

int AspectOf(const PreparedObject& object, const FloatPose& pose) {
  return AspectIndex(pose.R.transpose() * -pose.t - object.center.cast<float>());
}

// Marks the cells around a visible model edge point, for its own and the neighbouring orientation bins.
void MarkModelEdge(const EdgeMaps& maps, float x, float y, int bin, std::vector<std::uint8_t>* mask) {
  const std::uint8_t bits = static_cast<std::uint8_t>(
      (1u << bin) | (1u << ((bin + 1) % kOrientationBins)) |
      (1u << ((bin + kOrientationBins - 1) % kOrientationBins)));
  const int cx = static_cast<int>(std::lround(x));
  const int cy = static_cast<int>(std::lround(y));
  for (int v = std::max(0, cy - kExplainPx); v <= std::min(maps.height - 1, cy + kExplainPx); ++v) {
    for (int u = std::max(0, cx - kExplainPx); u <= std::min(maps.width - 1, cx + kExplainPx); ++u) {
      (*mask)[maps.Cell(u, v)] |= bits;
    }
  }
}

bool InsideSilhouette(const DepthBuffer& depth, const Eigen::Vector2f& p) {
  const int x = static_cast<int>(std::lround(p.x()));
  const int y = static_cast<int>(std::lround(p.y()));
  if (x < 0 || y < 0 || x >= depth.width || y >= depth.height) return false;
  return depth.At(x, y) < DepthBuffer::kNoDepth;
}

}  // namespace

EdgeSupport& EdgeSupport::operator+=(const EdgeSupport& o) {
  visible += o.visible;
  supported += o.supported;
  inside += o.inside;
  explained += o.explained;
  segments += o.segments;
  all_explained += o.all_explained;
  hidden_by_others += o.hidden_by_others;
  return *this;
}

double SilhouetteF1(const EdgeSupport& s) { return F1(s.Precision(), s.RecallInside(), s.supported); }
double WholeImageF1(const EdgeSupport& s) { return F1(s.Precision(), s.RecallAll(), s.supported); }

float QuickScore(const PreparedObject& object,
                 const EdgeMaps& maps,
                 const PinholeCamera& camera,
                 const Rigid3& camera_from_object,
                 float reach_px,
                 float give_up) {
  const FloatPose pose = ToFloat(camera, camera_from_object);
  const std::uint64_t* bits = object.VisibleBits(AspectOf(object, pose));
  const float inverse_reach = 1.0f / reach_px;
  const float width = static_cast<float>(camera.width), height = static_cast<float>(camera.height);
  float sum = 0;
  int inside = 0, outside = 0;
  // Two passes: every fourth sample of every edge first, so that a bad pose is left early.
  for (int pass = 0; pass < 2; ++pass) {
    for (int w = 0; w < object.words; ++w) {
      constexpr std::uint64_t kEveryFourth = 0x1111111111111111ull;
      std::uint64_t word = bits[w] & (pass == 0 ? kEveryFourth : ~kEveryFourth);
      while (word != 0) {
        const EdgeSample& s = object.samples[w * 64 + std::countr_zero(word)];
        word &= word - 1;
        const Eigen::Vector3f p = pose.R * s.point + pose.t;
        if (p.z() < kMinDepth) return 0.0f;
        const float inverse_z = 1.0f / p.z();
        const float x = pose.f * p.x() * inverse_z + pose.cx;
        const float y = pose.f * p.y() * inverse_z + pose.cy;
        if (!(x >= 0 && y >= 0 && x < width && y < height)) {
          ++outside;
          continue;
        }
        ++inside;
        const Eigen::Vector3f q = pose.R * s.tangent;
        const int bin = OrientationBin(q.x() * p.z() - p.x() * q.z(), q.y() * p.z() - p.y() * q.z());
        const float d = maps.DistanceAt(x, y, bin);
        sum += std::max(0.0f, 1.0f - d * inverse_reach);
      }
    }
    if (inside < 4 || outside * 3 > inside * 2) return 0.0f;
    if (pass == 0 && sum < give_up * static_cast<float>(inside)) break;
  }
  return sum / static_cast<float>(inside);
}

PinholeCamera WorkingCamera(const PinholeCamera& camera, const EdgeMaps& maps) {
  const double s = maps.working_from_image;
  return {maps.width, maps.height, camera.focal_px * s, camera.cx * s, camera.cy * s, camera.k1};
}

EdgeSupport VerifyPose(const PreparedObject& object,
                       const ViewEvidence& view,
                       const PinholeCamera& camera,
                       const Rigid3& camera_from_object,
                       const DepthBuffer* occluders,
                       VerifyScratch* scratch,
                       std::vector<std::uint8_t>* explained_segments) {
  EdgeSupport support;
  const EdgeMaps& maps = view.maps;
  const PinholeCamera working = WorkingCamera(camera, maps);
  DepthBuffer& depth = scratch->depth;
  if (depth.width != maps.width || depth.height != maps.height) {
    depth = MakeDepthBuffer(maps.width, maps.height);
  } else {
    ClearDepth(&depth);
  }
  RenderDepth(object.model.mesh, working, camera_from_object, &depth);
  scratch->model_mask.assign(static_cast<std::size_t>(maps.width) * maps.height, 0);

  const double tolerance = kHiddenTolerance * object.model.diameter_m;
  const std::size_t cells = static_cast<std::size_t>(maps.width) * maps.height;
  for (const EdgeSample& s : object.samples) {
    const Eigen::Vector3d p = camera_from_object * s.point.cast<double>();
    if (p.z() < kMinDepth) return {};
    const Eigen::Vector2d u = Project(working, p);
    if (!IsVisible(depth, u, p.z(), tolerance)) continue;
    const Eigen::Vector3d q = camera_from_object.R * s.tangent.cast<double>();
    const Eigen::Vector2d along(q.x() * p.z() - p.x() * q.z(), q.y() * p.z() - p.y() * q.z());
    const double length =
        along.norm() / (p.z() * p.z()) * working.focal_px * object.sample_spacing_m;
    if (occluders != nullptr && !IsVisible(*occluders, u, p.z(), tolerance)) {
      support.hidden_by_others += length;
      continue;
    }
    const int bin = OrientationBin(static_cast<float>(along.x()), static_cast<float>(along.y()));
    const int cx = std::clamp(static_cast<int>(std::lround(u.x())), 0, maps.width - 1);
    const int cy = std::clamp(static_cast<int>(std::lround(u.y())), 0, maps.height - 1);
    support.visible += length;
    MarkModelEdge(maps, static_cast<float>(u.x()), static_cast<float>(u.y()), bin, &scratch->model_mask);
    const std::int32_t nearest = maps.nearest[cells * bin + maps.Cell(cx, cy)];
    if (nearest < 0) continue;
    const EdgePoint& e = maps.points[nearest];
    const Eigen::Vector2f off = e.point * maps.scale_f - u.cast<float>();
    const float turn = std::abs(std::remainder(
        e.direction - static_cast<float>(std::atan2(along.y(), along.x())), 3.14159265f));
    if (off.norm() < kSupportPx && turn < kSupportRad) support.supported += length;
  }

  if (explained_segments != nullptr) explained_segments->assign(view.segment_samples.size(), 0);
  for (std::size_t i = 0; i < view.segment_samples.size(); ++i) {
    const SegmentSample& s = view.segment_samples[i];
    support.segments += ViewEvidence::kSegmentSampleStep;
    const int x = std::clamp(static_cast<int>(std::lround(s.point.x())), 0, maps.width - 1);
    const int y = std::clamp(static_cast<int>(std::lround(s.point.y())), 0, maps.height - 1);
    const bool explained = scratch->model_mask[maps.Cell(x, y)] >> s.bin & 1;
    if (explained) {
      support.all_explained += ViewEvidence::kSegmentSampleStep;
      if (explained_segments != nullptr) (*explained_segments)[i] = 1;
    }
    if (explained || InsideSilhouette(depth, s.point)) {
      // What another object hides asks for no explanation by this one.
      if (!explained && occluders != nullptr && occluders->At(x, y) < depth.At(x, y)) continue;
      support.inside += ViewEvidence::kSegmentSampleStep;
      if (explained) support.explained += ViewEvidence::kSegmentSampleStep;
    }
  }
  return support;
}

double ProjectionDistance(const PreparedObject& object,
                          const PinholeCamera& camera_a,
                          const Rigid3& a,
                          const PinholeCamera& camera_b,
                          const Rigid3& b,
                          double working_from_image) {
  const Eigen::Vector3d half = Eigen::Vector3d::Constant(object.radius_m / std::sqrt(3.0));
  double largest = 0.0;
  for (int corner = 0; corner < 8; ++corner) {
    const Eigen::Vector3d sign((corner & 1) ? 1 : -1, (corner & 2) ? 1 : -1, (corner & 4) ? 1 : -1);
    const Eigen::Vector3d x = object.center + sign.cwiseProduct(half);
    const Eigen::Vector3d pa = a * x, pb = b * x;
    if (pa.z() < kMinDepth || pb.z() < kMinDepth) return 1e9;
    largest = std::max(largest, (Project(camera_a, pa) - Project(camera_b, pb)).norm());
  }
  return largest * working_from_image;
}

}  // namespace horopter
