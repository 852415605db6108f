#include "greatest_value.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "hybrid/runge_kutta.h"

namespace saltus::python {
namespace {

using Matrix = RungeKutta::Matrix;

constexpr double kSameTime = 1e-15;  // of a part: times that are not told apart
constexpr int kMostTrials = 100;

// A time in the interval: a share of a part.
struct Place {
  int part = 0;
  double share = 0;
};

}  // namespace

GreatestValue::GreatestValue(HybridSystem system, int mode, RecordedFunction functions)
    : system_(std::move(system)),
      mode_(mode),
      num_parameters_(system_.num_parameters()),
      num_controls_(system_.num_controls()),
      functions_(std::move(functions)) {
  for (const int size : {system_.state_size(mode), num_controls_, num_parameters_, 1, 1}) {
    if (size > 0) mutable_parameter_block_sizes()->push_back(size);
  }
  set_num_residuals(2 * functions_.num_outputs());
}

bool GreatestValue::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const int n = system_.state_size(mode_), P = num_parameters_, m = num_controls_, count = functions_.num_outputs();
  const double* const* block = parameters;
  const double* x = *block++;
  const double* u = m > 0 ? *block++ : nullptr;
  const double* p = P > 0 ? *block++ : nullptr;
  const double t = **block++, length = **block / kParts;
  const int columns = n + 1 + P + m;
  RungeKutta integrator(system_.functions());
  std::vector<Eigen::VectorXd> states = {Eigen::Map<const Eigen::VectorXd>(x, n)};
  const auto step_to = [&](const Place& at) {
    return FlowStep{{mode_, t + at.part * length, states[at.part].data(), u, p}, at.share * length};
  };
  const auto state_at = [&](const Place& at) {
    Eigen::VectorXd state = states[at.part];
    if (at.share > 0) integrator.Step(step_to(at), state.data());
    return state;
  };
  for (int part = 0; part < kParts; ++part) states.push_back(state_at({part, 1}));
  // The values, their derivatives by [x t p u], and their rates.
  struct Values {
    Eigen::VectorXd value, rate;
    Matrix by;
  };
  const auto values_at = [&](const Place& at) {
    Values values{Eigen::VectorXd(count), Eigen::VectorXd(count), Matrix(count, columns)};
    const Eigen::VectorXd state = state_at(at);
    const double time = t + (at.part + at.share) * length;
    functions_.Linearize(std::array<RecordedFunction::Part, 4>{{{state.data(), n}, {&time, 1}, {p, P}, {u, m}}},
                         columns,
                         values.value.data(),
                         values.by.data());
    Eigen::VectorXd slope(n);
    system_.functions().Flow({mode_, time, state.data(), u, p}, slope.data());
    values.rate = values.by.leftCols(n) * slope + values.by.col(n);
    return values;
  };
  std::vector<Values> nodes;
  for (int part = 0; part <= kParts; ++part) nodes.push_back(values_at({part, 0}));

  std::vector<Place> places(2 * count);
  for (int row = 0; row < count; ++row) {
    residuals[row] = nodes[kParts].value[row];
    places[row] = {kParts, 0};
    double& greatest = residuals[count + row];
    greatest = nodes[0].value[row];
    for (int part = 0; part < kParts; ++part) {
      double low = 0, high = 1, at_low = nodes[part].rate[row], at_high = nodes[part + 1].rate[row];
      if (!(at_low > 0 && at_high <= 0)) continue;
      // The Illinois method finds the time at which the rate is zero.
      Values middle = nodes[part];
      double share = 0;
      int side = 0;
      for (int trial = 0; trial < kMostTrials && high - low > kSameTime && middle.rate[row] != 0; ++trial) {
        share = low + (high - low) * at_low / (at_low - at_high);
        middle = values_at({part, share});
        const double rate = middle.rate[row];
        (rate > 0 ? low : high) = share;
        (rate > 0 ? at_low : at_high) = rate;
        if (side * rate > 0) (rate > 0 ? at_high : at_low) /= 2;
        side = rate > 0 ? 1 : -1;
      }
      if (!(middle.value[row] > greatest)) continue;
      greatest = middle.value[row];
      places[count + row] = {part, share};
    }
    if (!std::isfinite(residuals[row]) || !std::isfinite(greatest)) return false;
  }
  if (jacobians == nullptr) return true;

  // The derivatives of states by [x t p u h].
  const int directions = columns + 1;
  std::vector<Matrix> by = {Matrix::Identity(n, directions)};
  const auto tangent_to = [&](const Place& at) {
    RungeKutta::Tangent tangent{by[at.part],
                                Eigen::RowVectorXd::Zero(directions),
                                Eigen::RowVectorXd::Zero(directions),
                                Matrix::Zero(P, directions),
                                Matrix::Zero(m, directions)};
    tangent.t[n] = 1;
    tangent.t[columns] = static_cast<double>(at.part) / kParts;
    tangent.h[columns] = at.share / kParts;
    tangent.p.middleCols(n + 1, P).setIdentity();
    tangent.u.middleCols(n + 1 + P, m).setIdentity();
    return tangent;
  };
  const auto state_by = [&](const Place& at) {
    if (at.share == 0) return by[at.part];
    integrator.Linearize(step_to(at));
    return integrator.PushForward(tangent_to(at));
  };
  const int last = std::ranges::max(places, {}, &Place::part).part;
  for (int part = 0; part < last; ++part) by.push_back(state_by({part, 1}));
  for (int row = 0; row < 2 * count; ++row) {
    const Place& at = places[row];
    const Values values = values_at(at);
    const int function = row % count;
    Eigen::RowVectorXd all = values.by.row(function).head(n) * state_by(at);
    all.segment(n, columns - n) += values.by.row(function).tail(columns - n);
    all[columns] += values.by(function, n) * (at.part + at.share) / kParts;
    if (!all.allFinite()) return false;
    double** next = jacobians;
    const auto put = [&](int first, int size) {
      if (size == 0) return;
      if (*next != nullptr) std::copy_n(all.data() + first, size, *next + row * size);
      ++next;
    };
    put(0, n);
    put(n + 1 + P, m);
    put(n + 1, P);
    put(n, 1);
    put(columns, 1);
  }
  return true;
}

}  // namespace saltus::python
