#include "server/vision/recognition/aspect_scenes/view_search.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"

namespace horopter {
namespace {

constexpr int kSwept = 2;                      // parts that are looked for at all places of a view
constexpr float kSweptSize[] = {0.7f, 1.45f};  // of their sizes in other views
constexpr int kFirstViews = 2;                 // that are searched for all parts before any others
// Of a fragment that are tested, where few parts are looked for; chosen, for time.
constexpr int kQuickMatches = 300;
// Least of ln f of a view beside linked ones: zooming cameras of rendered sets differ by 0.11. A
// pose of a hinge before holes was refined to a focal length 20 % too short, and scored .33 of .57.
constexpr double kBesideLogSigma = 0.12;

// Geometric mean of the linked views' relative focal lengths, and how far from it another may be;
// nominal while one view or none is there.
std::pair<double, double> FocalBeside(const LinkedScene& found) {
  double sum = 0.0, squares = 0.0;
  int n = 0;
  for (const auto& view : found.views) {
    if (!view) continue;
    const double log_focal = std::log(RelativeFocal(view->camera));
    sum += log_focal;
    squares += log_focal * log_focal;
    ++n;
  }
  if (n < 2) return {kNominalFocalShare, kNominalFocalLogSigma};
  const double mean = sum / n;
  const double deviation = std::sqrt(std::max(0.0, squares / n - mean * mean));
  return {std::exp(mean), std::clamp(deviation, kBesideLogSigma, kNominalFocalLogSigma)};
}

}  // namespace

ViewSearch::ViewSearch(const AspectLinkInput& input,
                       const AspectLinkOptions& options,
                       const StopRequested& stop,
                       ViewLinks* links)
    : in_(input),
      options_(options),
      stop_(stop),
      links_(*links),
      searched_(input.images.size(), !input.search),
      depth_(input.images.size(), 0) {}

bool ViewSearch::AllSearched() const {
  return std::all_of(searched_.begin(), searched_.end(), [](bool s) { return s; });
}

void ViewSearch::Search(int v) {
  if (searched_[v]) return;
  searched_[v] = true;
  links_.Add(v, in_.search(v));
}

void ViewSearch::SearchFirst() {
  const int views = static_cast<int>(searched_.size());
  for (int i = 0; i < kFirstViews; ++i) Search((2 * i + 1) * views / (2 * kFirstViews));
}

void ViewSearch::SearchNext() {
  const int views = static_cast<int>(searched_.size());
  int next = -1, farthest = 0;
  for (int v = 0; v < views; ++v) {
    int nearest = views;
    for (int w = 0; w < views; ++w) {
      if (searched_[w]) nearest = std::min(nearest, std::abs(v - w));
    }
    if (nearest > farthest) farthest = nearest, next = v;
  }
  if (next >= 0) Search(next);
}

void ViewSearch::SearchRest() {
  for (std::size_t v = 0; v < searched_.size() && !IsStopRequested(stop_); ++v)
    Search(static_cast<int>(v));
}

std::vector<AspectExpectation> ViewSearch::Expected(const LinkedScene& found,
                                                    const std::vector<int>& objects,
                                                    int most,
                                                    int v) const {
  std::vector<AspectExpectation> out;
  for (const LinkedObject& o : found.objects) {
    if (static_cast<int>(out.size()) >= most) break;
    const RenderMesh& mesh = in_.models[o.object].object->mesh;
    AspectExpectation e;
    e.model =
        static_cast<int>(std::find(objects.begin(), objects.end(), o.object) - objects.begin());
    if (std::any_of(out.begin(), out.end(), [&](const auto& x) { return x.model == e.model; }))
      continue;
    for (std::size_t w = 0; w < found.views.size(); ++w) {
      if (!found.views[w] || !o.shown[w] || static_cast<int>(w) == v) continue;
      const Rigid3 pose = found.views[w]->camera_from_scene * o.scene_from_object;
      const Eigen::Vector3d center = pose * mesh.center.cast<double>();
      const float size = static_cast<float>(found.views[w]->camera.focal_px * mesh.diameter_m /
                                            center.z() * in_.images[w].working_from_image);
      // Seen along the axis of the camera, as aspects are.
      const Eigen::Matrix3d ahead =
          Eigen::Quaterniond::FromTwoVectors(center, Eigen::Vector3d::UnitZ()).toRotationMatrix();
      e.rotations.push_back((ahead * pose.R).cast<float>());
      e.min_size_px = e.rotations.size() == 1 ? size : std::min(e.min_size_px, size);
      e.max_size_px = std::max(e.max_size_px, size);
    }
    if (e.rotations.empty()) continue;
    e.min_size_px *= kSweptSize[0];
    e.max_size_px *= kSweptSize[1];
    out.push_back(std::move(e));
  }
  return out;
}

FindAspectOptions ViewSearch::Options(int per_object,
                                      std::vector<AspectExpectation> expected,
                                      int v) const {
  FindAspectOptions find;
  find.threads = find.votes.threads = options_.threads;
  find.coarse_per_object = per_object;
  if (per_object > kQuickPerObject) {
    find.fine_per_object = per_object / 4;
    find.fine_share = 0.5;
    if (options_.swept) find.expected = std::move(expected);
    return find;
  }
  find.votes.max_matches = find.votes.max_pair_matches = kQuickMatches;
  const double width = in_.images[v].width;
  double low = find.votes.max_size_share * width, high = find.votes.min_size_px;
  for (const AspectExpectation& e : expected) {
    low = std::min(low, static_cast<double>(e.min_size_px));
    high = std::max(high, static_cast<double>(e.max_size_px));
  }
  find.votes.min_size_px = std::max(low, find.votes.min_size_px);
  find.votes.max_size_share = std::min(high / width, find.votes.max_size_share);
  return find;
}

void ViewSearch::SearchFor(const LinkedScene& found,
                           const std::vector<bool>& wanted,
                           int per_object) {
  std::vector<int> objects;
  std::vector<AspectModel> models;
  for (const LinkedObject& o : found.objects) {
    if (std::find(objects.begin(), objects.end(), o.object) != objects.end()) continue;
    objects.push_back(o.object);
    models.push_back(in_.models[o.object]);
  }
  const FragmentIndex index = BuildFragmentIndex(models);
  const auto [relative_focal, log_focal_sigma] = FocalBeside(found);
  const bool quick = per_object <= kQuickPerObject;
  const int most = quick ? static_cast<int>(found.objects.size()) : kSwept;
  for (int v = 0; v < static_cast<int>(wanted.size()); ++v) {
    if (!wanted[v] || depth_[v] >= per_object || IsStopRequested(stop_)) continue;
    depth_[v] = per_object;
    FindAspectOptions find = Options(per_object, Expected(found, objects, most, v), v);
    const PinholeCamera nominal = NominalCamera(in_.images[v]);
    find.nominal_focal_share =
        relative_focal * std::max(nominal.width, nominal.height) / std::max(1, nominal.width);
    find.log_focal_sigma = log_focal_sigma;
    std::vector<AspectHypothesis> list =
        FindAspectHypotheses(in_.images[v], index, find, nullptr, stop_).hypotheses;
    for (AspectHypothesis& h : list) h.object = objects[h.object];
    links_.Add(v, std::move(list));
  }
}

void ViewSearch::SearchUnsearchedFor(const LinkedScene& found, int per_object) {
  std::vector<bool> wanted;
  for (const bool searched : searched_) wanted.push_back(!searched);
  SearchFor(found, wanted, per_object);
}

}  // namespace horopter
