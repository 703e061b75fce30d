#include "server/base/stop_scope.h"

namespace horopter {
namespace {

thread_local const StopRequested* current_stop = nullptr;

}  // namespace

StopScope::StopScope(const StopRequested& stop) : outer_(current_stop) {
  current_stop = &stop;
}

StopScope::~StopScope() {
  current_stop = outer_;
}

const StopRequested* StopScope::Current() {
  return current_stop;
}

void StopScope::SetCurrent(const StopRequested* stop) {
  current_stop = stop;
}

void LeaveIfStopped() {
  if (IsWorkStopped()) throw WorkStopped();
}

bool IsWorkStopped() {
  return current_stop != nullptr && IsStopRequested(*current_stop);
}

}  // namespace horopter
