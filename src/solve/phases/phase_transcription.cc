#include "solve/phases/phase_transcription.h"

#include <ceres/manifold.h>
#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "control/control_bounds.h"
#include "control/model_step.h"
#include "control/own_term_cost.h"
#include "solve/phases/phase_functions.h"

namespace saltus {
namespace {

constexpr double kLeastLength = 1e-6;  // of a step of mean length, below which its effort is not smaller

std::optional<Vec2d> FixedAt(const Scene& scene, int body) {
  if (!scene.bodies[body].fixed) return std::nullopt;
  return scene.bodies[body].position;
}

ImpactCut MakeCut(const Scene& scene, const Candidate& c) {
  ImpactCut cut{MakeImpactConstants(scene, c), std::nullopt, {FixedAt(scene, c.a), std::nullopt}, 0};
  if (c.plane) {
    cut.plane = MakeHalfPlane(scene.planes[c.b]);
  } else {
    cut.at[1] = FixedAt(scene, c.b);
  }
  return cut;
}

bool TakesPart(const Candidate& c, int body) { return c.a == body || (!c.plane && c.b == body); }

}  // namespace

PhaseTranscription::PhaseTranscription(const Scene& scene, const std::vector<OwnTerm>& terms,
                                       std::vector<PhaseCut> cuts, std::vector<int> steps, const ControlAt& force,
                                       const ContactSequence& apart, double margin, const Simulator* flight)
    : scene_(scene),
      terms_(terms),
      flight_(flight),
      cuts_(std::move(cuts)),
      steps_(std::move(steps)),
      place_(scene.bodies.size(), -1),
      stepped_(scene.bodies.size(), false),
      rotations_(scene_, flight) {
  CHECK_EQ(steps_.size(), cuts_.size() + 1);
  for (const int body : scene_.control.bodies) stepped_[body] = true;
  for (const RunningTerm& term : scene_.objective.running) stepped_[term.body] = true;
  for (const OwnTerm& term : terms_) {
    for (const int body : term.states) stepped_[body] = stepped_[body] || term.at == OwnTerm::At::kEachStep;
  }
  for (int c = 0; c < scene_.num_controlled(); ++c) place_[scene_.control.bodies[c]] = c;
  times_ = {0.0};
  boundary_ = {0};
  for (int j = 0; j < num_phases(); ++j) {
    const double end = j + 1 < num_phases() ? cuts_[j].time : scene_.duration;
    if (steps_[j] > 0) {
      times_.push_back(end);
    } else {
      times_.back() = end;
    }
    boundary_.push_back(static_cast<int>(times_.size()) - 1);
  }
  Lay(force, apart);
  AddSteps();
  HoldWhatIsGiven();
  if (scene_.optimize == Optimize::kPosition) KeepApartAtStart();
  AddImpacts();
  rotations_.AddTo(times_, turns_, LeastLength(), &problem_);
  AddBounds();
  AddTerms();
  for (const OwnTerm& term : terms_) AddOwn(term);
  for (const Candidate& pair : apart) KeepApart(pair, margin);
}

bool PhaseTranscription::Concerns(int body, const ContactSequence& apart) const {
  if (scene_.bodies[body].fixed) return false;
  if (stepped_[body]) return true;
  const auto is_of_body = [&](const auto& term) { return term.body == body; };
  const Objective& objective = scene_.objective;
  if (std::any_of(objective.terminal.begin(), objective.terminal.end(), is_of_body)) return true;
  if (std::any_of(objective.via.begin(), objective.via.end(), is_of_body)) return true;
  if (std::ranges::any_of(objective.limits, is_of_body)) return true;
  if (std::any_of(terms_.begin(), terms_.end(), [&](const OwnTerm& term) {
        return std::ranges::count(term.states, body) + std::ranges::count(term.rotations, body) > 0;
      })) {
    return true;
  }
  if (std::any_of(apart.begin(), apart.end(), [&](const Candidate& c) { return TakesPart(c, body); })) return true;
  return std::any_of(
      cuts_.begin(), cuts_.end(), [&](const PhaseCut& cut) { return cut.impact && TakesPart(*cut.impact, body); });
}

// Sets the nodes to those of a motion with open gaps at its impacts.
void PhaseTranscription::Lay(const ControlAt& force, const ContactSequence& apart) {
  std::vector<int> last(scene_.num_bodies(), -1);
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    const Body& body = scene_.bodies[i];
    if (!Concerns(i, apart)) continue;
    last[i] = AddNode({body.position[0], body.position[1], body.velocity[0], body.velocity[1]});
    rotations_.Add(i);
  }
  initial_ = last;
  tracks_.resize(scene_.num_bodies());
  for (int j = 0; j < num_phases(); ++j) {
    const double begin = *Begin(j), length = *End(j) - begin;
    first_force_.push_back(static_cast<int>(forces_.size()));
    for (int k = 0; k < steps_[j]; ++k) {
      for (int c = 0; c < scene_.num_controlled(); ++c) {
        const double middle = begin + (k + 0.5) * length / steps_[j];
        forces_.push_back({force(2 * c, middle), force(2 * c + 1, middle)});
      }
    }
    LayTurns(j, force);
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      if (last[i] < 0) continue;
      std::vector<int> track = {last[i]};
      const int steps = StepsOf(i, j);
      for (int k = 0; k < steps; ++k) {
        const double* u = place_[i] >= 0 ? ForceOn(i, j, k) : nullptr;
        track.push_back(AddNode(FlyOnce(i, nodes_[track.back()], u, length / steps)));
      }
      last[i] = track.back();
      tracks_[i].push_back(std::move(track));
    }
    if (j + 1 < num_phases() && cuts_[j].impact) Strike(j, &last);
  }
  rotations_.End(boundary_.back(), times_);
  final_ = last;
}

