// A server as the target of a load run: requests are serialised once, calls are asynchronous.
#pragma once

#include <memory>
#include <vector>

#include "client/api.h"
#include "client/load/load_items.h"
#include "client/load/load_run.h"

namespace horopter {

// Must outlive the run. Of each set the different answers are kept; LoadReply::answer counts them
// from 0.
class ServerTarget {
 public:
  ServerTarget(const HoropterClient& client, const std::vector<LoadItem>& items);
  ~ServerTarget();

  LoadTarget target();

  // answers()[item][LoadReply::answer]. Not while a run is under way.
  const std::vector<std::vector<v1::RecognizeSceneResponse>>& answers() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace horopter
