// Variants of the methods, those of the thesis among them, that an operator may choose for one
// request. The defaults are what recognition does best with (tests/bench/results.md).
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "server/pipeline/pipeline.h"

namespace horopter {

// "NAME=VALUE[,NAME=VALUE...]", nothing twice:
//   detector       linked_field | edge_drawing (EDLines on five channels)
//   splitting      chords | curvature_threshold | curvature_templates (thesis 2.3)
//   conic_fit      rim | orthogonal (thesis 2.4)
//   line_sets      off | verify (thesis 4.2), of the projective and the metric route
//   association    cyclic_order | axes (thesis 4.4), of the projective route
//   decomposition  none | per_object | common | metric | images (thesis 5.3), of that route
//   ground         followed | unused: the plane under parts that gave the cameras
//   cameras        texture | parts: whether cameras of the images' texture are looked for
//   lens           terms | k1: lenses may have k2 and tangential coefficients
//   effort         any | 2 | 4 | 6 | 8: in searches of an image, of the whole request
//   routes         default | all | metric | projective | aspects: these last ones alone
// and on | off of single mechanisms of recognition, to measure what each is worth:
//   pairs, ellipses           of edges, that propose poses in the first search of an image
//   smoothing                 of noisy images
//   smooth_figures, coloured_figures, patterns, dot_patterns    what tells background from parts
//   printed_surfaces                                            what links views
//   doubtful_views                                              second looks into images
//   standing, faint_parts                                       parts that no single image shows
//   competing_parts, half_turns                                 what an answer is held against
// Errors: INVALID_ARGUMENT, says what is not known and what is; the options are then as they were.
absl::Status ApplyVariants(std::string_view variants, PipelineOptions* options);

// Every NAME=VALUE there is, in the order above.
std::vector<std::string> AllVariants();

}  // namespace horopter
