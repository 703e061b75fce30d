// Backup, verification, export and import of the whole catalog, and the look-alike report.
#include <google/protobuf/util/time_util.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/bop_export.h"
#include "client/cao_file.h"
#include "client/commands.h"
#include "client/convert.h"
#include "client/interrupt.h"
#include "client/output.h"
#include "client/progress.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;

// Objects exactly as the server gave them, beside the BOP layout, which cannot say everything.
constexpr const char* kObjectsFolder = "objects";
constexpr char kObjectExtension[] = ".pb";

std::string Percent(double stretch) {
  return absl::StrFormat("%.1f %%", 100.0 * stretch);
}

std::string Explain(const v1::LookAlike& a) {
  const std::string id = IdOfResource(a.name());
  const double scale = a.stretch_size() == 3 ? a.stretch(0) : 1.0;
  const size_t differing =
      static_cast<size_t>(a.only_in_named_m_size() + a.only_in_other_m_size()) / 3;
  std::string text;
  switch (a.kind()) {
    case v1::LookAlike::KIND_CONGRUENT:
      text = differing == 0 ? absl::StrCat(id, " is the same part")
                            : absl::StrCat(id, " is the same part but for some corners");
      break;
    case v1::LookAlike::KIND_SIMILAR:
      text = absl::StrCat(id,
                          " is the same part at ",
                          Percent(scale),
                          " of the size: only a known size tells them apart");
      break;
    case v1::LookAlike::KIND_MIRROR:
      text = absl::StrCat(id, " is its mirror image at ", Percent(scale), " of the size");
      break;
    case v1::LookAlike::KIND_AFFINE:
      text = absl::StrCat(id,
                          " is the same part stretched by ",
                          Percent(a.stretch(0)),
                          ", ",
                          Percent(a.stretch(1)),
                          ", ",
                          Percent(a.stretch(2)));
      break;
    default:
      text = absl::StrCat(id, " is the same part up to a collineation");
  }
  if (differing > 0) {
    absl::StrAppend(&text,
                    "; ",
                    a.matched_vertices(),
                    " corners agree, ",
                    a.only_in_named_m_size() / 3,
                    " and ",
                    a.only_in_other_m_size() / 3,
                    " do not");
    const auto& only = a.only_in_named_m_size() > 0 ? a.only_in_named_m() : a.only_in_other_m();
    absl::StrAppend(
        &text,
        absl::StrFormat(
            ", e.g. at (%.1f, %.1f, %.1f) mm", only[0] * 1e3, only[1] * 1e3, only[2] * 1e3));
  }
  return text;
}

absl::Status WriteFile(const fs::path& path, const std::string& bytes) {
  std::ofstream out(path, std::ios::binary);
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  out.close();
  if (!out)
    return absl::FailedPreconditionError(absl::StrCat(path.string(), ": cannot be written"));
  return absl::OkStatus();
}

// "obj_000012" keeps its number; other ids take the smallest free ones.
std::vector<int> NumbersFor(const std::vector<std::string>& ids) {
  std::vector<int> numbers(ids.size(), 0);
  std::vector<int> taken;
  for (size_t i = 0; i < ids.size(); ++i) {
    int number = 0, end = 0;
    if (std::sscanf(ids[i].c_str(), "obj_%6d%n", &number, &end) == 1 &&
        end == static_cast<int>(ids[i].size()) && number > 0 && BopObjectName(number) == ids[i]) {
      numbers[i] = number;
      taken.push_back(number);
    }
  }
  int next = 1;
  for (int& number : numbers) {
    if (number > 0) continue;
    while (std::find(taken.begin(), taken.end(), next) != taken.end()) ++next;
    number = next++;
  }
  return numbers;
}

absl::StatusOr<std::vector<std::string>> AllIds(HoropterClient& client) {
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<v1::Object> objects, client.ListObjects());
  std::vector<std::string> ids;
  for (const v1::Object& object : objects) ids.push_back(IdOfResource(object.name()));
  return ids;
}

// Names of a server become names of files: nothing but ids may, or a wrong server writes outside of
// the folder.
absl::Status CheckFileNames(const std::string& id, const v1::Object& object) {
  constexpr char kIdLetters[] = "abcdefghijklmnopqrstuvwxyz0123456789_-";
  const auto is_plain = [&](const std::string& text, size_t longest) {
    return text.size() <= longest && text.find_first_not_of(kIdLetters) == std::string::npos;
  };
  if (id.empty() || !is_plain(id, 63) || !is_plain(object.source().format(), 16)) {
    return absl::DataLossError(absl::StrCat("the server names an object '",
                                            absl::CHexEscape(id),
                                            "' of format '",
                                            absl::CHexEscape(object.source().format()),
                                            "': that is no name of a file"));
  }
  return absl::OkStatus();
}

absl::Status MakeExportFolder(const std::string& folder) {
  std::error_code error;
  for (const char* below : {kObjectsFolder, "cao"}) {
    fs::create_directories(fs::path(folder) / below, error);
    if (error) return absl::FailedPreconditionError(absl::StrCat(folder, ": ", error.message()));
  }
  return absl::OkStatus();
}

