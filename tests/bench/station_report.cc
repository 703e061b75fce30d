// Do stations learn their cameras, and is what they say of them true?
//   station_report [STATIONS]     synthetic rigs of four cameras, 30 requests each, seeds 1 ..
// Prints errors after 10 and 30 requests, how often 95 % ellipsoids hold the truth, how often a
// camera that was turned by 0.5 degrees or whose focal length changed by 2 % is reported in the
// first request that shows it, and false alarms.
#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iostream>
#include <map>
#include <random>

#include "server/vision/euclidean/euclidean.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/station/station_adjustment.h"
#include "tests/support/synthetic_metric_scene.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

using Part = std::shared_ptr<const PreparedObject>;
constexpr int kViews = 4;
constexpr int kRequests = 30;

std::vector<Part> Parts() {
  return {
      PrepareObject(LBracket()).value(),
      PrepareObject(Wedge()).value(),
      PrepareObject(Prism("profile", {{0, 0}, {0.06, 0}, {0.05, 0.03}, {0.01, 0.045}}, 0.03))
          .value(),
      PrepareObject(Prism("step", {{0, 0}, {0.05, 0}, {0.05, 0.04}, {0.02, 0.055}}, 0.06)).value()};
}

struct Rig {
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> poses;
};

// A request of 1 to 4 parts, with a table or without one, with 0.1 to 0.4 px of noise.
std::optional<StationScene> Request(const std::vector<Part>& parts,
                                    const Rig& rig,
                                    int seed,
                                    const StationState& state,
                                    const StationViews& views) {
  MetricSceneOptions options;
  options.seed = static_cast<unsigned>(seed);
  options.views = kViews;
  options.rig_cameras = rig.cameras;
  options.rig_from_world = rig.poses;
  std::mt19937 rng(static_cast<unsigned>(seed) * 7919u);
  const int count = 1 + static_cast<int>(rng() % 4), first = static_cast<int>(rng() % 4);
  for (int i = 0; i < count; ++i) options.parts.push_back(parts[(first + i) % 4]);
  options.table = rng() % 2 == 0;
  options.end_sigma_px = 0.1 + 0.1 * static_cast<double>(rng() % 4);
  const MetricSceneTruth truth = MakeMetricScene(options);
  auto scene = RefineUnderStation(truth.Input(), truth.recognition, state, views, {}, {});
  if (!scene.ok()) return std::nullopt;
  return *std::move(scene);
}

Rig MakeRig(int seed, const std::vector<Part>& parts) {
  MetricSceneOptions options;
  options.seed = static_cast<unsigned>(seed);
  options.views = kViews;
  options.parts = {parts[0]};
  const MetricSceneTruth truth = MakeMetricScene(options);
  return {truth.cameras, truth.camera_from_world};
}

struct Statistic {
  std::vector<double> focal, center;                // errors
  std::map<std::string, std::pair<int, int>> held;  // of how many
};

double Middle(std::vector<double> v, double share) {
  if (v.empty()) return 0.0;
  std::sort(v.begin(), v.end());
  return v[std::min(v.size() - 1, static_cast<std::size_t>(share * static_cast<double>(v.size())))];
}

void Check(const StationState& state, const Rig& rig, Statistic* out) {
  int frame = -1;
  for (int c = 0; c < kViews && frame < 0; ++c) {
    if (state.cameras[c].posed && state.covariance(10 * c, 10 * c) == 0.0) frame = c;
  }
  for (int c = 0; c < kViews; ++c) {
    const PinholeCamera &has = state.cameras[c].camera, &is = rig.cameras[c];
    Eigen::Vector4d d(
        std::log(has.focal_px / is.focal_px), has.cx - is.cx, has.cy - is.cy, has.k1 - is.k1);
    out->focal.push_back(std::abs(d(0)));
    out->center.push_back(d.segment<2>(1).norm());
    const auto held =
        [&](const char* what, const Eigen::VectorXd& x, const Eigen::MatrixXd& P, double limit) {
          auto& [in, of] = out->held[what];
          in += x.dot(P.ldlt().solve(x)) <= limit;
          ++of;
        };
    held("focal length", d.head<1>(), state.covariance.block<1, 1>(10 * c + 6, 10 * c + 6), 3.841);
    held("principal point",
         d.segment<2>(1),
         state.covariance.block<2, 2>(10 * c + 7, 10 * c + 7),
         5.991);
    held("lens (4)", d, state.covariance.block<4, 4>(10 * c + 6, 10 * c + 6), 9.488);
    if (frame < 0 || c == frame || !state.cameras[c].posed) continue;
    const Rigid3 truth = rig.poses[c] * rig.poses[frame].Inverse();
    const Vector6d off = PerturbationBetween(truth, state.cameras[c].camera_from_rig);
    held("place (6)", off, state.covariance.block<6, 6>(10 * c, 10 * c), 12.592);
  }
}

