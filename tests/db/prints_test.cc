// Learnt prints: an optional part of an object, kept with its versions, gone with its surface.
#include <gtest/gtest.h>
#include <sqlite3.h>

#include "db/blob.h"
#include "db/catalog.h"
#include "db/version_blob.h"
#include "tests/support/catalog_contract.h"
#include "tests/support/sample_record.h"

namespace horopter {
namespace {

class Prints : public CatalogContract {};

SurfacePrint Some(int places, float first) {
  SurfacePrint print;
  print.views = 3;
  for (int i = 0; i < places; ++i)
    print.places.push_back({{0.01f * first, 0.001f * i, 0.02f}, {0.0f, 0.6f, 0.8f}, 0.25f * first});
  return print;
}

CatalogRecord With(CatalogRecord record, SurfacePrint print) {
  record.model.print = std::move(print);
  return record;
}

TEST_P(Prints, AreWrittenReadAndRemovedByThemselves) {
  const std::string place = NewPlace();
  auto catalog = Open(place);
  const CatalogRecord plain = SampleRecord("box"), printed = With(plain, Some(40, 1.0f));
  ASSERT_TRUE(catalog->CreateObject(plain).ok());
  EXPECT_TRUE(catalog->GetObject("box").value().model.print.places.empty()) << "none by default";
  // Where it is not asked for nothing of it is written.
  ASSERT_TRUE(catalog->UpdateObject(printed, {.grasps = true}).ok());
  EXPECT_TRUE(catalog->GetObject("box").value().model.print.places.empty());
  ASSERT_TRUE(catalog->UpdateObject(printed, {.print = true}).ok());
  catalog = nullptr;
  catalog = Open(place);
  EXPECT_EQ(FirstDifference(catalog->GetObject("box").value(), printed), "");
  EXPECT_TRUE(SamePrint(catalog->LoadObject("box").value().model.print, printed.model.print))
      << "for recognition";
  ASSERT_TRUE(catalog->UpdateObject(plain, {.print = true}).ok());
  EXPECT_EQ(FirstDifference(catalog->GetObject("box").value(), plain), "");
}

TEST_P(Prints, AnObjectMayBeMadeWithOneAndLosesItWithTheObject) {
  auto catalog = Open(NewPlace());
  const CatalogRecord printed = With(SampleRecord("box"), Some(10, 1.0f));
  ASSERT_TRUE(catalog->CreateObject(printed).ok());
  EXPECT_EQ(FirstDifference(catalog->GetObject("box").value(), printed), "");
  ASSERT_TRUE(catalog->DeleteObject("box").ok());
  ASSERT_TRUE(catalog->CreateObject(SampleRecord("box")).ok());
  EXPECT_TRUE(catalog->GetObject("box").value().model.print.places.empty());
}

TEST_P(Prints, VersionsKeepThem) {
  auto catalog = Open(NewPlace());
  const CatalogRecord plain = SampleRecord("box");
  ASSERT_TRUE(catalog->CreateObject(plain).ok());
  ASSERT_TRUE(catalog->UpdateObject(With(plain, Some(10, 1.0f)), {.print = true}).ok());
  ASSERT_TRUE(catalog->UpdateObject(With(plain, Some(12, -1.0f)), {.print = true}).ok());
  ASSERT_TRUE(catalog->UpdateObject(With(plain, Some(12, -1.0f)), {.print = true}).ok());
  const auto versions = catalog->ListVersions("box").value();
  ASSERT_EQ(versions.size(), 3u) << "a write that changes nothing keeps nothing";
  EXPECT_TRUE(versions[0].changed && versions[0].changed->print);
  EXPECT_FALSE(versions[0].changed->geometry || versions[0].changed->labels);
  const auto print_of = [&](int i) {
    return catalog->GetVersion("box", versions[i].summary.record.revision).value().model.print;
  };
  EXPECT_TRUE(SamePrint(print_of(0), Some(12, -1.0f)));
  EXPECT_TRUE(SamePrint(print_of(1), Some(10, 1.0f)));
  EXPECT_TRUE(SamePrint(print_of(2), {}));
}

TEST_P(Prints, AreGoneWithTheSurfaceAndTheSymmetriesTheyWereLearntUnder) {
  auto catalog = Open(NewPlace());
  const CatalogRecord printed = With(SampleRecord("box"), Some(10, 1.0f));
  ASSERT_TRUE(catalog->CreateObject(printed).ok());
  CatalogRecord other = SampleRecord("box", 2);
  ASSERT_TRUE(catalog->UpdateObject(other, {.geometry = true}).ok());
  EXPECT_TRUE(catalog->GetObject("box").value().model.print.places.empty());
  ASSERT_TRUE(catalog->UpdateObject(With(other, Some(10, 1.0f)), {.print = true}).ok());
  other.model.symmetries.clear();
  ASSERT_TRUE(catalog->UpdateObject(other, {.symmetries = true}).ok());
  EXPECT_TRUE(catalog->GetObject("box").value().model.print.places.empty());
  ASSERT_TRUE(catalog->UpdateObject(With(other, Some(10, 1.0f)), {.print = true}).ok());
  ASSERT_TRUE(catalog->UpdateObject(other, {.labels = true}).ok());
  EXPECT_EQ(catalog->GetObject("box").value().model.print.places.size(), 10u);
  // Both at once: the print is of the new surface.
  ASSERT_TRUE(catalog
                  ->UpdateObject(With(SampleRecord("box", 3), Some(11, 1.0f)),
                                 {.geometry = true, .symmetries = true, .print = true})
                  .ok());
  EXPECT_EQ(catalog->GetObject("box").value().model.print.places.size(), 11u);
}

TEST_P(Prints, WhatIsNoPrintIsRefusedByItsField) {
  auto catalog = Open(NewPlace());
  const auto refused = [&](const SurfacePrint& print) {
    const absl::Status status = catalog->CreateObject(With(SampleRecord("box"), print));
    return absl::IsInvalidArgument(status) && status.message().substr(0, 6) == "print.";
  };
  SurfacePrint bad = Some(3, 1.0f);
  bad.places[1].normal.setZero();
  EXPECT_TRUE(refused(bad));
  bad = Some(3, 1.0f);
  bad.places[2].brightness = 1.5f;
  EXPECT_TRUE(refused(bad));
  bad = Some(3, 1.0f);
  bad.places[0].point.x() = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(refused(bad));
  bad = Some(3, 1.0f);
  bad.views = -1;
  EXPECT_TRUE(refused(bad));
  EXPECT_TRUE(refused(Some(static_cast<int>(kMaxPrintPlaces) + 1, 1.0f)));
}

INSTANTIATE_TEST_SUITE_P(Stores, Prints, EveryStore(), NameOfStore);

TEST(PrintBlob, IsReadAsItWasWrittenAndNotWhenCutOff) {
  const std::string blob = EncodePrint(Some(5, 1.0f));
  EXPECT_TRUE(SamePrint(DecodePrint(blob).value(), Some(5, 1.0f)));
  for (size_t size = 0; size < blob.size(); ++size)
    EXPECT_FALSE(DecodePrint(std::string_view(blob).substr(0, size)).ok()) << size;
  EXPECT_FALSE(DecodePrint(blob + "x").ok());
}

// Servers of before read the versions of objects that have none.
TEST(PrintBlob, DetailsOfAVersionWithoutOneAreAsTheyWere) {
  ObjectSummary summary;
  summary.record = SampleRecord("box");
  const std::string plain = EncodeDetails(summary);
  EXPECT_EQ(plain[4], 1);
  summary.record.model.print = Some(5, 1.0f);
  const std::string printed = EncodeDetails(summary);
  EXPECT_EQ(printed[4], 2);
  EXPECT_TRUE(SamePrint(DecodeDetails(printed).value().record.model.print, Some(5, 1.0f)));
  for (size_t size = plain.size(); size < printed.size(); ++size)
    EXPECT_FALSE(DecodeDetails(std::string_view(printed).substr(0, size)).ok()) << size;
}

TEST(PrintBlob, DamageIsToldForItsObjectAlone) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  {
    auto catalog = Catalog::Open(path).value();
    ASSERT_TRUE(catalog->CreateObject(With(SampleRecord("box"), Some(5, 1.0f))).ok());
    ASSERT_TRUE(catalog->CreateObject(SampleRecord("nut")).ok());
  }
  sqlite3* db = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &db), SQLITE_OK);
  constexpr char kZeros[] = "UPDATE surface_print SET data = zeroblob(length(data))";
  ASSERT_EQ(sqlite3_exec(db, kZeros, nullptr, nullptr, nullptr), SQLITE_OK);
  sqlite3_close(db);
  auto catalog = Catalog::Open(path).value();
  EXPECT_TRUE(absl::IsDataLoss(catalog->GetObject("box").status()));
  EXPECT_TRUE(catalog->GetObject("nut").ok());
  const auto loaded = catalog->LoadObjects("", 10).value();
  ASSERT_EQ(loaded.size(), 2u);
  EXPECT_FALSE(loaded[0].damage.ok());
  EXPECT_TRUE(loaded[1].damage.ok());
  EXPECT_EQ(catalog->ListObjects("", 10).value().size(), 2u);
}

}  // namespace
}  // namespace horopter
