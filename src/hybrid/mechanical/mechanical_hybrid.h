// A mechanical system with contacts as a hybrid system whose modes are created as a motion meets them.
//
// A mode is the status of all contacts (open, closed, sliding, sticking). Its flow is q' = v, M v' = h + F f under the
// contact forces f that keep closed contacts closed (mechanical_equations.h); its guards are the gaps of open contacts
// and, of closed ones, the normal force, the sliding speed and the distance of the force from the friction cone. The
// next status is a solution of a complementarity problem (contact_problem.h) in accelerations, at an impact in
// velocities.
#pragma once

#include <deque>
#include <map>
#include <memory>
#include <shared_mutex>
#include <span>
#include <string>
#include <vector>

#include "hybrid/mechanical/contact_problem.h"
#include "hybrid/mechanical/mechanical_equations.h"
#include "saltus/hybrid/mechanical_system.h"
#include "saltus/internal/hybrid_functions.h"

namespace saltus {

class MechanicalHybrid final : public HybridFunctions {
 public:
  using Point = MechanicalEquations::Point;

  // `smooth`: for each contact, whether it is taken as one without friction, whatever the system says; none: no
  // contact.
  MechanicalHybrid(std::shared_ptr<const MechanicalFunctions> functions, MechanicalOptions options,
                   std::vector<char> smooth = {});

  const MechanicalFunctions& mechanics() const { return *functions_; }
  const MechanicalEquations& equations() const { return equations_; }
  const MechanicalOptions& options() const { return options_; }

  struct GuardId {
    enum class Kind {  // in the order of their names in GuardName
      kHit,            // the gap
      kOff,            // f_n
      kStop,           // sigma v_t
      kBreakBack,      // mu f_n - f_t, behind which the contact slides with v_t < 0
      kBreakOn,        // mu f_n + f_t, behind which it slides with v_t > 0
      kEnd,            // the end of what the gap is measured from
      kJam,            // N M^-1 (N^T - mu sigma T^T)
      kGrip,           // -mu of a contact that is closed as without friction
    } kind = Kind::kHit;
    int contact = 0;
  };
  struct Mode {
    std::string status;
    std::vector<ClosedContact> closed;
    std::vector<GuardId> guards;
  };
  // Returns a mode; modes are never removed.
  const Mode& ModeAt(int mode) const;
  // The number of the mode with this status, which is created if there is none.
  int ModeOf(const std::string& status) const;
  // Whether it is a status of contacts of this system.
  bool IsStatus(const std::string& status) const;

  // The result of an impact. It has stages, each of which is linear: one, or two with Poisson's law.
  struct Impact {
    std::string why;            // there is none; the rest is empty
    std::vector<int> contacts;  // that take part
    std::vector<char> hits;     // of these: not closed before
    std::string status;         // of these, at the end of the impact
    Eigen::VectorXd impulse;    // of these, normal and tangential in turn
    Eigen::VectorXd v_plus;
    Eigen::MatrixXd W;           // as in ContactProblem
    Eigen::VectorXd before;      // v_n and v_t of these, in turn
    std::vector<char> restores;  // of these: its restitution counts
    std::vector<char> rebounds;  // of these: v_n+ > 0, as its restitution is
    bool ends_bouncing = false;
    bool held = false;  // its contacts are, whatever the signs of its impulses
    std::string next;   // status of all contacts after it
    // With Poisson's law: the state after compression.
    std::string compressed;
    Eigen::VectorXd compression, v_compressed;

    // Returns v_n and v_t after the impact, in turn.
    Eigen::VectorXd VelocityAfter() const { return before + W * impulse; }
  };
  Impact SolveImpact(const Mode& mode, int contact, const Point& at) const;

  // Accelerations and forces of the closed contacts of a mode, and their derivatives by the seeds of each pass.
  struct ClosedMotion {
    Eigen::VectorXd a, force;
    std::vector<MechanicalEquations::Derivative> derivatives;
    // Set by ForcedMotion only.
    Eigen::VectorXd tolerance;  // of each force: ForceTolerances
    Eigen::MatrixXd stresses;   // InternalStresses
    // Holds for each closed contact (none: false) whether it shares internal stresses with one that is at a limit
    // whatever these are. Several splits of the forces are as good then, of which the search takes one or another.
    std::vector<char> at_limit;
  };
  // Returns the forces to be compared with their limits: those that are not unique are those of SplitForces.
  ClosedMotion ForcedMotion(const Mode& mode, const Point& at,
                            std::span<const MechanicalEquations::Seeds> passes = {}) const;

