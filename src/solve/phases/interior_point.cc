#include "solve/phases/interior_point.h"

#ifdef SALTUS_WITH_IPOPT
#include <ceres/manifold.h>
#include <glog/logging.h>

#include <Eigen/Core>
#include <IpIpoptApplication.hpp>
#include <IpIpoptCalculatedQuantities.hpp>
#include <IpIpoptData.hpp>
#include <IpOrigIpoptNLP.hpp>
#include <IpTNLP.hpp>
#include <IpTNLPAdapter.hpp>
#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <unordered_map>

#include "base/statistics.h"
#endif

namespace saltus {

std::string ReasonNoInteriorPoint() {
  if (HasInteriorPoint()) return "";
  return "this build has no IPOPT; install it (coinor-libipopt-dev) and build saltus again";
}

#ifndef SALTUS_WITH_IPOPT

bool HasInteriorPoint() { return false; }
AugmentedLagrangian::Summary MinimizeByInteriorPoint(const std::vector<ConstrainedFunction>&,
                                                     const AugmentedLagrangian::Options&, ceres::Problem*) {
  return {};
}

#else

namespace {

using Ipopt::Index;
using Ipopt::Number;
using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr double kNoBound = 2e19;   // IPOPT takes a bound beyond 1e19 for none
constexpr double kWidth = 1e-6;     // of differences, relative to the size of a variable
constexpr double kRelaxed = 1e-13;  // of bounds: controls that go back to them hardly move, and keep constraints
constexpr double kExtreme = 1e3;    // the size of a variable, or its inverse
constexpr int kMostRestoring = 40;  // iterations in a row that look for a feasible point alone
constexpr int kMostCurved = 200;    // columns of a function whose Hessian is found by differences
constexpr double kInactive = 1e-8;  // of the largest multiplier: constraints with less add nothing to the Hessian

// The problem as IPOPT asks for it. Variables are the free components of the parameter blocks, in the order in which
// the functions name them first (that of ceres::Problem is one of addresses); rows are the constraints of the functions
// in their order.
class InteriorPointProblem final : public Ipopt::TNLP {
 public:
  InteriorPointProblem(const std::vector<ConstrainedFunction>& functions, const AugmentedLagrangian::Options& options,
                       ceres::Problem* problem, AugmentedLagrangian::Summary* summary)
      : options_(options), summary_(*summary) {
    for (const ConstrainedFunction& function : functions) {
      for (double* block : function.blocks) FindVariables(block, problem);
    }
    for (const ConstrainedFunction& function : functions) AddFunction(function);
    FindSizes();
    start_ = Variables();
  }

  // With its size as unit, a variable moves some row by about one. By default only those of very large or small sizes
  // have these units, such as metres of an orbit. Returns whether there are any.
  bool HasExtremeSizes() const { return std::ranges::any_of(sizes_, IsExtreme); }
  void TakeAllSizes() { takes_all_sizes_ = true; }

  int MostCurvedColumns() const {
    std::size_t most = 0;
    for (const Function& function : functions_) most = std::max(most, function.curved.size());
    return static_cast<int>(most);
  }

  std::vector<double> Variables() const {
    std::vector<double> x;
    for (const double* component : components_) x.push_back(*component);
    return x;
  }
  void MoveTo(const std::vector<double>& x) { Evaluate(x.data(), true); }

  bool get_nlp_info(Index& n, Index& m, Index& nonzeros_of_jacobian, Index& nonzeros_of_hessian,
                    IndexStyleEnum& style) override {
    n = static_cast<Index>(components_.size());
    m = num_rows_;
    nonzeros_of_jacobian = nonzeros_of_hessian = 0;
    for (const Function& function : functions_) {
      const auto columns = static_cast<Index>(function.columns.size());
      const auto curved = static_cast<Index>(function.curved.size());
      nonzeros_of_jacobian += function.num_constraints() * columns;
      nonzeros_of_hessian += function.HasSquares() ? columns * (columns + 1) / 2 : curved * (curved + 1) / 2;
    }
    style = C_STYLE;
    return true;
  }

