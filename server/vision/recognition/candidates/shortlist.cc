#include "server/vision/recognition/candidates/shortlist.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

constexpr double kChanceQuick = 0.25;  // settled quick score that clutter gives a pose

// Poses of an object that are looked at when it is ranked: the settling takes the best distinct of
// them, and telling hundreds apart costs more than refining three.
constexpr std::size_t kRankedPoses = 24;

}  // namespace

std::vector<PooledPose> PosesInSpace(const PreparedObject& object,
                                     std::span<const KnownView> views,
                                     std::span<const SpaceCorner> corners,
                                     std::span<const SpaceCircle> circles,
                                     const CornerSearchOptions& options) {
  std::vector<PooledPose> out = PosesFromCorners(object, views, corners, options);
  for (PooledPose& p : PosesFromCircles(object, views, circles, options))
    out.push_back(std::move(p));
  std::stable_sort(
      out.begin(), out.end(), [](const auto& x, const auto& y) { return x.quick > y.quick; });
  return out;
}

double Promise(const PreparedObject& object,
               std::span<const KnownView> views,
               const PooledPose& p) {
  double radius_px = 0.0;
  for (const KnownView& view : views) {
    const double depth = (view.camera_from_scene * (p.plane_from_object * object.center)).z();
    if (!(depth > object.radius_m)) return 0.0;
    radius_px += object.radius_m * view.camera.focal_px * view.maps->working_from_image / depth;
  }
  return (p.quick - kChanceQuick) *
         std::sqrt(radius_px / static_cast<double>(std::max<std::size_t>(1, views.size())));
}

std::vector<bool> PromisingInViews(const JointContext& context,
                                   const std::vector<std::vector<ImagePath>>& paths,
                                   const std::vector<bool>& wanted) {
  const ShortlistOptions& options = context.options.search.shortlist;
  if (std::count(wanted.begin(), wanted.end(), true) <= options.searched) return wanted;
  const int objects = static_cast<int>(wanted.size()), views = static_cast<int>(paths.size());
  ViewHypothesisOptions few = context.options.search.views;
  few.pool = kRankedPoses;
  few.refined = options.corners.settle.settled;
  few.verified = 0;
  few.turns = options.corners.turns;
  std::vector<double> best(static_cast<std::size_t>(views) * objects, 0.0);
  ParallelFor(views * objects, context.options.threads, [&](int i) {
    const int v = i / objects, k = i % objects;
    if (!wanted[k] || paths[v].empty()) return;
    const auto end =
        paths[v].begin() + std::min<std::ptrdiff_t>(options.paths_asked, std::ssize(paths[v]));
    ViewHypothesisOptions of_view = few;
    of_view.refine.focal_log_sigma = context.focal_log_sigma[v];
    const PreparedObject& object = *context.objects[k];
    for (const ViewHypothesis& h : FindViewHypotheses(object,
                                                      k,
                                                      context.views[v],
                                                      v,
                                                      {paths[v].begin(), end},
                                                      context.start_cameras[v],
                                                      of_view,
                                                      context.give_up)
                                       .pool) {
      const KnownView view{{h.camera, Rigid3{}}, &context.views[v].maps};
      best[i] =
          std::max(best[i], Promise(object, {&view, 1}, {h.camera_from_object, 1.0, h.score, 0.0}));
    }
  });
  std::vector<double> promise(objects, 0.0);
  for (std::size_t i = 0; i < best.size(); ++i) promise[i % objects] += best[i];
  std::vector<bool> out(objects, false);
  for (const int k : Largest(promise, options.searched)) out[k] = true;
  return out;
}

std::vector<int> Largest(std::span<const double> values, int most) {
  std::vector<int> order(values.size());
  std::iota(order.begin(), order.end(), 0);
  std::erase_if(order, [&](int i) { return !(values[i] > 0.0); });
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return values[a] > values[b]; });
  if (static_cast<int>(order.size()) > most) order.resize(most);
  return order;
}

Shortlist PromisingInSpace(std::span<const std::shared_ptr<const PreparedObject>> objects,
                           std::span<const KnownView> views,
                           std::span<const SpaceCorner> corners,
                           std::span<const SpaceCircle> circles,
                           const std::vector<bool>& among,
                           const ShortlistOptions& options,
                           int threads) {
  const int count = static_cast<int>(objects.size());
  const std::vector<bool> all(count, true), none(count, false);
  if (count <= options.searched) return {all, all};
  corners = corners.first(std::min<std::size_t>(corners.size(), options.corners_asked));
  circles = circles.first(std::min<std::size_t>(circles.size(), options.circles_asked));
  std::vector<std::vector<PooledPose>> poses(count);
  std::vector<double> quick(count, 0.0), promise(count, 0.0);
  ParallelFor(count, threads, [&](int k) {
    if (!among.empty() && !among[k]) return;
    poses[k] = PosesInSpace(*objects[k], views, corners, circles, options.corners);
    if (poses[k].size() > kRankedPoses) poses[k].resize(kRankedPoses);
    if (!poses[k].empty()) quick[k] = Promise(*objects[k], views, poses[k][0]);
  });
  const std::vector<int> refined = Largest(quick, options.refined);
  ParallelFor(static_cast<int>(refined.size()), threads, [&](int i) {
    const int k = refined[i];
    for (const PooledPose& p :
         SettledPoses(*objects[k], views, std::move(poses[k]), options.corners.settle))
      promise[k] = Promise(*objects[k], views, p);
  });
  Shortlist out{none, none};
  for (const int k : Largest(promise, options.searched)) out.searched[k] = true;
  for (const int k : refined) out.shortlist[k] = true;
  return out;
}

}  // namespace horopter
