#include "server/vision/station/station_filter.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/vision/geometry/pose_perturbation.h"
#include "server/vision/station/station_prediction.h"

namespace horopter {
namespace {

constexpr int kIterations = 4;  // Gauss-Newton steps of one correction
// Added to a variance, of itself and by itself, so that what two images of one camera share can be
// inverted.
constexpr double kBetweenImages = 1e-4;
constexpr double kLeastVariance = 1e-12;

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
    if (variances.size() == 0)
      variances =
          EquilibratedFactors(Closed(evidence.group, evidence.information)).InverseDiagonal();
    worst = std::max(worst, variances(kGroupParameters * static_cast<int>(i) + 6));
  }
  return 1.0 / (1.0 + worst / (options.linear_log_focal * options.linear_log_focal));
}

// The views of cameras of the station, a posed camera first: it is the anchor. camera_from_anchor
// is still camera_from_rig. Indices into the group of those whose places are not known.
std::vector<int> GroupViews(const StationState& state,
                            const StationState& drifted,
                            const StationViews& views,
                            const std::vector<bool>& known,
                            CameraGroup* group) {
  std::vector<int> images(state.cameras.size(), 0);
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (views[v] >= 0 && known[v]) ++images[views[v]];
  }
  std::vector<int> unposed;
  for (const bool posed_turn : {true, false}) {
    for (std::size_t v = 0; v < views.size(); ++v) {
      if (views[v] < 0 || !known[v]) continue;
      const StationCamera& c = state.cameras[views[v]];
      const bool posed = c.posed && !c.moving && images[views[v]] == 1;
      if (posed != posed_turn) continue;
      group->views.push_back(static_cast<int>(v));
      group->cameras.push_back(drifted.cameras[views[v]].camera);
      group->camera_from_anchor.push_back(c.camera_from_rig);
      if (!posed) unposed.push_back(static_cast<int>(group->views.size()) - 1);
    }
  }
  return unposed;
}

// Inverse of the covariance's rows and columns `compared`; zero in the others.
Eigen::MatrixXd InformationOf(Eigen::MatrixXd P, const std::vector<int>& compared) {
  // Two images of one camera have one lens: its variance stands for what is left between them.
  for (const int i : compared) P(i, i) += kBetweenImages * P(i, i) + kLeastVariance;
  const int m = static_cast<int>(compared.size());
  Eigen::MatrixXd of_compared(m, m);
  for (int i = 0; i < m; ++i) {
    for (int j = 0; j < m; ++j) of_compared(i, j) = P(compared[i], compared[j]);
  }
  const Eigen::MatrixXd information = EquilibratedFactors(of_compared).Inverse();
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(P.rows(), P.cols());
  for (int i = 0; i < m; ++i) {
    for (int j = 0; j < m; ++j)
      out(compared[i], compared[j]) = 0.5 * (information(i, j) + information(j, i));
  }
  return out;
}

// What is known of cameras that are seen fades; those that took no part are remembered as they are.
void Fade(const std::vector<bool>& seen, const StationOptions& options, StationState* state) {
  Eigen::VectorXd fade = Eigen::VectorXd::Ones(state->covariance.rows());
  for (std::size_t c = 0; c < seen.size(); ++c) {
    if (!seen[c]) continue;
    const int at = kCam * static_cast<int>(c);
    fade.segment<kCam>(at).setConstant(1.0 / std::sqrt(options.remembered));
    const Eigen::Vector4d most = PopulationSigmas(state->cameras[c].camera, options);
    for (int i = 0; i < kLensSize; ++i) {
      const double sigma = std::sqrt(state->covariance(at + kLensAt + i, at + kLensAt + i));
      fade(at + kLensAt + i) = std::min(fade(at + kLensAt + i), std::max(1.0, most(i) / sigma));
    }
  }
  state->covariance = fade.asDiagonal() * state->covariance * fade.asDiagonal();
}

// The prediction from `start` moved by d.
void MoveFrom(const StationPrediction& start,
              const CameraGroup& group,
              const Eigen::VectorXd& d,
              StationPrediction* p) {
  for (std::size_t i = 0; i < group.views.size(); ++i) {
    const int place = p->place[i];
    p->places[place] = Perturbed(start.places[place], d.segment<6>(p->place_at[i]));
  }
  for (std::size_t c = 0; c < p->cameras.size(); ++c) {
    const int at = kCam * static_cast<int>(c);
    if (std::find(p->place.begin(), p->place.end(), static_cast<int>(c)) == p->place.end())
      p->places[c] = Perturbed(start.places[c], d.segment<6>(at));
    const PinholeCamera& from = start.cameras[c];
    p->cameras[c].focal_px = from.focal_px * std::exp(d(at + kLensAt));
    p->cameras[c].cx = from.cx + d(at + kLensAt + 1);
    p->cameras[c].cy = from.cy + d(at + kLensAt + 2);
    p->cameras[c].k1 = from.k1 + d(at + kLensAt + 3);
  }
}

