#include <google/protobuf/util/json_util.h>
#include <google/protobuf/util/time_util.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/bop_dataset.h"
#include "client/bop_results.h"
#include "client/cad_findings.h"
#include "client/cad_import.h"
#include "client/commands.h"
#include "client/convert.h"
#include "client/interrupt.h"
#include "client/output.h"
#include "client/preview.h"
#include "client/progress.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/grasp_check.h"
#include "server/vision/geometry/symmetry.h"

namespace horopter {
namespace {

struct LoadedCad {
  CadImport import;
  CadFile file;
};

void WarnAboutGrasps(const ObjectModel& model) {
  for (const std::string& problem : CheckGrasps(model)) {
    std::fprintf(stderr, "warning: grasp %s\n", problem.c_str());
  }
}

std::string FileName(const std::string& path) {
  return std::filesystem::path(path).filename().string();
}

absl::StatusOr<LoadedCad> WithFile(CadImport import, const std::string& path) {
  LoadedCad cad;
  cad.import = std::move(import);
  HOROPTER_ASSIGN_OR_RETURN(cad.file.content, ReadFileBytes(path));
  cad.file.file_name = FileName(path);
  cad.file.format = absl::AsciiStrToLower(cad.import.format);
  cad.file.unit = cad.import.unit_name;
  for (const std::string& w : cad.import.warnings) {
    std::fprintf(stderr, "warning: %s: %s\n", path.c_str(), w.c_str());
  }
  for (const CadFinding& f : cad.import.findings) {
    const auto& warnings = cad.import.warnings;
    if (std::find(warnings.begin(), warnings.end(), f.text) != warnings.end()) continue;
    std::fprintf(stderr, "note: %s: %s\n", path.c_str(), f.text.c_str());
  }
  return cad;
}

absl::StatusOr<LoadedCad> LoadCad(const std::string& path, const std::string& unit) {
  CadImportOptions options;
  options.unit = unit;
  CadImport import;
  {
    const Waiting waiting(absl::StrCat("reading ", FileName(path)));
    HOROPTER_ASSIGN_OR_RETURN(import, ImportCad(path, options));
  }
  return WithFile(std::move(import), path);
}

std::string Describe(const CadImport& import) {
  const auto& c = import.counts;
  return absl::StrFormat(
      "%s, unit %s (%s), diameter %.1f mm, %d corners, %d lines, %d circles, %d other curves, "
      "%d triangles, %d symmetries",
      import.format,
      import.unit_name,
      import.unit_from_file ? "from the file" : "assumed",
      import.model.diameter_m * 1e3,
      c.at("vertices"),
      c.at("lines"),
      c.at("circles"),
      c.at("other_curves"),
      c.at("triangles"),
      import.model.symmetries.size());
}

// Declared turns that move the surface visibly, the worst one by its place; and what is not
// declared.
void WarnAboutSymmetries(const BopObject& object, const ObjectModel& model) {
  constexpr double kVisible = 4e-3;  // diameters
  const std::vector<SurfaceMismatch> measured =
      MeasureMismatches(model.mesh, model.diameter_m, object.symmetries);
  const auto less = [](const SurfaceMismatch& a, const SurfaceMismatch& b) {
    return a.largest_m < b.largest_m;
  };
  const auto worst = std::max_element(measured.begin(), measured.end(), less);
  if (worst != measured.end() && worst->largest_m > kVisible * model.diameter_m) {
    std::fprintf(stderr,
                 "warning: %s: %s\n",
                 model.id.c_str(),
                 DescribeMismatch(object.symmetries[worst - measured.begin()], *worst).c_str());
  }
  const int missing = CompareSymmetries(object.symmetries, model.symmetries, model).only_derived;
  if (missing > 0) {
    std::fprintf(stderr,
                 "warning: %s: does not declare %d symmetries that its geometry has\n",
                 model.id.c_str(),
                 missing);
  }
}

// Model and CAD file of one dataset object: exact CAD when there is one, symmetries as the dataset
// states them.
absl::StatusOr<LoadedCad> LoadDatasetObject(const BopObject& object) {
  const std::string path = object.cad_path.empty() ? object.mesh_path : object.cad_path;
  HOROPTER_ASSIGN_OR_RETURN(LoadedCad cad, LoadCad(path, object.cad_path.empty() ? "mm" : ""));
  ObjectModel& model = cad.import.model;
  model.id = BopObjectName(object.obj_id);
  model.display_name = object.name;
  if (object.in_models_info) {
    WarnAboutSymmetries(object, model);
    model.symmetries = object.symmetries;
  }
  if (!object.grasps_path.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(model.grasps, ReadGrasps(object.grasps_path));
    WarnAboutGrasps(model);
  }
  return cad;
}

// Enrols one, or replaces it. Returns the verb.
absl::StatusOr<std::string> EnrollOrUpdate(HoropterClient& client, const LoadedCad& cad) {
  const ObjectModel& model = cad.import.model;
  const absl::Status created = client.CreateObject(model, cad.file).status();
  if (created.ok()) return "added";
  if (!absl::IsAlreadyExists(created)) return created;
  HOROPTER_RETURN_IF_ERROR(client.UpdateObject(model, cad.file, {true, true, true}).status());
  return "updated";
}

absl::Status EnrollOfDataset(HoropterClient& client,
                             const BopObject& object,
                             const std::string& place) {
  HOROPTER_ASSIGN_OR_RETURN(const LoadedCad cad, LoadDatasetObject(object));
  const ObjectModel& model = cad.import.model;
  HOROPTER_ASSIGN_OR_RETURN(const std::string verb, EnrollOrUpdate(client, cad));
  Say("%s %s %s %s: %s, %zu grasps\n",
      place.c_str(),
      model.id.c_str(),
      model.display_name.c_str(),
      verb.c_str(),
      Describe(cad.import).c_str(),
      model.grasps.size());
  SayJson({{"id", model.id}, {"verb", verb}, {"grasps", model.grasps.size()}});
  return ReportLookAlikes(client, model.id);
}

}  // namespace

absl::StatusOr<std::string> ReadFileBytes(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::error_code error;
  if (!file || !std::filesystem::is_regular_file(path, error)) {
    return absl::NotFoundError(absl::StrCat(path, ": cannot be opened"));
  }
  std::string bytes{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  if (bytes.empty()) return absl::InvalidArgumentError(absl::StrCat(path, ": empty file"));
  return bytes;
}

absl::Status WritePreview(HoropterClient& client, const std::string& id, const std::string& path) {
  HOROPTER_ASSIGN_OR_RETURN(const v1::Object object,
                            client.GetObject(id, v1::OBJECT_VIEW_GEOMETRY));
  ObjectModel model = FromProto(object);
  model.id = id;
  const std::string extension =
      absl::AsciiStrToLower(std::filesystem::path(path).extension().string());
  const bool jpeg = extension == ".jpg" || extension == ".jpeg";
  if (!jpeg && !extension.empty() && extension != ".png") {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": pictures are .png or .jpg, not ", extension));
  }
  std::vector<uchar> file;
  try {
    cv::imencode(jpeg ? ".jpg" : ".png", RenderPreview(model), file);
  } catch (const std::exception& e) {
    return absl::InternalError(absl::StrCat("preview: ", e.what()));
  }
  return WriteFileAtomically(path, std::string(file.begin(), file.end()));
}

