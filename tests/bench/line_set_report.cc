// Whether invariants of sets with lines would earn a table of the index: how
// many sets of a part are usable, and how many keys of other parts a measured one cannot be told
// from, beside six points.
//
//   line_set_report DATASET [SIGMA_MM]
//     SIGMA_MM   deviation of every corner and line end, each coordinate (default 0.15: half a
//                pixel in six views at 0.6 m)
#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/vision/invariants/line_sets.h"
#include "server/vision/invariants/six_points.h"

namespace horopter {
namespace {

using Points = std::vector<Eigen::Vector4d>;
using Lines = std::vector<Vector6d>;
// All readings of a set: one, but for six points.
using Readings = std::vector<InvariantKey>;

constexpr int kDraws = 4000;     // sets tried of a part
constexpr int kStored = 200;     // kept of them, as of six points in the catalog
constexpr int kAsked = 50;       // measured sets of a part
constexpr double kFloor = 1e-6;  // of a variance

struct Form {
  const char* name;
  int points;
  int lines;
  double gate;  // 95 % of chi-square with as many degrees of freedom as invariants
  std::function<Readings(const Points&, const Lines&, const Eigen::MatrixXd& covariance)> keys;
};

Readings One(std::optional<InvariantKey> key) {
  return key ? Readings{*std::move(key)} : Readings{};
}

template <size_t N, typename T>
std::span<const T, N> All(const std::vector<T>& items) {
  return std::span<const T, N>(items);
}

const std::vector<Form>& Forms() {
  using Covariance = const Eigen::MatrixXd&;
  static const std::vector<Form> forms{
      {"six points",
       6,
       0,
       7.81,
       [](const Points& p, const Lines&, Covariance c) {
         Readings readings;
         const auto found = InvariantsOfSixPoints(All<6>(p), c);
         if (!found || found->invariants != 3) return readings;
         for (const SixPointLabeling& l : found->labelings) readings.push_back(l.key);
         return readings;
       }},
      {"4 lines",
       0,
       4,
       5.99,
       [](const Points&, const Lines& l, Covariance c) { return One(FourLines(All<4>(l), c)); }},
      {"4 points, 1 line",
       4,
       1,
       3.84,
       [](const Points& p, const Lines& l, Covariance c) {
         return One(FourPointsOneLine(All<4>(p), l[0], c));
       }},
      {"3 points, 2 lines",
       3,
       2,
       5.99,
       [](const Points& p, const Lines& l, Covariance c) {
         return One(ThreePointsTwoLines(All<3>(p), All<2>(l), c));
       }},
      {"2 points, 3 lines",
       2,
       3,
       7.81,
       [](const Points& p, const Lines& l, Covariance c) {
         return One(TwoPointsThreeLines(All<2>(p), All<3>(l), c));
       }},
  };
  return forms;
}

// Coordinates of a set's points, then of its lines' ends, in diameters.
struct Set {
  Eigen::VectorXd coordinates;
};

// sigma: of every coordinate; 0: without covariance.
Readings KeysOf(const Form& form, const Eigen::VectorXd& x, double sigma) {
  Points points;
  Lines lines;
  const Eigen::Index size = 4 * form.points + 6 * form.lines;
  Eigen::MatrixXd covariance;
  if (sigma > 0.0) covariance = Eigen::MatrixXd::Zero(size, size);
  for (int i = 0; i < form.points; ++i) {
    points.push_back(x.segment<3>(3 * i).homogeneous());
    if (sigma > 0.0) {
      covariance.diagonal().segment<3>(4 * i).setConstant(sigma * sigma);
    }
  }
  for (int i = 0; i < form.lines; ++i) {
    const auto line = [](const Eigen::VectorXd& ends) -> Eigen::VectorXd {
      return LineThrough(ends.head<3>().homogeneous(), ends.tail<3>().homogeneous());
    };
    const Eigen::VectorXd ends = x.segment<6>(3 * form.points + 6 * i);
    lines.push_back(line(ends));
    if (sigma > 0.0) {
      const Eigen::Index at = 4 * form.points + 6 * i;
      covariance.block<6, 6>(at, at) =
          PropagateCovariance(line, ends, sigma * sigma * Eigen::MatrixXd::Identity(6, 6));
    }
  }
  return form.keys(points, lines, covariance);
}

struct Part {
  std::vector<Eigen::Vector3d> corners;               // in diameters
  std::vector<std::array<Eigen::Vector3d, 2>> edges;  // straight ones
  double diameter_mm = 0.0;
};

Part PartOf(const ObjectModel& model) {
  Part part;
  part.diameter_mm = 1e3 * model.diameter_m;
  for (const Eigen::Vector3d& v : model.vertices) part.corners.push_back(v / model.diameter_m);
  for (const ModelEdge& edge : model.edges) {
    if (edge.kind != CurveKind::kLine) continue;
    part.edges.push_back(
        {edge.polyline.front() / model.diameter_m, edge.polyline.back() / model.diameter_m});
  }
  return part;
}

// Random points and edges, all different. Empty: the part has too few.
std::optional<Set> Draw(const Part& part, const Form& form, std::mt19937& rng) {
  if (static_cast<int>(part.corners.size()) < form.points ||
      static_cast<int>(part.edges.size()) < form.lines) {
    return std::nullopt;
  }
  const auto different = [&](int count, size_t of) {
    std::vector<size_t> chosen;
    while (static_cast<int>(chosen.size()) < count) {
      const size_t i = rng() % of;
      if (std::find(chosen.begin(), chosen.end(), i) == chosen.end()) chosen.push_back(i);
    }
    return chosen;
  };
  Set set;
  set.coordinates.resize(3 * form.points + 6 * form.lines);
  Eigen::Index at = 0;
  const auto put = [&](const Eigen::Vector3d& p) {
    set.coordinates.segment<3>(at) = p;
    at += 3;
  };
  if (form.points > 0) {
    for (const size_t i : different(form.points, part.corners.size())) put(part.corners[i]);
  }
  if (form.lines > 0) {
    for (const size_t i : different(form.lines, part.edges.size())) {
      put(part.edges[i][0]);
      put(part.edges[i][1]);
    }
  }
  return set;
}

struct Stored {
  std::vector<Set> sets;
  std::vector<Eigen::VectorXd> keys;  // the first reading
  double usable = 0.0;                // share of the sets drawn
};

Stored StoredOf(const Part& part, const Form& form, std::mt19937& rng) {
  Stored stored;
  int usable = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    std::optional<Set> set = Draw(part, form, rng);
    if (!set) return stored;
    const Readings keys = KeysOf(form, set->coordinates, 0.0);
    if (keys.empty()) continue;
    ++usable;
    if (stored.keys.size() < kStored) {
      stored.keys.push_back(keys[0].values);
      stored.sets.push_back(*std::move(set));
    }
  }
  stored.usable = static_cast<double>(usable) / kDraws;
  return stored;
}

// The set measured with errors: its readings with the inverses of their covariances in place of
// these. Empty: degenerate.
Readings Measured(const Set& set, const Form& form, double sigma, std::mt19937& rng) {
  std::normal_distribution<double> noise(0.0, sigma);
  Eigen::VectorXd x = set.coordinates;
  for (double& c : x) c += noise(rng);
  Readings readings = KeysOf(form, x, sigma);
  for (InvariantKey& key : readings) {
    const Eigen::Index n = key.values.size();
    key.covariance = (key.covariance + kFloor * Eigen::MatrixXd::Identity(n, n)).inverse().eval();
  }
  return readings;
}

bool Meets(const Readings& query, const Eigen::VectorXd& key, double gate) {
  return std::any_of(query.begin(), query.end(), [&](const InvariantKey& reading) {
    const Eigen::VectorXd off = reading.values - key;
    return off.dot(reading.covariance * off) <= gate;
  });
}

void Report(const Form& form, const std::vector<Part>& parts, double sigma_mm) {
  std::mt19937 rng(1);
  std::vector<Stored> stored;
  std::vector<double> usable;
  size_t keys = 0;
  int with_keys = 0;
  for (const Part& part : parts) {
    stored.push_back(StoredOf(part, form, rng));
    usable.push_back(stored.back().usable);
    keys += stored.back().keys.size();
    with_keys += !stored.back().keys.empty();
  }
  std::vector<double> shares;
  int asked = 0, recalled = 0;
  for (size_t p = 0; p < parts.size(); ++p) {
    const size_t count = stored[p].sets.size();
    for (size_t q = 0; q < std::min<size_t>(count, kAsked); ++q) {
      const Readings query =
          Measured(stored[p].sets[q], form, sigma_mm / parts[p].diameter_mm, rng);
      ++asked;
      if (query.empty()) continue;
      recalled += Meets(query, stored[p].keys[q], form.gate);
      size_t foreign = 0, met = 0;
      for (size_t o = 0; o < parts.size(); ++o) {
        if (o == p) continue;
        for (const Eigen::VectorXd& key : stored[o].keys) met += Meets(query, key, form.gate);
        foreign += stored[o].keys.size();
      }
      if (foreign > 0) {
        shares.push_back(static_cast<double>(met) / static_cast<double>(foreign));
      }
    }
  }
  std::sort(usable.begin(), usable.end());
  std::sort(shares.begin(), shares.end());
  double mean = 0.0;
  for (const double s : shares) mean += s / static_cast<double>(shares.size());
  std::printf("| %s | %.3f | %d of %zu | %zu | %.2f | %.4f | %.4f |\n",
              form.name,
              usable[usable.size() / 2],
              with_keys,
              parts.size(),
              keys,
              asked > 0 ? static_cast<double>(recalled) / asked : 0.0,
              shares.empty() ? 0.0 : shares[shares.size() / 2],
              mean);
  std::fflush(stdout);
}

int Main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: line_set_report DATASET [SIGMA_MM]\n");
    return 2;
  }
  const double sigma_mm = argc > 2 ? std::atof(argv[2]) : 0.15;
  const auto dataset = ReadBopDataset(argv[1]);
  if (!dataset.ok()) {
    std::fprintf(stderr, "%s\n", dataset.status().ToString().c_str());
    return 1;
  }
  std::vector<Part> parts;
  for (const BopObject& object : dataset->objects) {
    const auto cad = ImportCad(object.cad_path.empty() ? object.mesh_path : object.cad_path, {});
    if (cad.ok()) parts.push_back(PartOf(cad->model));
  }
  if (parts.empty()) return 1;
  std::printf("%zu parts, deviation %.2f mm\n", parts.size(), sigma_mm);
  std::printf(
      "| set | usable, median part | parts with any | keys | recall | foreign keys in the gate, "
      "median | mean |\n|---|---|---|---|---|---|---|\n");
  for (const Form& form : Forms()) Report(form, parts, sigma_mm);
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
