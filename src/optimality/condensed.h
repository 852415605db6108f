// The loss as a function of the control alone, along a fixed sequence of impacts: states and impact times are
// eliminated, the times by the implicit function theorem. Along the sequence this function is smooth.
//
// The motion depends on the control only through a few linear functionals s = F u. For each controlled disc on each of
// its legs, that is between two of its impacts or waypoints, which last a fixed time S and consist of pieces of lengths
// l_i with middles t_i from the start, these are the changes of velocity and of position by the forces,
//
//   sum l_i u_i / m   and   sum l_i (S - t_i) u_i / m,
//
// and of angular velocity and angle by the torques. A disc with running terms has a leg for each interval, as these
// notice every force: the functionals are the forces.
//
// At each impact whose time varies there is also the force: if the time shifts by dt, the force just before acts for dt
// longer and that just after for dt less (for an impact inside an interval the two cancel); likewise at a free final
// time, which is one functional more that no force enters. With interval lengths M,
//
//   L(u) = effort u^T M u + G(F u),   with second derivative   2 effort M + F^T G'' F.
//
// Without running terms the rank of the second part is a few times the number of impacts. G' comes from
// costates carried backwards through the impacts (impact.h), G'' from the same sweep in Jets.
//
// An impact on a node at which the force jumps is treated in one of two ways. Either the boundary of the two intervals
// moves with the impact, for the discs that take part; or the impact is held on the node, by a multiplier between those
// of the two one-sided gradients. Held impacts restrict directions to those along which they stay on their nodes, to
// first order.
//
// Active bounds on forces and constraints on states restrict directions as well. L is then the Lagrangian: multipliers
// of constraints add to the costates, a bound on the norm of a force, which is curved itself, adds to M, and a limit of
// the speed to G''.
#pragma once

#include <Eigen/Core>
#include <array>
#include <map>
#include <optional>
#include <span>
#include <vector>

#include "saltus/scene/scene.h"
#include "simulate/costate_sweep.h"
#include "simulate/flight.h"

namespace saltus {

// Active bounds on the forces and constraints on states, with their multipliers.
struct Restrictions {
  struct Force {
    Eigen::Matrix2d free = Eigen::Matrix2d::Identity();  // projects on the directions along its bounds
    double bend = 0;  // second derivative of its bounds, times their multiplier, as a part of that of the effort
  };
  std::vector<Force> forces = {};        // K x C; empty: all are free
  std::vector<char> turns = {};          // K x number of torques: whether it is free; empty: all are
  std::vector<ConstraintRow> rows = {};  // at waypoints and at the final time
  bool duration = true;                  // the final time may vary, if the scene has it free
};

// The least curvature of M + F^T G F, with M positive definite, along directions d that keep what is held: F d is in
// the null space of `held`. Given are F M^-1 F^T, G and `unit`, by which curvatures are divided; d^T M d = unit.
struct LeastCurvature {
  double smallest = 0, largest = 0;  // of F^T G F alone; M adds 1
  Eigen::VectorXd source;            // the direction is M^-1 F^T source; empty if no direction keeps what is held
  Eigen::Index rank = 0;             // of F M^-1 F^T
};
LeastCurvature FindLeastCurvature(const Eigen::MatrixXd& gram, const Eigen::MatrixXd& hessian,
                                  const Eigen::MatrixXd& held, double unit);

// The least and the largest curvature along directions, relative to that of the costs of the control alone.
struct CurvatureRange {
  double smallest = 1, largest = 1;
  Eigen::VectorXd direction;  // of the least
};

class CondensedLoss {
 public:
  // `theta`, by impact: if the impact is held on its node, the weight of the gradient as if it were early. An empty
  // vector holds no impact. The flight must outlive the object and be that of `control` on intervals of `lengths`.
  CondensedLoss(const Scene& scene, const Flight& flight, std::span<const double> control,
                std::span<const double> lengths, std::vector<std::optional<double>> theta = {},
                Restrictions restrictions = {});

  // Returns the number of rows of F.
  int num_functionals() const { return static_cast<int>(values_.size()); }

  // Returns the gradient by the control, in its layout, 1/N. With held impacts or constraints it is that of the
  // Lagrangian; bounds are left out.
  Eigen::VectorXd Gradient() const;

  // Returns the least curvature along directions d with integral |d|^2 dt = 1, relative to that of the effort (and of
  // the bounds on norms) alone, and its direction, in the layout of the control.
  CurvatureRange SmallestCurvature() const;

