#include "server/vision/recognition/interpretation/surface_print.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "absl/strings/str_format.h"
#include "server/vision/recognition/interpretation/pose_odds.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

constexpr int kPlaces = 2500;          // of which a print is learnt; chosen, some 70 kB
constexpr double kLeastFacing = 0.35;  // cosine between normal and ray; flatter is blurred
constexpr double kHiddenDiameters =
    0.02;                                // of the diameter: what hides a place is nearer by so much
constexpr int kLeastPlaces = 80;         // that say something together; chosen
constexpr int kLeastOfFacing = 15;       // ... of those that face one way, which have a mean
constexpr double kContrast = 6.0;        // grey levels (deviation); a plainer surface has no print
constexpr double kGreyNoise = 3.0;       // grey levels, which no correlation is asked to explain
constexpr double kUnit = 127.0;          // grey levels in PrintPlace::brightness
constexpr double kAgrees = 0.5;          // correlation of sights of one print; chosen
constexpr double kPlacesOfPatch = 25.0;  // that are as good as one, as print is larger than places
constexpr double kMostPatches = 16.0;
constexpr double kTurningLogOdds = 3.0;  // log odds with which a print turns a part

// Which way a surface faces: the nearest of 26 directions. Light differs by that, print does not.
int FacingOf(const Eigen::Vector3f& normal) {
  const float most = normal.cwiseAbs().maxCoeff();
  int facing = 0;
  for (const float x : normal) {
    const float share = x / most;
    facing = 3 * facing + (share > 0.5f ? 2 : share < -0.5f ? 0 : 1);
  }
  return facing;
}
constexpr int kFacings = 27;

// Bilinear; nothing outside.
std::optional<double> GreyAt(const AspectImage& image, const Eigen::Vector2d& at) {
  if (!(at.x() >= 0 && at.y() >= 0 && at.x() < image.width - 1 && at.y() < image.height - 1))
    return std::nullopt;
  const int x = static_cast<int>(at.x()), y = static_cast<int>(at.y());
  const double fx = at.x() - x, fy = at.y() - y;
  const std::uint8_t* above = &image.grey[image.Cell(x, y)];
  const std::uint8_t* below = above + image.width;
  return (1 - fy) * ((1 - fx) * above[0] + fx * above[1]) +
         fy * ((1 - fx) * below[0] + fx * below[1]);
}

// A sight with what it takes to look at places.
class Look {
 public:
  Look(const ObjectModel& model, const PrintSight& sight) : sight_(sight) {
    if (sight.image == nullptr || sight.image->width < 2 || sight.image->height < 2) return;
    working_ = WorkingCamera(*sight.image, sight.camera);
    straight_ = working_;
    straight_.k1 = 0.0;
    tolerance_m_ = kHiddenDiameters * model.diameter_m;
    own_ = MakeDepthBuffer(sight.image->width, sight.image->height);
    RenderDepth(model.mesh, straight_, sight.camera_from_object, &own_);
  }

  // Grey levels of each place, where it is seen, less the mean of those that face the same way. The
  // part is turned by one of its symmetries first.
  std::vector<std::optional<float>> Brightness(std::span<const PrintPlace> places,
                                               const Rigid3& turn) const {
    std::vector<std::optional<float>> out(places.size());
    if (own_.width == 0) return out;
    const Rigid3 camera_from_place = sight_.camera_from_object * turn;
    std::array<double, kFacings> sum{};
    std::array<int, kFacings> count{};
    for (std::size_t i = 0; i < places.size(); ++i) {
      const std::optional<double> grey = Grey(places[i], camera_from_place);
      if (!grey) continue;
      out[i] = static_cast<float>(*grey);
      const int facing = FacingOf(places[i].normal);
      sum[facing] += *grey;
      ++count[facing];
    }
    for (std::size_t i = 0; i < places.size(); ++i) {
      const int facing = FacingOf(places[i].normal);
      if (!out[i]) continue;
      if (count[facing] < kLeastOfFacing) {
        out[i].reset();
      } else {
        *out[i] -= static_cast<float>(sum[facing] / count[facing]);
      }
    }
    return out;
  }

