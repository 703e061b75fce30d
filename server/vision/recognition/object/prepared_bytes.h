// What is stored of a prepared object (prepared_blob.h), for those who only move it.
#pragma once

#include <string>

namespace horopter {

struct PreparedBytes {
  std::string data;
  std::string keys;  // its invariant keys

  friend bool operator==(const PreparedBytes&, const PreparedBytes&) = default;
};

}  // namespace horopter
