#include "server/vision/recognition/aspects/packed_piece.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <type_traits>

#include "server/base/checked_blob.h"
#include "server/base/constants.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {
namespace {

static_assert(sizeof(PackedView) == 50 && sizeof(PackedFragment) == 14,
              "both are written as they lie in memory");
static_assert(std::is_trivially_copyable_v<PackedView> &&
              std::is_trivially_copyable_v<PackedFragment>);

constexpr std::string_view kPieceMagic = "HRKP";  // first bytes of the stored format
constexpr float kTurnStep = 2 * kPiF / 256;
constexpr float kPlaceScale =
    FirstVotePoints::kPlaceScale / static_cast<float>(PackedView::kPlaceShift);
constexpr float kLeastSpread = 1.0f / 128;  // diameters: fragments are 0.14 long at least
constexpr float kSpreadStep = 0.019f;       // of the logarithm: 255 of them reach 1

std::int8_t ByteOfAngle(float rad) {
  return static_cast<std::int8_t>(static_cast<std::uint8_t>(std::lround(rad / kTurnStep)));
}
std::int8_t ByteOfPlace(float diameters) {
  return static_cast<std::int8_t>(std::lround(std::clamp(diameters * kPlaceScale, -127.f, 127.f)));
}
std::uint8_t ByteOfSpread(float diameters) {
  const float steps = std::log(std::max(diameters, kLeastSpread) / kLeastSpread) / kSpreadStep;
  return static_cast<std::uint8_t>(std::lround(std::min(steps, 255.0f)));
}

PackedView PackView(const IndexedAspect& aspect, const VotePoint* points) {
  PackedView out;
  for (int i = 0; i < kFirstVotePoints; ++i) {
    out.x[i] = ByteOfPlace(points[i].x);
    out.y[i] = ByteOfPlace(points[i].y);
    out.bin[i] = static_cast<std::uint8_t>(points[i].bin * PackedView::kBinSteps);
  }
  const float length = aspect.edge_length * PackedView::kLengthScale;
  out.edge_length = static_cast<std::uint16_t>(std::clamp(length, 1.0f, 65535.0f));
  return out;
}

template <typename T>
void AppendList(const std::vector<T>& list, std::string* out) {
  AppendNumber(*out, static_cast<std::uint32_t>(list.size()));
  out->append(reinterpret_cast<const char*>(list.data()), list.size() * sizeof(T));
}

template <typename T>
absl::Status TakeList(BlobReader* reader, std::vector<T>* list) {
  const auto count = reader->Take<std::uint32_t>();
  if (!reader->ok() || reader->left() < std::size_t{count} * sizeof(T))
    return absl::DataLossError("ranking keys: truncated");
  list->resize(count);
  const std::string_view bytes = reader->TakeBytes(std::size_t{count} * sizeof(T));
  if (!bytes.empty()) std::memcpy(list->data(), bytes.data(), bytes.size());
  return absl::OkStatus();
}

}  // namespace

BytePackedKey PackKeyInBytes(const FragmentKey& key) {
  BytePackedKey out;
  std::transform(key.begin(), key.end(), out.begin(), ByteOfAngle);
  return out;
}

FirstVotePoints UnpackFirstPoints(const PackedView& view) {
  constexpr int kBinFactor = FirstVotePoints::kBinSteps / PackedView::kBinSteps;
  FirstVotePoints out;
  for (int i = 0; i < kFirstVotePoints; ++i) {
    out.x[i] = static_cast<std::int16_t>(view.x[i] * PackedView::kPlaceShift);
    out.y[i] = static_cast<std::int16_t>(view.y[i] * PackedView::kPlaceShift);
    out.bin[i] = static_cast<std::uint16_t>(view.bin[i] * kBinFactor);
  }
  return out;
}

std::array<VotePoint, kFirstVotePoints> UnpackPoints(const PackedView& view) {
  std::array<VotePoint, kFirstVotePoints> out;
  for (int i = 0; i < kFirstVotePoints; ++i) {
    out[i] = {PlaceOf(view.x[i]),
              PlaceOf(view.y[i]),
              static_cast<float>(view.bin[i]) / static_cast<float>(PackedView::kBinSteps)};
  }
  return out;
}

float EdgeLength(const PackedView& view) {
  return static_cast<float>(view.edge_length) / PackedView::kLengthScale;
}

float SpreadOf(std::uint8_t packed) {
  // Asked for each vote that is tested.
  static const std::array<float, 256> spreads = [] {
    std::array<float, 256> out;
    for (int i = 0; i < 256; ++i)
      out[i] = kLeastSpread * std::exp(kSpreadStep * static_cast<float>(i));
    return out;
  }();
  return spreads[packed];
}
float PlaceOf(std::int8_t packed) {
  return static_cast<float>(packed) / kPlaceScale;
}
const IndexedTurn& TurnOfByte(std::int8_t packed) {
  static const std::array<IndexedTurn, 256> turns = [] {
    std::array<IndexedTurn, 256> out;
    for (int i = 0; i < 256; ++i) out[i] = IndexedTurn(static_cast<float>(i - 128) * kTurnStep);
    return out;
  }();
  return turns[packed + 128];
}

PackedPiece Pack(const FragmentPiece& piece) {
  PackedPiece out;
  std::vector<int> place(piece.aspects.size(), -1);
  for (std::size_t a = 0; a < piece.aspects.size(); ++a) {
    if (piece.aspects[a].points < kFirstVotePoints) continue;
    place[a] = static_cast<int>(out.views.size());
    out.views.push_back(
        PackView(piece.aspects[a], piece.points.data() + piece.aspects[a].first_point));
  }
  for (const FragmentPiece::Entry& e : piece.entries) {
    if (place[e.fragment.aspect] < 0) continue;
    out.fragments.push_back({PackKeyInBytes(UnpackKey(e.key)),
                             ByteOfPlace(e.fragment.x),
                             ByteOfPlace(e.fragment.y),
                             ByteOfSpread(e.fragment.spread),
                             ByteOfAngle(e.fragment.turn.rad),
                             static_cast<std::uint16_t>(place[e.fragment.aspect])});
  }
  return out;
}

std::string EncodePackedPiece(const PackedPiece& piece) {
  std::string body;
  AppendList(piece.views, &body);
  AppendList(piece.fragments, &body);
  return WithBlobHeader(kPieceMagic, kPackedPieceVersion, 0, body);
}

absl::StatusOr<PackedPiece> DecodePackedPiece(std::string_view blob) {
  HOROPTER_RETURN_IF_ERROR(
      TakeBlobHeader("ranking keys", kPieceMagic, kPackedPieceVersion, &blob).status());
  BlobReader reader(blob);
  PackedPiece out;
  HOROPTER_RETURN_IF_ERROR(TakeList(&reader, &out.views));
  HOROPTER_RETURN_IF_ERROR(TakeList(&reader, &out.fragments));
  if (reader.left() != 0) return absl::DataLossError("ranking keys: too long");
  for (const PackedFragment& f : out.fragments) {
    if (f.view >= out.views.size()) return absl::DataLossError("ranking keys: view out of range");
  }
  for (const PackedView& v : out.views) {
    if (*std::max_element(v.bin.begin(), v.bin.end()) >= kAspectBins * PackedView::kBinSteps)
      return absl::DataLossError("ranking keys: direction out of range");
  }
  return out;
}

}  // namespace horopter
