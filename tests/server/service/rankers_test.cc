#include "server/service/rankers.h"

#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <filesystem>
#include <limits>
#include <opencv2/core.hpp>
#include <thread>

#include "absl/strings/str_cat.h"
#include "server/service/ranking_convert.h"
#include "server/service/ranking_service.h"
#include "tests/support/fake_objects.h"
#include "tests/support/sample_record.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

// A ranker of a test's answer, on a port of its own.
class TestRanker {
 public:
  explicit TestRanker(PartRanker rank, int port = 0) : pool_(2, 8), memory_(int64_t{1} << 26) {
    access_ = *Access::Open({});
    service_ = std::make_unique<RankingService>(
        std::move(rank), CallGate{&pool_, &memory_, access_.get(), nullptr}, int64_t{8} << 20);
    grpc::ServerBuilder builder;
    builder.AddListeningPort(
        absl::StrCat("127.0.0.1:", port), grpc::InsecureServerCredentials(), &port_);
    builder.RegisterService(service_.get());
    server_ = builder.BuildAndStart();
  }
  ~TestRanker() {
    server_->Shutdown(std::chrono::system_clock::now());
    server_->Wait();
  }
  std::string address() const { return absl::StrCat("127.0.0.1:", port_); }

 private:
  WorkerPool pool_;
  MemoryBudget memory_;
  std::unique_ptr<Access> access_;
  std::unique_ptr<RankingService> service_;
  std::unique_ptr<grpc::Server> server_;
  int port_ = 0;
};

// Shard `number` of `count` has one part, whose value in each image is its number.
PartRanker OnePart(int number, int count) {
  return [=](std::span<const RankingImage> images, const StopRequested&) {
    ShardAnswer answer;
    answer.shard = {number, count};
    answer.part_count = 1;
    answer.parts.push_back({absl::StrCat("part", number),
                            std::vector<float>(images.size(), static_cast<float>(number))});
    return answer;
  };
}

std::vector<RankingImage> SomeImages() {
  RankingImage image;
  image.width = 64;
  image.height = 48;
  image.edges.push_back({{10.25f, 20.5f}, {0.6f, 0.8f}, 0.0f});
  ContourFragment f;
  f.key = {0.1f, -0.2f, 0.3f, -0.4f, 0.5f, -0.6f, 0.7f, -0.8f};
  f.center = {12.0f, 13.0f};
  f.pivot = {14.0f, 15.0f};
  f.spread = 16.5f;
  f.chord_rad = -1.25f;
  image.fragments.push_back(f);
  return {image, image};
}

RankerOptions OptionsFor(const std::vector<std::string>& addresses) {
  RankerOptions options;
  options.addresses = addresses;
  options.seconds = 20.0;
  return options;
}

TEST(RankingConvert, TheQuestionIsThatWhichIsAsked) {
  const auto asked = SomeImages();
  const auto read = RankingQuestionFromProto(RankingQuestionToProto(asked));
  ASSERT_TRUE(read.ok()) << read.status();
  ASSERT_EQ(read->size(), asked.size());
  for (std::size_t i = 0; i < asked.size(); ++i) {
    EXPECT_EQ((*read)[i].width, asked[i].width);
    EXPECT_EQ((*read)[i].height, asked[i].height);
    ASSERT_EQ((*read)[i].edges.size(), 1u);
    EXPECT_EQ((*read)[i].edges[0].point, asked[i].edges[0].point);
    EXPECT_EQ((*read)[i].edges[0].normal, asked[i].edges[0].normal);
    ASSERT_EQ((*read)[i].fragments.size(), 1u);
    const ContourFragment &a = (*read)[i].fragments[0], &b = asked[i].fragments[0];
    EXPECT_EQ(a.key, b.key);
    EXPECT_EQ(a.center, b.center);
    EXPECT_EQ(a.pivot, b.pivot);
    EXPECT_EQ(a.spread, b.spread);
    EXPECT_EQ(a.chord_rad, b.chord_rad);
  }
}