// Sets the rotations of discs under torques in a phase.
void PhaseTranscription::LayTurns(int phase, const ControlAt& force) {
  const double begin = *Begin(phase), length = *End(phase) - begin;
  const int first = static_cast<int>(turns_.size()), stride = scene_.num_turned();
  for (int k = 0; k < steps_[phase]; ++k) {
    for (int t = 0; t < stride; ++t) {
      turns_.push_back(force(2 * scene_.num_controlled() + t, begin + (k + 0.5) * length / steps_[phase]));
    }
  }
  for (int t = 0; t < stride; ++t) {
    const PhaseRotations::Span span{boundary_[phase], boundary_[phase + 1], steps_[phase]};
    rotations_.TurnUnder(scene_.control.turned[t], span, {first + t, stride}, turns_, times_);
  }
}

PhaseTranscription::Node PhaseTranscription::FlyOnce(int body, const Node& x, const double* force, double h) const {
  const Vec2d a = FlightAcceleration(scene_.gravity, 1 / scene_.bodies[body].mass, force);
  Node next;
  if (flight_ == nullptr) {
    Fly(x.data(), a, h, next.data());
  } else {
    Fly(flight_->FreeFlightOver(h).value().flight, x.data(), a, next.data());
  }
  return next;
}

// The impact as if the two touched; not if they separate.
void PhaseTranscription::Strike(int index, std::vector<int>* last) {
  const Candidate& c = *cuts_[index].impact;
  const ImpactCut cut = MakeCut(scene_, c);
  ImpactNodes nodes;
  std::array<Vec2d, 2> p = {Vec2d(0, 0), Vec2d(0, 0)}, v = p;
  for (int side = 0; side < 2; ++side) {
    if (cut.at[side]) p[side] = *cut.at[side];
    if (!cut.Moves(side)) continue;
    nodes.before[side] = (*last)[side == 0 ? c.a : c.b];
    const Node& x = nodes_[nodes.before[side]];
    p[side] = {x[0], x[1]};
    v[side] = {x[2], x[3]};
  }
  std::array<double, 2> spin = {0, 0};
  for (int side = 0; side < 2; ++side) {
    if (!cut.Spins(side)) continue;
    nodes.rotation_before[side] = rotations_.TurnTo(side == 0 ? c.a : c.b, boundary_[index + 1], times_);
    spin[side] = rotations_.SpinOf(side == 0 ? c.a : c.b);
  }
  const Separation<double> apart = cut.plane ? Separate<double>(p[0], *cut.plane) : Separate<double>(p[0], p[1]);
  const Impact<double> impact = MakeImpact<double>(cut.law, apart.normal, Vec2d(v[0] - v[1]), spin);
  for (int side = 0; side < 2; ++side) {
    if (!cut.Moves(side)) continue;
    Node after = nodes_[nodes.before[side]];
    const double gain = side == 0 ? cut.law.inverse_mass_a : -cut.law.inverse_mass_b;
    for (int k = 0; k < 2 && impact.speed < 0; ++k) after[2 + k] += gain * impact.impulse[k];
    nodes.after[side] = AddNode(after);
    (*last)[side == 0 ? c.a : c.b] = nodes.after[side];
    if (!cut.Spins(side)) continue;
    const double turn = impact.speed < 0 ? SpinGain(cut.law, side, impact) : 0.0;
    nodes.rotation_after[side] = rotations_.Strike(side == 0 ? c.a : c.b, turn);
  }
  impacts_.push_back(nodes);
}

