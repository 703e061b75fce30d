// What the straightness of edges says about the lens, against a data set's ground truth:
//   straightness_report DATASET SPLIT [--each]
// Every image of the split on its own, with the true focal length and the image's centre as
// principal point. Ground truth is used for these and for the comparison only.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "client/bop_dataset.h"
#include "server/vision/features/features.h"
#include "tests/bench/straightness.h"

namespace horopter {
namespace {

struct Tally {
  int images = 0, refused = 0;
  double z_square = 0.0;
  std::vector<double> errors, sigmas, truths;
};

double Median(std::vector<double> values) {
  if (values.empty()) return std::nan("");
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

int Run(const std::string& folder, const std::string& split, bool verbose) {
  const auto scenes = ListBopScenes(folder, split);
  if (!scenes.ok()) {
    std::fprintf(stderr, "%s\n", std::string(scenes.status().message()).c_str());
    return 1;
  }
  std::map<std::string, Tally> tiers;
  for (int id : *scenes) {
    const auto scene = ReadBopScene(folder, split, id);
    if (!scene.ok()) continue;
    for (const BopImage& view : scene->images) {
      const cv::Mat image = cv::imread(view.path, cv::IMREAD_COLOR);
      if (image.empty()) continue;
      const auto features = DetectFeatures(image, {});
      if (!features.ok()) continue;
      Tally& tally = tiers[scene->tier];
      ++tally.images;
      const PinholeCamera camera = CenteredCamera(image.cols, image.rows, view.camera.focal_px);
      const auto estimate = EstimateRadialDistortion(features->chains, camera, {});
      if (!estimate.ok()) {
        ++tally.refused;
        if (verbose) {
          std::printf("%d/%d true %.4f: %s\n",
                      scene->scene_id,
                      view.im_id,
                      view.camera.k1,
                      std::string(estimate.status().message()).c_str());
        }
        continue;
      }
      const double error = estimate->k1 - view.camera.k1;
      tally.errors.push_back(std::abs(error));
      tally.sigmas.push_back(estimate->k1_sigma);
      tally.truths.push_back(std::abs(view.camera.k1));
      tally.z_square += error * error / (estimate->k1_sigma * estimate->k1_sigma);
      if (verbose) {
        std::printf("%d/%d true %.4f: %.4f +- %.4f, %d of %d pieces, without the best +- %.4f\n",
                    scene->scene_id,
                    view.im_id,
                    view.camera.k1,
                    estimate->k1,
                    estimate->k1_sigma,
                    estimate->lines,
                    estimate->candidates,
                    estimate->k1_sigma_without_best);
      }
    }
  }
  std::printf(
      "| tier | images | refused | median error | median if k1 = 0 | median sigma | rms z |\n");
  std::printf("|---|---|---|---|---|---|---|\n");
  for (const auto& [tier, t] : tiers) {
    std::printf("| %s | %d | %d | %.4f | %.4f | %.4f | %.2f |\n",
                tier.c_str(),
                t.images,
                t.refused,
                Median(t.errors),
                Median(t.truths),
                Median(t.sigmas),
                std::sqrt(t.z_square / static_cast<double>(t.errors.size())));
  }
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  if (argc != 3 && !(argc == 4 && std::string(argv[3]) == "--each")) {
    std::fprintf(stderr, "usage: straightness_report DATASET SPLIT [--each]\n");
    return 2;
  }
  return horopter::Run(argv[1], argv[2], argc == 4);
}
