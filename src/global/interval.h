// Interval arithmetic with outward rounding by the hardware (Boost).
//
// Intervals are computed while the processor rounds upward: keep a RoundUpward alive around each use. Only files that
// are compiled with -frounding-math may include this header, since otherwise the compiler moves and merges operations
// as if their rounding were fixed.
#pragma once

#include <boost/numeric/interval.hpp>

namespace saltus::global {

using ProtectedInterval = boost::numeric::interval<
    double, boost::numeric::interval_lib::policies<
                boost::numeric::interval_lib::save_state<boost::numeric::interval_lib::rounded_arith_opp<double>>,
                boost::numeric::interval_lib::checking_base<double>>>;
using Interval = boost::numeric::interval_lib::unprotect<ProtectedInterval>::type;

// While it lives, the processor rounds upward. The mode before is restored at the end.
using RoundUpward = ProtectedInterval::traits_type::rounding;

template <typename T>
T Square(const T& a) {
  return a * a;
}
inline Interval Square(const Interval& a) { return boost::numeric::square(a); }
template <typename T>
T Reciprocal(const T& a) {
  return T(1.0) / a;
}

}  // namespace saltus::global
