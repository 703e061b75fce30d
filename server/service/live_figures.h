// Figures that are read when somebody asks for them: nothing has to be kept up to date.
#pragma once

#include <prometheus/client_metric.h>
#include <prometheus/collectable.h>
#include <prometheus/metric_family.h>

#include <ctime>
#include <functional>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "server/service/telemetry.h"

namespace horopter {

// Thread-safe.
class LiveFigures final : public prometheus::Collectable {
 public:
  // `certificate`: PEM file whose end is told; empty: none.
  LiveFigures(std::function<CatalogFigures()> catalog, std::string certificate)
      : catalog_(std::move(catalog)),
        certificate_(std::move(certificate)),
        start_(std::time(nullptr)) {}

  std::vector<prometheus::MetricFamily> Collect() const override;

  // See Telemetry::AskForLoad.
  void AskForLoad(std::function<LoadFigures()> load);

 private:
  void AddLoad(std::vector<prometheus::MetricFamily>* out) const;

  std::function<CatalogFigures()> catalog_;
  std::string certificate_;
  std::time_t start_;
  mutable std::mutex mutex_;
  std::function<LoadFigures()> load_;  // guarded by mutex_
};

}  // namespace horopter