int PhaseTranscription::AddNode(const Node& node) {
  nodes_.push_back(node);
  return static_cast<int>(nodes_.size()) - 1;
}

void PhaseTranscription::AddSteps() {
  const double least = LeastLength();
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    for (size_t j = 0; j < tracks_[i].size(); ++j) {
      const std::vector<int>& track = tracks_[i][j];
      const int steps = static_cast<int>(track.size()) - 1;
      for (int k = 0; k < steps; ++k) {
        const StepOfPhase step{k, steps};
        std::vector<double*> blocks = {NodeAt(track[k]), Begin(j), End(j), NodeAt(track[k + 1])};
        std::optional<Push> push;
        if (place_[i] >= 0) {
          push = {1 / scene_.bodies[i].mass, scene_.objective.effort, least};
          blocks.insert(blocks.begin() + 1, ForceOn(i, static_cast<int>(j), k));
        }
        std::unique_ptr<ceres::CostFunction> cost;
        if (flight_ != nullptr) {
          cost = std::make_unique<ModelStep<2>>(*flight_, step, push);
        } else if (push) {
          cost = Sized<4, 2, 1, 1, 4>(PushedStep<2>{step, scene_.gravity, push->inverse_mass, push->effort, least});
        } else {
          cost = Sized<4, 1, 1, 4>(CoastingStep<2>{step, scene_.gravity});
        }
        problem_.Add(std::move(cost), {.equalities = PushedStep<2>::kEqualities}, blocks);
      }
    }
  }
}

// The initial state, except for what is optimized of it, and then the forces.
void PhaseTranscription::HoldWhatIsGiven() {
  ceres::Problem& problem = problem_.problem();
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    if (initial_[i] < 0) continue;
    double* x = NodeAt(initial_[i]);
    const bool is_free = std::find(scene_.free.begin(), scene_.free.end(), i) != scene_.free.end();
    if (!is_free || (scene_.optimize != Optimize::kPosition && scene_.optimize != Optimize::kVelocity)) {
      problem.SetParameterBlockConstant(x);
      continue;
    }
    const std::vector<int> held = scene_.optimize == Optimize::kPosition ? std::vector{2, 3} : std::vector{0, 1};
    problem.SetManifold(x, new ceres::SubsetManifold(4, held));
  }
  if (scene_.optimize == Optimize::kControl) return;
  for (std::array<double, 2>& force : forces_) problem.SetParameterBlockConstant(force.data());
}

// Adds that discs do not overlap at the start, if their positions are optimized.
void PhaseTranscription::KeepApartAtStart() {
  const auto is_free = [&](int body) { return std::ranges::count(scene_.free, body) > 0 && initial_[body] >= 0; };
  for (const Candidate& c : AllPairs(scene_)) {
    if (!is_free(c.a) && (c.plane || !is_free(c.b))) continue;
    const ImpactCut cut = MakeCut(scene_, c);
    StartGap gap{cut.law.contact_distance, cut.plane, {}};
    std::vector<double*> blocks;
    for (int side = 0; side < (c.plane ? 1 : 2); ++side) {
      const int body = side == 0 ? c.a : c.b;
      if (is_free(body)) {
        blocks.push_back(NodeAt(initial_[body]));
      } else {
        gap.at[side] = scene_.bodies[body].position;
      }
    }
    problem_.Add(Dynamic(gap, 1, std::vector<int>(blocks.size(), 4)), {.inequalities = 1}, blocks);
  }
}

double PhaseTranscription::LeastLength() const {
  return kLeastLength * scene_.duration / std::accumulate(steps_.begin(), steps_.end(), 0);
}

