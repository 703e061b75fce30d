#include "client/load/load_items.h"

#include <algorithm>
#include <filesystem>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "client/bop_request.h"
#include "client/commands.h"
#include "server/base/recording_file.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;

bool IsNumber(const std::string& name) {
  return !name.empty() && name.size() <= 9 &&
         name.find_first_not_of("0123456789") == std::string::npos;
}

bool IsBopScene(const fs::path& folder) {
  std::error_code error;
  return IsNumber(folder.filename().string()) &&
         (HasBopImages(folder.string()) ||
          fs::is_regular_file(folder / "scene_camera.json", error));
}

std::vector<fs::path> SortedEntries(const fs::path& folder) {
  std::vector<fs::path> paths;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) paths.push_back(entry.path());
  std::sort(paths.begin(), paths.end());
  return paths;
}

absl::StatusOr<LoadItem> SceneItem(const fs::path& folder, const LoadItemOptions& options) {
  const fs::path split = folder.parent_path();
  const std::string dataset = split.parent_path().empty() ? "." : split.parent_path().string();
  HOROPTER_ASSIGN_OR_RETURN(const BopScene scene,
                            ReadBopScene(dataset,
                                         split.filename().string(),
                                         std::stoi(folder.filename().string()),
                                         ReadForRecognition(options.hints)));
  const auto images = ImagesToSend(scene, options.max_images);
  LoadItem item;
  item.name = folder.string();
  HOROPTER_ASSIGN_OR_RETURN(item.request, SceneRequestOf(images, options.hints));
  if (scene.has_ground_truth) {
    item.dataset = dataset;
    item.split = split.filename().string();
    item.scene_id = scene.scene_id;
    item.im_ids = ReportedIds(images);
  }
  return item;
}

absl::StatusOr<LoadItem> RecordedItem(const fs::path& path) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string bytes, ReadFileBytes(path.string()));
  const auto recording = DecodeRecording(bytes);
  LoadItem item;
  item.name = path.string();
  if (!recording.ok() || !item.request.ParseFromString(recording->request)) {
    return absl::InvalidArgumentError(absl::StrCat(
        path.string(),
        ": ",
        recording.ok() ? "its request cannot be read" : std::string(recording.status().message())));
  }
  return item;
}

absl::StatusOr<LoadItem> FolderItem(const fs::path& folder, const LoadItemOptions& options) {
  constexpr const char* kExtensions[] = {
      ".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".ppm", ".pgm", ".webp", ".heic"};
  std::vector<fs::path> images;
  for (const fs::path& path : SortedEntries(folder)) {
    const std::string extension = absl::AsciiStrToLower(path.extension().string());
    if (std::count(std::begin(kExtensions), std::end(kExtensions), extension) > 0) {
      images.push_back(path);
    }
  }
  const size_t n = images.size(), keep = static_cast<size_t>(std::max(0, options.max_images));
  LoadItem item;
  item.name = folder.string();
  const size_t sent = keep > 0 ? std::min(keep, n) : n;
  for (size_t i = 0; i < sent; ++i) {
    const size_t k = sent == 1 ? 0 : i * (n - 1) / (sent - 1);
    HOROPTER_ASSIGN_OR_RETURN(*item.request.add_images()->mutable_content(),
                              ReadFileBytes(images[k].string()));
  }
  if (sent == 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        folder.string(), ": neither a scene or split in BOP layout nor a folder with images"));
  }
  return item;
}

}  // namespace

absl::StatusOr<std::vector<LoadItem>> ReadLoadItems(const std::vector<std::string>& sources,
                                                    const LoadItemOptions& options) {
  std::vector<LoadItem> items;
  for (const std::string& source : sources) {
    std::error_code error;
    fs::path folder = fs::path(source).lexically_normal();
    if (!folder.has_filename()) folder = folder.parent_path();
    if (!fs::exists(folder, error)) {
      return absl::NotFoundError(absl::StrCat(source, ": is not there"));
    }
    if (!fs::is_directory(folder, error)) {
      HOROPTER_ASSIGN_OR_RETURN(LoadItem item, RecordedItem(folder));
      items.push_back(std::move(item));
      continue;
    }
    if (IsBopScene(folder)) {
      HOROPTER_ASSIGN_OR_RETURN(LoadItem item, SceneItem(folder, options));
      items.push_back(std::move(item));
      continue;
    }
    const size_t before = items.size();
    for (const fs::path& scene : SortedEntries(folder)) {
      const bool recorded = scene.extension() == kRecordingExtension;
      if (!recorded && !IsBopScene(scene)) continue;
      HOROPTER_ASSIGN_OR_RETURN(LoadItem item,
                                recorded ? RecordedItem(scene) : SceneItem(scene, options));
      items.push_back(std::move(item));
    }
    if (items.size() > before) continue;
    HOROPTER_ASSIGN_OR_RETURN(LoadItem item, FolderItem(folder, options));
    items.push_back(std::move(item));
  }
  return items;
}

}  // namespace horopter
