// Which of very many objects images may show, asked of rankers over the network: what ADR 98 rests
// on. ranking_scale.py starts the rankers, asks them and prints what it found.
//
//   ranking_scale serve COUNT SHARD/SHARDS PORT CACHE DATASET [OTHER_DATASET ...]
//     CACHE: folder with a folder of the name of each data set. A ranker of COUNT objects: those of
//     the data set, and others made of the objects of all data sets, each stretched along one
//     direction of its views by 0.6 to 0.88 or 1.14 to 1.6, keys and places off by noise: the
//     statistics of real parts, and none is one of them. Prints bytes an object, then "ready", and
//     serves RankParts until it is killed.
//   ranking_scale ask DATASET SPLIT CACHE SECONDS ADDRESS[,ADDRESS ...] [--rounds N] [--drawn N]
//     [--pictures N]
//     Asks about each scene, or N drawn questions about one part each, of one picture or as many as
//     are said, at most three, and prints a line of JSON: milliseconds of each question, how many
//     of the shown objects (more than half visible) are listed, the lists, and the shards that were
//     lost.
#include <grpcpp/grpcpp.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/bop_dataset.h"
#include "server/base/parallel_for.h"
#include "server/service/rankers.h"
#include "server/service/ranking_service.h"
#include "tests/bench/aspect_catalog.h"
#include "tests/support/random.h"
#include "tests/support/shaded_photo.h"

namespace horopter {
namespace {

int Fail(const absl::Status& status) {
  std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
  return 1;
}

std::string IdOf(int number) {
  return absl::StrCat("part", number);
}

// Normal numbers, drawn of a table: thousands an object.
class Noise {
 public:
  explicit Noise(std::mt19937* rng) : state_((*rng)() | 1u) {}
  float operator()(float sigma) {
    state_ = state_ * 6364136223846793005ull + 1442695040888963407ull;
    return sigma * Table()[state_ >> 48];
  }

 private:
  static const std::vector<float>& Table() {
    static const std::vector<float> table = [] {
      std::vector<float> out(1u << 16);
      std::mt19937 rng(1);
      std::normal_distribution<float> normal(0.0f, 1.0f);
      for (float& v : out) v = normal(rng);
      return out;
    }();
    return table;
  }
  std::uint64_t state_;
};

// Another object with the statistics of this one.
FragmentPiece Distractor(FragmentPiece piece, std::mt19937& rng) {
  std::uniform_real_distribution<float> smaller(0.6f, 0.88f), larger(1.14f, 1.6f),
      angle(0.0f, 3.14159265f);
  constexpr float kPlaceSigma = 0.01f, kKeySigma = 0.06f;  // diameters, radians
  const float s = rng() % 2 == 0 ? smaller(rng) : larger(rng), a = angle(rng);
  const float c = std::cos(a), t = std::sin(a);
  Noise noise(&rng);
  const auto moved = [&](float& x, float& y) {
    const float along = (s - 1.0f) * (c * x + t * y);
    x += along * c + noise(kPlaceSigma);
    y += along * t + noise(kPlaceSigma);
  };
  for (VotePoint& p : piece.points) moved(p.x, p.y);
  for (FragmentPiece::Entry& e : piece.entries) {
    moved(e.fragment.x, e.fragment.y);
    for (std::int16_t& k : e.key)
      k = static_cast<std::int16_t>(static_cast<float>(k) + noise(kKeyScale * kKeySigma));
  }
  return piece;
}

// What was derived of a data set's objects is kept in a folder of its own.
std::string CacheOf(const std::string& cache, const std::string& dataset) {
  return cache + dataset.substr(dataset.find_last_of('/'));
}

// Lists of plain values, as they lie in memory, between runs of one build.
template <typename T>
void Write(const std::vector<T>& list, std::ostream& out) {
  const std::size_t size = list.size();
  out.write(reinterpret_cast<const char*>(&size), sizeof(size));
  out.write(reinterpret_cast<const char*>(list.data()),
            static_cast<std::streamsize>(size * sizeof(T)));
}
template <typename T>
void Read(std::istream& in, std::vector<T>* list) {
  std::size_t size = 0;
  in.read(reinterpret_cast<char*>(&size), sizeof(size));
  list->resize(in ? size : 0);
  in.read(reinterpret_cast<char*>(list->data()), static_cast<std::streamsize>(size * sizeof(T)));
}

// Pieces of a data set's objects, in its order.
absl::Status MakePieces(const std::string& folder,
                        const std::string& cache,
                        std::vector<FragmentPiece>* pieces) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset dataset, ReadBopDataset(folder));
  AspectCatalog catalog;
  HOROPTER_RETURN_IF_ERROR(LoadAspectCatalog(dataset, CacheOf(cache, folder), &catalog));
  for (const AspectModel& part : catalog.parts)
    pieces->push_back(MakeFragmentPiece(*part.object, *part.fragments, kPackedChoice));
  return absl::OkStatus();
}

