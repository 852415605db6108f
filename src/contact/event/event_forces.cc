#include "contact/event/event_forces.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <memory_resource>
#include <optional>
#include <vector>

#include "base/local_memory.h"
#include "contact/solvers/force_rows_solver.h"
#include "contact/solvers/frictional_lcp.h"

namespace saltus {
namespace {

constexpr int kMaxSweeps = 20000;
constexpr int kFirstSweeps = 32;   // before the first direct solution
constexpr int kLongSweeps = 1024;  // before all guesses are tried
constexpr int kMostGuesses = 4096;
constexpr int kMostPivots = 1000;
constexpr int kFirstPivots = 12;  // of many contacts, before the first sweep
constexpr int kHastyPivots = 4;
constexpr int kBlockPatience = 3;
constexpr double kConverged = 1e-14;  // of the largest acceleration given
constexpr double kExact = 1e-12;      // likewise, of a direct solution
constexpr double kNearly = 1e-9;      // likewise, where contacts that depend on each other do not quite agree
constexpr double kWedged = 1e9;       // likewise

// Of the discs; `turning` is empty if none spins.
struct Accelerations {
  std::span<Vec2d> linear;    // m/s^2
  std::span<double> turning;  // rad/s^2
};
// The same, with memory of their own.
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

// At the points of contact.
Vec2d RelativeAcceleration(const PressingContact& c, const Accelerations& of) {
  Vec2d relative = of.linear[c.a];
  if (c.b >= 0) relative -= of.linear[c.b];
  if (!of.turning.empty()) relative -= RimAcceleration(c, of.turning) * Perpendicular(c.normal);
  return relative;
}

// What a force along the tangent does to the turning of the discs.
void Turn(const PressingContact& c, double tangential_force, std::span<double> turning) {
  turning[c.a] -= c.turns_a.radius * c.turns_a.inverse_inertia * tangential_force;
  if (c.b >= 0) turning[c.b] -= c.turns_b.radius * c.turns_b.inverse_inertia * tangential_force;
}

// One contact with all others held. Returns the change of force over the effective mass, m/s^2. In plain numbers: this
// is where the time goes.
double Relax(double friction, std::span<const double> inverse_mass, const Accelerations& of, PressingContact* c) {
  const double nx = c->normal[0], ny = c->normal[1];
  double* a = of.linear[c->a].data();
  double* b = c->b < 0 ? nullptr : of.linear[c->b].data();
  const double x = b ? a[0] - b[0] : a[0], y = b ? a[1] - b[1] : a[1];
  const double normal_force = std::max(0.0, c->normal_force - c->mass * (nx * x + ny * y + c->turning));
  const double bound = friction * normal_force;
  const double along = nx * y - ny * x - RimAcceleration(*c, of.turning);
  const double tangential_force = c->sliding == 0
                                      ? std::clamp(c->tangential_force - c->tangential_mass * along, -bound, bound)
                                      : -c->sliding * bound;
  const double dn = normal_force - c->normal_force, dt = tangential_force - c->tangential_force;
  c->normal_force = normal_force;
  c->tangential_force = tangential_force;
  const double fx = dn * nx - dt * ny, fy = dn * ny + dt * nx;
  a[0] += inverse_mass[c->a] * fx;
  a[1] += inverse_mass[c->a] * fy;
  if (b) {
    b[0] -= inverse_mass[c->b] * fx;
    b[1] -= inverse_mass[c->b] * fy;
  }
  if (!of.turning.empty()) Turn(*c, dt, of.turning);
  return (std::abs(dn) + std::abs(dt)) / c->mass;
}

// The accelerations under the forces of the contacts.
void Accelerate(std::span<const double> inverse_mass, std::span<const PressingContact> contacts,
                const Accelerations& of) {
  for (const PressingContact& c : contacts) {
    const Vec2d force = c.normal_force * c.normal + c.tangential_force * Perpendicular(c.normal);
    of.linear[c.a] += inverse_mass[c.a] * force;
    if (c.b >= 0) of.linear[c.b] -= inverse_mass[c.b] * force;
    if (!of.turning.empty()) Turn(c, c.tangential_force, of.turning);
  }
}

// What a contact may be found to do.
enum class Guess : char { kOpen, kLeft, kRight, kStick };  // kLeft, kRight: its friction is at that bound, - or +

// As the forces are now.
Guess GuessOf(double friction, const PressingContact& c) {
  if (c.normal_force <= 0) return Guess::kOpen;
  if (c.sliding != 0) return c.sliding > 0 ? Guess::kLeft : Guess::kRight;
  if (std::abs(c.tangential_force) < friction * c.normal_force) return Guess::kStick;
  return c.tangential_force < 0 ? Guess::kLeft : Guess::kRight;
}

// The guess after this one; kOpen after the last.
Guess NextGuess(double friction, const PressingContact& c, Guess guess) {
  if (guess == Guess::kStick) return Guess::kOpen;
  if (friction > 0 && c.sliding == 0) return static_cast<Guess>(static_cast<char>(guess) + 1);
  return guess != Guess::kOpen ? Guess::kOpen : c.sliding > 0 ? Guess::kLeft : Guess::kRight;
}

// A contact that cannot do what was guessed, and what it would rather do.
struct WrongGuess {
  int contact;
  Guess better;
};

// What contact c would rather do than was guessed, if so; `relative` is its acceleration under the guessed forces.
std::optional<Guess> BetterGuess(double friction, double allowed, const PressingContact& c, const Vec2d& relative) {
  const double bound = friction * c.normal_force, slack = allowed * c.mass;
  const double apart = Dot(c.normal, relative) + c.turning, along = Dot(Perpendicular(c.normal), relative);
  if (c.normal_force < 0) return Guess::kOpen;
  if (apart < -allowed) {
    return c.sliding > 0 ? Guess::kLeft : c.sliding < 0 || friction == 0 ? Guess::kRight : Guess::kStick;
  }
  if (c.sliding != 0 || c.normal_force == 0) return std::nullopt;
  if (std::abs(c.tangential_force) > bound + slack) return c.tangential_force < 0 ? Guess::kLeft : Guess::kRight;
  if (along * c.tangential_force > allowed * bound) return Guess::kStick;
  return std::nullopt;
}

// The forces under a guess of what each contact does: one linear system, from the forces as they are to the nearest
// that solve it. False, and nothing changed, if the guess is wrong; `wrong`, if given, gets the contacts that are, none
// if they cannot do together what was guessed or, if `hasty`, finding that out would take long.
bool SolveDirectly(double friction, double allowed, std::span<const double> inverse_mass,
                   const KeptAccelerations& given, std::span<const Guess> guesses, const Accelerations& of,
                   std::span<PressingContact> contacts, std::pmr::vector<WrongGuess>* wrong = nullptr,
                   bool hasty = false) {
  if (wrong != nullptr) wrong->clear();
  LocalMemory memory;
  std::pmr::vector<ForceRow> rows(memory.get());
  rows.reserve(2 * contacts.size());
  for (int k = 0; k < static_cast<int>(contacts.size()); ++k) {
    const PressingContact& c = contacts[k];
    const Vec2d tangent = Perpendicular(c.normal);
    if (guesses[k] == Guess::kOpen) continue;
    if (guesses[k] == Guess::kStick) {
      rows.push_back({k, {c.a, c.b, c.normal, c.normal}, c.turning});
      rows.push_back({k, {c.a, c.b, tangent, tangent}, 0});
      continue;
    }
    const double share = guesses[k] == Guess::kLeft ? -friction : friction;
    rows.push_back({k, {c.a, c.b, c.normal, c.normal + share * tangent}, c.turning});
  }
  const int n = static_cast<int>(rows.size());
  std::pmr::vector<PressingContact> solved(contacts.begin(), contacts.end(), memory.get());
  KeptAccelerations under(given, memory.get());
  const auto accelerate = [&] {
    under = given;
    Accelerate(inverse_mass, solved, under.view());
  };
  const auto missing = [&](const ForceRow& row) {
    return Dot(row.row.measured, RelativeAcceleration(contacts[row.contact], under.view())) + row.turning;
  };
  if (n > 0) {
    const RowSolver solver(rows, inverse_mass, contacts, !of.turning.empty());
    std::pmr::vector<double> change(n, memory.get());
    // The second time for what rounding leaves of the first.
    for (int pass = 0; pass < 2; ++pass) {
      accelerate();
      for (int i = 0; i < n; ++i) change[i] = -missing(rows[i]);
      if (!solver.Solve(hasty, change)) return false;
      for (int i = 0; i < n; ++i) {
        PressingContact& c = solved[rows[i].contact];
        c.normal_force += change[i] * Dot(c.normal, rows[i].row.push);
        c.tangential_force += change[i] * Dot(Perpendicular(c.normal), rows[i].row.push);
      }
    }
  }
  accelerate();
  for (const ForceRow& row : rows) {
    if (!(std::abs(missing(row)) <= allowed)) return false;
  }
  bool right = true;
  for (int k = 0; k < static_cast<int>(solved.size()); ++k) {
    const std::optional<Guess> better =
        BetterGuess(friction, allowed, solved[k], RelativeAcceleration(solved[k], under.view()));
    if (!better) continue;
    right = false;
    if (wrong == nullptr) break;
    wrong->push_back({k, *better});
  }
  if (!right) return false;
  std::copy(solved.begin(), solved.end(), contacts.begin());
  under.CopyTo(of);
  return true;
}

// Mends wrong guesses, again and again. First all at once, as long as they become fewer (block principal pivoting,
// Judice and Pires 1994); then the first, which arrives where matrices are positive definite (Murty 1974). False if
// that does not end in `most_pivots`.
bool SolveByPivoting(double friction, double allowed, int most_pivots, std::span<const double> inverse_mass,
                     const KeptAccelerations& given, std::span<const Guess> first_guesses, bool in_blocks,
                     const Accelerations& of, std::span<PressingContact> contacts, bool hasty = false) {
  LocalMemory memory;
  std::pmr::vector<Guess> guesses(first_guesses.begin(), first_guesses.end(), memory.get());
  std::pmr::vector<PressingContact> start(contacts.begin(), contacts.end(), memory.get());
  std::pmr::vector<WrongGuess> wrong(memory.get());
  std::size_t fewest = contacts.size() + 1;
  for (int pivot = 0, patience = kBlockPatience; pivot < most_pivots; ++pivot) {
    for (std::size_t k = 0; k < start.size(); ++k) {
      PressingContact& c = start[k];
      if (guesses[k] == Guess::kOpen) c.normal_force = c.tangential_force = 0;
      if (guesses[k] == Guess::kLeft) c.tangential_force = -friction * c.normal_force;
      if (guesses[k] == Guess::kRight) c.tangential_force = friction * c.normal_force;
    }
    if (SolveDirectly(friction, allowed, inverse_mass, given, guesses, of, start, &wrong, hasty)) {
      std::copy(start.begin(), start.end(), contacts.begin());
      return true;
    }
    if (wrong.empty()) return false;
    patience = wrong.size() < fewest ? kBlockPatience : patience - 1;
    fewest = std::min(fewest, wrong.size());
    if (!in_blocks || patience < 0) wrong.resize(1);
    for (const WrongGuess& one : wrong) guesses[one.contact] = one.better;
  }
  return false;
}

// Tries all guesses, from no forces. False if none is right.
bool TryAllGuesses(double friction, double allowed, std::span<const double> inverse_mass,
                   const KeptAccelerations& given, const Accelerations& of, std::span<PressingContact> contacts) {
  std::vector<PressingContact> none(contacts.begin(), contacts.end());
  for (PressingContact& c : none) c.normal_force = c.tangential_force = 0;
  std::vector<Guess> guesses(contacts.size(), Guess::kOpen);
  for (;;) {
    if (SolveDirectly(friction, allowed, inverse_mass, given, guesses, of, none)) {
      std::copy(none.begin(), none.end(), contacts.begin());
      return true;
    }
    std::size_t k = 0;
    for (; k < guesses.size(); ++k) {
      guesses[k] = NextGuess(friction, contacts[k], guesses[k]);
      if (guesses[k] != Guess::kOpen) break;
    }
    if (k == guesses.size()) return false;
  }
}

// What unit forces do: entries 2 k and 2 k + 1 are the normal and tangential part at contact k.
Eigen::MatrixXd Responses(std::span<const double> inverse_mass, const Accelerations& of,
                          std::span<const PressingContact> contacts) {
  const int n = static_cast<int>(contacts.size());
  Eigen::MatrixXd responses(2 * n, 2 * n);
  std::pmr::memory_resource* const memory = std::pmr::new_delete_resource();
  for (int column = 0; column < 2 * n; ++column) {
    KeptAccelerations under(of, memory);
    std::ranges::fill(under.linear, Vec2d(0, 0));
    std::ranges::fill(under.turning, 0.0);
    PressingContact unit = contacts[column / 2];
    unit.normal_force = column % 2 == 0;
    unit.tangential_force = column % 2;
    Accelerate(inverse_mass, {&unit, 1}, under.view());
    for (int k = 0; k < n; ++k) {
      const Vec2d relative = RelativeAcceleration(contacts[k], under.view());
      responses(2 * k, column) = Dot(contacts[k].normal, relative);
      responses(2 * k + 1, column) = Dot(Perpendicular(contacts[k].normal), relative);
    }
  }
  return responses;
}

// As one complementarity problem; then as SolveByPivoting, from what that finds each contact to do.
bool SolveAsComplementarity(double friction, double allowed, std::span<const double> inverse_mass,
                            const KeptAccelerations& given, const Accelerations& of,
                            std::span<PressingContact> contacts) {
  const int n = static_cast<int>(contacts.size());
  if (n > kMostComplementaryRows) return false;
  KeptAccelerations start(given, std::pmr::new_delete_resource());
  Eigen::VectorXd without(2 * n);
  std::vector<int> sliding(n);
  for (int k = 0; k < n; ++k) {
    const Vec2d relative = RelativeAcceleration(contacts[k], start.view());
    without[2 * k] = Dot(contacts[k].normal, relative) + contacts[k].turning;
    without[2 * k + 1] = Dot(Perpendicular(contacts[k].normal), relative);
    sliding[k] = contacts[k].sliding;
  }
  const std::optional<Eigen::VectorXd> forces =
      SolveFrictionalLcp(std::vector<double>(n, friction), Responses(inverse_mass, of, contacts), without, sliding);
  if (!forces) return false;
  std::vector<Guess> guesses(n);
  for (int k = 0; k < n; ++k) {
    PressingContact found = contacts[k];
    found.normal_force = (*forces)[2 * k];
    found.tangential_force = (1 + kNearly) * (*forces)[2 * k + 1];  // at its bound, where it is but for rounding
    guesses[k] = GuessOf(friction, found);
  }
  return SolveByPivoting(
      friction, allowed, kMostPivots, inverse_mass, given, guesses, /*in_blocks=*/true, of, contacts);
}

double NumGuesses(double friction, std::span<const PressingContact> contacts) {
  double number = 1;
  for (const PressingContact& c : contacts) number *= friction > 0 && c.sliding == 0 ? 4 : 2;
  return number;
}

}  // namespace

Pressing SolvePressingForces(double friction, std::span<const double> inverse_mass, std::span<Vec2d> acceleration,
                             std::span<PressingContact> contacts, std::span<double> turning, bool hasty) {
  const Accelerations of{acceleration, turning};
  LocalMemory memory;
  const KeptAccelerations given(of, memory.get());
  std::pmr::vector<Guess> guesses(contacts.size(), memory.get());
  double scale = 0;
  for (PressingContact& c : contacts) {
    c.normal_force = c.tangential_force = 0;
    if (c.tangential_mass == 0) c.tangential_mass = c.mass;
    const double given_here = RelativeAcceleration(c, of).norm();
    if (!std::isfinite(given_here) || !std::isfinite(c.turning)) return Pressing::kUnsolved;
    scale = std::max({scale, given_here, std::abs(c.turning)});
  }
  // Sweeps carry a force from one contact to the next: what many contacts do is guessed first, that all press.
  const bool many = contacts.size() > kMostDenseRows;
  if (many) {
    for (std::size_t k = 0; k < contacts.size(); ++k) {
      const PressingContact& c = contacts[k];
      guesses[k] = c.sliding > 0 ? Guess::kLeft : c.sliding < 0 || friction == 0 ? Guess::kRight : Guess::kStick;
    }
    const int pivots = hasty ? kHastyPivots : kFirstPivots;
    if (SolveByPivoting(friction, kExact * scale, pivots, inverse_mass, given, guesses, many, of, contacts, hasty)) {
      return Pressing::kSolved;
    }
    if (hasty) return Pressing::kUnsolved;
  }
  int direct = kFirstSweeps;
  for (int sweep = 1; sweep <= kMaxSweeps; ++sweep) {
    double change = 0;
    for (PressingContact& c : contacts) change = std::max(change, Relax(friction, inverse_mass, of, &c));
    if (change <= kConverged * scale) return Pressing::kSolved;
    if (change > kWedged * scale) return Pressing::kWedged;
    if (sweep < direct) continue;
    direct *= 2;
    for (std::size_t k = 0; k < contacts.size(); ++k) guesses[k] = GuessOf(friction, contacts[k]);
    if (SolveDirectly(friction, kExact * scale, inverse_mass, given, guesses, of, contacts)) {
      return Pressing::kSolved;
    }
    if (sweep != kLongSweeps) continue;
    const bool few = NumGuesses(friction, contacts) <= kMostGuesses;
    for (const double exact : {kExact, kNearly}) {
      const double allowed = exact * scale;
      if (SolveByPivoting(friction, allowed, kMostPivots, inverse_mass, given, guesses, many, of, contacts) ||
          (few && TryAllGuesses(friction, allowed, inverse_mass, given, of, contacts))) {
        return Pressing::kSolved;
      }
    }
    if (!few && SolveAsComplementarity(friction, kExact * scale, inverse_mass, given, of, contacts)) {
      return Pressing::kSolved;
    }
    if (!few) continue;
    const auto slides = [](const PressingContact& c) { return c.sliding != 0; };
    return std::ranges::any_of(contacts, slides) ? Pressing::kWedged : Pressing::kUnsolved;
  }
  return Pressing::kUnsolved;
}

// In units of the pressing acceleration and the speed 1 of the first impact, so a height of 1/2. Flight k >= 1 lasts
// 2 e^k; before and after the first impact it is at rest along the tangent, and each later one leaves it with the speed
// q (e + ... + e^k), q = 2 r - mu (1 + e), or at rest if q < 0. What is left when it bounces no more, it slides.
double DriftOfBounces(double tangential, double pressing, double friction, double restitution) {
  const double r = std::abs(tangential) / pressing, e = restitution;
  const double q = std::max(0.0, 2 * r - friction * (1 + e)), speed = q * e / (1 - e);
  double drift = 0.5 * r + 2 * (r + speed) * e * e / (1 - e * e);
  if (speed > 0) drift += 0.5 * speed * speed / (friction - r);
  return std::copysign(2 * drift, tangential);
}

}  // namespace saltus
