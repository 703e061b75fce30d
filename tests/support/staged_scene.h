// Scenes drawn by lot for rendered_scene.h: tables, lights, parts that stand on the table, and rigs
// of cameras around it. The same seed gives the same scene.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "server/vision/recognition/object/prepared_object.h"
#include "tests/support/random.h"
#include "tests/support/rendered_scene.h"

namespace horopter {

enum class TableKind { kBlank, kMottled, kStriped, kSpeckled };
inline constexpr int kTableKinds = 4;
std::string NameOf(TableKind kind);

// Reflectance of a metre of table. contrast: deviation over mean of its pattern.
PaintedTable MakeTable(TableKind kind, double contrast, Random* random);

// A part as it can be put onto a table.
struct StageablePart {
  int id = 0;
  RenderMesh mesh;
  double diameter_m = 0.0;
  std::vector<StablePose> poses;  // in which it stands surely
};

// Errors: those of ExactRenderMesh, INVALID_ARGUMENT (it stands in no pose).
absl::StatusOr<StageablePart> MakeStageable(int id, const TriangleMesh& mesh, double diameter_m);

// Middle of the parts' diameters: scenes and rigs are laid out by it.
double MedianDiameter(std::span<const StageablePart> parts);

struct StagedPart {
  int part = 0;  // index into the stageable ones
  Rigid3 world_from_object;
};

// So many different parts, each in a pose that it stands in, turned at will, none touching another.
// Fewer where there is no room.
std::vector<StagedPart> StandParts(std::span<const StageablePart> parts, int count, Random* random);

// A lamp with a border to its shadows and light from all around.
std::vector<LightSource> MakeLights(Random* random);

// Parts that stand, in colours of their own, on a table in this light.
PaintedScene PaintScene(std::span<const StageablePart> parts,
                        std::span<const StagedPart> standing,
                        PaintedTable table,
                        std::vector<LightSource> lights,
                        Random* random);

struct StagedRig {
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> camera_from_world;
};

struct RigOptions {
  int cameras = 4;
  int width = 640;
  int height = 480;
  double scene_m = 0.25;  // across, of what the cameras look at: two and a half parts
  double most_k1 = 0.06;  // k1 is between minus this and nothing
};

// Cameras on an arc above the table, 15 - 35 degrees from one to the next: focal lengths 1.1 - 1.9
// widths, principal points off by 1 % of the width, turned about their axes by up to 10 degrees.
StagedRig MakeRig(const RigOptions& options, Random* random);

// Exposure, white balance, blur and noise of a camera at a scene.
CameraLook MakeLook(Random* random);

}  // namespace horopter
