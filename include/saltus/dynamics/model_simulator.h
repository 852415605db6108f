// A contact model bound to a scene.
//
// ModelSimulator steps a scene with plain scalars and records what touched. While no disc can have met another
// (broad_phase.h), each flies by itself; otherwise discs that may touch are grouped into islands, and each island is
// stepped by the model as a scene of its own. Derivatives follow from the record: discs that fly have a constant
// Jacobian (free_flight.h), found once by differentiating the model's free flight; islands of discs that touched are
// differentiated with Jets (island_derivative.h).
//
// Memory: one window of states and one state per further window (trajectory.h), the control, and per contact and step
// two discs' states and what iterations have found (solved_steps.h).
#pragma once

#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <utility>

#include "saltus/dynamics/broad_phase.h"
#include "saltus/dynamics/free_flight.h"
#include "saltus/dynamics/island_derivative.h"
#include "saltus/dynamics/islands.h"
#include "saltus/dynamics/scratch_memory.h"
#include "saltus/dynamics/simulator.h"
#include "saltus/dynamics/solved_steps.h"
#include "saltus/dynamics/step_contract.h"
#include "saltus/dynamics/trajectory.h"

namespace saltus {

template <ContactModel M, typename S>
class ModelSimulator final : public Simulator {
 public:
  static constexpr int kRotation = M::kRotation;
  static constexpr int kSize = 4 + kRotation;
  using State = BodyState<S, kRotation>;
  static_assert(sizeof(State) == kSize * sizeof(S));
  static_assert(M::kTraits.spins == (kRotation > 0), "a model has the trait `spins` if discs have a rotation");

  ModelSimulator(const Scene& scene, Precision precision, M model = {})
      : Simulator(scene, precision, M::kTraits.grid_steps),
        model_(std::move(model)),
        contact_{S(scene.contact.restitution),
                 S(scene.contact.friction),
                 S(scene.contact.stiffness),
                 S(scene.contact.damping)},
        place_in_control_(scene.bodies.size(), -1) {
    for (const Body& body : scene.bodies) {
      const S mass = S(body.mass);
      bodies_.push_back({mass, body.fixed ? S(0) : S(1) / mass, S(body.radius), body.fixed});
      fixed_.push_back(body.fixed);
    }
    for (const Plane& plane : scene.planes) {
      const Vec2d normal = plane.normal.normalized();
      planes_.push_back({normal.cast<S>(), S(Dot(normal, plane.point))});
      wide_planes_.push_back({normal, Dot(normal, plane.point)});
    }
    for (int c = 0; c < num_controlled(); ++c) place_in_control_[scene.control.bodies[c]] = c;
    free_ = DifferentiateFreeFlight(/*offset=*/0);
    free_is_affine_ = free_ == DifferentiateFreeFlight(/*offset=*/1);
    work_.emplace(MakeBroadPhase());
  }

  const ModelTraits& traits() const override {
    static constexpr ModelTraits kTraits = M::kTraits;
    return kTraits;
  }
  int body_size() const override { return kSize; }
  const std::vector<StepTouch>& touches() const override { return touches_; }
  std::size_t LeastMemory() const override {
    const std::size_t state = num_bodies() * sizeof(State);
    const int length = WindowLength(num_steps_, state, 0);
    return (length + 1 + (num_steps_ + length - 1) / length) * state;
  }

  bool Rollout(std::span<const double> initial, std::span<const double> control) override {
    CHECK_EQ(static_cast<int>(initial.size()), 4 * num_bodies());
    CHECK_EQ(static_cast<int>(control.size()), control_size());
    control_.resize(control.size());
    trajectory_.Resize(num_bodies(), num_steps_, memory_limit_);
    Expand(initial, trajectory_.Checkpoint(0).data());
    touches_.clear();
    ties_.clear();
    ForgetTouchedStates(0);
    all_recorded_ = true;
    failure_.reset();
    if (!free_is_affine_) {
      failure_ = {0, -1, "free flight is not affine and isotropic, or its derivative depends on the state"};
      return false;
    }
    for (int w = 0; w < trajectory_.num_windows(); ++w) {
      if (RecordIsFull()) all_recorded_ = false;
      if (!all_recorded_) ForgetTouchedStates(static_cast<int>(touches_.size()));
      CopyControl(w, control);
      RunWindow(w, [&](int k) {
        for (const Touch& touch : work_->touches) touches_.push_back({k, touch});
        for (const TiedContact& contact : work_->ties) ties_.push_back({k, contact});
        RecordTouchedStates(k);
      });
      if (work_->failure) {
        failure_ = work_->failure;
        return false;
      }
      if (stopped()) return false;
    }
    if (!AllFinite(trajectory_.At(num_steps_))) failure_.emplace();
    return !failure_;
  }

