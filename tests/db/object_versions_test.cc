#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sqlite3.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "db/catalog.h"
#include "db/migrations.h"
#include "db/open_database.h"
#include "db/version_blob.h"
#include "tests/support/catalog_contract.h"
#include "tests/support/sample_record.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

class VersionRows : public CatalogContract {};

using absl::StatusCode;
using testing::HasSubstr;

constexpr UpdateParts kAll{true, true, true, true, true, true, true};

std::unique_ptr<Catalog> OpenOrDie(const std::string& path) {
  absl::StatusOr<std::unique_ptr<Catalog>> catalog = Catalog::Open(path);
  EXPECT_TRUE(catalog.ok()) << catalog.status();
  return *std::move(catalog);
}

CatalogRecord Sample(unsigned seed, const std::string& changed_by) {
  CatalogRecord record = SampleRecord("box", seed);
  record.model.display_name = absl::StrCat("box ", seed);
  record.labels = {{"seed", absl::StrCat(seed)}};
  record.changed_by = changed_by;
  record.update_time = absl::StrCat("2026-01-01T00:00:0", seed, "Z");
  return record;
}

void Tamper(const std::string& path, const std::string& sql) {
  sqlite3* db = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &db), SQLITE_OK);
  char* error = nullptr;
  EXPECT_EQ(sqlite3_exec(db, sql.c_str(), nullptr, nullptr, &error), SQLITE_OK) << error;
  sqlite3_close(db);
}

TEST_P(VersionRows, EveryWriteKeepsBitByBitWhatWasBefore) {
  const std::string place = NewPlace();
  auto catalog = OpenOrDie(place);
  std::vector<CatalogRecord> written = {Sample(1, "anna")};
  ASSERT_TRUE(catalog->CreateObject(written[0]).ok());
  for (const unsigned seed : {2u, 3u}) {
    written.push_back(Sample(seed, seed == 2 ? "ben" : "anna"));
    written.back().create_time = written[0].create_time;
    ASSERT_TRUE(catalog->UpdateObject(written.back(), kAll).ok());
  }
  catalog = nullptr;
  catalog = OpenOrDie(place);
  const auto versions = catalog->ListVersions("box").value();
  ASSERT_EQ(versions.size(), 3u);
  for (int i = 0; i < 3; ++i) {
    const CatalogRecord& is = versions[2 - i].summary.record;
    EXPECT_EQ(is.changed_by, written[i].changed_by);
    EXPECT_EQ(is.model.display_name, written[i].model.display_name);
    EXPECT_EQ(is.labels, written[i].labels);
    EXPECT_EQ(versions[2 - i].summary.triangle_count,
              static_cast<int>(written[i].model.mesh.triangles.size()));
    const CatalogRecord read = catalog->GetVersion("box", is.revision).value();
    EXPECT_EQ(FirstDifference(read, written[i]), "") << i;
    EXPECT_EQ(read.source.content, written[i].source.content);
    EXPECT_EQ(read.revision, is.revision);
  }
  EXPECT_LT(versions[1].summary.record.revision, versions[0].summary.record.revision);
  EXPECT_FALSE(versions[2].changed);
  EXPECT_TRUE(versions[0].changed->geometry && versions[0].changed->source);
  EXPECT_TRUE(catalog->Verify().value().empty());
}

