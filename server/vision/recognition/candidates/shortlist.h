// Which objects of a large catalog a costly search is worth. A small catalog is searched as a
// whole; of a large one every object is asked cheaply and the best are searched (ADR 0015).
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "server/vision/recognition/candidates/corner_search.h"
#include "server/vision/recognition/candidates/standing_poses.h"
#include "server/vision/recognition/candidates/view_hypotheses.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/recognition/scoring/pose_refine.h"

namespace horopter {

// What corners and circles in space suggest of one object: poses, best quick score first.
std::vector<PooledPose> PosesInSpace(const PreparedObject& object,
                                     std::span<const KnownView> views,
                                     std::span<const SpaceCorner> corners,
                                     std::span<const SpaceCircle> circles,
                                     const CornerSearchOptions& options);

// How much better than chance a pose's quick score is: samples that agree by chance are fewer in
// share the more there are, so that large parts are told from chance at lower scores.
double Promise(const PreparedObject& object, std::span<const KnownView> views, const PooledPose& p);

struct Shortlist {
  std::vector<bool> searched;   // one flag per object
  std::vector<bool> shortlist;  // that a later look in better cameras needs to rank again
};

// Ranks the objects of `among` (one flag per object; empty: all) by what corners and circles in
// space promise.
Shortlist PromisingInSpace(std::span<const std::shared_ptr<const PreparedObject>> objects,
                           std::span<const KnownView> views,
                           std::span<const SpaceCorner> corners,
                           std::span<const SpaceCircle> circles,
                           const std::vector<bool>& among,
                           const ShortlistOptions& options,
                           int threads);

// Objects worth a search in single views whose cameras are not known: by the best of few image
// paths, summed over the views. paths: per view, best rank first; a view without paths is not
// asked. wanted: one flag per object, the others are not ranked.
std::vector<bool> PromisingInViews(const JointContext& context,
                                   const std::vector<std::vector<ImagePath>>& paths,
                                   const std::vector<bool>& wanted);

// The indices of the `most` largest values, ties by index; of values above zero only.
std::vector<int> Largest(std::span<const double> values, int most);

}  // namespace horopter
