#include "server/pipeline/expected_parts.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/vision/geometry/plucker_line.h"

namespace horopter {
namespace {

constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;
// A part is in another's place when its middle is this near to where the other's should be, of
// the other's radius.
constexpr double kInPlaceRadii = 0.5;
// A part hides what is behind the inner part of the ball about it.
constexpr double kHidingRadii = 0.5;

// One part to be found.
struct Item {
  int expected = 0;
  bool has_place = false;
  std::optional<Rigid3> scene_from_object;  // as expected; empty: anywhere, or no frame
  int frame_part = -1;                      // whose frame it is; -1: the base
  int found = -1;
  bool wrong = false;  // `found` is another's part
};

const KnownShape& ShapeOf(const ExpectedScene& scene, const std::string& id) {
  static const KnownShape& unknown = *new KnownShape;
  const auto at = scene.shapes.find(id);
  return at == scene.shapes.end() ? unknown : at->second;
}

int BestOf(const ExpectedScene& scene, const std::string& id) {
  int best = -1;
  for (int k = 0; k < static_cast<int>(scene.parts.size()); ++k) {
    if (scene.parts[k].object_id == id &&
        (best < 0 || scene.parts[k].score > scene.parts[best].score))
      best = k;
  }
  return best;
}

std::vector<Item> ItemsOf(const std::vector<ExpectedPart>& expected, const ExpectedScene& scene) {
  std::vector<Item> out;
  for (std::size_t e = 0; e < expected.size(); ++e) {
    Item item;
    item.expected = static_cast<int>(e);
    if (expected[e].frame_from_object) {
      item.has_place = true;
      if (expected[e].frame_object.empty()) {
        if (scene.base_from_scene)
          item.scene_from_object =
              scene.base_from_scene->Inverse() * *expected[e].frame_from_object;
      } else if (item.frame_part = BestOf(scene, expected[e].frame_object); item.frame_part >= 0) {
        item.scene_from_object =
            scene.parts[item.frame_part].scene_from_object * *expected[e].frame_from_object;
      }
    }
    out.insert(out.end(), static_cast<std::size_t>(std::max(1, expected[e].count)), item);
  }
  return out;
}

struct Deviation {
  double distance_m = 0.0;
  double rotation_rad = 0.0;
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();  // scene axes
};

// From the nearest of the poses that the part's symmetries make equal.
Deviation DeviationOf(const Rigid3& expected,
                      const Rigid3& found,
                      const std::vector<Rigid3>& symmetries,
                      const ExpectedPart& tolerances) {
  Deviation best;
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t s = 0; s <= symmetries.size(); ++s) {
    const Rigid3 equal = s == 0 ? expected : expected * symmetries[s - 1];
    Deviation d;
    d.direction = found.t - equal.t;
    d.distance_m = d.direction.norm();
    d.rotation_rad = Eigen::AngleAxisd(equal.R.transpose() * found.R).angle();
    const double cost = d.distance_m / tolerances.position_tolerance_m +
                        d.rotation_rad / tolerances.rotation_tolerance_rad;
    if (cost >= least) continue;
    least = cost;
    best = d;
  }
  return best;
}

// P(|x| < limit) of a normal x about `mean`.
double Within(double mean, double sigma, double limit) {
  if (sigma < 1e-12) return mean < limit ? 1.0 : 0.0;
  const auto below = [&](double x) {
    return 0.5 * std::erfc((mean - x) / (sigma * std::sqrt(2.0)));
  };
  return below(limit) - below(-limit);
}

// Of a part's pose against the frame that its place is in, in the scene's axes.
Matrix6d CovarianceInFrame(const ExpectedScene& scene, int part, int frame_part) {
  const auto block = [&](int i, int k) -> Matrix6d {
    if (scene.joint_covariance.size() == 0) return Matrix6d::Zero();
    return scene.joint_covariance.block<6, 6>(6 * i, 6 * k);
  };
  if (frame_part < 0) {
    return scene.covariances_in_base.empty() ? block(part, part) : scene.covariances_in_base[part];
  }
  // What the frame's own error does to the pose of a part in it.
  Matrix6d J = Matrix6d::Identity();
  J.bottomLeftCorner<3, 3>() = -CrossMatrix(scene.parts[part].scene_from_object.t -
                                            scene.parts[frame_part].scene_from_object.t);
  const Matrix6d cross = block(part, frame_part) * J.transpose();
  return block(part, part) + J * block(frame_part, frame_part) * J.transpose() - cross -
         cross.transpose();
}

double WithinTolerances(const Deviation& d, const Matrix6d& covariance, const ExpectedPart& part) {
  const Eigen::Matrix3d place = covariance.bottomRightCorner<3, 3>();
  const double variance = d.distance_m > 1e-9
                              ? d.direction.dot(place * d.direction) / (d.distance_m * d.distance_m)
                              : place.trace() / 3.0;
  const double turn_variance = covariance.topLeftCorner<3, 3>().trace() / 3.0;
  return Within(d.distance_m, std::sqrt(std::max(0.0, variance)), part.position_tolerance_m) *
         Within(
             d.rotation_rad, std::sqrt(std::max(0.0, turn_variance)), part.rotation_tolerance_rad);
}

enum class Step { kInPlace, kOthersInPlace, kElsewhere };

// Cost of taking part k for the item in this step; infinite: not to be done.
double CostOf(const std::vector<ExpectedPart>& expected,
              const ExpectedScene& scene,
              const Item& item,
              int k,
              Step step) {
  constexpr double kNever = std::numeric_limits<double>::infinity();
  const ExpectedPart& wanted = expected[item.expected];
  const FoundPart& part = scene.parts[k];
  const bool same = part.object_id == wanted.object_id;
  if (k == item.frame_part || same == (step == Step::kOthersInPlace)) return kNever;
  if (!item.has_place) return step == Step::kElsewhere ? 1.0 - part.score : kNever;
  if (!item.scene_from_object) return kNever;
  const KnownShape& shape = ShapeOf(scene, wanted.object_id);
  const Eigen::Vector3d middle = *item.scene_from_object * shape.center;
  const double off =
      (part.scene_from_object * ShapeOf(scene, part.object_id).center - middle).norm();
  if (step == Step::kElsewhere) return off;
  // A tray is no part in the place of what should lie in it.
  if (step == Step::kOthersInPlace && part.is_reference) return kNever;
  return off <= std::max(wanted.position_tolerance_m, kInPlaceRadii * shape.radius_m) ? off
                                                                                      : kNever;
}

void MatchNearest(const std::vector<ExpectedPart>& expected,
                  const ExpectedScene& scene,
                  Step step,
                  std::vector<Item>* items,
                  std::vector<bool>* taken) {
  struct Pair {
    double cost;
    std::size_t item;
    int part;
  };
  std::vector<Pair> pairs;
  for (std::size_t i = 0; i < items->size(); ++i) {
    if ((*items)[i].found >= 0) continue;
    for (int k = 0; k < static_cast<int>(scene.parts.size()); ++k) {
      if ((*taken)[k]) continue;
      const double cost = CostOf(expected, scene, (*items)[i], k, step);
      if (std::isfinite(cost)) pairs.push_back({cost, i, k});
    }
  }
  std::stable_sort(
      pairs.begin(), pairs.end(), [](const Pair& a, const Pair& b) { return a.cost < b.cost; });
  for (const Pair& pair : pairs) {
    Item& item = (*items)[pair.item];
    if (item.found >= 0 || (*taken)[pair.part]) continue;
    item.found = pair.part;
    item.wrong = step == Step::kOthersInPlace;
    // What is in another's place may be there, or displaced, for its own.
    (*taken)[pair.part] = !item.wrong;
  }
}

bool IsHidden(const ExpectedScene& scene,
              const Item& item,
              const Eigen::Vector3d& camera,
              const Eigen::Vector3d& point) {
  const Eigen::Vector3d way = point - camera;
  for (int k = 0; k < static_cast<int>(scene.parts.size()); ++k) {
    if (k == item.frame_part) continue;
    const KnownShape& shape = ShapeOf(scene, scene.parts[k].object_id);
    const Eigen::Vector3d middle = scene.parts[k].scene_from_object * shape.center;
    const double along = (middle - camera).dot(way) / way.squaredNorm();
    if (along <= 0.0 || along >= 1.0) continue;
    if ((camera + along * way - middle).norm() < kHidingRadii * shape.radius_m) return true;
  }
  return false;
}

// Images that show the item's place; without a place all that were recovered.
int ImagesOf(const std::vector<ExpectedPart>& expected,
             const ExpectedScene& scene,
             const Item& item) {
  if (!item.has_place) return static_cast<int>(scene.cameras.size());
  const Eigen::Vector3d middle =
      *item.scene_from_object * ShapeOf(scene, expected[item.expected].object_id).center;
  int out = 0;
  for (const SeeingCamera& c : scene.cameras) {
    const Eigen::Vector3d in_camera = c.camera_from_scene * middle;
    if (in_camera.z() <= 0.0) continue;
    const Eigen::Vector2d pixel = Project(c.camera, in_camera);
    if (!(pixel.x() >= 0.0 && pixel.y() >= 0.0 && pixel.x() <= c.camera.width - 1 &&
          pixel.y() <= c.camera.height - 1))
      continue;
    out += !IsHidden(scene, item, c.camera_from_scene.Inverse().t, middle);
  }
  return out;
}

void JudgeMissing(const std::vector<ExpectedPart>& expected,
                  const ExpectedScene& scene,
                  const Item& item,
                  ExpectedOutcome* out) {
  out->cannot_tell = 1.0;
  const std::string& id = expected[item.expected].object_id;
  if (!scene.searched) {
    out->detail = absl::StrCat(id, " was not found, and not all was searched");
    return;
  }
  if (item.has_place && !item.scene_from_object) {
    out->detail = absl::StrCat("the frame of the place of ", id, " is not known");
    return;
  }
  const int images = ImagesOf(expected, scene, item);
  if (images == 0) {
    out->detail = item.has_place ? absl::StrCat("no image shows the place of ", id)
                                 : absl::StrCat(id, " was not found, and no camera was recovered");
    return;
  }
  // There or not there was as likely before the images.
  const double found_share = images > 1 ? kFoundShare : kFoundShareInOneImage;
  out->missing = 1.0 / (2.0 - found_share);
  out->cannot_tell = 1.0 - out->missing;
  out->detail =
      absl::StrCat(id,
                   " was not found",
                   item.has_place ? absl::StrCat("; ", images, " images show its place") : "");
}

ExpectedOutcome JudgeItem(const std::vector<ExpectedPart>& expected,
                          const ExpectedScene& scene,
                          const Item& item) {
  ExpectedOutcome out;
  out.expected = item.expected;
  out.found = item.found;
  const ExpectedPart& wanted = expected[item.expected];
  if (item.found < 0) {
    JudgeMissing(expected, scene, item, &out);
    return out;
  }
  const FoundPart& part = scene.parts[item.found];
  const double score = std::clamp(part.score, 0.0, 1.0);
  out.cannot_tell = 1.0 - score;
  if (item.wrong) {
    out.wrong_part = score;
    out.detail = absl::StrCat(part.object_id, " is in the place of ", wanted.object_id);
    return out;
  }
  if (!item.scene_from_object) {
    out.present = score;
    return out;
  }
  const Deviation d = DeviationOf(*item.scene_from_object,
                                  part.scene_from_object,
                                  ShapeOf(scene, wanted.object_id).symmetries,
                                  wanted);
  out.distance_m = d.distance_m;
  out.rotation_rad = d.rotation_rad;
  out.present =
      score * WithinTolerances(d, CovarianceInFrame(scene, item.found, item.frame_part), wanted);
  out.displaced = score - out.present;
  out.detail = absl::StrFormat("%s is %.1f mm and %.1f degrees from its place",
                               wanted.object_id,
                               1e3 * d.distance_m,
                               kDegreesPerRadian * d.rotation_rad);
  return out;
}

ExpectedState MostProbable(const ExpectedOutcome& o) {
  // Of equals the one that claims least.
  std::pair<double, ExpectedState> best{o.cannot_tell, ExpectedState::kCannotTell};
  for (const auto& [p, state] : {std::pair{o.missing, ExpectedState::kMissing},
                                 std::pair{o.wrong_part, ExpectedState::kWrongPart},
                                 std::pair{o.displaced, ExpectedState::kDisplaced},
                                 std::pair{o.present, ExpectedState::kPresent}}) {
    if (p > best.first) best = {p, state};
  }
  return best.second;
}

}  // namespace

ExpectedReport JudgeExpected(const std::vector<ExpectedPart>& expected,
                             const ExpectedScene& scene) {
  std::vector<Item> items = ItemsOf(expected, scene);
  std::vector<bool> taken(scene.parts.size(), false);
  for (const Step step : {Step::kInPlace, Step::kOthersInPlace, Step::kElsewhere})
    MatchNearest(expected, scene, step, &items, &taken);
  ExpectedReport out;
  for (const Item& item : items) {
    ExpectedOutcome& outcome = out.outcomes.emplace_back(JudgeItem(expected, scene, item));
    outcome.state = MostProbable(outcome);
    out.all_present *= outcome.present;
    if (item.frame_part >= 0) taken[item.frame_part] = true;
  }
  for (int k = 0; k < static_cast<int>(taken.size()); ++k) {
    if (!taken[k] && !scene.parts[k].is_reference) out.unexpected.push_back(k);
  }
  return out;
}

}  // namespace horopter
