#include "control/model_step.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>

namespace saltus {

ModelStep::ModelStep(const Simulator& simulator, StepOfPhase step, std::optional<Push> push)
    : simulator_(simulator), step_(step), push_(push) {
  std::vector<int>& sizes = *mutable_parameter_block_sizes();
  sizes = push ? std::vector<int>{4, 2, 1, 1, 4} : std::vector<int>{4, 1, 1, 4};
  set_num_residuals(push ? PushedStep::kRows : CoastingStep::kRows);
}

bool ModelStep::Evaluate(double const* const* parameters, double* rows, double** jacobians) const {
  const int times = push_ ? 2 : 1;  // which block is `begin`
  const double *x = parameters[0], *force = push_ ? parameters[1] : nullptr, *next = parameters[times + 2];
  const double h = step_.Length(parameters[times], parameters[times + 1]);
  const std::optional<FlightOver> over = simulator_.FreeFlightOver(h);
  if (!over) return false;
  const double inverse_mass = push_ ? push_->inverse_mass : 0;
  const Vec2d a = FlightAcceleration(simulator_.scene().gravity, inverse_mass, force);
  Fly(over->flight, x, a, rows);
  for (int r = 0; r < 4; ++r) rows[r] = next[r] - rows[r];
  const bool grows = push_ && h > push_->least;
  const double scale = push_ ? std::sqrt(push_->effort * std::max(h, push_->least)) : 0;
  for (int j = 0; push_ && j < 2; ++j) rows[4 + j] = scale * force[j];
  if (!std::all_of(rows, rows + num_residuals(), [](double row) { return std::isfinite(row); })) return false;
  if (jacobians == nullptr) return true;

  using Jacobian = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor, PushedStep::kRows, 4>;
  const auto zeros = [&](int columns) { return Jacobian(Jacobian::Zero(num_residuals(), columns)); };
  const auto put = [&](int block, const Jacobian& jacobian) {
    if (jacobians[block] == nullptr) return;
    Eigen::Map<Jacobian>(jacobians[block], jacobian.rows(), jacobian.cols()) = jacobian;
  };
  const StepLinearization::FreeFlight& by = over->flight;
  Jacobian by_node = zeros(4), by_force = zeros(2), by_next = zeros(4);
  for (int j = 0; j < 2; ++j) {
    by_node(j, j) = -by.pp;
    by_node(j, 2 + j) = -by.pv;
    by_node(2 + j, j) = -by.vp;
    by_node(2 + j, 2 + j) = -by.vv;
    if (!push_) continue;
    by_force(j, j) = -by.pa * inverse_mass;
    by_force(2 + j, j) = -by.va * inverse_mass;
    by_force(4 + j, j) = scale;
  }
  put(0, by_node);
  if (push_) put(1, by_force);
  std::array<double, 4> by_length;
  Fly(over->by_time, x, a, by_length.data());
  for (const int end : {0, 1}) {
    const double length = (end ? 1.0 : -1.0) / step_.count;  // d(h)/d(end) or d(h)/d(begin)
    Jacobian by_time = zeros(1);
    for (int r = 0; r < 4; ++r) by_time(r, 0) = -length * by_length[r];
    for (int j = 0; grows && j < 2; ++j) by_time(4 + j, 0) = length * 0.5 * scale / h * force[j];
    put(times + end, by_time);
  }
  by_next.topRows(4).setIdentity();
  put(times + 2, by_next);
  return true;
}

ModelTurn::ModelTurn(const Simulator& simulator, StepOfPhase step, const ModelStep::Push& push)
    : simulator_(simulator), step_(step), push_(push) {
  *mutable_parameter_block_sizes() = {2, 1, 1, 1, 2};
  set_num_residuals(TurnedStep::kRows);
}

bool ModelTurn::Evaluate(double const* const* parameters, double* rows, double** jacobians) const {
  const double *x = parameters[0], turn = parameters[1][0], *next = parameters[4];
  const double h = step_.Length(parameters[2], parameters[3]);
  const std::optional<FlightOver> over = simulator_.FreeFlightOver(h);
  if (!over) return false;
  const auto fly = [&](const StepLinearization::FreeFlight& by, double* to) {
    const double a = push_.inverse_mass * turn;
    to[0] = by.pp * x[0] + by.pv * x[1] + by.pa * a;
    to[1] = by.vp * x[0] + by.vv * x[1] + by.va * a;
  };
  fly(over->turn, rows);
  for (int r = 0; r < 2; ++r) rows[r] = next[r] - rows[r];
  const bool grows = h > push_.least;
  const double scale = std::sqrt(push_.effort * std::max(h, push_.least));
  rows[2] = scale * turn;
  if (!std::all_of(rows, rows + 3, [](double row) { return std::isfinite(row); })) return false;
  if (jacobians == nullptr) return true;
  using Rows = Eigen::Matrix<double, TurnedStep::kRows, Eigen::Dynamic, Eigen::RowMajor>;
  const auto put = [&](int block, const auto& jacobian) {
    if (jacobians[block] != nullptr) Eigen::Map<Rows>(jacobians[block], 3, jacobian.cols()) = jacobian;
  };
  const StepLinearization::FreeFlight& by = over->turn;
  put(0, Eigen::Matrix<double, 3, 2>{{-by.pp, -by.pv}, {-by.vp, -by.vv}, {0, 0}});
  put(1, Eigen::Vector3d(-by.pa * push_.inverse_mass, -by.va * push_.inverse_mass, scale));
  double by_length[2];
  fly(over->turn_by_time, by_length);
  const double cost = grows ? 0.5 * rows[2] / h : 0;
  const Eigen::Vector3d by_end = Eigen::Vector3d(-by_length[0], -by_length[1], cost) / step_.count;
  put(2, Eigen::Vector3d(-by_end));
  put(3, by_end);
  put(4, Eigen::Matrix<double, 3, 2>{{1, 0}, {0, 1}, {0, 0}});
  return true;
}

}  // namespace saltus
