// A prepared object as the search for aspects knows it.
#pragma once

#include "server/vision/recognition/aspects/fragment_index.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

// object.aspects must not be null; the object outlives the part.
AspectModel AspectModelOf(const PreparedObject& object);

}  // namespace horopter
