// The engine: a contact model's step bound to a scene.
//
// StepSimulator steps a scene with plain scalars and records what touched. While no disc can have met another
// (broad_phase.h), each flies by itself; otherwise the scene is stepped island by island (stepper.h). Derivatives
// follow from the record (model_adjoint.h): discs that fly have a constant Jacobian (free_flight.h), found once by
// differentiating the model's free flight; islands of discs that touched are differentiated with Jets
// (island_derivative.h).
//
// Memory: one window of states and one state per further window (trajectory.h), the control, and per contact and step
// what derivatives need (rollout_record.h).
#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <utility>

#include "simulate/free_flight.h"
#include "simulate/island_derivative.h"
#include "simulate/lane_simulator.h"
#include "simulate/model_adjoint.h"
#include "simulate/rollout_record.h"
#include "simulate/stepper.h"
#include "simulate/trajectory.h"
#include "simulate/typed_scene.h"

namespace saltus {
namespace {

template <typename S, int kRotation>
class StepSimulator final : public LaneSimulator {
 public:
  using Model = ContactStep<S, kRotation>;
  static constexpr int kSize = 4 + kRotation;
  using State = BodyState<S, kRotation>;

  StepSimulator(const Scene& scene, Precision precision, std::unique_ptr<const Model> model)
      : LaneSimulator(scene, precision, model->traits().grid_steps),
        model_(std::move(model)),
        typed_(scene, step()),
        control_(scene),
        stepper_(*model_, typed_, step()),
        flight_control_(scene.bodies.size()),
        adjoint_(*model_, scene_, typed_, control_) {
    free_ = DifferentiateFreeFlight(*model_, typed_.h, /*offset=*/S(0));
    free_is_affine_ = free_ == DifferentiateFreeFlight(*model_, typed_.h, /*offset=*/S(1));
    adjoint_.set_free_flight(free_);
  }
  StepSimulator(const StepSimulator&) = delete;  // its parts refer to each other
  StepSimulator& operator=(const StepSimulator&) = delete;

  const ModelTraits& traits() const override { return model_->traits(); }
  int body_size() const override { return kSize; }
  const std::vector<StepTouch>& touches() const override { return record_.touches(); }
  std::size_t LeastMemory() const override {
    const std::size_t state = num_bodies() * sizeof(State);
    const int length = WindowLength(num_steps_, state, 0);
    return (length + 1 + (num_steps_ + length - 1) / length) * state;
  }

  bool Rollout(std::span<const double> initial, std::span<const double> control) override {
    control_.Resize(control.size());
    if (!Begin(initial, control)) return false;
    for (int w = 0; w < trajectory_.num_windows(); ++w) {
      KeepWithinMemory();
      control_.Copy(trajectory_.begin(w), trajectory_.end(w), control);
      RunWindow(w, [&](int k) { Record(k); });
      if (!IsGoingOn()) return false;
    }
    return IsEndFinite();
  }

  bool HasLanes() const override { return Model::kInLanes; }
  void RolloutTogether(std::span<Motion> motions, double force_unit,
                       const std::array<std::ptrdiff_t, 2>& ahead) override {
    if constexpr (Model::kInLanes) {
      CHECK_LE(motions.size(), std::size_t{kLanes});
      std::array<Flights, kLanes> flights;
      for (std::size_t lane = 0; lane < motions.size(); ++lane) {
        Motion& motion = motions[lane];
        StepSimulator* const simulator = flights[lane].simulator = static_cast<StepSimulator*>(motion.simulator);
        simulator->control_.Refer(motion.control, force_unit);
        motion.ok = simulator->Begin(motion.initial, motion.control);
      }
      for (int w = 0; w < flights[0].simulator->trajectory_.num_windows(); ++w) {
        for (std::size_t lane = 0; lane < motions.size(); ++lane) {
          if (motions[lane].ok) flights[lane].simulator->BeginTogether(w, &flights[lane]);
        }
        FlyTogether(w, force_unit, ahead, flights);
        for (std::size_t lane = 0; lane < motions.size(); ++lane) {
          if (!motions[lane].ok) continue;
          flights[lane].simulator->trajectory_.Close();
          motions[lane].ok = flights[lane].simulator->IsGoingOn();
        }
      }
      for (std::size_t lane = 0; lane < motions.size(); ++lane) {
        motions[lane].ok = motions[lane].ok && flights[lane].simulator->IsEndFinite();
      }
    }
  }

