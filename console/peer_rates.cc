#include "console/peer_rates.h"

#include <algorithm>

namespace horopter {
namespace {

constexpr size_t kMostPeers = 4096;

}  // namespace

double PeerRates::Filled(const Bucket& bucket, std::chrono::steady_clock::time_point now) const {
  const double seconds = std::chrono::duration<double>(now - bucket.filled).count();
  return std::min(options_.burst, bucket.left + options_.per_second * std::max(0.0, seconds));
}

bool PeerRates::Take(const std::string& peer, std::chrono::steady_clock::time_point now) {
  if (buckets_.size() >= kMostPeers && !buckets_.contains(peer)) {
    // A full bucket says as much as none.
    std::erase_if(buckets_, [&](const auto& b) { return Filled(b.second, now) >= options_.burst; });
    if (buckets_.size() >= kMostPeers) return false;
  }
  Bucket& bucket = buckets_.try_emplace(peer, Bucket{options_.burst, now}).first->second;
  bucket.left = Filled(bucket, now);
  bucket.filled = now;
  if (bucket.left < 1.0) return false;
  bucket.left -= 1.0;
  return true;
}

}  // namespace horopter
