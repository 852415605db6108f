// Mechanical systems with contacts in generalized coordinates. The library determines which contacts are closed, stick
// or slide, the impulses of impacts, detachment and stick-slip.
//
//   M(q) dv/dt = h(t, q, v, u) + sum_i (N_i^T f_n,i + T_i^T f_t,i),   dq/dt = v,   gap phi_i(q) >= 0
//
// with the rows N_i = dphi_i/dq and T_i = dgamma_i/dq of a tangential coordinate gamma_i; v_n = N v is positive where a
// contact separates, v_t = T v, and f_n >= 0. A system is a struct with constants and functions that are templates on
// the scalar T:
//
//   struct BouncingRod {                          // SI units; members are constants of the system
//     static constexpr int kNumCoordinates = 3;   // n: q = [x y th]
//     static constexpr int kNumControls = 0;
//     static constexpr int kNumParameters = 2;    // e, mu
//     static constexpr int kNumContacts = 1;
//
//     // M, n x n, row-major, symmetric and positive definite.
//     template <typename T> void Mass(const T* q, const T* p, T* M) const;
//     // h, n numbers: all forces but those of contacts, and minus the terms of M dv/dt that are quadratic in v.
//     template <typename T> void Force(const T& t, const T* q, const T* v, const T* u, const T* p, T* h) const;
//     template <typename T> T Gap(int contact, const T* q, const T* p) const;
//     // gamma, in systems with friction only.
//     template <typename T> T Slide(int contact, const T* q, const T* p) const;
//     template <typename T> T Friction(int contact, const T* p) const;     // mu >= 0, constant along a motion
//     template <typename T> T Restitution(int contact, const T* p) const;  // e in [0, 1]
//   };
//   MechanicalSystem rod{BouncingRod()};
//   HybridSimulator simulator(rod.hybrid());
//
// If the tangential velocity is not the rate of a coordinate, as for bodies that roll on each other, `SlideRow(contact,
// q, p, T* row)` gives the row T itself instead of Slide. Gap and gamma must have the same metric: if the gap is a
// distance times c(q), so is gamma. The optional `T Reach(contact, q, p)` is above zero while a closed contact stays on
// the edge that its gap is measured from. If the gap has a kink at the end of the edge, `T Distance(contact, q, p)` is
// the gap continued smoothly past the end, which a closed contact keeps at zero. Names are optional: std::array<const
// char*, n> kContactNames, kCoordinateNames, kControlNames, kParameterNames. T is `double`, ceres::Jet, or a type with
// the arithmetic, comparisons and elementary functions of a Jet that takes numbers of type double as constants.
//
// The hybrid system has the state [q v]. Motions create its modes, whose names have a letter for each contact: 'o'
// open, 'n' closed without friction, '+' or '-' closed and sliding with v_t > 0 or < 0, 's' sticking. A contact without
// friction never sticks: it is 'n' while its tangential velocity is zero. The events are
//
//   hit    the gap of an open contact reaches zero       impact, and what stays closed by the accelerations after it
//   off    the normal force reaches zero                 the contact opens
//   stop   the sliding velocity reaches zero             sticks if friction can hold it, else slides the other way
//   end    Reach falls through zero                      the contact opens
//   break  the tangential force reaches mu f_n           slides against the force that friction gave
//   jam    N M^-1 (N^T -+ mu T^T) reaches zero           none: see below
//   grip   the friction of a contact that is 'n' is not zero   as after an impact
//
// Impacts. Newton's law with Coulomb's law at the end of the impact (Moreau 1988; Glocker, Set-Valued Force Laws):
//
//   v+ = v + M^-1 (N^T p_n + T^T p_t),   v_n+ = -e v_n,   -p_t in mu p_n Sgn(v_t+)
//
// or Poisson's law in a phase of compression and one of expansion (Pfeiffer and Glocker). Contacts that are closed and
// those that hit at the same instant, and are coupled by M^-1, take part: each has p = 0 and v_n+ > -e v_n, or
// v_n+ = -e v_n and p_n >= 0. A contact with v_n+ = 0 is closed or opens by the complementarity problem of the
// accelerations, 0 <= f_n _|_ a_n >= 0 with Coulomb's law, which is solved at the start, after impacts, at jumps of the
// control and where sliding stops. If it has no solution or several that differ (Painleve; Genot and Brogliato 1999),
// or an impact has, the motion ends there with a reason. Of accelerations that several modes have, the mode counts in
// which most contacts are closed and stick. Up to four coupled contacts all possibilities are tried; of more, one
// solution is found by Lemke's method or projected Gauss-Seidel, whether or not there are others.
//
// If forces are not unique, as those of two corners of a box that stick, those farthest from the limits of all contacts
// are taken, so that the mode lasts as long as any forces satisfy the conditions. Internal stresses count only if
// nothing else holds the contacts. Forces at a limit, within 1e-12 of their size, are within it; a motion that starts
// there has one-sided derivatives.
//
// Bounces that accumulate, also of several contacts in turn as of a body that rocks, end as follows: a contact with a
// closing force that would separate with less than `rest_speed` closes in this impact, whose restitution is zero. The
// error of the state at rest is of second order in this speed, and that of the time of rest, which is early, of first
// order.
//
// The state is projected onto the equations of closed contacts after each step of the integration.
#pragma once

#include <concepts>
#include <memory>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "saltus/hybrid/hybrid_simulator.h"
#include "saltus/internal/mechanical_functions.h"