absl::Status AddPieces(const std::string& folder,
                       const std::string& cache,
                       std::vector<FragmentPiece>* pieces) {
  const std::string path = CacheOf(cache, folder) + "/pieces";
  std::ifstream in(path, std::ios::binary);
  while (in.peek() != std::ifstream::traits_type::eof()) {
    FragmentPiece& piece = pieces->emplace_back();
    Read(in, &piece.aspects);
    Read(in, &piece.points);
    Read(in, &piece.entries);
  }
  if (in.is_open()) return absl::OkStatus();
  std::vector<FragmentPiece> made;
  HOROPTER_RETURN_IF_ERROR(MakePieces(folder, cache, &made));
  std::ofstream out(path, std::ios::binary);
  for (const FragmentPiece& piece : made) {
    Write(piece.aspects, out);
    Write(piece.points, out);
    Write(piece.entries, out);
  }
  std::move(made.begin(), made.end(), std::back_inserter(*pieces));
  return absl::OkStatus();
}

struct Shard {
  ShardNumber number;
  PackedIndex index;
  std::vector<std::string> ids;
};

Shard MakeShard(const std::vector<FragmentPiece>& real,
                int own,
                int count,
                const ShardNumber& number) {
  Shard shard;
  shard.number = number;
  std::vector<int> members;
  for (int i = 0; i < count; ++i) {
    if (ShardOf(IdOf(i), number.count) == number.number - 1) members.push_back(i);
  }
  PackedIndex::Builder builder(static_cast<int>(members.size()));
  constexpr std::size_t kLot = 1024;
  for (std::size_t begin = 0; begin < members.size(); begin += kLot) {
    const std::size_t n = std::min(kLot, members.size() - begin);
    std::vector<PackedPiece> pieces(n);
    ParallelFor(static_cast<int>(n), 2, [&](int k) {
      const int i = members[begin + static_cast<std::size_t>(k)];
      std::mt19937 rng(static_cast<unsigned>(i));
      pieces[k] = Pack(i < own ? real[i] : Distractor(real[rng() % real.size()], rng));
    });
    for (std::size_t k = 0; k < n; ++k) {
      builder.Add(pieces[k]);
      shard.ids.push_back(IdOf(members[begin + k]));
    }
  }
  shard.index = std::move(builder).Finish();
  return shard;
}

int Serve(const std::vector<std::string>& arguments) {
  if (arguments.size() < 5) return 2;
  const int count = std::atoi(arguments[0].c_str());
  const auto number = ParseShard(arguments[1]);
  if (!number.ok()) return Fail(number.status());
  std::vector<FragmentPiece> real;
  int own = 0;
  for (std::size_t i = 4; i < arguments.size(); ++i) {
    if (const absl::Status added = AddPieces(arguments[i], arguments[3], &real); !added.ok())
      return Fail(added);
    if (own == 0) own = static_cast<int>(real.size());
  }
  const Shard shard = MakeShard(real, own, count, *number);
  const auto parts = static_cast<double>(std::max<std::size_t>(1, shard.ids.size()));
  std::printf("%zu objects, %u fragments, %.0f bytes an object\n",
              shard.ids.size(),
              shard.index.fragments(),
              static_cast<double>(shard.index.bytes()) / parts);
  const auto access = Access::Open({});
  WorkerPool pool(2, 64);
  MemoryBudget memory(int64_t{1} << 30);
  const PackedIndex* const index = &shard.index;
  RankingService service(
      [&](std::span<const RankingImage> images, const StopRequested& stop) {
        const auto found =
            RankShard(images, std::span(&index, 1), shard.ids, {}, number->count, 1, stop);
        return ShardAnswer{found, *number, static_cast<int>(shard.ids.size()), 0};
      },
      CallGate{&pool, &memory, access->get(), nullptr},
      int64_t{64} << 20);
  grpc::ServerBuilder builder;
  builder.SetMaxReceiveMessageSize(64 << 20);
  builder.AddListeningPort("127.0.0.1:" + arguments[2], grpc::InsecureServerCredentials());
  builder.RegisterService(&service);
  const auto server = builder.BuildAndStart();
  if (server == nullptr) return 1;
  std::printf("ready\n");
  std::fflush(stdout);
  server->Wait();
  return 0;
}

// A scene's images as rankers are asked about them, and the objects that are shown.
struct Asked {
  std::vector<RankingImage> images;
  std::set<std::string> shown;
};

absl::StatusOr<std::vector<Asked>> ReadQuestions(const std::string& folder,
                                                 const std::string& split,
                                                 const std::string& cache) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset dataset, ReadBopDataset(folder));
  AspectCatalog catalog;
  HOROPTER_RETURN_IF_ERROR(LoadAspectCatalog(dataset, CacheOf(cache, folder), &catalog));
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<int> scenes, ListBopScenes(folder, split));
  std::vector<Asked> out;
  for (const int number : scenes) {
    HOROPTER_ASSIGN_OR_RETURN(const BopScene scene, ReadBopScene(folder, split, number));
    Asked& asked = out.emplace_back();
    std::vector<cv::Mat> images;
    for (const BopImage& image : scene.images) {
      images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
      for (const BopInstance& instance : image.instances) {
        const auto at = std::find(catalog.obj_ids.begin(), catalog.obj_ids.end(), instance.obj_id);
        if (at != catalog.obj_ids.end() && instance.visib_fract > 0.5)
          asked.shown.insert(IdOf(static_cast<int>(at - catalog.obj_ids.begin())));
      }
    }
    asked.images = RankingQuestion(images, 2);
  }
  return out;
}

