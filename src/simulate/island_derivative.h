// The one place where contact models meet Jets: derivatives of the step of one island.
//
// The model's own step is run with Jets, kJetWidth directions a pass: first position, velocity and force of each disc
// in turn, then what else there is. Discs that touch nothing but each other are moved on alike by a common shift of
// their positions, velocities or accelerations, as in free flight; that saves the pass of the last one.
//
// The transposed Jacobian of many discs needs no pass for each: models that state from how many discs on (kTapedFrom)
// are run once, on a tape (taped.h).
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "base/same_bits.h"
#include "saltus/internal/contact_step.h"
#include "saltus/internal/taped.h"
#include "simulate/free_flight.h"

namespace saltus {

template <typename S, int kRotation>
class IslandDerivative {
 public:
  using Model = ContactStep<S, kRotation>;
  static constexpr int kSize = 4 + kRotation;
  using State = BodyState<S, kRotation>;
  using Matrix = Eigen::Matrix<S, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

  // Columns of the Jacobian for n discs: their states, the forces on them, the torques on them if there are any (where
  // discs spin as the scene says) and, if asked for, restitution, friction, stiffness, damping, their masses, if they
  // spin so, their inverse moments of inertia, and the restitution and friction of each further pair of materials of
  // `num_pairs`. Rows: their next states.
  static int NumColumns(int n, bool with_torques) { return n * (kSize + 2 + with_torques); }
  static int NumColumns(int n, bool with_torques, bool with_parameters, std::size_t num_pairs) {
    if (!with_parameters) return NumColumns(n, with_torques);
    return NumColumns(n, with_torques) + FirstOfPairs(n) + (num_pairs > 1 ? 2 * static_cast<int>(num_pairs - 1) : 0);
  }
  // Where those of further pairs begin among the parameters.
  static int FirstOfPairs(int n) { return 4 + (kRotation == kSpin ? 2 : 1) * n; }

  // Computes before = J^T after. `in` and `x` have the discs of the island only, as the model's step takes them.
  void ApplyTranspose(const Model& model, const StepInput<S>& in, std::span<const State> x,
                      const FreeFlightJacobian<S>& free, bool with_parameters, std::span<const S> after,
                      std::span<S> before) {
    const int n = static_cast<int>(x.size());
    int first = 0;
    if constexpr (std::is_same_v<S, double>) {
      if (n >= model.properties().taped_from) return PullBackOnTape(model, in, x, after, before);
    }
    if (model.properties().published_jacobian) {
      first = NumColumns(n, HasTorques(in));
      PullBackAsPublished(model, in, x, after, before.first(NumColumns(n, false)));
      if constexpr (kRotation == kSpin) {
        for (int i = 0; HasTorques(in) && i < n; ++i) {
          before[n * (kSize + 2) + i] = TorqueAsSpin(in, i) * before[i * kSize + 5];
        }
      }
    }
    const bool shares_motion = first == 0 && OnlyRelativeMotionMatters(model, in);
    ForEachPass(model, in, x, with_parameters, first, shares_motion ? n - 1 : -1, [&](const auto& columns) {
      Eigen::Matrix<S, kJetWidth, 1> sum = Eigen::Matrix<S, kJetWidth, 1>::Zero();
      const auto* next = reinterpret_cast<const StepJet<S>*>(next_.data());
      for (int row = 0; row < n * kSize; ++row) sum += after[row] * next[row].v;
      for (int i = 0; i < columns.count; ++i) before[columns.index[i]] = sum[i];
    });
    if (shares_motion) CompleteByCommonMotion(in, free, after, before);
  }

  // Computes the Jacobian J.
  void Evaluate(const Model& model, const StepInput<S>& in, std::span<const State> x, bool with_parameters,
                Matrix* jacobian) {
    const int n = static_cast<int>(x.size());
    jacobian->setZero(n * kSize, NumColumns(n, HasTorques(in), with_parameters, in.pairs.size()));
    int first = 0;
    if (model.properties().published_jacobian) {
      EvaluateAsPublished(model, in, x, jacobian);
      first = NumColumns(n, HasTorques(in));
    }
    ForEachPass(model, in, x, with_parameters, first, -1, [&](const auto& columns) {
      const auto* next = reinterpret_cast<const StepJet<S>*>(next_.data());
      for (int row = 0; row < n * kSize; ++row) {
        for (int i = 0; i < columns.count; ++i) (*jacobian)(row, columns.index[i]) = next[row].v[i];
      }
    });
  }

