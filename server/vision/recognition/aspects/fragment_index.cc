#include "server/vision/recognition/aspects/fragment_index.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <numbers>
#include <numeric>

#include "server/base/constants.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {
namespace {

constexpr float kCellRad = 0.25f;  // edge of a grid cell
constexpr int kMaxCells = 64;      // along an axis

using KeyVector = Eigen::Matrix<float, kFragmentAngles, 1>;

using Entry = FragmentPiece::Entry;

KeyVector AsVector(const FragmentKey& key) {
  return Eigen::Map<const KeyVector>(key.data());
}
KeyVector AsVector(const PackedFragmentKey& key) {
  return AsVector(UnpackKey(key));
}

float MeanAngle(const PackedFragmentKey& key) {
  return static_cast<float>(std::accumulate(key.begin(), key.end(), 0)) /
         (kKeyScale * kFragmentAngles);
}

// The three directions in which keys differ most. A key read backwards is as likely, so the mean is
// taken over both; it only shifts the cells.
Eigen::Matrix<float, 3, kFragmentAngles> MainDirections(const std::vector<Entry>& all) {
  Eigen::Matrix<double, kFragmentAngles, kFragmentAngles> moment;
  moment.setZero();
  for (const Entry& f : all) {
    const Eigen::Matrix<double, kFragmentAngles, 1> v = AsVector(f.key).cast<double>();
    moment += v * v.transpose();
    moment += v.reverse() * v.reverse().transpose();
  }
  const Eigen::SelfAdjointEigenSolver<decltype(moment)> solver(moment);
  return solver.eigenvectors().rightCols<3>().transpose().cast<float>();
}

void AddFirstPoints(const IndexedAspect& aspect, FragmentPiece* piece) {
  constexpr float kReach = 32767.0f;  // largest 16 bit step
  FirstVotePoints& packed = piece->first_points.emplace_back();
  if (aspect.points < kFirstVotePoints) return;
  const auto pack = [&](float v) {
    return static_cast<std::int16_t>(
        std::lround(std::clamp(v * FirstVotePoints::kPlaceScale, -kReach, kReach)));
  };
  for (int i = 0; i < kFirstVotePoints; ++i) {
    const VotePoint& p = piece->points[aspect.first_point + i];
    packed.x[i] = pack(p.x);
    packed.y[i] = pack(p.y);
    packed.bin[i] = static_cast<std::uint16_t>(p.bin * FirstVotePoints::kBinSteps);
  }
}

// Each as far as possible from those before it, while that is farther than the spacing (Gonzalez
// 1985); in their own order.
std::vector<int> SpreadViews(const AspectSet& set, double spacing_rad) {
  const int count = static_cast<int>(set.aspects.size());
  std::vector<int> taken;
  if (spacing_rad <= 0) {
    taken.resize(count);
    std::iota(taken.begin(), taken.end(), 0);
    return taken;
  }
  std::vector<float> nearest(set.aspects.size(), -1.0f);  // cosine to the nearest one taken
  for (int next = 0; next < count;) {
    taken.push_back(next);
    const Eigen::Vector3f from = set.aspects[next].camera_from_object.row(2);
    int farthest = 0;
    for (int a = 0; a < count; ++a) {
      nearest[a] = std::max(nearest[a], from.dot(set.aspects[a].camera_from_object.row(2)));
      if (nearest[a] < nearest[farthest]) farthest = a;
    }
    if (nearest[farthest] > std::cos(spacing_rad)) break;
    next = farthest;
  }
  std::sort(taken.begin(), taken.end());
  return taken;
}

void AddAspect(const AspectSet& set,
               const PinholeCamera& camera,
               int number,
               std::span<const AspectPoint> points,
               FragmentPiece* piece) {
  const float unit = static_cast<float>(1.0 / set.render_px);
  const Rigid3 pose = AspectPose(set, number);
  IndexedAspect& aspect = piece->aspects.emplace_back();
  aspect.model = 0;
  aspect.aspect = number;
  aspect.first_point = static_cast<std::uint32_t>(piece->points.size());
  aspect.camera_from_object = set.aspects[number].camera_from_object;
  for (const AspectPoint& p : points) {
    const Eigen::Vector3d x = pose * p.point.cast<double>();
    const Eigen::Vector3d d = pose.R * p.direction.cast<double>();
    const Eigen::Vector2d image = Project(camera, x);
    // Derivative of the projection along the edge, up to scale.
    const double du = d.x() * x.z() - x.x() * d.z(), dv = d.y() * x.z() - x.y() * d.z();
    float angle = static_cast<float>(std::atan2(dv, du));
    if (angle < 0) angle += kPiF;
    float bin = angle * (kAspectBins / kPiF);
    if (bin >= kAspectBins) bin -= kAspectBins;
    piece->points.push_back({static_cast<float>(image.x() - camera.cx) * unit,
                             static_cast<float>(image.y() - camera.cy) * unit,
                             bin});
    ++aspect.points;
  }
  AddFirstPoints(aspect, piece);
}

// Whether most of a rim is among the points that the view shows of the part's edges.
bool IsShown(const std::vector<Eigen::Vector2f>& points,
             const ModelCircle& rim,
             const Rigid3& pose,
             const PinholeCamera& camera,
             float unit) {
  constexpr int kSamples = 12;
  constexpr float kSameNear = 0.03f;  // diameters; points of an aspect are some 0.02 apart
  const Eigen::Vector3d u = rim.axis.unitOrthogonal(), v = rim.axis.cross(u);
  int shown = 0;
  for (int k = 0; k < kSamples; ++k) {
    const double a = 2.0 * std::numbers::pi * k / kSamples;
    const Eigen::Vector3d x = rim.center + rim.radius_m * (std::cos(a) * u + std::sin(a) * v);
    const Eigen::Vector2f at =
        unit * (Project(camera, pose * x) - Eigen::Vector2d(camera.cx, camera.cy)).cast<float>();
    shown += std::any_of(points.begin(), points.end(), [&](const Eigen::Vector2f& p) {
      return (p - at).squaredNorm() < kSameNear * kSameNear;
    });
  }
  return 3 * shown >= 2 * kSamples;
}

void AddEllipses(const AspectSet& set,
                 const PinholeCamera& camera,
                 int number,
                 std::span<const AspectPoint> edges,
                 std::span<const ModelCircle> rims,
                 FragmentPiece* piece) {
  const auto aspect = static_cast<std::int32_t>(piece->aspects.size()) - 1;
  if (piece->aspects.back().points < kFirstVotePoints) return;
  const float unit = static_cast<float>(1.0 / set.render_px);
  const Rigid3 pose = AspectPose(set, number);
  std::vector<Eigen::Vector2f> points;
  for (const AspectPoint& p : edges) {
    points.push_back(unit * (Project(camera, pose * p.point.cast<double>()) -
                             Eigen::Vector2d(camera.cx, camera.cy))
                                .cast<float>());
  }
  for (const ModelCircle& rim : rims) {
    if (!IsShown(points, rim, pose, camera, unit)) continue;
    const Eigen::Vector3d center = pose * rim.center;
    const Eigen::Vector3d ray = center.normalized();
    const Eigen::Vector3d normal = pose.R * rim.axis;
    const Eigen::Vector3d major = ray.cross(normal);
    float direction = static_cast<float>(std::atan2(major.y(), major.x()));
    if (direction < 0) direction += kPiF;
    const Eigen::Vector2f at =
        unit * (Project(camera, center) - Eigen::Vector2d(camera.cx, camera.cy)).cast<float>();
    piece->ellipses.push_back(
        {aspect,
         at.x(),
         at.y(),
         unit * static_cast<float>(camera.focal_px * rim.radius_m / center.z()),
         static_cast<float>(std::abs(normal.dot(ray))),
         direction});
  }
}

void AddPiece(const FragmentPiece& piece, FragmentIndex* index, std::vector<Entry>* all) {
  const auto first_aspect = static_cast<std::int32_t>(index->aspects.size());
  const auto first_point = static_cast<std::uint32_t>(index->points.size());
  for (IndexedAspect aspect : piece.aspects) {
    aspect.model = index->model_count;
    aspect.first_point += first_point;
    index->aspects.push_back(aspect);
  }
  index->points.insert(index->points.end(), piece.points.begin(), piece.points.end());
  index->first_points.insert(
      index->first_points.end(), piece.first_points.begin(), piece.first_points.end());
  for (Entry entry : piece.entries) {
    entry.fragment.aspect += first_aspect;
    all->push_back(entry);
  }
  for (IndexedPair pair : piece.pairs) {
    pair.aspect += first_aspect;
    index->pairs.push_back(pair);
  }
  for (IndexedEllipse ellipse : piece.ellipses) {
    ellipse.aspect += first_aspect;
    index->ellipses.push_back(ellipse);
  }
  ++index->model_count;
}

// Sorts the fragments into cells.
void FillGrid(const std::vector<Entry>& all, FragmentIndex* index) {
  const std::size_t n = all.size();
  std::vector<Eigen::Array3f> places(n);
  Eigen::Array3f low = Eigen::Array3f::Constant(1e9f), high = -low;
  for (std::size_t i = 0; i < n; ++i) {
    places[i] = (index->axes * AsVector(all[i].key)).array();
    low = low.min(places[i]);
    high = high.max(places[i]);
  }
  const float cell = kCellRad;
  index->low = low;
  index->cells.counts = (((high - low) / cell).floor().cast<int>() + 1).max(1).min(kMaxCells);
  std::vector<std::uint32_t> of(n);
  index->cell_begin.assign(static_cast<std::size_t>(index->cells.total()) + 1, 0);
  for (std::size_t i = 0; i < n; ++i) {
    of[i] = static_cast<std::uint32_t>(index->cells.NumberAt((places[i] - low) / cell));
    ++index->cell_begin[of[i] + 1];
  }
  std::partial_sum(index->cell_begin.begin(), index->cell_begin.end(), index->cell_begin.begin());
  std::vector<std::uint32_t> next(index->cell_begin.begin(), index->cell_begin.end() - 1);
  index->fragments.resize(n);
  index->keys.resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    const std::uint32_t at = next[of[i]]++;
    index->fragments[at] = all[i].fragment;
    index->keys[at] = all[i].key;
  }
  index->coarse_keys = CoarseKeys(index->keys);
}

}  // namespace

