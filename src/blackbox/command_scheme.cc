#include "blackbox/command_scheme.h"

#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

namespace saltus {
namespace {

constexpr std::size_t kMostCharacters = 1 << 20;  // of an answer

}  // namespace

CommandScheme::CommandScheme(const HybridSystem& system, CommandOptions options, const ProtocolJson& scene)
    : system_(system), name_(options.name), session_(HelloOf(system, scene), options) {}

int CommandScheme::Ask(const SchemeStep& step, double* next, double* jacobian, std::string* error) {
  *error = session_.traits().not_applicable;
  if (error->empty()) *error = session_.traits().error;
  if (!error->empty()) return -1;
  int mode = -1;
  const auto take = [&](const ProtocolJson& reply, ProtocolJson*) {
    *error = ErrorIn(reply);
    if (!error->empty()) return false;
    const ProtocolJson name = reply.value("mode", ProtocolJson());
    for (mode = 0; mode < system_.num_modes() && name != system_.ModeName(mode);) ++mode;
    if (mode == system_.num_modes()) throw ProtocolError("found mode " + name.dump() + ", which does not exist");
    const std::size_t size = system_.state_size(mode),
                      columns = system_.state_size(step.mode) + system_.num_controls() + system_.num_parameters();
    const std::vector<double> state = NumbersAt(reply, "state", {size});
    std::ranges::copy(state, next);
    for (const double number : state) is_float32_ = is_float32_ && number == static_cast<float>(number);
    if (jacobian != nullptr) std::ranges::copy(NumbersAt(reply, "jacobian", {size, columns}), jacobian);
    knows_precision_ = true;
    return false;
  };
  session_.Ask({{"step", StepToJson(system_, step, jacobian != nullptr), kMostCharacters, take}});
  if (!session_.broken().empty()) *error = session_.broken();
  return error->empty() ? mode : -1;
}

int CommandScheme::Step(const SchemeStep& step, double* next, double* jacobian, std::string* error) {
  if (jacobian == nullptr || HasJacobian()) return Ask(step, next, jacobian, error);
  const StepFunction ask = [this](const SchemeStep& at, double* after, std::string* why) {
    return Ask(at, after, nullptr, why);
  };
  if (!knows_precision_ && Ask(step, next, nullptr, error) < 0) return -1;
  const double precision = is_float32_ ? std::numeric_limits<float>::epsilon() : std::numeric_limits<double>::epsilon();
  return DifferenceStep(system_, step, ask, next, jacobian, error, precision);
}

}  // namespace saltus
