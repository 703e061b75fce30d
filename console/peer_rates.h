// How often an address may ask.
#pragma once

#include <chrono>
#include <map>
#include <string>

namespace horopter {

struct RateOptions {
  double per_second = 50.0;  // in the long run
  double burst = 500.0;      // at once, after a pause
};

// A bucket for each address that is filled by time and emptied by requests. Of one thread.
class PeerRates {
 public:
  explicit PeerRates(const RateOptions& options) : options_(options) {}

  // False: the address has asked too often.
  bool Take(const std::string& peer, std::chrono::steady_clock::time_point now);

 private:
  struct Bucket {
    double left = 0.0;
    std::chrono::steady_clock::time_point filled;
  };
  double Filled(const Bucket& bucket, std::chrono::steady_clock::time_point now) const;

  const RateOptions options_;
  std::map<std::string, Bucket> buckets_;
};

}  // namespace horopter
