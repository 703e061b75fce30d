// Edges of a textured ground told by how they move: from view to view they go where the supporting
// plane's homographies take them, and what stands on it does not.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

// A view whose ground is linked to that of the view asked for.
struct GroundView {
  const AspectImage* image = nullptr;                             // with its edges and maps
  Eigen::Matrix3d there_from_here = Eigen::Matrix3d::Identity();  // working px of both
};

struct PlaneEdges {
  // For each edge whether it is of the ground's texture; empty where the ground has none that is
  // dense.
  std::vector<std::uint8_t> marked;
  double room_px = 0.0;  // beside the middle one: radius of discs without others that touch it
};

PlaneEdges FindPlaneEdges(const AspectImage& here,
                          std::span<const GroundView> others,
                          const PlaneEdgeOptions& options = {});

// Where an image alone tells the texture of its ground, by its blocks (AspectImage::Block): of the
// edges that move with the ground, in the smallest window about the block that has enough of them,
// texture took at least this share. As a whole: of all of them.
struct ToldAlone {
  bool as_a_whole = false;
  std::vector<std::uint8_t> blocks;
};

// `marked`: flags of the edges of `here`; `alone`: the same image without its texture.
ToldAlone FindToldAlone(const AspectImage& here,
                        const std::vector<std::uint8_t>& marked,
                        const AspectImage& alone,
                        double share);

// AspectImage::ground of an image with these edges of its ground.
std::vector<std::uint8_t> GroundCells(const AspectImage& here, const PlaneEdges& edges);

}  // namespace horopter
