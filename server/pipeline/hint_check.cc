#include "server/pipeline/hint_check.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "server/pipeline/contradicted_hint.h"
#include "server/vision/station/station_filter.h"

namespace horopter {
namespace {

constexpr int kPoseParameters = 6;  // of a view of the group, before those of its lens
// Deviations that the claims are let go with.
constexpr double kLooseFocalLog = 0.35;
constexpr double kLooseCenter = 0.03;  // of the width
// Deviations of calibrations that are not stated: rounded, of another focus, by another program.
constexpr double kClaimedCenterSigmaPx = 3.0;
constexpr double kClaimedK1Sigma = 0.01;
// What the images leave open is known as badly as this: turns and places, log f, centre (of the
// width), k1.
constexpr double kOpenPose = 100.0, kOpenFocalLog = 10.0, kOpenCenter = 0.5, kOpenK1 = 1.0;
// Evidence is taken for this many times less sure than it says: parts are not quite their models
// (SharedCameraOptions::widening).
constexpr double kEvidenceWidening = 2.0;
// Of the normal distribution; beyond it a claim is contradicted.
constexpr double kAlarmSigmas = 4.0;
// What many images say of one factor of all their focal lengths is as good as it says: over the 14
// scenes of hint_report --test (parts val, parts-dev) it is within 1.1 of its deviations of the
// true one, where single images err by three. Files of calibrations are better than what a caller
// may say by default (ADR 76).
constexpr double kCommonWidening = 1.0;
constexpr double kClaimedCommonFocalLog = 0.01;  // where no deviation is stated
constexpr double kCommonAlarmSigmas = 2.5;
// No answer of which a claim is contradicted is likelier than this.
constexpr double kMostContradictedScore = 0.5;

// A number that the caller states of a camera, and how far what the images say is from it.
struct Claim {
  int image = -1;
  int at = -1;          // in the group's parameters
  double offset = 0.0;  // of the camera of the group from what is said
  double sigma = 0.0;   // of what is said
  enum class Kind { kFocal, kCenterX, kCenterY, kK1 } kind = Kind::kK1;
  bool stated = false;  // sigma is the caller's
};

std::vector<Claim> ClaimsOf(std::span<const CameraHint> hints, const CameraGroup& group) {
  std::vector<Claim> claims;
  for (std::size_t i = 0; i < group.views.size(); ++i) {
    const int v = group.views[i];
    const CameraHint& hint = hints[v];
    const PinholeCamera& camera = group.cameras[i];
    const int lens = kGroupParameters * static_cast<int>(i) + kPoseParameters;
    if (hint.focal_px && !hint.presumed) {
      claims.push_back({v,
                        lens,
                        std::log(camera.focal_px / *hint.focal_px),
                        FocalLogSigma(hint),
                        Claim::Kind::kFocal,
                        hint.focal_log_sigma.has_value()});
    }
    if (hint.principal_point) {
      const Eigen::Vector2d& c = *hint.principal_point;
      claims.push_back(
          {v, lens + 1, camera.cx - c.x(), kClaimedCenterSigmaPx, Claim::Kind::kCenterX});
      claims.push_back(
          {v, lens + 2, camera.cy - c.y(), kClaimedCenterSigmaPx, Claim::Kind::kCenterY});
    }
    if (hint.k1)
      claims.push_back({v, lens + 3, camera.k1 - *hint.k1, kClaimedK1Sigma, Claim::Kind::kK1});
  }
  return claims;
}

// Covariance and mean of the cameras' parameters by the images.
struct LensEvidence {
  Eigen::MatrixXd covariance;
  Eigen::VectorXd mean;
};
LensEvidence WhatImagesSay(const CameraEvidence& evidence) {
  constexpr double kNarrowing = 1.0 / (kEvidenceWidening * kEvidenceWidening);
  Eigen::MatrixXd information = kNarrowing * evidence.information;
  for (std::size_t i = 0; i < evidence.group.views.size(); ++i) {
    Eigen::Matrix<double, kGroupParameters, 1> open;
    open.setConstant(kOpenPose);
    const double center = kOpenCenter * evidence.group.cameras[i].width;
    open.tail<4>() << kOpenFocalLog, center, center, kOpenK1;
    information.diagonal().segment<kGroupParameters>(kGroupParameters * static_cast<int>(i)) +=
        open.cwiseAbs2().cwiseInverse();
  }
  // Equilibrated, so that radians, metres and pixels are treated alike.
  const Eigen::VectorXd scale = information.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::LDLT<Eigen::MatrixXd> factors(scale.asDiagonal() * information * scale.asDiagonal());
  const Eigen::MatrixXd inverse =
      factors.solve(Eigen::MatrixXd::Identity(information.rows(), information.cols()));
  LensEvidence out;
  out.covariance = scale.asDiagonal() * inverse * scale.asDiagonal();
  out.mean = kNarrowing * (out.covariance * evidence.vector);
  return out;
}

// How far what the images say is from the claims, and its covariance by the images alone.
struct Offsets {
  Eigen::VectorXd offset;
  Eigen::MatrixXd covariance;
};
Offsets OffsetsOf(const std::vector<Claim>& claims, const LensEvidence& said) {
  const int n = static_cast<int>(claims.size());
  Offsets out{Eigen::VectorXd(n), Eigen::MatrixXd(n, n)};
  for (int i = 0; i < n; ++i) {
    out.offset(i) = claims[i].offset + said.mean(claims[i].at);
    for (int j = 0; j < n; ++j) out.covariance(i, j) = said.covariance(claims[i].at, claims[j].at);
  }
  return out;
}

// Squared distances of these claims from what the images say, all together.
double SquaredDistance(const std::vector<Claim>& claims, const LensEvidence& said) {
  auto [offset, S] = OffsetsOf(claims, said);
  for (std::size_t i = 0; i < claims.size(); ++i) S(i, i) += claims[i].sigma * claims[i].sigma;
  const Eigen::VectorXd scale = S.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::LLT<Eigen::MatrixXd> factors(scale.asDiagonal() * S * scale.asDiagonal());
  return factors.matrixL().solve(Eigen::VectorXd(scale.cwiseProduct(offset))).squaredNorm();
}

double LimitOf(const std::vector<Claim>& claims) {
  return ChiSquareLimit(static_cast<int>(claims.size()), kAlarmSigmas);
}

struct CommonError {
  double offset = 0.0, sigma = 0.0;
};

std::vector<Claim> OfKind(std::vector<Claim> claims, Claim::Kind kind) {
  std::erase_if(claims, [&](const Claim& claim) { return claim.kind != kind; });
  return claims;
}

// All claims of one kind being off by the same: one file for all images.
CommonError CommonOffset(const std::vector<Claim>& claims, const LensEvidence& said) {
  const auto [offset, S] = OffsetsOf(claims, said);
  const Eigen::VectorXd weights = S.ldlt().solve(Eigen::VectorXd::Ones(offset.size()));
  const double information = weights.sum();
  return {weights.dot(offset) / information, 1.0 / std::sqrt(information)};
}

double SquaredCommonDistance(const std::vector<Claim>& claims, const LensEvidence& said) {
  const CommonError common = CommonOffset(claims, said);
  const bool focal = claims[0].kind == Claim::Kind::kFocal;
  double sigma = 0.0;
  for (const Claim& claim : claims)
    sigma = std::max(sigma, focal && !claim.stated ? kClaimedCommonFocalLog : claim.sigma);
  // A single image has nothing that its own errors average out with.
  const double widening = focal && claims.size() > 1 ? kCommonWidening : kEvidenceWidening;
  const double of_images = widening / kEvidenceWidening * common.sigma;
  return common.offset * common.offset / (of_images * of_images + sigma * sigma);
}

}  // namespace

bool HasClaim(const CameraHint& hint) {
  return (hint.focal_px && !hint.presumed) || hint.principal_point || hint.k1;
}

bool HasClaims(std::span<const CameraHint> hints) {
  return std::any_of(hints.begin(), hints.end(), HasClaim);
}

SceneRequest WithoutClaims(SceneRequest request) {
  for (CameraHint& hint : request.hints) {
    if (!hint.presumed) {
      hint.focal_px.reset();
      hint.focal_log_sigma.reset();
    }
    hint.principal_point.reset();
    hint.k1.reset();
  }
  return request;
}

std::vector<CameraHint> LoosenedClaims(std::span<const CameraHint> hints,
                                       std::span<const cv::Mat> images) {
  std::vector<CameraHint> out(hints.begin(), hints.end());
  for (std::size_t v = 0; v < out.size(); ++v) {
    CameraHint& hint = out[v];
    if (hint.focal_px && !hint.presumed)
      hint.focal_log_sigma = std::max(kLooseFocalLog, FocalLogSigma(hint));
    if (hint.principal_point) hint.principal_point_sigma_px = kLooseCenter * images[v].cols;
    hint.k1.reset();
  }
  return out;
}

std::optional<CommonFactor> CommonFocalFactor(std::span<const CameraHint> hints,
                                              const CameraEvidence& evidence) {
  if (evidence.information.size() == 0) return std::nullopt;
  const std::vector<Claim> focals = OfKind(ClaimsOf(hints, evidence.group), Claim::Kind::kFocal);
  const LensEvidence said = WhatImagesSay(evidence);
  if (focals.empty() || !said.covariance.allFinite()) return std::nullopt;
  const CommonError common = CommonOffset(focals, said);
  return CommonFactor{common.offset, common.sigma};
}

HintTest TestHints(std::span<const CameraHint> hints, const CameraEvidence& evidence) {
  HintTest out;
  if (evidence.information.size() == 0) return out;
  const std::vector<Claim> claims = ClaimsOf(hints, evidence.group);
  const LensEvidence said = WhatImagesSay(evidence);
  if (claims.empty() || !said.covariance.allFinite()) return out;
  const auto test = [&](double squared, double limit, int image) {
    if (squared * out.limit >= out.squared * limit) {
      out.squared = squared;
      out.limit = limit;
    }
    if (squared <= limit) return;
    out.agrees = false;
    if (image >= 0) out.images.push_back(image);
  };
  for (const int v : evidence.group.views) {
    std::vector<Claim> of_view;
    for (const Claim& claim : claims) {
      if (claim.image != v) continue;
      of_view.push_back(claim);
    }
    if (!of_view.empty()) test(SquaredDistance(of_view, said), LimitOf(of_view), v);
  }
  test(SquaredDistance(claims, said), LimitOf(claims), -1);
  for (const auto kind : {Claim::Kind::kFocal, Claim::Kind::kCenterX, Claim::Kind::kCenterY}) {
    const std::vector<Claim> alike = OfKind(claims, kind);
    if (!alike.empty())
      test(SquaredCommonDistance(alike, said), ChiSquareLimit(1, kCommonAlarmSigmas), -1);
  }
  return out;
}

void TellContradictedHints(std::span<const CameraHint> hints,
                           const HintTest& test,
                           std::span<const std::optional<PosedCamera>> cameras,
                           SceneAnswer* answer) {
  std::vector<int> images = test.images;
  if (images.empty()) {
    // Together they do, none of them for certain.
    for (std::size_t v = 0; v < hints.size(); ++v) {
      if (HasClaim(hints[v])) images.push_back(static_cast<int>(v));
    }
  }
  for (const int v : images) {
    if (v >= static_cast<int>(cameras.size()) || !cameras[v]) continue;
    const PinholeCamera& camera = cameras[v]->camera;
    answer->contradicted_hints.push_back(TellHint(v, camera.focal_px, {camera.cx, camera.cy}));
  }
  AddReason(ReasonKind::kHintContradicted,
            "the images contradict what is said of their cameras, which was not used",
            answer);
  for (AnswerObject& object : answer->objects)
    object.score = std::min(object.score, kMostContradictedScore);
}

}  // namespace horopter
