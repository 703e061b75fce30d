#include "client/bop_targets.h"

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/bop_json.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

using Json = nlohmann::json;

// Numbers may be written as text.
int TargetIdOf(const Json& value) {
  if (value.is_string()) return std::stoi(value.get<std::string>());
  if (!value.is_number_integer()) throw std::runtime_error("an id that is no whole number");
  return value.get<int>();
}

const Json* TargetMember(const Json& object, std::initializer_list<const char*> names) {
  for (const char* name : names) {
    if (object.is_object() && object.contains(name)) return &object[name];
  }
  return nullptr;
}

std::string TextOf(const Json& value) {
  return value.is_string() ? value.get<std::string>() : value.dump();
}

struct Target {
  int scene_id = 0;
  std::set<int> im_ids;
  std::set<std::string> sensors;
  bool several = false;  // the images belong together
};

// One image: an id, or an object with the id and the sensor.
void AddView(const Json& view, Target* target) {
  const Json* id = TargetMember(view, {"im_id", "image_id", "id"});
  target->im_ids.insert(TargetIdOf(id == nullptr ? view : *id));
  if (const Json* sensor = TargetMember(view, {"sensor", "cam_id", "camera", "cam"}))
    target->sensors.insert(TextOf(*sensor));
}

Target TargetOf(const Json& entry) {
  Target target;
  const Json* scene = TargetMember(entry, {"scene_id"});
  if (scene == nullptr) throw std::runtime_error("without scene_id");
  target.scene_id = TargetIdOf(*scene);
  if (const Json* views =
          TargetMember(entry, {"im_ids", "image_ids", "view_ids", "views", "images"})) {
    if (!views->is_array() || views->empty())
      throw std::runtime_error("its images are no list, or none");
    target.several = true;
    for (const Json& view : *views) AddView(view, &target);
  } else if (const Json* view = TargetMember(entry, {"im_id", "image_id"})) {
    AddView(*view, &target);
  } else {
    throw std::runtime_error("with neither im_ids nor im_id");
  }
  if (const Json* sensor = TargetMember(entry, {"sensor", "cam_id", "camera", "cam"}))
    target.sensors.insert(TextOf(*sensor));
  return target;
}

}  // namespace

absl::StatusOr<std::vector<BopImageSet>> ReadBopTargets(const std::string& path) {
  HOROPTER_ASSIGN_OR_RETURN(const Json file, bop::ReadJson(path));
  if (!file.is_array()) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": not a list of targets"));
  }
  std::vector<BopImageSet> sets;
  std::map<int, size_t> of_single_images;  // scene -> its set
  std::set<std::pair<int, std::set<int>>> known;
  for (size_t i = 0; i < file.size(); ++i) {
    Target target;
    HOROPTER_RETURN_IF_ERROR(bop::Guarded(absl::StrCat(path, ": target ", i + 1), [&] {
      target = TargetOf(file[i]);
      return absl::OkStatus();
    }));
    const std::vector<std::string> sensors(target.sensors.begin(), target.sensors.end());
    if (target.several) {
      if (!known.emplace(target.scene_id, target.im_ids).second) continue;
      sets.push_back({target.scene_id, {target.im_ids.begin(), target.im_ids.end()}, sensors});
      continue;
    }
    const auto [at, is_new] = of_single_images.try_emplace(target.scene_id, sets.size());
    if (is_new) sets.push_back({target.scene_id, {}, sensors});
    std::vector<int>& ids = sets[at->second].im_ids;
    const int id = *target.im_ids.begin();
    const auto place = std::lower_bound(ids.begin(), ids.end(), id);
    if (place == ids.end() || *place != id) ids.insert(place, id);
  }
  return sets;
}

std::string MultiviewTargetsOf(const std::string& dataset, const std::string& split) {
  const auto file = [&](const std::string& name) {
    return absl::StrCat(dataset, "/", name, "_targets_multiview_bop25.json");
  };
  return bop::ExistingFile({file(split), file(split.substr(0, split.find('_')))});
}

}  // namespace horopter
