#include "identify/segment_motion.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <optional>
#include <span>
#include <tuple>
#include <utility>

#include "base/linear_algebra.h"
#include "saltus/simulate/learned_contact.h"
#include "simulate/flight.h"
#include "simulate/geometry_difference.h"

namespace saltus {
namespace {

using Kind = Unknown::Kind;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kOnNode = 1e-9;  // of a step: a time as near to a node is that of the node

// The scene of a segment: its free parameters are set, its horizon ends with the step of its last sample.
Scene SceneOf(const Scene& scene, double horizon, int grid_steps) {
  Scene segment = scene;
  const double dt = scene.dt();
  const int steps = std::max(1, static_cast<int>(std::ceil(horizon / dt - kOnNode)));
  segment.steps = (steps + grid_steps - 1) / grid_steps * grid_steps;
  segment.duration = dt * segment.steps;
  return segment;
}

// Returns the flight over n steps, as a matrix from [p v a] to [p v a].
Eigen::Matrix3d Power(const StepLinearization::FreeFlight& f, int n) {
  Eigen::Matrix3d step, power = Eigen::Matrix3d::Identity();
  step << f.pp, f.pv, f.pa, f.vp, f.vv, f.va, 0, 0, 1;
  for (; n > 0; n /= 2, step = (step * step).eval()) {
    if (n % 2 == 1) power = (step * power).eval();
  }
  return power;
}

// Derivatives of the step of a scene by the unknowns of its geometry (geometry_difference.h).
class GeometrySteps {
 public:
  GeometrySteps(const Contact& contact, const Scene& scene, const std::vector<Unknown>& unknowns)
      : contact_(contact), scene_(scene) {
    for (std::size_t column = 0; column < unknowns.size(); ++column) {
      const Unknown& unknown = unknowns[column];
      if (!IsOfGeometry(unknown.kind)) continue;
      all_.push_back({unknown, static_cast<Eigen::Index>(column), GeometryWidth(unknown, scene), {}});
    }
  }

  // Adds the derivatives of the state after a step from x to the columns of these unknowns. Returns whether they have
  // any: contacts must not differ on both sides of a value.
  bool Add(std::span<const double> x, std::span<const double> force, MatrixXd* tangent) {
    if (all_.empty()) return true;
    std::vector<Touch> touches_here, touches;
    VectorXd here(x.size()), next(x.size());
    SimulatorAt(0, &all_.front()).Step(x, force, {here.data(), x.size()}, &touches_here);
    for (Varied& varied : all_) {
      const auto change_at = [&](int node) -> std::optional<VectorXd> {
        SimulatorAt(node, &varied).Step(x, force, {next.data(), x.size()}, &touches);
        if (!next.allFinite() || !HasSameTouches(touches, touches_here)) return std::nullopt;
        return next - here;
      };
      const std::optional<VectorXd> derivative = GeometryDifference(varied.width, change_at);
      if (!derivative || !derivative->allFinite()) return false;
      tangent->col(varied.column) += *derivative;
    }
    return true;
  }

 private:
  struct Varied {
    Unknown unknown;
    Eigen::Index column;
    double width;
    std::array<std::unique_ptr<Simulator>, 2 * kGeometryNodes + 1> simulators;  // made when they are needed
  };

  const Simulator& SimulatorAt(int node, Varied* varied) const {
    std::unique_ptr<Simulator>& simulator = varied->simulators[node + kGeometryNodes];
    if (simulator == nullptr) {
      Scene near = scene_;
      const double value = varied->unknown.kind == Kind::kRadius ? ValueOf(varied->unknown, scene_) : 0;
      SetValue(varied->unknown, value + node * varied->width, &near);  // a wall is moved from its present place
      simulator = MakeSimulator(contact_, near, Precision::kDouble);
    }
    return *simulator;
  }

  const Contact contact_;
  const Scene scene_;
  std::vector<Varied> all_;
};

class Sweep {
 public:
  Sweep(const Contact& contact, const Scene& scene, const Segment& segment, const MotionRequest& request,
        bool with_derivatives)
      : segment_(segment),
        request_(request),
        with_derivatives_(with_derivatives),
        contacts_(ContactsOf(contact, request, with_derivatives)),
        scene_(SceneOf(scene, Last() - segment.begin, FindContactModel(contact)->grid_steps)),
        simulators_(MakeSimulators(scene_)),
        simulator_(simulators_.front().get()),
        geometry_(contacts_.front(), scene_, request.unknowns) {}

