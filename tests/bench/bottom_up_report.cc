// The bottom-up routes on synthetic scenes with known truth: how often the right object is the best
// hypothesis about a part, and what that takes.
//
//   bottom_up_report [--scenes N] [--first SEED] [--objects N] [--route projective|metric]
//                    [--sigma PX] [--sets N --keys N --balance X] [--tuples N] [--axes]
//                    [--verbose]
//     --sets, --keys, --balance   six-tuples of each object: ObjectKeyOptions
//     --tuples          six-tuples of each component: SixTupleOptions
//     --axes            the thesis's association by axes
//
// Scenes: 3 different parts of the catalog (tests/support/profile_parts.h), 6 views, a fifth of the
// observations missing, a quarter of the vertices never seen, a fifth as many points of clutter.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <ctime>
#include <set>

#include "server/vision/recognition/invariant_matching/metric_route.h"
#include "server/vision/recognition/invariant_matching/projective_route.h"
#include "server/vision/reconstruction/self_calibration.h"
#include "tests/support/profile_parts.h"

namespace horopter {
namespace {

struct Arguments {
  int scenes = 6, first = 1, objects = 100, hits = 0;
  std::string route = "projective";
  double sigma_px = 0.5;
  ObjectKeyOptions keys;
  SixTupleOptions tuples;
  ComponentOptions components = ProjectiveRouteOptions().route.components;
  bool axes = false, verbose = false;
};

struct Catalog {
  std::vector<ObjectModel> models;
  std::vector<ObjectKeys> keys;
  std::vector<StructureObject> objects;
  KeyIndexSnapshot index;
};

Catalog MakeCatalog(const Arguments& arguments) {
  Catalog out;
  for (int i = 0; i < arguments.objects; ++i) {
    out.models.push_back(ProfilePart(static_cast<unsigned>(i) + 1));
    out.keys.push_back(ComputeObjectKeys(out.models.back(), arguments.keys));
  }
  std::vector<const ObjectKeys*> keys;
  for (int i = 0; i < arguments.objects; ++i) {
    keys.push_back(&out.keys[i]);
    out.objects.push_back({&out.models[i], &out.keys[i], i});
  }
  auto index = KeyIndex::Build(keys, 1);
  if (index.ok()) out.index = index->Snapshot();
  return out;
}

struct Sums {
  int reconstructed = 0, parts = 0, keyed = 0, best = 0, listed = 0;
  double cpu_s = 0.0, hits = 0.0;
  int met = 0;  // parts of which a tuple asked for is one the catalog keeps
};

// How many of the tuples that are asked for lie on one part and are among those that the catalog
// keeps of it, by part: the rest can hit nothing right.
std::vector<int> TuplesMet(const Arguments& arguments,
                           const Catalog& catalog,
                           const ProfileScene& truth,
                           const SceneStructure& structure) {
  std::vector<int> met(truth.objects.size(), 0);
  std::vector<std::set<std::vector<int>>> kept(truth.objects.size());
  for (std::size_t part = 0; part < kept.size(); ++part) {
    for (const SixVertexKey& key : catalog.keys[truth.objects[part]].six_points) {
      std::vector<int> vertices(key.vertices.begin(), key.vertices.end());
      std::sort(vertices.begin(), vertices.end());
      kept[part].insert(vertices);
    }
  }
  for (const std::vector<int>& component : StructureComponents(structure, arguments.components)) {
    for (const SixTuple& tuple : ChooseSixTuples(structure,
                                                 component,
                                                 catalog.index.Transform(KeyTable::kSixPoints),
                                                 arguments.tuples)) {
      std::vector<int> vertices;
      std::set<int> parts;
      for (const int i : tuple.points) {
        vertices.push_back(truth.vertex_of_point[structure.point_track[i]]);
        parts.insert(truth.part_of_point[structure.point_track[i]]);
      }
      std::sort(vertices.begin(), vertices.end());
      if (parts.size() != 1 || *parts.begin() < 0) continue;
      met[*parts.begin()] += kept[*parts.begin()].count(vertices) > 0;
    }
  }
  return met;
}

// Points of a component by the parts they lie on, what lies on none last.
void PrintPoints(const ProfileScene& truth,
                 const SceneStructure& structure,
                 const std::vector<int>& component) {
  std::vector<int> points(truth.objects.size() + 1, 0);
  for (const int i : component) {
    const int part = truth.part_of_point[structure.point_track[i]];
    ++points[part < 0 ? truth.objects.size() : part];
  }
  std::printf(" ");
  for (std::size_t part = 0; part < points.size(); ++part)
    std::printf("%s%d", part == 0 ? "" : "+", points[part]);
}

double CpuSeconds() {
  return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

void Count(const Arguments& arguments,
           const Catalog& catalog,
           const ProfileScene& truth,
           const SceneStructure& structure,
           const StructureRouteResult& found,
           Sums* sums) {
  for (int part = 0; part < static_cast<int>(truth.objects.size()); ++part) {
    const StructureHypothesis *best = nullptr, *right = nullptr, *wrong = nullptr;
    for (const StructureHypothesis& h : found.hypotheses) {
      int own = 0;
      for (const VertexMatch& m : h.vertices) {
        own += truth.part_of_point[structure.point_track[m.point]] == part;
      }
      if (2 * own < static_cast<int>(h.vertices.size())) continue;
      const bool same = h.object == truth.objects[part];
      if (best == nullptr) best = &h;
      if (same && right == nullptr) right = &h;
      if (!same && wrong == nullptr) wrong = &h;
    }
    ++sums->parts;
    const ObjectKeys& keys = catalog.keys[truth.objects[part]];
    sums->keyed += arguments.route == "metric" || !keys.six_points.empty();
    sums->best +=
        best != nullptr && best == right && (wrong == nullptr || wrong->log_odds < right->log_odds);
    sums->listed += right != nullptr;
    if (!arguments.verbose) continue;
    const ObjectModel& model = catalog.models[truth.objects[part]];
    std::printf(
        "  part %d: %s, %zu vertices, %zu six-tuples, right %.1f (%zu vertices, %zu edges, %d "
        "votes), "
        "wrong %.1f\n",
        part,
        model.id.c_str(),
        model.vertices.size(),
        keys.six_points.size(),
        right != nullptr ? right->log_odds : -1e9,
        right != nullptr ? right->vertices.size() : 0,
        right != nullptr ? right->edges.size() : 0,
        right != nullptr ? right->votes : 0,
        wrong != nullptr ? wrong->log_odds : -1e9);
  }
}

absl::Status RunScene(const Arguments& arguments,
                      const Catalog& catalog,
                      unsigned seed,
                      Sums* sums) {
  ProfileSceneOptions options;
  options.seed = seed;
  options.sigma_px = arguments.sigma_px;
  const ProfileScene truth = MakeProfileScene(catalog.models, options);
  const MultiviewTracks& tracks = truth.tracks.tracks;
  const auto scene = ReconstructTracks(tracks, {}, {}, {});
  if (!scene.ok()) return scene.status();
  const bool metric = arguments.route == "metric";
  if (metric ? scene->metric.outcome != MetricOutcome::kMetric
             : scene->projective.outcome != ProjectiveOutcome::kReconstructed) {
    return absl::FailedPreconditionError(metric ? scene->metric.reason : scene->projective.reason);
  }
  const auto structure = metric ? MetricStructure(tracks,
                                                  scene->projective.scene,
                                                  scene->metric.scene,
                                                  *scene->metric.covariance,
                                                  truth.edges)
                                : ProjectiveStructure(tracks, scene->projective.scene, truth.edges);
  if (!structure.ok()) return structure.status();
  ++sums->reconstructed;
  std::vector<int> met;
  if (!metric) met = TuplesMet(arguments, catalog, truth, *structure);
  for (const int m : met) sums->met += m > 0;
  const double start = CpuSeconds();
  StructureRouteResult found;
  if (metric) {
    MetricRouteOptions route;
    auto result = MetricHypotheses(*structure, catalog.index, catalog.objects, route);
    if (!result.ok()) return result.status();
    found = std::move(result->found);
  } else {
    ProjectiveRouteOptions route;
    route.tuples = arguments.tuples;
    route.route.components = arguments.components;
    if (arguments.hits > 0) route.route.max_hits = arguments.hits;
    if (arguments.axes) route.association = AssociationForm::kAxes;
    auto result = ProjectiveHypotheses(*structure, catalog.index, catalog.objects, route);
    if (!result.ok()) return result.status();
    found = *std::move(result);
  }
  sums->cpu_s += CpuSeconds() - start;
  sums->hits += found.counts["hits"];
  if (arguments.verbose) {
    std::printf("scene %u:", seed);
    for (const auto& [name, value] : found.counts) std::printf(" %s %.0f", name.c_str(), value);
    for (const int m : met) std::printf(" met %d", m);
    std::printf("\n  components, points of each part and clutter:");
    for (const std::vector<int>& component : StructureComponents(*structure, arguments.components))
      PrintPoints(truth, *structure, component);
    std::printf("\n");
  }
  Count(arguments, catalog, truth, *structure, found, sums);
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("The bottom-up routes of recognition on synthetic scenes");
  Arguments arguments;
  app.add_option("--scenes", arguments.scenes);
  app.add_option("--objects", arguments.objects);
  app.add_option("--route", arguments.route)->check(CLI::IsMember({"projective", "metric"}));
  app.add_option("--sigma", arguments.sigma_px);
  app.add_option("--unions", arguments.components.unions, "Pairs of components asked together");
  app.add_option("--first", arguments.first);
  app.add_option("--sets", arguments.keys.six_point_sets);
  app.add_option("--balance", arguments.keys.six_point_balance);
  app.add_option("--tuples", arguments.tuples.max_tuples);
  app.add_option("--looked", arguments.tuples.max_sets, "Six-tuples of a component looked at");
  app.add_option("--hits", arguments.hits, "Most hits of a component");
  app.add_option("--keys", arguments.keys.max_six_points);
  app.add_flag("--axes", arguments.axes);
  app.add_flag("--verbose", arguments.verbose);
  CLI11_PARSE(app, argc, argv);
  const Catalog catalog = MakeCatalog(arguments);
  Sums sums;
  for (int i = 0; i < arguments.scenes; ++i) {
    const int seed = arguments.first + i;
    const absl::Status status = RunScene(arguments, catalog, static_cast<unsigned>(seed), &sums);
    if (!status.ok()) std::printf("scene %d: %s\n", seed, std::string(status.message()).c_str());
    std::fflush(stdout);
  }
  const int n = std::max(1, sums.reconstructed);
  std::printf(
      "%s, %d objects, %.1f px: %d of %d scenes reconstructed; of %d parts (%d with keys) "
      "right object strictly best %d, among the hypotheses %d, tuples met %d; %.0f hits, %.2f CPU "
      "s a "
      "scene\n",
      arguments.route.c_str(),
      arguments.objects,
      arguments.sigma_px,
      sums.reconstructed,
      arguments.scenes,
      sums.parts,
      sums.keyed,
      sums.best,
      sums.listed,
      sums.met,
      sums.hits / n,
      sums.cpu_s / n);
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
