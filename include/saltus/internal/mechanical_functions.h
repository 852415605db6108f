// A mechanical system as the engine sees it, and the adapter that puts a user's struct behind it.
//
// The equations of contact need derivatives of gaps of up to the third order: the normal N = dphi/dq, the acceleration
// v^T phi_qq v that motion along a curved gap adds, and the derivatives of both by all that a motion depends on. They
// come from evaluating the user's functions on the four scalar types below, which are a closed set: what computes with
// contacts is compiled once, in hybrid/mechanical/.
#pragma once

#include <ceres/jet.h>

#include <cmath>
#include <concepts>
#include <string>
#include <utility>
#include <vector>

#include "saltus/internal/complete_jets.h"

namespace saltus {

// ---------------------------------------------------------------------------------------------------------------------
// A function of time with its first and second derivative, over S, which is double or a ceres::Jet.
template <typename S>
struct TimeJet {
  S value{}, rate{}, second{};

  TimeJet() = default;
  TimeJet(double constant) : value(constant), rate(0.0), second(0.0) {}  // NOLINT: constants in expressions
  TimeJet(S v, S r, S s) : value(std::move(v)), rate(std::move(r)), second(std::move(s)) {}

  friend TimeJet operator+(const TimeJet& a, const TimeJet& b) {
    return {a.value + b.value, a.rate + b.rate, a.second + b.second};
  }
  friend TimeJet operator-(const TimeJet& a, const TimeJet& b) {
    return {a.value - b.value, a.rate - b.rate, a.second - b.second};
  }
  friend TimeJet operator*(const TimeJet& a, const TimeJet& b) {
    return {a.value * b.value,
            a.rate * b.value + a.value * b.rate,
            a.second * b.value + 2.0 * (a.rate * b.rate) + a.value * b.second};
  }
  friend TimeJet operator*(const TimeJet& a, double b) { return {a.value * b, a.rate * b, a.second * b}; }
  friend TimeJet operator*(double a, const TimeJet& b) { return b * a; }
  friend TimeJet operator/(const TimeJet& a, const TimeJet& b) {
    const S one_over = 1.0 / b.value;
    return a * TimeJet::Compose(b, one_over, -one_over * one_over, 2.0 * one_over * one_over * one_over);
  }
  friend TimeJet operator/(const TimeJet& a, double b) { return {a.value / b, a.rate / b, a.second / b}; }
  friend TimeJet operator-(const TimeJet& a) { return {-a.value, -a.rate, -a.second}; }
  friend TimeJet operator+(const TimeJet& a) { return a; }
  TimeJet& operator+=(const TimeJet& b) { return *this = *this + b; }
  TimeJet& operator-=(const TimeJet& b) { return *this = *this - b; }
  TimeJet& operator*=(const TimeJet& b) { return *this = *this * b; }
  TimeJet& operator/=(const TimeJet& b) { return *this = *this / b; }

  friend bool operator<(const TimeJet& a, const TimeJet& b) { return a.value < b.value; }
  friend bool operator>(const TimeJet& a, const TimeJet& b) { return a.value > b.value; }
  friend bool operator<=(const TimeJet& a, const TimeJet& b) { return a.value <= b.value; }
  friend bool operator>=(const TimeJet& a, const TimeJet& b) { return a.value >= b.value; }
  friend bool operator==(const TimeJet& a, const TimeJet& b) { return a.value == b.value; }
  friend bool operator!=(const TimeJet& a, const TimeJet& b) { return a.value != b.value; }

