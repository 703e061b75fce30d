// StationService: stations by hand. What requests teach them is in station_store.h.
#pragma once

#include "horopter/v1/station.grpc.pb.h"
#include "server/service/station_store.h"
#include "server/service/unary_call.h"

namespace horopter {

using StationServiceBase = v1::StationService::WithRawCallbackMethod_GetStation<
    v1::StationService::WithRawCallbackMethod_ListStations<
        v1::StationService::WithRawCallbackMethod_UpdateStation<
            v1::StationService::WithRawCallbackMethod_DeleteStation<
                v1::StationService::WithRawCallbackMethod_ResetStation<
                    v1::StationService::WithRawCallbackMethod_ImportCalibration<
                        v1::StationService::WithRawCallbackMethod_ExportCalibration<
                            v1::StationService::Service>>>>>>>;

// Thread-safe. The catalog and what the gate names must outlive the service's last call.
class StationService final : public StationServiceBase {
 public:
  StationService(Catalog& catalog, const CallGate& gate) : catalog_(catalog), gate_(gate) {}

  grpc::ServerUnaryReactor* GetStation(grpc::CallbackServerContext* context,
                                       const grpc::ByteBuffer* request,
                                       grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* ListStations(grpc::CallbackServerContext* context,
                                         const grpc::ByteBuffer* request,
                                         grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* UpdateStation(grpc::CallbackServerContext* context,
                                          const grpc::ByteBuffer* request,
                                          grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* DeleteStation(grpc::CallbackServerContext* context,
                                          const grpc::ByteBuffer* request,
                                          grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* ResetStation(grpc::CallbackServerContext* context,
                                         const grpc::ByteBuffer* request,
                                         grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* ImportCalibration(grpc::CallbackServerContext* context,
                                              const grpc::ByteBuffer* request,
                                              grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* ExportCalibration(grpc::CallbackServerContext* context,
                                              const grpc::ByteBuffer* request,
                                              grpc::ByteBuffer* response) override;

 private:
  Catalog& catalog_;
  const CallGate gate_;
};

}  // namespace horopter
