#include <Interface_CheckIterator.hxx>
#include <Interface_Static.hxx>
#include <Quantity_Color.hxx>
#include <STEPConstruct.hxx>
#include <STEPConstruct_Styles.hxx>
#include <STEPControl_Reader.hxx>
#include <StepData_StepModel.hxx>
#include <StepRepr_RepresentationItem.hxx>
#include <StepShape_FaceSurface.hxx>
#include <StepVisual_Colour.hxx>
#include <StepVisual_StyledItem.hxx>
#include <TopExp_Explorer.hxx>
#include <TransferBRep.hxx>
#include <Transfer_TransientProcess.hxx>
#include <XSControl_TransferReader.hxx>
#include <XSControl_WorkSession.hxx>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <map>
#include <set>
#include <sstream>
#include <unordered_map>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/brep_file.h"
#include "client/cad_findings.h"
#include "client/gzip.h"
#include "client/mesh_file.h"
#include "client/step_model.h"
#include "client/step_tessellation.h"
#include "client/step_text.h"
#include "client/step_unit.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

absl::Status BadStep(const std::string& path, const std::string& why) {
  return absl::InvalidArgumentError(absl::StrCat(path, ": ", why));
}

// Surface colours as styled items give them; what nothing is styled is left out.
std::map<const TopoDS_TShape*, Rgba> ColorsOf(const STEPControl_Reader& reader) {
  std::map<const TopoDS_TShape*, Rgba> colors;
  STEPConstruct_Styles styles(reader.WS());
  if (!styles.LoadStyles()) return colors;
  const auto process = reader.WS()->TransferReader()->TransientProcess();
  for (int i = 1; i <= styles.NbStyles(); ++i) {
    const Handle(StepVisual_StyledItem) style = styles.Style(i);
    Handle(StepVisual_Colour) surface, border, curve, rendering;
    double transparency = 0.0;
    bool is_component = false;
    if (style.IsNull() ||
        !styles.GetColors(style, surface, border, curve, rendering, transparency, is_component)) {
      continue;
    }
    if (surface.IsNull()) surface = rendering;
    const auto item = Handle(StepRepr_RepresentationItem)::DownCast(style->ItemAP242().Value());
    Quantity_Color color;
    if (item.IsNull() || surface.IsNull() || !STEPConstruct_Styles::DecodeColor(surface, color)) {
      continue;
    }
    const TopoDS_Shape shape = STEPConstruct::FindShape(process, item);
    if (shape.IsNull()) continue;
    double rgb[3];
    color.Values(rgb[0], rgb[1], rgb[2], Quantity_TOC_sRGB);
    Rgba& out = colors[shape.TShape().get()];
    for (int k = 0; k < 3; ++k) {
      out[k] = static_cast<std::uint8_t>(std::lround(255.0 * std::clamp(rgb[k], 0.0, 1.0)));
    }
    // Opacity 0 stands for no colour; what the file makes invisible still has one.
    out[3] =
        static_cast<std::uint8_t>(std::lround(255.0 - 254.0 * std::clamp(transparency, 0.0, 1.0)));
  }
  return colors;
}

// A body of the file and what became of it.
struct StepBody {
  int id = 0;
  TopoDS_Shape shape;  // null: nothing
};

std::string Named(const StepText& step, int id) {
  const std::string product = ProductNameOf(step, id);
  return absl::StrCat("#", id, " (", step.TypeOf(id), product.empty() ? "" : ", ", product, ")");
}

void VisitFaces(const TopoDS_Shape& shape, const std::function<void(const TopoDS_TShape*)>& use) {
  if (shape.IsNull()) return;
  for (TopExp_Explorer it(shape, TopAbs_FACE); it.More(); it.Next()) {
    use(it.Current().TShape().get());
  }
}

// What OpenCASCADE made of the file's entities.
class Transferred {
 public:
  Transferred(const STEPControl_Reader& reader, const StepText& step)
      : step_(step),
        model_(Handle(StepData_StepModel)::DownCast(reader.WS()->Model())),
        process_(reader.WS()->TransferReader()->TransientProcess()) {
    for (int i = 1; i <= model_->NbEntities(); ++i) {
      const Handle(Standard_Transient) entity = model_->Value(i);
      entity_of_[model_->IdentLabel(entity)] = i;
      if (entity->IsKind(STANDARD_TYPE(StepShape_FaceSurface))) faces_.push_back(entity);
    }
  }

  std::vector<StepBody> Bodies() const {
    std::vector<StepBody> bodies;
    for (const int id : BodiesOf(step_)) {
      if (step_.TypeOf(id).starts_with("TESSELLATED")) continue;
      const auto known = entity_of_.find(id);
      bodies.push_back({id, {}});
      if (known != entity_of_.end()) {
        bodies.back().shape = TransferBRep::ShapeResult(process_, model_->Value(known->second));
      }
    }
    return bodies;
  }

