#include "client/cad_import.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <system_error>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "client/cad_findings.h"
#include "client/mesh_import.h"
#include "client/step_import.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/symmetry.h"

namespace horopter {
namespace {

constexpr double kMinDiameterM = 1e-3;
constexpr double kMaxDiameterM = 10.0;

// Largest distance between two points. Beyond a few thousand points only those that are extreme in
// one of many directions are compared; the result is then short by less than 1e-5 of itself.
double Diameter(const std::vector<Eigen::Vector3d>& points) {
  std::vector<Eigen::Vector3d> candidates = points;
  constexpr size_t kAllPairs = 4000;
  if (points.size() > kAllPairs) {
    candidates.clear();
    constexpr int kDirections = 1500;
    const double golden = M_PI * (3.0 - std::sqrt(5.0));
    for (int i = 0; i < kDirections; ++i) {
      const double z = 1.0 - 2.0 * (i + 0.5) / kDirections, r = std::sqrt(1.0 - z * z);
      const Eigen::Vector3d d(r * std::cos(golden * i), r * std::sin(golden * i), z);
      candidates.push_back(
          *std::max_element(points.begin(), points.end(), [&](const auto& a, const auto& b) {
            return a.dot(d) < b.dot(d);
          }));
    }
  }
  double squared = 0.0;
  for (size_t i = 0; i < candidates.size(); ++i) {
    for (size_t j = i + 1; j < candidates.size(); ++j) {
      squared = std::max(squared, (candidates[i] - candidates[j]).squaredNorm());
    }
  }
  return std::sqrt(squared);
}

absl::Status CheckFile(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) {
    return absl::NotFoundError(absl::StrCat(path, ": no such file"));
  }
  if (!std::filesystem::is_regular_file(path, error)) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": not a file"));
  }
  if (std::filesystem::file_size(path, error) == 0) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": empty file"));
  }
  return absl::OkStatus();
}

absl::Status CheckModel(const std::string& path, const CadImport& import) {
  const ObjectModel& model = import.model;
  for (const Eigen::Vector3d& v : model.mesh.vertices) {
    if (!v.allFinite()) {
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": has coordinates that are not finite"));
    }
  }
  if (model.diameter_m < kMinDiameterM || model.diameter_m > kMaxDiameterM) {
    return absl::InvalidArgumentError(absl::StrCat(path,
                                                   ": diameter ",
                                                   model.diameter_m / import.metres_per_unit,
                                                   " ",
                                                   import.unit_name,
                                                   " = ",
                                                   model.diameter_m * 1e3,
                                                   " mm is outside 1 mm .. 10 m; is the unit '",
                                                   import.unit_name,
                                                   "' right?",
                                                   SuggestUnits(import)));
  }
  return absl::OkStatus();
}

// Diameter, checks, symmetries and counts of what a reader filled in.
absl::Status Finish(const std::string& path, const CadImportOptions& options, CadImport& import) {
  ObjectModel& model = import.model;
  model.diameter_m = Diameter(model.mesh.vertices);
  HOROPTER_RETURN_IF_ERROR(CheckModel(path, import));
  SymmetryOptions symmetry;
  symmetry.tolerance = options.symmetry_tolerance;
  FindOddities(OfSurface(symmetry), &import);
  model.symmetries = DeriveSymmetries(model, symmetry, import.symmetries);
  import.counts = {{"vertices", static_cast<int>(model.vertices.size())},
                   {"triangles", static_cast<int>(model.mesh.triangles.size())},
                   {"symmetries", static_cast<int>(model.symmetries.size())},
                   {"lines", 0},
                   {"circles", 0},
                   { "other_curves",
                     0 }};
  for (const ModelEdge& e : model.edges) {
    ++import.counts[e.kind == CurveKind::kLine     ? "lines"
                    : e.kind == CurveKind::kCircle ? "circles"
                                                   : "other_curves"];
  }
  return absl::OkStatus();
}