  // Returns the control after one step of Newton's method along directions that keep what is held. Returns std::nullopt
  // if second derivatives are singular. Precondition: forces are not restricted.
  std::optional<Eigen::VectorXd> NewtonStep() const;

  // Returns 2 effort M + F^T G'' F, for tests; after the control it has the final time, if that varies.
  Eigen::MatrixXd DenseHessian() const;

 private:
  // Indices of functionals of a disc: of a force, or a change by the forces, and of a torque or a change by the
  // torques; -1: none.
  struct Push {
    int force = -1, turn = -1;
  };
  // The arc of a disc that is not fixed, from one of its impacts (or the start) to the next (or the end), and its legs.
  struct Arc {
    int first = 0, end = 0;
  };
  struct Leg {
    int body = 0;
    double begin = 0, end = 0;  // s
    Push gain = {}, way = {};   // whose multiples are the changes of velocity and of position
    double by_gain = 1, by_way = 1, by_turn = 1, by_turned = 1;
    bool tracked = false;  // with running terms; `gain` and `way` are the forces of an interval
    int via = -1;          // the waypoint at its end
  };
  struct Side {
    int body = -1;  // -1: a plane or a fixed disc
    int arc_before = -1, arc_after = -1;
    Push before, after;  // the forces of the intervals that end and start there
  };
  // A component of F u: `weights` of the forces, along one axis, of a pushed disc from interval `first` on.
  struct Functional {
    int column = 0;  // of an interval's row of the control
    int first = 0;
    std::vector<double> weights;
  };

  int AddArc(int body, int from_hit, int to_hit);
  // Adds a leg between intervals first..last; it may contain only a part of each of these two.
  void AddLeg(int body, double begin, double end, int first, int last, int via);
  Push AddForce(int body, int interval);
  Push AddFunctionals(int body, int first, const std::vector<double>& weights);
  std::pair<int, int> IntervalsAt(int hit) const;
  double RateOfTurn(int body) const;  // angular acceleration per torque / radius, 1/(kg m)
  bool IsTracked(int body) const;
  // Computes the derivatives of G by F u at F u = s and, unless null, the values that are held: the gaps at impacts (in
  // order), then those of constraints.
  template <typename T>
  void Sweep(const T* s, T* gradient, T* gaps) const;
  // Computes G'', and the derivatives of what is held, one row each.
  void SecondDerivatives(Eigen::MatrixXd* hessian, Eigen::MatrixXd* gaps) const;
  Eigen::VectorXd Transposed(const Eigen::VectorXd& s) const;  // F^T s
  Eigen::MatrixXd Gram() const;                                // F M^-1 F^T, M restricted
  double Length(Eigen::Index i) const { return lengths_[i / width_]; }
  const Restrictions::Force& ForceAt(size_t interval, int c) const {
    return restrictions_.forces.empty() ? free_ : restrictions_.forces[interval * scene_.num_controlled() + c];
  }
  bool IsFreeTurn(size_t interval, int t) const {
    return restrictions_.turns.empty() || restrictions_.turns[interval * scene_.num_turned() + t];
  }
  // Computes M^-1 x of the free directions, and the number of these.
  void DivideByWeights(Eigen::VectorXd* x) const;
  Eigen::Index NumFree() const;

  const Scene& scene_;
  const Flight& flight_;
  std::span<const double> control_, lengths_;
  std::vector<std::optional<double>> theta_;
  Restrictions restrictions_;
  Restrictions::Force free_;
  Objective soft_;                    // without hard terms
  int width_;                         // of a row of the control
  std::vector<int> pushed_, turned_;  // by body: its place among those with a force (a torque), or -1
  std::vector<double> nodes_;
  std::vector<int> interval_at_;  // by hit: that which it lies in or starts; see IntervalsAt
  std::vector<Arc> arcs_;
  std::vector<Leg> legs_;
  std::vector<int> first_arc_, last_arc_;  // by body; -1 if it is fixed
  std::vector<std::array<Side, 2>> sides_;
  std::vector<Push> last_;     // by body: the forces of the last interval, if the final time varies
  int by_duration_ = -1;       // the functional that is the change of the final time
  std::map<int, int> forces_;  // functionals that are one component of a control: by its index
  std::vector<Functional> functionals_;
  std::vector<double> values_;  // F u
  int num_held_ = 0;
};

}  // namespace saltus
