#include "contact/solvers/resting_forces.h"

#include <Eigen/Core>
#include <algorithm>
#include <bit>
#include <cmath>
#include <memory_resource>
#include <optional>
#include <vector>

#include "base/linear_algebra.h"
#include "base/scratch_memory.h"
#include "contact/solvers/complementarity.h"
#include "contact/solvers/contact_system.h"
#include "contact/thresholds.h"

namespace saltus {
namespace {

using namespace internal;  // NOLINT: the thresholds

// Accelerations of the discs; `turning` is empty if none spins.
struct Accelerations {
  std::span<Vec2d> linear;    // m/s^2
  std::span<double> turning;  // rad/s^2
};
// A copy of the accelerations that owns its memory.
struct KeptAccelerations {
  KeptAccelerations(const Accelerations& given, std::pmr::memory_resource* memory)
      : linear(given.linear.begin(), given.linear.end(), memory),
        turning(given.turning.begin(), given.turning.end(), memory) {}
  KeptAccelerations(const KeptAccelerations& other, std::pmr::memory_resource* memory)
      : linear(other.linear, memory), turning(other.turning, memory) {}
  Accelerations view() { return {linear, turning}; }
  void CopyTo(const Accelerations& to) const {
    std::copy(linear.begin(), linear.end(), to.linear.begin());
    std::copy(turning.begin(), turning.end(), to.turning.begin());
  }
  std::pmr::vector<Vec2d> linear;
  std::pmr::vector<double> turning;
};

// Returns the relative acceleration at the points of contact, m/s^2.
Vec2d RelativeAcceleration(const RestingContact& c, const Accelerations& of) {
  Vec2d relative = of.linear[c.a];
  if (c.b >= 0) relative -= of.linear[c.b];
  if (!of.turning.empty()) relative -= RimAcceleration(c, of.turning) * Perpendicular(c.normal);
  return relative;
}

// Adds the angular accelerations by a force along the tangent, N.
void Turn(const RestingContact& c, double tangential_force, std::span<double> turning) {
  turning[c.a] -= c.turns_a.radius * c.turns_a.inverse_inertia * tangential_force;
  if (c.b >= 0) turning[c.b] -= c.turns_b.radius * c.turns_b.inverse_inertia * tangential_force;
}

// The hypothesis of what a contact does: it is open, slides with its friction at the bound - or +, or sticks.
enum class Mode : char { kOpen, kLeft, kRight, kStick };
using Modes = std::pmr::vector<Mode>;

// The linear systems of the same rows: dense if small or if discs spin, else sparse.
class RowSolver {
 public:
  RowSolver(std::span<const ContactRow> rows, std::span<const double> inverse_mass,
            std::span<const double> turn_mobility, ContactSystem::Cache* cache) {
    const int n = static_cast<int>(rows.size());
    if (n > kMostDenseRows && turn_mobility.empty()) {
      system_.emplace(rows, inverse_mass, /*like=*/nullptr, cache);
      return;
    }
    const auto decompose = [&](auto matrix) {
      for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) matrix(i, j) = Coupling(rows[i], rows[j], inverse_mass, turn_mobility);
      }
      dense_.emplace(matrix, kDependentRows);
    };
    if (n <= kMostDenseRows) {
      decompose(SmallMatrix(n, n));
    } else {
      decompose(Eigen::MatrixXd(n, n));
    }
  }
  // Overwrites the right side with the solution. With `iteration_limited`, returns false where that would take long.
  bool Solve(bool iteration_limited, std::span<double> x) const {
    if (system_ && iteration_limited) return system_->SolveOnlySparse(x);
    if (system_) {
      system_->Solve(x);
      return true;
    }
    Eigen::Map<Eigen::VectorXd> map(x.data(), static_cast<Eigen::Index>(x.size()));
    dense_->Solve(map, map);
    return true;
  }

 private:
  // A matrix whose entries are stored within the object, not on the heap.
  using SmallMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMostDenseRows, kMostDenseRows>;

  std::optional<LeastNormSolver> dense_;
  std::optional<ContactSystem> system_;
};

class ForceSolver {
 public:
  ForceSolver(std::span<const double> inverse_mass, const Accelerations& of, std::span<RestingContact> contacts,
              bool iteration_limited, ContactSystem::Cache* cache)
      : inverse_mass_(inverse_mass),
        of_(of),
        contacts_(contacts),
        iteration_limited_(iteration_limited),
        cache_(cache),
        given_(of, memory_.get()) {}

