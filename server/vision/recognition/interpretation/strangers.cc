#include "server/vision/recognition/interpretation/strangers.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/vision/geometry/model_features.h"
#include "server/vision/recognition/aspect_scenes/shape_strain.h"
#include "server/vision/recognition/aspects/edge_difference.h"
#include "server/vision/recognition/interpretation/extra_circles.h"
#include "server/vision/recognition/interpretation/feature_evidence.h"
#include "server/vision/recognition/interpretation/log_odds.h"
#include "server/vision/recognition/interpretation/pose_odds.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

// How likely a stranger is before the images are looked at, against the part; chosen.
constexpr double kStretchedPrior = 1.0, kFeaturePrior = 0.05;
// Of a feature that no image shows where it should be: a shadow hides a rim in all of them.
constexpr double kLeastOfFeature = -6.0;
// What edges beside each other are pushed apart or together by the smoothing, working px: thin
// plates look up to 1.6 px thicker than they are.
constexpr double kEdgeBiasPx = 0.5;
constexpr double kEdgeCorrelation = 9.0;  // points of an edge that err together
// Log odds that a part is not stretched, by the square of how many deviations it seems to be. Right
// parts have up to 5, mostly less than 2, those of real CAD stretched by a twentieth 1 - 8, by a
// tenth 2 - 14 (decision_report).
constexpr double kMostOfStrain = 5.0, kLeastOfStrain = -1.5, kOddsOfSquare = 0.2;
// Log odds of each view that shows something round in one place on a face, of four at most, for a
// part that has it. A printed circle looks the same: three views make an answer ambiguous, two not.
constexpr double kOddsOfCircle = 2.0;
constexpr int kCircleViews = 4;

// Of the part's sides, working px, mean over the views, none of them foreshortened.
Eigen::Vector3d ExtentsPx(std::span<const AspectImage> images,
                          const RenderMesh& mesh,
                          const std::vector<std::optional<CalibratedCamera>>& views,
                          const Rigid3& scene_from_object) {
  Eigen::AlignedBox3f box;
  for (const Eigen::Vector3f& v : mesh.vertices) box.extend(v);
  double scale = 0.0, count = 0.0;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    const double depth =
        (views[v]->camera_from_scene * (scene_from_object * mesh.center.cast<double>())).z();
    if (!(depth > 0.0)) continue;
    scale += views[v]->camera.focal_px * images[v].working_from_image / depth;
    count += 1.0;
  }
  return box.sizes().cast<double>() * (scale / std::max(count, 1.0));
}

// Of how many deviations the stretch is, in the two directions that images see; bias: of each axis.
double SquareOfStrain(const ShapeStrain& strained, const Eigen::Array3d& bias) {
  const Eigen::Matrix<double, 3, 2> seen = StrainDirections();
  Eigen::Matrix3d covariance = kEdgeCorrelation * strained.covariance;
  covariance.diagonal().array() += bias.square();
  const Eigen::Vector2d s = seen.transpose() * strained.strain;
  return s.dot((seen.transpose() * covariance * seen).ldlt().solve(s));
}

std::string PlaceText(const Eigen::Vector3d& place, double size_m) {
  const Eigen::Vector3d at = place * 1e3;
  return absl::StrFormat(
      "at (%.1f, %.1f, %.1f) mm, %.1f mm large", at.x(), at.y(), at.z(), size_m * 1e3);
}

class Strangers {
 public:
  Strangers(const JointContext& context,
            std::span<const AspectImage> images,
            const RecognitionResult& result,
            int place,
            std::span<const DepthBuffer> hidden)
      : context_(context),
        images_(images),
        views_(result.views),
        answer_(result.objects[place]),
        mesh_(context.objects[answer_.object]->aspects->object.mesh),
        hidden_(hidden),
        unknown_(UnknownOdds(context.options.unknown_share)) {}

  std::vector<Rival> All() {
    AddStretched();
    AddFeatures();
    return std::move(out_);
  }

 private:
  Rival& Add(AlternativeKind kind, double weight, std::string words) {
    Rival& rival = out_.emplace_back();
    rival.what.kind = kind;
    rival.what.object = answer_.object;
    rival.weight = unknown_ * weight;
    rival.words = std::move(words);
    return rival;
  }

  void AddStretched() {
    const ShapeStrain strained =
        EstimateStrain(images_, mesh_, views_, answer_.scene_from_object, hidden_);
    const Eigen::Vector3d extents = ExtentsPx(images_, mesh_, views_, answer_.scene_from_object);
    const Eigen::Array3d bias = kEdgeBiasPx / extents.array().max(1.0);
    const double log_odds =
        std::max(kMostOfStrain - kOddsOfSquare * SquareOfStrain(strained, bias), kLeastOfStrain);
    Add(AlternativeKind::kStretched,
        kStretchedPrior * std::exp(-log_odds),
        "like it, but stretched")
        .views = [&mesh = mesh_, strain = strained.strain] {
      return FindDistinguishingFeatures(mesh, Strained(mesh, strain), {}).views;
    };
  }

  void AddFeatures() {
    const std::vector<ModelFeature> features =
        FindModelFeatures(context_.objects[answer_.object]->model);
    const std::vector<VisibleEdges> edges =
        EdgesInViews(images_, views_, mesh_, answer_.scene_from_object);
    const SeenPart part{mesh_, answer_.scene_from_object, edges};
    const std::vector<FeatureEvidence> evidence = RateFeatures(
        images_, views_, part, features, hidden_, context_.options.acceptance.pose_choices);
    const double prior = kFeaturePrior / std::max<double>(1.0, features.size());
    for (std::size_t f = 0; f < features.size(); ++f) {
      AddFeature(features[f].place,
                 features[f].size_m,
                 prior * std::exp(-kEdgeBelief * std::max(evidence[f].log_odds, kLeastOfFeature)),
                 "like it, but without what it has ")
          .views = [&mesh = mesh_, feature = features[f]] {
        const FeatureMap map({feature}, mesh.diameter_m);
        return FindVisibleLength(
            mesh, [&](const VisibleEdgePoint& p) { return map.At(p.point.cast<double>()) >= 0; });
      };
    }
    for (const ExtraCircle& c : FindExtraCircles(images_, views_, part, hidden_)) {
      AddFeature(
          c.place,
          2.0 * c.radius_m,
          kFeaturePrior * std::exp(kEdgeBelief * kOddsOfCircle * std::min(c.views, kCircleViews)),
          "like it, but with something round ");
    }
  }

  Rival& AddFeature(const Eigen::Vector3d& place, double size_m, double weight, const char* words) {
    Rival& rival =
        Add(AlternativeKind::kFeature, weight, absl::StrCat(words, PlaceText(place, size_m)));
    rival.what.feature_place = place;
    rival.what.feature_size_m = size_m;
    return rival;
  }

  const JointContext& context_;
  std::span<const AspectImage> images_;
  const std::vector<std::optional<CalibratedCamera>>& views_;
  const SceneObject& answer_;
  const RenderMesh& mesh_;
  std::span<const DepthBuffer> hidden_;
  const double unknown_;
  std::vector<Rival> out_;
};

}  // namespace

std::vector<Rival> FindStrangers(const JointContext& context,
                                 std::span<const AspectImage> images,
                                 const RecognitionResult& result,
                                 int place,
                                 std::span<const DepthBuffer> hidden) {
  return Strangers(context, images, result, place, hidden).All();
}

}  // namespace horopter
