// What a Catalog holds of SQLite; internal to db/.
#pragma once

#include "db/catalog.h"
#include "db/sqlite.h"

namespace horopter {

struct Catalog::Connection {
  SqliteHandle handle;
};

}  // namespace horopter
