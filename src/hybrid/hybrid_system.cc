#include "saltus/hybrid/hybrid_system.h"

#include <numeric>

namespace saltus {
namespace {

// Returns name number `index`, or `otherwise` if there are no names.
std::string NameOr(const std::vector<std::string>& names, int index, const std::string& otherwise) {
  return names.empty() ? otherwise : names[index];
}

std::string Indexed(const char* name, int component) {
  return std::string(name) + "[" + std::to_string(component) + "]";
}

int OffsetOfMode(const std::vector<int>& numbers, int mode) {
  return std::accumulate(numbers.begin(), numbers.begin() + mode, 0);
}

}  // namespace

std::string HybridFunctions::ModeName(int mode) const {
  return NameOr(layout().mode_names, mode, "mode " + std::to_string(mode));
}

std::string HybridFunctions::GuardName(int mode, int guard) const {
  return NameOr(
      layout().guard_names, OffsetOfMode(layout().num_guards, mode) + guard, "guard " + std::to_string(guard));
}

std::string HybridFunctions::StateName(int mode, int component) const {
  return NameOr(layout().state_names, OffsetOfMode(layout().state_sizes, mode) + component, Indexed("x", component));
}

std::vector<StatePart> HybridFunctions::Parts(int mode) const {
  StatePart all;
  all.states.resize(state_size(mode));
  all.controls.resize(layout().num_controls);
  std::iota(all.states.begin(), all.states.end(), 0);
  std::iota(all.controls.begin(), all.controls.end(), 0);
  return {all};
}

std::vector<int> HybridFunctions::PartsOf(int mode, int /*guard*/) const {
  std::vector<int> all(Parts(mode).size());
  std::iota(all.begin(), all.end(), 0);
  return all;
}

void HybridFunctions::AppendGuardTerms(const ModePoint& at, int guard, std::vector<GuardTerm>* terms) const {
  const int n = state_size(at.mode);
  std::vector<double> gradient(n + 1 + layout().num_parameters + layout().num_controls);
  GuardGradient(at, guard, gradient.data());
  AppendTerms(gradient.data(), n, static_cast<int>(gradient.size()), terms);
}

std::string HybridSystem::ControlName(int component) const {
  return NameOr(layout().control_names, component, Indexed("u", component));
}

std::string HybridSystem::ParameterName(int component) const {
  return NameOr(layout().parameter_names, component, Indexed("p", component));
}

}  // namespace saltus
