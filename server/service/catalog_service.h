// CatalogService: standard methods over the catalog store.
#pragma once

#include "horopter/v1/catalog.grpc.pb.h"
#include "server/service/backup_shelf.h"
#include "server/service/cad_reader.h"
#include "server/service/catalog_store.h"
#include "server/service/recognition_service.h"
#include "server/service/unary_call.h"

namespace horopter {

// All unary methods get their bytes unparsed (unary_call.h).
using CatalogServiceBase = v1::CatalogService::WithRawCallbackMethod_LearnPrint<
    v1::CatalogService::WithRawCallbackMethod_RebuildObject<
        v1::CatalogService::WithCallbackMethod_VerifyCatalog<
            v1::CatalogService::WithRawCallbackMethod_ListLookAlikes<
                v1::CatalogService::WithRawCallbackMethod_DeleteObject<
                    v1::CatalogService::WithRawCallbackMethod_UpdateObject<
                        v1::CatalogService::WithRawCallbackMethod_ListObjects<
                            v1::CatalogService::WithRawCallbackMethod_GetObject<
                                v1::CatalogService::WithRawCallbackMethod_BatchCreateObjects<
                                    v1::CatalogService::WithRawCallbackMethod_CreateObject<
                                        v1::CatalogService::WithCallbackMethod_BackupCatalog<
                                            v1::CatalogService::WithCallbackMethod_RestoreCatalog<
                                                v1::CatalogService::WithRawCallbackMethod_ImportObject<
                                                    v1::CatalogService::
                                                        WithRawCallbackMethod_ListObjectVersions<
                                                            v1::CatalogService::
                                                                WithRawCallbackMethod_RestoreObject<
                                                                    v1::CatalogService::
                                                                        WithRawCallbackMethod_ListViewTemplates<
                                                                            v1::CatalogService::
                                                                                Service>>>>>>>>>>>>>>>>;

// Thread-safe. What the constructor is given must outlive the service's last call.
class CatalogService final : public CatalogServiceBase {
 public:
  // `max_object_bytes`: of a request that holds an object; `images`: of one that holds images.
  CatalogService(CatalogStore& store,
                 BackupShelf& shelf,
                 CadReader& cad_reader,
                 const CallGate& gate,
                 int64_t max_object_bytes,
                 const RecognitionLimits& images)
      : store_(store),
        shelf_(shelf),
        cad_reader_(cad_reader),
        gate_(gate),
        max_object_bytes_(max_object_bytes),
        images_(images) {}

  grpc::ServerUnaryReactor* CreateObject(grpc::CallbackServerContext* context,
                                         const grpc::ByteBuffer* request,
                                         grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* ImportObject(grpc::CallbackServerContext* context,
                                         const grpc::ByteBuffer* request,
                                         grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* BatchCreateObjects(grpc::CallbackServerContext* context,
                                               const grpc::ByteBuffer* request,
                                               grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* GetObject(grpc::CallbackServerContext* context,
                                      const grpc::ByteBuffer* request,
                                      grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* ListObjects(grpc::CallbackServerContext* context,
                                        const grpc::ByteBuffer* request,
                                        grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* UpdateObject(grpc::CallbackServerContext* context,
                                         const grpc::ByteBuffer* request,
                                         grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* DeleteObject(grpc::CallbackServerContext* context,
                                         const grpc::ByteBuffer* request,
                                         grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* ListObjectVersions(grpc::CallbackServerContext* context,
                                               const grpc::ByteBuffer* request,
                                               grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* RestoreObject(grpc::CallbackServerContext* context,
                                          const grpc::ByteBuffer* request,
                                          grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* ListViewTemplates(grpc::CallbackServerContext* context,
                                              const grpc::ByteBuffer* request,
                                              grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* ListLookAlikes(grpc::CallbackServerContext* context,
                                           const grpc::ByteBuffer* request,
                                           grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* LearnPrint(grpc::CallbackServerContext* context,
                                       const grpc::ByteBuffer* request,
                                       grpc::ByteBuffer* response) override;
  grpc::ServerWriteReactor<v1::VerifyCatalogResponse>* VerifyCatalog(
      grpc::CallbackServerContext* context, const v1::VerifyCatalogRequest* request) override;
  grpc::ServerUnaryReactor* RebuildObject(grpc::CallbackServerContext* context,
                                          const grpc::ByteBuffer* request,
                                          grpc::ByteBuffer* response) override;
  grpc::ServerWriteReactor<v1::BackupCatalogResponse>* BackupCatalog(
      grpc::CallbackServerContext* context, const v1::BackupCatalogRequest* request) override;
  grpc::ServerReadReactor<v1::RestoreCatalogRequest>* RestoreCatalog(
      grpc::CallbackServerContext* context, v1::RestoreCatalogResponse* response) override;

 private:
  // Fills `response` with the object as stored.
  absl::Status Read(const std::string& id, v1::ObjectView view, v1::Object* response);

  // The same with what it was.
  absl::Status ReadFormer(const std::string& id,
                          int64_t revision,
                          v1::ObjectView view,
                          v1::Object* response);

  // The calls without the network around them.
  absl::Status Create(const v1::CreateObjectRequest& request,
                      const CallInfo& info,
                      v1::Object* response);
  absl::Status CreateBatch(const v1::BatchCreateObjectsRequest& request,
                           const CallInfo& info,
                           v1::BatchCreateObjectsResponse* response);
  absl::Status Import(const v1::ImportObjectRequest& request,
                      const CallInfo& info,
                      v1::ImportObjectResponse* response);
  absl::Status Update(const v1::UpdateObjectRequest& request,
                      const CallInfo& info,
                      v1::Object* response);
  absl::Status Learn(const v1::LearnPrintRequest& request,
                     const CallInfo& info,
                     v1::Object* response);
  absl::Status Delete(const v1::DeleteObjectRequest& request);
  absl::Status Versions(const std::string& id, v1::ListObjectVersionsResponse* response);
  absl::Status Templates(const v1::ListViewTemplatesRequest& request,
                         v1::ListViewTemplatesResponse* response);
  absl::Status Restore(const v1::RestoreObjectRequest& request,
                       const CallInfo& info,
                       v1::Object* response);

  // Creates the records, or finds what the same request made before; `answer_of` gives the place of
  // the i-th object's answer, empty. It may be asked twice for one: an answer that was begun is
  // dropped when another call turns out to have made the objects meanwhile.
  using AnswerOf = std::function<v1::Object*(int i)>;
  absl::Status CreateOnce(std::vector<CatalogRecord> records,
                          const RepeatableRequest& request,
                          const CallInfo& info,
                          const AnswerOf& answer_of);

  CatalogStore& store_;
  BackupShelf& shelf_;
  CadReader& cad_reader_;
  const CallGate gate_;
  const int64_t max_object_bytes_;
  const RecognitionLimits images_;
};

}  // namespace horopter
