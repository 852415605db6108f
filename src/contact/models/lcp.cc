#include "contact/models/lcp.h"

#include <cmath>

#include "base/linear_algebra.h"

namespace saltus {
namespace {

// The number of degrees of freedom of a disc.
template <int kTurn>
inline constexpr int kDofs = kTurn == kSpin ? 3 : 2;

// A bound on the degrees of freedom of a group of up to kMaxRows rows: each row connects at most two moving discs, of
// two directions and, if they spin, a rotation.
template <int kMaxRows>
inline constexpr int kMaxDofs = kMaxRows == Eigen::Dynamic ? Eigen::Dynamic : 3 * (kMaxRows + 1);
template <int kMaxRows>
using DofVector = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, kMaxDofs<kMaxRows>, 1>;
template <int kMaxRows>
using DofMatrix =
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kMaxDofs<kMaxRows>, kMaxDofs<kMaxRows>>;
template <int kMaxRows>
using DofsByRows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kMaxDofs<kMaxRows>, kMaxRows>;
template <int kMaxRows>
using RowsByDofs = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kMaxRows, kMaxDofs<kMaxRows>>;

// Numbers the degrees of freedom of the discs of some rows, `width` for each disc that is not fixed.
class Dofs {
 public:
  template <typename Rows>
  Dofs(const StepInput<double>& in, std::size_t num_discs, int width, const Rows& rows)
      : width_(width), index_(num_discs, -1, in.scratch), discs_(in.scratch) {
    for (const auto& row : rows) {
      const Candidate& c = row.candidate;
      for (const int disc : {c.a, c.plane ? c.a : c.b}) {
        if (in.bodies[disc].fixed || index_[disc] >= 0) continue;
        index_[disc] = size();
        discs_.push_back(disc);
      }
    }
  }
  int size() const { return width_ * static_cast<int>(discs_.size()); }
  bool spins() const { return width_ > 2; }
  const std::pmr::vector<int>& discs() const { return discs_; }
  // Returns the first degree of freedom of a disc, -1 if it has none.
  int operator[](int disc) const { return index_[disc]; }