 private:
  using Jet = StepJet<S>;
  using JetState = BodyState<Jet, kRotation>;
  using Vector = Eigen::Matrix<S, Eigen::Dynamic, 1>;

  // The columns of the Jacobian that one pass computes.
  struct Columns {
    int count = 0;
    int index[kJetWidth];
    Jet* variable[kJetWidth];  // what each differentiates by
    void Add(int column, Jet* by) {
      index[count] = column;
      variable[count++] = by;
    }
  };

  static bool HasTorques(const StepInput<S>& in) { return !in.torque.empty(); }
  // Returns the angular velocity that is equivalent to a unit torque. Models with the Jacobian of their source add the
  // impulses of forces and torques to the velocities first.
  static S TorqueAsSpin(const StepInput<S>& in, int i) { return in.h * in.bodies[i].inverse_inertia; }

  // Whether a common motion of all discs of the island has no influence on contacts. Not used in single precision,
  // whose derivatives are those of the published programs to the last digits.
  static bool OnlyRelativeMotionMatters(const Model& model, const StepInput<S>& in) {
    if (!model.traits().relative || std::is_same_v<S, float> || in.bodies.size() < 2) return false;
    for (const BodyConstants<S>& body : in.bodies) {
      if (body.fixed) return false;
    }
    for (const Candidate& c : in.candidates) {
      if (c.plane) return false;
    }
    return true;
  }

  // Sets the columns of the last disc from those of the others.
  static void CompleteByCommonMotion(const StepInput<S>& in, const FreeFlightJacobian<S>& free,
                                     std::span<const S> after, std::span<S> before) {
    const int n = static_cast<int>(in.bodies.size());
    const int last = n - 1;
    for (int j = 0; j < 2; ++j) {
      S p = S(0), v = S(0), a = S(0);
      for (int i = 0; i < n; ++i) {
        const S after_p = after[i * kSize + j], after_v = after[i * kSize + 2 + j];
        p += free.pp * after_p + free.vp * after_v;
        v += free.pv * after_p + free.vv * after_v;
        a += free.pa * after_p + free.va * after_v;
        if (i == last) break;
        p -= before[i * kSize + j];
        v -= before[i * kSize + 2 + j];
        a -= in.bodies[i].mass * before[n * kSize + 2 * i + j];
      }
      before[last * kSize + j] = p;
      before[last * kSize + 2 + j] = v;
      before[n * kSize + 2 * last + j] = in.bodies[last].inverse_mass * a;
    }
  }

  // Runs the step once for every kJetWidth columns from `first` on, leaving it in next_, and calls use(columns). The
  // position, velocity and force of disc `without` are left out.
  template <typename Use>
  void ForEachPass(const Model& model, const StepInput<S>& in, std::span<const State> x, bool with_parameters,
                   int first, int without, const Use& use) {
    const int n = static_cast<int>(x.size());
    SetValues(in, x);
    if (first == 0) {
      for (int i = 0; i < n; ++i) {
        if (i == without) continue;
        Columns columns;
        for (int j = 0; j < 4; ++j) columns.Add(i * kSize + j, StateVariable(i * kSize + j));
        for (int j = 0; j < 2; ++j) columns.Add(n * kSize + 2 * i + j, &force_[i][j]);
        RunPass(model, in, columns, use);
      }
    }
    Columns columns;
    const auto add = [&](int column) {
      columns.Add(column, Variable(column));
      if (columns.count < kJetWidth) return;
      RunPass(model, in, columns, use);
      columns.count = 0;
    };
    if (first == 0) {
      for (int i = 0; i < n; ++i) {
        for (int j = 4; j < kSize; ++j) add(i * kSize + j);
      }
    }
    const int more = first == 0 ? n * (kSize + 2) : first;
    const int end = NumColumns(n, HasTorques(in), with_parameters, in.pairs.size());
    for (int column = more; column < end; ++column) add(column);
    if (columns.count > 0) RunPass(model, in, columns, use);
  }

