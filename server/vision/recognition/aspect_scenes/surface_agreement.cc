#include "server/vision/recognition/aspect_scenes/surface_agreement.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "server/vision/recognition/aspect_scenes/standing_planes.h"

namespace horopter {
namespace {

constexpr int kLeastPlaces = 150;   // that two views share; fewer say nothing
constexpr int kMuchShown = 2;       // times these
constexpr int kStepPx = 2;          // working pixels between the places looked at; chosen, for time
constexpr double kHiddenM = 0.003;  // by which what hides a place is nearer
constexpr double kAround = 0.6;     // of the part's size: how far about it the plane is looked at
constexpr double kLeastSlope = 0.1;  // cosine between plane normal and ray; flatter says little
// Of a view with the others, and by which the middle view has more. Views with wrong cameras had
// -0.38 - 0.16; so had right ones (0.05, 0.16) before what other parts hide was left out.
constexpr double kOddView = 0.25;
// Grey levels of noise, which no correlation is asked to explain.
constexpr double kGreyNoise = 3.0, kDetailNoise = 1.0;
// Grey levels a surface must differ by (deviation) in one of two views; else it is plain.
constexpr double kContrast = 6.0;

class Sums {
 public:
  void Add(double a, double b) {
    ++n_;
    a_ += a;
    b_ += b;
    aa_ += a * a;
    bb_ += b * b;
    ab_ += a * b;
  }
  int places() const { return n_; }
  double Contrast() const { return std::sqrt(std::max(Variance(a_, aa_), Variance(b_, bb_))); }
  double Correlation(double noise) const {
    const double covariance = ab_ / n_ - a_ / n_ * (b_ / n_);
    return covariance /
           std::sqrt((Variance(a_, aa_) + noise * noise) * (Variance(b_, bb_) + noise * noise));
  }

 private:
  double Variance(double sum, double squares) const {
    return std::max(0.0, squares / n_ - sum / n_ * (sum / n_));
  }
  int n_ = 0;
  double a_ = 0.0, b_ = 0.0, aa_ = 0.0, bb_ = 0.0, ab_ = 0.0;
};

// Bilinear; the place lies inside.
double Sample(const AspectImage& image, const std::vector<std::uint8_t>& map, double x, double y) {
  const int x0 = std::clamp(static_cast<int>(x), 0, image.width - 2);
  const int y0 = std::clamp(static_cast<int>(y), 0, image.height - 2);
  const double fx = x - x0, fy = y - y0;
  const std::uint8_t* above = &map[image.Cell(x0, y0)];
  const std::uint8_t* below = above + image.width;
  return (1 - fy) * ((1 - fx) * above[0] + fx * above[1]) +
         fy * ((1 - fx) * below[0] + fx * below[1]);
}

// 1 / m; 0 where the part is not.
float InverseDepthOf(const PartLayer& layer, int x, int y) {
  return layer.Has(x, y) ? layer.inverse_depth[layer.Cell(x, y)] : 0.0f;
}

struct Looked {
  std::vector<std::uint8_t> AspectImage::*map;
  bool on_part;     // else beside it
  double around;    // of the part's box, that is looked at as well
  double noise;     // grey levels
  double contrast;  // least
};

// `place`: the point of view v's camera frame that pixel (x, y) shows, or nothing.
template <typename Place>
Correlations Correlate(std::span<const AspectImage> images,
                       const std::vector<std::optional<AspectSceneView>>& views,
                       std::span<const PartLayer> layers,
                       const Looked& looked,
                       const Place& place) {
  Correlations out;
  out.views.resize(views.size());
  std::vector<double> sum(views.size(), 0.0);
  std::vector<int> count(views.size(), 0);
  const auto is_looked_at = [&](std::size_t v) {
    return views[v] && layers[v].width > 0 && images[v].width > 1 && images[v].height > 1 &&
           !(images[v].*looked.map).empty();
  };
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!is_looked_at(v)) continue;
    const PartLayer& layer = layers[v];
    const PinholeCamera here = WorkingCamera(images[v], views[v]->camera);
    const int margin = static_cast<int>(looked.around * std::max(layer.width, layer.height));
    const int x1 = std::min(images[v].width, layer.x0 + layer.width + margin);
    const int y1 = std::min(images[v].height, layer.y0 + layer.height + margin);
    for (std::size_t w = 0; w < views.size(); ++w) {
      if (w == v || !is_looked_at(w)) continue;
      const AspectImage& image = images[w];
      const PinholeCamera there = WorkingCamera(image, views[w]->camera);
      const Rigid3 there_from_here =
          views[w]->camera_from_scene * views[v]->camera_from_scene.Inverse();
      Sums sums;
      int shown = 0;
      for (int y = std::max(0, layer.y0 - margin); y < y1; y += kStepPx) {
        for (int x = std::max(0, layer.x0 - margin); x < x1; x += kStepPx) {
          const std::optional<Eigen::Vector3d> at = place(v, here, x, y);
          if (!at) continue;
          ++shown;
          const Eigen::Vector3d seen = there_from_here * *at;
          if (seen.z() <= 0) continue;
          const Eigen::Vector2d u = Project(there, seen);
          if (!(u.x() >= 0 && u.y() >= 0 && u.x() <= image.width - 1 && u.y() <= image.height - 1))
            continue;
          const float front = InverseDepthOf(layers[w],
                                             static_cast<int>(std::lround(u.x())),
                                             static_cast<int>(std::lround(u.y())));
          if (looked.on_part ? front <= 0 || 1.0 / front < seen.z() - kHiddenM : front > 0)
            continue;
          sums.Add((images[v].*looked.map)[images[v].Cell(x, y)],
                   Sample(image, image.*looked.map, u.x(), u.y()));
        }
      }
      // Views that show much of the part, but hardly a place of it in common, do not agree.
      const bool shared = sums.places() >= kLeastPlaces;
      if (shared ? sums.Contrast() < looked.contrast : shown < kMuchShown * kLeastPlaces) continue;
      const double correlation = shared ? sums.Correlation(looked.noise) : 0.0;
      for (const std::size_t i : {v, w}) {
        sum[i] += correlation;
        ++count[i];
      }
      out.mean += correlation;
      ++out.pairs;
    }
  }
  if (out.pairs > 0) out.mean /= out.pairs;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (count[v] > 0) out.views[v] = sum[v] / count[v];
  }
  return out;
}

