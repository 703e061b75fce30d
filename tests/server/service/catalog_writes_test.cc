// Writes that may be repeated, guarded and batched, and what the catalog says of itself over a
// restart.
#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <thread>

#include "server/service/rpc_status.h"
#include "tests/support/sample_record.h"
#include "tests/support/scratch_dir.h"
#include "tests/support/service_fixture.h"

namespace horopter {
namespace {

using grpc::StatusCode;

class CatalogWrites : public testing::Test {
 protected:
  void Restart() {
    server_.reset();
    server_ = std::make_unique<TestServer>(nullptr, ServerOptions{}, path_);
  }
  void SetUp() override { Restart(); }

  template <typename Response, typename Request, typename Method>
  grpc::Status Call(Method method, const Request& request, Response* response) {
    grpc::ClientContext context;
    response->Clear();
    const grpc::Status status = (server_->catalog().*method)(&context, request, response);
    field_ = Trailing(context, kErrorFieldKey);
    return status;
  }
  static v1::CreateObjectRequest CreateRequest(const std::string& id, unsigned seed = 1) {
    v1::CreateObjectRequest request;
    request.set_object_id(id);
    *request.mutable_object() = SampleObject(id, seed);
    return request;
  }
  grpc::Status Create(const v1::CreateObjectRequest& request) {
    return Call(&v1::CatalogService::Stub::CreateObject, request, &object_);
  }
  grpc::Status Update(const v1::UpdateObjectRequest& request) {
    return Call(&v1::CatalogService::Stub::UpdateObject, request, &object_);
  }
  grpc::Status Delete(const v1::DeleteObjectRequest& request) {
    google::protobuf::Empty empty;
    return Call(&v1::CatalogService::Stub::DeleteObject, request, &empty);
  }
  grpc::Status Batch(const v1::BatchCreateObjectsRequest& request) {
    return Call(&v1::CatalogService::Stub::BatchCreateObjects, request, &batch_);
  }
  v1::Object Get(const std::string& id) {
    v1::GetObjectRequest request;
    request.set_name("objects/" + id);
    v1::Object object;
    EXPECT_TRUE(Call(&v1::CatalogService::Stub::GetObject, request, &object).ok()) << id;
    return object;
  }
  int Count() {
    v1::ListObjectsResponse list;
    EXPECT_TRUE(Call(&v1::CatalogService::Stub::ListObjects, v1::ListObjectsRequest(), &list).ok());
    return list.total_size();
  }
  int64_t Generation() { return server_->server().store().Published()->snapshot.generation; }

