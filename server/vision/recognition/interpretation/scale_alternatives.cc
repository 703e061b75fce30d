#include "server/vision/recognition/interpretation/scale_alternatives.h"

#include <Eigen/Eigenvalues>
#include <algorithm>

#include "absl/strings/str_format.h"
#include "server/vision/invariants/look_alike.h"
#include "server/vision/recognition/interpretation/aspect_answer.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

constexpr double kSameSpread = 0.03;  // between spreads of corners, as shares of the largest one

// Deviations of the corners along their main axes, descending; as shares of the largest one.
Eigen::Vector3d SpreadOf(const ObjectModel& model) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& v : model.vertices) mean += v;
  mean /= static_cast<double>(model.vertices.size());
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3d& v : model.vertices) covariance += (v - mean) * (v - mean).transpose();
  const Eigen::Vector3d values =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(covariance).eigenvalues();
  const Eigen::Vector3d spread = values.reverse().cwiseMax(0.0).cwiseSqrt();
  return spread / std::max(spread[0], 1e-12);
}

// Size of b against a's, where it is the same shape in another size or the same one; 0: it is not.
double SizeOf(const ObjectModel& b, const ObjectModel& a, const Eigen::Vector3d& spread_of_a) {
  // Cheap tests first: catalogs are large.
  if (b.vertices.size() != a.vertices.size() ||
      (SpreadOf(b) - spread_of_a).cwiseAbs().maxCoeff() > kSameSpread)
    return 0.0;
  LookAlikeOptions options;
  options.projective = false;
  const auto found = FindLookAlike(a, b, options);
  if (!found ||
      (found->kind != LookAlikeKind::kCongruent && found->kind != LookAlikeKind::kSimilar) ||
      !found->only_in_a.empty() || !found->only_in_b.empty())
    return 0.0;
  return found->stretch.mean();
}

}  // namespace

void SayScaleAlternatives(const JointContext& context, RecognitionResult* result) {
  if (result->objects.size() != 1) return;
  SceneObject& answer = result->objects.front();
  const ObjectModel& model = context.objects[answer.object]->model;
  if (model.vertices.empty()) return;
  const Eigen::Vector3d spread = SpreadOf(model);
  for (int k = 0; k < static_cast<int>(context.objects.size()); ++k) {
    if (k == answer.object) continue;
    const ObjectModel& other = context.objects[k]->model;
    const double size = SizeOf(other, model, spread);
    if (size == 0.0) continue;
    AddAlternative(k, &answer, result);
    SceneAlternative& a = answer.left_open.emplace_back();
    a.kind = AlternativeKind::kSize;
    a.object = k;
    Tell(absl::StrFormat("%s: alone it looks like %s, which is %.1f %% of its size",
                         model.id,
                         other.id,
                         100.0 * size),
         result);
  }
}

}  // namespace horopter