  template <typename Use>
  void RunPass(const Model& model, const StepInput<S>& in, const Columns& columns, const Use& use) {
    Seed(in, columns, S(1));
    if (in.solved != nullptr) in.solved->Rewind();
    model.Step(jets_, x_, next_);
    Seed(in, columns, S(0));
    use(columns);
  }

  // Sets the values of the Jets; their derivatives are zero between passes.
  void SetValues(const StepInput<S>& in, std::span<const State> x) {
    const size_t n = x.size();
    x_.resize(n);
    next_.resize(n);
    force_.resize(n);
    bodies_.resize(n);
    for (size_t i = 0; i < n; ++i) {
      const S* values = reinterpret_cast<const S*>(&x[i]);
      for (int j = 0; j < kSize; ++j) StateVariable(static_cast<int>(i) * kSize + j)->a = values[j];
      for (int j = 0; j < 2; ++j) force_[i][j].a = in.force[i][j];
      const BodyConstants<S>& body = in.bodies[i];
      bodies_[i].mass.a = body.mass;
      bodies_[i].inverse_mass.a = body.inverse_mass;
      bodies_[i].radius = body.radius;
      bodies_[i].fixed = body.fixed;
      bodies_[i].material = body.material;
      bodies_[i].inverse_inertia.a = body.inverse_inertia;
    }
    torque_.clear();
    for (const S torque : in.torque) torque_.emplace_back(torque);
    jets_.ShareScene(in);
    jets_.torque = torque_;
    jets_.contact.restitution.a = in.contact.restitution;
    jets_.contact.friction.a = in.contact.friction;
    jets_.contact.stiffness.a = in.contact.stiffness;
    jets_.contact.damping.a = in.contact.damping;
    pairs_.resize(in.pairs.size());
    for (std::size_t k = 0; k < pairs_.size(); ++k) {
      pairs_[k].restitution.a = in.pairs[k].restitution;
      pairs_[k].friction.a = in.pairs[k].friction;
    }
    jets_.pairs = pairs_;
    jets_.bodies = bodies_;
    jets_.force = force_;
  }

  // Sets the derivatives of the variables of a pass to `one` in their directions.
  void Seed(const StepInput<S>& in, const Columns& columns, S one) {
    for (int direction = 0; direction < columns.count; ++direction) columns.variable[direction]->v[direction] = one;
    const int first_mass = NumColumns(static_cast<int>(x_.size()), HasTorques(in)) + 4;
    if (columns.count == 0 || columns.index[columns.count - 1] < first_mass) return;
    for (size_t i = 0; i < x_.size(); ++i) {
      if (!in.bodies[i].fixed) bodies_[i].inverse_mass = Divide(S(1), bodies_[i].mass);
    }
  }

  // Return the variable of a column of the Jacobian: the first columns are those of the states.
  Jet* StateVariable(int column) { return reinterpret_cast<Jet*>(x_.data()) + column; }
  Jet* Variable(int column) {
    const int n = static_cast<int>(x_.size());
    if (column < n * kSize) return StateVariable(column);
    column -= n * kSize;
    if (column < 2 * n) return &force_[column / 2][column % 2];
    column -= 2 * n;
    const int torques = static_cast<int>(torque_.size());
    if (column < torques) return &torque_[column];
    column -= torques;
    ContactConstants<Jet>& c = jets_.contact;
    PairConstants<Jet>& pair = pairs_.empty() ? c : pairs_[0];
    Jet* const contact[] = {&pair.restitution, &pair.friction, &c.stiffness, &c.damping};
    if (column < 4) return contact[column];
    if (const int of_pairs = column - FirstOfPairs(n); of_pairs >= 0) {
      PairConstants<Jet>& further = pairs_[1 + of_pairs / 2];
      return of_pairs % 2 == 0 ? &further.restitution : &further.friction;
    }
    column -= 4;
    return column < n ? &bodies_[column].mass : &bodies_[column - n].inverse_inertia;
  }

