#include "control/path_costs.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "control/phase_costs.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/control/objective.h"
#include "saltus/simulate/events.h"
#include "simulate/costate_sweep.h"

namespace saltus {
namespace {

using Quantity = TerminalTerm::Quantity;

int OffsetOf(Quantity quantity) { return quantity == Quantity::kPosition ? 0 : 2; }

// A row of the least squares: scale (q_axis(t) - target).
struct Row {
  int segment = 0;
  double offset = 0;  // s, after the start of the segment
  int body = 0;
  Quantity quantity = Quantity::kPosition;
  int axis = 0;
  double scale = 1;
  double value = 0;        // of the row
  double by_duration = 0;  // of the target and of the scale, by the final time
  bool scales = true;      // the time of the row scales with the final time
};

class ExactPathCosts final : public PathCosts {
 public:
  explicit ExactPathCosts(const Simulator& simulator) : num_steps_(simulator.num_steps()) {
    const Objective& objective = simulator.scene().objective;
    num_residuals_ = NumTerminalResiduals(objective) + 2 * static_cast<int>(objective.via.size()) +
                     kRowsOfStep * num_steps_ * static_cast<int>(objective.running.size());
  }

  std::string Update(const Simulator& simulator, std::span<const double> initial,
                     std::span<const double> control) override {
    scene_ = simulator.scene();
    if (const std::string beyond = NonBallisticFeatures(scene_); !beyond.empty()) {
      return "the scene has " + beyond + "; running and waypoint costs are integrated between impacts on planes";
    }
    ExactRun run;
    run.ok = true;
    for (const StepTouch& at : EventTouches(simulator)) {
      if (at.touch.kind != ContactKind::kImpact) {
        return "discs rest on or graze each other or a plane; running and waypoint costs, and derivatives by a free "
               "duration, are those of motions with impacts only: start from a guess without such contacts";
      }
      run.contacts.push_back(at.touch.candidate);
      run.places.push_back({at.step, at.touch.time});
    }
    const std::vector<double> lengths(num_steps_, simulator.step());
    sweep_.reset();
    flight_.emplace(scene_, initial, control, lengths, run);
    sweep_.emplace(scene_, *flight_);
    return "";
  }

  double Loss() const override { return RunningLoss(scene_, *flight_); }

  void Gradient(std::span<double> control, std::span<double> initial, double* duration) const override {
    const CostateSweep::Result found = sweep_->Sweep(
        {}, [&](int k, const ImpactJump& jump, double gain) { return sweep_->LateMultiplier(k, jump, gain); });
    std::fill(control.begin(), control.end(), 0.0);
    for (size_t i = 0; i < sweep_->segments().size() && !control.empty(); ++i) {
      sweep_->AddByControl(sweep_->segments()[i].interval, found.push[i], found.turn[i], control);
    }
    Put(found.start, initial);
    if (duration != nullptr) *duration = found.by_duration;
  }

  int num_residuals() const override { return num_residuals_; }

  void Residuals(std::span<double> residuals) const override {
    size_t at = 0;
    ForEachRow([&](const Row& row) { residuals[at++] = row.value; },
               [&](const RunningTerm&, int, int, double integral) {
                 residuals[at++] = std::sqrt(integral);
                 for (int i = 1; i < kRowsOfStep; ++i) residuals[at++] = 0;
               });
  }