TEST(RankingConvert, WhatIsNoQuestionIsRefusedByItsField) {
  const v1::RankPartsRequest good = RankingQuestionToProto(SomeImages());
  const auto refused = [&](const std::function<void(v1::RankPartsRequest*)>& change) {
    v1::RankPartsRequest request = good;
    change(&request);
    return RankingQuestionFromProto(request).status().code() == absl::StatusCode::kInvalidArgument;
  };
  const float none = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(refused([](auto* r) { r->clear_images(); }));
  EXPECT_TRUE(refused([&](auto* r) {
    for (int i = 0; i < 20; ++i) *r->add_images() = good.images(0);
  }));
  EXPECT_TRUE(refused([](auto* r) { r->mutable_images(0)->set_width_px(0); }));
  EXPECT_TRUE(refused([](auto* r) { r->mutable_images(1)->set_height_px(1 << 30); }));
  EXPECT_TRUE(refused([](auto* r) { r->mutable_images(0)->add_edges(1.0f); }));
  EXPECT_TRUE(refused([](auto* r) { r->mutable_images(0)->set_edges(0, 63.6f); }));
  EXPECT_TRUE(refused([](auto* r) { r->mutable_images(0)->set_edges(1, -0.6f); }));
  EXPECT_TRUE(refused([&](auto* r) { r->mutable_images(0)->set_edges(2, none); }));
  EXPECT_TRUE(refused([](auto* r) { r->mutable_images(0)->add_fragments(1.0f); }));
  EXPECT_TRUE(refused([&](auto* r) { r->mutable_images(0)->set_fragments(9, none); }));
  EXPECT_TRUE(refused([](auto* r) { r->mutable_images(0)->set_fragments(0, 1e9f); }));
  EXPECT_TRUE(refused([](auto* r) { r->mutable_images(0)->set_fragments(12, 0.0f); }));
}

TEST(Rankers, WhatAllShardsSayIsListedBestFirst) {
  const TestRanker one(OnePart(1, 3)), two(OnePart(2, 3)), three(OnePart(3, 3));
  const auto rankers = Rankers::Create(OptionsFor({one.address(), two.address(), three.address()}));
  ASSERT_TRUE(rankers.ok()) << rankers.status();
  const auto ranked = (*rankers)->Rank(SomeImages(), {});
  ASSERT_TRUE(ranked.ok()) << ranked.status();
  EXPECT_EQ(ranked->ids, (std::vector<std::string>{"part3", "part2", "part1"}));
  EXPECT_TRUE(ranked->lost.empty());
}

TEST(Rankers, AShardThatIsLostIsNamedAndTheOthersAreListed) {
  const TestRanker one(OnePart(1, 3)), three(OnePart(3, 3));
  auto two = std::make_unique<TestRanker>(OnePart(2, 3));
  const std::string address = two->address();
  const auto rankers = *Rankers::Create(OptionsFor({one.address(), address, three.address()}));
  EXPECT_EQ(rankers->Rank(SomeImages(), {})->ids.size(), 3u);
  two.reset();
  for (int i = 0; i < 5; ++i) {
    const auto ranked = rankers->Rank(SomeImages(), {});
    ASSERT_TRUE(ranked.ok()) << ranked.status();
    EXPECT_EQ(ranked->ids, (std::vector<std::string>{"part3", "part1"}));
    ASSERT_EQ(ranked->lost.size(), 1u);
    EXPECT_EQ(ranked->lost.begin()->first, 2);
  }
}

