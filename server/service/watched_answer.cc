#include "server/service/watched_answer.h"

#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/io/zero_copy_stream_impl_lite.h>
#include <google/protobuf/util/field_mask_util.h>
#include <google/protobuf/util/time_util.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "horopter/v1/answers.pb.h"
#include "server/pipeline/exception_status.h"
#include "server/service/image_preview.h"

namespace horopter {
namespace {

namespace proto = google::protobuf;

// A larger image takes longer to read than a preview is worth.
constexpr int64_t kMostPreviewedPixels = 24 << 20;

// All of a message's fields but some.
proto::FieldMask AllBut(const proto::Descriptor& type, const std::set<std::string>& left_out) {
  proto::FieldMask mask;
  for (int i = 0; i < type.field_count(); ++i) {
    if (left_out.count(type.field(i)->name()) == 0) mask.add_paths(type.field(i)->name());
  }
  return mask;
}

void CopyRequest(const v1::RecognizeSceneRequest& from, v1::RecognizeSceneRequest* to) {
  static const auto& mask = *new proto::FieldMask(
      AllBut(*v1::RecognizeSceneRequest::descriptor(), {"images", "station_state"}));
  proto::util::FieldMaskUtil::MergeMessageTo(from, mask, {}, to);
  for (const v1::SceneImage& image : from.images()) {
    v1::SceneImage* const copy = to->add_images();
    if (image.has_camera_hint()) *copy->mutable_camera_hint() = image.camera_hint();
    if (image.has_capture_time()) *copy->mutable_capture_time() = image.capture_time();
    copy->set_camera_id(image.camera_id());
    copy->set_frame_id(image.frame_id());
    copy->set_cropped(image.cropped());
  }
}

void CopyResponse(const v1::RecognizeSceneResponse& from, v1::RecognizeSceneResponse* to) {
  static const auto& mask = *new proto::FieldMask(
      AllBut(*v1::RecognizeSceneResponse::descriptor(), {"overlays", "joint_pose_covariance"}));
  proto::util::FieldMaskUtil::MergeMessageTo(from, mask, {}, to);
  for (v1::ExplainedImage& image : *to->mutable_explanation()->mutable_images()) {
    image.clear_edges();
  }
  if (!from.has_explanation()) to->clear_explanation();
}

proto::Duration ToDuration(double seconds) {
  return proto::util::TimeUtil::NanosecondsToDuration(std::llround(1e9 * seconds));
}

// The images as repeated fields of a WatchedAnswer, without a copy of them between.
std::string ImagesPiece(const v1::RecognizeSceneRequest& request) {
  std::string piece;
  proto::io::StringOutputStream bytes(&piece);
  proto::io::CodedOutputStream out(&bytes);
  constexpr uint32_t kLengthDelimited = 2;
  for (const v1::SceneImage& image : request.images()) {
    out.WriteTag((v1::WatchedAnswer::kImagesFieldNumber << 3) | kLengthDelimited);
    out.WriteVarint64(image.ByteSizeLong());
    image.SerializeWithCachedSizes(&out);
  }
  out.Trim();
  return piece;
}

}  // namespace

AnswerPieces PiecesOf(const RequestRecord& record,
                      int64_t number,
                      int64_t most_about_bytes,
                      int64_t most_image_bytes) {
  v1::WatchedAnswer about;
  about.set_number(number);
  about.set_request_id(record.request_id);
  *about.mutable_answer_time() = proto::util::TimeUtil::NanosecondsToTimestamp(
      std::chrono::duration_cast<std::chrono::nanoseconds>(
          std::chrono::system_clock::now().time_since_epoch())
          .count());
  *about.mutable_elapsed() = ToDuration(record.total_seconds);
  *about.mutable_queued() = ToDuration(record.queue_seconds);
  about.set_caller(record.caller);
  about.set_code(static_cast<int>(record.status.code()));
  about.set_message(std::string(record.status.message()));
  AnswerPieces pieces;
  if (const auto* const request = dynamic_cast<const v1::RecognizeSceneRequest*>(record.request)) {
    CopyRequest(*request, about.mutable_request());
    pieces.station = request->station();
    int64_t bytes = 0;
    for (const v1::SceneImage& image : request->images())
      bytes += static_cast<int64_t>(image.content().size() + image.raw().data().size());
    pieces.images_left_out = bytes > most_image_bytes;
    if (!pieces.images_left_out) pieces.images = ImagesPiece(*request);
  }
  const auto* const response = dynamic_cast<const v1::RecognizeSceneResponse*>(record.response);
  if (record.status.ok() && response != nullptr) CopyResponse(*response, about.mutable_response());
  if (static_cast<int64_t>(about.ByteSizeLong()) > most_about_bytes) {
    about.clear_request();
    about.clear_response();
    about.set_message("too large to be shown");
  }
  pieces.about = about.SerializeAsString();
  return pieces;
}

std::string TailPiece(const AnswerTail& tail) {
  v1::WatchedAnswer message;
  message.set_lost(tail.lost);
  message.set_refused(tail.refused);
  message.set_earlier(tail.earlier);
  message.set_images_left_out(tail.images_left_out);
  return message.SerializeAsString();
}

std::string PreviewPiece(const std::string& images, const ImageLimits& limits) {
  v1::WatchedAnswer came, made;
  if (!came.ParseFromString(images)) return "";
  ImageLimits previewed = limits;
  previewed.max_pixels = std::min(limits.max_pixels, kMostPreviewedPixels);
  for (const v1::SceneImage& image : came.images()) {
    v1::ImagePreview* const preview = made.add_previews();
    absl::StatusOr<ImagePreview> small =
        CatchExceptions([&] { return MakePreview(image, previewed); });
    if (!small.ok()) continue;
    preview->set_jpeg(std::move(small->jpeg));
    preview->set_image_width_px(small->image_width);
    preview->set_image_height_px(small->image_height);
  }
  return made.SerializeAsString();
}

}  // namespace horopter