  void GetState(int k, std::span<double> x) const override {
    CHECK(k >= 0 && k <= num_steps_) << "found state " << k << ", expected 0 to " << num_steps_;
    CHECK_EQ(static_cast<int>(x.size()), state_size());
    const int w = trajectory_.WindowOf(k);
    if (!trajectory_.Holds(w)) RunWindow(w, [](int) {});
    const S* flat = Flat(trajectory_.At(k).data());
    std::copy(flat, flat + state_size(), x.begin());
  }

  void AdjointInto(std::span<const double> cotangent, const SensitivityView& out) override {
    CHECK_EQ(static_cast<int>(cotangent.size()), state_size());
    CHECK(out.initial.empty() || out.initial.size() == 4 * bodies_.size());
    CHECK(out.control.empty() || static_cast<int>(out.control.size()) == control_size());
    CHECK(out.effort == 0 || out.effort_of.size() == out.control.size());
    if (out.parameters != nullptr) ClearParameters(out.parameters);
    lambda_.assign(cotangent.begin(), cotangent.end());
    pulled_to_.assign(num_bodies(), num_steps_);
    int end = static_cast<int>(touches_.size());
    for (int w = trajectory_.num_windows() - 1; w >= 0; --w) {
      const int begin = FirstTouch(trajectory_.begin(w), end);
      Reload(w, begin, end);
      while (end > begin) {
        if (stopped()) return;
        const int k = touches_[end - 1].step;
        const int first = FirstTouch(k, end);
        PullBackStep(k, first, end, out);
        end = first;
      }
      // Rotation needs the states on the way, which are at hand now.
      for (int i = 0; kRotation > 0 && i < num_bodies(); ++i) PullBackTo(trajectory_.begin(w), i, out);
    }
    for (int i = 0; i < num_bodies(); ++i) PullBackTo(0, i, out);
    // Gravity is a constant force on every disc.
    for (int i = 0; out.parameters != nullptr && i < num_bodies(); ++i) {
      out.parameters->gravity += double(bodies_[i].mass) * out.parameters->force[i];
    }
    for (size_t i = 0; i < out.initial.size(); ++i) {
      out.initial[i] = bodies_[i / 4].fixed ? 0.0 : double(lambda_[i / 4 * kSize + i % 4]);
    }
  }

  void Step(std::span<const double> x, std::span<const double> force, std::span<double> next,
            std::vector<Touch>* touches) const override {
    Workspace work(MakeBroadPhase());
    std::vector<State> from(num_bodies()), to(num_bodies());
    CHECK_EQ(static_cast<int>(next.size()), state_size());
    StepOnce(x, force, &work, &from, &to);
    std::copy(Flat(to.data()), Flat(to.data()) + state_size(), next.begin());
    if (work.failure) std::fill(next.begin(), next.end(), std::numeric_limits<double>::quiet_NaN());
    if (touches != nullptr) *touches = work.touches;
  }

  void Linearize(std::span<const double> x, std::span<const double> force, bool with_parameters,
                 StepLinearization* linearization) const override {
    Workspace work(MakeBroadPhase());
    std::vector<State> from(num_bodies()), to(num_bodies());
    StepOnce(x, force, &work, &from, &to);

    StepLinearization& out = *linearization;
    out.body_size = kSize;
    out.free = {
        double(free_.pp), double(free_.pv), double(free_.pa), double(free_.vp), double(free_.vv), double(free_.va)};
    out.inverse_mass.assign(num_bodies(), 0.0);
    for (int i = 0; i < num_bodies(); ++i) out.inverse_mass[i] = bodies_[i].inverse_mass;
    out.islands.clear();
    out.flying.clear();
    out.rotation.clear();
    std::vector<char> flying(num_bodies(), 1);
    FindTouchedIslands(&work);
    for (int q = 0; q < work.islands.size(); ++q) {
      const std::span<const int> island = work.islands.bodies(q);
      for (int i : island) flying[i] = 0;
      Gather(q, from, &work);
      work.local.solved.Clear();
      typename IslandDerivative<M, S>::Matrix jacobian;
      work.derivative.Evaluate(model_, LocalInput(work), work.local.x, with_parameters, &jacobian);
      work.scratch.Release();
      const int n = static_cast<int>(island.size());
      const Eigen::MatrixXd wide = jacobian.template cast<double>();
      out.islands.push_back({{island.begin(), island.end()},
                             wide.leftCols(n * kSize),
                             wide.middleCols(n * kSize, 2 * n),
                             wide.rightCols(wide.cols() - n * (kSize + 2))});
    }
    for (int i = 0; i < num_bodies(); ++i) {
      if (!flying[i]) continue;
      out.flying.push_back(i);
      if constexpr (kRotation > 0) out.rotation.push_back(RotationJacobian(i, from[i]).template cast<double>());
    }
  }

  void ExpandInitial(std::span<const double> initial, std::span<double> x) const override {
    CHECK_EQ(static_cast<int>(initial.size()), 4 * num_bodies());
    CHECK_EQ(static_cast<int>(x.size()), state_size());
    std::vector<State> state(num_bodies());
    Expand(initial, state.data());
    std::copy(Flat(state.data()), Flat(state.data()) + state_size(), x.begin());
  }