  // A point on the equations of a mode.
  struct ProjectedPoint {
    Point at;
    std::vector<double> x;  // that `at` refers to, if it has been moved
    std::vector<MechanicalEquations::Seeds> passes;
  };
  // `columns`: of [x t p u] at the point that are seeded; the seeds are moved as the point is.
  ProjectedPoint Projected(const Mode& mode, const Point& at, std::span<const int> columns = {}) const;

  // The velocities after impulses of contacts, normal and tangential in turn.
  Eigen::VectorXd Moved(const std::vector<int>& contacts, const Eigen::VectorXd& impulse, const Point& at) const;

  // Solutions of the problem of accelerations over contacts that neither approach nor part, by their signs of v_t:
  // one for each independent group is joined with those of the others. Of several, all are returned.
  struct Closing {
    std::vector<int> contacts, sliding;
  };
  std::vector<ContactSolution> SolveAccelerations(const Closing& closing, const Point& at) const;
  // The status of all contacts after `before`, of which those in `closing` close or open; empty if there is none or
  // several, and then `why` is the reason.
  std::string Close(const std::string& before, const Closing& closing, const Point& at, std::string* why) const;
  // The contacts at x that have a gap of zero and neither approach nor part. `why`: of a contact that penetrates.
  Closing Touching(const Point& at, std::string* why) const;

  // Returns a point; `u` is null where no control is known, as for the guard of an open contact, and then zeros.
  Point PointAt(double t, const double* x, const double* u, const double* p) const {
    return {t, x, x + equations_.n(), u != nullptr ? u : no_control_.data(), p};
  }
  Point PointAt(const ModePoint& at) const { return PointAt(at.t, at.x, at.u, at.p); }
  std::string ContactName(int contact) const;

  int num_modes() const override;
  int state_size(int) const override { return 2 * equations_.n(); }
  int num_guards(int mode) const override { return static_cast<int>(ModeAt(mode).guards.size()); }
  std::string ModeName(int mode) const override { return ModeAt(mode).status; }
  std::string GuardName(int mode, int guard) const override;
  std::string StateName(int /*mode*/, int component) const override { return HybridFunctions::StateName(0, component); }

  void Flow(const ModePoint& from, double* xdot) const override;
  void FlowJacobian(const ModePoint& from, double* xdot, double* jacobian) const override;
  double Guard(const ModePoint& from, int guard) const override;
  double GuardRate(const ModePoint& from, int guard, const double* xdot, double* rate) const override;
  void GuardRates(const ModePoint& from, const double* xdot, GuardValue* all) const override;
  double GuardGradient(const ModePoint& from, int guard, double* gradient) const override;
  void GuardGradients(const ModePoint& from, double* values, double* gradients) const override;
  void AppendGuardTerms(const ModePoint& from, int guard, std::vector<GuardTerm>* terms) const override {
    const Mode& of = ModeAt(from.mode);
    std::vector<std::size_t> ends;
    AppendTermsOf(of, {&of.guards[guard], 1}, from, terms, &ends);
  }
  void AppendAllGuardTerms(const ModePoint& from, std::vector<GuardTerm>* terms,
                           std::vector<std::size_t>* ends) const override {
    const Mode& of = ModeAt(from.mode);
    AppendTermsOf(of, of.guards, from, terms, ends);
  }
  int CauseOf(const ModePoint& from, int guard) const override;
  int Reset(const ModePoint& from, int guard, double* x_plus) const override;
  int ResetJacobian(const ModePoint& from, int guard, double* x_plus, double* jacobian) const override;
  std::string ReasonNoMode(const ModePoint& from, int guard) const override;
  std::string ReasonNoDerivative(const ModePoint& from, int guard) const override;
  int ModeAfterControlJump(const ModePoint& from) const override;
  bool Projects(int mode) const override { return !ModeAt(mode).closed.empty(); }
  void Project(int mode, const double* x, const double* p, double* x_plus) const override;
  void ProjectJacobian(const ModePoint& from, double* x_plus, double* jacobian) const override;
  bool RearmsAboveZero(int mode, int guard) const override {
    return ModeAt(mode).guards[guard].kind == GuardId::Kind::kHit;
  }
  bool CreatesModes() const override { return true; }
  std::vector<int> NextModes(int mode, int guard, const double* p) const override;
  bool ReadsControl(int mode, int guard) const override {
    return functions_->layout().num_controls > 0 && NeedsForces(ModeAt(mode).guards[guard]);
  }
  bool EndsAccumulations() const override { return true; }
  // Contacts whose friction is zero become contacts without friction, which do not count where their sliding reverses.
  std::shared_ptr<const HybridFunctions> RemoveIdleEvents(const double* p, std::span<const int> free) const override;
  int EquivalentMode(const std::string& name) const override;

