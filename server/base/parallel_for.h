// Loops over independent items on the threads of one pool, within the cores a request may use.
#pragma once

#include "absl/functional/function_ref.h"

namespace horopter {

// Calls body(i) for i = 0 .. count-1, each once, on the calling thread and on at most threads - 1
// of the process's pool that are free, now or before the loop ends. Every item writes only its own
// slot, so the result does not depend on the number of threads. Returns when all are done: a loop
// may stand in the body of another, and a busy or empty pool only makes it slower.
//
// What a body throws, or a stop (stop_scope.h), leaves ParallelFor in the calling thread (the first
// of several); items that were not begun by then are left out.
void ParallelFor(int count, int threads, absl::FunctionRef<void(int)> body);

// As long as it lives, the loops that this thread runs, and those in their bodies, together use at
// most `cores` threads at any time, this one among them. A loop outside of any budget opens one of
// its own `threads`; a budget within another changes nothing.
class CoreBudget {
 public:
  explicit CoreBudget(int cores);
  ~CoreBudget();
  CoreBudget(const CoreBudget&) = delete;
  CoreBudget& operator=(const CoreBudget&) = delete;

 private:
  friend class LoopPool;
  int free_;  // further threads that may join; guarded by the pool's mutex
  bool outermost_;
};

// Threads of the pool: those that call ParallelFor come on top. Until set, one less than the
// machine has cores. Returns false, and changes nothing, once a loop has started the pool.
bool SetPoolThreads(int threads);

}  // namespace horopter