 private:
  using Jet = StepJet<S>;
  using JetState = BodyState<Jet, kRotation>;
  // Not with rotation: windows cut flights, which must not change a bit. Nor in single precision, whose derivatives are
  // those of the published programs to the last digits.
  static constexpr bool kFlightsInOneGo = kRotation == 0 && !std::is_same_v<S, float>;
  // Of a rollout with more tied contacts than this, later ties are not looked for.
  static constexpr std::size_t kMostTies = 256;
  using RotationMatrix = Eigen::Matrix<S, kRotation, kRotation>;

  // The discs of one island as a scene of their own.
  struct LocalScene {
    std::vector<State> x, next;
    std::vector<Vec2<S>> force;
    std::vector<BodyConstants<S>> bodies;
    std::vector<Candidate> candidates;
    std::vector<Touch> touches;
    std::vector<TiedContact> ties;
    std::vector<S> after, before;  // cotangents
    SolveRecord solved;
    std::string_view failure;
  };

  // Everything a step or a sweep needs besides the trajectory; reused, so that neither allocates.
  struct Workspace {
    explicit Workspace(BroadPhase phase) : broad_phase(std::move(phase)) {}

    BroadPhase broad_phase;
    ScratchMemory scratch;
    std::vector<Candidate> candidates;
    std::vector<Touch> touches;
    std::vector<TiedContact> ties;
    std::vector<Vec2<S>> force;
    std::vector<double> push;
    Islands islands;
    SolvedSteps solved;  // of the step just taken
    LocalScene local;
    std::optional<Failure> failure;  // of the step just taken
    std::vector<char> reported;
    IslandDerivative<M, S> derivative;
  };

  static const S* Flat(const State* x) { return reinterpret_cast<const S*>(x); }
  static S* Flat(State* x) { return reinterpret_cast<S*>(x); }

  bool AllFinite(std::span<const State> x) const {
    return std::all_of(Flat(x.data()), Flat(x.data()) + state_size(), [](S value) { return std::isfinite(value); });
  }

  BroadPhase MakeBroadPhase() const {
    std::vector<BroadPhase::Disc> discs;
    for (const BodyConstants<S>& body : bodies_) discs.push_back({double(body.radius), double(body.mass), body.fixed});
    return {wide_planes_,
            std::move(discs),
            {.dt = step(),
             .chains = M::kTraits.chains,
             .push_gap = M::kTraits.reach,
             .rounding = std::numeric_limits<S>::epsilon()}};
  }

  void Expand(std::span<const double> initial, State* x) const {
    for (int i = 0; i < num_bodies(); ++i) {
      const double* from = &initial[4 * i];
      x[i] = AtRest();
      x[i].p = Vec2<S>(S(from[0]), S(from[1]));
      x[i].v = bodies_[i].fixed ? Vec2<S>::Zero() : Vec2<S>(S(from[2]), S(from[3]));
    }
  }

  // At the origin, with the rotation that every disc starts with.
  static State AtRest() {
    State x;
    std::fill_n(Flat(&x), kSize, S(0));
    if constexpr (requires(double* rotation) { M::InitialRotation(rotation); }) {
      double rotation[kRotation] = {};
      M::InitialRotation(rotation);
      std::copy(rotation, rotation + kRotation, x.rotation);
    }
    return x;
  }

  // -------------------------------------------------------------------------------------------------------------------
  // Steps.

  // Where the forces on disc i from step k on begin in the control, or null. From one step to the next it is
  // ControlStride() numbers.
  const S* ControlOf(int i, int k) const {
    return place_in_control_[i] < 0 ? nullptr : control_.data() + k * ControlStride() + 2 * place_in_control_[i];
  }
  std::ptrdiff_t ControlStride() const { return 2 * static_cast<std::ptrdiff_t>(num_controlled()); }

  // Takes over the control of window w, just before it is used: a long one does not stay in the processor's cache.
  void CopyControl(int w, std::span<const double> control) {
    const std::ptrdiff_t begin = trajectory_.begin(w) * ControlStride(), end = trajectory_.end(w) * ControlStride();
    std::copy(control.begin() + begin, control.begin() + end, control_.begin() + begin);
  }

  void SetForce(int k, std::vector<Vec2<S>>* force) const {
    for (int body : scene_.control.bodies) {
      const S* u = ControlOf(body, k);
      (*force)[body] = Vec2<S>(u[0], u[1]);
    }
  }

  // Bounds on the discs' accelerations in steps begin..end-1, m/s^2.
  void FindLargestAccelerations(int begin, int end, std::vector<double>* push) const {
    push->assign(num_bodies(), scene_.gravity.norm());
    const std::ptrdiff_t stride = ControlStride();
    for (int body : scene_.control.bodies) {
      // Several maxima, so that they need not wait for each other.
      constexpr int kLanes = 4;
      S largest[kLanes] = {};
      const S* u = ControlOf(body, begin);
      int k = begin;
      for (; k + kLanes <= end; k += kLanes, u += kLanes * stride) {
        for (int lane = 0; lane < kLanes; ++lane) {
          const S* at = u + lane * stride;
          const S square = at[0] * at[0] + at[1] * at[1];
          largest[lane] = square > largest[lane] ? square : largest[lane];
        }
      }
      for (; k < end; ++k, u += stride) largest[0] = std::max(largest[0], u[0] * u[0] + u[1] * u[1]);
      const double square = *std::max_element(largest, largest + kLanes);
      (*push)[body] += std::sqrt(square) * double(bodies_[body].inverse_mass);
    }
  }

