#include "server/pipeline/finer_images.h"

#include <algorithm>
#include <limits>

#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

constexpr int kFinerWidthPx = 1280;
constexpr double kFinerSizeShare = 0.25;
constexpr double kRoom = 2.0;       // sizes of the largest object found in a box; chosen
constexpr double kMostFiner = 1.4;  // images larger by less show no smaller parts; chosen
// Working px of the first look: of parts of 55 - 70 px its single images list 13 of 36 (small-dev),
// of larger ones 145 of 194 (ADR 61).
constexpr double kSmallPx = 100.0;
constexpr double kMostArea = 0.35;             // of an image in windows, for time; chosen
constexpr double kSameWindow = 0.6;            // of a window that others hold
constexpr double kAttentiveEnlargement = 2.0;  // of windows; larger: smaller parts, slower
// Objects. Large parts are found less well in more pixels: of the photographs of prague one of two
// parts is lost where all that is more is taken.
constexpr double kMoreRight = 0.5;

// Size (working px of the first look) of the smallest object where the answer's stand.
double SmallestPx(std::span<const std::shared_ptr<const PreparedObject>> objects,
                  const RecognitionResult& answer,
                  int width_px) {
  double smallest_m = std::numeric_limits<double>::infinity(), farthest = 0.0;
  for (const auto& o : objects)
    smallest_m = std::min<double>(smallest_m, o->aspects->object.mesh.diameter_m);
  for (const auto& view : answer.views) {
    for (const SceneObject& o : answer.objects) {
      if (!view) continue;
      const double depth = (view->camera_from_scene * o.scene_from_object.t).z();
      farthest = std::max(farthest, depth * view->camera.width / view->camera.focal_px);
    }
  }
  return width_px * smallest_m / farthest;
}

// Size (px of its image) of the answer's largest object in a view.
double LargestPx(std::span<const std::shared_ptr<const PreparedObject>> objects,
                 const RecognitionResult& answer,
                 std::size_t v) {
  double largest = 0.0;
  if (v >= answer.views.size() || !answer.views[v]) return largest;
  const auto& view = *answer.views[v];
  for (const SceneObject& o : answer.objects) {
    const double depth = (view.camera_from_scene * o.scene_from_object.t).z();
    largest = std::max(largest,
                       view.camera.focal_px * objects[o.object]->aspects->object.mesh.diameter_m /
                           std::max(depth, 1e-6));
  }
  return largest;
}

// Longest side (px) of the boxes.
double LongestSide(const SearchedPart& part) {
  double longest = 0.0;
  for (const ImageBox& box : part.boxes) longest = std::max(longest, box.sizes().maxCoeff());
  return longest;
}

}  // namespace

AspectRecognitionOptions FinerOptions() {
  AspectRecognitionOptions options;
  options.images.max_width_px = kFinerWidthPx;
  options.find.votes.max_size_share = kFinerSizeShare;
  return options;
}

bool MayShowMore(std::span<const cv::Mat> images,
                 std::span<const std::optional<SearchedPart>> searched,
                 std::span<const std::shared_ptr<const PreparedObject>> objects,
                 const RecognitionResult& answer) {
  const int width_px = AspectImageOptions().max_width_px;
  bool larger = false, room = false;
  for (std::size_t i = 0; i < images.size(); ++i) {
    const bool whole = searched.empty() || !searched[i];
    const double longest_px = whole ? images[i].cols : LongestSide(*searched[i]);
    // Smaller boxes have been enlarged by the first look.
    larger = larger || (images[i].cols > kMostFiner * width_px &&
                        longest_px > kFinerSizeShare * images[i].cols);
    // A carrier, not one part's place.
    room = room || (!whole && longest_px > kRoom * LargestPx(objects, answer, i));
  }
  const bool complete = !answer.objects.empty() && answer.registered() == std::ssize(images);
  return larger && (room || !complete || SmallestPx(objects, answer, width_px) < kSmallPx);
}

Attention Attend(std::span<const cv::Mat> images,
                 std::span<const std::vector<ImageBox>> things,
                 std::span<const OffPlaneGroup> standing_off) {
  Attention out;
  for (std::size_t v = 0; v < images.size(); ++v) {
    SearchedPart& part = out.parts.emplace_back().emplace();
    part.most_enlarged = kAttentiveEnlargement;
    double area = 0.0;
    const auto add = [&](const ImageBox& box) {
      const double share = box.volume() / (1.0 * images[v].cols * images[v].rows);
      const bool room = area + share <= kMostArea && std::ssize(part.boxes) < kMostWindows;
      if (!room || ShareInBoxes(box, part.boxes) > kSameWindow) return false;
      part.boxes.push_back(box);
      area += share;
      ++out.windows;
      return true;
    };
    for (const OffPlaneGroup& group : standing_off) {
      if (v < group.images.size() && group.images[v] &&
          group.images[v]->sizes().maxCoeff() < kMostWindowSide * images[v].cols)
        out.standing_off += add(*group.images[v]);
    }
    for (const ImageBox& box : things[v]) add(box);
    out.share += area / static_cast<double>(images.size());
  }
  return out;
}

bool ShowMore(const RecognitionResult& finer, const RecognitionResult& answer) {
  return ExpectedRight(finer) >= ExpectedRight(answer) + kMoreRight;
}

}  // namespace horopter
