// AnswerService: what others were answered, for people who watch.
#pragma once

#include <string>

#include "horopter/v1/answers.grpc.pb.h"
#include "server/service/answer_board.h"
#include "server/service/unary_call.h"

namespace horopter {

// Thread-safe. What the gate names and the board must outlive the service's last call.
class AnswerService final : public v1::AnswerService::WithRawCallbackMethod_WatchAnswers<
                                v1::AnswerService::WithRawCallbackMethod_GetAnswer<
                                    v1::AnswerService::WithRawCallbackMethod_ListRecordings<
                                        v1::AnswerService::WithCallbackMethod_GetRecording<
                                            v1::AnswerService::Service>>>> {
 public:
  // recordings: the folder; empty: none.
  AnswerService(AnswerBoard& board, std::string recordings, const CallGate& gate)
      : board_(board), recordings_(std::move(recordings)), gate_(gate) {}

  grpc::ServerWriteReactor<grpc::ByteBuffer>* WatchAnswers(
      grpc::CallbackServerContext* context, const grpc::ByteBuffer* request) override;
  grpc::ServerUnaryReactor* GetAnswer(grpc::CallbackServerContext* context,
                                      const grpc::ByteBuffer* request,
                                      grpc::ByteBuffer* response) override;
  grpc::ServerUnaryReactor* ListRecordings(grpc::CallbackServerContext* context,
                                           const grpc::ByteBuffer* request,
                                           grpc::ByteBuffer* response) override;
  grpc::ServerWriteReactor<v1::GetRecordingResponse>* GetRecording(
      grpc::CallbackServerContext* context, const v1::GetRecordingRequest* request) override;

 private:
  AnswerBoard& board_;
  const std::string recordings_;
  const CallGate gate_;
};

}  // namespace horopter