// Geometry and file are kept once, whoever of those after it changed them.
TEST_P(VersionRows, WhatAWriteLeavesIsFoundInALaterVersionOrTheObject) {
  const auto catalog = OpenOrDie(NewPlace());
  const CatalogRecord first = Sample(1, "");
  ASSERT_TRUE(catalog->CreateObject(first).ok());
  CatalogRecord grasps = first, geometry = first, labels = first;
  grasps.model.grasps = Sample(2, "").model.grasps;
  ASSERT_TRUE(catalog->UpdateObject(grasps, {.grasps = true}).ok());
  geometry = Sample(3, "");
  ASSERT_TRUE(catalog->UpdateObject(geometry, {.geometry = true, .source = true}).ok());
  labels.labels = {{"a", "b"}};
  ASSERT_TRUE(catalog->UpdateObject(labels, {.labels = true}).ok());

  const auto versions = catalog->ListVersions("box").value();
  ASSERT_EQ(versions.size(), 4u);
  EXPECT_TRUE(versions[0].changed->labels && !versions[0].changed->geometry);
  EXPECT_TRUE(versions[1].changed->geometry && versions[1].changed->source);
  EXPECT_FALSE(versions[1].changed->grasps);
  EXPECT_TRUE(versions[2].changed->grasps && !versions[2].changed->geometry);
  const auto of = [&](int i) {
    return catalog->GetVersion("box", versions[i].summary.record.revision).value();
  };
  EXPECT_EQ(FirstDifference(of(3), first), "");
  EXPECT_EQ(of(3).source.content, first.source.content);
  EXPECT_EQ(of(2).model.vertices, first.model.vertices);
  EXPECT_EQ(of(2).source.content, first.source.content);
  EXPECT_EQ(of(2).model.grasps.size(), grasps.model.grasps.size());
  EXPECT_EQ(of(1).model.vertices, geometry.model.vertices);
  EXPECT_EQ(of(1).source.content, geometry.source.content);
  EXPECT_EQ(of(1).labels, first.labels);
}

TEST_P(VersionRows, AWriteThatChangesNothingKeepsNothing) {
  const auto catalog = OpenOrDie(NewPlace());
  CatalogRecord record = Sample(1, "anna");
  ASSERT_TRUE(catalog->CreateObject(record).ok());
  record.changed_by = "ben";
  ASSERT_TRUE(catalog->UpdateObject(record, kAll).ok());
  EXPECT_EQ(catalog->ListVersions("box").value().size(), 1u);
}

TEST_P(VersionRows, TheNewestAreKeptAndTheyGoWithTheObject) {
  const auto catalog = OpenOrDie(NewPlace());
  CatalogRecord record = Sample(1, "");
  ASSERT_TRUE(catalog->CreateObject(record).ok());
  const int64_t first = catalog->GetSummary("box").value().record.revision;
  for (int i = 0; i < kKeptVersions + 5; ++i) {
    record.labels = {{"n", absl::StrCat(i)}};
    ASSERT_TRUE(catalog->UpdateObject(record, {.labels = true}).ok());
  }
  const auto versions = catalog->ListVersions("box").value();
  ASSERT_EQ(versions.size(), 1u + kKeptVersions);
  EXPECT_EQ(versions.back().summary.record.labels.at("n"), "4");
  EXPECT_FALSE(versions.back().changed);
  EXPECT_EQ(catalog->GetVersion("box", first).status().code(), StatusCode::kNotFound);
  EXPECT_EQ(catalog->GetVersion("none", 1).status().code(), StatusCode::kNotFound);
  EXPECT_EQ(catalog->ListVersions("none").status().code(), StatusCode::kNotFound);

  ASSERT_TRUE(catalog->DeleteObject("box").ok());
  ASSERT_TRUE(catalog->CreateObject(record).ok());
  EXPECT_EQ(catalog->ListVersions("box").value().size(), 1u);
}

TEST_P(VersionRows, NoMoreBytesAreKeptThanIsSaid) {
  constexpr int64_t kMost = 1 << 20;
  const auto catalog = Catalog::Open(NewPlace(), {.kept_version_bytes = kMost}).value();
  CatalogRecord record = Sample(1, "");
  record.source.sha256.clear();
  record.source.content.assign(kMost / 2, 'a');
  ASSERT_TRUE(catalog->CreateObject(record).ok());
  for (const char c : {'b', 'c', 'd'}) {
    record.source.content.assign(kMost / 2, c);
    ASSERT_TRUE(catalog->UpdateObject(record, {.source = true}).ok());
  }
  // Two files of half the bound each, and what stands beside them, are one too many.
  const auto versions = catalog->ListVersions("box").value();
  ASSERT_EQ(versions.size(), 2u);
  EXPECT_EQ(catalog->GetVersion("box", versions[1].summary.record.revision).value().source.content,
            std::string(kMost / 2, 'c'));
}

