#include "client/bop_evaluate.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include "absl/strings/str_cat.h"
#include "client/ply_vertices.h"
#include "client/units.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/lens_model.h"

namespace horopter {
namespace {

constexpr double kMatchPx = 50.0;
constexpr double kReferenceWidth = 640.0;
constexpr int kThresholds = 10;  // 0.05, 0.10 .. 0.50 of the diameter; 5, 10 .. 50 px

struct EvaluatedObject {
  std::vector<Eigen::Vector3d> points;  // metres
  std::vector<Rigid3> symmetries;       // with the identity
  double diameter_m = 0.0;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
};

// Raw figures of one scene or of several.
struct Samples {
  std::vector<double> mspd, mssd, recall_10px, own_10px, precision, rel_mm, rel_deg, focal_error,
      seconds;
  std::vector<BopScoredEstimate> estimates;
  int scenes = 0;

  void Append(const Samples& other) {
    const auto add = [](std::vector<double>& to, const std::vector<double>& from) {
      to.insert(to.end(), from.begin(), from.end());
    };
    add(mspd, other.mspd);
    add(mssd, other.mssd);
    add(recall_10px, other.recall_10px);
    add(own_10px, other.own_10px);
    add(precision, other.precision);
    add(rel_mm, other.rel_mm);
    add(rel_deg, other.rel_deg);
    add(focal_error, other.focal_error);
    add(seconds, other.seconds);
    scenes += other.scenes;
  }
};

double Mean(const std::vector<double>& x) {
  if (x.empty()) return std::numeric_limits<double>::quiet_NaN();
  double sum = 0.0;
  for (const double v : x) sum += v;
  return sum / static_cast<double>(x.size());
}

double Median(std::vector<double> x) {
  if (x.empty()) return std::numeric_limits<double>::quiet_NaN();
  std::sort(x.begin(), x.end());
  const size_t n = x.size();
  return n % 2 == 1 ? x[n / 2] : 0.5 * (x[n / 2 - 1] + x[n / 2]);
}

// Average recall of one error: the share of the thresholds it stays below.
double Recall(double error, double scale) {
  int below = 0;
  for (int i = 1; i <= kThresholds; ++i) below += error < scale * 0.05 * i;
  return static_cast<double>(below) / kThresholds;
}

// K, which may have skew, and the distortion in front of it.
struct Lens {
  Eigen::Matrix3d K = Eigen::Matrix3d::Identity();
  LensModel distortion;  // fx = fy = 1, cx = cy = 0
};

Lens LensOf(const Eigen::Matrix3d& K, const std::vector<double>& distortion) {
  Lens lens{K, {}};
  std::array<double, 5>& k = lens.distortion.coefficients;
  std::copy_n(distortion.begin(), std::min(k.size(), distortion.size()), k.begin());
  return lens;
}

Eigen::Vector2d Project(const Lens& lens, const Eigen::Vector3d& p) {
  if (p.z() <= 0.0) return {1e6, 1e6};
  return (lens.K * DistortedPixel(lens.distortion, p.hnormalized()).homogeneous()).head<2>();
}

// Of the estimate seen by one camera and the truth seen by another.
double Mspd(const Rigid3& estimate,
            const Lens& of_estimate,
            const Rigid3& truth,
            const Lens& of_truth,
            const EvaluatedObject& object) {
  double best = std::numeric_limits<double>::infinity();
  for (const Rigid3& s : object.symmetries) {
    const Rigid3 g = truth * s;
    double worst = 0.0;
    for (const Eigen::Vector3d& p : object.points) {
      worst = std::max(
          worst, (Project(of_estimate, estimate * p) - Project(of_truth, g * p)).squaredNorm());
    }
    best = std::min(best, worst);
  }
  return std::sqrt(best);
}

double Mssd(const Rigid3& estimate, const Rigid3& truth, const EvaluatedObject& object) {
  double best = std::numeric_limits<double>::infinity();
  for (const Rigid3& s : object.symmetries) {
    const Rigid3 g = truth * s;
    double worst = 0.0;
    for (const Eigen::Vector3d& p : object.points) {
      worst = std::max(worst, (estimate * p - g * p).squaredNorm());
    }
    best = std::min(best, worst);
  }
  return std::sqrt(best);
}

// Rotations from files are rounded, symmetries to four digits: the inverse, not the transpose,
// keeps the figures equal to those of the BOP tools.
Rigid3 TrueInverse(const Rigid3& a_from_b) {
  const Eigen::Matrix3d inverse = a_from_b.R.inverse();
  return {inverse, -(inverse * a_from_b.t)};
}

struct RelativeError {
  double mm = 0.0;
  double deg = 0.0;
};

// Error of the pose of object y relative to object x, at y's centre, for the best pair of
// symmetries.
RelativeError RelativePoseError(const Rigid3& estimate_x,
                                const Rigid3& estimate_y,
                                const Rigid3& truth_x,
                                const Rigid3& truth_y,
                                const EvaluatedObject& x,
                                const EvaluatedObject& y) {
  const Rigid3 rel = TrueInverse(estimate_x) * estimate_y;
  RelativeError best{1e300, 0.0};
  for (const Rigid3& sx : x.symmetries) {
    for (const Rigid3& sy : y.symmetries) {
      const Rigid3 g = TrueInverse(truth_x * sx) * (truth_y * sy);
      const double mm = kMmPerMetre * (rel * y.centre - g * y.centre).norm();
      const double cosine = ((rel.R.transpose() * g.R).trace() - 1.0) / 2.0;
      const double deg = std::acos(std::clamp(cosine, -1.0, 1.0)) * 180.0 / M_PI;
      if (mm + deg < best.mm + best.deg) best = {mm, deg};
    }
  }
  return best;
}

struct Match {
  Rigid3 estimate;
  double mspd_px = 0.0;  // by the true camera, without its lens
  double own_px = 0.0;   // the estimate by the camera of its answer, the truth by the true one
};

// Greedy matching of one image, best score first. own: of the answer; without one the true camera.
std::map<size_t, Match> MatchImage(const BopImage& image,
                                   std::vector<const BopEstimate*> estimates,
                                   const std::map<int, EvaluatedObject>& objects,
                                   const std::optional<Lens>& own,
                                   Samples& samples) {
  const double width = image.camera.width > 0 ? image.camera.width : kReferenceWidth;
  const Lens pinhole{image.K, {}}, lens = LensOf(image.K, image.distortion);
  std::stable_sort(estimates.begin(), estimates.end(), [](const auto* a, const auto* b) {
    return a->score > b->score;
  });
  std::map<size_t, Match> matches;
  for (const BopEstimate* e : estimates) {
    Match best;
    double least = std::numeric_limits<double>::infinity();
    size_t best_instance = 0;
    for (size_t j = 0; j < image.instances.size(); ++j) {
      const BopInstance& truth = image.instances[j];
      if (truth.obj_id != e->obj_id || matches.contains(j)) continue;
      const EvaluatedObject& object = objects.at(e->obj_id);
      const Rigid3 &estimate = e->camera_from_object, &pose = truth.camera_from_object;
      const double to_reference = kReferenceWidth / width;
      Match match{estimate, to_reference * Mspd(estimate, pinhole, pose, pinhole, object), 0.0};
      match.own_px = own ? to_reference * Mspd(estimate, *own, pose, lens, object) : match.mspd_px;
      const double px = std::min(match.mspd_px, match.own_px);
      if (px < least) {
        least = px;
        best = match;
        best_instance = j;
      }
    }
    if (least < kMatchPx) matches[best_instance] = best;
    samples.precision.push_back(least < kMatchPx ? 1.0 : 0.0);
    const double own_px = std::isfinite(least) ? best.own_px : least;
    samples.estimates.push_back({image.im_id, e->obj_id, e->score, least < kMatchPx, own_px});
  }
  return matches;
}

void EvaluateImage(const BopImage& image,
                   const std::vector<const BopEstimate*>& estimates,
                   const std::map<int, EvaluatedObject>& objects,
                   const std::optional<Lens>& own,
                   double min_visib,
                   Samples& samples) {
  const std::map<size_t, Match> matches = MatchImage(image, estimates, objects, own, samples);
  for (size_t j = 0; j < image.instances.size(); ++j) {
    const BopInstance& truth = image.instances[j];
    if (truth.visib_fract < min_visib) continue;
    double px = 1e9, own_px = 1e9, share = 1e9;
    if (const auto it = matches.find(j); it != matches.end()) {
      const EvaluatedObject& object = objects.at(truth.obj_id);
      px = it->second.mspd_px;
      own_px = it->second.own_px;
      share = Mssd(it->second.estimate, truth.camera_from_object, object) / object.diameter_m;
    }
    samples.mspd.push_back(Recall(px, 100.0));
    samples.mssd.push_back(Recall(share, 1.0));
    samples.recall_10px.push_back(px < 10.0 ? 1.0 : 0.0);
    samples.own_10px.push_back(own_px < 10.0 ? 1.0 : 0.0);
  }
  for (const auto& [x, mx] : matches) {
    for (const auto& [y, my] : matches) {
      if (x == y) continue;
      const BopInstance &tx = image.instances[x], &ty = image.instances[y];
      const RelativeError error = RelativePoseError(mx.estimate,
                                                    my.estimate,
                                                    tx.camera_from_object,
                                                    ty.camera_from_object,
                                                    objects.at(tx.obj_id),
                                                    objects.at(ty.obj_id));
      samples.rel_mm.push_back(error.mm);
      samples.rel_deg.push_back(error.deg);
    }
  }
}

absl::StatusOr<std::map<int, EvaluatedObject>> LoadObjects(const BopDataset& dataset) {
  std::map<int, EvaluatedObject> objects;
  for (const BopObject& o : dataset.objects) {
    if (o.mesh_path.empty() || !o.in_models_info) {
      return absl::InvalidArgumentError(
          absl::StrCat(dataset.folder,
                       ": object ",
                       o.obj_id,
                       " needs models/*.ply and an entry in models/models_info.json"));
    }
    EvaluatedObject& object = objects[o.obj_id];
    HOROPTER_ASSIGN_OR_RETURN(object.points, ReadPlyVertices(o.mesh_path));
    Eigen::AlignedBox3d box;
    for (Eigen::Vector3d& p : object.points) {
      p /= kMmPerMetre;
      box.extend(p);
    }
    object.centre = box.center();
    object.diameter_m = o.diameter_m;
    object.symmetries = {Rigid3{}};
    object.symmetries.insert(object.symmetries.end(), o.symmetries.begin(), o.symmetries.end());
  }
  return objects;
}

BopScores Summarize(const Samples& s) {
  BopScores scores;
  scores.scenes = s.scenes;
  scores.targets = static_cast<int>(s.mspd.size());
  scores.ar_mspd = Mean(s.mspd);
  scores.ar_mssd = Mean(s.mssd);
  scores.ar = (scores.ar_mspd + scores.ar_mssd) / 2.0;
  scores.recall_10px = Mean(s.recall_10px);
  scores.own_10px = Mean(s.own_10px);
  scores.precision = Mean(s.precision);
  scores.rel_mm = Median(s.rel_mm);
  scores.rel_deg = Median(s.rel_deg);
  scores.focal_error = Median(s.focal_error);
  scores.seconds_per_set = Median(s.seconds);
  return scores;
}

// The camera that an answer gives an image.
std::optional<Lens> OwnCamera(const BopResults& results, int scene_id, int im_id) {
  const auto cameras = results.cameras.find(scene_id);
  if (cameras == results.cameras.end()) return std::nullopt;
  const auto camera = cameras->second.find(im_id);
  if (camera == cameras->second.end()) return std::nullopt;
  std::vector<double> distortion;  // none is given where there is none
  if (const auto of_scene = results.distortions.find(scene_id);
      of_scene != results.distortions.end()) {
    if (const auto it = of_scene->second.find(im_id); it != of_scene->second.end())
      distortion = it->second;
  }
  return LensOf(camera->second, distortion);
}

Samples EvaluateScene(const BopScene& scene,
                      const BopResults& results,
                      const std::map<int, EvaluatedObject>& objects,
                      double min_visib) {
  Samples samples;
  samples.scenes = 1;
  std::map<int, std::vector<const BopEstimate*>> by_image;
  double seconds = -1.0;
  for (const BopEstimate& e : results.estimates) {
    if (e.scene_id != scene.scene_id) continue;
    by_image[e.im_id].push_back(&e);
    seconds = e.time_s;
  }
  if (seconds >= 0.0) samples.seconds.push_back(seconds);
  for (const BopImage& image : scene.images) {
    if (image.camera.focal_px <= 0.0) continue;  // not in scene_camera.json
    const std::optional<Lens> own = OwnCamera(results, scene.scene_id, image.im_id);
    EvaluateImage(image, by_image[image.im_id], objects, own, min_visib, samples);
    if (own) samples.focal_error.push_back(std::abs(own->K(0, 0) / image.K(0, 0) - 1.0));
  }
  return samples;
}

}  // namespace

absl::StatusOr<BopEvaluation> EvaluateBopResults(const BopDataset& dataset,
                                                 const std::string& split,
                                                 const BopResults& results,
                                                 const BopEvaluateOptions& options) {
  HOROPTER_ASSIGN_OR_RETURN(const auto objects, LoadObjects(dataset));
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<int> scene_ids, ListBopScenes(dataset.folder, split));
  BopEvaluation evaluation;
  std::map<std::string, Samples> tiers;
  Samples all;
  for (const int id : scene_ids) {
    if (!options.scenes.empty() && !options.scenes.contains(id)) continue;
    HOROPTER_ASSIGN_OR_RETURN(const BopScene scene, ReadBopScene(dataset.folder, split, id));
    if (!scene.has_ground_truth) {
      return absl::InvalidArgumentError(
          absl::StrCat(scene.folder, ": has no scene_gt.json to score against"));
    }
    for (const BopImage& image : scene.images) {
      for (const BopInstance& i : image.instances) {
        if (objects.contains(i.obj_id)) continue;
        return absl::InvalidArgumentError(
            absl::StrCat(scene.folder, "/scene_gt.json: unknown object ", i.obj_id));
      }
    }
    const Samples samples = EvaluateScene(scene, results, objects, options.min_visib);
    tiers[scene.tier].Append(samples);
    all.Append(samples);
    int wrong = 0;
    for (const double p : samples.precision) wrong += p == 0.0;
    evaluation.scenes[id] = {scene.tier,
                             Summarize(samples),
                             wrong,
                             samples.estimates,
                             samples.rel_mm,
                             samples.rel_deg,
                             samples.focal_error};
  }
  for (const auto& [tier, samples] : tiers) evaluation.tiers[tier] = Summarize(samples);
  evaluation.all = Summarize(all);
  return evaluation;
}

}  // namespace horopter
