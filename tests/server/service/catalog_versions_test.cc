// What objects were, and going back to it, over the wire; and what recognition looks for of them.
#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <fstream>
#include <set>

#include "server/base/sha256.h"
#include "server/service/rpc_status.h"
#include "tests/support/sample_record.h"
#include "tests/support/scratch_dir.h"
#include "tests/support/service_fixture.h"

namespace horopter {
namespace {

using grpc::StatusCode;
using testing::ElementsAre;
using Stub = v1::CatalogService::Stub;

class ObjectHistory : public testing::Test {
 protected:
  void SetUp() override {
    std::ofstream access(dir_.File("access"));
    for (const char* line : {"admin anna", "admin ben", "observer eve", "robot arm"}) {
      const std::string name = std::string(line).substr(std::string(line).find(' ') + 1);
      access << line << " sha256:" << Sha256Hex(name) << "\n";
    }
    access.close();
    options_.access_file = dir_.File("access");
    server_ = std::make_unique<TestServer>(nullptr, options_, dir_.File("a.db"));
    v1::CreateObjectRequest request;
    request.set_object_id("box");
    *request.mutable_object() = SampleObject("box");
    ASSERT_TRUE(Call(&Stub::CreateObject, request, &object_, "anna").ok());
  }
  template <typename Response, typename Request, typename Method>
  grpc::Status Call(Method method,
                    const Request& request,
                    Response* response,
                    const std::string& who = "anna") {
    return CallOf(server_->catalog(), method, request, response, who);
  }
  template <typename Response, typename Request, typename Method>
  grpc::Status CallOf(Stub& stub,
                      Method method,
                      const Request& request,
                      Response* response,
                      const std::string& who = "anna") {
    grpc::ClientContext context;
    context.AddMetadata("authorization", "Bearer " + who);
    response->Clear();
    const grpc::Status status = (stub.*method)(&context, request, response);
    field_ = Trailing(context, kErrorFieldKey);
    return status;
  }
  grpc::Status Rename(const std::string& name, const std::string& who) {
    v1::UpdateObjectRequest request;
    request.mutable_object()->set_name("objects/box");
    request.mutable_object()->set_display_name(name);
    request.mutable_update_mask()->add_paths("display_name");
    return Call(&Stub::UpdateObject, request, &object_, who);
  }
  std::vector<v1::ObjectVersion> Versions(const std::string& who = "eve") {
    v1::ListObjectVersionsRequest request;
    request.set_name("objects/box");
    v1::ListObjectVersionsResponse response;
    EXPECT_TRUE(Call(&Stub::ListObjectVersions, request, &response, who).ok());
    return {response.versions().begin(), response.versions().end()};
  }
  grpc::Status Restore(int64_t revision,
                       const std::string& if_match = {},
                       const std::string& who = "ben") {
    v1::RestoreObjectRequest request;
    request.set_name("objects/box");
    request.set_revision(revision);
    request.set_if_match(if_match);
    return Call(&Stub::RestoreObject, request, &object_, who);
  }
  v1::Object Get(int64_t revision, v1::ObjectView view = v1::OBJECT_VIEW_FULL) {
    v1::GetObjectRequest request;
    request.set_name("objects/box");
    request.set_revision(revision);
    request.set_view(view);
    v1::Object object;
    EXPECT_TRUE(Call(&Stub::GetObject, request, &object).ok());
    return object;
  }

