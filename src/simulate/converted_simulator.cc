#include "simulate/converted_simulator.h"

#include <glog/logging.h>

#include <utility>
#include <vector>

#include "saltus/control/contact_sequence.h"
#include "scene/units.h"
#include "simulate/lane_simulator.h"

namespace saltus {
namespace {

class ConvertedSimulator final : public LaneSimulator {
 public:
  ConvertedSimulator(const Scene& scene, std::unique_ptr<Simulator> inner)
      : LaneSimulator(scene, inner->precision(), scene.steps / inner->num_steps()),
        inner_(std::move(inner)),
        inner_lanes_(dynamic_cast<LaneSimulator*>(inner_.get())),
        to_inner_(scene_.units, inner_->scene().units),
        to_outer_(inner_->scene().units, scene_.units) {
    CHECK_EQ(num_steps_, inner_->num_steps());
  }

  const ModelTraits& traits() const override { return inner_->traits(); }
  int body_size() const override { return inner_->body_size(); }
  std::size_t LeastMemory() const override { return inner_->LeastMemory(); }
  const std::vector<StepTouch>& touches() const override { return touches_; }

  bool Rollout(std::span<const double> initial, std::span<const double> control) override {
    control_.resize(control.size());
    for (std::size_t i = 0; i < control.size(); ++i) control_[i] = to_inner_.force * control[i];
    Begin(initial);
    return End(inner_->Rollout(initial_, control_));
  }

  bool HasLanes() const override { return inner_lanes_ != nullptr && inner_lanes_->HasLanes(); }
  void RolloutTogether(std::span<Motion> motions, double force_unit,
                       const std::array<std::ptrdiff_t, 2>& ahead) override {
    std::vector<Motion> inner;
    for (const Motion& motion : motions) {
      auto* const simulator = static_cast<ConvertedSimulator*>(motion.simulator);
      simulator->Begin(motion.initial);
      simulator->converts_control_ = false;
      inner.push_back({simulator->inner_lanes_, simulator->initial_, motion.control});
    }
    inner_lanes_->RolloutTogether(inner, to_inner_.force * force_unit, ahead);
    for (std::size_t i = 0; i < motions.size(); ++i) {
      motions[i].ok = static_cast<ConvertedSimulator*>(motions[i].simulator)->End(inner[i].ok);
    }
  }

  void GetState(int k, std::span<double> x) const override {
    inner_->GetState(k, x);
    Convert(inner_->scene().units, scene_.units, body_size(), x, x);
  }

  void AdjointInto(std::span<const double> cotangent, const SensitivityView& out) override {
    cotangent_.assign(cotangent.begin(), cotangent.end());
    for (std::size_t i = 0; i < cotangent_.size(); ++i) cotangent_[i] *= FactorOf(to_outer_, i, body_size());
    SensitivityView inner = out;
    inner.factor *= to_outer_.force;
    inner_->AdjointInto(cotangent_, inner);
    const std::size_t moves = 4 * static_cast<std::size_t>(num_bodies());
    for (std::size_t i = 0; i < out.initial.size(); ++i) {
      out.initial[i] *= i < moves ? FactorOf(to_inner_, i, 4) : FactorOf(to_inner_, 4 + (i - moves) % kSpin, 4 + kSpin);
    }
    for (double& entry : out.control.first(converts_control_ ? out.control.size() : 0)) entry *= to_inner_.force;
    if (out.parameters != nullptr) ConvertParameters(out.parameters);
  }

  void Step(std::span<const double> x, std::span<const double> force, std::span<double> next,
            std::vector<Touch>* touches) const override {
    const std::size_t known = touches == nullptr ? 0 : touches->size();
    inner_->Step(InnerState(x), InnerForce(force), next, touches);
    Convert(inner_->scene().units, scene_.units, body_size(), next, next);
    for (std::size_t i = known; touches != nullptr && i < touches->size(); ++i) ConvertTime(&(*touches)[i]);
  }

