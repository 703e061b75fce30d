#include "console/rpc_answer.h"

#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "console/web_frames.h"
#include "console/web_reply.h"

namespace horopter {
namespace {

namespace http = boost::beast::http;

std::string ChunkHead(size_t bytes) {
  return absl::StrCat(absl::Hex(bytes), "\r\n");
}

}  // namespace

std::vector<boost::asio::const_buffer> BuffersOf(const RpcPiece& piece) {
  std::vector<boost::asio::const_buffer> buffers = {boost::asio::buffer(piece.before),
                                                    boost::asio::buffer(piece.text)};
  for (const grpc::Slice& slice : piece.slices) buffers.emplace_back(slice.begin(), slice.size());
  buffers.push_back(boost::asio::buffer(piece.after));
  return buffers;
}

void BeginAnswer(const std::multimap<std::string, std::string>& metadata,
                 bool keep_alive,
                 RpcHead* head) {
  SetSafeFields(*head);
  head->set(http::field::content_type, "application/grpc-web+proto");
  // Of the server's metadata only what is ours: none can change how a browser takes the answer.
  for (const auto& [name, value] : metadata) {
    const std::optional<std::string> sent = WebHeaderValue(name, value);
    if (sent && absl::StartsWith(name, "horopter-")) head->insert(name, *sent);
  }
  head->keep_alive(keep_alive);
  head->chunked(true);
}

RpcPiece MessagePiece(const grpc::ByteBuffer& message) {
  RpcPiece piece;
  message.Dump(&piece.slices);
  piece.text = WebMessageHead(static_cast<uint32_t>(message.Length()));
  piece.before = ChunkHead(message.Length() + piece.text.size());
  piece.after = "\r\n";
  return piece;
}

RpcPiece EndPiece(const grpc::Status& status,
                  const std::multimap<std::string, std::string>& metadata) {
  RpcPiece piece;
  piece.text = WebTrailerFrame(status.error_code(), status.error_message(), metadata);
  piece.before = ChunkHead(piece.text.size());
  piece.after = "\r\n0\r\n\r\n";
  return piece;
}

std::vector<grpc::ByteBuffer> SharedMessages(const std::shared_ptr<std::string>& body,
                                             const std::vector<std::string_view>& messages) {
  using Owner = std::shared_ptr<std::string>;
  std::vector<grpc::ByteBuffer> shared;
  for (const std::string_view message : messages) {
    const grpc::Slice slice(
        const_cast<char*>(message.data()),
        message.size(),
        [](void* owner) { delete static_cast<Owner*>(owner); },
        new Owner(body));
    shared.emplace_back(&slice, 1);
  }
  return shared;
}

}  // namespace horopter
