#include "server/vision/recognition/aspects/fragment_index.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <numeric>
#include <opencv2/core/hal/intrin.hpp>

#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {
namespace {

constexpr float kPi = 3.14159265358979f;
constexpr int kMaxCells = 64;  // along an axis

using KeyVector = Eigen::Matrix<float, kFragmentAngles, 1>;

using Entry = FragmentPiece::Entry;

KeyVector AsVector(const FragmentKey& key) {
  return Eigen::Map<const KeyVector>(key.data());
}
KeyVector AsVector(const PackedFragmentKey& key) {
  return AsVector(UnpackKey(key));
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
    if (angle < 0) angle += kPi;
    float bin = angle * (kAspectBins / kPi);
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
  constexpr float kNear = 0.03f;  // diameters; points of an aspect are some 0.02 apart
  const Eigen::Vector3d u = rim.axis.unitOrthogonal(), v = rim.axis.cross(u);
  int shown = 0;
  for (int k = 0; k < kSamples; ++k) {
    const double a = 2.0 * std::numbers::pi * k / kSamples;
    const Eigen::Vector3d x = rim.center + rim.radius_m * (std::cos(a) * u + std::sin(a) * v);
    const Eigen::Vector2f at =
        unit * (Project(camera, pose * x) - Eigen::Vector2d(camera.cx, camera.cy)).cast<float>();
    shown += std::any_of(points.begin(), points.end(), [&](const Eigen::Vector2f& p) {
      return (p - at).squaredNorm() < kNear * kNear;
    });
  }
  return 3 * shown >= 2 * kSamples;
}

void AddOutline(const AspectSet& set,
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
  if (const auto shape = ShapeOf(points)) piece->outlines.push_back({aspect, *shape});
  for (const ModelCircle& rim : rims) {
    if (!IsShown(points, rim, pose, camera, unit)) continue;
    const Eigen::Vector3d center = pose * rim.center;
    const Eigen::Vector3d ray = center.normalized();
    const Eigen::Vector3d normal = pose.R * rim.axis;
    const Eigen::Vector3d major = ray.cross(normal);
    float direction = static_cast<float>(std::atan2(major.y(), major.x()));
    if (direction < 0) direction += kPi;
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
  for (IndexedOutline outline : piece.outlines) {
    outline.aspect += first_aspect;
    index->outlines.push_back(outline);
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
  const float cell = static_cast<float>(index->options.cell_rad);
  index->low = low;
  index->cells = ((high - low) / cell).floor().cast<int>() + 1;
  index->cells = index->cells.max(1).min(kMaxCells);
  const std::size_t cells = static_cast<std::size_t>(index->cells.prod());
  std::vector<std::uint32_t> of(n);
  index->cell_begin.assign(cells + 1, 0);
  for (std::size_t i = 0; i < n; ++i) {
    const Eigen::Array3i c =
        ((places[i] - low) / cell).floor().cast<int>().min(index->cells - 1).max(0);
    of[i] =
        static_cast<std::uint32_t>((c.x() * index->cells.y() + c.y()) * index->cells.z() + c.z());
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
}

int SquaredSteps(const PackedFragmentKey& a, const PackedFragmentKey& b) {
  int sum = 0;
  for (int i = 0; i < kFragmentAngles; ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
  return sum;
}

// Appends the numbers in [begin, end) of the keys that differ by at most limit (squared steps): a
// search spends a quarter of its time here, so four keys are taken at once.
void AppendNear(const PackedFragmentKey* keys,
                std::uint32_t begin,
                std::uint32_t end,
                const PackedFragmentKey& key,
                int limit,
                std::vector<std::uint32_t>* found) {
  std::uint32_t f = begin;
#if CV_SIMD128
  static_assert(kFragmentAngles == 8);
  const cv::v_int16x8 center = cv::v_load(key.data());
  const cv::v_int32x4 most = cv::v_setall_s32(limit);
  const auto squares = [&](std::uint32_t k) {
    const cv::v_int16x8 d = cv::v_sub_wrap(cv::v_load(keys[k].data()), center);
    return cv::v_dotprod(d, d);
  };
  for (; f + 4 <= end; f += 4) {
    cv::v_int32x4 a, b, c, d;
    cv::v_transpose4x4(squares(f), squares(f + 1), squares(f + 2), squares(f + 3), a, b, c, d);
    int near = cv::v_signmask(~((a + b) + (c + d) > most));
    for (; near != 0; near &= near - 1)
      found->push_back(f +
                       static_cast<std::uint32_t>(std::countr_zero(static_cast<unsigned>(near))));
  }
#endif
  for (; f < end; ++f) {
    if (SquaredSteps(keys[f], key) <= limit) found->push_back(f);
  }
}

absl::StatusOr<XTreeSnapshot> BuildTree(const FragmentIndex& index) {
  std::vector<double> points;
  std::vector<std::int64_t> ids(index.keys.size());
  std::iota(ids.begin(), ids.end(), 0);
  points.reserve(ids.size() * kFragmentAngles);
  for (const PackedFragmentKey& key : index.keys) {
    for (const std::int16_t v : key) points.push_back(v / kKeyScale);
  }
  XTreeOptions options;
  options.dimensions = kFragmentAngles;
  HOROPTER_ASSIGN_OR_RETURN(XTree tree,
                            XTree::BulkLoad(options, points, ids, index.options.threads));
  return tree.Snapshot();
}

absl::StatusOr<XTreeSnapshot> BuildOutlineTree(const FragmentIndex& index) {
  std::vector<double> points;
  std::vector<std::int64_t> ids(index.outlines.size());
  std::iota(ids.begin(), ids.end(), 0);
  for (const IndexedOutline& outline : index.outlines) {
    for (const double v : outline.shape.Key()) points.push_back(v);
  }
  XTreeOptions options;
  options.dimensions = kOutlineOrders;
  HOROPTER_ASSIGN_OR_RETURN(XTree tree,
                            XTree::BulkLoad(options, points, ids, index.options.threads));
  return tree.Snapshot();
}

}  // namespace

void FragmentIndex::Find(const FragmentKey& key,
                         float radius,
                         std::vector<std::uint32_t>* found) const {
  if (options.lookup == FragmentLookup::kXTree) {
    std::array<double, kFragmentAngles> center;
    std::copy(key.begin(), key.end(), center.begin());
    for (const Neighbor& n : tree.Radius(center, radius)) {
      found->push_back(static_cast<std::uint32_t>(n.id));
    }
    return;
  }
  if (fragments.empty()) return;
  const float cell = static_cast<float>(options.cell_rad);
  const Eigen::Array3f place = ((axes * AsVector(key)).array() - low) / cell;
  const float reach = radius / cell;
  const auto first = [&](int d) {
    return std::clamp(static_cast<int>(std::floor(place[d] - reach)), 0, cells[d] - 1);
  };
  const auto last = [&](int d, float r) {
    return std::clamp(static_cast<int>(std::floor(place[d] + r)), 0, cells[d] - 1);
  };
  // Distance of the place from the cells [i, i + 1); border cells reach to infinity.
  const auto away = [&](int d, int i) {
    const float under = i == 0 ? 0.0f : i - place[d];
    const float over = i == cells[d] - 1 ? 0.0f : place[d] - (i + 1);
    return std::max(0.0f, std::max(under, over));
  };
  const PackedFragmentKey packed = PackKey(key);
  const int limit = static_cast<int>(radius * radius * kKeyScale * kKeyScale);
  for (int i = first(0); i <= last(0, reach); ++i) {
    const float di = away(0, i);
    for (int j = first(1); j <= last(1, reach); ++j) {
      const float dj = away(1, j);
      const float rest = reach * reach - di * di - dj * dj;
      if (rest < 0) continue;
      const float r = std::sqrt(rest);
      const int k0 = std::clamp(static_cast<int>(std::floor(place[2] - r)), 0, cells[2] - 1);
      const std::size_t row = (static_cast<std::size_t>(i) * cells[1] + j) * cells[2];
      const std::uint32_t begin = cell_begin[row + k0], end = cell_begin[row + last(2, r) + 1];
      AppendNear(keys.data(), begin, end, packed, limit, found);
    }
  }
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
         of(pairs) + of(outlines) + of(ellipses);
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
    if (choice.outlines) AddOutline(set, camera, a, points, rims, &piece);
  }
  const int aspects = std::max(1, static_cast<int>(piece.aspects.size()));
  std::vector<int> left(set.aspects.size(), (choice.fragments + aspects - 1) / aspects);
  for (const AspectFragment& f : fragments.fragments) {
    if (place[f.aspect] < 0 || piece.aspects[place[f.aspect]].points < kFirstVotePoints) continue;
    if (--left[f.aspect] < 0) continue;
    piece.entries.push_back({f.key,
                             {place[f.aspect],
                              f.x / AspectFragment::kPlaceScale,
                              f.y / AspectFragment::kPlaceScale,
                              f.spread / AspectFragment::kSpreadScale,
                              f.chord / AspectFragment::kTurnScale}});
  }
  for (const AspectSegmentPair& p : fragments.pairs) {
    if (!choice.pairs) break;
    if (place[p.aspect] < 0 || piece.aspects[place[p.aspect]].points < kFirstVotePoints) continue;
    piece.pairs.push_back({place[p.aspect],
                           p.x / AspectSegmentPair::kPlaceScale,
                           p.y / AspectSegmentPair::kPlaceScale,
                           p.direction / AspectSegmentPair::kTurnScale,
                           p.opening / AspectSegmentPair::kTurnScale,
                           p.length_a / AspectSegmentPair::kPlaceScale,
                           p.length_b / AspectSegmentPair::kPlaceScale});
  }
  return piece;
}

absl::StatusOr<FragmentIndex> BuildFragmentIndex(std::span<const AspectModel> models,
                                                 const FragmentIndexOptions& options) {
  std::vector<FragmentPiece> pieces(models.size());
  ParallelFor(static_cast<int>(models.size()), options.threads, [&](int i) {
    pieces[i] = MakeFragmentPiece(*models[i].object, *models[i].fragments, {}, models[i].rims);
  });
  std::vector<const FragmentPiece*> pointers;
  for (const FragmentPiece& piece : pieces) pointers.push_back(&piece);
  HOROPTER_ASSIGN_OR_RETURN(FragmentIndex index, BuildFragmentIndex(pointers, options));
  index.models.assign(models.begin(), models.end());
  return index;
}

absl::StatusOr<FragmentIndex> BuildFragmentIndex(std::span<const FragmentPiece* const> pieces,
                                                 const FragmentIndexOptions& options) {
  static const FragmentPiece kNone;
  FragmentIndex index;
  index.options = options;
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
  if (!index.outlines.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(index.outline_tree, BuildOutlineTree(index));
  }
  if (options.lookup == FragmentLookup::kXTree) {
    HOROPTER_ASSIGN_OR_RETURN(index.tree, BuildTree(index));
  }
  return index;
}

}  // namespace horopter