  // Returns f(x), given f and its first two derivatives at the value of x.
  static TimeJet Compose(const TimeJet& x, const S& f, const S& first, const S& second) {
    return {f, first * x.rate, first * x.second + second * x.rate * x.rate};
  }
};

template <typename S>
TimeJet<S> sin(const TimeJet<S>& x) {
  using std::cos, std::sin;
  const S s = sin(x.value), c = cos(x.value);
  return TimeJet<S>::Compose(x, s, c, -s);
}
template <typename S>
TimeJet<S> cos(const TimeJet<S>& x) {
  using std::cos, std::sin;
  const S s = sin(x.value), c = cos(x.value);
  return TimeJet<S>::Compose(x, c, -s, -c);
}
template <typename S>
TimeJet<S> tan(const TimeJet<S>& x) {
  using std::tan;
  const S t = tan(x.value), first = 1.0 + t * t;
  return TimeJet<S>::Compose(x, t, first, 2.0 * t * first);
}
template <typename S>
TimeJet<S> exp(const TimeJet<S>& x) {
  using std::exp;
  const S e = exp(x.value);
  return TimeJet<S>::Compose(x, e, e, e);
}
template <typename S>
TimeJet<S> log(const TimeJet<S>& x) {
  using std::log;
  const S first = 1.0 / x.value;
  return TimeJet<S>::Compose(x, log(x.value), first, -first * first);
}
template <typename S>
TimeJet<S> tanh(const TimeJet<S>& x) {
  using std::tanh;
  const S t = tanh(x.value), first = 1.0 - t * t;
  return TimeJet<S>::Compose(x, t, first, -2.0 * t * first);
}
template <typename S>
TimeJet<S> sqrt(const TimeJet<S>& x) {
  using std::sqrt;
  const S root = sqrt(x.value), first = 0.5 / root;
  return TimeJet<S>::Compose(x, root, first, -0.5 * first / x.value);
}
template <typename S>
TimeJet<S> atan(const TimeJet<S>& x) {
  using std::atan;
  const S first = 1.0 / (1.0 + x.value * x.value);
  return TimeJet<S>::Compose(x, atan(x.value), first, -2.0 * x.value * first * first);
}
template <typename S>
TimeJet<S> asin(const TimeJet<S>& x) {
  using std::asin, std::sqrt;
  const S first = 1.0 / sqrt(1.0 - x.value * x.value);
  return TimeJet<S>::Compose(x, asin(x.value), first, x.value * first * first * first);
}
template <typename S>
TimeJet<S> acos(const TimeJet<S>& x) {
  return 0.5 * M_PI - asin(x);
}
// The angle turns at the rate (x y' - y x') / r^2, whose own derivative is that of a quotient.
template <typename S>
TimeJet<S> atan2(const TimeJet<S>& y, const TimeJet<S>& x) {
  using std::atan2;
  const S squared = x.value * x.value + y.value * y.value;
  const S turn = x.value * y.rate - y.value * x.rate;
  const S grows = 2.0 * (x.value * x.rate + y.value * y.rate);
  const S rate = turn / squared;
  return {atan2(y.value, x.value), rate, (x.value * y.second - y.value * x.second - rate * grows) / squared};
}
template <typename S>
TimeJet<S> pow(const TimeJet<S>& x, double power) {
  using std::pow;
  return TimeJet<S>::Compose(
      x, pow(x.value, power), power * pow(x.value, power - 1), power * (power - 1) * pow(x.value, power - 2));
}
template <typename S>
TimeJet<S> abs(const TimeJet<S>& x) {
  return x.value < S(0.0) ? -x : x;
}

// ---------------------------------------------------------------------------------------------------------------------
// The parts of a mechanical system; see saltus/hybrid/mechanical_system.h for the meaning of each function.
struct MechanicalLayout {
  int num_coordinates = 0, num_controls = 0, num_parameters = 0, num_contacts = 0;
  std::vector<char> has_friction = {};  // of each contact
  std::vector<char> has_reach = {};     // likewise; none: no contact has
  // The coordinates that the functions of each contact read, in rising order; none: all contacts may read all.
  std::vector<std::vector<int>> contact_coordinates = {};
  std::vector<std::string> contact_names = {}, coordinate_names = {}, control_names = {}, parameter_names = {};
};

class MechanicalFunctions {
 public:
  static constexpr int kWidth = 12;  // of a pass
  using Jet = ceres::Jet<double, kWidth>;

  virtual ~MechanicalFunctions() = default;
  const MechanicalLayout& layout() const { return layout_; }

  virtual void Mass(const double* q, const double* p, double* M) const = 0;
  virtual void Mass(const Jet* q, const Jet* p, Jet* M) const = 0;
  virtual void Force(const double& t, const double* q, const double* v, const double* u, const double* p,
                     double* h) const = 0;
  virtual void Force(const Jet& t, const Jet* q, const Jet* v, const Jet* u, const Jet* p, Jet* h) const = 0;

  virtual double Gap(int contact, const double* q, const double* p) const = 0;
  virtual Jet Gap(int contact, const Jet* q, const Jet* p) const = 0;
  virtual TimeJet<double> Gap(int contact, const TimeJet<double>* q, const TimeJet<double>* p) const = 0;
  virtual TimeJet<Jet> Gap(int contact, const TimeJet<Jet>* q, const TimeJet<Jet>* p) const = 0;

