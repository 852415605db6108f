// What a step promises of the contacts that it reports and of the discs that it does not (contact_model.h): checked in
// every step, as derivatives are taken of reported contacts only. A model that forgets one would have a wrong gradient
// and nothing to show it.
#pragma once

#include <span>
#include <string_view>
#include <vector>

#include "saltus/contact/step_input.h"

namespace saltus {

// What a step does that it must not, and with which disc; nothing if there are no words.
struct BrokenContract {
  std::string_view what;
  int disc = -1;
};

// Whether two states are the same numbers. What does not fly to a number is left to those who look for that.
template <typename State>
bool FliesTo(const State& flying, const State& next) {
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

// Of a step from which disc i went to next[i], flying(i) says where free flight would have taken it and fixed(i)
// whether it cannot move. All indices are those of the step; `reported` is memory.
template <typename State, typename FixedOf, typename FlyingOf>
BrokenContract CheckContract(std::span<const Touch> touches, std::span<const State> next, int num_planes,
                             const FixedOf& fixed, const FlyingOf& flying, std::vector<char>* reported) {
  const int n = static_cast<int>(next.size());
  reported->assign(next.size(), 0);
  for (const Touch& touch : touches) {
    const Candidate& c = touch.candidate;
    const bool known = c.a >= 0 && c.a < n && c.b >= 0 && c.b < (c.plane ? num_planes : n);
    if (!known) return {"the model reports a contact of what it was not given"};
    (*reported)[c.a] = 1;
    if (!c.plane) (*reported)[c.b] = 1;
  }
  for (int i = 0; i < n; ++i) {
    if ((*reported)[i] || fixed(i) || FliesTo<State>(flying(i), next[i])) continue;
    return {"the disc does not fly freely, and the model reports no contact of it (StepInput::Report)", i};
  }
  return {};
}

}  // namespace saltus
