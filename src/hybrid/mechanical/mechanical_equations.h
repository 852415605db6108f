// The equations of motion and of impact of a mechanical system with closed contacts, and their derivatives.
//
//   M a = h + F f,     G a + c = 0,     F = [N^T - mu sigma T^T of sliding contacts, N^T, T^T of the others]
//
// where G has the rows N of all closed contacts and T of those that stick, and c are the accelerations that come from
// the turning of these rows. Derivatives follow from the implicit function theorem: with a and f as they are, the
// residuals of both equations are evaluated on Jets.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <atomic>
#include <deque>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "base/linear_algebra.h"
#include "hybrid/mechanical/contact_problem.h"
#include "saltus/internal/mechanical_functions.h"

namespace saltus {

// Where the functions of a mechanical system are evaluated.
template <typename T>
struct MechanicalPoint {
  T t{};
  const T *q = nullptr, *v = nullptr, *u = nullptr, *p = nullptr;
};

// A contact that is closed. Status: 'n' without friction, '+' or '-' sliding with v_t > 0 or < 0, 's' sticking; in the
// expansion of Poisson's law also 'S', which sticks under a normal impulse that is known.
struct ClosedContact {
  int contact = 0;
  char status = 'n';
  bool operator==(const ClosedContact&) const = default;
};

// The sign of v_t of a sliding contact, else 0.
inline int SlidingSign(char status) { return status == '+' ? 1 : status == '-' ? -1 : 0; }

// Adds `change` to `sum`. Entries that are rounding errors of their terms, of which those of the change add up to
// `terms`, become zero: what contacts hold rests exactly, wherever it is.
void AddChange(const Eigen::VectorXd& change, const Eigen::VectorXd& terms, VectorRef sum);

// Returns what is wrong with a mass matrix that is not symmetric; empty if it is.
std::string DescribeAsymmetry(const Eigen::MatrixXd& mass, const MechanicalLayout& layout);

// A mass matrix, factorized. That of free bodies is diagonal.
class MassMatrix {
 public:
  void Factorize(const Eigen::MatrixXd& mass);

  // Returns M^-1 right.
  template <typename Right>
  Eigen::Matrix<double, Eigen::Dynamic, Right::ColsAtCompileTime> Solve(const Eigen::MatrixBase<Right>& right) const {
    if (!is_diagonal_) return cholesky_.solve(right);
    Eigen::Matrix<double, Eigen::Dynamic, Right::ColsAtCompileTime> solution = right;
    // These are the operations of the factorization, in its order, so that the bits are the same.
    if constexpr (Right::ColsAtCompileTime == 1) {
      solution.array() = solution.array() / roots_.array() / roots_.array();
    } else {
      for (Eigen::Index i = 0; i < solution.rows(); ++i) {
        const double inverse = 1 / roots_[i];
        solution.row(i) = (solution.row(i) * inverse).eval() * inverse;
      }
    }
    return solution;
  }

 private:
  bool is_diagonal_ = false;
  Eigen::VectorXd roots_;  // of the diagonal, if there is nothing else
  Eigen::LLT<Eigen::MatrixXd> cholesky_;
};

class MechanicalEquations {
 public:
  using Jet = MechanicalFunctions::Jet;
  static constexpr int kWidth = MechanicalFunctions::kWidth;
  using Point = MechanicalPoint<double>;
  using Jets = std::vector<Jet>;

  explicit MechanicalEquations(const MechanicalFunctions& functions);

  const MechanicalFunctions& functions() const { return f_; }
  int n() const { return n_; }

  // A row of G: the normal of a contact or its tangent.
  struct Row {
    int contact = 0;
    bool tangential = false;
  };
  static std::vector<Row> RowsOf(const std::vector<ClosedContact>& closed);