absl::Status Export(HoropterClient& client,
                    const std::vector<std::string>& ids,
                    const std::string& folder) {
  std::error_code error;
  if (fs::exists(folder, error) && !fs::is_empty(folder, error)) {
    return absl::AlreadyExistsError(absl::StrCat(folder, ": is not empty"));
  }
  const std::vector<int> numbers = NumbersFor(ids);
  std::vector<BopExportEntry> entries;
  Progress progress("objects", static_cast<int64_t>(ids.size()));
  for (size_t i = 0; i < ids.size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(v1::Object object, client.GetObject(ids[i], v1::OBJECT_VIEW_FULL));
    HOROPTER_RETURN_IF_ERROR(CheckFileNames(ids[i], object));
    progress.Update(static_cast<int64_t>(i), ids[i]);
    // Not before the first object is here: an interrupted export leaves no empty folder.
    HOROPTER_RETURN_IF_ERROR(MakeExportFolder(folder));
    HOROPTER_RETURN_IF_ERROR(
        WriteFile(fs::path(folder) / kObjectsFolder / (ids[i] + kObjectExtension),
                  object.SerializeAsString()));
    BopExportEntry entry;
    entry.obj_id = numbers[i];
    entry.model = FromProto(object);
    entry.model.id = ids[i];
    entry.model.display_name = object.display_name();
    entry.cad_format = object.source().format();
    entry.cad_content = std::move(*object.mutable_source()->mutable_content());
    HOROPTER_RETURN_IF_ERROR(WriteBopObject(folder, entry));
    const std::vector<Eigen::Vector3d>& vertices = entry.model.mesh.vertices;
    if (!vertices.empty()) entry.low = entry.high = vertices[0];
    for (const Eigen::Vector3d& v : vertices) {
      entry.low = entry.low.cwiseMin(v);
      entry.high = entry.high.cwiseMax(v);
    }
    HOROPTER_RETURN_IF_ERROR(
        WriteCao(absl::StrCat(folder, "/cao/", BopObjectName(numbers[i]), ".cao"), entry.model));
    entry.model.mesh = {};
    entry.model.edges.clear();
    entry.cad_content.clear();
    entries.push_back(std::move(entry));
  }
  HOROPTER_RETURN_IF_ERROR(MakeExportFolder(folder));
  HOROPTER_RETURN_IF_ERROR(WriteBopLists(folder, entries));
  progress.Clear();
  Say("%zu objects in %s\n", ids.size(), folder.c_str());
  SayJson({{"objects", ids}, {"folder", folder}});
  return absl::OkStatus();
}

nlohmann::json LookAlikesJson(const v1::ListLookAlikesResponse& found) {
  nlohmann::json list = nlohmann::json::array();
  for (const v1::LookAlike& a : found.look_alikes()) {
    list.push_back({{"id", IdOfResource(a.name())},
                    {"kind", v1::LookAlike::Kind_Name(a.kind()).substr(5)},
                    {"stretch", std::vector<double>(a.stretch().begin(), a.stretch().end())},
                    {"matched_corners", a.matched_vertices()}});
  }
  return list;
}

std::string Explain(const v1::UntoldDecoy& decoy) {
  if (decoy.kind() == v1::UntoldDecoy::KIND_MIRROR_IMAGE) return "its mirror image";
  const Eigen::Vector3d at = FromProto(decoy.feature_place()) * 1e3;
  return absl::StrFormat("one without the %.2f mm large feature at (%.1f, %.1f, %.1f) mm",
                         decoy.feature_size_m() * 1e3,
                         at.x(),
                         at.y(),
                         at.z());
}

void PrintLookAlikes(const v1::ListLookAlikesResponse& found) {
  for (const v1::LookAlike& look_alike : found.look_alikes()) {
    Say("look-alike: %s\n", Explain(look_alike).c_str());
  }
  constexpr int kMostSaid = 5;
  const int decoys = found.untold_decoys_size();
  for (int i = 0; i < std::min(decoys, kMostSaid); ++i) {
    Say("not told from it where it is 160 px large: %s (%.0f px of edge)\n",
        Explain(found.untold_decoys(i)).c_str(),
        found.untold_decoys(i).differing_px());
  }
  if (decoys > kMostSaid) Say("... and %d more of that kind\n", decoys - kMostSaid);
}

}  // namespace

absl::Status ReportLookAlikes(HoropterClient& client, const std::string& id) {
  HOROPTER_ASSIGN_OR_RETURN(const v1::ListLookAlikesResponse found, client.ListLookAlikes(id));
  PrintLookAlikes(found);
  return absl::OkStatus();
}

