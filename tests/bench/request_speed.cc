// Whole requests to a running server, scene after scene of a data set: seconds and processor
// seconds by tier, beside one SIFT detection and one Canny of the same images on one core of the
// same machine in the same run, as yardsticks.
//
//   request_speed SERVER DATASET SPLIT [--scenes 1,2] [--images N] [--width W] [--repeats R]
//                 [--pid PID] [--csv FILE]
//     SERVER     host:port; the data set's parts are enrolled
//     --images   of each scene, spread evenly (0: all)
//     --width    images are scaled to so many pixels before they are sent (0: as they are)
//     --repeats  of each scene, one after the other
//     --pid      of the server on this machine, for its processor time
//     --csv      one line a request
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <map>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "client/api.h"
#include "client/bop_dataset.h"
#include "horopter/v1/recognition.pb.h"
#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

struct Arguments {
  std::string server, dataset, split, csv;
  std::vector<int> scenes;
  int images = 0, width = 0, repeats = 1, pid = 0;
};

struct Timed {
  int scene = 0;
  std::string tier;
  bool recognized = false;
  double seconds = 0.0, cpu_s = 0.0;     // of the request; of the server meanwhile
  double sift_s = 0.0, canny_s = 0.0;    // of its images, one core
  double segments = 0.0;                 // of an image, mean
  std::map<std::string, double> stages;  // seconds
};

using Clock = std::chrono::steady_clock;

double Since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