  const ScratchDir dir_;
  ServerOptions options_;
  std::unique_ptr<TestServer> server_;
  v1::Object object_;
  std::string field_;
};

// But for what every write changes.
v1::Object Content(v1::Object object) {
  object.clear_update_time();
  object.clear_revision();
  object.clear_etag();
  object.clear_recognition_status();
  return object;
}

TEST_F(ObjectHistory, SaysWhoChangedWhatAndGoesBackToAllOfIt) {
  const v1::Object first = Get(0);
  v1::UpdateObjectRequest all;
  *all.mutable_object() = SampleObject("box", 2);
  all.mutable_object()->set_name("objects/box");
  all.mutable_update_mask()->add_paths("*");
  ASSERT_TRUE(Call(&Stub::UpdateObject, all, &object_, "ben").ok());
  ASSERT_TRUE(Rename("third", "anna").ok());

  const auto versions = Versions();
  ASSERT_EQ(versions.size(), 3u);
  EXPECT_EQ(versions[0].changed_by(), "anna");
  EXPECT_EQ(versions[1].changed_by(), "ben");
  EXPECT_THAT(versions[0].changed_fields().paths(), ElementsAre("display_name"));
  EXPECT_GE(versions[1].changed_fields().paths_size(), 6);
  EXPECT_FALSE(versions[2].has_changed_fields());
  EXPECT_NE(versions[0].object().etag(), "");
  EXPECT_EQ(versions[1].object().etag(), "");
  EXPECT_EQ(versions[2].object().revision(), first.revision());
  EXPECT_EQ(Content(Get(first.revision())).SerializeAsString(), Content(first).SerializeAsString());
  EXPECT_EQ(Get(first.revision(), v1::OBJECT_VIEW_BASIC).mesh().vertices_m_size(), 0);
  EXPECT_EQ(Get(versions[0].object().revision()).etag(), versions[0].object().etag());

  ASSERT_TRUE(Restore(first.revision(), versions[0].object().etag()).ok());
  EXPECT_EQ(object_.recognition_status().state(), v1::RecognitionStatus::STATE_READY);
  EXPECT_GT(object_.revision(), versions[0].object().revision());
  const v1::Object back = Get(0);
  EXPECT_EQ(Content(back).SerializeAsString(), Content(first).SerializeAsString());
  EXPECT_EQ(back.etag(), object_.etag());
  // Recognition sees it, and it can be undone.
  const auto published = server_->server().store().Published();
  EXPECT_EQ(server_->server().store().ModelOf(*published->snapshot.objects[0]).vertices.size(),
            static_cast<size_t>(first.vertices_m_size() / 3));
  EXPECT_EQ(Versions()[0].changed_by(), "ben");
  ASSERT_TRUE(Restore(versions[0].object().revision()).ok());
  EXPECT_EQ(object_.display_name(), "third");
}

TEST_F(ObjectHistory, IsForThoseWhoMayAndSaysWhatIsNotThere) {
  v1::ListObjectVersionsRequest list;
  list.set_name("objects/box");
  v1::ListObjectVersionsResponse versions;
  EXPECT_EQ(Call(&Stub::ListObjectVersions, list, &versions, "arm").error_code(),
            StatusCode::PERMISSION_DENIED);
  list.set_name("box");
  EXPECT_EQ(Call(&Stub::ListObjectVersions, list, &versions).error_code(),
            StatusCode::INVALID_ARGUMENT);
  list.set_name("objects/none");
  EXPECT_EQ(Call(&Stub::ListObjectVersions, list, &versions).error_code(), StatusCode::NOT_FOUND);

  const int64_t first = object_.revision();
  const std::string etag = object_.etag();
  EXPECT_EQ(Restore(first, {}, "eve").error_code(), StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(Restore(0).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "revision");
  EXPECT_EQ(Restore(-1).error_code(), StatusCode::NOT_FOUND);
  EXPECT_EQ(Restore(99).error_code(), StatusCode::NOT_FOUND);
  ASSERT_TRUE(Rename("other", "ben").ok());
  EXPECT_EQ(Restore(first, etag).error_code(), StatusCode::ABORTED);
  EXPECT_EQ(field_, "if_match");
  EXPECT_EQ(Get(0).display_name(), "other");
  ASSERT_TRUE(Restore(first, object_.etag().empty() ? Get(0).etag() : object_.etag()).ok());
}

TEST_F(ObjectHistory, TemplatesAreSentInPagesAsTheyAreStored) {
  v1::ListViewTemplatesRequest request;
  request.set_name("objects/box");
  request.set_page_size(40);
  v1::ListViewTemplatesResponse page;
  // The stand-in for recognition keeps none.
  EXPECT_EQ(Call(&Stub::ListViewTemplates, request, &page, "arm").error_code(),
            StatusCode::FAILED_PRECONDITION);
  server_ = nullptr;
  auto server = HoropterServer::Start(
                    Catalog::Open(dir_.File("a.db")).value(), CatalogPreparer(), nullptr, options_)
                    .value();
  const auto real = v1::CatalogService::NewStub(server->InProcessChannel());
  v1::RebuildObjectRequest rebuild;  // else it is done beside what is served, some time
  rebuild.set_name("objects/box");
  v1::RebuildObjectResponse rebuilt;
  ASSERT_TRUE(CallOf(*real, &Stub::RebuildObject, rebuild, &rebuilt).ok());

  std::set<std::string> seen;
  int templates = 0;
  do {
    ASSERT_TRUE(CallOf(*real, &Stub::ListViewTemplates, request, &page, "arm").ok());
    ASSERT_LE(page.templates_size(), 40);
    templates += page.templates_size();
    for (const v1::ViewTemplate& view : page.templates()) {
      seen.insert(view.camera_from_object().SerializeAsString());
      ASSERT_EQ(view.points_px_size(), 2 * view.kinds_size());
      ASSERT_EQ(view.directions_rad_size(), view.kinds_size());
      ASSERT_LE(view.kinds_size(), 220);
      for (int i = 0; i < view.points_px_size(); ++i) {
        ASSERT_GE(view.points_px(i), -0.5f);
        ASSERT_LE(view.points_px(i), static_cast<float>(page.width_px()) - 0.5f);
      }
    }
    request.set_page_token(page.next_page_token());
  } while (!page.next_page_token().empty());
  EXPECT_EQ(templates, page.total_size());
  EXPECT_EQ(seen.size(), static_cast<size_t>(page.total_size()));
  EXPECT_GT(templates, 40);

  for (const char* token : {"v1.", "v1.0", "v1.x", "v1.100000", "box"}) {
    request.set_page_token(token);
    EXPECT_EQ(CallOf(*real, &Stub::ListViewTemplates, request, &page).error_code(),
              StatusCode::INVALID_ARGUMENT)
        << token;
    EXPECT_EQ(field_, "page_token");
  }
  request.clear_page_token();
  request.set_page_size(-1);
  EXPECT_EQ(CallOf(*real, &Stub::ListViewTemplates, request, &page).error_code(),
            StatusCode::INVALID_ARGUMENT);
  request.set_page_size(0);
  ASSERT_TRUE(CallOf(*real, &Stub::ListViewTemplates, request, &page).ok());
  EXPECT_EQ(page.templates_size(), 24);
  request.set_name("objects/none");
  EXPECT_EQ(CallOf(*real, &Stub::ListViewTemplates, request, &page).error_code(),
            StatusCode::NOT_FOUND);
}

}  // namespace
}  // namespace horopter
