#include "db/version_blob.h"

#include <bit>
#include <cstdint>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "db/blob.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

static_assert(std::endian::native == std::endian::little, "blobs are copied as they are in memory");

constexpr std::string_view kDetailsMagic = "HVER";
constexpr std::string_view kGeometryMagic = "HGEO";
constexpr uint16_t kVersionLayout = 1;
constexpr uint16_t kPrintedLayout =
    2;  // of details with a print; without one servers before it read

class Writer {
 public:
  explicit Writer(std::string_view magic, uint16_t layout = kVersionLayout) {
    out_.append(magic);
    Add(layout);
    Add(uint16_t{0});
  }
  template <typename T>
  void Add(T value) {
    out_.append(reinterpret_cast<const char*>(&value), sizeof(value));
  }
  void AddSize(size_t size) { Add(static_cast<uint32_t>(size)); }
  void AddText(std::string_view text) {
    AddSize(text.size());
    out_.append(text);
  }
  void AddPoint(const Eigen::Vector3d& point) {
    for (const double x : point) Add(x);
  }
  void AddRigid(const Rigid3& transform) {
    for (int i = 0; i < 9; ++i) Add(transform.R(i / 3, i % 3));
    AddPoint(transform.t);
  }
  std::string Take() && { return std::move(out_); }

 private:
  std::string out_;
};

// What is beyond the end reads as zeros and leaves the reader broken.
class Reader {
 public:
  Reader(std::string_view blob, std::string_view magic, uint16_t newest = kVersionLayout)
      : left_(blob), magic_(magic) {
    ok_ = blob.substr(0, magic.size()) == magic;
    left_.remove_prefix(std::min(magic.size(), blob.size()));
    layout_ = Take<uint16_t>();
    ok_ = ok_ && layout_ >= kVersionLayout && layout_ <= newest;
    Take<uint16_t>();
  }
  uint16_t layout() const { return layout_; }
  template <typename T>
  T Take() {
    T value{};
    if (left_.size() < sizeof(value)) {
      Break();
      return value;
    }
    std::memcpy(&value, left_.data(), sizeof(value));
    left_.remove_prefix(sizeof(value));
    return value;
  }
  // A number of things that take at least `bytes` each: more than are left are none.
  uint32_t TakeCount(size_t bytes) {
    const auto count = Take<uint32_t>();
    if (count <= left_.size() / bytes) return count;
    Break();
    return 0;
  }
  std::string_view TakeBytes() {
    const std::string_view text = left_.substr(0, TakeCount(1));
    left_.remove_prefix(text.size());
    return text;
  }
  std::string TakeText() { return std::string(TakeBytes()); }
  Eigen::Vector3d TakePoint() {
    Eigen::Vector3d point;
    for (double& x : point) x = Take<double>();
    return point;
  }
  Rigid3 TakeRigid() {
    Rigid3 transform;
    for (int i = 0; i < 9; ++i) transform.R(i / 3, i % 3) = Take<double>();
    transform.t = TakePoint();
    return transform;
  }
  absl::Status End() const {
    if (ok_ && left_.empty()) return absl::OkStatus();
    return absl::DataLossError(
        absl::StrCat("stored ", std::string(magic_), " blob: not of this layout"));
  }

 private:
  void Break() {
    ok_ = false;
    left_ = {};
  }

  std::string_view left_, magic_;
  uint16_t layout_ = 0;
  bool ok_ = false;
};

constexpr size_t kRigidBytes = 12 * sizeof(double);

void WriteGrasp(const Grasp& grasp, Writer* out) {
  out->AddText(grasp.name);
  out->AddRigid(grasp.object_from_gripper);
  for (const double x : {grasp.jaw_opening_m, grasp.grip_width_m, grasp.quality}) out->Add(x);
  out->Add(static_cast<uint8_t>(grasp.object_from_pregrasp.has_value()));
  if (grasp.object_from_pregrasp) out->AddRigid(*grasp.object_from_pregrasp);
}

Grasp ReadGrasp(Reader* in) {
  Grasp grasp;
  grasp.name = in->TakeText();
  grasp.object_from_gripper = in->TakeRigid();
  for (double* x : {&grasp.jaw_opening_m, &grasp.grip_width_m, &grasp.quality}) {
    *x = in->Take<double>();
  }
  if (in->Take<uint8_t>() != 0) grasp.object_from_pregrasp = in->TakeRigid();
  return grasp;
}

}  // namespace