  MotionAtSamples Run() {
    MotionAtSamples out;
    control_ = InitialControl(scene_, simulator_->num_steps());
    if (!simulator_->Rollout(segment_.initial, control_)) {
      out.reason = simulator_->FailureReason();
      return out;
    }
    out.touches = simulator_->touches();
    x_.resize(simulator_->state_size());
    if (request_.law != nullptr || request_.events != nullptr) FindImpacts(&out);
    FindTouchedSteps();
    if (with_derivatives_) Begin();
    for (int i = segment_.first; i < segment_.last; ++i) {
      if (!TakeSample((*request_.samples)[i], &out)) {
        out.reason = "the step to a sample has no result";
        return out;
      }
      if (!has_derivatives_) {
        out.reason = "the contacts of a step differ on both sides of a place of a wall, or of a radius";
        return out;
      }
    }
    out.ok = true;
    return out;
  }

 private:
  using Simulators = std::vector<std::unique_ptr<Simulator>>;

  // Returns contact models with the learned parameters, one for every few of those that derivatives are needed of.
  static std::vector<Contact> ContactsOf(const Contact& contact, const MotionRequest& request, bool with_derivatives) {
    if (request.law == nullptr && request.events == nullptr) return {contact};
    std::vector<Contact> contacts;
    const auto& parameters = request.law != nullptr ? request.law->parameters : request.events->parameters;
    const int count = with_derivatives ? static_cast<int>(parameters.size()) : 1;
    for (int i = 0; i < count; i += kLawParametersAtOnce) {
      contacts.push_back(request.law != nullptr ? LearnedContact(*request.law, i) : LearnedContact(*request.events, i));
    }
    return contacts;
  }
  Simulators MakeSimulators(const Scene& scene) const {
    Simulators simulators;
    for (const Contact& contact : contacts_) simulators.push_back(MakeSimulator(contact, scene, Precision::kDouble));
    return simulators;
  }

  // The first of each step: until then its discs fly.
  void FindImpacts(MotionAtSamples* out) {
    int last = -1;
    for (const StepTouch& at : simulator_->touches()) {
      if (at.step == last || at.touch.kind != ContactKind::kImpact) continue;
      last = at.step;
      simulator_->GetState(at.step, x_);
      ImpactState impact{at.touch.candidate, {}, {}};
      for (const int disc : {0, 1}) {
        if (disc == 1 && impact.candidate.plane) continue;
        const int body = disc == 0 ? impact.candidate.a : impact.candidate.b;
        std::tie(impact.position[disc], impact.velocity[disc]) = StateAfter(body, at.touch.time);
      }
      if (request_.law != nullptr) out->impact_speeds.push_back(SpeedsOf(impact));
      if (request_.events != nullptr && impact.candidate.plane) out->impacts.push_back(impact);
    }
  }
  // Returns the speeds of approach and of sliding.
  Vec2d SpeedsOf(const ImpactState& impact) const {
    const bool plane = impact.candidate.plane;
    const Separation<double> apart =
        plane ? Separate<double>(impact.position[0], WallPartsOf(scene_)[impact.candidate.b].wall)
              : Separate<double>(impact.position[0], impact.position[1]);
    const Vec2d w = plane ? impact.velocity[0] : Vec2d(impact.velocity[0] - impact.velocity[1]);
    return {std::max(0.0, -Dot(apart.normal, w)), std::abs(Dot(Perpendicular(apart.normal), w))};
  }
  // Returns position and velocity of disc i after flying from x_ for a time.
  std::pair<Vec2d, Vec2d> StateAfter(int i, double time) const {
    const double* x = &x_[i * size()];
    const Vec2d p(x[0], x[1]), v(x[2], x[3]);
    if (scene_.bodies[i].fixed) return {p, v};
    const Vec2d acceleration = InitialAcceleration(scene_, i);
    return {p + time * v + 0.5 * time * time * acceleration, v + time * acceleration};
  }