  // Warnings about faces that came to nothing, and about what OpenCASCADE calls failed.
  void Tell(CadImport* import) const {
    std::vector<int> lost;
    for (const Handle(Standard_Transient) & face : faces_) {
      const Handle(Transfer_Binder) binder = process_->Find(face);
      if (!binder.IsNull() && TransferBRep::ShapeResult(binder).IsNull()) {
        lost.push_back(model_->IdentLabel(face));
      }
    }
    constexpr size_t kMost = 3;
    if (!lost.empty()) {
      std::string names;
      for (size_t i = 0; i < std::min(lost.size(), kMost); ++i) {
        absl::StrAppend(&names, i > 0 ? ", " : "", "#", lost[i], " (", step_.TypeOf(lost[i]), ")");
      }
      AddFinding(CadFindingKind::kOther,
                 absl::StrCat(lost.size(),
                              " faces of the file cannot be read: ",
                              names,
                              lost.size() > kMost ? " ..." : ""),
                 import);
    }
    Interface_CheckIterator checks = process_->CheckList(true);
    size_t told = 0;
    for (checks.Start(); checks.More() && told < kMost; checks.Next()) {
      const Handle(Interface_Check) check = checks.Value();
      if (check.IsNull() || check->NbFails() == 0 || check->Entity().IsNull()) continue;
      const int id = model_->IdentLabel(check->Entity());
      ++told;
      import->warnings.push_back(
          absl::StrCat("#", id, " (", step_.TypeOf(id), "): ", check->CFail(1)));
    }
  }

 private:
  const StepText& step_;
  Handle(StepData_StepModel) model_;
  Handle(Transfer_TransientProcess) process_;
  std::unordered_map<int, int> entity_of_;
  std::vector<Handle(Standard_Transient)> faces_;
};

// What a file cannot be read without.
absl::Status CheckParts(const std::string& path, const StepText& step) {
  if (const std::string missing = MissingEntities(step); !missing.empty()) {
    return BadStep(path, missing);
  }
  const std::vector<std::string> files = ExternalFiles(step);
  if (files.empty()) return absl::OkStatus();
  std::string names;
  for (const std::string& file : files) {
    std::error_code error;
    const bool there =
        std::filesystem::exists(std::filesystem::path(path).parent_path() / file, error);
    absl::StrAppend(&names, names.empty() ? "" : ", ", "'", file, "'", there ? "" : " (missing)");
  }
  return BadStep(path,
                 absl::StrCat("parts of it are in other files, which are not read with it: ",
                              names,
                              "; export it as one file or enrol those"));
}

// Bodies that came to nothing refuse the file.
absl::Status CheckBodies(const std::string& path,
                         const StepText& step,
                         const TopoDS_Shape& shape,
                         const std::vector<StepBody>& bodies) {
  std::set<const TopoDS_TShape*> faces;
  VisitFaces(shape, [&](const TopoDS_TShape* face) { faces.insert(face); });
  std::string lost;
  size_t count = 0;
  for (const StepBody& body : bodies) {
    bool there = false;
    VisitFaces(body.shape, [&](const TopoDS_TShape* f) { there = there || faces.contains(f); });
    if (there) continue;
    constexpr size_t kMost = 3;
    if (++count <= kMost) absl::StrAppend(&lost, lost.empty() ? "" : ", ", Named(step, body.id));
  }
  for (const int id : EmptyShapes(step)) {
    ++count;
    absl::StrAppend(&lost,
                    lost.empty() ? "" : ", ",
                    "#",
                    id,
                    " (",
                    step.TypeOf(id),
                    "), which holds no body that is known");
  }
  if (count == 0) return absl::OkStatus();
  return BadStep(path,
                 absl::StrCat(count,
                              " of ",
                              bodies.size() + EmptyShapes(step).size(),
                              " bodies cannot be read: ",
                              lost));
}