// 0 where a registered view has none.
double Least(const Correlations& correlations,
             const std::vector<std::optional<AspectSceneView>>& views) {
  double least = 1.0;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (views[v]) least = std::min(least, correlations.views[v].value_or(0.0));
  }
  return correlations.pairs > 0 ? std::max(0.0, least) : 0.0;
}

}  // namespace

bool ViewAgreement::IsOdd(int view) const {
  std::vector<double> all;
  for (const auto& correlation : surface.views) {
    if (correlation) all.push_back(*correlation);
  }
  if (all.size() < 3 || !surface.views[view] || *surface.views[view] >= kOddView) return false;
  const auto middle = all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2);
  std::nth_element(all.begin(), middle, all.end());
  return *surface.views[view] < *middle - kOddView;
}

Correlations SurfaceCorrelations(std::span<const AspectImage> images,
                                 const std::vector<std::optional<AspectSceneView>>& views,
                                 std::span<const PartLayer> layers) {
  const auto place = [&](std::size_t v,
                         const PinholeCamera& camera,
                         int x,
                         int y) -> std::optional<Eigen::Vector3d> {
    const float inverse = InverseDepthOf(layers[v], x, y);
    if (inverse <= 0) return std::nullopt;
    return NormalizedPoint(camera, Eigen::Vector2d(x, y)).homogeneous() / inverse;
  };
  const Looked looked{&AspectImage::grey, true, 0.0, kGreyNoise, kContrast};
  return Correlate(images, views, layers, looked, place);
}

Correlations PlaneCorrelations(std::span<const AspectImage> images,
                               const std::vector<std::optional<AspectSceneView>>& views,
                               std::span<const PartLayer> layers,
                               const SupportingPlane& plane) {
  const auto place = [&](std::size_t v,
                         const PinholeCamera& camera,
                         int x,
                         int y) -> std::optional<Eigen::Vector3d> {
    if (InverseDepthOf(layers[v], x, y) > 0) return std::nullopt;
    const Rigid3& pose = views[v]->camera_from_scene;
    const Eigen::Vector3d normal = pose.R * plane.normal;
    const double offset = plane.offset_m + normal.dot(pose.t);
    const Eigen::Vector3d ray = NormalizedPoint(camera, Eigen::Vector2d(x, y)).homogeneous();
    const double falls = normal.dot(ray);
    if (offset * falls <= 0.0 || std::abs(falls) < kLeastSlope * ray.norm()) return std::nullopt;
    return Eigen::Vector3d(offset / falls * ray);
  };
  const Looked looked{&AspectImage::detail, false, kAround, kDetailNoise, 0.0};
  return Correlate(images, views, layers, looked, place);
}

std::vector<PartLayer> LayersInViews(std::span<const AspectImage> images,
                                     const std::vector<std::optional<AspectSceneView>>& views,
                                     const RenderMesh& mesh,
                                     const Rigid3& scene_from_object,
                                     double render_px) {
  std::vector<PartLayer> out(views.size());
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    out[v] = MakePartLayer(images[v],
                           mesh,
                           views[v]->camera,
                           views[v]->camera_from_scene * scene_from_object,
                           render_px);
  }
  return out;
}

void HideBehind(const PartLayer& nearer, PartLayer* layer) {
  const int x1 = std::min(layer->x0 + layer->width, nearer.x0 + nearer.width);
  const int y1 = std::min(layer->y0 + layer->height, nearer.y0 + nearer.height);
  for (int y = std::max(layer->y0, nearer.y0); y < y1; ++y) {
    for (int x = std::max(layer->x0, nearer.x0); x < x1; ++x) {
      float& inverse = layer->inverse_depth[layer->Cell(x, y)];
      if (nearer.inverse_depth[nearer.Cell(x, y)] > inverse) inverse = 0.0f;
    }
  }
}

double GroundAgreement(std::span<const AspectImage> images,
                       const std::vector<std::optional<AspectSceneView>>& views,
                       std::span<const PartLayer> layers,
                       std::span<const RestingFace> resting,
                       const Rigid3& scene_from_object) {
  double best = 0.0;
  for (const RestingFace& face : resting) {
    const SupportingPlane plane = PlaneUnder(scene_from_object, face);
    if (!IsBelow(plane, views)) continue;
    best = std::max(best, Least(PlaneCorrelations(images, views, layers, plane), views));
  }
  return best;
}

}  // namespace horopter
