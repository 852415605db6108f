// Hybrid systems in a few lines: one struct whose functions read a point of the motion and return rows of numbers.
//
//   struct Ball {
//     static constexpr saltus::Sizes kSizes{.states = 2, .controls = 1, .parameters = 2, .guards = 1};
//     template <typename T>
//     auto Flow(const saltus::At<T>& a) const {                            // x'
//       return saltus::Row<T>{a.x[1], a.u[0] - a.p[0]};
//     }
//     template <typename T>
//     T Guard(const saltus::At<T>& a) const {                              // an event where it falls through zero
//       return a.x[0];
//     }
//     template <typename T>
//     auto Reset(const saltus::At<T>& a) const {                           // the state after the event
//       return saltus::Row<T>{T(0), -a.p[1] * a.x[1]};
//     }
//   };
//
// A mode is `a.mode`, and a guard or switch `a.number`. A reset that leads to another mode returns
// saltus::ResetResult<T>{mode, row}. Flow, Guard and Reset may return std::array or std::vector as well; a row holds up
// to kMostInRow numbers. Members that are optional in hybrid_system.h, such as names and OnAccumulation, are optional
// here too; a Switch is a function of a point, and a Flow reads the sides of switches as `a.above`. Systems whose modes
// have states of different sizes need the interface of hybrid_system.h.
//
// A number that does not exist, such as a.u in a guard, throws std::out_of_range with its name and that of the
// function.
#pragma once

#include <algorithm>
#include <array>
#include <concepts>
#include <initializer_list>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include "saltus/hybrid/hybrid_system.h"

namespace saltus {

// The sizes of a system; all modes have as many states, guards and switches.
struct Sizes {
  int states = 0, controls = 0, parameters = 0, guards = 0;
  int modes = 1;
  int switches = 0;  // at most 6, where the flow jumps or has a kink
};

// A view of the numbers of a point, which checks its index. `name` is the letter in messages.
template <typename T>
class Numbers {
 public:
  // `reader` is the name of the function that gets the numbers.
  Numbers(char name, const T* numbers, int size, const char* reader = "function")
      : numbers_(numbers), reader_(reader), size_(size), name_(name) {}

  int size() const { return size_; }
  const T& operator[](int i) const {
    if (i < 0 || i >= size_) {
      const std::string range = size_ > 0
                                    ? std::string(1, name_) + "[0] to " + name_ + "[" + std::to_string(size_ - 1) + "]"
                                    : std::string("none, as it has no ") + name_;
      throw std::out_of_range(std::string(reader_) + ": found " + name_ + "[" + std::to_string(i) + "], expected " +
                              range);
    }
    return numbers_[i];
  }
  const T* begin() const { return numbers_; }
  const T* end() const { return numbers_ + size_; }

 private:
  const T* numbers_;
  const char* reader_;
  int size_;
  char name_;
};

// A point of a motion, the argument of user functions. T is double or a ceres::Jet.
template <typename T>
struct At {
  T t = T(0);                     // time
  Numbers<T> x{'x', nullptr, 0};  // state
  Numbers<T> u{'u', nullptr, 0};  // control; none in guards, resets and terms that are not in each interval
  Numbers<T> p{'p', nullptr, 0};  // parameters of the system
  T h = T(0);                     // terms in each interval: the length of the interval; 0 elsewhere
  int mode = 0;                   // mode of the motion; always 0 in terms
  int number = 0;                 // index of the guard or switch to evaluate
  const bool* above = nullptr;    // flows of systems with switches: whether each of them is above zero
};

inline constexpr int kMostInRow = 24;

// A row of up to kMostInRow numbers, without memory of its own on the heap.
template <typename T>
class Row {
 public:
  Row(std::initializer_list<T> numbers) : size_(static_cast<int>(numbers.size())) {
    static_assert(std::is_trivially_destructible_v<T>);
    if (size_ > kMostInRow) {
      throw std::length_error("Row: found " + std::to_string(size_) + " numbers, expected at most " +
                              std::to_string(kMostInRow) + "; return a std::vector");
    }
    std::uninitialized_copy(numbers.begin(), numbers.end(), numbers_);
  }
  int size() const { return size_; }
  const T* begin() const { return numbers_; }
  const T* end() const { return numbers_ + size_; }

