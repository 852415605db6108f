#include "hybrid/recorded_mechanics.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <initializer_list>
#include <span>
#include <tuple>
#include <type_traits>
#include <utility>

#include "hybrid/mechanical/mechanical_equations.h"
#include "hybrid/recorded_switches.h"

namespace saltus {
namespace {

constexpr int kTrials = 3;  // points at which a mass is symmetric, or not

double ValueOf(double x) { return x; }
template <int kWidth>
double ValueOf(const ceres::Jet<double, kWidth>& x) {
  return x.a;
}
template <typename S>
double ValueOf(const TimeJet<S>& x) {
  return ValueOf(x.value);
}

// A function of one variable at a number: its value and its first three derivatives.
using Taylor = std::array<double, 4>;

template <int kWidth>
ceres::Jet<double, kWidth> EvaluateRecorded(const ceres::Jet<double, kWidth>& x, const double* f) {
  return {f[0], f[1] * x.v};
}
TimeJet<double> EvaluateRecorded(const TimeJet<double>& x, const double* f) {
  return TimeJet<double>::Compose(x, f[0], f[1], f[2]);
}
template <int kWidth>
TimeJet<ceres::Jet<double, kWidth>> EvaluateRecorded(const TimeJet<ceres::Jet<double, kWidth>>& x, const double* f) {
  return TimeJet<ceres::Jet<double, kWidth>>::Compose(
      x, EvaluateRecorded(x.value, f), EvaluateRecorded(x.value, f + 1), EvaluateRecorded(x.value, f + 2));
}

Taylor PowerAt(double x, double exponent) {
  Taylor f;
  double factor = 1;
  for (int i = 0; i < 4; ++i) {
    f[i] = factor == 0 ? 0 : factor * std::pow(x, exponent - i);
    factor *= exponent - i;
  }
  return f;
}

Taylor TaylorOf(Operation operation, double x) {
  using enum Operation;
  const double f = Apply(operation, x, 0, 0);
  switch (operation) {
    case kAbs:
      return {f, Apply(kSign, x, 0, 0), 0, 0};
    case kSqrt:
      return {f, 0.5 / f, -0.25 / (f * x), 0.375 / (f * x * x)};
    case kExp:
      return {f, f, f, f};
    case kExpm1:
      return {f, f + 1, f + 1, f + 1};
    case kLog:
    case kLog1p: {
      const double r = 1 / (operation == kLog ? x : 1 + x);
      return {f, r, -r * r, 2 * r * r * r};
    }
    case kSin: {
      const double c = std::cos(x);
      return {f, c, -f, -c};
    }
    case kCos: {
      const double s = std::sin(x);
      return {f, -s, -f, s};
    }
    case kTan: {
      const double g = 1 + f * f;
      return {f, g, 2 * f * g, (2 + 6 * f * f) * g};
    }
    case kTanh: {
      const double g = 1 - f * f;
      return {f, g, -2 * f * g, (6 * f * f - 2) * g};
    }
    case kSinh: {
      const double c = std::cosh(x);
      return {f, c, f, c};
    }
    case kCosh: {
      const double s = std::sinh(x);
      return {f, s, f, s};
    }
    case kAsin:
    case kAcos: {
      const double r = (operation == kAsin ? 1 : -1) / std::sqrt(1 - x * x), g = r * r;
      return {f, r, x * r * g, (1 + 2 * x * x) * r * g * g};
    }
    case kAtan: {
      const double g = 1 / (1 + x * x);
      return {f, g, -2 * x * g * g, (6 * x * x - 2) * g * g * g};
    }
    case kAsinh:
    case kAcosh: {
      const double sign = operation == kAsinh ? 1 : -1, r = 1 / std::sqrt(x * x + sign), g = r * r;
      return {f, r, -x * r * g, (2 * x * x - sign) * r * g * g};
    }
    case kAtanh: {
      const double g = 1 / (1 - x * x);
      return {f, g, 2 * x * g * g, (2 + 6 * x * x) * g * g * g};
    }
    case kErf: {
      const double g = 2 / std::sqrt(M_PI) * std::exp(-x * x);
      return {f, g, -2 * x * g, (4 * x * x - 2) * g};
    }
    default:  // the sign and the integer part
      return {f, 0, 0, 0};
  }
}

template <typename T>
void Compute(Operation operation, const T& a, const T& b, const T& c, bool exponent_is_constant, T* result) {
  using enum Operation;
  switch (operation) {
    case kAdd:
      *result = a + b;
      return;
    case kSubtract:
      *result = a - b;
      return;
    case kMultiply:
      *result = a * b;
      return;
    case kDivide:
      *result = a / b;
      return;
    case kNegate:
      *result = -a;
      return;
    case kAtan2:
      *result = atan2(a, b);
      return;
    case kPower:
      if (exponent_is_constant) {
        *result = EvaluateRecorded(a, PowerAt(ValueOf(a), ValueOf(b)).data());
      } else {
        const T logarithm = b * EvaluateRecorded(a, TaylorOf(kLog, ValueOf(a)).data());
        *result = EvaluateRecorded(logarithm, TaylorOf(kExp, ValueOf(logarithm)).data());
      }
      return;
    case kWhere:
      *result = ValueOf(a) != 0 ? b : c;
      return;
    case kProductTerm:
      *result = ValueOf(a) == 0 && std::isnan(ValueOf(b)) && std::isfinite(ValueOf(c)) ? T(0.0) : a * b;
      return;
    case kLess:
    case kLessEqual:
    case kAnd:
    case kOr:
    case kNot:
    case kLarger:
      *result = T(Apply(operation, ValueOf(a), ValueOf(b), ValueOf(c)));
      return;
    default:
      *result = EvaluateRecorded(a, TaylorOf(operation, ValueOf(a)).data());
  }
}

}  // namespace

// A mechanical system as MechanicalFunctionsOf takes it: its functions are templates on the scalar.
class RecordedMechanics {
 public:
  RecordedMechanics(MechanicalLayout layout, const MechanicalRecording& recording)
      : layout_(std::move(layout)), mass_(recording.mass), force_(recording.force) {
    layout_.has_friction.clear();
    layout_.has_reach.clear();
    for (const MechanicalRecording::Contact& contact : recording.contacts) {
      const auto optional = [](const std::optional<ExpressionGraph>& graph) {
        return graph ? std::optional<RecordedFunction>(*graph) : std::nullopt;
      };
      layout_.has_friction.push_back(contact.slide || contact.slide_row ? 1 : 0);
      layout_.has_reach.push_back(contact.reach ? 1 : 0);
      contacts_.push_back({RecordedFunction(contact.gap),
                           RecordedFunction(contact.restitution),
                           RecordedFunction(contact.friction),
                           contact.slide ? RecordedFunction(GradientOf(*contact.slide, layout_.num_coordinates))
                                         : optional(contact.slide_row),
                           optional(contact.reach),
                           optional(contact.distance)});
    }
  }

