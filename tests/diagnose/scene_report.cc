#include "tests/diagnose/scene_report.h"

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <set>

#include "absl/strings/str_cat.h"

namespace horopter {
namespace {

using Json = nlohmann::ordered_json;

const std::set<std::string>& BooleanFigures() {
  static const std::set<std::string> names = {"cameras_model_free", "cameras_recovered"};
  return names;
}

std::map<std::string, std::vector<const SceneReport*>> ByTier(
    const std::vector<SceneReport>& scenes) {
  std::map<std::string, std::vector<const SceneReport*>> tiers;
  for (const SceneReport& scene : scenes) {
    tiers[scene.tier].push_back(&scene);
  }
  return tiers;
}

// Means over the scenes in which the figure was measured; objects as shares over all objects.
std::map<std::string, double> Means(const std::vector<const SceneReport*>& scenes) {
  std::map<std::string, double> sum, count;
  double objects = 0.0;
  for (const SceneReport* scene : scenes) {
    for (const auto& [name, value] : scene->figures) {
      sum[name] += value;
      count[name] += 1.0;
    }
    for (const ObjectFate& fate : scene->objects) {
      objects += 1.0;
      sum["hypothesised"] += fate.hypothesised;
      sum["verified"] += fate.verified;
      sum["final"] += fate.final;
      sum["lost_at_" + fate.lost_at] += 1.0;
    }
  }
  std::map<std::string, double> means;
  for (const auto& [name, value] : sum) {
    const bool of_objects = count.find(name) == count.end();
    means[name] = value / (of_objects ? objects : count[name]);
  }
  if (objects > 0.0) {
    means["objects"] = objects;
  }
  return means;
}

void PrintRow(const std::string& label,
              const std::map<std::string, double>& row,
              std::ostream& out) {
  char text[64];
  std::snprintf(text, sizeof text, "%-9s", label.c_str());
  out << text;
  for (const std::string& name : FigureNames()) {
    const auto it = row.find(name);
    if (it == row.end()) {
      std::snprintf(text, sizeof text, " %7s", "-");
    } else {
      std::snprintf(text, sizeof text, " %7.*f", it->second < 10.0 ? 3 : 1, it->second);
    }
    out << text;
  }
}

Json Optional(const std::optional<double>& value) {
  return value ? Json(*value) : Json(nullptr);
}

Json Figures(const std::map<std::string, double>& row, bool booleans) {
  Json out = Json::object();
  for (const std::string& name : FigureNames()) {
    out[name] = nullptr;
  }
  for (const auto& [name, value] : row) {
    if (booleans && BooleanFigures().count(name) > 0) {
      out[name] = value > 0.5;
    } else {
      out[name] = value;
    }
  }
  return out;
}

// Over the scenes that have the figure.
std::map<std::string, double> Medians(const std::vector<const SceneReport*>& scenes) {
  std::map<std::string, std::vector<double>> values;
  for (const SceneReport* scene : scenes) {
    for (const auto& [name, value] : scene->figures) values[name].push_back(value);
  }
  std::map<std::string, double> medians;
  for (auto& [name, list] : values) {
    std::sort(list.begin(), list.end());
    medians[name] = 0.5 * (list[(list.size() - 1) / 2] + list[list.size() / 2]);
  }
  return medians;
}

}  // namespace

const std::vector<std::string>& FigureNames() {
  static const std::vector<std::string> names = {"edge_recall",
                                                 "edge_fragments",
                                                 "junction_recall",
                                                 "junction_rms_px",
                                                 "arc_recall",
                                                 "segments",
                                                 "texture_share",
                                                 "texture_on_parts",
                                                 "match_precision",
                                                 "match_recall",
                                                 "match_tracked",
                                                 "cameras_model_free",
                                                 "cameras_recovered",
                                                 "focal_error",
                                                 "corner_error_mm",
                                                 "seconds"};
  return names;
}

void PrintTable(const std::vector<SceneReport>& scenes, std::ostream& out) {
  static const std::vector<std::string> heads = {"edges",
                                                 "frag",
                                                 "junct",
                                                 "rms-px",
                                                 "arcs",
                                                 "segs",
                                                 "textur",
                                                 "tex-on",
                                                 "m-prec",
                                                 "m-rec",
                                                 "m-trk",
                                                 "cam-mf",
                                                 "cam",
                                                 "f-err",
                                                 "mm",
                                                 "s"};
  out << "scene    ";
  for (const std::string& head : heads) {
    char text[32];
    std::snprintf(text, sizeof text, " %7s", head.c_str());
    out << text;
  }
  out << "   hyp/ver/fin of objects, lost at\n";
  for (const SceneReport& scene : scenes) {
    PrintRow(scene.tier + " " + std::to_string(scene.scene_id), scene.figures, out);
    int hypothesised = 0, verified = 0, final = 0;
    std::string lost;
    for (const ObjectFate& fate : scene.objects) {
      hypothesised += fate.hypothesised;
      verified += fate.verified;
      final += fate.final;
      if (fate.lost_at != "none") {
        absl::StrAppend(&lost, " ", fate.obj_id, ":", fate.lost_at);
      }
    }
    if (!scene.objects.empty()) {
      out << "   " << hypothesised << "/" << verified << "/" << final << " of "
          << scene.objects.size() << lost;
    }
    out << "\n";
    for (const std::string& note : scene.notes) {
      out << "            " << note << "\n";
    }
  }
  std::vector<const SceneReport*> all;
  for (const SceneReport& scene : scenes) {
    all.push_back(&scene);
  }
  auto tiers = ByTier(scenes);
  tiers["~ALL"] = all;  // sorts last
  for (const auto& [tier, members] : tiers) {
    const std::map<std::string, double> means = Means(members);
    PrintRow(tier == "~ALL" ? "ALL" : tier, means, out);
    if (means.count("final") > 0) {
      char text[128];
      std::snprintf(text,
                    sizeof text,
                    "   %.2f/%.2f/%.2f of %.0f",
                    means.at("hypothesised"),
                    means.at("verified"),
                    means.at("final"),
                    means.at("objects"));
      out << text;
    }
    out << "\n";
    PrintRow(" median", Medians(members), out);
    out << "\n";
  }
}

std::string ToJson(const std::vector<SceneReport>& scenes) {
  Json root;
  root["scenes"] = Json::object();
  std::vector<const SceneReport*> all;
  for (const SceneReport& scene : scenes) {
    all.push_back(&scene);
    Json entry = Json::object();
    entry["tier"] = scene.tier;
    entry.update(Figures(scene.figures, true));
    entry["objects"] = Json::array();
    for (const ObjectFate& fate : scene.objects) {
      entry["objects"].push_back({{"obj_id", fate.obj_id},
                                  {"instance", fate.instance},
                                  {"hypothesised", fate.hypothesised},
                                  {"verified", fate.verified},
                                  {"final", fate.final},
                                  {"lost_at", fate.lost_at},
                                  {"edge_recall", fate.edge_recall},
                                  {"best_hypothesis_px", Optional(fate.best_hypothesis_px)},
                                  {"best_verified_px", Optional(fate.best_verified_px)},
                                  {"final_px", Optional(fate.final_px)}});
    }
    entry["notes"] = scene.notes;
    root["scenes"][std::to_string(scene.scene_id)] = entry;
  }
  root["tiers"] = Json::object();
  for (const auto& [tier, members] : ByTier(scenes)) {
    root["tiers"][tier] = Figures(Means(members), false);
  }
  root["tiers"]["ALL"] = Figures(Means(all), false);
  return root.dump(1) + "\n";
}

}  // namespace horopter
