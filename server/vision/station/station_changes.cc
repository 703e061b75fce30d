#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

#include "server/vision/station/station_filter.h"
#include "server/vision/station/station_prediction.h"

namespace horopter {
namespace {

constexpr double kAlikeCriterion = 6.0;  // explanations this near cannot be told apart
// Cameras whose orders are all tried, 120; of more pairs are swapped.
constexpr std::size_t kMostPermuted = 5;
// Penalty of a number that an explanation leaves free; Akaike's is 2, Bayes' the logarithm of the
// count of points, about 6. Higher: a changed lens (4) is preferred to a moved camera (6).
constexpr double kFreedomPenalty = 4.0;

// How far the images are from what was predicted: offset, its covariance, and how many numbers are
// compared.
struct Comparison {
  Eigen::VectorXd offset;
  Eigen::MatrixXd S;
  std::vector<std::vector<int>> blocks;  // places and lenses of single views
  int freedoms = 0;
};

Comparison Compare(const StationPrediction& p,
                   const CameraEvidence& evidence,
                   const std::vector<bool>& lens_open,
                   const StationOptions& options) {
  const CameraGroup& group = evidence.group;
  const int n = static_cast<int>(group.views.size());
  const std::vector<AdjustedView> views = ViewsOf(p, group);
  const Eigen::MatrixXd J = PredictionJacobian(p, group, views);
  const Eigen::VectorXd predicted = GroupOffset(group, views);
  const double narrowing = 1.0 / (options.widening * options.widening);
  const EquilibratedFactors factors(Closed(group, narrowing * evidence.information));
  const Eigen::VectorXd right = narrowing * (evidence.vector - evidence.information * predicted);
  const Eigen::VectorXd offset = factors.Solve(right);
  std::vector<int> kept;  // all but the anchor's place
  for (int i = 6; i < kGroupParameters * n; ++i) kept.push_back(i);
  const Eigen::MatrixXd of_evidence = factors.Inverse();
  const Eigen::MatrixXd S = of_evidence + J * p.P * J.transpose();
  Comparison out;
  const int m = static_cast<int>(kept.size());
  out.offset.resize(m);
  out.S.resize(m, m);
  for (int i = 0; i < m; ++i) {
    out.offset(i) = offset(kept[i]);
    for (int j = 0; j < m; ++j) out.S(i, j) = S(kept[i], kept[j]);
  }
  int posed = 0;
  for (int i = 0; i < n; ++i) {
    const int at = kGroupParameters * i - 6;  // in `kept`
    posed += p.was_posed[i];
    if (p.was_posed[i] && i > 0 && p.was_posed[0]) {
      out.blocks.emplace_back(6);
      std::iota(out.blocks.back().begin(), out.blocks.back().end(), at);
    }
    if (p.camera[i] >= 0 && !lens_open[p.camera[i]]) {
      out.freedoms += kLensSize;
      out.blocks.emplace_back(kLensSize);
      std::iota(out.blocks.back().begin(), out.blocks.back().end(), at + 6);
    }
  }
  out.freedoms += 6 * std::max(0, posed - 1);
  return out;
}

double SquaredDistance(const Eigen::VectorXd& offset, const Eigen::MatrixXd& S) {
  const Eigen::VectorXd scale = S.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::LLT<Eigen::MatrixXd> llt(scale.asDiagonal() * S * scale.asDiagonal());
  return llt.matrixL().solve(Eigen::VectorXd(scale.cwiseProduct(offset))).squaredNorm();
}

// One explanation of the images.
struct Hypothesis {
  std::vector<bool> moved, lens;  // per camera of the state
  std::vector<int> swapped;       // cameras, empty: none
  StationViews views;
  bool passes = false;
  double squared = 0.0, limit = 0.0;
  int freedoms = 0;
  // The distance, and a penalty for each number that is free in it.
  double criterion = std::numeric_limits<double>::infinity();
};

void Judge(const StationState& state,
           const CameraEvidence& evidence,
           const StationOptions& options,
           Hypothesis* e) {
  StationState supposed = state;
  for (std::size_t c = 0; c < state.cameras.size(); ++c) {
    const int camera = static_cast<int>(c);
    if (e->moved[c]) ForgetPlace(camera, &supposed);
    if (e->lens[c]) {
      const double center = options.changed_center * state.cameras[c].camera.width;
      SetLensSigmas(camera,
                    {options.changed_log_focal, center, center, options.changed_k1},
                    &supposed.covariance);
    }
  }
  const StationPrediction p = Predict(supposed, e->views, evidence.group, options);
  const Comparison all = Compare(p, evidence, e->lens, options);
  const double squared = SquaredDistance(all.offset, all.S);
  e->squared = squared;
  e->freedoms = all.freedoms;
  e->limit = ChiSquareLimit(all.freedoms, options.alarm_sigmas);
  const auto count = [](const std::vector<bool>& b) {
    return static_cast<double>(std::count(b.begin(), b.end(), true));
  };
  const double free = 6.0 * count(e->moved) + kLensSize * count(e->lens);
  e->criterion = std::isfinite(squared) ? squared + kFreedomPenalty * free
                                        : std::numeric_limits<double>::infinity();
  e->passes = e->squared <= e->limit;
  for (const std::vector<int>& block : all.blocks) {
    const int k = static_cast<int>(block.size());
    if (static_cast<int>(all.offset.size()) < block.back() + 1) continue;
    const double of_block = SquaredDistance(all.offset.segment(block.front(), k),
                                            all.S.block(block.front(), block.front(), k, k));
    e->passes = e->passes && of_block <= ChiSquareLimit(k, options.alarm_sigmas);
  }
}

Hypothesis Nothing(const StationState& state, const StationViews& views) {
  Hypothesis e;
  e.moved.assign(state.cameras.size(), false);
  e.lens = e.moved;
  e.views = views;
  return e;
}

// The cameras of a request in other orders, all of fixed cameras with images of one size.
std::vector<Hypothesis> Orders(const StationState& state,
                               const StationViews& views,
                               const CameraGroup& group) {
  std::vector<int> at;
  for (const int v : group.views) {
    if (views[v] >= 0 && state.cameras[views[v]].requests > 0) at.push_back(v);
  }
  std::vector<Hypothesis> out;
  const auto add = [&](const std::vector<int>& to) {
    Hypothesis e = Nothing(state, views);
    for (std::size_t i = 0; i < at.size(); ++i) {
      const int from = views[at[i]], now = views[at[to[i]]];
      if (from == now) continue;
      const PinholeCamera &a = state.cameras[from].camera, &b = state.cameras[now].camera;
      if (a.width != b.width || a.height != b.height) return;
      e.views[at[i]] = now;
      e.swapped.push_back(from);
    }
    if (!e.swapped.empty()) out.push_back(std::move(e));
  };
  std::vector<int> order(at.size());
  std::iota(order.begin(), order.end(), 0);
  if (at.size() <= kMostPermuted) {
    while (std::next_permutation(order.begin(), order.end())) add(order);
    return out;
  }
  for (std::size_t i = 0; i < at.size(); ++i) {
    for (std::size_t j = i + 1; j < at.size(); ++j) {
      std::vector<int> to = order;
      std::swap(to[i], to[j]);
      add(to);
    }
  }
  return out;
}

// What may have happened to one more camera.
std::vector<Hypothesis> Further(const StationState& state,
                                const Hypothesis& base,
                                const CameraGroup& group) {
  std::vector<Hypothesis> out;
  std::vector<bool> seen(state.cameras.size(), false);
  for (const int v : group.views) {
    const int c = base.views[v];
    if (c < 0 || seen[c]) continue;
    seen[c] = true;
    for (const auto& [moved, lens] : {std::pair{true, false}, {false, true}, {true, true}}) {
      Hypothesis e = base;
      if ((moved && (!state.cameras[c].posed || base.moved[c])) || (lens && base.lens[c])) continue;
      e.moved[c] = e.moved[c] || moved;
      e.lens[c] = e.lens[c] || lens;
      out.push_back(std::move(e));
    }
  }
  return out;
}

const Hypothesis* Best(const std::vector<Hypothesis>& all, bool only_passing) {
  const Hypothesis* best = nullptr;
  for (const Hypothesis& e : all) {
    if (only_passing && !e.passes) continue;
    if (best == nullptr || e.criterion < best->criterion) best = &e;
  }
  return best;
}

// Cameras of which one moved, or whose lens changed, as likely as of `best`.
std::vector<int> AlikeCameras(const std::vector<Hypothesis>& all,
                              const Hypothesis& best,
                              int camera,
                              bool moved) {
  std::vector<int> out = {camera};
  const auto count = [](const std::vector<bool>& b) {
    return std::count(b.begin(), b.end(), true);
  };
  for (const Hypothesis& e : all) {
    if (!e.passes || !e.swapped.empty() || e.criterion > best.criterion + kAlikeCriterion) continue;
    if (count(e.moved) != count(best.moved) || count(e.lens) != count(best.lens)) continue;
    const std::vector<bool>& mine = moved ? e.moved : e.lens;
    for (std::size_t c = 0; c < mine.size(); ++c) {
      if (mine[c] && std::find(out.begin(), out.end(), static_cast<int>(c)) == out.end())
        out.push_back(static_cast<int>(c));
    }
  }
  return out;
}

// The best explanation, and those that it was chosen from last.
struct Explanation {
  Hypothesis best;
  std::vector<Hypothesis> tried;
};

// Other orders, then one more changed camera at a time, until the images fit. drifted: `state` at
// this request.
Explanation Explain(const StationState& state,
                    const StationState& drifted,
                    const StationViews& views,
                    const CameraEvidence& evidence,
                    const StationOptions& options,
                    const Hypothesis& unchanged) {
  Explanation out{unchanged, Orders(state, views, evidence.group)};
  for (Hypothesis& e : out.tried) Judge(drifted, evidence, options, &e);
  for (std::size_t round = 0; round < 2 * state.cameras.size() && !out.best.passes; ++round) {
    std::vector<Hypothesis> further = Further(state, out.best, evidence.group);
    if (further.empty()) break;
    for (Hypothesis& e : further) Judge(drifted, evidence, options, &e);
    if (round > 0) out.tried.clear();
    out.tried.insert(out.tried.end(), further.begin(), further.end());
    const Hypothesis* chosen = Best(out.tried, true);
    if (chosen == nullptr) chosen = Best(further, false);
    out.best = *chosen;
  }
  return out;
}

std::vector<StationChange> ChangesOf(const Explanation& explanation) {
  const auto& [best, tried] = explanation;
  if (!best.swapped.empty()) return {{StationChangeKind::kSwapped, best.swapped}};
  std::vector<StationChange> out;
  const auto single = [](const std::vector<bool>& b) {
    return std::count(b.begin(), b.end(), true) == 1;
  };
  for (std::size_t c = 0; c < best.moved.size(); ++c) {
    const int camera = static_cast<int>(c);
    if (best.moved[c]) {
      out.push_back({StationChangeKind::kMoved, {camera}});
      if (single(best.moved)) out.back().cameras = AlikeCameras(tried, best, camera, true);
    }
    if (best.lens[c]) {
      out.push_back({StationChangeKind::kLens, {camera}});
      if (single(best.lens)) out.back().cameras = AlikeCameras(tried, best, camera, false);
    }
  }
  return out;
}

// How far the first camera of each change went between two states.
void Measure(const StationState& state,
             const StationState& now,
             std::vector<StationChange>* changes) {
  for (StationChange& change : *changes) {
    const StationCamera &before = state.cameras[change.cameras[0]],
                        &after = now.cameras[change.cameras[0]];
    if (change.kind == StationChangeKind::kMoved && after.posed) {
      const Rigid3 move = after.camera_from_rig * before.camera_from_rig.Inverse();
      change.turn_rad = Eigen::AngleAxisd(move.R).angle();
      change.shift_m =
          (after.camera_from_rig.Inverse().t - before.camera_from_rig.Inverse().t).norm();
    } else if (change.kind == StationChangeKind::kLens) {
      change.log_focal = std::log(after.camera.focal_px / before.camera.focal_px);
      change.center_px = {after.camera.cx - before.camera.cx, after.camera.cy - before.camera.cy};
      change.k1 = after.camera.k1 - before.camera.k1;
    }
  }
}

}  // namespace

StationTest TestStation(const StationState& state,
                        const StationViews& views,
                        const CameraEvidence& evidence,
                        const StationOptions& options) {
  StationTest out;
  if (evidence.information.size() == 0) return out;
  const StationState drifted = AtNextRequest(state, options);
  Hypothesis unchanged = Nothing(state, views);
  Judge(drifted, evidence, options, &unchanged);
  out.squared = unchanged.squared;
  out.freedoms = unchanged.freedoms;
  out.limit = unchanged.limit;
  out.agrees = unchanged.passes;
  if (out.agrees) return out;
  const Explanation explanation = Explain(state, drifted, views, evidence, options, unchanged);
  out.changes = ChangesOf(explanation);
  if (!explanation.best.swapped.empty()) return out;
  // How much: what is learnt when only that is forgotten which changed.
  StationTest of_first = out;
  for (StationChange& change : of_first.changes) change.cameras.resize(1);
  Measure(state, UpdateStation(state, views, evidence, of_first, options), &out.changes);
  return out;
}

double ChiSquareLimit(int freedoms, double sigmas) {
  if (freedoms <= 0) return std::numeric_limits<double>::infinity();
  const double k = freedoms, v = 2.0 / (9.0 * k);
  return k * std::pow(1.0 - v + sigmas * std::sqrt(v), 3.0);
}

}  // namespace horopter
