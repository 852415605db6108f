#include "hybrid/linear_parts.h"

#include <algorithm>
#include <array>
#include <map>
#include <numeric>
#include <set>
#include <utility>

namespace saltus {
namespace {

// Returns the inputs that an output reads, whatever its derivatives by them are.
std::set<int> InputsOf(const ExpressionGraph& graph, int output) {
  std::vector<bool> is_read(graph.nodes.size());
  std::set<int> inputs;
  is_read[output] = true;
  for (int i = output; i >= 0; --i) {
    if (!is_read[i]) continue;
    const ExpressionGraph::Node& node = graph.nodes[i];
    if (node.operation == Operation::kInput) {
      inputs.insert(node.a);
      continue;
    }
    const std::array<int, 3> operands = {node.a, node.b, node.c};
    for (int j = 0; j < NumOperands(node.operation); ++j) is_read[operands[j]] = true;
  }
  return inputs;
}

// Returns the states that an event reads or changes.
std::set<int> StatesOf(const RecordedSystem::Transition& event, int num_states) {
  const ExpressionGraph &guard = event.guard.recording(), &reset = event.reset.recording();
  std::set<int> states = InputsOf(guard, guard.outputs[0]);
  for (int i = 0; i < static_cast<int>(reset.outputs.size()); ++i) {
    const ExpressionGraph::Node& node = reset.nodes[reset.outputs[i]];
    if (node.operation == Operation::kInput && node.a == i) continue;  // the state goes on
    states.merge(InputsOf(reset, reset.outputs[i]));
    states.insert(i);
  }
  states.erase(states.lower_bound(num_states), states.end());
  return states;
}

}  // namespace

LinearParts::LinearParts(const RecordedFunction& flow, const std::vector<LinearFlow::Entry>& derivatives,
                         const std::vector<RecordedSystem::Transition>& transitions, int num_states, int num_parameters,
                         int num_controls)
    : num_parameters_(num_parameters) {
  const int n = num_states, first_control = n + 1 + num_parameters;
  for (const RecordedSystem::Transition& transition : transitions) {
    if (transition.guard.num_inputs() > first_control) return;
  }
  // States and controls are connected by the derivatives.
  std::vector<int> group(n + num_controls);
  std::iota(group.begin(), group.end(), 0);
  for (const LinearFlow::Entry& entry : derivatives) {
    if (entry.column >= n && entry.column < first_control) continue;
    const int other = entry.column < n ? entry.column : n + entry.column - first_control;
    const int from = group[other], to = group[entry.row];
    std::ranges::replace(group, from, to);
  }
  // Blocks with a control, or without one, that the same events concern are one part.
  std::vector<std::set<int>> states_of_events;
  for (const RecordedSystem::Transition& transition : transitions) {
    states_of_events.push_back(StatesOf(transition, n));
  }
  const auto key_of = [&](int block) {
    std::pair<bool, std::set<int>> key(std::find(group.begin() + n, group.end(), block) != group.end(), {});
    for (int guard = 0; guard < std::ssize(states_of_events); ++guard) {
      const auto is_in_block = [&](int state) { return group[state] == block; };
      if (std::ranges::any_of(states_of_events[guard], is_in_block)) key.second.insert(guard);
    }
    return key;
  };
  std::map<std::pair<bool, std::set<int>>, int> part_of_key;
  std::vector<int> part_of(n);
  for (int i = 0; i < n; ++i) {
    const auto [at, is_new] = part_of_key.try_emplace(key_of(group[i]), static_cast<int>(parts_.size()));
    if (is_new) parts_.emplace_back();
    part_of[i] = at->second;
    parts_[at->second].states.push_back(i);
  }
  // A control that no state reads is one of the first part.
  for (int k = 0; k < num_controls; ++k) {
    const auto reader = std::find(group.begin(), group.begin() + n, group[n + k]);
    parts_[reader == group.begin() + n ? 0 : part_of[reader - group.begin()]].controls.push_back(k);
  }
  if (parts_.size() == 1) parts_.clear();
  std::vector<double> zeros(flow.num_inputs(), 0.0), rest(n);
  const std::array<RecordedFunction::Part, 1> inputs = {{{zeros.data(), static_cast<int>(zeros.size())}}};
  flow.Evaluate(inputs, rest.data());
  for (StatePart& part : parts_) {
    part.motion = part.controls.empty() ? StatePart::Motion::kCoasts : StatePart::Motion::kSteps;
    const int size = static_cast<int>(part.states.size());
    std::map<int, int> column_of;  // of the part, by that of the mode
    for (const int state : part.states) column_of.emplace(state, static_cast<int>(column_of.size()));
    for (int column = n; column < first_control; ++column) column_of.emplace(column, size + column - n);
    for (const int control : part.controls) {
      column_of.emplace(first_control + control, static_cast<int>(column_of.size()));
    }
    std::vector<LinearFlow::Entry> own;
    for (const LinearFlow::Entry& entry : derivatives) {
      if (!std::ranges::binary_search(part.states, entry.row)) continue;
      own.push_back({column_of.at(entry.row), column_of.at(entry.column), entry.value});
    }
    std::vector<double> rest_of_part;
    for (const int state : part.states) rest_of_part.push_back(rest[state]);
    blocks_.push_back(
        {own, std::move(rest_of_part), LinearFlow(size, static_cast<int>(column_of.size()), std::move(own))});
  }
  for (const std::set<int>& states : states_of_events) {
    std::set<int> touched;
    for (const int state : states) touched.insert(part_of[state]);
    of_guards_.emplace_back(touched.begin(), touched.end());
  }
}

void LinearParts::SetSlope(int part, const FlowStep& step, double t, const double* x, double* slope) const {
  const int n = static_cast<int>(parts_[part].states.size());
  std::ranges::copy(blocks_[part].rest, slope);
  for (const LinearFlow::Entry& entry : blocks_[part].derivatives) {
    const int place = entry.column - n - 1;
    const double input = place < -1                ? x[entry.column]
                         : place == -1             ? t
                         : place < num_parameters_ ? step.p[place]
                                                   : step.u[place - num_parameters_];
    slope[entry.row] += entry.value * input;
  }
}

void LinearParts::Move(int part, const FlowStep& step, double* after, double* jacobian) const {
  const int n = static_cast<int>(parts_[part].states.size());
  const int columns = n + 1 + num_parameters_ + static_cast<int>(parts_[part].controls.size());
  double slope[LinearFlow::kMostStates];
  SetSlope(part, step, step.t, step.x, slope);
  blocks_[part].closed_form.Step(step.h, step.x, slope, after);
  if (jacobian == nullptr) return;
  std::vector<double> by(static_cast<std::size_t>(n) * columns);
  blocks_[part].closed_form.Jacobian(step.h, by.data());
  SetSlope(part, step, step.t + step.h, after, slope);
  for (int row = 0; row < n; ++row) {
    double* const to =
        std::copy_n(&by[static_cast<std::size_t>(row) * columns], columns, jacobian + row * (columns + 1));
    *to = slope[row];
  }
}

}  // namespace saltus
