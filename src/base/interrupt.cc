#include "base/interrupt.h"

#include <glog/logging.h>

#include <atomic>
#include <chrono>

namespace saltus {
namespace {

using Clock = std::chrono::steady_clock;
constexpr std::chrono::milliseconds kGrace(300);

// A signal handler reaches nothing but static storage.
std::atomic<bool> interrupted{false};
std::atomic<Clock::rep> interrupt_time{0};  // as a duration since the clock's epoch
std::atomic<bool> guarded{false};
static_assert(std::atomic<bool>::is_always_lock_free && std::atomic<Clock::rep>::is_always_lock_free);

void OnSignal(int) {
  interrupt_time.store(Clock::now().time_since_epoch().count());
  interrupted.store(true);
  std::signal(SIGINT, SIG_DFL);
  std::signal(SIGTERM, SIG_DFL);
}

void Install(int signal, struct sigaction* previous) {
  CHECK_EQ(sigaction(signal, nullptr, previous), 0);
  if (previous->sa_handler == SIG_IGN) return;
  struct sigaction action = {};
  action.sa_handler = OnSignal;
  action.sa_flags = SA_RESTART;
  sigemptyset(&action.sa_mask);
  CHECK_EQ(sigaction(signal, &action, nullptr), 0);
}

}  // namespace

InterruptGuard::InterruptGuard() {
  CHECK(!guarded.exchange(true)) << "two InterruptGuards at a time";
  interrupted.store(false);
  Install(SIGINT, &previous_interrupt_);
  Install(SIGTERM, &previous_terminate_);
}

InterruptGuard::~InterruptGuard() {
  CHECK_EQ(sigaction(SIGINT, &previous_interrupt_, nullptr), 0);
  CHECK_EQ(sigaction(SIGTERM, &previous_terminate_, nullptr), 0);
  guarded.store(false);
}

bool InterruptGuard::Interrupted() { return interrupted.load(); }

bool InterruptGuard::GraceIsOver() {
  if (!interrupted.load()) return false;
  return Clock::now().time_since_epoch() - Clock::duration(interrupt_time.load()) >= kGrace;
}

}  // namespace saltus
