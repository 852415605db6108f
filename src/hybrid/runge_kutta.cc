#include "hybrid/runge_kutta.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace saltus {

using namespace cooper_verner;

void HybridFunctions::Step(const FlowStep& step, const double* slope, double* scratch, double* after,
                           double* slope_after) const {
  const auto flow = [&](double t, const double* x, double* xdot) { Flow({step.mode, t, x, step.u, step.p}, xdot); };
  EvaluateStep(state_size(step.mode), step, flow, slope, scratch, after, slope_after);
}

void HybridFunctions::LinearizeStep(const FlowStep& step, double* scratch, double* slopes, double* jacobians) const {
  const int n = state_size(step.mode);
  const std::size_t stride = static_cast<std::size_t>(n) * (n + 1 + layout().num_parameters + layout().num_controls);
  const auto flow = [&](double t, const double* x, double* xdot, double* jacobian) {
    FlowJacobian({step.mode, t, x, step.u, step.p, step.by_parameters}, xdot, jacobian);
  };
  saltus::LinearizeStep(n, step, stride, flow, scratch, slopes, jacobians);
}

RungeKutta::RungeKutta(const HybridFunctions& functions)
    : functions_(functions),
      num_parameters_(functions.layout().num_parameters),
      num_controls_(functions.layout().num_controls) {
  const int most = functions.most_states();
  scratch_.resize((kStages + 2) * most + 1 + num_parameters_ + num_controls_);
  slopes_.resize(kStages * most);
  jacobians_.resize(kStages * most * (most + 1 + num_parameters_ + num_controls_));
}

void RungeKutta::Step(const FlowStep& step, const double* slope, double* after, double* slope_after) {
  functions_.Step(step, slope, scratch_.data(), after, slope_after);
}

RungeKutta::ConstMatrixMap RungeKutta::JacobianOfStage(int stage) const {
  const int columns = size_ + 1 + num_parameters_ + num_controls_;
  return ConstMatrixMap(&jacobians_[static_cast<std::size_t>(stage) * size_ * columns], size_, columns);
}

void RungeKutta::Step(const FlowStep& step, double* after) {
  functions_.Flow(step, slopes_.data());
  Step(step, slopes_.data(), after, slopes_.data());
  if (!step.projects) return;
  functions_.Project(step.mode, after, step.p, slopes_.data());
  std::copy_n(slopes_.data(), functions_.state_size(step.mode), after);
}

void RungeKutta::Linearize(const FlowStep& step) {
  size_ = functions_.state_size(step.mode);
  length_ = step.h;
  projects_ = step.projects;
  double *after = scratch_.data(), *on = after + size_;
  flies_ = functions_.Fly(step, after, jacobians_.data());
  if (flies_) {
    functions_.Flow({step.mode, step.t + step.h, after, step.u, step.p}, slopes_.data());
  } else {
    functions_.LinearizeStep(step, scratch_.data(), slopes_.data(), jacobians_.data());
  }
  if (!projects_) return;
  if (!flies_) CombineSlopes(kStages, size_, length_, step.x, slopes_.data(), after);
  projection_.resize(size_ * (size_ + 1 + num_parameters_));
  const ModePoint at{step.mode, step.t + step.h, after, step.u, step.p, step.by_parameters};
  functions_.ProjectJacobian(at, on, projection_.data());
}

void RungeKutta::LengthDerivative(double* derivative) const {
  if (flies_) {
    std::copy_n(slopes_.data(), size_, derivative);
    return;
  }
  // dX_i/dh = sum a_ij (k_j + h dk_j/dh): scratch_ holds k_j + h dk_j/dh.
  double* total = scratch_.data();
  Eigen::VectorXd by_length(size_);
  for (int i = 0; i <= kStages; ++i) {
    by_length.setZero();
    for (int k = 0; k < kRows[i].count; ++k) {
      const Term& term = kRows[i].terms[k];
      by_length += term.factor * Eigen::Map<const Eigen::VectorXd>(total + term.stage * size_, size_);
    }
    if (i == kStages) break;
    const ConstMatrixMap jacobian = JacobianOfStage(i);
    Eigen::Map<Eigen::VectorXd>(total + i * size_, size_) =
        Eigen::Map<const Eigen::VectorXd>(&slopes_[i * size_], size_) +
        length_ * (jacobian.leftCols(size_) * by_length + kC[i] * jacobian.col(size_));
  }
  std::copy_n(by_length.data(), size_, derivative);
}

