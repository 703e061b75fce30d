// Parts found in single images by their aspects, focal length unknown, all parts of the data set in
// the catalog: the right pose among the votes, in the verified list, and first of all.
//
//   aspect_report DATASET SPLIT [--scenes 1,2] [--max-images N] [--cache DIR] [--overlays DIR]
//                 [--edges DIR] [--threads N] [--list] [--set coarse_per_object=12,...]
//     --max-images  views of each scene: 1 the first, 2 first and middle one, ... (0: all)
//     --cache       keeps what was derived of the parts between runs
//     --overlays    the image with the best hypotheses of the list, one file an image
//     --edges       the edges that are searched, in their directions' colours, one file an image
//     --list        prints the hypotheses of each image
//     --set         name=value of an option (Options() below), for ablations
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <limits>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <sstream>

#include "absl/strings/str_format.h"
#include "client/bop_dataset.h"
#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_search/find_aspects.h"
#include "server/vision/recognition/aspects/aspect_blob.h"
#include "tests/bench/aspect_catalog.h"

namespace horopter {
namespace {

constexpr double kRightPx = 8.0;          // worst vertex, at 640 px image width
constexpr double kRightShare = 0.2;       // ... and of the part's size in the image
constexpr double kRightVoteShare = 0.15;  // of the size: worst vertex of a vote
constexpr double kVisible = 0.5;
constexpr double kAccept = 0.60;
constexpr double kOverlapShare = 0.3;  // of the smaller size: accepted parts' centres are farther

struct Arguments {
  std::string dataset, split, cache, overlays, edges;
  std::vector<int> scenes;
  int max_images = 2;
  int threads = 1;
  bool list = false;
  std::vector<std::string> set;
};

struct Settings {
  AspectImageOptions image;
  FindAspectOptions find;
};

// Errors: INVALID_ARGUMENT, names the option.
absl::StatusOr<Settings> Options(const Arguments& arguments) {
  Settings o;
  o.find.threads = o.image.threads = arguments.threads;
  const std::map<std::string, double*> reals = {
      {"low_threshold", &o.image.low_threshold},
      {"high_threshold", &o.image.high_threshold},
      {"noise_factor", &o.image.noise_factor},
      {"max_gap_px", &o.image.max_gap_px},
      {"max_texture", &o.image.max_texture},
      {"key_rms_rad", &o.find.votes.key_rms_rad},
      {"fragment_factor", &o.find.votes.fragment_factor},
      {"start_share", &o.find.votes.start_share},
      {"min_step", &o.find.votes.min_step},
      {"pair_opening_rad", &o.find.votes.pair_opening_rad},
      {"min_arm_px", &o.find.votes.min_arm_px},
      {"max_arm_offset_px", &o.find.votes.max_arm_offset_px},
      {"pair_log_ratio", &o.find.votes.pair_log_ratio},
      {"ellipse_ratio", &o.find.votes.ellipse_ratio},
      {"tau_share", &o.find.votes.tau_share},
      {"min_tau_px", &o.find.votes.min_tau_px},
      {"min_size_px", &o.find.votes.min_size_px},
      {"max_size_share", &o.find.votes.max_size_share},
      {"min_fragment_px", &o.find.votes.min_fragment_px},
      {"min_support_6", &o.find.votes.min_support_6},
      {"min_support_16", &o.find.votes.min_support_16},
      {"min_support", &o.find.votes.min_support},
      {"free_chance", &o.find.votes.free_chance},
      {"rank_support", &o.find.votes.rank_support},
      {"nominal_focal_share", &o.find.nominal_focal_share},
      {"coarse_render_px", &o.find.coarse_render_px},
      {"fine_render_px", &o.find.fine_render_px},
      {"fine_share", &o.find.fine_share}};
  const std::map<std::string, int*> integers = {
      {"max_width_px", &o.image.max_width_px},
      {"pool", &o.find.votes.pool},
      {"max_matches", &o.find.votes.max_matches},
      {"max_repeats", &o.find.votes.max_repeats},
      {"max_pairs", &o.find.votes.max_pairs},
      {"max_pair_matches", &o.find.votes.max_pair_matches},
      {"max_ellipse_matches", &o.find.votes.max_ellipse_matches},
      {"max_per_object", &o.find.votes.max_per_object},
      {"max_per_place", &o.find.votes.max_per_place},
      {"coarse_per_object", &o.find.coarse_per_object},
      {"fine_per_object", &o.find.fine_per_object}};
  for (const std::string& text : arguments.set) {
    const std::size_t equals = text.find('=');
    const std::string name = text.substr(0, equals);
    const double value = equals == std::string::npos ? 0.0 : std::atof(text.c_str() + equals + 1);
    if (const auto real = reals.find(name); real != reals.end()) {
      *real->second = value;
    } else if (const auto integer = integers.find(name); integer != integers.end()) {
      *integer->second = static_cast<int>(value);
    } else {
      return absl::InvalidArgumentError("--set: no option " + name);
    }
  }
  return o;
}

struct Sums {
  int images = 0, instances = 0;
  int own_10 = 0, own_100 = 0, own_all = 0, all_10 = 0, all_100 = 0, all_1000 = 0;
  int listed = 0, listed_100 = 0, first = 0, first_3 = 0, singles = 0;
  int accepted_right = 0, accepted_false = 0;
  std::vector<double> seconds, errors, scores_right, scores_wrong;
};

void DrawEdges(const RenderMesh& mesh,
               const PinholeCamera& camera,
               const Rigid3& pose,
               const cv::Scalar& color,
               cv::Mat* image) {
  const double scale = static_cast<double>(image->cols) / camera.width;
  for (const VisibleEdgePoint& p : FindVisibleEdges(mesh, camera, pose).points) {
    const cv::Point at(static_cast<int>((p.image.x() + 0.5) * scale),
                       static_cast<int>((p.image.y() + 0.5) * scale));
    cv::circle(*image, at, 1, color, -1);
  }
}

// Truth thin and white, the first hypotheses in colours, best last.
void WriteOverlay(const std::string& file,
                  const cv::Mat& photo,
                  const AspectCatalog& catalog,
                  const AspectFindings& found) {
  cv::Mat image;
  cv::resize(photo, image, cv::Size(), 2, 2);
  const cv::Scalar colors[] = {
      {0, 255, 0}, {0, 200, 255}, {255, 100, 255}, {255, 200, 0}, {0, 0, 255}};
  for (int h = std::min<int>(4, static_cast<int>(found.hypotheses.size()) - 1); h >= 0; --h) {
    const AspectHypothesis& hypothesis = found.hypotheses[h];
    DrawEdges(catalog.parts[hypothesis.object].object->mesh,
              hypothesis.camera,
              hypothesis.camera_from_object,
              colors[h],
              &image);
    cv::putText(image,
                absl::StrFormat("%d: part %d F %.2f P %.2f R %.2f",
                                h + 1,
                                catalog.obj_ids[hypothesis.object],
                                hypothesis.score,
                                hypothesis.precision,
                                hypothesis.recall),
                cv::Point(8, 24 + 24 * h),
                cv::FONT_HERSHEY_SIMPLEX,
                0.7,
                colors[h],
                2);
  }
  cv::imwrite(file, image);
}

// Dark where the image is, each edge in the colour of its direction.
void WriteEdges(const std::string& file, const cv::Mat& photo, const AspectImage& image) {
  constexpr double kDim = 0.35;  // of the photo's light
  constexpr int kLarger = 2;     // times the working size
  cv::Mat out;
  cv::resize(photo, out, cv::Size(kLarger * image.width, kLarger * image.height));
  out *= kDim;
  for (const ImageEdgePoint& e : image.edges) {
    const int bin = AspectBin(-e.normal.y(), e.normal.x());
    cv::Mat3b hue(1, 1, cv::Vec3b(static_cast<std::uint8_t>(180 * bin / kAspectBins), 200, 255));
    cv::cvtColor(hue, hue, cv::COLOR_HSV2BGR);
    const cv::Point at(static_cast<int>(std::lround(kLarger * (e.point.x() + 0.5f) - 0.5f)),
                       static_cast<int>(std::lround(kLarger * (e.point.y() + 0.5f) - 0.5f)));
    cv::circle(out, at, 1, hue(0, 0), cv::FILLED);
  }
  cv::imwrite(file, out);
}

class Report {
 public:
  Report(const Arguments& arguments, const Settings& settings, const AspectCatalog& catalog)
      : arguments_(arguments), settings_(settings), catalog_(catalog) {
    for (std::size_t i = 0; i < catalog.obj_ids.size(); ++i) {
      part_of_[catalog.obj_ids[i]] = static_cast<int>(i);
    }
  }

