// W3C trace context and spans in OTLP/JSON.
#pragma once

#include <string>
#include <string_view>

#include "server/service/request_record.h"

namespace horopter {

// The context of a call whose `traceparent` header is given. A header that is not valid (version
// ff, wrong lengths, other than hex digits, zero ids) counts as none: a new trace begins.
TraceContext TraceContextFrom(std::string_view traceparent);

// One line: an ExportTraceServiceRequest in OTLP/JSON with a server span for the call, one for its
// time in the queue and one per stage. Stages follow each other from the end of the queue on.
std::string OtlpJson(const RequestRecord& record);

}  // namespace horopter
