// Forward-mode derivatives over a base scalar B, which is double or an interval (interval.h).
#pragma once

#include <array>

namespace saltus::global {

// A value and its derivatives by N parameters.
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
