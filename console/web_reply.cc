#include "console/web_reply.h"

#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/match.h"

namespace horopter {
namespace {

namespace http = boost::beast::http;

// Scripts and styles are the page's files alone; pictures may also come from its own memory.
constexpr char kContentPolicy[] =
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "media-src 'self' blob:; connect-src 'self'; font-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'";

}  // namespace

void SetSafeFields(http::fields& fields) {
  fields.set(http::field::server, "horopter-console");
  fields.set("Content-Security-Policy", kContentPolicy);
  fields.set("X-Content-Type-Options", "nosniff");
  fields.set("X-Frame-Options", "DENY");
  fields.set("Referrer-Policy", "no-referrer");
  fields.set("Cross-Origin-Opener-Policy", "same-origin");
  fields.set("Cross-Origin-Resource-Policy", "same-origin");
  fields.set("Permissions-Policy", "camera=(self), microphone=(), geolocation=()");
  fields.set(http::field::cache_control, "no-store");
}

WebReply TextReply(http::status status, std::string text, std::string_view type) {
  WebReply reply(status, 11);
  SetSafeFields(reply);
  reply.set(http::field::content_type, boost::beast::string_view(type.data(), type.size()));
  reply.body() = std::move(text);
  reply.prepare_payload();
  return reply;
}

std::string_view FieldOf(const WebRequestHead& head, std::string_view name) {
  const auto found = head.find(boost::beast::string_view(name.data(), name.size()));
  if (found == head.end()) return {};
  return {found->value().data(), found->value().size()};
}

WebReply FileReply(const PageFile& file, const WebRequestHead& head) {
  WebReply reply(http::status::ok, 11);
  SetSafeFields(reply);
  reply.set(http::field::etag, file.etag);
  reply.set(http::field::cache_control,
            file.lasting ? "public, max-age=31536000, immutable" : "no-cache");
  if (FieldOf(head, "If-None-Match") == file.etag) {
    reply.result(http::status::not_modified);
    return reply;
  }
  reply.set(http::field::content_type, file.type);
  reply.set(http::field::vary, "Accept-Encoding");
  const bool zipped = !file.gzipped.empty() &&
                      absl::StrContains(std::string(FieldOf(head, "Accept-Encoding")), "gzip");
  if (zipped) reply.set(http::field::content_encoding, "gzip");
  const std::string& content = zipped ? file.gzipped : file.content;
  reply.content_length(content.size());
  if (head.method() != http::verb::head) reply.body() = content;
  return reply;
}

std::string JsonString(std::string_view text) {
  return nlohmann::json(text).dump(-1, ' ', true, nlohmann::json::error_handler_t::replace);
}

}  // namespace horopter