  // Runs the steps of window w from its checkpoint and calls record(k) for each step in which something touched, with
  // its touches in work_->touches. Ends early with work_->failure.
  template <typename Record>
  void RunWindow(int w, const Record& record) const {
    Workspace& work = *work_;
    const int begin = trajectory_.begin(w), end = trajectory_.end(w);
    trajectory_.Open(w);
    work.failure.reset();
    FindLargestAccelerations(begin, end, &work.push);
    work.broad_phase.SetAccelerations(work.push);
    work.force.assign(num_bodies(), Vec2<S>::Zero());
    for (int k = begin; k < end && !stopped();) {
      const int quiet = work.broad_phase.Find(Flat(trajectory_.At(k).data()), kSize, &work.candidates);
      if (work.candidates.empty()) {
        const int steps = std::min(quiet, end - k);
        Fly(k, steps);
        k += steps;
        continue;
      }
      SetForce(k, &work.force);
      StepScene(k, trajectory_.At(k), trajectory_.At(k + 1), &work);
      if (work.failure) break;
      if (!work.touches.empty()) record(k);
      ++k;
    }
    trajectory_.Close();
  }

  // Free flight of all discs for some steps from step k on: disc by disc, so that a state stays in registers.
  void Fly(int k, int steps) const {
    State* first = trajectory_.At(k).data();
    for (int i = 0; i < num_bodies(); ++i) FlyAlone(i, ControlOf(i, k), steps, first + i);
  }

  void FlyAlone(int i, const S* u, int steps, State* at) const {
    const BodyConstants<S> body = bodies_[i];
    Vec2<S> force = Vec2<S>::Zero();
    StepInput<S> in{};
    in.h = S(step());
    in.gravity = scene_.gravity.template cast<S>();
    in.bodies = {&body, 1};
    in.force = {&force, 1};
    State x = *at;
    for (int j = 0; j < steps; ++j) {
      if (u != nullptr) {
        force = Vec2<S>(u[0], u[1]);
        u += ControlStride();
      }
      x = model_.Free(in, 0, x);
      at += num_bodies();
      *at = x;
    }
  }

  // Step k of all discs, under work->force; leaves what touched in work->touches.
  void StepScene(int k, std::span<const State> x, std::span<State> next, Workspace* work) const {
    FreeFlight(model_, Input(*work), x, next);
    work->touches.clear();
    work->ties.clear();
    work->solved.Clear();
    work->islands.Find(work->candidates, fixed_);
    for (int q = 0; q < work->islands.size() && !work->failure; ++q) StepIsland(k, q, x, next, work);
    if (work->islands.size() > 1) SortTouches(&work->touches);
  }

  // `next` has free flight and gets the step.
  void StepIsland(int k, int q, std::span<const State> x, std::span<State> next, Workspace* work) const {
    const std::span<const int> island = work->islands.bodies(q);
    Gather(q, x, work);
    LocalScene& local = work->local;
    local.next.resize(island.size());
    local.touches.clear();
    local.ties.clear();
    local.solved.Clear();
    StepInput<S> in = LocalInput(*work);
    in.touches = &local.touches;
    if (ties_.size() < kMostTies) in.ties = &local.ties;
    model_.Step(in, std::span<const State>(local.x), std::span<State>(local.next));
    work->scratch.Release();
    CheckStep(
        k, island, local.touches, local.next, [&](int i) -> const State& { return next[island[i]]; }, work);
    if (work->failure) return;
    // The derivative is of the pairs that touch only: it recalls this step if these are all there are.
    if (!local.solved.numbers().empty() && local.touches.size() == local.candidates.size()) {
      work->solved.Add(k, FirstPair(local, island), local.candidates.size(), local.solved.numbers());
    }
    for (size_t i = 0; i < island.size(); ++i) {
      if (!fixed_[island[i]]) next[island[i]] = local.next[i];
    }
    for (Touch touch : local.touches) {
      touch.candidate = InScene(touch.candidate, island);
      work->touches.push_back(touch);
    }
    const int ties = work->ties.empty() ? 0 : work->ties.back().tie + 1;
    for (const TiedContact& contact : local.ties) {
      work->ties.push_back({InScene(contact.candidate, island), contact.time, ties + contact.tie});
    }
  }