absl::Status CheckRequest(const std::string& path, const CadImportOptions& options) {
  HOROPTER_RETURN_IF_ERROR(CheckFile(path));
  if (!options.unit.empty() && MetresPerUnit(options.unit) <= 0.0) {
    return absl::InvalidArgumentError(
        absl::StrCat("units: unknown unit '", options.unit, "' (use mm, cm, m, in, ft or um)"));
  }
  return absl::OkStatus();
}

// STEP, IGES or nothing.
std::string BrepFormatOf(const std::string& extension) {
  for (const char* step : {".step", ".stp", ".p21", ".stpz"}) {
    if (extension == step) return "STEP";
  }
  return extension == ".iges" || extension == ".igs" ? "IGES" : "";
}

// In small letters; of a packed STEP or IGES file that in front of .gz.
std::string ExtensionOf(const std::string& path) {
  std::string extension = absl::AsciiStrToLower(std::filesystem::path(path).extension().string());
  if (extension == ".gz") {
    extension = absl::AsciiStrToLower(std::filesystem::path(path).stem().extension().string());
    return BrepFormatOf(extension).empty() ? ".gz" : extension;  // others are not unpacked
  }
  return extension;
}

}  // namespace

double MetresPerUnit(const std::string& unit) {
  const std::string u = absl::AsciiStrToLower(unit);
  if (u == "mm" || u == "millimetre" || u == "millimeter") return 1e-3;
  if (u == "cm" || u == "centimetre" || u == "centimeter") return 1e-2;
  if (u == "m" || u == "metre" || u == "meter") return 1.0;
  if (u == "in" || u == "inch" || u == "inches") return 0.0254;
  if (u == "ft" || u == "foot" || u == "feet") return 0.3048;
  if (u == "um" || u == "micrometre" || u == "micrometer" || u == "micron") return 1e-6;
  if (u == "mil") return 25.4e-6;
  if (u == "km" || u == "kilometre" || u == "kilometer") return 1e3;
  return 0.0;
}

absl::StatusOr<CadImport> ImportCad(const std::string& path, const CadImportOptions& options) {
  HOROPTER_RETURN_IF_ERROR(CheckRequest(path, options));
  const std::string extension = ExtensionOf(path), brep = BrepFormatOf(extension);
  CadImport import;
  if (!brep.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(import, ImportBrep(path, brep == "IGES", options));
    import.format = brep;
  } else if (extension == ".ply" || extension == ".stl" || extension == ".obj" ||
             extension == ".glb" || extension == ".3mf" || extension == ".cao" ||
             extension == ".json") {
    HOROPTER_ASSIGN_OR_RETURN(import, ImportMesh(path, options));
    import.format = absl::AsciiStrToUpper(extension.substr(1));
  } else {
    return absl::InvalidArgumentError(absl::StrCat(
        path,
        ": unknown CAD format '",
        extension,
        "' (known: .step .stp .stpz .step.gz .iges .igs .ply .stl .obj .glb .3mf .cao .json)"));
  }
  HOROPTER_RETURN_IF_ERROR(Finish(path, options, import));
  return import;
}

absl::StatusOr<std::vector<CadImport>> ImportCadParts(const std::string& path,
                                                      const CadImportOptions& options) {
  const std::string format = BrepFormatOf(ExtensionOf(path));
  if (format.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(CadImport import, ImportCad(path, options));
    return std::vector<CadImport>{std::move(import)};
  }
  HOROPTER_RETURN_IF_ERROR(CheckRequest(path, options));
  HOROPTER_ASSIGN_OR_RETURN(std::vector<CadImport> imports,
                            ImportBrepSolids(path, format == "IGES", options));
  for (CadImport& import : imports) {
    import.format = format;
    HOROPTER_RETURN_IF_ERROR(Finish(path, options, import));
  }
  return imports;
}

}  // namespace horopter