 private:
  std::optional<double> Grey(const PrintPlace& place, const Rigid3& camera_from_place) const {
    const Eigen::Vector3d at = camera_from_place * place.point.cast<double>();
    if (!(at.z() > 0.0)) return std::nullopt;
    const Eigen::Vector3d normal = camera_from_place.R * place.normal.cast<double>();
    if (-normal.dot(at) < kLeastFacing * at.norm()) return std::nullopt;
    const Eigen::Vector2d straight = Project(straight_, at);
    if (!IsVisible(own_, straight, at.z(), tolerance_m_)) return std::nullopt;
    if (sight_.others != nullptr && sight_.others->width > 0 &&
        !IsVisible(*sight_.others, straight, at.z(), tolerance_m_))
      return std::nullopt;
    return GreyAt(*sight_.image, Project(working_, at));
  }

  const PrintSight& sight_;
  PinholeCamera working_, straight_;
  double tolerance_m_ = 0.0;
  DepthBuffer own_;
};

// What two readings of the same places have in common.
struct Agreement {
  int places = 0;
  double contrast = 0.0;     // deviation of `a`
  double correlation = 0.0;  // -1 .. 1
};

// a and b: the brightness of a place, or nothing. Each is levelled once more over the places that
// both show.
template <typename A, typename B>
Agreement Compare(std::span<const PrintPlace> places, const A& a, const B& b) {
  std::array<double, kFacings> sum_a{}, sum_b{};
  std::array<int, kFacings> count{};
  const auto each = [&](const auto& use) {
    for (std::size_t i = 0; i < places.size(); ++i) {
      const std::optional<float> of_a = a(i), of_b = b(i);
      if (of_a && of_b) use(FacingOf(places[i].normal), *of_a, *of_b);
    }
  };
  each([&](int facing, float x, float y) {
    sum_a[facing] += x;
    sum_b[facing] += y;
    ++count[facing];
  });
  double aa = 0.0, bb = 0.0, ab = 0.0;
  Agreement out;
  each([&](int facing, float x, float y) {
    const double u = x - sum_a[facing] / count[facing], v = y - sum_b[facing] / count[facing];
    aa += u * u;
    bb += v * v;
    ab += u * v;
    ++out.places;
  });
  if (out.places == 0) return out;
  const double noise = kGreyNoise * kGreyNoise * out.places;
  out.contrast = std::sqrt(aa / out.places);
  out.correlation = ab / std::sqrt((aa + noise) * (bb + noise));
  return out;
}

// Sums of readings of the same places.
struct Sums {
  std::vector<double> sum;
  std::vector<int> count;

  explicit Sums(std::size_t places) : sum(places, 0.0), count(places, 0) {}
  void Add(std::span<const std::optional<float>> reading, double sign = 1.0) {
    for (std::size_t i = 0; i < reading.size(); ++i) {
      if (!reading[i]) continue;
      sum[i] += sign * *reading[i];
      count[i] += sign > 0.0 ? 1 : -1;
    }
  }
  std::optional<float> operator()(std::size_t i) const {
    if (count[i] < 1) return std::nullopt;
    return static_cast<float>(sum[i] / count[i]);
  }
};

using Reading = std::vector<std::optional<float>>;

auto AtOf(const Reading& reading) {
  return [&reading](std::size_t i) { return reading[i]; };
}

// The readings of an instance under the symmetry with which they agree best with what is known.
std::vector<Reading> BestTurned(const ObjectModel& model,
                                std::span<const PrintPlace> places,
                                const PrintSights& sights,
                                const Sums& known) {
  std::vector<Look> looks;
  for (const PrintSight& sight : sights) looks.emplace_back(model, sight);
  const auto under = [&](const Rigid3& turn) {
    std::vector<Reading> readings;
    for (const Look& look : looks) readings.push_back(look.Brightness(places, turn));
    return readings;
  };
  std::vector<Reading> best = under(Rigid3());
  double most = -2.0;
  const auto rate = [&](std::vector<Reading> readings) {
    Sums own(places.size());
    for (const Reading& r : readings) own.Add(r);
    const Agreement agreement = Compare(places, known, own);
    if (agreement.places < kLeastPlaces || agreement.correlation <= most) return;
    most = agreement.correlation;
    best = std::move(readings);
  };
  rate(best);
  for (const Rigid3& symmetry : model.symmetries) rate(under(symmetry));
  return best;
}