  void Linearize(std::span<const double> x, std::span<const double> force, bool with_parameters,
                 StepLinearization* linearization) const override {
    inner_->Linearize(InnerState(x), InnerForce(force), with_parameters, linearization);
    ConvertFlight(&linearization->free);
    for (double& inverse_mass : linearization->inverse_mass) inverse_mass *= to_inner_.mass;
    for (StepLinearization::Island& island : linearization->islands) ConvertIsland(&island);
    for (Eigen::MatrixXd& turn : linearization->rotation) ConvertTurn(&turn);
    for (Eigen::Vector2d& by_force : linearization->by_torque) {
      for (int row = 0; row < 2; ++row) by_force[row] *= FactorOf(to_outer_, 4 + row, body_size()) * to_inner_.force;
    }
  }

  std::optional<VariableFreeFlight> FreeFlightOfLength(double h) const override {
    std::optional<VariableFreeFlight> over = inner_->FreeFlightOfLength(h * to_inner_.time);
    if (!over) return over;
    ConvertFlight(&over->flight);
    ConvertFlight(&over->by_time);
    ConvertTurning(&over->turn);
    ConvertTurning(&over->turn_by_time);
    for (StepLinearization::FreeFlight* by : {&over->by_time, &over->turn_by_time}) {
      for (double* entry : {&by->pp, &by->pv, &by->pa, &by->vp, &by->vv, &by->va}) *entry *= to_inner_.time;
    }
    return over;
  }

  void ExpandInitial(std::span<const double> initial, std::span<double> x) const override {
    std::vector<double> inner(initial.size());
    ConvertInitial(initial, inner);
    inner_->ExpandInitial(inner, x);
    Convert(inner_->scene().units, scene_.units, body_size(), x, x);
  }

 private:
  // Returns the factor of entry i of states with `body_size` numbers a disc. A model's own rotation stays in SI units.
  static double FactorOf(const UnitFactors& factors, std::size_t i, int body_size) {
    const std::size_t entry = i % body_size;
    if (body_size == 4 + kSpin && entry == 5) return factors.rate;
    return entry < 2 ? factors.length : entry < 4 ? factors.speed : 1.0;
  }

  void Begin(std::span<const double> initial) {
    initial_.resize(initial.size());
    ConvertInitial(initial, initial_);
    converts_control_ = true;
    inner_->set_memory_limit(memory_limit_);
    inner_->set_stop(stop_);
    inner_->set_tie_order(tie_order_);
  }
  // Takes over the failure, touches and ties of a rollout. Returns `ok`.
  bool End(bool ok) {
    failure_ = FailureOf(*inner_);
    touches_ = inner_->touches();
    for (StepTouch& at : touches_) ConvertTime(&at.touch);
    ties_ = inner_->ties();
    for (StepTie& tie : ties_) tie.contact.time *= to_outer_.time;
    return ok;
  }

  void ConvertFlight(StepLinearization::FreeFlight* flight) const {
    flight->pv *= to_inner_.speed * to_outer_.length;
    flight->pa *= to_inner_.acceleration * to_outer_.length;
    flight->vp *= to_inner_.length * to_outer_.speed;
    flight->va *= to_inner_.acceleration * to_outer_.speed;
  }

  // Converts the derivatives of angle, angular velocity and angular acceleration.
  void ConvertTurning(StepLinearization::FreeFlight* turn) const {
    turn->pv *= to_inner_.rate;
    turn->pa *= to_inner_.rate * to_inner_.rate;
    turn->vp *= to_outer_.rate;
    turn->va *= to_inner_.rate;
  }

  // Converts states with `body_size` numbers a disc; `out` may be `in`.
  static void Convert(const Units& from, const Units& to, int body_size, std::span<const double> in,
                      std::span<double> out) {
    const UnitFactors factors(from, to);
    for (std::size_t i = 0; i + body_size <= in.size(); i += body_size) {
      const Vec2d position = ConvertPosition({in[i], in[i + 1]}, from, to);
      out[i] = position[0];
      out[i + 1] = position[1];
      for (std::size_t j = i + 2; j < i + body_size; ++j) out[j] = in[j] * FactorOf(factors, j - i, body_size);
    }
  }

