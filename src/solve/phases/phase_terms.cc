// What an objective asks of the nodes of a PhaseTranscription: terminal, via and running terms, those of a user's own,
// and the final time.
#include <algorithm>
#include <cmath>

#include "solve/phases/phase_functions.h"
#include "solve/phases/phase_transcription.h"

namespace saltus {

void PhaseTranscription::AddTerms() {
  for (const TerminalTerm& term : scene_.objective.terminal) {
    if (scene_.bodies[term.body].fixed || term.IsOfSpin()) continue;
    const double scale = term.hard ? 1.0 : std::sqrt(term.weight);
    problem_.Add(Sized<4>(NodeTarget{term.quantity, term.target, scale}),
                 {.equalities = term.hard ? NodeTarget::kRows : 0},
                 {NodeAt(final_[term.body])});
  }
  for (const ViaTerm& term : scene_.objective.via) {
    for (size_t k = 0; k < cuts_.size(); ++k) {
      if (cuts_[k].impact || cuts_[k].time != term.time) continue;
      const double scale = term.hard ? 1.0 : std::sqrt(term.weight);
      problem_.Add(Sized<4>(NodeTarget{term.quantity, term.target, scale}),
                   {.equalities = term.hard ? NodeTarget::kRows : 0},
                   {NodeAt(tracks_[term.body][k].back())});
    }
  }
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

}  // namespace saltus
