#include "db/object_digest.h"

#include <cstdint>

#include "absl/strings/str_cat.h"
#include "db/blob.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr uint32_t kDigestVersion = 1;
constexpr uint32_t kShapeDigestVersion = 1;

class Digest {
 public:
  template <typename T>
  void AddRaw(T value) {
    sha_.Add({reinterpret_cast<const char*>(&value), sizeof(value)});
  }
  void Add(double value) { AddRaw(value == 0.0 ? 0.0 : value); }
  void Add(int64_t value) { AddRaw(value); }
  void AddSize(size_t size) { AddRaw(static_cast<uint64_t>(size)); }
  void Add(std::string_view text) {
    AddSize(text.size());
    sha_.Add(text);
  }
  void Add(const Eigen::Vector3d& v) {
    for (const double x : v) Add(x);
  }
  void Add(const Rigid3& transform) {
    for (int row = 0; row < 3; ++row) {
      for (int col = 0; col < 3; ++col) Add(transform.R(row, col));
    }
    Add(transform.t);
  }
  std::string Hex() const { return sha_.Hex(); }

 private:
  Sha256 sha_;
};

void AddShape(const ObjectModel& model, Digest* digest) {
  digest->Add(model.diameter_m);
  digest->AddSize(model.vertices.size());
  for (const Eigen::Vector3d& v : model.vertices) digest->Add(v);
  digest->AddSize(model.edges.size());
  for (const ModelEdge& edge : model.edges) {
    digest->Add(static_cast<int64_t>(edge.kind));
    digest->Add(static_cast<int64_t>(edge.start_vertex));
    digest->Add(static_cast<int64_t>(edge.end_vertex));
    digest->Add(edge.dihedral_rad);
    digest->Add(std::string_view(EncodePolyline(edge.polyline)));
  }
  digest->Add(std::string_view(EncodeMesh(model.mesh)));
  digest->AddSize(model.symmetries.size());
  for (const Rigid3& symmetry : model.symmetries) digest->Add(symmetry);
}

void AddGrasp(const Grasp& grasp, Digest* digest) {
  digest->Add(std::string_view(grasp.name));
  digest->Add(grasp.object_from_gripper);
  for (const double x : {grasp.jaw_opening_m, grasp.grip_width_m, grasp.quality}) digest->Add(x);
  digest->AddSize(grasp.object_from_pregrasp.has_value());
  if (grasp.object_from_pregrasp) digest->Add(*grasp.object_from_pregrasp);
}

absl::Status Store(Database* db, const std::string& id, const std::string& digest) {
  Statement replace(db,
                    "INSERT INTO object_digest VALUES (?, ?) ON CONFLICT (object_id) DO UPDATE SET "
                    "sha256 = excluded.sha256");
  replace.Bind(std::string_view(id)).Bind(std::string_view(digest));
  return replace.Run();
}

}  // namespace

std::string DigestOf(const ObjectModel& model) {
  Digest digest;
  digest.AddRaw(std::array<char, 4>{'H', 'D', 'I', 'G'});
  digest.AddRaw(kDigestVersion);
  digest.Add(std::string_view(model.id));
  AddShape(model, &digest);
  digest.AddSize(model.grasps.size());
  for (const Grasp& grasp : model.grasps) AddGrasp(grasp, &digest);
  return digest.Hex();
}

std::string ShapeDigestOf(const ObjectModel& model) {
  Digest digest;
  digest.AddRaw(std::array<char, 4>{'H', 'S', 'H', 'P'});
  digest.AddRaw(kShapeDigestVersion);
  AddShape(model, &digest);
  return digest.Hex();
}

std::string DerivedAddress(const ObjectModel& model, int version) {
  return Sha256Hex(absl::StrCat(ShapeDigestOf(model), " ", version));
}

absl::Status WriteDigest(Database* db, const ObjectModel& model) {
  return Store(db, model.id, DigestOf(model));
}

absl::Status CheckDigest(Database* db, const ObjectModel& model) {
  Statement select(db, "SELECT sha256 FROM object_digest WHERE object_id = ?");
  select.Bind(std::string_view(model.id));
  HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
  if (row && select.Bytes(0) == DigestOf(model)) return absl::OkStatus();
  return absl::DataLossError(
      absl::StrCat("object ",
                   model.id,
                   ": what is stored differs from its digest; it is not used until it is restored "
                   "from a backup or enrolled again"));
}

}  // namespace horopter
