#include <unistd.h>

#include <IGESControl_Reader.hxx>
#include <IGESData_GlobalSection.hxx>
#include <IGESData_IGESEntity.hxx>
#include <IGESData_IGESModel.hxx>
#include <Interface_CheckIterator.hxx>
#include <Interface_Static.hxx>
#include <TopExp_Explorer.hxx>
#include <TransferBRep.hxx>
#include <Transfer_TransientProcess.hxx>
#include <XSControl_TransferReader.hxx>
#include <XSControl_WorkSession.hxx>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <optional>
#include <set>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "client/brep_file.h"
#include "client/cad_findings.h"
#include "client/gzip.h"
#include "client/mesh_file.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

absl::Status BadIges(const std::string& path, const std::string& why) {
  return absl::InvalidArgumentError(absl::StrCat(path, ": ", why));
}

// The text up to its terminate section, without the mark of CP/M that old programs put behind it.
// Errors: INVALID_ARGUMENT (the last record is no terminate section: letter T in column 73).
absl::StatusOr<std::string> CompleteIges(const std::string& path, std::string text) {
  const size_t end = text.find_last_not_of(std::string_view(" \r\n\t\x1A\0", 6));
  const size_t line = end == std::string::npos ? end : text.find_last_of("\r\n", end);
  const size_t start = line == std::string::npos ? 0 : line + 1;
  if (end == std::string::npos || end < start + 72 || text[start + 72] != 'T') {
    return BadIges(path, "not an IGES file, or cut short (no terminate section)");
  }
  text.resize(end + 1);
  text += '\n';
  return text;
}

// A file of this process alone that is gone with it.
class TemporaryFile {
 public:
  explicit TemporaryFile(const std::string& content) {
    std::error_code error;
    std::string name =
        (std::filesystem::temp_directory_path(error) / "horopter-XXXXXX.igs").string();
    const int file = error ? -1 : mkstemps(name.data(), 4);
    if (file < 0) return;
    close(file);
    path_ = name;
    std::ofstream out(path_, std::ios::binary);
    out << content;
    out.close();
    if (!out) Remove();
  }
  ~TemporaryFile() { Remove(); }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  const std::string& path() const { return path_; }  // empty: it could not be written

 private:
  void Remove() {
    std::error_code error;
    if (!path_.empty()) std::filesystem::remove(path_, error);
    path_.clear();
  }
  std::string path_;
};

struct IgesUnit {
  const char* name;
  double metres;
};

// By the flag of the global section; flag 3 says that its name counts.
std::optional<IgesUnit> UnitOfFlag(int flag) {
  static const IgesUnit kUnits[] = {{"in", 0.0254},
                                    {"mm", 1e-3},
                                    {nullptr, 0.0},
                                    {"ft", 0.3048},
                                    {"mile", 1609.344},
                                    {"m", 1.0},
                                    {"km", 1e3},
                                    {"mil", 25.4e-6},
                                    {"um", 1e-6},
                                    {"cm", 1e-2},
                                    {"uin", 25.4e-9}};
  if (flag < 1 || flag > 11 || flag == 3) return std::nullopt;
  return kUnits[flag - 1];
}

void TellIgesUnit(const IGESData_GlobalSection& section, CadImport* import) {
  const auto word = section.UnitName();
  const std::string name =
      word.IsNull() ? "" : std::string(absl::StripAsciiWhitespace(word->ToCString()));
  const double of_name = MetresPerUnit(name);
  if (const auto unit = UnitOfFlag(section.UnitFlag())) {
    SetUnit(unit->name, unit->metres, import);
    if (of_name > 0.0 && std::abs(of_name / unit->metres - 1.0) > 1e-6) {
      import->warnings.push_back(absl::StrCat(
          "the file calls its unit ", name, ", but its flag says ", unit->name, ", which counts"));
    }
    return;
  }
  if (of_name > 0.0) return SetUnit(name, of_name, import);
  SetUnit("mm", 1e-3, import);
  import->unit_from_file = false;
  import->warnings.push_back(
      absl::StrCat("the file names no known length unit ('", name, "'); mm assumed"));
}