  RestingForces Run() {
    double scale = 0;  // m/s^2, of the given accelerations
    for (RestingContact& c : contacts_) {
      c.normal_force = c.tangential_force = 0;
      if (c.tangential_mass == 0) c.tangential_mass = c.mass;
      const double given_here = RelativeAcceleration(c, of_).norm();
      if (!std::isfinite(given_here) || !std::isfinite(c.turning)) return RestingForces::kNotFound;
      scale = std::max({scale, given_here, std::abs(c.turning)});
    }
    LocalMemory memory;
    Modes modes(contacts_.size(), memory.get());
    // Sweeps carry a force from one contact to the next: of many contacts all are taken as active first.
    const bool many = contacts_.size() > kMostDenseRows;
    if (many) {
      std::ranges::transform(contacts_, modes.begin(), [&](const RestingContact& c) { return ActiveMode(c); });
      const int pivots = iteration_limited_ ? kForcesLimitedPivots : kForcesFirstPivots;
      if (SolveByPivoting(kForcesDirect * scale, pivots, modes, many, iteration_limited_)) return RestingForces::kFound;
      if (iteration_limited_) return RestingForces::kNotFound;
    }
    int direct = kForcesFirstSweeps;
    for (int sweep = 1; sweep <= kForcesMostSweeps; ++sweep) {
      const double change =
          GaussSeidelSweep(std::ssize(contacts_), [&](std::ptrdiff_t k) { return Relax(&contacts_[k]); });
      if (change <= kForcesConverged * scale) return RestingForces::kFound;
      if (change > kForcesJammed * scale) return RestingForces::kJammed;
      if (sweep < direct) continue;
      direct *= 2;
      std::ranges::transform(contacts_, modes.begin(), [&](const RestingContact& c) { return ModeOf(c); });
      if (SolveInModes(kForcesDirect * scale, modes, contacts_)) return RestingForces::kFound;
      if (sweep != kForcesLongSweeps) continue;
      const bool few = NumHypotheses() <= kForcesMostHypotheses;
      for (const double exact : {kForcesDirect, kForcesNearly}) {
        if (SolveByPivoting(exact * scale, kForcesMostPivots, modes, many) || (few && TryAllModes(exact * scale))) {
          return RestingForces::kFound;
        }
      }
      if (!few && SolveAsComplementarity(kForcesDirect * scale)) return RestingForces::kFound;
      if (!few) continue;
      const bool slide = std::ranges::any_of(contacts_, [](const RestingContact& c) { return c.sliding != 0; });
      return slide ? RestingForces::kJammed : RestingForces::kNotFound;
    }
    return RestingForces::kNotFound;
  }

 private:
  struct WrongMode {
    int contact;
    Mode better;
  };

  // Solves one contact with all others held. Returns the change of its force over the effective mass, m/s^2. Written in
  // scalars: most of the time is spent here.
  double Relax(RestingContact* c) {
    const double nx = c->normal[0], ny = c->normal[1];
    double* a = of_.linear[c->a].data();
    double* b = c->b < 0 ? nullptr : of_.linear[c->b].data();
    const double x = b ? a[0] - b[0] : a[0], y = b ? a[1] - b[1] : a[1];
    const double normal_force = std::max(0.0, c->normal_force - c->mass * (nx * x + ny * y + c->turning));
    const double bound = c->friction * normal_force;
    const double along = nx * y - ny * x - RimAcceleration(*c, of_.turning);
    const double tangential_force = c->sliding == 0
                                        ? std::clamp(c->tangential_force - c->tangential_mass * along, -bound, bound)
                                        : -c->sliding * bound;
    const double dn = normal_force - c->normal_force, dt = tangential_force - c->tangential_force;
    c->normal_force = normal_force;
    c->tangential_force = tangential_force;
    const double fx = dn * nx - dt * ny, fy = dn * ny + dt * nx;
    a[0] += inverse_mass_[c->a] * fx;
    a[1] += inverse_mass_[c->a] * fy;
    if (b) {
      b[0] -= inverse_mass_[c->b] * fx;
      b[1] -= inverse_mass_[c->b] * fy;
    }
    if (!of_.turning.empty()) Turn(*c, dt, of_.turning);
    return (std::abs(dn) + std::abs(dt)) / c->mass;
  }

