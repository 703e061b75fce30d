#include "client/scene_request.h"

#include <google/protobuf/util/json_util.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "client/bop_results.h"
#include "client/camera_hints.h"
#include "client/convert.h"
#include "client/expected_file.h"
#include "server/base/status_macros.h"
#include "server/base/utf8.h"
#include "server/overlay/paint.h"

namespace horopter {
namespace {

constexpr int kTileWidth = 800;

constexpr size_t kReferenceWords = 8;

// r: an object id, or an id and seven numbers, at `first`.
absl::StatusOr<v1::ReferenceObject> ReferenceOf(const std::vector<std::string>& r, size_t first) {
  Rigid3 base_from_object;
  if (r.size() > 1) {
    double n[7];
    for (size_t k = 0; k < 7; ++k) {
      const std::string& word = r[first + k + 1];
      char* end = nullptr;
      n[k] = std::strtod(word.c_str(), &end);
      if (*end != '\0' || end == word.c_str())
        return absl::InvalidArgumentError(absl::StrCat("--reference: not a number: ", word));
    }
    base_from_object.t = {n[0], n[1], n[2]};
    const Eigen::Quaterniond q(n[3], n[4], n[5], n[6]);
    if (!(std::abs(q.norm() - 1.0) < 0.01)) {
      return absl::InvalidArgumentError("--reference: the quaternion's norm is not 1");
    }
    base_from_object.R = q.normalized().toRotationMatrix();
  }
  v1::ReferenceObject reference;
  reference.set_object(ResourceName(r[first]));
  *reference.mutable_base_from_object() = ToProto(base_from_object);
  return reference;
}

absl::Status AddReferences(const RecognizeArguments& arguments,
                           v1::RecognizeSceneRequest* request) {
  const std::vector<std::string>& r = arguments.reference;
  if (r.empty()) {
    return arguments.reference_sigma.empty()
               ? absl::OkStatus()
               : absl::InvalidArgumentError("--reference-sigma: only with --reference");
  }
  if (r.size() != 1 && r.size() % kReferenceWords != 0) {
    return absl::InvalidArgumentError(
        "--reference takes an object id, or an id and its pose in the base: x y z qw qx qy qz");
  }
  for (size_t first = 0; first < r.size(); first += kReferenceWords) {
    v1::ReferenceObject* reference =
        first == 0 ? request->mutable_reference() : request->add_further_references();
    HOROPTER_ASSIGN_OR_RETURN(*reference, ReferenceOf(r, first));
    if (arguments.reference_sigma.empty()) continue;
    reference->set_rotation_sigma_rad(arguments.reference_sigma[0]);
    reference->set_position_sigma_m(arguments.reference_sigma[1]);
  }
  return absl::OkStatus();
}

absl::Status NameStation(const RecognizeArguments& arguments, v1::RecognizeSceneRequest* request) {
  if (arguments.station.empty() && arguments.read_only)
    return absl::InvalidArgumentError("--read-only: only with --station");
  request->set_station_read_only(arguments.read_only);
  if (arguments.station.empty()) {
    return arguments.station_cameras.empty()
               ? absl::OkStatus()
               : absl::InvalidArgumentError("--station-cameras: only with --station");
  }
  const std::vector<std::string>& cameras = arguments.station_cameras;
  if (!cameras.empty() && static_cast<int>(cameras.size()) != request->images_size())
    return absl::InvalidArgumentError("--station-cameras: one per image");
  request->set_station(ToUtf8(absl::StrCat("stations/", arguments.station)));
  for (int i = 0; i < request->images_size(); ++i) {
    request->mutable_images(i)->set_camera_id(
        cameras.empty() ? absl::StrCat("camera", i + 1) : ToUtf8(cameras[static_cast<size_t>(i)]));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<v1::RecognizeSceneRequest> BuildSceneRequest(const RecognizeArguments& arguments) {
  v1::RecognizeSceneRequest request;
  for (const std::string& path : arguments.images) {
    v1::SceneImage* image = request.add_images();
    HOROPTER_ASSIGN_OR_RETURN(*image->mutable_content(), ReadFileBytes(path));
    image->set_cropped(arguments.cropped);
  }
  request.set_ignore_exif(arguments.ignore_exif);
  if (arguments.unknown_share) request.set_unknown_share(*arguments.unknown_share);
  std::vector<std::string> warnings;
  HOROPTER_RETURN_IF_ERROR(AddCameraHints(arguments.cameras, &request, &warnings));
  for (const std::string& w : warnings) std::fprintf(stderr, "warning: %s\n", w.c_str());
  for (const std::string& id : arguments.candidates) {
    request.add_candidate_objects(ResourceName(id));
  }
  HOROPTER_RETURN_IF_ERROR(AddReferences(arguments, &request));
  HOROPTER_RETURN_IF_ERROR(AddExpectedParts(arguments.expected, &request));
  HOROPTER_RETURN_IF_ERROR(NameStation(arguments, &request));
  HOROPTER_RETURN_IF_ERROR(AddRegions(arguments.regions, &request));
  return request;
}

absl::Status CheckOverlayPath(const std::string& path) {
  const std::string extension =
      absl::AsciiStrToLower(std::filesystem::path(path).extension().string());
  for (const char* known : {"", ".png", ".jpg", ".jpeg", ".svg"}) {
    if (extension == known) return CheckCanBeWritten(path);
  }
  return absl::InvalidArgumentError(
      absl::StrCat("--out ", path, ": drawings are .png, .jpg or .svg, not ", extension));
}

v1::OverlayOptions::Format OverlayFormatOf(const std::string& path) {
  return absl::EndsWithIgnoreCase(path, ".svg") ? v1::OverlayOptions::FORMAT_SVG
                                                : v1::OverlayOptions::FORMAT_PNG;
}

absl::StatusOr<std::vector<std::string>> WriteOverlays(const v1::RecognizeSceneResponse& response,
                                                       const std::string& path) {
  if (response.overlays().empty()) {
    return absl::InternalError(
        "the answer has no drawings: is the server older than this program?");
  }
  if (OverlayFormatOf(path) == v1::OverlayOptions::FORMAT_SVG) {
    const std::string stem = path.substr(0, path.size() - 4);
    std::vector<std::string> files;
    for (int i = 0; i < response.overlays_size(); ++i) {
      files.push_back(absl::StrCat(stem, "-", i + 1, ".svg"));
      HOROPTER_RETURN_IF_ERROR(WriteFileAtomically(files.back(), response.overlays(i).content()));
    }
    return files;
  }
  try {
    std::vector<cv::Mat> tiles;
    for (const v1::Overlay& overlay : response.overlays()) {
      const std::string& bytes = overlay.content();
      tiles.push_back(
          cv::imdecode(std::vector<uchar>(bytes.begin(), bytes.end()), cv::IMREAD_COLOR));
      if (tiles.back().empty()) return absl::InternalError("a drawing of the answer is no PNG");
    }
    const bool jpeg =
        absl::EndsWithIgnoreCase(path, ".jpg") || absl::EndsWithIgnoreCase(path, ".jpeg");
    std::vector<uchar> file;
    cv::imencode(jpeg ? ".jpg" : ".png", Tile(tiles, kTileWidth), file);
    HOROPTER_RETURN_IF_ERROR(WriteFileAtomically(path, std::string(file.begin(), file.end())));
    return std::vector<std::string>{path};
  } catch (const std::exception& e) {
    return absl::InternalError(absl::StrCat("overlay: ", e.what()));
  }
}

absl::Status SayMessage(const google::protobuf::Message& message) {
  google::protobuf::util::JsonPrintOptions options;
  options.add_whitespace = true;
  options.preserve_proto_field_names = true;
  options.always_print_primitive_fields = true;
  std::string text;
  const auto status = google::protobuf::util::MessageToJsonString(message, &text, options);
  if (!status.ok()) return absl::InternalError(status.ToString());
  std::printf("%s", text.c_str());
  return absl::OkStatus();
}

}  // namespace horopter
