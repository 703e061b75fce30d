#include "server/service/catalog_service.h"

#include <gmock/gmock.h>
#include <google/protobuf/util/message_differencer.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "server/base/sha256.h"
#include "server/service/rpc_status.h"
#include "tests/support/sample_record.h"
#include "tests/support/scratch_dir.h"
#include "tests/support/service_fixture.h"

namespace horopter {
namespace {

using grpc::StatusCode;

absl::StatusOr<PipelineResult> NeverRecognise(const SceneRequest&,
                                              const CatalogSnapshot&,
                                              const CallLimits&) {
  return absl::UnimplementedError("not in this test");
}

class CatalogServiceTest : public testing::Test {
 protected:
  template <typename Response, typename Request, typename Method>
  grpc::Status Call(Method method, const Request& request, Response* response) {
    grpc::ClientContext context;
    const grpc::Status status = (server_.catalog().*method)(&context, request, response);
    field_ = Trailing(context, kErrorFieldKey);
    return status;
  }

  grpc::Status Create(const std::string& id, const v1::Object& object) {
    v1::CreateObjectRequest request;
    request.set_object_id(id);
    *request.mutable_object() = object;
    return Call(&v1::CatalogService::Stub::CreateObject, request, &answer_);
  }
  grpc::Status Get(const std::string& name, v1::ObjectView view = v1::OBJECT_VIEW_UNSPECIFIED) {
    v1::GetObjectRequest request;
    request.set_name(name);
    request.set_view(view);
    return Call(&v1::CatalogService::Stub::GetObject, request, &answer_);
  }
  grpc::Status Update(const v1::Object& object, const std::vector<std::string>& paths) {
    v1::UpdateObjectRequest request;
    *request.mutable_object() = object;
    for (const std::string& path : paths) request.mutable_update_mask()->add_paths(path);
    return Call(&v1::CatalogService::Stub::UpdateObject, request, &answer_);
  }
  grpc::Status List(int page_size, const std::string& token) {
    v1::ListObjectsRequest request;
    request.set_page_size(page_size);
    request.set_page_token(token);
    return Call(&v1::CatalogService::Stub::ListObjects, request, &list_);
  }

