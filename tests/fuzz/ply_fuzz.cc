#include "client/ply_file.h"
#include "tests/fuzz/check.h"

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  horopter::CheckMesh(horopter::ParsePly(bytes));
  return 0;
}
