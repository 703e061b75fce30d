#include "server/base/parallel_for.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <new>
#include <numeric>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace horopter {
namespace {

using namespace std::chrono_literals;

constexpr int kPoolThreads = 5;
const bool sized = SetPoolThreads(kPoolThreads);

// Threads inside of a scope at the same time, and the most there ever were.
class Crowd {
 public:
  class Inside {
   public:
    explicit Inside(Crowd& crowd) : crowd_(crowd) {
      const int now = ++crowd_.now_;
      int most = crowd_.most_;
      while (now > most && !crowd_.most_.compare_exchange_weak(most, now)) {
      }
    }
    ~Inside() { --crowd_.now_; }

   private:
    Crowd& crowd_;
  };
  int most() const { return most_; }
  // Waits until so many are inside at once; the limit only ends a test that has failed.
  bool Await(int count) const {
    for (int i = 0; i < 20000 && most_ < count; ++i) std::this_thread::sleep_for(1ms);
    return most_ >= count;
  }

 private:
  std::atomic<int> now_{0}, most_{0};
};

TEST(ParallelFor, CallsEveryIndexOnce) {
  ASSERT_TRUE(sized);
  for (const int threads : {-1, 0, 1, 2, 3, 6, 100}) {
    for (const int count : {-1, 0, 1, 2, 7, 1000}) {
      std::vector<int> calls(std::max(0, count), 0);
      ParallelFor(count, threads, [&](int i) { ++calls[i]; });
      EXPECT_EQ(std::count(calls.begin(), calls.end(), 1), std::ssize(calls))
          << threads << " threads, " << count << " items";
    }
  }
}

TEST(ParallelFor, UsesAsManyThreadsAsItMayAndNoMore) {
  for (const int threads : {1, 2, 4, 1 + kPoolThreads}) {
    Crowd crowd;
    std::atomic<bool> full{true};
    ParallelFor(40, threads, [&](int) {
      const Crowd::Inside inside(crowd);
      if (!crowd.Await(threads)) full = false;
      std::this_thread::sleep_for(200us);
    });
    EXPECT_TRUE(full);
    EXPECT_EQ(crowd.most(), threads);
  }
}

TEST(ParallelFor, LoopsInsideOfOthersEndWhateverThePoolDoes) {
  std::atomic<int> calls{0};
  ParallelFor(8, 8, [&](int) {
    ParallelFor(8, 8, [&](int) { ParallelFor(8, 8, [&](int) { ++calls; }); });
  });
  EXPECT_EQ(calls, 8 * 8 * 8);
}

TEST(ParallelFor, InnerLoopsShareTheCoresOfTheOuterOne) {
  for (const int threads : {1, 2, 3}) {
    Crowd crowd;
    // An inner loop asks for all, the budget is the outer one's.
    ParallelFor(4, threads, [&](int) {
      ParallelFor(20, 6, [&](int) {
        const Crowd::Inside inside(crowd);
        std::this_thread::sleep_for(100us);
      });
    });
    EXPECT_LE(crowd.most(), threads);
  }
}

TEST(ParallelFor, AnInnerLoopGetsTheCoresThatTheOuterOneLeaves) {
  Crowd crowd;
  bool full = false;
  // One outer item, so the second core is free.
  const CoreBudget budget(2);
  ParallelFor(1, 2, [&](int) {
    ParallelFor(2, 2, [&](int i) {
      const Crowd::Inside inside(crowd);
      if (i == 0) full = crowd.Await(2);
      if (i == 1) crowd.Await(2);
    });
  });
  EXPECT_TRUE(full);
}

TEST(ParallelFor, ABudgetBoundsTheLoopsInItWhateverTheyAskFor) {
  Crowd crowd, after;
  {
    const CoreBudget budget(2);
    const CoreBudget within(6);  // changes nothing
    ParallelFor(40, 6, [&](int) {
      const Crowd::Inside inside(crowd);
      std::this_thread::sleep_for(100us);
    });
  }
  EXPECT_LE(crowd.most(), 2);
  ParallelFor(3, 3, [&](int) {
    const Crowd::Inside inside(after);
    after.Await(3);
  });
  EXPECT_EQ(after.most(), 3);
}

TEST(ParallelFor, WhatABodyThrowsComesToTheCallerAndEndsTheLoop) {
  for (const int threads : {1, 2, 6}) {
    for (int repetition = 0; repetition < 50; ++repetition) {
      std::atomic<int> calls{0};
      std::string what;
      try {
        ParallelFor(100000, threads, [&](int i) {
          ++calls;
          if (i == 17) throw std::runtime_error("item 17");
        });
      } catch (const std::runtime_error& error) {
        what = error.what();
      }
      EXPECT_EQ(what, "item 17");
      if (threads == 1) {
        EXPECT_EQ(calls, 18);
      }
      // The pool is as good as before.
      std::atomic<int> sum{0};
      ParallelFor(100, threads, [&](int i) { sum += i; });
      ASSERT_EQ(sum, 4950);
    }
  }
}

TEST(ParallelFor, AThrowOfAHelperComesToTheCaller) {
  const std::thread::id caller = std::this_thread::get_id();
  Crowd crowd;
  EXPECT_THROW(ParallelFor(2,
                           2,
                           [&](int) {
                             const Crowd::Inside inside(crowd);
                             crowd.Await(2);  // one item is the helper's
                             if (std::this_thread::get_id() != caller) throw std::bad_alloc();
                           }),
               std::bad_alloc);
}

TEST(ParallelFor, WhenAllThrowOneIsHeard) {
  for (int repetition = 0; repetition < 200; ++repetition) {
    EXPECT_THROW(ParallelFor(12, 6, [](int) { throw std::bad_alloc(); }), std::bad_alloc);
  }
}

TEST(ParallelFor, AThrowCrossesTheLoopsAroundIt) {
  std::atomic<int> caught{0};
  for (int repetition = 0; repetition < 100; ++repetition) {
    try {
      ParallelFor(3, 3, [&](int i) {
        ParallelFor(8, 3, [&](int k) {
          if (i == 1 && k == 5) throw std::runtime_error("inner");
        });
      });
    } catch (const std::runtime_error&) {
      ++caught;
    }
  }
  EXPECT_EQ(caught, 100);
}

// Requests at once, more than the pool can help, some of which fail: each gets its own results and
// its own failures, and stays within its cores.
TEST(ParallelFor, ManyRequestsAtOnceKeepToThemselves) {
  constexpr int kRequests = 8, kLoops = 100;
  std::vector<int> wrong(kRequests, 0), failures(kRequests, 0), most(kRequests, 0);
  std::vector<std::thread> requests;
  for (int request = 0; request < kRequests; ++request) {
    requests.emplace_back([&, request] {
      const int cores = 1 + request % 4;
      const CoreBudget budget(cores);
      Crowd crowd;
      for (int loop = 0; loop < kLoops; ++loop) {
        std::vector<int> squares(20, 0);
        try {
          ParallelFor(20, cores, [&](int i) {
            const Crowd::Inside inside(crowd);
            std::vector<int> parts(i, 0);
            ParallelFor(i, 2, [&](int k) { parts[k] = i; });
            if (request % 2 == 1 && loop % 10 == 0 && i == 11) throw std::bad_alloc();
            squares[i] = std::accumulate(parts.begin(), parts.end(), 0);
          });
          for (int i = 0; i < 20; ++i) wrong[request] += squares[i] != i * i;
        } catch (const std::bad_alloc&) {
          ++failures[request];
        }
      }
      most[request] = crowd.most();
    });
  }
  for (std::thread& request : requests) request.join();
  for (int request = 0; request < kRequests; ++request) {
    EXPECT_EQ(wrong[request], 0);
    EXPECT_EQ(failures[request], request % 2 == 1 ? kLoops / 10 : 0);
    EXPECT_LE(most[request], 1 + request % 4);
  }
}

}  // namespace
}  // namespace horopter