  double Last() const { return (*request_.samples)[segment_.last - 1].time; }
  int size() const { return simulator_->body_size(); }

  // Discs that spin are moved on step by step, as their rotation has no Jacobian of its own, and so are those that drag
  // or springs act on.
  void FindTouchedSteps() {
    for (const StepTouch& touch : simulator_->touches()) {
      if (touched_.empty() || touched_.back() != touch.step) touched_.push_back(touch.step);
    }
    if (size() == 4 && scene_.forces.empty()) return;
    touched_.resize(simulator_->num_steps());
    for (int k = 0; k < simulator_->num_steps(); ++k) touched_[k] = k;
  }

  void Begin() {
    tangent_ = MatrixXd::Zero(simulator_->state_size(), request_.num_columns());
    int column = static_cast<int>(request_.unknowns.size());
    for (const int body : request_.free_bodies) {
      tangent_.block(body * size(), column, 4, 4).setIdentity();
      column += 4;
    }
    for (std::size_t u = 0; u < request_.unknowns.size(); ++u) {
      const Unknown& unknown = request_.unknowns[u];
      if (unknown.kind == Kind::kPosition) tangent_(unknown.body * size() + unknown.component, u) = 1;
    }
    FindPushes();
    const auto flight = simulator_->FreeFlightOfLength(simulator_->step());
    if (flight) {
      free_ = flight->flight;
      return;
    }
    std::vector<StepLinearization> first;
    Linearize(simulators_, 0, &first);
    free_ = first.front().free;
  }

  // Finds the effect of the unknowns as forces on every disc, and as accelerations of those that fly.
  void FindPushes() {
    const int num_bodies = scene_.num_bodies();
    force_ = MatrixXd::Zero(2 * num_bodies, request_.num_columns());
    acceleration_ = force_;
    for (std::size_t column = 0; column < request_.unknowns.size(); ++column) {
      const Unknown& unknown = request_.unknowns[column];
      const int row = 2 * unknown.body + unknown.component;
      if (unknown.kind == Kind::kForce) {
        force_(row, column) = 1;
        acceleration_(row, column) = 1 / scene_.bodies[unknown.body].mass;
      } else if (unknown.kind == Kind::kMass) {
        const double mass = scene_.bodies[unknown.body].mass;
        for (int c = 0; c < scene_.num_controlled(); ++c) {
          if (scene_.control.bodies[c] != unknown.body) continue;
          acceleration_.block<2, 1>(2 * unknown.body, column) = -scene_.control.initial[c] / (mass * mass);
        }
      } else if (unknown.kind == Kind::kGravity) {
        for (int i = 0; i < num_bodies; ++i) {
          if (scene_.bodies[i].fixed) continue;
          force_(2 * i + unknown.component, column) = scene_.bodies[i].mass;
          acceleration_(2 * i + unknown.component, column) = 1;
        }
      }
    }
  }

  // Moves `tangent` through a step from x_ with contacts.
  void Touch(const Simulators& simulators, int k, GeometrySteps* geometry, MatrixXd* tangent) {
    std::vector<StepLinearization> linear;
    Linearize(simulators, k, &linear);
    Apply(linear, tangent);
    if (!geometry->Add(x_, force_now_, tangent)) has_derivatives_ = false;
  }

  // Linearizes by each of the simulators, whose derivatives differ only in those by parameters of a law.
  void Linearize(const Simulators& simulators, int k, std::vector<StepLinearization>* linear) {
    force_now_.resize(2 * scene_.num_bodies());
    simulator_->GetState(k, x_);
    simulator_->ExpandForce(control_, k, force_now_);
    linear->resize(simulators.size());
    for (std::size_t i = 0; i < simulators.size(); ++i) {
      simulators[i]->Linearize(x_, force_now_, /*with_parameters=*/true, &(*linear)[i]);
    }
  }

  void Fly(const Eigen::Matrix3d& flight, int body, MatrixXd* tangent) const {
    for (int j = 0; j < 2; ++j) {
      const int p = body * size() + j;
      const Eigen::RowVectorXd at = tangent->row(p), moving = tangent->row(p + 2);
      const auto pushed = acceleration_.row(2 * body + j);
      tangent->row(p) = flight(0, 0) * at + flight(0, 1) * moving + flight(0, 2) * pushed;
      tangent->row(p + 2) = flight(1, 0) * at + flight(1, 1) * moving + flight(1, 2) * pushed;
    }
  }

