#include "client/obj_file.h"
#include "tests/fuzz/check.h"

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  horopter::CheckMesh(
      horopter::ParseObj(bytes, [&](const std::string&) { return std::string(bytes); }));
  return 0;
}
