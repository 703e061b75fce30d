// The rankers that a server asks which parts of a very large catalog a request's images may show.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "horopter/v1/ranking.grpc.pb.h"
#include "server/base/stop_token.h"
#include "server/pipeline/ranking.h"
#include "server/service/recognition_service.h"

namespace horopter {

struct RankerOptions {
  std::vector<std::string> addresses;  // HOST:PORT of each shard, in their order; empty: none
  std::string ca;                      // PEM of the authority of their certificates; empty: no TLS
  std::string token_file;              // whose first line is the token they want; empty: none
  // Catalogs of more objects are ranked by them. Lower: smaller catalogs as well.
  int above = 5000;
  double seconds = 5.0;  // that an answer may take; those that are later are done without
  int threads = 1;       // that look at the images of a request
};
// Errors: INVALID_ARGUMENT, names the option.
absl::Status Validate(const RankerOptions& options);

// What the shards said together.
struct RankedCatalog {
  std::vector<std::string> ids;      // best first
  std::map<int, absl::Status> lost;  // shards, from 1, without an answer, and why
  int shards = 0;
};

// Thread-safe.
class Rankers {
 public:
  // Errors: INVALID_ARGUMENT, FAILED_PRECONDITION (a file cannot be read). Connects when it asks.
  static absl::StatusOr<std::shared_ptr<Rankers>> Create(const RankerOptions& options);

  // Asks all shards at once. Errors: UNAVAILABLE (none answered in time), CANCELLED.
  absl::StatusOr<RankedCatalog> Rank(std::span<const RankingImage> images,
                                     const CallLimits& limits);

  const RankerOptions& options() const { return options_; }

 private:
  explicit Rankers(const RankerOptions& options) : options_(options) {}

  const RankerOptions options_;
  std::string token_;
  std::vector<std::unique_ptr<v1::RankingService::Stub>> stubs_;
};

// Requests that name no candidates, in a catalog of more than RankerOptions::above objects, are
// those over the parts that the rankers list; shards that are lost are in the answer's
// `unsearched` (kUnavailable). All others go to `recognizer` as they are.
Recognizer RankedRecognizer(Recognizer recognizer, std::shared_ptr<Rankers> rankers);

}  // namespace horopter
