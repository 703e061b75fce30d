#include "tests/diagnose/true_world.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <tuple>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "tests/diagnose/true_world_adjustment.h"

namespace horopter {
namespace {

constexpr double kLinkVisible = 0.1;  // less of a part is annotated by guess
constexpr double kMovesPx = 10.0;     // a part that is off by more moves against the others
constexpr double kPreferred = 8.0;    // above WorthOf's range
constexpr size_t kMaxAttempts = 12;
constexpr int kAbsent = -1;

// One part of the scene, and its entry in each image's list.
struct Slot {
  int obj_id = 0;
  std::vector<int> entry;
  std::optional<Rigid3> world_from_object;
  bool certain = true;  // the lists of its obj_id are of one length where they are not empty
};

// By the order of the lists.
std::vector<Slot> MakeSlots(const BopScene& scene) {
  std::vector<Slot> slots;
  std::map<std::pair<int, int>, size_t> known;  // (obj_id, which of them)
  std::map<int, std::vector<int>> lengths;
  for (size_t v = 0; v < scene.images.size(); ++v) {
    std::map<int, int> count;
    for (size_t i = 0; i < scene.images[v].instances.size(); ++i) {
      const int id = scene.images[v].instances[i].obj_id;
      const auto [at, is_new] = known.try_emplace({id, count[id]++}, slots.size());
      if (is_new) slots.push_back({id, std::vector<int>(scene.images.size(), kAbsent), {}, true});
      slots[at->second].entry[v] = static_cast<int>(i);
    }
    for (const auto& [id, n] : count) lengths[id].push_back(n);
  }
  for (Slot& slot : slots) {
    const std::vector<int>& n = lengths[slot.obj_id];
    slot.certain = std::all_of(n.begin(), n.end(), [&](int k) { return k == n.front(); });
  }
  return slots;
}

const BopInstance* InstanceOf(const BopScene& scene, const Slot& slot, size_t view) {
  return slot.entry[view] == kAbsent ? nullptr : &scene.images[view].instances[slot.entry[view]];
}

double DiameterOf(const ObjectModel& model) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& v : model.mesh.vertices) box.extend(v);
  return box.isEmpty() ? 0.0 : box.diagonal().norm();
}

// How well a part tells where a camera is, in [0, 7]: without symmetries before all others, then in
// how many images, then how large.
double WorthOf(const Slot& slot,
               const BopScene& scene,
               const TrueModels& models,
               double largest_m) {
  const auto model = models.find(slot.obj_id);
  int seen = 0;
  for (size_t v = 0; v < scene.images.size(); ++v) {
    const BopInstance* instance = InstanceOf(scene, slot, v);
    seen += instance != nullptr && instance->visib_fract >= kLinkVisible ? 1 : 0;
  }
  const bool symmetric = model != models.end() && !model->second.symmetries.empty();
  const double size = model == models.end() ? 0.0 : DiameterOf(model->second);
  return (symmetric ? 0.0 : 4.0) + 2.0 * seen / static_cast<double>(scene.images.size()) +
         (largest_m > 0.0 ? size / largest_m : 0.0);
}

// Gives the slots an image sees their place.
void Place(const BopImage& image, size_t view, std::vector<Slot>* slots) {
  for (Slot& slot : *slots) {
    if (!slot.certain || slot.world_from_object || slot.entry[view] == kAbsent) continue;
    const BopInstance& instance = image.instances[slot.entry[view]];
    if (instance.visib_fract < kLinkVisible) continue;
    slot.world_from_object = image.camera_from_world.Inverse() * instance.camera_from_object;
  }
}

// The best link from a placed part to an image without a pose; a slot of -1: there is none.
struct Link {
  int slot = -1;
  int view = -1;
  double worth = -1.0;
};

Link BestLink(const BopScene& scene,
              const std::vector<Slot>& slots,
              const std::vector<double>& worth,
              bool placed_only) {
  Link best;
  for (size_t s = 0; s < slots.size(); ++s) {
    if (!slots[s].certain || (placed_only && !slots[s].world_from_object)) continue;
    for (size_t v = 0; v < scene.images.size(); ++v) {
      const BopInstance* instance = InstanceOf(scene, slots[s], v);
      if (scene.images[v].has_pose || instance == nullptr) continue;
      if (instance->visib_fract < kLinkVisible) continue;
      const double value = worth[s] + instance->visib_fract;
      if (value > best.worth) best = {static_cast<int>(s), static_cast<int>(v), value};
    }
  }
  return best;
}

