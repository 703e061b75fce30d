#include "server/vision/recognition/aspect_scenes/standing_search.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_scenes/object_on_plane.h"
#include "server/vision/recognition/aspect_scenes/standing_grid.h"
#include "server/vision/recognition/aspect_scenes/standing_ground.h"

namespace horopter {
namespace {

constexpr double kLastReachShare = 0.04;  // of the size: how far an edge may lie at last
constexpr int kJudgedPerObject = 300;     // places and turns that are looked at with all points
constexpr int kClimbedPerObject = 60;     // ... and improved at first
constexpr int kKeptPerObject = 4;         // places that are answered
constexpr double kApartShare = 0.35;      // of the diameter: places that are not improved twice
constexpr double kApartRad = 0.45;        // ... unless turned by more
constexpr int kClimbs = 4;                // rounds, each with half the steps
constexpr double kLastClimbed = 12;       // places in the last
constexpr double kNextPlace = 0.02;       // of support

// Uphill from a place: one step each way, edges within `share` of the size.
void Climb(const ObjectOnPlane& object, double step, double turn, double share, StandingPlace* p) {
  p->support = object.Judge(*p, share);
  for (const auto [dx, dy, dyaw] : {std::array{step, 0.0, 0.0},
                                    std::array{-step, 0.0, 0.0},
                                    std::array{0.0, step, 0.0},
                                    std::array{0.0, -step, 0.0},
                                    std::array{0.0, 0.0, turn},
                                    std::array{0.0, 0.0, -turn}}) {
    StandingPlace moved = *p;
    moved.x += dx;
    moved.y += dy;
    moved.yaw += dyaw;
    moved.support = object.Judge(moved, share);
    if (moved.support > p->support) *p = moved;
  }
}

// The best first, no two alike.
std::vector<StandingPlace> Apart(const ObjectOnPlane& object,
                                 std::vector<StandingPlace> list,
                                 int count) {
  std::stable_sort(list.begin(), list.end(), [](const StandingPlace& a, const StandingPlace& b) {
    return a.support > b.support;
  });
  std::vector<StandingPlace> out;
  for (const StandingPlace& p : list) {
    if (static_cast<int>(out.size()) >= count) break;
    const bool known = std::any_of(out.begin(), out.end(), [&](const StandingPlace& o) {
      return o.face == p.face &&
             std::abs(std::remainder(o.yaw - p.yaw, object.faces()[p.face].yaw_range)) <
                 kApartRad &&
             std::hypot(o.x - p.x, o.y - p.y) < kApartShare * object.diameter_m();
    });
    if (!known) out.push_back(p);
  }
  return out;
}

std::vector<StandingPlace> SearchModel(const ObjectOnPlane& object, const StopRequested& stop) {
  std::vector<StandingPlace> found;
  for (std::size_t f = 0; f < object.faces().size(); ++f) {
    if (IsStopRequested(stop)) break;
    const std::vector<StandingPlace> on_face = SearchFace(object, static_cast<int>(f), stop);
    found.insert(found.end(), on_face.begin(), on_face.end());
  }
  // Steps halve while edges may lie less far, and of the places fewer and fewer are left.
  double step = kStandingStepShare * object.diameter_m(), turn = kStandingYawStepRad;
  double share = kStandingReachShare;
  const double narrower = std::pow(kLastReachShare / kStandingReachShare, 1.0 / kClimbs);
  found = Apart(object, std::move(found), kJudgedPerObject);
  for (StandingPlace& p : found) p.support = object.Judge(p, share);
  double most = kClimbedPerObject;
  const double fewer = std::pow(kLastClimbed / most, 1.0 / (kClimbs - 1));
  for (int round = 0; round < kClimbs; ++round) {
    found = Apart(object, std::move(found), static_cast<int>(most));
    step *= 0.5;
    turn *= 0.5;
    share *= narrower;
    most *= fewer;
    for (StandingPlace& p : found) {
      if (IsStopRequested(stop)) break;
      Climb(object, step, turn, share, &p);
    }
  }
  return Apart(object, std::move(found), kKeptPerObject);
}

}  // namespace

std::vector<StandingCandidate> FindStanding(
    std::span<const AspectImage> images,
    const std::vector<std::optional<AspectSceneView>>& views,
    std::span<const AspectModel> models,
    const StandingPlane& plane,
    std::span<const AspectSceneObject> taken,
    int threads,
    const StopRequested& stop) {
  const StandingGround ground = MakeGround(images, views, plane, taken, models, threads);
  if (ground.images.size() < 2 || !((ground.high - ground.low).array() > 0.0).all()) return {};
  std::vector<std::vector<StandingCandidate>> of_model(models.size());
  ParallelFor(static_cast<int>(models.size()), threads, [&](int p) {
    const ObjectOnPlane object(ground, models[p]);
    for (const StandingPlace& found : SearchModel(object, stop))
      of_model[p].push_back({{p, object.PoseOf(found)}, found.support});
  });
  // A part's second place comes after another part's first that is nearly as good.
  std::vector<std::pair<double, StandingCandidate>> ranked;
  for (const auto& list : of_model) {
    for (std::size_t i = 0; i < list.size(); ++i)
      ranked.emplace_back(list[i].support - kNextPlace * static_cast<double>(i), list[i]);
  }
  std::stable_sort(
      ranked.begin(), ranked.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<StandingCandidate> out;
  for (auto& [rank, candidate] : ranked) out.push_back(candidate);
  return out;
}

}  // namespace horopter
