// Room on the disk that is kept for removing objects: a transaction needs room to write before it
// gives any back. Internal to db/.
#pragma once

#include <cstdint>
#include <string>

namespace horopter {

// A file beside the database, of its blocks and nothing else; removed with this value, but for a
// disk that is nearly full, where the next one finds it. Where the disk has no room for it there is
// none. Not thread-safe.
class DiskReserve {
 public:
  explicit DiskReserve(const std::string& database);
  ~DiskReserve();
  DiskReserve(const DiskReserve&) = delete;
  DiskReserve& operator=(const DiskReserve&) = delete;

  // Gives the room back to whoever writes next. False: there was none.
  bool Release();
  // Takes again what is left of it.
  void TakeBack();
  // Whether the file could grow by the whole log; a merge that meets the end of the disk eats what
  // is left and merges nothing.
  bool HasRoomForLog() const;

 private:
  void Take(int64_t bytes);

  const std::string database_, path_;
  int64_t bytes_ = 0;  // that are, or were, held
  bool held_ = false;
};

}  // namespace horopter
