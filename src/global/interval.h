// Interval arithmetic with outward rounding by the hardware (Boost), and the same functions for doubles.
//
// Intervals are computed while the processor rounds upward: keep a RoundUpward alive around each use. Only files that
// are compiled with -frounding-math may include this header, since otherwise the compiler moves and merges operations
// as if their rounding were fixed.
#pragma once

#include <array>
#include <boost/numeric/interval.hpp>

namespace saltus::global {

using ProtectedInterval = boost::numeric::interval<
    double, boost::numeric::interval_lib::policies<
                boost::numeric::interval_lib::save_state<boost::numeric::interval_lib::rounded_arith_opp<double>>,
                boost::numeric::interval_lib::checking_base<double>>>;
using Interval = boost::numeric::interval_lib::unprotect<ProtectedInterval>::type;

// While it lives, the processor rounds upward. The mode before is restored at the end.
using RoundUpward = ProtectedInterval::traits_type::rounding;

inline double Square(double a) { return a * a; }
inline double Reciprocal(double a) { return 1 / a; }
inline Interval Square(const Interval& a) { return boost::numeric::square(a); }
inline Interval Reciprocal(const Interval& a) { return Interval(1.0) / a; }

// Forward-mode derivatives over a base scalar B, which is double or an interval: a value and its derivatives by N
// parameters.
template <typename B, int N>
struct Jet {
  B value = B(0);
  std::array<B, N> slope = Zero();

  Jet() = default;
  explicit Jet(const B& constant) : value(constant) {}

  static std::array<B, N> Zero() {
    std::array<B, N> zero;
    zero.fill(B(0));
    return zero;
  }

  Jet& operator+=(const Jet& other) {
    value += other.value;
    for (int i = 0; i < N; ++i) slope[i] += other.slope[i];
    return *this;
  }
  Jet& operator-=(const Jet& other) {
    value -= other.value;
    for (int i = 0; i < N; ++i) slope[i] -= other.slope[i];
    return *this;
  }
  Jet& operator*=(const B& factor) {
    value *= factor;
    for (int i = 0; i < N; ++i) slope[i] *= factor;
    return *this;
  }
  friend Jet operator+(Jet a, const Jet& b) { return a += b; }
  friend Jet operator-(Jet a, const Jet& b) { return a -= b; }
  friend Jet operator*(Jet a, const B& b) { return a *= b; }
  friend Jet operator*(const B& b, Jet a) { return a *= b; }
  friend Jet operator*(const Jet& a, const Jet& b) {
    Jet product(a.value * b.value);
    for (int i = 0; i < N; ++i) product.slope[i] = a.value * b.slope[i] + a.slope[i] * b.value;
    return product;
  }
};

template <typename B, int N>
Jet<B, N> Square(const Jet<B, N>& a) {
  Jet<B, N> square(Square(a.value));
  const B twice = a.value + a.value;
  for (int i = 0; i < N; ++i) square.slope[i] = twice * a.slope[i];
  return square;
}

template <typename B, int N>
Jet<B, N> Reciprocal(const Jet<B, N>& a) {
  Jet<B, N> out(Reciprocal(a.value));
  const B by_value = -Square(out.value);
  for (int i = 0; i < N; ++i) out.slope[i] = by_value * a.slope[i];
  return out;
}

}  // namespace saltus::global
