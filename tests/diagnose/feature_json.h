// Features and their graph as JSON, for other programs and for looking at.
#pragma once

#include <string>

#include "server/vision/features/feature_graph.h"
#include "server/vision/features/features.h"

namespace horopter {

// {"width", "height", "segments": [{"start", "end", "contrast", "rms_px", "offset_sigma_px",
// "angle_sigma_rad", "channel", "left_bgr", "right_bgr", "in_texture", "arc"}], "arcs": [{"center",
// "semi_major_px", "semi_minor_px", "angle_rad", "start_rad", "sweep_rad", "rms_px"}], "junctions":
// [{"point", "type", "covariance": [xx, xy, yy], "ends": [{"segment", "at": "start" | "end" |
// "interior"}]}], "conic_junctions": [{"point", "segment", "at", "arc", "angle_rad", "at_arc_end",
// "tangent", "covariance"}], "edges": [{"from", "to", "relation", "value"}], "counts"}.
// Nodes are written as "segment:3", "arc:0", "junction:7", "conic_junction:1"; each edge once.
// Numbers that are not finite become null. Chains are left out.
std::string FeaturesToJson(const ImageFeatures& features, const FeatureGraph& graph);

}  // namespace horopter