  MechanicalLayout Layout() const { return layout_; }

  template <typename T>
  void Mass(const T* q, const T* p, T* M) const {
    EvaluateRecorded(mass_, q, p, M);
  }
  template <typename T>
  void Force(const T& t, const T* q, const T* v, const T* u, const T* p, T* h) const {
    const int n = layout_.num_coordinates;
    Evaluate<T>(force_, {{q, n}, {v, n}, {&t, 1}, {p, layout_.num_parameters}, {u, layout_.num_controls}}, h);
  }
  template <typename T>
  T Gap(int contact, const T* q, const T* p) const {
    return EvaluateRecorded(contacts_[contact].gap, q, p);
  }
  template <typename T>
  void SlideRow(int contact, const T* q, const T* p, T* row) const {
    if (contacts_[contact].row) EvaluateRecorded(*contacts_[contact].row, q, p, row);
  }
  template <typename T>
  T Distance(int contact, const T* q, const T* p) const {
    return EvaluateRecorded(contacts_[contact].distance ? *contacts_[contact].distance : contacts_[contact].gap, q, p);
  }
  template <typename T>
  T Reach(int contact, const T* q, const T* p) const {
    return contacts_[contact].reach ? EvaluateRecorded(*contacts_[contact].reach, q, p) : T(1.0);
  }
  template <typename T>
  T Restitution(int contact, const T* p) const {
    return EvaluateAtParameters(contacts_[contact].restitution, p);
  }
  template <typename T>
  T Friction(int contact, const T* p) const {
    return EvaluateAtParameters(contacts_[contact].friction, p);
  }

 private:
  struct Contact {
    RecordedFunction gap, restitution, friction;
    std::optional<RecordedFunction> row, reach, distance;
  };
  template <typename T>
  struct Part {
    const T* data;
    int size;
  };

  template <typename T>
  void EvaluateRecorded(const RecordedFunction& function, const T* q, const T* p, T* outputs) const {
    Evaluate<T>(function, {{q, layout_.num_coordinates}, {p, layout_.num_parameters}}, outputs);
  }
  template <typename T>
  T EvaluateRecorded(const RecordedFunction& function, const T* q, const T* p) const {
    T value;
    EvaluateRecorded(function, q, p, &value);
    return value;
  }
  template <typename T>
  T EvaluateAtParameters(const RecordedFunction& function, const T* p) const {
    T value;
    Evaluate<T>(function, {{p, layout_.num_parameters}}, &value);
    return value;
  }