// Sends it, prints what it is and what it can be taken for.
absl::Status Add(HoropterClient& client, LoadedCad cad, const ObjectAddArguments& arguments) {
  ObjectModel& model = cad.import.model;
  model.display_name = arguments.display_name.empty() ? cad.import.name : arguments.display_name;
  if (!arguments.grasps_path.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(model.grasps, ReadGrasps(arguments.grasps_path));
    WarnAboutGrasps(model);
  }
  {
    const Waiting waiting(absl::StrCat("enrolling ", model.id));
    HOROPTER_RETURN_IF_ERROR(client.CreateObject(model, cad.file).status());
  }
  Say("%s added: %s, %zu grasps\n",
      model.id.c_str(),
      Describe(cad.import).c_str(),
      model.grasps.size());
  SayJson({{"id", model.id},
           {"verb", "added"},
           {"grasps", model.grasps.size()},
           {"unit", cad.import.unit_name},
           {"diameter_m", model.diameter_m},
           {"counts", cad.import.counts}});
  HOROPTER_RETURN_IF_ERROR(ReportLookAlikes(client, model.id));
  if (arguments.preview_path.empty()) return absl::OkStatus();
  return WritePreview(client, model.id, arguments.preview_path);
}

absl::Status ObjectPreview(HoropterClient& client, const std::string& id, const std::string& path) {
  HOROPTER_RETURN_IF_ERROR(WritePreview(client, id, path));
  Say("%s drawn in %s\n", id.c_str(), path.c_str());
  SayJson({{"id", id}, {"file", path}});
  return absl::OkStatus();
}