TEST(ObjectVersions, DamageIsDataLossOfThatVersionAndFoundByVerify) {
  for (const char* damage :
       {"UPDATE object_version SET details = x'00'",
        "UPDATE object_version SET details = substr(details, 1, length(details) - 1)",
        "UPDATE object_version SET geometry = substr(geometry, 1, length(geometry) - 1)",
        "UPDATE object_version SET cad_file = x'00'"}) {
    const ScratchDir dir;
    const std::string path = dir.File("a.db");
    int64_t revision = 0;
    {
      const auto catalog = OpenOrDie(path);
      ASSERT_TRUE(catalog->CreateObject(Sample(1, "")).ok());
      revision = catalog->GetSummary("box").value().record.revision;
      ASSERT_TRUE(catalog->UpdateObject(Sample(2, ""), kAll).ok());
    }
    Tamper(path, damage);
    const auto catalog = OpenOrDie(path);
    EXPECT_EQ(catalog->GetVersion("box", revision).status().code(), StatusCode::kDataLoss)
        << damage;
    EXPECT_TRUE(catalog->GetObject("box").ok());
    const auto problems = catalog->Verify().value();
    ASSERT_EQ(problems.size(), 1u) << damage;
    EXPECT_THAT(problems[0].what, HasSubstr("revision"));
  }
}

TEST(ObjectVersions, NoBytesThatAreCutOffAreRead) {
  ObjectSummary summary;
  summary.record = Sample(1, "");
  const std::string details = EncodeDetails(summary);
  const std::string geometry = EncodeGeometry(summary.record.model);
  for (size_t size = 0; size < details.size(); ++size) {
    EXPECT_FALSE(DecodeDetails(std::string_view(details).substr(0, size)).ok()) << size;
  }
  for (size_t size = 0; size < geometry.size(); ++size) {
    ObjectModel model;
    EXPECT_FALSE(DecodeGeometry(std::string_view(geometry).substr(0, size), &model).ok()) << size;
  }
  EXPECT_FALSE(DecodeDetails(details + "x").ok());
  EXPECT_FALSE(DecodeDetails(geometry).ok());
}

// A catalog of the schema before versions: its objects have none, and get them from now on.
TEST(ObjectVersions, AnOlderCatalogIsTakenOver) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  const CatalogRecord record = Sample(1, "");
  { ASSERT_TRUE(OpenOrDie(path)->CreateObject(record).ok()); }
  Tamper(path,
         "DROP TRIGGER print_of_mesh; DROP TRIGGER print_of_symmetry; DROP TRIGGER "
         "print_of_new_symmetry; DROP TABLE surface_print; "
         "DROP TRIGGER catalog_write_named; DROP TRIGGER catalog_write_named_anew; DROP TABLE "
         "catalog_write; DROP TABLE object_version; ALTER TABLE object DROP COLUMN changed_by; "
         "PRAGMA user_version = "
         "8");
  const auto catalog = OpenOrDie(path);
  EXPECT_TRUE(std::filesystem::exists(path + ".schema-8.bak"));
  EXPECT_EQ(FirstDifference(catalog->GetObject("box").value(), record), "");
  EXPECT_EQ(catalog->ListVersions("box").value().size(), 1u);
  ASSERT_TRUE(catalog->UpdateObject(Sample(2, "anna"), kAll).ok());
  const auto versions = catalog->ListVersions("box").value();
  ASSERT_EQ(versions.size(), 2u);
  EXPECT_EQ(versions[0].summary.record.changed_by, "anna");
  EXPECT_EQ(FirstDifference(catalog->GetVersion("box", versions[1].summary.record.revision).value(),
                            record),
            "");
}

INSTANTIATE_TEST_SUITE_P(Stores, VersionRows, EveryStore(), NameOfStore);

}  // namespace
}  // namespace horopter
