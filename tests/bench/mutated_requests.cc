// Sends mutated requests to a whole server in this process and fails when one of them ends in
// INTERNAL, takes more than 5 s, or the memory in use grows. Meant for the preset `dev`
// (sanitizers).
//
//   mutated_requests [--count 100000] [--seed 1]
//
// Images of every format, raw frames, hints, candidate lists, objects and names; mutated as bytes
// of the wire, as values of fields, or as bytes of an image. Recognition is a stand-in: decoding,
// conversion, admission, the catalog and the answers are the server's. The same seed sends the
// same.
#include <google/protobuf/descriptor.h>
#include <google/protobuf/message.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <malloc.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <future>
#include <limits>
#include <map>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <random>

#include "tests/support/service_fixture.h"

#ifdef __SANITIZE_ADDRESS__
// Of the sanitizer's runtime; GCC installs no header that declares it.
extern "C" std::size_t __sanitizer_get_current_allocated_bytes();
#endif

namespace horopter {
namespace {

using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using Random = std::mt19937_64;

constexpr double kHangS = 5.0;
// A leak of 50 bytes a request would be more.
constexpr int64_t kMaxGrownKb = 4096;

struct Call {
  std::string method;
  std::unique_ptr<Message> request;
};

size_t Below(Random& random, size_t end) {
  return end == 0 ? 0 : random() % end;
}

double OddNumber(Random& random) {
  constexpr double kInf = std::numeric_limits<double>::infinity();
  const double odd[] = {
      0.0, -0.0, 1.0, -1.0, 1e-320, 1e308, -1e308, kInf, -kInf, std::nan(""), 1e-9, 7.5e3};
  return odd[Below(random, std::size(odd))];
}

int64_t OddInteger(Random& random) {
  const int64_t odd[] = {0,
                         1,
                         -1,
                         2,
                         7,
                         15,
                         16,
                         17,
                         255,
                         65535,
                         65536,
                         1 << 24,
                         INT32_MAX,
                         INT32_MIN,
                         INT64_MAX,
                         INT64_MIN};
  return odd[Below(random, std::size(odd))];
}

void MutateBytes(Random& random, std::string* bytes) {
  const int changes = 1 + static_cast<int>(Below(random, 6));
  for (int i = 0; i < changes; ++i) {
    const size_t at = Below(random, bytes->size() + 1);
    // Headers are where the sizes are.
    const size_t place = random() % 2 == 0 ? std::min<size_t>(at, Below(random, 64)) : at;
    switch (random() % 6) {
      case 0:
        if (place < bytes->size()) (*bytes)[place] = static_cast<char>(random());
        break;
      case 1:
        if (place < bytes->size()) (*bytes)[place] ^= static_cast<char>(1 << (random() % 8));
        break;
      case 2:
        bytes->insert(place, 1 + Below(random, 8), static_cast<char>(random()));
        break;
      case 3:
        if (place < bytes->size()) bytes->erase(place, 1 + Below(random, 16));
        break;
      case 4:
        bytes->resize(at);
        break;
      default:
        if (place + 4 < bytes->size()) {
          for (int k = 0; k < 4; ++k) (*bytes)[place + k] = random() % 2 ? '\xff' : '\0';
        }
    }
  }
}

void MutateField(Random& random, Message* message);

void SetOddScalar(Random& random, Message* message, const FieldDescriptor* field) {
  const auto* r = message->GetReflection();
  switch (field->cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return r->SetDouble(message, field, OddNumber(random));
    case FieldDescriptor::CPPTYPE_FLOAT:
      return r->SetFloat(message, field, static_cast<float>(OddNumber(random)));
    case FieldDescriptor::CPPTYPE_INT32:
      return r->SetInt32(message, field, static_cast<int32_t>(OddInteger(random)));
    case FieldDescriptor::CPPTYPE_INT64:
      return r->SetInt64(message, field, OddInteger(random));
    case FieldDescriptor::CPPTYPE_BOOL:
      return r->SetBool(message, field, random() % 2);
    case FieldDescriptor::CPPTYPE_ENUM:
      return r->SetEnumValue(message, field, static_cast<int>(OddInteger(random)));
    case FieldDescriptor::CPPTYPE_STRING: {
      std::string value = r->GetString(*message, field);
      MutateBytes(random, &value);
      // Text of the wire is UTF-8.
      if (field->type() == FieldDescriptor::TYPE_STRING) {
        for (char& c : value) c &= 0x7f;
      }
      return r->SetString(message, field, value);
    }
    default:
      return;
  }
}

void MutateRepeated(Random& random, Message* message, const FieldDescriptor* field) {
  const auto* r = message->GetReflection();
  const int size = r->FieldSize(*message, field);
  if (size == 0) return;
  const int at = static_cast<int>(Below(random, static_cast<size_t>(size)));
  if (random() % 4 == 0) return r->RemoveLast(message, field);
  if (random() % 4 == 0) return r->SwapElements(message, field, at, size - 1);
  switch (field->cpp_type()) {
    case FieldDescriptor::CPPTYPE_MESSAGE:
      if (random() % 4 == 0 && size < 64) {
        r->AddMessage(message, field)->CopyFrom(r->GetRepeatedMessage(*message, field, at));
        return;
      }
      return MutateField(random, r->MutableRepeatedMessage(message, field, at));
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return r->SetRepeatedDouble(message, field, at, OddNumber(random));
    case FieldDescriptor::CPPTYPE_INT32:
      return r->SetRepeatedInt32(message, field, at, static_cast<int32_t>(OddInteger(random)));
    case FieldDescriptor::CPPTYPE_STRING: {
      std::string value = r->GetRepeatedString(*message, field, at);
      MutateBytes(random, &value);
      for (char& c : value) c &= 0x7f;
      return r->SetRepeatedString(message, field, at, value);
    }
    default:
      return;
  }
}

// Changes one field, at any depth.
void MutateField(Random& random, Message* message) {
  const auto* descriptor = message->GetDescriptor();
  if (descriptor->field_count() == 0) return;
  const auto* field = descriptor->field(
      static_cast<int>(Below(random, static_cast<size_t>(descriptor->field_count()))));
  const auto* r = message->GetReflection();
  if (random() % 12 == 0) return r->ClearField(message, field);
  if (field->is_map()) return;
  if (field->is_repeated()) return MutateRepeated(random, message, field);
  if (field->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
    return MutateField(random, r->MutableMessage(message, field));
  }
  SetOddScalar(random, message, field);
}

std::string Encoded(const char* extension, const cv::Mat& image) {
  std::vector<unsigned char> bytes;
  cv::imencode(extension, image, bytes);
  return {bytes.begin(), bytes.end()};
}

std::vector<std::string> SampleImages() {
  cv::Mat color(40, 56, CV_8UC3), grey(33, 47, CV_8UC1), deep(20, 30, CV_16UC1);
  cv::randu(color, 0, 255);
  cv::randu(grey, 0, 255);
  cv::randu(deep, 0, 65535);
  std::vector<std::string> images;
  for (const char* extension : {".png", ".jpg", ".webp", ".bmp", ".tiff", ".ppm"}) {
    images.push_back(Encoded(extension, color));
    if (std::string(extension) != ".ppm") images.push_back(Encoded(extension, grey));
  }
  images.push_back(Encoded(".png", deep));
  images.push_back(Encoded(".tiff", deep));
  return images;
}

std::unique_ptr<Message> SceneRequest(Random& random, const std::vector<std::string>& images) {
  auto request = std::make_unique<v1::RecognizeSceneRequest>();
  const int count = 1 + static_cast<int>(Below(random, 4));
  for (int i = 0; i < count; ++i) {
    v1::SceneImage* image = request->add_images();
    if (random() % 4 == 0) {
      v1::RawFrame* raw = image->mutable_raw();
      raw->set_format(static_cast<v1::RawFrame::PixelFormat>(1 + Below(random, 5)));
      raw->set_width_px(32);
      raw->set_height_px(24);
      raw->set_data(std::string(32 * 24 * 3, static_cast<char>(random())));
    } else {
      std::string bytes = images[Below(random, images.size())];
      if (random() % 2 == 0) MutateBytes(random, &bytes);
      image->set_content(bytes);
    }
    if (random() % 2 == 0) MutateField(random, image->mutable_camera_hint());
  }
  for (size_t i = Below(random, 4); i > 0; --i) request->add_candidate_objects("objects/box");
  if (random() % 4 == 0) request->mutable_reference()->set_object("objects/box");
  return request;
}

Call MakeCall(Random& random, const std::vector<std::string>& images) {
  const std::string scene = "/horopter.v1.RecognitionService/",
                    catalog = "/horopter.v1.CatalogService/";
  const auto with_object = [&](auto request) {
    *request->mutable_object() = SampleObject("box", static_cast<unsigned>(random() % 5));
    request->mutable_object()->set_name("objects/box");
    return request;
  };
  const auto named = [&](auto request) {
    request->set_name("objects/box");
    return request;
  };
  switch (random() % 8) {
    case 0: {
      auto create = with_object(std::make_unique<v1::CreateObjectRequest>());
      create->set_object_id("p" + std::to_string(random() % 50));
      return {catalog + "CreateObject", std::move(create)};
    }
    case 1: {
      auto update = with_object(std::make_unique<v1::UpdateObjectRequest>());
      for (const char* path : {"grasps", "mesh", "edges", "display_name", "diameter_m"}) {
        if (random() % 3 == 0) update->mutable_update_mask()->add_paths(path);
      }
      return {catalog + "UpdateObject", std::move(update)};
    }
    case 2:
      switch (random() % 4) {
        case 0:
          return {catalog + "GetObject", named(std::make_unique<v1::GetObjectRequest>())};
        case 1:
          return {catalog + "ListLookAlikes", named(std::make_unique<v1::ListLookAlikesRequest>())};
        case 2:
          return {catalog + "RebuildObject", named(std::make_unique<v1::RebuildObjectRequest>())};
        default:
          return {catalog + "ListObjects", std::make_unique<v1::ListObjectsRequest>()};
      }
    case 3: {
      auto remove = std::make_unique<v1::DeleteObjectRequest>();
      remove->set_name("objects/p" + std::to_string(random() % 50));
      return {catalog + "DeleteObject", std::move(remove)};
    }
    default:
      return {scene + "RecognizeScene", SceneRequest(random, images)};
  }
}

// What the process holds: blocks in use tell a leak, pages after trimming what fragments leave.
struct Memory {
  int64_t used_kb = 0, resident_kb = 0, trimmed_kb = 0;
};

int64_t ResidentKb() {
  long pages = 0, resident = 0;
  std::ifstream("/proc/self/statm") >> pages >> resident;
  return resident * (::sysconf(_SC_PAGESIZE) / 1024);
}

Memory MeasureMemory() {
  Memory memory;
  memory.resident_kb = ResidentKb();
#ifdef __SANITIZE_ADDRESS__
  memory.used_kb = static_cast<int64_t>(__sanitizer_get_current_allocated_bytes()) / 1024;
#else
  const struct mallinfo2 info = ::mallinfo2();  // of all arenas
  memory.used_kb = static_cast<int64_t>(info.uordblks + info.hblkhd) / 1024;
#endif
  ::malloc_trim(0);
  memory.trimmed_kb = ResidentKb();
  return memory;
}

// Leaves the catalog with the object it began with: what a catalog holds more is no leak. Returns
// how many objects there were, a negative number when one could not be removed.
int EmptyCatalog(TestServer& server) {
  const std::vector<std::string> ids = server.server().store().Published()->ids;
  for (const std::string& id : ids) {
    if (id == "box") continue;
    grpc::ClientContext context;
    v1::DeleteObjectRequest request;
    request.set_name("objects/" + id);
    google::protobuf::Empty nothing;
    if (!server.catalog().DeleteObject(&context, request, &nothing).ok()) return -1;
  }
  return static_cast<int>(ids.size());
}

grpc::StatusCode Send(grpc::GenericStub& stub,
                      const std::string& method,
                      const std::string& bytes) {
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(60));
  const grpc::Slice slice(bytes);
  const grpc::ByteBuffer request(&slice, 1);
  grpc::ByteBuffer response;
  std::promise<grpc::StatusCode> done;
  stub.UnaryCall(&context, method, {}, &request, &response, [&](const grpc::Status& status) {
    done.set_value(status.error_code());
  });
  return done.get_future().get();
}

int Main(int argc, char** argv) {
  CLI::App app("mutated_requests");
  int64_t count = 100'000;
  uint64_t seed = 1;
  app.add_option("--count", count);
  app.add_option("--seed", seed);
  CLI11_PARSE(app, argc, argv);
  Random random(seed);
  ServerOptions options;
  options.images.tiff_and_pnm = true;
  TestServer server(
      [](const auto& request, const auto&, const auto&) -> absl::StatusOr<PipelineResult> {
        PipelineResult result;
        result.answer.cameras.resize(request.images.size());
        return result;
      },
      options);
  if (!server.Enrol("box")) return 1;
  grpc::GenericStub stub(server.channel());
  const std::vector<std::string> images = SampleImages();
  std::map<std::string, int64_t> codes;
  int64_t internal = 0, hangs = 0;
  Memory first, last;
  double slowest = 0.0;
  for (int64_t i = 0; i < count; ++i) {
    Call call = MakeCall(random, images);
    for (size_t k = Below(random, 4); k > 0; --k) MutateField(random, call.request.get());
    std::string bytes = call.request->SerializePartialAsString();
    if (random() % 4 == 0) MutateBytes(random, &bytes);
    const auto start = std::chrono::steady_clock::now();
    const grpc::StatusCode code = Send(stub, call.method, bytes);
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - start;
    slowest = std::max(slowest, took.count());
    hangs += took.count() > kHangS;
    ++codes[call.method.substr(call.method.rfind('/') + 1) + " " +
            absl::StatusCodeToString(static_cast<absl::StatusCode>(code))];
    if (code == grpc::StatusCode::INTERNAL || code == grpc::StatusCode::UNKNOWN ||
        code == grpc::StatusCode::DATA_LOSS) {
      ++internal;
      std::printf(
          "request %lld: %s ended with %d\n", static_cast<long long>(i), call.method.c_str(), code);
    }
    if ((i + 1) % std::max<int64_t>(1, count / 10) == 0) {
      const int objects = EmptyCatalog(server);
      if (objects < 0) return std::printf("an object cannot be removed\n"), 1;
      last = MeasureMemory();
      // What is kept of the first tenth is what a running server holds.
      if (first.used_kb == 0) first = last;
      const Memory& now = last;
      std::printf(
          "after %lld: %d objects; without them %lld KiB in use, %lld resident, %lld after "
          "trimming\n",
          static_cast<long long>(i + 1),
          objects,
          static_cast<long long>(now.used_kb),
          static_cast<long long>(now.resident_kb),
          static_cast<long long>(now.trimmed_kb));
      std::fflush(stdout);
    }
  }
  for (const auto& [what, times] : codes)
    std::printf("%8lld  %s\n", static_cast<long long>(times), what.c_str());
  std::printf(
      "seed %llu, %lld requests, %lld internal, %lld above %.0f s, slowest %.2f s; since the first "
      "tenth %lld KiB more in use (%lld), %lld resident, %lld after trimming\n",
      static_cast<unsigned long long>(seed),
      static_cast<long long>(count),
      static_cast<long long>(internal),
      static_cast<long long>(hangs),
      kHangS,
      slowest,
      static_cast<long long>(last.used_kb - first.used_kb),
      static_cast<long long>(first.used_kb),
      static_cast<long long>(last.resident_kb - first.resident_kb),
      static_cast<long long>(last.trimmed_kb - first.trimmed_kb));
  const bool grows = last.used_kb - first.used_kb > kMaxGrownKb;
  return internal == 0 && hangs == 0 && !grows ? 0 : 1;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