absl::Status ObjectAdd(HoropterClient& client, const ObjectAddArguments& arguments) {
  if (!arguments.preview_path.empty()) {
    HOROPTER_RETURN_IF_ERROR(CheckCanBeWritten(arguments.preview_path));
  }
  if (!arguments.split) {
    HOROPTER_ASSIGN_OR_RETURN(LoadedCad cad, LoadCad(arguments.cad_path, arguments.unit));
    cad.import.model.id = arguments.id;
    return Add(client, std::move(cad), arguments);
  }
  if (!arguments.preview_path.empty()) {
    return absl::InvalidArgumentError("--preview with --split: see `object preview`");
  }
  if (!arguments.grasps_path.empty()) {
    return absl::InvalidArgumentError(
        "--grasps with --split: say by `object update` which solid they belong to");
  }
  CadImportOptions options;
  options.unit = arguments.unit;
  std::vector<CadImport> imports;
  {
    const Waiting waiting(absl::StrCat("reading ", FileName(arguments.cad_path)));
    HOROPTER_ASSIGN_OR_RETURN(imports, ImportCadParts(arguments.cad_path, options));
  }
  for (size_t i = 0; i < imports.size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(LoadedCad cad, WithFile(std::move(imports[i]), arguments.cad_path));
    cad.import.model.id = absl::StrCat(arguments.id, "-", i + 1);
    HOROPTER_RETURN_IF_ERROR(Add(client, std::move(cad), arguments));
  }
  return absl::OkStatus();
}

absl::Status ObjectUpdateCommand(HoropterClient& client, const ObjectUpdateArguments& arguments) {
  LoadedCad cad;
  ObjectUpdate what;
  if (arguments.cad_path) {
    HOROPTER_ASSIGN_OR_RETURN(cad, LoadCad(*arguments.cad_path, arguments.unit));
    what.geometry = true;
  }
  ObjectModel& model = cad.import.model;
  model.id = arguments.id;
  if (arguments.grasps_path) {
    HOROPTER_ASSIGN_OR_RETURN(model.grasps, ReadGrasps(*arguments.grasps_path));
    what.grasps = true;
  }
  if (arguments.display_name) {
    model.display_name = *arguments.display_name;
    what.display_name = true;
  }
  if (!what.geometry && !what.grasps && !what.display_name) {
    return absl::InvalidArgumentError("nothing to update: give --cad, --grasps or --name");
  }
  HOROPTER_RETURN_IF_ERROR(client.UpdateObject(model, cad.file, what).status());
  Say("%s updated\n", model.id.c_str());
  SayJson({{"id", model.id}, {"verb", "updated"}});
  return absl::OkStatus();
}

absl::Status ObjectList(HoropterClient& client) {
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<v1::Object> objects, client.ListObjects());
  Say("%-20s %-24s %9s %8s %6s %10s %7s  %s\n",
      "id",
      "name",
      "diameter",
      "corners",
      "edges",
      "symmetries",
      "grasps",
      "source");
  for (const v1::Object& o : objects) {
    Say("%-20s %-24s %6.1f mm %8d %6d %10d %7d  %s\n",
        IdOfResource(o.name()).c_str(),
        o.display_name().c_str(),
        o.diameter_m() * 1e3,
        o.vertex_count(),
        o.edge_count(),
        o.object_from_symmetric_object_size(),
        o.grasps_size(),
        o.source().file_name().c_str());
  }
  Say("%zu objects\n", objects.size());
  nlohmann::json list = nlohmann::json::array();
  for (const v1::Object& o : objects) {
    list.push_back({{"id", IdOfResource(o.name())},
                    {"name", o.display_name()},
                    {"diameter_m", o.diameter_m()},
                    {"corners", o.vertex_count()},
                    {"edges", o.edge_count()},
                    {"triangles", o.triangle_count()},
                    {"symmetries", o.object_from_symmetric_object_size()},
                    {"grasps", o.grasps_size()},
                    {"source", o.source().file_name()}});
  }
  SayJson({{"objects", list}});
  return absl::OkStatus();
}