  // Notes what is wrong with a step of the discs `island`, whose indices the touches are.
  template <typename FlyingOf>
  void CheckStep(int k, std::span<const int> island, std::span<const Touch> touches, std::span<const State> next,
                 const FlyingOf& flying, Workspace* work) const {
    if (!work->local.failure.empty()) {
      work->failure = {k, island[0], work->local.failure};
      return;
    }
    const BrokenContract broken = CheckContract(
        touches,
        next,
        static_cast<int>(planes_.size()),
        [&](int i) { return fixed_[island[i]]; },
        flying,
        &work->reported);
    if (!broken.what.empty()) work->failure = {k, broken.disc < 0 ? -1 : island[broken.disc], broken.what};
  }

  // In order of time if the model resolves it, else as candidates are.
  static void SortTouches(std::vector<Touch>* touches) {
    const auto before = [](const Touch& l, const Touch& r) {
      if constexpr (M::kTraits.event_driven) return l.time < r.time;
      const Candidate &a = l.candidate, &b = r.candidate;
      return std::tie(a.plane, a.a, a.b) < std::tie(b.plane, b.a, b.b);
    };
    // By insertion: stable, and without memory.
    for (auto at = touches->begin(); at != touches->end(); ++at) {
      std::rotate(std::upper_bound(touches->begin(), at, *at, before), at, at + 1);
    }
  }

  StepInput<S> Input(Workspace& work) const {
    return {.h = S(step()),
            .gravity = scene_.gravity.template cast<S>(),
            .contact = contact_,
            .bodies = bodies_,
            .planes = planes_,
            .force = work.force,
            .candidates = work.candidates,
            .scratch = &work.scratch,
            .tie_order = tie_order_};
  }
  StepInput<S> LocalInput(Workspace& work) const {
    StepInput<S> in = Input(work);
    in.bodies = work.local.bodies;
    in.force = work.local.force;
    in.candidates = work.local.candidates;
    in.solved = &work.local.solved;
    work.local.failure = {};
    in.failure = &work.local.failure;
    return in;
  }
  // The first of the local scene's pairs, in the numbers of the whole scene.
  static Candidate FirstPair(const LocalScene& local, std::span<const int> island) {
    return InScene(local.candidates[0], island);
  }
  static Candidate InScene(const Candidate& c, std::span<const int> island) {
    return {island[c.a], c.plane ? c.b : island[c.b], c.plane};
  }

  // Makes island q of work->islands the local scene, with the discs at x.
  void Gather(int q, std::span<const State> x, Workspace* work) const {
    work->local.x.clear();
    for (int i : work->islands.bodies(q)) work->local.x.push_back(x[i]);
    GatherAllButStates(q, work);
  }
  void GatherAllButStates(int q, Workspace* work) const {
    LocalScene& local = work->local;
    local.force.clear();
    local.bodies.clear();
    for (int i : work->islands.bodies(q)) {
      local.force.push_back(work->force[i]);
      local.bodies.push_back(bodies_[i]);
    }
    LocalPairs(work->islands.pairs(q), work->islands.bodies(q), &local.candidates);
  }

  // The islands that work->touches connect.
  void FindTouchedIslands(Workspace* work) const {
    work->candidates.clear();
    for (const Touch& touch : work->touches) work->candidates.push_back(touch.candidate);
    work->islands.Find(work->candidates, fixed_);
  }

  // One step of the whole scene from a state in doubles; leaves force and touches in `work`.
  void StepOnce(std::span<const double> x, std::span<const double> force, Workspace* work, std::vector<State>* from,
                std::vector<State>* to) const {
    CHECK_EQ(static_cast<int>(x.size()), state_size());
    CHECK_EQ(static_cast<int>(force.size()), 2 * num_bodies());
    std::copy(x.begin(), x.end(), Flat(from->data()));
    work->force.resize(num_bodies());
    work->push.resize(num_bodies());
    for (int i = 0; i < num_bodies(); ++i) {
      work->force[i] = Vec2<S>(S(force[2 * i]), S(force[2 * i + 1]));
      work->push[i] =
          scene_.gravity.norm() + std::hypot(force[2 * i], force[2 * i + 1]) * double(bodies_[i].inverse_mass);
    }
    work->broad_phase.SetAccelerations(work->push);
    work->broad_phase.Find(Flat(from->data()), kSize, &work->candidates);
    StepInput<S> in = Input(*work);
    in.touches = &work->touches;
    in.failure = &work->local.failure;
    model_.Step(in, std::span<const State>(*from), std::span<State>(*to));
    work->scratch.Release();
    std::vector<State> flying(num_bodies());
    FreeFlight(model_, in, std::span<const State>(*from), std::span<State>(flying));
    std::vector<int> all(num_bodies());
    std::iota(all.begin(), all.end(), 0);
    CheckStep(
        0, all, work->touches, *to, [&](int i) -> const State& { return flying[i]; }, work);
    // Without a result there is nothing to linearize.
    if (work->failure) work->touches.clear();
  }

  // -------------------------------------------------------------------------------------------------------------------
  // The record of a rollout.