 private:
  int width_;
  std::pmr::vector<int> index_, discs_;
};

template <int kMaxRows>
DofVector<kMaxRows> ImpulseDirection(const Dofs& dofs, const Candidate& c, const Vec2d& direction) {
  DofVector<kMaxRows> a = DofVector<kMaxRows>::Zero(dofs.size());
  if (dofs[c.a] >= 0) a.template segment<2>(dofs[c.a]) = direction;
  if (!c.plane && dofs[c.b] >= 0) a.template segment<2>(dofs[c.b]) = -direction;
  return a;
}

// Returns the direction of the impulse of a row in the degrees of freedom, with the lever arms of a tangent.
template <int kMaxRows, typename Row>
DofVector<kMaxRows> RowDirection(const StepInput<double>& in, const Dofs& dofs, const Row& row) {
  DofVector<kMaxRows> a = ImpulseDirection<kMaxRows>(dofs, row.candidate, row.direction);
  if (!dofs.spins() || !row.tangent) return a;
  const auto put = [&](int disc) {
    if (dofs[disc] >= 0) a[dofs[disc] + 2] = -in.bodies[disc].radius;
  };
  put(row.candidate.a);
  if (!row.candidate.plane) put(row.candidate.b);
  return a;
}

// Returns d ImpulseDirection / dp for a given turning distance (step_input.h). When the centres move along the tangent,
// normal and tangent turn alike, each towards the other.
template <int kMaxRows>
DofMatrix<kMaxRows> TurningOfDirection(const Dofs& dofs, const Candidate& c, const Vec2d& direction,
                                       const Vec2d& tangent, double distance) {
  if (c.plane && distance == 0) return DofMatrix<kMaxRows>::Zero(dofs.size(), dofs.size());
  const DofVector<kMaxRows> along = ImpulseDirection<kMaxRows>(dofs, c, tangent);
  return ImpulseDirection<kMaxRows>(dofs, c, Perpendicular(direction)) * along.transpose() / distance;
}

// Returns the matrix X closest to the identity with a^T X a = -e for each column a of `bounces`, with e its
// restitution.
template <int kMaxRows>
DofMatrix<kMaxRows> BounceMatrix(const DofsByRows<kMaxRows>& bounces, const LcpVector<kMaxRows>& restitution) {
  const int size = static_cast<int>(bounces.rows());
  DofMatrix<kMaxRows> X = DofMatrix<kMaxRows>::Identity(size, size);
  if (bounces.cols() == 0) return X;
  LcpMatrix<kMaxRows> gram(bounces.cols(), bounces.cols());
  MultiplyTransposed(bounces, bounces, gram);
  const LcpMatrix<kMaxRows> squared = gram.cwiseProduct(gram);
  LcpVector<kMaxRows> weights = gram.diagonal() + restitution;
  LeastNormSolver(squared, 1e-11).Solve(weights, weights);
  for (int i = 0; i < bounces.cols(); ++i) X -= weights[i] * bounces.col(i) * bounces.col(i).transpose();
  return X;
}

// Where the degrees of freedom of a disc stand in its state: its position and angle, and how fast they change.
constexpr int kPlace[] = {0, 1, 4}, kRate[] = {2, 3, 5};

// Sets the Jacobians of n discs in free flight.
template <int kTurn>
void SetFreeFlight(const StepInput<double>& in, int n, Eigen::Ref<Eigen::MatrixXd> A, Eigen::Ref<Eigen::MatrixXd> B) {
  constexpr int kSize = 4 + kTurn;
  A.setIdentity();
  B.setZero();
  for (int i = 0; i < n; ++i) {
    if (in.bodies[i].fixed) continue;
    A.block<2, 2>(kSize * i, kSize * i + 2).diagonal().setConstant(in.h);
    B.block<2, 2>(kSize * i + 2, 2 * i).diagonal().setConstant(in.h * in.bodies[i].inverse_mass);
    if (kTurn == kSpin) A(kSize * i + kPlace[2], kSize * i + kRate[2]) = in.h;
  }
}

// Returns |l_v| + |l_u| / h over some discs, from the cotangents of all states and forces.
template <int kTurn>
double SizeOfGradient(const StepInput<double>& in, const std::pmr::vector<int>& discs, const Eigen::VectorXd& state,
                      const Eigen::VectorXd& force) {
  double velocity_squared = 0, force_squared = 0;
  for (int disc : discs) {
    velocity_squared += state.segment<2>((4 + kTurn) * disc + 2).squaredNorm();
    force_squared += force.segment<2>(2 * disc).squaredNorm();
  }
  return std::sqrt(velocity_squared) + std::sqrt(force_squared) / in.h;
}

// How much larger counts: an elastic bounce leaves the size unchanged, and rounding must not choose a direction.
constexpr double kLarger = 1 + 1e-9;

}  // namespace

template <int kTurn>
void LcpOf<kTurn>::Linearize(const StepInput<double>& in, std::span<const State<double>> x,
                             Eigen::Ref<Eigen::MatrixXd> A, Eigen::Ref<Eigen::MatrixXd> B) const {
  const int n = static_cast<int>(x.size());
  SetFreeFlight<kTurn>(in, n, A, B);
  std::pmr::vector<State<double>> flying(n, in.scratch);
  FreeFlight(*this, in, x, std::span<State<double>>(flying));
  for (const Group<double>& group : FindGroups<double>(in, x, flying)) {
    if (IsSmall(group)) {
      LinearizeGroup(in, flying, group, SolveBoxedLcp(Problem<kFewLcpRows>(in, group)), /*with_bounces=*/true, A, B);
    } else {
      LinearizeGroup(in, flying, group, SolveBoxedLcp(Problem<Eigen::Dynamic>(in, group)), /*with_bounces=*/true, A, B);
    }
  }
}

template <int kTurn>
void LcpOf<kTurn>::PullBack(const StepInput<double>& in, std::span<const State<double>> x,
                            std::span<const double> after, std::span<double> before) const {
  const int n = static_cast<int>(x.size());
  constexpr int kSize = 4 + kTurn;
  Eigen::MatrixXd A(kSize * n, kSize * n), B(kSize * n, 2 * n);
  SetFreeFlight<kTurn>(in, n, A, B);
  std::vector<State<double>> flying(n);
  FreeFlight(*this, in, x, std::span(flying));
  const Eigen::Map<const Eigen::VectorXd> cotangent(after.data(), kSize * n);
  for (const Group<double>& group : FindGroups<double>(in, x, flying)) {
    const BoxedLcp problem = Problem<Eigen::Dynamic>(in, group);
    const LcpSolution solution = SolveBoxedLcp(problem);
    const LcpSolution preferred = SolveBoxedLcpInClasses(problem, PreferredClasses(in, group, cotangent), solution);
    Eigen::MatrixXd A_preferred = A, B_preferred = B;
    LinearizeGroup(in, flying, group, solution, /*with_bounces=*/true, A, B);
    LinearizeGroup(in, flying, group, preferred, /*with_bounces=*/false, A_preferred, B_preferred);
    const Dofs dofs(in, n, kDofs<kTurn>, group);
    const auto size = [&](const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
      return SizeOfGradient<kTurn>(in, dofs.discs(), a.transpose() * cotangent, b.transpose() * cotangent);
    };
    if (size(A_preferred, B_preferred) <= kLarger * size(A, B)) continue;
    A = A_preferred;
    B = B_preferred;
  }
  Eigen::Map<Eigen::VectorXd> pulled(before.data(), (kSize + 2) * n);
  pulled << A.transpose() * cotangent, B.transpose() * cotangent;
}

template <int kTurn>
std::vector<LcpClass> LcpOf<kTurn>::PreferredClasses(const StepInput<double>& in, const Group<double>& group,
                                                     const Eigen::VectorXd& cotangent) {
  std::vector<LcpClass> classes(group.size(), LcpClass::kFree);
  for (size_t i = 0; i < group.size(); ++i) {
    if (group[i].normal != static_cast<int>(i)) continue;
    const Candidate& c = group[i].candidate;
    const auto along = [&](int disc) {
      return in.bodies[disc].fixed ? 0.0 : Dot(group[i].direction, Vec2d(cotangent.segment<2>((4 + kTurn) * disc + 2)));
    };
    if (along(c.a) - (c.plane ? 0.0 : along(c.b)) >= 0) classes[i] = LcpClass::kClamping;
  }
  return classes;
}

template <int kTurn>
template <int kMaxRows>
void LcpOf<kTurn>::LinearizeGroup(const StepInput<double>& in, std::span<const State<double>> flying,
                                  const Group<double>& group, const LcpSolutionUpTo<kMaxRows>& solution,
                                  bool with_bounces, Eigen::Ref<Eigen::MatrixXd> A, Eigen::Ref<Eigen::MatrixXd> B) {
  using Vector = DofVector<kMaxRows>;
  using Matrix = DofMatrix<kMaxRows>;
  const Dofs dofs(in, flying.size(), kDofs<kTurn>, group);
  const int size = dofs.size();
  const int num_clamping = static_cast<int>(solution.clamping.size());
  Vector inverse_mass(size), free_velocity(size);
  for (int disc : dofs.discs()) {
    inverse_mass.template segment<2>(dofs[disc]).setConstant(in.bodies[disc].inverse_mass);
    free_velocity.template segment<2>(dofs[disc]) = flying[disc].v;
    if constexpr (kTurn == kSpin) {
      inverse_mass[dofs[disc] + 2] = in.bodies[disc].inverse_inertia;
      free_velocity[dofs[disc] + 2] = flying[disc].rotation[1];
    }
  }

  // Per clamping row k: its direction a_k, the impulse a_k + sigma t_k that one unit of it causes together with a
  // tangent at its bound, the derivatives G of both by position, and beta.
  DofsByRows<kMaxRows> direction(size, num_clamping), caused(size, num_clamping);
  LcpList<Matrix, kMaxRows> turning(num_clamping), caused_turning(num_clamping);
  LcpVector<kMaxRows> beta(num_clamping), rhs(num_clamping), impulse(num_clamping);
  DofsByRows<kMaxRows> bounces(size, 0);
  LcpVector<kMaxRows> rebounds(0);  // the restitution of each of these
  for (int k = 0; k < num_clamping; ++k) {
    const int i = solution.clamping[k];
    const Vec2d tangent = Perpendicular(group[group[i].normal].direction);
    direction.col(k) = RowDirection<kMaxRows>(in, dofs, group[i]);
    const double distance = CurvatureRadius(in, group[i].candidate, group[i].distance);
    turning[k] = TurningOfDirection<kMaxRows>(dofs, group[i].candidate, group[i].direction, tangent, distance);
    caused.col(k) = direction.col(k);
    caused_turning[k] = turning[k];
    for (int j = 0; j < static_cast<int>(group.size()); ++j) {
      const LcpClass c = solution.classes[j];
      if (group[j].normal != i || (c != LcpClass::kUpperBound && c != LcpClass::kLowerBound)) continue;
      const double friction = in.ContactOf(group[j].candidate).friction;
      const double sigma = c == LcpClass::kUpperBound ? friction : -friction;
      caused.col(k) += sigma * RowDirection<kMaxRows>(in, dofs, group[j]);
      caused_turning[k] +=
          sigma * TurningOfDirection<kMaxRows>(dofs, group[j].candidate, group[j].direction, tangent, distance);
    }
    const double restitution = in.ContactOf(group[i].candidate).restitution;
    beta[k] = group[i].bounced ? 1 + restitution : 1;
    rhs[k] = group[i].rhs;
    impulse[k] = solution.x[i];
    if (!group[i].bounced || !with_bounces) continue;
    bounces.conservativeResize(Eigen::NoChange, bounces.cols() + 1);
    bounces.template rightCols<1>() = direction.col(k);
    rebounds.conservativeResize(bounces.cols());
    rebounds[bounces.cols() - 1] = restitution;
  }

  const DofsByRows<kMaxRows> response = inverse_mass.asDiagonal() * caused;  // of the velocities to clamping impulses
  Matrix vv = Matrix::Identity(size, size);
  Matrix pv = Matrix::Zero(size, size);
  if (num_clamping > 0) {
    DofsByRows<kMaxRows> solved(size, num_clamping);
    Matrix product(size, size);
    Multiply(response, solution.inverse, solved);
    const DofsByRows<kMaxRows> closing = solved * beta.asDiagonal();
    MultiplyByTransposed(closing, direction, product);
    vv -= product;
    const LcpVector<kMaxRows> z = solution.inverse * rhs;
    const Vector dv = response * z;
    Matrix turned = Matrix::Zero(size, size);         // sum of z G
    Matrix applied = Matrix::Zero(size, size);        // sum of f G
    RowsByDofs<kMaxRows> change(num_clamping, size);  // d(b - Q z)/dp
    for (int k = 0; k < num_clamping; ++k) {
      turned += z[k] * caused_turning[k];
      applied += impulse[k] * caused_turning[k];
      change.row(k) = -(dv + beta[k] * free_velocity).transpose() * turning[k];
    }
    const DofsByRows<kMaxRows> moved = inverse_mass.asDiagonal() * direction;
    RowsByDofs<kMaxRows> by_turning(num_clamping, size);
    MultiplyTransposed(moved, turned, by_turning);
    change -= by_turning;
    Multiply(solved, change, pv);
    pv += inverse_mass.asDiagonal() * applied;
  }

  const Matrix X = BounceMatrix<kMaxRows>(bounces, rebounds);
  constexpr int kSize = 4 + kTurn;
  for (int row : dofs.discs()) {
    for (int column : dofs.discs()) {
      for (int i = 0; i < kDofs<kTurn>; ++i) {
        const int place = kSize * row + kPlace[i], rate = kSize * row + kRate[i], from = dofs[row] + i;
        for (int j = 0; j < kDofs<kTurn>; ++j) {
          const int by_place = kSize * column + kPlace[j], by_rate = kSize * column + kRate[j], by = dofs[column] + j;
          A(place, by_place) = X(from, by);
          A(place, by_rate) = in.h * X(from, by);
          A(rate, by_place) = pv(from, by);
          A(rate, by_rate) = vv(from, by);
          if (j < 2) B(rate, 2 * column + j) = in.h * in.bodies[column].inverse_mass * vv(from, by);
        }
      }
    }
  }
}

template struct LcpOf<0>;
template struct LcpOf<kSpin>;

}  // namespace saltus
