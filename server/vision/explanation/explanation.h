// Why an object is, or is not, in an answer: its best hypothesis, the test that refused it, and
// what each image says of its edges.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/euclidean/euclidean.h"
#include "server/vision/explanation/edge_report.h"
#include "server/vision/recognition/recognition.h"
#include "server/vision/recognition/refusals.h"

namespace horopter {

// The object as one image shows it.
struct ExplainedView {
  PinholeCamera camera;
  Rigid3 camera_from_object;
  double score = 0.0;  // AspectScore::score
  EdgeReport edges;
};

struct Explanation {
  AcceptanceTest failed = AcceptanceTest::kNone;
  double value = 0.0;   // of the test, see Refusal
  double needed = 0.0;  // 0: the test has no number
  int other = -1;       // object that has its place
  std::string detail;   // for people
  // One per image; empty where no pose is known. Of objects that failed kHypothesis or kLink each
  // image has a pose and a camera of its own, otherwise all have those of one scene.
  std::vector<std::optional<ExplainedView>> views;
};

// log: what recognition refused of the object that is to be explained. metric: the adjusted scene,
// null when nothing was recognised. Costs what the search for one object costs where recognition
// left nothing of it: about a second an image. Errors: INVALID_ARGUMENT (no object is to be
// explained), CANCELLED.
absl::StatusOr<Explanation> ExplainObject(const RecognitionInput& input,
                                          const RefusalLog& log,
                                          const RecognitionResult& recognition,
                                          const MetricScene* metric,
                                          const RecognitionOptions& options,
                                          const StopRequested& stop = {});

}  // namespace horopter
