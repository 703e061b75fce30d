// One address of the server with the services behind it.
#pragma once

#include <chrono>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/service/acceptor.h"
#include "server/service/access.h"
#include "server/service/answer_service.h"
#include "server/service/catalog_service.h"
#include "server/service/ranking_service.h"
#include "server/service/recognition_service.h"
#include "server/service/server_info_service.h"
#include "server/service/station_service.h"
#include "server/service/transport_security.h"

namespace grpc {
class Channel;
class Server;
class ServerBuilder;
class ServerCredentials;
}  // namespace grpc

namespace horopter {

struct ListenerOptions {
  std::string address;  // HOST:PORT or unix:PATH; empty: in-process only
  TlsOptions tls;       // not of a Unix socket, which is made for its owner alone
  AccessOptions access;
  bool reflection = true;
  int largest_message_mb = 256;
  ConnectionLimits connections;
  int max_age_seconds =
      86'400;  // of a connection; its calls end in peace, and clients connect anew
};

// What all listeners of a server share; must outlive them.
struct ServedParts {
  CatalogStore& store;
  PartRanker rank = {};  // of a ranker
  BackupShelf& shelf;
  CadReader& cad_reader;
  AnswerBoard& board;
  std::string recordings;  // their folder; empty: none
  WorkerPool& scenes;
  WorkerPool& catalog_calls;
  MemoryBudget& memory;
  RequestSink* sink = nullptr;
  Recognizer recognizer;
  RecognitionLimits recognition;
  int64_t max_object_bytes = 0;
  v1::ServerLimits limits;  // as told
};

// Before a server is built: gRPC's own health service, and reflection where it is wanted.
void EnableHealthAndReflection();

// What health says of a server and of each of our services.
void SetHealth(grpc::Server& server, bool serving);

// For an acceptor: hands its connections to the server that is built.
Acceptor::HandOver AddAcceptedConnections(
    const std::shared_ptr<grpc::ServerCredentials>& credentials, grpc::ServerBuilder* builder);

class Listener {
 public:
  // Errors: those of MakeServerCredentials and Access::Open, UNAVAILABLE (the address cannot be
  // bound).
  static absl::StatusOr<std::unique_ptr<Listener>> Start(const ListenerOptions& options,
                                                         const ServedParts& served);
  ~Listener();

  // With the port that was bound; empty: in-process only.
  const std::string& address() const { return address_; }
  bool has_tls() const { return !tls_.certificate.empty(); }
  std::shared_ptr<grpc::Channel> InProcessChannel();
  // What health says of the server and of each service.
  void SetServing(bool serving);
  // Looks at the access file and at the certificates now; what is wrong with them is logged, and
  // what was known stays in force.
  void Reload();
  // Lets running calls finish until then, cancels the rest and returns when the last is done.
  void Shutdown(std::chrono::system_clock::time_point until);

 private:
  Listener(std::unique_ptr<Access> access, TlsOptions tls, const ServedParts& served);

  const std::unique_ptr<Access> access_;
  const TlsOptions tls_;
  RecognitionService recognition_;
  CatalogService catalog_;
  StationService stations_;
  AnswerService answers_;
  ServerInfoService info_;
  RankingService ranking_;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<Acceptor> acceptor_;  // null: in-process only
  std::string address_;
};

}  // namespace horopter