  // Converts an initial state: the states of the discs, then their rotations, if there are any.
  void ConvertInitial(std::span<const double> initial, std::span<double> inner) const {
    const std::size_t moves = 4 * static_cast<std::size_t>(num_bodies());
    Convert(scene_.units, inner_->scene().units, 4, initial.first(moves), inner.first(moves));
    for (std::size_t i = moves; i < initial.size(); ++i) {
      inner[i] = initial[i] * FactorOf(to_inner_, 4 + (i - moves) % kSpin, 4 + kSpin);
    }
  }

  std::vector<double> InnerState(std::span<const double> x) const {
    std::vector<double> inner(x.size());
    Convert(scene_.units, inner_->scene().units, body_size(), x, inner);
    return inner;
  }
  std::vector<double> InnerForce(std::span<const double> force) const {
    std::vector<double> inner(force.begin(), force.end());
    for (double& entry : inner) entry *= to_inner_.force;
    return inner;
  }

  void ConvertTime(Touch* touch) const {
    if (touch->time > 0) touch->time *= to_outer_.time;  // those that are not resolved are negative
  }

  void ConvertIsland(StepLinearization::Island* island) const {
    for (Eigen::Index row = 0; row < island->A.rows(); ++row) {
      const double by = FactorOf(to_outer_, row, body_size());
      island->A.row(row) *= by;
      island->B.row(row) *= by;
      if (island->P.cols() > 0) island->P.row(row) *= by;
    }
    for (Eigen::Index column = 0; column < island->A.cols(); ++column) {
      island->A.col(column) *= FactorOf(to_inner_, column, body_size());
    }
    island->B *= to_inner_.force;
    const auto discs = static_cast<Eigen::Index>(island->bodies.size());
    const Eigen::Index of_discs = 4 + (scene_.Spins() ? 2 : 1) * discs;  // restitution and friction of pairs follow
    for (Eigen::Index column = 2; column < std::min(of_discs, island->P.cols()); ++column) {
      const bool mass = column < 4 + discs;
      island->P.col(column) *= column == 2   ? Stiffness()
                               : column == 3 ? Damping()
                               : mass        ? to_inner_.mass
                                             : 1 / to_inner_.moment_of_inertia;
    }
    if (island->P.cols() > 0 && !NonBallisticForces(scene_).empty())
      island->P.rightCols(discs) *= Damping();  // of drag
  }

  // Converts the derivative of a flying disc's rotation after a step by that before.
  void ConvertTurn(Eigen::MatrixXd* turn) const {
    for (Eigen::Index row = 0; row < turn->rows(); ++row) {
      for (Eigen::Index column = 0; column < turn->cols(); ++column) {
        (*turn)(row, column) *=
            FactorOf(to_outer_, 4 + row, body_size()) * FactorOf(to_inner_, 4 + column, body_size());
      }
    }
  }

  void ConvertParameters(ParameterGradient* gradient) const {
    gradient->stiffness *= Stiffness();
    gradient->damping *= Damping();
    gradient->gravity *= to_inner_.acceleration;
    for (double& mass : gradient->mass) mass *= to_inner_.mass;
    for (double& inertia : gradient->inertia) inertia *= to_inner_.moment_of_inertia;
    for (double& drag : gradient->drag) drag *= Damping();
    for (Vec2d& force : gradient->force) force *= to_inner_.force;
    for (std::size_t i = 0; i < gradient->design.size(); ++i) {
      gradient->design[i] *= to_inner_.of(scene_.design[i].parameter);
    }
  }

  double Stiffness() const { return to_inner_.force / to_inner_.length; }
  double Damping() const { return to_inner_.force / to_inner_.speed; }

  std::unique_ptr<Simulator> inner_;
  LaneSimulator* inner_lanes_;    // the same, if it is one
  bool converts_control_ = true;  // false if the last rollout of `inner_` was under the control as it is given
  UnitFactors to_inner_, to_outer_;
  std::vector<StepTouch> touches_;
  std::vector<double> initial_, control_, cotangent_;
};

}  // namespace

std::unique_ptr<Simulator> ConvertUnits(const Scene& scene, std::unique_ptr<Simulator> inner) {
  return std::make_unique<ConvertedSimulator>(scene, std::move(inner));
}

}  // namespace saltus
