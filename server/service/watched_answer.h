// The end of a call of RecognizeScene as watchers are told of it: serialized pieces of a
// WatchedAnswer, made once and sent to all.
#pragma once

#include <cstdint>
#include <string>

#include "server/service/image_decode.h"
#include "server/service/request_record.h"

namespace horopter {

// Of a WatchedAnswer whose pieces follow each other on the wire; messages merge by that.
struct AnswerPieces {
  std::string about;             // all but images, previews and what depends on the watcher
  std::string images;            // as they came; empty: none
  bool images_left_out = false;  // there are some, but they are too large
  std::string station;           // `stations/{station}` that the request names
};

// Copies what is told of the call; images of more than `most_image_bytes` together, and responses
// of more than `most_about_bytes`, are left out. record: of RecognizeScene, within
// RequestSink::OnRequest.
AnswerPieces PiecesOf(const RequestRecord& record,
                      int64_t number,
                      int64_t most_about_bytes,
                      int64_t most_image_bytes);

// What depends on the watcher.
struct AnswerTail {
  int64_t lost = 0;
  int64_t refused = 0;
  bool earlier = false;
  bool images_left_out = false;
};
std::string TailPiece(const AnswerTail& tail);

// Previews of AnswerPieces::images. One that cannot be shown (damaged, too large) is empty. Takes
// some 10 ms an image.
std::string PreviewPiece(const std::string& images, const ImageLimits& limits);

}  // namespace horopter
