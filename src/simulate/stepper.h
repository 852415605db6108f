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

// Memory that a step needs is reused, so that a step does not allocate. Each thread needs its own Stepper.
template <typename S, int kRotation>
class Stepper {
 public:
  using Model = ContactStep<S, kRotation>;
  static constexpr int kSize = 4 + kRotation;
  using State = BodyState<S, kRotation>;

  // Keeps references to `model` and `scene`, which must outlive this object.
  Stepper(const Model& model, const TypedScene<S>& scene, double step)
      : model_(model),
        scene_(scene),
        broad_phase_(MakeBroadPhase(model.traits(), scene, step)),
        force_(scene.bodies.size()) {
    if (scene.has_torques) torque_.resize(scene.bodies.size());
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
  // The torque on every disc in the next step, N m; empty if there are no torques.
  std::span<S> torque() { return torque_; }
  // Finds the pairs that can touch in the step from x. If there are none, returns for how many steps that holds.
  int FindCandidates(std::span<const State> x) { return broad_phase_.Find(Flat(x), kSize, &candidates_); }
  bool HasNoCandidates() const { return candidates_.empty(); }

  // Takes step k, from x to `next`, with the candidates found there.
  void Step(int k, std::span<const State> x, std::span<State> next) {
    model_.FreeFlight(Input(), x, next);
    touches_.clear();
    ties_.clear();
    solved_.Clear();
    FindIslands();
    for (int q = 0; q < islands_.size() && !failure_; ++q) StepIsland(k, q, x, next);
    if (islands_.size() > 1) SortTouches();
  }

  // Takes step 0 by one call of the model, without division into islands.
  void StepWithoutIslands(std::span<const State> x, std::span<State> next) {
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
    // A step without a result has no linearization.
    if (failure_) touches_.clear();
  }

  // The touches, ties and solutions of the last step.
  const std::vector<Touch>& touches() const { return touches_; }
  const std::vector<TiedContact>& ties() const { return ties_; }
  const SolvedSteps& solved() const { return solved_; }
  const std::optional<RolloutFailure>& failure() const { return failure_; }

  // Groups touches into islands, as derivatives are taken island by island. Each in turn is made the local scene.
  template <typename Touches, typename TouchOf>
  void FindTouchedIslands(const Touches& touches, const TouchOf& touch_of) {
    candidates_.clear();
    for (const auto& touch : touches) candidates_.push_back(touch_of(touch).candidate);
    FindIslands();
  }
  const Islands& islands() const { return islands_; }
  // The states of the local scene, to be set by the caller that differentiates it.
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
  // Returns the recorded solution of island q in step k; empty if there is none.
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

  // An island that a step has left unchanged, bit by bit, with the results of that step. As long as the forces are the
  // same, the next step has the same results.
  struct Rest {
    std::vector<int> island;  // empty if there is none
    std::vector<State> x;
    std::vector<Vec2<S>> force;
    std::vector<S> torque;
    std::vector<Candidate> candidates;
    std::vector<Touch> touches;
    SolveRecord solved;
  };
  // Whether islands may come to rest to the last bit, which only exact events can do.
  bool MayStayAtRest() const { return model_.traits().event_driven; }

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

  // Often the candidates are those of the step before, and then the islands are too.
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

  // Steps one island. `next` has the states after free flight, and gets those after the step.
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
      if (MayStayAtRest() && SameBits<State>(local_.next, local_.x) && local_.ties.empty()) Remember(q, island);
    }
    // The derivative treats the touching pairs only: it can use this solution if all pairs of the island touch.
    if (!local_.solved.numbers().empty() && local_.touches.size() == local_.candidates.size()) {
      solved_.Add(k, FirstPair(island), local_.candidates.size(), local_.solved.numbers());
    }
    for (std::size_t i = 0; i < island.size(); ++i) {
      if (!scene_.fixed[island[i]]) next[island[i]] = local_.next[i];
    }
    for (Touch touch : local_.touches) {
      touch.candidate = ToSceneIndices(touch.candidate, island);
      touches_.push_back(touch);
    }
    const int ties = ties_.empty() ? 0 : ties_.back().tie + 1;
    for (const TiedContact& contact : local_.ties) {
      ties_.push_back({ToSceneIndices(contact.candidate, island), contact.time, ties + contact.tie});
    }
  }

  // Takes the step of the local scene. `next` has the states after free flight.
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
    if (!MayStayAtRest() || q >= static_cast<int>(rests_.size())) return false;
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

  // Records a failure of a step of the discs `island`; the touches have the indices of the island.
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

  // Sorts by time if the model resolves it, else in the order of the candidates.
  void SortTouches() {
    const auto before = [by_time = model_.traits().event_driven](const Touch& l, const Touch& r) {
      if (by_time) return l.time < r.time;
      const Candidate &a = l.candidate, &b = r.candidate;
      return std::tie(a.plane, a.a, a.b) < std::tie(b.plane, b.a, b.b);
    };
    // Insertion is stable and needs no memory.
    for (auto at = touches_.begin(); at != touches_.end(); ++at) {
      std::rotate(std::upper_bound(touches_.begin(), at, *at, before), at, at + 1);
    }
  }

  // Returns the first pair of the local scene, with the indices of the whole scene.
  Candidate FirstPair(std::span<const int> island) const { return ToSceneIndices(local_.candidates[0], island); }
  static Candidate ToSceneIndices(const Candidate& c, std::span<const int> island) {
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
