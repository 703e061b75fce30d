#include "server/vision/recognition/object/ranking_keys.h"

namespace horopter {

PackedPiece RankingPiece(const PreparedObject& object) {
  if (object.aspects == nullptr) return {};
  return Pack(MakeFragmentPiece(object.aspects->object, object.aspects->fragments, kPackedChoice));
}

}  // namespace horopter
