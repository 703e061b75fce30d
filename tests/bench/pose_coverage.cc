#include "tests/bench/pose_coverage.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <iomanip>
#include <set>

#include "tests/diagnose/camera_report.h"
#include "tests/diagnose/object_report.h"

namespace horopter {
namespace {

constexpr double kRightPx = 10.0;
constexpr double kDegrees = 180.0 / M_PI;

Eigen::Vector3d CenterOf(const ObjectModel& model) {
  Eigen::Vector3d low = model.mesh.vertices[0], high = low;
  for (const auto& v : model.mesh.vertices) low = low.cwiseMin(v), high = high.cwiseMax(v);
  return 0.5 * (low + high);
}

double Turn(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b) {
  return std::acos(std::clamp(0.5 * ((a.transpose() * b).trace() - 1.0), -1.0, 1.0));
}

template <typename Check, typename Holds>
void PrintShare(const std::string& name,
                const std::vector<Check>& checks,
                const Holds& holds,
                std::ostream& out) {
  std::set<std::string> tiers{"all"};
  for (const Check& c : checks) tiers.insert(c.tier);
  for (const std::string& tier : tiers) {
    int n = 0, held = 0;
    for (const Check& c : checks) {
      if (tier != "all" && c.tier != tier) continue;
      ++n;
      held += holds(c);
    }
    if (n == 0) continue;
    out << std::left << std::setw(22) << name << std::setw(5) << tier << std::right << std::setw(6)
        << n << std::fixed << std::setprecision(3) << std::setw(8) << static_cast<double>(held) / n;
    if constexpr (requires { checks[0].chi_square; }) {
      std::vector<double> chi, turn, shift, stated_turn, stated_shift;
      for (const Check& c : checks) {
        if (tier != "all" && c.tier != tier) continue;
        chi.push_back(c.chi_square);
        turn.push_back(c.turn_deg);
        shift.push_back(c.shift_mm);
        stated_turn.push_back(c.stated_turn_deg);
        stated_shift.push_back(c.stated_shift_mm);
      }
      out << std::setprecision(2) << "   chi2 " << Median(chi) << "  off " << Median(shift)
          << " mm " << Median(turn) << " deg  stated " << Median(stated_shift) << " mm "
          << Median(stated_turn) << " deg";
    } else if constexpr (requires { checks[0].shift_mm; }) {
      double shift = 0.0, turn = 0.0;
      for (const Check& c : checks) {
        if (tier != "all" && c.tier != tier) continue;
        shift = std::max(shift, c.shift_mm);
        turn = std::max(turn, c.turn_deg);
      }
      out << std::setprecision(2) << "   worst " << shift << " mm " << turn << " deg";
    } else {
      std::vector<double> error, sigma;
      for (const Check& c : checks) {
        if (tier != "all" && c.tier != tier) continue;
        error.push_back(std::abs(c.error));
        sigma.push_back(c.sigma);
      }
      out << std::setprecision(4) << "   off " << Median(error) << "  stated " << Median(sigma);
    }
    out << "\n";
  }
}

}  // namespace

PoseCheck CheckPose(const UncertainPose& stated,
                    const Rigid3& truth,
                    const Eigen::Vector3d& center) {
  PoseCheck check;
  const Vector6d d = PerturbationBetween(stated.pose, truth);
  // Equilibrated: radians and metres differ by orders of magnitude.
  const Vector6d s = stated.covariance.diagonal().cwiseMax(1e-30).cwiseSqrt().cwiseInverse();
  const Matrix6d C = s.asDiagonal() * stated.covariance * s.asDiagonal();
  const Vector6d e = s.cwiseProduct(d);
  check.chi_square = e.dot(C.fullPivLu().solve(e));
  check.turn_deg = kDegrees * d.head<3>().norm();
  check.shift_mm = 1e3 * (stated.pose * center - truth * center).norm();
  const Matrix6d J = FirstInProduct(stated.pose, {Eigen::Matrix3d::Identity(), center});
  const Matrix6d at_center = J * stated.covariance * J.transpose();
  check.stated_turn_deg = kDegrees * std::sqrt(at_center.topLeftCorner<3, 3>().trace());
  check.stated_shift_mm = 1e3 * std::sqrt(at_center.bottomRightCorner<3, 3>().trace());
  return check;
}

std::vector<TrueMatch> MatchAnswer(const MetricScene& metric,
                                   const std::vector<const ObjectModel*>& models,
                                   const std::vector<int>& obj_ids,
                                   const BopScene& scene) {
  std::vector<TrueMatch> out(metric.objects.size());
  std::set<int> taken;
  for (std::size_t k = 0; k < metric.objects.size(); ++k) {
    double best = kRightPx;
    for (std::size_t i = 0; i < scene.images[0].instances.size(); ++i) {
      if (scene.images[0].instances[i].obj_id != obj_ids[k] || taken.count(static_cast<int>(i))) {
        continue;
      }
      std::vector<double> errors;
      for (std::size_t v = 0; v < metric.cameras.size(); ++v) {
        if (!metric.cameras[v]) continue;
        errors.push_back(ProjectionError(
            *models[k],
            metric.cameras[v]->camera,
            metric.cameras[v]->camera_from_scene * metric.objects[k].scene_from_object,
            scene.images[v],
            scene.images[v].instances[i].camera_from_object));
      }
      if (const double error = Median(errors); error < best) {
        best = error;
        out[k].instance = static_cast<int>(i);
      }
    }
    if (out[k].instance < 0) continue;
    taken.insert(out[k].instance);
    // The symmetry nearest in the first recovered camera.
    for (std::size_t v = 0; v < metric.cameras.size(); ++v) {
      if (!metric.cameras[v]) continue;
      const Eigen::Matrix3d estimate =
          metric.cameras[v]->camera_from_scene.R * metric.objects[k].scene_from_object.R;
      const Eigen::Matrix3d truth = scene.images[v].instances[out[k].instance].camera_from_object.R;
      double nearest = Turn(estimate, truth);
      for (const Rigid3& S : models[k]->symmetries) {
        if (const double turn = Turn(estimate, truth * S.R); turn < nearest) {
          nearest = turn;
          out[k].symmetry = S;
        }
      }
      break;
    }
  }
  return out;
}

void CheckScene(const MetricScene& metric,
                const std::vector<const ObjectModel*>& models,
                const std::vector<int>& obj_ids,
                const BopScene& scene,
                CoverageReport* report) {
  const std::vector<TrueMatch> matches = MatchAnswer(metric, models, obj_ids, scene);
  TransformGraph graph;
  const SceneFrames frames = AddSceneFrames(metric, &graph);
  const auto truth_of = [&](std::size_t v, std::size_t k) {
    return scene.images[v].instances[matches[k].instance].camera_from_object * matches[k].symmetry;
  };
  report->objects += static_cast<int>(matches.size());
  const auto add =
      [&](PoseCheck check, std::size_t k, std::size_t reference, std::vector<PoseCheck>* to) {
        check.tier = scene.tier;
        check.scene = scene.scene_id;
        check.object = static_cast<int>(k);
        check.reference = static_cast<int>(reference);
        to->push_back(check);
      };
  for (std::size_t k = 0; k < matches.size(); ++k) {
    if (matches[k].instance < 0) {
      ++report->wrong;
      continue;
    }
    const Eigen::Vector3d center = CenterOf(*models[k]);
    for (std::size_t v = 0; v < metric.cameras.size(); ++v) {
      if (!metric.cameras[v]) continue;
      add(CheckPose(*graph.Between(frames.cameras[v], frames.objects[k]), truth_of(v, k), center),
          k,
          v,
          &report->cameras);
    }
    for (std::size_t r = 0; r < k; ++r) {
      if (matches[r].instance < 0) continue;
      const PoseCheck check = CheckPose(*graph.Between(frames.objects[r], frames.objects[k]),
                                        truth_of(0, r).Inverse() * truth_of(0, k),
                                        center);
      add(check, k, r, &report->pairs);
      if (r == 0) add(check, k, r, &report->reference);
    }
  }
  for (std::size_t v = 0; v < metric.cameras.size(); ++v) {
    if (!metric.cameras[v]) continue;
    report->focal.push_back(
        {scene.tier,
         scene.scene_id,
         static_cast<int>(v),
         std::log(metric.cameras[v]->camera.focal_px / scene.images[v].camera.focal_px),
         metric.cameras[v]->focal_log_sigma});
  }
}

void CheckSceneGrasps(const MetricScene& metric,
                      const std::vector<const ObjectModel*>& models,
                      const std::vector<int>& obj_ids,
                      const BopScene& scene,
                      const GraspOptions& options,
                      CoverageReport* report) {
  const std::vector<TrueMatch> matches = MatchAnswer(metric, models, obj_ids, scene);
  const auto truth_of = [&](std::size_t k) {
    return scene.images[0].instances[matches[k].instance].camera_from_object * matches[k].symmetry;
  };
  TransformGraph graph;
  const SceneFrames frames = AddSceneFrames(metric, &graph);
  const std::size_t n = matches.size();
  for (std::size_t r = 0; r < n; ++r) {
    if (n > 1 && matches[r].instance < 0) continue;
    // The reference is object r: what is sure is said in its frame.
    GraspScene planned;
    planned.plane = metric.plane;
    for (std::size_t k = 0; k < n; ++k) {
      const Matrix6d turn = SecondInProduct(metric.objects[r].scene_from_object);
      planned.objects.push_back(
          {models[k],
           metric.objects[k].scene_from_object,
           turn * graph.Between(frames.objects[r], frames.objects[k])->covariance *
               turn.transpose()});
    }
    for (std::size_t k = 0; k < n; ++k) {
      GraspCounts counts;
      const auto grasps = PlanGrasps(planned, static_cast<int>(k), options, &counts);
      if (r == 0) {
        report->grasp_counts.considered += counts.considered;
        report->grasp_counts.too_narrow += counts.too_narrow;
        report->grasp_counts.below_plane += counts.below_plane;
        report->grasp_counts.blocked += counts.blocked;
        report->grasp_counts.unsure += counts.unsure;
        report->grasps_offered += static_cast<int>(grasps.size());
        report->objects_without_grasp += grasps.empty();
      }
      if (r == k || matches[k].instance < 0) continue;
      const Rigid3 object_from_scene = metric.objects[k].scene_from_object.Inverse();
      const Rigid3 r_from_scene = metric.objects[r].scene_from_object.Inverse();
      for (const SceneGrasp& g : grasps) {
        const Rigid3 wanted = truth_of(k) * (object_from_scene * g.scene_from_gripper);
        const Rigid3 got = truth_of(r) * (r_from_scene * g.scene_from_gripper);
        report->grasps.push_back({scene.tier,
                                  scene.scene_id,
                                  1e3 * (got.t - wanted.t).norm(),
                                  kDegrees * Turn(got.R, wanted.R),
                                  g.success});
      }
    }
  }
}

void PrintCoverage(const CoverageReport& report, std::ostream& out) {
  out << report.objects << " objects answered, " << report.wrong
      << " of them at no instance's pose (left out)\n";
  const auto holds = [](const PoseCheck& c) { return c.chi_square <= kChiSquare6; };
  PrintShare("object in reference", report.reference, holds, out);
  PrintShare("object in object", report.pairs, holds, out);
  PrintShare("object in camera", report.cameras, holds, out);
  PrintShare(
      "focal length",
      report.focal,
      [](const FocalCheck& c) { return c.error * c.error <= kChiSquare1 * c.sigma * c.sigma; },
      out);
  const GraspCounts& g = report.grasp_counts;
  out << "grasps: " << g.considered << " considered, " << report.grasps_offered << " offered, "
      << g.below_plane << " through the plane, " << g.blocked << " through another object, "
      << g.too_narrow << " too narrow, " << g.unsure << " unsure; " << report.objects_without_grasp
      << " objects without any\n";
  PrintShare(
      "grasp within 2 mm 2 deg",
      report.grasps,
      [](const GraspCheck& c) { return c.shift_mm <= 2.0 && c.turn_deg <= 2.0; },
      out);
}

}  // namespace horopter
