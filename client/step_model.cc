#include "client/step_model.h"

#include <algorithm>
#include <cstdint>
#include <map>
#include <unordered_set>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace horopter {
namespace {

constexpr const char* kBodyTypes[] = {"MANIFOLD_SOLID_BREP",
                                      "BREP_WITH_VOIDS",
                                      "FACETED_BREP",
                                      "SHELL_BASED_SURFACE_MODEL",
                                      "FACE_BASED_SURFACE_MODEL",
                                      "EXTRUDED_AREA_SOLID",
                                      "REVOLVED_AREA_SOLID",
                                      "EXTRUDED_FACE_SOLID",
                                      "REVOLVED_FACE_SOLID",
                                      "SWEPT_DISK_SOLID",
                                      "CSG_SOLID",
                                      "BOOLEAN_RESULT",
                                      "TESSELLATED_SOLID",
                                      "TESSELLATED_SHELL"};

// Representations that stand for the same shape as this one: not those that place it.
std::vector<int> SameShape(const StepText& step, int representation) {
  std::vector<int> all = {representation};
  for (size_t k = 0; k < all.size(); ++k) {
    for (const int user : step.UsersOf(all[k])) {
      if (!step.Is(user, "SHAPE_REPRESENTATION_RELATIONSHIP") ||
          step.Is(user, "REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION")) {
        continue;
      }
      for (const int other : step.ReferencesOf(user)) {
        if (IsShapeRepresentation(step, other) &&
            std::find(all.begin(), all.end(), other) == all.end()) {
          all.push_back(other);
        }
      }
    }
  }
  return all;
}

bool IsProductDefinition(const StepText& step, int id) {
  return step.Is(id, "PRODUCT_DEFINITION") ||
         step.Is(id, "PRODUCT_DEFINITION_WITH_ASSOCIATED_DOCUMENTS");
}

// The product definition that a representation is the shape of, or 0.
int DefinitionOf(const StepText& step, int representation) {
  for (const int same : SameShape(step, representation)) {
    for (const int user : step.UsersOf(same)) {
      if (!step.Is(user, "SHAPE_DEFINITION_REPRESENTATION")) continue;
      const int definition = step.Named(step.Named(user, 0), 2);
      if (IsProductDefinition(step, definition)) return definition;
    }
  }
  return 0;
}

std::vector<int> RepresentationsOf(const StepText& step, int definition) {
  std::vector<int> all;
  for (const int shape : step.UsersOf(definition)) {
    if (!step.Is(shape, "PRODUCT_DEFINITION_SHAPE")) continue;
    for (const int user : step.UsersOf(shape)) {
      if (!step.Is(user, "SHAPE_DEFINITION_REPRESENTATION")) continue;
      const std::vector<int> same = SameShape(step, step.Named(user, 1));
      all.insert(all.end(), same.begin(), same.end());
    }
  }
  return all;
}

// Without what no display name may have; at most 100 bytes, whole characters.
std::string CleanName(std::string name) {
  if (!IsCleanUtf8(name)) {
    for (char& c : name) {
      if (absl::ascii_iscntrl(static_cast<unsigned char>(c))) c = ' ';
    }
    if (!IsCleanUtf8(name)) return "";
  }
  constexpr size_t kLongest = 100;
  if (name.size() > kLongest) {
    name.resize(kLongest + 1);
    // Back to the first byte of the character that does not fit.
    while (!name.empty() && (static_cast<unsigned char>(name.back()) & 0xC0) == 0x80)
      name.pop_back();
    if (!name.empty()) name.pop_back();
  }
  return std::string(absl::StripAsciiWhitespace(name));
}

std::string NameOfDefinition(const StepText& step, int definition) {
  const int product = step.Named(step.Named(definition, 2), 2);
  if (!step.Is(product, "PRODUCT")) return "";
  for (const size_t parameter : {1, 0}) {
    const std::string name = CleanName(StepString(step.Parameter(product, parameter)));
    if (!name.empty() && name != "NONE" && !absl::StrContains(name, "Open CASCADE")) return name;
  }
  return "";
}

// Everything that the entities name, through any number of others.
std::unordered_set<int> ReachedFrom(const StepText& step, std::vector<int> stack) {
  std::unordered_set<int> reached(stack.begin(), stack.end());
  while (!stack.empty()) {
    const int id = stack.back();
    stack.pop_back();
    for (const int named : step.ReferencesOf(id)) {
      if (reached.insert(named).second) stack.push_back(named);
    }
  }
  return reached;
}

// Products with a shape that are made of no others, and how often each is placed.
std::map<int, int> LeafParts(const StepText& step) {
  std::map<int, int> leaves;
  for (const int shape : step.OfType("PRODUCT_DEFINITION_SHAPE")) {
    const int definition = step.Named(shape, 2);
    if (IsProductDefinition(step, definition)) leaves[definition] = 0;
  }
  std::set<int> wholes;
  for (const int use : step.OfType("NEXT_ASSEMBLY_USAGE_OCCURRENCE")) {
    wholes.insert(step.Named(use, 3));
    const auto leaf = leaves.find(step.Named(use, 4));
    if (leaf != leaves.end()) ++leaf->second;
  }
  for (auto it = leaves.begin(); it != leaves.end();) {
    it->second = std::max(it->second, 1);
    it = wholes.contains(it->first) ? leaves.erase(it) : std::next(it);
  }
  return leaves;
}

bool IsTessellated(const StepText& step, int id) {
  const std::string type = step.TypeOf(id);
  return absl::StartsWith(type, "TESSELLATED_") || absl::StrContains(type, "TRIANGULATED_");
}

bool IsBody(const StepText& step, int id) {
  return std::any_of(std::begin(kBodyTypes), std::end(kBodyTypes), [&](const char* type) {
    return step.Is(id, type);
  });
}

void Hide(const StepText& step, int id, int depth, HiddenBodies* hidden) {
  constexpr int kDeepest = 8;
  if (depth > kDeepest) return;
  const std::string type = step.TypeOf(id);
  if (IsBody(step, id)) {
    hidden->bodies.insert(id);
  } else if (absl::StartsWith(type, "CONTEXT_DEPENDENT_") && absl::EndsWith(type, "STYLED_ITEM")) {
    ++hidden->single_places;
  } else if (absl::EndsWith(type, "STYLED_ITEM")) {
    Hide(step, step.Named(id, 2, type), depth + 1, hidden);
  } else if (type == "PRESENTATION_LAYER_ASSIGNMENT" || absl::EndsWith(type, "REPRESENTATION")) {
    const size_t items = type == "PRESENTATION_LAYER_ASSIGNMENT" ? 2 : 1;
    for (const std::string_view item : StepList(step.Parameter(id, items, type))) {
      Hide(step, StepReference(item), depth + 1, hidden);
    }
  }
}

}  // namespace

