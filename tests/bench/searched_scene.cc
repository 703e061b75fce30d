#include "tests/bench/searched_scene.h"

#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/vision/matching/ground_motion.h"

namespace horopter {
namespace {

bool ReadHypotheses(const std::string& path, std::vector<AspectHypothesis>* out) {
  std::ifstream in(path);
  std::size_t n = 0;
  if (!(in >> n)) return false;
  out->resize(n);
  for (AspectHypothesis& h : *out) {
    in >> h.object >> h.camera.width >> h.camera.height >> h.camera.focal_px >> h.camera.cx >>
        h.camera.cy >> h.camera.k1;
    for (int k = 0; k < 9; ++k) in >> h.camera_from_object.R(k / 3, k % 3);
    for (int k = 0; k < 3; ++k) in >> h.camera_from_object.t(k);
    in >> h.precision >> h.recall >> h.support_px >> h.score;
  }
  return static_cast<bool>(in);
}

void WriteHypotheses(const std::string& path, const std::vector<AspectHypothesis>& list) {
  std::ofstream out(path);
  out.precision(12);
  out << list.size() << "\n";
  for (const AspectHypothesis& h : list) {
    out << h.object << " " << h.camera.width << " " << h.camera.height << " " << h.camera.focal_px
        << " " << h.camera.cx << " " << h.camera.cy << " " << h.camera.k1;
    for (int k = 0; k < 9; ++k) out << " " << h.camera_from_object.R(k / 3, k % 3);
    for (int k = 0; k < 3; ++k) out << " " << h.camera_from_object.t(k);
    out << " " << h.precision << " " << h.recall << " " << h.support_px << " " << h.score << "\n";
  }
}

std::vector<AspectImage> ImagesOf(const SceneSearchOptions& options, const BopScene& scene) {
  std::vector<cv::Mat> images;
  for (const BopImage& view : scene.images)
    images.push_back(cv::imread(view.path, cv::IMREAD_COLOR));
  PlaneInViews ground(images.size());
  MatchingOptions matching;
  matching.threads = options.threads;
  if (options.on_ground) ground = FindGround(images, matching);
  return MakeAspectImagesOnGround(images, ground, options.image, options.threads);
}

}  // namespace

SearchedScene SearchImages(const SceneSearchOptions& options,
                           const AspectCatalog& catalog,
                           BopScene scene) {
  SearchedScene out{std::move(scene), {}, {}, {}};
  if (options.max_images > 0 && out.scene.images.size() > options.max_images)
    out.scene.images.resize(options.max_images);
  out.images = ImagesOf(options, out.scene);
  for (std::size_t v = 0; v < out.images.size(); ++v) {
    const BopImage& view = out.scene.images[v];
    out.priors.push_back({NominalCamera(out.images[v]), kNominalFocalLogSigma});
    const std::string file =
        absl::StrFormat("%s/%d_%d.txt", options.hypotheses, out.scene.scene_id, view.im_id);
    std::vector<AspectHypothesis> found;
    if (options.hypotheses.empty() || !ReadHypotheses(file, &found)) {
      FindAspectOptions find;
      find.threads = options.threads;
      find.votes.threads = options.threads;
      found = FindAspectHypotheses(out.images[v], catalog.index, find).hypotheses;
      if (!options.hypotheses.empty()) WriteHypotheses(file, found);
    }
    out.hypotheses.push_back(std::move(found));
  }
  return out;
}

}  // namespace horopter
