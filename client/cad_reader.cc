// horopter-cad-reader: reads one CAD file for the server and ends.
//
//   horopter-cad-reader FILE UNIT MEMORY_MB SECONDS
//
// Writes a serialized ImportObjectResponse (exit code 0), or why the file is refused (3; 4:
// memory). What a file may make the libraries do ends with this process.
#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cstdlib>
#include <exception>
#include <new>
#include <string>

#include "absl/strings/ascii.h"
#include "client/cad_import.h"
#include "client/convert.h"
#include "horopter/v1/catalog.pb.h"
#include "server/base/cad_reader_exit.h"
#include "server/base/utf8.h"

namespace horopter {
namespace {

void Limit(int resource, rlim_t value) {
  const rlimit limit = {value, value};
  ::setrlimit(static_cast<__rlimit_resource>(resource), &limit);
}

// Before a byte of the file is looked at.
void Confine(rlim_t memory_bytes, rlim_t seconds) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  ::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0);
  Limit(RLIMIT_AS, memory_bytes);
  Limit(RLIMIT_CPU, seconds);
  Limit(RLIMIT_CORE, 0);
  Limit(RLIMIT_FSIZE, 0);  // no file; what goes into the pipe is none
  Limit(RLIMIT_NOFILE, 64);
}

bool WriteAll(int output, const std::string& text) {
  for (size_t done = 0; done < text.size();) {
    const ssize_t wrote = ::write(output, text.data() + done, text.size() - done);
    if (wrote <= 0) return false;
    done += static_cast<size_t>(wrote);
  }
  return true;
}

int Read(const std::string& path, const std::string& unit, int output) {
  CadImportOptions options;
  options.unit = unit;
  const absl::StatusOr<CadImport> import = ImportCad(path, options);
  if (!import.ok()) {
    WriteAll(output, ToUtf8(std::string(import.status().message())));
    return kCadReaderRefused;
  }
  v1::ImportObjectResponse response;
  *response.mutable_object() = ToProto(import->model);
  response.mutable_object()->set_display_name(ToUtf8(import->name));
  v1::CadSource* const source = response.mutable_object()->mutable_source();
  source->set_format(absl::AsciiStrToLower(import->format));
  source->set_unit(ToUtf8(import->unit_name));
  for (const std::string& warning : import->warnings) response.add_warnings(ToUtf8(warning));
  return WriteAll(output, response.SerializeAsString()) ? 0 : kCadReaderUsage;
}

int Main(int argc, char** argv) {
  if (argc != 5) return kCadReaderUsage;
  const long memory_mb = std::atol(argv[3]), seconds = std::atol(argv[4]);
  if (memory_mb <= 0 || seconds <= 0) return kCadReaderUsage;
  Confine(static_cast<rlim_t>(memory_mb) << 20, static_cast<rlim_t>(seconds));
  // Libraries print what they think of a file; the pipe is for the answer alone.
  const int output = ::dup(1), nothing = ::open("/dev/null", O_WRONLY | O_CLOEXEC);
  if (output < 0 || nothing < 0 || ::dup2(nothing, 1) < 0) return kCadReaderUsage;
  try {
    return Read(argv[1], argv[2], output);
  } catch (const std::bad_alloc&) {
    return kCadReaderOutOfMemory;
  } catch (const std::exception& e) {
    WriteAll(output, e.what());
    return kCadReaderRefused;
  }
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