  // Computes all columns at once: the step on a tape, and one reverse sweep.
  void PullBackOnTape(const Model& model, const StepInput<S>& in, std::span<const State> x, std::span<const S> after,
                      std::span<S> before) {
    const std::size_t n = x.size(), states = n * kSize;
    for (Resting& resting : resting_) {
      if (resting.Matches(in, x)) return Sweep(&resting.tape, resting.to, resting.places, after, before);
    }
    Tape& tape = Tape::ThreadTape();
    tape.Clear();
    std::vector<BodyState<Taped, kRotation>> from(n), to(n);
    std::vector<Vec2<Taped>> force(n);
    std::vector<BodyConstants<Taped>> bodies(n);
    std::vector<int> places;  // of the columns, in their order
    const auto vary = [&](Taped& entry, S value) {
      entry = Taped::Variable(value);
      places.push_back(entry.place());
    };
    for (std::size_t i = 0; i < states; ++i) {
      vary(reinterpret_cast<Taped*>(from.data())[i], reinterpret_cast<const S*>(x.data())[i]);
    }
    for (std::size_t i = 0; i < 2 * n; ++i) vary(force[i / 2][i % 2], in.force[i / 2][i % 2]);
    std::vector<Taped> torque(in.torque.size());
    for (std::size_t i = 0; i < torque.size(); ++i) vary(torque[i], in.torque[i]);
    ContactConstants<Taped> contact;
    std::vector<PairConstants<Taped>> pairs(in.pairs.size());
    PairConstants<Taped>& pair = pairs.empty() ? contact : pairs[0];
    const PairConstants<S>& pair_in = pairs.empty() ? in.contact : in.pairs[0];
    vary(pair.restitution, pair_in.restitution);
    vary(pair.friction, pair_in.friction);
    vary(contact.stiffness, in.contact.stiffness);
    vary(contact.damping, in.contact.damping);
    for (std::size_t i = 0; i < n; ++i) {
      const BodyConstants<S>& body = in.bodies[i];
      vary(bodies[i].mass, body.mass);
      bodies[i].inverse_mass = body.fixed ? Taped(body.inverse_mass) : Divide(S(1), bodies[i].mass);
      bodies[i].radius = body.radius;
      bodies[i].fixed = body.fixed;
      bodies[i].material = body.material;
    }
    for (std::size_t i = 0; kRotation == kSpin && i < n; ++i) {
      vary(bodies[i].inverse_inertia, in.bodies[i].inverse_inertia);
    }
    for (std::size_t k = 1; k < pairs.size(); ++k) {
      vary(pairs[k].restitution, in.pairs[k].restitution);
      vary(pairs[k].friction, in.pairs[k].friction);
    }
    StepInput<Taped> taped{};
    taped.ShareScene(in);
    taped.contact = contact;
    taped.pairs = pairs;
    taped.bodies = bodies;
    taped.force = force;
    taped.torque = torque;
    const std::span<const double> recalled = Resting::NumbersOf(in);
    std::vector<double> solved(recalled.begin(), recalled.end());  // before the step adds to them
    if (in.solved != nullptr) in.solved->Rewind();
    model.Step(taped, from, to);
    const std::span<const Taped> results(reinterpret_cast<const Taped*>(to.data()), states);
    std::vector<int> to_places;
    for (const Taped& result : results) to_places.push_back(result.place());
    Sweep(&tape, to_places, places, after, before);
    const S* start = reinterpret_cast<const S*>(x.data());
    if (std::ranges::equal(results, std::span(start, states), {}, [](const Taped& result) { return result.value(); })) {
      if (resting_.size() < kMostResting) resting_.emplace_back();
      Resting& oldest = resting_[next_resting_++ % kMostResting];
      oldest.Assign(in, x);
      oldest.solved = std::move(solved);
      oldest.to = std::move(to_places);
      oldest.places = std::move(places);
      std::swap(oldest.tape, tape);
    }
    tape.Clear();
  }

  // Computes before = J^T after by the tape of the step, with the tape indices of its results and of its variables.
  static void Sweep(Tape* tape, std::span<const int> to, std::span<const int> places, std::span<const S> after,
                    std::span<S> before) {
    std::vector<std::pair<int, double>> cotangents;
    for (std::size_t i = 0; i < to.size(); ++i) cotangents.emplace_back(to[i], after[i]);
    const std::span<const double> swept = tape->Sweep(cotangents);
    for (std::size_t i = 0; i < before.size(); ++i) before[i] = swept[places[i]];
  }

