#include "server/service/answer_overlay.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_format.h"
#include "horopter/v1/recognition.pb.h"
#include "server/base/status_macros.h"
#include "server/overlay/paint.h"
#include "server/overlay/scene_overlay.h"
#include "server/service/image_codecs.h"

namespace horopter {
namespace {

constexpr DrawingColor kGripper{255, 165, 0};
constexpr DrawingColor kUnexplained{255, 235, 60};
constexpr DrawingColor kSupported{60, 220, 60}, kUnsupported{255, 60, 60}, kHidden{80, 140, 255};
constexpr DrawingColor kText{255, 255, 255};
constexpr DrawingColor kRegion{0, 200, 255};
constexpr double kFingerM = 0.04;
constexpr double kGridShare = 0.4;  // of the largest object: a cell of the grid
constexpr int kGridCells = 8;       // to each side

// 1, 2 or 5 times a power of ten, at most x.
double RoundStep(double x) {
  const double ten = std::pow(10.0, std::floor(std::log10(x)));
  return x >= 5.0 * ten ? 5.0 * ten : x >= 2.0 * ten ? 2.0 * ten : ten;
}

void AddPlane(const SceneAnswer& answer,
              const ModelLookup& models,
              const PosedCamera& posed,
              Drawing* drawing) {
  if (!answer.plane || answer.objects.empty()) return;
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  double largest = 0.0;
  for (const AnswerObject& o : answer.objects) {
    middle += o.scene_from_object.t / static_cast<double>(answer.objects.size());
    if (const ObjectModel* model = models(o.object_id)) {
      largest = std::max(largest, model->diameter_m);
    }
  }
  if (!(largest > 0.0)) return;
  DrawGrid(posed.camera,
           posed.camera_from_scene,
           {answer.plane->normal, answer.plane->offset_m},
           middle,
           RoundStep(kGridShare * largest),
           kGridCells,
           drawing);
}

void AddObjects(const SceneAnswer& answer,
                const ModelLookup& models,
                const PosedCamera& posed,
                Drawing* drawing) {
  std::vector<OverlayObject> objects;
  for (size_t k = 0; k < answer.objects.size(); ++k) {
    const AnswerObject& o = answer.objects[k];
    const ObjectModel* model = models(o.object_id);
    const bool explained = answer.explanation && answer.explanation->object_id == o.object_id;
    if (model == nullptr || explained) continue;
    const std::string& name = model->display_name.empty() ? model->id : model->display_name;
    objects.push_back({model,
                       posed.camera_from_scene * o.scene_from_object,
                       absl::StrFormat("%s %.2f", name, o.score),
                       ObjectColor(static_cast<int>(k))});
  }
  DrawWireframes(posed.camera, objects, drawing);
  for (const AnswerObject& o : answer.objects) {
    if (o.grasps.empty()) continue;
    const SceneGrasp& best = o.grasps.front();
    const Rigid3 camera_from_gripper = posed.camera_from_scene * best.scene_from_gripper;
    if (best.suction) {
      DrawSuctionCup(
          posed.camera, camera_from_gripper, best.cup_radius_m, kFingerM, kGripper, drawing);
    } else {
      DrawGripper(
          posed.camera, camera_from_gripper, best.jaw_opening_m, kFingerM, kGripper, drawing);
    }
  }
}

// Strokes are drawn by cameras without the lens's further terms.
void ShiftByLens(const PosedCamera& posed, size_t first, Drawing* drawing) {
  if (posed.lens.none()) return;
  for (size_t i = first; i < drawing->strokes.size(); ++i) {
    for (Eigen::Vector2d& point : drawing->strokes[i].points)
      point += ShiftByTerms(posed.camera, posed.lens, point);
  }
}

DrawingColor ColorOf(EdgeState state) {
  switch (state) {
    case EdgeState::kSupported:
      return kSupported;
    case EdgeState::kUnsupported:
      return kUnsupported;
    case EdgeState::kHidden:
      return kHidden;
  }
  return kText;
}

void AddExplanation(const AnswerExplanation& explanation, size_t image, Drawing* drawing) {
  const double height = TextHeightPx(*drawing);
  drawing->labels.push_back({{8.0, 1.6 * height}, explanation.found.detail, kText, height});
  const auto& views = explanation.found.views;
  if (image >= views.size() || !views[image]) {
    drawing->labels.push_back({{8.0, 3.2 * height}, "no pose in this image", kText, height});
    return;
  }
  const ExplainedView& view = *views[image];
  for (const EdgeRun& run : view.edges.runs) {
    drawing->strokes.push_back({run.points, ColorOf(run.state), LineWidthPx(*drawing) + 1.0});
  }
  drawing->labels.push_back({{8.0, 3.2 * height},
                             absl::StrFormat("score %.2f, %.0f of %.0f px supported, %.0f hidden",
                                             view.score,
                                             view.edges.supported_px,
                                             view.edges.visible_px,
                                             view.edges.hidden_px),
                             kText,
                             height});
}

// Where parts were looked for, in pixels of the image.
void AddSearched(const SceneRequest& request, size_t image, Drawing* drawing) {
  if (request.searched.empty() || !request.searched[image]) return;
  for (const ImageBox& box : request.searched[image]->boxes) {
    const Eigen::Vector2d a = box.min(), b = box.max();
    drawing->strokes.push_back(
        {{a, {b.x(), a.y()}, b, {a.x(), b.y()}, a}, kRegion, LineWidthPx(*drawing)});
  }
  if (request.searched[image]->boxes.empty()) {
    const double height = TextHeightPx(*drawing);
    drawing->labels.push_back({{8.0, drawing->height - 2.4 * height},
                               "not searched: no region is here",
                               kRegion,
                               height});
  }
}

const char* NameOf(BasisSource source) {
  switch (source) {
    case BasisSource::kTexture:
      return "texture";
    case BasisSource::kFeatures:
      return "features";
    case BasisSource::kParts:
      return "parts";
    case BasisSource::kStation:
      return "station";
    case BasisSource::kGiven:
      return "given";
  }
  return "";
}

std::string CaptionOf(const SceneAnswer& answer, size_t image) {
  const int number = static_cast<int>(image) + 1;
  if (image >= answer.cameras.size() || !answer.cameras[image]) {
    const bool unrelated = image < answer.unrelated_images.size() && answer.unrelated_images[image];
    return absl::StrFormat("image %d, camera not recovered%s",
                           number,
                           unrelated ? ": shows nothing of what the others show" : "");
  }
  const PosedCamera& posed = *answer.cameras[image];
  std::string text = absl::StrFormat("image %d, f = %.0f px +- %.1f %%",
                                     number,
                                     posed.camera.focal_px,
                                     100.0 * posed.focal_log_sigma);
  if (image >= answer.camera_bases.size()) return text;
  for (const CameraBasis& basis : answer.camera_bases[image]) {
    absl::StrAppendFormat(&text, ", %s", NameOf(basis.source));
    if (basis.matches > 0)
      absl::StrAppendFormat(&text, " %d (%.1f px)", basis.matches, basis.rms_px);
  }
  return text;
}

}  // namespace

std::vector<Drawing> DrawAnswer(const SceneAnswer& answer,
                                const SceneRequest& request,
                                const ModelLookup& models) {
  std::vector<Drawing> drawings;
  for (size_t i = 0; i < request.images.size(); ++i) {
    Drawing& drawing = drawings.emplace_back();
    drawing.width = request.images[i].cols;
    drawing.height = request.images[i].rows;
    if (i < answer.unexplained_edges.size()) {
      for (const auto& line : answer.unexplained_edges[i]) {
        drawing.strokes.push_back({line, kUnexplained, 1.0});
      }
    }
    AddSearched(request, i, &drawing);
    const bool recovered = i < answer.cameras.size() && answer.cameras[i].has_value();
    if (recovered) {
      const size_t before = drawing.strokes.size();
      AddPlane(answer, models, *answer.cameras[i], &drawing);
      AddObjects(answer, models, *answer.cameras[i], &drawing);
      ShiftByLens(*answer.cameras[i], before, &drawing);
    }
    if (answer.explanation) AddExplanation(*answer.explanation, i, &drawing);
    DrawCaption(CaptionOf(answer, i), &drawing);
  }
  return drawings;
}

int64_t OverlayBytesPerPixel(const v1::OverlayOptions& options) {
  // The painted image, and the file, which compression may not make smaller.
  return options.format() == v1::OverlayOptions::FORMAT_SVG ? 0 : 3 + 4;
}

absl::Status AddOverlays(const v1::OverlayOptions& options,
                         const SceneRequest& request,
                         const std::vector<Drawing>& drawings,
                         v1::RecognizeSceneResponse* response) {
  for (size_t i = 0; i < drawings.size(); ++i) {
    v1::Overlay* overlay = response->add_overlays();
    if (options.format() == v1::OverlayOptions::FORMAT_SVG) {
      overlay->set_format(v1::OverlayOptions::FORMAT_SVG);
      overlay->set_content(ToSvg(drawings[i]));
      continue;
    }
    overlay->set_format(v1::OverlayOptions::FORMAT_PNG);
    cv::Mat canvas = Canvas(request.images[i]);
    Paint(drawings[i], &canvas);
    HOROPTER_ASSIGN_OR_RETURN(*overlay->mutable_content(), EncodePng(canvas));
  }
  return absl::OkStatus();
}

}  // namespace horopter
