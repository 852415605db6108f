#include "hybrid/mechanical/mechanical_equations.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <type_traits>

#include "base/number_text.h"

namespace saltus {
namespace {

using Jet = MechanicalEquations::Jet;
using Block = Eigen::Matrix<double, Eigen::Dynamic, MechanicalEquations::kWidth>;

constexpr double kDependentRow = 1e-10;    // pivots of rows that depend on others, of the largest
constexpr int kMostCorrections = 10;       // of a projection
constexpr double kRounding = 1e-13;        // of the terms of a gap: corrections below it do not change derivatives
constexpr double kSymmetric = 1e-12;       // of the largest entry of a mass matrix
constexpr std::size_t kManyContacts = 16;  // whose matrices are kept
constexpr std::size_t kMostKept = 4;
constexpr double kCancels = 1e-13;  // of the terms of an acceleration or velocity: what is left is rounding

template <typename S>
std::vector<TimeJet<S>> Path(int n, const S* q, const S* v, const S* a) {
  std::vector<TimeJet<S>> path(n);
  for (int i = 0; i < n; ++i) path[i] = {q[i], v[i], a != nullptr ? a[i] : S(0.0)};
  return path;
}
template <typename S>
std::vector<TimeJet<S>> Constant(int n, const S* p) {
  std::vector<TimeJet<S>> path(n);
  for (int i = 0; i < n; ++i) path[i] = {p[i], S(0.0), S(0.0)};
  return path;
}

// The solution for each column, in place. Few rows have fewer solutions for unit vectors than there are columns.
void SolveColumns(const BlockSolver& solver, Block* right) {
  const Eigen::Index rows = right->rows();
  Eigen::VectorXd column(rows);
  if (rows < MechanicalEquations::kWidth / 2 && right->allFinite()) {
    Eigen::MatrixXd inverse(rows, rows);
    for (Eigen::Index j = 0; j < rows; ++j) {
      column = Eigen::VectorXd::Unit(rows, j);
      solver.Solve(column, column);
      inverse.col(j) = column;
    }
    *right = inverse.lazyProduct(*right).eval();
    return;
  }
  for (int j = 0; j < right->cols(); ++j) {
    column = right->col(j);
    if ((column.array() == 0).all()) continue;
    solver.Solve(column, column);
    right->col(j) = column;
  }
}

}  // namespace

void AddChange(const Eigen::VectorXd& change, const Eigen::VectorXd& terms, VectorRef sum) {
  for (Eigen::Index i = 0; i < sum.size(); ++i) {
    const double before = sum[i];
    sum[i] += change[i];
    if (std::abs(sum[i]) <= kCancels * (std::abs(before) + terms[i])) sum[i] = 0;
  }
}

std::string DescribeAsymmetry(const Eigen::MatrixXd& mass, const MechanicalLayout& layout) {
  const auto name = [&](Eigen::Index i) {
    return layout.coordinate_names.empty() ? "coordinate " + std::to_string(i) : layout.coordinate_names[i];
  };
  const double rounding = kSymmetric * mass.cwiseAbs().maxCoeff();
  for (Eigen::Index i = 0; i < mass.rows(); ++i) {
    for (Eigen::Index j = 0; j < i; ++j) {
      if (!(std::abs(mass(i, j) - mass(j, i)) > rounding)) continue;
      return "mass: found " + ToText(mass(j, i), 6) + " and " + ToText(mass(i, j), 6) + " of " + name(j) + " and " +
             name(i) + ", expected a symmetric matrix";
    }
  }
  return "";
}

void MassMatrix::Factorize(const Eigen::MatrixXd& mass) {
  is_diagonal_ = mass.isDiagonal(0);
  if (is_diagonal_) {
    roots_ = mass.diagonal().cwiseSqrt();
  } else {
    cholesky_.compute(mass);
  }
}

MechanicalEquations::MechanicalEquations(const MechanicalFunctions& functions)
    : f_(functions),
      n_(functions.layout().num_coordinates),
      num_u_(functions.layout().num_controls),
      num_p_(functions.layout().num_parameters),
      all_(n_ + num_p_) {
  std::iota(all_.begin(), all_.end(), 0);
}

Block MechanicalEquations::Directions(const Jets& jets) {
  Block block(static_cast<Eigen::Index>(jets.size()), kWidth);
  for (std::size_t i = 0; i < jets.size(); ++i) block.row(static_cast<Eigen::Index>(i)) = jets[i].v.transpose();
  return block;
}

std::vector<MechanicalEquations::Row> MechanicalEquations::RowsOf(const std::vector<ClosedContact>& closed) {
  std::vector<Row> rows;
  for (const ClosedContact& contact : closed) {
    if (contact.status != 'S') rows.push_back({contact.contact, false});
  }
  for (const ClosedContact& contact : closed) {
    if (contact.status == 's' || contact.status == 'S') rows.push_back({contact.contact, true});
  }
  return rows;
}

MechanicalEquations::TimePath<Jet> MechanicalEquations::Still(const Seeds& seeds) const {
  return {Constant(n_, seeds.q.data()), Constant(num_p_, seeds.p.data())};
}

// Derivatives that are not numbers reach all that depends on them, whatever the values are.
bool MechanicalEquations::MassVaries(const Point& at) const {
  if (mass_varies_) return true;
  Jets q(at.q, at.q + n_), p(at.p, at.p + num_p_), mass(static_cast<std::size_t>(n_) * n_);
  for (Jet& jet : q) jet.v[0] = std::numeric_limits<double>::quiet_NaN();
  for (Jet& jet : p) jet.v[0] = std::numeric_limits<double>::quiet_NaN();
  f_.Mass(q.data(), p.data(), mass.data());
  const bool varies = std::ranges::any_of(mass, [](const Jet& entry) { return std::isnan(entry.v[0]); });
  if (varies) mass_varies_ = true;
  return varies;
}

std::vector<int> MechanicalEquations::ReadsOf(int contact, const Point& at) const {
  Jets q(at.q, at.q + n_), p(at.p, at.p + num_p_), row(n_);
  const auto jet = [&](int i) -> Jet& { return i < n_ ? q[i] : p[i - n_]; };
  const std::span<const int> coordinates = CoordinatesOf(contact);
  std::vector<int> reads, inputs(coordinates.begin(), coordinates.end());
  for (int i = 0; i < num_p_; ++i) inputs.push_back(n_ + i);
  for (std::size_t first = 0; first < inputs.size(); first += kWidth) {
    const int width = static_cast<int>(std::min<std::size_t>(kWidth, inputs.size() - first));
    const int* of_pass = &inputs[first];
    for (int j = 0; j < width; ++j) jet(of_pass[j]).v[j] = std::numeric_limits<double>::quiet_NaN();
    Jet sum = f_.Distance(contact, q.data(), p.data());
    if (f_.layout().has_friction[contact] != 0 && f_.has_rows()) {
      f_.SlideRow(contact, q.data(), p.data(), row.data());
      sum = std::accumulate(row.begin(), row.end(), sum);
    } else if (f_.layout().has_friction[contact] != 0) {
      sum += f_.Slide(contact, q.data(), p.data());
    }
    for (int j = 0; j < width; ++j) {
      if (std::isnan(sum.v[j])) reads.push_back(of_pass[j]);
      jet(of_pass[j]).v[j] = 0;
    }
  }
  return reads;
}

bool MechanicalEquations::Vary(std::span<const int> reads, const Seeds& seeds) const {
  return std::ranges::any_of(reads,
                             [&](int i) { return ((i < n_ ? seeds.q[i] : seeds.p[i - n_]).v.array() != 0).any(); });
}

void MechanicalEquations::RowOf(const Row& row, const Seeds& seeds, std::span<const int> reads, TimePath<Jet>* still,
                                Jet* out) const {
  if (row.tangential && f_.has_rows()) return f_.SlideRow(row.contact, seeds.q.data(), seeds.p.data(), out);
  std::fill_n(out, n_, Jet(0.0));
  for (const int j : reads) {
    if (j >= n_) break;
    still->q[j].rate = Jet(1.0);
    out[j] = row.tangential ? f_.Slide(row.contact, still->q.data(), still->p.data()).rate
                            : f_.Distance(row.contact, still->q.data(), still->p.data()).rate;
    still->q[j].rate = Jet(0.0);
  }
}

std::span<const int> MechanicalEquations::CoordinatesOf(int contact) const {
  const std::vector<std::vector<int>>& given = f_.layout().contact_coordinates;
  return given.empty() ? std::span(all_).first(n_) : std::span(given[contact]);
}

template <typename Use>
void MechanicalEquations::ForEachPass(int contact, Jets* q, const Use& use) const {
  const std::span<const int> all = CoordinatesOf(contact);
  for (std::size_t first = 0; first < all.size(); first += kWidth) {
    const std::span<const int> seeded = all.subspan(first, std::min<std::size_t>(kWidth, all.size() - first));
    for (std::size_t j = 0; j < seeded.size(); ++j) (*q)[seeded[j]].v[static_cast<int>(j)] = 1;
    use(seeded);
    for (std::size_t j = 0; j < seeded.size(); ++j) (*q)[seeded[j]].v[static_cast<int>(j)] = 0;
  }
}

Eigen::MatrixXd MechanicalEquations::RowsAt(const std::vector<Row>& rows, const Point& at) const {
  const auto r = static_cast<Eigen::Index>(rows.size());
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(r, n_);
  Eigen::RowVectorXd entries(n_);
  Jets q(at.q, at.q + n_);
  const Jets p(at.p, at.p + num_p_);
  for (Eigen::Index i = 0; i < r; ++i) {
    const Row& row = rows[i];
    if (row.tangential && f_.has_rows()) {
      f_.SlideRow(row.contact, at.q, at.p, entries.data());
      out.row(i) = entries;
      continue;
    }
    ForEachPass(row.contact, &q, [&](std::span<const int> seeded) {
      const Jet value =
          row.tangential ? f_.Slide(row.contact, q.data(), p.data()) : f_.Distance(row.contact, q.data(), p.data());
      for (std::size_t j = 0; j < seeded.size(); ++j) out(i, seeded[j]) = value.v[static_cast<int>(j)];
    });
  }
  return out;
}

double MechanicalEquations::GapGradient(int contact, const Point& at, double* by_q, double* by_p) const {
  Jets q(at.q, at.q + n_);
  const Jets known(at.p, at.p + num_p_);
  ForEachPass(contact, &q, [&](std::span<const int> seeded) {
    const Jet value = f_.Gap(contact, q.data(), known.data());
    for (std::size_t j = 0; j < seeded.size(); ++j) by_q[seeded[j]] = value.v[static_cast<int>(j)];
  });
  for (int first = 0; by_p != nullptr && first < num_p_; first += kWidth) {
    Jets p = known;
    const int width = std::min(kWidth, num_p_ - first);
    for (int j = 0; j < width; ++j) p[first + j].v[j] = 1;
    const Jet value = f_.Gap(contact, q.data(), p.data());
    std::copy_n(value.v.data(), width, by_p + first);
  }
  return f_.Gap(contact, at.q, at.p);
}

MechanicalEquations::TimePath<double> MechanicalEquations::PathAlong(const double* q, const double* v,
                                                                     const double* p) const {
  return {Path<double>(n_, q, v, nullptr), Constant(num_p_, p)};
}

double MechanicalEquations::GapScale(int contact, const Point& at) const {
  return RowAt({contact, false}, at).cwiseAbs().dot(Eigen::Map<const Eigen::RowVectorXd>(at.q, n_).cwiseAbs());
}

// A row along a path: value: not used; rate: the velocity along the row; second: the acceleration.
template <typename S>
TimeJet<S> MechanicalEquations::RowDerivatives(const Row& row, const TimePath<S>& path, const S* v, const S* a) const {
  const TimeJet<S>*q = path.q.data(), *p = path.p.data();
  if (!row.tangential) return f_.Distance(row.contact, q, p);
  if (!f_.has_rows()) return f_.Slide(row.contact, q, p);
  std::vector<TimeJet<S>> entries(n_);
  f_.SlideRow(row.contact, q, p, entries.data());
  TimeJet<S> along(0.0);
  for (int j = 0; j < n_; ++j) {
    along.rate += entries[j].value * v[j];
    along.second += entries[j].rate * v[j];
    if (a != nullptr) along.second += entries[j].value * a[j];
  }
  return along;
}

double MechanicalEquations::RateAlong(const Row& row, const double* q, const double* v, const double* p) const {
  return RowDerivatives<double>(row, PathAlong(q, v, p), v, nullptr).rate;
}
double MechanicalEquations::SecondAlong(const Row& row, const double* q, const double* v, const double* a,
                                        const double* p) const {
  return RowDerivatives<double>(row, {Path(n_, q, v, a), Constant(num_p_, p)}, v, a).second;
}
Jet MechanicalEquations::RateAlong(const Row& row, const Jet* q, const Jet* v, const Jet* p) const {
  return RowDerivatives<Jet>(row, {Path<Jet>(n_, q, v, nullptr), Constant(num_p_, p)}, v, nullptr).rate;
}

MechanicalEquations::System MechanicalEquations::Assemble(const std::vector<ClosedContact>& closed, const Point& at,
                                                          bool for_derivatives) const {
  if (closed.size() < kManyContacts) return NewSystem(closed, at, for_derivatives);
  std::vector<double> q_p(at.q, at.q + n_);
  q_p.insert(q_p.end(), at.p, at.p + num_p_);
  {
    const std::lock_guard lock(mutex_);
    for (const Kept& kept : kept_) {
      if (kept.for_derivatives == for_derivatives && kept.q_p == q_p && kept.closed == closed) return kept.system;
    }
  }
  System system = NewSystem(closed, at, for_derivatives);
  const std::lock_guard lock(mutex_);
  kept_.push_front({closed, std::move(q_p), for_derivatives, system});
  if (kept_.size() > kMostKept) kept_.pop_back();
  return system;
}

MechanicalEquations::System MechanicalEquations::NewSystem(const std::vector<ClosedContact>& closed, const Point& at,
                                                           bool for_derivatives) const {
  System system;
  Eigen::MatrixXd mass(n_, n_);
  f_.Mass(at.q, at.p, mass.data());  // symmetric: the order of rows and columns does not matter
  system.mass.Factorize(mass);
  if (for_derivatives) system.mass_varies = MassVaries(at);
  system.rows = RowsOf(closed);
  const auto r = static_cast<Eigen::Index>(system.rows.size());
  if (r == 0) return system;
  system.G = RowsAt(system.rows, at);
  system.F = system.G.transpose();
  Eigen::Index column = 0;  // of the normals, which come first
  for (const ClosedContact& contact : closed) {
    if (const int sign = SlidingSign(contact.status); sign != 0) {
      system.F.col(column) -=
          f_.Friction(contact.contact, at.p) * sign * RowAt({contact.contact, true}, at).transpose();
    }
    if (contact.status != 'S') ++column;
  }
  system.mobile_F = system.mass.Solve(system.F);
  system.contact.emplace(Multiply(system.G, system.mobile_F), kDependentRow);
  if (!for_derivatives) return system;
  system.reads.resize(f_.layout().num_contacts);
  for (const ClosedContact& contact : closed) system.reads[contact.contact] = ReadsOf(contact.contact, at);
  return system;
}

Eigen::VectorXd MechanicalEquations::Force(const Point& at) const {
  Eigen::VectorXd h(n_);
  f_.Force(at.t, at.q, at.v, at.u, at.p, h.data());
  return h;
}

void MechanicalEquations::Accelerate(const System& system, const Point& at, Eigen::VectorXd* a, Eigen::VectorXd* force,
                                     Eigen::VectorXd* terms) const {
  *a = system.mass.Solve(Force(at));
  const auto r = static_cast<Eigen::Index>(system.rows.size());
  force->resize(r);
  if (r == 0) return;
  Eigen::VectorXd right(r);
  const TimePath<double> path{Path(n_, at.q, at.v, static_cast<const double*>(a->data())), Constant(num_p_, at.p)};
  for (Eigen::Index i = 0; i < r; ++i) right[i] = -RowDerivatives<double>(system.rows[i], path, at.v, a->data()).second;
  system.contact->Solve(right, *force);
  if (terms != nullptr) *terms = system.G.cwiseAbs() * a->cwiseAbs();
  AddChange(system.mobile_F * *force, system.mobile_F.cwiseAbs() * force->cwiseAbs(), *a);
}

std::vector<int> MechanicalEquations::Columns(bool by_parameters, bool with_control) const {
  std::vector<int> columns;
  for (int i = 0; i < num_columns(with_control); ++i) {
    const bool of_parameter = i > 2 * n_ && i <= 2 * n_ + num_p_;
    if (by_parameters || !of_parameter) columns.push_back(i);
  }
  return columns;
}

MechanicalEquations::Seeds MechanicalEquations::UnseededPass(const Point& at) const {
  return {
      Jets(at.q, at.q + n_), Jets(at.v, at.v + n_), Jets(at.p, at.p + num_p_), Jets(at.u, at.u + num_u_), Jet(at.t)};
}

std::vector<MechanicalEquations::Seeds> MechanicalEquations::SeedColumns(const Point& at,
                                                                         std::span<const int> columns) const {
  std::vector<Seeds> passes;
  for (std::size_t first = 0; first < columns.size(); first += kWidth) {
    Seeds& seeds = passes.emplace_back(UnseededPass(at));
    const auto jet = [&](int column) -> Jet& {
      if (column < n_) return seeds.q[column];
      if (column < 2 * n_) return seeds.v[column - n_];
      if (column == 2 * n_) return seeds.t;
      column -= 2 * n_ + 1;
      return column < num_p_ ? seeds.p[column] : seeds.u[column - num_p_];
    };
    const auto width = static_cast<int>(std::min<std::size_t>(kWidth, columns.size() - first));
    for (int j = 0; j < width; ++j) jet(columns[first + j]).v[j] = 1;
  }
  return passes;
}

MechanicalEquations::Seeds MechanicalEquations::SeedDirection(const Point& at, const double* xdot) const {
  Seeds seeds;
  for (int i = 0; i < n_; ++i) seeds.q.emplace_back(at.q[i]).v[0] = xdot[i];
  for (int i = 0; i < n_; ++i) seeds.v.emplace_back(at.v[i]).v[0] = xdot[n_ + i];
  seeds.t = Jet(at.t);
  seeds.t.v[0] = 1;
  seeds.p = Jets(at.p, at.p + num_p_);
  seeds.u = Jets(at.u, at.u + num_u_);
  return seeds;
}

template <typename S>
void MechanicalEquations::AddMomentum(const System& system, const Seeds& seeds, const S* a, Jet* momentum) const {
  if (std::is_same_v<S, double> && !(system.mass_varies && Vary(all_, seeds))) return;
  Jets mass(static_cast<std::size_t>(n_) * n_);
  f_.Mass(seeds.q.data(), seeds.p.data(), mass.data());
  for (int i = 0; i < n_; ++i) {
    for (int j = 0; j < n_; ++j) momentum[i] += mass[i * n_ + j] * a[j];
  }
}

void MechanicalEquations::SubtractContact(int contact, const Jet& normal, int sliding, const Jet* tangential,
                                          const Seeds& seeds, std::span<const int> reads, TimePath<Jet>* still,
                                          Jet* residual) const {
  const bool vary = Vary(reads, seeds);
  Jets row(n_);
  const auto subtract = [&](const Jet& force, bool along_tangent) {
    if (!vary && (force.v.array() == 0).all()) return;
    RowOf({contact, along_tangent}, seeds, reads, still, row.data());
    for (int j = 0; j < n_; ++j) residual[j] -= force * row[j];
  };
  subtract(normal, false);
  if (tangential != nullptr) {
    subtract(*tangential, true);
  } else if (sliding != 0) {
    subtract(static_cast<double>(-sliding) * normal * f_.Friction(contact, seeds.p.data()), true);
  }
}

void MechanicalEquations::SubtractForces(const System& system, const std::vector<ClosedContact>& closed,
                                         const Seeds& seeds, const Eigen::VectorXd& force, Jet* residual) const {
  if (closed.empty()) return;
  TimePath<Jet> still = Still(seeds);
  Eigen::Index normals = 0;
  for (const ClosedContact& contact : closed) normals += contact.status != 'S' ? 1 : 0;
  Eigen::Index normal = 0, sticking = normals;
  for (const ClosedContact& contact : closed) {
    const Jet f_n(contact.status != 'S' ? force[normal++] : 0.0);
    const bool sticks = contact.status == 's' || contact.status == 'S';
    const Jet f_t(sticks ? force[sticking++] : 0.0);
    SubtractContact(contact.contact,
                    f_n,
                    SlidingSign(contact.status),
                    sticks ? &f_t : nullptr,
                    seeds,
                    system.reads[contact.contact],
                    &still,
                    residual);
  }
}

// Solves M da - F df = -momentum and G da = -rows for the derivatives of accelerations and forces.
MechanicalEquations::Derivative MechanicalEquations::Solve(const System& system, const Jets& momentum,
                                                           const Jets& rows) const {
  Derivative out;
  out.motion = system.mass.Solve(-Directions(momentum));
  out.force.resize(static_cast<Eigen::Index>(rows.size()), kWidth);
  if (rows.empty()) return out;
  out.force = -Directions(rows) - system.G * out.motion;
  SolveColumns(*system.contact, &out.force);
  out.motion += system.mobile_F * out.force;
  return out;
}

MechanicalEquations::Derivative MechanicalEquations::AccelerationDerivative(const System& system,
                                                                            const std::vector<ClosedContact>& closed,
                                                                            const Seeds& seeds,
                                                                            const Eigen::VectorXd& a,
                                                                            const Eigen::VectorXd& force) const {
  const MechanicalPoint<Jet> at = seeds.point();
  Jets momentum(n_), rows;
  f_.Force(at.t, at.q, at.v, at.u, at.p, momentum.data());
  for (Jet& entry : momentum) entry = -entry;
  AddMomentum(system, seeds, a.data(), momentum.data());
  SubtractForces(system, closed, seeds, force, momentum.data());
  if (!system.rows.empty()) {
    const Jets fixed(a.data(), a.data() + n_);
    const TimePath<Jet> path{Path(n_, at.q, at.v, fixed.data()), Constant(num_p_, at.p)};
    for (const Row& row : system.rows) rows.push_back(RowDerivatives<Jet>(row, path, at.v, fixed.data()).second);
  }
  return Solve(system, momentum, rows);
}

MechanicalEquations::Derivative MechanicalEquations::ImpactDerivative(const System& system,
                                                                      const std::vector<ClosedContact>& closed,
                                                                      const Seeds& seeds, const Eigen::VectorXd& v_plus,
                                                                      const Eigen::VectorXd& force,
                                                                      const std::vector<char>& has_restitution,
                                                                      const std::vector<KnownImpulse>& known) const {
  const MechanicalPoint<Jet> at = seeds.point();
  Jets momentum(n_), change(n_), rows;
  for (int i = 0; i < n_; ++i) change[i] = v_plus[i] - at.v[i];
  AddMomentum(system, seeds, change.data(), momentum.data());
  SubtractForces(system, closed, seeds, force, momentum.data());
  if (!known.empty()) {
    TimePath<Jet> still = Still(seeds);
    for (const KnownImpulse& impulse : known) {
      SubtractContact(impulse.contact, impulse.normal, impulse.sliding, nullptr, seeds, all_, &still, momentum.data());
    }
  }
  const Jets after(v_plus.data(), v_plus.data() + n_);
  for (std::size_t i = 0; i < system.rows.size(); ++i) {
    const Row& row = system.rows[i];
    Jet rate = RateAlong(row, at.q, after.data(), at.p);
    if (!row.tangential && has_restitution[i] != 0) {
      rate += f_.Restitution(row.contact, at.p) * RateAlong(row, at.q, at.v, at.p);
    }
    rows.push_back(rate);
  }
  return Solve(system, momentum, rows);
}

void MechanicalEquations::CorrectSeeds(const System& system, const std::vector<ClosedContact>& closed,
                                       const Eigen::VectorXd& force, const Jets& rows, Jets* moved,
                                       const Seeds& seeds) const {
  const bool constant = std::ranges::all_of(rows, [](const Jet& row) { return (row.v.array() == 0).all(); });
  if (constant && !Vary(all_, seeds)) return;
  const Eigen::VectorXd change = system.mobile_F * force;
  Jets momentum(n_), closing = rows;
  AddMomentum(system, seeds, change.data(), momentum.data());
  SubtractForces(system, closed, seeds, force, momentum.data());
  const Jets along(change.data(), change.data() + n_);
  for (std::size_t i = 0; i < closing.size(); ++i) {
    const Row& row = system.rows[i];
    if (!Vary(system.reads[row.contact], seeds)) continue;
    closing[i] += RateAlong(row, seeds.q.data(), along.data(), seeds.p.data());
  }
  const Derivative by = Solve(system, momentum, closing);
  for (int i = 0; i < n_; ++i) (*moved)[i].v += by.motion.row(i).transpose();
}

void MechanicalEquations::Project(const std::vector<ClosedContact>& closed, double* q, double* v, const double* p,
                                  std::span<Seeds> passes) const {
  std::vector<ClosedContact> normals = closed;
  for (ClosedContact& contact : normals) contact.status = 'n';
  const auto k = static_cast<Eigen::Index>(closed.size());
  const Point at{0, q, v, nullptr, p};
  Eigen::VectorXd gaps(k);
  double last = std::numeric_limits<double>::infinity();
  for (int i = 0; i <= kMostCorrections; ++i) {
    for (Eigen::Index c = 0; c < k; ++c) gaps[c] = -f_.Distance(closed[c].contact, q, p);
    const double size = gaps.cwiseAbs().maxCoeff();
    const bool ends = size == 0 || !(size < 0.5 * last) || i == kMostCorrections;
    if (ends && passes.empty()) break;
    last = size;
    const bool correct = !passes.empty() && (ends || size > kRounding * GapScale(closed[0].contact, at));
    const System system = Assemble(normals, at, correct);
    if (ends) gaps.setZero();  // what is left of them is rounding
    if (!ends) system.contact->Solve(gaps, gaps);
    for (Seeds& seeds : passes) {
      if (!correct) break;
      Jets rows;
      for (const ClosedContact& contact : closed) {
        rows.push_back(f_.Distance(contact.contact, seeds.q.data(), seeds.p.data()));
      }
      CorrectSeeds(system, normals, gaps, rows, &seeds.q, seeds);
    }
    if (ends) break;
    Eigen::Map<Eigen::VectorXd>(q, n_) += system.mobile_F * gaps;
    for (Seeds& seeds : passes) {
      for (int j = 0; j < n_; ++j) seeds.q[j].a = q[j];
    }
  }
  std::vector<ClosedContact> held = closed;
  for (ClosedContact& contact : held) {
    if (contact.status != 's') contact.status = 'n';
  }
  const System system = Assemble(held, at, !passes.empty());
  Eigen::Map<Eigen::VectorXd> velocity(v, n_);
  Eigen::VectorXd rates = -(system.G * velocity);
  system.contact->Solve(rates, rates);
  AddChange(system.mobile_F * rates, system.mobile_F.cwiseAbs() * rates.cwiseAbs(), velocity);
  for (Seeds& seeds : passes) {
    Jets rows;
    for (const Row& row : system.rows) {
      rows.push_back(RateAlong(row, seeds.q.data(), seeds.v.data(), seeds.p.data()));
    }
    CorrectSeeds(system, held, rates, rows, &seeds.v, seeds);
    for (int j = 0; j < n_; ++j) seeds.v[j].a = v[j];
  }
}

// With x = M^-1 N^T and y = M^-1 F held, N y + x^T F - x^T M y has the value and the derivative of N M^-1 F.
Jet MechanicalEquations::Pressability(const ClosedContact& contact, const Seeds& seeds, const Point& at) const {
  const System system = Assemble({contact}, at);
  const Eigen::VectorXd x = system.mass.Solve(system.G.transpose()), y = system.mobile_F;
  Jets normal(n_), tangent(n_), mass(static_cast<std::size_t>(n_) * n_);
  TimePath<Jet> still = Still(seeds);
  RowOf({contact.contact, false}, seeds, all_, &still, normal.data());
  RowOf({contact.contact, true}, seeds, all_, &still, tangent.data());
  f_.Mass(seeds.q.data(), seeds.p.data(), mass.data());
  const Jet slip = f_.Friction(contact.contact, seeds.p.data()) * static_cast<double>(SlidingSign(contact.status));
  Jet sum(0.0);
  for (int i = 0; i < n_; ++i) {
    sum += normal[i] * (y[i] + x[i]) - x[i] * slip * tangent[i];
    for (int j = 0; j < n_; ++j) sum -= x[i] * y[j] * mass[i * n_ + j];
  }
  return sum;
}

}  // namespace saltus
