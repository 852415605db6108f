// Steps of a whole scene by a contact model: discs that may touch are grouped into islands, and each island is stepped
// by the model as a scene of its own; all others fly.
#pragma once

#include <algorithm>
#include <limits>
#include <numeric>
#include <optional>
#include <span>
#include <tuple>
#include <vector>

#include "base/same_bits.h"
#include "base/scratch_memory.h"
#include "saltus/internal/contact_step.h"
#include "saltus/simulate/simulator.h"
#include "simulate/broad_phase.h"
#include "simulate/islands.h"
#include "simulate/rollout_record.h"
#include "simulate/step_contract.h"
#include "simulate/typed_scene.h"

namespace saltus {

// Everything that a step needs is reused, so that it does not allocate. One for each thread.
template <typename S, int kRotation>
class Stepper {
 public:
  using Model = ContactStep<S, kRotation>;
  static constexpr int kSize = 4 + kRotation;
  using State = BodyState<S, kRotation>;

  // Both must outlive this object.
  Stepper(const Model& model, const TypedScene<S>& scene, double step)
      : model_(model),
        scene_(scene),
        broad_phase_(MakeBroadPhase(model.traits(), scene, step)),
        force_(scene.bodies.size()) {
    if (scene.turns) torque_.resize(scene.bodies.size());
  }

  void set_tie_order(int order) { tie_order_ = order; }
  void set_finds_ties(bool finds) { finds_ties_ = finds; }

  // Begins a series of steps, in which the accelerations of all discs are at most `push`, m/s^2. No disc is pushed yet.
  void Begin(std::span<const double> push) {
    broad_phase_.SetAccelerations(push);
    std::fill(force_.begin(), force_.end(), Vec2<S>::Zero());
    std::fill(torque_.begin(), torque_.end(), S(0));
    failure_.reset();
    for (Rest& rest : rests_) rest.island.clear();
  }
  // The force on every disc in the next step, N.
  std::span<Vec2<S>> force() { return force_; }
  // Likewise the torque, N m; empty if there are none.
  std::span<S> torque() { return torque_; }
  // What can touch in the step from x. If nothing can, returns for how many steps that is so.
  int FindCandidates(std::span<const State> x) { return broad_phase_.Find(Flat(x), kSize, &candidates_); }
  bool AllFly() const { return candidates_.empty(); }

  // Step k, from x to `next`, with the candidates found there.
  void Step(int k, std::span<const State> x, std::span<State> next) {
    model_.FreeFlight(Input(), x, next);
    touches_.clear();
    ties_.clear();
    solved_.Clear();
    FindIslands();
    for (int q = 0; q < islands_.size() && !failure_; ++q) StepIsland(k, q, x, next);
    if (islands_.size() > 1) SortTouches();
  }

  // Step 0 in one call of the model, whatever the islands.
  void StepAtOnce(std::span<const State> x, std::span<State> next) {
    StepInput<S> in = Input();
    touches_.clear();
    in.touches = &touches_;
    local_.failure = {};
    in.failure = &local_.failure;
    model_.Step(in, x, next);
    scratch_.Release();
    std::vector<State> flying(x.size());
    model_.FreeFlight(in, x, flying);
    std::vector<int> all(x.size());
    std::iota(all.begin(), all.end(), 0);
    Check(0, all, touches_, next, [&](int i) -> const State& { return flying[i]; });
    // Without a result there is nothing to linearize.
    if (failure_) touches_.clear();
  }

  // Of the step just taken.
  const std::vector<Touch>& touches() const { return touches_; }
  const std::vector<TiedContact>& ties() const { return ties_; }
  const SolvedSteps& solved() const { return solved_; }
  const std::optional<RolloutFailure>& failure() const { return failure_; }