std::vector<int> BodiesOf(const StepText& step) {
  std::vector<int> bodies;
  for (const char* type : kBodyTypes) {
    for (const int id : step.OfType(type)) {
      bool of_shape = false, of_other = false;
      for (const int user : step.UsersOf(id)) {
        of_shape = of_shape || IsShapeRepresentation(step, user);
        // Operands, and geometry that only helps: no parts.
        of_other = of_other || IsBody(step, user) ||
                   (absl::EndsWith(step.TypeOf(user), "REPRESENTATION") &&
                    !IsShapeRepresentation(step, user));
      }
      if (of_shape || !of_other) bodies.push_back(id);
    }
  }
  std::sort(bodies.begin(), bodies.end());
  bodies.erase(std::unique(bodies.begin(), bodies.end()), bodies.end());
  return bodies;
}

std::string ProductNameOf(const StepText& step, int body) {
  for (const int user : step.UsersOf(body)) {
    if (!IsShapeRepresentation(step, user)) continue;
    if (const int definition = DefinitionOf(step, user)) return NameOfDefinition(step, definition);
  }
  return "";
}

std::string RootProductName(const StepText& step) {
  std::set<int> roots;
  for (const int shape : step.OfType("PRODUCT_DEFINITION_SHAPE")) {
    const int definition = step.Named(shape, 2);
    if (IsProductDefinition(step, definition)) roots.insert(definition);
  }
  for (const int use : step.OfType("NEXT_ASSEMBLY_USAGE_OCCURRENCE")) {
    roots.erase(step.Named(use, 4));
  }
  return roots.size() == 1 ? NameOfDefinition(step, *roots.begin()) : "";
}

HiddenBodies HiddenBodiesOf(const StepText& step) {
  HiddenBodies hidden;
  for (const int list : step.OfTypesLike("INVISIBILITY")) {
    for (const std::string_view item : StepList(step.Parameter(list, 0))) {
      Hide(step, StepReference(item), 0, &hidden);
    }
  }
  return hidden;
}