  // The mass matrix M, factorized, and the matrices of closed contacts at (q, p).
  struct System {
    MassMatrix mass;
    std::vector<Row> rows;
    Eigen::MatrixXd G, F, mobile_F;      // r x n, n x r, M^-1 F
    std::optional<BlockSolver> contact;  // of G M^-1 F; none without rows
    // For derivatives only: whether M depends on anything, and by contact, of those that are closed, what its rows
    // depend on, as indices in [q p].
    bool mass_varies = true;
    std::vector<std::vector<int>> reads;
  };
  // Bodies at rest ask again and again for the same matrices: the last ones of many contacts are kept.
  System Assemble(const std::vector<ClosedContact>& closed, const Point& at, bool for_derivatives = false) const;

  Eigen::RowVectorXd RowAt(const Row& row, const Point& at) const { return RowsAt({row}, at); }
  Eigen::MatrixXd RowsAt(const std::vector<Row>& rows, const Point& at) const;
  // The first or second time derivative of a gap, or the velocity or acceleration along a tangent, on a path with this
  // velocity and acceleration.
  double RateAlong(const Row& row, const double* q, const double* v, const double* p) const;
  double SecondAlong(const Row& row, const double* q, const double* v, const double* a, const double* p) const;
  double Gap(int contact, const Point& at) const { return f_.Gap(contact, at.q, at.p); }
  // Returns a gap, and sets its derivatives by p, unless `by_p` is null, and by the coordinates of the contact, which
  // are all that are not zero.
  double GapGradient(int contact, const Point& at, double* by_q, double* by_p) const;
  // The coordinates that the functions of a contact read.
  std::span<const int> CoordinatesOf(int contact) const;
  // All coordinates and parameters on a path through q with this velocity, and the rate of a gap on it.
  template <typename S>
  struct TimePath {
    std::vector<TimeJet<S>> q, p;
  };
  TimePath<double> PathAlong(const double* q, const double* v, const double* p) const;
  double GapRate(int contact, const TimePath<double>& path) const {
    return f_.Gap(contact, path.q.data(), path.p.data()).rate;
  }
  // Returns the sum of |N_j q_j|, the size of the terms of a gap, to which rounding errors are proportional.
  double GapScale(int contact, const Point& at) const;

  Eigen::VectorXd Force(const Point& at) const;
  // Computes accelerations and forces; unless `terms` is null, also the sizes of the terms of the accelerations along
  // the rows without forces of contacts.
  void Accelerate(const System& system, const Point& at, Eigen::VectorXd* a, Eigen::VectorXd* force,
                  Eigen::VectorXd* terms = nullptr) const;

  // Jets of all that a point consists of, seeded with some of the columns of [q v t p u], or with one direction.
  struct Seeds {
    Jets q, v, p, u;
    Jet t;
    MechanicalPoint<Jet> point() const { return {t, q.data(), v.data(), u.data(), p.data()}; }
  };
  Seeds UnseededPass(const Point& at) const;
  // Seeds these columns, kWidth of them in each pass.
  std::vector<Seeds> SeedColumns(const Point& at, std::span<const int> columns) const;
  Seeds SeedDirection(const Point& at, const double* xdot) const;
  static Eigen::Matrix<double, Eigen::Dynamic, kWidth> Directions(const Jets& jets);
  int num_columns(bool with_control) const { return 2 * n_ + 1 + num_p_ + (with_control ? num_u_ : 0); }
  // Returns the columns of [q v t p] or [q v t p u], without those of p unless `by_parameters`.
  std::vector<int> Columns(bool by_parameters, bool with_control) const;

