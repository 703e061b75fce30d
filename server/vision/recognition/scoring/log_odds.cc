#include "server/vision/recognition/scoring/log_odds.h"

#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

// Of the logistic regression of scenes: weights of what exceeds kChanceSupport.
constexpr double kSupportWeight = 20.0;
constexpr double kSharpnessWeight = 9.0;
// Weight of texture for an object among the log odds, by hand: 40 - 62 patches alike and few unlike
// on right printed parts in photographs, at most 34 with 24 unlike on wrong ones.
constexpr double kTextureFor = 1.6;
// Texture shows that faces lie about where the part has them, in cameras that may have adapted;
// that it is this part its edges must say. Less sharp than by chance by this much: it says nothing
// more.
constexpr double kBluntness = 0.1;
constexpr double kLearntCatalog = 20.0;  // objects in the catalog that it was learnt with

}  // namespace

double Logistic(double log_odds) {
  return 1.0 / (1.0 + std::exp(-log_odds));
}

double Evidence(double support, double sharpness) {
  return std::max(0.0,
                  kSupportWeight * (support - kChanceSupport) +
                      kSharpnessWeight * (sharpness - kChanceSupport));
}

double TextureLogOdds(double texture, double sharpness) {
  if (texture <= 0.0) return texture;
  return kTextureFor * texture *
         std::clamp(1.0 - (kChanceSupport - sharpness) / kBluntness, 0.0, 1.0);
}

double PriceOfTrying(std::size_t objects) {
  return std::max(0.0, std::log(static_cast<double>(objects) / kLearntCatalog));
}

}  // namespace horopter
