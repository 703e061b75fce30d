#include "db/catalog.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

#include "db/object_digest.h"
#include "server/base/sha256.h"
#include "tests/support/catalog_contract.h"
#include "tests/support/sample_record.h"

namespace horopter {
namespace {

class CatalogRows : public CatalogContract {};

using absl::StatusCode;

std::vector<std::string> Ids(Catalog& catalog) {
  std::vector<std::string> ids;
  const auto objects = catalog.LoadObjects("", 1000);
  EXPECT_TRUE(objects.ok()) << objects.status();
  for (const LoadedObject& object : *objects) ids.push_back(object.model.id);
  return ids;
}

TEST_P(CatalogRows, GivesBackBitByBitWhatItWasGivenAlsoAfterReopening) {
  const std::string place = NewPlace();
  const CatalogRecord record = SampleRecord("box", 7);
  for (const bool create : {true, false}) {
    const std::unique_ptr<Catalog> catalog = Open(place);
    if (create) {
      ASSERT_TRUE(catalog->CreateObject(record).ok());
    }
    const auto read = catalog->GetObject("box");
    ASSERT_TRUE(read.ok()) << read.status();
    EXPECT_EQ(FirstDifference(*read, record), "");
    EXPECT_EQ(read->source.sha256, Sha256Hex(record.source.content));
    EXPECT_EQ(*catalog->GetCadFile("box"), record.source.content);
    const auto objects = catalog->LoadObjects("", 10);
    ASSERT_EQ(objects->size(), 1u);
    EXPECT_EQ((*objects)[0].model.mesh.triangles, record.model.mesh.triangles);
  }
}

TEST_P(CatalogRows, ManyObjectsAreCreatedTogetherOrNotAtAll) {
  auto catalog = Open(NewPlace());
  std::vector<Catalog::NewObject> objects;
  for (int i = 0; i < 3; ++i) objects.push_back({SampleRecord("part-" + std::to_string(i), i), {}});
  ASSERT_TRUE(catalog->CreateObjects(objects).ok());
  EXPECT_EQ(FirstDifference(catalog->GetObject("part-1").value(), SampleRecord("part-1", 1)), "");
  objects[0].record.model.id = "new";  // the others are there already
  EXPECT_EQ(catalog->CreateObjects(objects).code(), absl::StatusCode::kAlreadyExists);
  EXPECT_EQ(*catalog->CountObjects(), 3);
}

TEST_P(CatalogRows, DerivedDataAndKeysGoTogetherAndKeysAreReadAlone) {
  auto catalog = Open(NewPlace());
  const std::string keys("k\0s", 3);
  ASSERT_TRUE(catalog->CreateObject(SampleRecord("b", 1), {7, "data", keys}).ok());
  ASSERT_TRUE(catalog->CreateObject(SampleRecord("a", 2)).ok());
  const auto all = catalog->LoadKeys("", 10);
  ASSERT_TRUE(all.ok()) << all.status();
  ASSERT_EQ(all->size(), 2u);
  EXPECT_EQ((*all)[0].id, "a");
  EXPECT_EQ((*all)[0].keys, "");
  EXPECT_EQ((*all)[1].keys, keys);
  EXPECT_EQ((*all)[1].version, 7);
  EXPECT_EQ((*all)[1].vertex_count, 8);
  EXPECT_EQ(catalog->LoadKeys("a", 10)->size(), 1u);
  EXPECT_EQ(catalog->LoadKeys("", 0).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(catalog->LoadObject("b")->derived.data, "data");
  EXPECT_EQ(catalog->LoadObject("c").status().code(), absl::StatusCode::kNotFound);
  ASSERT_TRUE(catalog->StoreDerived({{"b", {8, "more", "other"}}}).ok());
  EXPECT_EQ(catalog->GetDerived("b")->keys, "other");
  ASSERT_TRUE(catalog->StoreDerived({{"b", {}}}).ok());
  EXPECT_EQ((*catalog->LoadKeys("a", 1))[0].keys, "");
}

TEST_P(CatalogRows, AWriteIsTheOneThatItWasOnlyInItsHistory) {
  auto catalog = Open(NewPlace());
  WriteIdentity write = catalog->LastWrite().value();
  EXPECT_EQ(write.generation, 0);
  ASSERT_TRUE(catalog->CreateObjects({{SampleRecord("a", 1), {}}}, {}, &write).ok());
  const WriteIdentity first = write;
  EXPECT_EQ(first.generation, 1);
  EXPECT_FALSE(first.token.empty());
  ASSERT_TRUE(catalog->StoreDerived({{"a", {7, "d", "k", "at7"}}}, /*counts=*/true, &write).ok());
  EXPECT_EQ(write.generation, 2);
  EXPECT_NE(write.token, first.token);
  EXPECT_EQ(catalog->LastWrite()->token, write.token);
  // Not the last one any more.
  WriteIdentity late = first;
  EXPECT_TRUE(IsOvertaken(catalog->DeleteObject("a", &late)));
  EXPECT_EQ(late.token, first.token);
  // Of the number of the last one, and another.
  WriteIdentity other{2, first.token};
  EXPECT_TRUE(IsOvertaken(catalog->DeleteObject("a", &other)));
  EXPECT_EQ(*catalog->Generation(), 2);
  EXPECT_TRUE(IsOtherHistory(catalog->LoadObjects("", 10, {}, &other).status()));
  EXPECT_TRUE(IsOtherHistory(catalog->ListDerived("", 10, 7, -1, &other).status()));
  EXPECT_TRUE(IsOtherHistory(catalog->ChangesSince(2, other, {"a"}).status()));
  EXPECT_TRUE(IsOtherHistory(catalog->ChangesSince(2, {9, write.token}, {"a"}).status()));
  EXPECT_EQ(catalog->ChangesSince(1, first, {})->last.token, write.token);
  // What is read follows from what was seen, and is what has been seen then.
  WriteIdentity seen = first;
  const std::vector<std::string> ids{"a", "gone"};
  EXPECT_EQ(catalog->LoadObjects(ids, {}, &seen)->size(), 1u);
  EXPECT_EQ(seen.token, write.token);
  ASSERT_TRUE(catalog->DeleteObject("a", &write).ok());
  EXPECT_EQ(catalog->LastWrite()->token, write.token);
}

TEST_P(CatalogRows, WhatWasWrittenSinceIsListedAlone) {
  auto catalog = Open(NewPlace());
  for (const char* id : {"a", "b", "c"})
    ASSERT_TRUE(catalog->CreateObject(SampleRecord(id, 1), {7, "d", "k", "at7"}).ok());
  EXPECT_EQ(catalog->ListDerived("", 10, 7)->size(), 3u);
  EXPECT_EQ(catalog->ListDerived("", 10, 7, 2)->at(0).id, "c");
  EXPECT_EQ(catalog->ListDerived("", 1, 7, 1)->at(0).id, "b");
  EXPECT_TRUE(catalog->ListDerived("", 10, 7, 3)->empty());
}

TEST_P(CatalogRows, TwoVersionsOfDerivedDataLieSideBySideAndEachIsFoundByItsNumber) {
  auto catalog = Open(NewPlace());
  ASSERT_TRUE(catalog->CreateObject(SampleRecord("a", 1), {7, "seven", "k7", "at7"}).ok());
  ASSERT_TRUE(catalog->CreateObject(SampleRecord("b", 2)).ok());
  ASSERT_TRUE(catalog->StoreDerived({{"a", {8, "eight", "k8", "at8"}}}).ok());
  ASSERT_TRUE(catalog->StoreDerived({{"a", {7, "again", "k7", "at7"}}}).ok());
  EXPECT_EQ(catalog->GetDerived("a", {.version = 7})->data, "again");
  EXPECT_EQ(catalog->GetDerived("a", {.version = 8})->data, "eight");
  EXPECT_EQ(catalog->GetDerived("a", {.version = 9})->data, "");
  EXPECT_EQ(catalog->GetDerived("a")->version, 8);
  EXPECT_EQ(catalog->LoadObject("a", {.version = 7})->derived.address, "at7");
  const DerivedData named =
      catalog->LoadObjects("", 1, {.version = 8, .bytes = false}).value()[0].derived;
  EXPECT_EQ(named.address, "at8");
  EXPECT_EQ(named.data + named.keys, "");
  EXPECT_EQ(catalog->LoadKeys("", 10, 7).value()[0].keys, "k7");
  EXPECT_EQ(catalog->LoadKeys("", 10, 9).value()[0].version, 0);
  const auto entries = catalog->ListDerived("", 10, 8).value();
  ASSERT_EQ(entries.size(), 2u);
  EXPECT_EQ(entries[0].address + " " + entries[1].address, "at8 ");
  EXPECT_EQ(entries[0].version, 8);
  EXPECT_EQ(entries[1].version, 0);
  EXPECT_EQ(catalog->ListDerived("", 10).value()[0].version, 8);
  EXPECT_EQ(catalog->ListDerived("", 0).status().code(), absl::StatusCode::kInvalidArgument);
  // A third one takes the place of the oldest.
  ASSERT_TRUE(catalog->StoreDerived({{"a", {9, "nine", "k9", "at9"}}}).ok());
  EXPECT_EQ(catalog->GetDerived("a", {.version = 7})->data, "");
  EXPECT_EQ(catalog->GetDerived("a", {.version = 8})->data, "eight");
}

TEST_P(CatalogRows, WithAnotherShapeWhatWasDerivedOfTheFormerOneGoesInAllVersions) {
  for (const UpdateParts& parts :
       {UpdateParts{.geometry = true}, UpdateParts{.symmetries = true}}) {
    auto catalog = Open(NewPlace());
    ASSERT_TRUE(catalog->CreateObject(SampleRecord("a", 1), {7, "seven", "k7", "at7"}).ok());
    ASSERT_TRUE(catalog->UpdateObject(SampleRecord("a", 1), {.labels = true}).ok());
    EXPECT_EQ(catalog->GetDerived("a", {.version = 7})->data, "seven");
    ASSERT_TRUE(catalog->UpdateObject(SampleRecord("a", 2), parts, {8, "eight", "k8", "at8"}).ok());
    EXPECT_EQ(catalog->GetDerived("a", {.version = 7})->data, "");
    EXPECT_EQ(catalog->GetDerived("a", {.version = 8})->data, "eight");
  }
}

TEST_P(CatalogRows, DerivedDataWithoutAnAddressGetTheirOwnWhenTheCatalogIsOpened) {
  const std::string place = NewPlace();
  ASSERT_TRUE(Open(place)->CreateObject(SampleRecord("a", 1), {7, "seven", "k7"}).ok());
  auto catalog = Open(place);
  const std::string address = catalog->GetDerived("a")->address;
  EXPECT_EQ(address, DerivedAddress(catalog->GetObject("a")->model, 7));
  EXPECT_EQ(address.size(), 64u);
  EXPECT_EQ(catalog->GetDerived("a")->data, "seven");
}

TEST(DerivedAddress, IsThatOfTheShapeAndTheVersionAndOfNothingElse) {
  ObjectModel model = SampleRecord("a", 3).model;
  const std::string address = DerivedAddress(model, 7);
  EXPECT_NE(DerivedAddress(model, 8), address);
  ObjectModel other = model;
  other.id = "b";
  other.display_name = "another name";
  other.grasps.clear();
  EXPECT_EQ(DerivedAddress(other, 7), address);
  other.mesh.vertices[0].x() += 1e-9;
  EXPECT_NE(DerivedAddress(other, 7), address);
  other = model;
  other.symmetries.emplace_back();
  EXPECT_NE(DerivedAddress(other, 7), address);
}

TEST_P(CatalogRows, ASummaryHasCountsAndGraspsButNoGeometry) {
  const auto catalog = Open(NewPlace());
  ASSERT_TRUE(catalog->CreateObject(SampleRecord("box")).ok());
  const auto summary = catalog->GetSummary("box");
  ASSERT_TRUE(summary.ok());
  EXPECT_EQ(summary->vertex_count, 8);
  EXPECT_EQ(summary->edge_count, 13);
  EXPECT_EQ(summary->triangle_count, 12);
  EXPECT_EQ(summary->record.model.grasps.size(), 2u);
  EXPECT_TRUE(summary->record.model.vertices.empty());
  EXPECT_TRUE(summary->record.source.content.empty());
  EXPECT_GT(summary->record.source.size_bytes, 0);
}

TEST_P(CatalogRows, ADuplicateIdIsRefusedAndChangesNothing) {
  const auto catalog = Open(NewPlace());
  const CatalogRecord first = SampleRecord("box", 1);
  ASSERT_TRUE(catalog->CreateObject(first).ok());
  const absl::Status status = catalog->CreateObject(SampleRecord("box", 2));
  EXPECT_EQ(status.code(), StatusCode::kAlreadyExists);
  EXPECT_THAT(std::string(status.message()), testing::HasSubstr("'box'"));
  EXPECT_EQ(FirstDifference(*catalog->GetObject("box"), first), "");
}

TEST_P(CatalogRows, AMissingObjectIsNotFoundByEveryCall) {
  const auto catalog = Open(NewPlace());
  ASSERT_TRUE(catalog->CreateObject(SampleRecord("box")).ok());
  UpdateParts parts;
  parts.grasps = true;
  EXPECT_EQ(catalog->GetObject("nut").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(catalog->GetSummary("nut").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(catalog->GetCadFile("nut").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(catalog->DeleteObject("nut").code(), StatusCode::kNotFound);
  EXPECT_EQ(catalog->UpdateObject(SampleRecord("nut"), parts).code(), StatusCode::kNotFound);
  EXPECT_EQ(*catalog->CountObjects(), 1);
}

TEST_P(CatalogRows, AnInvalidRecordIsRefusedAndNothingIsWritten) {
  const auto catalog = Open(NewPlace());
  CatalogRecord record = SampleRecord("box");
  record.model.mesh.triangles.back()[2] = 99;
  EXPECT_EQ(catalog->CreateObject(record).code(), StatusCode::kInvalidArgument);
  record = SampleRecord("box");
  record.source.sha256 = std::string(64, '0');
  EXPECT_EQ(catalog->CreateObject(record).code(), StatusCode::kInvalidArgument);
  EXPECT_EQ(*catalog->CountObjects(), 0);
}

TEST_P(CatalogRows, AnUpdateWritesTheChosenPartsOnly) {
  const auto catalog = Open(NewPlace());
  const CatalogRecord before = SampleRecord("box", 1);
  ASSERT_TRUE(catalog->CreateObject(before).ok());
  CatalogRecord other = SampleRecord("box", 2);
  other.model.display_name = "other";
  other.update_time = "2025-05-05T05:05:05Z";

  UpdateParts grasps;
  grasps.grasps = true;
  ASSERT_TRUE(catalog->UpdateObject(other, grasps).ok());
  CatalogRecord expected = before;
  expected.model.grasps = other.model.grasps;
  expected.update_time = other.update_time;
  EXPECT_EQ(FirstDifference(*catalog->GetObject("box"), expected), "");
  EXPECT_EQ(*catalog->GetCadFile("box"), before.source.content);

  ASSERT_TRUE(catalog->UpdateObject(other, {true, true, true, true, true, true}).ok());
  other.create_time = before.create_time;
  EXPECT_EQ(FirstDifference(*catalog->GetObject("box"), other), "");
  EXPECT_EQ(*catalog->GetCadFile("box"), other.source.content);
}

TEST_P(CatalogRows, DeletingRemovesEverythingSoThatTheIdCanBeUsedAgain) {
  const auto catalog = Open(NewPlace());
  ASSERT_TRUE(catalog->CreateObject(SampleRecord("box", 1)).ok());
  ASSERT_TRUE(catalog->DeleteObject("box").ok());
  EXPECT_EQ(*catalog->CountObjects(), 0);
  const CatalogRecord again = SampleRecord("box", 2);
  ASSERT_TRUE(catalog->CreateObject(again).ok());
  EXPECT_EQ(FirstDifference(*catalog->GetObject("box"), again), "");
}

TEST_P(CatalogRows, PagesVisitEveryObjectOnceInOrder) {
  const auto catalog = Open(NewPlace());
  for (const int i : {5, 3, 9, 1, 7, 0, 2}) {
    ASSERT_TRUE(catalog->CreateObject(SampleRecord("obj_" + std::to_string(i), i)).ok());
  }
  for (const int limit : {1, 2, 3, 7, 100}) {
    std::vector<std::string> seen;
    std::string after;
    while (true) {
      const auto page = catalog->ListObjects(after, limit);
      ASSERT_TRUE(page.ok());
      if (page->empty()) break;
      for (const ObjectSummary& summary : *page) seen.push_back(summary.record.model.id);
      after = seen.back();
    }
    EXPECT_EQ(seen, Ids(*catalog)) << limit;
  }
  EXPECT_EQ(catalog->ListObjects("", 0).status().code(), StatusCode::kInvalidArgument);
}

TEST_P(CatalogRows, ManyThreadsMayWriteAndRead) {
  const auto catalog = Open(NewPlace());
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      for (int i = 0; i < 8; ++i) {
        const std::string id = "obj_" + std::to_string(t) + "_" + std::to_string(i);
        EXPECT_TRUE(catalog->CreateObject(SampleRecord(id, i)).ok());
        EXPECT_TRUE(catalog->GetObject(id).ok());
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(*catalog->CountObjects(), 32);
}

INSTANTIATE_TEST_SUITE_P(Stores, CatalogRows, EveryStore(), NameOfStore);

}  // namespace
}  // namespace horopter
