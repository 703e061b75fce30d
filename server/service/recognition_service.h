// RecognitionService: validate, convert, recognise, convert.
#pragma once

#include <functional>

#include "absl/status/statusor.h"
#include "horopter/v1/recognition.grpc.pb.h"
#include "server/base/call_limits.h"
#include "server/pipeline/pipeline.h"
#include "server/service/catalog_store.h"
#include "server/service/image_decode.h"
#include "server/service/worker_pool.h"

namespace horopter {

// The pipeline with its options bound; tests put a stand-in here.
using Recognizer = std::function<absl::StatusOr<PipelineResult>(
    const SceneRequest&, const CatalogSnapshot&, const CallLimits&)>;

// Thread-safe. `threads` decode the images of a request. The store and the pool must outlive the
// service's last call.
class RecognitionService final : public v1::RecognitionService::CallbackService {
 public:
  RecognitionService(CatalogStore& store,
                     WorkerPool& pool,
                     Recognizer recognizer,
                     ImageLimits limits,
                     int threads);

  grpc::ServerUnaryReactor* RecognizeScene(grpc::CallbackServerContext* context,
                                           const v1::RecognizeSceneRequest* request,
                                           v1::RecognizeSceneResponse* response) override;

 private:
  CatalogStore& store_;
  WorkerPool& pool_;
  const Recognizer recognizer_;
  const ImageLimits limits_;
  const int threads_;
};

}  // namespace horopter