  bool get_bounds_info(Index n, Number* lower, Number* upper, Index /*m*/, Number* rows_lower,
                       Number* rows_upper) override {
    std::copy_n(lower_.data(), n, lower);
    std::copy_n(upper_.data(), n, upper);
    for (const Function& function : functions_) {
      for (int row = 0; row < function.num_constraints(); ++row) {
        *rows_lower++ = row < function.roles().equalities ? 0 : -kNoBound;
        *rows_upper++ = 0;
      }
    }
    return true;
  }

  bool get_scaling_parameters(Number& objective, bool& scales_variables, Index n, Number* variables, bool& scales_rows,
                              Index /*m*/, Number* /*rows*/) override {
    objective = 1;
    scales_variables = true;
    scales_rows = false;
    for (Index i = 0; i < n; ++i) variables[i] = takes_all_sizes_ || IsExtreme(sizes_[i]) ? 1 / sizes_[i] : 1;
    return true;
  }

  bool get_starting_point(Index n, bool /*init_x*/, Number* x, bool /*init_z*/, Number* /*z_lower*/,
                          Number* /*z_upper*/, Index /*m*/, bool /*init_lambda*/, Number* /*lambda*/) override {
    std::copy_n(start_.data(), n, x);
    return true;
  }

  bool eval_f(Index /*n*/, const Number* x, bool is_new, Number& value) override {
    if (!Evaluate(x, is_new)) return false;
    value = Cost();
    return std::isfinite(value);
  }

  bool eval_grad_f(Index n, const Number* x, bool is_new, Number* gradient) override {
    if (!Linearize(x, is_new)) return false;
    std::fill_n(gradient, n, 0.0);
    for (const Function& function : functions_) {
      for (int row = function.num_constraints(); row < function.num_rows(); ++row) {
        const double weight = function.IsValue(row) ? 1 : 2 * function.rows[row];
        for (size_t j = 0; j < function.columns.size(); ++j) {
          gradient[function.columns[j].variable] += weight * function.JacobianEntry(row, function.columns[j]);
        }
      }
    }
    return true;
  }

  bool eval_g(Index /*n*/, const Number* x, bool is_new, Index /*m*/, Number* rows) override {
    if (!Evaluate(x, is_new)) return false;
    for (const Function& function : functions_)
      rows = std::copy_n(function.rows.data(), function.num_constraints(), rows);
    return true;
  }

  bool eval_jac_g(Index /*n*/, const Number* x, bool is_new, Index /*m*/, Index /*nonzeros*/, Index* rows,
                  Index* columns, Number* values) override {
    if (values != nullptr && !Linearize(x, is_new)) return false;
    Index first = 0;
    for (const Function& function : functions_) {
      for (int row = 0; row < function.num_constraints(); ++row) {
        for (const Column& column : function.columns) {
          if (values != nullptr) {
            *values++ = function.JacobianEntry(row, column);
          } else {
            *rows++ = first + row;
            *columns++ = column.variable;
          }
        }
      }
      first += function.num_constraints();
    }
    return true;
  }

  bool eval_h(Index /*n*/, const Number* x, bool is_new, Number factor, Index /*m*/, const Number* multipliers,
              bool /*new_multipliers*/, Index /*nonzeros*/, Index* rows, Index* columns, Number* values) override {
    if (values == nullptr) {
      for (const Function& function : functions_) {
        const std::vector<Column>& among = function.HasSquares() ? function.columns : function.curved;
        for (size_t i = 0; i < among.size(); ++i) {
          for (size_t j = 0; j <= i; ++j) {
            *rows++ = std::max(among[i].variable, among[j].variable);
            *columns++ = std::min(among[i].variable, among[j].variable);
          }
        }
      }
      return true;
    }
    if (!Linearize(x, is_new)) return false;
    const double inactive = kInactive * Largest(std::span(multipliers, num_rows_));
    for (Function& function : functions_) {
      if (Stops()) return false;
      values = AddHessian(factor, multipliers, inactive, &function, values);
      multipliers += function.num_constraints();
    }
    return true;
  }

