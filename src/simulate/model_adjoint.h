// The reverse sweep through a rollout: cotangents of the discs' states, pulled back contact by contact.
//
// A disc is pulled back through its flights only when it touches something, so a step costs nothing but what is done
// with the forces in it.
#pragma once

#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <span>
#include <type_traits>
#include <vector>

#include "saltus/simulate/simulator.h"
#include "simulate/free_flight.h"
#include "simulate/geometry_derivative.h"
#include "simulate/island_derivative.h"
#include "simulate/parameter_derivative.h"
#include "simulate/rollout_record.h"
#include "simulate/stepper.h"
#include "simulate/trajectory.h"
#include "simulate/typed_scene.h"
#include "simulate/wide_loops.h"

namespace saltus {

template <typename S, int kRotation>
class ModelAdjoint {
 public:
  using Model = ContactStep<S, kRotation>;
  static constexpr int kSize = 4 + kRotation;
  using State = BodyState<S, kRotation>;

  // Keeps references to all arguments, which must outlive this object. `scene` is `given` in the simulator's scalar.
  ModelAdjoint(const Model& model, const Scene& given, const TypedScene<S>& scene, const HeldControl<S>& control)
      : model_(model), given_(given), scene_(scene), control_(control), geometry_(model, given, scene) {}
  void set_free_flight(const FreeFlightJacobian<S>& free) { free_ = free; }

  // Begins a sweep. `cotangent` is that of the state in which step k begins.
  void Begin(int k, std::span<const double> cotangent, const SensitivityView& out) {
    out_ = out;
    if (out.parameters != nullptr) ClearParameters(out.parameters);
    if (out.parameters != nullptr) geometry_.Clear();
    lambda_.assign(cotangent.begin(), cotangent.end());
    pulled_to_.assign(scene_.num_bodies(), k);
  }

  // Pulls the discs that touched in step k, by touches first..end-1 of the record, back to its beginning.
  void PullBackStep(int k, int first, int end, const RolloutRecord<State>& record, Stepper<S, kRotation>* stepper,
                    Trajectory<State>* trajectory) {
    control_.SetForce(k, stepper->force(), stepper->torque());
    const std::span<const StepTouch> touches(record.touches().data() + first, end - first);
    stepper->FindTouchedIslands(touches, [](const StepTouch& at) -> const Touch& { return at.touch; });
    for (int q = 0; q < stepper->islands().size(); ++q) {
      const std::span<const int> island = stepper->islands().bodies(q);
      for (int i : island) PullBackTo(k + 1, i, trajectory);
      GatherStates(island, first, end, record, &stepper->local_states());
      stepper->GatherAllButStates(q);
      stepper->local_solved().Assign(stepper->FindSolved(record.solved(), k, q));
      PullBackIsland(k, island, stepper);
    }
  }

  // Pulls a disc back through its flight, to the state in which step k begins. With rotation that needs the states in
  // between.
  void PullBackTo(int k, int i, Trajectory<State>* trajectory) {
    const int steps = pulled_to_[i] - k;
    if (steps <= 0 || scene_.fixed[i]) return;
    pulled_to_[i] = k;
    S* lambda = &lambda_[i * kSize];
    if constexpr (kRotation > 0) PullBackRotation(k, steps, i, trajectory, lambda + 4);
    if (out_.parameters != nullptr) {
      PullBackWithParameters(k, steps, i, lambda);
    } else if (IsControlWanted(i)) {
      PullBackControlled(k, steps, i, lambda);
    } else if constexpr (kRotation > 0) {
      // Steps are taken one by one: memory windows may cut a flight, and the cut must not change a bit.
      PullBackFlight(free_, steps, lambda, [](int, S, S) {});
    } else {
      const FreeFlightJacobian<S> flight = free_.Power(steps);
      for (int j = 0; j < 2; ++j) flight.PullBack(&lambda[j], &lambda[2 + j]);
    }
  }

  // Whether flights need the states in between: those of discs with a rotation whose Jacobian depends on it.
  bool NeedsStates() const { return kRotation > 0 && !IsLinear(); }
  bool AnyRotation() const {
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      for (int j = 4; j < kSize; ++j) {
        if (lambda_[i * kSize + j] != S(0)) return true;
      }
    }
    return false;
  }

