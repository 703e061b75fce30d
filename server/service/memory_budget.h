// Admission by bytes: what all calls together may hold.
#pragma once

#include <cstdint>
#include <mutex>
#include <optional>
#include <utility>

namespace horopter {

// Thread-safe; must outlive its leases.
class MemoryBudget {
 public:
  // Bytes taken from a budget; given back when it goes.
  class Lease {
   public:
    Lease() = default;
    Lease(Lease&& other) noexcept { *this = std::move(other); }
    Lease& operator=(Lease&& other) noexcept {
      if (this == &other) return *this;
      GiveBack(bytes_);
      budget_ = std::exchange(other.budget_, nullptr);
      bytes_ = std::exchange(other.bytes_, 0);
      return *this;
    }
    ~Lease() { GiveBack(bytes_); }

    int64_t bytes() const { return bytes_; }
    // Takes `more` bytes too, all or none.
    bool Grow(int64_t more) {
      if (budget_ == nullptr || !budget_->Take(more)) return false;
      bytes_ += more;
      return true;
    }
    void GiveBack(int64_t bytes) {
      if (budget_ == nullptr) return;
      const std::lock_guard lock(budget_->mutex_);
      budget_->used_ -= bytes;
      bytes_ -= bytes;
    }

   private:
    friend class MemoryBudget;
    Lease(MemoryBudget* budget, int64_t bytes) : budget_(budget), bytes_(bytes) {}
    MemoryBudget* budget_ = nullptr;
    int64_t bytes_ = 0;
  };

  explicit MemoryBudget(int64_t bytes) : bytes_(bytes) {}
  MemoryBudget(const MemoryBudget&) = delete;
  MemoryBudget& operator=(const MemoryBudget&) = delete;

  // Empty: less than `bytes` are left.
  std::optional<Lease> TryReserve(int64_t bytes) {
    if (!Take(bytes)) return std::nullopt;
    return Lease(this, bytes);
  }

  int64_t bytes() const { return bytes_; }
  int64_t used() const {
    const std::lock_guard lock(mutex_);
    return used_;
  }

 private:
  bool Take(int64_t bytes) {
    const std::lock_guard lock(mutex_);
    if (bytes > bytes_ - used_) return false;
    used_ += bytes;
    return true;
  }

  const int64_t bytes_;
  mutable std::mutex mutex_;
  int64_t used_ = 0;  // guarded by mutex_
};

}  // namespace horopter
