// The bundle over a plane in Ceres with automatic derivatives: a peer to measure ours by.
#pragma once

#include "server/vision/reconstruction/bundle_adjustment.h"

namespace horopter {

// As AdjustBundle (bundle_adjustment.h).
BundleSummary AdjustBundleInCeres(const BundleOptions& options, Bundle* bundle);

}  // namespace horopter
