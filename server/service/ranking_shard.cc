#include "server/service/ranking_shard.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <iterator>
#include <string_view>
#include <unordered_set>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "server/base/parallel_for.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"
#include "server/pipeline/exception_status.h"

namespace horopter {
namespace {

constexpr int kMostShards = 1024;
constexpr auto kLookForNewParts = std::chrono::milliseconds(100);
constexpr int kLot = 1024;  // objects that are read before their keys are indexed

}  // namespace

absl::StatusOr<ShardNumber> ParseShard(const std::string& text) {
  const std::vector<std::string> words = absl::StrSplit(text, '/');
  ShardNumber out;
  if (words.size() != 2 || !absl::SimpleAtoi(words[0], &out.number) ||
      !absl::SimpleAtoi(words[1], &out.count) || out.count < 1 || out.count > kMostShards ||
      out.number < 1 || out.number > out.count) {
    return absl::InvalidArgumentError(
        absl::StrCat("shard: '", text, "' is not NUMBER/COUNT, e.g. 2/4"));
  }
  return out;
}

int ShardOf(const std::string& id, int count) {
  const std::string digits = Sha256Hex(id).substr(0, 15);
  return static_cast<int>(std::strtoull(digits.c_str(), nullptr, 16) %
                          static_cast<unsigned long long>(count));
}

RankingShard::RankingShard(const CatalogStore& store, RankingShardOptions options)
    : store_(store),
      options_(std::move(options)),
      cache_(options_.cache.empty()
                 ? nullptr
                 : std::make_unique<DerivedCache>(options_.cache, options_.cache_bytes)) {}

absl::StatusOr<std::unique_ptr<RankingShard>> RankingShard::Start(const CatalogStore& store,
                                                                  RankingShardOptions options,
                                                                  const StopRequested& stop) {
  std::unique_ptr<RankingShard> shard(new RankingShard(store, std::move(options)));
  HOROPTER_RETURN_IF_ERROR(shard->Update(store.Published(), stop));
  shard->following_ = std::thread([s = shard.get()] { s->Follow(); });
  return shard;
}

RankingShard::~RankingShard() {
  ending_ = true;
  if (following_.joinable()) following_.join();
}

void RankingShard::Follow() {
  std::shared_ptr<const PublishedCatalog> known;
  while (!ending_) {
    const std::shared_ptr<const PublishedCatalog> published = store_.Published();
    if (published != known) {
      const absl::Status updated =
          CatchExceptions([&] { return Update(published, [this] { return ending_.load(); }); });
      if (updated.ok()) {
        known = published;
        continue;
      }
      if (ending_) return;
      spdlog::error("the shard stays behind the catalog: {}", std::string(updated.message()));
    }
    std::this_thread::sleep_for(kLookForNewParts);
  }
}

std::vector<RankingShard::Member> RankingShard::MembersOf(const PublishedCatalog& published) const {
  const CatalogSnapshot& snapshot = published.snapshot;
  std::vector<Member> members;
  for (int i = 0; i < ObjectCount(snapshot); ++i) {
    const std::string& id = published.ids[i];
    if (ShardOf(id, options_.shard.count) != options_.shard.number - 1) continue;
    Member& member = members.emplace_back();
    member.id = id;
    member.index = i;
    if (snapshot.stored.empty()) member.held = snapshot.objects[i];
    const auto place = reinterpret_cast<std::uintptr_t>(member.held.get());
    member.identity =
        absl::StrCat(id, " ", place != 0 ? absl::StrCat(place) : published.addresses[i]);
  }
  return members;
}

PackedPiece RankingShard::PieceOf(const PublishedCatalog& published, const Member& member) {
  std::string address;
  if (cache_ != nullptr && !published.addresses.empty()) {
    address = Sha256Hex(
        absl::StrCat(published.addresses[member.index], " ranking keys ", kPackedPieceVersion));
    if (const std::optional<DerivedData> kept = cache_->Get(address)) {
      absl::StatusOr<PackedPiece> piece = DecodePackedPiece(kept->data);
      if (piece.ok()) return *std::move(piece);
      cache_->Quarantine(address, piece.status());
    }
  }
  const auto object = ObjectAt(published.snapshot, member.index);
  if (!object.ok()) {
    spdlog::error("object {} is not ranked: {}", member.id, std::string(object.status().message()));
    return {};
  }
  PackedPiece piece = options_.piece_of(**object);
  if (!address.empty())
    cache_->Put({kPackedPieceVersion, EncodePackedPiece(piece), "", std::move(address)});
  return piece;
}

absl::StatusOr<std::shared_ptr<const RankingShard::Tier>> RankingShard::MakeTier(
    const PublishedCatalog& published, std::span<const Member> members, const StopRequested& stop) {
  auto tier = std::make_shared<Tier>();
  PackedIndex::Builder builder(static_cast<int>(members.size()));
  for (std::size_t begin = 0; begin < members.size(); begin += kLot) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped while keys were indexed");
    const auto lot = members.subspan(begin, std::min<std::size_t>(kLot, members.size() - begin));
    std::vector<PackedPiece> pieces(lot.size());
    ParallelFor(static_cast<int>(lot.size()), options_.threads, [&](int i) {
      const auto known = fresh_pieces_.find(lot[i].identity);
      pieces[i] = known != fresh_pieces_.end() ? known->second : PieceOf(published, lot[i]);
    });
    for (std::size_t i = 0; i < lot.size(); ++i) {
      builder.Add(pieces[i]);
      tier->ids.push_back(lot[i].id);
      tier->identities.push_back(lot[i].identity);
      if (lot[i].held != nullptr) tier->held.push_back(lot[i].held);
      if (members.size() <= static_cast<std::size_t>(options_.most_fresh))
        fresh_pieces_.try_emplace(lot[i].identity, std::move(pieces[i]));
    }
  }
  tier->index = std::move(builder).Finish();
  return tier;
}

