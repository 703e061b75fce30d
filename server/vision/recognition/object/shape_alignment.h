// How one part's shape lies best over another's: what may be taken for it.
#pragma once

#include <mutex>
#include <vector>

#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/render_mesh.h"

namespace horopter {

struct ShapeAlignment {
  Rigid3 a_from_b;
  double distance = 0.0;  // mean over both surfaces, in diameters of a
};

// Rigid motions that lay b over a, best first, at most `most`, each a different turn: from the
// turns that take one frame's axes to the other's and those of the principal axes, refined by
// closest points (Besl and McKay 1992). Empty where the extents along the principal axes differ by
// more than `max_extent_ratio`. Deterministic.
std::vector<ShapeAlignment> AlignShapes(const RenderMesh& a,
                                        const RenderMesh& b,
                                        int most,
                                        double max_extent_ratio = 1.3);

// The part's mirror image, through the plane x = centre of its bounding box.
RenderMesh MirrorImage(const RenderMesh& mesh);

// What a part's mirror image is to it.
struct MirrorTwin {
  bool chiral = false;                     // it is another part: no motion lays it over the part
  RenderMesh mesh;                         // of chiral parts
  std::vector<ShapeAlignment> alignments;  // of its mesh over the part's, of chiral parts
};

// `mesh` as `of_model` is drawn.
MirrorTwin MakeMirrorTwin(const TriangleMesh& of_model, double diameter_m, const RenderMesh& mesh);

// The same, made when it is first asked for. Thread-safe.
class LazyMirrorTwin {
 public:
  const MirrorTwin& Of(const TriangleMesh& of_model,
                       double diameter_m,
                       const RenderMesh& mesh) const {
    std::call_once(once_, [&] { twin_ = MakeMirrorTwin(of_model, diameter_m, mesh); });
    return twin_;
  }

 private:
  mutable std::once_flag once_;
  mutable MirrorTwin twin_;
};

}  // namespace horopter
