#include "control/model_step.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>

namespace saltus {

template <int kSize>
ModelStep<kSize>::ModelStep(const Simulator& simulator, StepOfPhase step, std::optional<Push> push)
    : simulator_(simulator), step_(step), push_(push) {
  std::vector<int>& sizes = *mutable_parameter_block_sizes();
  sizes = {2 * kSize, 1, 1, 2 * kSize};
  if (push) sizes.insert(sizes.begin() + 1, kSize);
  set_num_residuals(push ? PushedStep<kSize>::kRows : CoastingStep<kSize>::kRows);
}

template <int kSize>
bool ModelStep<kSize>::Evaluate(double const* const* parameters, double* rows, double** jacobians) const {
  constexpr int kEqualities = 2 * kSize;
  const int times = push_ ? 2 : 1;  // which block is `begin`
  const double *x = parameters[0], *force = push_ ? parameters[1] : nullptr, *next = parameters[times + 2];
  const double h = step_.Length(parameters[times], parameters[times + 1]);
  const std::optional<FlightOver> over = simulator_.FreeFlightOver(h);
  if (!over) return false;
  const double inverse_mass = push_ ? push_->inverse_mass : 0;
  Coordinates<double, kSize> gravity = Coordinates<double, kSize>::Zero();
  if constexpr (kSize == 2) gravity = simulator_.scene().gravity;
  const Coordinates<double, kSize> a = FlightAcceleration(gravity, inverse_mass, force);
  const StepLinearization::FreeFlight& by = kSize == 2 ? over->flight : over->turn;
  Fly(by, x, a, rows);
  for (int r = 0; r < kEqualities; ++r) rows[r] = next[r] - rows[r];
  const bool grows = push_ && h > push_->least;
  const double scale = push_ ? std::sqrt(push_->effort * std::max(h, push_->least)) : 0;
  for (int j = 0; push_ && j < kSize; ++j) rows[kEqualities + j] = scale * force[j];
  if (!std::all_of(rows, rows + num_residuals(), [](double row) { return std::isfinite(row); })) return false;
  if (jacobians == nullptr) return true;

  using Jacobian =
      Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor, PushedStep<kSize>::kRows, kEqualities>;
  const auto zeros = [&](int columns) { return Jacobian(Jacobian::Zero(num_residuals(), columns)); };
  const auto put = [&](int block, const Jacobian& jacobian) {
    if (jacobians[block] == nullptr) return;
    Eigen::Map<Jacobian>(jacobians[block], jacobian.rows(), jacobian.cols()) = jacobian;
  };
  Jacobian by_node = zeros(kEqualities), by_force = zeros(kSize), by_next = zeros(kEqualities);
  for (int j = 0; j < kSize; ++j) {
    by_node(j, j) = -by.pp;
    by_node(j, kSize + j) = -by.pv;
    by_node(kSize + j, j) = -by.vp;
    by_node(kSize + j, kSize + j) = -by.vv;
    if (!push_) continue;
    by_force(j, j) = -by.pa * inverse_mass;
    by_force(kSize + j, j) = -by.va * inverse_mass;
    by_force(kEqualities + j, j) = scale;
  }
  put(0, by_node);
  if (push_) put(1, by_force);
  std::array<double, kEqualities> by_length;
  Fly(kSize == 2 ? over->by_time : over->turn_by_time, x, a, by_length.data());
  for (const int end : {0, 1}) {
    const double length = (end ? 1.0 : -1.0) / step_.count;  // d(h)/d(end) or d(h)/d(begin)
    Jacobian by_time = zeros(1);
    for (int r = 0; r < kEqualities; ++r) by_time(r, 0) = -length * by_length[r];
    for (int j = 0; grows && j < kSize; ++j) by_time(kEqualities + j, 0) = length * 0.5 * scale / h * force[j];
    put(times + end, by_time);
  }
  by_next.topRows(kEqualities).setIdentity();
  put(times + 2, by_next);
  return true;
}

template class ModelStep<1>;
template class ModelStep<2>;

}  // namespace saltus
