// Scenes of known parts as recognition hands them to the euclidean stage: edges with noise, poses
// and cameras a little off, exact truth.
#pragma once

#include <memory>
#include <vector>

#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/recognition/recognition.h"

namespace horopter {

struct MetricSceneOptions {
  unsigned seed = 1;
  std::vector<std::shared_ptr<const PreparedObject>> parts;  // one object of each, on a circle
  int views = 5;
  bool table = true;             // matched points of the plane z = 0
  double end_sigma_px = 0.3;     // of the ends of an edge, across and along
  double cad_sigma_m = 0.00004;  // displacement of each CAD edge, the same in all views
  double center_sigma = 0.01;    // of the principal point, share of the width
  double min_focal_widths = 1.1;
  double max_focal_widths = 1.9;
  bool one_camera = false;  // all views have the first one's intrinsics
  // Cameras that stand still from scene to scene; empty: new ones. One per view each.
  std::vector<PinholeCamera> rig_cameras;
  std::vector<Rigid3> rig_from_world;
  double distance_m = 0.55;  // of the cameras
  double arc_rad = 1.2;
  double start_turn_rad = 0.004;  // how far recognition's poses are off
  double start_shift_m = 0.0006;
};

struct MetricSceneTruth {
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> camera_from_world;
  std::vector<Rigid3> world_from_object;
  std::vector<ImageFeatures> features;
  MatchingResult matching;
  RecognitionResult recognition;
  std::vector<std::shared_ptr<const PreparedObject>> objects;

  RecognitionInput Input() const;
};

MetricSceneTruth MakeMetricScene(const MetricSceneOptions& options);

// A cylinder, listed as a surface of revolution: edges are two circles.
ObjectModel Cylinder(double radius_m, double height_m);

// The part enlarged.
ObjectModel Scaled(ObjectModel model, double factor);

}  // namespace horopter
