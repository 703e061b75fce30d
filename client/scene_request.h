// What `recognize` and `explain` have in common: the request, and the pictures that come back.
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/commands.h"
#include "horopter/v1/recognition.pb.h"

namespace horopter {

// Images, candidates, reference, camera hints and regions; warnings go to stderr. Errors:
// NOT_FOUND, INVALID_ARGUMENT, those of AddCameraHints.
absl::StatusOr<v1::RecognizeSceneRequest> BuildSceneRequest(const RecognizeArguments& arguments);

// Whether the drawings can be written there, before anybody searches for them. Errors:
// INVALID_ARGUMENT (no kind of picture), those of CheckCanBeWritten.
absl::Status CheckOverlayPath(const std::string& path);

// SVG for NAME.svg, else PNG.
v1::OverlayOptions::Format OverlayFormatOf(const std::string& path);

// The answer's drawings: PNG or JPEG (NAME.jpg) all in one picture, SVG one file an image,
// NAME-1.svg and so on. Errors: INTERNAL (the answer has none, or what cannot be read), those of
// writing.
absl::StatusOr<std::vector<std::string>> WriteOverlays(const v1::RecognizeSceneResponse& response,
                                                       const std::string& path);

// A message as JSON to stdout. Errors: INTERNAL.
absl::Status SayMessage(const google::protobuf::Message& message);

}  // namespace horopter
