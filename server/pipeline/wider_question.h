// A request for some of the catalog's objects, asked among all of them: what else lies there tells
// the cameras that the few leave open, and is not answered (ADR 81).
#pragma once

#include <memory>
#include <optional>
#include <span>

#include "server/pipeline/pipeline.h"
#include "server/pipeline/select_objects.h"

namespace horopter {

// What is looked for beside what is asked: all objects, where the catalog is small enough that all
// of it is searched, without those that look like what is asked, as whoever names one of
// look-alikes rules out the others; nothing where the request names no candidates or all. Errors:
// those of the stored objects.
absl::StatusOr<std::optional<Selection>> WiderQuestion(const SceneRequest& request,
                                                       const Selection& asked,
                                                       const CatalogSnapshot& catalog,
                                                       const PipelineOptions& options);

// Of an answer to the wider question the objects that were asked for, and what is said of them.
void LeaveAsked(std::span<const std::shared_ptr<const PreparedObject>> asked, SceneAnswer* answer);

}  // namespace horopter