void FragmentIndex::FindNearest(const FragmentKey& key,
                                float radius,
                                std::size_t most,
                                std::span<const std::uint8_t> wanted,
                                std::vector<std::uint32_t>* found) const {
  if (fragments.empty() || most == 0) return;
  const auto is_wanted = [&](std::uint32_t f) {
    return wanted.empty() || wanted[aspects[fragments[f].aspect].model] != 0;
  };
  NearestKeys nearest(CoarseKeys::LimitOf(radius), most);
  const CoarseKeys::Key coarse = CoarseKeys::Coarse(PackKey(key));
  const float cell = kCellRad;
  const Eigen::Array3f place = ((axes * AsVector(key)).array() - low) / cell;
  constexpr std::uint32_t kBlock = 512;  // keys, between two looks at the limit
  std::array<CoarseKeys::Near, kBlock + CoarseKeys::kLanes> near;
  // Nearest rows of cells first: they close the rings.
  for (const KeyCells::Row& row :
       cells.RowsAround(place, CoarseKeys::RadiusOf(nearest.limit()) / cell)) {
    const float reach = CoarseKeys::RadiusOf(nearest.limit()) / cell;
    if (row.away > reach * reach) break;
    const float r = std::sqrt(reach * reach - row.away);
    const std::uint32_t end = cell_begin[row.first_cell + cells.At(2, place[2] + r) + 1];
    for (std::uint32_t begin = cell_begin[row.first_cell + cells.At(2, place[2] - r)]; begin < end;
         begin += kBlock) {
      const std::uint32_t stop = std::min(end, begin + kBlock);
      const std::size_t n = coarse_keys.Find(coarse, begin, stop, nearest.limit(), near.data());
      for (std::size_t k = 0; k < n; ++k) {
        if (is_wanted(near[k].number)) nearest.Offer(near[k].number, near[k].squared);
      }
    }
  }
  nearest.Take(found);
}