  // Returns the distance that a closed contact keeps at zero: the gap, continued smoothly past the end of its edge.
  virtual double Distance(int contact, const double* q, const double* p) const = 0;
  virtual Jet Distance(int contact, const Jet* q, const Jet* p) const = 0;
  virtual TimeJet<double> Distance(int contact, const TimeJet<double>* q, const TimeJet<double>* p) const = 0;
  virtual TimeJet<Jet> Distance(int contact, const TimeJet<Jet>* q, const TimeJet<Jet>* p) const = 0;

  // The tangential coordinate of a contact with friction, whose derivative is the row T; or else the row itself.
  virtual bool has_rows() const = 0;
  virtual Jet Slide(int contact, const Jet* q, const Jet* p) const = 0;
  virtual TimeJet<double> Slide(int contact, const TimeJet<double>* q, const TimeJet<double>* p) const = 0;
  virtual TimeJet<Jet> Slide(int contact, const TimeJet<Jet>* q, const TimeJet<Jet>* p) const = 0;
  virtual void SlideRow(int contact, const double* q, const double* p, double* row) const = 0;
  virtual void SlideRow(int contact, const Jet* q, const Jet* p, Jet* row) const = 0;
  virtual void SlideRow(int contact, const TimeJet<double>* q, const TimeJet<double>* p,
                        TimeJet<double>* row) const = 0;
  virtual void SlideRow(int contact, const TimeJet<Jet>* q, const TimeJet<Jet>* p, TimeJet<Jet>* row) const = 0;

  // Returns a function that is positive while a closed contact stays on the part of the edge that its gap belongs to.
  virtual Jet Reach(int contact, const Jet* q, const Jet* p) const = 0;

  virtual double Restitution(int contact, const double* p) const = 0;
  virtual Jet Restitution(int contact, const Jet* p) const = 0;
  virtual double Friction(int contact, const double* p) const = 0;
  virtual Jet Friction(int contact, const Jet* p) const = 0;

 protected:
  explicit MechanicalFunctions(MechanicalLayout layout) : layout_(std::move(layout)) {}

 private:
  const MechanicalLayout layout_;
};

template <typename S>
class MechanicalFunctionsOf final : public MechanicalFunctions {
 public:
  explicit MechanicalFunctionsOf(S system) : MechanicalFunctions(LayoutOf(system)), system_(std::move(system)) {}

  void Mass(const double* q, const double* p, double* M) const override { system_.Mass(q, p, M); }
  void Mass(const Jet* q, const Jet* p, Jet* M) const override { system_.Mass(q, p, M); }
  void Force(const double& t, const double* q, const double* v, const double* u, const double* p,
             double* h) const override {
    system_.Force(t, q, v, u, p, h);
  }
  void Force(const Jet& t, const Jet* q, const Jet* v, const Jet* u, const Jet* p, Jet* h) const override {
    system_.Force(t, q, v, u, p, h);
    const int n = layout().num_coordinates;
    const std::span<Jet> out(h, static_cast<std::size_t>(n));
    if (HasDerivatives<Jet>(out)) return;
    Jet time = t;
    std::vector<Jet> x(q, q + n), y(v, v + n), given(p, p + layout().num_parameters);
    std::vector<Jet> control(u, u + layout().num_controls);
    CompleteJets<Jet>({{&time, 1}, x, y, given, control}, out, [&] {
      system_.Force(time, x.data(), y.data(), control.data(), given.data(), h);
    });
  }

  double Gap(int contact, const double* q, const double* p) const override { return system_.Gap(contact, q, p); }
  Jet Gap(int contact, const Jet* q, const Jet* p) const override { return system_.Gap(contact, q, p); }
  TimeJet<double> Gap(int contact, const TimeJet<double>* q, const TimeJet<double>* p) const override {
    return system_.Gap(contact, q, p);
  }
  TimeJet<Jet> Gap(int contact, const TimeJet<Jet>* q, const TimeJet<Jet>* p) const override {
    return system_.Gap(contact, q, p);
  }

  double Distance(int contact, const double* q, const double* p) const override { return DistanceOf(contact, q, p); }
  Jet Distance(int contact, const Jet* q, const Jet* p) const override { return DistanceOf(contact, q, p); }
  TimeJet<double> Distance(int contact, const TimeJet<double>* q, const TimeJet<double>* p) const override {
    return DistanceOf(contact, q, p);
  }
  TimeJet<Jet> Distance(int contact, const TimeJet<Jet>* q, const TimeJet<Jet>* p) const override {
    return DistanceOf(contact, q, p);
  }