std::vector<double*> PhaseTranscription::BlocksOf(const ImpactCut& cut, const ImpactNodes& nodes) {
  std::vector<double*> blocks;
  for (int side = 0; side < 2; ++side) {
    if (!cut.Moves(side)) continue;
    blocks.push_back(NodeAt(nodes.before[side]));
    blocks.push_back(NodeAt(nodes.after[side]));
  }
  for (int side = 0; side < 2; ++side) {
    if (!cut.Spins(side)) continue;
    blocks.push_back(rotations_.At(nodes.rotation_before[side]));
    blocks.push_back(rotations_.At(nodes.rotation_after[side]));
  }
  return blocks;
}

void PhaseTranscription::AddImpacts() {
  for (size_t k = 0, strike = 0; k < cuts_.size(); ++k) {
    if (!cuts_[k].impact) continue;
    ImpactCut cut = MakeCut(scene_, *cuts_[k].impact);
    cut.overlap = cuts_[k].overlap;
    cut.mode = cuts_[k].mode;
    const std::vector<double*> blocks = BlocksOf(cut, impacts_[strike++]);
    std::vector<int> sizes(2 * cut.num_moving(), 4);
    sizes.resize(blocks.size(), kSpin);
    const int equalities = cut.num_equalities();
    const int inequalities = cut.num_inequalities();
    problem_.Add(Dynamic(cut, equalities + inequalities, sizes),
                 {.equalities = equalities, .inequalities = inequalities},
                 blocks);
  }
}

void PhaseTranscription::AddBounds() {
  for (int j = 0; j < num_phases(); ++j) {
    if (steps_[j] == 0) continue;
    problem_.Add(Sized<1, 1>(LengthBound{}), {.inequalities = 1}, {Begin(j), End(j)});
  }
  const saltus::Control& control = scene_.control;
  for (size_t k = 0; scene_.optimize == Optimize::kControl && k < forces_.size(); ++k) {
    const int c = static_cast<int>(k) % scene_.num_controlled();
    if (!control.max.empty()) {
      problem_.Add(
          Sized<2>(ComponentBound<2>{control.max[c]}), {.inequalities = 4, .are_bounds = true}, {forces_[k].data()});
    }
    if (!control.max_norm.empty()) {
      problem_.Add(
          Sized<2>(NormBound{control.max_norm[c]}), {.inequalities = 1, .are_curved = true}, {forces_[k].data()});
    }
  }
  for (size_t k = 0; scene_.optimize == Optimize::kControl && k < turns_.size(); ++k) {
    const double most = MostTurn(scene_, static_cast<int>(k) % scene_.num_turned());
    if (std::isfinite(most))
      problem_.Add(Sized<1>(ComponentBound<1>{most}), {.inequalities = 2, .are_bounds = true}, {&turns_[k]});
  }
}

// Adds the terms of the objective that depend on nodes, and those of the final time.
void PhaseTranscription::AddTerms() {
  const auto hold = [&](TerminalTerm::Quantity quantity, const TerminalTerm::Region& region, int node) {
    const GoalRows goal{quantity, region};
    const RowRoles roles{
        .equalities = goal.num_equalities(), .inequalities = goal.num_inequalities(), .are_goals = true};
    problem_.Add(Dynamic(goal, roles.equalities + roles.inequalities, std::array{4}), roles, {NodeAt(node)});
  };
  const auto aim = [&](const auto& term, int node) {
    problem_.Add(Sized<4>(Target<2>{term.quantity, term.target, std::sqrt(term.weight)}), {}, {NodeAt(node)});
  };
  for (const TerminalTerm& term : scene_.objective.terminal) {
    if (scene_.bodies[term.body].fixed || term.IsOfSpin()) continue;
    if (term.hard) {
      hold(term.quantity, term.Goal(), final_[term.body]);
    } else {
      aim(term, final_[term.body]);
    }
  }
  for (const ViaTerm& term : scene_.objective.via) {
    for (size_t k = 0; k < cuts_.size(); ++k) {
      if (cuts_[k].impact || cuts_[k].time != term.time) continue;
      const int node = tracks_[term.body][k].back();
      if (term.hard) {
        hold(term.quantity, {term.target, term.target}, node);
      } else {
        aim(term, node);
      }
    }
  }
  for (const SpeedLimit& limit : scene_.objective.limits) AddLimit(limit);
  for (const RunningTerm& term : scene_.objective.running) AddRunning(term);
  ceres::Problem& problem = problem_.problem();
  problem.SetParameterBlockConstant(Begin(0));
  for (size_t k = 0; k < cuts_.size(); ++k) {
    if (!cuts_[k].impact) problem.SetParameterBlockConstant(End(static_cast<int>(k)));
  }
  double* end = End(num_phases() - 1);
  if (const std::optional<FreeDuration>& free = scene_.objective.duration) {
    problem.SetParameterLowerBound(end, 0, free->min);
    problem.SetParameterUpperBound(end, 0, free->max);
    if (free->weight > 0) problem_.Add(Sized<1>(DurationPrice{free->weight}), {}, {end});
  } else {
    problem.SetParameterBlockConstant(end);
  }
}

