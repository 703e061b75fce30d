#include "server/vision/recognition/scoring/pose_score.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "absl/container/inlined_vector.h"
#include "server/vision/geometry/hidden_tolerance.h"

namespace horopter {
namespace {

// Support needs a like-directed image edge within this (working pixels, radians).
constexpr float kSupportPx = 2.5f;
constexpr float kSupportRad = 0.30f;
// ... and is sharp within this of the edge's line: refined right poses have two thirds and more of
// their supported length there (wrong ones of similar parts mostly less than half).
constexpr double kSharpPx = 0.35;
// An image segment is explained by a visible model edge within this.
constexpr int kExplainPx = 3;
// A segment sample this close to the silhouette counts as inside.
constexpr float kMinDrawnDepth = 1e-4f;
// Supported samples of 4 px at which the small-count factor is one half.
constexpr double kSmallCount = 20.0;
constexpr double kSampleLength = 4.0;

// Worth of a pose whose own edges are all there, whatever else is inside its silhouette.
constexpr double kPrintedWorth = 0.85;

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

// Every sixteenth sample of every edge first, then every fourth, then all: a bad pose is left
// early.
constexpr int kPasses = 3;
constexpr std::uint64_t kSixteenth = 0x0001000100010001ull, kFourth = 0x1111111111111111ull;
constexpr std::uint64_t kMasks[kPasses] = {kSixteenth, kFourth & ~kSixteenth, ~kFourth};

// Support of one pose in one view, summed pass by pass. Plain floats: this is the innermost loop of
// recognition.
struct QuickSum {
  QuickSum(const PreparedObject& object,
           const EdgeMaps& edge_maps,
           const PinholeCamera& camera,
           const Rigid3& camera_from_object,
           float reach_px)
      : maps(&edge_maps),
        pose(ToFloat(camera, camera_from_object)),
        bits(object.VisibleBits(AspectOf(object, pose))),
        inverse_reach(1.0f / reach_px),
        width(static_cast<float>(camera.width)),
        height(static_cast<float>(camera.height)) {}

  // False when a sample lies behind the camera.
  bool Add(const PreparedObject& object, int pass) {
    const float* r = pose.R.data();  // column-major
    const float tx = pose.t.x(), ty = pose.t.y(), tz = pose.t.z();
    for (int w = 0; w < object.words; ++w) {
      std::uint64_t word = bits[w] & kMasks[pass];
      while (word != 0) {
        const EdgeSample& s = object.samples[w * 64 + std::countr_zero(word)];
        word &= word - 1;
        const float a = s.point.x(), b = s.point.y(), c = s.point.z();
        const float pz = r[2] * a + r[5] * b + r[8] * c + tz;
        if (pz < kMinDrawnDepth) return false;
        const float px = r[0] * a + r[3] * b + r[6] * c + tx;
        const float py = r[1] * a + r[4] * b + r[7] * c + ty;
        const float focal_over_z = pose.f / pz;
        const float x = focal_over_z * px + pose.cx;
        const float y = focal_over_z * py + pose.cy;
        if (!(x >= 0 && y >= 0 && x < width && y < height)) {
          ++outside;
          continue;
        }
        ++inside;
        const float d = s.tangent.x(), e = s.tangent.y(), g = s.tangent.z();
        const float qz = r[2] * d + r[5] * e + r[8] * g;
        const float qx = r[0] * d + r[3] * e + r[6] * g;
        const float qy = r[1] * d + r[4] * e + r[7] * g;
        const int bin = OrientationBin(qx * pz - px * qz, qy * pz - py * qz);
        sum += std::max(0.0f, 1.0f - maps->DistanceAt(x, y, bin) * inverse_reach);
      }
    }
    return true;
  }
  bool MostlyOutside() const { return inside < 4 || outside * 3 > inside * 2; }
  float Mean() const { return inside > 0 ? sum / static_cast<float>(inside) : 0.0f; }

