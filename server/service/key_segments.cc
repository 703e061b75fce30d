#include "server/service/key_segments.h"

#include <fcntl.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <iterator>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/service/derived_cache.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kExtension = ".keys";
// A file that nobody has used for so long, of shapes that are not in this catalog, is removed:
// servers of another version or another catalog use theirs.
constexpr auto kUnusedFor = std::chrono::hours(24 * 7);

}  // namespace

KeySegments::KeySegments(std::string folder) : folder_(std::move(folder)) {}

void KeySegments::Adopt(Segment segment, const KeySegmentView& view) {
  const int number = static_cast<int>(segments_.size());
  for (int m = 0; m < view.members(); ++m)
    places_.try_emplace(std::string(view.address(m)), Place{number, m});
  segment.members = view.members();
  segments_.push_back(std::move(segment));
}

bool KeySegments::OpenFile(const std::string& path,
                           const std::unordered_set<std::string_view>& wanted) {
  const absl::StatusOr<std::string> block = ReadWholeFile(path);
  if (!block.ok()) {
    spdlog::warn("keys cannot be read: {}", std::string(block.status().message()));
    return true;
  }
  const absl::StatusOr<KeySegmentView> view = KeySegmentView::Of(*block);
  if (absl::IsFailedPrecondition(view.status())) return false;  // another program's
  const absl::Status sound = view.ok() ? view->Verify() : view.status();
  if (!sound.ok()) {
    QuarantineFile(folder_, path, sound);
    return false;
  }
  int found = 0, of_use = 0;
  for (int m = 0; m < view->members(); ++m) {
    const std::string_view address = view->address(m);
    if (wanted.count(address) == 0) continue;
    ++found;
    of_use += places_.count(std::string(address)) == 0 ? 1 : 0;
  }
  // One with little of use would only be searched in vain.
  if (of_use * 2 < view->members()) return found > 0;
  ::utimensat(AT_FDCWD, path.c_str(), nullptr, 0);
  Adopt({path, "", 0, static_cast<int64_t>(block->size())}, *view);
  return true;
}

void KeySegments::OpenFolder(std::span<const std::string> addresses) {
  if (std::exchange(opened_, true) || folder_.empty()) return;
  const std::unordered_set<std::string_view> wanted(addresses.begin(), addresses.end());
  std::vector<std::string> files;
  std::error_code error;
  for (auto at = fs::directory_iterator(folder_, error); at != fs::directory_iterator();
       at.increment(error)) {
    if (at->path().extension() == kExtension) files.push_back(at->path().string());
  }
  std::sort(files.begin(), files.end());
  for (const std::string& path : files) {
    std::error_code gone;
    const auto used = fs::last_write_time(path, gone);
    if (!OpenFile(path, wanted) && !gone && fs::file_time_type::clock::now() - used > kUnusedFor)
      fs::remove(path, gone);
  }
}

void KeySegments::Make(KeySegmentWriter writer) {
  Segment made;
  made.block = std::move(writer).Finish();
  made.bytes = static_cast<int64_t>(made.block.size());
  const absl::StatusOr<KeySegmentView> view = KeySegmentView::Of(made.block);
  if (!view.ok()) return;  // of our own making it is sound
  if (!folder_.empty()) {
    // The block ends with its digest.
    const std::string path = absl::StrCat(
        folder_, "/", made.block.substr(made.block.size() - 64), std::string(kExtension));
    const absl::Status written = WriteWholeFile(path, made.block);
    if (written.ok()) {
      made.path = path;
    } else {
      spdlog::warn("keys cannot be kept in a file, they stay in memory: {}",
                   std::string(written.message()));
    }
  }
  Segment kept{made.path, made.path.empty() ? made.block : std::string(), 0, made.bytes};
  Adopt(std::move(kept), *view);
}

void KeySegments::Look(int segment, const std::function<void(const KeySegmentView&)>& look) {
  Segment& of = segments_[segment];
  if (of.members == 0) return;  // given up
  std::string file;
  absl::Status status;
  if (!of.path.empty()) {
    absl::StatusOr<std::string> read = ReadWholeFile(of.path);
    status = read.status();
    if (read.ok()) file = *std::move(read);
  }
  const absl::StatusOr<KeySegmentView> view =
      status.ok() ? KeySegmentView::Of(of.path.empty() ? of.block : file)
                  : absl::StatusOr<KeySegmentView>(status);
  if (view.ok() && view->members() == of.members) return look(*view);
  spdlog::error("keys are lost and made anew: {}: {}",
                of.path,
                view.ok() ? "of other members" : std::string(view.status().message()));
  of = {};
  for (auto at = places_.begin(); at != places_.end();)
    at = at->second.segment == segment ? places_.erase(at) : std::next(at);
}