  bool intermediate_callback(Ipopt::AlgorithmMode mode, Index iteration, Number /*value*/, Number /*primal*/,
                             Number /*dual*/, Number /*mu*/, Number /*step*/, Number /*regularization*/,
                             Number /*dual_length*/, Number /*primal_length*/, Index /*trials*/,
                             const Ipopt::IpoptData* data, Ipopt::IpoptCalculatedQuantities* quantities) override {
    if (iteration == 0) {
      restoring_ = 0;
      return true;
    }
    ++summary_.iterations;
    restoring_ = mode == Ipopt::RegularMode ? 0 : restoring_ + 1;
    if (options_.callback) {
      if (mode == Ipopt::RegularMode) MoveTo(data, quantities);
      summary_.interrupted = summary_.interrupted || !options_.callback(Cost());
    }
    return !summary_.interrupted && restoring_ < kMostRestoring;
  }

  void finalize_solution(Ipopt::SolverReturn status, Index /*n*/, const Number* x, const Number* /*z_lower*/,
                         const Number* /*z_upper*/, Index /*m*/, const Number* /*rows*/, const Number* /*multipliers*/,
                         Number /*value*/, const Ipopt::IpoptData* /*data*/,
                         Ipopt::IpoptCalculatedQuantities* /*quantities*/) override {
    summary_.usable = Evaluate(x, true);
    if (!summary_.usable) return;
    summary_.cost = Cost();
    summary_.violation = 0;
    for (const Function& function : functions_) {
      for (int row = 0; row < function.num_constraints(); ++row) {
        const double value = function.rows[row];
        summary_.violation = std::max(summary_.violation, row < function.roles().equalities ? std::abs(value) : value);
      }
    }
    summary_.converged = (status == Ipopt::SUCCESS || status == Ipopt::STOP_AT_ACCEPTABLE_POINT) &&
                         summary_.violation <= options_.tolerance;
  }

 private:
  // A free component of a parameter block of a function.
  struct Column {
    int block = 0, component = 0, variable = 0;
  };
  struct Function {
    const ConstrainedFunction* of;
    std::vector<Column> columns, curved;  // all, and those of blocks in which the function is not affine
    std::vector<double> rows;
    std::vector<Matrix> jacobians;  // of each block
    std::vector<double*> pointers;  // to the numbers of the Jacobians

    const RowRoles& roles() const { return of->roles; }
    int num_rows() const { return of->function->num_residuals(); }
    int num_constraints() const { return roles().equalities + roles().inequalities; }
    bool IsValue(int row) const { return row < num_constraints() + roles().values; }
    bool HasSquares() const { return num_rows() > num_constraints() + roles().values; }
    double JacobianEntry(int row, const Column& column) const { return jacobians[column.block](row, column.component); }
    bool Evaluate(double** out) { return of->function->Evaluate(of->blocks.data(), rows.data(), out); }
  };

  static bool IsExtreme(double size) { return std::max(size, 1 / size) > kExtreme; }

  void FindVariables(double* block, ceres::Problem* problem) {
    if (variables_.count(block) > 0) return;
    const int size = problem->ParameterBlockSize(block);
    std::vector<int>& variables = variables_[block];
    variables.assign(size, -1);
    if (problem->IsParameterBlockConstant(block)) return;
    const ceres::Manifold* manifold = problem->GetManifold(block);
    Matrix tangents = Matrix::Identity(size, size);
    if (manifold != nullptr) {
      tangents.resize(size, manifold->TangentSize());
      CHECK(manifold->PlusJacobian(block, tangents.data()));
    }
    for (int i = 0; i < size; ++i) {
      if (tangents.row(i).isZero(0)) continue;
      variables[i] = static_cast<int>(components_.size());
      components_.push_back(block + i);
      lower_.push_back(std::max(-kNoBound, problem->GetParameterLowerBound(block, i)));
      upper_.push_back(std::min(kNoBound, problem->GetParameterUpperBound(block, i)));
    }
  }