  const EdgeMaps* maps;
  FloatPose pose;
  const std::uint64_t* bits;
  float inverse_reach, width, height;
  float sum = 0;
  int inside = 0, outside = 0;
};

// Sizes the buffers to the projected bounding box plus a margin; false when nothing of it is in the
// image.
bool FitScratch(const PreparedObject& object,
                const PinholeCamera& working,
                const Rigid3& pose,
                VerifyScratch* scratch) {
  // Working px about the outline: reach of what explains, and rounding.
  constexpr double kMargin = kExplainPx + 2;
  double left = 1e9, top = 1e9, right = -1e9, bottom = -1e9;
  for (const auto& v : object.model.mesh.vertices) {
    const Eigen::Vector3d p = pose * v;
    if (p.z() < kMinDrawnDepth) return false;
    const Eigen::Vector2d u = Project(working, p);
    left = std::min(left, u.x()), right = std::max(right, u.x());
    top = std::min(top, u.y()), bottom = std::max(bottom, u.y());
  }
  scratch->x0 =
      static_cast<int>(std::clamp(left - kMargin, 0.0, static_cast<double>(working.width)));
  scratch->y0 =
      static_cast<int>(std::clamp(top - kMargin, 0.0, static_cast<double>(working.height)));
  const int x1 =
      static_cast<int>(std::clamp(right + kMargin + 1, 0.0, static_cast<double>(working.width)));
  const int y1 =
      static_cast<int>(std::clamp(bottom + kMargin + 1, 0.0, static_cast<double>(working.height)));
  if (x1 <= scratch->x0 || y1 <= scratch->y0) return false;
  DepthBuffer& depth = scratch->depth;
  depth.width = x1 - scratch->x0;
  depth.height = y1 - scratch->y0;
  const std::size_t cells = static_cast<std::size_t>(depth.width) * depth.height;
  depth.depth.assign(cells, DepthBuffer::kNoDepth);
  scratch->model_mask.assign(cells, 0);
  return true;
}

// Marks the cells around a visible model edge point, for its own and the neighbouring orientation
// bins.
void MarkModelEdge(float x, float y, int bin, VerifyScratch* scratch) {
  const std::uint8_t bits =
      static_cast<std::uint8_t>((1u << bin) | (1u << ((bin + 1) % kOrientationBins)) |
                                (1u << ((bin + kOrientationBins - 1) % kOrientationBins)));
  const int width = scratch->depth.width, height = scratch->depth.height;
  const int cx = static_cast<int>(std::lround(x)) - scratch->x0;
  const int cy = static_cast<int>(std::lround(y)) - scratch->y0;
  for (int v = std::max(0, cy - kExplainPx); v <= std::min(height - 1, cy + kExplainPx); ++v) {
    for (int u = std::max(0, cx - kExplainPx); u <= std::min(width - 1, cx + kExplainPx); ++u) {
      scratch->model_mask[static_cast<std::size_t>(v) * width + u] |= bits;
    }
  }
}

// What the object's samples that nothing hides find in the image; marks where they lie.
void CountModelEdges(const PreparedObject& object,
                     const EdgeMaps& maps,
                     const PinholeCamera& working,
                     const Rigid3& camera_from_object,
                     const DepthBuffer* occluders,
                     VerifyScratch* scratch,
                     EdgeSupport* support) {
  const DepthBuffer& depth = scratch->depth;
  const Eigen::Vector2d origin(scratch->x0, scratch->y0);
  const double tolerance = kHiddenShareFound * object.model.diameter_m;
  const std::size_t cells = static_cast<std::size_t>(maps.width) * maps.height;
  for (const EdgeSample& s : object.samples) {
    const Eigen::Vector3d p = camera_from_object * s.point.cast<double>();
    const Eigen::Vector2d u = Project(working, p);
    if (!IsVisible(depth, u - origin, p.z(), tolerance)) continue;
    const Eigen::Vector3d q = camera_from_object.R * s.tangent.cast<double>();
    const Eigen::Vector2d along(q.x() * p.z() - p.x() * q.z(), q.y() * p.z() - p.y() * q.z());
    const double length =
        along.norm() / (p.z() * p.z()) * working.focal_px * object.sample_spacing_m;
    if (occluders != nullptr && !IsVisible(*occluders, u, p.z(), tolerance)) {
      support->hidden_by_others += length;
      continue;
    }
    const int bin = OrientationBin(static_cast<float>(along.x()), static_cast<float>(along.y()));
    const int cx = std::clamp(static_cast<int>(std::lround(u.x())), 0, maps.width - 1);
    const int cy = std::clamp(static_cast<int>(std::lround(u.y())), 0, maps.height - 1);
    support->visible += length;
    MarkModelEdge(static_cast<float>(u.x()), static_cast<float>(u.y()), bin, scratch);
    const std::int32_t nearest = maps.nearest[cells * bin + maps.Cell(cx, cy)];
    if (nearest < 0) continue;
    const EdgePoint& e = maps.points[nearest];
    const Eigen::Vector2f off = e.point * maps.scale_f - u.cast<float>();
    const float turn = std::abs(std::remainder(
        e.direction - static_cast<float>(std::atan2(along.y(), along.x())), 3.14159265f));
    if (off.norm() < kSupportPx && turn < kSupportRad) {
      support->supported += length;
      const double beside =
          std::abs(off.x() * along.y() - off.y() * along.x()) / std::max(along.norm(), 1e-12);
      if (beside < kSharpPx) support->sharp += length;
    }
  }
}

// The image's segments inside the silhouette, and which of them the marks explain.
void CountSegments(const ViewEvidence& view,
                   const DepthBuffer* occluders,
                   const VerifyScratch& scratch,
                   std::vector<std::uint8_t>* explained_segments,
                   EdgeSupport* support) {
  const DepthBuffer& depth = scratch.depth;
  support->segments =
      ViewEvidence::kSegmentSampleStep * static_cast<double>(view.segment_samples.size());
  for (std::size_t i = 0; i < view.segment_samples.size(); ++i) {
    const SegmentSample& s = view.segment_samples[i];
    const int x = static_cast<int>(std::lround(s.point.x())) - scratch.x0;
    const int y = static_cast<int>(std::lround(s.point.y())) - scratch.y0;
    if (x < 0 || y < 0 || x >= depth.width || y >= depth.height) continue;
    const bool explained =
        scratch.model_mask[static_cast<std::size_t>(y) * depth.width + x] >> s.bin & 1;
    if (explained) {
      support->all_explained += ViewEvidence::kSegmentSampleStep;
      if (explained_segments != nullptr) (*explained_segments)[i] = 1;
    } else {
      if (!(depth.At(x, y) < DepthBuffer::kNoDepth)) continue;
      // What another object hides asks for no explanation by this one.
      if (occluders != nullptr && occluders->At(x + scratch.x0, y + scratch.y0) < depth.At(x, y))
        continue;
    }
    support->inside += ViewEvidence::kSegmentSampleStep;
    if (explained) support->explained += ViewEvidence::kSegmentSampleStep;
  }
}

}  // namespace

EdgeSupport& EdgeSupport::operator+=(const EdgeSupport& o) {
  visible += o.visible;
  supported += o.supported;
  sharp += o.sharp;
  inside += o.inside;
  explained += o.explained;
  segments += o.segments;
  all_explained += o.all_explained;
  hidden_by_others += o.hidden_by_others;
  return *this;
}

double SilhouetteF1(const EdgeSupport& s) {
  return F1(s.Precision(), s.RecallInside(), s.supported);
}
double ViewScore(const EdgeSupport& s) {
  const double p = s.Precision(), n = s.supported / kSampleLength;
  return std::max(SilhouetteF1(s), kPrintedWorth * p * p * n / (n + kSmallCount));
}
float QuickScore(const PreparedObject& object,
                 const EdgeMaps& maps,
                 const PinholeCamera& camera,
                 const Rigid3& camera_from_object,
                 float reach_px,
                 float give_up) {
  QuickSum sum(object, maps, camera, camera_from_object, reach_px);
  constexpr float kFirstLook = 0.6f;  // share of give_up that a sixteenth of the samples must reach
  for (int pass = 0; pass < kPasses; ++pass) {
    if (!sum.Add(object, pass)) return 0.0f;
    const float inside = static_cast<float>(sum.inside);
    if (pass == 0 && sum.sum < kFirstLook * give_up * inside) break;
    if (pass > 0 && sum.MostlyOutside()) return 0.0f;
    if (pass == 1 && sum.sum < give_up * inside) break;
  }
  return sum.Mean();
}

float QuickScoreOverViews(const PreparedObject& object,
                          std::span<const QuickView> views,
                          float reach_px,
                          float give_up) {
  // A partial mean of n samples errs by its standard deviation, about 0.3 / sqrt(n), this often.
  constexpr float kSlack = 2.5f * 0.3f;
  constexpr int kFew = 3;  // views after which the first pass may give up
  absl::InlinedVector<QuickSum, 8> sums;
  float mean = 0.0f;
  for (int pass = 0; pass < kPasses; ++pass) {
    float total = 0.0f;
    int seen = 0, samples = 0;
    const auto hopeless = [&] {
      const float slack =
          pass + 1 < kPasses ? kSlack / std::sqrt(static_cast<float>(samples)) : 0.0f;
      return total < (give_up - slack) * static_cast<float>(seen);
    };
    for (std::size_t v = 0; v < views.size(); ++v) {
      if (pass == 0) {
        sums.emplace_back(
            object, *views[v].maps, *views[v].camera, views[v].camera_from_object, reach_px);
      }
      QuickSum& sum = sums[v];
      if (!sum.Add(object, pass)) return 0.0f;
      if (sum.MostlyOutside()) continue;
      total += sum.Mean();
      ++seen;
      samples += sum.inside;
      if (pass == 0 && seen >= kFew && hopeless()) return total / static_cast<float>(seen);
    }
    if (seen == 0) return 0.0f;
    mean = total / static_cast<float>(seen);
    if (hopeless()) break;
  }
  return mean;
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
  if (explained_segments != nullptr) explained_segments->assign(view.segment_samples.size(), 0);
  if (!FitScratch(object, working, camera_from_object, scratch)) return support;
  PinholeCamera shifted = working;
  shifted.cx -= scratch->x0;
  shifted.cy -= scratch->y0;
  RenderDepth(object.model.mesh, shifted, camera_from_object, &scratch->depth);

  CountModelEdges(object, maps, working, camera_from_object, occluders, scratch, &support);
  CountSegments(view, occluders, *scratch, explained_segments, &support);
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
    if (pa.z() < kMinDrawnDepth || pb.z() < kMinDrawnDepth) return 1e9;
    largest = std::max(largest, (Project(camera_a, pa) - Project(camera_b, pb)).norm());
  }
  return largest * working_from_image;
}

}  // namespace horopter
