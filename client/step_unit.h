// The length unit of a STEP file.
#pragma once

#include <string>

#include "client/step_text.h"

namespace horopter {

struct StepUnit {
  std::string word;     // as the file calls it, in small letters; empty: the file names none
  double metres = 0.0;  // by its factor, whatever it is called
  bool mixed = false;   // other representations have other units
};

// Of the shape representations, the first one's.
StepUnit LengthUnitOf(const StepText& step);

}  // namespace horopter