  void AddFunction(const ConstrainedFunction& of) {
    Function function{&of, {}, {}, std::vector<double>(of.function->num_residuals()), {}, {}};
    const std::vector<int>& sizes = of.function->parameter_block_sizes();
    const auto blocks = static_cast<int>(sizes.size());
    for (int block = 0; block < blocks; ++block) {
      function.jacobians.emplace_back(function.num_rows(), sizes[block]);
      const std::vector<int>& variables = variables_.at(of.blocks[block]);
      for (int i = 0; i < sizes[block]; ++i) {
        if (variables[i] < 0) continue;
        function.columns.push_back({block, i, variables[i]});
        if (block < blocks - of.roles.affine_blocks) function.curved.push_back(function.columns.back());
      }
    }
    for (Matrix& jacobian : function.jacobians) function.pointers.push_back(jacobian.data());
    if (of.roles.are_bounds) return SetBounds(&function);
    num_rows_ += function.num_constraints();
    functions_.push_back(std::move(function));
    Function& added = functions_.back();  // its matrices have moved with it
    for (size_t block = 0; block < added.jacobians.size(); ++block)
      added.pointers[block] = added.jacobians[block].data();
  }

  // Each row is a (z - at) <= 0 of one component z.
  void SetBounds(Function* function) {
    if (!function->Evaluate(function->pointers.data())) return;
    for (int row = 0; row < function->num_constraints(); ++row) {
      for (const Column& column : function->columns) {
        const double a = function->JacobianEntry(row, column);
        if (a == 0) continue;
        const double at = *components_[column.variable] - function->rows[row] / a;
        double& upper = upper_[column.variable];
        double& lower = lower_[column.variable];
        if (a > 0) {
          upper = std::min(upper, at);
        } else {
          lower = std::max(lower, at);
        }
      }
    }
  }

  // The size of a variable is the change that moves some row, of order one, by one; of a row that is a cost the slope
  // vanishes at an optimum, and tells nothing. Without other rows, and by shooting, it is the width of its bounds.
  void FindSizes() {
    std::vector<double> steepest(components_.size(), 0.0);
    for (Function& function : functions_) {
      if (!function.Evaluate(function.pointers.data())) continue;
      for (const Column& column : function.columns) {
        for (int row = 0; row < function.num_rows(); ++row) {
          if (row >= function.num_constraints() && function.IsValue(row)) continue;
          const double slope = std::abs(function.JacobianEntry(row, column));
          if (std::isfinite(slope)) steepest[column.variable] = std::max(steepest[column.variable], slope);
        }
      }
    }
    for (size_t i = 0; i < components_.size(); ++i) {
      const double width = upper_[i] - lower_[i];
      const bool is_bounded = width > 0 && width < kNoBound;
      if (steepest[i] > 0 && !(options_.is_shooting && is_bounded)) {
        sizes_.push_back(1 / steepest[i]);
      } else {
        sizes_.push_back(is_bounded ? width : std::max(std::abs(*components_[i]), 1.0));
      }
    }
  }

  void Take(const Number* x) {
    for (size_t i = 0; i < components_.size(); ++i) *components_[i] = x[i];
  }
  bool Evaluate(const Number* x, bool is_new) {
    if (!is_new && evaluated_) return true;
    Take(x);
    linearized_ = false;
    evaluated_ = std::all_of(
        functions_.begin(), functions_.end(), [](Function& function) { return function.Evaluate(nullptr); });
    return evaluated_;
  }
  bool Linearize(const Number* x, bool is_new) {
    if (!is_new && linearized_) return true;
    Take(x);
    evaluated_ = linearized_ = std::all_of(functions_.begin(), functions_.end(), [this](Function& function) {
      return !Stops() && function.Evaluate(function.pointers.data());
    });
    summary_.jacobians += linearized_;
    return linearized_;
  }

  bool Stops() {
    summary_.interrupted = summary_.interrupted || (options_.stop && options_.stop());
    return summary_.interrupted;
  }