// Readings that agree with the mean of the others; those that do not are taken out, the worst
// first.
std::vector<Reading> Agreeing(std::span<const PrintPlace> places, std::vector<Reading> readings) {
  while (readings.size() > 1) {
    Sums all(places.size());
    for (const Reading& r : readings) all.Add(r);
    std::size_t worst = 0;
    double least = 2.0;
    for (std::size_t k = 0; k < readings.size(); ++k) {
      Sums others = all;
      others.Add(readings[k], -1.0);
      const Agreement agreement = Compare(places, others, AtOf(readings[k]));
      const double correlation = agreement.places < kLeastPlaces ? -1.0 : agreement.correlation;
      if (correlation < least) least = correlation, worst = k;
    }
    if (least >= kAgrees) return readings;
    readings.erase(readings.begin() + static_cast<std::ptrdiff_t>(worst));
  }
  return {};
}

}  // namespace

std::vector<PrintPlace> PlacesOn(const TriangleMesh& mesh, int count) {
  // Of the R2 sequence (Roberts 2018): even in the triangle, whatever its number.
  constexpr double kFirst = 0.7548776662466927, kSecond = 0.5698402909980532;
  std::vector<double> until;
  double area = 0.0;
  const auto corner = [&](std::size_t t, int k) { return mesh.vertices[mesh.triangles[t][k]]; };
  const auto across = [&](std::size_t t) -> Eigen::Vector3d {
    return (corner(t, 1) - corner(t, 0)).cross(corner(t, 2) - corner(t, 0));
  };
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) until.push_back(area += across(t).norm());
  std::vector<PrintPlace> out;
  if (!(area > 0.0)) return out;
  std::size_t t = 0;
  for (int i = 0; i < count; ++i) {
    while (t + 1 < until.size() && until[t] < (i + 0.5) / count * area) ++t;
    double u = std::fmod(0.5 + kFirst * (i + 1), 1.0), v = std::fmod(0.5 + kSecond * (i + 1), 1.0);
    if (u + v > 1.0) u = 1.0 - u, v = 1.0 - v;
    const Eigen::Vector3d at =
        corner(t, 0) + u * (corner(t, 1) - corner(t, 0)) + v * (corner(t, 2) - corner(t, 0));
    out.push_back({at.cast<float>(), across(t).normalized().cast<float>()});
  }
  return out;
}

absl::StatusOr<SurfacePrint> LearnPrint(const ObjectModel& model,
                                        std::span<const PrintSights> instances) {
  const std::vector<PrintPlace> places = PlacesOn(model.mesh, kPlaces);
  Sums known(places.size());
  std::vector<Reading> all;
  for (const PrintSights& sights : instances) {
    for (Reading& reading : BestTurned(model, places, sights, known)) {
      const auto shown = std::count_if(
          reading.begin(), reading.end(), [](const auto& r) { return r.has_value(); });
      if (shown < kLeastPlaces) continue;
      known.Add(reading);
      all.push_back(std::move(reading));
    }
  }
  if (all.size() < 2) {
    return absl::FailedPreconditionError(absl::StrFormat(
        "%d views show enough of the object's surface, at least 2 are needed", all.size()));
  }
  const std::size_t shown = all.size();
  const std::vector<Reading> agreeing = Agreeing(places, std::move(all));
  if (agreeing.size() < 2) {
    return absl::FailedPreconditionError(absl::StrFormat(
        "the %d views that show the object's surface do not agree on what is printed on it, or it "
        "is plain",
        shown));
  }
  Sums sums(places.size());
  for (const Reading& reading : agreeing) sums.Add(reading);
  SurfacePrint print;
  print.views = static_cast<int>(agreeing.size());
  double squares = 0.0;
  for (std::size_t i = 0; i < places.size(); ++i) {
    if (sums.count[i] < 2) continue;
    const double mean = sums.sum[i] / sums.count[i];
    squares += mean * mean;
    print.places.push_back(places[i]);
    print.places.back().brightness = static_cast<float>(std::clamp(mean / kUnit, -1.0, 1.0));
  }
  const double contrast = std::sqrt(squares / std::max<double>(1.0, 1.0 * print.places.size()));
  if (static_cast<int>(print.places.size()) < kLeastPlaces || contrast < kContrast) {
    return absl::FailedPreconditionError(absl::StrFormat(
        "the surface is plain: %d places differ by %.1f grey levels, %.1f are needed",
        print.places.size(),
        contrast,
        kContrast));
  }
  return print;
}