  // Adds the accelerations by the forces of contacts.
  void Accelerate(std::span<const RestingContact> contacts, const Accelerations& of) const {
    for (const RestingContact& c : contacts) {
      const Vec2d force = c.normal_force * c.normal + c.tangential_force * Perpendicular(c.normal);
      of.linear[c.a] += inverse_mass_[c.a] * force;
      if (c.b >= 0) of.linear[c.b] -= inverse_mass_[c.b] * force;
      if (!of.turning.empty()) Turn(c, c.tangential_force, of.turning);
    }
  }

  // Returns the mode of an active contact before its forces are known.
  Mode ActiveMode(const RestingContact& c) const {
    return c.sliding > 0 ? Mode::kLeft : c.sliding < 0 || c.friction == 0 ? Mode::kRight : Mode::kStick;
  }
  // Returns the mode that follows from the forces of a contact.
  Mode ModeOf(const RestingContact& c) const {
    if (c.normal_force <= 0) return Mode::kOpen;
    if (c.sliding != 0) return c.sliding > 0 ? Mode::kLeft : Mode::kRight;
    if (std::abs(c.tangential_force) < c.friction * c.normal_force) return Mode::kStick;
    return c.tangential_force < 0 ? Mode::kLeft : Mode::kRight;
  }
  // Returns the mode after `mode` in the order in which all are tried; kOpen after the last.
  Mode NextMode(const RestingContact& c, Mode mode) const {
    if (mode == Mode::kStick) return Mode::kOpen;
    if (c.friction > 0 && c.sliding == 0) return static_cast<Mode>(static_cast<char>(mode) + 1);
    return mode != Mode::kOpen ? Mode::kOpen : c.sliding > 0 ? Mode::kLeft : Mode::kRight;
  }
  // Returns the mode that a contact changes to if its forces violate the conditions by more than `allowed`, m/s^2;
  // `relative` is its acceleration under the forces.
  std::optional<Mode> BetterMode(double allowed, const RestingContact& c, const Vec2d& relative) const {
    const double bound = c.friction * c.normal_force, slack = allowed * c.mass;
    const double apart = Dot(c.normal, relative) + c.turning, along = Dot(Perpendicular(c.normal), relative);
    if (c.normal_force < 0) return Mode::kOpen;
    if (apart < -allowed) return ActiveMode(c);
    if (c.sliding != 0 || c.normal_force == 0) return std::nullopt;
    if (std::abs(c.tangential_force) > bound + slack) return c.tangential_force < 0 ? Mode::kLeft : Mode::kRight;
    if (along * c.tangential_force > allowed * bound) return Mode::kStick;
    return std::nullopt;
  }

  // Returns r^2 / I of each disc, 1/kg; empty if none spins.
  std::pmr::vector<double> TurnMobility(std::pmr::memory_resource* memory) const {
    std::pmr::vector<double> mobility(of_.turning.empty() ? 0 : inverse_mass_.size(), 0.0, memory);
    const auto set = [&](int disc, const RestingContact::Turns& turns) {
      if (disc >= 0) mobility[disc] = turns.radius * turns.radius * turns.inverse_inertia;
    };
    for (const RestingContact& c : contacts_) {
      if (mobility.empty()) break;
      set(c.a, c.turns_a);
      set(c.b, c.turns_b);
    }
    return mobility;
  }

