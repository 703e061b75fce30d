#include "client/threemf_file.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "client/mesh_text.h"
#include "client/zip_file.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr size_t kMostTriangles = 20'000'000;

// A tag of XML without its prefix; attributes too.
struct Tag {
  std::string_view name;
  bool closes = false, opens = false;  // both: <a/>
  std::vector<std::pair<std::string_view, std::string_view>> attributes;

  std::string_view Get(std::string_view attribute) const {
    for (const auto& [key, value] : attributes) {
      if (key == attribute) return value;
    }
    return {};
  }
};

std::string_view WithoutPrefix(std::string_view name) {
  const size_t colon = name.find(':');
  return colon == std::string_view::npos ? name : name.substr(colon + 1);
}

// Tags one after the other; what is between them is passed by.
class Tags {
 public:
  explicit Tags(std::string_view text) : text_(text) {}

  std::optional<Tag> Next() {
    while (true) {
      at_ = text_.find('<', at_);
      if (at_ == std::string_view::npos) return std::nullopt;
      if (!Skip("<!--", "-->") && !Skip("<![CDATA[", "]]>") && !Skip("<?", "?>") &&
          !Skip("<!", ">")) {
        return Read();
      }
      if (at_ == std::string_view::npos) return std::nullopt;
    }
  }

 private:
  bool Skip(std::string_view start, std::string_view end) {
    if (text_.substr(at_, start.size()) != start) return false;
    const size_t found = text_.find(end, at_ + start.size());
    at_ = found == std::string_view::npos ? found : found + end.size();
    return true;
  }

  std::string_view Word() {
    const size_t start = at_;
    while (at_ < text_.size() && text_[at_] != '=' && text_[at_] != '>' && text_[at_] != '/' &&
           !absl::ascii_isspace(static_cast<unsigned char>(text_[at_]))) {
      ++at_;
    }
    return WithoutPrefix(text_.substr(start, at_ - start));
  }

  void Blanks() {
    while (at_ < text_.size() && absl::ascii_isspace(static_cast<unsigned char>(text_[at_]))) ++at_;
  }

  Tag Read() {
    Tag tag;
    ++at_;
    if (at_ < text_.size() && text_[at_] == '/') {
      tag.closes = true;
      ++at_;
    } else {
      tag.opens = true;
    }
    tag.name = Word();
    while (at_ < text_.size() && text_[at_] != '>') {
      Blanks();
      if (at_ >= text_.size() || text_[at_] == '>') break;
      if (text_[at_] == '/') {
        tag.closes = true;
        ++at_;
        continue;
      }
      const size_t before = at_;
      const std::string_view key = Word();
      Blanks();
      if (at_ < text_.size() && text_[at_] == '=') {
        ++at_;
        Blanks();
        const char quote = at_ < text_.size() ? text_[at_] : '"';
        const size_t end =
            quote == '"' || quote == '\'' ? text_.find(quote, at_ + 1) : std::string_view::npos;
        if (end == std::string_view::npos) {
          at_ = text_.size();
          break;
        }
        tag.attributes.emplace_back(key, text_.substr(at_ + 1, end - at_ - 1));
        at_ = end + 1;
      }
      if (at_ == before) ++at_;
    }
    if (at_ < text_.size()) ++at_;
    return tag;
  }

  std::string_view text_;
  size_t at_ = 0;
};

absl::Status BadModel(const std::string& why) {
  return absl::InvalidArgumentError(why);
}

// Twelve numbers, rows of a matrix that a row of coordinates is multiplied by; nothing: none.
std::optional<Eigen::Affine3d> TransformOf(std::string_view words) {
  Eigen::Affine3d out = Eigen::Affine3d::Identity();
  const std::vector<std::string_view> numbers = WordsOf(words);
  if (numbers.empty()) return out;
  if (numbers.size() != 12) return std::nullopt;
  for (int i = 0; i < 12; ++i) {
    const auto value = ParseNumber(numbers[static_cast<size_t>(i)]);
    if (!value) return std::nullopt;
    out.matrix()(i % 3, i / 3) = *value;
  }
  return out;
}

