// A small valid catalog record for tests of catalog and service.
#pragma once

#include <random>
#include <string>

#include "db/catalog_record.h"

namespace horopter {

// A box with a hole in its top: 8 corners, 12 straight edges, one closed circle, a two-fold
// symmetry, two grasps and a CAD file of bytes that are not text. The numbers depend on the seed.
CatalogRecord SampleRecord(const std::string& id, unsigned seed = 1);

// The name of the first part in which the records differ; empty when they are equal bit by bit
// (source.content aside).
std::string FirstDifference(const CatalogRecord& a, const CatalogRecord& b);

bool SamePrint(const SurfacePrint& a, const SurfacePrint& b);

// Equal up to the given error of a rotation's or translation's element.
bool NearlyEqual(const Rigid3& a, const Rigid3& b, double tolerance);

}  // namespace horopter
