// CatalogService: standard methods over the catalog store.
#pragma once

#include "horopter/v1/catalog.grpc.pb.h"
#include "server/service/catalog_store.h"
#include "server/service/worker_pool.h"

namespace horopter {

// Thread-safe. The store and the pool must outlive the service's last call.
class CatalogService final : public v1::CatalogService::CallbackService {
 public:
  CatalogService(CatalogStore& store, WorkerPool& pool) : store_(store), pool_(pool) {}

  grpc::ServerUnaryReactor* CreateObject(grpc::CallbackServerContext* context,
                                         const v1::CreateObjectRequest* request,
                                         v1::Object* response) override;
  grpc::ServerUnaryReactor* GetObject(grpc::CallbackServerContext* context,
                                      const v1::GetObjectRequest* request,
                                      v1::Object* response) override;
  grpc::ServerUnaryReactor* ListObjects(grpc::CallbackServerContext* context,
                                        const v1::ListObjectsRequest* request,
                                        v1::ListObjectsResponse* response) override;
  grpc::ServerUnaryReactor* UpdateObject(grpc::CallbackServerContext* context,
                                         const v1::UpdateObjectRequest* request,
                                         v1::Object* response) override;
  grpc::ServerUnaryReactor* DeleteObject(grpc::CallbackServerContext* context,
                                         const v1::DeleteObjectRequest* request,
                                         google::protobuf::Empty* response) override;
  grpc::ServerUnaryReactor* ListLookAlikes(grpc::CallbackServerContext* context,
                                           const v1::ListLookAlikesRequest* request,
                                           v1::ListLookAlikesResponse* response) override;
  grpc::ServerUnaryReactor* VerifyCatalog(grpc::CallbackServerContext* context,
                                          const v1::VerifyCatalogRequest* request,
                                          v1::VerifyCatalogResponse* response) override;
  grpc::ServerUnaryReactor* RebuildObject(grpc::CallbackServerContext* context,
                                          const v1::RebuildObjectRequest* request,
                                          v1::RebuildObjectResponse* response) override;
  grpc::ServerWriteReactor<v1::BackupCatalogResponse>* BackupCatalog(
      grpc::CallbackServerContext* context, const v1::BackupCatalogRequest* request) override;

 private:
  // Fills `response` with the object as stored.
  absl::Status Read(const std::string& id, v1::ObjectView view, v1::Object* response);

  CatalogStore& store_;
  WorkerPool& pool_;
};

}  // namespace horopter
