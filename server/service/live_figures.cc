#include "server/service/live_figures.h"

#include <sys/resource.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <system_error>
#include <utility>

#include "server/service/transport_security.h"

namespace horopter {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;

MetricFamily GaugeFamily(const char* name, const char* help, double value, bool counter = false) {
  ClientMetric metric;
  (counter ? metric.counter.value : metric.gauge.value) = value;
  return {name, help, counter ? MetricType::Counter : MetricType::Gauge, {metric}};
}

void AddDescriptors(std::vector<MetricFamily>* out) {
  rlimit limit = {};
  std::error_code error;
  // The one that looks is among them.
  const auto open = std::distance(std::filesystem::directory_iterator("/proc/self/fd", error),
                                  std::filesystem::directory_iterator());
  if (error || ::getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  out->push_back(GaugeFamily("process_open_fds", "Descriptors in use", static_cast<double>(open)));
  out->push_back(GaugeFamily(
      "process_max_fds", "Descriptors that there may be", static_cast<double>(limit.rlim_cur)));
}

void AddCertificate(const std::string& file, std::vector<MetricFamily>* out) {
  if (file.empty()) return;
  const absl::StatusOr<absl::Time> end = CertificateEnd(file);
  // A file that cannot be read any more is as bad as one that is over.
  out->push_back(GaugeFamily("horopter_tls_certificate_end_seconds",
                             "End of the server's certificate file, Unix time; 0: cannot be read",
                             end.ok() ? absl::ToDoubleSeconds(*end - absl::UnixEpoch()) : 0.0));
}

}  // namespace

std::vector<MetricFamily> LiveFigures::Collect() const {
  const CatalogFigures c = catalog_();
  long pages = 0, resident = 0;
  std::ifstream("/proc/self/statm") >> pages >> resident;
  const auto page = static_cast<double>(::sysconf(_SC_PAGESIZE));
  std::vector<MetricFamily> out = {
      GaugeFamily(
          "horopter_catalog_objects", "Objects in the catalog", static_cast<double>(c.objects)),
      GaugeFamily("horopter_catalog_unusable_objects",
                  "Objects that recognition leaves out: damaged, or of no use to it",
                  static_cast<double>(c.unusable)),
      GaugeFamily("horopter_catalog_pending_objects",
                  "Objects that are being prepared again, and left out of recognition until then",
                  static_cast<double>(c.pending)),
      GaugeFamily("horopter_catalog_generation",
                  "Number of the catalog's state; grows with every change",
                  static_cast<double>(c.generation)),
      GaugeFamily(
          "horopter_catalog_behind_seconds",
          "Since the catalog's database was last known to hold no more than is served; 0 of "
          "a file",
          c.behind_s),
      GaugeFamily("process_resident_memory_bytes",
                  "Memory of the process",
                  page * static_cast<double>(resident)),
      GaugeFamily("process_cpu_seconds_total",
                  "Processor time of the process",
                  static_cast<double>(std::clock()) / CLOCKS_PER_SEC,
                  true),
      GaugeFamily("process_start_time_seconds",
                  "Start of the process, Unix time",
                  static_cast<double>(start_)),
  };
  AddDescriptors(&out);
  AddCertificate(certificate_, &out);
  AddLoad(&out);
  return out;
}

void LiveFigures::AskForLoad(std::function<LoadFigures()> load) {
  const std::lock_guard lock(mutex_);
  load_ = std::move(load);
}

void LiveFigures::AddLoad(std::vector<MetricFamily>* out) const {
  const std::lock_guard lock(mutex_);
  if (!load_) return;
  const LoadFigures load = load_();
  out->push_back(GaugeFamily("horopter_scenes_running", "Scenes being recognised", load.running));
  out->push_back(GaugeFamily("horopter_scenes_waiting", "Scenes in the queue", load.waiting));
  out->push_back(GaugeFamily("horopter_memory_reserved_bytes",
                             "Memory that calls have reserved",
                             static_cast<double>(load.reserved_bytes)));
  out->push_back(GaugeFamily("horopter_memory_limit_bytes",
                             "Memory that calls may reserve in all",
                             static_cast<double>(load.limit_bytes)));
}

}  // namespace horopter