  void Jacobian(std::span<double> control, std::span<double> initial, std::span<double> duration) const override {
    std::fill(control.begin(), control.end(), 0.0);
    std::fill(initial.begin(), initial.end(), 0.0);
    const size_t width = control.size() / num_residuals_;
    std::vector<double> ignored(static_cast<size_t>(num_steps_) * scene_.control_width());
    size_t at = 0;
    const auto forces = [&] { return width > 0 ? control.subspan(at * width, width) : std::span<double>(ignored); };
    const auto put = [&](const CostateSweep::Derivatives& of, double by_duration) {
      if (!initial.empty()) Put(of.start, initial.subspan(at * 4 * scene_.bodies.size(), 4 * scene_.bodies.size()));
      if (!duration.empty()) duration[at] = of.by_duration + by_duration;
    };
    ForEachRow(
        [&](const Row& row) {
          const bool of_position = row.quantity == Quantity::kPosition;
          const CostateSweep::Derivatives of =
              sweep_->DerivativesOfPoint(row.segment, row.offset, row.body, of_position, row.axis, row.scale, forces());
          double by_duration = row.by_duration;
          if (!row.scales) {  // its time does not move: less what it would have gained
            const Flight::Piece& piece = sweep_->segments()[row.segment];
            const Vec2d v = piece.at_start.v[row.body] + row.offset * piece.acceleration[row.body];
            const Vec2d rate = of_position ? v : piece.acceleration[row.body];
            by_duration -= row.scale * rate[row.axis] * (piece.start + row.offset) / scene_.duration;
          }
          put(of, by_duration);
          ++at;
        },
        [&](const RunningTerm& term, int first, int end, double integral) {
          const double scale = integral > 0 ? 0.5 / std::sqrt(integral) : 0.0;
          put(sweep_->DerivativesOfIntegral(term, first, end, scale, forces()), 0);
          at += kRowsOfStep;
        });
  }

 private:
  static constexpr int kRowsOfStep = 2 * static_cast<int>(kGaussNodes.size());

  static void Put(const std::vector<Costate<double>>& costates, std::span<double> initial) {
    for (size_t i = 0; i < initial.size() / 4; ++i) {
      const Costate<double>& costate = costates[i];
      const double numbers[] = {costate.position[0], costate.position[1], costate.velocity[0], costate.velocity[1]};
      std::copy_n(numbers, 4, &initial[4 * i]);
    }
  }

  Vec2d QuantityAt(int segment, double offset, int body, Quantity quantity) const {
    const Flight::Piece& piece = sweep_->segments()[segment];
    const Vec2d v = piece.at_start.v[body] + offset * piece.acceleration[body];
    if (quantity == Quantity::kVelocity) return v;
    return piece.at_start.p[body] + 0.5 * offset * (piece.at_start.v[body] + v);
  }

  // Calls on_row for terminal and via terms, and for the Gauss nodes of each step without an impact, in their order;
  // a step with an impact is one row, the root of its integral.
  template <typename OnRow, typename OnCutStep>
  void ForEachRow(const OnRow& on_row, const OnCutStep& on_cut_step) const {
    const int last = static_cast<int>(sweep_->segments().size()) - 1;
    const auto both_axes = [&](Row row, const Vec2d& miss, const Vec2d& target_rate, const auto& take) {
      for (row.axis = 0; row.axis < 2; ++row.axis) {
        Row one = row;
        one.value = row.scale * miss[row.axis];
        // The scale of a row of a running term is the root of the length of a step.
        one.by_duration = row.by_duration * one.value - row.scale * target_rate[row.axis];
        take(one);
      }
    };
    for (const TerminalTerm& term : scene_.objective.terminal) {
      const Vec2d& q = term.quantity == Quantity::kPosition ? flight_->end().p[term.body] : flight_->end().v[term.body];
      const Row row{.segment = last,
                    .offset = sweep_->segments()[last].duration,
                    .body = term.body,
                    .quantity = term.quantity,
                    .scale = std::sqrt(term.weight)};
      both_axes(row, q - term.target, Vec2d(0, 0), on_row);
    }
    for (size_t i = 0; i < scene_.objective.via.size(); ++i) {
      const ViaTerm& term = scene_.objective.via[i];
      Row row{.segment = sweep_->SegmentAfterVia(static_cast<int>(i)) - 1,
              .body = term.body,
              .quantity = term.quantity,
              .scale = std::sqrt(term.weight),
              .scales = false};
      row.offset = sweep_->segments()[row.segment].duration;
      both_axes(row, QuantityAt(row.segment, row.offset, term.body, term.quantity) - term.target, Vec2d(0, 0), on_row);
    }
    for (const RunningTerm& term : scene_.objective.running) {
      for (int first = 0, step = 0; step < num_steps_; ++step) {
        int end = first;
        while (end <= last && sweep_->segments()[end].interval == step) ++end;
        std::vector<Row> rows;
        double integral = 0;
        for (int i = first; i < end; ++i) {
          const Flight::Piece& piece = sweep_->segments()[i];
          for (size_t g = 0; g < kGaussNodes.size(); ++g) {
            const double s = kGaussNodes[g] * piece.duration, t = piece.start + s;
            Row row{.segment = i,
                    .offset = s,
                    .body = term.body,
                    .quantity = term.quantity,
                    .scale = std::sqrt(term.weight * kGaussWeights[g] * piece.duration)};
            row.by_duration = 0.5 / scene_.duration;
            const double step_of_time = 1e-3 * piece.duration;
            const Vec2d rate =
                (TargetAt(term, t + step_of_time) - TargetAt(term, t - step_of_time)) / (2 * step_of_time);
            both_axes(row,
                      QuantityAt(i, s, term.body, term.quantity) - TargetAt(term, t),
                      rate * (t / scene_.duration),
                      [&](const Row& one) {
                        rows.push_back(one);
                        integral += one.value * one.value;
                      });
          }
        }
        if (end - first == 1) {
          for (const Row& row : rows) on_row(row);
        } else {
          on_cut_step(term, first, end, integral);
        }
        first = end;
      }
    }
  }

