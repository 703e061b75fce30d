#include "server/vision/recognition/object/joint_context.h"

namespace horopter {
namespace {

// What is known of a view's camera before any part is: the caller's word, else the usual lens.
void StartCamera(const EvidenceInput& input, int v, JointContext* context) {
  const RecognitionOptions& options = context->options;
  const ImageFeatures& f = input.features[v];
  PinholeCamera camera = CenteredCamera(f.width, f.height, options.focal_start_widths * f.width);
  double sigma = options.focal_log_sigma;
  if (!input.hints.empty()) {
    CameraHint hint = input.hints[v];
    if (hint.presumed && FocalLogSigma(hint) > sigma) hint.focal_px.reset();
    camera = WithHint(camera, hint);
    if (hint.focal_px) sigma = FocalLogSigma(hint);
  }
  context->start_cameras.push_back(camera);
  context->focal_log_sigma.push_back(sigma);
}

}  // namespace

JointContext MakeContext(const EvidenceInput& input,
                         const RecognitionOptions& options,
                         const StopRequested& stop,
                         const StepListener& on_step) {
  JointContext context;
  context.on_step = on_step;
  context.objects = input.objects;
  context.options = options;
  context.stop = stop;
  context.give_up = [stop, hurry = options.hurry] {
    return IsStopRequested(stop) || IsStopRequested(hurry);
  };
  const int views = static_cast<int>(input.features.size());
  for (int v = 0; v < views; ++v) StartCamera(input, v, &context);
  return context;
}

}  // namespace horopter