  void AddImage(const BopScene& scene, const BopImage& view) {
    const cv::Mat photo = cv::imread(view.path, cv::IMREAD_COLOR);
    if (photo.empty()) return;
    const std::clock_t start = std::clock();
    const AspectImage image = MakeAspectImage(photo, settings_.image);
    const AspectFindings found = FindAspectHypotheses(image, catalog_.index, settings_.find);
    const double seconds = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
    Sums& sums = sums_[scene.tier];
    ++sums.images;
    sums.seconds.push_back(seconds);
    const std::string name = absl::StrFormat("%d/%d", scene.scene_id, view.im_id);
    std::cout << absl::StrFormat(
        "%s %s: %.2f s CPU, %d edges, %d fragments, %d matches, %d pairs, %d matches, "
        "%d ellipses, %d matches, %d of 16, %d "
        "climbs, %d accepted\n",
        name,
        scene.tier,
        seconds,
        static_cast<int>(image.edges.size()),
        found.votes.fragments,
        found.votes.matches,
        found.votes.pairs,
        found.votes.pair_matches,
        found.votes.ellipses,
        found.votes.ellipse_matches,
        found.votes.tests_16,
        found.votes.climbs,
        found.votes.accepted);
    Judge(scene, view, image, found, &sums);
    if (!arguments_.overlays.empty()) {
      WriteOverlay(
          absl::StrFormat("%s/%02d_%02d.png", arguments_.overlays, scene.scene_id, view.im_id),
          photo,
          catalog_,
          found);
    }
    if (!arguments_.edges.empty()) {
      WriteEdges(absl::StrFormat("%s/%02d_%02d.png", arguments_.edges, scene.scene_id, view.im_id),
                 photo,
                 image);
    }
    std::cout << std::flush;
  }

