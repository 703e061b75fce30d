#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_join.h"
#include "client/answer_text.h"
#include "client/commands.h"
#include "client/convert.h"
#include "client/output.h"
#include "client/scene_request.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr size_t kWorstEdges = 5;  // that are listed

struct EdgeLength {
  double visible = 0.0, supported = 0.0, hidden = 0.0;
};

// Lengths by enrolled edge over all images, pixels.
std::map<int, EdgeLength> LengthsOf(const v1::Explanation& explanation) {
  std::map<int, EdgeLength> lengths;
  for (const v1::ExplainedImage& image : explanation.images()) {
    for (const v1::ExplainedEdge& edge : image.edges()) {
      EdgeLength& length = lengths[edge.has_edge() ? edge.edge() : -1];
      double px = 0.0;
      for (int i = 2; i + 1 < edge.points_px_size(); i += 2) {
        px += std::hypot(edge.points_px(i) - edge.points_px(i - 2),
                         edge.points_px(i + 1) - edge.points_px(i - 1));
      }
      if (edge.state() == v1::ExplainedEdge::STATE_HIDDEN) {
        length.hidden += px;
        continue;
      }
      length.visible += px;
      if (edge.state() == v1::ExplainedEdge::STATE_SUPPORTED) length.supported += px;
    }
  }
  return lengths;
}

void SayEdges(const v1::Explanation& explanation) {
  const std::map<int, EdgeLength> lengths = LengthsOf(explanation);
  std::vector<std::pair<double, int>> missing;
  for (const auto& [edge, length] : lengths) {
    missing.emplace_back(length.visible - length.supported, edge);
  }
  std::sort(missing.rbegin(), missing.rend());
  if (missing.size() > kWorstEdges) missing.resize(kWorstEdges);
  for (const auto& [px, edge] : missing) {
    if (!(px > 0.0)) break;
    const EdgeLength& length = lengths.at(edge);
    Say("%s: %.0f of %.0f px without support\n",
        edge < 0 ? "outlines" : ("edge " + std::to_string(edge)).c_str(),
        px,
        length.visible);
  }
}

void SayExplanation(const v1::RecognizeSceneResponse& response,
                    const std::vector<std::string>& paths) {
  const v1::Explanation& explanation = response.explanation();
  if (explanation.failed_test() != v1::Explanation::TEST_UNSPECIFIED)
    Say("%s\n", v1::Explanation_Test_Name(explanation.failed_test()).c_str());
  Say("%s\n", explanation.detail().c_str());
  for (const v1::RecognizedObject& o : response.objects()) {
    if (o.object() != explanation.object()) continue;
    Say("right with a probability of %.2f\n", o.score());
    for (const v1::ObjectAlternative& a : o.alternatives())
      Say("or %s (mm, frame of the scene)\n", AlternativeText(a, Rigid3()).c_str());
  }
  for (int i = 0; i < explanation.images_size(); ++i) {
    const v1::ExplainedImage& image = explanation.images(i);
    const std::string& path = paths[static_cast<size_t>(i)];
    if (!image.has_camera_from_object()) {
      Say("image %d (%s): no pose\n", i + 1, path.c_str());
      continue;
    }
    Say("image %d (%s): score %.2f, %.0f of %.0f px of its edges supported, %.0f hidden; f = %.0f "
        "px\n",
        i + 1,
        path.c_str(),
        image.score(),
        image.supported_px(),
        image.visible_px(),
        image.hidden_px(),
        image.camera().focal_px());
  }
  for (int i = 0; i < response.cameras_size(); ++i) {
    Say("image %d: %s\n", i + 1, CameraText(response.cameras(i)).c_str());
  }
  if (const std::string open = OpenCamerasText(response); !open.empty()) Say("%s\n", open.c_str());
  SayEdges(explanation);
}

}  // namespace

absl::Status Explain(HoropterClient& client,
                     const std::string& object,
                     const RecognizeArguments& arguments) {
  HOROPTER_ASSIGN_OR_RETURN(v1::RecognizeSceneRequest request, BuildSceneRequest(arguments));
  request.set_explain_object(ResourceName(object));
  if (!arguments.overlay_path.empty()) {
    HOROPTER_RETURN_IF_ERROR(CheckOverlayPath(arguments.overlay_path));
    request.mutable_overlay()->set_format(OverlayFormatOf(arguments.overlay_path));
    request.mutable_overlay()->set_unexplained_edges(arguments.unexplained);
  }
  HOROPTER_ASSIGN_OR_RETURN(const v1::RecognizeSceneResponse response,
                            client.RecognizeScene(request));
  if (!response.has_explanation()) {
    return absl::InternalError(
        "the answer explains nothing: is the server older than this program?");
  }
  std::vector<std::string> drawn;
  if (!arguments.overlay_path.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(drawn, WriteOverlays(response, arguments.overlay_path));
  }
  if (JsonOutput()) return SayMessage(response.explanation());
  SayExplanation(response, arguments.images);
  if (!drawn.empty()) Say("overlay in %s\n", absl::StrJoin(drawn, ", ").c_str());
  return absl::OkStatus();
}

}  // namespace horopter