  double Cost() const {
    double cost = 0;
    for (const Function& function : functions_) {
      for (int row = function.num_constraints(); row < function.num_rows(); ++row) {
        cost += function.IsValue(row) ? function.rows[row] : function.rows[row] * function.rows[row];
      }
    }
    return cost;
  }

  // Moves the parameter blocks to the current iterate.
  void MoveTo(const Ipopt::IpoptData* data, Ipopt::IpoptCalculatedQuantities* quantities) {
    auto* nlp = dynamic_cast<Ipopt::OrigIpoptNLP*>(GetRawPtr(quantities->GetIpoptNLP()));
    auto* adapter = nlp != nullptr ? dynamic_cast<Ipopt::TNLPAdapter*>(GetRawPtr(nlp->nlp())) : nullptr;
    if (adapter == nullptr) return;
    std::vector<Number> x(components_.size());
    adapter->ResortX(*data->curr()->x(), x.data());
    Evaluate(x.data(), true);
  }

  // Writes the lower triangle of what a function adds to the Hessian, in the order of its structure. Returns the place
  // behind it.
  Number* AddHessian(Number factor, const Number* multipliers, double inactive, Function* function, Number* values) {
    const std::vector<Column>& among = function->HasSquares() ? function->columns : function->curved;
    const auto count = static_cast<Eigen::Index>(among.size());
    hessian_.setZero(count, count);
    if (function->HasSquares() && factor != 0) {
      const int rows = function->num_rows() - function->num_constraints() - function->roles().values;
      Matrix squares(rows, count);
      for (Eigen::Index j = 0; j < count; ++j) {
        squares.col(j) = function->jacobians[among[j].block].col(among[j].component).tail(rows);
      }
      hessian_.noalias() += 2 * factor * squares.transpose() * squares;
    }
    Eigen::VectorXd weights(function->num_rows());
    for (int row = 0; row < function->num_rows(); ++row) {
      weights[row] = row < function->num_constraints() ? multipliers[row]
                     : function->IsValue(row)          ? factor
                                                       : 2 * factor * function->rows[row];
    }
    if (weights.cwiseAbs().maxCoeff() > inactive) AddDifferences(weights, function);
    for (Eigen::Index i = 0; i < count; ++i) {
      for (Eigen::Index j = 0; j <= i; ++j) *values++ = 0.5 * (hessian_(i, j) + hessian_(j, i));
    }
    return values;
  }

  // Adds d/dx (J^T w) by the curved columns, which come first among all of them.
  void AddDifferences(const Eigen::VectorXd& weights, Function* function) {
    const std::vector<Matrix> jacobians = function->jacobians;
    const std::vector<double> rows = function->rows;
    const auto gradient = [&](Eigen::VectorXd* by) {
      by->resize(static_cast<Eigen::Index>(function->curved.size()));
      if (!function->Evaluate(function->pointers.data())) return false;
      for (Eigen::Index i = 0; i < by->size(); ++i) {
        const Column& column = function->curved[i];
        (*by)[i] = function->jacobians[column.block].col(column.component).dot(weights);
      }
      return by->allFinite();
    };
    Eigen::VectorXd moved, middle(static_cast<Eigen::Index>(function->curved.size()));
    for (Eigen::Index i = 0; i < middle.size(); ++i) {
      const Column& column = function->curved[i];
      middle[i] = jacobians[column.block].col(column.component).dot(weights);
    }
    for (size_t j = 0; j < function->curved.size(); ++j) {
      const int variable = function->curved[j].variable;
      double& value = *components_[variable];
      const double at = value, width = std::max(kWidth * sizes_[variable], 1e-7 * std::abs(at));
      for (const double side : {1.0, -1.0}) {
        value = at + side * width;
        const double change = value - at;
        const bool has_moved = gradient(&moved);
        value = at;
        if (!has_moved) continue;
        hessian_.col(static_cast<Eigen::Index>(j)).head(middle.size()) += (moved - middle) / change;
        break;
      }
    }
    function->rows = rows;
    for (size_t block = 0; block < jacobians.size(); ++block) function->jacobians[block] = jacobians[block];
  }