  void GetState(int k, std::span<double> x) const override {
    CHECK(k >= 0 && k <= num_steps_) << "found state " << k << ", expected 0 to " << num_steps_;
    CHECK_EQ(static_cast<int>(x.size()), state_size());
    const int w = trajectory_.WindowOf(k);
    if (!trajectory_.Holds(w) && !(k == num_steps_ && trajectory_.HoldsEnd())) RunWindow(w, [](int) {});
    const S* flat = Flat(trajectory_.StateAt(k).data());
    std::copy(flat, flat + state_size(), x.begin());
  }

  void AdjointInto(std::span<const double> cotangent, const SensitivityView& out) override {
    CHECK_EQ(static_cast<int>(cotangent.size()), state_size());
    CHECK(out.initial.empty() || static_cast<int>(out.initial.size()) == initial_size());
    CHECK(out.control.empty() || static_cast<int>(out.control.size()) == control_size());
    CHECK(out.factor == 0 || out.addend.size() == out.control.size());
    adjoint_.Begin(num_steps_, cotangent, out);
    int end = record_.size();
    for (int w = trajectory_.num_windows() - 1; w >= 0; --w) {
      const int begin = record_.First(trajectory_.begin(w), end);
      Reload(w, begin, end);
      while (end > begin) {
        if (stopped()) return;
        const int k = record_.touches()[end - 1].step;
        const int first = record_.First(k, end);
        adjoint_.PullBackStep(k, first, end, record_, &stepper_, &trajectory_);
        end = first;
      }
      // Rotation needs the states on the way, which are at hand now.
      for (int i = 0; kRotation > 0 && i < num_bodies(); ++i)
        adjoint_.PullBackTo(trajectory_.begin(w), i, &trajectory_);
    }
    for (int i = 0; i < num_bodies(); ++i) adjoint_.PullBackTo(0, i, &trajectory_);
    adjoint_.End();
  }

  void Step(std::span<const double> x, std::span<const double> force, std::span<double> next,
            std::vector<Touch>* touches) const override {
    CHECK_EQ(static_cast<int>(next.size()), state_size());
    std::vector<State> from(num_bodies()), to(num_bodies());
    const Stepper<S, kRotation> stepper = StepOnce(x, force, &from, &to);
    std::copy(Flat(to.data()), Flat(to.data()) + state_size(), next.begin());
    if (stepper.failure()) std::fill(next.begin(), next.end(), std::numeric_limits<double>::quiet_NaN());
    if (touches != nullptr) *touches = stepper.touches();
  }

  void Linearize(std::span<const double> x, std::span<const double> force, bool with_parameters,
                 StepLinearization* linearization) const override {
    std::vector<State> from(num_bodies()), to(num_bodies());
    Stepper<S, kRotation> stepper = StepOnce(x, force, &from, &to);
    IslandDerivative<S, kRotation> derivative;

    StepLinearization& out = *linearization;
    out.body_size = kSize;
    out.free = {
        double(free_.pp), double(free_.pv), double(free_.pa), double(free_.vp), double(free_.vv), double(free_.va)};
    out.inverse_mass.assign(num_bodies(), 0.0);
    for (int i = 0; i < num_bodies(); ++i) out.inverse_mass[i] = typed_.bodies[i].inverse_mass;
    out.has_torques = typed_.has_torques;
    out.islands.clear();
    out.flying.clear();
    out.rotation.clear();
    out.by_torque.clear();
    std::vector<char> flying(num_bodies(), 1);
    stepper.FindTouchedIslands(stepper.touches(), [](const Touch& touch) -> const Touch& { return touch; });
    for (int q = 0; q < stepper.islands().size(); ++q) {
      const std::span<const int> island = stepper.islands().bodies(q);
      for (int i : island) flying[i] = 0;
      stepper.Gather(q, from);
      stepper.local_solved().Clear();
      typename IslandDerivative<S, kRotation>::Matrix jacobian;
      derivative.Evaluate(*model_, stepper.LocalInput(), stepper.local_states(), with_parameters, &jacobian);
      stepper.ReleaseScratch();
      const int n = static_cast<int>(island.size());
      Eigen::MatrixXd wide = jacobian.template cast<double>();
      const int forces = (typed_.has_torques ? 3 : 2) * n;
      for (int i = 0; i < forces - 2 * n; ++i) {
        wide.col(n * (kSize + 2) + i) *= double(typed_.bodies[island[i]].radius);
      }
      out.islands.push_back({{island.begin(), island.end()},
                             wide.leftCols(n * kSize),
                             wide.middleCols(n * kSize, forces),
                             wide.rightCols(wide.cols() - n * kSize - forces)});
    }
    for (int i = 0; i < num_bodies(); ++i) {
      if (!flying[i]) continue;
      out.flying.push_back(i);
      if constexpr (kRotation > 0) {
        out.rotation.push_back(
            DifferentiateRotation(*model_, typed_.h, typed_.bodies[i], from[i]).template cast<double>());
      }
      if constexpr (kRotation == kSpin) {
        if (!typed_.has_torques) continue;
        const BodyConstants<S>& body = typed_.bodies[i];
        const auto turn = DifferentiateTurn(*model_, typed_.h, body, from[i], stepper.torque()[i]);
        out.rotation.back() = turn.template leftCols<2>().template cast<double>();
        out.by_torque.push_back(double(body.radius) * turn.col(2).template cast<double>());
      }
    }
  }

