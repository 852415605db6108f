// Ctrl-C as a question rather than an end: what has been computed so far can still be written.
#pragma once

#include <csignal>

namespace saltus {

// While it lives, the first SIGINT or SIGTERM only sets a flag, for the computation to look at between iterations; the
// second has its usual effect. A signal that was ignored before (nohup) stays ignored. What was installed before is
// restored at the end. At most one object at a time.
class InterruptGuard {
 public:
  InterruptGuard();
  ~InterruptGuard();
  InterruptGuard(const InterruptGuard&) = delete;
  InterruptGuard& operator=(const InterruptGuard&) = delete;

  // Whether a signal has arrived. May be called from any thread.
  static bool Interrupted();
  // Whether a signal has arrived 0.3 s ago or earlier. Functions that complete a result (checks, motions, figures) stop
  // when this becomes true rather than at the signal, so that short ones are still complete after an interrupt.
  static bool GraceIsOver();

 private:
  struct sigaction previous_interrupt_;
  struct sigaction previous_terminate_;
};

}  // namespace saltus