  void Print() const {
    for (const auto& [tier, s] : sums_) {
      std::cout << absl::StrFormat(
          "%s: %d images, %d instances; votes own 10/100/all %d %d %d, all parts 10/100/1000 %d %d "
          "%d; listed %d (first 100: %d); first %d, first three %d of %d; at %.2f right %d false "
          "%d; error px median %.1f 90 %% %.1f; CPU s median %.2f most %.2f\n",
          tier,
          s.images,
          s.instances,
          s.own_10,
          s.own_100,
          s.own_all,
          s.all_10,
          s.all_100,
          s.all_1000,
          s.listed,
          s.listed_100,
          s.first,
          s.first_3,
          s.singles,
          kAccept,
          s.accepted_right,
          s.accepted_false,
          Quantile(s.errors, 0.5),
          Quantile(s.errors, 0.9),
          Quantile(s.seconds, 0.5),
          Quantile(s.seconds, 1.0));
    }
  }

 private:
  static double Quantile(std::vector<double> v, double q) {
    if (v.empty()) return 0.0;
    std::sort(v.begin(), v.end());
    return v[static_cast<std::size_t>(q * static_cast<double>(v.size() - 1))];
  }

  double Error(const AspectHypothesis& h, const BopImage& view, const BopInstance& truth) const {
    return WorstVertexPx(catalog_.models[h.object],
                         h.camera,
                         h.camera_from_object,
                         view.camera,
                         truth.camera_from_object);
  }