std::string MissingEntities(const StepText& step) {
  std::vector<int> seeds = BodiesOf(step);
  for (const char* type : {"SHAPE_DEFINITION_REPRESENTATION",
                           "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION",
                           "SHAPE_REPRESENTATION_RELATIONSHIP"}) {
    seeds.insert(seeds.end(), step.OfType(type).begin(), step.OfType(type).end());
  }
  const std::unordered_set<int> reached = ReachedFrom(step, seeds);
  if (std::all_of(reached.begin(), reached.end(), [&](int id) { return step.Holds(id); }))
    return "";
  std::string out;
  constexpr int kMost = 3;
  int named_entities = 0;
  for (const int id : step.ids()) {
    if (!reached.contains(id)) continue;
    for (const int named : step.ReferencesOf(id)) {
      if (step.Holds(named) || ++named_entities > kMost) continue;
      absl::StrAppend(
          &out, out.empty() ? "" : ", ", "#", id, " (", step.TypeOf(id), ") names #", named);
    }
  }
  if (named_entities > kMost) absl::StrAppend(&out, " and ", named_entities - kMost, " more");
  absl::StrAppend(&out, ", which the file does not hold");
  int parts = 0, lost = 0;
  std::string names;
  for (const auto& [definition, places] : LeafParts(step)) {
    parts += places;
    const auto of_part = ReachedFrom(step, RepresentationsOf(step, definition));
    if (std::all_of(of_part.begin(), of_part.end(), [&](int id) { return step.Holds(id); }))
      continue;
    lost += places;
    absl::StrAppend(&names, names.empty() ? "" : ", ", NameOfDefinition(step, definition));
  }
  if (lost > 0) {
    absl::StrAppend(
        &out, ": ", lost, " of ", parts, " parts cannot be read", names.empty() ? "" : ": ", names);
  }
  return out;
}

std::vector<int> EmptyShapes(const StepText& step) {
  std::vector<int> empty;
  for (const char* type : {"ADVANCED_BREP_SHAPE_REPRESENTATION",
                           "FACETED_BREP_SHAPE_REPRESENTATION",
                           "MANIFOLD_SURFACE_SHAPE_REPRESENTATION"}) {
    for (const int id : step.OfType(type)) {
      bool has_body = false, has_other = false;
      for (const std::string_view parameter : StepList(step.Parameter(id, 1, type))) {
        const int item = StepReference(parameter);
        has_body = has_body || IsBody(step, item) || step.Is(item, "MAPPED_ITEM");
        has_other = has_other || !step.Is(item, "AXIS2_PLACEMENT_3D");
      }
      if (!has_body && has_other) empty.push_back(id);
    }
  }
  return empty;
}

std::vector<std::string> TessellatedParts(const StepText& step) {
  std::vector<std::string> names;
  for (const auto& [definition, places] : LeafParts(step)) {
    bool exact = false, tessellated = false;
    for (const int representation : RepresentationsOf(step, definition)) {
      for (const int item : step.ReferencesOf(representation)) {
        const bool triangles = IsTessellated(step, item);
        tessellated = tessellated || triangles;
        exact = exact || (!triangles && (IsBody(step, item) || step.Is(item, "MAPPED_ITEM")));
      }
    }
    if (tessellated && !exact) names.push_back(NameOfDefinition(step, definition));
  }
  return names;
}

std::vector<std::string> ExternalFiles(const StepText& step) {
  bool has_geometry_elsewhere = false;
  for (const auto& [definition, places] : LeafParts(step)) {
    const std::vector<int> representations = RepresentationsOf(step, definition);
    const bool has_body =
        std::any_of(representations.begin(), representations.end(), [&](int representation) {
          const auto items = step.ReferencesOf(representation);
          return std::any_of(items.begin(), items.end(), [&](int item) {
            return IsBody(step, item) || step.Is(item, "MAPPED_ITEM");
          });
        });
    has_geometry_elsewhere = has_geometry_elsewhere || !has_body;
  }
  std::vector<std::string> files;
  if (!has_geometry_elsewhere) return files;
  for (const int id : step.OfType("DOCUMENT_FILE")) {
    files.push_back(StepString(step.Parameter(id, 0)));
  }
  for (const int id : step.OfType("EXTERNAL_SOURCE")) {
    std::string_view source = step.Parameter(id, 0);  // IDENTIFIER('a.stp')
    const size_t open = source.find('('), close = source.rfind(')');
    if (open != std::string_view::npos && close != std::string_view::npos) {
      source = source.substr(open + 1, close - open - 1);
    }
    files.push_back(StepString(source));
  }
  // Drawings and texts beside a part are none of its geometry.
  std::erase_if(files, [](const std::string& file) {
    static const std::set<std::string> kOthers = {"pdf",
                                                  "txt",
                                                  "doc",
                                                  "docx",
                                                  "xls",
                                                  "xlsx",
                                                  "png",
                                                  "jpg",
                                                  "jpeg",
                                                  "tif",
                                                  "tiff",
                                                  "dxf",
                                                  "html",
                                                  "xml"};
    const size_t dot = file.rfind('.');
    return file.empty() || dot == std::string::npos ||
           kOthers.contains(absl::AsciiStrToLower(file.substr(dot + 1)));
  });
  std::sort(files.begin(), files.end());
  files.erase(std::unique(files.begin(), files.end()), files.end());
  return files;
}

}  // namespace horopter