  // The derivatives of accelerations and forces by the seeds.
  struct Derivative {
    Eigen::Matrix<double, Eigen::Dynamic, kWidth> motion, force;
  };
  Derivative AccelerationDerivative(const System& system, const std::vector<ClosedContact>& closed, const Seeds& seeds,
                                    const Eigen::VectorXd& a, const Eigen::VectorXd& force) const;
  // Solves the equations of an impact, M (v+ - v) = F f + known impulses with G v+ = -E G v. Closed contacts without a
  // restitution in it have e = 0.
  struct KnownImpulse {
    int contact = 0;
    Jet normal;
    int sliding = 0;  // sign of v_t, against which friction acts
  };
  Derivative ImpactDerivative(const System& system, const std::vector<ClosedContact>& closed, const Seeds& seeds,
                              const Eigen::VectorXd& v_plus, const Eigen::VectorXd& force,
                              const std::vector<char>& has_restitution,
                              const std::vector<KnownImpulse>& known = {}) const;

  // Moves q and v onto phi = 0 and G v = 0, and seeds at [q v] with them, from wherever they are.
  void Project(const std::vector<ClosedContact>& closed, double* q, double* v, const double* p,
               std::span<Seeds> seeds = {}) const;

  // Returns N M^-1 (N^T - mu sigma T^T) of a sliding contact; not positive: no force or several keep it closed.
  Jet Pressability(const ClosedContact& contact, const Seeds& seeds, const Point& at) const;

  Jet RateAlong(const Row& row, const Jet* q, const Jet* v, const Jet* p) const;

 private:
  System NewSystem(const std::vector<ClosedContact>& closed, const Point& at, bool for_derivatives) const;
  // Whether the mass matrix depends on coordinates or parameters, at this point or one that was asked for before.
  bool MassVaries(const Point& at) const;
  // Returns the coordinates and parameters that the rows of a contact depend on, as indices in [q p].
  std::vector<int> ReadsOf(int contact, const Point& at) const;
  // Whether the seeds of any of these, of the coordinates and parameters, are not zero.
  bool Vary(std::span<const int> reads, const Seeds& seeds) const;
  // The path that stays where it is.
  TimePath<Jet> Still(const Seeds& seeds) const;
  // `still` is that path, and so again afterwards. The row is zero except for the coordinates among `reads`.
  void RowOf(const Row& row, const Seeds& seeds, std::span<const int> reads, TimePath<Jet>* still, Jet* out) const;
  // v and a are those of the path.
  template <typename S>
  TimeJet<S> RowDerivatives(const Row& row, const TimePath<S>& path, const S* v, const S* a) const;
  // Calls use(coordinates) for each pass over the coordinates of a contact, of which these have the seeds in `q`.
  template <typename Use>
  void ForEachPass(int contact, Jets* q, const Use& use) const;
  // The functions below return or change Jets of which only the derivatives are used.
  // Adds M a.
  template <typename S>
  void AddMomentum(const System& system, const Seeds& seeds, const S* a, Jet* momentum) const;
  // Subtracts the effect of a contact with this normal force, which sticks under a tangential force or slides.
  void SubtractContact(int contact, const Jet& normal, int sliding, const Jet* tangential, const Seeds& seeds,
                       std::span<const int> reads, TimePath<Jet>* still, Jet* residual) const;
  // Subtracts F f from `residual`.
  void SubtractForces(const System& system, const std::vector<ClosedContact>& closed, const Seeds& seeds,
                      const Eigen::VectorXd& force, Jet* residual) const;
  Derivative Solve(const System& system, const Jets& momentum, const Jets& rows) const;
  // Adds to `moved`, the seeds of q or v, the derivative of a change d = M^-1 F force of these with rows + G d = 0.
  void CorrectSeeds(const System& system, const std::vector<ClosedContact>& closed, const Eigen::VectorXd& force,
                    const Jets& rows, Jets* moved, const Seeds& seeds) const;

  const MechanicalFunctions& f_;
  const int n_, num_u_, num_p_;
  std::vector<int> all_;  // indices in [q p]
  struct Kept {
    std::vector<ClosedContact> closed;
    std::vector<double> q_p;
    bool for_derivatives;
    System system;
  };
  mutable std::atomic<bool> mass_varies_ = false;
  mutable std::mutex mutex_;
  mutable std::deque<Kept> kept_;  // under mutex_
};

}  // namespace saltus