// Adds a limit of the speed, which under a constant force is largest at the ends of a step.
void PhaseTranscription::AddLimit(const SpeedLimit& limit) {
  const auto hold = [&](int node) {
    if (problem_.problem().IsParameterBlockConstant(NodeAt(node))) return;
    problem_.Add(Sized<4>(SpeedBound{limit.max}), {.inequalities = 1, .are_goals = true}, {NodeAt(node)});
  };
  if (limit.at == SpeedLimit::At::kEnd) return hold(final_[limit.body]);
  int last = -1;  // of the phase before, which the next one begins with, unless the disc takes part in the impact
  for (const std::vector<int>& track : tracks_[limit.body]) {
    for (const int node : track) {
      if (node != last) hold(node);
      last = node;
    }
  }
}

void PhaseTranscription::AddOwn(const OwnTerm& term) {
  const auto add = [&](int steps,
                       const auto& node_of,
                       const auto& force_of,
                       const auto& rotation_of,
                       int step,
                       const std::vector<double*>& times) {
    auto cost = std::make_unique<OwnTermCost>(term, scene_, steps);
    const int rows = cost->num_residuals();
    RowRoles roles;
    if (term.role == OwnTerm::Role::kEquality) roles.equalities = rows;
    if (term.role == OwnTerm::Role::kInequality) roles.inequalities = rows;
    roles.are_goals = term.at == OwnTerm::At::kEnd;
    std::vector<double*> blocks;
    for (const int body : term.states) blocks.push_back(node_of(body));
    for (const int body : term.forces) blocks.push_back(force_of(body));
    for (const int body : term.rotations) blocks.push_back(rotations_.At(rotation_of(body)));
    for (const int body : term.torques) {
      const std::vector<int>& turned = scene_.control.turned;
      const auto place = std::find(turned.begin(), turned.end(), body) - turned.begin();
      blocks.push_back(&turns_[static_cast<size_t>(step * scene_.num_turned() + place)]);
    }
    if (term.with_length) blocks.insert(blocks.end(), times.begin(), times.end());
    problem_.Add(std::move(cost), roles, blocks);
  };
  if (term.at == OwnTerm::At::kEnd) {
    const auto no_force = [](int) -> double* { return nullptr; };
    const auto rotation = [&](int body) { return rotations_.LastNode(body); };
    add(1, [&](int body) { return NodeAt(final_[body]); }, no_force, rotation, 0, {End(num_phases() - 1)});
    return;
  }
  int step = 0;  // of all phases
  for (int j = 0; j < num_phases(); ++j) {
    for (int k = 0; k < steps_[j]; ++k, ++step) {
      add(
          steps_[j],
          [&](int body) { return NodeAt(tracks_[body][j][k]); },
          [&](int body) { return ForceOn(body, j, k); },
          [&](int body) { return rotations_.StepNode(body, step); },
          step,
          {Begin(j), End(j)});
    }
  }
}

void PhaseTranscription::AddRunning(const RunningTerm& term) {
  const Body& body = scene_.bodies[term.body];
  if (body.fixed) return;
  const bool pushed = place_[term.body] >= 0;
  for (int j = 0; j < num_phases(); ++j) {
    for (int k = 0; k < steps_[j]; ++k) {
      std::vector<double*> blocks = {NodeAt(tracks_[term.body][j][k])};
      std::vector<int> sizes = {4};
      if (pushed) {
        blocks.push_back(ForceOn(term.body, j, k));
        sizes.push_back(2);
      }
      blocks.insert(blocks.end(), {Begin(j), End(j)});
      sizes.insert(sizes.end(), {1, 1});
      const RunningCost cost{{k, steps_[j]}, scene_.gravity, 1 / body.mass, pushed, LeastLength(), term};
      problem_.Add(Dynamic(cost, RunningCost::kRows, sizes), {}, blocks);
    }
  }
}

