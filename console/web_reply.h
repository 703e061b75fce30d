// Answers that are whole: files of the page, refusals, the state of the session.
#pragma once

#include <boost/beast/http/message.hpp>
#include <boost/beast/http/string_body.hpp>
#include <string>
#include <string_view>

#include "console/page_files.h"

namespace horopter {

using WebRequestHead = boost::beast::http::request_header<>;
using WebReply = boost::beast::http::response<boost::beast::http::string_body>;

// With what every answer has: no sniffing, no frames, no foreign scripts, nothing stored.
void SetSafeFields(boost::beast::http::fields& fields);

WebReply TextReply(boost::beast::http::status status,
                   std::string text,
                   std::string_view type = "text/plain; charset=utf-8");

// Gzipped where the browser takes it; 304 where it has it; without body for HEAD.
WebReply FileReply(const PageFile& file, const WebRequestHead& head);

// `text` as a string of JSON.
std::string JsonString(std::string_view text);

// The field's value; empty: not there.
std::string_view FieldOf(const WebRequestHead& head, std::string_view name);

}  // namespace horopter