namespace {

// The print under a symmetry, as PrintLogLikelihood.
std::optional<double> LikelihoodUnder(const SurfacePrint& print,
                                      std::span<const Look> looks,
                                      const Rigid3& turn,
                                      double most_log_odds) {
  std::optional<double> out;
  const auto learnt = [&](std::size_t i) -> std::optional<float> {
    return static_cast<float>(kUnit) * print.places[i].brightness;
  };
  for (const Look& look : looks) {
    const Reading reading = look.Brightness(print.places, turn);
    const Agreement agreement = Compare(print.places, learnt, AtOf(reading));
    if (agreement.places < kLeastPlaces || agreement.contrast < kContrast) continue;
    // Of jointly normal brightnesses with this correlation against independent ones; what runs the
    // other way is no print of it.
    const double r = std::clamp(agreement.correlation, 0.0, 0.99);
    const double patches = std::min(kMostPatches, agreement.places / kPlacesOfPatch);
    out = out.value_or(0.0) + std::min(most_log_odds, -0.5 * patches * std::log(1.0 - r * r));
  }
  return out;
}

std::vector<Look> LooksOf(const ObjectModel& model, std::span<const PrintSight> sights) {
  std::vector<Look> looks;
  for (const PrintSight& sight : sights) looks.emplace_back(model, sight);
  return looks;
}

}  // namespace

std::optional<double> PrintLogLikelihood(const ObjectModel& model,
                                         std::span<const PrintSight> sights,
                                         double most_log_odds) {
  if (model.print.places.empty()) return std::nullopt;
  return LikelihoodUnder(model.print, LooksOf(model, sights), Rigid3(), most_log_odds);
}

std::vector<PrintSight> SightsOf(std::span<const AspectImage> images,
                                 const std::vector<std::optional<CalibratedCamera>>& views,
                                 const Rigid3& scene_from_object,
                                 std::span<const DepthBuffer> hidden) {
  std::vector<PrintSight> out;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v] || images[v].width == 0) continue;
    out.push_back({&images[v],
                   views[v]->camera,
                   views[v]->camera_from_scene * scene_from_object,
                   v < hidden.size() ? &hidden[v] : nullptr});
  }
  return out;
}

double PrintLogOdds(const ObjectModel& a,
                    std::span<const PrintSight> sights_of_a,
                    const ObjectModel& b,
                    std::span<const PrintSight> sights_of_b,
                    double most_log_odds) {
  if (a.print.places.empty() || b.print.places.empty()) return 0.0;
  const auto of_a = PrintLogLikelihood(a, sights_of_a, most_log_odds);
  const auto of_b = PrintLogLikelihood(b, sights_of_b, most_log_odds);
  return of_a && of_b ? *of_a - *of_b : 0.0;
}

std::optional<Rigid3> TurnOfPrint(const ObjectModel& model,
                                  std::span<const PrintSight> sights,
                                  double least_log_odds,
                                  double most_log_odds) {
  if (model.print.places.empty() || model.symmetries.empty()) return std::nullopt;
  const std::vector<Look> looks = LooksOf(model, sights);
  const auto under = [&](const Rigid3& turn) {
    return LikelihoodUnder(model.print, looks, turn, most_log_odds).value_or(0.0);
  };
  double best = under(Rigid3()) + least_log_odds;
  std::optional<Rigid3> turn;
  for (const Rigid3& symmetry : model.symmetries) {
    const double likelihood = under(symmetry);
    if (likelihood <= best) continue;
    best = likelihood;
    turn = symmetry;
  }
  return turn;
}

void TurnByPrint(const JointContext& context,
                 std::span<const AspectImage> images,
                 RecognitionResult* result) {
  for (std::size_t k = 0; k < result->objects.size(); ++k) {
    SceneObject& answer = result->objects[k];
    const ObjectModel& model = context.objects[answer.object]->model;
    if (model.print.places.empty()) continue;
    const std::vector<DepthBuffer> hidden = DepthOfOthers(context, images, *result, k);
    const std::optional<Rigid3> turn =
        TurnOfPrint(model,
                    SightsOf(images, result->views, answer.scene_from_object, hidden),
                    kTurningLogOdds,
                    context.options.acceptance.pose_choices.most_log_odds);
    if (!turn) continue;
    answer.scene_from_object = answer.scene_from_object * *turn;
    result->counts["turned_by_print"] += 1.0;
  }
}

}  // namespace horopter