  template <typename T>
  static void Evaluate(const RecordedFunction& function, std::initializer_list<Part<T>> inputs, T* outputs) {
    if constexpr (std::is_same_v<T, double>) {
      std::array<RecordedFunction::Part, 5> parts;
      std::ranges::transform(inputs, parts.begin(), [](const Part<T>& part) {
        return RecordedFunction::Part{part.data, part.size};
      });
      function.Evaluate(std::span(parts).first(inputs.size()), outputs);
    } else {
      const RecordedFunction::Tape& tape = function.values_;
      thread_local std::vector<T> slots;
      if (slots.size() < tape.size) slots.resize(tape.size);
      T* next = slots.data();
      for (const Part<T>& part : inputs) next = std::copy_n(part.data, part.size, next);
      const auto first_constant = static_cast<int>(next - slots.data());
      for (const double constant : tape.constants) *next++ = T(constant);
      const auto first_result = static_cast<int>(next - slots.data());
      for (const auto& [operation, a, b, c] : tape.instructions) {
        const bool exponent_is_constant = b >= first_constant && b < first_result;
        Compute(operation, slots[a], slots[b], slots[c], exponent_is_constant, next++);
      }
      for (const int slot : tape.outputs) *outputs++ = slots[slot];
    }
  }

  MechanicalLayout layout_;
  RecordedFunction mass_, force_;
  std::vector<Contact> contacts_;
};

std::string Validate(const MechanicalLayout& layout, const MechanicalRecording& recording) {
  const int n = layout.num_coordinates, of_mass = n + layout.num_parameters;
  const auto check = [](const ExpressionGraph& graph, int inputs, int outputs, const std::string& what) {
    if (const std::string wrong = Validate(graph); !wrong.empty()) return what + ": " + wrong;
    if (graph.num_inputs == inputs && static_cast<int>(graph.outputs.size()) == outputs) return std::string();
    return what + ": found " + std::to_string(graph.num_inputs) + " inputs and " +
           std::to_string(graph.outputs.size()) + " outputs, expected " + std::to_string(inputs) + " and " +
           std::to_string(outputs);
  };
  std::string wrong = check(recording.mass, of_mass, n * n, "mass");
  if (wrong.empty())
    wrong = check(recording.force, 2 * n + 1 + layout.num_parameters + layout.num_controls, n, "force");
  if (wrong.empty() && static_cast<int>(recording.contacts.size()) != layout.num_contacts) {
    wrong = "contacts: found " + std::to_string(recording.contacts.size()) + ", expected " +
            std::to_string(layout.num_contacts);
  }
  for (std::size_t i = 0; i < recording.contacts.size() && wrong.empty(); ++i) {
    const MechanicalRecording::Contact& contact = recording.contacts[i];
    const std::string what = "contact '" + layout.contact_names.at(i) + "': ";
    wrong = check(contact.gap, of_mass, 1, what + "gap");
    for (const auto& [graph, outputs, name] : {std::tuple(&contact.slide, 1, "slide"),
                                               std::tuple(&contact.slide_row, n, "slide_row"),
                                               std::tuple(&contact.reach, 1, "reach"),
                                               std::tuple(&contact.distance, 1, "distance")}) {
      if (wrong.empty() && *graph) wrong = check(**graph, of_mass, outputs, what + name);
    }
    if (wrong.empty()) wrong = check(contact.restitution, layout.num_parameters, 1, what + "restitution");
    if (wrong.empty()) wrong = check(contact.friction, layout.num_parameters, 1, what + "friction");
  }
  if (!wrong.empty()) return wrong;
  const RecordedFunction mass(recording.mass);
  for (int trial = 0; trial < kTrials && wrong.empty(); ++trial) {
    std::vector<double> at(of_mass);
    for (int i = 0; i < of_mass; ++i) at[i] = 1.1 + std::sin(1 + trial * of_mass + i);
    Eigen::MatrixXd matrix(n, n);
    const RecordedFunction::Part part{at.data(), of_mass};
    mass.Evaluate({&part, 1}, matrix.data());
    wrong = DescribeAsymmetry(matrix.transpose(), layout);
  }
  if (!wrong.empty()) return wrong;
  // All numbers up to that of the time count: of a mass, whose inputs are [q p], the coordinates.
  for (const auto& [graph, last, name] :
       {std::tuple(&recording.mass, n - 1, "mass"), std::tuple(&recording.force, 2 * n, "force")}) {
    const RecordedSwitches switches({graph}, last);
    if (switches.count() == 0) continue;
    std::vector<std::string> inputs = layout.coordinate_names;
    if (graph == &recording.force) {
      for (const std::string& coordinate : layout.coordinate_names) inputs.push_back("d" + coordinate);
      inputs.emplace_back("t");
    }
    inputs.insert(inputs.end(), layout.parameter_names.begin(), layout.parameter_names.end());
    inputs.insert(inputs.end(), layout.control_names.begin(), layout.control_names.end());
    return std::string(name) + ": found a condition on " + switches.TextOf(0, inputs) +
           ", which changes along a motion and is no event of a mechanical system; expected a smooth function, or a "
           "saltus.HybridSystem, which locates such changes";
  }
  return "";
}

std::shared_ptr<const MechanicalFunctions> MakeMechanicalFunctions(MechanicalLayout layout,
                                                                   const MechanicalRecording& recording) {
  return std::make_shared<MechanicalFunctionsOf<RecordedMechanics>>(RecordedMechanics(std::move(layout), recording));
}

}  // namespace saltus
