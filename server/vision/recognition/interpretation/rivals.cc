#include "server/vision/recognition/interpretation/rivals.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/scene/scene_refine.h"
#include "server/vision/recognition/scene/surface_texture.h"

namespace horopter {
namespace {

constexpr double kSameTurnRad = 0.25;
constexpr double kSameShift = 0.1;       // diameters
constexpr double kHarm = 0.1;            // of score
constexpr double kTextureWeight = 0.05;  // score per unit of log odds
// Difference in texture (log odds) that decides alone: shadow and what stands before a plain part
// say as much by chance as less.
constexpr double kClearTexture = 3.5;
// Lead in score that decides between two poses of one object, whatever they gain: gain prices
// predicted edges that are not seen, and the pose that shows a pocket predicts more of them.
constexpr double kClearLead = 0.01;
constexpr double kSharpnessWeight = 0.2;  // score per unit of sharpness, between such poses
constexpr double kHalfPi = 1.5707963267948966;

// The turn about the object's centre.
Rigid3 About(const Eigen::Vector3d& center, const Eigen::Matrix3d& R) {
  return {R, center - R * center};
}

bool SamePose(const PreparedObject& object, const Rigid3& a, const Rigid3& b) {
  const auto close = [&](const Rigid3& x) {
    const double c = 0.5 * ((x.R.transpose() * b.R).trace() - 1.0);
    return c > std::cos(kSameTurnRad) &&
           (x * object.center - b * object.center).norm() < kSameShift * object.model.diameter_m;
  };
  if (close(a)) return true;
  return std::any_of(object.model.symmetries.begin(),
                     object.model.symmetries.end(),
                     [&](const Rigid3& s) { return close(a * s); });
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
std::optional<SceneModel> WithRival(const JointContext& context,
                                    const SceneModel& scene,
                                    int place,
                                    const PlacedObject& rival) {
  SceneModel trial = scene;
  trial.objects[place].object = rival.object;
  trial.objects[place].scene_from_object = rival.scene_from_object;
  SceneRefineOptions refine;
  refine.start_reach_px = 12.0;
  for (int pass = 0; pass < 2; ++pass) {
    if (!RefineScene(context, refine, &trial)) return std::nullopt;
    refine.start_reach_px = 8.0;
  }
  EvaluateTogether(context, &trial);
  JudgeTexture(context, place, &trial);
  return trial;
}

// Whether another object than the one in question loses its support.
bool Harms(const SceneModel& scene, const SceneModel& trial, int place) {
  for (std::size_t k = 0; k < scene.objects.size(); ++k) {
    if (static_cast<int>(k) != place && trial.objects[k].score < scene.objects[k].score - kHarm)
      return true;
  }
  return false;
}

// By how much score a rival leads what holds the place, less than 0: it does not. Sharpness tells
// poses of one object apart, of different objects their gain must (Leads).
double Lead(const PlacedObject& rival, const PlacedObject& held) {
  double lead = rival.score - held.score;
  if (rival.object == held.object)
    lead += kSharpnessWeight * (rival.total.Sharpness() - held.total.Sharpness());
  const double texture = rival.texture - held.texture;
  if (std::abs(texture) > kClearTexture || rival.object != held.object)
    lead += kTextureWeight * texture;
  return lead;
}

// Whether the rival of one scene leads what holds the place in the other.
bool Leads(const SceneModel& with_rival, const SceneModel& with_held, int place) {
  const PlacedObject &rival = with_rival.objects[place], &held = with_held.objects[place];
  // A look-alike may show as many edges, but not as sharply.
  if (rival.object != held.object && EvidenceOf(rival) <= EvidenceOf(held)) return false;
  const double lead = Lead(rival, held);
  if (lead > 0.0 && with_rival.gain > with_held.gain) return true;
  const double texture = rival.texture - held.texture;
  if (std::abs(texture) > kClearTexture) return lead > 0.0 && texture > 0.0;
  return rival.object == held.object && lead > kClearLead;
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
      if (SamePose(object, Rigid3{}, turn)) continue;
      if (std::any_of(
              out.begin(), out.end(), [&](const Rigid3& o) { return SamePose(object, o, turn); })) {
        continue;
      }
      if (Fits(object, turn, misfit_diameters * object.model.diameter_m)) out.push_back(turn);
    }
  }
  return out;
}

std::vector<Rival> ContestObjects(const JointContext& context,
                                  std::span<const PlacedObject> placements,
                                  const RivalOptions& options,
                                  SceneModel* scene) {
  std::vector<Rival> out;
  for (int place = 0; place < static_cast<int>(scene->objects.size()); ++place) {
    const PlacedObject accepted = scene->objects[place];
    const PreparedObject& object = *context.objects[accepted.object];
    std::vector<PlacedObject> tried;
    const auto add = [&](const PlacedObject& p) {
      const PreparedObject& other = *context.objects[p.object];
      if (p.object == accepted.object &&
          SamePose(object, accepted.scene_from_object, p.scene_from_object)) {
        return;
      }
      if (std::none_of(tried.begin(), tried.end(), [&](const PlacedObject& t) {
            return t.object == p.object &&
                   SamePose(other, t.scene_from_object, p.scene_from_object);
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
      if (SharedVolume(object,
                       accepted.scene_from_object,
                       *context.objects[p.object],
                       p.scene_from_object) >= options.min_shared_volume) {
        add(p);
      }
    }
    if (static_cast<int>(tried.size()) > options.most_per_object)
      tried.resize(options.most_per_object);
    if (tried.empty()) continue;
    // The accepted object through the same refinement as its rivals.
    tried.insert(tried.begin(), accepted);
    std::vector<std::optional<SceneModel>> trials(tried.size());
    ParallelFor(static_cast<int>(tried.size()), context.options.threads, [&](int i) {
      if (!IsStopRequested(context.stop)) trials[i] = WithRival(context, *scene, place, tried[i]);
    });
    std::size_t best = 0;
    for (std::size_t i = 1; i < trials.size() && trials[0]; ++i) {
      if (!trials[i]) continue;
      if (Leads(*trials[i], *trials[best], place) && !Harms(*scene, *trials[i], place)) {
        best = i;
      }
    }
    if (!trials[best]) continue;
    const PlacedObject winner = trials[best]->objects[place];
    for (std::size_t i = 0; i < trials.size(); ++i) {
      if (i == best || !trials[i]) continue;
      const PlacedObject& placed = trials[i]->objects[place];
      // Refined into the winner's place it is none.
      if (placed.object == winner.object && SamePose(*context.objects[placed.object],
                                                     placed.scene_from_object,
                                                     winner.scene_from_object)) {
        continue;
      }
      out.push_back({place, placed, winner.score + Lead(placed, winner), trials[i]->gain});
    }
    if (best > 0) *scene = *std::move(trials[best]);
  }
  return out;
}

}  // namespace horopter
