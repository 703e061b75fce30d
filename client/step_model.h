// What a STEP file says of its parts beside their geometry: products, what is hidden, what
// is missing.
#pragma once

#include <set>
#include <string>
#include <vector>

#include "client/step_text.h"

namespace horopter {

// Entities of bodies: solids and surface models, of parts or of nothing at all; not the operands of
// other bodies.
std::vector<int> BodiesOf(const StepText& step);

// The name of the product whose shape a body is; empty where it has none, or only what a program
// calls everything. UTF-8, at most 100 bytes.
std::string ProductNameOf(const StepText& step, int body);

// Of the one product that is part of no other; empty where there are several.
std::string RootProductName(const StepText& step);

struct HiddenBodies {
  std::set<int> bodies;
  int single_places = 0;  // hidden in one place only: those are not told apart
};

// Of invisible styled items, layers and representations.
HiddenBodies HiddenBodiesOf(const StepText& step);

// Entities of shapes that name an entity which the file does not hold, as one sentence; empty:
// none.
std::string MissingEntities(const StepText& step);

// Representations of exact bodies that hold none of a known kind.
std::vector<int> EmptyShapes(const StepText& step);

// Names of the parts that have tessellated bodies alone.
std::vector<std::string> TessellatedParts(const StepText& step);

// Names of the files that hold the geometry of parts which have none here.
std::vector<std::string> ExternalFiles(const StepText& step);

}  // namespace horopter