void Print(const char* when, const Statistic& s) {
  std::cout << when << ": focal error median " << 100 * Middle(s.focal, 0.5) << " %, 90 % "
            << 100 * Middle(s.focal, 0.9) << " %; principal point median " << Middle(s.center, 0.5)
            << " px, 90 % " << Middle(s.center, 0.9) << " px\n";
  for (const auto& [what, held] : s.held) {
    std::cout << "  95 % of " << what << " holds the truth in "
              << 100.0 * held.first / std::max(1, held.second) << " % of " << held.second << "\n";
  }
}

const StationChange* Find(const StationTest& test, StationChangeKind kind, int camera) {
  for (const StationChange& c : test.changes) {
    if (c.kind == kind && std::find(c.cameras.begin(), c.cameras.end(), camera) != c.cameras.end())
      return &c;
  }
  return nullptr;
}

struct Detection {
  int shown = 0, alarmed = 0, named = 0, alone = 0;
};

void Report(int stations) {
  const std::vector<Part> parts = Parts();
  const StationOptions options;
  const StationViews views = {0, 1, 2, 3};
  Statistic after_10, after_30;
  int tested = 0, false_alarms = 0, refused = 0;
  std::map<std::string, Detection> detections;
  for (int s = 1; s <= stations; ++s) {
    const Rig rig = MakeRig(s, parts);
    StationState state;
    for (int c = 0; c < kViews; ++c)
      AddStationCamera("camera" + std::to_string(c), 640, 480, options, &state);
    for (int r = 0; r < kRequests; ++r) {
      const int seed = 1000 * s + r;
      if (r >= 10 && r % 5 == 0) {
        std::mt19937 rng(static_cast<unsigned>(seed));
        const int c = static_cast<int>(rng() % kViews);
        std::normal_distribution<double> normal;
        const Eigen::Vector3d axis =
            Eigen::Vector3d(normal(rng), normal(rng), normal(rng)).normalized();
        const auto detect = [&](const char* what,
                                const Rig& changed,
                                const StationViews& asked,
                                StationChangeKind kind) {
          const auto scene = Request(parts, changed, seed, state, asked);
          if (!scene) return;
          const StationTest& test = scene->test;
          Detection& d = detections[what];
          ++d.shown;
          d.alarmed += !test.agrees;
          const StationChange* found = Find(test, kind, c);
          d.named += found != nullptr;
          d.alone += found != nullptr && test.changes.size() == 1 &&
                     (kind == StationChangeKind::kSwapped || found->cameras.size() == 1);
        };
        Rig turned = rig, zoomed = rig;
        turned.poses[c] =
            Rigid3{RotationFromVector(axis * 0.5 * M_PI / 180), Eigen::Vector3d::Zero()} *
            turned.poses[c];
        zoomed.cameras[c].focal_px *= 1.02;
        detect("turned by 0.5 degrees", turned, views, StationChangeKind::kMoved);
        detect("focal length 2 % longer", zoomed, views, StationChangeKind::kLens);
        Rig far = rig;
        far.poses[c] =
            Rigid3{RotationFromVector(axis * 0.05), Eigen::Vector3d(0.03, 0, 0)} * far.poses[c];
        detect("moved by 3 cm and 3 degrees", far, views, StationChangeKind::kMoved);
        StationViews other = views;
        std::swap(other[c], other[(c + 1) % kViews]);
        detect("two cameras in the other order", rig, other, StationChangeKind::kSwapped);
      }
      const auto scene = Request(parts, rig, seed, state, views);
      if (!scene) {
        ++refused;
        continue;
      }
      const StationTest& test = scene->test;
      ++tested;
      if (!test.agrees) {
        ++false_alarms;
        std::cout << "false alarm: station " << s << " request " << r << ": " << test.squared
                  << " > " << test.limit << "\n";
      }
      state = UpdateStation(state, views, scene->evidence, test, options);
      if (r == 9) Check(state, rig, &after_10);
    }
    Check(state, rig, &after_30);
  }
  Print("after 10 requests", after_10);
  Print("after 30 requests", after_30);
  std::cout << false_alarms << " false alarms in " << tested << " requests, " << refused
            << " requests without an adjusted scene\n";
  for (const auto& [what, d] : detections) {
    std::cout << what << ": reported in " << d.alarmed << " of " << d.shown << ", rightly named in "
              << d.named << ", and nothing else in " << d.alone << "\n";
  }
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  horopter::Report(argc > 1 ? std::atoi(argv[1]) : 20);
}