  bool has_rows() const override { return kHasRows; }
  Jet Slide(int contact, const Jet* q, const Jet* p) const override { return SlideOf(contact, q, p); }
  TimeJet<double> Slide(int contact, const TimeJet<double>* q, const TimeJet<double>* p) const override {
    return SlideOf(contact, q, p);
  }
  TimeJet<Jet> Slide(int contact, const TimeJet<Jet>* q, const TimeJet<Jet>* p) const override {
    return SlideOf(contact, q, p);
  }
  void SlideRow(int contact, const double* q, const double* p, double* row) const override {
    RowOf(contact, q, p, row);
  }
  void SlideRow(int contact, const Jet* q, const Jet* p, Jet* row) const override { RowOf(contact, q, p, row); }
  void SlideRow(int contact, const TimeJet<double>* q, const TimeJet<double>* p, TimeJet<double>* row) const override {
    RowOf(contact, q, p, row);
  }
  void SlideRow(int contact, const TimeJet<Jet>* q, const TimeJet<Jet>* p, TimeJet<Jet>* row) const override {
    RowOf(contact, q, p, row);
  }

  Jet Reach(int contact, const Jet* q, const Jet* p) const override {
    if constexpr (requires(const S& s) { s.Reach(0, q, p); }) {
      return system_.Reach(contact, q, p);
    } else {
      return Jet(1.0);
    }
  }

  double Restitution(int contact, const double* p) const override { return system_.Restitution(contact, p); }
  Jet Restitution(int contact, const Jet* p) const override { return system_.Restitution(contact, p); }
  double Friction(int contact, const double* p) const override { return FrictionOf(contact, p); }
  Jet Friction(int contact, const Jet* p) const override { return FrictionOf(contact, p); }

 private:
  static constexpr bool kHasSlide = requires(const S& s, const double* q) {
    { s.Slide(0, q, q) } -> std::convertible_to<double>;
  };
  static constexpr bool kHasRows = requires(const S& s, const double* q, double* row) { s.SlideRow(0, q, q, row); };

  template <typename T>
  T DistanceOf(int contact, const T* q, const T* p) const {
    if constexpr (requires(const S& s) { s.Distance(0, q, p); }) {
      return system_.Distance(contact, q, p);
    } else {
      return system_.Gap(contact, q, p);
    }
  }
  template <typename T>
  T SlideOf(int contact, const T* q, const T* p) const {
    if constexpr (kHasSlide) {
      return system_.Slide(contact, q, p);
    } else {
      return T(0.0);
    }
  }
  template <typename T>
  void RowOf(int contact, const T* q, const T* p, T* row) const {
    if constexpr (kHasRows) system_.SlideRow(contact, q, p, row);
  }
  template <typename T>
  T FrictionOf(int contact, const T* p) const {
    if constexpr (kHasSlide || kHasRows) {
      return system_.Friction(contact, p);
    } else {
      return T(0.0);
    }
  }

  static MechanicalLayout LayoutOf(const S& system) {
    MechanicalLayout layout;
    if constexpr (requires { S::kNumCoordinates; }) {
      layout.num_coordinates = S::kNumCoordinates;
      layout.num_controls = S::kNumControls;
      layout.num_parameters = S::kNumParameters;
      layout.num_contacts = S::kNumContacts;
      if constexpr (requires { S::kContactNames; }) {
        layout.contact_names.assign(S::kContactNames.begin(), S::kContactNames.end());
      }
      if constexpr (requires { S::kCoordinateNames; }) {
        layout.coordinate_names.assign(S::kCoordinateNames.begin(), S::kCoordinateNames.end());
      }
      if constexpr (requires { S::kControlNames; }) {
        layout.control_names.assign(S::kControlNames.begin(), S::kControlNames.end());
      }
      if constexpr (requires { S::kParameterNames; }) {
        layout.parameter_names.assign(S::kParameterNames.begin(), S::kParameterNames.end());
      }
    } else {
      layout = system.Layout();
    }
    if (layout.has_friction.empty()) layout.has_friction.assign(layout.num_contacts, kHasSlide || kHasRows);
    if constexpr (requires(const S& s, const double* q) { s.Reach(0, q, q); }) {
      if (layout.has_reach.empty()) layout.has_reach.assign(layout.num_contacts, 1);
    }
    return layout;
  }

  const S system_;
};

}  // namespace saltus
