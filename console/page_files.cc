#include "console/page_files.h"

#include <zlib.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "server/base/sha256.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;
constexpr size_t kMostBytes = 64 << 20;

std::string TypeOf(const std::string& extension) {
  static const std::map<std::string, std::string> kTypes = {
      {".html", "text/html; charset=utf-8"},
      {".js", "text/javascript; charset=utf-8"},
      {".css", "text/css; charset=utf-8"},
      {".json", "application/json"},
      {".txt", "text/plain; charset=utf-8"},
      {".svg", "image/svg+xml"},
      {".png", "image/png"},
      {".woff2", "font/woff2"}};
  const auto found = kTypes.find(extension);
  return found == kTypes.end() ? "application/octet-stream" : found->second;
}

// Empty: the library failed.
std::string Gzip(const std::string& text) {
  constexpr int kGzip = 15 + 16;  // window and kind of header (zlib.h)
  z_stream stream = {};
  if (deflateInit2(&stream, Z_BEST_COMPRESSION, Z_DEFLATED, kGzip, 9, Z_DEFAULT_STRATEGY) != Z_OK) {
    return "";
  }
  std::string packed(deflateBound(&stream, text.size()), '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(text.data()));
  stream.avail_in = static_cast<uInt>(text.size());
  stream.next_out = reinterpret_cast<Bytef*>(packed.data());
  stream.avail_out = static_cast<uInt>(packed.size());
  const bool done = deflate(&stream, Z_FINISH) == Z_STREAM_END;
  packed.resize(done ? stream.total_out : 0);
  deflateEnd(&stream);
  return packed;
}

PageFile MakeFile(std::string content, const std::string& extension) {
  PageFile file;
  file.type = TypeOf(extension);
  file.gzipped = Gzip(content);
  if (file.gzipped.size() >= content.size()) file.gzipped.clear();
  file.etag = absl::StrCat("\"", Sha256Hex(content).substr(0, 32), "\"");
  file.content = std::move(content);
  return file;
}

}  // namespace

absl::StatusOr<PageFiles> PageFiles::Load(const std::string& folder) {
  PageFiles page;
  size_t bytes = 0;
  std::error_code error;
  for (fs::recursive_directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    if (!it->is_regular_file()) continue;
    std::ifstream file(it->path(), std::ios::binary);
    std::ostringstream text;
    text << file.rdbuf();
    bytes += text.str().size();
    if (!file || bytes > kMostBytes) {
      return absl::FailedPreconditionError(
          absl::StrCat(it->path().string(), file ? ": the page is too large" : ": cannot be read"));
    }
    const std::string path = "/" + it->path().lexically_relative(folder).generic_string();
    PageFile made = MakeFile(text.str(), it->path().extension().string());
    made.lasting = path.starts_with("/assets/");
    page.files_[path] = std::move(made);
  }
  if (error) return absl::FailedPreconditionError(absl::StrCat(folder, ": ", error.message()));
  if (!page.files_.contains("/index.html")) {
    return absl::FailedPreconditionError(absl::StrCat(folder, ": holds no index.html"));
  }
  page.complete_ = true;
  return page;
}

PageFiles PageFiles::Missing(const std::string& why) {
  const std::string shown =
      absl::StrReplaceAll(why, {{"&", "&amp;"}, {"<", "&lt;"}, {">", "&gt;"}});
  PageFiles page;
  page.files_["/index.html"] = MakeFile(
      absl::StrCat(
          "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>Horopter"
          "</title></head><body><h1>The page is not installed</h1><p>",
          shown,
          "</p><p>This process works: it answers gRPC-Web and /healthz.</p></body></html>"),
      ".html");
  return page;
}

const PageFile* PageFiles::Find(std::string_view path) const {
  const auto found = files_.find(path == "/" ? std::string_view("/index.html") : path);
  return found == files_.end() ? nullptr : &found->second;
}

std::string FindPageFolder() {
  std::error_code error;
  const fs::path program = fs::read_symlink("/proc/self/exe", error);
  if (error) return "";
  for (const char* beside : {"../share/horopter/console", "../console/page"}) {
    const fs::path folder = (program.parent_path() / beside).lexically_normal();
    if (fs::is_regular_file(folder / "index.html", error)) return folder.string();
  }
  return "";
}

}  // namespace horopter