  // Ends a sweep. Precondition: all discs have been pulled back to the first state.
  void End() const {
    // Gravity acts as a constant force on every disc.
    for (int i = 0; out_.parameters != nullptr && i < scene_.num_bodies(); ++i) {
      out_.parameters->gravity += double(scene_.bodies[i].mass) * out_.parameters->force[i];
    }
    if (out_.parameters != nullptr) FindDesign(out_.parameters);
    const std::size_t moves = out_.initial.empty() ? 0 : 4 * static_cast<std::size_t>(scene_.num_bodies());
    for (std::size_t i = 0; i < moves; ++i) {
      out_.initial[i] = scene_.fixed[i / 4] ? 0.0 : double(lambda_[i / 4 * kSize + i % 4]);
    }
    for (std::size_t j = 0; moves + j < out_.initial.size(); ++j) {
      const bool spins = scene_.bodies[j / 2].inverse_inertia > S(0);
      out_.initial[moves + j] = spins ? double(lambda_[j / 2 * kSize + 4 + j % 2]) : 0.0;
    }
  }

 private:
  // Flights are pulled back in closed form unless discs rotate (memory windows cut flights, which must not change a
  // bit) or precision is single (derivatives are those of the published programs to the last digits).
  bool IsLinear() const { return model_.properties().linear_rotation; }
  static constexpr bool kFlightsInOneGo = kRotation == 0 && !std::is_same_v<S, float>;
  using RotationMatrix = Eigen::Matrix<S, kRotation, kRotation>;

  void ClearParameters(ParameterGradient* parameters) const {
    parameters->restitution = parameters->friction = parameters->stiffness = parameters->damping = 0;
    parameters->pairs.assign(scene_.pairs.size(), {0, 0});
    parameters->gravity.setZero();
    parameters->mass.assign(scene_.num_bodies(), 0.0);
    parameters->force.assign(scene_.num_bodies(), Vec2d::Zero());
    parameters->inertia.assign(kRotation == kSpin ? scene_.num_bodies() : 0, 0.0);
  }

  static void GatherStates(std::span<const int> island, int first, int end, const RolloutRecord<State>& record,
                           std::vector<State>* x) {
    x->resize(island.size());
    const auto put = [&](int body, const State& state) {
      const auto at = std::lower_bound(island.begin(), island.end(), body);
      if (at != island.end() && *at == body) (*x)[at - island.begin()] = state;
    };
    for (int t = first; t < end; ++t) {
      const Candidate& c = record.touches()[t].touch.candidate;
      const std::array<State, 2>& states = record.StatesOf(t);
      put(c.a, states[0]);
      if (!c.plane) put(c.b, states[1]);
    }
  }

  // Sets the total derivatives by Scene::design from those by the constants of a step.
  void FindDesign(ParameterGradient* parameters) const {
    parameters->design.clear();
    for (std::size_t i = 0; i < given_.design.size(); ++i) {
      const SceneParameter& parameter = given_.design[i].parameter;
      const bool position = parameter.kind == SceneParameter::Kind::kPosition;
      const std::optional<double> by = SceneParameterDerivative(given_, parameter, *parameters);
      parameters->design.push_back(by         ? *by
                                   : position ? lambda_[parameter.body * kSize + parameter.component]
                                              : geometry_.DesignDerivative(i));
    }
  }

  void PullBackIsland(int k, std::span<const int> island, Stepper<S, kRotation>* stepper) {
    const int n = static_cast<int>(island.size());
    const bool with_parameters = out_.parameters != nullptr;
    after_.resize(n * kSize);
    before_.resize(
        IslandDerivative<S, kRotation>::NumColumns(n, scene_.has_torques, with_parameters, scene_.pairs.size()));
    for (int i = 0; i < n; ++i) std::copy_n(&lambda_[island[i] * kSize], kSize, &after_[i * kSize]);
    derivative_.ApplyTranspose(
        model_, stepper->LocalInput(), stepper->local_states(), free_, with_parameters, after_, before_);
    stepper->ReleaseScratch();
    if (with_parameters) geometry_.Add(island, after_, stepper);
    for (int i = 0; i < n; ++i) {
      const int body = island[i];
      if (scene_.fixed[body]) {
        // A fixed disc keeps its position; its cotangent is the derivative by the position as a design parameter.
        if (with_parameters && !given_.design.empty()) std::copy_n(&before_[i * kSize], 2, &lambda_[body * kSize]);
        continue;
      }
      std::copy_n(&before_[i * kSize], kSize, &lambda_[body * kSize]);
      pulled_to_[body] = k;
      const Vec2<S> push(before_[n * kSize + 2 * i], before_[n * kSize + 2 * i + 1]);
      if (IsControlWanted(body)) GradientOf(body, k).Put(0, push[0], push[1]);
      if (with_parameters) AddConstantForce(body, push);
      if (IsTorqueWanted(body)) PutTorque(body, k, before_[n * (kSize + 2) + i]);
    }
    const int parameters = IslandDerivative<S, kRotation>::NumColumns(n, scene_.has_torques);
    if (with_parameters) AddContactParameters(island, &before_[parameters]);
  }

