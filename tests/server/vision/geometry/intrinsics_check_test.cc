#include "server/vision/geometry/intrinsics_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

namespace horopter {
namespace {

using testing::HasSubstr;
using testing::Optional;

TEST(CameraMatrix, OnlyThePatternOfOneIsTaken) {
  using K = std::array<double, 9>;
  EXPECT_EQ(FaultOfCameraMatrix(K{980, 0, 320, 0, 970, 240, 0, 0, 1}), std::nullopt);
  EXPECT_EQ(FaultOfCameraMatrix(K{980, 0.5, 0, 0, 500, 0, 0, 1e-9, 1}), std::nullopt);
  EXPECT_THAT(FaultOfCameraMatrix(K{980, 0, 0, 0, 980, 0, 320, 240, 1}),
              Optional(HasSubstr("transposed")));
  EXPECT_THAT(FaultOfCameraMatrix(K{980, 0, 0, 3, 980, 0, 320, 240, 1}),
              Optional(HasSubstr("transposed")));
  EXPECT_THAT(FaultOfCameraMatrix(K{}), Optional(HasSubstr("not calibrated")));
  for (const K& bad : {K{980, 0, 320, 0, 980, 240, 0, 0, 0},
                       K{980, 0, 320, 0, 980, 240, 0, 0, 980},
                       K{980, 0, 320, 0, 980, 240, 1e-3, 0, 1},
                       K{980, 0, 320, 5, 980, 240, 0, 0, 1},
                       K{0, 0, 320, 0, 980, 240, 0, 0, 1},
                       K{980, 0, 320, 0, -980, 240, 0, 0, 1},
                       K{980, 0, 320, 0, 480, 240, 0, 0, 1},
                       K{480, 0, 320, 0, 980, 240, 0, 0, 1},
                       K{NAN, 0, 320, 0, 980, 240, 0, 0, 1},
                       K{980, 0, INFINITY, 0, 980, 240, 0, 0, 1}})
    EXPECT_NE(FaultOfCameraMatrix(bad), std::nullopt);
}

LensModel Lens(double f, double cx, double cy) {
  LensModel lens;
  lens.fx = lens.fy = f;
  lens.cx = cx;
  lens.cy = cy;
  return lens;
}

TEST(Lens, FocalLengthAndCentreAreThoseOfAnImage) {
  const auto part = [](const LensModel& lens, bool cropped = false) -> std::optional<LensPart> {
    const auto fault = FaultOfLens(lens, 640, 480, cropped);
    if (!fault) return std::nullopt;
    return fault->part;
  };
  EXPECT_EQ(part(Lens(128.0, 320, 240)), std::nullopt);
  EXPECT_EQ(part(Lens(25600.0, 320, 240)), std::nullopt);
  EXPECT_EQ(part(Lens(127.0, 320, 240)), LensPart::kFocal);
  EXPECT_EQ(part(Lens(25700.0, 320, 240)), LensPart::kFocal);
  EXPECT_EQ(part(Lens(25700.0, 320, 240), true), std::nullopt);
  EXPECT_EQ(part(Lens(NAN, 320, 240)), LensPart::kFocal);
  EXPECT_EQ(part(Lens(980, -1, 240)), LensPart::kCenter);
  EXPECT_EQ(part(Lens(980, 320, 480)), LensPart::kCenter);
  EXPECT_EQ(part(Lens(980, 320, 480), true), std::nullopt);
  EXPECT_EQ(part(Lens(980, NAN, 480), true), LensPart::kCenter);
  LensModel oblong = Lens(980, 320, 240);
  oblong.fy = 450;
  EXPECT_EQ(part(oblong), LensPart::kAspect);
}

// The radial part of a lens grows up to the corners, or it shows the same pixels twice.
TEST(Lens, ThatFoldsTheImageIsNone) {
  const auto folds = [](LensModel::Kind kind, std::array<double, 5> d, std::array<double, 3> q) {
    LensModel lens = Lens(500, 320, 240);  // its corners are at 0.8 focal lengths
    lens.kind = kind;
    lens.coefficients = d;
    lens.denominator = q;
    return FoldsImage(lens, 640, 480);
  };
  using Kind = LensModel::Kind;
  EXPECT_FALSE(folds(Kind::kPlumbBob, {}, {}));
  EXPECT_FALSE(folds(Kind::kPlumbBob, {-0.2}, {}));         // at 0.86
  EXPECT_TRUE(folds(Kind::kPlumbBob, {-0.35}, {}));         // at 0.65
  EXPECT_FALSE(folds(Kind::kPlumbBob, {-0.35, 0.15}, {}));  // as real lenses have it
  EXPECT_TRUE(folds(Kind::kPlumbBob, {0.0, -1.0}, {}));
  EXPECT_FALSE(folds(Kind::kPlumbBob, {0.5, 0.0}, {}));
  EXPECT_FALSE(folds(Kind::kPlumbBob, {8.2, 3.1, 0, 0, 0.1}, {8.5, 5.2, 0.6}));
  EXPECT_TRUE(folds(Kind::kPlumbBob, {}, {4.0, 0.0, 0.0}));
  EXPECT_FALSE(folds(Kind::kEquidistant, {}, {}));
  EXPECT_FALSE(folds(Kind::kEquidistant, {-0.01, 0.05}, {}));
  EXPECT_TRUE(folds(Kind::kEquidistant, {-1.0}, {}));
}

}  // namespace
}  // namespace horopter