namespace saltus {

class MechanicalHybrid;

struct MechanicalOptions {
  enum class Law { kNewton, kPoisson } law = Law::kNewton;
  // The speed of separation below which a contact with a closing force closes in an impact, in the unit of the gap per
  // unit of time.
  double rest_speed = 1e-5;
};

// One impact of a motion.
struct MechanicalImpact {
  struct Contact {
    int contact = 0;  // its index
    // 'o': has no impulse; 'n': without friction; 's', '+', '-': sticks or slides at the end of the impact.
    char status = 'o';
    double normal_before = 0, normal_after = 0;          // v_n
    double tangential_before = 0, tangential_after = 0;  // v_t; zero without friction
    double normal_impulse = 0, tangential_impulse = 0;   // p_n >= 0 and p_t, which change M v by N^T p_n + T^T p_t
  };
  double time = 0;
  std::vector<Contact> contacts;  // contacts that hit, and those that are coupled with them
  double energy = 0;              // change of the kinetic energy by the impact, negative for a loss
  // Whether its restitution is zero because bounces accumulate; they would have ended at about accumulates_at.
  bool ends_bouncing = false;
  double accumulates_at = 0;
  // Whether several coupled contacts hit at the same instant. The state then depends on the order of the impacts, and
  // has no derivative. The velocities v (n numbers each) are those after the simultaneous impact and, for two contacts,
  // after impacts in sequence that begin with the first or the second, until none approaches. The coupling is |W_ij| /
  // sqrt(W_ii W_jj) with W = N M^-1 N^T.
  bool simultaneous = false;
  std::vector<double> v_simultaneous, v_first_then_second, v_second_then_first;
  double coupling = 0;
};

// The impacts of a motion of a mechanical system, with their energies.
struct MechanicalReport {
  std::vector<MechanicalImpact> impacts;
  double slowest_impact = 0;       // smallest |v_n| before an impact, of contacts that hit; infinite if there is none
  double largest_gain = 0;         // of energy, at an impact
  std::vector<int> energy_gains;   // indices of impacts that gain energy beyond rounding, as Newton's law can
  std::vector<int> accumulations;  // indices of impacts at which bounces end
};

// A solution of the complementarity problem of the accelerations: a status for each contact (a letter as in the names
// of modes), and normal and tangential forces, one for each contact.
struct ContactForces {
  std::string status;
  std::vector<double> normal, tangential;
};

// A mechanical system as a hybrid system, whose modes are created as motions need them.
class MechanicalSystem {
 public:
  template <typename S>
  requires(!std::derived_from<std::remove_cvref_t<S>, MechanicalSystem> &&
           requires(const S& s, const double* q) {
             s.Gap(0, q, q);
           }) explicit MechanicalSystem(S system, MechanicalOptions options = {})
      : MechanicalSystem(std::make_shared<MechanicalFunctionsOf<S>>(std::move(system)), options) {}
  explicit MechanicalSystem(std::shared_ptr<const MechanicalFunctions> functions, MechanicalOptions options = {});

  // Returns the hybrid system, whose copies share the modes.
  const HybridSystem& hybrid() const { return hybrid_; }
  const MechanicalFunctions& functions() const;
  const MechanicalOptions& options() const;

  // Returns the mode of a status. Precondition: IsStatus(status).
  int Mode(const std::string& status) const;
  // Returns whether the text has a letter for each contact, each a status that the contact can have.
  bool IsStatus(const std::string& status) const;

  // Checks at x = [q v] that the mass matrix is symmetric and positive definite, that no gap is constant, and that each
  // restitution is from 0 to 1 and each friction >= 0. Returns the first error as "found x, expected y"; empty if there
  // is none.
  std::string ValidateAt(std::span<const double> x, std::span<const double> p) const;

  // The result of FindMode: the mode in which a motion starts from x = [q v] under control u at time t. The
  // accelerations determine whether contacts with a gap of zero and a normal velocity of zero are closed. If there is
  // no mode, it is -1, and `reason` states why.
  struct Start {
    int mode = -1;
    std::string reason;
  };
  Start FindMode(std::span<const double> x, std::span<const double> u, std::span<const double> p, double t = 0) const;
  // Returns all solutions of the complementarity problem of the accelerations at x, over the contacts with a gap of
  // zero and a normal velocity of zero; more than one, or none, is a case of Painleve.
  std::vector<ContactForces> ClosedContacts(std::span<const double> x, std::span<const double> u,
                                            std::span<const double> p, double t = 0) const;
  // Forces and accelerations in a mode.
  struct Motion {
    std::vector<double> acceleration, normal, tangential;  // dv/dt (n numbers); f_n and f_t of each contact, 0 if open
  };
  Motion MotionIn(int mode, std::span<const double> x, std::span<const double> u, std::span<const double> p,
                  double t = 0) const;
  // Returns the impact at x of a mode in which contact `contact` has a gap of zero and approaches; without contacts if
  // the impact has no solution, or several.
  MechanicalImpact ImpactAt(int mode, int contact, std::span<const double> x, std::span<const double> u,
                            std::span<const double> p, double t = 0) const;

  // Computes the impacts of the last rollout, of `input`, of a simulator of hybrid().
  MechanicalReport Examine(const HybridSimulator& simulator, const HybridInput& input) const;

 private:
  std::shared_ptr<const MechanicalHybrid> modes_;
  HybridSystem hybrid_;
};

}  // namespace saltus