  std::optional<VariableFreeFlight> FreeFlightOfLength(double h) const override {
    return DifferentiateByLength(*model_, h);
  }

  void ExpandInitial(std::span<const double> initial, std::span<double> x) const override {
    CHECK_EQ(static_cast<int>(initial.size()), initial_size());
    CHECK_EQ(static_cast<int>(x.size()), state_size());
    std::vector<State> state(num_bodies());
    Expand(initial, state.data());
    std::copy(Flat(state.data()), Flat(state.data()) + state_size(), x.begin());
  }

 private:
  // The number of tied contacts in a rollout after which no more ties are looked for.
  static constexpr std::size_t kMostTies = 256;

  static const S* Flat(const State* x) { return reinterpret_cast<const S*>(x); }
  static S* Flat(State* x) { return reinterpret_cast<S*>(x); }

  bool AllFinite(std::span<const State> x) const {
    return std::all_of(Flat(x.data()), Flat(x.data()) + state_size(), [](S value) { return std::isfinite(value); });
  }

  void Expand(std::span<const double> initial, State* x) const {
    for (int i = 0; i < num_bodies(); ++i) {
      const double* from = &initial[4 * i];
      x[i] = model_->properties().at_rest;
      x[i].p = Vec2<S>(S(from[0]), S(from[1]));
      if (!typed_.fixed[i]) x[i].v = Vec2<S>(S(from[2]), S(from[3]));
    }
    const std::size_t moves = 4 * static_cast<std::size_t>(num_bodies());
    if constexpr (kRotation == kSpin) {
      for (std::size_t j = 0; moves + j < initial.size(); ++j) x[j / 2].rotation[j % 2] = S(initial[moves + j]);
    }
  }

  // Prepares a rollout; returns false if there cannot be one.
  bool Begin(std::span<const double> initial, std::span<const double> control) {
    CHECK_EQ(static_cast<int>(initial.size()), initial_size());
    CHECK_EQ(static_cast<int>(control.size()), control_size());
    trajectory_.Resize(num_bodies(), num_steps_, memory_limit_);
    Expand(initial, trajectory_.Checkpoint(0).data());
    record_.Clear();
    ties_.clear();
    all_recorded_ = true;
    failure_.reset();
    stepper_.set_tie_order(tie_order_);
    if (!free_is_affine_) {
      failure_ = {0, -1, "free flight is not affine and isotropic, or its derivative depends on the state"};
    }
    return free_is_affine_;
  }
  void KeepWithinMemory() {
    if (trajectory_.bytes() + record_.bytes_of_states() > memory_limit_) all_recorded_ = false;
    if (!all_recorded_) record_.ForgetStates(record_.size());
  }
  void Record(int k) {
    record_.AddTouches(k, stepper_.touches());
    for (const TiedContact& contact : stepper_.ties()) ties_.push_back({k, contact});
    RecordStates(k);
  }
  // Whether the rollout continues after a window: no step has failed, and nobody has stopped it.
  bool IsGoingOn() {
    if (stepper_.failure()) failure_ = stepper_.failure();
    return !failure_ && !stopped();
  }
  bool IsEndFinite() {
    if (!AllFinite(trajectory_.StateAt(num_steps_))) failure_.emplace();
    return !failure_;
  }

