#include "client/calibration_document.h"

#include <algorithm>
#include <cctype>
#include <exception>
#include <map>
#include <opencv2/core/persistence.hpp>
#include <opencv2/core/utility.hpp>
#include <sstream>

#include "absl/status/status.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

// Cameras deeper in a tree, and more of them, are no calibration's.
constexpr int kMostDepth = 4;
constexpr size_t kMostCameras = 1000;
constexpr size_t kMostNodes = 100'000;  // that are looked at: aliases make many of few
constexpr size_t kMostNumbers = 10'000;
constexpr int kMostXmlDepth = 100;  // its parser calls itself for each

// Of stereo calibrations; PlainWord of what stands beside the name.
constexpr const char* kSides[] = {"1", "2", "0", "l", "r", "left", "right"};

absl::Status NotRead(const std::string& why) {
  return absl::InvalidArgumentError(absl::StrCat(why, "; ", kCalibrationForms));
}

YAML::Node FromFileNode(const cv::FileNode& from, int depth) {
  YAML::Node to;
  if (depth > 2 * kMostDepth) return to;
  if (from.isMap()) {
    for (const cv::FileNode& child : from) to[child.name()] = FromFileNode(child, depth + 1);
  } else if (from.isSeq()) {
    for (const cv::FileNode& child : from) to.push_back(FromFileNode(child, depth + 1));
  } else if (from.isInt()) {
    to = static_cast<int>(from);
  } else if (from.isReal()) {
    to = static_cast<double>(from);
  } else if (from.isString()) {
    to = static_cast<std::string>(from);
  }
  return to;
}

int Silent(int, const char*, const char*, const char*, int, void*) {
  return 0;
}

// How deep elements stand in each other, at most; what is no element's tag does not count.
int XmlDepth(const std::string& text) {
  int depth = 0, most = 0;
  for (size_t i = 0; i + 1 < text.size(); ++i) {
    if (text[i] != '<') continue;
    if (text[i + 1] == '/') {
      --depth;
    } else if (text[i + 1] != '!' && text[i + 1] != '?') {
      most = std::max(most, ++depth);
    }
  }
  return most;
}

absl::StatusOr<YAML::Node> FromXml(const std::string& text) {
  if (XmlDepth(text) > kMostXmlDepth) return NotRead("is no XML of OpenCV");
  // Without it the library writes its errors to the terminal.
  const cv::ErrorCallback before = cv::redirectError(Silent);
  absl::StatusOr<YAML::Node> out = NotRead("is no XML of OpenCV");
  try {
    const cv::FileStorage file(
        text, cv::FileStorage::READ | cv::FileStorage::MEMORY | cv::FileStorage::FORMAT_XML);
    YAML::Node root;
    for (const cv::FileNode& child : file.root()) root[child.name()] = FromFileNode(child, 0);
    if (root.IsMap()) out = root;
  } catch (const std::exception&) {
  }
  cv::redirectError(before);
  return out;
}

