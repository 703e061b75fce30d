// What a Catalog holds of SQLite; internal to db/.
#pragma once

#include <functional>
#include <memory>
#include <utility>

#include "db/catalog.h"
#include "db/disk_reserve.h"
#include "db/file_state.h"
#include "db/sqlite.h"

namespace horopter {

struct Catalog::Connection {
  SqliteHandle handle;
  std::unique_ptr<DiskReserve> reserve;  // none of a database in memory

  // RunInTransaction for what frees room: where the disk is full the reserve is given for it. Then
  // the log is merged if there is room for all of it, so that it begins anew.
  absl::Status RunFreeing(const std::function<absl::Status()>& body) {
    const absl::Status status = RunInTransaction(handle.get(), body);
    if (!absl::IsResourceExhausted(status) || reserve == nullptr) return status;
    if (!reserve->Release()) return status;
    const absl::Status again = RunInTransaction(handle.get(), body);
    if (reserve->HasRoomForLog()) (void)QueryInt(handle.get(), "PRAGMA wal_checkpoint(RESTART)");
    reserve->TakeBack();
    return again;
  }
};

}  // namespace horopter
