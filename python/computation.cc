#include "computation.h"

#include <cmath>
#include <ctime>

#include "base/number_text.h"

namespace saltus::python {
namespace {

constexpr std::chrono::milliseconds kLook(50);  // how often signals are looked for

// Returns the time of the steady clock, up to 4 ms ago, at a fifth of the cost: rollouts ask in each step.
std::chrono::steady_clock::time_point CoarseNow() {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC_COARSE, &now);
  return std::chrono::steady_clock::time_point(std::chrono::seconds(now.tv_sec) +
                                               std::chrono::nanoseconds(now.tv_nsec));
}

}  // namespace

thread_local Computation* Computation::current_ = nullptr;

Computation::Computation(double seconds) : caller_(std::this_thread::get_id()), seconds_(seconds) {
  if (!(seconds >= 0) || std::isinf(seconds)) {
    throw py::value_error("seconds: found " + ToText(seconds) +
                          ", expected a finite number of at least 0; 0 is no limit");
  }
}

std::string Computation::ReasonTimedOut() const {
  if (!stopped_ || error_) return "";
  return "the limit of " + ToText(seconds_) + " s was reached; raise seconds, or go on from what was found";
}

void Computation::AddWhyTimedOut(std::string* reason) const {
  const std::string why = ReasonTimedOut();
  if (!why.empty()) *reason += (reason->empty() ? "" : "; ") + why;
}

void Computation::StopCurrent(std::exception_ptr error) {
  if (current_ != nullptr) current_->StopFor(std::move(error));
}

py::object Computation::StoppedBy() const {
  try {
    Rethrow();
  } catch (const py::error_already_set& error) {
    return error.value();
  }
  return py::none();
}

bool Computation::Stopped() {
  if (stopped_) return true;
  const bool is_caller = std::this_thread::get_id() == caller_;
  if (!is_caller && seconds_ == 0) return false;
  const auto now = CoarseNow();
  if (seconds_ > 0 && std::chrono::duration<double>(now - begin_).count() >= seconds_) return stopped_ = true;
  if (!is_caller || now < next_look_) return false;
  next_look_ = now + kLook;
  WithPython([] {
    if (PyErr_CheckSignals() != 0) throw py::error_already_set();
  });
  return stopped_;
}

void WorkCount::Add(std::int64_t work) {
  done_ += work;
  const std::unique_lock lock(mutex_, std::try_to_lock);
  const auto now = std::chrono::steady_clock::now();
  if (!shows() || !lock || now < next_) return;
  next_ = now + std::chrono::milliseconds(200);
  computation_->WithPython([&] { counter_(std::chrono::duration<double>(now - begin_).count(), done_.load(), all_); });
}

void Computation::StopFor(std::exception_ptr error) {
  const std::lock_guard lock(mutex_);
  if (!error_) error_ = std::move(error);
  stopped_ = true;
}

}  // namespace saltus::python