  // Moves `tangent` through one step.
  void Apply(const std::vector<StepLinearization>& all, MatrixXd* tangent) const {
    const StepLinearization& linear = all.front();
    const Eigen::Matrix3d flight = Power(linear.free, 1);
    for (std::size_t f = 0; f < linear.flying.size(); ++f) {
      const int body = linear.flying[f];
      if (!scene_.bodies[body].fixed) Fly(flight, body, tangent);
      if (size() == 4) continue;
      auto rotation = tangent->middleRows(body * size() + 4, size() - 4);
      rotation = (linear.rotation[f] * rotation).eval();
    }
    for (std::size_t q = 0; q < linear.islands.size(); ++q) ApplyIsland(all, q, tangent);
  }

  void ApplyIsland(const std::vector<StepLinearization>& all, std::size_t q, MatrixXd* tangent) const {
    const StepLinearization::Island& island = all.front().islands[q];
    const int n = static_cast<int>(island.bodies.size());
    MatrixXd before(n * size(), tangent->cols()), force(2 * n, tangent->cols());
    for (int i = 0; i < n; ++i) {
      before.middleRows(i * size(), size()) = tangent->middleRows(island.bodies[i] * size(), size());
      force.middleRows(2 * i, 2) = force_.middleRows(2 * island.bodies[i], 2);
    }
    MatrixXd after = Multiply(island.A, before);
    AddProduct(island.B, force, &after);
    for (std::size_t column = 0; column < request_.unknowns.size(); ++column) {
      const Unknown& unknown = request_.unknowns[column];
      const int of_step = ParameterColumn(unknown, island);
      const int simulator = unknown.kind == Kind::kLaw ? unknown.component / kLawParametersAtOnce : 0;
      if (of_step >= 0) after.col(column) += all[simulator].islands[q].P.col(of_step);
    }
    for (int i = 0; i < n; ++i) {
      if (scene_.bodies[island.bodies[i]].fixed) continue;
      tangent->middleRows(island.bodies[i] * size(), size()) = after.middleRows(i * size(), size());
    }
  }

  // In P of a step; -1: none.
  static int ParameterColumn(const Unknown& unknown, const StepLinearization::Island& island) {
    switch (unknown.kind) {
      case Kind::kRestitution:
      case Kind::kFriction: {
        const int friction = unknown.kind == Kind::kFriction;
        if (unknown.component == 0) return friction;
        // The numbers of pairs of materials follow the masses.
        return 4 + static_cast<int>(island.bodies.size()) + 2 * (unknown.component - 1) + friction;
      }
      case Kind::kStiffness:
        return 2;
      case Kind::kDamping:
        return 3;
      case Kind::kMass:
      case Kind::kDrag: {
        const auto found = std::find(island.bodies.begin(), island.bodies.end(), unknown.body);
        if (found == island.bodies.end()) return -1;
        const auto of_drags = static_cast<int>(island.P.cols()) - static_cast<int>(island.bodies.size());
        return (unknown.kind == Kind::kMass ? 4 : of_drags) + static_cast<int>(found - island.bodies.begin());
      }
      case Kind::kLaw: {
        constexpr int kPlaces[kLawParametersAtOnce] = {0, 2, 3};
        return kPlaces[unknown.component % kLawParametersAtOnce];
      }
      default:
        break;
    }
    return -1;
  }

  void FlyTo(int k) {
    if (k == at_) return;
    const Eigen::Matrix3d flight = Power(free_, k - at_);
    for (int body = 0; body < scene_.num_bodies(); ++body) {
      if (!scene_.bodies[body].fixed) Fly(flight, body, &tangent_);
    }
    at_ = k;
  }

  void AdvanceTo(int k) {
    for (; next_touched_ < touched_.size() && touched_[next_touched_] < k; ++next_touched_) {
      FlyTo(touched_[next_touched_]);
      Touch(simulators_, at_, &geometry_, &tangent_);
      ++at_;
    }
    FlyTo(k);
  }

  bool IsTouched(int k) const { return std::binary_search(touched_.begin(), touched_.end(), k); }