bool RungeKutta::IsFinite(int* stage, int* component, int* column) const {
  const int columns = size_ + 1 + num_parameters_ + num_controls_;
  const auto not_finite = [](double number) { return !std::isfinite(number); };
  const auto end = jacobians_.begin() + static_cast<std::ptrdiff_t>(flies_ ? 1 : kStages) * size_ * columns;
  if (const auto found = std::find_if(jacobians_.begin(), end, not_finite); found != end) {
    // A Jet with an infinite derivative by one variable has none by the others.
    const auto row = found - (found - jacobians_.begin()) % columns;
    const auto infinite = std::find_if(row, row + columns, [](double number) { return std::isinf(number); });
    const auto place = static_cast<int>((infinite == row + columns ? found : infinite) - jacobians_.begin());
    *stage = place / (size_ * columns);
    *component = place / columns % size_;
    *column = place % columns;
    return false;
  }
  *stage = 0;
  *component = -1;
  return !projects_ || std::none_of(projection_.begin(), projection_.end(), not_finite);
}

void RungeKutta::PullBack(const FlowStep& step, const double* after, StepCotangent* out) {
  if (!step.projects && functions_.PullBackStep(step, after, out)) return;
  Linearize(step);
  if (projects_) {
    const ConstMatrixMap projection(projection_.data(), size_, size_ + 1 + num_parameters_);
    const Eigen::RowVectorXd by = Eigen::Map<const Eigen::RowVectorXd>(after, size_) * projection;
    for (int j = 0; j < num_parameters_; ++j) out->p[j] += by[size_ + 1 + j];
    std::copy_n(by.data(), size_, out->x);
    after = out->x;
  }
  if (flies_) {
    const Eigen::Map<const Eigen::RowVectorXd> of_after(after, size_);
    out->h = of_after * Eigen::Map<const Eigen::VectorXd>(slopes_.data(), size_);
    const Eigen::RowVectorXd by = of_after * JacobianOfStage(0);
    std::copy_n(by.data(), size_, out->x);
    out->t = by[size_];
    for (int j = 0; j < num_parameters_; ++j) out->p[j] += by[size_ + 1 + j];
    for (int j = 0; j < num_controls_; ++j) out->u[j] += by[size_ + 1 + num_parameters_ + j];
    return;
  }
  DispatchSize(size_, [&](auto size) {
    const int n = size > 0 ? size : size_, columns = size_ + 1 + num_parameters_ + num_controls_;
    const auto multiply = [&](int stage, const double* of_slope, double* of_stage) {
      const double* jacobian = &jacobians_[static_cast<std::size_t>(stage) * n * columns];
      const auto columns_from = [&](int first, int last) {
        for (int column = first; column < last; ++column) of_stage[column] = of_slope[0] * jacobian[column];
        for (int row = 1; row < n; ++row) {
          for (int column = first; column < last; ++column) {
            of_stage[column] += of_slope[row] * jacobian[row * columns + column];
          }
        }
      };
      columns_from(0, n);  // a number of columns that is a constant
      columns_from(n, columns);
    };
    PullBackThroughStages<size>(
        size_, num_parameters_, num_controls_, length_, slopes_.data(), multiply, scratch_.data(), after, out);
  });
}

