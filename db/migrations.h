// The numbered schema changes of db/migrations, built into the program.
#pragma once

#include <string>
#include <vector>

namespace horopter {

// Element i brings a database from user_version i to i + 1.
std::vector<std::string> CatalogMigrations();

}  // namespace horopter
