// What a reconstructed structure says for an object in it: the hypothesis of both bottom-up routes
// and its verification by collineation or similarity (thesis 4.4).
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/recognition/invariant_matching/object_collineation.h"
#include "server/vision/recognition/invariant_matching/scene_structure.h"

namespace horopter {

struct SupportOptions {
  int rounds = 3;  // of matching and refinement
  RefineTransformOptions refine;
  // Half of the sets of four matched vertices and a matched edge must have the invariant of the
  // model's (thesis 4.2) within the angle, or the hypothesis goes.
  bool check_line_sets = false;
};

// An object in a structure. What makes it an answer, or not, are the images.
struct StructureHypothesis {
  int object = -1;  // index into the list of objects
  // Metres to the structure's frame: a collineation (unit norm, w > 0 on the object), or a
  // similarity where the structure is metric.
  Eigen::Matrix4d structure_from_object = Eigen::Matrix4d::Identity();
  std::vector<VertexMatch> vertices;
  std::vector<EdgeMatch> edges;
  double log_odds = 0.0;   // sum of the log-likelihood ratios of SupportOptions
  double rms_sigma = 0.0;  // of the matched vertices, per coordinate
  int component = -1;
  int votes = 0;  // tuples whose keys led to it
};

// What every judgement reads of a structure; it must outlive this.
struct StructureEvidence {
  const SceneStructure* structure = nullptr;
  std::vector<Eigen::Matrix3d> information;  // PointInformation
  std::vector<std::vector<bool>> joined;     // [point][point] by an edge
  std::vector<std::vector<int>> observations_of_line;
  std::vector<Eigen::Vector3d> line_middle;  // a point of the line between its observed ends
};
StructureEvidence GatherEvidence(const SceneStructure& structure);

// Every vertex's nearest free point among `points` within `reach` (structure units), vertices in
// turn; quick, not the best assignment. Empty when a vertex lies beyond the plane at infinity.
std::vector<VertexMatch> QuickVertexMatches(const SceneStructure& structure,
                                            std::span<const int> points,
                                            const ObjectShape& shape,
                                            const Eigen::Matrix4d& structure_from_shape,
                                            double reach);

// Distance of the mapped vertices from their middle, root mean square; infinite when one lies
// beyond the plane at infinity.
double MappedExtent(const ObjectShape& shape, const Eigen::Matrix4d& structure_from_shape);

// Whether most cameras see the object itself and not its mirror image: brought to the object's
// frame and with the object in front of them, P = [M | p] must have det M > 0. Needs no orientation
// of the structure's frame.
bool IsSeenUnmirrored(const SceneStructure& structure,
                      const ObjectShape& shape,
                      const Eigen::Matrix4d& structure_from_shape);

// Whether half and more of the sets of four matched vertices and a matched edge beside them have
// the invariant of the model's (FourPointsOneLine, thesis 4.2) within `tolerance_rad`; true without
// such sets. Needs no transformation, but correspondences.
bool LineSetsAgree(const SceneStructure& structure,
                   const ObjectShape& shape,
                   std::span<const VertexMatch> vertices,
                   std::span<const EdgeMatch> edges,
                   double tolerance_rad);

// Matches vertices and edges, refines the transformation on them, and sums up what speaks for it.
// log_odds is negative infinity when fewer vertices match than determine the transformation and one
// more, or when it mirrors the object or takes it through the plane at infinity, or its line sets
// do not agree where that is asked for.
StructureHypothesis JudgeTransform(TransformGroup group,
                                   const StructureEvidence& evidence,
                                   const ObjectShape& shape,
                                   const Eigen::Matrix4d& structure_from_shape,
                                   const SupportOptions& options = {});

}  // namespace horopter
