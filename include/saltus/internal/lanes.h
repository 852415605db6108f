// One number in each of kLanes motions that are computed at once: the scalar of free flight in batches. A contact
// model without rotation state has its Free (contact/contact_model.h) instantiated with it.
//
// An operation is that of double in every lane, with the same bits. There are no comparisons, whose outcomes could
// differ from lane to lane.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstring>

#include "saltus/base/scalar.h"

namespace saltus {

inline constexpr int kLanes = 4;

class Lanes {
 public:
  using Pack = double __attribute__((vector_size(kLanes * sizeof(double))));

  Lanes() = default;
  // Broadcasts through memory: GCC would take a broadcast apart although the processor has one.
  Lanes(double x) {  // NOLINT: converts, as a Jet does
    const double all[kLanes] = {x, x, x, x};
    std::memcpy(&pack_, all, sizeof(all));
  }
  explicit Lanes(const Pack& pack) : pack_(pack) {}
  // The copy is not trivial, so that it is passed in memory, whatever registers caller and callee are compiled for.
  Lanes(const Lanes& other) : pack_(other.pack_) {}
  Lanes& operator=(const Lanes& other) {
    pack_ = other.pack_;
    return *this;
  }

  double operator[](int lane) const { return pack_[lane]; }

  Lanes operator-() const { return Lanes(-pack_); }
  friend Lanes operator+(const Lanes& a, const Lanes& b) { return Lanes(a.pack_ + b.pack_); }
  friend Lanes operator-(const Lanes& a, const Lanes& b) { return Lanes(a.pack_ - b.pack_); }
  friend Lanes operator*(const Lanes& a, const Lanes& b) { return Lanes(a.pack_ * b.pack_); }
  friend Lanes operator/(const Lanes& a, const Lanes& b) { return Lanes(a.pack_ / b.pack_); }
  Lanes& operator+=(const Lanes& b) { return *this = *this + b; }
  Lanes& operator-=(const Lanes& b) { return *this = *this - b; }
  Lanes& operator*=(const Lanes& b) { return *this = *this * b; }
  Lanes& operator/=(const Lanes& b) { return *this = *this / b; }

 private:
  Pack pack_;
};

// Functions of lanes like those of doubles (base/smooth_math.h).
inline Lanes Divide(const Lanes& a, const Lanes& b) { return a / b; }
inline Lanes SafeSqrt(const Lanes& x) {
  return Lanes(Lanes::Pack{std::sqrt(x[0]), std::sqrt(x[1]), std::sqrt(x[2]), std::sqrt(x[3])});
}

namespace internal {
template <>
struct BaseScalar<Lanes> {
  using type = double;
};
}  // namespace internal

}  // namespace saltus

namespace Eigen {

template <>
struct NumTraits<saltus::Lanes> : GenericNumTraits<double> {
  using Real = saltus::Lanes;
  using NonInteger = saltus::Lanes;
  using Nested = saltus::Lanes;
  using Literal = saltus::Lanes;
};
template <typename Operation>
struct ScalarBinaryOpTraits<double, saltus::Lanes, Operation> {
  using ReturnType = saltus::Lanes;
};
template <typename Operation>
struct ScalarBinaryOpTraits<saltus::Lanes, double, Operation> {
  using ReturnType = saltus::Lanes;
};

}  // namespace Eigen
