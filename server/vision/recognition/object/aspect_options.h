// Options of the room of the aspects, in one place for whoever recognises by them.
#pragma once

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/recognition/aspect_scenes/scene_judgement.h"
#include "server/vision/recognition/aspect_search/find_aspects.h"
#include "server/vision/recognition/aspect_search/object_ranking.h"
#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

// Threads are the request's, whatever stands here.
struct AspectRecognitionOptions {
  AspectImageOptions images;      // drop_pattern: as whoever looks at them needs
  ObjectRankingOptions ranking;   // of large catalogs
  FindAspectOptions find;         // hypotheses of single images
  AspectLinkOptions link;         // from these to a scene
  SceneJudgementOptions judging;  // of what is explained
};

}  // namespace horopter
