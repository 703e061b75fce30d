#include "server/vision/recognition/aspect_scenes/view_search.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"

namespace horopter {
namespace {

constexpr double kSizeShare[] = {0.7, 1.45};  // of a part's sizes in other views
constexpr int kFirstViews = 2;                // that are searched for all parts before any others
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

// How many times as wide one whole image is as another, working pixels, where parts of them are
// looked at enlarged.
double WidthRatio(const AspectImage& a, const AspectImage& b) {
  if (!a.searched && !b.searched) return 1.0;
  return a.image_width * a.working_from_image / (b.image_width * b.working_from_image);
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

ViewSearch::SizeRange ViewSearch::SizesBeside(const LinkedScene& found, int v) const {
  SizeRange out;
  std::vector<int> parts;
  for (const LinkedObject& o : found.objects) {
    if (std::find(parts.begin(), parts.end(), o.object) != parts.end()) continue;
    parts.push_back(o.object);
    const RenderMesh& mesh = in_.models[o.object].object->mesh;
    for (std::size_t w = 0; w < found.views.size(); ++w) {
      if (!found.views[w] || !o.shown[w] || static_cast<int>(w) == v) continue;
      const Eigen::Vector3d center =
          found.views[w]->camera_from_scene * (o.scene_from_object * mesh.center.cast<double>());
      const double size = found.views[w]->camera.focal_px * mesh.diameter_m / center.z() *
                          in_.images[w].working_from_image *
                          WidthRatio(in_.images[v], in_.images[w]);
      out.least_px = std::min(out.least_px, kSizeShare[0] * size);
      out.most_px = std::max(out.most_px, kSizeShare[1] * size);
    }
  }
  return out;
}

FindAspectOptions ViewSearch::Options(int per_object, const LinkedScene& found, int v) const {
  FindAspectOptions find;
  find.threads = find.votes.threads = options_.threads;
  find.coarse_per_object = per_object;
  if (per_object > kQuickPerObject) {
    find.fine_per_object = per_object / 4;
    find.fine_share = 0.5;
    return find;
  }
  find.votes.max_matches = find.votes.max_pair_matches = kQuickMatches;
  const double width = in_.images[v].width;
  const SizeRange sizes = SizesBeside(found, v);
  find.votes.min_size_px =
      std::max(find.votes.min_size_px, std::min(sizes.least_px, find.votes.max_size_share * width));
  find.votes.max_size_share =
      std::min(find.votes.max_size_share, std::max(sizes.most_px, find.votes.min_size_px) / width);
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
  for (int v = 0; v < static_cast<int>(wanted.size()); ++v) {
    if (!wanted[v] || depth_[v] >= per_object || IsStopRequested(stop_)) continue;
    depth_[v] = per_object;
    FindAspectOptions find = Options(per_object, found, v);
    const PinholeCamera nominal = NominalCamera(in_.images[v]);
    find.nominal_focal_share =
        relative_focal * std::max(nominal.width, nominal.height) / std::max(1, nominal.width);
    find.log_focal_sigma = log_focal_sigma;
    SpendEffort(in_, kFoundPartsEffort);
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
