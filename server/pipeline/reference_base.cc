#include "server/pipeline/reference_base.h"

#include <algorithm>
#include <limits>
#include <map>
#include <optional>
#include <string>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/pipeline/answer.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

// References contradict a scene when they miss it by more than its covariance allows
// (0.1 % of chi square with six degrees of freedom) and by more than this.
constexpr double kGapChiSquare = 22.46;
constexpr double kGapRad = 0.0087;
constexpr double kGapM = 0.002;
// More hypotheses are not compared with each other: the base is open then.
constexpr std::size_t kMostHypotheses = 256;
constexpr std::size_t kMostAlternatives = 64;

struct Hypothesis {
  std::size_t reference = 0;  // index into the references
  std::size_t object = 0;     // of the answer
  int symmetry = 0;
  Rigid3 base_from_object;  // the object's frame as it was found
  int column = TransformGraph::kExact;
  int frame = -1;                      // of the base under it
  std::vector<std::size_t> confirmed;  // hypotheses of other references that agree
  double camera_chi_square = 0.0;      // of the camera that contradicts it most
};

const ObjectModel* FindModel(std::span<const std::shared_ptr<const PreparedObject>> objects,
                             const std::string& id) {
  const auto at = std::find_if(
      objects.begin(), objects.end(), [&](const auto& o) { return o->model.id == id; });
  return at == objects.end() ? nullptr : &(*at)->model;
}

bool Agrees(const LoopGap& gap) {
  return gap.chi_square < kGapChiSquare ||
         (gap.gap.head<3>().norm() < kGapRad && gap.gap.tail<3>().norm() < kGapM);
}

// Hypotheses of the references that were found, each with a base frame of its own.
absl::StatusOr<std::vector<Hypothesis>> HypothesesOf(
    std::span<const ReferenceObject> references,
    std::span<const std::shared_ptr<const PreparedObject>> objects,
    const SceneAnswer& answer,
    AnswerFrames* f) {
  std::vector<Hypothesis> out;
  for (std::size_t r = 0; r < references.size(); ++r) {
    const ReferenceObject& reference = references[r];
    const ObjectModel* const model = FindModel(objects, reference.object_id);
    const Matrix6d given =
        DiagonalCovariance(reference.rotation_sigma_rad, reference.position_sigma_m);
    for (std::size_t i = 0; i < answer.objects.size() && model != nullptr; ++i) {
      if (answer.objects[i].object_id != reference.object_id) continue;
      for (std::size_t s = 0; s <= model->symmetries.size() && out.size() <= kMostHypotheses; ++s) {
        Hypothesis& h = out.emplace_back();
        h.reference = r;
        h.object = i;
        h.symmetry = static_cast<int>(s);
        const Rigid3 turned = s == 0 ? Rigid3{} : model->symmetries[s - 1].Inverse();
        h.base_from_object = reference.base_from_object * turned;
        if (!given.isZero()) {
          const Matrix6d J = FirstInProduct(reference.base_from_object, turned);
          h.column = f->graph.AddUncertainty(J * given * J.transpose());
        }
        h.frame = f->graph.AddFrame("base");
        HOROPTER_RETURN_IF_ERROR(
            f->graph.Connect(h.frame, f->FrameOfObject(i), h.base_from_object, h.column));
      }
    }
  }
  return out;
}

// How many references can be found at once: of one object no more than there are instances.
std::size_t Findable(std::span<const ReferenceObject> references, const SceneAnswer& answer) {
  std::map<std::string, std::size_t> declared;
  for (const ReferenceObject& r : references) ++declared[r.object_id];
  std::size_t out = 0;
  for (const auto& [id, count] : declared) {
    const auto found = std::count_if(
        answer.objects.begin(), answer.objects.end(), [&, wanted = id](const auto& o) {
          return o.object_id == wanted;
        });
    out += std::min(count, static_cast<std::size_t>(found));
  }
  return out;
}

