// Who may call what, and that nothing a client sends breaks a line of the log.
#include "server/service/access.h"

#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <spdlog/logger.h>
#include <spdlog/sinks/ostream_sink.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <thread>

#include "horopter/v1/server.grpc.pb.h"
#include "server/base/sha256.h"
#include "server/service/log_format.h"
#include "server/service/rpc_status.h"
#include "tests/support/scratch_dir.h"
#include "tests/support/service_fixture.h"

namespace horopter {
namespace {

using testing::HasSubstr;

const std::string kRobotLine = "robot cell-3 sha256:" + Sha256Hex("robot-token");
const std::string kAdminLine = "admin workshop sha256:" + Sha256Hex("admin-token");

void Write(const std::string& path, const std::string& text) {
  std::ofstream(path + ".new") << text;
  std::filesystem::rename(path + ".new", path);
}

TEST(AccessList, HoldsTokensAndCertificatesWithTheirRoles) {
  const auto list =
      ParseAccessList("# cell\n" + kRobotLine + " until=2026-12-31 # temporary\n\n" + kAdminLine +
                      "\r\nrobot arm cert:arm.cell\n" + "teacher line cert:line.cell\n");
  ASSERT_TRUE(list.ok()) << list.status();
  EXPECT_EQ(list->by_hash.size(), 2u);
  EXPECT_EQ(list->by_hash.at(Sha256Hex("robot-token")).caller.name, "cell-3");
  EXPECT_EQ(list->by_hash.at(Sha256Hex("robot-token")).until,
            absl::FromCivil(absl::CivilDay(2027, 1, 1), absl::UTCTimeZone()));
  EXPECT_EQ(list->by_hash.at(Sha256Hex("admin-token")).caller.role, Role::kAdmin);
  EXPECT_EQ(list->by_certificate.at("arm.cell").caller.role, Role::kRobot);
  EXPECT_EQ(list->by_certificate.at("line.cell").caller.role, Role::kTeacher);
}

TEST(AccessList, EachBadLineIsRefusedByItsNumber) {
  for (const std::string& bad : {std::string("robot"),
                                 std::string("robot a"),
                                 "king a sha256:" + Sha256Hex("x"),
                                 "robot a/b sha256:" + Sha256Hex("x"),
                                 std::string("robot a sha256:12"),
                                 std::string("robot a sha256:") + std::string(64, 'G'),
                                 std::string("robot a token"),
                                 std::string("robot a cert:"),
                                 std::string("robot a cert:x until=2026-01-01"),
                                 kAdminLine + " until=tomorrow",
                                 kAdminLine + " until=2026-01-01 more",
                                 kRobotLine}) {
    const auto list = ParseAccessList(kRobotLine + "\n\n" + bad + "\n");
    EXPECT_EQ(list.status().code(), absl::StatusCode::kInvalidArgument) << bad;
    EXPECT_THAT(std::string(list.status().message()), HasSubstr("line 3")) << bad;
  }
}

class AccessTest : public testing::Test {
 protected:
  void SetUp() override {
    Write(file_, kRobotLine + " until=2026-12-31\n" + kAdminLine + "\nrobot arm cert:arm\n");
    auto opened = Access::Open({.file = file_});
    ASSERT_TRUE(opened.ok()) << opened.status();
    access_ = *std::move(opened);
  }
  absl::StatusCode Try(const std::string& authorization, const std::string& cert, Role needed) {
    return access_->Authorize(authorization, cert, needed, now_).status().code();
  }

