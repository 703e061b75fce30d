// A loop over independent items on a few threads. Every item writes only its own slot, so the
// result does not depend on the number of threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <thread>
#include <vector>

namespace horopter {

// Calls body(i) for i = 0 .. count-1 on up to `threads` threads (the caller's among them). body
// must not throw.
template <typename Body>
void ParallelFor(int count, int threads, const Body& body) {
  std::atomic<int> next{0};
  const auto work = [&] {
    for (int i = next.fetch_add(1); i < count; i = next.fetch_add(1)) body(i);
  };
  std::vector<std::thread> helpers;
  for (int t = 1; t < std::min(threads, count); ++t) helpers.emplace_back(work);
  work();
  for (std::thread& helper : helpers) helper.join();
}

}  // namespace horopter
