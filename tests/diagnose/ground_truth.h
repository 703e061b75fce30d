// What a perfect feature stage would see: the visible sharp edges and corners of the known parts.
#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/bop_dataset.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

// CAD models of a dataset by obj_id, with id, symmetries and grasps filled in as enrolment does.
using TrueModels = std::map<int, ObjectModel>;

// Errors: those of the readers; NOT_FOUND when an object has neither CAD nor mesh.
absl::StatusOr<TrueModels> ReadTrueModels(const BopDataset& dataset);

// A sharp edge with what of it the camera sees.
struct TrueEdge {
  int instance = -1;  // index into BopImage::instances
  int edge = -1;      // index into ObjectModel::edges
  CurveKind kind = CurveKind::kLine;
  std::vector<Eigen::Vector2d> points;  // visible samples about 1 px apart, pixels, with distortion
  std::vector<Eigen::Vector2d> tangents;  // unit
  double length_px = 0.0;                 // visible
};

// A part's vertex in which at least two of its visible edges meet, seen in the image.
struct TrueCorner {
  int instance = -1;
  int vertex = -1;
  Eigen::Vector2d point = Eigen::Vector2d::Zero();
};

struct TrueView {
  std::vector<TrueEdge> edges;  // visible for at least 20 px
  std::vector<TrueCorner> corners;
};

// Projects with the true camera, k1 included.
Eigen::Vector2d ProjectTrue(const BopImage& image, const Eigen::Vector3d& point_in_camera);

// Hidden lines are removed against all known parts of the scene (unknown objects are not modelled,
// so parts behind them count as visible: figures of scenes with distractors are lower bounds).
TrueView MakeTrueView(const BopImage& image, const TrueModels& models);

}  // namespace horopter