absl::Status ObjectLookAlikes(HoropterClient& client, const std::string& id) {
  HOROPTER_ASSIGN_OR_RETURN(const v1::ListLookAlikesResponse found, client.ListLookAlikes(id));
  PrintLookAlikes(found);
  Say("%d look-alikes among %d other objects\n",
      found.look_alikes_size(),
      static_cast<int>(found.compared()));
  SayJson({{"id", id},
           {"look_alikes", LookAlikesJson(found)},
           {"compared", found.compared()},
           {"untold_decoys", found.untold_decoys_size()}});
  return absl::OkStatus();
}

absl::Status CatalogRebuild(HoropterClient& client, std::vector<std::string> ids) {
  if (ids.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(ids, AllIds(client));
  }
  int changed = 0;
  int64_t done = 0;
  Progress progress("rebuild", static_cast<int64_t>(ids.size()));
  for (const std::string& id : ids) {
    HOROPTER_ASSIGN_OR_RETURN(const bool differed, client.RebuildObject(id));
    changed += differed;
    progress.Update(++done, id);
  }
  progress.Clear();
  SayJson({{"objects", ids.size()}, {"changed", changed}});
  Say("%zu objects rebuilt, the derived data of %d changed\n", ids.size(), changed);
  return absl::OkStatus();
}

absl::Status CatalogVerify(HoropterClient& client,
                           bool recompute,
                           const std::vector<std::string>& ids) {
  for (const std::string& id : ids) {
    HOROPTER_RETURN_IF_ERROR(client.GetObject(id, v1::OBJECT_VIEW_BASIC).status());
  }
  Progress progress("%", 100);
  HOROPTER_ASSIGN_OR_RETURN(const v1::VerifyCatalogResponse result,
                            client.VerifyCatalog(recompute, [&](double share) {
                              progress.Update(static_cast<int64_t>(100.0 * share));
                            }));
  progress.Clear();
  int problems = 0;
  nlohmann::json list = nlohmann::json::array();
  for (const auto& problem : result.problems()) {
    const std::string id = problem.name().empty() ? "" : IdOfResource(problem.name());
    if (!ids.empty() && !id.empty() && std::find(ids.begin(), ids.end(), id) == ids.end()) continue;
    ++problems;
    list.push_back({{"id", id}, {"what", problem.what()}});
    Say("%s: %s\n", id.empty() ? "catalog" : id.c_str(), problem.what().c_str());
  }
  const int checked = ids.empty() ? result.objects() : static_cast<int>(ids.size());
  Say("%d objects checked, %d problems\n", checked, problems);
  SayJson({{"objects", checked}, {"problems", list}});
  if (problems == 0) return absl::OkStatus();
  return absl::DataLossError(
      "the catalog is damaged; `horopter catalog rebuild` recomputes derived data, for the rest "
      "restore a backup or enrol the objects again");
}

absl::Status ObjectExport(HoropterClient& client,
                          const std::vector<std::string>& ids,
                          const std::string& folder) {
  return Export(client, ids, folder);
}

absl::Status CatalogExport(HoropterClient& client, const std::string& folder) {
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<std::string> ids, AllIds(client));
  return Export(client, ids, folder);
}

absl::Status CatalogImport(HoropterClient& client, const std::string& folder) {
  std::vector<fs::path> files;
  std::error_code error;
  for (fs::directory_iterator it(fs::path(folder) / kObjectsFolder, error), end;
       !error && it != end;
       it.increment(error)) {
    if (it->path().extension() == kObjectExtension) files.push_back(it->path());
  }
  // Any other dataset in BOP layout is enrolled from its CAD files and meshes.
  if (files.empty()) return DatasetEnroll(client, folder);
  std::sort(files.begin(), files.end());
  Progress progress("import", static_cast<int64_t>(files.size()));
  int64_t done = 0;
  for (const fs::path& file : files) {
    HOROPTER_ASSIGN_OR_RETURN(const std::string bytes, ReadFileBytes(file.string()));
    v1::Object object;
    if (!object.ParseFromString(bytes)) {
      return absl::InvalidArgumentError(absl::StrCat(file.string(), ": not an exported object"));
    }
    HOROPTER_RETURN_IF_ERROR(client.PutObject(object));
    progress.Update(++done, file.stem().string());
  }
  progress.Clear();
  SayJson({{"objects", files.size()}});
  Say("%zu objects imported\n", files.size());
  return absl::OkStatus();
}

absl::Status CatalogMigrate(const std::string& from, const std::string& to) {
  std::error_code error;
  const std::filesystem::path self = std::filesystem::read_symlink("/proc/self/exe", error);
  const std::filesystem::path folder = self.parent_path();
  // Installed beside this program; in a build in the next folder; else wherever PATH leads.
  for (const std::string& program : {(folder / "horopterd").string(),
                                     (folder.parent_path() / "bin" / "horopterd").string(),
                                     std::string("horopterd")}) {
    execlp(program.c_str(),
           program.c_str(),
           "--db",
           from.c_str(),
           "--copy-catalog-to",
           to.c_str(),
           static_cast<char*>(nullptr));
  }
  return absl::FailedPreconditionError(
      "horopterd, which copies catalogs, is not installed on this machine (package "
      "horopter-server)");
}

}  // namespace horopter
