// The packed fragments of very many parts (packed_piece.h), found by the similarity of their keys.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "server/vision/recognition/aspects/key_cells.h"
#include "server/vision/recognition/aspects/near_keys.h"
#include "server/vision/recognition/aspects/packed_piece.h"

namespace horopter {

// Sixteen fragments side by side, so that their keys are compared at once.
struct PackedBlock {
  static constexpr std::uint32_t kLanes = CoarseKeys::kLanes;
  std::array<std::array<std::int8_t, kLanes>, kFragmentAngles> key;
  std::array<std::int8_t, kLanes> x, y;
  std::array<std::uint8_t, kLanes> spread;
  std::array<std::int8_t, kLanes> turn;
  std::array<std::uint32_t, kLanes> view;
};

// Immutable once built; any number of threads may search it. 16 bytes a fragment, 50 a view.
class PackedIndex {
 public:
  // Takes pieces one after the other, so that nobody has to hold all of them.
  class Builder {
   public:
    // expected: how many pieces will come, for memory.
    explicit Builder(int expected) : expected_(expected) {}
    void Add(const PackedPiece& piece);
    PackedIndex Finish() &&;

   private:
    const int expected_;
    std::vector<PackedView> views_;
    std::vector<std::uint32_t> first_view_;
    std::vector<PackedBlock> blocks_;  // sixteen records each, until they are sorted
    std::size_t count_ = 0;
  };

  int pieces() const { return static_cast<int>(first_view_.size()); }
  std::uint32_t fragments() const { return count_; }
  std::size_t bytes() const;

  // Offers fragments whose keys differ by at most nearest->limit(), in squared steps of
  // BytePackedKey: at least those that it takes. They are named by `base` + their number. `wanted`:
  // a flag for each piece, the others are not found; empty: all.
  void Offer(const FragmentKey& key,
             std::uint32_t base,
             std::span<const std::uint8_t> wanted,
             NearestKeys* nearest) const;
  // For NearestKeys: the squared steps of keys that differ by a radius (radians).
  static int LimitOf(float radius_rad);

  // What a fragment says about its view.
  struct Match {
    std::uint32_t view = 0;
    Eigen::Vector2f center = Eigen::Vector2f::Zero();  // diameters
    float spread = 0.0f;
    IndexedTurn turn;
  };
  Match At(std::uint32_t fragment) const;
  const PackedView& View(std::uint32_t view) const { return views_[view]; }
  int PieceOf(std::uint32_t view) const;

 private:
  void MakeGrid();
  void SortIntoCells();
  int CellOf(const BytePackedKey& key) const;
  // Offers what lies in the cells first .. last.
  void OfferCells(int first,
                  int last,
                  const BytePackedKey& center,
                  std::uint32_t base,
                  std::span<const std::uint8_t> wanted,
                  NearestKeys* nearest) const;

  std::vector<PackedView> views_;
  std::vector<std::uint32_t> first_view_;  // of each piece
  std::vector<PackedBlock> blocks_;
  std::uint32_t count_ = 0;
  // Cell (i, j, k) holds fragments cell_begin[c] .. cell_begin[c + 1], k fastest.
  Eigen::Matrix<float, 3, kFragmentAngles> axes_ =
      Eigen::Matrix<float, 3, kFragmentAngles>::Zero();  // orthonormal rows
  Eigen::Array3f low_ = Eigen::Array3f::Zero();          // steps, as cell_
  KeyCells cells_ = {Eigen::Array3i::Ones()};
  float cell_ = 1.0f;
  std::vector<std::uint32_t> cell_begin_ = {0, 0};
};

}  // namespace horopter