// Corrects the prediction by the evidence; its covariance then, not finite where that fails.
Eigen::MatrixXd Correct(const CameraGroup& group,
                        const Eigen::MatrixXd& information,
                        const Eigen::VectorXd& vector,
                        StationPrediction* p) {
  const int size = static_cast<int>(p->P.rows());
  Eigen::VectorXd unit(size);  // makes radians, metres and pixels alike
  for (int i = 0; i < size; ++i) unit(i) = p->P(i, i) > 0.0 ? std::sqrt(p->P(i, i)) : 1.0;
  const Eigen::MatrixXd P =
      unit.cwiseInverse().asDiagonal() * p->P * unit.cwiseInverse().asDiagonal();
  const StationPrediction start = *p;
  Eigen::VectorXd moved = Eigen::VectorXd::Zero(size);  // from the start
  Eigen::MatrixXd after = P;
  // x = x0 + (I + P M)^-1 P b, M = J' L J: also where P or M is singular.
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    const std::vector<AdjustedView> at = ViewsOf(*p, group);
    const Eigen::MatrixXd J = PredictionJacobian(*p, group, at) * unit.asDiagonal();
    const Eigen::MatrixXd weighted = J.transpose() * information;
    const Eigen::VectorXd d = unit.cwiseInverse().asDiagonal() * moved;
    const Eigen::VectorXd b = J.transpose() * vector - weighted * (GroupOffset(group, at) - J * d);
    const Eigen::PartialPivLU<Eigen::MatrixXd> lu(Eigen::MatrixXd::Identity(size, size) +
                                                  P * (weighted * J));
    after = lu.solve(P);
    const Eigen::VectorXd step = after * b;
    if (!step.allFinite())
      return Eigen::MatrixXd::Constant(size, size, std::numeric_limits<double>::quiet_NaN());
    moved = unit.asDiagonal() * step;
    MoveFrom(start, group, moved, p);
  }
  after = unit.asDiagonal() * after * unit.asDiagonal();
  for (int i = 0; i < size; ++i) {  // of the frame, up to rounding
    if (p->P(i, i) == 0.0) ClearRows(i, 1, &after);
  }
  return after;
}

// Places that are known well enough now become those of their cameras.
void LearnPlaces(const StationPrediction& p, const StationOptions& options, StationState* state) {
  for (std::size_t i = 0; i < p.place.size(); ++i) {
    if (p.was_posed[i] || p.place[i] >= static_cast<int>(state->cameras.size())) continue;
    const int c = p.place[i];
    const Eigen::VectorXd variance = state->covariance.diagonal().segment<6>(kCam * c);
    const bool known = p.learns_place[i] &&
                       std::sqrt(variance.head<3>().maxCoeff()) < options.posed_turn_rad &&
                       std::sqrt(variance.tail<3>().maxCoeff()) < options.posed_shift_m;
    if (known) {
      state->cameras[c].posed = true;
      state->cameras[c].camera_from_rig = p.places[c];
    } else {
      ForgetPlace(c, state);
    }
  }
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
  const StationState drifted = AtNextRequest(state, options);
  CameraGroup& group = out.group;
  const std::vector<int> unposed = GroupViews(state, drifted, views, known, &group);
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
  const Eigen::MatrixXd P = J * drifted.covariance * J.transpose();
  std::vector<int> compared;
  for (int i = 0; i < kGroupParameters * n; ++i) {
    const int view = i / kGroupParameters;
    const bool place = i % kGroupParameters < 6;
    const bool open = std::find(unposed.begin(), unposed.end(), view) != unposed.end();
    if (!place || (view > 0 && !open)) compared.push_back(i);
  }
  out.information = InformationOf(P, compared);
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
  std::vector<bool> seen(state.cameras.size(), false);
  for (const int v : group.views) {
    if (views[v] >= 0) seen[views[v]] = true;
  }
  Fade(seen, options, &state);
  StationPrediction p = Predict(state, views, group, options);
  const Eigen::MatrixXd after =
      Correct(group, narrowing * evidence.information, narrowing * evidence.vector, &p);
  if (!after.allFinite()) return state;
  const int kept = static_cast<int>(state.covariance.rows());
  state.covariance =
      0.5 * (after.topLeftCorner(kept, kept) + after.topLeftCorner(kept, kept).transpose());
  for (std::size_t c = 0; c < state.cameras.size(); ++c) {
    state.cameras[c].camera = p.cameras[c];
    if (state.cameras[c].posed) state.cameras[c].camera_from_rig = p.places[c];
    if (seen[c]) ++state.cameras[c].requests;
  }
  LearnPlaces(p, options, &state);
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

}  // namespace horopter