// Of each other reference the hypothesis, by an instance that no one else has, that agrees best.
absl::Status Confirm(std::size_t reference_count,
                     const TransformGraph& graph,
                     const AnswerFrames& f,
                     std::vector<Hypothesis>* hypotheses,
                     std::size_t index) {
  Hypothesis& h = (*hypotheses)[index];
  std::vector<std::size_t> taken = {h.object};
  for (std::size_t r = 0; r < reference_count; ++r) {
    if (r == h.reference) continue;
    std::optional<std::size_t> best;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k < hypotheses->size(); ++k) {
      const Hypothesis& other = (*hypotheses)[k];
      if (other.reference != r ||
          std::find(taken.begin(), taken.end(), other.object) != taken.end())
        continue;
      HOROPTER_ASSIGN_OR_RETURN(
          const LoopGap gap,
          graph.Gap(h.frame, f.FrameOfObject(other.object), other.base_from_object, other.column));
      if (!Agrees(gap) || gap.chi_square >= least) continue;
      least = gap.chi_square;
      best = k;
    }
    if (!best) continue;
    h.confirmed.push_back(*best);
    taken.push_back((*hypotheses)[*best].object);
  }
  return absl::OkStatus();
}

// Those that as many references confirm as can be, each base once: one that confirms another is
// the same base.
absl::StatusOr<std::vector<std::size_t>> ConfirmedOf(std::span<const ReferenceObject> references,
                                                     const SceneAnswer& answer,
                                                     const AnswerFrames& f,
                                                     std::vector<Hypothesis>* hypotheses) {
  const std::size_t needed = Findable(references, answer);
  std::vector<std::size_t> out;
  for (std::size_t k = 0; k < hypotheses->size(); ++k) {
    HOROPTER_RETURN_IF_ERROR(Confirm(references.size(), f.graph, f, hypotheses, k));
    if ((*hypotheses)[k].confirmed.size() + 1 < needed) continue;
    const bool known = std::any_of(out.begin(), out.end(), [&](std::size_t kept) {
      const auto& confirmed = (*hypotheses)[kept].confirmed;
      return std::find(confirmed.begin(), confirmed.end(), k) != confirmed.end();
    });
    if (!known) out.push_back(k);
  }
  return out;
}

struct CameraConflict {
  double chi_square = 0.0;
  double shift_m = 0.0;
  std::string detail;
};

// The camera in the base that contradicts the hypothesis most; none: all agree.
absl::StatusOr<std::optional<CameraConflict>> ConflictWithCameras(const SceneRequest& request,
                                                                  const std::vector<int>& columns,
                                                                  const AnswerFrames& f,
                                                                  const Hypothesis& h,
                                                                  const std::string& object_id) {
  std::optional<CameraConflict> out;
  for (std::size_t v = 0; v < columns.size(); ++v) {
    if (columns[v] < 0) continue;
    HOROPTER_ASSIGN_OR_RETURN(const LoopGap gap,
                              f.graph.Gap(h.frame,
                                          f.frames.cameras[v],
                                          request.camera_poses[v]->camera_from_base.Inverse(),
                                          columns[v]));
    if (Agrees(gap) || (out && out->chi_square >= gap.chi_square)) continue;
    const double turn = gap.gap.head<3>().norm(), shift = gap.gap.tail<3>().norm();
    out = CameraConflict{gap.chi_square,
                         shift,
                         absl::StrCat("reference ",
                                      object_id,
                                      " and the camera of image ",
                                      v,
                                      " put the base ",
                                      1e3 * shift,
                                      " mm and ",
                                      turn,
                                      " rad apart")};
  }
  return out;
}

// Columns of the deviations of the cameras in the base, -1: not in it or not recovered.
std::vector<int> CameraColumns(const SceneRequest& request, AnswerFrames* f) {
  std::vector<int> out(request.camera_poses.size(), -1);
  for (std::size_t v = 0; v < out.size(); ++v) {
    if (!request.camera_poses[v] || f->frames.cameras[v] < 0) continue;
    const CameraPoseHint& hint = *request.camera_poses[v];
    out[v] =
        f->graph.AddUncertainty(DiagonalCovariance(hint.rotation_sigma_rad, hint.position_sigma_m));
  }
  return out;
}

