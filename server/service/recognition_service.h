// RecognitionService: validate, convert, recognise, convert.
#pragma once

#include <functional>

#include "absl/status/statusor.h"
#include "horopter/v1/recognition.grpc.pb.h"
#include "server/base/call_limits.h"
#include "server/pipeline/pipeline.h"
#include "server/service/catalog_store.h"
#include "server/service/image_decode.h"
#include "server/service/unary_call.h"

namespace horopter {

// The pipeline with its options bound; tests put a stand-in here.
using Recognizer = std::function<absl::StatusOr<PipelineResult>(
    const SceneRequest&, const CatalogSnapshot&, const CallLimits&)>;

struct RecognitionLimits {
  ImageLimits images;
  int64_t max_request_bytes = int64_t{256} << 20;
  // Reserved for the stages per pixel of the request, beside the decoded images. What they take
  // whatever the size is ServerLimits.stage_bytes.
  int64_t work_bytes_per_pixel = 24;
  int decode_threads = 2;
  bool allow_variants = false;  // that a call names in its metadata (pipeline/variants.h)
};

// Thread-safe. The store and what the gate names must outlive the service's last call.
class RecognitionService final
    : public v1::RecognitionService::WithRawCallbackMethod_RecognizeScene<
          v1::RecognitionService::Service> {
 public:
  RecognitionService(CatalogStore& store,
                     const CallGate& gate,
                     Recognizer recognizer,
                     const RecognitionLimits& limits);

  grpc::ServerUnaryReactor* RecognizeScene(grpc::CallbackServerContext* context,
                                           const grpc::ByteBuffer* request,
                                           grpc::ByteBuffer* response) override;

  // What a request takes, and the call itself without the network around it.
  absl::StatusOr<CallDemand> Demand(const v1::RecognizeSceneRequest& request) const;
  absl::Status Handle(const v1::RecognizeSceneRequest& request,
                      const CallInfo& call,
                      v1::RecognizeSceneResponse* response) const;

 private:
  CatalogStore& store_;
  const CallGate gate_;
  const Recognizer recognizer_;
  const RecognitionLimits limits_;
};

}  // namespace horopter
