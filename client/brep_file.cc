#include "client/brep_file.h"

#include <IGESControl_Reader.hxx>
#include <IGESData_GlobalSection.hxx>
#include <IGESData_IGESModel.hxx>
#include <Interface_Static.hxx>
#include <Quantity_Color.hxx>
#include <STEPConstruct.hxx>
#include <STEPConstruct_Styles.hxx>
#include <STEPControl_Reader.hxx>
#include <StepRepr_RepresentationItem.hxx>
#include <StepVisual_Colour.hxx>
#include <StepVisual_StyledItem.hxx>
#include <TColStd_SequenceOfAsciiString.hxx>
#include <TCollection_HAsciiString.hxx>
#include <TopExp_Explorer.hxx>
#include <Transfer_TransientProcess.hxx>
#include <XSControl_TransferReader.hxx>
#include <XSControl_WorkSession.hxx>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <sstream>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace horopter {
namespace {

// Short name of a unit as CAD systems write it ("MILLIMETRE" -> "mm"); the word itself when it is
// unusual.
std::string ShortUnit(const std::string& word) {
  const double metres = MetresPerUnit(word);
  for (const char* unit : {"mm", "cm", "m", "in", "ft", "um"}) {
    if (metres > 0.0 && std::abs(MetresPerUnit(unit) / metres - 1.0) < 1e-9) return unit;
  }
  return absl::AsciiStrToLower(word);
}

void SetUnit(CadImport& import, const std::string& word) {
  import.unit_name = ShortUnit(word);
  import.metres_per_unit = MetresPerUnit(word);
  import.unit_from_file = true;
}

// What the file calls a solid; writers put their own program's words where no one named it.
std::string NameOf(const STEPControl_Reader& reader, const TopoDS_Shape& solid) {
  const Handle(Standard_Transient) entity =
      reader.WS()->TransferReader()->EntityFromShapeResult(solid, 1);
  const auto item = Handle(StepRepr_RepresentationItem)::DownCast(entity);
  if (item.IsNull() || item->Name().IsNull()) return "";
  const std::string name = item->Name()->ToCString();
  // Long words and bytes that may be no UTF-8 would be refused as a display name.
  constexpr size_t kLongest = 100;
  const bool plain = name.size() <= kLongest && std::all_of(name.begin(), name.end(), [](char c) {
                       return absl::ascii_isprint(static_cast<unsigned char>(c));
                     });
  return !plain || absl::StrContains(name, "Open CASCADE") || name == "NONE" ? "" : name;
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

}  // namespace

absl::Status CheckComplete(const std::string& path, bool iges) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream buffer;
  buffer << file.rdbuf();
  const std::string text = buffer.str();
  if (iges) {
    // The last record is the terminate section: letter T in column 73.
    const size_t end = text.find_last_not_of(" \r\n\t");
    const size_t line = end == std::string::npos ? end : text.rfind('\n', end);
    const size_t start = line == std::string::npos ? 0 : line + 1;
    if (end == std::string::npos || end < start + 72 || text[start + 72] != 'T') {
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": not an IGES file, or cut short (no terminate section)"));
    }
    return absl::OkStatus();
  }
  if (text.substr(0, 4096).find("ISO-10303-21") == std::string::npos) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": not a STEP file (no ISO-10303-21 header)"));
  }
  if (text.find("END-ISO-10303-21") == std::string::npos) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": cut short (no END-ISO-10303-21 at the end)"));
  }
  return absl::OkStatus();
}

absl::StatusOr<TopoDS_Shape> ReadStep(const std::string& path,
                                      CadImport& import,
                                      Annotations& annotations) {
  STEPControl_Reader reader;
  Interface_Static::SetCVal("xstep.cascade.unit", "MM");
  if (reader.ReadFile(path.c_str()) != IFSelect_RetDone) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": not a readable STEP file"));
  }
  TColStd_SequenceOfAsciiString lengths, angles, solid_angles;
  reader.FileUnits(lengths, angles, solid_angles);
  if (lengths.IsEmpty()) {
    import.warnings.push_back("the file names no length unit; mm assumed");
    SetUnit(import, "mm");
    import.unit_from_file = false;
  } else {
    SetUnit(import, lengths.First().ToCString());
    for (int i = 2; i <= lengths.Length(); ++i) {
      if (!(lengths.Value(i) == lengths.First())) {
        import.warnings.push_back("the file mixes length units; each is converted by its own");
        break;
      }
    }
  }
  reader.TransferRoots();
  const TopoDS_Shape shape = reader.OneShape();
  if (shape.IsNull()) return shape;
  for (TopExp_Explorer it(shape, TopAbs_SOLID); it.More(); it.Next()) {
    annotations.names.push_back(NameOf(reader, it.Current()));
  }
  annotations.colors = ColorsOf(reader);
  return shape;
}

absl::StatusOr<TopoDS_Shape> ReadIges(const std::string& path, CadImport& import) {
  IGESControl_Reader reader;
  Interface_Static::SetCVal("xstep.cascade.unit", "MM");
  if (reader.ReadFile(path.c_str()) != IFSelect_RetDone) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": not a readable IGES file"));
  }
  const auto name = reader.IGESModel()->GlobalSection().UnitName();
  SetUnit(import, name.IsNull() ? "mm" : name->ToCString());
  reader.TransferRoots();
  return reader.OneShape();
}

}  // namespace horopter
