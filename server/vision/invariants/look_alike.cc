#include "server/vision/invariants/look_alike.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>

#include "server/vision/invariants/similarity_keys.h"

namespace horopter {
namespace {

using Vertices = std::vector<Eigen::Vector3d>;

constexpr size_t kMinVertices = 5;  // one over the four that a start takes
// A part with more corners is compared by the first chains found; its own chains are all tried.
constexpr size_t kMaxComparedVertices = 400;
constexpr size_t kMaxChains = 4000;

double Volume(const Vertices& v, const FourVertices& f) {
  Eigen::Matrix3d m;
  for (int i = 0; i < 3; ++i) m.col(i) = v[f[i + 1]] - v[f[0]];
  return std::abs(m.determinant());
}

Eigen::Matrix4d Homogeneous(const Vertices& v, const FourVertices& f) {
  Eigen::Matrix4d m;
  for (int i = 0; i < 4; ++i) m.col(i) = v[f[i]].homogeneous();
  return m;
}

std::vector<FourVertices> Reversed(std::vector<FourVertices> chains) {
  const size_t n = chains.size();
  for (size_t i = 0; i < n; ++i) {
    const FourVertices& c = chains[i];
    chains.push_back({c[3], c[2], c[1], c[0]});
  }
  return chains;
}

// Matched pairs of a map, one to one by nearest vertex; -1: none. A map that cannot reach `needed`
// pairs any more is given up: nearly all maps are, after the first few vertices.
struct Matching {
  std::vector<int> partner;
  int count = 0;
};

Matching Match(const Eigen::Matrix4d& b_from_a,
               const Vertices& a,
               const Vertices& b,
               double within,
               int needed) {
  Matching result;
  result.partner.assign(a.size(), -1);
  std::vector<char> taken(b.size(), 0);
  double sign = 0.0;
  for (size_t i = 0; i < a.size(); ++i) {
    if (result.count + static_cast<int>(a.size() - i) < needed) return result;
    const Eigen::Vector4d x = b_from_a * a[i].homogeneous();
    // A collineation that carries a part through the plane at infinity shows nothing real.
    if (sign == 0.0) sign = x.w();
    if (!(x.w() * sign > 0.0)) return {std::vector<int>(a.size(), -1), 0};
    const Eigen::Vector3d p = x.hnormalized();
    double nearest = within * within;
    for (size_t j = 0; j < b.size(); ++j) {
      const double squared = (p - b[j]).squaredNorm();
      if (squared <= nearest && !taken[j]) {
        nearest = squared;
        result.partner[i] = static_cast<int>(j);
      }
    }
    if (result.partner[i] >= 0) {
      taken[result.partner[i]] = 1;
      ++result.count;
    }
  }
  return result;
}

LookAlikeKind KindOf(const Eigen::Matrix4d& map, const Eigen::Vector3d& stretch, double tolerance) {
  if (map.row(3).head<3>().norm() > 1e-6 * std::abs(map(3, 3))) return LookAlikeKind::kProjective;
  if (stretch(0) > (1.0 + tolerance) * stretch(2)) return LookAlikeKind::kAffine;
  if (map.topLeftCorner<3, 3>().determinant() < 0.0) return LookAlikeKind::kMirror;
  return std::abs(stretch.mean() - 1.0) <= tolerance ? LookAlikeKind::kCongruent
                                                     : LookAlikeKind::kSimilar;
}

struct Best {
  Eigen::Matrix4d map;
  Eigen::Vector3d stretch;
  LookAlikeKind kind = LookAlikeKind::kProjective;
  Matching matching;
};

class Search {
 public:
  Search(const ObjectModel& a, const ObjectModel& b, const LookAlikeOptions& options)
      : a_(a.vertices),
        b_(b.vertices),
        within_(options.tolerance * b.diameter_m),
        needed_(Needed(options.min_vertex_share)),
        needed_similar_(Needed(options.min_similar_share)),
        stretch_tolerance_(options.stretch_tolerance) {}

  void Try(Eigen::Matrix4d map) {
    if (!map.allFinite() || map(3, 3) == 0.0) return;
    map /= map(3, 3);
    Matching matching = Match(map, a_, b_, within_, std::min(needed_, needed_similar_));
    if (matching.count < std::min(needed_, needed_similar_)) return;
    const Eigen::Vector3d stretch =
        Eigen::JacobiSVD<Eigen::Matrix3d>(map.topLeftCorner<3, 3>()).singularValues();
    if (!(stretch(2) > 1e-3 * stretch(0))) return;
    const LookAlikeKind kind = KindOf(map, stretch, stretch_tolerance_);
    if (best_ && kind > best_->kind) return;
    if (matching.count < (kind <= LookAlikeKind::kMirror ? needed_similar_ : needed_)) return;
    if (best_ && kind == best_->kind && matching.count <= best_->matching.count) return;
    best_ = Best{map, stretch, kind, std::move(matching)};
  }

  const std::optional<Best>& best() const { return best_; }

 private:
  int Needed(double share) const {
    return static_cast<int>(std::ceil(share * static_cast<double>(std::max(a_.size(), b_.size()))));
  }

