// The parts of a BOP dataset with exact CAD beside meshes: both roads must give the same part.
#include <gtest/gtest.h>

#include <string>

#include "client/bop_dataset.h"
#include "client/cad_import.h"

namespace horopter {
namespace {

// Every element of `a` is in `b` within `tolerance_m` at the part's size and half a degree.
bool Contains(const std::vector<Rigid3>& b, const Rigid3& a, double diameter_m) {
  for (const Rigid3& s : b) {
    if ((s.R - a.R).norm() < 0.01 && (s.t - a.t).norm() < 0.002 * diameter_m) return true;
  }
  return false;
}

class SampleParts : public testing::TestWithParam<int> {};

TEST_P(SampleParts, StepAndMeshGiveTheSamePart) {
  const auto dataset = ReadBopDataset(HOROPTER_TEST_DATA "/parts");
  ASSERT_TRUE(dataset.ok()) << dataset.status();
  const BopObject* object = dataset->Find(GetParam());
  ASSERT_NE(object, nullptr);
  const auto step = ImportCad(object->cad_path);
  const auto mesh = ImportCad(object->mesh_path);
  ASSERT_TRUE(step.ok()) << step.status();
  ASSERT_TRUE(mesh.ok()) << mesh.status();
  EXPECT_EQ(step->unit_name, "mm");
  EXPECT_TRUE(step->unit_from_file);
  EXPECT_TRUE(step->warnings.empty()) << step->warnings[0];
  EXPECT_TRUE(mesh->warnings.empty()) << mesh->warnings[0];
  for (const char* what : {"vertices", "lines", "circles", "other_curves", "symmetries"}) {
    EXPECT_EQ(step->counts.at(what), mesh->counts.at(what)) << what;
  }
  for (const auto* import : {&*step, &*mesh}) {
    EXPECT_NEAR(import->model.diameter_m, object->diameter_m, 2e-4 * object->diameter_m);
    EXPECT_EQ(import->model.symmetries.size(), object->symmetries.size()) << import->format;
    for (const Rigid3& s : object->symmetries) {
      EXPECT_TRUE(Contains(import->model.symmetries, s, object->diameter_m)) << import->format;
    }
  }
  RecordProperty("counts", testing::PrintToString(step->counts));
}

INSTANTIATE_TEST_SUITE_P(All, SampleParts, testing::Range(1, 21));

}  // namespace
}  // namespace horopter
