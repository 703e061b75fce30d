// The numbered schema changes of db/migrations and db/postgres_migrations, built into the program.
#pragma once

#include <string>
#include <vector>

namespace horopter {

// Element i brings a SQLite file from user_version i to i + 1.
std::vector<std::string> CatalogMigrations();
// Element i brings a schema of PostgreSQL from catalog_schema.version i to i + 1.
std::vector<std::string> PostgresMigrations();

}  // namespace horopter
