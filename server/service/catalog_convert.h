// Wire <-> domain of catalog objects; each way checked.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "db/catalog.h"
#include "db/catalog_record.h"

namespace google::protobuf {
class FieldMask;
}

namespace horopter::v1 {
class Object;
}

namespace horopter {

// Times are not read. A diameter of 0 is computed from the mesh; another must agree with it within
// 1 %. What the catalog checks itself (ranges, indices) is left to it. Errors: INVALID_ARGUMENT
// naming the field.
absl::StatusOr<CatalogRecord> RecordFromProto(const std::string& id, const v1::Object& proto);

// The parts an update mask names; "*" names all, an empty mask those that are populated in
// `object`. Errors: INVALID_ARGUMENT naming the unknown path.
struct ObjectMask {
  bool display_name = false, diameter = false, vertices = false, edges = false, mesh = false,
       symmetries = false, grasps = false, source = false, labels = false, print = false;

  UpdateParts Parts() const {
    const bool geometry = diameter || vertices || edges || mesh;
    return {display_name, geometry, symmetries, grasps, source, labels, print};
  }
};
absl::StatusOr<ObjectMask> MaskFromProto(const google::protobuf::FieldMask& proto,
                                         const v1::Object& object);

// `current` with the masked fields taken from `proto`. Errors: INVALID_ARGUMENT naming the field.
absl::StatusOr<CatalogRecord> MergeRecord(CatalogRecord current,
                                          const v1::Object& proto,
                                          const ObjectMask& mask);

// What changes with every write of the object, also over a deletion and a restored backup.
std::string EtagOf(const CatalogRecord& record);

// What is about to be written, in OBJECT_VIEW_BASIC.
void WrittenToProto(const CatalogRecord& record, v1::Object* proto);
// Everything but geometry and CAD bytes; counts from the summary.
void SummaryToProto(const ObjectSummary& summary, v1::Object* proto);
// Geometry, symmetries, grasps, source without bytes, counts.
void RecordToProto(const CatalogRecord& record, v1::Object* proto);

// Largest distance between two of the points, at most 0.2 % too small; linear time. 0 for fewer
// than two points.
double PointSetDiameter(const std::vector<Eigen::Vector3d>& points);

}  // namespace horopter