  int num_steps_ = 0, num_residuals_ = 0;
  Scene scene_;
  std::optional<Flight> flight_;
  std::optional<CostateSweep> sweep_;
};

// Path costs on the states after the model's steps.
class SteppedPathCosts final : public PathCosts {
 public:
  explicit SteppedPathCosts(const Simulator& simulator) : scene_(simulator.scene()), num_steps_(simulator.num_steps()) {
    const double h = simulator.step();
    for (const TerminalTerm& term : scene_.objective.terminal) {
      AddRows(num_steps_, 0, term, term.target, std::sqrt(term.weight));
    }
    num_terminal_ = static_cast<int>(rows_.size());
    for (const ViaTerm& term : scene_.objective.via) {
      const int before = std::min(static_cast<int>(term.time / h), num_steps_ - 1);
      AddRows(before, term.time / h - before, term, term.target, std::sqrt(term.weight));
    }
    for (const RunningTerm& term : scene_.objective.running) {
      for (int k = 0; k <= num_steps_; ++k) {
        const double part = k == 0 || k == num_steps_ ? 0.5 * h : h;
        AddRows(k, 0, term, TargetAt(term, k * h), std::sqrt(term.weight * part));
      }
    }
  }

  std::string Update(const Simulator& simulator, std::span<const double>, std::span<const double> control) override {
    simulator_ = &simulator;
    control_.assign(control.begin(), control.end());
    const size_t size = simulator.state_size();
    states_.resize((num_steps_ + 1) * size);
    for (int k = 0; k <= num_steps_; ++k) simulator.GetState(k, std::span(states_).subspan(k * size, size));
    return "";
  }

  double Loss() const override {
    double loss = 0;
    for (size_t i = num_terminal_; i < rows_.size(); ++i) loss += Value(rows_[i]) * Value(rows_[i]);
    return loss;
  }

  void Gradient(std::span<double> control, std::span<double> initial, double*) const override {
    std::vector<double> cotangents(states_.size());
    TerminalGradient(scene_.objective,
                     State(num_steps_),
                     simulator_->body_size(),
                     std::span(cotangents).last(simulator_->state_size()));
    for (size_t i = num_terminal_; i < rows_.size(); ++i) AddDerivative(rows_[i], 2 * Value(rows_[i]), cotangents);
    PullBack(Linearized(), cotangents, num_steps_, control, initial);
  }

