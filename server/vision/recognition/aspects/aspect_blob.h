// A part's decimated mesh and aspects as bytes, stored with the derived data.
//
// Byte layout, little-endian, no padding:
//    0  4  magic "HASP"
//    4  2  version, kAspectVersion
//    6  2  zero
//    8  8  fingerprint of the model's geometry and symmetries and of the options
//   16  8  checksum of everything behind it
//   24     mesh, then aspects (aspect_blob.cc)
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/recognition/aspects/aspect_set.h"
#include "server/vision/recognition/aspects/render_mesh.h"

namespace horopter {

// To be raised with every change of what MakeRenderMesh, FindVisibleEdges or MakeAspects compute or
// of how it is written: stored blobs of another version are recomputed.
inline constexpr int kAspectVersion = 1;

// What recognition by aspects knows about a part.
struct ObjectAspects {
  RenderMesh mesh;
  AspectSet aspects;
};

struct ObjectAspectOptions {
  RenderMeshOptions mesh;
  AspectOptions aspects;
};

// From the mesh, diameter and symmetries of a model. Errors: as MakeRenderMesh.
absl::StatusOr<ObjectAspects> MakeObjectAspects(const ObjectModel& model,
                                                const ObjectAspectOptions& options = {});

std::string EncodeObjectAspects(const ObjectAspects& object,
                                const ObjectModel& model,
                                const ObjectAspectOptions& options = {});

// What MakeObjectAspects(model, options) returns, bit for bit. Errors: FAILED_PRECONDITION (another
// version, geometry or options), DATA_LOSS (damaged).
absl::StatusOr<ObjectAspects> DecodeObjectAspects(std::string_view blob,
                                                  const ObjectModel& model,
                                                  const ObjectAspectOptions& options = {});

}  // namespace horopter