// Grows from the images with poses, else from the frame of the part that tells most; `preferred`,
// an index of slots, tells more than any other.
void LinkImages(int preferred,
                BopScene* scene,
                std::vector<Slot>* slots,
                const TrueModels& models) {
  double largest = 0.0;
  for (const auto& [id, model] : models) largest = std::max(largest, DiameterOf(model));
  std::vector<double> worth;
  for (const Slot& slot : *slots) worth.push_back(WorthOf(slot, *scene, models, largest));
  worth[preferred] += kPreferred;
  for (size_t v = 0; v < scene->images.size(); ++v) {
    if (scene->images[v].has_pose) Place(scene->images[v], v, slots);
  }
  if (PosedImages(*scene) == 0) {
    const Link first = BestLink(*scene, *slots, worth, false);
    if (first.slot < 0) return;
    (*slots)[first.slot].world_from_object = Rigid3();
  }
  for (Link link = BestLink(*scene, *slots, worth, true); link.slot >= 0;
       link = BestLink(*scene, *slots, worth, true)) {
    BopImage& image = scene->images[link.view];
    const Slot& slot = (*slots)[link.slot];
    image.camera_from_world = image.instances[slot.entry[link.view]].camera_from_object *
                              slot.world_from_object->Inverse();
    image.has_pose = true;
    Place(image, static_cast<size_t>(link.view), slots);
  }
}

// A single image that was posed by its own part alone says nothing of a world.
void ResetLoneImage(const std::vector<bool>& given, BopScene* scene) {
  if (PosedImages(*scene) != 1) return;
  for (size_t v = 0; v < scene->images.size(); ++v) {
    if (given[v]) continue;
    scene->images[v].has_pose = false;
    scene->images[v].camera_from_world = Rigid3();
  }
}

// A way to place images and parts in one world.
struct Attempt {
  TrueWorld world;
  std::vector<Slot> slots;
  double cost = 0.0;
};

// All parts speak for all cameras that the file does not give.
void Adjust(const std::vector<bool>& given, const TrueModels& models, Attempt* attempt) {
  TrueWorld& world = attempt->world;
  if (PosedImages(world.scene) < 2) return;
  std::vector<AnnotatedPart> parts;
  std::vector<size_t> slot_of;
  for (size_t s = 0; s < attempt->slots.size(); ++s) {
    const Slot& slot = attempt->slots[s];
    const auto model = models.find(slot.obj_id);
    if (!slot.world_from_object || model == models.end()) continue;
    AnnotatedPart part = {&model->second, *slot.world_from_object, {}, 0.0};
    for (size_t v = 0; v < world.scene.images.size(); ++v) {
      const BopInstance* instance = InstanceOf(world.scene, slot, v);
      const bool counts = instance != nullptr && world.scene.images[v].has_pose &&
                          instance->visib_fract >= kLinkVisible;
      part.camera_from_object.push_back(counts ? std::optional<Rigid3>(instance->camera_from_object)
                                               : std::nullopt);
    }
    parts.push_back(std::move(part));
    slot_of.push_back(s);
  }
  if (parts.size() < 2) return;
  const WorldAgreement agreement = AdjustTrueWorld(given, &world.scene.images, &parts);
  world.rms_px = agreement.rms_px;
  attempt->cost = agreement.cost;
  for (size_t k = 0; k < parts.size(); ++k) {
    attempt->slots[slot_of[k]].world_from_object = parts[k].world_from_object;
    if (parts[k].median_px <= kMovesPx) continue;
    world.notes.push_back(absl::StrFormat("truth: object %d is %.0f px off where the others are",
                                          attempt->slots[slot_of[k]].obj_id,
                                          parts[k].median_px));
  }
}

// From each part in turn, since one that moves against the others would have them follow it; of the
// worlds with most images that in which most agree.
Attempt BestAttempt(const BopScene& scene,
                    const std::vector<bool>& given,
                    const TrueModels& models,
                    const std::vector<Slot>& slots) {
  Attempt best = {{scene, {}, {}}, slots, 0.0};
  for (size_t s = 0; s < std::min(slots.size(), kMaxAttempts); ++s) {
    Attempt attempt = {{scene, {}, {}}, slots, 0.0};
    LinkImages(static_cast<int>(s), &attempt.world.scene, &attempt.slots, models);
    ResetLoneImage(given, &attempt.world.scene);
    Adjust(given, models, &attempt);
    const int images = PosedImages(attempt.world.scene), most = PosedImages(best.world.scene);
    if (s == 0 || images > most || (images == most && attempt.cost < best.cost)) {
      best = std::move(attempt);
    }
  }
  return best;
}