  bool TakeSample(const Sample& sample, MotionAtSamples* out) {
    const double h = simulator_->step(), time = sample.time - segment_.begin;
    int k = std::min(static_cast<int>(time / h + kOnNode), simulator_->num_steps());
    const double left = k == simulator_->num_steps() ? 0 : std::max(0.0, time - k * h);
    if (with_derivatives_) AdvanceTo(k);
    const int row = sample.body * size();
    if (left <= kOnNode * h) {
      simulator_->GetState(k, x_);
      Append(x_, tangent_, row, out);
      return true;
    }
    if (!IsPartial(k, left)) MakePartial(k, left);
    Append(partial_state_, partial_tangent_, row, out);
    return std::isfinite(partial_state_[row]);
  }

  void Append(const std::vector<double>& x, const MatrixXd& tangent, int row, MotionAtSamples* out) const {
    out->state.push_back(Eigen::Map<const Eigen::Vector4d>(&x[row]));
    if (with_derivatives_) out->derivative.push_back(tangent.middleRows(row, 4));
  }

  bool IsPartial(int k, double left) const { return k == partial_step_ && left == partial_length_; }

  // The state after a part of step k, and its derivative.
  void MakePartial(int k, double left) {
    partial_step_ = k;
    partial_length_ = left;
    partial_tangent_ = tangent_;
    simulator_->GetState(k, x_);
    const std::optional<VariableFreeFlight> flight = IsTouched(k) ? std::nullopt : simulator_->FreeFlightOfLength(left);
    if (flight) {
      FlyPartial(*flight, k);
      return;
    }
    Scene scene = scene_;
    scene.duration = left;
    scene.steps = FindContactModel(contacts_.front())->grid_steps;
    const Simulators simulators = MakeSimulators(scene);
    std::vector<double> force(2 * scene_.num_bodies());
    simulator_->ExpandForce(control_, k, force);
    partial_state_.resize(x_.size());
    simulators.front()->Step(x_, force, partial_state_);
    if (!with_derivatives_) return;
    GeometrySteps geometry(contacts_.front(), scene, request_.unknowns);
    Touch(simulators, k, &geometry, &partial_tangent_);
  }

  void FlyPartial(const VariableFreeFlight& flight, int k) {
    partial_state_ = x_;
    const Eigen::Matrix3d map = Power(flight.flight, 1);
    std::vector<double> force(2 * scene_.num_bodies());
    simulator_->ExpandForce(control_, k, force);
    for (int body = 0; body < scene_.num_bodies(); ++body) {
      if (scene_.bodies[body].fixed) continue;
      for (int j = 0; j < 2; ++j) {
        const double acceleration = force[2 * body + j] / scene_.bodies[body].mass + scene_.gravity[j];
        const int p = body * size() + j;
        const Eigen::Vector3d after = map * Eigen::Vector3d(x_[p], x_[p + 2], acceleration);
        partial_state_[p] = after[0];
        partial_state_[p + 2] = after[1];
      }
      if (with_derivatives_) Fly(map, body, &partial_tangent_);
    }
  }

  const Segment& segment_;
  const MotionRequest& request_;
  const bool with_derivatives_;
  const std::vector<Contact> contacts_;
  const Scene scene_;
  const Simulators simulators_;
  Simulator* const simulator_;  // the first of them, which rolls out
  GeometrySteps geometry_;      // of a whole step
  bool has_derivatives_ = true;
  std::vector<double> control_;
  std::vector<double> x_, force_now_;  // of the step that was linearized last
  std::vector<int> touched_;           // steps, rising

  // Derivatives of the state in which step at_ begins.
  int at_ = 0;
  std::size_t next_touched_ = 0;
  StepLinearization::FreeFlight free_{};
  MatrixXd tangent_, force_, acceleration_;

  int partial_step_ = -1;
  double partial_length_ = 0;
  std::vector<double> partial_state_;
  MatrixXd partial_tangent_;
};

}  // namespace

MotionAtSamples MoveThrough(const Contact& contact, const Scene& scene, const Segment& segment,
                            const MotionRequest& request, bool with_derivatives) {
  return Sweep(contact, scene, segment, request, with_derivatives).Run();
}

}  // namespace saltus
