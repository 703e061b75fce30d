#include "server/vision/matching/assignment.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <set>
#include <utility>

namespace horopter {
namespace {

struct Planted {
  AssignmentProblem problem;
  std::vector<char> right;  // per candidate
};

// `n` right candidates (i, i) and three wrong ones per row, all alike alone. Right ones are linked
// with each other with probability `density`, any two others with a fifth of it.
Planted MakePlanted(unsigned seed, int n, double density) {
  std::mt19937 rng(seed);
  const auto chance = [&](double p) { return static_cast<double>(rng()) / 4294967296.0 < p; };
  Planted planted;
  AssignmentProblem& p = planted.problem;
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < 4; ++k) {
      const int j = k == 0 ? i : static_cast<int>(rng() % n);
      p.row.push_back(i);
      p.column.push_back(j);
      p.self.push_back(1.0f);
      planted.right.push_back(i == j);
    }
  }
  std::vector<std::vector<std::pair<int, float>>> links(p.size());
  for (int i = 0; i < p.size(); ++i) {
    for (int j = i + 1; j < p.size(); ++j) {
      if (p.row[i] == p.row[j] || p.column[i] == p.column[j]) continue;
      if (!chance(planted.right[i] && planted.right[j] ? density : 0.2 * density)) continue;
      links[i].emplace_back(j, 1.0f);
      links[j].emplace_back(i, 1.0f);
    }
  }
  for (const auto& of_candidate : links) {
    for (const auto& [to, weight] : of_candidate) {
      p.to.push_back(to);
      p.weight.push_back(weight);
    }
    p.begin.push_back(static_cast<int>(p.to.size()));
  }
  return planted;
}

double ShareRight(const Planted& planted, AssignmentMethod method) {
  AssignmentOptions options;
  options.method = method;
  const std::vector<int> taken = Discretize(planted.problem, Confidences(planted.problem, options));
  int right = 0;
  for (int k : taken) right += planted.right[k];
  return static_cast<double>(right) / std::max<size_t>(1, taken.size());
}

TEST(Assignment, NeighboursFindWhatSimilarityAloneCannot) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    const Planted planted = MakePlanted(seed, 30, 0.4);
    EXPECT_GE(ShareRight(planted, AssignmentMethod::kSpectral), 0.95) << "seed " << seed;
    EXPECT_GE(ShareRight(planted, AssignmentMethod::kRandomWalks), 0.95) << "seed " << seed;
  }
}

TEST(Assignment, IsOneToOneAndRepeatsItself) {
  for (const AssignmentMethod method :
       {AssignmentMethod::kGreedy, AssignmentMethod::kSpectral, AssignmentMethod::kRandomWalks}) {
    const Planted planted = MakePlanted(3, 25, 0.2);
    AssignmentOptions options;
    options.method = method;
    const std::vector<double> confidences = Confidences(planted.problem, options);
    EXPECT_EQ(confidences, Confidences(planted.problem, options));
    EXPECT_DOUBLE_EQ(*std::max_element(confidences.begin(), confidences.end()), 1.0);
    std::set<int> rows, columns;
    for (int k : Discretize(planted.problem, confidences)) {
      EXPECT_TRUE(rows.insert(planted.problem.row[k]).second);
      EXPECT_TRUE(columns.insert(planted.problem.column[k]).second);
    }
  }
}

TEST(Assignment, EmptyAndUnlinkedProblemsAreFine) {
  for (const AssignmentMethod method :
       {AssignmentMethod::kGreedy, AssignmentMethod::kSpectral, AssignmentMethod::kRandomWalks}) {
    AssignmentOptions options;
    options.method = method;
    EXPECT_TRUE(Confidences({}, options).empty());
    EXPECT_TRUE(Discretize({}, {}).empty());
    AssignmentProblem nothing_speaks;
    nothing_speaks.row = {0, 1};
    nothing_speaks.column = {0, 1};
    nothing_speaks.self = {0.0f, 0.0f};
    nothing_speaks.begin = {0, 0, 0};
    EXPECT_TRUE(Discretize(nothing_speaks, Confidences(nothing_speaks, options)).empty());
  }
}

}  // namespace
}  // namespace horopter
