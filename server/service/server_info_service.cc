#include "server/service/server_info_service.h"

#include <ctime>
#include <utility>

#include "server/base/status_macros.h"
#include "server/pipeline/exception_status.h"
#include "server/service/rpc_status.h"

namespace horopter {

ServerInfoService::ServerInfoService(const CatalogStore& store,
                                     const WorkerPool& scenes,
                                     const MemoryBudget& memory,
                                     Access& access,
                                     v1::ServerLimits limits)
    : store_(store),
      scenes_(scenes),
      memory_(memory),
      access_(access),
      limits_(std::move(limits)),
      start_seconds_(static_cast<int64_t>(std::time(nullptr))) {}

grpc::ServerUnaryReactor* ServerInfoService::GetServerInfo(grpc::CallbackServerContext* context,
                                                           const v1::GetServerInfoRequest*,
                                                           v1::ServerInfo* response) {
  const absl::Status status = CatchExceptions([&]() -> absl::Status {
    HOROPTER_RETURN_IF_ERROR(access_.Authorize(*context, Role::kRobot).status());
    const auto published = store_.Published();
    response->set_version(HOROPTER_VERSION);
    response->mutable_start_time()->set_seconds(start_seconds_);
    *response->mutable_limits() = limits_;
    response->set_catalog_generation(published->snapshot.generation);
    response->set_object_count(static_cast<int32_t>(published->ids.size()));
    response->set_unusable_object_count(static_cast<int32_t>(published->unusable.size()));
    response->set_pending_object_count(static_cast<int32_t>(published->pending.size()));
    const WorkerPool::Load load = scenes_.load();
    response->mutable_load()->set_running(load.running);
    response->mutable_load()->set_waiting(load.waiting);
    response->mutable_load()->set_reserved_bytes(memory_.used());
    return absl::OkStatus();
  });
  grpc::ServerUnaryReactor* const reactor = context->DefaultReactor();
  reactor->Finish(ToRpcStatus(status, context));
  return reactor;
}

}  // namespace horopter