  TestServer server_{NeverRecognise};
  v1::Object answer_;
  v1::ListObjectsResponse list_;
  std::string field_;
};

TEST_F(CatalogServiceTest, AnObjectComesBackAsItWasCreated) {
  const v1::Object object = SampleObject("box");
  ASSERT_TRUE(Create("box", object).ok());
  EXPECT_EQ(answer_.name(), "objects/box");
  EXPECT_TRUE(answer_.has_create_time());
  EXPECT_TRUE(answer_.edges().empty());
  ASSERT_TRUE(Get("objects/box", v1::OBJECT_VIEW_FULL).ok());
  EXPECT_EQ(answer_.source().sha256(), Sha256Hex(object.source().content()));
  v1::Object read = answer_;
  read.clear_create_time();
  read.clear_update_time();
  read.clear_etag();
  read.clear_revision();
  read.clear_recognition_status();
  read.mutable_source()->clear_sha256();
  google::protobuf::util::MessageDifferencer differencer;
  google::protobuf::util::DefaultFieldComparator approximate;  // rotations pass through matrices
  approximate.set_float_comparison(google::protobuf::util::DefaultFieldComparator::APPROXIMATE);
  approximate.SetDefaultFractionAndMargin(1e-12, 1e-12);
  differencer.set_field_comparator(&approximate);
  std::string difference;
  differencer.ReportDifferencesToString(&difference);
  EXPECT_TRUE(differencer.Compare(object, read)) << difference;
}

TEST_F(CatalogServiceTest, ViewsGrowFromBasicToFull) {
  ASSERT_TRUE(Create("box", SampleObject("box")).ok());
  ASSERT_TRUE(Get("objects/box", v1::OBJECT_VIEW_BASIC).ok());
  EXPECT_EQ(answer_.edges_size(), 0);
  EXPECT_FALSE(answer_.has_mesh());
  EXPECT_EQ(answer_.edge_count(), 13);
  EXPECT_EQ(answer_.grasps_size(), 2);
  ASSERT_TRUE(Get("objects/box").ok());
  EXPECT_EQ(answer_.edges_size(), 13);
  EXPECT_TRUE(answer_.source().content().empty());
  EXPECT_GT(answer_.source().size_bytes(), 0);
}

TEST_F(CatalogServiceTest, ADuplicateIdIsAlreadyExists) {
  ASSERT_TRUE(Create("box", SampleObject("box", 1)).ok());
  const grpc::Status status = Create("box", SampleObject("box", 2));
  EXPECT_EQ(status.error_code(), StatusCode::ALREADY_EXISTS);
  EXPECT_THAT(status.error_message(), testing::HasSubstr("'box'"));
}

TEST_F(CatalogServiceTest, BadObjectsAreRefusedByFieldAndLeaveNothing) {
  v1::Object object = SampleObject("box");
  EXPECT_EQ(Create("Box!", object).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "object_id");
  object.mutable_edges(2)->set_end_vertex(80);
  EXPECT_EQ(Create("box", object).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "object.edges[2]");
  object = SampleObject("box");
  object.clear_mesh();
  EXPECT_EQ(Create("box", object).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "object.mesh.vertices_m");
  object = SampleObject("box");
  object.mutable_source()->set_sha256(std::string(64, 'a'));
  EXPECT_EQ(Create("box", object).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "object.source.sha256");
  object = SampleObject("box");
  object.set_display_name("unpreparable");
  EXPECT_EQ(Create("box", object).error_code(), StatusCode::INVALID_ARGUMENT);
  ASSERT_TRUE(List(0, "").ok());
  EXPECT_EQ(list_.total_size(), 0);
  EXPECT_TRUE(Create("box", SampleObject("box")).ok());
}

TEST_F(CatalogServiceTest, UnknownAndMalformedNamesAreToldApart) {
  EXPECT_EQ(Get("objects/nut").error_code(), StatusCode::NOT_FOUND);
  EXPECT_EQ(Get("nut").error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "name");
  v1::DeleteObjectRequest request;
  request.set_name("objects/nut");
  google::protobuf::Empty empty;
  EXPECT_EQ(Call(&v1::CatalogService::Stub::DeleteObject, request, &empty).error_code(),
            StatusCode::NOT_FOUND);
  v1::Object object = SampleObject("nut");
  EXPECT_EQ(Update(object, {"grasps"}).error_code(), StatusCode::NOT_FOUND);
}

TEST_F(CatalogServiceTest, AnUpdateTouchesTheMaskedFieldsOnly) {
  ASSERT_TRUE(Create("box", SampleObject("box", 1)).ok());
  ASSERT_TRUE(Get("objects/box", v1::OBJECT_VIEW_FULL).ok());
  const v1::Object before = answer_;
  v1::Object change;
  change.set_name("objects/box");
  *change.add_grasps() = before.grasps(1);
  change.mutable_grasps(0)->set_name("only");
  ASSERT_TRUE(Update(change, {"grasps"}).ok());
  ASSERT_TRUE(Get("objects/box", v1::OBJECT_VIEW_FULL).ok());
  ASSERT_EQ(answer_.grasps_size(), 1);
  EXPECT_EQ(answer_.grasps(0).name(), "only");
  EXPECT_EQ(answer_.display_name(), before.display_name());
  EXPECT_EQ(answer_.source().content(), before.source().content());
  EXPECT_EQ(answer_.mesh().SerializeAsString(), before.mesh().SerializeAsString());

  EXPECT_EQ(Update(change, {"mesh"}).error_code(), StatusCode::INVALID_ARGUMENT) << "no mesh left";
  EXPECT_EQ(Update(change, {"create_time"}).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "update_mask");
  ASSERT_TRUE(Update(SampleObject("box", 2), {}).ok());
  ASSERT_TRUE(Get("objects/box", v1::OBJECT_VIEW_FULL).ok());
  EXPECT_EQ(answer_.source().content(), SampleObject("box", 2).source().content());
  EXPECT_NE(answer_.diameter_m(), before.diameter_m());
}

TEST_F(CatalogServiceTest, PagesVisitEveryObjectOnceAndBadTokensAreRefused) {
  for (int i = 0; i < 7; ++i) ASSERT_TRUE(server_.Enrol("obj_" + std::to_string(i)));
  std::vector<std::string> names;
  std::string token;
  do {
    ASSERT_TRUE(List(3, token).ok());
    EXPECT_EQ(list_.total_size(), 7);
    for (const v1::Object& object : list_.objects()) names.push_back(object.name());
    token = list_.next_page_token();
    list_.Clear();
  } while (!token.empty());
  EXPECT_EQ(names.size(), 7u);
  EXPECT_TRUE(std::is_sorted(names.begin(), names.end()));
  ASSERT_TRUE(List(100000, "").ok());
  EXPECT_TRUE(list_.next_page_token().empty());
  EXPECT_EQ(List(-1, "").error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "page_size");
  EXPECT_EQ(List(3, "garbage").error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "page_token");
}

TEST(CatalogServiceRestart, ObjectsAreThereAfterARestartAndAnUnpreparableOneDoesNotStopTheServer) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  {
    TestServer server(NeverRecognise, {}, path);
    ASSERT_TRUE(server.Enrol("box"));
    ASSERT_TRUE(server.Enrol("nut"));
  }
  {
    auto catalog = Catalog::Open(path);
    ASSERT_TRUE(catalog.ok()) << catalog.status();
    CatalogRecord record = SampleRecord("odd");
    record.model.display_name = "unpreparable";
    ASSERT_TRUE((*catalog)->CreateObject(record).ok());
  }
  TestServer server(NeverRecognise, {}, path);
  EXPECT_THAT(server.server().store().Published()->ids, testing::ElementsAre("box", "nut"));
  const CatalogStore& store = server.server().store();
  while (!store.Published()->pending.empty())
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  EXPECT_THAT(store.Published()->unusable,
              testing::ElementsAre(testing::Pair("odd", testing::HasSubstr("no usable edge"))));
}

}  // namespace
}  // namespace horopter
