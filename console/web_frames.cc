#include "console/web_frames.h"

#include <algorithm>
#include <limits>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace horopter {
namespace {

constexpr unsigned char kMessage = 0x00;
constexpr unsigned char kTrailers = 0x80;

uint32_t BigEndian(std::string_view four) {
  uint32_t value = 0;
  for (const char c : four) value = value << 8 | static_cast<unsigned char>(c);
  return value;
}

std::string FrameHead(unsigned char flags, uint32_t bytes) {
  std::string head(kWebFrameHead, '\0');
  head[0] = static_cast<char>(flags);
  for (int i = 0; i < 4; ++i) head[1 + i] = static_cast<char>(bytes >> (24 - 8 * i) & 0xff);
  return head;
}

bool IsHeaderName(std::string_view name) {
  return !name.empty() && name.size() <= 128 && std::all_of(name.begin(), name.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '-' || c == '_' || c == '.';
  });
}

// As the protocol of gRPC over HTTP/2 has it for messages.
std::string PercentEncoded(std::string_view text) {
  constexpr char kHex[] = "0123456789ABCDEF";
  std::string encoded;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte >= 0x20 && byte < 0x7f && c != '%') {
      encoded.push_back(c);
    } else {
      encoded.append({'%', kHex[byte >> 4], kHex[byte & 15]});
    }
  }
  return encoded;
}

}  // namespace

absl::StatusOr<std::vector<std::string_view>> ReadWebMessages(std::string_view body, size_t most) {
  std::vector<std::string_view> messages;
  while (!body.empty()) {
    if (body.size() < kWebFrameHead) return absl::InvalidArgumentError("a frame is cut off");
    const auto flags = static_cast<unsigned char>(body[0]);
    if (flags != kMessage) {
      return absl::InvalidArgumentError(
          absl::StrCat("a frame with the flags ", flags, ": only plain messages are taken"));
    }
    const uint32_t bytes = BigEndian(body.substr(1, 4));
    if (body.size() - kWebFrameHead < bytes) {
      return absl::InvalidArgumentError(absl::StrCat(
          "a message of ", bytes, " bytes is cut off after ", body.size() - kWebFrameHead));
    }
    if (messages.size() == most) {
      return absl::InvalidArgumentError(absl::StrCat("more than ", most, " messages"));
    }
    messages.push_back(body.substr(kWebFrameHead, bytes));
    body.remove_prefix(kWebFrameHead + bytes);
  }
  if (messages.empty()) return absl::InvalidArgumentError("no message");
  return messages;
}

std::string WebMessageHead(uint32_t bytes) {
  return FrameHead(kMessage, bytes);
}

std::optional<std::string> WebHeaderValue(std::string_view name, std::string_view value) {
  if (!IsHeaderName(name)) return std::nullopt;
  if (name.ends_with("-bin")) {
    return absl::Base64Escape(absl::string_view(value.data(), value.size()));
  }
  const bool plain =
      std::all_of(value.begin(), value.end(), [](char c) { return c >= 0x20 && c < 0x7f; });
  return plain ? std::optional(std::string(value)) : std::nullopt;
}

std::string WebTrailerFrame(int code,
                            std::string_view message,
                            const std::multimap<std::string, std::string>& metadata) {
  std::string lines = absl::StrCat("grpc-status: ", code, "\r\n");
  if (!message.empty()) absl::StrAppend(&lines, "grpc-message: ", PercentEncoded(message), "\r\n");
  for (const auto& [name, value] : metadata) {
    const std::optional<std::string> sent = WebHeaderValue(name, value);
    if (sent && name != "grpc-status" && name != "grpc-message") {
      absl::StrAppend(&lines, name, ": ", *sent, "\r\n");
    }
  }
  return FrameHead(kTrailers, static_cast<uint32_t>(lines.size())) + lines;
}

std::optional<std::chrono::nanoseconds> ParseGrpcTimeout(std::string_view text) {
  constexpr size_t kMostDigits = 8;
  if (text.size() < 2 || text.size() > kMostDigits + 1) return std::nullopt;
  int64_t number = 0;
  for (const char c : text.substr(0, text.size() - 1)) {
    if (!absl::ascii_isdigit(static_cast<unsigned char>(c))) return std::nullopt;
    number = 10 * number + (c - '0');
  }
  constexpr int64_t kMost = std::numeric_limits<int64_t>::max();
  const auto times = [number](int64_t ns) {
    return std::chrono::nanoseconds(number > kMost / ns ? kMost : number * ns);
  };
  switch (text.back()) {
    case 'n':
      return times(1);
    case 'u':
      return times(1'000);
    case 'm':
      return times(1'000'000);
    case 'S':
      return times(1'000'000'000);
    case 'M':
      return times(60'000'000'000);
    case 'H':
      return times(3'600'000'000'000);
    default:
      return std::nullopt;
  }
}

}  // namespace horopter
