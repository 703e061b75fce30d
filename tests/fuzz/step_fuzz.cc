#include "client/step_model.h"
#include "client/step_tessellation.h"
#include "client/step_text.h"
#include "client/step_unit.h"
#include "tests/fuzz/check.h"

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, size_t size) {
  using namespace horopter;
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  Require(StepString(bytes).size() <= 2 * size);
  const auto step = StepText::Parse(bytes);
  if (!step.ok()) return 0;
  for (const int body : BodiesOf(*step)) Require(IsCleanUtf8(ProductNameOf(*step, body)));
  Require(IsCleanUtf8(RootProductName(*step)));
  Require(LengthUnitOf(*step).metres >= 0.0);
  HiddenBodiesOf(*step);
  MissingEntities(*step);
  ExternalFiles(*step);
  EmptyShapes(*step);
  TessellatedParts(*step);
  const auto mesh = TessellationOf(*step);
  if (mesh.ok()) Require(CheckCorners(*mesh).ok());
  return 0;
}