// Gives the entries that one image has of these slots to the nearest ones.
void AssignNearest(const BopImage& image,
                   size_t view,
                   const std::vector<size_t>& of,
                   std::vector<Slot>* slots) {
  std::vector<std::tuple<double, size_t, int>> ways;
  for (const size_t s : of) {
    for (const size_t from : of) {
      const int entry = (*slots)[from].entry[view];
      if (entry == kAbsent || !(*slots)[s].world_from_object) continue;
      const Rigid3 expected = image.camera_from_world * *(*slots)[s].world_from_object;
      ways.emplace_back(
          (expected.t - image.instances[entry].camera_from_object.t).norm(), s, entry);
    }
  }
  for (const size_t s : of) (*slots)[s].entry[view] = kAbsent;
  std::sort(ways.begin(), ways.end());
  std::set<int> given;
  for (const auto& [distance, s, entry] : ways) {
    if ((*slots)[s].entry[view] != kAbsent || !given.insert(entry).second) continue;
    (*slots)[s].entry[view] = entry;
  }
}

// Parts of one obj_id whose lists differ in length: where they are says which is which, as the
// image that has most of them lists them.
void AssignByPosition(const BopScene& scene, std::vector<Slot>* slots) {
  std::map<int, std::vector<size_t>> uncertain;
  for (size_t s = 0; s < slots->size(); ++s) {
    if (!(*slots)[s].certain) uncertain[(*slots)[s].obj_id].push_back(s);
  }
  for (const auto& [id, of] : uncertain) {
    std::optional<size_t> fullest;
    long most = 0;
    for (size_t v = 0; v < scene.images.size(); ++v) {
      const long listed = std::count_if(
          of.begin(), of.end(), [&of = *slots, v](size_t s) { return of[s].entry[v] != kAbsent; });
      if (!scene.images[v].has_pose || listed <= most) continue;
      most = listed;
      fullest = v;
    }
    if (!fullest) continue;
    for (const size_t s : of) {
      if (const BopInstance* instance = InstanceOf(scene, (*slots)[s], *fullest)) {
        (*slots)[s].world_from_object =
            scene.images[*fullest].camera_from_world.Inverse() * instance->camera_from_object;
      }
    }
    for (size_t v = 0; v < scene.images.size(); ++v) {
      if (scene.images[v].has_pose && v != *fullest) {
        AssignNearest(scene.images[v], v, of, slots);
      }
    }
  }
}

void AlignInstances(const std::vector<Slot>& slots, BopScene* scene) {
  for (size_t v = 0; v < scene->images.size(); ++v) {
    BopImage& image = scene->images[v];
    std::vector<BopInstance> aligned;
    for (const Slot& slot : slots) {
      if (slot.entry[v] != kAbsent) {
        aligned.push_back(image.instances[slot.entry[v]]);
        continue;
      }
      BopInstance absent = {slot.obj_id, {}, 0.0};
      if (image.has_pose && slot.world_from_object) {
        absent.camera_from_object = image.camera_from_world * *slot.world_from_object;
      } else {
        absent.camera_from_object.t.z() = -1e3;  // behind the camera: it projects nowhere
      }
      aligned.push_back(absent);
    }
    image.instances = std::move(aligned);
  }
}

}  // namespace

int PosedImages(const BopScene& scene) {
  return static_cast<int>(std::count_if(
      scene.images.begin(), scene.images.end(), [](const BopImage& i) { return i.has_pose; }));
}

TrueWorld CompleteTruth(const BopScene& scene, const TrueModels& models) {
  TrueWorld world;
  world.scene = scene;
  std::vector<Slot> slots = MakeSlots(scene);
  std::vector<bool> given;
  for (const BopImage& image : scene.images) given.push_back(image.has_pose);
  const bool all_given = PosedImages(scene) == static_cast<int>(scene.images.size());
  if (all_given) {
    for (size_t v = 0; v < scene.images.size(); ++v) Place(scene.images[v], v, &slots);
  } else {
    Attempt best = BestAttempt(scene, given, models, slots);
    world = std::move(best.world);
    slots = std::move(best.slots);
  }
  AssignByPosition(world.scene, &slots);
  AlignInstances(slots, &world.scene);
  for (const BopImage& image : world.scene.images) {
    if (!image.has_pose) {
      world.notes.push_back(
          absl::StrCat("truth: where the camera of image ", image.im_id, " stands is not known"));
    }
  }
  return world;
}

}  // namespace horopter
