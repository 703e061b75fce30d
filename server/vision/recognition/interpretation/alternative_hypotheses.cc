#include "server/vision/recognition/interpretation/alternative_hypotheses.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/object/same_pose.h"
#include "server/vision/recognition/scene/scene_refine.h"
#include "server/vision/recognition/scene/surface_texture.h"

namespace horopter {
namespace {

constexpr double kHalfPi = 1.5707963267948966;

// The turn about the object's centre.
Rigid3 About(const Eigen::Vector3d& center, const Eigen::Matrix3d& R) {
  return {R, center - R * center};
}

// Whether the turned edge samples lie nearer than `limit` to the edge samples in the mean. Without
// samples nothing is known, and every turn would fit.
bool Fits(const PreparedObject& object, const Rigid3& turn, double limit) {
  if (object.samples.empty()) return false;
  const double most = limit * static_cast<double>(object.samples.size());
  double sum = 0.0;
  for (const EdgeSample& s : object.samples) {
    const Eigen::Vector3f p = (turn * s.point.cast<double>()).cast<float>();
    float nearest = 1e30f;
    for (const EdgeSample& t : object.samples)
      nearest = std::min(nearest, (t.point - p).squaredNorm());
    sum += std::sqrt(nearest);
    if (sum >= most) return false;
  }
  return true;
}

// The scene with another object in the place of one of its own, refined and judged.
std::optional<SceneModel> WithAlternative(const JointContext& context,
                                          const SurfaceImages* images,
                                          const SceneModel& scene,
                                          int place,
                                          const PlacedObject& alternative) {
  SceneModel trial = scene;
  trial.objects[place].object = alternative.object;
  trial.objects[place].scene_from_object = alternative.scene_from_object;
  SceneRefineOptions refine = context.options.search.scene_refine;
  refine.start_reach_px = refine.guess_reach_px;
  for (int pass = 0; pass < 2; ++pass) {
    if (!RefineScene(context, refine, &trial)) return std::nullopt;
    refine.start_reach_px = context.options.search.scene_refine.start_reach_px;
  }
  EvaluateTogether(context, &trial);
  JudgeTexture(context, images, place, &trial);
  return trial;
}

// Whether another object than the one in question loses its support.
bool Harms(const AlternativeAcceptance& acceptance,
           const SceneModel& scene,
           const SceneModel& trial,
           int place) {
  for (std::size_t k = 0; k < scene.objects.size(); ++k) {
    if (static_cast<int>(k) != place &&
        trial.objects[k].score < scene.objects[k].score - acceptance.max_harm)
      return true;
  }
  return false;
}

// By how much score an alternative leads what holds the place, less than 0: it does not. Sharpness
// tells poses of one object apart, of different objects their description-length gain must (Leads).
double Lead(const AlternativeAcceptance& acceptance,
            const PlacedObject& alternative,
            const PlacedObject& holder) {
  double lead = alternative.score - holder.score;
  if (alternative.object == holder.object)
    lead +=
        acceptance.sharpness_weight * (alternative.total.Sharpness() - holder.total.Sharpness());
  const double texture = alternative.texture - holder.texture;
  if (std::abs(texture) > acceptance.clear_texture || alternative.object != holder.object)
    lead += acceptance.texture_weight * texture;
  return lead;
}

// Whether the alternative of one scene leads what holds the place in the other.
bool Leads(const AlternativeAcceptance& acceptance,
           const SceneModel& with_alternative,
           const SceneModel& with_holder,
           int place) {
  const PlacedObject &alternative = with_alternative.objects[place],
                     &holder = with_holder.objects[place];
  // A look-alike may show as many edges, but not as sharply.
  if (alternative.object != holder.object &&
      LogLikelihoodRatio(alternative) <= LogLikelihoodRatio(holder))
    return false;
  const double lead = Lead(acceptance, alternative, holder);
  if (lead > 0.0 && with_alternative.description_gain > with_holder.description_gain) return true;
  const double texture = alternative.texture - holder.texture;
  if (std::abs(texture) > acceptance.clear_texture) return lead > 0.0 && texture > 0.0;
  return alternative.object == holder.object && lead > acceptance.clear_lead;
}

// What may stand in the place of an accepted object, which comes first: its near symmetries and
// placements that share its volume, none twice.
std::vector<PlacedObject> ObjectsForPlace(const JointContext& context,
                                          std::span<const PlacedObject> placements,
                                          const PlacedObject& accepted) {
  const AlternativeAcceptance& options = context.options.acceptance.alternatives;
  const PreparedObject& object = *context.objects[accepted.object];
  std::vector<PlacedObject> tried;
  const auto add = [&](const PlacedObject& p) {
    const PreparedObject& other = *context.objects[p.object];
    if (p.object == accepted.object &&
        IsSamePose(object, accepted.scene_from_object, p.scene_from_object, kSamePlacement)) {
      return;
    }
    if (std::none_of(tried.begin(), tried.end(), [&](const PlacedObject& t) {
          return t.object == p.object &&
                 IsSamePose(other, t.scene_from_object, p.scene_from_object, kSamePlacement);
        })) {
      tried.push_back(p);
    }
  };
  for (const Rigid3& turn : NearSymmetries(object, options.misfit_diameters)) {
    PlacedObject p = accepted;
    p.scene_from_object = accepted.scene_from_object * turn;
    add(p);
  }
  for (const PlacedObject& p : placements) {
    if (p.score < accepted.score - options.max_score_deficit) continue;
    if (SharedVolume(
            object, accepted.scene_from_object, *context.objects[p.object], p.scene_from_object) >=
        options.min_shared_volume) {
      add(p);
    }
  }
  if (static_cast<int>(tried.size()) > options.most_per_object)
    tried.resize(options.most_per_object);
  // The accepted object through the same refinement as its alternatives.
  tried.insert(tried.begin(), accepted);
  return tried;
}

}  // namespace

std::vector<Rigid3> NearSymmetries(const PreparedObject& object, double misfit_diameters) {
  std::vector<Rigid3> out;
  const Eigen::Vector3d axes[3] = {
      Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY(), Eigen::Vector3d::UnitZ()};
  for (int up = 0; up < 6; ++up) {
    // First one of six faces up, then a quarter about it.
    const Eigen::Matrix3d first =
        up < 4 ? Eigen::AngleAxisd(up * kHalfPi, axes[0]).toRotationMatrix()
               : Eigen::AngleAxisd((up == 4 ? 1 : -1) * kHalfPi, axes[1]).toRotationMatrix();
    for (int quarter = 0; quarter < 4; ++quarter) {
      const Eigen::Matrix3d R =
          first * Eigen::AngleAxisd(quarter * kHalfPi, axes[2]).toRotationMatrix();
      const Rigid3 turn = About(object.center, R);
      if (IsSamePose(object, Rigid3{}, turn, kSamePlacement)) continue;
      if (std::any_of(out.begin(), out.end(), [&](const Rigid3& o) {
            return IsSamePose(object, o, turn, kSamePlacement);
          })) {
        continue;
      }
      if (Fits(object, turn, misfit_diameters * object.model.diameter_m)) out.push_back(turn);
    }
  }
  return out;
}

std::vector<Alternative> ContestObjects(const JointContext& context,
                                        const SurfaceImages* images,
                                        std::span<const PlacedObject> placements,
                                        SceneModel* scene) {
  const AlternativeAcceptance& options = context.options.acceptance.alternatives;
  std::vector<Alternative> out;
  for (int place = 0; place < static_cast<int>(scene->objects.size()); ++place) {
    const PlacedObject accepted = scene->objects[place];
    const std::vector<PlacedObject> tried = ObjectsForPlace(context, placements, accepted);
    if (tried.size() < 2) continue;
    std::vector<std::optional<SceneModel>> trials(tried.size());
    ParallelFor(static_cast<int>(tried.size()), context.options.threads, [&](int i) {
      if (!IsStopRequested(context.stop))
        trials[i] = WithAlternative(context, images, *scene, place, tried[i]);
    });
    std::size_t best = 0;
    for (std::size_t i = 1; i < trials.size() && trials[0]; ++i) {
      if (!trials[i]) continue;
      if (Leads(options, *trials[i], *trials[best], place) &&
          !Harms(options, *scene, *trials[i], place)) {
        best = i;
      }
    }
    if (!trials[best]) continue;
    const PlacedObject winner = trials[best]->objects[place];
    for (std::size_t i = 0; i < trials.size(); ++i) {
      if (i == best || !trials[i]) continue;
      const PlacedObject& placed = trials[i]->objects[place];
      // Refined into the winner's place it is none.
      if (placed.object == winner.object && IsSamePose(*context.objects[placed.object],
                                                       placed.scene_from_object,
                                                       winner.scene_from_object,
                                                       kSamePlacement)) {
        continue;
      }
      out.push_back({place,
                     placed,
                     winner.score + Lead(options, placed, winner),
                     trials[i]->description_gain});
    }
    if (best > 0) *scene = *std::move(trials[best]);
  }
  return out;
}

}  // namespace horopter
