// ServerService: what a client should know of the server.
#pragma once

#include "horopter/v1/server.grpc.pb.h"
#include "server/service/catalog_store.h"
#include "server/service/unary_call.h"

namespace horopter {

// Thread-safe; answers without waiting for a worker. What the constructor is given must outlive the
// service's last call.
class ServerInfoService final : public v1::ServerService::CallbackService {
 public:
  // `limits` are told as they are; `scenes` and `memory` give the load.
  ServerInfoService(const CatalogStore& store,
                    const WorkerPool& scenes,
                    const MemoryBudget& memory,
                    Access& access,
                    v1::ServerLimits limits);

  grpc::ServerUnaryReactor* GetServerInfo(grpc::CallbackServerContext* context,
                                          const v1::GetServerInfoRequest* request,
                                          v1::ServerInfo* response) override;

 private:
  const CatalogStore& store_;
  const WorkerPool& scenes_;
  const MemoryBudget& memory_;
  Access& access_;
  const v1::ServerLimits limits_;
  const int64_t start_seconds_;
};

}  // namespace horopter