absl::Status RankingShard::Update(const std::shared_ptr<const PublishedCatalog>& published,
                                  const StopRequested& stop) {
  const std::vector<Member> members = MembersOf(*published);
  auto next = std::make_shared<State>();
  next->base = Now() != nullptr ? Now()->base : std::make_shared<const Tier>();
  const std::unordered_set<std::string_view> there(next->base->identities.begin(),
                                                   next->base->identities.end());
  std::vector<Member> fresh;
  std::copy_if(members.begin(), members.end(), std::back_inserter(fresh), [&](const Member& m) {
    return there.count(m.identity) == 0;
  });
  if (fresh.size() > static_cast<std::size_t>(options_.most_fresh) &&
      fresh.size() > next->base->ids.size() / 4) {
    HOROPTER_ASSIGN_OR_RETURN(next->base, MakeTier(*published, members, stop));
    fresh.clear();
    fresh_pieces_.clear();
  }
  HOROPTER_ASSIGN_OR_RETURN(next->fresh, MakeTier(*published, fresh, stop));
  std::unordered_set<std::string_view> now;
  for (const Member& member : members) now.insert(member.identity);
  std::erase_if(fresh_pieces_, [&](const auto& piece) { return now.count(piece.first) == 0; });
  for (const auto& tier : {next->base, next->fresh}) {
    next->indices.push_back(&tier->index);
    next->ids.insert(next->ids.end(), tier->ids.begin(), tier->ids.end());
    for (const std::string& identity : tier->identities)
      next->wanted.push_back(now.count(identity) > 0 ? 1 : 0);
  }
  next->generation = published->snapshot.generation;
  next->parts = static_cast<int>(members.size());
  if (std::count(next->wanted.begin(), next->wanted.end(), 1) == std::ssize(next->wanted))
    next->wanted.clear();
  const std::lock_guard lock(mutex_);
  state_ = std::move(next);
  return absl::OkStatus();
}

std::shared_ptr<const RankingShard::State> RankingShard::Now() const {
  const std::lock_guard lock(mutex_);
  return state_;
}

ShardAnswer RankingShard::Rank(std::span<const RankingImage> images,
                               const StopRequested& stop) const {
  const std::shared_ptr<const State> state = Now();
  ShardAnswer answer;
  answer.shard = options_.shard;
  answer.generation = state->generation;
  answer.part_count = state->parts;
  answer.parts = RankShard(images,
                           state->indices,
                           state->ids,
                           state->wanted,
                           options_.shard.count,
                           options_.threads,
                           stop);
  return answer;
}

RankingShard::Figures RankingShard::figures() const {
  const std::shared_ptr<const State> state = Now();
  return {state->parts,
          state->fresh->index.pieces(),
          state->base->index.bytes() + state->fresh->index.bytes()};
}

}  // namespace horopter
