// What enrolment costs, object by object and stage by stage, on one core: from the CAD file to what
// the catalog stores and searches.
//
//   enrolment_report DATASET [ID...]
//
// One line an object: seconds of one core to read the file (symmetries included), to prepare it
// without its aspects, for its aspects and fragments; all together; triangles given and drawn;
// aspects; bytes of the derived data and in memory; and the checksum of the derived data, by which
// two builds are compared. The last line: median and worst of the sums, least and most memory.
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <set>
#include <string>
#include <vector>

#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/vision/recognition/object/prepared_blob.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

// Of the processor, so that other programs on the machine do not count; nothing here has threads.
double Seconds() {
  return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

// FNV-1a.
std::uint64_t Checksum(const std::string& bytes) {
  std::uint64_t sum = 0xcbf29ce484222325ull;
  for (const char c : bytes) sum = (sum ^ static_cast<unsigned char>(c)) * 0x100000001b3ull;
  return sum;
}

template <typename T>
std::size_t BytesOf(const std::vector<T>& v) {
  return v.size() * sizeof(T);
}

std::size_t MemoryOf(const PreparedObject& o) {
  std::size_t bytes =
      BytesOf(o.samples) + BytesOf(o.model.mesh.vertices) + BytesOf(o.model.mesh.triangles);
  for (const ModelEdge& e : o.model.edges) bytes += sizeof(e) + BytesOf(e.polyline);
  if (o.aspects == nullptr) return bytes;
  const RenderMesh& mesh = o.aspects->object.mesh;
  const AspectSet& set = o.aspects->object.aspects;
  return bytes + BytesOf(mesh.vertices) + BytesOf(mesh.triangles) + BytesOf(mesh.normals) +
         BytesOf(mesh.face_normals) + BytesOf(mesh.edges) + BytesOf(mesh.sharp_edges) +
         BytesOf(set.aspects) + BytesOf(set.points) + BytesOf(o.aspects->fragments.fragments);
}

struct Row {
  double read_s = 0.0, prepare_s = 0.0, aspects_s = 0.0;
  std::size_t blob_bytes = 0, memory_bytes = 0;
  double all_s() const { return read_s + prepare_s + aspects_s; }
};

absl::StatusOr<Row> Enrol(const BopObject& object) {
  Row row;
  const std::string& path = object.cad_path.empty() ? object.mesh_path : object.cad_path;
  CadImportOptions options;
  if (object.cad_path.empty()) options.unit = "mm";
  const double start = Seconds();
  absl::StatusOr<CadImport> import = ImportCad(path, options);
  if (!import.ok()) return import.status();
  row.read_s = Seconds() - start;
  ObjectModel model = std::move(import->model);
  model.id = BopObjectName(object.obj_id);
  const std::size_t given = model.mesh.triangles.size();
  const std::size_t symmetries = model.symmetries.size();
  if (object.in_models_info) model.symmetries = object.symmetries;
  const auto bare = PrepareObject(model);
  if (!bare.ok()) return bare.status();
  row.prepare_s = Seconds() - start - row.read_s;
  const auto aspects = MakeModelAspects(model);
  if (!aspects.ok()) return aspects.status();
  row.aspects_s = Seconds() - start - row.read_s - row.prepare_s;
  PreparedObject whole = **bare;
  whole.aspects = *aspects;
  const PreparedBytes bytes = EncodePrepared(whole, {.aspects = true});
  row.blob_bytes = bytes.data.size() + bytes.keys.size();
  row.memory_bytes = MemoryOf(whole);
  std::printf("%-10s %-20s %6.2f %6.2f %6.2f %6.2f %8zu %6zu %5zu/%-3zu %5zu %8zu %8zu %016llx\n",
              model.id.c_str(),
              object.name.c_str(),
              row.read_s,
              row.prepare_s,
              row.aspects_s,
              row.all_s(),
              given,
              whole.aspects->object.mesh.triangles.size(),
              model.symmetries.size(),
              symmetries,
              whole.aspects->object.aspects.aspects.size(),
              row.blob_bytes,
              row.memory_bytes,
              static_cast<unsigned long long>(Checksum(bytes.data)));
  std::fflush(stdout);
  return row;
}

int Main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: enrolment_report DATASET [ID...]\n");
    return 2;
  }
  const absl::StatusOr<BopDataset> data = ReadBopDataset(argv[1]);
  if (!data.ok()) {
    std::fprintf(stderr, "%s\n", std::string(data.status().message()).c_str());
    return 1;
  }
  std::set<int> wanted;
  for (int i = 2; i < argc; ++i) wanted.insert(std::atoi(argv[i]));
  std::printf("%-10s %-20s %6s %6s %6s %6s %8s %6s %9s %5s %8s %8s %16s\n",
              "id",
              "name",
              "read_s",
              "prep_s",
              "asp_s",
              "all_s",
              "given",
              "drawn",
              "told/own",
              "views",
              "stored",
              "memory",
              "checksum");
  std::vector<double> seconds;
  std::vector<std::size_t> stored, memory;
  for (const BopObject& object : data->objects) {
    if (!wanted.empty() && wanted.count(object.obj_id) == 0) continue;
    const absl::StatusOr<Row> row = Enrol(object);
    if (!row.ok()) {
      std::printf("%s: %s\n", object.name.c_str(), std::string(row.status().message()).c_str());
      continue;
    }
    seconds.push_back(row->all_s());
    stored.push_back(row->blob_bytes);
    memory.push_back(row->memory_bytes);
  }
  if (seconds.empty()) return 1;
  std::sort(seconds.begin(), seconds.end());
  std::sort(stored.begin(), stored.end());
  std::sort(memory.begin(), memory.end());
  std::printf(
      "%zu objects: %.2f s median, %.2f s worst; stored %zu - %zu, median %zu bytes; in memory %zu "
      "- %zu, median %zu bytes\n",
      seconds.size(),
      seconds[seconds.size() / 2],
      seconds.back(),
      stored.front(),
      stored.back(),
      stored[stored.size() / 2],
      memory.front(),
      memory.back(),
      memory[memory.size() / 2]);
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
