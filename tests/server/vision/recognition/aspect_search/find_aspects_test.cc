#include "server/vision/recognition/aspect_search/find_aspects.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <vector>

#include "server/vision/recognition/aspect_search/object_ranking.h"
#include "server/vision/recognition/aspect_search/object_values.h"
#include "server/vision/recognition/aspect_search/pose_edges.h"
#include "server/vision/recognition/aspects/fragment_blob.h"
#include "tests/server/vision/recognition/aspect_search/find_aspects_fixture.h"
#include "tests/support/part_photos.h"
#include "tests/support/shaded_photo.h"
#include "tests/support/solid_meshes.h"

namespace horopter {
namespace {

TEST_F(FindAspects, EachPartIsFirstAtItsPose) {
  for (int part = 0; part < 3; ++part) {
    const AspectImage image = MakeAspectImage(Photo(part, Pose()));
    const AspectFindings found = FindAspectHypotheses(image, *index_);
    ASSERT_FALSE(found.hypotheses.empty()) << part;
    EXPECT_EQ(found.hypotheses[0].object, part);
    // Of the cylinder any turn is right; the nearest listed one may be 5 degrees off.
    EXPECT_LT(ErrorPx(found.hypotheses[0], Pose()), part == 2 ? 12.0 : 4.0) << part;
    EXPECT_GT(found.hypotheses[0].score, 0.5) << part;
    for (std::size_t i = 0; i < found.hypotheses.size(); ++i) {
      const AspectHypothesis& h = found.hypotheses[i];
      EXPECT_LE(h.score, found.hypotheses[i > 0 ? i - 1 : 0].score);
      for (std::size_t j = 0; j < i; ++j) {
        const AspectHypothesis& other = found.hypotheses[j];
        if (h.object != other.object) continue;
        EXPECT_GT(PoseDistancePx(list_[h.object],
                                 h.camera,
                                 h.camera_from_object,
                                 other.camera,
                                 other.camera_from_object),
                  1.0);
      }
    }
  }
}

// The image that is searched in a box of it alone, which is not in its middle.
AspectImage SearchedIn(const cv::Mat& image, const ImageBox& box) {
  const std::vector<cv::Mat> images = {image};
  const std::vector<std::optional<SearchedPart>> parts = {SearchedPart{{box}, {}, 1.0}};
  return MakeAspectImagesOnGround(images, {}, {}, 1, parts)[0];
}

TEST_F(FindAspects, APartOfTheImageShowsTheSamePoseAndFocalLength) {
  const cv::Mat photo = Photo(0, Pose());
  ImageBox box;
  for (const auto& v : list_[0].object->mesh.vertices)
    box.extend(Project(Camera(), Pose() * v.cast<double>()));
  box = {box.min() - Eigen::Vector2d::Constant(60.0), box.max() + Eigen::Vector2d::Constant(15.0)};
  const AspectImage whole = MakeAspectImage(photo), part = SearchedIn(photo, box);
  ASSERT_LT(part.width / part.working_from_image, 0.8 * whole.width / whole.working_from_image);
  ASSERT_GT(part.origin.norm(), 10.0);
  const AspectFindings there = FindAspectHypotheses(whole, *index_);
  const AspectFindings here = FindAspectHypotheses(part, *index_);
  ASSERT_FALSE(there.hypotheses.empty() || here.hypotheses.empty());
  EXPECT_EQ(here.hypotheses[0].object, 0);
  EXPECT_LT(ErrorPx(here.hypotheses[0], Pose()), 4.0);
  EXPECT_NEAR(
      std::log(here.hypotheses[0].camera.focal_px / there.hypotheses[0].camera.focal_px), 0.0, 0.1);
  // What is matched of it lies on it, in pixels of the image.
  const PinholeCamera camera = Camera();
  const auto matches =
      MatchPoseEdges(part, list_[0].object->mesh, camera, Pose(), PoseEdgeOptions());
  ASSERT_GT(matches.size(), 30u);
  for (const PoseEdgeMatch& m : matches) {
    EXPECT_LT((m.projected - Project(camera, Pose() * m.point)).norm(), 1e-3);
    EXPECT_NEAR(m.normal.dot(m.matched - m.projected), m.residual_px, 1e-6);
  }
}

TEST_F(FindAspects, BesideAPartThatIsSearchedNothingIsProposed) {
  const cv::Mat photo = Photo(0, Pose());
  ImageBox box;
  for (const auto& v : list_[0].object->mesh.vertices)
    box.extend(Project(Camera(), Pose() * v.cast<double>()));
  const ImageBox beside(Eigen::Vector2d(0.0, 0.0), box.min());
  ASSERT_FALSE(beside.isEmpty());
  EXPECT_TRUE(FindAspectHypotheses(SearchedIn(photo, beside), *index_).hypotheses.empty());
}

// Neither fragments nor pairs.
FindAspectOptions WithoutContours() {
  FindAspectOptions options;
  options.votes.min_fragment_px = 1e6;
  options.votes.max_pairs = 0;
  return options;
}

TEST_F(FindAspects, EllipsesOfARimAloneFindAPart) {
  std::vector<AspectModel> models = list_;
  for (const double end : {0.035, -0.035})
    models[2].rims.push_back({{0, 0, end}, Eigen::Vector3d::UnitZ(), 0.02, 0});
  const FragmentIndex index = BuildFragmentIndex(models);
  ASSERT_FALSE(index.ellipses.empty());
  FindAspectOptions options = WithoutContours();
  const AspectImage image = MakeAspectImage(Photo(2, Pose()));
  const AspectFindings found = FindAspectHypotheses(image, index, options);
  EXPECT_GE(found.votes.ellipses, 1);
  EXPECT_GT(found.votes.ellipse_matches, 0);
  ASSERT_FALSE(found.hypotheses.empty());
  EXPECT_EQ(found.hypotheses[0].object, 2);
  EXPECT_LT(ErrorPx(found.hypotheses[0], Pose()), 12.0);
}

TEST_F(FindAspects, AKnownCameraIsKept) {
  const PinholeCamera camera = Camera();
  const AspectFindings found =
      FindAspectHypotheses(MakeAspectImage(Photo(0, Pose())), *index_, {}, &camera);
  ASSERT_FALSE(found.hypotheses.empty());
  EXPECT_NEAR(found.hypotheses[0].camera.focal_px, camera.focal_px, 1e-9);
  EXPECT_LT((found.hypotheses[0].camera_from_object.t - Pose().t).norm(), 0.003);
}

TEST_F(FindAspects, ThreadsDoNotMatterToTheVotes) {
  const AspectImage image = MakeAspectImage(Photo(0, Pose()));
  AspectVoteOptions two;
  two.threads = 2;
  const AspectVotes a = VoteForAspects(image, *index_);
  const AspectVotes b = VoteForAspects(image, *index_, two);
  EXPECT_GT(a.matches, 0);
  EXPECT_EQ(a.matches, b.matches);
  EXPECT_EQ(a.accepted, b.accepted);
  for (std::size_t p = 0; p < a.of_model.size(); ++p) {
    ASSERT_EQ(a.of_model[p].size(), b.of_model[p].size());
    for (std::size_t i = 0; i < a.of_model[p].size(); ++i) {
      EXPECT_EQ(a.of_model[p][i].rank, b.of_model[p][i].rank);
      EXPECT_EQ(a.of_model[p][i].aspect, b.of_model[p][i].aspect);
    }
  }
}

TEST_F(FindAspects, GridFindsTheNearestOfALinearScan) {
  const std::vector<std::uint8_t> wanted = {1, 0, 1};
  const float radius = 0.5f;
  std::vector<std::uint32_t> found;
  std::size_t full = 0;
  for (std::size_t f = 0; f < index_->fragments.size(); f += 97) {
    FragmentKey key = UnpackKey(index_->keys[f]);
    key[f % kFragmentAngles] += 0.2f;
    const CoarseKeys::Key center = CoarseKeys::Coarse(PackKey(key));
    std::vector<std::pair<int, std::uint32_t>> near;
    for (std::uint32_t k = 0; k < index_->keys.size(); ++k) {
      if (index_->aspects[index_->fragments[k].aspect].model == 1) continue;
      const CoarseKeys::Key other = CoarseKeys::Coarse(index_->keys[k]);
      int sum = 0;
      for (int i = 0; i < kFragmentAngles; ++i)
        sum += (other[i] - center[i]) * (other[i] - center[i]);
      if (sum <= CoarseKeys::LimitOf(radius)) near.emplace_back(sum, k);
    }
    std::sort(near.begin(), near.end());
    for (const std::size_t most : {10u, 120u}) {
      const std::size_t count = std::min(most, near.size());
      found.clear();
      index_->FindNearest(key, radius, most, wanted, &found);
      ASSERT_EQ(found.size(), count);
      EXPECT_TRUE(std::is_sorted(found.begin(), found.end()));
      if (count == most) ++full;
      for (std::size_t i = 0; i < count; ++i)
        EXPECT_TRUE(std::binary_search(found.begin(), found.end(), near[i].second)) << i;
    }
  }
  EXPECT_GT(full, 10u);
}

TEST_F(FindAspects, PiecesMakeTheIndexOfTheirParts) {
  std::vector<FragmentPiece> pieces;
  for (const PhotoPart& p : *parts_) pieces.push_back(MakeFragmentPiece(p.object, p.fragments));
  const std::vector<const FragmentPiece*> pointers = {&pieces[0], nullptr, &pieces[2]};
  const FragmentIndex index = BuildFragmentIndex(pointers);
  EXPECT_EQ(index.model_count, 3);
  EXPECT_EQ(index.aspects.size(), pieces[0].aspects.size() + pieces[2].aspects.size());
  const AspectImage image = MakeAspectImage(Photo(0, Pose()));
  const std::vector<std::uint8_t> wanted = {1, 0, 1};
  const AspectVotes by_pieces = VoteForAspects(image, index);
  const AspectVotes by_parts = VoteForAspects(image, *index_, {}, {}, wanted);
  EXPECT_TRUE(by_parts.of_model[1].empty());
  ASSERT_FALSE(by_parts.of_model[0].empty());
  ASSERT_FALSE(by_pieces.of_model[0].empty());
  // The grids' axes differ, and with them which of common fragments are tested.
  EXPECT_EQ(by_parts.matches, by_pieces.matches);
  EXPECT_NEAR(by_parts.of_model[0][0].rank, by_pieces.of_model[0][0].rank, 60.0f);
}

TEST_F(FindAspects, ViewsOfAPieceAreApartAndCoverTheSphere) {
  const PhotoPart& part = (*parts_)[0];
  const FragmentChoice choice{.view_spacing_rad = 0.5, .fragments = 120};
  const FragmentPiece piece = MakeFragmentPiece(part.object, part.fragments, choice);
  EXPECT_LT(piece.aspects.size(), part.object.aspects.aspects.size());
  const auto cosine = [](const Eigen::Matrix3f& a, const Eigen::Matrix3f& b) {
    return a.row(2).dot(b.row(2));
  };
  const float near = static_cast<float>(std::cos(choice.view_spacing_rad));
  for (const Aspect& a : part.object.aspects.aspects) {
    int covered = 0;
    for (const IndexedAspect& b : piece.aspects)
      covered += cosine(a.camera_from_object, b.camera_from_object) >= near - 1e-5f ? 1 : 0;
    EXPECT_GE(covered, 1);
  }
  std::vector<int> fragments(piece.aspects.size(), 0);
  for (const FragmentPiece::Entry& e : piece.entries) ++fragments[e.fragment.aspect];
  for (std::size_t i = 0; i < piece.aspects.size(); ++i) {
    EXPECT_LE(fragments[i], 1 + choice.fragments / static_cast<int>(piece.aspects.size()));
    for (std::size_t j = 0; j < i; ++j) {
      EXPECT_LT(cosine(piece.aspects[i].camera_from_object, piece.aspects[j].camera_from_object),
                near + 1e-5f);
    }
  }
}

TEST_F(FindAspects, TheShownPartIsAmongTheFirstTwoOfThree) {
  std::vector<FragmentPiece> pieces;
  std::vector<const FragmentPiece*> pointers;
  for (const PhotoPart& p : *parts_)
    pieces.push_back(MakeFragmentPiece(p.object, p.fragments, kRankingChoice));
  for (const FragmentPiece& piece : pieces) pointers.push_back(&piece);
  const FragmentIndex index = BuildFragmentIndex(pointers);
  ObjectRankingOptions two;
  two.objects = 2;
  for (int part = 0; part < 3; ++part) {
    const std::vector<AspectImage> images = {MakeAspectImage(Photo(part, Pose()))};
    const std::vector<int> listed = RankObjects(images, index, two);
    EXPECT_EQ(listed.size(), 2u);
    EXPECT_EQ(std::count(listed.begin(), listed.end(), part), 1) << part;
    // What is not wanted is not listed, and what can be searched for as a whole is not ranked.
    std::vector<std::uint8_t> wanted = {1, 1, 1};
    wanted[part] = 0;
    const std::vector<int> others = RankObjects(images, index, {}, {}, wanted);
    EXPECT_EQ(others.size(), 2u);
    EXPECT_EQ(std::count(others.begin(), others.end(), part), 0);
  }
}

// What several indices say of their parts is put side by side as if one had said it.
TEST_F(FindAspects, ValuesOfPartsThatAreSharedOutListThemAsOneIndexDoes) {
  std::vector<FragmentPiece> pieces;
  for (const PhotoPart& p : *parts_)
    pieces.push_back(MakeFragmentPiece(p.object, p.fragments, kRankingChoice));
  const auto index_of = [&](std::vector<const FragmentPiece*> some) {
    return BuildFragmentIndex(some);
  };
  const FragmentIndex one = index_of({&pieces[0], &pieces[1], &pieces[2]});
  const FragmentIndex first = index_of({&pieces[0]}), others = index_of({&pieces[1], &pieces[2]});
  ObjectRankingOptions options;
  options.objects = 2;
  options.votes.max_matches = 1 << 20;  // else those of one index leave out more
  for (int part = 0; part < 3; ++part) {
    const std::vector<AspectImage> images = {MakeAspectImage(Photo(part, Pose()))};
    const auto together = ObjectValues(images, one, options);
    auto joined = ObjectValues(images, first, options);
    const auto more = ObjectValues(images, others, options);
    ASSERT_EQ(joined.size(), 1u);
    joined[0].insert(joined[0].end(), more[0].begin(), more[0].end());
    ASSERT_EQ(joined[0].size(), together[0].size());
    for (int k = 0; k < 3; ++k)
      EXPECT_NEAR(joined[0][k], together[0][k], 0.1f * together[0][k] + 1e-3f) << part << k;
    EXPECT_EQ(BestObjects(joined, options), RankObjects(images, one, options));
    // One that does not answer leaves its parts out and changes nothing for the others.
    joined[0][0] = 0.0f;
    const std::vector<int> left = BestObjects(joined, options);
    EXPECT_EQ(std::count(left.begin(), left.end(), 0), 0);
    if (part != 0) {
      EXPECT_EQ(left[0], part);
    }
  }
  EXPECT_TRUE(BestObjects({}, options).empty());
}

// A lump without one sharp edge: all it shows are contours.
TEST_F(FindAspects, ASmoothPartIsFoundByItsContours) {
  TriangleMesh lump = SphereMesh(1.0, 32);
  for (Eigen::Vector3d& p : lump.vertices) {
    const Eigen::Vector3d d = p.normalized();
    p = 0.02 * (1 + 0.6 * d.x() * d.x() * d.x() + 0.5 * d.y() * d.y() - 0.4 * d.z() * d.y()) * d;
  }
  const PhotoPart smooth = MakePart(lump);
  int creases = 0, points = 0;
  for (int a = 0; a < static_cast<int>(smooth.object.aspects.aspects.size()); a += 29) {
    for (const AspectPoint& p : AspectPoints(smooth.object.aspects, a)) {
      ++points;
      creases += p.kind == VisibleEdgeKind::kCrease ? 1 : 0;
    }
  }
  EXPECT_LT(creases, 0.1 * points);
  std::vector<AspectModel> parts = list_;
  parts.push_back({&smooth.object, &smooth.fragments, smooth.model.symmetries});
  const FragmentIndex index = BuildFragmentIndex(parts);
  int found_right = 0;
  for (const double tilt : {-2.2, -1.2, 0.4}) {
    Rigid3 pose = Pose();
    pose.R = Eigen::AngleAxisd(tilt, Eigen::Vector3d(1, 0.3, 0.2).normalized()).toRotationMatrix();
    const cv::Mat photo = ShadedPhoto({{&smooth.model.mesh, pose}}, Camera());
    const PinholeCamera camera = Camera();
    const AspectFindings found = FindAspectHypotheses(MakeAspectImage(photo), index, {}, &camera);
    ASSERT_FALSE(found.hypotheses.empty()) << tilt;
    EXPECT_EQ(found.hypotheses[0].object, 3) << tilt;
    // One outline has several lumps behind it: of the list one is right.
    for (const AspectHypothesis& h : found.hypotheses) {
      if (h.object != 3) continue;
      if (PoseDistancePx(parts[3], h.camera, h.camera_from_object, camera, pose) < 10.0) {
        ++found_right;
        break;
      }
    }
  }
  EXPECT_GE(found_right, 2);
}

TEST_F(FindAspects, NothingIsFoundInNothing) {
  EXPECT_TRUE(FindAspectHypotheses(MakeAspectImage(cv::Mat()), *index_).hypotheses.empty());
  const cv::Mat flat(480, 640, CV_8UC3, cv::Scalar(100, 100, 100));
  EXPECT_TRUE(FindAspectHypotheses(MakeAspectImage(flat), *index_).hypotheses.empty());
  const AspectImage image = MakeAspectImage(Photo(0, Pose()));
  EXPECT_TRUE(FindAspectHypotheses(image, FragmentIndex{}).hypotheses.empty());
}

TEST_F(FindAspects, NoiseIsNoPart) {
  cv::Mat noise(480, 640, CV_8UC3);
  cv::RNG random(11);
  random.fill(noise, cv::RNG::UNIFORM, 0, 255);
  cv::GaussianBlur(noise, noise, cv::Size(), 2.0);
  for (const AspectHypothesis& h :
       FindAspectHypotheses(MakeAspectImage(noise), *index_).hypotheses) {
    EXPECT_LT(h.score, 0.35);
  }
}

TEST_F(FindAspects, StopsWhenAsked) {
  const AspectImage image = MakeAspectImage(Photo(0, Pose()));
  const AspectFindings found =
      FindAspectHypotheses(image, *index_, {}, nullptr, [] { return true; });
  EXPECT_TRUE(found.hypotheses.empty());
  EXPECT_EQ(found.votes.matches, 0);
}

// Of a search that is overtaken the best votes so far are refined: few, and the part among them.
TEST_F(FindAspects, WhatIsVotedForByThenIsRefinedOnceTimeIsUp) {
  const AspectImage image = MakeAspectImage(Photo(0, Pose()));
  int looks = 0;  // of the votes alone: what is refined comes after them
  VoteForAspects(image, *index_, FindAspectOptions().votes, [&] {
    ++looks;
    return false;
  });
  ASSERT_GT(looks, 8);
  int found = 0;
  for (const int of_eight : {4, 6, 7}) {
    int left = looks * of_eight / 8;
    const AspectFindings some =
        FindAspectHypotheses(image, *index_, {}, nullptr, [&] { return left-- <= 0; });
    if (some.hypotheses.empty()) continue;
    ++found;
    EXPECT_LE(some.refined, 12) << of_eight;
    EXPECT_EQ(some.hypotheses[0].object, 0) << of_eight;
    EXPECT_LT(ErrorPx(some.hypotheses[0], Pose()), 6.0) << of_eight;
  }
  EXPECT_GE(found, 1);
}

TEST_F(FindAspects, RefinementReturnsToThePoseItWasMovedFrom) {
  const AspectImage image = MakeAspectImage(Photo(0, Pose()));
  Rigid3 moved = Pose();
  moved.R = Eigen::AngleAxisd(0.04, Eigen::Vector3d(1, 2, -1).normalized()) * moved.R;
  moved.t += Eigen::Vector3d(0.0012, -0.001, 0.004);
  const RenderMesh& mesh = (*parts_)[0].object.mesh;
  const RefinedAspect refined = RefinePose(image, mesh, Camera(), moved);
  const auto error = [&](const Rigid3& pose) {
    return PoseDistancePx(list_[0], Camera(), pose, Camera(), Pose());
  };
  EXPECT_GT(error(moved), 4.0);
  EXPECT_LT(error(refined.camera_from_object), 1.0);
  EXPECT_LT(refined.rms_px, 1.0);
  // There the edges meet the image's, and the score says so.
  int near = 0;
  const auto matches = MatchPoseEdges(image, mesh, Camera(), refined.camera_from_object);
  for (const PoseEdgeMatch& m : matches) {
    EXPECT_NEAR(m.residual_px, m.normal.dot(m.matched - m.projected), 1e-9);
    near += std::abs(m.residual_px) < 1.0 ? 1 : 0;
  }
  EXPECT_GT(near, 0.8 * matches.size());
  EXPECT_GT(ScorePose(image, mesh, Camera(), refined.camera_from_object).score,
            ScorePose(image, mesh, Camera(), moved).score + 0.1);
}

// What stands 20 px beside a part of 250 px is its own matter.
TEST_F(FindAspects, TheMarginOfALargePartIsBounded) {
  const PhotoPart& part = (*parts_)[0];
  Rigid3 pose = Pose();
  pose.t = {0.0, 0.0, 0.22};
  cv::Mat photo = Photo(0, pose);
  const AspectImage bare = MakeAspectImage(photo);
  float right = 0.0f;
  for (const ImageEdgePoint& e : bare.edges) right = std::max(right, e.point.x());
  cv::rectangle(photo, cv::Rect(static_cast<int>(right) + 20, 60, 12, 360), {255, 255, 255}, -1);
  const AspectImage beside = MakeAspectImage(photo);
  AspectScoreOptions unbounded;
  unbounded.max_margin_px = 1e3;
  const auto recall = [&](const AspectImage& image, const AspectScoreOptions& options) {
    return ScorePose(image, part.object.mesh, Camera(), pose, options).recall;
  };
  EXPECT_GT(beside.edges.size(), bare.edges.size() + 300);
  EXPECT_NEAR(recall(beside, {}), recall(bare, {}), 0.02);
  EXPECT_LT(recall(beside, unbounded), recall(bare, unbounded) - 0.05);
}

TEST(PresumedScore, IsOfPosesWhoseEdgesAreFoundAndOnlyEverMore) {
  EXPECT_EQ(PresumedScore(0.9, 0.3, 400.0, 0.7), ScoreOf(0.9, 0.7, 400.0));
  EXPECT_EQ(PresumedScore(0.9, 0.8, 400.0, 0.7), ScoreOf(0.9, 0.8, 400.0));
  EXPECT_EQ(PresumedScore(kPrintPrecision - 0.01, 0.3, 400.0, 0.7),
            ScoreOf(kPrintPrecision - 0.01, 0.3, 400.0));
}

TEST_F(FindAspects, FragmentsSurviveTheirBlob) {
  const PhotoPart& part = (*parts_)[0];
  const std::string blob = EncodeModelFragments(part.fragments, part.object.aspects);
  const auto back = DecodeModelFragments(blob, part.object.aspects);
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_TRUE(*back == part.fragments);
  EXPECT_EQ(DecodeModelFragments(blob, (*parts_)[1].object.aspects).status().code(),
            absl::StatusCode::kFailedPrecondition);
  std::string damaged = blob;
  damaged[blob.size() / 2] ^= 1;
  EXPECT_EQ(DecodeModelFragments(damaged, part.object.aspects).status().code(),
            absl::StatusCode::kDataLoss);
  for (const std::size_t size : {std::size_t{0}, std::size_t{23}, blob.size() - 1}) {
    EXPECT_FALSE(DecodeModelFragments(blob.substr(0, size), part.object.aspects).ok());
  }
}

TEST(FindAspectOptions, BriefIsNeverMoreThanWhatIsAskedFor) {
  FindAspectOptions little;
  little.votes.max_matches = little.votes.max_pair_matches = little.votes.max_ellipse_matches = 1;
  little.votes.max_per_object = little.coarse_per_object = little.fine_per_object = 1;
  const FindAspectOptions brief = Brief(little);
  EXPECT_EQ(brief.votes.max_matches, 1);
  EXPECT_EQ(brief.votes.max_pair_matches, 1);
  EXPECT_EQ(brief.votes.max_ellipse_matches, 1);
  EXPECT_EQ(brief.votes.max_per_object, 1);
  EXPECT_EQ(brief.coarse_per_object, 1);
  EXPECT_EQ(brief.fine_per_object, 1);
  EXPECT_LT(Brief({}).coarse_per_object, FindAspectOptions{}.coarse_per_object);
}

}  // namespace
}  // namespace horopter