// An object that stands in another, or on the plate. Objects are known by file and number.
using Key = std::pair<std::string, std::string>;
struct Placed {
  Key object;
  Eigen::Affine3d place = Eigen::Affine3d::Identity();
};

struct Object {
  TriangleMesh mesh;
  std::vector<Placed> components;
  bool support = false;
};

struct Model {
  std::map<Key, Object> objects;
  std::vector<Placed> items;
  std::string unit;
};

std::string PartPathOf(const Tag& tag, const std::string& here) {
  std::string path(tag.Get("path"));
  if (path.empty()) return here;
  if (path[0] == '/') path.erase(0, 1);
  return path;
}

absl::StatusOr<Placed> PlacedOf(const Tag& tag, const std::string& here) {
  const auto place = TransformOf(tag.Get("transform"));
  if (!place) return BadModel("a transform that is not of twelve numbers");
  return Placed{{PartPathOf(tag, here), std::string(tag.Get("objectid"))}, *place};
}

absl::Status AddVertex(const Tag& tag, TriangleMesh* mesh) {
  const auto x = ParseNumber(tag.Get("x")), y = ParseNumber(tag.Get("y")),
             z = ParseNumber(tag.Get("z"));
  if (!x || !y || !z) return BadModel("a vertex without three numbers");
  mesh->vertices.emplace_back(*x, *y, *z);
  return absl::OkStatus();
}

absl::Status AddTriangle(const Tag& tag, TriangleMesh* mesh) {
  Eigen::Vector3i corners;
  const char* kNames[] = {"v1", "v2", "v3"};
  for (int k = 0; k < 3; ++k) {
    const std::string_view word = tag.Get(kNames[k]);
    int index = -1;
    if (!absl::SimpleAtoi(absl::string_view(word.data(), word.size()), &index) || index < 0 ||
        index >= static_cast<int>(mesh->vertices.size())) {
      return BadModel(absl::StrCat("triangle ",
                                   mesh->triangles.size() + 1,
                                   " names a vertex that is not among the ",
                                   mesh->vertices.size()));
    }
    corners[k] = index;
  }
  mesh->triangles.push_back(corners);
  return absl::OkStatus();
}

// Adds what one XML file holds.
absl::Status ReadModel(const std::string& path, std::string_view text, Model* model) {
  Tags tags(text);
  Object* object = nullptr;
  bool complete = false;
  while (const std::optional<Tag> tag = tags.Next()) {
    if (tag->name == "model") {
      if (tag->opens && model->unit.empty()) model->unit = std::string(tag->Get("unit"));
      complete = complete || tag->closes;
    }
    if (tag->name == "object" && tag->closes && !tag->opens) object = nullptr;
    if (!tag->opens) continue;
    if (tag->name == "object") {
      object = &model->objects[{path, std::string(tag->Get("id"))}];
      const std::string_view type = tag->Get("type");
      object->support = type == "support" || type == "solidsupport" || type == "other";
    } else if (tag->name == "item") {
      HOROPTER_ASSIGN_OR_RETURN(Placed item, PlacedOf(*tag, path));
      model->items.push_back(std::move(item));
    } else if (object == nullptr) {
      continue;
    } else if (tag->name == "vertex") {
      HOROPTER_RETURN_IF_ERROR(AddVertex(*tag, &object->mesh));
    } else if (tag->name == "triangle") {
      HOROPTER_RETURN_IF_ERROR(AddTriangle(*tag, &object->mesh));
    } else if (tag->name == "component") {
      HOROPTER_ASSIGN_OR_RETURN(Placed component, PlacedOf(*tag, path));
      object->components.push_back(std::move(component));
    }
  }
  return complete ? absl::OkStatus() : BadModel(absl::StrCat("'", path, "' is cut short"));
}