 private:
  int size_;
  union {
    T numbers_[kMostInRow];
  };
};

// The mode after an event, and the state in it.
template <typename T>
struct ResetResult {
  int mode;
  Row<T> x;
};

// Adapts a struct with kSizes to the interface of hybrid_system.h. Names and other optional members are inherited.
template <typename S>
struct CompactSystem : S {
  static constexpr int kNumControls = S::kSizes.controls, kNumParameters = S::kSizes.parameters;
  static constexpr auto kStateSizes = [] {
    std::array<int, S::kSizes.modes> sizes{};
    sizes.fill(S::kSizes.states);
    return sizes;
  }();
  static constexpr auto kNumGuards = [] {
    std::array<int, S::kSizes.modes> guards{};
    guards.fill(S::kSizes.guards);
    return guards;
  }();

  template <typename T>
  void Flow(int mode, const T& t, const T* x, const T* u, const T* p, T* xdot) const {
    Flow(mode, t, x, u, p, nullptr, xdot);
  }
  template <typename T>
  void Flow(int mode, const T& t, const T* x, const T* u, const T* p, const bool* above, T* xdot) const {
    At<T> at = MakePoint("Flow", mode, 0, t, x, p);
    at.u = {'u', u, kNumControls, "Flow"};
    at.above = above;
    Write("Flow", S::Flow(at), xdot);
  }
  template <typename T>
  T Guard(int mode, int guard, const T& t, const T* x, const T* p) const {
    if constexpr (S::kSizes.guards > 0) {
      return S::Guard(MakePoint("Guard", mode, guard, t, x, p));
    } else {
      return T(1.0);
    }
  }
  template <typename T>
  int Reset(int mode, int guard, const T& t, const T* x, const T* p, T* x_plus) const {
    if constexpr (S::kSizes.guards > 0) {
      const auto after = S::Reset(MakePoint("Reset", mode, guard, t, x, p));
      if constexpr (requires { after.mode; }) {
        Write("Reset", after.x, x_plus);
        return after.mode;
      } else {
        Write("Reset", after, x_plus);
      }
    }
    return mode;
  }
  template <typename T>
  T Switch(int mode, int number, const T& t, const T* x, const T* p) const {
    return S::Switch(MakePoint("Switch", mode, number, t, x, p));
  }

 private:
  template <typename T>
  static At<T> MakePoint(const char* function, int mode, int number, const T& t, const T* x, const T* p) {
    At<T> at;
    at.t = t;
    at.x = {'x', x, S::kSizes.states, function};
    at.u = {'u', nullptr, 0, function};
    at.p = {'p', p, kNumParameters, function};
    at.mode = mode;
    at.number = number;
    return at;
  }
  template <typename Range, typename T>
  static void Write(const char* function, const Range& numbers, T* to) {
    const auto size = numbers.end() - numbers.begin();
    if (size != S::kSizes.states) {
      throw std::length_error(std::string(function) + ": found " + std::to_string(size) + " numbers, expected " +
                              std::to_string(S::kSizes.states) + ", one for each state");
    }
    std::copy(numbers.begin(), numbers.end(), to);
  }
};

// Adapts a struct with kSizes and switches.
template <typename S>
struct CompactSwitchedSystem : CompactSystem<S> {
  static constexpr auto kNumSwitches = [] {
    std::array<int, S::kSizes.modes> switches{};
    switches.fill(S::kSizes.switches);
    return switches;
  }();
};

// Makes a hybrid system of a struct with kSizes or of a struct as hybrid_system.h describes; returns a HybridSystem as
// it is.
template <typename S>
HybridSystem MakeHybridSystem(S system) {
  if constexpr (std::derived_from<S, HybridSystem>) {
    return system;
  } else if constexpr (!requires { S::kSizes; }) {
    return HybridSystem(std::move(system));
  } else if constexpr (S::kSizes.switches > 0) {
    return HybridSystem(CompactSwitchedSystem<S>{{std::move(system)}});
  } else {
    return HybridSystem(CompactSystem<S>{std::move(system)});
  }
}

}  // namespace saltus
