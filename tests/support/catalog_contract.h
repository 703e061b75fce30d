// What holds for a catalog wherever it lies: tests of it run over each kind of database.
//
//   TEST_P(CatalogContract, ANameThatSaysTheLaw) { auto catalog = Open(NewPlace()); ... }
//   INSTANTIATE_TEST_SUITE_P(Stores, CatalogContract, EveryStore(), NameOfStore);
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "db/catalog.h"
#include "tests/support/postgres_server.h"
#include "tests/support/scratch_dir.h"

namespace horopter {

enum class CatalogKind { kSqlite, kPostgres };

class CatalogContract : public testing::TestWithParam<CatalogKind> {
 protected:
  void SetUp() override {
    if (GetParam() == CatalogKind::kPostgres && PostgresServer::OfProcess() == nullptr)
      GTEST_SKIP() << "PostgreSQL 15 is not installed (package postgresql-15)";
  }
  // Of an empty catalog, for Catalog::Open.
  std::string NewPlace() {
    if (GetParam() == CatalogKind::kPostgres) return PostgresServer::OfProcess()->NewCatalog();
    return File(std::to_string(++places_) + ".db");
  }
  std::string File(const std::string& name) const { return dir_.File(name); }
  static std::unique_ptr<Catalog> Open(const std::string& place) {
    absl::StatusOr<std::unique_ptr<Catalog>> catalog = Catalog::Open(place);
    EXPECT_TRUE(catalog.ok()) << catalog.status();
    return *std::move(catalog);
  }

 private:
  const ScratchDir dir_;
  int places_ = 0;
};

inline auto EveryStore() {
  return testing::Values(CatalogKind::kSqlite, CatalogKind::kPostgres);
}

inline std::string NameOfStore(const testing::TestParamInfo<CatalogKind>& info) {
  return info.param == CatalogKind::kSqlite ? "Sqlite" : "Postgres";
}

}  // namespace horopter