  const ScratchDir dir_;
  const std::string path_ = dir_.File("a.db");
  std::unique_ptr<TestServer> server_;
  v1::Object object_;
  v1::BatchCreateObjectsResponse batch_;
  std::string field_;
};

TEST_F(CatalogWrites, ACreationRepeatedUnderItsRequestIdIsAnsweredAsTheFirstTime) {
  v1::CreateObjectRequest request = CreateRequest("box");
  request.set_request_id("6f1c-1");
  ASSERT_TRUE(Create(request).ok());
  const std::string first = object_.SerializeAsString();
  const int64_t generation = Generation();
  ASSERT_TRUE(Create(request).ok());
  EXPECT_EQ(object_.SerializeAsString(), first);
  Restart();
  ASSERT_TRUE(Create(request).ok());
  EXPECT_EQ(object_.SerializeAsString(), first);
  EXPECT_EQ(Generation(), generation);

  request.mutable_object()->set_display_name("something else");
  EXPECT_EQ(Create(request).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "request_id");
  EXPECT_EQ(Create(CreateRequest("box")).error_code(), StatusCode::ALREADY_EXISTS);
  request = CreateRequest("nut");
  request.set_request_id("with space");
  EXPECT_EQ(Create(request).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "request_id");

  v1::DeleteObjectRequest gone;
  gone.set_name("objects/box");
  ASSERT_TRUE(Delete(gone).ok());
  request = CreateRequest("box");
  request.set_request_id("6f1c-1");
  EXPECT_EQ(Create(request).error_code(), StatusCode::NOT_FOUND) << "made once, not twice";
}

TEST_F(CatalogWrites, TheSameCreationFromManyThreadsIsOne) {
  v1::CreateObjectRequest request = CreateRequest("box");
  request.set_request_id("again");
  std::vector<std::thread> threads;
  std::atomic<int> right{0};
  for (int i = 0; i < 8; ++i) {
    threads.emplace_back([&] {
      grpc::ClientContext context;
      v1::Object object;
      const grpc::Status status = server_->catalog().CreateObject(&context, request, &object);
      EXPECT_TRUE(status.ok()) << status.error_message();
      right += status.ok() && object.name() == "objects/box";
    });
  }
  for (std::thread& t : threads) t.join();
  EXPECT_EQ(right, 8);
  EXPECT_EQ(Count(), 1);
}

TEST_F(CatalogWrites, TheSameBatchFromManyThreadsIsOneAndEachAnswerNamesEachObjectOnce) {
  v1::BatchCreateObjectsRequest request;
  for (const char* id : {"a", "b", "c"}) *request.add_requests() = CreateRequest(id);
  request.set_request_id("again");
  constexpr int kThreads = 8;
  std::vector<v1::BatchCreateObjectsResponse> answers(kThreads);
  std::vector<std::thread> threads;
  for (v1::BatchCreateObjectsResponse& answer : answers) {
    threads.emplace_back([&] {
      grpc::ClientContext context;
      const grpc::Status status = server_->catalog().BatchCreateObjects(&context, request, &answer);
      EXPECT_TRUE(status.ok()) << status.error_message();
    });
  }
  for (std::thread& t : threads) t.join();
  for (const v1::BatchCreateObjectsResponse& answer : answers) {
    ASSERT_EQ(answer.objects_size(), 3);
    for (int i = 0; i < 3; ++i) {
      EXPECT_EQ(answer.objects(i).name(), "objects/" + request.requests(i).object_id());
      EXPECT_EQ(answer.objects(i).etag(), answers[0].objects(i).etag());
    }
  }
  EXPECT_EQ(Count(), 3);
}

TEST_F(CatalogWrites, EtagsChangeWithEveryWriteAndGuardTheNext) {
  ASSERT_TRUE(Create(CreateRequest("box")).ok());
  const std::string made = object_.etag();
  const int64_t revision = object_.revision();
  ASSERT_FALSE(made.empty());
  EXPECT_EQ(Get("box").etag(), made);

  v1::UpdateObjectRequest update;
  update.mutable_object()->set_name("objects/box");
  update.mutable_object()->set_display_name("new");
  update.set_if_match(made);
  ASSERT_TRUE(Update(update).ok());
  const std::string changed = object_.etag();
  EXPECT_NE(changed, made);
  EXPECT_GT(object_.revision(), revision);
  EXPECT_EQ(Get("box").etag(), changed);

  update.mutable_object()->set_display_name("newer");
  EXPECT_EQ(Update(update).error_code(), StatusCode::ABORTED);
  EXPECT_EQ(field_, "if_match");
  EXPECT_EQ(Get("box").display_name(), "new");

  v1::DeleteObjectRequest gone;
  gone.set_name("objects/box");
  gone.set_if_match(made);
  EXPECT_EQ(Delete(gone).error_code(), StatusCode::ABORTED);
  EXPECT_EQ(field_, "if_match");
  gone.set_if_match(changed);
  ASSERT_TRUE(Delete(gone).ok());
  EXPECT_EQ(Delete(gone).error_code(), StatusCode::NOT_FOUND);
  gone.set_allow_missing(true);
  EXPECT_TRUE(Delete(gone).ok());

  // The same object once more is another one.
  ASSERT_TRUE(Create(CreateRequest("box")).ok());
  EXPECT_NE(object_.etag(), made);
  EXPECT_GT(object_.revision(), revision);
}

TEST_F(CatalogWrites, AnUnsetMaskMeansThePopulatedFieldsAndAStarAll) {
  ASSERT_TRUE(Create(CreateRequest("box")).ok());
  v1::UpdateObjectRequest update;
  update.mutable_object()->set_name("objects/box");
  update.mutable_object()->set_display_name("only this");
  ASSERT_TRUE(Update(update).ok());
  v1::Object after = Get("box");
  EXPECT_EQ(after.display_name(), "only this");
  EXPECT_EQ(after.grasps_size(), 2);
  EXPECT_GT(after.edges_size(), 0);
  EXPECT_EQ(after.labels().size(), 1u);

  *update.mutable_object() = SampleObject("box");
  update.mutable_object()->clear_grasps();
  update.mutable_object()->clear_labels();
  update.mutable_update_mask()->add_paths("*");
  ASSERT_TRUE(Update(update).ok());
  EXPECT_EQ(object_.grasps_size(), 0);
  EXPECT_EQ(object_.labels().size(), 0u);
}

TEST_F(CatalogWrites, AMissingObjectIsMadeByAnUpdateThatAllowsIt) {
  v1::UpdateObjectRequest update;
  *update.mutable_object() = SampleObject("box");
  EXPECT_EQ(Update(update).error_code(), StatusCode::NOT_FOUND);
  update.set_allow_missing(true);
  ASSERT_TRUE(Update(update).ok());
  const std::string etag = object_.etag();
  ASSERT_TRUE(Update(update).ok());
  EXPECT_NE(object_.etag(), etag);
  EXPECT_EQ(Count(), 1);
  update.set_if_match(etag);
  EXPECT_EQ(Update(update).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "if_match");
}

TEST_F(CatalogWrites, ABatchIsAllOrNothingAndErrorsSayWhichObject) {
  v1::BatchCreateObjectsRequest request;
  EXPECT_EQ(Batch(request).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "requests");
  for (const char* id : {"box", "nut", "rod"}) *request.add_requests() = CreateRequest(id);
  v1::BatchCreateObjectsRequest bad = request;
  bad.mutable_requests(1)->mutable_object()->mutable_edges(2)->set_end_vertex(80);
  EXPECT_EQ(Batch(bad).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "requests[1].object.edges[2]");
  bad = request;
  bad.mutable_requests(2)->mutable_object()->mutable_source()->set_sha256(std::string(64, 'a'));
  EXPECT_EQ(Batch(bad).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "requests[2].object.source.sha256");
  bad = request;
  bad.mutable_requests(2)->set_object_id("box");
  EXPECT_EQ(Batch(bad).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "requests[2].object_id");
  bad = request;
  bad.mutable_requests(2)->mutable_object()->set_display_name("unpreparable");
  EXPECT_EQ(Batch(bad).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(Count(), 0);

  request.set_request_id("batch");
  const int64_t before = Generation();
  ASSERT_TRUE(Batch(request).ok());
  ASSERT_EQ(batch_.objects_size(), 3);
  EXPECT_EQ(batch_.objects(2).name(), "objects/rod");
  EXPECT_EQ(Generation(), before + 1) << "one write";
  const std::string first = batch_.SerializeAsString();
  ASSERT_TRUE(Batch(request).ok());
  EXPECT_EQ(batch_.SerializeAsString(), first);
  EXPECT_EQ(server_->server().store().Published()->ids.size(), 3u);
  EXPECT_TRUE(server_->server().store().CheckIndex().ok());

  v1::BatchCreateObjectsRequest taken;
  *taken.add_requests() = CreateRequest("cup");
  *taken.add_requests() = CreateRequest("nut");
  EXPECT_EQ(Batch(taken).error_code(), StatusCode::ALREADY_EXISTS);
  EXPECT_EQ(Count(), 3);
}

TEST_F(CatalogWrites, TheGenerationCountsEveryWriteAndSurvivesARestart) {
  const int64_t empty = Generation();
  ASSERT_TRUE(Create(CreateRequest("box")).ok());
  EXPECT_EQ(Generation(), empty + 1);
  EXPECT_EQ(object_.revision(), Generation());
  v1::UpdateObjectRequest rename;
  rename.mutable_object()->set_name("objects/box");
  rename.mutable_object()->set_display_name("b");
  ASSERT_TRUE(Update(rename).ok());
  EXPECT_EQ(Generation(), empty + 2);
  Restart();
  EXPECT_EQ(Generation(), empty + 2);
  EXPECT_EQ(Get("box").revision(), empty + 2);
  ASSERT_TRUE(Create(CreateRequest("nut")).ok());
  EXPECT_EQ(Generation(), empty + 3);
}

TEST_F(CatalogWrites, AFullCatalogRefusesFurtherObjectsByTheNameOfTheLimit) {
  ServerOptions options;
  options.max_objects = 2;
  server_.reset();
  server_ = std::make_unique<TestServer>(nullptr, options, path_);
  ASSERT_TRUE(Create(CreateRequest("box")).ok());
  v1::BatchCreateObjectsRequest two;
  for (const char* id : {"nut", "rod"}) *two.add_requests() = CreateRequest(id);
  EXPECT_EQ(Batch(two).error_code(), StatusCode::RESOURCE_EXHAUSTED);
  ASSERT_TRUE(Create(CreateRequest("nut")).ok());
  const grpc::Status status = Create(CreateRequest("rod"));
  EXPECT_EQ(status.error_code(), StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(status.error_message(), testing::HasSubstr("max_objects"));
  EXPECT_EQ(Count(), 2);
  // What is there can still be changed.
  v1::UpdateObjectRequest rename;
  rename.mutable_object()->set_name("objects/box");
  rename.mutable_object()->set_display_name("b");
  EXPECT_TRUE(Update(rename).ok());
}

TEST_F(CatalogWrites, LabelsComeBackAndBadOnesAreRefused) {
  v1::CreateObjectRequest request = CreateRequest("box");
  (*request.mutable_object()->mutable_labels())["line/3"] = "left";
  ASSERT_TRUE(Create(request).ok());
  EXPECT_EQ(object_.labels().at("line/3"), "left");
  Restart();
  EXPECT_EQ(Get("box").labels().at("line/3"), "left");
  request = CreateRequest("nut");
  (*request.mutable_object()->mutable_labels())["Line"] = "left";
  EXPECT_EQ(Create(request).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "object.labels");
}

TEST_F(CatalogWrites, AnObjectThatRecognitionCannotUseSaysSoUntilItIsMended) {
  ASSERT_TRUE(Create(CreateRequest("box")).ok());
  EXPECT_EQ(object_.recognition_status().state(), v1::RecognitionStatus::STATE_READY);
  server_.reset();
  {
    CatalogRecord record = SampleRecord("odd");
    record.model.display_name = "unpreparable";
    ASSERT_TRUE(Catalog::Open(path_).value()->CreateObject(record).ok());
  }
  Restart();
  EXPECT_EQ(Get("box").recognition_status().state(), v1::RecognitionStatus::STATE_READY);
  v1::Object odd = Get("odd");
  while (odd.recognition_status().state() == v1::RecognitionStatus::STATE_PENDING) {
    std::this_thread::sleep_for(
        std::chrono::milliseconds(10));  // it is tried beside what is served
    odd = Get("odd");
  }
  EXPECT_EQ(odd.recognition_status().state(), v1::RecognitionStatus::STATE_FAILED);
  EXPECT_THAT(odd.recognition_status().reason(), testing::HasSubstr("no usable edge"));
  v1::UpdateObjectRequest mend;
  mend.mutable_object()->set_name("objects/odd");
  mend.mutable_object()->set_display_name("even");
  ASSERT_TRUE(Update(mend).ok());
  EXPECT_EQ(object_.recognition_status().state(), v1::RecognitionStatus::STATE_READY);
  EXPECT_EQ(Get("odd").recognition_status().state(), v1::RecognitionStatus::STATE_READY);
}

TEST_F(CatalogWrites, ASuctionGraspComesBackAndOneWithoutAGripperIsRefused) {
  v1::CreateObjectRequest request = CreateRequest("box");
  request.mutable_object()->mutable_grasps(0)->mutable_suction()->set_cup_radius_m(0.008);
  ASSERT_TRUE(Create(request).ok());
  EXPECT_EQ(Get("box").grasps(0).suction().cup_radius_m(), 0.008);
  EXPECT_TRUE(Get("box").grasps(1).has_parallel_jaw());
  request.set_object_id("nut");
  request.mutable_object()->mutable_grasps(0)->clear_suction();
  EXPECT_EQ(Create(request).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "object.grasps[0].gripper");
  request.mutable_object()->mutable_grasps(0)->mutable_suction();
  EXPECT_EQ(Create(request).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "object.grasps[0].suction.cup_radius_m");
}

}  // namespace
}  // namespace horopter
