// The page's files, read once and kept in memory: a request's path is looked up, never opened.
#pragma once

#include <map>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"

namespace horopter {

struct PageFile {
  std::string content;
  std::string gzipped;  // empty: does not get smaller
  std::string type;     // of the content
  std::string etag;
  bool lasting = false;  // its name changes with its content
};

class PageFiles {
 public:
  // All files below the folder, of which one is index.html. Errors: FAILED_PRECONDITION (no such
  // folder, no index.html, a file cannot be read, more than 64 MiB).
  static absl::StatusOr<PageFiles> Load(const std::string& folder);

  // Where the page was not built: one page that says so.
  static PageFiles Missing(const std::string& why);

  // `/` is index.html. Null: there is no such file.
  const PageFile* Find(std::string_view path) const;
  bool complete() const { return complete_; }

 private:
  std::map<std::string, PageFile, std::less<>> files_;
  bool complete_ = false;
};

// The folder of the page beside the program or where packages have it; empty: there is none.
std::string FindPageFolder();

}  // namespace horopter
