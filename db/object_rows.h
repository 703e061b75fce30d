// One object's rows in the tables; internal to db/. Callers open the transaction.
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "db/catalog_record.h"
#include "db/database.h"

namespace horopter {

// Each insert expects that the object's row exists and that it has no rows of that kind yet.
absl::Status InsertObjectRow(Database* db, const CatalogRecord& record, int64_t revision);
absl::Status InsertGeometry(Database* db, const ObjectModel& model);
absl::Status InsertSymmetries(Database* db, const ObjectModel& model);
absl::Status InsertGrasps(Database* db, const ObjectModel& model);
// After mesh and symmetries, with which it would go. None: no row.
absl::Status InsertPrint(Database* db, const ObjectModel& model);
absl::Status InsertLabels(Database* db,
                          const std::string& id,
                          const std::map<std::string, std::string>& labels);
absl::Status InsertSource(Database* db, const std::string& id, const CadSource& source);

// Writes the data of one version beside those of others, of which the newest stay
// (kKeptDerivedVersions); empty data: removes those of all.
absl::Status WriteDerived(Database* db, const std::string& id, const DerivedData& derived);
// Of an object whose shape has changed: those of all versions go.
absl::Status ReplaceDerived(Database* db, const std::string& id, const DerivedData& derived);

// Errors: DATA_LOSS (damaged blob).
absl::Status ReadGeometry(Database* db, ObjectModel& model);
absl::Status ReadSymmetries(Database* db, ObjectModel& model);
absl::Status ReadGrasps(Database* db, ObjectModel& model);
// Errors: DATA_LOSS.
absl::Status ReadPrint(Database* db, ObjectModel& model);
absl::Status ReadDerived(Database* db,
                         const std::string& id,
                         const DerivedWanted& wanted,
                         DerivedData& derived);
// Of the objects with id > after, at most limit, ordered by id.
absl::StatusOr<std::vector<StoredKeys>> ReadKeys(Database* db,
                                                 const std::string& after,
                                                 int limit,
                                                 int version);
// `since`: of a higher revision alone.
absl::StatusOr<std::vector<DerivedEntry>> ReadDerivedEntries(
    Database* db, const std::string& after, int limit, int version, int64_t since);
// Without content.
absl::Status ReadSource(Database* db, const std::string& id, CadSource& source);

// Summaries of the objects with id > after (or id == after when `exactly`), at most limit, ordered
// by id.
absl::StatusOr<std::vector<ObjectSummary>> ReadSummaries(Database* db,
                                                         const std::string& after,
                                                         bool exactly,
                                                         int limit);

}  // namespace horopter
