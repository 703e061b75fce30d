// Where a chain's curvature has the shape of a corner or of a join of line and arc (thesis 2.3).
#pragma once

#include <span>
#include <vector>

#include "absl/status/status.h"

namespace horopter {

// Shapes of thesis figure 2.6, as we read them: kPeak is 0 over L1, a triangle over L2, 0 over L3
// (two lines meet); kStepUp is 0 over L1, rises over L2, 1 over L3 (a line runs into an arc, or an
// arc into a tighter one); kStepDown is its mirror image.
enum class TemplateShape { kPeak, kStepUp, kStepDown };

// Lengths in chain points.
struct CurvatureTemplate {
  TemplateShape shape = TemplateShape::kPeak;
  int before = 0;  // L1
  int middle = 0;  // L2: about the window of the curvature
  int after = 0;   // L3

  int Length() const { return before + middle + after; }
};

// Two parametrisations of each shape, for curvature of half-width 5: short ones for features close
// together, long ones that hear weaker steps.
std::vector<CurvatureTemplate> DefaultTemplates();

struct TemplateSplittingOptions {
  std::vector<CurvatureTemplate> templates = DefaultTemplates();
  double threshold = 0.5;  // of the correlation; higher: fewer cuts
  // Curvature (1/px) that noise gives: it counts as part of the signal that no template explains,
  // so that the correlation of a shape no higher than it stays low. 0: the plain normalised
  // correlation, which cuts straight edges wherever their noise has one of the shapes.
  double noise_curvature = 0.014;
  int suppression = 8;  // points on both sides of a cut in which there is no other
};

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
