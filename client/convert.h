// Wire messages <-> value types, as the client needs them. The server validates; here nothing is
// refused.
#pragma once

#include <string>
#include <vector>

#include "horopter/v1/catalog.pb.h"
#include "horopter/v1/types.pb.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

v1::RigidTransform ToProto(const Rigid3& transform);
Eigen::Vector3d FromProto(const v1::Vector3& vector);
Rigid3 FromProto(const v1::RigidTransform& transform);  // unset rotation: identity

v1::Grasp ToProto(const Grasp& grasp);

// Everything but name and source.
v1::Object ToProto(const ObjectModel& model);

// Geometry, symmetries and grasps of an object in OBJECT_VIEW_GEOMETRY. Indices are checked, a
// broken edge or triangle is left out.
ObjectModel FromProto(const v1::Object& object);

// "objects/obj_000001" <-> "obj_000001".
std::string ResourceName(const std::string& id);
std::string IdOfResource(const std::string& name);

}  // namespace horopter