std::pair<std::size_t, std::size_t> FragmentIndex::FindPairs(float opening_rad,
                                                             float reach_rad) const {
  const auto first = std::lower_bound(
      pairs.begin(), pairs.end(), opening_rad - reach_rad, [](const IndexedPair& p, float v) {
        return p.opening_rad < v;
      });
  const auto last = std::upper_bound(
      first, pairs.end(), opening_rad + reach_rad, [](float v, const IndexedPair& p) {
        return v < p.opening_rad;
      });
  return {first - pairs.begin(), last - pairs.begin()};
}

std::pair<std::size_t, std::size_t> FragmentIndex::FindEllipses(float ratio, float reach) const {
  const auto first = std::lower_bound(
      ellipses.begin(), ellipses.end(), ratio - reach, [](const IndexedEllipse& e, float v) {
        return e.ratio < v;
      });
  const auto last =
      std::upper_bound(first, ellipses.end(), ratio + reach, [](float v, const IndexedEllipse& e) {
        return v < e.ratio;
      });
  return {first - ellipses.begin(), last - ellipses.begin()};
}

std::size_t FragmentIndex::bytes() const {
  const auto of = [](const auto& v) { return v.capacity() * sizeof(v[0]); };
  return of(aspects) + of(points) + of(first_points) + of(fragments) + of(keys) + of(cell_begin) +
         coarse_keys.bytes() + of(pairs) + of(ellipses);
}

