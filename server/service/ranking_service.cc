#include "server/service/ranking_service.h"

#include <utility>
#include <vector>

#include "server/base/status_macros.h"
#include "server/service/ranking_convert.h"

namespace horopter {

RankingService::RankingService(PartRanker rank, const CallGate& gate, int64_t max_request_bytes)
    : rank_(std::move(rank)), gate_(gate), max_request_bytes_(max_request_bytes) {}

grpc::ServerUnaryReactor* RankingService::RankParts(grpc::CallbackServerContext* context,
                                                    const grpc::ByteBuffer* request,
                                                    grpc::ByteBuffer* response) {
  return RunUnaryCall<v1::RankPartsRequest, v1::RankPartsResponse>(
      gate_,
      context,
      request,
      response,
      {{"RankParts", max_request_bytes_, Role::kRobot},
       [this](const auto& message, const CallInfo& call, auto* answer) {
         return Handle(message, call, answer);
       }});
}

absl::Status RankingService::Handle(const v1::RankPartsRequest& request,
                                    const CallInfo& call,
                                    v1::RankPartsResponse* response) const {
  if (!rank_) return absl::FailedPreconditionError("this server is no ranker (--role ranker)");
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<RankingImage> images,
                            RankingQuestionFromProto(request));
  const ShardAnswer answer = rank_(images, call.limits.stop);
  if (call.limits.stop()) return absl::CancelledError("stopped");
  RankedPartsToProto(answer.parts, response);
  response->set_catalog_generation(answer.generation);
  response->set_shard(answer.shard.number);
  response->set_shard_count(answer.shard.count);
  response->set_part_count(answer.part_count);
  return absl::OkStatus();
}

}  // namespace horopter
