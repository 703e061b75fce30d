// A transaction whose body throws leaves nothing behind, and no lock on the next.
#include <gtest/gtest.h>

#include <new>

#include "db/open_database.h"
#include "db/sqlite.h"

namespace horopter {
namespace {

TEST(RunInTransaction, WhatThrowsIsRolledBackAndTheNextOneRuns) {
  auto handle = OpenDatabase(":memory:", 0, {"CREATE TABLE t (x INTEGER) STRICT;"});
  ASSERT_TRUE(handle.ok()) << handle.status();
  sqlite3* db = handle->get();
  const auto insert = [db] { return Execute(db, "INSERT INTO t VALUES (1)"); };
  EXPECT_THROW((void)RunInTransaction(db,
                                      [&]() -> absl::Status {
                                        EXPECT_TRUE(insert().ok());
                                        throw std::bad_alloc();
                                      }),
               std::bad_alloc);
  EXPECT_EQ(QueryInt(db, "SELECT count(*) FROM t").value(), 0);
  EXPECT_TRUE(RunInTransaction(db, insert).ok());
  EXPECT_EQ(QueryInt(db, "SELECT count(*) FROM t").value(), 1);
}

}  // namespace
}  // namespace horopter
