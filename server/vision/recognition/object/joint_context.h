// What a request gives to recognition: nothing of it changes.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/recognition/options.h"
#include "server/vision/recognition/types.h"

namespace horopter {

struct JointContext {
  std::span<const std::shared_ptr<const PreparedObject>> objects;
  std::vector<PinholeCamera> start_cameras;  // per view: what is known before any part is
  std::vector<double> focal_log_sigma;       // of their focal lengths
  RecognitionOptions options;
  StopRequested stop;
  // A stop or a hurry: initial hypotheses need not be looked for any more, nor another round begun.
  StopRequested give_up;
  StepListener on_step;
};

// What a request brings, as far as cameras go. hints: empty or one per view.
struct EvidenceInput {
  std::span<const ImageFeatures> features;
  std::span<const CameraHint> hints;
  std::span<const std::shared_ptr<const PreparedObject>> objects;
};

// Start cameras of a request. The spans must outlive the result.
JointContext MakeContext(const EvidenceInput& input,
                         const RecognitionOptions& options,
                         const StopRequested& stop,
                         const StepListener& on_step);

// Says that a step begins; only from the thread that recognition was called on.
inline void BeginStep(const JointContext& context, std::string_view step) {
  if (context.on_step) context.on_step(step);
}

}  // namespace horopter