TEST(Rankers, WhoIsLateIsDoneWithout) {
  std::atomic<bool> over = false;
  const TestRanker one(OnePart(1, 2));
  const TestRanker two([&](std::span<const RankingImage>, const StopRequested& stop) {
    while (!stop()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    over = true;
    return ShardAnswer{};
  });
  RankerOptions options = OptionsFor({one.address(), two.address()});
  options.seconds = 2.0;
  const auto ranked = (*Rankers::Create(options))->Rank(SomeImages(), {});
  ASSERT_TRUE(ranked.ok()) << ranked.status();
  EXPECT_EQ(ranked->ids, (std::vector<std::string>{"part1"}));
  EXPECT_EQ(ranked->lost.count(2), 1u);
  for (int i = 0; i < 20000 && !over; ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  EXPECT_TRUE(over) << "what nobody waits for any more goes on";
}

TEST(Rankers, AnotherShardThanTheOneAskedIsNone) {
  const TestRanker one(OnePart(1, 2)), wrong(OnePart(1, 2));
  const auto ranked =
      (*Rankers::Create(OptionsFor({one.address(), wrong.address()})))->Rank(SomeImages(), {});
  ASSERT_TRUE(ranked.ok());
  EXPECT_EQ(ranked->ids.size(), 1u);
  ASSERT_EQ(ranked->lost.count(2), 1u);
  EXPECT_EQ(ranked->lost.at(2).message(), "it is shard 1 of 2");
}

TEST(Rankers, WithoutAnyTheCallIsUnavailable) {
  const TestRanker server({});
  const auto rankers = *Rankers::Create(OptionsFor({server.address()}));
  const absl::Status status = rankers->Rank(SomeImages(), {}).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable);
  EXPECT_NE(status.message().find("no ranker (--role ranker)"), absl::string_view::npos) << status;
  CallLimits stopped;
  stopped.stop = [] { return true; };
  EXPECT_EQ(rankers->Rank(SomeImages(), stopped).status().code(), absl::StatusCode::kCancelled);
}

TEST(Rankers, OptionsThatCannotBeAreRefusedByName) {
  RankerOptions options = OptionsFor({"localhost:0"});
  EXPECT_NE(Validate(options).message().find("rankers"), absl::string_view::npos);
  options = OptionsFor({});
  options.seconds = 0.0;
  EXPECT_NE(Validate(options).message().find("ranker-seconds"), absl::string_view::npos);
  options = OptionsFor({"localhost:1"});
  options.token_file = "/nowhere";
  EXPECT_EQ(Rankers::Create(options).status().code(), absl::StatusCode::kFailedPrecondition);
  options = OptionsFor({"localhost:1"});
  options.ca = "/nowhere";
  EXPECT_EQ(Rankers::Create(options).status().code(), absl::StatusCode::kFailedPrecondition);
}

// A catalog that is not in memory, so that nobody looks into the test's objects.
CatalogSnapshot SnapshotOf(const std::vector<std::string>& ids) {
  CatalogSnapshot snapshot;
  for (const std::string& id : ids) {
    snapshot.stored.push_back(std::make_shared<const StoredObject>(
        id, [](const std::string&) { return absl::UnknownError("not read"); }));
  }
  return snapshot;
}

class RankedRecognizerTest : public ::testing::Test {
 protected:
  RankedRecognizerTest() {
    request_.images.push_back(cv::Mat::zeros(48, 64, CV_8UC1));
    recognizer_ = [this](const SceneRequest& request, const CatalogSnapshot&, const CallLimits&) {
      asked_ = request.candidates;
      return PipelineResult();
    };
  }

  absl::StatusOr<PipelineResult> Ask(const std::vector<std::string>& addresses, int above) {
    RankerOptions options = OptionsFor(addresses);
    options.above = above;
    return RankedRecognizer(recognizer_, *Rankers::Create(options))(request_, snapshot_, {});
  }

  const CatalogSnapshot snapshot_ = SnapshotOf({"other", "part1", "part2"});
  Recognizer recognizer_;
  SceneRequest request_;
  std::vector<std::string> asked_;
};

TEST_F(RankedRecognizerTest, ARequestWithoutCandidatesIsOneOverTheListedPartsThatAreThere) {
  // The catalog does not hold part 3: the ranker is ahead of it.
  const TestRanker one(OnePart(1, 3)), two(OnePart(2, 3)), three(OnePart(3, 3));
  const auto result = Ask({one.address(), two.address(), three.address()}, 2);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(asked_, (std::vector<std::string>{"part2", "part1"}));
  EXPECT_TRUE(result->answer.unsearched.empty());
  EXPECT_FALSE(result->answer.time_limited);
  ASSERT_EQ(result->answer.stages.size(), 1u);
  EXPECT_EQ(result->answer.stages[0].stage, "ranking");
  EXPECT_EQ(result->answer.stages[0].counts.at("parts_listed"), 2.0);
}

TEST_F(RankedRecognizerTest, WhatALostRankerHasIsSaidToBeUnsearched) {
  const TestRanker one(OnePart(1, 2)), no({});
  const auto result = Ask({one.address(), no.address()}, 2);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(asked_, (std::vector<std::string>{"part1"}));
  ASSERT_EQ(result->answer.unsearched.size(), 1u);
  EXPECT_EQ(result->answer.unsearched[0].step, "ranker 2 of 2");
  EXPECT_EQ(result->answer.unsearched[0].cause, UnsearchedCause::kUnavailable);
  EXPECT_TRUE(result->answer.time_limited);
}

TEST_F(RankedRecognizerTest, RequestsWithCandidatesAndSmallCatalogsAskNobody) {
  // Nobody is there to be asked.
  const auto small = Ask({"127.0.0.1:1"}, 3);
  ASSERT_TRUE(small.ok()) << small.status();
  EXPECT_TRUE(asked_.empty());
  request_.candidates = {"part2"};
  const auto named = Ask({"127.0.0.1:1"}, 0);
  ASSERT_TRUE(named.ok()) << named.status();
  EXPECT_EQ(asked_, request_.candidates);
  request_.candidates.clear();
  EXPECT_EQ(Ask({"127.0.0.1:1"}, 0).status().code(), absl::StatusCode::kUnavailable);
}

TEST_F(RankedRecognizerTest, OfImagesThatShowNothingSomeObjectIsLookedFor) {
  const TestRanker none([](std::span<const RankingImage>, const StopRequested&) {
    ShardAnswer answer;
    answer.shard = {1, 1};
    return answer;
  });
  ASSERT_TRUE(Ask({none.address()}, 0).ok());
  EXPECT_EQ(asked_, (std::vector<std::string>{"other"}));
}

TEST(ParseShard, IsOneOfSome) {
  EXPECT_EQ(ParseShard("2/4")->number, 2);
  EXPECT_EQ(ParseShard("2/4")->count, 4);
  for (const char* text : {"", "1", "0/4", "5/4", "1/0", "a/b", "1/2/3", "1/100000", "-1/2"})
    EXPECT_EQ(ParseShard(text).status().code(), absl::StatusCode::kInvalidArgument) << text;
}

TEST(ShardOf, SharesOutEvenlyAndEachToOne) {
  std::vector<int> parts(8, 0);
  for (int i = 0; i < 8000; ++i) ++parts[ShardOf(absl::StrCat("part-", i), 8)];
  for (const int n : parts) EXPECT_NEAR(n, 1000, 150);
}

// Shards over a catalog of objects whose pieces say which they are: piece of an object with `n`
// letters in its display name has n fragments.
class RankingShardTest : public ::testing::Test {
 protected:
  static PackedPiece PieceOf(const PreparedObject& object) {
    PackedPiece piece;
    piece.views.resize(1);
    piece.fragments.resize(ModelOfFake(object).display_name.size());
    return piece;
  }

  void Load(int max_resident) {
    store_.reset();
    auto catalog = Catalog::Open(dir_.File("parts.db"));
    ASSERT_TRUE(catalog.ok()) << catalog.status();
    StoreOptions options;
    options.max_resident = max_resident;
    auto store = CatalogStore::Load(*std::move(catalog), FakePreparer(), options);
    ASSERT_TRUE(store.ok()) << store.status();
    store_ = *std::move(store);
  }

  std::unique_ptr<RankingShard> Start(ShardNumber number, int most_fresh) {
    RankingShardOptions options;
    options.shard = number;
    options.most_fresh = most_fresh;
    options.cache = dir_.File("cache");
    options.piece_of = [this](const PreparedObject& object) {
      ++made_;
      return PieceOf(object);
    };
    auto shard = RankingShard::Start(*store_, options);
    EXPECT_TRUE(shard.ok()) << shard.status();
    return *std::move(shard);
  }

  static void AwaitParts(const RankingShard& shard, int parts) {
    for (int i = 0; i < 20000 && shard.figures().parts != parts; ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    EXPECT_EQ(shard.figures().parts, parts);
  }

  ScratchDir dir_;
  std::unique_ptr<CatalogStore> store_;
  std::atomic<int> made_ = 0;
};

TEST_F(RankingShardTest, ShardsShareOutTheCatalogAndFollowIt) {
  for (const int max_resident : {100, 1}) {  // in memory, and read when asked for
    Load(max_resident);
    for (int i = 0; i < 20; ++i)
      ASSERT_TRUE(store_->Create(SampleRecord(absl::StrCat("o", max_resident, "-", i))).ok());
    Load(max_resident);
    const int before = static_cast<int>(store_->Published()->ids.size());
    const auto one = Start({1, 2}, 4), two = Start({2, 2}, 4);
    EXPECT_EQ(one->figures().parts + two->figures().parts, before);
    EXPECT_GT(one->figures().parts, 2);
    EXPECT_GT(two->figures().parts, 2);
    EXPECT_EQ(one->figures().fresh, 0);
    // What comes lies beside the rest, and what goes is not ranked any more.
    const std::string id = absl::StrCat("new", max_resident);
    ASSERT_TRUE(store_->Create(SampleRecord(id)).ok());
    const auto& its = ShardOf(id, 2) == 0 ? one : two;
    const auto& other = ShardOf(id, 2) == 0 ? two : one;
    const int parts = its->figures().parts, others = other->figures().parts;
    AwaitParts(*its, before + 1 - others);
    EXPECT_EQ(its->figures().fresh, 1);
    EXPECT_LE(parts, its->figures().parts);
    ASSERT_TRUE(store_->Delete(id).ok());
    AwaitParts(*its, before - others);
  }
}

TEST_F(RankingShardTest, AnswersNameShardAndGeneration) {
  Load(100);
  ASSERT_TRUE(store_->Create(SampleRecord("a")).ok());
  const auto shard = Start({1, 1}, 4);
  const ShardAnswer answer = shard->Rank(SomeImages(), {});
  EXPECT_EQ(answer.shard.number, 1);
  EXPECT_EQ(answer.shard.count, 1);
  EXPECT_EQ(answer.part_count, 1);
  EXPECT_EQ(answer.generation, store_->Published()->snapshot.generation);
}

TEST_F(RankingShardTest, KeysAreMadeOnceAndDamagedOnesAgain) {
  Load(1);
  for (int i = 0; i < 10; ++i)
    ASSERT_TRUE(store_->Create(SampleRecord(absl::StrCat("o", i), static_cast<unsigned>(i))).ok());
  Load(1);
  const std::size_t bytes = Start({1, 1}, 4)->figures().bytes;
  EXPECT_EQ(made_, 10);
  EXPECT_EQ(Start({1, 1}, 4)->figures().bytes, bytes);
  EXPECT_EQ(made_, 10);
  // One entry of the cache is damaged.
  int damaged = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(dir_.File("cache"))) {
    if (!entry.is_regular_file() || damaged++ > 0) continue;
    std::filesystem::resize_file(entry.path(), 20);
  }
  EXPECT_EQ(Start({1, 1}, 4)->figures().bytes, bytes);
  EXPECT_EQ(made_, 11);
}

}  // namespace
}  // namespace horopter
