// RankingService: what a ranker's shard says of images.
#pragma once

#include <functional>
#include <span>

#include "horopter/v1/ranking.grpc.pb.h"
#include "server/service/ranking_shard.h"
#include "server/service/unary_call.h"

namespace horopter {

// How a shard is asked.
using PartRanker =
    std::function<ShardAnswer(std::span<const RankingImage> images, const StopRequested& stop)>;

// Thread-safe. The shard and what the gate names must outlive the service's last call.
class RankingService final
    : public v1::RankingService::WithRawCallbackMethod_RankParts<v1::RankingService::Service> {
 public:
  // rank: empty where the server is no ranker; its calls are refused.
  RankingService(PartRanker rank, const CallGate& gate, int64_t max_request_bytes);

  grpc::ServerUnaryReactor* RankParts(grpc::CallbackServerContext* context,
                                      const grpc::ByteBuffer* request,
                                      grpc::ByteBuffer* response) override;

 private:
  absl::Status Handle(const v1::RankPartsRequest& request,
                      const CallInfo& call,
                      v1::RankPartsResponse* response) const;

  const PartRanker rank_;
  const CallGate gate_;
  const int64_t max_request_bytes_;
};

}  // namespace horopter
