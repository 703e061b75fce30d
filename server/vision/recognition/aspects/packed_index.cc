#include "server/vision/recognition/aspects/packed_index.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <numeric>

#include "server/base/constants.h"
#include "server/base/target_clones.h"

namespace horopter {
namespace {

constexpr float kKeyStep = 2 * kPiF / 256;
constexpr int kMostCells = 200;        // along an axis
constexpr float kLargestCell = 10.0f;  // steps: a quarter radian, for kFewFragments
constexpr float kFewFragments = 4e5f;  // of more the cells are smaller, so that each holds as many
constexpr float kGrowth = 1.5f;        // of the balls that are searched, from one cell on
constexpr int kBlockSide = static_cast<int>(PackedBlock::kLanes);  // fragments of one
constexpr int kGroupCells = 2048;  // that are sorted within themselves
constexpr int kFirstPieces = 256;  // say how much memory all will take

// A fragment while the index is built: sixteen take the place of a block.
struct Record {
  BytePackedKey key;
  std::int8_t x, y;
  std::uint8_t spread;
  std::int8_t turn;
  std::uint32_t view;
};
static_assert(sizeof(PackedBlock) == PackedBlock::kLanes * sizeof(Record));

using PackedKeyVector = Eigen::Matrix<float, kFragmentAngles, 1>;

PackedKeyVector VectorOf(const BytePackedKey& key) {
  return Eigen::Map<const Eigen::Matrix<std::int8_t, kFragmentAngles, 1>>(key.data()).cast<float>();
}

Record RecordAt(const std::vector<PackedBlock>& blocks, std::size_t i) {
  Record out;
  std::memcpy(
      &out, reinterpret_cast<const char*>(blocks.data()) + i * sizeof(Record), sizeof(Record));
  return out;
}
void SetRecord(const Record& record, std::size_t i, std::vector<PackedBlock>* blocks) {
  std::memcpy(
      reinterpret_cast<char*>(blocks->data()) + i * sizeof(Record), &record, sizeof(Record));
}

// The records of a block side by side.
PackedBlock Transposed(const std::vector<PackedBlock>& blocks, std::size_t block) {
  PackedBlock out;
  for (int lane = 0; lane < kBlockSide; ++lane) {
    const Record r = RecordAt(blocks, block * kBlockSide + lane);
    for (int k = 0; k < kFragmentAngles; ++k) out.key[k][lane] = r.key[k];
    out.x[lane] = r.x;
    out.y[lane] = r.y;
    out.spread[lane] = r.spread;
    out.turn[lane] = r.turn;
    out.view[lane] = r.view;
  }
  return out;
}

// Records of bucket b to places begin[b] .. begin[b + 1], in place: there is no memory for a second
// copy of all (American flag sort).
template <typename BucketOf>
void SortInPlace(std::span<const std::uint32_t> begin,
                 const BucketOf& bucket_of,
                 std::vector<PackedBlock>* blocks) {
  std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1);
  for (std::size_t b = 0; b < next.size(); ++b) {
    while (next[b] < begin[b + 1]) {
      Record record = RecordAt(*blocks, next[b]);
      for (auto to = static_cast<std::size_t>(bucket_of(record)); to != b;
           to = static_cast<std::size_t>(bucket_of(record))) {
        const Record other = RecordAt(*blocks, next[to]);
        SetRecord(record, next[to]++, blocks);
        record = other;
      }
      SetRecord(record, next[b]++, blocks);
    }
  }
}

using SignedBytes = std::int8_t __attribute__((vector_size(kBlockSide)));
using BlockBytes = std::uint8_t __attribute__((vector_size(kBlockSide)));
using SquareSums = std::uint16_t __attribute__((vector_size(2 * kBlockSide)));

// Writes the fragments of [begin, end) whose keys differ by at most `limit`. Returns how many.
HOROPTER_TARGET_CLONES
std::size_t FindInBlocks(const PackedBlock* blocks,
                         const BytePackedKey& center,
                         std::uint32_t begin,
                         std::uint32_t end,
                         std::uint16_t limit,
                         CoarseKeys::Near* near) {
  constexpr int kHalf = kBlockSide / 2;
  std::size_t count = 0;
  for (std::uint32_t b = begin / PackedBlock::kLanes; b * PackedBlock::kLanes < end; ++b) {
    SquareSums sum = {};
    for (int k = 0; k < kFragmentAngles; ++k) {
      BlockBytes key;
      std::memcpy(&key, blocks[b].key[k].data(), sizeof(key));
      // Differences wrap, as angles do.
      const SignedBytes d =
          reinterpret_cast<SignedBytes>(key - static_cast<std::uint8_t>(center[k]));
      const BlockBytes away = reinterpret_cast<BlockBytes>(d < 0 ? -d : d);
      SquareSums wide = __builtin_convertvector(away, SquareSums);
      wide = wide < CoarseKeys::kFar ? wide : SquareSums{} + CoarseKeys::kFar;
      sum += wide * wide;
    }
    const SignedBytes hits = __builtin_convertvector(sum <= limit, SignedBytes);
    std::uint64_t halves[2];
    std::memcpy(halves, &hits, sizeof(halves));
    for (int half = 0; half < 2; ++half) {
      for (std::uint64_t m = halves[half]; m != 0;) {
        const int lane = half * kHalf + std::countr_zero(m) / 8;
        m &= ~(std::uint64_t{0xff} << 8 * (lane % kHalf));
        const std::uint32_t number = b * PackedBlock::kLanes + static_cast<std::uint32_t>(lane);
        near[count] = {number, sum[lane]};
        count += number >= begin && number < end ? 1 : 0;
      }
    }
  }
  return count;
}

// Largest difference, steps, of what a limit lets pass: both keys are rounded.
float RadiusOf(int limit) {
  return std::sqrt(static_cast<float>(limit + 1)) + std::sqrt(float{kFragmentAngles});
}

}  // namespace

