// Which found features are images of the same CAD edge or corner.
#pragma once

#include <vector>

#include "server/vision/features/features.h"
#include "tests/diagnose/ground_truth.h"

namespace horopter {

// (instance, edge) or (instance, vertex) as one number; kUnknown: of no known part.
using FeatureLabel = int;
constexpr FeatureLabel kUnknownFeature = -1;
// Index into BopImage::instances of a known label.
int InstanceOf(FeatureLabel label);

struct FeatureLabels {
  std::vector<FeatureLabel> segments;
  std::vector<FeatureLabel> junctions;
};

// A segment carries the label of the straight edge that passes within 2 px and 5 degrees of at
// least 70 % of it; a junction that of the nearest corner within kCornerPx.
FeatureLabels LabelFeatures(const ImageFeatures& features, const TrueView& truth);

}  // namespace horopter