// Whether the images leave something of the object's pose open that its symmetries do not say.
bool IsPoseOpen(const AnswerObject& o, const SceneAnswer& answer) {
  if (std::find(o.alternatives.begin(), o.alternatives.end(), o.object_id) != o.alternatives.end())
    return true;
  return std::any_of(answer.findings.begin(), answer.findings.end(), [&](const AnswerFinding& f) {
    return (f.kind == FindingKind::kTurnUndetermined ||
            f.kind == FindingKind::kShiftUndetermined) &&
           f.object_id == o.object_id && f.instance == o.instance;
  });
}

absl::Status TellCameras(const AnswerFrames& f, const Hypothesis& h, SceneAnswer* answer) {
  for (const int camera : f.frames.cameras) {
    auto& out = answer->base_from_camera_by_reference.emplace_back();
    if (camera < 0) continue;
    HOROPTER_ASSIGN_OR_RETURN(out, f.graph.Between(h.frame, camera));
  }
  return absl::OkStatus();
}

absl::Status TellAmbiguous(const AnswerFrames& f,
                           const std::vector<Hypothesis>& hypotheses,
                           const std::vector<std::size_t>& left,
                           SceneAnswer* answer) {
  std::map<std::string, int> by_object;
  for (const std::size_t k : left) {
    const Hypothesis& h = hypotheses[k];
    const AnswerObject& o = answer->objects[h.object];
    ++by_object[absl::StrCat(o.object_id, " (instance ", o.instance, ")")];
    if (answer->base_alternatives.size() >= kMostAlternatives) continue;
    HOROPTER_ASSIGN_OR_RETURN(const UncertainPose pose, f.graph.Between(h.frame, f.frames.scene));
    answer->base_alternatives.push_back({pose.pose, o.object_id, o.instance, h.symmetry});
  }
  std::string detail;
  for (const auto& [object, count] : by_object) {
    absl::StrAppend(&detail, detail.empty() ? "" : ", ", count, " by ", object);
  }
  AddReason(ReasonKind::kReferenceAmbiguous,
            absl::StrCat("the references leave the base open, poses that agree: ",
                         detail,
                         "; another reference or a camera pose would decide"),
            answer);
  return absl::OkStatus();
}

// Symmetric references are told where they are declared, found or not.
void WarnOfSymmetric(std::span<const ReferenceObject> references,
                     std::span<const std::shared_ptr<const PreparedObject>> objects,
                     SceneAnswer* answer) {
  std::vector<std::string> told;
  for (const ReferenceObject& r : references) {
    const ObjectModel* const model = FindModel(objects, r.object_id);
    if (model == nullptr || model->symmetries.empty() ||
        std::find(told.begin(), told.end(), r.object_id) != told.end())
      continue;
    told.push_back(r.object_id);
    AnswerFinding f;
    f.kind = FindingKind::kReferenceSymmetric;
    f.object_id = r.object_id;
    f.value = static_cast<double>(model->symmetries.size() + 1);
    f.detail = absl::StrCat("reference ",
                            r.object_id,
                            " is symmetric: by itself it leaves ",
                            model->symmetries.size() + 1,
                            " poses of the base open");
    answer->findings.push_back(std::move(f));
  }
}

std::string NamesOf(std::span<const ReferenceObject> references) {
  std::string out;
  for (const ReferenceObject& r : references)
    absl::StrAppend(&out, out.empty() ? "" : ", ", r.object_id);
  return out;
}

}  // namespace

std::vector<ReferenceObject> ReferencesOf(const SceneRequest& request) {
  std::vector<ReferenceObject> out;
  if (request.reference) out.push_back(*request.reference);
  out.insert(out.end(), request.further_references.begin(), request.further_references.end());
  return out;
}

Matrix6d DiagonalCovariance(double rotation_sigma_rad, double position_sigma_m) {
  Vector6d sigmas;
  sigmas << Eigen::Vector3d::Constant(rotation_sigma_rad),
      Eigen::Vector3d::Constant(position_sigma_m);
  return sigmas.cwiseAbs2().asDiagonal();
}