  // Rank of the first right vote among the part's own and among all parts'.
  std::pair<int, int> VoteRanks(const AspectImage& image,
                                const AspectVotes& votes,
                                const BopImage& view,
                                const BopInstance& truth) const {
    const int part = part_of_.at(truth.obj_id);
    const PinholeCamera camera = NominalCamera(image);
    int own = -1;
    float rank = 0.0f;
    for (std::size_t i = 0; i < votes.of_model[part].size() && own < 0; ++i) {
      const AspectVote& vote = votes.of_model[part][i];
      const double error =
          WorstVertexPx(catalog_.models[part],
                        camera,
                        PoseOfVote(vote, catalog_.index, WorkingCamera(image, camera)),
                        view.camera,
                        truth.camera_from_object);
      if (error < kRightVoteShare * vote.size_px / image.working_from_image) {
        own = static_cast<int>(i);
        rank = vote.rank;
      }
    }
    if (own < 0) return {-1, -1};
    int before = 0;
    for (const auto& list : votes.of_model) {
      for (const AspectVote& v : list) before += v.rank > rank ? 1 : 0;
    }
    return {own, before};
  }

  void Judge(const BopScene& scene,
             const BopImage& view,
             const AspectImage& image,
             const AspectFindings& found,
             Sums* sums) {
    int targets = 0;
    for (const BopInstance& truth : view.instances) {
      if (truth.visib_fract < kVisible || part_of_.count(truth.obj_id) == 0) continue;
      const double right_px = RightPx(view, truth);
      ++targets;
      ++sums->instances;
      const auto [own, before] = VoteRanks(image, found.votes, view, truth);
      if (own >= 0) {
        sums->own_10 += own < 10;
        sums->own_100 += own < 100;
        ++sums->own_all;
        sums->all_10 += before < 10;
        sums->all_100 += before < 100;
        sums->all_1000 += before < 1000;
      }
      int place = -1;
      double best = std::numeric_limits<double>::infinity();
      for (std::size_t h = 0; h < found.hypotheses.size(); ++h) {
        if (found.hypotheses[h].object != part_of_.at(truth.obj_id)) continue;
        const double error = Error(found.hypotheses[h], view, truth);
        best = std::min(best, error);
        if (error < right_px && place < 0) {
          place = static_cast<int>(h);
          sums->errors.push_back(error);
        }
      }
      sums->listed += place >= 0;
      sums->listed_100 += place >= 0 && place < 100;
      std::cout << absl::StrFormat(
          "  part %d visible %.2f: vote %d of own, %d of all; listed %d, F %.3f, nearest %.1f px\n",
          truth.obj_id,
          truth.visib_fract,
          own,
          before,
          place,
          place >= 0 ? found.hypotheses[place].score : 0.0,
          best);
      if (scene.tier == "T1") {
        ++sums->singles;
        sums->first += place == 0;
        sums->first_3 += place >= 0 && place < 3;
      }
    }
    Accept(view, found, sums);
    const int shown = arguments_.list ? 10 : 3;
    for (int h = 0; h < std::min<int>(shown, static_cast<int>(found.hypotheses.size())); ++h) {
      const AspectHypothesis& x = found.hypotheses[h];
      std::cout << absl::StrFormat("    %d: part %d F %.3f P %.2f R %.2f n %.0f f %.0f%s\n",
                                   h,
                                   catalog_.obj_ids[x.object],
                                   x.score,
                                   x.precision,
                                   x.recall,
                                   x.support_px,
                                   x.camera.focal_px,
                                   Right(x, view) ? " right" : "");
    }
  }

  // Small parts are not right anywhere near.
  double RightPx(const BopImage& view, const BopInstance& truth) const {
    const double scale = view.camera.width > 0 ? view.camera.width / 640.0 : 1.0;
    const double size =
        SizePx(catalog_.parts[part_of_.at(truth.obj_id)], view.camera, truth.camera_from_object);
    return std::min(kRightPx * scale, kRightShare * size);
  }

