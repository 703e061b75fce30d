// What the files of the C++ client share; internal to client/.
#pragma once

#include <grpcpp/grpcpp.h>

#include <memory>
#include <string>

#include "client/api.h"
#include "horopter/v1/catalog.grpc.pb.h"
#include "horopter/v1/recognition.grpc.pb.h"
#include "horopter/v1/server.grpc.pb.h"
#include "horopter/v1/station.grpc.pb.h"

namespace horopter {

inline constexpr int kPageSize = 200;  // of a List request

struct HoropterClient::Stubs {
  absl::Status ready;
  std::shared_ptr<grpc::Channel> channel;
  std::unique_ptr<v1::CatalogService::Stub> catalog;
  std::unique_ptr<v1::RecognitionService::Stub> recognition;
  std::unique_ptr<v1::ServerService::Stub> server;
  std::unique_ptr<v1::StationService::Stub> stations;
};

// gRPC of the server broke the call off because messages on their way held all of its memory: the
// mapping of ENHANCE_YOUR_CALM (gRPC over HTTP/2, "Errors"), which no trailers come with.
bool BrokenOffForMemory(const grpc::Status& status);

// The context must be of a call that is over.
absl::Status ToAbsl(const grpc::Status& status,
                    const grpc::ClientContext& context,
                    const std::string& address);

}  // namespace horopter