// Of all threads; 0 without a process.
double ProcessorSeconds(int pid) {
  if (pid == 0) return 0.0;
  std::ifstream file("/proc/" + std::to_string(pid) + "/stat");
  std::string text((std::istreambuf_iterator<char>(file)), {});
  const std::size_t name_end = text.rfind(')');
  if (name_end == std::string::npos) return 0.0;
  std::istringstream fields(text.substr(name_end + 1));
  std::string skipped;
  for (int i = 0; i < 11; ++i) fields >> skipped;
  double user = 0.0, system = 0.0;
  fields >> user >> system;
  return (user + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
}

std::vector<cv::Mat> Decoded(const v1::RecognizeSceneRequest& request) {
  std::vector<cv::Mat> out;
  for (const v1::SceneImage& image : request.images()) {
    const std::vector<std::uint8_t> bytes(image.content().begin(), image.content().end());
    out.push_back(cv::imdecode(bytes, cv::IMREAD_COLOR));
  }
  return out;
}

// In place; JPEG at a quality that leaves edges as they are.
void Scale(int width, v1::RecognizeSceneRequest* request) {
  std::vector<cv::Mat> images = Decoded(*request);
  for (int i = 0; i < request->images_size(); ++i) {
    cv::Mat scaled;
    const double factor = static_cast<double>(width) / std::max(1, images[i].cols);
    cv::resize(
        images[i], scaled, {}, factor, factor, factor < 1 ? cv::INTER_AREA : cv::INTER_CUBIC);
    std::vector<std::uint8_t> bytes;
    cv::imencode(".jpg", scaled, bytes, {cv::IMWRITE_JPEG_QUALITY, 98});
    request->mutable_images(i)->set_content(bytes.data(), bytes.size());
  }
}

void TimeYardsticks(const v1::RecognizeSceneRequest& request, Timed* out) {
  for (const cv::Mat& image : Decoded(request)) {
    cv::Mat grey, edges, descriptors;
    cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
    auto start = Clock::now();
    std::vector<cv::KeyPoint> keypoints;
    cv::SIFT::create()->detectAndCompute(grey, {}, keypoints, descriptors);
    out->sift_s += Since(start);
    start = Clock::now();
    cv::Canny(grey, edges, 50, 150);
    out->canny_s += Since(start);
  }
}

absl::StatusOr<Timed> TimeRequest(const Arguments& arguments,
                                  const BopScene& scene,
                                  HoropterClient* client) {
  v1::RecognizeSceneRequest request;
  const int there = static_cast<int>(scene.images.size());
  const int count = arguments.images > 0 ? std::min(arguments.images, there) : there;
  for (int i = 0; i < count; ++i) {
    std::ifstream file(scene.images[i * there / count].path, std::ios::binary);
    request.add_images()->set_content(std::string(std::istreambuf_iterator<char>(file), {}));
  }
  for (const cv::Mat& image : Decoded(request)) {
    if (image.empty())
      return absl::InvalidArgumentError(scene.folder + ": an image that cannot be decoded");
  }
  if (arguments.width > 0) Scale(arguments.width, &request);
  Timed out;
  out.scene = scene.scene_id;
  out.tier = scene.tier;
  TimeYardsticks(request, &out);
  const double cpu = ProcessorSeconds(arguments.pid);
  const auto start = Clock::now();
  const auto answer = client->RecognizeScene(request);
  out.seconds = Since(start);
  out.cpu_s = ProcessorSeconds(arguments.pid) - cpu;
  if (!answer.ok()) return answer.status();
  out.recognized = answer->objects_size() > 0;
  for (const v1::StageReport& s : answer->stages()) {
    out.stages[s.stage()] +=
        static_cast<double>(s.elapsed().seconds()) + 1e-9 * s.elapsed().nanos();
    const auto segments = s.counts().find("segments");
    if (segments != s.counts().end()) out.segments = segments->second / std::max(1, count);
  }
  return out;
}

template <typename Value>
std::vector<double> Of(const std::vector<Timed>& all, Value value) {
  std::vector<double> out;
  for (const Timed& t : all) out.push_back(value(t));
  return out;
}

void Print(const std::string& name, const std::vector<Timed>& all) {
  if (all.empty()) return;
  std::vector<double> seconds = Of(all, [](const Timed& t) { return t.seconds; });
  std::vector<double> sift = Of(all, [](const Timed& t) { return t.sift_s; });
  std::vector<double> canny = Of(all, [](const Timed& t) { return t.canny_s; });
  double cpu = 0.0;
  for (const Timed& t : all) cpu += t.cpu_s / static_cast<double>(all.size());
  const double median = Median(&seconds), of_sift = Median(&sift);
  std::printf(
      "%-12s %4zu requests  p50 %6.2f  p95 %6.2f  p99 %6.2f  worst %6.2f s  processor %6.2f s  "
      "SIFT %.3f s  Canny %.4f s  p50 / SIFT %.1f\n",
      name.c_str(),
      all.size(),
      median,
      Quantile(0.95, &seconds),
      Quantile(0.99, &seconds),
      Quantile(1.0, &seconds),
      cpu,
      of_sift,
      Median(&canny),
      median / std::max(1e-9, of_sift));
}

void PrintAll(const std::vector<Timed>& all) {
  std::map<std::string, std::vector<Timed>> of_tier;
  std::vector<Timed> recognized, refused;
  std::map<std::string, std::vector<double>> stages;
  for (const Timed& t : all) {
    of_tier[t.tier].push_back(t);
    (t.recognized ? recognized : refused).push_back(t);
    for (const auto& [stage, seconds] : t.stages) stages[stage].push_back(seconds);
  }
  for (const auto& [tier, requests] : of_tier) Print(tier, requests);
  Print("recognised", recognized);
  Print("refused", refused);
  Print("together", all);
  for (auto& [stage, seconds] : stages)
    std::printf("  stage %-16s median %.3f s\n", stage.c_str(), Median(&seconds));
}

void WriteCsv(const std::string& path, const std::vector<Timed>& all) {
  std::ofstream file(path);
  file << "scene,tier,recognized,seconds,cpu_s,sift_s,canny_s,segments\n";
  for (const Timed& t : all) {
    file << t.scene << ',' << t.tier << ',' << t.recognized << ',' << t.seconds << ',' << t.cpu_s
         << ',' << t.sift_s << ',' << t.canny_s << ',' << t.segments << '\n';
  }
}

int Main(int argc, char** argv) {
  CLI::App app("request_speed");
  Arguments arguments;
  app.add_option("server", arguments.server)->required();
  app.add_option("dataset", arguments.dataset)->required();
  app.add_option("split", arguments.split)->required();
  app.add_option("--scenes", arguments.scenes)->delimiter(',');
  app.add_option("--images", arguments.images)->check(CLI::NonNegativeNumber);
  app.add_option("--width", arguments.width)->check(CLI::NonNegativeNumber);
  app.add_option("--repeats", arguments.repeats)->check(CLI::PositiveNumber);
  app.add_option("--pid", arguments.pid)->check(CLI::NonNegativeNumber);
  app.add_option("--csv", arguments.csv);
  CLI11_PARSE(app, argc, argv);
  const auto fail = [](const absl::Status& status) {
    std::fprintf(stderr, "%s\n", status.ToString().c_str());
    return 1;
  };
  const auto scenes = ListBopScenes(arguments.dataset, arguments.split);
  if (!scenes.ok()) return fail(scenes.status());
  cv::setNumThreads(1);
  HoropterClient client(arguments.server, 600.0);
  std::vector<Timed> all;
  for (const int id : *scenes) {
    const auto& wanted = arguments.scenes;
    if (!wanted.empty() && std::find(wanted.begin(), wanted.end(), id) == wanted.end()) continue;
    const auto scene = ReadBopScene(arguments.dataset, arguments.split, id);
    if (!scene.ok()) return fail(scene.status());
    for (int i = 0; i < arguments.repeats; ++i) {
      const auto timed = TimeRequest(arguments, *scene, &client);
      if (!timed.ok()) return fail(timed.status());
      all.push_back(*timed);
    }
  }
  PrintAll(all);
  if (!arguments.csv.empty()) WriteCsv(arguments.csv, all);
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
