// Expected parts from the command line.
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "horopter/v1/recognition.pb.h"

namespace horopter {

// words: each an id, ID=COUNT, or a file FILE.json: {"expected_parts": [..]} with the fields of
// ExpectedPart (recognition.proto); objects are named by id, with or without "objects/". Errors:
// INVALID_ARGUMENT, NOT_FOUND (the file).
absl::Status AddExpectedParts(const std::vector<std::string>& words,
                              v1::RecognizeSceneRequest* request);

// One line a part and one for what nobody expects.
std::string ExpectedText(const v1::ExpectedReport& report,
                         const v1::RecognizeSceneRequest& request);

// OUT_OF_RANGE: not every part is present, in how many cases which way. OK: all are.
absl::Status StatusOfExpected(const v1::ExpectedReport& report);

}  // namespace horopter
