// Where parts are looked for, from the command line or a dataset.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/bop_dataset.h"
#include "horopter/v1/recognition.pb.h"

namespace horopter {

struct RegionArguments {
  std::vector<std::string> boxes;  // IMAGE:X,Y,WIDTH,HEIGHT, images from 1, pixels
  // Ten numbers each: x y z (metres) qw qx qy qz of base_from_region and its size, metres.
  std::vector<double> space_boxes;
};

// Adds the regions to a request whose images are there. What lies where is for the server to say.
// Errors: INVALID_ARGUMENT (a word of another form, an image that is not there, numbers that are
// not ten each, a quaternion whose norm is not 1).
absl::Status AddRegions(const RegionArguments& arguments, v1::RecognizeSceneRequest* request);

// Which true boxes of a dataset a request may tell: of the visible part of each instance, or one
// that holds them all. They measure what regions can give, not what a robot knows.
enum class TrueRegions { kNone, kParts, kAll };
inline const std::map<std::string, TrueRegions> kTrueRegions = {
    {"none", TrueRegions::kNone}, {"parts", TrueRegions::kParts}, {"all", TrueRegions::kAll}};

// Of the instances that have a visible box in scene_gt_info.json, grown on every side by `margin`
// of their longer side. An image of which none is known is searched whole.
void AddTrueRegions(TrueRegions regions, double margin, const BopImage& image, v1::SceneImage* out);

}  // namespace horopter
