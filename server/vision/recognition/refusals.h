// What recognition refuses of one object, kept for whoever asks why it is not answered.
#pragma once

#include <optional>
#include <vector>

#include "server/vision/recognition/types.h"

namespace horopter {

// The tests that an object passes before it is answered, in their order.
enum class AcceptanceTest {
  kNone,           // all are passed
  kFeatures,       // the images have edges enough
  kHypothesis,     // some pose fits one image
  kLink,           // poses of single images agree with each other
  kSearch,         // the search comes upon a pose that is good enough
  kSupport,        // its edges are there in the images that should show them
  kPlace,          // nothing else explains its place better
  kChance,         // chance does not explain as much
  kFocal,          // the focal lengths that it asks for are those that are known
  kParallax,       // the images see it from sides different enough
  kContradiction,  // what the cameras should see of all that was found is there
  kCommonCameras,  // it fits the cameras that the other objects fit
};

// A placement that did not pass.
struct Refusal {
  AcceptanceTest test = AcceptanceTest::kNone;
  Rigid3 scene_from_object;
  std::vector<std::optional<CalibratedCamera>> views;  // the cameras it was judged in
  double value = 0.0;                                  // what the test measured
  double needed = 0.0;                                 // 0: the test has no number
};

// Of one object. Recognition only adds to it.
struct RefusalLog {
  int object = -1;  // index into the list of prepared objects
  std::vector<Refusal> refusals;
  std::vector<ViewHypothesis> hypotheses;  // of single images, also those of routes not taken
};

}  // namespace horopter