  int num_residuals() const override { return static_cast<int>(rows_.size()); }
  void Residuals(std::span<double> residuals) const override {
    for (size_t i = 0; i < rows_.size(); ++i) residuals[i] = Value(rows_[i]);
  }
  void Jacobian(std::span<double> control, std::span<double> initial, std::span<double>) const override {
    const std::vector<StepLinearization> steps = Linearized();
    const size_t width = control.size() / rows_.size(), size = initial.size() / rows_.size();
    std::vector<double> cotangents(states_.size());
    for (size_t i = 0; i < rows_.size(); ++i) {
      std::fill(cotangents.begin(), cotangents.end(), 0.0);
      AddDerivative(rows_[i], 1, cotangents);
      const int last = std::min(num_steps_, rows_[i].step + (rows_[i].part > 0));
      PullBack(steps, cotangents, last, control.subspan(i * width, width), initial.subspan(i * size, size));
    }
  }

 private:
  // The row scale (q - target) with q an entry of a disc's state, interpolated between two states.
  struct NodeRow {
    int body = 0, entry = 0;
    int step = 0;
    double part = 0;  // of the next state
    double target = 0, scale = 0;
  };

  template <typename Term>
  void AddRows(int step, double part, const Term& term, const Vec2d& target, double scale) {
    for (int d = 0; d < 2; ++d) {
      rows_.push_back({term.body, OffsetOf(term.quantity) + d, step, part, target[d], scale});
    }
  }

  int IndexOf(const NodeRow& row) const { return row.body * simulator_->body_size() + row.entry; }

  std::span<const double> State(int k) const {
    return std::span(states_).subspan(static_cast<size_t>(k) * simulator_->state_size(), simulator_->state_size());
  }
  double Value(const NodeRow& row) const {
    const int i = IndexOf(row);
    double q = State(row.step)[i];
    if (row.part > 0) q += row.part * (State(row.step + 1)[i] - q);
    return row.scale * (q - row.target);
  }
  void AddDerivative(const NodeRow& row, double weight, std::span<double> cotangents) const {
    const int i = IndexOf(row);
    const size_t size = simulator_->state_size();
    cotangents[row.step * size + i] += weight * row.scale * (1 - row.part);
    if (row.part > 0) cotangents[(row.step + 1) * size + i] += weight * row.scale * row.part;
  }

  std::vector<StepLinearization> Linearized() const {
    std::vector<StepLinearization> steps(num_steps_);
    std::vector<double> force(simulator_->force_size());
    for (int k = 0; k < num_steps_; ++k) {
      simulator_->ExpandForce(control_, k, force);
      simulator_->Linearize(State(k), force, /*with_parameters=*/false, &steps[k]);
    }
    return steps;
  }

  // Pulls the derivatives by each state up to number `last` back to those by control and initial state.
  void PullBack(const std::vector<StepLinearization>& steps, const std::vector<double>& cotangents, int last,
                std::span<double> control, std::span<double> initial) const {
    const size_t size = simulator_->state_size();
    std::vector<double> lambda(cotangents.begin() + last * size, cotangents.begin() + (last + 1) * size);
    std::vector<double> before(size), force(simulator_->force_size());
    std::fill(control.begin(), control.end(), 0.0);
    for (int k = last; k-- > 0;) {
      steps[k].ApplyTranspose(lambda, before, force);
      if (!control.empty()) {
        simulator_->SelectControl(force, control.subspan(scene_.ForceIndex(k, 0), scene_.control_width()));
      }
      for (size_t i = 0; i < size; ++i) lambda[i] = before[i] + cotangents[k * size + i];
    }
    for (size_t i = 0; i < initial.size(); ++i) {
      initial[i] = scene_.bodies[i / 4].fixed ? 0.0 : lambda[i / 4 * simulator_->body_size() + i % 4];
    }
  }

  Scene scene_;
  int num_steps_ = 0;
  const Simulator* simulator_ = nullptr;
  std::vector<NodeRow> rows_;
  int num_terminal_ = 0;
  std::vector<double> states_, control_;
};

}  // namespace

std::unique_ptr<PathCosts> PathCosts::Make(const Simulator& simulator) {
  const Objective& objective = simulator.scene().objective;
  if (objective.running.empty() && objective.via.empty() && !objective.duration) return nullptr;
  if (simulator.traits().event_driven && simulator.precision() == Precision::kDouble) {
    return std::make_unique<ExactPathCosts>(simulator);
  }
  return std::make_unique<SteppedPathCosts>(simulator);
}

}  // namespace saltus