class Builder {
 public:
  explicit Builder(const Model& model) : model_(model) {}

  absl::Status Add(const Placed& placed, const Eigen::Affine3d& parent, int depth) {
    constexpr int kDeepest = 50, kMostPlaces = 1'000'000;
    const auto found = model_.objects.find(placed.object);
    if (found == model_.objects.end()) {
      return BadModel(absl::StrCat("object ", placed.object.second, " is not there"));
    }
    if (depth > kDeepest) return BadModel("objects that hold themselves");
    const Object& object = found->second;
    if (object.support) {
      ++left_out;
      return absl::OkStatus();
    }
    const Eigen::Affine3d place = parent * placed.place;
    if (out.triangles.size() + object.mesh.triangles.size() > kMostTriangles ||
        out.vertices.size() + object.mesh.vertices.size() > 3 * kMostTriangles ||
        ++places_ > kMostPlaces) {
      return BadModel("more than twenty million triangles or a million places");
    }
    const int first = static_cast<int>(out.vertices.size());
    for (const Eigen::Vector3d& v : object.mesh.vertices) out.vertices.push_back(place * v);
    const bool mirrored = place.linear().determinant() < 0.0;
    for (Eigen::Vector3i t : object.mesh.triangles) {
      if (mirrored) std::swap(t[1], t[2]);
      out.triangles.push_back(t.array() + first);
    }
    for (const Placed& component : object.components) {
      HOROPTER_RETURN_IF_ERROR(Add(component, place, depth + 1));
    }
    return absl::OkStatus();
  }

  TriangleMesh out;
  int left_out = 0;

 private:
  const Model& model_;
  int places_ = 0;
};

// Short names of the units that the norm knows.
std::string UnitOf(const std::string& word) {
  static const std::map<std::string, std::string> kUnits = {{"micron", "um"},
                                                            {"millimeter", "mm"},
                                                            {"centimeter", "cm"},
                                                            {"inch", "in"},
                                                            {"foot", "ft"},
                                                            {"meter", "m"}};
  const auto known = kUnits.find(word);
  return known == kUnits.end() ? "" : known->second;
}

}  // namespace

absl::StatusOr<MeshFile> ParseThreeMf(std::string_view bytes) {
  HOROPTER_ASSIGN_OR_RETURN(const auto files, Unzip(bytes, {".model"}));
  Model model;
  // The root model names the unit: it is the one with a plate, else the first.
  for (const auto& [path, text] : files) {
    Model part;
    HOROPTER_RETURN_IF_ERROR(ReadModel(path, text, &part));
    const bool root = !part.items.empty() || model.unit.empty();
    if (root) model.unit = part.unit;
    model.objects.merge(part.objects);
    model.items.insert(model.items.end(), part.items.begin(), part.items.end());
  }
  Builder builder(model);
  for (const Placed& item : model.items) {
    HOROPTER_RETURN_IF_ERROR(builder.Add(item, Eigen::Affine3d::Identity(), 0));
  }
  if (model.items.empty()) {
    for (const auto& [key, object] : model.objects) {
      HOROPTER_RETURN_IF_ERROR(builder.Add({key}, Eigen::Affine3d::Identity(), 0));
    }
  }
  if (builder.out.triangles.empty()) return BadModel("holds no triangles");
  MeshFile file;
  file.mesh = std::move(builder.out);
  file.faces = static_cast<std::int64_t>(file.mesh.triangles.size());
  file.unit = UnitOf(model.unit);
  if (!model.unit.empty() && file.unit.empty())
    return BadModel("a unit that the norm does not know");
  if (builder.left_out > 0) {
    file.notes.push_back(absl::StrCat(builder.left_out, " objects of support left out"));
  }
  HOROPTER_RETURN_IF_ERROR(CheckCorners(file.mesh));
  return file;
}

}  // namespace horopter
