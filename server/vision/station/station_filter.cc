#include "server/vision/station/station_filter.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

#include "absl/strings/str_cat.h"
#include "server/vision/geometry/pose_perturbation.h"

namespace horopter {
namespace {

constexpr int kCam = kStationCameraParameters;
constexpr int kLensAt = kStationIntrinsics;
constexpr int kLensSize = kCam - kLensAt;
// Of a place of which nothing is known, about where the images put it.
constexpr double kUnknownTurnSigma = 1.0;
constexpr double kUnknownShiftSigmaM = 3.0;
// Of a parameter of the evidence that the data leave open.
constexpr double kOpenTurn = 1.0, kOpenShiftM = 3.0, kOpenLogFocal = 1.0, kOpenCenterPx = 200.0,
                 kOpenK1 = 0.5;
constexpr int kIterations = 4;
constexpr double kAlikeCriterion = 6.0;  // explanations this near cannot be told apart
constexpr std::size_t kMostPermuted = 5;
// Of a number that an explanation leaves free; Akaike's is 2, Bayes' the logarithm of the count of
// points, about 6. Higher: a changed lens (4) is preferred to a moved camera (6).
constexpr double kPriceOfFreedom = 4.0;

using Vector10 = Eigen::Matrix<double, kCam, 1>;

Eigen::Vector4d PopulationSigmas(const PinholeCamera& camera, const StationOptions& o) {
  const double center = o.center_sigma * camera.width;
  return {o.focal_log_sigma, center, center, o.k1_sigma};
}

void ClearRows(int at, int count, Eigen::MatrixXd* P) {
  P->middleRows(at, count).setZero();
  P->middleCols(at, count).setZero();
}

void SetLensSigmas(int camera, const Eigen::Vector4d& sigmas, Eigen::MatrixXd* P) {
  ClearRows(kCam * camera + kLensAt, kLensSize, P);
  P->diagonal().segment<kLensSize>(kCam * camera + kLensAt) = sigmas.cwiseAbs2();
}

bool AnyPosed(const StationState& state) {
  return std::any_of(
      state.cameras.begin(), state.cameras.end(), [](const auto& c) { return c.posed; });
}

void AddDrift(const StationOptions& o, StationState* state) {
  Vector10 drift;
  drift << Eigen::Vector3d::Constant(o.drift_turn_rad), Eigen::Vector3d::Constant(o.drift_shift_m),
      o.drift_log_focal, o.drift_center_px, o.drift_center_px, o.drift_k1;
  for (std::size_t c = 0; c < state->cameras.size(); ++c) {
    const int at = kCam * static_cast<int>(c);
    auto diagonal = state->covariance.diagonal().segment<kCam>(at);
    if (state->cameras[c].posed) diagonal.head<6>() += drift.head<6>().cwiseAbs2();
    diagonal.tail<kLensSize>() += drift.tail<kLensSize>().cwiseAbs2();
  }
}

// A lens that is declared to change is known anew each time.
void ForgetZooms(const StationOptions& options, StationState* state) {
  for (std::size_t c = 0; c < state->cameras.size(); ++c) {
    if (state->cameras[c].zooming) ForgetLens(static_cast<int>(c), options, state);
  }
}

// The parameters that a request has to do with: those of the state, and a place of their own for
// images of cameras that have none in the rig.
struct Prediction {
  std::vector<PinholeCamera> cameras;  // of the state
  std::vector<Rigid3> places;          // of the state's cameras, then of single views
  Eigen::MatrixXd P;
  std::vector<int> camera;         // per view of the evidence: of the state, -1: none
  std::vector<int> place_at;       // per view: column of its place
  std::vector<int> place;          // per view: index into places
  std::vector<int> lens_at;        // per view: column of its lens
  std::vector<bool> was_posed;     // per view
  std::vector<bool> learns_place;  // per view: its place is to be the camera's
};

// The parameters of an image that no camera of the station took stand behind those of the state.
Prediction Predict(const StationState& state,
                   const StationViews& views,
                   const CameraGroup& group,
                   const StationOptions& options) {
  const int cameras = static_cast<int>(state.cameras.size());
  const int n = static_cast<int>(group.views.size());
  Prediction out;
  std::vector<int> images(cameras, 0);
  for (const int v : group.views) {
    if (views[v] >= 0) ++images[views[v]];
  }
  for (const StationCamera& c : state.cameras) {
    out.cameras.push_back(c.camera);
    out.places.push_back(c.camera_from_rig);
  }
  int size = kCam * cameras;
  struct Block {
    int at;
    Eigen::VectorXd sigmas;
  };
  std::vector<Block> added;
  for (int i = 0; i < n; ++i) {
    const int c = views[group.views[i]];
    out.camera.push_back(c);
    const bool fixed = c >= 0 && !state.cameras[c].moving && images[c] == 1;
    out.was_posed.push_back(fixed && state.cameras[c].posed);
    out.learns_place.push_back(fixed);
    if (fixed) {
      out.place.push_back(c);
      out.place_at.push_back(kCam * c);
    } else {
      out.place.push_back(static_cast<int>(out.places.size()));
      out.places.push_back({});
      out.place_at.push_back(size);
      added.push_back({size, Eigen::VectorXd::Zero(6)});
      size += 6;
    }
    if (c >= 0) {
      out.lens_at.push_back(kCam * c + kLensAt);
    } else {
      out.lens_at.push_back(size);
      added.push_back({size, PopulationSigmas(group.cameras[i], options)});
      size += kLensSize;
    }
  }
  out.P = Eigen::MatrixXd::Zero(size, size);
  out.P.topLeftCorner(kCam * cameras, kCam * cameras) = state.covariance;
  for (const Block& b : added)
    out.P.diagonal().segment(b.at, b.sigmas.size()) = b.sigmas.cwiseAbs2();
  // Places of which nothing is known are taken from the evidence, seen from one that is.
  int known = -1;
  for (int i = 0; i < n && known < 0; ++i) {
    if (out.was_posed[i]) known = i;
  }
  const bool frame = known >= 0;
  if (!frame && !AnyPosed(state)) {  // the first fixed camera becomes the rig's frame
    for (int i = 0; i < n && known < 0; ++i) {
      if (out.learns_place[i]) known = i;
    }
  }
  if (known < 0) {  // of single images: any frame will do
    std::fill(out.learns_place.begin(), out.learns_place.end(), false);
    known = 0;
  }
  if (!frame && n > 0) out.places[out.place[known]] = Rigid3{};
  for (int i = 0; i < n; ++i) {
    if (i == known || out.was_posed[i]) continue;
    out.places[out.place[i]] = group.camera_from_anchor[i] *
                               group.camera_from_anchor[known].Inverse() *
                               out.places[out.place[known]];
    ClearRows(out.place_at[i], 6, &out.P);
    out.P.diagonal().segment<3>(out.place_at[i]).setConstant(kUnknownTurnSigma * kUnknownTurnSigma);
    out.P.diagonal()
        .segment<3>(out.place_at[i] + 3)
        .setConstant(kUnknownShiftSigmaM * kUnknownShiftSigmaM);
  }
  return out;
}

// The cameras of the group as predicted, to be compared with it.
std::vector<AdjustedView> ViewsOf(const Prediction& p, const CameraGroup& group) {
  const int last =
      group.views.empty() ? -1 : *std::max_element(group.views.begin(), group.views.end());
  std::vector<AdjustedView> out(last + 1);
  for (std::size_t i = 0; i < group.views.size(); ++i) {
    out[group.views[i]] = {
        true, p.camera[i] >= 0 ? p.cameras[p.camera[i]] : group.cameras[i], p.places[p.place[i]]};
  }
  return out;
}

// Derivative of the group's parameters by those of the prediction.
Eigen::MatrixXd PredictionJacobian(const Prediction& p,
                                   const CameraGroup& group,
                                   const std::vector<AdjustedView>& views) {
  const Eigen::MatrixXd by_views = GroupJacobian(group, views);
  const int n = static_cast<int>(group.views.size());
  Eigen::MatrixXd J = Eigen::MatrixXd::Zero(kGroupParameters * n, p.P.rows());
  for (int i = 0; i < n; ++i) {
    J.middleCols<6>(p.place_at[i]) += by_views.middleCols<6>(kGroupParameters * i);
    J.middleCols<kLensSize>(p.lens_at[i]) +=
        by_views.middleCols<kLensSize>(kGroupParameters * i + 6);
  }
  return J;
}

// How far the images are from what was predicted: offset, its covariance, and how many numbers are
// compared.
struct Comparison {
  Eigen::VectorXd offset;
  Eigen::MatrixXd S;
  std::vector<std::vector<int>> blocks;  // places and lenses of single views
  int freedoms = 0;
};

Comparison Compare(const Prediction& p,
                   const CameraEvidence& evidence,
                   const std::vector<bool>& lens_open,
                   const StationOptions& options) {
  const CameraGroup& group = evidence.group;
  const int n = static_cast<int>(group.views.size());
  const std::vector<AdjustedView> views = ViewsOf(p, group);
  const Eigen::MatrixXd J = PredictionJacobian(p, group, views);
  const Eigen::VectorXd predicted = GroupOffset(group, views);
  const double narrowing = 1.0 / (options.widening * options.widening);
  Vector10 open;
  open << Eigen::Vector3d::Constant(kOpenTurn), Eigen::Vector3d::Constant(kOpenShiftM),
      kOpenLogFocal, kOpenCenterPx, kOpenCenterPx, kOpenK1;
  Eigen::MatrixXd A = narrowing * evidence.information;
  for (int i = 0; i < n; ++i)
    A.diagonal().segment<kGroupParameters>(kGroupParameters * i) += open.cwiseAbs2().cwiseInverse();
  std::vector<int> kept;  // all but the anchor's place
  for (int i = 6; i < kGroupParameters * n; ++i) kept.push_back(i);
  const Eigen::VectorXd scale = A.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd scaled = scale.asDiagonal() * A * scale.asDiagonal();
  const Eigen::LDLT<Eigen::MatrixXd> ldlt(scaled);
  const Eigen::VectorXd right = narrowing * (evidence.vector - evidence.information * predicted);
  const Eigen::VectorXd offset =
      scale.cwiseProduct(ldlt.solve(Eigen::VectorXd(scale.cwiseProduct(right))));
  const Eigen::MatrixXd of_evidence = scale.asDiagonal() *
                                      ldlt.solve(Eigen::MatrixXd::Identity(A.rows(), A.rows())) *
                                      scale.asDiagonal();
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

// Of each parameter of the evidence, the variance when nothing else is known.
Eigen::VectorXd OpenVariances(const CameraEvidence& evidence) {
  const int n = static_cast<int>(evidence.group.views.size());
  Vector10 open;
  open << Eigen::Vector3d::Constant(kOpenTurn), Eigen::Vector3d::Constant(kOpenShiftM),
      kOpenLogFocal, kOpenCenterPx, kOpenCenterPx, kOpenK1;
  Eigen::MatrixXd A = evidence.information;
  for (int i = 0; i < n; ++i)
    A.diagonal().segment<kGroupParameters>(kGroupParameters * i) += open.cwiseAbs2().cwiseInverse();
  const Eigen::VectorXd scale = A.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::LDLT<Eigen::MatrixXd> ldlt(scale.asDiagonal() * A * scale.asDiagonal());
  const Eigen::MatrixXd inverse = ldlt.solve(Eigen::MatrixXd::Identity(A.rows(), A.rows()));
  return inverse.diagonal().cwiseProduct(scale.cwiseAbs2());
}

// How far what is said of cameras that are not known yet can be believed, 0 .. 1.
double Linearity(const StationState& state,
                 const StationViews& views,
                 const CameraEvidence& evidence,
                 const StationOptions& options) {
  double worst = 0.0;
  Eigen::VectorXd variances;
  for (std::size_t i = 0; i < evidence.group.views.size(); ++i) {
    const int c = views[evidence.group.views[i]];
    if (c < 0 || state.cameras[c].zooming) continue;
    const int at = kCam * c + kLensAt;
    if (std::sqrt(state.covariance(at, at)) <= options.near_log_focal) continue;
    if (variances.size() == 0) variances = OpenVariances(evidence);
    worst = std::max(worst, variances(kGroupParameters * static_cast<int>(i) + 6));
  }
  return 1.0 / (1.0 + worst / (options.linear_log_focal * options.linear_log_focal));
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
  // The distance, and a price for each number that is free in it.
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
  const Prediction p = Predict(supposed, e->views, evidence.group, options);
  const Comparison all = Compare(p, evidence, e->lens, options);
  const double squared = SquaredDistance(all.offset, all.S);
  e->squared = squared;
  e->freedoms = all.freedoms;
  e->limit = ChiSquareLimit(all.freedoms, options.alarm_sigmas);
  const auto count = [](const std::vector<bool>& b) {
    return static_cast<double>(std::count(b.begin(), b.end(), true));
  };
  const double free = 6.0 * count(e->moved) + kLensSize * count(e->lens);
  e->criterion = std::isfinite(squared) ? squared + kPriceOfFreedom * free
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

}  // namespace

absl::Status Validate(const StationOptions& o) {
  if (!(o.remembered > 0.0 && o.remembered <= 1.0))
    return absl::InvalidArgumentError("station.remembered: must be in (0, 1]");
  for (const auto& [value, name] : {std::pair{o.widening, "widening"},
                                    {o.alarm_sigmas, "alarm_sigmas"},
                                    {o.focal_widths, "focal_widths"},
                                    {o.focal_log_sigma, "focal_log_sigma"},
                                    {o.center_sigma, "center_sigma"},
                                    {o.k1_sigma, "k1_sigma"}}) {
    if (!(value > 0.0))
      return absl::InvalidArgumentError(absl::StrCat("station.", name, ": must be positive"));
  }
  return absl::OkStatus();
}

int AddStationCamera(const std::string& id,
                     int width,
                     int height,
                     const StationOptions& options,
                     StationState* state) {
  const int index = static_cast<int>(state->cameras.size());
  StationCamera camera;
  camera.id = id;
  camera.camera = CenteredCamera(width, height, options.focal_widths * width);
  state->cameras.push_back(camera);
  const Eigen::MatrixXd before = state->covariance;
  state->covariance = Eigen::MatrixXd::Zero(kCam * (index + 1), kCam * (index + 1));
  state->covariance.topLeftCorner(kCam * index, kCam * index) = before;
  SetLensSigmas(index, PopulationSigmas(camera.camera, options), &state->covariance);
  return index;
}

void ForgetLens(int camera, const StationOptions& options, StationState* state) {
  StationCamera& c = state->cameras[camera];
  c.camera = CenteredCamera(c.camera.width, c.camera.height, options.focal_widths * c.camera.width);
  c.requests = 0;
  SetLensSigmas(camera, PopulationSigmas(c.camera, options), &state->covariance);
}

void ForgetPlace(int camera, StationState* state) {
  StationCamera& c = state->cameras[camera];
  c.posed = false;
  c.camera_from_rig = {};
  ClearRows(kCam * camera, 6, &state->covariance);
}

void SetLens(int camera, const KnownLens& lens, StationState* state) {
  state->cameras[camera].camera = lens.camera;
  SetLensSigmas(camera,
                {lens.focal_log_sigma, lens.center_sigma_px, lens.center_sigma_px, lens.k1_sigma},
                &state->covariance);
}

CameraGroupPrior PriorOfRequest(const StationState& state,
                                const StationViews& views,
                                const std::vector<bool>& known,
                                const StationOptions& options) {
  CameraGroupPrior out;
  StationState drifted = state;
  AddDrift(options, &drifted);
  ForgetZooms(options, &drifted);
  CameraGroup& group = out.group;
  std::vector<int> images(state.cameras.size(), 0);
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (views[v] >= 0 && known[v]) ++images[views[v]];
  }
  std::vector<int> unposed;
  for (const bool posed_turn : {true, false}) {  // a posed camera is the anchor
    for (std::size_t v = 0; v < views.size(); ++v) {
      if (views[v] < 0 || !known[v]) continue;
      const StationCamera& c = state.cameras[views[v]];
      const bool posed = c.posed && !c.moving && images[views[v]] == 1;
      if (posed != posed_turn) continue;
      group.views.push_back(static_cast<int>(v));
      group.cameras.push_back(drifted.cameras[views[v]].camera);
      group.camera_from_anchor.push_back(c.camera_from_rig);
      if (!posed) unposed.push_back(static_cast<int>(group.views.size()) - 1);
    }
  }
  const int n = static_cast<int>(group.views.size());
  if (n == 0) return out;
  const Rigid3 rig_from_anchor = group.camera_from_anchor[0].Inverse();
  std::vector<AdjustedView> placed(views.size());
  Eigen::MatrixXd pick = Eigen::MatrixXd::Zero(kGroupParameters * n, state.covariance.rows());
  for (int i = 0; i < n; ++i) {
    const int v = group.views[i];
    placed[v] = {true, group.cameras[i], group.camera_from_anchor[i]};
    group.camera_from_anchor[i] = group.camera_from_anchor[i] * rig_from_anchor;
    pick.block<kCam, kCam>(kGroupParameters * i, kCam * views[v]).setIdentity();
  }
  const Eigen::MatrixXd J = GroupJacobian(group, placed) * pick;
  Eigen::MatrixXd P = J * drifted.covariance * J.transpose();
  std::vector<int> compared;
  for (int i = 0; i < kGroupParameters * n; ++i) {
    const int view = i / kGroupParameters;
    const bool place = i % kGroupParameters < 6;
    const bool open = std::find(unposed.begin(), unposed.end(), view) != unposed.end();
    if (!place || (view > 0 && !open)) compared.push_back(i);
  }
  // Two images of one camera have one lens: its variance stands for what is left between them.
  for (const int i : compared) P(i, i) += 1e-4 * P(i, i) + 1e-12;
  const int m = static_cast<int>(compared.size());
  Eigen::MatrixXd of_compared(m, m);
  for (int i = 0; i < m; ++i) {
    for (int j = 0; j < m; ++j) of_compared(i, j) = P(compared[i], compared[j]);
  }
  const Eigen::VectorXd scale = of_compared.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::LDLT<Eigen::MatrixXd> ldlt(scale.asDiagonal() * of_compared * scale.asDiagonal());
  const Eigen::MatrixXd information =
      scale.asDiagonal() * ldlt.solve(Eigen::MatrixXd::Identity(m, m)) * scale.asDiagonal();
  out.information = Eigen::MatrixXd::Zero(kGroupParameters * n, kGroupParameters * n);
  for (int i = 0; i < m; ++i) {
    for (int j = 0; j < m; ++j)
      out.information(compared[i], compared[j]) = 0.5 * (information(i, j) + information(j, i));
  }
  return out;
}

StationTest TestStation(const StationState& state,
                        const StationViews& views,
                        const CameraEvidence& evidence,
                        const StationOptions& options) {
  StationTest out;
  if (evidence.information.size() == 0) return out;
  StationState drifted = state;
  AddDrift(options, &drifted);
  ForgetZooms(options, &drifted);
  Hypothesis best = Nothing(state, views);
  Judge(drifted, evidence, options, &best);
  out.squared = best.squared;
  out.freedoms = best.freedoms;
  out.limit = best.limit;
  out.agrees = best.passes;
  if (out.agrees) return out;
  std::vector<Hypothesis> tried = Orders(state, views, evidence.group);
  for (Hypothesis& e : tried) Judge(drifted, evidence, options, &e);
  for (std::size_t round = 0; round < 2 * state.cameras.size() && !best.passes; ++round) {
    std::vector<Hypothesis> further = Further(state, best, evidence.group);
    if (further.empty()) break;
    for (Hypothesis& e : further) Judge(drifted, evidence, options, &e);
    if (round > 0) tried.clear();
    tried.insert(tried.end(), further.begin(), further.end());
    const Hypothesis* chosen = Best(tried, true);
    if (chosen == nullptr) chosen = Best(further, false);
    best = *chosen;
  }
  if (!best.swapped.empty()) {
    out.changes.push_back({StationChangeKind::kSwapped, best.swapped});
    return out;
  }
  const auto single = [](const std::vector<bool>& b) {
    return std::count(b.begin(), b.end(), true) == 1;
  };
  for (std::size_t c = 0; c < state.cameras.size(); ++c) {
    const int camera = static_cast<int>(c);
    if (best.moved[c]) {
      out.changes.push_back({StationChangeKind::kMoved, {camera}});
      if (single(best.moved)) out.changes.back().cameras = AlikeCameras(tried, best, camera, true);
    }
    if (best.lens[c]) {
      out.changes.push_back({StationChangeKind::kLens, {camera}});
      if (single(best.lens)) out.changes.back().cameras = AlikeCameras(tried, best, camera, false);
    }
  }
  // How much: what is learnt when only that is forgotten which changed.
  StationTest of_first = out;
  for (StationChange& change : of_first.changes) change.cameras.resize(1);
  const StationState now = UpdateStation(state, views, evidence, of_first, options);
  for (StationChange& change : out.changes) {
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
  return out;
}

StationState UpdateStation(StationState state,
                           const StationViews& views,
                           const CameraEvidence& evidence,
                           const StationTest& test,
                           const StationOptions& options) {
  for (const StationChange& change : test.changes) {
    for (const int c : change.cameras) {
      if (change.kind == StationChangeKind::kMoved) ForgetPlace(c, &state);
      if (change.kind == StationChangeKind::kLens) ForgetLens(c, options, &state);
    }
    if (change.kind == StationChangeKind::kSwapped) return state;
  }
  if (evidence.information.size() == 0) return state;
  ForgetZooms(options, &state);
  const CameraGroup& group = evidence.group;
  // Evidence that agrees, but badly, has more noise than it says.
  const double scatter = test.agrees ? test.squared / std::max(1, test.freedoms) : 1.0;
  const double narrowing = Linearity(state, views, evidence, options) /
                           (options.widening * options.widening * std::max(1.0, scatter));
  const Eigen::MatrixXd information = narrowing * evidence.information;
  const Eigen::VectorXd vector = narrowing * evidence.vector;
  std::vector<bool> seen(state.cameras.size(), false);
  for (const int v : group.views) {
    if (views[v] >= 0) seen[views[v]] = true;
  }
  // Cameras that took no part are remembered as they are.
  Eigen::VectorXd fade = Eigen::VectorXd::Ones(state.covariance.rows());
  for (std::size_t c = 0; c < seen.size(); ++c) {
    if (!seen[c]) continue;
    const int at = kCam * static_cast<int>(c);
    fade.segment<kCam>(at).setConstant(1.0 / std::sqrt(options.remembered));
    const Eigen::Vector4d most = PopulationSigmas(state.cameras[c].camera, options);
    for (int i = 0; i < kLensSize; ++i) {
      const double sigma = std::sqrt(state.covariance(at + kLensAt + i, at + kLensAt + i));
      fade(at + kLensAt + i) = std::min(fade(at + kLensAt + i), std::max(1.0, most(i) / sigma));
    }
  }
  state.covariance = fade.asDiagonal() * state.covariance * fade.asDiagonal();

  Prediction p = Predict(state, views, group, options);
  const int size = static_cast<int>(p.P.rows());
  Eigen::VectorXd unit(size);  // makes radians, metres and pixels alike
  for (int i = 0; i < size; ++i) unit(i) = p.P(i, i) > 0.0 ? std::sqrt(p.P(i, i)) : 1.0;
  const Eigen::MatrixXd P =
      unit.cwiseInverse().asDiagonal() * p.P * unit.cwiseInverse().asDiagonal();
  const Prediction start = p;
  Eigen::VectorXd moved = Eigen::VectorXd::Zero(size);  // from the start
  Eigen::MatrixXd after = P;
  const auto move = [&](const Eigen::VectorXd& d) {
    for (std::size_t i = 0; i < group.views.size(); ++i) {
      const int place = p.place[i];
      p.places[place] = Perturbed(start.places[place], d.segment<6>(p.place_at[i]));
    }
    for (std::size_t c = 0; c < p.cameras.size(); ++c) {
      const int at = kCam * static_cast<int>(c);
      if (std::find(p.place.begin(), p.place.end(), static_cast<int>(c)) == p.place.end())
        p.places[c] = Perturbed(start.places[c], d.segment<6>(at));
      const PinholeCamera& from = start.cameras[c];
      p.cameras[c].focal_px = from.focal_px * std::exp(d(at + kLensAt));
      p.cameras[c].cx = from.cx + d(at + kLensAt + 1);
      p.cameras[c].cy = from.cy + d(at + kLensAt + 2);
      p.cameras[c].k1 = from.k1 + d(at + kLensAt + 3);
    }
  };
  // x = x0 + (I + P M)^-1 P b, M = J' L J: also where P or M is singular.
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    const std::vector<AdjustedView> at = ViewsOf(p, group);
    const Eigen::MatrixXd J = PredictionJacobian(p, group, at) * unit.asDiagonal();
    const Eigen::MatrixXd weighted = J.transpose() * information;
    const Eigen::VectorXd d = unit.cwiseInverse().asDiagonal() * moved;
    const Eigen::VectorXd b = J.transpose() * vector - weighted * (GroupOffset(group, at) - J * d);
    const Eigen::PartialPivLU<Eigen::MatrixXd> lu(Eigen::MatrixXd::Identity(size, size) +
                                                  P * (weighted * J));
    after = lu.solve(P);
    const Eigen::VectorXd step = after * b;
    if (!step.allFinite()) return state;
    moved = unit.asDiagonal() * step;
    move(moved);
  }
  after = unit.asDiagonal() * after * unit.asDiagonal();
  for (int i = 0; i < size; ++i) {  // of the frame, up to rounding
    if (p.P(i, i) == 0.0) ClearRows(i, 1, &after);
  }
  const int kept = static_cast<int>(state.covariance.rows());
  if (!after.allFinite()) return state;
  state.covariance =
      0.5 * (after.topLeftCorner(kept, kept) + after.topLeftCorner(kept, kept).transpose());
  for (std::size_t c = 0; c < state.cameras.size(); ++c) {
    state.cameras[c].camera = p.cameras[c];
    if (state.cameras[c].posed) state.cameras[c].camera_from_rig = p.places[c];
    if (seen[c]) ++state.cameras[c].requests;
  }
  for (std::size_t i = 0; i < group.views.size(); ++i) {
    if (p.was_posed[i] || p.place[i] >= static_cast<int>(state.cameras.size())) continue;
    const int c = p.place[i];
    const Eigen::VectorXd variance = state.covariance.diagonal().segment<6>(kCam * c);
    const bool known = p.learns_place[i] &&
                       std::sqrt(variance.head<3>().maxCoeff()) < options.posed_turn_rad &&
                       std::sqrt(variance.tail<3>().maxCoeff()) < options.posed_shift_m;
    if (known) {
      state.cameras[c].posed = true;
      state.cameras[c].camera_from_rig = p.places[c];
    } else {
      ForgetPlace(c, &state);
    }
  }
  ++state.requests;
  return state;
}

StationDeviations DeviationsOf(const StationState& state, int camera) {
  const Eigen::VectorXd variance =
      state.covariance.diagonal().segment<kCam>(kCam * camera).cwiseMax(0.0);
  return {std::sqrt(variance.head<3>().mean()),
          std::sqrt(variance.segment<3>(3).mean()),
          std::sqrt(variance(kLensAt)),
          std::sqrt(variance.segment<2>(kLensAt + 1).mean()),
          std::sqrt(variance(kLensAt + 3))};
}

double ChiSquareLimit(int freedoms, double sigmas) {
  if (freedoms <= 0) return std::numeric_limits<double>::infinity();
  const double k = freedoms, v = 2.0 / (9.0 * k);
  return k * std::pow(1.0 - v + sigmas * std::sqrt(v), 3.0);
}

}  // namespace horopter