void PackedIndex::Builder::Add(const PackedPiece& piece) {
  const auto first = static_cast<std::uint32_t>(views_.size());
  first_view_.push_back(first);
  views_.insert(views_.end(), piece.views.begin(), piece.views.end());
  blocks_.resize((count_ + piece.fragments.size() + kBlockSide - 1) / kBlockSide);
  for (const PackedFragment& f : piece.fragments) {
    SetRecord({f.key, f.x, f.y, f.spread, f.turn, first + f.view}, count_++, &blocks_);
  }
  if (static_cast<int>(first_view_.size()) != kFirstPieces || expected_ <= kFirstPieces) return;
  const double more = 1.05 * expected_ / kFirstPieces;
  first_view_.reserve(static_cast<std::size_t>(expected_));
  views_.reserve(static_cast<std::size_t>(more * static_cast<double>(views_.size())));
  blocks_.reserve(static_cast<std::size_t>(more * static_cast<double>(blocks_.size())));
}

PackedIndex PackedIndex::Builder::Finish() && {
  PackedIndex out;
  out.views_ = std::move(views_);
  out.first_view_ = std::move(first_view_);
  out.blocks_ = std::move(blocks_);
  out.count_ = static_cast<std::uint32_t>(count_);
  if (count_ == 0) return out;
  out.MakeGrid();
  out.SortIntoCells();
  for (std::size_t b = 0; b < out.blocks_.size(); ++b) out.blocks_[b] = Transposed(out.blocks_, b);
  return out;
}

std::size_t PackedIndex::bytes() const {
  return views_.size() * sizeof(PackedView) + first_view_.size() * sizeof(first_view_[0]) +
         blocks_.size() * sizeof(PackedBlock) + cell_begin_.size() * sizeof(cell_begin_[0]);
}

// The three directions in which keys differ most, of a sample; a key read backwards is as likely.
void PackedIndex::MakeGrid() {
  constexpr std::size_t kSample = 1'000'000;
  const std::size_t stride = 1 + count_ / kSample;
  Eigen::Matrix<double, kFragmentAngles, kFragmentAngles> moment;
  moment.setZero();
  for (std::size_t i = 0; i < count_; i += stride) {
    const auto v = VectorOf(RecordAt(blocks_, i).key).cast<double>().eval();
    moment += v * v.transpose();
    moment += v.reverse() * v.reverse().transpose();
  }
  const Eigen::SelfAdjointEigenSolver<decltype(moment)> solver(moment);
  axes_ = solver.eigenvectors().rightCols<3>().transpose().cast<float>();
  Eigen::Array3f low = Eigen::Array3f::Constant(1e9f), high = -low;
  for (std::size_t i = 0; i < count_; i += stride) {
    const Eigen::Array3f place = (axes_ * VectorOf(RecordAt(blocks_, i).key)).array();
    low = low.min(place);
    high = high.max(place);
  }
  low_ = low;
  cell_ = kLargestCell *
          std::cbrt(std::min(1.0f, kFewFragments / std::max(1.0f, static_cast<float>(count_))));
  cells_.counts = (((high - low) / cell_).floor().cast<int>() + 1).max(1).min(kMostCells);
}

int PackedIndex::CellOf(const BytePackedKey& key) const {
  const Eigen::Array3f place = ((axes_ * VectorOf(key)).array() - low_) / cell_;
  return cells_.NumberAt(place);
}