  // The tape of a step that left an island unchanged: it serves for all steps in which the island rests.
  struct Resting {
    std::vector<State> x;
    std::vector<Vec2<S>> force;
    std::vector<S> torque;
    std::vector<BodyConstants<S>> bodies;
    std::vector<Candidate> candidates;
    std::vector<double> solved;
    std::vector<int> to, places;
    Tape tape;

    void Assign(const StepInput<S>& in, std::span<const State> at) {
      x.assign(at.begin(), at.end());
      force.assign(in.force.begin(), in.force.end());
      torque.assign(in.torque.begin(), in.torque.end());
      bodies.assign(in.bodies.begin(), in.bodies.end());
      candidates.assign(in.candidates.begin(), in.candidates.end());
    }
    bool Matches(const StepInput<S>& in, std::span<const State> at) const {
      return SameBits<State>(x, at) && SameBits<Vec2<S>>(force, in.force) && SameBits<S>(torque, in.torque) &&
             std::ranges::equal(bodies, in.bodies, SameConstants) && std::ranges::equal(candidates, in.candidates) &&
             SameBits<double>(solved, NumbersOf(in));
    }
    static std::span<const double> NumbersOf(const StepInput<S>& in) {
      return in.solved != nullptr ? in.solved->numbers() : std::span<const double>{};
    }
    static bool SameConstants(const BodyConstants<S>& a, const BodyConstants<S>& b) {
      return a.mass == b.mass && a.inverse_mass == b.inverse_mass && a.radius == b.radius && a.fixed == b.fixed &&
             a.material == b.material && a.inverse_inertia == b.inverse_inertia;
    }
  };

  // Computes the cotangents of states and forces with the Jacobian of the model's source, in double precision.
  void PullBackAsPublished(const Model& model, const StepInput<S>& in, std::span<const State> x,
                           std::span<const S> after, std::span<S> before) {
    if constexpr (std::is_same_v<S, double>) {
      if (model.PullBack(in, x, after, before)) return;
      const auto [A, B] = LinearizeAsPublished(model, in, x);
      const Eigen::Map<const Vector> cotangent(after.data(), after.size());
      Eigen::Map<Vector>(before.data(), A.cols()).noalias() = A.transpose() * cotangent;
      Eigen::Map<Vector>(&before[A.cols()], B.cols()).noalias() = B.transpose() * cotangent;
    }
  }
  // Sets the columns of states, forces and torques to those of the model's source.
  void EvaluateAsPublished(const Model& model, const StepInput<S>& in, std::span<const State> x, Matrix* jacobian) {
    if constexpr (std::is_same_v<S, double>) {
      const int n = static_cast<int>(x.size());
      const auto [A, B] = LinearizeAsPublished(model, in, x);
      jacobian->leftCols(A.cols()) = A;
      jacobian->middleCols(A.cols(), B.cols()) = B;
      if constexpr (kRotation == kSpin) {
        for (int i = 0; HasTorques(in) && i < n; ++i) {
          jacobian->col(n * (kSize + 2) + i) = TorqueAsSpin(in, i) * jacobian->col(i * kSize + 5);
        }
      }
    }
  }

  // The columns of states and forces of the model's source; valid until the next call.
  struct Published {
    Eigen::Map<Eigen::MatrixXd> A, B;
  };
  Published LinearizeAsPublished(const Model& model, const StepInput<S>& in, std::span<const State> x) {
    const int n = static_cast<int>(x.size());
    const int rows = n * kSize;
    published_.resize(rows * n * (kSize + 2));
    const Published published{{published_.data(), rows, rows}, {published_.data() + rows * rows, rows, 2 * n}};
    model.Linearize(in, x, published.A, published.B);
    return published;
  }

  std::vector<JetState> x_, next_;
  std::vector<Vec2<Jet>> force_;
  std::vector<BodyConstants<Jet>> bodies_;
  std::vector<PairConstants<Jet>> pairs_;
  std::vector<Jet> torque_;
  StepInput<Jet> jets_;  // kept: it is large to set up
  static constexpr std::size_t kMostResting = 4;
  std::vector<Resting> resting_;  // the latest ones
  std::size_t next_resting_ = 0;
  std::vector<double> published_;
};

}  // namespace saltus
