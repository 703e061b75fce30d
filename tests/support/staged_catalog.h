// Parts of a data set, to be put in images and enrolled.
#pragma once

#include <span>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/base/status_macros.h"
#include "server/pipeline/pipeline.h"
#include "tests/support/staged_scene.h"

namespace horopter {

struct StagedCatalog {
  std::vector<StageablePart> parts;
  CatalogSnapshot catalog;  // of the same parts, in the same order
};

// ids: of the data set's objects. Errors: those of reading and preparing them.
inline absl::StatusOr<StagedCatalog> StageCatalog(const std::string& dataset,
                                                  std::span<const int> ids) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset read, ReadBopDataset(dataset));
  StagedCatalog out;
  for (const int id : ids) {
    HOROPTER_ASSIGN_OR_RETURN(CadImport cad, ImportCad(read.Find(id)->cad_path));
    cad.model.id = BopObjectName(id);
    HOROPTER_ASSIGN_OR_RETURN(StageablePart part, MakeStageable(id, cad.model.mesh, 0.0));
    out.parts.push_back(std::move(part));
    HOROPTER_ASSIGN_OR_RETURN(auto object, PrepareCatalogObject(std::move(cad.model)));
    out.catalog.objects.push_back(std::move(object));
  }
  return out;
}

}  // namespace horopter
