// Variants of the methods, chosen by an operator for one request: through the service and the whole
// pipeline, on a sample scene.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <map>

#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/pipeline/variants.h"
#include "server/service/rpc_status.h"
#include "tests/support/service_fixture.h"

namespace horopter {
namespace {

using testing::HasSubstr;

constexpr char kDataset[] = HOROPTER_TEST_DATA "/parts";
constexpr int kScene = 5;

// Counts by stage and name of an answer.
using Counts = std::map<std::string, std::map<std::string, double>>;

class Variants : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    const BopDataset dataset = ReadBopDataset(kDataset).value();
    const BopScene scene = ReadBopScene(kDataset, "val", kScene).value();
    for (const BopObject& object : dataset.objects) {
      if (object.obj_id != scene.images[0].instances[0].obj_id) continue;
      CadImport cad = ImportCad(object.cad_path).value();
      cad.model.id = "part";
      catalog_.objects.push_back(PrepareCatalogObject(std::move(cad.model)).value());
    }
    for (const BopImage& image : scene.images) {
      std::ifstream file(image.path, std::ios::binary);
      request_.add_images()->set_content(
          std::string(std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()));
    }
  }
  static void TearDownTestSuite() {
    catalog_ = {};
    request_ = {};
  }

  explicit Variants(bool allowed = true)
      : server_(
            [](const SceneRequest& request, const CatalogSnapshot&, const CallLimits& limits) {
              return RecognizeScene(request, catalog_, {}, limits.stop);
            },
            [&] {
              ServerOptions options;
              options.allow_variants = allowed;
              return options;
            }()) {}

  grpc::Status Recognize(const std::string& variants, Counts* counts) {
    context_ = std::make_unique<grpc::ClientContext>();
    if (!variants.empty()) context_->AddMetadata(kVariantsKey, variants);
    v1::RecognizeSceneResponse response;
    const grpc::Status status =
        server_.recognition().RecognizeScene(context_.get(), request_, &response);
    if (counts != nullptr) {
      counts->clear();
      for (const v1::StageReport& stage : response.stages())
        for (const auto& [name, count] : stage.counts()) (*counts)[stage.stage()][name] = count;
      objects_ = response.objects_size();
    }
    return status;
  }

  static v1::RecognizeSceneRequest request_;
  static CatalogSnapshot catalog_;
  TestServer server_;
  std::unique_ptr<grpc::ClientContext> context_;
  int objects_ = -1;
};

v1::RecognizeSceneRequest Variants::request_;
CatalogSnapshot Variants::catalog_;

class RefusedVariants : public Variants {
 protected:
  RefusedVariants() : Variants(false) {}
};

TEST_F(RefusedVariants, AServerThatIsNotToldToTakesNone) {
  const grpc::Status status = Recognize("conic_fit=orthogonal", nullptr);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_THAT(status.error_message(), HasSubstr("--allow-variants"));
  EXPECT_EQ(Trailing(*context_, kErrorFieldKey), kVariantsKey);
}

TEST_F(Variants, UnknownOnesAreInvalid) {
  const grpc::Status status = Recognize("conic_fit=by_eye", nullptr);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_THAT(status.error_message(), HasSubstr("conic_fit=orthogonal"));
}

TEST_F(Variants, AreThoseOfOneRequest) {
  Counts plain, varied, again;
  ASSERT_TRUE(Recognize("", &plain).ok());
  EXPECT_EQ(objects_, 1);
  EXPECT_EQ(plain["features"].count("arcs_refitted"), 0u);
  ASSERT_TRUE(Recognize("splitting=curvature_templates,conic_fit=orthogonal", &varied).ok());
  EXPECT_EQ(varied["features"].count("arcs_refitted"), 1u);
  EXPECT_NE(varied["features"]["segments"], plain["features"]["segments"]);
  Counts drawn;
  ASSERT_TRUE(Recognize("detector=edge_drawing", &drawn).ok());
  EXPECT_NE(drawn["features"]["lines_detected"], plain["features"]["lines_detected"]);
  ASSERT_TRUE(Recognize("", &again).ok());
  EXPECT_EQ(again["features"], plain["features"]);
}

TEST_F(Variants, TheProjectiveRouteAloneWithEachOfItsVariants) {
  for (const char* variants : {"routes=projective",
                               "routes=projective,association=axes",
                               "routes=projective,line_sets=verify",
                               "routes=projective,decomposition=per_object",
                               "routes=projective,decomposition=images"}) {
    Counts counts;
    const grpc::Status status = Recognize(variants, &counts);
    ASSERT_TRUE(status.ok()) << variants << ": " << status.error_message();
    EXPECT_EQ(counts["recognition"].count("seconds_projective_route"), 1u) << variants;
    EXPECT_EQ(counts["recognition"].count("seconds_metric_route"), 0u) << variants;
    EXPECT_EQ(counts["recognition"].count("seconds_view_hypotheses"), 0u) << variants;
  }
}

}  // namespace
}  // namespace horopter