  const Vertices& a_;
  const Vertices& b_;
  double within_;
  int needed_;
  int needed_similar_;
  double stretch_tolerance_;
  std::optional<Best> best_;
};

// Four points as a frame in which a fifth one has coordinates.
struct Frame {
  explicit Frame(const Eigen::Matrix4d& points) : columns(points), inverse(points.inverse()) {}
  Eigen::Matrix4d columns;
  Eigen::Matrix4d inverse;
};

// The collineation that maps five points of a to five of b, given their frames and the fifth
// points' coordinates in them: scales of the four columns make the fifth fit.
std::optional<Eigen::Matrix4d> FivePointMap(const Frame& a,
                                            const Eigen::Vector4d& fifth_in_a,
                                            const Frame& b,
                                            const Eigen::Vector4d& fifth_in_b) {
  // A vanishing scale: the fifth point lies in a face of the tetrahedron.
  if (!(fifth_in_a.cwiseAbs().minCoeff() > 1e-6) || !(fifth_in_b.cwiseAbs().minCoeff() > 1e-6)) {
    return std::nullopt;
  }
  return b.columns * fifth_in_b.cwiseQuotient(fifth_in_a).asDiagonal() * a.inverse;
}

// Collineations keep the vertex graph. One fifth corner of a that is in general position against
// the start, every one of b.
void TryFivePointMaps(const ObjectModel& a,
                      const ObjectModel& b,
                      const FourVertices& start,
                      const std::vector<FourVertices>& chains_b,
                      Search* search) {
  const Frame from(Homogeneous(a.vertices, start));
  for (size_t fifth = 0; fifth < a.vertices.size(); ++fifth) {
    const Eigen::Vector4d in_a = from.inverse * a.vertices[fifth].homogeneous();
    if (!(in_a.cwiseAbs().minCoeff() > 1e-3)) continue;
    for (const FourVertices& chain : chains_b) {
      if (!(Volume(b.vertices, chain) > 1e-9 * std::pow(b.diameter_m, 3))) continue;
      const Frame to(Homogeneous(b.vertices, chain));
      for (const Eigen::Vector3d& b5 : b.vertices) {
        const auto map = FivePointMap(from, in_a, to, to.inverse * b5.homogeneous());
        if (map) search->Try(*map);
      }
    }
    return;
  }
}

LookAlike ToLookAlike(const Best& best, size_t vertices_a, size_t vertices_b) {
  LookAlike result;
  result.kind = best.kind;
  result.b_from_a = best.map;
  result.stretch = best.stretch;
  result.matched = best.matching.count;
  std::vector<char> taken(vertices_b, 0);
  for (size_t i = 0; i < vertices_a; ++i) {
    const int partner = best.matching.partner[i];
    if (partner < 0) {
      result.only_in_a.push_back(static_cast<int>(i));
    } else {
      taken[partner] = 1;
    }
  }
  for (size_t j = 0; j < vertices_b; ++j) {
    if (!taken[j]) result.only_in_b.push_back(static_cast<int>(j));
  }
  return result;
}

}  // namespace

std::optional<LookAlike> FindLookAlike(const ObjectModel& a,
                                       const ObjectModel& b,
                                       const LookAlikeOptions& options) {
  const size_t least = std::min(a.vertices.size(), b.vertices.size());
  const size_t most = std::max(a.vertices.size(), b.vertices.size());
  if (least < kMinVertices || most > kMaxComparedVertices || !(b.diameter_m > 0.0) ||
      static_cast<double>(least) < options.min_similar_share * static_cast<double>(most)) {
    return std::nullopt;
  }
  const std::vector<FourVertices> chains_a = VertexChains(a);
  std::vector<FourVertices> chains_b = Reversed(VertexChains(b));
  if (chains_a.empty() || chains_b.empty()) return std::nullopt;
  if (chains_b.size() > kMaxChains) chains_b.resize(kMaxChains);

  // Several starting chains, as one may touch corners that the other part lacks: the most spacious
  // ones that share no corner as far as possible.
  std::vector<FourVertices> starts = chains_a;
  std::sort(starts.begin(), starts.end(), [&](const FourVertices& x, const FourVertices& y) {
    return Volume(a.vertices, x) > Volume(a.vertices, y);
  });
  constexpr size_t kStarts = 4;  // sets of four vertices that are searched from; for time
  const double flat = 1e-6 * std::pow(a.diameter_m, 3);
  Search search(a, b, options);
  for (size_t s = 0; s < starts.size() && s < kStarts; ++s) {
    const FourVertices& start = starts[s * std::max<size_t>(1, starts.size() / 8) % starts.size()];
    if (!(Volume(a.vertices, start) > flat)) continue;
    const Eigen::Matrix4d inverse = Homogeneous(a.vertices, start).inverse();
    for (const FourVertices& chain : chains_b) {
      search.Try(Homogeneous(b.vertices, chain) * inverse);
    }
  }
  // Equal counts suggest one vertex graph.
  if (!search.best() && options.projective && a.vertices.size() == b.vertices.size() &&
      chains_a.size() * 2 == chains_b.size() && Volume(a.vertices, starts[0]) > flat) {
    TryFivePointMaps(a, b, starts[0], chains_b, &search);
  }
  if (!search.best()) return std::nullopt;
  return ToLookAlike(*search.best(), a.vertices.size(), b.vertices.size());
}

}  // namespace horopter
