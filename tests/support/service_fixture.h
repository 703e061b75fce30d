// A whole server on a :memory: catalog with a recognizer of the test's choice, and clients in the
// same process.
#pragma once

#include <grpcpp/client_context.h>

#include <memory>
#include <string>

#include "horopter/v1/catalog.grpc.pb.h"
#include "horopter/v1/recognition.grpc.pb.h"
#include "server/service/server.h"

namespace horopter {

class TestServer {
 public:
  explicit TestServer(Recognizer recognizer,
                      const ServerOptions& options = {},
                      const std::string& db = ":memory:");

  v1::RecognitionService::Stub& recognition() { return *recognition_; }
  v1::CatalogService::Stub& catalog() { return *catalog_; }
  std::shared_ptr<grpc::Channel> channel() { return channel_; }
  HoropterServer& server() { return *server_; }

  // Enrols SampleRecord(id); true on success.
  bool Enrol(const std::string& id);

 private:
  std::unique_ptr<HoropterServer> server_;
  std::shared_ptr<grpc::Channel> channel_;
  std::unique_ptr<v1::RecognitionService::Stub> recognition_;
  std::unique_ptr<v1::CatalogService::Stub> catalog_;
};

// SampleRecord(id, seed) as the wire's object.
v1::Object SampleObject(const std::string& id, unsigned seed = 1);

// Value of a trailing metadata key; empty when it is not there.
std::string Trailing(const grpc::ClientContext& context, const std::string& key);

}  // namespace horopter