  // Solves the linear system of the modes, from the forces of `contacts` to the nearest that solve it. Returns false,
  // and changes nothing, if these violate the conditions; `wrong`, if given, gets the contacts that do, or none if the
  // system has no solution or, with `iteration_limited`, if finding that out would take long.
  bool SolveInModes(double allowed, std::span<const Mode> modes, std::span<RestingContact> contacts,
                    std::pmr::vector<WrongMode>* wrong = nullptr, bool iteration_limited = false) {
    if (wrong != nullptr) wrong->clear();
    LocalMemory memory;
    std::pmr::vector<ContactRow> rows(memory.get());
    std::pmr::vector<int> contact_of(memory.get());  // of each row
    rows.reserve(2 * contacts.size());
    contact_of.reserve(2 * contacts.size());
    for (int k = 0; k < static_cast<int>(contacts.size()); ++k) {
      const RestingContact& c = contacts[k];
      if (modes[k] == Mode::kOpen) continue;
      const Vec2d tangent = Perpendicular(c.normal);
      const auto add = [&](const Vec2d& measured, const Vec2d& push) {
        rows.push_back({c.a, c.b, measured, push, Dot(tangent, measured), Dot(tangent, push)});
        contact_of.push_back(k);
      };
      if (modes[k] == Mode::kStick) {
        add(c.normal, c.normal);
        add(tangent, tangent);
      } else {
        add(c.normal, c.normal + (modes[k] == Mode::kLeft ? -c.friction : c.friction) * tangent);
      }
    }
    const int n = static_cast<int>(rows.size());
    std::pmr::vector<RestingContact> solved(contacts.begin(), contacts.end(), memory.get());
    KeptAccelerations under(given_, memory.get());
    const auto accelerate = [&] {
      under = given_;
      Accelerate(solved, under.view());
    };
    // Returns the acceleration across row i, which must vanish; for a normal it includes the turning of the normal.
    const auto missing = [&](int i) {
      const RestingContact& c = contacts[contact_of[i]];
      const bool tangential = i > 0 && contact_of[i - 1] == contact_of[i];
      return Dot(rows[i].measured, RelativeAcceleration(c, under.view())) + (tangential ? 0.0 : c.turning);
    };
    if (n > 0) {
      const RowSolver solver(rows, inverse_mass_, TurnMobility(memory.get()), cache_);
      std::pmr::vector<double> change(n, memory.get());
      // The second pass is an iterative refinement, which removes the rounding errors of the first.
      for (int pass = 0; pass < 2; ++pass) {
        accelerate();
        for (int i = 0; i < n; ++i) change[i] = -missing(i);
        if (!solver.Solve(iteration_limited, change)) return false;
        for (int i = 0; i < n; ++i) {
          RestingContact& c = solved[contact_of[i]];
          c.normal_force += change[i] * Dot(c.normal, rows[i].push);
          c.tangential_force += change[i] * rows[i].push_along;
        }
      }
    }
    accelerate();
    for (int i = 0; i < n; ++i) {
      if (!(std::abs(missing(i)) <= allowed)) return false;
    }
    bool right = true;
    for (int k = 0; k < static_cast<int>(solved.size()); ++k) {
      const std::optional<Mode> better = BetterMode(allowed, solved[k], RelativeAcceleration(solved[k], under.view()));
      if (!better) continue;
      right = false;
      if (wrong == nullptr) break;
      wrong->push_back({k, *better});
    }
    if (!right) return false;
    std::copy(solved.begin(), solved.end(), contacts.begin());
    under.CopyTo(of_);
    return true;
  }

  static bool HaveSameForces(const RestingContact& c, const RestingContact& d) {
    return c.normal_force == d.normal_force && c.tangential_force == d.tangential_force;
  }

  // Principal pivoting from the given modes: with `in_blocks`, of all wrong contacts at once while these become fewer;
  // else of the first. Returns false if that does not end in `most_pivots`, or cycles.
  bool SolveByPivoting(double allowed, int most_pivots, std::span<const Mode> first_modes, bool in_blocks,
                       bool iteration_limited = false) {
    LocalMemory memory;
    Modes modes(first_modes.begin(), first_modes.end(), memory.get());
    std::pmr::vector<RestingContact> start(contacts_.begin(), contacts_.end(), memory.get());
    std::pmr::vector<WrongMode> wrong(memory.get());
    BlockPivoting blocks;
    // The state at the last single pivot whose number was a power of two: if it comes again, the pivots cycle (Brent).
    Modes earlier_modes(memory.get());
    std::pmr::vector<RestingContact> earlier_start(memory.get());
    for (int pivot = 0; pivot < most_pivots; ++pivot) {
      for (std::size_t k = 0; k < start.size(); ++k) {
        RestingContact& c = start[k];
        if (modes[k] == Mode::kOpen) c.normal_force = c.tangential_force = 0;
        if (modes[k] == Mode::kLeft) c.tangential_force = -c.friction * c.normal_force;
        if (modes[k] == Mode::kRight) c.tangential_force = c.friction * c.normal_force;
      }
      if (SolveInModes(allowed, modes, start, &wrong, iteration_limited)) {
        std::copy(start.begin(), start.end(), contacts_.begin());
        return true;
      }
      if (wrong.empty()) return false;
      if (in_blocks && blocks.ChangesAll(wrong.size())) {
        earlier_modes.clear();
      } else {
        if (modes == earlier_modes && std::ranges::equal(start, earlier_start, HaveSameForces)) return false;
        if (std::has_single_bit(static_cast<unsigned>(pivot))) {
          earlier_modes = modes;
          earlier_start = start;
        }
        wrong.resize(1);
      }
      for (const WrongMode& one : wrong) modes[one.contact] = one.better;
    }
    return false;
  }

