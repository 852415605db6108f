#include "saltus/control/user_term.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <limits>
#include <numeric>

#include "control/user_term_cost.h"

namespace saltus {
namespace {

std::vector<int> BlocksOf(const UserTerm& term) {
  std::vector<int> sizes(term.states.size(), 4);
  sizes.insert(sizes.end(), term.forces.size() + term.rotations.size(), 2);
  sizes.insert(sizes.end(), term.torques.size(), 1);
  if (term.with_length) sizes.push_back(1);
  return sizes;
}

std::string ListOf(const std::vector<int>& sizes) {
  std::string text;
  for (const int size : sizes) text += (text.empty() ? "" : ", ") + std::to_string(size);
  return "[" + text + "]";
}

}  // namespace

std::string Validate(const UserTerm& term, const Scene& scene) {
  const auto wrong = [&](const std::string& what) { return term.name + ": " + what; };
  if (term.function == nullptr) return wrong("found no function");
  if (!(term.scale > 0) || !std::isfinite(term.scale)) return wrong("expected a scale above zero");
  for (const int body : term.states) {
    if (body < 0 || body >= scene.num_bodies()) {
      return wrong("found the state of disc " + std::to_string(body) + ", expected 0 to " +
                   std::to_string(scene.num_bodies() - 1));
    }
  }
  for (const int body : term.states) {
    if (scene.bodies[body].fixed) return wrong("found the state of " + scene.bodies[body].name + ", which is fixed");
  }
  const auto other = [&](const std::vector<int>& found,
                         const std::vector<int>& known,
                         const std::string& what,
                         const std::string& expected) {
    for (const int body : found) {
      if (std::ranges::count(known, body) > 0) continue;
      return wrong("found the " + what + " disc " + std::to_string(body) + ", expected a disc that " + expected);
    }
    return std::string();
  };
  const bool end = term.at == UserTerm::Timing::kEnd;
  std::vector<int> spinning;
  for (int body = 0; body < scene.num_bodies(); ++body) {
    if (scene.bodies[body].Spins()) spinning.push_back(body);
  }
  for (const std::string& found :
       {other(term.forces, scene.control.bodies, "force on", "is controlled"),
        other(term.torques, scene.control.torque_bodies, "torque on", "has a torque control"),
        end ? other(term.rotations, spinning, "rotation of", "spins")
            : other(term.rotations, scene.control.torque_bodies, "rotation in each step of", "has a torque control")}) {
    if (!found.empty()) return found;
  }
  if (end && !term.forces.empty()) return wrong("found a force at the final time, expected forces of steps");
  if (end && !term.torques.empty()) return wrong("found a torque at the final time, expected torques of steps");
  const std::vector<int> found(term.function->parameter_block_sizes().begin(),
                               term.function->parameter_block_sizes().end());
  if (found != BlocksOf(term)) {
    return wrong("found a function of parameter blocks of sizes " + ListOf(found) + ", expected " +
                 ListOf(BlocksOf(term)));
  }
  if (term.function->num_residuals() < 1) return wrong("found a function without residuals");
  return "";
}

UserTermCost::UserTermCost(const UserTerm& term, const Scene& scene)
    : term_(term), units_(scene.units), to_si_(scene.units, {}) {
  *mutable_parameter_block_sizes() = BlocksOf(term);
  set_num_residuals(term.function->num_residuals());
  row_factor_ = term.role == UserTerm::Role::kCost ? std::sqrt(UnitFactors({}, scene.units).loss) : 1 / term.scale;
  const auto add = [&](size_t count, const std::vector<double>& factors) {
    to_si_of_.insert(to_si_of_.end(), count, factors);
  };
  add(term.states.size(), {to_si_.length, to_si_.length, to_si_.speed, to_si_.speed});
  add(term.forces.size(), {to_si_.force, to_si_.force});
  for (const int body : term.rotations) {
    const double radius = scene.bodies[body].radius;
    add(1, {1 / radius, to_si_.rate / radius});
  }
  for (const int body : term.torques) add(1, {to_si_.force * to_si_.length * scene.bodies[body].radius});
}

bool UserTermCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  // The blocks of the user's function, in SI units.
  std::vector<std::vector<double>> blocks;
  std::size_t at = 0;
  for (; at < to_si_of_.size(); ++at) {
    std::vector<double>& block = blocks.emplace_back();
    for (std::size_t j = 0; j < to_si_of_[at].size(); ++j) block.push_back(to_si_of_[at][j] * parameters[at][j]);
    if (at >= term_.states.size()) continue;
    const Vec2d p = ConvertPosition({parameters[at][0], parameters[at][1]}, units_, {});
    std::copy_n(p.data(), 2, block.begin());
  }
  if (term_.with_length) blocks.push_back({to_si_.time * parameters[at][0]});
  std::vector<const double*> values;
  for (const std::vector<double>& block : blocks) values.push_back(block.data());

