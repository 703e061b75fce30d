// Which of many objects images may show, asked of one index and of several that share the objects:
// what ADR 98 rests on.
//
//   ranking_scale DATASET SPLIT COUNT SHARDS [--scenes N] [--cache DIR]
//     The data set's objects among COUNT in all, the others made of them: each stretched along one
//     direction of its aspects' images by 0.6 to 1.6, keys and places off by noise. Prints bytes an
//     object, CPU time a scene of one index and of the slowest shard, how many of one index's list
//     are in the shards' list, of how many of the objects that are shown either holds the right
//     one, and the same with one shard lost.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "client/bop_dataset.h"
#include "server/vision/recognition/aspect_search/object_values.h"
#include "tests/bench/aspect_catalog.h"

namespace horopter {
namespace {

using Values = std::vector<std::vector<float>>;

double CpuSeconds() {
  return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

FragmentPiece Distractor(FragmentPiece piece, std::mt19937& rng) {
  std::uniform_real_distribution<float> stretch(0.6f, 1.6f), angle(0.0f, 3.14159265f);
  std::normal_distribution<float> place(0.0f, 0.01f), key(0.0f, 0.06f);
  const float s = stretch(rng), c = std::cos(angle(rng)), t = std::sqrt(1.0f - c * c);
  const auto moved = [&](float& x, float& y) {
    const float along = (s - 1.0f) * (c * x + t * y);
    x += along * c + place(rng);
    y += along * t + place(rng);
  };
  for (std::size_t a = 0; a < piece.first_points.size(); ++a) {
    const IndexedAspect& aspect = piece.aspects[a];
    for (int i = 0; i < aspect.points; ++i) {
      VotePoint& p = piece.points[aspect.first_point + static_cast<std::uint32_t>(i)];
      moved(p.x, p.y);
      if (i >= kFirstVotePoints) continue;
      piece.first_points[a].x[i] = static_cast<std::int16_t>(p.x * FirstVotePoints::kPlaceScale);
      piece.first_points[a].y[i] = static_cast<std::int16_t>(p.y * FirstVotePoints::kPlaceScale);
    }
  }
  for (FragmentPiece::Entry& e : piece.entries) {
    moved(e.fragment.x, e.fragment.y);
    for (std::int16_t& k : e.key) k = static_cast<std::int16_t>(k + kKeyScale * key(rng));
  }
  return piece;
}

struct Sums {
  int scenes = 0, listed = 0, shared = 0, shown = 0, right_one = 0, right_shards = 0;
  int right_left = 0, shown_left = 0;  // with one shard lost, of objects of the others
  double one_s = 0.0, slowest_s = 0.0, all_s = 0.0;
};

void AskScene(std::span<const AspectImage> images,
              const std::set<int>& shown,
              const FragmentIndex& one,
              std::span<const FragmentIndex> shards,
              Sums* sums) {
  const ObjectRankingOptions options;
  const int count = one.model_count, parts = static_cast<int>(shards.size());
  double before = CpuSeconds();
  const std::vector<int> by_one = BestObjects(ObjectValues(images, one, options), options);
  sums->one_s += CpuSeconds() - before;
  Values joined, left;
  double slowest = 0.0;
  for (int s = 0; s < parts; ++s) {
    before = CpuSeconds();
    const Values values = ObjectValues(images, shards[s], options);
    slowest = std::max(slowest, CpuSeconds() - before);
    sums->all_s += CpuSeconds() - before;
    joined.resize(values.size(), std::vector<float>(count, 0.0f));
    for (std::size_t i = 0; i < values.size(); ++i) {
      for (std::size_t k = 0; k < values[i].size(); ++k)
        joined[i][k * static_cast<std::size_t>(parts) + static_cast<std::size_t>(s)] = values[i][k];
    }
    if (s == 0) left = joined;
  }
  sums->slowest_s += slowest;
  const std::vector<int> together = BestObjects(joined, options);
  // The first one is lost.
  left = joined;
  for (std::vector<float>& of_image : left) {
    for (int k = 0; k < count; k += parts) of_image[k] = 0.0f;
  }
  const std::vector<int> without = BestObjects(left, options);
  const auto has = [](const std::vector<int>& list, int k) {
    return std::find(list.begin(), list.end(), k) != list.end();
  };
  ++sums->scenes;
  sums->listed += static_cast<int>(by_one.size());
  for (const int k : by_one) sums->shared += has(together, k) ? 1 : 0;
  for (const int k : shown) {
    ++sums->shown;
    sums->right_one += has(by_one, k) ? 1 : 0;
    sums->right_shards += has(together, k) ? 1 : 0;
    if (k % parts == 0) continue;
    ++sums->shown_left;
    sums->right_left += has(without, k) ? 1 : 0;
  }
}

int Fail(const absl::Status& status) {
  std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
  return 1;
}

int Main(int argc, char** argv) {
  if (argc < 5) {
    std::fprintf(stderr,
                 "usage: ranking_scale DATASET SPLIT COUNT SHARDS [--scenes N] [--cache DIR]\n");
    return 2;
  }
  const std::string folder = argv[1], split = argv[2];
  const int count = std::atoi(argv[3]), shards = std::max(1, std::atoi(argv[4]));
  std::size_t most_scenes = 1000;
  std::string cache;
  for (int i = 5; i + 1 < argc; i += 2) {
    if (std::string(argv[i]) == "--scenes") most_scenes = std::strtoul(argv[i + 1], nullptr, 10);
    if (std::string(argv[i]) == "--cache") cache = argv[i + 1];
  }
  const auto dataset = ReadBopDataset(folder);
  if (!dataset.ok()) return Fail(dataset.status());
  AspectCatalog catalog;
  if (const auto loaded = LoadAspectCatalog(*dataset, cache, &catalog); !loaded.ok())
    return Fail(loaded);
  std::mt19937 rng(1);
  std::vector<FragmentPiece> pieces;
  const int own = static_cast<int>(catalog.parts.size());
  for (const AspectModel& part : catalog.parts)
    pieces.push_back(MakeFragmentPiece(*part.object, *part.fragments, kRankingChoice));
  while (static_cast<int>(pieces.size()) < count)
    pieces.push_back(Distractor(pieces[pieces.size() % static_cast<std::size_t>(own)], rng));
  std::vector<const FragmentPiece*> all;
  std::vector<std::vector<const FragmentPiece*>> shared(static_cast<std::size_t>(shards));
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    all.push_back(&pieces[i]);
    shared[i % shared.size()].push_back(&pieces[i]);
  }
  const FragmentIndex one = BuildFragmentIndex(all);
  std::vector<FragmentIndex> indices;
  for (const auto& of_shard : shared) {
    indices.push_back(BuildFragmentIndex(of_shard));
  }
  std::printf("%zu objects, %zu fragments, %.1f kB an object\n",
              pieces.size(),
              one.fragments.size(),
              1e-3 * static_cast<double>(one.bytes()) / static_cast<double>(pieces.size()));
  const auto scenes = ListBopScenes(folder, split);
  if (!scenes.ok()) return Fail(scenes.status());
  Sums sums;
  for (std::size_t n = 0; n < std::min(most_scenes, scenes->size()); ++n) {
    const auto scene = ReadBopScene(folder, split, (*scenes)[n]);
    if (!scene.ok()) return Fail(scene.status());
    std::vector<AspectImage> images;
    std::set<int> shown;
    for (const BopImage& image : scene->images) {
      images.push_back(MakeAspectImage(cv::imread(image.path, cv::IMREAD_COLOR)));
      for (const BopInstance& instance : image.instances) {
        const auto at = std::find(catalog.obj_ids.begin(), catalog.obj_ids.end(), instance.obj_id);
        if (at != catalog.obj_ids.end() && instance.visib_fract > 0.5)
          shown.insert(static_cast<int>(at - catalog.obj_ids.begin()));
      }
    }
    AskScene(images, shown, one, indices, &sums);
  }
  const double scenes_asked = std::max(1, sums.scenes);
  std::printf(
      "%d scenes, %d shards: CPU a scene: one index %.2f s, shards together %.2f s, the "
      "slowest %.2f s\n",
      sums.scenes,
      shards,
      sums.one_s / scenes_asked,
      sums.all_s / scenes_asked,
      sums.slowest_s / scenes_asked);
  std::printf(
      "of one index's list %d of %d are in the shards'; shown objects listed: one index %d, "
      "shards %d, of %d; with one shard lost %d of the %d others\n",
      sums.shared,
      sums.listed,
      sums.right_one,
      sums.right_shards,
      sums.shown,
      sums.right_left,
      sums.shown_left);
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
