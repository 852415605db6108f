// The contract of a step about the contacts that it reports and the discs that it does not (contact_model.h). It is
// checked in every step, because only reported contacts are differentiated: a model that omits one would have a wrong
// gradient without any other sign of it.
#pragma once

#include <span>
#include <string_view>
#include <vector>

#include "saltus/contact/step_input.h"

namespace saltus {

// How a step breaks the contract, and the disc with which it does; `what` is empty if it does not.
struct BrokenContract {
  std::string_view what;
  int disc = -1;
};

// Whether two states have the same numbers. A flight that leads to NaN passes here; others look for that.
template <typename State>
bool IsFreeFlight(const State& flying, const State& next) {
  const auto same = [](const auto& expected, const auto& found) { return found == expected || expected != expected; };
  for (int j = 0; j < 2; ++j) {
    if (!same(flying.p[j], next.p[j]) || !same(flying.v[j], next.v[j])) return false;
  }
  if constexpr (State::kSize > 4) {
    for (int j = 0; j < State::kSize - 4; ++j) {
      if (!same(flying.rotation[j], next.rotation[j])) return false;
    }
  }
  return true;
}

// Checks a step in which disc i went to next[i]; flying(i) is its state after free flight, fixed(i) is true if it
// cannot move. All indices are those of the step; `reported` is memory.
template <typename State, typename FixedOf, typename FlyingOf>
BrokenContract CheckContract(std::span<const Touch> touches, std::span<const State> next, int num_planes,
                             const FixedOf& fixed, const FlyingOf& flying, std::vector<char>* reported) {
  const int n = static_cast<int>(next.size());
  reported->assign(next.size(), 0);
  for (const Touch& touch : touches) {
    const Candidate& c = touch.candidate;
    const bool known = c.a >= 0 && c.a < n && c.b >= 0 && c.b < (c.plane ? num_planes : n);
    if (!known) return {"the model reports a contact of a pair that is not among its candidates"};
    (*reported)[c.a] = 1;
    if (!c.plane) (*reported)[c.b] = 1;
  }
  for (int i = 0; i < n; ++i) {
    if ((*reported)[i] || fixed(i) || IsFreeFlight<State>(flying(i), next[i])) continue;
    return {"the disc does not fly freely, and the model reports no contact of it (StepInput::Report)", i};
  }
  return {};
}

}  // namespace saltus