// Of COLMAP's models those that have a counterpart here: names of their parameters.
const std::map<std::string, std::vector<std::string>>& ColmapModels() {
  static const auto* const models = new std::map<std::string, std::vector<std::string>>{
      {"SIMPLE_PINHOLE", {"f", "cx", "cy"}},
      {"PINHOLE", {"fx", "fy", "cx", "cy"}},
      {"SIMPLE_RADIAL", {"f", "cx", "cy", "k1"}},
      {"RADIAL", {"f", "cx", "cy", "k1", "k2"}},
      {"OPENCV", {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"}},
      {"FULL_OPENCV", {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"}},
      {"OPENCV_FISHEYE", {"fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"}},
      {"SIMPLE_RADIAL_FISHEYE", {"f", "cx", "cy", "k1"}},
      {"RADIAL_FISHEYE", {"f", "cx", "cy", "k1", "k2"}}};
  return *models;
}

std::vector<std::string> Words(const std::string& line) {
  return absl::StrSplit(line, absl::ByAnyChar(" \t\r\f\v"), absl::SkipEmpty());
}

// Whether a line is that of a camera: its id, a model in capitals, the size of its images.
bool IsColmapLine(const std::vector<std::string>& words) {
  int64_t id = 0, width = 0, height = 0;
  const auto capital = [](char c) {
    return std::isupper(static_cast<unsigned char>(c)) || c == '_';
  };
  return words.size() >= 5 && absl::SimpleAtoi(words[0], &id) &&
         std::all_of(words[1].begin(), words[1].end(), capital) &&
         absl::SimpleAtoi(words[2], &width) && absl::SimpleAtoi(words[3], &height);
}

absl::Status AddColmapCamera(const std::vector<std::string>& words, YAML::Node* root) {
  const auto model = ColmapModels().find(words[1]);
  if (model == ColmapModels().end())
    return absl::InvalidArgumentError(absl::StrCat("model ", words[1], " of COLMAP is not read"));
  const std::vector<std::string>& names = model->second;
  if (words.size() != names.size() + 4) {
    return absl::InvalidArgumentError(absl::StrCat("camera ",
                                                   words[0],
                                                   ": model ",
                                                   words[1],
                                                   " has ",
                                                   names.size(),
                                                   " parameters, not ",
                                                   words.size() - 4));
  }
  YAML::Node camera;
  camera["width"] = words[2];
  camera["height"] = words[3];
  for (size_t i = 0; i < names.size(); ++i) {
    double value = 0.0;
    if (!absl::SimpleAtod(words[i + 4], &value))
      return absl::InvalidArgumentError(absl::StrCat(words[i + 4], " is no number"));
    // COLMAP's image begins at 0 with the edge of its first pixel.
    if (names[i] == "cx" || names[i] == "cy") value -= 0.5;
    camera[names[i]] = value;
  }
  if (words[1].find("FISHEYE") != std::string::npos) camera["distortion_model"] = "equidistant";
  (*root)[words[0]] = camera;
  return absl::OkStatus();
}

bool IsSide(const std::string& word) {
  return std::any_of(
      std::begin(kSides), std::end(kSides), [&](const char* s) { return word == s; });
}

// sure: its name is that of nothing else, so that one of other numbers is a faulty matrix.
bool IsMatrix(const YAML::Node& node, bool sure) {
  if (!node.IsSequence() && !node.IsMap()) return false;
  try {
    const size_t n = NumbersOf(node).size();
    return n == 9 || n == 4 || (sure && n > 0);
  } catch (const YAML::Exception&) {
    return true;  // to be complained of
  }
}

// The sides for which a map has a camera matrix; "" where it has one of no side.
std::vector<std::string> SidesOf(const YAML::Node& map) {
  std::vector<std::string> sides;
  const auto add = [&](const std::string& side) {
    if (std::find(sides.begin(), sides.end(), side) == sides.end()) sides.push_back(side);
  };
  bool fx = false, cx = false;
  for (const auto& entry : map) {
    if (!entry.first.IsScalar()) continue;
    const std::string key = PlainWord(entry.first.Scalar());
    fx = fx || ((key == "fx" || key == "f") && entry.second.IsScalar());
    cx = cx || ((key == "cx" || key == "ppx") && entry.second.IsScalar());
    std::vector<std::string> names = MatrixNames();
    names.push_back("m");
    for (const std::string& name : names) {
      std::string side;
      if (key.size() > name.size() && key.rfind(name, 0) == 0) side = key.substr(name.size());
      if (key.size() > name.size() && key.rfind(name) == key.size() - name.size())
        side = key.substr(0, key.size() - name.size());
      const bool plain = key == name && name != "m";
      if ((plain || IsSide(side)) && IsMatrix(entry.second, plain)) add(plain ? "" : side);
    }
  }
  if (fx && cx) add("");
  return sides;
}

void Collect(const YAML::Node& node,
             const std::string& name,
             std::vector<YAML::Node> around,
             size_t* looked,
             std::vector<CameraNode>* out) {
  if (around.size() > kMostDepth || out->size() >= kMostCameras || ++*looked > kMostNodes) return;
  if (node.IsSequence()) {
    around.push_back(node);
    for (size_t i = 0; i < node.size(); ++i) {
      if (node[i].IsMap()) Collect(node[i], absl::StrCat(i), around, looked, out);
    }
    return;
  }
  if (!node.IsMap()) return;
  const std::vector<std::string> sides = SidesOf(node);
  for (const std::string& side : sides)
    out->push_back({sides.size() == 1 ? name : side.empty() ? "camera" : side, node, side, around});
  if (!sides.empty()) return;
  around.push_back(node);
  for (const auto& entry : node) {
    if (entry.first.IsScalar()) Collect(entry.second, entry.first.Scalar(), around, looked, out);
  }
}

void AddNumbers(const YAML::Node& node, int depth, std::vector<double>* out) {
  if (depth > kMostDepth) return;
  for (const YAML::Node& entry : node) {
    if (out->size() >= kMostNumbers) return;
    if (entry.IsSequence()) {
      AddNumbers(entry, depth + 1, out);
    } else {
      out->push_back(entry.as<double>());
    }
  }
}

YAML::Node FindIn(const YAML::Node& map,
                  const std::vector<std::string>& names,
                  const std::string& side) {
  for (const std::string& name : names) {
    for (const auto& entry : map) {
      if (!entry.first.IsScalar()) continue;
      const std::string key = PlainWord(entry.first.Scalar());
      if (key == name + side || key == side + name) return entry.second;
    }
  }
  return YAML::Node(YAML::NodeType::Undefined);
}

}  // namespace

std::string PlainWord(const std::string& word) {
  std::string out;
  for (const char c : word) {
    if (c != '_' && c != '-' && c != ' ')
      out += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  }
  return out;
}

const std::vector<std::string>& MatrixNames() {
  static const auto* const names = new std::vector<std::string>{"cameramatrix",
                                                                "k",
                                                                "mtx",
                                                                "camk",
                                                                "cameramtx",
                                                                "kmatrix",
                                                                "intrinsicmatrix",
                                                                "intrinsicsmatrix",
                                                                "cameraintrinsicmatrix",
                                                                "cameraintrinsics",
                                                                "intrinsics",
                                                                "intrinsic"};
  return *names;
}

const std::vector<std::string>& DistortionNames() {
  static const auto* const names = new std::vector<std::string>{"distortioncoefficients",
                                                                "distortioncoeffs",
                                                                "distortioncoeff",
                                                                "distortioncoefs",
                                                                "distcoefficients",
                                                                "distcoeffs",
                                                                "distcoeff",
                                                                "distcoefs",
                                                                "distcoef",
                                                                "distortion",
                                                                "dist",
                                                                "d",
                                                                "camdist",
                                                                "coeffs",
                                                                "distortionparameters",
                                                                "distortionparams",
                                                                "distortionvector"};
  return *names;
}

const std::vector<std::string>& RadialNames() {
  static const auto* const names = new std::vector<std::string>{
      "radialdistortion", "radialdistortioncoefficients", "radialdistortioncoeffs", "radial"};
  return *names;
}

const std::vector<std::string>& TangentialNames() {
  static const auto* const names = new std::vector<std::string>{"tangentialdistortion",
                                                                "tangentialdistortioncoefficients",
                                                                "tangentialdistortioncoeffs",
                                                                "tangential"};
  return *names;
}

bool IsLensName(const std::string& key) {
  for (const auto* names : {&DistortionNames(), &RadialNames(), &TangentialNames()}) {
    for (const std::string& name : *names) {
      if (key == name) return true;
      for (const char* side : kSides) {
        if (key == name + side || key == side + name) return true;
      }
    }
  }
  return false;
}

absl::StatusOr<YAML::Node> ParseCalibration(const std::string& text) {
  const size_t first = text.find_first_not_of(" \t\r\n\xEF\xBB\xBF");
  if (first == std::string::npos) return NotRead("is empty");
  if (text.find('\0') != std::string::npos) return NotRead("is no text");
  if (text[first] == '<') return FromXml(text.substr(first));
  std::string yaml;
  YAML::Node colmap;
  std::istringstream lines(text.substr(first));
  for (std::string line; std::getline(lines, line);) {
    const std::vector<std::string> words = Words(line);
    if (IsColmapLine(words)) {
      HOROPTER_RETURN_IF_ERROR(AddColmapCamera(words, &colmap));
      continue;
    }
    // OpenCV writes "%YAML:1.0", which is no YAML directive, and `ros2 topic echo` a closing line.
    if (line.rfind("%YAML", 0) == 0 || line.rfind("---", 0) == 0) continue;
    yaml += line + '\n';
  }
  if (colmap.size() > 0) return colmap;
  try {
    return YAML::Load(yaml);
  } catch (const std::exception& e) {
    return NotRead(e.what());
  }
}

std::vector<CameraNode> CamerasIn(const YAML::Node& root) {
  std::vector<CameraNode> cameras;
  size_t looked = 0;
  Collect(root, "", {}, &looked, &cameras);
  return cameras;
}

YAML::Node Find(const CameraNode& camera, const std::vector<std::string>& names) {
  return FindIn(camera.node, names, camera.suffix);
}

YAML::Node FindAround(const CameraNode& camera, const std::vector<std::string>& names) {
  YAML::Node found = Find(camera, names);
  if (!found.IsDefined()) found.reset(FindIn(camera.node, names, ""));
  for (auto map = camera.around.rbegin(); map != camera.around.rend(); ++map) {
    if (found.IsDefined()) break;
    if (map->IsMap()) found.reset(FindIn(*map, names, ""));
  }
  return found;
}

std::vector<double> NumbersOf(const YAML::Node& node) {
  std::vector<double> numbers;
  if (!node.IsDefined() || node.IsNull()) return numbers;
  const YAML::Node list = node.IsMap() ? node["data"] : node;
  if (list.IsDefined() && list.IsSequence()) AddNumbers(list, 0, &numbers);
  return numbers;
}

}  // namespace horopter
