#include "server/vision/invariants/line_sets.h"

#include <gtest/gtest.h>

#include <Eigen/SVD>
#include <algorithm>
#include <functional>

#include "tests/server/vision/invariants/random_space.h"

namespace horopter {
namespace {

struct Set {
  std::vector<Eigen::Vector4d> points;
  std::vector<Vector6d> lines;
};

struct Form {
  const char* name;
  int points;
  int lines;
  int values;
  int rank;  // independent invariants
  std::function<std::optional<InvariantKey>(
      const Set&, const Eigen::MatrixXd&, const LineSetOptions&)>
      key;
};

template <size_t N, typename T>
std::span<const T, N> First(const std::vector<T>& v) {
  return std::span<const T, N>(v.data(), N);
}

const std::vector<Form>& Forms() {
  static const std::vector<Form> kForms = {
      {"4 lines",
       0,
       4,
       2,
       2,
       [](const Set& s, const Eigen::MatrixXd& c, const LineSetOptions& o) {
         return FourLines(First<4>(s.lines), c, o);
       }},
      {"4 points 1 line",
       4,
       1,
       1,
       1,
       [](const Set& s, const Eigen::MatrixXd& c, const LineSetOptions& o) {
         return FourPointsOneLine(First<4>(s.points), s.lines[0], c, o);
       }},
      {"3 points 2 lines",
       3,
       2,
       2,
       2,
       [](const Set& s, const Eigen::MatrixXd& c, const LineSetOptions& o) {
         return ThreePointsTwoLines(First<3>(s.points), First<2>(s.lines), c, o);
       }},
      {"2 points 3 lines",
       2,
       3,
       3,
       3,
       [](const Set& s, const Eigen::MatrixXd& c, const LineSetOptions& o) {
         return TwoPointsThreeLines(First<2>(s.points), First<3>(s.lines), c, o);
       }},
      {"5 points 1 line",
       5,
       1,
       10,
       4,
       [](const Set& s, const Eigen::MatrixXd& c, const LineSetOptions& o) {
         return FivePointsOneLine(First<5>(s.points), s.lines[0], c, o);
       }},
  };
  return kForms;
}

Set RandomSet(const Form& form, RandomSpace& space) {
  Set set;
  for (int i = 0; i < form.points; ++i) set.points.push_back(space.Point());
  for (int i = 0; i < form.lines; ++i) set.lines.push_back(space.Line());
  return set;
}

class LineSetsTest : public ::testing::TestWithParam<int> {
 protected:
  const Form& form() const { return Forms()[GetParam()]; }
};

TEST_P(LineSetsTest, KeySurvivesCollineationsScalesAndOrders) {
  RandomSpace space(20 + GetParam());
  int kept = 0;
  for (int trial = 0; trial < 500; ++trial) {
    Set set = RandomSet(form(), space);
    const auto before = form().key(set, {}, {.min_ratio = 0.05});
    if (!before) continue;
    ++kept;
    ASSERT_EQ(before->values.size(), form().values);
    const Eigen::Matrix4d h = space.Collineation();
    for (auto& p : set.points) p = space.Scale() * h * p;
    for (auto& l : set.lines) l = space.Scale() * TransformLine(h, l);
    std::shuffle(set.points.begin(), set.points.end(), space.rng());
    std::shuffle(set.lines.begin(), set.lines.end(), space.rng());
    const auto after = form().key(set, {}, {.min_ratio = 0.0});
    ASSERT_TRUE(after) << form().name << " trial " << trial;
    EXPECT_LT((after->values - before->values).norm(), 1e-6) << form().name << " trial " << trial;
  }
  EXPECT_GT(kept, 50) << form().name;
}

TEST_P(LineSetsTest, HasAsManyIndependentInvariantsAsTheParameterCountSays) {
  RandomSpace space(40 + GetParam());
  for (int found = 0; found < 5;) {
    const Set set = RandomSet(form(), space);
    const Eigen::Index n = 4 * form().points + 6 * form().lines;
    const auto key = form().key(set, Eigen::MatrixXd::Identity(n, n), {.min_ratio = 0.1});
    if (!key) continue;
    ++found;
    const Eigen::VectorXd spread =
        Eigen::JacobiSVD<Eigen::MatrixXd>(key->covariance).singularValues();
    const double threshold = 1e-9 * spread(0);
    EXPECT_EQ((spread.array() > threshold).count(), form().rank)
        << form().name << " " << spread.transpose();
  }
}

TEST_P(LineSetsTest, CovarianceIsWhatNoiseShows) {
  RandomSpace space(60 + GetParam());
  constexpr double kSigma = 1e-5;
  for (int found = 0; found < 3;) {
    const Set set = RandomSet(form(), space);
    const Eigen::Index n = 4 * form().points + 6 * form().lines;
    const auto stated =
        form().key(set, kSigma * kSigma * Eigen::MatrixXd::Identity(n, n), {.min_ratio = 0.15});
    if (!stated) continue;
    std::vector<Eigen::VectorXd> samples;
    for (int k = 0; k < 2000; ++k) {
      Set noisy = set;
      for (auto& p : noisy.points) p += kSigma * space.Noise(4);
      for (auto& l : noisy.lines) {
        Vector6d normal;  // of the Klein quadric: noise along it makes no line
        normal << l.tail<3>(), l.head<3>();
        normal.normalize();
        Vector6d noise = kSigma * space.Noise(6);
        noise -= normal * normal.dot(noise);
        l += noise;
      }
      const auto key = form().key(noisy, {}, {.min_ratio = 0.0});
      ASSERT_TRUE(key);
      samples.push_back(key->values);
    }
    // A value next to a fold or to its neighbour is not linear at any noise: such sets are skipped.
    const double deviation = std::sqrt(stated->covariance.diagonal().maxCoeff());
    bool near_fold = false;
    for (Eigen::Index i = 0; i < stated->values.size(); ++i) {
      const double v = stated->values(i);
      near_fold |= std::abs(v) < 8 * deviation || std::abs(v - M_PI / 3) < 8 * deviation;
      near_fold |= i > 0 && v - stated->values(i - 1) < 8 * deviation;
    }
    if (near_fold) continue;
    ++found;
    EXPECT_LT(CovarianceError(samples, stated->covariance), 0.15) << form().name;
  }
}

TEST_P(LineSetsTest, RejectsDegenerateSets) {
  RandomSpace space(80 + GetParam());
  Set set = RandomSet(form(), space);
  if (form().lines >= 2) {
    set.lines[1] = set.lines[0];  // coincident lines
  } else {
    set.lines[0] = LineThrough(set.points[0], space.Point());  // the line meets a point
  }
  EXPECT_FALSE(form().key(set, {}, {})) << form().name;
}

INSTANTIATE_TEST_SUITE_P(All, LineSetsTest, ::testing::Range(0, 5));

TEST(FourLinesTest, MeetingLinesAreRejected) {
  RandomSpace space(90);
  const Eigen::Vector4d corner = space.Point();
  const std::array<Vector6d, 4> lines{LineThrough(corner, space.Point()),
                                      LineThrough(corner, space.Point()),
                                      space.Line(),
                                      space.Line()};
  EXPECT_FALSE(FourLines(lines));
}

}  // namespace
}  // namespace horopter