absl::Status ObjectShow(HoropterClient& client, const std::string& id) {
  HOROPTER_ASSIGN_OR_RETURN(const v1::Object o, client.GetObject(id, v1::OBJECT_VIEW_BASIC));
  if (JsonOutput()) {
    google::protobuf::util::JsonPrintOptions options;
    options.add_whitespace = true;
    options.preserve_proto_field_names = true;
    std::string text;
    const auto status = google::protobuf::util::MessageToJsonString(o, &text, options);
    if (!status.ok()) return absl::InternalError(status.ToString());
    std::printf("%s", text.c_str());
    return absl::OkStatus();
  }
  using google::protobuf::util::TimeUtil;
  Say("id          %s\n", IdOfResource(o.name()).c_str());
  Say("name        %s\n", o.display_name().c_str());
  Say("diameter    %.2f mm\n", o.diameter_m() * 1e3);
  Say("geometry    %d corners, %d edges, %d triangles, %d symmetries\n",
      o.vertex_count(),
      o.edge_count(),
      o.triangle_count(),
      o.object_from_symmetric_object_size());
  Say("source      %s (%s, unit %s, %lld bytes, sha256 %s)\n",
      o.source().file_name().c_str(),
      o.source().format().c_str(),
      o.source().unit().c_str(),
      static_cast<long long>(o.source().size_bytes()),
      o.source().sha256().c_str());
  Say("created     %s\nupdated     %s\n",
      TimeUtil::ToString(o.create_time()).c_str(),
      TimeUtil::ToString(o.update_time()).c_str());
  for (const v1::Grasp& g : o.grasps()) {
    const Eigen::Vector3d t = FromProto(g.object_from_gripper()).t * 1e3;
    const std::string gripper =
        g.has_suction() ? absl::StrFormat("cup of radius %.1f mm", g.suction().cup_radius_m() * 1e3)
                        : absl::StrFormat("opening %.1f mm, grip %.1f mm",
                                          g.parallel_jaw().jaw_opening_m() * 1e3,
                                          g.parallel_jaw().grip_width_m() * 1e3);
    Say("grasp       %s at (%.1f, %.1f, %.1f) mm, %s%s\n",
        g.name().c_str(),
        t.x(),
        t.y(),
        t.z(),
        gripper.c_str(),
        g.has_object_from_pregrasp() ? ", with a pre-grasp" : "");
  }
  return absl::OkStatus();
}

absl::Status ObjectRemove(HoropterClient& client, const std::vector<std::string>& ids) {
  for (const std::string& id : ids) {
    HOROPTER_RETURN_IF_ERROR(client.DeleteObject(id));
    Say("%s removed\n", id.c_str());
    SayJson({{"id", id}, {"verb", "removed"}});
  }
  return absl::OkStatus();
}

absl::Status DatasetEnroll(HoropterClient& client, const std::string& folder) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset dataset, ReadBopDataset(folder));
  size_t number = 0, failed = 0;
  absl::Status first_error;
  for (const BopObject& object : dataset.objects) {
    const std::string place = absl::StrFormat("[%zu/%zu]", ++number, dataset.objects.size());
    const absl::Status status = EnrollOfDataset(client, object, place);
    if (absl::IsUnavailable(status)) return status;
    if (Interrupted()) return absl::CancelledError("interrupted");
    if (status.ok()) continue;
    // One bad file must not keep the others out.
    const std::string id = BopObjectName(object.obj_id);
    Say("%s %s not enrolled: %s\n", place.c_str(), id.c_str(), status.ToString().c_str());
    SayJson({{"id", id}, {"error", status.ToString()}});
    ++failed;
    if (first_error.ok()) first_error = status;
  }
  if (failed == 0) return absl::OkStatus();
  absl::Status status(first_error.code(),
                      absl::StrFormat("%zu of %zu objects not enrolled; the first: %s",
                                      failed,
                                      dataset.objects.size(),
                                      first_error.message()));
  first_error.ForEachPayload(
      [&](absl::string_view type, const absl::Cord& payload) { status.SetPayload(type, payload); });
  return status;
}

}  // namespace horopter