  bool Right(const AspectHypothesis& h, const BopImage& view) const {
    return std::any_of(view.instances.begin(), view.instances.end(), [&](const BopInstance& truth) {
      return part_of_.count(truth.obj_id) > 0 && part_of_.at(truth.obj_id) == h.object &&
             Error(h, view, truth) < RightPx(view, truth);
    });
  }

  // Best first, those above the bar whose place is not taken.
  void Accept(const BopImage& view, const AspectFindings& found, Sums* sums) const {
    struct Place {
      Eigen::Vector2d center;
      double size;
    };
    std::vector<Place> taken;
    for (const AspectHypothesis& h : found.hypotheses) {
      if (h.score < kAccept) break;
      const RenderMesh& mesh = catalog_.parts[h.object].object->mesh;
      const Eigen::Vector3d c = h.camera_from_object * mesh.center.cast<double>();
      const Place place{Project(h.camera, c), h.camera.focal_px * mesh.diameter_m / c.z()};
      const bool free = std::none_of(taken.begin(), taken.end(), [&](const Place& t) {
        return (t.center - place.center).norm() < kOverlapShare * std::min(t.size, place.size);
      });
      if (!free) continue;
      taken.push_back(place);
      ++(Right(h, view) ? sums->accepted_right : sums->accepted_false);
    }
  }

  const Arguments& arguments_;
  const Settings& settings_;
  const AspectCatalog& catalog_;
  std::map<int, int> part_of_;
  std::map<std::string, Sums> sums_;
};

absl::Status Run(const Arguments& arguments) {
  for (const std::string& folder : {arguments.cache, arguments.overlays, arguments.edges}) {
    if (!folder.empty()) std::filesystem::create_directories(folder);
  }
  const auto settings = Options(arguments);
  if (!settings.ok()) return settings.status();
  AspectCatalog catalog;
  const auto start = std::chrono::steady_clock::now();
  const auto dataset = ReadBopDataset(arguments.dataset);
  if (!dataset.ok()) return dataset.status();
  const absl::Status loaded = LoadAspectCatalog(*dataset, arguments.cache, &catalog);
  if (!loaded.ok()) return loaded;
  std::cout << absl::StrFormat(
      "%d parts, %d aspects, %d fragments, enrolled in %.1f s\n",
      static_cast<int>(catalog.parts.size()),
      static_cast<int>(catalog.index.aspects.size()),
      static_cast<int>(catalog.index.fragments.size()),
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  std::vector<int> scenes = arguments.scenes;
  if (scenes.empty()) {
    auto listed = ListBopScenes(arguments.dataset, arguments.split);
    if (!listed.ok()) return listed.status();
    scenes = *listed;
  }
  Report report(arguments, *settings, catalog);
  for (const int id : scenes) {
    const auto scene = ReadBopScene(arguments.dataset, arguments.split, id);
    if (!scene.ok()) return scene.status();
    const int views = static_cast<int>(scene->images.size());
    const int count = arguments.max_images > 0 ? std::min(arguments.max_images, views) : views;
    for (int i = 0; i < count; ++i) report.AddImage(*scene, scene->images[i * views / count]);
  }
  report.Print();
  return absl::OkStatus();
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  horopter::Arguments arguments;
  CLI::App app("Parts found in single images by their aspects");
  app.add_option("dataset", arguments.dataset)->required();
  app.add_option("split", arguments.split)->required();
  app.add_option("--scenes", arguments.scenes)->delimiter(',');
  app.add_option("--max-images", arguments.max_images);
  app.add_option("--cache", arguments.cache);
  app.add_option("--overlays", arguments.overlays);
  app.add_option("--edges", arguments.edges);
  app.add_option("--threads", arguments.threads);
  app.add_option("--set", arguments.set)->delimiter(',');
  app.add_flag("--list", arguments.list);
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = horopter::Run(arguments);
  if (!status.ok()) {
    std::cerr << status << "\n";
    return 1;
  }
  return 0;
}
