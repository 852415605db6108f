// States and controls of hybrid systems divided into the blocks of their parts (HybridFunctions::Parts), which are
// parameter blocks of Ceres.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <utility>
#include <vector>

#include "hybrid/runge_kutta.h"

namespace saltus {

// A vector, of states or of the control, divided into blocks: its parts.
class Divided {
 public:
  // The components of each part in the vector of `size`.
  Divided(int size, std::vector<std::vector<int>> parts) : size_(size), parts_(std::move(parts)) {}

  int size() const { return size_; }
  int num_parts() const { return static_cast<int>(parts_.size()); }
  const std::vector<int>& operator[](int part) const { return parts_[part]; }
  void AppendSizes(std::vector<int>* sizes) const {
    for (const std::vector<int>& part : parts_) sizes->push_back(static_cast<int>(part.size()));
  }
  // Copies the blocks to their places in the vector.
  void Join(double const* const* blocks, double* vector) const {
    for (const std::vector<int>& part : parts_) {
      const double* block = *blocks++;
      for (const int component : part) vector[component] = *block++;
    }
  }
  // Writes a part's columns of a derivative by the vector into the Jacobian of its block, if that is asked for.
  template <typename Derived>
  void Put(const Eigen::MatrixBase<Derived>& derivative, int part, double* jacobian) const {
    if (jacobian == nullptr) return;
    for (Eigen::Index row = 0; row < derivative.rows(); ++row) {
      for (const int component : parts_[part]) *jacobian++ = derivative(row, component);
    }
  }
  template <typename Derived>
  void Put(const Eigen::MatrixBase<Derived>& derivative, double** jacobians) const {
    for (int part = 0; part < num_parts(); ++part) Put(derivative, part, jacobians[part]);
  }

 private:
  int size_;
  std::vector<std::vector<int>> parts_;
};

// The state at a node of a phase, of which the blocks are the parts that are read. Where a part coasts through the
// node, its block is its state at the beginning of the phase.
class StateAtNode {
 public:
  StateAtNode(const HybridFunctions& functions, int mode, Divided states, std::vector<int> read,
              std::vector<bool> coasts, double part_of_phase)
      : functions_(functions),
        mode_(mode),
        part_of_phase_(part_of_phase),
        states_(std::move(states)),
        read_(std::move(read)),
        coasts_(std::move(coasts)),
        x_(Eigen::VectorXd::Zero(states_.size())),
        by_block_(coasts_.size()) {}

  bool Coasts() const { return std::ranges::find(coasts_, true) != coasts_.end(); }
  int num_blocks() const { return states_.num_parts(); }
  void AppendSizes(std::vector<int>* sizes) const { states_.AppendSizes(sizes); }

  // Returns the state; parts that are not read are zero. `times` are begin and end of the phase, if a part coasts.
  const double* Read(double const* const* blocks, double const* const* times, const double* p, bool with_derivatives) {
    states_.Join(blocks, x_.data());
    for (std::size_t i = 0; i < coasts_.size(); ++i) {
      if (!coasts_[i]) continue;
      const std::vector<int>& states = states_[static_cast<int>(i)];
      const auto n = static_cast<Eigen::Index>(states.size());
      const double begin = times[0][0], length = part_of_phase_ * (times[1][0] - begin);
      Eigen::VectorXd after(n);
      by_block_[i].resize(n, n + 2 + functions_.layout().num_parameters);
      functions_.MovePart(read_[i],
                          FlowStep{{mode_, begin, blocks[i], nullptr, p}, length},
                          after.data(),
                          with_derivatives ? by_block_[i].data() : nullptr);
      for (Eigen::Index k = 0; k < n; ++k) x_[states[k]] = after[k];
    }
    return x_.data();
  }

  // Writes the Jacobians of the blocks, given the derivative by the state that was read last, and adds what that is by
  // the parameters, and by begin and end of the phase.
  template <typename Derived>
  void Put(const Eigen::MatrixBase<Derived>& by_state, double** jacobians, RungeKutta::Matrix* by_parameters,
           RungeKutta::Matrix* by_times) const {
    for (int i = 0; i < states_.num_parts(); ++i) {
      if (!coasts_[i]) {
        states_.Put(by_state, i, jacobians[i]);
        continue;
      }
      const std::vector<int>& states = states_[i];
      const auto n = static_cast<Eigen::Index>(states.size());
      RungeKutta::Matrix of_part(by_state.rows(), n);
      for (Eigen::Index k = 0; k < n; ++k) of_part.col(k) = by_state.col(states[k]);
      const RungeKutta::Matrix by = of_part * by_block_[i];  // [x t p h]
      if (jacobians[i] != nullptr) Eigen::Map<RungeKutta::Matrix>(jacobians[i], by.rows(), n) = by.leftCols(n);
      *by_parameters += by.middleCols(n + 1, by_parameters->cols());
      const Eigen::VectorXd by_end = part_of_phase_ * by.rightCols(1);
      by_times->col(0) += by.col(n) - by_end;
      by_times->col(1) += by_end;
    }
  }

 private:
  const HybridFunctions& functions_;
  int mode_;
  double part_of_phase_;
  Divided states_;
  std::vector<int> read_;
  std::vector<bool> coasts_;
  Eigen::VectorXd x_;
  std::vector<RungeKutta::Matrix> by_block_;
};

}  // namespace saltus
