#include "server/vision/invariants/key_segment.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <span>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/checked_blob.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr std::string_view kSegmentMagic = "HSEG";
constexpr int kDimensions[] = {5, 5, 3};
constexpr std::size_t kSegmentHeaderBytes = 4 + 3 * 4 + 3 * 8;
constexpr std::size_t kDigestBytes = 64;
// As SharedKeys in key_index.cc: keys of an object that are asked for, and how near is near, a
// squared Mahalanobis distance of 4 at a deviation of 0.02.
constexpr std::size_t kMostAsked = 64;
constexpr double kReach = 0.04;

std::size_t MemberBytes(std::uint64_t keys) {
  return (keys * sizeof(std::uint16_t) + 3) / 4 * 4;
}

// The finaliser of splitmix64.
std::uint64_t Mix(std::uint64_t hash, std::uint64_t value) {
  hash += value + 0x9e3779b97f4a7c15ull;
  hash = (hash ^ (hash >> 30)) * 0xbf58476d1ce4e5b9ull;
  hash = (hash ^ (hash >> 27)) * 0x94d049bb133111ebull;
  return hash ^ (hash >> 31);
}

template <typename Values>
void Count(int table, const Values& values, KeySegmentView::Tally* tally) {
  std::uint64_t hash = Mix(0, static_cast<std::uint64_t>(table));
  for (const float v : values) hash = Mix(hash, std::bit_cast<std::uint32_t>(v));
  ++tally->count;
  tally->sum += hash;
}

}  // namespace

void KeySegmentWriter::Add(std::string_view address, const ObjectKeys& keys) {
  const auto member = static_cast<std::uint16_t>(members());
  addresses_.append(address.substr(0, kAddressBytes));
  addresses_.append(kAddressBytes - std::min(kAddressBytes, address.size()), '0');
  const auto add = [&](std::vector<Key>& table, const auto& rows) {
    for (const auto& row : rows) {
      Key& key = table.emplace_back();
      std::copy(row.values.begin(), row.values.end(), key.values.begin());
      key.member = member;
    }
  };
  add(tables_[0], keys.chains);
  add(tables_[1], keys.stars);
  add(tables_[2], keys.six_points);
}

std::string KeySegmentWriter::Finish() && {
  std::string out(kSegmentMagic);
  AppendNumber(out, kKeySegmentVersion);
  AppendNumber(out, static_cast<std::uint32_t>(members()));
  AppendNumber(out, std::uint32_t{0});
  std::size_t bytes = kSegmentHeaderBytes + addresses_.size() + kDigestBytes;
  for (int t = 0; t < 3; ++t) {
    const std::uint64_t keys = tables_[t].size();
    AppendNumber(out, keys);
    bytes += keys * kDimensions[t] * sizeof(float) + MemberBytes(keys);
  }
  out.reserve(bytes);
  out += addresses_;
  for (int t = 0; t < 3; ++t) {
    std::vector<Key> table = std::exchange(tables_[t], {});
    std::stable_sort(table.begin(), table.end(), [](const Key& a, const Key& b) {
      return a.values[0] < b.values[0];
    });
    for (int d = 0; d < kDimensions[t]; ++d) {
      for (const Key& key : table) AppendNumber(out, key.values[d]);
    }
    for (const Key& key : table) AppendNumber(out, key.member);
    out.append(MemberBytes(table.size()) - table.size() * sizeof(std::uint16_t), '\0');
  }
  out += Sha256Hex(out);
  return out;
}

