// A scalar that remembers how it was computed: derivatives of few results by many variables in one reverse sweep.
//
// A Taped has a value and, unless it is constant, a place on the tape of its thread, where every operation leaves its
// partial derivatives (reverse accumulation, e.g. Griewank and Walther, Evaluating Derivatives, chapter 3). Linear
// systems are one entry each: the sweep solves the transposed system once (implicit differentiation). It stands in
// where Jets do, with their values bit by bit, and pays where variables are many.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <functional>
#include <span>
#include <utility>
#include <vector>

#include "saltus/base/scalar.h"

namespace saltus {

class Taped;

class Tape {
 public:
  // Adds the contributions of the cotangents of the outputs to those of the inputs.
  using PullBack = std::function<void(std::span<const double> outputs, std::span<double> inputs)>;

  // Returns the tape of this thread, on which its operations are recorded.
  static Tape& ThreadTape();

  // Removes all entries; the memory stays.
  void Clear() {
    entries_.resize(1);
    maps_.clear();
  }
  int Add(int a, double by_a, int b = 0, double by_b = 0) {
    entries_.push_back({by_a, by_b, a, b});
    return static_cast<int>(entries_.size()) - 1;
  }
  // Adds a linear map, which is kept until Clear(). `outputs` have their values and get tape indices.
  void AddMap(std::span<const Taped> inputs, std::span<Taped> outputs, PullBack pull_back);

  // Returns the cotangents at all tape indices, given those of some; index 0 has constants. Valid until the next call.
  std::span<const double> Sweep(std::span<const std::pair<int, double>> cotangents);

 private:
  struct Entry {
    double by_a = 0, by_b = 0;
    int a = 0, b = 0;
  };
  struct Map {
    int first;  // its outputs' first place
    std::vector<int> inputs;
    int num_outputs;
    PullBack pull_back;
  };
  void SweepMap(const Map& map);

  std::vector<Entry> entries_{1};
  std::vector<Map> maps_;
  std::vector<double> cotangents_, of_inputs_;
};

class Taped {
 public:
  Taped() = default;
  explicit Taped(double value) : value_(value) {}
  Taped(double value, int place) : value_(value), place_(place) {}
  // Returns a new variable on the tape.
  static Taped Variable(double value) { return {value, Tape::ThreadTape().Add(0, 0)}; }

  double value() const { return value_; }
  int place() const { return place_; }  // 0: it is constant

  // Returns a function of a and b with these derivatives. Not inline: the models' functions would be far larger.
  static Taped FromDerivatives(double value, const Taped& a, double by_a);
  static Taped FromDerivatives(double value, const Taped& a, double by_a, const Taped& b, double by_b);

  friend Taped operator-(const Taped& a) { return FromDerivatives(-a.value_, a, -1); }
  friend Taped operator+(const Taped& a, const Taped& b) { return FromDerivatives(a.value_ + b.value_, a, 1, b, 1); }
  friend Taped operator+(const Taped& a, double b) { return {a.value_ + b, a.place_}; }
  friend Taped operator+(double a, const Taped& b) { return {a + b.value_, b.place_}; }
  friend Taped operator-(const Taped& a, const Taped& b) { return FromDerivatives(a.value_ - b.value_, a, 1, b, -1); }
  friend Taped operator-(const Taped& a, double b) { return {a.value_ - b, a.place_}; }
  friend Taped operator-(double a, const Taped& b) { return FromDerivatives(a - b.value_, b, -1); }
  friend Taped operator*(const Taped& a, const Taped& b) {
    return FromDerivatives(a.value_ * b.value_, a, b.value_, b, a.value_);
  }
  friend Taped operator*(const Taped& a, double b) { return FromDerivatives(a.value_ * b, a, b); }
  friend Taped operator*(double a, const Taped& b) { return FromDerivatives(a * b.value_, b, a); }
  Taped& operator+=(const Taped& b) { return *this = *this + b; }
  Taped& operator-=(const Taped& b) { return *this = *this - b; }
  Taped& operator*=(const Taped& b) { return *this = *this * b; }
  Taped& operator+=(double b) { return *this = *this + b; }
  Taped& operator-=(double b) { return *this = *this - b; }
  Taped& operator*=(double b) { return *this = *this * b; }

  friend bool operator==(const Taped& a, const Taped& b) { return a.value_ == b.value_; }
  friend auto operator<=>(const Taped& a, const Taped& b) { return a.value_ <=> b.value_; }
  friend auto operator<=>(const Taped& a, double b) { return a.value_ <=> b; }

 private:
  double value_ = 0;
  int place_ = 0;
};

namespace internal {
template <>
struct BaseScalar<Taped> {
  using type = double;
};
}  // namespace internal

inline double Value(const Taped& x) { return x.value(); }

// Functions with the derivatives of those of smooth_math.h.
inline Taped Divide(const Taped& a, const Taped& b) {
  const double quotient = a.value() / b.value(), inverse = 1 / b.value();
  return Taped::FromDerivatives(quotient, a, inverse, b, -quotient * inverse);
}
inline Taped Divide(const Taped& a, double b) { return Taped::FromDerivatives(a.value() / b, a, 1 / b); }
inline Taped Divide(double a, const Taped& b) {
  const double quotient = a / b.value();
  return Taped::FromDerivatives(quotient, b, -quotient / b.value());
}
inline Taped SafeSqrt(const Taped& x) {
  if (x.value() == 0) return Taped(0.0);
  const double root = std::sqrt(x.value());
  return Taped::FromDerivatives(root, x, 1 / (2 * root));
}

}  // namespace saltus

namespace Eigen {
template <>
struct NumTraits<saltus::Taped> : NumTraits<double> {
  using Real = saltus::Taped;
  using NonInteger = saltus::Taped;
  using Nested = saltus::Taped;
  using Literal = saltus::Taped;
  enum {
    IsComplex = 0,
    IsInteger = 0,
    IsSigned = 1,
    RequireInitialization = 1,
    ReadCost = 1,
    AddCost = 4,
    MulCost = 4
  };
};
template <typename Operation>
struct ScalarBinaryOpTraits<saltus::Taped, double, Operation> {
  using ReturnType = saltus::Taped;
};
template <typename Operation>
struct ScalarBinaryOpTraits<double, saltus::Taped, Operation> {
  using ReturnType = saltus::Taped;
};
}  // namespace Eigen
