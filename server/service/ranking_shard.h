// A ranker's share of the catalog: the keys of the parts whose ids' hash says so, as they are
// published.
#pragma once

#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/pipeline/ranking.h"
#include "server/service/catalog_store.h"
#include "server/service/derived_cache.h"

namespace horopter {

// 1 to `count`.
struct ShardNumber {
  int number = 1;
  int count = 1;
};
// "2/4". Errors: INVALID_ARGUMENT.
absl::StatusOr<ShardNumber> ParseShard(const std::string& text);

// Which of so many shards, 0 to count - 1, has the object: by the SHA-256 of its id.
int ShardOf(const std::string& id, int count);

struct ShardAnswer {
  std::vector<RankedPart> parts;  // RankShard
  ShardNumber shard;
  int part_count = 0;
  int64_t generation = 0;
};

struct RankingShardOptions {
  ShardNumber shard;
  int threads = 1;
  // Keys of parts that came since all were indexed lie in an index of their own, made anew with
  // each change. Above this many, and a quarter of the others, all are indexed together again.
  int most_fresh = 4096;
  std::string cache = {};  // folder that keeps keys (derived_cache.h); empty: none
  int64_t cache_bytes = int64_t{20} << 30;
  std::function<PackedPiece(const PreparedObject&)> piece_of = RankingPiece;
};

// Follows what the store publishes. Thread-safe; readers wait for nobody. The store must outlive
// it.
class RankingShard {
 public:
  // Returns when all that is published is indexed. Errors: CANCELLED.
  static absl::StatusOr<std::unique_ptr<RankingShard>> Start(const CatalogStore& store,
                                                             RankingShardOptions options,
                                                             const StopRequested& stop = {});
  ~RankingShard();

  ShardAnswer Rank(std::span<const RankingImage> images, const StopRequested& stop) const;

  struct Figures {
    int parts = 0;
    int fresh = 0;  // of them outside of the large index
    std::size_t bytes = 0;
  };
  Figures figures() const;

 private:
  struct Member {
    std::string id;
    // Changes with the object: its id and the address of what is derived of it, or, of a catalog in
    // memory, where the object lies, which is held so that no other one lies there.
    std::string identity;
    std::shared_ptr<const PreparedObject> held;
    int index = 0;  // of the published catalog
  };
  // An index with what its parts are.
  struct Tier {
    PackedIndex index;
    std::vector<std::string> ids, identities;
    std::vector<std::shared_ptr<const PreparedObject>> held;
  };
  struct State {
    std::shared_ptr<const Tier> base, fresh;
    std::vector<const PackedIndex*> indices;
    std::vector<std::string> ids;      // of both, one after the other
    std::vector<std::uint8_t> wanted;  // whether they are as published
    int64_t generation = 0;
    int parts = 0;
  };

  RankingShard(const CatalogStore& store, RankingShardOptions options);

  // Follows until it is told to end.
  void Follow();
  // Takes in what is published. Errors: CANCELLED.
  absl::Status Update(const std::shared_ptr<const PublishedCatalog>& published,
                      const StopRequested& stop);
  std::vector<Member> MembersOf(const PublishedCatalog& published) const;
  absl::StatusOr<std::shared_ptr<const Tier>> MakeTier(const PublishedCatalog& published,
                                                       std::span<const Member> members,
                                                       const StopRequested& stop);
  // Empty of an object that cannot be read: the log says why.
  PackedPiece PieceOf(const PublishedCatalog& published, const Member& member);
  std::shared_ptr<const State> Now() const;

  const CatalogStore& store_;
  const RankingShardOptions options_;
  const std::unique_ptr<DerivedCache> cache_;  // null: none
  mutable std::mutex mutex_;
  std::shared_ptr<const State> state_;  // guarded by mutex_
  // Of the fresh parts, so that each is made once. Of the following thread alone.
  std::map<std::string, PackedPiece> fresh_pieces_;
  std::atomic<bool> ending_ = false;
  std::thread following_;
};

}  // namespace horopter