  const AugmentedLagrangian::Options& options_;
  AugmentedLagrangian::Summary& summary_;
  std::unordered_map<const double*, std::vector<int> > variables_;  // of each block: its components' variables, or -1
  std::vector<double*> components_;                                 // of each variable
  std::vector<double> lower_, upper_, sizes_, start_;
  std::vector<Function> functions_;
  int num_rows_ = 0, restoring_ = 0;
  bool evaluated_ = false, linearized_ = false, takes_all_sizes_ = false;
  Matrix hessian_;
};

// Whether a solve has ended nearer to the constraints than another one, or with lower costs where both meet them.
bool EndsBetter(const AugmentedLagrangian::Summary& end, const AugmentedLagrangian::Summary& than, double tolerance) {
  if (!end.usable || !than.usable) return end.usable;
  const bool meets = end.violation <= tolerance, other = than.violation <= tolerance;
  return meets && other ? end.cost < than.cost : end.violation < than.violation;
}

}  // namespace

bool HasInteriorPoint() { return true; }

AugmentedLagrangian::Summary MinimizeByInteriorPoint(const std::vector<ConstrainedFunction>& functions,
                                                     const AugmentedLagrangian::Options& options,
                                                     ceres::Problem* problem) {
  static std::mutex one_at_a_time;
  const std::lock_guard<std::mutex> lock(one_at_a_time);
  AugmentedLagrangian::Summary summary;
  const Ipopt::SmartPtr<Ipopt::IpoptApplication> application = IpoptApplicationFactory();
  application->Options()->SetIntegerValue("print_level", 0);
  application->Options()->SetStringValue("sb", "yes");
  application->Options()->SetNumericValue("tol", 1e-9);
  application->Options()->SetNumericValue("compl_inf_tol", 1e-14);
  application->Options()->SetNumericValue("mu_min", 1e-16);
  application->Options()->SetNumericValue("constr_viol_tol", 0.1 * options.tolerance);
  application->Options()->SetNumericValue("acceptable_tol", 1e-8);
  application->Options()->SetNumericValue("acceptable_constr_viol_tol", 0.1 * options.tolerance);
  application->Options()->SetNumericValue("bound_relax_factor", kRelaxed);
  application->Options()->SetStringValue("mu_strategy", "adaptive");
  const Ipopt::SmartPtr<InteriorPointProblem> nlp = new InteriorPointProblem(functions, options, problem, &summary);
  if (nlp->MostCurvedColumns() > kMostCurved) {
    application->Options()->SetStringValue("hessian_approximation", "limited-memory");
  }
  // Sizes of the start are good units of most variables, but not of angles that hardly matter at the start. So all of
  // them are taken for a second attempt only. Without an optimum, the better end of the two is kept.
  AugmentedLagrangian::Summary first;
  std::vector<double> first_end;
  for (const bool takes_all_sizes : {false, true}) {
    const int rest = options.iterations - summary.iterations;
    if (takes_all_sizes) nlp->TakeAllSizes();
    application->Options()->SetIntegerValue("max_iter", takes_all_sizes ? rest : (rest + 1) / 2);
    application->Options()->SetStringValue(
        "nlp_scaling_method", takes_all_sizes || nlp->HasExtremeSizes() ? "user-scaling" : "gradient-based");
    if (application->Initialize("") != Ipopt::Solve_Succeeded)  // reads no file of options
      return summary;
    application->OptimizeTNLP(Ipopt::SmartPtr<Ipopt::TNLP>(GetRawPtr(nlp)));
    if (summary.converged || summary.interrupted) break;
    if (!takes_all_sizes) {
      first = summary;
      first_end = nlp->Variables();
    }
  }
  if (!summary.converged && EndsBetter(first, summary, options.tolerance)) {
    nlp->MoveTo(first_end);
    summary.usable = first.usable;
    summary.cost = first.cost;
    summary.violation = first.violation;
  }
  return summary;
}

#endif

}  // namespace saltus
