#include "tests/support/service_fixture.h"

#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include "server/service/catalog_convert.h"
#include "tests/support/fake_objects.h"
#include "tests/support/sample_record.h"

namespace horopter {

TestServer::TestServer(Recognizer recognizer, const ServerOptions& options, const std::string& db) {
  spdlog::set_level(spdlog::level::off);
  auto opened = Catalog::Open(db);
  EXPECT_TRUE(opened.ok()) << opened.status();
  auto server =
      HoropterServer::Start(*std::move(opened), FakePreparer(), std::move(recognizer), options);
  EXPECT_TRUE(server.ok()) << server.status();
  server_ = *std::move(server);
  channel_ = server_->InProcessChannel();
  recognition_ = v1::RecognitionService::NewStub(channel_);
  catalog_ = v1::CatalogService::NewStub(channel_);
}

bool TestServer::Enrol(const std::string& id) {
  grpc::ClientContext context;
  v1::CreateObjectRequest request;
  request.set_object_id(id);
  *request.mutable_object() = SampleObject(id);
  v1::Object answer;
  return catalog_->CreateObject(&context, request, &answer).ok();
}

v1::Object SampleObject(const std::string& id, unsigned seed) {
  const CatalogRecord record = SampleRecord(id, seed);
  v1::Object object;
  RecordToProto(record, &object);
  object.clear_create_time();
  object.clear_update_time();
  object.clear_etag();
  object.clear_revision();
  object.mutable_source()->set_content(record.source.content);
  return object;
}

std::string Trailing(const grpc::ClientContext& context, const std::string& key) {
  const auto& metadata = context.GetServerTrailingMetadata();
  const auto found = metadata.find(key);
  return found == metadata.end() ? "" : std::string(found->second.data(), found->second.size());
}

}  // namespace horopter
