// grpc.health.v1.Health/Check without its generated code.
#pragma once

#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>

#include <future>
#include <memory>
#include <string>
#include <utility>

namespace horopter {

// Field 1 of HealthCheckResponse, a varint.
inline constexpr char kServing[] = "\x08\x01";
inline constexpr char kNotServing[] = "\x08\x02";

// The bytes of the answer; of a call that failed "error: " and its text. service: at most 127
// bytes; empty: the server as a whole.
inline std::string HealthAnswer(const std::shared_ptr<grpc::Channel>& channel,
                                const std::string& service) {
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  const std::string bytes =
      service.empty() ? "" : std::string("\x0a") + static_cast<char>(service.size()) + service;
  const grpc::Slice slice(bytes);
  grpc::ByteBuffer request(&slice, 1), response;
  std::promise<grpc::Status> done;
  stub.UnaryCall(
      &context, "/grpc.health.v1.Health/Check", {}, &request, &response, [&](grpc::Status status) {
        done.set_value(std::move(status));
      });
  const grpc::Status status = done.get_future().get();
  if (!status.ok()) return "error: " + status.error_message();
  grpc::Slice answer;
  response.TrySingleSlice(&answer);
  return {reinterpret_cast<const char*>(answer.begin()), answer.size()};
}

}  // namespace horopter