  bool IsControlWanted(int body) const { return control_.Pushes(body) && !out_.control.empty(); }
  bool IsTorqueWanted(int body) const { return control_.HasTorque(body) && !out_.control.empty(); }

  // Stores the sensitivity to the torque on a disc in step k, given the one to torque / radius.
  void PutTorque(int body, int k, S sensitivity) const {
    const std::ptrdiff_t at = control_.TurnOffset(body, k);
    const double by_force = scene_.bodies[body].radius * sensitivity;
    out_.control[at] =
        control_.derivative_unit() * (out_.factor == 0 ? by_force : by_force + out_.factor * out_.addend[at]);
  }

  // The destination of the sensitivities to the forces on one disc, from some step on.
  struct ForceSink {
    double* gradient;
    const double* addend;  // null without
    double factor;
    double unit;            // of the forces, N
    std::ptrdiff_t stride;  // from one step to the next

    void Put(int step, S x, S y) const {
      const std::ptrdiff_t at = step * stride;
      gradient[at] = unit * (addend == nullptr ? x : x + factor * addend[at]);
      gradient[at + 1] = unit * (addend == nullptr ? y : y + factor * addend[at + 1]);
    }

    // Stores scale times the cotangent of step j, for all j < n.
    void PutAll(int n, S scale, const LinearCotangents<S>& cotangents) const {
      const Eigen::Array2d last = (scale * cotangents.last).template cast<double>();
      const Eigen::Array2d change = (scale * cotangents.change).template cast<double>();
      internal::RunWide([&] {
        using Pairs = internal::StepPairs<double>;
        using Pack = Pairs::Pack;
        const ForceSink to = *this;
        const Pack lasts = {last[0], last[1], last[0], last[1]}, changes = {change[0], change[1], change[0], change[1]};
        Pack left = {n - 1.0, n - 1.0, n - 2.0, n - 2.0};  // steps after each
        std::ptrdiff_t at = 0;
        for (int pairs = n / 2; pairs > 0; --pairs, at += 2 * to.stride, left -= 2.0) {
          Pack sum = lasts + left * changes;
          if (to.addend != nullptr) {
            Pack more;
            Pairs::Load(to.addend + at, to.stride, &more);
            sum += to.factor * more;
          }
          sum *= to.unit;
          Pairs::Store(sum, to.stride, to.gradient + at);
        }
        for (int j = 0; n % 2 == 1 && j < 2; ++j) {
          double sum = last[j] + left[j] * change[j];
          if (addend != nullptr) sum += factor * addend[at + j];
          gradient[at + j] = unit * sum;
        }
      });
    }
  };
  ForceSink GradientOf(int body, int k) const {
    const std::ptrdiff_t at = control_.Offset(body, k);
    return {out_.control.data() + at,
            out_.factor == 0 ? nullptr : out_.addend.data() + at,
            out_.factor,
            control_.derivative_unit(),
            control_.stride()};
  }

  void AddContactParameters(std::span<const int> island, const S* gradient) const {
    ParameterGradient& parameters = *out_.parameters;
    parameters.restitution += gradient[0];
    parameters.friction += gradient[1];
    parameters.stiffness += gradient[2];
    parameters.damping += gradient[3];
    const S* further = gradient + IslandDerivative<S, kRotation>::FirstOfPairs(static_cast<int>(island.size()));
    for (std::size_t k = 0; k < parameters.pairs.size(); ++k) {
      const S* of_pair = k == 0 ? gradient : further + 2 * (k - 1);
      parameters.pairs[k].restitution += of_pair[0];
      parameters.pairs[k].friction += of_pair[1];
    }
    for (std::size_t i = 0; i < island.size(); ++i) {
      if (!scene_.fixed[island[i]]) parameters.mass[island[i]] += gradient[4 + i];
    }
    if constexpr (kRotation == kSpin) {
      for (std::size_t i = 0; i < island.size(); ++i) {
        const S inverse = scene_.bodies[island[i]].inverse_inertia;
        parameters.inertia[island[i]] -= gradient[4 + island.size() + i] * inverse * inverse;
      }
    }
  }