  // Derivatives are taken island by island, of those that touches connect. Each in turn is made the local scene.
  template <typename Touches, typename TouchOf>
  void FindTouchedIslands(const Touches& touches, const TouchOf& touch_of) {
    candidates_.clear();
    for (const auto& touch : touches) candidates_.push_back(touch_of(touch).candidate);
    FindIslands();
  }
  const Islands& islands() const { return islands_; }
  // The states of the local scene, to be filled in by whoever differentiates it.
  std::vector<State>& local_states() { return local_.x; }
  SolveRecord& local_solved() { return local_.solved; }
  void GatherAllButStates(int q) {
    local_.force.clear();
    local_.torque.clear();
    for (int i : islands_.bodies(q)) {
      local_.force.push_back(force_[i]);
      if (!torque_.empty()) local_.torque.push_back(torque_[i]);
    }
    if (q == local_.island) return;
    local_.island = q;
    local_.bodies.clear();
    for (int i : islands_.bodies(q)) local_.bodies.push_back(scene_.bodies[i]);
    LocalPairs(islands_.pairs(q), islands_.bodies(q), &local_.candidates);
  }
  void Gather(int q, std::span<const State> x) {
    local_.x.clear();
    for (int i : islands_.bodies(q)) local_.x.push_back(x[i]);
    GatherAllButStates(q);
  }
  StepInput<S> LocalInput() {
    StepInput<S> in = Input();
    in.bodies = local_.bodies;
    in.force = local_.force;
    in.torque = local_.torque;
    in.candidates = local_.candidates;
    in.solved = &local_.solved;
    local_.failure = {};
    in.failure = &local_.failure;
    return in;
  }
  // What was found of island q in step k; empty if nothing was.
  std::span<const double> FindSolved(const SolvedSteps& solved, int k, int q) const {
    return solved.Find(k, FirstPair(islands_.bodies(q)), local_.candidates.size());
  }
  void ReleaseScratch() { scratch_.Release(); }

 private:
  // The discs of one island as a scene of their own.
  struct LocalScene {
    int island = -1;  // whose bodies and candidates these are; -1: of none
    std::vector<State> x, next;
    std::vector<Vec2<S>> force;
    std::vector<S> torque;
    std::vector<BodyConstants<S>> bodies;
    std::vector<Candidate> candidates;
    std::vector<Touch> touches;
    std::vector<TiedContact> ties;
    SolveRecord solved;
    std::string_view failure;
  };

  // An island that a step has left as it was, bit by bit, and what the step gave. As long as nothing else is asked, the
  // next step is that one.
  struct Rest {
    std::vector<int> island;  // empty if there is none
    std::vector<State> x;
    std::vector<Vec2<S>> force;
    std::vector<S> torque;
    std::vector<Candidate> candidates;
    std::vector<Touch> touches;
    SolveRecord solved;
  };
  // What comes to rest to the last bit are bodies under exact events; others need not be looked at.
  bool MayRest() const { return model_.traits().event_driven; }

  static const S* Flat(std::span<const State> x) { return reinterpret_cast<const S*>(x.data()); }

  static BroadPhase MakeBroadPhase(const ModelTraits& traits, const TypedScene<S>& scene, double step) {
    std::vector<BroadPhase::Disc> discs;
    for (const BodyConstants<S>& body : scene.bodies) {
      discs.push_back({double(body.radius), double(body.mass), body.fixed});
      if (body.inverse_inertia > S(0)) discs.back().gyration2 = 1 / (double(body.inverse_inertia) * double(body.mass));
    }
    return {scene.wall_parts,
            std::move(discs),
            {.dt = step,
             .chains = traits.chains,
             .push_gap = traits.push_gap,
             .rounding = std::numeric_limits<S>::epsilon(),
             .all_parts = traits.event_driven}};
  }

  // The candidates are often those of the step before; then so are the islands.
  void FindIslands() {
    if (candidates_ == grouped_) return;
    grouped_ = candidates_;
    islands_.Find(candidates_, scene_.fixed);
    local_.island = -1;
  }

  StepInput<S> Input() {
    StepInput<S> in = scene_.Input();
    in.force = force_;
    in.candidates = candidates_;
    in.scratch = &scratch_;
    in.tie_order = tie_order_;
    in.torque = torque_;
    return in;
  }

  // `next` has free flight and gets the step.
  void StepIsland(int k, int q, std::span<const State> x, std::span<State> next) {
    const std::span<const int> island = islands_.bodies(q);
    Gather(q, x);
    local_.next.resize(island.size());
    local_.ties.clear();
    if (RestsAsBefore(q, island)) {
      local_.next = local_.x;
      local_.touches = rests_[q].touches;
      local_.solved.Assign(rests_[q].solved.numbers());
    } else {
      TakeStep(k, island, next);
      if (failure_) return;
      if (MayRest() && SameBits<State>(local_.next, local_.x) && local_.ties.empty()) Remember(q, island);
    }
    // The derivative is of the pairs that touch only: it recalls this step if these are all there are.
    if (!local_.solved.numbers().empty() && local_.touches.size() == local_.candidates.size()) {
      solved_.Add(k, FirstPair(island), local_.candidates.size(), local_.solved.numbers());
    }
    for (std::size_t i = 0; i < island.size(); ++i) {
      if (!scene_.fixed[island[i]]) next[island[i]] = local_.next[i];
    }
    for (Touch touch : local_.touches) {
      touch.candidate = InScene(touch.candidate, island);
      touches_.push_back(touch);
    }
    const int ties = ties_.empty() ? 0 : ties_.back().tie + 1;
    for (const TiedContact& contact : local_.ties) {
      ties_.push_back({InScene(contact.candidate, island), contact.time, ties + contact.tie});
    }
  }