void PhaseTranscription::KeepApart(const Candidate& c, double margin) {
  const ImpactCut cut = MakeCut(scene_, c);
  const auto strikes_at = [&](int k) { return k >= 0 && k + 1 < num_phases() && cuts_[k].impact == c; };
  for (int j = 0; j < num_phases(); ++j) {
    if (strikes_at(j - 1) || strikes_at(j)) continue;
    for (int k = 0; k < steps_[j]; ++k) {
      Clearance clearance{cut.law.contact_distance * (1 + margin), cut.plane, {}, {k, steps_[j]}, scene_.gravity};
      std::vector<double*> blocks, forces;
      std::vector<int> sizes;
      for (int side = 0; side < clearance.num_sides(); ++side) {
        const int body = side == 0 ? c.a : c.b;
        clearance.sides[side].at = cut.at[side];
        if (cut.at[side]) continue;
        clearance.sides[side].coasts = !IsDense(body);
        clearance.sides[side].inverse_mass = 1 / scene_.bodies[body].mass;
        blocks.push_back(NodeAt(tracks_[body][j][IsDense(body) ? k : 0]));
        sizes.push_back(4);
        if (place_[body] < 0) continue;
        clearance.sides[side].pushed = true;
        forces.push_back(ForceOn(body, j, k));
      }
      blocks.insert(blocks.end(), forces.begin(), forces.end());
      sizes.insert(sizes.end(), forces.size(), 2);
      blocks.insert(blocks.end(), {Begin(j), End(j)});
      sizes.insert(sizes.end(), {1, 1});
      problem_.Add(Dynamic(clearance, 1, sizes), {.inequalities = 1}, blocks);
    }
  }
}

AugmentedLagrangian::Summary PhaseTranscription::Minimize(AugmentedLagrangian::Options options) {
  options.ScaleTo(*std::max_element(steps_.begin(), steps_.end()));
  return problem_.Minimize(options);
}

std::vector<double> PhaseTranscription::CutTimes() const {
  std::vector<double> times;
  for (size_t k = 0; k < cuts_.size(); ++k) times.push_back(times_[boundary_[k + 1]]);
  return times;
}

std::vector<double> PhaseTranscription::CutSpeeds() {
  std::vector<double> speeds;
  for (size_t k = 0, strike = 0; k < cuts_.size(); ++k) {
    speeds.push_back(0);
    if (!cuts_[k].impact) continue;
    const ImpactCut cut = MakeCut(scene_, *cuts_[k].impact);
    const std::vector<double*> blocks = BlocksOf(cut, impacts_[strike++]);
    std::vector<double> rows(cut.num_equalities() + 1);
    cut(blocks.data(), rows.data());
    speeds.back() = rows.back();
  }
  return speeds;
}

std::vector<double> PhaseTranscription::InitialState() const {
  std::vector<double> states = saltus::InitialState(scene_);
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    if (initial_[i] >= 0) std::copy_n(nodes_[initial_[i]].data(), 4, &states[4 * i]);
  }
  rotations_.CopyInitial(&states);
  return states;
}

void PhaseTranscription::Control(std::vector<double>* control, std::vector<double>* durations) const {
  control->clear();
  durations->clear();
  for (int j = 0; j < num_phases(); ++j) {
    for (int k = 0; k < steps_[j]; ++k)
      durations->push_back((times_[boundary_[j + 1]] - times_[boundary_[j]]) / steps_[j]);
  }
  const int pushed = scene_.num_controlled(), turned = scene_.num_turned();
  for (size_t k = 0; k < durations->size() && pushed > 0; ++k) {
    for (int c = 0; c < pushed; ++c) {
      const std::array<double, 2>& force = forces_[k * pushed + c];
      control->insert(control->end(), force.begin(), force.end());
    }
    const auto turns = turns_.begin() + static_cast<std::ptrdiff_t>(k) * turned;
    control->insert(control->end(), turns, turns + turned);
  }
}

}  // namespace saltus
