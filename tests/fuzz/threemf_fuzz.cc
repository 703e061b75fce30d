#include <zlib.h>

#include <string>

#include "client/threemf_file.h"
#include "tests/fuzz/check.h"

namespace {

void Put(std::string* out, unsigned long value, int bytes) {
  for (int k = 0; k < bytes; ++k) out->push_back(static_cast<char>(value >> 8 * k));
}

// An archive that holds the model as it is: no fuzzer guesses a checksum.
std::string Archive(std::string_view model) {
  const std::string name = "3D/a.model";
  const unsigned long crc =
      crc32(0, reinterpret_cast<const Bytef*>(model.data()), static_cast<uInt>(model.size()));
  const auto common = [&](std::string* out) {
    for (const int zero : {20, 0, 0, 0, 0}) Put(out, static_cast<unsigned long>(zero), 2);
    Put(out, crc, 4);
    Put(out, model.size(), 4);
    Put(out, model.size(), 4);
    Put(out, name.size(), 2);
    Put(out, 0, 2);
  };
  std::string out = "PK\x03\x04";
  common(&out);
  out += name;
  out += model;
  const size_t table = out.size();
  out += "PK\x01\x02";
  Put(&out, 20, 2);
  common(&out);
  Put(&out, 0, 2 + 2 + 2);
  Put(&out, 0, 4 + 4);
  out += name;
  const size_t size = out.size() - table;
  out += "PK\x05\x06";
  Put(&out, 0, 4);
  Put(&out, 1, 2);
  Put(&out, 1, 2);
  Put(&out, size, 4);
  Put(&out, table, 4);
  Put(&out, 0, 2);
  return out;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  horopter::CheckMesh(horopter::ParseThreeMf(bytes));
  horopter::CheckMesh(horopter::ParseThreeMf(Archive(bytes)));
  return 0;
}
