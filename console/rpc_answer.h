// A call's answer as pieces of HTTP.
#pragma once

#include <boost/asio/buffer.hpp>
#include <boost/beast/http/empty_body.hpp>
#include <boost/beast/http/message.hpp>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "console/bridge_call.h"

namespace horopter {

using RpcHead = boost::beast::http::response<boost::beast::http::empty_body>;

// What is written, in this order.
struct RpcPiece {
  std::string before, text;
  std::vector<grpc::Slice> slices;
  std::string after;
};

// They point into the piece, where it is now.
std::vector<boost::asio::const_buffer> BuffersOf(const RpcPiece& piece);

// Type, chunked coding and the metadata that can be headers.
void BeginAnswer(const std::multimap<std::string, std::string>& metadata,
                 bool keep_alive,
                 RpcHead* head);

// A chunk with the message's frame.
RpcPiece MessagePiece(const grpc::ByteBuffer& message);

// The chunk with the trailers, and the end of the chunks.
RpcPiece EndPiece(const grpc::Status& status,
                  const std::multimap<std::string, std::string>& metadata);

// Messages that point into the body, which lives as long as they do.
std::vector<grpc::ByteBuffer> SharedMessages(const std::shared_ptr<std::string>& body,
                                             const std::vector<std::string_view>& messages);

}  // namespace horopter