absl::Status KeySegments::Cover(std::span<const std::string> addresses,
                                const ReadKeys& read,
                                const StopRequested& stop) {
  const std::lock_guard lock(mutex_);
  OpenFolder(addresses);
  std::vector<int> missing;
  for (int i = 0; i < static_cast<int>(addresses.size()); ++i) {
    if (places_.count(addresses[i]) == 0 && loose_at_.count(addresses[i]) == 0)
      missing.push_back(i);
  }
  std::span<const int> left = missing;
  while (!left.empty()) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped");
    const size_t together = std::min<size_t>(left.size(), kSegmentMembers);
    const bool few = together < kLeastMembers;
    KeySegmentWriter writer;
    const absl::Status done = read(left.first(together), [&](int number, const ObjectKeys& keys) {
      if (!few) return writer.Add(addresses[number], keys);
      if (loose_at_.try_emplace(addresses[number], static_cast<int>(loose_.size())).second)
        loose_.emplace_back(addresses[number], keys);
      loose_block_.clear();
    });
    HOROPTER_RETURN_IF_ERROR(done);
    if (writer.members() > 0) Make(std::move(writer));
    left = left.subspan(together);
  }
  if (loose_.size() < kSegmentMembers) return absl::OkStatus();
  Make(LooseKeys());
  loose_.clear();
  loose_at_.clear();
  loose_block_.clear();
  return absl::OkStatus();
}

KeySegmentWriter KeySegments::LooseKeys() const {
  KeySegmentWriter writer;
  for (const auto& [address, keys] : loose_) writer.Add(address, keys);
  return writer;
}

const std::string& KeySegments::LooseBlock() {
  if (loose_block_.empty()) loose_block_ = LooseKeys().Finish();
  return loose_block_;
}

std::vector<int> KeySegments::SharedKeys(std::span<const std::string> addresses,
                                         const ObjectKeys& keys) {
  const std::lock_guard lock(mutex_);
  std::vector<std::vector<int>> shared(segments_.size());
  for (int s = 0; s < static_cast<int>(segments_.size()); ++s) {
    Look(s, [&](const KeySegmentView& view) {
      shared[s].resize(view.members(), 0);
      view.AddSharedKeys(keys, &shared[s]);
    });
  }
  std::vector<int> of_loose(loose_.size(), 0);
  if (const auto loose = KeySegmentView::Of(LooseBlock()); loose.ok())
    loose->AddSharedKeys(keys, &of_loose);
  std::vector<int> out;
  for (const std::string& address : addresses) {
    const auto place = places_.find(address);
    const auto loose = loose_at_.find(address);
    out.push_back(place != places_.end()     ? shared[place->second.segment][place->second.member]
                  : loose != loose_at_.end() ? of_loose[loose->second]
                                             : 0);
  }
  return out;
}

int KeySegments::ForEachTally(
    std::span<const std::string> addresses,
    const std::function<void(int number, const KeySegmentView::Tally&)>& compare) {
  const std::lock_guard lock(mutex_);
  std::vector<std::vector<KeySegmentView::Tally>> tallies(segments_.size());
  for (int s = 0; s < static_cast<int>(segments_.size()); ++s)
    Look(s, [&](const KeySegmentView& view) { tallies[s] = view.Tallies(); });
  int covered = 0;
  for (int i = 0; i < static_cast<int>(addresses.size()); ++i) {
    if (const auto place = places_.find(addresses[i]); place != places_.end()) {
      compare(i, tallies[place->second.segment][place->second.member]);
      ++covered;
    } else if (const auto loose = loose_at_.find(addresses[i]); loose != loose_at_.end()) {
      compare(i, KeySegmentView::TallyOf(loose_[loose->second].second));
      ++covered;
    }
  }
  return covered;
}

KeySegments::Figures KeySegments::figures() {
  const std::lock_guard lock(mutex_);
  Figures figures;
  figures.loose = static_cast<int>(loose_.size());
  for (const Segment& segment : segments_) {
    if (segment.members == 0) continue;
    ++figures.segments;
    figures.files += segment.path.empty() ? 0 : 1;
    figures.bytes += segment.bytes;
    figures.members += segment.members;
  }
  return figures;
}

}  // namespace horopter