  double NumHypotheses() const {
    double number = 1;
    for (const RestingContact& c : contacts_) number *= c.friction > 0 && c.sliding == 0 ? 4 : 2;
    return number;
  }
  // Tries all combinations of modes, each from zero forces.
  bool TryAllModes(double allowed) {
    std::vector<RestingContact> none(contacts_.begin(), contacts_.end());
    for (RestingContact& c : none) c.normal_force = c.tangential_force = 0;
    std::vector<Mode> modes(contacts_.size(), Mode::kOpen);
    for (;;) {
      if (SolveInModes(allowed, modes, none)) {
        std::copy(none.begin(), none.end(), contacts_.begin());
        return true;
      }
      std::size_t k = 0;
      for (; k < modes.size(); ++k) {
        modes[k] = NextMode(contacts_[k], modes[k]);
        if (modes[k] != Mode::kOpen) break;
      }
      if (k == modes.size()) return false;
    }
  }

  // Returns the accelerations by unit forces: rows and columns 2 k and 2 k + 1 are the normal and the tangential part
  // at contact k.
  Eigen::MatrixXd Responses() const {
    const int n = static_cast<int>(contacts_.size());
    Eigen::MatrixXd responses(2 * n, 2 * n);
    for (int column = 0; column < 2 * n; ++column) {
      KeptAccelerations under(of_, std::pmr::new_delete_resource());
      std::ranges::fill(under.linear, Vec2d(0, 0));
      std::ranges::fill(under.turning, 0.0);
      RestingContact unit = contacts_[column / 2];
      unit.normal_force = column % 2 == 0;
      unit.tangential_force = column % 2;
      Accelerate({&unit, 1}, under.view());
      for (int k = 0; k < n; ++k) {
        const Vec2d relative = RelativeAcceleration(contacts_[k], under.view());
        responses(2 * k, column) = Dot(contacts_[k].normal, relative);
        responses(2 * k + 1, column) = Dot(Perpendicular(contacts_[k].normal), relative);
      }
    }
    return responses;
  }

  // Finds forces by Lemke's method, then refines them by pivoting from their modes.
  bool SolveAsComplementarity(double allowed) {
    const int n = static_cast<int>(contacts_.size());
    if (n > kMostComplementaryRows) return false;
    KeptAccelerations start(given_, std::pmr::new_delete_resource());
    Eigen::VectorXd without(2 * n);
    std::vector<int> sliding(n);
    std::vector<double> friction(n);
    for (int k = 0; k < n; ++k) {
      const Vec2d relative = RelativeAcceleration(contacts_[k], start.view());
      without[2 * k] = Dot(contacts_[k].normal, relative) + contacts_[k].turning;
      without[2 * k + 1] = Dot(Perpendicular(contacts_[k].normal), relative);
      sliding[k] = contacts_[k].sliding;
      friction[k] = contacts_[k].friction;
    }
    const std::optional<Eigen::VectorXd> forces = SolveFrictionalLcp(friction, Responses(), without, sliding);
    if (!forces) return false;
    std::vector<Mode> modes(n);
    for (int k = 0; k < n; ++k) {
      RestingContact found = contacts_[k];
      found.normal_force = (*forces)[2 * k];
      found.tangential_force =
          (1 + kForcesNearly) * (*forces)[2 * k + 1];  // at its bound, where it is but for rounding
      modes[k] = ModeOf(found);
    }
    return SolveByPivoting(allowed, kForcesMostPivots, modes, /*in_blocks=*/true);
  }

  const std::span<const double> inverse_mass_;  // per disc
  const Accelerations of_;                      // under the forces of the contacts
  const std::span<RestingContact> contacts_;
  const bool iteration_limited_;
  ContactSystem::Cache* const cache_;
  LocalMemory memory_;
  const KeptAccelerations given_;  // without forces
};

}  // namespace

RestingForces SolveRestingForces(std::span<const double> inverse_mass, std::span<Vec2d> acceleration,
                                 std::span<RestingContact> contacts, std::span<double> turning, bool iteration_limited,
                                 ContactSystem::Cache* cache) {
  return ForceSolver(inverse_mass, {acceleration, turning}, contacts, iteration_limited, cache).Run();
}

}  // namespace saltus