  // A constant force acts in every step as the step's own force does.
  void AddConstantForce(int body, const Vec2<S>& push) const {
    out_.parameters->force[body] += push.template cast<double>();
  }

  void PullBackControlled(int k, int steps, int i, S* lambda) const {
    const ForceSink gradient = GradientOf(i, k);
    const S inverse_mass = scene_.bodies[i].inverse_mass;
    if (kFlightsInOneGo && free_.IsShear()) {
      gradient.PutAll(steps, inverse_mass, PullBackShear(free_, steps, lambda));
      return;
    }
    PullBackFlight(free_, steps, lambda, [&](int j, S x, S y) { gradient.Put(j, inverse_mass * x, inverse_mass * y); });
  }

  void PullBackWithParameters(int k, int steps, int i, S* lambda) const {
    const S inverse_mass = scene_.bodies[i].inverse_mass;
    PullBackFlight(free_, steps, lambda, [&](int j, S x, S y) {
      const Vec2<S> push = Scale(inverse_mass, Vec2<S>(x, y));
      AddConstantForce(i, push);
      if (IsControlWanted(i)) GradientOf(i, k + j).Put(0, push[0], push[1]);
      if (const S* u = control_.ForceOn(i, k + j)) {
        const S unit = S(control_.unit());
        out_.parameters->mass[i] -= Dot(push, Vec2<S>(unit * u[0], unit * u[1])) * inverse_mass;
      }
    });
  }

  // Pulls back the rotation of a disc with a torque.
  void PullBackTurn(int k, int steps, int i, Trajectory<State>* trajectory, S* lambda) {
    const BodyConstants<S>& body = scene_.bodies[i];
    Eigen::Map<Eigen::Matrix<S, 2, 1>> cotangent(lambda);
    const bool none = cotangent.isZero(S(0));
    Eigen::Matrix<S, 2, 3> jacobian = Eigen::Matrix<S, 2, 3>::Zero();
    if (IsLinear()) jacobian = DifferentiateTurn(model_, scene_.h, body, model_.properties().at_rest, S(0));
    for (int j = k + steps - 1; j >= k; --j) {
      const S torque = control_.Torque(i, j);
      if (!IsLinear() && !none) {
        jacobian = DifferentiateTurn(model_, scene_.h, body, trajectory->StateAt(j)[i], torque);
      }
      const Eigen::Matrix<S, 3, 1> before = jacobian.transpose() * cotangent;
      if (IsTorqueWanted(i)) PutTorque(i, j, before[2]);
      if (out_.parameters != nullptr) out_.parameters->inertia[i] -= before[2] * torque * body.inverse_inertia;
      cotangent = before.template head<2>();
    }
  }

  // Pulls back the rotation of a disc without a torque through its flight.
  void PullBackRotation(int k, int steps, int i, Trajectory<State>* trajectory, S* lambda) {
    Eigen::Map<Eigen::Matrix<S, kRotation, 1>> cotangent(lambda);
    if constexpr (kRotation == kSpin) {
      if (control_.HasTorque(i)) return PullBackTurn(k, steps, i, trajectory, lambda);
    }
    if (cotangent.isZero(S(0))) return;
    RotationMatrix jacobian = RotationMatrix::Zero();
    if (IsLinear()) {
      jacobian = DifferentiateRotation(model_, scene_.h, scene_.bodies[i], model_.properties().at_rest);
      for (int j = 0; j < steps; ++j) cotangent = (jacobian.transpose() * cotangent).eval();
      return;
    }
    const State* at = nullptr;  // where `jacobian` is; a disc that does not spin keeps it
    for (int j = k + steps - 1; j >= k; --j) {
      const State& x = trajectory->StateAt(j)[i];
      if (at == nullptr || !std::equal(x.rotation, x.rotation + kRotation, at->rotation)) {
        jacobian = DifferentiateRotation(model_, scene_.h, scene_.bodies[i], x);
        at = &x;
      }
      cotangent = (jacobian.transpose() * cotangent).eval();
    }
  }

  const Model& model_;
  const Scene& given_;
  const TypedScene<S>& scene_;
  const HeldControl<S>& control_;
  GeometryDerivative<S, kRotation> geometry_;
  FreeFlightJacobian<S> free_{};
  SensitivityView out_;
  std::vector<S> lambda_;          // B x kSize: of disc i the cotangent of its state in which step pulled_to_[i] begins
  std::vector<int> pulled_to_;     // B
  std::vector<S> after_, before_;  // of an island
  IslandDerivative<S, kRotation> derivative_;
};

}  // namespace saltus