// So many pictures of one of the data set's parts each, alone on a plain ground, in any attitudes.
absl::StatusOr<std::vector<Asked>> DrawQuestions(const std::string& folder,
                                                 const std::string& cache,
                                                 int count,
                                                 int pictures) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset dataset, ReadBopDataset(folder));
  AspectCatalog catalog;
  HOROPTER_RETURN_IF_ERROR(LoadAspectCatalog(dataset, CacheOf(cache, folder), &catalog));
  std::vector<Asked> out;
  for (int i = 0; i < count; ++i) {
    Random random(static_cast<unsigned>(i + 1));
    const int part = i % static_cast<int>(catalog.parts.size());
    const ObjectAspects& object = *catalog.parts[part].object;
    const PinholeCamera camera = CenteredCamera(640, 480, 800.0);
    std::vector<cv::Mat> drawn;
    for (int k = 0; k < pictures; ++k) {
      Rigid3 pose;
      pose.R =
          Eigen::Quaterniond(random.Normal(), random.Normal(), random.Normal(), random.Normal())
              .normalized()
              .toRotationMatrix();
      const double size_px = random.Uniform(180.0, 340.0);
      pose.t = Eigen::Vector3d(0, 0, camera.focal_px * object.aspects.diameter_m / size_px) -
               pose.R * object.aspects.center.cast<double>();
      drawn.push_back(ShadedPhoto({{&catalog.models[part].mesh, pose}}, camera));
    }
    out.push_back({RankingQuestion(drawn, 1), {IdOf(part)}});
  }
  return out;
}

int Ask(const std::vector<std::string>& arguments) {
  if (arguments.size() < 5) return 2;
  int rounds = 1, drawn = 0, pictures = 1;
  for (std::size_t i = 5; i + 1 < arguments.size(); i += 2) {
    int& option = arguments[i] == "--rounds"  ? rounds
                  : arguments[i] == "--drawn" ? drawn
                                              : pictures;
    option = std::atoi(arguments[i + 1].c_str());
  }
  const auto questions = drawn > 0 ? DrawQuestions(arguments[0], arguments[2], drawn, pictures)
                                   : ReadQuestions(arguments[0], arguments[1], arguments[2]);
  if (!questions.ok()) return Fail(questions.status());
  RankerOptions options;
  options.addresses = absl::StrSplit(arguments[4], ',');
  options.seconds = std::atof(arguments[3].c_str());
  const auto rankers = Rankers::Create(options);
  if (!rankers.ok()) return Fail(rankers.status());
  nlohmann::json out = {{"ms", nlohmann::json::array()}, {"lists", nlohmann::json::array()}};
  int shown = 0, listed = 0, failed = 0;
  std::set<int> lost;
  double request_bytes = 0.0;
  for (int round = 0; round < rounds; ++round) {
    for (const Asked& asked : *questions) {
      const auto start = std::chrono::steady_clock::now();
      const auto ranked = (*rankers)->Rank(asked.images, {});
      const auto took = std::chrono::steady_clock::now() - start;
      if (!ranked.ok()) {
        ++failed;
        continue;
      }
      out["ms"].push_back(std::chrono::duration<double, std::milli>(took).count());
      for (const auto& [shard, why] : ranked->lost) lost.insert(shard);
      if (round > 0) continue;
      for (const RankingImage& image : asked.images)
        request_bytes += 16.0 * static_cast<double>(image.edges.size()) +
                         56.0 * static_cast<double>(image.fragments.size());
      nlohmann::json right = nlohmann::json::array();
      for (const std::string& id : asked.shown) {
        ++shown;
        const bool there =
            std::find(ranked->ids.begin(), ranked->ids.end(), id) != ranked->ids.end();
        listed += there ? 1 : 0;
        if (there) right.push_back(id);
      }
      out["lists"].push_back({{"listed", ranked->ids}, {"shown", asked.shown}, {"right", right}});
    }
  }
  out["shown"] = shown;
  out["right"] = listed;
  out["failed"] = failed;
  out["lost"] = lost;
  out["request_kb"] = 1e-3 * request_bytes / std::max<double>(1.0, questions->size());
  std::printf("%s\n", out.dump().c_str());
  return 0;
}

int Main(int argc, char** argv) {
  const std::vector<std::string> arguments(argv + std::min(argc, 2), argv + argc);
  const std::string mode = argc > 1 ? argv[1] : "";
  const int code = mode == "serve" ? Serve(arguments) : mode == "ask" ? Ask(arguments) : 2;
  if (code == 2) {
    std::fprintf(stderr,
                 "usage: ranking_scale serve COUNT SHARD/SHARDS PORT CACHE DATASET ...\n"
                 "       ranking_scale ask DATASET SPLIT CACHE SECONDS ADDRESSES [--rounds N] "
                 "[--drawn N] [--pictures N]\n");
  }
  return code;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