  // Runs the steps of window w from its checkpoint and calls record(k) for each step in which something touched, with
  // the stepper as that step has left it. Ends early if a step fails.
  template <typename RecordStep>
  void RunWindow(int w, const RecordStep& record) const {
    control_.CopyReferred();
    int k = BeginWindow(w, /*whole=*/true);
    while (const int steps = StepUntilFlight(&k, trajectory_.end(w), record)) {
      Fly(k, steps);
      k += steps;
    }
    trajectory_.Close();
  }
  // Returns the window's first step.
  int BeginWindow(int w, bool whole) const {
    const int begin = trajectory_.begin(w), end = trajectory_.end(w);
    trajectory_.Open(w, whole);
    push_.assign(num_bodies(), scene_.gravity.norm());
    control_.AddLargestAccelerations(begin, end, typed_.bodies, push_);
    stepper_.Begin(push_);
    return begin;
  }
  // Takes steps from step *k on until all discs fly, and returns for how many steps they do; 0 at `end`, and if a step
  // fails.
  template <typename RecordStep>
  int StepUntilFlight(int* k, int end, const RecordStep& record) const {
    for (; *k < end && !stopped(); ++*k) {
      const int quiet = stepper_.FindCandidates(trajectory_.StateAt(*k));
      if (stepper_.HasNoCandidates()) return std::min(quiet, end - *k);
      control_.SetForce(*k, stepper_.force(), stepper_.torque());
      stepper_.set_finds_ties(ties_.size() < kMostTies);
      stepper_.Step(*k, trajectory_.StateAt(*k), trajectory_.StateAt(*k + 1));
      if (stepper_.failure()) return 0;
      if (!stepper_.touches().empty()) record(*k);
    }
    return 0;
  }

  // One of several motions that are simulated together, and its next flight.
  struct Flights {
    StepSimulator* simulator = nullptr;
    int k = 0, steps = 0;
  };
  void BeginTogether(int w, Flights* flights) {
    KeepWithinMemory();
    flights->k = BeginWindow(w, /*whole=*/false);
    StepTogether(w, flights);
  }
  void StepTogether(int w, Flights* flights) {
    flights->steps = StepUntilFlight(&flights->k, trajectory_.end(w), [this](int k) { Record(k); });
  }
  // Simulates all motions to the end of window w.
  void FlyTogether(int w, double force_unit, const std::array<std::ptrdiff_t, 2>& ahead,
                   std::array<Flights, kLanes>& flights) const {
    FlightsInput in;
    in.step.h = typed_.h;
    in.step.gravity = typed_.gravity;
    in.stride = control_.stride();
    in.unit = force_unit;
    in.ahead = ahead;
    while (std::ranges::any_of(flights, [](const Flights& next) { return next.steps > 0; })) {
      for (int i = 0; i < num_bodies(); ++i) {
        in.step.bodies = {&typed_.bodies[i], 1};
        std::array<State*, kLanes> at{};
        for (int lane = 0; lane < kLanes; ++lane) {
          const auto& [simulator, k, steps] = flights[lane];
          in.steps[lane] = steps;
          if (steps == 0) continue;
          in.force[lane] = simulator->control_.ForceOn(i, k);
          at[lane] = simulator->trajectory_.StateAt(k + steps).data() + i;
          *at[lane] = simulator->trajectory_.StateAt(k)[i];
        }
        model_->FlyTogether(in, at);
      }
      for (Flights& next : flights) {
        if (next.steps == 0) continue;
        next.k += next.steps;
        next.simulator->StepTogether(w, &next);
      }
    }
  }

  void RecordStates(int k) const { record_.AddStates(stepper_.touches(), trajectory_.StateAt(k), stepper_.solved()); }

  // Loads the data that the adjoint through window w needs. Its touches are begin..end-1.
  void Reload(int w, int begin, int end) {
    const bool forgotten = !all_recorded_ && begin < end && record_.first_with_states() != begin;
    const bool turns = adjoint_.NeedsStates() && !trajectory_.Holds(w) && (begin < end || adjoint_.AnyRotation());
    if (!forgotten && !turns) return;
    if (forgotten) record_.ForgetStates(begin);
    RunWindow(w, [&](int k) {
      if (forgotten) RecordStates(k);
    });
  }

