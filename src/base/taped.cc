#include "saltus/internal/taped.h"

namespace saltus {

Tape& Tape::ThreadTape() {
  static thread_local Tape tape;  // the operators of a scalar have no argument by which a tape could reach them
  return tape;
}

Taped Taped::FromDerivatives(double value, const Taped& a, double by_a) {
  return {value, a.place_ == 0 ? 0 : Tape::ThreadTape().Add(a.place_, by_a)};
}

Taped Taped::FromDerivatives(double value, const Taped& a, double by_a, const Taped& b, double by_b) {
  if (a.place_ == 0 && b.place_ == 0) return Taped(value);
  return {value, Tape::ThreadTape().Add(a.place_, by_a, b.place_, by_b)};
}

void Tape::AddMap(std::span<const Taped> inputs, std::span<Taped> outputs, PullBack pull_back) {
  Map map{static_cast<int>(entries_.size()), {}, static_cast<int>(outputs.size()), std::move(pull_back)};
  map.inputs.reserve(inputs.size());
  for (const Taped& input : inputs) map.inputs.push_back(input.place());
  for (Taped& output : outputs) output = Taped(output.value(), Add(0, 0));
  maps_.push_back(std::move(map));
}

std::span<const double> Tape::Sweep(std::span<const std::pair<int, double>> cotangents) {
  cotangents_.assign(entries_.size(), 0.0);
  for (const auto& [place, cotangent] : cotangents) cotangents_[place] += cotangent;
  int at = static_cast<int>(entries_.size()) - 1;
  const auto sweep_to = [&](int first) {
    for (; at >= first; --at) {
      const Entry& entry = entries_[at];
      const double cotangent = cotangents_[at];
      cotangents_[entry.a] += entry.by_a * cotangent;
      cotangents_[entry.b] += entry.by_b * cotangent;
    }
  };
  for (auto map = maps_.rbegin(); map != maps_.rend(); ++map) {
    sweep_to(map->first);
    SweepMap(*map);
  }
  sweep_to(1);
  cotangents_[0] = 0;
  return cotangents_;
}

void Tape::SweepMap(const Map& map) {
  of_inputs_.assign(map.inputs.size(), 0.0);
  map.pull_back(std::span<const double>(cotangents_).subspan(map.first, map.num_outputs), of_inputs_);
  for (std::size_t i = 0; i < map.inputs.size(); ++i) cotangents_[map.inputs[i]] += of_inputs_[i];
}

}  // namespace saltus