  // The step of the local scene. `next` has free flight.
  void TakeStep(int k, std::span<const int> island, std::span<const State> next) {
    local_.touches.clear();
    local_.solved.Clear();
    StepInput<S> in = LocalInput();
    in.touches = &local_.touches;
    if (finds_ties_) in.ties = &local_.ties;
    model_.Step(in, local_.x, local_.next);
    scratch_.Release();
    Check(k, island, local_.touches, local_.next, [&](int i) -> const State& { return next[island[i]]; });
  }

  bool RestsAsBefore(int q, std::span<const int> island) const {
    if (!MayRest() || q >= static_cast<int>(rests_.size())) return false;
    const Rest& rest = rests_[q];
    return std::ranges::equal(rest.island, island) && SameBits<State>(rest.x, local_.x) &&
           SameBits<Vec2<S>>(rest.force, local_.force) && SameBits<S>(rest.torque, local_.torque) &&
           rest.candidates == local_.candidates;
  }
  void Remember(int q, std::span<const int> island) {
    if (q >= static_cast<int>(rests_.size())) rests_.resize(q + 1);
    Rest& rest = rests_[q];
    rest.island.assign(island.begin(), island.end());
    rest.x = local_.x;
    rest.force = local_.force;
    rest.torque = local_.torque;
    rest.candidates = local_.candidates;
    rest.touches = local_.touches;
    rest.solved.Assign(local_.solved.numbers());
  }

  // Notes what is wrong with a step of the discs `island`, whose indices the touches are.
  template <typename FlyingOf>
  void Check(int k, std::span<const int> island, std::span<const Touch> touches, std::span<const State> next,
             const FlyingOf& flying) {
    if (!local_.failure.empty()) {
      failure_ = {k, island[0], local_.failure};
      return;
    }
    const BrokenContract broken = CheckContract(
        touches,
        next,
        static_cast<int>(scene_.planes.size()),
        [&](int i) { return scene_.fixed[island[i]]; },
        flying,
        &reported_);
    if (!broken.what.empty()) failure_ = {k, broken.disc < 0 ? -1 : island[broken.disc], broken.what};
  }

  // In order of time if the model resolves it, else as candidates are.
  void SortTouches() {
    const auto before = [by_time = model_.traits().event_driven](const Touch& l, const Touch& r) {
      if (by_time) return l.time < r.time;
      const Candidate &a = l.candidate, &b = r.candidate;
      return std::tie(a.plane, a.a, a.b) < std::tie(b.plane, b.a, b.b);
    };
    // By insertion: stable, and without memory.
    for (auto at = touches_.begin(); at != touches_.end(); ++at) {
      std::rotate(std::upper_bound(touches_.begin(), at, *at, before), at, at + 1);
    }
  }

  // The first of the local scene's pairs, in the numbers of the whole scene.
  Candidate FirstPair(std::span<const int> island) const { return InScene(local_.candidates[0], island); }
  static Candidate InScene(const Candidate& c, std::span<const int> island) {
    return {island[c.a], c.plane ? c.b : island[c.b], c.plane};
  }

  const Model& model_;
  const TypedScene<S>& scene_;
  BroadPhase broad_phase_;
  ScratchMemory scratch_;
  std::vector<Vec2<S>> force_;
  std::vector<S> torque_;
  int tie_order_ = 0;
  bool finds_ties_ = false;
  std::vector<Candidate> candidates_;
  std::vector<Candidate> grouped_;  // whose islands these are
  Islands islands_;
  LocalScene local_;
  std::vector<Rest> rests_;  // by island, where there was one at rest since Begin()
  std::vector<char> reported_;
  std::vector<Touch> touches_;
  std::vector<TiedContact> ties_;
  SolvedSteps solved_;
  std::optional<RolloutFailure> failure_;
};

}  // namespace saltus