namespace {

// Returns the product of the derivative of a flow with that of a state. In large systems a state depends on few others.
RungeKutta::Matrix Product(const Eigen::Ref<const RungeKutta::Matrix>& flow, const RungeKutta::Matrix& x) {
  constexpr Eigen::Index kLarge = 16, kFew = 8;  // states; one of so many entries that is not zero
  if (flow.rows() < kLarge || kFew * (flow.array() != 0).count() > flow.size()) return flow * x;
  RungeKutta::Matrix out = RungeKutta::Matrix::Zero(flow.rows(), x.cols());
  for (Eigen::Index row = 0; row < flow.rows(); ++row) {
    for (Eigen::Index column = 0; column < flow.cols(); ++column) {
      if (flow(row, column) != 0) out.row(row) += flow(row, column) * x.row(column);
    }
  }
  return out;
}

}  // namespace

RungeKutta::Matrix RungeKutta::PushForward(const Tangent& in) const {
  const int n = size_;
  std::array<Matrix, kStages> total;  // (k_i dh + h dk_i)
  // The derivative by what a stage, or the closed form, depends on.
  const auto multiply = [&](int stage, const Matrix& x, const Eigen::RowVectorXd& t) {
    const ConstMatrixMap jacobian = JacobianOfStage(stage);
    Matrix out = Product(jacobian.leftCols(n), x);
    // A direction in which a variable does not change takes nothing from the derivative by it, even an infinite one.
    const auto add = [&](int column, const auto& change) {
      for (Eigen::Index direction = 0; direction < change.size(); ++direction) {
        if (change[direction] != 0) out.col(direction) += change[direction] * jacobian.col(column);
      }
    };
    add(n, t);
    for (int j = 0; j < num_parameters_; ++j) add(n + 1 + j, in.p.row(j));
    for (int j = 0; j < num_controls_; ++j) add(n + 1 + num_parameters_ + j, in.u.row(j));
    return out;
  };
  const auto combine = [&](const Row& row) {
    Matrix out = in.x;
    for (int k = 0; k < row.count; ++k) out += row.terms[k].factor * total[row.terms[k].stage];
    return out;
  };
  for (int i = 0; i < kStages && !flies_; ++i) {
    total[i] = Eigen::Map<const Eigen::VectorXd>(&slopes_[i * n], n) * in.h +
               length_ * multiply(i, combine(kRows[i]), in.t + kC[i] * in.h);
  }
  const Matrix after =
      flies_ ? Matrix(multiply(0, in.x, in.t) + Eigen::Map<const Eigen::VectorXd>(slopes_.data(), n) * in.h)
             : combine(kRows[kStages]);
  if (!projects_) return after;
  const ConstMatrixMap projection(projection_.data(), n, n + 1 + num_parameters_);
  return projection.leftCols(n) * after + projection.rightCols(num_parameters_) * in.p;
}

RungeKutta::Matrix RungeKutta::Jacobian(const FlowStep& step, double* after) {
  Linearize(step);
  if (after != nullptr && (flies_ || projects_)) {
    std::copy_n(&scratch_[projects_ ? size_ : 0], size_, after);
  } else if (after != nullptr) {
    CombineSlopes(kStages, size_, length_, step.x, slopes_.data(), after);
  }
  const Eigen::Index columns = size_ + 1 + num_parameters_ + num_controls_ + 1;
  if (flies_ && !projects_) {
    Matrix jacobian(size_, columns);
    jacobian << JacobianOfStage(0), Eigen::Map<const Eigen::VectorXd>(slopes_.data(), size_);
    return jacobian;
  }
  const auto seed = [&](Eigen::Index first, Eigen::Index rows) {
    Matrix out = Matrix::Zero(rows, columns);
    out.middleCols(first, rows).setIdentity();
    return out;
  };
  return PushForward({seed(0, size_),
                      seed(size_, 1),
                      seed(columns - 1, 1),
                      seed(size_ + 1, num_parameters_),
                      seed(size_ + 1 + num_parameters_, num_controls_)});
}

}  // namespace saltus