absl::StatusOr<KeySegmentView> KeySegmentView::Of(std::string_view bytes) {
  if (std::bit_cast<std::uintptr_t>(bytes.data()) % alignof(float) != 0)
    return absl::InternalError("key segment: bytes are not aligned");
  BlobReader reader(bytes);
  if (reader.TakeBytes(kSegmentMagic.size()) != kSegmentMagic)
    return absl::DataLossError("key segment: wrong magic");
  const auto version = reader.Take<std::uint32_t>();
  if (reader.ok() && version != kKeySegmentVersion) {
    return absl::FailedPreconditionError(absl::StrCat(
        "key segment: of version ", version, ", this program reads ", kKeySegmentVersion));
  }
  KeySegmentView view;
  view.bytes_ = bytes;
  const auto members = reader.Take<std::uint32_t>();
  reader.Take<std::uint32_t>();
  for (int t = 0; t < 3; ++t) {
    const auto count = reader.Take<std::uint64_t>();
    if (count > bytes.size()) return absl::DataLossError("key segment: cut short");
    view.tables_[t].count = static_cast<int64_t>(count);
    view.tables_[t].dimensions = kDimensions[t];
  }
  if (members > kMaxSegmentMembers) return absl::DataLossError("key segment: too many members");
  view.members_ = static_cast<int>(members);
  view.addresses_ = reader.TakeBytes(members * kAddressBytes);
  for (Table& table : view.tables_) {
    const auto count = static_cast<std::uint64_t>(table.count);
    table.values = reinterpret_cast<const float*>(
        reader.TakeBytes(count * table.dimensions * sizeof(float)).data());
    table.of = reinterpret_cast<const std::uint16_t*>(reader.TakeBytes(MemberBytes(count)).data());
  }
  if (!reader.ok() || reader.left() != kDigestBytes)
    return absl::DataLossError("key segment: cut short, or bytes behind it");
  return view;
}

absl::Status KeySegmentView::Verify() const {
  const std::string_view body = bytes_.substr(0, bytes_.size() - kDigestBytes);
  if (Sha256Hex(body) != bytes_.substr(body.size()))
    return absl::DataLossError("key segment: wrong digest");
  for (const Table& table : tables_) {
    const auto last = table.of + table.count;
    if (std::any_of(table.of, last, [&](int member) { return member >= members_; }))
      return absl::DataLossError("key segment: key of no member");
  }
  return absl::OkStatus();
}

template <typename Key>
void KeySegmentView::Ask(const Table& table,
                         const std::vector<Key>& keys,
                         std::vector<int>* shared) const {
  std::vector<int> last_asked(members_, 0);
  const std::size_t asked = std::min(keys.size(), kMostAsked);
  const float* const end = table.values + table.count;
  for (std::size_t k = 0; k < asked; ++k) {
    const auto& values = keys[k * keys.size() / asked].values;
    // A little wider: distances are compared below.
    const auto from = static_cast<float>(values[0] - 1.001 * kReach);
    const auto to = static_cast<float>(values[0] + 1.001 * kReach);
    const float* const first = std::lower_bound(table.values, end, from);
    const float* const last = std::upper_bound(first, end, to);
    for (const float* at = first; at != last; ++at) {
      const std::int64_t i = at - table.values;
      double squared = 0.0;
      for (int d = 0; d < table.dimensions && squared <= kReach * kReach; ++d) {
        const double by = static_cast<double>(table.values[d * table.count + i]) - values[d];
        squared += by * by;
      }
      if (squared > kReach * kReach) continue;
      const int member = table.of[i];
      if (member >= members_) continue;  // the file has changed since it was verified
      const int number = static_cast<int>(k) + 1;
      if (last_asked[member] != number) ++(*shared)[member];  // each key counts once
      last_asked[member] = number;
    }
  }
}

void KeySegmentView::AddSharedKeys(const ObjectKeys& keys, std::vector<int>* shared) const {
  Ask(tables_[0], keys.chains, shared);
  Ask(tables_[1], keys.stars, shared);
  Ask(tables_[2], keys.six_points, shared);
}

std::vector<KeySegmentView::Tally> KeySegmentView::Tallies() const {
  std::vector<Tally> tallies(members_);
  for (int t = 0; t < 3; ++t) {
    const Table& table = tables_[t];
    std::vector<float> values(table.dimensions);
    for (std::int64_t i = 0; i < table.count; ++i) {
      for (int d = 0; d < table.dimensions; ++d) values[d] = table.values[d * table.count + i];
      if (table.of[i] < members_) Count(t, values, &tallies[table.of[i]]);
    }
  }
  return tallies;
}

KeySegmentView::Tally KeySegmentView::TallyOf(const ObjectKeys& keys) {
  Tally tally;
  for (const auto& key : keys.chains) Count(0, key.values, &tally);
  for (const auto& key : keys.stars) Count(1, key.values, &tally);
  for (const auto& key : keys.six_points) Count(2, key.values, &tally);
  return tally;
}

}  // namespace horopter
