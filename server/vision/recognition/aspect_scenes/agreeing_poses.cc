#include "server/vision/recognition/aspect_scenes/agreeing_poses.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_scenes/standing_planes.h"

namespace horopter {
namespace {

// The agreement of each pose of a view with each pose of another one: over the surface, then over
// the ground under each resting face.
struct PairTable {
  std::size_t v = 0, w = 0;  // views
  std::size_t columns = 0;   // poses of w
  std::vector<std::vector<double>> values = {};

  double At(std::size_t kind, int a, int b) const {
    return values[kind][static_cast<std::size_t>(a) * columns + static_cast<std::size_t>(b)];
  }
};

bool IsAbove(const SeenObject& seen, const SupportingPlane& plane) {
  return IsBelow(plane, {AspectSceneView{seen.camera, seen.camera_from_scene}});
}

class Chooser {
 public:
  Chooser(std::span<const AspectImage> images,
          std::span<const PinholeCamera> cameras,
          const RenderMesh& mesh,
          std::span<const RestingFace> resting,
          std::span<const std::vector<AllowedPose>> allowed,
          const AgreeingPosesOptions& options)
      : options_(options), count_(allowed.size()) {
    for (std::size_t v = 0; v < allowed.size(); ++v) {
      if (allowed[v].empty()) continue;
      views_.push_back(v);
      lists_.push_back(allowed[v]);
    }
    for (const RestingFace& face : resting) planes_.push_back(PlaneUnder({}, face));
    layers_.resize(views_.size());
    seen_.resize(views_.size());
    ParallelFor(static_cast<int>(views_.size()), options.threads, [&](int i) {
      const std::size_t v = views_[i];
      for (const AllowedPose& pose : lists_[i])
        layers_[i].push_back(MakeObjectLayer(
            images[v], mesh, cameras[v], pose.camera_from_object, options.render_px));
      for (std::size_t a = 0; a < lists_[i].size(); ++a)
        seen_[i].push_back(
            {&images[v], cameras[v], lists_[i][a].camera_from_object, &layers_[i][a]});
    });
    for (std::size_t i = 0; i < views_.size(); ++i) {
      for (std::size_t j = i + 1; j < views_.size(); ++j) tables_.push_back({i, j});
    }
    ParallelFor(
        static_cast<int>(tables_.size()), options.threads, [&](int t) { Fill(&tables_[t]); });
  }

  ChosenPoses First() const { return Rated(std::vector<int>(views_.size(), 0)); }

  // View by view, the best choices so far are continued by each pose of the next.
  ChosenPoses Best() const {
    std::vector<std::vector<int>> beam = {{}};
    for (std::size_t i = 0; i < views_.size(); ++i) {
      std::vector<std::pair<double, std::vector<int>>> longer;
      for (const std::vector<int>& chosen : beam) {
        for (std::size_t a = 0; a < lists_[i].size(); ++a) {
          std::vector<int> more = chosen;
          more.push_back(static_cast<int>(a));
          longer.emplace_back(Worth(Rated(more)), std::move(more));
        }
      }
      std::stable_sort(longer.begin(), longer.end(), [](const auto& a, const auto& b) {
        return a.first > b.first;
      });
      if (longer.size() > static_cast<std::size_t>(options_.beam)) longer.resize(options_.beam);
      beam.clear();
      for (auto& [worth, chosen] : longer) beam.push_back(std::move(chosen));
    }
    ChosenPoses best = First();
    ChosenPoses found = Rated(beam.front());
    return Worth(found) > Worth(best) ? found : best;
  }

 private:
  void Fill(PairTable* table) const {
    const auto& of_v = seen_[table->v];
    const auto& of_w = seen_[table->w];
    table->columns = of_w.size();
    table->values.assign(1 + planes_.size(), std::vector<double>(of_v.size() * of_w.size(), 0.0));
    for (std::size_t a = 0; a < of_v.size(); ++a) {
      for (std::size_t b = 0; b < of_w.size(); ++b) {
        const std::size_t cell = a * of_w.size() + b;
        if (options_.surface_tells)
          table->values[0][cell] = SurfaceCorrelation(of_v[a], of_w[b]).value_or(0.0);
        for (std::size_t p = 0; p < planes_.size(); ++p) {
          if (!IsAbove(of_v[a], planes_[p]) || !IsAbove(of_w[b], planes_[p])) continue;
          table->values[1 + p][cell] = PlaneCorrelation(of_v[a], of_w[b], planes_[p]).value_or(0.0);
        }
      }
    }
  }

  static double Worth(const ChosenPoses& c) { return c.Agreement() + c.score; }

  // Of the views chosen for.
  double Agreement(std::size_t kind, const std::vector<int>& chosen) const {
    double sum = 0.0;
    int pairs = 0;
    for (const PairTable& t : tables_) {
      if (t.w >= chosen.size()) continue;
      sum += t.At(kind, chosen[t.v], chosen[t.w]);
      ++pairs;
    }
    return pairs > 0 ? sum / pairs : 0.0;
  }

  // `chosen`: of the first views.
  ChosenPoses Rated(const std::vector<int>& chosen) const {
    ChosenPoses out;
    out.poses.assign(count_, -1);
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      out.poses[views_[i]] = chosen[i];
      out.score +=
          lists_[i][static_cast<std::size_t>(chosen[i])].score / static_cast<double>(chosen.size());
    }
    out.surface = Agreement(0, chosen);
    for (std::size_t p = 0; p < planes_.size(); ++p)
      out.ground = std::max(out.ground, Agreement(1 + p, chosen));
    return out;
  }

  const AgreeingPosesOptions& options_;
  const std::size_t count_;
  std::vector<std::size_t> views_;                   // that have poses
  std::vector<std::span<const AllowedPose>> lists_;  // of these
  std::vector<SupportingPlane> planes_;              // object frame
  std::vector<std::vector<ObjectLayer>> layers_;
  std::vector<std::vector<SeenObject>> seen_;
  std::vector<PairTable> tables_;
};

}  // namespace

AgreeingPoses FindAgreeingPoses(std::span<const AspectImage> images,
                                std::span<const PinholeCamera> cameras,
                                const RenderMesh& mesh,
                                std::span<const RestingFace> resting,
                                std::span<const std::vector<AllowedPose>> allowed,
                                const AgreeingPosesOptions& options) {
  const Chooser chooser(images, cameras, mesh, resting, allowed, options);
  return {chooser.First(), chooser.Best()};
}

}  // namespace horopter