void AddReferenceConflict(const std::string& detail, double value, SceneAnswer* answer) {
  AnswerFinding f;
  f.kind = FindingKind::kReferenceConflict;
  f.value = value;
  f.detail = detail;
  answer->findings.push_back(f);
  AddReason(ReasonKind::kReferenceConflict, detail, answer);
}

absl::StatusOr<ReferenceVerdict> BaseFromReferences(
    const SceneRequest& request,
    std::span<const std::shared_ptr<const PreparedObject>> objects,
    AnswerFrames* frames,
    SceneAnswer* answer) {
  const std::vector<ReferenceObject> references = ReferencesOf(request);
  WarnOfSymmetric(references, objects, answer);
  HOROPTER_ASSIGN_OR_RETURN(std::vector<Hypothesis> hypotheses,
                            HypothesesOf(references, objects, *answer, frames));
  if (hypotheses.empty()) {
    AddReason(
        ReasonKind::kReferenceNotFound,
        absl::StrCat("reference ", NamesOf(references), " is not among the recognised objects"),
        answer);
    return ReferenceVerdict::kNone;
  }
  std::vector<std::size_t> confirmed;
  bool open = hypotheses.size() > kMostHypotheses;
  if (open) {
    for (std::size_t k = 0; k < hypotheses.size(); ++k) confirmed.push_back(k);
  } else {
    HOROPTER_ASSIGN_OR_RETURN(confirmed, ConfirmedOf(references, *answer, *frames, &hypotheses));
  }
  if (confirmed.empty()) {
    AddReferenceConflict(
        absl::StrCat("references ", NamesOf(references), " put the base in different places"),
        0.0,
        answer);
    return ReferenceVerdict::kNone;
  }
  const std::vector<int> columns = CameraColumns(request, frames);
  const bool posed = std::any_of(columns.begin(), columns.end(), [](int c) { return c >= 0; });
  std::vector<std::size_t> left;
  std::optional<CameraConflict> least;
  std::size_t nearest = confirmed.front();
  for (const std::size_t k : confirmed) {
    const Hypothesis& h = hypotheses[k];
    HOROPTER_ASSIGN_OR_RETURN(
        const std::optional<CameraConflict> conflict,
        ConflictWithCameras(request, columns, *frames, h, references[h.reference].object_id));
    if (!conflict) {
      left.push_back(k);
    } else if (!least || conflict->chi_square < least->chi_square) {
      least = conflict;
      nearest = k;
    }
  }
  if (left.empty()) {
    AddReferenceConflict(least->detail, least->shift_m, answer);
    HOROPTER_RETURN_IF_ERROR(TellCameras(*frames, hypotheses[nearest], answer));
    return ReferenceVerdict::kNone;
  }
  // Those that confirm each other are one base: by the first whose own pose is known.
  std::vector<std::size_t> same = hypotheses[left.front()].confirmed;
  same.insert(same.begin(), left.front());
  const auto known = std::find_if(same.begin(), same.end(), [&](std::size_t k) {
    return !IsPoseOpen(answer->objects[hypotheses[k].object], *answer);
  });
  open = open || left.size() > 1 || known == same.end();
  if (open && posed) return ReferenceVerdict::kOpen;
  if (open) {
    HOROPTER_RETURN_IF_ERROR(TellAmbiguous(*frames, hypotheses, left, answer));
    return ReferenceVerdict::kNone;
  }
  const Hypothesis& chosen = hypotheses[*known];
  frames->base = chosen.frame;
  HOROPTER_ASSIGN_OR_RETURN(const UncertainPose pose,
                            frames->graph.Between(chosen.frame, frames->frames.scene));
  answer->base_from_scene = pose.pose;
  HOROPTER_RETURN_IF_ERROR(TellCameras(*frames, chosen, answer));
  return ReferenceVerdict::kDecided;
}

}  // namespace horopter