std::string EncodeDetails(const ObjectSummary& summary) {
  const CatalogRecord& record = summary.record;
  const ObjectModel& model = record.model;
  const bool printed = !model.print.places.empty();
  Writer out(kDetailsMagic, printed ? kPrintedLayout : kVersionLayout);
  out.AddText(model.display_name);
  out.AddText(record.create_time);
  out.Add(model.diameter_m);
  for (const int n : {summary.vertex_count, summary.edge_count, summary.triangle_count}) {
    out.Add(static_cast<int64_t>(n));
  }
  out.AddSize(model.symmetries.size());
  for (const Rigid3& symmetry : model.symmetries) out.AddRigid(symmetry);
  out.AddSize(model.grasps.size());
  for (const Grasp& grasp : model.grasps) WriteGrasp(grasp, &out);
  out.AddSize(record.labels.size());
  for (const auto& [key, value] : record.labels) {
    out.AddText(key);
    out.AddText(value);
  }
  const CadSource& source = record.source;
  for (const std::string* text : {&source.file_name, &source.format, &source.unit, &source.sha256})
    out.AddText(*text);
  out.Add(source.size_bytes);
  if (printed) out.AddText(EncodePrint(model.print));
  return std::move(out).Take();
}

std::string EncodeGeometry(const ObjectModel& model) {
  Writer out(kGeometryMagic);
  out.Add(model.diameter_m);
  out.AddSize(model.vertices.size());
  for (const Eigen::Vector3d& v : model.vertices) out.AddPoint(v);
  out.AddSize(model.edges.size());
  for (const ModelEdge& edge : model.edges) {
    for (const int i : {static_cast<int>(edge.kind), edge.start_vertex, edge.end_vertex}) {
      out.Add(int32_t{i});
    }
    out.Add(edge.dihedral_rad);
    out.AddText(EncodePolyline(edge.polyline));
  }
  out.AddText(EncodeMesh(model.mesh));
  return std::move(out).Take();
}

absl::StatusOr<ObjectSummary> DecodeDetails(std::string_view blob) {
  Reader in(blob, kDetailsMagic, kPrintedLayout);
  ObjectSummary summary;
  CatalogRecord& record = summary.record;
  ObjectModel& model = record.model;
  model.display_name = in.TakeText();
  record.create_time = in.TakeText();
  model.diameter_m = in.Take<double>();
  for (int* n : {&summary.vertex_count, &summary.edge_count, &summary.triangle_count}) {
    *n = static_cast<int>(in.Take<int64_t>());
  }
  for (uint32_t n = in.TakeCount(kRigidBytes); n > 0; --n) {
    model.symmetries.push_back(in.TakeRigid());
  }
  for (uint32_t n = in.TakeCount(kRigidBytes); n > 0; --n) model.grasps.push_back(ReadGrasp(&in));
  for (uint32_t n = in.TakeCount(2 * sizeof(uint32_t)); n > 0; --n) {
    const std::string key = in.TakeText();
    record.labels[key] = in.TakeText();
  }
  CadSource& source = record.source;
  for (std::string* text : {&source.file_name, &source.format, &source.unit, &source.sha256})
    *text = in.TakeText();
  source.size_bytes = in.Take<int64_t>();
  if (in.layout() == kPrintedLayout) {
    HOROPTER_ASSIGN_OR_RETURN(model.print, DecodePrint(in.TakeBytes()));
  }
  HOROPTER_RETURN_IF_ERROR(in.End());
  return summary;
}

absl::Status DecodeGeometry(std::string_view blob, ObjectModel* model) {
  Reader in(blob, kGeometryMagic);
  model->diameter_m = in.Take<double>();
  for (uint32_t n = in.TakeCount(3 * sizeof(double)); n > 0; --n) {
    model->vertices.push_back(in.TakePoint());
  }
  for (uint32_t n = in.TakeCount(4 * sizeof(int32_t)); n > 0; --n) {
    ModelEdge& edge = model->edges.emplace_back();
    edge.kind = static_cast<CurveKind>(in.Take<int32_t>());
    edge.start_vertex = in.Take<int32_t>();
    edge.end_vertex = in.Take<int32_t>();
    edge.dihedral_rad = in.Take<double>();
    const std::string_view polyline = in.TakeBytes();
    if (polyline.empty()) break;
    HOROPTER_ASSIGN_OR_RETURN(edge.polyline, DecodePolyline(polyline));
  }
  const std::string_view mesh = in.TakeBytes();
  HOROPTER_RETURN_IF_ERROR(in.End());
  HOROPTER_ASSIGN_OR_RETURN(model->mesh, DecodeMesh(mesh));
  return absl::OkStatus();
}

}  // namespace horopter
