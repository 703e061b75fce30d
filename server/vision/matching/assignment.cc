#include "server/vision/matching/assignment.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

constexpr double kConverged = 1e-5;  // change of the unit-sum vector
constexpr int kBalanceRounds = 6;    // of Sinkhorn's alternation

// y = M x, M with `self` on its diagonal.
std::vector<double> Apply(const AssignmentProblem& p, const std::vector<double>& x) {
  std::vector<double> y(x.size());
  for (size_t i = 0; i < x.size(); ++i) {
    double sum = p.self[i] * x[i];
    for (int k = p.begin[i]; k < p.begin[i + 1]; ++k) sum += p.weight[k] * x[p.to[k]];
    y[i] = sum;
  }
  return y;
}

void ScaleToSum(std::vector<double>* x) {
  const double sum = std::accumulate(x->begin(), x->end(), 0.0);
  if (sum > 0.0) {
    for (double& v : *x) v /= sum;
  }
}

double Change(const std::vector<double>& x, const std::vector<double>& y) {
  double change = 0.0;
  for (size_t i = 0; i < x.size(); ++i) change += std::abs(x[i] - y[i]);
  return change;
}

// Rows and columns in turn are scaled down to sum at most 1: a feature may stay without a match.
void Balance(const AssignmentProblem& p, int rows, int columns, std::vector<double>* x) {
  std::vector<double> sums;
  const auto normalize = [&](const std::vector<int>& group, int groups) {
    sums.assign(groups, 0.0);
    for (size_t i = 0; i < x->size(); ++i) sums[group[i]] += (*x)[i];
    for (size_t i = 0; i < x->size(); ++i) (*x)[i] /= std::max(1e-300, sums[group[i]]);
  };
  for (int round = 0; round < kBalanceRounds; ++round) {
    LeaveIfStopped();
    normalize(p.row, rows);
    normalize(p.column, columns);
  }
}

}  // namespace

std::vector<double> Confidences(const AssignmentProblem& problem,
                                const AssignmentOptions& options) {
  const int n = problem.size();
  std::vector<double> x(problem.self.begin(), problem.self.end());
  if (n == 0) return x;
  if (options.method != AssignmentMethod::kGreedy) {
    const int rows = 1 + *std::max_element(problem.row.begin(), problem.row.end());
    const int columns = 1 + *std::max_element(problem.column.begin(), problem.column.end());
    x.assign(n, 1.0 / n);
    for (int iteration = 0; iteration < options.iterations; ++iteration) {
      LeaveIfStopped();
      std::vector<double> y = Apply(problem, x);
      ScaleToSum(&y);  // stays zero where nothing speaks for any candidate
      if (options.method == AssignmentMethod::kRandomWalks) {
        const double largest = *std::max_element(y.begin(), y.end());
        if (!(largest > 0.0)) return y;
        std::vector<double> jump(n);
        for (int i = 0; i < n; ++i) jump[i] = std::exp(options.inflation * (y[i] / largest - 1.0));
        Balance(problem, rows, columns, &jump);
        ScaleToSum(&jump);
        for (int i = 0; i < n; ++i)
          y[i] = options.reweighting * y[i] + (1.0 - options.reweighting) * jump[i];
        ScaleToSum(&y);
      }
      const double change = Change(x, y);
      x = std::move(y);
      if (change < kConverged) break;
    }
  }
  const double largest = *std::max_element(x.begin(), x.end());
  for (double& v : x) v = largest > 0.0 ? v / largest : 0.0;
  return x;
}

std::vector<int> Discretize(const AssignmentProblem& problem,
                            const std::vector<double>& confidences) {
  std::vector<int> order(problem.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(
      order.begin(), order.end(), [&](int i, int j) { return confidences[i] > confidences[j]; });
  std::vector<int> taken;
  std::vector<char> row_used, column_used;
  for (int i : order) {
    if (!(confidences[i] > 0.0)) break;
    const size_t r = problem.row[i], c = problem.column[i];
    if (r >= row_used.size()) row_used.resize(r + 1, 0);
    if (c >= column_used.size()) column_used.resize(c + 1, 0);
    if (row_used[r] || column_used[c]) continue;
    row_used[r] = column_used[c] = 1;
    taken.push_back(i);
  }
  return taken;
}

}  // namespace horopter