  bool RecordIsFull() const {
    return trajectory_.bytes() + touched_states_.size() * sizeof(touched_states_[0]) + solved_.bytes() > memory_limit_;
  }
  // From here on, states are kept from touch `first` on.
  void ForgetTouchedStates(int first) {
    touched_states_.clear();
    solved_.Clear();
    first_touch_with_states_ = first;
  }
  void RecordTouchedStates(int k) {
    const std::span<const State> x = trajectory_.At(k);
    for (const Touch& touch : work_->touches) {
      const Candidate& c = touch.candidate;
      touched_states_.push_back({x[c.a], c.plane ? x[c.a] : x[c.b]});
    }
    solved_.AddAll(work_->solved);
  }
  // The first of the touches before `end` in step k or later.
  int FirstTouch(int k, int end) const {
    while (end > 0 && touches_[end - 1].step >= k) --end;
    return end;
  }

  // Makes sure that what the adjoint through window w needs is in memory. Its touches are begin..end-1.
  void Reload(int w, int begin, int end) {
    const bool forgotten = !all_recorded_ && begin < end && first_touch_with_states_ != begin;
    const bool turns = kRotation > 0 && !trajectory_.Holds(w) && (begin < end || AnyRotation());
    if (!forgotten && !turns) return;
    if (forgotten) ForgetTouchedStates(begin);
    RunWindow(w, [&](int k) {
      if (forgotten) RecordTouchedStates(k);
    });
  }

  // -------------------------------------------------------------------------------------------------------------------
  // Derivatives. lambda_ has the cotangent of disc i's state at step pulled_to_[i]; discs are pulled back through their
  // flights only when they touch something.

  void ClearParameters(ParameterGradient* parameters) const {
    parameters->restitution = parameters->friction = parameters->stiffness = parameters->damping = 0;
    parameters->gravity.setZero();
    parameters->mass.assign(num_bodies(), 0.0);
    parameters->force.assign(num_bodies(), Vec2d::Zero());
  }

  // Pulls the discs that touched in step k, by touches first..end-1, back to its beginning.
  void PullBackStep(int k, int first, int end, const SensitivityView& out) {
    Workspace& work = *work_;
    SetForce(k, &work.force);
    work.touches.clear();
    for (int t = first; t < end; ++t) work.touches.push_back(touches_[t].touch);
    FindTouchedIslands(&work);
    for (int q = 0; q < work.islands.size(); ++q) {
      for (int i : work.islands.bodies(q)) PullBackTo(k + 1, i, out);
      GatherTouchedStates(q, first, end);
      PullBackIsland(k, work.islands.bodies(q), out);
    }
  }

  // Makes island q the local scene, with the states that were recorded.
  void GatherTouchedStates(int q, int first, int end) {
    const std::span<const int> island = work_->islands.bodies(q);
    std::vector<State>& x = work_->local.x;
    x.resize(island.size());
    const auto put = [&](int body, const State& state) {
      const auto at = std::lower_bound(island.begin(), island.end(), body);
      if (at != island.end() && *at == body) x[at - island.begin()] = state;
    };
    for (int t = first; t < end; ++t) {
      const Candidate& c = touches_[t].touch.candidate;
      const std::array<State, 2>& states = touched_states_[t - first_touch_with_states_];
      put(c.a, states[0]);
      if (!c.plane) put(c.b, states[1]);
    }
    GatherAllButStates(q, &*work_);
  }

  void PullBackIsland(int k, std::span<const int> island, const SensitivityView& out) {
    LocalScene& local = work_->local;
    const int n = static_cast<int>(island.size());
    const bool with_parameters = out.parameters != nullptr;
    local.after.resize(n * kSize);
    local.before.resize(IslandDerivative<M, S>::NumColumns(n, with_parameters));
    local.solved.Assign(solved_.Find(k, FirstPair(local, island), local.candidates.size()));
    for (int i = 0; i < n; ++i) std::copy_n(&lambda_[island[i] * kSize], kSize, &local.after[i * kSize]);
    work_->derivative.ApplyTranspose(
        model_, LocalInput(*work_), local.x, free_, with_parameters, local.after, local.before);
    work_->scratch.Release();
    for (int i = 0; i < n; ++i) {
      const int body = island[i];
      if (fixed_[body]) continue;
      std::copy_n(&local.before[i * kSize], kSize, &lambda_[body * kSize]);
      pulled_to_[body] = k;
      const Vec2<S> push(local.before[n * kSize + 2 * i], local.before[n * kSize + 2 * i + 1]);
      if (IsControlWanted(body, out)) GradientOf(body, k, out).Put(0, push[0], push[1]);
      if (with_parameters) AddConstantForce(body, push, out.parameters);
    }
    if (with_parameters) AddContactParameters(island, &local.before[n * (kSize + 2)], out.parameters);
  }

  bool IsControlWanted(int body, const SensitivityView& out) const {
    return place_in_control_[body] >= 0 && !out.control.empty();
  }

  // Where the sensitivity to the forces on one disc goes, from some step on.
  struct ForceSink {
    double* gradient;
    const double* control;  // null without effort
    double effort;
    std::ptrdiff_t stride;  // from one step to the next

