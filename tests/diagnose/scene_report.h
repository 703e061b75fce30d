// The stage report of one scene and its means over tiers, as table and JSON.
#pragma once

#include <map>
#include <optional>
#include <ostream>
#include <string>
#include <vector>

namespace horopter {

struct ObjectFate {
  int obj_id = 0;
  int instance = 0;  // in the order of scene_gt.json
  bool hypothesised = false;
  bool verified = false;
  bool final = false;
  std::string
      lost_at;  // features, matching, reconstruction, hypothesis, verification, consolidation, none
  double edge_recall = 0.0;                  // of this instance
  std::optional<double> best_hypothesis_px;  // smallest error of a hypothesis of this object
  std::optional<double> best_verified_px;
  std::optional<double> final_px;
};

// A figure that could not be measured is absent (null in JSON).
struct SceneReport {
  int scene_id = 0;
  std::string tier;
  std::map<std::string, double> figures;  // by JSON name; booleans as 0 / 1
  std::vector<ObjectFate> objects;
  std::vector<std::string> notes;  // refusals and states, in the stages' own words
};

// The names that are always written, in table order.
const std::vector<std::string>& FigureNames();

void PrintTable(const std::vector<SceneReport>& scenes, std::ostream& out);
std::string ToJson(const std::vector<SceneReport>& scenes);

}  // namespace horopter