void PackedIndex::SortIntoCells() {
  cell_begin_.assign(static_cast<std::size_t>(cells_.total()) + 1, 0);
  for (std::uint32_t i = 0; i < count_; ++i) ++cell_begin_[CellOf(RecordAt(blocks_, i).key) + 1];
  std::partial_sum(cell_begin_.begin(), cell_begin_.end(), cell_begin_.begin());
  // By groups of cells first, then each within itself, where it stays in the cache.
  const int cells = static_cast<int>(cell_begin_.size()) - 1;
  std::vector<std::uint32_t> group_begin;
  for (int c = 0; c < cells; c += kGroupCells) group_begin.push_back(cell_begin_[c]);
  group_begin.push_back(count_);
  SortInPlace(
      group_begin, [&](const Record& r) { return CellOf(r.key) / kGroupCells; }, &blocks_);
  for (int first = 0; first < cells; first += kGroupCells) {
    const int end = std::min(cells, first + kGroupCells);
    SortInPlace(
        std::span(cell_begin_).subspan(first, end - first + 1),
        [&](const Record& r) { return CellOf(r.key) - first; },
        &blocks_);
  }
}

void PackedIndex::Offer(const FragmentKey& key,
                        std::uint32_t base,
                        std::span<const std::uint8_t> wanted,
                        NearestKeys* nearest) const {
  if (count_ == 0) return;
  const BytePackedKey center = PackKeyInBytes(key);
  const Eigen::Array3f place = ((axes_ * VectorOf(center)).array() - low_) / cell_;
  const auto reach_now = [&] { return RadiusOf(nearest->limit()) / cell_; };
  // Ball by ball: what a smaller one holds brings the limit down, and nothing is looked at twice.
  float done = -1.0f;
  for (float ball = 1.0f;; ball *= kGrowth) {
    const float reach = std::min(ball, reach_now());
    if (reach <= done) return;
    for (const KeyCells::Row& row : cells_.RowsAround(place, reach)) {
      const float now = std::min(reach, reach_now());
      if (row.away > now * now) break;
      const float r = std::sqrt(now * now - row.away);
      const int low = cells_.At(2, place[2] - r), high = cells_.At(2, place[2] + r);
      if (done < 0 || row.away > done * done) {
        OfferCells(row.first_cell + low, row.first_cell + high, center, base, wanted, nearest);
        continue;
      }
      const float known = std::sqrt(done * done - row.away);
      OfferCells(row.first_cell + low,
                 row.first_cell + cells_.At(2, place[2] - known) - 1,
                 center,
                 base,
                 wanted,
                 nearest);
      OfferCells(row.first_cell + cells_.At(2, place[2] + known) + 1,
                 row.first_cell + high,
                 center,
                 base,
                 wanted,
                 nearest);
    }
    done = reach;
  }
}

void PackedIndex::OfferCells(int first,
                             int last,
                             const BytePackedKey& center,
                             std::uint32_t base,
                             std::span<const std::uint8_t> wanted,
                             NearestKeys* nearest) const {
  constexpr std::uint32_t kBlock = 512;  // keys, between two looks at the limit
  std::array<CoarseKeys::Near, kBlock + 2 * PackedBlock::kLanes> near;
  if (first > last) return;
  const std::uint32_t end = cell_begin_[last + 1];
  for (std::uint32_t begin = cell_begin_[first]; begin < end; begin += kBlock) {
    const std::uint32_t stop = std::min(end, begin + kBlock);
    const auto limit = static_cast<std::uint16_t>(nearest->limit());
    const std::size_t n = FindInBlocks(blocks_.data(), center, begin, stop, limit, near.data());
    for (std::size_t k = 0; k < n; ++k) {
      if (wanted.empty() || wanted[PieceOf(At(near[k].number).view)] != 0)
        nearest->Offer(base + near[k].number, near[k].squared);
    }
  }
}

int PackedIndex::LimitOf(float radius_rad) {
  const float steps = radius_rad / kKeyStep;
  constexpr float kMost = CoarseKeys::kFar * CoarseKeys::kFar - 1;
  return static_cast<int>(std::min(steps * steps, kMost));
}

PackedIndex::Match PackedIndex::At(std::uint32_t fragment) const {
  const PackedBlock& block = blocks_[fragment / PackedBlock::kLanes];
  const std::uint32_t lane = fragment % PackedBlock::kLanes;
  return {block.view[lane],
          {PlaceOf(block.x[lane]), PlaceOf(block.y[lane])},
          SpreadOf(block.spread[lane]),
          TurnOfByte(block.turn[lane])};
}

int PackedIndex::PieceOf(std::uint32_t view) const {
  return static_cast<int>(std::upper_bound(first_view_.begin(), first_view_.end(), view) -
                          first_view_.begin()) -
         1;
}

}  // namespace horopter
