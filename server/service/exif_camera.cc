#include "server/service/exif_camera.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace horopter {
namespace {

constexpr double kFilmWidthMm = 36.0, kFilmDiagonalMm = 43.2666;
// The focal length engraved against that of a lens focused near by, and cut-outs by stabilisation.
constexpr double kLensLogSigma = 0.05;
// Known worse than this, a focal length is no help: see kNominalFocalLogSigma.
constexpr double kWorstLogSigma = 0.2;
// Nothing is said of the size that the camera stored: the image may be a cut-out.
constexpr double kNoSizeLogSigma = 0.1;
// Two tags that mean the same focal length and differ by more, as logarithms: one of them is wrong.
constexpr double kContradictionLog = 0.25;
// Shapes are the same within this share; sides are rounded to whole pixels.
constexpr double kSameShape = 0.01;
// In widths of the larger side: nobody's lens is outside.
constexpr double kLeastFocalWidths = 0.3, kMostFocalWidths = 30.0;
constexpr std::array<double, 6> kSensorShapes = {
    4.0 / 3, 3.0 / 2, 16.0 / 9, 5.0 / 4, 1.0, 16.0 / 10};

// An interval of equally likely values of a logarithm.
struct Interval {
  double least = 0.0, most = 0.0;
  double Middle() const { return 0.5 * (least + most); }
  double Variance() const { return (most - least) * (most - least) / 12.0; }
};

// Sides in pixels, the larger first.
struct Sides {
  double larger = 0.0, smaller = 0.0;
  double Shape() const { return larger / smaller; }
};

Sides SidesOf(double width, double height) {
  return {std::max(width, height), std::min(width, height)};
}

bool IsPlausible(double focal_px, const Sides& stored) {
  return focal_px >= kLeastFocalWidths * stored.larger &&
         focal_px <= kMostFocalWidths * stored.larger;
}

// ln of the focal length in pixels of the stored image, by the equivalent on film.
std::optional<Interval> ByEquivalent(const Exif& exif, const Sides& stored) {
  if (!exif.focal_35mm) return std::nullopt;
  const double whole_4_3 = 5.0 * std::max(stored.larger / 4.0, stored.smaller / 3.0);
  std::array<double, 3> per_mm = {std::hypot(stored.larger, stored.smaller) / kFilmDiagonalMm,
                                  stored.larger / kFilmWidthMm,
                                  whole_4_3 / kFilmDiagonalMm};
  if (std::abs(std::log(stored.Shape() / 1.5)) < kSameShape) per_mm[2] = per_mm[0];
  const auto [least, most] = std::minmax_element(per_mm.begin(), per_mm.end());
  // Written in whole millimetres.
  const double half_mm = std::min(0.5, 0.5 * *exif.focal_35mm);
  Interval f{std::log(*least * (*exif.focal_35mm - half_mm)),
             std::log(*most * (*exif.focal_35mm + half_mm))};
  // Some count a digital zoom in, others do not.
  if (exif.digital_zoom) f.most += std::log(*exif.digital_zoom);
  if (!IsPlausible(std::exp(f.Middle()), stored)) return std::nullopt;
  return f;
}

// The same by the focal length in millimetres and the pixels of the sensor.
std::optional<Interval> BySensor(const Exif& exif, const Sides& stored) {
  if (!exif.focal_mm || !exif.pixels_per_mm) return std::nullopt;
  const double f = *exif.focal_mm * *exif.pixels_per_mm;
  if (!IsPlausible(f, stored)) return std::nullopt;
  Interval out{std::log(f), std::log(f)};
  if (exif.digital_zoom) out.most += std::log(*exif.digital_zoom);
  return out;
}

std::optional<Interval> LogFocal(const Exif& exif, const Sides& stored) {
  const std::optional<Interval> equivalent = ByEquivalent(exif, stored),
                                sensor = BySensor(exif, stored);
  if (!equivalent || !sensor) return equivalent ? equivalent : sensor;
  if (std::abs(equivalent->Middle() - sensor->Middle()) > kContradictionLog) return std::nullopt;
  return sensor;  // of the pixels themselves, whatever the maker's convention
}

}  // namespace

ExifCamera CameraFromExif(const Exif& exif, int width, int height, bool cropped) {
  ExifCamera out;
  const Sides image = SidesOf(width, height);
  const bool sized = exif.width_px > 0 && exif.height_px > 0;
  const Sides stored =
      sized ? SidesOf(static_cast<double>(exif.width_px), static_cast<double>(exif.height_px))
            : image;
  const double along = std::log(image.larger / stored.larger),
               across = std::log(image.smaller / stored.smaller);
  const bool same_shape =
      std::abs(along - across) < kSameShape + 1.0 / image.smaller + 1.0 / stored.smaller;
  // Pixels of the image to those stored: as large as the cut-out of the whole at least, and as
  // they were at most.
  Interval scale{std::max(along, across), std::max(along, across)};
  if (!same_shape || cropped) scale.most = std::max(0.0, scale.least);
  if (!same_shape) {
    const double off = std::max(stored.larger - image.larger, stored.smaller - image.smaller);
    const double most = stored.larger * std::exp(scale.least);  // where it was scaled, cut least
    out.center_sigma_px = std::max(off, most - image.larger) / std::sqrt(12.0);
    out.center_sigma_px = std::clamp(*out.center_sigma_px, 0.01 * image.larger, 0.3 * image.larger);
  }
  const std::optional<Interval> focal = LogFocal(exif, stored);
  if (!focal) return out;
  double variance = focal->Variance() + scale.Variance() + kLensLogSigma * kLensLogSigma;
  const bool odd_shape =
      std::none_of(kSensorShapes.begin(), kSensorShapes.end(), [&](double shape) {
        return std::abs(std::log(stored.Shape() / shape)) < 2.0 * kSameShape;
      });
  // Programs that cut an image may write its new size as the camera's.
  if (!sized || odd_shape) variance += kNoSizeLogSigma * kNoSizeLogSigma;
  if (variance > kWorstLogSigma * kWorstLogSigma) return out;
  out.focal_px = std::exp(focal->Middle() + scale.Middle());
  out.focal_log_sigma = std::sqrt(variance);
  return out;
}

int QuarterTurnsToUpright(const Exif& exif) {
  switch (exif.orientation) {
    case 6:
      return 1;
    case 3:
      return 2;
    case 8:
      return 3;
    default:
      return 0;
  }
}

}  // namespace horopter
