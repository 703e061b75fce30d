// What all connections of the console share. Of one thread.
#pragma once

#include <grpcpp/channel.h>
#include <grpcpp/generic/generic_stub.h>
#include <prometheus/counter.h>
#include <prometheus/gauge.h>
#include <prometheus/registry.h>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "client/channel.h"
#include "console/page_files.h"
#include "console/peer_rates.h"
#include "console/sessions.h"

namespace horopter {

struct ConsoleOptions {
  std::string listen = "127.0.0.1:8080";  // HOST:PORT, port 0: any free one
  std::string certificate, key;           // PEM, of this listener; empty: no TLS
  // Listen without TLS where others can read along, or send tokens on without TLS.
  bool insecure = false;
  std::vector<std::string> names;  // further names that browsers may call it by

  std::string server = "localhost:50051";
  ChannelSecurity security;  // towards the server; its token stays empty

  std::string page;  // folder; auto: FindPageFolder()

  int max_connections = 256;
  int max_connections_per_peer = 64;  // raising it lets one address take more of them
  int max_body_mb = 256;              // of a request; the server's own bounds are tested there
  int memory_mb = 512;                // bodies of all requests on their way to the server
  int max_calls = 128;                // of the server, at once
  int max_watches = 64;               // pages that watch answers, beside these
  double head_seconds = 15.0;         // for the head of a request
  double body_seconds = 300.0;        // for its body
  double idle_seconds = 120.0;        // between two requests of a connection
  double write_seconds = 60.0;        // for a piece of an answer; slower readers are cut off
  double call_seconds = 3600.0;       // for a call without a deadline of its own
  double stop_seconds = 5.0;          // for running calls after SIGTERM
  RateOptions rate;
  double sign_ins_per_minute = 6.0;  // of an address, good or bad
  SessionOptions session;
};

// What the process counts of itself (Prometheus).
class ConsoleMetrics {
 public:
  ConsoleMetrics();
  void CountRequest(const std::string& kind, int status);
  void CountCall(int code);
  void CountRefusal(const std::string& why);
  prometheus::Gauge& connections() { return connections_; }
  prometheus::Gauge& calls() { return calls_; }
  prometheus::Gauge& sessions() { return sessions_; }
  prometheus::Gauge& body_bytes() { return body_bytes_; }
  // As Prometheus reads it.
  std::string Text() const;

 private:
  prometheus::Registry registry_;
  prometheus::Family<prometheus::Counter>& requests_;
  prometheus::Family<prometheus::Counter>& answers_;
  prometheus::Family<prometheus::Counter>& refusals_;
  prometheus::Gauge& connections_;
  prometheus::Gauge& calls_;
  prometheus::Gauge& sessions_;
  prometheus::Gauge& body_bytes_;
};

struct ConsoleState {
  ConsoleState(const ConsoleOptions& the_options, std::shared_ptr<grpc::Channel> the_channel)
      : options(the_options),
        channel(the_channel),
        stub(the_channel),
        sessions(the_options.session),
        rates(the_options.rate),
        sign_ins({the_options.sign_ins_per_minute / 60.0, 10.0 + the_options.sign_ins_per_minute}) {
  }

  const ConsoleOptions options;
  const std::shared_ptr<grpc::Channel> channel;
  grpc::GenericStub stub;
  ConsoleSessions sessions;
  PeerRates rates, sign_ins;
  PageFiles page;
  ConsoleMetrics metrics;
  int64_t body_bytes = 0;  // reserved for bodies on their way
  int calls = 0;           // of the server, running
  int watches = 0;         // of answers, beside these
};

}  // namespace horopter
