// Where a chain's curvature has the shape of a corner or of a join of line and arc (thesis 2.3).
#pragma once

#include <span>
#include <vector>

#include "absl/status/status.h"
#include "server/vision/features/feature_options.h"

namespace horopter {

// Errors: INVALID_ARGUMENT naming the field.
absl::Status Validate(const TemplateSplittingOptions& options);

// Normalised correlation of the curvature (signed, 1/px) with one template centred at each point,
// in [-1, 1]: mean removed from both. Negative: the shape with the other sign. Beyond the ends of
// an open chain the curvature is continued by its end values; a closed one wraps around.
std::vector<double> TemplateCorrelation(std::span<const double> curvature,
                                        bool closed,
                                        const CurvatureTemplate& shape,
                                        double noise_curvature);

// Points at which the largest |correlation| over all templates is above the threshold and no
// larger one lies within `suppression`, ascending. A step is no cut when a stronger peak lies under
// its template: that is the peak's flank. Costs points x templates x length.
std::vector<int> FindTemplateCuts(std::span<const double> curvature,
                                  bool closed,
                                  const TemplateSplittingOptions& options);

// The points whose value is above the threshold and above all values within `suppression` points,
// ascending; of equal ones the first. `reach`, where given, is one number per point: a point also
// gives way to an accepted one of reach 0 within its own reach.
std::vector<int> SuppressNonMaxima(std::span<const double> values,
                                   std::span<const int> reach,
                                   bool closed,
                                   double threshold,
                                   int suppression);

}  // namespace horopter
