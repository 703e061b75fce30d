#include <prometheus/text_serializer.h>

#include <sstream>

#include "console/console_state.h"

namespace horopter {
namespace {

prometheus::Family<prometheus::Counter>& NewCounter(prometheus::Registry& registry,
                                                    const std::string& name,
                                                    const std::string& help) {
  return prometheus::BuildCounter().Name(name).Help(help).Register(registry);
}

prometheus::Gauge& NewGauge(prometheus::Registry& registry,
                            const std::string& name,
                            const std::string& help) {
  return prometheus::BuildGauge().Name(name).Help(help).Register(registry).Add({});
}

}  // namespace

ConsoleMetrics::ConsoleMetrics()
    : requests_(NewCounter(registry_, "horopter_console_requests_total", "Requests of browsers")),
      answers_(NewCounter(registry_, "horopter_console_calls_total", "Calls by the server's code")),
      refusals_(NewCounter(
          registry_, "horopter_console_refusals_total", "Requests and connections refused")),
      connections_(NewGauge(registry_, "horopter_console_connections", "Connections of browsers")),
      calls_(NewGauge(registry_, "horopter_console_running_calls", "Calls that are running")),
      sessions_(NewGauge(registry_, "horopter_console_sessions", "Sessions that are signed in")),
      body_bytes_(NewGauge(
          registry_, "horopter_console_body_bytes", "Reserved for requests on their way")) {}

void ConsoleMetrics::CountRequest(const std::string& kind, int status) {
  requests_.Add({{"kind", kind}, {"status", std::to_string(status)}}).Increment();
}

void ConsoleMetrics::CountCall(int code) {
  answers_.Add({{"code", std::to_string(code)}}).Increment();
}

void ConsoleMetrics::CountRefusal(const std::string& why) {
  refusals_.Add({{"why", why}}).Increment();
}

std::string ConsoleMetrics::Text() const {
  std::ostringstream text;
  prometheus::TextSerializer().Serialize(text, registry_.Collect());
  return text.str();
}

}  // namespace horopter
