// A computation without the GIL that Ctrl-C ends, and that ends when a callback throws.
#pragma once

#include <pybind11/pybind11.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <exception>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>

#include "saltus/simulate/simulator.h"

namespace saltus::python {

namespace py = pybind11;

// To be made and destroyed with the GIL held.
class Computation {
 public:
  // `seconds`: after which it is to end; 0 is no limit. Throws ValueError for a number that is no such time.
  explicit Computation(double seconds = 0);
  Computation(const Computation&) = delete;
  Computation& operator=(const Computation&) = delete;

  // Runs `compute` without the GIL. What it finds stands even if it was stopped.
  template <typename Compute>
  void Run(const Compute& compute) {
    const Current current(this);
    const py::gil_scoped_release release;
    compute();
  }
  // Throws what has stopped it: KeyboardInterrupt, what another signal's handler raised, or what a callback threw.
  void Rethrow() const {
    if (error_) std::rethrow_exception(error_);
  }
  // The exception of Python's that has stopped it, or None.
  py::object StoppedBy() const;
  // Runs, and throws what has stopped it, or else what `compute` has thrown.
  template <typename Compute>
  void RunOrThrow(const Compute& compute) {
    std::exception_ptr thrown;
    Run([&] {
      try {
        compute();
      } catch (...) {
        thrown = std::current_exception();
      }
    });
    Rethrow();
    if (thrown) std::rethrow_exception(thrown);
  }

  // For what computes to ask, from any thread. The thread that began it looks for signals now and then.
  StopRequest stop() {
    return [this] { return Stopped(); };
  }
  bool Stopped();
  // Returns the reason why it has ended before it was done, if that was the limit of time, otherwise an empty text.
  std::string ReasonTimedOut() const;
  // Adds the text of ReasonTimedOut(), unless it is empty, to a reason, behind a semicolon if the reason has one
  // before.
  void AddWhyTimedOut(std::string* reason) const;

  // Runs `call` with the GIL, from any thread; stops the computation if it throws. False then, and without a call if it
  // has been stopped before.
  template <typename Call>
  bool WithPython(const Call& call) {
    if (stopped_) return false;
    const py::gil_scoped_acquire acquire;
    try {
      call();
    } catch (...) {
      StopFor(std::current_exception());
      return false;
    }
    return true;
  }

  // Stops what this thread runs, if anything, and makes it throw `error`.
  static void StopCurrent(std::exception_ptr error);

 private:
  // Makes it what the thread runs.
  class Current {
   public:
    explicit Current(Computation* computation) : before_(std::exchange(current_, computation)) {}
    ~Current() { current_ = before_; }

   private:
    Computation* before_;
  };
  void StopFor(std::exception_ptr error);

  static thread_local Computation* current_;
  std::thread::id caller_;
  const double seconds_;  // limit of time; 0: none
  const std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
  std::chrono::steady_clock::time_point next_look_{};  // of the caller's thread
  std::atomic<bool> stopped_{false};
  std::mutex mutex_;
  std::exception_ptr error_;  // the first; none if the time was over
};

// Counts work that is done, and shows it from two seconds on, a few times a second, by `counter`(seconds, done, all),
// unless that is None.
class WorkCount {
 public:
  WorkCount(Computation* computation, const py::object& counter, std::int64_t all)
      : computation_(computation), counter_(counter), all_(all) {}
  bool shows() const { return !counter_.is_none(); }
  // Adds work, from any thread.
  void Add(std::int64_t work);

 private:
  Computation* const computation_;
  const py::object& counter_;
  const std::int64_t all_;
  std::atomic<std::int64_t> done_{0};
  const std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
  std::mutex mutex_;  // of the time from which on it is shown next
  std::chrono::steady_clock::time_point next_ = begin_ + std::chrono::seconds(2);
};

// Lets one thread at a time use a simulator, and tells that one, all its life, when its user is asked to stop.
class OneUser {
 public:
  StopRequest stop() {
    return [this] {
      Computation* computation = computation_;
      return computation != nullptr && computation->Stopped();
    };
  }

  // While it lives, the simulator is `computation`'s; others wait. To be made without the GIL.
  class Use {
   public:
    Use(OneUser* of, Computation* computation) : of_(of) {
      // A signal handler may come back while this very thread computes.
      if (of_->thread_ == std::this_thread::get_id()) {
        throw std::runtime_error("this simulation is at work in this very thread; expected another one");
      }
      of_->mutex_.lock();
      of_->thread_ = std::this_thread::get_id();
      of_->computation_ = computation;
    }
    ~Use() {
      of_->computation_ = nullptr;
      of_->thread_ = std::thread::id();
      of_->mutex_.unlock();
    }
    Use(const Use&) = delete;
    Use& operator=(const Use&) = delete;

   private:
    OneUser* of_;
  };

 private:
  std::mutex mutex_;
  std::atomic<std::thread::id> thread_{};
  std::atomic<Computation*> computation_{nullptr};
};

}  // namespace saltus::python
