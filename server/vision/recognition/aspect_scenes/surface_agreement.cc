#include "server/vision/recognition/aspect_scenes/surface_agreement.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "server/base/rounded.h"
#include "server/base/stop_scope.h"
#include "server/vision/recognition/aspect_scenes/standing_planes.h"

namespace horopter {
namespace {

constexpr int kLeastPlaces = 150;  // that two views share; fewer say nothing
constexpr int kMuchShown = 2;      // times these
constexpr int kStepPx = 2;         // working pixels between the places looked at; chosen, for time
constexpr int kPlaces = 2000;      // of a view, about which are looked at quickly; chosen, for time
constexpr double kHiddenM = 0.003;   // by which what hides a place is nearer
constexpr double kAround = 0.6;      // of the part's size: how far about it the plane is looked at
constexpr double kLeastSlope = 0.1;  // cosine between plane normal and ray; flatter says little
// Of a view with the others, and by which the middle view has more. Views with wrong cameras had
// -0.38 - 0.16; so had right ones (0.05, 0.16) before what other parts hide was left out. Commit
// 38de6ec.
constexpr double kOddView = 0.25;
// Grey levels of noise, which no correlation is asked to explain.
constexpr double kGreyNoise = 3.0, kDetailNoise = 1.0;
// Grey levels a surface must differ by (deviation) in one of two views; else it is plain.
constexpr double kContrast = 6.0;

class CorrelationSums {
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
float InverseDepthOf(const ObjectLayer& layer, int x, int y) {
  return layer.Has(x, y) ? layer.inverse_depth[layer.Cell(x, y)] : 0.0f;
}

struct Looked {
  std::vector<std::uint8_t> AspectImage::*map;
  bool on_object;   // else beside it
  double around;    // of the part's box, that is looked at as well
  double noise;     // grey levels
  double contrast;  // least
};

enum class Speed { kFull, kQuick };

// What v shows against what w shows of the same places; `place`: the point of v's camera frame that
// a working pixel (x, y) of camera `here` shows, or nothing. Nothing where they say nothing.
template <typename Place>
std::optional<double> CorrelateOneWay(const SeenObject& v,
                                      const SeenObject& w,
                                      const Looked& looked,
                                      Speed speed,
                                      const Place& place) {
  const auto is_looked_at = [&](const SeenObject& s) {
    return s.layer->width > 0 && s.image->width > 1 && s.image->height > 1 &&
           !(s.image->*looked.map).empty();
  };
  if (!is_looked_at(v) || !is_looked_at(w)) return std::nullopt;
  const ObjectLayer& layer = *v.layer;
  const AspectImage& image = *w.image;
  const PinholeCamera here = WorkingCamera(*v.image, v.camera);
  const PinholeCamera there = WorkingCamera(image, w.camera);
  const Rigid3 there_from_here = w.camera_from_scene * v.camera_from_scene.Inverse();
  const int margin = static_cast<int>(looked.around * std::max(layer.width, layer.height));
  const int x1 = std::min(v.image->width, layer.x0 + layer.width + margin);
  const int y1 = std::min(v.image->height, layer.y0 + layer.height + margin);
  const int x0 = std::max(0, layer.x0 - margin), y0 = std::max(0, layer.y0 - margin);
  int step = kStepPx;
  if (speed == Speed::kQuick) {
    const double area = std::max(0, x1 - x0) * static_cast<double>(std::max(0, y1 - y0));
    step = std::max(step, static_cast<int>(std::sqrt(area / kPlaces)));
  }
  const int least = kLeastPlaces * kStepPx * kStepPx / (step * step);
  CorrelationSums sums;
  int shown = 0;
  for (int y = y0; y < y1; y += step) {
    LeaveIfStopped();
    for (int x = x0; x < x1; x += step) {
      const std::optional<Eigen::Vector3d> at = place(v, here, x, y);
      if (!at) continue;
      ++shown;
      const Eigen::Vector3d seen = there_from_here * *at;
      if (seen.z() <= 0) continue;
      const Eigen::Vector2d u = Project(there, seen);
      if (!(u.x() >= 0 && u.y() >= 0 && u.x() <= image.width - 1 && u.y() <= image.height - 1))
        continue;
      const float front = InverseDepthOf(*w.layer, Rounded(u.x()), Rounded(u.y()));
      if (looked.on_object ? front <= 0 || 1.0 / front < seen.z() - kHiddenM : front > 0) continue;
      sums.Add((v.image->*looked.map)[v.image->Cell(x, y)],
               Sample(image, image.*looked.map, u.x(), u.y()));
    }
  }
  // Views that show much of the part, but hardly a place of it in common, do not agree.
  const bool shared = sums.places() >= least;
  if (shared ? sums.Contrast() < looked.contrast : shown < kMuchShown * least) return std::nullopt;
  return shared ? sums.Correlation(looked.noise) : 0.0;
}

std::optional<double> SurfaceOneWay(const SeenObject& v, const SeenObject& w, Speed speed) {
  const Looked looked{&AspectImage::grey, true, 0.0, kGreyNoise, kContrast};
  const auto place = [](const SeenObject& s, const PinholeCamera& camera, int x, int y) {
    const float inverse = InverseDepthOf(*s.layer, x, y);
    std::optional<Eigen::Vector3d> out;
    if (inverse > 0) out = NormalizedPoint(camera, Eigen::Vector2d(x, y)).homogeneous() / inverse;
    return out;
  };
  return CorrelateOneWay(v, w, looked, speed, place);
}

std::optional<double> PlaneOneWay(const SeenObject& v,
                                  const SeenObject& w,
                                  const SupportingPlane& plane,
                                  Speed speed) {
  const Looked looked{&AspectImage::detail, false, kAround, kDetailNoise, 0.0};
  const Eigen::Vector3d normal = v.camera_from_scene.R * plane.normal;
  const double offset = plane.offset_m + normal.dot(v.camera_from_scene.t);
  const auto place = [&](const SeenObject& s,
                         const PinholeCamera& camera,
                         int x,
                         int y) -> std::optional<Eigen::Vector3d> {
    if (InverseDepthOf(*s.layer, x, y) > 0) return std::nullopt;
    const Eigen::Vector3d ray = NormalizedPoint(camera, Eigen::Vector2d(x, y)).homogeneous();
    const double falls = normal.dot(ray);
    if (offset * falls <= 0.0 || std::abs(falls) < kLeastSlope * ray.norm()) return std::nullopt;
    return Eigen::Vector3d(offset / falls * ray);
  };
  return CorrelateOneWay(v, w, looked, speed, place);
}

// Mean of both ways.
std::optional<double> BothWays(std::optional<double> a, std::optional<double> b) {
  if (a && b) return (*a + *b) / 2;
  return a ? a : b;
}

// Of all pairs of views; `one_way` of two of them.
template <typename OneWay>
Correlations Correlate(std::span<const AspectImage> images,
                       const std::vector<std::optional<AspectSceneView>>& views,
                       std::span<const ObjectLayer> layers,
                       const OneWay& one_way) {
  Correlations out;
  out.views.resize(views.size());
  std::vector<double> sum(views.size(), 0.0);
  std::vector<int> count(views.size(), 0);
  const auto seen = [&](std::size_t v) {
    return SeenObject{&images[v], views[v]->camera, views[v]->camera_from_scene, &layers[v]};
  };
  for (std::size_t v = 0; v < views.size(); ++v) {
    for (std::size_t w = 0; w < views.size(); ++w) {
      if (w == v || !views[v] || !views[w]) continue;
      const std::optional<double> correlation = one_way(seen(v), seen(w));
      if (!correlation) continue;
      for (const std::size_t i : {v, w}) {
        sum[i] += *correlation;
        ++count[i];
      }
      out.mean += *correlation;
      ++out.pairs;
    }
  }
  if (out.pairs > 0) out.mean /= out.pairs;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (count[v] > 0) out.views[v] = sum[v] / count[v];
  }
  return out;
}

Correlations OfPlane(std::span<const AspectImage> images,
                     const std::vector<std::optional<AspectSceneView>>& views,
                     std::span<const ObjectLayer> layers,
                     const SupportingPlane& plane,
                     Speed speed) {
  return Correlate(images, views, layers, [&](const SeenObject& v, const SeenObject& w) {
    return PlaneOneWay(v, w, plane, speed);
  });
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

std::optional<double> SurfaceCorrelation(const SeenObject& a, const SeenObject& b) {
  return BothWays(SurfaceOneWay(a, b, Speed::kQuick), SurfaceOneWay(b, a, Speed::kQuick));
}

std::optional<double> PlaneCorrelation(const SeenObject& a,
                                       const SeenObject& b,
                                       const SupportingPlane& plane) {
  return BothWays(PlaneOneWay(a, b, plane, Speed::kQuick), PlaneOneWay(b, a, plane, Speed::kQuick));
}

Correlations SurfaceCorrelations(std::span<const AspectImage> images,
                                 const std::vector<std::optional<AspectSceneView>>& views,
                                 std::span<const ObjectLayer> layers) {
  return Correlate(images, views, layers, [](const SeenObject& v, const SeenObject& w) {
    return SurfaceOneWay(v, w, Speed::kFull);
  });
}

Correlations PlaneCorrelations(std::span<const AspectImage> images,
                               const std::vector<std::optional<AspectSceneView>>& views,
                               std::span<const ObjectLayer> layers,
                               const SupportingPlane& plane) {
  return OfPlane(images, views, layers, plane, Speed::kFull);
}

std::vector<ObjectLayer> LayersInViews(std::span<const AspectImage> images,
                                       const std::vector<std::optional<AspectSceneView>>& views,
                                       const RenderMesh& mesh,
                                       const Rigid3& scene_from_object,
                                       double render_px) {
  std::vector<ObjectLayer> out(views.size());
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    out[v] = MakeObjectLayer(images[v],
                             mesh,
                             views[v]->camera,
                             views[v]->camera_from_scene * scene_from_object,
                             render_px);
  }
  return out;
}

void HideBehind(const ObjectLayer& nearer, ObjectLayer* layer) {
  const int x1 = std::min(layer->x0 + layer->width, nearer.x0 + nearer.width);
  const int y1 = std::min(layer->y0 + layer->height, nearer.y0 + nearer.height);
  for (int y = std::max(layer->y0, nearer.y0); y < y1; ++y) {
    for (int x = std::max(layer->x0, nearer.x0); x < x1; ++x) {
      float& inverse = layer->inverse_depth[layer->Cell(x, y)];
      if (nearer.inverse_depth[nearer.Cell(x, y)] > inverse) inverse = 0.0f;
    }
  }
}

double TextureAround(std::span<const AspectImage> images,
                     const std::vector<std::optional<AspectSceneView>>& views,
                     std::span<const ObjectLayer> layers) {
  std::optional<double> least;
  for (std::size_t v = 0; v < views.size(); ++v) {
    const AspectImage& image = images[v];
    const ObjectLayer& layer = layers[v];
    if (!views[v] || layer.width <= 0 || image.detail.empty()) continue;
    const int margin = static_cast<int>(kAround * std::max(layer.width, layer.height));
    const int x1 = std::min(image.width, layer.x0 + layer.width + margin);
    const int y1 = std::min(image.height, layer.y0 + layer.height + margin);
    double n = 0.0, sum = 0.0, squares = 0.0;
    for (int y = std::max(0, layer.y0 - margin); y < y1; y += kStepPx) {
      for (int x = std::max(0, layer.x0 - margin); x < x1; x += kStepPx) {
        if (InverseDepthOf(layer, x, y) > 0) continue;
        const double detail = image.detail[image.Cell(x, y)];
        n += 1.0;
        sum += detail;
        squares += detail * detail;
      }
    }
    if (n < kLeastPlaces) continue;
    const double deviation = std::sqrt(std::max(0.0, squares / n - sum / n * (sum / n)));
    least = std::min(least.value_or(deviation), deviation);
  }
  return least.value_or(0.0);
}

double GroundAgreement(std::span<const AspectImage> images,
                       const std::vector<std::optional<AspectSceneView>>& views,
                       std::span<const ObjectLayer> layers,
                       std::span<const RestingFace> resting,
                       const Rigid3& scene_from_object) {
  const auto agreement = [&](const SupportingPlane& plane, Speed speed) {
    return Least(OfPlane(images, views, layers, plane, speed), views);
  };
  // Few places tell which face it rests on.
  std::optional<SupportingPlane> under;
  double best = 0.0;
  for (const RestingFace& face : resting) {
    const SupportingPlane plane = PlaneUnder(scene_from_object, face);
    if (!IsBelow(plane, views)) continue;
    const double quick = agreement(plane, Speed::kQuick);
    if (quick <= best) continue;
    best = quick;
    under = plane;
  }
  return under ? agreement(*under, Speed::kFull) : 0.0;
}

}  // namespace horopter
