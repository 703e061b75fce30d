#include "tests/diagnose/feature_json.h"

#include <nlohmann/json.hpp>

namespace horopter {
namespace {

using nlohmann::json;

template <typename Vector>
json Array(const Vector& v) {
  json out = json::array();
  for (int k = 0; k < v.size(); ++k) out.push_back(v[k]);
  return out;
}

json Covariance(const Eigen::Matrix2d& c) {
  return json::array({c(0, 0), c(0, 1), c(1, 1)});
}

json ToJson(const Segment& s) {
  return {{"start", Array(s.start)},
          {"end", Array(s.end)},
          {"contrast", s.contrast},
          {"rms_px", s.rms_px},
          {"offset_sigma_px", s.offset_sigma_px},
          {"angle_sigma_rad", s.angle_sigma_rad},
          {"channel", s.channel},
          {"left_bgr", Array(s.left_bgr)},
          {"right_bgr", Array(s.right_bgr)},
          {"in_texture", s.in_texture},
          {"arc", s.arc}};
}

json ToJson(const EllipseArc& a) {
  return {{"center", Array(a.center)},
          {"semi_major_px", a.semi_major_px},
          {"semi_minor_px", a.semi_minor_px},
          {"angle_rad", a.angle_rad},
          {"start_rad", a.start_rad},
          {"sweep_rad", a.sweep_rad},
          {"rms_px", a.rms_px}};
}

json ToJson(const Junction& j) {
  json ends = json::array();
  for (const Junction::End& end : j.ends) {
    ends.push_back({{"segment", end.segment},
                    {"at",
                     end.interior   ? "interior"
                     : end.at_start ? "start"
                                    : "end"}});
  }
  return {{"point", Array(j.point)},
          {"type", NameOf(j.type)},
          {"covariance", Covariance(j.covariance)},
          {"ends", ends}};
}

json ToJson(const ConicJunction& j) {
  return {{"point", Array(j.point)},
          {"segment", j.segment},
          {"at", j.at_start ? "start" : "end"},
          {"arc", j.arc},
          {"angle_rad", j.angle_rad},
          {"at_arc_end", j.at_arc_end},
          {"tangent", j.tangent},
          {"covariance", Covariance(j.covariance)}};
}

template <typename Item>
json List(const std::vector<Item>& items) {
  json out = json::array();
  for (const Item& item : items) out.push_back(ToJson(item));
  return out;
}

std::string NodeName(const FeatureGraph& graph, uint32_t node) {
  static const char* const kNames[] = {"segment", "arc", "junction", "conic_junction"};
  return std::string(kNames[static_cast<int>(graph.KindOf(node))]) + ":" +
         std::to_string(graph.IndexOf(node));
}

}  // namespace

std::string FeaturesToJson(const ImageFeatures& features, const FeatureGraph& graph) {
  json edges = json::array();
  for (uint32_t node = 0; node < static_cast<uint32_t>(graph.NodeCount()); ++node) {
    for (const GraphEdge& edge : graph.EdgesOf(node)) {
      if (edge.node < node) continue;
      edges.push_back({{"from", NodeName(graph, node)},
                       {"to", NodeName(graph, edge.node)},
                       {"relation", NameOf(edge.relation)},
                       {"value", edge.value}});
    }
  }
  const json out = {{"width", features.width},
                    {"height", features.height},
                    {"segments", List(features.segments)},
                    {"arcs", List(features.arcs)},
                    {"junctions", List(features.junctions)},
                    {"conic_junctions", List(features.conic_junctions)},
                    {"edges", edges},
                    {"counts", features.counts}};
  return out.dump();
}

}  // namespace horopter