    void Put(int step, S x, S y) const {
      const std::ptrdiff_t at = step * stride;
      gradient[at] = control == nullptr ? x : x + effort * control[at];
      gradient[at + 1] = control == nullptr ? y : y + effort * control[at + 1];
    }

    // Step j of n gets scale * (its cotangent).
    void PutAll(int n, S scale, const LinearCotangents<S>& cotangents) const {
      const Eigen::Array2d last = (scale * cotangents.last).template cast<double>();
      const Eigen::Array2d change = (scale * cotangents.change).template cast<double>();
      if (control == nullptr) {
        PutEach(n, [&](double* to, double left, std::ptrdiff_t) { Pair{to} = last + left * change; });
      } else {
        PutEach(n, [&](double* to, double left, std::ptrdiff_t at) {
          Pair{to} = last + left * change + effort * ConstPair{control + at};
        });
      }
    }

   private:
    using Pair = Eigen::Map<Eigen::Array2d>;
    using ConstPair = Eigen::Map<const Eigen::Array2d>;

    // Calls put(where, number of steps after it, offset) for each step; some at a time, which need not wait for each
    // other.
    template <typename PutStep>
    void PutEach(int n, const PutStep& put) const {
      constexpr int kAtATime = 4;
      std::ptrdiff_t at = 0;
      double left = n;
      for (; n >= kAtATime; n -= kAtATime, left -= kAtATime) {
        for (int j = 1; j <= kAtATime; ++j, at += stride) put(gradient + at, left - j, at);
      }
      for (; n > 0; --n, at += stride) put(gradient + at, --left, at);
    }
  };
  ForceSink GradientOf(int body, int k, const SensitivityView& out) const {
    const std::ptrdiff_t at = k * ControlStride() + 2 * place_in_control_[body];
    return {
        out.control.data() + at, out.effort == 0 ? nullptr : out.effort_of.data() + at, out.effort, ControlStride()};
  }

  void AddContactParameters(std::span<const int> island, const S* gradient, ParameterGradient* parameters) const {
    parameters->restitution += gradient[0];
    parameters->friction += gradient[1];
    parameters->stiffness += gradient[2];
    parameters->damping += gradient[3];
    for (size_t i = 0; i < island.size(); ++i) {
      if (!fixed_[island[i]]) parameters->mass[island[i]] += gradient[4 + i];
    }
  }

  // A constant force acts in every step as the step's own force does.
  void AddConstantForce(int body, const Vec2<S>& push, ParameterGradient* parameters) const {
    parameters->force[body] += push.template cast<double>();
  }

  // Pulls disc i back through its flight, to the state in which step k begins.
  void PullBackTo(int k, int i, const SensitivityView& out) {
    const int steps = pulled_to_[i] - k;
    if (steps <= 0 || fixed_[i]) return;
    pulled_to_[i] = k;
    S* lambda = &lambda_[i * kSize];
    if constexpr (kRotation > 0) PullBackRotation(k, steps, i, lambda + 4);
    if (out.parameters != nullptr) {
      PullBackWithParameters(k, steps, i, lambda, out);
    } else if (IsControlWanted(i, out)) {
      PullBackControlled(k, steps, i, lambda, out);
    } else if constexpr (kRotation > 0) {
      // Step by step: windows may cut a flight, which must not change a bit.
      PullBackFlight(free_, steps, lambda, [](int, S, S) {});
    } else {
      const FreeFlightJacobian<S> flight = free_.Power(steps);
      for (int j = 0; j < 2; ++j) flight.PullBack(&lambda[j], &lambda[2 + j]);
    }
  }

  void PullBackControlled(int k, int steps, int i, S* lambda, const SensitivityView& out) const {
    const ForceSink gradient = GradientOf(i, k, out);
    const S inverse_mass = bodies_[i].inverse_mass;
    if (kFlightsInOneGo && free_.IsShear()) {
      gradient.PutAll(steps, inverse_mass, PullBackShear(free_, steps, lambda));
      return;
    }
    PullBackFlight(free_, steps, lambda, [&](int j, S x, S y) { gradient.Put(j, inverse_mass * x, inverse_mass * y); });
  }

  void PullBackWithParameters(int k, int steps, int i, S* lambda, const SensitivityView& out) const {
    const S inverse_mass = bodies_[i].inverse_mass;
    PullBackFlight(free_, steps, lambda, [&](int j, S x, S y) {
      const Vec2<S> push = Scale(inverse_mass, Vec2<S>(x, y));
      AddConstantForce(i, push, out.parameters);
      if (IsControlWanted(i, out)) GradientOf(i, k + j, out).Put(0, push[0], push[1]);
      if (const S* u = ControlOf(i, k + j)) {
        out.parameters->mass[i] -= Dot(push, Vec2<S>(u[0], u[1])) * inverse_mass;
      }
    });
  }

