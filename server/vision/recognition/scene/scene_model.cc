#include "server/vision/recognition/scene/scene_model.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/vision/recognition/scoring/log_odds.h"

namespace horopter {
namespace {

// Cost of a predicted edge that is not there, and of an image edge inside the silhouette that
// stays unexplained, in units of an explained edge.
constexpr double kPrintedPrecision = 0.8;
constexpr double kPrintedShare = 0.5;
constexpr double kMissingCost = 1.5;
constexpr double kUnexplainedCost = 0.5;
constexpr double kFootprintTouch = 0.006;  // share of the diameter

// Views in which less is predicted to be visible (working pixels) have no say.
constexpr double kMinVisible = 40.0;
// Floor of a view's F1 in the geometric mean: one view hidden by something unknown must not decide
// alone.
constexpr double kViewFloor = 0.12;

}  // namespace

double LogLikelihoodRatio(const PlacedObject& p) {
  const double sharpness = p.total.Sharpness();
  return EdgeLogLikelihoodRatio(p.score, sharpness) + TextureLogOdds(p.texture, sharpness);
}

double JointScore(std::span<const EdgeSupport> support,
                  const std::vector<std::optional<CalibratedCamera>>& views) {
  int registered = 0, seen = 0, hidden = 0;
  double log_sum = 0.0;
  for (std::size_t v = 0; v < support.size(); ++v) {
    if (!views[v]) continue;
    ++registered;
    if (support[v].visible >= kMinVisible) {
      ++seen;
      log_sum += std::log(std::max(kViewFloor, ViewScore(support[v])));
    } else if (support[v].hidden_by_others > 0) {
      ++hidden;
    }
  }
  if (seen == 0 || (registered >= 2 && seen < 2) || 3 * (seen + hidden) < 2 * registered)
    return 0.0;
  return std::exp(log_sum / seen);
}

double DescriptionGain(const EdgeSupport& s) {
  double unexplained = s.inside - s.explained;
  // Print on a part that is there beyond doubt is no evidence against it.
  if (s.Precision() >= kPrintedPrecision)
    unexplained = std::min(unexplained, kPrintedShare * s.supported);
  return s.supported - kMissingCost * (s.visible - s.supported) - kUnexplainedCost * unexplained;
}

void EvaluatePlacement(const JointContext& context,
                       const std::vector<std::optional<CalibratedCamera>>& views,
                       std::span<const DepthBuffer> occluders,
                       VerifyScratch* scratch,
                       PlacedObject* placed,
                       ExplainedSegments* explained) {
  const PreparedObject& object = *context.objects[placed->object];
  placed->support.assign(views.size(), {});
  placed->total = {};
  if (explained != nullptr) explained->assign(views.size(), {});
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    placed->support[v] = VerifyPose(object,
                                    context.views[v],
                                    views[v]->camera,
                                    views[v]->camera_from_scene * placed->scene_from_object,
                                    occluders.empty() ? nullptr : &occluders[v],
                                    scratch,
                                    explained == nullptr ? nullptr : &(*explained)[v]);
    placed->total += placed->support[v];
  }
  placed->score = JointScore(placed->support, views);
  placed->description_gain = DescriptionGain(placed->total);
}

void EvaluateTogether(const JointContext& context, SceneModel* scene) {
  VerifyScratch scratch;
  scene->description_gain = 0.0;
  for (PlacedObject& o : scene->objects) {
    std::vector<DepthBuffer> others;
    if (scene->objects.size() > 1) {
      for (std::size_t v = 0; v < scene->views.size(); ++v) {
        const EdgeMaps& maps = context.views[v].maps;
        others.push_back(MakeDepthBuffer(maps.width, maps.height));
        if (!scene->views[v]) continue;
        for (const PlacedObject& other : scene->objects) {
          if (&other == &o) continue;
          RenderDepth(context.objects[other.object]->model.mesh,
                      WorkingCamera(scene->views[v]->camera, maps),
                      scene->views[v]->camera_from_scene * other.scene_from_object,
                      &others.back());
        }
      }
    }
    EvaluatePlacement(context, scene->views, others, &scratch, &o);
    scene->description_gain += std::max(0.0, o.description_gain);
  }
}

std::vector<Eigen::Vector3d> Footprint(const PreparedObject& object, const StablePose& pose) {
  const Eigen::Vector3d u = pose.up.unitOrthogonal();
  const Eigen::Vector3d w = pose.up.cross(u);
  std::vector<Eigen::Vector3d> touching;
  for (const auto& v : object.model.mesh.vertices) {
    if (pose.up.dot(v) + pose.height_m < kFootprintTouch * object.model.diameter_m)
      touching.push_back(v);
  }
  std::vector<Eigen::Vector3d> out;
  for (int k = 0; k < 8 && !touching.empty(); ++k) {
    const double a = k * 3.14159265358979 / 4;
    const Eigen::Vector3d d = std::cos(a) * u + std::sin(a) * w;
    const auto it =
        std::max_element(touching.begin(), touching.end(), [&](const auto& x, const auto& y) {
          return d.dot(x) < d.dot(y);
        });
    if (std::none_of(
            out.begin(), out.end(), [&](const auto& x) { return (x - *it).norm() < 1e-6; })) {
      out.push_back(*it);
    }
  }
  return out;
}

}  // namespace horopter