  const int rows = num_residuals();
  std::vector<std::vector<double>> derivatives;
  std::vector<double*> wanted;
  if (jacobians != nullptr) {
    for (const std::vector<double>& block : blocks) {
      wanted.push_back(derivatives.emplace_back(rows * block.size()).data());
    }
  }
  if (!term_.function->Evaluate(values.data(), residuals, jacobians == nullptr ? nullptr : wanted.data())) return false;
  for (int r = 0; r < rows; ++r) residuals[r] *= row_factor_;
  if (jacobians == nullptr) return true;

  for (std::size_t k = 0; k < blocks.size(); ++k) {
    if (jacobians[k] == nullptr) continue;
    const int columns = static_cast<int>(blocks[k].size());
    for (int i = 0; i < rows * columns; ++i) {
      const double to_si = k < to_si_of_.size() ? to_si_of_[k][i % columns] : to_si_.time;
      jacobians[k][i] = row_factor_ * to_si * derivatives[k][i];
    }
  }
  return true;
}

UserTermValues EvaluateUserTerms(const std::vector<UserTerm>& terms, const Scene& scene, const Flight& flight,
                                 std::span<const double> control, std::span<const double> durations) {
  UserTermValues sum;
  for (const UserTerm& term : terms) {
    const UserTermCost cost(term, scene);
    std::vector<double> residuals(cost.num_residuals());
    const auto add = [&](const DiscStates& x, const double* row, double length) {
      std::deque<std::array<double, 4>> numbers;  // of states and rotations; a deque does not move its entries
      std::vector<const double*> blocks;
      for (const int body : term.states) {
        numbers.push_back({x.p[body][0], x.p[body][1], x.v[body][0], x.v[body][1]});
        blocks.push_back(numbers.back().data());
      }
      const auto place_in = [](const std::vector<int>& all, int body) {
        return std::find(all.begin(), all.end(), body) - all.begin();
      };
      for (const int body : term.forces) blocks.push_back(row + 2 * place_in(scene.control.bodies, body));
      for (const int body : term.rotations) {
        const double radius = scene.bodies[body].radius;
        numbers.push_back({radius * x.angle[body], radius * x.spin[body]});
        blocks.push_back(numbers.back().data());
      }
      for (const int body : term.torques) {
        blocks.push_back(row + 2 * scene.num_controlled() + place_in(scene.control.torque_bodies, body));
      }
      if (term.with_length) blocks.push_back(&length);
      if (!cost.Evaluate(blocks.data(), residuals.data(), nullptr)) {
        sum.cost = sum.violation = std::numeric_limits<double>::infinity();
        return;
      }
      for (const double r : residuals) {
        if (term.role == UserTerm::Role::kCost) {
          sum.cost += r * r;
          continue;
        }
        const double violation = term.role == UserTerm::Role::kEquality ? std::abs(r) : r;
        if (violation > sum.violation) sum = {sum.cost, violation, term.name};
      }
    };
    if (term.at == UserTerm::Timing::kEnd) {
      add(flight.end(), nullptr, std::accumulate(durations.begin(), durations.end(), 0.0));
      continue;
    }
    int interval = -1;
    for (const Flight::Piece& piece : flight.pieces()) {
      if (piece.interval == interval) continue;  // cut by an impact within the step
      interval = piece.interval;
      add(piece.at_start, control.data() + scene.ForceIndex(interval, 0), durations[interval]);
    }
  }
  return sum;
}

}  // namespace saltus