FragmentPiece MakeFragmentPiece(const ObjectAspects& object,
                                const ModelFragments& fragments,
                                const FragmentChoice& choice,
                                std::span<const ModelCircle> rims) {
  const AspectSet& set = object.aspects;
  const PinholeCamera camera = AspectCamera(set);
  FragmentPiece piece;
  std::vector<int> place(set.aspects.size(), -1);  // of an aspect in the piece
  for (const int a : SpreadViews(set, choice.view_spacing_rad)) {
    place[a] = static_cast<int>(piece.aspects.size());
    const std::vector<AspectPoint> points = AspectPoints(set, a);
    const std::size_t voting =
        std::min(points.size(), static_cast<std::size_t>(std::max(0, choice.points)));
    AddAspect(set, camera, a, std::span(points).first(voting), &piece);
    piece.aspects.back().edge_length = fragments.edge_length[a];
    if (choice.ellipses) AddEllipses(set, camera, a, points, rims, &piece);
  }
  const int aspects = std::max(1, static_cast<int>(piece.aspects.size()));
  std::vector<int> left(set.aspects.size(), (choice.fragments + aspects - 1) / aspects);
  for (const AspectFragment& f : fragments.fragments) {
    if (place[f.aspect] < 0 || piece.aspects[place[f.aspect]].points < kFirstVotePoints) continue;
    if (--left[f.aspect] < 0) continue;
    piece.entries.push_back(
        {f.key,
         {place[f.aspect],
          f.x / AspectFragment::kPlaceScale,
          f.y / AspectFragment::kPlaceScale,
          f.spread / AspectFragment::kSpreadScale,
          IndexedTurn(f.chord / AspectFragment::kTurnScale + MeanAngle(f.key))}});
  }
  for (const AspectSegmentPair& p : fragments.pairs) {
    if (!choice.pairs) break;
    if (place[p.aspect] < 0 || piece.aspects[place[p.aspect]].points < kFirstVotePoints) continue;
    const float direction = p.direction / AspectSegmentPair::kTurnScale;
    const float opening = p.opening / AspectSegmentPair::kTurnScale;
    piece.pairs.push_back({place[p.aspect],
                           p.x / AspectSegmentPair::kPlaceScale,
                           p.y / AspectSegmentPair::kPlaceScale,
                           opening,
                           IndexedTurn(direction + 0.5f * opening),
                           p.length_a / AspectSegmentPair::kPlaceScale,
                           p.length_b / AspectSegmentPair::kPlaceScale});
  }
  return piece;
}

FragmentIndex BuildFragmentIndex(std::span<const AspectModel> models, int threads) {
  std::vector<FragmentPiece> pieces(models.size());
  ParallelFor(static_cast<int>(models.size()), threads, [&](int i) {
    pieces[i] = MakeFragmentPiece(*models[i].object, *models[i].fragments, {}, models[i].rims);
  });
  std::vector<const FragmentPiece*> pointers;
  for (const FragmentPiece& piece : pieces) pointers.push_back(&piece);
  FragmentIndex index = BuildFragmentIndex(pointers);
  index.models.assign(models.begin(), models.end());
  return index;
}

FragmentIndex BuildFragmentIndex(std::span<const FragmentPiece* const> pieces) {
  static const FragmentPiece kNone;
  FragmentIndex index;
  std::vector<Entry> all;
  for (const FragmentPiece* piece : pieces) {
    AddPiece(piece != nullptr ? *piece : kNone, &index, &all);
  }
  if (!all.empty()) {
    index.axes = MainDirections(all);
    FillGrid(all, &index);
  }
  std::stable_sort(
      index.pairs.begin(), index.pairs.end(), [](const IndexedPair& a, const IndexedPair& b) {
        return a.opening_rad < b.opening_rad;
      });
  std::stable_sort(index.ellipses.begin(), index.ellipses.end(), [](const auto& a, const auto& b) {
    return a.ratio < b.ratio;
  });
  return index;
}

}  // namespace horopter