  // Moves all discs in free flight for some steps from step k on.
  void Fly(int k, int steps) const {
    for (int i = 0; i < num_bodies(); ++i) flight_control_[i] = {control_.ForceOn(i, k), control_.TorqueOn(i, k)};
    FlightInput<S> flight;
    flight.step.h = typed_.h;
    flight.step.gravity = typed_.gravity;
    flight.step.bodies = typed_.bodies;
    flight.steps = steps;
    flight.control = flight_control_;
    flight.stride = control_.stride();
    model_->Fly(flight, trajectory_.StateAt(k).data());
  }

  // Takes one step of the whole scene from a state in doubles.
  Stepper<S, kRotation> StepOnce(std::span<const double> x, std::span<const double> force, std::vector<State>* from,
                                 std::vector<State>* to) const {
    CHECK_EQ(static_cast<int>(x.size()), state_size());
    CHECK_EQ(static_cast<int>(force.size()), force_size());
    Stepper<S, kRotation> stepper(*model_, typed_, step());
    std::copy(x.begin(), x.end(), Flat(from->data()));
    std::vector<double> push(num_bodies());
    for (int i = 0; i < num_bodies(); ++i) {
      push[i] =
          scene_.gravity.norm() + std::hypot(force[2 * i], force[2 * i + 1]) * double(typed_.bodies[i].inverse_mass);
    }
    const auto torque = [&](int i) { return typed_.bodies[i].radius * S(force[2 * num_bodies() + i]); };
    for (int i = 0; typed_.has_torques && i < num_bodies(); ++i) {
      push[i] += HeldControl<S>::AccelerationByTorque(typed_.bodies[i], std::abs(double(torque(i))));
    }
    stepper.set_tie_order(tie_order_);
    stepper.Begin(push);
    for (int i = 0; i < num_bodies(); ++i) stepper.force()[i] = Vec2<S>(S(force[2 * i]), S(force[2 * i + 1]));
    for (int i = 0; typed_.has_torques && i < num_bodies(); ++i) stepper.torque()[i] = torque(i);
    stepper.FindCandidates(*from);
    stepper.StepWithoutIslands(*from, *to);
    return stepper;
  }

  const std::unique_ptr<const Model> model_;
  const TypedScene<S> typed_;
  FreeFlightJacobian<S> free_{};
  bool free_is_affine_ = true;

  // The last rollout. A query for a state may simulate its window again.
  mutable HeldControl<S> control_;
  mutable Trajectory<State> trajectory_;
  mutable Stepper<S, kRotation> stepper_;
  mutable RolloutRecord<State> record_;
  mutable std::vector<double> push_;
  mutable std::vector<typename FlightInput<S>::Control> flight_control_;
  bool all_recorded_ = true;  // false if the states of some touches were let go for the sake of memory_limit()
  ModelAdjoint<S, kRotation> adjoint_;
};

}  // namespace

template <typename S, int kRotation>
std::unique_ptr<Simulator> MakeStepSimulator(const Scene& scene, Precision precision,
                                             std::unique_ptr<const ContactStep<S, kRotation>> step) {
  return std::make_unique<StepSimulator<S, kRotation>>(scene, precision, std::move(step));
}

template <typename S, int kRotation>
using StepPointer = std::unique_ptr<const ContactStep<S, kRotation>>;
static_assert(kMostRotation == 3);
template std::unique_ptr<Simulator> MakeStepSimulator(const Scene&, Precision, StepPointer<double, 0>);
template std::unique_ptr<Simulator> MakeStepSimulator(const Scene&, Precision, StepPointer<double, 1>);
template std::unique_ptr<Simulator> MakeStepSimulator(const Scene&, Precision, StepPointer<double, 2>);
template std::unique_ptr<Simulator> MakeStepSimulator(const Scene&, Precision, StepPointer<double, 3>);
template std::unique_ptr<Simulator> MakeStepSimulator(const Scene&, Precision, StepPointer<float, 0>);
template std::unique_ptr<Simulator> MakeStepSimulator(const Scene&, Precision, StepPointer<float, 1>);
template std::unique_ptr<Simulator> MakeStepSimulator(const Scene&, Precision, StepPointer<float, 2>);
template std::unique_ptr<Simulator> MakeStepSimulator(const Scene&, Precision, StepPointer<float, 3>);

}  // namespace saltus
