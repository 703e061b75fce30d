// A request for some of the catalog's objects, asked among all of them: what else lies there tells
// the cameras that the few leave open, and is not answered (ADR 81).
#pragma once

#include <memory>
#include <optional>
#include <span>

#include "server/pipeline/pipeline.h"

namespace horopter {

// The request without its candidates, where the catalog is small enough that all of it is searched;
// nothing where it names none or all.
std::optional<SceneRequest> WiderQuestion(const SceneRequest& request,
                                          const CatalogSnapshot& catalog,
                                          const PipelineOptions& options);

// Whether no wider question would know the cameras better: an object is found and every image has
// its camera.
bool IsEnough(const RecognitionResult& recognition);

// Of an answer to the wider question the objects that were asked for, and what is said of them.
void LeaveAsked(std::span<const std::shared_ptr<const PreparedObject>> asked, SceneAnswer* answer);

}  // namespace horopter