// Surfaces, faces, shells and solids.
bool IsGeometry(const IGESData_IGESEntity& entity) {
  static const std::set<int> kTypes = {108, 114, 118, 120, 122, 128, 140, 143, 144, 186, 510, 514};
  return kTypes.contains(entity.TypeNumber());
}

// Hidden ones are not read; returns how many of their own there are.
int CountHidden(const IGESData_IGESModel& model) {
  int hidden = 0;
  for (int i = 1; i <= model.NbEntities(); ++i) {
    const Handle(IGESData_IGESEntity) entity = model.Entity(i);
    const bool own = entity->SubordinateStatus() == 0 || entity->SubordinateStatus() == 2;
    hidden += entity->BlankStatus() == 1 && own && IsGeometry(*entity);
  }
  return hidden;
}

// Faces and solids that came to nothing: a solid refuses the file, faces are told.
absl::Status CheckLost(const std::string& path,
                       const IGESControl_Reader& reader,
                       bool some_hidden,
                       CadImport* import) {
  static const std::set<int> kFaces = {143, 144, 510}, kSolids = {186};
  const Handle(IGESData_IGESModel) model = reader.IGESModel();
  const auto process = reader.WS()->TransferReader()->TransientProcess();
  std::string names;
  int faces = 0, all = 0;
  for (int i = 1; i <= model->NbEntities(); ++i) {
    const Handle(IGESData_IGESEntity) entity = model->Entity(i);
    const int type = entity->TypeNumber();
    if (!kFaces.contains(type) && !kSolids.contains(type)) continue;
    if (entity->BlankStatus() == 1) continue;
    ++all;
    const Handle(Transfer_Binder) binder = process->Find(entity);
    const TopoDS_Shape shape = binder.IsNull() ? TopoDS_Shape() : TransferBRep::ShapeResult(binder);
    if (!shape.IsNull() && TopExp_Explorer(shape, TopAbs_FACE).More()) continue;
    const std::string name = absl::StrCat("D", 2 * i - 1, " (type ", type, ")");
    if (kSolids.contains(type))
      return BadIges(path, absl::StrCat("a solid cannot be read: ", name));
    constexpr int kMost = 3;
    if (++faces <= kMost) absl::StrAppend(&names, names.empty() ? "" : ", ", name);
  }
  // The faces of hidden bodies are not read either, and do not say that they are hidden.
  if (faces > 0 && !some_hidden) {
    AddFinding(CadFindingKind::kOther,
               absl::StrCat(faces, " of ", all, " faces of the file cannot be read: ", names),
               import);
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<TopoDS_Shape> ReadIges(const std::string& path, CadImport& import) {
  HOROPTER_ASSIGN_OR_RETURN(std::string bytes, ReadBytes(path));
  const bool packed = IsGzip(bytes);
  if (packed) {
    absl::StatusOr<std::string> unpacked = Gunzip(bytes);
    if (!unpacked.ok()) return BadIges(path, std::string(unpacked.status().message()));
    bytes = *std::move(unpacked);
  }
  HOROPTER_ASSIGN_OR_RETURN(const std::string text, CompleteIges(path, std::move(bytes)));
  // OpenCASCADE reads IGES from files alone.
  const TemporaryFile file(text);
  if (file.path().empty()) {
    return absl::ResourceExhaustedError(
        absl::StrCat(path, ": no room in the folder for temporary files"));
  }
  IGESControl_Reader reader;
  Interface_Static::SetCVal("xstep.cascade.unit", "MM");
  if (reader.ReadFile(file.path().c_str()) != IFSelect_RetDone) {
    return BadIges(path, "not a readable IGES file");
  }
  TellIgesUnit(reader.IGESModel()->GlobalSection(), &import);
  const int hidden = CountHidden(*reader.IGESModel());
  reader.SetReadVisible(hidden > 0);
  reader.TransferRoots();
  const TopoDS_Shape shape = reader.OneShape();
  if (hidden > 0) {
    if (shape.IsNull()) return BadIges(path, "all of its bodies are hidden");
    AddFinding(CadFindingKind::kOther, absl::StrCat(hidden, " hidden bodies left out"), &import);
  }
  HOROPTER_RETURN_IF_ERROR(CheckLost(path, reader, hidden > 0, &import));
  Annotations none;
  return Sewn(shape, &none);
}

}  // namespace horopter