absl::StatusOr<TopoDS_Shape> WithoutHidden(const std::string& path,
                                           const StepText& step,
                                           const TopoDS_Shape& shape,
                                           const std::vector<StepBody>& bodies,
                                           CadImport* import) {
  const HiddenBodies hidden = HiddenBodiesOf(step);
  if (hidden.single_places > 0) {
    import->warnings.push_back(absl::StrCat(hidden.single_places,
                                            " bodies are hidden in one of their places; they are "
                                            "taken as visible"));
  }
  std::set<const TopoDS_TShape*> shapes;
  std::string names;
  size_t count = 0;
  for (const StepBody& body : bodies) {
    if (!hidden.bodies.contains(body.id) || body.shape.IsNull()) continue;
    shapes.insert(body.shape.TShape().get());
    if (body.shape.ShapeType() == TopAbs_COMPOUND) {  // of a surface model: its shells
      for (TopExp_Explorer it(body.shape, TopAbs_SHELL); it.More(); it.Next()) {
        shapes.insert(it.Current().TShape().get());
      }
    }
    ++count;
    absl::StrAppend(&names, names.empty() ? "" : ", ", Named(step, body.id));
  }
  if (count == 0) return shape;
  const TopoDS_Shape visible = WithoutBodies(shape, shapes);
  if (visible.IsNull() || !TopExp_Explorer(visible, TopAbs_FACE).More()) {
    return BadStep(path, "all of its bodies are hidden");
  }
  AddFinding(
      CadFindingKind::kOther, absl::StrCat(count, " hidden bodies left out: ", names), import);
  return visible;
}

// Of the one product whose geometry is triangles alone.
absl::Status ReadTessellated(const std::string& path,
                             const StepText& step,
                             const CadImport& import,
                             Annotations* annotations) {
  absl::StatusOr<TriangleMesh> mesh = TessellationOf(step);
  if (!mesh.ok()) return BadStep(path, std::string(mesh.status().message()));
  for (Eigen::Vector3d& v : mesh->vertices) v *= import.metres_per_unit;
  annotations->tessellated = *std::move(mesh);
  return absl::OkStatus();
}

void TellUnit(const StepText& step, CadImport* import) {
  const StepUnit unit = LengthUnitOf(step);
  if (unit.metres > 0.0) {
    SetUnit(unit.word, unit.metres, import);
  } else {
    SetUnit("mm", 1e-3, import);
    import->warnings.push_back("the file names no length unit; mm assumed");
    import->unit_from_file = false;
  }
  if (unit.mixed) {
    import->warnings.push_back("the file mixes length units; each is converted by its own");
  }
}

}  // namespace

absl::StatusOr<TopoDS_Shape> ReadStep(const std::string& path,
                                      CadImport& import,
                                      Annotations& annotations) {
  HOROPTER_ASSIGN_OR_RETURN(std::string bytes, ReadBytes(path));
  if (IsGzip(bytes)) {
    absl::StatusOr<std::string> unpacked = Gunzip(bytes);
    if (!unpacked.ok()) return BadStep(path, std::string(unpacked.status().message()));
    bytes = *std::move(unpacked);
  }
  const absl::StatusOr<StepText> parsed = StepText::Parse(bytes);
  if (!parsed.ok()) return BadStep(path, std::string(parsed.status().message()));
  const StepText& step = *parsed;
  HOROPTER_RETURN_IF_ERROR(CheckParts(path, step));
  TellUnit(step, &import);
  annotations.root_name = RootProductName(step);

  STEPControl_Reader reader;
  Interface_Static::SetCVal("xstep.cascade.unit", "MM");
  std::istringstream stream(bytes);
  if (reader.ReadStream(path.c_str(), stream) != IFSelect_RetDone) {
    return BadStep(path, "not a readable STEP file");
  }
  reader.TransferRoots();
  TopoDS_Shape shape = reader.OneShape();
  if (shape.IsNull() && HoldsTessellation(step)) {
    HOROPTER_RETURN_IF_ERROR(ReadTessellated(path, step, import, &annotations));
    return shape;
  }
  const Transferred transferred(reader, step);
  const std::vector<StepBody> bodies = transferred.Bodies();
  HOROPTER_RETURN_IF_ERROR(CheckBodies(path, step, shape, bodies));
  if (shape.IsNull()) return shape;
  const std::vector<std::string> only_triangles = TessellatedParts(step);
  if (!only_triangles.empty()) {
    return BadStep(path,
                   absl::StrCat(only_triangles.size(),
                                " of its parts are tessellated alone, which is read of single "
                                "parts only: ",
                                only_triangles[0]));
  }
  transferred.Tell(&import);
  annotations.colors = ColorsOf(reader);
  for (const StepBody& body : bodies) {
    const std::string name = ProductNameOf(step, body.id);
    if (name.empty() || body.shape.IsNull()) continue;
    for (TopExp_Explorer it(body.shape, TopAbs_SOLID); it.More(); it.Next()) {
      annotations.names[it.Current().TShape().get()] = name;
    }
  }
  HOROPTER_ASSIGN_OR_RETURN(shape, WithoutHidden(path, step, shape, bodies, &import));
  return Sewn(shape, &annotations);
}

}  // namespace horopter