  const ScratchDir dir_;
  const std::string file_ = dir_.File("access");
  absl::Time now_ = absl::FromCivil(absl::CivilDay(2026, 6, 1), absl::UTCTimeZone());
  std::unique_ptr<Access> access_;
};

TEST_F(AccessTest, ARobotReadsAndAnAdminWrites) {
  EXPECT_EQ(Try("Bearer robot-token", "", Role::kRobot), absl::StatusCode::kOk);
  EXPECT_EQ(Try("Bearer robot-token", "", Role::kAdmin), absl::StatusCode::kPermissionDenied);
  EXPECT_EQ(Try("bearer admin-token", "", Role::kRobot), absl::StatusCode::kOk);
  EXPECT_EQ(Try("Bearer admin-token", "", Role::kAdmin), absl::StatusCode::kOk);
  EXPECT_EQ(access_->Authorize("Bearer admin-token", "", Role::kAdmin, now_)->name, "workshop");
}

TEST_F(AccessTest, NoUnknownOrExpiredTokenIsUnauthenticated) {
  constexpr auto kNobody = absl::StatusCode::kUnauthenticated;
  EXPECT_EQ(Try("", "", Role::kRobot), kNobody);
  EXPECT_EQ(Try("Bearer guess", "", Role::kRobot), kNobody);
  EXPECT_EQ(Try("Bearer ", "", Role::kRobot), kNobody);
  EXPECT_EQ(Try("Basic robot-token", "", Role::kRobot), kNobody);
  EXPECT_EQ(Try("robot-token", "", Role::kRobot), kNobody);
  now_ = absl::FromCivil(absl::CivilDay(2027, 1, 1), absl::UTCTimeZone());
  EXPECT_EQ(Try("Bearer robot-token", "", Role::kRobot), kNobody);
  EXPECT_EQ(Try("Bearer admin-token", "", Role::kRobot), absl::StatusCode::kOk);
}

TEST_F(AccessTest, ARefusalKnowsWhomItRefusesAsFarAsThatIsKnown) {
  const auto refused = [&](const std::string& authorization, const std::string& certificate) {
    return CallerOf(access_->Authorize(authorization, certificate, Role::kAdmin, now_).status());
  };
  EXPECT_EQ(refused("Bearer robot-token", ""), "cell-3");
  EXPECT_EQ(refused("", "arm"), "arm");
  EXPECT_EQ(refused("Bearer guess", ""), "");
  EXPECT_EQ(refused("", ""), "");
  now_ = absl::FromCivil(absl::CivilDay(2027, 1, 1), absl::UTCTimeZone());
  EXPECT_EQ(refused("Bearer robot-token", ""), "cell-3");  // expired
  const auto reader = *Access::Open({.file = file_, .admin_calls = false});
  const absl::Status closed =
      reader->Authorize("Bearer admin-token", "", Role::kAdmin, now_).status();
  EXPECT_TRUE(absl::IsPermissionDenied(closed));
  EXPECT_EQ(CallerOf(closed), "workshop");
}

TEST_F(AccessTest, ACertificateIsAnIdentityAndATokenGoesBeforeIt) {
  EXPECT_EQ(Try("", "arm", Role::kRobot), absl::StatusCode::kOk);
  EXPECT_EQ(Try("", "arm", Role::kAdmin), absl::StatusCode::kPermissionDenied);
  EXPECT_EQ(Try("", "leg", Role::kRobot), absl::StatusCode::kUnauthenticated);
  EXPECT_EQ(Try("Bearer admin-token", "arm", Role::kAdmin), absl::StatusCode::kOk);
  EXPECT_EQ(Try("Bearer guess", "arm", Role::kRobot), absl::StatusCode::kUnauthenticated);
}

TEST_F(AccessTest, AChangedFileCountsWithoutARestartAndADamagedOneDoesNot) {
  const auto await = [&](const std::string& authorization, absl::StatusCode code) {
    for (int i = 0; i < 500 && Try(authorization, "", Role::kRobot) != code; ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
    return Try(authorization, "", Role::kRobot) == code;
  };
  Write(file_, kRobotLine + "\nrobot second sha256:" + Sha256Hex("second") + "\n");
  EXPECT_TRUE(await("Bearer second", absl::StatusCode::kOk));
  EXPECT_EQ(Try("Bearer admin-token", "", Role::kRobot), absl::StatusCode::kUnauthenticated);
  Write(file_, "damaged\n");
  std::this_thread::sleep_for(std::chrono::milliseconds(1500));
  EXPECT_EQ(Try("Bearer second", "", Role::kRobot), absl::StatusCode::kOk);
  Write(file_, kAdminLine + "\n");
  EXPECT_TRUE(await("Bearer second", absl::StatusCode::kUnauthenticated));
}

TEST(Access, WithoutAFileAllMayDoAllUnlessAdminCallsAreOff) {
  const auto now = absl::Now();
  EXPECT_EQ((*Access::Open({}))->Authorize("", "", Role::kAdmin, now).status().code(),
            absl::StatusCode::kOk);
  const auto off = *Access::Open({.admin_calls = false});
  EXPECT_TRUE(off->Authorize("", "", Role::kRobot, now).ok());
  EXPECT_EQ(off->Authorize("", "", Role::kAdmin, now).status().code(),
            absl::StatusCode::kPermissionDenied);
  EXPECT_EQ(Access::Open({.file = "/nowhere/access"}).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

// Which calls a robot may make; a method that is added needs an admin until it says otherwise.
class Roles : public testing::Test {
 protected:
  void SetUp() override {
    Write(file_, kRobotLine + "\n" + kAdminLine + "\n");
    options_.access_file = file_;
    options_.telemetry.audit_log = audit_;
    server_ = std::make_unique<TestServer>(Recognizer(), options_);
  }
  template <typename Request, typename Response, typename Method>
  grpc::StatusCode Call(Method method, const Request& request, const std::string& token) {
    grpc::ClientContext context;
    if (!token.empty()) context.AddMetadata("authorization", "Bearer " + token);
    Response response;
    return (server_->catalog().*method)(&context, request, &response).error_code();
  }
  grpc::StatusCode Create(const std::string& id, const std::string& token) {
    v1::CreateObjectRequest request;
    request.set_object_id(id);
    *request.mutable_object() = SampleObject("box");
    return Call<v1::CreateObjectRequest, v1::Object>(
        &v1::CatalogService::Stub::CreateObject, request, token);
  }
  grpc::StatusCode List(const std::string& token) {
    return Call<v1::ListObjectsRequest, v1::ListObjectsResponse>(
        &v1::CatalogService::Stub::ListObjects, {}, token);
  }

  const ScratchDir dir_;
  const std::string file_ = dir_.File("access"), audit_ = dir_.File("audit");
  ServerOptions options_;
  std::unique_ptr<TestServer> server_;
};

TEST_F(Roles, EachCallIsRefusedWithTheRightCode) {
  using Stub = v1::CatalogService::Stub;
  EXPECT_EQ(List(""), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(List("robot-token"), grpc::StatusCode::OK);
  EXPECT_EQ(Create("box", ""), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(Create("box", "robot-token"), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(Create("box", "admin-token"), grpc::StatusCode::OK);
  v1::DeleteObjectRequest remove;
  remove.set_name("objects/box");
  EXPECT_EQ((Call<v1::DeleteObjectRequest, google::protobuf::Empty>(
                &Stub::DeleteObject, remove, "robot-token")),
            grpc::StatusCode::PERMISSION_DENIED);
  v1::UpdateObjectRequest update;
  EXPECT_EQ((Call<v1::UpdateObjectRequest, v1::Object>(&Stub::UpdateObject, update, "robot-token")),
            grpc::StatusCode::PERMISSION_DENIED);
  v1::RebuildObjectRequest rebuild;
  EXPECT_EQ((Call<v1::RebuildObjectRequest, v1::RebuildObjectResponse>(
                &Stub::RebuildObject, rebuild, "robot-token")),
            grpc::StatusCode::PERMISSION_DENIED);
  v1::ImportObjectRequest import;
  EXPECT_EQ((Call<v1::ImportObjectRequest, v1::ImportObjectResponse>(
                &Stub::ImportObject, import, "robot-token")),
            grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ((Call<v1::ImportObjectRequest, v1::ImportObjectResponse>(
                &Stub::ImportObject, import, "admin-token")),
            grpc::StatusCode::INVALID_ARGUMENT);
  grpc::ClientContext context;
  context.AddMetadata("authorization", "Bearer robot-token");
  v1::BackupCatalogResponse chunk;
  const auto backup = server_->catalog().BackupCatalog(&context, {});
  EXPECT_FALSE(backup->Read(&chunk));
  EXPECT_EQ(backup->Finish().error_code(), grpc::StatusCode::PERMISSION_DENIED);
}

TEST_F(Roles, TheServersInfoIsNotForStrangers) {
  const auto stub = v1::ServerService::NewStub(server_->channel());
  grpc::ClientContext stranger, robot;
  robot.AddMetadata("authorization", "Bearer robot-token");
  v1::ServerInfo info;
  EXPECT_EQ(stub->GetServerInfo(&stranger, {}, &info).error_code(),
            grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_TRUE(stub->GetServerInfo(&robot, {}, &info).ok());
}

TEST_F(Roles, WritesAreAuditedWithTheCallerAlsoWhenTheyAreRefusedAndReadsAreNot) {
  List("robot-token");
  Create("box", "robot-token");
  Create("box", "admin-token");
  Create("a\nb\",\"caller\":\"x", "admin-token");
  std::ifstream file(audit_);
  std::vector<std::string> lines;
  for (std::string line; std::getline(file, line);) lines.push_back(line);
  ASSERT_EQ(lines.size(), 3u);
  EXPECT_THAT(lines[0], HasSubstr("\"code\":\"PERMISSION_DENIED\""));
  EXPECT_THAT(lines[0], HasSubstr("\"caller\":\"cell-3\""));
  EXPECT_THAT(lines[1], HasSubstr("\"caller\":\"workshop\""));
  EXPECT_THAT(lines[1], HasSubstr("\"code\":\"OK\""));
  EXPECT_THAT(lines[1], HasSubstr("\"resource\":\"box\""));
  EXPECT_THAT(lines[2], HasSubstr("a\\nb\\\",\\\"caller"));
}

TEST(LogFormat, OneMessageIsOneLineWhateverIsInIt) {
  std::ostringstream out;
  spdlog::logger log("test", std::make_shared<spdlog::sinks::ostream_sink_st>(out));
  log.set_formatter(OneLineFormatter());
  log.info("name={}", "a\n[2026-01-01 00:00:00.000] [info] forged\r\x1b[31m");
  const std::string text = out.str();
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 1) << text;
  EXPECT_EQ(text.find('\r'), std::string::npos);
  EXPECT_EQ(text.find('\x1b'), std::string::npos);
  EXPECT_THAT(text, HasSubstr("a\\x0a[2026"));
  EXPECT_EQ(Quoted("a\"b\\c\n"), "\"a\\\"b\\\\c\\x0a\"");
}

TEST(ServerOptionsTest, OtherMachinesAreListenedToWithTlsOrWhenThatIsSaid) {
  ServerOptions options;
  for (const char* local :
       {"localhost:1", "127.0.0.1:1", "127.1.2.3:0", "[::1]:5", "unix:/run/s", ""}) {
    options.listen = local;
    EXPECT_TRUE(Validate(options).ok()) << local;
  }
  for (const char* open : {"0.0.0.0:1", "[::]:1", "cell-pc:1", "10.0.0.7:1", "127.evil.com:1"}) {
    options = {};
    options.listen = open;
    EXPECT_EQ(Validate(options).code(), absl::StatusCode::kInvalidArgument) << open;
    options.insecure = true;
    EXPECT_TRUE(Validate(options).ok()) << open;
    options.insecure = false;
    // With TLS everybody may still do everything, unless there is an access file or it is meant.
    options.tls.certificate = "server.pem";
    EXPECT_EQ(Validate(options).code(), absl::StatusCode::kInvalidArgument) << open;
    options.open_access = true;
    EXPECT_TRUE(Validate(options).ok()) << open;
    options.open_access = false;
    options.access_file = "access";
    EXPECT_TRUE(Validate(options).ok()) << open;
    options = {};
    options.admin_listen = open;
    EXPECT_EQ(Validate(options).code(), absl::StatusCode::kInvalidArgument) << open;
  }
}

TEST(AdminListener, AloneServesAdminCallsAndItsSocketIsForItsOwnerAlone) {
  const ScratchDir dir;
  ServerOptions options;
  options.admin_listen = "unix:" + dir.File("admin.sock");
  TestServer server(Recognizer(), options);
  EXPECT_FALSE(server.Enrol("box"));
  const auto admin = v1::CatalogService::NewStub(
      grpc::CreateChannel(options.admin_listen, grpc::InsecureChannelCredentials()));
  v1::CreateObjectRequest request;
  request.set_object_id("box");
  *request.mutable_object() = SampleObject("box");
  v1::Object object;
  grpc::ClientContext write, read;
  EXPECT_TRUE(admin->CreateObject(&write, request, &object).ok());
  v1::GetObjectRequest get;
  get.set_name("objects/box");
  EXPECT_TRUE(server.catalog().GetObject(&read, get, &object).ok());
  const auto mode = std::filesystem::status(dir.File("admin.sock")).permissions();
  EXPECT_EQ(mode & (std::filesystem::perms::group_all | std::filesystem::perms::others_all),
            std::filesystem::perms::none);
}

}  // namespace
}  // namespace horopter