 private:
  using Jet = MechanicalEquations::Jet;
  using Block = Eigen::Matrix<double, Eigen::Dynamic, MechanicalEquations::kWidth>;

  bool HasFriction(int contact) const { return has_friction_[contact] != 0; }
  bool CanStick(int contact, const double* p) const {
    return HasFriction(contact) && functions_->Friction(contact, p) > 0;
  }
  // Returns W and the velocities or accelerations of contacts, as in ContactProblem.
  ContactProblem ProblemOf(const std::vector<int>& contacts, const Point& at) const;
  // The restitution of contacts that hit: the given one; none; or none, and all contacts that take part are held
  // closed, and at rest where they are slow.
  enum class Restitution { kOwn, kNone, kNoneAndHeld };
  Impact SolveImpactWith(const Mode& mode, int contact, const Point& at, Restitution law) const;
  Block ImpactDerivative(const Impact& impact, const MechanicalEquations::Seeds& seeds, const Point& at) const;
  void CopyColumns(const ProjectedPoint& on, std::span<const int> columns, double* jacobian) const;
  static bool NeedsForces(const GuardId& guarded);
  ClosedMotion MotionOf(const Mode& mode, const Point& at,
                        std::span<const MechanicalEquations::Seeds> passes = {}) const;
  // The guard and its derivatives by the seeds of a pass. `motion` is that of ForcedMotion, and read where NeedsForces.
  Jet GuardJet(const Mode& mode, const GuardId& guarded, const Point& at, const MechanicalEquations::Seeds& seeds,
               const ClosedMotion& motion, std::size_t pass) const;
  void GuardGradients(const Mode& mode, std::span<const GuardId> guards, const ModePoint& from, double* values,
                      double* gradients) const;
  // Derivatives of gaps are those at the point on the equations of the mode, of which each has few.
  void AppendTermsOf(const Mode& mode, std::span<const GuardId> guards, const ModePoint& from,
                     std::vector<GuardTerm>* terms, std::vector<std::size_t>* ends) const;
  // A guard and its rate along the direction of path and seeds. Seeds and motion are not read where a gap is the guard,
  // the path where none is.
  GuardValue GuardAlong(const Mode& mode, const GuardId& guarded, const Point& at,
                        const MechanicalEquations::TimePath<double>& path, const MechanicalEquations::Seeds& seeds,
                        const ClosedMotion& motion) const;
  int ResetOn(const Mode& mode, const GuardId& guarded, const Point& at, Impact* impact, double* x_plus) const;
  std::string NextStatus(const Mode& mode, const GuardId& guarded, const Point& at, Impact* impact,
                         std::string* why) const;
  // Returns the reason why a mode with these forces has only one-sided derivatives.
  std::string ForcesAtLimits(const Mode& mode, const Point& at) const;
  std::string StatusPastLimit(const Mode& mode, const GuardId& guarded, const Point& at, std::string* why) const;
  Closing ClosedOf(const Mode& mode, const Point& at) const;
  Closing Stopping(const Mode& mode, const GuardId& guarded, const Point& at) const;
  std::vector<ClosedContact> Stopped(const Mode& mode, const GuardId& guarded, const Point& at) const;
  // The sign of v_t; zero if it is no more than this part of its terms.
  int SlipSign(int contact, const Point& at, double zero) const;

  const std::shared_ptr<const MechanicalFunctions> functions_;
  const MechanicalOptions options_;
  const MechanicalEquations equations_;
  const std::vector<double> no_control_;
  const std::vector<char> has_friction_;
  // Returns InternalStresses, which are kept: those of bodies at rest stay the same.
  Eigen::MatrixXd StressesOf(const Eigen::MatrixXd& matrix) const;
  mutable std::shared_mutex mutex_;
  mutable std::deque<Mode> modes_;                                     // under mutex_; the elements do not move
  mutable std::map<std::string, int> known_;                           // under mutex_
  mutable std::pair<Eigen::MatrixXd, Eigen::MatrixXd> last_stresses_;  // under mutex_: a matrix, and its stresses
};

}  // namespace saltus