  bool AnyRotation() const {
    for (int i = 0; i < num_bodies(); ++i) {
      for (int j = 4; j < kSize; ++j) {
        if (lambda_[i * kSize + j] != S(0)) return true;
      }
    }
    return false;
  }

  // The same for the rotation, which a flight changes by itself.
  void PullBackRotation(int k, int steps, int i, S* lambda) {
    Eigen::Map<Eigen::Matrix<S, kRotation, 1>> cotangent(lambda);
    if (cotangent.isZero(S(0))) return;
    RotationMatrix jacobian = RotationMatrix::Zero();
    const State* at = nullptr;  // where `jacobian` is; a disc that does not spin keeps it
    for (int j = k + steps - 1; j >= k; --j) {
      const State& x = trajectory_.At(j)[i];
      if (at == nullptr || !std::equal(x.rotation, x.rotation + kRotation, at->rotation)) {
        jacobian = RotationJacobian(i, x);
        at = &x;
      }
      cotangent = (jacobian.transpose() * cotangent).eval();
    }
  }

  RotationMatrix RotationJacobian(int i, const State& x) const {
    static_assert(kRotation <= kJetWidth);
    JetState jets{};
    for (int j = 0; j < 2; ++j) {
      jets.p[j] = Jet(x.p[j]);
      jets.v[j] = Jet(x.v[j]);
    }
    for (int j = 0; j < kRotation; ++j) jets.rotation[j] = Jet(x.rotation[j], j);
    const std::array<Vec2<Jet>, 1> force{Vec2<Jet>(Jet(S(0)), Jet(S(0)))};
    const std::array<BodyConstants<Jet>, 1> body{
        {{Jet(bodies_[i].mass), Jet(bodies_[i].inverse_mass), bodies_[i].radius, bodies_[i].fixed}}};
    StepInput<Jet> in{};
    in.h = S(step());
    in.gravity = Vec2<S>::Zero();
    in.bodies = body;
    in.force = force;
    const JetState next = model_.Free(in, 0, jets);
    RotationMatrix jacobian;
    for (int r = 0; r < kRotation; ++r) jacobian.row(r) = next.rotation[r].v.template head<kRotation>();
    return jacobian;
  }

  // At a state whose numbers are all `offset`. Not a number where free flight is not isotropic, or turns with the
  // motion.
  FreeFlightJacobian<S> DifferentiateFreeFlight(S offset) const {
    JetState x{};
    std::array<Vec2<Jet>, 1> force;
    for (int j = 0; j < 2; ++j) {
      x.p[j] = Jet(offset, j);
      x.v[j] = Jet(offset, 2 + j);
      force[0][j] = Jet(offset, 4 + j);
    }
    if constexpr (kRotation > 0) {
      const State start = AtRest();
      for (int j = 0; j < kRotation; ++j) x.rotation[j] = Jet(start.rotation[j]);
    }
    const std::array<BodyConstants<Jet>, 1> body{{{Jet(S(1)), Jet(S(1)), S(1), false}}};
    StepInput<Jet> in{};
    in.h = S(step());
    in.gravity = Vec2<S>::Zero();
    in.bodies = body;
    in.force = force;
    const JetState next = model_.Free(in, 0, x);
    FreeFlightJacobian<S> free{
        next.p[0].v[0], next.p[0].v[2], next.p[0].v[4], next.v[0].v[0], next.v[0].v[2], next.v[0].v[4]};
    bool isotropic = true;
    for (int by = 0; by < 6; by += 2) {
      for (const Vec2<Jet>& to : {next.p, next.v}) {
        isotropic = isotropic && to[1].v[by + 1] == to[0].v[by] && to[0].v[by + 1] == S(0) && to[1].v[by] == S(0);
      }
      if constexpr (kRotation > 0) {
        for (const Jet& to : next.rotation) isotropic = isotropic && to.v[by] == S(0) && to.v[by + 1] == S(0);
      }
    }
    if (!isotropic) free.pp = std::numeric_limits<S>::quiet_NaN();
    return free;
  }

  M model_;
  ContactConstants<S> contact_;
  std::vector<BodyConstants<S>> bodies_;
  std::vector<char> fixed_;
  std::vector<int> place_in_control_;  // of each disc; -1 if it is not controlled
  std::vector<HalfPlane<S>> planes_;
  std::vector<HalfPlane<double>> wide_planes_;
  FreeFlightJacobian<S> free_{};
  bool free_is_affine_ = true;

  // The last rollout.
  std::vector<S> control_;  // K x C x 2
  std::vector<StepTouch> touches_;
  std::vector<std::array<State, 2>> touched_states_;  // of discs a and b before the step, from the touch below on
  int first_touch_with_states_ = 0;
  SolvedSteps solved_;        // from the same touch on
  bool all_recorded_ = true;  // false if the states of some touches were let go for the sake of memory_limit()
  std::vector<S> lambda_;
  std::vector<int> pulled_to_;

  // Asking for a state may run its window again.
  mutable Trajectory<State> trajectory_;
  mutable std::optional<Workspace> work_;
};

}  // namespace saltus
