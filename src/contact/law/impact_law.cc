#include "saltus/contact/impact_law.h"

#include <ceres/cost_function.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace saltus {
namespace {

constexpr double kSpread = 3;  // of weights, whose inputs and outputs are about 1

// Parameters: for each hidden unit `inputs` weights and a bias, then for each output `width` weights and a bias.
class Network final : public ceres::CostFunction {
 public:
  Network(int width, int inputs, int outputs, double speed) : width_(width), inputs_(inputs), speed_(speed) {
    set_num_residuals(outputs);
    *mutable_parameter_block_sizes() = {2, width * (inputs + 1) + outputs * (width + 1)};
  }

  bool Evaluate(double const* const* blocks, double* outputs, double** jacobians) const override {
    const double *speeds = blocks[0], *weights = blocks[1];
    std::vector<double> hidden(width_);
    for (int i = 0; i < width_; ++i) {
      const double* of_unit = weights + i * (inputs_ + 1);
      double sum = of_unit[inputs_];
      for (int j = 0; j < inputs_; ++j) sum += of_unit[j] * speeds[j] / speed_;
      hidden[i] = std::tanh(sum);
    }
    for (int r = 0; r < num_residuals(); ++r) {
      const int first = width_ * (inputs_ + 1) + r * (width_ + 1);
      double sum = weights[first + width_];
      for (int i = 0; i < width_; ++i) sum += weights[first + i] * hidden[i];
      // The logistic function keeps the restitution in (0, 1), the exponential keeps the friction positive.
      outputs[r] = r == 0 ? 1 / (1 + std::exp(-sum)) : std::exp(sum);
      const double slope = r == 0 ? outputs[r] * (1 - outputs[r]) : outputs[r];
      if (jacobians != nullptr) Differentiate(r, first, slope, speeds, weights, hidden, jacobians);
    }
    return true;
  }

 private:
  // Sets the derivatives of output r, whose weights begin at `first`.
  void Differentiate(int r, int first, double slope, const double* speeds, const double* weights,
                     const std::vector<double>& hidden, double** jacobians) const {
    double* by_speeds = jacobians[0] == nullptr ? nullptr : jacobians[0] + 2 * r;
    const int count = parameter_block_sizes()[1];
    double* by_weights = jacobians[1] == nullptr ? nullptr : jacobians[1] + r * count;
    if (by_speeds != nullptr) std::fill_n(by_speeds, 2, 0.0);
    if (by_weights != nullptr) std::fill_n(by_weights, count, 0.0);
    for (int i = 0; i < width_; ++i) {
      const double by_sum = slope * weights[first + i] * (1 - hidden[i] * hidden[i]);
      for (int j = 0; j < inputs_; ++j) {
        const int weight = i * (inputs_ + 1) + j;
        if (by_speeds != nullptr) by_speeds[j] += by_sum * weights[weight] / speed_;
        if (by_weights != nullptr) by_weights[weight] = by_sum * speeds[j] / speed_;
      }
      if (by_weights == nullptr) continue;
      by_weights[i * (inputs_ + 1) + inputs_] = by_sum;
      by_weights[first + i] = slope * hidden[i];
    }
    if (by_weights != nullptr) by_weights[first + width_] = slope;
  }

  const int width_, inputs_;
  const double speed_;
};

// Makes a network whose output weights are zero, so that its first outputs are the given constants. The biases of the
// hidden units differ, because units with equal parameters would have equal gradients and stay equal.
ImpactLaw MakeNetwork(const char* name, int width, int inputs, double speed, const std::vector<double>& outputs) {
  const int num_outputs = static_cast<int>(outputs.size());
  ImpactLaw law;
  law.name = name;
  law.spread = kSpread;
  law.function = std::make_shared<Network>(width, inputs, num_outputs, speed);
  for (int i = 0; i < width; ++i) {
    const double bend = (i + 0.5) / width;
    for (int j = 0; j < inputs; ++j) law.parameters.push_back(j == i % inputs || inputs == 1 ? 2.0 : 0.5);
    law.parameters.push_back(-2 * bend);
  }
  law.learned_last = static_cast<int>(law.parameters.size());
  for (const double output : outputs) {
    law.parameters.insert(law.parameters.end(), width, 0.0);
    law.parameters.push_back(output);
  }
  return law;
}

}  // namespace

bool ImpactLaw::HasFriction() const { return function->num_residuals() == 2; }

std::string Validate(const ImpactLaw& law) {
  const auto wrong = [&](const std::string& what) { return law.name + ": " + what; };
  if (law.function == nullptr) return wrong("found no function");
  const std::vector<int>& blocks = law.function->parameter_block_sizes();
  if (blocks.size() != 2 || blocks[0] != 2 || blocks[1] != static_cast<int>(law.parameters.size())) {
    return wrong("found a function of other parameter blocks, expected 2 speeds and " +
                 std::to_string(law.parameters.size()) + " parameters");
  }
  const int outputs = law.function->num_residuals();
  if (outputs != 1 && outputs != 2) {
    return wrong("found " + std::to_string(outputs) + " residuals, expected the restitution and maybe the friction");
  }
  if (!(law.spread > 0)) return wrong("expected a spread above zero");
  if (law.learned_last < 0 || law.learned_last > blocks[1]) return wrong("found learned_last beyond the parameters");
  if (!std::isfinite(EvaluateLaw(law, 0, 0).restitution)) {
    return wrong("found no restitution in [0, 1] and friction >= 0 at the speeds 0");
  }
  return "";
}

ImpactLawValues EvaluateLaw(const ImpactLaw& law, double speed, double sliding) {
  const double speeds[2] = {speed, sliding};
  const double* blocks[2] = {speeds, law.parameters.data()};
  const std::size_t count = law.parameters.size(), outputs = static_cast<std::size_t>(law.function->num_residuals());
  std::vector<double> value(outputs), slopes(outputs * count);
  double* jacobians[2] = {nullptr, slopes.data()};
  ImpactLawValues at;
  at.restitution = std::numeric_limits<double>::quiet_NaN();
  if (!law.function->Evaluate(blocks, value.data(), jacobians)) return at;
  if (!(value[0] >= 0 && value[0] <= 1) || (outputs == 2 && !(value[1] >= 0))) return at;
  at.restitution = value[0];
  at.restitution_slope.assign(slopes.begin(), slopes.begin() + static_cast<std::ptrdiff_t>(count));
  if (outputs == 1) return at;
  at.friction = value[1];
  at.friction_slope.assign(slopes.begin() + static_cast<std::ptrdiff_t>(count), slopes.end());
  return at;
}

ImpactLaw RestitutionNetwork(int width, double speed, double restitution) {
  return MakeNetwork("restitution network", width, 1, speed, {std::log(restitution / (1 - restitution))});
}

ImpactLaw ImpulseNetwork(int width, double speed, double restitution, double friction) {
  return MakeNetwork(
      "impulse network", width, 2, speed, {std::log(restitution / (1 - restitution)), std::log(friction)});
}

}  // namespace saltus
