// Frames of gRPC-Web: one byte of flags, four of the length (most significant first), the bytes.
// https://github.com/grpc/grpc/blob/master/doc/PROTOCOL-WEB.md
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"

namespace horopter {

constexpr size_t kWebFrameHead = 5;

// The messages of a request's body, in place. Errors: INVALID_ARGUMENT (none or more than `most`,
// cut off, compressed, a frame that is no message).
absl::StatusOr<std::vector<std::string_view>> ReadWebMessages(std::string_view body, size_t most);

// What stands before a message of so many bytes.
std::string WebMessageHead(uint32_t bytes);

// The last frame of an answer: status, its message in percent-encoding, and the trailing metadata;
// of these keys that are no names of headers are dropped, and values of keys that end in -bin are
// base64.
std::string WebTrailerFrame(int code,
                            std::string_view message,
                            const std::multimap<std::string, std::string>& metadata);

// Name and value of metadata as a header of HTTP; unset: it cannot be one.
std::optional<std::string> WebHeaderValue(std::string_view name, std::string_view value);

// The header grpc-timeout: up to eight digits and a unit. Unset: it is none.
std::optional<std::chrono::nanoseconds> ParseGrpcTimeout(std::string_view text);

}  // namespace horopter
